"""Reduced systems are port-Hamiltonian, as near as their bounds say, and right in special cases."""

import pickle

import control as ct
import numpy as np
import pytest
from passive_systems import passive_system
from slow import slowly

import ph_control as phc

METHODS = ("modal", "balanced", "h2")


def matrices(sys):
    return ct.ss(sys.A, sys.B, sys.C, sys.D)


def error_on_a_grid(one, other):
    """Largest difference of the responses, by dense matrices, at resonances of both and between them."""
    poles = np.concatenate([np.linalg.eigvals(one.A), np.linalg.eigvals(other.A)])
    size = np.abs(poles)
    near = (np.abs(poles.imag)[:, None] + poles.real[:, None] * np.linspace(-3, 3, 31)).ravel()
    omega = np.unique(np.concatenate([[0.0], np.geomspace(size.min() / 30, size.max() * 30, 400), near[near > 0]]))
    values = [M.C @ np.linalg.solve(1j * w * np.eye(len(M.A)) - M.A, M.B) + M.D for M in (one, other) for w in omega]
    half = len(omega)
    return max(np.linalg.norm(a - b, 2) for a, b in zip(values[:half], values[half:], strict=True))


def damped_system(seed):
    """Random passive system of poles off the axis."""
    while True:
        given, _ = passive_system(seed, states=16, hidden=False, scales=3.0, condition=0.0)
        if given.nstates > 3 and (given.poles().real < -1e-4 * np.abs(given.poles())).all():
            return given
        seed += 1000


@pytest.mark.variants
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [0, 1, *slowly(2, 3)])
def test_reduced_systems_are_passive_and_the_bound_holds(method, seed):
    given = damped_system(seed)
    order = max(1, given.nstates // 2)
    small = phc.reduce(given, order, method=method)
    assert isinstance(small, phc.PortHamiltonian)
    assert phc.passivity(matrices(small)).is_passive
    error = error_on_a_grid(given, small)
    scale = ct.linfnorm(given)[0]
    assert error <= small.error_bound * (1 + 1e-6) + 1e-9 * scale
    if np.isfinite(small.error_bound) and error > 1e-6 * scale:
        assert small.error_bound <= 2 * error


@pytest.mark.slow
def test_the_benchmark_chain_has_the_known_h2_errors():
    chain = phc.msd_chain()
    # of orders 6 and 14 the balanced starts end in symmetric models, with twice the error
    for order, most in ((4, 0.05066), (6, 0.011165), (10, 7.715e-4), (14, 2.94e-5)):
        small = phc.reduce(chain, order, method="h2")
        assert small.nstates == order and phc.passivity(matrices(small)).is_passive
        assert ct.norm(matrices(chain) - matrices(small), 2) < most


@pytest.mark.slow
def test_a_further_state_never_makes_the_h2_model_worse():
    chain = phc.msd_chain(5)
    full = matrices(chain)
    errors = [ct.norm(full - matrices(phc.reduce(chain, order, method="h2")), 2) for order in range(1, 6)]
    assert (np.diff(errors) < 0).all() and errors[-1] < 0.5 * errors[0]


def test_the_h2_model_is_stationary():
    chain = phc.msd_chain(6)
    small = phc.reduce(chain, 4, method="h2")
    full = matrices(chain)
    best = ct.norm(full - matrices(small), 2)
    rng = np.random.default_rng(0)
    for _ in range(20):
        J, R, G = small.J.copy(), small.R.copy(), small.G.copy()
        turn = rng.normal(size=J.shape)
        J += 1e-3 * np.abs(J).max() * (turn - turn.T)
        k, U = np.linalg.eigh(R)
        L = U * np.sqrt(np.maximum(k, 0.0)) + 1e-3 * np.sqrt(np.abs(R).max()) * rng.normal(size=R.shape)
        G += 1e-3 * np.abs(G).max() * rng.normal(size=G.shape)
        moved = ct.ss((J - L @ L.T) @ small.Q, G, G.T @ small.Q, 0 * small.D)
        assert ct.norm(full - moved, 2) > best * (1 - 1e-9)


def test_classical_modes_stay_as_they_are():
    d, r = np.array([1.0, 2.0, 3.0, 5.0]), np.array([0.5, 2.0, 0.1, 1.0])
    plant = phc.ph(phc.modes(d, r, damping=0.02))
    low = phc.reduce(plant, band=(0.0, 2.5), residual_modes=False)
    omega = np.geomspace(0.1, 20, 50)
    expected = phc.modes(d[:2], r[:2], damping=0.02).freqresp(omega)
    assert np.abs(low.modes.freqresp(omega) - expected).max() < 1e-9 * np.abs(expected).max()
    rest = phc.ph(phc.modes(d[2:], r[2:], damping=0.02))
    assert low.error_bound == pytest.approx(ct.linfnorm(matrices(rest))[0], rel=1e-6)
    highest = phc.reduce(plant, 2, residual_modes=False)
    assert highest.natural_frequencies[0] == pytest.approx(2.0)


def test_residual_modes_make_the_response_right_at_low_frequencies():
    rng = np.random.default_rng(3)
    n = 12
    K = np.diag(np.arange(1.0, n + 1) ** 2) + 0.1
    C = 0.02 * K + 0.05 * np.diag(rng.uniform(size=n))
    frame = phc.from_second_order(np.eye(n), K, rng.normal(size=(n, 2)), C=C)
    plain, static = (phc.reduce(frame, band=(0.0, 3.5), residual_modes=on) for on in (False, True))
    assert static.nstates == plain.nstates + 4
    s = 1e-4j
    exact = frame(s)
    assert np.abs(static(s) - exact).max() < 1e-5 * np.abs(exact).max() < np.abs(plain(s) - exact).max()
    for pole in plain.poles():
        assert np.abs(static.poles() - pole).min() < 1e-9
        assert np.abs(frame.poles() - pole).min() < 1e-9


@pytest.mark.variants
@pytest.mark.parametrize("port", [0, 99])
@pytest.mark.parametrize("order", [8, *slowly(12, 20)])
def test_residual_modes_do_not_resonate(port, order):
    """Without dampers of their own their resonances were up to 183 times as high as all those of the chain."""
    chain = phc.spring_chain(np.ones(100), 4.0, ground=[2.0] + [0.0] * 99, c=0.05, port=port)
    static, plain = (phc.reduce(chain, order, residual_modes=on).error_bound for on in (True, False))
    assert static < 2 * plain


def test_lossless_systems_stay_lossless_and_the_bound_is_that_of_the_band():
    chain = phc.spring_chain(np.ones(20), 4.0, ground=1.0)
    for keywords in ({"band": (0.0, 1.5)}, {"order": 8, "band": (0.0, 2.0)}, {"order": 6}, {"band": (1.0, 2.0)}):
        small = phc.reduce(chain, **keywords)
        assert small.is_lossless and type(small) is phc.PortHamiltonian and small.nstates <= 14
    small = phc.reduce(chain, band=(0.0, 1.5))
    omega = np.linspace(0.0, 1.5, 300)
    away = np.abs(omega[:, None] - chain.d).min(axis=1) > 1e-3
    off = np.abs(chain.modes.freqresp(omega) - small.modes.freqresp(omega))[away].max()
    assert off <= small.error_bound * (1 + 1e-9) and small.error_bound < 3 * off
    plain = phc.reduce(chain, band=(0.0, 1.5), residual_modes=False)
    assert plain.n == small.n - 1 and plain.error_bound > 2 * small.error_bound
    assert np.isinf(phc.reduce(chain, 4, residual_modes=False, band=(0.0, 2.0)).error_bound)


@pytest.mark.parametrize("method", METHODS[1:])
def test_lossless_systems_have_no_other_method(method):
    with pytest.raises(phc.StructureError, match=r"lossless.*method='modal'"):
        phc.reduce(phc.spring_chain([1.0, 1.0], 1.0, ground=1.0), 2, method=method)


@pytest.mark.parametrize("method", METHODS[1:])
def test_poles_on_the_axis_are_kept_beside(method):
    plant = phc.msd_chain(6) + phc.ph(np.diag([4.0, 4.0, 1.0, 1.0]), np.vstack([np.zeros((2, 2)), np.eye(2)]))
    small = phc.reduce(plant, 4, method=method)
    assert small.nstates == 8 and np.abs(small.poles() - 2j).min() < 1e-9
    assert np.isfinite(small.error_bound)


@pytest.mark.parametrize("method", METHODS)
def test_all_states_and_one(method):
    chain = phc.msd_chain(3)
    same = phc.reduce(chain, 6, method=method)
    assert same.error_bound == 0 and np.array_equal(same.A, chain.A)
    # two equal pairs of poles
    twice = phc.ph(phc.modes([1.0, 1.0, 2.0], [1.0, 1.0, 0.5], damping=0.1))
    assert phc.reduce(twice, 4, method=method).nstates <= 4
    slow = phc.ph(phc.modes([1.0, 3.0], [1.0, 0.5], damping=1.5))
    small = phc.reduce(slow, 1, method=method)
    assert small.nstates == 1 and phc.passivity(small).is_passive


@pytest.mark.variants
@pytest.mark.parametrize("rate", [1e-10, 1e10])
@pytest.mark.parametrize("size", [1e12, *slowly(1e-12)])
def test_the_error_bound_has_units(rate, size):
    chain = phc.msd_chain(4)
    other = phc.ph(chain.Q, np.sqrt(size) * chain.B, J=rate * chain.J, R=rate * chain.R)
    for method in METHODS:
        one, two = (phc.reduce(sys, 4, method=method).error_bound for sys in (chain, other))
        assert two == pytest.approx(one * size / rate, rel=1e-3)


def test_orders_of_which_no_linear_model_can_be_made_passive():
    # frequencies decades apart: the closest passive models of one state, with their inputs as they are, have none
    for seed in (13, 17):
        plant, _ = passive_system(seed, states=12, hidden=True, scales=6.0, condition=3.0)
        small = phc.reduce(plant, 1, method="h2")
        assert small.nstates <= 5 and phc.passivity(small).is_passive


def test_a_tolerance_chooses_the_order():
    chain = phc.msd_chain(12)
    gain = ct.linfnorm(matrices(chain))[0]
    small = phc.reduce(chain, tolerance=0.01, method="balanced")
    assert 0 < small.error_bound <= 0.01 * gain
    assert phc.reduce(chain, small.nstates - 2, method="balanced").error_bound > 0.01 * gain


@pytest.mark.variants
@pytest.mark.parametrize("method", METHODS)
def test_sensors_names_and_pickles(method):
    n = 6
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    plant = phc.from_second_order(
        np.eye(n), K, np.eye(n)[0], C=0.1 * K, sensors=np.eye(n)[[3]], inputs=["force"], outputs=["velocity", "there"]
    )
    small = phc.reduce(plant, 6, method=method)
    assert small.output_labels == ["velocity", "there"] and small.input_labels == ["force"]
    assert error_on_a_grid(plant, small) <= small.error_bound * (1 + 1e-6)
    again = pickle.loads(pickle.dumps(small))
    assert again.error_bound == small.error_bound and np.array_equal(again.A, small.A)


@pytest.mark.parametrize(
    "keywords, match",
    [
        ({}, "order, a tolerance"),
        ({"order": 2, "tolerance": 0.1}, "without order"),
        ({"order": 0}, "order"),
        ({"tolerance": 2.0}, "between 0 and 1"),
        ({"band": (2.0, 1.0)}, "low < high"),
        ({"band": (50.0, 60.0), "residual_modes": False}, "no natural frequency"),
        ({"band": (0.0, 1.0), "method": "h2"}, "band chooses modes"),
        ({"order": 2, "method": "irka"}, "'balanced'"),
    ],
)
def test_refusals(keywords, match):
    with pytest.raises(phc.StructureError, match=match):
        phc.reduce(phc.msd_chain(4), **keywords)


def test_what_is_not_passive_is_sent_on():
    with pytest.raises(phc.NotPassiveError):
        phc.reduce(ct.tf([1.0, -0.1, 0.0], [1.0, 0.4, 2.1, 0.4, 1.0]), 2)


def test_models_of_pymor_and_back():
    pytest.importorskip("pymor", reason="pyMOR is optional")
    from pymor.reductors.ph.ph_irka import PHIRKAReductor

    chain = phc.msd_chain(6)
    model = phc.to_pymor(chain)
    again = phc.from_pymor(model)
    assert np.array_equal(again.A, chain.A) and np.array_equal(again.C, chain.C)
    small = phc.from_pymor(PHIRKAReductor(model).reduce(4))
    assert isinstance(small, phc.PortHamiltonian) and small.nstates == 4 and phc.passivity(small).is_passive
    plain = phc.to_pymor(ct.ss(chain.A, chain.B, chain.C, np.eye(2)))
    assert np.array_equal(phc.from_pymor(plain).D, np.eye(2))
    for wrong in (3.0, ct.tf([1.0], [1.0, 1.0])):
        with pytest.raises(phc.StructureError, match="StateSpace"):
            phc.to_pymor(wrong)
    with pytest.raises(phc.StructureError, match="LTIModel"):
        phc.from_pymor(chain)


def test_units_of_stiffness_and_mass_do_not_matter():
    """In SI the stiffnesses and mobilities of a building are sixteen decades apart."""
    K = 1e9 * (2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    plant = phc.from_second_order(2e6 * np.eye(6), K, np.eye(6)[:, :1], C=1e-3 * K)
    small = phc.reduce(plant, order=6, residual_modes=False)
    assert np.allclose(small.natural_frequencies, plant.natural_frequencies[:3], rtol=1e-9)

"""The passive model next to another: passive by the exact test, poles kept, and no nearer one.

The reference is the semidefinite program of the same problem, by CVXPY and Clarabel where they are installed
(`passive_programs.py`), and else costs that `python -m benchmarks.semidefinite --stored` prints.
"""

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from passive_programs import KINDS, program, random_system
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

STORED = {
    0: 32170.79,
    1: 15.446506,
    2: 339.66323,
    3: 18.104089,
    4: 706.92678,
    5: 8699.899,
    6: 311.5807,
    7: 0.041299362,
}


def matrices(sys):
    return ct.ss(sys.A, sys.B, sys.C, sys.D)


def active_system(seed, ports=None):
    """Stable system of random modes and residues, which gives energy somewhere."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 5)), ports or int(rng.integers(1, 4))
    d, zeta = rng.uniform(0.5, 3.0, n), rng.uniform(0.01, 0.3, n)
    A = np.kron(np.diag(d), [[0.0, 1.0], [-1.0, 0.0]]) - np.diag(np.repeat(zeta * d, 2))
    B = rng.normal(size=(2 * n, m))
    scale = 10 ** rng.uniform(-4, 4, 3)
    C = 0.2 * B.T + rng.normal(size=(m, 2 * n)) * rng.uniform(0.5, 2.0)
    return ct.ss(A * scale[0], B * scale[1], C * scale[2], np.zeros((m, m)))


def least_by_search(sys, grid):
    """Least squared H2 distance of residues that are passive on a dense grid, by a general solver: one port."""
    A, B, C = (np.asarray(M) for M in (sys.A, sys.B, sys.C))
    P = ct.lyap(A, B @ B.T)
    K = np.array([np.linalg.solve(1j * w * np.eye(len(A)) - A, B)[:, 0] for w in grid])
    size = np.abs(K).max(axis=1)
    beyond = -(A @ B)[:, 0]
    root = np.linalg.cholesky(P)
    x0 = C[0] @ root
    rows = np.vstack([np.real(K) / size[:, None], beyond[None] / np.abs(beyond).max()]) @ np.linalg.inv(root).T
    found = minimize(
        lambda x: np.sum((x - x0) ** 2) / np.sum(x0**2), x0, jac=lambda x: 2 * (x - x0) / np.sum(x0**2), method="SLSQP",
        constraints={"type": "ineq", "fun": lambda x: rows @ x, "jac": lambda x: rows},
        options={"maxiter": 500, "ftol": 1e-14},
    )  # fmt: skip
    assert found.success or found.status == 8  # rounding ends the search
    return found.fun * np.sum(x0**2)


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_model_is_passive_and_its_cost_is_the_h2_distance(seed):
    given = active_system(seed)
    assert not phc.passivity(given).is_passive
    model = phc.nearest_passive(given)
    assert isinstance(model, phc.PortHamiltonian)
    assert phc.passivity(matrices(model)).is_passive
    distance = ct.norm(given - matrices(model), 2) ** 2
    assert model.cost == pytest.approx(distance, rel=1e-5)
    kept = model.poles()
    for pole in kept:
        assert np.abs(given.poles() - pole).min() < 1e-6 * np.abs(pole)


@pytest.mark.variants
@pytest.mark.parametrize("seed", [20, 21, 22, 23])
def test_no_nearer_model_is_found_by_a_general_solver(seed):
    given = active_system(seed, ports=1)
    poles = given.poles()
    size = np.abs(poles).max()
    near = np.concatenate([np.abs(p.imag) + p.real * np.linspace(-6, 6, 121) for p in poles])
    grid = np.unique(np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 600) * size, near[near > 0]]))
    model = phc.nearest_passive(given)
    assert model.cost == pytest.approx(least_by_search(given, grid), rel=2e-3)


def test_what_is_passive_stays_as_it_is():
    chain = phc.msd_chain(5)
    same = phc.nearest_passive(chain)
    assert same.cost == 0 and np.array_equal(same.A, chain.A)
    lossless = phc.nearest_passive(ct.tf([2, 0], [1, 0, 4]))
    assert lossless.cost == 0 and lossless.is_lossless


def test_ports_that_drive_nothing_and_poles_on_the_axis():
    A = np.array([[-0.1, 1.0], [-1.0, -0.1]])
    B = np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 1.0]])
    C = np.array([[0.3, 0.1], [0.2, 0.0], [-0.1, 0.4]])
    model = phc.nearest_passive(ct.ss(A, B, C, np.zeros((3, 3))))
    assert np.linalg.norm(model.C[1]) < 1e-9 and phc.passivity(matrices(model)).is_passive
    indefinite = ct.tf([1.0, 0.0], [1.0, 0.0, 1.0]) + ct.tf([1.0, -1.0], [1.0, 1.0, 4.0])
    kept = phc.nearest_passive(indefinite)
    assert phc.passivity(kept).is_passive and 0 < kept.cost < np.inf
    assert np.abs(kept.poles() - 1j).min() < 1e-9
    wrong = phc.nearest_passive(-1 * ct.tf([1.0, 0.0], [1.0, 0.0, 1.0]) + ct.tf([1.0, 0.0], [1.0, 1.0, 4.0]))
    assert wrong.cost == np.inf and wrong.nstates == 2


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(4))
def test_a_weight_moves_the_feedthrough_too(seed):
    given = active_system(seed)
    given = ct.ss(given.A, given.B, given.C, given.D - 0.1 * ct.norm(given, "inf") * np.eye(given.ninputs))
    with pytest.raises(phc.StructureError, match=r"feedthrough D is active.*weight=\(omega, weights\)"):
        phc.nearest_passive(given)
    omega = np.linspace(0.0, 2.0, 40) * np.abs(given.poles()).max()
    weights = np.linspace(1.0, 0.5, 40)
    model = phc.nearest_passive(given, weight=(omega, weights))
    assert phc.passivity(matrices(model)).is_passive
    off = np.moveaxis(given(1j * omega, squeeze=False) - model(1j * omega, squeeze=False), 2, 0)
    assert model.cost == pytest.approx(np.sum((weights * np.linalg.norm(off, axis=(1, 2))) ** 2), rel=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_scattering_matrices(seed):
    given = active_system(seed)
    given = given * (1.05 / ct.norm(given, "inf"))
    assert not phc.passivity(given, kind="scattering").is_passive
    model = phc.nearest_passive(given, kind="scattering")
    assert phc.passivity(model, kind="scattering").is_passive
    assert model.cost == pytest.approx(ct.norm(given - model, 2) ** 2, rel=1e-5)
    # scaling all residues down is passive as well, and farther away
    assert 0 < model.cost < (0.05 / 1.05 * ct.norm(given, 2)) ** 2 * 1.001


def noisy_fit(seed, ports=1):
    """Free fit of a passive plant whose weak mode drowns in noise."""
    rng = np.random.default_rng(seed)
    d = np.array([1.0, 1.7, 2.6])
    psi = rng.normal(size=(3, ports)) * np.array([1.0, 0.05, 1.0])[:, None]
    p = d * (-0.02 + 1j * np.sqrt(1 - 0.02**2))
    w = np.linspace(0.3, 4.0, 150)
    residues = psi[:, :, None] * psi[:, None, :] * (p / (2j * p.imag))[:, None, None]
    s = 1j * w[:, None]
    G = np.einsum("kl,lab->abk", 1 / (s - p), residues) + np.einsum("kl,lab->abk", 1 / (s - p.conj()), residues.conj())
    G = G + 0.02 * np.abs(G).max() * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape))
    pairs = None if ports == 1 else [(k, k) for k in range(ports)]
    quantity = {} if ports == 1 else {"quantity": ["velocity"] * ports}
    return phc.pem(ct.FrequencyResponseData(G, w), 3, structure="free", ports=pairs, **quantity)


@pytest.mark.variants
@pytest.mark.parametrize("seed, ports", [(1, 1), (0, 2), *slowly((2, 1), (3, 1), (1, 2))])
def test_a_fit_pays_in_likelihood_and_less_than_by_another_metric(seed, ports):
    fit = noisy_fit(seed, ports)
    by_data = phc.nearest_passive(fit)
    assert phc.passivity(by_data).is_passive and isinstance(by_data, phc.PortHamiltonian)
    assert by_data.cost > 0 and by_data.ninputs == ports
    by_h2 = phc.nearest_passive(fit, weight="h2")
    assert phc.passivity(by_h2).is_passive
    # residues of the answers, in the metric of the fit with poles as they are
    n, size = len(fit.poles), fit.residues.size
    if (fit.poles.real < 0).all():
        assert all(np.abs(by_data.poles() - pole).min() < 1e-6 for pole in fit.poles)
        information = np.linalg.pinv(np.nan_to_num(fit.covariance))[2 * n :, 2 * n :]

        def likelihood_ratio(model):
            form = phc.modes(ct.ss(model.A, model.B, model.C, model.D))
            omega = np.linspace(0.1, 5.0, 400)
            s = 1j * omega[:, None]
            basis = np.hstack([1 / (s - fit.poles) + 1 / (s - fit.poles.conj()),
                               1j / (s - fit.poles) - 1j / (s - fit.poles.conj())])  # fmt: skip
            values = np.moveaxis(form.evaluate(1j * omega), 2, 0).reshape(len(omega), -1)
            both = np.vstack([basis.real, basis.imag])
            found = np.linalg.lstsq(both, np.vstack([values.real, values.imag]), rcond=None)[0]
            moved = found - np.vstack([fit.residues.reshape(n, -1).real, fit.residues.reshape(n, -1).imag])
            moved = np.concatenate([moved.ravel(), np.zeros(len(information) - 2 * size)])
            return float(moved @ information @ moved)

        assert likelihood_ratio(by_data) == pytest.approx(by_data.cost, rel=1e-3)
        assert likelihood_ratio(by_data) <= likelihood_ratio(by_h2) * (1 + 1e-4)


@pytest.mark.parametrize(
    "system, keywords, match",
    [
        (ct.tf([1.0], [1.0, -1.0]), {}, "right half-plane.*fit it again with stable poles"),
        (ct.tf([1.0], [1.0, 1.0]), {"weight": "covariance"}, "is for fits"),
        (ct.tf([1.0], [1.0, 1.0]), {"weight": "l2"}, "'covariance', 'h2'"),
        (ct.tf([1.0], [1.0, 1.0]), {"weight": 3}, "a pair"),
        (ct.tf([1.0], [1.0, 1.0]), {"weight": ([1.0, 2.0], [1.0])}, "shape"),
        (ct.tf([1.0], [1.0, 1.0]), {"kind": "power"}, "immittance"),
        (ct.tf([1.0], [1.0, 0.0]), {"kind": "scattering"}, "pole on the imaginary axis"),
        (ct.tf([1.0], [1.0, 0.0, 0.0]), {}, "not simple"),
        (ct.tf([1.0], [1.0, 0.5], 0.1), {}, "discrete time"),
    ],
)
def test_refusals(system, keywords, match):
    with pytest.raises(phc.StructureError, match=match):
        phc.nearest_passive(system, **keywords)


def kind_of(seed):
    return "scattering" if KINDS[seed % 4] == "scattering" else "immittance"


@pytest.mark.parametrize("seed", STORED)
def test_the_cost_is_the_least_of_all_models_with_these_poles_and_inputs(seed):
    system = random_system(seed)
    model = phc.nearest_passive(system, kind=kind_of(seed))
    assert phc.passivity(matrices(model), kind=kind_of(seed)).is_passive
    assert model.cost == pytest.approx(STORED[seed], rel=1e-6)
    assert np.abs(model.D - system.D).max() <= 1e-13 * (1 + np.abs(system.D).max())


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(100, 116))
def test_the_cost_is_that_of_a_semidefinite_program(seed):
    pytest.importorskip("cvxpy", reason="the semidefinite program needs the packages of the bench extra")
    system = random_system(seed)
    model = phc.nearest_passive(system, kind=kind_of(seed))
    assert phc.passivity(matrices(model), kind=kind_of(seed)).is_passive
    reference = program(system, kind_of(seed) == "scattering")
    assert model.cost == pytest.approx(reference, rel=1e-5, abs=1e-12 * squared_norm(system))


def squared_norm(system):
    A, B, C = (np.asarray(M) for M in (system.A, system.B, system.C))
    return float(np.trace(C @ solve_continuous_lyapunov(A, -B @ B.T) @ C.T))


@pytest.mark.slow
@settings(deadline=None, max_examples=12, derandomize=True)
@given(
    seed=st.integers(0, 2**31), damping=st.floats(-8, -1), rate=st.sampled_from([1e-9, 1.0, 1e9]),
    size=st.sampled_from([1e-9, 1.0, 1e9]),
)  # fmt: skip
def test_a_lightly_damped_mode_of_two_ports_costs_at_most_itself(seed, damping, rate, size):
    rng = np.random.default_rng(seed)
    w, zeta = 10 ** rng.uniform(-1, 1), 10**damping
    A = np.array([[0.0, w], [-w, -2 * zeta * w]])
    B, C = rng.standard_normal((2, 2, 2))
    system = ct.ss(rate * A, rate * B, size * C, 0)
    model = phc.nearest_passive(system)
    assert phc.passivity(matrices(model)).is_passive
    # with two states and two inputs `C B^-1` is the storage, nearly a multiple of the unit matrix: the model of the
    # best multiple is passive
    multiple = max(0.0, float(np.sum(C * B.T) / np.sum(B**2)))
    bound = squared_norm(ct.ss(rate * A, rate * B, size * (C - multiple * B.T), 0))
    assert model.cost <= min(bound, squared_norm(system)) * (1 + 1e-6)
    assert model.cost == pytest.approx(phc.nearest_passive(ct.ss(A, B, C, 0)).cost * rate * size**2, rel=1e-5)


@pytest.mark.variants
@pytest.mark.parametrize("amount", [3e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("masses, ports", [(1, 2), (3, 2), (4, 3)])
def test_a_disturbed_structure_costs_at_most_its_disturbance(masses, ports, amount):
    rng = np.random.default_rng(17)
    x, y, F = (rng.standard_normal(shape) for shape in ((masses, masses), (masses, masses), (masses, ports)))
    plant = phc.from_second_order(np.eye(masses), x @ x.T + np.eye(masses), F, C=0.01 * (y @ y.T + np.eye(masses)))
    C = plant.C * (1 + amount * rng.standard_normal(plant.C.shape))
    model = phc.nearest_passive(ct.ss(plant.A, plant.B, C, 0))
    assert phc.passivity(matrices(model)).is_passive
    assert model.cost <= squared_norm(ct.ss(plant.A, plant.B, C - plant.C, 0)) * (1 + 1e-9)


@pytest.mark.variants
@pytest.mark.parametrize(
    "A",
    [[[-2.0]], [[-1.0, 1.0], [0.0, -1.0]], [[0.0, 1.0], [-4.0, -4.0]], np.diag([-1.0, -1 - 1e-9, -3.0]), -np.eye(3)],
    ids=["one state", "double pole", "critical damping", "nearly equal poles", "equal poles"],
)
@pytest.mark.parametrize("ports", [1, 2])
def test_degenerate_poles_have_a_nearest_model_too(A, ports):
    rng = np.random.default_rng(4)
    A = np.array(A)
    B, C = rng.standard_normal((len(A), ports)), rng.standard_normal((ports, len(A)))
    system = ct.ss(A, B, C, 0)
    model = phc.nearest_passive(system)
    assert phc.passivity(matrices(model)).is_passive
    assert model.cost <= squared_norm(system) * (1 + 1e-6)


@pytest.mark.parametrize("several", [False, True])
def test_a_lossless_fit_is_its_own_nearest_passive_model(several):
    rng = np.random.default_rng(0)
    plant = phc.spring_chain([1.0, 1.0], [2.0], ground=1.0, port=[0, 1] if several else 0)
    u = rng.standard_normal((plant.ninputs, 400))
    y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh", squeeze=False).outputs
    ports = {"ports": [(0, 0), (1, 1)]} if several else {}
    fit = phc.pem((u, y + 0.01 * rng.standard_normal(y.shape)), 2, dt=0.1, structure="lossless", **ports)
    model = phc.nearest_passive(fit)
    s = np.array([0.3 + 1j, 0.1 + 3j])
    assert model.cost == 0 and model.is_lossless
    np.testing.assert_allclose(model.horner(s), fit.system.horner(s), rtol=1e-12)
    with pytest.raises(phc.StructureError, match="pole on the imaginary axis"):
        phc.nearest_passive(fit, kind="scattering")


@pytest.mark.parametrize("seed", [12, 119])
def test_a_mode_near_critical_damping_whose_nearest_passive_poles_meet(seed):
    """Residues of poles that meet have no slopes."""
    rng = np.random.default_rng(seed)
    u, k = lfilter([1], [1, -0.9], rng.standard_normal(400)), np.arange(400)
    w, zeta = rng.uniform(0.05, 0.2), rng.uniform(0.9, 0.999)
    pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    response = np.real(np.exp(pole * k) * np.exp(1j * rng.uniform(0, 6.28)))
    y = np.convolve(response, np.append(0.0, u))[:400]
    y = y / y.std() + rng.uniform(0.1, 2) * rng.standard_normal(400)
    result = phc.pem((u, y), 1, dt=1.0)
    passive = next(test for test in result.tests if test.hypothesis == "passive")
    assert np.isfinite(result.poles).all() and 0 <= passive.p <= 1

"""Responses of the canonical forms, in their own coordinates, against companion matrices with many digits."""

import warnings

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_step

import ph_control as phc

relaxed = settings(deadline=None, max_examples=12, derandomize=True)
RULES = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
SPECTRA = {
    "one": [2.0],
    "decade": np.logspace(0, 1, 4),
    "wide 1e4": np.logspace(-2, 2, 3),
    "clustered 1e-6": 1 + 1e-6 * np.arange(3),
    "repeated": [1.0, 2.0, 1.0, 2.0],
    "slow": [1e-9, 2e-9, 3e-9],
    "fast": [1e9, 2e9, 3e9],
}


@pytest.fixture(autouse=True)
def _quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", phc.ConditioningWarning)
        yield


def companion_step(A, B, h, method, intersample):
    """`s_{k+1} = F s_k + G0 u_k + G1 u_{k+1}` in mpmath, from the companion matrix itself."""
    A, B, h = mp.matrix(A.tolist()), mp.matrix(B.tolist()), mp.mpf(h)
    n = A.rows
    I = mp.eye(n)
    if method == "euler":
        return I + h * A, h * B, 0 * B
    if method == "midpoint":
        inverse = (I - h / 2 * A) ** -1
        F, G = inverse * (I + h / 2 * A), inverse * B * h
        return (F, G, 0 * B) if intersample == "zoh" else (F, G / 2, G / 2)
    M = mp.zeros(n + 2)
    for i in range(n):
        for j in range(n):
            M[i, j] = h * A[i, j]
        M[i, n] = h * B[i]
    M[n, n + 1] = 1
    E = mp.expm(M, method="taylor")
    F, whole, late = E[:n, :n], E[:n, n], E[:n, n + 1]
    return (F, whole, 0 * B) if intersample == "zoh" else (F, whole - late, late)


def many_digits(sys, h, u, s0, method, intersample):
    with mp.workdps(150):
        F, now, then = companion_step(sys.A, sys.B, h, method, intersample)
        s, C = mp.matrix(s0.tolist()), mp.matrix(sys.C.tolist())
        states, outputs = [s], [(C * s)[0]]
        for k in range(len(u) - 1):
            s = F * s + now * mp.mpf(float(u[k])) + then * mp.mpf(float(u[k + 1]))
            states.append(s)
            outputs.append((C * s)[0])
        return np.array([float(y) for y in outputs]), np.array([[float(x) for x in s] for s in states]).T


def typical_state(sys, rng):
    """Entries of the sizes that a companion state has: each the derivative of the one before."""
    powers = np.median(sys.modes.d) ** np.arange(2.0 * sys.n)
    return rng.standard_normal(2 * sys.n) * (powers if isinstance(sys, phc.ControllableHamiltonian) else powers[::-1])


@pytest.mark.variants
@pytest.mark.parametrize("name", SPECTRA)
@pytest.mark.parametrize("make", [phc.ch, phc.oh])
@pytest.mark.parametrize("rule", RULES, ids="-".join)
def test_outputs_and_states_are_those_of_the_companion_matrix(name, make, rule):
    rng = np.random.default_rng(3)
    d = np.array(SPECTRA[name])
    sys = make(d, rng.standard_normal(2 * len(d)))
    h = 0.2 / d.max()
    u, s0 = rng.standard_normal(25), typical_state(sys, rng)
    response = phc.forced_response(sys, h * np.arange(25), u, s0, method=rule[0], intersample=rule[1])
    outputs, states = many_digits(sys, h, u, s0, *rule)
    # the coefficients of the matrix are rounded, which moves close frequencies: what the reference itself is worth
    worth = 1e3 * EPS * 10 ** min(0.0, sys.digits - 15) if sys.digits > 6 else 1e-9
    allowed = max(2e-12, 1e4 * EPS * 10.0 ** (15.7 - sys.digits) if 6 < sys.digits < 12 else 2e-12, worth)
    assert np.max(np.abs(response.outputs - outputs)) <= allowed * np.max(np.abs(outputs))
    scale = np.max(np.abs(states), axis=1)
    assert np.max(np.max(np.abs(response.states - states), axis=1) / scale) <= allowed
    alone = phc.forced_response(sys, h * np.arange(25), u, s0, method=rule[0], intersample=rule[1], return_states=False)
    assert np.array_equal(alone.outputs, response.outputs)


@relaxed
@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.sampled_from(RULES), st.booleans())
def test_the_controllable_form_moves_as_its_image_does(n, seed, rule, repeated):
    """`z = L s` is carried along by every rule of stepping: the remark on integrators of the paper's appendix."""
    rng = np.random.default_rng(seed)
    d = np.cumsum(rng.uniform(0.5, 1.5, n))
    if repeated and n > 1:
        d[1] = d[0]
    v = rng.standard_normal(2 * n)
    sys = phc.ch(d, v)
    L = phc.controllable_morphism(d, v)
    t, u, s0 = 0.1 * np.arange(40), rng.standard_normal(40), rng.standard_normal(2 * n)
    ours = phc.forced_response(sys, t, u, s0, method=rule[0], intersample=rule[1])
    image = phc.forced_response(sys.port_hamiltonian(), t, u, L @ s0, method=rule[0], intersample=rule[1])
    size = np.max(np.abs(image.states))
    assert np.max(np.abs(L @ ours.states - image.states)) <= 1e5 * EPS * max(
        size, np.max(np.abs(L) @ np.abs(ours.states))
    )
    assert np.max(np.abs(ours.outputs - image.outputs)) <= 1e4 * EPS * max(1.0, np.max(np.abs(image.outputs)))


@relaxed
@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.sampled_from(RULES), st.booleans())
def test_the_observable_form_shows_every_motion_of_the_port_hamiltonian_system(n, seed, rule, repeated):
    rng = np.random.default_rng(seed)
    d = np.cumsum(rng.uniform(0.5, 1.5, n))
    if repeated and n > 1:
        d[1] = d[0]
    v = rng.standard_normal(2 * n)
    v[[n - 1, 2 * n - 1]] = 0.0
    source = phc.ph(np.diag(np.r_[d, d]), v)
    L = phc.observable_morphism(source)
    t, u, z0 = 0.1 * np.arange(40), rng.standard_normal(40), rng.standard_normal(2 * n)
    truth = phc.forced_response(source, t, u, z0, method=rule[0], intersample=rule[1])
    ours = phc.forced_response(phc.oh(d, v), t, u, L @ z0, method=rule[0], intersample=rule[1])
    size = 1 + np.max(np.abs(truth.outputs))
    assert np.max(np.abs(ours.outputs - truth.outputs)) <= 1e6 * EPS * size
    reach = np.max(np.abs(L) @ np.abs(truth.states))
    assert np.max(np.abs(ours.states - L @ truth.states)) <= 1e6 * EPS * reach


def test_a_repeated_frequency_makes_free_motions_of_the_observable_form_grow_and_no_output_of_the_controllable():
    d, v = [1.0, 1.0], [1.0, 0.0, 1.0, 1.0]
    t = np.linspace(0, 200, 2001)
    free = phc.initial_response(phc.oh(d, v), t, [1.0, 0.0, 0.0, 0.0]).outputs
    # 1/(s^2+1)^2
    assert np.max(np.abs(free - 0.5 * (np.sin(t) - t * np.cos(t)))) < 1e-10
    driven = phc.initial_response(phc.ch(d, v), t, [1.0, 0.0, 0.0, 0.0]).outputs
    assert np.max(np.abs(driven)) < 10


def test_a_double_pole_at_0_is_followed():
    t = np.linspace(0, 10, 101)
    sys = phc.oh([0.0, 1.0], [0.0, 2.0])
    response = phc.forced_response(sys, t, 1.0, [3.0, 5.0])
    assert np.max(np.abs(response.outputs - (5 + 3 * t + 4 * t))) < 1e-12
    sys = phc.ch([0.0, 1.0], [0.0, 2.0])
    response = phc.forced_response(sys, t, 1.0, [3.0, 5.0])
    assert np.max(np.abs(response.states - [3 + 5 * t + t**2 / 2, 5 + t])) < 1e-11
    assert np.max(np.abs(response.outputs - 4 * (5 + t))) < 1e-11


def test_thirty_modes_respond_though_their_companion_matrix_tells_nothing():
    n, rng = 30, np.random.default_rng(0)
    d, v = np.linspace(1, 10, n), rng.standard_normal(2 * n)
    source = phc.ph(np.diag(np.r_[d, d]), v)
    t, u = 0.05 * np.arange(400), rng.standard_normal(400)
    truth = phc.forced_response(source, t, u).outputs
    for make in (phc.ch, phc.oh):
        found = phc.forced_response(make(d, v), t, u, return_states=False).outputs
        assert np.max(np.abs(found - truth)) < 1e-12 * np.max(np.abs(truth))
    steps, impulses = (
        [call(system, t).outputs for system in (source, phc.ch(d, v), phc.oh(d, v))]
        for call in (phc.step_response, lambda s, t: phc.impulse_response(s, t, return_states=True))
    )
    assert np.max(np.abs(np.array(steps) - steps[0])) < 1e-11 * np.max(np.abs(steps[0]))
    assert np.max(np.abs(np.array(impulses) - impulses[0])) < 1e-9 * np.max(np.abs(impulses[0]))


@pytest.mark.variants
@pytest.mark.parametrize("rule", RULES, ids="-".join)
@pytest.mark.parametrize("make", [phc.ch, phc.oh])
@pytest.mark.parametrize("d", [np.arange(1.0, 8.0), 1 + 1e-3 * np.arange(6.0), np.repeat([1.0, 2.0], 3)])
def test_the_first_steps_of_many_or_close_modes_have_their_digits_too(d, make, rule):
    """Where a short record leaves the states small beside those of the modes; against the exact coefficients."""
    sys, h, n = make(d, np.random.default_rng(0).standard_normal(2 * len(d))), 0.05, 2 * len(d)
    u = np.array([0.7, -1.3, 0.4])
    with mp.workdps(80):
        P, c = [mp.mpf(1)], [mp.mpf(0)]
        for x, kappa in zip(sys.modes.d, sys.modes.kappa, strict=True):
            x, kappa = mp.mpf(float(x)) ** 2, mp.mpf(float(kappa))
            c = [x * a + b + kappa * p for a, b, p in zip([*c, 0], [0, *c], [*P, 0], strict=True)]
            P = [x * a + b for a, b in zip([*P, 0], [0, *P], strict=True)]
        A, b, readout = mp.zeros(n), mp.zeros(n, 1), mp.zeros(n, 1)
        for k in range(n - 1):
            A[k, k + 1] = 1
        for k in range(n // 2):
            A[n - 1, 2 * k], readout[2 * k + 1] = -P[k], c[k]
        b[n - 1] = 1
        if make is phc.oh:
            A, b = A.T, readout
        rows = [[A[i, j] for j in range(n)] for i in range(n)]
        F, now, then = companion_step(Listed(rows), Listed([[b[i]] for i in range(n)]), h, *rule)
        s, truth = mp.zeros(n, 1), []
        for k in range(3):
            truth.append([float(x) for x in s])
            s = F * s + now * mp.mpf(float(u[k])) + then * mp.mpf(float(u[min(k + 1, 2)]))
        wanted = [np.array([[float(M[i, j]) for j in range(M.cols)] for i in range(n)]) for M in (F, now + F * then)]
    states = phc.forced_response(sys, h * np.arange(3), u, 0.0, method=rule[0], intersample=rule[1]).states
    assert np.all(np.abs(states.T - truth) <= 1e-9 * np.max(np.abs(truth), axis=0))
    sampled = phc.sample(sys, h, rule[0], intersample=rule[1])
    for found, exact in zip((sampled.A, sampled.B), wanted, strict=True):
        assert np.all(np.abs(found - exact) <= 4 * EPS * np.abs(exact))


class Listed:
    """Numbers with many digits where `companion_step` expects an array."""

    def __init__(self, rows):
        self.rows = rows

    def tolist(self):
        return self.rows


def test_a_record_too_long_for_exact_states_of_a_repeated_frequency_is_refused():
    sys = phc.oh(np.ones(12), np.ones(24))
    with pytest.raises(phc.StructureError, match="take fewer"):
        phc.initial_response(sys, 0.1 * np.arange(500_000), 1.0)


@pytest.mark.parametrize("rule", RULES, ids="-".join)
def test_an_affine_system_has_the_states_of_its_derivative_and_integrates_its_output(rule):
    rng = np.random.default_rng(1)
    sys = phc.affine(np.diag([0.0, 4.0, 1.0, 2.0]), [1.0, -1.0, 0.0, 0.0])
    t, u, z0 = 0.1 * np.arange(50), rng.standard_normal(50), rng.standard_normal(4)
    response = phc.forced_response(sys, t, u, z0, method=rule[0], intersample=rule[1])
    F, now, then = dense_step(sys.A, sys.B, 0.1, *rule)
    z = [z0]
    for k in range(49):
        z.append(F @ z[-1] + now[:, 0] * u[k] + then[:, 0] * u[k + 1])
    assert np.max(np.abs(response.states - np.array(z).T)) < 1e-12 * np.max(np.abs(z))
    assert np.max(np.abs(response.outputs - (np.array(z) @ sys.C.T)[:, 0])) < 1e-12 * np.max(np.abs(z))

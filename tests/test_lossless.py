"""Any lossless linear system becomes port-Hamiltonian, with its modes right; any other is refused with reasons."""

import re

import control as ct
import numpy as np
import pytest
import reference as ref
import scipy.io
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

import ph_control as phc

EPS = ref.EPS
SETTINGS = settings(deadline=None, max_examples=15, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


# --- making systems ----------------------------------------------------------------------------------------------


def separate_frequencies(n, rng):
    """n frequencies from 0.1 to 10, neighbours at least 1 % apart."""
    return 0.1 * np.exp(np.sort(rng.permutation(400)[:n]) * np.log(100) / 400)


def modal_matrices(d, nu):
    """`(A, B, C)` of modes with complex input weights (n, m), in Williamson coordinates."""
    Dhat = np.diag(np.r_[d, d])
    B = np.concatenate([nu.real, nu.imag])
    return ref.symplectic_form(len(d)) @ Dhat, B, B.T @ Dhat


def random_modes(n, m, rng):
    d = separate_frequencies(n, rng)
    nu = rng.uniform(0.3, 2, (n, m)) * np.exp(1j * rng.uniform(0, 2 * np.pi, (n, m)))
    return d, nu


def random_coordinates(A, B, C, condition, rng):
    """The same system in coordinates of a given condition number."""
    n = len(A)
    U, V = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    s = np.geomspace(1, condition, n)
    T, inverse = U * s @ V.T, V / s @ U.T
    D = np.zeros((len(C), B.shape[1]))
    return ct.StateSpace(T @ A @ inverse, T @ B, C @ inverse, D, remove_useless_states=False)


def polynomials(d, r):
    """Numerator and denominator of `sum r d s / (s^2 + d^2)`, in descending powers."""
    num, den = np.zeros(1), np.ones(1)
    for x, y in zip(d, r, strict=True):
        num = np.polyadd(np.polymul(num, [1, 0, x * x]), np.polymul(den, [x * y, 0]))
        den = np.polymul(den, [1, 0, x * x])
    return np.trim_zeros(num, "f"), den


def weights(nu):
    """The Hermitian matrices `nu^H nu` of the modes: what the transfer function shows of their weights."""
    return nu.conj()[:, :, None] * nu[:, None, :]


def errors(sys, d, nu):
    """Relative error of the frequencies, and of the weights to the largest."""
    assert len(sys.modes.rigid) == 0
    assert sys.d.shape == d.shape
    truth = weights(nu)
    return np.max(np.abs(sys.d / d - 1)), np.max(np.abs(weights(sys.modes.nu) - truth)) / np.max(np.abs(truth))


def from_r(r):
    return np.sqrt(np.asarray(r, dtype=complex))[:, None]


# --- state space -------------------------------------------------------------------------------------------------


@SETTINGS
@given(st.integers(1, 8), st.integers(1, 3), st.floats(0, 4), seeds)
def test_modes_survive_random_coordinates_to_the_accuracy_that_the_coordinates_leave(n, m, exponent, seed):
    rng = np.random.default_rng(seed)
    d, nu = random_modes(n, m, rng)
    condition = 10**exponent
    sys = phc.ph(random_coordinates(*modal_matrices(d, nu), condition, rng))
    frequency_error, weight_error = errors(sys, d, nu)
    # a backward error of n eps ||A||, seen through the coordinates, on frequencies from d[0] to d[-1]
    bound = 10 * n * EPS * condition**2 * d[-1] / d[0]
    assert frequency_error < bound
    gap = np.min(np.diff(d), initial=d[0])
    assert weight_error < 10 * bound * d[0] / gap + 100 * n * EPS
    assert sys.is_canonical


HIDDEN = {
    "stable": np.diag([-1.0, -2.0]),
    "unstable": np.diag([0.5, 3.0]),
    "repeated": -np.eye(3),
    "at rest": np.zeros((2, 2)),
    "oscillator": np.array([[0.0, 1.0], [-4.0, 0.0]]),
    "damped oscillator": np.array([[0.0, 1.0], [-4.0, -0.5]]),
    "growing motion": np.diag(np.ones(2), 1),
    "stable Jordan block": np.diag(np.ones(2), 1) - np.eye(3),
    "Jordan block of four": np.diag(np.ones(3), 1) - 2 * np.eye(4),
    "two Jordan blocks": block_diag(np.diag(np.ones(1), 1), np.diag(np.ones(1), 1)),
    "resonance": np.kron(np.eye(2), [[0.0, 1.0], [-4.0, 0.0]]) + np.diag(np.ones(2), 2),
}  # fmt: skip


@pytest.mark.variants
@pytest.mark.parametrize("seen", ["by the outputs", "by the inputs", "by nothing"])
@pytest.mark.parametrize("hidden", HIDDEN)
@pytest.mark.parametrize("ports", [1, 2])
def test_what_no_port_both_reaches_and_sees_is_taken_out(hidden, seen, ports):
    H = HIDDEN[hidden]
    for seed in range(5):
        rng = np.random.default_rng(seed)
        d, nu = random_modes(3, ports, rng)
        A, B, C = modal_matrices(d, nu)
        B_hidden, C_hidden = rng.standard_normal((len(H), ports)), rng.standard_normal((ports, len(H)))
        B = np.concatenate([B, B_hidden * (seen == "by the inputs")])
        C = np.concatenate([C, C_hidden * (seen == "by the outputs")], axis=1)
        sys = phc.ph(random_coordinates(block_diag(A, H), B, C, 30, rng))
        frequency_error, weight_error = errors(sys, d, nu)
        assert sys.n == 3
        assert frequency_error < 1e-9
        assert weight_error < 1e-7


def test_a_hidden_jordan_block_next_to_slow_modes_does_not_swallow_them():
    rng = np.random.default_rng(0)
    d, nu = np.array([0.01, 0.011, 20.0]), from_r([1.0, 1.0, 1.0])
    A, B, C = modal_matrices(d, nu)
    B = np.concatenate([B, rng.standard_normal((3, 1))])
    C = np.concatenate([C, np.zeros((1, 3))], axis=1)
    sys = phc.ph(random_coordinates(block_diag(A, np.diag(np.ones(2), 1)), B, C, 10, rng))
    assert max(errors(sys, d, nu)) < 1e-6


def test_a_hidden_mode_at_the_frequency_of_a_seen_one_leaves_it():
    rng = np.random.default_rng(3)
    A, B, C = modal_matrices(np.array([1.0, 1.0, 2.0]), from_r([0.5, 0.0, 1.0]))
    sys = phc.ph(random_coordinates(A, B, C, 10, rng))
    assert max(errors(sys, np.array([1.0, 2.0]), from_r([0.5, 1.0]))) < 1e-11


@pytest.mark.parametrize("copies", [2, 5, 24])
def test_equal_branches_act_as_one_in_any_coordinates(copies):
    rng = np.random.default_rng(copies)
    r = rng.uniform(0.1, 2, copies)
    A, B, C = modal_matrices(np.r_[np.full(copies, 2.0), 5.0], from_r(np.r_[r, 1.0]))
    for condition in (1, 10):
        sys = phc.ph(random_coordinates(A, B, C, condition, rng))
        assert max(errors(sys, np.array([2.0, 5.0]), from_r([r.sum(), 1.0]))) < 1e-10


def test_equal_frequencies_merge_into_as_many_modes_as_the_ports_show():
    rng = np.random.default_rng(4)
    d = np.array([1.0, 1.0, 1.0, 2.0])
    _, nu = random_modes(4, 2, rng)
    sys = phc.ph(random_coordinates(*modal_matrices(d, nu), 10, rng))
    assert np.allclose(sys.d, [1.0, 1.0, 2.0], rtol=1e-12)
    total = weights(nu)[:3].sum(axis=0)
    assert np.allclose(weights(sys.modes.nu)[:2].sum(axis=0), total, rtol=0, atol=1e-10 * np.abs(total).max())


@pytest.mark.parametrize("gap", [1e-3, 1e-6])
def test_clustered_frequencies_stay_apart(gap):
    rng = np.random.default_rng(5)
    d = np.array([1.0, 1.0 + gap, 1.0 + 3 * gap, 2.0])
    r = np.array([1.0, 0.5, 0.3, 0.7])
    nu = from_r(r)
    in_states = phc.ph(random_coordinates(*modal_matrices(d, nu), 10, rng))
    modes = phc.modes(d, r)
    in_factors = phc.ph(scipy.signal.ZerosPolesGain(modes.zeros, modes.poles, modes.kappa.sum()))
    for sys in (in_states, in_factors):
        frequency_error, weight_error = errors(sys, d, nu)
        assert frequency_error < 1e-12
        assert weight_error < 1e4 * EPS / gap


@pytest.mark.parametrize("time", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("amplitude", [1e-9, 1.0, 1e9])
def test_units_of_time_and_amplitude_do_not_matter(time, amplitude):
    rng = np.random.default_rng(6)
    d, nu = random_modes(4, 1, rng)
    r = np.abs(nu[:, 0]) ** 2
    scaled_d, scaled_nu = d / time, nu * np.sqrt(amplitude * time)
    modes = phc.modes(scaled_d, amplitude * time * r)
    num, den = polynomials(scaled_d, amplitude * time * r)
    for source in (
        random_coordinates(*modal_matrices(scaled_d, scaled_nu), 100, rng),
        ct.tf(num, den),
        ct.tf(1e9 * num, 1e9 * den),
        scipy.signal.ZerosPolesGain(modes.zeros, modes.poles, modes.kappa.sum()),
        ct.tf(phc.ph(modes)),
    ):
        assert max(errors(phc.ph(source), scaled_d, scaled_nu)) < 1e-9


@pytest.mark.parametrize("time", [1e-9, 1e9])
def test_units_of_time_do_not_matter_beside_a_hidden_jordan_block(time):
    rng = np.random.default_rng(7)
    d, nu = random_modes(3, 1, rng)
    A, B, C = modal_matrices(d / time, nu)
    A = block_diag(A, np.diag(np.ones(2), 1) / time)
    B = np.concatenate([B, rng.standard_normal((3, 1))])
    C = np.concatenate([C, np.zeros((1, 3))], axis=1)
    assert max(errors(phc.ph(random_coordinates(A, B, C, 30, rng)), d / time, nu)) < 1e-7


def test_states_in_very_different_units_are_balanced_first():
    rng = np.random.default_rng(8)
    d, nu = random_modes(3, 1, rng)
    A, B, C = modal_matrices(d, nu)
    units = 10.0 ** rng.uniform(-8, 8, 6)
    sys = phc.ph(ct.ss(units[:, None] * A / units, units[:, None] * B, C / units, 0))
    # without balancing, 16 orders of magnitude would leave nothing
    assert max(errors(sys, d, nu)) < 1e-10


# --- coordinates -------------------------------------------------------------------------------------------------


@SETTINGS
@given(st.lists(st.floats(0, 10), min_size=1, max_size=4), st.integers(1, 2), seeds)
def test_a_state_space_in_normal_form_keeps_its_coordinates(d, m, seed):
    rng = np.random.default_rng(seed)
    Q, _ = ref.random_hamiltonian([x if x > 0.1 else 0.0 for x in d], rng)
    B = rng.standard_normal((2 * len(d), m))
    A = ref.symplectic_form(len(d)) @ Q
    names = {"states": [f"z{i}" for i in range(len(Q))], "inputs": [f"f{i}" for i in range(m)], "name": "given"}
    sys = phc.ph(ct.StateSpace(A, B, B.T @ Q, np.zeros((m, m)), remove_useless_states=False, **names))
    assert np.array_equal(sys.Q, Q)
    assert np.array_equal(sys.B, B)
    assert (sys.state_labels, sys.input_labels, sys.name) == (names["states"], names["inputs"], "given")


def test_also_a_normal_form_that_is_not_minimal_keeps_its_coordinates():
    Q, B = np.diag([4.0, 1.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 0.0]
    assert np.array_equal(phc.ph(ct.ss(phc.ph(Q, B))).Q, Q)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda A, B, C, D: (A, 2 * B, C, D),
        lambda A, B, C, D: (A, B, 2 * C, D),
        lambda A, B, C, D: (2 * A, B, C, D),
        lambda A, B, C, D: (A[::-1, ::-1], B[::-1], C[:, ::-1], D),
    ],
)
def test_any_other_lossless_state_space_arrives_in_williamson_coordinates(spoil):
    sys = phc.ph([[4.0, 1.0], [1.0, 2.0]], [1.0, 1.0])
    other = ct.ss(*spoil(sys.A, sys.B, sys.C, sys.D), states=["q", "p"])
    converted = phc.ph(other)
    assert np.array_equal(converted.Q, np.diag([converted.d[0], converted.d[0]]))
    assert converted.state_labels == ["x[0]", "x[1]"]
    for s in (1j, 1.0, 0.5 - 2j):
        assert converted(s) == pytest.approx(other(s), rel=100 * EPS)


def test_a_matrix_of_negative_energy_is_not_taken_for_a_normal_form():
    Q, B = np.diag([-4.0, -1.0]), np.array([[0.0], [1.0]])
    with pytest.raises(phc.NotLosslessError, match=r"pole 0\+2i: residue -0.5 is negative"):
        phc.ph(ct.ss(ref.symplectic_form(1) @ Q, B, B.T @ Q, 0))


def test_a_system_without_a_timebase_is_continuous():
    assert phc.ph(ct.ss([[0, 2], [-2, 0]], [[0], [1]], [[0, 2]], 0, None)).dt == 0
    assert phc.ph(ct.tf([2, 0], [1, 0, 4], None)).d[0] == pytest.approx(2, rel=4 * EPS)


# --- transfer functions ------------------------------------------------------------------------------------------


@SETTINGS
@given(st.integers(1, 5), seeds)
def test_modes_survive_polynomials_products_and_foreign_state_spaces(n, seed):
    rng = np.random.default_rng(seed)
    d, nu = random_modes(n, 1, rng)
    r = np.abs(nu[:, 0]) ** 2
    modes = phc.modes(d, r)
    zpk = (modes.zeros, modes.poles, modes.kappa.sum())
    A, B, C = modal_matrices(d, nu)
    sources = {
        "ct.tf of a PH system": ct.tf(phc.ph(modes)),
        "ct.tf": ct.tf(*polynomials(d, r)),
        "scipy.signal.TransferFunction": scipy.signal.TransferFunction(*polynomials(d, r)),
        "ct.zpk": ct.zpk(*zpk),
        "sum of fractions": sum(ct.tf([x * y, 0], [1, 0, x * x]) for x, y in zip(d, r, strict=True)),
        "scipy.signal.ZerosPolesGain": scipy.signal.ZerosPolesGain(*zpk),
        "scipy.signal.StateSpace": scipy.signal.StateSpace(A, B, C, np.zeros((1, 1))),
    }
    gap = np.min(np.diff(d) / d[1:], initial=1.0)
    for name, source in sources.items():
        sys = phc.ph(source)
        assert type(sys) is phc.PortHamiltonian
        # rounding of 2n coefficients moves roots by eps times products of gaps; products and states lose less
        exact = name in ("scipy.signal.ZerosPolesGain", "scipy.signal.StateSpace")
        assert max(errors(sys, d, nu)) < (1e3 * EPS / gap if exact else 1e5 * EPS / gap ** min(n - 1, 2)), name


@pytest.mark.parametrize(
    "factor",
    [[1, 1], [1, -1], [1, 0], [1, 2, 1], [1, 0, 2], [1, 3, 3, 1], [1, -1, 4, -4]],
    ids=lambda factor: str(np.poly1d(factor)).replace("\n", " "),
)
def test_common_factors_of_numerator_and_denominator_cancel(factor):
    d, r = np.array([1.0, 3.0]), np.array([0.5, 0.25])
    num, den = polynomials(d, r)
    sys = phc.ph(ct.tf(np.polymul(num, factor), np.polymul(den, factor)))
    assert max(errors(sys, d, from_r(r))) < 1e-9


def test_common_zeros_and_poles_cancel():
    sys = phc.ph(scipy.signal.ZerosPolesGain([0, -1, -1, 2, 3j, -3j], [1j, -1j, -1, -1, 2, 3j, -3j], 2.0))
    assert max(errors(sys, np.array([1.0]), from_r([2.0]))) < 100 * EPS


def two_port_polynomials(d, nu):
    """Numerators and denominators of the entries of a two-port with its poles shared among them."""
    num = [[np.zeros(1) for _ in range(2)] for _ in range(2)]
    den = np.ones(1)
    for x, R in zip(d, weights(nu), strict=True):
        for i in range(2):
            for j in range(2):
                # d (Re R s + Im R d) / (s^2 + d^2)
                mode = np.polymul(den, [x * R[i, j].real, x * x * R[i, j].imag])
                num[i][j] = np.polyadd(np.polymul(num[i][j], [1, 0, x * x]), mode)
        den = np.polymul(den, [1, 0, x * x])
    return num, [[den, den], [den, den]]


def test_a_two_port_transfer_function_keeps_its_modes_and_all_its_entries():
    d, nu = random_modes(3, 2, np.random.default_rng(9))
    num, den = two_port_polynomials(d, nu)
    source = ct.tf(num, den)
    s = 0.3 + 0.8j
    A, B, C = modal_matrices(d, nu)
    assert np.allclose(source(s), ref.dense_transfer_function(A, B, C, s), rtol=1e-11)
    sys = phc.ph(source)
    assert max(errors(sys, d, nu)) < 1e-10
    assert np.allclose(sys(s), source(s), rtol=1e-10)


def test_a_diagonal_two_port_transfer_function_has_the_modes_of_both_ports():
    sys = phc.ph(ct.tf([[[2, 0], [0]], [[0], [3, 0]]], [[[1, 0, 4], [1]], [[1], [1, 0, 9]]]))
    assert np.allclose(sys.d, [2, 3], rtol=8 * EPS)
    assert np.allclose(sys.r, [[1, 0], [0, 1]], rtol=0, atol=8 * EPS)


# --- poles at zero and no poles ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "source",
    [
        ct.tf([3.0], [1.0, 0.0]),
        ct.tf([6.0], [2.0, 0.0]),
        ct.tf([3.0, 0.0], [1.0, 0.0, 0.0]),
        ct.zpk([], [0], 3.0),
        scipy.signal.ZerosPolesGain([], [0], 3.0),
        ct.ss([[0.0]], [[1.5]], [[2.0]], 0),
        ct.ss([[0, 1], [0, 0]], [[0], [1]], [[0, 3]], 0),
        ct.ss([[0, 0], [5, 0]], [[3], [1]], [[1, 0]], 0),
    ],
    ids=range(8),
)
def test_a_free_mass_is_accepted_with_its_pole_at_zero(source):
    sys = phc.ph(source)
    assert (sys.n, len(sys.d)) == (1, 0)
    assert sys.modes.kappa_0 == pytest.approx(3.0, rel=16 * EPS)
    assert sys(2.0) == pytest.approx(1.5, rel=16 * EPS)
    assert np.isinf(sys(0))


@SETTINGS
@given(st.integers(1, 4), seeds)
def test_a_rigid_body_mode_is_found_beside_oscillating_ones_in_random_coordinates(n, seed):
    rng = np.random.default_rng(seed)
    d, nu = random_modes(n, 1, rng)
    A, B, C = modal_matrices(d, nu)
    # position and momentum of a free mass
    A = block_diag(A, [[0.0, 1.0], [0.0, 0.0]])
    B = np.concatenate([B, [[0.0], [1.0]]])
    C = np.concatenate([C, [[0.0, 1.5]]], axis=1)
    sys = phc.ph(random_coordinates(A, B, C, 10, rng))
    assert sys.n == n + 1
    assert np.allclose(sys.d, d, rtol=1e-9)
    assert np.allclose(sys.r, np.abs(nu[:, 0]) ** 2, rtol=1e-7)
    assert sys.modes.kappa_0 == pytest.approx(1.5, rel=1e-7)


def test_a_rigid_two_port_keeps_its_residue_matrix():
    R = np.array([[2.0, 1.0], [1.0, 3.0]])
    sys = phc.ph(ct.ss(np.zeros((2, 2)), R, np.eye(2), np.zeros((2, 2))))
    assert sys.n == 2
    assert np.allclose(sys.modes.kappa_0, R, rtol=16 * EPS)


@pytest.mark.parametrize(
    "source",
    [
        ct.tf([0], [1, 2, 1]),
        ct.tf([0], [1]),
        ct.ss([], [], [], [[0.0]]),
        ct.ss([[-1.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[0.0, 0.0]], 0, remove_useless_states=False),
        ct.ss([[-1.0, 0.0], [0.0, 2.0]], [[1.0], [0.0]], [[0.0, 1.0]], 0, remove_useless_states=False),
        scipy.signal.ZerosPolesGain([], [-1], 0.0),
    ],
    ids=range(6),
)
def test_no_transfer_function_is_a_system_without_states(source):
    sys = phc.ph(source)
    assert (sys.n, sys.nstates, sys.ninputs) == (0, 0, 1)
    assert sys(1.0) == 0


def test_a_two_port_that_shows_nothing_keeps_its_ports():
    sys = phc.ph(ct.ss(-np.eye(2), np.eye(2), np.zeros((2, 2)), np.zeros((2, 2)), remove_useless_states=False))
    assert (sys.nstates, sys.ninputs) == (0, 2)
    assert np.array_equal(sys(1.0), np.zeros((2, 2)))


# --- refusals ----------------------------------------------------------------------------------------------------


def violations(source):
    with pytest.raises(phc.NotLosslessError) as caught:
        phc.ph(source, lossless=True)
    return caught.value.violations


def in_states(numerator, denominator, seed=0):
    """In random coordinates, so that the decision has no help from zeros in the matrices."""
    sys = ct.tf2ss(ct.tf(numerator, denominator))
    T = np.linalg.qr(np.random.default_rng(seed).standard_normal((sys.nstates, sys.nstates)))[0]
    return ct.similarity_transform(sys, T)


OFF = "is off the imaginary axis: real part"
TWICE = r"is repeated: coefficient of 1/\(s - pole\)\^2 is"
NOT_LOSSLESS = [
    ("unstable", [1, 0], [1, -0.2, 1], [rf"pole 0\.1\+0\.99498\d*i {OFF} 0\.1, .*\(unstable\)"]),
    ("damped", [1, 0], [1, 0.2, 1], [rf"pole -0\.1\+0\.99498\d*i {OFF} -0\.1, .*\(damped\)"]),
    ("lightly damped", [1, 0], [1, 2e-9, 1], [rf"pole -1e-09\+1i {OFF} -1e-09, .*\(damped\)"]),
    ("first order", [1], [1, 5], [rf"pole -5[+-]0i {OFF} -5, .*\(damped\)"]),
    ("saddle", [1, 0], [1, 0, -4], [rf"pole [+-]?2[+-].*i {OFF} -?2, "] * 2),
    (
        "negative residue",
        [-3, 0],
        [1, 0, 4],
        [r"pole .*\+2i: residue -1\.5 is negative, allowed >= -\d.*: not passive"],
    ),
    ("one negative residue", [1, 0, 16, 0], [1, 0, 5, 0, 4], [r"pole .*\+2i: residue -2 is negative, "]),
    ("negative integrator", [-2], [1, 0], [r"pole .*0i: residue -2 is negative, "]),
    ("even", [1], [1, 0, 1], [r"pole .*\+1i: residue .*-0\.5i is not real: off by 0\.5, allowed \d"]),
    ("mixed", [1, 1], [1, 0, 1], [r"pole .*\+1i: residue 0\.5-0\.5i is not real: off by 0\.5, allowed \d"]),
    ("repeated", [1, 0], [1, 0, 2, 0, 1], [rf"pole .*\+1i {TWICE} 0\.25, allowed \d"]),
    ("double integrator", [1], [1, 0, 0], [rf"pole .*0i {TWICE} 1, allowed \d"]),
    ("integrator and more", [1, 1], [1, 0, 0], [rf"pole .*0i {TWICE} 1, allowed \d"]),
    ("feedthrough", [1, 1, 1], [1, 0, 1], [r"feedthrough D = 1, allowed 0 within \d.*: .* strictly proper"]),
]


@pytest.mark.parametrize("route", [ct.tf, in_states], ids=["polynomials", "states"])
def test_a_displacement_and_a_wrong_sign_are_recognised_and_a_mixture_is_not(route):
    (displacement,), (mixture,) = violations(route([1], [1, 0, 1])), violations(route([1, 1], [1, 0, 1]))
    assert displacement.endswith("; imaginary, as that of a displacement (see affine) or an acceleration")
    assert "displacement" not in mixture
    (reversed_sign,) = violations(route([-1, 0], [1, 0, 1]))
    assert reversed_sign.endswith("not passive, the sensor away from the actuator or of the wrong sign")


@pytest.mark.parametrize("route", [ct.tf, in_states], ids=["polynomials", "states"])
@pytest.mark.parametrize(("what", "num", "den", "expected"), NOT_LOSSLESS, ids=[row[0] for row in NOT_LOSSLESS])
def test_what_is_not_lossless_is_refused_with_each_offence_its_size_and_the_tolerance(what, num, den, expected, route):
    found = violations(route(num, den))
    assert len(found) == len(expected)
    for sentence, pattern in zip(found, expected, strict=True):
        # rounding may leave a real or imaginary part of 1e-17
        assert re.match(pattern, sentence), sentence
        # the tolerance is far below the size
        allowed = float(re.search(r"(?:allowed|within)(?: 0 within)?(?: >=)? -?([\d.e+-]+[\d])", sentence)[1])
        assert allowed < 1e-11


@pytest.mark.parametrize(
    "what", [row[:3] for row in NOT_LOSSLESS if row[0] not in ("feedthrough",)], ids=lambda row: row[0]
)
def test_what_is_not_lossless_is_refused_also_from_zeros_and_poles(what):
    name, num, den = what
    num = np.trim_zeros(np.array(num, float), "f")
    found = violations(scipy.signal.ZerosPolesGain(np.roots(num), np.roots(den), num[0]))
    expected = {"un": "unstable", "da": "damped", "li": "damped", "fi": "damped", "sa": "off the", "on": "negative"}
    expected |= {"ne": "negative", "ev": "not real", "mi": "not real", "re": "", "do": "repeated", "in": "repeated"}
    assert all(expected[name[:2]] in sentence for sentence in found)


def test_two_exactly_equal_factors_are_a_repeated_pole():
    (sentence,) = violations(scipy.signal.ZerosPolesGain([0.0], [1j, 1j, -1j, -1j], 1.0))
    assert sentence.startswith("pole 0+1i is repeated: coefficient of 1/(s - pole)^2 is 0.25, allowed ")


@pytest.mark.parametrize(
    ("source", "degrees"),
    [
        (ct.tf([1, 0, 0, 0], [1, 0, 1]), "numerator of degree 3 over degree 2"),
        (ct.tf([1, 0], [2]), "numerator of degree 1 over degree 0"),
        (scipy.signal.TransferFunction([1, 0, 0, 0], [1, 0, 1]), "numerator of degree 3 over degree 2"),
    ],
)
def test_an_improper_transfer_function_is_refused(source, degrees):
    assert violations(source) == (f"the transfer function is improper: {degrees}, expected less",)


def test_an_improper_zero_pole_gain_system_is_refused():
    found = violations(scipy.signal.ZerosPolesGain([0, 0, 0], [1j, -1j], 1.0))
    assert found == ("the system is improper: 3 zeros over 2 poles, expected less",)


def test_a_constant_is_refused_and_a_zero_feedthrough_is_not():
    assert violations(ct.tf([2], [1]))[0].startswith("feedthrough D = 2, allowed 0 within 0.0e+00")
    sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    assert violations(ct.ss(sys) + 1e-9)[0].startswith("feedthrough D = 1e-09, allowed 0 within ")
    assert phc.ph(sys + 0.0).n == 1


@pytest.mark.parametrize("dt", [0.1, True])
def test_a_sampled_system_is_refused_without_the_method_of_sampling(dt):
    expected = (
        f"the system is discrete-time (dt = {dt}), expected continuous time; pass the method by which it was sampled: "
        "ph(sys, method='exact'), 'midpoint' or 'euler'",
    )
    assert violations(ct.tf([1, 0], [1, 0, 1], dt)) == expected
    assert violations(ct.ss([[0, 1], [-1, 0]], [[0], [1]], [[0, 1]], 0, dt)) == expected
    (found,) = violations(scipy.signal.dlti([1, 0], [1, 0, 1], dt=dt))
    assert found == (
        f"the system is discrete-time (dt = {dt}); give it as a control.StateSpace, with how it was sampled"
    )


def test_a_system_with_more_inputs_than_outputs_is_refused():
    sys = ct.ss([[0, 1], [-1, 0]], np.eye(2), [[0, 1]], [[0, 0]])
    assert violations(sys) == ("the system has 2 inputs and 1 outputs, expected as many of both: each pair is a port",)
    assert violations(ct.tf(sys)) == violations(sys)


@pytest.mark.parametrize(
    ("B", "C", "expected"),
    [
        (np.eye(2), [[0, 1], [1, 0]], r"pole .*\+1i: residue matrix .* is not Hermitian: off by 0.5, allowed \d"),
        (
            np.eye(2),
            -np.eye(2),
            r"pole .*\+1i: smallest eigenvalue of the residue matrix -1 is negative, allowed >= -\d",
        ),
    ],
)
def test_a_two_port_of_crossed_or_negative_residues_is_refused(B, C, expected):
    sys = ct.ss([[0, 1], [-1, 0]], B, C, np.zeros((2, 2)))
    assert re.match(expected, violations(sys)[0]), violations(sys)


def test_a_two_port_of_positive_diagonal_and_indefinite_residues_is_refused():
    sys = ct.ss(np.zeros((2, 2)), np.eye(2), [[1, 2], [2, 1]], np.zeros((2, 2)))
    (sentence,) = violations(sys)
    assert "smallest eigenvalue of the residue matrix -1 is negative" in sentence


@SETTINGS
@given(st.integers(1, 5), st.floats(-9, 0), st.booleans(), seeds)
def test_damping_of_a_billionth_of_one_mode_is_seen_in_random_coordinates(n, exponent, sign, seed):
    rng = np.random.default_rng(seed)
    d, nu = random_modes(n, 1, rng)
    A, B, C = modal_matrices(d, nu)
    A[0, 0] = A[n, n] = (1 if sign else -1) * 10**exponent * d[0]
    found = violations(random_coordinates(A, B, C, 10, rng))
    kind = "unstable" if sign else "damped"
    assert len(found) == 1
    assert f"{kind})" in found[0]


@SETTINGS
@given(st.integers(2, 5), st.floats(-9, 0), seeds)
def test_a_negative_residue_of_a_billionth_of_the_others_is_seen_in_random_coordinates(n, exponent, seed):
    rng = np.random.default_rng(seed)
    d, nu = random_modes(n, 1, rng)
    A, B, C = modal_matrices(d, nu)
    size = 10 ** (exponent / 2)
    B[[0, n]] *= size
    C[:, [0, n]] *= -size
    (sentence,) = violations(random_coordinates(A, B, C, 3, rng))
    assert "is negative" in sentence


def test_both_sides_of_the_bound_on_damping():
    def damped(amount):
        return ct.ss([[-amount, 1.0], [-1.0, -amount]], [[1.0], [0.0]], [[1.0, 0.0]], 0)

    (sentence,) = violations(damped(1e-9))
    allowed = float(re.search(r"allowed ([\d.e-]+\d)", sentence)[1])
    assert phc.ph(damped(0.9 * allowed)).n == 1
    assert "damped" in violations(damped(1.2 * allowed))[0]


def test_both_sides_of_the_bound_on_a_negative_residue():
    def with_residue(small):
        return ct.tf([1.0, 0], [1, 0, 1]) + ct.tf([small, 0], [1, 0, 4])

    (sentence,) = violations(with_residue(-1e-6))
    # residues are halves of the coefficients
    allowed = 2 * float(re.search(r"allowed >= -([\d.e-]+\d)", sentence)[1])
    assert phc.ph(with_residue(-0.5 * allowed)).n == 1
    assert phc.ph(with_residue(0.5 * allowed)).n == 1
    assert phc.ph(with_residue(2 * allowed)).n == 2
    assert "negative" in violations(with_residue(-2 * allowed))[0]


def test_a_negative_mode_behind_a_positive_one_of_the_same_frequency_is_no_offence():
    sys = ct.ss(block_diag([[0, 1], [-1, 0]], [[0, 1], [-1, 0]]), [[0], [2], [0], [1]], [[0, 2, 0, -1]], 0)
    assert max(errors(phc.ph(sys), np.array([1.0]), from_r([3.0]))) < 100 * EPS


# --- structures --------------------------------------------------------------------------------------------------


def benchmark(data_folder, name):
    model = scipy.io.loadmat(data_folder / "models" / f"{name}.mat")
    A, B, C = (model[key].toarray() if scipy.sparse.issparse(model[key]) else model[key] for key in "ABC")
    return A.astype(float), B.astype(float), C.astype(float)


def test_the_building_without_damping_is_lossless_with_the_modes_of_a_dense_symmetric_eigenproblem(data_folder):
    A, B, C = benchmark(data_folder, "build")
    n = 24
    assert np.array_equal(A[:n, n:], np.eye(n))
    A[n:, n:] = 0
    sys = phc.ph(ct.ss(A, B, C, 0))
    assert sys.n == 24
    # x'' = -K x + b u, y = c x' by eigenvectors of K alone: residues are c V W^H b
    x, V = np.linalg.eig(-A[n:, :n])
    W = np.linalg.inv(V)
    order = np.argsort(x.real)
    kappa = ((C[0, n:] @ V) * (W @ B[n:, 0]))[order]
    assert np.max(np.abs(x.imag)) == 0
    assert np.allclose(sys.d, np.sqrt(x[order].real), rtol=1e-10)
    assert np.max(np.abs(sys.modes.kappa - kappa.real)) < 1e-9 * np.max(kappa.real)
    for w in (1.0, 5.2, 30.0):
        assert sys(1j * w + 0.1) == pytest.approx(ref.dense_transfer_function(A, B, C, 1j * w + 0.1)[0, 0], rel=1e-9)


def test_the_building_with_its_damping_is_refused_for_every_pole(data_folder):
    A, B, C = benchmark(data_folder, "build")
    found = violations(ct.ss(A, B, C, 0))
    assert len(found) == 24
    poles = np.linalg.eigvals(A)
    assert np.all(poles.real < 0)
    named = sorted(
        float(re.match(r"pole .*\+([\d.]+)i is off the imaginary axis: .*\(damped\)", text)[1]) for text in found
    )
    assert np.allclose(named, np.sort(poles.imag[poles.imag > 0]), rtol=1e-5)


def test_the_compact_disc_player_is_refused_for_its_damping_and_without_it_for_its_residues(data_folder):
    A, B, C = benchmark(data_folder, "CDplayer")
    found = violations(ct.ss(A, B, C, np.zeros((2, 2))))
    assert all("off the imaginary axis" in text and "(damped)" in text for text in found)
    # modes in blocks of two states, weakly damped: put each on the axis
    undamped = 0.5 * (A - A.T)
    found = violations(ct.ss(undamped, B, C, np.zeros((2, 2))))
    assert any("not Hermitian" in text or "negative" in text for text in found)
    assert not any("off the imaginary axis" in text for text in found)


# --- units of the states -------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("decades", [3, 6, 9])
@pytest.mark.parametrize("rigid", [False, True])
def test_the_units_of_the_states_do_not_matter(decades, rigid):
    rng = np.random.default_rng(decades)
    for _ in range(20):
        d = rng.uniform(0.5, 3.0, 3)
        Q = np.diag([0.0, d[1], d[2], 1.0, d[1], d[2]]) if rigid else ref.random_hamiltonian(d, rng, 0.5)[0]
        A, B, C = ref.dense_matrices(Q, rng.standard_normal(6))
        truth = ref.dense_transfer_function(A, B, C, 0.3 + 0.5j)[0, 0]
        unit = 10 ** rng.uniform(-decades, decades, 6)
        sys = phc.ph(ct.ss(A * unit[:, None] / unit, B * unit[:, None], C / unit, 0))
        assert sys.n == 3 and abs(sys(0.3 + 0.5j) - truth) < 1e-9 * abs(truth)


@pytest.mark.parametrize(
    ("A", "B", "C"),
    [
        ([[0, 1.0], [-4e18, 0]], [0, 1.0], [0, -0.5]),
        ([[0, 1.0], [-4e18, -3.0]], [0, 1.0], [0, 1.0]),
        ([[0, 1e-9], [-4e9, 0]], [0, 1e7], [1e-3, 0]),
        (np.diag([1e15, 1.0], 2) - np.diag([1e15, 1.0], -2), [1.0, 1, 0, 0], [1e15, -1.0, 0, 0]),
        ([[0, 1.0, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1e5], [0, 0, 0, 0]], [1.0, 0, 0, 1], [1.0, 0, 0, -0.5]),
        ([[-0.01, 1.0, 0, 0], [-1, -0.01, 0, 0], [0, 0, 0, 1e5], [0, 0, 0, 0]], [1.0, 0, 0, 1], [1.0, 0, 0, 1.0]),
    ],
    ids=["negative", "damped", "even", "a slow negative one", "negative at 0", "damped beside a rigid body"],
)
def test_a_large_entry_hides_no_offence_in_the_others(A, B, C):
    with pytest.raises(phc.NotLosslessError):
        phc.ph(ct.ss(A, np.reshape(B, (-1, 1)), np.reshape(C, (1, -1)), 0), lossless=True)


def test_a_gain_that_is_not_that_of_the_normal_form_is_kept():
    sys = ct.ss([[0, 1.0], [-4e18, 0]], [[0], [1.0]], [[0, 0.5]], 0)
    assert abs(phc.ph(sys)(1e9j) / (0.5 * 1e9j / (4e18 - 1e18)) - 1) < 1e-14


@pytest.mark.parametrize("mass", [1e-4, 1e-5, 1e-7])
def test_a_light_free_mass_beside_an_oscillator_is_kept_apart(mass):
    A = [[0, 1.0, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1 / mass], [0, 0, 0, 0]]
    sys = phc.ph(ct.ss(A, [[1.0], [0], [0], [1.0]], [[1.0, 0, 0, 1.0]], 0))
    assert sys.n == 2 and abs(sys.d[0] - 1) < 1e-14 and abs(sys.modes.kappa_0 - 1) < 1e-14


@pytest.mark.parametrize("scale", [1e-9, 1e-5, 1.0, 1e5, 1e9])
@pytest.mark.parametrize("method", ["exact", "midpoint", "euler"])
def test_a_sampled_canonical_form_comes_back_at_every_scale_of_time(scale, method):
    sys = phc.ch(np.array([0.0, 2, 1, 2]) * scale, [0, 0, 1.0, 1.0])
    back = phc.ph(phc.sample(sys, 0.1 / scale, method), method=method)
    s = 1j * scale
    assert back.n == 2 and abs(back(s) / sys(s) - 1) < 1e-8


@pytest.mark.variants
@pytest.mark.parametrize("gap", [1e-13, 1e-12, 3e-12, 1e-11, 1e-10])
def test_frequencies_that_nearly_coincide_are_not_called_active(gap):
    answered = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        Q, _ = ref.random_hamiltonian([0.78, 0.78 * (1 + gap), 4.0], rng, 1.0)
        sys = phc.ph(Q, rng.standard_normal(6))
        T = np.linalg.qr(rng.standard_normal((6, 6)))[0]
        s = 0.3 + 0.5j
        plain = ct.ss(T @ sys.A @ T.T, T @ sys.B, sys.C @ T.T, 0)
        sampled = {"method": "exact"}, phc.sample(sys, 0.1)
        for options, other in (({}, plain), sampled):
            try:
                found = phc.ph(other, **options)
            except phc.NotLosslessError:
                raise
            except phc.StructureError as refusal:
                # just beyond what rounding leaves together neither answer is safe
                assert "too ill-conditioned to tell" in str(refusal)
                continue
            answered += 1
            assert abs(found(s) / sys(s) - 1) < 1e-9
    assert answered >= 16

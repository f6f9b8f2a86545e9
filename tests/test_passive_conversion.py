"""`ph` of passive systems: exact, with the energy that is asked for, against dense matrices and a closed form."""

from __future__ import annotations

import copy
import pickle
import warnings

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from passive_systems import measured, passive_system
from scipy.linalg import block_diag, qr
from test_passivity import crosses_in_50_digits, drawn, modal_system

import ph_control as phc

SEEDS = given(seed=st.integers(0, 2**31))
STORAGES = ("auto", "available", "required", "mean")


def converted(system, **options):
    """The form, and how many digits its conversion says it has: 10, or fewer with a warning."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        form = phc.ph(system, **options)
    assert {warning.category for warning in told} <= {phc.ConditioningWarning}
    return form, max(1e-10, form.conversion.error if told else 0.0)


@pytest.mark.variants
@pytest.mark.parametrize("storage", STORAGES)
@settings(max_examples=13, deadline=None, derandomize=True)
@SEEDS
def test_every_passive_system_has_an_exact_form(storage, seed):
    system, _ = passive_system(seed, states=12)
    form, allowed = converted(system, storage=storage)
    found = measured(form, system)
    assert found["transfer"] <= 10 * allowed and found["losses"] >= -1e-12 and found["energy"] > 0 and found["skew"]
    if form.is_lossless:
        return
    assert phc.ph(form.Q, form.G, R=form.R, P=form.P, S=form.S, N=form.N, J=form.J).nstates == form.nstates
    assert form.conversion.hidden == system.nstates - form.nstates


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(3))
def test_a_hundred_states_and_six_ports(seed):
    system, _ = passive_system(seed, states=100, hidden=False)
    form, allowed = converted(system)
    found = measured(form, system)
    assert found["transfer"] <= 10 * allowed and found["losses"] >= -1e-12 and found["energy"] > 0


def test_seventy_states_that_hardly_lose_energy_at_rest_are_not_refused():
    # where no state is left out, no digit is
    system, _ = passive_system(70011, states=200)
    form, _ = converted(system)
    assert form.nstates == 70 and measured(form, system)["transfer"] <= 1e-10


@pytest.mark.slow
@settings(max_examples=20, deadline=None, derandomize=True)
@SEEDS
def test_what_is_active_is_refused_with_the_bands_of_passivity(seed):
    poles, residues, D = drawn(np.random.default_rng(seed))
    system = modal_system(poles, residues, D)
    report = phc.passivity(system)
    if report.is_passive:
        converted(system)
        return
    with pytest.raises(phc.NotPassiveError) as caught:
        phc.ph(system)
    np.testing.assert_allclose(np.ravel(caught.value.bands), np.ravel(report.bands), rtol=1e-9)
    np.testing.assert_allclose(caught.value.sizes, report.sizes, rtol=1e-6)
    assert len(caught.value.violations) == len(report.bands)


def test_the_bands_of_a_refusal_are_right_to_eight_digits():
    ends = 0
    for seed in range(30, 45):
        poles, residues, D = drawn(np.random.default_rng(seed))
        try:
            converted(modal_system(poles, residues, D))
        except phc.NotPassiveError as error:
            inner = [end for band in error.bands for end in band if 0 < end < np.inf]
            assert all(crosses_in_50_digits(poles, residues, D, end) for end in inner), seed
            ends += len(inner)
    assert ends > 10


@pytest.mark.parametrize(
    ("system", "signs", "advice"),
    [
        (ct.tf([-1.0, 0.0], [1.0, 0.1, 4.0]), (-1,), r"ph\(-sys\)"),
        (ct.tf([1.0], [1.0, 0.1, 4.0]), (), "ports="),
        (ct.ss(-np.eye(2), np.eye(2), np.diag([1.0, -1.0]), np.zeros((2, 2))), (1, -1), "output 1"),
        (ct.tf([1.0], [1.0, -1.0]), (), "right half plane"),
        (ct.tf([1.0], [1.0, 0.0, 0.0]), (), "repeated"),
    ],
)
def test_a_refusal_says_what_to_do(system, signs, advice):
    with pytest.raises(phc.NotPassiveError, match=advice) as caught:
        phc.ph(system)
    error = caught.value
    assert error.signs == signs and isinstance(error, phc.StructureError)
    twin = pickle.loads(pickle.dumps(error))
    assert (str(twin), twin.bands, twin.signs) == (str(error), error.bands, error.signs)


# --- which energy -------------------------------------------------------------------------------------------------


def structure(seed, n=4, ports=2, damping="general"):
    """Mass, damping and stiffness matrices and the places of forces."""
    rng = np.random.default_rng(seed)
    M, K, C = (root @ root.T + 0.1 * np.eye(n) for root in rng.normal(size=(3, n, n)))
    C = 0.1 * C if damping == "general" else 0.02 * K + 0.05 * M
    return M, C, K, rng.normal(size=(n, ports))


@pytest.mark.parametrize("coordinates", ["velocities", "momenta", "velocities first"])
@pytest.mark.parametrize("seed", range(5))
def test_matrices_of_mass_damping_and_stiffness_keep_their_energy(coordinates, seed):
    M, C, K, F = structure(seed)
    n, zero = len(M), np.zeros((len(M), len(M)))
    none, inverse = np.zeros_like(F), np.linalg.inv(M)
    if coordinates == "momenta":
        A = np.block([[zero, inverse], [-K, -C @ inverse]])
        system, energy = ct.ss(A, np.vstack([none, F]), np.vstack([none, inverse @ F]).T, 0), block_diag(K, inverse)
    else:
        A = np.block([[zero, np.eye(n)], [-inverse @ K, -inverse @ C]])
        system, energy = ct.ss(A, np.vstack([none, inverse @ F]), np.vstack([none, F]).T, 0), block_diag(K, M)
    if coordinates == "velocities first":
        order = np.roll(np.arange(2 * n), n)
        system = ct.ss(A[np.ix_(order, order)], system.B[order], system.C[:, order], 0)
        energy = energy[np.ix_(order, order)]
    form = phc.ph(system)
    assert form.conversion.energy == "given" and form.conversion.hidden == 0
    np.testing.assert_allclose(form.Q, energy, atol=1e-9 * np.abs(energy).max())
    np.testing.assert_allclose(form.A, system.A, atol=1e-9 * np.abs(system.A).max())
    x = np.random.default_rng(seed).normal(size=2 * n)
    assert form.hamiltonian(x) == pytest.approx(0.5 * x @ energy @ x, rel=1e-8)


@pytest.mark.parametrize("free", [False, True])
def test_a_long_chain_keeps_its_masses_and_springs(free):
    """Sixty masses, driven at the end: only the first few can be told from the port alone."""
    rng = np.random.default_rng(0)
    n = 60
    mass, spring = rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n)
    bonds = np.eye(n) - np.eye(n, k=-1)
    if free:
        bonds, spring = bonds[1:], spring[1:]
    K, C = bonds.T @ np.diag(spring) @ bonds, bonds.T @ np.diag(0.1 * rng.uniform(size=len(bonds))) @ bonds
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / mass[:, None], -C / mass[:, None]]])
    port = np.eye(2 * n)[:, [-1]]
    form = phc.ph(ct.ss(A, port / mass[-1], port.T, 0))
    assert form.conversion.energy == "given" and form.conversion.hidden == 0
    np.testing.assert_allclose(form.Q, block_diag(K, np.diag(mass)), atol=1e-12)
    np.testing.assert_allclose(form.R[n:, n:], C / np.outer(mass, mass), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_classical_damping_is_given_by_modes(seed):
    M, C, K, F = structure(seed, damping="classical")
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ K, -inverse @ C]])
    T = qr(np.random.default_rng(seed).normal(size=(8, 8)))[0]
    B, rows = np.vstack([np.zeros_like(F), inverse @ F]), np.vstack([np.zeros_like(F), F]).T
    form = phc.ph(ct.ss(T @ A @ T.T, T @ B, rows @ T.T, 0))
    assert form.conversion.energy == "modal"
    d = np.sort(np.sqrt(np.linalg.eigvals(inverse @ K).real))
    np.testing.assert_allclose(np.diag(form.Q), np.r_[d, d], rtol=1e-9)
    np.testing.assert_allclose(np.diag(form.R), np.r_[np.zeros(4), 0.02 * d + 0.05 / d], rtol=1e-8, atol=1e-12)
    assert not (form.R - np.diag(np.diag(form.R))).any() and not form.P.any()


def test_an_overdamped_mode_and_a_dashpot_on_a_free_mass_are_classical():
    terms = [([2.0, 0.0], [1.0, 5.0, 4.0]), ([3.0], [1.0, 2.0]), ([1.0, 0.0], [1.0, 0.0, 9.0]), ([1.0], [1.0, 0.0])]
    system = sum((ct.ss(ct.tf(*term)) for term in terms), ct.ss([], [], [], 0.5))
    form = phc.ph(system)
    assert form.conversion.energy == "modal" and form.nstates == 6
    np.testing.assert_allclose(sorted(np.diag(form.R)), [0.0, 0.0, 0.0, 0.0, 2.0, 2.5], atol=1e-9)
    np.testing.assert_allclose(np.diag(form.Q), [2.0, 3.0, 2.0, 3.0, 1.0, 1.0], rtol=1e-9)


def closed_form_storage(poles, residues, D):
    """Least storage of one port of simple poles, `X` for the states `x' = p x + u`, `y = sum residue x`, by products.

    `G(s) + G(-s) = W(s) W(-s)` with zeros of `W` in the left half plane.
    """
    n = len(poles)
    denominator = np.poly(poles).real
    numerator = (D * denominator).astype(complex)
    for k in range(n):
        numerator[1:] = numerator[1:] + residues[k] * np.poly(np.delete(poles, k))
    numerator, mirror = numerator.real, (-1.0) ** np.arange(n, -1, -1)
    even = np.polymul(numerator, denominator * mirror) + np.polymul(numerator * mirror, denominator)
    even = np.where(np.abs(even) > 1e-12 * np.abs(even).max(), even, 0)
    zeros = np.roots(np.trim_zeros(even, "f"))
    left = zeros[np.argsort(zeros.real)][: len(zeros) // 2]
    s0 = 1j * np.abs(poles).mean() * 0.37
    product = np.prod(s0 - left) / np.prod(s0 - poles)
    phi = 2 * (D + np.sum(residues / (s0 - poles))).real
    w = np.array([np.prod(poles[k] - left) / np.prod(poles[k] - np.delete(poles, k)) for k in range(n)])
    g2 = phi / np.abs(product) ** 2
    return -g2 * np.outer(w.conj(), w) / (poles.conj()[:, None] + poles)


@pytest.mark.parametrize("feedthrough", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(6))
def test_the_least_storage_of_one_port_is_that_of_the_spectral_factor(seed, feedthrough):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    root = rng.normal(size=(2 * n, 2 * n))
    skew = rng.normal(size=(2 * n, 2 * n))
    A, b = skew - skew.T - 0.3 * root @ root.T, rng.normal(size=(2 * n, 1))
    poles, V = np.linalg.eig(A)
    V = V * np.linalg.solve(V, b).ravel()  # modal states that the input drives alike
    residues = (b.T @ V).ravel()
    X = closed_form_storage(poles, residues, feedthrough)
    form = phc.ph(ct.ss(A, b, b.T, feedthrough), storage="available")
    # the same states: those that inputs drive to the same place
    U, W = np.linalg.eig(form.A)
    order = [int(np.argmin(np.abs(U - p))) for p in poles]
    T = (W * np.linalg.solve(W, form.B).ravel())[:, order]
    np.testing.assert_allclose(T.conj().T @ form.Q @ T, X, rtol=1e-6, atol=1e-7 * np.abs(X).max())


@pytest.mark.slow
@settings(max_examples=15, deadline=None, derandomize=True)
@SEEDS
def test_the_storages_are_ordered_and_the_true_energy_lies_between(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 7)), int(rng.integers(1, 3))
    root, skew, B = rng.normal(size=(n, n)), rng.normal(size=(n, n)), rng.normal(size=(n, m))
    A = skew - skew.T - 0.5 * root @ root.T
    plain = ct.ss(A, B, B.T, 0.2 * np.eye(m))  # its energy is |x|^2 / 2

    def energy(storage):
        """`X` in the states given, by the states that unit inputs reach at n instants of decay."""
        form = phc.ph(plain, storage=storage)
        powers = [np.linalg.matrix_power(np.linalg.inv(M - 3 * np.eye(n)), k) for M in (form.A, A) for k in range(n)]
        mine, given_ = (np.hstack([P @ Bk for P in part]) for part, Bk in ((powers[:n], form.B), (powers[n:], B)))
        T = mine @ np.linalg.pinv(given_)
        return T.T @ form.Q @ T

    least, mean, largest = (energy(storage) for storage in ("available", "mean", "required"))
    slack = 1e-6 * np.linalg.norm(largest)
    for low, high in ((least, mean), (mean, largest), (least, np.eye(n)), (np.eye(n), largest)):
        assert np.linalg.eigvalsh(high - low)[0] >= -slack


# --- ports and sensors --------------------------------------------------------------------------------------------


def test_outputs_that_are_no_ports_become_sensors():
    M, C, K, F = structure(1, ports=1)
    inverse, zero = np.linalg.inv(M), np.zeros((4, 4))
    A = np.block([[zero, np.eye(4)], [-inverse @ K, -inverse @ C]])
    T = qr(np.random.default_rng(3).normal(size=(8, 8)))[0]
    B = np.vstack([np.zeros((4, 1)), inverse @ F])
    rows = np.vstack([np.eye(8)[0], np.r_[np.zeros(4), F[:, 0]], np.eye(8)[6]])
    system = ct.ss(T @ A @ T.T, T @ B, rows @ T.T, 0, inputs=["force"], outputs=["position", "velocity", "far"])
    for ports in ([(1, 0)], [("velocity", "force")], {"velocity": "force"}):
        form = phc.ph(system, ports=ports)
        assert form.output_labels == ["velocity", "position", "far"] and form.noutputs == 3
        s = 1j * np.geomspace(0.1, 10, 7)
        np.testing.assert_allclose(form(s), system(s)[[1, 0, 2]], rtol=1e-9)
    with pytest.raises(phc.NotPassiveError):
        phc.ph(system, ports=[(0, 0)])
    with pytest.raises(phc.StructureError, match="ports="):
        phc.ph(system)


@pytest.mark.parametrize(
    ("ports", "message"),
    [
        ([(0, 0)], "no output for input 1"),
        ([(0, 0), (0, 1)], "is at 2 ports"),
        ([(0, 0), (2, 1)], "numbered from 0 to 1"),
        ([0, 1], "not a list of pairs"),
        (3, "not a list of pairs"),
        (ct.ss(-1.0, 1.0, 1.0, 0.0), "not a list of pairs"),
        ([("y", 0), (1, 1)], "no output 'y'"),
        (["ab", (1, 1)], "not a list of pairs"),
    ],
)
def test_ports_that_are_none_are_refused(ports, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.ph(ct.ss(-np.eye(2), np.eye(2), np.eye(2), 0), ports=ports)


def test_ports_in_another_order_and_sensors_of_lossless_modes():
    w, K = 2.0, np.array([[1.0, 0.5], [0.5, 1.0]])
    system = modal_system([w * 1j, -1.0 + 3j], [K + 0j, (0.5 + 1j / 6) * np.eye(2)], np.zeros((2, 2)))
    swapped = system[::-1, :]
    form = phc.ph(swapped, ports=[(1, 0), (0, 1)])
    s = 1j * np.geomspace(0.1, 10, 7)
    np.testing.assert_allclose(form(s), system(s), rtol=1e-9)
    lossless = ct.ss(phc.from_second_order(np.eye(2), [[2.0, -1.0], [-1.0, 3.0]], np.eye(2)))
    again = phc.ph(lossless[::-1, :], ports=[(1, 0), (0, 1)], lossless=True)
    assert type(again) is phc.PortHamiltonian
    np.testing.assert_allclose(again(s), lossless(s), rtol=1e-9)
    for lossy in (swapped, swapped[:, 0]):
        with pytest.raises(phc.NotLosslessError):
            phc.ph(lossy, ports=[(1, 0), (0, 1)][: lossy.ninputs], lossless=True)
    watched = ct.ss(system.A, system.B[:, :1], system.C, 0)
    form = phc.ph(watched, ports=[(0, 0)])
    np.testing.assert_allclose(form(s), watched(s), rtol=1e-9)


# --- the call -----------------------------------------------------------------------------------------------------


def test_lossless_systems_stay_what_they_were():
    lossless = ct.ss(phc.frenkel_kontorova(4))
    assert type(phc.ph(lossless)) is phc.PortHamiltonian
    assert np.array_equal(phc.ph(lossless).d, phc.ph(lossless, lossless=True).d)
    for damped in (ct.tf([1.0, 0.0], [1.0, 0.1, 4.0]), phc.ph(np.eye(2), [0.0, 1.0], R=np.eye(2))):
        with pytest.raises(phc.NotLosslessError) as caught:
            phc.ph(damped, lossless=True)
        assert not isinstance(caught.value, phc.NotPassiveError) and "no port-Hamiltonian form" not in str(caught.value)


def test_the_ways_into_a_system():
    wanted = ct.tf([2.0, 1.0], [1.0, 1.0, 4.0])
    s = 1j * np.geomspace(0.1, 10, 7)
    import scipy.signal

    for source in (wanted, ct.ss(wanted), scipy.signal.lti([2.0, 1.0], [1.0, 1.0, 4.0]), phc.modes(ct.ss(wanted))):
        np.testing.assert_allclose(phc.ph(source)(s), wanted(s), rtol=1e-12)
    form = phc.ph(wanted, storage="required", name="plant", inputs=["V"], outputs=["I"])
    assert (form.name, form.input_labels, form.output_labels) == ("plant", ["V"], ["I"])
    for twin in (copy.copy(form), pickle.loads(pickle.dumps(form)), phc.ph(form)):
        assert twin.conversion == form.conversion and np.array_equal(twin.R, form.R)
    again = phc.ph(form, storage="available")
    assert again.conversion.energy == "available"
    np.testing.assert_allclose(again(s), wanted(s), rtol=1e-10)


@pytest.mark.parametrize(
    "call",
    [
        lambda: phc.ph(ct.tf([2, 1], [1, 1, 4]), storage="physical"),
        lambda: phc.ph(np.eye(2), [0.0, 1.0], storage="mean"),
        lambda: phc.ph(np.eye(2), [0.0, 1.0], ports=[(0, 0)]),
        lambda: phc.ph(ct.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1), ports=[(0, 0)]),
    ],
)
def test_options_that_do_not_fit_are_refused(call):
    with pytest.raises(phc.StructureError):
        call()


def test_hidden_states_are_left_out_and_counted():
    seen = ct.ss(ct.tf([2.0, 1.0], [1.0, 1.0, 4.0]))
    hidden = ct.ss(block_diag(seen.A, [[0.0, 5.0], [-5.0, 0.0]], [[0.3]]), np.r_[seen.B, np.zeros((3, 1))],
                   np.c_[seen.C, np.ones((1, 3))], 0)  # fmt: skip
    form = phc.ph(hidden)
    assert form.conversion.hidden == 3 and form.nstates == 2

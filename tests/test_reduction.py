"""One coupled energy: its factors, its modes where positions and momenta are apart, and frequencies alone."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, random_hamiltonian, symplectic_form
from scipy.linalg import block_diag

import ph_control as phc
from ph_control.numerics import definiteness as _definite
from ph_control.symplectic import skew_tridiagonal as reduction
from ph_control.symplectic.forms_and_williamson import energy_coordinates, port_spectrum
from ph_control.symplectic.skew_tridiagonal import bounded_spectrum, reduce_block

relaxed = settings(deadline=None, max_examples=20, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def norm(M):
    return np.linalg.norm(M, 2)


def definite(size, rng, condition=100.0):
    X, _ = np.linalg.qr(rng.standard_normal((size, size)))
    M = (X * np.logspace(0, np.log10(condition), size)) @ X.T
    return 0.5 * (M + M.T)


def errors(Q, d, S):
    """Backward error relative to `||Q||`, both symplectic errors relative to `||S||^2`."""
    J = symplectic_form(len(d))
    size = max(1.0, norm(S)) ** 2
    backward = norm((S.T * np.r_[d, d]) @ S - Q) / norm(Q)
    return backward, norm(S @ J @ S.T - J) / size, norm(S.T @ J @ S - J) / size


# --- factors ---------------------------------------------------------------------------------------------------------


@relaxed
@given(st.integers(1, 30), st.sampled_from([1.0, 1e6, 1e12]), st.sampled_from([1e-150, 1e-9, 1.0, 1e9, 1e150]), seeds)
def test_a_definite_matrix_is_its_lower_factor_times_the_transpose(size, condition, scale, seed):
    Q = scale * definite(size, np.random.default_rng(seed), condition)
    F, _ = _definite.definite_factor(Q)
    assert np.array_equal(F, np.tril(F))
    assert norm(F @ (F / scale).T - Q / scale) <= 4 * size * EPS * norm(Q / scale)


@pytest.mark.parametrize("size", [2, 40, 300])
def test_what_may_be_semidefinite_has_no_factor_and_what_is_a_little_away_from_it_has(size):
    # one eigenvalue at a chosen distance from zero, of a matrix of unit diagonal
    for gap, clear in ((64.0, True), (4.0, False), (-64.0, False)):
        smallest = gap * size * EPS
        Q = np.eye(size)
        Q[0, 1] = Q[1, 0] = 1 - smallest
        assert (_definite.definite_factor(Q) is not None) == clear


# --- positions and momenta apart -------------------------------------------------------------------------------------

CONDITIONS = [(1.0, 1.0), (1e2, 1e2), (1e6, 1.0), (1e6, 1e6), (1.0, 1e12)]


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 7, 40])
@pytest.mark.parametrize(("stiff", "light"), CONDITIONS)
@pytest.mark.parametrize("scales", [(1.0, 1.0), (1e9, 1e-9), (1e-9, 1e-9), (1e9, 1e9), (1e120, 1e-120)])
def test_a_mechanical_energy_is_reduced_at_half_the_size(n, stiff, light, scales, monkeypatch):
    rng = np.random.default_rng(n)
    K, W = scales[0] * definite(n, rng, stiff), scales[1] * definite(n, rng, light)
    Q = block_diag(K, W)
    with monkeypatch.context() as patch:
        patch.setattr(reduction, "_coupled_rows", None)
        patch.setattr(reduction, "_semidefinite_rows", None)
        d, S = phc.williamson(Q)
    assert not S[:n, n:].any() and not S[n:, :n].any()
    # in common units of positions and momenta
    unit = np.r_[np.full(n, (scales[1] / scales[0]) ** 0.25), np.full(n, (scales[0] / scales[1]) ** 0.25)]
    backward, right, left = errors(unit[:, None] * Q * unit, d, S * unit)
    assert backward <= 4 * (1 + n) * EPS
    assert max(right, left) <= 4 * (1 + n) * EPS
    L = np.linalg.cholesky(W / scales[1])
    squares = np.linalg.eigvalsh(L.T @ (K / scales[0]) @ L)
    allowed = 20 * n * EPS * squares.max()
    assert np.all(np.abs(d**2 / scales[0] / scales[1] - squares) <= allowed)


def test_the_frequencies_of_a_mechanical_energy_keep_their_digits_over_a_wide_range():
    n = 12
    rng = np.random.default_rng(3)
    masses, springs = 10.0 ** rng.uniform(-3, 3, n), 10.0 ** rng.uniform(-3, 3, n + 1)
    K = np.diag(springs[1:] + springs[:-1]) - np.diag(springs[1:-1], 1) - np.diag(springs[1:-1], -1)
    d, _ = phc.williamson(block_diag(K, np.diag(1 / masses)))
    with mp.workdps(60):
        root = [1 / mp.sqrt(mp.mpf(float(m))) for m in 1 / (1 / masses)]
        scaled = mp.matrix(n)
        for j in range(n):
            for k in range(n):
                scaled[j, k] = root[j] * mp.mpf(float(K[j, k])) * root[k]
        truth = np.array([float(mp.sqrt(x)) for x in sorted(mp.eigsy(scaled, eigvals_only=True))])
    # rounding the entries of K relative to themselves moves each square by this much
    scaled = K / np.sqrt(np.outer(np.diag(K), np.diag(K)))
    assert np.max(np.abs(d / truth - 1)) <= 20 * n * EPS * np.linalg.cond(scaled)


@pytest.mark.parametrize("order", ["qp", "pq"])
def test_repeated_frequencies_and_diagonal_masses_are_no_exception(order):
    n = 6
    rng = np.random.default_rng(5)
    d0 = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 5.0])
    masses = rng.uniform(0.5, 2.0, n)
    X, _ = np.linalg.qr(rng.standard_normal((n, n)))
    K = np.sqrt(masses)[:, None] * ((X * d0**2) @ X.T) * np.sqrt(masses)
    parts = [0.5 * (K + K.T), np.diag(1 / masses)]
    Q = block_diag(*(parts if order == "qp" else parts[::-1]))
    d, S = phc.williamson(Q)
    backward, right, left = errors(Q, d, S)
    assert np.max(np.abs(d - d0)) <= 100 * EPS * 25
    assert max(backward, right, left) <= 4 * n * EPS


def test_half_a_mechanical_energy_that_is_semidefinite_takes_the_way_of_semidefinite_ones():
    chain = phc.spring_chain([1.0, 2.0, 3.0], [2.0, 5.0])  # floating
    d1, d2, S = phc.williamson_semidefinite(chain.Q)
    assert d1[-1] == 0 and d2[-1] == 1
    assert norm((S.T * np.r_[d1, d2]) @ S - chain.Q) <= 50 * EPS * norm(chain.Q)


@relaxed
@given(st.integers(2, 12), st.integers(1, 3), seeds)
def test_all_uses_of_a_mechanical_energy_agree_with_the_general_path(n, ports, seed):
    rng = np.random.default_rng(seed)
    Q = block_diag(definite(n, rng), definite(n, rng))
    B = rng.standard_normal((2 * n, ports))
    # a rotation of one plane by a little, exactly symplectic, couples positions with momenta
    c, s = np.cos(0.3), np.sin(0.3)
    R = np.eye(2 * n)
    R[0, 0] = R[n, n] = c
    R[0, n], R[n, 0] = s, -s
    turned = R @ Q @ R.T
    general = phc.ph(0.5 * (turned + turned.T), R @ B)
    apart = phc.ph(Q, B)
    assert np.max(np.abs(apart.d / general.d - 1)) <= 1e4 * n * EPS
    w = np.linspace(0.1, 1.5 * apart.d[-1], 7) + 0.1j
    assert np.allclose(apart.horner(w), general.horner(w), rtol=1e-9, atol=1e-9 * np.abs(general.horner(w)).max())
    found, E, E0 = energy_coordinates(Q)
    assert np.array_equal(found, apart.d) and not len(E0)
    assert norm((E.conj().T @ E).real - Q) <= 100 * n * EPS * norm(Q)


# --- how many digits products have -----------------------------------------------------------------------------------


@pytest.mark.parametrize("squeeze", [0.0, 2.0, 4.0, 6.0])
def test_backward_and_symplectic_errors_do_not_grow_with_the_squeeze(squeeze):
    n = 30
    Q, _ = random_hamiltonian(np.linspace(1, 4, n), np.random.default_rng(1), squeeze)
    d, S = phc.williamson(Q)
    backward, right, left = errors(Q, d, S)
    assert backward <= n * EPS
    assert max(right, left) <= n * EPS


def test_products_have_more_digits_only_where_rounding_would_show(monkeypatch):
    asked = []
    product = reduction.product

    def watched(left, right, slices=3, *multiply):
        asked.append(slices)
        return product(left, right, slices, *multiply)

    monkeypatch.setattr(reduction, "product", watched)
    for squeeze, expected in ((0.0, [1]), (3.0, [2]), (7.0, [3])):
        monkeypatch.setattr(reduction, "_AMPLIFIED", 2.0**16)
        Q, _ = random_hamiltonian(np.linspace(1, 4, 10), np.random.default_rng(1), squeeze)
        asked.clear()
        reduce_block(Q)
        assert asked == expected


@pytest.mark.parametrize("Q", [np.diag([4.0, 1.0]), np.array([[4.0, 1.0], [1.0, 1.0]]), 1e140 * np.diag([1.0, 1e-280])])
def test_one_degree_of_freedom_has_its_frequency_to_the_last_place(Q):
    d, S = phc.williamson(Q)
    with mp.workdps(60):
        a, b, c = (mp.mpf(float(x)) for x in (Q[0, 0], Q[0, 1], Q[1, 1]))
        truth = float(mp.sqrt(a * c - b * b))
    assert abs(d[0] / truth - 1) <= 4 * EPS
    assert np.max(np.abs((S.T * d[0]) @ S - Q) / np.sqrt(np.outer(np.diag(Q), np.diag(Q)))) <= 8 * EPS
    assert abs(np.linalg.det(S) - 1) <= 8 * EPS


# --- frequencies and residues alone ----------------------------------------------------------------------------------


@relaxed
@given(st.integers(1, 20), st.booleans(), st.sampled_from([1e-9, 1.0, 1e9]), st.sampled_from(["any", "force"]), seeds)
def test_frequencies_and_residues_alone_are_those_of_the_modes(n, apart, scale, port, seed):
    rng = np.random.default_rng(seed)
    Q = scale * (block_diag(definite(n, rng, 10.0), definite(n, rng, 10.0)) if apart else definite(2 * n, rng, 10.0))
    b = rng.standard_normal(2 * n)
    if port == "force":
        b[:n] = 0
    d, kappa, _ = bounded_spectrum(Q, b)
    truth = phc.ph(Q, b).modes
    assert np.all(np.diff(d) >= 0)
    assert np.max(np.abs(d - truth.d)) <= 20 * n * EPS * truth.d[-1]
    assert abs(kappa.sum() - b @ Q @ b) <= 100 * n * EPS * norm(Q) * (b @ b)
    # weights may flow between near frequencies: what a port shows of them together may not
    s = truth.d[-1] * np.array([0.3 + 0.2j, 1.1 + 0.1j])
    mine = (kappa * s[:, None] / (s[:, None] ** 2 + d**2)).sum(axis=1)
    assert np.allclose(mine, truth.evaluate(s)[0, 0], rtol=1e-9, atol=1e-12 * kappa.sum() / truth.d[-1])


def test_an_input_of_zero_has_residues_of_zero():
    Q = definite(8, np.random.default_rng(0))
    d, kappa, _ = bounded_spectrum(Q, np.zeros(8))
    assert not kappa.any()
    assert np.allclose(d, phc.williamson(Q)[0], rtol=1e-12)


def test_wide_and_semidefinite_spectra_are_left_to_the_modes():
    rng = np.random.default_rng(0)
    wide, _ = random_hamiltonian(np.logspace(0, 2, 4), rng, 0.1)
    narrow, _ = random_hamiltonian(np.logspace(0, 1, 4), rng, 0.1)
    b = rng.standard_normal(8)
    assert port_spectrum(narrow, b) is not None
    assert port_spectrum(wide, b) is None
    assert bounded_spectrum(np.ones((8, 8)), b) is None


def test_turns_of_modes_take_a_defect_away_at_no_cost_of_energy(monkeypatch):
    n = 40
    Q, _ = random_hamiltonian(np.linspace(1, 4, n), np.random.default_rng(2), 4.0)
    # rounding that is to be taken away: rows in doubles where they would have more digits
    monkeypatch.setattr(reduction, "_HARMLESS", np.inf)
    with_turns = errors(Q, *phc.williamson(Q))
    monkeypatch.setattr(reduction, "_TURN", 0.0)
    without = errors(Q, *phc.williamson(Q))
    assert max(with_turns) <= n * EPS
    assert with_turns[0] < 0.1 * without[0]
    assert max(without[1:]) <= n * EPS


def test_near_and_equal_frequencies_are_not_turned():
    d = np.array([1.0, 1.0, 1.0 + 1e-12, 2.0])
    defect = np.full((4, 4), 1e-14)
    (turn,) = reduction._turns(d, defect)
    assert not turn[0, 1] and not np.diag(turn).any()
    # 2 d_j d_l / (d_l^2 - d_j^2), and the opposite the other way
    assert np.allclose(turn[0, 3] / 1e-14, 4 / 3, rtol=1e-12) and np.allclose(turn[3, 0], -turn[0, 3], rtol=1e-12)
    (larger,) = reduction._turns(d, 1e4 * defect)
    assert turn[0, 2] == 0 and larger[0, 3] > 0
    (small,) = reduction._turns(d, 1e-9 * defect)
    assert 0 < small[0, 2] < 1e-10

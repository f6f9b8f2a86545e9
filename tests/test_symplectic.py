"""Williamson's normal form and what it rests on."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, random_hamiltonian, random_orthogonal_symplectic, random_symplectic, symplectic_form
from scipy.io import mmread
from scipy.linalg import eigh
from slow import slowly

import ph_control as phc
from ph_control.symplectic.forms_and_williamson import apply_form, energy_coordinates, skew_normal_form

relaxed = settings(deadline=None, max_examples=20, derandomize=True)
seeds = st.integers(0, 2**32 - 1)

SPECTRA = {
    "one": [3.0],
    "two": [0.5, 2.0],
    "repeated": [2.0] * 5,
    "repeated twice": [1.0, 1.0, 1.0, 2.0, 2.0],
    "close to 1e-9": 1 + 1e-9 * np.arange(5),
    "close to 1e-14": 1 + 1e-14 * np.arange(5),
    "ratio 1e12": np.logspace(-6, 6, 8),
    "ratio 1e12, two clusters": [1e-6, 1e-6, 1e6, 1e6],
    "thirty": np.linspace(1, 4, 30),
}


def norm(M):
    return np.linalg.norm(M, 2)


def residuals(Q, d, S):
    """Backward and symplectic error in units of `n eps`, relative to `||Q||` and `||S||^2`."""
    n = len(d)
    J = symplectic_form(n)
    backward = norm(S.T @ np.diag(np.r_[d, d]) @ S - Q) / norm(Q)
    symplectic = max(norm(S @ J @ S.T - J), norm(S.T @ J @ S - J)) / norm(S) ** 2
    return backward / (n * EPS), symplectic / (n * EPS)


# --- the form and its tests ----------------------------------------------------------------------------------------


def test_the_symplectic_form_is_the_canonical_one():
    for n in (0, 1, 3):
        J = phc.symplectic_form(n)
        assert np.array_equal(J, symplectic_form(n))
        M = np.arange(4.0 * n * n).reshape(2 * n, 2 * n) + 1
        assert np.array_equal(apply_form(M), J @ M)


@pytest.mark.parametrize("n", [-1, 2.5, "two", None, True])
def test_the_symplectic_form_refuses_what_counts_no_degrees_of_freedom(n):
    with pytest.raises(phc.StructureError, match="whole number from 0"):
        phc.symplectic_form(n)


@pytest.mark.parametrize("n", [1, 2, 7])
def test_a_symplectic_matrix_is_told_from_one_just_outside_the_bound(n):
    S = random_symplectic(n, np.random.default_rng(n))
    allowed = 100 * 2 * n * EPS * norm(S) ** 2
    assert phc.is_symplectic(S)
    # (1 + t) S has the residual 2 t J
    assert phc.is_symplectic((1 + 0.4 * allowed) * S)
    assert not phc.is_symplectic((1 + 0.6 * allowed) * S)
    assert phc.is_symplectic((1 + 0.6 * allowed) * S, rtol=200 * 2 * n * EPS)


@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_a_hamiltonian_matrix_is_told_from_one_just_outside_the_bound_at_every_scale(scale):
    n = 3
    Q, _ = random_hamiltonian([1.0, 2.0, 3.0], np.random.default_rng(0))
    A = scale * apply_form(Q)
    allowed = 100 * 2 * n * EPS * np.max(np.abs(A))
    assert phc.is_hamiltonian_matrix(A)
    skewed = np.zeros_like(A)
    skewed[0, 0] = allowed
    assert phc.is_hamiltonian_matrix(A + 0.8 * skewed)
    assert not phc.is_hamiltonian_matrix(A + 1.2 * skewed)
    assert phc.is_hamiltonian_matrix(A + 1.2 * skewed, rtol=200 * 2 * n * EPS)


@pytest.mark.parametrize("test", [phc.is_symplectic, phc.is_hamiltonian_matrix])
def test_a_matrix_of_the_wrong_shape_is_neither_and_no_matrix_is_an_error(test):
    assert not test(np.eye(3))
    assert not test(np.ones((2, 4)))
    assert test(np.zeros((0, 0)))
    for bad in ([1.0, 2.0], np.full((2, 2), np.nan), 1j * np.eye(2), [["a", "b"], ["c", "d"]], [[1, 2], [3]]):
        with pytest.raises(phc.StructureError):
            test(bad)


# --- Williamson ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SPECTRA)
@pytest.mark.parametrize("squeeze", [0.0, 1.0])
def test_williamson_residuals_scale_with_n_eps_for_every_spectrum(name, squeeze):
    d0 = np.sort(SPECTRA[name])
    Q, S0 = random_hamiltonian(d0, np.random.default_rng(len(name)), squeeze)
    d, S = phc.williamson(Q)
    backward, symplectic = residuals(Q, d, S)
    assert backward < 20
    assert symplectic < 5
    assert phc.is_symplectic(S)
    assert np.all(np.diff(d) >= 0)
    # a symplectic eigenvalue moves by at most ||S^{-1}||^2 times the change of Q, and ||S^{-1}|| = ||S||
    assert np.max(np.abs(d - d0)) < 50 * len(d) * EPS * norm(Q) * norm(S0) ** 2


@relaxed
@given(st.integers(1, 8), seeds)
def test_williamson_holds_for_random_matrices_of_one_to_eight_degrees_of_freedom(n, seed):
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((2 * n, 2 * n + 2))
    Q = F @ F.T
    original = Q.copy()
    d, S = phc.williamson(Q)
    backward, symplectic = residuals(Q, d, S)
    assert backward < 20
    assert symplectic < 5
    frequencies = np.sort(np.abs(np.linalg.eigvals(symplectic_form(n) @ Q).imag))[::2]
    assert np.max(np.abs(d - frequencies)) < 1000 * n * EPS * norm(Q) * norm(S) ** 2
    assert np.array_equal(Q, original)


@pytest.mark.parametrize("scale", [1e-299, 1e-200, 1e-150, 1e-9, 1e9, 1e150])
def test_a_scaled_matrix_has_scaled_frequencies_and_residuals_as_good(scale):
    Q, _ = random_hamiltonian([1.0, 2.0, 2.0, 5.0], np.random.default_rng(3))
    d, S = phc.williamson(Q)
    scaled_d, scaled_S = phc.williamson(scale * Q)
    backward, symplectic = residuals(Q, scaled_d / scale, scaled_S)
    assert backward < 20
    assert symplectic < 5
    assert np.max(np.abs(scaled_d / scale / d - 1)) < 100 * EPS * norm(Q) * norm(S) ** 2


def test_another_symplectic_basis_leaves_the_frequencies():
    rng = np.random.default_rng(5)
    Q, _ = random_hamiltonian([1.0, 2.0, 3.0], rng)
    d, S = phc.williamson(Q)
    T = random_orthogonal_symplectic(3, rng)
    turned = T.T @ Q @ T
    assert np.max(np.abs(phc.williamson(0.5 * (turned + turned.T))[0] - d)) < 100 * EPS * norm(Q) * norm(S) ** 2


def test_uncoupled_degrees_of_freedom_keep_their_own_relative_accuracy():
    springs, masses = np.logspace(-100, 100, 9), np.logspace(80, -120, 9)
    order = np.random.default_rng(0).permutation(9)
    d, S = phc.williamson(np.diag(np.r_[springs[order], masses[order]]))
    truth = np.sort(np.sqrt(springs) * np.sqrt(masses))
    assert np.max(np.abs(d / truth - 1)) < 8 * EPS
    J = symplectic_form(9)
    # column by column, as the units of the columns differ by many powers of ten
    size = np.abs(S) @ np.abs(J) @ np.abs(S.T)
    assert np.max(np.abs(S @ J @ S.T - J)) < 8 * EPS * max(1.0, size.max())


def test_uncoupled_groups_keep_their_own_relative_accuracy():
    rng = np.random.default_rng(6)
    d0 = np.array([1.0, 2.0])
    Q = np.zeros((8, 8))
    # in an order in which the slow and the fast group alternate
    for scale, group in ((1e-8, [0, 2, 4, 6]), (1e8, [1, 3, 5, 7])):
        Q[np.ix_(group, group)] = scale * random_hamiltonian(d0, rng, 0.5)[0]
    d, S = phc.williamson(Q)
    assert np.max(np.abs(d / np.r_[1e-8 * d0, 1e8 * d0] - 1)) < 100 * EPS
    assert np.max(np.abs((S.T * np.r_[d, d]) @ S - Q)[np.ix_([0, 2, 4, 6], [0, 2, 4, 6])]) < 100 * EPS * 1e-8


def test_units_of_length_and_momentum_do_not_make_a_matrix_semidefinite():
    Q, _ = random_hamiltonian([1.0, 2.0, 3.0], np.random.default_rng(1), 0.2)
    unit = np.r_[1e-8, 1.0, 1e8, 1e8, 1.0, 1e-8]
    d, _ = phc.williamson(unit[:, None] * Q * unit)
    assert np.max(np.abs(d - [1.0, 2.0, 3.0])) < 1000 * EPS


def test_the_empty_matrix_has_the_empty_normal_form():
    d, S = phc.williamson(np.zeros((0, 0)))
    assert d.shape == (0,)
    assert S.shape == (0, 0)


@pytest.mark.parametrize("names", [("lund_stiffness", "lund_mass"), ("bcsstk02", "bcsstm02")])
def test_the_frequencies_of_a_real_structure_are_those_of_the_generalized_eigenproblem(data_folder, names):
    K, M = (mmread(data_folder / "structures" / f"{name}.mtx") for name in names)
    K, M = (np.asarray(X.todense() if hasattr(X, "todense") else X, dtype=float) for X in (K, M))
    n = len(K)
    inverse = np.linalg.inv(M)
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n], Q[n:, n:] = K, 0.5 * (inverse + inverse.T)
    d, S = phc.williamson(Q)
    backward, symplectic = residuals(Q, d, S)
    assert backward < 5
    assert symplectic < 5
    squares = eigh(K, M, eigvals_only=True)
    # both are backward stable for the squares, relative to the largest, and inv(M) adds the condition of M
    allowed = n * EPS * squares.max() + EPS * np.linalg.cond(M) * squares
    assert np.all(np.abs(d**2 - squares) < allowed)


BAD = {
    "not square": (np.ones((2, 4)), r"Q is not square: its shape is \(2, 4\)"),
    "odd": (np.eye(3), "Q has odd size 3"),
    "not symmetric": ([[1.0, 1e-3], [0.0, 1.0]], r"not symmetric: .* = 1\.0e-03, allowed .*; pass \(Q \+ Q\.T\)/2"),
    "indefinite": (np.diag([1.0, -1.0]), "Q is indefinite: smallest eigenvalue .* -1, allowed"),
    "zero diagonal": ([[0.0, 1.0], [1.0, 1.0]], "Q is indefinite"),
    "free": (
        np.diag([0.0, 1.0]),
        r"not symplectic: rank 1, kernel of dimension 1, its symplectic part of dimension 0 \(",
    ),
    "free, coupled": (np.ones((2, 2)), r"use williamson_semidefinite\(Q\), or ground or remove the 1 rigid-body mode"),
    "free and cyclic": (
        np.diag([0.0, 0.0, 1.0, 0.0]),
        "rank 1, kernel of dimension 3, its symplectic part of dimension 2",
    ),
    "NaN": ([[1.0, 0.0], [0.0, np.nan]], r"1 of 4 entries are NaN or infinite, the first at index \(1, 1\)"),
    "infinite": ([[np.inf, 0.0], [0.0, 1.0]], "not finite"),
    "complex": (np.eye(2) + 1e-3j, "Q is complex: largest imaginary part 0.001"),
    "text": ([["a", "b"], ["c", "d"]], "does not hold real numbers"),
    "ragged": ([[1.0, 2.0], [3.0]], "not a rectangular array"),
    "vector": ([1.0, 2.0], "has 1 dimensions"),
}


@pytest.mark.parametrize("name", BAD)
def test_williamson_says_what_is_wrong_with_its_input(name):
    Q, message = BAD[name]
    with pytest.raises(phc.StructureError, match=message):
        phc.williamson(Q)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_definiteness_is_decided_relative_to_the_size_of_the_matrix(scale):
    bound = 8 * 2 * EPS
    for gap, accepted in ((4 * bound, True), (0.25 * bound, False)):
        Q = scale * np.array([[1.0, 1 - gap], [1 - gap, 1.0]])
        if accepted:
            assert np.all(phc.williamson(Q)[0] > 0)
        else:
            with pytest.raises(phc.StructureError, match="only positive semidefinite and its kernel is not symplectic"):
                phc.williamson(Q)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_symmetry_is_decided_relative_to_the_size_of_the_matrix(scale):
    def skewed(t):
        return scale * np.array([[2.0, t], [0.0, 2.0]])

    phc.williamson(skewed(0.9 * 1000 * 2 * EPS * 2))
    with pytest.raises(phc.StructureError, match="not symmetric"):
        phc.williamson(skewed(1.1 * 1000 * 2 * EPS * 2))
    phc.williamson(skewed(0.9 * 1e-6 * 2), rtol=1e-6)
    with pytest.raises(phc.StructureError, match="not symmetric"):
        phc.williamson(skewed(1.1 * 1e-6 * 2), rtol=1e-6)


# --- a symplectic kernel -------------------------------------------------------------------------------------------


@relaxed
@given(st.integers(0, 5), st.integers(1, 3), seeds, st.sampled_from([1.0, 1e9, 1e-9, 1e100, 1e-100]))
def test_a_symplectic_kernel_of_dimension_two_m_makes_m_frequencies_exactly_zero(oscillating, cyclic, seed, scale):
    rng = np.random.default_rng(seed)
    d0 = np.sort(rng.uniform(0.5, 5.0, oscillating))
    Q, S0 = random_hamiltonian(np.r_[np.zeros(cyclic), d0], rng)
    Q = scale * Q
    d, S = phc.williamson(Q)
    assert np.array_equal(d[:cyclic], np.zeros(cyclic))
    allowed = 100 * len(d) * EPS * (norm(Q) / scale) * norm(S0) ** 2
    assert np.all(np.abs(d[cyclic:] / scale - d0) < allowed)
    _, symplectic = residuals(np.eye(len(Q)), d, S)
    assert symplectic < 5
    assert norm((S.T * np.r_[d, d]) @ S - Q) <= 20 * len(d) * EPS * norm(Q)


def test_the_frequencies_of_a_symplectic_kernel_and_of_the_system_are_the_same():
    Q, _ = random_hamiltonian([0.0, 1.0, 0.0, 3.0], np.random.default_rng(8))
    sys = phc.ph(Q, np.ones(8))
    d, S = phc.williamson(Q)
    assert np.array_equal(d, np.r_[0.0, 0.0, sys.d])
    assert np.array_equal(sys.S, S)


def test_a_free_momentum_beside_a_cyclic_pair_is_refused_with_the_dimensions_of_the_kernel():
    S = random_symplectic(4, np.random.default_rng(9))
    Q = S.T @ np.diag([0.0, 0.0, 0.0, 2.0, 1.0, 1.0, 0.0, 2.0]) @ S
    with pytest.raises(phc.StructureError, match="rank 4, kernel of dimension 4, its symplectic part of dimension 2"):
        phc.williamson(0.5 * (Q + Q.T))


# --- large and ill-conditioned -------------------------------------------------------------------------------------

LARGE = {
    # spectrum and the exponents of the squeeze: Q has a condition number of about 1e12
    "repeated": lambda n: (np.repeat([1.0, 2.0], [n // 2, n - n // 2]), 6.9),
    "clustered": lambda n: (1 + 1e-9 * np.arange(n), 6.9),
    "ratio 1e12": lambda n: (np.logspace(-6, 6, n), 0.0),
    "ratio 1e6, squeezed": lambda n: (np.logspace(-3, 3, n), 3.45),
}


def hold_to_the_bounds_of_large_matrices(Q, d0):
    """Backward error, both symplectic errors, and where known the frequencies."""
    d, S = phc.williamson(Q)
    J = symplectic_form(len(d))
    assert norm((S.T * np.r_[d, d]) @ S - Q) < 1e-13 * norm(Q)
    # the exact S rounded to doubles is symplectic to eps ||S||^2 only; 1e-12 where that allows it
    allowed = max(1e-12, EPS * norm(S) ** 2)
    assert norm(S.T @ apply_form(S) - J) < allowed
    assert norm(S @ apply_form(S.T) - J) < allowed
    if d0 is not None:
        assert np.max(np.abs(d / np.sort(d0) - 1)) < 10 * EPS * np.linalg.cond(Q)


@pytest.mark.parametrize("n", [20, 100])
@pytest.mark.parametrize("name", LARGE)
def test_a_matrix_of_condition_1e12_has_an_exact_normal_form_whatever_its_spectrum(name, n):
    d0, squeeze = LARGE[name](n)
    Q, _ = random_hamiltonian(d0, np.random.default_rng(n), squeeze)
    assert 1e10 < np.linalg.cond(Q) < 1e13
    hold_to_the_bounds_of_large_matrices(Q, d0)


@pytest.mark.parametrize("n", [20, 100, *slowly(500)])
def test_a_dense_matrix_of_condition_1e12_has_an_exact_normal_form(n):
    U, _ = np.linalg.qr(np.random.default_rng(n).standard_normal((2 * n, 2 * n)))
    Q = (U * np.logspace(0, 12, 2 * n)) @ U.T
    hold_to_the_bounds_of_large_matrices(0.5 * (Q + Q.T), None)


@pytest.mark.parametrize("seed", [12, 29, 117, 159])
def test_pairs_of_frequencies_that_rounding_parts_are_turned_by_a_rotation(seed):
    Q, _ = random_hamiltonian([1.0, 1.0, 1e10, 1e10], np.random.default_rng(seed), 0.0)
    d, S = phc.williamson(Q)
    assert max(residuals(Q, d, S)) < 10


# --- energy coordinates and the skew normal form -------------------------------------------------------------------


def semidefinite_cases():
    rng = np.random.default_rng(11)
    definite, _ = random_hamiltonian([1.0, 2.0, 3.0], rng)
    S = random_symplectic(3, rng)
    free = S.T @ np.diag([0.0, 1.0, 2.0, 1.0, 1.0, 2.0]) @ S
    flat = S.T @ np.diag([0.0, 1.0, 2.0, 0.0, 1.0, 2.0]) @ S
    chain = np.zeros((6, 6))
    chain[:3, :3] = [[1, -1, 0], [-1, 2, -1], [0, -1, 1]]
    chain[3:, 3:] = np.eye(3)
    position = np.zeros((4, 4))
    position[0, 0] = position[1, 1] = 1.0
    return {
        "definite": (definite, 3, 0),
        "a free momentum": (0.5 * (free + free.T), 2, 1),
        "a cyclic pair": (0.5 * (flat + flat.T), 2, 0),
        "a free chain": (chain, 2, 1),
        "no springs": (np.diag([0.0, 0.0, 1.0, 4.0]), 0, 2),
        "no masses": (position, 0, 2),
        "nothing": (np.zeros((4, 4)), 0, 0),
    }


@pytest.mark.parametrize("name", semidefinite_cases())
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_in_energy_coordinates_the_energy_is_a_sum_of_squares_and_the_motion_a_rotation(name, scale):
    Q, oscillating, still = semidefinite_cases()[name]
    Q = scale * Q
    d, E, E0 = energy_coordinates(Q)
    assert (len(d), len(E0)) == (oscillating, still)
    allowed = 100 * len(Q) * EPS * max(norm(Q), np.finfo(float).tiny)
    assert norm((E.conj().T @ E).real + E0.T @ E0 - Q) <= allowed
    J = symplectic_form(len(Q) // 2)
    assert np.all(d > 0)
    if oscillating:
        assert norm(E @ J @ Q + 1j * d[:, None] * E) <= allowed * norm(E)
    if still:
        assert norm(E0 @ J @ Q) <= allowed * norm(E0)


@pytest.mark.parametrize("size", [0, 1, 2, 3, 6, 7])
def test_a_skew_matrix_is_a_sum_of_rotations_in_orthogonal_planes(size):
    M = np.random.default_rng(size).standard_normal((size, size))
    for K in (M - M.T, 0 * M):
        sigma, a, b = skew_normal_form(K)
        pairs = size // 2
        assert len(sigma) == pairs
        assert a.shape[1] + b.shape[1] == size
        planes = a[:, :pairs] * sigma @ b[:, :pairs].T
        assert np.max(np.abs(planes - planes.T - K), initial=0.0) <= 20 * size * EPS * np.max(np.abs(K), initial=0.0)
        basis = np.concatenate([a, b], axis=1)
        assert np.max(np.abs(basis.T @ basis - np.eye(size)), initial=0.0) <= 20 * size * EPS
        assert np.all(np.diff(sigma) >= 0)
        assert np.all(sigma >= 0)


@pytest.mark.parametrize("test", [phc.williamson, phc.is_symplectic, phc.is_hamiltonian_matrix])
@pytest.mark.parametrize("rtol", ["a", [1e-6], np.nan, np.inf, 1.0, -1.0])
def test_a_tolerance_of_no_meaning_is_refused_and_symmetrises_nothing(test, rtol):
    with pytest.raises(phc.StructureError, match=r"rtol is .*; a relative tolerance is a number from 0 to 1"):
        test(np.array([[1.0, 0.5], [0.0, 1.0]]), rtol=rtol)


@pytest.mark.parametrize("n", [10**400, 10**5000, 10**9], ids=["400", "5000", "9"])
def test_a_symplectic_form_that_no_memory_holds_is_refused(n):
    with pytest.raises(phc.StructureError, match="a whole number from 0 to 100000000"):
        phc.symplectic_form(n)


@pytest.mark.parametrize("size", [1e300, 1e154])
def test_a_matrix_whose_products_leave_the_range_of_doubles_is_not_called_symplectic_or_not(size):
    with pytest.raises(phc.StructureError, match="S is out of range"):
        phc.is_symplectic(size * np.eye(2))
    with pytest.raises(phc.StructureError, match="S is out of range"):
        phc.controllable_morphism([1.0], [1.0, 0.0], size * np.eye(2))


def test_a_matrix_whose_normal_form_rounding_leaves_open_is_refused_or_solved_without_a_warning():
    Q = [
        [3.919966739146276e-17, -3529720.5792329116, -1.3760204197293926e-09, 1.445183488163157e-06],
        [-3529720.579232911, 1.2136776817781992e31, 21158275784963.324, 6.277730210092467e18],
        [-1.3760204197293928e-09, 21158275784963.324, 0.06186301401162058, -354.8716297772628],
        [1.4451834881631567e-06, 6.277730210092467e18, -354.8716297772628, 12580894.564685863],
    ]
    # which of the two depends on the rounding of the machine's BLAS
    for make in (phc.williamson, phc.williamson_semidefinite, lambda Q: phc.ph(Q, np.ones(4)).observable_form()):
        with contextlib.suppress(phc.StructureError):
            make(Q)

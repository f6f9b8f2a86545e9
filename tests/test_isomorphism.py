"""Isomorphisms: found where they exist, refused where they do not, against dense linear algebra."""

import control as ct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_systems import SETTINGS, SQUEEZE, cases, companion, pair, plain, target, transposed
from reference import EPS, dense_matrices, random_hamiltonian, random_symplectic

import ph_control as phc
from ph_control import are_isomorphic, is_morphism, system_isomorphism


def dense_solutions(sys1, sys2):
    """Least-squares solution of `L A1 = A2 L, L B1 = B2, C1 = C2 L`, what is left of it, and the null space."""
    I = np.eye(sys1.nstates)
    system = np.concatenate([np.kron(I, sys1.A.T) - np.kron(sys2.A, I), np.kron(I, sys1.B.T), np.kron(sys2.C, I)])
    wanted = np.concatenate([np.zeros(sys1.nstates**2), sys2.B.ravel(), sys1.C.ravel()])
    U, sigma, Vt = np.linalg.svd(system)
    rank = int(np.sum(sigma > 1e-9 * sigma[0]))
    L = Vt[:rank].T @ ((U[:, :rank].T @ wanted) / sigma[:rank])
    return L.reshape(I.shape), np.linalg.norm(system @ L - wanted), Vt[rank:].reshape(-1, *I.shape)


def dense_existence(sys1, sys2, rng):
    """Whether an invertible solution exists: a random one is, if any."""
    L, left, free = dense_solutions(sys1, sys2)
    L = L + np.tensordot(rng.standard_normal(len(free)), free, axes=1)
    return bool(left < 1e-8 and np.linalg.cond(L) < 1e8)


def dense(d, v, T):
    """The normal form in the states `T z`."""
    A, B, C = dense_matrices(np.diag(np.r_[d, d]), v)
    return plain(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T))


# --- port-Hamiltonian systems ------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.sampled_from([0.0, 1.0, SQUEEZE]))
def test_symplectic_changes_of_states_are_found(case, squeeze):
    d, v, rng = pair(*case)
    first, second = (target(d, v, random_symplectic(len(d), rng, squeeze)) for _ in range(2))
    verdict = are_isomorphic(first, second)
    assert verdict and verdict.residual <= verdict.allowed
    check = is_morphism(verdict.witness, first, second)
    assert check.residual == verdict.residual
    assert check.injective and check.surjective
    # a bound that cond(Q) of both explains: cond(S)^2 max d / min d
    assert verdict.residual <= 100 * len(d) * EPS * np.exp(4 * squeeze) * d.max() / d.min()


@SETTINGS
@given(cases, st.sampled_from([0.0, 0.5]), st.booleans())
def test_a_change_of_a_frequency_or_of_a_weight_is_seen(case, squeeze, of_frequency):
    d, v, rng = pair(*case)
    first = target(d, v, random_symplectic(len(d), rng, squeeze))
    l = int(np.argmax(np.abs(v[: len(d)])))
    other_d, other_v = d.copy(), v.copy()
    if of_frequency:
        other_d[l] *= 1 + 1e-7
    else:
        other_v[l] *= 1 + 1e-5
    second = target(other_d, other_v, random_symplectic(len(d), rng, squeeze))
    verdict = are_isomorphic(first, second)
    assert not verdict and verdict.witness is None
    assert verdict.residual > verdict.allowed
    assert "differ" in verdict.reason
    assert system_isomorphism(first, second) is None
    # so close that a tolerance may let it pass; repeated or clustered modes mix by more than they differ
    if case[1] in ("decade", "dark") or not of_frequency:
        assert are_isomorphic(first, second, rtol=1e-3)


@SETTINGS
@given(st.integers(1, 4), st.integers(0, 10**6), st.booleans(), st.booleans())
def test_for_repeated_frequencies_the_sums_of_weights_decide_as_dense_algebra_does(n, seed, same, hidden):
    rng = np.random.default_rng(seed)
    d = rng.choice([1.0, 2.0], n)
    v, w = rng.standard_normal((2, 2 * n))
    if hidden:
        v[np.r_[d == 1.0, d == 1.0]] = 0
    if same:
        for x in (1.0, 2.0):
            l = np.r_[d == x, d == x]
            w[l] *= np.linalg.norm(v[l]) / (np.linalg.norm(w[l]) or 1)
    first, second = phc.ph(np.diag(np.r_[d, d]), v), phc.ph(np.diag(np.r_[d, d]), w)
    verdict = are_isomorphic(first, second)
    assert bool(verdict) == same == dense_existence(first, second, rng)


def test_equal_hidden_parts_are_matched_and_different_ones_are_not():
    """Example 4.2 of the paper: the same filter, but no isomorphism."""
    B = [1.0, 0.0, 0.0, 0.0]
    first, second = phc.ph(np.eye(4), B), phc.ph(np.diag([1.0, 2.0, 1.0, 3.0]), B)
    verdict = are_isomorphic(first, second)
    assert not verdict and verdict.reason == "the frequencies differ: 1 and 2.44949"
    s = 0.7j
    G = [M.C @ np.linalg.solve(s * np.eye(4) - M.A, M.B.astype(complex)) for M in (first, second)]
    assert np.isclose(*G)
    assert are_isomorphic(second, phc.ph(np.diag([1.0, 3.0, 1.0, 2.0]), B))


def test_an_isomorphism_is_symplectic_only_where_the_port_reaches():
    hidden = phc.ph(np.diag([1.0, 2.0, 1.0, 2.0]), [1.0, 0.0, 0.0, 0.0])
    L = np.diag([1.0, 7.0, 1.0, 7.0])
    assert is_morphism(L, hidden, hidden) and not phc.is_symplectic(L)


def test_several_ports_are_matched_by_their_residue_matrices():
    rng = np.random.default_rng(5)
    Q, _ = random_hamiltonian([1.0, 1.0, 1.0, 4.0], rng)
    B = rng.standard_normal((8, 2))
    first = phc.ph(Q, B)
    S = random_symplectic(4, rng)
    inverse = np.linalg.inv(S)
    moved = inverse.T @ Q @ inverse
    assert are_isomorphic(first, phc.ph(0.5 * (moved + moved.T), S @ B))
    assert not are_isomorphic(first, phc.ph(0.5 * (moved + moved.T), S @ B @ np.diag([1.0, 1 + 1e-6])))


def test_systems_with_rigid_bodies_are_matched_through_their_eigenvalues():
    Q = np.diag([0.0, 4.0, 1.0, 1.0])
    rng = np.random.default_rng(2)
    T = np.linalg.inv(random_symplectic(2, rng))
    moved = T.T @ Q @ T
    first = phc.ph(Q, [0.0, 0.0, 1.0, 1.0])
    second = phc.ph(0.5 * (moved + moved.T), np.linalg.inv(T) @ np.array([0.0, 0.0, 1.0, 1.0]))
    verdict = are_isomorphic(first, second, rtol=1e-6)
    assert verdict and verdict.residual < 1e-7


# --- any systems -------------------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.integers(0, 4))
def test_the_states_of_a_plain_system_map_to_those_of_its_port_hamiltonian_form(case, exponents):
    d, v, rng = pair(case[0], "decade", case[2])
    n = len(d)
    T = random_symplectic(n, rng, 0.5) @ np.diag(2.0 ** rng.integers(-exponents, exponents + 1, 2 * n))
    first = dense(d, v, T)
    form = phc.ph(first)
    L = system_isomorphism(first, form)
    assert L is not None
    truth, left, free = dense_solutions(first, form)
    assert left < 1e-8 and len(free) == 0
    assert np.linalg.norm(L - truth) <= 1e-6 * np.linalg.norm(truth)
    assert is_morphism(L, first, form).residual <= 1000 * n * EPS * np.linalg.cond(T)


@SETTINGS
@given(cases)
def test_clustered_and_repeated_spectra_are_matched_in_blocks(case):
    d, v, rng = pair(min(case[0], 6), case[1], case[2])
    first, second = (dense(d, v, random_symplectic(len(d), rng, 0.3)) for _ in range(2))
    verdict = are_isomorphic(first, second)
    assert verdict, verdict.reason
    assert is_morphism(verdict.witness, first, second).residual <= verdict.allowed < 1e-6


@pytest.mark.parametrize("seed", range(10))
def test_damped_systems_of_several_ports_and_jordan_blocks_are_matched(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5))
    if seed % 2:
        A = np.diag([-1.0, -1.0, -2.0, -2.0, -2.0]) + np.diag([1.0, 0.0, 1.0, 1.0], 1)
    B, C, T = rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), rng.standard_normal((5, 5))
    first, second = plain(A, B, C), plain(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T))
    verdict = are_isomorphic(first, second)
    assert verdict, verdict.reason
    assert np.linalg.norm(verdict.witness - T) <= 1e-8 * np.linalg.norm(T) * np.linalg.cond(T)
    assert not are_isomorphic(first, plain(second.A, 1.001 * second.B, second.C))


def test_a_jordan_block_is_not_matched_with_two_simple_eigenvalues():
    block, simple = (plain(np.array([[-1.0, x], [0.0, -1.0]]), np.zeros((2, 1)), np.zeros((1, 2))) for x in (1.0, 0.0))
    assert are_isomorphic(block, block) and are_isomorphic(simple, simple)
    assert not are_isomorphic(block, simple)


def test_discrete_systems_are_matched():
    first = ct.StateSpace([[0.5, 1.0], [0.0, 0.2]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0, 0.1)
    second = ct.StateSpace([[0.5, 2.0], [0.0, 0.2]], [[0.0], [0.5]], [[1.0, 0.0]], 0.0, 0.1)
    assert np.allclose(system_isomorphism(first, second), np.diag([1.0, 0.5]))


@pytest.mark.slow
@SETTINGS
@given(st.integers(1, 6), st.integers(0, 10**6))
def test_canonical_systems_are_isomorphic_to_both_of_their_canonical_forms(n, seed):
    d, v, rng = pair(n, "decade", seed)
    sys = target(d, v, random_symplectic(n, rng, 0.3))
    gaps = np.diff(np.sort(d))
    if n > 1 and gaps.min() < 1e-2:
        return
    ch, oh = plain(*companion(d, v)), transposed(*companion(d, v))
    for first, second in ((ch, sys), (sys, oh), (ch, oh)):
        assert are_isomorphic(first, second, rtol=1e-9), (first, second)


def test_canonical_forms_of_noncanonical_pairs_are_not_isomorphic_to_their_port_hamiltonian_system():
    d, v = np.array([1.0, 2.0]), np.array([1.0, 0.0, 0.0, 0.0])
    sys = phc.ph(np.diag(np.r_[d, d]), v)
    ch, oh = plain(*companion(d, v)), transposed(*companion(d, v))
    for first, second in ((ch, sys), (sys, oh), (ch, oh)):
        assert not are_isomorphic(first, second)
    assert are_isomorphic(ch, ch) and are_isomorphic(oh, oh)


@pytest.mark.parametrize("seed", range(10))
def test_what_the_input_reaches_in_one_system_only_is_not_hidden_by_a_change_of_states(seed):
    """The morphism is singular, but for rounding."""
    rng = np.random.default_rng(seed)
    d, v = np.array([1.0, 2.0]), np.array([1.0, 0.0, 0.0, 0.0])
    T = random_symplectic(2, rng, 1.0)
    reached = companion(d, v)
    verdict = are_isomorphic(plain(*reached), dense(d, v, T))
    assert not verdict and "in one of them only" in verdict.reason


@pytest.mark.slow
@SETTINGS
@pytest.mark.filterwarnings("ignore::UserWarning")  # companion matrices of clustered frequencies hold no digits of them
@given(st.integers(1, 8), st.sampled_from(["decade", "wide", "clustered"]), st.integers(0, 10**6))
def test_canonical_form_objects_are_linked_through_their_modes_where_companion_matrices_know_nothing(n, kind, seed):
    d, v, rng = pair(n, kind, seed)
    order = rng.permutation(n)
    other = d[order], v[np.r_[order, n + order]]
    systems = [phc.ph(np.diag(np.r_[d, d]), v), phc.ch(d, v), phc.oh(*other), phc.ch(*other)]
    for first in systems:
        for second in systems:
            verdict = are_isomorphic(first, second)
            assert verdict, verdict.reason
            assert is_morphism(verdict.witness, first, second).residual <= 1000 * n * EPS
        assert not are_isomorphic(first, phc.ch(d * (1 + 1e-9), v))


def test_the_links_between_canonical_forms_are_inverse_to_one_another():
    d, v, _ = pair(5, "decade", 1)
    ch, oh, sys = phc.ch(d, v), phc.oh(d, v), phc.ph(np.diag(np.r_[d, d]), v)
    for first, second in ((ch, sys), (oh, sys), (ch, oh)):
        there, back = system_isomorphism(first, second), system_isomorphism(second, first)
        loop = there @ back
        assert np.all(np.abs(loop - np.eye(10)) <= 1e3 * EPS * (np.abs(there) @ np.abs(back)))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_canonical_form_objects_of_resonant_pairs_are_isomorphic_to_their_own_kind_only():
    d, v, w = [1.0, 1.0, 2.0], [1.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 1.0, 0.0, 0.0, 0.0]
    kinds = (phc.ch, phc.oh, lambda d, v: phc.ph(np.diag(np.r_[d, d]), v))
    for j, first in enumerate(kinds):
        for k, second in enumerate(kinds):
            verdict = are_isomorphic(first(d, v), second(d, w))
            assert bool(verdict) == (j == k), verdict.reason


def test_a_hundred_equal_modes_are_linked_without_a_system_of_their_square():
    """The equations of all entries at once would take 200^2 x 200^2 numbers."""
    v = np.random.default_rng(0).standard_normal(200)
    sys = phc.ph(np.eye(200), v)
    other = phc.ph(np.eye(200), np.roll(v, 1))
    verdict = are_isomorphic(sys, ct.ss(other))
    assert verdict and is_morphism(verdict.witness, sys, other).residual <= 1e-12
    assert not are_isomorphic(sys, ct.ss(phc.ph(np.eye(200), 1.0001 * v)))


@pytest.mark.parametrize(("ports", "outputs"), [(1, 1), (2, 1), (1, 3), (3, 3)])
@pytest.mark.parametrize("n", [1, 2, 4])
def test_semisimple_blocks_are_solved_as_dense_algebra_does(n, ports, outputs):
    rng = np.random.default_rng(n)
    A, T = -2.0 * np.eye(n), rng.standard_normal((n, n))
    B, C = rng.standard_normal((n, ports)), rng.standard_normal((outputs, n))
    first, second = plain(A, B, C), plain(A, T @ B, C @ np.linalg.inv(T))
    verdict = are_isomorphic(first, second)
    assert verdict and dense_solutions(first, second)[1] < 1e-10
    L = verdict.witness
    size = 1e3 * EPS * np.linalg.cond(T) ** 2
    assert np.linalg.norm(L @ B - second.B) <= size * np.linalg.norm(second.B)
    assert np.linalg.norm(second.C @ L - C) <= size * np.linalg.norm(C)
    assert not are_isomorphic(first, plain(A, T @ B, 1.01 * C @ np.linalg.inv(T)))


def test_a_jordan_block_too_large_for_its_equations_is_refused():
    J = np.diag(-np.ones(30)) + np.diag(np.ones(29), 1)
    sys = plain(J, np.ones((30, 1)), np.ones((1, 30)))
    with pytest.raises(phc.StructureError, match="more than 24 eigenvalues coincide"):
        are_isomorphic(sys, sys)


@pytest.mark.parametrize("size", [1e-100, 1e-30, 1e-8, 1e8, 1e30, 1e100])
def test_isomorphisms_of_plain_systems_are_found_in_any_unit_without_a_warning(size):
    sys = phc.ph(size * np.eye(2), [size, 0.0])
    assert are_isomorphic(ct.ss(sys), phc.ph(size * np.eye(2), [0.0, size]))
    assert not are_isomorphic(ct.ss(sys), phc.ph(size * np.eye(2), [0.0, 1.1 * size]))


@pytest.mark.parametrize("size", [1e-8, 1e8, 1e30])
def test_canonical_forms_are_linked_in_any_unit_of_time_without_a_warning(size):
    first, second = phc.ch([size, 2 * size], np.ones(4)), phc.oh([size, 2 * size], np.ones(4))
    assert are_isomorphic(first, first) and are_isomorphic(first, second)


@pytest.mark.parametrize("size", [1e-70, 1e70])
def test_an_isomorphism_beyond_the_range_of_doubles_is_refused_not_denied(size):
    with pytest.raises(phc.StructureError, match="the entries of the isomorphism leave the range"):
        are_isomorphic(phc.oh([size, 2 * size], np.ones(4)), phc.ch([size, 2 * size], np.ones(4)))


# --- verdicts and refusals ---------------------------------------------------------------------------------------


def test_systems_of_different_sizes_are_not_isomorphic():
    small, large = phc.ph(np.eye(2), [1.0, 0.0]), phc.ph(np.eye(4), [1.0, 0.0, 0.0, 0.0])
    assert are_isomorphic(small, large).reason == "they have 2 and 4 states"


def test_systems_without_states_compare_by_their_feedthrough():
    gain = [ct.StateSpace([], [], [], [[x]]) for x in (1.0, 1.0, 2.0)]
    assert are_isomorphic(gain[0], gain[1]) and not are_isomorphic(gain[0], gain[2])


def test_bad_arguments_are_refused():
    sys = phc.ph(np.eye(2), [1.0, 0.0])
    for other, message in (
        (ct.tf([1, 0], [1, 0, 1]), "TransferFunction"),
        (phc.ph(np.eye(2), np.eye(2)), "must agree"),
        (ct.StateSpace(np.eye(2), np.eye(2)[:, :1], np.eye(2)[:1], 0, 0.1), "time bases"),
    ):
        with pytest.raises(phc.StructureError, match=message):
            are_isomorphic(sys, other)
    with pytest.raises(phc.StructureError, match="rtol"):
        are_isomorphic(sys, sys, rtol=2)

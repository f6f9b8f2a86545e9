"""Statements of the paper that no other test holds: symmetries, genericity, quotients, lifting, the diagram.

Ranks and characteristic polynomials are computed in exact fractions, everything else from dense matrices.
"""

from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_systems import SETTINGS, companion, pair, plain, target, transposed
from reference import DIGITS, EPS, coefficients, random_hamiltonian, random_symplectic, symplectic_form
from scipy.linalg import block_diag, expm, polar

import ph_control as phc

seeds = st.integers(0, 10**6)
kinds = st.sampled_from(["decade", "repeated", "dark"])
cases = st.tuples(st.integers(1, 6), kinds, seeds)


def weights(v):
    n = len(v) // 2
    return v[:n] ** 2 + v[n:] ** 2


def choice(n, rng):
    """Pair of whole numbers, some frequencies repeated and some weights 0."""
    return rng.choice([1.0, 2.0, 5.0], n), rng.choice([0.0, 1.0, 2.0], 2 * n)


# --- Section 2: symplectic matrices, controllability -----------------------------------------------------------------


def characteristic_polynomial(A):
    """Coefficients by the Faddeev-LeVerrier recursion in exact fractions, from the highest power."""
    n = len(A)
    A = [[Fraction(int(x)) for x in row] for row in A]
    M, c = [[Fraction(0)] * n for _ in range(n)], [Fraction(1)]
    for k in range(1, n + 1):
        M = [[sum(A[i][l] * M[l][j] for l in range(n)) + c[-1] * (i == j) for j in range(n)] for i in range(n)]
        c.append(-sum(A[i][l] * M[l][i] for i in range(n) for l in range(n)) / k)
    return c


@SETTINGS
@given(st.integers(1, 3), seeds)
def test_the_characteristic_polynomial_of_an_infinitesimally_symplectic_matrix_is_even(n, seed):
    rng = np.random.default_rng(seed)
    R = rng.integers(-5, 6, (2 * n, 2 * n))
    A = symplectic_form(n) @ (R + R.T)
    assert phc.is_hamiltonian_matrix(A)
    assert not any(characteristic_polynomial(A)[1::2])
    other = A + np.eye(2 * n)
    assert not phc.is_hamiltonian_matrix(other) and any(characteristic_polynomial(other)[1::2])


@SETTINGS
@given(st.integers(1, 5), seeds)
def test_the_flow_of_an_infinitesimally_symplectic_matrix_is_symplectic_and_that_of_another_is_not(n, seed):
    rng = np.random.default_rng(seed)
    R = rng.standard_normal((2 * n, 2 * n))
    J = symplectic_form(n)
    A = J @ (R + R.T) / (4 * n)
    assert np.abs(A.T @ J + J @ A).max() <= 8 * EPS and phc.is_hamiltonian_matrix(A)
    assert phc.is_symplectic(expm(A)) and phc.is_symplectic(expm(-3 * A))
    assert not phc.is_symplectic(expm(A + 1e-6 * np.eye(2 * n)))


@SETTINGS
@given(st.integers(1, 6), seeds)
def test_a_matrix_in_two_of_the_orthogonal_complex_and_symplectic_groups_is_in_the_third_and_unitary(n, seed):
    rng = np.random.default_rng(seed)
    J, eye, allowed = symplectic_form(n), np.eye(2 * n), 1e3 * n * EPS
    U = np.linalg.qr(rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))[0]
    orthogonal_complex = np.block([[U.real, -U.imag], [U.imag, U.real]])
    assert phc.is_symplectic(orthogonal_complex)
    # the orthogonal factor of a symplectic matrix is symplectic
    orthogonal_symplectic = polar(random_symplectic(n, rng))[0]
    assert phc.is_symplectic(orthogonal_symplectic)
    assert np.abs(orthogonal_symplectic @ J - J @ orthogonal_symplectic).max() <= allowed
    # the flow of a Hamiltonian matrix that commutes with J
    R = rng.standard_normal((2 * n, 2 * n))
    H = J @ (R + R.T)
    complex_symplectic = expm((H - J @ H @ J) / (4 * n))
    assert phc.is_symplectic(complex_symplectic)
    assert np.abs(complex_symplectic.T @ complex_symplectic - eye).max() <= allowed
    # none of the three groups is in another
    assert not phc.is_symplectic(np.diag(np.r_[-1.0, np.ones(2 * n - 1)])) and not phc.is_symplectic(2 * eye)
    squeeze = random_symplectic(n, rng) @ np.diag(np.r_[np.full(n, 2.0), np.full(n, 0.5)])
    assert np.abs(squeeze.T @ squeeze - eye).max() > 0.1 < np.abs(squeeze @ J - J @ squeeze).max()


def exact_rank(rows):
    """Rank by Gaussian elimination in exact fractions."""
    rows, rank = [[Fraction(int(x)) for x in row] for row in rows], 0
    for column in range(len(rows[0])):
        pivot = next((i for i in range(rank, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for i in range(rank + 1, len(rows)):
            factor = rows[i][column] / rows[rank][column]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[rank], strict=True)]
        rank += 1
    return rank


@SETTINGS
@given(st.integers(1, 3), seeds, st.booleans(), st.booleans())
def test_controllable_and_definite_is_observable_is_canonical(n, seed, singular, uncoupled):
    rng = np.random.default_rng(seed)
    F = rng.integers(-2, 3, (2 * n, 2 * n))
    if uncoupled:
        F = np.diag(rng.integers(1, 4, 2 * n))
    if singular:
        F[rng.integers(2 * n)] = 0
    Q, B = F.T @ F, rng.integers(-1, 2, 2 * n)
    A = [[int(x) for x in row] for row in symplectic_form(n) @ Q]
    reached, seen = [B.tolist()], [(B @ Q).tolist()]
    for _ in range(2 * n - 1):
        reached.append([sum(a * x for a, x in zip(row, reached[-1], strict=True)) for row in A])
        seen.append([sum(x * A[i][j] for i, x in enumerate(seen[-1])) for j in range(2 * n)])
    controllable, observable = exact_rank(reached) == 2 * n, exact_rank(seen) == 2 * n
    definite = exact_rank(Q) == 2 * n
    assert observable == (controllable and definite)
    assert phc.ph(Q, B).is_canonical == observable


# --- Section 3: the canonical forms ----------------------------------------------------------------------------------


@SETTINGS
@given(cases)
@pytest.mark.filterwarnings("ignore::ph_control.ConditioningWarning")
def test_the_two_forms_are_transposes_controllable_and_observable_by_construction(case):
    d, v, _ = pair(*case)
    ch, oh = phc.ch(d, v), phc.oh(d, v)
    assert np.array_equal(ch.A, oh.A.T) and np.array_equal(ch.B, oh.C.T) and np.array_equal(ch.C, oh.B.T)
    # [B, A B ..] is 0 above the antidiagonal and 1 on it, whatever d and v are
    columns = [ch.B[:, 0]]
    for _ in range(2 * len(d) - 1):
        columns.append(ch.A @ columns[-1])
    reached = np.array(columns).T[::-1]
    assert np.array_equal(np.tril(reached, -1), np.zeros_like(reached)) and np.array_equal(
        np.diag(reached), columns[0] * 0 + 1
    )


@SETTINGS
@given(cases)
def test_the_coefficients_do_not_change_under_permutations_and_turns_of_the_modes(case):
    d, v, rng = pair(*case)
    n = len(d)
    ch = phc.ch(d, v)
    moved_d, moved_v = phc.act(rng.permutation(n), rng.uniform(-9, 9, n), d, v)
    moved = phc.ch(moved_d, moved_v)
    assert np.array_equal(moved.a, ch.a)
    assert np.all(np.abs(moved.c - ch.c) <= 64 * n * EPS * np.abs(ch.c))
    stretched = v.copy()
    stretched[0] += 1.0 + abs(v[0])
    assert not np.allclose(phc.ch(d, stretched).c, ch.c, rtol=1e-9)


@SETTINGS
@given(st.integers(1, 5), seeds)
def test_the_map_from_weights_to_numerator_coefficients_has_the_determinant_of_the_paper(n, seed):
    """The step of Proposition 4.19: the rows F_k are independent iff no frequency is repeated."""
    d = np.random.default_rng(seed).choice(np.arange(1.0, 8.0), n)
    F = np.array([phc.ch(d, np.eye(2 * n)[l]).c for l in range(n)]).T
    if len(set(d)) < n:  # mpmath may find no pivot
        assert np.linalg.matrix_rank(F) < n
        return
    with mp.workdps(DIGITS):
        found = mp.det(mp.matrix(F.tolist())) if n > 1 else mp.mpf(F[0, 0])
        expected = mp.fprod(d.tolist()) * mp.fprod(d[j] ** 2 - d[k] ** 2 for k in range(n) for j in range(k))
    assert abs(abs(found) - abs(expected)) <= 1e-30


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_a_free_hamiltonian_system_with_any_readout_is_an_observable_form_whatever_its_input(n):
    """Without input: `y = c^T z` for any c, since `c = Q b` has a solution; g2 plays no part."""
    rng = np.random.default_rng(n)
    d = np.cumsum(rng.uniform(0.5, 1.5, n))
    Q, _ = random_hamiltonian(d, rng)
    readout, z0, t = rng.standard_normal(2 * n), rng.standard_normal(2 * n), np.linspace(0, 5, 51)
    truth = np.array([readout @ expm(x * symplectic_form(n) @ Q) @ z0 for x in t])
    s0 = phc.observable_morphism(phc.ph(Q, np.linalg.solve(Q, readout))) @ z0
    for v in (np.zeros(2 * n), rng.standard_normal(2 * n)):
        free = phc.initial_response(phc.oh(d, v), t, s0).outputs
        assert np.abs(free - truth).max() <= 1e-10 * np.abs(truth).max()


# --- Section 4: what the filter determines ---------------------------------------------------------------------------


@SETTINGS
@given(st.integers(1, 5), seeds, st.booleans())
@pytest.mark.filterwarnings("ignore::ph_control.ConditioningWarning")
def test_controllable_forms_are_isomorphic_exactly_when_observable_forms_are(n, seed, same):
    rng = np.random.default_rng(seed)
    d, v = choice(n, rng)
    d2, v2 = phc.act(rng.permutation(n), rng.uniform(0, 6, n), d, v) if same else choice(n, rng)
    (a1, c1), (a2, c2) = coefficients(d, weights(v)), coefficients(d2, weights(v2))
    equal = a1 == a2 and np.allclose([float(x) for x in c1], [float(x) for x in c2], rtol=1e-12, atol=1e-12)
    for form in (phc.ch, phc.oh):
        assert bool(phc.are_isomorphic(form(d, v), form(d2, v2))) == equal
    # the isomorphism can only be the identity: it keeps the input and commutes with the companion matrix
    if equal:
        for dense in (plain, transposed):
            assert phc.is_morphism(np.eye(2 * n), dense(*companion(d, v)), dense(*companion(d2, v2)), rtol=1e-12)


@SETTINGS
@given(cases)
def test_the_class_of_the_image_of_a_pair_does_not_depend_on_the_symplectic_matrix(case):
    d, v, rng = pair(*case)
    S1, S2 = (random_symplectic(len(d), rng) for _ in range(2))
    form = phc.ch(d, v)
    first, second = form.port_hamiltonian(S1), form.port_hamiltonian(S2)
    assert phc.is_morphism(np.linalg.solve(S2, S1), first, second, rtol=1e-10)
    assert phc.are_isomorphic(first, second)
    assert phc.are_isomorphic(first, phc.ph(np.diag(np.r_[d, d]), v))


@SETTINGS
@given(cases)
def test_canonical_systems_are_open_and_dense(case):
    d, v, rng = pair(*case)
    n = len(d)
    Q, B = np.diag(np.r_[d, d]), v
    small = 1e-6
    R = rng.standard_normal((2 * n, 2 * n))
    near = phc.ph(Q + small * (R + R.T), B + small * rng.standard_normal(2 * n))
    assert near.is_canonical  # whether the system itself is or not
    margins = phc.canonical_margins(near)
    # a perturbation far below both margins leaves it canonical
    step = 1e-3 * min(margins.resonance, margins.degeneracy, 1.0) * d.min() / (4 * n)
    assert phc.ph(near.Q + step * (R + R.T), near.B * (1 + step)).is_canonical
    assert phc.ph(Q, B).is_canonical == (len(set(d.tolist())) == n and weights(v).min() > 0)


@SETTINGS
@given(st.integers(1, 6), seeds)
def test_only_the_identity_of_the_group_keeps_a_canonical_pair(n, seed):
    rng = np.random.default_rng(seed)
    d, v, _ = pair(n, "decade", seed)
    for sigma in (np.arange(n), rng.permutation(n)):
        for theta in (np.zeros(n), 2 * np.pi * rng.integers(-2, 3, n), rng.uniform(0.1, 6.1, n)):
            moved_d, moved_v = phc.act(sigma, theta, d, v)
            kept = np.array_equal(moved_d, d) and np.allclose(moved_v, v, rtol=0, atol=100 * EPS)
            assert kept == (np.array_equal(sigma, np.arange(n)) and np.allclose(np.cos(theta), 1))
    # a mode that is not reached turns freely, equal modes change places
    assert np.array_equal(phc.act([0], [1.0], [2.0], [0.0, 0.0])[1], [0.0, 0.0])
    assert np.array_equal(phc.act([1, 0], [0.0, 0.0], [2.0, 2.0], [1.0, 1.0, 3.0, 3.0])[1], [1.0, 1.0, 3.0, 3.0])


@SETTINGS
@given(st.integers(1, 3), seeds)
def test_frequencies_and_weights_are_local_coordinates_of_filters_exactly_where_the_pair_is_canonical(n, seed):
    """2n coordinates where Q and B have 2 n^2 + 3 n entries: the Jacobian of the 2n filter coefficients."""
    rng = np.random.default_rng(seed)
    d, r = rng.choice(np.arange(1.0, 5.0), n), rng.choice([0.0, 1.0, 2.0], n)

    def jacobian(h=1e-5):
        columns = []
        for k in range(2 * n):
            e = []
            for sign in (1, -1):
                x = np.r_[d, r]
                x[k] += sign * h + (h if k >= n else 0)  # weights stay positive; the coefficients are linear in them
                e.append(phc.filter_coefficients(x[:n], np.r_[np.sqrt(x[n:]), np.zeros(n)]))
            columns.append((e[0] - e[1]) / (2 * h))
        return np.array(columns).T

    M = jacobian() / d.max() ** (2.0 * np.arange(2 * n)[:, None])
    smallest = np.linalg.svd(M / np.maximum(np.linalg.norm(M, axis=0), 1e-3), compute_uv=False)[-1]
    canonical = len(set(d.tolist())) == n and r.min() > 0
    assert (smallest > 1e-6) == canonical


def test_the_arrows_from_a_system_that_no_input_reaches_fill_a_larger_space_than_those_from_others():
    """Propositions 4.11 and 4.13 call the groupoids Lie groupoids.  For n = 1 an arrow from (Q, B) with B not 0 is
    any L of determinant 1 (dimension 3), from (Q, 0) any of positive determinant (dimension 4): no submersion has
    fibres of two dimensions over a connected base.  Over canonical systems both are those of group actions.
    """
    rng = np.random.default_rng(0)
    reached, unreached = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]), phc.ph(np.diag([4.0, 1.0]), [0.0, 0.0])
    for _ in range(20):
        L = rng.standard_normal((2, 2))
        unit = L / np.sqrt(abs(np.linalg.det(L)))
        for matrix in (L, unit):
            determinant = np.linalg.det(matrix)
            assert phc.PortHamiltonianGroupoid.is_arrow(matrix, unreached) == (determinant > 0)
            assert phc.PortHamiltonianGroupoid.is_arrow(matrix, reached) == (abs(determinant - 1) < 1e-12)
    for scale in (1.0, 2.0):
        assert phc.ReducedGroupoid.is_arrow([[1.0]], scale * np.eye(2), [1.0], [0.0, 0.0])
        assert phc.ReducedGroupoid.is_arrow([[1.0]], scale * np.eye(2), [1.0], [0.0, 1.0]) == (scale == 1.0)


# --- Section 5: higher dimensions ------------------------------------------------------------------------------------


def exchange(n, m):
    """Permutation matrix O with `O diag(J_n, J_{m-n}) O^T = J_m`."""
    O = np.zeros((2 * m, 2 * m))
    places = np.r_[0:n, m : m + n, n:m, m + n : 2 * m]
    O[places, np.arange(2 * m)] = 1.0
    return O


@SETTINGS
@given(cases, st.integers(1, 3))
@pytest.mark.filterwarnings("ignore:.*Jordan blocks:UserWarning")
def test_lifting_by_ones_pads_the_frequencies_with_ones_and_the_two_halves_of_v_with_zeros(case, more):
    d, v, rng = pair(*case)
    n = len(d)
    m = n + more
    S = random_symplectic(n, rng)
    sys = target(d, v, S)
    large = phc.lift(sys, m, padding="ones")
    O = exchange(n, m)
    assert np.array_equal(O @ block_diag(symplectic_form(n), symplectic_form(more)) @ O.T, symplectic_form(m))
    assert np.array_equal(large.Q, O @ block_diag(sys.Q, np.eye(2 * more)) @ O.T)
    assert np.array_equal(large.B[:, 0], O @ np.r_[sys.B[:, 0], np.zeros(2 * more)])
    # Williamson's matrix of the lifted energy, and with it v'
    lifted = O @ block_diag(S, np.eye(2 * more)) @ O.T
    assert phc.is_symplectic(lifted)
    padded = np.r_[d, np.ones(more)]
    size = 1e3 * n * EPS * np.linalg.cond(S) ** 2 * max(d.max(), 1.0)
    assert np.abs(lifted.T @ np.diag(np.r_[padded, padded]) @ lifted - large.Q).max() <= size
    expected = np.r_[v[:n], np.zeros(more), v[n:], np.zeros(more)]
    assert np.abs(lifted @ large.B[:, 0] - expected).max() <= size * np.abs(v).max()
    assert np.allclose(large.d, np.sort(padded), rtol=size / d.min())
    assert not large.is_canonical


@SETTINGS
@given(st.integers(1, 4), st.integers(1, 3), seeds, st.booleans())
@pytest.mark.filterwarnings("ignore:.*(Jordan blocks|is repeated):UserWarning")
def test_lifted_systems_are_isomorphic_exactly_when_the_systems_are(n, more, seed, same):
    rng = np.random.default_rng(seed)
    d, v = choice(n, rng)  # with frequencies that the padding repeats
    d2, v2 = phc.act(rng.permutation(n), rng.uniform(0, 6, n), d, v) if same else choice(n, rng)
    small = bool(phc.are_isomorphic(*(phc.ph(np.diag(np.r_[x, x]), y) for x, y in ((d, v), (d2, v2)))))
    large = [
        phc.lift(target(x, y, random_symplectic(n, rng, 0.3)), n + more, padding="ones") for x, y in ((d, v), (d2, v2))
    ]
    assert bool(phc.are_isomorphic(*large)) == small
    ones, none = np.ones(more), np.zeros(more)
    pairs = [(np.r_[x, ones], np.r_[y[:n], none, y[n:], none]) for x, y in ((d, v), (d2, v2))]
    assert bool(phc.star_equivalent(*pairs[0], *pairs[1])) == small


# --- Section 6: the diagram ------------------------------------------------------------------------------------------


@SETTINGS
@given(st.integers(1, 5), seeds, st.booleans(), st.booleans())
def test_the_diagram_of_quotients_commutes_on_canonical_systems(n, seed, same, lifted):
    """Every path from two systems to a verdict, and from a system to coordinates and back, gives the same."""
    rng = np.random.default_rng(seed)
    d, v, _ = pair(n, "decade", seed)
    d2, v2 = phc.act(rng.permutation(n), rng.uniform(0, 6, n), d, v)
    if not same:
        v2[rng.integers(2 * n)] += 0.5
    first, second = target(d, v, random_symplectic(n, rng, 0.3)), target(d2, v2, random_symplectic(n, rng, 0.3))
    # PH / ~sys, PH / ~filter, PH / G_n
    assert bool(phc.are_isomorphic(first, second)) == bool(phc.same_filter(first, second)) == same
    # (d, v) / ~star, (d, v) / H_n; (d, v) / ~sys
    assert bool(phc.star_equivalent(d, v, d2, v2)) == same
    assert bool(phc.are_isomorphic(phc.oh(d, v), phc.oh(d2, v2))) == same
    if same:
        arrow = phc.PortHamiltonianGroupoid.between(first, second)
        reduced = phc.ReducedGroupoid.between(d, v, d2, v2)
        assert np.allclose(arrow.target.Q, second.Q, atol=1e-9 * np.abs(second.Q).max())
        assert np.allclose(reduced.target[1], v2, atol=1e-12)
        assert phc.is_symplectic(arrow.L, rtol=1e-9)  # between canonical systems the groupoid is that of Sp(2n)
    # X x R_+: the coordinates of the system are those of its orbit, and their section has the same filter
    unique, r = phc.to_unique(d, v)
    assert np.allclose(first.d, unique, rtol=1e-9) and np.allclose(first.r, r, rtol=1e-8)
    assert np.allclose(phc.to_unique(d2, v2)[1], r, rtol=1e-9) == same
    assert phc.same_filter(phc.ch(*phc.from_unique(unique, r)), (d, v))
    if lifted:
        assert bool(phc.same_filter(phc.lift(first, n + 2), phc.lift(second, n + 1))) == same


# --- Appendix: integrators -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("h", [1e-3, 1.0, 1e3, 1e6])
def test_the_midpoint_step_of_both_forms_exists_for_every_step_size(h):
    """The paper asks for small h; `I - h/2 A` has the eigenvalues `1 ± i h d/2`, never 0."""
    d, v = np.array([1.0, 2.0]), np.array([1.0, 0.5, 0.2, -0.3])
    for form in (phc.ch, phc.oh):
        step = phc.sample(form(d, v), h, "midpoint").A
        expected = np.sort(2 * np.arctan(h * d / 2))
        angles = np.sort(np.abs(np.angle(np.linalg.eigvals(step))))[::2]
        assert np.abs(angles - expected).max() <= 1e-9
        assert abs(np.linalg.det(step) - 1) <= 1e-9


def test_the_midpoint_step_is_determined_up_to_the_kernel_of_the_morphism():
    d, v = np.array([1.0, 2.0]), np.array([1.0, 0.0, 0.0, 0.0])
    L = phc.controllable_morphism(d, v)
    kernel = np.linalg.svd(L)[2][2:]
    assert np.abs(L @ kernel.T).max() < 8 * EPS
    form, h, s = phc.ch(d, v), 0.1, np.array([0.3, -0.2, 0.5, 1.0])
    step = phc.sample(form, h, "midpoint").A
    moved = np.linalg.solve(np.eye(4) - h / 2 * form.A, (np.eye(4) + h / 2 * form.A) @ s + kernel[0])
    assert np.abs(moved - step @ s).max() > 0.1
    # the kernel is invariant, so the states of the port-Hamiltonian system do not see the choice
    assert np.abs(L @ (moved - step @ s)).max() < 64 * EPS


def test_the_forced_midpoint_rule_has_the_force_times_the_step():
    """The paper prints the force without h; the balance of energy then fails."""
    sys, h = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]), 0.1
    u = np.random.default_rng(0).standard_normal(200)
    z = phc.forced_response(sys, h * np.arange(200), u, [1.0, 0.0], method="midpoint", intersample="zoh").states
    residual = np.diff(z) - h * sys.A @ (z[:, 1:] + z[:, :-1]) / 2
    assert np.abs(residual - h * sys.B * u[:-1]).max() < 64 * EPS
    assert np.abs(residual - sys.B * u[:-1]).max() > 0.5

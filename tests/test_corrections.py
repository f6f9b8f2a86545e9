"""The places where the paper's text is wrong: what is right holds, what is printed fails, both computed.

The numbers are those of the section "Corrections" in docs/paper.md.
"""

from fractions import Fraction
from itertools import combinations
from math import prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import (
    EPS,
    dense_matrices,
    dense_transfer_function,
    random_hamiltonian,
    random_symplectic,
    symplectic_form,
)

import ph_control as phc

relaxed = settings(deadline=None, max_examples=13, derandomize=True)
sizes, seeds = st.integers(1, 6), st.integers(0, 2**32 - 1)
POINTS = np.array([0.3 + 0.7j, 2.0 - 1.0j, 5.0])


def distinct(n, rng):
    return np.cumsum(rng.uniform(0.5, 1.5, n))


def dense_values(Q, B):
    return np.array([dense_transfer_function(*dense_matrices(Q, B), s)[0, 0] for s in POINTS])


# --- 1: v = S B ------------------------------------------------------------------------------------------------------


@relaxed
@given(sizes, seeds, st.sampled_from([phc.ch, phc.oh]))
def test_1_the_canonical_forms_of_a_system_have_v_equal_to_S_B_and_not_to_the_inverse_of_S_times_B(n, seed, form):
    rng = np.random.default_rng(seed)
    d = distinct(n, rng)
    Q, S = random_hamiltonian(d, rng)
    B = rng.standard_normal(2 * n)
    truth = dense_values(Q, B)
    allowed = 1e4 * n * EPS * np.linalg.norm(S, 2) ** 2 * (1 + np.abs(truth).max())
    assert np.abs(form(d, S @ B)(POINTS) - truth).max() <= allowed
    assert np.abs(form(d, np.linalg.solve(S, B))(POINTS) - truth).max() > 1e3 * allowed
    # the package takes the first
    sys = phc.ph(Q, B)
    assert np.abs(form(sys)(POINTS) - truth).max() <= allowed
    assert np.linalg.norm(sys.v - sys.S @ B) <= 64 * EPS * np.linalg.norm(sys.S, 2) * np.linalg.norm(B)


# --- 2: the transfer function ----------------------------------------------------------------------------------------


@relaxed
@given(sizes, seeds)
def test_2_the_transfer_function_has_the_inverse_that_the_paper_leaves_out(n, seed):
    rng = np.random.default_rng(seed)
    Q, S = random_hamiltonian(distinct(n, rng), rng)
    sys = phc.ph(Q, rng.standard_normal(2 * n))
    A, B, C = dense_matrices(sys.Q, sys.B)
    inverse = np.array([(C @ np.linalg.inv(s * np.eye(2 * n) - A) @ B)[0, 0] for s in POINTS])
    printed = np.array([(C @ (s * np.eye(2 * n) - A) @ B)[0, 0] for s in POINTS])
    allowed = 1e4 * n * EPS * np.linalg.norm(S, 2) ** 2 * (1 + np.abs(inverse).max())
    assert np.abs(sys(POINTS) - inverse).max() <= allowed
    assert np.abs(sys(POINTS) - printed).max() > 1e3 * allowed
    # the printed one is C B s - C A B = C B s, no function of the frequencies at all
    assert np.abs(printed / POINTS - printed[0] / POINTS[0]).max() <= allowed


# --- 3: the coefficients that determine a filter ---------------------------------------------------------------------


def printed_criterion(d, r):
    """`e_1 .. e_n` by the recursion of the paper, in exact fractions."""
    n = len(d)
    squares = [Fraction(x) ** 2 for x in d]

    def elementary(k, left_out=None):
        rest = [x for l, x in enumerate(squares) if l != left_out]
        return sum((prod(s, start=Fraction(1)) for s in combinations(rest, k)), Fraction(0))

    a = [elementary(n - k) for k in range(n)]  # a_0, a_2 ..
    c = [sum(Fraction(x) * Fraction(y) * elementary(k, l) for l, (x, y) in enumerate(zip(d, r, strict=True)))
         for k in range(n)]  # fmt: skip
    e = []
    for k in range(n):
        e.append(c[k] - sum(a[n - 1 - j] * e[k - 1 - j] for j in range(k)))
    return e


def test_3_agreement_of_the_first_n_coefficients_does_not_make_filters_equal():
    first, second = phc.modes(1, 2), phc.modes(2, 1)
    assert printed_criterion([1], [2]) == printed_criterion([2], [1]) == [2]
    assert not phc.same_filter(first, second)
    s = POINTS[0]
    assert (
        abs(first.evaluate(s) - 2 * s / (s**2 + 1)) < 8 * EPS and abs(second.evaluate(s) - 2 * s / (s**2 + 4)) < 8 * EPS
    )
    # nor are the further ones 0, as the proof says: e_2 tells these two apart
    e, f = phc.filter_coefficients([1.0], [1.0, 1.0]), phc.filter_coefficients([2.0], [1.0, 0.0])
    assert e.tolist() == [2, -2] and f.tolist() == [2, -8]


@pytest.mark.parametrize("n", range(1, 6))
def test_3_for_every_n_there_are_different_filters_that_agree_in_the_printed_coefficients(n):
    """The n weights of other frequencies are chosen to give the same n numbers: a Vandermonde system."""
    d = np.arange(1.0, n + 1)
    other = 1.001 * d  # so little that the weights stay positive
    e = phc.filter_coefficients(d, np.r_[np.ones(n), np.zeros(n)])
    assert printed_criterion(d, np.ones(n)) == e[:n].tolist()
    r = np.linalg.solve((-(other**2)) ** np.arange(n)[:, None] * other, e[:n])
    assert r.min() > 0
    f = phc.filter_coefficients(other, np.r_[np.sqrt(r), np.zeros(n)])
    assert np.abs(f[:n] / e[:n] - 1).max() < 1e-10
    assert np.abs(f[n:] / e[n:] - 1).max() > 1e-4
    assert not phc.same_filter(phc.modes(d, np.ones(n)), phc.modes(other, r))


# --- 4: the example of two systems with one filter -------------------------------------------------------------------


def convolution(kernel, t):
    """`integral_0^t kernel(t - s) e^{-s} ds` by Gauss-Legendre quadrature."""
    x, w = np.polynomial.legendre.leggauss(20)
    s = t * (x + 1) / 2
    return t / 2 * np.sum(w * kernel(t - s) * np.exp(-s))


def test_4_the_filter_of_the_example_is_a_cosine_and_its_exponential_is_not():
    t = np.linspace(0, 3, 301)
    u, z0 = np.exp(-t), np.array([0.3, -1.0, 0.7, 2.0])
    right, printed = (np.array([convolution(kernel, x) for x in t]) for kernel in (np.cos, np.exp))
    free = 0.3 * np.cos(t) + 0.7 * np.sin(t)
    for weights in ([1.0, 1.0, 1.0, 1.0], [1.0, 2.0, 1.0, 3.0]):
        sys = phc.ph(np.diag(weights), [1.0, 0.0, 0.0, 0.0])
        y = phc.forced_response(sys, t, u, intersample="foh").outputs
        # an input interpolated over steps h is off by h^2/8 of its curvature
        assert np.abs(y - right).max() < t[1] ** 2 / 8 * t[-1] < 1e-1 < np.abs(y - printed).max()
        motion = phc.initial_response(sys, t, z0).outputs
        assert np.abs(motion - free).max() < 100 * EPS < 1 < np.abs(motion - np.exp(t) * z0[-1]).max()


def test_4_the_two_systems_of_the_example_have_one_filter_and_are_not_isomorphic():
    first, second = (phc.ph(np.diag(w), [1.0, 0.0, 0.0, 0.0]) for w in ([1.0, 1, 1, 1], [1.0, 2, 1, 3]))
    assert phc.same_filter(first, second) and not phc.are_isomorphic(first, second)


# --- 5: the determinant of a symplectic matrix -----------------------------------------------------------------------


@relaxed
@given(sizes, seeds, st.booleans())
def test_5_the_determinant_of_a_symplectic_matrix_is_plus_one_never_minus_one(n, seed, from_williamson):
    rng = np.random.default_rng(seed)
    S = random_symplectic(n, rng)
    if from_williamson:
        S = phc.williamson(random_hamiltonian(distinct(n, rng), rng)[0])[1]
    assert phc.is_symplectic(S)
    assert abs(np.linalg.det(S) - 1) <= 1e3 * n * EPS * np.linalg.cond(S)
    # the printed -1 would be that of the same matrix with two columns exchanged or one reversed
    assert n == 1 or not phc.is_symplectic(S[:, np.r_[1, 0, 2 : 2 * n]])
    assert not phc.is_symplectic(S * np.r_[-1.0, np.ones(2 * n - 1)])


# --- 6: the circuit --------------------------------------------------------------------------------------------------


def test_6_the_circuit_of_the_paper_has_five_branches_and_ten_states():
    """The text says ten branches; the Hamiltonian has five charges and five flux linkages."""
    sys = phc.lc_circuit(np.ones(5), np.ones(5))
    assert sys.state_labels == [f"{letter}_{k}" for letter in ("Q", "phi") for k in range(1, 6)]
    five = np.sum(1 / (POINTS[:, None] * np.ones(5) + 1 / POINTS[:, None]), axis=1)
    assert np.abs(sys(POINTS) - five).max() < 64 * EPS < np.abs(sys(POINTS) - 2 * five).max()


@relaxed
@given(st.integers(2, 6), seeds)
def test_6_such_a_circuit_is_canonical_unless_products_of_its_capacitances_and_inductances_are_equal(n, seed):
    rng = np.random.default_rng(seed)
    C, L = rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n)
    product = 1.0 + np.arange(n)
    sys = phc.lc_circuit(C, product / C)
    assert sys.is_canonical  # "one verifies that such a system is non-canonical" is not so in general
    assert not phc.lc_circuit(C, 3.0 / C).is_canonical
    # Foster's second form
    sys = phc.lc_circuit(C, L)
    order = np.argsort(1 / np.sqrt(L * C))
    assert np.abs(sys.d * np.sqrt(L * C)[order] - 1).max() < 16 * EPS
    assert np.abs(sys.modes.kappa * L[order] - 1).max() < 16 * EPS


# --- 7: source and target of the reduced groupoid --------------------------------------------------------------------


def test_7_the_product_of_the_reduced_groupoid_joins_source_and_target_only_in_the_corrected_order():
    d, v = np.array([1.0, 2.0, 3.0]), np.arange(1.0, 7.0)
    exchange, shift = np.eye(3)[[1, 0, 2]], np.eye(3)[[1, 2, 0]]
    first = phc.ReducedGroupoid(exchange, np.eye(6), d, v)
    then = phc.ReducedGroupoid(shift, np.eye(6), *first.target)
    # corrected: arrows 1 and 2 have a product if 2 starts where 1 ends; it leads from the start of 1 to the end of 2
    product = then @ first
    assert np.array_equal(product.source[0], d) and np.array_equal(product.target[0], then.target[0])
    assert np.array_equal(product.target[1], then.target[1])
    # printed: it exists if alpha, where 1 starts, is beta, where 2 ends; with its formula (P2 P1, .., (d1, v1))
    one, two = then, first
    assert np.array_equal(one.source[0], two.target[0])
    with pytest.raises(phc.StructureError, match="do not compose"):
        two @ one
    printed = phc.ReducedGroupoid(two.P @ one.P, np.eye(6), *one.source)
    assert not np.array_equal(printed.source[0], two.source[0])
    assert not np.array_equal(printed.target[0], one.target[0])


# --- 8: lifting by ones ----------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("more", [2, 3])
def test_8_padding_by_ones_gives_an_observable_form_whose_free_motions_grow_and_distinct_padding_does_not(more):
    sys = phc.ph(phc.modes([2.0, 3.0], [1.0, 0.5]))
    with pytest.warns(UserWarning, match="Jordan blocks"):
        ones = phc.lift(sys, 2 + more, padding="ones")
    t = np.linspace(0, 400, 4001)
    start = np.eye(2 * (2 + more))[0]

    def growth(system):
        """Largest output late over largest early."""
        y = np.abs(phc.initial_response(phc.oh(system), t, start).outputs)
        return y[3000:].max() / y[:1000].max()

    assert growth(ones) > 2 > 1.1 > growth(phc.lift(sys, 2 + more))
    # no port-Hamiltonian system of that size moves so: the energy bounds its outputs for ever
    late = phc.initial_response(ones, t, start).outputs
    assert np.abs(late[3000:]).max() <= 1.1 * np.abs(late[:1000]).max()


def test_8_the_eigenvalue_i_of_the_observable_companion_has_a_jordan_block_for_each_repeated_one():
    with pytest.warns(phc.ConditioningWarning):
        A = phc.oh([2.0, 1.0, 1.0], [1.0, 0, 0, 0, 0, 0]).A
    K = A - 1j * np.eye(6)
    ranks = [np.linalg.matrix_rank(np.linalg.matrix_power(K, k), tol=1e-10) for k in (1, 2, 3)]
    assert ranks == [5, 4, 4]  # one block of size two; the port-Hamiltonian matrix has two of size one
    J = symplectic_form(3) @ np.diag([2.0, 1, 1, 2, 1, 1])
    assert np.linalg.matrix_rank(J - 1j * np.eye(6), tol=1e-10) == 4


# --- 9: Euler data ---------------------------------------------------------------------------------------------------


@relaxed
@given(seeds, st.floats(0.01, 0.5))
def test_9_data_made_by_eulers_rule_gain_energy_by_one_plus_h_d_squared_a_step_and_lossless_ones_none(seed, h):
    rng = np.random.default_rng(seed)
    d = distinct(3, rng)
    sys = phc.ph(phc.modes(d, np.ones(3)))
    z0, t = rng.standard_normal(6), h * np.arange(50)
    for method, factor in (("euler", 1 + (h * d) ** 2), ("exact", np.ones(3)), ("midpoint", np.ones(3))):
        z = phc.initial_response(sys, t, z0, method=method).states
        energy = 0.5 * d[:, None] * (z[:3] ** 2 + z[3:] ** 2)
        expected = energy[:, :1] * factor[:, None] ** np.arange(50)
        assert np.abs(energy / expected - 1).max() <= 1e3 * EPS
        assert (sys.hamiltonian(z)[-1] / sys.hamiltonian(z0) > 1 + 1e-4) == (method == "euler")
        # a lossless system in discrete time has its poles on the unit circle
        radius = np.abs(phc.sample(sys, h, method).poles())
        assert (np.abs(radius - 1).max() > 1e-5) == (method == "euler")


# --- 10: coefficients of a semidefinite Hamiltonian ------------------------------------------------------------------


def test_10_the_semidefinite_coefficients_pair_d_j_with_d_n_plus_j():
    """Read literally, `d_{j_1} .. d_{j_k} d_{j_{n+1}} .. d_{j_{n+k}}` pairs the chosen j with `n + 1 .. n + k`."""
    d, v = [1, 2, 4, 3], [1, 2, 0, 1]
    # n = 2, k = 1: one j is chosen, the one that is not l
    corrected = sum(d[p + l] * v[p + l] ** 2 * d[1 - l] * d[3 - l] for p in (0, 2) for l in (0, 1))
    printed = sum(d[p + l] * v[p + l] ** 2 * d[1 - l] * d[2] for p in (0, 2) for l in (0, 1))
    a, c = phc.semidefinite_coefficients(d, v)
    assert c.tolist() == [1 * 1 + 2 * 4 + 3 * 1, corrected] and printed != corrected
    assert a.tolist() == [1 * 4 * 2 * 3, 0, 1 * 4 + 2 * 3, 0]
    truth = dense_values(np.diag(np.array(d, float)), np.array(v, float))
    P = POINTS**4 + 10 * POINTS**2 + 24
    assert np.abs((12 * POINTS**3 + corrected * POINTS) / P / truth - 1).max() < 64 * EPS
    assert np.abs((12 * POINTS**3 + printed * POINTS) / P / truth - 1).max() > 1e-2
    # and residue by residue: kappa_l = d_l v_l^2 + d_{n+l} v_{n+l}^2 at the pole i sqrt(d_l d_{n+l})
    foster = sum((d[l] * v[l] ** 2 + d[2 + l] * v[2 + l] ** 2) * POINTS / (POINTS**2 + d[l] * d[2 + l]) for l in (0, 1))
    assert np.abs(phc.ch(d, v)(POINTS) / foster - 1).max() < 64 * EPS

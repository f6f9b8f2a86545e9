"""Positive semidefinite Hamiltonians: normal form, kinds of degrees of freedom, coefficients with the doubled d."""

from fractions import Fraction
from itertools import combinations
from math import prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_matrices, dense_transfer_function, random_symplectic, symplectic_form

import ph_control as phc
from ph_control import semidefinite_coefficients, williamson_semidefinite

quick = settings(deadline=None, max_examples=40, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def semidefinite(d, free, cyclic, rng, squeeze=1.0, scale=1.0):
    """`scale S^T diag(d1, d2) S` with random symplectic S: oscillating, free and cyclic pairs."""
    d1, d2 = np.r_[d, np.zeros(free + cyclic)], np.r_[d, np.ones(free), np.zeros(cyclic)]
    S = random_symplectic(len(d1), rng, squeeze)
    Q = scale * (S.T * np.r_[d1, d2]) @ S
    return 0.5 * (Q + Q.T), S


def condition_on_range(Q):
    """Condition number of Q, scaled to unit diagonal, on its range; the true rank is told by the gap."""
    scale = np.sqrt(np.where(np.diag(Q) > 0, np.diag(Q), 1.0))
    values = np.linalg.eigvalsh(Q / scale[:, None] / scale)
    live = values[values > 1e-12]
    return live.max(initial=1.0) / live.min(initial=1.0)


def backward_error(Q, d1, d2, S):
    return np.linalg.norm((S.T * np.r_[d1, d2]) @ S - Q, 2) / np.linalg.norm(Q, 2)


def symplectic_error(S):
    """Largest entry of `S J S^T - J` in units of what rounding the entries of S makes of it."""
    J = symplectic_form(len(S) // 2)
    worst = 0.0
    for M in (S, S.T):
        rounding = np.abs(M) @ np.abs(J) @ np.abs(M.T)
        worst = max(worst, np.max(np.abs(M @ J @ M.T - J) / (1 + rounding)))
    return worst


spectra = st.sampled_from(["decade", "wide", "clustered", "repeated"])


def spectrum(kind, n, rng):
    return {
        "decade": np.sort(rng.uniform(0.5, 5.0, n)),
        "wide": np.logspace(-2, 2, n),
        "clustered": 1 + 1e-6 * np.arange(n),
        "repeated": np.full(n, 2.0),
    }[kind]


# --- the normal form ---


@quick
@given(
    st.integers(0, 4), st.integers(0, 3), st.integers(0, 3), spectra, st.sampled_from([0.0, 1.0, 3.0, 4.6]), seeds,
    st.sampled_from([1.0, 1e9, 1e-9, 1e100, 1e-100]),
)  # fmt: skip
def test_any_semidefinite_matrix_has_the_kinds_it_was_made_of_and_small_residuals(
    oscillating, free, cyclic, kind, squeeze, seed, scale
):
    n = oscillating + free + cyclic
    if n == 0:
        return
    rng = np.random.default_rng(seed)
    d = spectrum(kind, oscillating, rng)
    Q, S0 = semidefinite(d, free, cyclic, rng, squeeze, scale)
    original = Q.copy()
    d1, d2, S = williamson_semidefinite(Q)
    assert np.array_equal(Q, original)
    # exactly zero and exactly one, in the documented order
    assert np.array_equal(d1[:oscillating], d2[:oscillating])
    assert np.all(d1[:oscillating] > 0) and np.all(np.diff(d1[:oscillating]) >= 0)
    assert np.array_equal(d1[oscillating:], np.zeros(free + cyclic))
    assert np.array_equal(d2[oscillating:], np.r_[np.ones(free), np.zeros(cyclic)])
    assert symplectic_error(S) < 8 * n * EPS
    if oscillating + free:
        # rounding Q keeps two free momenta from commuting by the root of its condition
        amplified = np.sqrt(condition_on_range(Q)) if free > 1 else 1.0
        assert backward_error(Q, d1, d2, S) < 50 * n * EPS * amplified
        size = np.linalg.norm(S0, 2) ** 2
        error = np.abs(d1[:oscillating] / scale - d)
        assert np.all(error < 100 * n * EPS * np.linalg.norm(Q, 2) / scale * size * max(1.0, amplified**0.5))


def test_the_textbook_cases_have_their_normal_forms_exactly():
    for diagonal, d1, d2 in [
        ([0, 1], [0], [1]),  # a free particle
        ([1, 0], [0], [1]),  # its mirror: the momentum is cyclic, so it is the position that is free
        ([0, 0], [0], [0]),
        ([0, 0, 0, 4], [0, 0], [1, 0]),
        ([0, 4, 0, 9, 16, 0], [8, 0, 0], [8, 1, 0]),  # each kind once
    ]:
        Q = np.diag(np.array(diagonal, float))
        found1, found2, S = williamson_semidefinite(Q)
        assert np.all(np.abs(found1 - d1) <= 4 * EPS * np.array(d1))
        assert np.all(np.abs(found2 - d2) <= 4 * EPS * np.array(d1))  # 0 and 1 exactly
        assert np.max(np.abs((S.T * np.r_[found1, found2]) @ S - Q)) <= 8 * EPS * np.max(Q)
        assert symplectic_error(S) <= 2 * EPS


def test_uncoupled_degrees_of_freedom_of_far_apart_sizes_are_told_apart_exactly():
    # springs, a free particle, an oscillator 1e-30 as fast, and nothing, in mixed order
    Q = np.diag([1e20, 0.0, 1e-20, 0.0, 1e20, 1e-40, 1e-20, 0.0])
    d1, d2, S = williamson_semidefinite(Q)
    assert np.max(np.abs(d1 / [1e-20, 1e20, 1.0, 1.0] - [1, 1, 0, 0])) <= 4 * EPS
    assert np.array_equal(d2[2:], [1.0, 0.0])
    assert np.all(np.abs(np.diag((S.T * np.r_[d1, d2]) @ S) - np.diag(Q)) <= 8 * EPS * np.diag(Q))


def test_units_do_not_change_the_kinds():
    rng = np.random.default_rng(4)
    Q, _ = semidefinite([1.0, 2.0], 1, 1, rng, 0.5)
    t = np.array([1e-8, 1e3, 1e8, 1.0])
    unit = np.r_[t, 1 / t]
    d1, d2, S = williamson_semidefinite(unit[:, None] * Q * unit)
    assert np.max(np.abs(d1[:2] - [1.0, 2.0])) < 1e4 * EPS
    assert np.array_equal(d2[2:], [1.0, 0.0])
    assert symplectic_error(S) < 50 * EPS


def test_a_floating_chain_is_one_free_pair_with_the_momentum_of_the_whole():
    masses = np.array([1.0, 2.0, 3.0])
    sys = phc.spring_chain(masses, [2.0, 5.0])
    d1, d2, S = williamson_semidefinite(sys.Q)
    assert np.array_equal(np.sign(d1), [1, 1, 0]) and d2[2] == 1
    # the energy of the rigid motion is (p_1 + p_2 + p_3)^2 / (2 * total mass)
    total = np.r_[np.zeros(3), np.ones(3)] / np.sqrt(masses.sum())
    assert np.min([np.max(np.abs(S[5] - total)), np.max(np.abs(S[5] + total))]) < 100 * EPS
    # and its position is that of the centre of mass: conjugate to it, and to nothing else
    assert abs(S[2] @ symplectic_form(3) @ S[5] - 1) < 100 * EPS


@quick
@given(st.integers(0, 3), st.integers(0, 2), st.integers(0, 2), seeds)
def test_the_normal_form_and_the_modal_data_of_the_system_are_the_same(oscillating, free, cyclic, seed):
    n = oscillating + free + cyclic
    if n == 0:
        return
    rng = np.random.default_rng(seed)
    Q, _ = semidefinite(spectrum("decade", oscillating, rng), free, cyclic, rng)
    d1, d2, S = williamson_semidefinite(Q)
    B = rng.standard_normal(2 * n)
    sys, v = phc.ph(Q, B), S @ B
    d = sys.modes.d
    assert sys.rigid_modes == np.sum(d2 > d1) and np.array_equal(d, d1[: len(d)])
    size = np.linalg.norm(S, 2) ** 2 * np.linalg.norm(B) ** 2
    kappa = d1[:oscillating] * (v[:oscillating] ** 2 + v[n : n + oscillating] ** 2)
    assert np.sum(kappa) == pytest.approx(np.sum(sys.modes.kappa), abs=1e4 * n * EPS * size)
    kappa_0 = np.sum(v[n + oscillating : n + oscillating + free] ** 2)
    assert kappa_0 == pytest.approx(sys.modes.kappa_0, abs=1e4 * n * EPS * size)


def test_the_empty_matrix_has_the_empty_normal_form():
    d1, d2, S = williamson_semidefinite(np.zeros((0, 0)))
    assert d1.shape == d2.shape == (0,) and S.shape == (0, 0)


@pytest.mark.parametrize(
    ("Q", "message"),
    [
        (np.eye(3), "Q has odd size 3"),
        (np.diag([1.0, -1.0]), "Q is indefinite"),
        ([[1.0, 1e-3], [0.0, 1.0]], "Q is not symmetric"),
        (np.ones((2, 4)), "Q is not square"),
    ],
)
def test_what_is_no_stored_energy_is_refused(Q, message):
    with pytest.raises(phc.StructureError, match=message):
        williamson_semidefinite(Q)


def test_symmetry_is_held_to_the_tolerance_that_is_given():
    Q = np.array([[1.0, 1e-7], [0.0, 1.0]])
    with pytest.raises(phc.StructureError, match="not symmetric"):
        williamson_semidefinite(Q)
    assert np.max(np.abs(williamson_semidefinite(Q, rtol=1e-6)[0] - 1)) < 1e-6


# --- coefficients with the doubled d ---


def exact_coefficients(d, v):
    """The corrected formula of the paper, subset by subset, in exact fractions."""
    n = len(d) // 2
    d, v = [Fraction(float(x)) for x in d], [Fraction(float(x)) for x in v]
    pair = [d[j] * d[n + j] for j in range(n)]

    def symmetric(k, left_out=()):
        return sum(
            (prod(s, start=Fraction(1)) for s in combinations([pair[j] for j in range(n) if j not in left_out], k)),
            Fraction(0),
        )

    a = [symmetric(n - k) for k in range(n)]
    c = [sum(v[p * n + l] ** 2 * d[p * n + l] * symmetric(k, (l,)) for p in (0, 1) for l in range(n)) for k in range(n)]
    return a, c


def close(found, exact, allowed):
    return all(abs(Fraction(float(x)) - y) <= Fraction(allowed) * y for x, y in zip(found, exact, strict=True))


energies = st.one_of(st.just(0.0), st.floats(1e-3, 1e3))


@quick
@given(st.integers(1, 6).flatmap(lambda n: st.tuples(*[st.lists(energies, min_size=2 * n, max_size=2 * n)] * 2)))
def test_the_coefficients_are_those_of_the_corrected_formula_to_the_last_places(dv):
    d, v = map(np.array, dv)
    a, c = semidefinite_coefficients(d, v)
    exact_a, exact_c = exact_coefficients(d, v)
    n = len(d) // 2
    assert not a[1::2].any()
    assert close(a[0::2], exact_a, 4 * n * EPS)
    assert close(c, exact_c, 4 * n * EPS)


@quick
@given(st.integers(0, 3), st.integers(0, 2), st.integers(0, 2), seeds)
def test_the_canonical_form_of_a_semidefinite_system_has_its_transfer_function(oscillating, free, cyclic, seed):
    n = oscillating + free + cyclic
    if n == 0:
        return
    rng = np.random.default_rng(seed)
    Q, _ = semidefinite(spectrum("decade", oscillating, rng), free, cyclic, rng)
    B = rng.standard_normal(2 * n)
    d1, d2, S = williamson_semidefinite(Q)
    a, c = semidefinite_coefficients(np.r_[d1, d2], S @ B)
    # the companion matrix of the denominator, the last state driven, the output row 0, c_{2n-1}, .., 0, c_1
    A = np.diag(np.ones(2 * n - 1), 1)
    A[-1] = -a
    row = np.zeros(2 * n)
    row[1::2] = c[::-1]
    for s in (1.0 + 0.5j, 0.3j + 2.0, 4.0):
        direct = dense_transfer_function(*dense_matrices(Q, B), s)[0, 0]
        companion = dense_transfer_function(A, np.eye(2 * n)[:, -1:], row[None], s)[0, 0]
        size = np.linalg.norm(Q, 2) * (B @ B) * np.linalg.norm(S, 2) ** 2
        assert abs(companion - direct) <= 1e4 * n * EPS * size


def test_equal_energies_give_the_coefficients_of_the_definite_theory():
    d, v = np.array([0.5, 2.0, 3.0]), np.array([1.0, 0.0, 2.0, 0.5, 1.0, 1.0])
    a, c = semidefinite_coefficients(np.r_[d, d], v)
    expected_a, expected_c = phc.modes(d, v[:3] ** 2 + v[3:] ** 2).coefficients()
    assert np.max(np.abs(a - expected_a)) <= 8 * EPS * a.max()
    assert np.max(np.abs(c / expected_c - 1)) <= 8 * EPS


def printed_coefficients(d, v):
    """The formula as printed: `d_{j_1} .. d_{j_k} d_{j_{n+1}} .. d_{j_{n+k}}` with `j_1 < .. < j_k <= n`.

    There is no `j_{n+1}`: only k indices are chosen.  The nearest literal reading takes the entry `n + 1, .. n + k`.
    """
    n = len(d) // 2
    c = []
    for k in range(n):
        total = 0.0
        for p in (0, 1):
            for l in range(n):
                subsets = combinations([j for j in range(n) if j != l], k)
                f = d[p * n + l] * sum(prod(d[list(s)]) * prod(d[n : n + k]) for s in subsets)
                total += f * v[p * n + l] ** 2
        c.append(total)
    return np.array(c)


def test_the_formula_as_printed_has_another_transfer_function_and_the_corrected_one_the_right_one():
    d, v = np.array([1.0, 2.0, 4.0, 3.0, 5.0, 0.5]), np.array([1.0, 0.0, 2.0, 1.0, 1.0, 0.0])
    s = 0.7 + 0.4j
    truth = dense_transfer_function(*dense_matrices(np.diag(d), v), s)[0, 0]
    a, corrected = semidefinite_coefficients(d, v)
    powers = s ** np.array([5, 3, 1])
    denominator = s**6 + np.sum(a * s ** np.arange(6))
    assert abs(corrected @ powers / denominator / truth - 1) < 100 * EPS
    printed = printed_coefficients(d, v)
    assert printed[0] == pytest.approx(corrected[0], rel=8 * EPS)  # no product yet, so nothing to misprint
    assert abs(printed @ powers / denominator / truth - 1) > 0.1


@pytest.mark.parametrize(
    ("d", "v", "message"),
    [
        ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0], "d has 3 entries and v has 3; each holds n of the positions"),
        ([1.0, -2.0], [1.0, 0.0], r"d\[1\] = -2; a stored energy cannot be negative"),
        ([1.0, 2.0], [1.0], "d has 2 entries and v has 1"),
        ([1.0, np.nan], [1.0, 1.0], "d is not finite"),
        ([1e200, 1e200], [1.0, 1.0], "the coefficients of these 1 degrees of freedom leave the range of doubles"),
    ],
)
def test_what_has_no_coefficients_is_refused(d, v, message):
    with pytest.raises(phc.StructureError, match=message):
        semidefinite_coefficients(d, v)


def test_nothing_has_no_coefficients():
    a, c = semidefinite_coefficients([], [])
    assert a.shape == c.shape == (0,)


@pytest.mark.parametrize("rtol", ["a", [1e-6], np.nan, np.inf, 1.0, -1.0])
def test_a_tolerance_of_no_meaning_is_refused(rtol):
    with pytest.raises(phc.StructureError, match=r"rtol is .*; a relative tolerance is a number from 0 to 1"):
        phc.williamson_semidefinite(np.array([[1.0, 0.5], [0.0, 1.0]]), rtol=rtol)

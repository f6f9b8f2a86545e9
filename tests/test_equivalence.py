"""Equivalences of filters and of pairs, the group action, and global coordinates, against many digits."""

from fractions import Fraction

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper_systems import SETTINGS, SQUEEZE, cases, companion, pair, plain, target, transposed
from reference import EPS, coefficients, random_symplectic, symplectic_form

import ph_control as phc
from ph_control import act, are_isomorphic, filter_coefficients, from_unique, same_filter, star_equivalent, to_unique


def weights(v):
    n = len(v) // 2
    return v[:n] ** 2 + v[n:] ** 2


def canonical_pair(n, seed):
    """Random pair whose frequencies keep a distance."""
    rng = np.random.default_rng(seed)
    d = rng.permutation(1.0 + np.arange(n) + rng.uniform(0, 0.5, n))
    return d, rng.standard_normal(2 * n), rng


def block_turn(d, v, rng):
    """`U v` for a random unitary U that commutes with the frequencies."""
    n = len(d)
    nu = (v[:n] + 1j * v[n:]).copy()
    for x in set(d.tolist()):
        l = np.flatnonzero(d == x)
        U, _ = np.linalg.qr(rng.standard_normal((len(l),) * 2) + 1j * rng.standard_normal((len(l),) * 2))
        nu[l] = U @ nu[l]
    return np.r_[nu.real, nu.imag]


# --- the same filter ---------------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.sampled_from([0.0, 1.0, SQUEEZE]))
def test_a_filter_is_the_same_in_all_its_clothes(case, squeeze):
    d, v, rng = pair(*case)
    sys = target(d, v, random_symplectic(len(d), rng, squeeze))
    for other in ((d, v), (d, block_turn(d, v, rng)), phc.modes(d, weights(v)), phc.modes(d, weights(v)).minimal()):
        verdict = same_filter(sys, other)
        assert verdict and verdict.residual <= verdict.allowed
        assert len(verdict.witness.d) <= len(set(d.tolist()))


@pytest.mark.slow
@SETTINGS
@given(cases, st.booleans())
def test_a_small_change_of_a_pole_or_of_a_residue_is_seen_in_exact_data(case, of_pole):
    d, v, _ = pair(*case)
    l = int(np.argmax(d * weights(v)))
    other_d, other_v = d.copy(), v.copy()
    if of_pole:
        other_d[l] *= 1 + 1e-12
    else:
        other_v[[l, l + len(d)]] *= 1 + 1e-12
    verdict = same_filter((d, v), (other_d, other_v))
    assert not verdict and verdict.residual > verdict.allowed and "differ" in verdict.reason
    assert verdict.witness is None
    assert same_filter((d, v), (other_d, other_v), rtol=1e-10)


@pytest.mark.slow
@SETTINGS
@given(st.integers(1, 5), st.integers(0, 10**6))
def test_plain_systems_and_transfer_functions_are_compared_within_their_own_errors(n, seed):
    d, v, rng = canonical_pair(n, seed)
    A, B, C = companion(d, v)
    T = random_symplectic(n, rng, 0.5)
    moved = plain(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T))
    a, c = coefficients(d, weights(v))
    num, den = np.zeros(2 * n), np.zeros(2 * n + 1)
    num[0::2], den[0], den[2::2] = [float(x) for x in c[::-1]], 1.0, [float(x) for x in a[::-1]]
    for other in (plain(A, B, C), transposed(A, B, C), moved, ct.tf(num, den)):
        assert same_filter((d, v), other)
        assert not same_filter((d * (1 + 1e-4), v), other)


def test_hidden_modes_and_rigid_bodies_are_compared_too():
    """Example 4.2 of the paper: one filter, two systems that are not isomorphic."""
    B = [1.0, 0.0, 0.0, 0.0]
    first, second = phc.ph(np.eye(4), B), phc.ph(np.diag([1.0, 2.0, 1.0, 3.0]), B)
    assert same_filter(first, second) and not are_isomorphic(first, second)
    free = [phc.ph(np.diag([0.0, 4.0, 1.0, 1.0]), [0.0, 0.0, x, 1.0]) for x in (1.0, 1.0, 1.0 + 1e-9)]
    assert same_filter(free[0], free[1]) and not same_filter(free[0], free[2])
    assert not same_filter(free[0], phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]))
    assert "0" in same_filter(free[0], free[2]).reason


def test_the_filter_of_the_example_is_a_cosine_not_an_exponential():
    """The paper prints the kernel `exp(t - s)`; the impulse response of `Q = I`, `B = e_1` is `cos t`."""
    sys = phc.ph(np.eye(4), [1.0, 0.0, 0.0, 0.0])
    t = np.linspace(0, 3, 31)
    response = phc.impulse_response(sys, t).outputs
    assert np.abs(response - np.cos(t)).max() < 1e-13 < np.abs(response - np.exp(t)).max()


def test_several_ports_are_compared_by_residue_matrices():
    Q = np.diag([1.0, 4.0, 1.0, 1.0])
    B = np.random.default_rng(0).standard_normal((4, 2))
    assert same_filter(phc.ph(Q, B), phc.ph(Q, B))
    # the same diagonal of G, another phase between the ports
    assert not same_filter(phc.ph(Q, B), phc.ph(Q, B * [1.0, -1.0]))
    with pytest.raises(phc.StructureError, match="2 and 1 ports"):
        same_filter(phc.ph(Q, B), phc.ph(Q, B[:, 0]))


def test_systems_without_residues_have_the_same_filter():
    assert same_filter(([1.0, 2.0], np.zeros(4)), ([3.0], np.zeros(2)))
    assert same_filter(([], []), ([3.0], np.zeros(2)))
    assert not same_filter(([], []), ([3.0], [1.0, 0.0]))


@pytest.mark.parametrize("gap", [1e-15, 1e-14, 1e-13, 1e-12, 1e-10, 1e-8, 1e-3])
def test_close_poles_of_a_plain_system_are_compared_within_the_errors_they_were_judged_with(gap):
    sys = phc.ph(phc.modes([1.0, 1.0 + gap], [1.0, 2.0]))
    heavier = phc.ph(phc.modes([1.0, 1.0 + gap], [1.0, 2.5]))
    for seed in range(3):
        T, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((4, 4)))
        moved = plain(T @ sys.A @ T.T, T @ sys.B, sys.C @ T.T)
        assert same_filter(sys, moved) and same_filter(moved, sys)
        # 0.25 is the error of the single residues at the worst of these gaps
        assert same_filter(heavier, moved).holds == (gap == 1e-12)


def test_the_transfer_function_of_close_poles_is_the_same_filter():
    sys, heavier = (phc.ph(phc.modes([1.0, 1.001], [1.0, r])) for r in (2.0, 2.0 + 1e-5))
    assert same_filter(sys, phc.tf(sys)) and not same_filter(heavier, phc.tf(sys))


def test_a_rigid_body_mode_of_a_plain_system_is_compared_too():
    Q = np.diag([0.0, 4.0, 1.0, 1.0])
    sys, heavier = (phc.ph(Q, [0.0, 0.0, x, 1.0]) for x in (1.0, 1.0 + 1e-6))
    T, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))
    moved = plain(T @ sys.A @ T.T, T @ sys.B, sys.C @ T.T)
    assert same_filter(sys, moved) and not same_filter(heavier, moved)


@pytest.mark.parametrize(
    ("d", "v", "w"),
    [(1.0, 1e77, 2e77), (1.0, 1e-85, 2e-85), (1e100, 1e100, 2e100), (1e-100, 1e-100, 2e-100), (1e150, 1e-140, 2e-140)],
)
def test_filters_whose_residues_have_no_square_are_told_apart_without_a_warning(d, v, w):
    """Warnings are errors here; the residues are within the range of doubles, the squares of them are not."""
    assert same_filter(([d], [v, 0.0]), ([d], [0.0, v]))
    verdict = same_filter(([d], [v, 0.0]), ([d], [w, 0.0]))
    assert not verdict and abs(verdict.residual - 0.6) < 1e-14


@pytest.mark.parametrize("small", [1.0, 1e-30, 1e-200])
def test_a_residue_of_exact_data_is_compared_with_its_own_rounding_not_with_the_largest(small):
    large = 1e18
    for first, second in (
        (phc.modes([1.0, 2.0], [large, small]), phc.modes([1.0, 2.0], [large, 9 * small])),
        (([1.0, 2.0], [large, small**0.5, 0, 0]), ([1.0, 2.0], [large, 3 * small**0.5, 0, 0])),
    ):
        verdict = same_filter(first, second)
        assert not verdict and "frequency 2" in verdict.reason
        assert same_filter(first, first)
        assert same_filter(first, second, rtol=1e-9)
    near = phc.modes([1.0, 2.0], [large, small * (1 + 2 * EPS)])
    assert same_filter(phc.modes([1.0, 2.0], [large, small]), near)


def test_residues_at_zero_of_exact_data_are_compared_with_their_own_rounding_too():
    d, nu = np.array([1.0]), np.array([[1e9 + 0j]])
    forms = [phc.ModalForm(d.copy(), nu.copy(), np.array([[x]])) for x in (1e-6, 2e-6)]
    verdict = same_filter(*forms)
    assert not verdict and verdict.reason.startswith("the residues at 0 differ: 1e-12 and 4e-12")
    assert same_filter(*forms, rtol=1e-9)


# --- filter coefficients -----------------------------------------------------------------------------------------


@SETTINGS
@given(cases)
def test_the_coefficients_follow_the_recursion_of_the_paper_and_its_continuation(case):
    """`e_1 .. e_n` as printed; beyond n not 0, as its proof claims, but by Cayley and Hamilton."""
    d, v, _ = pair(*case)
    n = len(d)
    a, c = coefficients(d, weights(v))
    c = c[::-1]  # c_1, c_3 ..
    exact = [Fraction(0)] * (2 * n)
    for m in range(2 * n):
        exact[m] = (c[m] if m < n else 0) - sum(a[n - 1 - j] * exact[m - 1 - j] for j in range(min(m, n)))
    e = filter_coefficients(d, v)
    assert e.shape == (2 * n,)
    for value, truth in zip(e, exact, strict=True):
        assert abs(Fraction(float(value)) - truth) <= 10 * n * Fraction(EPS) * abs(truth)
    assert np.all(e[n:] != 0) == bool(weights(v).any())


@SETTINGS
@given(cases)
def test_the_coefficients_are_markov_parameters_of_ch(case):
    d, v, _ = pair(*case)
    n = len(d)
    A, B, C = companion(d, v)
    with mp.workdps(200):
        A, x, C = mp.matrix(A), mp.matrix(B), mp.matrix(C)
        for m, value in enumerate(filter_coefficients(d, v)):
            exact = (C * x)[0]
            # the companion matrix itself is rounded
            assert abs(value - exact) <= 100 * n * EPS * float(np.sum(d * weights(v)) * (2 * d.max()) ** (2 * m)) * 4**n
            assert abs((C * A * x)[0]) <= 1e-180 + abs(exact) * mp.mpf(10) ** -100
            x = A * A * x


def test_agreement_of_the_printed_coefficients_is_not_enough():
    """n = 1: `e_1` agrees, `2 s/(s^2 + 1)` and `2 s/(s^2 + 4)` do not."""
    first, second = ([1.0], [np.sqrt(2.0), 0.0]), ([2.0], [1.0, 0.0])
    e, f = filter_coefficients(*first), filter_coefficients(*second)
    assert abs(e[0] - f[0]) < 4 * EPS and abs(e[1] - f[1]) > 1
    assert not same_filter(first, second)


def test_even_all_but_the_last_may_agree():
    """Two measures on two points each share three moments: Gauss quadratures that differ in the fourth."""
    x, kappa = np.array([1.0, 3.0]), np.array([0.5, 0.5])
    # orthogonal polynomial of degree 2, shifted by a multiple of the one of degree 1: x^2 - 4 x + 3 - t (x - 2)
    y = np.roots([1.0, -4.0 - 0.1, 3.0 + 0.2])[::-1]
    rho = np.linalg.solve(np.vander(y, 2, increasing=True).T, [1.0, 2.0])
    e, f = (filter_coefficients(np.sqrt(z), np.r_[np.sqrt(w / np.sqrt(z)), 0, 0]) for z, w in ((x, kappa), (y, rho)))
    assert np.allclose(e[:3], f[:3], rtol=1e-13) and abs(e[3] - f[3]) > 0.05
    assert not same_filter(phc.modes(np.sqrt(x), kappa / np.sqrt(x)), phc.modes(np.sqrt(y), rho / np.sqrt(y)))


@SETTINGS
@given(st.integers(1, 4), st.integers(0, 10**6), st.booleans())
def test_all_2n_coefficients_agree_exactly_when_the_filters_do(n, seed, same):
    rng = np.random.default_rng(seed)
    d = rng.choice([1.0, 2.0, 3.0], n)
    v = rng.choice([0.0, 1.0, 2.0], 2 * n)
    other = block_turn(d, v, rng) if same else rng.choice([0.0, 1.0, 2.0], 2 * n)
    e, f = filter_coefficients(d, v), filter_coefficients(d, other)
    assert bool(same_filter((d, v), (d, other))) == np.allclose(e, f, rtol=1e-12, atol=1e-12)


# --- ~star and ~sys ----------------------------------------------------------------------------------------------


@SETTINGS
@given(cases, st.booleans())
def test_star_equivalence_gives_a_witness_that_meets_the_four_conditions(case, unitary):
    d, v, rng = pair(*case)
    n = len(d)
    sigma, theta = rng.permutation(n), rng.uniform(-4, 4, n)
    d2, v2 = act(sigma, theta, d, block_turn(d, v, rng) if unitary else v)
    verdict = star_equivalent(d, v, d2, v2)
    assert verdict and verdict.residual <= verdict.allowed
    P, A = verdict.witness
    both, D1, D2, J = np.kron(np.eye(2), P), np.diag(np.r_[d, d]), np.diag(np.r_[d2, d2]), symplectic_form(n)
    size = 100 * n * EPS * np.linalg.norm(v)
    assert np.array_equal(both @ D1 @ both.T, D2)
    assert np.linalg.norm(A.T @ D1 @ A @ v - D1 @ v) <= size * d.max()
    assert np.linalg.norm(A @ J @ D1 - J @ D1 @ A) <= 100 * n * EPS * d.max()
    assert np.linalg.norm(v2 - both @ A @ v) <= size


@SETTINGS
@given(st.integers(1, 6), st.integers(0, 10**6), st.booleans(), st.booleans())
def test_star_sys_on_systems_and_sys_on_canonical_forms_coincide_for_all_pairs(n, seed, same, repeated):
    rng = np.random.default_rng(seed)
    d = rng.choice([1.0, 2.0, 5.0], n) if repeated else 1.0 + rng.permutation(n)
    v = rng.choice([0.0, 1.0, 2.0], 2 * n)
    w = block_turn(d, v, rng) if same else rng.choice([0.0, 1.0, 2.0], 2 * n)
    d2, v2 = act(rng.permutation(n), rng.uniform(0, 6, n), d, w)
    star = star_equivalent(d, v, d2, v2)
    systems = are_isomorphic(phc.ph(np.diag(np.r_[d, d]), v), phc.ph(np.diag(np.r_[d2, d2]), v2))
    # Theorem 4.5 (I): the coefficients a and c agree
    (a1, c1), (a2, c2) = coefficients(d, weights(v)), coefficients(d2, weights(v2))
    forms = a1 == a2 and np.allclose([float(x) for x in c1], [float(x) for x in c2], rtol=1e-12, atol=1e-12)
    assert bool(star) == bool(systems) == forms


@SETTINGS
@given(st.integers(1, 8), st.integers(0, 10**6), st.booleans())
def test_on_canonical_pairs_it_is_the_orbit_of_the_group(n, seed, same):
    d, v, rng = canonical_pair(n, seed)
    d2, v2 = act(rng.permutation(n), rng.uniform(0, 6, n), d, v)
    if not same:
        v2[rng.integers(2 * n)] += 0.1
    # the only element that can link them: sort the frequencies, then turn each phase
    sigma = np.argsort(d, kind="stable")[np.argsort(np.argsort(d2, kind="stable"))]
    n_ = len(d)
    theta = np.angle(v2[:n_] + 1j * v2[n_:]) - np.angle((v[:n_] + 1j * v[n_:])[sigma])
    moved_d, moved_v = act(sigma, theta, d, v)
    in_orbit = bool(np.array_equal(moved_d, d2) and np.allclose(moved_v, v2, rtol=0, atol=1e-12))
    assert in_orbit == same == bool(star_equivalent(d, v, d2, v2))
    assert same == bool(same_filter((d, v), (d2, v2)))


def test_at_repeated_frequencies_the_orbits_are_smaller_than_the_classes():
    d, v, w = [1.0, 1.0], [1.0, 0.0, 0.0, 0.0], np.array([0.6, 0.0, 0.0, 0.8])
    assert star_equivalent(d, v, d, w)
    assert not np.allclose(np.sort(weights(np.array(v))), np.sort(weights(w)))


@SETTINGS
@given(st.integers(1, 6), st.integers(0, 10**6), st.booleans())
def test_williamson_matrices_of_one_hamiltonian_differ_by_phases_or_unitaries(n, seed, repeated):
    """Remark 4.15: for different d the ambiguity of S is a torus; for a repeated d it is a unitary group."""
    rng = np.random.default_rng(seed)
    d = np.full(n, 2.0) if repeated else 1.0 + np.arange(n)
    S = random_symplectic(n, rng)
    sys = target(d, rng.standard_normal(2 * n), S)
    turn = sys.S @ np.linalg.inv(S)
    U = turn[:n, :n] + 1j * turn[n:, :n]
    tolerance = 1e3 * n * EPS * np.linalg.cond(S) ** 2
    assert np.linalg.norm(U @ U.conj().T - np.eye(n)) <= tolerance
    assert repeated or np.linalg.norm(U - np.diag(np.diag(U))) <= tolerance
    # either way the pairs stand for the same system
    B = np.asarray(sys.B)[:, 0]
    assert star_equivalent(d, S @ B, d, sys.S @ B, rtol=tolerance)
    assert same_filter((d, S @ B), (d, sys.S @ B), rtol=tolerance)


def test_star_says_what_differs():
    d, v = [1.0, 2.0], [1.0, 0.0, 0.0, 1.0]
    assert star_equivalent(d, v, [1.0, 2.1], v).reason == "the frequencies differ"
    assert star_equivalent(d, v, d, [1.0, 0.0, 0.0, 1.1]).reason == "the input weights differ"
    assert star_equivalent(d, v, [1.0], [1.0, 0.0]).reason == "they have 2 and 1 modes"
    assert star_equivalent(d, v, [1.0, 2.0 * (1 + 1e-9)], v, rtol=1e-8)
    with pytest.raises(phc.StructureError, match=r"pair 2: v has shape \(3,\)"):
        star_equivalent(d, v, d, [1.0, 2.0, 3.0])


@pytest.mark.parametrize("gap", [2e-15, 4e-15, 1e-14])
def test_star_tells_as_many_frequencies_apart_as_the_filters_do(gap):
    first, second = ([1.0, 1.0 + gap], [1.0, 2.0, 0.0, 0.0]), ([1.0 + gap, 1.0], [1.0, 2.0, 0.0, 0.0])
    systems = [phc.ph(np.diag(np.r_[d, d]), v) for d, v in (first, second)]
    assert star_equivalent(*first, *second) and same_filter(first, second) and are_isomorphic(*systems)


def test_star_compares_the_weights_of_each_frequency_with_their_own_size():
    d, v, w = [1.0, 2.0], np.array([1e18, 1.0, 0.0, 0.0]), np.array([1e18, 3.0, 0.0, 0.0])
    systems = [phc.ph(np.diag(np.r_[d, d]), x) for x in (v, w)]
    assert not star_equivalent(d, v, d, w) and not same_filter((d, v), (d, w)) and not are_isomorphic(*systems)
    assert star_equivalent(d, v, d, w, rtol=1e-12)
    turned = np.array([0.0, 1.0, 1e18, 0.0])
    assert star_equivalent(d, v, d, turned)


@pytest.mark.parametrize("size", [1e-150, 1e-100, 1e100, 1e150])
def test_star_does_not_depend_on_units(size):
    assert star_equivalent([1.0], [size, 0.0], [1.0], [0.0, size])
    assert not star_equivalent([1.0], [size, 0.0], [1.0], [2 * size, 0.0])
    assert star_equivalent([size], [size, 0.0], [size], [0.0, size])
    assert not star_equivalent([size], [size, 0.0], [size], [2 * size, 0.0])


# --- the group ---------------------------------------------------------------------------------------------------


@SETTINGS
@given(cases)
def test_the_action_is_a_left_action_of_the_semidirect_product(case):
    d, v, rng = pair(*case)
    n = len(d)
    sigma, tau = rng.permutation(n), rng.permutation(n)
    theta, phi = rng.uniform(-9, 9, (2, n))
    twice = act(sigma, theta, *act(tau, phi, d, v))
    once = act(tau[sigma], theta + phi[sigma], d, v)
    assert np.array_equal(twice[0], once[0])
    # sums of angles and products of turns round differently
    assert np.allclose(twice[1], once[1], rtol=0, atol=100 * EPS * np.abs(v).max())
    assert [x.tolist() for x in act(np.arange(n), np.zeros(n), d, v)] == [d.tolist(), v.tolist()]


def test_the_action_permutes_by_the_matrix_and_turns_by_the_rotation_of_the_paper():
    d, v = np.array([1.0, 2.0, 3.0]), np.arange(6.0)
    sigma, theta = np.array([2, 0, 1]), np.array([0.1, 0.2, 0.3])
    P = np.zeros((3, 3))
    P[np.arange(3), sigma] = 1
    c, s = np.diag(np.cos(theta)), np.diag(np.sin(theta))
    R = np.block([[c, -s], [s, c]])
    moved_d, moved_v = act(sigma, theta, d, v)
    assert np.array_equal(moved_d, P @ d)
    assert np.allclose(moved_v, R @ np.kron(np.eye(2), P) @ v, rtol=1e-15)


# --- global coordinates ------------------------------------------------------------------------------------------


@SETTINGS
@given(st.integers(1, 8), st.integers(0, 10**6))
def test_the_coordinates_are_those_of_the_orbit(n, seed):
    d, v, rng = canonical_pair(n, seed)
    coordinates = to_unique(d, v)
    assert np.array_equal(coordinates[0], np.sort(d))
    moved = to_unique(*act(rng.permutation(n), rng.uniform(0, 6, n), d, v))
    assert np.array_equal(coordinates[0], moved[0])
    assert np.allclose(coordinates[1], moved[1], rtol=8 * EPS * 10, atol=0)
    modes = phc.modes(d, weights(v))
    assert np.array_equal(modes.d, coordinates[0]) and np.array_equal(modes.r, coordinates[1])


@SETTINGS
@given(st.integers(1, 8), st.integers(0, 10**6))
def test_the_section_is_a_right_inverse_and_meets_every_orbit_once(n, seed):
    d, v, _ = canonical_pair(n, seed)
    coordinates = to_unique(d, v)
    section = from_unique(*coordinates)
    assert not section[1][n:].any() and np.all(section[1][:n] > 0)
    back = to_unique(*section)
    assert np.array_equal(back[0], coordinates[0]) and np.allclose(back[1], coordinates[1], rtol=4 * EPS, atol=0)
    assert star_equivalent(d, v, *section)


def test_noncanonical_pairs_have_no_coordinates():
    refusals = [
        (
            r"1 and 1 differ by 0.0e\+00 of their size, expected more than 3.6e-15; merge",
            lambda: to_unique([1, 1], np.ones(4)),
        ),
        (r"r = 0 at frequency 2, expected > 0.*drop", lambda: to_unique([2, 1], [0, 1, 0, 1])),
        (r"d is not ascending: d\[0\] = 2, d\[1\] = 1; sort", lambda: from_unique([2, 1], [1, 1])),
        (r"not canonical: the frequencies 1 and 1", lambda: from_unique([1, 1], [1, 1])),
        (r"r = 0 at frequency 1", lambda: from_unique([1, 2], [0, 1])),
        (r"r is negative", lambda: from_unique([1, 2], [-1, 1])),
        (r"the weights r = v\^2 leave the range", lambda: to_unique([1, 2], [1, 1e-170, 0, 0])),
        (
            r"the modal weights of this d and v leave the range",
            lambda: same_filter(([1, 2], [1, 1e-170, 0, 0]), ([], [])),
        ),
        (r"the modal weights of this d and v leave", lambda: same_filter(([1e100], [1e150, 0]), ([], []))),
        (r"sigma is no permutation of the indices 0 .. 1", lambda: act([[1], [1, 2]], [0, 0], [1, 2], np.ones(4))),
        (r"sigma is \[0 0\]", lambda: act([0, 0], [0, 0], [1, 2], np.ones(4))),
        (r"sigma is \[0. 1.\]", lambda: act([0.0, 1.0], [0, 0], [1, 2], np.ones(4))),
        (r"theta has shape \(1,\)", lambda: act([0, 1], [0], [1, 2], np.ones(4))),
        (r"range of doubles", lambda: filter_coefficients([1e150] * 2, np.ones(4))),
        (r"tuple of 3", lambda: same_filter(([1], [1, 0], 2), ([1], [1, 0]))),
        (r"rtol is 3", lambda: same_filter(([1], [1, 0]), ([1], [1, 0]), rtol=3)),
    ]
    for message, call in refusals:
        with pytest.raises(phc.StructureError, match=message):
            call()


def test_nearly_repeated_frequencies_are_canonical_until_rounding():
    assert to_unique([1.0, 1.0 + 1e-12], np.ones(4))[0].tolist() == [1.0, 1.0 + 1e-12]


def test_frequencies_any_factor_apart_differ():
    verdict = phc.star_equivalent([1e100, 2e100], [1.0, 0.0, 1.0, 0.0], [1e-299, 2e100], [1.0, 0.0, 1.0, 0.0])
    assert not verdict and verdict.residual == 1.0 and verdict.reason == "the frequencies differ"


def test_sizes_at_the_ends_of_the_range_of_doubles_give_no_warning():
    far = phc.ReducedGroupoid, ([1.0, 2.0], [1.0, 0.0, 0.5, 5e-324], [1.0, 2.0], [0.0, 0.0, 0.0, 0.0])
    with pytest.raises(phc.StructureError):
        far[0].between(*far[1])
    with pytest.raises(phc.StructureError, match="leave the range of doubles"):
        phc.filter_coefficients([1e150] * 4, [0.0] * 5 + [1.0] * 3)
    with pytest.raises(phc.StructureError, match="leave the range of doubles"):
        phc.ModalForm.from_coefficients([6.25, 0.0, 7.25, 0.0], [2e300, 7e300])

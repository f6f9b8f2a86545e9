"""Minimal realisation, Kalman decomposition, lifting and canonical margins, against known modes and dense matrices."""

import itertools
import warnings

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import (
    EPS,
    dense_matrices,
    dense_transfer_function,
    largest_error,
    on_axis,
    random_orthogonal_symplectic,
    symplectic_form,
)

import ph_control as phc
from ph_control import CanonicalMargins, ModalForm, canonical_margins, kalman_decomposition, lift, minreal
from ph_control.modal.error_bounds import separate

relaxed = settings(deadline=None, max_examples=20, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
conditions = st.sampled_from([1.0, 1e2, 1e4])
sizes = st.integers(1, 8)
kinds = st.sampled_from(["decade", "wide", "clustered", "one repeated", "third repeated", "third zero", "all zero"])
generic = st.sampled_from(["decade", "wide", "one repeated", "third repeated", "third zero", "all zero"])


def symplectic_of_condition(n, condition, rng):
    """`S` and its inverse, `S = U1 diag(s, 1/s) U2`, with `cond(S)` as wanted."""
    s = np.sqrt(condition) ** rng.uniform(-1, 1, n)
    s[0] = np.sqrt(condition)
    U1, U2 = random_orthogonal_symplectic(n, rng), random_orthogonal_symplectic(n, rng)
    return U1 @ np.diag(np.r_[s, 1 / s]) @ U2, U2.T @ np.diag(np.r_[1 / s, s]) @ U1.T


def spectrum(n, kind, rng, spacing="random"):
    """Frequencies and input vector `(d, v)`; a third is at least one."""
    d = {
        "random": lambda: np.sort(10 ** rng.uniform(0, 1, n)),
        "linear": lambda: np.linspace(1, 10, n),
        "logarithmic": lambda: np.logspace(0, 1, n),
    }[spacing]()
    # lengths and directions of the pairs; none is nearly 0
    v = np.exp(rng.uniform(-1, 1, n)) * np.exp(2j * np.pi * rng.random(n))
    third = max(1, n // 3)
    if kind == "wide":
        d = np.sort(10 ** rng.uniform(-2, 2, n))
    if kind == "clustered":
        d = 2 + 1e-6 * (np.arange(n) + 0.5 * rng.random(n))
    if kind == "one repeated":
        d[1:2] = d[0]
    if kind == "third repeated":
        d[1 : third + 1] = d[0]
    if kind == "third zero":
        v[rng.permutation(n)[:third]] = 0
    if kind == "all zero":
        v[:] = 0
    return d, np.r_[v.real, v.imag]


def weights(v):
    return np.sum(v.reshape(2, -1) ** 2, axis=0)


def minimal_truth(d, v):
    """Frequencies and weights after merging equal ones and dropping zeros, from the numbers the system was made of."""
    r = weights(v)
    kept = np.unique(d[r > 0])
    return kept, np.array([r[d == x].sum() for x in kept])


def made_of(d, v, S, inverse):
    Q = S.T @ np.diag(np.r_[d, d]) @ S
    return 0.5 * (Q + Q.T), inverse @ v


def any_system(n, kind, condition, seed):
    """`(Q, B, d, v, S)` of a random system."""
    rng = np.random.default_rng(seed)
    d, v = spectrum(n, kind, rng)
    S, inverse = symplectic_of_condition(n, condition, rng)
    return *made_of(d, v, S, inverse), d, v, S


def frequency_floor(d, S):
    """What an error `|dQ_ij| <= eps sqrt(Q_ii Q_jj)`, that of any computed `S^T Dhat S`, makes of each frequency.

    `w^T dQ w` over the columns `w` of `S^{-1}`, which are rows of `S` with q and p exchanged; and the rounding of
    products of the size of `sqrt(Q_qq Q_pp)`.
    """
    n = len(d)
    root = np.sqrt(np.diag(S.T @ np.diag(np.r_[d, d]) @ S))
    exchanged = np.abs(np.concatenate([S[:, n:], S[:, :n]], axis=1)) * root
    pairs = np.sum(exchanged**2, axis=1).reshape(2, n).sum(axis=0)
    return EPS * (pairs / 2 + np.linalg.norm(root[:n] * root[n:]))


def direct_sum(first, second):
    """Matrices of two systems in the states `(q1, q2, p1, p2)`."""
    n1, n2 = first.n, second.n
    n = n1 + n2
    order = np.r_[0:n1, n : n + n1, n1:n, n + n1 : 2 * n]
    Q, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 1))
    Q[np.ix_(order, order)] = np.block([[first.Q, np.zeros((2 * n1, 2 * n2))], [np.zeros((2 * n2, 2 * n1)), second.Q]])
    B[order] = np.concatenate([first.B, second.B])
    return Q, B


# --- the right order, without a tolerance from the user -----------------------------------------------------------

GRID = list(
    itertools.product(
        [1, 2, 5, 10, 20, 50, 100], ["decade", "one repeated", "third repeated", "third zero"], [1.0, 1e2, 1e4]
    )
)


@pytest.mark.variants
@pytest.mark.parametrize("spacing", ["random", "linear", "logarithmic"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_minimal_order_is_right_84_times_of_84(spacing, seed):
    assert len(GRID) == 84
    wrong, worst = [], 0.0
    for n, kind, condition in GRID:
        rng = np.random.default_rng([seed, n, int(condition)])
        d, v = spectrum(n, kind, rng, spacing)
        S, inverse = symplectic_of_condition(n, condition, rng)
        small = minreal(phc.ph(*made_of(d, v, S, inverse)))
        truth, r = minimal_truth(d, v)
        if small.n != len(truth):
            wrong.append((n, kind, condition, small.n, len(truth)))
            continue
        assert np.all(small.poles().real == 0)
        floor = frequency_floor(d, S)
        floor = np.array([floor[d == x].max() for x in truth])
        error = np.abs(small.d - truth)
        worst = max(worst, float(np.max(error / floor, initial=0.0)))
        assert np.all(error <= np.maximum(1e-11 * truth, (4 + np.sqrt(n)) * floor))
        if condition == 1:
            assert np.all(error <= 1e-11 * truth)
        assert abs(small.r.sum() - r.sum()) <= 1e-6 * r.sum()
    assert wrong == []
    # the floor is one: some error comes near it
    assert 0.3 < worst


@relaxed
@given(sizes, generic, conditions, seeds)
def test_the_minimal_system_has_the_known_modes(n, kind, condition, seed):
    Q, B, d, v, _ = any_system(n, kind, condition, seed)
    system = phc.ph(Q, B)
    errors = separate(system.modes, (system.Q, system.B), system._energy).errors
    small = minreal(system)
    truth, r = minimal_truth(d, v)
    gaps = np.diff(truth)
    # two frequencies drawn at random may be nearer than rounding allows to see
    if np.all(gaps > 100 * errors.d.max()):
        assert small.n == len(truth)
        assert np.all(np.abs(small.d - truth) <= errors.d.max())
        assert np.all(np.abs(small.r - r) <= 4 * np.sqrt(r) * errors.nu.max() + 4 * errors.nu.max() ** 2)
    if r.size:
        assert abs(small.r.sum() / r.sum() - 1) < 1e-6


@relaxed
@given(sizes, kinds, seeds)
def test_well_conditioned_minimal_systems_have_the_dense_transfer_function(n, kind, seed):
    Q, B, d, _, _ = any_system(n, kind, 1.0, seed)
    small = minreal(phc.ph(Q, B))
    rng = np.random.default_rng(seed)
    A, B, C = dense_matrices(Q, B)
    for s in d.max() * (rng.uniform(0.5, 2, 3) + 1j * rng.uniform(-2, 2, 3)):
        size = np.linalg.norm(B) * np.linalg.norm(C) * np.linalg.norm(np.linalg.inv(s * np.eye(2 * n) - A), 2)
        condition = np.linalg.cond(s * np.eye(2 * n) - A)
        assert abs(small(s) - dense_transfer_function(A, B, C, s)[0, 0]) <= 200 * n * EPS * condition * size


def test_clusters_of_1e_6_stay_apart_where_the_condition_lets_them():
    for n in (2, 8, 30):
        Q, B, d, v, _ = any_system(n, "clustered", 1.0, n)
        small = minreal(phc.ph(Q, B))
        assert small.n == n
        assert np.max(np.abs(small.d - d)) < 1e-13
        assert np.max(np.abs(small.r / weights(v) - 1)) < 1e-6


def near_pair(gap, condition=1e4):
    """Two modes with weights 1 and 0.09 at a distance of `gap`, and two others."""
    rng = np.random.default_rng(5)
    d, v = np.array([1.0, 1.0 + gap, 2.0, 3.0]), np.array([1.0, 0.3, 1.0, 0.0, 0.0, 0.0, 0.5, 0.7])
    return phc.ph(*made_of(d, v, *symplectic_of_condition(4, condition, rng)))


def test_frequencies_that_nothing_can_tell_apart_merge_and_keep_their_total_residue():
    system = near_pair(1e-12)
    bound = separate(system.modes, (system.Q, system.B), system._energy).errors.d[0]
    # the same gap is below the bound here, and above it where S is orthogonal
    assert 1e-12 < bound < 1e-5
    merged = minreal(system)
    assert merged.n == 3
    assert abs(merged.r[0] - 1.09) < 1e-6
    assert minreal(near_pair(1e-12, 1.0)).n == 4
    assert minreal(near_pair(100 * bound)).n == 4


@pytest.mark.parametrize("gap", 10.0 ** np.arange(-14.0, -2.5, 0.25))
def test_no_residue_is_lost_at_any_distance_of_two_frequencies(gap):
    system = near_pair(gap)
    small = minreal(system)
    assert small.n in (3, 4)
    near = small.d < 1.5
    assert abs(small.r[near].sum() - 1.09) < 1e-5
    assert abs(np.average(small.d[near], weights=small.r[near]) - (1 + gap * 0.09 / 1.09)) < 1e-6


def test_weight_that_a_near_neighbour_lent_goes_back_to_it():
    system = near_pair(1e-5)
    # the second mode unreached, at distances from far below the bound to far above
    orders, rng = [], np.random.default_rng(0)
    for gap in 10.0 ** np.arange(-12.0, -2.0, 0.5):
        d, v = np.array([1.0, 1.0 + gap, 2.0]), np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        system = phc.ph(*made_of(d, v, *symplectic_of_condition(3, 1e4, rng)))
        small = minreal(system)
        orders.append(small.n)
        assert abs(small.r[0] - 1) < 1e-5
        assert abs(small.d[0] - 1) < 1e-6
    assert set(orders) == {2}


# --- systems given by modes ----------------------------------------------------------------------------------------


def test_exact_modes_are_merged_only_where_equal_and_dropped_only_where_zero():
    tiny = minreal(phc.modes([1.0, 1.0 + 1e-14 * 8, 2.0], [1.0, 2.0, 1e-300]))
    assert tiny.n == 3
    assert np.array_equal(tiny.r, [1.0, 2.0, 1e-300])
    equal = minreal(phc.modes([1.0, 1.0 + EPS, 2.0, 3.0], [1.0, 2.0, 0.0, 0.5]))
    assert np.array_equal(equal.r, [3.0, 0.5])
    assert abs(equal.d[0] - 1.0) <= EPS


def test_a_minimal_system_given_by_modes_stays_bit_for_bit():
    modes = phc.modes(np.logspace(-3, 3, 9), 10 ** np.random.default_rng(0).uniform(-4, 4, 9))
    small = minreal(modes)
    assert np.array_equal(small.d, modes.d)
    assert np.array_equal(small.r, modes.r)


def test_a_tolerance_of_the_user_overrides_the_bounds_on_both_sides():
    modes = phc.modes([1.0, 1.001, 3.0], [1.0, 3.0, 1e-3])
    residue = 3e-3 / 3.003
    assert minreal(modes).n == 3
    assert minreal(modes, rtol=0.9e-3).n == 3
    assert minreal(modes, rtol=1.1e-3).n == 1
    assert minreal(phc.modes([1.0, 1.1, 3.0], modes.r), rtol=0.9 * residue).n == 3
    assert minreal(phc.modes([1.0, 1.1, 3.0], modes.r), rtol=1.1 * residue).n == 2
    Q, B, *_ = any_system(4, "one repeated", 1.0, 0)
    assert minreal(phc.ph(Q, B)).n == 3
    # frequencies that are equal to the last bit are one in any case
    nearly = phc.modes([1.0, 1.0 + 4 * np.finfo(float).eps, 2.0], np.ones(3))
    assert minreal(phc.ph(nearly), rtol=0).n == 3


def test_minreal_takes_what_ph_takes_and_keeps_the_names_of_the_ports():
    system = minreal(ct.tf([1, 0], [1, 0, 4], name="plant", inputs=["force"], outputs=["velocity"]))
    assert isinstance(system, phc.PortHamiltonian)
    assert (system.input_labels, system.output_labels) == (["force"], ["velocity"])
    doubled = phc.ph(np.eye(4), [1.0, 1.0, 0.0, 0.0], inputs="voltage", outputs="current")
    for part in (minreal(doubled), *kalman_decomposition(doubled)[:2], lift(doubled, 4)):
        assert (part.input_labels, part.output_labels) == (["voltage"], ["current"])


# --- many ports and rigid-body modes -------------------------------------------------------------------------------


@relaxed
@given(st.integers(2, 6), st.integers(2, 3), seeds)
def test_with_several_ports_a_frequency_stays_as_often_as_the_ports_reach_it(n, ports, seed):
    rng = np.random.default_rng(seed)
    d = rng.permutation(np.r_[np.full(n - 1, 2.0), 5.0])
    S, inverse = symplectic_of_condition(n, 10.0, rng)
    Q = S.T @ np.diag(np.r_[d, d]) @ S
    system = phc.ph(0.5 * (Q + Q.T), inverse @ rng.standard_normal((2 * n, ports)))
    small = minreal(system)
    assert small.n == 1 + min(n - 1, ports)
    s = rng.uniform(0.5, 3, 4) + 1j * rng.uniform(-3, 3, 4)
    truth = np.stack([dense_transfer_function(*dense_matrices(system.Q, system.B), x) for x in s], axis=-1)
    assert np.max(np.abs(small(s) - truth)) < 1e5 * EPS * np.max(np.abs(truth))


@relaxed
@given(st.integers(1, 5), st.integers(1, 3), st.integers(0, 2), seeds)
def test_the_rotation_of_a_group_takes_its_weights_onto_the_reached_states(k, ports, kept, seed):
    rng = np.random.default_rng(seed)
    rank = min(k, ports, kept)
    factors = [rng.standard_normal(shape) + 1j * rng.standard_normal(shape) for shape in ((k, rank), (rank, ports))]
    (group,) = separate(ModalForm(np.full(k, 3.0), factors[0] @ factors[1], np.zeros((0, ports)))).groups
    assert group.rank == rank
    assert np.max(np.abs(group.rotation @ group.rotation.conj().T - np.eye(k))) < 100 * EPS
    wanted = np.concatenate([group.nu, np.zeros((k - rank, ports))])
    assert np.max(np.abs(group.rotation @ factors[0] @ factors[1] - wanted)) <= 200 * EPS * (group.strength or 1)
    largest = group.nu[np.arange(rank), np.abs(group.nu).argmax(axis=1)] if rank else np.ones(0)
    assert np.all(largest.real > 0)
    assert np.all(np.abs(largest.imag) <= 4 * EPS * np.abs(largest))


def test_rigid_body_modes_merge_into_one_and_unreached_ones_go():
    chain = phc.spring_chain([1.0, 2.0, 3.0], [4.0, 5.0])
    both = phc.ph(*direct_sum(chain, chain))
    small = minreal(both)
    assert (small.n, len(small.modes.rigid)) == (3, 1)
    assert abs(small.modes.kappa_0 - 2 * chain.modes.kappa_0) < 1e-13
    assert np.max(np.abs(small.d - chain.d)) < 1e-13
    silent = phc.ph(*direct_sum(phc.ph(np.eye(2), [1.0, 0.0]), phc.ph(np.diag([0.0, 1.0]), [0.0, 0.0])))
    assert (minreal(silent).n, len(minreal(silent).modes.rigid)) == (1, 0)
    # a free mass turned into other coordinates, whose momentum the port reaches by rounding only
    rng = np.random.default_rng(1)
    S, inverse = symplectic_of_condition(4, 100.0, rng)
    Q = S.T @ np.diag([0.0, 1, 2, 3, 1, 1, 2, 3]) @ S
    turned = phc.ph(0.5 * (Q + Q.T), inverse @ [0.0, 1, 1, 1, 0, 1, 1, 1])
    assert len(turned.modes.rigid) == 1
    assert turned.modes.rigid.any()
    assert (minreal(turned).n, len(minreal(turned).modes.rigid)) == (3, 0)
    faint = phc.ph(turned.Q, inverse @ [0.0, 1, 1, 1, 1e-6, 1, 1, 1])
    assert len(minreal(faint).modes.rigid) == 1


# --- Kalman decomposition ------------------------------------------------------------------------------------------


@relaxed
@given(sizes, kinds, conditions, seeds)
def test_the_kalman_decomposition_is_a_direct_sum_of_a_canonical_and_a_hidden_system(n, kind, condition, seed):
    Q, B, d, _, S = any_system(n, kind, condition, seed)
    system = phc.ph(Q, B)
    reachable, hidden, T = kalman_decomposition(system)
    assert reachable.n + hidden.n == n
    assert isinstance(reachable, phc.PortHamiltonian)
    assert isinstance(hidden, phc.PortHamiltonian)
    assert hidden.B.shape == (2 * hidden.n, 1)
    assert not hidden.B.any()
    assert np.array_equal(reachable.B[reachable.n :], np.zeros((reachable.n, 1)))
    assert np.all(reachable.B[: reachable.n] > 0)
    assert canonical_margins(reachable).is_canonical

    J = symplectic_form(n)
    size = np.linalg.norm(T, 2)
    assert np.max(np.abs(T @ J @ T.T - J)) <= 100 * n * EPS * size**2
    wanted_Q, wanted_B = direct_sum(reachable, hidden)
    inverse = J.T @ T.T @ J
    floor = frequency_floor(d, S).max()
    assert np.max(np.abs(inverse.T @ Q @ inverse - wanted_Q)) <= 20 * n * floor
    errors = separate(system.modes, (system.Q, system.B), system._energy).errors
    assert np.max(np.abs(T @ B[:, None] - wanted_B)) <= 4 * n * errors.nu.max() + 100 * EPS * size * np.linalg.norm(B)


@relaxed
@given(sizes, st.sampled_from(["decade", "one repeated", "third repeated", "third zero", "all zero"]), seeds)
def test_the_reachable_subspace_is_symplectic_and_orthogonal_in_energy_to_the_unobservable_one(n, kind, seed):
    rng = np.random.default_rng(seed)
    d, v = spectrum(n, kind, rng, "linear")
    S, inverse = symplectic_of_condition(n, 10.0, rng)
    Q, B = made_of(d, v, S, inverse)
    reachable, _, T = kalman_decomposition(phc.ph(Q, B))
    A, B, C = dense_matrices(Q, B)
    k = reachable.n
    assert k == len(minimal_truth(d, v)[0])
    # orthonormal bases from the states that held frequencies reach and that outputs at them show
    R, O = reached_space(A, B, d, k), reached_space(A.T, C.T, d, k)
    J = symplectic_form(n)
    back = J.T @ T.T @ J
    seen, unseen = np.r_[0:k, n : n + k], np.r_[k:n, n + k : 2 * n]
    condition = np.linalg.cond(T)
    allowed = 1e4 * n * EPS * condition**2
    # columns of T^{-1}: the first k pairs span what is reached, the others what is not seen
    assert np.linalg.norm(back[:, seen] - R @ (R.T @ back[:, seen])) <= allowed * np.linalg.norm(back)
    assert np.linalg.norm(O.T @ back[:, unseen]) <= allowed * np.linalg.norm(back)
    assert np.linalg.norm(back[:, unseen].T @ Q @ R) <= allowed * np.linalg.norm(Q) * np.linalg.norm(back)
    if k:
        assert np.linalg.svd(R.T @ J @ R, compute_uv=False).min() > 1e-3 / condition


def reached_space(A, B, d, k):
    """Orthonormal basis of `2k` dimensions of the Krylov space of `(A, B)`, from resolvents near the poles."""
    points = [1j * x * (1 + 1e-3) for x in np.unique(d)]
    columns = [np.linalg.solve(s * np.eye(len(A)) - A, B.astype(complex)) for s in points]
    both = np.concatenate([np.concatenate([c.real, c.imag], axis=1) for c in columns], axis=1)
    length = np.linalg.norm(both, axis=0)
    U, sigma, _ = np.linalg.svd(both / np.where(length > 0, length, 1.0))
    if k:
        assert sigma[2 * k - 1] > 1e-6
    assert np.all(sigma[2 * k :] < 1e-9)
    return U[:, : 2 * k]


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_reachable_part_is_controllable_and_observable_by_the_rank_test(n):
    Q, B, *_ = any_system(2 * n, "third zero", 10.0, n)
    reachable, _, _ = kalman_decomposition(phc.ph(Q, B))
    for A, columns in ((reachable.A, reachable.B), (reachable.A.T, reachable.C.T)):
        krylov = [columns]
        for _ in range(2 * reachable.n - 1):
            krylov.append(A @ krylov[-1] / np.linalg.norm(A, 2))
        assert np.linalg.matrix_rank(np.concatenate(krylov, axis=1)) == 2 * reachable.n


def test_a_canonical_system_has_a_hidden_part_without_states_and_an_unreached_one_no_reachable_states():
    reachable, hidden, T = kalman_decomposition(phc.modes([1.0, 2.0], [1.0, 4.0]))
    assert (reachable.n, hidden.n, hidden.nstates) == (2, 0, 0)
    assert np.array_equal(np.abs(T), np.eye(4))
    assert hidden(1j) == 0
    reachable, hidden, _ = kalman_decomposition(phc.ph(np.diag([1.0, 2.0, 1.0, 2.0]), np.zeros(4)))
    assert (reachable.n, hidden.n) == (0, 2)
    assert reachable(1j) == 0
    assert np.max(np.abs(hidden.d - [1.0, 2.0])) < 4 * EPS
    assert minreal(phc.ph(np.eye(2), [0.0, 0.0])).n == 0


def test_one_degree_of_freedom():
    reachable, hidden, T = kalman_decomposition(phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]))
    assert (reachable.n, hidden.n) == (1, 0)
    assert np.max(np.abs(T @ [0.0, 1.0] - [np.sqrt(0.5), 0])) < 4 * EPS
    assert (minreal(reachable).n, lift(reachable, 1).n, lift(reachable, 2).n) == (1, 1, 2)


def test_a_decomposition_is_compared_with_an_array_as_a_whole():
    parts = kalman_decomposition(phc.ph(np.eye(2), [0.0, 1.0]))
    for array in (np.zeros(3), np.zeros(3, dtype=[("a", float)]), np.array([None] * 3)):
        assert (parts == array) is False and (array == parts) is False and parts != array


def test_equal_frequencies_given_by_modes_turn_onto_one():
    r = np.array([1.0, 2.0, 3.0, 4.0])
    modes = ModalForm(np.array([1.0, 1.0, 1.0, 2.0]), np.sqrt(r)[:, None] * np.exp(1j * r)[:, None], np.zeros((0, 1)))
    reachable, hidden, T = kalman_decomposition(modes)
    assert np.array_equal(reachable.d, [1.0, 2.0])
    assert np.max(np.abs(reachable.r - [6.0, 4.0])) < 8 * EPS
    assert np.array_equal(hidden.d, [1.0, 1.0])
    assert np.max(np.abs(T @ T.T - np.eye(8))) < 16 * EPS
    assert np.max(np.abs(T @ phc.ph(modes).B - direct_sum(reachable, hidden)[1])) < 16 * EPS


# --- scales, inputs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [1e-9, 1e9])
@pytest.mark.parametrize("amplitude", [1e-9, 1e9])
@pytest.mark.parametrize("kind", ["decade", "clustered", "third repeated", "third zero"])
def test_every_decision_is_the_same_in_other_units(time, amplitude, kind):
    Q, B, *_ = any_system(6, kind, 1e2, 3)
    plain, scaled = phc.ph(Q, B), phc.ph(time * Q, amplitude * B)
    assert minreal(plain).n == minreal(scaled).n
    assert np.max(np.abs(minreal(scaled).d / minreal(plain).d / time - 1)) < 1e-9
    assert kalman_decomposition(plain)[0].n == kalman_decomposition(scaled)[0].n
    here, there = canonical_margins(plain), canonical_margins(scaled)
    assert here.is_canonical == there.is_canonical
    assert (here.pair, here.mode) == (there.pair, there.mode) or not here.is_canonical
    # the shapes of modes of one frequency are chosen by rounding
    assert np.isclose(
        here.resonance_tolerance, there.resonance_tolerance, rtol=1e-3 if here.is_canonical else 0.5, atol=0
    )
    # positions and momenta in units of their own
    units = np.r_[np.full(6, 1e5), np.full(6, 1e-5)]
    stretched = phc.ph(units[:, None] * Q * units, B / units)
    assert minreal(stretched).n == minreal(plain).n
    assert 0.5 < canonical_margins(stretched).resonance_tolerance / here.resonance_tolerance < 2
    assert (
        np.max(np.abs(lift(phc.modes([time, 3 * time], [1, 1]), 5).d / time / lift(phc.modes([1, 3], [1, 1]), 5).d - 1))
        < 1e-13
    )


def test_decoupled_parts_of_very_different_size_do_not_blur_each_other():
    d = np.array([1e-6, 1e-6 * (1 + 1e-12), 1.0, 1e6])
    system = phc.ph(np.diag(np.r_[d, d]), np.r_[np.ones(4), np.zeros(4)])
    assert minreal(system).n == 4
    assert minreal(phc.ph(np.diag(np.r_[d, d]), np.r_[1, 1, 1e-20, 0, np.zeros(4)])).n == 3


def test_inputs_are_not_modified():
    Q, B, *_ = any_system(4, "third repeated", 10.0, 2)
    Q0, B0, pad = Q.copy(), B.copy(), np.array([3.0, 4.0])
    system = phc.ph(Q, B)
    minreal(system), kalman_decomposition(system), canonical_margins(system), lift(system, 6, padding=pad)
    assert np.array_equal(Q, Q0)
    assert np.array_equal(B, B0)
    assert np.array_equal(pad, [3.0, 4.0])
    assert np.array_equal(system.Q, Q0)


# --- lifting ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [2, 5])
@pytest.mark.parametrize("n", [1, 3, 10, 40])
def test_the_lifted_system_has_the_same_frequency_response_to_1e_13(n, factor):
    rng = np.random.default_rng(n)
    d, v = spectrum(n, "decade", rng, "linear")
    large = lift(phc.modes(d, weights(v)), factor * n)
    assert large.n == factor * n
    # outside, between the modes, and next to each
    middles = np.sqrt(d[1:] * d[:-1])
    w = np.r_[d[0] / 7, d[0] / 2, middles, d * (1 + 1e-9), d * (1 - 1e-4), d[-1] * 9]
    got = large(1j * w)
    assert np.all(got.real == 0)
    assert largest_error(got.imag, on_axis(d, weights(v), w)) < 1e-13


def test_a_lifted_system_whose_padding_repeats_its_frequencies_is_parted_again():
    rng = np.random.default_rng(0)
    d, v = np.array([0.5, 1.0, 1.0, 3.0]), rng.standard_normal(8)
    S, inverse = symplectic_of_condition(4, 10.0, rng)
    system = phc.ph(*made_of(d, v, S, inverse))
    with pytest.warns(UserWarning, match=r"Jordan"):
        large = lift(system, 7, padding="ones")
    reachable, hidden, T = kalman_decomposition(large)
    assert (reachable.n, hidden.n) == (3, 4)
    J = symplectic_form(7)
    back = J.T @ T.T @ J
    Q, B = direct_sum(reachable, hidden)
    assert np.max(np.abs(T @ large.B - B)) < 1e-12
    assert np.max(np.abs(back.T @ large.Q @ back - Q)) < 1e-12
    assert np.max(np.abs(T @ J @ T.T - J)) < 1e-12


@relaxed
@given(sizes, conditions, seeds, st.integers(0, 12))
def test_a_system_given_by_matrices_keeps_its_coordinates_and_frequencies_bit_for_bit(n, condition, seed, more):
    Q, B, d, _, S = any_system(n, "decade", condition, seed)
    system = phc.ph(Q, B)
    large = lift(system, n + more)
    m = n + more
    old = np.r_[0:n, m : m + n]
    assert np.array_equal(large.Q[np.ix_(old, old)], system.Q)
    assert np.array_equal(large.B[old], system.B)
    new = np.r_[n:m, m + n : 2 * m]
    assert not large.B[new].any()
    assert not large.Q[np.ix_(old, new)].any()
    reached = large.r > 0
    assert np.array_equal(large.d[reached], system.d)
    # the energy coordinates are those of the lifted matrix
    _, E, _ = large._energy
    assert np.max(np.abs((E.conj().T @ E).real - large.Q)) <= 100 * m * EPS * np.linalg.norm(large.Q)
    assert np.max(np.abs(phc.ph(large.Q, large.B).d - large.d)) <= np.max(frequency_floor(d, S)) * (4 + np.sqrt(m))
    assert np.max(np.abs(large.r[reached] / system.r - 1)) < 100 * EPS * condition
    # the embedding intertwines both systems
    embed = np.eye(2 * m)[:, old]
    assert np.array_equal(large.A @ embed, embed @ system.A)
    assert np.max(np.abs(large.C @ embed - system.C)) <= 4 * n * EPS * np.max(np.abs(system.B)) * np.max(
        np.abs(system.Q)
    )
    assert minreal(large).n == minreal(system).n


@relaxed
@given(sizes, generic, seeds, st.integers(1, 30))
def test_the_default_padding_is_distinct_away_from_the_system_and_of_its_size(n, kind, seed, more):
    d, v = spectrum(n, kind, np.random.default_rng(seed))
    large = lift(phc.modes(d, weights(v)), n + more)
    pad = np.diag(large.Q)[n : n + more]
    assert np.all((pad >= d.min() / 17) & (pad <= d.max() * 17))
    distances = np.abs(np.log2(pad[:, None] / np.r_[d, pad]))
    distances[np.arange(more), n + np.arange(more)] = np.inf
    # evenly spread over at least two octaves, into the gaps that n frequencies leave
    assert distances.min() > min(2, more / 2) / (n + 2 * more + 2)


def test_more_frequencies_are_added_where_the_gap_is_larger():
    pad = np.diag(lift(phc.modes([1.0, 1.001, 1024.0], [1, 1, 1]), 7).Q)[3:7]
    assert np.all((pad > 1.1) & (pad < 1000))
    steps = np.diff(np.log2(np.r_[1.001, pad, 1024.0]))
    assert np.ptp(steps) < 1e-12


def evenly_in_gaps(edges, counts):
    """Points evenly inside each gap; the two outer ends are free, so that the last point there stands on the end."""
    points = []
    for k, (low, high, count) in enumerate(zip(edges[:-1], edges[1:], counts, strict=True)):
        if k == 0:
            points += [low + (high - low) * i / count for i in range(count)]
        elif k == len(counts) - 1:
            points += [low + (high - low) * (i + 1) / count for i in range(count)]
        else:
            points += [low + (high - low) * (i + 1) / (count + 1) for i in range(count)]
    return np.array(points)


def least_step(points, known):
    steps = np.abs(points[:, None] - np.r_[known, points])
    steps[np.arange(len(points)), len(known) + np.arange(len(points))] = np.inf
    return steps.min()


@relaxed
@given(st.integers(1, 3), st.integers(1, 4), seeds)
def test_no_other_distribution_over_the_gaps_leaves_a_larger_least_distance(n, more, seed):
    known = np.sort(np.random.default_rng(seed).uniform(-3, 3, n))
    large = lift(phc.modes(2.0**known, np.ones(n)), n + more)
    found = least_step(np.log2(np.diag(large.Q)[n : n + more]), known)
    edges = np.r_[known[0] - 1, known, known[-1] + 1]
    choices = [c for c in itertools.product(range(more + 1), repeat=n + 1) if sum(c) == more]
    best = max(least_step(evenly_in_gaps(edges, counts), known) for counts in choices)
    assert abs(found - best) < 1e-12


def test_frequencies_given_for_the_padding_are_used_in_their_order():
    large = lift(phc.modes([1.0, 2.0], [1, 1]), 4, padding=[9.0, 5.0])
    assert np.array_equal(np.diag(large.Q), [1, 2, 9, 5, 1, 2, 9, 5])
    assert np.array_equal(np.diag(lift(phc.modes([2.0], [1]), 2, padding=7).Q), [2, 7, 2, 7])


def test_systems_with_several_ports_or_rigid_bodies_are_lifted_too():
    chain = phc.spring_chain([1.0, 2.0, 3.0], [4.0, 5.0], port=[0, 2])
    large = lift(chain, 5)
    s = np.array([0.3 + 1j, 2.0])
    assert (large.n, len(large.modes.rigid)) == (5, 1)
    assert np.max(np.abs(large(s) - chain(s))) < 1e-13
    assert lift(phc.ph(phc.modes([], [])), 2).n == 2


def test_lifting_to_its_own_order_gives_the_system_itself():
    system = phc.ph(np.eye(2), [1.0, 0.0])
    same = lift(system, 1)
    assert np.array_equal(same.Q, system.Q)
    assert np.array_equal(same.B, system.B)


# --- correction of the paper: padding by ones makes Jordan blocks ----------------------------------------------------


def observable_companion(d):
    """`g1(d)^T` with the coefficients of `prod (s^2 + d_l^2)`, all sums of positive terms."""
    c = np.ones(1)
    for x in d:
        c = np.convolve(c, [1.0, x * x])
    A = np.diag(np.ones(2 * len(d) - 1), 1)
    A[-1, 0::2] = -c[:0:-1]
    return A.T


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_the_observable_companion_of_the_default_lifting_is_diagonalisable(n):
    d, v = spectrum(n, "decade", np.random.default_rng(n), "linear")
    large = lift(phc.modes(d, weights(v)), 2 * n)
    unit = np.exp(np.mean(np.log(large.d)))
    values, vectors = np.linalg.eig(observable_companion(large.d / unit))
    assert np.abs(np.sort(values.imag) - np.sort(np.r_[large.d, -large.d]) / unit).max() < 1e-6
    gaps = np.diff(np.sort(values.imag))
    assert gaps.min() > 1e-3
    # far from the 1/sqrt(eps) of a double eigenvalue in doubles, although entries range over decades
    length = np.linalg.norm(vectors / np.abs(vectors).max(axis=1, keepdims=True), axis=0)
    assert np.linalg.cond(vectors / np.abs(vectors).max(axis=1, keepdims=True) / length) < 1e6


def test_padding_by_ones_gives_jordan_blocks_and_a_warning_from_two_on():
    system = phc.modes([2.0, 3.0], [1.0, 1.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        single = lift(system, 3, padding="ones")
    with pytest.warns(UserWarning, match=r"Jordan blocks"):
        double = lift(system, 4, padding="ones")
    with pytest.warns(UserWarning, match=r"padding frequency 1 is repeated"):
        lift(phc.modes([1.0, 3.0], [1.0, 1.0]), 3, padding="ones")
    with pytest.warns(UserWarning, match=r"padding frequency 5 is repeated"):
        lift(system, 4, padding=[5.0, 5.0])
    for large, expected_rank in ((single, 5), (double, 7)):
        A = observable_companion(large.d)
        # one eigenvector of the eigenvalue i: nullity 1, however often it is repeated
        assert np.linalg.matrix_rank(1j * np.eye(2 * large.n) - A) == expected_rank
        repeated = int(np.sum(large.d == 1))
        assert np.linalg.matrix_rank(np.linalg.matrix_power(1j * np.eye(2 * large.n) - A, 2)) == 2 * large.n - repeated
    assert np.max(np.abs(double([0.5j, 4j]) - phc.ph(system)([0.5j, 4j]))) < 1e-14


# --- canonical margins -----------------------------------------------------------------------------------------------


@relaxed
@given(sizes, kinds, conditions, seeds)
def test_a_system_is_canonical_iff_it_is_its_own_minimal_order(n, kind, condition, seed):
    Q, B, *_ = any_system(n, kind, condition, seed)
    system = phc.ph(Q, B)
    margins = canonical_margins(system)
    assert margins.is_canonical == (minreal(system).n == n)
    above = margins.resonance > margins.resonance_tolerance and margins.degeneracy > margins.degeneracy_tolerance
    assert margins.is_canonical == above


def test_the_margins_are_the_distances_of_the_nearest_pair_and_the_faintest_mode():
    margins = canonical_margins(phc.modes([1.0, 2.0, 2.5, 7.0], [1.0, 0.5, 0.01, 2.0]))
    assert isinstance(margins, CanonicalMargins)
    assert (margins.is_canonical, margins.pair, margins.mode, margins.rigid) == (True, (1, 2), 2, 0)
    assert abs(margins.resonance - 0.2) < EPS
    assert abs(margins.degeneracy - 0.025 / 14) < EPS
    assert margins.degeneracy_tolerance == 0
    assert 8 * EPS < margins.resonance_tolerance < 100 * EPS
    assert "canonical" in str(margins)
    assert "frequencies of modes 2 and 3 differ by 0.2" in str(margins)
    assert "mode 3 is 0.00179" in str(margins)


def test_margins_of_systems_that_are_not_canonical_name_what_is_wrong():
    resonant = canonical_margins(phc.ph(np.eye(4), [1.0, 2.0, 0.0, 0.0]))
    assert not resonant.is_canonical
    assert resonant.resonance <= resonant.resonance_tolerance
    assert resonant.degeneracy > resonant.degeneracy_tolerance
    faint = canonical_margins(phc.modes([1.0, 2.0], [1.0, 0.0]))
    assert (faint.is_canonical, faint.mode, faint.degeneracy) == (False, 1, 0.0)
    assert "not canonical" in str(faint)
    free = canonical_margins(phc.ph(np.diag([0.0, 1.0]), [0.0, 1.0]))
    assert (free.is_canonical, free.rigid, free.pair, free.mode) == (False, 1, None, None)
    assert free.resonance == np.inf
    assert "without a frequency: 1" in str(free)
    assert not canonical_margins(phc.ph(np.eye(2), [0.0, 0.0])).is_canonical


# --- bad input -------------------------------------------------------------------------------------------------------


def test_bad_input_is_refused_with_what_was_measured_and_what_to_do():
    system = phc.modes([1.0, 2.0], [1.0, 1.0])
    for m in (1, -1, 2.0, True, None, "3"):
        with pytest.raises(phc.StructureError, match=rf"m is {m!r}, .*n = 2 .*from n to .*minreal"):
            lift(system, m)
    with pytest.raises(phc.StructureError, match=r"padding has shape \(1,\); m - n = 2"):
        lift(system, 4, padding=[3.0])
    with pytest.raises(phc.StructureError, match=r"padding is not positive: padding\[1\] = -3"):
        lift(system, 4, padding=[3.0, -3.0])
    with pytest.raises(phc.StructureError, match=r"padding is 'zeros'; it must be one of 'ones'"):
        lift(system, 4, padding="zeros")
    with pytest.raises(phc.StructureError, match=r"padding is not finite"):
        lift(system, 4, padding=[3.0, np.nan])
    for rtol in (-1, 1.0, np.nan, "1", True):
        for function in (minreal, kalman_decomposition):
            with pytest.raises(phc.StructureError, match=r"rtol is .*number from 0 to 1"):
                function(system, rtol=rtol)
    two_ports = phc.ph(np.eye(2), np.eye(2))
    for function in (kalman_decomposition, canonical_margins):
        with pytest.raises(phc.StructureError, match=r"has 2 ports"):
            function(two_ports)
    with pytest.raises(phc.StructureError, match=r"only positive semidefinite: 1 of 2 .*use minreal"):
        kalman_decomposition(phc.ph(np.diag([0.0, 1, 1, 1]), np.ones(4)))
    for function in (minreal, kalman_decomposition, canonical_margins, lambda sys: lift(sys, 2)):
        with pytest.raises(phc.NotLosslessError):
            function(ct.tf([1], [1, 1] if function is not minreal else [1, -1]))
        with pytest.raises(phc.StructureError):
            function("system")


def test_the_hidden_modes_of_a_canonical_form_are_kept():
    for form in (phc.ch([1.0, 2.0, 3.0], [1.0, 0.0, 1.0, 0.0, 0.0, 0.0]), phc.oh([1.0, 1.0, 3.0], np.ones(6))):
        reachable, hidden, _ = phc.kalman_decomposition(form)
        assert (reachable.n, hidden.n) == (2, 1)
        assert phc.modes(form).n == 3 and phc.lift(form, 5).n == 5 and not phc.canonical_margins(form).is_canonical
        assert phc.minreal(form).n == phc.ph(form).n == 2


def test_what_a_foreign_state_space_hides_is_refused_not_forgotten():
    """The hidden mode of a plain state space is in its matrices, its energy is not."""
    source = phc.spring_chain([1.0, 2.0, 1.0], 100.0, ground=[50.0, 0.0, 50.0], port=1)
    X = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))[0]
    plain = ct.ss(X.T @ source.A @ X, X.T @ source.B, source.C @ X, 0)
    for call in (phc.kalman_decomposition, phc.canonical_margins):
        with pytest.raises(phc.StructureError, match=r"has 6 states, of which 4 take part .*: use minreal\(sys\)"):
            call(plain)
    assert phc.minreal(plain).n == 2
    for same in (source, ct.ss(source)):
        assert phc.kalman_decomposition(same).hidden.n == 1 and not phc.canonical_margins(same).is_canonical
    whole = phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0]))
    Y = X[:4, :4] + np.eye(4)
    similar = ct.ss(Y @ whole.A @ np.linalg.inv(Y), Y @ whole.B, whole.C @ np.linalg.inv(Y), 0)
    assert phc.canonical_margins(similar).is_canonical and phc.kalman_decomposition(similar).hidden.n == 0


@pytest.mark.parametrize("gap", [7e-13, 1e-11, 1e-9, 1e-7])
def test_the_parts_and_the_transformation_of_nearly_equal_frequencies_belong_together(gap):
    """Weights of close modes depend on how they are computed; those of the parts are those that `T` makes."""
    rng = np.random.default_rng(3)
    d = 8.0 * np.array([1.0, 1.0 + gap])
    S, _ = symplectic_of_condition(2, 10.0, rng)
    Q = S.T @ np.diag(np.concatenate([d, d])) @ S
    Q, B = 0.5 * (Q + Q.T), rng.standard_normal(4)
    reachable, _, T = phc.kalman_decomposition(phc.ph(Q, B))
    k, n = reachable.n, 2
    expected = np.zeros(2 * n)
    expected[:k], expected[n : n + k] = reachable.B[:k, 0], reachable.B[k:, 0]
    assert np.abs(T @ B - expected).max() < 1e-10 * np.linalg.cond(T) * np.abs(expected).max()


def test_pairs_of_a_symmetric_structure_that_rounding_took_apart_are_counted_and_merged_on_request():
    Q = np.diag([1.0, 1.0 + 4e-11, 4.0, 4.0 + 4e-10, 9.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    sys = phc.ph(Q, np.repeat([0.0, 1.0], 5))
    margins = phc.canonical_margins(sys)
    assert margins.near_pairs == 2 and "rtol=1e-09" in str(margins)
    assert (phc.minreal(sys).n, phc.minreal(sys, rtol=1e-9).n) == (5, 3)
    assert phc.canonical_margins(phc.minreal(sys, rtol=1e-9)).near_pairs == 0

"""What is told from frequencies and weights alone is what all the modes tell, or nothing."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, random_orthogonal_symplectic

import ph_control as phc
from ph_control import ModalForm
from ph_control.modal import minimal as reachability
from ph_control.modal.error_bounds import separate
from ph_control.modal.minimal import Reduction, minimal_of_exact, of_exact, of_matrix
from ph_control.symplectic.forms_and_williamson import port_spectrum

relaxed = settings(deadline=None, max_examples=30, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def exact_modes(n, seed, scale=1.0):
    """Modes with frequencies that repeat, also up to a rounding, and weights of 0 among others of any size."""
    rng = np.random.default_rng(seed)
    d = np.sort(rng.choice(rng.uniform(1, 10, max(1, n // 2)), n)) * (1 + EPS * rng.integers(-1, 2, n))
    r = np.where(rng.random(n) < 0.3, 0.0, 10.0 ** rng.uniform(-12, 2, n))
    return phc.modes(scale * d, r)


def matrix_of(d, r, condition, rng):
    """`(Q, B)` of given modes in random coordinates."""
    n = len(d)
    s = np.sqrt(condition) ** rng.uniform(-1, 1, n)
    U, V = random_orthogonal_symplectic(n, rng), random_orthogonal_symplectic(n, rng)
    S = U @ np.diag(np.r_[s, 1 / s]) @ V
    phase = 2 * np.pi * rng.random(n)
    v = np.sqrt(np.r_[r, r]) * np.r_[np.cos(phase), np.sin(phase)]
    Q = S.T @ np.diag(np.r_[d, d]) @ S
    return 0.5 * (Q + Q.T), V.T @ (np.r_[1 / s, s] * (U.T @ v))


# --- modes that are given ------------------------------------------------------------------------------------------


@relaxed
@given(st.integers(1, 130), seeds, st.sampled_from([1e-9, 1.0, 1e9]))
def test_given_modes_are_reduced_as_by_their_groups(n, seed, scale):
    modes = exact_modes(n, seed, scale)
    slow, fast, direct = separate(modes), of_exact(modes), minimal_of_exact(modes)
    wanted = slow.minimal()
    for found in (fast.minimal(), direct):
        assert found.n == wanted.n
        assert np.all(np.abs(found.d - wanted.d) <= 4 * EPS * wanted.d)
        assert np.all(np.abs(found.r - wanted.r) <= n * EPS * wanted.r)
        assert np.array_equal(found.nu[:, 0], np.sqrt(found.r))
    hidden = slow.hidden()
    assert len(fast.hidden()) == len(hidden) == n - wanted.n
    assert np.all(np.abs(fast.hidden() - hidden) <= 8 * EPS * hidden)
    assert fast.is_minimal == slow.is_minimal


@relaxed
@given(st.integers(1, 40), seeds)
def test_a_loop_over_modes_and_array_operations_give_the_same(n, seed):
    modes = exact_modes(n, seed)
    one, other = minimal_of_exact(modes), of_exact(modes).minimal()
    assert np.all(np.abs(one.d - other.d) <= 2 * EPS * one.d)
    assert np.all(np.abs(one.r - other.r) <= n * EPS * one.r)


def test_what_needs_more_than_frequencies_and_weights_is_left_open():
    assert of_exact(phc.modes([], [])) is None
    assert of_exact(ModalForm(np.array([1.0]), np.ones((1, 2), complex), np.zeros((0, 2)))) is None
    assert of_exact(ModalForm(np.array([1.0]), np.ones((1, 1), complex), np.ones((1, 1)))) is None
    assert minimal_of_exact(phc.modes([1.0], [0.0])).n == 0


@pytest.mark.parametrize("k", [2, 3, 5])
def test_what_is_left_of_a_group_interlaces_with_its_frequencies(k):
    rng = np.random.default_rng(k)
    d, r = 2 + 1e-3 * np.sort(rng.random(k)), rng.uniform(0.1, 1, k)
    hidden = Reduction(d, r, np.array([0]), np.array([True])).hidden()
    assert np.all((d[:-1] <= hidden) & (hidden <= d[1:]))
    # the zeros of its residues' sum: sum_l r_l / (d_l - x)
    for x in hidden:
        terms = r / (d - x)
        assert abs(terms.sum()) <= 1e-7 * np.abs(terms).sum()


# --- matrices ------------------------------------------------------------------------------------------------------


def decided(Q, B):
    """`(fast, slow)`: the decision of frequencies and residues, None where there is none, and that of all the modes."""
    system = phc.ph(Q, B)
    found = port_spectrum(system.Q, system.B[:, 0])
    if found is not None and found[2] is None:
        fast = reachability.of_pairs(*found[:2])
    else:
        fast = None if found is None else of_matrix(*found, np.diag(system.Q))
    return fast, separate(phc.ph(Q, B).modes, (system.Q, system.B), system._energy)


def same_decision(fast, slow):
    starts = np.sort([int(g.members.min()) for g in slow.groups])
    ranks = [g.rank for g in sorted(slow.groups, key=lambda g: int(g.members.min()))]
    return np.array_equal(fast.starts, starts) and np.array_equal(fast.reached, np.array(ranks) > 0)


@relaxed
@given(st.integers(1, 12), st.sampled_from([1.0, 1e2, 1e4, 1e6]), seeds)
def test_where_it_is_decided_all_modes_decide_the_same(n, condition, seed):
    rng = np.random.default_rng(seed)
    d = np.sort(rng.choice(rng.uniform(1, 10, max(1, n // 2)), n))
    r = np.where(rng.random(n) < 0.3, 0.0, np.exp(rng.uniform(-1, 1, n)))
    fast, slow = decided(*matrix_of(d, r, condition, rng))
    if fast is not None:
        assert same_decision(fast, slow)
        small, wanted = fast.minimal(), slow.minimal()
        room = 4 * slow.errors.d.max()
        assert np.all(np.abs(small.d - wanted.d) <= room)
        nu = slow.errors.nu.max()
        assert np.all(np.abs(small.r - wanted.r) <= 4 * np.sqrt(wanted.r) * nu + 4 * nu**2)
        assert np.all(np.abs(fast.hidden() - slow.hidden()) <= room)


@relaxed
@given(st.integers(2, 60), seeds, st.sampled_from([1e-6, 1.0, 1e6]))
def test_well_conditioned_matrices_are_decided_and_rightly(n, seed, scale):
    rng = np.random.default_rng(seed)
    d = np.linspace(1.0, 5.0, n)
    d[1::4] = d[0::4][: len(d[1::4])]
    r = np.exp(rng.uniform(-1, 1, n))
    r[2::3] = 0.0
    fast, _ = decided(*matrix_of(scale * d, r, 4.0, rng))
    truth = np.unique(d[r > 0])
    assert fast is not None
    assert fast.minimal().n == len(truth)
    assert np.max(np.abs(fast.minimal().d / scale - truth)) < 1e-12
    assert np.max(np.abs(fast.minimal().r - [r[d == x].sum() for x in truth])) < 1e-9


@pytest.mark.variants
@pytest.mark.parametrize("condition", [1.0, 1e3])
@pytest.mark.parametrize("what", ["gap", "weight"])
def test_on_the_way_from_equal_to_different_the_decision_is_right_or_open_and_not_always_open(what, condition):
    verdicts = []
    for exponent in np.arange(-17.0, -1.0, 0.25):
        rng = np.random.default_rng(5)
        gap, weight = (10**exponent, 0.3) if what == "gap" else (1.0, 10**exponent)
        d, r = np.array([1.0, 1.0 + gap, 3.5, 5.0]), np.array([1.0, weight**2, 0.25, 0.5])
        fast, slow = decided(*matrix_of(d, r, condition, rng))
        if fast is not None:
            assert same_decision(fast, slow), exponent
        verdicts.append(None if fast is None else fast.minimal().n)
    told = [v for v in verdicts if v is not None]
    # merged or dropped first, kept last, and in between left open
    assert set(told) == {3, 4}
    assert told == sorted(told)
    assert verdicts[-1] == 4
    middle = verdicts[len(verdicts) - verdicts[::-1].index(3) : verdicts.index(4)]
    assert middle and all(v is None for v in middle)


def test_a_matrix_near_a_singular_one_is_left_open():
    rng = np.random.default_rng(0)
    Q, B = matrix_of(np.array([1.0, 1.5, 2.0]), np.ones(3), 1e7, rng)
    d, kappa = np.array([1.0, 1.0 + 1e-6, 2.0]), np.ones(3)
    _, _, inverse = port_spectrum(Q, B)
    root = np.sqrt(np.diag(Q))
    assert inverse >= 1 / np.linalg.eigvalsh(Q / root / root[:, None])[0]
    assert of_matrix(d, kappa, inverse, np.diag(Q)) is None
    assert of_matrix(d, kappa, 1.0, np.ones(6)) is not None


def pairs_of(n, coupling, rng, repeated=True):
    """`(Q, B)` of pairs that nothing couples, some of one frequency in units of their own, some unreached."""
    d = np.sort(rng.choice(10 ** rng.uniform(-3, 3, max(1, n // 2 if repeated else n)), n, replace=repeated))
    c, unit = coupling * rng.uniform(-1, 1, n), 2.0 ** rng.integers(-8, 8, n)
    size = d / np.sqrt(1 - c * c)
    Q = np.diag(np.r_[size * unit, size / unit]) + np.diag(size * c, n) + np.diag(size * c, -n)
    B = rng.standard_normal(2 * n) * np.tile(np.where(rng.random(n) < 0.3, 0.0, 10.0 ** rng.uniform(-30, 3, n)), 2)
    B[0] = 1.0
    return Q, B


@relaxed
@given(st.integers(2, 40), st.sampled_from([0.0, 0.2, 0.49]), seeds)
def test_pairs_that_nothing_couples_are_decided_as_by_their_modes(n, coupling, seed):
    Q, B = pairs_of(n, coupling, np.random.default_rng(seed))
    system, modes = phc.ph(Q, B), phc.ph(Q, B).modes
    d, kappa, inverse = port_spectrum(system.Q, B)
    assert inverse is None
    assert np.all(np.abs(d - modes.d) <= 8 * EPS * d)
    # modes of one frequency may come in another order
    assert abs(kappa.sum() - modes.kappa.sum()) <= 20 * EPS * kappa.sum()
    fast, slow = reachability.of_pairs(d, kappa), separate(modes, (system.Q, system.B), system._energy)
    assert fast is not None
    small, wanted = fast.minimal(), slow.minimal()
    assert small.n == wanted.n
    assert np.all(np.abs(small.d - wanted.d) <= 20 * EPS * wanted.d)
    assert np.all(np.abs(small.r - wanted.r) <= 100 * EPS * wanted.r)
    assert len(fast.hidden()) == n - small.n


def test_a_pair_that_is_nearly_free_and_weights_out_of_range_are_left_to_the_modes():
    Q = np.diag([1.0, 2.0, 1.0, 2.0])
    assert port_spectrum(Q, np.ones(4)) is not None
    Q[0, 2] = Q[2, 0] = 0.9
    assert port_spectrum(Q, np.ones(4)) is None
    assert phc.minreal(phc.ph(Q, np.ones(4))).n == 2
    assert port_spectrum(np.diag([1.0, 0.0, 1.0, 1.0]), np.ones(4)) is None
    assert port_spectrum(np.eye(4), np.array([1.0, 1e-150, 0.0, 0.0])) is None


@pytest.mark.parametrize("exponent", np.arange(-17.0, -10.0, 0.25))
def test_near_frequencies_of_pairs_are_merged_kept_or_left_open(exponent):
    d = np.array([1.0, 1.0 + 10**exponent, 3.0])
    Q, B = np.diag(np.r_[d, d]), np.ones(6)
    found = reachability.of_pairs(*port_spectrum(Q, B)[:2])
    slow = separate(phc.ph(Q, B).modes, (Q, B[:, None]), phc.ph(Q, B)._energy).minimal().n
    assert found is None or found.minimal().n == slow
    assert (found is None) <= (-15.5 < exponent < -13)


# --- systems ---------------------------------------------------------------------------------------------------------


def reducible_system():
    return matrix_of(np.array([1.0, 1.0, 2.0, 3.0]), np.array([1.0, 2.0, 0.0, 1.0]), 4.0, np.random.default_rng(1))


def test_no_modes_are_computed_for_the_minimal_system_and_the_transformation_only_when_looked_at():
    system = phc.ph(*reducible_system())
    small, decomposition = phc.minreal(system), phc.kalman_decomposition(system)
    assert (small.n, decomposition.reachable.n, decomposition.hidden.n) == (2, 2, 2)
    assert not system.is_canonical
    assert system._modes is None and "_energy" not in system._views
    assert decomposition.T.shape == (8, 8)
    assert system._modes is not None
    assert decomposition.T is decomposition[2] and not decomposition.T.flags.writeable


def test_the_transformation_fits_the_parts_that_were_decided_without_it(monkeypatch):
    Q, B = reducible_system()
    fast = phc.kalman_decomposition(phc.ph(Q, B))
    monkeypatch.setattr(reachability, "of_matrix", lambda *arguments: None)
    slow = phc.kalman_decomposition(phc.ph(Q, B))
    for one, other in ((fast, slow), (slow, fast)):
        back = np.linalg.inv(one.T)
        both = phc.ph(phc.modes(np.r_[other.reachable.d, other.hidden.d], np.r_[other.reachable.r, other.hidden.d * 0]))
        order = np.argsort(np.r_[other.reachable.d, other.hidden.d], kind="stable")
        order = np.argsort(np.r_[order, order + 4])
        assert np.abs(back.T @ Q @ back - both.Q[np.ix_(order, order)]).max() < 1e-12
        assert np.abs(one.T @ B - both.B[order, 0]).max() < 1e-12


def test_a_decomposition_is_a_sequence_of_three_that_can_be_stored_and_not_changed():
    decomposition = phc.kalman_decomposition(phc.ph(*reducible_system()))
    reachable, hidden, T = decomposition
    assert (reachable, hidden) == decomposition[:2] and decomposition[-1] is T and len(decomposition) == 3
    again = pickle.loads(pickle.dumps(decomposition))
    assert np.array_equal(again.T, T) and np.array_equal(again.reachable.d, reachable.d)
    with pytest.raises(AttributeError):
        decomposition.reachable = hidden
    with pytest.raises(AttributeError):
        decomposition.T = T
    with pytest.raises(IndexError):
        decomposition[3]
    assert "2 modes" in repr(decomposition)


@pytest.mark.parametrize("ports", [1, 2])
def test_the_verdict_on_a_system_is_that_of_its_groups(ports):
    rng = np.random.default_rng(ports)
    for r in ([1.0, 1.0, 1.0], [1.0, 0.0, 1.0]):
        for d in ([1.0, 2.0, 3.0], [1.0, 1.0, 3.0]):
            Q, B = matrix_of(np.array(d), np.array(r), 4.0, rng)
            system = phc.ph(Q, np.stack([B] * ports, axis=1))
            assert system.is_canonical == (min(r) > 0 and d[0] < d[1])
            assert phc.ph(phc.modes(d, r)).is_canonical == (min(r) > 0 and d[0] < d[1])


def test_frequencies_on_the_diagonal_are_kept_to_the_last_bit():
    d = np.sort(np.random.default_rng(0).uniform(0.1, 10, 50))
    found, _, _ = port_spectrum(np.diag(np.r_[d, d]), np.ones(100))
    assert np.array_equal(found, d)

"""Modes that a port reaches: of modes that are given, and of matrices."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, random_orthogonal_symplectic

import ph_control as phc
from ph_control.modal.error_bounds import separate

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
@given(st.integers(0, 130), seeds, st.sampled_from([1e-9, 1.0, 1e9]))
def test_given_modes_are_reduced_as_by_their_groups(n, seed, scale):
    modes = exact_modes(n, seed, scale)
    found, wanted = modes.minimal(), separate(modes).minimal()
    assert found.n == wanted.n
    assert np.all(np.abs(found.d - wanted.d) <= 4 * EPS * wanted.d)
    assert np.all(np.abs(found.r - wanted.r) <= n * EPS * wanted.r)
    assert np.array_equal(found.nu[:, 0], np.sqrt(found.r))
    assert modes.is_minimal == (found.n == n)


def test_modes_that_are_minimal_are_kept_to_the_last_bit():
    modes = phc.modes([1.0, 3.0, 7.0], [0.3, 0.1, 0.7])
    assert np.array_equal(modes.minimal().d, modes.d) and np.array_equal(modes.minimal().r, modes.r)
    assert phc.modes([1.0], [0.0]).minimal().n == 0


# --- systems ---------------------------------------------------------------------------------------------------------


def reducible_system():
    return matrix_of(np.array([1.0, 1.0, 2.0, 3.0]), np.array([1.0, 2.0, 0.0, 1.0]), 4.0, np.random.default_rng(1))


def test_the_transformation_is_computed_when_it_is_looked_at_and_fits_the_parts():
    Q, B = reducible_system()
    decomposition = phc.kalman_decomposition(phc.ph(Q, B))
    assert (decomposition.reachable.n, decomposition.hidden.n) == (2, 2)
    both = decomposition.reachable + decomposition.hidden
    assert decomposition.T is decomposition[2] and not decomposition.T.flags.writeable
    back = np.linalg.inv(decomposition.T)
    assert np.abs(back.T @ Q @ back - both.Q).max() < 1e-12
    assert np.abs(decomposition.T @ B - both.B[:, 0]).max() < 1e-12


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

"""Structures that no spring ties to the ground, and parts that none ties to the others."""

from __future__ import annotations

import warnings

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.linalg import eigh, null_space

import ph_control as phc

OMEGA = np.geomspace(1e-3, 20.0, 5)


def drawn(n, level, seed):
    """Masses, springs and ground dampers of about `level` of a floating chain."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 2.0, n), rng.uniform(1.0, 5.0, n - 1), level * rng.uniform(0.1, 1.0, n)


def velocity_of_first(m, k, c, unit=1.0):
    """Response of the first velocity to the force on the first mass, in 50 digits; frequencies in units of `unit`."""
    n, values = len(m), []
    with mp.workdps(50):
        for omega in OMEGA:
            s = mp.mpc(0, omega * unit)
            Z = mp.diag([s * s * mp.mpf(m[i]) + s * mp.mpf(c[i]) for i in range(n)])
            for i, spring in enumerate(map(mp.mpf, k)):
                for row, column, sign in ((i, i, 1), (i + 1, i + 1, 1), (i, i + 1, -1), (i + 1, i, -1)):
                    Z[row, column] += sign * spring
            unit_force = mp.matrix([1] + [0] * (n - 1))
            values.append(complex(s * mp.lu_solve(Z, unit_force)[0]))
    return np.array(values)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 8), st.sampled_from([1e-11, 1e-6, 1e-3, 1.0, 30.0]), st.integers(0, 10**6))
def test_a_floating_chain_with_ground_dampers_loses_its_common_position_alone(n, level, seed):
    m, k, c = drawn(n, level, seed)
    small = phc.minreal(phc.spring_chain(m, k if n > 1 else 1.0, ground_c=c))
    assert (small.nstates, small.conversion.hidden, small.conversion.energy) == (2 * n - 1, 1, "given")
    wanted = velocity_of_first(m, k, c)
    np.testing.assert_allclose(small(1j * OMEGA), wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
    assert np.linalg.eigvalsh(small.Q)[0] > 0 and np.linalg.eigvalsh(small.R)[0] > -1e-15 * np.abs(small.R).max()
    again = phc.minreal(small)
    assert again.conversion.hidden == 0
    np.testing.assert_array_equal(again.Q, small.Q)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_units_of_a_floating_chain_do_not_matter(unit):
    m, k, c = drawn(5, 1.0, 3)
    small = phc.minreal(phc.spring_chain(m, k * unit**2, ground_c=c * unit))
    wanted = velocity_of_first(m, k * unit**2, c * unit, unit)
    assert small.nstates == 9
    np.testing.assert_allclose(small(1j * OMEGA * unit), wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.parametrize("seed", range(4))
def test_a_plain_state_space_of_a_floating_chain_is_converted_and_reduced(seed):
    m, k, c = drawn(6, 1.0, seed)
    chain = phc.spring_chain(m, k, ground_c=c)
    plain = ct.ss(chain.A, chain.B, chain.C, 0)
    wanted = velocity_of_first(m, k, c)
    for made, states in ((phc.ph(plain), 12), (phc.minreal(plain), 11)):
        assert made.nstates == states
        np.testing.assert_allclose(made(1j * OMEGA), wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())


def test_a_hidden_mode_goes_with_the_common_position():
    # of three equal masses the middle one does not see the others against each other
    chain = phc.spring_chain([1.0, 1.0, 1.0], [2.0, 2.0], ground_c=[0.3, 0.5, 0.3], port=1)
    small = phc.minreal(chain)
    assert (small.nstates, small.conversion.hidden) == (3, 3)
    wanted = chain(1j * OMEGA)
    np.testing.assert_allclose(small(1j * OMEGA), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


def test_rows_of_sensors_are_kept_in_the_states_that_are_left():
    m, k, c = drawn(4, 1.0, 9)
    chain = phc.spring_chain(m, k, ground_c=c)
    rows = np.zeros((2, 8))
    rows[0, :2], rows[1, 6] = [1.0, -1.0], 1 / m[2]  # a spring, and the velocity of the third mass
    measured = phc.ph(chain.Q, chain.G, R=chain.R, sensors=rows)
    small = phc.minreal(measured)
    assert small.nstates == 7
    s = 1j * OMEGA
    np.testing.assert_allclose(small(s), measured(s), rtol=0, atol=1e-12 * np.abs(measured(s)).max())


# --- parts that nothing holds ---


def line(n):
    return 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def with_loose(structure, loose, seed, *, coupled=False):
    """Mass and stiffness of a structure with loose degrees of freedom anywhere among the others."""
    rng = np.random.default_rng(seed)
    n = len(structure) + loose
    K = np.zeros((n, n))
    K[loose:, loose:] = structure
    M = np.diag(rng.uniform(0.5, 2.0, n))
    if coupled:
        root = rng.standard_normal((n, 3)) / np.sqrt(n)
        M = M + root @ root.T
    order = rng.permutation(n)
    return M[np.ix_(order, order)], K[np.ix_(order, order)]


CHOICES = [{}, {"modes": 3}, {"modes": 15}, {"band": (0.0, 0.3)}, {"band": (0.05, 0.3)}]


@pytest.mark.parametrize("choice", CHOICES)
@pytest.mark.parametrize("loose, coupled", [(1, False), (1, True), (2, True), (3, False), (5, True), (5, False)])
def test_masses_that_no_spring_holds_are_rigid_modes(loose, coupled, choice):
    M, K = with_loose(line(70), loose, 3, coupled=coupled)
    F = np.random.default_rng(1).standard_normal(len(M))
    sys = phc.from_second_order(M, K, F, **choice)
    assert sys.rigid_modes == loose
    if not choice:
        np.testing.assert_allclose(sys.Q[: len(M), : len(M)], K, atol=1e-14)
        return
    squares, shapes = eigh(K, M)
    still = shapes[:, np.abs(squares) < 1e-10]
    kept = sys.structural_modes
    assert still.shape[1] == loose == np.count_nonzero(kept.natural_frequencies == 0) and kept.is_complete
    # the same motions, whatever their basis
    rigid = kept.shapes[:, kept.natural_frequencies == 0]
    np.testing.assert_allclose(rigid @ rigid.T, still @ still.T, atol=1e-12)
    elastic = kept.natural_frequencies[loose:]
    exact = np.sqrt(squares[np.abs(squares) > 1e-10])
    first = np.searchsorted(exact, choice["band"][0]) if "band" in choice else 0
    np.testing.assert_allclose(elastic, exact[first : first + len(elastic)], rtol=1e-10)


@pytest.mark.parametrize("spread", [1e-6, 1.0, 1e6])
def test_a_loose_mass_beside_stiffness_of_any_spread(spread):
    stiff = np.diag(np.geomspace(1.0, spread, 120)) @ (2 * np.eye(120) + np.diag(np.linspace(-1, 1, 120)))
    M, K = with_loose(stiff, 2, 5)
    sys = phc.from_second_order(sparse.csc_array(M), sparse.csc_array(K), np.ones(122), modes=6)
    assert np.count_nonzero(sys.structural_modes.natural_frequencies == 0) == 2


@pytest.mark.parametrize("options", [{}, {"modes": 4}])
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units_of_loose_masses_do_not_matter(unit, options):
    M, K = with_loose(line(60), 2, 8)
    sys = phc.from_second_order(unit * M, K / unit, np.ones(62), **options)
    plain = phc.from_second_order(M, K, np.ones(62), **options)
    assert sys.rigid_modes == plain.rigid_modes
    np.testing.assert_allclose(sys.d * unit, plain.d, rtol=1e-9)


def frame_without_diagonals(n):
    """Stiffness of a square net whose rows and columns slide as wholes: 2 n mechanisms in a connected structure."""
    along = sparse.diags_array(
        [np.r_[1.0, np.full(n - 2, 2.0), 1.0], -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1]
    )
    unit = sparse.eye_array(n)
    return sparse.block_diag([sparse.kron(unit, along), sparse.kron(along, unit)], format="csc")


@pytest.mark.variants
@pytest.mark.parametrize("n", [12, 30])
def test_a_large_kernel_is_counted_found_and_said(n):
    K = frame_without_diagonals(n)
    M = sparse.diags_array(np.random.default_rng(0).uniform(0.5, 2.0, K.shape[0]))
    F = np.ones(K.shape[0])
    with pytest.warns(
        phc.ConditioningWarning, match=f"{2 * n} motions without stiffness, more than the 5 modes"
    ) as said:
        sys = phc.from_second_order(M, K, F, modes=5)
    assert said[0].filename == __file__
    kept = sys.structural_modes
    assert not kept.natural_frequencies.any() and kept.shapes.shape[1] == 2 * n and kept.is_complete
    free = null_space(K.toarray())
    assert free.shape[1] == 2 * n
    np.testing.assert_allclose(free @ (free.T @ kept.shapes), kept.shapes, atol=1e-11)
    np.testing.assert_allclose(kept.shapes.T @ (M @ kept.shapes), np.eye(2 * n), atol=1e-12)
    more = phc.from_second_order(M, K, F, modes=2 * n + 4).structural_modes
    exact = np.sqrt(eigh(K.toarray(), M.toarray(), eigvals_only=True)[2 * n :])
    elastic = more.natural_frequencies[more.natural_frequencies > 0]
    assert len(more.natural_frequencies) - len(elastic) == 2 * n
    np.testing.assert_allclose(elastic, exact[: len(elastic)], rtol=1e-9)


@pytest.mark.variants
@pytest.mark.parametrize("loose, modes", [(40, 50), (120, 10), (120, 130)])
def test_many_loose_masses_beside_a_soft_chain_are_all_rigid(loose, modes):
    # whose lowest modes are only some thousand times the shift
    n = 3000
    K = sparse.block_diag([sparse.csc_array((loose, loose)), sparse.csc_array(line(n))], format="csc")
    order = np.random.default_rng(2).permutation(n + loose)
    M = sparse.eye_array(n + loose).tocsc()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", phc.ConditioningWarning)
        sys = phc.from_second_order(M, K[order][:, order], np.eye(n + loose)[order[0]], modes=modes)
    kept = sys.structural_modes
    assert sys.rigid_modes == np.count_nonzero(kept.natural_frequencies == 0) == loose and kept.is_complete
    exact = 2 * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    elastic = kept.natural_frequencies[loose:]
    np.testing.assert_allclose(elastic, exact[: len(elastic)], rtol=1e-8)
    np.testing.assert_allclose(kept.shapes.T @ kept.shapes, np.eye(len(kept.natural_frequencies)), atol=1e-12)


def test_soft_but_not_loose_parts_are_elastic():
    # sixty oscillators on springs of 1e-8 of those beside them
    K = sparse.diags_array(np.r_[np.full(60, 1e-8), np.linspace(1.0, 2.0, 200)]).tocsc()
    kept = phc.from_second_order(sparse.eye_array(260), K, np.ones(260), modes=60).structural_modes
    np.testing.assert_allclose(kept.natural_frequencies, 1e-4, rtol=1e-9)

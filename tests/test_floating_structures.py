"""Structures that no spring ties to the ground, and parts that none ties to the others."""

from __future__ import annotations

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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

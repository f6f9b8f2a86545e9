"""Motions without kinetic energy of mass matrices as programs print them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc


def drawn(n, massless, seed):
    """Mass matrix of rank n - massless with its kernel, stiffness, and a force of which the kernel has no part."""
    rng = np.random.default_rng(seed)
    kernel = np.linalg.qr(rng.standard_normal((n, massless)))[0]
    still = kernel @ kernel.T
    M = (np.eye(n) - still) @ np.diag(rng.uniform(1.0, 3.0, n)) @ (np.eye(n) - still)
    root = rng.standard_normal((n, n))
    force = (np.eye(n) - still) @ rng.standard_normal(n)
    return 0.5 * (M + M.T), kernel, root @ root.T + np.eye(n), force


def printed(M, digits):
    """The matrix as a file of so many digits holds it."""
    return np.array([[float(f"{entry:.{digits - 1}e}") for entry in row] for row in M])


def velocity(M, K, F, s, C=0.0):
    return s * F @ np.linalg.solve(s**2 * M + s * C + K, F.astype(complex))


@settings(max_examples=13, deadline=None)
@given(st.integers(2, 9), st.integers(1, 3), st.sampled_from([9, 10, 12, 16]), st.integers(0, 10**6))
def test_a_printed_mass_matrix_is_condensed_like_the_exact_one(n, massless, digits, seed):
    massless = min(massless, n - 1)
    M, _, K, F = drawn(n, massless, seed)
    sys = phc.from_second_order(printed(M, digits), K, F, condense=True)
    assert sys.n == n - massless
    for s in (0.3 + 0.7j, 0.1 + 2j):
        wanted = velocity(M, K, F, s)
        np.testing.assert_allclose(sys(s), wanted, rtol=0, atol=10.0 ** (6 - min(digits, 13)) * np.abs(wanted))


@pytest.mark.parametrize("digits", [9, 10, 12, 16])
@pytest.mark.parametrize("part", [1e-6, 1e-3, 1.0])
def test_a_force_on_a_massless_motion_is_refused_with_its_part_and_the_degrees_of_freedom(digits, part):
    M, kernel, K, F = drawn(6, 1, 4)
    with pytest.raises(
        phc.StructureError, match=r"a force acts on .* of force 2 acts on a motion of \(.*give them mass"
    ):
        phc.from_second_order(printed(M, digits), K, np.column_stack([F, F + part * kernel[:, 0]]), condense=True)


def test_the_message_names_the_degrees_of_freedom_that_move_without_mass():
    motion = np.zeros(7)
    motion[[1, 4, 5]] = [1.0, -2.0, 1.0]
    unit = motion / np.linalg.norm(motion) + 1e-10 * np.random.default_rng(1).standard_normal(7)
    unit /= np.linalg.norm(unit)
    M, K = np.eye(7) - np.outer(unit, unit), 3 * np.eye(7) - np.eye(7, k=1) - np.eye(7, k=-1)
    for k in range(7):
        if motion[k]:
            with pytest.raises(phc.StructureError, match=r"a motion of \(2, 5, 6, counted from 1\)"):
                phc.from_second_order(M, K, np.eye(7)[k], condense=True)
        else:
            assert phc.from_second_order(M, K, np.eye(7)[k], condense=True).n == 6


def test_dampers_on_the_others_stay_and_those_on_massless_motions_are_refused():
    M, kernel, K, F = drawn(6, 2, 7)
    apart = np.eye(6) - kernel @ kernel.T
    C = 0.2 * apart @ np.diag(np.arange(1.0, 7.0)) @ apart
    sys = phc.from_second_order(printed(M, 10), K, F, C=0.5 * (C + C.T), condense=True)
    s = 0.1 + 1j
    np.testing.assert_allclose(sys(s), velocity(M, K, F, s, C), rtol=1e-6)
    with pytest.raises(phc.StructureError, match="dampers act on degrees of freedom without mass"):
        phc.from_second_order(M, K, F, C=np.eye(6), condense=True)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_units_of_the_degrees_of_freedom_do_not_matter(unit):
    M, _, K, F = drawn(5, 1, 11)
    scale = np.array([1.0, unit, 1.0, unit, 1.0])
    turned = scale[:, None] * printed(M, 10) * scale, scale[:, None] * K * scale
    sys = phc.from_second_order(*turned, scale * F, condense=True)
    s = 0.2 + 1j
    assert sys.n == 4
    np.testing.assert_allclose(sys(s), velocity(M, K, F, s), rtol=1e-6)


def test_light_masses_stay_and_a_mass_matrix_that_is_rounded_to_indefinite_is_called_singular():
    M, _, K, F = drawn(4, 1, 2)
    light = M + np.diag([0, 0, 0, 1e-4])
    assert phc.from_second_order(light, K, F, condense=True).n == 4
    light = np.diag([1.0, 1.0, 1e-12])  # by its units
    assert phc.from_second_order(light, np.eye(3), [1.0, 0, 0], condense=True).n == 3
    rng = np.random.default_rng(0)
    rough = M - 1e-10 * np.abs(rng.standard_normal(1)) * np.eye(4)
    with pytest.raises(phc.StructureError, match=r"M is singular: .*condense=True"):
        phc.from_second_order(rough, K, F)
    with pytest.raises(phc.StructureError, match="M is indefinite"):
        phc.from_second_order(M - 1e-5 * np.eye(4), K, F, condense=True)

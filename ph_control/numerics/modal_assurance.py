"""Comparison of mode shapes: modal assurance (MAC), phase collinearity (MPC), and poles stable over orders."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from .._checks import TINY, shown
from .._types import Array, ComplexArray
from ..exceptions import StructureError


def mac(shapes1: ComplexArray, shapes2: ComplexArray) -> Array:
    """Modal assurance criterion `|c^H c'|^2 / (|c|^2 |c'|^2)` of shapes (n, p) and (n', p), shape (n, n').

    1 where two shapes are a multiple of each other, 0 where they are orthogonal, or one of them vanishes.
    """
    if shapes1.shape[1] != shapes2.shape[1]:
        raise StructureError(
            f"shapes of {shapes1.shape[1]} and of {shapes2.shape[1]} outputs; they must be the same ones"
        )
    return np.asarray(np.minimum(np.abs(_unit(shapes1).conj() @ _unit(shapes2).T) ** 2, 1.0), float)


def phase_collinearity(shapes: ComplexArray) -> Array:
    """Modal phase collinearity (MPC) `|c^T c|^2 / (c^H c)^2` of shapes (.., p), shape (..): 1 if all phases are one.

    With the eigenvalues `l1 >= l2` of the scatter of the entries in the complex plane it is
    `((l1 - l2) / (l1 + l2))^2`: 0 where they scatter alike in all directions.  That of a shape that vanishes is NaN.
    """
    unit = _unit(shapes)
    collinearity = np.minimum(np.abs(np.sum(unit * unit, axis=-1)) ** 2, 1.0)
    return np.where(unit.any(axis=-1), collinearity, np.nan)


def aligned_shapes(shapes: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Shapes (.., p) turned so that their real parts are as large as can be, and the factors (.., 1) that turn them.

    The entry of the largest real part is positive.
    """
    unit = _unit(shapes)
    # the sum of squares has twice the phase of the direction along which the entries scatter
    turn = np.exp(-0.5j * np.angle(np.sum(unit * unit, axis=-1, keepdims=True)))
    real = (unit * turn).real
    lead = np.take_along_axis(real, np.abs(real).argmax(axis=-1, keepdims=True), axis=-1)
    turn = np.where(lead < 0, -turn, turn)
    return shapes * turn, turn


def _unit(shapes: ComplexArray) -> ComplexArray:
    """Shapes of norm 1; 0 of those that vanish."""
    # first by the largest part, as squares of entries may leave the range of doubles
    peak = np.maximum(np.abs(shapes.real), np.abs(shapes.imag)).max(axis=-1, keepdims=True, initial=TINY)
    scaled = shapes / peak
    return np.asarray(scaled / np.maximum(np.linalg.norm(scaled, axis=-1, keepdims=True), TINY))


class Stability(IntEnum):
    """Quantities in which a pole agrees with one of the order before."""

    NEW = 0
    FREQUENCY = 1
    DAMPING = 2
    SHAPE = 3


def stable_poles(
    poles: Sequence[ComplexArray],
    shapes: Sequence[ComplexArray] | None = None,
    *,
    frequency_tolerance: float = 0.01,
    damping_tolerance: float = 0.05,
    least_mac: float = 0.95,
) -> tuple[list[NDArray[np.int8]], list[Array]]:
    """For the poles (k,) of each order, with shapes (k, p), their `Stability` against those of the order before.

    And the MAC with the pole of the order before that confirms each; NaN without one, and of a single output.

    A pole is stable in frequency if one of the order before has the same `|p|` to `frequency_tolerance`, in damping if
    its ratio, not negative, is the same to `damping_tolerance` as well, both relative to the larger one, and in shape
    if besides the MAC of both reaches `least_mac`.  Each pole of the order before confirms one at most: that of the
    most in common, then the nearest.  A single output has no shape.
    """
    for name, value in (
        ("frequency_tolerance", frequency_tolerance), ("damping_tolerance", damping_tolerance), ("least_mac", least_mac)
    ):  # fmt: skip
        if isinstance(value, bool) or not (isinstance(value, int | float | np.floating) and 0 <= value <= 1):
            raise StructureError(f"{name} is {shown(value)}; it must be a number from 0 to 1")
    stability = [np.zeros(len(row), np.int8) for row in poles]
    assurance = [np.full(len(row), np.nan) for row in poles]
    seen = shapes is not None and all(row.shape[1] > 1 for row in shapes)
    for k in range(1, len(poles)):
        d, before = np.abs(poles[k])[:, None], np.abs(poles[k - 1])[None, :]
        zeta, earlier = (_ratios(row) for row in (poles[k], poles[k - 1]))
        distance = np.abs(d - before) / np.maximum(np.maximum(d, before), TINY)
        in_frequency = distance <= frequency_tolerance
        sizes = np.maximum(np.abs(zeta)[:, None], np.abs(earlier))
        in_damping = in_frequency & (np.abs(zeta[:, None] - earlier) <= damping_tolerance * sizes)
        in_damping &= zeta[:, None] >= 0
        level = in_frequency.astype(np.int8) + in_damping
        alike = mac(shapes[k], shapes[k - 1]) if seen and shapes is not None else np.full(level.shape, np.nan)
        level += in_damping & (alike >= least_mac)
        # one level outweighs any sum of distances, of which each counts less than its share of 1
        near = np.where(in_frequency, distance, 0.0) / (frequency_tolerance or 1.0) / (2.0 * (len(d) + 1))
        mine, its = linear_sum_assignment(np.where(in_frequency, near - level, 0.0))
        stability[k][mine] = level[mine, its]
        assurance[k][mine] = np.where(in_frequency, alike, np.nan)[mine, its]
    return stability, assurance


def _ratios(poles: ComplexArray) -> Array:
    """Damping ratios; 0 of a pole at 0."""
    return np.asarray(-poles.real / np.maximum(np.abs(poles), TINY))

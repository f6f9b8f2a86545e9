"""Modes of a computed model paired with fitted ones, by frequency and modal assurance (MAC)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..._types import Array, ComplexArray, Indices
from ...numerics.modal_assurance import mac
from .physical_modes import PhysicalModes

_UNLIKE = 0.5  # logarithm of a ratio of frequencies that counts as much as shapes that have nothing in common


def paired(
    frequencies: Array, shapes: ComplexArray, computed: Array, computed_shapes: ComplexArray
) -> tuple[Indices, Array]:
    """Pair each fitted mode with a computed one, as far as there are some.

    Parameters
    ----------
    frequencies, computed : ndarray, shape (n,) and (k,)
        Of fitted and computed modes.
    shapes, computed_shapes : ndarray of complex, shape (n, p) and (k, p)
        At the same outputs; of one output they tell nothing.

    Returns
    -------
    ndarray of int, shape (n,)
        Place of the computed mode, -1 for none.
    ndarray, shape (n,)
        MAC of the pair; NaN for none.
    """
    distance = np.abs(np.log(np.maximum(frequencies, 1e-300))[:, None] - np.log(np.maximum(computed, 1e-300)))
    alike = mac(shapes, computed_shapes) if shapes.shape[1] > 1 else np.ones(distance.shape)
    places = np.full(len(frequencies), -1)
    mine, its = linear_sum_assignment(distance / _UNLIKE + (1.0 - alike))
    places[mine] = its
    assurance = np.full(len(frequencies), np.nan)
    assurance[mine] = alike[mine, its]
    return places, assurance


def followed(before: PhysicalModes, after: PhysicalModes) -> PhysicalModes:
    """Modes in the order of those of neighbouring parameters; as they were where poles turned real, or complex."""
    order = np.empty(len(before.poles), int)
    for mine, others in (
        (np.flatnonzero(before.real), np.flatnonzero(after.real)),
        (np.flatnonzero(~before.real), np.flatnonzero(~after.real)),
    ):
        if len(mine) != len(others):
            return before
        order[mine] = others[_nearest(before.poles[mine], after.poles[others])]
    return after.among(order)


def _nearest(before: ComplexArray, after: ComplexArray) -> Indices:
    """Place of each pole among others that are so near that each has one."""
    distance = np.abs(before[:, None] - after[None])
    return np.asarray(linear_sum_assignment(distance)[1], int)

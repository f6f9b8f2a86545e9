"""Modes of a computed model paired with fitted ones, by frequency and modal assurance (MAC)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..._types import Array, ComplexArray, Indices
from ...numerics.mode_shapes import mac

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

"""Frequencies at which a model of known poles is worst: minima of a function over the imaginary axis."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..._types import Array, ComplexArray
from ...modal.positive_real import lowest_places

_NEAR = 57  # points about each pole
_ZOOMS = 4  # towards a minimum between three points, to a hundredth of their distance squared


def minima(least: Callable[[Array], Array], poles: ComplexArray) -> list[float]:
    """Local minima between 0 and infinity of `least`, a function of frequencies (K,) that varies as its poles do."""
    grid = _grid(poles)
    values = least(grid)
    inner = lowest_places(values)
    if not len(inner):
        return []
    low, high = grid[inner - 1], grid[inner + 1]
    for _ in range(_ZOOMS):
        closer = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, 17)
        values = least(closer.ravel()).reshape(closer.shape)
        k = np.argmin(values, axis=1)
        rows = np.arange(len(k))
        low, high = closer[rows, np.maximum(k - 1, 0)], closer[rows, np.minimum(k + 1, 16)]
    return [float(w) for w in closer[rows, k]]


def _grid(poles: ComplexArray) -> Array:
    """Frequencies dense about the poles, evenly spaced between them, and beyond."""
    size = float(np.abs(poles).max())
    near = (poles.imag[:, None] + poles.real[:, None] * np.sinh(np.linspace(-7.0, 7.0, _NEAR))).ravel()
    even = np.linspace(0.0, 2 * size, 20 * len(poles))
    return np.unique(np.concatenate([near[near > 0], even, np.geomspace(2, 100, 20) * size]))

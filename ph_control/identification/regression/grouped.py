"""Inner products of columns that follow, group by group of samples, from a few numbers about each group.

Within a group of samples every column is `sum_r V_r phi_r(s)`, with numbers `V_r` of the group (modal amplitudes at its
start, its inputs, its outputs) and functions `phi_r` of the place `s` in the group that are the same for all groups.
The inner products of the columns are then those of the rows of V, which are fewer by the length of a group, weighted by
inner products of the functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._types import Array


@dataclass(frozen=True)
class Modal:
    """Columns of which each has one row of V of its own: column l adds `V[rows][l] * phi[l, s]`, `phi` (n, s)."""

    columns: slice
    rows: slice
    phi: Array


@dataclass(frozen=True)
class Shared:
    """Columns made of the same m rows of V: column l adds `sum_j V[rows][j] * weights[l, j, s]`, (n, m, s)."""

    columns: slice
    rows: slice
    weights: Array


def gram(size: int, modal: Sequence[Modal], shared: Sequence[Shared], inner: Array) -> Array:
    """Inner products (size, size) of columns given by their parts, from those of the rows of V.

    Parts that name the same columns add up.  O(n^2) operations, whatever the number of groups.
    """
    found = np.zeros((size, size))
    # (m, place, row of V): what meets in a product of two columns is the place in the group
    weights = [np.ascontiguousarray(one.weights.transpose(0, 2, 1)) for one in shared]
    for first, one in zip(shared, weights, strict=True):
        for second, two in zip(shared, weights, strict=True):
            common = one @ inner[first.rows, second.rows]
            found[first.columns, second.columns] += _flat(common) @ _flat(two).T
    if not modal:
        return found
    rows = np.concatenate([np.arange(len(inner))[one.rows] for one in modal])
    phi = np.concatenate([one.phi for one in modal])
    of_rows = inner[rows]
    found += _summed(size, modal, _summed(size, modal, of_rows[:, rows] * (phi @ phi.T)).T)
    for other, two in zip(shared, weights, strict=True):
        common = phi[:, :, None] * of_rows[:, None, other.rows]
        part = _summed(size, modal, _flat(common) @ _flat(two).T)
        found[:, other.columns] += part
        found[other.columns] += part.T
    return found


def _summed(size: int, modal: Sequence[Modal], parts: Array) -> Array:
    """Rows of parts, one block for each entry of `modal`, added up to the columns that they belong to."""
    found, first = np.zeros((size, parts.shape[1])), 0
    for one in modal:
        found[one.columns] += parts[first : first + len(one.phi)]
        first += len(one.phi)
    return found


def _flat(parts: Array) -> Array:
    # there may be no columns at all, so that the second size has to be told
    return parts.reshape(len(parts), parts.shape[1] * parts.shape[2])

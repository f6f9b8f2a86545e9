"""Connected components of graphs that are given as dense matrices."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .._types import Mask, NDArray, RealOrComplex

Labels = NDArray[np.int32]


def components(near: Mask) -> tuple[int, Labels]:
    """Number of connected components, and for each node the one it belongs to, numbered by their first nodes.

    `near[j, k]` or `near[k, j]` joins `j` and `k`.  Graphs in which the first node meets all, or none meets another,
    are told by looking; most are of these kinds.
    """
    size = len(near)
    if size == 0 or (near[0] | near[:, 0])[1:].all():
        return min(size, 1), np.zeros(size, np.int32)
    rows, columns = np.nonzero(near)
    if np.array_equal(rows, columns):
        return size, np.arange(size, dtype=np.int32)
    edges = csr_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(size, size))
    count, label = connected_components(edges, directed=False)
    return int(count), np.asarray(label, np.int32)


def coupled_pairs(Q: RealOrComplex) -> tuple[int, Labels]:
    """`components` of the pairs `(q_l, p_l)` that entries of a symmetric `Q`, shape (2n, 2n), couple."""
    n = len(Q) // 2
    if n:
        first = (Q[0] != 0) | (Q[n] != 0)
        if (first[:n] | first[n:])[1:].all():
            return 1, np.zeros(n, np.int32)
    pattern = Q != 0
    return components(pattern[:n, :n] | pattern[:n, n:] | pattern[n:, :n] | pattern[n:, n:])

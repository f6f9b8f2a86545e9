"""The point nearest to the origin that meets linear inequalities and equations."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from .._types import Array

_EMPTY = 1e-12  # of a unit vector: a rest so small says that no point meets the constraints


def least_distance(M: Array, h: Array, equal: int) -> Array | None:
    """Multipliers of the point nearest to the origin with `A z >= h`, the first few equal; `M = A A^T`.

    The point is `A^T` times them; None if there is none.  Lawson and Hanson's way to non-negative least squares.
    """
    scale = float(np.abs(h).max(initial=0.0)) or 1.0
    both = np.concatenate([np.arange(len(h)), np.arange(equal)])
    sign = np.concatenate([np.ones(len(h)), -np.ones(equal)])
    values, vectors = np.linalg.eigh(M)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    E = np.concatenate([root[:, both] * sign, (sign * h[both])[None] / scale])
    target = np.append(np.zeros(len(root)), 1.0)
    solution, _ = nnls(E, target, maxiter=100 * len(both))
    residual = 1.0 - E[-1] @ solution
    if not residual > _EMPTY:
        return None
    multipliers = np.zeros(len(h))
    np.add.at(multipliers, both, sign * solution * (scale / residual))
    return multipliers

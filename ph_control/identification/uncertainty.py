"""Covariance of the estimates, from the curvature of the loss at its minimum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._checks import EPS
from ..modal import ModalForm
from .solver import Projection

Array = NDArray[np.float64]


def covariance_of(at: Projection, rank: NDArray[np.intp]) -> tuple[Array, float]:
    """Covariance of `(d, kappa, alpha, beta)` sorted by `rank`, NaN for what is held; and the noise variance."""
    J, free = at.full_jacobian()
    n = len(at.d)
    size = 4 * n
    known = np.zeros(size, bool)
    known[: len(free)] = free
    degrees = max(1, len(at.residual) - int(known.sum()))
    variance = at.loss / degrees
    columns = J[:, free]
    lengths = np.where((norm := np.linalg.norm(columns, axis=0)) > 0, norm, 1.0)
    covariance = np.full((size, size), np.nan)
    information = np.linalg.pinv((columns / lengths).T @ (columns / lengths), rcond=size * EPS, hermitian=True)
    covariance[np.ix_(known, known)] = variance * information / np.outer(lengths, lengths)
    sorting = np.concatenate([rank + k * n for k in range(4)])
    return covariance[np.ix_(sorting, sorting)], variance


def in_user_parameters(
    covariance: Array, modes: ModalForm, amplitudes: NDArray[np.complex128], free: NDArray[np.bool_], n: int
) -> Array:
    """Propagate a covariance of `(d, kappa, alpha, beta)` to `(d, r, q, p)`, unseen modes NaN.

    `r = kappa / d` and `q + i p = (alpha + i beta) / sqrt(d kappa)`.
    """
    d, kappa = modes.d[:n], modes.kappa[:n]
    T = np.zeros((4 * n, 4 * n))
    k = np.arange(n)
    T[k, k] = 1.0
    T[n + k, k], T[n + k, n + k] = -kappa / d**2, 1.0 / d
    safe = np.where(free, kappa, 1.0)
    root = 1.0 / np.sqrt(d * safe)
    for offset, part in ((2 * n, amplitudes.real[:n]), (3 * n, amplitudes.imag[:n])):
        T[offset + k, offset + k] = root
        T[offset + k, k] = -0.5 * part * root / d
        T[offset + k, n + k] = -0.5 * part * root / safe
    held = np.concatenate([np.zeros(n, bool), ~free, ~free, ~free])
    inner = T @ np.where(np.isnan(covariance), 0.0, covariance) @ T.T
    inner[held] = np.nan
    inner[:, held] = np.nan
    total = modes.n
    full = np.full((4 * total, 4 * total), np.nan)
    places = np.concatenate([k + part * total for part in range(4)])
    full[np.ix_(places, places)] = inner
    return full

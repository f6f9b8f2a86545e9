"""Covariance of natural frequencies, damping ratios, residues and feedthrough, in the units of the data."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._types import Array, Mask, NDArray
from ..regression.free import FreeProjection
from ..regression.free_prediction import natural_jacobian
from .fitted_structure import FittedStructure


def covariance_of(structure: FittedStructure) -> Array:
    """Covariance in the coordinates of a result from that in those of the projection, NaN for what leaves no trace."""
    fit, free, rank = structure.fit, structure.free, structure.rank
    n, projection = len(fit.p), fit.projection
    width, count = projection.shared.shape[0] if projection.shared.size else 0, len(free.scales)
    places = (2 * n + np.arange(width * count)).reshape(count, width).T
    scales = np.broadcast_to(free.scales, (width, count))
    inputs = 0 if not width else projection.inputs
    entries = fit.residues.shape[1:]

    def split(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Real and imaginary parts (n, p, m) and feedthrough (p, m) of numbers of the shared unknowns."""
        each = values.reshape(inputs, -1 if inputs else 2 * n, count)
        real, imag = (np.moveaxis(each[:, k * n : (k + 1) * n], 0, 2).reshape(n, *entries) for k in (0, 1))
        if each.shape[1] > 2 * n:
            return real, imag, each[:, 2 * n].T.reshape(entries)
        return real, imag, np.full(entries, -1 if values.dtype.kind in "iu" else 1, values.dtype)

    real, imag, through = split(places)
    order = np.concatenate([rank, n + rank, real[rank].ravel(), imag[rank].ravel(), through.ravel()]).astype(int)
    unit = [np.ones(2 * n), *(part.ravel() for part in (split(scales)[0], split(scales)[1], split(scales)[2]))]
    seen = split(projection.shown.astype(float))
    lost = np.concatenate([np.zeros(2 * n), *((part == 0).ravel() for part in (seen[0][rank], seen[1][rank], seen[2]))])
    given = fit.covariance if n else projection.covariance(fit.variance)
    J, inner = natural_jacobian(fit.p), given.copy()
    inner[: 2 * n] = J @ inner[: 2 * n]
    inner[:, : 2 * n] = inner[:, : 2 * n] @ J.T
    inner = 0.5 * (inner + inner.T)  # but for rounding
    size = np.concatenate(unit)
    twice = np.where(fit.p[rank].imag == 0, 2.0, 1.0).repeat(int(np.prod(entries)))
    size[2 * n :][: 2 * len(twice)] *= np.tile(twice, 2)  # a real pole has its residue in two halves
    if not inner.size:
        return np.full((len(order), len(order)), np.nan)
    covariance = inner[np.ix_(order, order)] * np.outer(size, size)
    # a structure may tell of residues that free ones do not show
    unknown = split(_blind(structure).astype(float))
    hidden = np.concatenate(
        [np.zeros(2 * n), *(part.ravel() for part in (unknown[0][rank], unknown[1][rank], unknown[2]))]
    )
    nothing = np.tile((fit.residues[rank] == 0).ravel(), 2)  # weights that are held at 0
    still = np.all(fit.residues[rank] == 0, axis=(1, 2)) & (np.diag(covariance)[:n] == 0)  # poles that leave no trace
    held = np.concatenate([np.tile(still, 2), nothing, np.zeros(through.size, bool)])
    absent = (order < 0) | ((lost > 0) & (np.diag(covariance) == 0)) | (hidden > 0) | held
    covariance[absent] = np.nan
    covariance[:, absent] = np.nan
    return covariance


def _blind(structure: FittedStructure) -> Mask:
    """Which numbers of the shared unknowns free residues leave without a trace, if those of the structure do too."""
    fit, free = structure.fit, structure.free
    if not fit.point.deficiency:
        return np.zeros(fit.projection.shared.shape, bool)
    if len(free.projection.p) == len(fit.p):
        return free.projection.blind
    # a pair of the free model may be two real poles under a structure
    return FreeProjection(free.projection.experiments, fit.p, free.projection.fed).blind

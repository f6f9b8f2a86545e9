"""The minimum over all data of some modes, with the variances that belong to it."""

from __future__ import annotations

import numpy as np

from ..._types import Array, ComplexArray, Mask
from ..regression.free import FreeProjection
from ..regression.tuning import TUNING
from ..search.path import FreePath
from .soundness import given_real_poles, growing

_ROUNDS = 6  # of fit and variances in turn
_SETTLED = 1e-6  # relative change of the likelihood, over the samples


def settled(
    path: FreePath, p: ComplexArray, fed: Mask | None, rtol: float | None, known: FreeProjection | None = None
) -> tuple[FreeProjection, Array]:
    """Find the minimum over all data, with the variances that belong to it, and the losses of outputs.

    To a decrease of the loss by `rtol` of itself; with None at the poles as they are.
    """
    before, alone = -np.inf, rtol is None or len(path.counts) == 1
    if rtol is None:
        projection = FreeProjection(path.scaled.data, p, fed)
    else:
        projection = path.refined(p, rtol if alone else TUNING.rough, fed, known)
    for _ in range(_ROUNDS):
        losses, sizes = path.in_data(projection.losses), path.sizes
        now = path.loglik(losses)
        path.weigh(losses)
        projection = projection.rescaled(path.scaled.data, path.sizes / sizes, fed)
        if rtol is not None and not alone:
            projection = path.refined(projection.p, rtol, fed, projection)
        if alone or now - before <= _SETTLED * max(1.0, abs(now)) / len(losses):
            break
        before = now
    return projection, losses


def needless_mode(path: FreePath, projection: FreeProjection) -> int | None:
    """Return a mode of a minimum that is none of the plant, or without which the criterion is better; None without."""
    n = len(projection.p)
    if not n:
        return None
    if growing(path, projection, lambda: projection.evidence).any():
        return int(np.argmin(projection.sigma))
    weakest = int(np.argmin(np.where(given_real_poles(path, projection.p), np.inf, projection.evidence)))
    if given_real_poles(path, projection.p)[weakest]:
        return None
    lost = 0.5 * projection.rows * float(np.log1p(projection.evidence[weakest] / projection.loss))
    with_it, without = (
        path.criteria(loglik, path.search.unknowns_of(p)).by_name(path.options.criterion)
        for loglik, p in ((0.0, projection.p), (-lost, np.delete(projection.p, weakest)))
    )
    return weakest if without <= with_it else None


def fed_through(path: FreePath, projection: FreeProjection) -> Mask:
    """Return which of all that may be fed through is more than its error shows."""
    n, width = len(projection.p), 2 * len(projection.p) + 1
    variance = projection.rows / max(1, projection.rows - path.search.unknowns_of(projection.p))
    variances = np.diag(projection.covariance(variance))[2 * n :]
    errors = np.sqrt(np.maximum(variances, 0.0))
    errors = errors.reshape(len(projection.feedthrough), projection.inputs, width)[:, :, -1]
    return np.asarray(np.abs(projection.feedthrough) > TUNING.fed_through * errors)

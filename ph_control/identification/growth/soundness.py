"""Which modes of a model are modes of the plant, and the model without the others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..._types import Array, ComplexArray, Mask
from ..regression.free import FreeProjection
from ..regression.tuning import TUNING
from ..search.fitted_modes import are_broad, count_real_poles
from ..search.free_search import FreeModel
from ..search.path import FreePath

_GROWING = 3.0  # standard errors of a decay rate beyond which a mode grows
_LARGE = 0.01  # of the power of all outputs: with less no mode is taken to grow


def is_sound(path: FreePath, model: FreeModel, lags: int = 0) -> bool:
    """Whether each mode is one of the plant: none mends the shape of another, is too broad, or grows unseen.

    So many as `lags` that have become pairs of complex poles may be broad.  Nothing is doubted of a model that
    reproduces the data to rounding.
    """
    if not len(model.p) or path.is_exact(model):
        return True
    too_broad = int(np.sum(are_broad(model.p))) > lags
    return not _patching(model.projection, path.search.crowding) and not too_broad and not grows(path, model)


def cleaned(path: FreePath, model: FreeModel, lags: int = 0) -> FreeModel:
    """Drop the modes of a model that are none of the plant."""
    while len(model.p) and not is_sound(path, model, lags):
        projection = model.projection
        # what several channels see of a pair changes as others go
        alone = len(path.counts) * max(1, projection.inputs) == 1
        worst = _patching(projection, path.search.crowding)[: None if alone else 1]
        if not worst:
            widths = np.abs(projection.sigma) / np.where(projection.d > 0, projection.d, 1.0)
            widths = np.where(are_broad(projection.p), widths, 0.0)
            worst = [int(np.argmax(widths) if widths.any() else np.argmin(projection.sigma))]
        model = path.model(np.delete(projection.p, worst))
    return model


def growing(path: FreePath, projection: FreeProjection, evidence: Callable[[], Array]) -> Mask:
    """Return which modes grow and are broad, or no large part of any motion.

    They patch records that are not stationary.
    """
    modes = (projection.p.imag > 0) & (projection.sigma < -_GROWING * _decay_errors(path, projection))
    if modes.any():
        large = _LARGE * float(np.sum(path.power * path.sizes**2))
        modes &= (projection.sigma < -TUNING.broadest * projection.d) | (evidence() < large)
    return modes


def grows(path: FreePath, model: FreeModel) -> bool:
    """Whether a model has modes as in `growing`."""
    return bool(growing(path, model.projection, lambda: evidence_of(path, model)).any())


def pruned(path: FreePath, model: FreeModel) -> FreeModel:
    """Drop modes as long as the criterion gets better, or their widths are not known."""
    while len(model.p):
        vague = vagueness(path, model)
        evidence = np.where(given_real_poles(path, model.p), np.inf, evidence_of(path, model))
        weakest = int(np.argmax(vague)) if vague.max() > 1 else int(np.argmin(evidence))
        if vague.max() <= 1 and not np.isfinite(evidence[weakest]):
            break
        fewer = path.model(np.delete(model.p, weakest))
        if vague.max() <= 1 and path.cost(fewer) >= path.cost(model):
            break
        model = path.reweighted(fewer)
    return model


def given_real_poles(path: FreePath, p: ComplexArray) -> Mask:
    """Return which poles stay in any case: the real ones of a number that was given."""
    given = path.options.real_poles != "auto"
    return (p.imag == 0) & (given and count_real_poles(p) <= int(path.options.real_poles))


def vagueness(path: FreePath, model: FreeModel) -> Array:
    """Return the errors of widths of peaks, in units of what a resonance may have: beyond, it patches a background."""
    allowed = TUNING.vague * np.maximum(np.abs(model.projection.sigma), path.search.region.bin)
    lag = (model.p.imag == 0) | (are_broad(model.p) & path.search.kinds_may_change) | path.crowded
    return np.where(lag, 0.0, _decay_errors(path, model.projection) / allowed)


def _decay_errors(path: FreePath, projection: FreeProjection) -> Array:
    """Return the standard errors of the decay rates."""
    n = len(projection.p)
    inner = projection.covariance(projection.loss / max(1, projection.rows - path.search.unknowns_of(projection.p)))
    return np.sqrt(np.maximum(np.diag(inner)[n : 2 * n], 0.0))  # rounding may make them negative


def evidence_of(path: FreePath, model: FreeModel) -> Array:
    """Return how much the loss would grow without each mode."""
    return FreeProjection(path.scaled.rows(model.p), model.p).evidence


def _patching(projection: FreeProjection, distance: float) -> list[int]:
    """Return the weaker mode of each pair that is too close, the closest first, no mode in two of them.

    Two modes that all channels see in different proportions may be as close as they like.
    """
    d, half_width = projection.d, np.abs(projection.sigma)
    apart = np.abs(d[:, None] - d) / (distance + half_width[:, None] + half_width)
    apart[~_alike(projection)] = np.inf
    lag = (projection.p.imag == 0) | are_broad(projection.p)
    apart[lag] = apart[:, lag] = np.inf
    np.fill_diagonal(apart, np.inf)
    weaker, taken = list[int](), set[int]()
    for place in np.argsort(apart, axis=None, kind="stable")[: np.count_nonzero(apart < 1)].tolist():
        pair = divmod(place, len(d))
        if not taken & set(pair):
            taken |= set(pair)
            # of a pair that mends one peak the broader is the patch
            weaker.append(max(reversed(pair), key=lambda k: half_width[k]))
    return weaker


def _alike(projection: FreeProjection) -> Mask:
    """Return which pairs of modes have the same shape in all channels, by the modal assurance criterion."""
    n = len(projection.p)
    shapes = projection.residues.reshape(n, -1)
    if not projection.inputs:
        shapes = np.concatenate([own[:n] + 1j * own[n : 2 * n] for own in projection.own], axis=1)
    if shapes.shape[1] == 1:
        return np.ones((n, n), bool)
    power = np.sum(np.abs(shapes) ** 2, axis=1)
    products = np.outer(power, power)
    return np.abs(shapes.conj() @ shapes.T) ** 2 >= TUNING.same_shape * np.where(products > 0, products, 1.0)

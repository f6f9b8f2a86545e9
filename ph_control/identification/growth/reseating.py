"""Weak modes of a model are exchanged, mended or dropped where that is likelier."""

from __future__ import annotations

import numpy as np

from ..regression.tuning import TUNING
from ..search.fitted_modes import are_broad, count_modes
from ..search.free_search import FreeModel
from ..search.path import FreePath
from .joining import candidates
from .soundness import evidence_of, given_real_poles, grows, is_sound, pruned, vagueness

_SWAPS = 6  # modes that are looked for elsewhere, at most


def improved(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel:
    """Relocate weak modes of a model and, of an order that is chosen, drop needless ones."""
    best = _relocated(path, model, automatic, most)
    return _without_slow_noise(path, _patched(path, pruned(path, best), most)) if automatic else best


def _relocated(path: FreePath, model: FreeModel, sound: bool, most: int) -> FreeModel:
    """Exchange the weakest modes for what stands out of the rest, as long as that is likelier."""
    for _ in range(_SWAPS):
        p, gains = candidates(path, model)
        if not gains.any():
            break
        more = path.model(np.append(model.p, p[0]))
        weakest = int(np.argmin(evidence_of(path, more)))
        other = path.model(np.delete(more.p, weakest))
        gain = path.loglik(other.losses) - path.loglik(model.losses)
        # a mode may come in the place of a real pole
        if gain <= TUNING.sure or count_modes(other.p) > max(most, count_modes(model.p)):
            break
        if sound and not is_sound(path, other, int(np.sum(are_broad(model.p)))):
            break
        model = path.reweighted(other)
    return model


def _patched(path: FreePath, model: FreeModel, most: int) -> FreeModel:
    """Let modes join that are close to others, or broad, where they leave white residuals and others do not."""
    more = model
    for _ in range(TUNING.patches):
        p, gains = candidates(path, more)
        if not gains.any() or count_modes(more.p) >= most or path.is_exact(more) or path.is_white(more):
            break
        more = path.reweighted(path.model(np.append(more.p, p[0])))
    if more is model or not path.is_white(more):
        return model
    more = pruned(path, _relocated(path, more, False, most))
    better = path.is_white(more) and path.cost(more) < path.cost(model)
    return more if better and not grows(path, more) else model


def _without_slow_noise(path: FreePath, model: FreeModel) -> FreeModel:
    """Drop the slow poles of a model where the criterion prefers noise of slow colour to these.

    In white noise such poles explain so much that none of them is ever the weakest, and the others are poor without
    them: these are compared in their own noise.
    """
    if path.search is not path.plain:
        return model
    slow = (np.abs(model.p) < TUNING.broad_noise * path.search.region.bin) & ~given_real_poles(path, model.p)
    if not slow.any() or path.is_exact(model) or not path.noise_filters(model):
        return model
    fewer = path.reweighted(path.model(model.p[~slow]))
    costs = [path.cost(path.in_its_noise(candidate)) for candidate in (fewer, model)]
    chosen = fewer if costs[0] < costs[1] else model
    path.whiten((), chosen.losses)
    return chosen


def likelier(path: FreePath, model: FreeModel, most: int) -> FreeModel | None:
    """Return a much likelier model that the search has come by, of so many modes at `most`, if there is one.

    Where what is left is no noise, as of plants that are not quite linear, the way of a search depends on rounding.
    """
    limit = path.cost(model) - TUNING.likelier * float(path.counts.sum())
    for cost, p in sorted(path.seen, key=lambda pair: pair[0]):
        if cost > limit:
            break
        if count_modes(p) <= most and np.all(np.abs(p.real) <= TUNING.broadest * np.abs(p)):
            other = path.model(p)
            if is_sound(path, other) and vagueness(path, other).max(initial=0.0) <= 1:
                return path.reweighted(other)
    return None

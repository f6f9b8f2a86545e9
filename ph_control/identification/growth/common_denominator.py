"""Modes that overlap so much that they are found all at once, by a common denominator."""

from __future__ import annotations

from dataclasses import replace

from ..regression.free import FreeProjection
from ..regression.frequency_rows import FURTHER_TERMS
from ..regression.tuning import TUNING
from ..search.fitted_modes import count_modes
from ..search.free_search import FreeModel, Responses
from ..search.path import FreePath
from .soundness import cleaned, pruned

_NO_NOISE = 1.0  # by which the logarithm of the variance falls where what was left is no noise, of any law


def of_common_denominator(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
    """Find modes that overlap all at once, as many as the criterion wants; None unless they explain much more.

    From there on modes may mend the shape of others, if they have to.
    """
    if path.separate or path.options.real_poles not in ("auto", 0) or not (
        isinstance(path.search, Responses) and path.search.share_poles
    ):  # fmt: skip
        return None
    plain, path.separate = path.search, True
    path.search = together = replace(path.search, crowded=True)
    path.weigh(model.losses)
    together = together.scaled(path.sizes)
    best, missed, count = model, 0, count_modes(model.p) if automatic else most - 1
    while missed < TUNING.patience and (count < most or not automatic):
        count = min(most, count * 5 // 4 + 1) if automatic else count + 1
        p = together.of_common_denominator(count)
        if path.search.unknowns_of(p) >= path.counts.sum():
            break
        missed += 1
        if automatic or count_modes(p) == most:
            more = path.judged(FreeProjection(path.scaled.data, p))
            best, missed = (more, 0) if path.cost(more) < path.cost(best) else (best, missed)
    if best is not model:
        best = path.reweighted(path.model(best.p))
        best = pruned(path, best) if automatic else best
    crowded, path.search = path.search, plain
    for term in FURTHER_TERMS:  # what may be no background, but one of further terms
        path.search = path.search.with_term(term)
    path.weigh(best.losses)
    apart = path.reweighted(cleaned(path, path.model(best.p))) if automatic else model
    if path.cost(best) < min(path.cost(apart), path.cost(model)) - _NO_NOISE * path.counts.sum():
        path.search = crowded
        path.weigh(best.losses)
        return best
    path.search = plain
    path.weigh(model.losses)
    return None

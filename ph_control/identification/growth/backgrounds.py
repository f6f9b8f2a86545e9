"""Backgrounds of responses: terms that the data ask for."""

from __future__ import annotations

import numpy as np

from ..._types import Array, Mask
from ..regression.free import FreeProjection
from ..regression.frequency_rows import FURTHER_TERMS, FreeResponse, Term
from ..regression.tuning import TUNING
from ..search.fitted_modes import are_broad
from ..search.free_search import Responses
from ..search.path import FreePath
from .choosing import chosen
from .settling import settled


def beside_further_terms(path: FreePath, most: int, automatic: bool) -> FreePath | None:
    """Search among responses on a background of further terms; None unless these explain more than real poles do."""
    if path.best is None or not isinstance(path.search, Responses) or not path.search.shows_background(0):
        return None
    if path.search.crowded:
        return None
    # of what is no background itself
    modes = path.best.p[(path.best.p.imag > 0) & ~are_broad(path.best.p)]
    if len(modes) == len(path.best.p) and path.is_white(path.best):
        return None
    search = path.search
    for term in FURTHER_TERMS:
        search = search.with_term(term)
    wider = path.elsewhere(search)
    wider.weigh(path.best.losses)
    model = wider.model(modes, TUNING.rough)
    projection, _ = on_simplest_background(wider, model.projection, model.losses, None, None)
    limit = path.cost(path.best) - 2 * TUNING.sure
    remaining_terms = wider.search.terms if isinstance(wider.search, Responses) else []
    if not set(remaining_terms) - set(path.search.terms) or wider.cost(wider.judged(projection)) > limit:
        return None
    wider.best = chosen(wider, projection.p, most, automatic)
    return wider if wider.cost(wider.best) <= limit else None


def on_simplest_background(
    path: FreePath, projection: FreeProjection, losses: Array, fed: Mask | None, rtol: float | None
) -> tuple[FreeProjection, Array]:
    """Find the minimum without the terms of the background that the criterion does not ask for."""
    while isinstance(path.search, Responses) and path.search.terms:
        variance = projection.rows / max(1, projection.rows - path.search.unknowns_of(projection.p))
        gains = _term_gains(projection, variance)
        # what a parameter costs by the criterion, in squares of standard errors
        less, more = (path.criteria(0.0, k).by_name(path.options.criterion) for k in (0, 1))
        each = more - less
        excess = {term: gain - count * each for term, (gain, count) in gains.items()}
        weakest = min(excess, key=lambda term: excess[term])
        if excess[weakest] >= 0:
            break
        path.search = path.search.without_term(weakest)
        path.weigh(losses)
        projection, losses = settled(path, projection.p, fed, rtol)
    return projection, losses


def _term_gains(projection: FreeProjection, variance: float) -> dict[Term, tuple[float, int]]:
    """Return squares of the terms of backgrounds of responses over their variances, and how many numbers each is."""
    gains: dict[Term, tuple[float, int]] = {}
    covariance = projection.covariance(variance)
    for k, rows in enumerate(projection.experiments):
        if isinstance(rows, FreeResponse) and rows.terms:
            spread = np.array([np.diag(inner) for inner, _ in projection.own_covariances(k, covariance, variance)]).T
            squares = projection.own[k] ** 2 / np.where(spread > 0, spread, np.inf)
            for term, each in zip(rows.terms, squares, strict=True):
                gain, count = gains.get(term, (0.0, 0))
                gains[term] = gain + float(each.sum()), count + len(each)
    return gains

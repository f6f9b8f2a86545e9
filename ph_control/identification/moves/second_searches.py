"""Searches that begin or proceed otherwise, whose fits are taken where they are likelier."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import f as f_law

from ..._types import Array
from ..growth.choosing import chosen
from ..growth.ending import finished
from ..growth.growing import evidence_of
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments
from ..search.fitted_modes import FreeFit, are_broad, count_real_poles
from ..search.free_search import FreeModel, Responses
from ..search.path import FreePath
from ..uncertainty.residual_tests import is_white
from .assumptions import Assumptions, Fit, Search, alone

_FEW_MODES = 5  # that few points of responses do not show beside a background


def from_peaks(fit: FreeFit, path: FreePath, search: Search) -> FreeFit:
    """Fit from the poles that responses show where all lines weigh the same, if that is likelier.

    Weighted by its gain, a response is equally large everywhere: its resonances do not stand out in a search for poles.
    """
    channels: Any = fit.channels
    if not fit.per_entry or fit.interrupted or fit.crowded or path.best is None or path.is_white(path.best):
        return fit
    if all(np.ptp(channel.weights[channel.observed]) == 0 for channel in channels):
        return fit
    alike = [replace(channel, weights=np.where(channel.observed, 1.0, channel.weights)) for channel in channels]
    p = search.along(search.path(alike), alike).projection.p
    other = search.along(search.path(channels), channels, p)
    return other if other.criteria.bic < fit.criteria.bic else fit


def in_own_noise(fit: FreeFit, filters: tuple[Array, ...], search: Search) -> FreeFit:
    """Fit modes that grow together with coloured noise of each output, if that is likelier.

    Beside constants: in white noise slow poles may have stood for them.
    """
    path = search.path(fit.channels)
    path.whiten(filters, path.power)
    again = search.along(path, fit.channels)
    return again if again.interrupted or again.criteria.bic < fit.criteria.bic else fit


def likelier_in_own_noise(forced: FreeFit, search: Search) -> FreeFit | None:
    """Fit the modes of a fit beside forces in coloured noise of each output instead; None if that is less likely."""
    path = search.path(forced.channels, forced.lateness, forced.offset, forced.intersample)
    path.whiten(forced.own_noise, path.power)
    try:
        model = path.in_its_noise(path.model(forced.projection.p))
    except KeyboardInterrupt:
        return replace(forced, interrupted=True)
    coloured = finished(path, model, forced.channels)
    return coloured if coloured.criteria.bic <= forced.criteria.bic else None


def of_few_lines(fit: FreeFit, whole: FreePath, most: int) -> FreeFit:
    """Fit few points of responses at the poles that real shapes of damping that decouples ask for, if likelier.

    Where few points show as many residues of any phase, these are too many numbers for the criterion to grant.
    """
    best: FreeModel | None = None
    cost = np.inf
    try:
        for few in _searches_of_few_lines(whole):
            model = _significant(few, chosen(few, np.zeros(0, complex), most, True))
            if few.cost(model) < min(cost, fit.criteria.by_name(few.options.criterion)):
                best, cost, path = model, few.cost(model), few
        if best is None:
            return fit
        rows = [replace(response, classical=False) for response in path.search.data]
        free = path.elsewhere(Responses(rows, False))
        judged = finished(free, free.model(best.p), fit.channels)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    return replace(judged, order_table=tuple(path.table[n] for n in sorted(path.table)))


def _searches_of_few_lines(path: FreePath) -> list[FreePath]:
    """Begin searches for modes with real shapes among responses of few points, without and with a background."""
    if not isinstance(path.search, Responses) or path.search.shows_background(_FEW_MODES):
        return []
    if any(response.quantity == "free" for response in path.search.data):
        return []
    rows = [replace(response, classical=True) for response in path.search.data]
    return [
        path.elsewhere(Responses(each, False), real_poles=0, largest=None)
        for each in (rows, [response.beside_modes_outside() for response in rows])
    ]


def _significant(path: FreePath, model: FreeModel) -> FreeModel:
    """Drop modes of a model that noise alone might show somewhere, the weakest dropped first."""
    each = path.search.unknowns(1) - path.search.unknowns(0)
    while len(model.p):
        evidence, loss = evidence_of(path, model), float(np.sum(model.losses * path.sizes**2))
        weakest, spare = int(np.argmin(evidence)), path.counts.sum() - path.search.unknowns_of(model.p)
        ratio = evidence[weakest] / loss * spare / each if loss > 0 else np.inf
        if spare > 0 and f_law.sf(ratio, each, spare) * path.counts.sum() < TUNING.by_chance:
            break
        model = path.model(np.delete(model.p, weakest))
    return model


def with_real_poles(channels: Experiments, order: int, assumptions: Assumptions, fitted: Fit) -> FreeFit:
    """Fit a number of modes, pairs of real poles among them, with further real poles if these are likelier.

    They are looked for where modes alone leave what is no noise, or have no peak, as a pair of real poles has none.
    Modes that overlap may be fewer, as a search has them all at once.
    """
    fit = fitted(channels, order, replace(assumptions, real_poles=0), None)
    if fit.interrupted or fit.rounding or fit.beside is not None:
        return fit
    if not are_broad(fit.projection.p).any() and is_white(fit.projection):
        return fit
    open_order = replace(assumptions, max_order=min(order, assumptions.max_order))
    # first under the circumstances that there are
    same = replace(open_order, delay=fit.delay, input_delay=fit.input_delay, intersample=fit.intersample, beside=alone)
    trial = fitted(channels, "auto", same, fit.projection.p)
    if trial.interrupted:
        return replace(fit, interrupted=True)
    if not count_real_poles(trial.projection.p) or trial.criteria.bic >= fit.criteria.bic:
        return fit
    wider = fitted(channels, "auto", open_order, None)
    real = count_real_poles(wider.projection.p)
    fewer = order - real // 2 - wider.order
    if wider.interrupted:
        return replace(fit, interrupted=True)
    if not real:
        return fit
    if fewer > 0 and not wider.crowded:
        wider = fitted(channels, order - real // 2, replace(assumptions, real_poles=real), wider.projection.p)
    return wider if not wider.interrupted and wider.criteria.bic < fit.criteria.bic else fit

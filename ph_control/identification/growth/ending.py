"""The end of a search: the last minimum, without modes, constants, backgrounds or feedthrough that data do not show."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache, partial

import numpy as np

from ..._types import Array, ComplexArray, Mask
from ..regression.free import FreeProjection
from ..regression.frequency_rows import FURTHER_TERMS, FreeResponse, Term
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments
from ..search.fitted_modes import FreeFit, are_broad
from ..search.free_search import FreeModel, Records, Responses
from ..search.path import EXACT, FreePath
from ..search.whitening import correlations, foretold
from .growing import chosen, given_real_poles, growing

_DECIDED = 0.01  # decrease, in variances of the noise, at which what belongs to the model beside poles can be told
_ROUNDS = 6  # of fit and variances in turn
_SETTLED = 1e-6  # relative change of the likelihood, over the samples


def end_of_search(
    path: FreePath, start: ComplexArray, most: int, automatic: bool, channels: Experiments, *, either_hold: bool,
    refined: bool = True,
) -> FreeFit:  # fmt: skip
    """Search, if no model is known, and return the last minimum, with what makes that under the other hold.

    Poles of a known model stay where they are if they are not to be `refined`.

    Residues and a feedthrough of one hold say what others say of the other.  So free models tell the two apart only
    where something is fed through: then the likelier comes first.  Of a search that is interrupted the best so far,
    if it has a mode.
    """
    fit: FreeFit | None = None
    try:
        if path.best is None:
            path.best = chosen(path, start, most, automatic)
            beside = beside_further_terms(path, most, automatic)
            if beside is not None:
                return end_of_search(beside, start, most, automatic, channels, either_hold=either_hold)
        fit = finished(path, path.best, channels, automatic, refined=refined)
        if not either_hold:
            return fit
        fit = with_other_hold(path, fit, path.best, channels, automatic, refined)
        if fit.held_otherwise is None or (fit.projection.fed is not None and not fit.projection.fed.any()):
            return fit
        rival = fit.held_otherwise()
    except KeyboardInterrupt:
        if fit is not None:
            return replace(fit, interrupted=True, held_otherwise=None)
        if path.best is None or not len(path.best.p):
            raise
        return finished(path, path.best, channels, interrupted=True)
    if fit.criteria.bic - rival.criteria.bic > 2 * TUNING.sure:
        return replace(rival, held_otherwise=cache(lambda: fit))
    return fit


def with_other_hold(
    path: FreePath, fit: FreeFit, model: FreeModel, channels: Experiments, automatic: bool, refined: bool = True
) -> FreeFit:  # fmt: skip
    """Return a finished fit with what makes that under the other hold of the inputs, if records have any."""
    if not (isinstance(path.plain, Records) and fit.states and fit.projection.inputs):
        return fit
    made = cache(partial(_held_otherwise, path, fit, model, path.plain, channels, automatic, refined))
    return replace(fit, held_otherwise=made)


def _held_otherwise(
    path: FreePath, fit: FreeFit, model: FreeModel, plain: Records, channels: Experiments, automatic: bool,
    refined: bool,
) -> FreeFit:  # fmt: skip
    """Fit with the inputs held otherwise, from the poles of a fit."""
    kept = replace(model, projection=fit.projection)
    other = plain.held("foh" if fit.intersample == "zoh" else "zoh")
    again = finished(path.elsewhere(other, kept, fit.noise), kept, channels, automatic, refined=refined)
    return replace(again, order_table=fit.order_table)


def finished(
    path: FreePath, model: FreeModel, channels: Experiments, automatic: bool = False, interrupted: bool = False,
    refined: bool = True,
) -> FreeFit:  # fmt: skip
    """Find the last minimum of a model; what is fed through only where it stands out, or has to be.

    Of an `automatic` order without modes that only the bins about them asked for.  Poles stay as they are if they are
    not to be `refined`, or after an interruption: who interrupts wants an end.
    """
    path.whiten(model.innovations, model.losses)
    # the exact minimum is that of what remains; real and broad poles that are one too many are told at the minimum
    enough = EXACT if automatic and np.any((model.p.imag == 0) | are_broad(model.p)) else _DECIDED / path.counts.sum()
    refined = refined and not interrupted
    near = float(enough) if refined else None
    projection, losses = settled(path, model.p, None, near)
    while automatic and (weakest := needless_mode(path, projection)) is not None:
        projection, losses = settled(path, np.delete(projection.p, weakest), None, near)
    near = float(_DECIDED / path.counts.sum()) if refined else None
    # noise of slow colour hides a constant that is still the level of the output, and so do steps of rounding
    hidden = model.innovations or np.any(projection.within_rounding)
    constant_open = path.options.constant_open and not (interrupted or hidden)
    projection, losses, fed = _without_what_is_needless(path, projection, losses, constant_open, near)
    projection, losses = on_simplest_background(path, projection, losses, fed, near)
    if refined:
        projection, losses = settled(path, projection.p, fed, EXACT, projection)
    projection = projection.ascending()
    unknowns = path.unknowns_of(projection.p) - (0 if fed is None else int(np.sum(~fed)))
    table = tuple(path.table[n] for n in sorted(path.table))
    criteria = path.criteria(path.loglik(losses), unknowns)
    rounding = bool(np.any(losses <= path.floors))
    measured = FreeProjection(path.plain.scaled(path.sizes).data, projection.p, fed) if model.innovations else None
    return FreeFit(
        projection, tuple(channels), 1.0 / path.sizes, table, path.region(projection.p), unknowns, criteria,
        rounding, interrupted, measured=measured, noise=model.innovations, delay=path.delay,
        input_delay=path.input_delay, crowded=path.crowded,
    )  # fmt: skip


def _without_what_is_needless(
    path: FreePath, projection: FreeProjection, losses: Array, constant_open: bool, rtol: float | None
) -> tuple[FreeProjection, Array, Mask | None]:
    """Find the minimum without constants and feedthrough that do not stand out, and what is fed through."""
    fed: Mask | None = None
    if projection.has_feedthrough and not path.felt.all():
        fed = path.felt | fed_through(path, projection)
    constants = constant_open and evidence_of_constants(projection) >= least_of_constants(projection)
    if fed is not None and not fed.all():
        projection, losses = settled(path, projection.p, fed, rtol, projection)
    if constant_open and (not constants or np.any(np.abs(projection.p) < path.scaled.region.bin)):
        slowness = 1.0 if constants else max(itertools.chain(*_slowness(projection)))
        projection, losses = _without_constants(path, projection, losses, fed, rtol, slowness)
    return projection, losses, fed


def least_of_constants(projection: FreeProjection) -> float:
    """Return the square, in variances of the noise, from which on constants of outputs stand out."""
    constants = sum(len(rows.outputs) for rows in projection.experiments)
    return float(max(2 * TUNING.likely, constants * np.log(projection.rows)))


def _without_constants(
    path: FreePath, projection: FreeProjection, losses: Array, fed: Mask | None, rtol: float | None, slowness: float
) -> tuple[FreeProjection, Array]:
    """Find the minimum without constants of the outputs, unless these explain more than noise of such a slowness.

    Beside an integrator, or what is nearly one, a constant is the same as its initial state, and of poles that are
    nearly the same no errors can be told: what it explains is seen without it.
    """
    kept = path.plain, path.search
    path.drop_constants(losses)
    level, level_losses = settled(path, projection.p, fed, rtol)
    explained = 2 * (path.loglik(losses) - path.loglik(level_losses)) / slowness
    if explained < least_of_constants(projection):
        return level, level_losses
    path.plain, path.search = kept
    path.weigh(losses)
    return projection, losses


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


def evidence_of_constants(projection: FreeProjection) -> float:
    """Return how much the loss would grow without the constants of outputs, in noise as slow as these are left with."""
    covariance, slowness = projection.covariance(1.0), _slowness(projection)
    pairs = (
        (own[-1], inner[-1, -1] * slow) for k, outputs in enumerate(projection.own) for own, (inner, _), slow in zip(
            outputs.T, projection.own_covariances(k, covariance, 1.0), slowness[k], strict=True
        )
    )  # fmt: skip
    # rows may show nothing of a constant
    return float(sum(value**2 / variance for value, variance in pairs if variance > 0))


def _slowness(projection: FreeProjection) -> list[list[float]]:
    """Return of each record and output how many times the variance of a mean is that in white noise."""
    slowness = []
    for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
        assert isinstance(rows, FreeRecord)
        each = []
        for residual in rows.residuals(predicted):
            models, variances = foretold(correlations([np.fft.rfft(residual)], [rows.length]))
            order = order_of_noise(rows.samples, variances)
            each.append(max(1.0, float(variances[order] / (1 - models[order].sum()) ** 2)))
        slowness.append(each)
    return slowness


def order_of_noise(samples: int, variances: Array) -> int:
    """Return the order of an autoregression that BIC prefers."""
    return int(np.argmin(samples * np.log(variances) + np.log(max(samples, 2)) * np.arange(len(variances))))


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

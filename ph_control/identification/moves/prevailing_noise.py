"""Noise that is far from white, whose model comes before any search, and drifts and delays beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._types import ComplexArray
from ..data.channels import Recording
from ..growth.growing import may_reach
from ..regression.free import FreeProjection, Lateness
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments
from ..search.fitted_modes import FreeFit, Orders, are_broad
from ..search.path import FreePath
from ..search.predictor_states import predicted_delay, ranked_predictors
from .assumptions import Search
from .delays import errors_leave_traces, feel_at_once, leaves_traces
from .drifts import are_slow, drift_of, may_drift, with_constants

InNoise = Callable[[FreeFit], FreeFit]

_SAMPLES = 1500  # of a record whose errors would show what is missing
_ROWS = 100  # of a covariance that only has to tell whether forces prevail
_CLOSE = 3  # models that are looked at
_DECAYS = 2.0  # time constants of the slowest mode that records last
_ROUNDING = 18.0  # logarithm of the ratio of variances for each output: what is left is rounding
_PREVAILING = 0.1  # logarithm of the ratio of variances for each output


@dataclass(frozen=True)
class Begun:
    """Fits in noise of each output, and beside forces: the same where noise is coloured; whether no search follows."""

    fit: FreeFit
    forced: FreeFit
    stands: bool


def in_prevailing_noise(channels: Experiments, search: Search, late: Lateness) -> Begun | None:
    """Fit modes in noise that is far from white: beside forces that nobody measured, or coloured noise of each output.

    White noise tells little of the poles of such records, and a search in it takes modes for what the noise does.  So
    the poles to begin with are those of a predictor.

    Returns
    -------
    Begun or None
        None where no such noise prevails, records are short, or modes in white noise may be as likely.  Fits that leave
        traces do not stand.
    """
    given = search.assumptions
    if given.white or given.delay is not None:
        return None
    if sum(channel.samples for channel in channels if isinstance(channel, Recording)) < _SAMPLES:
        return None
    path, orders = search.path(channels, late), search.orders
    foretold = _likelier_than_in_white_noise(path, channels, search, late)
    if foretold is None:
        return None
    p, bic = foretold
    fit = search.from_poles(path, channels, p, bic)
    if fit is None:
        return None
    forced = fit if fit.interrupted else given.beside(fit, orders=orders)
    if forced.interrupted:
        return Begun(fit, forced, True)
    if forced.own_likelier and search.automatic:
        path.best = None
        path.whiten(forced.own_noise, path.power)
        coloured = search.along(path, channels, p)
        stands = coloured.interrupted or bool(coloured.states and not leaves_traces(coloured.projection))
        if coloured.interrupted or forced.beside is None or coloured.gain_over(forced) > 0:
            return Begun(coloured, coloured, stands)
    if forced.beside is None:
        return None
    try:
        white = path.reweighted(path.model(forced.projection.p))
    except KeyboardInterrupt:
        return Begun(fit, replace(forced, interrupted=True), True)
    if path.bic(white) <= forced.criteria.bic:
        return None
    # a predictor takes two modes for one, beside which forces stand for what it lacks
    return Begun(fit, forced, not errors_leave_traces(forced))


def _likelier_than_in_white_noise(
    path: FreePath, channels: Experiments, search: Search, late: Lateness
) -> tuple[ComplexArray, float] | None:  # fmt: skip
    """Poles and BIC of the likeliest predictor; None where modes that join in white noise may be as likely."""
    records = [record for record in path.plain.data if isinstance(record, FreeRecord)]
    foretold = likely_poles(records, len(path.counts), search.orders)
    if foretold is None or not search.automatic:
        return foretold
    return None if may_be_white(channels, search, late, foretold[1]) else foretold


def may_be_white(channels: Experiments, search: Search, late: Lateness, bic: float) -> bool:
    """Whether modes that join in white noise lead to a BIC as small as some, or may yet; of a given number always."""
    if not search.automatic:
        return True
    path = search.in_white_noise.path(channels, late)
    return may_reach(path, path.reweighted(path.model(search.begin)), search.most, bic)


def likely_poles(records: Sequence[FreeRecord], outputs: int, orders: Orders) -> tuple[ComplexArray, float] | None:
    """Return the poles of the likeliest predictor, where it foretells far more than inputs alone do from these poles.

    Parameters
    ----------
    records : sequence of FreeRecord
        Records, as late as their outputs are.
    outputs : int
        Number of outputs.
    orders : Orders
        Numbers of poles.

    Returns
    -------
    tuple of ndarray and float or None
        Poles of imaginary part 0 or more, and the smallest BIC of all predictors.
    """
    ranked, samples = ranked_predictors(records, outputs, _ROWS)
    if not ranked or ranked[0][1] > orders.states:
        return None  # what modes that are missing leave says nothing of the noise
    ranked = [row for row in ranked if row[1] <= orders.states]
    for _, size, predictor in ranked[:_CLOSE]:
        A, errors = predictor.model(size)[0], predictor.errors
        if not np.isfinite(A).all() or errors[0] - errors[size] > _ROUNDING * outputs:
            return None
        values: ComplexArray = np.asarray(np.linalg.eigvals(A), complex)
        p: ComplexArray = np.asarray(np.log(values[orders.among(values)]) / records[0].hold.h, complex)
        if not orders.admit(p):
            continue
        # lags and slow noise are told apart by a search
        peaks = p[(p.imag > 0) & ~are_broad(p)]
        if not len(peaks) or np.max(peaks.real) * records[0].hold.h * samples > -_DECAYS:
            return None
        projection = FreeProjection(records, p)
        residuals = [
            rows.residuals(predicted) for rows, predicted in zip(records, projection.predictions(), strict=True)
        ]
        covariance = sum(each @ each.T for each in residuals) / samples
        gain = float(np.linalg.slogdet(covariance)[1] - errors[size]) / outputs
        return (p, ranked[0][0]) if gain > _PREVAILING else None
    return None


def beside_forces_and_more(forced: FreeFit, fit: FreeFit, search: Search, *, may_be_late: bool) -> FreeFit:
    """Return a fit beside forces with the delay and the drifts that make it likelier.

    Parameters
    ----------
    forced, fit : FreeFit
        Fits beside forces, and in white noise.
    search : Search
        What is left to the data.
    may_be_late : bool
        Whether outputs may come later than the response to the inputs.
    """
    best = forced
    try:
        records = [rows for rows in forced.projection.experiments if isinstance(rows, FreeRecord)]
        felt = feel_at_once(search.path(fit.channels))
        samples = predicted_delay(records, len(fit.scales), felt)[0] if may_be_late else 0
        if samples:
            delay = np.full(len(fit.scales), samples * fit.channels[0].dt)
            late = _in_other_rows(fit, best.projection.p, replace(fit.lateness, outputs=delay), fit.offset, search)
            gain = late.gain_over(best)
            best = replace(late, delay_gain=0.5 * gain) if gain > 2 * TUNING.sure else best
        if search.assumptions.drifting and may_drift(best):
            best = _beside_drift(best, fit, search)
    except KeyboardInterrupt:
        return replace(best, interrupted=True)
    return with_constants(best) if search.assumptions.drifting else best


def _beside_drift(forced: FreeFit, fit: FreeFit, search: Search) -> FreeFit:
    """Return a fit beside forces, or that of its poles that are not slow, with a drift or a constant, if likelier.

    Noise that takes the place of slow poles may wander as far as outputs drift.
    """
    drifting = _in_other_rows(fit, forced.projection.p[~are_slow(forced)], forced.lateness, 2, search)
    if drifting.gain_over(forced) <= 2 * TUNING.sure:
        return forced
    level = _in_other_rows(fit, drifting.projection.p, forced.lateness, fit.offset, search, drifting)
    best = level if level.gain_over(forced) > 0 else forced
    gain = drifting.gain_over(best)
    if gain > 2 * TUNING.sure:
        best = replace(drifting, findings=(*drifting.findings, drift_of(drifting, 0.5 * gain)))
    return replace(best, delay_gain=forced.delay_gain, own_noise=best.own_noise or forced.own_noise)


def _in_other_rows(
    fit: FreeFit, p: ComplexArray, late: Lateness, offset: int, search: Search, like: FreeFit | None = None
) -> FreeFit:  # fmt: skip
    """Return a fit of some poles with another delay or drift, beside forces if they remain, `like` those of another."""
    is_open = search.assumptions.delay is None
    again = search.anew(fit)(late, offset, p).with_delay_open(is_open)
    again = search.assumptions.beside(again, orders=Orders(), like=like)
    if again.interrupted:
        raise KeyboardInterrupt
    return again

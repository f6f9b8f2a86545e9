"""Inputs that act later, each by a dead time of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices
from ..regression.free import FreeProjection, Lateness
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments, is_short
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from ..search.predictor_states import ranked_predictors
from .assumptions import Anew, Search, rows_as_in
from .dead_times import DeadTimeScan, numbers_of
from .delays import LONGEST_DELAY, are_heavy, bic_within, leaves_traces

_MOSTLY = 0.5  # of the squares of outputs: lags that leave more of them say little of dead times
_SCANS = 3  # searches with the delays that the last one says
_ROWS = 100  # of the covariance of a predictor
_LAGS = 4  # of different rates, with which delays are looked for


def of_late_inputs(channels: Experiments, search: Search) -> FreeFit | None:
    """Fit inputs that act later, each by a time of its own, where a few lags already tell; None elsewhere.

    These have to explain most of the outputs, and of what past outputs and inputs foretell.  The fit has to be likelier
    than what a search without dead times finds that begins with its poles and its noise, with one more mode at most:
    more of them would come to stand for dead times one by one.
    """
    path = search.path(channels)
    rows = [record for record in path.plain.data if isinstance(record, FreeRecord)]
    proposed = _proposed_dead_times(rows, path.felt.shape[1], np.zeros(0, complex))
    if proposed is None:
        return None
    late_path = search.path(channels, _lateness_of(proposed.times, path.felt.shape[0]))
    late_rows = late_path.plain.data
    still, lagging = (FreeProjection(late_rows, p).losses for p in (np.zeros(0, complex), proposed.lags))
    if np.mean(lagging / np.maximum(still, np.finfo(float).tiny)) > _MOSTLY:
        return None
    late_path.whiten(proposed.noise, late_path.power)
    if _is_foretold_better(rows, FreeProjection(late_path.search.data, proposed.lags)):
        return None
    late = search.along(late_path, channels, np.append(search.begin, proposed.lags))
    try:
        late = late if late.interrupted else _in_best_dead_times(late, search)
    except KeyboardInterrupt:
        return replace(late, interrupted=True)
    if late.interrupted:
        return late
    path.whiten(late.noise, path.power)
    rival = replace(search, most=min(search.most, late.order + search.automatic))
    return _likelier_late(late, rival.along(path, channels, late.projection.p))


def _is_foretold_better(rows: Sequence[FreeRecord], lagging: FreeProjection) -> bool:
    """Whether a predictor from past outputs and inputs leaves less than half of the squares that late lags leave."""
    outputs = len(lagging.losses)
    ranked, _ = ranked_predictors(rows, outputs, _ROWS)
    if not ranked:
        return False
    _, states, best = ranked[0]
    counts = np.zeros(outputs)
    for record in lagging.experiments:
        counts[record.outputs] += record.samples
    errors = float(np.mean(np.log(np.maximum(lagging.losses, np.finfo(float).tiny) / counts)))
    return bool(float(best.errors[states]) / outputs < errors + np.log(_MOSTLY))


def with_dead_times(fit: FreeFit, anew: Anew, search: Search) -> FreeFit | None:
    """Let inputs of a fit act later, each by a time of its own, where that explains more; None elsewhere.

    Nothing is looked for where what is left shows nothing of the inputs, and no pole could stand for a dead time.
    """
    p = fit.projection.p
    mimics = are_heavy(p)
    if fit.rounding or not (fit.noise or mimics.any() or leaves_traces(fit.projection)):
        return None
    proposed = _proposed_dead_times(_of_fit(fit), len(fit.input_delay), p[~mimics]) if not mimics.all() else None
    if proposed is None:  # lags alone were looked at before
        return None
    late = anew(_lateness_of(proposed.times, len(fit.delay)), fit.offset, None)
    return _likelier_late(_in_best_dead_times(late, search), fit)


def _likelier_late(late: FreeFit, on_time: FreeFit) -> FreeFit | None:
    """Return a fit with dead times and findings that say so, where it is likelier than one without; None elsewhere."""
    if on_time.interrupted:
        return replace(late, interrupted=True)
    gain = 0.5 * (_criterion(on_time) - _criterion(late))
    if gain <= TUNING.sure:
        return None
    times = zip(late.channels[0].input_labels, late.input_delay.tolist(), strict=True)
    findings = (Finding(Cause.INPUT_DELAY, (time,), gain, label) for label, time in times if time)
    return replace(late, findings=(*on_time.findings, *findings), delay_gain=gain)


def _in_best_dead_times(fit: FreeFit, search: Search) -> FreeFit:
    """Fit with the dead times that are the likeliest for the slowest poles and the noise, and poles for these.

    Fast poles may stand for a part of a dead time.
    """
    for _ in range(_SCANS):
        before, slowest = _dead_samples(fit), fit.projection.p[np.argsort(np.abs(fit.projection.p))]
        trials = []
        for count in range(len(slowest), 0, -1):
            scan = _scan(_of_fit(fit), slowest[:count], len(before))
            dead = scan.refined(before, fit.noise)
            trials.append((scan.cost(dead), dead.samples, scan.p))
        if not trials:
            break
        _, samples, p = min(trials, key=lambda trial: trial[0])
        if np.array_equal(samples, before) and len(p) == len(slowest):
            break
        lateness = _lateness_of(fit.channels[0].dt * samples, len(fit.delay))
        again = search.anew(fit)(lateness, fit.offset, p)
        if _criterion(again) >= _criterion(fit):
            break
        fit = again
    return fit


@dataclass(frozen=True)
class _Proposal:
    """Times (m,) by which inputs act later, with the lags beside which they are likely, and the noise of these."""

    times: Array
    lags: ComplexArray
    noise: tuple[Array, ...]


def _proposed_dead_times(rows: Sequence[FreeRecord], inputs: int, p: ComplexArray) -> _Proposal | None:
    """Return times by which inputs act later, that some modes and a few lags are likelier with by far than any without.

    A lag of second order looks like one of first order and a dead time: more lags without dead times have to be less
    likely as well.  None where there are no such times.
    """
    steps = [record.hold.h for record in rows]
    if inputs < 2 or np.ptp(steps) > EPS * max(steps) or is_short(rows[0]):
        return None
    start = np.zeros(inputs, int)
    slowest = 6.0 / min(record.length for record in rows)
    single = np.geomspace(3 * slowest, 0.5, _LAGS)[:, None]
    several = [*(single[:-1] * [1.0, 3.0]), *(np.geomspace(slowest, 0.5, count) for count in (3, 4, 6))]
    trials, least = [], np.inf
    for rates in (single, several):
        for lags in (-np.array(row, complex) / steps[0] for row in rates):
            scan = _scan(rows, np.append(p, lags), inputs)
            without, late = scan.likeliest(start)
            least = min(least, scan.cost(without))
            trials.append((scan.cost(late), late, lags))
        cost, late, lags = min(trials, key=lambda trial: trial[0])
        if cost > least - TUNING.likely:
            return None
    return _Proposal(np.asarray(steps[0] * late.samples), lags.astype(complex), late.noise)


def _lateness_of(times: Array, outputs: int) -> Lateness:
    """Return delays that have these dead times of the inputs: what all inputs share is one of the outputs."""
    common = 0.0 if np.ptp(times) else float(times[0])
    return Lateness(np.full(outputs, common), times - common)


def _dead_samples(fit: FreeFit) -> Indices:
    """Return samples by which each input acts later, with what all outputs are late by."""
    return np.asarray(np.rint((fit.input_delay + fit.delay.min()) / fit.channels[0].dt), int)


def _of_fit(fit: FreeFit) -> list[FreeRecord]:
    """Return the records of a fit without delays."""
    moving = any(rows.moving for rows in fit.projection.experiments)
    return rows_as_in(fit, fit.channels, moving)


def _scan(rows: Sequence[FreeRecord], p: ComplexArray, inputs: int) -> DeadTimeScan:
    """Return the scan of dead times of inputs for some poles."""
    count = sum(record.samples * len(record.outputs) for record in rows)
    return DeadTimeScan(rows, p, _longest_dead_time(rows), 0.5 * float(np.log(count)), inputs)


def _longest_dead_time(rows: Sequence[FreeRecord]) -> int:
    """Return the samples of the longest dead time that is looked for."""
    return min(LONGEST_DELAY, min(record.length for record in rows) // 10)


def _criterion(fit: FreeFit) -> float:
    """Return the BIC over the samples that the longest dead times leave to all fits, these among the parameters."""
    most = _longest_dead_time(_of_fit(fit)) * fit.channels[0].dt - float(fit.input_delay.max(initial=0.0))
    return bic_within(fit, 0.0, most, numbers_of(_dead_samples(fit)))

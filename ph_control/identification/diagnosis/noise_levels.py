"""Noise of several levels: that changes within a recording, is unequal in experiments, or has samples that stand out.

Of noise that changes: from where to where, and how large it is in each span.  Of experiments of different quality: how
large the noise of each is beside that of the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import norm, t

from ..._types import Array, Indices, Mask, RealOrComplex
from ..data.channels import Recording, ResponseMatrix
from ..data.time_record import LONG, Signal, blocks, is_long
from ..regression.free import FreeProjection
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments, experiments_of
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from ..search.whitening import foretold

# noise that changes within a recording
_PIECE = 16  # samples that are looked at together
_PIECES = 600  # of a recording, at most
_SHORTEST = 2  # pieces of a span
_CHANGE = 3.0  # times the logarithm of the samples: what a change costs, in squares of standard errors
_WORTH = 1.4  # ratio of levels below which nothing is gained by telling them apart
_PAST = 30  # samples of it that noise may depend on
_EACH = 20  # samples for each of them, at least
_CLIPPED = 4.0  # times the level of a span: what is farther out does not count more
_FAR_OUT = 8.0  # where a border is looked for: a loud sample beyond it would be taken for an outlier
_DISTINCT = 1e-9  # of the range of an output: values that are nearer are the same digit
_MEDIAN = 0.6745  # of the absolute value of a normal variable
_LOG_VARIANCE = np.pi**2 / 2  # of the logarithm of its square

Spans = list[tuple[int, int]]

# experiments of different quality
_ROUNDS = 20  # of the noise of outputs and of experiments in turn
_SETTLED = 1e-3  # relative change
_EQUAL = 0.02  # relative difference of units beyond which a fit is repeated

# samples that stand out, and those at an end of a range
_BY_CHANCE = 1e-4  # probability that noise alone shows one anywhere
_FEWEST = 20  # residuals to spare below which nothing is said
_SHARE = 0.03  # of the samples: with more of them the noise has another distribution, or another level in places
_REPEATED = 5  # samples with the largest value of all, below which nothing is said of the range
_OFTEN = 2.0  # times as many of them as of the values next to it
_NEAR = 0.01, 0.1  # of the range: what is next to its end, and how far to look for that
_RESTS = 20, 4.0  # samples of one value, and times as many as elsewhere, of an output that moves no more
_EFFICIENCY = 0.37  # of the median of absolute values beside the mean of squares


def records_of(projection: FreeProjection, channels: Experiments) -> Iterator[tuple[int, FreeRecord, Array]]:
    """Which experiment each of the rows of recordings is from, the rows, and what is predicted of their outputs."""
    places = experiments_of(projection.experiments, channels).tolist()
    for place, record, predicted in zip(places, projection.experiments, projection.predictions(), strict=True):
        assert isinstance(record, FreeRecord)
        yield place, record, predicted


def changing_levels(fit: FreeFit) -> tuple[Array | None, ...] | None:
    """Level of the noise of each recording (p, T), None where it is the same; None where that is so in all.

    What is nothing but rounding has no noise.
    """
    channels = fit.channels
    unfit = fit.interrupted or fit.rounding or fit.per_entry or is_long(channels)
    if unfit or not all(isinstance(channel, Recording) for channel in channels):
        return None
    noise: list[Array] = [np.full(channel.y.shape, np.nan) for channel in channels]
    for place, record, predicted in records_of(fit.projection, channels):
        channel, level = channels[place], 1.0 if record.level is None else record.level
        first = channel.samples - record.length if record.whole_record is None else record.whole_record.first
        residuals = level * np.stack([_innovations(each) for each in record.residuals(predicted)])
        sizes = fit.scales[record.outputs, None] * record.unit
        part = slice(first, first + record.length)
        noise[place][record.outputs, part] = np.where(record.observed, residuals * sizes, np.nan)
    return levels_of_noise(channels, noise, fit.unknowns)


def levels_of_noise(
    channels: Sequence[Recording], noise: Sequence[Array], unknowns: int
) -> tuple[Array | None, ...] | None:
    """Level of white noise (p, T) of each recording, None where it is the same; None where that is so in all.

    The logarithms of squared innovations have the same variance whatever the level, and hardly feel outliers: spans are
    those of their means that are most likely, with a price for each change.  Outputs change together where that is
    likelier.  Nothing is said of outputs that are saturated, and beside outliers: errors of these are no noise.
    """
    if any(saturation(row)[0] for channel in channels for row in channel.original.y):
        return None
    levels = tuple(_levels(channel, each) for channel, each in zip(channels, noise, strict=True))
    if all(level is None for level in levels):
        return None
    seen = [row for each, level in zip(noise, levels, strict=True) for row in (each if level is None else each / level)]
    seen = [row for row in seen if np.isfinite(row).any()]
    # what a few of them have done to a fit is no noise either
    return None if any(outliers(seen, sum(map(len, seen)) - unknowns)) else levels


def _levels(channel: Recording, noise: Array) -> Array | None:
    """Level of the noise (p, T) of each output of a recording, with a geometric mean of 1; None where none changes.

    An output that rests on one of its digits has the noise of its digits there.
    """
    outputs = np.flatnonzero(np.isfinite(noise).any(axis=1))
    digits = np.array([_of_digits(channel.original.y[output]) for output in outputs])
    every = np.hypot(noise[outputs], digits[:, None])
    if not len(every) or np.isfinite(every).sum(axis=1).min() < 4 * _SHORTEST * _PIECE:
        return None
    apart = [_level(each, _spans(each[None])) for each in every]
    together = _spans(every)
    alike = [_level(each, together) for each in every]
    cost = sum(_cost(each, level) for each, level in zip(every, apart, strict=True))
    # levels that change together count once
    shared = np.exp(np.mean(np.log(alike), axis=0))
    cost_shared = sum(_cost(each, shared) for each in every)
    cost_shared -= (len(every) - 1) * _price(shared)
    chosen = [shared] * len(every) if cost_shared <= cost else apart
    if all(level.max() < _WORTH * level.min() for level in chosen):
        return None
    levels = np.ones(noise.shape)
    for output, each, level in zip(outputs, every, chosen, strict=True):
        if level.max() >= _WORTH * level.min():
            levels[output] = level / np.exp(np.mean(np.log(level[each == each])))
    return levels


def _of_digits(y: Array) -> float:
    """Standard deviation of the rounding of an output to its digits, by the least difference of two of its values."""
    steps = np.diff(np.unique(y[np.isfinite(y)]))
    distinct = steps[steps > _DISTINCT * steps.sum()]
    return float(distinct.min()) / np.sqrt(12) if len(distinct) else 0.0


def _innovations(residual: Array) -> Array:
    """What the past of a residual does not foretell, by the autoregression that BIC prefers.

    As of so many samples as its largest values are.
    """
    count = 3 * np.sum(residual**2) ** 2 / max(float(np.sum(residual**4)), np.finfo(float).tiny)
    most = max(0, min(_PAST, int(count) // _EACH))
    products = np.fft.irfft(np.abs(np.fft.rfft(residual, 2 * len(residual))) ** 2)[: most + 1]
    models, variances = foretold(products)
    order = int(np.argmin(count * np.log(variances) + np.log(max(count, 2.0)) * np.arange(len(variances))))
    past = np.concatenate([[1.0], -models[order]])
    return np.convolve(residual, past)[: len(residual)]


def _spans(noise: Array) -> Spans:
    """Spans of the samples of outputs (q, T) in which their noise has one level each."""
    known = np.flatnonzero(np.any(noise == noise, axis=0))
    borders = [known[first] for first, _ in _spans_of_known(noise[:, known])[1:]]
    return list(pairwise([0, *map(int, borders), noise.shape[1]]))


def _spans_of_known(noise: Array) -> Spans:
    """Spans of samples of which each was observed in one of the outputs (q, T), by dynamic programming."""
    samples = noise.shape[1]
    with np.errstate(divide="ignore"):
        logs = np.log(noise**2)
    # zeros are those of digits
    logs = np.fmax(logs, np.nanmedian(logs, axis=1, keepdims=True) - 20.0)
    logs -= np.nanmean(logs, axis=1, keepdims=True)
    seen = np.sum(logs == logs, axis=0).astype(float)
    sums = np.nansum(logs, axis=0)
    edges = np.unique(np.linspace(0, samples, 1 + max(1, min(_PIECES, samples // _PIECE))).astype(int))
    weight, total = (np.concatenate([[0.0], np.cumsum(np.add.reduceat(x, edges[:-1]))]) for x in (seen, sums))
    # outputs of which one knows the noise of others are worth fewer
    means = sums / np.maximum(seen, 1.0)
    spread = float(np.mean(np.diff(means[seen > 0]) ** 2)) / 2 * float(np.mean(seen[seen > 0]))
    variance, price = max(_LOG_VARIANCE, spread), _CHANGE * float(np.log(samples))
    count = len(edges) - 1
    least, start = np.full(count + 1, np.inf), np.zeros(count + 1, int)
    least[0] = 0.0
    for end in range(_SHORTEST, count + 1):
        first = np.arange(end - _SHORTEST + 1)
        inner = (total[end] - total[first]) ** 2 / np.maximum(weight[end] - weight[first], 1e-9) / variance
        costs = least[first] - inner + price * (first > 0)
        start[end] = int(np.argmin(costs))
        least[end] = costs[start[end]]
    spans, end = Spans(), count
    while end > 0:
        spans.append((int(edges[start[end]]), int(edges[end])))
        end = int(start[end])
    return _to_samples(noise, spans[::-1], int(np.max(np.diff(edges))))


def _to_samples(noise: Array, spans: Spans, reach: int) -> Spans:
    """Spans whose borders are where the noise of outputs (q, T) is likeliest to change."""
    for k in range(len(spans) - 1):
        (first, border), (_, last) = spans[k], spans[k + 1]
        sizes = [_rms(noise[:, a:b]) for a, b in ((first, border), (border, last))]
        low, high = max(first + reach, border - reach), min(last - reach, border + reach)
        if high <= low:
            continue
        before, after = (
            np.nansum(0.5 * np.minimum(np.abs(noise[:, low:high]) / size, _FAR_OUT) ** 2 + np.log(size), axis=0)
            for size in sizes
        )
        steps = np.concatenate([[0.0], np.cumsum(before - after)])
        moved = low + int(np.argmin(steps))
        spans[k], spans[k + 1] = (first, moved), (moved, last)
    return spans


def _rms(noise: Array) -> Array:
    """Level of the noise of outputs (q, T), (q, 1), of which values far out count no more than others.

    Of nothing but missing samples it is 1, and that of rounding where they are 0.
    """
    levels = np.ones((len(noise), 1))
    for row, every in zip(levels, noise, strict=True):
        values = np.abs(every[every == every])
        if len(values):
            rough = max(float(np.median(values)) / _MEDIAN, np.finfo(float).tiny)
            row[0] = rough * np.sqrt(np.mean(np.minimum(values / rough, _CLIPPED) ** 2))
    return np.maximum(levels, np.finfo(float).tiny)


def _level(noise: Array, spans: Spans) -> Array:
    """Level of the noise (T,) of an output at all samples, that of each span, with a geometric mean of 1."""
    level = np.ones(len(noise))
    for first, last in spans:
        level[first:last] = float(_rms(noise[None, first:last])[0, 0])
    return np.asarray(level / np.exp(np.mean(np.log(level[noise == noise]))))


def _cost(noise: Array, level: Array) -> float:
    """Twice the negative log-likelihood of noise of this level, and the price of its changes."""
    seen = noise == noise
    each = (noise / level)[seen]
    size = float(_rms(each[None])[0, 0])
    return float(np.sum(np.minimum(np.abs(each) / size, _CLIPPED) ** 2) + 2 * len(each) * np.log(size)) + _price(level)


def _price(level: Array) -> float:
    """What the changes of a level cost."""
    return _CHANGE * float(np.log(len(level))) * np.count_nonzero(np.diff(level))


# --- as findings -----------------------------------------------------------------------------------------------------


def findings_of(channels: Experiments, gain: float) -> list[Finding]:
    """One of each recording and output whose noise changes: first sample and level of each span, one after the other.

    Of outputs that change together one for all.
    """
    findings = []
    for e, channel in enumerate(channels):
        if not isinstance(channel, Recording) or channel.level is None:
            continue
        together = len(channel.level) > 1 and np.ptp(channel.level, axis=0).max() == 0
        labels = ("",) if together else channel.output_labels
        for label, level in zip(labels, channel.level, strict=False):
            starts = _starts(level)
            if len(starts) > 1:
                values = np.stack([starts.astype(float), level[starts]], axis=1).ravel()
                findings.append(Finding(Cause.CHANGING_NOISE, tuple(values.tolist()), gain, label, e))
    return findings


def _starts(level: Array) -> Indices:
    return np.concatenate([[0], np.flatnonzero(np.diff(level)) + 1])


def levels_of(findings: Sequence[Finding], channels: Sequence[Any]) -> list[Array | None]:
    """Level of the noise of each recording (p, T) that findings tell; None where it does not change."""
    levels: list[Array | None] = []
    for e, channel in enumerate(channels):
        level = np.ones((len(getattr(channel, "output_labels", ())), channel.samples))
        changes = [f for f in findings if f.cause is Cause.CHANGING_NOISE and f.experiment == e]
        for finding in changes:
            starts, sizes = np.reshape(finding.values, (-1, 2)).T
            each = sizes[np.searchsorted(starts, np.arange(channel.samples), side="right") - 1]
            which = channel.output_labels.index(finding.output) if finding.output else slice(None)
            level[which] = each
        levels.append(level if changes else None)
    return levels


def rounded_outputs(findings: Sequence[Finding], channels: Sequence[Recording]) -> list[Mask]:
    """Which outputs of each recording were rounded to steps larger than their noise, as findings tell."""
    rounded = {(finding.experiment, finding.output) for finding in findings if finding.cause is Cause.ROUNDED}
    return [np.array([(e, name) in rounded for name in data.output_labels]) for e, data in enumerate(channels)]


def level_of(channel: Recording | ResponseMatrix) -> Array | None:
    """Level of the noise of a recording (p, T), None where it does not change."""
    level: Array | None = getattr(channel, "level", None)
    return level


def noise_units(fit: FreeFit) -> tuple[Array, float]:
    """Standard deviation of the noise of each experiment, and the log-likelihood beside the same noise in all.

    The residuals of output o in experiment e have the variance `(unit_e sigma_o)^2`, both by maximum likelihood.  The
    geometric mean of the units, over all samples, is 1.  The gain is less what the criterion charges for them.
    """
    channels = fit.channels
    units = np.ones(len(channels))
    if len(channels) == 1 or not isinstance(channels[0], Recording) or fit.rounding or fit.interrupted:
        return units, 0.0
    squares, counts = _squares(fit)
    seen, total = counts.sum(axis=1), counts.sum()
    if np.any(seen == 0) or np.any(squares.sum(axis=1) == 0):
        return units, 0.0

    def variances() -> Array:
        return np.sum(squares / units[:, None] ** 2, axis=0) / np.maximum(counts.sum(axis=0), 1)

    def loglik() -> float:
        known = counts.sum(axis=0) > 0
        return -0.5 * float(counts.sum(axis=0)[known] @ np.log(variances()[known])) - float(seen @ np.log(units))

    alike = loglik()
    for _ in range(_ROUNDS):
        before = units
        units = np.sqrt(np.sum(squares / np.maximum(variances(), np.finfo(float).tiny), axis=1) / seen)
        units = units / np.exp(seen @ np.log(units) / total)
        if np.max(np.abs(units / before - 1)) < _SETTLED:
            break
    return units, loglik() - alike - 0.5 * (len(units) - 1) * float(np.log(total))


def _squares(fit: FreeFit) -> tuple[Array, Array]:
    """Squares of what a fit leaves of each experiment and output, in units of the data, and of how many samples.

    Beside forces that is what the past does not foretell.
    """
    channels, size = fit.channels, (len(fit.channels), len(fit.scales))
    squares, counts = np.zeros(size), np.zeros(size)
    if fit.beside is not None:
        for place, errors in enumerate(fit.beside.errors):
            squares[place] = channels[place].unit ** 2 * np.sum(errors**2, axis=1)
            counts[place] = errors.shape[1]
        return squares, counts
    for place, record, predicted in records_of(fit.projection, channels):
        residuals = record.residuals(predicted)
        squares[place, record.outputs] += channels[place].unit ** 2 * np.sum(residuals**2, axis=1)
        counts[place, record.outputs] += record.samples
    return squares, counts


def in_equal_noise(channels: Sequence[Any], fit: FreeFit) -> tuple[Recording, ...] | None:
    """Recordings in units in which their noise is the same, if that is likelier; None where it is as they are."""
    if is_long(channels):
        return None
    units, gain = noise_units(fit)
    if gain <= TUNING.sure or all(
        abs(u / channel.unit - 1) < _EQUAL for u, channel in zip(units, channels, strict=True)
    ):
        return None
    return tuple(channel.adjusted(unit) for channel, unit in zip(channels, units.tolist(), strict=True))


def outliers(residuals: Sequence[Signal], spare: int) -> tuple[tuple[int, ...], ...]:
    """Samples of each of several experiments that noise with the scale of the others would hardly show anywhere.

    Residuals are in units of the noise: real, or complex with real and imaginary parts of equal variance; NaN where
    missing.  `spare` is the number of degrees of freedom: residuals, real and imaginary parts, less fitted parameters.
    The scale of each experiment is estimated from the median of absolute residuals, of long records of a part, which
    outliers do not move; the bound is Bonferroni's for so many t-distributed variables.
    """
    count = sum(
        int(np.count_nonzero(~np.isnan(_parts(residual[part]))))
        for residual in residuals
        for part in blocks(len(residual))
    )
    if spare < _FEWEST:
        return ((),) * len(residuals)
    bound = float(t.isf(0.5 * _BY_CHANCE / count, _EFFICIENCY * spare / len(residuals)))
    outlying = []
    for residual in residuals:
        few = np.abs(_parts(residual[:: 1 + len(residual) // LONG]))
        scale = float(np.nanmedian(few)) / float(norm.isf(0.25)) * np.sqrt(count / spare) if len(few) else 0.0
        far: list[int] = []
        for part in blocks(len(residual)) if scale else ():
            size = np.abs(_parts(residual[part]))
            far += (part.start + np.flatnonzero(np.any(size > bound * scale, axis=1))).tolist()
        outlying.append(tuple(far) if len(far) <= max(1, _SHARE * len(residual)) else ())
    return tuple(outlying)


def saturation(y: Signal) -> tuple[int, tuple[float, ...]]:
    """How many samples of an output stay at an end of its range, and at which ends.

    A sensor that is driven beyond its range repeats one value, more often than those next to it.  Of values of few
    digits the next one is found as often, and nothing is said.
    """
    ends = np.array(
        [[np.nanmin(y[part]), np.nanmax(y[part])] for part in blocks(len(y)) if not np.isnan(y[part]).all()]
    )
    if not len(ends):
        return 0, ()
    low, high = ends[:, 0].min(), ends[:, 1].max()
    stuck = 0
    limits: tuple[float, ...] = ()
    for end in (low, high):
        below = (np.abs(end - y[part]) for part in blocks(len(y)))
        near = np.concatenate([distance[distance <= _NEAR[1] * (high - low)] for distance in below])
        others = near[near > 0]
        count = len(near) - len(others)
        around = max(_NEAR[0] * (high - low), others.min(initial=np.inf))
        held = count >= _REPEATED and len(others) and count > _OFTEN * np.count_nonzero(others <= around)
        if held:
            stuck, limits = stuck + count, (*limits, float(end))
    return stuck, limits


def stuck(y: Array) -> tuple[int, int] | None:
    """First sample, and how many, of the longest part in which an output stays at one value; None where it moves.

    Of values of few digits several parts are about as long, and nothing is said.
    """
    borders = np.flatnonzero(np.append(True, y[1:] != y[:-1]))
    lengths = np.diff(np.append(borders, len(y)))
    longest = int(np.argmax(lengths))
    fewest, ratio = _RESTS
    if lengths[longest] < max(fewest, ratio * np.delete(lengths, longest).max(initial=0)):
        return None
    return int(borders[longest]), int(lengths[longest])


def _parts(residuals: RealOrComplex) -> Array:
    if np.iscomplexobj(residuals):
        return np.stack([residuals.real, residuals.imag], axis=1)
    return np.asarray(residuals, float)[:, None]

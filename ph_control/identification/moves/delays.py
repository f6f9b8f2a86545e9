"""Outputs that come some samples after the inputs.

Lags come late by the delay at which one or two of them explain the outputs best.  For lags of given rates the
regressions at all delays are correlations of their responses to the input with the outputs, by the fast Fourier
transform.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import toeplitz
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.stats import chi2

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, Mask
from ..data.channels import Recording, ResponseMatrix
from ..data.time_record import cut
from ..regression.elimination import orthogonal, without
from ..regression.free import ROUNDED, FreeProjection, Lateness
from ..regression.modal_regressors import SampledModes
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments, experiments_of
from ..search.fitted_modes import FreeFit
from ..search.free_search import Records
from ..search.path import FreePath
from ..search.predictor_states import likelier_apart, predicted_delays
from ..uncertainty.residual_tests import ljung_box
from .assumptions import Search, rows_as_in

_MIMICS = 0.2  # damping ratio from which on modes may stand for a delay
_BEGINNING = 100_000  # samples of each record in which predictors show delays
_DELAYS_FROM = 20_000  # samples of each recording that delays are looked for in
_SCANS = 3  # searches with the delays that the last one says
LONGEST_DELAY = 24  # samples, up to which each is tried
_PER_DECADE = 24  # delays beyond, each a tenth longer than the one before
_FEW = 2  # modes beside which lags that come late are looked for first
_ROUNDS = 4  # of a delay and the poles beside it, each as the other shows it
_NEAR = 3  # samples, by which a delay may be another for the poles that were found with it
_LAGS = 6  # of different rates, with which delays are looked for
_TOGETHER = 64  # outputs of a record, about: products of more of them with one another cost more than they spare
_SHOWN = 1e-2  # of what an input tells at most: at combinations of lags where it has less it tells nothing

# lags that come late
_SAMPLES = 20_000  # of each record that are looked at
_RATES = 16  # of late lags, from the slowest to the fastest
_EACH = 3  # of these is looked at first
_PAIRS = 4  # of lags without a delay
_SHARE = 10  # of the shortest record: no delay is longer
_MOSTLY = 0.2  # of the squares of outputs that a late lag leaves at most
_ROUGHLY = 0.35  # of those that the best of a few rates leaves
_CLEARLY = 0.8  # of the squares that lags without a delay leave: a late one leaves less


def of_late_lag(channels: Experiments, search: Search) -> FreeFit | None:
    """Fit outputs that come later than the response to the only input, where a lag already tells; None elsewhere.

    It has to explain most of the outputs, and far more than several lags without a delay.  The fit stands if all its
    poles are lags or heavily damped modes, and it leaves white residuals: others are compared after a search.
    """
    given = search.assumptions
    single = isinstance(channels[0], Recording) and len(channels[0].input_labels) == 1
    if not single or given.delay is not None or given.input_delay is not None:
        return None
    path = search.path(channels)
    rows = [record for record in path.plain.data if isinstance(record, FreeRecord) and record.driven]
    samples, gain = _late_lags(rows, len(path.counts))
    if not samples.any():
        return None
    delay = replace(path.lateness, outputs=np.asarray(samples * rows[0].hold.h, float))
    few = replace(search, most=min(search.most, _FEW))
    fit = few.along(few.path(channels, delay), channels)
    if fit.interrupted:
        return fit
    lags = fit.states and np.all(are_heavy(fit.projection.p))
    white = fit.rounding or not leaves_traces(fit.projection)
    return replace(fit, delay_gain=gain) if lags and white and _is_late(fit, path) else None


def _is_late(fit: FreeFit, path: FreePath) -> bool:
    """Whether the poles of a fit explain less without its delay: of an input of few lines phases may be the same."""
    on_time = path.model(fit.projection.p)
    if fit.exact:
        return not path.is_exact(on_time)
    latest = float(fit.delay.max())  # as many samples are left out on either side: they may be those that tell
    rows = [record.delayed(0.0, 0.0, latest) for record in path.plain.data if isinstance(record, FreeRecord)]
    without = _bic_of(rows, FreeProjection(rows, on_time.p), fit.unknowns)
    return bic_within(fit, 0.0, latest) < without - 2 * TUNING.likely


def predicted_lateness(channels: Experiments, search: Search) -> tuple[Lateness, float]:
    """Return the delays that predictors show in the first samples, and the log-likelihood that these gain."""
    given, path = search.assumptions, search.path(channels)
    if not isinstance(channels[0], Recording) or given.delay is not None:
        return path.lateness, 0.0
    some = [cut(channel, slice(0, min(channel.samples, _BEGINNING))) for channel in channels]
    records = [record for record in search.path(some).plain.data if isinstance(record, FreeRecord)]
    samples, gain = predicted_delays(records, len(path.counts), feel_at_once(path))
    return replace(path.lateness, outputs=np.asarray(samples * channels[0].dt, float)), gain


def _late_lags(records: Sequence[FreeRecord], outputs: int) -> tuple[Indices, float]:
    """Return the samples by which each output comes late as lags show it, and the log-likelihood that this gains.

    As many for all of them, or as many as each shows alone, if that gains more.
    """

    def shown(records: Sequence[FreeRecord], outputs: int) -> tuple[int, float]:
        """Return the samples of all outputs; 0 where lags show none."""
        scan = _LateLagScan.of(records, outputs)
        return (scan and scan.likeliest()) or (0, 0.0)

    common = shown(records, outputs)
    if 1 < outputs <= _TOGETHER:
        return likelier_apart(common, shown, records, outputs)
    return np.full(outputs, common[0]), common[1]


def feel_at_once(path: FreePath) -> bool:
    """Whether some outputs answer to inputs at once: accelerations, or to inputs that change between samples."""
    return bool(path.felt.any()) or any(
        rows.hold.intersample == "foh" for rows in path.plain.data if isinstance(rows, FreeRecord)
    )


def of_predicted_delay(channels: Experiments, search: Search, late: Lateness, gain: float) -> FreeFit | None:
    """Fit outputs as late as predictors show, which gains so much log-likelihood; None if they show none.

    A search without that delay takes modes for it, and is only made where traces are left: the likelier of both then.
    """
    if not gain:
        return None
    fit = search.along(search.path(channels, late), channels)
    if fit.interrupted:
        return fit
    if not _responds(fit):
        return None
    if fit.rounding or not leaves_traces(fit.projection):
        return replace(fit, delay_gain=gain) if _is_late(fit, search.path(channels)) else None
    try:  # as of a delay that is a sample too short
        fit = on_time(fit, search)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    if fit.exact:
        return None
    if leaves_traces(fit.projection):
        without, latest = search.along(search.path(channels), channels), float(fit.delay.max())
        if without.interrupted:
            return replace(fit, delay_gain=gain, interrupted=True)
        if bic_within(without, 0.0, latest) <= bic_within(fit, 0.0, latest):
            return without
    return replace(fit, delay_gain=gain)


def on_time(fit: FreeFit, search: Search) -> FreeFit:
    """Let outputs of a fit come some samples after the inputs, or before, where a search with that is likelier."""
    trials = _Trials(fit, search)
    for _ in range(_SCANS):
        # poles that were found in a wrong delay, or none, say little of the right one
        before, scan = trials.best, _DelayScan.of(trials.best)
        if scan is not None and search.automatic:
            trials.compare_fewer_poles(scan)
        likely = [] if scan is None else scan.likely()
        made = trials.compare(likely + ([] if trials.best.delay.any() else _shown_delays(trials.best)))
        if made and trials.best is before:
            trials.compare_near_loser(min(made, key=lambda fit: fit.criteria.bic / fit.criteria.samples))
        if trials.best is before:
            break
    if not trials.best.exact and trials.best.delay.any():
        trials.compare_near(trials.best)
    return trials.best


class _Trials:
    """Fits with other delays than a first one, of which none is made twice, and the `best` of them."""

    def __init__(self, fit: FreeFit, search: Search) -> None:
        self._first, self._anew = fit, search.anew(fit)
        self.best, self.step = fit, fit.channels[0].dt
        self._made = {self._key(fit.delay, None)}

    def _key(self, delay: Array, poles: ComplexArray | None) -> tuple[tuple[int, ...], bool]:
        return _in_samples(delay, self.step), poles is None

    def compare(self, delays: Sequence[Array], poles: ComplexArray | None = None) -> list[FreeFit]:
        """Take the likeliest of the best fit and those with other delays, searched for or refined from poles.

        Returns those that were made.
        """
        delays = [
            delay for delay in delays
            if self._key(delay, poles) not in self._made and (np.all(delay >= 0) or self._first.direct)
        ]  # fmt: skip
        if not delays:
            return []
        first, best, gain, made = self._first, self.best, 0.0, list[FreeFit]()
        least, most = float(np.min(delays)), float(np.max(delays))
        before = bic_within(best, least, most)
        for delay in delays:
            if self._key(delay, poles) in self._made:
                continue
            self._made.add(self._key(delay, poles))
            again = self._anew(replace(first.lateness, outputs=delay), first.offset, poles)
            made.append(again)
            now = 0.5 * (before - bic_within(again, least, most))
            needed = _least_gain(first, again) if self.best is first and not first.delay.any() else gain
            better = now > needed
            if self.best.exact and again.exact:  # all of exact data, as other delays do: the least of them
                better = bool(np.sum(np.abs(delay)) < np.sum(np.abs(self.best.delay)))
            if better and _responds(again):
                self.best = replace(again, findings=first.findings, delay_gain=best.delay_gain + now)
                gain = now
                if again.order < first.order and not leaves_traces(again.projection):
                    break
        return made

    def compare_near(self, fit: FreeFit) -> None:
        """Take the likeliest of the best fit and those with the poles of another, refined with a delay near to its."""
        near = sorted({*range(-_NEAR, _NEAR + 1)} - {0}, key=abs)
        self.compare([fit.delay + self.step * samples for samples in near], fit.projection.p)

    def compare_near_loser(self, fit: FreeFit) -> None:
        """The same about a fit that is not far less likely than the best."""
        if fit.exact or self.best.exact or not (fit.delay.any() and _responds(fit)):
            return
        least, most = (float(end([fit.delay, self.best.delay])) for end in (np.min, np.max))
        if bic_within(fit, least, most) < bic_within(self.best, least, most) + 2 * TUNING.likely:
            self.compare_near(fit)

    def compare_fewer_poles(self, scan: _DelayScan) -> None:
        """Take a delay in place of one of the poles of the best fit where that is likelier."""
        p, delay = scan.of_fewer(), np.zeros(0)
        for _ in range(_ROUNDS):
            if p is None:
                break
            again = scan.delays(scan.latest(p))
            if np.array_equal(again, delay) or not again.any():
                break
            delay = again
            p = self._anew(replace(self._first.lateness, outputs=delay), self._first.offset, p).projection.p
        if len(delay):
            self.compare([delay], p)


def _in_samples(delay: Array, step: float) -> tuple[int, ...]:
    return tuple(np.rint(delay / step).astype(int).tolist())


def _least_gain(fit: FreeFit, again: FreeFit) -> float:
    """Return the log-likelihood that a delay has to gain over a fit without it.

    Fewer lags that leave white residuals are simpler, as the criterion counts; but one that is over within a sample may
    be a lag as well as a delay.  With noise that is modelled, or is white, a delay is one more parameter; else what
    leaves traces may ask for it.
    """
    white = not leaves_traces(again.projection)
    if not fit.order and again.states < fit.states and _samples_late(again) > 1 and white:
        return 0.0
    return 0.5 * float(np.log(fit.projection.rows)) if again.noise or white else TUNING.likely


def bic_within(fit: FreeFit, least: float, most: float, more: int = 0) -> float:
    """Return the BIC of a fit, with some more parameters, over the samples that delays between two times leave."""
    measured = _measured_within(fit, fit.channels, fit.delay, least, most)
    rows = _in_noise_of(fit, measured)
    projection = FreeProjection(rows, fit.projection.p, fit.projection.fed)
    return _bic_of(rows, projection, fit.unknowns + more, measured)


def _measured_within(
    fit: FreeFit, channels: Sequence[Recording], delay: Array, least: float, most: float
) -> Sequence[FreeRecord]:  # fmt: skip
    """Return rows of a fit with some delay, of the samples that delays between two times leave."""
    moving = any(rows.moving for rows in fit.projection.experiments)
    records = rows_as_in(fit, channels, moving, replace(fit.lateness, outputs=delay))
    return [record.delayed(record.delay_time, least, most) for record in records]


def _in_noise_of(fit: FreeFit, rows: Sequence[FreeRecord]) -> Sequence[FreeRecord]:
    """Return rows in which the noise of a fit is white."""
    return Records(rows).whitened(fit.noise).data if fit.noise else rows


def _bic_of(
    rows: Sequence[FreeRecord], projection: FreeProjection, unknowns: int, measured: Sequence[FreeRecord] | None = None
) -> float:
    """Return the BIC of poles in some rows, with so many parameters, as of all samples that were measured.

    The first of these begin the filters of coloured noise, of each fit its own.
    """
    losses = np.maximum(projection.losses, np.maximum(ROUNDED * projection.rounded, np.finfo(float).tiny))
    counts, samples = np.zeros((2, len(losses)))
    for record in rows:
        counts[record.outputs] += record.samples
    for record in rows if measured is None else measured:
        samples[record.outputs] += record.samples
    return unknowns * float(np.log(samples.sum())) + float(samples @ np.log(losses / counts))


def are_heavy(p: ComplexArray) -> Mask:
    """Return which poles are lags or heavily damped modes, which may stand for a delay."""
    return np.asarray(np.abs(p.real) >= _MIMICS * np.abs(p))


def _responds(fit: FreeFit) -> bool:
    """Whether outputs are more than noise and free motions, which know no delay."""
    return bool(fit.states or np.any(fit.projection.feedthrough))


def _shown_delays(fit: FreeFit) -> list[Array]:
    """Return whole samples, as times, by which outputs may come after the inputs, where poles leave traces of delays.

    A delay turns the phase of residues; the first samples of a response determine it.  One delay of all outputs, or of
    each its own; the likeliest first.
    """
    if not fit.projection.inputs or not fit.states or isinstance(fit.channels[0], ResponseMatrix) or fit.noise:
        return []
    some = [cut(recording, slice(0, min(recording.samples, _DELAYS_FROM))) for recording in fit.channels]
    step, count, p = some[0].dt, len(fit.scales), fit.projection.p
    records = [
        replace(record, y=record.y / fit.scales[record.outputs, None])
        for record in rows_as_in(fit, some, True, _undelayed(fit))
    ]
    tried = [delay for delay in TUNING.delays if delay >= 0 or fit.direct]
    delayed = _Delayed.of(records, tried, count)
    if delayed.rows <= 2 * fit.projection.unknowns or not leaves_traces(FreeProjection(records, p)):
        return []
    each = dict(zip(tried, delayed.losses(p)[0] / delayed.rows, strict=True))
    gains = {delay: -0.5 * fit.projection.rows * float(np.log(loss.sum())) for delay, loss in each.items()}
    # modes too many may stand for most of a delay; one sample more or less is what may be fed through
    likely = {delay for delay, gain in gains.items() if delay > 1 and gain > gains[0] - TUNING.likely}
    likely |= {1} & gains.keys() if likely else set()
    likely = (likely | {max(gains, key=lambda delay: gains[delay])}) - {0}
    common_delays = [np.full(count, step * lag) for lag in sorted(likely, key=lambda delay: -gains[delay])]
    own = np.array(tried)[np.argmin(np.stack([each[delay] for delay in tried]), axis=0)]
    return [*common_delays, step * own] if np.ptp(own) else common_delays


@dataclass(frozen=True)
class _Delayed:
    """Records in which outputs without a delay are seen with each of several delays, in `rows` equations a delay.

    A delay of whole samples shifts what inputs cause, or outputs the other way: so all delays share the columns of some
    poles, and each is one more set of outputs.
    """

    parts: Sequence[Sequence[FreeRecord]]
    outputs: int
    rows: int

    @classmethod
    def of(cls, records: Sequence[FreeRecord], delays: Sequence[int], outputs: int) -> _Delayed:
        """See all outputs of records, so many of them, with each of some delays in samples."""
        together, ends = max(1, _TOGETHER // outputs), (-min(0, *delays), max(0, *delays))
        some = [delays[k : k + together] for k in range(0, len(delays), together)]
        lasting = [record for record in records if record.length > sum(ends)]
        parts = [[rows for record in lasting for rows in _seen_with(record, each, ends, outputs)] for each in some]
        rows = sum(rows.samples * len(rows.outputs) for part in parts for rows in part)
        return cls(parts, outputs, rows // len(delays))

    def losses(self, p: ComplexArray) -> tuple[Array, int]:
        """Return squares (delays, outputs) that poles leave, and the unknowns of poles with one of the delays."""
        projections = [FreeProjection(rows, p) for rows in self.parts]
        losses = np.concatenate([projection.losses for projection in projections]).reshape(-1, self.outputs)
        poles = len(projections[0].x)
        linear = sum(projection.unknowns - poles for projection in projections)
        return losses, poles + linear // len(losses)


def _seen_with(record: FreeRecord, delays: Sequence[int], ends: tuple[int, int], outputs: int) -> list[FreeRecord]:
    """Return a record with its outputs as they are after some delays, of those that end samples leave to all."""
    first, last = ends[0], record.length - ends[1]
    shifted = [
        replace(
            record, u=record.u[:, first:last], y=record.y[:, first + delay : last + delay],
            observed=record.observed[first + delay : last + delay], outputs=record.outputs + place * outputs,
            moving=record.moving or first > 0, whole_record=None,
            level=None if record.level is None else record.level[first + delay : last + delay],
        )
        for place, delay in enumerate(delays)
    ]  # fmt: skip
    if not record.complete or record.level is not None:
        return shifted
    y, numbers = (np.concatenate([getattr(rows, name) for rows in shifted]) for name in ("y", "outputs"))
    scale = None if record.scale is None else np.tile(record.scale, len(shifted))
    return [replace(shifted[0], y=y, outputs=numbers, scale=scale, steps=None)]


def _samples_late(fit: FreeFit) -> int:
    """Return the whole samples by which the outputs of a fit come after its inputs."""
    return int(np.rint(np.median(fit.delay) / fit.channels[0].dt))


@dataclass(frozen=True)
class _DelayScan:
    """Delays of records, for the poles of a fit that has some delay, and for a lag of some rates beside some poles.

    All outputs come late together: by how much one comes after another stays as in the fit.  Poles may stand for a
    part of a delay, or for all of it: a lag of any rate takes the place of the heavily damped ones, or joins the
    slowest of them.
    """

    fit: FreeFit
    channels: Sequence[Recording]
    rows: Sequence[FreeRecord]
    beside: Sequence[ComplexArray]
    rates: Array
    most: int

    @classmethod
    def of(cls, fit: FreeFit) -> _DelayScan | None:
        """Prepare it in the noise of a fit; None where nothing stands for a delay: no such poles, in white noise."""
        channels, p = fit.channels, fit.projection.p
        if isinstance(channels[0], ResponseMatrix) or not len(channels[0].input_labels) or fit.exact:
            return None
        heavy = are_heavy(p)
        if not (fit.noise or np.any(heavy)):
            return None
        some = [cut(recording, slice(0, min(recording.samples, _DELAYS_FROM))) for recording in channels]
        shortest = min(recording.samples for recording in some)
        moving = any(rows.moving for rows in fit.projection.experiments)
        records = Records(rows_as_in(fit, some, moving, _undelayed(fit)))
        rows = (records.whitened(fit.noise) if fit.noise else records).scaled(1.0 / fit.scales).data
        lags = p[p.imag == 0].real
        lags = lags[np.argsort(np.abs(lags))]  # the slowest first
        fewer = len(lags) + 2 * int(np.sum(p[heavy].imag > 0)) - 1  # than there are
        beside = [np.concatenate([p[~heavy], lags[:count]]) for count in range(max(min(len(lags), fewer), 0) + 1)]
        beside += [] if heavy.all() else [p[:0]]
        rates = np.array([*np.geomspace(4.0 / shortest, 0.5, _LAGS) / channels[0].dt, *np.abs(lags[lags != 0])])
        return cls(fit, some, rows, beside, rates, shortest // 10)

    @property
    def p(self) -> ComplexArray:
        """Poles of the fit."""
        return self.fit.projection.p

    @property
    def late(self) -> int:
        """Samples by which that output of the fit comes late which comes first."""
        return int(np.rint(self.fit.delay.min() / self.channels[0].dt))

    @property
    def far(self) -> list[int]:
        """Delays in samples beyond those of which each is tried, each a tenth longer than the one before."""
        longest = max(self.most, LONGEST_DELAY)
        count = 1 + int(_PER_DECADE * np.log10(longest / LONGEST_DELAY))
        return sorted({*np.rint(np.geomspace(LONGEST_DELAY, longest, count)).astype(int).tolist()})

    def likeliest(self, delays: Sequence[int]) -> dict[int, tuple[float, ComplexArray]]:
        """Return the best of some delays for the poles, and for the best lag, with what it gains, and these poles.

        The gain in log-likelihood is over that of the fit.
        """
        tried, scanned = self._costs(delays)

        def with_lag(some: ComplexArray, log_rate: float) -> Array:
            return scanned(np.append(some, -np.exp(log_rate)))

        poles, logs = scanned(self.p), np.log(self.rates)
        lowest, some, about = min(
            ((float(with_lag(some, rate).min()), some, rate) for some in self.beside for rate in logs),
            key=lambda lag: lag[0],
        )
        nearest = minimize_scalar(
            lambda rate: float(with_lag(some, rate).min()), bounds=(about - 1, about + 1), method="bounded",
            options={"xatol": 0.03},
        )  # fmt: skip
        rate = nearest.x if nearest.fun < lowest else about
        scans = [(poles, self.p), (with_lag(some, rate), np.append(some, -np.exp(rate)))]
        before = float(poles[tried.index(self.late)])
        return {tried[int(np.argmin(scan))]: (before - float(scan.min()), p) for scan, p in scans}

    def _costs(self, delays: Sequence[int]) -> tuple[list[int], Callable[[ComplexArray], Array]]:
        """Return those of some delays that records are long enough for, and half the BIC of poles with each."""
        tried = sorted({self.late, *(delay for delay in delays if 0 <= delay <= self.most)})
        delayed = _Delayed.of(self.rows, tried, len(self.fit.scales))

        def costs(p: ComplexArray) -> Array:
            losses, unknowns = delayed.losses(p)
            return np.asarray(0.5 * (delayed.rows * np.log(losses.sum(axis=1)) + unknowns * np.log(delayed.rows)))

        return tried, costs

    @cached_property
    def _all(self) -> tuple[list[int], Callable[[ComplexArray], Array]]:
        return self._costs([*range(LONGEST_DELAY + 1), *self.far])

    def latest(self, p: ComplexArray) -> int:
        """Return the likeliest delay of some poles."""
        tried, costs = self._all
        return tried[int(np.argmin(costs(p)))]

    def of_fewer(self) -> ComplexArray | None:
        """Return the poles without that heavily damped one for which a delay best stands; None of less than two."""
        heavy = np.flatnonzero(are_heavy(self.p))
        if len(self.p) < 2 or not len(heavy):
            return None
        return min((np.delete(self.p, k) for k in heavy), key=lambda some: float(self._all[1](some).min()))

    def likely(self) -> list[Array]:
        """Return whole samples, as times, by which outputs may come late, the likeliest first.

        What is far less likely than the fit, though no pole that stays is refined, is not among them.
        """
        likely, far = self.likeliest(range(min(LONGEST_DELAY, self.most) + 1)), self.likeliest(self.far)
        if max(gain for gain, _ in far.values()) > max(gain for gain, _ in likely.values()):
            near = {delay for about in far for delay in range(about - about // 8, about + about // 8 + 1)}
            likely |= self.likeliest(sorted(near))
        gains = {delay: min(gain, self._gain_within(delay, p)) for delay, (gain, p) in likely.items()}
        ranked = sorted(gains, key=lambda delay: -gains[delay])
        return [self.delays(delay) for delay in ranked if gains[delay] > -TUNING.likely]

    def delays(self, samples: int) -> Array:
        """Return times by which outputs come late, that which comes first by so many samples."""
        return _undelayed(self.fit).outputs + samples * self.rows[0].hold.h

    def _gain_within(self, samples: int, p: ComplexArray) -> float:
        """Return what poles with another delay gain over those of the fit, in the samples that both delays leave.

        A response that ends before a delay does would be left out of one of them alone.
        """
        delays = (self.fit.delay, self.delays(samples))
        rows = [
            _in_noise_of(self.fit, _measured_within(self.fit, self.channels, each, np.min(delays), np.max(delays)))
            for each in delays
        ]
        projections = [FreeProjection(*pair) for pair in zip(rows, (self.p, p), strict=True)]
        before, after = (_bic_of(*pair, pair[1].unknowns) for pair in zip(rows, projections, strict=True))
        return 0.5 * (before - after)


def _undelayed(fit: FreeFit) -> Lateness:
    """Return the delays of a fit without that which all outputs have."""
    return replace(fit.lateness, outputs=fit.delay - fit.delay.min())


def leaves_traces(projection: FreeProjection, together: bool = False) -> bool:
    """Whether what is left of outputs is no white noise, or goes with an input some samples before or after.

    All samples `together` tell more of what is missing, and no more of delays that are right to a part of a sample.
    """
    if np.all(projection.losses <= ROUNDED * projection.rounded):
        return False
    pairs = zip(projection.experiments, projection.predictions(), strict=True)
    return _are_traces([
        (rows.u[: rows.inputs], np.where(rows.observed, rows.measured - predicted, np.nan))
        for rows, predicted in pairs if isinstance(rows, FreeRecord)
    ], together=together)  # fmt: skip


def may_be_late(fit: FreeFit) -> bool:
    """Whether outputs may come late: beside noise that is far from white not where nothing is left of the inputs.

    Lags and heavily damped modes stand for delays without a trace, and coloured noise for lags that come late.
    """
    p = fit.projection.p
    if fit.beside is not None:
        return errors_leave_traces(fit, together=True)
    if not fit.noise or not len(p) or np.any(are_heavy(p)):
        return True
    return leaves_traces(fit.projection, together=True)


def errors_leave_traces(fit: FreeFit, together: bool = False) -> bool:
    """Whether prediction errors beside forces or shared noise are no white noise, or go with what an input was.

    What an input will be answers to them in a closed loop.
    """
    records = [rows for rows in fit.projection.experiments if isinstance(rows, FreeRecord)]
    first = np.unique(experiments_of(records, fit.channels), return_index=True)[1].tolist()
    inputs = (records[place].u[: records[place].inputs] for place in first)
    return _are_traces(list(zip(inputs, fit.beside.errors, strict=True)), first=0, together=together)


def _are_traces(
    parts: Sequence[tuple[Array, Array]], first: int = -max(map(abs, TUNING.delays)), together: bool = False
) -> bool:  # fmt: skip
    """Whether residuals (p, T), NaN where missing, are no white noise or go with inputs (m, T), of some records.

    With inputs so many samples before and more, from the `first` on; each by itself, and all `together` as well.
    """
    most, p_values = LONGEST_DELAY if together else max(map(abs, TUNING.delays)), []
    for u, remaining in parts:
        seen = ~np.isnan(remaining)
        residuals = np.where(seen, remaining, 0.0)
        p_values += [ljung_box([residual[known]], TUNING.lags) for residual, known in zip(residuals, seen, strict=True)]
        size = 2 * u.shape[1]
        U, E = np.fft.rfft(u, size), np.fft.rfft(residuals, size)
        products = np.fft.irfft(E[:, None] * U.conj(), size)[..., np.r_[first : most + 1]]
        power = np.sum(residuals**2, axis=1)[:, None] * np.sum(u**2, axis=1) / np.sum(seen, axis=1)[:, None]
        scores = products / np.sqrt(np.where(power > 0, power, np.inf))[..., None]
        p_values += chi2.sf(scores**2, 1).ravel().tolist()
        for of_input, spectrum in zip(np.moveaxis(scores, 1, 0), U, strict=True) if together else ():
            p_values += _together(of_input, spectrum)
    return bool(p_values) and min(p_values) * len(p_values) < TUNING.white


def _together(scores: Array, spectrum: ComplexArray) -> list[float]:
    """p-values of the scores (p, lags) of each output with an input of some spectrum, all lags taken together."""
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: scores.shape[1]]
    if not products[0] > 0:
        return []
    values, vectors = np.linalg.eigh(toeplitz(products / products[0]))
    kept = values > _SHOWN * values[-1]
    squares = np.sum((scores @ vectors[:, kept]) ** 2 / values[kept], axis=1)
    return [float(p) for p in chi2.sf(squares, int(kept.sum()))]


@dataclass(frozen=True)
class _LateLags:
    """Lags with a delay: twice their negative log-likelihood with its penalty, delay, rates, and squares left over."""

    cost: float
    samples: int
    rates: Array
    losses: Array


@dataclass(frozen=True)
class _LateLagScan:
    """Records of one input, of which as many samples as the longest delay has are left out where they may be moving."""

    records: Sequence[FreeRecord]
    outputs: int
    most: int

    @classmethod
    def of(cls, records: Sequence[FreeRecord], outputs: int) -> _LateLagScan | None:
        """See the first samples of records of the same step, None where there are too few."""
        most = min((min(record.length, _SAMPLES) for record in records), default=0) // _SHARE
        same = len({record.hold.h for record in records}) == 1
        scan = cls(records, outputs, most)
        return scan if same and most > 1 and scan._counts.sum() > most else None

    def likeliest(self) -> tuple[int, float] | None:
        """Return the samples of the delay that a lag or two show, and the log-likelihood gained; None if none do."""
        slowest = 0.4 / self.most
        lags = np.append(0.0, np.geomspace(slowest, 0.5, _RATES))  # an integrator first
        still = self._on_time(lags[:0])
        rough = self._likeliest_of([lags[k : k + 1] for k in range(0, len(lags), _EACH)])
        if np.mean(rough.losses / still) > _ROUGHLY:
            return None
        about = int(np.searchsorted(lags, rough.rates[0]))
        likeliest = self._likeliest_of([lags[k : k + 1] for k in range(len(lags)) if abs(k - about) < _EACH])
        if not likeliest.samples or np.mean(likeliest.losses / still) > _MOSTLY:
            return None
        # a lag of second order looks like one of first order that comes later
        double = self._likeliest_of([np.append(likeliest.rates, rate) for rate in lags])
        likeliest = min(likeliest, double, key=lambda late: late.cost)
        pairs = np.geomspace(slowest, 0.25, _PAIRS)[:, None] * [1.0, 2.0]
        several = [*pairs, *(np.geomspace(slowest, 0.5, count) for count in (3, 4, 6))]
        several += [np.append(0.0, pair[:1]) for pair in pairs]
        gain = 0.5 * min(float(self._counts @ np.log(self._on_time(rates) / likeliest.losses)) for rates in several)
        least = max(TUNING.likely, -0.5 * float(np.log(_CLEARLY)) * self._counts.sum())
        return (likeliest.samples, gain) if likeliest.samples and gain > least else None

    @cached_property
    def _counts(self) -> Array:
        """Samples of each output."""
        counts = np.zeros(self.outputs)
        for record in self.records:
            counts[record.outputs] += len(self._window(record))
        return counts

    def _likeliest_of(self, several: Sequence[Array]) -> _LateLags:
        """Return the lags of the best criterion, of some rates, with their delay."""
        late = np.stack([self._late(rates) for rates in several])
        unknowns = np.array([(1 + self.outputs) * len(rates) for rates in several])
        costs = np.einsum("o,rod->rd", self._counts, np.log(late)) + np.log(self._counts.sum()) * unknowns[:, None]
        place, samples = (int(k) for k in np.unravel_index(np.argmin(costs), costs.shape))
        return _LateLags(float(costs[place, samples]), samples, several[place], late[place, :, samples])

    def _window(self, record: FreeRecord) -> Indices:
        """Return the samples of a record that are looked at."""
        first = self.most if record.moving else 0
        return first + np.flatnonzero(record.observed[first : min(record.length, _SAMPLES)])

    def _columns(self, record: FreeRecord, rates: Array) -> tuple[Array, Array, Array]:
        """Return outputs (q, N) without what a record has of its own, a basis (k, N) of this, and responses (n, T)."""
        window, instants = self._window(record), np.arange(min(record.length, _SAMPLES))
        own = [instants ** float(power) for power in range(record.offset)]
        own += [*np.exp(-np.multiply.outer(rates, instants))] if record.moving else []
        basis = orthogonal(np.reshape(own, (-1, len(instants)))[:, window].T)[0]
        modes = SampledModes.of(record.hold, (-rates / record.hold.h).astype(complex))
        steps = zip(modes.multiplier.real, modes.b0.real, modes.b1.real, strict=True)
        responses = [lfilter([b1, b0], [1.0, -each], record.u[0, : len(instants)]) for each, b0, b1 in steps]
        return without(record.measured[:, window].T, basis).T, basis.T, np.reshape(responses, (-1, len(instants)))

    def _late(self, rates: Array) -> Array:
        """Return squares (outputs, delays) that lags of some rates leave together with each delay."""
        count, delays = len(rates), self.most + 1
        gram, products = np.zeros((self.outputs, delays, count, count)), np.zeros((self.outputs, delays, count))
        total = np.zeros(self.outputs)
        for record in self.records:
            y, basis, responses = self._columns(record, rates)
            window, whole = self._window(record), np.zeros((len(y) + len(basis) + 1, responses.shape[1]))
            whole[:, window] = [*y, *basis, np.ones(len(window))]
            with_each = _products(whole[:-1], responses, delays)
            products[record.outputs] += with_each[: len(y)]
            own, pairs = with_each[len(y) :], (responses[:, None] * responses).reshape(count**2, -1)
            squares = _products(whole[-1:], pairs, delays).reshape(delays, count, count)
            gram[record.outputs] += squares - np.einsum("kdi,kdj->dij", own, own)
            total[record.outputs] += np.sum(y**2, axis=1)
        return _left_over(total[:, None], gram, products)

    def _on_time(self, rates: Array) -> Array:
        """Return squares (outputs,) that lags of some rates leave together without a delay."""
        count = len(rates)
        gram, products = np.zeros((self.outputs, count, count)), np.zeros((self.outputs, count))
        total = np.zeros(self.outputs)
        for record in self.records:
            y, basis, responses = self._columns(record, rates)
            columns = without(responses[:, self._window(record)].T, basis.T)
            gram[record.outputs] += columns.T @ columns
            products[record.outputs] += y @ columns
            total[record.outputs] += np.sum(y**2, axis=1)
        return _left_over(total, gram, products)


def _products(rows: Array, responses: Array, delays: int) -> Array:
    """Return sums of products (rows, delays, n) with responses (n, T) that come 0, 1, .. samples later."""
    size = next_fast_len(rows.shape[1] + delays, real=True)
    spectra = rfft(rows, size)[:, None] * rfft(responses, size).conj()
    return np.asarray(irfft(spectra, size)[..., :delays].transpose(0, 2, 1))


def _left_over(total: Array, gram: Array, products: Array) -> Array:
    """Return what columns leave of sums of squares (..), of inner products (.., k, k), and (.., k) with the outputs."""
    power = np.diagonal(gram, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(power > 0, power, 1.0))
    gram, products = gram / (scale[..., None] * scale[..., None, :]), products / scale
    solved = np.linalg.solve(gram + TUNING.ridge * np.eye(scale.shape[-1]), products[..., None])[..., 0]
    return np.maximum(total - np.sum(products * solved, axis=-1), EPS * total + np.finfo(float).tiny)

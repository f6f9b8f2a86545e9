"""Outputs that come some samples after the inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ..._types import Array, ComplexArray
from ..data.channels import ResponseMatrix
from ..data.parts import cut
from ..regression.free import FreeProjection, Lateness
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.fitted_modes import FreeFit
from ..search.free_search import Records
from ..uncertainty.residual_tests import ljung_box
from .assumptions import Anew, rows_as_in

MIMICS = 0.2  # damping ratio from which on modes may stand for a delay
_DELAYS_FROM = 20_000  # samples of each recording that delays are looked for in
_SCANS = 3  # searches with the delays that the last one says
LONGEST_DELAY = 24  # samples
_SLOWER = (1.15, 1.3)  # than the slowest of several lags that stand for one that comes late
_LAGS = 4  # of different rates, with which delays are looked for
_TOGETHER = 64  # outputs of a record, about: products of more of them with one another cost more than they spare


def on_time(fit: FreeFit, anew: Anew) -> FreeFit:
    """Let outputs of a fit come some samples after the inputs, or before, where the modes say so."""
    best, gain = fit, TUNING.likely
    for delay in _likely_delays(fit):
        again = anew(replace(fit.lateness, outputs=delay), fit.offset, None)
        share = fit.projection.rows / again.projection.rows
        now = 0.5 * (fit.criteria.bic - again.criteria.bic * share)
        # fewer lags that leave white residuals are simpler, as the criterion counts; one that is over within a sample
        # may be a lag as well as a delay
        simpler = (
            best is fit and not fit.order and again.states < fit.states and _samples_late(again) > 1
            and not leaves_traces(again.projection)
        )  # fmt: skip
        least = 0.0 if simpler else gain
        if now > least and _responds(again):
            best, gain = replace(again, findings=fit.findings, delay_gain=now), now
            if again.order < fit.order and not leaves_traces(again.projection):
                break
    # poles that were found in a wrong delay, or none, say little of the right one
    tried = {_samples_late(best)}
    for _ in range(_SCANS * (not best.rounding)):
        proposed = _scanned_delays(best) - tried
        if best is not fit and np.any(best.projection.feedthrough):  # what is fed through comes a sample earlier
            proposed |= {_samples_late(best) - 1} - tried
        tried, before = tried | proposed, best
        for samples in sorted(proposed - {-1, 0}):
            delay = np.full(len(fit.scales), samples * fit.channels[0].dt)
            again = anew(replace(fit.lateness, outputs=delay), fit.offset, None)
            now = 0.5 * (fit.criteria.bic - again.criteria.bic * fit.projection.rows / again.projection.rows)
            # with noise that is modelled a delay is one more parameter; without, what else leaves traces may ask for it
            each = 0.5 * float(np.log(fit.projection.rows)) if again.noise else TUNING.likely
            if now > (each if best is fit else gain) and _responds(again):
                best, gain = replace(again, findings=fit.findings, delay_gain=now), now
        if best is before:
            break
    return best


def _responds(fit: FreeFit) -> bool:
    """Whether outputs are more than noise and free motions, which know no delay."""
    return bool(fit.states or np.any(fit.projection.feedthrough))


def _likely_delays(fit: FreeFit) -> list[Array]:
    """Return whole samples, as times, by which outputs may come after the inputs, for the poles there are.

    A delay turns the phase of residues; the first samples of a response determine it.  Lags and heavily damped modes
    can be a rational approximation of it (Pade), which leaves white residuals: they are weighed against a delay without
    them.  One delay of all outputs, or of each its own; the likeliest first.
    """
    if not fit.projection.inputs or not fit.states or isinstance(fit.channels[0], ResponseMatrix):
        return []
    some = [cut(recording, slice(0, min(recording.samples, _DELAYS_FROM))) for recording in fit.channels]
    step, count, p = some[0].dt, len(fit.scales), fit.projection.p
    records = [
        replace(record, y=record.y / fit.scales[record.outputs, None])
        for record in rows_as_in(fit, some, True, _undelayed(fit))
    ]
    delayed = _Delayed.of(records, TUNING.delays, count)
    if delayed.rows <= 2 * fit.projection.unknowns:
        return []

    def of_all(samples: list[int]) -> list[Array]:
        return [np.full(count, step * lag) for lag in samples]

    mimicked = _mimicked_delays(delayed, p)
    if mimicked:
        return of_all(mimicked)
    if not leaves_traces(FreeProjection(records, p)):
        return []
    each = dict(zip(TUNING.delays, delayed.losses(p)[0] / delayed.rows, strict=True))
    gains = {delay: -0.5 * fit.projection.rows * float(np.log(loss.sum())) for delay, loss in each.items()}
    if fit.noise:  # what takes the place of a delay
        best = max(gains, key=lambda delay: gains[delay])
        return of_all([best] if best else [])
    # modes too many may stand for most of a delay; one sample more or less is what may be fed through
    likely = {delay for delay, gain in gains.items() if delay > 1 and gain > gains[0] - TUNING.likely}
    likely |= {1} & gains.keys() if likely else set()
    likely = (likely | {max(gains, key=lambda delay: gains[delay])}) - {0}
    common_delays = of_all(sorted(likely, key=lambda delay: -gains[delay]))
    tried = np.array(list(each))
    own = tried[np.argmin(np.stack([each[delay] for delay in tried.tolist()]), axis=0)]
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
    return [replace(shifted[0], y=y, outputs=numbers, scale=scale)]


def _mimicked_delays(delayed: _Delayed, p: ComplexArray) -> list[int]:
    """Return samples of the delays that fast lags and heavily damped modes stand for, the likeliest first."""

    def bic(p: ComplexArray) -> Array:
        losses, unknowns = delayed.losses(p)
        return np.asarray(np.log(losses.sum(axis=1)) + unknowns * np.log(delayed.rows) / delayed.rows)

    lags = np.sort(p[p.imag == 0])[::-1]  # the slowest first
    light = p[(-p.real < MIMICS * np.abs(p)) & (p.imag != 0)]
    kept = [np.concatenate([light, lags[:count]]) for count in range(len(lags) + 1)]
    kept += [lags[:1] / slower for slower in _SLOWER if len(lags) == len(p)]
    values = [bic(some) for some in kept if 0 < len(some) < len(p)]
    if not values:
        return []
    likeliest = values[int(np.argmin([value.min() for value in values]))]
    best, none = TUNING.delays[int(np.argmin(likeliest))], TUNING.delays.index(0)
    if not best or likeliest.min() >= bic(p)[none]:
        return []
    near = ({best - 1, best, best + 1} & set(TUNING.delays)) - {0}  # a sample may be fed through
    return sorted(near, key=lambda delay: float(likeliest[TUNING.delays.index(delay)]))


def _samples_late(fit: FreeFit) -> int:
    """Return the whole samples by which the outputs of a fit come after its inputs."""
    return int(np.rint(np.median(fit.delay) / fit.channels[0].dt))


def _scanned_delays(fit: FreeFit) -> set[int]:
    """Return samples by which outputs may come late, for the poles and the noise there are, or a lag of any rate.

    Poles of a fit may stand for a part of a delay, which a lag cannot.  Nothing is looked for where what is left shows
    nothing of the inputs.
    """
    channels = fit.channels
    if isinstance(channels[0], ResponseMatrix) or not len(channels[0].input_labels) or fit.rounding or not (
        fit.noise or (fit.order and np.any(fit.projection.p.imag == 0) and leaves_traces(fit.projection))
    ):  # fmt: skip
        return set()
    some = [cut(recording, slice(0, min(recording.samples, _DELAYS_FROM))) for recording in channels]
    shortest = min(recording.samples for recording in some)
    most = min(LONGEST_DELAY, shortest // 10)
    records = Records(rows_as_in(fit, some, True, _undelayed(fit)))
    rows = (records.whitened(fit.noise) if fit.noise else records).scaled(1.0 / fit.scales).data
    delayed = _Delayed.of(rows, range(most + 1), len(fit.scales))

    def scanned(p: ComplexArray) -> tuple[float, int]:
        """Return squares that poles leave with the best delay, and this."""
        losses = delayed.losses(p)[0].sum(axis=1)
        return float(losses.min()), int(np.argmin(losses))

    p = fit.projection.p
    rates = [*np.geomspace(20.0 / shortest, 0.5, _LAGS) / channels[0].dt, *-p.real[(p.imag == 0) & (p.real < 0)]]
    proposed = {min(scanned(np.array([-rate + 0j])) for rate in rates)[1]}
    return proposed | {scanned(p)[1]} if fit.order else proposed


def _undelayed(fit: FreeFit) -> Lateness:
    """Return the delays of a fit without those of the outputs."""
    return replace(fit.lateness, outputs=np.zeros_like(fit.delay))


def leaves_traces(projection: FreeProjection) -> bool:
    """Whether what is left of outputs is no white noise, or goes with an input some samples before or after."""
    pairs = zip(projection.experiments, projection.predictions(), strict=True)
    return _are_traces([
        (rows.u[: rows.inputs], np.where(rows.observed, rows.measured - predicted, np.nan))
        for rows, predicted in pairs if isinstance(rows, FreeRecord)
    ])  # fmt: skip


def may_be_late(fit: FreeFit) -> bool:
    """Whether outputs may come late: beside noise that is far from white not where nothing is left of the inputs.

    Lags and heavily damped modes stand for delays without a trace, and coloured noise for lags that come late.
    """
    p = fit.projection.p
    if fit.beside is not None:
        return errors_leave_traces(fit)
    if not fit.noise or not len(p) or np.any(-p.real > MIMICS * np.abs(p)):
        return True
    return leaves_traces(fit.projection)


def errors_leave_traces(fit: FreeFit) -> bool:
    """Whether prediction errors beside forces or shared noise are no white noise, or go with what an input was.

    What an input will be answers to them in a closed loop.
    """
    records = [rows for rows in fit.projection.experiments if isinstance(rows, FreeRecord)]
    inputs = (rows.u[: rows.inputs] for rows in records)
    return _are_traces(list(zip(inputs, fit.beside.errors, strict=True)), first=0)


def _are_traces(parts: Sequence[tuple[Array, Array]], first: int = -max(map(abs, TUNING.delays))) -> bool:
    """Whether residuals (p, T), NaN where missing, are no white noise or go with inputs (m, T), of some records.

    With inputs so many samples before and more, from the `first` on.
    """
    most, p_values = max(map(abs, TUNING.delays)), []
    for u, remaining in parts:
        seen = ~np.isnan(remaining)
        residuals = np.where(seen, remaining, 0.0)
        p_values += [ljung_box([residual[known]], TUNING.lags) for residual, known in zip(residuals, seen, strict=True)]
        size = 2 * u.shape[1]
        U, E = np.fft.rfft(u, size), np.fft.rfft(residuals, size)
        products = np.fft.irfft(E[:, None] * U.conj(), size)[..., np.r_[first : most + 1]]
        power = np.sum(residuals**2, axis=1)[:, None] * np.sum(u**2, axis=1) / np.sum(seen, axis=1)[:, None]
        p_values += chi2.sf(products**2 / np.where(power > 0, power, np.inf)[..., None], 1).ravel().tolist()
    return bool(p_values) and min(p_values) * len(p_values) < TUNING.white

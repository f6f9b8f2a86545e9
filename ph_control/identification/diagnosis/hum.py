"""Tones of constant amplitude in the outputs, such as the hum of the mains: part of the model, and no modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from ..._types import Array, Indices
from ..data.channels import Recording
from ..regression.free import FreeProjection
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import experiments_of
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from .noise_levels import records_of

_STILL = 3.0  # over the length of a record: the decay rate that a tone may seem to have
_LARGEST = 1 << 24  # samples of all outputs beyond which nothing is said of tones
_LINE = 1e-6  # probability that noise alone shows a line anywhere
_BESIDE = 16  # bins on either side, whose level a line stands out of
_WIDTH = 3  # bins on either side that a line may reach to, under the window
_CLEAN = 0.02  # of the power of a line: what is beyond
_UNDRIVEN = 1e-6  # p-value from which on an input hardly drives a mode: the criterion decides
_PASSES = 12  # of modes and tones in turn
_ROUNDS = 3  # over the tones, which leak into one another
_SETTLED = 1e-4  # relative change of their amplitudes


@dataclass(frozen=True)
class Tones:
    """Frequencies (k,) of tones, and cosine and sine (k, 2, p) of each in the outputs of each experiment."""

    frequencies: Array
    amplitudes: tuple[Array, ...]

    def signals(self, channels: Sequence[Any]) -> list[Array]:
        """What they add to the outputs (p, T) of each experiment."""
        signals = []
        for channel, each in zip(channels, self.amplitudes, strict=True):
            waves = _waves(self.frequencies, channel.dt * np.arange(float(channel.samples)))
            signals.append(each.reshape(-1, each.shape[-1]).T @ waves.reshape(-1, channel.samples))
        return signals

    def taken_from(self, channels: Sequence[Any]) -> tuple[Recording, ...]:
        """Recordings without them."""
        pairs = zip(channels, self.signals(channels), strict=True)
        return tuple(channel.adjusted(hum=signal) for channel, signal in pairs)

    def findings(self, gain: float) -> list[Finding]:
        """One of each tone and experiment: its frequency, then cosine and sine in each output."""
        return [
            Finding(Cause.HUM, (float(frequency), *each[k].T.ravel().tolist()), gain, experiment=e)
            for k, frequency in enumerate(self.frequencies) for e, each in enumerate(self.amplitudes)
        ]  # fmt: skip

    @classmethod
    def of(cls, findings: Sequence[Finding], channels: Sequence[Any]) -> Tones:
        """Those of a fit."""
        hums, amplitudes = [finding for finding in findings if finding.cause is Cause.HUM], []
        for e, channel in enumerate(channels):
            each = [np.reshape(hum.values[1:], (-1, 2)).T for hum in hums if hum.experiment == e]
            amplitudes.append(np.reshape(each, (len(each), 2, len(channel.output_labels))))
        return cls(np.array([hum.values[0] for hum in hums if not hum.experiment]), tuple(amplitudes))

    def is_near(self, others: Tones) -> bool:
        """Whether amplitudes are the same as those of others, but for a little."""
        sizes = zip(self.amplitudes, others.amplitudes, strict=True)
        return all(np.linalg.norm(new - old) <= _SETTLED * np.linalg.norm(new) for new, old in sizes)

    @property
    def unknowns(self) -> int:
        """Numbers that are estimated: of outputs that were not measured amplitudes are 0."""
        return len(self.frequencies) + sum(int(np.count_nonzero(each)) for each in self.amplitudes)


def _waves(frequencies: Array, t: Array) -> Array:
    """Cosines and sines, shape (k, 2, T)."""
    phase = frequencies[:, None] * t
    return np.stack([np.cos(phase), np.sin(phase)], axis=1)


def undriven(fit: FreeFit) -> Indices:
    """Modes that neither decay nor answer to any input: tones that were there in any case.

    Noise shows modes as faint anywhere when more of them are asked for than there are: these are no tones.
    """
    projection, n = fit.projection, len(fit.projection.p)
    rows = [record for record in projection.experiments if isinstance(record, FreeRecord)]
    if _unfit(fit):
        return np.zeros(0, int)
    covariance, width = fit.covariance, projection.shared.shape[0]
    still = _STILL / max(record.length * record.hold.h for record in rows)
    slowest, tones = TUNING.broad_noise * max(record.bin for record in rows), []
    bins, seen_by = max(record.length for record in rows) // 2, sum(len(record.outputs) for record in rows)
    faint = float(chi2.isf(_LINE / bins, 2 * seen_by)) * projection.loss / projection.rows
    for l in np.flatnonzero((projection.p.imag > slowest) & (np.abs(projection.p.real) < still)).tolist():
        first = np.arange(projection.inputs)[:, None] * (width // projection.inputs) + np.array([l, n + l])
        places = (2 * n + np.arange(projection.shared.shape[1])[:, None] * width + first.ravel()).ravel()
        residues = projection.shared[first.ravel()].T.ravel()
        seen = np.linalg.pinv(covariance[np.ix_(places, places)], hermitian=True)
        is_driven = chi2.sf(residues @ seen @ residues, len(places)) <= _UNDRIVEN
        if not is_driven and projection.without_mode(l).loss - projection.loss > faint:
            tones.append(l)
    return np.array(tones, int)


def lines_in(fit: FreeFit, share: float = 0.0) -> Array:
    """Frequencies of single lines that stand out of the spectra of what a fit leaves, with no power about them.

    A mode that is missing has a peak that is broader, as inputs drive it all along.  Each line has at least a `share`
    of the power that is left of the outputs as measured: coloured noise may take it for a peak of its own.
    """
    if _unfit(fit):
        return np.zeros(0)
    frequencies: list[float] = []
    measured = fit.projection if fit.measured is None else fit.measured
    for _, record, predicted in records_of(measured, fit.channels):
        count, last = len(record.outputs), (record.length - 1) // 2
        if last < 4 * _BESIDE:
            continue
        residuals = record.residuals(predicted) * np.hanning(record.length)
        power = np.abs(np.fft.rfft(residuals)[:, : last + 1]) ** 2
        about = median_filter(power, (1, 2 * _BESIDE + 1), mode="nearest")
        level = np.maximum(about / np.log(2), np.finfo(float).tiny)
        statistic = 2 * np.sum(power / level, axis=0)
        statistic[:_BESIDE] = 0.0
        limit = float(chi2.isf(_LINE / last, 2 * count))
        while (place := int(np.argmax(statistic))) and statistic[place] > limit:
            about = np.arange(place - _WIDTH, place + _WIDTH + 1)
            flanks = np.r_[about[0] - 2 : about[0], about[-1] + 1 : about[-1] + 3]
            flanks = flanks[flanks <= last]
            large = power[:, about[about <= last]].sum() >= share * power.sum()
            if large and statistic[flanks].max(initial=0.0) < _CLEAN * statistic[place]:
                frequencies.append(2 * np.pi * place / (record.length * record.hold.h))
            statistic[max(0, place - _BESIDE) : place + _BESIDE] = 0.0
    return np.unique(frequencies)


def _unfit(fit: FreeFit) -> bool:
    """Whether nothing is said of tones: of responses, of what is nothing but rounding, and of very long recordings."""
    rows = [record for record in fit.projection.experiments if isinstance(record, FreeRecord)]
    unfit = fit.interrupted or fit.rounding or fit.per_entry or not fit.projection.inputs
    return unfit or sum(channel.y.size for channel in fit.channels) > _LARGEST or not all(
        record.driven and record.moving for record in rows
    )  # fmt: skip


def tones_in(fit: FreeFit, frequencies: Array) -> Tones:
    """Tones near to some frequencies, beside the modes of a fit that are driven, by least squares in its noise.

    The modes that stood for tones are left out: what the inputs drive in them is noise.
    """
    measured, channels = fit.projection if fit.measured is None else fit.measured, fit.channels
    driven, places = np.delete(measured.p, undriven(fit)), experiments_of(measured.experiments, channels).tolist()
    parts = list(zip(measured.experiments, places, strict=True))
    best = np.array(frequencies, float)
    tones = Tones(best, tuple(np.zeros((len(best), 2, channel.y.shape[0])) for channel in channels))
    for _ in range(_PASSES):
        beside = []
        for record, place in parts:
            assert isinstance(record, FreeRecord)
            known = tones.signals(channels)[place] - np.broadcast_to(channels[place].hum, channels[place].y.shape)
            beside.append(record.without(known[record.outputs] / channels[place].unit))
        remainders: list[Any] = [np.full(channel.y.shape, np.nan) for channel in channels]
        for place, record, predicted in records_of(FreeProjection(beside, driven, measured.fed), channels):
            channel, outputs = channels[place], record.outputs
            rest = channel.y[outputs] - fit.scales[outputs, None] * record.placed(predicted)
            remainders[place][outputs] = channel.unit * rest + np.broadcast_to(channel.hum, channel.y.shape)[outputs]
        weights = [1.0 / (channel.unit * fit.scales) for channel in channels]
        before, tones = tones, _fitted(tones, remainders, channels, weights)
        if tones.is_near(before):
            break
    return tones


def tones_near(
    frequencies: Array, remainders: Sequence[Array], weights: Sequence[Array], channels: Sequence[Any]
) -> Tones:
    """Tones near to some frequencies by least squares in outputs (p, T), NaN where missing, of each experiment.

    `weights` (p,) are those of the outputs of each experiment, in proportion to one over the deviation of their noise.
    """
    best = np.array(frequencies, float)
    tones = Tones(best, tuple(np.zeros((len(best), 2, channel.y.shape[0])) for channel in channels))
    return _fitted(tones, remainders, channels, weights)


def _fitted(tones: Tones, remainders: Sequence[Array], channels: Sequence[Any], weights: Sequence[Array]) -> Tones:
    """Tones in what modes leave of recordings, one after the other, from where they are."""
    times = [channel.dt * np.arange(channel.samples) for channel in channels]
    seen = [np.isfinite(rest) for rest in remainders]
    remainders = [np.where(known, rest, 0.0) for known, rest in zip(seen, remainders, strict=True)]

    def fitted(frequency: float, rest: Sequence[Array]) -> tuple[float, list[Array]]:
        """Squares that a tone explains, and its cosine and sine (2, p) in each experiment."""
        gain, amplitudes = 0.0, []
        for t, part, weight, known in zip(times, rest, weights, seen, strict=True):
            X = _waves(np.array([frequency]), t)[0]
            gram = np.einsum("at,bt,pt->pab", X, X, known.astype(float)) + 1e-9 * len(t) * np.eye(2)
            projections = part @ X.T
            each = np.linalg.solve(gram, projections[:, :, None])[:, :, 0]
            gain += float(np.sum(weight**2 * np.sum(each * projections, axis=1)))
            amplitudes.append(each.T)
        return gain, amplitudes

    best, amplitudes = tones.frequencies.copy(), [each.copy() for each in tones.amplitudes]
    width = 2 * np.pi / max(t[-1] for t in times)
    for _ in range(_ROUNDS):
        for k, start in enumerate(tones.frequencies):
            for each in amplitudes:
                each[k] = 0.0
            others = Tones(best, tuple(amplitudes)).signals(channels)
            rest = [part - np.where(known, s, 0.0) for part, known, s in zip(remainders, seen, others, strict=True)]
            highest = minimize_scalar(
                lambda w, rest=rest: -fitted(w, rest)[0], bounds=(start - 0.75 * width, start + 0.75 * width),
                method="bounded", options={"xatol": 1e-6 * width},
            )  # fmt: skip
            best[k] = highest.x
            for each, values in zip(amplitudes, fitted(float(best[k]), rest)[1], strict=True):
                each[k] = values
    return Tones(best, tuple(amplitudes))

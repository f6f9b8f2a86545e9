"""Tones of constant amplitude in the outputs, such as the hum of the mains: part of the model, and no modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from ..._types import Array, Indices
from ..data.channels import Recording
from ..data.parts import is_long
from ..regression.time_rows import FreeRecord
from ..search.circumstances import Cause, Finding
from ..search.modal_search import FreeFit
from .unequal_noise import experiments_of

_STILL = 3.0  # standard errors, or one over the record, that a decay rate of a tone may have
_UNDRIVEN = 1e-3  # p-value from which on an input does not drive a mode
_PASSES = 3  # over the tones, which leak into one another


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

    @property
    def unknowns(self) -> int:
        """Numbers that are estimated."""
        return len(self.frequencies) + sum(each.size for each in self.amplitudes)


def _waves(frequencies: Array, t: Array) -> Array:
    """Cosines and sines, shape (k, 2, T)."""
    phase = frequencies[:, None] * t
    return np.stack([np.cos(phase), np.sin(phase)], axis=1)


def undriven(fit: FreeFit) -> Indices:
    """Modes that neither decay nor answer to any input: tones that were there in any case."""
    projection, n = fit.projection, len(fit.projection.p)
    rows = [record for record in projection.experiments if isinstance(record, FreeRecord)]
    unfit = fit.interrupted or fit.rounding or fit.per_entry or is_long(fit.channels)
    if unfit or not projection.inputs or not all(record.driven and record.moving for record in rows):
        return np.zeros(0, int)
    covariance, width = fit.covariance, projection.shared.shape[0]
    still = np.maximum(
        _STILL * np.sqrt(np.maximum(np.diag(covariance)[n : 2 * n], 0.0)),
        1.0 / max(record.length * record.hold.h for record in rows),
    )
    tones = []
    for l in np.flatnonzero((projection.p.imag > 0) & (np.abs(projection.p.real) < still)).tolist():
        first = np.arange(projection.inputs)[:, None] * (width // projection.inputs) + np.array([l, n + l])
        places = (2 * n + np.arange(projection.shared.shape[1])[:, None] * width + first.ravel()).ravel()
        residues = projection.shared[first.ravel()].T.ravel()
        seen = np.linalg.pinv(covariance[np.ix_(places, places)], hermitian=True)
        if chi2.sf(residues @ seen @ residues, len(places)) > _UNDRIVEN:
            tones.append(l)
    return np.array(tones, int)


def tones_in(fit: FreeFit, frequencies: Array) -> Tones:
    """Tones near to some frequencies, in what the driven modes of a fit leave, by least squares in its noise."""
    measured, tones = fit.projection if fit.measured is None else fit.measured, undriven(fit)
    p, channels = measured.p, fit.channels
    remainders: list[Any] = [np.full(channel.y.shape, np.nan) for channel in channels]
    places = experiments_of(measured.experiments, channels).tolist()
    parts = zip(measured.experiments, measured.own, measured.predictions(), places, strict=True)
    for record, own, predicted, place in parts:
        assert isinstance(record, FreeRecord)
        channel, outputs = channels[place], record.outputs
        motion = 2 * record.motion_at_start(p, measured.residues[:, outputs], own)[tones].T
        alone = (motion @ np.exp(np.outer(p[tones], channel.dt * np.arange(float(channel.samples))))).real
        rest = channel.y[outputs] - fit.scales[outputs, None] * (record.placed(predicted) - alone)
        remainders[place][outputs] = channel.unit * rest + np.broadcast_to(channel.hum, channel.y.shape)[outputs]
    weights = [1.0 / (channel.unit * fit.scales) for channel in channels]
    return tones_near(frequencies, remainders, weights, channels)


def tones_near(
    frequencies: Array, remainders: Sequence[Array], weights: Sequence[Array], channels: Sequence[Any]
) -> Tones:
    """Tones near to some frequencies by least squares in outputs (p, T), NaN where missing, of each experiment.

    `weights` (p,) are those of the outputs of each experiment, in proportion to one over the deviation of their noise.
    """
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

    def without(tone: int) -> list[Array]:
        others = [np.where(np.arange(len(best))[:, None, None] == tone, 0.0, each) for each in stacked()]
        signals = Tones(best, tuple(others)).signals(channels)
        return [part - np.where(known, s, 0.0) for part, known, s in zip(remainders, seen, signals, strict=True)]

    def stacked() -> list[Array]:
        return [np.array([each[e] for each in amplitudes]) for e in range(len(channels))]

    best = np.array(frequencies, float)
    amplitudes = [[np.zeros((2, channel.y.shape[0])) for channel in channels] for _ in best]
    width = 2 * np.pi / max(t[-1] for t in times)
    for _ in range(_PASSES):
        for k, start in enumerate(frequencies):
            rest = without(k)
            highest = minimize_scalar(
                lambda w, rest=rest: -fitted(w, rest)[0], bounds=(start - 0.75 * width, start + 0.75 * width),
                method="bounded", options={"xatol": 1e-6 * width},
            )  # fmt: skip
            best[k] = highest.x
            amplitudes[k] = fitted(float(best[k]), rest)[1]
    return Tones(best, tuple(stacked()))

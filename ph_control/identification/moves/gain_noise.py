"""Noise of responses that grows with their gain: its law in each entry, and the fit with the weights of these laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from ..._types import Array, ComplexArray
from ..data.channels import ResponseMatrix
from ..growth.choosing import chosen
from ..growth.ending import finished
from ..growth.growing import cleaned
from ..regression.free import FreeProjection
from ..regression.frequency_rows import FreeResponse
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from ..search.free_search import Responses
from ..search.path import FreePath
from .assumptions import Search

ROUNDS = 8  # of fit and law in turn
SETTLED = 1e-3  # relative change of the weights
_RATIOS = 25  # of a to b that are tried first,
_SOME = 4000  # over so many points, or twice as many
_FREE = 0.5  # of the noise of a point that modes leave, where they do not follow it
_TURNS = 30  # of a fixed point, at most
_MANY = 1 << 13  # points that a law is estimated from, at most about
_SAME = 1e-12  # relative change at which it is found


def in_noise_of_the_gain(first: FreeFit, search: Search) -> FreeFit:
    """Repeat a fit with the weights of the noise of its entries, until both agree; as it was, if that is constant."""
    refits = Refits(first, search)
    laws, free = entry_laws(first.projection)
    if free and not any(law.share for law, _ in laws):
        return first
    # points of large gain, were they taken as equally sure, would draw the model through themselves
    weights, p, known = balanced([channel.response for channel in first.channels]), first.projection.p, False
    while True:
        for place in range(ROUNDS):
            before = weights
            near = refits.refined(_with_weights(first.channels, weights), p)
            laws, _ = entry_laws(near.projection)
            if not any(law.share for law, _ in laws):
                return first
            weights, p = _inverse_variances(near, [law for law, _ in laws]), near.projection.p
            pairs = zip(weights, before, strict=True)
            if place and all(np.nanmax(np.abs(new / old - 1)) <= SETTLED for new, old in pairs):
                break
        judged = refits.again(_with_weights(first.channels, weights), p, known)
        if known or judged.order == len(p):
            break
        # other modes leave other noise
        p, known = judged.projection.p, True
    finding = Finding(Cause.GAIN_NOISE, tuple(law.share for law, _ in laws), sum(gain for _, gain in laws))
    # constant noise, at the points of large gain that balanced weights leave free, may seem to grow
    more = float(np.log(judged.projection.rows)) * sum(1 for law, _ in laws if law.share)
    return replace(judged, findings=(finding,)) if _restricted_bic(judged) + more < _restricted_bic(first) else first


@dataclass(frozen=True)
class Refits:
    """A fit to responses, repeated in the noise of other weights."""

    fit: FreeFit
    search: Search

    def refined(self, channels: Experiments, p: ComplexArray) -> FreeFit:
        """Keep the poles but for what the weights move them by."""
        path = self._path(channels)
        path.weigh(path.model(p).losses)
        projection = path.refined(p, TUNING.rough, None)
        return replace(self.fit, projection=projection, channels=tuple(channels), scales=1.0 / path.sizes)

    def again(self, channels: Experiments, p: ComplexArray, known: bool) -> FreeFit:
        """Look for other poles as well, unless these are known."""
        path = self._path(channels)
        model = path.model(p)
        if self.search.automatic and not known:
            model = chosen(path, cleaned(path, model).p, self.search.most, True)
        return finished(path, model, channels, self.search.automatic)

    def _path(self, channels: Experiments) -> FreePath:
        path = self.search.path(channels)
        path.add_terms([rows for rows in self.fit.projection.experiments if isinstance(rows, FreeResponse)])
        return path


def weighted_bic(fit: FreeFit) -> float:
    """Return the BIC with the density of the noise where it has these weights: two real numbers at each point."""
    logs = [np.log(relative_weights(channel)).reshape(channel.observed.shape) for channel in fit.channels]
    return fit.criteria.bic - 2 * sum(
        float(np.sum(each[channel.observed])) for each, channel in zip(logs, fit.channels, strict=True)
    )


def _restricted_bic(fit: FreeFit) -> float:
    """Return the same, each point counted as far as the fit leaves its noise: one that it goes through tells of none.

    So it has the derivative of the restricted likelihood by the weights.
    """
    logs, weights = 0.0, [np.log(relative_weights(channel)) for channel in fit.channels]
    for rows in fit.projection.experiments:
        if isinstance(rows, FreeResponse):
            each = weights[rows.experiment][rows.outputs][:, rows.observed]
            if each.any():
                logs += float(np.sum(each * _left(rows, fit.projection)))
    return fit.criteria.bic - 2 * logs


def relative_weights(channel: ResponseMatrix) -> Array:
    """Return the weights of each entry (p m, K) over their mean, as rows have them: the same in any units."""
    weights, seen = (each.reshape(-1, channel.samples) for each in (channel.weights, channel.observed))
    means = np.sum(np.where(seen, weights, 0.0), axis=1) / np.maximum(seen.sum(axis=1), 1)
    return np.asarray(weights / np.where(seen.any(axis=1), means, 1.0)[:, None])


def _with_weights(channels: Sequence[ResponseMatrix], weights: Sequence[Array]) -> list[ResponseMatrix]:
    pairs = zip(channels, weights, strict=True)
    return [replace(channel, weights=np.where(channel.observed, each, 1.0)) for channel, each in pairs]


def _inverse_variances(fit: FreeFit, laws: Sequence[NoiseLaw]) -> list[Array]:
    """Return weights (p, m, K) of each experiment by the laws of its entries, in the units of the data."""
    inverse_variances, projection = [], fit.projection
    for number, channel in enumerate(fit.channels):
        weights = np.ones((len(laws), channel.samples))
        for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
            if isinstance(rows, FreeResponse) and rows.experiment == number:
                for output, gain in zip(rows.outputs.tolist(), np.abs(predicted), strict=True):
                    variance = laws[output].floor ** 2 + (laws[output].share * gain) ** 2
                    weights[output] = 1.0 / (fit.scales[output] ** 2 * np.where(np.isnan(gain), 1.0, variance))
        inverse_variances.append(weights.reshape(channel.response.shape))
    return inverse_variances


class NoiseKind(str, Enum):
    """What was taken for the variance of the noise."""

    CONSTANT = "constant"
    WEIGHTS = "weights"
    GAIN = "gain"


@dataclass(frozen=True)
class NoiseLaw:
    """The variance `floor^2 + (share |G|)^2` of real and imaginary part, each; that of a record in time is constant.

    Attributes
    ----------
    kind : NoiseKind
        'constant'; 'weights' if these were given, of which the variance is the inverse, times `floor^2`; or 'gain' if
        a part that grows with the gain was estimated.
    floor : float
        Standard deviation where there is no gain.
    share : float
        Standard deviation over the gain.
    """

    kind: NoiseKind
    floor: float
    share: float = 0.0

    def times(self, factor: float) -> NoiseLaw:
        """Standard deviations so many times as large."""
        return NoiseLaw(self.kind, factor * self.floor, factor * self.share)


def balanced(responses: Sequence[ComplexArray]) -> list[Array]:
    """Weights between those of constant noise and of noise in proportion to the gain, of responses (..., K)."""
    squares = [np.abs(response) ** 2 for response in responses]
    middle = np.nanmedian(np.concatenate(squares, axis=-1), axis=-1, keepdims=True)
    return [1.0 / np.maximum(square + middle, np.finfo(float).tiny) for square in squares]


def entry_laws(projection: FreeProjection) -> tuple[list[tuple[NoiseLaw, float]], bool]:
    """Law of the noise of each entry of responses about damped modes, and how much likelier it is than a constant.

    Then whether no point has so much leverage that it draws the modes through itself: all residuals show noise.
    """
    every = [response for response in projection.experiments if isinstance(response, FreeResponse)]
    steps = [1 + len(response.omega) // _MANY for response in every]
    search = Responses([response.every(step) for response, step in zip(every, steps, strict=True)])
    parts: list[list[_Points]] = [[] for _ in range(projection.shared.shape[1])]
    for rows, residuals, step in zip(search.data, search.residuals(projection), steps, strict=True):
        spare = 1 - (1 - _left(rows, projection)) / step  # of all points each takes less
        for output, residual, target in zip(rows.outputs.tolist(), residuals, rows.target, strict=True):
            parts[output].append(_points(residual, target, rows.weight, spare))
    free = all(spare.min(initial=1.0) > _FREE for entry in parts for _, spare, _ in entry)
    return [_likeliest(entry, len(parts)) for entry in parts], free


_Points = tuple[Array, Array, Array]  # squares of what is left, share of the noise that it has, and gain


def _points(residual: ComplexArray, target: ComplexArray, weight: Array, spare: Array) -> _Points:
    return np.abs(residual / weight) ** 2, spare, np.abs(target - residual) / weight


def _likeliest(parts: Sequence[_Points], entries: int = 1) -> tuple[NoiseLaw, float]:
    """The law of one of several entries, and how much likelier it is than a constant."""
    squares, spare, gain = (np.concatenate(each) for each in zip(*parts, strict=True))
    if spare.sum() < TUNING.fewest_points or not np.ptp(gain):
        return NoiseLaw(NoiseKind.CONSTANT, 1.0), 0.0
    unit = float(np.mean(gain**2))
    floor, share, more = _law(squares, spare, gain**2 / unit, TUNING.constant_by_chance / entries)
    kind = NoiseKind.GAIN if share else NoiseKind.CONSTANT
    return NoiseLaw(kind, float(np.sqrt(floor)), float(np.sqrt(share / unit))), more


def _left(rows: FreeResponse, projection: FreeProjection) -> Array:
    """Share of the noise of each point that a fit leaves, shape (m,)."""
    columns = next(rows.evaluated(projection.p).blocks())[: -len(rows.outputs)]
    alone, together = _spare(columns[: -2 * len(projection.p)]), _spare(columns)
    # poles are fitted to all entries, of which each feels its share
    return np.asarray(alone + (together - alone) / projection.shared.shape[1])


def _spare(columns: Array) -> Array:
    """Share of the noise of each point that a fit of these columns (k, 2m) leaves, shape (m,); 0 to 1."""
    lengths = np.linalg.norm(columns, axis=1)
    Q, R = np.linalg.qr(columns.T / np.where(lengths > 0, lengths, 1.0))
    taken = np.sum(Q[:, np.abs(np.diag(R)) > 1e-12] ** 2, axis=1)
    return np.clip(1 - 0.5 * (taken[: len(taken) // 2] + taken[len(taken) // 2 :]), 0.0, 1.0)


def _law(squares: Array, spare: Array, power: Array, by_chance: float) -> tuple[float, float, float]:
    """Variances `a` and `b` of `a + b power`, and log-likelihood beyond a constant; `b` is 0 unless that is refused."""
    kept = np.argsort(power, kind="stable")
    kept = kept[spare[kept] > 0.1]
    squares, every, power = squares[kept] / spare[kept], spare[kept], power[kept]

    def fitted(shape: Array, apart: int = 1) -> tuple[float, float]:
        """Half of -2 log-likelihood of variances in proportion to a shape at some points, and the factor."""
        size, shape, spare = squares[::apart] / shape[::apart], shape[::apart], every[::apart]
        factor = float(np.median(size))
        if not factor:
            return np.inf, 0.0
        for _ in range(_TURNS):
            before, heavy = factor, size * (TUNING.tails + 2) / (TUNING.tails + size / factor)
            factor = float(spare @ heavy / (2 * spare.sum()))
            if abs(factor - before) < _SAME * factor:
                break
        tail = 0.5 * (TUNING.tails + 2) * np.log1p(size / (TUNING.tails * factor))
        return float(spare @ (np.log(factor * shape) + tail)), factor

    def cost(log_ratio: float, apart: int = 1) -> float:
        return fitted(np.exp(log_ratio) + power, apart)[0]

    constant, level = fitted(np.ones(len(power)))
    ends = np.log([1e-3 * max(power.min(), 1e-16 * power.max()), 1e3 * power.max()])
    tried = np.linspace(ends[0], ends[1], _RATIOS)
    best, before = int(np.argmin([cost(log_ratio, 1 + len(power) // _SOME) for log_ratio in tried])), -1
    while best != before:  # over all points
        near = np.arange(max(0, best - 1), min(_RATIOS, best + 2))
        before, best = best, int(near[np.argmin([cost(tried[k]) for k in near])])
    bounds = tried[near[0]], tried[near[-1]]
    ratio = float(minimize_scalar(cost, bounds=bounds, method="bounded").x)
    varying, factor = fitted(np.exp(ratio) + power)
    # under the hypothesis the share lies on the border of what it may be, so that half the chances are on one side
    if 2 * (constant - varying) < chi2.isf(2 * by_chance, 1):
        return level, 0.0, 0.0
    return factor * float(np.exp(ratio)), factor, constant - varying

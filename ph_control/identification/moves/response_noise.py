"""Noise of frequency responses: that grows with their gain, that an estimate with a window has, and lines in error.

Noise of the gain has a law in each entry, and the fit the weights of these laws.

Blocks of a record begin in motion, so that the errors of a response estimated with a window are largest at its
resonances, and those of neighbouring lines are correlated.  All follows from the modes and from the ratio of the noise
of each output to the input, which is estimated from what the modes leave, as the likelihood of the residuals with their
own degrees of freedom has it.  The law times the number of blocks is that of one: without this number the few lines
about resonances have to tell how large the errors there are, which they do poorly.

Single lines that are wild, or in error, are values of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from ..._types import Array, ComplexArray, Indices
from ...analysis.spectral_window import SpectralWindow
from ...exceptions import IdentificationError
from ..data.channels import ResponseMatrix
from ..data.frequency_record import BandedFactor, LineErrors
from ..data.windowed import WindowErrors, error_bands
from ..growth.ending import finished
from ..growth.growing import chosen, cleaned
from ..regression.free import FreeProjection, pole_derivatives
from ..regression.frequency_rows import FreeResponse
from ..regression.spectral_rows import real_rows
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit, count_real_poles
from ..search.free_search import Responses
from ..search.path import FreePath
from ..uncertainty.residual_tests import is_white
from .assumptions import Assumptions, Fit, Search, alone

# noise of the gain
_ROUNDS = 8  # of fit and law in turn
SETTLED = 1e-3  # relative change of the weights
_RATIOS = 25  # of a to b that are tried first,
_SOME = 4000  # over so many points, or twice as many
_FREE = 0.5  # of the noise of a point that modes leave, where they do not follow it
_TURNS = 30  # of a fixed point, at most
_MANY = 1 << 13  # points that a law is estimated from, at most about
_SAME = 1e-12  # relative change at which it is found

# errors of a window
_CURVED = 0.1  # of the second differences of a response: errors of its peaks before they are known
_RIDGE = 1e-12  # of unit columns that may be alike
_LEAST = 1e-12  # of the largest motion: what of it is rounding
_SAME_ERRORS = 0.02  # relative change of the variances of lines
_ALL = 0.01  # noise beside motion, or motion beside noise, that does not count

Place = tuple[int, int]  # an experiment and a line of it

# lines in error
_ABOUT = 4  # lines on either side, whose median a wild line is so many times as large as
_WILD = 20.0
_HARDLY_MORE = 4.0  # times the squares that a fit without some lines leaves
_EXPLAINED = 0.5  # of a value at a line: what modes that explain it may leave
_FEW_WILD = 3  # lines, or a few in a thousand: more are no accident


def in_noise_of_the_gain(first: FreeFit, search: Search) -> FreeFit:
    """Repeat a fit with the weights of the noise of its entries, until both agree; as it was, if that is constant."""
    refits = _Refits(first, search)
    laws, free = entry_laws(first.projection)
    if free and not any(law.share for law, _ in laws):
        return first
    # points of large gain, were they taken as equally sure, would draw the model through themselves
    weights, p, known = balanced([channel.response for channel in first.channels]), first.projection.p, False
    while True:
        for place in range(_ROUNDS):
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
class _Refits:
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


def _restricted_bic(fit: FreeFit) -> float:
    """Return the BIC, each point counted as far as the fit leaves its noise: one that it goes through tells of none.

    So it has the derivative of the restricted likelihood by the weights.
    """
    logs, weights = 0.0, [np.log(_relative_weights(channel)) for channel in fit.channels]
    for rows in fit.projection.experiments:
        if isinstance(rows, FreeResponse):
            each = weights[rows.experiment][rows.outputs][:, rows.observed]
            if each.any():
                logs += float(np.sum(each * (1 - _noise_share_left(rows, fit.projection))))
    return fit.criteria.bic + 2 * logs


def _relative_weights(channel: ResponseMatrix) -> Array:
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
        spare = 1 - (1 - _noise_share_left(rows, projection)) / step  # of all points each takes less
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


def _noise_share_left(rows: FreeResponse, projection: FreeProjection) -> Array:
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


def in_noise_of_the_window(fit: FreeFit, search: Search) -> FreeFit:
    """Repeat a fit to responses estimated with a window with the errors of its own model, until both agree."""
    refits = _Refits(fit, search)
    near, known = fit, False
    while True:
        for _ in range(_ROUNDS):
            before = near
            near = refits.refined(_of_model(near), near.projection.p)
            if len(near.projection.p) == len(before.projection.p) and _agree(near, before):
                break
        judged = refits.again(near.channels, near.projection.p, known)
        if judged.interrupted:
            raise KeyboardInterrupt
        if known or len(judged.projection.p) == len(near.projection.p):
            return judged
        # other modes leave other errors
        near, known = judged, True


def _agree(fit: FreeFit, before: FreeFit) -> bool:
    """Return whether the errors of two fits are the same."""
    laws = [[channel.errors.covariances[:, :, 0].real for channel in each.channels] for each in (fit, before)]
    scales = [float(np.exp(np.mean([np.log(law).mean() for law in each]))) for each in laws]
    pairs = zip(*laws, strict=True)
    return all(np.max(np.abs(now / then * (scales[1] / scales[0]) - 1)) <= _SAME_ERRORS for now, then in pairs)


def _noise_alone(window: SpectralWindow, omega: Array) -> ComplexArray:
    """Return correlations (b + 1, K) of the errors that white noise leaves."""
    lines = window.lines(omega)
    none = np.zeros(0, complex), np.zeros((0, 1, 1), complex), np.zeros((1, 1))
    bands = error_bands(window, lines, *none).covariance(lines, (0, 0), 1.0)
    sizes = np.sqrt(bands[0].real)
    for d in range(len(bands)):
        bands[d, : len(sizes) - d] /= sizes[d:] * sizes[: len(sizes) - d]
    return bands


def _of_variances(data: ResponseMatrix, variances: Array) -> ResponseMatrix:
    """Return responses with errors of these variances (p, m, K), correlated as those of noise."""
    assert data.window is not None
    sizes, correlation = np.sqrt(variances), _noise_alone(data.window, data.omega)
    bands = np.tile(correlation, (*sizes.shape[:2], 1, 1))
    for d in range(len(correlation)):
        kept = data.samples - d
        bands[:, :, d, :kept] *= sizes[..., d:] * sizes[..., :kept]
    return _with_errors(data, LineErrors(bands, np.zeros_like(bands), np.zeros(len(sizes))))


def _with_errors(data: ResponseMatrix, errors: LineErrors) -> ResponseMatrix:
    """Return responses with other errors, and weights that go with them."""
    return replace(data, errors=errors, weights=np.where(data.observed, errors.weights, 1.0))


def with_first_errors(responses: list[ResponseMatrix], weighted: bool) -> list[ResponseMatrix]:
    """Return responses of which some have a window, with errors by weights or curvature unless these are known."""
    windowed = [data for data in responses if data.window is not None]
    if any(data.errors is not None for data in windowed):
        return responses
    return [_in_weights(data) if weighted else _of_curvature(data) for data in windowed]


def _in_weights(data: ResponseMatrix) -> ResponseMatrix:
    """Return responses with errors of which the variances are the inverse of their weights."""
    return _of_variances(data, 1.0 / data.weights)


def _of_curvature(data: ResponseMatrix) -> ResponseMatrix:
    """Return responses with errors as their second differences let them appear: of noise, and about narrow peaks."""
    padded = np.pad(np.nan_to_num(data.response), ((0, 0), (0, 0), (1, 1)), mode="edge")
    curved = np.abs(np.diff(padded, 2)) ** 2
    scale = np.median(curved, axis=-1, keepdims=True)
    curved = np.pad(curved / np.where(scale > 0, scale, 1.0), ((0, 0), (0, 0), (1, 1)), mode="edge")
    near = np.mean(np.lib.stride_tricks.sliding_window_view(curved, 3, axis=-1), axis=-1)
    return _of_variances(data, 1.0 + _CURVED * near)


def _of_model(fit: FreeFit) -> list[ResponseMatrix]:
    """Return responses with the errors that their model leaves, and noise as the residuals of each output show it."""
    projection = fit.projection
    p, m = len(fit.channels[0].output_labels), len(fit.channels[0].input_labels)
    residues = (projection.residues[:, :, 0] * fit.scales).reshape(len(projection.p), p, m)
    residues[projection.p.imag == 0] = residues[projection.p.imag == 0].real
    feedthrough = (projection.feedthrough[:, 0] * fit.scales).reshape(p, m)
    channels = []
    for data in fit.channels:
        lines = data.window.lines(data.omega)
        law = error_bands(data.window, lines, projection.p, residues, feedthrough)
        entries = [
            _Entry.of(fit, k, rows, m) for k, rows in enumerate(projection.experiments)
            if isinstance(rows, FreeResponse) and rows.frequencies is data.omega
        ]  # fmt: skip
        noise = np.array([
            _likeliest_noise([each for each in entries if each.place[0] == output], law, data.window.blocks)
            for output in range(p)
        ])  # fmt: skip
        covariances = np.array([[law.covariance(lines, (o, o), noise[o])] * m for o in range(p)])
        relations = np.array([[law.relation(lines, (o, i), (o, i)) for i in range(m)] for o in range(p)])
        unit = np.median(covariances[:, :, :1].real, axis=-1, keepdims=True)
        errors = LineErrors(covariances / unit, relations / unit, noise)
        object.__setattr__(errors, "law", law)
        channels.append(_with_errors(data, errors))
    return channels


def _likeliest_noise(entries: Sequence[_Entry], law: WindowErrors, blocks: int | None) -> float:
    """Variance of noise over that of an input with which the residuals of the entries of an output are likeliest."""
    if not entries:
        return 1.0
    output = entries[0].place[0]
    ratios = law.motion[output, output, 0].real / law.noise[0].real
    largest = float(ratios.max(initial=0.0))
    if largest <= 0:
        return 1.0

    def unlikely(log_noise: float) -> float:
        return sum(entry.unlikely(law, float(np.exp(log_noise)), blocks) for entry in entries)

    # from where motion is all at all lines to where noise is
    low, high = np.log([max(float(ratios.min()), _LEAST * largest) * _ALL, largest / _ALL]).tolist()
    tried = np.linspace(low, high, 2 + int((high - low) / np.log(10)))
    best = int(np.argmin([unlikely(noise) for noise in tried]))
    bounds = tried[max(0, best - 1)], tried[min(len(tried) - 1, best + 1)]
    end = minimize_scalar(unlikely, bounds=bounds, method="bounded", options={"xatol": 0.02})
    return float(np.exp(end.x))


@dataclass(frozen=True)
class _Entry:
    """An entry of responses: the columns (k, K) that its fit is free in, and what was measured, as last of them.

    That is in the units of the data.
    """

    place: tuple[int, int]
    lines: Indices
    columns: ComplexArray

    @classmethod
    def of(cls, fit: FreeFit, k: int, rows: FreeResponse, inputs: int) -> _Entry:
        """That of the rows of an experiment."""
        projection = fit.projection
        plain, n = replace(rows, white=None, scale=np.ones(len(rows.scale))), len(projection.p)
        assert plain.window is not None
        columns, entry = next(plain.evaluated(projection.p).blocks()), int(rows.outputs[0])
        linear = plain.own_unknowns(n) + 2 * n + plain.through
        derivatives = columns[linear : linear + 4 * n].T
        slopes = pole_derivatives(derivatives, plain, projection.own[k][:, 0], projection.residues[:, entry])
        parts = np.concatenate([columns[:linear], slopes.T, columns[-1:]])
        parts[-1] *= fit.scales[entry]
        half = len(plain.omega)
        each = parts[:, :half] + 1j * parts[:, half:]
        return cls(divmod(entry, inputs), plain.window.lines(plain.omega), each)

    def unlikely(self, law: WindowErrors, noise: float, blocks: int | None) -> float:
        """-2 log-likelihood of what is left, with the degrees of freedom that it has.

        The scale of the errors is that of so many `blocks`; where their number is not known, the best.
        """
        covariance = law.covariance(self.lines, (self.place[0],) * 2, noise)
        factor = BandedFactor.of(covariance, law.relation(self.lines, self.place, self.place))
        rows = real_rows([factor.whitened(self.columns)])
        lengths = np.linalg.norm(rows, axis=1)
        unit = rows[lengths > 0] / lengths[lengths > 0, None]
        R, _ = lapack.dpotrf(unit @ unit.T + _RIDGE * np.eye(len(unit)))
        sizes = np.log(np.abs(np.diag(R))) + np.log(lengths[lengths > 0])
        if blocks is not None:
            return float(factor.log_determinant + 2 * np.sum(sizes[:-1]) + blocks * np.exp(2 * sizes[-1]))
        spare = max(1, rows.shape[1] - len(sizes) + 1)
        return float(factor.log_determinant + 2 * spare * sizes[-1] + 2 * np.sum(sizes[:-1]))


def without_lines_in_error(
    responses: Sequence[ResponseMatrix],
    order: int | str,
    assumptions: Assumptions,
    start: ComplexArray | None,
    fitted: Fit,
) -> FreeFit:
    """Fit modes to responses, without lines that are wild, or in error, if they are better values of their own."""
    sure = replace(assumptions, doubted=False, beside=alone)

    def among(
        channels: Experiments, start: ComplexArray | None, order: int | str = order,
        real_poles: int | str = assumptions.real_poles,
    ) -> FreeFit:  # fmt: skip
        return fitted(channels, order, replace(sure, real_poles=real_poles), start)

    wild = [_wild_lines(data) for data in responses]
    if any(map(len, wild)):
        return _with_or_without(wild, responses, among, start)
    return _without_errors(among(responses, start), responses, among)


def _with_or_without(
    wild: Sequence[Indices], channels: Experiments, among: Callable[..., FreeFit], start: ComplexArray | None
) -> FreeFit:
    """Fit all lines of responses, or without those that are wild, if they are better values of their own."""
    calm = among(_without_lines(channels, wild), start)
    if not calm.interrupted:
        whole = among(channels, calm.projection.p)
        explained = whole.order <= calm.order and _explains(whole, calm, wild)
        if explained or not _is_likelier_without(whole, calm, wild):
            return whole
    return _leaving_out(calm, wild)


def _wild_lines(response: ResponseMatrix) -> Indices:
    """Return the places of lines that are far larger than the lines about them in some entry, unless many are.

    In units of their standard errors, where the weights give these.
    """
    size = np.abs(response.response * np.sqrt(response.weights)).reshape(-1, response.samples)
    wild = np.zeros(response.samples, bool)
    for each in size:
        seen = np.flatnonzero(each == each)
        if len(seen) <= 2 * _ABOUT:
            continue
        padded = np.pad(each[seen], _ABOUT, mode="reflect")
        about = np.delete(np.lib.stride_tricks.sliding_window_view(padded, 2 * _ABOUT + 1), _ABOUT, axis=1)
        wild[seen] |= each[seen] > _WILD * np.median(about, axis=1)
    return np.flatnonzero(wild) if 0 < wild.sum() <= max(_FEW_WILD, _ABOUT * len(wild) // 1000) else np.zeros(0, int)


def _without_lines(channels: Experiments, lines: Sequence[Indices]) -> list[ResponseMatrix]:
    responses = []
    for channel, places in zip(channels, lines, strict=True):
        assert isinstance(channel, ResponseMatrix)
        response = channel.response.copy()
        response[..., places] = np.nan
        responses.append(replace(channel, response=response))
    return responses


def _explains(whole: FreeFit, calm: FreeFit, lines: Sequence[Indices]) -> bool:
    """Return whether a fit to all lines explains the values at some, and all others hardly worse than one without.

    Values of few digits next to a resonance may be off by more than the noise of all others, and still belong to it.
    There is no resonance at a frequency of 0.
    """
    if any(np.any(data.omega[far] == 0) for data, far in zip(whole.channels, lines, strict=True)):
        return False
    for rows, predicted in zip(whole.projection.experiments, whole.projection.predictions(), strict=True):
        if isinstance(rows, FreeResponse):
            far = lines[rows.experiment]
            if np.any(np.abs(rows.response - predicted)[:, far] > _EXPLAINED * np.abs(rows.response[:, far])):
                return False
    losses = []
    for fit in (whole, calm):
        losses.append(0.0)
        for rows, predicted in zip(fit.projection.experiments, fit.projection.predictions(), strict=True):
            if isinstance(rows, FreeResponse):
                others = calm.channels[rows.experiment]
                weights = np.where(others.observed, others.weights, 0.0).reshape(-1, others.samples)[rows.outputs]
                size = np.abs(rows.response - predicted) * fit.scales[rows.outputs, None]
                losses[-1] += float(np.nansum(weights * size**2))
    return losses[0] <= _HARDLY_MORE * losses[1]


def _without_errors(whole: FreeFit, channels: Sequence[ResponseMatrix], among: Callable[..., FreeFit]) -> FreeFit:
    """Leave out values that are errors of single lines, where these made a mode, or broadened one.

    A mode that only one line asks for has more unknowns than a value of its own.  Next to a resonance an error looks
    like damping, and residuals are not white: there a line is left out only if nothing else was wrong.
    """
    projection = whole.projection
    if whole.interrupted or whole.rounding or whole.crowded or not len(projection.p):
        return whole

    def leaving(places: Collection[Place], **how: Any) -> FreeFit:
        lines = [np.array(sorted(line for k, line in places if k == j), int) for j in range(len(channels))]
        try:
            calm = among(_without_lines(channels, lines), **how)
        except IdentificationError:  # the other lines do not carry the modes
            return whole
        likelier = not calm.interrupted and _is_likelier_without(whole, calm, lines)
        return _leaving_out(calm, lines) if likelier else whole

    single = _of_single_lines(whole, channels)
    if single:
        rest = np.delete(projection.p, list(single))
        return leaving(set(single.values()), start=rest) if len(set(single.values())) <= _FEW_WILD else whole
    if is_white(projection):
        return whole
    nearest = {
        (k, int(np.argmin(np.where(data.observed.any(axis=(0, 1)), np.abs(data.omega - d), np.inf))))
        for k, data in enumerate(channels) for d in projection.d[projection.p.imag > 0]
    }  # fmt: skip
    order: dict[str, int] = {"order": whole.order, "real_poles": count_real_poles(projection.p)}
    calm = leaving(nearest, **order, start=projection.p)
    if calm is whole or not is_white(calm.projection):
        return whole
    start = calm.projection.p
    fits = [leaving([each], **order, start=start) for each in sorted(nearest)]
    return min((fit for fit in fits if fit is not whole), key=lambda fit: fit.criteria.bic, default=whole)


def _of_single_lines(fit: FreeFit, channels: Sequence[ResponseMatrix]) -> dict[int, Place]:
    """Return modes that the criterion takes for one line alone, each with its experiment and the line."""
    effects = _effects(fit.projection, channels)
    lines = [int(data.observed.sum()) for data in channels]
    places = {}
    for l in np.flatnonzero(fit.projection.p.imag > 0).tolist():
        k = int(np.argmax([part[l].max() for part in effects]))
        others = sum(float(part[l].sum()) for part in effects) - float(effects[k][l].max())
        if others < (2 + 2 * len(fit.scales)) * np.log(2 * sum(lines)):
            places[l] = (k, int(np.argmax(effects[k][l])))
    return places


def _effects(projection: FreeProjection, channels: Sequence[ResponseMatrix]) -> list[Array]:
    """Return the square of what each mode adds to each line of each experiment, all entries together."""
    effects = [np.zeros((len(projection.p), data.samples)) for data in channels]
    for rows in projection.experiments:
        assert isinstance(rows, FreeResponse)
        ahead, behind = rows.peaks(projection.p)[:2]
        for output in rows.outputs.tolist():
            r = projection.residues[:, output, 0][:, None]
            size = np.abs((r * ahead + r.conj() * behind) * rows.weight) ** 2
            effects[rows.experiment][:, rows.observed] += size
    return effects


def _is_likelier_without(whole: FreeFit, calm: FreeFit, lines: Sequence[Indices]) -> bool:
    """Return whether the BIC prefers values of their own at some lines to a fit to all."""
    return whole.criteria.bic > calm.criteria.bic + _cost_of_lines(whole, lines)


def _leaving_out(calm: FreeFit, lines: Sequence[Indices]) -> FreeFit:
    """Return the fit without some lines, with the finding that says so."""
    wild = [
        Finding(Cause.WILD_LINES, tuple(data.omega[places].tolist()), 0.0, experiment=k)
        for k, (data, places) in enumerate(zip(calm.channels, lines, strict=True)) if len(places)
    ]  # fmt: skip
    return replace(calm, findings=(*calm.findings, *wild))


def _cost_of_lines(whole: FreeFit, lines: Sequence[Indices]) -> float:
    """Return what it costs by the BIC to take the values at some lines as they are, in the noise of a fit to all lines.

    Two numbers for each value, and one at 0, where responses are real.
    """
    count, cost = 2 * sum(int(channel.observed.sum()) for channel in whole.channels), 0.0
    for channel, places in zip(whole.channels, lines, strict=True):
        variances = (whole.scales**2)[:, None] / _relative_weights(channel)[:, places]
        numbers = np.where(channel.omega[places] == 0, 1, 2) * np.log(count)
        cost += float(np.sum(2 * np.log(2 * np.pi * variances) + numbers))
    return cost

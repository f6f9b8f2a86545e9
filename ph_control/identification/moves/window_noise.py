"""The errors of responses that were estimated with a window: before a model is known, and by the model.

Blocks of a record begin in motion, so that the errors of an estimated response are largest at its resonances, and those
of neighbouring lines are correlated.  All follows from the modes and from the ratio of the noise of each output to the
input, which is estimated from what the modes leave, as the likelihood of the residuals with their own degrees of
freedom has it.  The law times the number of blocks is that of one: without this number the few lines about resonances
have to tell how large the errors there are, which they do poorly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize_scalar

from ..._types import Array, ComplexArray, Indices
from ...analysis.spectral_window import SpectralWindow
from ..data.channels import ResponseMatrix
from ..data.frequency_record import BandedFactor, LineErrors
from ..data.windowed import WindowErrors, error_bands
from ..regression.free import by_poles
from ..regression.frequency_rows import FreeResponse
from ..regression.spectral_rows import real_rows
from ..search.fitted_modes import FreeFit
from .assumptions import Search
from .gain_noise import ROUNDS, Refits

_CURVED = 0.1  # of the second differences of a response: errors of its peaks before they are known
_RIDGE = 1e-12  # of unit columns that may be alike
_LEAST = 1e-12  # of the largest motion: what of it is rounding
_SAME_ERRORS = 0.02  # relative change of the variances of lines
_ALL = 0.01  # noise beside motion, or motion beside noise, that does not count


def in_noise_of_the_window(fit: FreeFit, search: Search) -> FreeFit:
    """Repeat a fit to responses estimated with a window with the errors of its own model, until both agree."""
    refits = Refits(fit, search)
    near, known = fit, False
    while True:
        for _ in range(ROUNDS):
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
        slopes = by_poles(derivatives, plain, projection.own[k][:, 0], projection.residues[:, entry])
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

"""Residuals of one or several records, the input, and the directions in which a model was fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ..._checks import EPS
from ..._types import Array, Indices, Mask
from ..regression.triangular import triangle

RANK = 1e-8  # relative size of directions that a regression counts

_REACH = 6.0  # times the median size, 4 standard deviations of normal noise
_QUIETEST = 1e-6  # noise of a record beside that of the loudest
_CACHED = 1 << 17  # numbers that fit in the cache


@dataclass(frozen=True)
class ResidualData:
    """Residuals (T,), NaN where missing, the input, and the directions that were fitted (T, k).

    With several records, one after the other, `lengths` are their samples, and `local` the directions (T_k, p_k) that
    were fitted to each of them alone.  `level` is what a constant looks like, where the residuals are in a scale of
    their own.  `past` is the number of coefficients of their own past that were fitted.
    """

    residuals: Array
    u: Array
    directions: Array
    lags: int
    lengths: tuple[int, ...] = ()
    local: tuple[Array, ...] = ()
    level: Array | None = None
    past: int = 0

    @cached_property
    def parts(self) -> list[slice]:
        """Where each record lies."""
        ends = np.cumsum(self.lengths or (len(self.residuals),)).tolist()
        return [slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True)]

    @cached_property
    def seen(self) -> Mask:
        """Where there is a residual."""
        return ~np.isnan(self.residuals)

    @cached_property
    def e(self) -> Array:
        """Residuals, 0 where missing."""
        return np.where(self.seen, self.residuals, 0.0)

    @cached_property
    def constant(self) -> Array:
        """A constant in the scale of the residuals."""
        return np.ones(len(self.residuals)) if self.level is None else self.level

    @cached_property
    def count(self) -> int:
        """Number of residuals N."""
        return int(self.seen.sum())

    @cached_property
    def power(self) -> float:
        """Sum of their squares."""
        return float(self.e @ self.e)

    @cached_property
    def centred(self) -> Array:
        """Residuals less the mean of their record, 0 where missing."""
        residuals = self.e.copy()
        for part in self.parts:
            residuals[part] -= residuals[part].sum() / max(1, int(self.seen[part].sum()))
        return np.where(self.seen, residuals, 0.0)

    @cached_property
    def v(self) -> Array:
        """Input less its mean over the record; 0 where it only rounds about that."""
        centred_input = np.zeros(len(self.u))
        for part in self.parts:
            u = self.u[part]
            v = u - u.mean()
            if np.max(np.abs(v)) > len(v) * EPS * np.max(np.abs(u)):
                centred_input[part] = v
        return centred_input

    @cached_property
    def own(self) -> list[Array]:
        """Directions that were fitted to each record alone."""
        return list(self.local) or [np.zeros((part.stop - part.start, 0)) for part in self.parts]

    @cached_property
    def fitted(self) -> Basis:
        """Orthonormal basis of the directions over the observed samples."""
        return _basis(self, self.own)

    @cached_property
    def fitted_and_means(self) -> Basis:
        """The same with a constant in each record."""
        pairs = zip(self.parts, self.own, strict=True)
        return _basis(self, [np.column_stack([self.constant[part], columns]) for part, columns in pairs])

    @cached_property
    def noise_covariance(self) -> Array:
        """Autocovariance of the noise, tapered so that its spectrum is positive."""
        T, longest = len(self.e), max(part.stop - part.start for part in self.parts)
        reach = min(longest - 1, max(self.lags, int(4 * np.sqrt(T))))
        m = np.arange(reach + 1)
        covariance, pairs, all_pairs = np.zeros((3, reach + 1))
        for part in self.parts:
            samples = part.stop - part.start
            size = next_fast_len(samples + reach + 1, real=True)
            covariance += irfft(np.abs(rfft(self.centred[part], size)) ** 2, size)[: reach + 1]
            pairs += irfft(np.abs(rfft(self.seen[part].astype(float), size)) ** 2, size)[: reach + 1]
            all_pairs += np.maximum(samples - m, 0)
        # averaged over the pairs there are, and tapered as full records would be
        covariance = np.where(pairs > 0.5, covariance / np.maximum(pairs, 1.0), 0.0) * all_pairs / T
        free = max(1, self.count - self.fitted.size - len(self.parts))
        return np.asarray(covariance * (self.count / free) * _parzen(m / (reach + 1)))

    def shifted_inputs(self, part: slice, lags: Indices, rows: Indices | None = None) -> Array:
        """Row j holds the inputs `lags[j]` samples before the residuals of a record, or some of them; 0 if unknown."""
        v = self.v[part]
        L = int(np.max(np.abs(lags)))
        padded = np.concatenate([np.zeros(L), v, np.zeros(L)])
        view = np.lib.stride_tricks.sliding_window_view(padded, len(v))
        return np.asarray(view[L - lags] if rows is None else view[(L - lags)[:, None], rows])


def noise_scales(residuals: Sequence[Array]) -> list[float]:
    """Root mean square of the residuals of each of several records: sensors and levels of noise may differ.

    None is taken as smaller than a millionth of the largest, nor a single record in other than its own unit.
    """
    seen = [~np.isnan(residual) for residual in residuals]
    return scales_of_noise(
        [float(np.sum(residual**2, where=kept)) for residual, kept in zip(residuals, seen, strict=True)],
        [int(kept.sum()) for kept in seen],
    )


def scales_of_noise(powers: Sequence[float], counts: Sequence[int]) -> list[float]:
    """The same of sums of squares and numbers of residuals."""
    if len(powers) == 1:
        return [1.0]
    sizes = [float(np.sqrt(power / max(1, count))) for power, count in zip(powers, counts, strict=True)]
    largest = max(sizes) or 1.0
    return [max(size, _QUIETEST * largest) for size in sizes]


@dataclass(frozen=True)
class Basis:
    """Orthonormal directions: some in one record alone, (T_k, p_k) each, others through all of them, (T, s)."""

    local: list[Array]
    shared: Array

    @property
    def size(self) -> int:
        """Number of directions."""
        return self.shared.shape[1] + sum(columns.shape[1] for columns in self.local)


def _basis(data: ResidualData, local: list[Array]) -> Basis:
    own = [
        orthonormal_of_unit(_unit(columns * data.seen[part, None]))
        for part, columns in zip(data.parts, local, strict=True)
    ]
    unit = _unit(data.directions * data.seen[:, None])
    for _ in range(2):  # once more for what rounding leaves
        for part, columns in zip(data.parts, own, strict=True):
            if columns.shape[1] and unit.shape[1]:
                unit[part] -= columns @ (columns.T @ unit[part])
    return Basis(own, orthonormal_of_unit(unit))


def _parzen(x: Array) -> Array:
    """Window whose transform is positive."""
    return np.where(x < 0.5, 1 - 6 * x**2 * (1 - x), 2 * (1 - x) ** 3)


# --- orthonormal bases -----------------------------------------------------------------------------------------------


def _unit(columns: Array) -> Array:
    """Columns brought to unit length, those that are 0 left out; a copy."""
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    return np.asarray(columns[:, lengths > 0] / lengths[lengths > 0])


def orthonormal_of_unit(columns: Array) -> Array:
    """Orthonormal basis of columns that had unit length before something was taken off."""
    for _ in range(2):  # of columns that are nearly dependent the first basis is orthonormal to half the digits only
        _, sigma, turn = np.linalg.svd(factor_of(columns.T))
        kept = sigma > RANK
        columns = columns @ (turn[kept].T / sigma[kept])
    return np.asarray(columns)


def factor_of(columns: Array) -> Array:
    """Triangular factor of columns given as rows (p, m), made by blocks that fit in the cache."""
    count, samples = columns.shape
    width = max(1024, _CACHED // max(1, count))
    if not columns.size:
        return np.zeros((count, count))
    return triangle(lambda: iter([columns[:, first : first + width] for first in range(0, samples, width)]), samples)


def without_peaks(residuals: Array) -> Array:
    """Residuals in frequency, cut off where they are much larger than most.

    Of white noise this touches one point in 20 000; of a missed resonance, a few points that would outweigh all others,
    it leaves the flanks to be seen.
    """
    limit = _REACH * float(np.nanmedian(np.abs(residuals)))
    return np.clip(residuals, -limit, limit) if limit else residuals

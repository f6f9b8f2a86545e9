"""Statistics of residuals: correlations with their bands, and tests that are right for short records too.

Residuals of a fit are what the noise leaves beside the directions that were fitted, `e = (I - Q Q^T) noise`.  The
moments below are those of `e` for white noise and orthonormal `Q`, over the samples that were observed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f, norm

from .._checks import EPS

Array = NDArray[np.float64]

_RANK = 1e-8  # relative size of directions that a regression counts
_NOISE_ORDERS = 20  # most that are tried for the noise
_ROWS_PER_ORDER = 10
_FEWEST = 5  # degrees of freedom below which a test says nothing


@dataclass(frozen=True)
class ResidualData:
    """Residuals (T,), NaN where missing, the input, and the directions that were fitted (T, k)."""

    residuals: Array
    u: Array
    directions: Array
    lags: int

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Where there is a residual."""
        return ~np.isnan(self.residuals)

    @cached_property
    def e(self) -> Array:
        """Residuals, 0 where missing."""
        return np.where(self.seen, self.residuals, 0.0)

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
        """Residuals less their mean, 0 where missing."""
        return np.where(self.seen, self.e - self.e.sum() / max(1, self.count), 0.0)

    @cached_property
    def v(self) -> Array:
        """Input less its mean; 0 where it only rounds about that."""
        v = self.u - self.u.mean()
        return np.where(np.max(np.abs(v)) <= len(v) * EPS * np.max(np.abs(self.u)), 0.0, v)

    @cached_property
    def fitted(self) -> Array:
        """Orthonormal basis of the directions over the observed samples, shape (T, p), 0 where missing."""
        return _orthonormal(self.directions * self.seen[:, None])

    @cached_property
    def shifted_inputs(self) -> Array:
        """Column tau + L holds the input tau samples before each residual, shape (T, 2L + 1); 0 where unknown."""
        L, T = self.lags, len(self.v)
        padded = np.concatenate([np.zeros(L), self.v, np.zeros(L)])
        return np.lib.stride_tricks.sliding_window_view(padded, T)[::-1].T


@dataclass(frozen=True)
class Correlation:
    """Correlation at some lags, half the width of its band, and the number of pairs behind each; NaN without pairs."""

    lags: NDArray[np.intp]
    values: Array
    band: Array
    pairs: NDArray[np.intp]

    @property
    def outside(self) -> int:
        """Number of lags at which the correlation leaves its band."""
        return int(np.sum(np.abs(self.values) > self.band))

    @property
    def expected(self) -> int:
        """Number of lags that have a correlation."""
        return int(np.isfinite(self.values).sum())


def autocorrelation(data: ResidualData, confidence: float) -> tuple[Correlation, float, float]:
    """Autocorrelation at lags 1 to L less its mean for white noise; the Ljung-Box statistic and its p-value.

    With all samples and nothing fitted the statistic is the classical one: then the mean is 0 and the variance of the
    correlation `(T - k)/(T (T + 2))`.
    """
    lags = np.arange(1, data.lags + 1)
    pairs = np.array([np.sum(data.seen[k:] & data.seen[:-k]) for k in lags])
    if data.power == 0:
        return Correlation(lags, np.zeros(len(lags)), np.full(len(lags), np.inf), pairs), 0.0, 1.0
    found = np.array([data.e[k:] @ data.e[:-k] for k in lags]) / data.power
    mean, variance = np.array([_moments(data, int(k), int(n)) for k, n in zip(lags, pairs, strict=True)]).T
    usable = (pairs > 0) & (variance > 0)
    variance = np.where(usable, variance, np.nan)
    statistic = float(np.nansum((found - mean) ** 2 / variance))
    per_pair = data.count / np.where(usable, pairs, 1)
    values = np.where(usable, (found - mean) * per_pair, np.nan)
    band = norm.isf(0.5 * (1 - confidence)) * np.sqrt(variance) * per_pair
    p_value = float(chi2.sf(statistic, int(usable.sum()))) if usable.any() else np.nan
    return Correlation(lags, values, band, pairs), statistic, p_value


def _moments(data: ResidualData, lag: int, pairs: int) -> tuple[float, float]:
    """Mean and variance of `e^T S e / e^T e` for white noise: moments of a ratio of quadratic forms."""
    Q = data.fitted
    free = data.count - Q.shape[1]
    if free < 1:
        return 0.0, 0.0
    # S: half the sum of the shifts to either side, between observed samples
    SQ = np.zeros_like(Q)
    SQ[lag:] += 0.5 * Q[:-lag]
    SQ[:-lag] += 0.5 * Q[lag:]
    SQ *= data.seen[:, None]
    within = Q.T @ SQ
    trace = -float(np.trace(within))
    square = 0.5 * pairs - 2.0 * float(np.sum(SQ**2)) + float(np.sum(within**2))
    mean = trace / free
    return mean, (trace**2 + 2.0 * square) / (free * (free + 2)) - mean**2


def cross_correlation(data: ResidualData, confidence: float) -> Correlation:
    """Correlation of residuals with the input tau samples before, tau from -L to L.

    The band is that of residuals of any colour that know nothing of the input: the variance of `sum_k e_k v_{k-tau}` is
    `sum_m c_e(m) c_v(m)`, `c_e` estimated with a Parzen window.
    """
    lags = np.arange(-data.lags, data.lags + 1)
    X = data.shifted_inputs
    inside = np.lib.stride_tricks.sliding_window_view(
        np.pad(np.ones(len(data.v)), data.lags), len(data.v)
    )[::-1].T  # fmt: skip
    pairs = np.rint(data.seen.astype(float) @ inside).astype(int)
    sizes = np.sqrt(np.sum(data.centred**2) / max(1, data.count) * np.mean(data.v**2))
    if sizes == 0:
        return Correlation(lags, np.zeros(len(lags)), np.full(len(lags), np.inf), pairs)
    Q = _orthonormal(np.column_stack([data.seen, data.directions * data.seen[:, None]]))
    spectrum, size = _noise_spectrum(data)
    deviation = np.empty(len(lags))
    for column in range(len(lags)):
        x = X[:, column] * data.seen
        x = x - Q @ (Q.T @ x)
        # both sides of the spectrum: all frequencies but the ends count twice
        power = np.abs(np.fft.rfft(x, size)) ** 2 * spectrum
        deviation[column] = np.sqrt(max(0.0, 2 * power.sum() - power[0] - power[-1]) / size)
    usable = pairs > 0
    scale = np.where(usable, pairs, 1) * sizes
    values = np.where(usable, data.centred @ X / scale, np.nan)
    return Correlation(lags, values, norm.isf(0.5 * (1 - confidence)) * deviation / scale, pairs)


def _noise_spectrum(data: ResidualData) -> tuple[Array, int]:
    """Spectrum of the residuals at the frequencies of a padded transform of even size, and that size."""
    T = len(data.e)
    reach = min(T - 1, max(data.lags, int(4 * np.sqrt(T))))
    size = 2 * T
    covariance = np.fft.irfft(np.abs(np.fft.rfft(data.centred, size)) ** 2, size)[: reach + 1]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(data.seen, size)) ** 2, size)[: reach + 1]
    m = np.arange(reach + 1)
    # averaged over the pairs there are, and tapered as a full record would be
    covariance = np.where(pairs > 0.5, covariance / np.maximum(pairs, 1.0), 0.0) * (1 - m / T)
    free = max(1, data.count - data.fitted.shape[1] - 1)
    covariance *= data.count / free * _parzen(m / (reach + 1))
    sequence = np.zeros(size)
    sequence[: reach + 1] = covariance
    sequence[-reach:] = covariance[:0:-1]
    return np.maximum(np.fft.rfft(sequence).real, 0.0), size


def _parzen(x: Array) -> Array:
    """Window whose transform is positive."""
    return np.where(x < 0.5, 1 - 6 * x**2 * (1 - x), 2 * (1 - x) ** 3)


@dataclass(frozen=True)
class Influence:
    """p-values of what the residuals depend on; NaN where the record cannot tell."""

    offset: float
    response: float
    feedback: float
    noise_order: int


def influence(data: ResidualData) -> Influence:
    """Regress the residuals on a constant, on the inputs at and before them, and then on those after them.

    Each is an F test beside what was fitted and what came before in this list, exact for white Gaussian noise.  For
    coloured residuals their own past stands first, as many samples as BIC chooses: a response that is long because it
    resonates then shows in what is new in each sample.
    """
    if data.power == 0:
        return Influence(np.nan, np.nan, np.nan, 0)
    whitening = _whitening(data)
    order = len(whitening) - 1
    rows = _with_past(data, order)
    past = data.e[np.flatnonzero(rows)[:, None] - np.arange(1, order + 1)]
    directions = _filtered(whitening, data.directions)[rows]
    X, L = data.shifted_inputs, data.lags
    steps = (np.ones((len(past), 1)), X[rows, L:], X[rows, :L])
    offset, response, feedback = _successive_tests(data.e[rows], np.concatenate([directions, past], axis=1), steps)
    return Influence(offset, response, feedback, order)


def _filtered(weights: Array, columns: Array) -> Array:
    """Moving average of each column, zeros before its start."""
    out = np.zeros_like(columns)
    for shift, weight in enumerate(weights):
        out[shift:] += weight * columns[: len(columns) - shift]
    return out


def _with_past(data: ResidualData, order: int) -> NDArray[np.bool_]:
    """Where a residual and so many before it were observed."""
    rows = np.convolve(data.seen, np.ones(order + 1))[: len(data.e)] > order + 0.5
    return np.asarray(rows)


def _whitening(data: ResidualData) -> Array:
    """Coefficients `(1, -phi_1, ..)` of the autoregression that makes the residuals white, of least BIC."""
    most = _NOISE_ORDERS
    while most:
        rows = _with_past(data, most)
        if rows.sum() >= _ROWS_PER_ORDER * (most + 1):
            break
        most //= 2
    if not most:
        return np.ones(1)
    target = data.e[rows]
    places = np.flatnonzero(rows)
    past = data.e[places[:, None] - np.arange(1, most + 1)]
    Q, R = np.linalg.qr(past)
    explained = Q.T @ target
    left = np.maximum(target @ target - np.cumsum(np.concatenate([[0.0], explained**2])), EPS * (target @ target))
    order = int(np.argmin(len(target) * np.log(left) + np.arange(most + 1) * np.log(len(target))))
    found = np.linalg.lstsq(R[:order, :order], explained[:order], rcond=None)[0]
    return np.concatenate([[1.0], -found])


def _successive_tests(rhs: Array, fitted: Array, steps: tuple[Array, ...]) -> list[float]:
    """p-values of the F tests that each set of columns in turn explains nothing more."""
    basis = _orthonormal(fitted)
    rhs = rhs - basis @ (basis.T @ rhs)
    found = []
    for columns in steps:
        added = _orthonormal(columns, beside=basis)
        gained = added.T @ rhs
        rhs = rhs - added @ gained
        basis = np.concatenate([basis, added], axis=1)
        free, left = len(rhs) - basis.shape[1], float(rhs @ rhs)
        if added.shape[1] == 0 or free < _FEWEST or left == 0:
            found.append(np.nan)
        else:
            ratio = float(gained @ gained) / added.shape[1] / (left / free)
            found.append(float(f.sf(ratio, added.shape[1], free)))
    return found


def _orthonormal(columns: Array, beside: Array | None = None) -> Array:
    """Orthonormal basis of the span of columns, or of what they span beside another orthonormal basis."""
    lengths = np.linalg.norm(columns, axis=0)
    unit = columns[:, lengths > 0] / lengths[lengths > 0]
    if beside is not None:
        for _ in range(2):  # once more for what rounding leaves
            unit = unit - beside @ (beside.T @ unit)
    if unit.shape[1] == 0:
        return np.zeros((len(columns), 0))
    U, sigma, _ = np.linalg.svd(unit, full_matrices=False)
    return np.asarray(U[:, sigma > _RANK])

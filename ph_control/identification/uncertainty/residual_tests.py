"""Statistics of residuals: correlations with their bands, and tests that are right for short records too.

Residuals of a fit are what the noise leaves beside the directions that were fitted, `e = (I - Q Q^T) noise`.  The
moments below are those of `e` for white noise and orthonormal `Q`, over the samples that were observed.  Records stand
one after the other; a correlation never reaches from one into the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.stats import chi2, f, norm

from ..._checks import EPS
from ..._types import Array, Indices, Mask
from ..data.time_record import Signal, blocks, size_of
from ..regression.elimination import eliminate, reduced, triangle
from ..regression.free import FreeProjection
from ..regression.frequency_rows import FreeResponse
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING

_NOISE_ORDERS = 20  # most that are tried for the noise
_ROWS_PER_ORDER = 10
_FEWEST = 5  # degrees of freedom below which a test says nothing
_SAMPLES_PER_LAG = 5
_PIECE = 512  # samples of a few columns that fit in the cache
_ROWS = 1 << 13  # of a regression that are made at a time
_TOGETHER = 1 << 22  # numbers in shifted inputs that are transformed at a time

# residuals and the directions that were fitted
_RANK = 1e-8  # relative size of directions that a regression counts
_REACH = 6.0  # times the median size, 4 standard deviations of normal noise
_QUIETEST = 1e-6  # noise of a record beside that of the loudest
_CACHED = 1 << 17  # numbers that fit in the cache


@dataclass(frozen=True)
class Correlation:
    """Correlation at some lags, half the width of its band, and the number of pairs behind each; NaN without pairs."""

    lags: Indices
    values: Array
    band: Array
    pairs: Indices

    @property
    def outside(self) -> int:
        """Number of lags at which the correlation leaves its band."""
        return int(np.sum(np.abs(self.values) > self.band))

    @property
    def expected(self) -> int:
        """Number of lags that have a correlation."""
        return int(np.isfinite(self.values).sum())


# --- whiteness -------------------------------------------------------------------------------------------------------


def autocorrelation(data: ResidualData, confidence: float) -> tuple[Correlation, float, float]:
    """Autocorrelation at lags 1 to L less its mean for white noise; the Ljung-Box statistic and its p-value.

    With all samples and nothing fitted the statistic is the classical one: then the mean is 0 and the variance of the
    correlation `(T - k)/(T (T + 2))`.  Each coefficient of an autoregression that was fitted takes a degree of freedom
    (Box and Pierce, J. Am. Stat. Assoc. 65, 1970).
    """
    lags = np.arange(1, data.lags + 1)
    pairs = np.zeros(len(lags), int)
    products = np.zeros(len(lags))
    for part in data.parts:
        seen, e = data.seen[part], data.e[part]
        for row, k in enumerate(lags[: max(0, len(e) - 1)]):
            pairs[row] += np.count_nonzero(seen[k:] & seen[:-k])
            products[row] += e[k:] @ e[:-k]
    if data.power == 0:
        return Correlation(lags, np.zeros(len(lags)), np.full(len(lags), np.inf), pairs), 0.0, 1.0
    correlations = products / data.power
    mean, variance = _moments(data, lags, pairs)
    usable = (pairs > 0) & (variance > 0)
    variance = np.where(usable, variance, np.nan)
    statistic = float(np.nansum((correlations - mean) ** 2 / variance))
    per_pair = data.count / np.where(usable, pairs, 1)
    values = np.where(usable, (correlations - mean) * per_pair, np.nan)
    band = norm.isf(0.5 * (1 - confidence)) * np.sqrt(variance) * per_pair
    p_value = float(chi2.sf(statistic, max(1, int(usable.sum()) - data.past))) if usable.any() else np.nan
    return Correlation(lags, values, band, pairs), statistic, p_value


def _moments(data: ResidualData, lags: Indices, pairs: Indices) -> tuple[Array, Array]:
    """Mean and variance of `e^T S e / e^T e` for white noise: moments of a ratio of quadratic forms.

    `S` is half the sum of the shifts to either side, between observed samples.
    """
    free = data.count - data.fitted.size
    if free < 1:
        return np.zeros(len(lags)), np.zeros(len(lags))
    trace, within, image = np.zeros((3, len(lags)))
    shared = data.fitted.shared.shape[1]
    common = np.zeros((len(lags), shared, shared))
    for part, local in zip(data.parts, data.fitted.local, strict=True):
        Q, own = np.concatenate([local, data.fitted.shared[part]], axis=1), local.shape[1]
        if Q.shape[1]:
            products, sizes = _shifted(Q, data.seen[part], lags)
            trace += np.trace(products, axis1=1, axis2=2)
            image += sizes
            # what several records share is squared when all have been added
            within += np.sum(products[:, :, :own] ** 2, axis=(1, 2)) + np.sum(products[:, :own, own:] ** 2, axis=(1, 2))
            common += products[:, own:, own:]
    within += np.sum(common**2, axis=(1, 2))
    square = 0.5 * pairs - 2.0 * image + within
    mean = -trace / free
    return mean, (trace**2 + 2.0 * square) / (free * (free + 2)) - mean**2


def _shifted(Q: Array, seen: Mask, lags: Indices) -> tuple[Array, Array]:
    """`Q^T S Q`, shape (lags, p, p), and the squared size of `S Q`; by pieces that fit in the cache."""
    products, sizes = np.zeros((len(lags), Q.shape[1], Q.shape[1])), np.zeros(len(lags))
    L = int(lags.max())
    padded = np.pad(Q, ((L, L), (0, 0)))
    for first in range(0, len(Q), _PIECE):
        piece = Q[first : first + _PIECE]
        missing = ~seen[first : first + _PIECE]
        for row, k in enumerate(lags):
            before, after = (padded[start : start + len(piece)] for start in (first + L - k, first + L + k))
            both = before + after
            both[missing] = 0.0
            products[row] += piece.T @ both
            sizes[row] += np.vdot(both, both)
    return 0.5 * products, 0.25 * sizes


def is_white(projection: FreeProjection) -> bool:
    """Whether what a model leaves of each output, or entry of a response, may be white noise."""
    outputs: dict[int, list[Array]] = {}
    for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
        if isinstance(rows, FreeResponse):
            residuals = rows.in_rows((rows.response - predicted)[:, rows.observed])
            parts = [[row.real, row.imag] for row in residuals]
        elif isinstance(rows, FreeRecord):
            parts = [[row] for row in rows.residuals(predicted)[:, rows.observed]]
        else:
            continue
        for output, part in zip(rows.outputs.tolist(), parts, strict=True):
            outputs.setdefault(output, []).extend(part)
    return all_white(list(outputs.values()))


def all_white(outputs: Sequence[Sequence[Signal]]) -> bool:
    """Whether none of several outputs, each the residuals of its records, fails the test of whiteness."""
    p_values = [ljung_box(parts, TUNING.lags) for parts in outputs]
    return bool(p_values) and min(p_values) * len(p_values) >= TUNING.white


def ljung_box(
    residuals: Sequence[Signal],
    lags: int,
    *,
    shared: Sequence[Array] | None = None,
    local: Sequence[Array] | None = None,
) -> float:
    """p-value of the Ljung-Box test that residuals of several records, with NaN where missing, are white.

    Each record may have noise of its own variance.

    `shared` (T_k, s) and `local` (T_k, p_k) are the directions in which a model was fitted to each, to all of them and
    to one alone: they are missing from the residuals.  1 where there is too little to tell.
    """
    if shared is None and local is None:
        return _of_noise_alone(residuals, lags)
    given = [np.asarray(residual[:]) for residual in residuals]
    lengths = tuple(len(residual) for residual in given)
    largest = max((size_of(residual) for residual in given), default=0.0)
    scales = noise_scales([residual / (largest or 1.0) for residual in given])
    joined = np.concatenate([np.zeros(0), *(residual / size for residual, size in zip(given, scales, strict=True))])
    count = min(lags, int((~np.isnan(joined)).sum()) // _SAMPLES_PER_LAG, max(lengths, default=0) - 1)
    if count < 1 or largest == 0:
        return 1.0
    directions = np.zeros((len(joined), 0))
    if shared is not None:
        directions = np.concatenate([tangent / size for tangent, size in zip(shared, scales, strict=True)])
    data = ResidualData(
        joined / largest, np.zeros(len(joined)), directions, count, lengths, tuple(local) if local is not None else ()
    )
    p = autocorrelation(data, 0.95)[2]
    return 1.0 if np.isnan(p) else p


def _of_noise_alone(residuals: Sequence[Signal], lags: int) -> float:
    """The p-value with nothing fitted, `N (N + 2) sum rho_k^2 / pairs_k`; block by block."""
    unit = max((size_of(residual[part]) for residual in residuals for part in blocks(len(residual))), default=0.0)
    powers, counts = [], []
    for residual in residuals:
        power, count = 0.0, 0
        for part in blocks(len(residual)):
            values = np.asarray(residual[part]) / (unit or 1.0)
            seen = ~np.isnan(values)
            power, count = power + float(np.sum(values**2, where=seen)), count + int(seen.sum())
        powers.append(power)
        counts.append(count)
    total = sum(counts)
    most = min(lags, total // _SAMPLES_PER_LAG, max(map(len, residuals), default=0) - 1)
    if most < 1 or unit == 0:
        return 1.0
    scales = _scales_of_noise(powers, counts)
    pairs, products, power = np.zeros(most), np.zeros(most), 0.0
    for residual, scale in zip(residuals, scales, strict=True):
        past = np.full(most, np.nan)
        for part in blocks(len(residual)):
            values = np.concatenate([past, np.asarray(residual[part]) / (unit * scale)])
            seen, past = ~np.isnan(values), values[-most:]
            whole, values = bool(seen.all()), np.where(seen, values, 0.0)
            power += float(values[most:] @ values[most:])
            for k in range(1, most + 1):
                products[k - 1] += values[most:] @ values[most - k : -k]
                pairs[k - 1] += len(values) - most if whole else np.count_nonzero(seen[most:] & seen[most - k : -k])
    usable = pairs > 0
    statistic = total * (total + 2) * np.sum((products[usable] / power) ** 2 / pairs[usable])
    return float(chi2.sf(statistic, int(usable.sum()))) if usable.any() else 1.0


# --- correlation with the input --------------------------------------------------------------------------------------


def cross_correlation(data: ResidualData, confidence: float) -> Correlation:
    """Correlation of residuals with the input tau samples before, tau from -L to L.

    The band is that of residuals of any colour that know nothing of the input: the variance of `sum_k e_k v_{k-tau}` is
    `sum_m c_e(m) c_v(m)`, `c_e` estimated with a Parzen window.
    """
    lags = np.arange(-data.lags, data.lags + 1)
    pairs = np.zeros(len(lags), int)
    for part in data.parts:
        known = np.concatenate([[0], np.cumsum(data.seen[part])])
        T = len(known) - 1
        pairs += known[np.clip(T + np.minimum(lags, 0), 0, T)] - known[np.clip(np.maximum(lags, 0), 0, T)]
    sizes = np.sqrt(np.sum(data.centred**2) / max(1, data.count) * np.mean(data.v**2))
    if sizes == 0:
        return Correlation(lags, np.zeros(len(lags)), np.full(len(lags), np.inf), pairs)
    rows = max(1, _TOGETHER // len(data.v))
    products, deviation = np.concatenate(
        [_products(data, lags[first : first + rows]) for first in range(0, len(lags), rows)], axis=1
    )
    usable = pairs > 0
    scale = np.where(usable, pairs, 1) * sizes
    values = np.where(usable, products / scale, np.nan)
    return Correlation(lags, values, norm.isf(0.5 * (1 - confidence)) * deviation / scale, pairs)


def _products(data: ResidualData, lags: Indices) -> Array:
    """Sums of residuals times shifted inputs, and their standard deviations, shape (2, len(lags))."""
    basis = data.fitted_and_means
    inputs = [data.shifted_inputs(part, lags) * data.seen[part] for part in data.parts]
    shared = sum(x @ basis.shared[part] for x, part in zip(inputs, data.parts, strict=True))
    sums, variance = np.zeros((2, len(lags)))
    for x, part, own in zip(inputs, data.parts, basis.local, strict=True):
        sums += x @ data.centred[part]
        x -= (x @ own) @ own.T
        x -= shared @ basis.shared[part].T
        spectrum, size = _noise_spectrum(data, len(data.e[part]))
        # both sides of the spectrum: all frequencies but the ends count twice
        power = np.abs(rfft(x, size, axis=1)) ** 2
        variance += (2 * power @ spectrum - power[:, 0] * spectrum[0] - power[:, -1] * spectrum[-1]) / size
    return np.array([sums, np.sqrt(np.maximum(variance, 0.0))])


def _noise_spectrum(data: ResidualData, samples: int) -> tuple[Array, int]:
    """Spectrum of the residuals at the frequencies of a transform of so many samples, padded to even size."""
    covariance = data.noise_covariance
    reach = len(covariance) - 1
    size = 2 * next_fast_len(-(-(samples + reach + 1) // 2), real=True)
    sequence = np.zeros(size)
    sequence[: reach + 1] = covariance
    sequence[size - reach :] = covariance[:0:-1]
    return np.maximum(rfft(sequence).real, 0.0), size


# --- what the residuals depend on ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Influence:
    """p-values of what the residuals depend on; NaN where the record cannot tell."""

    offset: float
    response: float
    feedback: float
    noise_order: int


def influence(data: ResidualData) -> Influence:
    """Regress the residuals on constants, on the inputs at and before them, and then on those after them.

    Each is an F test beside what was fitted and what came before in this list, exact for white Gaussian noise.  For
    coloured residuals their own past stands first, as many samples as BIC chooses: a response that is long because it
    resonates then shows in what is new in each sample.
    """
    if data.power == 0:
        return Influence(np.nan, np.nan, np.nan, 0)
    whitening = _whitening(data)
    order = len(whitening) - 1
    rows, free, counts = _eliminated(data, whitening)
    ends = np.cumsum(counts)
    steps = [rows[:, start:end] for start, end in pairwise(ends)]
    offset, response, feedback = _successive_tests(rows[:, -1], rows[:, : ends[0]], steps, free)
    return Influence(offset, response, feedback, order)


def _eliminated(data: ResidualData, whitening: Array) -> tuple[Array, int, list[int]]:
    """Regressors of unit length and the residuals, as a few rows, after elimination of what each record fits alone.

    The columns are what was fitted to all and the past of the residuals, a constant in each record, the inputs at and
    before each residual, those after it, and the residual.  With the degrees of freedom that are left, and how many
    columns of each kind there are.
    """
    order, K = len(whitening) - 1, len(data.parts)
    counts = [data.directions.shape[1] + order, K, data.lags + 1, data.lags]
    width = sum(counts) + 1
    factors = [_record_factor(data, place, whitening) for place in range(K)]
    lengths = np.sqrt(sum(np.sum(factor[:, -width:] ** 2, axis=0) for factor, _ in factors))
    lengths[-1] = 1.0  # the residual keeps its size
    scale = 1.0 / np.where(lengths > 0, lengths, 1.0)
    remainders, free = [], sum(samples for _, samples in factors)
    for (factor, _), columns in zip(factors, data.own, strict=True):
        part = eliminate(factor, columns.shape[1], len(columns), _RANK)
        remainders.append(part.below * scale)
        free -= len(part.above)
    rows = np.concatenate(remainders)
    return (reduced(rows) if len(rows) > width else rows), free, counts


def _record_factor(data: ResidualData, place: int, whitening: Array) -> tuple[Array, int]:
    """Triangular factor of all regressors of a record, those fitted to it alone first; and the number of residuals."""
    part, order, L = data.parts[place], len(whitening) - 1, data.lags
    rows = np.flatnonzero(_with_past(data.seen[part], order))
    e = data.e[part]
    fitted = _filtered(whitening, np.concatenate([data.own[place], data.directions[part]], axis=1))
    lags = np.concatenate([np.arange(L + 1), np.arange(-L, 0)])

    def columns(rows: Indices) -> Array:
        means = np.zeros((len(data.parts), len(rows)))
        means[place] = data.constant[part][rows]
        past = e[rows - np.arange(1, order + 1)[:, None]]
        return np.concatenate([fitted[rows].T, past, means, data.shifted_inputs(part, lags, rows), e[None, rows]])

    starts = range(0, max(1, len(rows)), _ROWS)
    return triangle(lambda: (columns(rows[k : k + _ROWS]) for k in starts), len(rows)), len(rows)


def _filtered(weights: Array, columns: Array) -> Array:
    """Moving average of each column, zeros before its start."""
    out = weights[0] * columns
    for shift, weight in enumerate(weights[1:], start=1):
        out[shift:] += weight * columns[:-shift]
    return np.asarray(out)


def _with_past(seen: Mask, order: int) -> Mask:
    """Where a residual and so many before it were observed."""
    return np.asarray(np.convolve(seen, np.ones(order + 1))[: len(seen)] > order + 0.5)


def _whitening(data: ResidualData) -> Array:
    """Coefficients `(1, -phi_1, ..)` of the autoregression that makes the residuals white, of least BIC."""
    most = _NOISE_ORDERS
    while most:
        places = [part.start + np.flatnonzero(_with_past(data.seen[part], most)) for part in data.parts]
        if sum(map(len, places)) >= _ROWS_PER_ORDER * (most + 1):
            break
        most //= 2
    if not most:
        return np.ones(1)
    rows = np.concatenate(places)
    factor = _factor_of(data.e[rows - np.concatenate([np.arange(1, most + 1), [0]])[:, None]])
    R, explained = factor[:-1, :-1], factor[:-1, -1]
    total = float(np.sum(factor[:, -1] ** 2))
    losses = np.maximum(total - np.cumsum(np.concatenate([[0.0], explained**2])), EPS * total)
    order = int(np.argmin(len(rows) * np.log(losses) + np.arange(most + 1) * np.log(len(rows))))
    coefficients = np.linalg.lstsq(R[:order, :order], explained[:order], rcond=None)[0]
    return np.concatenate([[1.0], -coefficients])


def _successive_tests(rhs: Array, fitted: Array, steps: list[Array], free: int) -> list[float]:
    """p-values of the F tests that each set of columns in turn explains nothing more."""
    basis = _orthonormal_of_unit(fitted)
    rhs = rhs - basis @ (basis.T @ rhs)
    free -= basis.shape[1]
    p_values = []
    for columns in steps:
        beside = columns
        for _ in range(2):  # once more for what rounding leaves
            beside = beside - basis @ (basis.T @ beside)
        added = _orthonormal_of_unit(beside)
        gained = added.T @ rhs
        rhs = rhs - added @ gained
        basis = np.concatenate([basis, added], axis=1)
        free -= added.shape[1]
        remainder = float(rhs @ rhs)
        if added.shape[1] == 0 or free < _FEWEST or remainder == 0:
            p_values.append(np.nan)
        else:
            p_values.append(
                float(f.sf(float(gained @ gained) / added.shape[1] / (remainder / free), added.shape[1], free))
            )
    return p_values


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
    return _scales_of_noise(
        [float(np.sum(residual**2, where=kept)) for residual, kept in zip(residuals, seen, strict=True)],
        [int(kept.sum()) for kept in seen],
    )


def _scales_of_noise(powers: Sequence[float], counts: Sequence[int]) -> list[float]:
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
        _orthonormal_of_unit(_unit(columns * data.seen[part, None]))
        for part, columns in zip(data.parts, local, strict=True)
    ]
    unit = _unit(data.directions * data.seen[:, None])
    for _ in range(2):  # once more for what rounding leaves
        for part, columns in zip(data.parts, own, strict=True):
            if columns.shape[1] and unit.shape[1]:
                unit[part] -= columns @ (columns.T @ unit[part])
    return Basis(own, _orthonormal_of_unit(unit))


def _parzen(x: Array) -> Array:
    """Window whose transform is positive."""
    return np.where(x < 0.5, 1 - 6 * x**2 * (1 - x), 2 * (1 - x) ** 3)


# --- orthonormal bases -----------------------------------------------------------------------------------------------


def _unit(columns: Array) -> Array:
    """Columns brought to unit length, those that are 0 left out; a copy."""
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    return np.asarray(columns[:, lengths > 0] / lengths[lengths > 0])


def _orthonormal_of_unit(columns: Array) -> Array:
    """Orthonormal basis of columns that had unit length before something was taken off."""
    for _ in range(2):  # of columns that are nearly dependent the first basis is orthonormal to half the digits only
        _, sigma, turn = np.linalg.svd(_factor_of(columns.T))
        kept = sigma > _RANK
        columns = columns @ (turn[kept].T / sigma[kept])
    return np.asarray(columns)


def _factor_of(columns: Array) -> Array:
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

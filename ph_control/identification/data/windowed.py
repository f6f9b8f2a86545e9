"""Modes in responses that were estimated with a window, and the law of the errors of such responses.

Blocks of a record begin in motion, which the spectra of their own inputs do not explain: near a resonance that motion
is the larger part of what a response is in error by, and it is as long as the mode is.  For a white input both parts,
motion and noise, have a law that depends on the modes and on the ratio of noise and input alone (`error_bands`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..._types import Array, ComplexArray, Indices, RealOrComplex
from ...analysis.spectral_window import SpectralWindow
from ...modal.discretization import Hold
from .frequency_record import BandedFactor, among

_BEYOND = 2  # lines beyond the reach of a window that errors share something with
_LONGEST = 0.02  # lines: half-width of a peak; of longer modes the motion at the beginning of blocks has no bound
_NEAR = 0.1  # of a turn between samples: where a series is more accurate


class Peaks(NamedTuple):
    """What stands for `1 / (s - p)` and `1 / (s - conj p)`, shapes (n, K), and their derivatives by `p`, `conj p`.

    Those of the two themselves are their squares, and need not be there.
    """

    pole_term: ComplexArray
    conjugate_term: ComplexArray
    windowed_slopes: tuple[ComplexArray, ComplexArray] | None = None

    @property
    def slopes(self) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives of both terms."""
        if self.windowed_slopes is not None:
            return self.windowed_slopes
        return np.asarray(self.pole_term**2, complex), np.asarray(self.conjugate_term**2, complex)


def windowed_peaks(window: SpectralWindow, omega: Array, p: ComplexArray) -> Peaks:
    """Modes of unit residue as a window shows them; O(n N log N) at lines, and O(n N K) at any other frequencies."""
    r, k = window.correlation, np.arange(window.length - 1)
    if window.hold == "bandlimited":
        return _bandlimited_peaks(window, omega, p)
    b0, b1, b0_slope, b1_slope = (
        weights[:, None] for weights in Hold(window.step, "exact", window.hold).weights_and_derivatives(p)
    )
    log = p[:, None] * window.step
    powers = np.exp(log * k)  # of the impulse response after a sample or more
    lam = np.exp(log)
    weight, weight_slope = b0 + lam * b1, b0_slope + lam * (b1_slope + window.step * b1)
    windowed_powers = r[1:] * powers
    values = np.concatenate([b1, weight * windowed_powers], axis=1)
    slopes = np.concatenate([b1_slope, (weight_slope + weight * (k * window.step)) * windowed_powers], axis=1)
    terms, term_slopes = (_transforms(samples, window, omega) for samples in (values, slopes))
    hold = window.hold_at(omega)
    return Peaks(terms[0] / hold, terms[1] / hold, (term_slopes[0] / hold, term_slopes[1] / hold))


def _transforms(values: Any, window: SpectralWindow, omega: Array) -> tuple[Any, Any]:
    """Transforms (n, K) of impulse responses (n, N), and those of their conjugates."""
    if window.has_lines(omega):
        lines, transform = window.lines(omega), np.fft.fft(values)
        return transform[:, lines], transform[:, -lines].conj()
    phasors = np.exp(-1j * window.step * np.multiply.outer(np.arange(window.length), omega))
    return values @ phasors, values.conj() @ phasors


def _bandlimited_peaks(window: SpectralWindow, omega: Array, p: ComplexArray) -> Peaks:
    """The same for inputs without content beyond the Nyquist frequency: integrals in place of sums.

    What sums fold back from beyond it is that of peaks without a window, as it is far from them.
    """
    h, r, k = window.step, window.correlation, np.arange(window.length)
    decay = h * r * np.exp(p[:, None] * h * k)
    decay[:, 0] *= 0.5
    values, slopes = (_transforms(samples, window, omega) for samples in (decay, decay * (k * h)))
    s = 1j * omega
    aliasing = [_aliasing(pole[:, None] - s, h) for pole in (p, p.conj())]
    term_slopes = slopes[0] + aliasing[0][1], slopes[1] + aliasing[1][1]
    return Peaks(values[0] + aliasing[0][0], values[1] + aliasing[1][0], term_slopes)


def _aliasing(q: ComplexArray, h: float) -> tuple[ComplexArray, ComplexArray]:
    """Integral less trapezoidal sum of `exp(q t)` for t > 0, and its derivative: `-1/q + h/2 coth(q h/2)`."""
    x = 0.5 * h * q
    is_small = np.abs(x) < _NEAR * np.pi
    small, large = np.where(is_small, x, 0.0), np.where(is_small, 1.0, x)
    series = small / 3 - small**3 / 45 + 2 * small**5 / 945 - small**7 / 4725 + 2 * small**9 / 93555
    slope = 1 / 3 - small**2 / 15 + 2 * small**4 / 189 - small**6 / 675 + 2 * small**8 / 10395
    exact = 1 / np.tanh(large) - 1 / large
    exact_slope = 1 / large**2 - 1 / np.sinh(large) ** 2
    value, derivative = np.where(is_small, series, exact), np.where(is_small, slope, exact_slope)
    return np.asarray(0.5 * h * value, complex), np.asarray(0.25 * h**2 * derivative, complex)


def windowed_response(
    window: SpectralWindow, omega: Array, p: ComplexArray, residues: ComplexArray, feedthrough: Array
) -> ComplexArray:
    """Response (q, m, K) as a window shows it, of residues (n, q, m), those of real poles halved, and (q, m)."""
    peaks = windowed_peaks(window, omega, p)
    modes = np.einsum("lqi,lk->qik", residues, peaks.pole_term) + np.einsum(
        "lqi,lk->qik", residues.conj(), peaks.conjugate_term
    )
    return np.asarray(modes + feedthrough[..., None] / window.hold_at(omega))


# --- the law of the errors --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class WindowErrors:
    """Moments of the errors of estimated responses, times the number of blocks, at all lines of a band.

    Of q outputs and m inputs.  Entry d of each array is that of the lines `k + d` and `k`, for `k` in a run of lines.

    Attributes
    ----------
    first : int
        Number of the first line.
    noise : ndarray of complex, shape (b + 1, K)
        Covariance that white noise at an output leaves, of the variance of an input.
    motion : ndarray of complex, shape (q, q, b + 1, K)
        Covariance by what outputs still do from before a block, where all inputs have variance 1, for any one input.
    cross_factors : ndarray of complex, shape (2, q, m, s, b + 1, K)
        Factors of the moments without conjugate: those of entries (a, i) and (b, j) are
        `cross_factors[0, a, j] cross_factors[1, b, i]`, summed over a block and the s that overlap it.
    """

    first: int
    noise: ComplexArray
    motion: ComplexArray
    cross_factors: ComplexArray

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return self.cross_factors.shape[2]

    def covariance(self, lines: Indices, outputs: tuple[int, int], noise: float) -> ComplexArray:
        """Diagonals of the covariance at some lines in ascending order, for this ratio of the variances."""
        first, second = outputs
        return among(self.motion[first, second] + noise * self.noise * (first == second), lines - self.first)

    def relation(self, lines: Indices, entry: tuple[int, int], other: tuple[int, int]) -> ComplexArray:
        """Diagonals of the moments without conjugate of two entries, (output, input), at some lines."""
        return among(self.band_relation(entry, other), lines - self.first)

    def band_relation(self, entry: tuple[int, int], other: tuple[int, int]) -> ComplexArray:
        """Diagonals of the same moments at all lines of the band."""
        (a, i), (b, j) = entry, other
        return np.asarray(np.sum(self.cross_factors[0, a, j] * self.cross_factors[1, b, i], axis=0))


def error_bands(
    window: SpectralWindow, lines: Indices, p: ComplexArray, residues: ComplexArray, feedthrough: Array
) -> WindowErrors:
    """Moments of errors of responses of a plant, by its `residues` (n, q, m) and what is fed through (q, m).

    Of unit inputs `u` the block at k has the transforms U and Y = H U + R, where H is the mean of the estimate and R,
    which is not correlated with U at this line, is noise and the response to what was before.  So the error is that of
    `R conj(U)`, with the covariance `E[R_k R_l*] E[U_k* U_l]` and, as R is correlated with U at other lines, the moment
    `E[R_k U_l*] E[R_l U_k*]`, summed over a block and those that overlap it.
    O(q^2 m N log N) for each of the few lines within which transforms of a window are correlated.
    """
    N, first, last = window.length, int(lines.min()), int(lines.max())
    band = np.arange(first, last + 1)
    m = np.arange(-(N - 1.0), N)
    plant = _SampledPlant.of(window, p, residues, feedthrough)
    hold = window.hold_at(np.asarray(band * window.line))
    power, width = window.overlaps(0)[N - 1].real, min(window.reach + 1 + _BEYOND, len(band))
    shifts = [0, *(sign * shift for shift in range(window.shift, N, window.shift) for sign in (1, -1))]
    q, inputs = feedthrough.shape
    noise = np.zeros((width, len(band)), complex)
    motion = np.zeros((q, q, width, len(band)), complex)
    cross_factors = np.zeros((2, q, inputs, len(shifts), width, len(band)), complex)
    H = np.fft.fft(plant.impulse_response(np.arange(float(N))) * window.correlation)  # (q, m, N)
    for d in range(width):
        overlaps, later = window.overlaps(-d), (band + d) % N  # between lines k + d and k
        H_later, H_here = H[..., later], H[..., band].conj()
        for place, shift in enumerate(shifts):

            def transform(values: RealOrComplex, overlaps: ComplexArray = overlaps, later: Indices = later) -> Any:
                folded = np.zeros((*values.shape[:-1], N), complex)
                products = values * overlaps
                folded[..., 1:], folded[..., 0] = products[..., : N - 1] + products[..., N:], products[..., N - 1]
                return np.fft.fft(folded)[..., later]

            UU = transform((m == shift).astype(float))
            RU = transform(plant.impulse_response(m - shift)) - H_later * UU  # (q, m, K)
            UR = transform(plant.impulse_response(shift - m)) - H_here * UU
            YY = transform(plant.correlations(m - shift))
            RR = (
                YY
                - np.einsum("aik,bik->abk", H_later, UR)
                - np.einsum("aik,bik->abk", RU, H_here)
                - np.einsum("aik,bik->abk", H_later, H_here) * UU
            )
            motion[:, :, d] += RR * UU.conj() / power**2
            noise[d] += np.abs(UU) ** 2 / power**2
            cross_factors[0, :, :, place, d], cross_factors[1, :, :, place, d] = RU / power, UR.conj() / power
        count = len(band) - d
        noise[d, :count] /= hold[d:] * hold[:count].conj()
        motion[:, :, d, :count] /= hold[d:] * hold[:count].conj()
        cross_factors[0, ..., d, :count] /= hold[d:] * hold[:count]
    return WindowErrors(first, noise, motion, cross_factors)


@dataclass(frozen=True)
class _SampledPlant:
    """Impulse response of a plant at samples: `feedthrough` (q, m), then `sum weights multipliers^(k - 1)`."""

    feedthrough: Array
    weights: ComplexArray  # (2n, q, m)
    multipliers: ComplexArray  # (2n,)

    @classmethod
    def of(cls, window: SpectralWindow, p: ComplexArray, residues: ComplexArray, feedthrough: Array) -> _SampledPlant:
        # motion that never ends would have no bound
        p = np.minimum(p.real, -_LONGEST * window.line) + 1j * p.imag
        hold = "zoh" if window.hold == "bandlimited" else window.hold
        b0, b1 = Hold(window.step, "exact", hold).weights(p)
        lam = np.exp(p * window.step)
        weights = residues * (b0 + lam * b1)[:, None, None]
        direct = feedthrough + 2 * np.einsum("l,lqi->qi", b1, residues).real
        return cls(direct, np.concatenate([weights, weights.conj()]), np.concatenate([lam, lam.conj()]))

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.feedthrough)

    def _powers(self, k: Array) -> ComplexArray:
        return np.asarray(np.exp(np.log(self.multipliers)[:, None] * np.maximum(k, 0)))

    def impulse_response(self, k: Array) -> Array:
        """Impulse responses (q, m, len(k)) after so many samples."""
        later = np.einsum("lqi,lk->qik", self.weights, self._powers(k - 1)).real
        return np.asarray(np.where(k > 0, later, np.where(k == 0, self.feedthrough[..., None], 0.0)))

    def correlations(self, k: Array) -> Array:
        """Correlations `E[y_a(t + k) y_b(t)]` (q, q, len(k)) for white inputs of variance 1."""
        sums = 1.0 / (1.0 - np.multiply.outer(self.multipliers, self.multipliers))
        shapes = np.einsum("lai,lr,rbi->lab", self.weights, sums, self.weights)
        # that of the feedthrough with later samples, after one or more
        shapes_later = shapes * self.multipliers[:, None, None] + np.einsum(
            "lai,bi->lab", self.weights, self.feedthrough
        )
        positive_lags = np.einsum("lab,lk->abk", shapes_later, self._powers(np.abs(k) - 1)).real
        zero_lag = (shapes.sum(axis=0).real + self.feedthrough @ self.feedthrough.T)[..., None]
        return np.asarray(np.where(k == 0, zero_lag, np.where(k > 0, positive_lags, np.swapaxes(positive_lags, 0, 1))))


# --- what entries have in common ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """What the errors of an entry (output, input) have in common with those of others, by the `law` of all.

    Outputs show the same motion from before a block, and what they say of a mode must not count twice.  Rows of each
    entry are white, and entries are eliminated one by one; what they share enters covariances and tests afterwards.
    """

    law: WindowErrors
    entry: tuple[int, int]
    noise: float
    lines: Indices
    factor: BandedFactor  # of the errors of this entry, by the law

    @classmethod
    def of(cls, law: WindowErrors, entry: tuple[int, int], noise: float, lines: Indices) -> SharedErrors:
        """That of an entry at some lines, of an output with such noise."""
        covariance = law.covariance(lines, (entry[0],) * 2, noise)
        return cls(law, entry, noise, lines, BandedFactor.of(covariance, law.relation(lines, entry, entry)))

    def times(self, other: SharedErrors, rows: Array) -> Array:
        """Covariance of the errors of this entry in its rows with those of another, times some of its rows (2 K, k)."""
        real, imaginary = np.split(other.factor.turned_back(rows), 2)
        values = np.zeros((self.law.noise.shape[1], rows.shape[1]), complex)
        values[other.lines - self.law.first] = real + 1j * imaginary
        (a, i), (b, j) = self.entry, other.entry
        relation, transposed_relation = (
            self.law.band_relation(self.entry, other.entry),
            self.law.band_relation(other.entry, self.entry),
        )
        products = _banded(relation, transposed_relation, values.conj())
        if i == j:
            products = products + _banded(self.law.motion[a, b], self.law.motion[b, a].conj(), values)
        covariance = 0.5 * products[self.lines - self.law.first]
        white = self.factor.whitened(covariance.T).T
        return np.concatenate([white.real, white.imag])


def _banded(ahead: ComplexArray, behind: ComplexArray, values: ComplexArray) -> ComplexArray:
    """Product of a banded matrix with columns: entries (k + d, k) of it are `ahead`, (k, k + d) `behind`."""
    product = ahead[0][:, None] * values
    for d in range(1, len(ahead)):
        product[d:] += ahead[d, :-d, None] * values[:-d]
        product[:-d] += behind[d, :-d, None] * values[d:]
    return product


def have_shared_errors(experiments: Sequence[Any]) -> bool:
    """Whether rows of several entries have errors in common."""
    return sum(getattr(rows, "shared_errors", None) is not None for rows in experiments) > 1


def shared_score_covariance(experiments: Sequence[Any], jacobians: Mapping[int, Array]) -> Array:
    """Covariance of `sum J^T e` over the rows of all experiments beyond `sum J^T J`, by what entries share.

    `jacobians[k]` (2 K, unknowns) is that of the rows of experiment k, whose own unknowns have been eliminated.
    """
    members = [k for k in jacobians if getattr(experiments[k], "shared_errors", None) is not None]
    size = next(iter(jacobians.values())).shape[1]
    scores = np.zeros((size, size))
    for place, k in enumerate(members):
        for l in members[:place]:
            first, second = experiments[k].shared_errors, experiments[l].shared_errors
            if first.law is second.law:
                cross = jacobians[k].T @ first.times(second, jacobians[l])
                scores += cross + cross.T
    return scores

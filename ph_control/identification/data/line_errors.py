"""Correlated errors of the lines of a frequency response, and rows in which they are white."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

from ..._types import Array, ComplexArray, Indices, Mask

_RIDGES = 1e-9, 1e-6, 1e-3  # of the variances: what keeps nearly singular correlations positive


@dataclass(frozen=True, eq=False)
class LineErrors:
    """Second moments of the errors `e` of responses estimated with a window, but for one factor of each entry.

    Attributes
    ----------
    covariances, relations : ndarray of complex, shape (p, m, b + 1, K)
        Entry d of each entry of the response is `E[e_(k + d) conj(e_k)]`, or `E[e_(k + d) e_k]`, at points k.
    noise_ratio : ndarray, shape (p,)
        Variance of white noise at each output over that of an input.
    """

    covariances: ComplexArray
    relations: ComplexArray
    noise_ratio: Array
    law: Any = field(default=None, init=False, repr=False)  # of all entries together, where a fit has just made it

    def factor(self, output: int, input: int, observed: Mask) -> BandedFactor:
        """That of the errors of an entry where it was observed (K,)."""
        places = np.flatnonzero(observed)
        return BandedFactor.of(
            among(self.covariances[output, input], places), among(self.relations[output, input], places)
        )

    def whitened(self, output: int, input: int, values: ComplexArray) -> ComplexArray:
        """Residuals (k, K) of an entry with errors made white, NaN where one is missing."""
        observed = np.logical_not(np.isnan(values).any(axis=0))
        rows = np.full(values.shape, np.nan, complex)
        if observed.any():
            rows[:, observed] = self.factor(output, input, observed).whitened(values[:, observed])
        return rows

    @property
    def weights(self) -> Array:
        """Inverse variances, shape (p, m, K)."""
        return np.asarray(1.0 / self.covariances[:, :, 0].real)


def among(bands: ComplexArray, places: Indices) -> ComplexArray:
    """Diagonals of the covariance of some of many errors, at ascending places, from the diagonals (b + 1, K) of all."""
    width = len(bands)
    some = np.zeros((width, len(places)), complex)
    for d in range(min(width, len(places))):
        apart = places[d:] - places[: len(places) - d]
        k = np.flatnonzero(apart < width)
        some[d, k] = bands[apart[k], places[k]]
    return some


@dataclass(frozen=True, eq=False)
class BandedFactor:
    """Factor `L` (lower, banded) of the covariance `L L^T` of the real and imaginary parts of K errors in turn.

    `bands` (2 b + 2, 2 K) are its diagonals.
    """

    bands: Array

    @classmethod
    def of(cls, covariance: ComplexArray, relation: ComplexArray) -> BandedFactor:
        """Factor for moments given by their diagonals (b + 1, K): row d has those of the errors at k + d and k."""
        real = _of_parts(covariance, relation)
        for ridge in _RIDGES:
            raised = real.copy()
            raised[0] *= 1 + ridge
            try:
                return cls(cholesky_banded(raised, lower=True))
            except np.linalg.LinAlgError:
                pass
        return cls(np.sqrt(np.maximum(real[:1], np.finfo(float).tiny)))

    def whitened(self, values: ComplexArray) -> ComplexArray:
        """Rows (q, K) made such that errors have variance 1 in each part, and no correlation."""
        parts = np.ascontiguousarray(values, complex).view(float)
        solved = solve_banded((len(self.bands) - 1, 0), self.bands, parts.T)
        return np.ascontiguousarray(solved.T).view(complex)

    def coloured(self, values: ComplexArray) -> ComplexArray:
        """Rows (q, K) with errors of this covariance, of such rows."""
        parts = np.ascontiguousarray(values, complex).view(float)
        rows = parts * self.bands[0]
        for d in range(1, len(self.bands)):
            rows[:, d:] += parts[:, :-d] * self.bands[d, :-d]
        return rows.view(complex)

    def turned_back(self, rows: Array) -> Array:
        """`L^-T` times columns (2 K, k) of rows, real parts first, as these are in the result."""
        half, width = len(rows) // 2, len(self.bands)
        mixed = np.empty_like(rows)
        mixed[::2], mixed[1::2] = rows[:half], rows[half:]
        upper = np.zeros_like(self.bands)
        for d in range(width):
            upper[width - 1 - d, d:] = self.bands[d, : self.bands.shape[1] - d]
        solved = solve_banded((0, width - 1), upper, mixed)
        return np.concatenate([solved[::2], solved[1::2]])

    @property
    def deviations(self) -> Array:
        """Standard deviations of the parts of the errors, shape (K,), as the mean of both."""
        variances = self.bands[0] ** 2
        for d in range(1, len(self.bands)):
            variances[d:] += self.bands[d, :-d] ** 2
        return np.asarray(np.sqrt(variances.reshape(-1, 2).mean(axis=1)))

    @property
    def log_determinant(self) -> float:
        """Of the covariance."""
        return float(2 * np.sum(np.log(self.bands[0])))


def _of_parts(covariance: ComplexArray, relation: ComplexArray) -> Array:
    """Diagonals (2 b + 2, 2 K) of the covariance of real and imaginary parts, one after the other."""
    width, count = covariance.shape
    both, apart = 0.5 * (covariance + relation), 0.5 * (relation - covariance)
    bands = np.zeros((2 * width, 2 * count))
    bands[::2, ::2], bands[::2, 1::2] = both.real, -apart.real  # of real parts, of imaginary parts
    bands[1::2, ::2] = both.imag  # of an imaginary part with a real one
    bands[1:-1:2, 1::2] = apart.imag[1:]  # of a real part with an imaginary one before
    return bands

"""Damped modes with residues of either sign: how resonances are looked for in frequency responses.

A damped mode of residue `kappa` is `kappa s / (s^2 + 2 sigma s + d^2)`, `d` being its natural frequency and `sigma / d`
its damping ratio, for a velocity; so a response is rows in which all but `d` and `sigma` is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..._checks import EPS
from .frequency_rows import FrequencyRows
from .triangular import reduced

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_MOST_DAMPED = 0.7  # damping ratio
_WIDTHS = (0.03, 0.3, 1.0, 3.0, 10.0)  # decay rates tried for a mode of which nothing is known, in bins


class DampedRows(Protocol):
    """An experiment as rows of the linear problem for damped modes."""

    @property
    def target(self) -> ComplexArray:
        """Measured values, shape (m,)."""

    @property
    def driven(self) -> bool:
        """Whether there are columns for the residues."""

    def own(self, d: Array, sigma: Array) -> ComplexArray:
        """Columns with real coefficients of this experiment alone, shape (k, m)."""

    def shared(self, d: Array, sigma: Array) -> ComplexArray:
        """Columns of the residues, shape (n, m)."""

    def slopes(self, d: Array, sigma: Array, kappa: Array, own: Array) -> ComplexArray:
        """Derivatives of the output by `(d, sigma)`, shape (2n, m)."""


@dataclass(frozen=True)
class DampedResponse:
    """The points of a frequency response, on a background of what modes outside the band leave."""

    rows: FrequencyRows
    driven: bool = True

    @property
    def target(self) -> ComplexArray:
        """Response in the scale of its weights."""
        return self.rows.target

    @cached_property
    def factor(self) -> ComplexArray:
        """Numerator of a mode of unit residue, in the scale of the weights."""
        omega = self.rows.omega
        factor = {"velocity": 1j * omega, "displacement": 1.0 + 0j * omega, "acceleration": -(omega**2) + 0j}
        return np.asarray(factor[self.rows.quantity] * self.rows.scale)

    def own(self, d: Array, sigma: Array) -> ComplexArray:
        """Modes far below the band act as a mass, those far above as a spring; only where points abound."""
        omega = self.rows.omega
        lowest = omega[omega > 0].min(initial=np.inf)
        if len(omega) < 10 + 4 * len(d) or not np.isfinite(lowest):
            return np.zeros((0, len(omega)), complex)
        return np.stack([self.factor / np.maximum(omega, lowest) ** 2, self.factor])

    def shared(self, d: Array, sigma: Array) -> ComplexArray:
        """Responses of modes of unit residue."""
        return np.asarray(self.factor / self._gap(d, sigma))

    def partial_fractions(self, d: Array, sigma: Array) -> ComplexArray:
        """Velocity and displacement, times d, of modes of unit residue, shape (2n, m); not weighted."""
        gap = self._gap(d, sigma)
        return np.concatenate([1j * self.rows.omega / gap, d[:, None] / gap])

    def slopes(self, d: Array, sigma: Array, kappa: Array, own: Array) -> ComplexArray:
        """Derivatives of the output by `(d, sigma)`."""
        by_gap = -kappa[:, None] * self.factor / self._gap(d, sigma) ** 2
        return np.concatenate([2 * d[:, None] * by_gap, 2j * self.rows.omega * by_gap])

    def _gap(self, d: Array, sigma: Array) -> ComplexArray:
        omega = self.rows.omega
        gap = (d[:, None] - omega) * (d[:, None] + omega) + 2j * sigma[:, None] * omega
        return np.where(gap == 0, EPS * np.maximum(d[:, None], omega) ** 2, gap)


# --- the linear problem ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """An experiment with its own unknowns eliminated."""

    rows: DampedRows
    basis: Array
    solve: Array
    shared: Array
    target: Array


class DampedProjection:
    """Best residues of either sign, and what belongs to each experiment, for damped modes."""

    def __init__(self, experiments: list[DampedRows], d: Array, sigma: Array) -> None:
        self.d, self.sigma, self._experiments = d, np.clip(sigma, -_MOST_DAMPED * d, _MOST_DAMPED * d), experiments

    @cached_property
    def _parts(self) -> list[_Part]:
        found = []
        for rows in self._experiments:
            own = _real(rows.own(self.d, self.sigma))
            basis, solve = _orthogonal(own)
            shared = _real(rows.shared(self.d, self.sigma)) if rows.driven else np.zeros((len(own), len(self.d)))
            target = _real(rows.target[None])[:, 0]
            found.append(_Part(rows, basis, solve, shared, target))
        return found

    @cached_property
    def _stacked(self) -> tuple[Array, Array, Array, Array]:
        """Shared columns and outputs, free of what belongs to each experiment; basis of the former, and its solver."""
        shared = np.concatenate([_without(part.shared, part.basis) for part in self._parts])
        target = np.concatenate([_without(part.target, part.basis) for part in self._parts])
        return shared, target, *_orthogonal(shared)

    @cached_property
    def kappa(self) -> Array:
        """Residues, shape (n,)."""
        _, target, basis, solve = self._stacked
        return np.asarray(solve @ (basis.T @ target))

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment."""
        return [part.solve @ (part.basis.T @ (part.target - part.shared @ self.kappa)) for part in self._parts]

    @cached_property
    def residual(self) -> Array:
        """What is left of all rows, in the frame in which the own unknowns are eliminated."""
        _, target, basis, _ = self._stacked
        return _without(target, basis)

    @property
    def loss(self) -> float:
        """Sum of squares of what is left."""
        return float(self.residual @ self.residual)

    @cached_property
    def _slopes(self) -> Array:
        return np.concatenate(
            [
                _without(_real(part.rows.slopes(self.d, self.sigma, self.kappa, own)), part.basis)
                for part, own in zip(self._parts, self.own, strict=True)
            ]
        )

    @cached_property
    def condensed(self) -> tuple[Array, Array]:
        """Residual and its Jacobian by `(d, sigma)`, turned into a few rows."""
        J = -_without(self._slopes, self._stacked[2])
        R = reduced(np.asfortranarray(np.column_stack([J, self.residual])))
        return R[:, -1], R[:, :-1]

    def covariance(self, variance: float) -> Array:
        """Covariance of `(d, sigma, kappa)`, for a variance of the rows."""
        shown = any(part.rows.driven for part in self._parts)
        J = np.concatenate([self._slopes, self._stacked[0]], axis=1) if shown else self._slopes
        lengths = np.linalg.norm(J, axis=0)
        lengths = np.where(lengths > 0, lengths, 1.0)
        inverse = np.linalg.pinv(np.linalg.qr(J / lengths, mode="r"), rcond=len(J) * EPS)
        return np.asarray(variance * (inverse @ inverse.T) / np.outer(lengths, lengths))

    @property
    def rows(self) -> int:
        """Number of real rows."""
        return len(self.residual)


def _real(columns: ComplexArray) -> Array:
    """Real and imaginary parts of complex columns (k, m) under one another, shape (2m, k)."""
    return np.concatenate([columns.real, columns.imag], axis=1).T


def _orthogonal(columns: Array) -> tuple[Array, Array]:
    """Orthonormal basis of columns (m, k), and the matrix that turns coordinates in it into coefficients."""
    lengths = np.linalg.norm(columns, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    Q, R = np.linalg.qr(columns / lengths)
    U, s, Vt = np.linalg.svd(R)
    kept = s > max(columns.shape) * EPS * s.max(initial=0.0)
    return Q @ U[:, : len(s)][:, kept], (Vt[: len(s)][kept].T / s[kept]) / lengths[:, None]


def _without(values: Array, basis: Array) -> Array:
    return np.asarray(values - basis @ (basis.T @ values))


# --- the non-linear one ----------------------------------------------------------------------------------------------

Make = Callable[[Array, Array], list[DampedRows]]  # rows for modes about which they reach


@dataclass(frozen=True)
class Band:
    """Where frequencies are looked for, and the distance within which the loss has one minimum."""

    bin: float
    ceiling: float


def refine_damped(make: Make, d: Array, sigma: Array, band: Band) -> DampedProjection:
    """Natural frequencies and decay rates, refined from a start; NaN decay rates are looked for first."""
    sigma = sigma.copy()
    for k in np.flatnonzero(np.isnan(sigma)):
        sigma[k] = _first_decay(make, d, sigma, int(k), band)
    for _ in range(2):  # peaks turn out wider than their window
        rows = make(d, sigma)
        if len(d) == 0:
            return DampedProjection(rows, d, sigma)
        before, at = np.abs(sigma), _refined(rows, d, sigma, band)
        d, sigma = at.d, at.sigma
        if np.all(np.abs(sigma) <= 2 * before + band.bin):
            break
    return at


def _first_decay(make: Make, d: Array, sigma: Array, k: int, band: Band) -> float:
    known = np.where(np.isnan(sigma), band.bin, sigma)
    known[k] = max(_WIDTHS) * band.bin
    rows = make(d, known)
    losses = []
    for width in _WIDTHS:
        known[k] = width * band.bin
        losses.append(DampedProjection(rows, d, known).loss)
    return float(_WIDTHS[int(np.argmin(losses))] * band.bin)


def _refined(rows: list[DampedRows], d: Array, sigma: Array, band: Band) -> DampedProjection:
    n = len(d)
    last: list[tuple[Array, DampedProjection]] = []

    def at(x: Array) -> DampedProjection:
        if not last or not np.array_equal(last[0][0], x):
            moved = np.clip(d + band.bin * x[:n], 1e-3 * band.bin, band.ceiling)
            last[:] = [(x.copy(), DampedProjection(rows, moved, sigma + band.bin * x[n:]))]
        return last[0][1]

    unit = float(np.sqrt(DampedProjection(rows, d, sigma).loss))
    if unit == 0.0:
        return at(np.zeros(2 * n))
    found = least_squares(
        lambda x: at(x).condensed[0] / unit,
        np.zeros(2 * n),
        jac=lambda x: at(x).condensed[1] * (band.bin / unit),
        ftol=1e-10, xtol=1e-10, gtol=1e-12, max_nfev=25,
    )  # fmt: skip
    return at(found.x)

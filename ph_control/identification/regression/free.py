"""Modes of any damping and residues of any phase, fitted to data: the linear problem, and steps of the poles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from ..._checks import EPS
from .free_rows import FreeRows
from .triangular import Blocks, reduced, triangle
from .variable_projection import eliminate

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_KEPT = 1 << 24  # numbers that are made once only
_MOST_DAMPED = 0.7  # damping ratio
_FASTEST_GROWTH = 2.0  # bins: a factor of 3e5 over a record, which leaves ten digits
_SHOWN = 1e-6  # part of a column of unit length that is not among others
_STEPS = 40
_STUCK = 1e10  # damping of steps of which none leads on
_WIDTHS = (0.03, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # decay rates tried where nothing is known, in bins

# --- the linear problem ----------------------------------------------------------------------------------------------


class FreeProjection:
    """Best residues, and what belongs to each experiment, for modes with poles `p` (n,) of positive imaginary part."""

    def __init__(self, experiments: Sequence[FreeRows], p: ComplexArray) -> None:
        self.p, self.experiments = p, experiments

    @property
    def d(self) -> Array:
        """Natural frequencies."""
        return np.abs(self.p)

    @property
    def sigma(self) -> Array:
        """Decay rates."""
        return -self.p.real

    @cached_property
    def _parts(self) -> list[tuple[Array, Array, Array, Array, FreeRows]]:
        """What turns rows into own unknowns, these rows, and below them shared and extra columns with the output."""
        found = []
        for rows in self.experiments:
            blocks: Blocks = partial(rows.blocks, self.p)
            if rows.samples * (8 * len(self.p) + 4) <= _KEPT:
                blocks = list(blocks()).__iter__
            factor = triangle(blocks, rows.samples)
            part = eliminate(factor, rows.own_unknowns(len(self.p)), rows.samples)
            count = (2 * len(self.p) + rows.through) * rows.driven
            above, below = part.above, part.below
            found.append((part.inverse, above, below[:, :count], below[:, count:], rows))
        return found

    @cached_property
    def _width(self) -> int:
        return max((2 * len(self.p) + rows.through for rows in self.experiments if rows.driven), default=0)

    @cached_property
    def _linear(self) -> tuple[Array, Array, Array, Array]:
        """Shared columns and outputs in a few rows; basis of the former, and what turns coordinates in it to unknowns.

        No experiment's own unknowns have a part in them.
        """
        parts = [(np.pad(shared, ((0, 0), (0, self._width - shared.shape[1]))), rest) for *_, shared, rest, _ in
                 self._parts]  # fmt: skip
        columns = np.concatenate([shared for shared, _ in parts])
        return columns, np.concatenate([rest[:, -1] for _, rest in parts]), *_orthogonal(columns)

    @cached_property
    def shared(self) -> Array:
        """Real and imaginary parts of the residues, and what is fed through."""
        _, target, basis, solve = self._linear
        return np.asarray(solve @ (basis.T @ target))

    @property
    def residues(self) -> ComplexArray:
        """Residues `rho`, shape (n,); 0 without an input."""
        n = len(self.p)
        return self.shared[:n] + 1j * self.shared[n : 2 * n] if self._width else np.zeros(n, complex)

    @property
    def has_feedthrough(self) -> bool:
        """Whether something may be fed through."""
        return self._width > 2 * len(self.p)

    @property
    def feedthrough(self) -> float:
        """What is fed through."""
        return float(self.shared[-1]) if self.has_feedthrough else 0.0

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment."""
        found = []
        for inverse, above, shared, _, _ in self._parts:
            count = shared.shape[1]
            found.append(inverse @ (above[:, -1] - above[:, :count] @ self.shared[:count]))
        return found

    @cached_property
    def residual(self) -> Array:
        """What is left of all rows, in a few."""
        _, target, basis, _ = self._linear
        return _without(target, basis)

    @property
    def loss(self) -> float:
        """Sum of squares of what is left."""
        return float(self.residual @ self.residual)

    @cached_property
    def _slopes(self) -> Array:
        """Derivatives of the output by imaginary and real parts of the poles, in the rows of `residual`."""
        pairs = zip(self._parts, self.own, strict=True)
        return np.concatenate([_by_poles(extra, rows, own, self.residues) for (*_, extra, rows), own in pairs])

    @cached_property
    def condensed(self) -> tuple[Array, Array]:
        """Residual and its Jacobian by imaginary and real parts of the poles, all else moving along."""
        J = -_without(self._slopes, self._linear[2])
        R = reduced(np.asfortranarray(np.column_stack([J, self.residual])))
        return R[:, -1], R[:, :-1]

    def covariance(self, variance: float) -> Array:
        """Covariance of imaginary and real parts of the poles, then `shared`, for a variance of the rows."""
        J = np.concatenate([self._slopes, self._linear[0]], axis=1)
        lengths = np.linalg.norm(J, axis=0)
        lengths = np.where(lengths > 0, lengths, 1.0)
        inverse = np.linalg.pinv(np.linalg.qr(J / lengths, mode="r"), rcond=len(J) * EPS)
        return np.asarray(variance * (inverse @ inverse.T) / np.outer(lengths, lengths))

    @cached_property
    def rows(self) -> int:
        """Number of real rows."""
        return sum(one.samples for one in self.experiments)


def _by_poles(extra: Array, rows: FreeRows, own: Array, residues: ComplexArray) -> Array:
    """Derivatives of the output by imaginary and real parts of the poles, from the columns of these."""
    n = len(residues)
    found = np.zeros((len(extra), n), complex)
    amplitudes = [own[:n] + 1j * own[n : 2 * n]] if rows.moving else []
    amplitudes += [residues] if rows.driven else []
    for k, one in enumerate(amplitudes):
        first, second = extra[:, 2 * k * n : (2 * k + 1) * n], extra[:, (2 * k + 1) * n : (2 * k + 2) * n]
        # derivative along the real axis; along the imaginary one the coefficient turns by a quarter
        found += first * one.real + second * one.imag + 1j * (second * one.real - first * one.imag)
    return np.concatenate([found.imag, found.real], axis=1)


def first_step(
    experiments: Sequence[FreeRows], p: ComplexArray, shared: Array, directions: Array
) -> tuple[float, float, int, int]:
    """How much the best first step from a model gains beyond one within some `directions` of `(poles, shared)`.

    Then what it leaves, how many directions these are more, and how many unknowns all are.
    """
    n, parts, fitted = len(p), [], 0
    driven = any(rows.driven for rows in experiments)
    for rows in experiments:
        block = np.concatenate(list(rows.blocks(p)), axis=1).T
        own, count = rows.own_unknowns(n), (2 * n + rows.through) * rows.driven
        columns, plant, extra, target = np.split(block, [own, own + count, block.shape[1] - 1], axis=1)
        left = target[:, 0] - plant @ shared[:count]
        basis, solve = _orthogonal(columns)
        residues = shared[:n] + 1j * shared[n : 2 * n] if driven else np.zeros(n, complex)
        slopes = _by_poles(extra, rows, solve @ (basis.T @ left), residues)
        width = len(directions) - 2 * n
        moved = np.column_stack([slopes, np.pad(plant, ((0, 0), (0, width - count))), left])
        parts.append(moved - basis @ (basis.T @ moved))
        fitted += basis.shape[1]
    moved = np.concatenate(parts)
    J = moved[:, :-1]
    lengths = np.linalg.norm(J, axis=0)
    J = J / np.where(lengths > 0, lengths, 1.0)
    # first the directions, then all that are perpendicular to them
    turn = np.linalg.qr(directions * lengths[:, None], mode="complete")[0]
    factor = triangle(lambda: iter([np.column_stack([J @ turn, moved[:, -1]]).T]), len(moved))
    return _beyond(factor, directions.shape[1], fitted)


def _beyond(factor: Array, some: int, fitted: int) -> tuple[float, float, int, int]:
    """What the columns of a triangular factor after the first explain of the last."""
    diagonal = np.abs(np.diag(factor))[:-1]
    shown = diagonal > _SHOWN * np.maximum(np.linalg.norm(factor[:, :-1], axis=0), _SHOWN)
    explained = factor[:-1, -1] ** 2 * shown
    more = int(shown[some:].sum())
    return float(explained[some:].sum()), float(factor[-1, -1] ** 2), more, fitted + int(shown[:some].sum()) + more


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

Make = Callable[[ComplexArray], Sequence[FreeRows]]  # rows for modes about which they reach


@dataclass(frozen=True)
class Band:
    """Where frequencies are looked for, and the distance within which the loss has one minimum."""

    bin: float
    ceiling: float

    def inside(self, p: ComplexArray) -> ComplexArray:
        """Poles brought to where they are allowed."""
        w = np.clip(p.imag, 1e-3 * self.bin, self.ceiling)
        steepest = w * _MOST_DAMPED / np.sqrt(1 - _MOST_DAMPED**2)
        return np.clip(p.real, -steepest, np.minimum(steepest, _FASTEST_GROWTH * self.bin)) + 1j * w


def refine_free(make: Make, p: ComplexArray, band: Band, rtol: float = 1e-8) -> FreeProjection:
    """Poles refined from a start; of those without a decay rate (NaN) it is looked for first."""
    p = p.copy()
    for k in np.flatnonzero(np.isnan(p.real)):
        p[k] = _first_decay(make, p, int(k), band)
    for _ in range(3):  # peaks turn out wider than their window
        rows = make(p)
        at = _refined(rows, band.inside(p), band, rtol)
        before, p = p, at.p
        if np.all(np.abs(p.real) <= 2 * np.abs(before.real) + band.bin):
            break
    return at


def _first_decay(make: Make, p: ComplexArray, k: int, band: Band) -> complex:
    known = np.where(np.isnan(p.real), -band.bin, p.real) + 1j * p.imag
    widest = max(width for width in _WIDTHS if width * band.bin <= 0.3 * max(p[k].imag, 4 * band.bin))
    known[k] = -widest * band.bin + 1j * p[k].imag
    rows = make(known)
    losses = []
    for width in _WIDTHS[: _WIDTHS.index(widest) + 1]:
        known[k] = -width * band.bin + 1j * p[k].imag
        losses.append(FreeProjection(rows, known).loss)
    return complex(-_WIDTHS[int(np.argmin(losses))] * band.bin, p[k].imag)


def _refined(rows: Sequence[FreeRows], p: ComplexArray, band: Band, rtol: float) -> FreeProjection:
    """Levenberg and Marquardt's steps, damped as Nielsen does; none is longer than the basin of its mode is wide."""
    at = FreeProjection(rows, p)
    n, damping, growth = len(p), 1e-3, 2.0
    for _ in range(_STEPS if n else 0):
        residual, J = at.condensed
        scale = np.linalg.norm(J, axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        unit = J / scale
        gradient = unit.T @ residual
        step = -np.linalg.solve(unit.T @ unit + damping * np.eye(2 * n), gradient)
        promised = -float(gradient @ step) - 0.5 * float(np.sum((unit @ step) ** 2))
        moved = step[n:] / scale[n:] + 1j * step[:n] / scale[:n]
        moved *= np.min((band.bin + np.abs(at.p.real)) / np.maximum(np.abs(moved), 1e-300), initial=1.0)
        small = promised <= 0.5 * rtol * at.loss
        trial = FreeProjection(rows, band.inside(at.p + moved))
        if trial.loss < at.loss:
            ratio = (at.loss - trial.loss) / max(2 * promised, np.finfo(float).tiny)
            at, damping, growth = trial, damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 2.0
        else:
            damping, growth = damping * growth, 2 * growth
        if small or damping > _STUCK:
            break
    return at

"""Data at a computed model: what it leaves of them, with what belongs to each experiment at its best.

Outputs that share samples share the state that they begin in, as they do in the plant: of N poles N numbers, and not as
many for each output as a free model has.  The state and the constants are eliminated by their inner products: no column
is longer than the record of one output.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray
from ..regression.free import FreeRows
from ..regression.frequency_rows import FreeResponse
from ..regression.prediction import halved
from ..regression.time_rows import FreeRecord
from .physical_modes import PhysicalModes

_RANK = 1e-11  # of the largest eigenvalue of the inner products of unit columns


@dataclass(frozen=True)
class RowsRemainder:
    """What a model leaves of the rows of an experiment.

    Attributes
    ----------
    residual : ndarray, shape (N,)
        Rows without what the model and what belongs to the experiment make of them.
    own : ndarray, shape (unknowns, q)
        What belongs to the experiment, as rows have it: free motions of each output, drifts, constants.
    unknowns : int
        How many numbers of it were estimated.
    spread : callable
        From an output, by its place, to the covariance of its `own` for known parameters and rows of variance 1.
    """

    residual: Array
    own: Array
    unknowns: int
    spread: Any


def shared_unknowns(rows: FreeRecord, model: PhysicalModes, scales: Array, through: bool) -> Array:
    """Residues and feedthrough of the outputs of a record, as `predict` takes them, shape (.., q)."""
    each = np.moveaxis(halved(model.poles, model.residues)[:, rows.outputs], 2, 0)
    parts = [each.real, each.imag] + [model.feedthrough[rows.outputs].T[:, None]] * through
    stacked = np.concatenate(parts, axis=1)[rows.acting]
    return np.asarray(stacked.reshape(-1, len(rows.outputs)) / scales[rows.outputs])


def _response(rows: FreeResponse, model: PhysicalModes, scales: Array) -> ComplexArray:
    """Responses (q, K) of a model in the scale of those of rows, at the measured frequencies."""
    o, i = np.divmod(rows.outputs, model.feedthrough.shape[1])
    peaks, halves = rows.peaks(model.poles), halved(model.poles, model.residues)[:, o, i]
    columns = np.concatenate(
        [peaks.pole_term + peaks.conjugate_term, 1j * (peaks.pole_term - peaks.conjugate_term), rows.direct]
    )
    weights = np.concatenate([halves.real, halves.imag, model.feedthrough[o, i][None]])
    return np.asarray((weights / scales[rows.outputs]).T @ columns)


def remainder_of(rows: FreeRows, model: PhysicalModes, scales: Array) -> RowsRemainder:
    """What a model leaves of the rows of an experiment, what belongs to this at its best."""
    if isinstance(rows, FreeRecord):
        return _remainder_of_record(rows, model, scales)
    # responses have nothing of their own: a computed model has all modes
    assert isinstance(rows, FreeResponse)
    remainder = rows.target - rows.in_rows(_response(rows, model, scales))
    own = np.zeros((rows.own_unknowns(len(model.poles)), len(rows.outputs)))
    return RowsRemainder(
        np.concatenate([remainder.real.ravel(), remainder.imag.ravel()]), own, 0, lambda _: np.zeros((len(own),) * 2)
    )


def _remainder_of_record(rows: FreeRecord, model: PhysicalModes, scales: Array) -> RowsRemainder:
    n, q = len(model.poles), len(rows.outputs)
    own = np.zeros((rows.own_unknowns(n), q))
    forced = np.zeros((q, rows.length))
    if n and rows.inputs:
        forced = np.asarray(
            rows.evaluated(model.poles).predict(shared_unknowns(rows, model, scales, rows.through), own)
        )
    elif rows.inputs:
        forced = (model.feedthrough[rows.outputs][:, rows.acting] / scales[rows.outputs][:, None]) @ rows.direct
    residual = rows.residuals(forced)
    constants = _in_rows(rows, np.stack([np.arange(float(rows.length)), np.ones(rows.length)])[2 - rows.offset :])
    motion = _Motion.of(rows, model, scales, residual, constants)
    remainder = motion.residual
    own[: 2 * n * rows.moving] = motion.amplitudes
    own[2 * n * rows.moving :] = motion.constants
    return RowsRemainder(remainder.ravel(), own, motion.rank + q * rows.offset, motion.spread)


def _in_rows(rows: FreeRecord, signals: Array) -> Array:
    """Signals (k, T) where samples were observed, in units of their noise."""
    seen = np.where(rows.observed, signals, 0.0)
    return seen if rows.level is None else np.asarray(seen / rows.level)


@dataclass(frozen=True)
class _Motion:
    """The free motion of one state in several outputs, beside constants of each.

    `E` (2n, T) are real and imaginary parts of `lambda^t`; an output has `a_l E_l + b_l E_(n+l)` of the real part of a
    state and `b_l E_l - a_l E_(n+l)` of its imaginary part.
    """

    data: Array
    basis: Array
    a: Array
    b: Array
    constant_columns: Array

    @classmethod
    def of(cls, rows: FreeRecord, model: PhysicalModes, scales: Array, data: Array, constants: Array) -> _Motion:
        n = len(model.poles) * rows.moving
        c = model.shapes[:n][:, rows.outputs].T / scales[rows.outputs][:, None]
        c = c * np.where(model.real[:n], 1.0, 2.0)
        powers = rows.hold.step(model.poles[:n]).powers(np.arange(float(rows.length)))
        powers = np.where(np.isfinite(powers), powers, 0.0)
        basis = _in_rows(rows, np.concatenate([powers.real, powers.imag]).reshape(2 * n, rows.length))
        return cls(data, basis, c.real, -c.imag, constants)

    @cached_property
    def _without(self) -> tuple[Array, Array]:
        """Data and basis without constants."""
        if not len(self.constant_columns):
            return self.data, self.basis
        Q = np.linalg.qr(self.constant_columns.T)[0]
        return self.data - (self.data @ Q) @ Q.T, self.basis - (self.basis @ Q) @ Q.T

    @cached_property
    def _solved(self) -> tuple[Array, Array, int]:
        """State, its covariance for rows of variance 1, and how many numbers of it the data show."""
        data, basis = self._without
        n = len(basis) // 2
        if not n:
            return np.zeros(0), np.zeros((0, 0)), 0
        G, X = basis @ basis.T, data @ basis.T
        rr, ri, ii = G[:n, :n], G[:n, n:], G[n:, n:]
        a, b = self.a, self.b
        aa, ab, bb = a.T @ a, a.T @ b, b.T @ b
        upper = aa * rr + ab * ri + ab.T * ri.T + bb * ii
        cross = ab * rr - aa * ri + bb * ri.T - ab.T * ii
        lower = bb * rr - ab.T * ri - ab * ri.T + aa * ii
        gram = np.block([[upper, cross], [cross.T, lower]])
        right = np.concatenate([
            np.sum(a * X[:, :n] + b * X[:, n:], axis=0), np.sum(b * X[:, :n] - a * X[:, n:], axis=0)
        ])  # fmt: skip
        lengths = np.sqrt(np.maximum(np.diag(gram), 0.0))
        lengths = np.where(lengths > 0, lengths, np.inf)
        values, vectors = np.linalg.eigh(gram / np.outer(lengths, lengths))
        kept = values > _RANK * max(values.max(initial=0.0), np.finfo(float).tiny)
        root = vectors[:, kept] / np.sqrt(values[kept]) / lengths[:, None]
        return root @ (root.T @ right), root @ root.T, int(kept.sum())

    @property
    def rank(self) -> int:
        """Numbers of the state that the data show."""
        return self._solved[2]

    @cached_property
    def _motions(self) -> Array:
        """The motion in each output."""
        state, n = self._solved[0], len(self.basis) // 2
        x, y = state[:n], state[n:]
        return np.concatenate([self.a * x + self.b * y, self.b * x - self.a * y], axis=1)

    @property
    def amplitudes(self) -> Array:
        """Real and imaginary parts of the motion in each output as rows have them, `2 Re(amplitude lambda^t)`."""
        n = len(self.basis) // 2
        parts = 0.5 * self._motions
        return np.concatenate([parts[:, :n], -parts[:, n:]], axis=1).T

    @cached_property
    def constants(self) -> Array:
        """Drift and constant of each output."""
        if not len(self.constant_columns):
            return np.zeros((0, len(self.data)))
        remainder = self.data - self._motions @ self.basis
        return np.linalg.lstsq(self.constant_columns.T, remainder.T, rcond=None)[0]

    @property
    def residual(self) -> Array:
        """Data without motion and constants."""
        data, basis = self._without
        return data - self._motions @ basis

    def spread(self, output: int) -> Array:
        """Covariance of what belongs to an output, for rows of variance 1."""
        n = len(self.basis) // 2
        a, b = np.diag(self.a[output]), np.diag(self.b[output])
        turn = np.block([[a, b], [b, -a]])  # of the state to what E is multiplied by
        own = 0.5 * turn
        own[n:] *= -1.0
        K = self.constant_columns.T
        if not K.shape[1]:
            return own @ self._solved[1] @ own.T
        along = -np.linalg.lstsq(K, self.basis.T @ turn, rcond=None)[0]
        every = np.concatenate([own, along])
        covariance = every @ self._solved[1] @ every.T
        covariance[2 * n :, 2 * n :] += np.linalg.inv(K.T @ K)
        return covariance


def remainders_of(experiments: Sequence[FreeRows], model: PhysicalModes, scales: Array) -> list[RowsRemainder]:
    """What a model leaves of each experiment."""
    return [remainder_of(rows, model, scales) for rows in experiments]


def energies(experiments: Sequence[FreeRows], model: PhysicalModes, scales: Array, own: Sequence[Array]) -> Array:
    """Sum of squares of what each mode makes of the rows, its motion among it."""
    total = np.zeros(len(model.poles))
    for rows, mine in zip(experiments, own, strict=True):
        for k in range(len(model.poles)):
            signal = of_modes(rows, model, np.array([k]), scales, mine)
            if isinstance(rows, FreeRecord):
                total[k] += float(np.sum(_in_rows(rows, signal) ** 2))
            elif isinstance(rows, FreeResponse):
                total[k] += float(np.sum(np.abs(rows.in_rows(signal)) ** 2))
    return total


def of_modes(rows: Any, model: PhysicalModes, places: Any, scales: Array, own: Array) -> Any:
    """What some modes make of the outputs of rows, in the scale of these; of responses at the measured frequencies."""
    some, n = model.among(places), len(model.poles)
    some = PhysicalModes(some.poles, some.shapes, some.participation, 0 * some.feedthrough)
    if isinstance(rows, FreeRecord):
        moving = np.concatenate([places, n + places]) if rows.moving else places[:0]
        mine = np.concatenate([own[moving], np.zeros((rows.offset, own.shape[1]))])
        return rows.evaluated(some.poles).predict(shared_unknowns(rows, some, scales, rows.through), mine)
    return _response(rows, some, scales)

"""What a computed model leaves of records beside noise that outputs share, or that comes through the plant.

The noise is that of the free fit.  Its innovations filter, and the covariance of the innovations, make rows of variance
1 of what the model leaves; columns of the state in which a record begins, and of constants, go through the same filter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from ..._types import Array
from ..innovations.forces import FittedNoise
from ..parameters.physical_modes import PhysicalModes
from ..parameters.rows import RowsRemainder, shared_unknowns
from ..regression.free import FreeProjection, input_places
from ..regression.time_rows import FreeRecord
from ..uncertainty.kalman import KalmanFilter

_RANK = 1e-9  # of the largest singular value of columns of unit length


@dataclass(frozen=True)
class SharedNoise:
    """Innovations of noise (k, p, T) of several signals, of variance 1.

    Attributes
    ----------
    noise : FittedNoise
        Of the free fit, in units of the data.
    """

    noise: FittedNoise

    @cached_property
    def _root(self) -> Array:
        return np.asarray(np.linalg.cholesky(self.noise.covariance))

    @cached_property
    def _filter(self) -> KalmanFilter:
        noise = self.noise.sections
        p, N = noise.C.shape
        return KalmanFilter(noise.A, np.zeros((N, 0)), noise.C, np.zeros((p, 0)), noise.K, self.noise.covariance)

    def whitened(self, signals: Array) -> Array:
        """Innovations of signals (k, p, T)."""
        errors = signals
        if self.noise.is_coloured:
            errors = np.stack([each - self._filter.foretold(np.zeros((0, each.shape[1])), each, 1) for each in signals])
        k, p, T = signals.shape
        flat = np.moveaxis(errors, 1, 0).reshape(p, k * T)
        return np.moveaxis(solve_triangular(self._root, flat, lower=True).reshape(p, k, T), 0, 1)

    def remainder(self, experiments: Sequence[FreeRecord], model: PhysicalModes, scales: Array) -> list[RowsRemainder]:
        """What a model leaves of all experiments; the first rows of a record have all of its innovations."""
        return [part for rows in of_records(experiments, len(scales)) for part in self._remainder(rows, model, scales)]

    def _remainder(self, parts: Sequence[FreeRecord], model: PhysicalModes, scales: Array) -> list[RowsRemainder]:
        n, p, T = len(model.poles), len(scales), parts[0].length
        data, columns, kinds = np.zeros((p, T)), list[Array](), list[tuple[int, int, Any]]()
        for place, rows in enumerate(parts):
            own = np.zeros((rows.own_unknowns(n), len(rows.outputs)))
            forced: Any = 0.0
            if rows.inputs:
                forced = rows.evaluated(model.poles).predict(shared_unknowns(rows, model, scales, rows.through), own)
            unit = (scales[rows.outputs] * rows.unit)[:, None]
            data[rows.outputs] = unit * rows.residuals(forced)
            for column, kind in _own_columns(rows, model, scales, unit):
                columns.append(np.zeros((p, T)))
                columns[-1][rows.outputs] = column
                kinds.append((place, *kind))
        every = self.whitened(np.stack([data, *columns])).reshape(1 + len(columns), p * T)
        target, X = every[0], every[1:].T
        lengths = np.linalg.norm(X, axis=0)
        lengths = np.where(lengths > 0, lengths, np.inf)
        U, s, V = np.linalg.svd(X / lengths, full_matrices=False)
        kept = s > _RANK * s.max(initial=0.0)
        root = V[kept].T / s[kept] / lengths[:, None]
        numbers = root @ (U[:, kept].T @ target)
        residual, spread = target - U[:, kept] @ (U[:, kept].T @ target), root @ root.T
        remainder = []
        for place, rows in enumerate(parts):
            mine = np.flatnonzero([kind[0] == place for kind in kinds])
            turn = _turn(rows, model, scales, [kinds[k] for k in mine])
            remainder.append(RowsRemainder(
                residual if not place else np.zeros(0), np.einsum("uqk,k->uq", turn, numbers[mine]),
                int(kept.sum()) if not place else 0,
                lambda output, turn=turn, mine=mine: turn[:, output] @ spread[np.ix_(mine, mine)] @ turn[:, output].T,
            ))  # fmt: skip
        return remainder

    def loss_of(self, free: FreeProjection, scales: Array) -> float:
        """Sum of squared innovations of the free fit itself."""
        total, places = 0.0, {id(rows): k for k, rows in enumerate(free.experiments)}
        records: Any = free.experiments
        for parts in of_records(records, len(scales)):
            data = np.zeros((len(scales), parts[0].length))
            for rows in parts:
                shared = free.shared[np.ix_(input_places(rows, len(free.p)), rows.outputs)]
                predicted = rows.evaluated(free.p).predict(shared, free.own[places[id(rows)]])
                data[rows.outputs] = (scales[rows.outputs] * rows.unit)[:, None] * rows.residuals(predicted)
            total += float(np.sum(self.whitened(data[None]) ** 2))
        return total


def of_records(experiments: Sequence[FreeRecord], outputs: int) -> Iterator[list[FreeRecord]]:
    """Rows of all outputs of one record each."""
    parts = list[FreeRecord]()
    for rows in experiments:
        parts.append(rows)
        if sum(len(part.outputs) for part in parts) == outputs:
            yield parts
            parts = []


def _own_columns(
    rows: FreeRecord, model: PhysicalModes, scales: Array, unit: Array
) -> Iterator[tuple[Array, tuple[int, Any]]]:
    """Columns (q, T) of what belongs to rows, in units of the data, and what each is: a state, drift or constant."""
    if rows.moving:
        powers = rows.hold.step(model.poles).powers(np.arange(float(rows.length)))
        shapes = model.shapes[:, rows.outputs] * np.where(model.real, 1.0, 2.0)[:, None]
        for part, turn in enumerate((1.0, 1j)):
            for l in range(len(model.poles)):
                if part and model.real[l]:
                    continue
                yield (turn * shapes[l][:, None] * powers[l]).real, (0, (l, part))
    for term in range(2 - rows.offset, 2):
        time = np.arange(float(rows.length)) if not term else np.ones(rows.length)
        for q in range(len(rows.outputs)):
            column = np.zeros((len(rows.outputs), rows.length))
            column[q] = unit[q] * time
            yield column, (1, (term, q))


def _turn(rows: FreeRecord, model: PhysicalModes, scales: Array, kinds: Sequence[tuple[int, int, Any]]) -> Array:
    """What columns make of the `own` unknowns of rows, shape (unknowns, q, columns)."""
    n, q = len(model.poles), len(rows.outputs)
    turn = np.zeros((rows.own_unknowns(n), q, len(kinds)))
    unit = scales[rows.outputs] * rows.unit
    for k, (_, kind, what) in enumerate(kinds):
        if kind:
            term, output = what
            turn[2 * n * rows.moving + term - (2 - rows.offset), output, k] = 1.0
            continue
        l, part = what
        amplitude = (1j if part else 1.0) * model.shapes[l, rows.outputs] * (0.5 if model.real[l] else 1.0) / unit
        turn[l, :, k], turn[n + l, :, k] = amplitude.real, amplitude.imag
    return turn

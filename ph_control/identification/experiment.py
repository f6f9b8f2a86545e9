"""One experiment as the solver sees it: rows of a linear problem, made in blocks that fit in the cache.

Every kind of data offers the same: for given frequencies the output is `N nu + F kappa`, with the residues `kappa`
shared by all experiments and `nu` (the free motion, an offset) belonging to this one alone.  A block holds columns as
rows, shape (p, m): the `own` unknowns first (of those the first 2n belong to the modes), then the residues of a driven
experiment, the derivatives by the frequencies where they are asked for, and the output.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .regressors import SHORT, Hold, Kernel, in_groups

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_BLOCK = 1 << 19  # numbers in a block of columns: a few megabytes, whatever the length of the record
_FEWEST = 32  # groups of samples in a block


class Rows(Protocol):
    """What an experiment offers to the solver."""

    @property
    def samples(self) -> int:
        """Number of real rows."""

    @property
    def driven(self) -> bool:
        """Whether there are columns for the residues."""

    @property
    def bin(self) -> float:
        """Distance of frequencies within which the loss has one minimum."""

    @property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""

    @property
    def largest(self) -> float:
        """Largest output."""

    def own_unknowns(self, n: int) -> int:
        """Number of unknowns besides the frequencies and residues of n modes."""

    def at(self, d: Array) -> Evaluation:
        """The rows at frequencies `d`."""


class Evaluation(Protocol):
    """The rows of an experiment at one set of frequencies."""

    def blocks(self) -> Iterator[Array]:
        """All rows, block by block."""

    def sensitive_blocks(self, kappa: Array, own: Array) -> Iterator[Array]:
        """The same with the derivatives of the output by the frequencies, at these residues and own unknowns."""

    def predict(self, kappa: Array, own: Array) -> NDArray[Any]:
        """Output of a model at all instants or frequencies, observed or not."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """A record in time: input, output, where the output was observed, and the hold."""

    u: Array
    y: Array
    observed: NDArray[np.bool_]
    hold: Hold
    from_rest: bool = False
    offset: bool = False
    quantity: str = "velocity"
    driven: bool = True

    @property
    def target(self) -> Array:
        """Observed outputs."""
        return self.y if self.complete else self.y[self.observed]

    @cached_property
    def complete(self) -> bool:
        """Whether the output was observed at every sample."""
        return bool(self.observed.all())

    @cached_property
    def samples(self) -> int:
        """Number of observed outputs."""
        return int(self.observed.sum())

    @cached_property
    def largest(self) -> float:
        """Largest output."""
        return float(np.max(np.abs(self.target), initial=0.0))

    def seen(self, rows: Array) -> Array:
        """Rows at which the output was observed."""
        return rows if self.complete else rows[self.observed]

    @property
    def bin(self) -> float:
        """Spacing of the discrete Fourier frequencies, rad per unit time: the width of a basin of the loss."""
        return 2 * np.pi / (len(self.u) * self.hold.h)

    @property
    def largest_phase(self) -> float:
        """Largest phase per step that is searched."""
        return self.hold.largest_phase(len(self.u)) * (1 - 1e-9)

    @property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""
        return float(self.hold.frequency_of(np.array([self.largest_phase]))[0])

    def own_unknowns(self, n: int) -> int:
        """Free motion of every mode, and the offset."""
        return (0 if self.from_rest else 2 * n) + self.offset

    def at(self, d: Array) -> TimeEvaluation:
        """The rows at frequencies `d`."""
        return TimeEvaluation(self, d)


@dataclass(frozen=True)
class _Piece:
    """Some consecutive samples of a record: its columns, and what their derivatives are made of."""

    columns: Array
    groups: Array
    state: ComplexArray
    slope: ComplexArray
    free: ComplexArray
    turning: ComplexArray
    kept: slice | NDArray[np.bool_]


class TimeEvaluation:
    """The rows of a record: O(T n) time, memory for one block; a record of one block is worked out once."""

    def __init__(self, experiment: Experiment, d: Array) -> None:
        self._experiment, self._kernel = experiment, Kernel(d, experiment.hold, experiment.quantity)
        width = 4 * len(d) + 2
        groups = -(-len(experiment.u) // SHORT)
        self._groups = min(groups, max(_FEWEST, _BLOCK // (width * SHORT)))
        self._only: _Piece | None = None

    @cached_property
    def _turns(self) -> ComplexArray:
        return self._kernel.turns(self._groups)

    def blocks(self) -> Iterator[Array]:
        """All rows, block by block."""
        for piece in self._pieces(slopes=False):
            yield piece.columns[:, piece.kept]

    def sensitive_blocks(self, kappa: Array, own: Array) -> Iterator[Array]:
        """The same with the derivatives of the output by the frequencies, at these residues and own unknowns."""
        n = self._kernel.n
        moving = own[:n] + 1j * own[n : 2 * n] if len(own) >= 2 * n else np.zeros(n, complex)
        for piece in self._pieces(slopes=True):
            by_d = self._by_frequency(piece, kappa, moving[:, None])
            columns = piece.columns
            yield np.concatenate([columns[:-1], by_d[:, : columns.shape[1]], columns[-1:]])[:, piece.kept]

    def predict(self, kappa: Array, own: Array) -> Array:
        """Output at all samples, observed or not, shape (T,)."""
        weights = np.concatenate([own, kappa]) if self._experiment.driven else own
        return np.concatenate([weights @ piece.columns[:-1] for piece in self._pieces(slopes=False)])

    def _pieces(self, slopes: bool) -> Iterator[_Piece]:
        one, kernel = self._experiment, self._kernel
        if self._only is not None:
            yield self._only
            return
        size = self._groups * SHORT
        carry, alone = kernel.start(one.u), size >= len(one.u)
        for first in range(0, len(one.u), size):
            part = slice(first, min(first + size, len(one.u)))
            groups = in_groups(one.u[part])
            turns = self._turns[:, : len(groups) + 1]
            state, slope, carry = kernel.states(groups, turns, carry, slopes or alone)
            free, turning = kernel.free_starts(first, turns)
            columns = self._columns(groups, state, free, one.y[part])
            kept = slice(None) if one.complete else one.observed[part]
            piece = _Piece(columns, groups, state, slope, free, turning, kept)
            if alone:
                self._only = piece
            yield piece

    def _columns(self, groups: Array, state: ComplexArray, free: ComplexArray, y: Array) -> Array:
        """Columns of a piece, those of the samples that pad the last group left out."""
        one, kernel = self._experiment, self._kernel
        n, own = kernel.n, one.own_unknowns(kernel.n)
        block = np.empty((own + n * one.driven + 1, len(groups) * SHORT))
        columns = block.reshape(len(block), len(groups), SHORT)
        if one.driven:
            kernel.forced(groups, state, columns[own : own + n])
        if not one.from_rest:
            kernel.free(free, columns[:n])
            kernel.free(1j * free, columns[n : 2 * n])
        if one.offset:
            block[own - 1] = 1.0
        block = block[:, : len(y)]
        block[-1] = y
        return block

    def _by_frequency(self, piece: _Piece, kappa: Array, moving: ComplexArray) -> Array:
        """Derivatives of the output by the frequencies over the groups of a piece."""
        kernel = self._kernel
        now, later = moving * piece.free, moving * piece.turning
        if self._experiment.driven:
            output, output_slope = (weight[:, None] for weight in kernel.output)
            now += (kappa[:, None] * output) * piece.state
            later += kappa[:, None] * (output_slope * piece.state + output * piece.slope)
        groups = piece.groups if self._experiment.driven else None
        return kernel.moved(kappa, groups, later, now).reshape(kernel.n, len(piece.groups) * SHORT)

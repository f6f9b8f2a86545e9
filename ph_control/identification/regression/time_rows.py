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

from ...modal.discretization import Hold
from .grouped import Modal, Shared, gram
from .modal_regressors import SHORT, Kernel, in_groups

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_BLOCK = 1 << 19  # numbers in a block of columns: a few megabytes, whatever the length of the record
_FEWEST = 32  # groups of samples in a block
_LONG = 1 << 14  # samples from which on inner products are cheaper without columns, whatever the number of modes
_SAMPLES = ((0, SHORT), (SHORT, SHORT), (2 * SHORT, 1))  # where inputs, outputs and a constant stand, and how many


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

    def gram(self) -> Array | None:
        """Inner products of the columns of `blocks`, where they can be had without these."""
        return None

    def sensitive_gram(self, kappa: Array, own: Array) -> Array | None:
        """Those of `sensitive_blocks`."""
        return None

    def predict(self, kappa: Array, own: Array) -> NDArray[Any]:
        """Output of a model at all instants or frequencies, observed or not."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """A record in time: input, output, where the output was observed, and the hold.

    `offset` counts the terms of what the output has beside the modes: none, a constant, or a constant and a drift.
    """

    u: Array
    y: Array
    observed: NDArray[np.bool_]
    hold: Hold
    from_rest: bool = False
    offset: int = 0
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
        """Free motion of every mode, then the drift per sample, and the constant as the last."""
        return (0 if self.from_rest else 2 * n) + self.offset

    def at(self, d: Array) -> TimeEvaluation:
        """The rows at frequencies `d`."""
        return TimeEvaluation(self, d)


@dataclass(frozen=True)
class _States:
    """Where the modes are at the start of every group of a piece of a record, and how that changes with frequency."""

    part: slice
    groups: Array
    state: ComplexArray
    slope: ComplexArray
    free: ComplexArray
    turning: ComplexArray


class TimeEvaluation(Evaluation):
    """The rows of a record: O(T n) time, memory for one block; a record of one block is worked out once."""

    def __init__(self, experiment: Experiment, d: Array) -> None:
        self._experiment, self._kernel = experiment, Kernel(d, experiment.hold, experiment.quantity)
        self._groups = self._at_once((4 * len(d) + 2) * SHORT)
        self._only: tuple[_States, Array] | None = None

    def blocks(self) -> Iterator[Array]:
        """All rows, block by block."""
        for states, columns in self._pieces(slopes=False):
            yield columns[:, self._kept(states)]

    def sensitive_blocks(self, kappa: Array, own: Array) -> Iterator[Array]:
        """The same with the derivatives of the output by the frequencies, at these residues and own unknowns."""
        for states, columns in self._pieces(slopes=True):
            yield self._joined(states, columns, kappa, own)[:, self._kept(states)]

    def gram(self) -> Array | None:
        """Inner products of the columns, for a long record without gaps."""
        return self._by_groups(None, np.zeros(0)) if self._by_gram else None

    def sensitive_gram(self, kappa: Array, own: Array) -> Array | None:
        """The same with the derivatives of the output by the frequencies."""
        return self._by_groups(kappa, own) if self._by_gram else None

    def predict(self, kappa: Array, own: Array) -> Array:
        """Output at all samples, observed or not, shape (T,)."""
        weights = np.concatenate([own, kappa]) if self._experiment.driven else own
        return np.concatenate([weights @ columns[:-1] for _, columns in self._pieces(slopes=False)])

    def _at_once(self, width: int) -> int:
        """Groups of so many numbers each that are looked at in one go."""
        return min(-(-len(self._experiment.u) // SHORT), max(_FEWEST, _BLOCK // width))

    # --- columns --------------------------------------------------------------------------------------------------

    def _pieces(self, slopes: bool) -> Iterator[tuple[_States, Array]]:
        if self._only is not None:
            yield self._only
            return
        alone = self._groups * SHORT >= len(self._experiment.u)
        for states in self._states(slopes or alone, self._groups):
            piece = states, self._columns(states)
            if alone:
                self._only = piece
            yield piece

    def _states(self, slopes: bool, size: int) -> Iterator[_States]:
        """States of the modes through the whole record, so many groups at a time."""
        one, kernel = self._experiment, self._kernel
        carry, leaps = kernel.start(one.u), kernel.turns(size)
        for first in range(0, len(one.u), size * SHORT):
            part = slice(first, min(first + size * SHORT, len(one.u)))
            groups = in_groups(one.u[part])
            turns = leaps[:, : len(groups) + 1]
            state, slope, carry = kernel.states(groups, turns, carry, slopes)
            yield _States(part, groups, state, slope, *kernel.free_starts(first, turns))

    def _kept(self, states: _States) -> slice | NDArray[np.bool_]:
        return slice(None) if self._experiment.complete else self._experiment.observed[states.part]

    def _columns(self, states: _States) -> Array:
        """Columns of a piece, those of the samples that pad the last group left out."""
        one, kernel, groups, y = self._experiment, self._kernel, states.groups, self._experiment.y[states.part]
        n, own = kernel.n, one.own_unknowns(kernel.n)
        block = np.empty((own + n * one.driven + 1, len(groups) * SHORT))
        columns = block.reshape(len(block), len(groups), SHORT)
        if one.driven:
            kernel.forced(groups, states.state, columns[own : own + n])
        if not one.from_rest:
            kernel.free(states.free, columns[:n])
            kernel.free(1j * states.free, columns[n : 2 * n])
        if one.offset > 1:
            block[own - 2] = np.arange(states.part.start, states.part.start + block.shape[1])
        if one.offset:
            block[own - 1] = 1.0
        block = block[:, : len(y)]
        block[-1] = y
        return block

    def _joined(self, states: _States, columns: Array, kappa: Array | None, own: Array) -> Array:
        """Columns of a piece, with the derivatives of the output by the frequencies if there are residues."""
        if kappa is None:
            return columns
        groups = states.groups if self._experiment.driven else None
        moved = self._kernel.moved(kappa, groups, *self._amplitudes(states, kappa, own))
        by_d = moved.reshape(len(moved), len(states.groups) * SHORT)[:, : columns.shape[1]]
        return np.concatenate([columns[:-1], by_d, columns[-1:]])

    def _amplitudes(self, states: _States, kappa: Array, own: Array) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives by the frequencies of the modes' amplitudes in the output, and these amplitudes, (n, count)."""
        n = self._kernel.n
        moving = own[:n, None] + 1j * own[n : 2 * n, None] if len(own) >= 2 * n else np.zeros((n, 1), complex)
        now, later = moving * states.free, moving * states.turning
        if self._experiment.driven:
            output, output_slope = (weight[:, None] for weight in self._kernel.output)
            now += (kappa[:, None] * output) * states.state
            later += kappa[:, None] * (output_slope * states.state + output * states.slope)
        return later, now

    # --- inner products without columns -----------------------------------------------------------------------------

    @property
    def _width(self) -> int:
        """Numbers about each group of samples that the inner products are made of, at most."""
        return 8 * self._kernel.n + 2 * SHORT + 1

    @property
    def _by_gram(self) -> bool:
        """Whether it pays to go without the columns: no gaps, no drift, and many more samples than numbers."""
        one = self._experiment
        return one.complete and one.offset < 2 and len(one.u) >= max(_LONG, SHORT * self._width // 2)

    def _by_groups(self, kappa: Array | None, own: Array) -> Array:
        """Inner products by way of groups of samples, with the derivatives if there are residues."""
        one = self._experiment
        size, whole = self._at_once(self._width), len(one.u) // SHORT
        inner: Array | float = 0.0
        rest = np.zeros((1, 0))
        for states in self._states(kappa is not None, size):
            full = whole - states.part.start // SHORT
            numbers = self._numbers(states, kappa, own)[:, :full]
            inner = inner + numbers @ numbers.T
            if full < len(states.groups):
                rest = self._after(states, full, kappa, own)
        return gram(*self._parts(kappa), np.asarray(inner)) + rest @ rest.T

    def _numbers(self, states: _States, kappa: Array | None, own: Array) -> Array:
        """What the columns within each group are made of, shape (rows, count): see `_parts`."""
        amplitudes = [states.free, self._kernel.output[0][:, None] * states.state]
        if kappa is not None:
            amplitudes += self._amplitudes(states, kappa, own)
        rows = [part for amplitude in amplitudes for part in (amplitude.real, amplitude.imag)]
        outputs = in_groups(self._experiment.y[states.part])
        return np.concatenate([*rows, states.groups.T, outputs.T, np.ones((1, len(outputs)))])

    def _parts(self, kappa: Array | None) -> tuple[int, list[Modal], list[Shared]]:
        """Number of columns, and how they follow within a group from the numbers of the group."""
        one, kernel, n = self._experiment, self._kernel, self._kernel.n
        own = one.own_unknowns(n)
        forced, by_d = slice(own, own + n), slice(own + n * one.driven, own + n * one.driven + n)
        rows = [slice(k * n, k * n + n) for k in range(4 if kappa is None else 8)]
        inputs, outputs, always = (slice(rows[-1].stop + k, rows[-1].stop + k + m) for k, m in _SAMPLES)
        cosine, sine, *turning = np.moveaxis(kernel.motion, 1, 0)
        modal, shared = [], [Shared(slice(-1, None), outputs, np.eye(SHORT)[None])]
        if not one.from_rest:
            modal += [Modal(slice(n), rows[0], cosine), Modal(slice(n), rows[1], sine)]
            modal += [Modal(slice(n, 2 * n), rows[0], sine), Modal(slice(n, 2 * n), rows[1], -cosine)]
        if one.offset:
            shared.append(Shared(slice(own - 1, own), always, np.ones((1, 1, SHORT))))
        if one.driven:
            modal += [Modal(forced, rows[2], cosine), Modal(forced, rows[3], sine)]
            shared.append(Shared(forced, inputs, kernel.within))
        if kappa is not None:
            modal += [Modal(by_d, row, phi) for row, phi in zip(rows[4:], (cosine, sine, *turning), strict=True)]
            if one.driven:
                shared.append(Shared(by_d, inputs, kappa[:, None, None] * kernel.within_slope))
        return by_d.start + n * (kappa is not None) + 1, modal, shared

    def _after(self, states: _States, full: int, kappa: Array | None, own: Array) -> Array:
        """Columns of the samples after the last whole group."""
        part = slice(states.part.start + full * SHORT, states.part.stop)
        late = (states.state, states.slope, states.free, states.turning)
        last = _States(part, states.groups[full:], *(each[:, full:] for each in late))
        return self._joined(last, self._columns(last), kappa, own)

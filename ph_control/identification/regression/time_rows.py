"""Records in time as rows of a linear problem, made in blocks that fit in the cache.

Every kind of data offers the same: for given poles the outputs are `N nu + F kappa`, with the unknowns `kappa`
(residues and what is fed through) shared by all experiments and `nu` (the free motion, an offset) belonging to this one
alone.  A block holds columns as rows, shape (p, m): the `own` unknowns first (of those the first 2n belong to the
modes), then the shared ones of a driven experiment, derivatives, and the outputs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.signal import lfilter

from ..._options import Interpolation
from ..._types import Array, ComplexArray, Indices, Mask, RealOrComplex
from ...modal.discretization import Hold
from ..data.time_record import size_of
from .elimination import triangle
from .modal_regressors import SHORT, GroupStates, Kernel, ModalColumns, SampledModes, in_groups

_BLOCK = 1 << 19  # numbers in a block of columns: a few megabytes, whatever the length of the record
_MUCH = 0.2  # of the squares of its changes: an input is not left out that has these in a few samples
_LONGER = 20  # times as many samples as may be left out tell whether inputs go on changing
_FEWEST = 32  # groups of samples in a block
_KEPT = 0.25  # of the measured samples, that filters need at least
WHOLE = 1e-9  # samples: a delay so near to a whole number of samples is one
_LONG = 1 << 14  # samples from which on inner products are cheaper without columns, whatever the number of modes


def _shifted(signals: Array, seen: slice, samples: Indices, lasting: bool) -> Array:
    """Signals (m, T), each so many samples (m,) later, at the samples that are seen.

    Before the record they are 0, or `lasting` at their first values.
    """
    if len(signals) > 1 and np.ptp(samples):
        pairs = zip(signals, samples, strict=True)
        return np.concatenate([_shifted(signal[None], seen, late[None], lasting) for signal, late in pairs])
    first, last = (end - int(samples[0]) for end in (seen.start, seen.stop))
    shifted = signals[:, max(0, first) : max(0, last)]
    if first >= 0:
        return shifted
    return np.concatenate([np.repeat(lasting * signals[:, :1], -first, axis=1), shifted], axis=1)


def change_seldom(u: Array, first: int) -> bool:
    """Whether an input (m, T) has much of its changes in the first samples, as a step has."""
    lost = np.sum(np.diff(u[:, : first + 1]) ** 2, axis=1)
    # of inputs that go on changing a beginning tells
    for samples in (1 + _LONGER * first, u.shape[1]):
        if not np.any(lost > _MUCH * np.sum(np.diff(u[:, :samples]) ** 2, axis=1)):
            return False
    return True


class Evaluation:
    """The rows of an experiment at one set of poles: by blocks, or by their inner products."""

    def blocks(self, slopes: bool = True) -> Iterator[Array]:
        """All rows, block by block; without `slopes` they may lack the derivatives."""
        raise NotImplementedError

    def gram(self) -> Array | None:
        """Inner products of the columns of `blocks`, where they can be had without these."""
        return None

    def predict(self, shared: Array, own: Array) -> RealOrComplex:
        """Output of a model at all instants or frequencies, observed or not."""
        raise NotImplementedError

    def factor(self, rows: int) -> Array:
        """Triangular factor of the columns."""
        return triangle(self.blocks, rows, self.gram())


@dataclass(frozen=True)
class WholeRecord:
    """Inputs (m, T), outputs (q, T) and where these were observed, of a record of which `first` samples are left out.

    So are the `last`: inputs before and after the record are not known, and so not what they do to outputs that come
    late or early.
    """

    u: Array
    y: Array
    observed: Mask
    first: int
    last: int
    level: Array | None = None


def may_filter(records: Sequence[Any], innovations: Sequence[Array]) -> bool:
    """Whether filters leave most of what was measured of each output: a sample needs those before it."""
    gaps = [record for record in records if isinstance(record, FreeRecord) and not record.complete]
    rows = [(record, row) for record in gaps for row in record.filtered(innovations)]
    return all(row.samples > _KEPT * record.samples for record, row in rows)


@dataclass(frozen=True, eq=False)
class FreeRecord:
    """The observed samples of a record, for modes with any damping and residues.

    Of several inputs (m, T) and outputs (q, T) that were observed at the same samples: they share one factorisation.
    Inputs that are zero throughout are left out, and those there are have their places `among` all.  Of outputs with a
    delay the inputs are shifted by whole samples, and modes are seen a part of a step later; inputs with a dead time of
    their own are shifted each by its own number of samples.  As many of the first samples are left out as may depend on
    inputs before the record, unless these are much of what tells: inputs that change seldom are taken to have lasted.
    """

    u: Array
    y: Array
    observed: Mask
    hold: Hold
    moving: bool = True
    offset: int = 0
    through: bool = True
    driven: bool = True
    outputs: Indices = field(default_factory=lambda: np.zeros(1, int))
    among: Indices | None = None
    scale: Array | None = None  # (q,) that the outputs are multiplied by
    delay: float = 0.0  # samples
    late: float = 0.0  # part of a step by which the inputs come later than `u` says
    ahead: Array | None = None  # inputs one sample after `u`, where they are seen as well
    whole_record: WholeRecord | None = None  # all samples, where these are a part
    unit: float = 1.0  # what inputs and outputs were divided by
    level: Array | None = None  # (T,) noise of each sample over that of the rows, by which these are divided
    dead_samples: Indices | None = None  # (m,) by which each input acts later
    lasting: bool = False  # before the record, inputs are taken to have had their first values
    known_lasting: bool | None = None  # whether they are with any delay, as before a filter
    steady: Array | None = None  # (m,) that was subtracted from inputs: what they were before the record
    steps: Array | None = None  # (q,) that outputs were rounded to, before their scale
    filled: Mask | None = None  # samples (q, T) that were not measured, of outputs with values in their place

    @cached_property
    def complete(self) -> bool:
        """Whether the outputs were observed at every sample."""
        return bool(self.observed.all())

    @cached_property
    def samples(self) -> int:
        """Number of observed samples."""
        return int(self.observed.sum())

    @property
    def length(self) -> int:
        """Number of all samples T."""
        return self.u.shape[-1]

    @property
    def bin(self) -> float:
        """Spacing of the discrete Fourier frequencies, rad per unit time: the width of a basin of the loss."""
        return 2 * np.pi / (self.length * self.hold.h)

    @property
    def largest_phase(self) -> float:
        """Largest phase per step that is searched."""
        return self.hold.largest_phase(self.length) * (1 - 1e-9)

    @property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""
        return float(self.hold.frequency_of(np.array([self.largest_phase]))[0])

    def residuals(self, predicted: Array) -> Array:
        """What is left of the outputs (q, T), in units in which its noise is the same at all samples; 0 where missing.

        Of `predicted` outputs in their scale.
        """
        left_over = np.where(self.observed, self.measured - predicted, 0.0)
        return left_over if self.level is None else left_over / self.level

    @property
    def rounded(self) -> Array:
        """Losses (q,) of outputs in their scale that rounding leaves, by `steps^2 / 12` in each sample."""
        return self.samples / 12 * self._rounded_to**2

    @property
    def _rounded_to(self) -> Array:
        """Steps (q,) of outputs in their scale."""
        steps = np.zeros(len(self.outputs)) if self.steps is None else self.steps
        return steps if self.scale is None else steps * self.scale

    def filled_with(self, y: Array) -> FreeRecord:
        """The record with outputs (q, T) in their scale at all samples, values in place of those that are missing."""
        missing = np.broadcast_to(~self.observed, y.shape) if self.filled is None else self.filled
        y = y if self.scale is None else y / self.scale[:, None]
        return replace(self, y=y, observed=np.ones(self.length, bool), filled=missing)

    @property
    def measured(self) -> Array:
        """Outputs (q, T) in their scale, 0 where missing."""
        y = self.y if self.scale is None else self.y * self.scale[:, None]
        return y if self.complete else np.where(self.observed, y, 0.0)

    @classmethod
    def by_observation(
        cls, u: Array, y: Array, observed: Mask, hold: Hold, level: Array | None = None,
        steps: Array | None = None, **options: Any,
    ) -> list[FreeRecord]:  # fmt: skip
        """A record with inputs (m, T) and outputs (q, T), divided into outputs observed at the same samples.

        So it is into outputs whose noise has the same level (q, T) at all samples.
        """
        groups: dict[bytes, list[int]] = {}
        alike, steps = bool(observed.all()), None if steps is None or not steps.any() else steps
        for output in np.flatnonzero(observed.any(axis=1)).tolist():
            key = b"" if alike else observed[output].tobytes()
            key += b"" if level is None else level[output].tobytes()
            groups.setdefault(key, []).append(output)
        records = []
        for outputs in groups.values():
            first, rows = outputs[0], slice(None) if len(outputs) == len(y) else outputs  # the whole is not copied
            record = cls(
                u, y[rows], observed[first], hold, outputs=np.array(outputs),
                steps=None if steps is None else steps[rows], level=None if level is None else level[first], **options,
            )  # fmt: skip
            records.append(record.of_one_level())
        return records

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return len(self.u) if self.driven else 0

    @property
    def acting(self) -> Indices:
        """Which of all inputs these are."""
        return (np.arange(len(self.u)) if self.among is None else self.among)[: self.inputs]

    @property
    def largest(self) -> Array:
        """Largest value of each output."""
        return np.array([size_of(y) for y in self.y])

    @property
    def whole(self) -> bool:
        """Whether the bins of its transform have all that it tells of modes."""
        return self.complete and self.moving and self.offset < 2 and self.level is None

    def own_unknowns(self, n: int) -> int:
        """Free motion of every mode, then the drift per sample, and the constant as the last."""
        return 2 * n * self.moving + self.offset

    def delayed(self, time: float, least: float | None = None, most: float | None = None) -> FreeRecord:
        """The record with outputs that come so much later than the response to the inputs.

        So many samples are left out that delays may be between the `least` and the `most`, of which more than there
        are already.
        """
        if not self.driven:
            return self
        samples = time / self.hold.h
        samples = float(np.rint(samples)) if abs(samples - np.rint(samples)) < WHOLE else samples
        known, dead = self.whole_record or WholeRecord(self.u, self.y, self.observed, 0, 0, self.level), self._dead
        ends = [samples, *(bound / self.hold.h for bound in (least, most) if bound is not None)]
        first = max(known.first, int(np.ceil(max(ends))) + int(dead.max())) * self.moving
        lasting = change_seldom(known.u, first) if self.known_lasting is None else self.known_lasting
        lasting = lasting and self.moving and first > 0
        first = 0 if lasting else first
        last = max(known.last, -int(np.floor(min(ends))) - int(dead.min()))
        if self.whole_record is None and not (samples or first or last or dead.any()):
            return self
        moving = self.moving or samples < 0
        shift = int(np.floor(samples))
        late = samples - shift
        seen = slice(first, known.u.shape[-1] - last)
        u, ahead = (_shifted(known.u, seen, shift + back + dead, lasting) for back in (late > 0, 0))
        return replace(
            self, u=u, y=known.y[:, seen], observed=known.observed[seen], delay=samples, late=late, moving=moving,
            ahead=ahead if late and self.hold.intersample == "foh" else None,
            whole_record=replace(known, first=first, last=last), lasting=lasting,
            level=None if known.level is None else known.level[seen],
        )  # fmt: skip

    def with_dead_times(self, times: Array) -> FreeRecord:
        """The record with inputs (all there are) that act later, each by a time of its own: whole samples."""
        dead = np.rint(times[self.acting] / self.hold.h).astype(int)
        return replace(self, dead_samples=dead).delayed(self.delay_time) if dead.any() else self

    @property
    def _dead(self) -> Indices:
        return np.zeros(len(self.u), int) if self.dead_samples is None else self.dead_samples

    @property
    def delay_time(self) -> float:
        """The delay per unit time."""
        return self.delay * self.hold.h

    def of_one_level(self) -> FreeRecord:
        """The record in units of its noise, where that is the same at all samples."""
        if self.level is None or np.ptp(self.level):
            return self
        size = float(self.level[0])
        return replace(self.in_units(1.0 / size), unit=self.unit * size, level=None)

    def among_outputs(self, kept: Mask) -> FreeRecord:
        """The record of some of the outputs."""
        scale, whole = (None if self.scale is None else self.scale[kept]), self.whole_record
        return replace(
            self, y=self.y[kept], outputs=self.outputs[kept], scale=scale,
            steps=None if self.steps is None else self.steps[kept],
            whole_record=None if whole is None else replace(whole, y=whole.y[kept]),
        )  # fmt: skip

    def in_units(self, size: float) -> FreeRecord:
        """The record with all signals so many times as large."""
        known = self.whole_record
        return replace(
            self, u=self.u * size, y=self.y * size, ahead=None if self.ahead is None else self.ahead * size,
            steady=None if self.steady is None else self.steady * size,
            steps=None if self.steps is None else self.steps * size,
            whole_record=known and replace(known, u=known.u * size, y=known.y * size),
        )  # fmt: skip

    def without(self, signals: Array) -> FreeRecord:
        """The record less signals (q, T) of all samples, in the unit of its outputs before their scale."""
        known = self.whole_record
        if known is None:
            return replace(self, y=self.y - signals)
        y = known.y - signals
        seen = slice(known.first, known.u.shape[-1] - known.last)
        return replace(self, y=y[:, seen], whole_record=replace(known, y=y))

    def placed(self, values: Array) -> Array:
        """What is predicted at the samples of the record at those of the whole one, NaN where inputs are unknown."""
        known = self.whole_record
        if known is None or not (known.first or known.last):
            return values
        extended = np.full((*values.shape[:-1], known.u.shape[-1]), np.nan)
        extended[..., known.first : known.u.shape[-1] - known.last] = values
        return extended

    def motion_at_start(self, p: ComplexArray, residues: ComplexArray, own: Array) -> ComplexArray:
        """Free motions (n, q) at the first sample of the whole record, beside inputs that lasted before.

        Of `own` unknowns, which have those at the first sample that is not left out, and `residues` (n, q, m).  Of a
        record from rest they are such as inputs that were subtracted hold.
        """
        n, known, modes = len(p), self.whole_record, self.modes(p)
        held = np.zeros((n, self.inputs), complex)
        if self.steady is not None:  # an integrator is not held
            ahead = 1 - modes.multiplier[:, None]
            np.divide(np.outer(modes.b0 + modes.b1, self.steady), ahead, out=held, where=ahead != 0)
        motion = np.einsum("lqi,li->lq", residues[:, :, self.acting], held)
        if self.moving:
            motion += own[:n] + 1j * own[n : 2 * n]
        if known is None or not self.moving:
            return motion
        # what inputs have done to the state that the rows do not know of
        u = known.u if self.steady is None else known.u + self.steady[:, None]
        shift = int(np.floor(self.delay)) + (self.late > 0)
        state = self._driven(modes, u, range(min(-shift, -int(self.late > 0)), known.first + 1 - shift))
        forced = np.einsum("lqi,li->lq", residues[:, :, self.acting], state)
        return np.asarray(np.exp(-p * known.first * self.hold.h)[:, None] * (motion - forced))

    def _driven(self, modes: SampledModes, u: Array, samples: range) -> ComplexArray:
        """State (n, m) at the last of some samples, from rest at the first; before the record inputs have lasted."""
        places = np.maximum(np.array(samples)[:, None] - self._dead[: self.inputs], 0)
        state, lam = np.zeros((len(modes.multiplier), self.inputs), complex), modes.multiplier[:, None]
        for now, then in pairwise(u[np.arange(self.inputs), places]):
            state = lam * state + np.outer(modes.b0, now) + np.outer(modes.b1, then)
        return state

    def offset_at_start(self, own: Array) -> tuple[Array, Array]:
        """Constant of each output at the first sample of the whole record, and its change per unit time.

        It has in it what inputs that were subtracted hold.
        """
        none = np.zeros(own.shape[1])
        first = 0 if self.whole_record is None else self.whole_record.first
        drift = own[-2] if self.offset > 1 else none
        return (own[-1] - first * drift if self.offset else none), drift / self.hold.h

    def held(self, intersample: Interpolation) -> FreeRecord:
        """The record with inputs that behave otherwise between the samples."""
        record = replace(self, hold=replace(self.hold, intersample=intersample))
        return record.delayed(self.delay_time)

    @property
    def direct(self) -> Array:
        """Inputs (m, T) as an output with the delay meets them at its samples."""
        return self.u if self.ahead is None else self.late * self.u + (1.0 - self.late) * self.ahead

    def modes(self, p: ComplexArray) -> SampledModes:
        """Modes with these poles as the samples show them."""
        return SampledModes.of(self.hold, p, self.late)

    def filtered(self, innovations: Sequence[Array]) -> list[FreeRecord]:
        """Inputs and each output through the filter of that output; what it cannot know is left out.

        A filter takes inputs and outputs of any poles to inputs and outputs of the same poles.
        """
        if self.whole_record is not None:
            known = self.whole_record
            whole = replace(
                self, u=known.u, y=known.y, observed=known.observed, delay=0.0, late=0.0, ahead=None, whole_record=None,
                level=known.level,
            )  # fmt: skip
            # as many samples are left out at the ends, which other delays may ask for
            dead, h = self._dead, self.hold.h
            ends = -h * (known.last + int(dead.min())), h * (known.first - int(dead.max()))
            ends = min(self.delay_time, ends[0]), max(self.delay_time, ends[1])
            return [rows.delayed(self.delay_time, *ends) for rows in whole.filtered(innovations)]
        records = []
        for row, output in enumerate(self.outputs.tolist()):
            b = innovations[output]
            u = np.concatenate([np.repeat(self.lasting * self.u[:, :1], len(b) - 1, axis=1), self.u], axis=1)
            u = np.asarray(lfilter(b, 1.0, u, axis=-1))[:, len(b) - 1 :]
            y = np.asarray(lfilter(b, 1.0, self.measured[row : row + 1], axis=-1))
            missing = np.convolve(~self.observed, np.ones(len(b)))[: self.length] > 0
            # before a record at rest, all is 0; a constant is not
            missing[: (len(b) - 1) * (self.offset > 0 or self.lasting)] = True
            part = slice((len(b) - 1) * (self.moving and not self.lasting), None)
            record = replace(
                self, u=u[:, part], y=y[:, part], observed=~missing[part], scale=None, outputs=self.outputs[[row]],
                known_lasting=self.lasting, level=None if self.level is None else self.level[part],
                steps=None if self.steps is None else self._rounded_to[[row]] * np.linalg.norm(b),
            )  # fmt: skip
            records.append(record)
        return records

    def evaluated(self, p: ComplexArray) -> FreeTimeEvaluation:
        """The rows for modes with these poles."""
        return FreeTimeEvaluation(self, p)


# --- columns ----------------------------------------------------------------------------------------------------------

Column = ModalColumns | tuple[str, int]  # modal columns, or a constant, a drift, an input or an output by its number


class FreeTimeEvaluation(Evaluation):
    """The rows of a record for modes with any damping and residues: `y = 2 Re(residue state) + ...`.

    O(T n) time and memory for one block; a record of one block is worked out once.
    """

    def __init__(self, rows: FreeRecord, p: ComplexArray) -> None:
        self._rows, n, m = rows, len(p), len(rows.u)
        self._kernel = Kernel(rows.modes(p).doubled)
        self._last = None if rows.ahead is None else rows.ahead[:, -1]
        self._scale = np.ones(len(rows.y)) if rows.scale is None else rows.scale
        self._groups = self._at_once((4 * n * (1 + m) + 2 * m + rows.offset + len(rows.y)) * SHORT)
        self._only: tuple[GroupStates, Array] | None = None

    def layout(self, states: GroupStates, slopes: bool = True) -> list[Column]:
        """Free motions, offsets, responses, what is fed through, derivatives by the poles, rises, outputs."""
        rows, columns = self._rows, list[Column]()
        if rows.moving:
            columns.append(ModalColumns((2 * states.free,)))
        columns += [("drift", 0), ("constant", 0)][2 - rows.offset :]
        for k in range(rows.inputs):
            columns.append(ModalColumns((states.driven[k],), self._kernel.within[0], k))
            columns += [("input", k)] * rows.through
        if slopes:
            if rows.moving:
                columns.append(ModalColumns((2 * states.free_slope, 2 * states.free)))
            for k in range(rows.inputs):
                columns.append(ModalColumns((states.driven_slope[k], states.driven[k]), self._kernel.within[1], k))
            columns += [("rise", k) for k in range(rows.inputs * (rows.ahead is not None))]
        return columns + [("output", k) for k in range(len(rows.y))]

    def blocks(self, slopes: bool = True) -> Iterator[Array]:
        """All rows, block by block; without `slopes` they may lack the derivatives."""
        rows = self._rows
        for states, columns in self._pieces(slopes):
            columns = columns if rows.level is None else columns / rows.level[states.samples]
            yield columns if rows.complete else columns[:, rows.observed[states.samples]]

    def gram(self) -> Array | None:
        """Inner products of the columns, for a long record without gaps."""
        return self._by_groups() if self._by_gram else None

    def predict(self, shared: Array, own: Array) -> Array:
        """Output at all samples, observed or not, shape (T,); of several outputs (q, T)."""
        weights = np.concatenate([own, shared[: len(shared) * self._rows.driven]])
        outputs = np.empty((*weights.T.shape[:-1], self._rows.length))
        for states, columns in self._pieces(False):
            outputs[..., states.samples] = weights.T @ columns[: len(weights)]
        return outputs

    def _at_once(self, width: int) -> int:
        """Groups of so many numbers each that are looked at in one go."""
        return min(-(-self._rows.length // SHORT), max(_FEWEST, _BLOCK // width))

    def _pieces(self, slopes: bool) -> Iterator[tuple[GroupStates, Array]]:
        if self._only is not None:
            yield self._only
            return
        alone = self._groups * SHORT >= self._rows.length
        for states in self._kernel.pieces(self._rows.u, self._groups, slopes or alone, self._last):
            piece = states, self._filled(states, self.layout(states, slopes or alone))
            if alone:
                self._only = piece
            yield piece

    def _filled(self, states: GroupStates, layout: Sequence[Column]) -> Array:
        """Columns of a piece, those of the samples that pad the last group left out."""
        part, n = states.samples, self._kernel.n
        sizes = [2 * n if isinstance(entry, ModalColumns) else 1 for entry in layout]
        block = np.empty((sum(sizes), states.inputs.shape[1], SHORT))
        flat = block.reshape(len(block), states.inputs.shape[1] * SHORT)[:, : part.stop - part.start]
        place = 0
        for entry, size in zip(layout, sizes, strict=True):
            if isinstance(entry, ModalColumns):
                self._kernel.fill(entry, states.inputs[entry.input], block[place : place + size])
            else:
                flat[place] = self._plain(*entry, part)
            place += size
        return flat

    def _plain(self, kind: str, number: int, part: slice) -> Array | float:
        rows = self._rows
        if kind == "drift":
            return np.arange(float(part.start), part.stop)
        if kind == "constant":
            return 1.0
        if kind == "output":
            return rows.y[number, part] * self._scale[number]
        if rows.ahead is None:
            return rows.u[number, part]
        before, after = rows.u[number, part], rows.ahead[number, part]
        return after - before if kind == "rise" else rows.late * before + (1.0 - rows.late) * after

    # --- inner products without columns -------------------------------------------------------------------------------

    @property
    def _width(self) -> int:
        """Numbers about each group of samples that the inner products are made of, at most."""
        m, q = len(self._rows.u), len(self._rows.y)
        return 8 * self._kernel.n * m + (m + q) * SHORT + 1

    @property
    def _by_gram(self) -> bool:
        """Whether it pays to go without the columns: no gaps, no drift, and many more samples than numbers."""
        rows = self._rows
        alike = rows.complete and rows.offset < 2 and rows.level is None
        return alike and rows.length >= max(_LONG, SHORT * self._width // 2)

    def _by_groups(self) -> Array:
        """Inner products by way of groups of samples."""
        whole = self._rows.length // SHORT
        inner: Array | float = 0.0
        rest = np.zeros((1, 0))
        for states in self._kernel.pieces(self._rows.u, self._at_once(self._width), True, self._last):
            full = whole - states.samples.start // SHORT
            columns = self.layout(states)
            numbers = self._numbers(states, columns)[:, :full]
            inner = inner + numbers @ numbers.T
            if full < states.inputs.shape[1]:
                late = states.after(full)
                rest = self._filled(late, self.layout(late))
        return gram(*self._parts(columns), np.asarray(inner)) + rest @ rest.T

    def _numbers(self, states: GroupStates, layout: Sequence[Column]) -> Array:
        """What the columns within each group are made of, shape (rows, count): see `_parts`."""
        amplitudes = [each for entry in layout if isinstance(entry, ModalColumns) for each in entry.amplitudes]
        rows = [part for amplitude in amplitudes for part in (amplitude.real, amplitude.imag)]
        outputs = zip(self._rows.y, self._scale, strict=True)
        signals = [*states.inputs, *(scale * in_groups(y[states.samples]) for y, scale in outputs)]
        return np.concatenate([*rows, *(signal.T for signal in signals), np.ones((1, states.inputs.shape[1]))])

    def _parts(self, layout: Sequence[Column]) -> tuple[int, list[Modal], list[Shared]]:
        """Number of columns, and how they follow within a group from the numbers of the group."""
        n, motion = self._kernel.n, np.moveaxis(self._kernel.motion, 1, 0)
        amplitudes = sum(len(entry.amplitudes) for entry in layout if isinstance(entry, ModalColumns))
        rows = self._rows
        size_in = SHORT + (rows.ahead is not None)
        sizes = [size_in] * len(rows.u) + [SHORT] * len(rows.y) + [1]
        signals = [2 * n * amplitudes + int(start) for start in np.cumsum([0, *sizes[:-1]])]
        # a sample, the one after it, and what these make of an input with a delay
        now, after = (np.eye(size_in, SHORT, -k)[None] for k in (0, size_in - SHORT))
        met = now if rows.ahead is None else rows.late * now + (1 - rows.late) * after
        made = {"rise": after - now, "input": met, "constant": np.ones((1, 1, SHORT)), "output": np.eye(SHORT)[None]}
        modal, shared, column, row = [], [], 0, 0
        for entry in layout:
            if not isinstance(entry, ModalColumns):
                kind, number = entry
                place = {"output": len(rows.u) + number, "constant": -1}.get(kind, number)
                first = signals[place]
                shared.append(Shared(slice(column, column + 1), slice(first, first + sizes[place]), made[kind]))
                column += 1
                continue
            for turn, (_, within) in enumerate(entry.turned):
                here = slice(column, column + n)
                for k in range(len(entry.amplitudes)):
                    real, imaginary = (slice(row + 2 * k * n + part * n, row + 2 * k * n + part * n + n)
                                       for part in (0, 1))  # fmt: skip
                    first, second = motion[2 * k], motion[2 * k + 1]
                    if turn:
                        first, second = second, -first
                    modal += [Modal(here, real, first), Modal(here, imaginary, second)]
                if within is not None:
                    inputs = signals[entry.input]
                    shared.append(Shared(here, slice(inputs, inputs + size_in), within))
                column += n
            row += 2 * n * len(entry.amplitudes)
        return column, modal, shared


# --- inner products of columns, group by group ------------------------------------------------------------------------
#
# Within a group of samples every column is `sum_r V_r phi_r(s)`, with numbers `V_r` of the group (modal amplitudes at
# its start, its inputs, its outputs) and functions `phi_r` of the place `s` in the group that are the same for all
# groups. The inner products of the columns are then those of the rows of V, which are fewer by the length of a group,
# weighted by inner products of the functions.


@dataclass(frozen=True)
class Modal:
    """Columns of which each has one row of V of its own: column l adds `V[rows][l] * phi[l, s]`, `phi` (n, s)."""

    columns: slice
    rows: slice
    phi: Array


@dataclass(frozen=True)
class Shared:
    """Columns made of the same m rows of V: column l adds `sum_j V[rows][j] * weights[l, j, s]`, (n, m, s)."""

    columns: slice
    rows: slice
    weights: Array


def gram(size: int, modal: Sequence[Modal], shared: Sequence[Shared], inner: Array) -> Array:
    """Inner products (size, size) of columns given by their parts, from those of the rows of V.

    Parts that name the same columns add up.  O(n^2) operations, whatever the number of groups.
    """
    products = np.zeros((size, size))
    # (m, place, row of V): what meets in a product of two columns is the place in the group
    weights = [np.ascontiguousarray(block.weights.transpose(0, 2, 1)) for block in shared]
    for first, first_weights in zip(shared, weights, strict=True):
        for second, second_weights in zip(shared, weights, strict=True):
            common = first_weights @ inner[first.rows, second.rows]
            products[first.columns, second.columns] += _flat(common) @ _flat(second_weights).T
    if not modal:
        return products
    rows = np.concatenate([np.arange(len(inner))[block.rows] for block in modal])
    phi = np.concatenate([block.phi for block in modal])
    of_rows = inner[rows]
    products += _summed(size, modal, _summed(size, modal, of_rows[:, rows] * (phi @ phi.T)).T)
    for other, other_weights in zip(shared, weights, strict=True):
        common = phi[:, :, None] * of_rows[:, None, other.rows]
        part = _summed(size, modal, _flat(common) @ _flat(other_weights).T)
        products[:, other.columns] += part
        products[other.columns] += part.T
    return products


def _summed(size: int, modal: Sequence[Modal], parts: Array) -> Array:
    """Rows of parts, one block for each entry of `modal`, added up to the columns that they belong to."""
    sums, first = np.zeros((size, parts.shape[1])), 0
    for block in modal:
        sums[block.columns] += parts[first : first + len(block.phi)]
        first += len(block.phi)
    return sums


def _flat(parts: Array) -> Array:
    # there may be no columns at all, so that the second size has to be told
    return parts.reshape(len(parts), parts.shape[1] * parts.shape[2])

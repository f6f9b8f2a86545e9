"""Measured records in time, checked once: what the identification sees of a recording.

Records that are too long to be searched at once have parts: modes are found in one, and followed to the whole.
"""

from __future__ import annotations

import numbers
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from control import TimeResponseData

from ... import _checks
from ..._display import counted
from ..._frozen import Frozen
from ..._types import Array, ArrayLike, Mask, RealOrComplex
from ..._units import with_unit
from ...analysis.time_grid import printed_step
from ...exceptions import IdentificationError, StructureError

LONG = 1 << 21  # numbers of a record up to which it is searched as a whole, and has doubles
_LARGEST = 1e100  # of a signal whose squares are summed
_CONTRADICTION = 0.01  # of a step: how far a given dt may be from the step of the record

_BLOCK = 1 << 18  # numbers that are looked at at a time


@dataclass(frozen=True)
class Clock:
    """Instants `k dt` of samples by their numbers k, which need no memory."""

    numbers: range
    dt: float

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, part: slice) -> Clock:
        return Clock(self.numbers[part], self.dt)

    def instants(self) -> Array:
        """All of them."""
        time = np.arange(float(self.numbers.start), self.numbers.stop)
        time *= self.dt
        return time


class CheckedData(Frozen):
    """Data of any kind that have been checked; the `time` of a `Clock` is made when it is first asked for."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(vars(self).get("time"), Clock):
            vars(self)["_clock"] = vars(self).pop("time")

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name != "time" or "_clock" not in vars(self):
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            return vars(self).setdefault("time", _checks.readonly(self.clock.instants()))

    @property
    def clock(self) -> Any:
        """The time, as it is kept."""
        return vars(self).get("_clock", vars(self).get("time"))

    @property
    def measured(self) -> RealOrComplex:
        """What was measured, samples along the last axis; NaN where it is missing."""
        raise NotImplementedError

    @property
    def samples(self) -> int:
        """Number of instants T, or frequencies K."""
        return self.measured.shape[-1]

    @cached_property
    def observed(self) -> Mask:
        """Where it was measured."""
        mask = np.isnan(self.measured)
        return _checks.readonly(np.logical_not(mask, out=mask))


class InTime(CheckedData):
    """Signals on a uniform grid."""

    time: Array
    dt: float
    u: Array
    y: Array

    @property
    def measured(self) -> Array:
        """Outputs; NaN where they are missing."""
        return self.y


@dataclass(frozen=True, eq=False, repr=False)
class Record(InTime):
    """One input and one output on a uniform grid.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Instants, as recorded.
    dt : float
        Time between samples.
    u, y : ndarray, shape (T,)
        Input, and output with NaN for missing samples.
    input_label, output_label : str
        Names of the two.
    driven : bool
        Whether there is an input; an autonomous record has `u` = 0.
    title : str
        What the record is called, such as the name of its file or trace; may be empty.
    time_unit : str or None
        Unit of the time, such as 'ms'; None where it is not known.
    """

    time: Array
    dt: float
    u: Array
    y: Array
    input_label: str = "u"
    output_label: str = "y"
    driven: bool = True
    title: str = field(default="", kw_only=True)
    time_unit: str | None = field(default=None, kw_only=True)

    def __repr__(self) -> str:
        source = f" from {self.input_label!r}" * self.driven
        return f"<Record: {self.samples} samples, step {self.dt:.6g}, {self.output_label!r}{source}>"

    @property
    def input_labels(self) -> tuple[str, ...]:
        """Name of the input; none of a free motion."""
        return (self.input_label,) * self.driven

    @property
    def output_labels(self) -> tuple[str, ...]:
        """Name of the output."""
        return (self.output_label,)

    def as_response(self) -> TimeResponseData:
        """Return the record as python-control keeps one."""
        response = TimeResponseData(
            self.time, self.y, inputs=self.u if self.driven else None, issiso=True,
            input_labels=[self.input_label] if self.driven else None, output_labels=[self.output_label],
            title=self.title or "Recording",
        )  # fmt: skip
        return with_unit(response, self.time_unit)


def uniform_time(name: str, recorded: ArrayLike, dt: float | None = None) -> tuple[Array, float]:
    """Instants on a uniform grid, and their step, which does not depend on where the time begins.

    Far from its origin a time in doubles is coarse: the step is the shortest number that the instants allow.
    """
    time, step = _checks.time_vector(recorded, name=name)
    _checks.sampling_step(step, name=f"the step of {name}")
    refuse_contradiction(dt, step, name)
    return time, printed_step(time)


def refuse_contradiction(dt: float | None, step: float, name: str) -> None:
    """Refuse a `dt` other than the step of a time that the data bring along."""
    if dt is None:
        return
    given = _checks.sampling_step(dt)
    if abs(given - step) > _CONTRADICTION * step:
        raise StructureError(f"dt = {given:g} contradicts {name}, whose step is {step:.6g}; leave dt out")


def instants(samples: int, dt: float, start: float = 0.0) -> Array:
    """Uniform grid, made in place."""
    time = np.arange(float(samples))
    time *= dt
    time += start
    return time


def refuse_short(samples: int) -> None:
    """Refuse a record that has no step."""
    if samples < 2:
        raise IdentificationError(f"the record has {counted(samples, 'sample')}; a fit needs at least 5")


def size_of(values: Array) -> float:
    """Largest absolute value, without an array of them; NaN is left out."""
    return max(float(np.fmax.reduce(values, initial=0.0)), -float(np.fmin.reduce(values, initial=0.0)))


def refuse_out_of_range(name: str, values: Array) -> None:
    """Refuse a signal whose squares come near the ends of the range of doubles; NaN is left out."""
    size = size_of(values)
    if size and not 1 / _LARGEST < size < _LARGEST:
        raise StructureError(
            f"{name} is of size {size:.3g}, and its square is near the end of the range of doubles; allowed is "
            f"{1 / _LARGEST:g} to {_LARGEST:g}: choose another unit"
        )


def signal(name: str, value: object, *, missing: bool = False) -> Array:
    """Take a vector of numbers; a single column or row counts as one.

    With `missing`, what is masked, None or NaN becomes NaN; otherwise it is refused with its place.
    """
    if stays_on_disk(value):
        array: Array = np.asarray(value)
    else:
        array = np.array(_numbers(name, value), dtype=float)
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim != 1:
        raise StructureError(
            f"{name} has shape {array.shape}; expected one signal of shape (T,); several experiments are a list of "
            "tuples, [(u1, y1), (u2, y2)]"
        )
    bad = np.isinf(array) if missing else ~np.isfinite(array)
    count = int(np.count_nonzero(bad))
    if count and missing:
        raise StructureError(f"{name} is infinite at sample {np.argmax(bad)}; mark missing samples with NaN")
    if count:
        first = np.argmax(bad)
        raise StructureError(
            f"{name} is not finite at sample {first}: {count} of {len(array)} samples are NaN or infinite, the first "
            f"at index {first}; every sample is needed, so fill them in or cut the record there"
        )
    return array


def stays_on_disk(value: object) -> bool:
    """Whether an array is read from the disk block by block: of doubles, or of many numbers of single precision."""
    if not isinstance(value, np.memmap) or value.flags.writeable:
        return False
    return bool(value.dtype == np.float64 or (value.dtype == np.float32 and value.size > LONG))


def _numbers(name: str, value: object) -> RealOrComplex:
    """Real numbers of any type, NaN where one is absent; not copied if that can be avoided."""
    if isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "biuf":
        return np.where(np.ma.getmaskarray(value), np.nan, value.data)
    try:
        array = np.asarray(value)
    except ValueError:
        return _checks.real_array(name, value)
    if array.dtype.kind == "O":
        array = _unboxed(array, value)
    if array.dtype.kind == "c" and (lost := np.isnan(array)).any():
        return np.where(lost, np.nan, _checks.real_array(name, np.where(lost, 0.0, array)))
    return array if array.dtype.kind in "biuf" else _checks.real_array(name, array)


def _unboxed(array: RealOrComplex, value: object) -> RealOrComplex:
    """Doubles of an array of Python numbers and marks of the missing; anything else is left for the check to refuse."""
    with suppress(TypeError, ValueError, OverflowError):
        if hasattr(value, "to_numpy"):
            # only the library of a data frame knows its own mark
            array = value.to_numpy(na_value=np.nan)
        if array.ndim and all(
            item is None or isinstance(item, numbers.Real | Decimal | np.bool_) for item in array.flat
        ):
            return array.astype(float)
    return array


class Signal(Protocol):
    """Samples read by slices: an array, or values computed on demand."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> Array: ...


@dataclass(frozen=True)
class Difference:
    """Residual of a signal (T,), measured less predicted, computed for the slice that is read."""

    measured: Array
    predicted: Array

    def __len__(self) -> int:
        return len(self.measured)

    def __getitem__(self, part: slice) -> Array:
        return self.measured[part] - self.predicted[part]


def blocks(samples: int, rows: int = 1) -> Iterator[slice]:
    """Consecutive slices of a record of `samples`, each of a size that `rows` signals fit into a few megabytes."""
    size = max(1, _BLOCK // max(1, rows))
    for first in range(0, samples, size):
        yield slice(first, min(first + size, samples))


def _size(record: InTime) -> int:
    """Number of samples whose inputs and outputs are together few enough to be searched; at least 2."""
    channels = record.u.size // max(1, record.samples) + record.y.size // max(1, record.samples)
    return max(2, LONG // max(1, channels))


def is_long(records: Sequence[CheckedData]) -> bool:
    """Whether a record is so long that modes are searched for in a part of it first."""
    return any(isinstance(record, InTime) and record.samples > _size(record) for record in records)


def searched_part(record: CheckedData, from_rest: bool = False) -> slice:
    """Samples in which modes are looked for: all, or of a long record those where the outputs move most.

    Of a plant at rest before the record it is the first one.
    """
    if not isinstance(record, InTime):
        return slice(0, record.samples)
    samples = record.samples
    y, size = np.atleast_2d(record.y), _size(record)
    if samples <= size or from_rest:
        return slice(0, min(samples, size))
    moved = np.zeros((len(y), -(-samples // size)))
    for k in range(moved.shape[1]):
        for part in blocks(min(size, samples - k * size), len(y)):
            moved[:, k] += _motion(y[:, k * size + part.start : k * size + part.stop])
    shares = moved / np.maximum(moved.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    first = min(int(np.argmax(shares.sum(axis=0))) * size, samples - size)
    return slice(first, first + size)


def _motion(y: RealOrComplex) -> Array:
    """Sum of `|y - mean|` of each output; not of squares, which a single outlier would dominate."""
    seen = ~np.isnan(y)
    values = np.where(seen, y, 0.0).astype(float)
    mean = values.sum(axis=1, keepdims=True) / np.maximum(seen.sum(axis=1, keepdims=True), 1)
    return np.sum(np.abs(values - mean), axis=1, where=seen)


def stages(part: slice, samples: int) -> Iterator[slice]:
    """Parts that contain one another, each twice as long, up to the whole: modes stay in their basins on the way."""
    size = part.stop - part.start
    while size < samples:
        size = min(2 * size, samples)
        first = min(max(0, (part.start + part.stop - size) // 2), samples - size)
        part = slice(first, first + size)
        yield part


def cut(record: object, part: slice) -> Any:
    """A part of a record, copied into memory as doubles if it is short; frequency responses are returned whole."""
    if not isinstance(record, InTime) or part == slice(0, record.samples):
        return record
    short = part.stop - part.start <= LONG
    u, y = (np.asarray(x[..., part], float if short else x.dtype) for x in (record.u, record.y))
    level = getattr(record, "level", None)
    changes = {} if level is None else {"level": level[:, part]}
    return replace(record, time=record.clock[part], u=u, y=y, **changes)  # type: ignore[type-var]

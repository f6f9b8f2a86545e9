"""Parts of records that are too long to be searched at once: modes are found in one, and followed to the whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ..._types import Array, NDArray
from .time_record import LONG, CheckedData, InTime

_BLOCK = 1 << 18  # numbers that are looked at at a time


class Signal(Protocol):
    """Samples read by slices: an array, or values computed on demand."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> NDArray[Any]: ...


@dataclass(frozen=True)
class Difference:
    """Residual of a signal (T,), measured less predicted, computed for the slice that is read."""

    measured: NDArray[Any]
    predicted: NDArray[Any]

    def __len__(self) -> int:
        return len(self.measured)

    def __getitem__(self, part: slice) -> NDArray[Any]:
        return self.measured[part] - self.predicted[part]


def blocks(samples: int, rows: int = 1) -> Iterator[slice]:
    """Consecutive slices of a record of `samples`, each of a size that `rows` signals fit into a few megabytes."""
    size = max(1, _BLOCK // max(1, rows))
    for first in range(0, samples, size):
        yield slice(first, min(first + size, samples))


def _size(record: InTime, numbers: int = LONG) -> int:
    """Number of samples whose inputs and outputs are together so many numbers; at least 2."""
    channels = record.u.size // max(1, record.samples) + record.y.size // max(1, record.samples)
    return max(2, numbers // max(1, channels))


def is_long(records: Sequence[CheckedData]) -> bool:
    """Whether a record is so long that modes are searched for in a part of it first."""
    return any(isinstance(record, InTime) and record.samples > _size(record) for record in records)


def searched_part(record: CheckedData, from_rest: bool = False, numbers: int = LONG) -> slice:
    """Samples in which modes are looked for: all, or of a long record those where the outputs move most.

    A part has at most so many numbers; of a plant at rest before the record it is the first one.
    """
    if not isinstance(record, InTime):
        return slice(0, record.samples)
    samples = record.samples
    y, size = np.atleast_2d(record.y), _size(record, numbers)
    if samples <= size or from_rest:
        return slice(0, min(samples, size))
    moved = np.zeros((len(y), -(-samples // size)))
    for k in range(moved.shape[1]):
        for part in blocks(min(size, samples - k * size), len(y)):
            moved[:, k] += _motion(y[:, k * size + part.start : k * size + part.stop])
    shares = moved / np.maximum(moved.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    first = min(int(np.argmax(shares.sum(axis=0))) * size, samples - size)
    return slice(first, first + size)


def _motion(y: NDArray[Any]) -> Array:
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


def cut(record: Any, part: slice) -> Any:
    """A part of a record, copied into memory as doubles if it is short; frequency responses are returned whole."""
    if not isinstance(record, InTime) or part == slice(0, record.samples):
        return record
    short = part.stop - part.start <= LONG
    u, y = (np.asarray(x[..., part], float if short else x.dtype) for x in (record.u, record.y))
    level = getattr(record, "level", None)
    changes = {} if level is None else {"levels": level[:, part]}
    return replace(record, time=record.clock[part], u=u, y=y, **changes)  # type: ignore[type-var]

"""Columns of a table: how the caller names them, what their labels tell, and errors that point at the place."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ... import _checks
from ..._checks import labelled, without_unit
from ..._types import Array, Mask
from ..._units import known_unit
from ...exceptions import FileFormatError, StructureError

_TIME_LABELS = frozenset(
    ["time", "times", "timestamp", "datetime", "timestamputc", "elapsedtime", "unixtime", "epoch", "zeitstempel"]
)
# of other languages, which are taken for a time beside a unit only
_TIME_WORDS = frozenset(
    ["zeit", "temps", "tiempo", "tempo", "tijd", "tid", "czas", "aika", "idő", "время", "时间", "時間"]
)
_SUFFIX = re.compile(r"(.+?)(?:\s*[/,_]\s*|\s+in\s+|\s+)([^\W\d_]+|rad_s)")  # a unit without brackets
_X_VALUE = "xvalue"  # the time of LabVIEW's text files, in seconds
_EPOCHS = {"s": (1e9, 1e10), "ms": (1e12, 1e13), "us": (1e15, 1e16), "ns": (1e18, 1e19)}  # 2001 to 2286


@dataclass(frozen=True)
class Table:
    """Columns of one length, with labels if there are any; subclasses hold the values."""

    path: str
    labels: tuple[str, ...] | None
    width: int
    step: float | None = field(default=None, kw_only=True)  # between samples, s, where the file itself declares it

    @property
    def count(self) -> int:
        """Number of rows."""
        raise NotImplementedError

    def columns(self, wanted: Sequence[int]) -> Array:
        """Values of the wanted columns: shape (number wanted, number of rows), NaN where a value is missing."""
        raise NotImplementedError

    def clock_columns(self) -> list[int]:
        """Columns that hold times of day, with or without a date."""
        return []

    def holds_numbers(self, column: int) -> bool:
        """Whether a column may be a signal."""
        raise NotImplementedError

    def is_empty(self, column: int) -> bool:
        """Whether a column has no value in the first and in the last row."""
        return False

    def holds_dates(self, column: int) -> bool:
        """Whether a column holds dates or times of day."""
        return column in self.clock_columns()

    def proposed_step(self) -> float | None:
        """Step that the file seems to tell, for messages."""
        return self.step

    def instants(self, column: int) -> tuple[Array, str | None]:
        """Instants in a column, and their unit if the file tells it."""
        values = self.columns([column])[0]
        label = self.labels[column] if self.labels else ""
        return values, unit_of_time(label) or _unit_of_epoch(label, values)

    def line(self, row: int) -> str:
        """Name a row."""
        return f"row {row}"

    def place_of(self, row: int, column: int) -> str:
        """Name a place: file, line and column."""
        return f"{self.path}, {self.line(row)}, {self.name(column)}"

    def name(self, column: int) -> str:
        """Name a column: its number and its label."""
        label = self.labels[column] if self.labels else ""
        return f"column {column} ({label!r})" if label else f"column {column}"

    def key(self, column: int) -> str | int:
        """Shortest choice of a column that `find` understands: its label without the unit, or its number."""
        label = without_unit(self.labels[column]) if self.labels else ""
        return label if label and len(label) <= 40 and labelled(label, self.labels or ()) == [column] else column

    def refuse(self, column: int, wrong: Mask, message: str, values: Array | None = None) -> None:
        """Refuse a column for the first of its rows that are wrong; the message may show the value there."""
        if wrong.any():
            row = int(np.argmax(wrong))
            shown = message if values is None else message.format(values[row])
            raise FileFormatError(f"{self.place_of(row, column)}: {shown}")

    def only(self, columns: list[int], role: str) -> int | None:
        """Return the one column that may have a role, if there is any."""
        if len(columns) > 1:
            names = " and ".join(map(self.name, columns))
            raise StructureError(
                f"{self.path}: {names} may both be the {role}; choose with {role}=, such as {role}="
                f"{self.key(columns[0])!r}"
            )
        return columns[0] if columns else None

    def refuse_repeats(self, columns: list[int]) -> None:
        """Refuse a column that is to have several roles."""
        for column in columns:
            if columns.count(column) > 1:
                raise StructureError(f"{self.path}: {self.name(column)} is chosen twice; give each its own")

    def listing(self) -> str:
        """Say which columns there are."""
        if self.labels is None:
            return f"the file has {self.width} columns without names; choose by number, 0 to {self.width - 1}"
        shown = [f"{j} {label!r}" for j, label in enumerate(self.labels[:30])]
        more = [f"and {self.width - 30} more"] if self.width > 30 else []
        return "the columns are " + ", ".join(shown + more)

    def find(self, wanted: Any, role: str) -> int:
        """Number of a column that the caller chose by label or number; `role` is the name of the argument."""
        if _checks.is_whole(wanted):
            if not 0 <= wanted < self.width:
                raise StructureError(f"{self.path}: {role}: there is no column number {wanted}; {self.listing()}")
            return int(wanted)
        if not isinstance(wanted, str):
            raise StructureError(f"{role} is {wanted!r}; give the label of a column or its number, counted from 0")
        matches = labelled(wanted, self.labels or ())
        if len(matches) > 1:
            numbers = " and ".join(map(str, matches))
            raise StructureError(f"{self.path}: {role}: columns {numbers} are all called {wanted!r}; choose by number")
        if matches:
            return matches[0]
        if wanted.isdecimal():
            return self.find(int(wanted), role)
        close = difflib.get_close_matches(wanted, self.labels or (), 1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        parts = wanted.split(",")
        if len(parts) > 1 and all(labelled(part, self.labels or ()) for part in parts):
            hint = "; several columns are passed as a list"
        raise StructureError(f"{self.path}: {role}: there is no column called {wanted!r}; {self.listing()}{hint}")

    def time_columns(self, needed: bool) -> list[int]:
        """Columns that may be the time: by label, else by times of day, else, where `needed`, by a unit of time."""
        # a time that is declared and left empty, as of files with a step above the table, is none
        labels = [(j, label) for j, label in enumerate(self.labels or ()) if not self.is_empty(j)]
        clocks = self.clock_columns()
        named = [j for j, label in labels if is_time_label(label)]
        # beside a column of dates, or one of numbers since the start, both may be called time
        for choice in ([j for j in named if j in clocks] if len(named) > 1 else [], named, clocks):
            if choice:
                return choice
        # a capital T is as often a period
        return [] if not needed else [j for j, label in labels if unit_of_time(label) and without_unit(label) != "T"]


@dataclass(frozen=True)
class ArrayTable(Table):
    """Columns of a binary file: numbers, or instants as `numpy.datetime64`."""

    arrays: tuple[Any, ...]

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.arrays[0])

    def columns(self, wanted: Sequence[int]) -> Array:
        """Values of the wanted columns, in the order of `wanted`."""
        for column in wanted:
            if self.arrays[column].dtype.kind not in "biuf":
                kind = self.arrays[column].dtype
                raise FileFormatError(f"{self.path}: {self.name(column)} holds {kind}, no numbers; choose another")
        return np.array([self.arrays[column] for column in wanted], dtype=float).reshape(len(wanted), -1)

    def holds_numbers(self, column: int) -> bool:
        """Whether a column may be a signal."""
        return self.arrays[column].dtype.kind in "biuf"

    def clock_columns(self) -> list[int]:
        """Columns of instants or durations."""
        return [j for j, values in enumerate(self.arrays) if values.dtype.kind in "mM"]

    def instants(self, column: int) -> tuple[Array, str | None]:
        """Instants in a column: those of a clock in seconds since the first."""
        values = self.arrays[column]
        if values.dtype.kind not in "mM":
            return super().instants(column)
        return np.asarray((values - values[:1]) / np.timedelta64(1, "s"), dtype=float), "s"


def is_time_label(label: str) -> bool:
    """Whether a column of this label holds instants; a capital T is as often a temperature or a torque."""
    bare, unit = name_and_unit(label, known_unit)
    word = _simplified(bare)
    known = bare == "t" or word in _TIME_LABELS or word == _X_VALUE
    return known or _is_spelt_unit(label) or bool(known_unit(unit) and word in _TIME_WORDS)


def unit_of_time(label: str) -> str | None:
    """Unit of time that a label tells, as `Time (ms)`, `t [s]`, `t / h`, `time/us` or `time_min` do; or None."""
    if _simplified(label) == _X_VALUE:
        return "s"
    return known_unit(label.strip() if _is_spelt_unit(label) else name_and_unit(label, known_unit)[1])


def name_and_unit(label: str, known: Callable[[str], str | None]) -> tuple[str, str]:
    """Label without its unit, and the unit; one that no bracket sets off must be `known`."""
    bare = without_unit(label)
    if bare == label.strip() and (match := _SUFFIX.fullmatch(bare)) and known(match[2]):
        return match[1], match[2]
    return bare, label.strip()[len(bare) :].strip(" []()/")


def _is_spelt_unit(label: str) -> bool:
    """Whether a unit of time stands in place of a label: `Second` does, `min` may be a minimum."""
    return len(label.strip()) > 4 and known_unit(label.strip()) is not None


def _simplified(label: str) -> str:
    return "".join(filter(str.isalpha, label.casefold()))


def _unit_of_epoch(label: str, values: Array) -> str | None:
    """Unit of instants since 1970, by their size, where the label says that they are such."""
    if not len(values) or not any(word in _simplified(label) for word in ("stamp", "epoch", "unix", "utc")):
        return None
    return next((unit for unit, (low, high) in _EPOCHS.items() if low <= values[0] < high), None)

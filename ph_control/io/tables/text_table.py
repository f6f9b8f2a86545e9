"""Text tables: from the bytes of a file to columns of doubles, with errors that point at the place.

`read_table` finds out how a file is laid out; `TextTable.columns` parses the columns that are wanted: clean blocks of
lines by `numpy.loadtxt`, the others field by field, to fill in what is missing and to say what is wrong.
"""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ... import _checks
from ..._display import counted
from ..._options import DECIMAL_MARKS
from ..._types import Array
from ...exceptions import FileFormatError, StructureError
from .columns import Table
from .instants import is_date, is_instant, seconds_since_first
from .layout import (
    COMMENTS,
    MISSING,
    NUMBER,
    Wanted,
    chosen_body,
    content_of,
    decimal_sign,
    find_bodies,
    find_layout,
    header_fields,
    kinds,
    labels_in_comment,
    split,
)

_BLOCK = 1024  # lines parsed at once: what one missing value costs
_LONGEST_HEADER = 20  # lines of labels in quotes
_SPELLED = {" ": "white space", "\t": "tab", ",": "comma", ";": "semicolon"}
# control characters that no text table holds; tab, line feed, form feed and carriage return are text
_CONTROL = bytes(set(range(32)) - {9, 10, 12, 13})
_RECORDER = {b"TDSm": "TDMS", b"PAR1": "Parquet", b"RIFF": "WAV", b"\x89HDF": "HDF5"}  # first bytes of a file
_FIELD = re.compile(r"[,;\t:=]")
_STEP = re.compile(r"increment|interval|delta_?[tx]|\bd[tx]\b|period", re.I)
_RATE = re.compile(r"rate|sampling freq|sample freq", re.I)


@dataclass(frozen=True)
class TextTable(Table):
    """A text table: its rows as lines of text, and how to read them."""

    rows: list[str]
    line_numbers: list[int]
    delimiter: str
    decimal: str
    preamble: list[str]

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def columns(self, wanted: Sequence[int]) -> Array:
        """Parse the wanted columns: shape (number wanted, number of rows), NaN where a value is missing."""
        out = np.empty((len(wanted), len(self.rows)))
        for start in range(0, len(self.rows), _BLOCK):
            stop = min(start + _BLOCK, len(self.rows))
            out[:, start:stop] = self._block(start, stop, wanted)
        return out

    def instants(self, column: int) -> tuple[Array, str | None]:
        """Instants in a column: times of day in seconds since the first."""
        if column not in self.clock_columns():
            return super().instants(column)
        fields = [split(row, self.delimiter)[column].strip() for row in self.rows]
        seconds, wrong = seconds_since_first(fields)
        if wrong is not None:
            example = f"is no instant as {fields[0]!r} in line {self.line_numbers[0]} is; correct it"
            raise FileFormatError(f"{self.place_of(wrong, column)}: {fields[wrong][:60]!r} {example}, or drop the row")
        return seconds, "s"

    def line(self, row: int) -> str:
        """Name a row by its line."""
        return f"line {self.line_numbers[row]}"

    def clock_columns(self) -> list[int]:
        """Columns whose first field is a time of day or a duration."""
        return [j for j, field in enumerate(self._first()) if is_instant(field)]

    def holds_numbers(self, column: int) -> bool:
        """Whether the first and the last field of a column are numbers, and no instants."""
        fields = [[*split(row, self.delimiter), ""][column].strip() for row in (self.rows[0], self.rows[-1])]
        return not any(map(is_instant, fields)) and kinds(fields, self.decimal) == "nn"

    def is_empty(self, column: int) -> bool:
        """Whether a column has no value in the first and in the last row."""
        return not any([*split(row, self.delimiter), ""][column].strip() for row in (self.rows[0], self.rows[-1]))

    def holds_dates(self, column: int) -> bool:
        """Whether the first field of a column is a date or a time of day."""
        return is_instant(self._first()[column]) or is_date(self._first()[column])

    def proposed_step(self) -> float | None:
        """Step, or inverse of a rate, that lines above the table seem to tell, for messages; or None."""
        lines = [[field.strip() for field in _FIELD.split(line)] for line in self.preamble]
        for fields, below in zip(lines, [*lines[1:], []], strict=False):
            for j, field in enumerate(fields):
                if _STEP.search(field) or _RATE.search(field):
                    # beside the word, or below it
                    values = [_leading_number(text) for text in (*fields[j + 1 : j + 2], *below[j : j + 1])]
                    value = next((number for number in values if number > 0), None)
                    if value is not None:
                        return 1 / value if _RATE.search(field) else value
        return None

    def _first(self) -> list[str]:
        return [field.strip() for field in split(self.rows[0], self.delimiter)][: self.width]

    def _block(self, start: int, stop: int, wanted: Sequence[int]) -> Array:
        rows = self.rows[start:stop]
        values = None if any('"' in row for row in rows) else _numbers(rows, self.delimiter, wanted, self.decimal)
        if values is None:
            table = [split(row, self.delimiter) for row in rows]
            values = np.array([[self._value(start + k, j, f[j]) for k, f in enumerate(table)] for j in wanted])
        return values

    def _value(self, row: int, column: int, field: str) -> float:
        text = field.strip()
        if NUMBER[self.decimal].fullmatch(text) and math.isfinite(value := float(text.replace(",", "."))):
            return value
        if text.casefold() in MISSING:
            return math.nan
        hint = "; put # in front of the line if it holds units" if row == 0 and self.labels else ""
        raise FileFormatError(f"{self.place_of(row, column)}: {_what_is_wrong(text, self.decimal)}{hint}")


@dataclass(frozen=True)
class TextOptions:
    """What a caller says about the layout of a text; None is found out."""

    header: bool | None = None
    delimiter: str | None = None
    decimal: str | None = None
    skiprows: int | None = None
    comment: str | None = None

    def __post_init__(self) -> None:
        if self.header is not None and not _checks.is_flag(self.header):
            raise StructureError(f"header is {_checks.shown(self.header)}; it must be True, False or None")
        sign: object = self.delimiter
        if sign is not None and (not isinstance(sign, str) or len(sign) != 1 or sign in '"\n\r.'):
            raise StructureError(f"delimiter is {sign!r}; it must be one character, such as ',' or ';' or a tab")
        if self.decimal is not None:
            _checks.choice("decimal", self.decimal, DECIMAL_MARKS)
        if self.skiprows is not None:
            _checks.whole_number("skiprows", self.skiprows, 0)
        if self.comment is not None and not isinstance(self.comment, str):
            raise StructureError(
                f"comment is {_checks.shown(self.comment)}; it must be the text that comments begin with, such as '//'"
            )

    @property
    def comments(self) -> tuple[str, ...]:
        """Starts of lines that are comments."""
        return COMMENTS if self.comment is None else (self.comment,) * bool(self.comment)


def read_table(data: bytes, name: str, options: TextOptions, wanted: Wanted | None = None) -> TextTable:
    """Find the layout of a table in the content of a file: separator, decimal sign, labels, number of columns.

    Of several tables the one whose labels are `wanted`, else the one of the most rows.
    """
    lines, content = _lines_of_table(data, name, options)
    delimiter = options.delimiter
    announced = re.fullmatch(r'"?sep=(.)"? *', lines[content[0]])
    if announced:
        delimiter, lines[content[0]] = delimiter or announced[1], ""
        content = content[1:]
    if not content:
        raise FileFormatError(f"{name} has no rows of numbers")
    layout = find_layout(lines, content, delimiter, options.decimal, options.comments)
    delimiter = layout.delimiter
    if delimiter == "\t":
        # a line of tabs is a row of missing values, not a blank line
        content = content_of(lines, options.comments, " ")
    while content and not lines[content[-1]].strip(delimiter + ' \t"'):
        content.pop()
    bodies = find_bodies(lines, content, layout, options.header)
    if not bodies:
        if not content:
            raise FileFormatError(f"{name} has no rows of numbers")
        raise FileFormatError(f"{name} has a header in line {content[0] + 1} and no rows of numbers below it")
    body = chosen_body(bodies, wanted)
    labels, rows, numbers = body.labels, [lines[k] for k in body.rows], [k + 1 for k in body.rows]
    decimal = decimal_sign(rows, delimiter) if options.decimal is None else options.decimal
    preamble = lines[: body.rows[0]]
    if labels is None and _has_header(name, rows, numbers, delimiter, decimal, options.header):
        labels = tuple(header_fields(rows.pop(0), delimiter))
        if not rows:
            raise FileFormatError(f"{name} has a header in line {numbers[0]} and no rows of numbers below it")
        del numbers[0]
    width = _width(name, rows, numbers, delimiter, labels)
    if labels is None and options.header is None:
        labels = labels_in_comment(lines, numbers[0] - 1, layout, width)
    return TextTable(name, labels and labels[:width], width, rows, numbers, delimiter, decimal, preamble)


def _lines_of_table(data: bytes, name: str, options: TextOptions) -> tuple[list[str], list[int]]:
    """Lines of a text, a header in one of them, and the indices of those that are neither blank nor comments."""
    if data[:64].lstrip()[:1] == b"{":
        raise FileFormatError(
            f"{name} holds JSON, perhaps a model, and a table of measurements is needed; ph-control info shows models"
        )
    lines = text_lines(data, name)
    skipped = min(options.skiprows or 0, len(lines))
    lines[:skipped] = [""] * skipped
    content = content_of(lines, options.comments)
    if content and _join_header(lines, content[0]):
        content = content_of(lines, options.comments)
    if not content:
        state = "holds only comments" if any(line.strip() for line in lines) else "is empty"
        state = f"has no lines below the {skipped} that skiprows= leaves out" if skipped else state
        raise FileFormatError(f"{name} {state}; it needs rows of numbers")
    arrows = [k for k in content if " -> " in lines[k]]
    if len(arrows) == len(content):
        # the serial monitor of Arduino puts the time of day and an arrow before each line
        separator = next((sign for sign in ";\t," if sign in lines[arrows[0]]), "\t")
        for k in arrows:
            lines[k] = lines[k].replace(" -> ", separator, 1)
    return lines, content


def _leading_number(text: str) -> float:
    """Number that a text begins with, or 0."""
    match = re.match(NUMBER["."].pattern, text.strip().strip('"'))
    value = float(match[0]) if match else 0.0
    return value if math.isfinite(value) else 0.0


def _join_header(lines: list[str], first: int) -> bool:
    """Join a header whose quoted labels go over several lines; these stay as blank ones."""
    parts = 1
    while '"' in lines[first] and " ".join(lines[first : first + parts]).count('"') % 2:
        parts += 1
        if parts > _LONGEST_HEADER or first + parts > len(lines):
            return False
    if parts > 1:
        lines[first : first + parts] = [" ".join(lines[first : first + parts]), *[""] * (parts - 1)]
    return parts > 1


def text_lines(data: bytes, name: str) -> list[str]:
    """Lines of a text in any usual encoding."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        with suppress(UnicodeDecodeError):
            data = data.decode("utf-16").encode()
    data = data.rstrip(b"\x1a")  # the mark of the end in old systems
    if len(data.translate(None, _CONTROL)) < len(data):
        if data[:4] in _RECORDER:
            raise FileFormatError(
                f"{name} is not a text file, but {_RECORDER[data[:4]]}; call ph_control.read_recording({name!r})"
            )
        raise FileFormatError(
            f"{name} is not a text file: it holds bytes that no text has; export it as CSV, as text in UTF-8"
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        # an older Western encoding; numbers are ASCII in all of them, and units such as ° and µ come out right
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _numbers(rows: list[str], delimiter: str, wanted: Sequence[int], decimal: str) -> Array | None:
    """Columns of rows by numpy, or None where they hold more than plain finite numbers and NaN."""
    if decimal == ",":
        text = "\n".join(rows)
        if "." in text or delimiter == ",":
            return None
        rows = text.replace(",", ".").split("\n")
    try:
        values = np.loadtxt(
            rows, delimiter=None if delimiter == " " else delimiter, usecols=wanted, comments=None, ndmin=2
        )
    except ValueError:
        return None
    return None if np.isinf(values).any() else values.T


def _has_header(
    path: str, rows: list[str], numbers: list[int], delimiter: str, decimal: str, header: bool | None
) -> bool:
    """Whether the first row of a table without words above it holds labels all the same."""
    if header is not None:
        return header
    fields = header_fields(rows[0], delimiter)
    first = kinds(fields, decimal)
    if not {"t", "n"} <= set(first):
        return "t" in first
    if len(rows) > 1 and kinds(split(rows[1], delimiter), decimal) == first:
        return False
    word, number = fields[first.index("t")], fields[first.index("n")]
    raise FileFormatError(
        f"{path}, line {numbers[0]} is neither a header nor a row of numbers: {number!r} in column {first.index('n')} "
        f"is a number, {word!r} in column {first.index('t')} is not; correct it, or "
        f"pass skiprows={numbers[0]} to leave it out, or pass header=True or header=False"
    )


def _width(path: str, rows: list[str], numbers: list[int], delimiter: str, labels: tuple[str, ...] | None) -> int:
    """Number of columns; an error if a row has another one.  An empty field at the end may be there or not."""
    sizes = [(len(fields), not fields[-1].strip()) for fields in (split(row, delimiter) for row in rows)]
    full, spare = sizes[0]
    if labels is not None:
        width = len(labels)
        if labels[-1] == "" and all(size == (width, True) for size in set(sizes)):
            width -= 1
    else:
        width = full - 1 if spare and all(empty for _, empty in set(sizes)) else full
    allowed = {(width, False), (width, True), (width + 1, True)}
    if width == 0 or set(sizes) <= allowed:
        return width
    row = next(k for k, size in enumerate(sizes) if size not in allowed)
    reference = "the header has" if labels is not None else f"line {numbers[0]} has"
    count = sizes[row][0]
    raise FileFormatError(
        f"{path}, line {numbers[row]}: {counted(count, 'field')}, but {reference} {width} (separator: "
        f"{_SPELLED.get(delimiter, repr(delimiter))}); complete the row, put # in front of a line that is no part of "
        "the table, leave out lines above it by skiprows=, or pass delimiter= if the separator is another"
    )


def _what_is_wrong(text: str, decimal: str) -> str:
    other = "." if decimal == "," else ","
    shown = repr(text if len(text) <= 60 else text[:57] + "...")
    if other in text and NUMBER[other].fullmatch(text):
        signs = {".": "a decimal point", ",": "a decimal comma"}
        return f"{shown} has {signs[other]}, but the numbers above have {signs[decimal]}; use one of them throughout"
    if NUMBER[decimal].fullmatch(text) or text.casefold().lstrip("+-") in ("inf", "infinity"):
        return (
            f"{shown} is not finite, or too large for a double; correct it, or leave the field empty if it is missing"
        )
    if re.fullmatch(r"\(?[-+0-9.eE ]+[ij]\)?", text):
        return f"{shown} is a complex number; give its real and its imaginary part a column each"
    if re.match(r"[0-9]+[:/-][0-9]", text):
        return f"{shown} is a date or a time of day; convert it to a number first, such as seconds from the start"
    return f"{shown} is not a number; correct it, or leave the field empty if the value is missing"

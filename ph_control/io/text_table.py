"""Text tables: from the bytes of a file to columns of doubles, with errors that point at the place.

`read_table` finds out how a file is laid out; `Table.columns` parses the columns that are wanted: clean blocks of lines
by `numpy.loadtxt`, the others field by field, to fill in what is missing and to say what is wrong.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _checks
from .._checks import labelled, without_unit
from .._display import counted
from .._types import Array, Mask
from .._units import UNIT, known_unit
from ..exceptions import FileFormatError, StructureError
from .files import read_bytes, source_name

_BLOCK = 1024  # lines parsed at once: what one missing value costs
_SAMPLE = 20  # lines that the layout is judged by
_COMMENTS = ("#", "%")
_MISSING = frozenset(
    ["", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "?", "nan(ind)", "-nan(ind)", "1.#qnan",
     "-1.#ind"]
)  # fmt: skip
_NUMBER = {
    ".": re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?"),
    ",": re.compile(r"[+-]?([0-9]+(,[0-9]*)?|,[0-9]+)([eE][+-]?[0-9]+)?"),
}
_LAYOUTS = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (" ", "."), (" ", ","), (",", ","))
_SPELLED = {" ": "white space", "\t": "tab", ",": "comma", ";": "semicolon"}
# control characters that no text table holds; tab, line feed, form feed and carriage return are text
_CONTROL = bytes(set(range(32)) - {9, 10, 12, 13})
_SUFFIX = re.compile(r"(.+?)(?:\s*[/,_]\s*|\s+in\s+|\s+)([^\W\d_]+|rad_s)")  # a unit without brackets
_HEADER_WORD = re.compile(r'"[^"]*"|\S+(?:\s+[\[(][^\])]*[\])])*')


@dataclass(frozen=True)
class Table:
    """A text table: its rows as lines of text, and how to read them."""

    path: str
    labels: tuple[str, ...] | None
    width: int
    rows: list[str]
    line_numbers: list[int]
    delimiter: str
    decimal: str

    def columns(self, wanted: Sequence[int]) -> Array:
        """Parse the wanted columns: shape (number wanted, number of rows), NaN where a value is missing."""
        out = np.empty((len(wanted), len(self.rows)))
        for start in range(0, len(self.rows), _BLOCK):
            stop = min(start + _BLOCK, len(self.rows))
            out[:, start:stop] = self._block(start, stop, wanted)
        return out

    def _block(self, start: int, stop: int, wanted: Sequence[int]) -> Array:
        rows = self.rows[start:stop]
        values = None if any('"' in row for row in rows) else _numbers(rows, self.delimiter, wanted, self.decimal)
        if values is None:
            table = [_split(row, self.delimiter) for row in rows]
            values = np.array([[self._value(start + k, j, f[j]) for k, f in enumerate(table)] for j in wanted])
        return values

    def _value(self, row: int, column: int, field: str) -> float:
        text = field.strip()
        if _NUMBER[self.decimal].fullmatch(text) and math.isfinite(value := float(text.replace(",", "."))):
            return value
        if text.casefold() in _MISSING:
            return math.nan
        hint = "; put # in front of the line if it holds units" if row == 0 and self.labels else ""
        raise FileFormatError(f"{self.at(row, column)}: {_what_is_wrong(text, self.decimal)}{hint}")

    def at(self, row: int, column: int) -> str:
        """Name a place: file, line and column."""
        return f"{self.path}, line {self.line_numbers[row]}, {self.name(column)}"

    def name(self, column: int) -> str:
        """Name a column: its number and its label."""
        label = self.labels[column] if self.labels else ""
        return f"column {column} ({label!r})" if label else f"column {column}"

    def refuse(self, column: int, wrong: Mask, message: str, values: Array | None = None) -> None:
        """Refuse a column for the first of its rows that are wrong; the message may show the value there."""
        if wrong.any():
            row = int(np.argmax(wrong))
            shown = message if values is None else message.format(values[row])
            raise FileFormatError(f"{self.at(row, column)}: {shown}")

    def only(self, columns: list[int], role: str) -> int | None:
        """Return the one column that may have a role, if there is any."""
        if len(columns) > 1:
            names = " and ".join(map(self.name, columns))
            raise StructureError(f"{self.path}: {names} may both be the {role}; choose with {role}=")
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
        if len(parts) > 1 and all(labelled(one, self.labels or ()) for one in parts):
            hint = "; several columns are passed as a list"
        raise StructureError(f"{self.path}: {role}: there is no column called {wanted!r}; {self.listing()}{hint}")


def is_time_label(label: str) -> bool:
    """Whether a column of this label holds instants; a capital T is as often a temperature or a torque."""
    bare, _ = name_and_unit(label, known_unit)
    return bare == "t" or bare.casefold() in ("time", "times", "timestamp")


def unit_of_time(label: str) -> str | None:
    """Unit of time that a label tells, as `Time (ms)`, `t [s]`, `t / h`, `time/us` or `time_min` do; or None."""
    return known_unit(name_and_unit(label, known_unit)[1])


def name_and_unit(label: str, known: Callable[[str], str | None]) -> tuple[str, str]:
    """Label without its unit, and the unit; one that no bracket sets off must be `known`."""
    bare = without_unit(label)
    if bare == label.strip() and (found := _SUFFIX.fullmatch(bare)) and known(found[2]):
        return found[1], found[2]
    return bare, label.strip()[len(bare) :].strip(" []()/")


def read_table(path: Any, header: bool | None, delimiter: str | None, decimal: str | None) -> Table:
    """Read a file and find its layout: separator, decimal sign, labels, number of columns."""
    _check_layout(header, delimiter, decimal)
    name = source_name(path)
    lines, content = _lines_of_table(read_bytes(path), name)
    announced = re.fullmatch(r'"?sep=(.)"? *', lines[content[0]])
    if announced:
        delimiter, lines[content[0]] = delimiter or announced[1], ""
        content = content[1:]
    sample = [lines[k] for k in content[:_SAMPLE]]
    delimiter = _delimiter(sample, delimiter, decimal)
    if delimiter == "\t":
        # a line of tabs is a row of missing values, not a blank line
        content = _content(lines, " ")
    while content and not lines[content[-1]].strip(delimiter + ' \t"'):
        content.pop()
    rows, numbers = [lines[k] for k in content], [k + 1 for k in content]
    decimal = _decimal(rows, delimiter) if decimal is None else decimal
    labels = None
    if rows and _has_header(name, rows, numbers, delimiter, decimal, header):
        labels = _take_header(name, rows, numbers, delimiter, decimal)
    if not rows:
        raise FileFormatError(f"{name} has no rows of numbers")
    width = _width(name, rows, numbers, delimiter, labels)
    if labels is None and header is None:
        labels = _labels_in_comment(lines, numbers[0] - 1, delimiter, width)
    return Table(name, labels and labels[:width], width, rows, numbers, delimiter, decimal)


def _lines_of_table(data: bytes, name: str) -> tuple[list[str], list[int]]:
    """Lines of a text, a header in one of them, and the indices of those that are neither blank nor comments."""
    if data[:64].lstrip()[:1] == b"{":
        raise FileFormatError(
            f"{name} holds JSON, perhaps a model, and a table of measurements is needed; ph-control info shows models"
        )
    lines = text_lines(data, name)
    content = _content(lines, None)
    if content and _join_header(lines, content[0]):
        content = _content(lines, None)
    if not content:
        state = "holds only comments" if any(line.strip() for line in lines) else "is empty"
        raise FileFormatError(f"{name} {state}; it needs rows of numbers")
    return lines, content


def _take_header(name: str, rows: list[str], numbers: list[int], delimiter: str, decimal: str) -> tuple[str, ...]:
    """Take the header, and a row of units below it, away from the rows; return the labels."""
    labels = tuple(_header_fields(rows.pop(0), delimiter))
    header_line = numbers.pop(0)
    if not rows:
        raise FileFormatError(f"{name} has a header in line {header_line} and no rows of numbers below it")
    units = _units(labels, rows, delimiter, decimal)
    if not units:
        return labels
    del rows[0], numbers[0]
    return tuple(f"{a} [{b}]" if a and b else a for a, b in zip(labels, units, strict=True))


def _join_header(lines: list[str], first: int) -> bool:
    """Join a header whose quoted labels go over several lines; these stay as blank ones."""
    parts = 1
    while '"' in lines[first] and " ".join(lines[first : first + parts]).count('"') % 2:
        parts += 1
        if parts > _SAMPLE or first + parts > len(lines):
            return False
    if parts > 1:
        lines[first : first + parts] = [" ".join(lines[first : first + parts]), *[""] * (parts - 1)]
    return parts > 1


def _check_layout(header: Any, delimiter: Any, decimal: Any) -> None:
    if header is not None and not _checks.is_flag(header):
        raise StructureError(f"header is {_checks.shown(header)}; it must be True, False or None")
    if delimiter is not None and (not isinstance(delimiter, str) or len(delimiter) != 1 or delimiter in '"\n\r.'):
        raise StructureError(f"delimiter is {delimiter!r}; it must be one character, such as ',' or ';' or a tab")
    if decimal is not None:
        _checks.choice("decimal", decimal, (".", ","))


def _content(lines: list[str], blanks: str | None) -> list[int]:
    """Indices of the lines that are neither blank nor comments."""
    return [k for k, line in enumerate(lines) if line.strip(blanks) and not line.lstrip().startswith(_COMMENTS)]


def text_lines(data: bytes, name: str) -> list[str]:
    """Lines of a text in any usual encoding."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        with suppress(UnicodeDecodeError):
            data = data.decode("utf-16").encode()
    data = data.rstrip(b"\x1a")  # the mark of the end in old systems
    if len(data.translate(None, _CONTROL)) < len(data):
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


def _split(row: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return row.split()
    if '"' in row:
        # a field that is longer than the module allows is no number: quotes that are never closed are letters
        with suppress(csv.Error):
            return next(csv.reader([row], delimiter=delimiter, skipinitialspace=True))
    return row.split(delimiter)


def _header_fields(row: str, delimiter: str) -> list[str]:
    fields = _HEADER_WORD.findall(row) if delimiter == " " else _split(row, delimiter)
    return [field.strip().strip('"').strip() for field in fields]


def _kinds(fields: Sequence[str], decimal: str) -> str:
    """One letter for each field: number, missing or text."""
    words = [field.strip() for field in fields]
    return "".join("m" if w.casefold() in _MISSING else "n" if _NUMBER[decimal].fullmatch(w) else "t" for w in words)


def _delimiter(sample: list[str], delimiter: str | None, decimal: str | None) -> str:
    """Separator that splits the sample into the most numbers; of those, into the fewest other fields."""
    if delimiter is not None:
        return " " if delimiter.isspace() and delimiter != "\t" else delimiter

    def score(layout: tuple[str, str]) -> tuple[int, int]:
        kinds = "".join(_kinds(_split(row, layout[0]), layout[1]) for row in sample)
        return kinds.count("n"), -kinds.count("t")

    best = max((layout for layout in _LAYOUTS if decimal in (None, layout[1])), key=score)
    if score(best)[0]:
        return best[0]
    # no numbers at all: only the words for the error are at stake
    return next((sign for sign in (";", "\t", ",") if sign in sample[0]), " ")


def _decimal(rows: list[str], delimiter: str) -> str:
    """Decimal sign of the first number that has one."""
    for row in rows:
        # in a file with commas between the fields only a quoted number can have a decimal comma
        for field in map(str.strip, _split(row, delimiter)) if "," in row or "." in row else ():
            for sign in ",.":
                if sign in field and _NUMBER[sign].fullmatch(field):
                    return sign
    return "."


def _has_header(
    path: str, rows: list[str], numbers: list[int], delimiter: str, decimal: str, header: bool | None
) -> bool:
    if header is not None:
        return header
    fields = _header_fields(rows[0], delimiter)
    first = _kinds(fields, decimal)
    if not {"t", "n"} <= set(first):
        return "t" in first
    if len(rows) > 1 and _kinds(_split(rows[1], delimiter), decimal) == first:
        return False
    word, number = fields[first.index("t")], fields[first.index("n")]
    raise FileFormatError(
        f"{path}, line {numbers[0]} is neither a header nor a row of numbers: {number!r} in column {first.index('n')} "
        f"is a number, {word!r} in column {first.index('t')} is not; correct it, or pass header=True or header=False"
    )


def _units(labels: Sequence[str], rows: list[str], delimiter: str, decimal: str) -> list[str] | None:
    """Units of the columns if the row below the labels holds nothing else, without any doubt; else None."""
    if any(without_unit(label) != label for label in labels) or len(rows) < 2:
        return None
    fields = [field.strip(' \t"') for field in _split(rows[0], delimiter)]
    units = ["" if field == "-" else re.sub(r"^(?:\[(.*)\]|\((.*)\))$", r"\1\2", field).strip() for field in fields]
    # an empty field at the end may be there or not
    units += [""] * (len(labels) - len(units) == 1 and not labels[-1])
    if len(units) != len(labels) or not any(units):
        return None
    if any(len(unit) > 30 or not UNIT.fullmatch(unit) for unit in units if unit):
        return None
    # a column with a unit holds numbers: letters above letters are a row of the table
    below = [_kinds(_split(row, delimiter), decimal) for row in rows[1:_SAMPLE]]
    seen = [{row[column : column + 1] for row in below} for column in range(len(units))]
    return units if all({"n"} <= kinds <= {"n", "m"} for kinds, unit in zip(seen, units, strict=True) if unit) else None


def _labels_in_comment(lines: list[str], first: int, delimiter: str, width: int) -> tuple[str, ...] | None:
    """Labels in a comment right above the numbers, as `numpy.savetxt` writes them."""
    above = lines[first - 1].strip() if first else ""
    if not above.startswith(_COMMENTS):
        return None
    text = above.lstrip("#% \t")
    # the comment need not be separated as the numbers are: words may be, with or without commas, between white space
    words = [label.rstrip(",;") for label in _header_fields(text, " ")]
    for labels in (_header_fields(text, delimiter), words) if delimiter != " " else (words,):
        if _kinds(labels, ".") == width * "t":
            return tuple(labels)
    return None


def _width(path: str, rows: list[str], numbers: list[int], delimiter: str, labels: tuple[str, ...] | None) -> int:
    """Number of columns; an error if a row has another one.  An empty field at the end may be there or not."""
    sizes = [(len(fields), not fields[-1].strip()) for fields in (_split(row, delimiter) for row in rows)]
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
        "the table, or pass delimiter= if the separator is another"
    )


def _what_is_wrong(text: str, decimal: str) -> str:
    other = "." if decimal == "," else ","
    shown = repr(text if len(text) <= 60 else text[:57] + "...")
    if other in text and _NUMBER[other].fullmatch(text):
        signs = {".": "a decimal point", ",": "a decimal comma"}
        return f"{shown} has {signs[other]}, but the numbers above have {signs[decimal]}; use one of them throughout"
    if _NUMBER[decimal].fullmatch(text) or text.casefold().lstrip("+-") in ("inf", "infinity"):
        return (
            f"{shown} is not finite, or too large for a double; correct it, or leave the field empty if it is missing"
        )
    if re.fullmatch(r"\(?[-+0-9.eE ]+[ij]\)?", text):
        return f"{shown} is a complex number; give its real and its imaginary part a column each"
    if re.match(r"[0-9]+[:/-][0-9]", text):
        return f"{shown} is a date or a time of day; convert it to a number first, such as seconds from the start"
    return f"{shown} is not a number; correct it, or leave the field empty if the value is missing"

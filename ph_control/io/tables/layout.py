"""Layout of a text table: its separator and decimal sign, where its rows begin, its labels and units.

Loggers write a preamble above the table, often as long as it.  The rows are those of the commonest number of fields
with numbers in the same places; the labels are the words above them.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

from ..._checks import without_unit
from ..._units import UNIT, known_unit
from .columns import is_time_label
from .instants import is_instant

COMMENTS = ("#", "%")
MISSING = frozenset(
    ["", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "?", "nan(ind)", "-nan(ind)", "1.#qnan",
     "-1.#ind"]
)  # fmt: skip
NUMBER = {
    ".": re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?"),
    ",": re.compile(r"[+-]?([0-9]+(,[0-9]*)?|,[0-9]+)([eE][+-]?[0-9]+)?"),
}
_LAYOUTS = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (" ", "."), (" ", ","), (",", ","))
_SAMPLE = 20  # lines at the begin and at the end that the separator is judged by
_LINES = 400  # over the file, that its rows are judged by
_ABOVE = 6  # lines above the rows of numbers, labels and units among them
_MOST_HEADERS = 3  # of these
_HEADER_WORD = re.compile(r'"[^"]*"|\S+(?:\s+[\[(][^\])]*[\])])*')


@dataclass(frozen=True)
class Layout:
    """Separator and decimal sign of a table, and the starts of comments."""

    delimiter: str
    decimal: str
    comments: tuple[str, ...]

    def fields(self, line: str) -> list[str]:
        """Fields of a line."""
        return split(line, self.delimiter)

    def kinds(self, line: str) -> str:
        """One letter for each field: number (or instant), missing or text."""
        return kinds(self.fields(line), self.decimal)

    def words(self, line: str) -> list[str]:
        """Fields of a line of labels."""
        return header_fields(line, self.delimiter)


@dataclass(frozen=True)
class Body:
    """Rows of a table, as indices of lines, and the labels above them."""

    rows: list[int]
    labels: tuple[str, ...] | None


@dataclass(frozen=True)
class _Shape:
    """Number of fields of the rows, and which of them hold numbers."""

    width: int
    numeric: tuple[int, ...]

    def fits(self, kinds: str) -> bool:
        """Whether a line has this shape, an empty field at its end apart."""
        size = len(kinds) - (len(kinds) == self.width + 1 and kinds.endswith("m"))
        return size == self.width and "n" in kinds and all(kinds[j] in "nm" for j in self.numeric)


def content_of(lines: Sequence[str], comments: tuple[str, ...], blanks: str | None = None) -> list[int]:
    """Indices of the lines that are neither blank nor comments."""
    return [
        k
        for k, line in enumerate(lines)
        if line.strip(blanks) and not (comments and line.lstrip().startswith(comments))
    ]


def split(row: str, delimiter: str) -> list[str]:
    """Fields of a line, those in quotes whole."""
    if delimiter == " ":
        return row.split()
    if '"' in row:
        # a field that is longer than the module allows is no number: quotes that are never closed are letters
        with suppress(csv.Error):
            return next(csv.reader([row], delimiter=delimiter, skipinitialspace=True))
    return row.split(delimiter)


def header_fields(row: str, delimiter: str) -> list[str]:
    """Labels in a line, without quotes."""
    fields = _HEADER_WORD.findall(row) if delimiter == " " else split(row, delimiter)
    return [field.strip().strip('"').strip() for field in fields]


def kinds(fields: Sequence[str], decimal: str) -> str:
    """One letter for each field: number (or instant), missing or text."""
    return "".join(_kind(field.strip(), decimal) for field in fields)


def _kind(word: str, decimal: str) -> str:
    if NUMBER[decimal].fullmatch(word):
        return "n"
    if word.casefold() in MISSING:
        return "m"
    return "n" if is_instant(word) else "t"


def find_layout(
    lines: Sequence[str], content: Sequence[int], delimiter: str | None, decimal: str | None, comments: tuple[str, ...]
) -> Layout:
    """Separator and decimal sign that split a sample into the most numbers; of those, into the fewest other fields."""
    chosen = content if len(content) <= 2 * _SAMPLE else [*content[:_SAMPLE], *content[-_SAMPLE:]]
    sample = [lines[k] for k in chosen]
    layouts = [layout for layout in _LAYOUTS if decimal in (None, layout[1])]
    if delimiter is not None:
        delimiter = " " if delimiter.isspace() and delimiter != "\t" else delimiter
        layouts = [(delimiter, sign) for sign in ".," if decimal in (None, sign)]

    def score(layout: tuple[str, str]) -> tuple[int, int, int]:
        rows = [kinds(split(row, layout[0]), layout[1]) for row in sample]
        letters = "".join(rows)
        # a number among many words is one of the preamble
        numbers = sum(row.count("n") for row in rows if row.count("n") > row.count("t"))
        return numbers, 0 if numbers else letters.count("n"), -letters.count("t")

    best = max(layouts, key=score)
    if delimiter is None and not any(score(best)[:2]):
        # no numbers at all: only the words for the error are at stake
        best = next((sign for sign in (";", "\t", ",") if sign in sample[0]), " "), decimal or "."
    return Layout(*best, comments)


@dataclass(frozen=True)
class _Words:
    """A line of words above a table, by columns."""

    line: int
    words: list[str]
    letters: str
    is_comment: bool

    @property
    def has_numbers(self) -> bool:
        return "n" in self.letters

    @property
    def names_time(self) -> bool:
        return any(map(is_time_label, self.words))

    @property
    def units(self) -> list[str | None]:
        """Of each column, empty for none; None for a word that is no unit."""
        return [_unit(word) for word in self.words]


@dataclass(frozen=True)
class _Header:
    """Labels with their units, if there are any, and the line from which on all belongs to the table."""

    labels: tuple[str, ...] | None = None
    below: int | None = None


@dataclass(frozen=True)
class _Text:
    """Lines of a file, the numbers of those with a content, and how they are laid out."""

    lines: Sequence[str]
    content: Sequence[int]
    layout: Layout

    def letters(self, k: int) -> str:
        """Kinds of the fields of a line with a content; none beyond the last."""
        return self.layout.kinds(self.lines[self.content[k]]) if k < len(self.content) else ""

    def words(self, k: int) -> list[str]:
        """A line with a content as one of labels."""
        return self.layout.words(self.lines[self.content[k]])

    def words_above(self, first: int, width: int) -> list[_Words]:
        """Lines of words above a line, as many as there are columns, the nearest first."""
        rows: list[_Words] = []
        above = (k for k in range(first - 1, -1, -1) if self.lines[k].strip())
        for k, _ in zip(above, range(_ABOVE), strict=False):
            words, comment = self.layout.words(self.lines[k]), _is_comment(self.lines[k], self.layout)
            # an empty label at the end, and a column of remarks that no row has
            words = words[:-1] if len(words) == width + 1 else words
            if len(words) != width and self.layout.delimiter == " ":
                # units in brackets are not those of labels before them
                words = self.lines[k].split()
            letters = kinds(words, self.layout.decimal)
            if len(words) == width and "t" in letters:
                rows.append(_Words(k, words, letters, comment))
            elif rows and not comment:
                break
        rows = rows[:_MOST_HEADERS]
        while rows and rows[-1].is_comment:
            rows.pop()
        return rows

    def header_above(self, first: int, width: int) -> _Header:
        """Labels above a line, with the units below them."""
        rows = self.words_above(first, width)
        if not rows or rows[0].has_numbers:
            return _Header()
        place = _place_of_labels(rows)
        labels = rows[place].words
        if place == 0:
            return _Header(tuple(labels))
        units = self.units_of(rows[place - 1].units, first)
        if units is None:
            # words that are no units stay, to be refused
            return _Header(tuple(labels), rows[place].line + 1)
        return _Header(tuple(
            f"{label} [{unit}]" if label and unit and without_unit(label) == label else label
            for label, unit in zip(labels, units, strict=True)
        ))  # fmt: skip

    def units_of(self, units: list[str | None], first: int) -> list[str | None] | None:
        """Units, if at least half of the words are such, above columns of numbers that begin in a line; else None."""
        if not any(units) or 2 * sum(map(bool, units)) < sum(unit != "" for unit in units):
            return None
        # a column with a unit holds numbers: letters above letters are a row of the table
        below = filter(str.strip, self.lines[first : first + _SAMPLE])
        rows = [self.layout.kinds(row) for row in below if not _is_comment(row, self.layout)]
        seen = [{row[column : column + 1] for row in rows} for column, unit in enumerate(units) if unit]
        return units if all({"n"} <= letters <= {"n", "m", ""} for letters in seen) else None


def find_bodies(lines: Sequence[str], content: Sequence[int], layout: Layout, header: bool | None) -> list[Body]:
    """Rows of the commonest shapes, that of most numbers first; none where no line has a number."""
    text = _Text(lines, content, layout)
    step = max(1, len(content) // _LINES)
    places = sorted({*range(0, len(content), step), *range(min(_SAMPLE, len(content)))})
    rows = [kind for kind in map(text.letters, places) if "n" in kind]
    numbers: Counter[_Shape] = Counter()
    for kind in rows:
        numbers[_Shape(len(kind), tuple(j for j, letter in enumerate(kind) if letter != "t"))] += kind.count("n")
    return [body for shape, _ in numbers.most_common(4) for body in _bodies(text, shape, header)]


def _bodies(text: _Text, shape: _Shape, header: bool | None) -> list[Body]:
    """Rows of one shape, the longest table first: a line of words below a blank one begins another."""
    content, count = text.content, len(text.content)
    first = next((k for k in range(count) if shape.fits(text.letters(k))), count)
    starts = [
        k for k in range(first + 1, count)
        if not all(line.strip() for line in text.lines[content[k - 1] + 1 : content[k]])
        and "t" in text.letters(k) and "n" not in text.letters(k)
    ]  # fmt: skip
    tables = (replace(text, content=content[start:stop]) for start, stop in pairwise([0, *starts, count]))
    bodies = (_body(table, shape, header) for table in tables)
    return sorted((body for body in bodies if body), key=lambda body: len(body.rows), reverse=True)


def _body(text: _Text, shape: _Shape, header: bool | None) -> Body | None:
    """Rows of one shape in a table, from the first to the last, and their labels."""
    count, width, layout = len(text.content), shape.width, text.layout
    first = next((k for k in range(count) if shape.fits(text.letters(k))), None)
    if first is None:
        return None
    behind = next(k for k in range(count, 0, -1) if shape.fits(text.letters(k - 1)))
    # a row with numbers of which one is wrong is a row
    first = _upward(first, lambda k: len(text.words(k)) == width and "n" in kinds(text.words(k), layout.decimal))
    # so is a row of missing values
    top = _upward(first, lambda k: set(text.letters(k)) == {"m"} and len(text.letters(k)) in (width, width + 1))
    headed = _Header() if header is False else text.header_above(text.content[top], width)
    if headed.labels is None and top:
        headed = _Header() if header is False else text.header_above(text.content[first], width)
        top = first
    if headed.below is not None:
        below = headed.below
        top = _upward(top, lambda k: text.content[k] >= below)
    labels = headed.labels
    if labels is None and header is not False and top == 1:
        # a single line above numbers whose fields are others in number, or in quotes that are left open
        headline = text.words(0)
        labels = tuple(headline) if len(headline) > 1 or text.lines[text.content[0]].count('"') % 2 else None
    # what begins with words behind the table is left out; a row that is cut or wrong is left to be refused
    after, place = text.letters(behind), shape.numeric[0] if shape.numeric else 0
    stop = behind if len(after) != width and after[place : place + 1] in ("t", "") else count
    return Body(list(text.content[top:stop]), labels)


def _upward(k: int, belongs: Callable[[int], bool]) -> int:
    """Go up from a line as long as the one above belongs to it."""
    while k and belongs(k - 1):
        k -= 1
    return k


def _place_of_labels(rows: Sequence[_Words]) -> int:
    """Which of the lines of words above a table, the nearest first, holds the labels."""
    if len(rows) > 1:
        nearest, above = rows[0].units, rows[1].units
        units = 0 if rows[0].names_time else sum(map(bool, nearest))
        mostly = 2 * units >= sum(unit != "" for unit in nearest) and units > sum(map(bool, above))
        if None not in nearest or (units and mostly):
            return 1
    return next((k for k, row in enumerate(rows) if row.names_time and not row.has_numbers), 0)


def _unit(word: str) -> str | None:
    """Unit that a field below a label tells, empty for none; None for a field that is no unit."""
    text = word.strip(' \t"')
    text = "" if text in ("-", "#") else re.sub(r"^(?:\[(.*)\]|\((.*)\))$", r"\1\2", text).strip()
    spellings = [text, text.lower()] if text.isalpha() and len(text) > 2 else [text]
    known = not text or (len(text) <= 30 and any(map(UNIT.fullmatch, spellings)))
    return text if known or known_unit(text) else None


def _is_comment(line: str, layout: Layout) -> bool:
    return bool(layout.comments) and line.lstrip().startswith(layout.comments)


def labels_in_comment(lines: Sequence[str], first: int, layout: Layout, width: int) -> tuple[str, ...] | None:
    """Labels in a comment right above the numbers, as `numpy.savetxt` writes them."""
    above = lines[first - 1].strip() if first else ""
    if not above.startswith(COMMENTS):
        return None
    text = above.lstrip("#% \t")
    # the comment need not be separated as the numbers are: words may be, with or without commas, between white space;
    # a # with a separator behind it is the label of a column of numbers of rows
    words = [label.rstrip(",;") for label in header_fields(text, " ")]
    splits = [words] if layout.delimiter == " " else [layout.words(text), words, layout.words(above)]
    return next((tuple(labels) for labels in splits if kinds(labels, ".") == width * "t"), None)


def decimal_sign(rows: Sequence[str], delimiter: str) -> str:
    """Decimal sign of the first number that has one."""
    for row in rows:
        # in a file with commas between the fields only a quoted number can have a decimal comma
        for field in map(str.strip, split(row, delimiter)) if "," in row or "." in row else ():
            for sign in ",.":
                if sign in field and NUMBER[sign].fullmatch(field):
                    return sign
    return "."


Wanted = Callable[[tuple[str, ...]], bool]


def chosen_body(bodies: Sequence[Body], wanted: Wanted | None) -> Body:
    """Body whose labels are the wanted ones, or else that of the most rows."""
    return next((body for body in bodies if wanted and body.labels and wanted(body.labels)), bodies[0])

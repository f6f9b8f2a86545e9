"""Text with the coefficients of a transfer function, or with modes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ..exceptions import FileFormatError

_COMMENT = re.compile(r"[#%].*|//.*")
_NAMED = re.compile(r"\s*([A-Za-z]\w*)\s*[:=,;\s]\s*(.*)")
_SEPARATOR = re.compile(r"\s*[,;]\s*|\s+")
_MEANING = {
    "num": "num", "numerator": "num", "den": "den", "denominator": "den", "d": "d", "r": "r",
}  # fmt: skip
_ADVICE = (
    "a model as text is two lines, the numerator and the denominator, highest power first, such as 'num 1 0' and "
    "'den 1 0 4'"
)


def table_of_coefficients(content: bytes, name: str) -> dict[str, list[float]]:
    """Named lists of numbers: a line for each, or a column for each under a header."""
    lines = _lines(content, name)
    header = [word.strip('"').casefold() for word in _SEPARATOR.split(lines[0][1].strip())]
    if len(header) > 1 and all(word in _MEANING for word in header):
        return _columns([_MEANING[word] for word in header], lines[1:], name)
    if len(lines) != 2:
        recording = "; ph-control fit reads recordings" if len(lines) > 2 else ""
        raise FileFormatError(f"{name} has {len(lines)} line{'s' * (len(lines) != 1)} of text; {_ADVICE}{recording}")
    found: dict[str, list[float]] = {}
    for default, (number, line) in zip(("num", "den"), lines, strict=True):
        key, rest = default, line
        if (named := _NAMED.fullmatch(line.strip())) and named[1].casefold() not in ("nan", "inf", "infinity"):
            key, rest = _MEANING.get(named[1].casefold(), ""), named[2]
        if not key or key in found:
            raise FileFormatError(
                f"{name}, line {number}: {_shown(line)} is {'there twice' if key else 'not known'}; {_ADVICE}"
            )
        with _at(name, number):
            found[key] = list_of_numbers(rest)
    return found


def _lines(content: bytes, name: str) -> list[tuple[int, str]]:
    """Lines with content and their numbers, comments taken away."""
    try:
        text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text or any(ord(sign) < 32 and sign not in "\t\n\r\f" for sign in text):
        raise FileFormatError(f"{name} is neither JSON nor a .mat file nor a text; pass a model in one of these forms")
    # a tab at the start of a line may stand for an empty field
    lines = [(k, _COMMENT.sub("", line).strip(" ")) for k, line in enumerate(text.splitlines(), 1)]
    lines = [(k, line) for k, line in lines if line.strip()]
    if not lines:
        raise FileFormatError(f"{name} holds only comments; {_ADVICE}")
    return lines


def list_of_numbers(text: str) -> list[float]:
    """Numbers between commas, semicolons or white space, one of these throughout, in brackets or not."""
    inside = text.strip().rstrip(";").strip().removeprefix("[").removesuffix("]").strip()
    if not inside:
        raise FileFormatError("there are no numbers")
    signs = {found.strip() for found in _SEPARATOR.findall(inside)}
    if len(signs) > 1:
        # a decimal comma would make two numbers of one
        listed = " and ".join(sorted(sign or "space" for sign in signs))
        raise FileFormatError(
            f"{_shown(inside)} has {listed} between its numbers; write decimal points, and one of them"
        )
    return [_number(word) for word in _SEPARATOR.split(inside)]


def _number(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise FileFormatError(f"{_shown(word)} is not a number") from None
    if value - value != 0:
        raise FileFormatError(f"{_shown(word)} is not finite, or too large")
    return value


@contextmanager
def _at(name: str, line: int) -> Iterator[None]:
    """Say where what is wrong stands, and what is needed."""
    try:
        yield
    except FileFormatError as error:
        raise FileFormatError(f"{name}, line {line}: {error}; {_ADVICE}") from None


def _columns(keys: list[str], lines: Sequence[tuple[int, str]], name: str) -> dict[str, list[float]]:
    """Lists below one another; the shorter ends earlier."""
    found: dict[str, list[float]] = {key: [] for key in keys}
    if len(found) < len(keys):
        raise FileFormatError(f"{name}: two columns have the same name; {_ADVICE}")
    ended: set[str] = set()
    for number, line in lines:
        words = re.split(r"[,;\t]", line) if re.search(r"[,;\t]", line) else line.split()
        if len(words) > len(keys):
            raise FileFormatError(f"{name}, line {number}: {len(words)} fields for {len(keys)} columns; correct it")
        for key, word in zip(keys, [*words, *[""] * (len(keys) - len(words))], strict=True):
            if not word.strip():
                ended.add(key)
            elif key in ended:
                raise FileFormatError(f"{name}, line {number}: the column {key} goes on after a gap; fill it in")
            else:
                with _at(name, number):
                    found[key].append(_number(word.strip()))
    return found


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:37] + "...")


def rows_of(fields: dict[str, Any], separator: str) -> str:
    """Lines of named numbers, each with the shortest digits that give it again."""
    rows = [separator.join([key, *(repr(float(x)) for x in values)]) for key, values in fields.items()]
    return "\n".join(rows) + "\n"


def columns_of(fields: dict[str, Any], separator: str) -> str:
    """The same as columns of one length under a header."""
    rows = [separator.join(repr(float(x)) for x in row) for row in zip(*fields.values(), strict=True)]
    return "\n".join([separator.join(fields), *rows]) + "\n"

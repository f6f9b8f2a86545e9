"""SPICE netlists as lists of elements."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from typing import Any

from .. import _checks
from ..exceptions import FileFormatError
from ..io.files import read_bytes, source_name
from .elements import Element

_SUFFIXES = {
    "t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "mil": 25.4e-6, "m": 1e-3, "u": 1e-6, "\u00b5": 1e-6, "\u03bc": 1e-6,
    "n": 1e-9, "p": 1e-12, "f": 1e-15,
}  # fmt: skip
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)(meg|mil|[tgkmunpf\u00b5\u03bc])?([a-z\u03a9\u2126%]*)")
# number of words between name and value
_NODES = {"R": 2, "L": 2, "C": 2, "K": 2, "E": 4, "F": 3, "V": 2, "I": 2}
# lines that change no element
_ANALYSES = {
    ".ac", ".dc", ".end", ".endc", ".four", ".ic", ".meas", ".measure", ".nodeset", ".noise", ".op", ".option",
    ".options", ".plot", ".print", ".probe", ".pz", ".save", ".sens", ".temp", ".tf", ".title", ".tran", ".width",
}  # fmt: skip
_GROUND = {"gnd", "0"}

Line = tuple[int, str]


def content_of(source: str | os.PathLike[str] | Any) -> tuple[str, str]:
    """Text of a netlist and what to call it: the text itself if it has several lines, else what the file holds."""
    if isinstance(source, str) and "\n" in source:
        return source, "the netlist"
    raw = read_bytes(source)
    name = source_name(source)
    if b"\0" in raw:
        raise FileFormatError(f"{name} is not text; a netlist is a text file, as SPICE programs read it")
    try:
        return raw.decode("utf-8-sig"), name
    except UnicodeDecodeError:
        return raw.decode("latin-1"), name


def elements_of(text: str, name: str) -> list[Element]:
    """Elements of a netlist in their order; sources without what they are set to."""
    found: dict[str, Element] = {}
    for count, (number, line) in enumerate(_lines(text)):
        where = f"{name}, line {number}: {_shown(line)}"
        words = line.replace("=", " = ").replace(",", " ").split() or [line]
        if words[0].startswith("."):
            if words[0].lower() == ".end":
                break
            if words[0].lower() not in _ANALYSES:
                raise FileFormatError(f"{where}: {words[0]} is not read; write the elements out, with numbers")
            continue
        try:
            element = _element(words, where)
        except FileFormatError:
            if count == 0 and number == 1:  # the title
                continue
            raise
        if element.name.upper() in found:
            raise FileFormatError(f"{where}: there is another {element.name}; give each element a name of its own")
        found[element.name.upper()] = element
    if not found:
        raise FileFormatError(f"{name} has no elements; lines such as 'R1 1 0 50' are read")
    return list(found.values())


def _lines(text: str) -> Iterator[Line]:
    """Lines with their numbers, without comments and control blocks, continuation lines joined."""
    joined: list[Line] = []
    control = False
    for number, raw in enumerate(text.splitlines(), start=1):
        line = re.split(r";|(?:^|\s)\$(?:\s|$)|(?:^|\s)//", raw, maxsplit=1)[0].strip()
        if line.lower().split()[:1] in ([".control"], [".endc"]):
            control = line.lower().startswith(".control")
        elif line.startswith("+"):
            if not joined:
                raise FileFormatError(f"line {number}: {_shown(line)} continues no line")
            joined[-1] = joined[-1][0], f"{joined[-1][1]} {line[1:]}"
        elif line and not line.startswith("*") and not control:
            joined.append((number, line))
    yield from joined


def _element(words: list[str], where: str) -> Element:
    letter = words[0][0].upper()
    if letter not in _NODES:
        raise FileFormatError(f"{where}: {words[0]} is no {', '.join(_NODES)}; a linear circuit has such elements only")
    count = _NODES[letter]
    if len(words) < count + 1 + (letter not in "VI"):
        what = "two inductors" if letter == "K" else f"{count} nodes" if letter != "F" else "two nodes and a source"
        value = "" if letter in "VI" else " and a value"
        raise FileFormatError(f"{where}: {letter} needs a name, {what}{value}")
    nodes = tuple(_node(word) for word in words[1 : count + 1])
    if letter in "VI":
        return Element(words[0], nodes, 0.0)
    if len(words) > count + 2:
        extra = " ".join(words[count + 2 :])
        raise FileFormatError(f"{where}: {extra!r} after the value is not read; give one number, such as 4.7k or 10u")
    return Element(words[0], nodes, _value(letter, words[count + 1], where))


def _node(word: str) -> str:
    lower = word.lower()
    return "0" if lower in _GROUND else lower


def _value(letter: str, word: str, where: str) -> float:
    match = _NUMBER.fullmatch(word.lower())
    if match is None:
        raise FileFormatError(f"{where}: {word!r} is not a number; write 4700, 4.7k, 4.7e3; m is 1e-3, meg 1e6")
    value = float(match[1]) * _SUFFIXES.get(match[2] or "", 1.0)
    if match[2] and match[2] not in ("meg", "mil"):  # rounded once, as 4.7e3 would be
        exponent = round(math.log10(_SUFFIXES[match[2]]))
        digits, _, power = match[1].partition("e")
        value = float(f"{digits}e{int(power or 0) + exponent}")
    if letter in "RLC" and not _checks.SMALLEST <= value <= 1 / _checks.SMALLEST:
        raise FileFormatError(f"{where}: the value is {value:g}; {letter} must be positive and finite")
    if letter == "K" and not 0 < abs(value) < 1:
        raise FileFormatError(
            f"{where}: the coupling is {value:g}; it must be between 0 and 1, both excluded: coils without any leakage "
            "have no flux linkages of their own"
        )
    if not math.isfinite(value):
        raise FileFormatError(f"{where}: the value is {value:g}; it must be finite")
    return value


def _shown(line: str) -> str:
    return repr(line if len(line) < 80 else f"{line[:77]}...")

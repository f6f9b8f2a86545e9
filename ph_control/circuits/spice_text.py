"""Lines of a SPICE netlist, and the blocks of subcircuits that they make."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, Any

from ..exceptions import FileFormatError
from ..io.files import read_bytes, source_name
from .expressions import shown

# lines that change no element
_ANALYSES = {
    ".ac", ".backanno", ".dc", ".disto", ".endc", ".fft", ".four", ".graph", ".ic", ".meas", ".measure", ".model",
    ".net", ".nodeset", ".noise", ".op", ".opt", ".option", ".options", ".plot", ".print", ".probe", ".protect", ".pz",
    ".save", ".savebias", ".sens", ".sp", ".step", ".temp", ".tf", ".title", ".tnom", ".tran", ".unprotect", ".wave",
    ".width",
}  # fmt: skip
_OTHER_FILES = {".include", ".inc", ".incl", ".lib", ".endl"}
_WORD = re.compile(r"\{(?:[^{}]|\{[^{}]*\})*\}|'[^']*'|=|[^\s=,{}']+|[{}']")
_ASSIGNED = re.compile(r"([a-z_][\w.]*)\s*=(?!=)", re.IGNORECASE)
_GROUND = {"gnd", "0"}


@dataclass(frozen=True)
class Card:
    """A line with its continuations, as words; `where` names it in errors."""

    words: tuple[str, ...]
    where: str
    first: bool  # of the text, where a title may stand


@dataclass(frozen=True)
class Block:
    """Elements, parameters and subcircuits between `.subckt` and `.ends`, or those of the whole text."""

    name: str
    where: str
    nodes: tuple[str, ...] = ()
    outer: Block | None = None
    defaults: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, str] = field(default_factory=dict)
    cards: list[Card] = field(default_factory=list)
    inner: dict[str, Block] = field(default_factory=dict)

    def subcircuit(self, name: str) -> Block | None:
        """Subcircuit of a name: one that is defined in this block, or in one around it."""
        block: Block | None = self
        while block is not None:
            if name.lower() in block.inner:
                return block.inner[name.lower()]
            block = block.outer
        return None


def content_of(source: str | os.PathLike[str] | IO[Any]) -> tuple[str, str]:
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


def blocks_of(text: str, name: str) -> tuple[Block, set[str]]:
    """Block of the whole text, and the nodes that are the same in all subcircuits."""
    block, shared = Block("", name), set(_GROUND)
    for count, (number, line) in enumerate(_lines(text)):
        where = f"{name}, line {number}: {shown(line)}"
        words = tuple(_WORD.findall(line)) or (line,)
        command = words[0].lower()
        if not command.startswith("."):
            block.cards.append(Card(words, where, first=count == 0 and number == 1))
        elif command == ".end":
            break
        elif command in (".subckt", ".macro"):
            block = _opened(block, line, where)
        elif command in (".ends", ".eom"):
            if block.outer is None:
                raise FileFormatError(f"{where}: {words[0]} ends no subcircuit; put .subckt before it, or delete it")
            block = block.outer
        elif command in (".param", ".params", ".parameter"):
            _define(block.parameters, line.partition(words[0])[2], where)
        elif command == ".global":
            shared |= {word.lower() for word in words[1:]}
        elif command in _OTHER_FILES:
            raise FileFormatError(
                f"{where}: {words[0]} names another file, and no other file is opened; put its text in the place of "
                "this line"
            )
        elif command not in _ANALYSES:
            raise FileFormatError(f"{where}: {words[0]} is not read; write the elements out, with numbers")
    if block.outer is not None:
        raise FileFormatError(f"{block.where}: the subcircuit has no end; put a line .ends after its elements")
    return block, shared


def node_of(word: str) -> str:
    """Name of a node; names are the same in capital and small letters, and ground has several."""
    lower = word.lower()
    return "0" if lower in _GROUND else lower


def _opened(outer: Block, line: str, where: str) -> Block:
    """A new block, known to the one around it."""
    words = [word for word in _before_assignments(line).replace(",", " ").split()[1:] if word.lower() != "params:"]
    if not words:
        raise FileFormatError(f"{where}: a subcircuit needs a name and its nodes, as in .subckt filter in out")
    name, *nodes = words
    if "optional:" in map(str.lower, nodes):
        raise FileFormatError(f"{where}: optional nodes are not read; give the subcircuit all of its nodes")
    if name.lower() in outer.inner:
        raise FileFormatError(f"{where}: there is another subcircuit {name}; give each a name of its own")
    nodes = [node_of(word) for word in nodes]
    if len(set(nodes)) < len(nodes):
        raise FileFormatError(f"{where}: a node is named twice; give each node of the subcircuit a name of its own")
    block = Block(name, where, tuple(nodes), outer)
    _define(block.defaults, line[len(_before_assignments(line)) :], where)
    outer.inner[name.lower()] = block
    return block


def _before_assignments(line: str) -> str:
    match = _ASSIGNED.search(line)
    return line if match is None else line[: match.start()]


def _define(parameters: dict[str, str], text: str, where: str) -> None:
    """Add the assignments `name = expression` of a line."""
    matches = list(_ASSIGNED.finditer(text))
    if text.strip() and (not matches or text[: matches[0].start()].strip(" \t,")):
        raise FileFormatError(f"{where}: write parameters as name=value")
    for k, match in enumerate(matches):
        end = matches[k + 1].start() if k + 1 < len(matches) else len(text)
        name, value = match[1].lower(), text[match.end() : end].strip(" \t,")
        if name in parameters:
            raise FileFormatError(f"{where}: {match[1]} is set twice; set each parameter once")
        parameters[name] = value


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments and control blocks, continuation lines joined."""
    joined: list[tuple[int, str]] = []
    control = False
    for number, raw in enumerate(text.splitlines(), start=1):
        line = re.split(r";|(?:^|\s)\$(?:\s|$)|(?:^|\s)//", raw, maxsplit=1)[0].strip()
        if line.lower().split()[:1] in ([".control"], [".endc"]):
            control = line.lower().startswith(".control")
        elif line.startswith("+"):
            if control:
                continue
            if not joined:
                raise FileFormatError(f"line {number}: {shown(line)} continues no line")
            joined[-1] = joined[-1][0], f"{joined[-1][1]} {line[1:]}"
        elif line and not line.startswith("*") and not control:
            joined.append((number, line))
    yield from joined

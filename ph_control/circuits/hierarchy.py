"""Elements of a netlist: subcircuits in the place of their calls, parameters by their values, wires as one node."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

from .. import _checks
from ..exceptions import FileFormatError
from .elements import Element
from .expressions import CONSTANTS, evaluate, unwrapped, value_of
from .spice_text import Block, Card, blocks_of, node_of

_DEPTH = 40  # of subcircuits in each other, and of parameters that follow from each other
_MOST = 100_000  # elements
# number of words between name and value
_NODES = {"R": 2, "L": 2, "C": 2, "K": 2, "E": 4, "F": 3, "V": 2, "I": 2}
_REFUSED = {
    "D": "a diode", "Q": "a bipolar transistor", "M": "a MOSFET", "J": "a field-effect transistor",
    "Z": "a field-effect transistor", "G": "a controlled source", "H": "a controlled source",
    "B": "a source given by a formula", "A": "a model in code", "S": "a switch", "W": "a switch or a line",
    "T": "a transmission line", "O": "a transmission line", "U": "a line or a digital part", "Y": "a line",
    "P": "a line", "N": "a model in code",
}  # fmt: skip
# what stands beside a value: a part that is not ideal; what scales it; and what is passed over
_PARTS = {"L": ("rser", "rpar", "cpar"), "C": ("rser", "lser", "rpar", "cpar", "rlshunt"), "V": ("rser", "cpar")}
_SCALES = ("m", "scale")
_PASSED = {
    "ic", "temp", "dtemp", "tc", "tc1", "tc2", "noisy", "noise", "tol", "mfg", "pn", "type", "irms", "ipk", "vpk",
    "pwr", "v", "dev", "lot",
}  # fmt: skip


def elements_of(text: str, name: str) -> list[Element]:
    """Elements of a netlist in their order; sources without what they are set to.

    Elements of subcircuits are named as in ngspice: `R.X1.R2` is R2 of the call X1; a node `mid` there is `x1.mid`.
    """
    whole, shared = blocks_of(text, name)
    scope = _Scope(whole.parameters, None, {})
    placed = _Placed(whole, scope, "", {node: node_of(node) for node in shared}, shared, iter(range(_MOST)))
    try:
        elements = list(_elements(placed))
    except RecursionError:
        raise FileFormatError(f"{name}: parameters follow from too many others in turn; write their values") from None
    if not elements:
        inside = ", ".join(block.name for block in whole.inner.values())
        raise FileFormatError(
            f"{name} defines the subcircuit {inside} and calls none; add a source and a line such as 'X1 1 0 {inside}'"
            if inside else f"{name} has no elements; lines such as 'R1 1 0 50' are read"
        )  # fmt: skip
    return _without_wires(elements)


class _Scope:
    """Parameters by their names, each computed when it is first used."""

    def __init__(self, texts: Mapping[str, str], outer: _Scope | None, given: Mapping[str, float]) -> None:
        self._texts, self.outer, self._values = texts, outer, dict(given)
        self._open: set[str] = set()

    def __call__(self, name: str) -> float:
        """Value of a parameter of this block, or of one around it."""
        if name in self._values:
            return self._values[name]
        if name not in self._texts:
            if self.outer is not None:
                return self.outer(name)
            if name in CONSTANTS:
                return CONSTANTS[name]
            raise FileFormatError(f"{name!r} is neither a number nor a parameter; define it: .param {name}=1")
        if name in self._open or len(self._open) > _DEPTH:
            raise FileFormatError(f"the parameter {name} follows from itself, or from over {_DEPTH} others in turn")
        self._open.add(name)
        try:
            self._values[name] = evaluate(unwrapped(self._texts[name]), self)
        except FileFormatError as error:
            known = "(in the parameter" in str(error)
            raise FileFormatError(str(error) if known else f"{error} (in the parameter {name})") from None
        finally:
            self._open.discard(name)
        return self._values[name]


@dataclass(frozen=True)
class _Placed:
    """A block where it is called: its parameters, its path, and the nodes outside by those inside."""

    block: Block
    parameters: _Scope
    path: str
    nodes: Mapping[str, str]
    shared: set[str]
    budget: Iterator[int]  # one for each line that is still allowed
    parallel: float = 1.0  # so many side by side
    depth: int = 0

    def node(self, word: str) -> str:
        name = node_of(word)
        prefix = f"{self.path.lower()}." if self.path else ""
        return self.nodes.get(name, f"{prefix}{name}")

    def name(self, word: str) -> str:
        return f"{word[0]}.{self.path}.{word}" if self.path else word


def _elements(placed: _Placed) -> Iterator[Element]:
    """Elements of a block and of those that it calls."""
    names: set[str] = set()
    for card in placed.block.cards:
        name, made, called = card.words[0], list[Element](), None
        if next(placed.budget, None) is None:
            raise FileFormatError(f"{card.where}: with all subcircuits there are over {_MOST} elements; leave some out")
        try:
            if name[0] in "xX":
                called = _called(card, placed)
            else:
                made = list(_of_card(card, placed))
        except FileFormatError as error:
            if card.first:  # the title
                continue
            raise FileFormatError(f"{card.where}: {error}") from None
        if name.upper() in names:
            raise FileFormatError(f"{card.where}: there is another {name}; give each element a name of its own")
        names.add(name.upper())
        yield from made if called is None else _elements(called)


def _of_card(card: Card, placed: _Placed) -> Iterable[Element]:
    letter = card.words[0][0].upper()
    if letter not in _NODES:
        what = f"is {_REFUSED[letter]}" if letter in _REFUSED else f"is no {', '.join(_NODES)}, X"
        raise FileFormatError(
            f"{card.words[0]} {what}; a linear circuit of R, L, C, K and sources is read: leave it out, or put its "
            "linear equivalent in its place"
        )
    words, options = _options(card.words)
    if letter in "VI":
        return _source(letter, words, options, placed)
    if letter == "K":
        return _couplings(words, options, placed)
    if letter in "EF":
        return [_controlled(letter, words, options, placed)]
    return _element(letter, words, options, placed)


def _options(words: tuple[str, ...]) -> tuple[list[str], dict[str, str]]:
    """Words by their places, and those that stand behind a name and `=`."""
    plain: list[str] = []
    options: dict[str, str] = {}
    k = 0
    while k < len(words):
        if words[k + 1 : k + 2] == ("=",):
            if k + 2 >= len(words):
                raise FileFormatError(f"{words[k]}= has no value")
            options[words[k].lower()] = words[k + 2]
            k += 3
        else:
            plain += [words[k]] if words[k] != "=" else []
            k += 1
    return plain, options


# --- elements ----------------------------------------------------------------------------------------------------


def _element(letter: str, words: list[str], options: dict[str, str], placed: _Placed) -> Iterator[Element]:
    """R, L or C; a coil or capacitor that is not ideal is several elements."""
    if len(words) == 3 and letter.lower() in options:
        words = [*words, options.pop(letter.lower())]
    value = _value_of(letter, words, placed)
    parts = _values_of(letter, options, placed)
    name, begin, end = placed.name(words[0]), placed.node(words[1]), placed.node(words[2])
    parallel = placed.parallel * parts.get("m", 1.0)
    series = [(letter, name, value * parts.get("scale", 1.0))]
    series += [(key[0].upper(), f"{key.capitalize()}.{name}", parts[key]) for key in ("rser", "lser") if parts.get(key)]
    inner = [begin, *(f"{name.lower()} {k}" for k in range(1, len(series))), end]
    for k, (kind, part, size) in enumerate(series):
        yield _checked(kind, part, (inner[k], inner[k + 1]), size, parallel)
        if part.startswith("Lser.") and "rlshunt" in parts:
            yield _checked("R", f"Rlshunt.{name}", (inner[k], inner[k + 1]), parts["rlshunt"], parallel)
    for key in ("rpar", "cpar"):
        if parts.get(key):
            yield _checked(key[0].upper(), f"{key.capitalize()}.{name}", (begin, end), parts[key], parallel)


def _controlled(letter: str, words: list[str], options: dict[str, str], placed: _Placed) -> Element:
    """Half of an ideal transformer: E with its controlling nodes, F with its controlling source."""
    value = _value_of(letter, words, placed)
    _values_of(letter, options, placed)
    if placed.parallel != 1:
        raise FileFormatError(f"{letter} in a subcircuit with m={placed.parallel:g} is not read; write the calls out")
    nodes = [placed.node(word) for word in words[1 : _NODES[letter] + 1]]
    if letter == "F":
        nodes[2] = placed.name(words[3])
    return Element(placed.name(words[0]), tuple(nodes), value)


def _value_of(letter: str, words: list[str], placed: _Placed) -> float:
    """Value behind the nodes, of which nothing else may stand."""
    count = _NODES[letter]
    if len(words) < count + 2:
        what = f"{count} nodes" if letter != "F" else "two nodes and a source"
        raise FileFormatError(f"{letter} needs a name, {what} and a value")
    if len(words) > count + 2:
        extra = " ".join(words[count + 2 :])
        raise FileFormatError(f"{extra!r} after the value is not read; give one number, such as 4.7k or 10u")
    return value_of(words[count + 1], placed.parameters)


def _checked(letter: str, name: str, nodes: tuple[str, str], value: float, parallel: float) -> Element:
    """Element of a value that is not negative; so many side by side."""
    value = value * parallel if letter == "C" else value / parallel
    if value < 0:
        raise FileFormatError(
            f"{name} is {value:g}; {letter} must not be negative: it would supply energy, and the circuit would not be "
            "passive"
        )
    if value and not _checks.SMALLEST <= value <= 1 / _checks.SMALLEST:
        raise FileFormatError(f"{name} is {value:g}; {letter} must be 0, or between 1e-300 and 1e300")
    return Element(name, nodes, value)


def _values_of(letter: str, options: dict[str, str], placed: _Placed) -> dict[str, float]:
    """Values of the options that are read; those that change nothing are passed over, and others refused."""
    known = (*_PARTS.get(letter, ()), *(_SCALES if letter in "RLC" else ()))
    values: dict[str, float] = {}
    for name, text in options.items():
        if name in known:
            values[name] = value_of(text, placed.parameters)
            if not 0 <= values[name] or (not values[name] and name not in ("rser", "lser", "cpar")):
                raise FileFormatError(f"{name} is {values[name]:g}; it must be positive")
        elif name not in _PASSED:
            hint = f"; read are {', '.join(known)}" if known else ""
            raise FileFormatError(f"{name}={text} is not read{hint}")
    return values


def _source(letter: str, words: list[str], options: dict[str, str], placed: _Placed) -> Iterator[Element]:
    """A port; what the source is set to does not matter, but for a resistance and a capacitance of its own."""
    if len(words) < 3:
        raise FileFormatError(f"{letter} needs a name and 2 nodes")
    if placed.parallel != 1:
        raise FileFormatError(f"a source in a subcircuit with m={placed.parallel:g} is not read; write the calls out")
    name, nodes = placed.name(words[0]), (placed.node(words[1]), placed.node(words[2]))
    parts = _values_of(letter, {key: options[key] for key in _PARTS.get(letter, ()) if key in options}, placed)
    inner = f"{name.lower()} 1" if parts.get("rser") else nodes[0]
    yield Element(name, (inner, nodes[1]), 0.0)
    if parts.get("rser"):
        yield _checked("R", f"Rser.{name}", (nodes[0], inner), parts["rser"], 1.0)
    if parts.get("cpar"):
        yield _checked("C", f"Cpar.{name}", nodes, parts["cpar"], 1.0)


def _couplings(words: list[str], options: dict[str, str], placed: _Placed) -> Iterator[Element]:
    """Coupling of each pair of the coils that are named."""
    text = options.pop("k") if "k" in options else words.pop() if len(words) > 3 else None
    if text is None or len(words) < 3:
        raise FileFormatError("K needs a name, two inductors and a value")
    _values_of("K", options, placed)
    value = value_of(text, placed.parameters)
    if not abs(value) <= 1:
        raise FileFormatError(f"the coupling is {value:g}; it must be between -1 and 1")
    for first, second in combinations(words[1:], 2):
        yield Element(placed.name(words[0]), (placed.name(first), placed.name(second)), value)


# --- subcircuits -------------------------------------------------------------------------------------------------


def _called(card: Card, placed: _Placed) -> _Placed:
    """The subcircuit of a call, in its place."""
    words, options = _options(tuple(word for word in card.words if word.lower() != "params:"))
    if len(words) < 2:
        raise FileFormatError("X needs a name, its nodes and the name of a subcircuit")
    name, *outside, called = words
    block = placed.block.subcircuit(called)
    if block is None:
        raise FileFormatError(
            f"there is no subcircuit {called}; put its text, from .subckt to .ends, into the netlist: no other file is "
            "opened"
        )
    if len(outside) != len(block.nodes):
        raise FileFormatError(f"{called} has {len(block.nodes)} nodes, and {name} gives {len(outside)}")
    if placed.depth >= _DEPTH:
        raise FileFormatError(f"{called} calls itself, or more than {_DEPTH} subcircuits lie in each other")
    nodes = {node: placed.node(node) for node in placed.shared}
    for inside, word in zip(block.nodes, outside, strict=True):
        if inside in placed.shared and placed.node(word) != nodes[inside]:
            raise FileFormatError(
                f"node {inside} of {called} is the same everywhere, and {name} joins it to {word}; call it otherwise"
            )
        nodes[inside] = placed.node(word)
    given = {key: evaluate(unwrapped(text), placed.parameters) for key, text in options.items()}
    parallel = 1.0 if "m" in block.defaults else given.pop("m", 1.0)
    if not parallel > 0:
        raise FileFormatError(f"m is {parallel:g}; it must be positive")
    around = _scope_around(block, placed)
    scope = _Scope({**block.defaults, **block.parameters}, around, given)
    path = f"{placed.path}.{name}" if placed.path else name
    return _Placed(
        block, scope, path, nodes, placed.shared, placed.budget, placed.parallel * parallel, placed.depth + 1
    )


def _scope_around(block: Block, placed: _Placed) -> _Scope | None:
    """Parameters that a subcircuit sees beside its own: those of the block in which it is defined."""
    scope: _Scope | None = placed.parameters
    here: Block | None = placed.block
    while here is not None and here is not block.outer:
        here = here.outer
        scope = None if scope is None else scope.outer
    return scope


# --- wires -------------------------------------------------------------------------------------------------------


def _without_wires(elements: list[Element]) -> list[Element]:
    """Elements between nodes that no wire joins: R = 0 and L = 0 make two nodes one, and C = 0 is nothing."""
    coupled = {
        name.upper() for element in elements if element.letter == "K" and element.value for name in element.nodes
    }
    wires = [element for element in elements if element.letter in "RL" and not element.value]
    for wire in wires:
        if wire.name.upper() in coupled:
            raise FileFormatError(f"{wire.name} is 0 and coupled; give it an inductance, or delete its coupling")
    first: dict[str, str] = {}

    def end(node: str) -> str:
        while node in first:
            node = first[node]
        return node

    for wire in wires:
        # ground keeps its name, and otherwise the node of which the wire begins
        kept, gone = sorted(map(end, wire.nodes), key=lambda node: node != "0")
        if kept != gone:
            first[gone] = kept
    ends = {"K": 0, "F": 2}
    return [
        replace(
            element,
            nodes=(*map(end, element.nodes[: ends.get(element.letter)]), *element.nodes[ends.get(element.letter, 4) :]),
        )
        for element in elements
        if element.value or element.letter not in "RLCK"
    ]

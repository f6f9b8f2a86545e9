"""Numbers of SPICE with their suffixes, and plain arithmetic of them and of parameters.

Nothing is executed: an expression becomes a syntax tree, of which the nodes of arithmetic are computed and all others
refused.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable

from ..exceptions import FileFormatError

Lookup = Callable[[str], float]

_SUFFIXES = {
    "t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "mil": 25.4e-6, "m": 1e-3, "u": 1e-6, "\u00b5": 1e-6, "\u03bc": 1e-6,
    "n": 1e-9, "p": 1e-12, "f": 1e-15,
}  # fmt: skip
_UNSIGNED = r"((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)(meg|mil|[tgkmunpf\u00b5\u03bc])?([a-z\u03a9\u2126%]*)(?![\w.])"
_NUMBER = re.compile(rf"([+-]?){_UNSIGNED}")
_TOKEN = re.compile(rf"\s*(?:{_UNSIGNED}|([a-z_][\w.]*)|(\*\*|\^|[-+*/(),]))")
_NAME = re.compile(r"[a-z_][\w.]*")
_LONGEST = 2000  # characters of an expression
_OPERATIONS: dict[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: math.pow, ast.UAdd: operator.pos, ast.USub: operator.neg,
}  # fmt: skip
FUNCTIONS: dict[str, Callable[..., float]] = {
    "abs": abs, "sqrt": math.sqrt, "exp": math.exp, "ln": math.log, "log": math.log, "log10": math.log10,
    "min": min, "max": max, "pow": math.pow, "sin": math.sin, "cos": math.cos, "tan": math.tan,
}  # fmt: skip
CONSTANTS = {"pi": math.pi}


def number(word: str) -> float | None:
    """Value of a word that is a number with a suffix and a unit, as `4.7k` or `10uF`; None of any other."""
    match = _NUMBER.fullmatch(word.lower())
    return None if match is None else _scaled(match[1] + match[2], match[3])


def value_of(word: str, lookup: Lookup) -> float:
    """Value of a word: a number, a parameter, or an expression in braces or single quotation marks."""
    plain = number(word)
    if plain is not None:
        return plain
    inner = unwrapped(word)
    if inner == word and not _NAME.fullmatch(word.lower()):
        raise FileFormatError(
            f"{word!r} is not a number; write 4700, 4.7k, 4.7e3 (m is 1e-3, meg 1e6), or arithmetic in braces"
        )
    return evaluate(inner, lookup)


def unwrapped(text: str) -> str:
    """Text without the braces or quotation marks around it."""
    text = text.strip()
    while len(text) > 1 and text[0] + text[-1] in ("{}", "''"):
        text = text[1:-1].strip()
    return text


def evaluate(text: str, lookup: Lookup) -> float:
    """Value of an expression of numbers, parameters, `+ - * / ** ^`, parentheses and `FUNCTIONS`."""
    if len(text) > _LONGEST:
        raise FileFormatError(f"an expression has {len(text)} characters; it may have {_LONGEST}")
    python = _as_python(text, lookup)
    try:
        result = _computed(ast.parse(python, mode="eval").body)
    except (SyntaxError, RecursionError, MemoryError):
        raise FileFormatError(
            f"{shown(text)} is no arithmetic of numbers and parameters; write for example {{2*R1/3}}"
        ) from None
    except (ZeroDivisionError, OverflowError, ValueError, TypeError) as error:
        raise FileFormatError(f"{shown(text)} cannot be computed: {error}") from None
    if not math.isfinite(result):
        raise FileFormatError(f"{shown(text)} is {result:g}; it must be finite")
    return result


def shown(text: str) -> str:
    """Text of a line for a message, cut where it is long."""
    return repr(text if len(text) < 80 else f"{text[:77]}...")


def _as_python(text: str, lookup: Lookup) -> str:
    """Expression with the values of numbers and parameters in their places."""
    lower, pieces, start = text.lower().strip(), list[str](), 0
    powers = [False]  # in each parenthesis that is open: whether a power came before, of the same term
    while start < len(lower):
        match = _TOKEN.match(lower, start)
        if match is None:
            raise FileFormatError(
                f"{shown(text)} has {lower[start:].strip()[:1]!r}; read are numbers, parameters, + - * / ** ( ) and "
                f"{', '.join(FUNCTIONS)}"
            )
        start = match.end()
        digits, suffix, _, name, symbol = match.groups()
        if digits:
            value = _scaled(digits, suffix)
            if not math.isfinite(value):
                raise FileFormatError(f"{shown(text)} has the number {digits}; it must be finite")
            pieces.append(repr(value))
        elif symbol:
            symbol = "**" if symbol == "^" else symbol
            if symbol == "**" and powers[-1]:  # programs differ in where they begin
                raise FileFormatError(f"{shown(text)} has a power of a power; put one of them in parentheses")
            if symbol == "(":
                powers.append(False)
            elif symbol == ")":
                powers = powers[:-1] or [False]
            elif pieces and pieces[-1] != "**":  # no sign of an exponent
                powers[-1] = symbol == "**"
            pieces.append(symbol)
        elif name in FUNCTIONS and lower[start:].lstrip().startswith("("):
            pieces.append(name)
        else:
            pieces.append(f"({lookup(name)!r})")
    return " ".join(pieces)


def _computed(node: ast.AST) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, float):
        return node.value
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](_computed(node.left), _computed(node.right))
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](_computed(node.operand))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return float(FUNCTIONS[node.func.id](*map(_computed, node.args)))
    raise SyntaxError


def _scaled(digits: str, suffix: str | None) -> float:
    """Number with its suffix, rounded once, as `4.7e3` would be."""
    if not suffix:
        return float(digits)
    if suffix == "mil":
        return float(digits) * _SUFFIXES[suffix]
    mantissa, _, power = digits.partition("e")
    return float(f"{mantissa}e{int(power or 0) + round(math.log10(_SUFFIXES[suffix]))}")

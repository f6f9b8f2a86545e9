"""Options that commands share: one name and one meaning wherever they appear."""

from __future__ import annotations

import argparse
import csv
import difflib
import math
import re
import textwrap
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from .._options import (
    DECIMAL_MARKS,
    DISCRETISATIONS,
    FREQUENCY_UNITS,
    INTERPOLATIONS,
    MAGNITUDE_UNITS,
    NETWORK_PARAMETERS,
    PHASE_UNITS,
)
from .outcome import BAD, complain

_WIDTH = 88  # characters of running text in a help
_NUMBER = re.compile(r"^-\.?[0-9]")
_SEPARATOR = re.compile(r"\s*[,;]\s*|\s+")
_PARTS = {"real": "real part", "imag": "imaginary part"}


class Parser(argparse.ArgumentParser):
    """Parser whose errors take one line, and that takes `-1,0` for a value."""

    def __init__(self, help: str | None, epilog: str = "", **settings: Any) -> None:
        # the docstring of a command is its help; python -OO has none
        description, _, examples = (help or "").partition("\nExamples\n--------\n")
        parts = [textwrap.fill(" ".join(text.split()), _WIDTH) for text in (description, epilog)]
        super().__init__(
            description=parts[0], epilog=f"{parts[1]}\n\nexamples:\n{examples}".strip("\n"),
            formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **settings,
        )  # fmt: skip
        # polynomials begin with negative numbers, and no option does
        self._negative_number_matcher = _NUMBER

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse, positional arguments anywhere among the options, with a proposal for one that is spelt wrong."""
        parsed, extra = self.parse_known_intermixed_args(words)
        if extra:
            known = [name for action in self._actions for name in action.option_strings]
            close = difflib.get_close_matches(extra[0].split("=")[0], known, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            self.error(f"{extra[0]} is not an option or argument of this command{hint}")
        return parsed

    def error(self, message: str) -> NoReturn:
        """One line, and where to read on."""
        complain(f"{message}; see {self.prog} --help")
        raise SystemExit(BAD)


# --- types of values -------------------------------------------------------------------------------------------------


def order(text: str) -> str | int:
    """Number of modes, or 'auto'."""
    return text if text == "auto" else int(text)


def within(kind: Callable[[str], float], low: float, high: float) -> Callable[[str], float]:
    """Type of a number from `low` to `high`; of others the library says what they may be."""

    def number(text: str) -> float:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not between {low:g} and {high:g}")
        return value

    return number


def system_name(text: str) -> str:
    """Name of a system."""
    if not text or "." in text:
        raise argparse.ArgumentTypeError(f"{text!r} is not a name; it needs a letter, and must have no dots")
    return text


def numbers(text: str) -> list[float]:
    """Numbers between commas, semicolons or spaces, in brackets or not."""
    try:
        return list_of_numbers(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error}; write for example 1,0,4") from None


def pair(text: str) -> tuple[float, float]:
    """Two numbers."""
    values = numbers(text)
    if len(values) != 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not two numbers, such as 0.1,10")
    return values[0], values[1]


def names(text: str) -> list[str]:
    """Names between commas; one that has a comma itself stands in double quotes."""
    listed = [name.strip() for name in next(csv.reader([text], skipinitialspace=True), [])]
    if not listed or not all(listed):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of names, such as force1,force2")
    return listed


def size(text: str) -> tuple[float, float]:
    """Width and height in inches."""
    sides = pair(text)
    if not all(1 <= side <= 100 for side in sides):
        raise argparse.ArgumentTypeError(f"{text!r} is not width,height of 1 to 100 inches, such as 8,5")
    return sides


def list_of_numbers(text: str) -> list[float]:
    """Finite numbers between commas, semicolons or white space, one of these throughout, in brackets or not."""
    inside = text.strip().rstrip(";").strip().removeprefix("[").removesuffix("]").strip()
    if not inside:
        raise ValueError("there are no numbers")
    signs = {separator.strip() for separator in _SEPARATOR.findall(inside)}
    if len(signs) > 1:
        # a decimal comma would make two numbers of one
        listed = " and ".join(sorted(sign or "space" for sign in signs))
        raise ValueError(f"{inside!r} has {listed} between its numbers; use one separator, and decimal points")
    return [_number(word) for word in _SEPARATOR.split(inside)]


def _number(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise ValueError(f"{word!r} is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"{word!r} is not finite, or too large")
    return value


# --- groups of options -----------------------------------------------------------------------------------------------


def add_json(parser: argparse._ActionsContainer) -> None:
    """How the answer is given."""
    parser.add_argument("--json", action="store_true", help="print the answer as JSON with all digits")


def add_written(parser: argparse._ActionsContainer) -> None:
    """What commands that write files take, and how they answer."""
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
    add_json(parser)


def add_labels(parser: Parser) -> None:
    """Models, and their names."""
    parser.add_argument("models", nargs="*", metavar="MODEL", help="models; ph-control info --help lists the formats")
    parser.add_argument(
        "--label", action="append", metavar="NAME", help="name of a model, in order (default: the file)"
    )


def add_recording(parser: Parser) -> None:
    """How tables are read, in time and in frequency."""
    table = parser.add_argument_group(
        "recordings",
        "text tables: columns by name or number from 0, between commas, semicolons, tabs or spaces;\n"
        "times of day and units are read; .tdms, .parquet, .wav;\n"
        ".mat, .h5: variables by name; .uff, .unv: places such as 3+Z",
    )
    table.add_argument("--input", metavar="COLUMN", help="input column")
    table.add_argument("--output", metavar="COLUMN", help="output column")
    table.add_argument("--inputs", type=names, metavar="LIST", help="columns of several inputs, such as force1,force2")
    table.add_argument("--outputs", type=names, metavar="LIST", help="columns of several outputs")
    table.add_argument("--no-input", action="store_true", help="free motion, without an input")
    table.add_argument("--time", metavar="COLUMN", help="time column")
    table.add_argument("--no-time", action="store_true", help="the table has no time column; needs --dt")
    table.add_argument("--dt", type=float, metavar="STEP", help="sampling interval of a table without a time column")
    table.add_argument(
        "--time-unit", metavar="UNIT",
        help="unit of time: ns, us, ms, s, min or h (default: from the column name)",
    )  # fmt: skip
    table.add_argument("--delimiter", metavar="CHARACTER", help="column separator (default: detected)")
    table.add_argument("--decimal", choices=DECIMAL_MARKS, help="decimal mark (default: detected)")
    table.add_argument(
        "--header", action=argparse.BooleanOptionalAction, help="whether the first row holds names (default: detected)"
    )
    table.add_argument(
        "--skiprows", type=int, metavar="COUNT", help="lines to leave out at the begin (default: the table is found)"
    )
    table.add_argument("--comment", metavar="TEXT", help="start of comment lines (default: # and %%)")
    response = parser.add_argument_group(
        "frequency responses",
        "tables with frequency, and magnitude and phase or real and imaginary part;\n.uff, .unv; Touchstone (.s1p, "
        ".s2p, ...); .mat: --frequency and --outputs name variables",
    )
    for role in ("frequency", "magnitude", "phase", "real", "imag"):
        part = _PARTS.get(role, role)
        response.add_argument(f"--{role}", metavar="COLUMN", help=f"column of the {part}")
    response.add_argument("--frequency-unit", choices=FREQUENCY_UNITS, help="default: from the column name")
    response.add_argument("--magnitude-unit", choices=MAGNITUDE_UNITS, help="default: from the column name, or linear")
    response.add_argument("--phase-unit", choices=PHASE_UNITS, help="default: from the column name")
    response.add_argument(
        "--parameter", choices=NETWORK_PARAMETERS,
        help="Touchstone files: impedance Z (default), admittance Y or scattering S",
    )  # fmt: skip
    response.add_argument("--weights", metavar="COLUMN", help="column of weights, proportional to 1/variance")


def add_meeting(
    parser: argparse._ActionsContainer, states: Sequence[str], auto: str, holds: Sequence[str] = INTERPOLATIONS
) -> None:
    """How a model meets samples, and what the default of the input between them means."""
    parser.add_argument(
        "--method", choices=DISCRETISATIONS, default="exact",
        help="exact (default); midpoint and euler only for data made by these rules",
    )  # fmt: skip
    parser.add_argument(
        "--intersample", choices=("auto", *holds), default="auto",
        help=f"input between samples: {auto} (default), held or linear",
    )  # fmt: skip
    parser.add_argument("--initial-state", choices=states, default="estimate", help="initial state (default: estimate)")
    parser.add_argument("--offset", action="store_true", help="estimate a constant offset of the output")


def add_model(parser: Parser) -> None:
    """A model given by its coefficients in place of a file."""
    model = parser.add_argument_group("a model without a file")
    model.add_argument("--num", type=numbers, metavar="LIST", help="numerator, highest power first, such as 1,0")
    model.add_argument("--den", type=numbers, metavar="LIST", help="denominator, such as 1,0,4")


def add_files(parser: Parser, written: str) -> None:
    """A model and the file made of it."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help=f"the model and the {written} to write; - for standard input and output",
    )
    add_model(parser)

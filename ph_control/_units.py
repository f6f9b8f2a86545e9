"""Units that data bring along: how labels spell them, that of time, and what frequencies are called in it.

Times and what is made of them stay in that unit; only Hz are converted.  A unit that nobody has told is not known, and
never shown.  Data, and results of fits, tell theirs by an attribute `time_unit`, one of `SECONDS` or None.
"""

from __future__ import annotations

import re
from typing import Any, TypeVar

import numpy as np

from . import _checks
from ._options import QUANTITIES
from .exceptions import StructureError

Data = TypeVar("Data")

# what an output measures, as a derivative of a displacement; of any other sensor nothing is known
DERIVATIVES = {name: quantity.derivatives for name, quantity in QUANTITIES.items()}
SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_SPELLINGS = {
    "ns": ("ns", "nsec", "nanosecond", "nanoseconds"),
    "us": ("us", "\u00b5s", "\u03bcs", "usec", "microsecond", "microseconds"),
    "ms": ("ms", "msec", "msecs", "millisecond", "milliseconds"),
    "s": ("s", "sec", "secs", "second", "seconds"),
    "min": ("min", "mins", "minute", "minutes"),
    "h": ("h", "hr", "hrs", "hour", "hours"),
}
_UNITS = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}

_UNIT_NAME = (
    r"(?:(?:da|[YZEPTGMkhcdmuµμnpf])?(?:mol|cd|Pa|Hz|Wb|bar|rad|ohm|Ohm|Ω|sr|eV|min|sec|dB|[mgsAKNJWVCFSHTlLth])"
    r"|°[CF]?|deg|degC|%|rpm|in|ft|lb|lbf|psi|hours?|minutes?|(?:milli|micro|nano)?seconds?|met(?:er|re)s?|newtons?"
    r"|volts?|amperes?|pascals?|radians?|degrees?|kelvins?|counts?)"
)
_UNIT_FACTOR = _UNIT_NAME + r"(?:(?:\^|\*\*)?\(?[+-]?[0-9]\)?|[⁻]?[⁰¹²³⁴-⁹])?"
UNIT = re.compile(rf"(?:1/|√)?{_UNIT_FACTOR}(?:\s*[*·.⋅/ ]\s*(?:√|\()?{_UNIT_FACTOR}\)?){{0,5}}")


def feels_force(quantity: str) -> bool:
    """Whether a force shows in a quantity at once, as in an acceleration."""
    return DERIVATIVES[quantity] >= 2


def known_unit(text: str) -> str | None:
    """Unit of time that a text spells, or None; of two letters, `mS` and `Ms` are other units."""
    return _UNITS.get(text.lower() if len(text) > 2 or text.isupper() else text)


def parted(label: str) -> tuple[str, str]:
    """Label and unit of `force [N]`, `Acc (g)` and `v[m/s]`; a whole label without one, as `Acc (left)` or `y[0]`."""
    bare = _checks.without_unit(label)
    behind = label.strip()[len(bare) :]
    unit = behind.strip()[1:-1].strip()
    if bare and unit and (behind.startswith(" [") or (behind.strip()[0] in "[(" and UNIT.fullmatch(unit))):
        return bare, unit
    return label, ""


def checked_unit(value: object) -> str | None:
    """Unit of time that a caller gave, in the spelling of `SECONDS`."""
    unit = known_unit(value) if isinstance(value, str) else None
    if value is not None and unit is None:
        raise StructureError(
            f"time_unit is {_checks.shown(value)}; known are {', '.join(map(repr, SECONDS))}, or None where no unit is"
        )
    return unit


def with_unit(data: Data, unit: str | None) -> Data:
    """The same data, told its unit of time."""
    data.time_unit = unit  # type: ignore[attr-defined]
    return data


def common_unit(*things: object) -> str | None:
    """Unit of time of data, results and lists of these, where any tells one; two of them are refused."""
    flat = [source for thing in things for source in (thing if isinstance(thing, list | tuple) else [thing])]
    stated = dict.fromkeys(checked_unit(getattr(source, "time_unit", None)) for source in flat)
    units = [unit for unit in stated if unit is not None]
    if len(units) > 1:
        raise StructureError(
            f"the times are in {units[0]} here and in {units[1]} there, so that frequencies mean different things; "
            "bring them to one unit"
        )
    return units[0] if units else None


def unit_for(given: str | None, *things: object) -> str | None:
    """Unit for the labels of a picture: the one given, which may be any text, or else that of what is drawn."""
    known = common_unit(*things)
    if given is None or known is None:
        return known if given is None else str(given)
    if known_unit(str(given)) not in (known, None):
        raise StructureError(
            f"time_unit is {given!r}, but the times are in {known}; leave it out, or convert the times"
        )
    return str(given)


def step_of(record: Any) -> str:
    """Text of the step of a record, or of what was found of one."""
    return f"step {record.dt:g} {record.time_unit or ''}".rstrip()


def rate(unit: str | None) -> str:
    """Name of the unit of angular frequencies."""
    return f"rad/{unit or 'time'}"


def hertz_size(unit: str | None) -> float:
    """One Hz in radians per unit of time; where that is not known, times are taken for seconds."""
    return 2 * np.pi * SECONDS["s" if unit is None else unit]

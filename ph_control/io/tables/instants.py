"""Instants as loggers print them: times of day, with dates and zones or without, and durations with their unit."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence

import numpy as np

from ..._types import Array
from ..._units import SECONDS, known_unit

_DATE = (
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})|(?P<a>\d{1,2})(?P<sep>[-/. ])(?P<b>\d{1,2}|[A-Za-z]{3})"
    r"(?P=sep)(?P<year>\d{4}|\d{2}))"
)
_CLOCK = re.compile(
    rf"(?:{_DATE}(?:\s*[T,]\s*|\s+))?"
    r"(?:(?P<h>\d{1,4}):(?P<min>[0-5]\d)(?::(?P<s>[0-5]\d)(?:[.,:](?P<f>\d{1,12}))?)?|(?P<min2>\d{1,4}):(?P<s2>[0-5]\d)"
    r"[.,](?P<f2>\d{1,12}))(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?(?:\s*(?:Z|UTC|GMT|(?P<zone>[+-]\d{2}:?(?:\d{2})?)))?"
)
_DURATION = re.compile(r"([+-]?[0-9]+(?:[.,][0-9]*)?(?:[eE][+-]?[0-9]+)?)\s*([^\W\d_]+)")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DAY = 86_400 * 10**9  # in nanoseconds
_LONGEST = 40  # characters of an instant


def is_instant(text: str) -> bool:
    """Whether a field holds a time of day, with a date or without, or a duration with its unit."""
    return len(text) <= _LONGEST and (_CLOCK.fullmatch(text) is not None or _duration(text) is not None)


def is_date(text: str) -> bool:
    """Whether a field holds a date without a time of day."""
    return len(text) <= _LONGEST and re.fullmatch(_DATE, text) is not None


def seconds_since_first(fields: Sequence[str]) -> tuple[Array, int | None]:
    """Seconds from the first instant to each of some fields, and the first field that is no instant, or None.

    Durations are kept as they are.  Times of day without a date go on over midnight.
    """
    matches = [_CLOCK.fullmatch(text) if len(text) <= _LONGEST else None for text in fields]
    if matches[0] is None:
        durations = [_duration(text) for text in fields]
        wrong = next((k for k, value in enumerate(durations) if value is None), None)
        return np.array([np.nan if value is None else value for value in durations]), wrong
    dated = matches[0]["y"] is not None or matches[0]["year"] is not None
    best, failure = None, 0
    for day_first in (True, False):
        instants, wrong = _nanoseconds(matches, dated, day_first)
        if wrong is not None:
            failure = max(failure, wrong)
        elif best is None or abs(instants[-1] - instants[0]) < abs(best[-1] - best[0]):
            best = instants
    if best is None:
        return np.full(len(fields), np.nan), failure
    if not dated:
        _carry_midnights(best)
    return np.array([(instant - best[0]) / 1e9 for instant in best]), None


def _nanoseconds(matches: Sequence[re.Match[str] | None], dated: bool, day_first: bool) -> tuple[list[int], int | None]:
    """Nanoseconds of instants, and the first that is none, or has no date as the others have."""
    instants: list[int] = []
    for row, match in enumerate(matches):
        try:
            if match is None or dated != (match["y"] is not None or match["year"] is not None):
                raise ValueError(row)
            instants.append((_day(match, day_first) if dated else 0) * _DAY + _time_of_day(match))
        except ValueError:
            return instants, row
    return instants, None


def _day(match: re.Match[str], day_first: bool) -> int:
    """Number of the day; `ValueError` for one that no month has."""
    if match["y"] is not None:
        return datetime.date(int(match["y"]), int(match["m"]), int(match["d"])).toordinal()
    first, second, year = match["a"], match["b"], int(match["year"])
    if second.isalpha():
        day, month = int(first), _MONTHS.index(second.casefold()) + 1
    elif day_first or match["sep"] == ".":
        day, month = int(first), int(second)
    else:
        day, month = int(second), int(first)
    return datetime.date(year + 2000 * (year < 100), month, day).toordinal()


def _time_of_day(match: re.Match[str]) -> int:
    """Nanoseconds since midnight, of Greenwich where a zone is given."""
    if match["h"] is not None:
        hours, minutes, seconds, fraction = int(match["h"]), int(match["min"]), int(match["s"] or 0), match["f"]
    else:
        hours, minutes, seconds, fraction = 0, int(match["min2"]), int(match["s2"]), match["f2"]
    if match["half"]:
        hours = hours % 12 + 12 * (match["half"] in "Pp")
    if match["zone"]:
        zone = match["zone"].replace(":", "")
        sign = -1 if zone[0] == "-" else 1
        hours, minutes = hours - sign * int(zone[1:3]), minutes - sign * int(zone[3:] or 0)
    return (hours * 3600 + minutes * 60 + seconds) * 10**9 + round(
        int(fraction or 0) * 10.0 ** (9 - len(fraction or ""))
    )


def _carry_midnights(instants: list[int]) -> None:
    """Add a day wherever times of day start again."""
    days, previous = 0, instants[0]
    for k, instant in enumerate(instants):
        days += instant - previous < -_DAY // 2
        previous = instant
        instants[k] = instant + days * _DAY


def _duration(text: str) -> float | None:
    """Seconds of a number with a unit of time, as in `0.5 sec`."""
    match = _DURATION.fullmatch(text) if len(text) <= _LONGEST else None
    unit = known_unit(match[2]) if match else None
    return float(match[1].replace(",", ".")) * SECONDS[unit] if match and unit else None

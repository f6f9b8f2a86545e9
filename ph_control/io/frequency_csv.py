"""Measured frequency responses: text tables become frequency response data of python-control."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import BinaryIO, TextIO

import numpy as np
from control import FrequencyResponseData
from numpy.typing import NDArray

from .. import _checks
from .._units import with_unit
from ..exceptions import FileFormatError, StructureError
from .text_table import Table, is_time_label, read_table, without_unit

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Column = int | str

FREQUENCY_UNITS = {"rad/s": 1.0, "Hz": 2 * np.pi, "kHz": 2e3 * np.pi, "MHz": 2e6 * np.pi, "GHz": 2e9 * np.pi}
MAGNITUDE_UNITS = ("linear", "dB")
PHASE_UNITS = ("deg", "rad")

_ANGULAR = ("omega", "w", "ω", "angular frequency")
_LABELS = {
    "frequency": ("f", "freq", "frequency", *_ANGULAR),
    "magnitude": ("mag", "magnitude", "gain", "amplitude", "modulus", "abs", "|g|", "|h|"),
    "phase": ("phase", "phi", "arg", "angle"),
    "real": ("re", "real", "real part"),
    "imag": ("im", "imag", "imaginary", "imaginary part"),
}
_POLAR, _CARTESIAN = ("magnitude", "phase"), ("real", "imag")
# a unit at the end of a label, where no brackets set it off
_SUFFIX = re.compile(r"[_ ](hz|khz|mhz|ghz|rad_s|rads|db|deg|rad)$", re.IGNORECASE)
_SPELLINGS = {
    "rads": "rad/s", "rad_s": "rad/s", "rad/sec": "rad/s", "1/s": "rad/s", "s^-1": "rad/s", "hz": "Hz", "khz": "kHz",
    "ghz": "GHz", "db": "dB", "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad",
}  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """Columns of a frequency response, by label or number, and their units; None is found from the labels."""

    frequency: Column | None = None
    magnitude: Column | None = None
    phase: Column | None = None
    real: Column | None = None
    imag: Column | None = None
    frequency_unit: str | None = None
    magnitude_unit: str | None = None
    phase_unit: str | None = None


def read_frequency_csv(
    path: str | os.PathLike[str] | BinaryIO | TextIO,
    *,
    frequency: Column | None = None,
    magnitude: Column | None = None,
    phase: Column | None = None,
    real: Column | None = None,
    imag: Column | None = None,
    frequency_unit: str | None = None,
    magnitude_unit: str | None = None,
    phase_unit: str | None = None,
    header: bool | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> FrequencyResponseData:
    r"""Read a measured frequency response from a text table: frequency, and magnitude and phase or both parts.

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.
    frequency, magnitude, phase, real, imag : str or int, optional
        Columns, by label or by number counted from 0.  Default: those labelled so, as `f`, `freq`, `omega`, `mag`,
        `gain`, `phase`, `re`, `im` and the like.
    frequency_unit : {'rad/s', 'Hz', 'kHz', 'MHz', 'GHz'}, optional
        Default: the unit in the label, and rad/s under `omega`; otherwise it must be given.
    magnitude_unit : {'linear', 'dB'}, optional
        Default: dB if the label says so.
    phase_unit : {'deg', 'rad'}, optional
        Default: the unit in the label; otherwise it must be given.
    header, delimiter, decimal
        As in `read_csv`.

    Returns
    -------
    control.FrequencyResponseData
        At the frequencies of the file, in rad/s and ascending, with `time_unit` 's'; what is missing is NaN.

    Raises
    ------
    FileFormatError
        If the content is not such a table; it names line and column, what was found and what to do.
    StructureError
        If the arguments do not fit the file, or a unit is told by neither.
    FileNotFoundError
        If there is no such file (an error of this package as well).

    See Also
    --------
    read_csv : recordings in time.

    Notes
    -----
    A label carries its unit as `frequency [Hz]`, `mag (dB)` or `phase_deg`.  O(K) for K rows.

    Examples
    --------
    >>> import io, ph_control as phc
    >>> data = phc.read_frequency_csv(io.StringIO("f [Hz],gain [dB],phase [deg]\n0.5,0,90\n1.0,20,-90\n"))
    >>> data.omega.round(3), data.frdata[0, 0].round(3)
    (array([3.142, 6.283]), array([0. +1.j, 0.-10.j]))
    """
    units = (frequency_unit, magnitude_unit, phase_unit)
    layout = Layout(frequency, magnitude, phase, real, imag, *units)
    return response_in(read_table(path, header, delimiter, decimal), layout)[0]


def response_in(
    table: Table, layout: Layout, weights: Column | None = None
) -> tuple[FrequencyResponseData, Array | None]:
    """Response that a table holds, and the column of weights if there is one; both ascending in frequency."""
    for name, allowed in (
        ("frequency_unit", tuple(FREQUENCY_UNITS)), ("magnitude_unit", MAGNITUDE_UNITS), ("phase_unit", PHASE_UNITS)
    ):  # fmt: skip
        if getattr(layout, name) is not None:
            _checks.choice(name, getattr(layout, name), allowed)
    clock, first, second, polar = _columns_of(table, layout)
    chosen = [clock, first, second] + ([] if weights is None else [table.find(weights, "weights")])
    for column in chosen:
        if chosen.count(column) > 1:
            raise StructureError(f"{table.path}: {table.name(column)} is chosen twice; give each its own")
    values = table.columns(chosen)
    _refuse_missing(table, values[0], clock)
    omega = _angular(table, values[0], clock, FREQUENCY_UNITS[_frequency_unit(table, layout, clock)])
    response = _polar(table, layout, first, second, *values[1:3]) if polar else values[1] + 1j * values[2]
    order = np.argsort(omega, kind="stable")
    found = FrequencyResponseData(response[order], omega[order], title=os.path.basename(table.path) or None)
    return with_unit(found, "s"), None if weights is None else values[3][order]


def is_frequency_table(table: Table) -> bool:
    """Whether the labels of a table are those of a frequency response, and none is that of a time."""
    named = {role for role in _LABELS if len(_labelled(table, role)) == 1}
    parts = any({"frequency", *pair} <= named for pair in (_POLAR, _CARTESIAN))
    return parts and not any(map(is_time_label, table.labels or ()))


# --- columns -----------------------------------------------------------------------------------------------------


def _columns_of(table: Table, layout: Layout) -> tuple[int, int, int, bool]:
    """Columns of the frequency and of the two parts, and whether these are magnitude and phase."""
    asked = {pair: any(getattr(layout, name) is not None for name in pair) for pair in (_POLAR, _CARTESIAN)}
    if all(asked.values()):
        raise StructureError("magnitude or phase is given, and real or imag too; give one pair of them")
    known = {pair: all(_find(table, layout, name) is not None for name in pair) for pair in (_POLAR, _CARTESIAN)}
    wanted = [pair for pair in known if asked[pair]] or [pair for pair in known if known[pair]]
    if len(wanted) > 1:
        raise StructureError(
            f"{table.path} has magnitude and phase, and real and imaginary part as well; choose with magnitude= and "
            "phase=, or with real= and imag="
        )
    pair = wanted[0] if wanted else _POLAR
    places = [_find(table, layout, name) for name in ("frequency", *pair)]
    missing = [name for name, place in zip(("frequency", *pair), places, strict=True) if place is None]
    if missing:
        other = "" if wanted else ", or real= and imag= in place of magnitude= and phase="
        raise StructureError(
            f"{table.path}: which column is the {' and which the '.join(missing)}? say which with "
            f"{', '.join(f'{name}=' for name in missing)}{other} ({table.listing()})"
        )
    frequency, first, second = (place for place in places if place is not None)
    return frequency, first, second, pair == _POLAR


def _find(table: Table, layout: Layout, role: str) -> int | None:
    wanted = getattr(layout, role)
    if wanted is not None:
        return table.find(wanted, role)
    places = _labelled(table, role)
    if len(places) > 1:
        names = " and ".join(map(table.name, places))
        raise StructureError(f"{table.path}: {names} may both be the {role}; choose with {role}=")
    return places[0] if places else None


def _labelled(table: Table, role: str) -> list[int]:
    labels = [_bare(label).casefold() for label in table.labels or ()]
    return [k for k, label in enumerate(labels) if label in _LABELS[role]]


def _bare(label: str) -> str:
    """Label without its unit, in brackets or after an underscore."""
    return _SUFFIX.sub("", without_unit(label))


def _unit(table: Table, column: int) -> str:
    """Unit that the label of a column tells, in the spelling of the options; empty if there is none."""
    label = table.labels[column] if table.labels else ""
    tail = label[len(without_unit(label)) :].strip(" []()/") if without_unit(label) != label else ""
    if not tail and (found := _SUFFIX.search(label)):
        tail = found[1]
    # MHz and mHz differ by nine decades
    return tail if tail in FREQUENCY_UNITS else _SPELLINGS.get(tail.casefold(), tail)


# --- units -------------------------------------------------------------------------------------------------------


def _frequency_unit(table: Table, layout: Layout, column: int) -> str:
    if layout.frequency_unit is not None:
        return layout.frequency_unit
    unit = _unit(table, column)
    if unit in FREQUENCY_UNITS:
        return unit
    if not unit and table.labels and _bare(table.labels[column]).casefold() in _ANGULAR:
        return "rad/s"
    raise _unknown_unit(table, column, unit, "frequency_unit", tuple(FREQUENCY_UNITS))


def _angular(table: Table, values: Array, column: int, unit: float) -> Array:
    """Frequencies in rad/s."""
    with np.errstate(over="ignore"):
        omega = values * unit
    if np.isinf(omega).any():
        row = int(np.argmax(np.isinf(omega)))
        raise FileFormatError(
            f"{table.at(row, column)}: {values[row]:.6g} is beyond the range of doubles in rad/s; correct the "
            "frequency or its unit"
        )
    return omega


def _polar(table: Table, layout: Layout, first: int, second: int, size: Array, angle: Array) -> ComplexArray:
    """Response of its magnitude and phase."""
    unit = layout.phase_unit or _unit(table, second)
    if unit not in PHASE_UNITS:
        raise _unknown_unit(table, second, unit, "phase_unit", PHASE_UNITS)
    decibels = (layout.magnitude_unit or _unit(table, first)) == "dB"
    if not decibels and np.any(size < 0):
        row = int(np.argmax(size < 0))
        raise FileFormatError(
            f"{table.at(row, first)}: the magnitude is {size[row]:.6g}, and a linear one is never negative; pass "
            "magnitude_unit='dB' if these are decibels"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        gain = 10.0 ** (size / 20.0) if decibels else size
    if np.isinf(gain).any():
        row = int(np.argmax(np.isinf(gain)))
        raise FileFormatError(
            f"{table.at(row, first)}: {size[row]:.6g} dB is beyond the range of doubles; if the magnitude is linear, "
            "pass magnitude_unit='linear'"
        )
    return gain * _turned(angle, unit == "deg")


def _turned(angle: Array, degrees: bool) -> ComplexArray:
    """Points of the unit circle; quarter turns are exact, so that a lossless response stays on its axis."""
    if not degrees:
        return np.exp(1j * angle)
    quarters = np.rint(angle / 90.0)
    rest = np.exp(1j * np.deg2rad(angle - 90.0 * quarters))
    known = np.where(np.isnan(quarters), 0.0, np.mod(quarters, 4.0)).astype(int)
    return np.array([1, 1j, -1, -1j])[known] * rest


def _unknown_unit(table: Table, column: int, unit: str, name: str, allowed: tuple[str, ...]) -> StructureError:
    found = f"the unit {unit!r} is not known" if unit else "its label tells no unit"
    return StructureError(
        f"{table.path}: {table.name(column)}: {found}; say which with {name}=, one of "
        f"{', '.join(map(repr, allowed))}, or write it into the label, such as '... [{allowed[0]}]'"
    )


def _refuse_missing(table: Table, values: Array, column: int) -> None:
    if np.isnan(values).any():
        row = int(np.argmax(np.isnan(values)))
        raise FileFormatError(f"{table.at(row, column)}: the frequency is missing; only responses may be: drop the row")

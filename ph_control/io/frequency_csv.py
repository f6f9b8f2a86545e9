"""Measured frequency responses: text tables become frequency response data of python-control."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO, TextIO

import numpy as np
from control import FrequencyResponseData
from scipy.special import cosdg, sindg

from .. import _checks
from .._options import MAGNITUDE_UNITS, PHASE_UNITS, DecimalMark, FrequencyUnit, MagnitudeUnit, PhaseUnit
from .._types import Array, ComplexArray, NDArray
from .._units import with_unit
from ..exceptions import FileFormatError, StructureError, printable
from .files import read_bytes, source_name
from .tables.columns import Table, is_time_label, name_and_unit
from .tables.text_table import TextOptions, read_table

Column = int | str
Columns = Column | Sequence[Column] | Sequence[Sequence[Column]]

FREQUENCY_UNITS = {"rad/s": 1.0, "Hz": 2 * np.pi, "kHz": 2e3 * np.pi, "MHz": 2e6 * np.pi, "GHz": 2e9 * np.pi}
UNITS = {
    "frequency_unit": tuple(FREQUENCY_UNITS), "magnitude_unit": MAGNITUDE_UNITS, "phase_unit": PHASE_UNITS
}  # fmt: skip

_ANGULAR = ("omega", "w", "ω", "angular frequency")
_LABELS = {
    "frequency": ("f", "freq", "frequency", *_ANGULAR),
    "magnitude": (
        "mag",
        "magnitude",
        "gain",
        "amplitude",
        "modulus",
        "abs",
        "impedance",
        "admittance",
        "mobility",
        "accelerance",
        "receptance",
        *(f"|{letter}|" for letter in "ghzy"),
    ),
    "phase": ("phase", "phi", "arg", "angle"),
    "real": (
        "re",
        "real",
        "real part",
        "zreal",
        *(f"{part}({letter})" for part in ("re", "real") for letter in "ghzy"),
        "z'",
    ),
    "imag": (
        "im",
        "imag",
        "zimag",
        "imaginary",
        "imaginary part",
        *(f"{part}({letter})" for part in ("im", "imag") for letter in "ghzy"),
        "z''",
        'z"',
    ),
}
COLUMNS = tuple(_LABELS)
_LARGEST_PHASE = 1e12  # whose rounding is a ten-thousandth of a degree, or of a radian
# before a label; dashes of other widths are as common as the hyphen
_MINUS = re.compile(
    r"\s*(?:\(?[-\u2010-\u2015\u2212\ufe63\uff0d]\)?\s*(?:1\s*[*·×]\s*)?|(?:minus|neg(?:ative)?)\b[\s.]*)(?=\S)", re.I
)
_PAIRS = _POLAR, _CARTESIAN = ("magnitude", "phase"), ("real", "imag")
_SPELLINGS = {
    "rads": "rad/s", "rad_s": "rad/s", "rad/sec": "rad/s", "1/s": "rad/s", "s^-1": "rad/s", "hz": "Hz", "khz": "kHz",
    "ghz": "GHz", "db": "dB", "deg": "deg", "°": "deg", "degree": "deg", "degrees": "deg", "rad": "rad",
    "radian": "rad", "radians": "rad", "ohm": "Ohm", "ohms": "Ohm", "ω": "Ohm",
}  # fmt: skip


def read_frequency_csv(
    path: str | os.PathLike[str] | BinaryIO | TextIO,
    *,
    frequency: Column | None = None,
    magnitude: Columns | None = None,
    phase: Columns | None = None,
    real: Columns | None = None,
    imag: Columns | None = None,
    frequency_unit: FrequencyUnit | None = None,
    magnitude_unit: MagnitudeUnit | None = None,
    phase_unit: PhaseUnit | None = None,
    header: bool | None = None,
    delimiter: str | None = None,
    decimal: DecimalMark | None = None,
    skiprows: int | None = None,
    comment: str | None = None,
) -> FrequencyResponseData:
    r"""Read a measured frequency response from a text table: frequency, and magnitude and phase or both parts.

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.
    frequency : str or int, optional
        Column, by label or by number counted from 0.  Default: the one labelled `f`, `freq`, `omega` and the like.
    magnitude, phase, real, imag : str or int, or lists of these, optional
        Columns of the response, likewise; default: those labelled `mag`, `gain`, `impedance`, `phase`, `re`, `im` and
        the like.  A list has a column for each output, a list of lists one for each output and input,
        `[["re11", "re12"], ["re21", "re22"]]`; both parts need the same shape.
    frequency_unit : {'rad/s', 'Hz', 'kHz', 'MHz', 'GHz'}, optional
        Default: the unit in the label, and rad/s under `omega`; otherwise it must be given.
    magnitude_unit : {'linear', 'dB'}, optional
        Default: dB if the label says so.
    phase_unit : {'deg', 'rad'}, optional
        Default: the unit in the label; otherwise it must be given.
    header, delimiter, decimal, skiprows, comment
        As in `read_csv`.

    Returns
    -------
    control.FrequencyResponseData
        Shape (p, m, K), at the frequencies of the file, in rad/s and ascending, with `time_unit` 's'; what is missing
        is NaN.

    Raises
    ------
    FileFormatError
        If the content is not such a table; it names line and column, what was found and what to do.
    StructureError
        If the arguments do not fit the file, or a unit is told by neither.
    FileMissingError
        If there is no such file.

    See Also
    --------
    read_csv : recordings in time.

    Notes
    -----
    A label carries its unit as `frequency [Hz]`, `mag (dB)` or `phase_deg`.  A part or a phase whose label begins with
    a minus sign, such as `-Im(Z)`, is the negative of what the column holds.  O(K) for K rows.

    Examples
    --------
    >>> import io, ph_control as phc
    >>> data = phc.read_frequency_csv(io.StringIO("f [Hz],gain [dB],phase [deg]\n0.5,0,90\n1.0,20,-90\n"))
    >>> data.omega.round(3), data.frdata[0, 0].round(3)
    (array([3.142, 6.283]), array([0. +1.j, 0.-10.j]))
    """
    columns = {"frequency": frequency, "magnitude": magnitude, "phase": phase, "real": real, "imag": imag}
    units = {"frequency_unit": frequency_unit, "magnitude_unit": magnitude_unit, "phase_unit": phase_unit}
    options = TextOptions(header, delimiter, decimal, skiprows, comment)
    table = read_table(read_bytes(path), source_name(path), options, are_labels_of_response)
    return response_in(table, columns, units)[0]


def response_in(
    table: Table, columns: Mapping[str, Any], units: Mapping[str, str | None], weights: Column | None = None
) -> tuple[FrequencyResponseData, Array | None]:
    """Response that a table holds, and the column of weights if there is one; both ascending in frequency."""
    for name, allowed in UNITS.items():
        if units[name] is not None:
            _checks.choice(name, units[name], allowed)
    clock, parts, polar = _columns_of(table, columns)
    shape, first, second = parts[0].shape, *(part.ravel().tolist() for part in parts)
    chosen = [clock, *first, *second] + ([] if weights is None else [table.find(weights, "weights")])
    table.refuse_repeats(chosen)
    values = table.columns(chosen)
    omega = _angular(table, values[0], clock, units["frequency_unit"])
    pairs = zip(first, second, values[1 : len(first) + 1], values[len(first) + 1 :], strict=False)
    signed = [(j, k, a if polar else _sign(table, j) * a, _sign(table, k) * b) for j, k, a, b in pairs]
    response = np.array([_polar(table, units, [j, k], a, b) if polar else a + 1j * b for j, k, a, b in signed])
    order = np.argsort(omega, kind="stable")
    data = response_matrix(omega, response.reshape(*shape, -1), None, None, table.path)
    return data, None if weights is None else values[-1][order]


def response_matrix(
    omega: Array, response: ComplexArray, inputs: list[str] | None, outputs: list[str] | None, path: str
) -> FrequencyResponseData:
    """Data of python-control, ascending in frequency: response (p, m, K), labels, and the file it comes from."""
    order, names = np.argsort(omega, kind="stable"), {}
    if len(omega) and omega.min() < 0:
        raise FileFormatError(
            f"{path} has negative frequencies, the lowest {omega.min():.6g} rad/s; leave them out, since the response "
            "there is the conjugate of that at the positive ones"
        )
    for role, labels in (("inputs", inputs), ("outputs", outputs)):
        if labels is not None:
            names[role] = _checks.without_dots([printable(label, one_line=True) for label in labels])
    title = os.path.basename(path) or None
    return with_unit(FrequencyResponseData(response[..., order], omega[order], title=title, **names), "s")


def selected_channels(
    data: FrequencyResponseData, inputs: Sequence[str] | None, outputs: Sequence[str] | None, path: str
) -> FrequencyResponseData:
    """Response of some of the inputs and outputs, by their labels."""
    inputs, outputs = inputs or data.input_labels, outputs or data.output_labels
    places = []
    for role, known, wanted in (("output", data.output_labels, outputs), ("input", data.input_labels, inputs)):
        unknown = [label for label in wanted if label not in known]
        if unknown:
            raise StructureError(f"{path}: there is no {role} {unknown[0]!r}; they are {', '.join(known)}")
        places.append([known.index(label) for label in wanted])
    return response_matrix(data.omega, data.frdata[np.ix_(*places)], list(inputs), list(outputs), path)


def are_labels_of_response(labels: Sequence[str]) -> bool:
    """Whether labels are those of a frequency response; beside a time both parts must be there, as of impedances."""
    named = {role for role in _LABELS if len(_labelled(labels, role)) == 1}
    timed = any(map(is_time_label, labels))
    return any({"frequency", *pair} <= named for pair in ((_CARTESIAN,) if timed else _PAIRS))


# --- columns -----------------------------------------------------------------------------------------------------


def _columns_of(table: Table, given: Mapping[str, object]) -> tuple[int, list[NDArray[np.intp]], bool]:
    """Column of the frequencies, those of both parts of each entry, shape (p, m), and whether these are polar."""
    named = [pair for pair in _PAIRS if any(given[role] is not None for role in pair)]
    if len(named) > 1:
        raise StructureError("magnitude or phase is given, and real or imag too; give one pair of them")
    columns = {role: _entries(table, role, given[role]) for role in _LABELS}
    pairs = named or [pair for pair in _PAIRS if all(columns[role].size for role in pair)]
    if len(pairs) > 1:
        raise StructureError(
            f"{table.path} has magnitude and phase, and real and imaginary part as well; choose with magnitude= and "
            "phase=, or with real= and imag="
        )
    pair = pairs[0] if pairs else _POLAR
    missing = [role for role in ("frequency", *pair) if not columns[role].size]
    if missing:
        other = "" if pairs else ", or real= and imag= in place of magnitude= and phase="
        raise StructureError(
            f"{table.path}: which column is the {' and which the '.join(missing)}? say which with "
            f"{', '.join(f'{role}=' for role in missing)}{other} ({table.listing()})"
        )
    parts = [columns[role] for role in pair]
    if parts[0].shape != parts[1].shape:
        sizes = [f"{role} {len(part)} x {len(part.T)}" for role, part in zip(pair, parts, strict=True)]
        raise StructureError(f"columns of {' and '.join(sizes)} (outputs x inputs); give both parts of each entry")
    return int(columns["frequency"][0, 0]), parts, pair == _POLAR


def _entries(table: Table, role: str, given: object) -> NDArray[np.intp]:
    """Columns of one role for each entry of the response, shape (p, m); empty where there are none."""
    if given is None:
        place = table.only(_labelled(table.labels or (), role), role)
        return np.zeros((0, 0), np.intp) if place is None else np.array([[place]])
    if role == "frequency" or not isinstance(given, list | tuple):
        return np.array([[table.find(given, role)]])
    rows = [row if isinstance(row, list | tuple) else [row] for row in given]
    if len({len(row) for row in rows}) != 1 or not rows[0]:
        raise StructureError(
            f"{role} is {_checks.shown(given)}; a list of columns, or of lists of one length, is needed"
        )
    return np.array([[table.find(column, role) for column in row] for row in rows])


def _labelled(columns: Sequence[str], role: str) -> list[int]:
    # `Trace 1: Gain: Magnitude (dB)` of network analysers
    labels = [name_and_unit(label.rpartition(": ")[2], _spelled)[0].casefold() for label in columns]
    signed = _LABELS[role] if role in ("phase", "real", "imag") else ()
    return [k for k, label in enumerate(labels) if label in _LABELS[role] or _MINUS.sub("", label) in signed]


def _sign(table: Table, column: int) -> float:
    """-1 for a column that holds the negative of a part or a phase by its label, as `-Im(Z)` does."""
    return -1.0 if table.labels and _MINUS.match(table.labels[column]) else 1.0


# --- units -------------------------------------------------------------------------------------------------------


def _spelled(text: str) -> str | None:
    """Unit of a text, in the spelling of the options; MHz and mHz differ by nine decades."""
    return text if text in FREQUENCY_UNITS else _SPELLINGS.get(text.casefold())


def _named(table: Table, column: int) -> tuple[str, str]:
    """Label of a column without its unit, and the unit."""
    return name_and_unit(table.labels[column], _spelled) if table.labels else ("", "")


def _unit(table: Table, column: int, given: str | None, name: str) -> str:
    """Unit of a column: the one given, or that of its label."""
    label, unit = _named(table, column)
    known = given or _spelled(unit) or ("rad/s" if not unit and label.casefold() in _ANGULAR else None)
    if known in UNITS[name]:
        return str(known)
    reason = f"the unit {unit!r} is not known" if unit else "its label tells no unit"
    raise StructureError(
        f"{table.path}: {table.name(column)}: {reason}; say which with {name}=, one of "
        f"{', '.join(map(repr, UNITS[name]))}, or write it into the label, such as '... [{UNITS[name][0]}]'"
    )


def _angular(table: Table, values: Array, column: int, given: str | None) -> Array:
    """Frequencies in rad/s."""
    table.refuse(column, np.isnan(values), "the frequency is missing; only responses may be: drop the row")
    with np.errstate(over="ignore"):
        omega = values * FREQUENCY_UNITS[_unit(table, column, given, "frequency_unit")]
    wrong = "{:.6g} is beyond the range of doubles in rad/s; correct the frequency or its unit"
    table.refuse(column, np.isinf(omega), wrong, values)
    return omega


def _polar(
    table: Table, units: Mapping[str, str | None], columns: list[int], size: Array, angle: Array
) -> ComplexArray:
    """Response of its magnitude and phase."""
    degrees = _unit(table, columns[1], units["phase_unit"], "phase_unit") == "deg"
    wrong = "a phase of {:.6g} has no digits left within a turn; correct it, or leave the field empty if it is missing"
    table.refuse(columns[1], np.abs(angle) > _LARGEST_PHASE, wrong, angle)
    # at quarter turns exact, so that a lossless response stays on its axis
    turns: ComplexArray = cosdg(angle) + 1j * sindg(angle) if degrees else np.exp(1j * angle)
    if (units["magnitude_unit"] or _spelled(_named(table, columns[0])[1])) != "dB":
        wrong = "the magnitude is {:.6g}, and a linear one is never negative; pass magnitude_unit='dB' if it is in dB"
        table.refuse(columns[0], size < 0, wrong, size)
        return size * turns
    with np.errstate(over="ignore"):
        gain = 10.0 ** (size / 20.0)
    wrong = "{:.6g} dB is beyond the range of doubles; if the magnitude is linear, pass magnitude_unit='linear'"
    table.refuse(columns[0], np.isinf(gain), wrong, size)
    return gain * turns

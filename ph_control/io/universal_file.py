"""Universal files of vibration tests (UFF, UNV): recordings and frequency responses, of data set 58, or modes."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np
from control import FrequencyResponseData, TimeResponseData

from .. import _checks
from .._types import Array
from ..analysis.time_grid import shortest_number
from ..exceptions import FileFormatError, StructureError, installed
from .files import read_bytes, source_name
from .frequency_csv import response_matrix
from .time_csv import complete_grid, recording
from .universal_modes import UniversalModes, modes_in

SUFFIXES = (".uff", ".unv", ".uf", ".bunv", ".bun", ".uf58")

_TIME, _FREQUENCY = 17, 18  # specific data types of the abscissa
_FORCE = 13  # of the ordinate: excitation force
_QUANTITIES = {8: "displacement", 11: "velocity", 12: "acceleration"}
_GENERAL, _TIME_RESPONSE, _FREQUENCY_RESPONSE = 0, 1, 4  # function types
_COMPLEX = (5, 6)  # ordinate data types
_DIRECTIONS = ("", "X", "Y", "Z", "RX", "RY", "RZ")
_PRINTED = 6  # digits of abscissa minimum and increment in the header
_SAME = 1e-6  # relative difference of two frequencies that are one
_OTHERS = {2: "auto spectrum", 3: "cross spectrum", 5: "transmissibility", 6: "coherence", 9: "power spectral density"}


@dataclass(frozen=True)
class _Function:
    """One function of a file: where it was measured, what excited it, and its values over time or frequency."""

    in_time: bool
    is_force: bool
    by_force: bool
    quantity: str | None
    response: str
    reference: str
    load_case: int
    abscissa: Array
    values: Any


def read_uff(
    path: str | os.PathLike[str] | BinaryIO | TextIO,
    *,
    input: str | Sequence[str] | None = None,
    output: str | Sequence[str] | None = None,
) -> list[TimeResponseData | FrequencyResponseData | UniversalModes]:
    r"""Read the recordings and frequency responses of a universal file (UFF, UNV: data set 58), or its mode shapes.

    Functions of one test become one matrix of responses, or one recording of several channels.

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.
    input, output : str or list of str, optional
        Labels of the inputs and outputs wanted, such as `"3+Z"`: node and direction (`+X` to `-Z`, rotations `+RX` to
        `-RZ`), with the name of the component before it, as in `"wing:3+Z"`, where the file tells one.
        Default: all; in recordings the excitation forces are the inputs and the other channels the outputs.

    Returns
    -------
    list of control.FrequencyResponseData and control.TimeResponseData, or of one UniversalModes
        In the order of the file, with labels, and `time_unit` 's'; frequencies in rad/s.  `quantity` is a mapping from
        labels of outputs to 'displacement', 'velocity' or 'acceleration', of those that the file calls so and that
        respond to forces; `pem` takes it.  `ports` is a list of (output, input), the labels of driving points: outputs
        with such a quantity at the place and in the direction of a force; `pem` takes it as well.

        Frequency response functions on the same frequencies form one matrix, shape (p, m, K): a row for each place of
        response, a column for each reference, NaN where a pair was not measured.  A pair that comes again opens the
        next matrix.  Channels in time on the same grid and of one load case form one recording; a channel that
        comes again opens the next one.  A file without excitation forces gives recordings without input.

        In labels of frequency responses `_` takes the place of a dot, which python-control does not allow.

        A file with neither, but with normal or complex modes (data set 55), gives these, and takes no labels.

    Raises
    ------
    FileFormatError
        If the file is damaged, cut short, of another kind, or holds no recordings, frequency responses or modes.
    StructureError
        If a label is not in the file.
    MissingPackageError
        If pyuff is not installed; `pip install "ph_control[formats]"` brings it.
    FileMissingError
        If there is no such file.

    See Also
    --------
    read_csv, read_mat : recordings in other formats.
    write_uff : writes mode shapes.

    Notes
    -----
    Spectra, coherences and geometry are passed over, and modes beside measurements.  Of modes, directions in which all
    nodes rest are those that were not measured, one of two conjugate poles is kept, and a loss factor counts as half a
    damping ratio.  Amplitudes stay in the units of the file, and signs
    in the directions measured.  Step and first value of an axis are printed with six digits in such files; they are
    taken for the shortest decimal number, or rate, that is printed so: 1/2048 s for 4.88281e-04.  Within these digits
    times and frequencies are exact.  O(size of the file).

    Examples
    --------
    >>> import pathlib, tempfile, numpy as np, ph_control as phc, pyuff
    >>> f = np.arange(1.0, 5.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pyuff.UFF(str(pathlib.Path(folder, "beam.uff")))
    ...     for node in (1, 2):
    ...         _ = pyuff.prepare_58(
    ...             func_type=4, rsp_node=node, rsp_dir=3, ref_node=1, ref_dir=3, data=1 / (9 - f**2 + 1j), x=f,
    ...             id1="", id2="", id3="", id4="", id5="", load_case_id=0, rsp_ent_name="", ref_ent_name="",
    ...             abscissa_spacing=1, abscissa_spec_data_type=18, ordinate_spec_data_type=8,
    ...             orddenom_spec_data_type=13, abscissa_min=1.0, abscissa_inc=1.0, binary=0,
    ...         )
    ...         file.write_sets(_, "add")
    ...     (data,) = phc.read_uff(pathlib.Path(folder, "beam.uff"))
    >>> data.output_labels, data.input_labels, data.frdata.shape
    (['1+Z', '2+Z'], ['1+Z'], (2, 1, 4))
    >>> data.quantity, data.ports
    ({'1+Z': 'displacement', '2+Z': 'displacement'}, [('1+Z', '1+Z')])
    """
    name = source_name(path)
    wanted = _labels("input", input), _labels("output", output)
    content = read_bytes(path)
    functions, others = _functions(_data_sets(content, name, 58), name)
    if not functions:
        modes = modes_in([fields for _, fields in _data_sets(content, name, 55)], name)
        if modes is None:
            held = f", but {' and '.join(sorted(others))}" if others else ""
            raise FileFormatError(
                f"{name} holds no recording, no frequency response (data set 58, function types 1 and 4) and no modes "
                f"(data set 55){held}; export these from the measurement"
            )
        if input is not None or output is not None:
            raise StructureError(f"{name} holds modes, which are read as a whole; leave out input and output")
        return [modes]
    known = list(dict.fromkeys(label for function in functions for label in (function.response, function.reference)))
    inputs, outputs = (_in_file(labels, known) for labels in wanted)
    kinds = [_matrices(functions, name, inputs, outputs), _recordings(functions, name, inputs, outputs)]
    # in the order of the file, by the first function of each
    placed = [placed_data for kind in kinds for placed_data in kind]
    data_sets = [data for _, data in sorted(placed, key=lambda placed_data: placed_data[0])]
    if not data_sets:
        raise StructureError(
            f"{name}: no function has the labels asked for; those of the file are {', '.join(sorted(known))}"
        )
    return data_sets


def _labels(role: str, given: object) -> list[str] | None:
    if given is None:
        return None
    labels = [given] if isinstance(given, str) else given
    if not isinstance(labels, list | tuple) or not labels or not all(isinstance(label, str) for label in labels):
        raise StructureError(f"{role} is {_checks.shown(given)}; give a label such as '3+Z', or a list of these")
    return list(labels)


def _in_file(wanted: list[str] | None, known: list[str]) -> list[str] | None:
    """Labels that are asked for as the file has them, where they are those of the data that were read of it."""
    shown = dict(zip(_checks.without_dots(known), known, strict=True))
    return None if wanted is None else [label if label in known else shown.get(label, label) for label in wanted]


# --- functions of a file ---------------------------------------------------------------------------------------------


def _functions(data_sets: list[tuple[int, dict[str, Any]]], name: str) -> tuple[list[_Function], set[str]]:
    """Recorded functions of a file, all checked, and kinds of the others."""
    functions, others = [], set()
    for place, fields in data_sets:
        function = _function(fields, f"{name}, data set {place + 1}")
        if function is None:
            others.add(_OTHERS.get(fields["func_type"], f"function type {fields['func_type']}"))
        else:
            functions.append(function)
    return functions, others


def _data_sets(content: bytes, name: str, number: int) -> list[tuple[int, dict[str, Any]]]:
    """Fields of all data sets of a number, each with its place."""
    pyuff = installed("pyuff", "universal files are read by pyuff")
    if b"    -1" not in content:
        raise FileFormatError(f"{name} is not a universal file: no line of it is '    -1'; export it as UFF or UNV")
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        copy = Path(folder, "copy.uff")  # the reader takes names of files only
        copy.write_bytes(content)
        try:
            file = pyuff.UFF(str(copy))
            places = [k for k, kind in enumerate(file.get_set_types()) if kind == number]
            sets = [(k, file.read_sets(k)) for k in places]
        except Exception as error:
            # a damaged file ends in errors of every kind
            raise FileFormatError(
                f"{name} is not a universal file, or damaged ({str(error)[:80] or type(error).__name__}); export again"
            ) from None
    if not content.rstrip(b" \r\n\t\0\x1a").endswith(b"    -1"):
        raise FileFormatError(f"{name} is cut short: its last data set does not end in '    -1'; copy it again")
    return sets


def _function(fields: dict[str, Any], place: str) -> _Function | None:
    """Function of a data set, or None if it is of another kind."""
    try:
        kind, axis, count = (int(fields[key]) for key in ("func_type", "abscissa_spec_data_type", "num_pts"))
        values = np.asarray(fields["data"])[:count]
        is_complex = int(fields["ord_data_type"]) in _COMPLEX
        in_time = kind == _TIME_RESPONSE or (kind == _GENERAL and axis == _TIME)
        if not in_time and kind != _FREQUENCY_RESPONSE and not (kind == _GENERAL and axis == _FREQUENCY and is_complex):
            return None
        if len(values) < count or count < 1:
            raise FileFormatError(f"{place} has {len(values)} values, and its header says {count}; export it again")
        even = int(fields["abscissa_spacing"]) == 1
        abscissa = (
            _printed_grid(float(fields["abscissa_min"]), float(fields["abscissa_inc"]), count) if even
            else np.asarray(fields["x"], float)[:count]
        )  # fmt: skip
        response, reference = (
            _place_label(fields[f"{of}_ent_name"], int(fields[f"{of}_node"]), int(fields[f"{of}_dir"]))
            for of in ("rsp", "ref")
        )
        case, measured = int(fields["load_case_id"]), int(fields["ordinate_spec_data_type"])
        by_force = int(fields["orddenom_spec_data_type"]) == _FORCE
    except FileFormatError:
        raise
    except Exception as error:
        raise FileFormatError(f"{place} is damaged ({type(error).__name__}); export it again") from None
    if in_time and is_complex:
        raise FileFormatError(f"{place} is a recording of complex values; export the measured signal")
    if not np.isfinite(abscissa).all():
        raise FileFormatError(
            f"{place}: its {'times' if in_time else 'frequencies'} are not all finite; export it again"
        )
    infinite = np.isinf(values)
    if infinite.any():
        raise FileFormatError(f"{place}: value {int(np.argmax(infinite)) + 1} is infinite; export it again")
    quantity = _QUANTITIES.get(measured)
    return _Function(in_time, measured == _FORCE, by_force, quantity, response, reference, case, abscissa, values)


def _place_label(component: Any, node: int, direction: int) -> str:
    """Label of a place: its component, if the file names one, node and direction."""
    before = str(component or "").strip()
    prefix = "" if before.upper() in ("", "NONE") else f"{before}:"
    sign = "" if direction == 0 else "-" if direction < 0 else "+"
    return f"{prefix}{node}{sign}{_DIRECTIONS[abs(direction)]}"


def _printed_grid(first: float, step: float, count: int) -> Array:
    """Grid whose first value and step were printed with six digits."""
    if not (step > 0 and np.isfinite(step)):
        raise FileFormatError(f"the step of the axis is {step:g}; it must be positive")
    printed = shortest_number(step, _rounding(step))
    whole = round(first / printed)
    error = _rounding(first) if first else 0.0
    start = whole * printed if abs(whole * printed - first) <= error else first
    return np.asarray(start + printed * np.arange(count))


def _rounding(value: float) -> float:
    """Half a unit of the last digit that is printed."""
    return float(0.501 * 10.0 ** (np.floor(np.log10(abs(value))) + 1 - _PRINTED))


# --- functions that belong together ----------------------------------------------------------------------------------


def _same_axis(a: Array, b: Array) -> bool:
    return len(a) == len(b) and bool(np.allclose(a, b, rtol=_SAME, atol=0.0))


def _matrices(
    functions: list[_Function], name: str, inputs: list[str] | None, outputs: list[str] | None
) -> Iterator[tuple[int, FrequencyResponseData]]:
    """Frequency responses, as matrices, each with the place of its first function."""
    groups: list[tuple[int, Array, dict[tuple[str, str], _Function]]] = []
    for place, function in enumerate(functions):
        if function.in_time or not _is_wanted(outputs, function.response) or not _is_wanted(inputs, function.reference):
            continue
        pair = function.response, function.reference
        group = next((g for g in groups if _same_axis(g[1], function.abscissa) and pair not in g[2]), None)
        if group is None:
            groups.append(group := (place, function.abscissa, {}))
        group[2][pair] = function
    for place, hertz, entries in groups:
        rows, columns = (_ordered(wanted, [pair[k] for pair in entries]) for k, wanted in ((0, outputs), (1, inputs)))
        matrix = np.full((len(rows), len(columns), len(hertz)), np.nan, complex)
        for (response, reference), function in entries.items():
            matrix[rows.index(response), columns.index(reference)] = function.values
        data = response_matrix(2 * np.pi * hertz, matrix, columns, rows, name)
        yield place, _described(data, rows, columns, list(entries.values()))


def _recordings(
    functions: list[_Function], name: str, inputs: list[str] | None, outputs: list[str] | None
) -> Iterator[tuple[int, TimeResponseData]]:
    """Recordings of several channels, each with the place of its first channel."""
    for place, channels in _recorded_together(functions):
        driving = {channel.response: channel for channel in channels if channel.is_force}
        moving = {channel.response: channel for channel in channels if not channel.is_force}
        if inputs is not None:
            # a label may be that of a force and of a motion at channel place
            candidates = {**moving, **driving}
            driving = {label: candidates[label] for label in inputs if label in candidates}
            moving = {label: channel for label, channel in moving.items() if driving.get(label) is not channel}
        if outputs is not None:
            moving = {label: moving[label] for label in outputs if label in moving}
        if not moving or (inputs is not None and not driving):
            if inputs is None and outputs is None:
                raise FileFormatError(f"{name} holds a recording of forces without responses; export these as well")
            continue
        u, y = (np.array([channel.values for channel in side.values()], float) for side in (driving, moving))
        grid = complete_grid(channels[0].abscissa, u, list(driving), name)
        data = recording(grid, u, y, list(driving), list(moving), name, "s")
        forced = all(channel.is_force for channel in driving.values())
        functions = [replace(channel, by_force=forced) for channel in moving.values()]
        yield place, _described(data, list(moving), list(driving), functions)


def _recorded_together(functions: list[_Function]) -> list[tuple[int, list[_Function]]]:
    """Functions of time one after the other with one axis and load case, no channel twice; the place of the first."""
    groups: list[tuple[int, list[_Function]]] = []
    for place, function in enumerate(functions):
        if not function.in_time:
            continue
        last = groups[-1][1] if groups else []
        known = {(each.response, each.is_force) for each in last}
        fits = last and last[0].load_case == function.load_case and _same_axis(last[0].abscissa, function.abscissa)
        if not fits or (function.response, function.is_force) in known:
            groups.append((place, []))
        groups[-1][1].append(function)
    return groups


def _described(data: Any, outputs: list[str], inputs: list[str], functions: list[_Function]) -> Any:
    """The same data, told what each output is where all its functions say the same, and are responses to forces.

    An output of which this is known is a driving point where an input has its place and direction.
    """
    quantities: dict[str, set[str | None]] = {}
    for function in functions:
        quantities.setdefault(function.response, set()).add(function.quantity if function.by_force else None)
    # the labels of the data may differ from those of the file
    rows, columns = dict(zip(outputs, data.output_labels, strict=True)), {}
    if inputs:
        columns = dict(zip(inputs, data.input_labels, strict=True))
    known = {label: quantity for label, (quantity, *others) in quantities.items() if quantity and not others}
    data.quantity = {rows[label]: quantity for label, quantity in known.items()}
    data.ports = [(rows[label], columns[label]) for label in known if label in columns and label[-1] in "XYZ"]
    return data


def _is_wanted(wanted: list[str] | None, label: str) -> bool:
    return wanted is None or label in wanted


def _ordered(wanted: list[str] | None, labels: list[str]) -> list[str]:
    """Labels that were found, in the order in which they were asked for, or appear."""
    return [label for label in wanted if label in labels] if wanted else list(dict.fromkeys(labels))

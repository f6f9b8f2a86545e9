"""Files: recordings from text tables, models to JSON and back."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from control import TimeResponseData
from numpy.typing import NDArray

from . import _checks
from ._documents import Fields, as_path, compose, decompose, plain, read_bytes, write_atomically
from ._instants import printed_step
from ._tables import Table, is_time_label, read_table
from .affine import AffineHamiltonian
from .canonical_forms import ControllableHamiltonian, ObservableHamiltonian
from .exceptions import FileFormatError, StructureError
from .modal import ModalForm
from .systems import PortHamiltonian

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Column = int | str

_DRIFT = 0.01  # of a step: how far two grids may part over the record and still be the same


# --- recordings --------------------------------------------------------------------------------------------------


def read_csv(
    path: str | os.PathLike[str],
    *,
    input: Column | Sequence[Column] | bool | None = None,
    output: Column | Sequence[Column] | None = None,
    time: Column | bool | None = None,
    dt: float | None = None,
    header: bool | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> TimeResponseData:
    r"""Read a recording from a text table (CSV, TSV or columns between white space).

    Parameters
    ----------
    path : str or path-like
        The file.
    input, output : str, int, or a list of these, optional
        Columns of the input and the output: by label, or by number counted from 0 over all columns of the file.
        A label matches with or without its unit and, failing that, without regard to case; digits that are no
        label are a number.  `input=False` says that there is no input, as in a free decay.
        Default: the one remaining column; with neither given and two columns left, the first is the input and the
        second the output.
    time : str, int or False, optional
        Column of the time.  Default: the one labelled `t`, `time`, `timestamp` or the like, with or without unit.
        `time=False` says that no column is the time, and needs `dt`.
    dt : float, optional
        Time between samples.  Needed if there is no time column; if there is one, the two must agree.
    header : bool, optional
        Whether the first row holds labels.  Default: it does if none of its fields is a number.
    delimiter : str, optional
        Separator of the fields; `" "` is any white space.  Default: found from the first rows.
    decimal : {".", ","}, optional
        Decimal sign.  Default: found from the rows.

    Returns
    -------
    control.TimeResponseData
        `time` (N,), `inputs` and `outputs` as python-control squeezes them, with the labels of the columns.  The
        time is the exactly uniform grid through the instants in the file, in their unit: pass seconds to get
        frequencies in rad/s.  Missing outputs are NaN.

    Raises
    ------
    FileFormatError
        If the content is not such a table; it names line and column, what was found and what to do.  A missing
        input or time, unequal sampling, and a file of fewer than two rows are such errors too.
    StructureError
        If the arguments do not fit the file, such as a column that it does not have.
    FileNotFoundError
        If there is no such file (an error of this package as well).

    Notes
    -----
    Blank lines and lines that start with `#` or `%` are skipped; labels may be in such a line right above the
    numbers.  Empty fields, NaN, NA, N/A, null, none, `-` and `?` are missing values.  Columns that are not asked
    for may hold anything.  The instants may be off the grid by a hundredth of a step, as rounding in print makes
    them; the step is the shortest decimal number, or rate, within the uncertainty of a straight line through them.
    A few seconds for a million rows.

    Examples
    --------
    >>> import pathlib, tempfile, ph_control as phc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "recording.csv")
    ...     _ = path.write_text("t [s],force [N],velocity [m/s]\n0.0,1.0,0.0\n0.1,0.0,0.2\n0.2,0.0,\n")
    ...     data = phc.read_csv(path, input="force", output="velocity")
    >>> data.time.tolist(), data.inputs.tolist(), data.outputs.tolist()
    ([0.0, 0.1, 0.2], [1.0, 0.0, 0.0], [0.0, 0.2, nan])
    >>> data.output_labels
    ['velocity [m/s]']
    """
    _check_layout(header, delimiter, decimal)
    step = None if dt is None else _checks.sampling_step(dt)
    table = read_table(path, header, delimiter, decimal)
    clock = _time_column(table, time, step)
    inputs, outputs = _signal_columns(table, clock, input, output)
    if len(table.rows) < 2:
        raise FileFormatError(
            f"{table.path} has one row of numbers (line {table.line_numbers[0]}); "
            "a recording needs at least two samples"
        )
    values = table.columns([*([] if clock is None else [clock]), *inputs, *outputs])
    if clock is not None:
        instants, values = values[0], values[1:]
        _refuse_missing(table, instants, clock, "the time")
        grid = _uniform_grid(table, instants, clock, step)
    else:
        assert step is not None
        grid = step * np.arange(len(table.rows), dtype=float)
    u, y = values[: len(inputs)], values[len(inputs) :]
    for column, signal in zip(inputs, u, strict=True):
        _refuse_missing(table, signal, column, "the input")
    for column, signal in zip(outputs, y, strict=True):
        if np.isnan(signal).all():
            raise FileFormatError(f"{table.path}: {table.name(column)} has no values at all; choose another output")
    return TimeResponseData(
        grid,
        y,
        inputs=u if inputs else None,
        issiso=len(outputs) == 1 and len(inputs) <= 1,
        input_labels=_signal_labels(table, inputs, "u"),
        output_labels=_signal_labels(table, outputs, "y"),
        title=Path(path).name,
    )


def _check_layout(header: Any, delimiter: Any, decimal: Any) -> None:
    if header not in (None, True, False):
        raise StructureError(f"header is {header!r}; it must be True, False or None")
    if delimiter is not None and (not isinstance(delimiter, str) or len(delimiter) != 1 or delimiter in '"\n\r.'):
        raise StructureError(f"delimiter is {delimiter!r}; it must be one character, such as ',' or ';' or a tab")
    if decimal is not None:
        _checks.choice("decimal", decimal, (".", ","))


def _time_column(table: Table, time: Any, step: float | None) -> int | None:
    """Number of the time column, or None where `dt` takes its place."""
    if time is not None and time is not False:
        return table.find(time, "time")
    found = [] if time is False else [j for j in range(table.width) if table.labels and is_time_label(table.labels[j])]
    if len(found) > 1:
        names = " and ".join(table.name(j) for j in found)
        raise StructureError(f"{table.path}: {names} may both be the time; choose with time=")
    if found:
        return found[0]
    if step is None:
        raise StructureError(
            f"{table.path}: no column is the time; name it with time=, or give the time between samples with dt= "
            f"({table.listing()})"
        )
    return None


def _signal_columns(table: Table, clock: int | None, input: Any, output: Any) -> tuple[list[int], list[int]]:
    """Numbers of the input and output columns."""
    if isinstance(output, bool) or input is True:
        name, value = ("input", input) if input is True else ("output", output)
        raise StructureError(f"{name} is {value}; give the label of a column or its number, counted from 0")
    inputs = [] if input is False else _chosen(table, input, "input")
    outputs = _chosen(table, output, "output")
    taken = [*([] if clock is None else [clock]), *(inputs or []), *(outputs or [])]
    for column in taken:
        if taken.count(column) > 1:
            raise StructureError(f"{table.path}: {table.name(column)} is chosen twice among time, input and output")
    rest = [j for j in range(table.width) if j not in taken]
    missing = [name for name, columns in (("input", inputs), ("output", outputs)) if columns is None]
    if len(rest) != len(missing) and missing:
        asked = " and ".join(f"{name}=" for name in missing)
        enough = inputs is not None or len(rest) > len(missing)
        free = "" if enough else ", or pass input=False if the recording has no input"
        raise StructureError(
            f"{table.path}: which column is the {' and which the '.join(missing)}? {len(rest)} of {table.width} "
            f"columns are left to choose from; say which with {asked}{free} ({table.listing()})"
        )
    if inputs is None:
        inputs = [rest.pop(0)]
    if outputs is None:
        outputs = [rest.pop(0)]
    return inputs, outputs


def _chosen(table: Table, wanted: Any, role: str) -> list[int] | None:
    if wanted is None:
        return None
    if isinstance(wanted, list | tuple):
        if not wanted:
            hint = "; pass input=False for a recording without input" if role == "input" else ""
            raise StructureError(f"{role} is an empty list; name at least one column{hint}")
        return [table.find(one, role) for one in wanted]
    return [table.find(wanted, role)]


def _signal_labels(table: Table, columns: list[int], prefix: str) -> list[str] | None:
    labels = [table.labels[j] if table.labels else "" for j in columns]
    return [label or f"{prefix}[{k}]" for k, label in enumerate(labels)] or None


def _refuse_missing(table: Table, values: Array, column: int, what: str) -> None:
    missing = np.isnan(values)
    if missing.any():
        row = int(np.argmax(missing))
        found = table.split(table.rows[row])[column].strip()
        raise FileFormatError(
            f"{table.at(row, column)}: {what} is missing ({repr(found) if found else 'the field is empty'}; "
            f"{int(missing.sum())} of {len(values)} rows); only outputs may be missing: fill in {what} or cut the "
            "recording there"
        )


def _uniform_grid(table: Table, instants: Array, column: int, dt: float | None) -> Array:
    """The uniform grid that instants in print stand for."""
    try:
        _checks.time_vector(instants)
    except StructureError:
        raise FileFormatError(_why_not_uniform(table, instants, column)) from None
    step, count = printed_step(instants), len(instants)
    if dt is not None:
        if abs(dt - step) * (count - 1) > _DRIFT * step:
            raise StructureError(
                f"{table.path}: dt is {dt:.9g}, but the step of {table.name(column)} is {step:.9g}; leave dt out, "
                "or pass time=False if that column is not the time in the wanted unit"
            )
        step = dt
    return instants[0] + step * np.arange(count)


def _why_not_uniform(table: Table, t: Array, column: int) -> str:
    gaps = np.diff(t)
    median = float(np.median(gaps))
    backwards = gaps <= 0
    k = int(np.argmax(backwards)) if backwards.any() else int(np.argmax(np.abs(gaps - median)))
    place = f"{table.at(k + 1, column)}: the time is {t[k + 1]:.12g}, after {t[k]:.12g} in line {table.line_numbers[k]}"
    if backwards.any():
        return f"{place}; it must increase: sort the rows, and drop repeats"
    return (
        f"{place}: a step of {gaps[k]:.6g}, where the median is {median:.6g}; the sampling must be uniform to a "
        f"hundredth of a step: {_how_to_mend(gaps, median, k)}"
    )


def _how_to_mend(gaps: Array, median: float, worst: int) -> str:
    """Advice for gaps that are unequal: whether the print, lost samples or surplus ones look like the cause."""
    if np.all(np.abs(gaps - median) <= 0.5 * median):
        return f"resample; if the times are only rounded in print, pass time=False, dt={gaps.mean():.9g}"
    # rows numbered by time=False would close the gaps that lost samples leave, so it is not offered
    with np.errstate(over="ignore"):
        lost = np.where(gaps > 1.5 * median, np.rint(gaps / median) - 1, 0)
    if not lost[worst]:
        return "the row seems to be one too many there: drop it, or resample"
    places = np.count_nonzero(lost)
    elsewhere = f" ({lost.sum():.9g} at {places} places in the whole file)" if places > 1 else ""
    missing = "1 row seems" if lost[worst] == 1 else f"{lost[worst]:.9g} rows seem"
    return (
        f"samples are lost, {missing} to be missing there{elsewhere}; add rows for them (input and time given, output "
        "empty), or resample"
    )


# --- models ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Codec:
    """How one kind of object becomes the fields of a document, and comes back.

    `to_dict` may give arrays (real or complex) and nested dicts; `from_dict` takes every field, checked.
    """

    kind: str
    type: type
    to_dict: Callable[[Any], dict[str, Any]]
    from_dict: Callable[[Fields], Any]


def _modes_to_dict(modes: ModalForm) -> dict[str, Any]:
    return {"ports": modes.nports, "d": modes.d, "nu": modes.nu, "rigid": modes.rigid, "r": modes.r}


def _modes_from_dict(fields: Fields) -> ModalForm:
    ports = fields.integer("ports")
    if ports < 1:
        raise StructureError(f"ports is {ports}; a model has at least one port")
    d = fields.array("d", (None,))
    nu = fields.complex_array("nu", (len(d), ports))
    rigid = fields.array("rigid", (None, ports))
    r = fields.array("r", (len(d),) if ports == 1 else (len(d), ports))
    _checks.natural_frequencies(d)
    if np.any(np.diff(d) < 0):
        raise StructureError("d is not ascending; the natural frequencies must be sorted")
    _refuse_other_weights(nu, r)
    return ModalForm(d, nu, rigid, r)


def _refuse_other_weights(nu: ComplexArray, r: Array) -> None:
    """`r` is kept beside `nu` to the last bit; here it is only held against a change of one without the other."""
    if np.any(r < 0):
        raise StructureError(f"r is negative: {r.min():.6g}; weights are >= 0")
    with np.errstate(over="ignore"):
        size, root = np.abs(nu).reshape(r.shape), np.sqrt(r)
    # compared as roots, whose squares may underflow
    allowed = np.sqrt(_checks.EPS) * root + 2 * np.sqrt(np.finfo(float).tiny)
    if np.any(np.abs(size - root) > allowed):
        raise StructureError("r is not |nu|^2; change both or none")


def system_to_dict(system: PortHamiltonian) -> dict[str, Any]:
    """Fields of a system: its names, and its matrices or its modes, whichever it was made of."""
    names = system._names()
    if system._given is None:
        return {**names, "modes": _modes_to_dict(system.modes)}
    return {**names, "Q": system.Q, "B": system.B}


def system_from_dict(fields: Fields) -> PortHamiltonian:
    """Restore the system of `system_to_dict`."""
    names = _names_from_dict(fields)
    if "modes" in fields:
        return PortHamiltonian._from_modes(_modes_from_dict(fields.nested("modes")), **names)
    return PortHamiltonian(fields.array("Q", (None, None)), fields.array("B", (None, None)), **names)


def _names_from_dict(fields: Fields) -> dict[str, Any]:
    names: dict[str, Any] = {key: fields.texts(key) for key in ("inputs", "outputs", "states")}
    return names | {"name": fields.text("name")}


def _parameters_to_dict(system: Any) -> dict[str, Any]:
    """Fields of a canonical form."""
    return {**system._names(), "d": system.d, "v": system.v}


def _parameters_codec(kind: type[Any]) -> Codec:
    def restore(fields: Fields) -> Any:
        return kind(fields.array("d", (None,)), fields.array("v", (None,)), **_names_from_dict(fields))

    return Codec(kind.__name__, kind, _parameters_to_dict, restore)


def _affine_to_dict(system: AffineHamiltonian) -> dict[str, Any]:
    return {**system._names(), "Q": system.Q, "B": system.C.T.copy()}


def _affine_from_dict(fields: Fields) -> AffineHamiltonian:
    matrices = (fields.array(key, (None, None)) for key in "QB")
    return AffineHamiltonian(*matrices, **_names_from_dict(fields))


_CODECS = [
    Codec("PortHamiltonian", PortHamiltonian, system_to_dict, system_from_dict),
    Codec("ModalForm", ModalForm, _modes_to_dict, _modes_from_dict),
    _parameters_codec(ControllableHamiltonian),
    _parameters_codec(ObservableHamiltonian),
    Codec("AffineHamiltonian", AffineHamiltonian, _affine_to_dict, _affine_from_dict),
]


def register(codec: Codec) -> None:
    """Teach `save` and `load` a further kind; for modules above this one."""
    _CODECS.append(codec)


def save(obj: Any, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a model to a JSON file.

    Parameters
    ----------
    obj : PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian, ModalForm or PEMResult
        The model.
    path : str or path-like
        The file, `.json` by custom.
    overwrite : bool, optional
        Whether a file of that name may be replaced.

    Raises
    ------
    OutputExistsError
        If the file exists and `overwrite` is False, or the path is a folder, a device, a pipe or a socket.  Nothing
        is written then.
    FileNotFoundError
        If the folder does not exist (an error of this package as well).
    StructureError
        If the object is of another kind, or holds what `load` would refuse, or the path cannot be the name of a file.
    PermissionError
        If the folder cannot be written.

    Notes
    -----
    Every number comes back bit by bit, with all names; a system made from modes stays one.  The file appears whole
    or not at all.  Its content is described in `docs/files.md`.

    Examples
    --------
    >>> import pathlib, tempfile, ph_control as phc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "model.json")
    ...     phc.save(phc.modes([1.0, 3.0], [0.5, 0.25]), path)
    ...     phc.load(path)
    ModalForm(d=[1. 3.], r=[0.5  0.25])
    """
    target = as_path(path)
    # the class itself: a subclass would come back as its base
    codec = next((codec for codec in _CODECS if type(obj) is codec.type), None)
    if codec is None:
        kinds = ", ".join(codec.kind for codec in _CODECS)
        raise StructureError(
            f"an object of type {type(obj).__name__} cannot be saved, only {kinds}; "
            "a lossless system of another type can be converted with ph(sys)"
        )
    text = compose(codec.kind, plain(codec.to_dict(obj)))
    try:
        _restore(text.encode(), codec.kind)
    except FileFormatError as error:
        raise StructureError(f"this {codec.kind} cannot be saved, because it could not be loaded: {error}") from None
    write_atomically(target, text, overwrite=overwrite)


def load(path: str | os.PathLike[str]) -> Any:
    """Read a model that `save` has written.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian, ModalForm or PEMResult
        What was saved, bit by bit.

    Raises
    ------
    FileFormatError
        If the file is not JSON, damaged, cut short, of another program, of a newer schema or of an unknown kind,
        or if its values are not a valid model.  The message says which, and where.
    FileNotFoundError
        If there is no such file (an error of this package as well).

    Notes
    -----
    Every field is checked: present, of its type and shape, finite, and valid as a whole; nothing in the file is
    ever executed.  A checksum finds changed digits.

    Examples
    --------
    See `save`.
    """
    return _restore(read_bytes(as_path(path)), str(path))


def _restore(content: bytes, name: str) -> Any:
    kind, fields = decompose(content, name)
    codec = next((codec for codec in _CODECS if codec.kind == kind), None)
    if codec is None:
        kinds = ", ".join(repr(codec.kind) for codec in _CODECS)
        raise FileFormatError(f"{name} holds a {kind!r}; this version of ph_control reads {kinds}")
    try:
        restored = codec.from_dict(fields)
    except FileFormatError:
        raise
    except ValueError as error:
        raise FileFormatError(f"{name} holds no valid {kind}: {error}") from None
    fields.done()
    return restored

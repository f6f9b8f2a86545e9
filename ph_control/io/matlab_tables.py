"""Recordings and frequency responses that lie in MATLAB's `.mat` files as arrays, also inside structures."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO, TextIO

import numpy as np
from control import FrequencyResponseData, TimeResponseData

from .. import _checks
from .._options import FrequencyUnit
from .._types import Array, ArrayLike, ComplexArray
from .._units import checked_unit
from ..analysis.time_grid import printed_step
from ..exceptions import FileFormatError, StructureError, printable
from .files import read_bytes, source_name
from .frequency_csv import FREQUENCY_UNITS, response_matrix
from .matlab import Elements, is_matlab, read_matlab
from .time_csv import complete_grid, recording

_COLUMN = re.compile(r"(.*)\[([0-9]+)\]")
_FROM_ONE = re.compile(r"[({]\s*([0-9]+(?:\s*,\s*[0-9]+)*)\s*[)}]")  # indices as MATLAB spells them
_TIMES = ("t", "time")


def read_mat(
    path: str | os.PathLike[str] | BinaryIO | TextIO,
    *,
    input: str | Sequence[str] | bool | None = None,
    output: str | Sequence[str] | None = None,
    time: str | bool | None = None,
    dt: float | None = None,
    time_unit: str | None = None,
) -> TimeResponseData:
    r"""Read a recording from a MATLAB file: arrays, also those in structures, that are named as input, output and time.

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.
    input, output : str or list of str, optional
        Variables: vectors, or matrices with a column for each channel.  `"data.u"` is a field of a structure,
        `"x[2]"` the column 2 of `x`, counted from 0, `"runs[1].u"` or, as in MATLAB, `"runs(2).u"` that of the second
        of several structures, and `"c[1]"` or `"c{2}"` the second cell.  `input=False` says that there is no input.
        Default: `u` and `y`.
    time : str or False, optional
        Variable of the time.  Default: `t` or `time`, if there is one and `dt` is not given.
    dt : float, optional
        Time between samples, where no variable is the time.
    time_unit : {'ns', 'us', 'ms', 's', 'min', 'h'}, optional
        Unit of the time, and of `dt`; not known by default.

    Returns
    -------
    control.TimeResponseData
        `time` (N,), inputs (m, N) and outputs (p, N) as python-control squeezes them, labelled by the variables, with
        the number of the column where there are several; NaN among the outputs are missing samples.

    Raises
    ------
    FileFormatError
        If the file is damaged or no `.mat` file of version 5 to 7.3, or if a variable is not an array of real numbers,
        an input or the time has missing values, or the sampling is not uniform.
    StructureError
        If a variable is not in the file, or the lengths do not fit.
    MissingPackageError
        If the file is of version 7.3 and h5py is not installed; `pip install "ph_control[formats]"` brings it.
    FileMissingError
        If there is no such file.

    See Also
    --------
    read_frequency_mat : frequency responses.
    read_csv : recordings in text tables.

    Notes
    -----
    Samples run along the rows of a matrix, as MATLAB has them, unless only its columns are as many as the samples of
    the time or of a vector.  h5py reads files of version 7.3 (HDF5); no other file is opened for links in them.
    Arrays of HDF5 that MATLAB did not save have the dimensions that h5py shows, samples by channels.
    O(size of the file).

    Examples
    --------
    >>> import io, numpy as np, ph_control as phc, scipy.io
    >>> file = io.BytesIO()
    >>> test = {"force": np.array([[1.0], [0.0], [0.0]]), "motion": np.arange(6.0).reshape(3, 2)}
    >>> scipy.io.savemat(file, {"test": test})
    >>> _ = file.seek(0)
    >>> data = phc.read_mat(file, input="test.force", output="test.motion", dt=0.1, time_unit="s")
    >>> data.output_labels, data.outputs.tolist()
    (['test.motion[0]', 'test.motion[1]'], [[0.0, 2.0, 4.0], [1.0, 3.0, 5.0]])
    """
    name = source_name(path)
    step, unit = None if dt is None else _checks.sampling_step(dt), checked_unit(time_unit)
    variables = _Variables(read_bytes(path), name)
    clock = variables.time(time, step)
    driving = [] if input is False else variables.named("input", "u" if input is None else input)
    moving = variables.named("output", "y" if output is None else output)
    vectors = [value for _, value, column in driving + moving if column is None and 1 in value.shape]
    count = len(clock) if clock is not None else next((vector.size for vector in vectors), None)
    inputs, u = _channels(driving, count, name)
    outputs, y = _channels(moving, count, name)
    lengths = {len(signal) for signal in (*u, *y)} | ({len(clock)} if clock is not None else set())
    if len(lengths) != 1:
        raise StructureError(
            f"{name}: the variables have {' and '.join(map(str, sorted(lengths)))} samples; choose those of one "
            "recording"
        )
    samples = lengths.pop()
    if clock is None:
        assert step is not None
        clock = step * np.arange(samples, dtype=float)
    grid = complete_grid(clock, u, inputs, name)
    if step is not None:
        grid = clock[0] + step * np.arange(samples)
        if abs(grid[-1] - clock[-1]) > 0.02 * step:
            printed = printed_step(clock)
            raise StructureError(f"{name}: dt is {dt:g}, but the step of the time is {printed:.9g}; leave dt out")
    return recording(grid, np.array(u).reshape(-1, samples), np.array(y), inputs, outputs, name, unit)


def read_frequency_mat(
    path: str | os.PathLike[str] | BinaryIO | TextIO,
    frequency: str,
    response: str | Sequence[str],
    *,
    frequency_unit: FrequencyUnit | None = None,
) -> FrequencyResponseData:
    r"""Read measured frequency responses from a MATLAB file: complex arrays, also those in structures, by their names.

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.
    frequency : str
        Variable of the frequencies, K numbers.
    response : str or list of str
        Variables of the response: K complex numbers, a matrix with K rows and a column for each output, or an array
        (K, p, m) as MATLAB's `modalfrf` gives it or (p, m, K) as its `frd` keeps it.  Those of a list are outputs one
        after the other.
    frequency_unit : {'rad/s', 'Hz', 'kHz', 'MHz', 'GHz'}
        Unit of the frequencies; it must be given, since such files tell none.

    Returns
    -------
    control.FrequencyResponseData
        Shape (p, m, K), in rad/s and ascending, with `time_unit` 's'; what is missing is NaN.

    Raises
    ------
    FileFormatError
        If the file is damaged or no `.mat` file of version 5 to 7.3, if a variable is not an array of numbers, or a
        frequency is negative.
    StructureError
        If a variable is not in the file, or the lengths do not fit.
    MissingPackageError
        If the file is of version 7.3 and h5py is not installed; `pip install "ph_control[formats]"` brings it.
    FileMissingError
        If there is no such file.

    See Also
    --------
    read_mat : recordings in time, and how variables are named.

    Notes
    -----
    O(size of the file).

    Examples
    --------
    >>> import io, numpy as np, ph_control as phc, scipy.io
    >>> file, f = io.BytesIO(), np.arange(1.0, 4.0)
    >>> scipy.io.savemat(file, {"f": f, "H": np.stack([1 / (4.1 - f**2), 1j * f], axis=1)})
    >>> _ = file.seek(0)
    >>> data = phc.read_frequency_mat(file, "f", "H", frequency_unit="Hz")
    >>> data.frdata.shape, data.output_labels
    ((2, 1, 3), ['H[0]', 'H[1]'])
    """
    name, known = source_name(path), tuple(FREQUENCY_UNITS)
    if frequency_unit is None:
        raise StructureError(
            f"{name}: the unit of {_checks.shown(frequency)} is not known; give frequency_unit=, one of "
            f"{', '.join(map(repr, known))}"
        )
    size = FREQUENCY_UNITS[_checks.choice("frequency_unit", frequency_unit, known)]
    variables = _Variables(read_bytes(path), name)
    ((label_f, f, column),) = variables.named("frequency", [frequency])
    hertz = _real(np.ravel(f) if column is None else f[:, column], label_f, name)
    if not len(hertz) or not np.isfinite(hertz).all():
        raise FileFormatError(f"{name}: {label_f} needs finite frequencies; export it again")
    blocks, outputs, inputs = [], [], 1
    for label, value, column in variables.named("response", response):
        block = _entries(value if column is None else value[:, [column]], len(hertz), label, name)
        own = f"{label}[{column}]" if column is not None else label
        outputs += [own] if len(block) == 1 else [f"{own}[{k}]" for k in range(len(block))]
        blocks.append(block)
        inputs = block.shape[1]
    if len(set(outputs)) < len(outputs):
        raise StructureError(f"{name}: {next(label for label in outputs if outputs.count(label) > 1)} is named twice")
    if len({block.shape[1] for block in blocks}) != 1:
        raise StructureError(f"{name}: the responses have several numbers of inputs; read those of one number")
    if any(np.isinf(block).any() for block in blocks):
        raise FileFormatError(f"{name}: the response has infinite values; replace them by NaN for missing values")
    entries: ComplexArray = np.concatenate(blocks)
    with np.errstate(over="ignore"):
        omega = size * hertz
    if np.isinf(omega).any():
        raise FileFormatError(f"{name}: {label_f} is beyond the range of doubles in rad/s; correct it or its unit")
    return response_matrix(omega, entries, [f"u[{k}]" for k in range(inputs)], outputs, name)


# --- variables -------------------------------------------------------------------------------------------------------


class _Variables:
    """Arrays of a file by their names, those in structures as `structure.field`."""

    def __init__(self, content: bytes, name: str) -> None:
        if not is_matlab(content, name):
            raise FileFormatError(f"{name} is not a .mat file; save it in MATLAB with the option '-v7'")
        self.name = name
        self._variables = dict(_flat(read_matlab(content, name), ""))
        if not any(isinstance(value, np.ndarray) for value in self._variables.values()):
            raise FileFormatError(f"{name} holds no arrays of numbers; save the measurement as arrays")

    def named(self, role: str, wanted: object) -> list[tuple[str, Array, int | None]]:
        """Name, array of at least two dimensions, and column if one was asked for."""
        names = [wanted] if isinstance(wanted, str) else wanted
        if not isinstance(names, list | tuple) or not names or not all(isinstance(text, str) for text in names):
            raise StructureError(f"{role} is {_checks.shown(wanted)}; give the name of a variable, or a list of names")
        return [self._variable(role, text.strip()) for text in names]

    def _variable(self, role: str, wanted: str) -> tuple[str, Array, int | None]:
        wanted = _FROM_ONE.sub(lambda match: f"[{','.join(str(int(k) - 1) for k in match[1].split(','))}]", wanted)
        bare, column = wanted, None
        if wanted not in self._variables and (match := _COLUMN.fullmatch(wanted)):
            bare, column = match[1], int(match[2])
        if bare not in self._variables:
            close = difflib.get_close_matches(bare, self._variables, 1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise StructureError(
                f"{self.name}: {role}: there is no variable {bare!r}; say which with {role}= (the file has "
                f"{', '.join(list(self._variables)[:30])}){hint}"
            )
        value = self._variables[bare]
        if not isinstance(value, np.ndarray) or not value.size:
            raise FileFormatError(f"{self.name}: {bare} is {_kind(value)}; an array of numbers is needed")
        if column is not None and (value.ndim != 2 or column >= value.shape[1]):
            raise StructureError(f"{self.name}: {bare} has shape {value.shape}, and no column {column}, counted from 0")
        return bare, value, column

    def time(self, wanted: object, step: float | None) -> Array | None:
        """Instants, or None where a step takes their place."""
        instants = None if wanted is False else wanted
        if wanted is None and step is None:
            instants = next((label for label in _TIMES if label in self._variables), None)
        if instants is None:
            if step is None:
                raise StructureError(
                    f"{self.name}: no variable is the time; name it with time=, or give the time between samples with "
                    f"dt= (the file has {', '.join(list(self._variables)[:30])})"
                )
            return None
        ((label, value, column),) = self.named("time", [instants])
        return _real(np.ravel(value) if column is None else value[:, column], label, self.name)


def _flat(fields: Mapping[str, object], before: str) -> Iterator[tuple[str, Any]]:
    """Names of all arrays and what else there is; those of an element of an array of structures as `runs[1].u`."""
    for key, value in fields.items():
        yield from _inside(f"{before}{printable(key, one_line=True)}", value)


def _inside(name: str, value: object) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        yield from _flat(value, f"{name}.")
    elif isinstance(value, Elements):
        yield name, value.kind
        for k, element in enumerate(value.values):
            index = np.unravel_index(k, value.shape, order="F")
            place = str(k) if max(value.shape) == len(value.values) else ",".join(map(str, index))
            yield from _inside(f"{name}[{place}]", element)
    else:
        yield name, value


def _kind(value: object) -> str:
    if isinstance(value, np.ndarray):
        return "empty"
    return value if isinstance(value, str) and value.startswith(("a ", "an ")) else "a text"


def _real(values: ArrayLike, label: str, name: str) -> Array:
    if np.iscomplexobj(values):
        raise FileFormatError(f"{name}: {label} is complex; real numbers are needed")
    return np.asarray(values, float)


def _channels(variables: list[tuple[str, Array, int | None]], count: int | None, name: str) -> tuple[list[str], Any]:
    """Labels and samples of channels; `count` is the number of samples, where it is known."""
    labels: list[str] = []
    rows: list[Array] = []
    for label, value, column in variables:
        if value.ndim != 2:
            raise FileFormatError(f"{name}: {label} has {value.ndim} dimensions; samples by channels are needed")
        table = _real(value, label, name)
        if np.isinf(table).any():
            raise FileFormatError(f"{name}: {label} has infinite values; replace them by NaN for missing values")
        if column is not None:
            channels = {f"{label}[{column}]": table[:, column]}
        else:
            if table.shape[0] == 1 or (table.shape[1] == count != table.shape[0]):
                table = table.T
            several = table.shape[1] > 1
            channels = {f"{label}[{k}]" if several else label: table[:, k] for k in range(table.shape[1])}
        labels += channels
        rows += channels.values()
    if len(set(labels)) < len(labels):
        raise StructureError(f"{name}: {next(label for label in labels if labels.count(label) > 1)} is named twice")
    return labels, rows


def _entries(value: object, count: int, label: str, name: str) -> ComplexArray:
    """Response as outputs x inputs x frequencies."""
    array = np.asarray(value, complex)
    if array.ndim == 3 and array.shape[2] == count:
        return array
    if array.ndim == 3 and array.shape[0] == count:
        return array.transpose(1, 2, 0)
    if array.ndim == 2 and array.shape[0] == count:
        return array.T[:, None, :]
    if array.ndim == 2 and array.shape[1] == count:
        return array[:, None, :]
    raise StructureError(
        f"{name}: {label} has shape {array.shape}, and there are {count} frequencies; expected as many rows, or an "
        "array (frequencies, outputs, inputs) or (outputs, inputs, frequencies)"
    )

"""Measurements of a file of any kind that is read."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from control import TimeResponseData

from ..exceptions import StructureError
from .files import read_bytes, source_name
from .frequency_csv import COLUMNS, UNITS, are_labels_of_response, response_in, selected_channels
from .matlab_tables import read_frequency_mat, read_mat
from .tables.columns import Table
from .tables.recorders import READERS, read_array_table
from .tables.text_table import TextOptions, read_table
from .time_csv import recording_in
from .touchstone import is_touchstone, read_touchstone
from .universal_file import SUFFIXES, read_uff

_NAMES = ("input", "output", "time")
_IN_TIME = (*_NAMES, "dt")
_IN_TEXT = ("header", "delimiter", "decimal", "skiprows", "comment")
_IN_FREQUENCY = (*COLUMNS, *UNITS, "weights")
_MATLAB = (".mat", ".h5", ".hdf5")  # version 7.3 of MATLAB is HDF5


def read_recording(
    path: str | os.PathLike[str] | BinaryIO,
    *,
    input: int | str | Sequence[int | str] | bool | None = None,
    output: int | str | Sequence[int | str] | None = None,
    time: int | str | bool | None = None,
    dt: float | None = None,
    time_unit: str | None = None,
) -> TimeResponseData:
    r"""Read a recording from a file of a logger, its kind told by the suffix.

    Parameters
    ----------
    path : str, path-like, or file object open for reading bytes
        `.tdms` (LabVIEW), `.parquet`, `.wav`, `.h5`, `.hdf5` or `.mat`; all others, `.lvm` and `.csv` among them, are
        text tables.
    input, output, time, dt, time_unit
        As in `read_csv`; of HDF5 and MATLAB files as in `read_mat`, with names such as `"run/force"` or `"run.force"`.

    Returns
    -------
    control.TimeResponseData
        As `read_csv` gives it.  Channels of TDMS have the step and the units that the file tells, of several groups
        `group/channel`; those of WAV are called `channel 1`, ..., with full scale 1.

    Raises
    ------
    FileFormatError
        If the file is damaged or of another kind, or its sampling is not uniform.
    StructureError
        If the arguments do not fit the file; the message lists the columns and proposes a choice.
    MissingPackageError
        If nptdms, pyarrow or h5py is not installed; `pip install "ph_control[formats]"` brings them.
    FileMissingError
        If there is no such file.

    See Also
    --------
    read_csv : text tables, with options for their layout.
    read_uff, read_mat : universal files, MATLAB files.

    Notes
    -----
    Time and memory grow with the file: a table in text of 1e6 rows takes some 2 s, binary files a tenth of that.

    Examples
    --------
    >>> import io, numpy as np, scipy.io.wavfile, ph_control as phc
    >>> file = io.BytesIO()
    >>> scipy.io.wavfile.write(file, 8000, np.array([[0, 8192], [16384, -32768]], dtype=np.int16))
    >>> file.name = "bell.wav"
    >>> data = phc.read_recording(file, input="channel 1", output="channel 2")
    >>> data.time.tolist(), data.inputs.tolist(), data.outputs.tolist()
    ([0.0, 0.000125], [0.0, 0.5], [0.25, -1.0])
    """
    options = {"input": input, "output": output, "time": time, "dt": dt, "time_unit": time_unit}
    return _recording(path, {key: value for key, value in options.items() if value is not None})


def _recording(source: Any, given: Mapping[str, Any]) -> TimeResponseData:
    """Recording of a file of a logger or of MATLAB, or of a text table."""
    name = source_name(source)
    suffix = Path(name).suffix.casefold()
    if suffix in _MATLAB:
        names = {key: _dotted(given[key]) for key in _NAMES if key in given}
        return read_mat(source, **names, **{key: given[key] for key in ("dt", "time_unit") if key in given})
    if suffix in READERS:
        return _of_table(read_array_table(read_bytes(source), name, suffix), given)
    return _of_table(read_table(read_bytes(source), name, TextOptions()), given)


def _of_table(table: Table, given: Mapping[str, Any]) -> TimeResponseData:
    return recording_in(table, *(given.get(key) for key in (*_IN_TIME, "time_unit")))


def _dotted(names: object) -> Any:
    """Names of variables with a dot, as `read_mat` takes them, for paths of HDF5."""
    if isinstance(names, list | tuple):
        return [_dotted(name) for name in names]
    return names.strip("/").replace("/", ".") if isinstance(names, str) else names


def read_measurements(path: str | Path) -> Any:
    """Recording or frequency response of a file, with the defaults of its reader; of a universal file, a list."""
    measurements, _ = measured(path, {})
    return measurements if len(measurements) > 1 else measurements[0]


def measured(source: Any, options: Mapping[str, Any]) -> tuple[list[Any], Any]:
    """Recordings or frequency responses of a file, its kind told by its suffix, and weights if a column has them.

    `options` are those of all readers.  A text table is a frequency response where these or its labels say so.
    """
    name, given = source_name(source), {key: value for key, value in options.items() if value is not None}
    suffix, input, output = Path(name).suffix.casefold(), given.get("input"), given.get("output")
    if suffix in SUFFIXES:
        return read_uff(source, input=input or None, output=output), None
    if is_touchstone(name):
        columns, rows = ([role] if isinstance(role, str) else role or None for role in (input, output))
        network = read_touchstone(source, parameter=given.get("parameter", "Z"))
        return [selected_channels(network, columns, rows, name)], None
    if suffix in READERS or (suffix in _MATLAB and "frequency" not in given):
        return [_recording(source, given)], None
    if suffix not in _MATLAB:
        return _in_table(source, given)
    if output is None or "frequency_unit" not in given:
        raise StructureError(f"{name}: give --outputs, variables of the response, and --frequency-unit as well")
    unit = given["frequency_unit"]
    return [read_frequency_mat(source, given["frequency"], output, frequency_unit=unit)], None


def _in_table(source: object, given: Mapping[str, Any]) -> tuple[list[Any], Any]:
    options = TextOptions(*(given.get(key) for key in _IN_TEXT))
    given_keys, contrary = ([key for key in keys if key in given] for keys in (_IN_FREQUENCY, _IN_TIME))
    wanted = None if contrary else are_labels_of_response
    table = read_table(read_bytes(source), source_name(source), options, wanted)
    if given_keys and contrary:
        raise StructureError(
            f"{given_keys[0]}= is for frequency responses and {contrary[0]}= for recordings in time; give one"
        )
    if given_keys or (not contrary and are_labels_of_response(table.labels or ())):
        columns, units = ({key: given.get(key) for key in keys} for keys in (COLUMNS, UNITS))
        data, weights = response_in(table, columns, units, given.get("weights"))
        return [data], weights
    return [_of_table(table, given)], None

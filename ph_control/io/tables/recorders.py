"""Binary files of recorders as tables: TDMS of LabVIEW, Parquet and WAV."""

from __future__ import annotations

import io
import warnings
from typing import Any, Literal

import numpy as np
import scipy.io.wavfile

from ...exceptions import FileFormatError, PHControlError, installed
from .columns import ArrayTable

_UNKNOWN = 0xFFFFFFFF  # bytes that a WAV file announces which was written to a pipe: so many as there are


def read_array_table(content: bytes, name: str, suffix: str) -> ArrayTable:
    """Table of a file of one of the kinds `READERS`."""
    kind, reader = READERS[suffix]
    try:
        table = reader(content, name)
    except PHControlError:
        raise
    except Exception as error:
        # a damaged file ends in errors of every kind in the packages that read it
        raise FileFormatError(
            f"{name} is no {kind} file, or damaged ({type(error).__name__}); export it again, or as CSV for read_csv"
        ) from None
    if not table.arrays or not table.count:
        raise FileFormatError(f"{name} holds no samples; export it again")
    return table


def _tdms(content: bytes, name: str) -> ArrayTable:
    nptdms = installed("nptdms", f"{name}: TDMS files are read by nptdms")
    file = nptdms.TdmsFile.read(io.BytesIO(content))
    channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
    several = len({channel.group_name for channel in channels}) > 1
    lengths = {len(channel) for channel in channels}
    steps = {channel.properties.get("wf_increment") for channel in channels}
    if len(lengths) > 1 or len(steps) > 1:
        listed = ", ".join(f"{channel.name!r} {len(channel)}" for channel in channels[:10])
        raise FileFormatError(
            f"{name} has channels of several rates or lengths ({listed} samples); export those of one rate"
        )
    labels = [f"{channel.group_name}/{channel.name}" if several else str(channel.name) for channel in channels]
    units = [channel.properties.get("unit_string") for channel in channels]
    labels = [f"{label} [{unit}]" if unit else label for label, unit in zip(labels, units, strict=True)]
    step = steps.pop() if steps else None
    arrays = tuple(np.asarray(channel[:]) for channel in channels)
    return ArrayTable(name, tuple(labels), len(labels), arrays, step=float(step) if step else None)


def _parquet(content: bytes, name: str) -> ArrayTable:
    parquet = installed("pyarrow.parquet", f"{name}: Parquet files are read by pyarrow")
    table = parquet.read_table(io.BytesIO(content))
    arrays = tuple(np.asarray(column.to_numpy()) for column in table.columns)
    # columns of integers with gaps come as floats or as objects
    arrays = tuple(_without_objects(values) for values in arrays)
    return ArrayTable(name, tuple(map(str, table.column_names)), len(arrays), arrays)


def _without_objects(values: Any) -> Any:
    if values.dtype.kind != "O":
        return values
    try:
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    except (TypeError, ValueError):
        return values.astype(str)


def _check_length(content: bytes, name: str) -> None:
    """Refuse a WAV file whose samples are fewer than its header announces: scipy reads what is there."""
    order: Literal["big", "little"] = "big" if content.startswith(b"RIFX") else "little"
    place = 12
    while place < len(content):
        kind, size = content[place : place + 4], int.from_bytes(content[place + 4 : place + 8], order)
        if kind == b"data":
            # of files beyond 4 GB the first chunk has the sizes
            announced = int.from_bytes(content[28:36], order) if content.startswith(b"RF64") else size
            held = len(content) - place - 8
            if held < announced < _UNKNOWN:
                raise FileFormatError(
                    f"{name} was cut short: it announces {announced} bytes of samples, and {held} are there; "
                    "copy it again"
                )
            return
        place += 8 + size + size % 2


def _wav(content: bytes, name: str) -> ArrayTable:
    _check_length(content, name)
    with warnings.catch_warnings():
        # chunks that scipy does not know, such as names of tracks
        warnings.simplefilter("ignore")
        rate, samples = scipy.io.wavfile.read(io.BytesIO(content))
    columns = samples.reshape(len(samples), -1)
    if columns.dtype.kind in "iu":
        # full scale is 1; eight bits have their zero at 128
        middle = 128.0 * (columns.dtype == np.uint8)
        columns = (columns - middle) / (128.0 if middle else -float(np.iinfo(columns.dtype).min))
    labels = tuple(f"channel {k + 1}" for k in range(columns.shape[1]))
    return ArrayTable(name, labels, len(labels), tuple(columns.T), step=1 / rate)


READERS = {
    ".tdms": ("TDMS", _tdms),
    ".parquet": ("Parquet", _parquet),
    ".wav": ("WAV", _wav),
}

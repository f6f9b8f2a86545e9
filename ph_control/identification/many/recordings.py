"""One of many recordings: where it is, what its modes are, and where its result is kept."""

from __future__ import annotations

import functools
import glob
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from control.iosys import NamedSignal

from ..._frozen import Frozen
from ..._types import Array, ComplexArray
from ..._units import hertz_size
from ..._workers import uninterrupted
from ...exceptions import FileFormatError, PHControlError, StructureError
from ...io.codecs import document_of, load
from ...io.files import write_atomically
from ...io.measurements import read_measurements
from ..change.score_test import ChangeTest
from ..data.data_frames import is_data_frame
from ..diagnosis.verdict import Outcome
from ..fit.pem import pem
from ..fit.pem_result import PEMResult

_LETTERS = 60  # of the name of a recording in that of its file


@dataclass(frozen=True)
class OneRecording:
    """A recording, or the path of one, and what it is called."""

    name: str
    data: object


def sources(recordings: Iterable[object]) -> Iterator[OneRecording]:
    """Recordings one by one; a pattern of file names stands for the files that match, sorted."""
    for place, data in enumerate(recordings):
        if not isinstance(data, str | os.PathLike):
            yield OneRecording(str(getattr(data, "title", None) or f"recording {place}"), _plain(data))
            continue
        name = os.fspath(data)
        # a file that there is may be called like a pattern
        files = [] if os.path.exists(name) else sorted(glob.glob(name, recursive=True))
        # other processes may be in another folder
        yield from (OneRecording(file, Path(os.path.abspath(file))) for file in files or [name])


def _plain(data: Any) -> Any:
    """Data that can travel to another process, which signals of python-control cannot."""
    if isinstance(data, NamedSignal):
        return np.asarray(data)
    return type(data)(map(_plain, data)) if type(data) in (tuple, list) else data


@dataclass(frozen=True, eq=False)
class Modes(Frozen):
    """What the table of many fits says of one recording; of a failure the order is -1."""

    name: str
    message: str
    order: int = -1
    structure: str = ""
    fit_percent: float = np.nan
    numbers: Array = None  # type: ignore[assignment]  # (n, 4): hertz and damping ratio, each with its standard error
    shapes: ComplexArray = None  # type: ignore[assignment]  # (n, p)
    file: str = ""
    time_unit: str | None = None
    covariance: Array = None  # type: ignore[assignment]  # (2n, 2n) of frequencies in Hz, then damping ratios
    score: ChangeTest | str = "no reference was given"

    @classmethod
    def of(cls, result: PEMResult, name: str, file: str) -> Modes:
        """Those of a result."""
        size = hertz_size(result.time_unit)
        numbers = np.column_stack([
            result.hertz, result.stderr["natural_frequencies"] / size, result.damping_ratios,
            result.stderr["damping_ratios"],
        ])  # fmt: skip
        parts = result.order, result.structure, float(result.fit_percent), numbers, np.array(result.shapes), file
        modes = np.arange(result.order)
        places = np.concatenate([modes, len(result.poles) + modes])
        units = np.repeat([size, 1.0], result.order)
        covariance = result.covariance[np.ix_(places, places)] / np.outer(units, units)
        return cls(name, result.verdict, *parts, result.time_unit, covariance)


@dataclass(frozen=True)
class FitAndKeep:
    """Fit of one recording with these options; its result is kept in a folder, and taken from there if it is known.

    With a reference, the recording is tested against it as well.
    """

    options: Mapping[str, Any]
    reader: Callable[[Path], object] | None = None
    store: Path | None = None
    reference: PEMResult | None = None

    def __call__(self, source: OneRecording) -> Modes:
        """Modes of a recording, or the message of what went wrong."""
        modes = self._fitted(source)
        return modes if self.reference is None else replace(modes, score=self._score(self.reference, source))

    def _score(self, reference: PEMResult, source: OneRecording) -> ChangeTest | str:
        """Test of the poles of the reference on a recording, or the message of what went wrong."""
        try:
            return reference.changed(self._data(source), parameters="poles", dt=self.options.get("dt"))
        except PHControlError as error:
            return str(error)
        except Exception as error:
            return f"{type(error).__name__}: {error}"

    def _fitted(self, source: OneRecording) -> Modes:
        path = None
        try:
            path = self._place(source)
            if path is not None and path.is_file():
                with suppress(FileFormatError):  # of a file that was damaged since: the recording is fitted again
                    return Modes.of(load(path), source.name, path.name)
            result = pem(self._data(source), **self.options)
        except PHControlError as error:
            return Modes(source.name, str(error))
        except Exception as error:
            return Modes(source.name, f"{type(error).__name__}: {error}")
        if result.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if path is not None:
            document = document_of(result)
            with uninterrupted():
                write_atomically(path, document, overwrite=True)
        return Modes.of(result, source.name, "" if path is None else path.name)

    def _data(self, source: OneRecording) -> Any:
        if isinstance(source.data, Path):
            return (self.reader or read_measurements)(source.data)
        return source.data

    def _place(self, source: OneRecording) -> Path | None:
        """File of the result: the name of the recording, and what tells its content and the options from others."""
        if self.store is None:
            return None
        mark = hashlib.sha256()
        if isinstance(source.data, Path):
            with open(source.data, "rb") as stream:
                for block in iter(lambda: stream.read(1 << 20), b""):
                    mark.update(block)
            _tell(self.reader, mark.update)
        else:
            _tell(source.data, mark.update)
        _tell(self.options, mark.update)
        title = Path(source.name).stem if isinstance(source.data, Path) else getattr(source.data, "title", None)
        stem = re.sub(r"[^\w.-]+", "_", str(title or "recording"))
        return self.store / f"{stem[:_LETTERS]}-{mark.hexdigest()[:20]}.json"


def _tell(value: Any, write: Callable[[bytes], None]) -> None:
    """Write bytes that identify the content of an object, the same in every process, for a hash."""
    write(f"<{type(value).__qualname__}>".encode())
    if isinstance(value, np.ndarray):
        write(f"{value.dtype.str}{value.shape}".encode())
        write(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for key in sorted(value):
            write(str(key).encode() + b"=")
            _tell(value[key], write)
    elif isinstance(value, list | tuple):
        for element in value:
            _tell(element, write)
    elif is_data_frame(value):
        for column in value.columns:
            write(str(column).encode())
            _tell(np.asarray(value[column]), write)
    elif isinstance(value, functools.partial):
        _tell([value.func, value.args, value.keywords], write)
    elif callable(value) and hasattr(value, "__qualname__"):
        write(f"{value.__module__}.{value.__qualname__}".encode())
    elif hasattr(value, "__dict__"):
        try:
            write(document_of(value).encode())
        except StructureError:  # of what is no model, such as a time response
            _tell(vars(value), write)
    else:
        write(repr(value).encode())

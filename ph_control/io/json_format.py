"""Strict JSON documents: what `save` writes and `load` accepts, without knowing what they mean.

A document is an object with `format`, `schema`, `kind`, `data` and the checksum of kind and data.  Every float is
written with the shortest digits that give the same double again; a complex number is `[re, im]`.  JSON has no word
for NaN and infinity: they are the strings "nan", "inf" and "-inf", and only fields that allow them may hold them.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
import shutil
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import FileFormatError, FileMissingError, OutputExistsError, StructureError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

FORMAT = "ph_control"
SCHEMA = 1
_NON_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


# --- values to JSON ----------------------------------------------------------------------------------------------


def _spelt(value: float) -> str | None:
    return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"


def plain(value: Any, spelt: Callable[[float], str | None] = _spelt) -> Any:
    """Turn arrays, numpy scalars, tuples and complex numbers into what JSON has; `spelt` says what is not finite."""
    if isinstance(value, dict):
        return {key: plain(item, spelt) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        if np.iscomplexobj(value):
            value = np.stack([np.real(value), np.imag(value)], axis=-1)
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item, spelt) for item in value]
    if isinstance(value, complex):
        return [plain(value.real, spelt), plain(value.imag, spelt)]
    if isinstance(value, float) and not math.isfinite(value):
        return spelt(value)
    return value


def compose(kind: str, data: dict[str, Any]) -> str:
    """Text of a document; `data` holds plain values."""
    document = {"format": FORMAT, "schema": SCHEMA, "kind": kind, "data": data, "sha256": _checksum(kind, data)}
    return _pretty(document) + "\n"


def _checksum(kind: str, data: Any) -> str:
    canonical = json.dumps([kind, data], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


def _pretty(value: Any, indent: str = "") -> str:
    """JSON with a line for each field and each row of numbers."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        parts = [f"{json.dumps(key)}: {_pretty(item, inner)}" for key, item in value.items()]
        return "{\n" + inner + f",\n{inner}".join(parts) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, list) for item in value):
        return "[\n" + inner + f",\n{inner}".join(json.dumps(item, allow_nan=False) for item in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False)


# --- JSON to values ----------------------------------------------------------------------------------------------


def decompose(content: bytes, name: str) -> tuple[str, Fields]:
    """Kind and data of a document, its envelope checked; `name` is the file, for the errors."""
    try:
        document = _parse(content, name)
        return _open_envelope(document, name)
    except RecursionError:
        raise FileFormatError(f"{name} is damaged: it is nested too deeply to be a model") from None


def _open_envelope(document: Any, name: str) -> tuple[str, Fields]:
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise FileFormatError(
            f'{name} is JSON, but not a ph_control file: it has no "format": "{FORMAT}"; pass a file that '
            "ph_control.save has written"
        )
    envelope = Fields(document, name)
    envelope.text("format")
    schema = envelope.integer("schema")
    if schema > SCHEMA:
        raise FileFormatError(
            f"{name} has schema {schema}; this version of ph_control reads schema {_range(1, SCHEMA)}: "
            "upgrade ph_control to read it"
        )
    if schema < 1:
        raise FileFormatError(f"{name} has schema {schema}, which never existed; the file is damaged")
    kind = envelope.text("kind")
    data = envelope.nested("data")
    if "sha256" in document and envelope.text("sha256") != _checksum(kind, data.content):
        raise FileFormatError(
            f"{name} is damaged: its content does not match its checksum; restore it from a copy, or, if it was "
            'edited on purpose, delete the line "sha256"'
        )
    envelope.refuse_unknown()
    return kind, data


def _range(first: int, last: int) -> str:
    return str(first) if first == last else f"{first} to {last}"


def _parse(content: bytes, name: str) -> Any:
    if not content.strip():
        raise FileFormatError(f"{name} is empty; pass a file that ph_control.save has written")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{name} is not a text file: byte {content[error.start]:#04x} at position {error.start} is not UTF-8; "
            "pass a file that ph_control.save has written; ph-control convert makes one of a .mat file"
        ) from None
    try:
        return json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_duplicates)
    except json.JSONDecodeError as error:
        raise FileFormatError(
            f"{name} is not JSON, or damaged or cut short: line {error.lineno}, column {error.colno}: {error.msg}"
        ) from None
    except ValueError as error:
        raise FileFormatError(f"{name} is damaged: {error}") from None


def _no_constant(token: str) -> Any:
    raise ValueError(f"{token} is not JSON, and no number of a model")


def _no_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the field {twice!r} is there twice")
    return fields


class Fields:
    """The fields of one JSON object, each taken once and checked; `done` refuses what was not asked for.

    Parameters
    ----------
    content : dict
        The object.
    place : str
        Where it is, for the errors: the file and the path of fields in it.
    """

    def __init__(self, content: dict[str, Any], place: str) -> None:
        self.content = content
        self.place = place
        self.seen: set[str] = set()
        self.children: list[Fields] = []

    def __contains__(self, key: str) -> bool:
        return key in self.content

    def take(self, key: str) -> Any:
        """Value of a field that must be there."""
        if key not in self.content:
            raise FileFormatError(f"{self.place}: the field {key!r} is missing; the file is damaged or incomplete")
        self.seen.add(key)
        return self.content[key]

    def error(self, key: str, found: Any, needed: str) -> FileFormatError:
        """Error about one field."""
        return FileFormatError(f"{self.place}: {key} is {_describe(found)}, needed {needed}")

    def text(self, key: str) -> str:
        """Take a string."""
        value = self.take(key)
        if not isinstance(value, str):
            raise self.error(key, value, "a string")
        return value

    def texts(self, key: str, length: int | None = None) -> list[str]:
        """Take a list of strings."""
        value = self.take(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.error(key, value, "a list of strings")
        if length is not None and len(value) != length:
            raise FileFormatError(f"{self.place}: {key} has {len(value)} entries, needed {length}")
        return value

    def integer(self, key: str) -> int:
        """Take an integer."""
        value = self.take(key)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self.error(key, value, "an integer")
        return value

    def flag(self, key: str) -> bool:
        """Take true or false."""
        value = self.take(key)
        if not isinstance(value, bool):
            raise self.error(key, value, "true or false")
        return value

    def number(self, key: str, *, finite: bool = True) -> float:
        """Take a float."""
        return float(self.array(key, (), finite=finite))

    def array(self, key: str, shape: tuple[int | None, ...], *, finite: bool = True) -> Array:
        """Take an array of that shape; None stands for a length that the file decides."""
        found = list(shape)
        numbers: list[float] = []
        self._collect(key, self.take(key), 0, found, numbers, finite)
        # an empty list says nothing about the lengths inside it
        return np.array(numbers, dtype=float).reshape([length or 0 for length in found])

    def complex_array(self, key: str, shape: tuple[int | None, ...], *, finite: bool = True) -> ComplexArray:
        """Take an array of complex numbers, each `[re, im]`."""
        pairs = self.array(key, (*shape, 2), finite=finite)
        return pairs.view(complex)[..., 0]

    def nested(self, key: str) -> Fields:
        """Take an object; its fields are checked by `done` of this one too."""
        value = self.take(key)
        if not isinstance(value, dict):
            raise self.error(key, value, "an object with fields")
        child = Fields(value, f"{self.place}: {key}")
        self.children.append(child)
        return child

    def done(self) -> None:
        """Refuse fields that nobody asked for, here and in the objects taken from here."""
        self.refuse_unknown()
        for child in self.children:
            child.done()

    def refuse_unknown(self) -> None:
        """Refuse fields that nobody asked for."""
        extra = [key for key in self.content if key not in self.seen]
        if extra:
            raise FileFormatError(
                f"{self.place}: unknown field {extra[0]!r}; the fields here are "
                f"{', '.join(map(repr, sorted(self.seen)))}"
            )

    def _collect(
        self, place: str, value: Any, depth: int, shape: list[int | None], numbers: list[float], finite: bool
    ) -> None:
        """Walk nested lists, append their numbers, and fill in the lengths that were left open."""
        if depth == len(shape):
            numbers.append(self._float(place, value, finite))
            return
        if not isinstance(value, list):
            raise self.error(place, value, f"a list of {'numbers' if depth == len(shape) - 1 else 'lists'}")
        if shape[depth] is None:
            shape[depth] = len(value)
        if len(value) != shape[depth]:
            raise FileFormatError(
                f"{self.place}: {place} has {len(value)} entries, needed {shape[depth]}; "
                "the file is damaged or incomplete"
            )
        if depth == len(shape) - 1 and all(type(item) is float and math.isfinite(item) for item in value):
            numbers.extend(value)
            return
        for k, item in enumerate(value):
            self._collect(f"{place}[{k}]", item, depth + 1, shape, numbers, finite)

    def _float(self, place: str, value: Any, finite: bool) -> float:
        if isinstance(value, str) and value in _NON_FINITE and not finite:
            return _NON_FINITE[value]
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self.error(place, value, "a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise FileFormatError(f"{self.place}: {place} is too large for a double")
        return number


def _describe(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, list | dict):
        noun = "a list" if isinstance(value, list) else "an object"
        return f"{noun} with {len(value)} entries"
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


# --- files -------------------------------------------------------------------------------------------------------


def as_path(path: Any) -> Path:
    """Path of what the caller gave as the name of a file."""
    try:
        return Path(path)
    except TypeError:
        raise StructureError(
            f"path is {_checks.shown(path)}; it must be the name of a file, as a string or pathlib.Path"
        ) from None


def source_name(source: Any) -> str:
    """Name of what is read, for errors and titles: that of the file, also of one that is open already."""
    return str(getattr(source, "name", "the stream") if hasattr(source, "read") else source)


def _no_file_name(path: Path, error: Exception) -> StructureError:
    """Error for a name that the operating system takes for no file: too long, or with characters it does not allow."""
    name = str(path)
    shown = repr(name if len(name) <= 80 else name[:40] + "..." + name[-37:])
    reason = getattr(error, "strerror", None) or str(error)
    return StructureError(f"{shown} cannot be the name of a file: {reason}; choose another name")


def _mode(path: Path) -> int | None:
    """Kind and permissions of what a path leads to, or None if there is nothing."""
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except PermissionError:
        raise
    except (OSError, ValueError) as error:
        raise _no_file_name(path, error) from None


def read_bytes(source: Any) -> bytes:
    """Content of a file: of that name, or open already, for bytes or for text."""
    if hasattr(source, "read"):
        try:
            content = source.read()
        except ValueError as error:  # closed, open for writing only, or of another encoding
            raise StructureError(
                f"{source_name(source)} cannot be read: {error}; pass its name, or open it for reading, as bytes best"
            ) from error
        return content.encode() if isinstance(content, str) else bytes(content)
    path = as_path(source)
    mode = _mode(path)
    if mode is not None and stat.S_ISDIR(mode):
        raise FileFormatError(f"{path} is a folder; pass the file in it")
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise FileMissingError(
            f"there is no file {path} (looked from {Path.cwd()}); check its name and folder"
        ) from None


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Refuse a path that cannot be written: no file, or a file that must not be overwritten."""
    mode = _mode(path)
    if mode is not None and stat.S_ISDIR(mode):
        raise OutputExistsError(f"{path} is a folder; pass the name of a file in it")
    if mode is not None and not stat.S_ISREG(mode):
        # renaming a file to it would put the file in the place of the device
        raise OutputExistsError(f"{path} is not a regular file, but a device, a pipe or a socket; choose another name")
    if mode is not None and not mode & 0o222:
        raise OutputExistsError(f"{path} is read-only; make it writable, or choose another name")
    if not overwrite and os.path.lexists(path):
        raise OutputExistsError(f"{path} exists already; choose another name, or pass overwrite=True to replace it")
    if not path.parent.is_dir():
        raise FileMissingError(f"the folder {path.parent} does not exist; make it first")


def write_atomically(path: Path, content: str | bytes, *, overwrite: bool) -> None:
    """Write a file so that its name shows the old content or all of the new, never a part.

    The content goes to a temporary file in the same folder, reaches the disk, and then takes the name.  Without
    `overwrite` a file that somebody else makes in the meantime is left alone; with it the permissions of the old one
    stay, and a file with several names, by hard links, is written in place.
    """
    refuse_existing(path, overwrite)
    # through a symbolic link the file it points at is replaced, not the link
    target = Path(os.path.realpath(path)) if overwrite else path
    refuse_existing(target, overwrite)
    temporary = target.parent / f".{FORMAT}-{secrets.token_hex(8)}.tmp"
    try:
        # not tempfile: its files are private, this one shall have the permissions of any new file
        with _new_file(temporary, target) as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        old = target.stat() if overwrite and target.exists() else None
        if old is not None and old.st_nlink > 1:
            # all its names shall lead to the new content, which renaming would give to one only
            shutil.copyfile(temporary, target)
        elif overwrite:
            if old is not None:
                os.chmod(temporary, stat.S_IMODE(old.st_mode))
            os.replace(temporary, target)
        else:
            _name_new_file(temporary, target)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(temporary)


def _new_file(temporary: Path, target: Path) -> BinaryIO:
    """Open the temporary file; where that is not allowed, the error names the file that the caller knows."""
    try:
        return open(temporary, "xb")
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(target)) from None


def _name_new_file(temporary: Path, target: Path) -> None:
    """Give a file its name unless that is taken."""
    try:
        os.link(temporary, target)
    except OSError as error:
        refuse_existing(target, False)
        if isinstance(error, FileExistsError):
            raise
        _name_without_links(temporary, target)


def _name_without_links(temporary: Path, target: Path) -> None:
    """The same where the file system has no hard links: reserve the name with an empty file, then replace that."""
    try:
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
    except FileExistsError:
        refuse_existing(target, False)
        raise
    try:
        os.replace(temporary, target)
    except OSError:
        os.unlink(target)
        raise

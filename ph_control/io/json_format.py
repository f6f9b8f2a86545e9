"""Strict JSON documents: what `save` writes and `load` accepts, without knowing what they mean.

A document is an object with `format`, `schema`, `kind`, `data` and the checksum of kind and data.  Every float is
written with the shortest digits that give the same double again; a complex number is `[re, im]`.  JSON has no word
for NaN and infinity: they are the strings "nan", "inf" and "-inf", and only fields that allow them may hold them.
Long arrays are their bytes, as `{"shape": [..], "float64": ".."}`: little-endian doubles, compressed by zlib, base64.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import zlib
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from .._types import Array, ComplexArray
from ..exceptions import FileFormatError

Value = TypeVar("Value")

FORMAT = "ph_control"
SCHEMA = 2  # that is written; 1, of lossless systems, is a part of it
_READ = (1, 2)
_NON_FINITE = ("nan", "inf", "-inf")
_LONG = 10_000  # numbers of an array whose digits nobody reads one by one


# --- values to JSON ----------------------------------------------------------------------------------------------


def _spelt(value: float) -> str | None:
    return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"


def plain(value: object, spelt: Callable[[float], str | None] = _spelt, *, long: float = np.inf) -> Any:
    """Turn arrays, numpy scalars, tuples and complex numbers into what JSON has.

    `spelt` says what is not finite; from `long` numbers on an array is its bytes.
    """
    if isinstance(value, dict):
        return {key: plain(item, spelt, long=long) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        if np.iscomplexobj(value):
            value = np.stack([np.real(value), np.imag(value)], axis=-1)
        if value.size >= long and value.dtype == float:
            packed = base64.b64encode(zlib.compress(value.astype("<f8").tobytes()))
            return {"shape": list(value.shape), "float64": packed.decode()}
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item, spelt, long=long) for item in value]
    if isinstance(value, complex):
        return [plain(value.real, spelt), plain(value.imag, spelt)]
    if isinstance(value, float) and not math.isfinite(value):
        return spelt(value)
    return value


def compose(kind: str, data: dict[str, object]) -> str:
    """Text of a document."""
    data = plain(data, long=_LONG)
    document = {"format": FORMAT, "schema": SCHEMA, "kind": kind, "data": data, "sha256": _checksum(kind, data)}
    return _pretty(document) + "\n"


def _checksum(kind: str, data: object) -> str:
    canonical = json.dumps([kind, data], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


def _pretty(value: object, indent: str = "") -> str:
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
    if schema not in _READ:
        raise FileFormatError(
            f"{name} has schema {schema}; this version of ph_control reads schemas {_READ[0]} to {_READ[-1]}: upgrade "
            "ph_control"
        )
    kind = envelope.text("kind")
    data = envelope.nested("data")
    if "sha256" in document and envelope.text("sha256") != _checksum(kind, data.content):
        raise FileFormatError(
            f"{name} is damaged: its content does not match its checksum; restore it from a copy, or, if it was "
            'edited on purpose, delete the line "sha256"'
        )
    envelope.refuse_unknown()
    return kind, data


def _parse(content: bytes, name: str) -> Any:
    if not content.strip():
        raise FileFormatError(f"{name} is empty; pass a file that ph_control.save has written")
    try:
        return json.loads(content.decode("utf-8-sig"))
    except ValueError as error:
        raise FileFormatError(
            f"{name} is not JSON, or damaged or cut short: {error}; pass a file that ph_control.save has written, "
            "or make one by ph-control convert"
        ) from None


class Fields:
    """The fields of one JSON object, each taken once and checked; `done` refuses what was not asked for.

    Parameters
    ----------
    content : dict
        The object.
    place : str
        Where it is, for the errors: the file and the path of fields in it.
    """

    def __init__(self, content: dict[str, object], place: str) -> None:
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

    def error(self, key: str, value: object, needed: str) -> FileFormatError:
        """Error about one field."""
        return FileFormatError(f"{self.place}: {key} is {_describe(value)}, expected {needed}")

    def _typed(self, key: str, kind: type[Value], needed: str) -> Value:
        value = self.take(key)
        # not isinstance: true and false are no integers here
        if type(value) is not kind:
            raise self.error(key, value, needed)
        return value

    def text(self, key: str) -> str:
        """Take a string."""
        return self._typed(key, str, "a string")

    def texts(self, key: str) -> list[str]:
        """Take a list of strings."""
        value = self._typed(key, list, "a list of strings")
        if not all(isinstance(item, str) for item in value):
            raise self.error(key, value, "a list of strings")
        return value

    def integer(self, key: str) -> int:
        """Take an integer."""
        return self._typed(key, int, "an integer")

    def flag(self, key: str) -> bool:
        """Take true or false."""
        return self._typed(key, bool, "true or false")

    def number(self, key: str) -> float:
        """Take a float."""
        return float(self.array(key, ()))

    def array(self, key: str, shape: tuple[int | None, ...], *, finite: bool = True) -> Array:
        """Take an array of that shape; None stands for a length that the file decides."""
        value = self.take(key)
        entries = self._unpacked(key, value) if isinstance(value, dict) else np.array(value, dtype=object)
        if not entries.size:
            # an empty list says nothing about the lengths inside it
            entries = entries.reshape([*entries.shape, *(length or 0 for length in shape[entries.ndim :])])
        if len(shape) != entries.ndim or any(a not in (None, b) for a, b in zip(shape, entries.shape, strict=True)):
            needed = ", ".join("any" if length is None else str(length) for length in shape)
            raise FileFormatError(
                f"{self.place}: {key} has shape {entries.shape}, expected ({needed}); the file is damaged or incomplete"
            )
        words = () if finite else _NON_FINITE
        for entry in entries.flat if entries.dtype == object else ():
            # not isinstance: true and false are no numbers here
            if type(entry) is not float and type(entry) is not int and entry not in words:
                raise self.error(key, entry, "a number")
        try:
            numbers = entries.astype(float)
        except OverflowError:
            numbers = np.array(math.inf)
        if finite and not np.isfinite(numbers).all():
            raise FileFormatError(f"{self.place}: {key} holds NaN, or a number that is too large for a double")
        return numbers

    def _unpacked(self, key: str, value: dict[str, object]) -> Array:
        """Array of its bytes."""
        shape: Any = value.get("shape")
        packed = value.get("float64")
        fits = isinstance(shape, list) and all(type(length) is int and length >= 0 for length in shape)
        try:
            if len(value) != 2 or not fits or not isinstance(packed, str):
                raise ValueError
            size = 8 * math.prod(shape)
            content = zlib.decompressobj().decompress(base64.b64decode(packed, validate=True), size + 1)
            return np.frombuffer(content, "<f8").reshape(shape).astype(float)
        except (ValueError, zlib.error):
            raise self.error(key, value, "an array of numbers, or its shape and bytes that make it") from None

    def complex_array(self, key: str, shape: tuple[int | None, ...], *, finite: bool = True) -> ComplexArray:
        """Take an array of complex numbers, each `[re, im]`."""
        return self.array(key, (*shape, 2), finite=finite).view(complex)[..., 0]

    def nested(self, key: str) -> Fields:
        """Take an object; its fields are checked by `done` of this one too."""
        child = Fields(self._typed(key, dict, "an object with fields"), f"{self.place}: {key}")
        self.children.append(child)
        return child

    def skip(self, *keys: str) -> None:
        """Pass over fields that nothing is made of any more."""
        self.seen.update(keys)

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


def _describe(value: object) -> str:
    if value is None:
        return "null"
    if isinstance(value, list | dict):
        noun = "a list" if isinstance(value, list) else "an object"
        return f"{noun} with {len(value)} entries"
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."

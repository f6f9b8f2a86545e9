"""MATLAB's `.mat` files: level 5 is read here, with every size checked; the reader of scipy crashes on damaged ones."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import scipy.io

from ..exceptions import FileFormatError

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_UTF8 = 16
_MATRIX, _COMPRESSED = 14, 15  # types of elements that hold others
_CELL, _STRUCT, _TEXT, _SPARSE, _NUMERIC = 1, 2, 4, 5, range(6, 16)  # classes of arrays
_OBJECTS = (3, 16, 17)
_LOGICAL, _COMPLEX = 0x200, 0x800  # flags of arrays
_MOST = 1 << 26  # entries of a sparse matrix, which is filled up


class _MatlabObject(Exception):
    """What only MATLAB reads."""


def is_matlab(content: bytes, name: str) -> bool:
    """Whether this is a `.mat` file, by its mark, or its name."""
    return content.startswith(b"MATLAB ") or content.startswith(b"\x89HDF") or name.casefold().endswith(".mat")


def read_matlab(content: bytes, name: str) -> dict[str, Any]:
    """Variables of a `.mat` file: arrays, and structures as mappings; of what is no number a text in its place."""
    if content.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise FileFormatError(f"{name} is of version 7.3, not supported; save it in MATLAB with the option '-v7'")
    try:
        # the header of level 5, which the files of MATLAB 4 do not have, ends in the mark of its byte order
        order = {b"IM": "<", b"MI": ">"}[content[126:128]]
        with np.errstate(all="ignore"):
            return dict(_variables(content[128:], order))
    except _MatlabObject:
        raise FileFormatError(
            f"{name} holds a MATLAB object, which only MATLAB reads; run there [A,B,C,D] = ssdata(sys); "
            "save('model.mat', 'A','B','C','D','-v7')"
        ) from None
    except Exception as error:
        # a damaged file ends in errors of every kind, also of modules below the reader
        raise FileFormatError(
            f"{name} is not a .mat file, or damaged ({type(error).__name__}); save it in MATLAB with the option '-v7'"
        ) from None


def _variables(data: bytes, order: str) -> Iterator[tuple[str, Any]]:
    for kind, body in _elements(data, order):
        if kind == _COMPRESSED:
            yield from _variables(zlib.decompress(body), order)
        elif kind == _MATRIX:
            yield _matrix(body, order)
        else:
            raise ValueError(kind)


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of one element after the other; each must end where the data end, or before."""
    place = 0
    while place < len(data):
        kind, size = (int(word) for word in np.frombuffer(data, order + "u4", 2, place))
        start, stop = place + 8, place + 8 + size
        if kind >> 16:
            # a small element: the size in the upper half of the type, and the content in place of the size
            kind, size = kind & 0xFFFF, kind >> 16
            start, stop = place + 4, place + 4 + size
            if size > 4:
                raise ValueError(size)
        if stop > len(data):
            raise EOFError
        yield kind, data[start:stop]
        place = stop if kind == _COMPRESSED else -(-stop // 8) * 8


def _numbers(element: tuple[int, bytes], order: str) -> Any:
    kind, body = element
    return np.frombuffer(body, order + _NUMBERS[kind])


def _matrix(body: bytes, order: str) -> tuple[str, Any]:
    """Name and value of an array."""
    if not body:
        return "", np.zeros((0, 0))
    elements = _elements(body, order)
    flags = int(_numbers(next(elements), order)[0])
    kind = flags & 0xFF
    if kind in _OBJECTS:
        raise _MatlabObject
    shape = tuple(int(size) for size in _numbers(next(elements), order))
    name = next(elements)[1].decode("latin-1")
    if kind in _NUMERIC:
        parts = [_numbers(element, order).astype(float).reshape(shape, order="F") for element in elements]
        return name, parts[0] + 1j * parts[1] if flags & _COMPLEX else parts[0]
    if kind == _SPARSE and not flags & _LOGICAL:
        rows, ends, *parts = (_numbers(element, order) for element in elements)
        return name, _filled(shape, rows, ends, parts[0] + 1j * parts[1] if flags & _COMPLEX else parts[0])
    if kind == _STRUCT:
        width, names = int(_numbers(next(elements), order)[0]), next(elements)[1]
        keys = [names[k : k + width].split(b"\0")[0].decode("latin-1") for k in range(0, len(names), width)]
        values = [_matrix(part, order)[1] for _, part in elements]
        return name, dict(zip(keys, values, strict=True)) if np.prod(shape) == 1 else "an array of structures"
    if kind == _TEXT:
        return name, _text(next(elements, (_UTF8, b"")), order)
    if kind == _CELL:
        inner = [_matrix(part, order)[1] for _, part in elements]
        return name, inner if all(isinstance(one, str) for one in inner) else "a cell array"
    return name, {_SPARSE: "a sparse matrix of logical values"}[kind]


def _text(element: tuple[int, bytes], order: str) -> str:
    """Text of one row; characters of one byte, or of UTF-16 or UTF-8."""
    kind, body = element
    wide = {4: "utf-16", 17: "utf-16"}.get(kind)
    return body.decode((wide + ("-le" if order == "<" else "-be")) if wide else "utf-8" if kind == _UTF8 else "latin-1")


def _filled(shape: tuple[int, ...], rows: Any, ends: Any, values: Any) -> Any:
    # not by scipy.sparse, whose own checks let indices through that it does not survive
    ends, stored = ends.astype(np.int64), min(len(rows), len(values))
    steps = np.diff(ends, prepend=0, append=stored)
    if len(ends) != shape[1] + 1 or steps.min() < 0 or shape[0] * shape[1] > _MOST:
        raise ValueError(shape)
    full = np.zeros(shape, values.dtype)
    full[rows[: ends[-1]], np.repeat(np.arange(shape[1]), np.diff(ends))] = values[: ends[-1]]
    return full


def matlab_of(fields: Mapping[str, Any]) -> bytes:
    """Content of a `.mat` file."""
    with io.BytesIO() as buffer:
        cells = {key: np.array(value, object) if isinstance(value, list) else value for key, value in fields.items()}
        scipy.io.savemat(buffer, cells)
        content = bytearray(buffer.getvalue())
    # the header tells the time of writing: the same model shall give the same bytes
    text = b"MATLAB 5.0 MAT-file, written by ph_control"
    content[:116] = text.ljust(116)
    return bytes(content)

"""MATLAB's `.mat` files: level 5 is read here, with every size checked; the reader of scipy crashes on damaged ones.

Those of version 7.3 are HDF5, which h5py reads.
"""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.io

from ..exceptions import FileFormatError, PHControlError, installed

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_UTF8 = 16
_MATRIX, _COMPRESSED = 14, 15  # types of elements that hold others
_CELL, _STRUCT, _TEXT, _SPARSE, _NUMERIC = 1, 2, 4, 5, range(6, 16)  # classes of arrays
_OBJECTS = (3, 16, 17)
_LOGICAL, _COMPLEX = 0x200, 0x800  # flags of arrays
_MOST = 1 << 26  # entries of a sparse matrix, which is filled up
_DEEPEST = 32  # structures in one another
_MOST_NODES = 1 << 17  # arrays of a file; references of a damaged one may go in circles
_RATIO = 2000  # of the numbers of an array to its bytes: deflate, which MATLAB uses, has at most 1032
_SMALL = 1 << 20  # bytes of an array that may be declared without a content
_REAL = frozenset("biuf")


@dataclass(frozen=True)
class Elements:
    """Array of structures, or cell array: its values in the order of MATLAB, the first index fastest."""

    kind: str
    shape: tuple[int, ...]
    values: Sequence[Any]


class _MatlabObject(Exception):
    """What only MATLAB reads."""


def is_matlab(content: bytes, name: str) -> bool:
    """Whether this is a `.mat` file, by its mark, or its name."""
    return content.startswith(b"MATLAB ") or content.startswith(b"\x89HDF") or name.casefold().endswith(".mat")


def read_matlab(content: bytes, name: str) -> dict[str, object]:
    """Variables of a `.mat` file: arrays, structures as mappings, several as `Elements`; of other things a text."""
    try:
        if content.startswith((b"MATLAB 7.3", b"\x89HDF")):
            return _hdf5_variables(content, name)
        # the header of level 5, which the files of MATLAB 4 do not have, ends in the mark of its byte order
        order = {b"IM": "<", b"MI": ">"}[content[126:128]]
        with np.errstate(all="ignore"):
            return dict(_variables(content[128:], order))
    except PHControlError:
        raise
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
        if len(values) != len(keys) * math.prod(shape):
            raise ValueError(shape)
        starts = range(0, len(values), max(len(keys), 1))
        fields = [dict(zip(keys, values[k : k + len(keys)], strict=True)) for k in starts]
        return name, _structures(shape, fields)
    if kind == _TEXT:
        return name, _text(next(elements, (_UTF8, b"")), order)
    if kind == _CELL:
        inner = [_matrix(part, order)[1] for _, part in elements]
        return name, _cells(shape, inner)
    return name, {_SPARSE: "a sparse matrix of logical values"}[kind]


def _structures(shape: tuple[int, ...], values: Sequence[Mapping[str, object]]) -> Any:
    """Structure, or array of several."""
    return values[0] if len(values) == math.prod(shape) == 1 else Elements("an array of structures", shape, values)


def _cells(shape: tuple[int, ...], values: list[Any]) -> Any:
    """Cell array: a list where all of it are texts, such as names."""
    return values if all(isinstance(value, str) for value in values) else Elements("a cell array", shape, values)


def _text(element: tuple[int, bytes], order: str) -> str:
    """Text of one row; characters of one byte, or of UTF-16 or UTF-8."""
    kind, body = element
    wide = {4: "utf-16", 17: "utf-16"}.get(kind)
    return body.decode((wide + ("-le" if order == "<" else "-be")) if wide else "utf-8" if kind == _UTF8 else "latin-1")


def _filled(shape: tuple[int, ...], rows: Any, ends: Any, values: Any) -> Any:
    # not by scipy.sparse, whose own checks let indices through that it does not survive
    ends, stored = ends.astype(np.int64), min(len(rows), len(values))
    steps = np.diff(ends, prepend=0, append=stored)
    if len(ends) != shape[1] + 1 or steps.min() < 0 or (stored and rows.min() < 0) or shape[0] * shape[1] > _MOST:
        raise ValueError(shape)
    full = np.zeros(shape, values.dtype)
    full[rows[: ends[-1]], np.repeat(np.arange(shape[1]), np.diff(ends))] = values[: ends[-1]]
    return full


# --- version 7.3 -----------------------------------------------------------------------------------------------------


def _hdf5_variables(content: bytes, name: str) -> dict[str, object]:
    """Variables of a file, as `read_matlab` gives them."""
    h5py = installed(
        "h5py", f"{name} is HDF5, or of version 7.3 of MATLAB, read by h5py",
        "pip install 'ph_control[formats]', or save the file in MATLAB with the option '-v7'",
    )  # fmt: skip
    with h5py.File(io.BytesIO(content), "r") as file:
        return _Hdf5(file, h5py, name, content.startswith(b"MATLAB ")).fields(file, 0)


class _Hdf5:
    """Values of the nodes of one file; links and data outside of it are refused, and so are declared sizes it lacks."""

    def __init__(self, file: Any, h5py: Any, name: str, of_matlab: bool) -> None:
        self.file, self.h5py, self.name, self.of_matlab = file, h5py, name, of_matlab
        self.nodes = 0

    def fields(self, group: Any, depth: int) -> dict[str, Any]:
        """Variables of a file, or fields of a structure; `#refs#` holds what others refer to."""
        names = [key for key in group if not key.startswith("#")]
        for key in names:
            if not isinstance(group.get(key, getlink=True), self.h5py.HardLink):
                raise FileFormatError(f"{self.name}: {key} is a link; save it in MATLAB, which writes none")
        return {key: self.value(group[key], depth + 1) for key in names}

    def value(self, node: Any, depth: int) -> Any:
        """Array, mapping of a structure, or several of these."""
        self.nodes += 1
        if depth > _DEEPEST or self.nodes > _MOST_NODES:
            raise FileFormatError(
                f"{self.name} has arrays in more than {_DEEPEST} others, or more than {_MOST_NODES}; save those "
                "that are needed in a file of their own"
            )
        kind = self.kind(node)
        if "MATLAB_object_decode" in node.attrs or kind in ("function_handle", "opaque"):
            raise _MatlabObject
        if isinstance(node, self.h5py.Group):
            return self.sparse(node) if "MATLAB_sparse" in node.attrs else self.structure(node, depth)
        if not isinstance(node, self.h5py.Dataset):
            return "a type"
        if node.attrs.get("MATLAB_empty", 0):
            shape = tuple(int(size) for size in np.ravel(node[()]))
            return "" if kind == "char" else _cells(shape, []) if kind == "cell" else np.zeros((0, 0))
        values = self.array(node)
        if self.refers(node):
            return _cells(values.shape, [self.target(ref, depth) for ref in values.ravel(order="F")])
        if kind == "char":
            return "".join(map(chr, values.ravel().tolist()))
        if values.dtype.names is not None and {"real", "imag"} <= set(values.dtype.names):
            return values["real"].astype(float) + 1j * values["imag"].astype(float)
        if values.dtype.kind not in _REAL | {"c"}:
            return "a text"
        return values.astype(complex if values.dtype.kind == "c" else float)

    def kind(self, node: Any) -> str:
        """Class that MATLAB has written."""
        name = node.attrs.get("MATLAB_class", b"")
        return name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)

    def refers(self, node: Any) -> bool:
        """Whether an array holds references to others."""
        return self.h5py.check_ref_dtype(node.dtype) is self.h5py.Reference

    def target(self, reference: object, depth: int) -> Any:
        """What a reference refers to; an empty one to nothing."""
        return self.value(self.file[reference], depth + 1) if reference else np.zeros((0, 0))

    def array(self, node: Any) -> Any:
        """Array in the order of dimensions of the program that wrote it, at least two of them."""
        held = node.id.get_storage_size()
        if node.external or node.is_virtual:
            raise FileFormatError(f"{self.name}: {node.name} lies in another file, and no other file is opened")
        declared = math.prod(node.shape or (0,)) * node.dtype.itemsize
        if declared > _SMALL and declared > _RATIO * held:
            raise FileFormatError(
                f"{self.name}: {node.name} has {declared} bytes by its header, and {held} in the file; save it again"
            )
        if node.shape is None:
            return np.zeros((0, 0))
        values = np.asarray(node[()])
        if self.of_matlab or self.kind(node):
            # MATLAB writes the dimensions in the other order
            values = values.T
        # numbers and vectors of other programs
        return values.reshape(1, -1) if values.ndim < 2 else values

    def structure(self, group: Any, depth: int) -> Any:
        """Structure, or array of structures: then each field is an array of references."""
        own = [key for key in group if not key.startswith("#")]
        lists = [
            isinstance(node := group.get(key), self.h5py.Dataset) and self.refers(node) and not self.kind(node)
            for key in own
        ]  # fmt: skip
        if not own or not all(lists):
            return self.fields(group, depth)
        columns = {key: self.array(group[key]) for key in own}
        shapes = {values.shape for values in columns.values()}
        if len(shapes) != 1:
            raise FileFormatError(f"{self.name}: the fields of {group.name} have several sizes; save it again")
        shape = shapes.pop()
        parts = {key: values.ravel(order="F") for key, values in columns.items()}
        fields = [{key: self.target(refs[k], depth) for key, refs in parts.items()} for k in range(math.prod(shape))]
        return _structures(shape, fields)

    def sparse(self, group: Any) -> Any:
        """Sparse matrix, filled up."""
        ends = self.array(group["jc"]).ravel()
        values: Any
        rows, values = (self.array(group[key]).ravel() if key in group else np.zeros(0) for key in ("ir", "data"))
        if values.dtype.names is not None:
            values = values["real"] + 1j * values["imag"]
        shape = int(group.attrs["MATLAB_sparse"]), len(ends) - 1
        return _filled(shape, rows, ends, values.astype(complex if np.iscomplexobj(values) else float))


# --- writing ----------------------------------------------------------------------------------------------------------


def matlab_of(fields: Mapping[str, object]) -> bytes:
    """Content of a `.mat` file."""
    with io.BytesIO() as buffer:
        cells = {key: np.array(value, object) if isinstance(value, list) else value for key, value in fields.items()}
        scipy.io.savemat(buffer, cells)
        content = bytearray(buffer.getvalue())
    # the header tells the time of writing: the same model shall give the same bytes
    text = b"MATLAB 5.0 MAT-file, written by ph_control"
    content[:116] = text.ljust(116)
    return bytes(content)

"""Singular values with the components of a few vectors along the singular vectors, which are never formed themselves.

LAPACK has it: reflections make a matrix bidiagonal and turn the vectors with it, rotations make it diagonal and turn
them again.  SciPy carries these routines, but publishes them by their addresses only, for Cython.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import cython_lapack

from .._types import Array

_WORK = 64  # numbers of workspace for each row, with which reflections are applied in blocks
_SMALL = 40  # rows up to which all singular vectors are as cheap


def components(M: Array, right_vector: Array, left_vector: Array) -> tuple[Array, Array, Array]:
    """Singular values of a square matrix, descending, and vectors in the bases of its singular vectors.

    With `M = U diag(sigma) V^T` returns `sigma`, `V^T right_vector` and `U^T left_vector`.  `8 n^3 / 3` operations,
    those of `sigma` alone, and O(n^2).
    """
    n = len(M)
    if n <= _SMALL:
        return _dense(M, right_vector, left_vector)
    reduced, x, y = np.array(M, order="F"), right_vector.copy(), left_vector.copy()
    diagonal, above, for_y, for_x = np.empty((4, n))
    work, size, single = np.empty(_WORK * n), _int(n), _int(1)
    _call("dgebrd", size, size, reduced, size, diagonal, above, for_y, for_x, work, _int(len(work)))
    for vector, side, scale in ((y, b"Q", for_y), (x, b"P", for_x)):
        turn = side, b"L", b"T", size, single, size, reduced, size, scale
        _call("dormbr", *turn, vector, size, work, _int(len(work)))
    return bidiagonal_components(diagonal, above[: n - 1], x, y)


def bidiagonal_components(
    diagonal: Array, above: Array, right_vector: Array, left_vector: Array | None = None
) -> tuple[Array, Array, Array]:
    """As `components`, of the upper bidiagonal matrix with this diagonal and these numbers above it; O(n^2).

    Singular values are right to the last places relative to each, however small.
    """
    n = len(diagonal)
    sigma, superdiagonal, x = diagonal.copy(), above.copy(), right_vector.copy()
    y = np.zeros(n) if left_vector is None else left_vector.copy()
    size, single, none, count = _int(n), _int(1), _int(0), _int(left_vector is not None)
    room = _int(max(1, n))
    turned, work = (x, room, np.zeros(1), single, y, room), np.empty(4 * n)
    _call("dbdsqr", b"U", size, single, none, count, sigma, superdiagonal, *turned, work)
    # where it has vectors to turn, it is content with 90 eps; without any it takes the way of small errors
    sigma, superdiagonal = diagonal.copy(), above.copy()
    _call("dbdsqr", b"U", size, none, none, none, sigma, superdiagonal, *turned, work)
    return sigma, x, y


def bidiagonal_svd(diagonal: Array, above: Array) -> tuple[Array, Array, Array]:
    """Singular value decomposition of the upper bidiagonal matrix with this diagonal and these numbers above it.

    Divide and conquer, without the reflections that a routine for any matrix begins with.
    """
    n = len(diagonal)
    sigma, superdiagonal, size = diagonal.copy(), np.append(above, 0.0), _int(n)
    U, Vt = np.empty((2, n, n)).transpose(0, 2, 1)
    work, integers, unused, room = np.empty(3 * n * n + 4 * n), np.empty(8 * n, np.intc), np.empty(1), _int(max(1, n))
    vectors = U, room, Vt, room, unused, integers
    _call("dbdsdc", b"U", b"I", size, sigma, superdiagonal, *vectors, work, integers)
    return U, sigma, Vt


def _dense(M: Array, right_vector: Array, left_vector: Array) -> tuple[Array, Array, Array]:
    U, sigma, Vt = np.linalg.svd(M)
    return sigma, Vt @ right_vector, U.T @ left_vector


# --- addresses ------------------------------------------------------------------------------------------------


def _routine(name: str, arguments: str) -> Callable[..., None]:
    """The routine at the address that SciPy publishes; its arguments are characters (c), arrays and integers (p)."""
    capsule, api = cython_lapack.__pyx_capi__[name], ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    kinds = [ctypes.c_char_p if letter == "c" else ctypes.c_void_p for letter in arguments]
    return ctypes.CFUNCTYPE(None, *kinds)(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


_ROUTINES = {
    name: _routine(name, arguments)
    for name, arguments in {
        "dgebrd": 11 * "p", "dormbr": "ccc" + 11 * "p", "dbdsqr": "c" + 14 * "p", "dbdsdc": "cc" + 12 * "p",
    }.items()
}  # fmt: skip


def _int(value: int) -> Any:
    return ctypes.byref(ctypes.c_int(value))


def _call(name: str, *arguments: Any) -> None:
    """Call a routine with arrays, integers and letters."""
    info = ctypes.c_int(0)
    pointers = [x.__array_interface__["data"][0] if isinstance(x, np.ndarray) else x for x in arguments]
    _ROUTINES[name](*pointers, ctypes.byref(info))
    if info.value:
        raise np.linalg.LinAlgError(f"{name} of LAPACK returns {info.value}")

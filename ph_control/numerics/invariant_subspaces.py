"""Invariant subspaces of any matrix: its Schur form, clusters of eigenvalues, and the block that belongs to each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eig, rsf2csf, schur
from scipy.linalg.lapack import dgebal, zgetrf, zgetrs, ztrsen, ztrsyl

from .._checks import EPS
from .._types import Array, ComplexArray, Indices
from ..exceptions import StructureError
from .graphs import components

SAFETY = 32.0  # between a first-order error bound and what is called an error
_ROWS = 32  # of a triangular matrix that are solved together


def equilibrated(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """A system in units of its states in which rows and columns of `A` are alike in size: powers of 2 round nothing."""
    if not len(A):
        return A, B, C
    A, _, _, scale, _ = dgebal(A, scale=1)
    return A, B / scale[:, None], C * scale


def balanced(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """Units of the states, powers of two, in which rows and columns are alike in size: those of B and C as well."""
    if not len(A):
        return A, B, C
    # units do not touch the diagonal, which would hide small couplings from the balancing
    coupling = A - np.diag(np.diag(A))
    rate = float(np.linalg.norm(dgebal(coupling, scale=1)[0])) or 1.0
    # the unit of input and output does not matter, nor that of time
    whole = np.zeros((len(A) + max(len(C), B.shape[1]),) * 2)
    whole[: len(A), : len(A)] = coupling
    whole[: len(A), len(A) : len(A) + B.shape[1]] = rate * B / (np.abs(B).max() or 1.0)
    whole[len(A) : len(A) + len(C), : len(A)] = rate * C / (np.abs(C).max() or 1.0)
    scale = dgebal(whole, scale=1)[3][: len(A)]
    return A * scale / scale[:, None], B / scale[:, None], C * scale


class SchurResolvent:
    """`(s - A)^-1 B` and `C (s - A)^-1` at points `s` (K,) by one Schur form, O(n^2) a point; NaN at a pole."""

    def __init__(self, A: Array) -> None:
        self.T, self.Z = schur_form(A, turned=True)
        # the backward error of the Schur form
        self.rounding = len(A) * EPS * float(np.linalg.norm(A))

    def columns(self, s: ComplexArray, B: ComplexArray | Array) -> ComplexArray:
        """`(s - A)^-1 B`, shape (K, n, m)."""
        return _turned(self.Z, _back_substituted(self.T, s, self.Z.conj().T @ B))

    def rows(self, s: ComplexArray, C: ComplexArray | Array) -> ComplexArray:
        """`C (s - A)^-1`, shape (K, p, n)."""
        # the transpose is triangular too, in the other order
        solved = _back_substituted(self.T.T[::-1, ::-1].copy(), s, (C @ self.Z).T[::-1])
        return _turned(self.Z.conj()[:, ::-1], solved).transpose(0, 2, 1)


def _turned(Z: ComplexArray, X: ComplexArray) -> ComplexArray:
    """`Z X[:, k]` for all k, shape (K, n, m), of `X` (n, K, m)."""
    n, count, m = X.shape
    return np.asarray((Z @ X.reshape(n, count * m)).reshape(n, count, m).transpose(1, 0, 2))


def _back_substituted(T: ComplexArray, s: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Solutions `(s_k - T) X[:, k] = right` of a triangular `T`, shape (n, K, m): some rows of all at a time."""
    n, m = right.shape
    gaps = np.asarray(s) - np.diag(T)[:, None]
    gaps[:, (gaps == 0).any(axis=0)] = np.nan
    X = np.repeat(right[:, None].astype(complex), len(s), axis=1)
    rows = X.reshape(n, len(s) * m)
    for end in range(n, 0, -_ROWS):
        start = max(end - _ROWS, 0)
        rows[start:end] += T[start:end, end:] @ rows[end:]
        for k in reversed(range(start, end)):
            rows[k] += T[k, k + 1 : end] @ rows[k + 1 : end]
            X[k] /= gaps[k, :, None]
    return X


class EliminationResolvent:
    """As `SchurResolvent`, by elimination and a step of refinement: its error is that of a rounding of each entry."""

    rounding = 0.0

    def __init__(self, A: Array) -> None:
        self.A = A

    def columns(self, s: ComplexArray, B: Array | ComplexArray) -> ComplexArray:
        """`(s - A)^-1 B`, shape (K, n, m)."""
        return np.array([_eliminated(point * np.eye(len(self.A)) - self.A, np.asarray(B + 0j, complex)) for point in s])

    def rows(self, s: ComplexArray, C: Array | ComplexArray) -> ComplexArray:
        """`C (s - A)^-1`, shape (K, p, n)."""
        return np.array([_eliminated((point * np.eye(len(self.A)) - self.A).T, C.T + 0j).T for point in s])


def _eliminated(M: ComplexArray, right: ComplexArray) -> ComplexArray:
    if not right.size:
        return right
    factors, pivots, info = zgetrf(M)
    if info:
        return np.full_like(right, np.nan)
    solved, _ = zgetrs(factors, pivots, right)
    return np.asarray(solved + zgetrs(factors, pivots, right - M @ solved)[0])


class Eigenvalues(NamedTuple):
    """Eigenvalues of a triangular matrix in the order of its diagonal, with unit eigenvectors as columns.

    `overlap` are the products of left and right vectors, `separation` their sizes: the reciprocals of the condition
    numbers of the eigenvalues.
    """

    values: ComplexArray
    left_vectors: ComplexArray
    right_vectors: ComplexArray
    overlap: ComplexArray
    separation: Array


class InvariantBlock(NamedTuple):
    """Restriction `T` (k, k) of a matrix to an invariant subspace.

    `columns` (n, k) are an orthonormal basis of it, and `columns @ rows` is the projection onto it along the other
    eigenvectors.  `separation` is the cosine between left and right subspace, 1 for a normal matrix: what a
    perturbation of the matrix may be divided by to bound the motion of the mean eigenvalue.
    """

    T: ComplexArray
    columns: ComplexArray
    rows: ComplexArray
    separation: float


def schur_form(A: Array, turned: bool = False) -> tuple[ComplexArray, ComplexArray]:
    """Triangular `T` and unitary `Z` with `A = Z T Z^H`.

    A real form that is `turned` complex takes less than half the time; it is exact enough for solutions, while nearly
    coincident eigenvalues lose digits.
    """
    if not len(A):
        return A.astype(complex), A.astype(complex)
    try:
        if turned and not np.iscomplexobj(A):
            return rsf2csf(*schur(A, output="real", check_finite=False), check_finite=False)
        return schur(A, output="complex", check_finite=False)
    except np.linalg.LinAlgError:
        raise StructureError(
            f"the eigenvalues of A were not found: its entries range over {np.abs(A[A != 0]).min():.1e} to "
            f"{np.abs(A).max():.1e}; choose another unit of time, or other states"
        ) from None


def eigenvalues_of(T: ComplexArray) -> Eigenvalues:
    """Eigenvalues and eigenvectors of a triangular matrix."""
    values, left_vectors, right_vectors = eig(T, left=True, right=True, check_finite=False)
    overlap = np.sum(left_vectors.conj() * right_vectors, axis=0)
    return Eigenvalues(values, left_vectors, right_vectors, overlap, np.maximum(np.abs(overlap), EPS))


def clusters(values: ComplexArray, radius: Array) -> list[Indices]:
    """Groups of values whose disks of these radii overlap."""
    near = np.abs(values[:, None] - values) <= radius[:, None] + radius
    count, label = components(near)
    return [np.flatnonzero(label == k) for k in range(count)]


def reordered(T: ComplexArray, first: Indices) -> tuple[ComplexArray, ComplexArray, float]:
    """Triangular matrix with these eigenvalues first, the unitary matrix to it, and the separation of their block."""
    n, k = len(T), len(first)
    select = np.zeros(n, np.int32)
    select[first] = 1
    T, Q, _, _, separation, _, _ = ztrsen(select, T, np.eye(n, dtype=complex), lwork=max(1, 2 * k * (n - k)))
    return T, Q, max(float(separation), EPS)


def invariant_block(T: ComplexArray, group: Indices) -> InvariantBlock:
    """Split a cluster of eigenvalues off a triangular matrix: reorder, then solve a Sylvester equation."""
    k = len(group)
    T, Q, separation = reordered(T, group)
    rows = Q[:, :k].conj().T
    if k < len(T):
        X, scale, _ = ztrsyl(T[:k, :k], T[k:, k:], T[:k, k:], isgn=-1)
        rows = rows + X @ Q[:, k:].conj().T / scale
    return InvariantBlock(T[:k, :k], Q[:, :k], rows, separation)

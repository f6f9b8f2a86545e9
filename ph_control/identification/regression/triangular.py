"""Triangular factors of tall matrices that come in blocks, so that memory does not grow with the rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain

import numpy as np
from scipy.linalg import blas, lapack

from ..._checks import EPS
from ..._types import Array

Blocks = Callable[[], Iterable[Array]]

_SMALL = 1 << 15  # numbers up to which Householder reflections cost next to nothing
_PASSES = 3
_WELL_CONDITIONED = 0.01  # smallest diagonal of a factor of unit columns: its Gram matrix then loses four digits


def triangle(blocks: Blocks, rows: int, gram: Array | None = None) -> Array:
    """Upper triangular factor, shape (p, p), of a matrix (rows, p) whose blocks are made as arrays (p, m).

    From the Gram matrix, where that is not known yet by 2 rows p^2 operations at the speed of matrix products; where
    that would lose digits, once more with the columns orthogonalised by the factor found so far, and with reflections
    where even that does not help.
    """
    if gram is None:
        made = iter(blocks())
        first = next(made)
        if first.size <= _SMALL and first.shape[1] == rows:
            return reflect([first])
        gram = _gram(chain([first], made), None)
    guess, trusted = _by_gram(gram, None)
    for _ in range(1, _PASSES):
        if trusted:
            return guess
        guess, trusted = _by_gram(_gram(blocks(), guess), guess)
    return guess if trusted else reflect(blocks())


def _gram(blocks: Iterable[Array], guess: Array | None) -> Array:
    """Gram matrix of the columns, orthogonalised by a guess."""
    gram: Array | float = 0.0
    for block in blocks:
        # rows are solved for, not multiplied by an inverse: what a nearly singular guess blows up, it then takes back
        turned = block if guess is None else blas.dtrsm(1.0, guess, block.T, side=1, lower=0).T
        gram = gram + turned @ turned.T
    return np.asarray(gram)


def _by_gram(gram: Array, guess: Array | None) -> tuple[Array, bool]:
    """Factor from the Gram matrix of columns that a guess has orthogonalised; and whether to trust it."""
    size, empty = len(gram), np.flatnonzero(np.diag(gram) == 0)
    lengths = np.sqrt(np.diag(gram))
    lengths[empty] = 1.0
    scaled = gram / np.outer(lengths, lengths)
    scaled[empty, empty] = 1.0
    factor, failed = lapack.dpotrf(scaled, lower=0)
    if failed:
        scaled[np.diag_indices(size)] += 10 * size * EPS
        factor, failed = lapack.dpotrf(scaled, lower=0)
        if failed:
            factor = np.linalg.qr(scaled, mode="r")
            diagonal = np.diag(factor)
            factor = factor + np.diag(np.where(np.abs(diagonal) < EPS, EPS, 0.0))
        failed = True
    trusted = not failed and float(np.abs(np.diag(factor)).min(initial=1.0)) >= _WELL_CONDITIONED
    upper = factor * lengths
    upper = upper if guess is None else upper @ guess
    if trusted:
        upper[empty, empty] = 0.0
    return upper, trusted


def reflect(blocks: Iterable[Array]) -> Array:
    """The factor by Householder reflections, block by block."""
    factor: Array | None = None
    for block in blocks:
        joined = block if factor is None else np.concatenate([factor.T, block], axis=1)
        factor = reduced(joined.T)
    if factor is None:
        raise ValueError("no rows")
    return factor


def reduced(rows: Array) -> Array:
    """Upper triangular factor (p, p) of rows (m, p), fast if they are stored by columns."""
    size = rows.shape[1]
    factored = lapack.dgeqrf(rows, lwork=64 * max(1, size))[0] if rows.size else rows
    upper = np.zeros((size, size))
    upper[: min(len(rows), size)] = np.triu(factored[:size])
    return upper

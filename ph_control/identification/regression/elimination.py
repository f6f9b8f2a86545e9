"""Linear unknowns eliminated from rows of data, so that a small problem in the poles alone is left.

Of the rows only triangular factors are kept: orthogonal transformations eliminate what belongs to one experiment, then
the factors of all are put under one another, and what they share is eliminated as well (Golub and Pereyra, with the
Jacobian of Kaufman).  Rows come in blocks, so that memory does not grow with their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.linalg import blas, lapack

from ..._checks import EPS
from ..._types import Array

_WELL_CONDITIONED = 1e6  # entries of the inverse of a factor of unit columns, above which its rank is looked at

Blocks = Callable[[], Iterable[Array]]

# triangular factors
_SMALL = 1 << 15  # numbers up to which Householder reflections cost next to nothing
_PASSES = 3
_LEAST_DIAGONAL = 0.01  # smallest diagonal of a factor of unit columns: its Gram matrix then loses four digits


@dataclass(frozen=True)
class Eliminated:
    """An experiment whose own unknowns are eliminated: `own = inverse @ (above of the output - ...)`.

    `above` (k, p) are the rows that the own unknowns fit exactly, `inverse` (s, k) turns them into these unknowns,
    `below` what is left for the other columns, the last being the outputs.
    """

    inverse: Array
    above: Array
    below: Array


def eliminate(factor: Array, own: int, samples: int, smallest: float = 0.0) -> Eliminated:
    """Eliminate the first `own` columns of a triangular factor; directions that these do not reach stay below.

    Not reached is what has a relative singular value of rounding of so many samples, or below the `smallest`.
    """
    if own == 0:
        return Eliminated(np.zeros((0, 0)), factor[:0], factor)
    corner = factor[:own, :own]
    lengths = column_lengths(corner)
    scaled, there = corner / lengths, np.diag(corner) != 0
    # columns of nothing, as those of real poles, have rows of nothing as well
    if np.any(scaled[~there]) or np.any(scaled[:, ~there]):
        there[:] = True
    direct, singular = lapack.dtrtri(scaled + np.diag(np.where(there, 0.0, 1.0)))
    if not singular and np.abs(direct).max() < _WELL_CONDITIONED:
        return Eliminated(
            (direct / lengths[:, None])[:, there],
            factor[:own, own:][there],
            np.concatenate([factor[:own, own:][~there], factor[own:, own:]]),
        )
    U, sigma, Vt = np.linalg.svd(scaled)
    kept = sigma > max(smallest, tolerance(samples, own)) * sigma.max(initial=0.0)
    above = U.T @ factor[:own, own:]
    inverse = (Vt[kept].T / sigma[kept]) / lengths[:, None]
    return Eliminated(inverse, above[kept], np.concatenate([above[~kept], factor[own:, own:]]))


def tolerance(samples: int, columns: int) -> float:
    """Relative size of singular values that are rounding."""
    return max(samples, columns) * EPS


def column_lengths(columns: Array) -> Array:
    """Norms of columns, 1 where there is nothing."""
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    return np.where(lengths > 0, lengths, 1.0)


def orthogonal(columns: Array, samples: int = 0) -> tuple[Array, Array]:
    """Orthonormal basis of columns (m, k), and the matrix that turns coordinates in it into coefficients.

    Directions that are rounding of so many samples, or of m, are left out.
    """
    there = columns.any(axis=0)
    if not there.all():
        basis, inner = orthogonal(columns[:, there], samples)
        solve = np.zeros((columns.shape[1], basis.shape[1]))
        solve[there] = inner
        return basis, solve
    lengths = column_lengths(columns)
    Q, R = np.linalg.qr(columns / lengths)
    if R.size and R.shape[0] == R.shape[1]:
        direct, singular = lapack.dtrtri(R)
        if not singular and np.abs(direct).max(initial=0.0) < _WELL_CONDITIONED:
            return Q, direct / lengths[:, None]
    U, s, Vt = np.linalg.svd(R)
    kept = s > tolerance(max(samples, len(columns)), columns.shape[1]) * s.max(initial=0.0)
    return Q @ U[:, : len(s)][:, kept], (Vt[: len(s)][kept].T / s[kept]) / lengths[:, None]


def null_space(columns: Array, samples: int) -> Array:
    """Directions among columns (m, k), of unit length each, that `orthogonal` leaves out, one a row."""
    scaled = columns / column_lengths(columns)
    _, s, Vt = np.linalg.svd(np.linalg.qr(scaled, mode="r"), full_matrices=True)
    rank = int(np.sum(s > tolerance(max(samples, len(columns)), columns.shape[1]) * s.max(initial=0.0)))
    return np.asarray(Vt[rank:])


def without(values: Array, basis: Array) -> Array:
    """What of columns is perpendicular to an orthonormal basis."""
    return np.asarray(values - basis @ (basis.T @ values))


def inverse_gram(columns: Array) -> Array:
    """Pseudo-inverse of `J^T J`, its columns brought to unit length first."""
    lengths = column_lengths(columns)
    # from the triangular factor: a product of columns would square their condition
    inverse = np.linalg.pinv(np.linalg.qr(columns / lengths, mode="r"), rcond=max(1, *columns.shape) * EPS)
    return np.asarray((inverse @ inverse.T) / np.outer(lengths, lengths))


class LinearProjection:
    """The best linear unknowns at some poles, given by real numbers `x`, and what is left of the data.

    A change of each number is compared with its size, of `sizes`.
    """

    x: Array
    sizes: Array

    @property
    def loss(self) -> float:
        """Sum of squared residuals."""
        raise NotImplementedError

    @property
    def condensed(self) -> tuple[Array, Array]:
        """Residual, and its Jacobian by `x` with everything else moving along, both in a few rows."""
        raise NotImplementedError

    @cached_property
    def gradient(self) -> Array:
        """Half the gradient of the loss by `x`."""
        residual, jacobian = self.condensed
        return np.asarray(jacobian.T @ residual)

    @cached_property
    def gram(self) -> Array:
        """`J^T J` of the residuals by `x`."""
        jacobian = self.condensed[1]
        return np.asarray(jacobian.T @ jacobian)


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
    trusted = not failed and float(np.abs(np.diag(factor)).min(initial=1.0)) >= _LEAST_DIAGONAL
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

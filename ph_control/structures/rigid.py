"""Rigid-body modes of a stiffness matrix, and massless motions of a mass matrix, whose entries have been rounded."""

from __future__ import annotations

import numpy as np

from .. import _checks
from .._types import Array, Mask
from ..exceptions import StructureError

ROUNDED = 1e-9  # part of the energy of a motion that is called rounding of a stiffness where it is negative
FAINT = 1e-10  # the same, where it is positive, provided that
ROUNDED_MASS = 1e-8  # the same of a mass matrix that is said to be singular, scaled to unit diagonal
_GAP = 1e3  # times more is the next
_MARGIN = 10.0  # between a negative energy and the positive ones that are rounding too


def energy_parts(K_diagonal: Array, squares: Array, shapes: Array) -> Array:
    """Energy of modes in units of what the entries of `K` would store if nothing cancelled: free of units.

    What rounding of entries `K_ij`, in units of `sqrt(K_ii K_jj)`, can make of `w^2` is that part of
    `(|shape|^T sqrt(diag K))^2`.
    """
    return squares / np.maximum((np.abs(shapes).T @ np.sqrt(np.abs(K_diagonal))) ** 2, _checks.TINY)


def rigid_modes(squares: Array, part: Array, n: int, rtol: float | None, largest: float) -> Mask:
    """Modes of which rounding leaves a small `w^2`; a negative one beyond that is refused.

    `part` are the energies of `energy_parts`, of a structure of `n` degrees of freedom, `largest` the largest `w^2`.
    """
    allowed = ROUNDED if rtol is None else max(rtol, 8 * n * _checks.EPS)
    if part.min(initial=0.0) < -allowed:
        raise StructureError(
            f"K is indefinite: the energy of one motion is {part.min():.3g} of what its springs hold one by one, "
            f"allowed >= {-allowed:.1e} for the rounding of K; a stored energy cannot be negative, so check the signs "
            "in K, or say with rtol how far it is rounded"
        )
    if rtol is not None:
        return np.asarray(squares <= rtol * largest)
    return zeros_by_rounding(part, n, FAINT)


def zeros_by_rounding(part: Array, n: int, faint: float) -> Mask:
    """Values of size 1 and less that rounding has made of zeros: the negative ones, and those that a gap shows."""
    zero = np.asarray(part <= max(_MARGIN * -part.min(initial=0.0), 0.0))
    order = np.argsort(part)
    size = np.maximum(np.abs(part[order]), n * _checks.EPS)
    # rounding leaves a gap above what it makes of zeros
    gap = np.flatnonzero((size[:-1] <= faint) & (size[1:] >= _GAP * size[:-1]))
    zero[order[: gap.max(initial=-1) + 1]] = True
    return zero

"""Rigid-body modes of a stiffness matrix, and massless motions of a mass matrix, whose entries have been rounded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _checks
from .._types import Array, Mask
from ..exceptions import StructureError

ROUNDED = 1e-9  # part of the energy of a motion that is called rounding of a stiffness where it is negative
FAINT = 1e-10  # the same, where it is positive, provided that
ROUNDED_MASS = 1e-8  # the same of a mass matrix that is said to be singular, scaled to unit diagonal
_GAP = 1e3  # times more is the next
_ROUNDINGS = 16.0  # of the energies of single springs, in the sum of them
_MARGIN = 10.0  # between a negative energy and the positive ones that are rounding too


class EnergyParts(NamedTuple):
    """Energy of modes in units of what the entries of `K` would store if nothing cancelled, and its rounding."""

    part: Array
    noise: Array


def energy_parts(K_diagonal: Array, squares: Array, shapes: Array, scale: float) -> EnergyParts:
    """Energy of modes, each `w^2` the Rayleigh quotient of its shape, free of units.

    What rounding of entries `K_ij`, in units of `sqrt(K_ii K_jj)`, can make of `w^2` is that part of
    `(|shape|^T sqrt(diag K))^2`.  Where a shape strains hardly any spring, as that of a loose mass, what its own
    rounding strains stands for that; `scale` is the largest `|K_ii| / M_ii`.
    """
    stiff, floor = np.abs(K_diagonal), _checks.EPS * scale
    unit = np.maximum((np.abs(shapes).T @ np.sqrt(stiff) + np.sqrt(floor)) ** 2, _checks.TINY)
    return EnergyParts(squares / unit, _ROUNDINGS * _checks.EPS * ((shapes**2).T @ stiff + floor) / unit)


def rigid_modes(squares: Array, energy: EnergyParts, n: int, rtol: float | None, largest: float) -> Mask:
    """Modes of which rounding leaves a small `w^2`; a negative one beyond that is refused.

    `energy` is that of a structure of `n` degrees of freedom, `largest` the largest `w^2`.
    """
    part = energy.part
    allowed = ROUNDED if rtol is None else max(rtol, 8 * n * _checks.EPS)
    if part.min(initial=0.0) < -allowed:
        raise StructureError(
            f"K is indefinite: the energy of one motion is {part.min():.3g} of what its springs hold one by one, "
            f"allowed >= {-allowed:.1e} for the rounding of K; a stored energy cannot be negative, so check the signs "
            "in K, or say with rtol how far it is rounded"
        )
    if rtol is not None:
        return np.asarray(squares <= rtol * largest)
    return zeros_by_rounding(part, energy.noise, FAINT)


def zeros_by_rounding(part: Array, noise: Array | float, faint: float) -> Mask:
    """Values of size 1 and less that rounding has made of zeros: the negative ones, and those that a gap shows."""
    zero = np.asarray(part <= max(_MARGIN * -part.min(initial=0.0), 0.0))
    order = np.argsort(part)
    size = np.maximum(np.abs(part), noise)[order]
    # rounding leaves a gap above what it makes of zeros
    gap = np.flatnonzero((size[:-1] <= faint) & (size[1:] >= _GAP * size[:-1]))
    zero[order[: gap.max(initial=-1) + 1]] = True
    return zero

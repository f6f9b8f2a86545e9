"""Motions without kinetic energy, which follow the others and are eliminated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotri, dpstrf
from scipy.sparse import csc_array

from .. import _checks
from .._types import Array, Indices, Mask
from ..exceptions import StructureError
from ..numerics import definiteness as _definite
from .rigid import ROUNDED_MASS, zeros_by_rounding

# what to do about degrees of freedom without mass
CONDENSED = "from_second_order(M, K, F, condense=True) eliminates them statically, or give them mass"
_KNOWN = 1e-8  # of its length: how exactly a massless motion is known by the digits of a mass matrix in a file
_TAKES_PART = 1e-3  # of the largest: a degree of freedom that is named as part of such a motion


class Structure(NamedTuple):
    """Matrices on the degrees of freedom with mass, and what moves with these."""

    M: Array
    C: Array | None
    G: Array | None
    K: Array
    F: Array
    motion: Array  # all degrees of freedom, of those with mass
    kept: Indices


def with_mass(M: Array, C: Array | None, G: Array | None, K: Array, F: Array, condense: bool) -> Structure:
    """The structure on the degrees of freedom that have mass."""
    n = len(M)
    without = np.flatnonzero(np.diag(M) == 0)
    whole = Structure(M, C, G, K, F, np.eye(n), np.arange(n))
    refuse_singular(without, n, condense)
    factor = _definite.definite_factor(M)
    if factor is not None and not (condense and factor[1] * ROUNDED_MASS > 1):
        return whole
    scaled, _ = _definite.unit_diagonal(M)
    values: Array = np.linalg.eigvalsh(scaled).astype(float)
    tolerance = 8 * n * _checks.EPS
    _definite.refuse_indefinite("M", float(values[0]), max(tolerance, ROUNDED_MASS))
    if not condense:
        if values[0] > tolerance:
            return whole
        count = int((values <= max(tolerance, -10 * values[0])).sum())
        raise StructureError(
            f"M is singular: its smallest eigenvalue after scaling to unit diagonal is {values[0]:.3g}, expected > "
            f"{tolerance:.1e}; a combination of degrees of freedom moves without kinetic energy ({count} in all): "
            f"{CONDENSED}"
        )
    faint = zeros_by_rounding(values, n * _checks.EPS, ROUNDED_MASS)
    if not faint.any():
        return whole
    rest = values[~faint].min(initial=1.0)
    bound = np.sqrt(max(float(np.abs(values[faint]).max()), 2 * tolerance) * rest)
    _, pivots, rank, _ = dpstrf(scaled, tol=bound, lower=1)
    kept, massless = np.sort(pivots[:rank]) - 1, np.sort(pivots[rank:]) - 1
    return _condensed(whole, kept, massless)


def _condensed(whole: Structure, kept: Indices, massless: Indices) -> Structure:
    """The structure in `x = q_kept + X q_massless`, all that moves mass: `M q = M[:, kept] x`.

    The columns of `still` are the motions without mass, `x = 0`.
    """
    M, C, G, K, F, _, _ = whole
    n = len(M)
    mass = M[np.ix_(kept, kept)]
    still = np.zeros((n, len(massless)))
    still[kept], still[massless] = -inverse(mass) @ M[np.ix_(kept, massless)], np.eye(len(massless))
    exact = np.asarray(~M[massless].any(axis=1))
    _refuse_forces(M, F, still, exact, massless)
    for matrix in (C, G):
        if matrix is not None:
            _refuse_dampers(M, matrix, still, exact, massless)
    coupled = K @ still
    inner = symmetric(still.T @ coupled)
    smallest, tolerance = _definite.smallest_scaled_eigenvalue(inner)
    if smallest <= tolerance:
        raise StructureError(
            f"the degrees of freedom without mass ({listed(massless)}, counted from 1) cannot be eliminated: the "
            f"smallest eigenvalue of their stiffness, scaled to unit diagonal, is {smallest:.3g}, expected > "
            f"{tolerance:.1e}; one of their motions deforms no spring"
        )
    follow = -inverse(inner) @ coupled[kept].T
    motion = still @ follow
    motion[kept] += np.eye(len(kept))
    stiffness = symmetric(K[np.ix_(kept, kept)] + coupled[kept] @ follow)
    damping, gyroscopic = (None if matrix is None else matrix[np.ix_(kept, kept)] for matrix in (C, G))
    return Structure(mass, damping, gyroscopic, stiffness, F[kept], motion, kept)


def _refuse_forces(M: Array, F: Array, still: Array, exact: Mask, massless: Indices) -> None:
    """Refuse forces that act on massless motions by more than these are known."""
    scale = _definite.unit_diagonal(M)[1]
    motions = still * scale[:, None]
    motions /= np.linalg.norm(motions, axis=0)
    forces = F / scale[:, None]
    part, size = np.abs(motions.T @ forces), np.linalg.norm(forces, axis=0)
    acting = part > np.where(exact, 0.0, _KNOWN)[:, None] * size
    if (acting & exact[:, None]).any():
        refuse_acting(massless[(acting & exact[:, None]).any(axis=1)], ())
    if not acting.any():
        return
    k, port = np.unravel_index(int(np.argmax(np.where(acting, part / np.where(size, size, 1.0), 0.0))), acting.shape)
    amplitude = np.abs(motions[:, k])
    moved = np.flatnonzero(amplitude > _TAKES_PART * amplitude.max())
    raise StructureError(
        f"a force acts on degrees of freedom without mass: {part[k, port] / size[port]:.2g} of force {port + 1} acts "
        f"on a motion of ({listed(moved)}, counted from 1) that moves no mass, allowed {_KNOWN:.0e}; it would make "
        "their velocity depend on the rate of the force; move the force, or give them mass"
    )


def _refuse_dampers(M: Array, C: Array, still: Array, exact: Mask, massless: Indices) -> None:
    """Refuse dampers and gyroscopes that act on massless motions by more than these are known."""
    scale = _definite.unit_diagonal(M)[1]
    motions = still * scale[:, None]
    scaled = C / scale / scale[:, None]
    part = np.abs(scaled @ motions).max(axis=0) / np.linalg.norm(motions, axis=0)
    acting = part > np.where(exact, 0.0, _KNOWN) * np.abs(scaled).max()
    refuse_acting((), massless if acting.any() else ())


def symmetric(A: Array) -> Array:
    """Symmetric part."""
    return 0.5 * (A + A.T)


def inverse(M: Array) -> Array:
    """Inverse of a positive definite matrix, exactly symmetric."""
    scaled, scale = _definite.unit_diagonal(M)
    lower, _ = dpotri(np.linalg.cholesky(scaled), lower=1, overwrite_c=1)
    lower = np.tril(lower) / scale / scale[:, None]
    return lower + np.tril(lower, -1).T


def refuse_massless(M: csc_array, others: Sequence[csc_array | None], F: Array, condense: bool) -> None:
    """Check degrees of freedom without mass of a sparse structure: allowed where they only follow the others.

    `others` are the damping and the gyroscopic matrix, or None.
    """
    mass = M.diagonal()
    if mass.min() < 0:
        raise StructureError(
            f"M is indefinite: entry {int(mass.argmin()) + 1} of its diagonal is {mass.min():.3g}, expected >= 0"
        )
    without = np.flatnonzero(mass == 0)
    refuse_singular(without, len(mass), condense)
    if abs(M[without]).sum() > 0:
        raise StructureError(
            f"M is indefinite: rows of M with a zero on the diagonal ({listed(without)}, counted from 1) have other "
            "entries; make these rows zero, or give them mass"
        )
    damped = any(matrix is not None and abs(matrix[without]).sum() > 0 for matrix in others)
    refuse_acting(without[F[without].any(axis=1)], without if damped else ())


def refuse_singular(without: Indices, n: int, condense: bool) -> None:
    """Refuse degrees of freedom without mass among n, but for those that are to follow the others."""
    if len(without) == n:
        raise StructureError("M is zero: no degree of freedom has mass, so nothing would be left")
    if len(without) and not condense:
        raise StructureError(
            f"M is singular: {len(without)} of {n} degrees of freedom have no mass ({listed(without)}, counted from "
            f"1); {CONDENSED}"
        )


def refuse_acting(forced: Sequence[int] | Indices, damped: Sequence[int] | Indices) -> None:
    """Refuse forces and dampers on degrees of freedom without mass, which then follow with a delay."""
    if len(forced):
        raise StructureError(
            f"a force acts on degrees of freedom without mass ({listed(forced)}, counted from 1), which would make "
            "their velocity depend on the rate of the force; move the force, or give them mass"
        )
    if len(damped):
        raise StructureError(
            f"dampers act on degrees of freedom without mass (among {listed(damped)}, counted from 1), which would "
            "follow the others with a delay; give them mass, or move the dampers"
        )


def listed(indices: Sequence[int] | Indices) -> str:
    """The first of some degrees of freedom, counted from 1."""
    return ", ".join(str(k + 1) for k in indices[:8]) + (f" .. {indices[-1] + 1}" if len(indices) > 8 else "")

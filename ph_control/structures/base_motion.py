"""Structures on a base that moves: how much of each mode the motion of the base excites, and with how much mass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from .. import _checks
from .._display import Report, aligned, to_its_error
from .._frozen import Frozen, ReadOnlyMapping
from .._types import Array, ArrayLike
from ..exceptions import StructureError

_ROUNDING = 100.0  # roundings of a sum that is 0


@dataclass(frozen=True, eq=False, repr=False)
class BaseMotion(Report, Frozen):
    """Participation factors and effective masses of modes under motions of the base.

    Of a computed structure the attribute `base_motion` of what `from_second_order(base=..)` returns; of a fit made by
    `base_motion`.  There are r directions, or inputs of the fit, and p degrees of freedom, or outputs.

    Attributes
    ----------
    natural_frequencies : ndarray, shape (k,)
        Of undamped modes, or those of the fit; ascending, rad per unit time.
    contributions : ndarray, shape (k, p, r)
        What modes make of a motion of the base: shape times participation factor, whatever the scale of the shape.  A
        mode adds `-contribution s^2 / (s^2 + 2 zeta d s + d^2)` to the response of the relative acceleration; the sum
        over all modes is `base`.
    effective_masses : ndarray, shape (k, r)
        Mass that a mode moves with the base; the sum over all modes is `moving_mass`.  NaN of a fit without `masses`.
    participation_factors : ndarray, shape (k, r)
        Of shapes of unit modal mass, `phi^T M base`; of a fit their size, the root of the effective mass.
    moving_mass : ndarray, shape (r,)
        Mass that moves with the base in each direction, `base^T M base`.
    covariance : ndarray, shape (r, k, k)
        Of the effective masses of each direction; 0 of a computed structure.
    stderr : mapping
        Standard errors under the names of these attributes, and 'total' of the sum of the effective masses; empty of a
        computed structure.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> K = np.array([[2.0, -1.0], [-1.0, 1.0]])
    >>> frame = phc.from_second_order(np.eye(2), 100 * K, base=[1.0, 1.0])
    >>> frame.base_motion.effective_masses[:, 0].round(4), frame.base_motion.moving_mass
    (array([1.8944, 0.1056]), array([2.]))
    """

    natural_frequencies: Array
    contributions: Array
    effective_masses: Array
    participation_factors: Array
    moving_mass: Array
    covariance: Array
    stderr: Mapping[str, Any] = field(default_factory=lambda: ReadOnlyMapping({}))

    @property
    def total(self) -> Array:
        """Sum of the effective masses, shape (r,)."""
        return np.asarray(self.effective_masses.sum(axis=0))

    @property
    def ratios(self) -> Array:
        """Effective masses as parts of the moving mass, shape (k, r)."""
        return self.effective_masses / self.moving_mass

    def __str__(self) -> str:
        directions = self.effective_masses.shape[1]
        if np.isnan(self.effective_masses).all():  # of a fit without masses
            largest = np.abs(self.contributions).max(axis=(1, 2))
            pairs = zip(self.natural_frequencies.tolist(), largest.tolist(), strict=True)
            rows = [[str(l + 1), f"{d:.6g}", f"{size:.4g}", ""] for l, (d, size) in enumerate(pairs)]
            return "\n".join(aligned([["mode", "d", "largest contribution", ""], *rows]))
        numbers = [f" {k + 1}" if directions > 1 else "" for k in range(directions)]
        head = ["mode", "d"]
        for number in numbers:
            head += [f"effective mass{number}", *["+-"] * bool(self.stderr), "part"]
        rows = [[str(l + 1), f"{d:.6g}", *self._row(l), ""] for l, d in enumerate(self.natural_frequencies.tolist())]
        return "\n".join(aligned([[*head, ""], *rows]))

    def _row(self, l: int) -> list[str]:
        cells = []
        for k, mass in enumerate(self.effective_masses[l].tolist()):
            error = float(self.stderr["effective_masses"][l, k]) if self.stderr else 0.0
            cells += [to_its_error(mass, error), *[f"{error:.2g}"] * bool(self.stderr)]
            cells.append(f"{100 * self.ratios[l, k]:.2f} %")
        return cells


def base_directions(base: ArrayLike | None, n: int) -> Array:
    """Check directions (n,) or (n, r) in which the degrees of freedom move with the base."""
    if base is None:
        return np.zeros((n, 0))
    directions = _checks.real_array("base", base)
    directions = directions[:, None] if directions.ndim == 1 else directions
    if directions.ndim != 2 or len(directions) != n or not directions.shape[1]:
        raise StructureError(
            f"base has shape {np.shape(base)}; it must be ({n},), the motion of each degree of freedom when the base "
            f"moves by 1 and nothing deforms, or ({n}, number of directions)"
        )
    _checks.in_range("base", directions)
    still = np.flatnonzero(~directions.any(axis=0))
    if still.size:
        raise StructureError(f"base has no motion in direction {still[0]}: all its entries are 0")
    return directions


def base_forces(M: Array | sparse.csc_array, directions: Array) -> Array:
    """Forces `-M base` per unit of acceleration of the base."""
    forces = -np.asarray(M @ directions)
    still = np.flatnonzero(~forces.any(axis=0))
    if still.size:
        raise StructureError(f"no mass moves with the base in direction {still[0]}: M @ base is 0")
    return forces


def absolute(feedthrough: Array, rows: Array, directions: Array) -> Array:
    """Feedthrough of absolute accelerations from that of relative ones; 0 where masses follow through springs only."""
    carried = rows @ directions
    total = feedthrough + carried
    size = np.abs(rows) @ np.abs(directions)
    return np.where(np.abs(total) <= _ROUNDING * len(directions) * _checks.EPS * size, 0.0, total)


def motion_of_structure(M: Array, K: Array, momenta: Array, moving_mass: Array, motion: Array) -> BaseMotion:
    """Base motion of all modes of a structure with dense matrices; `motion` (n, k) takes what has mass to all."""
    squares, shapes = eigh(K, M)
    return motion_of_modes(np.sqrt(np.maximum(squares, 0.0)), shapes.T @ momenta, moving_mass, motion @ shapes)


def motion_of_modes(d: Array, factors: Array, moving_mass: Array, shapes: Array) -> BaseMotion:
    """Base motion of modes with shapes (n, k) of unit modal mass and participation factors (k, r)."""
    contributions, (k, r) = shapes.T[:, :, None] * factors[:, None, :], factors.shape
    return BaseMotion(d, contributions, factors**2, factors, moving_mass, np.zeros((r, k, k)))

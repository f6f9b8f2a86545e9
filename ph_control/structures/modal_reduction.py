"""The modes of a large structure that matter, and residual modes that make its static response right."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from .. import _checks
from .._frozen import Frozen
from .._types import Array, ArrayLike
from ..exceptions import ConditioningWarning, StructureError
from ..numerics.shift_invert import RESIDUAL, Eigensolver, Pencil, Selection, lowest_modes, modes_between
from .rigid import energy_parts, rigid_modes

_CLASSICAL = 1e-10  # relative size of coupling of modes by damping that is called none
_NOTHING = 1e-13  # part of the static response for which no residual mode is kept
# what to do about parts of matrices that belong to another term of the equations
NOTES = {
    "C": "; a skew part is gyroscopic: pass it as G=(C - C.T)/2, and (C + C.T)/2 as C",
    "K": (
        "; a skew part is circulatory (follower forces, dampers in rotating parts): no energy stores it, and it may "
        "feed the motion, so that it is no part of a port-Hamiltonian system: pass (K + K.T)/2 as K, forces and "
        "sensors of position where it acts, and close the loop u = -(K - K.T)/2 q with "
        "control.feedback(control.ss(sys), ..), which is a free StateSpace"
    ),
}
_DEPENDENT = 1e-12  # relative modal mass of a combination of residual modes that is none of its own


@dataclass(frozen=True, eq=False)
class StructuralModes(Frozen):
    """Modes that `from_second_order` has kept of a structure: its attribute `structural_modes`.

    Attributes
    ----------
    natural_frequencies : ndarray, shape (k,)
        Ascending, rad per unit time; 0 for rigid modes.
    shapes : ndarray, shape (n, k)
        Mode shapes of unit modal mass, on all degrees of freedom.
    residual_frequencies : ndarray, shape (r,)
        Of the residual modes: none of them is a natural frequency of the structure.
    residual_shapes : ndarray, shape (n, r)
        Static deflection under the forces that the modes leave, of unit modal mass, orthogonal to them.
    residuals : ndarray, shape (k,)
        `||K phi - d^2 M phi||` in units of `|| |K| |phi| ||`, the forces of the springs one by one.
    count : int
        Modes in the range that was asked for, by the inertia of a factorisation.
    is_complete : bool
        Whether the count is certain and all of them were found.
    complete_below : float
        All natural frequencies below this one are among them; 0 where that is not certain, and for a band above zero.

    Notes
    -----
    The states of the system are the displacements and momenta of `hstack([shapes, residual_shapes])`, which takes them
    to all degrees of freedom.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> K = 2 * np.eye(50) - np.eye(50, k=1) - np.eye(50, k=-1)
    >>> kept = phc.from_second_order(np.eye(50), K, np.eye(50)[0], modes=3).structural_modes
    >>> kept.natural_frequencies.round(4), kept.shapes.shape, kept.count, kept.is_complete
    (array([0.0616, 0.1231, 0.1845]), (50, 3), 3, True)
    """

    natural_frequencies: Array
    shapes: Array
    residual_frequencies: Array
    residual_shapes: Array
    residuals: Array
    count: int
    is_complete: bool
    complete_below: float = 0.0


@dataclass(frozen=True)
class ModeChoice:
    """Which modes of a large structure are kept, the lowest or those in a band, and what computes them."""

    modes: int | None
    band: tuple[float, float] | None
    residual_modes: bool
    eigensolver: Eigensolver | None

    @property
    def few(self) -> bool:
        """Whether not all modes are."""
        return self.modes is not None or self.band is not None


def structural_modes(
    M: sparse.csc_array, K: sparse.csc_array, F: Array, choice: ModeChoice, rtol: float | None
) -> StructuralModes:
    """Modes of checked sparse matrices."""
    pencil = Pencil(K, M, choice.eigensolver)
    chosen = _chosen(pencil, choice, F if choice.residual_modes else None)
    eigenpairs, wanted = chosen.eigenpairs, chosen.wanted
    energy = energy_parts(K.diagonal(), *eigenpairs, pencil.scale)
    rigid = rigid_modes(eigenpairs.squares, energy, K.shape[0], rtol, pencil.scale)[wanted]
    kept = type(eigenpairs)(eigenpairs.squares[wanted], eigenpairs.shapes[:, : wanted.sum()])
    residuals = pencil.residuals(kept)
    if residuals.max(initial=0.0) > RESIDUAL:
        raise StructureError(
            f"a mode found does not meet its equation: ||K phi - d^2 M phi|| is {residuals.max():.1e} of the forces of "
            f"the springs, allowed {RESIDUAL:.0e}; let the eigensolver iterate further, or check the scaling of K and M"
        )
    squares = np.where(rigid, 0.0, np.maximum(kept.squares, 0.0))
    stiff, residual_shapes = _residual_modes(pencil, chosen, F, kept.shapes, squares)
    if not len(squares) + len(stiff):
        raise StructureError(
            f"the structure has no natural frequency in the band {_checks.shown(choice.band)}; widen it"
        )
    complete = chosen.counted.certain and chosen.counted.below <= len(squares)
    if not complete:
        warnings.warn(
            f"whether all modes were found is not certain: the factorisation that counts {chosen.counted.below} is too "
            "inexact, as where an edge of the band lies on a natural frequency, or K and M are badly scaled; compare "
            "with another band or number of modes",
            ConditioningWarning,
            stacklevel=3,
        )
    return StructuralModes(
        np.sqrt(squares), kept.shapes, np.sqrt(stiff), residual_shapes, residuals, chosen.counted.below, complete,
        float(np.sqrt(chosen.below)) if complete else 0.0,
    )  # fmt: skip


def _chosen(pencil: Pencil, choice: ModeChoice, static: Array | None) -> Selection:
    if choice.band is None:
        return lowest_modes(pencil, _checks.whole_number("modes", choice.modes, 1, pencil.finite), static)
    low, high = (edge**2 for edge in _checks.band(choice.band))
    return modes_between(pencil, low, high, static)


def _residual_modes(pencil: Pencil, chosen: Selection, F: Array, shapes: Array, squares: Array) -> tuple[Array, Array]:
    """Squares of frequencies and shapes: the modes of the structure within the static deflections."""
    deflections, forces = chosen.deflections, chosen.forces
    part = np.einsum("ij,ij->j", deflections, forces)
    elastic = squares > 0
    dynamic = ((shapes[:, elastic].T @ F) ** 2 / squares[elastic, None]).sum(axis=0)
    if deflections.shape[1]:
        rest = np.linalg.norm(forces, axis=0) > _NOTHING * np.linalg.norm(F, axis=0)
        deflections = deflections[:, rest & (part > _NOTHING * dynamic)]
    if not deflections.shape[1]:
        return np.zeros(0), np.zeros((len(F), 0))
    mass, stiffness = (deflections.T @ (matrix @ deflections) for matrix in (pencil.M, pencil.K))
    scale = np.sqrt(np.diag(mass))
    masses, turn = eigh(mass / scale / scale[:, None])
    turn = turn[:, masses > _DEPENDENT] / np.sqrt(masses[masses > _DEPENDENT]) / scale[:, None]
    stiff, within = eigh(turn.T @ stiffness @ turn)
    return np.maximum(stiff, 0.0), deflections @ (turn @ within)


def projected_gyroscopic(G: sparse.csc_array, basis: Array) -> Array:
    """Gyroscopic matrix of the modes, skew."""
    reduced = np.asarray(basis.T @ (G @ basis))
    return 0.5 * (reduced - reduced.T)


def projected_damping(C: sparse.csc_array, basis: Array) -> Array | None:
    """Damping matrix of the modes; that of classical damping is diagonal."""
    reduced = np.asarray(basis.T @ (C @ basis))
    reduced = 0.5 * (reduced + reduced.T)
    if not reduced.any():
        return None
    size = np.sqrt(np.abs(np.diag(reduced)))
    coupling = np.abs(reduced - np.diag(np.diag(reduced)))
    return np.diag(np.diag(reduced)) if (coupling <= _CLASSICAL * size * size[:, None]).all() else reduced


def _sparse_square(name: str, value: Any, n: int | None) -> sparse.csc_array:
    """Check the entries and the size of a square matrix, sparse or dense; the result is sparse."""
    given = value if sparse.issparse(value) else _checks.real_array(name, value, 2)
    if sparse.issparse(given):
        if given.dtype.kind == "c":
            raise StructureError(f"{name} is complex; pass its real part if that is meant")
        if given.dtype.kind not in "biuf":
            raise StructureError(f"{name} does not hold real numbers: its type is {given.dtype}")
    shape, size = np.shape(given), n
    if len(shape) != 2 or shape[0] != shape[1] or not shape[0] or (size is not None and shape[0] != size):
        needed = "(n, n) with at least one degree of freedom" if size is None else f"{(size, size)}, that of M"
        raise StructureError(f"{name} has shape {shape}; it must be {needed}")
    matrix = sparse.csc_array(given, dtype=float)
    if not matrix.has_canonical_format:
        matrix = matrix.copy()
        matrix.sum_duplicates()
    _checks.finite(f"the entries of {name}", matrix.data)
    _checks.in_range(name, matrix.data)
    return matrix


def sparse_matrix(name: str, value: ArrayLike | sparse.sparray, n: int | None = None) -> sparse.csc_array:
    """Check a symmetric matrix, sparse or dense; the result is sparse."""
    matrix = _sparse_square(name, value, n)
    largest = float(np.abs(matrix.data).max(initial=0.0))
    difference = (matrix - matrix.T).tocsc()
    asymmetry, allowed = float(np.abs(difference.data).max(initial=0.0)), 1000 * matrix.shape[0] ** 0.5 * _checks.EPS
    if asymmetry > allowed * largest:
        raise StructureError(
            f"{name} is not symmetric: max |{name} - {name}.T| / max |{name}| = {asymmetry / largest:.1e}, allowed "
            f"{allowed:.1e}; pass ({name} + {name}.T)/2 if that is meant (a file may hold one triangle only)"
            + NOTES.get(name, "")
        )
    return matrix if asymmetry == 0 else (0.5 * (matrix + matrix.T)).tocsc()


def sparse_skew_matrix(name: str, value: ArrayLike | sparse.sparray, n: int) -> sparse.csc_array | None:
    """Check a skew-symmetric matrix, sparse or dense; the result is sparse, or None if it is zero."""
    matrix = _sparse_square(name, value, n)
    largest, even = (float(np.abs(part.data).max(initial=0.0)) for part in (matrix, (matrix + matrix.T).tocsc()))
    allowed = 1000 * n**0.5 * _checks.EPS
    if even > allowed * largest:
        raise _checks.not_skew(name, even / largest, allowed)
    return (0.5 * (matrix - matrix.T)).tocsc() if largest else None


def dense(value: Any) -> Any:
    """Columns of forces or rows of sensors, few and long, as an array."""
    return value.toarray() if sparse.issparse(value) else value

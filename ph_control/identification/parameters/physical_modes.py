"""Modes of a computed model at the channels of the data: poles, shapes at the outputs, participation of the inputs.

    y = D u + sum_l 2 Re(c_l x_l) + sum_r c_r x_r,      x' = p x + b^T u,

pairs of poles by those in the upper half-plane, real poles by themselves.  Poles that no well-conditioned
transformation parts, as those of a rigid body or of critical damping, are moved apart so little that no record shows
it.  They are paired with fitted ones by frequency and modal assurance (MAC).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import control as ct
import numpy as np
from scipy.optimize import linear_sum_assignment

from ... import _checks
from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices
from ...exceptions import StructureError
from ...modal.general_form import from_matrices
from ...numerics.modal_assurance import mac

_APART = 1e-4  # of the slowest rate that data show: by its square responses change
_LARGEST = 1e100  # squares and products stay numbers
_CONDITION = 1e12  # of eigenvectors of poles that were moved apart

_UNLIKE = 0.5  # logarithm of a ratio of frequencies that counts as much as shapes that have nothing in common


@dataclass(frozen=True)
class PhysicalModes:
    """Modes of a computed model.

    Attributes
    ----------
    poles : ndarray of complex, shape (n,)
        Those of positive imaginary part, then real ones.
    shapes : ndarray of complex, shape (n, p)
        What the state of each makes of the outputs.
    participation : ndarray of complex, shape (n, m)
        What the inputs make of each state.
    feedthrough : ndarray, shape (p, m)
        Response at infinity.
    """

    poles: ComplexArray
    shapes: ComplexArray
    participation: ComplexArray
    feedthrough: Array

    @property
    def real(self) -> Any:
        """Which poles are real."""
        return self.poles.imag == 0

    @cached_property
    def residues(self) -> ComplexArray:
        """Residues (n, p, m)."""
        return self.shapes[:, :, None] * self.participation[:, None, :]

    @property
    def frequencies(self) -> Array:
        """Sizes of the poles."""
        return np.abs(self.poles)

    @property
    def damping(self) -> Array:
        """Damping ratios; 1 of real poles that decay."""
        size = np.abs(self.poles)
        return np.asarray(-self.poles.real / np.where(size > 0, size, 1.0))

    def among(self, places: Indices) -> PhysicalModes:
        """Some of the modes."""
        return PhysicalModes(self.poles[places], self.shapes[places], self.participation[places], self.feedthrough)

    def of_outputs(self, outputs: Indices) -> PhysicalModes:
        """The modes at some of the outputs."""
        return PhysicalModes(self.poles, self.shapes[:, outputs], self.participation, self.feedthrough[outputs])


def modes_of_system(sys: Any, slowest: float) -> PhysicalModes:
    """Modes of a linear system of continuous time.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction, or any system of this package
        The model.
    slowest : float
        Rate, per unit time, below which data show none.

    Returns
    -------
    PhysicalModes
        Its modes, hidden ones among them.

    Raises
    ------
    StructureError
        If it is no linear system of continuous time, or is not finite.
    """
    plant = _as_state_space(sys)
    A, B, C, D = (np.asarray(matrix, float) for matrix in (plant.A, plant.B, plant.C, plant.D))
    if not all(np.isfinite(matrix).all() for matrix in (A, B, C, D)):
        raise StructureError("the system has entries that are not finite")
    if not len(A):
        none = np.zeros(0, complex)
        return PhysicalModes(none, np.zeros((0, len(C)), complex), np.zeros((0, B.shape[1]), complex), D)
    with np.errstate(all="ignore"):
        form = from_matrices(A, B, C, D)
        poles, participation, seen = form.equations
        shapes = seen.T / np.where(poles.imag == 0, 1.0, 2.0)[:, None]
        parts = [(poles, shapes, participation)]
        parts += [_moved_apart(block, slowest) for block in form.clusters]
        poles, shapes, participation = (np.concatenate(each) for each in zip(*parts, strict=True))
        order = np.lexsort((np.abs(poles), poles.imag == 0))
        modes = PhysicalModes(poles[order], shapes[order], participation[order], D)
        sizes = np.concatenate([np.abs(poles), np.abs(modes.residues).ravel()])
    if not np.all(sizes < _LARGEST):
        raise StructureError(
            f"the system has poles or residues of {sizes.max():.3g}; let those of the data be of another unit"
        )
    return modes


def _as_state_space(sys: Any) -> ct.StateSpace:
    if isinstance(sys, ct.TransferFunction) and not sys.isdtime(strict=True):
        sys = ct.ss(sys)
    if not isinstance(sys, ct.StateSpace):
        sys = getattr(sys, "state_space", lambda: sys)() if hasattr(sys, "equations") else sys
    if not isinstance(sys, ct.StateSpace):
        raise StructureError(
            f"the model function returns {_checks.shown(sys)}; it must return a StateSpace, a TransferFunction or a "
            "system of this package"
        )
    if sys.isdtime(strict=True):
        raise StructureError(
            f"the model function returns a system of discrete time, dt = {sys.dt}; it must be of continuous time"
        )
    return sys


def _moved_apart(block: Any, slowest: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Poles, shapes and participation of a cluster whose coupling back to the first states is no longer 0.

    Of `[[p, a], [0, p]]` the entry below becomes `-(delta^2) / a`: poles `p +- i delta`, and a response that differs by
    the square of `delta` times the time.
    """
    T = np.asarray(block.A, float)
    above = np.triu(T, 1)
    inside = np.diag(np.diag(T, 1) * (np.diag(T, -1) != 0), 1)  # of the 2 x 2 blocks of pairs
    above = above - inside
    size = float(np.abs(above).max(initial=0.0))
    centre = float(np.abs(np.linalg.eigvals(T)).min())
    delta = _APART * max(min(slowest, centre) if centre > slowest else slowest, EPS * size)
    moved = T - (delta / size) ** 2 * above.T if size else T + delta * np.diag(np.linspace(-1.0, 1.0, len(T)))
    poles, vectors = np.linalg.eig(moved)
    if not np.linalg.cond(vectors) < _CONDITION:
        raise StructureError(
            f"the system has {len(T)} poles next to {poles[0]:.4g} that no transformation parts; change the values of "
            "its elements a little"
        )
    kept = poles.imag >= 0
    participation = np.linalg.solve(vectors, block.B.astype(complex))
    return poles[kept], (block.C @ vectors).T[kept], participation[kept]


def paired(
    frequencies: Array, shapes: ComplexArray, computed: Array, computed_shapes: ComplexArray
) -> tuple[Indices, Array]:
    """Pair each fitted mode with a computed one, as far as there are some.

    Parameters
    ----------
    frequencies, computed : ndarray, shape (n,) and (k,)
        Of fitted and computed modes.
    shapes, computed_shapes : ndarray of complex, shape (n, p) and (k, p)
        At the same outputs; of one output they tell nothing.

    Returns
    -------
    ndarray of int, shape (n,)
        Place of the computed mode, -1 for none.
    ndarray, shape (n,)
        MAC of the pair; NaN for none.
    """
    distance = np.abs(np.log(np.maximum(frequencies, 1e-300))[:, None] - np.log(np.maximum(computed, 1e-300)))
    alike = mac(shapes, computed_shapes) if shapes.shape[1] > 1 else np.ones(distance.shape)
    places = np.full(len(frequencies), -1)
    mine, its = linear_sum_assignment(distance / _UNLIKE + (1.0 - alike))
    places[mine] = its
    assurance = np.full(len(frequencies), np.nan)
    assurance[mine] = alike[mine, its]
    return places, assurance


def followed(before: PhysicalModes, after: PhysicalModes) -> PhysicalModes:
    """Modes in the order of those of neighbouring parameters; as they were where poles turned real, or complex."""
    order = np.empty(len(before.poles), int)
    for mine, others in (
        (np.flatnonzero(before.real), np.flatnonzero(after.real)),
        (np.flatnonzero(~before.real), np.flatnonzero(~after.real)),
    ):
        if len(mine) != len(others):
            return before
        order[mine] = others[_nearest(before.poles[mine], after.poles[others])]
    return after.among(order)


def _nearest(before: ComplexArray, after: ComplexArray) -> Indices:
    """Place of each pole among others that are so near that each has one."""
    distance = np.abs(before[:, None] - after[None])
    return np.asarray(linear_sum_assignment(distance)[1], int)

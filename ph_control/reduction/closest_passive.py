"""The passive model closest to another of the same poles: linear constraints at the worst frequencies.

    G(s) = C (s - A)^-1 B + D,    A and B as they are,    (theta - theta_0)^T W^-1 (theta - theta_0) least,

`theta` the entries of `C` and `D`.  Passive models are a convex set of them: at a frequency where a model is active
the worst direction gives a half-space in which all passive models lie, `v^H (G + G^H) v >= 0`, or `Re u^H S v <= 1` of
a scattering matrix.  The closest model in all half-spaces known so far is active elsewhere, and less; the exact test
of passivity says when there is nothing left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from .._types import Array, ComplexArray
from ..exceptions import StructureError
from ..modal.general_form import from_matrices
from ..modal.positive_real import Passivity
from ..numerics.least_distance import least_distance
from .worst_frequencies import minima

_INSIDE = (1e-7, 1e-5, 1e-3, 1e-1)  # of the distance: by which constraints are kept, so that rounding breaks none
_ROUNDS = 60  # of new worst frequencies
_FLAT = 24  # rounds of half-spaces as they are; the later ones, where the set is strongly curved, cut deeper
_DEEPER = 0.2  # each by so much more of the violation, at most by as much again
_ROUNDING = 1e-13  # of the largest eigenvalue
_SINGULAR = 1e-12  # of the size of the model: an eigenvalue of a feedthrough that is 0


@dataclass(frozen=True)
class Closest:
    """The closest passive model, its squared distance, and the force of the constraints.

    The entries of `C` and `D`, row by row, are moved by the covariance times the force.
    """

    C: Array
    D: Array
    distance: float
    force: Array


@dataclass(frozen=True)
class FixedPoles:
    """Models of the poles of `A` whose inputs are those of `B`, stable: the frequency responses of all `C` and `D`."""

    A: Array
    B: Array
    scattering: bool

    @cached_property
    def _poles(self) -> ComplexArray:
        return np.asarray(np.linalg.eigvals(self.A), complex)

    @cached_property
    def _modes(self) -> Any:
        n, m = self.B.shape
        return from_matrices(self.A, self.B, np.eye(n), np.zeros((n, m)))

    def states(self, omega: Array) -> ComplexArray:
        """Response of the states, shape (K, n, m)."""
        return np.moveaxis(self._modes.evaluate(1j * omega), 2, 0)

    def activity(self, G: ComplexArray) -> tuple[Array, ComplexArray, ComplexArray]:
        """Values that must not be negative, and their directions `u` and `v`, for responses (K, m, m)."""
        if self.scattering:
            U, s, V = np.linalg.svd(G)
            return 1 - s, U, V.conj().transpose(0, 2, 1)
        values, U = np.linalg.eigh(G + G.conj().transpose(0, 2, 1))
        return np.asarray(values, float), U, U

    def worst(self, C: Array, D: Array) -> list[float]:
        """Frequencies at which a model may be active: from a grid while that shows any, then by the exact test."""

        def least(omega: Array) -> Array:
            return np.asarray(self.activity(C @ self.states(omega) + D)[0].min(axis=1), float)

        found = [0.0, *minima(least, self._poles)]
        G = C @ self.states(np.array(found)) + D
        if np.any(self.activity(G)[0].min(axis=1) < -_ROUNDING * self._sizes(G)):
            return found
        bands = Passivity(self.A, self.B, C, D, scattering=self.scattering).bands()
        ends = [one for band in bands for one in (band.low, band.high) if one == 0.0]
        return sorted({*(band.worst for band in bands if np.isfinite(band.worst)), *ends})

    def _sizes(self, G: ComplexArray) -> Array:
        return np.asarray(np.linalg.norm(G, axis=(1, 2)) + float(self.scattering), float)


@dataclass(frozen=True)
class _Plane:
    """`offset + gradient . theta >= 0`."""

    offset: float
    gradient: Array


@dataclass(frozen=True)
class _Cuts:
    """Constraints on the models of some poles; `free` says whether the feedthrough may move."""

    family: FixedPoles
    through: Array
    free: bool

    def at(self, w: float, C: Array, D: Array) -> list[_Plane]:
        """Constraints that a model breaks at a finite frequency."""
        K = self.family.states(np.array([w]))
        G = C @ K + D
        values, U, V = (part[0] for part in self.family.activity(G))
        rounding = _ROUNDING * self.family._sizes(G)[0]
        found = []
        for value, u, v in zip(values, U.T, V.T, strict=True):
            if value < -rounding:
                sign, offset = (-1.0, 1.0) if self.family.scattering else (2.0, 0.0)
                found.append(self._plane(offset, sign * np.outer(u.conj(), K[0] @ v), sign * np.outer(u.conj(), v)))
        return found

    def at_infinity(self, C: Array, D: Array) -> list[_Plane]:
        """Constraints that a model breaks at infinite frequency, where the feedthrough is singular at higher order."""
        none = np.zeros_like(C)
        found = []
        if self.free or self.family.scattering:
            values, U, V = (part[0] for part in self.family.activity(np.asarray(D[None], complex)))
            for value, u, v in zip(values, U.T, V.T, strict=True):
                if value < 0 and self.free:
                    sign, offset = (-1.0, 1.0) if self.family.scattering else (2.0, 0.0)
                    found.append(self._plane(offset, none, sign * np.outer(u.conj(), v)))
            return found
        A, B = self.family.A, self.family.B
        full, empty = self._kernel
        b1, b0 = B @ full, B @ empty
        S = full.T @ (D + D.T) @ full
        X = (full.T @ C @ b0 - b1.T @ C.T @ empty) / 1j
        K2 = -(empty.T @ C @ A @ b0 + (empty.T @ C @ A @ b0).T)
        values, W = np.linalg.eigh(np.block([[S, X], [X.conj().T, K2]]))
        for value, w in zip(values, W.T, strict=True):
            if value < -_ROUNDING * np.abs(values).max():
                u1, u0 = full @ w[: full.shape[1]], empty @ w[full.shape[1] :]
                gradient = 2 * np.outer(u1.conj(), B @ u0) / 1j - 2 * np.outer(u0, (B @ u1).conj()) / 1j
                gradient = gradient - 2 * np.outer(u0.conj(), A @ B @ u0)
                found.append(self._plane(float(np.real(u1.conj() @ (D + D.T) @ u1)), gradient, np.zeros_like(D)))
        return found

    def symmetric(self) -> list[_Plane]:
        """Equations where the feedthrough is singular: the first order at infinity is symmetric.

        Outputs of ports that drive nothing are 0.
        """
        if self.free or self.family.scattering:
            return []
        _, U = self._kernel
        _, s, V = np.linalg.svd(self.family.B @ U)
        unmoved = np.append(s, np.zeros(len(V) - len(s))) <= _SINGULAR * max(s.max(initial=0.0), np.finfo(float).tiny)
        U = U @ V.T
        b, n = self.family.B @ U, len(self.family.B)
        idle, moving = np.flatnonzero(unmoved), np.flatnonzero(~unmoved)
        found = [np.outer(U[:, k], row) for k in idle for row in np.eye(n)]
        found += [np.outer(U[:, k], b[:, j]) - np.outer(U[:, j], b[:, k]) for k in moving for j in moving if j < k]
        return [self._plane(0.0, one, np.zeros_like(self.through)) for one in found]

    @cached_property
    def _kernel(self) -> tuple[Array, Array]:
        """Directions of ports in which the fixed feedthrough takes in energy, and the others."""
        values, U = np.linalg.eigh(self.through + self.through.T)
        full = values > _SINGULAR * max(np.abs(values).max(initial=0.0), np.finfo(float).tiny)
        return U[:, full], U[:, ~full]

    def _plane(self, offset: float, by_C: Any, by_D: Any) -> _Plane:
        return _Plane(offset, np.concatenate([np.real(by_C).ravel(), np.real(by_D).ravel()]))


def closest_passive(family: FixedPoles, C: Array, D: Array, covariance: Array) -> Closest:
    """The passive model closest to `(C, D)` in the metric of a covariance, which may be singular.

    Entries of `D` without variance are fixed, and then `D` must be passive by itself.

    Raises
    ------
    StructureError
        If what may move does not reach a passive model.
    """
    for inside in _INSIDE:
        found = _closest(family, C, D, covariance, inside)
        if found is not None:
            return found
    raise StructureError(
        "no passive model was found by moving residues alone: let the feedthrough move too (weight=(omega, weights)), "
        "or give the system in better scaled states"
    )


def _closest(family: FixedPoles, C: Array, D: Array, covariance: Array, inside: float) -> Closest | None:
    cuts = _Cuts(family, D, bool(np.any(np.diag(covariance)[C.size :] > 0)))
    centre = np.concatenate([C.ravel(), D.ravel()])
    equal, planes = cuts.symmetric(), list[_Plane]()
    theta, force, distance = centre, np.zeros_like(centre), 0.0
    reach = 0.0
    for round_ in range(_ROUNDS):
        c, d = theta[: C.size].reshape(C.shape), theta[C.size :].reshape(D.shape)
        new = cuts.at_infinity(c, d) + [plane for w in family.worst(c, d) for plane in cuts.at(w, c, d)]
        deeper = min(1.0, _DEEPER * max(0, round_ - _FLAT))
        new = [replace(one, offset=one.offset + deeper * (one.offset + one.gradient @ theta)) for one in new]
        settled = all(abs(one.gradient @ theta) <= _ROUNDING * np.abs(one.gradient) @ np.abs(theta) for one in equal)
        if not new and (settled or planes or distance):
            return Closest(c, d, distance, force)
        rows = [*equal, *planes, *new]
        A = np.array([one.gradient for one in rows])
        size = np.sqrt(np.maximum(np.einsum("ij,ij->i", A @ covariance, A), 0.0))
        if not np.all(size > 0):
            return None
        A = A / size[:, None]
        short = -(np.array([one.offset for one in rows]) / size + A @ centre)
        reach = max(reach, float(short[len(equal) :].max(initial=0.0)))
        short[len(equal) :] += inside * reach
        solved = least_distance(A @ covariance @ A.T, short, len(equal))
        if solved is None:
            return None
        force = A.T @ solved
        moved = covariance @ force
        theta, distance = centre + moved, float(force @ moved)
        planes = [one for one, weight in zip(rows[len(equal) :], solved[len(equal) :], strict=True) if weight > 0]
    return None

"""Reduced models of least H2 error: first the best of all models, then the best of port-Hamiltonian ones.

With Gramians `P` and `Q` of the error `G - G_r`, split as its states,

    |G - G_r|^2 = |G|^2 - 2 tr(C P12 Cr^T) + tr(Cr P22 Cr^T),

and its gradients by `Ar`, `Br`, `Cr` are `2 (Q22 P22 + Q12^T P12)`, `2 (Q22 Br + Q12^T B)`, `2 (Cr P22 - C P12)`.
Where all three vanish the reduced model is a projection of the large one, which the iteration uses (Wilson 1970; Xu
and Zeng 2011), with poles mirrored at the axis where it leaves the stable ones.  There are many such models, and
symmetric starts stay symmetric: the iteration starts at random ones too.  Port-Hamiltonian models are
`Ar = J - L L^T - Y Y^T` with unit energy, without constraints.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, qr, schur
from scipy.linalg.lapack import dtrsyl
from scipy.optimize import minimize

from .._checks import EPS
from .._types import Array, ComplexArray
from .modal_truncation import Parts

_STARTS = 12  # beside the balanced one
_SHORT = 30  # projections of each
_KEPT = 3  # of the best starts are followed further
_ITERATIONS = 300  # projections of these
_SETTLED = 1e-14  # of the squared norm of the system: change of the squared error
_DECAY = 1e-9  # of the fastest pole: least decay of a mirrored one
_STEPS = 2000  # of quasi-Newton
_ENOUGH = 1e-10  # of the squared error: what a last step makes of it
_WELL_PARTED = 1e6  # product of the conditions of the modes of two systems that their Gramians are made of
_PART = 1e-13  # of the largest eigenvalue of the feedthrough: one that is 0

Matrices = tuple[Array, Array, Array]


class _Modes(NamedTuple):
    """Poles, modes as columns, their inverse, and the condition of both."""

    poles: ComplexArray
    vectors: ComplexArray
    inverse: ComplexArray
    condition: float


@dataclass(frozen=True)
class Full:
    """A stable system, of which H2 norms and distances are measured."""

    A: Array
    B: Array
    C: Array

    @cached_property
    def modes(self) -> _Modes:
        """Modes of a condition that is infinite where they do not span all states."""
        poles, vectors = np.linalg.eig(self.A)
        try:
            inverse = np.linalg.inv(vectors)
        except np.linalg.LinAlgError:
            return _Modes(poles, vectors, vectors, np.inf)
        return _Modes(poles, vectors, inverse, float(np.linalg.norm(vectors) * np.linalg.norm(inverse)))

    @cached_property
    def _schur(self) -> tuple[Array, Array]:
        T, U = schur(self.A, output="real")
        return np.asfortranarray(T), U

    @cached_property
    def squared_norm(self) -> float:
        """Square of the H2 norm."""
        P, _ = self.crossed(self)
        return float(np.sum((self.C @ P) * self.C))

    def crossed(self, other: Full) -> tuple[Array, Array]:
        """Gramians `P12`, `Q12` of the difference to another system."""
        if self.modes.condition * other.modes.condition <= _WELL_PARTED:
            P, Q = _of_modes(self.modes.poles, self.modes.inverse @ self.B, self.C @ self.modes.vectors, other)
            return (self.modes.vectors @ P).real, (self.modes.inverse.T @ Q).real
        (T, U), (t, u) = self._schur, other._schur
        P = U @ _sylvester(T, t, U.T @ self.B @ (u.T @ other.B).T, "N", "T") @ u.T
        Q = -U @ _sylvester(T, t, U.T @ self.C.T @ (other.C @ u), "T", "N") @ u.T
        return P, Q

    def error(self, small: Full) -> tuple[float, Matrices]:
        """Squared H2 error less the squared norm of the system, and its gradients by the matrices of a small system."""
        (P12, Q12), (P22, minus_Q22) = self.crossed(small), small.crossed(small)
        value = float(np.sum(small.C * (small.C @ P22 - 2 * self.C @ P12)))
        by_A = 2 * (Q12.T @ P12 - minus_Q22 @ P22)
        return value, (by_A, 2 * (Q12.T @ self.B - minus_Q22 @ small.B), 2 * (small.C @ P22 - self.C @ P12))


def _of_modes(poles: ComplexArray, b: ComplexArray, c: ComplexArray, other: Full) -> tuple[ComplexArray, ComplexArray]:
    """Gramians of modes, a row of each for each, to another system, whose modes are well parted too."""
    gaps = poles[:, None] + other.modes.poles
    P = -((b @ (other.modes.inverse @ other.B).T) / gaps) @ other.modes.vectors.T
    return P, ((c.T @ (other.C @ other.modes.vectors)) / gaps) @ other.modes.inverse


@dataclass(frozen=True)
class _OfModes(Full):
    """A system of which the states are real and imaginary parts of its modes, those of pairs `k` before real ones.

    Where the modes of both are well parted, Gramians to a small system cost a quotient for each pair of them.
    """

    poles: ComplexArray
    b: ComplexArray
    c: ComplexArray
    condition: float

    def crossed(self, other: Full) -> tuple[Array, Array]:
        """Gramians `P12`, `Q12` of the difference to another system."""
        if not self.condition * other.modes.condition <= _WELL_PARTED:
            return super().crossed(other)
        P, Q = _of_modes(self.poles, self.b, self.c, other)
        pairs = int(np.count_nonzero(self.poles.imag))
        return (
            np.concatenate([P.real[:pairs], P.imag[:pairs], P.real[pairs:]]),
            np.concatenate([2 * Q.real[:pairs], -2 * Q.imag[:pairs], Q.real[pairs:]]),
        )


def in_modes(full: Full) -> Full:
    """The same system in coordinates of its modes; itself where they are not well parted."""
    modes = full.modes
    if not modes.condition <= _WELL_PARTED:
        return full
    kept = np.concatenate([np.flatnonzero(modes.poles.imag > 0), np.flatnonzero(modes.poles.imag == 0)])
    poles, b, c = modes.poles[kept], (modes.inverse @ full.B)[kept], (full.C @ modes.vectors)[:, kept]
    pair, real = np.split(np.arange(len(kept)), [int(np.count_nonzero(poles.imag))])
    turning = np.diag(poles.imag[pair])
    A = block_diag(np.block([[np.diag(poles.real[pair]), -turning], [turning, np.diag(poles.real[pair])]]),
                   np.diag(poles.real[real]))  # fmt: skip
    B = np.concatenate([b.real[pair], b.imag[pair], b.real[real]])
    C = np.hstack([2 * c.real[:, pair], -2 * c.imag[:, pair], c.real[:, real]])
    return _OfModes(A, B, C, poles, b, c, modes.condition)


def _sylvester(T: Array, t: Array, right: Array, first: str, second: str) -> Array:
    """`X` with `T X + X t + right = 0`, matrices of real Schur form transposed as said."""
    X, scale, _ = dtrsyl(T, t, np.asfortranarray(-right), trana=first, tranb=second)
    return np.asarray(X / scale, float)


def stationary_models(full: Full, order: int) -> list[tuple[float, Matrices]]:
    """Models at which the H2 error is stationary, the best first, with the squared error less the squared norm.

    Iterations start at the leading states of a system in balanced coordinates, and at random models of their size.
    """
    rng = np.random.default_rng(0)
    start = full.A[:order, :order], full.B[:order], full.C[:, :order]
    starts = [start]
    for _ in range(_STARTS):
        A, B, C = (M + np.abs(M).mean() * rng.standard_normal(M.shape) for M in start)
        starts.append((A, B, C))
    full = in_modes(full)
    stationary = _best(_stationary(full, model, _SHORT) for model in starts)[:_KEPT]
    return _best(_stationary(full, model, _ITERATIONS) for _, model in stationary)


def _best(models: Iterable[tuple[float, Matrices]]) -> list[tuple[float, Matrices]]:
    return sorted(models, key=lambda candidate: candidate[0])


def _stationary(full: Full, start: Matrices, iterations: int) -> tuple[float, Matrices]:
    """The best model on the way of the projections, and its squared error less the norm of the system."""
    model = Full(_mirrored(start[0]), *start[1:])
    best, least, before = model, full.error(model)[0], np.inf
    for _ in range(iterations):
        V, W = (qr(part, mode="economic")[0] for part in full.crossed(model))
        both = W.T @ V
        if not np.linalg.cond(both) < 1 / EPS:
            break
        A, B = np.linalg.solve(both, W.T @ full.A @ V), np.linalg.solve(both, W.T @ full.B)
        model = Full(_mirrored(A), B, full.C @ V)
        value = full.error(model)[0]
        if value < least:
            best, least = model, value
        if abs(value - before) <= _SETTLED * full.squared_norm:
            break
        before = value
    return least, (best.A, best.B, best.C)


def _mirrored(A: Array) -> Array:
    """The matrix with its poles in the left half-plane, those in the right one mirrored at the axis."""
    poles, vectors = np.linalg.eig(A)
    least = _DECAY * np.abs(poles).max(initial=0.0)
    if (poles.real <= -least).all():
        return A
    poles = -np.maximum(np.abs(poles.real), least) + 1j * poles.imag
    return np.real(vectors * poles @ np.linalg.inv(vectors))


@dataclass(frozen=True)
class _Layout:
    """Port-Hamiltonian models of unit energy as a vector: `J`, `L`, `Y`, `G` and the rows of sensors."""

    r: int
    m: int
    sensors: int
    through: Array

    @cached_property
    def _root(self) -> Array:
        """`U sqrt(s)` with `S = U s U^T`, of the part of the feedthrough that takes in energy."""
        s, U = np.linalg.eigh(self.through)
        kept = s > _PART * max(s[-1], np.finfo(float).tiny)
        return np.asarray(U[:, kept] * np.sqrt(s[kept]), float)

    @property
    def _shapes(self) -> list[tuple[int, int]]:
        r, q = self.r, self._root.shape[1]
        return [(r, r), (r, r), (r, q), (r, self.m), (self.sensors, r)]

    def split(self, x: Array) -> list[Array]:
        ends = np.cumsum([a * b for a, b in self._shapes])[:-1]
        return [part.reshape(shape) for part, shape in zip(np.split(x, ends), self._shapes, strict=True)]

    def matrices(self, x: Array) -> tuple[Array, Array, Array]:
        """`A`, `B`, `C`."""
        J, L, Y, G, rows = self.split(x)
        P = Y @ self._root.T
        return 0.5 * (J - J.T) - L @ L.T - Y @ Y.T, G - P, np.vstack([(G + P).T, rows])

    def gradient(self, x: Array, by: Matrices) -> Array:
        """Gradient by the vector of that by the matrices."""
        _, L, Y, _, _ = self.split(x)
        by_A, by_B, by_C = by
        loss, ports = by_A + by_A.T, by_C[: self.m].T
        by_Y = -loss @ Y + (ports - by_B) @ self._root
        parts = [0.5 * (by_A - by_A.T), -loss @ L, by_Y, by_B + ports, by_C[self.m :]]
        return np.concatenate([part.ravel() for part in parts])

    def vector(self, parts: Parts) -> Array:
        """The vector of a system of unit energy."""
        U = self._root
        Y = parts["P"] @ U @ np.linalg.inv(U.T @ U) if U.shape[1] else np.zeros((self.r, 0))
        k, V = np.linalg.eigh(parts["R"] - Y @ Y.T)
        L = V * np.sqrt(np.maximum(k, 0.0))
        return np.concatenate([part.ravel() for part in (parts["J"], L, Y, parts["G"], parts["sensor_rows"])])

    def parts(self, x: Array, like: Parts) -> Parts:
        """The system of a vector."""
        J, L, Y, G, rows = self.split(x)
        return like | {
            "Q": np.eye(self.r), "J": 0.5 * (J - J.T), "R": L @ L.T + Y @ Y.T, "G": G.copy(), "P": Y @ self._root.T,
            "sensor_rows": rows.copy(),
        }  # fmt: skip


def best_passive(full: Full, start: Parts) -> tuple[Parts, float]:
    """Port-Hamiltonian system of least H2 error next to another, and the squared error less the squared norm."""
    full = in_modes(full)
    layout = _Layout(len(start["Q"]), start["G"].shape[1], len(start["sensor_rows"]), start["S"])
    x, size = layout.vector(start), full.squared_norm
    before = size + full.error(Full(*layout.matrices(x)))[0]

    def value(x: Array) -> tuple[float, Array]:
        model = Full(*layout.matrices(x))
        if not np.isfinite(model.A).all() or model.modes.poles.real.max() >= 0:
            return 1e3, np.zeros_like(x)
        f, by = full.error(model)
        return (size + f) / before, layout.gradient(x, by) / before

    options = {"maxiter": _STEPS, "maxfun": 2 * _STEPS, "ftol": _ENOUGH, "gtol": _ENOUGH, "maxcor": 30}
    solution = minimize(value, x, jac=True, method="L-BFGS-B", options=options)
    if not solution.fun < 1:
        return start, before - size
    return layout.parts(solution.x, start), before * float(solution.fun) - size

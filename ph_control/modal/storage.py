"""Storage functions of passive systems: solutions of the Kalman-Yakubovich-Popov inequality without touching `D`.

`x^T X x / 2`, `X > 0`, is a storage of `x' = A x + B u`, `y = C x + D u` if

    W(X) = [[-(A^T X + X A),  C^T - X B],
            [  C - B^T X   ,  D + D^T  ]] >= 0.

Where this matrix must be singular it fixes `X`: `W [x; u] = 0` says what `X` makes of `A x + B u`.  Without
feedthrough that is `X B = C^T`; what follows from it, again and again, is known as well.  The inequality with the same
`X` holds for the system in `1 / (s - j w)`, whose feedthrough is `G(j w)`: at a frequency where `G + G^H` is singular
it fixes more.  On what is left the inequality is a regular Riccati equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, block_diag, eigh, qr, solve_continuous_are, solve_continuous_lyapunov, svd
from scipy.optimize import brentq

from .._checks import EPS
from .._types import Array, ComplexArray
from ..exceptions import StructureError
from .positive_real import Matrices, Passivity, lowest_places, minimum

_NULLS = (1e-12, 1e-10, 1e-14, 1e-8, 1e-6)  # of its terms: an eigenvalue of a known block taken for 0, tried in turn
_NEW = 100.0  # times the root of that: what a direction has outside the known ones, to be a new one
_SINGULAR = 1e-12  # of its terms: an eigenvalue of `G + G^H` that is 0 at all frequencies
_NEAR = 1e-2  # of them: one that may touch 0 between points looked at
_TOUCHES = 1e-9  # of them: one that may be 0
_ROUNDING, _GOOD = 1e-14, 1e-12  # of the system: a correction of `W` that is rounding, and one that is good enough
_UNFED = 1e-13  # of `W`: a feedthrough of ports that is taken for none
_FLOOR = 8.0  # roundings of its norm: the least eigenvalue of what is left
_REFINED = 3  # steps of Newton's method


KINDS = ("available", "required", "mean")


@dataclass(frozen=True)
class Coordinates:
    """`z = T x` in which a storage is `|z|^2 / 2`, and what of `W` there had to be corrected, over the system."""

    T: Array
    inverse: Array
    correction: float


def storage_coordinates(A: Array, B: Array, C: Array, D: Array, kind: str) -> Coordinates:
    """Coordinates in which a storage of a stable, minimal and passive system is the unit matrix.

    Parameters
    ----------
    A, B, C, D : ndarray
        The system in coordinates that are scaled well, balanced ones, with `A` and the response of size 1.
    kind : {"available", "required", "mean"}
        The least storage, the largest, or the geometric mean of the two.

    Raises
    ------
    StructureError
        If none is found: the system is not passive, or rounding hides that it is.
    """
    system = A, B, C, D
    points = touching_frequencies(*system)
    best: Coordinates | None = None
    for null in _NULLS:
        try:
            found = _first_coordinates(system, points, kind, null)
            if found.correction > _ROUNDING:
                found = min(found, _again(system, points, kind, null, found), key=lambda one: one.correction)
        except (LinAlgError, ValueError):
            continue
        if best is None or found.correction < best.correction:
            best = found
        if best.correction <= _GOOD:
            break
    if best is None:
        raise StructureError(
            "no storage function was found although the system is passive at all frequencies: it is too "
            "ill-conditioned; give it in better scaled states, or with fewer"
        )
    return best


def _first_coordinates(system: Matrices, points: list[float], kind: str, null: float) -> Coordinates:
    """By the least storages of the system and of its dual, whose inverse is the largest storage.

    Balanced, the two are `diag(s)` and its inverse, `s <= 1`; their geometric mean is the unit matrix.
    """
    A, B, C, D = system
    R = _root(_least_storage(system, points, null))
    S = _root(_least_storage((A.T, C.T, B.T, D.T), points, null))
    left: Any
    right: Any
    U, s, V = svd(S @ R.T)
    root = np.sqrt(np.maximum(s, EPS * s[0]))[:, None]
    left, right = V @ R / root, U.T @ S / root
    if kind == "available":
        left, right = left * root, right / root
    if kind == "required":
        left, right = left / root, right * root
    return _judged(system, left, right.T)


def _again(system: Matrices, points: list[float], kind: str, null: float, before: Coordinates) -> Coordinates:
    """Once more in the coordinates found, in which the storage is the unit matrix but for rounding."""
    step = _first_coordinates(_transformed(system, before), points, kind, null)
    return _judged(system, step.T @ before.T, before.inverse @ step.inverse)


def _transformed(system: Matrices, found: Coordinates) -> Matrices:
    A, B, C, D = system
    return found.T @ A @ found.inverse, found.T @ B, C @ found.inverse, D


def _judged(system: Matrices, T: Array, inverse: Array) -> Coordinates:
    found = Coordinates(T, inverse, 0.0)
    moved = _transformed(system, found)
    W = dissipation(*moved)
    size = sum(float(np.linalg.norm(M)) for M in moved)
    correction = float(np.linalg.norm(semidefinite(W, len(T)) - W)) / size
    return Coordinates(T, inverse, correction if np.isfinite(correction) else np.inf)


def _root(X: Array) -> Array:
    """`R` with `X = R^T R`, of what is positive definite but for rounding."""
    k, U = eigh(X)
    return np.asarray(np.sqrt(np.maximum(k, EPS * k[-1]))[:, None] * U.T, float)


def dissipation(A: Array, B: Array, C: Array, D: Array) -> Array:
    """`W(I)`, symmetric."""
    coupling = C.T - B
    return np.block([[-(A + A.T), coupling], [coupling.T, D + D.T]])


def semidefinite(W: Array, states: int) -> Array:
    """The positive semidefinite matrix beside `W`: without coupling to ports that lose nothing themselves.

    Its other eigenvalues are at least a rounding above 0, so that it stays so in any scaling.
    """
    size = float(np.linalg.norm(W, 2)) if W.size else 0.0
    s, U = eigh(W[states:, states:])
    fed = s > _UNFED * size
    basis = block_diag(np.eye(states), U[:, fed])
    if not basis.shape[1]:
        return np.zeros_like(W)
    k, V = eigh(basis.T @ W @ basis)
    part = (V * np.maximum(k, _FLOOR * EPS * size)) @ V.T
    found = basis @ (0.5 * (part + part.T)) @ basis.T
    return np.asarray(0.5 * (found + found.T), float)


# --- where W must be singular -------------------------------------------------------------------------------------


def touching_frequencies(A: Array, B: Array, C: Array, D: Array) -> list[float]:
    """Frequencies, infinity and 0 among them, at which the rank of `G + G^H` may fall."""
    if not len(A):
        return [np.inf]
    tested = Passivity(A, B, C, D, scattering=False)
    grid = tested._grid()
    k = np.asarray(np.linalg.eigvalsh(tested.phi(grid)), float)
    size = tested.modes.magnitude(np.asarray(1j * grid, complex))
    rank = int(np.max(np.sum(k > _SINGULAR * size[:, None], axis=1), initial=0))
    if not rank:
        return [np.inf, 0.0]
    values = k[:, -rank]
    low = [i for i in lowest_places(values) if values[i] < _NEAR * size[i]]
    minima = [_stationary((A, B, C), tested, rank, *grid[i - 1 : i + 2]) for i in low]
    return [np.inf, 0.0, *(w for w, value, of in minima if value <= _TOUCHES * of)]


def _stationary(
    system: tuple[Array, Array, Array], tested: Passivity, rank: int, low: float, middle: float, high: float
) -> tuple[float, float, float]:
    """Minimum of the eigenvalue `rank` from above of `G + G^H`: its frequency, the value, and the size of its terms."""

    def value(w: float) -> float:
        return float(np.linalg.eigvalsh(tested.phi(np.array([w])))[0, -rank])

    A, B, C = system

    def slope(w: float) -> float:
        u = eigh(tested.phi(np.array([w]))[0])[1][:, -rank]
        M = 1j * w * np.eye(len(A)) - A
        x, y = np.linalg.solve(M, B @ u), np.linalg.solve(M.conj().T, C.T @ u)
        return 2 * float(np.real(-1j * (y.conj() @ x)))

    middle = min(minimum(value, low, high), middle, key=value)
    for reach in (1e-6, 1e-4, 1e-2):
        a, b = max(middle * (1 - reach), low), min(middle * (1 + reach), high)
        if slope(a) < 0 < slope(b):
            middle = float(brentq(slope, a, b, xtol=4 * EPS * b, rtol=4 * EPS))
            break
    return middle, value(middle), float(tested.modes.magnitude(np.array([1j * middle]))[0])


def _seen_from(system: Matrices, frequency: float) -> tuple[Any, Any, Any, Any]:
    """The system in `1 / (s - j frequency)`, with a state matrix of norm 1: the same storages."""
    A, B, C, D = (np.asarray(M, complex) for M in system)
    if np.isfinite(frequency):
        A = np.linalg.inv(A - 1j * frequency * np.eye(len(A)))
        B, C, D = -A @ B, C @ A, D - C @ A @ B
    rate = float(np.linalg.norm(A, 2)) or 1.0
    return A / rate, B / np.sqrt(rate), C / np.sqrt(rate), D


# --- what is known of X -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class KnownDirections:
    """Directions `V` (n, k), orthonormal, on which `X V = Y` is known."""

    V: Array
    Y: Array

    def with_directions(self, V: ComplexArray, Y: ComplexArray, new: float) -> KnownDirections:
        """These and others, of which what is known already is left out."""
        V, Y = np.hstack([V.real, V.imag]), np.hstack([Y.real, Y.imag])
        for _ in range(2):  # twice is enough
            overlap = self.V.T @ V
            V, Y = V - self.V @ overlap, Y - self.Y @ overlap
        U, s, W = svd(V, full_matrices=False)
        kept = s > new
        V, Y = U[:, kept], (Y @ W.T)[:, kept] / s[kept]
        # X is symmetric: along what was known before, the older directions say it with less rounding
        Y = Y + self.V @ (self.Y.T @ V - self.V.T @ Y)
        skew = V.T @ Y
        Y = Y - V @ (0.5 * (skew - skew.T))
        return KnownDirections(np.hstack([self.V, V]), np.hstack([self.Y, Y]))


def _block(known: KnownDirections, system: Any) -> tuple[Any, Any]:
    """`W` on the known directions and all inputs, and the sizes of what is summed in it."""
    A, B, C, D = system
    V, Y = known.V, known.Y
    YAV, coupling, through = Y.T @ A @ V, V.T @ C.conj().T - Y.T @ B, D + D.conj().T
    K = np.block([[-(YAV + YAV.conj().T), coupling], [coupling.conj().T, through]])
    sizes = np.concatenate([
        np.linalg.norm(Y, axis=0) * np.linalg.norm(A @ V, axis=0),
        np.full(D.shape[1], np.linalg.norm(D) + np.linalg.norm(C, 2) * np.linalg.norm(B, 2)),
    ])  # fmt: skip
    return K, sizes


def _null_space(K: Any, sizes: Array, null: float) -> tuple[Any, Any, Array]:
    """Vectors that `K >= 0` takes to 0, the others, and their eigenvalues."""
    k, W = eigh(K)
    zero = k <= null * (sizes @ np.abs(W) ** 2)
    return W[:, zero], W[:, ~zero], k[~zero]


def _all_known(system: Matrices, points: list[float], null: float) -> KnownDirections:
    """All directions that follow from `W >= 0`."""
    n = len(system[0])
    known = KnownDirections(np.zeros((n, 0)), np.zeros((n, 0)))
    views = [_seen_from(system, point) for point in points]
    before = -1
    while known.V.shape[1] > before:
        before = known.V.shape[1]
        for A, B, C, D in views:
            count = -1
            while known.V.shape[1] > count and known.V.shape[1] < n:
                count = known.V.shape[1]
                zero, _, _ = _null_space(*_block(known, (A, B, C, D)), null)
                x, u = known.V @ zero[:count], zero[count:]
                leads, value = A @ x + B @ u, C.conj().T @ u - A.conj().T @ (known.Y @ zero[:count])
                known = known.with_directions(leads, value, _NEW * np.sqrt(null) * 1e-1)
    return known


# --- the rest ------------------------------------------------------------------------------------------------------


def _rest(a: Array, b: Array, q: Array, e: Array, k: Array) -> Array:
    """Solution `Z` of the Riccati equation `W22 - W21 K^-1 W12 = 0`, the unknown block of `X`.

    In the coordinates `[V, rest]`, `W22 = -(Z a + a^T Z) - q` and `W21 = -(e + Z b)` on inputs of weights `k`.  Steps
    of Newton's method follow the solver, as long as the residual falls.
    """
    if not len(k):
        raise LinAlgError("no input weighs what is not known")

    def residual(Z: Array) -> Array:
        coupling, Za = e + Z @ b, Z @ a
        return np.asarray(-(Za + Za.T) - q - coupling / k @ coupling.T, float)

    Z = solve_continuous_are(a, b, q, -np.diag(k), s=e)
    Z = 0.5 * (Z + Z.T)
    left = residual(Z)
    for _ in range(_REFINED):
        closed = a + b / k @ (e + Z @ b).T
        try:
            step = solve_continuous_lyapunov(closed.T, left)
        except (LinAlgError, ValueError):
            break
        again = Z + 0.5 * (step + step.T)
        better = residual(again)
        if not np.linalg.norm(better) < 0.5 * np.linalg.norm(left):
            break
        Z, left = again, better
    return np.asarray(Z, float)


def _least_storage(system: Matrices, points: list[float], null: float) -> Array:
    known = _all_known(system, points, null)
    n, k = known.V.shape
    A, B, C, _ = system
    T = np.hstack([known.V, qr(known.V)[0][:, k:]]) if k else np.eye(n)
    X1, X2 = known.V.T @ known.Y, known.Y.T @ T[:, k:]
    Z = np.zeros((0, 0))
    if k < n:
        K, sizes = _block(known, system)
        _, basis, weight = _null_space(K, sizes, null)
        a, b, c = T.T @ A @ T, T.T @ B, C @ T
        a11, a12, a21, a22 = a[:k, :k], a[:k, k:], a[k:, :k], a[k:, k:]
        q = X2.T @ a12
        e = np.hstack([X2.T @ a11 + a12.T @ X1 + a22.T @ X2.T, X2.T @ b[:k] - c[:, k:].T])
        Z = _rest(a22, np.hstack([a21, b[k:]]) @ basis, q + q.T, e @ basis, weight)
    X = T @ np.block([[X1, X2], [X2.T, Z]]) @ T.T
    return 0.5 * (X + X.T)

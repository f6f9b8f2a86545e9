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

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import (
    LinAlgError,
    block_diag,
    eigh,
    qr,
    schur,
    solve_continuous_are,
    solve_continuous_lyapunov,
    solve_sylvester,
    svd,
)
from scipy.optimize import brentq

from .._checks import EPS
from .._types import Array, ComplexArray, Numbers
from ..exceptions import StructureError
from .positive_real import Matrices, Passivity, lowest_places, minimum

_NULLS = (1e-12, 1e-10, 1e-14, 1e-8, 1e-6)  # of its terms: an eigenvalue of a known block taken for 0, tried in turn
_NEW = 100.0  # times the root of that: what a direction has outside the known ones, to be a new one
_SINGULAR = 1e-12  # of its terms: an eigenvalue of `G + G^H` that is 0 at all frequencies
_NEAR = 1e-2  # of them: one that may touch 0 between points looked at
_TOUCHES = 1e-9  # of them: one that may be 0
_ROUNDING = 4.0  # roundings of the system, times the number of states: a correction of `W` that is none
_GOOD = 1e-12  # of the system: a correction that is good enough
_UNFED = 1e-13  # of `W`: a feedthrough of ports that is taken for none
_FLOOR = 8.0  # roundings of its norm: the least eigenvalue of what is left
_LARGE = 1e3  # times the norm of `a`: what a Hamiltonian matrix may lose by the weights it is divided by
_REFINED = 3  # steps of Newton's method


KINDS = ("available", "required", "mean")
AnyMatrices = tuple[Numbers, Numbers, Numbers, Numbers]


@dataclass(frozen=True)
class Coordinates:
    """`z = T x` in which a storage is `|z|^2 / 2`, and what of `W` there had to be corrected, over the system."""

    T: Array
    inverse: Array
    correction: float


def storage_coordinates(
    A: Array, B: Array, C: Array, D: Array, kind: str, singular: Array | None = None
) -> Coordinates:
    """Coordinates in which a storage of a stable, minimal and passive system is the unit matrix.

    Parameters
    ----------
    A, B, C, D : ndarray
        The system in coordinates that are scaled well, balanced ones, with `A` and the response of size 1.
    kind : {"available", "required", "mean"}
        The least storage, the largest, or the geometric mean of the two.
    singular : ndarray, optional
        Frequencies at which `G + G^H` is singular, where they are known.

    Raises
    ------
    StructureError
        If none is found: the system is not passive, or rounding hides that it is.
    """
    system = A, B, C, D
    points = touching_frequencies(*system, singular)
    best: Coordinates | None = None
    tried = set()
    for null in _NULLS:
        try:
            known = _known_parts(system, points, null)
            if known.counts in tried:
                continue
            tried.add(known.counts)
            coordinates = _coordinates(system, known, kind)
            if coordinates.correction > _ROUNDING * len(A) * EPS:
                again = _again(system, points, kind, null, coordinates)
                coordinates = min(coordinates, again, key=lambda candidate: candidate.correction)
        except (LinAlgError, ValueError):
            continue
        if best is None or coordinates.correction < best.correction:
            best = coordinates
        if best.correction <= _GOOD:
            break
    if best is None:
        raise StructureError(
            "no storage function was found although the system is passive at all frequencies: it is too "
            "ill-conditioned; give it in better scaled states, or with fewer"
        )
    return best


def _coordinates(system: Matrices, known: KnownParts, kind: str) -> Coordinates:
    """By the least storage and the largest, which agree on the known directions.

    With `X V = Y` known and `Y^T N = 0`, all storages are `diag(V^T Y, Z)` in the basis `[V, N]`.  Balanced, the least
    and the largest `Z` are `diag(s)` and its inverse, `s <= 1`; their geometric mean is the unit matrix.
    """
    V, Y = known.directions.V, known.directions.Y
    n, k = V.shape
    basis = np.hstack([V, qr(Y)[0][:, k:]]) if k else np.eye(n)
    inverse = np.asarray(np.linalg.inv(basis), float)
    fixed = _root(V.T @ Y)
    R, S = (_root(X) for X in _extremes(system, known, basis, inverse))
    U, s, W = svd(S @ R.T)
    root = np.sqrt(np.maximum(s, EPS * s.max(initial=0.0)))[:, None]
    to_balanced, from_balanced = W @ R / root, U.T @ S / root
    if kind == "available":
        to_balanced, from_balanced = to_balanced * root, from_balanced / root
    if kind == "required":
        to_balanced, from_balanced = to_balanced / root, from_balanced * root
    T = np.vstack([fixed @ inverse[:k], to_balanced @ inverse[k:]])
    return _judged(system, T, np.hstack([basis[:, :k] @ np.linalg.inv(fixed), basis[:, k:] @ from_balanced.T]))


def _again(system: Matrices, points: list[float], kind: str, null: float, before: Coordinates) -> Coordinates:
    """Once more in the coordinates found, in which the storage is the unit matrix but for rounding."""
    moved = _transformed(system, before)
    step = _coordinates(moved, _known_parts(moved, points, null), kind)
    return _judged(system, step.T @ before.T, before.inverse @ step.inverse)


def _transformed(system: Matrices, coordinates: Coordinates) -> Matrices:
    A, B, C, D = system
    return coordinates.T @ A @ coordinates.inverse, coordinates.T @ B, C @ coordinates.inverse, D


def _judged(system: Matrices, T: Array, inverse: Array) -> Coordinates:
    coordinates = Coordinates(T, inverse, 0.0)
    moved = _transformed(system, coordinates)
    W = dissipation(*moved)
    size = sum(float(np.linalg.norm(M)) for M in moved)
    correction = float(np.linalg.norm(semidefinite(W, len(T)) - W)) / size
    return Coordinates(T, inverse, correction if np.isfinite(correction) else np.inf)


def _root(X: Array) -> Array:
    """`R` with `X = R^T R`, of what is positive definite but for rounding."""
    k, U = eigh(X)
    return np.asarray(np.sqrt(np.maximum(k, EPS * k.max(initial=0.0)))[:, None] * U.T, float)


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
    positive = basis @ (0.5 * (part + part.T)) @ basis.T
    return np.asarray(0.5 * (positive + positive.T), float)


# --- where W must be singular -------------------------------------------------------------------------------------


def touching_frequencies(A: Array, B: Array, C: Array, D: Array, singular: Array | None = None) -> list[float]:
    """Frequencies, infinity and 0 among them, at which the rank of `G + G^H` may fall."""
    if not len(A):
        return [np.inf]
    tested = Passivity((A, B, C, D), scattering=False)
    if singular is not None:
        tested.singular = singular
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


def _seen_from(system: Matrices, frequency: float) -> AnyMatrices[Any]:
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


def _block(known: KnownDirections, system: AnyMatrices[Numbers]) -> tuple[Numbers, Array]:
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


def _null_space(K: Numbers, sizes: Array, null: float) -> tuple[Numbers, Numbers, Array]:
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


@dataclass(frozen=True)
class KnownParts:
    """Directions on which all storages agree, and the combinations of them and of inputs that cost energy.

    `weighed` (k + m, r) are these combinations, `weights` the eigenvalues of the known block of `W` there.
    """

    directions: KnownDirections
    weighed: Array
    weights: Array

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of directions and of weights, by which two choices are told apart."""
        return self.directions.V.shape[1], len(self.weights)


def _known_parts(system: Matrices, points: list[float], null: float) -> KnownParts:
    known = _all_known(system, points, null)
    _, weighed, weights = _null_space(*_block(known, system), null)
    return KnownParts(known, weighed, weights)


# --- the rest ------------------------------------------------------------------------------------------------------


def _extremes(system: Matrices, known: KnownParts, basis: Array, inverse: Array) -> tuple[Array, Array]:
    """Least `Z`, and the inverse of the largest: the unknown block of the storages `diag(V^T Y, Z)`.

    With the known block of `W` as weight of inputs `b`, scaled to 1, `Z` and its inverse solve

        a^T Z + Z a + (e + Z b) (e + Z b)^T = 0,    a Z^-1 + Z^-1 a^T + (b + Z^-1 e) (b + Z^-1 e)^T = 0.
    """
    A, B, C, _ = system
    V, Y = known.directions.V, known.directions.Y
    n, k = V.shape
    if k == n:
        return np.zeros((0, 0)), np.zeros((0, 0))
    if not len(known.weights):
        raise LinAlgError("no input weighs what is not known")
    N, rows = basis[:, k:], inverse[k:]
    root = np.sqrt(known.weights)
    a, b = rows @ A @ N, rows @ np.hstack([A @ V, B]) @ known.weighed / root
    e = N.T @ np.hstack([A.T @ Y, -C.T]) @ known.weighed / root
    # a unit of energy in which both are of one size
    unit = float(np.linalg.norm(e) / np.linalg.norm(b)) if e.any() and b.any() else 1.0
    b, e = b * np.sqrt(unit), e / np.sqrt(unit)
    least = inverse_largest = None
    if np.linalg.norm(b) * np.linalg.norm(e) < _LARGE * np.linalg.norm(a):
        with suppress(LinAlgError):  # eigenvalues on the axis by rounding
            least, inverse_largest = _extreme_solutions(a, b, e)
    if least is None or inverse_largest is None:
        # of pencils, in which no weight is a divisor
        least = solve_continuous_are(a, b * root, np.zeros_like(a), -np.diag(root**2), s=e * root)
        inverse_largest = solve_continuous_are(a.T, e * root, np.zeros_like(a), -np.diag(root**2), s=b * root)
    return unit * _refined(a, b, e, least), _refined(a.T, e, b, inverse_largest) / unit


def _extreme_solutions(a: Array, b: Array, e: Array) -> tuple[Array, Array]:
    """Least solution of the Riccati equation of `Z` and inverse of the largest one.

    One Schur form of the Hamiltonian matrix has both: its stable subspace is that of the least one, and what a
    Sylvester equation parts from it, the antistable one, that of the largest.
    """
    n, closed = len(a), a + b @ e.T
    T, U, stable = schur(np.block([[closed, b @ b.T], [-e @ e.T, -closed.T]]), output="real", sort="lhp")
    if stable != n:
        raise LinAlgError("an eigenvalue lies on the axis")
    antistable = U[:, :n] @ solve_sylvester(T[:n, :n], -T[n:, n:], -T[:n, n:]) + U[:, n:]
    least = np.linalg.solve(U[:n, :n].T, U[n:, :n].T)
    inverse_largest = np.linalg.solve(antistable[n:].T, antistable[:n].T)
    return 0.5 * (least + least.T), 0.5 * (inverse_largest + inverse_largest.T)


def _refined(a: Array, b: Array, e: Array, Z: Array) -> Array:
    """Solution of the Riccati equation, by steps of Newton's method until its residual is rounding."""
    for _ in range(_REFINED):
        coupling, Za = e + Z @ b, Z @ a
        residual = Za + Za.T + coupling @ coupling.T
        size = np.linalg.norm(residual)
        if not size > 0.5 * np.sqrt(len(a)) * EPS * np.linalg.norm(Za):
            break
        step = solve_continuous_lyapunov((a + b @ coupling.T).T, -residual)
        again = Z + 0.5 * (step + step.T)
        coupling, Za = e + again @ b, again @ a
        if not np.linalg.norm(Za + Za.T + coupling @ coupling.T) < 0.5 * size:
            break
        Z = again
    return Z

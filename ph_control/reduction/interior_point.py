"""The passive model closest to another of the same poles: least squares over the cone of positive-real functions.

    G(s) = C (s - A)^-1 B + D,    A and B as they are,    (theta - theta_0)^T W^-1 (theta - theta_0) least,

`theta` the entries of `C` and `D`.  `G` is passive if and only if there are `X` and `S >= 0` with

    S = [[-(A^T X + X A),  C^T - X B],
         [  C - B^T X   ,  D + D^T  ]],

so that passive models are a linear image of the positive semidefinite matrices: `A^T X + X A` gives `X`, and `X` and
the other blocks give `C` and `D`.  Ports that feed nothing through have no row in `S`.  The multipliers `(Y, U)` of
`C` and `D` are those with

    Z = [[P, Y^T], [Y, U]] >= 0,    A P + P A^T + B Y + Y^T B^T = 0,

and `theta = theta_0 + W (Y, U)`, `Z S = 0` at the closest model.  A primal-dual interior-point method solves this with
the scaling of Nesterov and Todd.  It ends inside the cone, so that rounding does not make the model active; light
damping, where the cone is so thin that half-spaces about it do not help, only scales it.

A scattering matrix is passive if `[[1, G], [G^H, 1]]` is positive semidefinite: the immittance
`[[1/2, G], [0, 1/2]]` is passive, in which nothing but `G` moves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky, qr, schur, solve_triangular, svd
from scipy.linalg.lapack import dtrsyl

from .._types import Array, ComplexArray, Indices, Mask
from ..exceptions import StructureError
from ..modal.general_form import GeneralModalForm, from_matrices
from ..modal.positive_real import Passivity
from ..systems.passive_form import gramian_root

_LEAST = 1e-8  # of the squared distance: by which it may exceed the least one; what is left is room for rounding
_MOST = 1e-2  # the same where rounding leaves no better model passive
_FREE = 1e-10  # of the largest: variance of what may move
_ITERATIONS = 100  # of the interior-point method; 10 to 20 are usual
_SHORT = 0.98  # of the way to the boundary: a step
_FAR = 1e12  # of the size of the model: beyond, there is no passive one
_LITTLE = 1e-4  # of `C`: what is left of it, below which it is not taken from a difference
_SINGULAR = 1e-12  # of the size of the model: an eigenvalue of a feedthrough that is 0
_LARGE = 2_000_000  # entries of the images of all multipliers: beyond, products are summed by modes if they can be
_RIDGE = 1e-14  # of each: what rounding of a sum of products may take of it
_WELL_PARTED = 1e4  # condition of modes up to which products are summed by modes
_CENTRINGS = 6  # steps at most to the middle of the cone
_CLOSER = 0.5  # of the residual before: what is left after such a step
_REFINED = 1  # steps of iterative refinement
_REACHED = 1e-10  # of its size: part of a state that inputs reach

Direction = Callable[[Array], tuple[Array, Array, Array]]


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
    def _modes(self) -> GeneralModalForm:
        n, m = self.B.shape
        return from_matrices(self.A, self.B, np.eye(n), np.zeros((n, m)))

    def states(self, omega: Array) -> ComplexArray:
        """Response of the states, shape (K, n, m)."""
        return np.moveaxis(self._modes.evaluate(1j * omega), 2, 0)

    def is_passive(self, C: Array, D: Array) -> bool:
        """Whether a model is passive by the exact test."""
        return not Passivity((self.A, self.B, C, D), scattering=self.scattering).bands()


def closest_passive(family: FixedPoles, C: Array, D: Array, covariance: Array | None = None) -> Closest:
    """The passive model closest to `(C, D)` in the metric of a covariance, which may be singular, or of the H2 norm.

    Entries of `D` without variance are fixed, all of them in the H2 norm, and then `D` must be passive by itself.

    Raises
    ------
    StructureError
        If what may move does not reach a passive model.
    """
    if not len(family.A) or family.is_passive(C, D):
        return Closest(C, D, 0.0, np.zeros(C.size + D.size))
    program = _Program.of(family, C, D, covariance)
    for force, rows in program.models():
        moved = program.moved(force)
        through = D + moved[C.size :].reshape(D.shape)
        closest = Closest(C + moved[: C.size].reshape(C.shape), through, float(force @ moved), force)
        if np.linalg.norm(closest.C) < _LITTLE * np.linalg.norm(C) and rows is not None:
            closest = replace(closest, C=rows)
        if family.is_passive(closest.C, closest.D):
            return closest
    raise StructureError(
        "no passive model was found by moving residues alone: let the feedthrough move too (weight=(omega, weights)), "
        "or give the system in better scaled states"
    )


# --- the cone -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Cone:
    """Passive immittances of a stable pair `(A, B)`, as images of positive semidefinite matrices `S`.

    Columns of `fed` are the directions of ports with a feedthrough that takes in energy, `unfed` those without, in
    which `D + D^T` is 0 for all models.  Multipliers are `Y`, row by row, and coordinates of symmetric matrices `U`.
    """

    A: Array
    B: Array
    fed: Array
    unfed: Array

    @property
    def size(self) -> int:
        """Rows of `S` and `Z`."""
        return len(self.A) + self.fed.shape[1]

    @property
    def coupled(self) -> int:
        """Number of the last multipliers, of ports that are fed with the others."""
        return self.fed.shape[1] * self.unfed.shape[1]

    @cached_property
    def through(self) -> Array:
        """Basis (K, m, m) of the symmetric `U`: of ports that are fed, then of these with the others."""
        q = self.fed.shape[1]
        i, j = np.tril_indices(q)
        first = np.hstack([self.fed[:, i], np.repeat(self.fed, self.unfed.shape[1], axis=1)])
        second = np.hstack([self.fed[:, j], np.tile(self.unfed, q)])
        return 0.5 * (np.einsum("ak,bk->kab", first, second) + np.einsum("ak,bk->kab", second, first))

    @cached_property
    def _schur(self) -> tuple[Array, Array]:
        T, V = schur(self.A, output="real")
        return np.asfortranarray(T), V

    def _lyapunov(self, M: Array, side: str) -> Array:
        """`P` with `A P + P A^T + M = 0`, or with the transposes of `A` exchanged."""
        T, V = self._schur
        other = {"N": "T", "T": "N"}[side]
        X, scale, _ = dtrsyl(T, T, np.asfortranarray(-V.T @ M @ V), trana=side, tranb=other)
        P = V @ (X / scale) @ V.T
        return np.asarray(0.5 * (P + P.T), float)

    def matrix(self, y: Array) -> Array:
        """`Z` of multipliers."""
        n, m = self.B.shape
        q = self.fed.shape[1]
        Y = y[: m * n].reshape(m, n)
        P = self._lyapunov(self.B @ Y + (self.B @ Y).T, "N")
        U = np.zeros((q, q))
        U[np.tril_indices(q)] = 0.5 * y[m * n : m * n + q * (q + 1) // 2]
        return np.block([[P, Y.T @ self.fed], [self.fed.T @ Y, U + U.T]])

    def model(self, S: Array) -> Array:
        """`C`, row by row, and the products of `D` with the basis of `U`: adjoint of the above."""
        n, q = len(self.A), self.fed.shape[1]
        X = self._lyapunov(S[:n, :n], "T")
        C = 2 * (self.B.T @ X + self.fed @ S[n:, :n])
        rest = np.zeros(self.coupled)
        return np.concatenate([C.ravel(), S[n:, n:][np.tril_indices(q)], rest])

    @cached_property
    def _modes(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Poles, modes and their inverse."""
        poles, V = np.linalg.eig(self.A)
        return poles.astype(complex), V.astype(complex), np.linalg.inv(V).astype(complex)

    @cached_property
    def _images(self) -> Array:
        """`Z` of unit multipliers."""
        count = self.B.size + len(self.through)
        return np.array([self.matrix(row) for row in np.eye(count)])

    @cached_property
    def is_large(self) -> bool:
        """Whether products are summed by modes: there are many, and modes are well parted."""
        return self.B.size * self.size**2 > _LARGE and bool(np.linalg.cond(self._modes[1]) <= _WELL_PARTED)

    def rows(self, R: Array) -> Array:
        """Columns of the entries of `R^T Z R` for unit multipliers, of the same inner products."""
        moved = R.T @ self._images @ R
        return np.asarray((moved[:, self.upper[0], self.upper[1]] * self.weights).T)

    @cached_property
    def upper(self) -> tuple[Indices, Indices]:
        """Places of the upper triangle of `Z`."""
        return np.triu_indices(self.size)

    @cached_property
    def weights(self) -> Array:
        """Weights of these places, of which those off the diagonal stand for two."""
        return np.where(self.upper[0] == self.upper[1], 1.0, np.sqrt(2.0))

    def symmetric(self, entries: Array) -> Array:
        """The matrix of weighted entries of the upper triangle."""
        M = np.zeros((self.size, self.size))
        M[self.upper] = entries / self.weights
        return np.asarray(M + np.triu(M, 1).T)

    def gram_by_modes(self, R: Array) -> Array:
        """Inner products of `R^T Z R` for unit multipliers.

        By matrices of rank two: `Z` is the sum of all `y w e^H` and its adjoint, `e` a mode or a port.
        """
        poles, V, W = self._modes
        (n, m), q = self.B.shape, self.fed.shape[1]
        by_mode, by_port = R[:n].T @ V, R[n:].T
        kernel = -1.0 / (poles[:, None] + poles.conj())
        first = [by_mode @ ((W @ self.B[:, [a]]) * kernel) + (by_port @ self.fed[a])[:, None] for a in range(m)]
        i, j = np.tril_indices(q)
        w = np.hstack([*first, by_port[:, i] * 0.5])
        e = np.hstack([np.tile(by_mode, m), by_port[:, j]])
        ew = e.conj().T @ w
        near, far = (w.conj().T @ w) * (e.conj().T @ e).T, ew * ew.T

        def turned(M: ComplexArray, W: ComplexArray) -> ComplexArray:
            """Columns of modes to columns of states."""
            modes = np.ascontiguousarray(M[:, : m * n]).reshape(-1, n) @ W
            return np.hstack([modes.reshape(len(M), m * n), M[:, m * n :]])

        both = turned(near, W.conj()) + turned(far, W.conj()).conj()
        products = 2 * np.real(turned(both.T, W).T)
        full = np.zeros((self.B.size + len(self.through),) * 2)
        full[: len(products), : len(products)] = products
        return full

    def inside(self) -> Array:
        """Multipliers in the interior: the Gramian is the unit matrix."""
        q = self.fed.shape[1]
        U = (1 + np.linalg.norm(self.B) ** 2) * np.eye(q)[np.tril_indices(q)]
        return np.concatenate([0.5 * self.B.T.ravel(), U, np.zeros(len(self.through) - len(U))])


# --- the program --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Program:
    """Least `y^T W y / 2 + centre^T y` over the multipliers of a cone; `forces` are those of multipliers on a model.

    `back` takes states to those of the cone.
    """

    cone: _Cone
    forces: Array
    metric: _Metric
    centre: Array
    back: Array

    @classmethod
    def of(cls, family: FixedPoles, C: Array, D: Array, covariance: Array | None) -> _Program:
        """The program of a model; a scattering matrix is a part of an immittance."""
        m = len(D)
        T, back = _unit_gramian(family.A, family.B)
        rate = float(np.linalg.norm(family.A))
        A, B, T1 = back @ family.A @ T / rate, back @ family.B / np.sqrt(rate), T / np.sqrt(rate)
        through = D
        held = np.ones(m, bool) if covariance is None else np.diag(covariance)[C.size :: m + 1] <= 0
        if family.scattering:
            through = np.block([[0.5 * np.eye(m), D], [np.zeros((m, m)), 0.5 * np.eye(m)]])
            B, held = np.hstack([np.zeros_like(B), B]), np.full(2 * m, held.all())
        cone = _Cone(A, B, *_fed(through, held))
        k, U = B.size, cone.through
        forces = np.zeros((C.size + D.size, k + len(U)))
        forces[: C.size, : m * len(A)] = np.kron(np.eye(m), T1)
        forces[C.size :, k:] = (U[:, :m, m:] if family.scattering else U).reshape(len(U), m * m).T
        rows = np.zeros(k)
        rows[: m * len(A)] = (C @ T1).ravel()
        centre = np.concatenate([rows, np.einsum("kab,ab->k", U, through)])
        return cls(cone, forces, _Metric(back, C.shape, covariance), centre, back * np.sqrt(rate))

    def moved(self, forces: Array) -> Array:
        """What forces move."""
        return self.metric.moved(forces)

    def models(self) -> Iterator[tuple[Array, Array | None]]:
        """Forces of models inside the cone next to the closest one, the closest first, and `C` where all of it moves.

        Where little is left of `C`, the difference to what is moved would have no digits.
        """
        W = np.asarray(self.forces.T @ self.moved(self.forces), float)
        # a coupling of ports that are fed with others, where neither moves, is 0
        idle = (np.arange(len(W)) >= len(W) - self.cone.coupled) & (np.diag(W) == 0)
        W[idle, idle] = np.diag(W).max()
        centre = np.where(idle, 0.0, self.centre)
        size, reach = float(np.linalg.norm(centre)), float(np.linalg.norm(W, 2))
        if not (size > 0 and reach > 0):
            return
        scaled = _InteriorPoint(self.cone, W / reach, centre / size)
        for point in scaled.points()[::-1]:
            y, S = scaled.corrected(scaled.centred(point))
            yield size / reach * (self.forces @ y), self._rows(size * self.cone.model(S))

    def _rows(self, model: Array) -> Array | None:
        """`C` of a model of the cone, in the H2 norm."""
        if self.metric.covariance is not None or len(self.cone.B.T) > self.metric.shape[0]:
            return None
        rows = model[: self.cone.B.size].reshape(self.cone.B.T.shape)
        return np.asarray(rows @ self.back, float)


@dataclass(frozen=True)
class _Metric:
    """Covariance of the entries of `C` and `D`, that of the H2 norm by the states of unit Gramian."""

    back: Array
    shape: tuple[int, ...]
    covariance: Array | None

    def moved(self, forces: Array) -> Array:
        """The covariance times forces, (K,) or (K, L)."""
        if self.covariance is not None:
            return np.asarray(self.covariance @ forces, float)
        m, n = self.shape
        rows = forces[: m * n].reshape(m, n, -1)
        moved = np.zeros_like(forces)
        moved[: m * n] = (self.back.T @ (self.back @ rows)).reshape(m * n, *forces.shape[1:])
        return moved


def _fed(through: Array, held: Mask) -> tuple[Array, Array]:
    """Directions of ports in which a feedthrough takes in energy or may move, and the others."""
    ports = np.eye(len(through))
    values, U = np.linalg.eigh((through + through.T)[np.ix_(held, held)])
    fed = values > _SINGULAR * max(float(np.linalg.norm(through, 2)), np.finfo(float).tiny)
    basis = ports[:, held] @ U
    return np.hstack([ports[:, ~held], basis[:, fed]]), basis[:, ~fed]


def _unit_gramian(A: Array, B: Array) -> tuple[Array, Array]:
    """`T`, `back` with `back T = 1`: states `x = T z` that inputs reach, of the unit matrix as Gramian."""
    root = gramian_root(A.T, B.T).T
    size = np.linalg.norm(root, axis=1)
    size = np.where(size > 0, size, 1.0)[:, None]
    U, s, _ = svd(root / size, full_matrices=False)
    kept = s > _REACHED * s[0]
    return size * U[:, kept] * s[kept], U[:, kept].T / s[kept][:, None] / size.T


@dataclass(frozen=True)
class _Point:
    """Multipliers `y`, the matrix `S` of a model, and that of the multipliers `Z`, which rounding keeps positive."""

    y: Array
    S: Array
    Z: Array


@dataclass(frozen=True)
class _InteriorPoint:
    """Primal-dual interior-point method for least `y^T W y / 2 + centre^T y`, `W` and `centre` of size 1."""

    cone: _Cone
    W: Array
    centre: Array

    @cached_property
    def _variances(self) -> tuple[Array, Array]:
        values, U = np.linalg.eigh(self.W)
        return np.maximum(values, 0.0), U

    @cached_property
    def _root(self) -> Array:
        values, U = self._variances
        return np.asarray(np.sqrt(values)[:, None] * U.T)

    @cached_property
    def _inverse(self) -> Array:
        """Inverse of `W` in directions that may move."""
        values, U = self._variances
        free = values > _FREE
        return np.asarray(U[:, free] / values[free] @ U[:, free].T)

    def _short(self, y: Array, S: Array) -> Array:
        return self.cone.model(S) - self.W @ y - self.centre

    def points(self) -> list[_Point]:
        """Points on the way to the least value, from where it is nearly reached."""
        y = self.cone.inside()
        y /= float(np.linalg.norm(y))
        point, points = _Point(y, np.eye(self.cone.size), self.cone.matrix(y)), list[_Point]()
        for _ in range(_ITERATIONS):
            moved, gap = float(point.y @ self.W @ point.y), float(np.sum(point.S * point.Z))
            if gap <= _MOST * moved:
                points.append(point)
            if gap <= _LEAST * moved or not moved < _FAR:
                break
            try:
                point = self._stepped(point)
            except LinAlgError:
                break
        return points

    def centred(self, point: _Point) -> _Point:
        """A point of the same gap with `W y + centre = model(S)`, in the middle of the cone."""
        before = np.inf
        for _ in range(_CENTRINGS):
            size = float(np.linalg.norm(self._short(point.y, point.S)))
            if not size < _CLOSER * before:
                break
            before = size
            try:
                point = self._stepped(point, centring=True)
            except LinAlgError:
                break
        return point

    def corrected(self, point: _Point) -> tuple[Array, Array]:
        """Multipliers whose model is that of `S`, as far as it may move, with the feedthrough that does not."""
        n, q, k = len(self.cone.A), self.cone.fed.shape[1], self.cone.B.size
        y, S = point.y, point.S
        for _ in range(2):
            y = y + self._inverse @ self._short(y, S)
            through = np.zeros((q, q))
            through[np.tril_indices(q)] = (self.W @ y + self.centre)[k : k + q * (q + 1) // 2]
            through = through + np.tril(through, -1).T
            # a congruence keeps S positive semidefinite
            root = cholesky(S[n:, n:], lower=True)
            ratio = cholesky(through, lower=True) @ solve_triangular(root, np.eye(q), lower=True)
            S = np.block([[S[:n, :n], S[:n, n:] @ ratio.T], [ratio @ S[n:, :n], through]])
        return y, S

    def _stepped(self, point: _Point, *, centring: bool = False) -> _Point:
        """The next point: a predictor and corrector of Mehrotra in the scaling of Nesterov and Todd, or centring.

        `R^-1 S R^-T` and `R^T Z R` are one diagonal matrix.
        """
        cone, short = self.cone, self._short(point.y, point.S)
        root, other = cholesky(point.S, lower=True), cholesky(point.Z, lower=True)
        U, scaled, V = svd(other.T @ root)
        R, back = root @ V.T / np.sqrt(scaled), other @ U / np.sqrt(scaled)
        direction = self._by_modes(R, short) if cone.is_large else self._by_images(R, short)

        def reach(step: Array) -> float:
            """Part of a step to the boundary."""
            least = float(np.linalg.eigvalsh(step / np.sqrt(np.outer(scaled, scaled)))[0])
            return np.inf if least >= 0 else -1 / least

        target, second = 1.0, np.zeros_like(R)
        if not centring:
            _, dS, dZ = direction(-np.diag(scaled))
            target, second = (1 - min(1.0, reach(dS), reach(dZ))) ** 3, dS @ dZ + dZ @ dS
        gap = target * float(np.mean(scaled**2)) * np.eye(len(R))
        dy, dS, dZ = direction((2 * gap - second) / (scaled[:, None] + scaled) - np.diag(scaled))
        length = min(1.0, _SHORT * min(reach(dS), reach(dZ)))
        S, Z = point.S + length * (R @ dS @ R.T), point.Z + length * (back @ dZ @ back.T)
        return _Point(point.y + length * dy, 0.5 * (S + S.T), 0.5 * (Z + Z.T))

    def _by_images(self, R: Array, short: Array) -> Direction:
        """Steps of `y` and of the scaled `S` and `Z`, whose sum is given, by least squares."""
        cone, n = self.cone, len(self.cone.upper[0])
        Q, T = qr(np.vstack([cone.rows(R), self._root]), mode="economic")
        # what may not move takes another part than what may, of which the products would have half the digits
        moving = self._root @ (self._inverse @ short)
        fixed = solve_triangular(T, short - self.W @ (self._inverse @ short), trans="T")

        def direction(wanted: Array) -> tuple[Array, Array, Array]:
            along = Q.T @ np.concatenate([wanted[cone.upper] * cone.weights, moving]) + fixed
            dZ = cone.symmetric(Q[:n] @ along)
            return solve_triangular(T, along), wanted - dZ, dZ

        return direction

    def _by_modes(self, R: Array, short: Array) -> Direction:
        """The same by the normal equations."""
        cone = self.cone
        H = self.W + cone.gram_by_modes(R)
        factor = cho_factor(H + np.diag(_RIDGE * np.diag(H)))

        def direction(wanted: Array) -> tuple[Array, Array, Array]:
            right = short + cone.model(R @ wanted @ R.T)
            dy = cho_solve(factor, right)
            for _ in range(_REFINED):
                dZ = R.T @ cone.matrix(dy) @ R
                dy = dy + cho_solve(factor, right - self.W @ dy - cone.model(R @ dZ @ R.T))
            dZ = R.T @ cone.matrix(dy) @ R
            return dy, wanted - dZ, dZ

        return direction

"""Eigenpairs `K phi = d2 M phi` of large sparse matrices by shift and invert, counted by Sylvester's law of inertia."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.blas import dtrsm
from scipy.sparse import csc_array, sparray
from scipy.sparse.linalg import ArpackError, LinearOperator, SuperLU, cg, eigsh, splu

from .. import _checks
from .._checks import EPS
from .._types import Array, Mask
from ..exceptions import ConditioningWarning, StructureError

Eigensolver = Callable[[csc_array, csc_array, int, float], tuple[Array, Array]]

_BELOW = 1e-10  # of the scale of K: the shift below zero that makes rigid modes regular
_GAP = 1e-6  # relative distance at which neighbouring eigenvalues are told apart by a factorisation
_NOISE = 1e-3  # part of the shift below zero in which rigid modes are scattered by rounding
_SOFT = 1e3  # times that shift: rigid modes, and others that are searched for first
_STEPS = 3  # inverse iterations that show whether there are any
_INVERSIONS = 9  # of many rigid modes together, at most
_FALL = 0.1  # of the energy, by an inversion that is worth another
_DEPENDENT = 0.1  # least part of unit motions across the others that keeps the digits of orthogonality
_BODY = 8  # modes searched for then: the six of a free body, and two
_ROUNDS = 6  # searches for modes that the count finds missing
_SMALL = 0.1  # size of the relative error of a factorisation that cannot change a count, with a margin of ten
_SHAPE = 16  # roundings of the entries of a shape of unit modal mass
_AT_ONCE = 32  # shapes that are multiplied by a matrix together
_PROBES = 4  # random vectors that estimate it
RESIDUAL = 1e-9  # of the forces of the springs one by one, allowed


class Count(NamedTuple):
    """Number of eigenvalues below a shift, and whether the factorisation is exact enough for it."""

    below: int
    certain: bool


class Eigenpairs(NamedTuple):
    """Eigenvalues in ascending order with eigenvectors of unit modal mass."""

    squares: Array
    shapes: Array


class Pencil:
    """Symmetric stiffness and mass, sparse, with shift-invert operations; one factorisation is held at a time."""

    def __init__(self, K: sparray, M: sparray, eigensolver: Eigensolver | None = None) -> None:
        self.K, self.M, self.eigensolver = K.tocsc(), M.tocsc(), eigensolver
        mass, stiffness = M.diagonal(), np.abs(K.diagonal())
        moving = mass > 0
        self.finite = int(moving.sum())  # eigenvalues; rows without mass have infinite ones
        with np.errstate(over="ignore"):
            self.scale = float((stiffness[moving] / mass[moving]).max(initial=0.0)) or 1.0
        _checks.representable("the squared frequencies of K and M", np.array([self.scale]))
        self.low = -_BELOW * self.scale
        self.kernel: Eigenpairs | None = None  # motions without stiffness, where they are many
        self._factor: tuple[float, SuperLU] | None = None

    def factor(self, shift: float) -> SuperLU:
        """LU of `K - shift M` with pivots on the diagonal: `P^T L D L^T P`."""
        if self._factor is None or self._factor[0] != shift:
            self._factor = None
            self._factor = (shift, _factored(self.K - shift * self.M, shift))
        return self._factor[1]

    def release(self) -> None:
        """Free the memory of the factorisation."""
        self._factor = None

    def count(self, shift: float) -> Count:
        """Eigenvalues below the shift."""
        negative, certain = self._negative(shift)
        return Count(int(negative.sum()), certain)

    def _negative(self, shift: float) -> tuple[Mask, bool]:
        """Rows of negative pivots, as many as eigenvalues below the shift (Sylvester), and whether that is certain."""
        A = self.K - shift * self.M
        try:
            lu = self.factor(shift)
        except StructureError:  # singular to the last digit: count a little further, and say so
            return self._negative(shift + _GAP * (abs(shift) - self.low))[0], False
        certain = bool(np.array_equal(lu.perm_r, lu.perm_c)) and _factor_error(A, lu) < _SMALL
        pivots = lu.U.diagonal()[lu.perm_r]  # makes copies of both factors, which go with them
        self.release()
        return pivots < 0, certain and bool(pivots.all())

    def nearest(self, k: int, shift: float) -> Eigenpairs:
        """Eigenpairs nearest to the shift."""
        if self.eigensolver is not None:
            return self._of_eigensolver(k, shift)
        if _vectors(k) >= self.finite:  # they would fill a square matrix
            return self._dense(k, shift)
        soft = self._soft(k) if shift == self.low else None
        if soft is None or len(soft.squares) >= k:
            return soft or self._lanczos(k, shift, None)
        return self.more(soft, k - len(soft.squares), shift)

    def more(self, known: Eigenpairs, k: int, shift: float) -> Eigenpairs:
        """Search for further eigenpairs in the complement of those found; all together."""
        total = len(known.squares) + k
        if self.eigensolver is not None or _vectors(k) >= self.finite - len(known.squares):
            return self.nearest(min(total, self.finite), shift)
        new = self._lanczos(k, shift, known)
        if self.kernel is not None and len(known.squares) == len(self.kernel.squares):
            # exact to rounding, as what was found in its complement is orthogonal to it
            return Eigenpairs(np.concatenate([known.squares, new.squares]), np.hstack([known.shapes, new.shapes]))
        return _ritz(self, np.hstack([known.shapes, new.shapes]))

    def residuals(self, eigenpairs: Eigenpairs) -> Array:
        """`||K phi - d2 M phi||` in units of `|| |K| |phi| ||`, what the springs would exert one by one.

        Where hardly any spring is strained, as by a loose mass, the rounding of the shape itself is the unit.
        """
        size = abs(self.K)
        mass = self.M.diagonal()
        rounded = np.where(mass > 0, _SHAPE * EPS / RESIDUAL / np.sqrt(np.where(mass > 0, mass, 1.0)), 0.0)
        floor = size @ rounded
        errors, sizes = [], []
        for start in range(0, len(eigenpairs.squares), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            shapes = eigenpairs.shapes[:, part]
            errors.append(np.linalg.norm(self.K @ shapes - (self.M @ shapes) * eigenpairs.squares[part], axis=0))
            sizes.append(np.linalg.norm(size @ np.abs(shapes) + floor[:, None], axis=0))
        none = np.zeros(0)
        return np.asarray(np.concatenate([none, *errors]) / np.maximum(np.concatenate([none, *sizes]), _checks.TINY))

    def residual_flexibility(self, F: Array, shapes: Array) -> tuple[Array, Array]:
        """Static deflection under forces without the part of the modes given, and the forces that remain.

        `K x = (I - M Phi Phi^T) F` with `Phi^T M x = 0`, by conjugate gradients that the factorisation of the shift
        below zero preconditions: its eigenvalues are `d2 / (d2 - shift)`, nearly 1.  `Phi` has all rigid modes.
        """
        momenta = self.M @ shapes
        forces = F - momenta @ (shapes.T @ F)
        forces -= momenta @ (shapes.T @ forces)
        inverse = self._inverse(self.low, shapes)
        deflections = np.empty_like(forces)
        for port in range(F.shape[1]):
            f = forces[:, port]
            start = inverse.matvec(f)
            with np.errstate(all="ignore"):  # nothing is left to divide by where the start is exact
                x, _ = cg(self.K, f, x0=start, rtol=1e-14, atol=0.0, maxiter=20, M=inverse)
            x = x if np.isfinite(x).all() else start
            deflections[:, port] = x - shapes @ (momenta.T @ x)
        return deflections, forces

    def _inverse(self, shift: float, shapes: Array | None) -> LinearOperator:
        """`(K - shift M)^-1`, in the complement of some modes."""
        lu = self.factor(shift)
        if shapes is None:
            return LinearOperator(self.K.shape, matvec=lu.solve, dtype=float)
        momenta = self.M @ shapes

        def solve(f: Array) -> Array:
            x = lu.solve(f)
            return np.asarray(x - shapes @ (momenta.T @ x))

        return LinearOperator(self.K.shape, matvec=solve, dtype=float)

    def _soft(self, k: int) -> Eigenpairs | None:
        """Rigid modes, and others as soft; None where there is none.

        Their large inverses would drown those of the others in rounding, which are searched for in the complement.
        """
        lu, soft = self.factor(self.low), -_SOFT * self.low
        x = np.random.default_rng(1).standard_normal(self.K.shape[0])
        for _ in range(_STEPS):
            x = lu.solve(self.M @ x)
            x /= np.linalg.norm(x)
        if x @ (self.K @ x) > soft * (x @ (self.M @ x)):
            return None
        number = _BODY
        while True:
            eigenpairs = self._lanczos(number, self.low, None)
            within = eigenpairs.squares < soft
            if not within.all() or number >= max(k, _BODY + 1):
                return Eigenpairs(eigenpairs.squares[within], eigenpairs.shapes[:, within]) if within.any() else None
            if number == _BODY and (kernel := self._large_kernel(k)) is not None:
                return kernel
            number = min(2 * number, max(k, _BODY + 1))

    def _large_kernel(self, k: int) -> Eigenpairs | None:
        """All motions without stiffness, more than those of a free body; None where they are not set apart.

        A factorisation counts them, and a unit force at each row of a negative pivot moves them, all independently.
        Inverse iteration from these forces leaves nothing else, where Lanczos vectors would show one after the other
        by rounding alone.
        """
        negative, certain = self._negative(-self.low)
        number = int(negative.sum())
        if not certain or number < _BODY:
            return None
        forces = np.zeros((self.K.shape[0], number), order="F")
        forces[negative, np.arange(number)] = 1.0
        lu, before = self.factor(self.low), np.inf
        mixed = np.random.default_rng(2).standard_normal((number, _PROBES))
        shapes = lu.solve(forces)
        for _ in range(_INVERSIONS):
            shapes /= np.abs(shapes).max(axis=0)
            energy = float(np.abs(_rayleigh(self, shapes @ mixed)).max())
            if energy <= EPS**2 * self.scale or energy > _FALL * before:
                break
            before, shapes = energy, lu.solve(self.M @ shapes)
        try:
            shapes, least = _orthonormal(self, shapes)
            if least < _DEPENDENT:  # what they had beside has grown
                shapes, _ = _orthonormal(self, lu.solve(self.M @ shapes))
        except np.linalg.LinAlgError:
            return None
        squares = np.einsum("ij,ij->j", shapes, self.K @ shapes)
        if not np.abs(squares).max() <= _NOISE * -self.low:
            return None
        order = np.argsort(squares)
        self.kernel = Eigenpairs(squares[order], np.asfortranarray(shapes[:, order]))
        return self.kernel

    def _lanczos(self, k: int, shift: float, beside: Eigenpairs | None) -> Eigenpairs:
        start = np.random.default_rng(0 if beside is None else len(beside.squares)).standard_normal(self.K.shape[0])
        inverse = self._inverse(shift, None if beside is None else beside.shapes)
        start = inverse.matvec(self.M @ start)  # nothing without mass, nothing found before
        try:
            squares, shapes_found = eigsh(self.K, k, M=self.M, sigma=shift, OPinv=inverse, v0=start, ncv=_vectors(k))
        except ArpackError as error:
            raise StructureError(
                f"the Lanczos iteration for {k} modes near {shift:.3g} has failed ({error}); check that K and M are "
                "positive semidefinite, ask for fewer modes or a narrower band, or give another eigensolver"
            ) from error
        return _normalised(self, squares, shapes_found)

    def _dense(self, k: int, shift: float) -> Eigenpairs:
        K, M = self.K.toarray(), self.M.toarray()
        try:
            squares, shapes = eigh(K, M)
        except np.linalg.LinAlgError:  # rows without mass
            try:
                inverses, shapes = eigh(M, K - self.low * M)
            except np.linalg.LinAlgError:
                raise self.indefinite() from None
            with np.errstate(divide="ignore"):
                squares = np.where(inverses > 0, self.low + 1 / inverses, np.inf)
        chosen = np.sort(np.argsort(np.abs(squares - shift))[: min(k, self.finite)])
        return _normalised(self, squares[chosen], shapes[:, chosen])

    def _of_eigensolver(self, k: int, shift: float) -> Eigenpairs:
        assert self.eigensolver is not None
        n, given = self.K.shape[0], self.eigensolver(self.K, self.M, k, shift)
        if not isinstance(given, tuple | list) or len(given) != 2:
            raise StructureError(
                f"the eigensolver returned {_checks.shown(given)}; it must return (d2, phi), the squares of natural "
                f"frequencies, shape (k,), and the shapes, ({n}, k)"
            )
        squares = _checks.real_array("the d2 of the eigensolver", given[0], 1)
        shapes = _checks.real_array("the phi of the eigensolver", given[1], 2)
        if shapes.shape != (n, len(squares)) or len(squares) < k:
            raise StructureError(
                f"the eigensolver returned d2 of shape {squares.shape} and phi {shapes.shape} where {k} modes were "
                f"asked for; they must be (k,) and ({n}, k), with k of at least {k}"
            )
        return _ritz(self, shapes)

    def indefinite(self) -> StructureError:
        """Error that says so."""
        return StructureError(
            f"K or M is indefinite: K - s M is, at s = {self.low:.3g}, while it must be positive definite below zero; "
            "a stored energy cannot be negative, so check the signs in K and M"
        )


class Selection(NamedTuple):
    """Modes that were asked for, those beside them that were found too, and what remains under static forces."""

    eigenpairs: Eigenpairs
    wanted: Mask
    counted: Count  # in the range that was asked for
    deflections: Array
    forces: Array
    below: float  # all eigenvalues up to this one are among those found, if the count is met; 0 for none


def lowest_modes(pencil: Pencil, number: int, F: Array | None) -> Selection:
    """The lowest modes, and those that cannot be told from the last."""
    shift = pencil.low
    eigenpairs = pencil.nearest(min(number + 1, pencil.finite), shift)
    if pencil.kernel is not None and len(pencil.kernel.squares) > number:
        warnings.warn(
            f"K has {len(pencil.kernel.squares)} motions without stiffness, more than the {number} modes that were "
            "asked for and the six of a free body: loose parts, mechanisms or missing supports; all are kept, and no "
            f"others: ask for modes={len(pencil.kernel.squares) + number} to have {number} elastic ones beside them",
            ConditioningWarning,
            stacklevel=5,
        )
    for _ in range(_ROUNDS):
        while (last := _end(eigenpairs.squares, number, pencil)) is None:
            several = 1 if eigenpairs is pencil.kernel else 4 + len(eigenpairs.squares) // 4
            eigenpairs = pencil.more(eigenpairs, min(several, pencil.finite - len(eigenpairs.squares)), shift)
        static = _static(pencil, F, eigenpairs.shapes[:, :last])
        wanted = np.arange(len(eigenpairs.squares)) < last
        if last == pencil.finite:
            return Selection(eigenpairs, wanted, Count(last, True), *static, np.inf)
        pencil.release()
        kept, (low, high) = last, eigenpairs.squares[last - 1 : last + 1]
        for part in (0.5, 0.35, 0.65):
            edge = low + part * (high - low)
            counted = pencil.count(edge)
            if counted.certain:
                break
        if counted.below <= last or not counted.certain:
            return Selection(eigenpairs, wanted, counted, *static, edge)
        _refuse_negative(pencil, eigenpairs)
        eigenpairs = pencil.more(eigenpairs, counted.below - last, shift)
    raise _missing(pencil, counted.below, kept)


def modes_between(pencil: Pencil, low: float, high: float, F: Array | None) -> Selection:
    """Modes of `low <= d2 <= high`, and with forces the rigid ones."""
    above, below = pencil.count(high), pencil.count(low) if low > 0 else Count(0, True)
    number = above.below - below.below
    counted = Count(number, above.certain and below.certain)
    shift = pencil.low if low <= 0 else 0.5 * (low + high)
    n = pencil.K.shape[0]
    eigenpairs = pencil.nearest(number, shift) if number > 0 else Eigenpairs(np.zeros(0), np.zeros((n, 0)))
    inside = _inside(eigenpairs, low, high)
    for _ in range(_ROUNDS):
        missing = number - int(inside.sum())
        if missing <= 0 or not counted.certain:
            break
        _refuse_negative(pencil, eigenpairs)
        eigenpairs = pencil.more(eigenpairs, missing, shift)
        inside = _inside(eigenpairs, low, high)
    else:
        raise _missing(pencil, number, int(inside.sum()))
    eigenpairs = Eigenpairs(eigenpairs.squares[inside], eigenpairs.shapes[:, inside])
    if F is not None and low > 0:
        rigid = pencil.count(-pencil.low).below
        if rigid:
            soft = pencil.nearest(rigid, pencil.low)
            new = soft.squares < low
            eigenpairs = Eigenpairs(
                np.concatenate([soft.squares[new], eigenpairs.squares]),
                np.hstack([soft.shapes[:, new], eigenpairs.shapes]),
            )
    static = _static(pencil, F, eigenpairs.shapes)
    pencil.release()
    return Selection(eigenpairs, np.ones(len(eigenpairs.squares), bool), counted, *static, high if low <= 0 else 0.0)


def _vectors(k: int) -> int:
    """Number of Lanczos vectors for so many modes."""
    return max(2 * k + 1, 20)


def _inside(eigenpairs: Eigenpairs, low: float, high: float) -> Mask:
    return (eigenpairs.squares <= high) & ((eigenpairs.squares >= low) | (low <= 0))


def _end(squares: Array, number: int, pencil: Pencil) -> int | None:
    """Number of modes up to the first gap at or behind the last one wanted; None where none was found."""
    apart = np.diff(squares) > _GAP * np.abs(squares[1:]) - _NOISE * pencil.low
    ends = number + np.flatnonzero(apart[number - 1 :])
    if len(ends):
        return int(ends[0])
    return len(squares) if len(squares) >= pencil.finite else None


def _static(pencil: Pencil, F: Array | None, shapes: Array) -> tuple[Array, Array]:
    if F is None:
        none = np.zeros((shapes.shape[0], 0))
        return none, none
    return pencil.residual_flexibility(F, shapes)


def _factored(A: csc_array, shift: float) -> SuperLU:
    try:
        return splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:
        raise StructureError(
            f"K - s M is singular at s = {shift:.6g}: {error}; degrees of freedom that have neither mass nor stiffness "
            "are to be left out, and a band is not to end at a natural frequency"
        ) from None


def _factor_error(A: csc_array, lu: SuperLU) -> float:
    """Frobenius norm of `E A^{-1}`, estimated, where `A - E` is what was factored, scaled to unit diagonal.

    Below 1, no eigenvalue of `A - t E` passes zero for t from 0 to 1: the factors have the inertia of `A`.  Of a
    normally distributed `b`, the mean square of `b - A x`, `x` the solution by the factors, is the square of that norm.
    """
    diagonal = np.abs(A.diagonal())
    scale = np.sqrt(np.where(diagonal > 0, diagonal, abs(A).max() or 1.0))
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(_PROBES):
        b = scale * rng.standard_normal(len(scale))
        worst = max(worst, float(np.linalg.norm((b - A @ lu.solve(b)) / scale)))
    return worst if np.isfinite(worst) else np.inf


def _normalised(pencil: Pencil, squares: Array, shapes: Array) -> Eigenpairs:
    """Eigenpairs in ascending order, scaled to unit modal mass, each eigenvalue by its Rayleigh quotient."""
    order = np.argsort(squares)
    shapes = np.asfortranarray(shapes[:, order])
    squares = np.empty(len(order))
    for start in range(0, len(order), _AT_ONCE):
        part = shapes[:, start : start + _AT_ONCE]
        masses = np.einsum("ij,ij->j", part, pencil.M @ part)
        if not (masses > 0).all():
            raise StructureError(
                f"M is indefinite, or a mode has no mass: one found has the modal mass {masses.min():.3g}, expected > "
                "0; check the signs in M, and whether all that can move has mass"
            )
        part /= np.sqrt(masses)
        squares[start : start + _AT_ONCE] = np.einsum("ij,ij->j", part, pencil.K @ part)
    return Eigenpairs(squares, shapes)


def _ritz(pencil: Pencil, shapes: Array) -> Eigenpairs:
    """Eigenpairs of the pencil in a subspace."""
    momenta = pencil.M @ shapes
    lengths = np.sqrt(np.abs(np.einsum("ij,ij->j", shapes, momenta)))
    lengths = np.where(lengths > 0, lengths, 1.0)
    units = lengths * lengths[:, None]
    mass, stiffness = shapes.T @ momenta / units, shapes.T @ (pencil.K @ shapes) / units
    try:
        squares, turn = eigh(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T))
    except np.linalg.LinAlgError:
        raise StructureError(
            "the shapes found depend on one another, or M is indefinite: their modal masses are no positive definite "
            "matrix; check the signs in M, or the eigensolver"
        ) from None
    return _normalised(pencil, squares, shapes @ (turn / lengths[:, None]))


def _rayleigh(pencil: Pencil, shapes: Array) -> Array:
    """Energy of motions per modal mass."""
    masses = np.einsum("ij,ij->j", shapes, pencil.M @ shapes)
    return np.asarray(np.einsum("ij,ij->j", shapes, pencil.K @ shapes) / np.where(masses, masses, _checks.TINY))


def _orthonormal(pencil: Pencil, shapes: Array) -> tuple[Array, float]:
    """Motions of unit modal mass, orthogonal in the mass, and the least part of one that those before it lack.

    Raises `LinAlgError` where a motion has no mass, or depends on those before it.
    """
    masses = shapes.T @ (pencil.M @ shapes)
    lengths = np.sqrt(np.maximum(np.diag(masses), _checks.TINY))
    root = np.linalg.cholesky(masses / lengths / lengths[:, None])
    return dtrsm(1.0, root * lengths[:, None], shapes, side=1, lower=1, trans_a=1), float(root.diagonal().min())


def _refuse_negative(pencil: Pencil, eigenpairs: Eigenpairs) -> None:
    """Refuse a K or M that is indefinite: then the modes that are missing lie far below zero."""
    if pencil.count(pencil.low).below > int((eigenpairs.squares < pencil.low).sum()):
        raise pencil.indefinite()


def _missing(pencil: Pencil, counted: int, count: int) -> StructureError:
    by = "the Lanczos iteration" if pencil.eigensolver is None else "the eigensolver"
    return StructureError(
        f"{counted} modes lie in the range that was asked for, by the inertia of a factorisation, and {by} found "
        f"{count} of them; ask for another number or band, or give another eigensolver"
    )

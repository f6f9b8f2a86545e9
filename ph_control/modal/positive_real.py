"""Where a transfer function takes in energy and where it gives energy: the exact bands, without a grid of frequencies.

`G` is passive as an immittance if it is stable and `Phi(w) = G(jw) + G(jw)^H >= 0` at all frequencies, as a scattering
matrix if `Phi(w) = I - G(jw)^H G(jw) >= 0`.  The smallest eigenvalue of `Phi` changes its sign only where `Phi` is
singular: at eigenvalues of a pencil of the state-space matrices that lie on the imaginary axis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import control as ct
import numpy as np
from scipy.linalg import block_diag, eigvals, rsf2csf, schur, solve_sylvester
from scipy.linalg.lapack import dtrsen
from scipy.optimize import brentq, minimize_scalar

from .._checks import EPS
from .._types import Array, ArrayLike, ComplexArray, Indices
from ..exceptions import StructureError
from ..numerics.invariant_subspaces import (
    EliminationResolvent,
    SchurResolvent,
    clusters,
    eigenvalues_of,
    equilibrated,
    invariant_block,
)
from .general_form import from_matrices

Matrices = tuple[Array, Array, Array, Array]
ResponseError = Callable[[ComplexArray], Array]

_SLACK = 64 * EPS  # of the sum of magnitudes of all terms: what rounding leaves of a value 0
_GIVEN = 64  # roundings of each matrix that is given
_NEAR = 1e-3  # of that sum: a smallest eigenvalue below may turn negative between the points looked at
_LOOKS = 5  # points spread over a piece, beside the most negative ones
_SOLVER = 8  # backward errors of a Schur form
_FAR = 1e6  # times the largest pole: of a picture, nothing is beyond
_DECADES = (8.0, 4.0)  # of poles, on which one shift serves: of several ports in `s`, of one in its square
_OVERLAP = 3.0  # times its ends, what a shift serves as well
_BESIDE = np.array([1.0, 1.3, 0.77, 1.7, 0.59, 2.2, 0.45])  # of the middle of them: points to choose the shift from
_REGULAR = 1e-8  # least over largest singular value of `Phi` at a shift, below which there is no inverse
_DIGITS = 1e4  # roundings of the terms that the least one must exceed there
_PIECES = 8  # of the way between two of these: for the worst frequency of a band, which has several minima
_FINE = 1e-7  # of it: to what the least value is sought
_LEVELS = 20  # steps down to it, at most; three are usual
_HALVINGS = 60  # of intervals of a band that may have less, and
_INTERVALS = 4000  # of these at a time, at most
_FOURFOLD = 20  # factors beyond the poles, up to where the way to infinity is looked at
_AXIS = 256  # times the rounding of an eigenvalue: a real part that is taken for 0
_DOUBLE = 8.0  # times the root of that: how far the two of a double pole may lie from it
_CLEAR = 16  # times that: a real part that needs no second look
_HIDDEN = 256  # times the number of states, roundings of `|B| |C|`: a residue that is none
_RESIDUE = 1e-8  # of its size: what a residue on the axis may miss of a Hermitian positive semidefinite matrix
_WIDTHS = (0.25, 1.0, 4.0)  # of a resonance, beside it: points looked at


@dataclass(frozen=True)
class Band:
    """Frequencies `low` to `high` at which `Phi` is indefinite, and the worst of them.

    `excess` is the size of the violation at `worst`: minus the smallest eigenvalue of `(G + G^H) / 2`, of a scattering
    matrix the largest singular value less 1.
    """

    low: float
    high: float
    worst: float
    excess: float


@contextmanager
def well_conditioned(task: str) -> Iterator[None]:
    """Refuse a system whose eigenvalue problems have no answer, and say what it was needed for."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (np.linalg.LinAlgError, ArithmeticError):
        raise StructureError(
            f"the system is too ill-conditioned to {task}: its eigenvalue problems have no answer; give it in better "
            "scaled states, or in other units"
        ) from None


class Passivity:
    """The smallest eigenvalue of `Phi` of a stable system, and the bands in which it is negative."""

    def __init__(
        self, matrices: Matrices, *, scattering: bool, given: Matrices | None = None, error: ResponseError | None = None
    ) -> None:
        self.matrices, self.scattering = matrices, scattering
        # those that were given, with what was split off: their rounding decides
        self.given = matrices if given is None else given
        self.error = error  # of the response they were computed with, beyond that
        A, B, C, D = matrices
        self.modes = from_matrices(A, B, C, D.copy())

    def smallest(self, omega: ArrayLike) -> tuple[Array, Array]:
        """Smallest eigenvalue of `Phi` at each frequency, and what rounding leaves of it."""
        frequencies = np.atleast_1d(np.asarray(omega, float))
        size = self.modes.magnitude(1j * frequencies)
        slack = _SLACK * max(self.modes.feedthrough.shape) * (1 + size**2 if self.scattering else size)
        return self._smallest(frequencies), slack

    def _smallest(self, omega: Array) -> Array:
        return np.asarray(np.linalg.eigvalsh(self.phi(omega))[:, 0], float)

    def phi(self, omega: Array) -> ComplexArray:
        """`Phi` at frequencies (N,), shape (N, m, m)."""
        G = np.moveaxis(self.modes.evaluate(1j * omega), 2, 0)
        adjoint = G.conj().transpose(0, 2, 1)
        return np.asarray(np.eye(G.shape[2]) - adjoint @ G if self.scattering else G + adjoint, complex)

    def at_infinity(self) -> float:
        """Smallest eigenvalue of `Phi` at infinite frequency."""
        D = self.matrices[3]
        Phi = np.eye(D.shape[1]) - D.T @ D if self.scattering else D + D.T
        return float(np.linalg.eigvalsh(Phi)[0])

    def singular_frequencies(self, level: float = 0.0, low: float = 0.0, high: float = np.inf) -> Array:
        """Imaginary parts of all points of the plane at which `Phi` has the eigenvalue `level`; some beyond two bounds.

        Of two points that lie on the axis close together rounding may make a pair beside it, whose projection lies
        between the two.
        """
        if not len(self.modes.poles):
            return np.zeros(0)
        one_port = self.matrices[1].shape[1] == 1 and not self.scattering
        singular = self._one_port_points if one_port else self._points
        with np.errstate(all="ignore"):
            shifts = self._shifts(level, low, high)
            frequencies = np.concatenate([np.abs(singular(*shift, level).imag) for shift in shifts])
        return np.asarray(frequencies[np.isfinite(frequencies)], float)

    @cached_property
    def singular(self) -> Array:
        """Imaginary parts of the points at which `Phi` is singular."""
        return self.singular_frequencies()

    def _shifts(self, level: float, lowest: float, highest: float) -> list[tuple[float, bool]]:
        """Points of the real axis, each amid the poles of some decades, and whether `Phi` is far from singular there.

        The eigenvalues of an inverse are right beside the point that was taken from the matrix.
        """
        size = np.abs(self.modes.poles)
        size = size[size > 0] if size.any() else np.ones(1)
        one_port = self.matrices[1].shape[1] == 1 and not self.scattering
        low, high = float(np.log10(size.min())), float(np.log10(size.max()))
        ends = np.linspace(low, high, max(1, int(np.ceil((high - low) / _DECADES[one_port]))) + 1)
        middles = 10 ** (0.5 * (ends[1:] + ends[:-1]))
        # the first serves all that is slower, the last all that is faster
        ends = 10.0 ** np.concatenate([[-np.inf], ends[1:-1], [np.inf]])
        shifts = []
        for middle in middles[(ends[1:] * _OVERLAP >= lowest) & (ends[:-1] <= highest * _OVERLAP)]:
            points = middle * _BESIDE
            away = np.min(np.abs(points[:, None] - size) / (points[:, None] + size), axis=1)
            points = points[away > 0]
            away = away[away > 0]
            k = np.linalg.svd(self._on_real_axis(points) - level * np.eye(self.matrices[1].shape[1]), compute_uv=False)
            terms = sum(self.modes.magnitude(sign * points + 0j) for sign in (1.0, -1.0))
            regular = (k[:, -1] > _REGULAR * k[:, 0]) & (k[:, -1] > _DIGITS * EPS * terms)
            score = away * k[:, -1] / np.where(k[:, 0] > 0, terms if one_port else k[:, 0], 1.0)
            best = int(np.argmax(np.where(np.isfinite(score), score, -1.0)))
            shifts.append((float(points[best]), bool(regular[best])))
        return shifts

    def _on_real_axis(self, points: Array) -> Array:
        """Continuation of `Phi` to the real axis, shape (N, m, m)."""
        G, mirrored = (np.moveaxis(self.modes.evaluate(sign * points), 2, 0).real for sign in (1.0, -1.0))
        mirrored = mirrored.transpose(0, 2, 1)
        return np.asarray(np.eye(G.shape[2]) - mirrored @ G if self.scattering else G + mirrored, float)

    @cached_property
    def _modal(self) -> Matrices:
        """Real matrices of the modes."""
        modes = self.modes.state_space()
        return modes.A, modes.B, modes.C, modes.D

    def _one_port_points(self, shift: float, _: bool, level: float) -> ComplexArray:
        """Zeros of `Phi(s) = R + 2 C A (s^2 - A^2)^-1 B`: eigenvalues of order n in `s^2`."""
        A, B, C, D = self._modal
        inverse = np.linalg.inv(A @ A - shift**2 * np.eye(len(A)))
        column, row = inverse @ B, 2 * C @ A @ inverse
        value = 2 * D - level - 2 * C @ A @ column
        moved = inverse + column @ row / value
        if not np.isfinite(moved).all():
            return self._points(shift, False, level)
        squares = shift**2 + 1 / np.linalg.eigvals(moved)
        return np.asarray(np.sqrt(squares.astype(complex)), complex)

    def _points(self, shift: float, regular: bool, level: float) -> ComplexArray:
        """Eigenvalues of the pencil of `Phi`: by an inverse, or, where that has no digits, of both matrices."""
        A, B, C, D = self.matrices
        n, m = B.shape
        R = D + D.T - level * np.eye(m)
        if not self.scattering:
            A, B, C, R = balanced(A, B, C, R)
        none = np.zeros((n, n))
        square, sides, through = none, C, R
        if self.scattering:
            square, sides, through = -C.T @ C, -D.T @ C, (1 - level) * np.eye(m) - D.T @ D
        M = np.block([[none, A, B], [A.T, square, sides.T], [B.T, sides, through]])
        E = block_diag(np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(n)), np.zeros((m, m)))
        if regular:
            return np.asarray(shift + 1 / np.linalg.eigvals(np.linalg.solve(M - shift * E, E[:, : 2 * n])[: 2 * n]))
        alpha, beta = eigvals(M, E, homogeneous_eigvals=True)
        return np.asarray(alpha / beta, complex)

    def in_units(self, smallest: float) -> float:
        """Smallest eigenvalue of `(G + G^H) / 2`, or 1 less the largest singular value, from that of `Phi`."""
        return smallest / (1 + np.sqrt(1 - smallest)) if self.scattering else 0.5 * smallest

    def dense_grid(self, reach: float) -> Array:
        """Frequencies for a picture: spaced evenly in the logarithm, dense at resonances and at what is singular."""
        poles, singular = self.modes.poles, self.singular
        # beyond are zeros at infinity, and what rounding makes of them
        singular = singular[singular <= _FAR * np.abs(poles).max(initial=0.0)]
        marks = np.concatenate([np.abs(poles), singular, [0.0]])
        marks = marks[(marks > 0) & (marks > 1e-6 * marks.max())] if marks.any() else np.ones(1)
        even = np.geomspace(marks.min() / reach, marks.max() * reach, 2001)
        near = np.abs(poles.imag[:, None] + poles.real[:, None] * np.sinh(np.linspace(-6.0, 6.0, 121))).ravel()
        return np.unique(np.concatenate([even, near[(near > even[0]) & (near < even[-1])]]))

    def _grid(self) -> Array:
        """Frequencies that part the axis into pieces on which `Phi` keeps its sign, and some between them."""
        poles = self.modes.poles
        marks = [np.zeros(1), np.abs(poles.imag), np.abs(poles), self.singular]
        marks += [np.abs(poles.imag) + width * sign * poles.real for width in _WIDTHS for sign in (-1, 1)]
        points = np.unique(np.concatenate(marks))
        points = points[points >= 0]
        between = points[:-1, None] + np.diff(points)[:, None] * np.linspace(0.0, 1.0, _PIECES, endpoint=False)
        means = np.sqrt(points[1:] * points[:-1])
        return np.unique(np.concatenate([between.ravel(), means, points[-1:], [2 * points[-1] or 1.0]]))

    def bands(self) -> list[Band]:
        """Bands in which the smallest eigenvalue of `Phi` is negative by more than rounding, ascending."""
        grid, values, _ = self._looked_at
        return [self._band(grid, values, first, last) for first, last in self._pieces()]

    def is_passive(self) -> bool:
        """Whether there is no band."""
        omega = np.unique(np.abs([self.modes.poles, self.modes.poles.imag]))
        if len(omega):  # the place of a pole often tells, at a fraction of the cost
            values, slack = self.smallest(omega)
            k = int(np.argmin(values / slack))
            if values[k] < -slack[k] and self._is_negative(float(omega[k])):
                return False
        return not self._pieces()

    def _pieces(self) -> list[tuple[int, int]]:
        """First and last but one of the points of each piece of the axis on which `Phi` is negative beyond rounding."""
        grid, values, slack = self._looked_at
        negative = values < -slack
        edges = np.flatnonzero(np.diff(np.concatenate([[False], negative, [False]]).astype(int)))
        return [
            (first, last)
            for first, last in zip(edges[::2], edges[1::2], strict=True)
            if self._stands_out(grid[first:last], values[first:last], slack[first:last])
        ]

    def _stands_out(self, omega: Array, values: Array, slack: Array) -> bool:
        """Whether `Phi` is negative somewhere by more than rounding of the given matrices makes of it."""
        even = np.linspace(0, len(omega) - 1, _LOOKS).astype(int)
        likely = [np.argmin(values), np.argmin(values / slack)]
        return any(self._is_negative(float(omega[k])) for k in dict.fromkeys([*likely, *even]))

    def _is_negative(self, omega: float) -> bool:
        value, entries, whole = self._perturbed(omega, self._resolvent)
        if np.isfinite(whole) and abs(-value - entries) <= whole:  # the Schur form is not that of each entry
            value, entries, _ = self._perturbed(omega, EliminationResolvent(self.given[0]))
        return bool(-value > entries)

    @cached_property
    def _resolvent(self) -> SchurResolvent:
        return SchurResolvent(self.given[0])

    def _perturbed(self, omega: float, resolvent: SchurResolvent | EliminationResolvent) -> tuple[float, float, float]:
        """Smallest eigenvalue of `Phi`, what it changes by with errors of what is given, and with those of the solver.

        To first order the quadratic form of its eigenvector `u` changes by `2 Re y^H (dA x + dB u) + ..`, with
        `x = (jw - A)^-1 B u` and `y` that of the adjoint.
        """
        A, B, C, D = self.given
        s = np.array([1j * omega])
        X = resolvent.columns(s, B)[0]
        G = C @ X + D
        Phi = np.eye(len(G.T)) - G.conj().T @ G if self.scattering else G + G.conj().T
        if not np.isfinite(Phi).all():
            return 0.0, np.inf, np.inf  # a pole on the axis is judged by its residue
        k, U = np.linalg.eigh(Phi)
        u = U[:, 0]
        h = G @ u if self.scattering else u
        x, y = np.abs(X @ u), np.abs(resolvent.rows(s, (h.conj() @ C)[None]))[0, 0]
        beyond = 0.0 if self.error is None else 2 * float(self.error(s)[0] * np.linalg.norm(h))
        u, h = np.abs(u), np.abs(h)
        entries = float(y @ (np.abs(A) @ x + np.abs(B) @ u) + h @ (np.abs(C) @ x + np.abs(D) @ u))
        whole = 2 * _SOLVER * resolvent.rounding * float(np.linalg.norm(x) * np.linalg.norm(y))
        return float(k[0]), 2 * _GIVEN * EPS * entries + beyond, whole

    def margin(self) -> float:
        """Infimum over all frequencies of a system without bands, in units of `excess`; 0 where rounding hides it."""
        grid, values, slack = self._looked_at
        hidden = slack[np.argmin(values)]
        least = min(values.min(), self.at_infinity())
        if least > hidden:
            least = min(least, self._infimum(grid, values, 0.0, np.inf)[1])
        return 0.0 if least <= hidden else self.in_units(least)

    @cached_property
    def _looked_at(self) -> tuple[Array, Array, Array]:
        """Frequencies that show every change of sign, the smallest eigenvalue of `Phi` there, and its rounding."""
        grid = self._grid()
        values, slack = self.smallest(grid)
        # where it is small between three points, its minimum there
        low = [k for k in lowest_places(values) if values[k] < _NEAR / _SLACK * slack[k]]
        minima = np.array([minimum(self._value, grid[k - 1], grid[k + 1]) for k in low])
        there = self.smallest(minima)
        _, order = np.unique(np.concatenate([grid, minima]), return_index=True)
        parts = zip((grid, values, slack), (minima, *there), strict=True)
        grid, values, slack = (np.concatenate(part)[order] for part in parts)
        return grid, values, slack

    def _value(self, omega: float) -> float:
        return float(self._smallest(np.array([omega]))[0])

    def _band(self, grid: Array, values: Array, first: int, last: int) -> Band:
        # where it is 0 down to frequency 0, the signs of its rounding are no crossings
        hidden = (np.abs(values[:first]) <= self._looked_at[2][:first]).all()
        low = 0.0 if hidden else self._crossing(grid[first - 1], grid[first])
        high = self._crossing(grid[last - 1], grid[last]) if last < len(grid) else np.inf
        worst, least = self._infimum(grid[first:last], values[first:last], low, high)
        if high == np.inf and self.at_infinity() < least:
            worst, least = np.inf, self.at_infinity()
        return Band(float(low), float(high), worst, -self.in_units(least))

    def _infimum(self, grid: Array, values: Array, low: float, high: float) -> tuple[float, float]:
        """Frequency of the least value of the smallest eigenvalue of `Phi` between two others, and the value.

        From the best point downhill; then where else `Phi` takes that value, there may be less between.
        """
        if (settled := self._infimum_by_halving(grid, low, high)) is not None:
            return settled
        k = int(np.argmin(values))
        worst, least = float(grid[k]), float(values[k])
        for _ in range(_LEVELS):
            level = least - _FINE * abs(least)
            points = self.singular_frequencies(level, low, high)
            points = np.unique(np.concatenate([points[(points > low) & (points < high)], [low, worst], grid[-1:]]))
            middles = np.unique(np.append(0.5 * (points[1:] + points[:-1]), worst))
            k = int(np.argmin(self.smallest(middles)[0]))
            before = int(np.searchsorted(points, middles[k])) - 1
            after = int(np.searchsorted(points, middles[k], side="right"))
            best = minimum(self._value, points[max(before, 0)], points[min(after, len(points) - 1)])
            value = self._value(best)
            if not value < level:
                return (best, value) if value < least else (worst, least)
            worst, least = best, value
        return worst, least

    def _infimum_by_halving(self, grid: Array, low: float, high: float) -> tuple[float, float] | None:
        """The same without an eigenvalue problem; None where the modes leave it open.

        On the straight way between two values of `G` the smallest eigenvalue is concave, that is, least at an end
        (and the largest singular value convex).  From this way `G` is at most `h^2 |G''| / 8` off, in an interval `h`,
        and its modes bound `G''`.  Intervals that may have less than the least value found are halved.
        """
        if self.modes.clusters:
            return None
        end = high if high < np.inf else 2 * grid[-1]
        points = np.unique(np.concatenate([[low], grid[(grid > low) & (grid < end)], [end]]))
        at_points = self._smallest(points)
        k = int(np.argmin(at_points))
        worst, least = self._downhill(points[max(k - 1, 0)], points[min(k + 1, len(points) - 1)], points[k])
        if high == np.inf:
            beyond = points[-1] * 4.0 ** np.arange(_FOURFOLD)
            at_beyond = self._smallest(beyond)
            floor = min(least, at_beyond.min(), self.at_infinity())
            clear = np.flatnonzero(self._least_beyond(beyond, at_beyond) >= floor - _FINE * abs(floor))
            if not len(clear):
                return None
            added = slice(1, clear[0] + 1)
            points, at_points = np.append(points, beyond[added]), np.append(at_points, at_beyond[added])
            worst, least = min((worst, least), (float(points[-1]), float(at_points[-1])), key=lambda point: point[1])
        a, b, of_a, of_b = points[:-1], points[1:], at_points[:-1], at_points[1:]
        for _ in range(_HALVINGS):
            level = least - _FINE * abs(least)
            may_be_less = ~(self._least_between(a, b, np.minimum(of_a, of_b)) >= level)
            a, b, of_a, of_b = (part[may_be_less] for part in (a, b, of_a, of_b))
            if not len(a):
                return worst, least
            if len(a) > _INTERVALS:
                return None
            middle = 0.5 * (a + b)
            of_middle = self._smallest(middle)
            k = int(np.argmin(of_middle))
            if of_middle[k] < level:
                worst, least = self._downhill(a[k], b[k], middle[k])
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
            of_a, of_b = np.concatenate([of_a, of_middle]), np.concatenate([of_middle, of_b])
        return None

    def _least_between(self, a: Array, b: Array, at_ends: Array) -> Array:
        """Lower bound of the smallest eigenvalue of `Phi` in intervals, by the lesser of the values at their ends."""
        poles, sizes = self._fractions
        away = np.hypot(poles.real, poles.imag - np.clip(poles.imag, a[:, None], b[:, None]))
        return self._lowered(at_ends, 0.25 * (((b - a)[:, None] / away) ** 2 / away) @ sizes)

    def _least_beyond(self, omega: Array, value: Array) -> Array:
        """The same from frequencies to infinity, by straight ways in `1 / w`."""
        poles, sizes = self._fractions
        part = np.abs(poles) / omega[:, None]
        off = np.where(part < 1, 0.25 * part / (1 - part) ** 3, np.inf) / omega[:, None]
        return self._lowered(np.minimum(value, self.at_infinity()), off @ sizes)

    @cached_property
    def _fractions(self) -> tuple[ComplexArray, Array]:
        """Poles and norms of residues."""
        poles, c, b = self.modes._both_halves
        return poles, np.linalg.norm(c, axis=1) * np.linalg.norm(b, axis=1)

    def _lowered(self, smallest: Array, off: Array) -> Array:
        """Bound of the smallest eigenvalue of `Phi` where `G` is at most `off` from one that has a given one."""
        if self.scattering:
            return np.asarray(1 - (np.sqrt(np.maximum(1 - smallest, 0.0)) + off) ** 2, float)
        return np.asarray(smallest - 2 * off, float)

    def _downhill(self, low: float, high: float, start: float) -> tuple[float, float]:
        """A local minimum of the smallest eigenvalue of `Phi` between two frequencies, no greater than at a third."""
        minimizer = minimum(self._value, low, high)
        return min(((w, self._value(w)) for w in (float(start), minimizer)), key=lambda candidate: candidate[1])

    def _crossing(self, a: float, b: float) -> float:
        fa, fb = self._value(a), self._value(b)
        if fa == 0 or fb == 0 or (fa > 0) == (fb > 0):
            return a if abs(fa) <= abs(fb) else b
        return float(brentq(self._value, a, b, xtol=4 * EPS * max(b, np.finfo(float).tiny), rtol=4 * EPS, maxiter=500))


def lowest_places(values: Array) -> Indices:
    """Places of the values that neither neighbour is below."""
    return np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])) + 1


def minimum(f: Callable[[float], float], low: float, high: float) -> float:
    """Where a function is least between two numbers."""
    solution = minimize_scalar(f, bounds=(low, high), method="bounded", options={"xatol": 1e-9 * (high - low)})
    return float(solution.x)


def balanced(A: Array, B: Array, C: Array, D: Array) -> Matrices:
    """The same `Phi` up to a positive factor, with inputs and outputs of one size.

    `B` is scaled against `C`, which keeps `C (s - A)^-1 B`, and both so that the product is of the size of `A`.
    """
    size, b, c = (float(np.linalg.norm(M)) for M in (A, B, C))
    if not (size and b and c):
        return A, B, C, D
    root = np.sqrt(size)
    return A, B * (root / b), C * (root / c), D * (size / (b * c))


# --- poles on the axis and what ports do not see ------------------------------------------------------------


@dataclass(frozen=True)
class Split:
    """Frequencies and residues on the imaginary axis, matrices of the rest of the system, and the poles to the right.

    Residues are not finite where a pole is not simple.
    """

    axis: list[tuple[float, ComplexArray]]
    rest: tuple[Array, Array, Array]
    unstable: ComplexArray


def split_axis(A: Array, B: Array, C: Array) -> Split:
    """Poles on the imaginary axis, which are judged by their residues, and the rest; both without what is hidden.

    Poles that rounding may mix are judged together, by their mean: the two of a rigid body lie apart by the root of it.
    """
    if not len(A):
        return Split([], (A, B, C), np.zeros(0, complex))
    given = float(np.linalg.norm(B) * np.linalg.norm(C))
    A, B, C = equilibrated(A, B, C)
    # what is left out moves poles by rounding of all that was given
    size = float(np.linalg.norm(A, 2))
    rounding = _AXIS * len(A) * EPS * size
    unseen = _HIDDEN * len(A) * EPS * max(given, float(np.linalg.norm(B) * np.linalg.norm(C)))
    whole = len(A)
    A, B, C = staircase(A, B, C)
    n = len(A)
    if not n:
        return Split([], (A, B, C), np.zeros(0, complex))
    # of matrices as they were given, each entry is known to its own rounding
    noise = np.abs(A) * (_AXIS * EPS) if n == whole else np.full((n, n), rounding / n)
    T, Z = schur(A, output="real")
    U, Y = rsf2csf(T, Z)
    eigenvalues = eigenvalues_of(U)
    right_vectors, left_vectors = Y @ eigenvalues.right_vectors, Y @ eigenvalues.left_vectors
    # the bounds of first order are too large for double poles, which rounding moves by its root
    double = _DOUBLE * np.sqrt(rounding * size)
    values = np.sum(left_vectors.conj() * (A @ right_vectors), axis=0) / eigenvalues.overlap
    moved = np.abs(values - eigenvalues.values)
    values = np.where(moved <= np.minimum(rounding / eigenvalues.separation, double), values, eigenvalues.values)
    error = np.sum(np.abs(left_vectors) * (noise @ np.abs(right_vectors)), axis=0) / eigenvalues.separation
    radius = np.minimum(error, double)
    axis: list[tuple[float, ComplexArray]] = []
    off = np.ones(n, bool)
    for group in clusters(values, radius):
        real = values.real[group]
        if (np.abs(real) > _CLEAR * radius[group]).all() and len(np.unique(np.sign(real))) == 1:
            continue
        block = invariant_block(U, group)
        columns, rows = Y @ block.columns, block.rows @ Y.conj().T
        center = complex(np.trace(rows @ A @ columns)) / len(group)
        known = float(np.sum(np.abs(rows.T) * (noise @ np.abs(columns)))) / len(group)
        if abs(center.real) > known:
            continue
        off[group] = False
        if center.imag < -known:
            continue
        c, b = C @ columns, rows @ B
        K = _residue(block.T - center * np.eye(len(group)), b, c, float(np.linalg.norm(A)))
        if not np.linalg.norm(K) <= unseen:
            still = center.imag <= known
            axis.append((0.0, np.asarray(K.real, complex)) if still else (center.imag, K))
    unstable = values[off & (values.real > radius)]
    count = n - int(off.sum())
    if not count:
        return Split([], (A, B, C), unstable)
    T, Z, _, _, count, _, _, _ = dtrsen(~off, T, Z, lwork=max(n, 2 * count * (n - count)), liwork=n * n)
    B, C = Z.T @ B, C @ Z
    X = solve_sylvester(T[:count, :count], -T[count:, count:], -T[:count, count:])
    rest = T[count:, count:], B[count:], C[:, count:] + C[:, :count] @ X
    return Split(sorted(axis, key=lambda pole: pole[0]), rest, unstable)


def staircase(A: Array, B: Array, C: Array, coupled: float = 0.0) -> tuple[Array, Array, Array]:
    """Matrices of what inputs reach and outputs see, by couplings above `coupled` of the norm; 0 means rounding."""
    # its tolerance is that of inputs and outputs of the size of A
    size, b, c = (float(np.linalg.norm(M)) or 1.0 for M in (A, B, C))
    reduced = ct.ss(A, B * (size / b), C * (size / c), np.zeros((len(C), B.shape[1]))).minreal(coupled)
    if reduced.nstates == len(A):
        return A, B, C  # the staircase form has lost digits for nothing
    return reduced.A, reduced.B * (b / size), reduced.C * (c / size)


def _residue(beside: ComplexArray, b: ComplexArray, c: ComplexArray, size: float) -> ComplexArray:
    """Residue of a pole, `c b`; not finite if `c beside b / (s - p)^2` says that it is not simple."""
    again = np.linalg.norm(c @ beside @ b)
    simple = again <= _RESIDUE * size * np.linalg.norm(c) * np.linalg.norm(b)
    return c @ b if simple else np.full((len(c), b.shape[1]), np.nan + 0j)


def is_positive(K: ComplexArray) -> bool:
    """Whether a residue is Hermitian positive semidefinite, but for rounding."""
    if not np.isfinite(K).all():
        return False
    size = float(np.linalg.norm(K, 2))
    least = float(np.linalg.eigvalsh(0.5 * (K + K.conj().T))[0])
    return bool(np.linalg.norm(K - K.conj().T, 2) <= _RESIDUE * size and least >= -_RESIDUE * size)


def violations(split: Split, tested: Passivity | None, *, scattering: bool) -> list[Band]:
    """Bands of the rest and poles on the axis that are not passive, ascending."""
    wrong = [w for w, K in split.axis if scattering or not is_positive(K)]
    bands = [Band(w, w, w, np.inf) for w in wrong] + ([] if tested is None else tested.bands())
    return sorted(bands, key=lambda band: band.low)

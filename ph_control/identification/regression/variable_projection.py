"""Variable projection: residues and initial states eliminated, frequencies by Levenberg-Marquardt.

For given frequencies the best `kappa >= 0` and initial states solve a linear problem (`Projection`); what is left
is a small non-linear problem in the frequencies alone (Golub and Pereyra, with the Jacobian of Kaufman).

Of the rows only triangular factors are kept, made block by block, so that memory does not grow with the record:
orthogonal transformations eliminate what belongs to one experiment, then the factors of all are put under one another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, solve_triangular
from scipy.optimize import minimize, nnls

from ..._checks import EPS
from .frequency_rows import FrequencyRows
from .time_rows import Rows
from .triangular import reduced, triangle

Array = NDArray[np.float64]

Progress = Callable[[int, float], None]  # iteration, loss

_FLAT = 1e-9  # slope of the loss, relative to itself and to a step of its own size, at a minimum
LAST = 1e-15  # relative decrease of the loss at which the last refinement ends
_BETTER = 1e-3  # relative decrease of the loss for which a mode is moved to another place
_WELL_CONDITIONED = 1e6  # entries of the inverse of a factor of unit columns, above which its rank is looked at


@dataclass(frozen=True)
class Problem:
    """The experiments of one fit, and what the fit may do.

    `signed` lets residues take either sign; `structured` takes the free motion from modes without weight, which no
    state of a port-Hamiltonian system shows at its port.
    """

    experiments: tuple[Rows, ...]
    signed: bool = False
    structured: bool = False

    @cached_property
    def samples(self) -> int:
        """Number of real equations."""
        return sum(one.samples for one in self.experiments)

    @cached_property
    def rounding(self) -> float:
        """Loss below which residuals are rounding: in recursions run in doubles, errors grow with the samples."""
        largest = max(one.largest for one in self.experiments)
        return float(self.samples * (EPS * self.samples * largest) ** 2)

    @cached_property
    def driven(self) -> bool:
        """Whether any experiment shows the residues."""
        return any(one.driven for one in self.experiments)

    @property
    def carried(self) -> int:
        """Largest number of modes for which there are more equations than unknowns."""
        none = self.unknowns(0)
        return max(0, (self.samples - 1 - none) // (self.unknowns(1) - none))

    @cached_property
    def bin(self) -> float:
        """Width of a basin of the loss, by the longest experiment."""
        return min(one.bin for one in self.experiments)

    @cached_property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""
        return max(one.ceiling for one in self.experiments)

    def unknowns(self, n: int) -> int:
        """Parameters of n modes: frequencies, residues, and what belongs to each experiment."""
        return (1 + self.driven) * n + sum(one.own_unknowns(n) for one in self.experiments)

    def project(self, d: Array) -> Projection:
        """Best residues and initial states for frequencies `d`."""
        return Projection(self, d)


@dataclass(frozen=True)
class _Eliminated:
    """An experiment whose own unknowns are eliminated: `own = solve @ (rest_of_rows - ...)`.

    `above` (k, p) are the rows that the own unknowns fit exactly, `inverse` (s, k) turns them into these unknowns,
    `below` what is left for the shared columns, the last column being the output.
    """

    inverse: Array
    above: Array
    below: Array
    deficiency: int


class Projection:
    """The linear problem at one set of frequencies (n,), solved."""

    def __init__(self, problem: Problem, d: Array) -> None:
        self.problem, self.d = problem, d
        self._evaluations = [one.at(d) for one in problem.experiments]

    # --- first pass: residues, initial states, loss ---------------------------------------------------------------

    @cached_property
    def _factors(self) -> list[Array]:
        """Triangular factor of `[own, shared, output]` of each experiment."""
        return [
            triangle(evaluation.blocks, rows.samples, evaluation.gram())
            for evaluation, rows in zip(self._evaluations, self.problem.experiments, strict=True)
        ]

    @cached_property
    def _lengths(self) -> Array:
        """Norm of each shared column over all experiments."""
        n = len(self.d)
        squares = np.zeros(n)
        for factor, rows in zip(self._factors, self.problem.experiments, strict=True):
            if rows.driven:
                squares += np.sum(factor[:, -n - 1 : -1] ** 2, axis=0)
        return np.where(squares > 0, np.sqrt(squares), 1.0)

    def _own(self, place: int) -> int:
        return self.problem.experiments[place].own_unknowns(len(self.d))

    def _without_held(self, factor: Array, place: int, held: NDArray[np.bool_]) -> Array:
        """Factor whose own columns of held modes are 0, where the structure asks for it."""
        n, own = len(self.d), self._own(place)
        if not (self.problem.structured and held.any() and own >= 2 * n):
            return factor
        factor = factor.copy()
        factor[:, np.flatnonzero(np.concatenate([held, held]))] = 0.0
        return reduced(factor)

    def _eliminated(self, factors: Sequence[Array], held: NDArray[np.bool_]) -> list[_Eliminated]:
        return [
            eliminate(self._without_held(factor, k, held), self._own(k), self.problem.samples)
            for k, factor in enumerate(factors)
        ]

    @cached_property
    def _solution(self) -> tuple[Array, NDArray[np.bool_], list[_Eliminated], int]:
        """Residues, which of them are free, the eliminated experiments, and the rank that the residues lack."""
        n = len(self.d)
        held = np.zeros(n, bool)
        while True:
            parts = self._eliminated(self._factors, held)
            if not self.problem.driven:
                return np.zeros(n), ~held, parts, 0
            stacked = np.concatenate(
                [p.below if rows.driven else _widened(p.below, n) for p, rows in self._pairs(parts)]
            )
            scaled = stacked[:, :-1] / self._lengths
            kappa, free, deficiency = _residues(scaled, stacked[:, -1], held, self.problem)
            if not self.problem.structured or np.array_equal(free, ~held):
                return kappa / self._lengths, free, parts, deficiency
            held = ~free

    def _pairs(self, parts: list[_Eliminated]) -> Iterable[tuple[_Eliminated, Rows]]:
        return zip(parts, self.problem.experiments, strict=True)

    @property
    def kappa(self) -> Array:
        """Residues, shape (n,); 0 where no experiment shows them."""
        return self._solution[0]

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which residues are not held at 0 by `kappa >= 0`, shape (n,)."""
        return self._solution[1]

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment: free motion `(alpha, beta)` of each mode, then the offset."""
        found = []
        for part, rows in self._pairs(self._solution[2]):
            rhs = part.above[:, -1] - (part.above[:, :-1] @ self.kappa if rows.driven else 0.0)
            own = part.inverse @ rhs
            if self.problem.structured and len(own) >= 2 * len(self.d):
                own[np.flatnonzero(np.concatenate([~self.free, ~self.free]))] = 0.0
            found.append(own)
        return found

    @property
    def deficiency(self) -> int:
        """How many combinations of residues and initial states the data do not show at all."""
        return self._solution[3] + sum(part.deficiency for part in self._solution[2])

    @cached_property
    def loss(self) -> float:
        """Sum of squared residuals."""
        total = 0.0
        for part, rows in self._pairs(self._solution[2]):
            left = part.below[:, -1] - (part.below[:, :-1] @ self.kappa if rows.driven else 0.0)
            total += float(left @ left)
        return total

    # --- second pass: sensitivity to the frequencies ---------------------------------------------------------------

    @cached_property
    def _sensitive_factors(self) -> list[Array]:
        """Triangular factor of `[own, shared, by frequency, output]` of each experiment."""
        return [
            triangle(
                partial(evaluation.sensitive_blocks, self.kappa, own),
                rows.samples,
                evaluation.sensitive_gram(self.kappa, own),
            )
            for evaluation, own, rows in zip(self._evaluations, self.own, self.problem.experiments, strict=True)
        ]

    @cached_property
    def _reduced(self) -> tuple[Array, Array]:
        """Jacobian by the frequencies with everything else moving along, and the residual, both in a few rows."""
        n = len(self.d)
        rows = []
        for part, one in self._pairs(self._eliminated(self._sensitive_factors, ~self.free)):
            rows.append(part.below if one.driven else _widened(part.below, n))
        stacked = np.concatenate(rows)
        shared = stacked[:, :n][:, self.free] / self._lengths[self.free]
        rest = stacked[:, n:]
        if shared.size and self.problem.driven:
            U, sigma, _ = np.linalg.svd(shared, full_matrices=False)
            basis = U[:, sigma > _tolerance(self.problem.samples, n) * max(1.0, sigma.max(initial=0.0))]
            rest = rest - basis @ (basis.T @ rest)
        # the frequency of a mode without any trace stays: its column would be rounding
        return -rest[:, :n] * self._traced, rest[:, n]

    @property
    def _moving(self) -> NDArray[np.bool_]:
        """Which modes may move freely in a record."""
        return self.free if self.problem.structured else np.ones(len(self.d), bool)

    @cached_property
    def _traced(self) -> NDArray[np.bool_]:
        """Which modes leave a trace in any experiment."""
        n = len(self.d)
        records = any(self._own(k) >= 2 * n for k in range(len(self.problem.experiments)))
        return (self.free & self.problem.driven) | (self._moving & records)

    @cached_property
    def gradient(self) -> Array:
        """Half the gradient of the loss by the frequencies, shape (n,)."""
        jacobian, residual = self._reduced
        return np.asarray(jacobian.T @ residual)

    @cached_property
    def gram(self) -> Array:
        """`J^T J` of the residuals by the frequencies, shape (n, n)."""
        return np.asarray(self._reduced[0].T @ self._reduced[0])

    def jacobian(self) -> tuple[Array, NDArray[np.bool_]]:
        """Derivatives of the prediction by `(d, kappa, own of each experiment)` and which of these are free.

        Orthogonally reduced to a few rows, so that only its Gram matrix is that of the rows of the data.
        """
        n = len(self.d)
        counts = [self._own(k) for k in range(len(self.problem.experiments))]
        ends = np.cumsum([2 * n, *counts])
        rows, known = [], [self._traced, self.free & self.problem.driven]
        for k, (factor, one) in enumerate(zip(self._sensitive_factors, self.problem.experiments, strict=True)):
            s, f = counts[k], n if one.driven else 0
            part = np.zeros((len(factor), int(ends[-1])))
            part[:, ends[k] : ends[k + 1]] = factor[:, :s]
            part[:, n : n + f] = factor[:, s : s + f]
            part[:, :n] = factor[:, s + f : s + f + n]
            rows.append(part)
            parts = [self._moving, self._moving, np.ones(s - 2 * n, bool)] if s >= 2 * n else [np.ones(s, bool)]
            known.append(np.concatenate(parts))
        return np.concatenate(rows), np.concatenate(known)

    def column_lengths(self) -> Array:
        """Norms of the columns of the residues, and of what belongs to each experiment."""
        n = len(self.d)
        shared, own = np.zeros(n), []
        for k, (factor, rows) in enumerate(zip(self._factors, self.problem.experiments, strict=True)):
            squares = np.sum(factor[:, :-1] ** 2, axis=0)
            own.append(np.sqrt(squares[: self._own(k)]))
            shared += squares[self._own(k) :] if rows.driven else 0.0
        return np.concatenate([np.sqrt(shared), *own])

    def asks_for_negative_residues_only(self) -> bool:
        """Whether all residues would be negative, were they free to be."""
        signed = Projection(replace(self.problem, signed=True), self.d)
        return bool(self.problem.driven and np.all(signed.kappa < 0))

    def predicted(self) -> list[NDArray[Any]]:
        """Output of the model at all instants of each experiment."""
        return [
            evaluation.predict(self.kappa, own) for evaluation, own in zip(self._evaluations, self.own, strict=True)
        ]


def _tolerance(samples: int, columns: int) -> float:
    return max(samples, columns) * EPS


def _widened(below: Array, n: int) -> Array:
    """Rows of an experiment without residues, with zeros in their place."""
    return np.concatenate([np.zeros((len(below), n)), below], axis=1)


def eliminate(factor: Array, own: int, samples: int) -> _Eliminated:
    """Eliminate the first `own` columns of a triangular factor; directions that these do not reach stay below."""
    if own == 0:
        return _Eliminated(np.zeros((0, 0)), factor[:0], factor, 0)
    corner = factor[:own, :own]
    lengths = np.sqrt(np.einsum("ij,ij->j", corner, corner))
    lengths = np.where(lengths > 0, lengths, 1.0)
    direct, singular = lapack.dtrtri(corner / lengths)
    if not singular and np.abs(direct).max() < _WELL_CONDITIONED:
        return _Eliminated(direct / lengths[:, None], factor[:own, own:], factor[own:, own:], 0)
    U, sigma, Vt = np.linalg.svd(corner / lengths)
    kept = sigma > _tolerance(samples, own) * sigma.max(initial=0.0)
    above = U.T @ factor[:own, own:]
    inverse = (Vt[kept].T / sigma[kept]) / lengths[:, None]
    below = np.concatenate([above[~kept], factor[own:, own:]])
    return _Eliminated(inverse, above[kept], below, int(np.sum(~kept)))


def _residues(
    columns: Array, rhs: Array, held: NDArray[np.bool_], problem: Problem
) -> tuple[Array, NDArray[np.bool_], int]:
    """Least squares with `kappa >= 0` for columns of length at most 1; which are free; how many directions are lost."""
    tolerance = _tolerance(problem.samples, columns.shape[1])
    kappa, deficiency = _least_squares(columns, rhs, ~held, tolerance)
    if problem.signed or np.all(kappa >= 0):
        return kappa, ~held, deficiency
    shown = np.where(held, 0.0, columns)
    found, _ = nnls(shown, rhs, maxiter=30 * max(1, len(held)))
    free = found > 0
    kappa, deficiency = _least_squares(columns, rhs, free, tolerance)
    # a rank-deficient problem can leave a residue at minus rounding
    return np.maximum(kappa, 0.0), free, deficiency


def _least_squares(columns: Array, rhs: Array, free: NDArray[np.bool_], tolerance: float) -> tuple[Array, int]:
    """Smallest solution with the columns that are free, and the rank that these lack."""
    solution = np.zeros(columns.shape[1])
    if not free.any():
        return solution, 0
    U, sigma, Vt = np.linalg.svd(columns[:, free], full_matrices=False)
    kept = sigma > tolerance * max(1.0, sigma.max(initial=0.0))
    solution[free] = Vt[kept].T @ ((U[:, kept].T @ rhs) / sigma[kept])
    return solution, int(np.sum(~kept))


@dataclass(frozen=True)
class Refinement:
    """End of a Levenberg-Marquardt run."""

    projection: Projection
    iterations: int
    converged: bool
    interrupted: bool = False


def refine(
    problem: Problem,
    d: Array,
    *,
    rtol: float,
    max_iterations: int = 60,
    last: bool = True,
    progress: Progress | None = None,
) -> Refinement:
    """Minimise the loss over the frequencies from a start within the basin of the minimum.

    Stops when a full step would reduce the loss by less than `rtol` of itself, or when steps drown in rounding; that
    step is still taken if it is to be the `last`.
    No step is longer than one Fourier bin in any frequency, so that it stays in its basin.
    """
    current = problem.project(d)
    if len(d) == 0:
        return Refinement(current, 0, True)
    state: _Descent | None = _Descent(current)
    try:
        while state is not None:
            end = state
            while not end.converged and end.iterations < max_iterations:
                _descend(problem, end, rtol, last)
                if progress is not None:
                    progress(end.iterations, end.current.loss)
            if last and not end.converged:
                _follow_secants(problem, end)
            state = _elsewhere(problem, end) if end.converged else None
    except (KeyboardInterrupt, StopIteration):
        return Refinement(end.current, end.iterations, False, interrupted=True)
    return Refinement(end.current, end.iterations, end.converged)


@dataclass
class _Descent:
    """Where a refinement stands."""

    current: Projection
    damping: float = 1e-3
    growth: float = 2.0
    iterations: int = 0
    converged: bool = False


def _elsewhere(problem: Problem, state: _Descent) -> _Descent | None:
    """A start beside a minimum from which the loss is lower, where the rows know of such places."""
    at = state.current
    best = at
    for rows in problem.experiments:
        for l, place in rows.elsewhere(at.d, at.kappa) if isinstance(rows, FrequencyRows) else []:
            moved = at.d.copy()
            moved[l] = min(max(place, 1e-3 * problem.bin), problem.ceiling)
            trial = problem.project(moved)
            best = trial if trial.loss < best.loss else best
    return _Descent(best, iterations=state.iterations) if best.loss < (1 - _BETTER) * at.loss else None


def _descend(problem: Problem, state: _Descent, rtol: float, last: bool) -> None:
    """One iteration of Levenberg and Marquardt, damped as Nielsen does."""
    current = state.current
    state.iterations += 1
    scale = np.maximum(np.diag(current.gram), EPS * np.diag(current.gram).max(initial=0.0))
    if not scale.any():
        state.converged = True
        return
    step = _damped_step(current.gram, scale, state.damping, current.gradient)
    step *= min(1.0, problem.bin / np.abs(step).max())
    promised = float(-(current.gradient @ step) - 0.5 * step @ current.gram @ step)
    if promised <= 0.5 * rtol * current.loss or np.all(np.abs(step) <= 2 * EPS * current.d):
        state.converged = True
        if not last:
            return
    trial = problem.project(np.clip(current.d + step, 1e-3 * problem.bin, problem.ceiling))
    ratio = (current.loss - trial.loss) / max(2 * promised, np.finfo(float).tiny)
    # the last step shortens the way to the minimum also where its gain drowns in the rounding of the loss
    if trial.loss < current.loss or (state.converged and trial.loss <= current.loss * (1 + problem.samples * EPS)):
        state.current = trial
        state.damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3)
        state.growth = 2.0
    else:
        state.damping, state.growth = state.damping * state.growth, 2 * state.growth
        state.converged = state.converged or state.damping > 1e16


def _follow_secants(problem: Problem, state: _Descent) -> None:
    """The way to the minimum where much is left, so that the curvature is not that of the Jacobian alone (BFGS)."""
    start, curvature = state.current, np.diag(state.current.gram)
    unit = np.minimum(problem.bin, np.sqrt(start.loss / np.where(curvature > 0, curvature, np.inf)))
    if not unit.any() or start.loss == 0:
        return
    best = start

    def relative(x: Array) -> tuple[float, Array]:
        nonlocal best
        at = problem.project(np.clip(start.d + unit * x, 1e-3 * problem.bin, problem.ceiling))
        best = at if at.loss < best.loss else best
        return at.loss / start.loss, 2 * unit * at.gradient / start.loss

    found = minimize(relative, np.zeros(len(unit)), jac=True, method="BFGS", options={"gtol": _FLAT})
    state.current, state.iterations = best, state.iterations + int(found.nit)
    # where the loss rounds, steps end before the slope does
    slope = np.max(np.abs(unit * best.gradient)) / best.loss
    state.converged = bool(found.success or slope < np.sqrt(problem.samples * EPS))


def _damped_step(gram: Array, scale: Array, damping: float, gradient: Array) -> Array:
    """Solve `(J^T J + damping diag) step = -gradient` in units where the diagonal is 1."""
    root = np.sqrt(scale)
    matrix = gram / np.outer(root, root) + damping * np.eye(len(gram))
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return -gradient / scale / (1 + damping)
    half = solve_triangular(factor, -gradient / root, lower=True)
    return np.asarray(solve_triangular(factor.T, half)) / root

"""Variable projection: residues and initial states eliminated, poles by Levenberg-Marquardt.

For given frequencies the best `kappa >= 0` and initial states of lossless modes solve a linear problem (`Projection`);
what is left is a small non-linear problem in the frequencies alone.  `refine` solves it, and in the same way that of
modes with any damping, whose poles are two numbers each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize, nnls

from ..._checks import EPS
from ..._types import Array, ComplexArray, Mask, NDArray
from .elimination import Eliminated, LinearProjection, eliminate, tolerance, without
from .frequency_rows import FrequencyRows
from .spectral_rows import Window
from .time_rows import RecordRows
from .triangular import reduced
from .tuning import TUNING

Progress = Callable[[int, float], None]  # iteration, loss
Rows = RecordRows | FrequencyRows | Window

_FLAT = 1e-9  # slope of the loss, relative to itself and to a step of its own size, at a minimum
LAST = 1e-15  # relative decrease of the loss at which the last refinement ends
_STUCK = 1e16  # damping of steps of which none leads on

# --- lossless modes -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Problem:
    """The experiments of one fit of lossless modes, and what the fit may do.

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

    def inside(self, d: Array) -> Array:
        """Frequencies brought to the band."""
        return np.clip(d, 1e-3 * self.bin, self.ceiling)

    def reach(self, at: Projection) -> Array:
        """Widths of the basins of the modes: a Fourier bin each."""
        return np.full(len(at.d), self.bin)

    def elsewhere(self, at: Projection) -> Iterator[Array]:
        """Starts beside a minimum where the rows know of such places."""
        for rows in self.experiments:
            for l, place in rows.elsewhere(at.d, at.kappa) if isinstance(rows, FrequencyRows) else []:
                yield np.where(np.arange(len(at.d)) == l, place, at.d)


class Projection(LinearProjection):
    """The linear problem of lossless modes at one set of frequencies (n,), solved."""

    def __init__(self, problem: Problem, d: Array) -> None:
        self.problem, self.d, self.x, self.sizes = problem, d, d, d
        self._evaluations = [one.at(d) for one in problem.experiments]

    # --- first pass: residues, initial states, loss ---------------------------------------------------------------

    @cached_property
    def _factors(self) -> list[Array]:
        """Triangular factor of `[own, shared, output]` of each experiment."""
        pairs = zip(self._evaluations, self.problem.experiments, strict=True)
        return [self._with_residues(evaluation.factor(rows.samples), rows) for evaluation, rows in pairs]

    def _with_residues(self, factor: Array, rows: Rows) -> Array:
        """Factor of an experiment, with zeros for the residues where it does not show them."""
        n = len(self.d)
        return factor if rows.driven else np.insert(factor, n * [rows.own_unknowns(n)], 0.0, axis=1)

    @cached_property
    def _lengths(self) -> Array:
        """Norm of each shared column over all experiments."""
        n = len(self.d)
        lengths = np.sqrt(sum(np.sum(factor[:, -n - 1 : -1] ** 2, axis=0) for factor in self._factors))
        return np.where(lengths > 0, lengths, 1.0)

    def _own(self, place: int) -> int:
        return self.problem.experiments[place].own_unknowns(len(self.d))

    def motion(self, place: int) -> int:
        """How many unknowns of an experiment are the free motion of its modes; they come first."""
        return self._own(place) - self.problem.experiments[place].own_unknowns(0)

    def _without_held(self, factor: Array, place: int, held: Mask) -> Array:
        """Factor whose own columns of held modes are 0, where the structure asks for it."""
        if not (self.problem.structured and held.any() and self.motion(place)):
            return factor
        factor = factor.copy()
        factor[:, np.flatnonzero(np.tile(held, 2))] = 0.0
        return reduced(factor)

    def _eliminated(self, factors: Sequence[Array], held: Mask) -> list[Eliminated]:
        return [
            eliminate(self._without_held(factor, k, held), self._own(k), self.problem.samples)
            for k, factor in enumerate(factors)
        ]

    @cached_property
    def _solution(self) -> tuple[Array, Mask, list[Eliminated]]:
        """Residues, which of them are free, and the eliminated experiments."""
        n = len(self.d)
        held = np.zeros(n, bool)
        while True:
            parts = self._eliminated(self._factors, held)
            if not self.problem.driven:
                return np.zeros(n), ~held, parts
            stacked = np.concatenate([part.below for part in parts])
            kappa, free = _residues(stacked[:, :-1] / self._lengths, stacked[:, -1], held, self.problem)
            if not self.problem.structured or np.array_equal(free, ~held):
                return kappa / self._lengths, free, parts
            held = ~free

    @property
    def kappa(self) -> Array:
        """Residues, shape (n,); 0 where no experiment shows them."""
        return self._solution[0]

    @property
    def free(self) -> Mask:
        """Which residues are not held at 0 by `kappa >= 0`, shape (n,)."""
        return self._solution[1]

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment: free motion `(alpha, beta)` of each mode, then the offset."""
        found = []
        for k, part in enumerate(self._solution[2]):
            own = part.inverse @ (part.above[:, -1] - part.above[:, :-1] @ self.kappa)
            own[: self.motion(k)][np.tile(~self._moving, 2)[: self.motion(k)]] = 0.0
            found.append(own)
        return found

    def amplitudes(self, place: int) -> ComplexArray:
        """Free motion of each mode at the output of an experiment, shape (n,); 0 from rest."""
        n, own = len(self.d), self.own[place]
        return own[:n] + 1j * own[n : 2 * n] if self.motion(place) else np.zeros(n, complex)

    @cached_property
    def ascending(self) -> Projection:
        """The same with the frequencies in ascending order."""
        return self if np.all(np.diff(self.d) >= 0) else self.problem.project(np.sort(self.d))

    @cached_property
    def loss(self) -> float:
        """Sum of squared residuals."""
        left = (part.below[:, -1] - part.below[:, :-1] @ self.kappa for part in self._solution[2])
        return float(sum(one @ one for one in left))

    # --- second pass: sensitivity to the frequencies ---------------------------------------------------------------

    @cached_property
    def _sensitive_factors(self) -> list[Array]:
        """Triangular factor of `[own, shared, by frequency, output]` of each experiment."""
        triples = zip(self._evaluations, self.own, self.problem.experiments, strict=True)
        return [
            self._with_residues(evaluation.sensitive_factor(rows.samples, self.kappa, own), rows)
            for evaluation, own, rows in triples
        ]

    @cached_property
    def condensed(self) -> tuple[Array, Array]:
        """Residual, and its Jacobian by the frequencies with everything else moving along, both in a few rows."""
        n = len(self.d)
        stacked = np.concatenate([part.below for part in self._eliminated(self._sensitive_factors, ~self.free)])
        shared = stacked[:, :n][:, self.free] / self._lengths[self.free]
        rest = stacked[:, n:]
        if shared.size and self.problem.driven:
            U, sigma, _ = np.linalg.svd(shared, full_matrices=False)
            rest = without(rest, U[:, sigma > tolerance(self.problem.samples, n) * max(1.0, sigma.max(initial=0.0))])
        # the frequency of a mode without any trace stays: its column would be rounding
        return rest[:, n], -rest[:, :n] * self._traced

    @property
    def _moving(self) -> Mask:
        """Which modes may move freely in a record."""
        return self.free if self.problem.structured else np.ones(len(self.d), bool)

    @cached_property
    def _traced(self) -> Mask:
        """Which modes leave a trace in any experiment."""
        records = any(self.motion(k) for k in range(len(self.problem.experiments)))
        return (self.free & self.problem.driven) | (self._moving & records)

    def jacobian(self) -> tuple[Array, Mask]:
        """Derivatives of the prediction by `(d, kappa, own of each experiment)` and which of these are free.

        Orthogonally reduced to a few rows, so that only its Gram matrix is that of the rows of the data.
        """
        n = len(self.d)
        counts = [self._own(k) for k in range(len(self.problem.experiments))]
        ends = np.cumsum([2 * n, *counts])
        rows, known = [], [self._traced, self.free & self.problem.driven]
        for k, (factor, s) in enumerate(zip(self._sensitive_factors, counts, strict=True)):
            part = np.zeros((len(factor), int(ends[-1])))
            part[:, ends[k] : ends[k + 1]] = factor[:, :s]
            part[:, n : 2 * n], part[:, :n] = factor[:, s : s + n], factor[:, s + n : s + 2 * n]
            rows.append(part)
            known.append(np.append(np.tile(self._moving, 2)[: self.motion(k)], np.ones(s - self.motion(k), bool)))
        return np.concatenate(rows), np.concatenate(known)

    @cached_property
    def energies(self) -> Array:
        """Output energy of each mode, roughly: of its forced and its free motion."""
        n, found = len(self.d), np.zeros(len(self.d))
        for k, (factor, own) in enumerate(zip(self._factors, self.own, strict=True)):
            squares = np.sum(factor[:, :-1] ** 2, axis=0)
            found += self.kappa**2 * squares[len(own) :]
            if self.motion(k):
                found += np.sum((own[: 2 * n] ** 2 * squares[: 2 * n]).reshape(2, n), axis=0)
        return found

    def asks_for_negative_residues_only(self) -> bool:
        """Whether all residues would be negative, were they free to be."""
        signed = Projection(replace(self.problem, signed=True), self.d)
        return bool(self.problem.driven and np.all(signed.kappa < 0))

    def predicted(self) -> list[NDArray[Any]]:
        """Output of the model at all instants of each experiment."""
        return [
            evaluation.predict(self.kappa, own) for evaluation, own in zip(self._evaluations, self.own, strict=True)
        ]


def _residues(columns: Array, rhs: Array, held: Mask, problem: Problem) -> tuple[Array, Mask]:
    """Least squares with `kappa >= 0` for columns of length at most 1, and which are free."""
    smallest = tolerance(problem.samples, columns.shape[1])
    kappa = _least_squares(columns, rhs, ~held, smallest)
    if problem.signed or np.all(kappa >= 0):
        return kappa, ~held
    found, _ = nnls(np.where(held, 0.0, columns), rhs, maxiter=30 * max(1, len(held)))
    free = found > 0
    # a rank-deficient problem can leave a residue at minus rounding
    return np.maximum(_least_squares(columns, rhs, free, smallest), 0.0), free


def _least_squares(columns: Array, rhs: Array, free: Mask, smallest: float) -> Array:
    """Smallest solution with the columns that are free."""
    solution = np.zeros(columns.shape[1])
    if free.any():
        U, sigma, Vt = np.linalg.svd(columns[:, free], full_matrices=False)
        kept = sigma > smallest * max(1.0, sigma.max(initial=0.0))
        solution[free] = Vt[kept].T @ ((U[:, kept].T @ rhs) / sigma[kept])
    return solution


# --- the poles ------------------------------------------------------------------------------------------------------

At = TypeVar("At", bound=LinearProjection)


class Minimisation(Protocol[At]):
    """A loss over real numbers `x` that fix the poles."""

    @property
    def samples(self) -> int:
        """Number of real equations."""

    def project(self, x: Array) -> At:
        """The best linear unknowns at `x`."""

    def inside(self, x: Array) -> Array:
        """Numbers brought to where they are allowed."""

    def reach(self, at: At) -> Array:
        """Widths of the basins of the loss; no step is longer."""

    def elsewhere(self, at: At) -> Iterator[Array]:
        """Places close to a minimum where the loss may have another one."""


@dataclass
class Refinement(Generic[At]):
    """Where a Levenberg-Marquardt run stands, or has ended."""

    projection: At
    iterations: int = 0
    converged: bool = False
    damping: float = 1e-3
    growth: float = 2.0


class Interrupted(KeyboardInterrupt):
    """A run that the user ended, and the numbers `x` that it had come to."""

    def __init__(self, x: Array) -> None:
        super().__init__()
        self.x = x


def refine(
    problem: Minimisation[At],
    x: Array,
    *,
    rtol: float,
    max_iterations: int = 60,
    last: bool = True,
    progress: Progress | None = None,
) -> Refinement[At]:
    """Minimise the loss over `x` from a start within the basin of the minimum.

    Stops when a full step would reduce the loss by less than `rtol` of itself, or when steps drown in rounding; that
    step is still taken if it is to be the `last`.  Raises `Interrupted`.
    """
    state: Refinement[At] | None = Refinement(problem.project(x), converged=len(x) == 0)
    try:
        while state is not None:
            end = state
            while not end.converged and end.iterations < max_iterations:
                _descend(problem, end, rtol, last)
                if progress is not None:
                    progress(end.iterations, end.projection.loss)
            if last and not end.converged:
                _follow_secants(problem, end)
            state = _elsewhere(problem, end) if end.converged and len(x) else None
    except KeyboardInterrupt:
        raise Interrupted(end.projection.x) from None
    return end


def _elsewhere(problem: Minimisation[At], state: Refinement[At]) -> Refinement[At] | None:
    """A start beside a minimum from which the loss is lower, where the problem knows of such places."""
    at = state.projection
    best = min([at, *(problem.project(problem.inside(x)) for x in problem.elsewhere(at))], key=lambda one: one.loss)
    return Refinement(best, state.iterations) if best.loss < (1 - TUNING.better_place) * at.loss else None


def _descend(problem: Minimisation[At], state: Refinement[At], rtol: float, last: bool) -> None:
    """One iteration of Levenberg and Marquardt, damped as Nielsen does."""
    current = state.projection
    state.iterations += 1
    scale = np.maximum(np.diag(current.gram), EPS * np.diag(current.gram).max(initial=0.0))
    if not scale.any():
        state.converged = True
        return
    step = _damped_step(current.gram, scale, state.damping, current.gradient)
    # as a largest share of the reach: the steps may be as small as they like
    step /= max(1.0, float(np.max(np.abs(step) / problem.reach(current), initial=0.0)))
    promised = float(-(current.gradient @ step) - 0.5 * step @ current.gram @ step)
    if promised <= 0.5 * rtol * current.loss or np.all(np.abs(step) <= 2 * EPS * current.sizes):
        state.converged = True
        if not last:
            return
    trial = problem.project(problem.inside(current.x + step))
    ratio = (current.loss - trial.loss) / max(2 * promised, np.finfo(float).tiny)
    # the last step shortens the way to the minimum also where its gain drowns in the rounding of the loss
    if trial.loss < current.loss or (state.converged and trial.loss <= current.loss * (1 + problem.samples * EPS)):
        state.projection = trial
        state.damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3)
        state.growth = 2.0
    else:
        state.damping, state.growth = state.damping * state.growth, 2 * state.growth
        state.converged = state.converged or state.damping > _STUCK


def _follow_secants(problem: Minimisation[At], state: Refinement[At]) -> None:
    """The way to the minimum where much is left, so that the curvature is not that of the Jacobian alone (BFGS)."""
    start, curvature = state.projection, np.diag(state.projection.gram)
    unit = np.minimum(problem.reach(start), np.sqrt(start.loss / np.where(curvature > 0, curvature, np.inf)))
    if not unit.any() or start.loss == 0:
        return
    best = start

    def relative(x: Array) -> tuple[float, Array]:
        nonlocal best
        at = problem.project(problem.inside(start.x + unit * x))
        best = at if at.loss < best.loss else best
        return at.loss / start.loss, 2 * unit * at.gradient / start.loss

    found = minimize(relative, np.zeros(len(unit)), jac=True, method="BFGS", options={"gtol": _FLAT})
    state.projection, state.iterations = best, state.iterations + int(found.nit)
    # where the loss rounds, steps end before the slope does
    slope = np.max(np.abs(unit * best.gradient)) / best.loss
    state.converged = bool(found.success or slope < np.sqrt(problem.samples * EPS))


def _damped_step(gram: Array, scale: Array, damping: float, gradient: Array) -> Array:
    """Solve `(J^T J + damping diag) step = -gradient` in units where the diagonal is 1."""
    root = np.sqrt(scale)
    matrix = gram / np.outer(root, root) + damping * np.eye(len(gram))
    _, step, failed = lapack.dposv(matrix, -gradient / root)
    return -gradient / scale / (1 + damping) if failed else np.asarray(step) / root

"""Variable projection: residues and motions are eliminated, and the residual minimised by Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize

from ..._checks import EPS
from ..._heartbeat import alive
from ..._types import Array
from .elimination import LinearProjection

Progress = Callable[[int, float], None]  # iteration, loss

_FLAT = 1e-9  # slope of the loss, relative to itself and to a step of its own size, at a minimum
_SECANTS = 100  # steps along secants at most
_STUCK = 1e16  # damping of steps of which none leads on

Projection = TypeVar("Projection", bound=LinearProjection)


class Minimisation(Protocol[Projection]):
    """A loss over real numbers `x` that fix the poles."""

    @property
    def samples(self) -> int:
        """Number of real equations."""

    def project(self, x: Array) -> Projection:
        """The best linear unknowns at `x`."""

    def inside(self, x: Array) -> Array:
        """Numbers brought to where they are allowed."""

    def reach(self, projection: Projection) -> Array:
        """Widths of the basins of the loss; no step is longer."""


@dataclass
class Refinement(Generic[Projection]):
    """Where a Levenberg-Marquardt run stands, or has ended."""

    projection: Projection
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
    problem: Minimisation[Projection],
    x: Array,
    *,
    rtol: float,
    max_iterations: int = 60,
    last: bool = True,
    progress: Progress | None = None,
) -> Refinement[Projection]:
    """Minimise the loss over `x` from a start within the basin of the minimum.

    Stops when a full step would reduce the loss by less than `rtol` of itself, or when steps drown in rounding; that
    step is still taken if it is to be the `last`.  Raises `Interrupted`.
    """
    end = Refinement(problem.project(x), converged=len(x) == 0)
    return continue_refinement(problem, end, rtol=rtol, max_iterations=max_iterations, last=last, progress=progress)


def continue_refinement(
    problem: Minimisation[Projection],
    end: Refinement[Projection],
    *,
    rtol: float,
    max_iterations: int,
    last: bool,
    progress: Progress | None = None,
) -> Refinement[Projection]:
    """Go on with a minimisation from where it stands, up to so many iterations in all, as `refine` does."""
    try:
        while not end.converged and end.iterations < max_iterations:
            alive("refinement")
            _descend(problem, end, rtol, last)
            if progress is not None:
                progress(end.iterations, end.projection.loss)
        if last and not end.converged:
            _follow_secants(problem, end)
    except KeyboardInterrupt:
        raise Interrupted(end.projection.x) from None
    return end


def _descend(problem: Minimisation[Projection], state: Refinement[Projection], rtol: float, last: bool) -> None:
    """One iteration of Levenberg and Marquardt, damped as Nielsen does."""
    current = state.projection
    state.iterations += 1
    curvature, square = np.diag(current.gram), current.sizes**2
    if not curvature.any():
        state.converged = True
        return
    # curvatures are compared in steps of the size of each number, so that units do not count
    least = np.divide(EPS * (curvature * square).max(), square, out=np.zeros(len(square)), where=square > 0)
    scale = np.maximum(curvature, least)
    scale[scale == 0] = 1.0
    step = _damped_step(current.gram, scale, state.damping, current.gradient)
    # as a largest share of the reach: the steps may be as small as they like
    step /= max(1.0, float(np.max(np.abs(step) / problem.reach(current), initial=0.0)))
    promised = float(-(current.gradient @ step) - 0.5 * step @ current.gram @ step)
    if promised <= 0.5 * rtol * current.loss or np.all(np.abs(step) <= 2 * EPS * current.sizes):
        state.converged = True
        if not last:
            return
    trial = problem.project(problem.inside(current.x + step))
    ratio = float(current.loss - trial.loss) / max(2 * float(promised), float(np.finfo(float).tiny))
    # the last step shortens the way to the minimum also where its gain drowns in the rounding of the loss
    if trial.loss < current.loss or (state.converged and trial.loss <= current.loss * (1 + problem.samples * EPS)):
        state.projection = trial
        state.damping *= max(1 / 3, 1 - (2 * min(ratio, 1.0) - 1) ** 3)
        state.growth = 2.0
    else:
        state.damping, state.growth = state.damping * state.growth, 2 * state.growth
        state.converged = state.converged or state.damping > _STUCK


def _follow_secants(problem: Minimisation[Projection], state: Refinement[Projection]) -> None:
    """The way to the minimum where residuals are large, so that `J^T J` is not the curvature of the loss (BFGS)."""
    start, curvature = state.projection, np.diag(state.projection.gram)
    unit = np.minimum(problem.reach(start), np.sqrt(start.loss / np.where(curvature > 0, curvature, np.inf)))
    if not unit.any() or start.loss == 0:
        return
    best = start

    def relative(x: Array) -> tuple[float, Array]:
        nonlocal best
        trial = problem.project(problem.inside(start.x + unit * x))
        best = trial if trial.loss < best.loss else best
        return trial.loss / start.loss, 2 * unit * trial.gradient / start.loss

    outcome = minimize(
        relative, np.zeros(len(unit)), jac=True, method="BFGS", options={"gtol": _FLAT, "maxiter": _SECANTS}
    )
    state.projection, state.iterations = best, state.iterations + int(outcome.nit)
    # where the loss rounds, steps end before the slope does
    slope = np.max(np.abs(unit * best.gradient)) / best.loss
    state.converged = bool(outcome.success or slope < np.sqrt(problem.samples * EPS))


def _damped_step(gram: Array, scale: Array, damping: float, gradient: Array) -> Array:
    """Solve `(J^T J + damping diag) step = -gradient` in units where the diagonal is 1."""
    root = np.sqrt(scale)
    matrix = gram / np.outer(root, root) + damping * np.eye(len(gram))
    _, step, failed = lapack.dposv(matrix, -gradient / root)
    return -gradient / scale / (1 + damping) if failed else np.asarray(step) / root

"""Variable projection: residues and initial states eliminated, frequencies by Levenberg-Marquardt.

For given frequencies the best `kappa >= 0` and initial states solve a linear problem (`Projection`); what is left
is a small non-linear problem in the frequencies alone, with its exact Jacobian (Golub and Pereyra).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from .._checks import EPS
from .regressors import Hold, Regressors, regressors

Array = NDArray[np.float64]

Progress = Callable[[int, float], None]  # iteration, loss


@dataclass(frozen=True)
class Problem:
    """The data of one fit: input, output, where the output was observed, and the hold."""

    u: Array
    y: Array
    observed: NDArray[np.bool_]
    hold: Hold
    from_rest: bool = False

    @cached_property
    def target(self) -> Array:
        """Observed outputs."""
        return self.y[self.observed]

    def seen(self, rows: Array) -> Array:
        """Rows at which the output was observed."""
        return rows if len(self.target) == len(rows) else rows[self.observed]

    @property
    def bin(self) -> float:
        """Spacing of the discrete Fourier frequencies, rad per unit time: the width of a basin of the loss."""
        return 2 * np.pi / (len(self.u) * self.hold.h)

    @property
    def unknowns(self) -> int:
        """Parameters of one mode: `d`, `kappa`, and the initial state where it is estimated."""
        return 2 if self.from_rest else 4

    @property
    def largest_phase(self) -> float:
        """Largest phase per step that is searched."""
        return self.hold.largest_phase(len(self.u)) * (1 - 1e-9)

    def project(self, d: Array) -> Projection:
        """Best residues and initial states for frequencies `d`."""
        return Projection(self, d, regressors(d, self.u, self.hold))


@dataclass(frozen=True)
class Projection:
    """The linear problem at one set of frequencies, solved; shapes for n modes and T observed samples."""

    problem: Problem
    d: Array
    regressors: Regressors

    @cached_property
    def _columns(self) -> Array:
        columns = self.problem.seen(self.regressors.columns())
        return columns[:, : len(self.d)] if self.problem.from_rest else columns

    @cached_property
    def _slopes(self) -> Array:
        slopes = self.problem.seen(self.regressors.slopes())
        return slopes[:, : len(self.d)] if self.problem.from_rest else slopes

    @cached_property
    def _factors(self) -> tuple[Array, Array, Array]:
        """`Q`, `R` of the columns scaled to unit length, and the lengths."""
        lengths = np.linalg.norm(self._columns, axis=0)
        lengths = np.where(lengths > 0, lengths, 1.0)
        Q, R = np.linalg.qr(self._columns / lengths)
        return Q, R, lengths

    @property
    def asks_for_negative_residues_only(self) -> bool:
        """Whether all residues would be negative, were they free to be."""
        Q, R, _ = self._factors
        return bool(np.all(_least_squares(R, Q.T @ self.problem.target)[0][: len(self.d)] < 0))

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """Which coefficients are not held at 0 by `kappa >= 0`."""
        Q, R, _ = self._factors
        n = len(self.d)
        free = np.ones(R.shape[1], bool)
        rhs = Q.T @ self.problem.target
        if np.all(_least_squares(R, rhs)[0][:n] >= 0):
            return free
        # eliminate the unconstrained columns, then non-negative least squares on the rest
        Q_states, _ = np.linalg.qr(R[:, n:])
        inside = R[:, :n] - Q_states @ (Q_states.T @ R[:, :n])
        kappa, _ = nnls(inside, rhs - Q_states @ (Q_states.T @ rhs), maxiter=30 * max(1, n))
        free[:n] = kappa > 0
        return free

    @cached_property
    def _solution(self) -> tuple[Array, Array, Array]:
        """Coefficients in original units, orthonormal basis of the free columns, and their pseudo-inverse."""
        Q, R, lengths = self._factors
        coefficients = np.zeros(R.shape[1])
        U, sigma, Vt = np.linalg.svd(R[:, self.free], full_matrices=False)
        kept = sigma > max(self._columns.shape) * EPS * sigma.max(initial=0.0)
        basis = Q @ U[:, kept]
        inverse = (Vt[kept].T / sigma[kept]) / lengths[self.free, None]
        coefficients[self.free] = inverse @ (basis.T @ self.problem.target)
        return coefficients, basis, inverse

    @property
    def coefficients(self) -> Array:
        """`(kappa, alpha, beta)`, shape (3n,)."""
        n = len(self.d)
        found = self._solution[0]
        full = found if not self.problem.from_rest else np.concatenate([found, np.zeros(2 * n)])
        # a rank-deficient problem can leave a residue at minus rounding
        return np.concatenate([np.maximum(full[:n], 0.0), full[n:]])

    @property
    def rank_deficiency(self) -> int:
        """How many combinations of residues and initial states the data do not show at all."""
        sigma = np.linalg.svd(self._factors[1], compute_uv=False)
        return int(np.sum(sigma <= max(self._columns.shape) * EPS * sigma.max(initial=0.0)))

    @cached_property
    def residual(self) -> Array:
        """Output minus prediction at the observed samples, shape (T,)."""
        return self.problem.target - self._columns @ self.coefficients[: self._columns.shape[1]]

    @cached_property
    def loss(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @cached_property
    def sensitivity(self) -> Array:
        """Derivative of the prediction by each frequency, coefficients fixed, shape (T, n)."""
        n = len(self.d)
        weighted = self._slopes * self.coefficients[: self._columns.shape[1]]
        blocks = weighted.shape[1] // n if n else 0
        return np.asarray(weighted.reshape(len(weighted), blocks, n).sum(axis=1))

    def jacobian(self) -> Array:
        """Exact derivative of the residual by the frequencies, the eliminated coefficients moving along."""
        n = len(self.d)
        _, basis, inverse = self._solution
        direct = self.sensitivity - basis @ (basis.T @ self.sensitivity)
        # second term of Golub and Pereyra: how the projector turns
        inner = (self._slopes.T @ self.residual).reshape(-1, n)
        turning = np.zeros((self._slopes.shape[1], n))
        for block, row in enumerate(inner):
            turning[block * n + np.arange(n), np.arange(n)] = row
        return -(direct + basis @ (inverse.T @ turning[self.free]))

    def full_jacobian(self) -> tuple[Array, NDArray[np.bool_]]:
        """Derivative of the prediction by `(d, kappa, alpha, beta)` and which of these are free."""
        free = np.concatenate([np.ones(len(self.d), bool), self.free])
        return np.concatenate([self.sensitivity, self._columns], axis=1), free


def _least_squares(R: Array, rhs: Array) -> tuple[Array, int]:
    U, sigma, Vt = np.linalg.svd(R, full_matrices=False)
    kept = sigma > len(R) * EPS * sigma.max(initial=0.0)
    return Vt[kept].T @ ((U[:, kept].T @ rhs) / sigma[kept]), int(kept.sum())


@dataclass(frozen=True)
class Refinement:
    """End of a Levenberg-Marquardt run."""

    projection: Projection
    iterations: int
    converged: bool


def refine(
    problem: Problem, d: Array, *, rtol: float, max_iterations: int = 60, progress: Progress | None = None
) -> Refinement:
    """Minimise the loss over the frequencies from a start within the basin of the minimum.

    Stops when a full step would reduce the loss by less than `rtol` of itself, or when steps drown in rounding.
    No step is longer than one Fourier bin in any frequency, so that it stays in its basin.
    """
    current = problem.project(d)
    if len(d) == 0:
        return Refinement(current, 0, True)
    damping, growth = 1e-3, 2.0
    iterations, converged = 0, False
    ceiling = problem.hold.frequency_of(np.array([problem.largest_phase]))[0]
    gradient, gram = _normal_equations(current)
    while not converged and iterations < max_iterations:
        iterations += 1
        scale = np.maximum(np.diag(gram), EPS * np.diag(gram).max(initial=0.0))
        if not scale.any():
            converged = True
            break
        step = _damped_step(gram, scale, damping, gradient)
        step *= min(1.0, problem.bin / np.abs(step).max())
        promised = float(-(gradient @ step) - 0.5 * step @ gram @ step)
        if promised <= 0.5 * rtol * current.loss or np.all(np.abs(step) <= 2 * EPS * current.d):
            converged = True
            # the last step costs one evaluation and may still help
        trial_d = np.clip(current.d + step, 1e-3 * problem.bin, ceiling)
        trial = problem.project(trial_d)
        ratio = (current.loss - trial.loss) / max(2 * promised, np.finfo(float).tiny)
        if trial.loss < current.loss:
            current = trial
            gradient, gram = _normal_equations(current)
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3)
            growth = 2.0
        else:
            damping, growth = damping * growth, 2 * growth
            converged = converged or damping > 1e16
        if progress is not None:
            progress(iterations, current.loss)
    return Refinement(current, iterations, converged)


def _normal_equations(at: Projection) -> tuple[Array, Array]:
    J = at.jacobian()
    return J.T @ at.residual, J.T @ J


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

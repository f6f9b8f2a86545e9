"""Random systems of several kinds, and the cost of the nearest passive model by a semidefinite program."""

from __future__ import annotations

import warnings
from typing import Any

import control as ct
import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov

KINDS = ("none", "definite", "singular", "scattering")


def random_system(seed: int) -> Any:
    """Stable system of 1 to 3 ports; the kind of its feedthrough is `KINDS[seed % 4]`."""
    rng = np.random.default_rng(seed)
    m, pairs, single = int(rng.integers(1, 4)), int(rng.integers(0, 4)), int(rng.integers(0, 3))
    blocks: list[Any] = []
    for _ in range(pairs):
        w, zeta = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-3, -0.5)
        blocks.append([[0.0, w], [-w, -2 * zeta * w]])
    blocks += [[[-(10 ** rng.uniform(-1, 1))]] for _ in range(max(single, int(not pairs)))]
    A = block_diag(*blocks)
    B = rng.standard_normal((len(A), m))
    C, root = rng.standard_normal((m, len(A))) + rng.choice([0.0, 1.0, 3.0]) * B.T, rng.standard_normal((m, m))
    kind = KINDS[seed % len(KINDS)]
    if kind == "definite":
        return ct.ss(A, B, C, 0.3 * root @ root.T + root - root.T)
    if kind == "singular":
        return ct.ss(A, B, C, np.outer(root[0], root[0]) if m > 1 else np.zeros((1, 1)))
    if kind == "scattering":
        gain = ct.norm(ct.ss(A, B, C, 0), "inf", tol=1e-6)
        return ct.ss(A, B, C * rng.uniform(0.5, 5.0) / gain, 0.5 * root / np.linalg.norm(root, 2))
    return ct.ss(A, B, C, 0)


def program(system: Any, scattering: bool) -> float:
    """Least squared H2 distance of a passive model with these poles and inputs: Kalman, Yakubovich and Popov."""
    import cvxpy as cp

    A, B, C, D = (np.array(getattr(system, name), float) for name in "ABCD")
    root = np.linalg.cholesky(solve_continuous_lyapunov(A, -B @ B.T))  # its states have the unit matrix as Gramian
    A, B, C = np.linalg.solve(root, A @ root), np.linalg.solve(root, B), C @ root
    (n, m), size = B.shape, float(np.linalg.norm(C))
    X, moved = cp.Variable((n, n), symmetric=True), cp.Variable((m, n))
    constraints: list[Any] = []
    if scattering:
        size, eye = 1.0, np.eye(m)
        W = cp.bmat([[-(A.T @ X + X @ A), -X @ B, -moved.T], [-(X @ B).T, eye, -D.T], [-moved, -D, eye]])
    else:
        values, U = np.linalg.eigh((D + D.T) / size)
        fed = values > 1e-12 * max(float(values[-1]), np.finfo(float).tiny)
        full, empty, W = U[:, fed], U[:, ~fed], -(A.T @ X + X @ A)
        if empty.shape[1]:
            constraints = [X @ (B @ empty) == moved.T @ empty]
        if full.shape[1]:
            coupling = moved.T @ full - X @ (B @ full)
            W = cp.bmat([[W, coupling], [coupling.T, np.diag(values[fed])]])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(moved - C / size)), [*constraints, W >> 0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the last digits
        problem.solve(solver="CLARABEL", tol_gap_abs=1e-14, tol_gap_rel=1e-10, tol_feas=1e-11)
    return float(problem.value) * size**2

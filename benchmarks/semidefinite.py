"""Nearest passive models beside the semidefinite program of the same problem, by CVXPY and Clarabel, one run.

    python -m benchmarks.semidefinite [--count N] [--stored]

Random systems of 1 to 3 ports with complex and real poles, damping ratios of 1e-3 to 0.3, without feedthrough, with a
positive definite one, with one of rank 1, and scattering matrices: cost over that of the program, of the model 0 and
of residues made positive semidefinite one by one, whether models are passive, CPU seconds.  `--stored` prints the
costs that the tests hold.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from time import process_time
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve_continuous_lyapunov

import ph_control as phc

Array = NDArray[Any]

KINDS = ("none", "definite", "singular", "scattering")


def main(argv: Sequence[str] | None = None) -> None:
    """Compare costs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--stored", action="store_true")
    options = parser.parse_args(argv)
    if options.stored:
        for seed in range(8):
            print(f"    {seed}: {program(random_system(seed), KINDS[seed % 4] == 'scattering'):.8g},")
        return
    ratios, passive_models, seconds, reference_seconds, seed, dearer = list[float](), 0, 0.0, 0.0, 0, 0
    while len(ratios) < options.count:
        system, scattering = random_system(seed), KINDS[seed % 4] == "scattering"
        seed += 1
        kind = "scattering" if scattering else "immittance"
        if phc.passivity(system, kind=kind).is_passive:
            continue
        start = process_time()
        reference = program(system, scattering)
        reference_seconds += process_time() - start
        start = process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = phc.nearest_passive(system, kind=kind)
        seconds += process_time() - start
        passive_models += phc.passivity(plain(model), kind=kind).is_passive
        ratios.append(model.cost / reference)
        dearer += any(model.cost > (1 + 1e-6) * cost for cost in simple_costs(system, scattering))
    found = np.abs(np.array(ratios) - 1)
    print(f"{options.count} systems that are not passive; passive after: {passive_models}")
    print(
        f"cost over that of the semidefinite program: off by median {np.median(found):.1e}, largest {found.max():.1e}"
    )
    print(f"dearer than the model 0 or one with positive semidefinite residues: {dearer}")
    print(f"{seconds:.2f} s, the program {reference_seconds:.2f} s")


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


def plain(model: Any) -> Any:
    """The matrices alone, which are judged without what is known of their energy."""
    return ct.ss(model.A, model.B, model.C, model.D)


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


def simple_costs(system: Any, scattering: bool) -> list[float]:
    """Squared H2 distances of passive models at hand: without residues, and with those made positive semidefinite."""
    A, B, C = (np.array(getattr(system, name), float) for name in "ABC")
    P = solve_continuous_lyapunov(A, -B @ B.T)
    costs = [float(np.trace(C @ P @ C.T))]
    if scattering:
        return costs
    # inputs as they are: `C = B^T X`, `X` positive semidefinite and the same for each pole
    starts = [k for k in range(len(A)) if not k or not A[k, k - 1]]
    rows = np.zeros_like(C)
    for start, end in zip(starts, [*starts[1:], len(A)], strict=True):
        b, c = B[start:end], C[:, start:end]
        energy = solve_continuous_lyapunov(A[start:end, start:end].T, -np.eye(end - start))
        rows[:, start:end] = b.T @ energy * max(0.0, float(np.sum((b.T @ energy) * c) / np.sum((b.T @ energy) ** 2)))
    off = rows - C
    return [*costs, float(np.trace(off @ P @ off.T))]


if __name__ == "__main__":
    main()

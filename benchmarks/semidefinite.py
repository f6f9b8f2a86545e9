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
from scipy.linalg import solve_continuous_lyapunov

import ph_control as phc
from tests.passive_programs import KINDS, program, random_system

Array = NDArray[Any]


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


def plain(model: Any) -> Any:
    """The matrices alone, which are judged without what is known of their energy."""
    return ct.ss(model.A, model.B, model.C, model.D)


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

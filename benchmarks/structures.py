"""The lowest modes of generated structures: time and memory beside bare `eigsh`, residuals, count, static response.

python -m benchmarks.structures lattice|plane [--side N] [--modes K] [--free] [--ways default ordered package]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh, splu

import ph_control as phc

Array = NDArray[np.float64]

SIDES = {"lattice": 46, "plane": 1000}
WAYS = ("default", "ordered", "package")
BELOW = 1e-10  # shift of all three, below zero, in units of the largest K_ii / M_ii


def structure(kind: str, side: int, free: bool) -> tuple[Any, Any, Array]:
    """Masses on a lattice or a plane with springs between neighbours, at rest at their edges unless free.

    Sides differ by a few per mille and masses by up to 20 %, so that no natural frequency is repeated exactly.
    """
    sides = [side, side + 1, side + 2] if kind == "lattice" else [side, side + 1]
    K: Any = sparse.csc_array((1, 1))
    for n in sides:
        row = 2.0 * sparse.eye_array(n) - sparse.eye_array(n, k=1) - sparse.eye_array(n, k=-1)
        row = row.tolil()
        if free:
            row[0, 0] = row[n - 1, n - 1] = 1.0
        K = sparse.kronsum(K, row, format="csc")
    n = K.shape[0]
    M = sparse.diags_array(np.random.default_rng(0).uniform(0.9, 1.1, n), format="csc")
    F = np.zeros((n, 2))
    F[n // 2, 0] = F[n // 3, 1] = 1.0
    return M, K, F


def shift(M: Any, K: Any) -> float:
    """Shift below zero that all ways use."""
    return -BELOW * float((K.diagonal() / M.diagonal()).max())


def measured(way: str, kind: str, side: int, modes: int, free: bool) -> dict[str, Any]:
    """Time and memory of one way, in a process of its own, and what its modes are worth."""
    M, K, F = structure(kind, side, free)
    phc.from_second_order(np.eye(30), np.eye(30), np.ones(30), modes=1)  # imports what it needs
    before, start, cpu = peak(), time.perf_counter(), time.process_time()
    if way == "package":
        sys_ = phc.from_second_order(M, K, F, modes=modes, sensors=F.T)
        seconds, cpu, memory = time.perf_counter() - start, time.process_time() - cpu, peak()
        kept = sys_.structural_modes
        squares, shapes = kept.natural_frequencies**2, kept.shapes
        more = {"count": kept.count, "complete": kept.is_complete} | static(M, K, F, sys_, kept)
    else:
        inverse = None
        if way == "ordered":
            lu = splu(
                K - shift(M, K) * M, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )  # fmt: skip
            inverse = LinearOperator(K.shape, matvec=lu.solve, dtype=float)
        squares, shapes = eigsh(K, modes, M=M, sigma=shift(M, K), OPinv=inverse)
        seconds, cpu, memory, more = time.perf_counter() - start, time.process_time() - cpu, peak(), {}
    errors = [
        np.linalg.norm(K @ x - s * (M @ x)) / np.linalg.norm(abs(K) @ np.abs(x))
        for s, x in zip(squares, shapes.T, strict=True)
    ]
    absolute = [np.linalg.norm(K @ x - s * (M @ x)) for s, x in zip(squares, shapes.T, strict=True)]
    found = {
        "n": K.shape[0],
        "modes": len(squares),
        "seconds": seconds,
        "CPU seconds": cpu,
        "GB": memory,
        "GB before": before,
    }
    return found | {"residual": max(errors), "residual, absolute": max(absolute)} | more


def static(M: Any, K: Any, F: Array, system: Any, kept: Any) -> dict[str, float]:
    """Relative error of the compliance between the ports at rest, with residual modes and without."""
    if not kept.natural_frequencies.all():
        return {}
    factor = splu(K, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    x = factor.solve(F)
    x += factor.solve(F - K @ x)
    exact = F.T @ x
    modal = (kept.shapes.T @ F) / kept.natural_frequencies[:, None]
    found = np.real(system(0.0)[2:])
    return {
        "static error": float(np.abs(found - exact).max() / np.abs(exact).max()),
        "static error without residual modes": float(np.abs(modal.T @ modal - exact).max() / np.abs(exact).max()),
    }


def peak() -> float:
    """Largest memory of this process so far, GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure each way in its own process, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=SIDES)
    parser.add_argument("--side", type=int, help="masses along a side (46: 1e5 in a lattice, 1000: 1e6 in a plane)")
    parser.add_argument("--modes", type=int, default=50)
    parser.add_argument("--free", action="store_true", help="a structure with a rigid mode")
    parser.add_argument("--ways", nargs="*", choices=WAYS, default=WAYS)
    parser.add_argument("--here", action="store_true", help="measure in this process")
    given = parser.parse_args(arguments)
    side = given.side or SIDES[given.kind]
    for way in given.ways:
        if given.here:
            print(json.dumps(measured(way, given.kind, side, given.modes, given.free)))
            continue
        command = [sys.executable, "-m", "benchmarks.structures", given.kind, "--here", "--ways", way]
        command += ["--side", str(side), "--modes", str(given.modes)] + ["--free"] * given.free
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            cause = done.stderr.strip().splitlines()[-1:] or f"signal {-done.returncode}"
            print(f"{way:8s} failed: {cause}", flush=True)
            continue
        values = json.loads(done.stdout)
        shown = {key: f"{one:.3g}" if isinstance(one, float) else one for key, one in values.items()}
        print(f"{way:8s} " + ", ".join(f"{key} {one}" for key, one in shown.items()), flush=True)


if __name__ == "__main__":
    main()

"""How many digits frequencies, weights and responses of a dense `Q` have: `python -m benchmarks.digits`.

The reference are eigenvalues and eigenvectors of `J Q` with 50 digits, of the very doubles that the package was given.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import mpmath as mp
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

import ph_control as phc

from .page import write
from .tasks import dense_hamiltonian

Array = NDArray[np.float64]

DIGITS = 50
SEEDS = 3
POINTS = 50  # frequencies at which responses are compared
HEAD = "| dense Q | error of `d` | of `r` | of the response | of the response of `modes` |\n" + 5 * "|---" + "|"


def exact_modes(Q: Array, B: Array) -> tuple[list[mp.mpf], list[mp.mpf]]:
    """Frequencies, ascending, and weights."""
    with mp.workdps(DIGITS):
        n = len(B) // 2
        energy, port = mp.matrix(Q.tolist()), mp.matrix(B.tolist())
        structure = mp.matrix(np.asarray(phc.symplectic_form(n)).tolist())
        values, right = mp.eig(structure * energy)
        # residues r d / 2 of the transfer function at i d
        residues = [c * b for c, b in zip(port.T * energy * right, mp.inverse(right) * port, strict=True)]
        above = sorted((mp.im(value), k) for k, value in enumerate(values) if mp.im(value) > 0)
        return [d for d, _ in above], [2 * mp.re(residues[k]) / d for d, k in above]


def errors(Q: Array, B: Array) -> Array:
    """Largest relative errors of frequencies, weights, the response without modes, and that of the modes."""
    d, r = exact_modes(Q, B)
    w = np.linspace(0.3, 1.2, POINTS) * float(d[-1])
    with mp.workdps(DIGITS):
        truth = [sum(a * b * x / ((a - x) * (a + x)) for a, b in zip(d, r, strict=True)) for x in map(mp.mpf, w)]
    alone = phc.ph(Q, B)
    first, later = (system(1j * w).imag for system in (phc.ph(Q, B), phc.ph(phc.ph(Q, B).modes)))
    pairs = ((alone.d, d), (alone.r, r), (first, truth), (later, truth))
    return np.array([_relative(found, exact) for found, exact in pairs])


def _relative(found: Array, truth: Sequence[mp.mpf]) -> float:
    with mp.workdps(DIGITS):
        return max(float(abs(mp.mpf(float(a)) - b) / abs(b)) for a, b in zip(found, truth, strict=True))


def nearly_repeated(gap: float, seed: int) -> tuple[Array, Array]:
    """Six modes of condition about 30, the lowest two of them closer than the others."""
    rng = np.random.default_rng(seed)
    d = np.array([1.0, 1.0 + gap, 1.5, 2.0, 2.5, 3.0])
    X = rng.standard_normal((12, 12))
    S = expm(0.15 * phc.symplectic_form(6) @ (X + X.T))
    Q = (S.T * np.concatenate([d, d])) @ S
    return 0.5 * (Q + Q.T), rng.standard_normal(12)


def row(name: str, make: Callable[[int], tuple[Array, Array]]) -> str:
    """A row of the table: the worst of some seeds."""
    worst = np.max([errors(*make(seed)) for seed in range(SEEDS)], axis=0)
    return " | ".join([f"| {name}", *(f"{error:.0e}" for error in worst)]) + " |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and put it into a page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.digits", description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[4, 12, 24], help="numbers of modes")
    parser.add_argument(
        "--write", type=Path, metavar="PAGE", help="page of which the table is to replace the one there"
    )
    options = parser.parse_args(arguments)
    rows = [HEAD]
    for n in options.sizes:
        for condition in (1e2, 1e6, 1e10):
            rows.append(
                row(f"n = {n}, condition {condition:.0e}", lambda seed, n=n, c=condition: dense_hamiltonian(n, c, seed))
            )
    for gap in (1e-2, 1e-4, 1e-6, 1e-8):
        rows.append(row(f"n = 6, two frequencies {gap:.0e} apart", lambda seed, gap=gap: nearly_repeated(gap, seed)))
    print("\n".join(rows))
    if options.write is not None:
        write(options.write, "digits", ["\n".join(rows)])


if __name__ == "__main__":
    main()

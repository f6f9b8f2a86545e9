"""From passive systems to port-Hamiltonian form: the same systems by several packages, one run.

    python -m benchmarks.passive_peers [--count N] [--states N ...] [--method TEXT ...] [--json FILE]

A form counts if its transfer function is within 1e-10 of the largest response, its `W = [[R, P], [P^T, S]]` has no
eigenvalue below -1e-12 of its norm, and its energy is positive.  `epsilon` adds to `D` the least power of ten with
which the Riccati equation of `D + D^T > 0` can be solved, as published codes for passive systems do; `SDP` is the
inequality itself, with the trace of the energy least.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

import ph_control as phc

from .montecarlo import environment

Array = NDArray[np.float64]
Form = tuple[Array, Array, Array, Array, Array, Array, Array]  # Q, J, R, B, P, S, N

TRANSFER, LOSSES = 1e-10, 1e-12
KINDS = ("chain", "chain, one dashpot", "D > 0", "D of rank 1", "undamped mode")


@dataclass(frozen=True)
class Trial:
    """What one method made of one system; a failure has no numbers."""

    method: str
    kind: str
    states: int
    transfer: float
    losses: float
    energy: float
    seconds: float
    failure: str = ""

    @property
    def counts(self) -> bool:
        """Whether it is a port-Hamiltonian form of the system."""
        return not self.failure and self.transfer <= TRANSFER and self.losses >= -LOSSES and self.energy > 0


def system(kind: str, states: int, seed: int) -> ct.StateSpace:
    """Passive system of two ports, in random orthogonal states."""
    rng = np.random.default_rng([KINDS.index(kind), states, seed])
    D = np.zeros((2, 2))
    if kind.startswith("D"):
        loss, skew = rng.normal(size=(states, states // 2)), rng.normal(size=(states, states))
        root = rng.normal(size=(2, 2 if kind == "D > 0" else 1))
        A, B, D = skew - skew.T - 0.1 * loss @ loss.T, rng.normal(size=(states, 2)), root @ root.T
    else:
        n = states // 2
        bond = np.eye(n) - np.eye(n, k=-1)
        root = np.diag(np.sqrt(rng.uniform(0.5, 2.0, n))) @ bond
        dashpots = rng.uniform(0.05, 0.5, n) * (1.0 if kind == "chain" else np.eye(n)[0])
        A = np.block([[np.zeros((n, n)), root], [-root.T, -np.diag(dashpots)]])
        if kind == "undamped mode":
            A[[0, n]], A[:, [0, n]] = 0, 0
            A[0, n], A[n, 0] = 1.0, -1.0
            A[n + 1 :, n + 1 :] -= 0.1 * np.eye(n - 1)
        B = np.vstack([np.zeros((n, 2)), np.eye(n)[:, :2]])
    T = np.linalg.qr(rng.normal(size=(states, states)))[0]
    return ct.ss(T @ A @ T.T, T @ B, B.T @ T.T, D)


# --- methods ------------------------------------------------------------------------------------------------------


def of_storage(A: Array, B: Array, C: Array, D: Array, X: Array) -> Form:
    """Port-Hamiltonian form by the storage `x^T X x / 2`."""
    K, G = np.linalg.solve(X, A.T).T, np.linalg.solve(X, C.T)
    return X, 0.5 * (K - K.T), -0.5 * (K + K.T), 0.5 * (G + B), 0.5 * (G - B), 0.5 * (D + D.T), 0.5 * (D - D.T)


def ours(A: Array, B: Array, C: Array, D: Array) -> Form:
    form: Any = phc.ph(ct.ss(A, B, C, D), storage="mean")
    return form.Q, form.J, form.R, form.G, form.P, form.S, form.N


def by_epsilon(A: Array, B: Array, C: Array, D: Array) -> Form:
    size = np.linalg.norm(C @ np.linalg.solve(A - np.eye(len(A)) * np.linalg.norm(A), B)) + np.linalg.norm(D)
    for power in range(-14, 0):
        through = D + 10.0**power * size * np.eye(len(D))
        try:
            X = solve_continuous_are(A, B, np.zeros_like(A), -(through + through.T), s=-C.T)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.linalg.eigvalsh(0.5 * (X + X.T))[0] > 0:
            return of_storage(A, B, C, through, 0.5 * (X + X.T))
    raise ArithmeticError("no epsilon was enough")


def by_pymor(A: Array, B: Array, C: Array, D: Array) -> Form:
    from pymor.core.logger import set_log_levels
    from pymor.models.iosys import LTIModel, PHLTIModel

    set_log_levels({"pymor": "ERROR"})
    X = LTIModel.from_matrices(A, B, C, D).gramian("pr_o_dense")
    model = PHLTIModel.from_passive_LTIModel(LTIModel.from_matrices(A, B, C, D))
    J, R, G, P, S, N, _, Q = model.to_matrices(format="dense")
    m = len(D)
    none = np.zeros((m, m))
    return (
        X if Q is None else Q, J, R, G, np.zeros_like(G) if P is None else P, none if S is None else S,
        none if N is None else N,
    )  # fmt: skip


def by_sdp(A: Array, B: Array, C: Array, D: Array) -> Form:
    import cvxpy as cp

    X = cp.Variable((len(A), len(A)), symmetric=True)
    W = cp.bmat([[-(A.T @ X + X @ A), C.T - X @ B], [C - B.T @ X, D + D.T]])
    problem = cp.Problem(cp.Minimize(cp.trace(X)), [0.5 * (W + W.T) >> 0, X >> 0])
    problem.solve(solver="CLARABEL")
    if X.value is None:
        raise ArithmeticError(problem.status)
    return of_storage(A, B, C, D, 0.5 * (X.value + X.value.T))


METHODS: dict[str, Callable[..., Form]] = {
    "ph_control": ours, "pyMOR": by_pymor, "epsilon in D": by_epsilon, "SDP (cvxpy, Clarabel)": by_sdp
}  # fmt: skip


# --- judgement ----------------------------------------------------------------------------------------------------


def response(A: Array, B: Array, C: Array, D: Array, omega: Array) -> Any:
    """Frequency response, shape (N, p, m)."""
    inputs = np.broadcast_to(B, (len(omega), *B.shape))
    return C @ np.linalg.solve(1j * omega[:, None, None] * np.eye(len(A)) - A, inputs) + D


def attempt(method: str, kind: str, states: int, seed: int) -> Trial:
    """One conversion, timed, and held against the matrices."""
    given = system(kind, states, seed)
    A, B, C, D = (np.array(getattr(given, name), float) for name in "ABCD")
    nothing = np.nan, np.nan, np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # failures show in the numbers
        start = perf_counter()
        try:
            Q, J, R, G, P, S, N = METHODS[method](A, B, C, D)
        except ImportError:
            return Trial(method, kind, states, *nothing, np.nan, "not installed")
        except Exception as reason:
            return Trial(method, kind, states, *nothing, perf_counter() - start, f"{type(reason).__name__}: {reason}")
        seconds = perf_counter() - start
    omega = np.geomspace(1e-2, 1e2, 200)
    wanted = response(A, B, C, D, omega)
    got = response((J - R) @ Q, G - P, (G + P).T @ Q, S + N, omega)
    W = np.block([[R, P], [P.T, S]])
    size = np.linalg.norm(W, 2) or 1.0
    return Trial(
        method, kind, states, float(np.abs(got - wanted).max() / np.abs(wanted).max()),
        float(np.linalg.eigvalsh(W)[0] / size), float(np.linalg.eigvalsh(Q)[0] / np.linalg.norm(Q, 2)), seconds,
    )  # fmt: skip


def table(trials: Sequence[Trial]) -> list[str]:
    """One row a method and kind: how many count, worst transfer and losses of those that gave anything, median time."""
    lines = [f"{'method':<24}{'system':<20}{'states':>7}{'right':>8}{'transfer':>11}{'losses':>11}{'time':>10}"]
    for key in dict.fromkeys((one.kind, one.states, one.method) for one in trials):
        kind, states, method = key
        of = [one for one in trials if (one.kind, one.states, one.method) == key]
        given = [one for one in of if not one.failure]
        numbers = f"{'-':>11}{'-':>11}{'-':>10}"
        if given:
            seconds = float(np.median([one.seconds for one in given]))
            numbers = (
                f"{max(one.transfer for one in given):>11.1e}{min(one.losses for one in given):>11.1e}"
                f"{1e3 * seconds:>7.0f} ms"
            )
        right = f"{sum(one.counts for one in of)}/{len(of)}"
        reason = "" if given else "  " + of[0].failure.split("\n")[0][:60]
        lines.append(f"{method:<24}{kind:<20}{states:>7}{right:>8}{numbers}{reason}")
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all methods on all systems and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.passive_peers", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=5, help="systems of each kind (default: 5)")
    parser.add_argument("--states", type=int, nargs="+", default=[6, 20])
    parser.add_argument("--method", nargs="+", metavar="TEXT", help="only the methods with one of these in their names")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    chosen = [name for name in METHODS if options.method is None or any(text in name for text in options.method)]
    print(f"passive_peers: {environment(1)}", flush=True)
    for method in chosen:
        attempt(method, "D > 0", 4, 0)  # imports are not what is timed
    trials = [
        attempt(method, kind, states, seed)
        for kind in KINDS for states in options.states for method in chosen for seed in range(options.count)
    ]  # fmt: skip
    print("\n".join(table(trials)), flush=True)
    if options.json:
        options.json.write_text(json.dumps([asdict(one) for one in trials], indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()

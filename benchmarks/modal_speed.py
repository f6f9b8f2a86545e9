"""Time and memory of fits of damped modes, each in a process of its own.

python -m benchmarks.modal_speed [NAME ...] [--rounds N] [--threads N]

Seconds of the clock and of the processor of the first call, imports apart, and the peak of memory: with the order
given and free residues, and by the default call, which chooses order and structure.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from time import perf_counter, process_time
from typing import Any

import numpy as np

import ph_control as phc

from .cold import MEGABYTE, peak
from .modal_convergence import Modal, drawn, drawn_poles
from .montecarlo import environment

SNR = 20.0  # dB
CASES = {
    "2": Modal(2, 400, SNR, 1e-3, 2e-2),
    "5": Modal(5, 2000, SNR, 1e-3, 2e-2),
    "5-20000": Modal(5, 20_000, SNR, 1e-3, 2e-2),
    "5-200000": Modal(5, 200_000, SNR, 1e-3, 2e-2),
    "10-1000000": Modal(10, 1_000_000, SNR, 1e-3, 1e-2),
    "20-2x7": Modal(20, 8500, SNR, 1e-3, 1e-2, 2, 7),
    "20-2x14": Modal(20, 8500, SNR, 1e-3, 1e-2, 2, 14),
    "20-2x28": Modal(20, 8500, SNR, 1e-3, 1e-2, 2, 28),
    "lines-9": Modal(6, 50_000, SNR, 1e-3, 1e-2, 1, 9),
    "hammer": Modal(5, 2000, SNR, 1e-3, 1e-2, 9, 2),
}
ALLOWED = {"5": (0.1, np.inf), "20-2x28": (10.0, 1000.0), "10-1000000": (10.0, np.inf), "lines-9": (5.0, np.inf)}


def data_of(name: str) -> Any:
    """Recordings, a response matrix of so many lines, or one recording for each position of a hammer."""
    case = CASES[name]
    if name.startswith("lines"):
        return response(case)
    if name != "hammer":
        return drawn(case, 0)[1:]
    p, rng = drawn_poles(case, np.random.default_rng(0)), np.random.default_rng(1)
    shapes, t = rng.standard_normal((case.n, case.outputs + case.inputs)), np.arange(case.samples)
    found = []
    for k in range(case.inputs):
        u = np.zeros((case.inputs, case.samples))
        u[k, 5:10] = [0.2, 0.8, 1.0, 0.8, 0.2]
        motion = np.array([np.convolve(u[k], np.exp(one * t))[: case.samples].real for one in p])
        y = (shapes[:, : case.outputs] * shapes[:, case.outputs + k, None]).T @ motion
        found.append((u, y + 0.01 * rng.standard_normal(y.shape)))
    return found


def response(case: Modal) -> Any:
    """Frequency responses with noise of one level in each entry."""
    import control as ct

    rng = np.random.default_rng(0)
    p, omega = drawn_poles(case, rng), np.linspace(0.01, 3.1, case.samples)
    rho = (rng.standard_normal((case.n, case.outputs)) + 1j * rng.standard_normal((case.n, case.outputs))) * -p.real[
        :, None
    ]
    clean = sum(r[:, None] / (1j * omega - one) + r.conj()[:, None] / (1j * omega - one.conj())
                for one, r in zip(p, rho, strict=True))  # fmt: skip
    noise = 10 ** (-case.snr / 20) * np.sqrt(np.mean(np.abs(clean) ** 2, axis=1, keepdims=True) / 2)
    parts = rng.standard_normal((2, *clean.shape))
    return ct.frd((clean + noise * (parts[0] + 1j * parts[1]))[:, None], omega)


def measured(name: str, default: bool) -> dict[str, Any]:
    """The first fit of this process."""
    data = data_of(name)
    case, step = CASES[name], {} if name.startswith("lines") else {"dt": 1.0}
    pem = phc.pem  # imports what it needs
    before, start, clock = peak(), process_time(), perf_counter()
    found = pem(data, **step) if default else pem(data, case.n, structure="free", quantity="free", **step)
    return {
        "clock": perf_counter() - clock, "seconds": process_time() - start, "before": before, "peak": peak(),
        "order": found.order, "structure": found.structure,
    }  # fmt: skip


def in_a_new_process(name: str, default: bool, threads: int) -> dict[str, Any]:
    """What `measured` finds there."""
    variables = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), str(threads))
    command = [sys.executable, "-m", "benchmarks.modal_speed", name, "--child", "default" if default else "given"]
    done = subprocess.run(command, env=os.environ | variables, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases and print a row of each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.modal_speed", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)} (default: all)")
    parser.add_argument("--rounds", type=int, default=3, help="processes of each, of which the best counts")
    parser.add_argument("--threads", type=int, default=1, help="of BLAS, where the package does not set them")
    parser.add_argument("--child", choices=("given", "default"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in CASES]
    if unknown:
        parser.error(f"{unknown[0]} is no case; they are {', '.join(CASES)}")
    if options.child:
        print(json.dumps(measured(options.names[0], options.child == "default")))
        return
    print(f"modal_speed: {environment(1)}, BLAS with {options.threads} threads\n")
    print("| case | modes | samples | inputs x outputs | call | answer | time | of the processor | memory | allowed |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in options.names or CASES:
        case = CASES[name]
        for default in (False, True):
            runs = [in_a_new_process(name, default, options.threads) for _ in range(options.rounds)]
            best = min(runs, key=lambda one: one["seconds"])
            memory = min(one["peak"] - one["before"] for one in runs) / MEGABYTE
            seconds, most = ALLOWED.get(name, (np.inf, np.inf))
            kept = "" if np.isinf(seconds) else f"{seconds:g} s: {'yes' if best['seconds'] < seconds else 'NO'}"
            kept += "" if np.isinf(most) else f", {most:g} MB: {'yes' if memory < most else 'NO'}"
            print(
                f"| {name} | {case.n} | {case.samples} | {case.inputs} x {case.outputs} | "
                f"{'default' if default else 'order given, free'} | {best['order']}, {best['structure']} | "
                f"{best['clock']:.3g} s | {best['seconds']:.3g} s | {memory:.0f} MB | {kept} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

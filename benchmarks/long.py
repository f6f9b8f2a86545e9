"""Long recordings on the disk: time, memory and errors of `pem` by the number of samples, each in a process of its own.

python -m benchmarks.long [--samples 1e6 1e7 1e8] [--outputs P] [--rest] [--folder DIR]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from control import tf
from scipy.signal import cont2discrete, lfilter

import ph_control as phc

STEP, BLOCK = 0.1, 1_000_000
D, KAPPA, ZETA = np.array([1.0, 2.3, 4.1]), np.array([1.0, 1.61, 2.05]), 0.01
SHAPES = np.array([[1.0, 1.0, 1.0], [1.0, -0.5, 2.0], [0.5, -1.0, 0.3]])
QUIET = 6  # samples before a hammer hits


def write(folder: Path, samples: int, outputs: int, rest: bool) -> None:
    """Input and outputs of three damped modes, made block by block, with a fifth of noise."""
    rng = np.random.default_rng(1)
    shape = (samples,) if outputs == 1 else (outputs, samples)
    u = np.lib.format.open_memmap(folder / "u.npy", "w+", float, (samples,))
    y = np.lib.format.open_memmap(folder / "y.npy", "w+", float, shape)
    filters = []
    for d, kappa in zip(D, KAPPA, strict=True):
        plant = tf([kappa, 0], [1, 2 * ZETA * d, d * d])
        numerator, denominator, _ = cont2discrete((plant.num[0][0], plant.den[0][0]), STEP, "zoh")
        filters.append([numerator.ravel(), denominator, np.zeros(2)])
    for first in range(0, samples, BLOCK):
        count = min(BLOCK, samples - first)
        force, seen = rng.standard_normal(count), 0.5 * rng.standard_normal((outputs, count))
        if rest and not first:
            force[:QUIET], seen[:, :QUIET] = 0.0, 0.01 * seen[:, :QUIET]
        for k, one in enumerate(filters):
            motion, one[2] = lfilter(one[0], one[1], force, zi=one[2])
            seen += SHAPES[:outputs, k : k + 1] * motion
        u[first : first + count], y[..., first : first + count] = force, seen if outputs > 1 else seen[0]


def own_memory(kind: str = "RssAnon") -> int:
    """Megabytes of this process that no file holds, or of another kind."""
    return int(Path("/proc/self/status").read_text().split(kind + ":")[1].split()[0]) // 1024


def fit(folder: Path) -> None:
    """Fit the record in a folder, and print what that took."""
    u, y = (np.load(folder / f"{name}.npy", mmap_mode="r") for name in "uy")
    peak = [0]

    def watch() -> None:
        while True:
            peak[0] = max(peak[0], own_memory())
            time.sleep(0.02)

    threading.Thread(target=watch, daemon=True).start()
    wall, own = time.perf_counter(), time.process_time()
    found = phc.pem((u, y), dt=STEP)
    wall, own = time.perf_counter() - wall, time.process_time() - own
    off = np.abs(found.natural_frequencies - D) / found.stderr["natural_frequencies"]
    print(
        f"{u.size:.0e} samples, {y.size // u.size} outputs: {own:.1f} s of processor, {wall:.1f} s; at most {peak[0]} "
        f"MB of its own, {own_memory('VmHWM')} MB with the pages of the files; {found.structure}, frequencies off by "
        f"at most {off.max():.1f} standard errors", flush=True,
    )  # fmt: skip


def main() -> None:
    """Make records and fit them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--samples", type=float, nargs="+", default=[1e6, 1e7, 1e8])
    parser.add_argument("--outputs", type=int, choices=range(1, len(SHAPES) + 1), default=1)
    parser.add_argument("--rest", action="store_true", help="nothing acts or moves in the first samples")
    parser.add_argument("--folder", help="for the files, 16 bytes a sample")
    options = parser.parse_args()
    for samples in options.samples:
        with tempfile.TemporaryDirectory(dir=options.folder) as name:
            write(Path(name), int(samples), options.outputs, options.rest)
            code = f"from pathlib import Path; from benchmarks.long import fit; fit(Path({name!r}))"
            subprocess.run([sys.executable, "-c", code], check=True)


if __name__ == "__main__":
    main()

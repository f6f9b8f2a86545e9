"""Time and memory of one fit in a process of its own, order known: nothing is warm, and the peak is that of the fit.

python -m benchmarks.cold ORDER SAMPLES
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import ph_control as phc

from .recordings import Configuration, Recording, random_recording

MEGABYTE = 1e6


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what `measure` finds, or, as its process, fit the recording of a file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cold", description=__doc__.splitlines()[0])
    parser.add_argument("order", type=int)
    parser.add_argument("samples", type=int, nargs="?")
    parser.add_argument("--recording", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.recording:
        print(json.dumps(_fit(options.recording, options.order)))
    else:
        found = measure(options.order, options.samples)
        print(
            f"n={options.order}, T={options.samples}: {found['seconds']:.3g} s, peak {found['peak'] / MEGABYTE:.0f} MB "
            f"({found['before'] / MEGABYTE:.0f} MB before the fit), frequencies to {found['error']:.1e}"
        )


def recording_of(order: int, samples: int) -> Recording:
    """White-noise recording at 20 dB, closest modes 3 bins apart."""
    return random_recording(Configuration(order, samples, 20, 3), np.random.default_rng([order, samples]))


def measure(order: int, samples: int) -> dict[str, Any]:
    """Seconds, peak memory and memory before (bytes) of one fit, and the largest relative error of a frequency."""
    recording = recording_of(order, samples)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "recording.npy")
        np.save(file, [recording.u, recording.y])
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.cold", str(order), "--recording", str(file)],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)},
            stdout=subprocess.PIPE, text=True, check=True,
        )  # fmt: skip
    found: dict[str, Any] = json.loads(done.stdout)
    found["error"] = float(np.max(np.abs(np.array(found.pop("d")) / recording.d - 1)))
    return found


def _fit(file: Path, order: int) -> dict[str, Any]:
    u, y = np.load(file, mmap_mode="r")
    before = _peak()
    start = perf_counter()
    result = phc.pem((u, y), order=order, dt=1.0)
    return {"seconds": perf_counter() - start, "before": before, "peak": _peak(), "d": result.d.tolist()}


def _peak() -> int:
    """Largest resident memory so far, bytes.

    That of the system call can be the one of the process that started this one; the kernel's own count is not.
    """
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024
    # kilobytes, but bytes on macOS
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


if __name__ == "__main__":
    main()

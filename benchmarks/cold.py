"""Time and memory in a process of its own, where nothing is warm and the peak is that of the work.

python -m benchmarks.cold ORDER SAMPLES [--work fit|step]

The work is one fit, order known, or one step of variable projection at the true frequencies: the best residues and
free motions, the residual, and its Jacobian by the poles reduced to a triangle, as every iteration of a fit does.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ph_control import pem
from ph_control.identification.regression.free import FreeProjection
from ph_control.identification.regression.sections import Sections
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.modal.discretization import Hold

from .recordings import Configuration, Recording, random_recording

Array = NDArray[np.float64]

MEGABYTE = 1e6


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what `measure` finds, or, as its process, fit the recording of a file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cold", description=__doc__.splitlines()[0])
    parser.add_argument("order", type=int)
    parser.add_argument("samples", type=int, nargs="?")
    parser.add_argument("--work", choices=list(WORKS), default="fit")
    parser.add_argument("--recording", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.recording:
        print(json.dumps(_measured(WORKS[options.work], options.recording)))
    else:
        found = measure(options.order, options.samples, options.work)
        print(
            f"{options.work}, n={options.order}, T={options.samples}: {found['seconds']:.3g} s, "
            f"peak {found['peak'] / MEGABYTE:.0f} MB ({found['before'] / MEGABYTE:.0f} MB before), "
            f"frequencies to {found['error']:.1e}"
        )


def recording_of(order: int, samples: int) -> Recording:
    """White-noise recording at 20 dB, closest modes 3 bins apart."""
    return random_recording(Configuration(order, samples, 20, 3), np.random.default_rng([order, samples]))


def measure(order: int, samples: int, work: str = "fit") -> dict[str, Any]:
    """Seconds, peak memory and memory before (bytes) of the work, and the largest relative error of a frequency."""
    recording = recording_of(order, samples)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("u", "y", "d"):
            np.save(Path(folder, name), getattr(recording, name))
        found: dict[str, Any] = json.loads(
            _in_a_new_process("-m", "benchmarks.cold", str(order), "--work", work, "--recording", folder)
        )
    found["error"] = float(np.max(np.abs(np.array(found.pop("d")) / recording.d - 1)))
    return found


def imported(before: str, code: str, rounds: int = 5) -> float:
    """Seconds of the processor that code takes in a new process after what comes before, the best of several."""
    timed = f"{before}\nfrom time import process_time\nbegun = process_time()\n{code}\nprint(process_time() - begun)"
    return min(float(_in_a_new_process("-c", timed)) for _ in range(rounds))


def _in_a_new_process(*arguments: str) -> str:
    path = os.pathsep.join(path or os.getcwd() for path in sys.path)
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, *arguments], env=environment, stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def _measured(work: Callable[[Array, Array, Array], Array], folder: Path) -> dict[str, Any]:
    u, y, d = (np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("u", "y", "d"))
    before = peak()
    start = process_time()
    found = work(u, y, d)
    return {"seconds": process_time() - start, "before": before, "peak": peak(), "d": found.tolist()}


def _fit(u: Array, y: Array, d: Array) -> Array:
    return pem((u, y), order=len(d), dt=1.0).d


def _step(u: Array, y: Array, d: Array) -> Array:
    rows = FreeRecord(np.atleast_2d(u), np.atleast_2d(y), np.ones(len(y), bool), Hold(1.0))
    here = FreeProjection([rows], 1j * d)
    assert here.loss > 0
    moved = Sections.from_coordinates(here.x - np.linalg.solve(here.gram, here.gradient))
    return np.asarray(np.abs(moved.p))


WORKS: dict[str, Callable[[Array, Array, Array], Array]] = {"fit": _fit, "step": _step}


def peak() -> int:
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

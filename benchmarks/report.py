"""One table of what the package and others need for the same task, in one run: `python -m benchmarks.report`.

All contenders of a task take turns in one process; a time is the best of several, in seconds of the processor.  Only
the ratios within a row mean anything: machines differ, and on a shared one so do hours.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
import tracemalloc
import warnings
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402  # it reads the number of threads once

from benchmarks.tasks import FAMILIES, OURS, Task, tasks  # noqa: E402

PACKAGES = ("numpy", "scipy", "control", "slycot", "thewalrus", "pymor")
HEAD = "| task | size | ours | peak | others: time, ratio, error | our error | needed |\n|---|---|---|---|---|---|---|"

_SHORT = 0.02  # seconds: what takes less is repeated until it does


def race(runs: dict[str, Callable[[], Any]], rounds: int = 4, budget: float = 5.0) -> dict[str, float]:
    """Best time of each, taking turns; at least two rounds, no more than fit the budget."""
    best = dict.fromkeys(runs, np.inf)
    begun = time.perf_counter()
    for k in range(rounds):
        for name, run in runs.items():
            best[name] = min(best[name], _seconds(run))
        if k and time.perf_counter() - begun > budget:
            break
    return best


def _seconds(run: Callable[[], Any]) -> float:
    begun = time.process_time()
    run()
    taken = time.process_time() - begun
    if taken >= _SHORT:
        return taken
    times = int(_SHORT / max(taken, 1e-6)) + 1
    begun = time.process_time()
    for _ in range(times):
        run()
    return (time.process_time() - begun) / times


def peak(run: Callable[[], Any]) -> float:
    """Megabytes that a call holds at most beyond what was there before."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def measure(task: Task) -> dict[str, Any]:
    """Times, errors and peak memory of a task."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of others, about ill-conditioned systems
        errors = {name: task.error(run()) for name, run in task.runs.items()} if task.error else {}
        memory = peak(task.runs[OURS])
        seconds = race(task.runs)
    return {"seconds": seconds, "errors": errors, "peak": memory}


def row(task: Task, found: dict[str, Any]) -> str:
    """A row of the table."""
    ours, errors = found["seconds"][OURS], found["errors"]
    others, verdict = [], []
    for name, seconds in found["seconds"].items():
        if name == OURS:
            continue
        ratio = seconds / ours
        error = f", {errors[name]:.1e}" if np.isfinite(errors.get(name, np.nan)) else ""
        others.append(f"{name} {_time(seconds)}, {ratio:.3g}x{error}")
        if name in task.needed:
            verdict.append(f"{task.needed[name]:g}x {'yes' if ratio >= task.needed[name] else 'NO'}")
    error = f"{errors[OURS]:.1e}" if np.isfinite(errors.get(OURS, np.nan)) else ""
    cells = (task.name, task.size, _time(ours), f"{found['peak']:.1f} MB", "; ".join(others), error, ", ".join(verdict))
    return "| " + " | ".join(cells) + " |"


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def versions() -> str:
    """Where and with what a report was made."""
    found = []
    for name in PACKAGES:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            found.append(f"{name} not installed")
    threads = os.environ["OPENBLAS_NUM_THREADS"]
    machine = f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores"
    return f"{machine}, {threads} BLAS thread(s); {', '.join(found)}; load {os.getloadavg()[0]:.1f}"


def slope(sizes: list[float], seconds: list[float]) -> float:
    """Power of the size with which time grows, by the larger half of the sizes."""
    half = max(2, len(sizes) // 2 + 1)
    return float(np.polyfit(np.log(sizes[-half:]), np.log(seconds[-half:]), 1)[0])


def draw(curves: dict[str, dict[str, list[tuple[float, float]]]], folder: Path) -> list[Path]:
    """One picture a family: time against size for each contender."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    made = []
    for family, contenders in curves.items():
        if max(len({size for size, _ in points}) for points in contenders.values()) < 3:
            continue
        figure, axes = plt.subplots(figsize=(5.5, 4), layout="constrained")
        for name, points in contenders.items():
            sizes, seconds = (list(part) for part in zip(*sorted(points), strict=True))
            power = f" (grows as size^{slope(sizes, seconds):.1f})" if len(set(sizes)) > 2 else ""
            axes.loglog(sizes, seconds, "o-", label=name + power)
        axes.set(xlabel="number of frequencies" if family == "points" else "modes n", ylabel="time (s)", title=family)
        axes.grid(True, which="both", alpha=0.3)
        axes.legend(fontsize=8)
        made.append(folder / f"performance_{family}.png")
        figure.savefig(made[-1], dpi=100)
        plt.close(figure)
    return made


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.report", description=__doc__)
    parser.add_argument("--tasks", nargs="+", choices=list(FAMILIES), help="families of tasks; default all")
    parser.add_argument("--largest", type=int, help="leave out systems of more modes than this")
    parser.add_argument("--pictures", type=Path, help="folder for the scaling plots; default none")
    options = parser.parse_args(argv)
    print(versions(), HEAD, sep="\n\n", flush=True)
    curves: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for family, task in tasks(options.tasks, options.largest):
        found = measure(task)
        print(row(task, found), flush=True)
        for name, seconds in found["seconds"].items():
            curves.setdefault(family, {}).setdefault(name, []).append((task.growth, seconds))
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
        curves.pop("simulation", None)
        for path in draw(curves, options.pictures):
            print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""One table of what the package and others need for the same task, in one run: `python -m benchmarks.report`.

All contenders of a task take turns in one process; a time is the best of several, in seconds of the processor.  What
takes seconds runs once.  Only the ratios within a row mean anything: machines differ, and on a shared one so do hours.
"""

from __future__ import annotations

import argparse
import gc
import os
import platform
import sys
import time
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.page import write
from benchmarks.tasks import FAMILIES, OURS, Task, tasks

PACKAGES = ("numpy", "scipy", "control", "slycot", "thewalrus", "pymor")
HEAD = "| task | size | ours | peak | our error | others: time, ratio, peak, error | needed |\n" + 7 * "|---" + "|"
GROWTH_HEAD = "| plot | growth of ours | growth of others |\n|---|---|---|"

_SHORT = 0.02  # seconds: what takes less is repeated until it does
_LONG = 1.5  # what takes more runs once
_TOO_LONG = 15.0  # what takes more does not run again for its memory


@dataclass
class Found:
    """Seconds, errors and peak memory (bytes beyond what was there before) of each contender."""

    seconds: dict[str, float] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    peaks: dict[str, float] = field(default_factory=dict)


# --- measuring ----------------------------------------------------------------------------------------------------


def measure(task: Task) -> Found:
    """Run every contender of a task for its error, its time and its memory."""
    found, short = Found(), {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of others, about ill-conditioned systems
        for name, run in task.runs.items():
            begun = time.process_time()
            result = run()
            found.seconds[name] = time.process_time() - begun
            found.errors[name] = task.error(result) if task.error else np.nan
            if task.apart:
                found.seconds[name], found.peaks[name] = result
            elif found.seconds[name] <= _LONG:
                short[name] = run
            del result
            if not task.apart and found.seconds[name] <= _TOO_LONG:
                found.peaks[name] = peak(run)
        for name, seconds in race(short).items():
            found.seconds[name] = min(found.seconds[name], seconds)
    return found


def race(runs: dict[str, Callable[[], Any]], rounds: int = 4, budget: float = 3.0) -> dict[str, float]:
    """Best time of each, taking turns; no more rounds than fit the budget."""
    best = dict.fromkeys(runs, np.inf)
    begun = time.perf_counter()
    for _ in range(rounds):
        for name, run in runs.items():
            best[name] = min(best[name], _seconds(run))
        if time.perf_counter() - begun > budget:
            break
    return best


def _seconds(run: Callable[[], Any]) -> float:
    gc.collect()
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
    """Bytes that a call holds at most beyond what was there before."""
    tracemalloc.start()
    try:
        run()
        return float(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()


# --- the table ----------------------------------------------------------------------------------------------------


def row(task: Task, found: Found) -> str:
    """A row of the table."""
    ours = found.seconds[OURS]
    others = [
        f"{name} {_time(seconds)}, {seconds / ours:.3g}x{_memory(found, name, ', ')}{_error(found, name, ', ')}"
        for name, seconds in found.seconds.items()
        if name != OURS
    ]
    cells = (task.name, task.size, _time(ours), _memory(found, OURS), _error(found, OURS), "; ".join(others))
    return "| " + " | ".join([*cells, ", ".join(verdicts(task, found))]) + " |"


def verdicts(task: Task, found: Found) -> list[str]:
    """What a task needs, each with yes or NO: ratios to others, and limits of our own figures."""
    ours = found.seconds[OURS]
    judged = [
        (f"{needed:g}x {name}", found.seconds[name] >= needed * ours)
        for name, needed in task.needed.items()
        if name in found.seconds
    ]
    figures = {"seconds": ours, "megabytes": found.peaks.get(OURS, np.nan) / 1e6, "error": found.errors[OURS]}
    units = {"seconds": "{:g} s", "megabytes": "{:g} MB", "error": "error {:.0e}"}
    judged += [(units[which].format(limit), figures[which] <= limit) for which, limit in task.limits.items()]
    return [f"{what}: {'yes' if met else 'NO'}" for what, met in judged]


def _time(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"


def _memory(found: Found, name: str, before: str = "") -> str:
    held = found.peaks.get(name, np.nan)
    if not np.isfinite(held):
        return ""
    return f"{before}{held / 1e6:.3g} MB" if held >= 999.5e3 else f"{before}{held / 1e3:.3g} kB"


def _error(found: Found, name: str, before: str = "") -> str:
    return f"{before}{found.errors[name]:.1e}" if np.isfinite(found.errors[name]) else ""


def versions() -> str:
    """Where and with what a report was made."""
    found = []
    for name in PACKAGES:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            found.append(f"{name} not installed")
    blas = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith("OPENBLAS_")]
    machine = f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores"
    return f"{machine}; {', '.join(found)}; {', '.join(blas)}; load {os.getloadavg()[0]:.1f}"


# --- growth -------------------------------------------------------------------------------------------------------

Curves = dict[str, dict[str, list[tuple[float, float]]]]  # family: contender: size and seconds


def slope(points: list[tuple[float, float]]) -> float:
    """Power of the size with which time grows, by the larger half of the sizes."""
    sizes, seconds = np.log(sorted(points)[-max(2, len(points) // 2 + 1) :]).T
    # a decimal is what it is worth, and 0 has no sign
    return float(np.round(np.polyfit(sizes, seconds, 1)[0], 1)) + 0.0


def drawn(curves: Curves) -> Curves:
    """What there is a picture of: the families that have a title, and the contenders with three sizes or more."""
    kept = {
        family: {name: sorted(points) for name, points in contenders.items() if len(points) > 2}
        for family, contenders in curves.items()
        if FAMILIES[family].title
    }
    return {family: contenders for family, contenders in kept.items() if OURS in contenders}


def powers(family: str, contenders: dict[str, list[tuple[float, float]]]) -> dict[str, str]:
    """The power of each contender, as `n^1.2`."""
    size = FAMILIES[family].axis.split()[-1]
    return {name: f"{size}^{slope(points):.1f}" for name, points in contenders.items()}


def growth(curves: Curves) -> str:
    """Table of the measured powers."""
    rows = []
    for family, contenders in drawn(curves).items():
        found = powers(family, contenders)
        ours = found.pop(OURS)
        others = ", ".join(f"{name} {power}" for name, power in found.items())
        rows.append(f"| {FAMILIES[family].title} | {ours} | {others} |")
    return "\n".join([GROWTH_HEAD, *rows]) if rows else ""


def draw(curves: Curves, folder: Path) -> list[Path]:
    """One picture a family: time against size for each contender."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import EngFormatter

    made = []
    for family, contenders in drawn(curves).items():
        figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
        for name, power in powers(family, contenders).items():
            base, _, exponent = power.partition("^")
            style = {"color": "black", "linewidth": 2} if name == OURS else {"linewidth": 1}
            label = f"{name}: ${base}^{{{exponent}}}$"
            axes.loglog(*zip(*contenders[name], strict=True), "o-", label=label, **style)
        axes.set(xlabel=FAMILIES[family].axis, ylabel="processor time of a call")
        axes.set_title(FAMILIES[family].title, fontsize="medium")
        sizes = sorted({size for points in contenders.values() for size, _ in points})
        axes.set_xticks(sizes, [f"{size:,.0f}".replace(",", " ") for size in sizes], minor=False)
        axes.set_xticks([], minor=True)
        axes.yaxis.set_major_formatter(EngFormatter("s"))
        axes.yaxis.set_minor_formatter("")
        axes.grid(True, alpha=0.3)
        figure.legend(loc="outside lower center", ncols=2, fontsize="medium", frameon=False)
        made.append(folder / f"performance_{family}.png")
        figure.savefig(made[-1], dpi=100)
        plt.close(figure)
    return made


# --- the command ----------------------------------------------------------------------------------------------------


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.report", description=__doc__)
    parser.add_argument("--tasks", nargs="+", choices=list(FAMILIES), help="families of tasks; default all")
    parser.add_argument("--largest", type=int, help="leave out systems of more modes than this")
    parser.add_argument("--pictures", type=Path, help="folder for the scaling plots; default none")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="page of which the run is to replace the one there")
    options = parser.parse_args(argv)
    header, rows, begun = versions(), [HEAD], time.perf_counter()
    print(header, HEAD, sep="\n\n", flush=True)
    curves: Curves = {}
    for family, task in tasks(options.tasks, options.largest):
        found = measure(task)
        rows.append(row(task, found))
        print(rows[-1], flush=True)
        for name, seconds in found.seconds.items():
            curves.setdefault(family, {}).setdefault(name, []).append((task.growth, seconds))
    took = f"The run took {(time.perf_counter() - begun) / 60:.1f} minutes."
    print("", growth(curves), took, sep="\n", flush=True)
    pictures = []
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
        pictures = draw(curves, options.pictures)
        print(*pictures, sep="\n")
    if options.write is not None:
        base = options.write.resolve().parent
        titles = [FAMILIES[path.stem.removeprefix("performance_")].title for path in pictures]
        places = [os.path.relpath(path.resolve(), base) for path in pictures]
        shown = [f"![{title}]({place})" for title, place in zip(titles, places, strict=True)]
        write(options.write, "the run", [f"{header}. {took}", "\n".join(rows), growth(curves), "\n".join(shown)])
    return 0


if __name__ == "__main__":
    sys.exit(main())

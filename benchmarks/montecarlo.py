"""Seeded Monte-Carlo studies of `pem`: does it find the optimum, is it efficient, does it find the order.

python -m benchmarks.montecarlo convergence|efficiency|order|disturbances
    [--seeds N] [--config K ...] [--workers W] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import control
import numpy as np
import scipy

from . import THREADS, trials
from .recordings import Configuration

Trials = list[dict[str, Any]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a study, print a line or two for each configuration, and write all numbers to a file if asked to."""
    options = _options(arguments)
    trial, configurations, report = STUDIES[options.study]
    chosen = [configurations[k - 1] for k in options.config] if options.config else configurations
    print(f"{options.study}: {environment(options.workers)}", flush=True)
    document: dict[str, Any] = {
        "study": options.study, "environment": environment(options.workers), "configurations": []
    }  # fmt: skip
    for config in chosen:
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        done = list(_run(trial, [(config, seed) for seed in seeds], options.workers))
        print("\n".join(report(config, done)), flush=True)
        document["configurations"].append({"configuration": asdict(config), "trials": done})
        if options.json:
            # after each configuration, so that a study that is interrupted leaves what it has
            options.json.write_text(json.dumps(document, indent=1), encoding="utf-8")


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.montecarlo", description=__doc__.splitlines()[0])
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=int, help="number of seeds (default: 100, and 200 for efficiency)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--config", type=int, nargs="+", metavar="K", help="configurations, from 1 (default: all)")
    parser.add_argument("--workers", type=int, default=1, help="processes; times are best taken with one")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    options.seeds = options.seeds or (200 if options.study == "efficiency" else 100)
    allowed = len(STUDIES[options.study][1])
    if options.config and not all(1 <= k <= allowed for k in options.config):
        parser.error(f"{options.study} has the configurations 1 to {allowed}")
    return options


def environment(workers: int) -> str:
    """Versions, cores, processes and threads: what the times below depend on."""
    packages = ", ".join(f"{package.__name__} {package.__version__}" for package in (np, scipy, control))
    threads = ", ".join(f"{name}={os.environ[name]}" for name in THREADS)
    return (
        f"Python {platform.python_version()}, {packages}; {os.cpu_count()} cores, {workers} worker"
        f"{'s' * (workers != 1)}; {threads}"
    )


def _run(trial: Callable[[Any], dict[str, Any]], tasks: list[Any], workers: int) -> Iterator[dict[str, Any]]:
    if workers == 1:
        yield from map(trial, tasks)
        return
    # new processes, not copies: they import this package, and so pin their threads, before numpy
    with get_context("spawn").Pool(min(workers, len(tasks))) as pool:
        yield from pool.imap(trial, tasks)


# --- reports ---------------------------------------------------------------------------------------------------------


def _report_convergence(config: Configuration, done: Trials) -> list[str]:
    outcomes = Counter(trial["outcome"] for trial in done)
    at_optimum = outcomes[trials.FOUND] + outcomes[trials.BAD_LUCK]
    lines = [
        f"{config!s:32s} within {trials.ALLOWED:g} standard errors {outcomes[trials.FOUND]:3d}/{len(done)}, at the "
        f"optimum {at_optimum:3d}/{len(done)}; {_times(done)}"
    ]
    for trial in done:
        if trial["outcome"] == trials.ERROR:
            lines.append(f"    seed {trial['seed']}: {trial['error']}")
        elif trial["outcome"] != trials.FOUND:
            lines.append(
                f"    seed {trial['seed']}: {trial['outcome']}, {trial['worst']:.3g} standard errors away, loss "
                f"{trial['loss']:.6g}, near the truth {trial['loss_near_truth']:.6g}; verdict {trial['message']!r}"
            )
    return lines


def _report_efficiency(config: Configuration, done: Trials) -> list[str]:
    good = [trial for trial in done if "error" not in trial]
    lines = [f"{config!s:32s} {len(good)}/{len(done)} fits of one recording, other noise each time; {_times(done)}"]
    lines += [f"    seed {trial['seed']}: {trial['error']}" for trial in done if "error" in trial]
    if not good:
        return lines
    squares = np.square([trial["scaled_error"] for trial in good])
    covered = 100.0 * np.array([trial["covered"] for trial in good])
    for name, part in parameter_groups(config.n).items():
        ratio, spread = mean_and_error(squares[:, part])
        modes = squares[:, part].mean(axis=0)
        share, doubt = mean_and_error(covered[:, part])
        lines.append(
            f"    {name:14s} mean squared error / bound {ratio:.3f} +- {spread:.3f} (parameters {modes.min():.2f} .. "
            f"{modes.max():.2f}); 95 % intervals hold {share:.1f} +- {doubt:.1f} %"
        )
    return lines


def parameter_groups(n: int) -> dict[str, slice]:
    """Places of the groups of parameters in `(d, r, state)`."""
    return {"d": slice(0, n), "r": slice(n, 2 * n), "initial state": slice(2 * n, 4 * n)}


def mean_and_error(values: np.ndarray) -> tuple[float, float]:
    """Mean over seeds and parameters, shape (seeds, parameters), and its Monte-Carlo standard error.

    Parameters of one fit depend on one another, so it is their mean that counts as one observation.
    """
    means = values.mean(axis=1)
    error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else np.nan
    return float(means.mean()), float(error)


def _report_order(config: Configuration, done: Trials) -> list[str]:
    orders = Counter(trial["order"] for trial in done)
    found = ", ".join(f"{order}: {count}" for order, count in sorted(orders.items(), key=lambda item: str(item[0])))
    name = str(config) if config.n else f"pure noise, T={config.samples}"
    lines = [f"{name:32s} right order {orders[config.n]:3d}/{len(done)} (orders found {found}); {_times(done)}"]
    lines += [f"    seed {trial['seed']}: {trial['error']}" for trial in done if "error" in trial]
    wrong = [f"{trial['seed']} ({trial['order']})" for trial in done if trial["order"] != config.n]
    if wrong:
        lines.append(f"    wrong at seeds {', '.join(wrong)}")
    said = Counter(trial.get("message", "no result") for trial in done)
    lines += [f"    verdict {text!r}: {count}" for text, count in said.most_common()]
    return lines


def _report_disturbance(config: trials.Disturbed, done: Trials) -> list[str]:
    near = sum(abs(trial["order"] - config.n) <= 1 for trial in done if trial["order"] is not None)
    whole = sum(trial.get("modes_found") == config.n for trial in done)
    named = Counter(cause for trial in done for cause in trial.get("causes", ()))
    return [
        *_report_order(config, done),
        f"    order within 1: {near}/{len(done)}; every mode found: {whole}/{len(done)}; named: {dict(named)}",
    ]


def _times(done: Trials) -> str:
    seconds = [trial["seconds"] for trial in done]
    return f"a fit takes {np.median(seconds):.3g} s (median), {max(seconds):.3g} s (longest)"


STUDIES: dict[str, tuple[Callable[[Any], dict[str, Any]], tuple[Any, ...], Callable[..., list[str]]]] = {
    "convergence": (trials.convergence, trials.CONVERGENCE, _report_convergence),
    "efficiency": (trials.efficiency, trials.EFFICIENCY, _report_efficiency),
    "disturbances": (trials.disturbance, trials.DISTURBED, _report_disturbance),
    "order": (trials.order, (*trials.ORDER, trials.NOISE), _report_order),
}

if __name__ == "__main__":
    main()

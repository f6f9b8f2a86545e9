"""Identification methods side by side: the same recordings, one run.

    python -m benchmarks.peers [--seeds N] [--rule exact euler] [--method TEXT ...] [--json FILE]

All records start at rest, which the Markov parameters of ERA need.  `exact` has plants sampled as an engineer would
(0.1 to 0.9 of the Nyquist frequency), recorded exactly; `euler` is the ground of the paper's scheme: step 0.01, slow
modes, and a recording made by Euler's rule, which is what the scheme models.  Every method knows the order, and is
given the best of its settings by the truth, of every recording anew; the paper's scheme starts at random, but in the
right band, with weights of the right size, and at rest.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bound import standard_errors
from .methods import COORDINATES, EPOCHS, METHODS, Method, Model, disagreement
from .montecarlo import environment
from .recordings import BAND, Recording, balanced_modes, record, simulate, spaced_frequencies

Array = NDArray[np.float64]

BINS = 3.0  # smallest distance of two frequencies
CLOSE = 0.01  # relative error of a frequency that counts as found
ALLOWED = 4.0  # standard errors, likewise
AHEAD = 2000  # samples of the new input
EULER_STEP, EULER_BAND, EULER_GAP, EULER_INPUT = 0.01, (0.6, 5.5), 0.94, 5.0


@dataclass(frozen=True)
class Case:
    """Kind of the recording, modes, samples, signal-to-noise ratio in dB."""

    rule: str
    n: int
    samples: int
    snr: float

    def __str__(self) -> str:
        return f"{self.rule} recording, {self.n} modes, {self.samples} samples, {self.snr:g} dB"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all methods on all cases and print a table of each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--rule", choices=("exact", "euler"), nargs="+", default=["exact", "euler"])
    parser.add_argument("--modes", type=int, nargs="+", default=[3, 5])
    parser.add_argument("--samples", type=int, nargs="+", default=[1000, 2000])
    parser.add_argument("--snr", type=float, default=20.0, help="dB (default: 20)")
    parser.add_argument("--defaults", action="store_true", help="state-space methods with their packages' defaults")
    parser.add_argument("--method", nargs="+", metavar="TEXT", help="only the methods with one of these in their names")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    # ours always, to compare with
    chosen = [
        method for k, method in enumerate(METHODS)
        if k == 0 or options.method is None or any(text in method.name for text in options.method)
    ]  # fmt: skip
    if options.defaults:
        chosen = [replace(method, settings=(None,)) if method.state_space else method for method in chosen]
    print(f"peers: {environment(1)}", flush=True)
    document: list[dict[str, Any]] = []
    for rule, n, samples in product(options.rule, options.modes, options.samples):
        case = Case(rule, n, samples, options.snr)
        rows = {method.name: trials_of(method, case, options.seeds) for method in chosen}
        print("\n".join(table(case, rows)), flush=True)
        if rule == "euler" and any(method.package == "numba" and method.installed for method in chosen):
            print(compiled_is_the_same(case), flush=True)
        document.append({"case": str(case), "trials": rows})
        if options.json:
            options.json.write_text(json.dumps(document, indent=1), encoding="utf-8")


def compiled_is_the_same(case: Case) -> str:
    """Line that says how far the compiled descent is from the library's, for rates at which neither is chaotic."""
    recording, _, _ = recording_of(case, 0)
    worst = max(
        disagreement(recording, kind, optimizer, rate, 100)
        for kind in COORDINATES
        for optimizer, rate in (("plain", 1e-4), ("adam", 0.02))
    )
    return f"  compiled and library descent: losses of 100 steps agree to {worst:.1e}"


def recording_of(case: Case, seed: int) -> tuple[Recording, Array, Array]:
    """Recording number `seed` of a case, a new input, and the noise-free answer to it from rest."""
    rng = np.random.default_rng([case.n, case.samples, case.rule == "euler", seed])
    if case.rule == "exact":
        h, band, gap, size = 1.0, (BAND[0] * np.pi, BAND[1] * np.pi), BINS * 2 * np.pi / case.samples, 1.0
    else:
        h, band, gap, size = EULER_STEP, EULER_BAND, EULER_GAP, EULER_INPUT
    d = spaced_frequencies(case.n, gap, band, rng)
    u, new = size * rng.standard_normal(case.samples), size * rng.standard_normal(AHEAD)
    r, rest = balanced_modes(d, u, rng, h, case.rule, moving=False)
    return record(d, r, rest, u, case.snr, rng, h, case.rule), new, simulate(d, r, rest, new, h, case.rule)


def trials_of(method: Method, case: Case, seeds: int) -> list[dict[str, Any]] | None:
    """Each seed with the best setting for it; None where the package is not installed."""
    if not method.installed:
        return None
    # imports and compilation are not what is timed
    attempt(method, method.settings[0], case, 0)
    return [
        min((attempt(method, setting, case, seed) for setting in method.settings), key=lambda trial: trial["error"])
        for seed in range(seeds)
    ]


def attempt(method: Method, setting: Any, case: Case, seed: int) -> dict[str, Any]:
    """One identification, timed, and held against the truth."""
    recording, new, answer = recording_of(case, seed)
    failure = ""
    with warnings.catch_warnings():
        # what other packages warn of is not our business here; failures show in the numbers
        warnings.simplefilter("ignore")
        start = perf_counter()
        try:
            model = method.identify(recording, setting, seed)
        except (Exception, SystemExit) as reason:
            failure = f"{type(reason).__name__}: {reason}"
            model = Model(np.full(case.n, np.nan), lambda u: np.full(len(u), np.nan))
        seconds = perf_counter() - start
    off = np.abs(model.d - recording.d)
    close, efficient = CLOSE * recording.d, ALLOWED * standard_errors(recording)[: case.n]
    with np.errstate(over="ignore", invalid="ignore"):
        error = float(np.linalg.norm(model.response(new) - answer) / np.linalg.norm(answer))
    return {
        "seed": seed, "setting": setting, "failure": failure, "seconds": seconds, "steps": model.steps,
        "close": bool((off <= close).all()), "efficient": bool((off <= efficient).all()),
        "frequency_error": _finite(np.sqrt(np.mean((off / recording.d) ** 2))), "error": _finite(error),
    }  # fmt: skip


def _finite(value: float) -> float:
    return float(value) if np.isfinite(value) else np.inf


def table(case: Case, rows: dict[str, list[dict[str, Any]] | None]) -> list[str]:
    """Lines of the table of a case: counts, medians over the seeds, and their ratios to the first row."""
    title = f"{case!s:44s} d to 1 %  to 4 s.e.   rms error of d   x ours   on new input   x ours   time [s]   x ours"
    lines = ["", title]
    ours: list[float] = []
    for name, trials in rows.items():
        if trials is None:
            lines.append(f"  {name:42s} not installed")
            continue
        medians = [
            float(np.median([trial[key] for trial in trials])) for key in ("frequency_error", "error", "seconds")
        ]
        ours = ours or medians
        close, efficient = (f"{sum(trial[key] for trial in trials)}/{len(trials)}" for key in ("close", "efficient"))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.divide(medians, ours)
        cells = [
            f"{value:{width}.3g}   {ratio:6.3g}"
            for value, ratio, width in zip(medians, ratios, (14, 12, 8), strict=True)
        ]
        lines.append(f"  {name:42s} {close:>8s}  {efficient:>9s}   " + "   ".join(cells))
        cut = sum(trial["steps"] < EPOCHS for trial in trials)
        if cut:
            lines.append(f"      left the range of doubles {cut} times; the time is that until then")
        reasons = {trial["failure"] for trial in trials if trial["failure"]}
        lines += [f"      failed: {reason}" for reason in sorted(reasons)]
    return lines


if __name__ == "__main__":
    main()

"""Monte Carlo of fits of damped modes under noise as it is: which order, and how often intervals cover the truth.

python -m benchmarks.real_noise [--seeds N] [--modes N] [--noise NAME] [--structure NAME]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import ph_control as phc
from tests.noisy_plants import SIZES, plant, recording, response

RESPONSES = ("constant", "gain", "both")
RECORDINGS = ("white", "coloured", "input", "forces", "drift", "delay", "outlier")


@dataclass(frozen=True)
class Outcome:
    """Share of seeds with the order of the plant, those covered of its frequencies and damping ratios, CPU time."""

    right: float
    cover: float
    seconds: float


def study(modes: int, outputs: int, inputs: int, noise: str, seeds: int, **options: Any) -> Outcome:
    """Fits to plants and noise of different seeds."""
    start, right, covered = time.process_time(), [], []
    for seed in range(seeds):
        poles, _ = plant(modes, outputs, inputs, seed)
        if noise in RESPONSES:
            found = phc.pem(response(modes, outputs, inputs, noise, seed), **options)
        else:
            found = phc.pem(recording(modes, outputs, inputs, noise, seed), dt=1.0, **options)
        right.append(found.order == modes)
        if not right[-1]:
            continue
        intervals, d = found.confidence_interval(), np.abs(poles)
        for name, true in (("natural_frequencies", d), ("damping_ratios", -poles.real / d)):
            low, high = intervals[name].T
            covered += ((low <= true) & (true <= high)).tolist()
    return Outcome(float(np.mean(right)), float(np.mean(covered or [np.nan])), (time.process_time() - start) / seeds)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--modes", type=int, action="append")
    parser.add_argument("--noise", action="append", choices=RESPONSES + RECORDINGS)
    parser.add_argument("--structure", default="free", choices=("auto", "lossless", "classical", "passive", "free"))
    options = parser.parse_args()
    for modes in options.modes or (3, 6):
        for outputs, inputs in SIZES:
            for noise in options.noise or RESPONSES:
                one = study(modes, outputs, inputs, noise, options.seeds, structure=options.structure)
                print(
                    f"{modes} modes, {outputs} x {inputs}, noise {noise}: order right in {100 * one.right:.0f} %, "
                    f"95 % intervals cover {100 * one.cover:.1f} %, {one.seconds:.2f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()

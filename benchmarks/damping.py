"""Monte Carlo of the test of lossless models, of damping that leaves residuals white, and of a hammer test.

python -m benchmarks.damping test|hammer [--seeds N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

import ph_control as phc

Array = NDArray[np.float64]

RATIOS = (0.0, 1e-5, 3e-5, 1e-4)
NUMERATORS = {"velocity": [1.0, 0.0], "acceleration": [1.0, 0.0, 0.0]}


def output(
    u: Array, d: Sequence[float], ratios: Sequence[float], weights: Sequence[float], h: float, kind: str
) -> Array:
    """Second-order transfer functions under a held input."""
    y = np.zeros(len(u))
    for frequency, ratio, weight in zip(d, ratios, weights, strict=True):
        plant = ([weight * one for one in NUMERATORS[kind]], [1, 2 * ratio * frequency, frequency**2])
        numerator, denominator, _ = cont2discrete(plant, h, "zoh")
        y += lfilter(numerator[0], denominator, u)
    return y


def white_input(seeds: int) -> None:
    """How often a lossless model is refused: n = 3, T = 2000, 26 dB."""
    for ratio in RATIOS:
        p, consistent = [], 0
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            u = rng.standard_normal(2000)
            y = output(u, (0.5, 1.3, 2.2), [ratio] * 3, (1.0, 0.6, 0.8), 1.0, "velocity")
            y += 10**-1.3 * np.std(y) * rng.standard_normal(2000)
            result = phc.pem((u, y), 3, dt=1.0, structure="lossless")
            p.append(result.tests[0].p)
            consistent += result.verdict.startswith("consistent")
        shares = ", ".join(f"p < {level:g}: {100 * np.mean(np.array(p) < level):.1f} %" for level in (0.05, 0.01, 1e-3))
        print(f"zeta {ratio:g}: {shares}; 'consistent' {100 * consistent / seeds:.1f} %", flush=True)


def hammer(seeds: int) -> None:
    """Damping ratios of a hammer test, 10^5 samples, and what they are off in standard errors."""
    h, ratios = 5e-5, np.array([0.005, 0.012, 0.02])
    t = h * np.arange(100_000)
    u = np.where((t >= 0.01) & (t <= 0.0108), 100 * np.sin(np.pi * (t - 0.01) / 8e-4), 0.0)
    clean = output(u, 2 * np.pi * np.array([120.0, 310.0, 540.0]), ratios, (1.0, -0.6, 0.8), h, "acceleration")
    scores, times = [], []
    for seed in range(seeds):
        y = clean + 0.01 * np.std(clean) * np.random.default_rng(seed).standard_normal(len(t))
        start = time.process_time()
        model = phc.pem((u, y), dt=h, quantity="acceleration")
        times.append(time.process_time() - start)
        if model.order != 3:
            print(f"seed {seed}: {model!r}")
            continue
        scores.append((model.damping_ratios - ratios) / model.stderr["damping_ratios"])
    print(
        f"{len(scores)} of {seeds} with three modes; rms z-score {np.sqrt(np.mean(np.square(scores))):.2f}, largest "
        f"{np.max(np.abs(scores)):.1f}; CPU time {np.median(times):.1f} s, at most {np.max(times):.1f} s"
    )


def main() -> None:
    """Run a study."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.damping", description=__doc__.splitlines()[0])
    parser.add_argument("study", choices=("test", "hammer"))
    parser.add_argument("--seeds", type=int)
    options = parser.parse_args()
    if options.study == "test":
        white_input(options.seeds or 100)
    else:
        hammer(options.seeds or 20)


if __name__ == "__main__":
    main()

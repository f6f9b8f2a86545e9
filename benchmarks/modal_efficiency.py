"""Monte Carlo of fits of damped structures: errors over the Cramer-Rao bound, and how often intervals cover the truth.

python -m benchmarks.modal_efficiency [--seeds N] [--kind time|response|decay] [--structure free|classical]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ph_control as phc
from tests.modal_plants import Plant, data_of

Array = NDArray[np.float64]

SAMPLES = 800
NOISE = 0.1  # 20 dB
QUIET = 1e-3  # of the noise, with which fits have the bound at the truth,
QUIET_SEEDS = range(10_000, 10_025)  # each estimates its variances: the mean of so many is right to a per cent
LEVEL = 0.95
PARAMETERS = ("natural_frequencies", "damping_ratios", "residues", "shapes")


@dataclass(frozen=True)
class Efficiency:
    """Of one kind of parameter: mean squared error over the bound, mean error, share of intervals that cover.

    `uncertain` is the standard error of the ratio.
    """

    ratio: float
    uncertain: float
    bias: float
    cover: float


def study(
    kind: str = "time", structure: str = "free", seeds: int = 200, samples: int = SAMPLES, plant: Plant | None = None
) -> dict[str, Efficiency]:
    """Fits to the same plant with noise of different seeds."""
    plant = plant or Plant.of()
    ports = [] if kind == "decay" else [(k, k) for k in range(plant.inputs)]
    options: dict[str, Any] = {"structure": structure, "ports": ports, "order": len(plant.poles)}
    options |= {} if kind == "response" else {"dt": 1.0, "intersample": "zoh"}
    quiet = [phc.pem(data_of(plant, kind, samples, one, NOISE * QUIET), **options) for one in QUIET_SEEDS]
    truth = plant.truth
    if kind == "decay":
        lead = np.abs(plant.shapes).argmax(axis=1)
        truth["shapes"] = plant.shapes / plant.shapes[np.arange(len(lead)), lead][:, None] + 0j
        truth.pop("residues")
    squares = {name: np.mean([_parts(one.stderr[name]) ** 2 for one in quiet], axis=0) for name in truth}
    errors: dict[str, list[Array]] = {name: [] for name in truth}
    covers: dict[str, list[NDArray[Any]]] = {name: [] for name in truth}
    for seed in range(1, seeds + 1):
        found = phc.pem(data_of(plant, kind, samples, seed, NOISE), initial_guess=quiet[0], **options)
        intervals = found.confidence_interval(LEVEL)
        for name, true in truth.items():
            bound = np.sqrt(squares[name]) / QUIET
            shown = bound > 1e-6 * np.abs(true).max()  # some are fixed by the scale, or by the structure
            errors[name].append((_parts(getattr(found, name)) - _parts(true))[shown] / bound[shown])
            low, high = _parts(intervals[name][..., 0]), _parts(intervals[name][..., 1])
            covers[name].append(((low <= _parts(true)) & (_parts(true) <= high))[shown])
    each = {name: np.mean(np.square(errors[name]), axis=1) for name in truth}
    return {
        name: Efficiency(
            float(np.mean(each[name])),
            float(np.std(each[name]) / np.sqrt(seeds)),
            float(np.abs(np.mean(errors[name], axis=0)).max()),
            float(np.mean(covers[name])),
        )
        for name in truth
    }


def _parts(values: NDArray[Any]) -> Array:
    """Real and imaginary parts."""
    return np.stack([values.real, values.imag]) if np.iscomplexobj(values) else np.asarray(values)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--kind", action="append", choices=("time", "response", "decay"))
    parser.add_argument("--structure", action="append", choices=("free", "classical"))
    options = parser.parse_args()
    print("3 modes, 4 outputs, 2 inputs, 20 dB; mean squared error over the Cramer-Rao bound, share of 95 % intervals")
    for kind in options.kind or ("time", "response", "decay"):
        for structure in options.structure or (("free",) if kind == "decay" else ("free", "classical")):
            begin = time.perf_counter()
            found = study(kind, structure, options.seeds)
            took = time.perf_counter() - begin
            print(f"{kind}, {structure}: {options.seeds} seeds in {took:.0f} s")
            for name, one in found.items():
                print(
                    f"  {name:20s} ratio {one.ratio:5.3f} +- {one.uncertain:5.3f}, largest bias {one.bias:5.3f}, "
                    f"cover {100 * one.cover:5.1f} %"
                )


if __name__ == "__main__":
    main()

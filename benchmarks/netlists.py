"""Circuits of random lossless one-ports: every form's response, by nodal analysis with 60 digits, against the system's.

python -m benchmarks.netlists [--systems N] [--modes N] [--first-seed S]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

import ph_control as phc
from tests.nodal_analysis import FORMS, KINDS, errors, random_one_port, round_trip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark and print one line for each form."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=200)
    parser.add_argument("--modes", type=int, default=30, help="of a system, at most")
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args(arguments)
    seeds = range(options.first_seed, options.first_seed + options.systems)
    print(f"{options.systems} systems of 1 to {options.modes} modes, two frequencies each; relative errors")
    print(
        f"{'kind':11} {'form':8} {'largest':>9} {'median':>9} {'of rounding':>11} {'> 1e-9':>6} {'trip':>9} {'ms':>6}"
    )
    for kind in KINDS:
        for form in FORMS:
            found, trips, spent = [], [], 0.0
            for seed in seeds:
                modes = random_one_port(seed, options.modes)
                began = time.perf_counter()
                circuit = phc.netlist(modes, form, kind=kind)
                spent += time.perf_counter() - began
                rng = np.random.default_rng([seed, 1])
                band = np.log([modes.d[0] / 2, 2 * modes.d[-1]])
                found += [errors(modes, circuit, float(np.exp(rng.uniform(*band)))) for _ in range(2)]
                if len(modes.d) <= 6:
                    trips.append(round_trip(circuit))
            error, rounding = np.array(found).T
            print(
                f"{kind:11} {form:8} {error.max():9.1e} {np.median(error):9.1e} {(error / rounding).max():11.2f} "
                f"{np.count_nonzero(error > 1e-9):6d} {np.max(trips):9.1e} {1e3 * spent / len(seeds):6.1f}"
            )
    print("of rounding: error over what values rounded by half a unit in the last place explain, at most")
    print("trip: netlist, port-Hamiltonian system, netlist: largest change of an element, systems of up to 6 modes")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Six fits of `benchmarks.golden` and four tasks of `benchmarks.report`, for `asv run`: processor time of each commit.

The package is the one that is installed for the commit: nothing here imports the rest of `benchmarks`, which is that of
the working tree.  Records come from `golden_records.py` by its path, as that does not call the package.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from time import process_time

import control as ct
import numpy as np

import ph_control as phc

_PATH = Path(__file__).resolve().parents[1] / "golden_records.py"
_SPEC = importlib.util.spec_from_file_location("golden_records", _PATH)
golden_records = sys.modules["golden_records"] = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(golden_records)


class Fits:
    """Default calls, and one with the order given, on records that are made from a seed."""

    params = ("plain", "order_given", "damped", "two_by_three", "decay", "response_matrix")
    param_names = ("kind",)
    timer = staticmethod(process_time)
    timeout = 600.0  # of the clock: beside other work processor time is a part of it

    def setup(self, kind: str) -> None:
        """Make the record."""
        _, self.record = golden_records.record(kind, 0)

    def time_pem(self, kind: str) -> None:
        """`pem`."""
        phc.pem(self.record.data, **self.record.keywords)


def chain(masses: int) -> ct.StateSpace:
    """Spring chain with proportional damping as a plain state space, driven at its end."""
    n = masses
    K = 250.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    C, F, none = 1e-3 * K + 0.02 * np.eye(n), np.eye(n)[:, -1:], np.zeros((n, 1))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]])
    return ct.ss(A, np.vstack([none, F]), np.vstack([none, F]).T, 0)


class Systems:
    """Conversion, passivity, reduction and simulation of chains."""

    timer = staticmethod(process_time)
    timeout = 600.0  # of the clock: beside other work processor time is a part of it

    def setup(self) -> None:
        """Make the systems."""
        self.plain, self.large = chain(50), phc.ph(chain(100))
        self.t, self.u = 0.01 * np.arange(20_000), np.random.default_rng(0).standard_normal(20_000)

    def time_conversion(self) -> None:
        """`ph` of 100 states."""
        phc.ph(self.plain)

    def time_passivity(self) -> None:
        """`passivity` of 100 states."""
        phc.passivity(self.plain)

    def time_reduction(self) -> None:
        """`reduce` of 200 states to 20."""
        phc.reduce(self.large, 20)

    def time_simulation(self) -> None:
        """20 000 samples of 200 states."""
        phc.forced_response(self.large, self.t, self.u, intersample="zoh")

"""The search for modes in measured frequency responses.

Real plants have some damping, and responses have few points on a peak.  Modes are therefore looked for with a damping
and a residue of either sign of their own, on a smooth background; what the lossless model makes of these frequencies is
judged by the loss.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .damped_search import DampedSearch, damped_data
from .search import Report, Step, mode_energies, more_than_noise
from .solver import Problem, refine

Array = NDArray[np.float64]


class ResponseSearch:
    """Search in frequency responses."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._damped = DampedSearch(problem, damped_data(problem))

    @property
    def affords_batches(self) -> bool:
        """Modes join one at a time."""
        return False

    def unconvinced(self, step: Step) -> bool:
        """Whether what is left shows a mode that noise alone would hardly show anywhere."""
        return more_than_noise(self.problem, step)

    def step(self, d: Array, rtol: float, report: Report | None = None) -> Step:
        """Refine modes from a start and look for more."""
        free = self._damped.step(d, rtol)
        end = refine(self.problem, free.d, rtol=rtol, progress=report)
        at = end.projection
        # the path goes on from the damped frequencies: damping, not noise, is what moves those of the lossless model
        return Step(
            free.d, at.loss, end.iterations, end.converged, free.candidates, free.gains, ~at.free, mode_energies(at),
            end.interrupted,
        )  # fmt: skip

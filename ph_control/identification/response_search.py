"""The search for modes in measured frequency responses.

Real plants have some damping, and responses have few points on a peak.  Modes are therefore looked for with a damping
and a residue of either sign of their own, on a smooth background; what the lossless model makes of these frequencies is
judged by the loss.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .damped_search import DampedSearch, damped_data
from .frequency_rows import FrequencyRows
from .search import Report, Step, mode_energies, more_than_noise
from .solver import Problem, refine

Array = NDArray[np.float64]

_APART = 4  # points between resonances that are told apart at sight


class ResponseSearch:
    """Search in frequency responses."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._damped = DampedSearch(problem, damped_data(problem))
        self._points = np.unique(
            np.concatenate([one.omega for one in problem.experiments if isinstance(one, FrequencyRows)])
        )

    @property
    def affords_batches(self) -> bool:
        """Modes join one at a time."""
        return False

    def unconvinced(self, step: Step) -> bool:
        """Whether what is left shows a mode that noise alone would hardly show anywhere."""
        return more_than_noise(self.problem, step)

    @cached_property
    def _first(self) -> Step:
        return self._damped.step(np.zeros(0), 1.0)

    def _peaks(self, count: int) -> Array:
        """The strongest resonances as they stand in the data, apart from one another.

        A mode that joined early, when others were still missing, may have left its resonance to explain these.
        """
        chosen: list[int] = []
        places = np.searchsorted(self._points, self._first.candidates)
        for k, place in enumerate(places):
            if len(chosen) < count and all(abs(place - places[other]) >= _APART for other in chosen):
                chosen.append(k)
        return self._first.candidates[chosen]

    def step(self, d: Array, rtol: float, report: Report | None = None) -> Step:
        """Refine modes from a start and look for more."""
        free = self._damped.step(d, rtol)
        peaks = self._peaks(len(d))
        if len(peaks) == len(d) > 1:
            free = min(free, self._damped.step(peaks, rtol), key=lambda one: one.loss)
        end = refine(self.problem, free.d, rtol=rtol, progress=report)
        at = end.projection
        # the path goes on from the damped frequencies: damping, not noise, is what moves those of the lossless model
        return Step(
            free.d, at.loss, end.iterations, end.converged, free.candidates, free.gains, ~at.free, mode_energies(at),
            end.interrupted,
        )  # fmt: skip

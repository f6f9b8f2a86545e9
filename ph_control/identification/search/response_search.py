"""The search for modes in measured frequency responses.

Real plants have some damping, and responses have few points on a peak.  Modes are therefore looked for with a damping
and a residue of either sign of their own, on a smooth background; what the lossless model makes of these frequencies is
judged by the loss.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..regression.frequency_rows import FrequencyRows
from ..regression.variable_projection import Problem, refine
from .damped_search import DampedSearch, damped_data
from .steps import Report, Step, mode_energies, more_than_noise
from .vector_fitting import vector_fit

Array = NDArray[np.float64]

_MUCH = 0.1  # of the weighted squares of a response: with more left, modes are missing that no criterion can weigh


class ResponseSearch:
    """Search in frequency responses."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.latest: Step | None = None
        self._damped = DampedSearch(problem, damped_data(problem))
        self._responses = [one for one in problem.experiments if isinstance(one, FrequencyRows)]
        self._power = sum(float(np.sum(np.abs(one.target) ** 2)) for one in self._responses)
        self._together: dict[int, Step] = {}

    @property
    def affords_batches(self) -> bool:
        """Modes join one at a time."""
        return False

    def unconvinced(self, step: Step) -> bool:
        """Whether what is left shows a mode that noise alone would hardly show anywhere."""
        return more_than_noise(self.problem, step)

    def _at_once(self, n: int, rtol: float) -> Step:
        """The best that comes of all modes found together, whatever has joined until now."""
        if n not in self._together:
            d, sigma = vector_fit(self._responses, n)
            self._together[n] = self._damped.step(d, rtol, sigma=sigma)
        return self._together[n]

    def step(self, d: Array, rtol: float, report: Report | None = None) -> Step:
        """Refine modes from a start and look for more."""
        free = self._damped.step(d, rtol)
        if free.coloured and len(d):
            other = self._at_once(len(d), rtol)
            free = other if len(other.d) == len(d) and other.loss < free.loss else free
        end = refine(self.problem, free.d, rtol=rtol, progress=report)
        at = end.projection
        # the path goes on from the damped frequencies: damping, not noise, is what moves those of the lossless model
        self.latest = step = Step(
            free.d, at.loss, end.iterations, end.converged, free.candidates, free.gains, ~at.free, mode_energies(at),
            end.interrupted, free.coloured and free.loss > _MUCH * self._power,
        )  # fmt: skip
        return step

"""The search for modes in measured frequency responses.

Real plants have some damping, and responses have few points on a peak.  Modes are therefore looked for with a damping
and a residue of any phase of their own, on a smooth background; what the lossless model makes of these frequencies is
judged by the loss.
"""

from __future__ import annotations

import numpy as np

from ..._types import Array
from ..regression.tuning import TUNING
from ..regression.variable_projection import Problem, refine
from ..uncertainty.residual_data import without_peaks
from ..uncertainty.residual_tests import ljung_box
from .free_path import FreeStep, free_step
from .free_search import responses_of
from .steps import Report, Search, Step


class ResponseSearch(Search):
    """Search in frequency responses."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.data = responses_of(problem)
        self.power = sum(float(np.sum(np.abs(one.target) ** 2)) for one in self.data.experiments)
        self._poles: dict[float, complex] = {}

    def damped(self, d: Array) -> FreeStep:
        """The best damped modes near some frequencies, from the poles that were found there before."""
        p = np.array([self._poles.get(one, complex(np.nan, one)) for one in d.tolist()], complex)
        step = free_step(self.data, p)
        self._poles.update(zip(step.at.d.tolist(), step.at.p.tolist(), strict=True))
        return step

    def _is_white(self, step: FreeStep) -> bool:
        """Whether what damped modes leave is noise from point to point, but for a few that outweigh all others."""
        parts = [without_peaks(part) for (one,) in step.left for part in (one.real, one.imag)]
        return ljung_box(parts, TUNING.lags) >= TUNING.white

    def _refined(self, d: Array, rtol: float, report: Report | None) -> Step:
        damped = self.damped(d)
        candidates, gains = self.data.candidates(damped.left)
        end = refine(self.problem, damped.at.d, rtol=rtol, progress=report)
        at = end.projection
        # the path goes on from the damped frequencies: damping, not noise, is what moves those of the lossless model
        return Step(
            damped.at.d, at.loss, end.iterations, end.converged, candidates.imag, gains, ~at.free, at.energies,
            damped.loss > TUNING.much * self.power and not self._is_white(damped),
        )  # fmt: skip

"""The search for modes in measured frequency responses.

Real plants have some damping, and responses have few points on a peak.  Modes are therefore looked for with a damping
and a residue of any phase of their own, on a smooth background; what the lossless model makes of these frequencies is
judged by the loss.
"""

from __future__ import annotations

import numpy as np

from ..._types import Array
from ..regression.free import refine_free
from ..regression.frequency_rows import FreeResponse, FrequencyRows
from ..regression.tuning import TUNING
from ..regression.variable_projection import Problem, refine
from ..uncertainty.residual_data import without_peaks
from ..uncertainty.residual_tests import ljung_box
from .free_search import FreeModel, Responses
from .steps import Report, Search, Step


class ResponseSearch(Search):
    """Search in frequency responses."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.experiments = [one for one in problem.experiments if isinstance(one, FrequencyRows)]
        self.damped_search = Responses([FreeResponse.of(one) for one in self.experiments])
        self.power = sum(float(np.sum(np.abs(one.target) ** 2)) for one in self.experiments)
        self._poles: dict[float, complex] = {}

    def damped(self, d: Array) -> FreeModel:
        """The best damped modes near some frequencies, from the poles that were found there before."""
        p = np.array([self._poles.get(one, complex(np.nan, one)) for one in d.tolist()], complex)
        found = self.damped_search.model(refine_free(lambda _: self.damped_search.data, p, self.damped_search.region))
        self._poles.update(zip(found.at.d.tolist(), found.p.tolist(), strict=True))
        return found

    def _is_white(self, step: FreeModel) -> bool:
        """Whether what damped modes leave is noise from point to point, but for a few that outweigh all others."""
        parts = [without_peaks(part) for (one,) in step.left for part in (one.real, one.imag)]
        return ljung_box(parts, TUNING.lags) >= TUNING.white

    def _candidates(self, damped: FreeModel) -> tuple[Array, Array]:
        """Frequencies of modes that explain most of what is left; of few points the middles between these."""
        poles, gains = self.damped_search.candidates(damped)
        if len(poles):
            return poles.imag, gains
        pairs = [(one.omega, np.abs(left) ** 2) for one, (left,) in zip(self.experiments, damped.left, strict=True)]
        middles = np.concatenate([0.5 * (omega[1:] + omega[:-1]) for omega, _ in pairs])
        power = np.concatenate([each[1:] + each[:-1] for _, each in pairs])
        best = np.argsort(-power, kind="stable")
        return middles[best], power[best]

    def _refined(self, d: Array, rtol: float, report: Report | None) -> Step:
        damped = self.damped(d)
        candidates, gains = self._candidates(damped)
        end = refine(self.problem, damped.at.d, rtol=rtol, progress=report)
        at = end.projection
        # the path goes on from the damped frequencies: damping, not noise, is what moves those of the lossless model
        return Step(
            damped.at.d, at.loss, end.iterations, end.converged, candidates, gains, ~at.free, at.energies,
            damped.loss > TUNING.much * self.power and not self._is_white(damped),
        )  # fmt: skip

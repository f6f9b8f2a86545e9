"""The search for damped modes with residues of either sign in frequency responses.

The same path as for lossless modes, one joining at a time where it explains most of what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..regression.damped import Band, DampedProjection, DampedResponse, DampedRows, refine_damped
from ..regression.frequency_rows import FrequencyRows
from ..regression.variable_projection import Problem
from ..uncertainty.residual_data import without_peaks
from ..uncertainty.whiteness import ljung_box
from .response_candidates import ranked_candidates
from .steps import Report, Step, more_than_noise

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_LAGS = 20
_WHITE = 1e-3  # p-value


class DampedData(Protocol):
    """Experiments in which damped modes are looked for."""

    def rows(self, d: Array, sigma: Array) -> list[DampedRows]:
        """Rows of the linear problem that tell of these modes."""

    def left(self, at: DampedProjection) -> list[ComplexArray]:
        """What a model leaves of each experiment, at all its bins or points."""

    def loss(self, left: Sequence[ComplexArray]) -> float:
        """Sum of squares, over the data as they were measured."""

    def sequences(self, left: Sequence[ComplexArray]) -> list[Array]:
        """Real residuals in the order in which white noise is white; NaN where missing."""

    def ranked(self, left: list[ComplexArray]) -> tuple[Array, Array]:
        """Frequencies at which one more mode explains most, and how much."""


class Responses:
    """Frequency responses."""

    def __init__(self, experiments: Sequence[FrequencyRows]) -> None:
        self._responses: list[DampedRows] = [DampedResponse(one) for one in experiments]
        self.experiments = experiments

    def rows(self, d: Array, sigma: Array) -> list[DampedRows]:
        """All points."""
        return self._responses

    def left(self, at: DampedProjection) -> list[ComplexArray]:
        """What a model leaves, in the scale of the weights."""
        found = []
        for rows, own in zip(self._responses, at.own, strict=True):
            found.append(rows.target - own @ rows.own(at.d, at.sigma) - at.kappa @ rows.shared(at.d, at.sigma))
        return found

    def loss(self, left: Sequence[ComplexArray]) -> float:
        """Weighted sum of squares."""
        return float(sum(np.sum(np.abs(one) ** 2) for one in left))

    def sequences(self, left: Sequence[ComplexArray]) -> list[Array]:
        """Real and imaginary parts from point to point, without the few that outweigh all others."""
        return [without_peaks(part) for one in left for part in (one.real, one.imag)]

    def ranked(self, left: list[ComplexArray]) -> tuple[Array, Array]:
        """Candidates between the points."""
        return ranked_candidates(self.experiments, left)


def damped_data(problem: Problem) -> Responses:
    """The responses of a problem, for damped modes."""
    return Responses([one for one in problem.experiments if isinstance(one, FrequencyRows)])


class DampedSearch:
    """Search for damped modes; what is known of their decay rates is kept with their frequencies."""

    def __init__(self, problem: Problem, data: DampedData) -> None:
        self.problem, self.data = problem, data
        self.band = Band(problem.bin, problem.ceiling)
        self._decay: dict[float, float] = {}

    @property
    def affords_batches(self) -> bool:
        """Modes join one at a time."""
        return False

    def unconvinced(self, step: Step) -> bool:
        """Whether what is left shows a mode that noise alone would hardly show anywhere."""
        return more_than_noise(self.problem, step)

    def refined(self, d: Array) -> DampedProjection:
        """The best damped modes near these frequencies."""
        sigma = np.array([self._decay.get(float(one), np.nan) for one in d])
        at = refine_damped(self.data.rows, d, sigma, self.band)
        self._decay.update(zip(at.d.tolist(), at.sigma.tolist(), strict=True))
        return at

    def step(self, d: Array, rtol: float, report: Report | None = None, sigma: Array | None = None) -> Step:
        """Refine modes from a start, with decay rates if they are known, and look for more."""
        if sigma is not None:
            self._decay.update(zip(d.tolist(), sigma.tolist(), strict=True))
        at = self.refined(d)
        left = self.data.left(at)
        none = np.zeros(len(at.d), bool)
        coloured = ljung_box(self.data.sequences(left), _LAGS) < _WHITE
        ranked = self.data.ranked(left)
        return Step(at.d, self.data.loss(left), 1, True, *ranked, none, np.abs(at.kappa), coloured=coloured)

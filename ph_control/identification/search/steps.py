"""The search for modes: one at a time, each where it explains most of what is left, all refined together.

Short records are refined in time at every step.  Of long ones the bins about the modes are enough until the end, so
that a step costs little more than a look at the transform.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from scipy.special import chdtrc

from ..._types import Array, Mask
from ..regression.spectral_rows import Spectrum, Window
from ..regression.time_rows import RecordRows
from ..regression.tuning import TUNING
from ..regression.variable_projection import Interrupted, Problem, refine
from .circumstances import autoregression, correlations, input_noise, meeting
from .screening import Screen

Report = Callable[[int, float], None]  # iteration, loss

_ABOUT = np.linspace(-1.0, 1.0, 9)  # bins from a peak


@dataclass(frozen=True, eq=False)
class Step:
    """Some modes, refined: what they leave as a sum of squares, and the candidates for one more.

    `candidates` are natural frequencies by how much a mode there would explain, the most first, and `gains` how much;
    `held` tells which residues are held at 0, and `weights` how much each mode contributes, in order to compare them;
    `coloured`, that what is left is no noise, and of a response so much that no criterion can judge the order yet;
    `correlations` are the sums of products of what is left with its past, of so many `samples` at least;
    `crowding` the records in which one more mode would only stand beside another.
    """

    d: Array
    loss: float
    iterations: int
    converged: bool
    candidates: Array
    gains: Array
    held: Mask
    weights: Array
    coloured: bool = False
    correlations: Array = field(default_factory=lambda: np.zeros(1))
    samples: int = 0
    crowding: tuple[RecordRows, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """The records stay where they are."""
        return {**self.__dict__, "crowding": ()}

    @cached_property
    def foretold(self) -> Array:
        """Variance of what is left that its own past does not foretell, by the length of that past."""
        return autoregression(self.correlations, self.samples)[1]

    @cached_property
    def noisy(self) -> float:
        """What noise on the input would gain in log-likelihood, where modes crowd; worked out when asked for."""
        return input_noise(self.crowding, self.d)[-1] if self.crowding else 0.0


class Search:
    """How modes are added to a problem; all `steps` are kept for who interrupts."""

    affords_batches = False  # whether several modes may join at once

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.steps: list[Step] = []

    def unconvinced(self, step: Step) -> bool:
        """Whether what is left shows a mode that noise alone would hardly show anywhere."""
        return more_than_noise(self.problem, step)

    def step(self, d: Array, rtol: float, report: Report | None = None) -> Step:
        """Refine modes from a start and look for more."""
        try:
            self.steps.append(self._refined(d, rtol, report))
        except Interrupted as cut:
            at, none = self.problem.project(cut.x), np.zeros(0)
            self.steps.append(Step(at.d, at.loss, 0, False, none, none, ~at.free, at.energies))
            raise
        return self.steps[-1]

    def _refined(self, d: Array, rtol: float, report: Report | None) -> Step:
        raise NotImplementedError


class TimeSearch(Search):
    """Search in records of time."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._experiments = [one for one in problem.experiments if isinstance(one, RecordRows)]
        self._spectra = [Spectrum.of(one) for one in self._experiments]
        self._screen = Screen(self._spectra, problem.signed)
        self._windowed = max(len(one.u) for one in self._experiments) > TUNING.in_time and all(
            one.complete and one.offset < 2 for one in self._experiments
        )
        self._arrivals: dict[tuple[str, int], float] = {}
        self._slow = TUNING.slow * max(one.bin for one in self._experiments)
        self.affords_batches = max(len(one.u) for one in self._experiments) >= TUNING.long_enough

    def _posed(self, d: Array, intersample: str | None = None) -> Problem:
        """All of the records, or of long ones the bins about some modes; also with an input held otherwise."""
        problem = self.problem if intersample is None else meeting(self.problem, intersample)
        # the bins about a slow mode are few, and what it has in common with a constant is not among them
        if not self._windowed or np.any(d < self._slow):
            return problem
        pairs = zip(self._spectra, problem.experiments, strict=True)
        windows = (Window.about(replace(one, record=cast(RecordRows, rows)), d) for one, rows in pairs)
        return Problem(tuple(windows), problem.signed)

    def _refined(self, d: Array, rtol: float, report: Report | None) -> Step:
        problem = self._posed(d)
        end = refine(problem, d, rtol=rtol, last=False, progress=report)
        at, loss, left = end.projection, end.projection.loss, [one.Y for one in self._spectra]
        if problem is self.problem:
            pairs = zip(self._experiments, at.predicted(), strict=True)
            left = [np.fft.rfft(np.where(one.observed, one.y - predicted, 0.0)) for one, predicted in pairs]
        else:
            if len(d):
                windows = (one for one in problem.experiments if isinstance(one, Window))
                left = [one.at(at.d).left(at.kappa, own) for one, own in zip(windows, at.own, strict=True)]
            left = [one.beside_offset(residual) for one, residual in zip(self._spectra, left, strict=True)]
            loss = sum(one.energy(residual) for one, residual in zip(self._spectra, left, strict=True))
        lengths = [len(one.u) for one in self._experiments]
        step = Step(
            at.d, loss, end.iterations, end.converged, *self._screen.ranked(left),
            ~at.free, at.energies, correlations=correlations(left, lengths), samples=min(lengths),
        )  # fmt: skip
        crowding = loss > self.problem.rounding and crowds(step, self.problem)
        return replace(step, crowding=tuple(self._experiments)) if crowding else step

    def slow(self, step: Step) -> bool:
        """Whether what would join next is as slow as a constant or a drift, and more than noise."""
        return bool(len(step.candidates) and step.candidates[0] < self._slow and self.unconvinced(step))

    def arrival(self, first: Step, intersample: str, delay: int) -> float:
        """Log-likelihood of single modes at the peaks of the output, where the input arrives at other instants.

        Each peak is looked at alone, so that modes which a wrong arrival has misled have no part in it.
        """
        if (intersample, delay) not in self._arrivals:
            self._arrivals[intersample, delay] = self._arrival(first, intersample, delay)
        return self._arrivals[intersample, delay]

    def _arrival(self, first: Step, intersample: str, delay: int) -> float:
        peaks: list[float] = []
        band = self.problem.bin
        for d in first.candidates.tolist():
            if all(abs(d - other) > 2 * TUNING.half_width * band for other in peaks):
                peaks.append(d)
        places = (np.array(peaks)[:, None] + band * _ABOUT).clip(band * _ABOUT[-1], self.problem.ceiling)
        spectra = []
        for one, met in zip(self._spectra, meeting(self.problem, intersample).experiments, strict=True):
            turn = np.exp(-2j * np.pi * delay / one.length * np.arange(len(one.U)))
            spectra.append(Spectrum(cast(RecordRows, met), one.U * turn, one.Y))
        left = [one.beside_offset(one.Y) for one in spectra]
        gains, total = Screen(spectra, self.problem.signed).at_peaks(places.ravel(), left)
        unexplained = np.min((total - gains).reshape(places.shape), axis=1)
        return -float(TUNING.half_width * np.sum(np.log(np.maximum(unexplained, np.finfo(float).tiny))))

    def likelihood(self, step: Step, intersample: str) -> float:
        """Log-likelihood of the modes of a step, but for a constant, with an input held otherwise."""
        problem, own = self._posed(step.d, intersample), self._experiments[0].hold.intersample
        known = isinstance(problem.experiments[0], RecordRows) and intersample == own
        loss = step.loss if known else problem.project(step.d).loss
        return -0.5 * problem.samples * float(np.log(max(loss / problem.samples, np.finfo(float).tiny)))


def crowds(step: Step, problem: Problem) -> bool:
    """Whether one more mode would stand beside another, as it does to mimic what no mode is."""
    if not len(step.d) or not len(step.candidates):
        return False
    return bool(np.min(np.abs(step.d - step.candidates[0])) < TUNING.crowding * problem.bin)


def more_than_noise(problem: Problem, step: Step) -> bool:
    """Whether what is left shows a mode that noise alone would hardly show anywhere."""
    gain = float(step.gains[0]) if len(step.gains) else 0.0
    return stands_out(gain, step.loss, problem.samples, problem.unknowns(len(step.d)), problem.unknowns(1))


def stands_out(gain: float, loss: float, samples: int, unknowns: int, more: int) -> bool:
    """Whether noise alone would hardly let a mode with so many unknowns `more` gain as much anywhere in the band."""
    spare = samples - unknowns
    return bool(spare > 0 and loss > 0 and chdtrc(more, gain * spare / loss) * samples < TUNING.by_chance)

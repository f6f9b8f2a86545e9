"""Outputs alone, under forces that nobody measured: modes by the likelihood of a stationary process.

    y = C x + e,    x' = A x + K e            e white: wind, traffic, the sea, a machine at work

Models of ascending order come from canonical variates of the correlations; those that the criterion prefers are
refined by maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._types import Array, ComplexArray
from ..data.channels import Recording
from ..search.criteria import Criteria
from ..search.progress import Report
from .minimum import Evaluation, Experiment, Minimum, Point, Problem, minimise
from .noise_sections import NoiseSections
from .subspace import CanonicalVariates, correlations, in_sections

_ROWS = 300  # of a covariance of the past
_HORIZONS = (1.0, 0.5, 0.25)  # of the longest past
_SAMPLES_EACH = 10  # of the records for each sample of the past
_CLOSE = 3  # models that are refined before the criterion chooses
_NEAR = 60.0  # of the smallest BIC: what refinement may make up for
_STEPS = 12  # of these
_BINS = 1 << 14  # that orders are compared in
_PATIENCE = 8  # states more without a better criterion


@dataclass(frozen=True, eq=False)
class AmbientOrder:
    """The best model of a number of states on the way, and its criteria in units of the scaled outputs."""

    noise: NoiseSections
    criteria: Criteria

    @property
    def unknowns(self) -> int:
        """Number of unknowns, of the covariance as well."""
        p = len(self.noise.C)
        return self.noise.unknowns + len(self.noise.sections.x) + p * (p + 1) // 2

    def loss(self, samples: int) -> float:
        """Geometric mean of the squared prediction errors, of so many samples of each output."""
        loglik = 0.5 * (2 * self.unknowns - self.criteria.aic)
        return float(np.exp(-2 * loglik / (samples * len(self.noise.C)) - 1) / (2 * np.pi))

    @property
    def bic(self) -> float:
        """Value of that criterion."""
        return self.criteria.bic

    @property
    def order(self) -> int:
        """Number of modes."""
        return int(np.sum(self.noise.sections.p.imag > 0))


@dataclass(frozen=True, eq=False)
class AmbientFit:
    """Modes of outputs alone.

    Attributes
    ----------
    minimum : Minimum
        Where the likelihood is largest, of outputs less their means, divided by `scales`.
    scales, means : ndarray, shapes (p,) and (E, p)
        Standard deviation of each output, and its mean in each experiment.
    orders : tuple of AmbientOrder
        Models of ascending order, as their canonical variates have them.
    """

    minimum: Minimum
    scales: Array
    means: Array
    orders: tuple[AmbientOrder, ...]

    @property
    def evaluation(self) -> Evaluation:
        """Prediction errors of the model."""
        return self.minimum.evaluation

    @property
    def samples(self) -> int:
        """Number of samples of all outputs."""
        return self.evaluation.problem.samples * len(self.scales)

    @cached_property
    def criteria(self) -> Criteria:
        """Likelihood in the units of the data, and the criteria made of it."""
        size = self.evaluation.problem.samples * float(np.sum(np.log(self.scales)))
        unknowns = self.evaluation.unknowns + self.means.size
        return Criteria.of(-0.5 * self.evaluation.cost - size, unknowns, float(self.samples))


def ambient_fit(
    channels: Sequence[Recording], *, order: int | None = None, real_poles: int | None = None, max_order: int = 20,
    criterion: str = "bic", reports: Callable[[int], Report | None] = lambda order: None,
) -> AmbientFit | None:  # fmt: skip
    """Fit modes to outputs alone.

    Parameters
    ----------
    channels : sequence of Recording
        Records without inputs and without missing samples, of the same outputs and the same step.
    order, real_poles : int, optional
        Numbers of modes and of real poles; by default those that the criterion prefers.
    max_order : int
        Largest number of modes.
    criterion : {'bic', 'aicc', 'aic'}
        What chooses.
    reports : callable, optional
        Called with a number of modes, to give what is called with each iteration, and the mean squared prediction error
        of outputs of unit variance.

    Returns
    -------
    AmbientFit or None
        None where the records are too short for any model.

    Notes
    -----
    Exact Gaussian maximum likelihood but for the first samples, whose motion is estimated.  O(T p^2 N) a model of N
    states on the way, O(T p^3 N^2) a step of those that are refined.
    """
    outputs = [channel.y - channel.y.mean(axis=1, keepdims=True) for channel in channels]
    samples = sum(y.shape[1] for y in outputs)
    scales = np.sqrt(sum(np.sum(y**2, axis=1) for y in outputs) / samples)
    outputs = [y / scales[:, None] for y in outputs]
    problem = Problem([Experiment.of_outputs(y) for y in outputs], np.zeros((0, len(scales)), bool))
    shortest = min(y.shape[1] for y in outputs)
    longest = min(_ROWS // len(scales), shortest // 4, samples // (_SAMPLES_EACH * len(scales)))
    if longest < 2:
        return None
    R = sum(correlations(y, 2 * longest) for y in outputs) / samples
    best: dict[int, AmbientOrder] = {}
    most = 2 * max_order if order is None else 2 * order + 4
    coarse = [experiment.thinned(max(1, len(experiment.z) // _BINS)) for experiment in problem.experiments]
    coarse_problem = Problem(coarse, problem.active)
    for share in _HORIZONS:
        horizon = max(2, round(share * longest))
        variates, worse = CanonicalVariates(R[: 2 * horizon + 1]), 0
        for states in range(1, min(most, variates.largest // 2) + 1):
            model = _started(coarse_problem, variates, states)
            least = min((known.bic for known in best.values()), default=np.inf)
            worse = 0 if model is not None and model.bic < least else worse + 1
            if model is not None and (states not in best or model.bic < best[states].bic):
                best[states] = model
            if model is not None and (report := reports(model.order)) is not None:
                report(states, model.loss(samples))
            if order is None and worse > _PATIENCE:
                break
    fitting = [model for model in best.values() if _has(model.noise, order, real_poles) and model.order <= max_order]
    if not fitting:
        return None
    least = min(model.bic for model in fitting)
    close = [model for model in sorted(fitting, key=lambda model: model.bic)[:_CLOSE] if model.bic < least + _NEAR]
    refined = [minimise(problem, _point(problem, model.noise), steps=_STEPS) for model in close]
    chosen = min(refined, key=lambda minimum: _criteria(minimum.evaluation).by_name(criterion))
    end = minimise(problem, chosen.evaluation.point)
    means = np.stack([channel.y.mean(axis=1) for channel in channels])
    return AmbientFit(end, scales, means, tuple(best[states] for states in sorted(best)))


def _has(noise: NoiseSections, order: int | None, real_poles: int | None) -> bool:
    poles = noise.sections.p
    modes, real = int(np.sum(poles.imag > 0)), int(np.sum(poles.imag == 0))
    return (order is None or modes == order) and (real_poles is None or real == real_poles)


def _started(problem: Problem, variates: CanonicalVariates, states: int) -> AmbientOrder | None:
    matrices = variates.model(states)
    noise = None if matrices is None else in_sections(*matrices, 1.0)
    if noise is None:
        return None
    evaluation = problem.at(_point(problem, noise))
    return AmbientOrder(noise, _criteria(evaluation)) if np.isfinite(evaluation.cost) else None


def _point(problem: Problem, noise: NoiseSections) -> Point:
    states = tuple(np.zeros(noise.states) for _ in problem.experiments)
    return Point(noise, np.zeros((0, len(noise.C))), (), states)


def _criteria(evaluation: Evaluation) -> Criteria:
    rows = float(evaluation.problem.samples * evaluation.p)
    return Criteria.of(-0.5 * evaluation.cost, evaluation.unknowns, rows)


def shapes_of(noise: NoiseSections) -> ComplexArray:
    """Shapes (n, p) of the modes in their order in `sections.p`: what outputs see of the motion `exp(p t)`."""
    sections = noise.sections
    modes = np.flatnonzero(sections.square > 0)
    turn = 1j * np.sqrt(sections.square[modes]) / noise.references[modes]
    return np.asarray((noise.C[:, 2 * modes] + turn * noise.C[:, 2 * modes + 1]).T)



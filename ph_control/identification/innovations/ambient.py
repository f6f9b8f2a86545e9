"""Outputs alone, under forces that nobody measured: modes by the likelihood of a stationary process.

    y = C x + e,    x' = A x + K e            e white: wind, traffic, the sea, a machine at work

Models of ascending order come from canonical variates of the correlations; those that the criterion prefers are
refined by maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._heartbeat import Report
from ..._types import Array, ComplexArray, Indices, Mask
from ..data.channels import Recording, bridged, missing_in
from ..search.fitted_modes import Criteria
from ..search.predictor_states import cross_correlations, longest_past
from .minimum import Experiment, InnovationsModel, LikelihoodEvaluation, Minimum, Problem, minimise
from .noise_sections import NoiseSections
from .set_ups import SetUpsProblem
from .subspace import CanonicalVariates, in_sections

_ROWS = 300  # of a covariance of the past
_HORIZONS = (1.0, 0.5, 0.25)  # of the longest past
_CLOSE = 3  # models that are refined before the criterion chooses
_NEAR = 60.0  # of the smallest BIC: what refinement may make up for
_STEPS = 12  # of these
_GAIN = 1e-3  # of twice the log-likelihood by the last step, for each number that moves
_BINS = 1 << 14  # that orders are compared in
_REAL = 4  # real poles at most beside modes whose number is given
_SAME = 1e-13  # of the variance of outputs: what others leave of one that is a combination of these
_PATIENCE = 8  # states more without a better criterion
_ROUGH = 20.0  # what a step gains at least before models of set-ups are compared
_FEW = 3  # of these more without a better criterion
_ROUNDS = 5  # of a fit, and of missing samples in its noise, in turn
_SETTLED = 0.02  # of the prediction errors: change of missing samples


@dataclass(frozen=True, eq=False)
class AmbientOrder:
    """The best model of a number of states on the way, and its criteria in units of the scaled outputs."""

    noise: NoiseSections
    criteria: Criteria
    loss: float  # geometric mean of the squared prediction errors

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
        Standard deviation of each output, and its mean in each experiment, NaN where it was not measured.
    orders : tuple of AmbientOrder
        Models of ascending order, as their canonical variates have them.
    outputs : tuple of ndarray, shapes (p, T)
        Outputs of each experiment, with the likeliest values of samples that are missing.
    missing : ndarray, shape (p,)
        How many samples of each output these are.
    """

    minimum: Minimum
    scales: Array
    means: Array
    orders: tuple[AmbientOrder, ...]
    outputs: tuple[Array, ...]
    missing: Indices

    @property
    def evaluation(self) -> LikelihoodEvaluation:
        """Prediction errors of the model."""
        return self.minimum.evaluation

    @property
    def noise(self) -> NoiseSections:
        """Sections, and what outputs see and predict of them."""
        return self.evaluation.point.noise

    @property
    def order(self) -> int:
        """Number of modes."""
        return int(np.sum(self.noise.sections.p.imag > 0))

    @property
    def samples(self) -> int:
        """Number of samples of all outputs."""
        return self.evaluation.values

    @property
    def unknowns(self) -> int:
        """Number of unknowns, means and covariance among them."""
        return self.evaluation.unknowns + int(np.isfinite(self.means).sum())

    @property
    def spare(self) -> int:
        """Samples that were measured beyond the unknowns; 1 at least."""
        return max(1, self.measured - self.unknowns)

    @property
    def measured(self) -> int:
        """Number of samples that were measured."""
        return self.samples - int(self.missing.sum())

    @property
    def size(self) -> float:
        """Sum of the logarithms of the scales, of all samples."""
        return sum(
            evaluation.problem.samples * float(np.sum(np.log(self.scales[outputs])))
            for outputs, _, evaluation in self.evaluation.by_set_up
        )

    @cached_property
    def criteria(self) -> Criteria:
        """Likelihood in the units of the data, and the criteria made of it; of what was measured."""
        size = self.size - float(self.missing @ np.log(self.scales))
        loglik = -0.5 * self.evaluation.cost * (self.measured / self.samples) - size
        return Criteria.of(loglik, self.unknowns, float(self.measured))

    @property
    def variances(self) -> Array:
        """Variance (p,) of the prediction errors of each output, in units of the data."""
        squares, counts = np.zeros((2, len(self.scales)))
        for outputs, _, evaluation in self.evaluation.by_set_up:
            squares[outputs] += evaluation.problem.samples * np.diag(evaluation.covariance)
            counts[outputs] += evaluation.problem.samples
        return np.asarray(squares / counts * self.scales**2)

    @property
    def cut(self) -> AmbientFit:
        """The same after an interruption."""
        return replace(self, minimum=replace(self.minimum, interrupted=True))

    def with_real_shapes(self) -> AmbientFit:
        """The fit of modes each of which moves outputs in phase, or opposed."""
        problem = self.evaluation.problem.with_real_shapes()
        point = replace(self.evaluation.point, noise=self.noise.of_real_shapes())
        return replace(self, minimum=minimise(problem, point, _tolerance(problem, point)))


def ambient_fit(
    channels: Sequence[Recording], *, order: int | None = None, real_poles: int | None = None, max_order: int = 20,
    criterion: str = "bic", reports: Callable[[int], Report | None] = lambda order: None,
) -> AmbientFit | None:  # fmt: skip
    """Fit modes to outputs alone.

    Parameters
    ----------
    channels : sequence of Recording
        Records without inputs, of the same step and the same outputs, each of which was measured in a record, but for
        some samples, or not at all.
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
        None where the records are too short for any model, an output is a combination of others, or none was measured
        in all of them.

    Notes
    -----
    Exact Gaussian maximum likelihood but for the first samples, whose motion is estimated.  O(T p^2 N) a model of N
    states on the way, O(T p^3 N^2) a step of those that are refined.  Missing samples are unknowns of the likelihood:
    a fit, and their values in its noise, in turn; the last of these fits compares models that are nearly as likely.
    """
    missing = [missing_in(channel.y) for channel in channels]
    counts = np.sum([each.sum(axis=1) for each in missing], axis=0)

    def fitted(outputs: Sequence[Array], last: bool) -> AmbientFit | None:
        data = _Standardised.of(outputs)
        if data.longest < 2 or not (len(data.references) and data.is_independent):
            return None
        more = real_poles if real_poles is not None else _REAL if order is not None else 1
        most = 2 * (max_order if order is None else order) + more
        models = data.models(most, order is None, reports, _HORIZONS if last else _HORIZONS[:1])
        fitting = [model for model in models.best if _has(model.noise, order, real_poles) and model.order <= max_order]
        if not fitting:
            return None
        least = min(model.bic for model in fitting)
        few = sorted(fitting, key=lambda model: model.bic)[: _CLOSE if last else 1]
        close = [model for model in few if model.bic < least + _NEAR]
        end = _refined(data.problem, close, criterion, reports, models.interrupted)
        return AmbientFit(end, data.scales, data.means, models.best, tuple(outputs), counts)

    last = not counts.any()
    fit = fitted([bridged(channel.y) for channel in channels], last)
    for further in reversed(range(_ROUNDS)):
        if last or fit is None or fit.minimum.interrupted:
            break
        outputs = _completed(fit, missing)
        last = not further or _are_settled(outputs, fit, missing)
        fit = fitted(outputs, last)
    return fit


def _are_settled(outputs: Sequence[Array], fit: AmbientFit, missing: Sequence[Mask]) -> bool:
    """Whether values of missing samples differ by far less than the noise from those that a fit was made with."""
    moved = [((y - old) ** 2)[gaps] for y, old, gaps in zip(outputs, fit.outputs, missing, strict=True)]
    sizes = [np.broadcast_to(fit.variances[:, None], gaps.shape)[gaps] for gaps in missing]
    return bool(np.sum(np.concatenate(moved)) < _SETTLED**2 * np.sum(np.concatenate(sizes)))


def errors_beside(fit: AmbientFit, missing: Sequence[Mask]) -> list[Array]:
    """Prediction errors (p, T) of each experiment in units of the data, with the likeliest values of some samples.

    NaN of outputs that were not measured.
    """
    every, completed = [np.full(y.shape, np.nan) for y in fit.outputs], _completed(fit, missing)
    for outputs, members, evaluation in fit.evaluation.by_set_up:
        scales, experiments = fit.scales[outputs, None], evaluation.problem.experiments
        for place, errors, experiment in zip(members.tolist(), evaluation.errors, experiments, strict=True):
            if missing[place].any():
                moved = np.fft.rfft((completed[place] - fit.outputs[place])[outputs] / scales)
                moved = evaluation.point.noise.errors(experiment.z, moved / np.sqrt(experiment.samples))
                errors = errors + moved
            every[place][outputs] = np.fft.irfft(errors, experiment.samples) * np.sqrt(experiment.samples) * scales
    return every


def _completed(fit: AmbientFit, missing: Sequence[Mask]) -> list[Array]:
    """Outputs (p, T) of each experiment with the values of missing samples that are likeliest in the noise of a fit."""
    completed = [y.copy() for y in fit.outputs]
    for outputs, members, evaluation in fit.evaluation.by_set_up:
        noise, scales = evaluation.point.noise, fit.scales[outputs, None]
        for place, errors, experiment in zip(
            members.tolist(), evaluation.errors, evaluation.problem.experiments, strict=True
        ):
            gaps, samples = missing[place][outputs], experiment.samples
            if not gaps.any():
                continue
            before = np.fft.irfft(errors, samples) * np.sqrt(samples)
            change = noise.likeliest_change(before, evaluation.covariance, gaps)
            y = completed[place][outputs]
            y[gaps] += change * np.broadcast_to(scales, gaps.shape)[gaps]
            completed[place][outputs] = y
    return completed


def _refined(
    problem: Problem, close: Sequence[AmbientOrder], criterion: str, reports: Callable[[int], Report | None],
    interrupted: bool,
) -> Minimum:  # fmt: skip
    """The best of a few models, at its maximum of the likelihood unless interrupted."""
    refined = list[Minimum]()
    for model in close[:1] if interrupted else close:
        start, steps = _point(problem, model.noise), 0 if interrupted else _STEPS
        refined.append(minimise(problem, start, _tolerance(problem, start), steps, _telling(reports, start)))
        interrupted = interrupted or refined[-1].interrupted
        if interrupted:
            break
    chosen = min(refined, key=lambda minimum: _criteria(minimum.evaluation).by_name(criterion))
    if interrupted:
        return replace(chosen, interrupted=True)
    start = chosen.evaluation.point
    if chosen.converged:
        return chosen
    return minimise(problem, start, _tolerance(problem, start), report=_telling(reports, start))


def _tolerance(problem: Problem, start: InnovationsModel) -> float:
    """What the last step may still gain: far less than the errors of the numbers, of which each gains about 1."""
    return _GAIN * len(problem.vector(start))


def _telling(
    reports: Callable[[int], Report | None], start: InnovationsModel
) -> Callable[[int, LikelihoodEvaluation], None]:
    """What tells of the steps of a minimisation."""
    report = reports(int(np.sum(start.poles.imag > 0)))

    def tell(step: int, evaluation: LikelihoodEvaluation) -> None:
        if report is not None:
            report(step, _loss(evaluation))

    return tell


@dataclass(frozen=True, eq=False)
class _Models:
    """Models of ascending numbers of states, from the canonical variates that suit each best."""

    best: tuple[AmbientOrder, ...]
    interrupted: bool


@dataclass(frozen=True, eq=False)
class _Standardised:
    """Records less their means, of variance 1, and the longest past that they show.

    `outputs` are those that each record shows, at their places `shown` among all.
    """

    problem: Problem
    outputs: list[Array]
    shown: list[Indices]
    scales: Array
    means: Array

    @classmethod
    def of(cls, recorded: Sequence[Array]) -> _Standardised:
        """Those of outputs (p, T) of some records, NaN where one was not measured."""
        means = np.stack([y.mean(axis=1) for y in recorded])
        shown = [np.flatnonzero(np.isfinite(mean)) for mean in means]
        triples = zip(recorded, means, shown, strict=True)
        outputs = [y[rows] - mean[rows, None] for y, mean, rows in triples]
        squares, counts = np.zeros((2, means.shape[1]))
        for rows, y in zip(shown, outputs, strict=True):
            squares[rows] += np.sum(y**2, axis=1)
            counts[rows] += y.shape[1]
        scales = np.sqrt(squares / counts)
        outputs = [y / scales[rows, None] for rows, y in zip(shown, outputs, strict=True)]
        problem = Problem([Experiment.of_outputs(y) for y in outputs], np.zeros((0, len(scales)), bool))
        if any(len(rows) < len(scales) for rows in shown):
            problem = SetUpsProblem(problem, shown)
        return cls(problem, outputs, shown, scales, means)

    @property
    def references(self) -> Indices:
        """Outputs that all records show."""
        return np.flatnonzero(np.isfinite(self.means).all(axis=0))

    @property
    def is_independent(self) -> bool:
        """Whether no output is a combination of others."""
        together = len(self.references) == len(self.scales)
        parts = [np.concatenate(self.outputs, axis=1)] if together else self.outputs
        return all(np.linalg.eigvalsh(y @ y.T / y.shape[1]).min() > len(y) * _SAME for y in parts)

    @property
    def longest(self) -> int:
        """Samples of the longest past."""
        return longest_past(self.outputs, _ROWS)

    def models(
        self, most: int, automatic: bool = False, reports: Callable[[int], Report | None] = lambda order: None,
        horizons: Sequence[float] = _HORIZONS,
    ) -> _Models:  # fmt: skip
        """Models of up to so many states; none beyond those that the criterion prefers, where that is to choose."""
        if isinstance(self.problem, SetUpsProblem):
            return self._models_of_set_ups(self.problem.thinned(_BINS), most, automatic, reports)
        samples = self.problem.samples
        R = np.asarray(sum(cross_correlations(y, 2 * self.longest) for y in self.outputs)) / samples
        coarse = self.problem.thinned(_BINS)
        nothing = _judged(coarse, NoiseSections.without_states(len(self.scales)))
        best = {0: nothing} if nothing is not None else {}
        try:
            for share in horizons:
                horizon = max(2, round(share * self.longest))
                variates, worse = CanonicalVariates(R[: 2 * horizon + 1]), 0
                for states in range(1, min(most, variates.largest // 2) + 1):
                    model = _started(coarse, variates, states)
                    least = min((known.bic for known in best.values()), default=np.inf)
                    worse = 0 if model is not None and model.bic < least else worse + 1
                    if model is not None:
                        kept = model.noise.states  # less those that no continuous motion has
                        best[kept] = min(best.get(kept, model), model, key=lambda each: each.bic)
                        if (report := reports(model.order)) is not None:
                            report(states, model.loss)
                    if automatic and worse > _PATIENCE:
                        break
        except KeyboardInterrupt:
            return _Models(tuple(best[states] for states in sorted(best)), True)
        return _Models(tuple(best[states] for states in sorted(best)), False)

    def _models_of_set_ups(
        self, coarse: SetUpsProblem, most: int, automatic: bool, reports: Callable[[int], Report | None]
    ) -> _Models:
        """Models near to their maximum of the likelihood.

        They begin with those of the outputs that all records show, which may be at the nodes of a mode, and of each
        set-up by itself.
        """
        parts = [self._among(np.arange(len(self.outputs)), self.references)]
        parts += [self._among(each.members, each.outputs) for each in coarse.set_ups]
        begun, interrupted = dict[int, list[InnovationsModel]](), False
        for part in parts:
            models = part.models(most, automatic, reports, _HORIZONS if part is parts[0] else _HORIZONS[1:2])
            for model in models.best:
                noise = part.seen_by(self.references, model.noise)
                if noise is not None:
                    begun.setdefault(noise.states, []).append(coarse.extended(noise, self.references))
            interrupted = interrupted or models.interrupted
        best = list[AmbientOrder]()
        for states in sorted(begun):
            start = min(begun[states], key=lambda point: coarse.evaluated(point).cost)
            end = minimise(coarse, start, _ROUGH, 0 if interrupted else _STEPS)
            if np.isfinite(end.evaluation.cost):
                best.append(_order_of(end.evaluation))
            interrupted = interrupted or end.interrupted
            if automatic and len(best) > _FEW and min(best, key=lambda each: each.bic) not in best[-_FEW:]:
                break
        return _Models(tuple(best), interrupted)

    def _among(self, members: Indices, rows: Indices) -> _Standardised:
        """Some of the outputs of some of the records, which all show them."""
        outputs = [self.outputs[place][np.searchsorted(self.shown[place], rows)] for place in members.tolist()]
        problem = Problem([Experiment.of_outputs(y) for y in outputs], np.zeros((0, len(rows)), bool))
        shown = [rows] * len(outputs)
        return _Standardised(problem, outputs, shown, self.scales[rows], self.means[np.ix_(members, rows)])

    def seen_by(self, rows: Indices, noise: NoiseSections) -> NoiseSections | None:
        """What some of the outputs of records that show the same see of a model; None where they have no predictor."""
        places = np.searchsorted(self.shown[0], rows)
        if len(places) == len(self.shown[0]):
            return noise
        return noise.seen_by(places, self.problem.evaluated(_point(self.problem, noise)).covariance)


def orders_of(channels: Sequence[Recording], most: int) -> list[tuple[ComplexArray, ComplexArray]]:
    """Poles (n,) and shapes (n, p) of models of 1, 2, .. modes, per unit time and in units of the outputs."""
    data, step = _Standardised.of([bridged(channel.y) for channel in channels]), channels[0].dt
    orders = list[tuple[ComplexArray, ComplexArray]]()
    if data.longest < 2:
        return orders
    models = data.models(2 * most + _REAL).best
    for count in range(1, most + 1):
        fitting = [model for model in models if model.order == count]
        if fitting:
            noise = min(fitting, key=lambda model: model.bic).noise
            poles = noise.sections.p
            orders.append((poles[poles.imag > 0] / step, shapes_of(noise) * data.scales))
    return orders


def _has(noise: NoiseSections, order: int | None, real_poles: int | None) -> bool:
    poles = noise.sections.p
    modes, real = int(np.sum(poles.imag > 0)), int(np.sum(poles.imag == 0))
    return (order is None or modes == order) and (real_poles is None or real == real_poles)


def _started(problem: Problem, variates: CanonicalVariates, states: int) -> AmbientOrder | None:
    matrices = variates.model(states)
    noise = None if matrices is None else in_sections(*matrices, 1.0)
    return None if noise is None else _judged(problem, noise)


def _judged(problem: Problem, noise: NoiseSections) -> AmbientOrder | None:
    evaluation = problem.evaluated(_point(problem, noise))
    return _order_of(evaluation) if np.isfinite(evaluation.cost) else None


def _order_of(evaluation: LikelihoodEvaluation) -> AmbientOrder:
    return AmbientOrder(evaluation.point.noise, _criteria(evaluation), _loss(evaluation))


def _loss(evaluation: LikelihoodEvaluation) -> float:
    """Geometric mean of the squared prediction errors."""
    return float(np.exp(evaluation.cost / evaluation.values - 1) / (2 * np.pi))


def _point(problem: Problem, noise: NoiseSections) -> InnovationsModel:
    states = tuple(np.zeros(noise.states) for _ in problem.experiments)
    return InnovationsModel(noise, np.zeros((0, len(noise.C))), (), states)


def _criteria(evaluation: LikelihoodEvaluation) -> Criteria:
    return Criteria.of(-0.5 * evaluation.cost, evaluation.unknowns, float(evaluation.values))


def shapes_of(noise: NoiseSections) -> ComplexArray:
    """Shapes (n, p) of the modes in their order in `sections.p`: what outputs see of the motion `exp(p t)`."""
    sections = noise.sections
    modes = np.flatnonzero(sections.square > 0)
    turn = 1j * np.sqrt(sections.square[modes]) / noise.references[modes]
    return np.asarray((noise.C[:, 2 * modes] + turn * noise.C[:, 2 * modes + 1]).T)

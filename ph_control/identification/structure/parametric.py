"""The minimum of the loss over the parameters of a system function, from the minimum over all models.

Rows are those of the free fit, in which noise is white and of one variance, and so is everything that belongs to
them: hold, delays, constants, gaps.  The loss is minimised by Levenberg and Marquardt's method, with the residuals of a
few calls of the function at neighbouring parameters as derivatives: poles that meet or turn real on the way do no harm.
The search begins next to the modes of the free fit, since the loss has many minima in each frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ...exceptions import StructureError
from ..data.channels import Recording
from ..data.windowed import crossed_scores, share_errors
from ..diagnosis.verdict import HypothesisTest
from ..parameters.fitted_parameters import FittedParameters, Information, named_combination
from ..parameters.model_function import ModelFunction
from ..parameters.pairing import followed, paired
from ..parameters.physical_modes import PhysicalModes
from ..parameters.rows import RowsLeft, energies, left_of_all, of_modes
from ..regression.free import FreeProjection, GivenResidues, refine_free
from ..regression.frequency_rows import FreeResponse
from ..regression.time_rows import FreeRecord
from ..search.circumstances import Cause, Finding
from ..search.fitted_modes import FreeFit
from .constrained import StructuredFit
from .hypothesis_tests import likelihood_test
from .layout import ChannelLayout

PARAMETRIC = "parametric"
_SETTLED = 1e-4  # of the variance of the rows: a decrease of the loss that is none
_ROUNDS = 12  # of derivatives
_FLOORS = 0.02, 0.2, 0.3  # relative errors of frequencies, damping ratios and residues on the way to the start
_NEAR = 0.5  # of a bin: poles so near to those of the free fit need no better start
_STRONG = 100.0, 5.0  # sum of squares of a mode, and for each of its unknowns, from which on a free model may have it


def for_channels(function: ModelFunction, channels: Sequence[Any]) -> ModelFunction:
    """A function whose system has the channels of the data, called once to see that it has."""
    first = channels[0]
    longest = [data.dt * data.samples if isinstance(data, Recording) else 1 / _lowest(data.omega) for data in channels]
    made = replace(
        function, outputs=len(first.output_labels), inputs=len(first.input_labels), slowest=1.0 / max(longest)
    )
    made.modes(made.start)
    return made


def _lowest(omega: Array) -> float:
    return float(omega[omega > 0].min(initial=float(omega.max())))


# --- the data at a model ---------------------------------------------------------------------------------------------


class ParametricProjection(GivenResidues):
    """The data at a computed model; each record begins in a state that all its outputs share."""

    def __init__(self, free: FreeProjection, model: PhysicalModes, layout: ChannelLayout, left: Sequence[RowsLeft]):
        halves = np.where(model.real, 0.5, 1.0)[:, None, None] * model.residues
        projection = FreeProjection(free.experiments, model.poles, free.fed)
        shared = layout.joined(halves, model.feedthrough, projection.has_feedthrough)
        super().__init__(projection, shared)
        self._left = list(left)
        self.slopes: Array = np.zeros((0, 0))  # of poles and shared unknowns by relative changes of the parameters
        self.own_slopes: list[Array] = []
        self.spread: Array = np.zeros((0, 0))

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment, shape (unknowns, its outputs)."""
        return [part.own for part in self._left]

    @cached_property
    def losses(self) -> Array:
        """Sum of squared residuals of each output."""
        losses = np.zeros(self.shared.shape[1])
        for rows, part in zip(self.experiments, self._left, strict=True):
            squares = part.residual.reshape(-1, len(rows.outputs), len(part.residual) // _parts(rows)) ** 2
            losses[rows.outputs] += squares.sum(axis=(0, 2))
        return losses

    def own_covariances(self, experiment: int, covariance: Array, variance: float) -> list[tuple[Array, Array]]:
        """Covariances of what belongs to an experiment, for each output, and with poles and what `shared` has of it."""
        rows, part = self.experiments[experiment], self._left[experiment]
        n, width, pairs = len(self.p), len(self.shared), []
        for k, output in enumerate(rows.outputs.tolist()):
            places = np.append(np.arange(2 * n), 2 * n + output * width + np.arange(width)).astype(int)
            along = self.own_slopes[experiment][:, k] @ self.spread
            spread = part.spread(k) + along @ self.own_slopes[experiment][:, k].T
            pairs.append((variance * spread, variance * along @ self.slopes[places].T))
        return pairs


def _parts(rows: Any) -> int:
    """Number of real signals in the rows of an experiment."""
    return len(rows.outputs) * (2 if isinstance(rows, FreeResponse) else 1)


@dataclass(frozen=True, eq=False)
class ParametricPoint:
    """Covariance of poles and shared unknowns, by the parameters."""

    slopes: Array
    spread: Array
    excess: float | None = None
    deficiency: int = 0

    def covariance(self, variance: float) -> Array:
        """In the coordinates of `FreeProjection.covariance`."""
        return np.asarray(self.slopes @ (variance * self.spread) @ self.slopes.T)


@dataclass(eq=False)
class _Problem:
    """The loss of a system function in the rows of a free fit."""

    free: FreeFit
    layout: ChannelLayout
    function: ModelFunction

    @property
    def experiments(self) -> Sequence[Any]:
        """Rows of the data."""
        return self.free.projection.experiments

    def layout_feedthrough(self, model: PhysicalModes) -> Array:
        """What a model feeds through, one row for each output of the projection."""
        return model.feedthrough.reshape(len(self.free.scales), -1)

    def left(self, model: PhysicalModes) -> list[RowsLeft]:
        """What a model leaves of the data."""
        with np.errstate(all="ignore"):
            return left_of_all(self.experiments, model, self.free.scales)

    def residual(self, model: PhysicalModes) -> Array:
        """Rows of all experiments without the model, one after the other."""
        return np.concatenate([part.residual for part in self.left(model)])


@dataclass(eq=False)
class _Point:
    """Parameters with the residual there."""

    problem: _Problem
    theta: Array
    errors: Array | None = None  # of the parameters, as far as they are known
    _jacobian: Array | None = field(default=None, repr=False)

    @cached_property
    def model(self) -> PhysicalModes:
        """Modes of the system."""
        return self.problem.function.modes(self.theta)

    @cached_property
    def residual(self) -> Array:
        """What is left of the rows."""
        return self.problem.residual(self.model)

    @cached_property
    def loss(self) -> float:
        """Sum of squares; infinite where the model leaves the range of numbers."""
        loss = float(self.residual @ self.residual)
        return loss if np.isfinite(loss) else np.inf

    @cached_property
    def near(self) -> list[tuple[float, PhysicalModes]]:
        """Steps of the parameters and the modes there."""
        return self.problem.function.neighbours(self.theta, self.errors)

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives (N, P) by relative changes of the parameters."""
        scale = self.problem.function.scale
        columns = [(self.problem.residual(model) - self.residual) / step for step, model in self.near]
        return np.stack(columns, axis=1) * scale

    @cached_property
    def free(self) -> Any:
        """Which parameters are not held at a bound that the loss pushes them across."""
        function, slope = self.problem.function, self.jacobian.T @ self.residual
        return ~(((self.theta <= function.lower) & (slope > 0)) | ((self.theta >= function.upper) & (slope < 0)))


# --- the search ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Minimum:
    point: _Point
    converged: bool


def _minimise(problem: _Problem, theta: Array) -> _Minimum:
    """Levenberg and Marquardt's method in relative changes of the parameters, within bounds and the calls there are."""
    function, damping = problem.function, 1e-6
    point = _Point(problem, theta)
    unit = 1.0
    for _ in range(_ROUNDS):
        if function.exhausted:
            return _Minimum(point, False)
        J, r, free = point.jacobian, point.residual, point.free
        unit = max(1.0, point.loss / max(1, len(r)))
        J = J * free
        gram, gradient = J.T @ J, J.T @ r
        trial, damping, promised = _descended(point, gram, gradient, damping, unit)
        if trial is None:
            return _Minimum(point, promised <= 10 * _SETTLED * unit)
        settled = promised <= _SETTLED * unit or point.loss - trial.loss <= _SETTLED * unit
        trial.errors = _errors(J, function.scale, unit)
        if settled:
            # derivatives here serve there: they differ by less than a hundredth of an error
            return _Minimum(point if point.loss <= trial.loss else trial, True)
        point = trial
    return _Minimum(point, False)


def _errors(J: Array, scale: Array, unit: float) -> Array:
    """Standard errors of the parameters by themselves, others known."""
    lengths = np.linalg.norm(J, axis=0)
    with np.errstate(divide="ignore"):
        return np.asarray(scale * np.sqrt(unit) / lengths)


def _descended(
    point: _Point, gram: Array, gradient: Array, damping: float, unit: float
) -> tuple[_Point | None, float, float]:
    """The next point, the damping after it, and the decrease that an undamped step promises; no point if none is lower.

    A step that promises next to nothing is not tried.
    """
    function = point.problem.function
    lengths = np.sqrt(np.diag(gram))
    lengths = np.where(lengths > 0, lengths, 1.0)
    G, g = gram / np.outer(lengths, lengths), gradient / lengths
    full = -np.linalg.lstsq(G, g, rcond=1e-10)[0]
    promised = float(-full @ g)
    if promised <= _SETTLED * unit:
        return None, damping, promised
    for _ in range(8):
        if function.is_spent:
            break
        step = -np.linalg.lstsq(G + damping * np.eye(len(G)), g, rcond=1e-12)[0] / lengths
        theta = function.inside(point.theta + function.scale * step)
        if np.array_equal(theta, point.theta):
            break
        trial = _tried(point.problem, theta)
        if trial is not None and trial.loss < point.loss:
            return trial, max(damping / 10, 1e-9), promised
        damping = max(10 * damping, 1e-3)
    return None, damping, promised


def _tried(problem: _Problem, theta: Array) -> _Point | None:
    """A point, or None where the function has no system there."""
    trial = _Point(problem, theta)
    try:
        return trial if np.isfinite(trial.loss) else None
    except (ArithmeticError, np.linalg.LinAlgError, StructureError):
        return None


# --- where it begins -------------------------------------------------------------------------------------------------


def _start(problem: _Problem) -> Array:
    """Parameters next to the modes of the free fit: those given, or better ones."""
    function, free = problem.function, problem.free
    given = function.start if function.best is None else function.best
    fitted = _Fitted.of(free, problem.layout)
    if not len(fitted.frequencies) or fitted.is_near(function.modes(given), free.region.bin):
        return given
    theta, best, damping = given, fitted.distance(function.modes(given)), 1e-3
    while function.calls + len(given) + 1 <= function.most // 2:
        r = best
        near = function.neighbours(theta)
        J = np.stack([(fitted.distance(model) - r) / step for step, model in near], axis=1) * function.scale
        moved = None
        for _ in range(4):
            gram = J.T @ J
            step = -np.linalg.lstsq(gram + damping * np.diag(np.diag(gram) + 1e-12), J.T @ r, rcond=1e-10)[0]
            trial = function.inside(theta + function.scale * np.clip(step, -0.5, 0.5))
            left = fitted.distance(function.modes(trial))
            if left @ left < r @ r:
                moved, damping = trial, damping / 10
                break
            damping = max(10 * damping, 1e-2)
        if moved is None:
            break
        gain, theta, best = float(r @ r - left @ left), moved, left
        if fitted.is_near(function.modes(theta), free.region.bin) or gain < 1e-3 * float(r @ r):
            break
    trials = [_tried(problem, each) for each in (given, theta)]
    losses = [np.inf if trial is None else trial.loss for trial in trials]
    return theta if losses[1] < losses[0] else given


@dataclass(frozen=True)
class _Fitted:
    """Modes of a free fit, in the units of the data."""

    poles: ComplexArray
    residues: ComplexArray
    errors: Array

    @classmethod
    def of(cls, free: FreeFit, layout: ChannelLayout) -> _Fitted:
        p = free.projection.p
        some = np.flatnonzero(p.imag > 0)
        if not len(some) or not free.projection.inputs:
            motions = np.zeros((len(some), layout.outputs, 0), complex)
            if len(some) and free.projection.own and isinstance(free.projection.experiments[0], FreeRecord):
                motions = _motion_shapes(free, some)
            return cls(p[some], motions, np.zeros(len(some)))
        residues, _ = layout.split(free.projection.shared, len(p))
        return cls(p[some], residues[some], np.zeros(len(some)))

    @property
    def frequencies(self) -> Array:
        """Natural frequencies."""
        return np.abs(self.poles)

    @property
    def shapes(self) -> ComplexArray:
        """Shapes at the outputs."""
        if not self.residues.size:
            return np.ones((len(self.poles), 1), complex)
        return np.linalg.svd(self.residues, full_matrices=False)[0][:, :, 0]

    def places(self, model: PhysicalModes) -> Indices:
        """Modes of a model that are paired with these."""
        some = np.flatnonzero(~model.real)
        shapes = model.shapes[some] if self.residues.size else np.ones((len(some), 1), complex)
        places, _ = paired(self.frequencies, self.shapes, np.abs(model.poles[some]), shapes)
        return np.where(places >= 0, some[places], -1) if len(some) else places

    def is_near(self, model: PhysicalModes, width: float) -> bool:
        """Whether all poles are within a part of a bin, or of their peaks."""
        places = self.places(model)
        distance = np.abs(model.poles[places] - self.poles) if len(model.poles) else np.array([np.inf])
        return bool(np.all(places >= 0) and np.all(distance < _NEAR * (width + np.abs(self.poles.real))))

    def distance(self, model: PhysicalModes) -> Array:
        """Frequencies, damping ratios and residues of a model less these, in rough units."""
        places = self.places(model)
        of_frequency, of_damping, of_residue = _FLOORS
        parts = []
        for k, place in enumerate(places.tolist()):
            if place < 0:
                parts.append(np.zeros(2 + 2 * self.residues[k].size))
                continue
            pole, mine = model.poles[place], self.poles[k]
            zeta, own = -pole.real / np.abs(pole), -mine.real / np.abs(mine)
            residue = model.residues[place] if self.residues.shape[2] == model.residues.shape[2] else 0 * self.residues[k]
            size = float(np.linalg.norm(self.residues[k])) or 1.0
            apart = (residue - self.residues[k]).ravel() / (of_residue * size)
            if self.residues.shape[2] != model.residues.shape[2] or not model.residues.shape[2]:
                apart = _shape_apart(model.shapes[place], self.residues[k], of_residue)
            parts.append(np.concatenate([
                [np.log(np.abs(pole) / np.abs(mine)) / of_frequency, (zeta - own) / (of_damping * max(abs(own), 0.01))],
                apart.real, apart.imag,
            ]))  # fmt: skip
        return np.concatenate(parts) if parts else np.zeros(0)


def _shape_apart(shape: ComplexArray, fitted: ComplexArray, unit: float) -> ComplexArray:
    """A shape less a fitted one of any scale."""
    goal = fitted.ravel() / (np.linalg.norm(fitted) or 1.0)
    if len(goal) != len(shape):
        return np.zeros(fitted.size, complex)
    factor = np.vdot(shape, goal) / (np.vdot(shape, shape).real or 1.0)
    return np.asarray((factor * shape - goal) / unit)


def _motion_shapes(free: FreeFit, some: Indices) -> ComplexArray:
    """Shapes (n, p, 1) by the free motion of the first record."""
    rows, own = free.projection.experiments[0], free.projection.own[0]
    n = len(free.projection.p)
    shapes = np.zeros((len(some), len(free.scales), 1), complex)
    if rows.moving:
        motion = own[:n] + 1j * own[n : 2 * n]
        shapes[:, rows.outputs, 0] = motion[some] * free.scales[rows.outputs]
    return shapes


# --- the fit ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ParametricFit:
    """A system function fitted to the data of a free fit.

    Attributes
    ----------
    fit : StructuredFit
        The minimum.
    test : HypothesisTest
        Against free models of as many modes as the data show.
    findings : tuple of Finding
        Parameters at a bound, and combinations without a trace.
    """

    fit: StructuredFit
    test: HypothesisTest
    findings: tuple[Finding, ...]


def fit_parameters(free: FreeFit, layout: ChannelLayout, function: ModelFunction) -> ParametricFit:
    """Fit the parameters of a system function to the data of a free fit, and test the function within free models.

    Parameters
    ----------
    free : FreeFit
        Minimum over all models.
    layout : ChannelLayout
        Inputs and outputs, and their units.
    function : ModelFunction
        The system, and where its parameters start.

    Returns
    -------
    ParametricFit

    Notes
    -----
    One pass over the data for each call of the function, O(T n (m + p)).
    """
    problem = _Problem(free, layout, function)
    minimum = _minimise(problem, _start(problem))
    function.best = minimum.point.theta
    fit = _structured_fit(problem, minimum)
    test = _tested(problem, minimum.point, fit)
    assert fit.physical is not None
    return ParametricFit(fit, test, _findings(problem, minimum.point, fit.physical))


def _structured_fit(problem: _Problem, minimum: _Minimum) -> StructuredFit:
    """The minimum as a structure: modes, their covariance by that of the parameters, and what belongs to the data."""
    free, layout, function, point = problem.free, problem.layout, problem.function, minimum.point
    model, left = point.model, problem.left(point.model)
    information = Information.of(point.jacobian, point.free)
    spread, excess = _with_shared_errors(problem, point, information)
    projection = ParametricProjection(free.projection, model, layout, left)
    projection.slopes, projection.own_slopes = _slopes(problem, point, projection, left)
    projection.spread = spread
    own, own_free = sum(part.unknowns for part in left), _own_unknowns(free.projection)
    relative = np.where(np.outer(*[point.free & information.seen] * 2), spread, np.nan)
    physical = FittedParameters(
        function.names, point.theta.copy(), relative * np.outer(function.scale, function.scale), function.start,
        function.lower, function.upper, information.hidden, function.calls,
    )  # fmt: skip
    return StructuredFit(
        PARAMETRIC, PARAMETRIC, model.poles, np.where(model.real, 0.5, 1.0)[:, None, None] * model.residues,
        model.feedthrough, None, None, point.loss, information.rank + own - own_free, free.variance, projection,
        minimum.converged, ParametricPoint(projection.slopes, spread, excess), physical=physical,
    )  # fmt: skip


def _own_unknowns(projection: FreeProjection) -> int:
    """Numbers of a free model that belong to one experiment each."""
    return projection.unknowns - len(projection.x) - int(projection.shown.sum())


def _with_shared_errors(problem: _Problem, point: _Point, information: Information) -> tuple[Array, float | None]:
    """Inverse of the information, with what errors that entries of a response have in common add to it."""
    if not share_errors(problem.experiments):
        return information.inverse, None
    jacobians, first = {}, 0
    for place, rows in enumerate(problem.experiments):
        size = rows.samples * len(rows.outputs)
        jacobians[place] = point.jacobian[first : first + size] * point.free
        first += size
    scores = crossed_scores(problem.experiments, jacobians)
    inverse = information.inverse
    return inverse + inverse @ scores @ inverse, float(np.sum(inverse * scores))


def _slopes(
    problem: _Problem, point: _Point, projection: ParametricProjection, left: Sequence[RowsLeft]
) -> tuple[Array, list[Array]]:
    """Derivatives of poles and shared unknowns, and of what belongs to each experiment, by relative changes."""
    scale, known = problem.function.scale, _numbers(projection)
    slopes = np.zeros((len(known), len(scale)))
    own = [np.zeros((*part.own.shape, len(scale))) for part in left]
    for k, (step, model) in enumerate(point.near):
        neighbour = followed(point.model, model)
        parts = problem.left(neighbour)
        moved = ParametricProjection(problem.free.projection, neighbour, problem.layout, parts)
        slopes[:, k] = (_numbers(moved) - known) / step * scale[k]
        for slope, before, after in zip(own, left, parts, strict=True):
            slope[:, :, k] = (after.own - before.own) / step * scale[k]
    return slopes, own


def _numbers(projection: FreeProjection) -> Array:
    """Poles and shared unknowns of a model."""
    return np.concatenate([projection.pole_parts, projection.shared.T.ravel()])


# --- the test --------------------------------------------------------------------------------------------------------


def _tested(problem: _Problem, point: _Point, fit: StructuredFit) -> HypothesisTest:
    """Test the function within free models: of its own modes that stand out of the noise, or of those of the free fit.

    Poles of modes that are weak have no law of their own in a free model, and stay those of the function.
    """
    free, rows = problem.free, problem.free.projection.rows
    own = sum(part.unknowns for part in problem.left(point.model))
    shown = fit.parameters - own + _own_unknowns(free.projection)  # numbers of the parameters
    wide, held = _freed(problem, point)
    candidates = [(free.projection, free.projection.unknowns - free.projection.deficiency - shown - own)]
    if wide is not None:
        candidates.append((wide, wide.unknowns - wide.deficiency - shown - (own - held)))
    wider, dof = min(candidates, key=lambda pair: pair[0].loss + pair[1] * float(np.log(rows)))
    return likelihood_test(wider, fit, max(0, dof))


def _freed(problem: _Problem, point: _Point) -> tuple[FreeProjection | None, int]:
    """A free model of the strong modes of the function, beside its weak ones, and how many numbers these begin with."""
    free, model, left = problem.free, point.model, problem.left(point.model)
    outputs, inputs = len(free.scales), 1 if free.per_entry else free.projection.inputs
    unknowns = 2 + 2 * outputs * max(1, inputs)
    size = energies(problem.experiments, model, free.scales, [part.own for part in left])
    strong = size > _STRONG[0] + _STRONG[1] * unknowns
    strong &= (np.abs(model.poles.imag) < free.region.ceiling) & (np.abs(model.poles.real) < free.region.ceiling)
    if not strong.any():
        return None, 0
    weak = np.flatnonzero(~strong)
    experiments = [
        _without(rows, of_modes(rows, model, weak, free.scales, part.own)) if len(weak) else rows
        for rows, part in zip(problem.experiments, left, strict=True)
    ]
    through = free.projection.fed
    if through is not None:
        through = through | (np.abs(problem.layout_feedthrough(model)) > 0)
    wide = refine_free(lambda _: experiments, model.poles[strong], free.region, fed=through)
    count = int(np.where(model.real[weak], 1, 2).sum())
    return wide, count * sum(bool(getattr(rows, "moving", False)) for rows in experiments)


def _without(rows: Any, signals: Any) -> Any:
    """Rows less what some modes make of them."""
    if isinstance(rows, FreeRecord):
        scaled = signals if rows.scale is None else signals / rows.scale[:, None]
        return rows.without(np.nan_to_num(rows.placed(scaled)))
    response = rows.response.copy()
    response[:, rows.observed] -= signals * np.exp(-1j * rows.omega * rows.delay_time)
    return replace(rows, response=response)


def _findings(problem: _Problem, point: _Point, physical: FittedParameters) -> tuple[Finding, ...]:
    """Parameters that ended at a bound, and combinations that leave no trace."""
    bound = [
        Finding(Cause.PARAMETER_BOUND, (float(point.theta[k]),), 0.0, physical.names[k])
        for k in np.flatnonzero(problem.function.at_bound(point.theta)).tolist()
    ]
    hidden = [
        Finding(Cause.UNIDENTIFIED, tuple(direction.tolist()), 0.0, named_combination(direction, physical.names))
        for direction in physical.hidden
    ]
    return (*bound, *hidden)

"""The minimum of the loss over the parameters of a system function, from the minimum over all models.

Rows are those of the free fit, in which noise is white and of one variance, and so is everything that belongs to
them: hold, delays, constants, gaps.  The loss is minimised by Levenberg and Marquardt's method, with the residuals of a
few calls of the function at neighbouring parameters as derivatives: poles that meet or turn real on the way do no harm.
The search begins next to the modes of the free fit, since the loss has many minima in each frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Indices, Mask
from ..._units import common_unit
from ...exceptions import StructureError
from ..data.channels import Channels, Recording
from ..data.windowed import have_shared_errors, shared_score_covariance
from ..diagnosis.verdict import HypothesisTest
from ..parameters.fitted_parameters import FittedParameters, ParameterInformation, ParametricPoint, named_combination
from ..parameters.model_function import ModelFunction
from ..parameters.physical_modes import PhysicalModes, followed, paired
from ..parameters.rows import RowsRemainder, energies, of_modes, remainders_of
from ..regression.free import FreeProjection, GivenResidues, refine_free
from ..regression.frequency_rows import FreeResponse
from ..regression.prediction import halved
from ..regression.time_rows import FreeRecord
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from .constrained import StructuredFit
from .coordinates import ChannelLayout
from .hypothesis_tests import likelihood_test
from .parametric_noise import SharedNoise

PARAMETRIC = "parametric"
_WEAK = 1e-2  # of the largest singular value of columns of unit length: what one-sided differences may have made
_SETTLED = 1e-4  # of the variance of the rows: a decrease of the loss that is none
_ROUNDS = 12  # of derivatives
_FLOORS = 0.02, 0.2, 0.3  # relative errors of frequencies, damping ratios and residues on the way to the start
_NEAR = 0.5  # of a bin: poles so near to those of the free fit need no better start
_ALIKE = 0.5  # modal assurance from which on modes are taken for the same on the way to the start
_BROAD = 3.0  # times the largest damping ratio of a model, from which on a fitted mode is none of its
_STRONG = 100.0, 5.0  # sum of squares of a mode, and for each of its unknowns, from which on a free model may have it


def for_channels(function: ModelFunction, channels: Channels) -> ModelFunction:
    """A function whose system has the channels of the data, called once to see that it has."""
    first = channels[0]
    longest = [data.dt * data.samples if isinstance(data, Recording) else 1 / _lowest(data.omega) for data in channels]
    made = replace(
        function, outputs=len(first.output_labels), inputs=len(first.input_labels), slowest=1.0 / max(longest),
        time_unit=common_unit(list(channels)),
    )  # fmt: skip
    made.modes(made.start)
    return made


def _lowest(omega: Array) -> float:
    return float(omega[omega > 0].min(initial=float(omega.max())))


# --- the data at a model ---------------------------------------------------------------------------------------------


class ParametricProjection(GivenResidues):
    """The data at a computed model; each record begins in a state that all its outputs share."""

    def __init__(
        self, free: FreeProjection, model: PhysicalModes, layout: ChannelLayout, remainder: Sequence[RowsRemainder]
    ):
        halves = halved(model.poles, model.residues)
        projection = FreeProjection(free.experiments, model.poles, free.fed)
        shared = layout.joined(halves, model.feedthrough, projection.has_feedthrough)
        super().__init__(projection, shared)
        self._remainder = list(remainder)
        self.slopes: Array = np.zeros((0, 0))  # of poles and shared unknowns by relative changes of the parameters
        self.own_slopes: list[Array] = []
        self.spread: Array = np.zeros((0, 0))

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment, shape (unknowns, its outputs)."""
        return [part.own for part in self._remainder]

    @cached_property
    def losses(self) -> Array:
        """Sum of squared residuals of each output."""
        losses = np.zeros(self.shared.shape[1])
        if any(part.residual.size != rows.samples * len(rows.outputs) for rows, part in self._pairs()):
            return losses + sum(float(part.residual @ part.residual) for part in self._remainder) / len(losses)
        for rows, part in self._pairs():
            squares = part.residual.reshape(-1, len(rows.outputs), len(part.residual) // _parts(rows)) ** 2
            losses[rows.outputs] += squares.sum(axis=(0, 2))
        return losses

    def _pairs(self) -> list[tuple[Any, RowsRemainder]]:
        return list(zip(self.experiments, self._remainder, strict=True))

    def own_covariances(self, experiment: int, covariance: Array, variance: float) -> list[tuple[Array, Array]]:
        """Covariances of what belongs to an experiment, for each output, and with poles and what `shared` has of it."""
        rows, part = self.experiments[experiment], self._remainder[experiment]
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


@dataclass(eq=False)
class _ParametricProblem:
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

    def remainder(self, model: PhysicalModes) -> list[RowsRemainder]:
        """What a model leaves of the data."""
        with np.errstate(all="ignore"):
            if self.is_quadratic(model):
                return self._beside_forces(model)
            if self.noise is not None:
                return self.noise.remainder(self.experiments, model, self.free.scales)
            return remainders_of(self.experiments, model, self.free.scales)

    def is_quadratic(self, model: PhysicalModes) -> bool:
        """Whether forces on the plant tell of its poles as well, and a model has as many as the free fit."""
        beside, p = self.free.beside, self.free.projection.p
        alike = len(p) == len(model.poles) and int(np.sum(p.imag == 0)) == int(np.sum(model.real))
        return beside is not None and beside.is_coloured and alike

    def modes(self, theta: Array) -> PhysicalModes:
        """Modes of the system, beside forces in the order of those of the free fit."""
        model = self.function.modes(theta)
        return model.among(self._in_order(model)) if self.is_quadratic(model) else model

    def _in_order(self, model: PhysicalModes) -> Indices:
        p, order = self.free.projection.p, np.empty(len(model.poles), int)
        fitted = _FittedPoles.of(self.free, self.layout)
        some = np.flatnonzero(~model.real)
        order[p.imag != 0] = some[
            paired(fitted.frequencies, fitted.shapes, np.abs(model.poles[some]), model.shapes[some])[0]
        ]
        real = np.flatnonzero(model.real)
        order[p.imag == 0] = real[np.argsort(np.argsort(p[p.imag == 0].real))][
            np.argsort(np.argsort(model.poles[real].real))
        ]
        return order

    def _beside_forces(self, model: PhysicalModes) -> list[RowsRemainder]:
        """The distance of poles and residues from those of the free fit, which has all that noise tells of them."""
        joint: Any = self.free.projection
        quadratic, halves = joint.quadratic, halved(model.poles, model.residues)
        shared = self.layout.joined(halves, model.feedthrough, joint.has_feedthrough)
        moved = np.concatenate([model.poles.imag, model.poles.real, shared.T.ravel()]) - quadratic.centre
        remainder = []
        for place, (mine, along, inner) in enumerate(zip(quadratic.own, quadratic.along, quadratic.inner, strict=True)):
            own, outputs = mine + (along @ moved).reshape(mine.shape), mine.shape[1]
            remainder.append(RowsRemainder(
                quadratic.root @ moved if not place else np.zeros(0), own, self.own_of_free if not place else 0,
                lambda output, inner=inner, outputs=outputs: inner[output::outputs, output::outputs],
            ))  # fmt: skip
        return remainder

    @cached_property
    def noise(self) -> SharedNoise | None:
        """Noise that outputs share, where the free fit has some."""
        return None if self.free.beside is None else SharedNoise(self.free.beside)

    @cached_property
    def apart(self) -> float:
        """By how much the loss of the free fit is larger here than that fit has it: it begins in another way."""
        if self.noise is None:
            return 0.0
        if self.is_quadratic(self.function.modes(self.function.start)):
            return -float(self.free.projection.loss)
        return self.noise.loss_of(self.free.projection, self.free.scales) - self.free.projection.loss

    @property
    def own_of_free(self) -> int:
        """Numbers of the free model that belong to one experiment each."""
        projection = self.free.projection
        noise = 0 if self.free.beside is None else int(self.free.beside.unknowns)
        return projection.unknowns - len(projection.x) - int(projection.excited_unknowns.sum()) - noise

    def residual(self, model: PhysicalModes) -> Array:
        """Rows of all experiments without the model, one after the other."""
        return np.concatenate([part.residual for part in self.remainder(model)])


@dataclass(eq=False)
class _ParameterPoint:
    """Parameters with the residual there."""

    problem: _ParametricProblem
    theta: Array
    errors: Array | None = None  # of the parameters, as far as they are known

    @cached_property
    def model(self) -> PhysicalModes:
        """Modes of the system."""
        return self.problem.modes(self.theta)

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
        near = self.problem.function.neighbours(self.theta, self.errors)
        if self.problem.is_quadratic(self.model):
            return [(step, followed(self.model, model)) for step, model in near]
        return near

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives (N, P) by relative changes of the parameters."""
        scale = self.problem.function.scale
        columns = [(self.problem.residual(model) - self.residual) / step for step, model in self.near]
        return np.stack(columns, axis=1) * scale

    @cached_property
    def sharp(self) -> Array:
        """The same by differences to both sides, where calls are left and some combination leaves next to no trace."""
        J, function = self.jacobian, self.problem.function
        s = np.linalg.svd(np.linalg.qr(J / np.maximum(np.linalg.norm(J, axis=0), 1e-300), mode="r"), compute_uv=False)
        if s.min(initial=1.0) > _WEAK * s.max(initial=0.0) or function.calls + len(self.theta) > function.most:
            return J
        other = function.opposite(self.theta, self.near)
        if self.problem.is_quadratic(self.model):
            other = [(step, followed(self.model, model)) for step, model in other]
        columns = [
            (self.problem.residual(ahead) - self.problem.residual(behind)) / (step - back)
            if step != back else (self.problem.residual(ahead) - self.residual) / step
            for (step, ahead), (back, behind) in zip(self.near, other, strict=True)
        ]  # fmt: skip
        return np.stack(columns, axis=1) * function.scale

    @cached_property
    def free(self) -> Mask:
        """Which parameters are not held at a bound that the loss pushes them across."""
        return self.problem.function.may_move(self.theta, self.jacobian.T @ self.residual)


# --- the search ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _ParameterMinimum:
    point: _ParameterPoint
    converged: bool


def _minimise(problem: _ParametricProblem, theta: Array) -> _ParameterMinimum:
    """Levenberg and Marquardt's method in relative changes of the parameters, within bounds and the calls there are."""
    function, damping = problem.function, 1e-6
    point = _ParameterPoint(problem, theta)
    unit = 1.0
    for _ in range(_ROUNDS):
        if function.exhausted:
            return _ParameterMinimum(point, False)
        J, r, free = point.jacobian, point.residual, point.free
        unit = max(1.0, point.loss / max(1, len(r)))
        J = J * free
        gram, gradient = J.T @ J, J.T @ r
        trial, damping, promised = _descended(point, gram, gradient, damping, unit)
        if trial is None:
            return _ParameterMinimum(point, promised <= 10 * _SETTLED * unit)
        settled = promised <= _SETTLED * unit or point.loss - trial.loss <= _SETTLED * unit
        trial.errors = _errors(J, function.scale, unit)
        if settled:
            # derivatives here serve there: they differ by less than a hundredth of an error
            return _ParameterMinimum(point if point.loss <= trial.loss else trial, True)
        point = trial
    return _ParameterMinimum(point, False)


def _errors(J: Array, scale: Array, unit: float) -> Array:
    """Standard errors of the parameters by themselves, others known."""
    lengths = np.linalg.norm(J, axis=0)
    with np.errstate(divide="ignore"):
        return np.asarray(scale * np.sqrt(unit) / lengths)


def _descended(
    point: _ParameterPoint, gram: Array, gradient: Array, damping: float, unit: float
) -> tuple[_ParameterPoint | None, float, float]:
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
        theta = function.stepped(point.theta, step)
        if np.array_equal(theta, point.theta):
            break
        trial = _tried(point.problem, theta)
        if trial is not None and trial.loss < point.loss:
            return trial, max(damping / 10, 1e-9), promised
        damping = max(10 * damping, 1e-3)
    return None, damping, promised


def _tried(problem: _ParametricProblem, theta: Array) -> _ParameterPoint | None:
    """A point, or None where the function has no system there."""
    trial = _ParameterPoint(problem, theta)
    try:
        return trial if np.isfinite(trial.loss) else None
    except (ArithmeticError, np.linalg.LinAlgError, StructureError):
        return None


# --- where it begins -------------------------------------------------------------------------------------------------


def _start(problem: _ParametricProblem) -> Array:
    """Parameters next to the modes of the free fit: those given, or better ones."""
    function, free = problem.function, problem.free
    given = function.start if function.best is None else function.best
    fitted = _FittedPoles.of(free, problem.layout)
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
            trial = function.stepped(theta, np.clip(step, -0.5, 0.5))
            remainder = fitted.distance(function.modes(trial))
            if remainder @ remainder < r @ r:
                moved, damping = trial, damping / 10
                break
            damping = max(10 * damping, 1e-2)
        if moved is None:
            break
        gain, theta, best = float(r @ r - remainder @ remainder), moved, remainder
        if fitted.is_near(function.modes(theta), free.region.bin) or gain < 1e-3 * float(r @ r):
            break
    trials = [_tried(problem, each) for each in (given, theta)]
    losses = [np.inf if trial is None else trial.loss for trial in trials]
    return theta if losses[1] < losses[0] else given


@dataclass(frozen=True)
class _FittedPoles:
    """Modes of a free fit, in the units of the data."""

    poles: ComplexArray
    residues: ComplexArray

    @classmethod
    def of(cls, free: FreeFit, layout: ChannelLayout) -> _FittedPoles:
        p = free.projection.p
        some = np.flatnonzero(p.imag > 0)
        if not len(some) or not free.projection.inputs:
            motions = np.zeros((len(some), layout.outputs, 0), complex)
            if len(some) and free.projection.own and isinstance(free.projection.experiments[0], FreeRecord):
                motions = _motion_shapes(free, some)
            return cls(p[some], motions)
        residues, _ = layout.split(free.projection.shared, len(p))
        return cls(p[some], residues[some])

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
        places, alike = paired(self.frequencies, self.shapes, np.abs(model.poles[some]), shapes)
        if not len(some):
            return places
        broad = -self.poles.real / self.frequencies > _BROAD * max(0.01, model.damping[some].max())
        return np.where((places >= 0) & (alike >= _ALIKE) & ~broad, some[places], -1)

    def is_near(self, model: PhysicalModes, width: float) -> bool:
        """Whether all poles are within a part of a bin, or of their peaks."""
        places = self.places(model)
        if not np.any(places >= 0):
            return False
        distance = np.abs(model.poles[places] - self.poles)[places >= 0]
        return bool(np.all(distance < _NEAR * (width + np.abs(self.poles.real[places >= 0]))))

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
            residue = (
                model.residues[place] if self.residues.shape[2] == model.residues.shape[2] else 0 * self.residues[k]
            )
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
    problem = _ParametricProblem(free, layout, function)
    minimum = _minimise(problem, _start(problem))
    function.best = minimum.point.theta
    fit = _structured_fit(problem, minimum)
    test = _tested(problem, minimum.point, fit)
    assert fit.physical is not None
    return ParametricFit(fit, test, _findings(problem, minimum.point, fit.physical))


def _structured_fit(problem: _ParametricProblem, minimum: _ParameterMinimum) -> StructuredFit:
    """The minimum as a structure: modes, their covariance by that of the parameters, and what belongs to the data."""
    free, layout, function, point = problem.free, problem.layout, problem.function, minimum.point
    model, remainder = point.model, problem.remainder(point.model)
    information = ParameterInformation.of(point.sharp, point.free)
    spread, excess = _with_shared_errors(problem, point, information)
    projection = ParametricProjection(free.projection, model, layout, remainder)
    projection.slopes, projection.own_slopes = _slopes(problem, point, projection, remainder)
    projection.spread = spread
    own, own_free = sum(part.unknowns for part in remainder), problem.own_of_free
    relative = np.where(np.outer(*[point.free & information.seen] * 2), spread, np.nan)
    physical = FittedParameters(
        function.names, point.theta.copy(), relative * np.outer(function.scale, function.scale), function.start,
        function.lower, function.upper, information.hidden, function.calls,
    )  # fmt: skip
    return StructuredFit(
        PARAMETRIC, PARAMETRIC, model.poles, halved(model.poles, model.residues),
        model.feedthrough, None, None, point.loss - problem.apart, information.rank + own - own_free, free.variance,
        projection, minimum.converged, ParametricPoint(projection.slopes, spread, excess), physical=physical,
    )  # fmt: skip


def _with_shared_errors(
    problem: _ParametricProblem, point: _ParameterPoint, information: ParameterInformation
) -> tuple[Array, float | None]:
    """Inverse of the information, with what errors that entries of a response have in common add to it."""
    if not have_shared_errors(problem.experiments):
        return information.inverse, None
    jacobians, first = {}, 0
    for place, rows in enumerate(problem.experiments):
        size = rows.samples * len(rows.outputs)
        jacobians[place] = point.jacobian[first : first + size] * point.free
        first += size
    scores = shared_score_covariance(problem.experiments, jacobians)
    inverse = information.inverse
    return inverse + inverse @ scores @ inverse, float(np.sum(inverse * scores))


def _slopes(
    problem: _ParametricProblem,
    point: _ParameterPoint,
    projection: ParametricProjection,
    remainder: Sequence[RowsRemainder],
) -> tuple[Array, list[Array]]:
    """Derivatives of poles and shared unknowns, and of what belongs to each experiment, by relative changes."""
    scale, known = problem.function.scale, _numbers(projection)
    slopes = np.zeros((len(known), len(scale)))
    own = [np.zeros((*part.own.shape, len(scale))) for part in remainder]
    for k, (step, model) in enumerate(point.near):
        neighbour = followed(point.model, model)
        parts = problem.remainder(neighbour)
        moved = ParametricProjection(problem.free.projection, neighbour, problem.layout, parts)
        slopes[:, k] = (_numbers(moved) - known) / step * scale[k]
        for slope, before, after in zip(own, remainder, parts, strict=True):
            slope[:, :, k] = (after.own - before.own) / step * scale[k]
    return slopes, own


def _numbers(projection: FreeProjection) -> Array:
    """Poles and shared unknowns of a model."""
    return np.concatenate([projection.pole_parts, projection.shared.T.ravel()])


# --- the test --------------------------------------------------------------------------------------------------------


def _tested(problem: _ParametricProblem, point: _ParameterPoint, fit: StructuredFit) -> HypothesisTest:
    """Test the function within free models: of its own modes that stand out of the noise, or of those of the free fit.

    Poles of modes that are weak have no law of their own in a free model, and stay those of the function.
    """
    free, rows = problem.free, problem.free.projection.rows
    own = sum(part.unknowns for part in problem.remainder(point.model))
    shown = fit.parameters - own + problem.own_of_free  # numbers of the parameters
    wide, held = _freed(problem, point)
    of_free = problem.own_of_free + len(free.projection.x) + int(free.projection.excited_unknowns.sum())
    candidates = [(free.projection, of_free - free.projection.deficiency - shown - own)]
    if problem.noise is not None:
        return likelihood_test(free.projection, fit, max(0, candidates[0][1] + held))
    if wide is not None:
        candidates.append((wide, wide.unknowns - wide.deficiency - shown - (own - held)))
    wider, dof = min(candidates, key=lambda pair: pair[0].loss + pair[1] * float(np.log(rows)))
    return likelihood_test(wider, fit, max(0, dof))


def _freed(problem: _ParametricProblem, point: _ParameterPoint) -> tuple[FreeProjection | None, int]:
    """A free model of the strong modes of the function, beside its weak ones, and how many numbers these begin with."""
    free, model, remainder = problem.free, point.model, problem.remainder(point.model)
    outputs, inputs = len(free.scales), 1 if free.per_entry else free.projection.inputs
    unknowns = 2 + 2 * outputs * max(1, inputs)
    size = energies(problem.experiments, model, free.scales, [part.own for part in remainder])
    strong = size > _STRONG[0] + _STRONG[1] * unknowns
    strong &= (np.abs(model.poles.imag) < free.region.ceiling) & (np.abs(model.poles.real) < free.region.ceiling)
    if not strong.any():
        return None, 0
    weak = np.flatnonzero(~strong)
    experiments = [
        _without(rows, of_modes(rows, model, weak, free.scales, part.own)) if len(weak) else rows
        for rows, part in zip(problem.experiments, remainder, strict=True)
    ]
    through = free.projection.fed
    if through is not None:
        through = through | (np.abs(problem.layout_feedthrough(model)) > 0)
    wide = None
    if problem.noise is None:
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


def _findings(problem: _ParametricProblem, point: _ParameterPoint, physical: FittedParameters) -> tuple[Finding, ...]:
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

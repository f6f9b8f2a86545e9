"""The minimum of the loss over models with a structure, from the minimum over all models.

What belongs to each experiment is eliminated as for free residues, in factors that hold for any residues at their
poles: an iteration costs one pass over the data, whatever the structure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import nnls

from ..._checks import EPS
from ..._frozen import Frozen
from ..._options import HYPOTHESES
from ..._types import Array, ComplexArray, Indices, Mask, RealOrComplex
from ..data.windowed import have_shared_errors, shared_score_covariance
from ..parameters.fitted_parameters import FittedParameters, ParametricPoint
from ..regression.elimination import LinearProjection, reduced, tolerance
from ..regression.free import Delays, FreeProjection, GivenResidues, Sensitivity
from ..regression.sections import PoleRegion
from ..regression.tuning import TUNING
from ..regression.variable_projection import Refinement, continue_refinement, refine
from .coordinates import ChannelLayout, MatrixCoordinates, ShapeCoordinates, StructureCoordinates
from .passive import PassivePoint, classical_passive, nearest_passive

_EXACT = 1e-10  # relative decrease of the loss at which a refinement ends
_WELL_CONDITIONED = 1e10  # entries of the inverse of a Gram matrix of unit columns
_WEAK = 0.01  # standard errors: a weight so small may be 0
_LEAST_SIZE = 1e-3  # of the largest: modes of no size do not move
_ITERATIONS = 60  # before it follows secants
_FEW = 12  # in the tangent of a free fit, where three are usual


@dataclass(frozen=True, eq=False)
class StructuredFit(Frozen):
    """Minimum of the loss over the models of a structure.

    Attributes
    ----------
    hypothesis, structure : str
        What was assumed, and which of 'lossless', 'classical', 'passive', 'free' it is.
    p : ndarray of complex, shape (n,)
        Poles of positive imaginary part.
    residues : ndarray of complex, shape (n, p, m)
        In the units of the data.
    feedthrough : ndarray, shape (p, m)
        The same.
    shapes, participation : ndarray, shape (n, p) and (n, m), or None
        Factors of residues of rank one, `shapes[l, o] participation[l, i] p_l**k_o / (2j Im p_l)`; real with classical
        damping, and equal at ports.
    loss : float
        Sum of squares in the rows of the projection.
    parameters : int
        Unknown numbers in poles, residues and feedthrough; of a passive model less the constraints that hold it.
    variance : float
        Of the rows of the projection, by the free fit.
    projection : FreeProjection
        The data at this model.
    converged : bool
        Whether the loss has come to its minimum.
    point : ConstrainedProjection, PassivePoint, ParametricPoint or FreeProjection
        What the covariance is made of.
    delays : Delays or None
        Delays of the outputs of the projection, where they were fitted; `parameters` count them.
    physical : FittedParameters or None
        Parameters of a system function, with the covariance for rows of variance 1.
    """

    hypothesis: str
    structure: str
    p: ComplexArray
    residues: ComplexArray
    feedthrough: Array
    shapes: RealOrComplex | None
    participation: RealOrComplex | None
    loss: float
    parameters: int
    variance: float
    projection: FreeProjection
    converged: bool
    point: ConstrainedProjection | PassivePoint | ParametricPoint | FreeProjection
    delays: Delays | None = None
    physical: FittedParameters | None = None

    @cached_property
    def covariance(self) -> Array:
        """In the coordinates and units of `FreeProjection.covariance`."""
        return self.point.covariance(self.variance)

    @property
    def delay_errors(self) -> Array:
        """Standard errors of the delays."""
        if not isinstance(self.point, ConstrainedProjection) or self.delays is None:
            return np.zeros(0)
        return self.point.delay_errors(self.variance)


class Tangent:
    """Linearised residuals of a free fit about its minimum: they cost no pass over the data."""

    def __init__(self, projection: FreeProjection) -> None:
        self._poles, self._shared, self._sensitivities = projection.pole_parts, projection.shared, list[Sensitivity]()
        for outputs, residual, by_poles, by_shared in projection.with_unknowns(
            projection.p, projection.shared, projection.sections
        ).sensitivities():
            R = reduced(np.asfortranarray(np.column_stack([by_poles, by_shared, residual])))
            n = len(projection.p)
            self._sensitivities.append((outputs, R[:, -1], R[:, : 2 * n], R[:, 2 * n : -1]))

    def evaluated(self, p: ComplexArray, shared: Array) -> TangentPoint:
        """The residuals at other poles and residues."""
        pole_change = np.concatenate([p.imag, p.real]) - self._poles
        return TangentPoint([
            (
                outputs, residual + by_poles @ pole_change + by_shared @ (shared - self._shared)[:, outputs].T.ravel(),
                by_poles, by_shared,
            )
            for outputs, residual, by_poles, by_shared in self._sensitivities
        ])  # fmt: skip


@dataclass(frozen=True)
class TangentPoint:
    """Residuals and Jacobians of each output."""

    parts: list[Sensitivity]

    @property
    def loss(self) -> float:
        """Sum of squared residuals."""
        return float(sum(residual @ residual for _, residual, _, _ in self.parts))

    def sensitivities(self) -> Iterator[Sensitivity]:
        """Outputs with their residual and the Jacobians of this."""
        return iter(self.parts)


class ConstrainedProjection(LinearProjection):
    """The data at a model with a structure, what belongs to each experiment at its best."""

    def __init__(self, problem: ConstrainedProblem, x: Array) -> None:
        self.x, self._problem = x, problem
        self._model, delays = np.split(x, [problem.coordinates.size])
        self.sections, self.residues, self.feedthrough = problem.coordinates.model(self._model)
        self.p = self.sections.p
        self.sizes = np.append(problem.coordinates.sizes(self._model, problem.region.bin), np.abs(delays))
        start, layout = problem.start, problem.coordinates.layout
        self.delays = problem.delays and replace(problem.delays, values=delays)
        experiments = start.experiments if self.delays is None else self.delays.rows(start.experiments)  # type: ignore[type-var]
        shared = layout.joined(self.residues, self.feedthrough, start.has_feedthrough)
        self.data: GivenResidues | TangentPoint
        if problem.tangent is not None:
            self.data = problem.tangent.evaluated(self.p, shared)
        else:
            self.data = start.with_unknowns(self.p, shared, self.sections, experiments)

    @property
    def loss(self) -> float:
        """Sum of squared residuals."""
        return self.data.loss

    @cached_property
    def _normal_equations(self) -> tuple[Array, Array]:
        """Gram matrix of the Jacobian by the coordinates, and half the gradient."""
        size, poles = len(self.x), self._pole_derivatives
        gram, gradient = np.zeros((size, size)), np.zeros(size)
        for outputs, residual, by_poles, by_shared in self.data.sensitivities():
            slopes = np.concatenate([self.derivatives(output) for output in outputs])
            # each output depends on its own part of the shapes
            columns = np.flatnonzero(slopes.any(axis=0) | poles.any(axis=0))
            J = by_poles @ poles[:, columns] + by_shared @ slopes[:, columns]
            if self.delays is not None and isinstance(self.data, GivenResidues):
                columns = np.append(columns, size - self.delays.count + self.delays.groups[outputs[0]])
                J = np.column_stack([J, -self.data.delay_slopes(outputs[0])])
            gram[np.ix_(columns, columns)] += J.T @ J
            gradient[columns] += J.T @ residual
        fixed = np.append(~self._problem.free, np.zeros(size - len(self._model), bool))
        gram[fixed] = gram[:, fixed] = gradient[fixed] = 0.0
        return gram, gradient

    def derivatives(self, output: int) -> Array:
        """Derivatives by the coordinates of the `shared` unknowns of an output."""
        coordinates = self._problem.coordinates
        slopes = (
            coordinates.derivatives(self._model, output, self._problem.start.has_feedthrough)
            / coordinates.layout.scales[output]
        )
        return self._padded_for_delays(slopes)

    @property
    def _pole_derivatives(self) -> Array:
        return self._padded_for_delays(self._problem.coordinates.pole_derivatives(self._model))

    def _padded_for_delays(self, slopes: Array) -> Array:
        """Derivatives of what does not depend on delays, with zero columns for these."""
        return np.pad(slopes, ((0, 0), (0, len(self.x) - len(self._model))))

    @cached_property
    def gram(self) -> Array:
        """`J^T J` of the residuals by the coordinates."""
        return self._normal_equations[0]

    @cached_property
    def gradient(self) -> Array:
        """Half the gradient of the loss."""
        return self._normal_equations[1]

    def covariance(self, variance: float) -> Array:
        """Covariance of the model, in the coordinates of `FreeProjection.covariance`."""
        places, inverse = self._inverse_gram
        poles = self._pole_derivatives
        J = np.concatenate([poles, *map(self.derivatives, range(self._problem.start.shared.shape[1]))])[:, places]
        if isinstance(self.data, GivenResidues) and have_shared_errors(self.data.experiments):
            inverse = inverse + inverse @ self.shared_score_covariance[np.ix_(places, places)] @ inverse
        return np.asarray(J @ (variance * inverse) @ J.T)

    @cached_property
    def shared_score_covariance(self) -> Array:
        """Covariance of the gradient beyond the Gram matrix, by errors that entries have in common."""
        assert isinstance(self.data, GivenResidues)
        jacobians, poles = {}, self._pole_derivatives
        for place, rows in enumerate(self.data.experiments):
            by_poles, by_shared = self.data.row_jacobians(place)
            J = by_poles @ poles + by_shared @ self.derivatives(int(rows.outputs[0]))
            jacobians[place] = np.where(np.diag(self.gram) > 0, J, 0.0)
        return shared_score_covariance(self.data.experiments, jacobians)

    @property
    def excess(self) -> float:
        """How many more squares than it has unknowns this model takes of errors that entries have in common."""
        if not (isinstance(self.data, GivenResidues) and have_shared_errors(self.data.experiments)):
            return 0.0
        places, inverse = self._inverse_gram
        return float(np.sum(inverse * self.shared_score_covariance[np.ix_(places, places)]))

    @cached_property
    def deficiency(self) -> int:
        """Number of combinations of residues and feedthrough that leave no trace, for given poles and delays."""
        linear = np.arange(len(self._problem.coordinates.pole_coordinates), len(self._model))
        places = linear[np.diag(self.gram)[linear] > 0]
        lengths = np.sqrt(np.diag(self.gram)[places])
        eigenvalues = np.linalg.eigvalsh(self.gram[np.ix_(places, places)] / np.outer(lengths, lengths))
        return int(np.sum(eigenvalues <= tolerance(self._problem.samples, len(places)) * eigenvalues.max(initial=0.0)))

    def delay_errors(self, variance: float) -> Array:
        """Standard errors of the delays."""
        places, inverse = self._inverse_gram
        errors = np.full(len(self.x), np.nan)
        errors[places] = np.sqrt(variance * np.diag(inverse))
        return errors[len(self._model) :]

    @cached_property
    def _inverse_gram(self) -> tuple[Indices, Array]:
        """Coordinates that the data show, and the inverse of their Gram matrix."""
        places = np.flatnonzero(np.diag(self.gram))
        gram = self.gram[np.ix_(places, places)]
        if not len(places):
            return places, gram
        lengths = np.sqrt(np.diag(gram))
        inverse, failed = lapack.dpotri(lapack.dpotrf(gram / np.outer(lengths, lengths))[0])
        inverse = np.triu(inverse) + np.triu(inverse, 1).T
        if failed or not np.abs(inverse).max(initial=0.0) < _WELL_CONDITIONED:
            inverse = np.linalg.pinv(gram / np.outer(lengths, lengths), rcond=len(lengths) * EPS, hermitian=True)
        return places, inverse / np.outer(lengths, lengths)


@dataclass(frozen=True)
class ConstrainedProblem:
    """The loss of a free fit over the coordinates of a structure."""

    coordinates: StructureCoordinates
    start: FreeProjection
    region: PoleRegion
    free: Mask
    tangent: Tangent | None = None
    delays: Delays | None = None

    @property
    def samples(self) -> int:
        """Number of real equations."""
        return self.start.rows

    def project(self, x: Array) -> ConstrainedProjection:
        """The data at the model with these coordinates."""
        return ConstrainedProjection(self, x)

    def inside(self, x: Array) -> Array:
        """Poles brought to where they are allowed; next to a free fit no two of a section meet."""
        coordinates, size = self.coordinates, self.coordinates.size
        x, delays = x[:size], x[size:] if self.delays is None else self.delays.inside(x[size:])
        bounded = self.region.inside(coordinates.sections_at(x).x.copy())
        if self.tangent is not None or not (coordinates.damped and coordinates.real):
            k = len(coordinates.sections.decay)
            decay, product = bounded[:k], bounded[k : 2 * k]
            sign = np.where(coordinates.sections.square > 0, 1.0, -1.0) if coordinates.damped else np.ones(k)
            ends = decay**2 + sign * self.region.least(decay)
            bounded[k : 2 * k] = np.where(sign > 0, np.maximum(product, ends), np.minimum(product, ends))
        return np.concatenate([bounded[coordinates.pole_coordinates], x[len(coordinates.pole_coordinates) :], delays])

    def reach(self, projection: ConstrainedProjection) -> Array:
        """Longest steps: of poles a bin and the half-width of a peak; unlimited for what is nearly linear."""
        pole_coordinates, widths = self.coordinates.pole_coordinates, np.full(len(projection.x), np.inf)
        widths[: len(pole_coordinates)] = self.region.reach(projection.sections)[pole_coordinates]
        if self.delays is not None:
            widths[self.coordinates.size :] = self.delays.step
        return widths


def constrained(
    projection: FreeProjection, layout: ChannelLayout, hypothesis: str, region: PoleRegion,
    iterations: int | None = None, delays: Delays | None = None,
) -> StructuredFit:  # fmt: skip
    """Fit a structure to the data of a free fit, and delays of the outputs where there are some.

    Parameters
    ----------
    projection : FreeProjection
        Minimum of the free fit over all that was measured.
    layout : ChannelLayout
        Inputs and outputs, their units and ports.
    hypothesis : {'lossless', 'classical', 'passive', 'rank one', 'reciprocal', 'free'}
        Poles on the axis and real shapes; real shapes; no energy from any port; simple poles; equal responses between
        ports; nothing.
    region : PoleRegion
        Where poles are looked for.
    iterations : int, optional
        After so many it ends, wherever it stands: enough for structures that fit. None goes on to the minimum.
    delays : Delays, optional
        Delays that are refined with the model; of a passive one those of the data stay.

    Returns
    -------
    StructuredFit
        By Levenberg's and Marquardt's method on the loss itself, O(T n^2) an iteration.  A passive model is the nearest
        in the metric of the information, there and once more at what it leads to.
    """
    variance = projection.variance_of(projection.loss)
    coordinates = coordinates_of(projection, layout, hypothesis)
    if hypothesis == "free" and delays is None:
        return StructuredFit(
            hypothesis, "free", projection.p, *layout.split(projection.shared, len(projection.p)), None, None,
            projection.loss, coordinates.dof - projection.deficiency, variance, projection, True, projection,
        )  # fmt: skip
    if hypothesis == "passive":
        return nearest_passive_fit(
            projection, layout, lambda: constrained(projection, layout, "classical", region, _ITERATIONS)
        )
    steps = _ITERATIONS if iterations is None else max(iterations, _FEW)
    return Approach.from_free_fit(projection, layout, hypothesis, region, delays, steps).continued(iterations).fit


@dataclass(frozen=True)
class Approach:
    """The way from a free fit to the minimum of a structure, to be followed further from where it has come to."""

    hypothesis: str
    problem: ConstrainedProblem
    refinement: Refinement[ConstrainedProjection]

    @classmethod
    def from_free_fit(
        cls, projection: FreeProjection, layout: ChannelLayout, hypothesis: str, region: PoleRegion,
        delays: Delays | None = None, steps: int = _FEW,
    ) -> Approach:  # fmt: skip
        """The beginning: the minimum in the tangent of the free fit, in so many steps, where the structure is near."""
        coordinates = coordinates_of(projection, layout, hypothesis)
        residues, through = layout.split(projection.shared, len(projection.p))
        crowded = is_crowded(projection, region)
        x = coordinates.start(residues, through)
        if (projection.deficiency or crowded) and isinstance(coordinates, ShapeCoordinates) and coordinates.real:
            # where data show sums of residues only, those of the free fit may have any sign and size
            residues = coordinates.turned_to_positive(residues)
            x = coordinates.start(residues, through)
            x = _with_best_sizes(projection, coordinates, x) if np.all(projection.p.imag > 0) else x
        problem = ConstrainedProblem(coordinates, projection, region, coordinates.free_coordinates(x), delays=delays)
        x = problem.inside(x if delays is None else np.append(x, delays.values))
        if delays is None and not crowded and coordinates.sections_at(x).keeps_kinds(projection.sections):
            tangent = replace(problem, tangent=Tangent(projection))
            x = refine(tangent, x, rtol=TUNING.rough, max_iterations=steps, last=False).projection.x
        return cls(hypothesis, problem, Refinement(problem.project(x), converged=not len(x)))

    def continued(self, iterations: int | None) -> Approach:
        """The same after so many iterations in all, or at the minimum: with None it is followed to its last digit."""
        limit, last = _ITERATIONS if iterations is None else iterations, iterations is None
        end = continue_refinement(self.problem, replace(self.refinement), rtol=_EXACT, max_iterations=limit, last=last)
        while end.converged and (point := _at_bound(self.problem, end.projection)) is not end.projection:
            end = refine(self.problem, point.x, rtol=_EXACT, max_iterations=limit, last=last)
        return replace(self, refinement=end)

    @property
    def predicted_share(self) -> float:
        """Share of the loss that is left a step of Gauss and Newton ahead, to first order."""
        end = self.refinement.projection
        curvature = np.diag(end.gram)
        root = np.sqrt(np.where(curvature > 0, curvature, 1.0))
        inverse = np.linalg.pinv(end.gram / np.outer(root, root), rcond=len(root) * EPS, hermitian=True)
        return 1.0 - float(end.gradient / root @ inverse @ (end.gradient / root)) / max(end.loss, np.finfo(float).tiny)

    @property
    def fit(self) -> StructuredFit:
        """The model that it has come to."""
        coordinates, start, end = self.problem.coordinates, self.problem.start, self.refinement.projection
        model = end.x[: coordinates.size]
        shapes, participation = coordinates.shapes(model) if isinstance(coordinates, ShapeCoordinates) else (None, None)
        parameters = coordinates.dof - end.deficiency + (0 if end.delays is None else end.delays.count)
        # free residues in the delays that a descent began with may be far from the minimum
        least = start.loss if end.delays is None else min(start.loss, end.loss)
        variance = start.variance_of(least)
        return StructuredFit(
            self.hypothesis, structure_of(self.hypothesis), end.p, end.residues, end.feedthrough, shapes,
            participation, end.loss, parameters, variance, cast(GivenResidues, end.data), self.refinement.converged,
            end, end.delays,
        )  # fmt: skip


def structure_of(hypothesis: str) -> str:
    """What a model of a hypothesis is called."""
    known = HYPOTHESES.get(hypothesis)
    return hypothesis if known is None else known.structure or hypothesis


def is_crowded(projection: FreeProjection, region: PoleRegion) -> bool:
    """Whether some complex poles are closer than a bin: structures of these are far from linear, and start anywhere."""
    return bool(np.all(projection.p.imag > 0) and np.any(np.diff(np.sort(projection.p.imag)) < region.bin))


def _with_best_sizes(projection: FreeProjection, coordinates: ShapeCoordinates, x: Array) -> Array:
    """Coordinates with each mode as large, with its shape and pole, as explains most of the data."""
    sections, residues, through = coordinates.model(x)
    layout, rows, targets = coordinates.layout, [], []
    modes = [np.where(np.arange(len(residues)) == l, 1.0, 0.0)[:, None, None] * residues for l in range(len(residues))]
    mode_unknowns = [layout.joined(mode, 0 * through, projection.has_feedthrough) for mode in modes]
    static = layout.joined(0 * residues, through, projection.has_feedthrough)
    for outputs, target, _, by_shared in projection.with_unknowns(sections.p, static, sections).sensitivities():
        rows.append(np.stack([-by_shared @ mode[:, outputs].T.ravel() for mode in mode_unknowns], axis=1))
        targets.append(target)
    sizes = nnls(np.concatenate(rows), np.concatenate(targets))[0]
    least = _LEAST_SIZE * sizes.max(initial=0.0)
    return coordinates.start(np.maximum(sizes, least)[:, None, None] * residues, through)


def _at_bound(problem: ConstrainedProblem, projection: ConstrainedProjection) -> ConstrainedProjection:
    """The same with weights of a single port set to 0 where they tend to 0: steps in their roots never get there."""
    coordinates = problem.coordinates
    if not isinstance(coordinates, ShapeCoordinates) or not coordinates.is_port_alone:
        return projection
    first, roots = len(coordinates.pole_coordinates), coordinates.residue_values(projection.x)[:, 0]
    effects = np.diag(projection.gram)[first:][: len(roots)] * roots**2
    for k in np.flatnonzero((roots != 0) & (effects < _WEAK**2 * projection.loss / problem.samples)).tolist():
        x = projection.x.copy()
        x[first + k] = 0.0
        without_mode = problem.project(x)
        if without_mode.loss <= projection.loss * (1 + _EXACT):
            projection = without_mode
    return projection


def nearest_passive_fit(
    projection: FreeProjection,
    layout: ChannelLayout,
    classical: Callable[[], StructuredFit],
    max_distance: float = np.inf,
) -> StructuredFit:
    """Nearest passive model; that with classical damping where the way from the free one does not lead to any.

    Nor does it where the squared distance is beyond `max_distance`, in standard errors.
    """
    variance = projection.variance_of(projection.loss)
    point, unknowns = (
        nearest_passive(projection, layout, variance, max_distance),
        coordinates_of(projection, layout, "free").dof,
    )
    if point is None:
        damped = classical()
        point = classical_passive(damped.projection, layout, unknowns - damped.parameters, damped.covariance / variance)
    data, parameters = point.data, unknowns - point.active
    return StructuredFit(
        "passive", "passive", data.p, *layout.split(data.shared, len(data.p)), None, None, data.loss,
        parameters, variance, data, True, point,
    )  # fmt: skip


def coordinates_of(projection: FreeProjection, layout: ChannelLayout, hypothesis: str) -> StructureCoordinates:
    """Coordinates of the models of a hypothesis, for what the data show."""
    n, shown, sections = len(projection.p), projection.excited_unknowns, projection.sections
    residues, through = layout.split(shown.astype(float), n)
    entries, fed = np.any(residues, axis=0, keepdims=True)[0], through != 0
    if hypothesis == "lossless":
        # beside an accelerometer's mass, what is fed through dissipates
        fed &= np.array([quantity in ("acceleration", "free") for quantity in layout.quantities])[:, None]
    if not layout.inputs:
        return MatrixCoordinates(layout, sections, entries, fed, damped=hypothesis != "lossless")
    if hypothesis in ("lossless", "classical"):
        return ShapeCoordinates(layout, sections, entries, fed, damped=hypothesis == "classical", real=True, tied=True)
    if hypothesis == "rank one":
        return ShapeCoordinates(layout, sections, entries, fed)
    return MatrixCoordinates(layout, sections, entries, fed, reciprocal=hypothesis == "reciprocal")

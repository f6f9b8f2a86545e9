"""A structure that was fitted: poles, residues and delays in the units of a result, and their covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..._types import Array, ArrayLike, ComplexArray, Indices, Mask, NDArray
from ..diagnosis.verdict import HypothesisTest
from ..regression.free import FreeProjection, GivenResidues
from ..regression.prediction import natural_jacobian
from ..search.fitted_modes import FreeFit
from ..structure.choice import Choice, Request
from ..structure.constrained import StructuredFit
from ..structure.hypothesis_tests import is_refused
from ..structure.late_outputs import places_of


@dataclass(frozen=True, eq=False)
class FittedStructure:
    """A structure that was chosen, as it was requested.

    Attributes
    ----------
    choice : Choice
        The free fit, the structure, and its tests.
    request : Request
        What was to be assumed.
    """

    choice: Choice
    request: Request

    @property
    def free(self) -> FreeFit:
        """The free fit that the structure is next to."""
        return self.choice.free

    @property
    def tests(self) -> tuple[HypothesisTest, ...]:
        """Tests of the structures."""
        return self.choice.tests

    @cached_property
    def refused(self) -> bool:
        """Whether the data reject the structure that was given."""
        return is_refused(self.request.structure, self.tests)

    @cached_property
    def fit(self) -> StructuredFit:
        """The structure at its minimum; if it was refused, with the variance of what it leaves."""
        fit, projection = self.choice.fit, self.free.projection
        if not self.refused:
            return fit
        # who insists on it gets the errors of what it leaves
        rows_to_spare = max(1, projection.rows - projection.unknowns)
        return replace(fit, variance=max(fit.variance, fit.loss / rows_to_spare))

    @property
    def rounding(self) -> bool:
        """Whether residuals are rounding, and no noise."""
        return self.free.rounding and not self.refused

    @cached_property
    def rank(self) -> Indices:
        """Places of the poles of a result among those of the fit: modes by their frequencies, then real poles."""
        return np.lexsort((np.abs(self.fit.p), self.fit.p.imag == 0))

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles of the result."""
        return self.fit.p[self.rank]

    @cached_property
    def residues(self) -> ComplexArray:
        """Residues of the result (n, p, m)."""
        return self.fit.residues[self.rank] * np.where(self.poles.imag == 0, 2.0, 1.0)[:, None, None]

    @property
    def is_single(self) -> bool:
        """Whether there is one output, and at most one input."""
        return self.residues.shape[1] == 1 and self.residues.shape[2] <= 1

    @cached_property
    def measured(self) -> FreeProjection:
        """The data as they were measured at this model, also at one that was fitted in other rows."""
        fit, measured = self.fit, self.free.measured
        if measured is None:
            return fit.projection
        rows = measured.experiments
        if fit.delays is not None:
            rows = fit.delays.rows(rows)  # type: ignore[type-var]
        return GivenResidues(FreeProjection(rows, fit.p, measured.fed), fit.projection.shared)

    @property
    def of_shared(self) -> Array:
        """Covariance of the poles and of what experiments share, in the coordinates of the projection."""
        return self.fit.covariance if len(self.fit.p) else self.measured.covariance(self.fit.variance)

    def own_spreads(self, experiment: int) -> list[tuple[Array, Array]]:
        """Covariance of what belongs to rows of an experiment, for each output, and with poles and shared unknowns."""
        return self.measured.own_covariances(experiment, self.of_shared, self.fit.variance)

    @cached_property
    def delays(self) -> tuple[Array, Array]:
        """Delay of each output and its standard error: NaN if known to a sample only, 0 if it was given."""
        fit, free, places = self.fit, self.free, places_of(self.free)
        if fit.delays is not None:
            return fit.delays.by_output[places], fit.delay_errors[fit.delays.groups][places]
        late = np.broadcast_to(free.delay, free.scales.shape)[places]
        return late.copy(), np.where(late != 0, np.nan if free.delay_open else 0.0, 0.0)


def roots(variances: ArrayLike) -> Array:
    """Standard errors; NaN where so little is shown that rounding leaves less than nothing."""
    each = np.asarray(variances, float)
    return np.sqrt(np.where(each >= 0, each, np.nan))


def covariance_of(structure: FittedStructure) -> Array:
    """Covariance in the coordinates of a result from that in those of the projection, NaN for what leaves no trace."""
    fit, free, rank = structure.fit, structure.free, structure.rank
    n, projection = len(fit.p), fit.projection
    width, count = projection.shared.shape[0] if projection.shared.size else 0, len(free.scales)
    places = (2 * n + np.arange(width * count)).reshape(count, width).T
    scales = np.broadcast_to(free.scales, (width, count))
    inputs = 0 if not width else projection.inputs
    entries = fit.residues.shape[1:]

    def in_order(of_poles: Array, values: NDArray[Any]) -> NDArray[Any]:
        """Numbers of the poles, then those (.., outputs) of the shared unknowns, in the order of a result."""
        each = values.reshape(inputs, -1 if inputs else 2 * n, count)
        parts = [np.moveaxis(each[:, k * n : (k + 1) * n], 0, 2).reshape(n, *entries)[rank] for k in (0, 1)]
        through = np.full(entries, -1 if values.dtype.kind in "iu" else 1, values.dtype)
        parts.append(each[:, 2 * n].T if each.shape[1] > 2 * n else through)
        return np.concatenate([of_poles, *(part.ravel() for part in parts)])

    order = in_order(np.concatenate([rank, n + rank]), places).astype(int)
    size = in_order(np.ones(2 * n), scales)
    lost = in_order(np.ones(2 * n), projection.excited_unknowns.astype(float)) == 0
    given = fit.covariance if n else projection.covariance(fit.variance)
    J, inner = natural_jacobian(fit.p), given.copy()
    inner[: 2 * n] = J @ inner[: 2 * n]
    inner[:, : 2 * n] = inner[:, : 2 * n] @ J.T
    inner = 0.5 * (inner + inner.T)  # but for rounding
    twice = np.where(fit.p[rank].imag == 0, 2.0, 1.0).repeat(int(np.prod(entries)))
    size[2 * n :][: 2 * len(twice)] *= np.tile(twice, 2)  # a real pole has its residue in two halves
    if not inner.size:
        return np.full((len(order), len(order)), np.nan)
    covariance = inner[np.ix_(order, order)] * np.outer(size, size)
    # a structure may tell of residues that free ones do not show
    hidden = in_order(np.zeros(2 * n), _blind(structure).astype(float)) > 0
    nothing = np.tile((fit.residues[rank] == 0).ravel(), 2)  # weights that are held at 0
    still = np.all(fit.residues[rank] == 0, axis=(1, 2)) & (np.diag(covariance)[:n] == 0)  # poles that leave no trace
    held = np.concatenate([np.tile(still, 2), nothing, np.zeros(int(np.prod(entries)), bool)])
    absent = (order < 0) | (lost & (np.diag(covariance) == 0)) | hidden | held
    covariance[absent] = np.nan
    covariance[:, absent] = np.nan
    return covariance


def _blind(structure: FittedStructure) -> Mask:
    """Which numbers of the shared unknowns free residues leave without a trace, if those of the structure do too."""
    fit, free = structure.fit, structure.free
    if not fit.point.deficiency:
        return np.zeros(fit.projection.shared.shape, bool)
    if len(free.projection.p) == len(fit.p):
        return free.projection.unidentifiable_unknowns
    # a pair of the free model may be two real poles under a structure
    return FreeProjection(free.projection.experiments, fit.p, free.projection.fed).unidentifiable_unknowns

"""A structure that was fitted, with its poles, residues and delays in the order and units of a result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._types import Array, ArrayLike, ComplexArray, Indices
from ..diagnosis.verdict import HypothesisTest
from ..regression.free import FreeProjection, GivenResidues
from ..search.modal_search import FreeFit
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

    def own_spreads(self, experiment: int) -> list[tuple[Array, Array]]:
        """Covariance of what belongs to rows of an experiment, for each output, and with poles and shared unknowns."""
        fit = self.fit
        every = fit.covariance if len(fit.p) else self.measured.covariance(fit.variance)
        return self.measured.own_covariances(experiment, every, fit.variance)

    @cached_property
    def delays(self) -> tuple[Array, Array]:
        """Delay of each output and its standard error: NaN if known to a sample only, 0 if it was given."""
        fit, free, places = self.fit, self.free, places_of(self.free)
        if fit.delays is not None:
            return fit.delays.each[places], fit.delay_errors[fit.delays.groups][places]
        late = np.broadcast_to(free.delay, free.scales.shape)[places]
        return late.copy(), np.where(late != 0, np.nan if free.delay_open else 0.0, 0.0)


def roots(variances: ArrayLike) -> Array:
    """Standard errors; NaN where so little is shown that rounding leaves less than nothing."""
    each = np.asarray(variances, float)
    return np.sqrt(np.where(each >= 0, each, np.nan))

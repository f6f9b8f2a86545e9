"""All numbers of a result, each made from the fitted structure when it is first needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..._types import Array, ComplexArray
from ..diagnosis.fitted_directions import FittedModel
from ..regression.prediction import FittedChannels, joint_percent, shares_left
from .covariance import FittedStructure, covariance_of
from .experiments import fitted_channels, fitted_shapes, squeezed
from .likelihood import FittedLikelihood
from .scaled_shapes import ModeShapes


@dataclass(frozen=True, eq=False)
class Estimates(FittedStructure):
    """A fitted structure with the covariance of its parameters, mode shapes, experiments and likelihood."""

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters, in the order of `PEMResult.covariance`."""
        return covariance_of(self)

    @cached_property
    def experiments(self) -> tuple[FittedChannels, ...]:
        """Predictions and what belongs to each experiment."""
        return fitted_channels(self)

    @cached_property
    def shown(self) -> Any:
        """The experiments as a result shows them: those of one input and one output without dimensions for these."""
        return squeezed(self, self.experiments) if self.is_single else self.experiments

    @cached_property
    def shapes(self) -> tuple[ModeShapes, ComplexArray]:
        """Mode shapes, and their standard errors."""
        return fitted_shapes(self, self.covariance, self.experiments)

    @cached_property
    def likelihood(self) -> FittedLikelihood:
        """Likelihood and criteria."""
        return FittedLikelihood.of(self, self.experiments)

    @cached_property
    def fit_percent(self) -> float:
        """How much of the outputs the prediction has, in per cent."""
        return joint_percent(shares_left([(each.record, each.predicted) for each in self.experiments]))

    @property
    def model(self) -> FittedModel:
        """What the directions of the fit depend on."""
        free, delay = self.free, self.delays[0]
        return FittedModel(
            self.poles, self.residues, self.fit.feedthrough, self.covariance, delay, self.request.quantities,
            free.method, free.intersample,
        )  # fmt: skip

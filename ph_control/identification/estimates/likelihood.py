"""Likelihood of a fit, the criteria made of it, and the variance of the noise of each output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._types import Array
from ..data.channels import ResponseMatrix
from ..diagnosis.noise_levels import level_of
from ..regression.prediction import FittedChannels, pieces
from ..search.findings import Cause
from ..search.fitted_modes import FreeFit
from .covariance import FittedStructure


@dataclass(frozen=True, eq=False)
class FittedLikelihood:
    """Gaussian likelihood of a fit.

    Attributes
    ----------
    samples, unknowns : int
        Number of real samples, and of estimated numbers, variances of the noise among them.
    loss : float
        Mean squared residual; of several outputs the geometric mean of theirs.
    loglik : float
        The logarithm.
    noise_variance : ndarray, shape (p,) or (p, m)
        Of the noise of each output, or entry of a response.
    spare : int
        Samples beyond the unknowns.
    """

    samples: int
    unknowns: int
    loss: float
    loglik: float
    noise_variance: Array
    spare: int

    @classmethod
    def of(cls, structure: FittedStructure, experiments: Sequence[FittedChannels]) -> FittedLikelihood:
        """Likelihood of a structure by what it leaves of the experiments."""
        fit, free, unknowns = structure.fit, structure.free, _unknowns(structure)
        counts, variances = _variances(experiments, free)
        samples, known = int(counts.sum()), counts > 0
        loglik = float(-0.5 * np.sum(counts[known] * (np.log(2 * np.pi * variances[known]) + 1)))
        if free.noise or free.beside is not None:  # that of the innovations, less what a structure costs
            loglik = free.criteria.loglik - 0.5 * (fit.loss - free.projection.loss) / free.variance
        # as variances are divided by it, they are none of the unknowns
        spare = max(1, samples - (unknowns - len(free.scales)))
        noise_variance = (variances * samples / spare).reshape(fit.feedthrough.shape[: 1 + free.per_entry])
        loss = float(np.exp(counts @ np.log(variances) / max(1, samples)))
        return cls(samples, unknowns, loss, loglik, noise_variance, spare)

    @property
    def aic(self) -> float:
        """Criterion of Akaike."""
        return 2 * self.unknowns - 2 * self.loglik

    @property
    def bic(self) -> float:
        """Criterion of Schwarz."""
        return self.unknowns * float(np.log(self.samples)) - 2 * self.loglik


def _unknowns(structure: FittedStructure) -> int:
    """Number of estimated numbers: those of the free fit, less what the structure saves, with delays and variances."""
    fit, free = structure.fit, structure.free
    delays = 0 if fit.delays is None else fit.delays.count
    extra = fit.parameters - delays - (len(free.projection.x) + int(free.projection.shown.sum()))
    late = sum(finding.cause is Cause.INPUT_DELAY for finding in free.findings)
    return free.unknowns + min(0, extra) + delays + len(free.scales) + late


def _variances(experiments: Sequence[FittedChannels], free: FreeFit) -> tuple[Array, Array]:
    """Number of real residuals of each output or entry, and the mean square of these, in the same noise."""
    counts: Any = 0
    losses: Any = 0.0
    for data, channel in zip(experiments, free.channels, strict=True):
        known = data.record.observed & ~np.isnan(data.predicted)
        counts = counts + known.sum(axis=-1) * (1 + free.per_entry)
        if isinstance(data.record, ResponseMatrix) and data.record.errors is not None:
            losses = losses + np.nansum(np.abs(data.record.in_noise(data.residuals)) ** 2, axis=-1)
            continue
        if (level := level_of(channel)) is not None:
            residuals = np.where(known, data.residuals / level, 0.0)
            losses = losses + np.sum(residuals**2, axis=-1) / data.noise_scale**2
            continue
        for weights, _, residuals in pieces([(data.record, data.predicted)]):
            losses = losses + np.sum(weights * np.abs(residuals) ** 2, axis=-1) / data.noise_scale**2
    divisor = np.maximum(np.ravel(counts), 1)
    return np.ravel(counts), np.maximum(np.ravel(losses), np.finfo(float).tiny * divisor) / divisor

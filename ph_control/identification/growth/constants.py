"""Constants of outputs that the data ask for, in noise as slow as outputs are left with."""

from __future__ import annotations

import numpy as np

from ..._types import Array
from ..regression.free import FreeProjection
from ..regression.time_rows import FreeRecord
from ..search.circumstances import correlations, foretold


def evidence_of_constants(projection: FreeProjection) -> float:
    """Return how much the loss would grow without the constants of outputs, in noise as slow as these are left with."""
    covariance, slowness = projection.covariance(1.0), _slowness(projection)
    triples = (
        (own[-1], inner[-1, -1], slow) for k, outputs in enumerate(projection.own) for own, (inner, _), slow in zip(
            outputs.T, projection.own_covariances(k, covariance, 1.0), slowness[k], strict=True
        )
    )  # fmt: skip
    return float(sum(value**2 / (variance * slow) for value, variance, slow in triples))


def _slowness(projection: FreeProjection) -> list[list[float]]:
    """Return of each record and output how many times the variance of a mean is that in white noise."""
    slowness = []
    for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
        assert isinstance(rows, FreeRecord)
        each = []
        for residual in rows.residuals(predicted):
            models, variances = foretold(correlations([np.fft.rfft(residual)], [rows.length]))
            order = order_of_noise(rows.samples, variances)
            each.append(max(1.0, float(variances[order] / (1 - models[order].sum()) ** 2)))
        slowness.append(each)
    return slowness


def order_of_noise(samples: int, variances: Array) -> int:
    """Return the order of an autoregression that BIC prefers."""
    return int(np.argmin(samples * np.log(variances) + np.log(max(samples, 2)) * np.arange(len(variances))))

"""Whether residuals are white."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]


def ljung_box(residuals: Sequence[Array], lags: int) -> float:
    """p-value of the Ljung-Box test that residuals of several records are white; NaN residuals count as 0."""
    statistic, used = 0.0, 0
    for one in residuals:
        e = np.where(np.isnan(one), 0.0, one)
        power, samples = float(e @ e), len(e)
        count = min(lags, samples // 5)
        if power == 0 or count < 1:
            continue
        rho = np.array([float(e[k:] @ e[:-k]) for k in range(1, count + 1)]) / power
        statistic += samples * (samples + 2) * float(np.sum(rho**2 / (samples - np.arange(1, count + 1))))
        used += count
    return float(chi2.sf(statistic, used)) if used else 1.0

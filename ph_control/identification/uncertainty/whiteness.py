"""Whether residuals are white."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..uncertainty.residual_data import ResidualData, noise_scales
from ..uncertainty.residual_tests import autocorrelation

Array = NDArray[np.float64]

_SAMPLES_PER_LAG = 5


def ljung_box(
    residuals: Sequence[Array],
    lags: int,
    *,
    shared: Sequence[Array] | None = None,
    local: Sequence[Array] | None = None,
) -> float:
    """p-value of the Ljung-Box test that residuals of several records, with NaN where missing, are white.

    Each record may have noise of its own variance.

    `shared` (T_k, s) and `local` (T_k, p_k) are the directions in which a model was fitted to each, to all of them and
    to one alone: they are missing from the residuals.  1 where there is too little to tell.
    """
    lengths = tuple(len(one) for one in residuals)
    largest = max((float(np.fmax.reduce(np.abs(one), initial=0.0)) for one in residuals), default=0.0)
    scales = noise_scales([one / (largest or 1.0) for one in residuals])
    joined = np.concatenate([np.zeros(0), *(one / size for one, size in zip(residuals, scales, strict=True))])
    count = min(lags, int((~np.isnan(joined)).sum()) // _SAMPLES_PER_LAG, max(lengths, default=0) - 1)
    if count < 1 or largest == 0:
        return 1.0
    directions = np.zeros((len(joined), 0))
    if shared is not None:
        directions = np.concatenate([one / size for one, size in zip(shared, scales, strict=True)])
    data = ResidualData(
        joined / largest, np.zeros(len(joined)), directions, count, lengths, tuple(local) if local is not None else ()
    )
    p = autocorrelation(data, 0.95)[2]
    return 1.0 if np.isnan(p) else p

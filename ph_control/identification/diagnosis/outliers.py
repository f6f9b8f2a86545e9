"""Samples that stand out of the noise of all others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from ..._types import Array
from ..data.time_record import LONG, Signal, blocks

_BY_CHANCE = 1e-4  # probability that noise alone shows one anywhere
_FEWEST = 20  # residuals to spare below which nothing is said
_SHARE = 0.03  # of the samples: with more of them the noise has another distribution, or another level in places
_REPEATED = 5  # samples with the largest value of all, below which nothing is said of the range
_OFTEN = 2.0  # times as many of them as of the values next to it
_NEAR = 0.01, 0.1  # of the range: what is next to its end, and how far to look for that
_EFFICIENCY = 0.37  # of the median of absolute values beside the mean of squares


def outliers(residuals: Sequence[Signal], spare: int) -> tuple[tuple[int, ...], ...]:
    """Samples of each of several experiments that noise with the scale of the others would hardly show anywhere.

    Residuals are in units of the noise: real, or complex with real and imaginary parts of equal variance; NaN where
    missing.  `spare` is the number of degrees of freedom: residuals, real and imaginary parts, less fitted parameters.
    The scale of each experiment is estimated from the median of absolute residuals, of long records of a part, which
    outliers do not move; the bound is Bonferroni's for so many t-distributed variables.
    """
    count = sum(
        int(np.count_nonzero(~np.isnan(_parts(residual[part]))))
        for residual in residuals
        for part in blocks(len(residual))
    )
    if spare < _FEWEST:
        return ((),) * len(residuals)
    bound = float(t.isf(0.5 * _BY_CHANCE / count, _EFFICIENCY * spare / len(residuals)))
    outlying = []
    for residual in residuals:
        few = np.abs(_parts(residual[:: 1 + len(residual) // LONG]))
        scale = float(np.nanmedian(few)) / float(norm.isf(0.25)) * np.sqrt(count / spare) if len(few) else 0.0
        far: list[int] = []
        for part in blocks(len(residual)) if scale else ():
            size = np.abs(_parts(residual[part]))
            far += (part.start + np.flatnonzero(np.any(size > bound * scale, axis=1))).tolist()
        outlying.append(tuple(far) if len(far) <= max(1, _SHARE * len(residual)) else ())
    return tuple(outlying)


def saturation(y: Signal) -> tuple[int, tuple[float, ...]]:
    """How many samples of an output stay at an end of its range, and at which ends.

    A sensor that is driven beyond its range repeats one value, more often than those next to it.  Of values of few
    digits the next one is found as often, and nothing is said.
    """
    ends = np.array(
        [[np.nanmin(y[part]), np.nanmax(y[part])] for part in blocks(len(y)) if not np.isnan(y[part]).all()]
    )
    if not len(ends):
        return 0, ()
    low, high = ends[:, 0].min(), ends[:, 1].max()
    stuck = 0
    limits: tuple[float, ...] = ()
    for end in (low, high):
        below = (np.abs(end - y[part]) for part in blocks(len(y)))
        near = np.concatenate([distance[distance <= _NEAR[1] * (high - low)] for distance in below])
        others = near[near > 0]
        count = len(near) - len(others)
        around = max(_NEAR[0] * (high - low), others.min(initial=np.inf))
        held = count >= _REPEATED and len(others) and count > _OFTEN * np.count_nonzero(others <= around)
        if held:
            stuck, limits = stuck + count, (*limits, float(end))
    return stuck, limits


def _parts(residuals: NDArray[Any]) -> Array:
    if np.iscomplexobj(residuals):
        return np.stack([residuals.real, residuals.imag], axis=1)
    return np.asarray(residuals, float)[:, None]

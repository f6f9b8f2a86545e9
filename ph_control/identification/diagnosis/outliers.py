"""Samples that stand out of the noise of all others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from ..._types import Array
from ..regression.frequency_rows import FrequencyRows
from ..regression.time_rows import RecordRows
from ..regression.variable_projection import Problem

_BY_CHANCE = 1e-4  # probability that noise alone shows one anywhere
_FEWEST = 20  # residuals to spare below which nothing is said
_SHARE = 0.01  # of the samples: with more of them the noise has another distribution, or another level in places
_EFFICIENCY = 0.37  # of the median of absolute values beside the mean of squares


def outliers(residuals: Sequence[NDArray[Any]], spare: int) -> tuple[tuple[int, ...], ...]:
    """Samples of each of several experiments that noise with the scale of the others would hardly show anywhere.

    Residuals are in the scale of the noise, real, or complex with parts alike; NaN where missing.  `spare` are the
    residuals, real and imaginary parts, less what was fitted to them.  The scale of each experiment is that of the
    median, which outliers do not move, and the bound that of the largest of so many t variables, Bonferroni's.
    """
    parts = [_parts(one) for one in residuals]
    count = sum(int(np.count_nonzero(~np.isnan(one))) for one in parts)
    if spare < _FEWEST:
        return ((),) * len(parts)
    bound = float(t.isf(0.5 * _BY_CHANCE / count, _EFFICIENCY * spare / len(parts)))
    found = []
    for one in parts:
        size = np.abs(one)
        scale = float(np.nanmedian(size)) / float(norm.isf(0.25)) * np.sqrt(count / spare) if len(size) else 0.0
        far = np.flatnonzero(np.any(size > bound * scale, axis=1)) if scale else np.zeros(0, int)
        found.append(tuple(far.tolist()) if len(far) <= max(1, _SHARE * len(size)) else ())
    return tuple(found)


def without(problem: Problem, far: Sequence[tuple[int, ...]]) -> Problem:
    """The problem without some samples of each experiment."""
    rows: list[Any] = []
    for one, places in zip(problem.experiments, far, strict=True):
        if isinstance(one, RecordRows):
            observed = one.observed.copy()
            observed[list(places)] = False
            rows.append(replace(one, observed=observed))
        elif isinstance(one, FrequencyRows):
            response = one.record.response.copy()
            response[list(places)] = np.nan
            rows.append(replace(one, record=replace(one.record, response=response)))
    return replace(problem, experiments=tuple(rows))


def _parts(residuals: NDArray[Any]) -> Array:
    if np.iscomplexobj(residuals):
        return np.stack([residuals.real, residuals.imag], axis=1)
    return np.asarray(residuals, float)[:, None]

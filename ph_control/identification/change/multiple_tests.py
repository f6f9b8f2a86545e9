"""p-values of several tests together."""

from __future__ import annotations

import numpy as np
from scipy.special import erfc

from ..._types import Array


def holm(p: Array) -> Array:
    """Adjust p-values (k,) by the method of Holm; NaN stands for no test and stays.

    To reject where the adjusted value is below a level keeps the probability of any false rejection below that level,
    however the tests depend on one another.
    """
    p = np.asarray(p, float)
    adjusted = np.full(p.shape, np.nan)
    tested = np.flatnonzero(~np.isnan(p))
    order = tested[np.argsort(p[tested], kind="stable")]
    factors = np.arange(len(order), 0, -1.0)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * p[order]), 1.0)
    return adjusted


def two_sided(z: Array) -> Array:
    """Probability that a standard normal variable is at least as far from 0 as z."""
    return np.asarray(erfc(np.abs(z) / np.sqrt(2.0)))

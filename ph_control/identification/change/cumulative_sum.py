"""Cumulative sum of vectors (Crosier 1988): small shifts that last add up, and what no shift makes is taken off.

    c = |S + u|,        S+ = (S + u) max(0, 1 - k / c)        u standard normal in q dimensions if nothing has changed

It alarms where `|S|` exceeds the limit h.  The next size depends on the last one only, as `|S + u|^2` is noncentral
chi-square: how long it runs without a false alarm is a Markov chain.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chndtr

from ..._types import Array

_CELLS = 80  # of the sizes up to the limit
_ROUNDS = 60  # of a bisection


def next_sum(sum: Array, step: Array, allowance: float) -> Array:
    """The cumulative sum (q,) after one step."""
    moved = sum + step
    size = float(np.linalg.norm(moved))
    return moved * max(0.0, 1.0 - allowance / size) if size > 0 else moved


def average_run(limit: float, allowance: float, dimensions: int) -> float:
    """Mean number of steps from 0 to the first alarm, where nothing has changed; O(80^3)."""
    edges = limit * np.arange(_CELLS + 1) / _CELLS
    middles = np.concatenate([[0.0], 0.5 * (edges[1:] + edges[:-1])])
    reached = chndtr((allowance + edges[None]) ** 2, dimensions, middles[:, None] ** 2)
    # the first state is a sum of exactly 0
    steps = np.concatenate([reached[:, :1], np.diff(reached, axis=1)], axis=1)
    return float(np.linalg.solve(np.eye(len(steps)) - steps, np.ones(len(steps)))[0])


def limit_for(run: float, allowance: float, dimensions: int) -> float:
    """Limit at which the mean number of steps to a false alarm is as given."""
    low, high = 0.0, 1.0
    while average_run(high, allowance, dimensions) < run:
        low, high = high, 2 * high
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if average_run(middle, allowance, dimensions) < run else (low, middle)
        if high - low <= 1e-6 * high:
            break
    return high

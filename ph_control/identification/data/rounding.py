"""Outputs that were rounded, by a converter, an encoder or a table of few digits: their steps, and their likelihood."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr

from ..._types import Array

_FEWEST = 4  # values that show a step
_ON_GRID = 1e-3  # of a step: how far values may be from whole multiples of it
_NOISE = 0.02, 1.0  # steps: the least and the largest deviation of noise before rounding
_FLAT = 1e-3  # over the square of the step: the least curvature of a log-likelihood, of a sample that tells nothing
_SAME = 1e-9  # of the range: values that are nearer are the same


def rounding_step(y: Array) -> float:
    """Return the step of which all values of an output are whole multiples apart; 0 where there is none."""
    values = np.unique(y[np.isfinite(y)])
    gaps = np.diff(values)
    gaps = gaps[gaps > _SAME * (values[-1] - values[0])] if len(values) else gaps
    if len(gaps) < _FEWEST - 1:
        return 0.0
    step = float(gaps.min())
    multiples = gaps / step
    return step if np.all(np.abs(multiples - np.rint(multiples)) <= _ON_GRID) else 0.0


def noise_before(y: Array, step: float, predicted: Array) -> float:
    """Return the likeliest deviation of the noise that an output had before it was rounded, or the least that counts.

    A sample has the probability that predicted output and noise fall within half a step of it.
    """

    def unlikely(logarithm: float) -> float:
        return -float(np.sum(_probabilities(y, step, predicted, step * np.exp(logarithm))[0]))

    bounds = np.log(_NOISE)
    best = minimize_scalar(unlikely, bounds=bounds, method="bounded", options={"xatol": 0.03})
    return step * float(np.exp(best.x if best.fun < unlikely(bounds[0]) else bounds[0]))


def before_rounding(y: Array, step: float, predicted: Array, noise: float) -> tuple[Array, Array]:
    """Return values and deviations whose squares have the slope and the curvature of the log-likelihood of an output.

    Both are by what was predicted of its samples, to which rounding leaves their mean by no more than a step.
    """
    _, slope, curvature = _probabilities(y, step, predicted, noise)
    curvature = np.maximum(curvature, _FLAT / step**2)
    return predicted + np.clip(slope / curvature, -step, step), 1 / np.sqrt(curvature)


def _probabilities(y: Array, step: float, predicted: Array, noise: float) -> tuple[Array, Array, Array]:
    """Logarithms of the probabilities of samples, with their slopes and negative curvatures by what was predicted."""
    above, below = (0.5 * step + y - predicted) / noise, (-0.5 * step + y - predicted) / noise
    # of the tail that is the smaller one, whose differences are exact
    flip = above + below > 0
    low, high = np.where(flip, -above, below), np.where(flip, -below, above)
    logs = log_ndtr(high) + np.log1p(-np.exp(log_ndtr(low) - log_ndtr(high)))
    densities = [np.exp(-0.5 * side**2 - logs) / np.sqrt(2 * np.pi) for side in (low, high)]
    slope = np.where(flip, -1.0, 1.0) * (densities[0] - densities[1])
    return logs, slope / noise, (slope**2 + high * densities[1] - low * densities[0]) / noise**2

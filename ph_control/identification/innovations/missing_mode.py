"""The mode that a model beside forces lacks: where its prediction errors are no white noise that inputs leave alone.

About each bin, in windows of several widths, prediction errors of covariance 1 are compared with noise of a covariance
of its own beside a gain of its own from the inputs.  What that explains more is the most that a mode there may gain.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import digamma

from ..._types import Array, ComplexArray
from .minimum import Experiment, LikelihoodEvaluation

_NARROWEST = 8  # bins of a window, beside what is fitted in it,
_WIDEST = 1 / 16  # and of all bins
_NO_INPUT = 1e-10  # of the power of the inputs: what is less in a window tells nothing


def missing_mode(evaluation: LikelihoodEvaluation, least: float) -> complex | None:
    """Pole of the mode that the prediction errors ask for most; None where no window gains the `least`.

    Gains are twice the log-likelihood.
    """
    longest = max(evaluation.problem.experiments, key=lambda experiment: len(experiment.z))
    angles, width = np.angle(longest.z), _NARROWEST + 2 * (evaluation.p + evaluation.problem.inputs)
    best, pole = least, None
    while width <= max(_WIDEST * len(angles), _NARROWEST):
        total = np.zeros(len(angles))
        for experiment, errors in zip(evaluation.problem.experiments, evaluation.errors, strict=True):
            centres, each = _gains(evaluation, experiment, errors, round(width * len(experiment.z) / len(angles)))
            total += np.interp(angles, centres, each, left=0.0, right=0.0)
        place = int(np.argmax(total))
        if total[place] > best:
            decay = 0.25 * width * 2 * np.pi / longest.samples
            best, pole = float(total[place]), complex(-decay, angles[place]) / evaluation.point.noise.step
        width *= 2
    return pole


def _gains(
    evaluation: LikelihoodEvaluation, experiment: Experiment, errors: ComplexArray, width: int
) -> tuple[Array, Array]:
    """Angles of the centres of windows of an experiment, and what each gains beyond what noise does on average."""
    p, u = len(errors), experiment.rows[0].u[: experiment.rows[0].inputs]
    spare = width - len(u) - p
    inner = slice(1, len(experiment.z) - 1)
    if spare < 1 or len(experiment.z) - 2 < width:
        return np.array([0.0]), np.array([0.0])
    white = solve_triangular(np.linalg.cholesky(evaluation.covariance), errors[:, inner], lower=True)
    U = np.fft.rfft(u)[:, inner] / np.sqrt(experiment.samples)
    both = np.concatenate([white, U])
    sums = np.cumsum(np.einsum("ik,jk->kij", both, both.conj()), axis=0)
    sums = sums[width - 1 :] - np.concatenate([np.zeros((1, *sums.shape[1:])), sums[:-width]])
    inputs, crossed, total = sums[:, p:, p:], sums[:, :p, p:], sums[:, :p, :p]
    inputs = inputs + _NO_INPUT * np.mean(np.abs(U) ** 2) * width * np.eye(len(u))
    remaining = total - crossed @ np.linalg.solve(inputs, crossed.conj().transpose(0, 2, 1))
    size = np.linalg.slogdet(remaining / width)[1]
    by_chance = float(np.sum(digamma(width - len(u) - np.arange(p)))) - p * np.log(width)
    gain = 2 * (np.trace(total, axis1=1, axis2=2).real - width * (p + size - by_chance))
    angles = np.angle(experiment.z[inner])
    return 0.5 * (angles[: len(gain)] + angles[width - 1 :]), gain

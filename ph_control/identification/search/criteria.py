"""Which order the data speak for: criteria, the error over what is held out, and whether a mode is more than noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ..._types import Array
from ..regression.elimination import column_lengths
from ..regression.tuning import TUNING
from ..regression.variable_projection import Problem, Projection, Refinement
from .steps import Step

CRITERIA = ("bic", "aicc", "aic", "holdout")
HELD_OUT = 1 / 3  # of each experiment, by the criterion of that name


@dataclass(frozen=True)
class Criteria:
    """Gaussian log-likelihood at the best noise variance, a parameter as well, and what is made of it."""

    loglik: float
    aic: float
    aicc: float
    bic: float

    @classmethod
    def of(cls, loglik: float, parameters: int, samples: float) -> Criteria:
        """Criteria of a likelihood with so many parameters, variances among them."""
        aic, spare = 2 * parameters - 2 * loglik, samples - parameters - 1
        aicc = aic + 2 * parameters * (parameters + 1) / spare if spare > 0 else np.inf
        return cls(loglik, aic, aicc, parameters * float(np.log(samples)) - 2 * loglik)

    def by_name(self, name: str) -> float:
        """Value of a criterion; the likelihood guides a search whose choice is made by what was held out."""
        return self.bic if name == "holdout" else float(getattr(self, name))


def criteria(problem: Problem, loss: float, n: int) -> Criteria:
    """Criteria of n modes that leave a sum of squares."""
    return criteria_of(problem.samples, loss, problem.unknowns(n))


def criteria_of(samples: int, loss: float, unknowns: int) -> Criteria:
    """Criteria of a model with so many unknowns that leaves a sum of squares."""
    variance = max(loss / samples, np.finfo(float).tiny)
    return Criteria.of(-0.5 * samples * float(np.log(2 * np.pi * variance) + 1), unknowns + 1, samples)


def preference(problem: Problem, step: Step, name: str) -> float:
    """Value of a criterion for a step of a search, with the noise that the criterion prefers.

    A mode too many mends a little of coloured noise, or of noise on the input, which comes out of the plant at its
    resonances; a few coefficients mend most of it.  What no mode explains yet is not taken for noise.
    """
    found = criteria(problem, step.loss, len(step.d)).by_name(name)
    if not len(step.d):
        return found
    each = 2.0 if name in ("aic", "aicc") else float(np.log(problem.samples))
    return found + min(past_of_noise(problem.samples, step.foretold, each), each - 2 * step.noisy)


def past_of_noise(samples: int, foretold: Array, each: float) -> float:
    """How much a criterion falls where noise may depend on its past, each sample of which it charges for."""
    return float(np.min(samples * np.log(foretold) + each * np.arange(len(foretold))))


def crowded(d: Array, distance: float) -> bool:
    """Whether the mode that joined last may only mend what a circumstance does to another."""
    return len(d) > 1 and bool(np.min(np.abs(d[:-1] - d[-1])) < distance)


def significant(problem: Problem, end: Refinement, again: Callable[[Array], Refinement]) -> Refinement:
    """Drop the weakest mode, one after the other, while noise alone could well have shown it somewhere."""
    while len(end.projection.d):
        evidence = _evidence(end.projection)
        weakest = int(np.argmin(evidence))
        unknowns = problem.unknowns(1) - problem.unknowns(0)
        if chi2.sf(evidence[weakest], unknowns) * problem.samples < TUNING.by_chance:
            break
        before = end.iterations
        end = again(np.delete(end.projection.d, weakest))
        end = replace(end, iterations=before + end.iterations)
    return end


def _evidence(at: Projection) -> Array:
    """How much the loss would grow without each mode, in units of the noise variance (Wald)."""
    n = len(at.d)
    J, known = at.jacobian()
    degrees = max(1, at.problem.samples - int(known.sum()))
    variance = at.loss / degrees
    if variance == 0:
        return np.full(n, np.inf)
    # the mode that each unknown belongs to; -1 where that is a frequency, or an offset
    modes, none = np.arange(n), np.full(n, -1)
    own = [
        np.append(np.tile(modes, 2)[: at.motion(k)], np.full(len(part) - at.motion(k), -1))
        for k, part in enumerate(at.own)
    ]
    owner = np.concatenate([none, modes, *own])[known]
    lengths = column_lengths(J[:, known])
    scaled = np.concatenate([np.zeros(n), at.kappa, *at.own])[known] * lengths
    inverse = np.linalg.pinv(np.linalg.qr(J[:, known] / lengths, mode="r"))
    found = np.zeros(n)
    for l in np.unique(owner[owner >= 0]):
        rows, values = inverse[owner == l], scaled[owner == l]
        # the covariance of these unknowns is rows @ rows.T; its inverse weighs them
        found[l] = values @ np.linalg.lstsq(rows @ rows.T, values, rcond=None)[0] / variance
    return found

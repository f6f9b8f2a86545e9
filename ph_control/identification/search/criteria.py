"""Which order the data speak for: criteria, and whether a mode is more than noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from ..._types import Array
from ..regression.tuning import TUNING

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


def past_of_noise(samples: int, foretold: Array, each: float) -> float:
    """How much a criterion falls where noise may depend on its past, each sample of which it charges for."""
    return float(np.min(samples * np.log(foretold) + each * np.arange(len(foretold))))


def stands_out(gain: float, loss: float, samples: int, unknowns: int, more: int) -> bool:
    """Tell whether noise would hardly let so many unknowns `more` gain as much anywhere in the band."""
    spare = samples - unknowns
    return bool(spare > 0 and loss > 0 and chdtrc(more, gain * spare / loss) * samples < TUNING.by_chance)


def least_gain(loss: float, samples: int, unknowns: int, more: int) -> float:
    """Gain below which none `stands_out`, but for rounding; infinite where none does."""
    spare, chance = samples - unknowns, TUNING.by_chance / samples
    if spare <= 0 or loss <= 0:
        return np.inf
    return float(chdtri(more, chance)) * loss / spare if chance < 1 else 0.0

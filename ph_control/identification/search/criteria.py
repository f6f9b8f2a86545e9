"""Which order the data speak for: criteria, and whether a mode is more than noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from ..._types import Array, ComplexArray, Mask
from ..regression.tuning import TUNING

_REAL = 4  # real poles at most beside modes whose number is open
HELD_OUT = 1 / 3  # of each experiment, by the criterion of that name


@dataclass(frozen=True)
class Orders:
    """Numbers of poles that a model may have.

    Attributes
    ----------
    fewest, most : int
        Modes; 0 and 0 where these are known.
    real_poles : int or None
        Real poles; None for any number.
    """

    fewest: int = 0
    most: int = 0
    real_poles: int | None = None

    @property
    def are_open(self) -> bool:
        """Whether the data choose the number of modes."""
        return self.fewest < self.most

    @property
    def states(self) -> int:
        """States of the largest model, some real poles among them."""
        return 2 * self.most + _REAL

    def admit(self, p: ComplexArray) -> bool:
        """Whether a model may have poles, given by those of imaginary part 0 or more."""
        real = int(np.sum(p.imag == 0))
        return self.fewest <= len(p) - real <= self.most and self.real_poles in (None, real)

    def among(self, p: ComplexArray) -> Mask:
        """Which of the poles of a discrete model, one of each pair, are those of motions that decay as they may."""
        real_may_be = self.real_poles != 0
        return (np.abs(p) < 1) & ((p.imag > 0) | (real_may_be & (p.imag == 0) & (p.real > 0)))


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

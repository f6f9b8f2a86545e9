"""The modes that a search ends with, and what belongs to them; the criteria of their number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy.special import chdtrc, chdtri

from ..._frozen import Frozen
from ..._options import Discretisation, Interpolation
from ..._types import Array, ComplexArray, Mask
from ..data.channels import ResponseMatrix
from ..regression.free import FreeProjection, Lateness
from ..regression.sections import PoleRegion
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..uncertainty.residual_tests import is_white
from .findings import Finding

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
    samples: float

    @classmethod
    def of(cls, loglik: float, parameters: int, samples: float) -> Criteria:
        """Criteria of a likelihood with so many parameters, variances among them."""
        aic, spare = 2 * parameters - 2 * loglik, samples - parameters - 1
        aicc = aic + 2 * parameters * (parameters + 1) / spare if spare > 0 else np.inf
        return cls(loglik, aic, aicc, parameters * float(np.log(samples)) - 2 * loglik, samples)

    def by_name(self, name: str) -> float:
        """Value of a criterion; the likelihood guides a search whose choice is made by what was held out."""
        return self.bic if name == "holdout" else float(getattr(self, name))


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


@dataclass(frozen=True)
class FreeOrder(Criteria):
    """The best model of an order on the way."""

    order: int
    poles: ComplexArray


@dataclass(frozen=True, eq=False)
class FreeFit(Frozen):
    """The most likely modes of any damping and residues.

    Attributes
    ----------
    projection : FreeProjection
        The linear problem at the minimum, over all data; its rows have variance 1.
    channels : tuple of Recording, or of ResponseMatrix
        The data.
    scales : ndarray, shape (outputs of the projection,)
        What one unit of each output of the projection is in the data: the standard deviation of its noise.
    order_table : tuple of FreeOrder
        The orders that were looked at.
    region : PoleRegion
        Where poles were looked for.
    unknowns : int
        Parameters of the model, without the variances.
    criteria : Criteria
        Likelihood, with the variances at their best, and what is made of it.
    rounding : bool
        Whether what is left of an output is rounding, and no noise.
    interrupted : bool
        Whether the search was ended before it had come to its end.
    findings : tuple of Finding
        What the data show beside the modes.
    held_otherwise : callable or None
        Refines these modes with the inputs held otherwise, if that is left to the data: see `rival`.
    measured : FreeProjection or None
        The linear problem of the data as they are, where its noise is coloured and rows were made in which it is white.
    delay : ndarray, shape (outputs of the projection,)
        Time by which each comes later than the response to the inputs, in its rows.
    input_delay : ndarray, shape (m,)
        Time by which each input acts later than the record says, in the rows.
    delay_gain : float
        Log-likelihood by which this explains more.
    delay_open : bool
        Whether the delay is left to the data.
    noise : tuple of ndarray
        Innovations filter of the noise of each output, with which these rows were made; none where the noise is white.
    crowded : bool
        Whether modes of responses overlap so much that they were found all at once, by a common denominator.
    beside : FittedNoise or None
        Noise that outputs share, or that comes through the plant, with which the minimum is a joint one.
    filters : tuple of ndarray
        Innovations filter of the noise of each output that residuals show afterwards; none where `noise` has it all.
    own_noise : tuple of ndarray
        Innovations filters of noise of each output where such noise was looked at: it explains more, or, beside the
        latter, may do so once the poles are fitted in it.
    own_likelier : bool
        Whether noise of each output is likelier than that which outputs share, with the same poles.
    """

    projection: FreeProjection
    channels: tuple[Any, ...]
    scales: Array
    order_table: tuple[FreeOrder, ...]
    region: PoleRegion
    unknowns: int
    criteria: Criteria
    rounding: bool
    interrupted: bool = False
    findings: tuple[Finding, ...] = ()
    held_otherwise: Callable[[], FreeFit] | None = None
    measured: FreeProjection | None = None
    delay: Array = field(default_factory=lambda: np.zeros(1))
    input_delay: Array = field(default_factory=lambda: np.zeros(1))
    delay_gain: float = 0.0
    delay_open: bool = False
    noise: tuple[Array, ...] = ()
    crowded: bool = False
    beside: Any = None
    filters: tuple[Array, ...] = ()
    own_noise: tuple[Array, ...] = ()
    own_likelier: bool = False

    @property
    def leaves_white_noise(self) -> bool:
        """Whether what it leaves, in its noise, passes the Ljung-Box test of whiteness."""
        return is_white(self.projection) if self.beside is None else bool(self.beside.whiteness >= TUNING.white)

    @property
    def per_entry(self) -> bool:
        """Whether outputs of the projection are entries of a response matrix, `output * m + input`."""
        return isinstance(self.channels[0], ResponseMatrix)

    @property
    def windowed(self) -> bool:
        """Whether responses were estimated with a window."""
        return any(getattr(channel, "window", None) is not None for channel in self.channels)

    @property
    def intersample(self) -> Interpolation:
        """Behaviour of the inputs between samples; 'zoh' for response matrices, which have none."""
        rows = self.projection.experiments[0]
        return rows.hold.intersample if isinstance(rows, FreeRecord) else "zoh"

    @property
    def direct(self) -> bool:
        """Whether inputs may be fed through."""
        return self.per_entry or self.projection.has_feedthrough or not self.projection.inputs

    @property
    def method(self) -> Discretisation:
        """Discretisation by which the modes meet the samples."""
        rows = self.projection.experiments[0]
        return rows.hold.method if isinstance(rows, FreeRecord) else "exact"

    @property
    def offset(self) -> int:
        """Terms of what outputs have beside the modes: none, a constant, or a constant and a drift."""
        return max(getattr(rows, "offset", 0) for rows in self.projection.experiments)

    @property
    def lateness(self) -> Lateness:
        """Delays of outputs and inputs."""
        return Lateness(self.delay, self.input_delay)

    @property
    def order(self) -> int:
        """Number of modes: pairs of complex poles."""
        return count_modes(self.projection.p)

    @property
    def states(self) -> int:
        """Number of all poles."""
        return self.order + len(self.projection.p)

    @property
    def variance(self) -> float:
        """Variance of the rows of the projection that is not biased by the parameters."""
        rows = self.projection.rows
        return rows / max(1, rows - self.unknowns)

    def gain_over(self, other: FreeFit) -> float:
        """By how much the BIC is smaller than that of another fit, as of as many samples as that has.

        Where outputs come late, their first samples are left out.
        """
        return other.criteria.bic - self.criteria.bic * other.criteria.samples / self.criteria.samples

    def with_delay_open(self, is_open: bool) -> FreeFit:
        """The fit, and that under the other hold, with the delay left to the data or not."""
        return replace(self.with_rival(lambda rival: replace(rival, delay_open=is_open)), delay_open=is_open)

    @property
    def exact(self) -> bool:
        """Whether what is left of an output is rounding of numbers, and not of what was recorded."""
        return self.rounding and not self.projection.rounded.any()

    @property
    def rival(self) -> FreeFit | None:
        """These modes refined with the inputs held otherwise, if that is left to the data; made when first needed."""
        return None if self.held_otherwise is None or self.interrupted else self.held_otherwise()

    def with_rival(self, change: Callable[[FreeFit], FreeFit]) -> FreeFit:
        """The fit with a change of that under the other hold."""
        made = self.held_otherwise
        return self if made is None else replace(self, held_otherwise=cache(lambda: change(made())))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of imaginary and real parts of the poles, then of what is shared by outputs of the projection."""
        return self.projection.covariance(self.variance)


def feedthrough_of(fit: FreeFit) -> Array:
    """Return what is fed through in the units of the data, shape (p, m)."""
    feedthrough = fit.projection.feedthrough * fit.scales[:, None]
    return feedthrough.reshape(-1, len(fit.channels[0].input_labels)) if fit.per_entry else feedthrough


def count_modes(p: ComplexArray) -> int:
    """Count the pairs of complex poles."""
    return int(np.sum(p.imag > 0))


def count_real_poles(p: ComplexArray) -> int:
    """Count the real poles."""
    return int(np.sum(p.imag == 0))


def are_broad(p: ComplexArray) -> Mask:
    """Return which poles are those of modes without a peak."""
    return (p.imag > 0) & (np.abs(p.real) > TUNING.broadest * np.abs(p))

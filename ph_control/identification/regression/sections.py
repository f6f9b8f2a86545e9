"""Sections: coordinates of poles that pass smoothly from pairs of complex poles through critical damping to real ones.

    s^2 + 2 decay s + product        a section, with the poles -decay +- i sqrt(square), square = product - decay^2,
    s + rate                         a first-order section, where the number of real poles is odd

A section is a damped mode (`square > 0`), an overdamped mass or two lags (`square < 0`), a mass on a damper (a pole at
0) or a rigid body (both).  Poles and residues are not smooth at critical damping, where residues are infinite; these
coordinates and everything that is predicted are.  Data may show a slow pole well and the fast one beside it badly: all
sections with that slow pole are a straight line in these coordinates, which a search follows easily.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, Mask
from .tuning import TUNING

# of their distance from 0, or of a bin: two poles of a section are taken as that far apart. What is predicted changes
# by the square of it, and keeps all but as many digits as it has
_APART = 1e-4
_LOWEST = 0.5  # bins: where modes stay modes, what does not swing half a time is a drift
_NUDGE = 1e-6  # of the size of a coordinate: a step towards a border


@dataclass(frozen=True)
class Sections:
    """Sections of a model: `decay` and `product` of each, shapes (k,), and `rates` (0 or 1,) of a first-order section.

    `places` (k, 2) are those of the poles of each section among all poles, the same twice for one of a complex pair;
    `single` that of the first-order section.
    """

    decay: Array
    product: Array
    rates: Array
    places: Indices
    single: Indices

    @classmethod
    def of(cls, p: ComplexArray) -> Sections:
        """Sections of poles (n,): those of positive imaginary part alone, neighbouring real poles in pairs."""
        pairs = np.flatnonzero(p.imag != 0)
        real = np.flatnonzero(p.imag == 0)
        real = real[np.argsort(-p[real].real, kind="stable")]
        couples = real[: len(real) // 2 * 2].reshape(-1, 2)
        slow, fast = p.real[couples].T if len(couples) else np.zeros((2, 0))
        return cls(
            np.concatenate([-p.real[pairs], -0.5 * (slow + fast)]),
            np.concatenate([np.abs(p[pairs]) ** 2, slow * fast]),
            -p.real[real[2 * len(couples) :]],
            np.concatenate([np.stack([pairs, pairs], axis=1), couples]).astype(int),
            real[2 * len(couples) :],
        )

    @classmethod
    def from_coordinates(cls, x: Array) -> Sections:
        """The sections with these coordinates, poles in the order of the sections."""
        decay, product, rates = np.split(x, [len(x) // 2, 2 * (len(x) // 2)])
        count = np.where(product > decay**2, 1, 2)
        ends = np.cumsum(count).astype(int)
        places = np.stack([ends - count, ends - 1], axis=1)
        single = np.arange(len(rates)) + (int(ends[-1]) if len(ends) else 0)
        return cls(decay, product, rates, places, single)

    def moved(self, x: Array) -> Sections:
        """Sections with other coordinates, poles at the same places as long as each section is of the same kind."""
        sections = Sections.from_coordinates(x)
        return replace(sections, places=self.places, single=self.single) if sections.keeps_kinds(self) else sections

    def keeps_kinds(self, other: Sections) -> bool:
        """Whether the sections of another model have complex, or real poles as these."""
        return np.array_equal(self.square > 0, other.square > 0)

    @cached_property
    def x(self) -> Array:
        """Coordinates: decays, products, rates."""
        return np.concatenate([self.decay, self.product, self.rates])

    @cached_property
    def square(self) -> Array:
        """Squares of the imaginary parts of the poles; of real ones negative, of half their distance."""
        return self.product - self.decay**2

    @cached_property
    def root(self) -> Array:
        """Half the distance of the poles of each section."""
        return np.sqrt(np.abs(self.square))

    @cached_property
    def p(self) -> ComplexArray:
        """Poles, at their places."""
        poles = np.empty(len(np.unique(self.places)) + len(self.single), complex)
        overdamped = self.square <= 0
        poles[self.places[~overdamped, 1]] = (-self.decay + 1j * self.root)[~overdamped]
        # the pole farther from 0 is no difference of nearly the same numbers
        decay, product = self.decay[overdamped], self.product[overdamped]
        far = -decay - np.where(decay < 0, -1.0, 1.0) * self.root[overdamped]
        near = np.divide(product, far, out=np.zeros(len(far)), where=far != 0)
        slow, fast = self.places[overdamped].T
        poles[slow], poles[fast] = np.maximum(near, far), np.minimum(near, far)
        poles[self.single] = -self.rates
        return poles

    @cached_property
    def pole_slopes(self) -> Array:
        """Derivatives of imaginary, then real parts of the poles by the coordinates, shape (2n, len(x))."""
        n, k = len(self.p), len(self.decay)
        slopes, section = np.zeros((2 * n, len(self.x))), np.arange(k)
        slow, fast = self.places.T
        # of two poles that are the same no derivative is finite
        root = np.maximum(self.root, EPS * max(float(np.abs(self.p).max(initial=0.0)), EPS))
        half, oscillating = 0.5 / root, self.square > 0
        real, by_product = np.flatnonzero(~oscillating), k + section
        slopes[n + fast[oscillating], section[oscillating]] = -1.0
        slopes[fast[oscillating], section[oscillating]] = -(self.decay / root)[oscillating]
        slopes[fast[oscillating], by_product[oscillating]] = half[oscillating]
        for places, sign in ((slow[real], -1.0), (fast[real], 1.0)):
            slopes[n + places, real] = sign * self.p[places].real / root[real]
            slopes[n + places, k + real] = sign * half[real]
        slopes[n + self.single, 2 * k + np.arange(len(self.rates))] = -1.0
        return slopes

    def sizes(self, bin: float = 0.0) -> Array:
        """Sizes of the coordinates."""
        distance = np.maximum(np.hypot(self.decay, self.root), bin)
        return np.concatenate([distance, distance**2, np.maximum(np.abs(self.rates), bin)])


@dataclass(frozen=True)
class PoleRegion:
    """Where poles are looked for; `bin` is the distance in frequency within which the loss has one minimum.

    No pole is beyond the `ceiling`, and none grows faster than `growth` bins, by a factor over the record.  Where the
    kinds of sections may not change, those with complex poles are the `oscillating` ones (k,).
    """

    bin: float
    ceiling: float
    kinds_may_change: bool = True
    oscillating: Mask | None = None
    growth: float = TUNING.fastest_growth

    def about(self, sections: Sections) -> PoleRegion:
        """The region of models that begin with some sections."""
        return self if self.kinds_may_change else replace(self, oscillating=sections.square > 0)

    @property
    def _growth(self) -> float:
        return self.growth * self.bin

    def inside(self, x: Array) -> Array:
        """Coordinates brought to where poles are allowed, those of a section apart from one another."""
        decay, product, rates = np.split(x, [len(x) // 2, 2 * (len(x) // 2)])
        decay = np.clip(decay, -self._growth, self.ceiling)
        least, square = self.least(decay), product - decay**2
        product = np.where(np.abs(square) < least, decay**2 + np.where(square < 0, -least, least), product)
        lowest = -np.maximum(np.minimum(decay + self._growth, 2 * self.ceiling - decay) ** 2, least)
        highest = np.full(len(square), self.ceiling**2)
        if self.oscillating is not None:
            lowest = np.where(self.oscillating, (_LOWEST * self.bin) ** 2, lowest)
            highest = np.where(self.oscillating, highest, -least)
        return np.concatenate([
            decay, np.clip(product, decay**2 + lowest, decay**2 + highest), np.clip(rates, -self._growth, self.ceiling)
        ])  # fmt: skip

    def least(self, decay: Array) -> Array:
        """Sizes of squares below which poles of a section are too close to tell what each of them does."""
        return (_APART * np.maximum(np.abs(decay), self.bin)) ** 2

    def reach(self, sections: Sections) -> Array:
        """Widths of the basins of the coordinates: a bin, and the half-width of a peak; of real poles their rate."""
        width = self.bin + np.abs(sections.decay)
        return np.concatenate([
            width, width * (2 * np.hypot(sections.decay, sections.root) + width), self.bin + np.abs(sections.rates)
        ])  # fmt: skip

    def held(self, x: Array, gradient: Array) -> Mask:
        """Which numbers a descent would only push across the border that they are at."""
        nudge = _NUDGE * Sections.from_coordinates(x).sizes(self.bin) * np.sign(gradient)
        # the borders of a product change with the decay
        of_product = (np.arange(len(x)) // max(1, len(x) // 2)) == 1
        ends = [self.inside(x - np.where(moving, nudge, 0.0)) for moving in (~of_product, of_product)]
        return np.asarray((np.where(of_product, ends[1], ends[0]) == x) & (gradient != 0))

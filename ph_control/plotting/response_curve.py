"""A frequency response to draw: gain and continuous phase, points beside a model, bands, and the range to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .. import _checks
from .._types import Array, ComplexArray, Indices, Mask

_SHOWN = 0.02  # of the gap between poles and zeros: nearer than this to one, an infinite peak leaves the picture
_DOT = 1 / 1200  # of the width of a picture
_CROWD = 72  # poles and zeros within so much of that width: a dot cannot tell one from the next
_CROWD_WIDTH = 0.06
_BINS = 150  # of a picture, each eight dots wide
_PER_BIN = 256  # levels of which a median is taken
_SEEN = 1e-6  # relative distance of samples on both sides of a pole or zero that no picture resolves
_BEYOND = 1e4  # decibels
_LONE = 40.0  # decibels by which a few samples may stick out of all others before they leave the picture
_NOTCH = 20.0  # by which an antiresonance may lie below all but a fiftieth of the picture
_EVEN = 600  # places of a picture at which this share is counted
_WIDE = 100.0  # ratio of the ends of a frequency axis beyond which it is logarithmic
_NARROW = 3.0  # and below which it is not
_FILLED = 30.0  # nor where the modes of an even grid are within so much of its upper end
_WRAP = 1.05 * np.pi  # step of the phase that is a wrap; a pole on the axis turns it by half a turn
_BACKWARD = 0.75 * np.pi  # phase beyond which a response may as well begin a turn later or earlier
_WINDOW = 9  # steps of the phase of a table whose mean direction tells a response from noise
_BESIDE = 5
_STEADY = 0.7  # least length of this mean


@dataclass(frozen=True)
class FrequencyAxis:
    """Ends in rad per unit time, size of the unit in the same and its name, and the scale."""

    low: float
    high: float
    unit: float
    unit_name: str
    logarithmic: bool = True

    def position(self, omega: Array) -> Array:
        """Where frequencies are, from 0 at the left end to 1 at the right."""
        if self.logarithmic:
            return np.asarray(np.log(omega / self.low) / np.log(self.high / self.low))
        return np.asarray((omega - self.low) / (self.high - self.low))

    def places(self, start: float, end: float, count: int) -> Array:
        """Frequencies at equal distances on the axis."""
        return (np.geomspace if self.logarithmic else np.linspace)(start, end, count)


def is_logarithmic(
    scale: str | None, low: float, high: float, grid: Array | None = None, modes: Array | None = None
) -> bool:
    """Whether a frequency axis is logarithmic: as `scale` says, else for a logarithmic grid or beyond two decades.

    Not so where the modes are all in the upper part of an evenly spaced grid; of a plant without modes always.
    """
    if scale is not None:
        return _checks.choice("scale", scale, ("log", "linear")) == "log"
    if modes is not None and not len(modes):
        return 0 < low < high / _NARROW
    grid = np.zeros(0) if grid is None else grid[grid > 0]
    if len(grid) < 3 or not 0 < low < high / _NARROW:
        return 0 < low < high / _WIDE
    steps, ratios = (np.std(part) / np.mean(part) for part in (np.diff(grid), np.diff(np.log(grid))))
    if ratios < steps:
        return True
    return low < high / _WIDE and not (modes is not None and np.min(modes) > high / _FILLED)


@dataclass(frozen=True)
class Band:
    """Confidence band of a curve: `magnitude` in decibels and `phase` in degrees, shape (2, N), at `omega`."""

    label: str
    omega: Array
    magnitude: Array
    phase: Array


def band_of(models: Any, omega: Array, level: float, **entry: int) -> Band:
    """Band of models drawn around a system."""
    with np.errstate(divide="ignore"):
        size = 20.0 * np.log10(models.magnitude_band(omega, level, **entry))
    # infinite where draws have their pole, zero where they have their zero: beyond any picture
    size = np.clip(size, -_BEYOND, _BEYOND)
    return Band(f"{100 * level:g} % band", omega, size, models.phase_band(omega, level, **entry))


@dataclass(frozen=True)
class Curve:
    """A response to draw, shape (p, m, N), at `omega`, shape (N,), positive, rad per unit time.

    `singular` holds its poles and zeros on the imaginary axis, ascending; `doubtful`, shape (p, N), marks what is
    mostly noise; `bands` are those of entries (i, j), and `line` properties of its own.
    """

    label: str
    omega: Array
    response: ComplexArray
    singular: Array = field(default_factory=lambda: np.zeros(0))
    nyquist: float | None = None
    doubtful: Mask | None = None
    tabulated: bool = False
    bands: Mapping[tuple[int, int], Band] = field(default_factory=dict)
    line: Mapping[str, Any] = field(default_factory=dict)

    @property
    def vanishes(self) -> bool:
        """Whether the response is zero throughout, of which a logarithmic picture shows nothing."""
        return not np.any(self.response)

    def noisy(self, i: int) -> Mask:
        """Which points of an output say more about noise and leakage than about the system."""
        return np.zeros(len(self.omega), bool) if self.doubtful is None else self.doubtful[i]

    def magnitude(self, i: int, j: int) -> Array:
        """Decibels; NaN where infinite or zero."""
        return decibels(self.response[i, j])

    def phase(self, i: int, j: int, *, unwrap: bool = True) -> Array:
        """Degrees, continuous along the curve; NaN where the response is infinite or zero.

        A phase near half a turn begins below zero where the response falls faster than 1/s, as that of a double
        integrator, else above.  Points of a table that are mostly noise turn nothing.
        """
        values = self.response[i, j]
        usable = np.isfinite(values) & (values != 0)
        angle = np.full(values.shape, np.nan)
        angle[usable] = np.angle(values[usable])
        # without losses half a turn has no sign; with small ones the phase falls at a pole
        turned = (values.imag == 0) & (values.real < 0) & usable
        angle[turned] = np.pi if turned[np.argmax(usable)] else -np.pi
        steady = usable & ~self.scattered(i, j)
        if unwrap and steady.any():
            continuous = np.unwrap(angle[steady], discont=_WRAP)
            continuous += 2 * np.pi * _first_turn(self.omega[steady], np.abs(values[steady]), continuous[0])
            beside = np.interp(np.arange(len(angle)), np.flatnonzero(steady), continuous)
            angle += 2 * np.pi * np.round((beside - angle) / (2 * np.pi))
            angle[steady] = continuous
        return np.asarray(np.degrees(angle))

    def scattered(self, i: int, j: int) -> Mask:
        """Points of a table where the phase steps in all directions, as that of noise does."""
        values = self.response[i, j]
        scattered = np.zeros(len(values), bool)
        usable = np.flatnonzero(np.isfinite(values) & (values != 0))
        if not self.tabulated or len(usable) <= 2 * _WINDOW:
            return scattered
        z = values[usable] / np.abs(values[usable])
        window = np.ones(_WINDOW)
        mean = np.abs(np.convolve(z[1:] * z[:-1].conj(), window, "same"))
        mean /= np.convolve(np.ones(len(mean)), window, "same")
        noise = np.maximum(np.append(mean, 0.0), np.insert(mean, 0, 0.0)) < _STEADY
        # with the points beside, whose steps are half of noise
        scattered[usable] = np.convolve(noise, np.ones(_BESIDE), "same") > 0
        return scattered

    def phase_beside(self, i: int, j: int, other: Curve) -> Array:
        """Degrees within half a turn of the phase of another curve."""
        return _nearest_turn(self.phase(i, j, unwrap=False), self.omega, other.omega, other.phase(i, j))

    def phase_band(self, i: int, j: int, *, unwrap: bool = True) -> Array:
        """Ends of the band of phases, shape (2, N), by whole turns next to the curve."""
        band = self.bands[i, j]
        middle = band.phase.mean(axis=0)
        return np.asarray(
            band.phase + _nearest_turn(middle, band.omega, self.omega, self.phase(i, j, unwrap=unwrap)) - middle
        )

    def visible(self, axis: FrequencyAxis) -> Mask:
        """Where the curve counts for the range of a picture: inside, and not on an infinite peak.

        Nor within a dot of one: between two peaks that a picture cannot part, it would be as high as they are close.
        """
        inside = (self.omega >= axis.low) & (self.omega <= axis.high)
        if not len(self.singular):
            return inside
        fenced = np.concatenate([[0.0], self.singular, [2 * self.singular[-1]]])
        above = np.clip(np.searchsorted(fenced, self.omega), 1, len(fenced) - 1)
        dot = np.log(axis.high / axis.low) * self.omega if axis.logarithmic else axis.high - axis.low
        least = np.maximum(_SHOWN * (fenced[above] - fenced[above - 1]), _DOT * dot)
        return inside & (distance(self.omega, self.singular) >= least)

    def shown(self, i: int, j: int, axis: FrequencyAxis) -> Array:
        """Decibels that a picture must hold: no infinite peak or notch and, of tables, no lone outlier."""
        level = np.where(self.visible(axis), self.magnitude(i, j), np.nan)
        known = np.isfinite(level)
        kept = level[known]
        if self.tabulated and len(kept):
            bottom, top = np.quantile(kept, [0.02, 0.98])
            kept = kept[(kept >= bottom - _LONE) & (kept <= top + _LONE)]
        elif len(kept):
            omega = self.omega[known]
            at = np.searchsorted(omega, axis.places(float(omega[0]), float(omega[-1]), _EVEN)[:-1])
            kept = kept[kept >= np.quantile(kept[at], 0.02) - _NOTCH]
        if (i, j) in self.bands:
            # beyond nine tenths of it the band may run off as its curve does: next to a resonance it is as high
            band = self.bands[i, j]
            seen = band.magnitude[:, replace(self, omega=band.omega).visible(axis)]
            kept = np.concatenate([kept, np.quantile(seen, [0.05, 0.95]) if seen.size else []])
        return kept

    def crowds(self, axis: FrequencyAxis) -> list[tuple[float, float]]:
        """Ranges, ascending and apart, where a picture cannot part poles from zeros."""
        marks = self.singular[(self.singular >= axis.low) & (self.singular <= axis.high)]
        first, last = marks[: 1 - _CROWD], marks[_CROWD - 1 :]
        close = axis.position(last) - axis.position(first) < _CROWD_WIDTH
        starts, ends = first[close], last[close]
        if not len(starts):
            return []
        apart = np.flatnonzero(starts[1:] > ends[:-1])
        return list(zip(starts[[0, *(apart + 1)]].tolist(), ends[[*apart, -1]].tolist(), strict=True))

    def typical(self, level: Array, axis: FrequencyAxis) -> tuple[Array, Array]:
        """Median of `level` over frequency in bins of the crowds, with a NaN between any two of these.

        Between a pole and the next zero a lossless response passes through all levels: lines that close fill the
        picture, and tell nothing of the size of what they fill it with.
        """
        known = np.isfinite(level)
        place, level = axis.position(self.omega[known]), level[known]
        between = 0.5 * (place[1:] + place[:-1])
        omega, middle = [np.zeros(0)], [np.zeros(0)]
        for start, end in self.crowds(axis):
            reach = axis.position(np.array([start, end]))
            bins = max(1, round(_BINS * float(reach[1] - reach[0])))
            points = axis.places(start, end, bins * _PER_BIN).reshape(bins, _PER_BIN)
            # of the nearest samples: those on both sides of a peak are no line
            levels = level[np.searchsorted(between, axis.position(points))]
            omega.append(np.append(points[:, _PER_BIN // 2], end))
            middle.append(np.append(np.median(levels, axis=1), np.nan))
        return np.concatenate(omega), np.concatenate(middle)

    def gaps(self) -> Indices:
        """Places before which a line must break: between the two samples there the response is infinite or zero."""
        if self.tabulated or not len(self.singular):
            return np.zeros(0, np.intp)
        k = np.unique(np.searchsorted(self.omega, self.singular))
        k = k[(k > 0) & (k < len(self.omega))]
        # where the samples come close to a peak from both sides it runs off the picture, and the phase steps
        return k[self.omega[k] - self.omega[k - 1] > _SEEN * self.omega[k]]


def _first_turn(omega: Array, size: Array, start: float) -> int:
    """Turns to add to a curve whose phase starts there, in radians."""
    k = min(4, len(omega) - 1)
    if abs(start) <= _BACKWARD or not k:
        return 0
    sign = -1 if np.log(size[k] / size[0]) < -np.log(omega[k] / omega[0]) else 1
    return 0 if sign * start > 0 else sign


def _nearest_turn(phase: Array, omega: Array, other_omega: Array, other: Array) -> Array:
    """Degrees within half a turn of others at other frequencies."""
    known = np.isfinite(other)
    if not known.any():
        return phase
    beside = np.interp(np.log(omega), np.log(other_omega[known]), other[known])
    return np.asarray(phase + 360.0 * np.round((beside - phase) / 360.0))


def decibels(values: ComplexArray) -> Array:
    """Decibels; NaN where infinite or zero."""
    size = np.abs(values)
    usable = np.isfinite(size) & (size > 0)
    return np.where(usable, 20.0 * np.log10(np.where(usable, size, 1.0)), np.nan)


def distance(x: Array, marks: Array) -> Array:
    """Distance of each `x` to the nearest of the ascending marks."""
    fenced = np.concatenate([[-np.inf], marks, [np.inf]])
    above = np.searchsorted(fenced, x)
    return np.minimum(x - fenced[above - 1], fenced[above] - x)

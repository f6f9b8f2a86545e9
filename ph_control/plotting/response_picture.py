"""The picture of frequency responses: curves, bands, measured points, limits; a pair of panels for each entry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, MultipleLocator

from .. import _checks
from .._options import AXIS_SCALES
from .._types import Array, ComplexArray, Indices, Mask
from .._units import parted
from .style import (
    BAND,
    DOTS,
    ZERO,
    AxesGiven,
    Look,
    Picture,
    gain_label,
    labelled,
    picture,
    plain,
    plain_log_labels,
)

_SHOWN = 0.02  # of the gap between poles and zeros: nearer than this to one, an infinite peak leaves the picture
_DOT = 1 / 1200  # of the width of a picture
_CROWD = 36  # poles and zeros within so much of that width: a dot cannot tell one from the next
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
_MANY = 50  # poles and zeros
_CROWD_BELOW = 2.0  # place among what is drawn, above the grid
_SLACK = 15.0  # degrees beyond a quarter of a turn for which the axis has no further quarter
_STRAY = 0.01  # share of the measured phases that may leave the picture
_LETTERS = 34  # of the name of a panel

PALE_DOTS: dict[str, Any] = {**DOTS, "markersize": 2.5, "color": "0.78", "zorder": 2.1}
LIMIT: dict[str, Any] = {"color": "0.3", "linestyle": ":", "linewidth": 1.0}
POLAR, CARTESIAN = ("magnitude", "phase"), ("real", "imaginary")


# --- numbers of a curve -----------------------------------------------------------------------------------------------


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
        return _checks.choice("scale", scale, AXIS_SCALES) == "log"
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
class ResponseBand:
    """Confidence band of a curve: `magnitude` in decibels and `phase` in degrees, shape (2, N), at `omega`."""

    label: str
    omega: Array
    magnitude: Array
    phase: Array


def band_of(models: Any, omega: Array, level: float, **entry: int) -> ResponseBand:
    """ResponseBand of models drawn around a system."""
    with np.errstate(divide="ignore"):
        size = 20.0 * np.log10(models.magnitude_band(omega, level, **entry))
    # infinite where draws have their pole, zero where they have their zero: beyond any picture
    size = np.clip(size, -_BEYOND, _BEYOND)
    return ResponseBand(f"{100 * level:g} % band", omega, size, models.phase_band(omega, level, **entry))


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
    bands: Mapping[tuple[int, int], ResponseBand] = field(default_factory=dict)
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
            spread = np.searchsorted(omega, axis.places(float(omega[0]), float(omega[-1]), _EVEN)[:-1])
            kept = kept[kept >= np.quantile(kept[spread], 0.02) - _NOTCH]
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


# --- numbers of a picture ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scale:
    """How gains and phases are drawn."""

    dB: bool = True
    deg: bool = True
    wrap: bool = False
    negative_imaginary: bool = False

    @property
    def angle(self) -> float:
        """Size of a degree."""
        return 1.0 if self.deg else np.pi / 180.0

    def gain(self, level: Array) -> Array:
        """Decibels as they are drawn."""
        return level if self.dB else np.asarray(10.0 ** (level / 20.0))

    def label(self, part: str, unit: str | None, short: bool) -> str:
        """Label of an axis; a short one of decibels is its unit alone."""
        if part == "magnitude":
            text = gain_label(unit) if self.dB else labelled("Magnitude", unit)
            return text[text.index("[") + 1 : -1] if short and self.dB else text
        if part == "phase":
            return "Phase [deg]" if self.deg else "Phase [rad]"
        return labelled({"real": "Re", "imaginary": "−Im" if self.negative_imaginary else "Im"}[part], unit)


@dataclass(frozen=True)
class DrawnResponses:
    """All that is drawn: curves, measured responses of the same entries, their axis and names."""

    curves: list[Curve]
    measured: list[Curve]
    axis: FrequencyAxis
    output_labels: Sequence[str]
    input_labels: Sequence[str]
    title: str = ""

    @property
    def nyquist(self) -> list[float]:
        """Nyquist frequencies inside the picture, ascending."""
        limits = {curve.nyquist for curve in [*self.curves, *self.measured] if curve.nyquist is not None}
        return sorted(limit for limit in limits if self.axis.low <= limit <= self.axis.high)

    def cells(self, wide: int) -> tuple[list[tuple[int, int]], tuple[int, int]]:
        """Entries in the order of their panels, and the shape of these: a single row or column is folded."""
        p, m = len(self.output_labels), len(self.input_labels)
        every = [(i, j) for i in range(p) for j in range(m)]
        if min(p, m) > 1 or wide == 1:
            return every, (p, m)
        # no row of a single panel where two rows of two hold them
        columns = 2 if len(every) == 4 else min(len(every), wide)
        return every, (-(-len(every) // columns), columns)

    def name(self, i: int, j: int) -> str:
        """What a panel is called: without units, and without the only input where the name would not fit."""
        source, sensor = (parted(name)[0] for name in (self.input_labels[j], self.output_labels[i]))
        name = f"{source} to {sensor}"
        name = sensor if len(self.input_labels) == 1 and len(name) > _LETTERS else name
        return name if len(name) <= _LETTERS else name[: _LETTERS - 1] + "…"

    def phases(self, i: int, j: int, *, wrap: bool = False) -> list[Array]:
        """Degrees of all curves, and of what was measured: that, and tables, within half a turn of the first model."""
        if wrap:
            return [curve.phase(i, j, unwrap=False) for curve in [*self.curves, *self.measured]]
        models = [curve for curve in self.curves if not curve.tabulated]
        first = (models or self.curves)[0]
        return [
            curve.phase_beside(i, j, first) if models and curve.tabulated else curve.phase(i, j)
            for curve in self.curves
        ] + [dots.phase_beside(i, j, first) for dots in self.measured]

    def values(self, part: str, i: int, j: int, scale: Scale) -> tuple[list[Array], list[Array]]:
        """Numbers to draw of all curves, and of what was measured."""
        every = [*self.curves, *self.measured]
        if part == "magnitude":
            drawn = [scale.gain(curve.magnitude(i, j)) for curve in every]
        elif part == "phase":
            drawn = [scale.angle * phase for phase in self.phases(i, j, wrap=scale.wrap)]
        elif part == "real":
            drawn = [curve.response[i, j].real for curve in every]
        else:
            drawn = [(-1.0 if scale.negative_imaginary else 1.0) * curve.response[i, j].imag for curve in every]
        return drawn[: len(self.curves)], drawn[len(self.curves) :]


def draw_responses(
    responses: DrawnResponses, look: Look, ax: AxesGiven, parts: Sequence[str], scale: Scale,
    units: Sequence[str | None], wide: int = 1, meaning: str = "",
) -> Picture:  # fmt: skip
    """Panels of all entries, the parts of each below one another; a unit for each output."""
    cells, (rows, columns) = responses.cells(wide if ax is None else 1)
    kinds = len(parts)
    each = 3.4 if rows == 1 else 2.3 if rows <= 3 else 1.6
    size = (max(6.4, 3.5 * columns), 0.9 + each * rows * (1.0 if kinds == 2 else 0.62))
    heights = [1.6, 1.0] if tuple(parts) == POLAR else [1.0] * kinds
    drawn = picture(look, ax, (kinds * rows, columns), size, meaning=meaning, sharex=True, height_ratios=heights * rows)
    for k, (i, j) in enumerate(cells):
        row, column = divmod(k, columns)
        for index, part in enumerate(parts):
            axis = drawn.axes[kinds * row + index, column]
            drawn.lines[kinds * row + index, column] = draw_part(axis, responses, part, i, j, look, scale)
            draw_limits(axis, responses)
            if column == 0:
                axis.set_ylabel(scale.label(part, units[i], short=rows > 1))
        # those below may have no panel
        if k + columns >= len(cells):
            axis.set_xlabel(labelled("Frequency", responses.axis.unit_name))
            axis.tick_params(labelbottom=True)
        if len(cells) > 1:
            first = drawn.axes[kinds * row, column]
            first.set_title(plain(responses.name(i, j)), loc="left", fontsize="small", pad=2.0)
    for k in range(len(cells), rows * columns):
        for index in range(kinds):
            place = kinds * (k // columns) + index, k % columns
            drawn.axes[place].set_visible(False)
            drawn.lines[place] = []
    return drawn


def draw_part(
    axis: Axes, responses: DrawnResponses, part: str, i: int, j: int, look: Look, scale: Scale
) -> list[Line2D]:
    """One part of an entry on its axes, which get their range; lines of curves, then of measurements."""
    values, dots = responses.values(part, i, j, scale)
    if part in CARTESIAN:
        axis.axhline(0.0, **ZERO)
    lines = _draw_curves(axis, responses, part, values, i, j, look)
    if part in POLAR:
        _draw_bands(axis, responses, lines, part, i, j, scale)
    lines += _draw_dots(axis, responses, dots, i)
    if part == "magnitude":
        _magnitude_range(axis, responses, i, j, scale)
    elif part == "phase":
        _phase_range(axis, responses, values, dots, i, scale)
    draw_frequency_axis(axis, responses.axis, look)
    return lines


def _draw_curves(
    axis: Axes, responses: DrawnResponses, part: str, values: list[Array], i: int, j: int, look: Look
) -> list[Line2D]:
    """Curves, and medians where they close to a block."""
    lines: list[Line2D] = []
    unit = responses.axis.unit
    for k, (curve, value) in enumerate(zip(responses.curves, values, strict=True)):
        label = plain(f"{curve.label}: zero" if curve.vanishes else curve.label)
        properties, breaks, crowds = look.curve(k) | dict(curve.line), curve.gaps(), curve.crowds(responses.axis)
        if len(breaks):
            # what stands between two breaks is no line
            properties |= {"marker": ".", "markersize": 4.0}
        if len(curve.singular) > _MANY and "linewidth" not in look.line:
            # many resonances are told apart by thinner lines only
            properties["linewidth"] = 0.7
        if crowds:
            properties["zorder"] = _CROWD_BELOW
        # lines between points that are mostly noise are strokes across the picture
        stray = curve.scattered(i, j) if part == "phase" else np.zeros(len(value), bool)
        omega, level = np.insert(curve.omega, breaks, np.nan), np.insert(np.where(stray, np.nan, value), breaks, np.nan)
        lines += axis.plot(omega / unit, level, label=label, **properties)
        if stray.any():
            axis.plot(curve.omega[stray] / unit, value[stray], **PALE_DOTS | {"color": lines[-1].get_color()})
        # a block is pale, and nothing else: above such curves, below all others
        for start, end in crowds:
            pale: dict[str, Any] = {"color": axis.get_facecolor(), "alpha": 0.7, "linewidth": 0.0}
            axis.axvspan(start / unit, end / unit, zorder=_CROWD_BELOW + 0.05, **pale)
        if part == "magnitude" and crowds:
            omega, middle = curve.typical(value, responses.axis)
            label = plain(f"{curve.label}: median where resonances are closer than dots")
            axis.plot(omega / unit, middle, label=label, color=lines[-1].get_color(), linewidth=1.6, zorder=3.1)
    return lines


def _draw_bands(
    axis: Axes, responses: DrawnResponses, lines: list[Line2D], part: str, i: int, j: int, scale: Scale
) -> None:
    """Confidence bands of magnitude or phase, in the colours of their curves."""
    for curve, line in zip(responses.curves, lines, strict=True):
        if (i, j) in curve.bands:
            band = curve.bands[i, j]
            ends = (
                scale.gain(band.magnitude) if part == "magnitude"
                else scale.angle * curve.phase_band(i, j, unwrap=not scale.wrap)
            )  # fmt: skip
            axis.fill_between(
                band.omega / responses.axis.unit, *ends, label=plain(band.label), color=line.get_color(), **BAND
            )


def _draw_dots(axis: Axes, responses: DrawnResponses, dots: list[Array], i: int) -> list[Line2D]:
    lines, named = [], set()
    for curve, value in zip(responses.measured, dots, strict=True):
        inside = (curve.omega >= responses.axis.low) & (curve.omega <= responses.axis.high) & np.isfinite(value)
        noisy = curve.noisy(i)
        for which, style, label in (
            (inside & ~noisy, DOTS, curve.label), (inside & noisy, PALE_DOTS, "coherence below 0.5")
        ):  # fmt: skip
            if which.any():
                once = "_" if label in named else plain(label)
                named.add(label)
                places = curve.omega[which] / responses.axis.unit
                lines += axis.plot(places, value[which], label=once, rasterized=True, **style | dict(curve.line))
    return lines


def _magnitude_range(axis: Axes, responses: DrawnResponses, i: int, j: int, scale: Scale) -> None:
    every = [curve.shown(i, j, responses.axis) for curve in [*responses.curves, *responses.measured]]
    values = np.concatenate(every)
    if not scale.dB:
        axis.set_yscale("log")
    if len(values):
        margin = 4.0 + 0.05 * np.ptp(values)
        axis.set_ylim(*scale.gain(np.array([values.min() - margin, values.max() + margin])))
    if scale.dB:
        axis.yaxis.set_major_locator(MaxNLocator(nbins=7, steps=[1, 2, 4, 5, 10]))


def _phase_range(
    axis: Axes, responses: DrawnResponses, values: list[Array], dots: list[Array], i: int, scale: Scale
) -> None:
    """Whole quarters of a turn that hold the curves and all but a few of the measured points."""
    ends = [np.zeros(0)]
    for curve, value in zip([*responses.curves, *responses.measured], [*values, *dots], strict=True):
        inside = (curve.omega >= responses.axis.low) & (curve.omega <= responses.axis.high)
        seen = value[inside & ~curve.noisy(i) & np.isfinite(value)] / scale.angle
        share = _STRAY * curve.tabulated
        ends += [np.quantile(seen, [share, 1.0 - share])] if len(seen) else []
    every = np.concatenate(ends) if len(ends) > 1 else np.zeros(1)
    low, high = 90.0 * np.floor((every.min() + _SLACK) / 90.0), 90.0 * np.ceil((every.max() - _SLACK) / 90.0)
    low, high = (low, high) if high > low else (high - 90.0, low + 90.0)
    step = 90.0 if high - low <= 450.0 else 180.0
    axis.set_ylim(scale.angle * (low - 0.25 * step), scale.angle * (high + 0.25 * step))
    if high - low <= 1440.0:
        if axis.get_window_extent().height < axis.figure.dpi and high - low > 180.0:  # below an inch
            step = 180.0 if high - low <= 540.0 else 360.0
        axis.yaxis.set_major_locator(MultipleLocator(scale.angle * step))
        axis.yaxis.set_minor_locator(MultipleLocator(scale.angle * step / 2.0))
    if not scale.deg:
        axis.yaxis.set_major_formatter(lambda value, _: f"{value / np.pi:g}π" if value else "0")


def draw_frequency_axis(axis: Axes, frequency: FrequencyAxis, look: Look) -> None:
    """Scale, ends and grid of the abscissa."""
    axis.set_xscale("log" if frequency.logarithmic else "linear")
    axis.set_xlim(frequency.low / frequency.unit, frequency.high / frequency.unit)
    if frequency.logarithmic:
        plain_log_labels(axis)
    look.lattice(axis, minor="x" if frequency.logarithmic else None)


def draw_limits(axis: Axes, responses: DrawnResponses) -> None:
    """Nyquist frequencies."""
    unit, name = responses.axis.unit, responses.axis.unit_name
    limits = [limit / unit for limit in responses.nyquist]
    values = ", ".join(f"{limit:.4g}" for limit in limits)
    for k, limit in enumerate(limits):
        axis.axvline(limit, label="_" if k else plain(f"Nyquist frequency ({values} {name})"), zorder=1, **LIMIT)

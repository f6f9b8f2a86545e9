"""The picture of frequency responses: curves, bands, measured points, limits; a pair of panels for each entry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator

from .._types import Array
from .._units import parted
from .response_curve import Curve, FrequencyAxis
from .style import BAND, DOTS, ZERO, Look, Picture, PlainLogFormatter, gain_label, labelled, picture, plain

_MANY = 50  # poles and zeros
_NARROW = 100.0  # ratio of the ends of the frequency axis below which its labels are plain numbers
_CROWD_BELOW = 2.0  # place among what is drawn, above the grid
_SLACK = 15.0  # degrees beyond a quarter of a turn for which the axis has no further quarter
_STRAY = 0.01  # share of the measured phases that may leave the picture
_LETTERS = 34  # of the name of a panel

PALE_DOTS: dict[str, Any] = {**DOTS, "markersize": 2.5, "color": "0.78", "zorder": 2.1}
LIMIT: dict[str, Any] = {"color": "0.3", "linestyle": ":", "linewidth": 1.0}
POLAR, CARTESIAN = ("magnitude", "phase"), ("real", "imaginary")


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
class Responses:
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

    def values(self, part: str, i: int, j: int, scale: Scale) -> tuple[list[Array], list[Array]]:
        """Numbers to draw of all curves, and of what was measured."""
        every = [*self.curves, *self.measured]
        if part == "magnitude":
            drawn = [scale.gain(curve.magnitude(i, j)) for curve in every]
        elif part == "phase":
            drawn = [scale.angle * curve.phase(i, j, unwrap=not scale.wrap) for curve in self.curves]
            drawn += [
                scale.angle * (one.phase(i, j, unwrap=False) if scale.wrap else one.phase_beside(i, j, self.curves[0]))
                for one in self.measured
            ]
        elif part == "real":
            drawn = [curve.response[i, j].real for curve in every]
        else:
            drawn = [(-1.0 if scale.negative_imaginary else 1.0) * curve.response[i, j].imag for curve in every]
        return drawn[: len(self.curves)], drawn[len(self.curves) :]


def draw_responses(
    responses: Responses, look: Look, ax: Any, parts: Sequence[str], scale: Scale, units: Sequence[str | None],
    wide: int = 1, meaning: str = "",
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


def draw_part(axis: Axes, responses: Responses, part: str, i: int, j: int, look: Look, scale: Scale) -> list[Any]:
    """One part of an entry on its axes, which get their range; lines of curves, then of measurements."""
    values, dots = responses.values(part, i, j, scale)
    if part in CARTESIAN:
        axis.axhline(0.0, **ZERO)
    lines = _draw_curves(axis, responses, part, values, i, j, look, scale)
    lines += _draw_dots(axis, responses, dots, i)
    if part == "magnitude":
        _magnitude_range(axis, responses, i, j, scale)
    elif part == "phase":
        _phase_range(axis, responses, values, dots, i, scale)
    draw_frequency_axis(axis, responses.axis, look)
    return lines


def _draw_curves(
    axis: Axes, responses: Responses, part: str, values: list[Array], i: int, j: int, look: Look, scale: Scale
) -> list[Any]:
    """Curves, medians where they close to a block, and bands around them."""
    lines: list[Any] = []
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
    for curve, line in zip(responses.curves, lines, strict=True):
        if (i, j) in curve.bands and part in POLAR:
            band = curve.bands[i, j]
            ends = (
                scale.gain(band.magnitude) if part == "magnitude"
                else scale.angle * curve.phase_band(i, j, unwrap=not scale.wrap)
            )  # fmt: skip
            axis.fill_between(band.omega / unit, *ends, label=plain(band.label), color=line.get_color(), **BAND)
    return lines


def _draw_dots(axis: Axes, responses: Responses, dots: list[Array], i: int) -> list[Any]:
    lines, named = [], set()
    for one, value in zip(responses.measured, dots, strict=True):
        inside = (one.omega >= responses.axis.low) & (one.omega <= responses.axis.high) & np.isfinite(value)
        noisy = one.noisy(i)
        for which, style, label in (
            (inside & ~noisy, DOTS, one.label), (inside & noisy, PALE_DOTS, "coherence below 0.5")
        ):  # fmt: skip
            if which.any():
                once = "_" if label in named else plain(label)
                named.add(label)
                at = one.omega[which] / responses.axis.unit
                lines += axis.plot(at, value[which], label=once, rasterized=True, **style | dict(one.line))
    return lines


def _magnitude_range(axis: Axes, responses: Responses, i: int, j: int, scale: Scale) -> None:
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
    axis: Axes, responses: Responses, values: list[Array], dots: list[Array], i: int, scale: Scale
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
    if frequency.logarithmic and frequency.high < _NARROW * frequency.low:
        axis.xaxis.set_major_formatter(PlainLogFormatter())
        axis.xaxis.set_minor_formatter(PlainLogFormatter(labelOnlyBase=False))
    look.lattice(axis, minor="x" if frequency.logarithmic else None)


def draw_limits(axis: Axes, responses: Responses) -> None:
    """Nyquist frequencies."""
    unit, name = responses.axis.unit, responses.axis.unit_name
    limits = [limit / unit for limit in responses.nyquist]
    values = ", ".join(f"{limit:.4g}" for limit in limits)
    for k, limit in enumerate(limits):
        axis.axvline(limit, label="_" if k else plain(f"Nyquist frequency ({values} {name})"), zorder=1, **LIMIT)

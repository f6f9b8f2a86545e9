"""Pictures of validation: models beside a frequency response, correlations of residuals, and the choice of the order.

Each function returns a `control.ControlPlot`, and draws on given axes or a new figure, which `heading` entitles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator

from .._types import Array, ComplexArray, Indices, Mask
from .bode_data import decibels
from .fit_plot import line_of_model
from .style import BAND, SAMPLES, ZERO, FrameStyle, Look, frequency_axis, gain_label, labelled, picture, plain

if TYPE_CHECKING:
    from typing_extensions import Unpack

# the line between two points is not the response, which may have a resonance there
_POINTS: dict[str, Any] = {"linewidth": 0.8, "marker": ".", "markersize": 4.0, "zorder": 3}
_INSIDE, _OUTSIDE = "0.25", "C3"
_CRITERIA = {"AIC": ("C0", "s", "-"), "AICc": ("C2", "^", "--"), "BIC": ("C3", "o", "-"), "hold-out": ("C4", "D", ":")}
_FLAT = 10.0  # differences of a criterion below this are drawn to a linear scale

# --- models beside a frequency response ------------------------------------------------------------------------------


def response_comparison_plot(
    omega: Array,
    measured: ComplexArray,
    predicted: ComplexArray,
    *,
    labels: Sequence[str],
    time_unit: str | None = None,
    Hz: bool = False,
    gain_unit: str | None = None,
    heading: str,
    ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Magnitudes of all models over the measured one, phases below, and the size of the errors.

    `predicted` has shape (k, K); the other arguments are those of `bode_plot`.
    """
    look = Look.of(style, FrameStyle)
    unit, unit_name = frequency_axis(Hz, time_unit)
    frequency, cut = omega / unit, _phase_cut(measured)
    with look.context():
        drawn = picture(look, ax, (3, 1), (7.2, 5.55), tied=3, height_ratios=[2.4, 1.7, 1.7])
        gains, phases, errors = drawn.axes[:, 0]
        for row, of in enumerate((decibels, lambda values: _degrees(values, cut))):
            axis = drawn.axes[row, 0]
            drawn.lines[row, 0] = axis.plot(frequency, of(measured), label="measured", zorder=2, **SAMPLES)
            for k, (label, values) in enumerate(zip(labels, predicted, strict=True)):
                line = axis.plot(frequency, of(values), label=plain(label), **_POINTS, **line_of_model(k))
                drawn.lines[row, 0] += line
        drawn.lines[2, 0] = []
        # the smaller error is drawn over the larger
        for k in np.argsort([float(np.nanmean(np.abs(measured - values) ** 2)) for values in predicted])[::-1]:
            properties = {"label": plain(labels[k]), "linewidth": 1.0, **line_of_model(int(k))}
            drawn.lines[2, 0] += errors.plot(frequency, decibels(measured - predicted[k]), **properties)
        # models on their peaks run out of the picture
        known = decibels(measured)[np.isfinite(decibels(measured))]
        if len(known):
            margin = 5.0 + 0.25 * float(np.ptp(known))
            gains.set_ylim(float(known.min()) - margin, float(known.max()) + margin)
        gains.set(ylabel=gain_label(gain_unit))
        phases.set(ylabel="Phase [deg]", ylim=(cut - 20.0, cut + 380.0))
        phases.yaxis.set_major_locator(MultipleLocator(90.0))
        errors.set(ylabel=gain_label(gain_unit, "Error"), xlabel=labelled("Frequency", unit_name))
        for axis in (gains, phases, errors):
            _over_frequency(axis, frequency, look)
        return drawn.finished(heading)


def _over_frequency(axis: Axes, frequency: Array, look: Look) -> None:
    """Logarithmic over more than a decade; a point at 0 has no place there."""
    positive = frequency[frequency > 0]
    logarithmic = len(positive) > 0 and positive[-1] > 10.0 * positive[0]
    if logarithmic:
        axis.set_xscale("log")
    if frequency[-1] > frequency[0]:
        axis.set_xlim(*(positive if logarithmic else frequency)[[0, -1]])
    look.lattice(axis, minor="x" if logarithmic else None)


def _degrees(values: ComplexArray, low: float) -> Array:
    """Degrees from `low` on; NaN where the response is infinite or zero."""
    usable = np.isfinite(values) & (values != 0)
    angle = np.degrees(np.angle(np.where(usable, values, 1.0)))
    return np.where(usable, np.mod(angle - low, 360.0) + low, np.nan)


def _phase_cut(measured: ComplexArray) -> float:
    """Where the circle of phases is cut open, from -360 to 0 degrees: in the middle of the widest gap between them.

    A displacement has phases about 0 and 180 degrees; cut at 180, noise would throw them from one end to the other.
    """
    angle = np.sort(np.degrees(np.angle(measured[np.isfinite(measured) & (measured != 0)])))
    if not len(angle):
        return -180.0
    gaps = np.diff(angle, append=angle[0] + 360.0)
    k = int(np.argmax(gaps))
    # to tens of degrees, where the gap is wide enough for that
    cut = angle[k] + 0.5 * gaps[k]
    cut = 10.0 * np.round(0.1 * cut) if gaps[k] > 20.0 else cut
    return float(np.mod(cut, 360.0) - 360.0)


# --- residuals -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CorrelationPanel:
    """Correlation at each lag, and half the width of its band."""

    lags: Indices
    values: Array
    band: Array
    confidence: float
    title: str
    abscissa: str

    def draw(self, axis: Axes, look: Look) -> list[Any]:
        """Stems; those that leave the band in another colour; feedback and response are parted at lag 0."""
        band = np.where(np.isfinite(self.band), self.band, 0.0)
        # one step wide at each lag
        edges, ends = np.append(self.lags - 0.5, self.lags[-1] + 0.5), np.append(band, band[-1])
        axis.fill_between(
            edges, ends, -ends, step="post", label=f"{100 * self.confidence:g} % band", color="C0", **BAND
        )  # fmt: skip
        axis.axhline(0.0, **ZERO)
        out = np.abs(self.values) > self.band
        lines: list[Any] = []
        for mask, colour, name in ((~out, _INSIDE, "inside"), (out, _OUTSIDE, "outside")):
            lags, values = self.lags[mask], self.values[mask]
            axis.vlines(lags, 0.0, values, color=colour, linewidth=1.2, zorder=2)
            dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 3.5, "color": colour, "zorder": 3}
            lines += axis.plot(lags, values, label=name, **dots)
        reach = 1.25 * max(float(np.nanmax(np.abs(self.values), initial=0.0)), float(band.max()), 1e-3)
        axis.set(xlim=(edges[0], edges[-1]), ylim=(-reach, reach), xlabel=self.abscissa, ylabel="Correlation")
        axis.xaxis.set_major_locator(MaxNLocator(nbins=11, integer=True, steps=[1, 2, 5, 10]))
        look.lattice(axis)
        if self.lags[0] < 0:
            axis.axvline(-0.5, color="0.3", linestyle=":", linewidth=1.0, zorder=1)
            corner: dict[str, Any] = {"va": "top", "color": "0.35", "fontsize": "small"}
            axis.text(0.01, 0.97, "feedback", transform=axis.transAxes, ha="left", **corner)
            axis.text(0.99, 0.97, "response", transform=axis.transAxes, ha="right", **corner)
        return lines


@dataclass(frozen=True)
class ResponsePanel:
    """Residual beside what was measured of a frequency response."""

    omega: Array
    measured: ComplexArray
    residuals: ComplexArray
    title: str
    time_unit: str | None = None
    Hz: bool = False
    gain_unit: str | None = None

    def draw(self, axis: Axes, look: Look) -> list[Any]:
        """Both in decibels over frequency."""
        unit, unit_name = frequency_axis(self.Hz, self.time_unit)
        frequency = self.omega / unit
        lines = axis.plot(frequency, decibels(self.measured), label="measured", **SAMPLES)
        properties: dict[str, Any] = {"label": "residual", "color": "C0", "linewidth": 1.1, "zorder": 3}
        lines += axis.plot(frequency, decibels(self.residuals), **properties)
        _over_frequency(axis, frequency, look)
        axis.set(xlabel=labelled("Frequency", unit_name), ylabel=gain_label(self.gain_unit))
        return lines


def residual_panels_plot(
    panels: Sequence[CorrelationPanel | ResponsePanel], heading: str, ax: Any = None, **style: Unpack[FrameStyle]
) -> ct.ControlPlot:
    """Panels below one another; a legend for each kind of them."""
    look = Look.of(style, FrameStyle)
    count = len(panels)
    with look.context():
        drawn = picture(look, ax, (count, 1), (7.2, 0.8 + 2.3 * count))
        for row, (axis, panel) in enumerate(zip(drawn.axes[:, 0], panels, strict=True)):
            drawn.lines[row, 0] = panel.draw(axis, look)
            axis.set_title(plain(panel.title), loc="left")
        kinds = len({type(panel) for panel in panels})
        return drawn.finished(heading, drawn.legends() if kinds > 1 else None)


# --- the order -------------------------------------------------------------------------------------------------------


def stabilisation_plot(
    orders: Indices,
    frequencies: Sequence[Array],
    stable: Sequence[Mask],
    criteria: Mapping[str, Array],
    *,
    chosen: int,
    criterion: str,
    time_unit: str | None = None,
    Hz: bool = False,
    ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Stabilisation diagram: natural frequencies of each order, and what each criterion has above its least value."""
    look = Look.of(style, FrameStyle)
    unit, unit_name = frequency_axis(Hz, time_unit)
    frequencies = [row / unit for row in frequencies]
    with look.context():
        drawn = picture(look, ax, (1, 2), (7.8, 4.4), sharey=True, width_ratios=[1.7, 1.0])
        modes, above = drawn.axes[0]
        drawn.lines[0, 0] = _draw_stabilisation(modes, orders, frequencies, stable)
        drawn.lines[0, 1] = _draw_criteria(above, orders, criteria)
        for frequency in frequencies[list(orders).index(chosen)]:
            modes.axvline(frequency, color="C3", linestyle=":", linewidth=0.8, zorder=0)
        modes.set(xlabel=labelled("Natural frequency", unit_name), ylabel="Order (number of modes)")
        above.set_xlabel("Criterion above its least value")
        choice = f"{criterion} chooses {chosen}" + ", the largest tried" * int(chosen == orders[-1])
        for axis, label in ((modes, choice), (above, "_")):
            axis.axhline(chosen, color="C3", linewidth=6.0, alpha=0.15, zorder=0, label=label)
            axis.set_ylim(orders[0] - 0.5, orders[-1] + 0.5)
            axis.yaxis.set_major_locator(MaxNLocator(integer=True))
            look.lattice(axis)
        return drawn.finished("Choice of the order", drawn.legends())


def _draw_stabilisation(axis: Axes, orders: Indices, frequencies: Sequence[Array], stable: Sequence[Mask]) -> list[Any]:
    d = np.concatenate([np.zeros(0), *frequencies])
    order = np.repeat(orders, [len(row) for row in frequencies])
    kept = np.concatenate([np.zeros(0, bool), *stable])
    lines = axis.plot(d[kept], order[kept], linestyle="none", marker="o", markersize=5.0, color="C0", label="stable")
    lines += axis.plot(d[~kept], order[~kept], linestyle="none", marker="x", markersize=4.5, color="0.5", label="new")
    low, high = float(d.min(initial=np.inf)), float(d.max(initial=0.0))
    # frequencies close together are spread out, others seen from 0 on
    margin = max(0.1 * (high - low), 0.02 * high)
    axis.set_xlim(low - margin if low > 0.5 * high else 0.0, high + margin if high else 1.0)
    return lines


def _draw_criteria(axis: Axes, orders: Indices, criteria: Mapping[str, Array]) -> list[Any]:
    lines: list[Any] = []
    for name, above in criteria.items():
        colour, marker, style = _CRITERIA[name]
        lines += axis.plot(
            np.where(np.isfinite(above), above, np.nan), orders, color=colour, marker=marker, markersize=4.0,
            linestyle=style, linewidth=1.2, label=name,
        )  # fmt: skip
    # thousands at low orders and a few near the best: both must be seen
    axis.set_xscale("symlog", linthresh=_FLAT)
    axis.set_xlim(left=-0.08 * _FLAT)
    return lines

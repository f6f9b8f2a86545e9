"""Pictures of validation: models beside a record, correlations of residuals, and the choice of the order.

Each function returns a `control.ControlPlot`, and draws on given axes or a new figure, which `heading` entitles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from .. import _checks
from .bode_data import decibels
from .fit_data import chosen_part, percent, strongest_part
from .style import (
    BAND,
    DRAWN,
    MEASURED,
    SAMPLES,
    ZERO,
    FrameStyle,
    Look,
    extremes,
    frequency_axis,
    gain_label,
    labelled,
    new_axes,
    plain,
    stacked,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]

_STYLES = ("-", "--", "-.", ":")
_COLOURS = ("C0", "C3", "C2", "C4", "C5", "C6", "C8", "C9")  # not that of the measurement
# the line between two points is not the response, which may have a resonance there
_POINTS: dict[str, Any] = {"linewidth": 0.8, "marker": ".", "markersize": 4.0}
_INSIDE, _OUTSIDE = "0.25", "C3"
_CRITERIA = {"AIC": ("C0", "s", "-"), "AICc": ("C2", "^", "--"), "BIC": ("C3", "o", "-"), "hold-out": ("C4", "D", ":")}
_FLAT = 10.0  # differences of a criterion below this are drawn to a linear scale


# --- models beside a record ------------------------------------------------------------------------------------------


def comparison_plot(
    time: Array,
    measured: Array,
    predicted: Array,
    *,
    labels: Sequence[str],
    fit_percent: Array,
    time_unit: str | None = None,
    output_label: str = "Output",
    output_unit: str | None = None,
    detail: Any = "auto",
    heading: str,
    ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Outputs of all models over the measured one, their errors below, and a few periods enlarged.

    `predicted` has shape (k, T); the other arguments are those of `fit_plot`.
    """
    look = Look.of(style, FrameStyle)
    part = _enlarged(time, measured, predicted, detail, ax)
    names = [plain(f"{label} ({percent(fit)})") for label, fit in zip(labels, fit_percent, strict=True)]
    everything = slice(None)
    with look.context():
        figure, axes = stacked(ax, [3.0, 2.0] + [3.0] * (part is not None))
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_outputs(axes[0, 0], time, measured, predicted, names, everything, MEASURED)
        lines[1, 0] = _draw_errors(axes[1, 0], time, measured - predicted, names)
        if part is not None:
            axes[0, 0].axvspan(time[part][0], time[part][-1], color="0.85", zorder=0)
            lines[2, 0] = _draw_outputs(axes[2, 0], time, measured, predicted, names, part, SAMPLES)
            axes[2, 0].set_title("Detail (shaded above)", loc="left")
        for axis, quantity in zip(axes[:, 0], (output_label, "Error", output_label), strict=False):
            axis.set_ylabel(labelled(quantity, output_unit))
            axis.set_xlabel(labelled("Time", time_unit))
            look.lattice(axis)
        if ax is None:
            axes[0, 0].set_xlabel("")
        legend = look.legend(axes[0, 0])
        look.entitle(figure, ax, heading)
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _enlarged(time: Array, measured: Array, predicted: Array, detail: Any, ax: Any) -> slice | None:
    """Part to enlarge; with axes of one's own, there must be one for it."""
    if detail is None or (isinstance(detail, str) and ax is not None and np.size(ax) == 2):
        return None
    if isinstance(detail, str):
        _checks.choice("detail", detail, ("auto",))
        errors = np.nan_to_num(measured - predicted)
        # where the models differ most from the measurement, all together
        sizes = np.maximum(np.sqrt(np.mean(errors**2, axis=1, keepdims=True)), np.finfo(float).tiny)
        return strongest_part(measured, np.sqrt(np.sum((errors / sizes) ** 2, axis=0)))
    return chosen_part(time, detail)


def _draw_outputs(
    axis: Axes, time: Array, measured: Array, predicted: Array, names: list[str], part: slice, style: dict[str, Any]
) -> list[Any]:
    t = time[part]
    axis.set_xlim(t[0], t[-1])
    lines = axis.plot(*extremes(t, measured[part], DRAWN), label="measured", zorder=2, **style)
    for k, (name, output) in enumerate(zip(names, predicted, strict=True)):
        lines += axis.plot(*extremes(t, output[part], DRAWN), label=name, linewidth=1.1, zorder=3, **_line(k))
    # a model that runs away must not hide the others
    known = measured[np.isfinite(measured)]
    reach = float(np.ptp(known)) or float(np.max(np.abs(known))) or 1.0
    low, high = axis.get_ylim()
    axis.set_ylim(max(low, float(known.min()) - reach), min(high, float(known.max()) + reach))
    return lines


def _draw_errors(axis: Axes, time: Array, errors: Array, names: list[str]) -> list[Any]:
    axis.axhline(0.0, **ZERO)
    lines: list[Any] = []
    sizes = [float(np.sqrt(np.nanmean(error**2))) for error in errors]
    for k in np.argsort(sizes)[::-1]:
        # the smaller error is drawn over the larger
        lines += axis.plot(*extremes(time, errors[k], DRAWN), label=names[k], linewidth=0.8, **_line(int(k)))
    axis.set_xlim(time[0], time[-1])
    return lines


def _line(k: int) -> dict[str, Any]:
    return {"color": _COLOURS[k % len(_COLOURS)], "linestyle": _STYLES[k % len(_STYLES)]}


# --- models beside a frequency response ------------------------------------------------------------------------------


def response_comparison_plot(
    omega: Array,
    measured: ComplexArray,
    predicted: ComplexArray,
    *,
    labels: Sequence[str],
    fit_percent: Array,
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
    frequency = omega / unit
    names = [plain(f"{name} ({percent(fit)})") for name, fit in zip(labels, fit_percent, strict=True)]
    turn = _phase_cut(measured)
    with look.context():
        figure, axes = stacked(ax, [2.4, 1.7, 1.7], share="all")
        lines = np.empty(axes.shape, dtype=object)
        for row, of in enumerate((decibels, lambda values: _degrees(values, turn))):
            axis = axes[row, 0]
            drawn = axis.plot(frequency, of(measured), label="measured", zorder=2, **SAMPLES)
            for k, (name, values) in enumerate(zip(names, predicted, strict=True)):
                drawn += axis.plot(frequency, of(values), label=name, zorder=3, **_POINTS, **_line(k))
            lines[row, 0] = drawn
        sizes = [float(np.nanmean(np.abs(measured - values) ** 2)) for values in predicted]
        lines[2, 0] = []
        for k in np.argsort(sizes)[::-1]:
            # the smaller error is drawn over the larger
            error = decibels(measured - predicted[k])
            lines[2, 0] += axes[2, 0].plot(frequency, error, label=names[k], linewidth=1.0, **_line(int(k)))
        _limit_to_dots(axes[0, 0], decibels(measured))
        axes[1, 0].set_ylim(turn - 20.0, turn + 380.0)
        axes[1, 0].yaxis.set_major_locator(MultipleLocator(90.0))
        wording = (gain_label(gain_unit), "Phase [deg]", gain_label(gain_unit, "Error"))
        for axis, name in zip(axes[:, 0], wording, strict=True):
            axis.set_ylabel(name)
            _over_frequency(axis, frequency, look)
        axes[2, 0].set_xlabel(labelled("Frequency", unit_name))
        legend = look.legend(axes[0, 0])
        look.entitle(figure, ax, heading)
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _over_frequency(axis: Axes, frequency: Array, look: Look) -> None:
    """Logarithmic over more than a decade; a point at 0 has no place there."""
    positive = frequency[frequency > 0]
    if len(positive) and positive[-1] > 10.0 * positive[0]:
        axis.set_xscale("log")
        axis.set_xlim(positive[0], positive[-1])
        look.lattice(axis, minor="x")
        return
    if frequency[-1] > frequency[0]:
        axis.set_xlim(frequency[0], frequency[-1])
    look.lattice(axis)


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
    gaps = np.diff(np.concatenate([angle, [angle[0] + 360.0]]))
    k = int(np.argmax(gaps))
    # to tens of degrees, where the gap is wide enough for that
    cut = angle[k] + 0.5 * gaps[k]
    cut = 10.0 * np.round(0.1 * cut) if gaps[k] > 20.0 else cut
    return float(np.mod(cut, 360.0) - 360.0)


def _limit_to_dots(axis: Axes, dots: Array) -> None:
    """Range of a picture in which the measurement is seen; models on their peaks run out of it."""
    known = dots[np.isfinite(dots)]
    if len(known):
        margin = 5.0 + 0.25 * float(np.ptp(known))
        axis.set_ylim(float(known.min()) - margin, float(known.max()) + margin)


# --- correlations of residuals ---------------------------------------------------------------------------------------


def correlation_plot(
    autocorrelation: Array,
    autocorrelation_band: Array,
    cross_correlation: Array,
    cross_correlation_band: Array,
    *,
    confidence: float,
    panel_titles: tuple[str, str],
    heading: str,
    ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Autocorrelation at lags 1 to L above the correlation with the input at lags -L to L, with their bands."""
    look = Look.of(style, FrameStyle)
    L = len(autocorrelation)
    panels = (
        (np.arange(1, L + 1), autocorrelation, autocorrelation_band),
        (np.arange(-L, L + 1), cross_correlation, cross_correlation_band),
    )
    with look.context():
        figure, axes = stacked(ax, [1.0, 1.0], share="none")
        lines = np.empty(axes.shape, dtype=object)
        for row, ((lags, values, band), panel_title) in enumerate(zip(panels, panel_titles, strict=True)):
            axis = axes[row, 0]
            lines[row, 0] = _draw_correlation(axis, lags, values, band, confidence, look)
            axis.set_title(plain(panel_title), loc="left")
            axis.set_ylabel("Correlation")
        axes[0, 0].set_xlabel("Lag [samples]")
        axes[1, 0].set_xlabel("Lag of the residual behind the input [samples]")
        axes[1, 0].axvline(-0.5, color="0.3", linestyle=":", linewidth=1.0, zorder=1)
        for place, text, side in ((0.01, "feedback", "left"), (0.99, "response", "right")):
            axes[1, 0].text(
                place, 0.97, text, transform=axes[1, 0].transAxes, ha=side, va="top", color="0.35", fontsize="small"
            )
        legend = look.legend(axes[0, 0])
        look.entitle(figure, ax, heading)
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def whiteness_plot(
    autocorrelation: Array,
    band: Array,
    *,
    confidence: float,
    panel_title: str,
    heading: str,
    ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Autocorrelation at lags 1 to L with its band, where there is no input to correlate with."""
    look = Look.of(style, FrameStyle)
    with look.context():
        figure, axes = stacked(ax, [1.0], share="none")
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_autocorrelation(axes[0, 0], autocorrelation, band, confidence, panel_title, "samples", look)
        legend = look.legend(axes[0, 0])
        look.entitle(figure, ax, heading)
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def residual_response_plot(
    omega: Array,
    measured: ComplexArray,
    residuals: ComplexArray,
    autocorrelation: Array,
    band: Array,
    *,
    confidence: float,
    panel_titles: tuple[str, str],
    time_unit: str | None = None,
    Hz: bool = False,
    gain_unit: str | None = None,
    heading: str,
    ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Size of the residual beside that of the response, over frequency, above its autocorrelation."""
    look = Look.of(style, FrameStyle)
    unit, unit_name = frequency_axis(Hz, time_unit)
    frequency = omega / unit
    with look.context():
        figure, axes = stacked(ax, [1.0, 1.0], share="none")
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = [
            *axes[0, 0].plot(frequency, decibels(measured), label="measured", **SAMPLES),
            *axes[0, 0].plot(frequency, decibels(residuals), label="residual", color="C0", linewidth=1.1, zorder=3),
        ]
        _over_frequency(axes[0, 0], frequency, look)
        axes[0, 0].set_title(plain(panel_titles[0]), loc="left")
        axes[0, 0].set_xlabel(labelled("Frequency", unit_name))
        axes[0, 0].set_ylabel(gain_label(gain_unit))
        lines[1, 0] = _draw_autocorrelation(
            axes[1, 0], autocorrelation, band, confidence, panel_titles[1], "points", look
        )
        legend = np.array([[look.legend(axes[0, 0])], [look.legend(axes[1, 0])]], dtype=object)
        look.entitle(figure, ax, heading)
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _draw_autocorrelation(
    axis: Axes, values: Array, band: Array, confidence: float, title: str, unit: str, look: Look
) -> list[Any]:
    lines = _draw_correlation(axis, np.arange(1, len(values) + 1), values, band, confidence, look)
    axis.set_title(plain(title), loc="left")
    axis.set_ylabel("Correlation")
    axis.set_xlabel(f"Lag [{unit}]")
    return lines


def _draw_correlation(
    axis: Axes, lags: NDArray[Any], values: Array, band: Array, confidence: float, look: Look
) -> list[Any]:
    """Stems; those that leave the band in another colour."""
    shown = np.where(np.isfinite(band), band, 0.0)
    # one step wide at each lag
    edges = np.concatenate([lags - 0.5, [lags[-1] + 0.5]])
    axis.fill_between(
        edges, np.append(shown, shown[-1]), -np.append(shown, shown[-1]), step="post",
        label=f"{100 * confidence:g} % band", color="C0", **BAND,
    )  # fmt: skip
    axis.axhline(0.0, **ZERO)
    out = np.abs(values) > band
    lines: list[Any] = []
    for mask, colour, name in ((~out, _INSIDE, "inside"), (out, _OUTSIDE, "outside")):
        axis.vlines(lags[mask], 0.0, values[mask], color=colour, linewidth=1.2, zorder=2)
        lines += axis.plot(
            lags[mask], values[mask], linestyle="none", marker="o", markersize=3.5, color=colour, zorder=3,
            label=name,
        )  # fmt: skip
    reach = 1.25 * max(float(np.nanmax(np.abs(values), initial=0.0)), float(shown.max()), 1e-3)
    axis.set_ylim(-reach, reach)
    axis.set_xlim(edges[0], edges[-1])
    axis.xaxis.set_major_locator(MaxNLocator(nbins=11, integer=True, steps=[1, 2, 5, 10]))
    look.lattice(axis)
    return lines


# --- the order -------------------------------------------------------------------------------------------------------


def stabilisation_plot(
    orders: NDArray[np.intp],
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
        figure, axes = new_axes(ax, (1, 2), (7.8, 4.4), sharey=True, width_ratios=[1.7, 1.0])
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_stabilisation(axes[0, 0], orders, frequencies, stable)
        lines[0, 1] = _draw_criteria(axes[0, 1], orders, criteria)
        for frequency in frequencies[list(orders).index(chosen)]:
            axes[0, 0].axvline(frequency, color="C3", linestyle=":", linewidth=0.8, zorder=0)
        axes[0, 0].set_xlabel(labelled("Natural frequency", unit_name))
        axes[0, 0].set_ylabel("Order (number of modes)")
        axes[0, 1].set_xlabel("Criterion above its least value")
        choice = f"{criterion} chooses {chosen}" + ", the largest tried" * int(chosen == orders[-1])
        for axis, label in zip(axes[0], (choice, "_"), strict=True):
            axis.axhline(chosen, color="C3", linewidth=6.0, alpha=0.15, zorder=0, label=label)
            axis.set_ylim(orders[0] - 0.5, orders[-1] + 0.5)
            axis.yaxis.set_major_locator(MaxNLocator(integer=True))
            look.lattice(axis)
        legend = np.array([[look.legend(axes[0, 0]), look.legend(axes[0, 1])]], dtype=object)
        look.entitle(figure, ax, "Choice of the order")
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _draw_stabilisation(
    axis: Axes, orders: NDArray[np.intp], frequencies: Sequence[Array], stable: Sequence[Mask]
) -> list[Any]:
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


def _draw_criteria(axis: Axes, orders: NDArray[np.intp], criteria: Mapping[str, Array]) -> list[Any]:
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

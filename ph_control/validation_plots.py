"""Pictures of validation: models beside a record, correlations of residuals, and the choice of the order.

Each function returns a `control.ControlPlot`, and draws on given axes or a new figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from . import _checks
from .exceptions import StructureError
from .plots import DRAWN, chosen_part, extremes, legend_above, plain, strongest_part

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]

_STYLES = ("-", "--", "-.", ":")
_COLOURS = ("C0", "C3", "C2", "C4", "C5", "C6", "C8", "C9")  # not that of the measurement
_MEASURED: dict[str, Any] = {"color": "C1", "linewidth": 3.2, "alpha": 0.6}
_SAMPLES: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4.0, "color": "C1", "alpha": 0.7}
_BAND: dict[str, Any] = {"color": "C0", "alpha": 0.18, "linewidth": 0.0}
_INSIDE, _OUTSIDE = "0.25", "C3"
_CRITERIA = {"AIC": ("C0", "s", "-"), "AICc": ("C2", "^", "--"), "BIC": ("C3", "o", "-"), "hold-out": ("C4", "D", ":")}
_FLAT = 10.0  # differences of a criterion below this are drawn to a linear scale


def percent(fit: float) -> str:
    """Text of a fit; never rounded up to a perfect one, nor wider than it can be read."""
    if 99.995 <= fit < 100.0:
        return "above 99.99 %"
    return f"{fit:.2f} %" if fit > -1e4 else f"{fit:.3g} %"


# --- models beside a record ------------------------------------------------------------------------------------------


def comparison_plot(
    time: Array,
    measured: Array,
    predicted: Array,
    *,
    labels: Sequence[str],
    fit_percent: Array,
    time_unit: str = "s",
    output_label: str = "Output",
    output_unit: str | None = None,
    detail: Any = "auto",
    title: str | None = None,
    ax: Any = None,
) -> ct.ControlPlot:
    """Outputs of all models over the measured one, their errors below, and a few periods enlarged.

    `predicted` has shape (k, T); the other arguments are those of `fit_plot`.
    """
    part = _enlarged(time, measured, predicted, detail, ax)
    suffix = f" [{output_unit}]" if output_unit else ""
    names = [plain(f"{label} ({percent(fit)})") for label, fit in zip(labels, fit_percent, strict=True)]
    everything = slice(None)
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _stacked(ax, [3.0, 2.0] + [3.0] * (part is not None))
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_outputs(axes[0, 0], time, measured, predicted, names, everything, _MEASURED)
        lines[1, 0] = _draw_errors(axes[1, 0], time, measured - predicted, names)
        if part is not None:
            axes[0, 0].axvspan(time[part][0], time[part][-1], color="0.85", zorder=0)
            lines[2, 0] = _draw_outputs(axes[2, 0], time, measured, predicted, names, part, _SAMPLES)
            axes[2, 0].set_title("Detail (shaded above)", loc="left")
        wording = (output_label + suffix, "Error" + suffix, output_label + suffix)
        for axis, label in zip(axes[:, 0], wording, strict=False):
            axis.set_ylabel(plain(label))
            axis.set_xlabel(plain(f"Time [{time_unit}]"))
            axis.grid(True, linewidth=0.5, alpha=0.6)
        if ax is None:
            axes[0, 0].set_xlabel("")
        legend = legend_above(axes[0, 0])
        _entitle(figure, title, ax, f"{output_label}, measured and simulated")
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
        lines += axis.plot(*extremes(t, output[part], DRAWN), label=name, linewidth=1.1, zorder=3, **_look(k))
    # a model that runs away must not hide the others
    known = measured[np.isfinite(measured)]
    reach = float(np.ptp(known)) or float(np.max(np.abs(known))) or 1.0
    low, high = axis.get_ylim()
    axis.set_ylim(max(low, float(known.min()) - reach), min(high, float(known.max()) + reach))
    return lines


def _draw_errors(axis: Axes, time: Array, errors: Array, names: list[str]) -> list[Any]:
    axis.axhline(0.0, color="0.3", linewidth=0.6, zorder=1)
    lines: list[Any] = []
    sizes = [float(np.sqrt(np.nanmean(error**2))) for error in errors]
    for k in np.argsort(sizes)[::-1]:
        # the smaller error is drawn over the larger
        lines += axis.plot(*extremes(time, errors[k], DRAWN), label=names[k], linewidth=0.8, **_look(int(k)))
    axis.set_xlim(time[0], time[-1])
    return lines


def _look(k: int) -> dict[str, Any]:
    return {"color": _COLOURS[k % len(_COLOURS)], "linestyle": _STYLES[k % len(_STYLES)]}


# --- models beside a frequency response ------------------------------------------------------------------------------


def response_comparison_plot(
    omega: Array,
    measured: ComplexArray,
    predicted: ComplexArray,
    *,
    labels: Sequence[str],
    fit_percent: Array,
    time_unit: str = "s",
    Hz: bool = False,
    gain_unit: str | None = None,
    title: str | None = None,
    ax: Any = None,
) -> ct.ControlPlot:
    """Magnitudes of all models over the measured one, phases below, and the size of the errors.

    `predicted` has shape (k, K); the other arguments are those of `bode_plot`.
    """
    frequency, label = _frequency_axis(omega, time_unit, Hz)
    decibels = f"[dB re 1 {gain_unit}]" if gain_unit else "[dB]"
    names = [plain(f"{name} ({percent(fit)})") for name, fit in zip(labels, fit_percent, strict=True)]
    turn = _phase_cut(measured)
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _stacked(ax, [2.4, 1.7, 1.7], share="all")
        lines = np.empty(axes.shape, dtype=object)
        for row, of in enumerate((_decibels, lambda values: _degrees(values, turn))):
            axis = axes[row, 0]
            drawn = axis.plot(frequency, of(measured), label="measured", zorder=2, **_SAMPLES)
            for k, (name, values) in enumerate(zip(names, predicted, strict=True)):
                drawn += axis.plot(frequency, of(values), label=name, linewidth=1.3, zorder=3, **_look(k))
            lines[row, 0] = drawn
        sizes = [float(np.nanmean(np.abs(measured - values) ** 2)) for values in predicted]
        lines[2, 0] = []
        for k in np.argsort(sizes)[::-1]:
            # the smaller error is drawn over the larger
            error = _decibels(measured - predicted[k])
            lines[2, 0] += axes[2, 0].plot(frequency, error, label=names[k], linewidth=1.0, **_look(int(k)))
        _limit_to_dots(axes[0, 0], _decibels(measured))
        axes[1, 0].set_ylim(turn - 20.0, turn + 380.0)
        axes[1, 0].yaxis.set_major_locator(MultipleLocator(90.0))
        for axis, name in zip(axes[:, 0], (f"Magnitude {decibels}", "Phase [deg]", f"Error {decibels}"), strict=True):
            axis.set_ylabel(plain(name))
            _over_frequency(axis, frequency)
        axes[2, 0].set_xlabel(plain(label))
        legend = legend_above(axes[0, 0])
        _entitle(figure, title, ax, "Response, measured and modelled")
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _frequency_axis(omega: Array, time_unit: str, Hz: bool) -> tuple[Array, str]:
    if Hz and time_unit != "s":
        raise StructureError(f"Hz needs times in s, time_unit is {time_unit!r}; use Hz=False, or convert the times")
    return (omega / (2.0 * np.pi), "Frequency [Hz]") if Hz else (omega, f"Frequency [rad/{time_unit}]")


def _over_frequency(axis: Axes, frequency: Array) -> None:
    """Logarithmic over more than a decade; a point at 0 has no place there."""
    positive = frequency[frequency > 0]
    if len(positive) and positive[-1] > 10.0 * positive[0]:
        axis.set_xscale("log")
        axis.set_xlim(positive[0], positive[-1])
        axis.grid(True, which="minor", axis="x", linewidth=0.3, alpha=0.35)
    elif frequency[-1] > frequency[0]:
        axis.set_xlim(frequency[0], frequency[-1])
    axis.grid(True, linewidth=0.5, alpha=0.6)


def _decibels(values: ComplexArray) -> Array:
    """Decibels; NaN where infinite or zero."""
    size = np.abs(values)
    usable = np.isfinite(size) & (size > 0)
    return np.where(usable, 20.0 * np.log10(np.where(usable, size, 1.0)), np.nan)


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


def residual_plot(
    autocorrelation: Array,
    autocorrelation_band: Array,
    cross_correlation: Array,
    cross_correlation_band: Array,
    *,
    confidence: float,
    panel_titles: tuple[str, str],
    title: str | None = None,
    ax: Any = None,
) -> ct.ControlPlot:
    """Autocorrelation at lags 1 to L above the correlation with the input at lags -L to L, with their bands."""
    L = len(autocorrelation)
    panels = (
        (np.arange(1, L + 1), autocorrelation, autocorrelation_band),
        (np.arange(-L, L + 1), cross_correlation, cross_correlation_band),
    )
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _stacked(ax, [1.0, 1.0], share="none")
        lines = np.empty(axes.shape, dtype=object)
        for row, ((lags, values, band), panel_title) in enumerate(zip(panels, panel_titles, strict=True)):
            axis = axes[row, 0]
            lines[row, 0] = _draw_correlation(axis, lags, values, band, confidence)
            axis.set_title(plain(panel_title), loc="left")
            axis.set_ylabel("Correlation")
        axes[0, 0].set_xlabel("Lag [samples]")
        axes[1, 0].set_xlabel("Lag of the residual behind the input [samples]")
        axes[1, 0].axvline(-0.5, color="0.3", linestyle=":", linewidth=1.0, zorder=1)
        for place, text, side in ((0.01, "feedback", "left"), (0.99, "response", "right")):
            axes[1, 0].text(
                place, 0.97, text, transform=axes[1, 0].transAxes, ha=side, va="top", color="0.35", fontsize="small"
            )
        legend = legend_above(axes[0, 0])
        _entitle(figure, title, ax, "Residuals")
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def whiteness_plot(
    autocorrelation: Array,
    band: Array,
    *,
    confidence: float,
    panel_title: str,
    title: str | None = None,
    ax: Any = None,
) -> ct.ControlPlot:
    """Autocorrelation at lags 1 to L with its band, where there is no input to correlate with."""
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _stacked(ax, [1.0], share="none")
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_autocorrelation(axes[0, 0], autocorrelation, band, confidence, panel_title, "samples")
        legend = legend_above(axes[0, 0])
        _entitle(figure, title, ax, "Residuals")
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def response_residual_plot(
    omega: Array,
    measured: ComplexArray,
    residuals: ComplexArray,
    autocorrelation: Array,
    band: Array,
    *,
    confidence: float,
    panel_titles: tuple[str, str],
    time_unit: str = "s",
    Hz: bool = False,
    gain_unit: str | None = None,
    title: str | None = None,
    ax: Any = None,
) -> ct.ControlPlot:
    """Size of the residual beside that of the response, over frequency, above its autocorrelation."""
    frequency, label = _frequency_axis(omega, time_unit, Hz)
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _stacked(ax, [1.0, 1.0], share="none")
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = [
            *axes[0, 0].plot(frequency, _decibels(measured), label="measured", **_SAMPLES),
            *axes[0, 0].plot(frequency, _decibels(residuals), label="residual", color="C0", linewidth=1.1, zorder=3),
        ]
        _over_frequency(axes[0, 0], frequency)
        axes[0, 0].set_title(plain(panel_titles[0]), loc="left")
        axes[0, 0].set_xlabel(plain(label))
        axes[0, 0].set_ylabel(plain(f"Magnitude [dB re 1 {gain_unit}]" if gain_unit else "Magnitude [dB]"))
        lines[1, 0] = _draw_autocorrelation(axes[1, 0], autocorrelation, band, confidence, panel_titles[1], "points")
        legend = np.array([[legend_above(axes[0, 0])], [legend_above(axes[1, 0])]], dtype=object)
        _entitle(figure, title, ax, "Residuals")
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _draw_autocorrelation(
    axis: Axes, values: Array, band: Array, confidence: float, title: str, unit: str
) -> list[Any]:
    lines = _draw_correlation(axis, np.arange(1, len(values) + 1), values, band, confidence)
    axis.set_title(plain(title), loc="left")
    axis.set_ylabel("Correlation")
    axis.set_xlabel(f"Lag [{unit}]")
    return lines


def _draw_correlation(axis: Axes, lags: NDArray[Any], values: Array, band: Array, confidence: float) -> list[Any]:
    """Stems; those that leave the band in another colour."""
    shown = np.where(np.isfinite(band), band, 0.0)
    # one step wide at each lag
    edges = np.concatenate([lags - 0.5, [lags[-1] + 0.5]])
    axis.fill_between(
        edges, np.append(shown, shown[-1]), -np.append(shown, shown[-1]), step="post",
        label=f"{100 * confidence:g} % band", **_BAND,
    )  # fmt: skip
    axis.axhline(0.0, color="0.3", linewidth=0.6, zorder=1)
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
    axis.grid(True, linewidth=0.5, alpha=0.6)
    return lines


# --- the order -------------------------------------------------------------------------------------------------------


def order_plot(
    orders: NDArray[np.intp],
    frequencies: Sequence[Array],
    stable: Sequence[Mask],
    criteria: Mapping[str, Array],
    *,
    chosen: int,
    criterion: str,
    time_unit: str = "s",
    title: str | None = None,
    ax: Any = None,
) -> ct.ControlPlot:
    """Stabilisation diagram: natural frequencies of each order, and what each criterion has above its least value."""
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _beside(ax)
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_stabilisation(axes[0, 0], orders, frequencies, stable)
        lines[0, 1] = _draw_criteria(axes[0, 1], orders, criteria)
        for frequency in frequencies[list(orders).index(chosen)]:
            axes[0, 0].axvline(frequency, color="C3", linestyle=":", linewidth=0.8, zorder=0)
        axes[0, 0].set_xlabel(plain(f"Natural frequency [rad/{time_unit}]"))
        axes[0, 0].set_ylabel("Order (number of modes)")
        axes[0, 1].set_xlabel("Criterion above its least value")
        choice = f"{criterion} chooses {chosen}" + ", the largest tried" * int(chosen == orders[-1])
        for axis, label in zip(axes[0], (choice, "_"), strict=True):
            axis.axhline(chosen, color="C3", linewidth=6.0, alpha=0.15, zorder=0, label=label)
            axis.set_ylim(orders[0] - 0.5, orders[-1] + 0.5)
            axis.yaxis.set_major_locator(MaxNLocator(integer=True))
            axis.grid(True, linewidth=0.5, alpha=0.6)
        legend = np.array([[legend_above(axes[0, 0]), legend_above(axes[0, 1])]], dtype=object)
        _entitle(figure, title, ax, "Choice of the order")
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


# --- axes and titles -------------------------------------------------------------------------------------------------


def _stacked(ax: Any, heights: list[float], *, share: str = "first") -> tuple[Figure, NDArray[Any]]:
    """One column of axes; the second, or all of them, share the abscissa of the first, or none does."""
    if ax is not None:
        return _given(ax, (len(heights), 1))
    tall = 0.8 + 2.3 * len(heights) if share == "none" else 1.2 + 0.75 * sum(heights)
    figure = plt.figure(figsize=(7.2, tall), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    panels = [figure.add_subplot(grid[0])]
    for k in range(1, len(heights)):
        shared = share == "all" or (share == "first" and k == 1)
        panels.append(figure.add_subplot(grid[k], sharex=panels[0] if shared else None))
        if shared:
            panels[k - 1].tick_params(labelbottom=False)
    figure.align_ylabels(panels)
    return figure, np.array(panels, dtype=object)[:, None]


def _beside(ax: Any) -> tuple[Figure, NDArray[Any]]:
    if ax is not None:
        return _given(ax, (1, 2))
    figure, axes = plt.subplots(
        1, 2, sharey=True, squeeze=False, layout="constrained", figsize=(7.8, 4.4), width_ratios=[1.7, 1.0]
    )
    return figure, axes


def _given(ax: Any, shape: tuple[int, int]) -> tuple[Figure, NDArray[Any]]:
    axes = np.array(ax, dtype=object)
    if axes.size != np.prod(shape):
        raise StructureError(f"ax has {axes.size} axes; needed {np.prod(shape)}, of shape {shape}")
    axes = axes.reshape(shape)
    return axes[0, 0].figure, axes


def _entitle(figure: Figure, title: str | None, ax: Any, default: str) -> None:
    """Title of the figure; on axes of one's own only if it was asked for."""
    if title is not None or ax is None:
        figure.suptitle(plain(default if title is None else title))

"""Pictures: numbers first, then matplotlib.  Every function returns a `control.ControlPlot`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import ArrayLike, NDArray

from . import _checks
from .bode import BodeData, Curve, bode_data
from .exceptions import StructureError
from .spectra import gapped_array

Array = NDArray[np.float64]

_SHOWN = 0.02  # of the gap between poles and zeros: nearer than this to one, an infinite peak leaves the picture
DRAWN = 6000  # samples beyond which a line is drawn by the extremes of its bins: the same picture, drawn faster
_FEW_PERIODS = 10  # that are seen in the whole record
_DETAIL_PERIODS = 8
_DETAIL_SAMPLES = (80, 1000)  # at least, if the record allows it, and where the strongest motion is slower than that

_STYLES = ("-", "--", "-.", ":")

_DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 3.5, "color": "0.4"}
_PALE_DOTS: dict[str, Any] = {**_DOTS, "markersize": 2.5, "color": "0.78"}
_LIMIT: dict[str, Any] = {"color": "0.3", "linestyle": ":", "linewidth": 1.0}
# beneath the prediction, and wide enough to be seen on both sides of it where they are equal
_MEASURED: dict[str, Any] = {"color": "C1", "linewidth": 3.2, "alpha": 0.6}
_SAMPLES: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4.0, "color": "C1", "alpha": 0.7}
_PREDICTED: dict[str, Any] = {"color": "C0", "linewidth": 1.0}
_RESIDUAL: dict[str, Any] = {"color": "C3", "linewidth": 0.8}


def bode_plot(
    sysdata: Any,
    omega: ArrayLike | None = None,
    *,
    data: ct.TimeResponseData | ct.FrequencyResponseData | None = None,
    segments: int = 8,
    intersample: str = "zoh",
    omega_limits: ArrayLike | None = None,
    Hz: bool = False,
    time_unit: str = "s",
    gain_unit: str | None = None,
    label: str | Sequence[str] | None = None,
    data_label: str | None = None,
    title: str | None = None,
    ax: Any = None,
) -> ct.ControlPlot:
    """Bode plot that shows every resonance and antiresonance, and measurements with it.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other LTI system of python-control, `control.FrequencyResponseData`.
    omega : array_like, shape (N,), optional
        Angular frequencies, rad per unit time, ascending and positive; two of them are limits.  By default every pole
        and zero of the systems is resolved.
    data : control.TimeResponseData or control.FrequencyResponseData, optional
        Measurement to draw as dots: a record, of which `spectral_estimate` is made, or a frequency response.
    segments, intersample
        As in `spectral_estimate`.
    omega_limits : array_like, shape (2,), optional
        Ends of the frequency axis, in Hz if `Hz` is true, otherwise in rad per unit time.
    Hz : bool
        Frequency axis in Hz instead of rad/s.
    time_unit : str
        Unit of time of the systems and the measurement, for the labels of frequencies.
    gain_unit : str, optional
        Unit of the response, output over input, such as "m/s/N"; the magnitude is in dB re 1 of it.
    label : str or sequence of str, optional
        Legend entries of the systems; by default their names, and "model" for a single `PortHamiltonian` without one.
    data_label : str, optional
        Legend entry of the measurement.
    title : str, optional
        Title; by default from the names of the systems.
    ax : array of matplotlib.axes.Axes, shape (2p, m), optional
        Axes to draw on, magnitude above phase for each of p outputs and m inputs.  By default a new figure.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2p, m), `figure`, `legend`.

    Raises
    ------
    StructureError
        If the systems differ in their ports, the frequencies are not usable, or the measurement is not, or for `Hz`
        where the unit of time is not the second.

    Notes
    -----
    At its poles and zeros on the imaginary axis a lossless response is infinite or zero: the curve runs off the
    picture there.  The phase of a one-port is then exactly +90 or -90 degrees, and steps.  A response that is zero
    throughout has no curve, and the legend says so.

    The phase of systems is continuous, that of a measurement between -180 and 180 degrees.  Dots of a record are
    pale where the coherence is below one half; those of a held input leave a continuous-time curve near the Nyquist
    frequency even without noise, mostly upwards, because sampling folds the response.

    Nyquist frequencies are marked: of a record, of discrete-time systems and of discrete-time frequency responses.

    O(n) for each frequency, and 16 to 60 frequencies for each pole and zero.

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.bode_plot(phc.frenkel_kontorova(name="chain"))
    >>> plot.axes[0, 0].get_ylabel(), plot.axes[1, 0].get_ylabel(), plot.axes[1, 0].get_xlabel()
    ('Magnitude [dB]', 'Phase [deg]', 'Frequency [rad/s]')
    >>> plt.close(plot.figure)
    """
    if Hz and time_unit != "s":
        raise StructureError(f"Hz needs times in s, time_unit is {time_unit!r}; use Hz=False, or convert the times")
    numbers = bode_data(
        sysdata, omega, data, segments=segments, intersample=intersample, omega_limits=omega_limits, Hz=Hz,
        label=label, data_label=data_label,
    )  # fmt: skip
    unit, unit_name = (2.0 * np.pi, "Hz") if Hz else (1.0, f"rad/{time_unit}")
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _bode_axes(ax, len(numbers.output_labels), len(numbers.input_labels))
        lines = np.empty(axes.shape, dtype=object)
        for (row, j), axis in np.ndenumerate(axes):
            draw = _draw_phases if row % 2 else _draw_magnitudes
            lines[row, j] = draw(axis, numbers, row // 2, j, unit)
            _draw_limits(axis, [limit / unit for limit in numbers.nyquist], unit_name)
        _label_bode(axes, numbers, unit, unit_name, gain_unit)
        # a curve that is nowhere must at least be told
        legend = legend_above(axes[0, -1], 1 if any(curve.vanishes for curve in numbers.curves) else 2)
        if title is None and ax is None:
            title = numbers.title
        if title:
            figure.suptitle(plain(title))
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _bode_axes(ax: Any, noutputs: int, ninputs: int) -> tuple[Figure, NDArray[Any]]:
    shape = (2 * noutputs, ninputs)
    if ax is None:
        size = (max(6.4, 3.8 * ninputs), 4.8 if noutputs == 1 else 3.8 * noutputs)
        figure, axes = plt.subplots(*shape, sharex=True, squeeze=False, layout="constrained", figsize=size)
        figure.align_ylabels()
        return figure, axes
    axes = np.array(ax, dtype=object)
    if axes.size != np.prod(shape):
        raise StructureError(f"ax has {axes.size} axes; needed {shape}: magnitude above phase for each output")
    axes = axes.reshape(shape)
    return axes[0, 0].figure, axes


def _draw_magnitudes(axis: Axes, numbers: BodeData, i: int, j: int, unit: float) -> list[Any]:
    levels = [curve.magnitude(i, j) for curve in numbers.curves]
    lines = _draw_curves(axis, numbers.curves, levels, unit)
    shown = [
        level[curve.visible(numbers.low, numbers.high, _SHOWN)]
        for curve, level in zip(numbers.curves, levels, strict=True)
    ]
    if numbers.measured is not None:
        dots = numbers.measured.magnitude(i, j)
        lines += _draw_dots(axis, numbers.measured, dots, unit)
        shown.append(dots[numbers.measured.visible(numbers.low, numbers.high, 0.0)])
    values = np.concatenate(shown)
    values = values[np.isfinite(values)]
    if len(values):
        margin = 5.0 + 0.05 * np.ptp(values)
        axis.set_ylim(float(values.min() - margin), float(values.max() + margin))
    axis.yaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 4, 5, 10]))
    return lines


def _draw_phases(axis: Axes, numbers: BodeData, i: int, j: int, unit: float) -> list[Any]:
    phases = [curve.phase(i, j) for curve in numbers.curves]
    lines = _draw_curves(axis, numbers.curves, phases, unit)
    if numbers.measured is not None:
        phases.append(numbers.measured.phase(i, j, unwrap=False))
        lines += _draw_dots(axis, numbers.measured, phases[-1], unit)
    values = np.concatenate([[-90.0, 90.0], *phases])
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    step = 90.0 if high - low <= 450.0 else 180.0
    axis.set_ylim(low - 0.25 * step, high + 0.25 * step)
    if high - low <= 1440.0:
        axis.yaxis.set_major_locator(MultipleLocator(step))
        axis.yaxis.set_minor_locator(MultipleLocator(step / 2.0))
    return lines


def _draw_curves(axis: Axes, curves: list[Curve], values: list[Array], unit: float) -> list[Any]:
    lines = []
    for k, (curve, value) in enumerate(zip(curves, values, strict=True)):
        # broken lines after the first, so that equal curves are all seen
        style = _STYLES[k % len(_STYLES)]
        label = plain(f"{curve.label}: zero" if curve.vanishes else curve.label)
        lines += axis.plot(curve.omega / unit, value, label=label, linestyle=style, linewidth=1.4, zorder=3)
    return lines


def _draw_dots(axis: Axes, measured: Curve, values: Array, unit: float) -> list[Any]:
    omega = measured.omega / unit
    if measured.doubtful is None or not measured.doubtful.any():
        return axis.plot(omega, values, label=plain(measured.label), zorder=2.2, **_DOTS)
    sure = ~measured.doubtful
    return [
        *axis.plot(omega[sure], values[sure], label=plain(measured.label), zorder=2.2, **_DOTS),
        *axis.plot(omega[~sure], values[~sure], label="coherence below 0.5", zorder=2.1, **_PALE_DOTS),
    ]


def _draw_limits(axis: Axes, limits: list[float], unit_name: str) -> None:
    values = ", ".join(f"{limit:.4g}" for limit in limits)
    for k, limit in enumerate(limits):
        label = "_" if k else plain(f"Nyquist frequency ({values} {unit_name})")
        axis.axvline(limit, label=label, zorder=1, **_LIMIT)


def plain(text: str) -> str:
    """Text that matplotlib shows as it is: two dollar signs would make a formula of what is between them."""
    return str(text).replace("$", r"\$")


def _label_bode(axes: NDArray[Any], numbers: BodeData, unit: float, unit_name: str, gain_unit: str | None) -> None:
    rows, columns = axes.shape
    for (row, j), axis in np.ndenumerate(axes):
        axis.set_xscale("log")
        axis.set_xlim(numbers.low / unit, numbers.high / unit)
        axis.grid(True, which="major", linewidth=0.5, alpha=0.6)
        axis.grid(True, which="minor", axis="x", linewidth=0.3, alpha=0.35)
        if j == 0:
            decibels = f"Magnitude [dB re 1 {plain(gain_unit)}]" if gain_unit else "Magnitude [dB]"
            axis.set_ylabel("Phase [deg]" if row % 2 else decibels)
        if row == rows - 1:
            axis.set_xlabel(plain(f"Frequency [{unit_name}]"))
        if (rows > 2 or columns > 1) and row % 2 == 0:
            channel = f"{numbers.input_labels[j]} to {numbers.output_labels[row // 2]}"
            axis.set_title(plain(channel), loc="left")


def legend_above(axis: Axes, least: int = 2) -> Any:
    """Legend outside the data, where no line can hide behind it; none for fewer entries than `least`."""
    handles, labels = axis.get_legend_handles_labels()
    if len(labels) < least:
        return None
    # matplotlib fills column by column, each as wide as its longest entry
    widest = [max(map(len, column)) for column in np.array_split(np.array(labels, dtype=object), 4) if len(column)]
    columns = 4 if sum(widest) < 80 else 2
    return axis.legend(
        handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns,
        frameon=False, borderaxespad=0.2,
    )  # fmt: skip


# --- measured against predicted --------------------------------------------------------------------------------------


def fit_plot(
    time: ArrayLike,
    measured: ArrayLike,
    predicted: ArrayLike,
    *,
    fit_percent: float | None = None,
    time_unit: str = "s",
    output_label: str = "Output",
    output_unit: str | None = None,
    detail: str | ArrayLike | None = "auto",
    title: str | None = None,
) -> ct.ControlPlot:
    """Measured and predicted output, the residual below, and a few periods enlarged.

    Parameters
    ----------
    time : array_like, shape (T,)
        Instants, ascending.
    measured, predicted : array_like, shape (T,)
        Outputs at these instants; NaN samples are gaps.
    fit_percent : float, optional
        Fit to show in the legend, in percent.
    time_unit : str
        Unit of time, for the label of the axis.
    output_label : str
        Name of the output, for the labels.
    output_unit : str, optional
        Its unit, for the labels; by default they have none.
    detail : {'auto'}, or array_like of shape (2,), or None
        Part of the record to enlarge in a panel of its own: from one instant to another, or none.  By default about
        8 periods of the strongest oscillation where the residual is largest, at most a third of the record, if it has
        more than 10 periods or 3000 samples.
    title : str, optional
        Title of the picture.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2, 1), or (3, 1) with the detail; `figure`, `legend`.

    Raises
    ------
    StructureError
        If the signals are not vectors of one length, time does not ascend, or no sample has both outputs.

    Notes
    -----
    Long records are drawn by the extremes of short bins, which gives the same picture.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> t = np.linspace(0, 10, 201)
    >>> plot = phc.fit_plot(t, np.sin(t), 0.9 * np.sin(t), fit_percent=90.0, output_label="Velocity", output_unit="m/s")
    >>> plot.axes[0, 0].get_ylabel(), plot.axes[1, 0].get_xlabel()
    ('Velocity [m/s]', 'Time [s]')
    >>> plt.close(plot.figure)
    """
    numbers = _fit_data(time, measured, predicted, detail)
    suffix = f"[{output_unit}]" if output_unit else ""
    quantity, residual = (plain(name.strip()) for name in (f"{output_label} {suffix}", f"Residual\n{suffix}"))
    with plt.rc_context(ct.config.defaults["ctrlplot.rcParams"]):
        figure, axes = _fit_axes(numbers.detail is not None)
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_record(axes[0, 0], numbers, fit_percent)
        lines[1, 0] = _draw_residual(axes[1, 0], numbers, output_unit or "")
        for axis, name in zip(axes[:, 0], (quantity, residual, quantity), strict=False):
            axis.set_ylabel(name)
            axis.grid(True, linewidth=0.5, alpha=0.6)
        if numbers.detail is not None:
            lines[2, 0] = _draw_detail(axes[2, 0], axes[0, 0], numbers, detail)
        for axis in axes[1:, 0]:
            axis.set_xlabel(plain(f"Time [{time_unit}]"))
        legend = np.array([[legend_above(axis)] for axis in axes[:, 0]], dtype=object)
        figure.suptitle(plain(f"{output_label}, measured and predicted" if title is None else title))
    return ct.ControlPlot(lines, axes, figure, legend=legend)


@dataclass(frozen=True)
class _FitData:
    """Signals of one length, and the samples to enlarge."""

    time: Array
    measured: Array
    predicted: Array
    detail: slice | None

    @property
    def residual(self) -> Array:
        return self.measured - self.predicted

    @property
    def residual_rms(self) -> float:
        return float(np.sqrt(np.nanmean(self.residual**2)))


def _fit_data(time: ArrayLike, measured: ArrayLike, predicted: ArrayLike, detail: Any) -> _FitData:
    t = _checks.real_array("the time", time, 1)
    y, p = gapped_array("the measured output", measured), gapped_array("the predicted output", predicted)
    if not len(t) == len(y) == len(p):
        raise StructureError(
            f"the time has {len(t)} samples, the measured output {len(y)} and the predicted output {len(p)}; "
            "they must be of one length"
        )
    if np.any(np.diff(t) <= 0):
        k = int(np.argmax(np.diff(t) <= 0))
        raise StructureError(
            f"the time does not increase: samples {k} and {k + 1} are at {t[k]:.9g} and {t[k + 1]:.9g}"
        )
    if not np.isfinite(y - p).any():
        raise StructureError("no sample has a measured and a predicted output; there is nothing to compare")
    if detail is None:
        return _FitData(t, y, p, None)
    if isinstance(detail, str):
        _checks.choice("detail", detail, ("auto",))
        return _FitData(t, y, p, strongest_part(y, y - p))
    return _FitData(t, y, p, chosen_part(t, detail))


def strongest_part(measured: Array, residual: Array) -> slice | None:
    """A few periods of the strongest oscillation, where the residual is largest; None if the record has few itself."""
    known = np.isfinite(measured)
    signal = np.where(known, measured - np.mean(measured[known]), 0.0)
    periods = int(np.argmax(np.abs(np.fft.rfft(signal))))
    least, most = _DETAIL_SAMPLES
    if periods > _FEW_PERIODS:
        count = min(max(least, _DETAIL_PERIODS * len(signal) // periods), len(signal) // 3)
    elif 3 * most <= len(signal):
        count = most
    else:
        return None
    power = np.cumsum(np.concatenate([[0.0], np.nan_to_num(residual) ** 2]))
    start = int(np.argmax(power[count:] - power[:-count]))
    return slice(start, start + count)


def chosen_part(time: Array, detail: Any) -> slice:
    """Samples between the two instants that the user asked to see enlarged."""
    ends = _checks.real_array("detail", detail, 1)
    if len(ends) != 2:
        raise StructureError(f"detail has {len(ends)} entries; give the first and the last instant to enlarge")
    start, stop = (int(k) for k in (np.searchsorted(time, ends[0]), np.searchsorted(time, ends[1], side="right")))
    if stop - start < 2:
        raise StructureError(
            f"detail from {ends[0]:.6g} to {ends[1]:.6g} holds {max(0, stop - start)} samples of the record, which "
            f"reaches from {time[0]:.6g} to {time[-1]:.6g}; needed at least 2"
        )
    return slice(start, stop)


def _fit_axes(detail: bool) -> tuple[Figure, NDArray[Any]]:
    figure = plt.figure(figsize=(7.2, 6.8 if detail else 4.8), layout="constrained")
    grid = figure.add_gridspec(2 + detail, 1, height_ratios=[3.0, 1.7, 3.0][: 2 + detail])
    top = figure.add_subplot(grid[0])
    panels = [top, figure.add_subplot(grid[1], sharex=top)]
    top.tick_params(labelbottom=False)
    if detail:
        panels.append(figure.add_subplot(grid[2]))
    figure.align_ylabels(panels)
    return figure, np.array(panels, dtype=object)[:, None]


def _draw_record(axis: Axes, numbers: _FitData, fit_percent: float | None) -> list[Any]:
    label = "predicted" if fit_percent is None else f"predicted (fit {_percent(fit_percent)})"
    axis.set_xlim(numbers.time[0], numbers.time[-1])
    return [
        *axis.plot(*extremes(numbers.time, numbers.measured, DRAWN), label="measured", **_MEASURED),
        *axis.plot(*extremes(numbers.time, numbers.predicted, DRAWN), label=label, **_PREDICTED),
    ]


def _draw_residual(axis: Axes, numbers: _FitData, unit: str) -> list[Any]:
    size = plain(f"RMS {numbers.residual_rms:.3g} {unit}".strip())
    axis.text(
        0.995, 1.0, size, transform=axis.transAxes, ha="right", va="bottom",
        fontsize=plt.rcParams["legend.fontsize"],
    )  # fmt: skip
    axis.axhline(0.0, color="0.3", linewidth=0.6, zorder=1)
    return list(axis.plot(*extremes(numbers.time, numbers.residual, DRAWN), label="residual", **_RESIDUAL))


def _draw_detail(axis: Axes, top: Axes, numbers: _FitData, detail: Any) -> list[Any]:
    part = numbers.detail
    t = numbers.time[part]
    top.axvspan(t[0], t[-1], color="0.85", zorder=0)
    axis.set_xlim(t[0], t[-1])
    where = (
        "Detail (shaded above), where the residual is largest" if isinstance(detail, str) else "Detail (shaded above)"
    )
    axis.set_title(where, loc="left")
    return [
        *axis.plot(*extremes(t, numbers.measured[part], DRAWN), label="measured", **_SAMPLES),
        *axis.plot(*extremes(t, numbers.predicted[part], DRAWN), label="predicted", **_PREDICTED),
    ]


def extremes(time: Array, values: Array, limit: int) -> tuple[Array, Array]:
    """At most about `limit` samples that draw the same line: the least and the greatest of each short bin, in order.

    A bin without any number is a gap.
    """
    if len(values) <= limit:
        return time, values
    size = -(-2 * len(values) // limit)
    padding = -len(values) % size
    bins = np.concatenate([values, np.full(padding, np.nan)]).reshape(-1, size)
    first = size * np.arange(len(bins))
    low = first + np.argmin(np.where(np.isnan(bins), np.inf, bins), axis=1)
    high = first + np.argmax(np.where(np.isnan(bins), -np.inf, bins), axis=1)
    # argmin and argmax of an empty bin are its first sample, a NaN
    kept = np.unique(np.concatenate([low, high]))
    return time[kept], values[kept]


def _percent(fit: float) -> str:
    """Never rounded up to a perfect fit."""
    return "above 99.99 %" if 99.995 <= fit < 100.0 else f"{fit:.2f} %"

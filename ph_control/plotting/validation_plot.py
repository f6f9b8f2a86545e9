"""Pictures of validation: models beside a response, residuals, the choice of the order, and tests of hypotheses.

Each function returns a `control.ControlPlot`, and draws on given axes or a new figure, which `heading` entitles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray
from scipy import signal
from scipy.special import ndtri

from .. import _checks
from .._display import p_value
from .._options import AxisScale
from .._types import Array, ComplexArray, Indices, Mask, RealOrComplex, Unpack
from .._units import unit_for
from ..exceptions import StructureError
from ..numerics.modal_assurance import stable_poles
from .fit_plot import Outputs, draw_outputs, line_of_model
from .inputs import measurements_of, recording_in, table_in
from .response_picture import Curve, DrawnResponses, FrequencyAxis, Scale, decibels, draw_part, is_logarithmic
from .style import (
    BAND,
    DOTS,
    MEASURED,
    SAMPLES,
    ZERO,
    AxesGiven,
    FrameStyle,
    Look,
    PlainLogFormatter,
    checked_limits,
    frequency_axis,
    gain_label,
    labelled,
    panels,
    picture,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist

# the line between two points is not the response, which may have a resonance there
_POINTS: dict[str, Any] = {"linewidth": 0.8, "marker": ".", "markersize": 4.0, "zorder": 3}
_INSIDE, _OUTSIDE = "0.25", "C3"
_CRITERIA = {"AIC": ("C0", "s", "-"), "AICc": ("C2", "^", "--"), "BIC": ("C3", "o", "-"), "hold-out": ("C4", "D", ":")}
_FEW = 150  # points
_CHANNELS = 12  # of one picture
_SEGMENTS = 8  # of which output spectra are averaged
_LAGS, _CONFIDENCE = 25, 0.99  # of the correlations of channels
_BESIDE = 0.75  # of the lowest mode of the chosen order, and of the highest its inverse, that are seen as well
_AROUND = 10**0.25  # of the modes on a logarithmic axis
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
    scale: str | None = None,
    heading: str,
    ax: AxesGiven = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Magnitudes of all models over the measured one, phases below, and the size of the errors.

    `predicted` has shape (k, K); the other arguments are those of `bode_plot`.
    """
    look = Look.of(style, FrameStyle)
    unit, unit_name = frequency_axis(Hz, time_unit)
    responses = _compared(omega, measured[None], predicted[:, None], labels, scale, (unit, unit_name))
    errors = [
        replace(curve, response=responses.measured[0].response - curve.response, line=line_of_model(k))
        for k, curve in enumerate(responses.curves)
    ]
    # the smaller error is drawn over the larger
    errors.sort(key=lambda error: -float(np.nanmean(np.abs(error.response) ** 2)))
    remainder, count = replace(responses, curves=errors, measured=[]), len(labels)
    quantities = gain_label(gain_unit), "Phase [deg]", gain_label(gain_unit, "Error")
    with look.context():
        drawn = picture(look, ax, (3, 1), (7.2, 5.55), tied=3, height_ratios=[2.4, 1.7, 1.7])
        for row, (part, of) in enumerate((("magnitude", responses), ("phase", responses), ("magnitude", remainder))):
            lines = draw_part(drawn.axes[row, 0], of, part, 0, 0, look, Scale())
            # what was measured first
            drawn.lines[row, 0] = lines[count:] + lines[:count]
            drawn.axes[row, 0].set_ylabel(quantities[row])
        drawn.axes[2, 0].set_xlabel(labelled("Frequency", unit_name))
        return drawn.finished(heading)


def _compared(
    omega: Array, measured: ComplexArray, predicted: ComplexArray, labels: Sequence[str], scale: str | None,
    unit: tuple[float, str], dots: Any = None,
) -> DrawnResponses:  # fmt: skip
    """Models (k, p, K) over a measured response (p, K) of p entries, at its frequencies above 0."""
    seen = omega > 0
    omega = omega[seen]
    # of a single frequency a little on both sides
    low, high = (omega[0], omega[-1]) if len(omega) > 1 else (0.9 * omega[0], 1.1 * omega[0])
    line = _POINTS if len(omega) <= _FEW else {**_POINTS, "marker": ""}
    models = [
        Curve(label, omega, values[:, None, seen], tabulated=True, line=line | line_of_model(k))
        for k, (label, values) in enumerate(zip(labels, predicted, strict=True))
    ]
    known = Curve("measured", omega, measured[:, None, seen], tabulated=True, line=dots or SAMPLES)
    axis = FrequencyAxis(float(low), float(high), *unit, is_logarithmic(scale, low, high, omega))
    return DrawnResponses(models, [known], axis, [""] * len(measured), [""])


def channel_comparison_plot(
    abscissa: Array,
    measured: NDArray[Any],
    predicted: NDArray[Any],
    *,
    names: Sequence[str],
    labels: Sequence[str],
    time_unit: str | None = None,
    Hz: bool | None = None,
    scale: str | None = None,
    gain_unit: str | None = None,
    detail: object = "auto",
    heading: str,
    ax: AxesGiven = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Outputs of all models over those measured, a panel for each of c channels.

    `abscissa` are instants or frequencies, `measured` has shape (c, T) and `predicted` (k, c, T).  Responses are
    complex, and drawn by their magnitudes.
    """
    look = Look.of(style, FrameStyle)
    spectral = np.iscomplexobj(measured)
    count = min(_CHANNELS, len(names))
    unit, unit_name = frequency_axis(Hz, time_unit)
    part: slice | None = None
    responses: DrawnResponses | None = None
    if spectral:
        responses = _compared(abscissa, measured, predicted, labels, scale, (unit, unit_name), DOTS)
    else:
        # of the output that is explained worst
        share = np.nanmean(np.abs(measured - predicted) ** 2, axis=(0, 2)) / np.nanvar(measured, axis=1)
        worst = int(np.nanargmax(share[:count]))
        part = Outputs(abscissa, measured[worst], predicted[:, worst], labels).part(detail, None)
    with look.context():
        drawn = panels(look, ax, count, (3.6, 2.2), sharex=ax is None)
        for k, axis in enumerate(drawn.axes.flat[:count]):
            if responses is not None:
                lines = draw_part(axis, responses, "magnitude", k, 0, look, Scale())
            else:
                outputs = Outputs(abscissa, measured[k], predicted[:, k], labels)
                outputs, dots = (outputs, MEASURED) if part is None else (outputs.cut(part), SAMPLES)
                lines = draw_outputs(axis, outputs, dots)
                look.lattice(axis)
            drawn.lines.flat[k] = lines
            axis.set_title(plain(names[k]), loc="left", fontsize="small")
            if k % drawn.axes.shape[1] == 0:
                axis.set_ylabel(gain_label(gain_unit) if spectral else "Output")
            if k + drawn.axes.shape[1] >= count:
                axis.set_xlabel(labelled("Frequency", unit_name) if spectral else labelled("Time", time_unit))
                axis.tick_params(labelbottom=True)
        kind = f" ({count} of {len(names)} channels)" * (count < len(names))
        return drawn.finished(heading + kind, drawn.legend_of_all())


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

    def draw(self, axis: Axes, look: Look) -> list[Artist]:
        """Stems; those that leave the band in another colour; feedback and response are parted at lag 0."""
        band = np.where(np.isfinite(self.band), self.band, 0.0)
        # one step wide at each lag
        edges, ends = np.append(self.lags - 0.5, self.lags[-1] + 0.5), np.append(band, band[-1])
        axis.fill_between(
            edges, ends, -ends, step="post", label=f"{100 * self.confidence:g} % band", color="C0", **BAND
        )  # fmt: skip
        axis.axhline(0.0, **ZERO)
        out = np.abs(self.values) > self.band
        lines: list[Artist] = []
        for mask, colour, marker, name in ((~out, _INSIDE, "o", "inside"), (out, _OUTSIDE, "D", "outside")):
            lags, values = self.lags[mask], self.values[mask]
            axis.vlines(lags, 0.0, values, color=colour, linewidth=1.2, zorder=2)
            dots: dict[str, Any] = {"linestyle": "none", "markersize": 3.5, "color": colour, "zorder": 3}
            lines += axis.plot(lags, values, label=name, marker=marker, **dots)
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

    def draw(self, axis: Axes, look: Look) -> list[Line2D]:
        """Both in decibels over frequency."""
        unit, unit_name = frequency_axis(self.Hz, self.time_unit)
        parts = self.measured[None], self.residuals[None, None]
        responses = _compared(self.omega, *parts, ["residual"], None, (unit, unit_name))
        lines = draw_part(axis, responses, "magnitude", 0, 0, look, Scale())[::-1]
        axis.set(xlabel=labelled("Frequency", unit_name), ylabel=gain_label(self.gain_unit))
        return lines


def residual_panels_plot(
    given: Sequence[CorrelationPanel | ResponsePanel], heading: str, ax: AxesGiven = None, *, folded: bool = False,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:  # fmt: skip
    """Panels below one another with a legend for each kind of them, or `folded`, in rows of three with one legend."""
    look = Look.of(style, FrameStyle)
    count = len(given)
    with look.context():
        if folded:
            drawn = panels(look, ax, count, (3.2, 2.1))
        else:
            drawn = picture(look, ax, (count, 1), (7.2, 0.8 + 2.3 * count))
        for k, panel in enumerate(given):
            axis = drawn.axes.flat[k]
            drawn.lines.flat[k] = panel.draw(axis, look)
            axis.set_title(plain(panel.title), loc="left")
            if folded:
                axis.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
        several = len({type(panel) for panel in given}) > 1
        return drawn.finished(heading, drawn.legend_of_all() if folded else drawn.legends() if several else None)


# --- the order -------------------------------------------------------------------------------------------------------


def order_selection_plot(
    orders: Indices,
    frequencies: Sequence[Array],
    stable: Sequence[Mask],
    criteria: Mapping[str, Array],
    *,
    chosen: int,
    criterion: str,
    time_unit: str | None = None,
    Hz: bool = False,
    ax: AxesGiven = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Natural frequencies of each order, and what each criterion has above its least value."""
    look = Look.of(style, FrameStyle)
    unit, unit_name = frequency_axis(Hz, time_unit)
    frequencies = [row / unit for row in frequencies]
    with look.context():
        drawn = picture(look, ax, (1, 2), (7.8, 4.4), sharey=True, width_ratios=[1.7, 1.0])
        modes, above = drawn.axes[0]
        drawn.lines[0, 0] = _draw_orders(modes, orders, frequencies, stable)
        drawn.lines[0, 1] = _draw_criteria(above, orders, criteria)
        for k, frequency in enumerate(frequencies[list(orders).index(chosen)]):
            label = "_" if k else f"modes of order {chosen}"
            modes.axvline(frequency, label=label, color="C3", linestyle=":", linewidth=0.8, zorder=0)
        modes.set(xlabel=labelled("Natural frequency", unit_name), ylabel="Order (number of modes)")
        above.set_xlabel("Criterion above its least value")
        choice = f"{criterion} chooses {chosen}" + ", the largest tried" * int(chosen == orders[-1])
        for axis, label in ((modes, choice), (above, "_")):
            axis.axhline(chosen, color="C3", linewidth=6.0, alpha=0.15, zorder=0, label=label)
            axis.set_ylim(orders[0] - 0.5, orders[-1] + 0.5)
            axis.yaxis.set_major_locator(MaxNLocator(integer=True))
            look.lattice(axis)
        return drawn.finished("Choice of the order", drawn.legends())


def _draw_orders(axis: Axes, orders: Indices, frequencies: Sequence[Array], stable: Sequence[Mask]) -> list[Line2D]:
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


def _draw_criteria(axis: Axes, orders: Indices, criteria: Mapping[str, Array]) -> list[Artist]:
    lines: list[Artist] = []
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


# --- poles of several orders -----------------------------------------------------------------------------------------


def stabilisation_plot(
    poles: Any,
    data: object = None,
    *,
    orders: ArrayLike | None = None,
    chosen: int | None = None,
    frequency_tolerance: float = 0.01,
    damping_tolerance: float = 0.05,
    least_mac: float = 0.95,
    omega_limits: ArrayLike | None = None,
    Hz: bool | None = None,
    scale: AxisScale | None = None,
    time_unit: str | None = None,
    ax: AxesGiven = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Stabilisation diagram: natural frequencies of models of several orders, and which of them stay.

    Parameters
    ----------
    poles : PEMResult, Stabilisation, or sequence of pairs (poles, shapes) or of arrays of poles
        For each order the poles, shape (k,), rad per unit time, one of each pair, and mode shapes, shape (k, p); or a
        result, whose `stabilisation()` gives these, with five orders above its own.
    data : control.FrequencyResponseData, control.TimeResponseData, or list of them, optional
        Measurement to draw behind: the sum of the sizes of all responses, or the power spectrum of all outputs; by
        default what a result was fitted to.
    orders : array_like, shape (K,), optional
        What the models are called; by default their numbers of poles.
    chosen : int, optional
        Order to mark; by default that of a result.
    frequency_tolerance, damping_tolerance : float
        Relative change up to which a frequency, or a damping ratio, counts as the same.
    least_mac : float
        Modal assurance criterion from which on a shape does.
    omega_limits : array_like, shape (2,), optional
        Ends of the frequency axis, in its unit; by default around the modes of the chosen order, else the stable poles.
    Hz : bool, optional
        As in `frf_plot`.
    scale : {'log', 'linear'}, optional
        Scale of the frequency axis; by default logarithmic where the poles span more than two decades.
    time_unit : str, optional
        Unit of time, for the label; by default that of the result or the data.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (1, 1): poles that are new, stable in frequency, also in damping, also in shape;
        `figure`, `legend`.

    Raises
    ------
    StructureError
        If poles, shapes, orders or tolerances are not of this form, or the data have no spectrum.

    Notes
    -----
    A pole is compared with those of the order before; each of these confirms one pole at most, that of the most in
    common, then the nearest.  Poles of a single output are not asked for their shape.  Real poles have no place here.

    Spectra and responses are those of each channel over its root mean square, so that units do not choose among them.

    O(sum k^3) for orders k.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> one, two = np.array([-0.1 + 10j]), np.array([-0.1 + 10.01j, -3 + 44j])
    >>> plot = phc.stabilisation_plot([one, two], Hz=False)
    >>> [line.get_label() for line in plot.lines[0, 0] if len(line.get_xdata())]
    ['new', 'and damping (5 %)']
    >>> plt.close(plot.figure)
    """
    table = stabilisation_data(
        poles, orders=orders, frequency_tolerance=frequency_tolerance, damping_tolerance=damping_tolerance,
        least_mac=least_mac,
    )  # fmt: skip
    given = measurements_of(poles, data)
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, poles, given))
    behind = _behind(given)
    marked = getattr(poles, "order", None) if chosen is None else _checks.whole_number("chosen", chosen, 1)
    look = Look.of(style, FrameStyle)
    d = np.concatenate(table.frequencies)
    ends = (d.min(initial=np.inf), d.max(initial=0.0)) if omega_limits is None else checked_limits(omega_limits)
    logarithmic = is_logarithmic(scale, float(ends[0]), float(ends[1]))
    with look.context():
        drawn = picture(look, ax, (1, 1), (7.6, 4.8))
        axis = drawn.axes[0, 0]
        drawn.lines[0, 0] = _draw_levels(axis, table, unit)
        _draw_behind(axis, behind, unit)
        axis.set(xlabel=labelled("Natural frequency", unit_name), ylabel="Order")
        axis.set_xscale("log" if logarithmic else "linear")
        axis.set_xlim(*_frequency_ends(table, behind, omega_limits, unit, logarithmic, marked))
        if logarithmic:
            axis.xaxis.set_major_formatter(PlainLogFormatter())
        low, high = float(table.orders.min()), float(table.orders.max())
        if marked is not None and low <= marked <= high:
            axis.axhline(marked, color="C3", linewidth=6.0, alpha=0.15, zorder=0, label=f"order {marked}")
        axis.set_ylim(low - 0.5 - 0.02 * (high - low), high + 0.5 + 0.02 * (high - low))
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
        look.lattice(axis)
        return drawn.finished("Stabilisation diagram", drawn.legend_of_all())


@dataclass(frozen=True)
class StabilisationData:
    """Poles that oscillate of each order, what they have in common with the order before, and what that is called."""

    orders: Array
    frequencies: list[Array]
    stability: list[NDArray[np.int8]]
    names: list[str]

    def points(self, level: int) -> tuple[Array, Array]:
        """Natural frequencies in rad per unit time, and orders, of the poles of one level."""
        kept = [row == level for row in self.stability]
        d = np.concatenate([row[mask] for row, mask in zip(self.frequencies, kept, strict=True)])
        return d, np.repeat(self.orders, [int(mask.sum()) for mask in kept])


def stabilisation_data(
    given: Any, *, orders: Any = None, frequency_tolerance: float = 0.01, damping_tolerance: float = 0.05,
    least_mac: float = 0.95,
) -> StabilisationData:  # fmt: skip
    """Compute what `stabilisation_plot` draws, of its arguments."""
    poles, shapes = _poles_and_shapes(given.stabilisation() if hasattr(given, "stabilisation") else given)
    levels, _ = stable_poles(
        poles, shapes, frequency_tolerance=frequency_tolerance, damping_tolerance=damping_tolerance,
        least_mac=least_mac,
    )  # fmt: skip
    names = _checks.real_array("orders", [len(row) for row in poles] if orders is None else orders, 1)
    if len(names) != len(poles):
        raise StructureError(f"there are {len(names)} orders for the poles of {len(poles)}; give one for each")
    moving = [row.imag > 0 for row in poles]
    words = [
        "new",
        f"stable frequency ({100 * frequency_tolerance:g} %)",
        f"and damping ({100 * damping_tolerance:g} %)",
    ]
    words += [f"and shape (MAC {least_mac:g})"] if shapes and shapes[0].shape[1] != 1 else []
    return StabilisationData(
        names, [np.abs(row)[mask] for row, mask in zip(poles, moving, strict=True)],
        [row[mask] for row, mask in zip(levels, moving, strict=True)], words,
    )  # fmt: skip


def _poles_and_shapes(orders: Any) -> tuple[list[ComplexArray], list[ComplexArray] | None]:
    """Poles of each order, and shapes of the same outputs with each, or with none."""
    try:
        rows = [_one_order(k, order) for k, order in enumerate(orders)]
    except (TypeError, OSError):  # python-control raises the last on being iterated
        raise StructureError(
            f"poles is a {type(orders).__name__}; pass a sequence with poles, or (poles, shapes), of each order"
        ) from None
    if not rows:
        raise StructureError("there are no orders; pass the poles of one at least")
    shapes = [row for _, row in rows if row is not None]
    if len({row.shape[1] for row in shapes}) > 1 or 0 < len(shapes) < len(rows):
        raise StructureError("the orders differ in the outputs of their shapes; give shapes of the same ones with each")
    return [row for row, _ in rows], shapes or None


def _one_order(k: int, given: Any) -> tuple[ComplexArray, ComplexArray | None]:
    """Poles and, where there are some, shapes of one order; of more than a vector of poles the second part."""
    pair = isinstance(given, tuple | list) and len(given) == 2 and np.ndim(given[0]) == 1
    row, shapes = given if pair else (given, None)
    name = f"of order {k}, counted from 0,"
    poles = _checks.complex_points(f"the poles {name}", row) if np.size(row) else np.zeros(0, complex)
    _checks.finite(f"the list of poles {k}", poles)
    if (poles.imag < 0).any():
        raise StructureError(
            f"pole {poles[poles.imag < 0][0]:.6g} is in the lower half-plane; give one of each pair of conjugates, "
            "that with a positive imaginary part"
        )
    if shapes is not None:
        shapes = np.reshape(shapes, (0, 1)) if not len(poles) and not np.size(shapes) else shapes
        shapes = _checks.complex_matrix(f"the shapes {name}", shapes, len(poles))
    return poles, shapes


def _behind(data: list[Any]) -> list[tuple[Array, Array, str]]:
    """Frequencies and decibels of what is drawn behind the poles, and its name."""
    curves = []
    for measurement in data:
        if (table := table_in(measurement)) is not None:
            omega, size, name = table[0], np.abs(table[1].reshape(-1, len(table[0]))), "Sum of |FRF| [dB]"
        else:
            _, y, step = recording_in(measurement)
            (omega, size), name = _output_spectra(y, step), "Output spectra [dB]"
        size = size[np.isfinite(size).any(axis=1)]
        level = np.sqrt(np.nanmean(size**2, axis=1, keepdims=True))
        total = np.nansum(size / np.where(level > 0, level, 1.0), axis=0)
        curves.append((omega, decibels(total), name))
    return curves


def _output_spectra(y: Array, step: float) -> tuple[Array, Array]:
    """Amplitude spectra (p, K) of outputs (p, T), of Hann windows; missing samples count as the mean."""
    y = y[np.isfinite(y).any(axis=1)]
    y = y - np.nanmean(y, axis=1, keepdims=True)
    length = 2 * max(4, y.shape[1] // (_SEGMENTS + 1))
    omega, power = signal.welch(np.nan_to_num(y), 2 * np.pi / step, nperseg=min(length, y.shape[1]))
    return omega, np.sqrt(power)


def _frequency_ends(
    table: StabilisationData, behind: list[tuple[Array, Array, str]], given: object, unit: float, logarithmic: bool,
    marked: int | None,
) -> tuple[float, float]:  # fmt: skip
    """Ends of the axis: those given, or around the poles of the marked order, else that are stable, as data reach."""
    if given is not None:
        return checked_limits(given)
    stable = np.concatenate([d[level > 0] for d, level in zip(table.frequencies, table.stability, strict=True)])
    d = stable if len(stable) else np.concatenate(table.frequencies)
    if marked is not None and (table.orders == marked).any():
        d = table.frequencies[int(np.argmax(table.orders == marked))] * np.array([[_BESIDE], [1 / _BESIDE]])
    if not len(d):
        return (behind[0][0][0] / unit, behind[0][0][-1] / unit) if behind else (0.0, 1.0)
    # as wide as the modes and half a decade, or what was measured
    low, high = float(d.min()), float(d.max())
    low, high = (low / _AROUND, high * _AROUND) if logarithmic else (low - 0.15 * high, 1.15 * high)
    if behind:
        grids = [omega for omega, *_ in behind]
        low, high = max(low, min(grid[0] for grid in grids)), min(high, max(grid[-1] for grid in grids))
    return max(low, 0.0) / unit, high / unit


_LEVELS: list[dict[str, Any]] = [
    {"marker": "x", "color": "0.65", "markersize": 4.0, "markeredgewidth": 0.9},
    {"marker": "^", "color": "0.35", "markersize": 5.0, "markerfacecolor": "white"},
    {"marker": "s", "color": "C1", "markersize": 4.5, "markerfacecolor": "white"},
    {"marker": "o", "color": "C0", "markersize": 5.0},
]


def _draw_levels(axis: Axes, table: StabilisationData, unit: float) -> list[Artist]:
    lines: list[Artist] = []
    for level, (name, look) in enumerate(zip(table.names, _LEVELS, strict=False)):
        d, order = table.points(level)
        lines += axis.plot(d / unit, order, linestyle="none", label=name, zorder=3 + 0.1 * level, **look)
    return lines


def _draw_behind(axis: Axes, behind: list[tuple[Array, Array, str]], unit: float) -> None:
    """Curves to a scale of their own at the right, beneath the poles."""
    if not behind:
        return
    twin = axis.twinx()
    twin.set_zorder(axis.get_zorder() - 1)
    twin.patch.set_visible(True)
    axis.patch.set_visible(False)
    twin.set_facecolor(axis.get_facecolor())
    for omega, level, _ in behind:
        twin.plot(omega / unit, level, color="0.78", linewidth=1.0)
    twin.set_ylabel(", ".join(dict.fromkeys(name for _, _, name in behind)), color="0.45")
    twin.tick_params(axis="y", colors="0.45")
    twin.grid(False)


# --- residuals of several channels, tests of hypotheses --------------------------------------------------------------


def channel_correlations(residuals: RealOrComplex, labels: Sequence[str]) -> list[CorrelationPanel]:
    """Autocorrelation of each row of residuals (c, T), NaN where missing, and the band of white noise.

    Of complex ones it is the real part, from point to point.
    """
    panels = []
    for row, label in zip(residuals, labels, strict=True):
        seen = np.isfinite(row)
        e = np.where(seen, row - (np.mean(row[seen]) if seen.any() else 0.0), 0.0)
        count = max(1, min(_LAGS, int(seen.sum()) // 5))
        k = np.arange(1, count + 1)
        sums = np.array([np.sum(e[j:] * e[:-j].conj()).real for j in k])
        pairs = np.array([np.count_nonzero(seen[j:] & seen[:-j]) for j in k])
        power = np.sum(np.abs(e) ** 2) / max(1, int(seen.sum()))
        values = sums / np.maximum(pairs, 1) / (power or 1.0)
        degrees = pairs * (2 if np.iscomplexobj(row) else 1)
        band = float(ndtri(0.5 + 0.5 * _CONFIDENCE)) / np.sqrt(np.maximum(degrees, 1))
        unit = "points" if np.iscomplexobj(row) else "samples"
        panels.append(CorrelationPanel(k, values, band, _CONFIDENCE, label, f"Lag [{unit}]"))
    return panels


def hypothesis_plot(
    tests: Any, *, level: float = 0.05, ax: AxesGiven = None, **style: Unpack[FrameStyle]
) -> ct.ControlPlot:
    """Table of the tests of a fit: hypothesis, likelihood ratio, degrees of freedom, p-value, and what follows.

    Parameters
    ----------
    tests : PEMResult, or sequence of tests
        A result, or its `tests`: each with `hypothesis`, `likelihood_ratio`, `dof` and `p`.
    level : float
        p-value below which a hypothesis is rejected, between 0 and 1.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (1, 1), the lines a list with the table; `figure`.

    Raises
    ------
    StructureError
        If there are no tests, or the level is out of range.

    Notes
    -----
    A likelihood ratio is twice the log-likelihood that the wider model gains.  Rejected hypotheses are in bold type.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> plant, rng = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0)
    >>> u = rng.standard_normal(500)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
    >>> plot = phc.hypothesis_plot(phc.pem((u, y + 0.1 * rng.standard_normal(500)), 1, dt=0.1))
    >>> plot.lines[0, 0][0][1, 0].get_text().get_text()
    'lossless'
    >>> plt.close(plot.figure)
    """
    _checks.level("level", level)
    rows = hypothesis_table(tests, level)
    look = Look.of(style, FrameStyle)
    with look.context():
        drawn = picture(look, ax, (1, 1), (6.6, 0.9 + 0.3 * (1 + len(rows))))
        axis = drawn.axes[0, 0]
        axis.set_axis_off()
        cells = [[plain(text) for text in row] for row in rows]
        columns = ["hypothesis", "likelihood ratio", "dof", "p-value", f"at {100 * level:g} %"]
        table = axis.table(
            cells, colLabels=columns, loc="center", cellLoc="right", edges="horizontal", colWidths=_WIDTHS
        )
        table.auto_set_font_size(False)
        table.scale(1.0, 1.4)
        for (i, j), cell in table.get_celld().items():
            cell.set_edgecolor("0.75")
            cell.get_text().set_horizontalalignment("left" if j in (0, 4) else "right")
            if i == 0 or rows[i - 1][4].startswith("rejected"):
                cell.get_text().set_fontweight("bold")
        drawn.lines[0, 0] = [table]
        return drawn.finished("Tests of the model against wider ones")


_WIDTHS = [0.3, 0.22, 0.1, 0.18, 0.2]


def hypothesis_table(tests: Any, level: float) -> list[list[str]]:
    """Rows of `hypothesis_plot`, as texts."""
    listed = list(getattr(tests, "tests", tests)) if hasattr(tests, "tests") or isinstance(tests, list | tuple) else []
    needed = ("hypothesis", "likelihood_ratio", "dof", "p")
    if not listed or not all(hasattr(test, name) for test in listed for name in needed):
        raise StructureError(
            f"this is a {type(tests).__name__} without tests; pass a result of pem that has some, or its tests"
        )
    return [
        [
            str(test.hypothesis), f"{test.likelihood_ratio:.5g}", f"{test.dof:g}",
            p_value(test.p).removeprefix("p ").removeprefix("= "),
            "rejected" if test.p < level else "not rejected",
        ]
        for test in listed
    ]  # fmt: skip

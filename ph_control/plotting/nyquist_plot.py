"""Nyquist curves of frequency responses over their measurement, with impedances as electrochemists draw them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from .._types import Array
from .._units import unit_for
from .frf_plot import chosen_channels, frf_data, gain_units
from .inputs import table_in
from .response_curve import Curve, FrequencyAxis
from .response_picture import Responses, Scale
from .style import (
    DOTS,
    ZERO,
    LineStyle,
    Look,
    checked_limits,
    frequency_axis,
    imaginary_is_turned,
    panels,
    plain,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

_HEIGHTS = 2.8, 5.2  # of a figure, inches
_MARKED = 10  # decades of frequency, beyond which none is marked
_MARK: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 5.0, "markerfacecolor": "white", "zorder": 4}


def nyquist_plot(
    model: Any,
    data: Any = None,
    *,
    outputs: Sequence[int | str] | None = None,
    inputs: Sequence[int | str] | None = None,
    omega_limits: ArrayLike | None = None,
    Hz: bool | None = None,
    segments: int = 8,
    intersample: str | None = None,
    negative_imaginary: bool | None = None,
    time_unit: str | None = None,
    gain_unit: str | Sequence[str] | None = None,
    ax: Any = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Imaginary over real part of frequency responses, with the measurement as dots beneath the model.

    Parameters
    ----------
    model : PEMResult, modal form, linear system, or control.FrequencyResponseData
        Model of p outputs and m inputs, as in `frf_plot`; a measured response is drawn alone.
    data, outputs, inputs, omega_limits, Hz, segments, intersample
        As in `frf_plot`; frequencies are those of the curves.
    negative_imaginary : bool, optional
        Whether `-Im` points upwards, as is usual for impedances; by default where the unit of the response is the ohm.
    time_unit, gain_unit
        As in `frf_plot`.
    ax : array of matplotlib.axes.Axes, optional
        Axes to draw on, one for each response.  By default a new figure.
    **style
        As in `frf_plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` with a panel for each response: curve, then dots; `figure`, `legend`.

    Raises
    ------
    StructureError
        As `frf_plot`.

    Notes
    -----
    Only positive frequencies are drawn.  Both axes have one scale, so that a resistor beside a capacitor is half a
    circle.  Where the frequencies span more than a decade, rings on the curve mark powers of ten.  Next to poles on the
    imaginary axis the curve leaves the picture.

    Examples
    --------
    >>> import control as ct, matplotlib.pyplot as plt, ph_control as phc
    >>> cell = 0.01 + ct.tf([0.02], [0.1, 1.0])  # a resistor before another one beside a capacitor
    >>> plot = phc.nyquist_plot(cell, gain_unit="ohm", time_unit="s")
    >>> plot.axes[0, 0].get_xlabel(), plot.axes[0, 0].get_ylabel()
    ('Re [ohm]', '−Im [ohm]')
    >>> plt.close(plot.figure)
    """
    look = Look.of(style)
    if data is None and table_in(model) is not None:
        numbers, units = _tabulated(model, outputs, inputs, omega_limits, Hz, time_unit, gain_unit)
    else:
        numbers, units = frf_data(
            model, data, outputs=outputs, inputs=inputs, omega_limits=omega_limits, Hz=Hz, segments=segments,
            intersample=intersample, time_unit=time_unit, gain_unit=gain_unit,
        )  # fmt: skip
    scale = Scale(negative_imaginary=imaginary_is_turned(negative_imaginary, units))
    cells = numbers.cells(1)[0]
    with look.context():
        drawn = panels(look, ax, len(cells), (6.0, 4.6) if len(cells) == 1 else (3.4, 3.2))
        for k, (i, j) in enumerate(cells):
            axis = drawn.axes.flat[k]
            drawn.lines.flat[k] = _draw(axis, numbers, i, j, look, scale)
            axis.set(xlabel=scale.label("real", units[i], False), ylabel=scale.label("imaginary", units[i], False))
            if len(cells) > 1:
                axis.set_title(plain(numbers.name(i, j)), loc="left", fontsize="small")
        if len(cells) == 1 and drawn.new:
            _fit_height(drawn.figure, drawn.axes[0, 0])
        title = numbers.title.replace("Frequency response", "Nyquist curve")
        return drawn.finished(title, drawn.legend_of_all())


def _tabulated(
    table: Any, outputs: Any, inputs: Any, limits: Any, Hz: bool | None, time_unit: str | None, gain_unit: Any
) -> tuple[Responses, list[str | None]]:
    """A measured response without a model."""
    omega, values = table_in(table) or (np.zeros(0), np.zeros((0, 0, 0), complex))
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, table))
    low, high = (omega[0], omega[-1]) if limits is None else np.multiply(checked_limits(limits), unit)
    names = [
        list(getattr(table, f"{kind}_labels", None) or [f"{letter}[{k}]" for k in range(count)])
        for kind, letter, count in zip(("output", "input"), "yu", values.shape, strict=False)
    ]
    rows, columns = (
        chosen_channels(what, given, some)
        for what, given, some in zip(("outputs", "inputs"), (outputs, inputs), names, strict=True)
    )
    measured = Curve("measured", omega, values[np.ix_(rows, columns)], tabulated=True)
    chosen = [names[0][k] for k in rows], [names[1][k] for k in columns]
    responses = Responses([], [measured], FrequencyAxis(float(low), float(high), unit, unit_name), *chosen)
    title = f"Nyquist curve, {responses.name(0, 0)}" if len(rows) == len(columns) == 1 else "Nyquist curves"
    title = title.replace(", u[0] to y[0]", "")
    units = gain_units(gain_unit, [table], values.shape[:2], rows, columns)
    return Responses([], [measured], responses.axis, *chosen, title), units


def _draw(axis: Axes, numbers: Responses, i: int, j: int, look: Look, scale: Scale) -> list[Any]:
    """Curve of an entry, dots, and rings at powers of ten of the frequency; lines of the first two."""
    (real, imaginary), (real_dots, imaginary_dots) = zip(
        *(numbers.values(part, i, j, scale) for part in ("real", "imaginary")), strict=True
    )
    lines: list[Any] = []
    axis.axhline(0.0, **ZERO)
    axis.axvline(0.0, **ZERO)
    for k, (curve, x, y) in enumerate(zip(numbers.curves, real, imaginary, strict=True)):
        seen = curve.visible(numbers.axis)
        x, y = np.where(seen, x, np.nan), np.where(seen, y, np.nan)
        lines += axis.plot(x, y, label=plain(curve.label), **look.curve(k))
        _mark_decades(axis, numbers.axis, curve.omega, x, y, lines[-1].get_color())
    for one, x, y in zip(numbers.measured, real_dots, imaginary_dots, strict=True):
        seen = (one.omega >= numbers.axis.low) & (one.omega <= numbers.axis.high) & ~one.noisy(i)
        lines += axis.plot(x[seen], y[seen], label=plain(one.label), rasterized=True, **{**DOTS, "markersize": 5.0})
        if not numbers.curves:
            _mark_decades(axis, numbers.axis, one.omega, x, y, lines[-1].get_color())
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.1)
    look.lattice(axis)
    return lines


def _fit_height(figure: Figure, axis: Axes) -> None:
    """Make a figure as high as what it shows."""
    width, _ = figure.get_size_inches()
    share = axis.dataLim.height / (axis.dataLim.width or 1.0)
    figure.set_size_inches(width, float(np.clip(1.5 + (width - 1.0) * 1.2 * share, *_HEIGHTS)))


def _mark_decades(axis: Axes, frequency: FrequencyAxis, omega: Array, x: Array, y: Array, colour: str) -> None:
    low, high = max(frequency.low, omega[0]) / frequency.unit, min(frequency.high, omega[-1]) / frequency.unit
    if not low > 0:
        return
    powers = 10.0 ** np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
    if not 2 <= len(powers) <= _MARKED:
        return
    place = [np.interp(np.log(powers * frequency.unit), np.log(omega), values) for values in (x, y)]
    axis.plot(*place, color=colour, label="_", **_MARK)
    # where rings crowd, as at both ends of a curve, only the first of them is named
    reach = max(np.nanmax(x) - np.nanmin(x), np.nanmax(y) - np.nanmin(y)) or 1.0
    last = None
    for power, at, height in zip(powers, *place, strict=True):
        if np.isfinite(at + height) and (last is None or np.hypot(at - last[0], height - last[1]) > 0.1 * reach):
            last = (at, height)
            axis.annotate(
                f"{power:g} {frequency.unit_name}", last, (5, 5), textcoords="offset points", fontsize="x-small",
                color="0.35",
            )  # fmt: skip

"""Pictures of modes: their weights over frequency, and poles and zeros on the imaginary axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from .. import _checks
from .._units import unit_for
from ..exceptions import StructureError
from .mode_data import ModeTable, PoleZeroMap, mode_tables, pole_zero_maps, strips
from .style import LineStyle, Look, MarkStyle, frequency_axis, labelled, new_axes, plain

if TYPE_CHECKING:
    from typing_extensions import Unpack

Array = NDArray[np.float64]

_WIDE = 1e3  # ratio of weights beyond which they are drawn to a logarithmic scale
_DECADES = 100.0  # ratio of frequencies beyond which they are
_MANY = 12  # poles in a strip
_MANY_STEMS = 40
_MARKERS = ("o", "s", "^", "D", "v")
_POLE: dict[str, Any] = {"linestyle": "none", "marker": "x", "markersize": 7.0, "markeredgewidth": 1.5, "zorder": 3}
_ZERO: dict[str, Any] = {
    "linestyle": "none", "marker": "o", "markersize": 6.0, "markerfacecolor": "none", "markeredgewidth": 1.3,
    "zorder": 3,
}  # fmt: skip
_AXIS: dict[str, Any] = {"color": "0.4", "linewidth": 0.8, "zorder": 1}


def modes_plot(
    sysdata: Any,
    *,
    quantity: str = "kappa",
    level: float = 0.95,
    Hz: bool = False,
    time_unit: str | None = None,
    gain_unit: str | None = None,
    label: str | Sequence[str] | None = None,
    ax: Any = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Modes of lossless systems: a stem at each natural frequency, as high as its weight.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other lossless system of python-control, or a `PEMResult`, which is drawn
        with its confidence intervals.
    quantity : {'kappa', 'r'}
        Weight to draw: the residue `kappa = r d` of the pole, or `r`.
    level : float
        Probability of the intervals of a `PEMResult`, between 0 and 1.
    Hz : bool
        Frequency axis in Hz instead of rad per unit time, as in `bode_plot`.
    time_unit : str, optional
        Unit of time, for the labels; by default that of the fit, none where it is not known.
    gain_unit : str, optional
        Unit of the response, output over input, which is that of `r`.
    label : str or sequence of str, optional
        Legend entries of the systems; by default their names, and "model" for a single `PortHamiltonian` without one.
    ax : array of matplotlib.axes.Axes, shape (m, 1), optional
        Axes to draw on, one for each port.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the stems, `color`, `linestyle`, `linewidth`,
        as in `control.bode_plot`.

    Returns
    -------
    control.ControlPlot
        `lines`, of shape (m, 1), holds the heads of the stems of each system; `axes`, `figure`, `legend`.

    Raises
    ------
    NotLosslessError
        If a system has no modes of this kind.
    StructureError
        If the systems differ in their ports or the arguments are not of this form.

    Notes
    -----
    The scale of weights is logarithmic where they span more than three decades, that of frequencies beyond two.  Hollow
    heads are modes that no input reaches, and, of a fit, weights that the data do not show.  A pole at 0 has the weight
    `kappa_0` and stands at 0, or, where the scale is logarithmic, in the legend.

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.modes_plot(phc.modes([1.0, 2.0], [1.0, 0.25]))
    >>> plot.lines[0, 0][0].get_ydata()
    array([1. , 0.5])
    >>> plt.close(plot.figure)
    """
    time_unit = unit_for(time_unit, sysdata)
    unit, unit_name = frequency_axis(Hz, time_unit)
    tables, ports, default = mode_tables(sysdata, quantity, level, label)
    look = Look.of(style)
    with look.context():
        size = (6.4, 3.4 if len(ports) == 1 else 2.2 * len(ports))
        figure, axes = new_axes(ax, (len(ports), 1), size, sharex=True)
        lines = np.empty(axes.shape, dtype=object)
        for port, axis in enumerate(axes[:, 0]):
            lines[port, 0] = _draw_modes(axis, tables, port, unit, look)
            look.lattice(axis)
            axis.set_ylabel(_weight_label(quantity, gain_unit, time_unit))
            if len(ports) > 1:
                axis.set_title(plain(f"Port {ports[port]}"), loc="left")
        axes[-1, 0].set_xlabel(labelled("Natural frequency", unit_name))
        legend = look.legend(axes[0, 0])
        look.entitle(figure, ax, default)
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _weight_label(quantity: str, gain_unit: str | None, time_unit: str | None) -> str:
    if quantity == "r":
        return labelled("Weight r", gain_unit)
    return labelled("Residue κ = r d", f"({gain_unit})/{time_unit or 'time'}" if _checks.unit_text(gain_unit) else None)


def _draw_modes(axis: Axes, tables: list[ModeTable], port: int, unit: float, look: Look) -> list[Any]:
    d = np.concatenate([table.d for table in tables]) / unit
    size = np.concatenate([table.size[:, port] for table in tables])
    shown = size[size > 0]
    logarithmic = bool(len(shown)) and float(shown.max()) > _WIDE * float(shown.min())
    _frequency_scale(axis, d, any(table.at_zero[port] > 0 for table in tables))
    bottom = 0.0
    if logarithmic:
        bottom = float(10.0 ** np.floor(np.log10(shown.min()) - 0.3))
        axis.set_yscale("log")
    lines = [_draw_stems(axis, k, table, port, unit, bottom, look) for k, table in enumerate(tables)]
    _weight_range(axis, tables, port, bottom, logarithmic)
    return lines


def _frequency_scale(axis: Axes, d: Array, from_zero: bool) -> None:
    low, high = float(d.min(initial=np.inf)), float(d.max(initial=0.0))
    if len(d) and high > _DECADES * low:
        axis.set_xscale("log")
        axis.set_xlim(low / 1.5, high * 1.5)
    elif high > low > 0.5 * high and not from_zero:
        margin = max(0.1 * (high - low), 0.02 * high)
        axis.set_xlim(low - margin, high + margin)
    else:
        axis.set_xlim(-0.02 * (high or 1.0), 1.05 * (high or 1.0))


def _weight_range(axis: Axes, tables: list[ModeTable], port: int, bottom: float, logarithmic: bool) -> None:
    """From the bottom of the stems to above all weights, and above their intervals where these are not far longer."""
    largest = max(float(np.max(table.size[:, port], initial=float(table.at_zero[port]))) for table in tables)
    largest = largest or 1.0
    tops = [table.size_range[:, 1] for table in tables]
    ends = np.concatenate([top[np.isfinite(top)] for top in tops])
    top = max(largest, min(float(ends.max(initial=0.0)), 3.0 * largest))
    axis.set_ylim(bottom if logarithmic else -0.03 * top, 2.0 * top if logarithmic else 1.08 * top)


def _draw_stems(axis: Axes, k: int, table: ModeTable, port: int, unit: float, bottom: float, look: Look) -> Any:
    colour = look.line.get("color", f"C{k}")
    stem = {
        "linewidth": 1.2 if len(table.d) <= _MANY_STEMS else 0.8 if len(table.d) <= 5 * _MANY_STEMS else 0.3,
        "linestyle": "-",
        **look.line,
        "color": colour,
    }
    d, size = table.d / unit, table.size[:, port]
    height = np.maximum(size, bottom)
    known = (size > 0) & ~np.isinf(table.size_range[:, 1])
    axis.vlines(d, bottom, height, zorder=2, **stem)
    label = table.label
    on_zero = table.at_zero[port]
    if on_zero > 0 and axis.get_xscale() == "log":
        label += f" (and {on_zero:.3g} at 0)"
    elif on_zero > 0:
        axis.vlines([0.0], bottom, [on_zero], zorder=2, **stem)
        axis.plot([0.0], [on_zero], marker=_MARKERS[k % 5], color=colour, markersize=5.0, zorder=3)
    head = 5.0 if len(d) <= _MANY_STEMS else 3.0
    marker: dict[str, Any] = {"linestyle": "none", "marker": _MARKERS[k % 5], "markersize": head, "zorder": 3}
    heads = axis.plot(d, height, label=plain(label), color=colour, **marker)[0]
    hollow = {**marker, "markerfacecolor": "white", "color": colour, "zorder": 4, "clip_on": False}
    if not known.all():
        axis.plot(d[~known], height[~known], label="not reached, or not shown by the data", **hollow)
    if table.level is not None:
        _draw_intervals(axis, table, d, height, unit, colour, stem["linewidth"])
    return heads


def _draw_intervals(
    axis: Axes, table: ModeTable, d: Array, height: Array, unit: float, colour: Any, width: float
) -> None:
    reach = np.abs(table.size_range - table.size[:, :1]).T
    spread = np.abs(table.d_range / unit - d[:, None]).T
    usable = [np.where(np.isfinite(bars), bars, 0.0) for bars in (reach, spread)]
    axis.errorbar(
        d, height, yerr=usable[0], xerr=usable[1], fmt="none", ecolor=colour, elinewidth=2.2 * width, capsize=3.0,
        alpha=0.45, zorder=2.5, label=f"{100 * (table.level or 0.0):g} % intervals",
    )  # fmt: skip


# --- poles and zeros -------------------------------------------------------------------------------------------------


def pole_zero_plot(
    sysdata: Any,
    *,
    Hz: bool = False,
    time_unit: str | None = None,
    label: str | Sequence[str] | None = None,
    ax: Any = None,
    **style: Unpack[MarkStyle],
) -> ct.ControlPlot:
    """Poles and zeros; those of lossless systems along the imaginary axis, where they alternate.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other LTI system of python-control; a `PEMResult` stands for its `system`.
    Hz : bool
        Axes in Hz instead of rad per unit time, as in `bode_plot`.
    time_unit : str, optional
        Unit of time, for the labels; by default that of the fit, none where it is not known.
    label : str or sequence of str, optional
        Names of the systems; by default their own, and "model" for a single `PortHamiltonian` without one.
    ax : array of matplotlib.axes.Axes, optional
        Axes to draw on: as many strips of the imaginary axis, or one complex plane.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`, `color`, as in `control.pole_zero_plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (strips, 1): in each a list with poles and zeros of the first system, then of the
        next; `figure`, `legend`.

    Raises
    ------
    StructureError
        If the systems differ in their ports, or continuous-time and discrete-time systems are mixed.

    Notes
    -----
    If all poles and zeros are on the imaginary axis, its upper half is drawn, from left to right, one row for each
    system, in strips of 24 poles, or in twelve of as many as it takes; the lower half mirrors it.  The picture says
    whether poles and zeros alternate, as Foster's theorem has it for one port, and how many cancel.  Otherwise the
    complex plane is drawn.

    The zeros cost O(n^3).

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.pole_zero_plot(phc.frenkel_kontorova())
    >>> poles, zeros = plot.lines[0, 0]
    >>> zeros.get_xdata().round(6)
    array([0., 1.])
    >>> plt.close(plot.figure)
    """
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, sysdata))
    maps, default = pole_zero_maps(sysdata, label)
    look = Look.of(style, MarkStyle)
    with look.context():
        if all(one.on_axis for one in maps):
            figure, axes, lines = _draw_strips(ax, maps, unit, unit_name, look)
        else:
            figure, axes = new_axes(ax, (1, 1), (5.6, 4.8))
            lines = np.empty((1, 1), dtype=object)
            lines[0, 0] = _draw_plane(axes[0, 0], maps, unit, unit_name, look)
        legend = look.legend(axes[0, 0])
        look.entitle(figure, ax, default)
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _draw_strips(ax: Any, maps: list[PoleZeroMap], unit: float, unit_name: str, look: Look) -> Any:
    ranges = strips(maps, None if ax is None else max(1, int(np.size(ax))))
    if ax is not None and np.size(ax) > len(ranges):
        raise StructureError(f"ax has {np.size(ax)} axes, but there are poles for {len(ranges)} only; pass as many")
    shape = (len(ranges), 1)
    figure, axes = new_axes(
        ax, shape, (7.2, 1.0 + len(ranges) * (0.55 + (0.35 if len(maps) == 1 else 0.45) * len(maps)))
    )
    lines = np.empty(shape, dtype=object)
    for row, (axis, (low, high)) in enumerate(zip(axes[:, 0], ranges, strict=True)):
        lines[row, 0] = []
        for k, one in enumerate(maps):
            lines[row, 0] += _draw_row(axis, one, -k, low, high, unit, look.line, len(maps) > 1)
        _strip_axis(axis, maps, low / unit, high / unit, lines[row, 0])
        if look.grid:
            axis.grid(True, axis="x", linewidth=0.5, alpha=0.6)
    axes[-1, 0].set_xlabel(labelled("Imaginary part, upper half", unit_name))
    return figure, axes, lines


def _draw_row(
    axis: Axes, one: PoleZeroMap, height: int, low: float, high: float, unit: float, line: dict[str, Any], named: bool
) -> list[Any]:
    axis.axhline(height, **_AXIS)
    poles, zeros = (w[(w >= low) & (w < high)] / unit for w in one.upper)
    counts = [f"{len(w)} {what}{'s' * (len(w) != 1)}" for w, what in zip(one.upper, ("pole", "zero"), strict=True)]
    counts[1] += _verdict(one)
    if named:
        text = ", ".join(counts)
        place = axis.get_yaxis_transform()
        axis.text(1.0, height + 0.16, text, transform=place, ha="right", va="bottom", fontsize="x-small", color="0.35")
        counts = ["poles", "zeros"] if height == 0 else ["_", "_"]
    # smaller where they are many
    share = 1.0 if len(poles) <= _MANY else max(0.4, 0.75 * min(1.0, (3 * _MANY / len(poles)) ** 0.5))
    lines = []
    for places, style, label, colour in ((poles, _POLE, counts[0], "C0"), (zeros, _ZERO, counts[1], "C1")):
        properties = {"color": colour, **line, **style, "markersize": share * style["markersize"]}
        properties["markeredgewidth"] = style["markeredgewidth"] * (1.0 if share >= 0.75 else 0.5)
        lines += axis.plot(places, np.full(len(places), height), label=plain(label), **properties)
    return lines


def _verdict(one: PoleZeroMap) -> str:
    """Say how poles and zeros lie; of several ports nothing, where they need not alternate."""
    if one.ports != 1:
        return ""
    return f", {one.cancelled} cancelled" if one.cancelled else f", {'not ' * (not one.alternating)}alternating"


def _strip_axis(axis: Axes, maps: list[PoleZeroMap], low: float, high: float, lines: list[Any]) -> None:
    marks = np.concatenate([line.get_xdata() for line in lines])
    positive = marks[marks > 0]
    if len(positive) and positive.max() > _DECADES * positive.min():
        # 0 has no place on this scale but its end
        end = float(positive.min()) / 2.0
        axis.set_xscale("log")
        axis.set_xlim(end, high)
        for line in lines:
            x = np.asarray(line.get_xdata(), float)
            if (x == 0).any():
                line.set_xdata(np.where(x == 0, end, x))
                line.set_clip_on(False)
                axis.annotate(
                    "0", (end, line.get_ydata()[0]), (0, 8), textcoords="offset points", ha="center",
                    fontsize="small",
                )  # fmt: skip
    else:
        axis.set_xlim(low, high)
    axis.set_ylim(-len(maps) + 0.35, 0.65)
    several = len(maps) > 1
    axis.set_yticks(-np.arange(len(maps)) if several else [], [plain(one.label) for one in maps] if several else [])
    axis.spines[["left", "right", "top"]].set_visible(False)


def _draw_plane(axis: Axes, maps: list[PoleZeroMap], unit: float, unit_name: str, look: Look) -> list[Any]:
    lines: list[Any] = []
    discrete = maps[0].discrete
    scale = 1.0 if discrete else unit
    axis.axhline(0.0, **_AXIS)
    axis.axvline(0.0, **_AXIS)
    if discrete:
        angle = np.linspace(0.0, 2 * np.pi, 361)
        axis.plot(np.cos(angle), np.sin(angle), label="_", **_AXIS)
        axis.set_aspect("equal")
    for k, one in enumerate(maps):
        for points, what, style in ((one.poles, "poles", _POLE), (one.zeros, "zeros", _ZERO)):
            shown = points[np.isfinite(points)] / scale
            label = f"{one.label}: {what}" if len(maps) > 1 else what
            properties = {"color": f"C{k}", **look.line, **style}
            lines += axis.plot(shown.real, shown.imag, label=plain(label), **properties)
    axis.margins(0.08)
    look.lattice(axis)
    axis.set_xlabel("Real part" if discrete else labelled("Real part", unit_name))
    axis.set_ylabel("Imaginary part" if discrete else labelled("Imaginary part", unit_name))
    return lines

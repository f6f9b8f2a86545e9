"""Pictures of modes: their weights over frequency, and poles and zeros on the imaginary axis; numbers first."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from .. import _checks
from .._display import counted
from .._types import Array, ComplexArray, Unpack
from .._units import unit_for
from ..exceptions import StructureError
from ..modal.general_form import invariant_zeros
from ..numerics.rational import poles as poles_of
from ..systems.port_hamiltonian import modes as modes_of
from .inputs import Subject, is_fit, subjects_of, title_of
from .style import AxesGiven, LineStyle, Look, MarkStyle, Picture, frequency_axis, labelled, picture, plain

WeightKind = Literal["kappa", "r"]

_WIDE = 1e3  # ratio of weights beyond which they are drawn to a logarithmic scale
_DECADES = 100.0  # ratio of frequencies beyond which they are
_MANY_STEMS = 40
_MARKERS = ("o", "s", "^", "D", "v")

_UNREACHED = 1e-13  # of the largest weight: that of a mode that is not reached, but for rounding
_STILL = 1e-12  # of the largest frequency: that of a pole at 0, but for rounding
_TINY = float(np.finfo(float).tiny)

_ON_AXIS = 1e-7  # relative real part of a pole or zero that is on the axis but for the rounding of an eigenvalue
_POLES_IN_STRIP = 24  # that are told apart
_STRIPS = 12  # that fit on a page; of more than 288 poles the marks overlap
_MANY = 12  # poles in a strip
_POLE: dict[str, Any] = {"linestyle": "none", "marker": "x", "markersize": 7.0, "markeredgewidth": 1.5, "zorder": 3}
_ZERO: dict[str, Any] = {
    "linestyle": "none", "marker": "o", "markersize": 6.0, "markerfacecolor": "none", "markeredgewidth": 1.3,
    "zorder": 3,
}  # fmt: skip
_AXIS: dict[str, Any] = {"color": "0.4", "linewidth": 0.8, "zorder": 1}


def modes_plot(
    sysdata: Any,
    *,
    quantity: WeightKind = "kappa",
    level: float = 0.95,
    Hz: bool = False,
    time_unit: str | None = None,
    gain_unit: str | None = None,
    label: str | Sequence[str] | None = None,
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Modes: a stem at each natural frequency, as high as its weight; with losses also the damping ratios.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other continuous-time system of python-control, or a `PEMResult`, which is
        drawn with its confidence intervals.
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
        Axes to draw on, one for each port, and with losses one more for the damping ratios.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the stems, `color`, `linestyle`, `linewidth`,
        as in `control.bode_plot`.

    Returns
    -------
    control.ControlPlot
        `lines`, of shape (m, 1), holds the heads of the stems of each system, with losses in a last row those of the
        damping ratios; `axes`, `figure`, `legend`.

    Raises
    ------
    NotLosslessError
        If a system is in discrete time.
    StructureError
        If the systems differ in their ports or the arguments are not of this form.

    Notes
    -----
    The scale of weights is logarithmic where they span more than three decades, that of frequencies beyond two.  Hollow
    heads are modes that no input reaches, and, of a fit, weights that the data do not show.  A pole at 0 has the weight
    `kappa_0` and stands at 0, or, where the scale is logarithmic, in the legend.

    With losses, `kappa` is that of the terms `kappa s / (s^2 + 2 zeta d s + d^2)` and `kappa / (s + d)` where these
    describe the mode, and its size where the residue `K` of the pole `p` has another phase: `|K (p - conj(p)) / p|`,
    of a real pole `|K|`.  Sensors have no part in it.  Poles that are not parted, as at critical damping, have a
    damping ratio but no weight of their own, and crosses in place of heads.

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.modes_plot(phc.modes([1.0, 2.0], [1.0, 0.25]))
    >>> plot.lines[0, 0][0].get_ydata()
    array([1. , 0.5])
    >>> plt.close(plot.figure)
    >>> plot = phc.modes_plot(phc.modes([1.0, 2.0], [1.0, 0.25], damping=[0.01, 0.02]))
    >>> plot.lines[0, 0][0].get_ydata().round(12), plot.lines[1, 0][0].get_ydata().round(12)
    (array([1. , 0.5]), array([0.01, 0.02]))
    >>> plt.close(plot.figure)
    """
    time_unit = unit_for(time_unit, sysdata)
    unit, unit_name = frequency_axis(Hz, time_unit)
    _checks.choice("quantity", quantity, get_args(WeightKind))
    subjects = subjects_of(sysdata, label)
    tables = [mode_table(subject, quantity, level) for subject in subjects]
    system = subjects[0].system
    ports = system.output_labels[: system.ninputs]
    lossy = any(table.damping is not None for table in tables)
    rows = len(ports) + lossy
    if quantity == "r":
        weight = labelled("Weight r", gain_unit)
    else:
        slope = f"({gain_unit})/{time_unit or 'time'}" if _checks.unit_text(gain_unit) else None
        weight = labelled("Residue κ = r d", slope)
    look = Look.of(style)
    with look.context():
        size = (6.4, 3.4 if rows == 1 else 2.2 * rows)
        drawn = picture(look, ax, (rows, 1), size, sharex=True)
        if lossy:
            # first, as axes share their limits, which those of the weights set
            drawn.lines[-1, 0] = _draw_damping(drawn.axes[-1, 0], tables, unit, look)
            look.lattice(drawn.axes[-1, 0])
        for port, axis in enumerate(drawn.axes[: len(ports), 0]):
            drawn.lines[port, 0] = _draw_modes(axis, tables, port, unit, look)
            look.lattice(axis)
            axis.set_ylabel(weight)
            if len(ports) > 1:
                axis.set_title(plain(f"Port {ports[port]}"), loc="left")
        drawn.axes[-1, 0].set_xlabel(labelled("Natural frequency", unit_name))
        return drawn.finished(title_of("Modes", subjects, label is not None))


@dataclass(frozen=True)
class ModeTable:
    """Modes of one system: weights `size`, shape (n, m), at `d`, shape (n,), and that of a pole at 0, shape (m,).

    Weights are NaN where poles are not parted.  `damping` has the ratios, shape (n,), of a system with losses.
    `d_range` and `size_range`, shape (n, 2), are confidence intervals: NaN where there is none, and infinite for what
    the data do not show.
    """

    label: str
    d: Array
    size: Array
    at_zero: Array
    d_range: Array
    size_range: Array
    level: float | None
    damping: Array | None = None


def mode_table(subject: Subject, quantity: str, level: float) -> ModeTable:
    """Modes of a system; of a fit, with intervals at a level."""
    modes = modes_of(subject.system)
    if not modes.is_lossless:
        return _damped_table(subject.label, modes, quantity)
    size = (modes.kappa if quantity == "kappa" else modes.r).reshape(len(modes.d), modes.nports)
    at_zero = np.atleast_2d(modes.kappa_0).diagonal() if quantity == "kappa" else np.zeros(modes.nports)
    if not is_fit(subject.given) or quantity not in subject.given.stderr:
        unknown = np.full((len(modes.d), 2), np.nan)
        return ModeTable(subject.label, modes.d, size, at_zero, unknown, unknown, None)
    intervals = subject.given.confidence_interval(level)
    ends = np.asarray(intervals["d"]), np.asarray(intervals[quantity])
    return ModeTable(subject.label, modes.d, size, at_zero, *ends, level)


def _damped_table(label: str, modes: Any, quantity: str) -> ModeTable:
    """Modes of a system with losses; poles that are 0 to rounding count as one at 0."""
    m, single = modes.nports, modes.single
    p = modes.mode_poles
    d, zeta = modes.natural_frequencies, modes.damping_ratios
    size = np.full((len(p), m), np.nan)
    parted = single.mode_poles
    pairs = np.where(parted.imag == 0, 1.0, 2.0 * np.abs(parted.imag) / np.maximum(np.abs(parted), _TINY))
    size[: len(parted)] = pairs[:, None] * np.abs(single.shapes[:, :m] * single.participation[:, :m])
    size[size <= _UNREACHED * np.nanmax(size, initial=0.0)] = 0.0
    still = d <= _STILL * d.max(initial=0.0)
    at_zero = np.nansum(size[still], axis=0)
    for block in modes.clusters:
        if (np.abs(block.poles) <= _STILL * d.max()).all():  # a free mass, whose position is not seen
            at_zero = at_zero + np.abs(np.diagonal((block.C @ block.B)[:m, :m]))
    at_zero = at_zero if quantity == "kappa" else np.zeros(m)
    d, zeta, size = d[~still], zeta[~still], size[~still]
    if quantity == "r":
        size = size / d[:, None]
    unknown = np.full((len(d), 2), np.nan)
    return ModeTable(label, d, size, at_zero, unknown, unknown, None, zeta)


def _draw_modes(axis: Axes, tables: list[ModeTable], port: int, unit: float, look: Look) -> list[Line2D]:
    size = np.concatenate([table.size[:, port] for table in tables])
    shown = size[size > 0]
    logarithmic = bool(len(shown)) and float(shown.max()) > _WIDE * float(shown.min())
    at_zero = max(float(table.at_zero[port]) for table in tables)
    _frequency_scale(axis, np.concatenate([table.d for table in tables]) / unit, at_zero > 0)
    bottom = float(10.0 ** np.floor(np.log10(shown.min()) - 0.3)) if logarithmic else 0.0
    lines = [_draw_stems(axis, k, table, port, unit, bottom, look) for k, table in enumerate(tables)]
    # above all weights, and above their intervals where these are not far longer
    largest = max(float(np.nanmax(size, initial=0.0)), at_zero) or 1.0
    ends = np.concatenate([table.size_range[:, 1] for table in tables])
    top = max(largest, min(float(ends[np.isfinite(ends)].max(initial=0.0)), 3.0 * largest))
    limits = (bottom, 2.0 * top) if logarithmic else (-0.03 * top, 1.08 * top)
    axis.set(yscale="log" if logarithmic else "linear", ylim=limits)
    return lines


def _frequency_scale(axis: Axes, d: Array, from_zero: bool) -> None:
    low, high = float(d.min(initial=np.inf)), float(d.max(initial=0.0))
    if len(d) and high > _DECADES * low:
        axis.set(xscale="log", xlim=(low / 1.5, high * 1.5))
    elif high > low > 0.5 * high and not from_zero:
        margin = max(0.1 * (high - low), 0.02 * high)
        axis.set_xlim(low - margin, high + margin)
    else:
        axis.set_xlim(-0.02 * (high or 1.0), 1.05 * (high or 1.0))


def _draw_stems(axis: Axes, k: int, table: ModeTable, port: int, unit: float, bottom: float, look: Look) -> Any:
    """Stems of one system with their heads, which are returned; intervals behind them."""
    d, size, on_zero = table.d / unit, table.size[:, port], table.at_zero[port]
    height, count = np.maximum(size, bottom), len(table.d)
    width = 1.2 if count <= _MANY_STEMS else 0.8 if count <= 5 * _MANY_STEMS else 0.3
    stem = {"linewidth": width, "linestyle": "-", "color": f"C{k}", **look.line}
    mark: dict[str, Any] = {"linestyle": "none", "marker": _MARKERS[k % 5], "color": stem["color"], "zorder": 3}
    head = {**mark, "markersize": 5.0 if count <= _MANY_STEMS else 3.0}
    axis.vlines(d, bottom, height, zorder=2, **stem)
    label = table.label
    if on_zero > 0 and axis.get_xscale() == "log":
        label += f" (and {on_zero:.3g} at 0)"
    elif on_zero > 0:
        axis.vlines([0.0], bottom, [on_zero], zorder=2, **stem)
        axis.plot([0.0], [on_zero], markersize=5.0, **mark)
    heads = axis.plot(d, height, label=plain(label), **head)[0]
    if np.isnan(size).any():
        cross = {**head, "marker": "x", "clip_on": False}
        together = d[np.isnan(size)]
        axis.plot(together, np.full(len(together), bottom), label="poles not parted: no weight of their own", **cross)
    hidden = (size == 0) | np.isinf(table.size_range[:, 1])
    if hidden.any():
        hollow = {**head, "markerfacecolor": "white", "zorder": 4, "clip_on": False}
        axis.plot(d[hidden], height[hidden], label="not reached, or not shown by the data", **hollow)
    if table.level is not None:
        reach = np.abs(table.size_range - table.size[:, :1]).T
        spread = np.abs(table.d_range / unit - d[:, None]).T
        yerr, xerr = (np.where(np.isfinite(half), half, 0.0) for half in (reach, spread))
        bars = axis.errorbar(
            d, height, yerr=yerr, xerr=xerr, fmt="none", ecolor=stem["color"], elinewidth=2.2 * stem["linewidth"],
            capsize=3.0, alpha=0.45, zorder=2.5, label=f"{100 * table.level:g} % intervals",
        )  # fmt: skip
        bars.has_xerr = False  # for the legend, where two short bars that cross are a blot
    return heads


def _draw_damping(axis: Axes, tables: list[ModeTable], unit: float, look: Look) -> list[Line2D]:
    """Damping ratios of all systems over frequency; those of lossless ones are 0."""
    from_zero = any((table.at_zero > 0).any() for table in tables)
    _frequency_scale(axis, np.concatenate([table.d for table in tables]) / unit, from_zero)
    lines, ratios = [], [np.zeros(len(table.d)) if table.damping is None else table.damping for table in tables]
    for k, (table, zeta) in enumerate(zip(tables, ratios, strict=True)):
        style = {"color": f"C{k}", **look.line}
        axis.vlines(table.d / unit, 0.0, zeta, zorder=2, linewidth=1.2, color=style["color"])
        head: dict[str, Any] = {"marker": _MARKERS[k % 5], "markersize": 5.0 if len(zeta) <= _MANY_STEMS else 3.0}
        lines += axis.plot(table.d / unit, zeta, linestyle="none", color=style["color"], zorder=3, label="_", **head)
    every = np.concatenate(ratios)
    shown = every[every > 0]
    if len(shown) == len(every) > 0 and shown.max() > _WIDE * shown.min():
        axis.set(yscale="log", ylim=(shown.min() / 2.0, 2.0 * shown.max()))
    else:
        low, high = min(float(every.min(initial=0.0)), 0.0), float(every.max(initial=0.0))
        span = high - low or 1.0
        axis.set_ylim(low - 0.03 * span, high + 0.08 * span)
    axis.set_ylabel("Damping ratio [%]")
    axis.yaxis.set_major_formatter(lambda ratio, _: f"{100 * ratio:g}")
    return lines


# --- poles and zeros -------------------------------------------------------------------------------------------------


def pole_zero_plot(
    sysdata: Any,
    *,
    Hz: bool = False,
    time_unit: str | None = None,
    label: str | Sequence[str] | None = None,
    ax: AxesGiven = None,
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
    subjects = subjects_of(sysdata, label)
    if len({subject.system.isdtime(strict=True) for subject in subjects}) > 1:
        raise StructureError("continuous-time and discrete-time poles are in different planes; draw them apart")
    maps = [pole_zero_map(subject) for subject in subjects]
    look = Look.of(style, MarkStyle)
    with look.context():
        if all(chart.on_axis for chart in maps):
            drawn = _draw_strips(ax, maps, unit, unit_name, look)
        else:
            drawn = picture(look, ax, (1, 1), (5.6, 4.8))
            drawn.lines[0, 0] = _draw_plane(drawn.axes[0, 0], maps, unit, unit_name, look)
        return drawn.finished(title_of("Poles and zeros", subjects, label is not None))


@dataclass(frozen=True)
class PoleZeroMap:
    """Poles and zeros of one system; `on_axis` if all of them are on the imaginary axis."""

    label: str
    poles: ComplexArray
    zeros: ComplexArray
    on_axis: bool
    discrete: bool
    ports: int = 1

    @property
    def upper(self) -> tuple[Array, Array]:
        """Imaginary parts of poles and zeros on the upper half of the axis, 0 included, ascending."""
        w, z = np.sort(self.poles.imag), np.sort(self.zeros.imag)
        return w[w >= 0], z[z >= 0]

    @property
    def cancelled(self) -> int:
        """Number of poles on the upper half of the axis that a zero lies on."""
        return int(np.isin(*self.upper).sum())

    @property
    def alternating(self) -> bool:
        """Whether poles and zeros alternate on the upper half of the axis, as those of a lossless one-port do."""
        poles, zeros = self.upper
        places = np.concatenate([poles, zeros])
        kinds = np.repeat([True, False], [len(poles), len(zeros)])[np.argsort(places, kind="stable")]
        return bool(len(np.unique(places)) == len(places) and (kinds[1:] != kinds[:-1]).all())

    @property
    def counts(self) -> list[str]:
        """How many there are and, of one port, how they lie; those of several ports need not alternate."""
        poles, zeros = map(counted, map(len, self.upper), ("pole", "zero"))
        if self.ports != 1:
            return [poles, zeros]
        order = "alternating" if self.alternating else "not alternating"
        return [poles, f"{zeros}, {f'{self.cancelled} cancelled' if self.cancelled else order}"]


def pole_zero_map(subject: Subject) -> PoleZeroMap:
    """Poles and zeros of a system."""
    sys, label = subject.system, subject.label
    if subject.lossless and not sys._integrated:
        # those of the transfer function: the matrices have 0 twice where a mass is free, and show one of them
        return PoleZeroMap(label, sys.modes.poles, sys.modes.zeros, True, False, sys.ninputs)
    try:
        zeros = invariant_zeros(sys) if type(sys) is ct.StateSpace else sys.zeros()
        poles, zeros = poles_of(sys), np.asarray(zeros, complex)
    except NotImplementedError as error:
        raise StructureError(f"{label}: {error} Convert the system with control.ss") from None
    points = np.concatenate([poles, zeros])
    discrete = bool(sys.isdtime(strict=True))
    near = np.abs(points.real) <= _ON_AXIS * np.abs(points).max(initial=0.0)
    return PoleZeroMap(label, poles, zeros, bool(near.all()) and not discrete, discrete, sys.ninputs)


def strips(maps: Sequence[PoleZeroMap], count: int | None = None) -> list[tuple[float, float]]:
    """Frequency ranges that hold equally many poles each, few enough to be told apart; `count` of them if given."""
    poles = np.sort(np.concatenate([chart.upper[0] for chart in maps]))
    marks = np.sort(np.concatenate([poles, *(chart.upper[1] for chart in maps)]))
    if not len(marks):
        return [(0.0, 1.0)] * (count or 1)
    if count is None:
        count = min(max(1, -(-max(len(chart.upper[0]) for chart in maps) // _POLES_IN_STRIP)), _STRIPS)
    low, high = float(marks[0]), float(marks[-1])
    # from 0 on, unless all are far from it
    inner = [low if low > 0.3 * high else 0.0, *_cuts(marks, poles, count), high]
    least = 0.1 * high or 1.0
    margins = [0.03 * (inner[1] - inner[0]) or least, 0.03 * (inner[-1] - inner[-2]) or least]
    return list(itertools.pairwise([inner[0] - margins[0], *inner[1:-1], high + margins[1]]))


def _cuts(marks: Array, poles: Array, count: int) -> list[float]:
    """Where to part the axis: below poles that leave about equally many in each strip, in the middle of wide gaps."""
    cuts: list[float] = []
    spread = len(poles) // (6 * count)
    for target in np.arange(1, count) * len(poles) // count:
        near = poles[max(1, target - spread) : target + spread + 1]
        below = np.array([marks[marks < w].max(initial=0.0) for w in near])
        if len(near):
            widest = int(np.argmax(near - below))
            cuts.append(0.5 * float(below[widest] + near[widest]))
    return sorted(set(cuts))


def _draw_strips(ax: AxesGiven, maps: list[PoleZeroMap], unit: float, unit_name: str, look: Look) -> Picture:
    given = None if ax is None else np.asarray(ax, object).size
    ranges = strips(maps, None if given is None else max(1, given))
    if given is not None and given > len(ranges):
        raise StructureError(f"ax has {given} axes, but there are poles for {len(ranges)} only; pass as many")
    height = 0.55 + (0.35 if len(maps) == 1 else 0.45) * len(maps)
    drawn = picture(look, ax, (len(ranges), 1), (7.2, 1.0 + len(ranges) * height))
    for row, (axis, (low, high)) in enumerate(zip(drawn.axes[:, 0], ranges, strict=True)):
        drawn.lines[row, 0] = []
        for k, chart in enumerate(maps):
            drawn.lines[row, 0] += _draw_row(axis, chart, -k, (low, high), unit, look.line, len(maps) > 1)
        _strip_axis(axis, maps, low / unit, high / unit, drawn.lines[row, 0])
        if look.grid:
            axis.grid(True, axis="x", linewidth=0.5, alpha=0.6)
    drawn.axes[-1, 0].set_xlabel(labelled("Imaginary part, upper half", unit_name))
    return drawn


def _draw_row(
    axis: Axes,
    chart: PoleZeroMap,
    height: int,
    ends: tuple[float, float],
    unit: float,
    line: dict[str, Any],
    named: bool,
) -> list[Line2D]:
    axis.axhline(height, **_AXIS)
    low, high = ends
    poles, zeros = (w[(w >= low) & (w < high)] / unit for w in chart.upper)
    labels = chart.counts
    if named:
        corner: dict[str, Any] = {"ha": "right", "va": "bottom", "fontsize": "x-small", "color": "0.35"}
        axis.text(1.0, height + 0.16, ", ".join(labels), transform=axis.get_yaxis_transform(), **corner)
        labels = ["poles", "zeros"] if height == 0 else ["_", "_"]
    # smaller where they are many
    share = 1.0 if len(poles) <= _MANY else max(0.4, 0.75 * min(1.0, (3 * _MANY / len(poles)) ** 0.5))
    lines = []
    for places, style, label, colour in ((poles, _POLE, labels[0], "C0"), (zeros, _ZERO, labels[1], "C1")):
        edge = style["markeredgewidth"] * (1.0 if share >= 0.75 else 0.5)
        sizes = {"markersize": share * style["markersize"], "markeredgewidth": edge}
        properties = {"color": colour, **line, **style, **sizes}
        lines += axis.plot(places, np.full(len(places), height), label=plain(label), **properties)
    return lines


def _strip_axis(axis: Axes, maps: list[PoleZeroMap], low: float, high: float, lines: list[Any]) -> None:
    marks = np.concatenate([line.get_xdata() for line in lines])
    positive = marks[marks > 0]
    if len(positive) and positive.max() > _DECADES * positive.min():
        # 0 has no place on this scale but its end
        end = float(positive.min()) / 2.0
        axis.set(xscale="log", xlim=(end, high))
        for line in lines:
            x = np.asarray(line.get_xdata(), float)
            if (x == 0).any():
                line.set_xdata(np.where(x == 0, end, x))
                line.set_clip_on(False)
                place: dict[str, Any] = {"xytext": (0, 8), "textcoords": "offset points"}
                axis.annotate("0", (end, line.get_ydata()[0]), **place, ha="center", fontsize="small")
    else:
        axis.set_xlim(low, high)
    axis.set_ylim(-len(maps) + 0.35, 0.65)
    several = len(maps) > 1
    axis.set_yticks(-np.arange(len(maps)) if several else [], [plain(chart.label) for chart in maps] if several else [])
    axis.spines[["left", "right", "top"]].set_visible(False)


def _draw_plane(axis: Axes, maps: list[PoleZeroMap], unit: float, unit_name: str, look: Look) -> list[Line2D]:
    lines: list[Line2D] = []
    discrete = maps[0].discrete
    scale = 1.0 if discrete else unit
    axis.axhline(0.0, **_AXIS)
    axis.axvline(0.0, **_AXIS)
    if discrete:
        angle = np.linspace(0.0, 2 * np.pi, 361)
        axis.plot(np.cos(angle), np.sin(angle), label="_", **_AXIS)
        axis.set_aspect("equal")
    for k, chart in enumerate(maps):
        for points, what, style in ((chart.poles, "poles", _POLE), (chart.zeros, "zeros", _ZERO)):
            shown = points[np.isfinite(points)] / scale
            label = f"{chart.label}: {what}" if len(maps) > 1 else what
            properties = {"color": f"C{k}", **look.line, **style}
            lines += axis.plot(shown.real, shown.imag, label=plain(label), **properties)
    axis.margins(0.08)
    look.lattice(axis)
    name = None if discrete else unit_name
    axis.set(xlabel=labelled("Real part", name), ylabel=labelled("Imaginary part", name))
    return lines

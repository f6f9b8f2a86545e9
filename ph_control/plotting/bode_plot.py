"""Bode plots: numbers first, then matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from .._types import Array
from .._units import unit_for
from ..analysis.margins import margin
from ..exceptions import StructureError
from .bode_data import BodeData, bode_data
from .style import (
    BAND,
    DOTS,
    LineStyle,
    Look,
    PlainLogFormatter,
    frequency_axis,
    gain_label,
    labelled,
    picture,
    plain,
    told_gain_unit,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

_MANY = 50  # poles and zeros
_NARROW = 100.0  # ratio of the ends of the frequency axis below which its labels are plain numbers
_CROWD_BELOW = 2.0  # place among what is drawn, above the grid

_PALE_DOTS: dict[str, Any] = {**DOTS, "markersize": 2.5, "color": "0.78", "zorder": 2.1}
_LIMIT: dict[str, Any] = {"color": "0.3", "linestyle": ":", "linewidth": 1.0}
_MARGIN: dict[str, Any] = {"linestyle": "-", "linewidth": 1.8, "zorder": 2.8}


def bode_plot(
    sysdata: Any,
    omega: ArrayLike | None = None,
    *,
    data: ct.TimeResponseData | ct.FrequencyResponseData | None = None,
    segments: int = 8,
    intersample: str = "zoh",
    confidence: Any = None,
    level: float = 0.95,
    omega_limits: ArrayLike | None = None,
    omega_num: int | None = None,
    Hz: bool = False,
    dB: bool = True,
    deg: bool = True,
    plot_magnitude: bool = True,
    plot_phase: bool = True,
    wrap_phase: bool = False,
    display_margins: bool = False,
    time_unit: str | None = None,
    gain_unit: str | None = None,
    label: str | Sequence[str] | None = None,
    data_label: str | None = None,
    ax: Any = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Bode plot that shows every resonance and antiresonance, and measurements with it.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other LTI system of python-control, `control.FrequencyResponseData`; a
        `PEMResult` stands for the response of the quantity that was measured: that of its `observed_system`, on the
        `background` of a fit to a response.
    omega : array_like, shape (N,), optional
        Angular frequencies, rad per unit time, ascending and positive; two of them are limits.  By default every pole
        and zero of the systems is resolved.
    data : control.TimeResponseData or control.FrequencyResponseData, optional
        Measurement to draw as dots: a record, of which `spectral_estimate` is made, or a frequency response; also the
        `record` of a `PEMResult`.
    segments, intersample
        As in `spectral_estimate`.
    confidence : PEMResult or ModalSamples, or list of them, or True, optional
        Whose `magnitude_band` and `phase_band` to shade around the first system, or around each; True stands for the
        results of `pem` among the systems.  Such a result draws 300 models, always the same.
    level : float
        Share of these models inside the band, between 0 and 1.
    omega_limits : array_like, shape (2,), optional
        Ends of the frequency axis, in Hz if `Hz` is true, otherwise in rad per unit time.
    omega_num : int, optional
        Number of frequencies between the ends; those around poles and zeros come on top.
    Hz : bool
        Frequency axis in Hz instead of rad per unit time; where no unit of time is known, times are taken for seconds.
    dB, deg : bool
        Magnitude in decibels instead of to a logarithmic scale, phase in degrees instead of radians.
    plot_magnitude, plot_phase : bool
        Which of the two to draw.
    wrap_phase : bool
        Phases between -180 and 180 degrees instead of continuous ones.
    display_margins : bool
        Whether to draw the phase margin and a finite gain margin of each system of one port, and to tell both.
    time_unit : str, optional
        Unit of time, for the labels of frequencies; by default that of the measurement or the fit, none where it is not
        known.
    gain_unit : str, optional
        Unit of the response, output over input, such as "m/s/N"; the magnitude is in dB re 1 of it.  By default that
        of names such as "force [N]" where all channels of the first system, or of the measurement, have one.
    label : str or sequence of str, optional
        Legend entries of the systems; by default their names, and "model" for a single `PortHamiltonian` without one.
    data_label : str, optional
        Legend entry of the measurement.
    ax : array of matplotlib.axes.Axes, shape (2p, m), optional
        Axes to draw on, magnitude above phase for each of p outputs and m inputs.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the curves, `color`, `linestyle`, `linewidth`,
        as in `control.bode_plot`; the title is made of the names of the systems, or else of the channels.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2p, m), or (p, m) with one of magnitude and phase; `figure`, `legend`.

    Raises
    ------
    StructureError
        If the systems differ in their ports, the frequencies are not usable, or the measurement or what `confidence`
        holds is not, for `Hz` with a `time_unit` that is no unit of time, or for `display_margins` with several ports.

    Notes
    -----
    At its poles and zeros on the imaginary axis a lossless response is infinite or zero: the curve runs off the
    picture there, and at frequencies of your own, which may straddle a peak, it breaks.  The phase of a one-port is
    exactly +90 or -90 degrees, and steps.  A response that is zero throughout has no curve, and the legend says so.

    Where poles and zeros are closer than the dots of a picture, their curve is pale, and its median over frequency is
    drawn and named in the legend; `omega_limits` take them apart.

    The phase of systems is continuous; that of a measurement is within half a turn of the first system.  Dots of a
    record are pale where the coherence is below one half; those of a held input leave a continuous-time curve near the
    Nyquist frequency even without noise, mostly upwards, because sampling folds the response.  Of measured responses
    the range of the picture leaves out a lone point 40 dB beyond all others.

    Nyquist frequencies are marked: of a record, of discrete-time systems and of discrete-time frequency responses.

    O(n) for each frequency, and 6 to 60 frequencies for each pole and zero in the picture; a band, that for each of
    its models.

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.bode_plot(phc.frenkel_kontorova(name="chain"))
    >>> plot.axes[0, 0].get_ylabel(), plot.axes[1, 0].get_ylabel(), plot.axes[1, 0].get_xlabel()
    ('Magnitude [dB]', 'Phase [deg]', 'Frequency [rad/time]')
    >>> plt.close(plot.figure)
    """
    look = Look.of(style)
    unit, unit_name = frequency_axis(Hz, unit_for(time_unit, sysdata, data))
    _checks.flags(
        dB=dB, deg=deg, plot_magnitude=plot_magnitude, plot_phase=plot_phase, wrap_phase=wrap_phase,
        display_margins=display_margins,
    )  # fmt: skip
    rows = [name for name, wanted in (("magnitude", plot_magnitude), ("phase", plot_phase)) if wanted]
    if not rows:
        raise StructureError("plot_magnitude and plot_phase are both False; there is nothing to draw")
    numbers = bode_data(
        sysdata, omega, data, segments=segments, intersample=intersample, omega_limits=omega_limits,
        omega_num=omega_num, unit=unit, confidence=confidence, level=level, label=label, data_label=data_label,
    )  # fmt: skip
    outputs, inputs, kinds = len(numbers.output_labels), len(numbers.input_labels), len(rows)
    if display_margins and (outputs, inputs) != (1, 1):
        raise StructureError(
            f"margins are those of one port; the systems have {outputs} outputs and {inputs} inputs: draw the loop "
            "sys[i, j]"
        )
    height = 1.6 + 1.6 * kinds if outputs == 1 else 1.9 * kinds * outputs
    meaning = "magnitude above phase for each output" if kinds == 2 else ""
    with look.context():
        drawn = picture(
            look, ax, (kinds * outputs, inputs), (max(6.4, 3.8 * inputs), height), meaning=meaning, sharex=True
        )
        for (row, j), axis in np.ndenumerate(drawn.axes):
            if rows[row % kinds] == "magnitude":
                drawn.lines[row, j] = _draw_magnitudes(axis, numbers, row // kinds, j, unit, look, dB)
            else:
                drawn.lines[row, j] = _draw_phases(axis, numbers, row // kinds, j, unit, look, deg, wrap_phase)
            _draw_limits(axis, [limit / unit for limit in numbers.nyquist], unit_name)
            look.lattice(axis, minor="x")
        gain_unit = told_gain_unit(numbers, data) if gain_unit is None else gain_unit
        gain = gain_label(gain_unit) if dB else labelled("Magnitude", gain_unit)
        phase = "Phase [deg]" if deg else "Phase [rad]"
        _label_axes(drawn.axes, numbers, unit, unit_name, [gain if kind == "magnitude" else phase for kind in rows])
        if display_margins:
            panels = dict(zip(rows, drawn.axes[:, 0], strict=True))
            _draw_margins(panels, numbers, drawn.lines[0, 0], unit, unit_name, dB, deg)
        # a curve that is nowhere must at least be told
        legend = look.legend(drawn.axes[0, -1], 1 if any(curve.vanishes for curve in numbers.curves) else 2)
        return drawn.finished(numbers.title, legend)


def _draw_magnitudes(
    axis: Axes, numbers: BodeData, i: int, j: int, unit: float, look: Look, decibels: bool
) -> list[Any]:
    def scaled(level: Array) -> Array:
        return level if decibels else 10.0 ** (level / 20.0)

    levels = [scaled(curve.magnitude(i, j)) for curve in numbers.curves]
    bands = [None if curve.band is None else scaled(curve.band.magnitude) for curve in numbers.curves]
    dots = None if numbers.measured is None else scaled(numbers.measured.magnitude(i, j))
    lines = _draw_panel(axis, numbers, levels, bands, dots, unit, look, medians=True)
    everything = numbers.curves if numbers.measured is None else [*numbers.curves, numbers.measured]
    values = np.concatenate([curve.shown(i, j, numbers.low, numbers.high) for curve in everything])
    if not decibels:
        axis.set_yscale("log")
    if len(values):
        margin = 5.0 + 0.05 * np.ptp(values)
        axis.set_ylim(*scaled(np.array([values.min() - margin, values.max() + margin])))
    if decibels:
        axis.yaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 4, 5, 10]))
    return lines


def _draw_phases(
    axis: Axes, numbers: BodeData, i: int, j: int, unit: float, look: Look, degrees: bool, wrap: bool
) -> list[Any]:
    size, first, measured = 1.0 if degrees else np.pi / 180.0, numbers.curves[0], numbers.measured
    phases = [size * curve.phase(i, j, unwrap=not wrap) for curve in numbers.curves]
    bands = [None if curve.band is None else size * curve.phase_band(i, j, unwrap=not wrap) for curve in numbers.curves]
    dots = None
    if measured is not None:
        dots = size * (measured.phase(i, j, unwrap=False) if wrap else measured.phase_near(i, j, first))
    lines = _draw_panel(axis, numbers, phases, bands, dots, unit, look)
    values = np.concatenate([*phases, [] if dots is None else dots]) / size
    low, high = min(-90.0, float(np.nanmin(values, initial=0.0))), max(90.0, float(np.nanmax(values, initial=0.0)))
    step = 90.0 if high - low <= 450.0 else 180.0
    axis.set_ylim(size * (low - 0.25 * step), size * (high + 0.25 * step))
    if high - low <= 1440.0:
        axis.yaxis.set_major_locator(MultipleLocator(size * step))
        axis.yaxis.set_minor_locator(MultipleLocator(size * step / 2.0))
    if not degrees:
        axis.yaxis.set_major_formatter(lambda value, _: f"{value / np.pi:g}π" if value else "0")
    return lines


def _draw_panel(
    axis: Axes, numbers: BodeData, values: list[Array], bands: list[Array | None], dots: Array | None, unit: float,
    look: Look, medians: bool = False,
) -> list[Any]:  # fmt: skip
    """Curves, medians where they close to a block, bands around them, and the measurement; lines of all but bands."""
    lines: list[Any] = []
    for k, (curve, value) in enumerate(zip(numbers.curves, values, strict=True)):
        label = plain(f"{curve.label}: zero" if curve.vanishes else curve.label)
        properties, breaks, crowds = look.curve(k), curve.gaps(), curve.crowds(numbers.low, numbers.high)
        if len(breaks):
            # what stands between two breaks is no line
            properties |= {"marker": ".", "markersize": 4.0}
        if len(curve.singular) > _MANY and "linewidth" not in look.line:
            # many resonances are told apart by thinner lines only
            properties["linewidth"] = 0.7
        if crowds:
            properties["zorder"] = _CROWD_BELOW
        omega = np.insert(curve.omega, breaks, np.nan) / unit
        lines += axis.plot(omega, np.insert(value, breaks, np.nan), label=label, **properties)
        # a block is pale, and nothing else: above such curves, below all others
        for start, end in crowds:
            pale: dict[str, Any] = {"color": axis.get_facecolor(), "alpha": 0.7, "linewidth": 0.0}
            axis.axvspan(start / unit, end / unit, zorder=_CROWD_BELOW + 0.05, **pale)
    for curve, value, ends, line in zip(numbers.curves, values, bands, lines, strict=True):
        omega, middle = curve.typical(value, numbers.low, numbers.high)
        if medians and len(omega):
            label = plain(f"{curve.label}: median where resonances are closer than dots")
            axis.plot(omega / unit, middle, label=label, color=line.get_color(), linewidth=1.6, zorder=3.1)
        if curve.band is not None and ends is not None:
            label = plain(curve.band.label)
            axis.fill_between(curve.band.omega / unit, *ends, label=label, color=line.get_color(), **BAND)
    if numbers.measured is not None and dots is not None:
        omega, doubtful = numbers.measured.omega / unit, numbers.measured.doubtful
        lines += axis.plot(omega[~doubtful], dots[~doubtful], label=plain(numbers.measured.label), **DOTS)
        if doubtful.any():
            lines += axis.plot(omega[doubtful], dots[doubtful], label="coherence below 0.5", **_PALE_DOTS)
    return lines


def _draw_limits(axis: Axes, limits: list[float], unit_name: str) -> None:
    values = ", ".join(f"{limit:.4g}" for limit in limits)
    for k, limit in enumerate(limits):
        label = "_" if k else plain(f"Nyquist frequency ({values} {unit_name})")
        axis.axvline(limit, label=label, zorder=1, **_LIMIT)


def _draw_margins(
    panels: dict[str, Axes], numbers: BodeData, lines: list[Any], unit: float, unit_name: str, dB: bool, deg: bool
) -> None:
    """Distances from -180 degrees where the gain is 1, and from a gain of 1 where the phase is -180 degrees."""
    size = 1.0 if deg else np.pi / 180.0
    texts = []
    for system, curve, line in zip(numbers.systems, numbers.curves, lines[: len(numbers.curves)], strict=True):
        gm, pm, wcg, wcp = margin(system)
        style = {"label": "_", "color": line.get_color(), **_MARGIN}
        decibels = 20.0 * np.log10(gm) if gm else -np.inf
        if "phase" in panels and np.isfinite(pm):
            # the phase of the curve may be whole turns away
            at = np.interp(wcp, curve.omega, curve.phase(0, 0))
            critical = -180.0 + 360.0 * np.round((at - (pm - 180.0)) / 360.0)
            low, high = panels["phase"].get_ylim()
            panels["phase"].set_ylim(min(low, size * (critical - 20.0)), max(high, size * (critical + 20.0)))
            panels["phase"].axhline(size * critical, **_LIMIT)
            panels["phase"].plot([wcp / unit] * 2, [size * critical, size * (critical + pm)], **style)
        if "magnitude" in panels:
            panels["magnitude"].axhline(0.0 if dB else 1.0, **_LIMIT)
            if np.isfinite(decibels):
                panels["magnitude"].plot([wcg / unit] * 2, [-decibels, 0.0] if dB else [1.0 / gm, 1.0], **style)
        gain = f"{decibels:.4g} dB at {wcg / unit:.4g} {unit_name}" if np.isfinite(decibels) else f"{decibels:g}"
        phase = f"{pm:.4g}° at {wcp / unit:.4g} {unit_name}" if np.isfinite(pm) else f"{pm:g}"
        name = f"{curve.label}: " if len(numbers.curves) > 1 else ""
        texts.append(plain(f"{name}gain margin {gain}, phase margin {phase}"))
    axis = next(iter(panels.values()))
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    axis.text(0.01, 0.02, "\n".join(texts), transform=axis.transAxes, fontsize="x-small", zorder=4, bbox=box)


def _label_axes(axes: NDArray[Any], numbers: BodeData, unit: float, unit_name: str, quantities: list[str]) -> None:
    for (row, j), axis in np.ndenumerate(axes):
        i, kind = divmod(row, len(quantities))
        axis.set_xscale("log")
        axis.set_xlim(numbers.low / unit, numbers.high / unit)
        if numbers.high < _NARROW * numbers.low:
            axis.xaxis.set_major_formatter(PlainLogFormatter())
            axis.xaxis.set_minor_formatter(PlainLogFormatter(labelOnlyBase=False))
        if j == 0:
            axis.set_ylabel(quantities[kind])
        if row == len(axes) - 1:
            axis.set_xlabel(labelled("Frequency", unit_name))
        if axes.size > len(quantities) and kind == 0:
            axis.set_title(plain(f"{numbers.input_labels[j]} to {numbers.output_labels[i]}"), loc="left")

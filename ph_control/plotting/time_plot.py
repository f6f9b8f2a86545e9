"""Pictures of responses to a step and an impulse."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from numpy.typing import ArrayLike, NDArray

from .._units import unit_for
from .style import BAND, DOTS, ZERO, LineStyle, Look, extremes, labelled, picture, plain
from .time_data import Trace, TransientData, transient_data

if TYPE_CHECKING:
    from typing_extensions import Unpack

Array = NDArray[np.float64]

_ENVELOPE: dict[str, Any] = {"linewidth": 0.6, "zorder": 1.2, "hatch": "////"}


def step_plot(
    sysdata: Any, timepts: ArrayLike | None = None, *, timepts_num: int | None = None,
    data: ct.TimeResponseData | None = None, confidence: Any = None, level: float = 0.95, time_unit: str | None = None,
    output_unit: str | None = None, label: str | Sequence[str] | None = None, data_label: str | None = None,
    ax: Any = None, **style: Unpack[LineStyle],
) -> ct.ControlPlot:  # fmt: skip
    """Responses to a unit step, in which no motion is lost between samples.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other LTI system of python-control; a `PEMResult` stands for its `system`.
    timepts : array_like, shape (T,), or a number
        Instants, or the last one.  By default 3 periods of the slowest mode, or as long as was measured, and 20 samples
        in the shortest period.
    timepts_num : int, optional
        Number of instants.
    data : control.TimeResponseData, optional
        Measured response to a unit step, one trace for each input, to draw as dots.
    confidence : PEMResult or ModeSamples, or list of them, or True, optional
        Whose `step_band` to shade around the first system, or around each; True stands for the results of `pem` among
        the systems.  Such a result draws 300 models, always the same.
    level : float
        Share of these models inside the band, between 0 and 1.
    time_unit, output_unit : str, optional
        Units, for the labels; by default of time that of the measurement or the fit, none where it is not known.
    label : str or sequence of str, optional
        Legend entries of the systems; by default their names, and "model" for a single `PortHamiltonian` without one.
    data_label : str, optional
        Legend entry of the measurement.
    ax : array of matplotlib.axes.Axes, shape (p, m), optional
        Axes to draw on, outputs below one another, inputs side by side.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams` and, for the curves, `color`, `linestyle`, `linewidth`,
        as in `control.time_response_plot`; the title is made of the names of the systems.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (p, m), `figure`, `legend`.

    Raises
    ------
    StructureError
        If the systems differ in their ports, the instants or the data are not usable, or `confidence` holds no models,
        or its band is asked for at instants that do not resolve every mode.

    Notes
    -----
    Modes of which the instants hold fewer than 8 samples a period are not sampled, which would show slower motions that
    are not there, but drawn as the envelope that they fill, and the legend says which; with instants of your own the
    samples are dots.  Lossless systems in plain form are recognised; of other systems that are too fast for 50 000
    samples the beginning is drawn.  A band of more than 2e7 terms is drawn for the beginning, and the legend says
    how far.

    Responses of lossless systems are exact: O(n T), and for a band that times the number of models.

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.step_plot(phc.frenkel_kontorova(name="chain"), output_unit="m/s")
    >>> plot.axes[0, 0].get_ylabel(), plot.axes[0, 0].get_xlabel(), plot.figure.get_suptitle()
    ('v [m/s]', 'Time', 'Step response of chain')
    >>> plt.close(plot.figure)
    """
    look = Look.of(style)
    numbers = transient_data(
        sysdata, "step", timepts, timepts_num,
        confidence=confidence, level=level, data=data, label=label, data_label=data_label,
    )  # fmt: skip
    return _draw(numbers, look, unit_for(time_unit, sysdata, data), output_unit, ax)


def impulse_plot(
    sysdata: Any, timepts: ArrayLike | None = None, *, timepts_num: int | None = None,
    data: ct.TimeResponseData | None = None, confidence: Any = None, level: float = 0.95, time_unit: str | None = None,
    output_unit: str | None = None, label: str | Sequence[str] | None = None, data_label: str | None = None,
    ax: Any = None, **style: Unpack[LineStyle],
) -> ct.ControlPlot:  # fmt: skip
    """Responses to a unit impulse, in which no motion is lost between samples.

    Parameters
    ----------
    sysdata, timepts, timepts_num, data, confidence, level, time_unit, output_unit, label, data_label, ax, **style
        As in `step_plot`, for a unit impulse; the band is the `impulse_band` of the models.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (p, m), `figure`, `legend`.

    Raises
    ------
    StructureError
        As `step_plot`.

    Notes
    -----
    Cost and accuracy as `step_plot`.

    Examples
    --------
    >>> import ph_control as phc
    >>> import matplotlib.pyplot as plt
    >>> plot = phc.impulse_plot(phc.modes([1.0, 3.0], [1.0, 1.0]))
    >>> float(plot.lines[0, 0][0].get_ydata()[0])
    4.0
    >>> plt.close(plot.figure)
    """
    look = Look.of(style)
    numbers = transient_data(
        sysdata, "impulse", timepts, timepts_num,
        confidence=confidence, level=level, data=data, label=label, data_label=data_label,
    )  # fmt: skip
    return _draw(numbers, look, unit_for(time_unit, sysdata, data), output_unit, ax)


def _draw(
    numbers: TransientData, look: Look, time_unit: str | None, output_unit: str | None, ax: Any
) -> ct.ControlPlot:  # fmt: skip
    rows, columns = len(numbers.output_labels), len(numbers.input_labels)
    with look.context():
        size = (max(6.4, 3.8 * columns), 3.4 if rows == 1 else 2.2 * rows)
        drawn = picture(look, ax, (rows, columns), size, sharex=True)
        for (i, j), axis in np.ndenumerate(drawn.axes):
            drawn.lines[i, j] = _draw_responses(axis, numbers, i, j, look)
            axis.axhline(0.0, **ZERO)
            axis.set_xlim(0.0, numbers.end)
            look.lattice(axis)
        for axis, label in zip(drawn.axes[:, 0], numbers.output_labels, strict=True):
            axis.set_ylabel(labelled(label, output_unit))
        for axis, label in zip(drawn.axes[0], numbers.input_labels * (columns > 1), strict=False):
            axis.set_title(plain(f"From {label}"), loc="left")
        for axis in drawn.axes[-1]:
            axis.set_xlabel(labelled("Time", time_unit))
        # an envelope must be told apart from a response
        alone = all(trace.resolved and trace.joined for trace in numbers.traces)
        legend = look.legend(drawn.axes[0, -1], 2 if alone else 1)
        return drawn.finished(numbers.title, legend)


def _draw_responses(axis: Axes, numbers: TransientData, i: int, j: int, look: Look) -> list[Any]:
    lines: list[Any] = []
    for k, (trace, band) in enumerate(zip(numbers.traces, numbers.bands, strict=True)):
        line = _draw_trace(axis, trace, i, j, look.curve(k))
        lines.append(line)
        if not trace.resolved:
            _draw_envelope(axis, trace, i, j, line.get_color())
        if band is not None:
            t, low = extremes(band.time, band.ends[0])
            other, high = extremes(band.time, band.ends[1])
            # the two ends may be thinned at instants of their own
            both = np.union1d(t, other)
            low, high = np.interp(both, t, low), np.interp(both, other, high)
            axis.fill_between(both, low, high, label=plain(band.label), color=line.get_color(), **BAND)
    if numbers.measured is not None:
        t, y = extremes(numbers.measured.time, numbers.measured.values[i, j])
        lines += axis.plot(t, y, label=plain(numbers.measured.label), zorder=2.2, **DOTS)
    return lines


def _draw_trace(axis: Axes, trace: Trace, i: int, j: int, style: dict[str, Any]) -> Any:
    label = plain(trace.label)
    if not trace.joined:
        dots = {**style, "linestyle": "none", "marker": ".", "markersize": 4.0}
        return axis.plot(trace.time, trace.values[i, j], label=f"{label} (samples)", **dots)[0]
    if trace.sampled:
        style = {**style, "drawstyle": "steps-post", "linestyle": "-", "linewidth": 1.0}
    return axis.plot(*extremes(trace.time, trace.values[i, j]), label=label, **style)[0]


def _draw_envelope(axis: Axes, trace: Trace, i: int, j: int, colour: Any) -> None:
    t, slow = extremes(trace.time, trace.slow[i, j])
    reach = trace.reach[i, j]
    shade: dict[str, Any] = {"facecolor": to_rgba(colour, 0.12), "edgecolor": to_rgba(colour, 0.45)}
    axis.fill_between(t, slow - reach, slow + reach, label=plain(trace.warning), **shade, **_ENVELOPE)

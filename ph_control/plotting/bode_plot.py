"""Bode plots: numbers first, then matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from .. import _checks
from .._units import unit_for
from ..analysis.margins import margin
from ..exceptions import StructureError
from .bode_data import bode_data
from .inputs import is_fit, subjects_of
from .response_picture import LIMIT, POLAR, Responses, Scale, draw_responses
from .style import LineStyle, Look, frequency_axis, plain, told_gain_unit

if TYPE_CHECKING:
    from typing_extensions import Unpack

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
    scale: str = "log",
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
    scale : {'log', 'linear'}
        Scale of the frequency axis.
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
    rows = [name for name, wanted in zip(POLAR, (plot_magnitude, plot_phase), strict=True) if wanted]
    if not rows:
        raise StructureError("plot_magnitude and plot_phase are both False; there is nothing to draw")
    numbers = bode_data(
        sysdata, omega, data, segments=segments, intersample=intersample, omega_limits=omega_limits,
        omega_num=omega_num, unit=unit, confidence=confidence, level=level, label=label, data_label=data_label,
        unit_name=unit_name, scale=scale,
    )  # fmt: skip
    outputs, inputs, kinds = len(numbers.output_labels), len(numbers.input_labels), len(rows)
    if display_margins and (outputs, inputs) != (1, 1):
        raise StructureError(
            f"margins are those of one port; the systems have {outputs} outputs and {inputs} inputs: draw the loop "
            "sys[i, j]"
        )
    gain_unit = told_gain_unit(numbers, data) if gain_unit is None else gain_unit
    drawing = Scale(dB, deg, wrap_phase)
    with look.context():
        meaning = "magnitude above phase for each output" if kinds == 2 else ""
        drawn = draw_responses(numbers, look, ax, rows, drawing, [gain_unit] * outputs, meaning=meaning)
        if display_margins:
            panels = dict(zip(rows, drawn.axes[:, 0], strict=True))
            subjects = subjects_of(sysdata, None, tabulated=True)
            observed = [one.given.observed_system if is_fit(one.given) else one.system for one in subjects]
            _draw_margins(panels, numbers, observed, drawn.lines[0, 0], drawing)
        # a curve that is nowhere must at least be told
        legend = look.legend(drawn.axes[0, -1], 1 if any(curve.vanishes for curve in numbers.curves) else 2)
        return drawn.finished(numbers.title, legend)


def _draw_margins(
    panels: dict[str, Axes], numbers: Responses, systems: list[Any], lines: list[Any], scale: Scale
) -> None:
    """Distances from -180 degrees where the gain is 1, and from a gain of 1 where the phase is -180 degrees."""
    size, unit, unit_name = scale.angle, numbers.axis.unit, numbers.axis.unit_name
    texts = []
    for system, curve, line in zip(systems, numbers.curves, lines[: len(numbers.curves)], strict=True):
        gm, pm, wcg, wcp = margin(system)
        style = {"label": "_", "color": line.get_color(), **_MARGIN}
        decibels = 20.0 * np.log10(gm) if gm else -np.inf
        if "phase" in panels and np.isfinite(pm):
            # the phase of the curve may be whole turns away
            at = np.interp(wcp, curve.omega, curve.phase(0, 0))
            critical = -180.0 + 360.0 * np.round((at - (pm - 180.0)) / 360.0)
            low, high = panels["phase"].get_ylim()
            panels["phase"].set_ylim(min(low, size * (critical - 20.0)), max(high, size * (critical + 20.0)))
            panels["phase"].axhline(size * critical, **LIMIT)
            panels["phase"].plot([wcp / unit] * 2, [size * critical, size * (critical + pm)], **style)
        if "magnitude" in panels:
            panels["magnitude"].axhline(0.0 if scale.dB else 1.0, **LIMIT)
            if np.isfinite(decibels):
                panels["magnitude"].plot([wcg / unit] * 2, [-decibels, 0.0] if scale.dB else [1.0 / gm, 1.0], **style)
        gain = f"{decibels:.4g} dB at {wcg / unit:.4g} {unit_name}" if np.isfinite(decibels) else f"{decibels:g}"
        phase = f"{pm:.4g}° at {wcp / unit:.4g} {unit_name}" if np.isfinite(pm) else f"{pm:g}"
        name = f"{curve.label}: " if len(numbers.curves) > 1 else ""
        texts.append(plain(f"{name}gain margin {gain}, phase margin {phase}"))
    axis = next(iter(panels.values()))
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    axis.text(0.01, 0.02, "\n".join(texts), transform=axis.transAxes, fontsize="x-small", zorder=4, bbox=box)

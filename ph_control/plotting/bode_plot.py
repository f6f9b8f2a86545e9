"""Bode plots: frequencies that resolve every resonance, responses and measurements; then matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike
from scipy.linalg import matrix_balance

from .. import _checks
from .._options import AxisScale, ResponseInterpolation
from .._types import Array, Unpack
from .._units import parted, unit_for
from ..analysis.margins import margin
from ..analysis.spectral_estimate import SpectralEstimate, spectral_estimate
from ..exceptions import StructureError
from ..numerics.rational import LinearSystem
from ..numerics.rational import poles as poles_of
from ..systems.base import in_normal_form
from .inputs import (
    Subject,
    as_measured,
    is_fit,
    measurements_of,
    models_around,
    subjects_of,
    table_in,
    timebase,
    title_of,
)
from .response_picture import (
    LIMIT,
    POLAR,
    Curve,
    DrawnResponses,
    FrequencyAxis,
    Scale,
    band_of,
    distance,
    draw_responses,
    is_logarithmic,
)
from .style import AxesGiven, LineStyle, Look, frequency_axis, plain, told_gain_unit

_PER_DECADE = 200
_AROUND_ALL = 6000  # grid points on each side of all poles and zeros together
_AROUND_BAND = 400  # and of a band, each of which costs as many responses as there are models
_CLOSEST_BAND = 1e-6
_CLOSEST = 1e-8  # relative distance of the nearest grid points to a pole or zero that is an eigenvalue with rounding
_CLOSEST_PH = 1e-12  # and to one of a PH system: there a nearly cancelled resonance runs off the picture too
_NEGLIGIBLE = 1e-9  # relative size below which a computed pole or zero is at the origin
_COHERENT = 0.5  # coherence below which dots are pale
_MARGIN: dict[str, Any] = {"linestyle": "-", "linewidth": 1.8, "zorder": 2.8}


def bode_plot(
    sysdata: Any,
    omega: ArrayLike | None = None,
    *,
    data: ct.TimeResponseData | ct.FrequencyResponseData | None = None,
    segments: int = 8,
    intersample: ResponseInterpolation = "zoh",
    confidence: object = None,
    level: float = 0.95,
    omega_limits: ArrayLike | None = None,
    omega_num: int | None = None,
    scale: AxisScale = "log",
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
    ax: AxesGiven = None,
    **style: Unpack[LineStyle],
) -> ct.ControlPlot:
    """Bode plot that shows every resonance and antiresonance, and measurements with it.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other LTI system of python-control, `control.FrequencyResponseData`; a
        `PEMResult` stands for the response of the quantity that was measured: that of its `observed_system`, on the
        `background` of a fit to a response, and over the frequencies of this.
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
            observed = [
                subject.given.observed_system if is_fit(subject.given) else subject.system for subject in subjects
            ]
            _draw_margins(panels, numbers, observed, drawn.lines[0, 0], drawing)
        # a curve that is nowhere must at least be told
        legend = look.legend(drawn.axes[0, -1], 1 if any(curve.vanishes for curve in numbers.curves) else 2)
        return drawn.finished(numbers.title, legend)


def _draw_margins(
    panels: dict[str, Axes], numbers: DrawnResponses, systems: list[LinearSystem], lines: list[Line2D], scale: Scale
) -> None:
    """Distances from -180 degrees where the gain is 1, and from a gain of 1 where the phase is -180 degrees."""
    size, unit, unit_name = scale.angle, numbers.axis.unit, numbers.axis.unit_name
    texts = []
    count = len(numbers.curves)
    phases = numbers.phases(0, 0)[:count]
    for system, curve, phase_drawn, line in zip(systems, numbers.curves, phases, lines[:count], strict=True):
        gm, pm, wcg, wcp = margin(system)
        style = {"label": "_", "color": line.get_color(), **_MARGIN}
        decibels = 20.0 * np.log10(gm) if gm else -np.inf
        if "phase" in panels and np.isfinite(pm):
            # the phase of the curve may be whole turns away
            phase_there = np.interp(wcp, curve.omega, phase_drawn)
            critical = -180.0 + 360.0 * np.round((phase_there - (pm - 180.0)) / 360.0)
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
        name = f"{curve.label}: " if count > 1 else ""
        texts.append(plain(f"{name}gain margin {gain}, phase margin {phase}"))
    axis = next(iter(panels.values()))
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    axis.text(0.01, 0.02, "\n".join(texts), transform=axis.transAxes, fontsize="x-small", zorder=4, bbox=box)


# --- numbers ----------------------------------------------------------------------------------------------------------


def bode_data(
    sysdata: Any,
    omega: ArrayLike | None = None,
    data: object = None,
    *,
    segments: int = 8,
    intersample: ResponseInterpolation = "zoh",
    omega_limits: ArrayLike | None = None,
    omega_num: int | None = None,
    unit: float = 1.0,
    confidence: object = None,
    level: float = 0.95,
    label: str | Sequence[str] | None = None,
    data_label: str | None = None,
    unit_name: str = "",
    scale: AxisScale | None = "log",
) -> DrawnResponses:
    """Compute what `bode_plot` draws; its arguments, and the unit of frequencies with its size in rad per unit time."""
    if omega_num is not None:
        _checks.whole_number("omega_num", omega_num, 1)
    subjects = subjects_of(sysdata, label, tabulated=True)
    first = subjects[0].system
    models = models_around(confidence, subjects, "magnitude_band", "phase_band")
    measured = _measurement(data, first, segments, intersample, data_label)
    known = _known_band(measured, subjects)
    extents = np.concatenate([_extent(subject.system, known) for subject in subjects])
    grid, low, high = _frequencies(extents, known, omega, omega_limits, unit)
    axis = FrequencyAxis(low, high, unit, unit_name, is_logarithmic(scale, low, high))
    curves = [_curve(subject, grid, low, high, omega_num) for subject in subjects]
    for k, (curve, drawn) in enumerate(zip(curves, models, strict=True)):
        if drawn is not None:
            near = frequency_grid(curve.singular, low, high, False, omega_num, _AROUND_BAND, _CLOSEST_BAND)
            curves[k] = replace(curve, bands={(0, 0): band_of(drawn, near if grid is None else grid, level)})
    title = title_of("Bode plot", subjects, label is not None)
    if title == "Bode plot" and first.issiso():
        source, sensor = (parted(labels[0])[0] for labels in (first.input_labels, first.output_labels))
        title += f", {source} to {sensor}" * (not {source, sensor} & {"u", "y", "u[0]", "y[0]"})
    dots = [] if measured is None else [measured]
    return DrawnResponses(curves, dots, axis, first.output_labels, first.input_labels, title)


def _measurement(
    data: object, sys: LinearSystem, segments: int, intersample: ResponseInterpolation, label: str | None
) -> Curve | None:
    """The dots: a frequency response as it is, or the spectral estimate of a record."""
    if data is None:
        return None
    data = data.as_response() if hasattr(data, "as_response") else data
    if isinstance(data, ct.TimeResponseData):
        data = spectral_estimate(data, segments=segments, intersample=intersample)
        label = label or f"data (spectral estimate, {data.segments} segments)"
    if not isinstance(data, ct.FrequencyResponseData):
        raise StructureError(
            f"data is a {type(data).__name__}; pass a record as control.TimeResponseData, or a "
            "control.FrequencyResponseData"
        )
    if (data.noutputs, data.ninputs) != (sys.noutputs, sys.ninputs):
        raise StructureError(
            f"the data have {data.noutputs} outputs and {data.ninputs} inputs, the systems {sys.noutputs} and "
            f"{sys.ninputs}; select the same ones"
        )
    curve = _tabulated(data, label or "data")
    if isinstance(data, SpectralEstimate) and data.segments > 1:
        return replace(curve, doubtful=np.array([data.coherence[data.omega > 0] < _COHERENT]))
    return curve


def _tabulated(data: ct.FrequencyResponseData, label: str) -> Curve:
    seen = data.omega > 0
    if not seen.any():
        raise StructureError("the frequency response data have no frequency above 0; nothing can be drawn")
    nyquist = data.nyquist if isinstance(data, SpectralEstimate) else _nyquist(data)
    return Curve(label, data.omega[seen], data.frdata[:, :, seen], nyquist=nyquist, tabulated=True)


def _curve(subject: Subject, grid: Array | None, low: float, high: float, count: int | None) -> Curve:
    """Response of a system at the given frequencies, or on a grid of its own."""
    sys = subject.system
    if isinstance(sys, ct.FrequencyResponseData):
        return _tabulated(sys, subject.label)
    marks, singular = features(sys)
    grid = frequency_grid(marks, low, high, subject.lossless, count) if grid is None else grid
    nyquist = _nyquist(sys)
    grid = grid if nyquist is None else grid[grid <= nyquist]
    s = 1j * grid
    response = _balanced(sys)(s if nyquist is None else np.exp(s * timebase(sys)), squeeze=False, warn_infinite=False)
    response = as_measured(subject.given, response, grid)
    return Curve(subject.label, grid, response, singular, nyquist)


def _balanced(sys: LinearSystem) -> LinearSystem:
    """A plain state space in states of like sizes: python-control loses the digits of a response where they differ."""
    if type(sys) is not ct.StateSpace or not sys.nstates:
        return sys
    size = matrix_balance(sys.A, permute=False, separate=True)[1][0]
    return ct.ss(sys.A * size / size[:, None], sys.B / size[:, None], sys.C * size, sys.D, sys.dt)


def _nyquist(sys: LinearSystem) -> float | None:
    return float(np.pi) / timebase(sys) if sys.isdtime(strict=True) else None


# --- frequency axes --------------------------------------------------------------------------------------------------


def _known_band(measured: Curve | None, subjects: list[Subject]) -> tuple[float, float] | None:
    """Ends of a measurement, or else of the responses that fits were made to; None of neither."""
    if measured is not None:
        return float(measured.omega[0]), float(measured.omega[-1] if measured.nyquist is None else measured.nyquist)
    fits = [subject.given for subject in subjects if is_fit(subject.given)]
    tables = [table_in(record) for fit in fits for record in measurements_of(fit, None)]
    bands = [omega[omega > 0] for omega, _ in filter(None, tables)]
    ends = np.concatenate([band[[0, -1]] for band in bands if len(band)] or [np.zeros(0)])
    return (float(ends.min()), float(ends.max())) if len(ends) else None


def _frequencies(
    extents: Array, known: tuple[float, float] | None, omega: object, omega_limits: object, unit: float
) -> tuple[Array | None, float, float]:
    """Frequencies asked for, if any, and the ends of the axis, all in rad per unit time."""
    given = None if omega is None else _ascending("omega", omega)
    ends = _default_limits(extents, known, unit) if given is None else given[[0, -1]]
    if omega_limits is not None:
        ends = _ascending("omega_limits", omega_limits) * unit
        if len(ends) != 2:
            raise StructureError(f"omega_limits has {len(ends)} entries; give the lowest and the highest frequency")
    # two frequencies are limits
    return (given if given is not None and len(given) > 2 else None), float(ends[0]), float(ends[1])


def _ascending(name: str, value: object) -> Array:
    array = _checks.real_array(name, value, 1)
    if len(array) < 2 or array[0] <= 0 or np.any(np.diff(array) <= 0):
        raise StructureError(
            f"{name} must be at least two positive, ascending frequencies; it has {len(array)} entries"
            + (f" from {array.min():.6g} to {array.max():.6g}" if len(array) else "")
        )
    return array


def _default_limits(extents: Array, known: tuple[float, float] | None, unit: float) -> Array:
    """Full decades that hold all systems, 0.1 to 10 for none; with a measurement what it covers and they need."""
    if known is not None:
        first, top = known
        margin = min(1.1, (top / first) ** 0.05) if top > first else 1.1
        everything = np.concatenate([extents, [first / margin, top * margin]])
        return np.array([everything.min(), everything.max()])
    if not len(extents):
        return np.array([0.1, 10.0]) * unit
    # a table may end at a decade, to rounding
    low = np.floor(np.log10(extents.min() / unit) + 1e-9)
    high = np.ceil(np.log10(extents.max() / unit) - 1e-9)
    return 10.0 ** np.array([low, high]) * unit


def _extent(sys: LinearSystem, known: tuple[float, float] | None) -> Array:
    """Ends of what the picture must show: twice as far as the poles and zeros are, or as far as tabulated data are.

    Poles and zeros within a measurement ask for no more than it covers.
    """
    if isinstance(sys, ct.FrequencyResponseData):
        return _tabulated(sys, "").omega[[0, -1]]
    marks = features(sys)[0]
    if not len(marks):
        return marks
    ends, wider = marks[[0, -1]], np.array([0.5, 2.0])
    if known is not None:
        beyond = [ends[0] < known[0], ends[1] > known[1]]
        wider = np.where(beyond, wider, 1.0)
    return np.asarray(ends * wider, float)


def features(sys: LinearSystem) -> tuple[Array, Array]:
    """Frequencies of the poles and zeros of a system, ascending, positive, and those of them on the imaginary axis.

    The second kind is where the response is infinite or zero; it includes every pole and zero of a lossless one-port.
    """
    # with several ports the zeros of the system itself are not seen in a picture
    entries = [sys] if sys.issiso() else [sys[i, j] for i in range(sys.noutputs) for j in range(sys.ninputs)]
    poles = poles_of(sys)
    points = np.concatenate([poles, *(np.asarray(entry.zeros(), complex) for entry in entries)])
    if sys.isdtime(strict=True):
        points = np.log(points[points != 0]) / timebase(sys)
    points = points[np.isfinite(points)]
    if in_normal_form(sys) and sys.issiso():
        on_axis = np.unique(points.imag[points.imag > 0])
        return on_axis, on_axis
    size = np.abs(points)
    # eigenvalue solvers return zeros at infinity as huge numbers, and those at the origin as tiny ones
    scale = np.max(np.abs(poles), initial=0.0) if sys.isctime() else np.pi / timebase(sys)
    points = points[(size > _NEGLIGIBLE * scale) & ((size < scale / _NEGLIGIBLE) | (scale == 0))]
    on_axis = points[(np.abs(points.real) <= 1e-7 * np.abs(points)) & (points.imag > 0)].imag
    # well damped ones have no peak, and of repeated real ones the imaginary parts are rounding
    peaks = points.imag[points.imag > 0.5 * np.abs(points)]
    return np.unique(np.concatenate([np.abs(points), peaks])), np.unique(on_axis)


def frequency_grid(
    marks: ArrayLike,
    low: float,
    high: float,
    exact: bool = False,
    count: int | None = None,
    around: int = _AROUND_ALL,
    closest: float | None = None,
) -> Array:
    """Frequencies from `low` to `high`, dense on both sides of every mark and never on one.

    Parameters
    ----------
    marks : array_like, shape (N,)
        Frequencies of poles and zeros, positive.
    low, high : float
        Ends of the grid, `0 < low < high`.
    exact : bool
        Whether marks are told apart however close they are; otherwise those closer than a tenth of `closest` may be one
        that was rounded.
    count : int, optional
        Number of frequencies between the ends, those around the marks apart.
    around : int
        Number of those on each side of all marks between the ends together, as far as there are at least 3 and at most
        30 for each.
    closest : float, optional
        Distance of the nearest points to a mark, relative to its frequency; by default 1e-8, of exact ones 1e-12.

    Returns
    -------
    ndarray
        Ascending frequencies: 200 a decade, at least 500, and on each side of each mark 3 to 30 points at geometrically
        shrinking distances, from half way to the next mark, or half its frequency, down to `closest`.

    Examples
    --------
    >>> import numpy as np
    >>> from ph_control.plotting.bode_plot import frequency_grid
    >>> grid = frequency_grid([1.0], 0.1, 10.0)
    >>> bool(np.abs(grid - 1.0).min() > 0), bool(np.abs(grid - 1.0).min() < 1e-7)
    (True, True)
    """
    closest = closest or (_CLOSEST_PH if exact else _CLOSEST)
    if count is None:
        count = 2 + int(np.ceil(max(500.0, _PER_DECADE * np.log10(high / low))))
    base = np.geomspace(low, high, max(2, count))
    base[0], base[-1] = low, high
    marks = np.unique(np.asarray(marks, dtype=float))
    gaps = np.diff(marks, prepend=0.0, append=np.inf)
    # fewer for each of very many, which the picture cannot separate anyhow
    inside = int(np.sum((marks >= low) & (marks <= high)))
    shrinking = np.linspace(0.0, 1.0, int(np.clip(around // max(1, inside), 3, 30)))
    parts = [base]
    for side, gap in ((-1.0, gaps[:-1]), (1.0, gaps[1:])):
        far = 0.5 * np.minimum(gap, marks)
        near = np.minimum(closest * marks, far)
        parts.append((marks[:, None] + side * far[:, None] * (near / far)[:, None] ** shrinking).ravel())
    grid = np.unique(np.concatenate(parts))
    clear = distance(grid, marks) > (0.0 if exact else 0.1 * closest * grid)
    return grid[(grid >= low) & (grid <= high) & clear]

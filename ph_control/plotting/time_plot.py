"""Pictures of responses to a step and an impulse: instants that resolve every mode, or an envelope; numbers first.

Responses of lossless systems are sums of sines, exact at any instant.  Modes too fast for the instants are not sampled,
which would show slower motions that are not there: they widen the response to an envelope, which they fill.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from numpy.typing import ArrayLike

from .. import _checks
from .._types import Array, Mask, Unpack
from .._units import unit_for
from ..analysis.time_grid import listed
from ..exceptions import PHControlError, StructureError
from ..modal.modal_form import ModalForm
from ..numerics.rational import LinearSystem, state_space
from ..numerics.rational import poles as poles_of
from ..systems.base import in_normal_form
from ..systems.port_hamiltonian import ph
from .inputs import Subject, lateness_of, models_around, subjects_of, timebase, title_of
from .style import BAND, DOTS, ZERO, AxesGiven, LineStyle, Look, extremes, labelled, picture, plain

if TYPE_CHECKING:
    from matplotlib.artist import Artist

KINDS = ("impulse", "step")

_PERIODS = 3  # of the slowest mode
_PER_PERIOD = 20  # samples in the shortest period
_COARSEST = 2 * np.pi / 8  # phase between samples beyond which a line through them is not the motion
_LEAST = 501  # samples
_MOST = 200_000
_TABLE = 5_000_000  # entries of a (mode x instant) table, in all
_MOST_STEPPED = 50_000  # samples of a system that is stepped from one to the next
_MOST_IN_BAND = 20_000_000  # entries of a (model x mode x instant) table, in all
_UNIT_STEP = 0.01  # by which a measured step may miss 1
_GONE = 5.0  # time constants after which a motion is over
_ENVELOPE: dict[str, Any] = {"linewidth": 0.6, "zorder": 1.2, "hatch": "////"}


def step_plot(
    sysdata: Any, timepts: ArrayLike | None = None, *, timepts_num: int | None = None,
    data: ct.TimeResponseData | None = None, confidence: object = None, level: float = 0.95,
    time_unit: str | None = None, output_unit: str | None = None, label: str | Sequence[str] | None = None,
    data_label: str | None = None, ax: AxesGiven = None, **style: Unpack[LineStyle],
) -> ct.ControlPlot:  # fmt: skip
    """Responses to a unit step, in which no motion is lost between samples.

    Parameters
    ----------
    sysdata : system, or list of systems
        `PortHamiltonian`, `ModalForm`, any other LTI system of python-control; a `PEMResult` stands for the response of
        the quantity that was measured, with its delays: instants count from when these are over.
    timepts : array_like, shape (T,), or a number
        Instants, or the last one.  By default 3 periods of the slowest mode, or as long as was measured, and 20 samples
        in the shortest period.
    timepts_num : int, optional
        Number of instants.
    data : control.TimeResponseData, optional
        Measured response to a unit step, one trace for each input, to draw as dots.
    confidence : PEMResult or ModalSamples, or list of them, or True, optional
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
    options = {
        "timepts": timepts, "timepts_num": timepts_num, "confidence": confidence, "level": level, "data": data,
        "label": label, "data_label": data_label,
    }  # fmt: skip
    return _transient_plot("step", sysdata, options, time_unit, output_unit, ax, style)


def impulse_plot(
    sysdata: Any, timepts: ArrayLike | None = None, *, timepts_num: int | None = None,
    data: ct.TimeResponseData | None = None, confidence: object = None, level: float = 0.95,
    time_unit: str | None = None, output_unit: str | None = None, label: str | Sequence[str] | None = None,
    data_label: str | None = None, ax: AxesGiven = None, **style: Unpack[LineStyle],
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
    options = {
        "timepts": timepts, "timepts_num": timepts_num, "confidence": confidence, "level": level, "data": data,
        "label": label, "data_label": data_label,
    }  # fmt: skip
    return _transient_plot("impulse", sysdata, options, time_unit, output_unit, ax, style)


def _transient_plot(
    kind: str, sysdata: Any, options: Mapping[str, Any], time_unit: str | None, output_unit: str | None, ax: AxesGiven,
    style: Mapping[str, Any],
) -> ct.ControlPlot:  # fmt: skip
    look = Look.of(style)
    numbers = transient_data(sysdata, kind, **options)
    time_unit = unit_for(time_unit, sysdata, options["data"])
    rows, columns = len(numbers.output_labels), len(numbers.input_labels)
    with look.context():
        size = (max(6.4, 3.8 * columns), 3.4 if rows == 1 else 2.2 * rows)
        drawn = picture(look, ax, (rows, columns), size, sharex=True)
        for (i, j), axis in np.ndenumerate(drawn.axes):
            drawn.lines[i, j] = _draw_responses(axis, numbers, i, j, look, time_unit)
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
        return drawn.finished(numbers.title, look.legend(drawn.axes[0, -1], 2 if alone else 1))


# --- numbers ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TimeBand:
    """Confidence band: lower and upper end, shape (2, T), at `time`."""

    label: str
    time: Array
    ends: Array


@dataclass(frozen=True)
class Trace:
    """Response of one system, shape (p, m, T), at `time`, shape (T,); of a measured one NaN where missing.

    `fast` holds the natural frequencies that the instants do not resolve, and `reach`, shape (p, m), how far they
    lead away from `slow`, the response without them; `joined` if a line through the samples is the motion, or that
    without the fast ones; `sampled` systems change at their instants only.  Responses come `late`, shape (p, m), by the
    delays of a fit; their band has them.
    """

    label: str
    time: Array
    values: Array
    slow: Array = field(default_factory=lambda: np.zeros((1, 1, 0)))
    fast: Array = field(default_factory=lambda: np.zeros(0))
    reach: Array = field(default_factory=lambda: np.zeros((1, 1)))
    joined: bool = True
    sampled: bool = False
    band: TimeBand | None = None
    late: Array = field(default_factory=lambda: np.zeros((1, 1)))

    @property
    def resolved(self) -> bool:
        """Whether the samples show every motion."""
        return not len(self.fast)

    def with_delay(self, values: Array, i: int, j: int) -> tuple[Array, Array]:
        """Instants and values of such a response of an entry, at rest until its delay is over."""
        late = float(np.broadcast_to(self.late, values.shape[:2])[i, j])
        if late <= 0:
            return self.time + late, values[i, j]
        return np.concatenate([[0.0, late], self.time + late]), np.concatenate([[0.0, 0.0], values[i, j]])


@dataclass(frozen=True)
class TransientData:
    """All that a picture of step or impulse responses draws."""

    traces: list[Trace]
    measured: Trace | None
    end: float
    input_labels: list[str]
    output_labels: list[str]
    title: str


def transient_data(
    sysdata: Any,
    kind: str,
    timepts: ArrayLike | None = None,
    timepts_num: int | None = None,
    *,
    confidence: object = None,
    level: float = 0.95,
    data: ct.TimeResponseData | None = None,
    label: str | Sequence[str] | None = None,
    data_label: str | None = None,
) -> TransientData:
    """Compute what `step_plot` and `impulse_plot` draw; the arguments are theirs."""
    subjects = subjects_of(sysdata, label)
    models = models_around(confidence, subjects, "step_band", "impulse_band")
    forms = [_modes(subject) for subject in subjects]
    first = subjects[0].system
    measured = None if data is None else _measured(data, first, kind, data_label)
    if timepts is None and measured is not None:
        timepts = float(measured.time[-1])
    given = None if timepts is None or np.ndim(timepts) == 0 else _instants(timepts)
    end = _end(subjects, forms, timepts) if given is None else float(given[-1])
    traces = []
    for subject, modes, drawn in zip(subjects, forms, models, strict=True):
        if modes is None:
            trace = _stepped(subject, kind, given, end, timepts_num)
        else:
            trace = _lossless(subject, modes, kind, given, end, timepts_num)
        trace = replace(trace, late=lateness_of(subject.given))
        band = None if drawn is None else _band(trace, drawn, kind, level)
        traces.append(replace(trace, band=band))
    outputs = first.output_labels
    if any(subject.system.output_labels != outputs for subject in subjects):
        # names that differ from one system to the next would be wrong for all but one
        outputs = ["Output"] if first.noutputs == 1 else [f"Output {k + 1}" for k in range(first.noutputs)]
    title = title_of(f"{kind.capitalize()} response", subjects, label is not None)
    return TransientData(traces, measured, end, first.input_labels, outputs, title)


def _measured(data: object, sys: LinearSystem, kind: str, label: str | None) -> Trace:
    if not isinstance(data, ct.TimeResponseData):
        raise StructureError(f"data is a {type(data).__name__}; pass the measured response as control.TimeResponseData")
    # one trace for each input, as control.step_response has it
    outputs, inputs = (None if x is None or not np.size(x) else np.asarray(x, float) for x in (data.y, data.u))
    shape = sys.noutputs, sys.ninputs
    if outputs is None or (len(outputs), outputs.shape[1] if outputs.ndim == 3 else 1) != shape:
        raise StructureError(
            f"the data have outputs of shape {np.shape(data.y)}; expected those of {shape[0]} outputs for a {kind} at "
            f"each of {shape[1]} inputs"
        )
    if kind == "step" and inputs is not None:
        heights = np.einsum("iik->ik", inputs.reshape(sys.ninputs, sys.ninputs, -1))
        if np.abs(heights - 1.0).max() > _UNIT_STEP:
            raise StructureError(
                f"the input of the data is not a unit step: it is between {heights.min():.4g} and {heights.max():.4g}, "
                f"allowed 1 +- {_UNIT_STEP}; divide the outputs by its height, or use compare(data, model)"
            )
    return Trace(label or "data", np.asarray(data.time, float), outputs.reshape(*shape, -1))


def _modes(subject: Subject) -> ModalForm | None:
    """Modal form of a lossless system, also of one in plain form; None for any other."""
    sys = subject.system
    if subject.lossless:
        return sys.modes
    if sys.isdtime(strict=True) or sys.noutputs != sys.ninputs:
        return None
    try:
        lossless = ph(sys, lossless=True)
        return lossless.modes if in_normal_form(lossless) else None
    except PHControlError:
        return None


# --- instants --------------------------------------------------------------------------------------------------------


def _instants(timepts: ArrayLike | None) -> Array:
    t = _checks.real_array("the time vector", timepts, 1)
    if len(t) < 2 or t[0] < 0 or (np.diff(t) <= 0).any():
        raise StructureError(
            f"the time vector has {len(t)} entries; expected at least 2, ascending, none before 0, when the response "
            "begins"
        )
    return t


def _end(subjects: list[Subject], forms: list[ModalForm | None], timepts: ArrayLike | None) -> float:
    """Last instant: the one asked for, or one by which every system has shown its slowest motion."""
    if timepts is not None:
        return _checks.sampling_step(timepts, name="the last instant")
    ends = []
    for subject, modes in zip(subjects, forms, strict=True):
        late = max(float(lateness_of(subject.given).max()), 0.0)
        if modes is None:
            ends.append(late + float(ct.step_response(state_space(subject.system)).time[-1]))
        elif modes.nu.any():
            ends.append(late + _PERIODS * 2 * np.pi / float(modes.d[modes.nu.any(axis=1)].min()))
    return max(ends, default=10.0)


def _count(end: float, fastest: float, given: int | None, most: int) -> int:
    if given is not None:
        return _checks.whole_number("timepts_num", given, 2, _MOST)
    return int(np.clip(np.ceil(end * fastest / (2 * np.pi) * _PER_PERIOD) + 1, _LEAST, max(_LEAST, most)))


# --- responses -------------------------------------------------------------------------------------------------------


def _lossless(
    subject: Subject, modes: ModalForm, kind: str, given: Array | None, end: float, samples: int | None
) -> Trace:
    """Response of a lossless system, with an envelope in place of the modes that its instants do not resolve."""
    integrals = KINDS.index(kind) + int(subject.lossless and subject.system._integrated)
    live, d = modes.nu.any(axis=1), modes.d
    if given is None:
        most = min(_MOST, _TABLE // max(1, int(live.sum())))
        count = _count(end, d[live].max(initial=0.0), samples, most)
        fast = live & (d * end / (count - 1) > _COARSEST)
        # without those far fewer samples are enough
        t = np.linspace(0.0, end, _count(end, d[live & ~fast].max(initial=0.0), samples, most))
    else:
        t = given
        fast = live & (d * float(np.diff(t).max()) > _COARSEST)
    slow = values = response_of(modes, t, integrals, ~fast)
    chosen = bool(fast.any()) and (given is not None or samples is not None)
    if chosen:
        values = response_of(modes, t, integrals)
    # the largest sum of the oscillations
    size = np.abs(modes.nu[fast])
    reach: Array = np.einsum("li,lj,l->ij", size, size, d[fast] ** (1.0 - integrals))
    return Trace(subject.label, t, values, slow, d[fast], reach, not chosen)


def response_of(modes: ModalForm, time: ArrayLike, integrals: int, moving: Mask | None = None) -> Array:
    """Impulse response of a modal form, integrated so many times (0, 1 or 2), shape (m, m, T).

    `integrals` of 1 is the step response.  Of modes that are not `moving` only the mean over an oscillation is taken, a
    displacement or a drift.  O(n T m^2).
    """
    t = np.asarray(time, float)
    residue = modes.rigid.T @ modes.rigid
    total: Array = residue[:, :, None] * np.array([np.ones_like(t), t, 0.5 * t**2][integrals])
    for l, (d, nu) in enumerate(zip(modes.d, modes.nu, strict=True)):
        # Re(d conj(nu_i) nu_j exp(-i d t)), integrated
        weight = nu.conj()[:, None] * nu[None, :] * d
        wave = np.exp(-1j * d * t) if moving is None or moving[l] else np.zeros(len(t))
        for k in range(integrals):
            wave = (wave - t**k) / (-1j * d)
        total += (weight[:, :, None] * wave).real
    return total


def _stepped(subject: Subject, kind: str, given: Array | None, end: float, samples: int | None) -> Trace:
    """Response that python-control computes, at instants that resolve it."""
    sys, label, sampled = subject.system, subject.label, bool(subject.system.isdtime(strict=True))
    fastest = 0.0
    if sampled:
        step = timebase(sys)
        t = step * np.arange(min(_MOST_STEPPED, int(np.floor(end / step * (1 + 1e-12))) + 1), dtype=float)
    else:
        # the fastest of the oscillations that last longer than a dot of the picture
        poles = poles_of(sys)
        fastest = float(np.abs(poles[poles.real > -_GONE * _LEAST / end].imag).max(initial=0.0))
        count = _count(end, fastest, samples, _MOST_STEPPED)
        if given is None and samples is None and fastest * end / (count - 1) > _COARSEST:
            # what is left of it is shown as it is, rather than all of it as it is not
            end = (count - 1) * _COARSEST / fastest
            label = f"{label} (to {end:.3g}: it oscillates at {fastest:.3g} rad per unit time)"
        t = np.linspace(0.0, end, count) if given is None else given
    respond = ct.step_response if kind == "step" else ct.impulse_response
    values = np.asarray(respond(state_space(sys), timepts=t, squeeze=False).outputs).reshape(
        sys.noutputs, sys.ninputs, len(t)
    )
    joined = fastest * float(np.diff(t).max(initial=0.0)) <= _COARSEST
    return Trace(label, t, values, values, joined=joined, sampled=sampled)


def _band(trace: Trace, models: Any, kind: str, level: float) -> TimeBand:
    if not trace.resolved:
        raise StructureError(
            f"no band can be drawn at instants that do not resolve {listed(trace.fast)}; pass timepts of at most "
            f"{_MOST * 2 * np.pi / _PER_PERIOD / float(trace.fast.max()):.3g}"
        )
    t = trace.time[: max(2, _MOST_IN_BAND // max(1, models.poles.size))] + float(trace.late[0, 0])
    ends = (models.step_band if kind == "step" else models.impulse_band)(t, level)
    shown = f"{100 * level:g} % band" + ("" if len(t) == len(trace.time) else f" (to {t[-1]:.3g})")
    return TimeBand(shown, t, np.asarray(ends))


# --- drawing ---------------------------------------------------------------------------------------------------------


def _draw_responses(
    axis: Axes, numbers: TransientData, i: int, j: int, look: Look, time_unit: str | None
) -> list[Artist]:
    lines: list[Artist] = []
    for k, trace in enumerate(numbers.traces):
        line = _draw_trace(axis, trace, i, j, look.curve(k))
        colour = line.get_color()
        lines.append(line)
        if not trace.resolved:
            t, slow = extremes(*trace.with_delay(trace.slow, i, j))
            warning = plain(f"envelope with {listed(trace.fast, time_unit)}, too fast for these instants")
            shade: dict[str, Any] = {"facecolor": to_rgba(colour, 0.12), "edgecolor": to_rgba(colour, 0.45)}
            low, high = slow - trace.reach[i, j], slow + trace.reach[i, j]
            axis.fill_between(t, low, high, label=warning, **shade, **_ENVELOPE)
        if trace.band is not None:
            # the two ends may be thinned at instants of their own
            ends = [extremes(trace.band.time, end) for end in trace.band.ends]
            t = np.union1d(ends[0][0], ends[1][0])
            low, high = (np.interp(t, *end) for end in ends)
            axis.fill_between(t, low, high, label=plain(trace.band.label), color=colour, **BAND)
    if numbers.measured is not None:
        t, y = extremes(numbers.measured.time, numbers.measured.values[i, j])
        lines += axis.plot(t, y, label=plain(numbers.measured.label), **DOTS)
    return lines


def _draw_trace(axis: Axes, trace: Trace, i: int, j: int, style: dict[str, Any]) -> Any:
    label = plain(trace.label)
    if not trace.joined:
        dots = {**style, "linestyle": "none", "marker": ".", "markersize": 4.0}
        return axis.plot(*trace.with_delay(trace.values, i, j), label=f"{label} (samples)", **dots)[0]
    if trace.sampled:
        style = {**style, "drawstyle": "steps-post", "linestyle": "-", "linewidth": 1.0}
    return axis.plot(*extremes(*trace.with_delay(trace.values, i, j)), label=label, **style)[0]

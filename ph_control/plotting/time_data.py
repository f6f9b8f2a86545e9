"""What a picture of step or impulse responses shows, as numbers: instants that resolve every mode, or an envelope.

Responses of lossless systems are sums of sines, exact at any instant.  Modes too fast for the instants are not sampled,
which would show slower motions that are not there: they widen the response to an envelope, which they fill.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from ..analysis.time_grid import listed
from ..exceptions import PHControlError, StructureError
from ..modal.modal_form import ModalForm
from ..systems.port_hamiltonian import ph
from .inputs import Subject, models_around, subjects_of, title_of

Array = NDArray[np.float64]

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


@dataclass(frozen=True)
class Trace:
    """Response of one system, shape (p, m, T), at `time`, shape (T,).

    `fast` holds the natural frequencies that the instants do not resolve, and `reach`, shape (p, m), how far they
    lead away from `slow`, the response without them; `joined` if a line through the samples is the motion, or that
    without the fast ones; `sampled` systems change at their instants only.
    """

    label: str
    time: Array
    values: Array
    slow: Array
    fast: Array = field(default_factory=lambda: np.zeros(0))
    reach: Array = field(default_factory=lambda: np.zeros((1, 1)))
    joined: bool = True
    sampled: bool = False

    @property
    def resolved(self) -> bool:
        """Whether the samples show every motion."""
        return not len(self.fast)

    @property
    def warning(self) -> str:
        """What the legend is to say of the envelope."""
        return f"envelope with {listed(self.fast)}, too fast for these instants"


@dataclass(frozen=True)
class TimeBand:
    """Confidence band: lower and upper end, shape (2, T), at `time`."""

    label: str
    time: Array
    ends: Array


@dataclass(frozen=True)
class MeasuredResponse:
    """Measured response, shape (p, m, T), at `time`; NaN where missing."""

    label: str
    time: Array
    values: Array


@dataclass(frozen=True)
class TransientData:
    """All that a picture of step or impulse responses draws."""

    traces: list[Trace]
    bands: list[TimeBand | None]
    measured: MeasuredResponse | None
    end: float
    input_labels: list[str]
    output_labels: list[str]
    title: str


def transient_data(
    sysdata: Any,
    kind: str,
    timepts: ArrayLike | None,
    timepts_num: int | None,
    *,
    confidence: Any = None,
    level: float = 0.95,
    data: ct.TimeResponseData | None = None,
    label: str | Sequence[str] | None = None,
    data_label: str | None = None,
) -> TransientData:
    """Compute what `step_plot` and `impulse_plot` draw; the arguments are theirs."""
    subjects = subjects_of(sysdata, label)
    models = models_around(confidence, subjects, "step_band", "impulse_band")
    forms = [_modes(one) for one in subjects]
    first = subjects[0].system
    measured = None if data is None else _measured(data, first, kind, data_label)
    if timepts is None and measured is not None:
        timepts = float(measured.time[-1])
    given = None if timepts is None or np.ndim(timepts) == 0 else _instants(timepts)
    end = _end(subjects, forms, timepts) if given is None else float(given[-1])
    traces = [
        _stepped(one, kind, given, end, timepts_num)
        if modes is None
        else _lossless(one, modes, kind, given, end, timepts_num)
        for one, modes in zip(subjects, forms, strict=True)
    ]
    bands = [
        None if drawn is None else _band(one, modes, trace, drawn, kind, level)
        for one, modes, trace, drawn in zip(subjects, forms, traces, models, strict=True)
    ]
    outputs = first.output_labels
    if any(one.system.output_labels != outputs for one in subjects):
        # names that differ from one system to the next would be wrong for all but one
        outputs = ["Output"] if first.noutputs == 1 else [f"Output {k + 1}" for k in range(first.noutputs)]
    title = title_of(f"{kind.capitalize()} response", subjects, label is not None)
    return TransientData(traces, bands, measured, end, first.input_labels, outputs, title)


def _measured(data: Any, sys: Any, kind: str, label: str | None) -> MeasuredResponse:
    if not isinstance(data, ct.TimeResponseData):
        raise StructureError(f"data is a {type(data).__name__}; pass the measured response as control.TimeResponseData")
    # one trace for each input, as control.step_response has it
    outputs, inputs = (None if x is None or not np.size(x) else np.asarray(x, float) for x in (data.y, data.u))
    shape = sys.noutputs, sys.ninputs
    if outputs is None or (len(outputs), outputs.shape[1] if outputs.ndim == 3 else 1) != shape:
        raise StructureError(
            f"the data have outputs of shape {np.shape(data.y)}; needed those of {shape[0]} outputs for a {kind} at "
            f"each of {shape[1]} inputs"
        )
    if kind == "step" and inputs is not None:
        heights = np.einsum("iik->ik", inputs.reshape(sys.ninputs, sys.ninputs, -1))
        if np.abs(heights - 1.0).max() > _UNIT_STEP:
            raise StructureError(
                f"the input of the data is no unit step: it lies between {heights.min():.4g} and {heights.max():.4g}, "
                f"allowed 1 +- {_UNIT_STEP}; divide the outputs by its height, or use compare(data, model)"
            )
    return MeasuredResponse(label or "data", np.asarray(data.time, float), outputs.reshape(*shape, -1))


def _modes(subject: Subject) -> ModalForm | None:
    """Modal form of a lossless system, also of one in plain form; None for any other."""
    sys = subject.system
    if subject.lossless:
        return sys.modes
    if sys.isdtime(strict=True) or sys.noutputs != sys.ninputs:
        return None
    try:
        return ph(sys).modes
    except PHControlError:
        return None


# --- instants --------------------------------------------------------------------------------------------------------


def _instants(timepts: Any) -> Array:
    t = _checks.real_array("the time vector", timepts, 1)
    if len(t) < 2 or t[0] < 0 or (np.diff(t) <= 0).any():
        raise StructureError(
            f"the time vector has {len(t)} entries; needed at least 2, ascending, and none before 0, when the response "
            "begins"
        )
    return t


def _end(subjects: list[Subject], forms: list[ModalForm | None], timepts: Any) -> float:
    """Last instant: the one asked for, or one by which every system has shown its slowest motion."""
    if timepts is not None:
        return _checks.sampling_step(timepts, name="the last instant")
    ends = []
    for one, modes in zip(subjects, forms, strict=True):
        if modes is None:
            ends.append(float(ct.step_response(one.system).time[-1]))
        elif modes.nu.any():
            ends.append(_PERIODS * 2 * np.pi / float(modes.d[modes.nu.any(axis=1)].min()))
    return max(ends, default=10.0)


def _count(end: float, fastest: float, asked: int | None, most: int) -> int:
    if asked is not None:
        if isinstance(asked, bool) or not isinstance(asked, int | np.integer) or not 2 <= asked <= _MOST:
            raise StructureError(
                f"timepts_num is {_checks.shown(asked)}; it must be a whole number from 2 to {_MOST} instants"
            )
        return int(asked)
    return int(np.clip(np.ceil(end * fastest / (2 * np.pi) * _PER_PERIOD) + 1, _LEAST, max(_LEAST, most)))


# --- responses -------------------------------------------------------------------------------------------------------


def _lossless(
    subject: Subject, modes: ModalForm, kind: str, given: Array | None, end: float, asked: int | None
) -> Trace:
    """Response of a lossless system, with an envelope in place of the modes that its instants do not resolve."""
    integrals = KINDS.index(kind) + int(subject.lossless and subject.system._integrated)
    live, d = modes.nu.any(axis=1), modes.d
    if given is None:
        most = min(_MOST, _TABLE // max(1, int(live.sum())))
        count = _count(end, d[live].max(initial=0.0), asked, most)
        fast = live & (d * end / (count - 1) > _COARSEST)
        # without those far fewer samples are enough
        t = np.linspace(0.0, end, _count(end, d[live & ~fast].max(initial=0.0), asked, most))
    else:
        t = given
        fast = live & (d * float(np.diff(t).max()) > _COARSEST)
    slow = values = response_of(modes, t, integrals, ~fast)
    chosen = bool(fast.any()) and (given is not None or asked is not None)
    if chosen:
        values = response_of(modes, t, integrals)
    # the largest sum of the oscillations
    size = np.abs(modes.nu[fast])
    reach: Array = np.einsum("li,lj,l->ij", size, size, d[fast] ** (1.0 - integrals))
    return Trace(subject.label, t, values, slow, d[fast], reach, not chosen)


def response_of(modes: ModalForm, time: ArrayLike, integrals: int, moving: NDArray[np.bool_] | None = None) -> Array:
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
        cosine, sine = np.zeros((2, len(t)))
        if moving is None or moving[l]:
            cosine, sine = np.cos(d * t), np.sin(d * t)
        if integrals == 1:
            cosine, sine = sine / d, (1.0 - cosine) / d
        elif integrals == 2:
            cosine, sine = (1.0 - cosine) / d**2, (t - sine / d) / d
        total += weight.real[:, :, None] * cosine + weight.imag[:, :, None] * sine
    return total


def _stepped(subject: Subject, kind: str, given: Array | None, end: float, asked: int | None) -> Trace:
    """Response that python-control computes, at instants that resolve it."""
    sys, label, sampled = subject.system, subject.label, bool(subject.system.isdtime(strict=True))
    fastest = 0.0
    if sampled:
        step = 1.0 if sys.dt is True else float(sys.dt)
        t = step * np.arange(min(_MOST_STEPPED, int(np.floor(end / step * (1 + 1e-12))) + 1), dtype=float)
    else:
        # the fastest of the oscillations that last longer than a dot of the picture
        poles = sys.poles()
        fastest = float(np.abs(poles[poles.real > -_GONE * _LEAST / end].imag).max(initial=0.0))
        count = _count(end, fastest, asked, _MOST_STEPPED)
        if given is None and asked is None and fastest * end / (count - 1) > _COARSEST:
            # what is left of it is shown as it is, rather than all of it as it is not
            end = (count - 1) * _COARSEST / fastest
            label = f"{label} (to {end:.3g}: it oscillates at {fastest:.3g} rad per unit time)"
        t = np.linspace(0.0, end, count) if given is None else given
    respond = ct.step_response if kind == "step" else ct.impulse_response
    values = np.asarray(respond(sys, timepts=t, squeeze=False).outputs).reshape(sys.noutputs, sys.ninputs, len(t))
    joined = fastest * float(np.diff(t).max(initial=0.0)) <= _COARSEST
    return Trace(label, t, values, values, joined=joined, sampled=sampled)


def _band(subject: Subject, modes: ModalForm | None, trace: Trace, models: Any, kind: str, level: float) -> TimeBand:
    if modes is None or (subject.lossless and subject.system._integrated):
        raise StructureError(f"bands are those of port-Hamiltonian systems; {subject.system.name} is none")
    if not trace.resolved:
        raise StructureError(
            f"no band can be drawn at instants that do not resolve {listed(trace.fast)}; pass timepts of at most "
            f"{_MOST * 2 * np.pi / _PER_PERIOD / float(trace.fast.max()):.3g}"
        )
    draws = len(models) if hasattr(models, "__len__") else 1
    t = trace.time[: max(2, _MOST_IN_BAND // max(1, draws * modes.n))]
    ends = (models.step_band if kind == "step" else models.impulse_band)(t, level)
    shown = f"{100 * level:g} % band" + ("" if len(t) == len(trace.time) else f" (to {t[-1]:.3g})")
    return TimeBand(shown, t, np.asarray(ends))

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
from ..numerics import double_double as tf
from ..systems.base import LosslessSystem
from ..systems.port_hamiltonian import ph
from .inputs import as_systems, labels_of, models_around, title_of

Array = NDArray[np.float64]

KINDS = ("impulse", "step")

_PERIODS = 3  # of the slowest mode
_PER_PERIOD = 20  # samples in the shortest period
_COARSEST = 8  # below, a line through the samples is not the motion
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
    lead away from `slow`, the response without them; `sampled` systems change at their instants only.
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
        """Whether a line through the samples is the motion."""
        return not len(self.fast)

    @property
    def warning(self) -> str:
        """What the legend is to say of the envelope."""
        return f"envelope with {listed(self.fast)}, too fast for these instants"


@dataclass(frozen=True)
class Band:
    """Confidence band: lower and upper end, shape (2, T), at `time`."""

    label: str
    time: Array
    ends: Array


@dataclass(frozen=True)
class Measured:
    """Measured response, shape (p, m, T), at `time`; NaN where missing."""

    label: str
    time: Array
    values: Array


@dataclass(frozen=True)
class TransientData:
    """All that a picture of step or impulse responses draws."""

    traces: list[Trace]
    bands: list[Band | None]
    measured: Measured | None
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
    systems = as_systems(sysdata)
    labels = labels_of(sysdata, systems, label)
    models = models_around(confidence, sysdata, systems, "step_band", "impulse_band")
    lossless = [_modes(sys) for sys in systems]
    measured = None if data is None else _measured(data, systems[0], kind, data_label)
    if timepts is None and measured is not None:
        timepts = float(measured.time[-1])
    given = None
    if timepts is not None and np.ndim(timepts) > 0:
        given = _instants(timepts)
    end = _end(systems, lossless, timepts) if given is None else float(given[-1])
    traces = [
        _stepped(sys, name, kind, given, end, timepts_num)
        if modes is None
        else lossless_trace(modes, name, kind, _integrals(sys, kind), given, end, timepts_num)
        for sys, modes, name in zip(systems, lossless, labels, strict=True)
    ]
    bands = [
        None if drawn is None else _band(sys, modes, trace, drawn, kind, level)
        for sys, modes, trace, drawn in zip(systems, lossless, traces, models, strict=True)
    ]
    first = systems[0]
    # names that differ from one system to the next would be wrong for all but one
    common = all(sys.output_labels == first.output_labels for sys in systems)
    outputs = first.output_labels if common else ["Output"] if first.noutputs == 1 else _numbered(first.noutputs)
    title = title_of(f"{kind.capitalize()} response", systems, label is not None)
    return TransientData(traces, bands, measured, end, first.input_labels, outputs, title)


def _measured(data: Any, sys: Any, kind: str, label: str | None) -> Measured:
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
        steps = inputs.reshape(sys.ninputs, sys.ninputs, -1)
        heights = steps[np.arange(sys.ninputs), np.arange(sys.ninputs)]
        if np.abs(heights - 1.0).max() > _UNIT_STEP:
            raise StructureError(
                f"the input of the data is no unit step: it lies between {heights.min():.4g} and {heights.max():.4g}, "
                f"allowed 1 +- {_UNIT_STEP}; divide the outputs by its height, or use compare(data, model)"
            )
    return Measured(label or "data", np.asarray(data.time, float), outputs.reshape(*shape, -1))


def _numbered(count: int) -> list[str]:
    return [f"Output {k + 1}" for k in range(count)]


def _modes(sys: Any) -> ModalForm | None:
    """Modal form of a lossless system, also of one in plain form; None for any other."""
    if isinstance(sys, LosslessSystem):
        return sys.modes
    if sys.isdtime(strict=True) or sys.noutputs != sys.ninputs:
        return None
    try:
        return ph(sys).modes
    except PHControlError:
        return None


def _integrals(sys: Any, kind: str) -> int:
    """How often the impulse response of the modes is integrated over time."""
    return KINDS.index(kind) + int(isinstance(sys, LosslessSystem) and sys._integrated)


# --- instants --------------------------------------------------------------------------------------------------------


def _instants(timepts: Any) -> Array:
    t = _checks.real_array("the time vector", timepts, 1)
    if len(t) < 2 or t[0] < 0 or (np.diff(t) <= 0).any():
        raise StructureError(
            f"the time vector has {len(t)} entries; needed at least 2, ascending, and none before 0, when the response "
            "begins"
        )
    return t


def _end(systems: list[Any], lossless: list[ModalForm | None], timepts: Any) -> float:
    """Last instant: the one asked for, or one by which every system has shown its slowest motion."""
    if timepts is not None:
        return _checks.sampling_step(timepts, name="the last instant")
    ends = []
    for sys, modes in zip(systems, lossless, strict=True):
        if modes is None:
            ends.append(float(ct.step_response(sys).time[-1]))
            continue
        live = modes.d[modes.nu.any(axis=1)]
        if len(live):
            ends.append(_PERIODS * 2 * np.pi / float(live.min()))
    return max(ends, default=10.0)


def _count(end: float, fastest: float, asked: int | None, most: int) -> int:
    if asked is not None:
        if isinstance(asked, bool) or not isinstance(asked, int | np.integer) or not 2 <= asked <= _MOST:
            raise StructureError(
                f"timepts_num is {_checks.shown(asked)}; it must be a whole number from 2 to {_MOST} instants"
            )
        return int(asked)
    return int(np.clip(np.ceil(end * fastest / (2 * np.pi) * _PER_PERIOD) + 1, _LEAST, max(_LEAST, most)))


# --- lossless systems ------------------------------------------------------------------------------------------------


def lossless_trace(
    modes: ModalForm, label: str, kind: str, integrals: int, given: Array | None, end: float, asked: int | None
) -> Trace:
    """Response of a lossless system, with an envelope in place of the modes that its instants do not resolve."""
    live = modes.nu.any(axis=1)
    d = modes.d[live]
    if given is None:
        most = min(_MOST, _TABLE // max(1, len(d)))
        count = _count(end, d.max(initial=0.0), asked, most)
        fast = d * end / (count - 1) > 2 * np.pi / _COARSEST
        if fast.any() and asked is None:
            # without them far fewer samples are enough
            count = _count(end, d[~fast].max(initial=0.0), None, most)
        t = np.linspace(0.0, end, count)
    else:
        t = given
        fast = d * float(np.diff(t).max()) > 2 * np.pi / _COARSEST
    fast_modes = np.zeros(modes.d.shape, bool)
    fast_modes[live] = fast
    slow = response_of(_part(modes, ~fast_modes), t, integrals)
    # what the modes add on the average, a displacement or a drift, is no oscillation
    rest = _part(modes, fast_modes, rigid=False)
    slow = slow + _mean_of(rest, t, integrals)
    values = slow
    if fast.any() and (given is not None or asked is not None):
        values = response_of(modes, t, integrals)
    joined = not (fast.any() and (given is not None or asked is not None))
    return Trace(label, t, values, slow, d[fast], _reach(rest, integrals), joined)


def _part(modes: ModalForm, chosen: NDArray[np.bool_], *, rigid: bool = True) -> ModalForm:
    return ModalForm._of(
        modes.d[chosen], modes.nu[chosen], modes.rigid.copy() if rigid else modes.rigid[:0], modes.r[chosen]
    )


def response_of(modes: ModalForm, time: ArrayLike, integrals: int) -> Array:
    """Impulse response of a modal form, integrated so many times (0, 1 or 2), shape (m, m, T).

    `integrals` of 1 is the step response.  Each `d t` is formed to twice the digits: right to a few units in the last
    place of the sum of amplitudes, at any time.  O(n T m^2).
    """
    t = np.asarray(time, float)
    residue = modes.rigid.T @ modes.rigid
    total: Array = residue[:, :, None] * np.array([np.ones_like(t), t, 0.5 * t**2][integrals])
    for d, nu in zip(modes.d, modes.nu, strict=True):
        # Re(d conj(nu_i) nu_j exp(-i d t)), integrated
        weight = nu.conj()[:, None] * nu[None, :] * d
        phase, rest = tf.two_prod(np.full_like(t, d), t)
        cosine, sine = np.cos(phase) - rest * np.sin(phase), np.sin(phase) + rest * np.cos(phase)
        if integrals == 1:
            cosine, sine = sine / d, (1.0 - cosine) / d
        elif integrals == 2:
            cosine, sine = (1.0 - cosine) / d**2, (t - sine / d) / d
        total += weight.real[:, :, None] * cosine + weight.imag[:, :, None] * sine
    return total


def _mean_of(modes: ModalForm, t: Array, integrals: int) -> Array:
    """What a response is on the average over the oscillations."""
    weight = np.einsum("li,lj->lij", modes.nu.conj(), modes.nu) * modes.d[:, None, None]
    d = modes.d[:, None, None]
    if integrals == 0:
        return np.zeros((modes.nports, modes.nports, len(t)))
    if integrals == 1:
        return np.repeat((weight.imag / d).sum(axis=0)[:, :, None], len(t), axis=2)
    mean: Array = (weight.real / d**2).sum(axis=0)[:, :, None] + (weight.imag / d).sum(axis=0)[:, :, None] * t
    return mean


def _reach(modes: ModalForm, integrals: int) -> Array:
    """Largest sum of the oscillations, shape (m, m)."""
    size = np.abs(modes.nu)
    reach: Array = np.einsum("li,lj,l->ij", size, size, modes.d ** (1.0 - integrals))
    return reach


# --- other systems ---------------------------------------------------------------------------------------------------


def _stepped(sys: Any, label: str, kind: str, given: Array | None, end: float, asked: int | None) -> Trace:
    """Response that python-control computes, at instants that resolve it."""
    if sys.isdtime(strict=True):
        step = 1.0 if sys.dt is True else float(sys.dt)
        count = min(_MOST_STEPPED, int(np.floor(end / step * (1 + 1e-12))) + 1)
        t = np.asarray(step * np.arange(count), float)
        fastest = 0.0
    else:
        fastest = _fastest(sys, end)
        if given is None:
            count = _count(end, fastest, asked, _MOST_STEPPED)
            if asked is None and fastest * end / (count - 1) > 2 * np.pi / _COARSEST:
                # what is left of it is shown as it is, rather than all of it as it is not
                end = (count - 1) * 2 * np.pi / _COARSEST / fastest
                label = f"{label} (to {end:.3g}: it oscillates at {fastest:.3g} rad per unit time)"
            given = np.linspace(0.0, end, count)
        t = given
    respond = ct.step_response if kind == "step" else ct.impulse_response
    response = respond(sys, timepts=t, squeeze=False)
    joined = fastest * float(np.diff(t).max(initial=0.0)) <= 2 * np.pi / _COARSEST
    values = np.asarray(response.outputs).reshape(sys.noutputs, sys.ninputs, len(t))
    return Trace(label, t, values, values, joined=joined, sampled=bool(sys.isdtime(strict=True)))


def _fastest(sys: Any, end: float) -> float:
    """Highest frequency of oscillations that last longer than a dot of the picture."""
    poles = sys.poles()
    lasting = poles.real > -_GONE * _LEAST / end
    return float(np.abs(poles[lasting].imag).max(initial=0.0))


# --- bands -----------------------------------------------------------------------------------------------------------


def _band(sys: Any, modes: ModalForm | None, trace: Trace, models: Any, kind: str, level: float) -> Band:
    if modes is None or (isinstance(sys, LosslessSystem) and sys._integrated):
        raise StructureError(f"bands are those of port-Hamiltonian systems; {sys.name} is none")
    if not trace.resolved:
        raise StructureError(
            f"no band can be drawn at instants that do not resolve {listed(trace.fast)}; pass timepts of at most "
            f"{_MOST * 2 * np.pi / _PER_PERIOD / float(trace.fast.max()):.3g}"
        )
    draws = len(models) if hasattr(models, "__len__") else 1
    most = max(2, _MOST_IN_BAND // max(1, draws * modes.n))
    t = trace.time[:most]
    ends = (models.step_band if kind == "step" else models.impulse_band)(t, level)
    shown = f"{100 * level:g} % band" + ("" if len(t) == len(trace.time) else f" (to {t[-1]:.3g})")
    return Band(shown, t, np.asarray(ends))

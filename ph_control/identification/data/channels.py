"""Recordings and response matrices: data of several inputs and outputs, checked once and of one list of channels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, overload

import numpy as np
from control import FrequencyResponseData, TimeResponseData

from ... import _checks
from ..._display import first_of
from ..._options import ResponseInterpolation
from ..._types import Array, ArrayLike, ComplexArray, Indices, Mask
from ..._units import checked_unit
from ...analysis.spectral_window import SpectralWindow, window_of
from ...exceptions import IdentificationError, StructureError
from .frequency_record import FrequencyRecord, InFrequency, LineErrors, checked_points, checked_weights, title_of
from .rounding import before_rounding, noise_before, rounding_step
from .time_record import (
    LONG,
    CheckedData,
    Clock,
    InTime,
    Record,
    refuse_contradiction,
    refuse_out_of_range,
    refuse_short,
    signal,
    stays_on_disk,
    uniform_time,
)

ResponseHold = Literal["auto", "zoh", "foh", "bandlimited", "sampled"]

Labels = tuple[str, ...]


_ACTING = 0.01  # of its largest value: an input that acts
_QUIET = 3  # samples before that: fewer do not show whether outputs move
_FEW_CHANGES = 20  # samples in which inputs that step change
_LOOKED_AT = 5000  # samples that show to which steps an output was rounded
_SHORT = 30  # samples, of which few more unknowns are many
_STILL = 1 / 3  # of the outputs that follow: what outputs are before that, of a system at rest


def missing_in(y: Array) -> Mask:
    """Samples that are missing of outputs (p, T) that were measured."""
    unseen = np.isnan(y)
    return np.asarray(unseen & ~unseen.all(axis=1, keepdims=True))


def bridged(y: Array) -> Array:
    """Outputs (p, T) with lines from sample to sample where some are missing."""
    gaps, t = missing_in(y), np.arange(y.shape[1])
    y = np.array(y, float) if gaps.any() else y
    for row, gap in zip(y, gaps, strict=True):
        if gap.any():
            row[gap] = np.interp(t[gap], t[~gap], row[~gap])
    return y


@dataclass(frozen=True, eq=False, repr=False)
class Recording(InTime):
    """Inputs and outputs on a uniform grid.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Instants, as recorded.
    dt : float
        Time between samples.
    u : ndarray, shape (m, T)
        Inputs; m = 0 for a free motion, 0 for an input that this experiment does not have.
    y : ndarray, shape (p, T)
        Outputs, NaN where a sample is missing.
    input_labels, output_labels : tuple of str
        Names of the channels, the same in all experiments of one fit.
    title : str
        What the recording is called; may be empty.
    time_unit : str or None
        Unit of the time; None where it is not known.
    unit : float
        What inputs and outputs were divided by; 1 of a recording as it was measured, as what follows is 0 or None.
    hum, rounding : ndarray, shape (p, T)
        What was subtracted from the outputs before that, and what rounding is taken to have added to them.
    steady : ndarray, shape (m,)
        What was subtracted from the inputs: values that they are taken to have had long before.
    level : ndarray, shape (p, T), or None
        Noise of each sample of the outputs over that of the recording; None where it is the same.
    """

    time: Array
    dt: float
    u: Array
    y: Array
    input_labels: Labels
    output_labels: Labels
    title: str = ""
    time_unit: str | None = None
    unit: float = field(default=1.0, init=False)
    hum: Array | float = field(default=0.0, init=False)
    rounding: Array | float = field(default=0.0, init=False)
    steady: Array | float = field(default=0.0, init=False)
    level: Array | None = field(default=None, init=False)

    @property
    def original(self) -> Recording:
        """The recording as it was measured."""
        return self

    def adjusted(
        self,
        unit: float | None = None,
        hum: Array | float | None = None,
        level: Array | None = None,
        steady: Array | float | None = None,
        rounding: Array | float | None = None,
    ) -> Recording:
        """The same with another hum subtracted from the outputs, and with inputs and outputs divided by a number.

        So is it with other `steady` values subtracted from the inputs, and another `rounding` from the outputs; a
        `level` of the noise is kept beside them.
        """
        unit, hum = self.unit if unit is None else unit, self.hum if hum is None else hum
        level, steady = self.level if level is None else level, self.steady if steady is None else steady
        rounding = self.rounding if rounding is None else rounding
        if unit == 1 and level is None and not (np.any(hum) or np.any(steady) or np.any(rounding)):
            return self.original
        given = {part.name: getattr(self.original, part.name) for part in fields(Recording)}
        given |= {"u": (given["u"].T - steady).T / unit, "y": (given["y"] - hum - rounding) / unit}
        given |= {"unit": unit, "hum": hum, "rounding": rounding, "steady": steady, "level": level}
        return AdjustedRecording(**given, whole=self.original)

    @cached_property
    def steps(self) -> Array:
        """Steps (p,) that outputs were rounded to, in the present unit; 0 of others."""
        every = max(1, min(self.samples, LONG) // _LOOKED_AT)
        return _checks.readonly(np.array([rounding_step(row[:LONG:every]) for row in self.y]))

    def before_rounding(self, predicted: Array, rounded: Mask) -> Recording:
        """The same with outputs that are `rounded` (p,) as they tell of others near to those `predicted` (p, T).

        Levels are those of noise of the deviation of rounding, `step / sqrt(12)`.
        """
        y, level = self.original.y, np.ones(self.y.shape)
        rounding = np.zeros(y.shape)
        for k in np.flatnonzero(rounded & (self.steps > 0)).tolist():
            step, seen = self.steps[k] * self.unit, ~np.isnan(y[k] + predicted[k])
            noise = noise_before(y[k, seen], step, predicted[k, seen])
            values, deviations = before_rounding(y[k, seen], step, predicted[k, seen], noise)
            rounding[k, seen], level[k, seen] = y[k, seen] - values, np.sqrt(12) / step * deviations
        return self.adjusted(level=level, rounding=rounding)

    @property
    def changes(self) -> Indices:
        """First samples of the spans in which the noise of each output has one level, but for the first."""
        return np.zeros(0, int) if self.level is None else np.flatnonzero(np.diff(self.level, axis=1).any(axis=0)) + 1

    @property
    def of_one_level(self) -> Recording:
        """The same without the level of its noise."""
        return self

    def __repr__(self) -> str:
        return f"<Recording: {self.samples} samples, step {self.dt:.6g}, {_shape(self)}>"

    @property
    def driven(self) -> bool:
        """Whether there is an input that is not 0."""
        return bool(self.u.any())

    @property
    def first_inputs(self) -> tuple[Array, int]:
        """Inputs (m,) before any of them changes, and in how many samples; none where they change at once or never."""
        u = self.u[:, :LONG]  # the beginning tells of longer records
        changing = _changing(u - u[:, :1])
        first = int(changing[0]) if len(changing) else 0
        return np.median(u[:, :first], axis=1) if first else np.zeros(len(u)), first

    @property
    def mostly_stays(self) -> bool:
        """Whether inputs are in most samples what they were before."""
        return bool(np.mean(np.all(np.diff(self.u[:, :LONG], axis=1) == 0, axis=0)) > 0.5)

    @property
    def inputs_at_rest(self) -> Array | None:
        """Inputs (m,) of a record that may begin at rest, before they first change; None of others.

        At rest outputs change little, beside what follows, in the few samples before.  Where inputs are not 0 then, or
        two samples tell nothing, they change seldom in a record that is not short: of others a motion hides nothing.
        """
        inputs, first = self.first_inputs
        if not first:
            return None
        few = len(_changing(np.diff(self.u[:, :LONG], axis=1))) <= _FEW_CHANGES and self.samples >= _SHORT
        if (first < _QUIET or inputs.any()) and not few:
            return None
        y = np.where(self.observed[:, :LONG], self.y[:, :LONG], np.nan)
        still = first < _QUIET or np.all(_spread(y[:, :first]) <= _STILL * _spread(y[:, first:]))
        return inputs if still else None


def _changing(moves: Array) -> Indices:
    """Samples in which any of some signals (m, T) is more than a small part of its largest value."""
    sizes = np.abs(moves)
    return np.flatnonzero((sizes > _ACTING * sizes.max(axis=1, keepdims=True, initial=0.0)).any(axis=0))


def _spread(y: Array) -> Array:
    """Root mean square of values about their median along the last axis, of those that are not NaN; 0 without any."""
    seen = ~np.isnan(y)
    level = np.nanmedian(np.where(seen.any(axis=-1, keepdims=True), y, 0.0), axis=-1, keepdims=True)
    squares = np.where(seen, y - level, 0.0) ** 2
    return np.asarray(np.sqrt(squares.sum(axis=-1) / np.maximum(seen.sum(axis=-1), 1)))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class AdjustedRecording(Recording):
    """A `whole` recording without a hum of its outputs, in another unit, and with the level of its noise in time."""

    whole: Recording
    unit: float
    hum: Array | float
    rounding: Array | float
    steady: Array | float
    level: Array | None

    @property
    def original(self) -> Recording:
        """The recording as it was measured."""
        return self.whole

    @cached_property
    def steps(self) -> Array:
        """Steps (p,) that outputs were rounded to, in the present unit; 0 of others."""
        return _checks.readonly(self.whole.steps / self.unit)

    @property
    def of_one_level(self) -> Recording:
        """The same without the level of its noise."""
        return replace(self, level=None)


@dataclass(frozen=True, eq=False, repr=False)
class ResponseMatrix(InFrequency):
    """Frequency responses from each input to each output.

    Attributes
    ----------
    omega : ndarray, shape (K,)
        Frequencies in rad per unit of time, ascending, none negative.
    response : ndarray of complex, shape (p, m, K)
        Measured values, NaN where one is missing.
    weights : ndarray, shape (p, m, K)
        What squared errors count, in proportion to 1/variance; ones by default.
    input_labels, output_labels : tuple of str
        Names of the channels, the same in all experiments of one fit.
    title : str
        What the response is called; may be empty.
    time_unit : str or None
        Unit of time that `omega` is in radians per; None where it is not known.
    window : SpectralWindow or None
        The window that the responses were estimated with.
    errors : LineErrors or None
        Covariances of the errors of such responses, as a fit has estimated them.
    """

    omega: Array
    response: ComplexArray
    weights: Array
    input_labels: Labels
    output_labels: Labels
    title: str = ""
    time_unit: str | None = None
    window: SpectralWindow | None = None
    errors: LineErrors | None = None

    def __repr__(self) -> str:
        return f"<ResponseMatrix: {self.samples} frequencies, {_shape(self)}>"


Channels = tuple[Recording, ...] | tuple[ResponseMatrix, ...]
Kind = Record | FrequencyRecord | Recording | ResponseMatrix


def _shape(experiment: Recording | ResponseMatrix) -> str:
    inputs, outputs = len(experiment.input_labels), len(experiment.output_labels)
    return f"{outputs} output{'s' * (outputs != 1)} from {inputs} input{'s' * (inputs != 1)}"


# --- one experiment --------------------------------------------------------------------------------------------------


def single(data: CheckedData) -> Record | FrequencyRecord:
    """Data of one output and at most one input, as a `Record` or `FrequencyRecord`; refuse more channels."""
    if not isinstance(data, Recording | ResponseMatrix):
        return data  # type: ignore[return-value]
    m, p = len(data.input_labels), len(data.output_labels)
    if p != 1 or m > 1:
        spectral = isinstance(data, ResponseMatrix)
        raise StructureError(
            f"the {'frequency response' if spectral else 'record'} has {m} inputs and {p} outputs "
            f"({_listed(data.input_labels)}; {_listed(data.output_labels)}), and a fit takes one of each: "
            + ("select them by data[output, input]" if spectral else "pass the pair (data.u[j], data.y[i]) with dt")
        )
    if isinstance(data, ResponseMatrix):
        return FrequencyRecord(
            data.omega, data.response[0, 0], data.weights[0, 0], data.input_labels[0], data.output_labels[0],
            data.title, data.time_unit, data.window, data.errors,
        )  # fmt: skip
    u, label = (data.u[0], data.input_labels[0]) if m else (np.zeros(data.samples), "u")
    return Record(
        data.clock,
        data.dt,
        u,
        data.y[0],
        label,
        data.output_labels[0],
        bool(m),
        title=data.title,
        time_unit=data.time_unit,
    )


def _listed(labels: Labels) -> str:
    return first_of([*map(repr, labels)], 8, ", ...") or "no names"


@overload
def several(data: Record | Recording) -> Recording: ...
@overload
def several(data: object) -> Recording | ResponseMatrix: ...
def several(data: Any) -> Recording | ResponseMatrix:
    """The same data as a `Recording` or `ResponseMatrix`, which may have several channels.

    A `Record` has one output, and one input if it is driven; a `FrequencyRecord` one entry; others are as they were.
    """
    named = {name: getattr(data, name) for name in ("input_labels", "output_labels", "title", "time_unit")}
    if isinstance(data, FrequencyRecord):
        response, weights = data.response[None, None], data.weights[None, None]
        return ResponseMatrix(data.omega, response, weights, **named, window=data.window, errors=data.errors)
    if not isinstance(data, Record):
        return data
    return Recording(data.clock, data.dt, data.u[None][: int(data.driven)], data.y[None], **named)


def recording_of_pair(u: Any, y: Any, dt: float | None, output_needed: bool = True) -> Recording:
    """Recording of signals (T,) or (channels, T); of a free motion without `u`, of no known output without `y`."""
    inputs = [] if u is None else _signals("input", u)
    if y is None and not len(inputs):
        raise StructureError("the record has neither input nor output; pass (u, y), or (None, y) for a free motion")
    if y is None and output_needed:
        raise StructureError("the record has no output; pass (u, y), missing samples of y as NaN")
    if dt is None:
        raise StructureError("dt is missing: with arrays (u, y) give dt, the time between samples")
    step = _checks.sampling_step(dt)
    outputs = [np.full(len(inputs[0]), np.nan)] if y is None else _signals("output", y, missing=True)
    return recording(None, step, inputs, outputs, _numbered("u", len(inputs)), _numbered("y", len(outputs)))


def recordings_of_response(data: TimeResponseData, dt: float | None) -> tuple[Recording, ...]:
    """One recording for each trace."""
    refuse_short(len(data.time))
    time, step = uniform_time("the time of the record", data.time, dt)
    unit, runs = checked_unit(getattr(data, "time_unit", None)), max(1, data.ntraces)
    shape = (-1, runs, len(time))
    inputs = np.reshape(data.u, shape) if data.ninputs else np.zeros((0, runs, len(time)))
    outputs = np.reshape(data.y, shape)
    names = tuple(data.input_labels or _numbered("u", len(inputs)))[: len(inputs)]
    seen, recordings = tuple(data.output_labels or _numbered("y", len(outputs))), []
    titles = list(data.trace_labels) if runs > 1 and data.trace_labels else runs * [data.title or ""]
    for k, title in enumerate(titles):
        try:
            u, y = _signals("input", inputs[:, k]), _signals("output", outputs[:, k], missing=True)
            recordings.append(recording(time, step, u, y, names, seen, title, unit))
        except StructureError as error:
            raise StructureError(f"trace {k + 1}: {error}" if runs > 1 else str(error)) from None
    return tuple(recordings)


def _signals(role: str, value: Any, missing: bool = False) -> Sequence[Array] | Array:
    """Signals of one channel (T,), or of several (channels, T)."""
    shape = shape_of(value)
    if len(shape) != 2 or 1 in shape:
        return [signal(f"the {role}", value, missing=missing)]
    if shape[0] > shape[1]:
        raise StructureError(
            f"the {role}s have shape {shape}, more channels than samples; expected one row for each {role}, "
            f"(channels, T): pass the transpose, {'uy'[role == 'output']}.T"
        )
    if not hasattr(type(value), "__array__") and not isinstance(value, list | tuple):
        raise StructureError(f"the {role} is a {type(value).__name__}; pass an array of signals")
    rows = value if isinstance(value, np.ndarray) else list(value)
    checked = [signal(f"{role} {k}", row, missing=missing) for k, row in enumerate(rows, start=1)]
    return np.asarray(value) if stays_on_disk(value) else checked


def shape_of(value: ArrayLike) -> tuple[int, ...]:
    """Shape of an array_like; (0,) of what is none, which is refused where it is read."""
    try:
        return tuple(np.shape(value))
    except ValueError:
        return (0,)


def _numbered(letter: str, count: int) -> Labels:
    return (letter,) if count == 1 else tuple(f"{letter}{k}" for k in range(1, count + 1))


def recording(
    time: Array | Clock | None, dt: float, inputs: Sequence[Array] | Array, outputs: Sequence[Array] | Array,
    names: Labels, seen: Labels, title: str = "", time_unit: str | None = None,
) -> Recording:  # fmt: skip
    """Put checked signals together, of one length each; without `time` they begin at 0."""
    if not len(outputs):
        raise StructureError("the record has no outputs; pass at least one, with missing samples as NaN")
    time = Clock(range(len(outputs[0])), dt) if time is None else time
    parts = [("input", values) for values in inputs] + [("output", values) for values in outputs] + [("time", time)]
    for (name, here), (other, there) in pairwise((name, len(values)) for name, values in parts):
        if here != there:
            raise StructureError(f"the {name} has {here} samples, the {other} {there}; they must have the same length")
    refuse_short(len(time))
    for name, values in parts[:-1]:
        refuse_out_of_range(f"the {name}", values)
    _refuse_repeated("input", names)
    _refuse_repeated("output", seen)
    u, y = _stacked(inputs, len(time)), _stacked(outputs, len(time))
    return Recording(time, dt, u, y, names, seen, title, time_unit)  # type: ignore[arg-type]


def _stacked(signals: Sequence[Array] | Array, samples: int) -> Array:
    """Signals (k, T) as rows; those of one array on the disk stay there."""
    if len(signals) == 1:
        return signals[0][None]
    if isinstance(signals, np.ndarray):
        return signals
    return np.reshape(signals, (len(signals), samples)).astype(float)


def _refuse_repeated(role: str, labels: Labels) -> None:
    repeated = [label for label in dict.fromkeys(labels) if labels.count(label) > 1]
    if repeated:
        raise StructureError(f"{labels.count(repeated[0])} {role}s are called {repeated[0]!r}; give each its own label")


@dataclass(frozen=True)
class Sampling:
    """How responses were estimated from samples, as far as it was given: window, step and hold of the input.

    The hold 'sampled' is that of a held input whose responses were not divided by that of the hold.
    """

    window: ArrayLike | None = None
    dt: float | None = None
    hold: ResponseHold = "auto"

    def stated_by(self, data: Any) -> Sampling:
        """With what data state of themselves by the attributes `window`, `segments`, `step` and `intersample`."""
        if self.window is not None or getattr(data, "window", None) is None:
            return self
        step = getattr(data, "step", None)
        if step is not None:
            refuse_contradiction(self.dt, step, "the estimate")
        hold: Any = getattr(data, "intersample", "auto") if self.hold == "auto" else self.hold
        window, blocks = data.window, getattr(data, "segments", None)
        if blocks is not None and isinstance(window, tuple | list) and len(window) == 2:
            window = (*window, blocks)
        return Sampling(window, step or self.dt, hold)

    def of(self, data: object, omega: Array) -> SpectralWindow | None:
        """The window at some frequencies."""
        if self.window is None:
            if self.dt is not None:
                raise StructureError(
                    "dt is the step of a record in time, and a frequency response has none; leave dt out, or give the "
                    "window with which the response was estimated, window=('hann', N)"
                )
            return None
        step = self.dt
        if isinstance(data, FrequencyResponseData) and data.dt:
            step = float(data.dt)
            refuse_contradiction(self.dt, step, "the frequency response")
        step = None if step is None else _checks.sampling_step(step)
        hold: ResponseInterpolation = "zoh" if self.hold == "auto" or self.hold == "sampled" else self.hold
        return window_of(self.window, omega, step, hold)


NO_SAMPLING = Sampling()


def response_matrix(
    data: FrequencyResponseData, weights: ArrayLike | None, sampling: Sampling = NO_SAMPLING
) -> ResponseMatrix:
    """Check a frequency response, and sort it by frequency; one of samples is divided by that of their hold."""
    sampling = sampling.stated_by(data)
    omega, response = checked_points(data, windowed=sampling.window is not None)
    window = sampling.of(data, omega)
    if window is not None and (data.dt or sampling.hold == "sampled"):
        response = response / window.hold_at(omega)
    names, seen = tuple(data.input_labels), tuple(data.output_labels)
    _refuse_repeated("input", names)
    _refuse_repeated("output", seen)
    order, unit = np.argsort(omega, kind="stable"), checked_unit(getattr(data, "time_unit", None))
    matrix = ResponseMatrix(omega, response, np.ones(response.shape), names, seen, title_of(data), unit)
    matrix = weighted(matrix, weights)
    arrays = (matrix.omega[order], matrix.response[..., order], matrix.weights[..., order])
    return ResponseMatrix(*arrays, names, seen, matrix.title, unit, window)


def weighted(matrix: ResponseMatrix, weights: ArrayLike | None) -> ResponseMatrix:
    """The same response with given weights: one for each frequency (K,), or for each entry (p, m, K)."""
    if weights is None:
        return matrix
    shape = matrix.response.shape
    given = shape_of(weights)
    if given not in (shape, (shape[2],)):
        raise StructureError(
            f"weights have shape {given}; with a response of shape {shape} they must be {shape} or ({shape[2]},)"
        )
    each = checked_weights(np.ravel(weights), math.prod(given))
    return replace(matrix, weights=np.broadcast_to(each.reshape(given), shape).copy())


# --- one list of channels --------------------------------------------------------------------------------------------


def matched(parts: Sequence[Recording | ResponseMatrix], by_label: bool) -> tuple[Any, ...]:
    """Experiments of the same inputs and outputs, matched by their labels or by their places."""
    inputs = _union([experiment.input_labels for experiment in parts], by_label)
    outputs = _union([experiment.output_labels for experiment in parts], by_label)
    experiments = tuple(_with_channels(experiment, inputs, outputs, by_label) for experiment in parts)
    if isinstance(experiments[0], Recording):
        seen = np.any([experiment.observed.any(axis=-1) for experiment in experiments], axis=0)
        if not seen.all():
            lost = outputs[int(np.argmin(seen))]
            raise StructureError(f"output {lost!r} has no sample in any experiment; leave it out")
    return experiments


def _union(labels: Sequence[Labels], by_label: bool) -> Labels:
    if by_label:
        return tuple(dict.fromkeys(name for names in labels for name in names))
    return max(labels, key=len)


def _with_channels(
    experiment: Recording | ResponseMatrix, inputs: Labels, outputs: Labels, by_label: bool
) -> Recording | ResponseMatrix:
    """An experiment with all inputs and outputs in this order; inputs it lacks are 0, outputs it lacks NaN."""
    if (experiment.input_labels, experiment.output_labels) == (inputs, outputs):
        return experiment
    driven = [inputs.index(name) if by_label else k for k, name in enumerate(experiment.input_labels)]
    seen = [outputs.index(name) if by_label else k for k, name in enumerate(experiment.output_labels)]
    if isinstance(experiment, Recording):
        u, y = np.zeros((len(inputs), experiment.samples)), np.full((len(outputs), experiment.samples), np.nan)
        u[driven], y[seen] = experiment.u, experiment.y
        return replace(experiment, u=u, y=y, input_labels=inputs, output_labels=outputs)
    response = np.full((len(outputs), len(inputs), experiment.samples), np.nan, complex)
    weights = np.ones(response.shape)
    response[np.ix_(seen, driven)], weights[np.ix_(seen, driven)] = experiment.response, experiment.weights
    return replace(experiment, response=response, weights=weights, input_labels=inputs, output_labels=outputs)


# --- what they show --------------------------------------------------------------------------------------------------


def refuse_still(channels: Sequence[Recording] | Sequence[ResponseMatrix], moving: bool) -> None:
    """Refuse outputs that are zero, and inputs whose response cannot be told from a free motion."""
    seen = [bool(data.observed.any()) for data in channels]
    if len(seen) > 1 and not all(seen):
        place = seen.index(False)
        raise IdentificationError(
            f"experiment {place + 1} has no outputs: all {channels[place].samples} of them are NaN; leave it out"
        )
    for k, label in enumerate(channels[0].output_labels):
        values = [data.y[k] if isinstance(data, Recording) else data.response[k] for data in channels]
        if not any(np.any((value != 0) & (value == value)) for value in values):
            raise IdentificationError(f"output {label!r} is zero throughout; there is nothing to model: leave it out")
    recordings = [data for data in channels if isinstance(data, Recording)]
    for k, label in enumerate(channels[0].input_labels if recordings else ()):
        if all(np.all(data.u[k] == data.u[k, 0]) for data in recordings):
            if not moving and any(data.u[k, 0] != 0 for data in recordings):
                continue
            raise IdentificationError(
                f"input {label!r} is constant in every experiment, so that no response to it can be told from a free "
                "motion: leave it out, pass (None, y) if nothing drove the outputs, or initial_state='zero' if a step "
                "was applied to a plant at rest"
            )

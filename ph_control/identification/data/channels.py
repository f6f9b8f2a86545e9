"""Recordings and response matrices: data of several inputs and outputs, checked once and of one list of channels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from control import FrequencyResponseData, TimeResponseData

from ... import _checks
from ..._types import Array, ComplexArray, Mask
from ..._units import checked_unit, common_unit
from ...exceptions import StructureError
from .data_frames import is_data_frame, record_of_frame
from .experiments import each_experiment, refuse_mixture
from .frequency_record import FrequencyRecord, checked_points, checked_weights, title_of
from .time_record import (
    CheckedData,
    Record,
    checked_record,
    instants,
    refuse_contradiction,
    refuse_short,
    signal,
    stays_on_disk,
    titles_of,
    uniform_time,
)

Labels = tuple[str, ...]


_ACTING = 0.01  # of its largest value: an input that acts
_QUIET = range(3, 17)  # samples before that: fewer show nothing, more tell the motion of eight modes by themselves
_STILL = 1 / 3  # of the outputs that follow: what outputs are before that, of a system at rest


@dataclass(frozen=True, eq=False, repr=False)
class Recording(CheckedData):
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
    """

    time: Array
    dt: float
    u: Array
    y: Array
    input_labels: Labels
    output_labels: Labels
    title: str = ""
    time_unit: str | None = None

    def __repr__(self) -> str:
        return f"<Recording: {self.samples} samples, step {self.dt:.6g}, {_shape(self)}>"

    @property
    def samples(self) -> int:
        """Number of instants T."""
        return len(self.time)

    @property
    def driven(self) -> bool:
        """Whether there is an input that is not 0."""
        return bool(self.u.any())

    @cached_property
    def observed(self) -> Mask:
        """Where each output was measured, shape (p, T)."""
        return _checks.readonly(~np.isnan(self.y))

    @property
    def begins_at_rest(self) -> bool:
        """Whether outputs are small, beside what follows, in the few samples before an input acts."""
        size = np.abs(self.u)
        largest: Array = size.max(axis=1, keepdims=True, initial=0.0)
        first = int(np.argmax((size > _ACTING * largest).any(axis=0)))
        if first not in _QUIET:
            return False
        level = self.y - np.nanmedian(
            np.where(self.observed.any(axis=1, keepdims=True), self.y, 0.0), axis=1, keepdims=True
        )
        before, after = (
            np.sqrt(np.mean(np.where(seen, part, 0.0) ** 2, axis=1) / np.maximum(np.mean(seen, axis=1), _ACTING))
            for part, seen in (
                (level[:, :first], self.observed[:, :first]),
                (level[:, first:], self.observed[:, first:]),
            )
        )
        return bool(np.all(before <= _STILL * after))


@dataclass(frozen=True, eq=False, repr=False)
class ResponseMatrix(CheckedData):
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
    """

    omega: Array
    response: ComplexArray
    weights: Array
    input_labels: Labels
    output_labels: Labels
    title: str = ""
    time_unit: str | None = None

    def __repr__(self) -> str:
        return f"<ResponseMatrix: {self.samples} frequencies, {_shape(self)}>"

    @property
    def samples(self) -> int:
        """Number of frequencies K."""
        return len(self.omega)

    @cached_property
    def observed(self) -> Mask:
        """Where each entry was measured, shape (p, m, K)."""
        return _checks.readonly(~np.isnan(self.response))


def _shape(one: Recording | ResponseMatrix) -> str:
    inputs, outputs = len(one.input_labels), len(one.output_labels)
    return f"{outputs} output{'s' * (outputs != 1)} from {inputs} input{'s' * (inputs != 1)}"


def as_channels(
    data: Any, dt: Any = None, *, weights: Any = None
) -> tuple[Recording, ...] | tuple[ResponseMatrix, ...]:
    """Make checked experiments of several inputs and outputs, all in time or all in frequency.

    Parameters
    ----------
    data : control.TimeResponseData, control.FrequencyResponseData, pair (u, y), data frame, or list of these
        One experiment or several; a response of several traces gives one for each.  Signals of a pair have shape (T,),
        or (m, T) and (p, T), one row for each channel; `(None, y)` is a free motion.  Missing outputs are NaN.
    dt : float, or sequence of float or None, one for each experiment, optional
        Time between samples.  Needed with arrays; where the data have a time of their own, the two must agree.
    weights : array_like of float, shape (K,) or (p, m, K), or list of these (or None), optional
        What the squared error at each frequency counts; positive.  For frequency responses only.

    Returns
    -------
    tuple of Recording, or tuple of ResponseMatrix
        All with the same inputs and outputs: those of all experiments, matched by their labels where all have labels,
        by position otherwise.  An input that an experiment does not have is 0, what it does not measure NaN.

    Raises
    ------
    StructureError
        If the data are of another kind, or not finite, or do not fit together.
    IdentificationError
        If a record has fewer than 2 samples, or a frequency response no frequencies.

    Notes
    -----
    Nothing is modified.  O((m + p) T) time and memory.

    Examples
    --------
    >>> import numpy as np
    >>> from ph_control.identification.data.channels import as_channels
    >>> (one,) = as_channels((np.ones((2, 5)), np.ones((3, 5))), dt=0.1)
    >>> one
    <Recording: 5 samples, step 0.1, 3 outputs from 2 inputs>
    """
    return _matched(each_experiment(data, dt, weights, _channels))


def has_several_channels(data: Any) -> bool:
    """Whether data have more than one input or output in any experiment, right or wrong."""
    if isinstance(data, TimeResponseData | FrequencyResponseData):
        return bool(max(data.ninputs, data.noutputs) > 1)
    if isinstance(data, Recording | ResponseMatrix):
        return max(len(data.input_labels), len(data.output_labels)) > 1
    if isinstance(data, tuple) and len(data) == 2 and not any(map(_is_experiment, data)):
        return any(len(shape) == 2 and min(shape) > 1 for shape in map(_shape_of, data))
    if isinstance(data, list | tuple):
        return any(map(has_several_channels, data)) or _differ(list(map(_named, data)))
    return False


def _differ(names: list[tuple[Any, Any] | None]) -> bool:
    """Whether experiments, all named, have inputs or outputs of different names; a free motion has no input."""
    if not all(names):
        return False
    inputs, outputs = ({name for one in names if one for name in one[k]} for k in (0, 1))
    return max(len(inputs), len(outputs)) > 1


def _is_experiment(data: Any) -> bool:
    kinds = TimeResponseData | FrequencyResponseData | Recording | ResponseMatrix | Record | FrequencyRecord
    return isinstance(data, kinds | tuple) or is_data_frame(data)


def _named(data: Any) -> tuple[Any, Any] | None:
    """Names of the input and the output of an experiment that has one of each, and names."""
    if isinstance(data, TimeResponseData | FrequencyResponseData):
        return (tuple(data.input_labels or ()), tuple(data.output_labels or ())) if data.output_labels else None
    if isinstance(data, Record):
        return (data.input_label,) * data.driven, (data.output_label,)
    return ((data.input_label,), (data.output_label,)) if isinstance(data, FrequencyRecord) else None


# --- one experiment --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """An experiment, and whether its channels have names of their own."""

    one: Recording | ResponseMatrix
    named: bool

    @property
    def time_unit(self) -> str | None:
        """Unit of its time."""
        return self.one.time_unit


def _is_spectral(data: Any) -> bool:
    return isinstance(data, FrequencyResponseData | FrequencyRecord | ResponseMatrix)


def _channels(data: Any, dt: Any, weights: Any, first: Any) -> tuple[_Part, ...]:
    refuse_mixture(data, dt, weights, first, _is_spectral)
    if isinstance(data, FrequencyResponseData):
        return (_Part(_of_frequency_response(data, weights), True),)
    if isinstance(data, FrequencyRecord):
        found = ResponseMatrix(
            data.omega, data.response[None, None], data.weights[None, None], (data.input_label,), (data.output_label,),
            data.title, data.time_unit,
        )  # fmt: skip
        return (_Part(_weighted(found, weights), True),)
    if isinstance(data, ResponseMatrix):
        return (_Part(_weighted(data, weights), True),)
    if isinstance(data, Recording):
        refuse_contradiction(dt, data.dt, "the time of the recording")
        return (_Part(data, True),)
    if isinstance(data, Record):
        refuse_contradiction(dt, data.dt, "the time of the record")
        return (_Part(_of_record(data), True),)
    if is_data_frame(data):
        return (_Part(_of_record(record_of_frame(data, dt)), True),)
    if isinstance(data, TimeResponseData):
        named = bool(data.output_labels) and bool(data.input_labels or not data.ninputs)
        return tuple(_Part(one, named) for one in _of_response(data, dt))
    u, y = data
    return (_Part(_of_pair(u, y, dt), False),)


def _of_record(one: Record) -> Recording:
    inputs = (one.input_label,) if one.driven else ()
    u = one.u[None] if one.driven else np.zeros((0, one.samples))
    return Recording(one.time, one.dt, u, one.y[None], inputs, (one.output_label,), one.title, one.time_unit)


def _of_pair(u: Any, y: Any, dt: Any) -> Recording:
    if y is None:
        raise StructureError("the record has no output; pass (u, y), missing samples of y as NaN")
    if dt is None:
        raise StructureError("dt is missing: with arrays (u, y) give dt, the time between samples")
    step = _checks.sampling_step(dt)
    outputs = _signals("output", y, missing=True)
    inputs = [] if u is None else _signals("input", u)
    return _recording(None, step, inputs, outputs, _numbered("u", len(inputs)), _numbered("y", len(outputs)))


def _of_response(data: TimeResponseData, dt: Any) -> list[Recording]:
    refuse_short(len(data.time))
    time, step = uniform_time("the time of the record", data.time, dt)
    unit, runs = checked_unit(getattr(data, "time_unit", None)), max(1, data.ntraces)
    shape = (-1, runs, len(time))
    inputs = np.reshape(data.u, shape) if data.ninputs else np.zeros((0, runs, len(time)))
    outputs = np.reshape(data.y, shape)
    names = tuple(data.input_labels or _numbered("u", len(inputs)))[: len(inputs)]
    seen, found = tuple(data.output_labels or _numbered("y", len(outputs))), []
    for k, title in enumerate(titles_of(data, runs)):
        try:
            u, y = _signals("input", inputs[:, k]), _signals("output", outputs[:, k], missing=True)
            found.append(_recording(time, step, u, y, names, seen, title, unit))
        except StructureError as error:
            raise StructureError(f"trace {k + 1}: {error}" if runs > 1 else str(error)) from None
    return found


def _signals(role: str, value: Any, missing: bool = False) -> Sequence[Array] | Array:
    """Signals of one channel (T,), or of several (channels, T)."""
    shape = _shape_of(value)
    if len(shape) != 2 or shape[1] == 1:
        return [signal(f"the {role}", value, missing=missing)]
    if shape[0] > shape[1]:
        raise StructureError(
            f"the {role}s have shape {shape}, more channels than samples; needed is one row for each {role}, "
            f"(channels, T): pass the transpose, {'uy'[role == 'output']}.T"
        )
    if not hasattr(type(value), "__array__") and not isinstance(value, list | tuple):
        raise StructureError(f"the {role} is a {type(value).__name__}; pass an array of signals")
    rows = value if isinstance(value, np.ndarray) else list(value)
    found = [signal(f"{role} {k}", row, missing=missing) for k, row in enumerate(rows, start=1)]
    return np.asarray(value) if stays_on_disk(value) else found


def _shape_of(value: Any) -> tuple[int, ...]:
    """Shape of an array_like; (0,) of what is none, which is refused where it is read."""
    try:
        return tuple(np.shape(value))
    except ValueError:
        return (0,)


def _numbered(letter: str, count: int) -> Labels:
    return (letter,) if count == 1 else tuple(f"{letter}{k}" for k in range(1, count + 1))


def _recording(
    time: Array | None, dt: float, inputs: Sequence[Array] | Array, outputs: Sequence[Array] | Array,
    names: Labels, seen: Labels, title: str = "", time_unit: str | None = None,
) -> Recording:  # fmt: skip
    """Put checked signals together, of one length each."""
    if not len(outputs):
        raise StructureError("the record has no outputs; needed at least one, missing samples as NaN")
    time = instants(len(outputs[0]), dt) if time is None else time
    records = [checked_record(time, dt, None, y) for y in outputs]
    records += [checked_record(time, dt, u, outputs[0]) for u in inputs]
    _refuse_repeated("input", names)
    _refuse_repeated("output", seen)
    lengths = {one.samples for one in records}
    if len(lengths) > 1:
        raise StructureError(f"the outputs have {' and '.join(map(str, sorted(lengths)))} samples; needed one length")
    u, y = _stacked(inputs, records[0].samples), _stacked(outputs, records[0].samples)
    return Recording(records[0].time, dt, u, y, names, seen, title, time_unit)


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


def _of_frequency_response(data: FrequencyResponseData, weights: Any) -> ResponseMatrix:
    omega, response = checked_points(data)
    names, seen = tuple(data.input_labels), tuple(data.output_labels)
    _refuse_repeated("input", names)
    _refuse_repeated("output", seen)
    order, unit = np.argsort(omega, kind="stable"), checked_unit(getattr(data, "time_unit", None))
    found = ResponseMatrix(omega, response, np.ones(response.shape), names, seen, title_of(data), unit)
    found = _weighted(found, weights)
    arrays = (found.omega[order], found.response[..., order], found.weights[..., order])
    return ResponseMatrix(*arrays, names, seen, found.title, unit)


def _weighted(one: ResponseMatrix, weights: Any) -> ResponseMatrix:
    """The same with weights of every frequency, or of every entry at every frequency."""
    if weights is None:
        return one
    shape = one.response.shape
    given = _shape_of(weights)
    if given not in (shape, (shape[2],)):
        raise StructureError(
            f"weights have shape {given}; with a response of shape {shape} they must be {shape} or ({shape[2]},)"
        )
    each = checked_weights(np.ravel(weights), math.prod(given))
    return replace(one, weights=np.broadcast_to(each.reshape(given), shape).copy())


# --- one list of channels --------------------------------------------------------------------------------------------


def _matched(parts: Sequence[_Part]) -> tuple[Any, ...]:
    """Experiments of the same inputs and outputs."""
    common_unit(list(parts))
    by_label = all(part.named for part in parts)
    inputs = _union([part.one.input_labels for part in parts], by_label)
    outputs = _union([part.one.output_labels for part in parts], by_label)
    found = tuple(_with_channels(part.one, inputs, outputs, by_label) for part in parts)
    if isinstance(found[0], Recording):
        seen = np.any([one.observed.any(axis=-1) for one in found], axis=0)
        if not seen.all():
            lost = outputs[int(np.argmin(seen))]
            raise StructureError(f"output {lost!r} has no sample in any experiment; leave it out")
    return found


def _union(labels: Sequence[Labels], by_label: bool) -> Labels:
    if by_label:
        return tuple(dict.fromkeys(name for one in labels for name in one))
    return max(labels, key=len)


def _with_channels(
    one: Recording | ResponseMatrix, inputs: Labels, outputs: Labels, by_label: bool
) -> Recording | ResponseMatrix:
    """An experiment with all inputs and outputs, at their places."""
    if (one.input_labels, one.output_labels) == (inputs, outputs):
        return one
    driven = [inputs.index(name) if by_label else k for k, name in enumerate(one.input_labels)]
    seen = [outputs.index(name) if by_label else k for k, name in enumerate(one.output_labels)]
    if isinstance(one, Recording):
        u, y = np.zeros((len(inputs), one.samples)), np.full((len(outputs), one.samples), np.nan)
        u[driven], y[seen] = one.u, one.y
        return replace(one, u=u, y=y, input_labels=inputs, output_labels=outputs)
    response = np.full((len(outputs), len(inputs), one.samples), np.nan, complex)
    weights = np.ones(response.shape)
    response[np.ix_(seen, driven)], weights[np.ix_(seen, driven)] = one.response, one.weights
    return replace(one, response=response, weights=weights, input_labels=inputs, output_labels=outputs)

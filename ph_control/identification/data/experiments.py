"""The one door for data: every kind that can be fitted becomes a tuple of checked experiments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from control import FrequencyResponseData, TimeResponseData

from ... import _checks
from ..._types import ArrayLike, OneOrEach
from ..._units import common_unit
from ...exceptions import IdentificationError, StructureError
from .channels import (
    Channels,
    Kind,
    Recording,
    ResponseHold,
    ResponseMatrix,
    Sampling,
    matched,
    recording_of_pair,
    recordings_of_response,
    response_matrix,
    several,
    shape_of,
    single,
    weighted,
)
from .data_frames import is_data_frame, recording_of_frame
from .frequency_record import FrequencyRecord, checked_weights
from .time_record import CheckedData, Record, refuse_contradiction

_KINDS = (
    "a control.TimeResponseData, a control.FrequencyResponseData, a data frame with columns t, u and y, or a tuple "
    "(u, y) of signals together with dt"
)


def as_experiments(
    data: object, dt: OneOrEach = None, *, weights: OneOrEach = None, output_needed: bool = True
) -> tuple[Record, ...] | tuple[FrequencyRecord, ...]:
    """Make checked experiments of data of any kind, all in time or all in frequency.

    Parameters
    ----------
    data : control.TimeResponseData, control.FrequencyResponseData, data frame, pair (u, y), or list of these
        One experiment or several.  A response of several traces gives one experiment for each.  A pair is a tuple or
        list of two signals, array_like of shape (T,) each; `(None, y)` is an autonomous record, and with
        `output_needed=False` also `(u, None)` is one.  A data frame has `columns` and gives a column by its label; its
        time is found as in `phc.read_csv`, and the first column beside it is the input, the second the output.
        Experiments in a list may differ in length, step and start; pairs in it are tuples.  A tuple of several
        experiments is taken as well.
    dt : float, or sequence of float or None, one for each experiment, optional
        Time between samples.  Needed with arrays; where the data have a time of their own, the two must agree.
    weights : array_like of float, shape (K,), or list of these (or None), one for each experiment, optional
        What the squared error at each frequency counts; positive.  For frequency responses only.
    output_needed : bool, optional
        Whether a record without output is refused.

    Returns
    -------
    tuple of Record, or tuple of FrequencyRecord
        At least one experiment.

    Raises
    ------
    StructureError
        If the data are of another kind, or not finite, or do not fit together.  The message names the sample, and
        in a list the experiment, counted from 1.
    IdentificationError
        If a record has fewer than 2 samples, or a frequency response no frequencies.

    Notes
    -----
    Nothing is modified.  Signals are copied, but for read-only memory-mapped arrays of doubles, which stay on the disk
    (one that can be written is copied; so is one of another type).  The step is the shortest number that the instants
    allow: it does not depend on where the time begins.  O(T), and no more memory than the signals and the time take.

    Examples
    --------
    >>> import numpy as np
    >>> from ph_control.identification.data.experiments import as_experiments
    >>> first, second = as_experiments([([1, 0, 0], [0, 2, 1]), (None, [1, np.nan, 3, 4])], dt=[0.1, 0.2])
    >>> first.dt, second.dt, second.driven, second.observed.tolist()
    (0.1, 0.2, False, [True, False, True, True])
    """
    take = partial(_experiment, output_needed=output_needed)
    return _each_experiment(data, dt, weights, lambda *arguments: map(single, take(*arguments)))


def as_channels(
    data: object, dt: OneOrEach = None, *, weights: OneOrEach = None, window: ArrayLike | None = None,
    hold: ResponseHold = "auto", output_needed: bool = True,
) -> Channels:  # fmt: skip
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
    window : pair (name, N), or array_like, shape (N,), optional
        Window of the blocks that frequency responses were estimated from; by default what these state themselves.
    hold : {'auto', 'zoh', 'foh', 'bandlimited'}
        What the input of such responses did between samples.
    output_needed : bool, optional
        Whether a pair must have an output; without one its values are missing.

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
    >>> from ph_control.identification.data.experiments import as_channels
    >>> (recording,) = as_channels((np.ones((2, 5)), np.ones((3, 5))), dt=0.1)
    >>> recording
    <Recording: 5 samples, step 0.1, 3 outputs from 2 inputs>
    """
    take = partial(_experiment, output_needed=output_needed, window=window, hold=hold)
    experiments = _each_experiment(data, dt, weights, lambda *arguments: map(several, take(*arguments)))
    if not output_needed and not any(experiment.observed.any() for experiment in experiments):
        return experiments
    return matched(experiments, _are_named(data))


def as_measured(data: Any, dt: OneOrEach = None, *, weights: OneOrEach = None) -> tuple[Kind, ...]:
    """Experiments as `as_experiments` makes them of one input and one output, and `as_channels` of more in any.

    Experiments that differ in the names of their inputs or outputs have several channels together; columns of data
    frames are taken by their places.
    """
    experiments = _each_experiment(data, dt, weights, _experiment)
    sides = (
        [experiment.input_labels for experiment in experiments],
        [experiment.output_labels for experiment in experiments],
    )
    different = _are_named(data) and not any(map(is_data_frame, data if _are_several(data) else [data]))
    together = max(len({name for labels in side for name in labels}) for side in sides)
    if (different and together > 1) or max(len(labels) for side in sides for labels in side) > 1:
        return matched(tuple(map(several, experiments)), _are_named(data))
    return tuple(map(single, experiments))


def _each_experiment(
    data: Any, dt: OneOrEach, weights: OneOrEach, take: Callable[..., Iterable[Any]]
) -> tuple[Any, ...]:
    """What `take(data, dt, weights, first)` makes of an experiment, or of each in a list, `first` being one of them."""
    if not _are_several(data):
        return tuple(take(data, dt, weights, None))
    if len(data) == 0:
        raise StructureError(f"data is an empty {type(data).__name__}; pass at least one experiment: {_KINDS}")
    if weights is not None and not isinstance(weights, list | tuple):
        raise StructureError(
            f"weights are a {type(weights).__name__}; with a list of {len(data)} experiments give a list of as many "
            "arrays"
        )
    steps, shares = _one_for_each("dt", dt, len(data)), _one_for_each("weights", weights, len(data))
    checked: list[Any] = []
    for k, (experiment, step, share) in enumerate(zip(data, steps, shares, strict=True), start=1):
        try:
            checked.extend(take(experiment, step, share, data[0]))
            common_unit(checked)
        except (StructureError, IdentificationError) as error:
            raise type(error)(f"experiment {k}: {error}") from None
    return tuple(checked)


def as_record(data: Any, dt: float | None = None, *, output_needed: bool = True) -> Record:
    """Make one record in time of data that `as_experiments` takes; a record is returned as it is."""
    records = (data,) if isinstance(data, Record) else as_experiments(data, dt, output_needed=output_needed)
    record = records[0]
    if len(records) > 1 or not isinstance(record, Record):
        raise StructureError(f"data is a {type(data).__name__} of {len(records)} experiments; pass one time record")
    if not record.driven:
        raise StructureError("the record has no input; pass one that varies (a free motion is estimated along with it)")
    return record


def one_recording(data: Any, dt: float | None, outputs: int) -> Recording:
    """Make one recording of data that `as_channels` takes; without outputs these are missing throughout."""
    blind = isinstance(data, tuple) and len(data) == 2 and data[1] is None
    if blind:
        u = np.atleast_2d(_checks.real_array("the input", data[0]))
        data = (u, np.zeros((outputs, u.shape[1])))
    channels = as_channels(data, dt if isinstance(data, tuple) else None)
    if len(channels) > 1 or isinstance(channels[0], ResponseMatrix):
        raise StructureError(f"data is a {type(data).__name__} of {len(channels)} experiments; pass one time record")
    record: Recording = several(channels[0])
    return replace(record, y=np.full_like(record.y, np.nan)) if blind else record


# --- one or several --------------------------------------------------------------------------------------------------


def _is_object(data: object) -> bool:
    """Whether this can be nothing but one experiment."""
    return isinstance(data, CheckedData | TimeResponseData | FrequencyResponseData) or is_data_frame(data)


def _is_signal(value: object) -> bool:
    return hasattr(type(value), "__len__") and getattr(value, "ndim", 1) > 0


def _is_pair(data: object) -> bool:
    """Whether this is a tuple of two signals, any of which may be None; a tuple of two numbers is no pair."""
    return isinstance(data, tuple) and len(data) == 2 and all(values is None or _is_signal(values) for values in data)


def _are_several(data: object) -> bool:
    """Whether a list or tuple is one of experiments, right or wrong, rather than the pair of two signals."""
    if not isinstance(data, list | tuple):
        return False
    return len(data) != 2 or any(_is_object(entry) for entry in data) or any(map(_is_pair, data))


def _refuse_unknown(data: object, listed: bool) -> None:
    """Refuse what is no experiment; one in a list is no list itself, since its signals could not be told from it."""
    if _is_object(data) or (isinstance(data, tuple if listed else list | tuple) and not _are_several(data)):
        return
    kind = type(data).__name__
    if isinstance(data, list | tuple) and any(_is_object(entry) or _is_pair(entry) for entry in data):
        raise StructureError(f"this is a {kind} of experiments; lists are not nested: pass one list of all experiments")
    more = "" if listed else ", or a list of these"
    if isinstance(data, str):
        more += "; phc.read_csv reads a file"
    elif isinstance(data, Iterator):
        more += "; put what it yields in a list"
    raise StructureError(f"{'this' if listed else 'data'} is a {kind}; pass {_KINDS}{more}")


# --- one experiment --------------------------------------------------------------------------------------------------


def _is_spectral(data: object) -> bool:
    return isinstance(data, FrequencyResponseData | FrequencyRecord | ResponseMatrix)


def _are_named(data: Any) -> bool:
    """Whether the channels of all experiments have names of their own, which a pair has not."""
    every = data if _are_several(data) else [data]
    if any(isinstance(experiment, list | tuple) for experiment in every):
        return False
    responses = [experiment for experiment in every if isinstance(experiment, TimeResponseData)]
    return all(response.output_labels and (response.input_labels or not response.ninputs) for response in responses)


def _refuse_mixture(data: object, weights: object, first: object, window: object) -> None:
    """Refuse what is no experiment, what is of another kind than the `first` of a list, and options of other kinds."""
    _refuse_unknown(data, listed=first is not None)
    spectral = _is_spectral(data)
    if first is not None and spectral != _is_spectral(first):
        kinds = ["a frequency response", "a record in time"][:: 1 if spectral else -1]
        raise StructureError(f"this is {kinds[0]}, the first is {kinds[1]}; fit the two kinds one by one")
    if not spectral and window is not None:
        raise StructureError(
            "window belongs to frequency responses that were estimated from blocks of a record, and this is a record: "
            "its fit needs none; leave window out"
        )
    if not spectral and weights is not None:
        raise StructureError(
            "weights belong to frequency responses, and this is a record in time; mark samples to leave out with NaN"
        )


def _experiment(
    data: Any,
    dt: float | None,
    weights: ArrayLike | None,
    first: object,
    output_needed: bool = True,
    window: ArrayLike | None = None,
    hold: ResponseHold = "auto",
) -> tuple[Any, ...]:
    """Checked data of one experiment, of one or of several channels; in a list of the kind of the `first`."""
    _refuse_mixture(data, weights, first, window)
    if isinstance(data, FrequencyResponseData):
        return (response_matrix(data, weights, Sampling(window, dt, hold)),)
    if isinstance(data, FrequencyRecord | ResponseMatrix):
        sampling = Sampling(window, dt, hold)
        known = data.window if window is None and dt is None else sampling.of(data, data.omega)
        if weights is None and known is data.window:
            return (data,)
        if isinstance(data, FrequencyRecord):
            weights = data.weights if weights is None else checked_weights(weights, data.samples)
            return (replace(data, weights=weights, window=known),)
        return (replace(weighted(data, weights), window=known),)
    if isinstance(data, Record | Recording):
        refuse_contradiction(dt, data.dt, "the time of the record")
        return (data,)
    if isinstance(data, TimeResponseData):
        return recordings_of_response(data, dt)
    if is_data_frame(data):
        return (recording_of_frame(data, dt, output_needed=output_needed),)
    u, y = data
    if isinstance(data, list) and any(len(shape) == 2 and min(shape) > 1 for shape in map(shape_of, data)):
        raise StructureError(
            "this is a list of lists of signals; several experiments are a list of tuples, [(u1, y1), ..]"
        )
    return (recording_of_pair(u, y, dt, output_needed),)


def _one_for_each(name: str, value: object, count: int) -> Sequence[Any]:
    """A value for each experiment: the one for all, or those of a sequence."""
    if not isinstance(value, list | tuple) and not (isinstance(value, np.ndarray) and value.ndim == 1):
        return count * [value]
    if len(value) != count:
        raise StructureError(f"{name} has {len(value)} entries for {count} experiments; give one for each")
    return list(value)

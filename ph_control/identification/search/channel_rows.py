"""The rows of a search, from recordings or response matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._options import Discretisation, InterpolationOrAuto
from ..._types import Array, Indices, Mask
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ..data.channels import Recording, ResponseMatrix
from ..data.windowed import SharedErrors
from ..regression.free import Delays, Lateness
from ..regression.frequency_rows import FreeResponse
from ..regression.time_rows import FreeRecord

Experiments = Sequence[Recording] | Sequence[ResponseMatrix]

_LASTING = 0.05  # of a record: the part in which an input has to act


@dataclass(frozen=True, eq=False)
class RowOptions:
    """How channels become rows.

    Attributes
    ----------
    quantities : sequence of str, optional
        Of each output 'displacement', 'velocity', 'acceleration', or 'free'; all free by default.
    intersample : {'auto', 'zoh', 'foh'}
        How inputs go on between samples; 'auto' begins with the first.
    offset : int
        Terms of what outputs have beside the modes: none, a constant, or a constant and a drift.
    moving : bool
        Whether the modes may be in motion where a recording begins.
    method : {'exact', 'midpoint', 'euler'}
        How the modes meet the samples.
    late : Lateness, optional
        Delays of outputs and inputs.
    direct : bool
        Whether inputs may be fed through.
    """

    quantities: Sequence[str] | None = None
    intersample: InterpolationOrAuto = "auto"
    offset: int = 1
    moving: bool = True
    method: Discretisation = "exact"
    late: Lateness | None = None
    direct: bool = True


def records_of(channels: Sequence[Recording], form: RowOptions) -> list[FreeRecord]:
    """Return the rows of recordings, grouped by the samples that outputs have in common."""
    hold = "zoh" if form.intersample == "auto" else form.intersample
    records = list[FreeRecord]()
    for recording in channels:
        acting = np.flatnonzero(recording.u.any(axis=1))
        driven = len(acting) > 0
        options = {"offset": form.offset, "driven": driven, "moving": form.moving or not driven, "among": acting,
                   "unit": recording.unit, "steady": _steady(recording, acting), "through": form.direct}  # fmt: skip
        u = recording.u if driven and len(acting) == len(recording.u) else recording.u[acting]
        u = u if driven else np.broadcast_to(0.0, (1, recording.samples))
        records += FreeRecord.by_observation(
            u, recording.y, recording.observed, Hold(recording.dt, form.method, hold), recording.level,
            recording.steps, **options,
        )  # fmt: skip
    if form.late is None:
        return records
    records = [rows.with_dead_times(form.late.inputs) for rows in records]
    return Delays.of_outputs(form.late.outputs).rows(records) if form.late.outputs.any() else records


def _steady(recording: Recording, acting: Indices) -> Array | None:
    """What was subtracted from some of the inputs of a recording; None if nothing."""
    steady = np.broadcast_to(recording.steady, len(recording.u))[acting] / recording.unit
    return steady if steady.any() else None


def responses_of(
    channels: Sequence[ResponseMatrix], quantities: Sequence[str], delay: Array | None = None
) -> list[FreeResponse]:
    """Return the rows of responses, entries grouped where weights, but for a factor, and points agree."""
    responses = list[FreeResponse]()
    for number, channel in enumerate(channels):
        entries = channel.response.reshape(-1, channel.samples)
        weights, observed = channel.weights.reshape(entries.shape), channel.observed.reshape(entries.shape)
        kinds = np.repeat(np.array(quantities), channel.response.shape[1])
        groups: dict[tuple[str, bytes, bytes], list[int]] = {}
        for e in np.flatnonzero(observed.any(axis=1)).tolist():
            shape = np.float32(np.where(observed[e], weights[e] / weights[e][observed[e]].mean(), 0.0)).tobytes()
            if channel.errors is not None:
                shape = str(e).encode()
            groups.setdefault((str(kinds[e]), observed[e].tobytes(), shape), []).append(e)
        for (kind, *_), members in groups.items():
            first, seen = members[0], observed[members[0]]
            scale = np.sqrt(weights[first] / weights[first][seen].mean())
            response = np.where(seen, entries[members], 0.0)
            output, source = divmod(first, channel.response.shape[1])
            white = None if channel.errors is None else channel.errors.factor(output, source, seen)
            rows = FreeResponse(
                channel.omega, response, scale, seen, kind, np.array(members), window=channel.window, white=white,
                shared_errors=_shared_errors(channel, first, seen), experiment=number,
            )  # fmt: skip
            responses.append(rows.on_background())
    if delay is None or not delay.any():
        return responses
    return Delays.of_outputs(delay.repeat(len(channels[0].input_labels))).rows(responses)


def _shared_errors(channel: ResponseMatrix, entry: int, seen: Mask) -> SharedErrors | None:
    """Return the errors that an entry of several has in common with others."""
    inputs = channel.response.shape[1]
    law = None if channel.errors is None else channel.errors.law
    if channel.errors is None or law is None or channel.window is None or len(channel.response) * inputs < 2:
        return None
    place, lines = divmod(entry, inputs), channel.window.lines(channel.omega[seen])
    return SharedErrors.of(law, place, float(channel.errors.noise_ratio[place[0]]), lines)


def refuse_unmeasured(matrix: ResponseMatrix, measured: Array) -> None:
    """Refuse an entry that no experiment measured: nothing is known of its residues."""
    rest = np.setdiff1d(np.arange(matrix.response[..., 0].size), measured)
    if rest.size:
        o, i = divmod(int(rest[0]), len(matrix.input_labels))
        more = f", and {rest.size - 1} more of {matrix.response[..., 0].size} responses" if rest.size > 1 else ""
        raise StructureError(
            f"the response of {matrix.output_labels[o]!r} to {matrix.input_labels[i]!r} was not measured at any "
            f"frequency{more}; fit the inputs and outputs that were measured with one another, data[outputs, inputs]"
        )


def is_short(rows: FreeRecord) -> bool:
    """Whether inputs act in a small part of a record, as hits do: their noise has no spectrum that lasts."""
    power = np.sum(rows.u**2, axis=0)
    return bool(np.sum(power) ** 2 < _LASTING * len(power) * np.sum(power**2))


def experiments_of(rows: Sequence[Any], channels: Experiments) -> Indices:
    """Which experiment each of some rows is from: experiments have rows for the outputs that they observe."""
    ends = np.cumsum([int(channel.observed.any(axis=-1).sum()) for channel in channels])
    starts = np.cumsum([0, *(len(record.outputs) for record in rows)])[:-1]
    return np.searchsorted(ends, starts, side="right")

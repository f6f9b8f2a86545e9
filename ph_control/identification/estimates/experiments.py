"""What a fit says of each experiment: prediction, free motions, offsets, and backgrounds of responses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..data.channels import Recording
from ..regression.free_prediction import FittedChannels
from ..regression.frequency_rows import FreeResponse
from ..regression.prediction import ResponseBackground
from ..regression.time_rows import FreeRecord
from .fitted_structure import FittedStructure, roots

_Rows = Iterator[tuple[int, tuple[Any, Any, Any]]]  # place, rows, what belongs to them alone, prediction


def fitted_channels(structure: FittedStructure) -> tuple[FittedChannels, ...]:
    """Predictions, free motions, offsets and backgrounds of each experiment, from the rows of its outputs."""
    projection = structure.measured
    rows = enumerate(zip(projection.experiments, projection.own, projection.predictions(), strict=True))
    return tuple(
        _of_recording(structure, channel, rows) if isinstance(channel, Recording)
        else _of_response(structure, channel, rows)
        for channel in structure.free.channels
    )  # fmt: skip


def _of_recording(structure: FittedStructure, channel: Recording, rows: _Rows) -> FittedChannels:
    """What the fit says of a recording, from the next of the rows."""
    projection, free = structure.measured, structure.free
    n, m, outputs = len(projection.p), len(channel.input_labels), len(free.scales)
    seen = channel.observed.any(axis=1)
    predicted = np.empty((outputs, channel.samples))
    predicted[~seen] = np.nan
    motion, offsets, drifts = np.zeros((n, outputs), complex), np.zeros(outputs), np.zeros(outputs)
    errors = np.full(outputs, np.nan)
    remaining = int(seen.sum())
    while remaining > 0:
        place, (part, own, values) = next(rows)
        which = part.outputs
        scale = free.scales[which] * getattr(part, "unit", 1.0)
        remaining -= len(which)
        residues = projection.residues[:, which] if n else np.zeros((0, len(which), m), complex)
        if isinstance(part, FreeRecord):
            motion[:, which] = 2 * scale * part.motion_at_start(projection.p, residues, own)[structure.rank]
            offsets[which], drifts[which] = scale * part.offset_at_start(own)
            if part.offset:
                errors[which] = scale * roots([spread[-1, -1] for spread, _ in structure.own_spreads(place)])
            values = part.placed(values)
        if len(which) == outputs:
            predicted = np.multiply(values, scale[:, None], out=values)
        else:
            predicted[which] = values * scale[:, None]
        predicted[which] += np.broadcast_to(channel.hum, predicted.shape)[which]
    return FittedChannels(
        channel.original, motion, offsets, drifts, predicted, offset_stderr=errors, noise_scale=channel.unit
    )


def _of_response(structure: FittedStructure, channel: Any, rows: _Rows) -> FittedChannels:
    """What the fit says of a response matrix, from the next of the rows."""
    free, n = structure.free, len(structure.measured.p)
    p, m, entries = len(channel.output_labels), len(channel.input_labels), len(free.scales)
    predicted = np.full((entries, channel.samples), complex(np.nan, 0.0))
    terms = np.zeros((2, 5, entries), complex)  # of the background, and their standard errors
    remaining = int(channel.observed.reshape(entries, -1).any(axis=1).sum())
    while remaining > 0:
        place, (part, own, values) = next(rows)
        which = part.outputs
        scale = free.scales[which] * getattr(part, "unit", 1.0)
        remaining -= len(which)
        if isinstance(part, FreeResponse):
            spread = np.array([np.diag(inner) for inner, _ in structure.own_spreads(place)]).T
            for term, *values_of in zip(part.terms, own, np.sqrt(np.maximum(spread, 0.0)), strict=True):
                terms[:, term.power + 2, which] += (1j if term.turned else 1.0) * scale * np.array(values_of)
        predicted[which] = values * scale[:, None]
    coefficients, errors = terms.reshape(2, 5, p, m)
    background = ResponseBackground(coefficients, errors, structure.request.quantities) if terms.any() else None
    nothing = np.zeros((n, 0), complex), np.zeros(p), np.zeros(p)
    return FittedChannels(channel, *nothing, predicted.reshape(p, m, channel.samples), background)

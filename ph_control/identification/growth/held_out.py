"""The order of damped modes whose model of a part of the data has the least error over the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Mask, RealOrComplex
from ...exceptions import IdentificationError
from ..data.channels import Recording, ResponseMatrix
from ..regression.free import FreeProjection
from ..regression.frequency_rows import FreeResponse
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import Experiments
from ..search.fitted_modes import HELD_OUT
from ..search.path import EXACT, FreePath
from .growing import chosen


def foretelling_order(
    channels: Experiments, start: ComplexArray, most: int, path_for: Callable[[Experiments], FreePath]
) -> int:
    """Return the order of the least error over what is held out, all outputs together; `path_for` starts a search."""

    def searched(path: FreePath) -> None:
        chosen(path, start, min(most, path.carried), True)

    errors = errors_ahead(channels, path_for, HELD_OUT, searched)
    values = {}
    for n, (losses, counts) in errors.items():
        seen = counts > 0
        if not seen.any():
            raise IdentificationError(
                "with a third of the data held out there are 0 observed outputs to predict; choose by 'bic'"
            )
        variances = np.maximum(losses[seen], np.finfo(float).tiny) / counts[seen]
        values[n] = float(np.sum(counts[seen] * np.log(variances)))
    return min(values, key=lambda n: (values[n], n))


def errors_ahead(
    channels: Experiments, path_for: Callable[[Experiments], FreePath], part: float,
    searched: Callable[[FreePath], None], orders: Sequence[int] | None = None,
) -> dict[int, tuple[Array, Array]]:  # fmt: skip
    """Return squared errors of each output over what is held out, and their number, by order.

    `path_for` starts a search in channels, `searched` runs it through the orders; of these all are judged, or `orders`.
    """
    ahead = [held_out(data.samples, part, isinstance(data, Recording)) for data in channels]
    # the search has only what comes before; its models are judged where the rest is missing
    rest, gaps = (
        [_without(data, hidden, shorter) for data, hidden in zip(channels, ahead, strict=True)]
        for shorter in (True, False)
    )
    path, judge = path_for(rest), path_for(gaps)
    searched(path)
    return {
        n: _errors(judge, row.poles, channels, ahead)
        for n, row in path.table.items() if orders is None or n in orders
    }  # fmt: skip


def held_out(samples: int, part: float, in_time: bool) -> Mask:
    """Which samples are held out: the end of a record, points all over a response, since neighbours foretell these."""
    if in_time:
        return np.asarray(np.arange(samples) >= samples - max(1, round(part * samples)))
    # where the running share of what is held out passes a whole number
    return np.asarray(np.diff(np.floor(part * np.arange(samples + 1) + 0.5)) > 0)


def _without(channel: Any, hidden: Mask, shorter: bool) -> Any:
    """An experiment whose outputs are missing at some samples; a recording ends before them if it may be shorter."""
    if isinstance(channel, ResponseMatrix):
        return replace(channel, response=np.where(hidden, np.nan, channel.response))
    if shorter:
        return replace(channel, time=channel.time[~hidden], u=channel.u[:, ~hidden], y=channel.y[:, ~hidden])
    return replace(channel, y=np.where(hidden, np.nan, channel.y))


def _errors(path: FreePath, p: ComplexArray, channels: Experiments, ahead: Sequence[Mask]) -> tuple[Array, Array]:
    """Weighted squares of each output where it is held out, of modes refined over the rest, and their number."""
    projection = path.refined(path.reweighted(path.model(p)).p, EXACT, None)
    outputs, sizes = len(path.counts), path.sizes[:, None]
    losses, counts, rows = np.zeros(outputs), np.zeros(outputs), iter(_foretold(projection))
    for channel, hidden in zip(channels, ahead, strict=True):
        data: Any = channel
        measured = data.y if isinstance(data, Recording) else data.response.reshape(outputs, -1)
        weights = np.reshape(getattr(data, "weights", np.ones(measured.shape)), measured.shape)
        remaining = int(np.any(~np.isnan(measured) & ~hidden, axis=1).sum())
        while remaining > 0:
            which, values = next(rows)
            remaining -= len(which)
            errors = measured[which] - values / sizes[which]
            seen = hidden & ~np.isnan(errors)
            losses[which] += np.sum(np.where(seen, weights[which] * np.abs(errors) ** 2, 0.0), axis=1)
            counts[which] += seen.sum(axis=1) * (1 + np.iscomplexobj(errors))
    return losses, counts


def _foretold(projection: FreeProjection) -> list[tuple[Any, RealOrComplex]]:
    """Outputs of each of the rows, and what they are at all samples, also where nothing was measured."""
    n, foretold, predictions = len(projection.p), [], list[Any](projection.predictions())
    for rows, own, values in zip(projection.experiments, projection.own, predictions, strict=True):
        if isinstance(rows, FreeResponse):
            everywhere = replace(rows, observed=np.ones(len(rows.frequencies), bool), white=None)
            weights = np.concatenate([own, projection.shared[: 2 * n + rows.through, rows.outputs]])
            # few points have no background
            values = (
                weights.T @ everywhere.out_of_rows(everywhere.columns(projection.p))[-len(weights) :]
                if len(weights)
                else 0.0
            )
            values = values * np.exp(-1j * rows.frequencies * (rows.delay or 0.0))
        elif isinstance(rows, FreeRecord):
            values = rows.placed(values)
        foretold.append((rows.outputs, np.zeros((len(rows.outputs), 1)) if not np.size(values) else np.asarray(values)))
    return foretold

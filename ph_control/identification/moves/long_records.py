"""Long records, and records whose noise changes: modes of parts, refined over all samples."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..._types import ComplexArray
from ..data.channels import Recording
from ..data.time_record import cut, searched_part, stages
from ..growth.ending import end_of_search, finished
from ..regression.free import FreeProjection
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments, RowOptions
from ..search.fitted_modes import FreeFit
from ..search.free_search import FreeModel
from ..search.path import FreePath, SearchOptions
from .assumptions import Assumptions, Fit, alone

_SHORTEST_SPAN = 32  # samples of one level of noise that are searched


def of_long(
    channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None, fitted: Fit
) -> FreeFit:
    """Fit modes to a part of long records, and refine them over longer and longer ones, up to all samples."""
    part = [searched_part(channel, not assumptions.moving) for channel in channels]
    parts = [cut(channel, span) for channel, span in zip(channels, part, strict=True)]
    fit = fitted(parts, order, replace(assumptions, beside=alone, white=False), start)
    if fit.interrupted:
        return fit
    largest = None if isinstance(order, int) else assumptions.max_order
    best, path = FreeModel(fit.projection, [], fit.projection.losses * fit.scales**2), None
    while path is None or any(
        span.stop - span.start < channel.samples for span, channel in zip(part, channels, strict=True)
    ):
        part = [next(stages(span, channel.samples), span) for span, channel in zip(part, channels, strict=True)]
        longer = [cut(channel, span) for channel, span in zip(channels, part, strict=True)]
        path = _path_as_of(fit, longer, assumptions, largest, best)
        projection = path.refined(best.p, TUNING.rough, None)
        path.best = best = FreeModel(projection, [], path.in_data(projection.losses), path.search)
    whole = end_of_search(path, best.p, len(best.p), False, channels, either_hold=assumptions.intersample == "auto")
    whole = whole.with_rival(lambda rival: replace(rival, order_table=fit.order_table))
    return replace(
        whole, order_table=fit.order_table, findings=fit.findings, delay_gain=fit.delay_gain
    ).with_delay_open(fit.delay_open)


def in_changing_noise(
    channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None, fitted: Fit
) -> FreeFit:
    """Fit modes to spans of one level of recordings whose noise changes, and refine them over all samples.

    Plants at rest before the recordings, which are in motion where others of the spans begin, are looked for in the
    noise of all of them.
    """
    recordings = [channel for channel in channels if isinstance(channel, Recording)]
    moving = assumptions.moving
    spans = [part for data in recordings for part in (_spans_of_one_level(data) if moving else [data.of_one_level])]
    fit = fitted(spans, order, replace(assumptions, beside=alone, white=False), start)
    path = _path_as_of(fit, channels, assumptions)
    path.table = {row.order: row for row in fit.order_table}
    model = FreeModel(fit.projection, [], path.power, path.search)
    if fit.interrupted:
        path.weigh(path.in_data(FreeProjection(path.scaled.data, fit.projection.p).losses))
        return replace(finished(path, model, channels, interrupted=True), interrupted=True)
    path.best = replace(model, losses=path.in_data(path.refined(fit.projection.p, TUNING.rough, None).losses))
    whole = end_of_search(
        path, fit.projection.p, fit.order, False, channels, either_hold=assumptions.intersample == "auto"
    )
    return replace(whole, findings=fit.findings, delay_gain=fit.delay_gain).with_delay_open(fit.delay_open)


def _path_as_of(
    fit: FreeFit, channels: Experiments, assumptions: Assumptions, largest: int | None = None,
    best: FreeModel | None = None,
) -> FreePath:  # fmt: skip
    """Begin a search in other channels, with the hold, offset, delays and noise of a fit."""
    form = RowOptions(
        assumptions.quantities, fit.intersample, fit.offset, assumptions.moving, assumptions.method, fit.lateness
    )
    options = SearchOptions(assumptions.criterion, assumptions.reports, assumptions.real_poles, largest=largest)
    return FreePath.of(channels, form, options, best, fit.noise)


def _spans_of_one_level(recording: Recording) -> list[Recording]:
    """Return recordings of the spans in which noise has one level, but for those too short to be searched.

    Spans end at different samples where outputs change by themselves.
    """
    ends = [0, *recording.changes.tolist(), recording.samples]
    return [
        cut(recording, slice(first, last)) for first, last in pairwise(ends)
        if last - first >= min(_SHORTEST_SPAN, max(np.diff(ends)))
    ]  # fmt: skip

"""The number of modes, with noise as coloured as the criterion prefers."""

from __future__ import annotations

import numpy as np

from ..._types import ComplexArray
from ..data.time_record import cut, searched_part
from ..regression.free import FreeProjection
from ..search.channel_rows import Experiments, RowOptions, is_short
from ..search.fitted_modes import are_broad, count_modes
from ..search.free_search import FreeModel, Records
from ..search.path import FreePath
from .growing import grown, improved, likelier, of_common_denominator, with_modes


def chosen(path: FreePath, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
    """Search for the model of an order, or of the best, with noise as coloured as the criterion prefers."""
    if path.innovations:
        return _joint(path, start, most, automatic)
    model = _in_rows(path, start, most, automatic)
    # coloured noise would take over what a plant lacks that has too few modes, when their number is given; beside
    # modes with a peak it would take over the weak ones, though broad noise is no mode with a peak in any case
    peaks = bool(np.any((model.p.imag > 0) & ~are_broad(model.p)))
    if peaks or not ((automatic or not most) and _coloured(path, model)):
        return model
    # noise of a model that is too small has what this lacks: in its rows others are looked for, and from nothing
    models = [path.in_its_noise(model)]
    if path.options.real_poles == "auto":
        models.append(_in_rows(path, models[0].p, most, automatic))
    return min([*models, _joint(path, start, most, automatic)], key=path.cost)


def _coloured(path: FreePath, model: FreeModel) -> bool:
    """Whether the criterion prefers coloured noise, where something acts all along; spans of a record may be idle."""
    driven = isinstance(path.plain, Records) and any(
        record.inputs and not is_short(record) for record in path.plain.data
    )
    return driven and bool(path.noise_filters(model)) and not np.any(model.losses <= path.floors)


def _joint(path: FreePath, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
    """Grow a model from a start with the noise that belongs to each step."""
    path.whiten((), path.power)
    model = grown(path, start, most, automatic, path.in_its_noise)
    path.whiten(model.innovations, model.losses)
    return path.in_its_noise(improved(path, model, most, automatic))


def _in_rows(path: FreePath, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
    """Search for the model of an order, or of the best, in the noise of the present rows."""
    model = improved(path, grown(path, start, most, automatic), most, automatic)
    if not automatic and len(model.p) and not (path.is_exact(model) or path.is_white(model)):
        model = of_common_denominator(path, model, most, automatic) or model
    other = likelier(path, model, most) if automatic else None
    if other is not None:
        other = improved(path, grown(path, other.p, most, automatic), most, automatic)
        model = min(model, other, key=path.cost)
    return model


def through_orders(path: FreePath, start: ComplexArray, most: int) -> None:
    """Let modes join one by one from a start up to a number of them; the table has the best of each order.

    The path ends where the data are reproduced to rounding.
    """
    model: FreeModel | None = path.reweighted(path.model(start))
    while model is not None and count_modes(model.p) < most and np.any(model.losses > path.floors):
        model = with_modes(path, model, count_modes(model.p) + 1, False)


def orders_about(
    channels: Experiments, poles: ComplexArray, most: int, form: RowOptions
) -> list[tuple[ComplexArray, ComplexArray]]:
    """Return poles and residues (n, p, m) of ascending orders, one more mode each: to some poles, and on to the most.

    Real poles stay, and are left out.
    Without inputs the residues are motions in the experiments.
    """
    channels = [cut(channel, searched_part(channel, not form.moving)) for channel in channels]
    path = FreePath.of(channels, form)
    orders = []
    for start, end in ((poles[poles.imag == 0], count_modes(poles) - 1), (poles, min(most, path.carried))):
        model: FreeModel | None = path.reweighted(path.model(start))
        while model is not None:
            modes = model.p.imag > 0
            if modes.any():
                orders.append((model.p[modes], _residues(path, model.projection, channels)[modes]))
            model = with_modes(path, model, count_modes(model.p) + 1, False) if count_modes(model.p) < end else None
    return orders


def _residues(path: FreePath, projection: FreeProjection, channels: Experiments) -> ComplexArray:
    """Return residues in the units of the data, shape (n, p, m); without inputs motions in the experiments."""
    n, p, m = len(projection.p), len(channels[0].output_labels), len(channels[0].input_labels)
    if m:
        return np.asarray(projection.residues / path.sizes[:, None]).reshape(n, p, m)
    motions = np.zeros((n, p, len(channels)), complex)
    measured, done = np.cumsum([int(channel.observed.any(axis=-1).sum()) for channel in channels]), 0
    for rows, own in zip(projection.experiments, projection.own, strict=True):
        place = int(np.searchsorted(measured, done, side="right"))
        motions[:, rows.outputs, place] = (own[:n] + 1j * own[n : 2 * n]) / path.sizes[rows.outputs]
        done += len(rows.outputs)
    return motions

"""Structures of plants whose outputs come late: free residues absorb what of a delay turns them.

A delay turns the residue of each mode by its own angle, and so a plant with a structure and a delay looks like one
without either. What the delay buys is the structure, which has fewer unknowns.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.signal import argrelmin

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, Mask
from ..._units import DERIVATIVES
from ..regression.free import Delays, FreeProjection, FreeRows
from ..regression.sections import PoleRegion
from ..regression.tuning import TUNING
from .constrained import Approach, StructuredFit
from .coordinates import ChannelLayout

_GRID = 16  # delays that are compared within the interval between samples
_REST = 0.05  # of the squares by which residues are off a structure, which delays may leave,
_BY_CHANCE = 3.0  # and of each residue in units of its variance: what leaves more is no delay
_STARTS = 2  # common delays that are tried
_MARGIN = 1.5  # samples by which a search may go beyond where it began
_BROAD = 0.2  # damping ratio from which on modes may stand for a delay
_ITERATIONS = 12  # of the most promising start
_FAR = 10.0  # times what free residues leave: from there no way leads to what they leave


@dataclass(frozen=True)
class DelayedStructure:
    """A structure with delays, and the free model in the same rows.

    Attributes
    ----------
    fit : StructuredFit
        Minimum of the loss over the models of the structure and the delays.
    free : FreeProjection
        Poles and free residues in the rows with these delays.
    """

    fit: StructuredFit
    free: FreeProjection


def cost_of(fit: StructuredFit, scales: Array) -> float:
    """BIC of a structure for each row of the data, in their units, with the variance of each output at its best.

    What is left of exact data is rounding, which grows with the samples, and tells no model from another.
    """
    projection = fit.projection
    counts = np.zeros(len(projection.losses))
    for rows in projection.experiments:
        counts[rows.outputs] += rows.samples
    least = np.maximum(projection.rounding, np.finfo(float).tiny)
    losses = scales**2 * np.maximum(projection.losses, least) / np.maximum(counts, 1)
    own = projection.unknowns - len(projection.x) - int(projection.excited_unknowns.sum())
    return float(np.sum(counts * np.log(losses)) + (fit.parameters + own) * np.log(projection.rows)) / projection.rows


def with_delays(
    projection: FreeProjection, layout: ChannelLayout, hypothesis: str, region: PoleRegion, fed: Mask, *, settled: bool
) -> DelayedStructure | None:
    """Fit a structure with delays of the outputs to the data of a free fit, where residues may be those of a delay.

    Parameters
    ----------
    projection : FreeProjection
        Minimum of the free fit, in rows that may have delays already.
    layout : ChannelLayout
        Inputs and outputs, their units and ports.
    hypothesis : str
        The structure.
    region : PoleRegion
        Where poles are looked for.
    fed : ndarray of bool, shape (outputs of the projection, inputs)
        What is fed through in any case; other entries where they are in the free fit, and improve the criterion.
    settled : bool
        Whether the structure holds with the delays there are, which are refined.

    Returns
    -------
    DelayedStructure or None
        The best of a delay common to all outputs, and one of each; None where none comes near to the free fit.
    """
    now = delays_of(projection)
    starts = [Delays.of_outputs(now)] if settled else list(_starts(projection, layout, now, region.ceiling))
    if settled and np.ptp(now) == 0 and len(now) > 1:
        starts.append(Delays(_outputs_of(layout), now[np.unique(_outputs_of(layout), return_index=True)[1]]))
    through = [fed] + [projection.fed_through] * bool(np.any(projection.fed_through & ~fed))
    if settled and len(through) > 1:  # what a part of a sample earlier is fed through is not
        starts += [Delays(each.groups, each.values - 0.5 * np.pi / region.ceiling) for each in starts]
    light = np.abs(projection.p.real) < _BROAD * np.abs(projection.p)
    poles = [projection.p] + [projection.p[light]] * bool(light.any() and not light.all() and not settled)
    masks = through if projection.has_feedthrough else [None]
    ways = list(product(poles, masks))
    beginnings = [
        each for delays in starts
        for each in _begun(projection, layout, hypothesis, region, ways, _bounded(delays, region))
    ]  # fmt: skip
    if not beginnings:
        return None
    _, beginning, mask = min(beginnings, key=lambda each: each[0])
    approach = beginning.continued(_ITERATIONS)
    known = approach.fit
    far = known.loss / known.projection.rows > _FAR * projection.loss / projection.rows
    if far and not (settled or known.converged):
        return None
    fit = approach.continued(None).fit
    return DelayedStructure(fit, FreeProjection(fit.projection.experiments, fit.p, mask))


def _begun(
    projection: FreeProjection, layout: ChannelLayout, hypothesis: str, region: PoleRegion,
    starts: Iterable[tuple[ComplexArray, Mask | None]], delays: Delays,
) -> Iterator[tuple[float, Approach, Mask | None]]:  # fmt: skip
    """Yield what descents promise, as a BIC for each row of the data, where they begin, and what is fed through."""
    rows: Sequence[FreeRows] = delays.rows(projection.experiments)  # type: ignore[type-var]
    for p, mask in starts:
        start = FreeProjection(rows, p, mask)
        beginning = Approach.from_free_fit(start, layout, hypothesis, region.about(start.sections), delays)
        yield cost_of(beginning.fit, layout.scales) + np.log(max(beginning.predicted_share, EPS)), beginning, mask


def delays_of(projection: FreeProjection) -> Array:
    """Delay of each output in the rows of a projection."""
    delays = np.zeros(projection.shared.shape[1])
    for rows in projection.experiments:
        if rows.inputs:
            delays[rows.outputs] = rows.delay_time
    return delays


def _outputs_of(layout: ChannelLayout) -> Indices:
    """Output of each output of the projection."""
    return np.arange(layout.outputs).repeat(layout.inputs if layout.per_entry else 1)


def _bounded(delays: Delays, region: PoleRegion) -> Delays:
    """Delays between bounds, for steps that hardly turn the fastest motion there may be."""
    step = np.pi / region.ceiling
    first, last = float(delays.values.min()), float(delays.values.max())
    return Delays(delays.groups, delays.values, step / np.pi, first - _MARGIN * step, last + _MARGIN * step)


def _starts(projection: FreeProjection, layout: ChannelLayout, now: Array, ceiling: float) -> Iterator[Delays]:
    """Delays, one for all outputs or one of each, that turn residues into those of shapes that are real."""
    step, groups = np.pi / ceiling, _outputs_of(layout)
    grid = step * np.arange(TUNING.delays[0], TUNING.delays[-1] + 0.5 / _GRID, 1.0 / _GRID)
    prior = 2 * TUNING.delay_prior * np.abs(grid) / step
    there = [now[groups == output][:1] for output in range(layout.outputs)]
    each = np.stack([beside_real_shapes(projection, layout, k, grid - known) for k, known in enumerate(there)])
    none = np.concatenate([beside_real_shapes(projection, layout, k, -known) for k, known in enumerate(there)])
    count = np.sum(projection.p.imag > 0) * layout.outputs * layout.inputs
    most = min(none.sum() - 2 * TUNING.sure, _REST * none.sum() + _BY_CHANCE * count)
    total = each.sum(axis=0) + prior
    minima = np.unique(np.append(argrelmin(total)[0], np.argmin(total)))
    for place in minima[np.argsort(total[minima])][:_STARTS].tolist():
        if total[place] < most:
            yield Delays(np.zeros_like(groups), grid[[place]])
    if layout.outputs > 1:
        places = np.argmin(each + prior, axis=1)
        if np.sum((each + prior)[np.arange(len(each)), places]) < most:
            yield Delays(groups, grid[places])


def beside_real_shapes(projection: FreeProjection, layout: ChannelLayout, output: int, delays: Array) -> Array:
    """Squared distance of residues of an output from those of real shapes, in standard errors, for each added delay."""
    residues, _ = layout.split(projection.shared, len(projection.p))
    errors, _ = layout.split(
        projection.shared_errors * np.sqrt(projection.loss / max(1, projection.rows - projection.unknowns)),
        len(projection.p),
    )
    modes = projection.p.imag > 0
    p, rho, error = projection.p[modes], residues[modes, output], np.abs(errors[modes, output]) / np.sqrt(2)
    factor = (p ** DERIVATIVES[layout.quantities[output]] / (2j * p.imag))[:, None]
    shape, size = rho / factor, np.where(error > 0, error, np.inf) / np.abs(factor)
    turned = shape[None] * np.exp(1j * np.multiply.outer(delays, p.imag))[:, :, None]
    beside: Array = (turned.imag / size) ** 2
    for port_output, source in layout.ports:
        if port_output == output:
            beside[:, :, source] += (np.minimum(turned.real[:, :, source], 0.0) / size[:, source]) ** 2
    return np.asarray(beside.sum(axis=(1, 2)))

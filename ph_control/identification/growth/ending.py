"""The last minimum of a search, and that with the inputs held otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Mask
from ..regression.free import FreeProjection
from ..regression.tuning import TUNING
from ..search.fitted_modes import FreeFit, are_broad
from ..search.free_search import FreeModel, Records
from ..search.path import EXACT, FreePath
from .backgrounds import beside_further_terms, on_simplest_background
from .choosing import chosen
from .constants import evidence_of_constants
from .settling import fed_through, needless_mode, settled

_DECIDED = 0.01  # decrease, in variances of the noise, at which what belongs to the model beside poles can be told


def end_of_search(
    path: FreePath, start: ComplexArray, most: int, automatic: bool, channels: Sequence[Any], *, either_hold: bool
) -> FreeFit:
    """Search, if no model is known, and return the last minimum, with what makes that under the other hold.

    Residues and a feedthrough of one hold say what others say of the other.  So free models tell the two apart only
    where something is fed through: then the likelier comes first.  Of a search that is interrupted the best so far,
    if it has a mode.
    """
    fit: FreeFit | None = None
    try:
        if path.best is None:
            path.best = chosen(path, start, most, automatic)
            beside = beside_further_terms(path, most, automatic)
            if beside is not None:
                return end_of_search(beside, start, most, automatic, channels, either_hold=either_hold)
        fit = finished(path, path.best, channels, automatic)
        if not (either_hold and isinstance(path.plain, Records) and fit.states and fit.projection.inputs):
            return fit
        held_otherwise = cache(partial(_held_otherwise, path, fit, path.best, path.plain, channels, automatic))
        fit = replace(fit, held_otherwise=held_otherwise)
        if fit.projection.fed is not None and not fit.projection.fed.any():
            return fit
        rival = held_otherwise()
    except KeyboardInterrupt:
        if fit is not None:
            return replace(fit, interrupted=True, held_otherwise=None)
        if path.best is None or not len(path.best.p):
            raise
        return finished(path, path.best, channels, interrupted=True)
    if fit.criteria.bic - rival.criteria.bic > 2 * TUNING.sure:
        return replace(rival, held_otherwise=cache(lambda: fit))
    return fit


def _held_otherwise(
    path: FreePath, fit: FreeFit, model: FreeModel, plain: Records, channels: Sequence[Any], automatic: bool
) -> FreeFit:
    """Refine a fit with the inputs held otherwise."""
    kept = replace(model, projection=fit.projection)
    other = plain.held("foh" if fit.intersample == "zoh" else "zoh")
    again = finished(path.elsewhere(other, kept, fit.noise), kept, channels, automatic)
    return replace(again, order_table=fit.order_table)


def finished(
    path: FreePath, model: FreeModel, channels: Sequence[Any], automatic: bool = False, interrupted: bool = False
) -> FreeFit:
    """Find the last minimum of a model; what is fed through only where it stands out, or has to be.

    Of an `automatic` order without modes that only the bins about them asked for.  Who interrupts wants an end:
    then the poles stay as they are.
    """
    path.whiten(model.innovations, model.losses)
    # the exact minimum is that of what remains; real and broad poles that are one too many are told at the minimum
    enough = EXACT if automatic and np.any((model.p.imag == 0) | are_broad(model.p)) else _DECIDED / path.counts.sum()
    near = None if interrupted else float(enough)
    projection, losses = settled(path, model.p, None, near)
    while automatic and (weakest := needless_mode(path, projection)) is not None:
        projection, losses = settled(path, np.delete(projection.p, weakest), None, near)
    fed: Mask | None = None
    if projection.has_feedthrough and not path.felt.all():
        fed = path.felt | fed_through(path, projection)
        if not fed.all():
            projection, losses = settled(path, projection.p, fed, near, projection)
    # noise of slow colour hides a constant that is still the level of the output
    if path.options.constant_open and not (interrupted or model.innovations):
        projection, losses = _without_needless_constants(path, projection, losses, fed, near)
    projection, losses = on_simplest_background(path, projection, losses, fed, near)
    if not interrupted:
        projection, losses = settled(path, projection.p, fed, EXACT, projection)
    projection = projection.ascending()
    unknowns = path.unknowns_of(projection.p) - (0 if fed is None else int(np.sum(~fed)))
    table = tuple(path.table[n] for n in sorted(path.table))
    criteria = path.criteria(path.loglik(losses), unknowns)
    rounding = bool(np.any(losses <= path.floors))
    measured = FreeProjection(path.plain.scaled(path.sizes).data, projection.p, fed) if model.innovations else None
    return FreeFit(
        projection, tuple(channels), 1.0 / path.sizes, table, path.region(projection.p), unknowns, criteria,
        rounding, interrupted, measured=measured, noise=model.innovations, delay=path.delay,
        input_delay=path.input_delay, crowded=path.crowded,
    )  # fmt: skip


def _without_needless_constants(
    path: FreePath, projection: FreeProjection, losses: Array, fed: Mask | None, rtol: float | None
) -> tuple[FreeProjection, Array]:
    """Find the minimum without constants of the outputs, unless these stand out, and the losses of outputs.

    Beside an integrator, or what is nearly one, a constant is the same as its initial state, and its own error says
    nothing: what it explains is seen without it.
    """
    constants = sum(len(rows.outputs) for rows in path.search.data)
    least = max(2 * TUNING.likely, constants * np.log(projection.rows))
    weak = evidence_of_constants(projection) < least
    if not weak and not np.any(np.abs(projection.p) < path.scaled.region.bin):
        return projection, losses
    kept = path.plain, path.search
    path.drop_constants(losses)
    level, level_losses = settled(path, projection.p, fed, rtol)
    if weak or 2 * (path.loglik(losses) - path.loglik(level_losses)) < least:
        return level, level_losses
    path.plain, path.search = kept
    path.weigh(losses)
    return projection, losses

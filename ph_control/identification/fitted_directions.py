"""The directions in which a fit has adapted to its data: what noise has along them is missing from the residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from .data import Record
from .frequency_data import FrequencyRecord
from .frequency_rows import modal_columns
from .prediction import FittedExperiment
from .regressors import Hold, regressors
from .result import PEMResult


@dataclass(frozen=True)
class Directions:
    """Derivatives of an output by what was fitted, one column each: to all experiments, and to this one alone."""

    shared: NDArray[Any]
    local: NDArray[Any]


def same_data(one: Any, other: Any) -> bool:
    """Whether two experiments are one."""
    if one is other:
        return True
    if isinstance(one, FrequencyRecord) and isinstance(other, FrequencyRecord):
        return np.array_equal(one.omega, other.omega) and np.array_equal(one.response, other.response, equal_nan=True)
    if not (isinstance(one, Record) and isinstance(other, Record)):
        return False
    return (
        one.samples == other.samples
        and one.driven == other.driven
        and abs(one.dt - other.dt) <= _checks.EPS * one.samples * one.dt
        and np.array_equal(one.u, other.u)
        and np.array_equal(one.y, other.y, equal_nan=True)
    )


def fitted_directions(model: PEMResult, place: int) -> Directions:
    """Derivatives of the prediction of one experiment by `(d, kappa)`, and by its own free motion and offset.

    O(T n), and as much memory.
    """
    one = model.experiments[place]
    seen = [l for l in range(model.order) if l not in model.unseen]
    weighted = [l not in model.active for l in seen]
    if isinstance(one.record, FrequencyRecord):
        columns, slopes = modal_columns(model.d[seen], one.record.omega, model.quantity)
        by_d = model.modes.kappa[seen][:, None] * slopes
        return Directions(np.concatenate([by_d, columns[weighted]]).T, np.zeros((one.record.samples, 0)))
    return _in_time(model, one, one.record, seen, weighted, bool(np.isfinite(model.offset_stderr[place])))


def _in_time(
    model: PEMResult, one: FittedExperiment, record: Record, seen: list[int], weighted: list[bool], offset: bool
) -> Directions:
    d, kappa, free = model.d[seen], model.modes.kappa[seen], one.free_amplitudes[seen]
    found = regressors(d, record.u, Hold(record.dt, model.method, model.intersample), model.quantity)
    # without an input the forced columns are 0
    by_d = kappa * found.forced_slope + free.real * found.cosine_slope + free.imag * found.sine_slope
    shared = np.concatenate([by_d, found.forced[:, weighted]], axis=1)
    parts = [np.zeros((record.samples, 0))]
    if free.any():
        moving = weighted if model.representation == "controllable" else [True] * len(seen)
        parts += [found.cosine[:, moving], found.sine[:, moving]]
    if offset:
        parts.append(np.ones((record.samples, 1)))
    return Directions(shared, np.concatenate(parts, axis=1))

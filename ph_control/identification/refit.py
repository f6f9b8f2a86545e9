"""The problem that a result solved, made again from what the result says of itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from .data import Record
from .experiment import Experiment
from .frequency_data import FrequencyRecord
from .frequency_rows import FrequencyRows
from .regressors import Hold
from .solver import Problem


def rows_of(
    record: Record | FrequencyRecord, hold: Hold | None, quantity: str, *, from_rest: bool, offset: bool
) -> Any:
    """What one record offers to the solver; a frequency response has no hold."""
    if isinstance(record, FrequencyRecord):
        return FrequencyRows(record, quantity)
    if hold is None:
        raise ValueError("a record in time needs a hold")
    rest = from_rest and record.driven
    return Experiment(record.u, record.y, record.observed, hold, rest, offset, quantity, record.driven)


def problem_of(result: Any) -> Problem:
    """Problem that a `PEMResult` is the minimum of, its data included."""
    offset = bool(np.isfinite(result.offset_stderr).any())
    rest = starts_from_rest(result)
    rows = []
    for one in result.experiments:
        record = one.record
        hold = Hold(record.dt, result.method, result.intersample) if isinstance(record, Record) else None
        rows.append(rows_of(record, hold, result.quantity, from_rest=rest, offset=offset))
    return Problem(tuple(rows), structured=result.representation == "controllable")


def starts_from_rest(result: Any) -> bool:
    """Whether the records with an input were taken to start at rest: no free motion was estimated for them."""
    driven = [one for one in result.experiments if isinstance(one.record, Record) and one.record.driven]
    # an estimate of a free motion that is exactly 0 does not occur
    return bool(driven) and not any(one.free_amplitudes.any() for one in driven)

"""The problem that a result solved, made again from what the result says of itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..data.time_record import Record
from ..regression.variable_projection import Problem
from ..search.formulation import rows_of


def problem_of(result: Any) -> Problem:
    """Problem that a `PEMResult` is the minimum of, its data included."""
    offset = int(np.isfinite(result.offset_stderr).any())
    rest = starts_from_rest(result)
    rows = []
    for one in result.experiments:
        rows.append(
            rows_of(
                one.record,
                result.method,
                result.intersample,
                result.quantity,
                from_rest=rest,
                offset=offset + (one.drift != 0),
            )
        )
    return Problem(tuple(rows), structured=result.representation == "controllable")


def starts_from_rest(result: Any) -> bool:
    """Whether the records with an input were taken to start at rest: no free motion was estimated for them."""
    driven = [one for one in result.experiments if isinstance(one.record, Record) and one.record.driven]
    # an estimate of a free motion that is exactly 0 does not occur
    return bool(driven) and not any(one.free_amplitudes.any() for one in driven)

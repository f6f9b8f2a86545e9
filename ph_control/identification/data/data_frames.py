"""Records from anything that quacks like a data frame: it has `columns`, and gives a column by its label."""

from __future__ import annotations

from typing import Any

import numpy as np

from ... import _checks
from ...exceptions import StructureError
from ...io.text_table import is_time_label, unit_of_time
from .channels import Recording, recording
from .time_record import instants, refuse_short, signal, uniform_time

_SHOWN = 30  # labels of columns listed in a message


def is_data_frame(data: Any) -> bool:
    """Whether an object has the two things that are used of a data frame."""
    return hasattr(data, "columns") and hasattr(type(data), "__getitem__")


def recording_of_frame(frame: Any, dt: Any = None, *, output_needed: bool = True) -> Recording:
    """Recording of a data frame with columns of the time (or none, with `dt`), the input and the output, in that order.

    The time is recognised by its label, as `phc.read_csv` does; of the two that remain the first is the input.
    """
    columns = list(frame.columns)
    labels = [str(column) for column in columns]
    for label in labels:
        if labels.count(label) > 1:
            raise StructureError(f"the data frame has {labels.count(label)} columns called {label!r}; rename them")
    clock = _time_column(labels, dt)
    rest = [k for k in range(len(columns)) if k != clock]
    if len(rest) != 2 and (output_needed or len(rest) != 1):
        raise StructureError(
            f"which column is the input and which the output? {len(rest)} columns are left beside the time; keep one "
            f"of each, the input first, or pass (u, y), of a free motion (None, y), with dt ({_listing(labels)})"
        )
    names = [f"the {role} (column {labels[k]!r})" for role, k in zip(("input", "output"), rest, strict=False)]
    u = signal(names[0], _column(frame, columns[rest[0]]))
    y = signal(names[1], _column(frame, columns[rest[1]]), missing=True) if len(rest) == 2 else np.full(len(u), np.nan)
    inputs, outputs = (labels[rest[0]],), (labels[rest[1]] if len(rest) == 2 else "y",)
    if clock is None:
        return recording(None, _checks.sampling_step(dt), [u], [y], inputs, outputs)
    name = f"the time (column {labels[clock]!r})"
    recorded = signal(name, _column(frame, columns[clock]))
    refuse_short(len(recorded))
    time, step = uniform_time(name, recorded, dt)
    # the grid that instants in print stand for, as in a recording that was read from a file
    grid = instants(len(time), step, float(time[0]))
    return recording(grid, step, [u], [y], inputs, outputs, time_unit=unit_of_time(labels[clock]))


def _time_column(labels: list[str], dt: Any) -> int | None:
    found = [k for k, label in enumerate(labels) if is_time_label(label)]
    if len(found) > 1:
        names = " and ".join(repr(labels[k]) for k in found)
        raise StructureError(f"the columns {names} of the data frame may both be the time; drop the one that is not")
    if not found and dt is None:
        raise StructureError(
            f"no column of the data frame is called time or t; rename the one that is (an index is no column: "
            f"reset_index() makes it one), or give the time between samples with dt ({_listing(labels)})"
        )
    return found[0] if found else None


def _listing(labels: list[str]) -> str:
    more = f" and {len(labels) - _SHOWN} more" if len(labels) > _SHOWN else ""
    return "the columns are " + ", ".join(map(repr, labels[:_SHOWN])) + more


def _column(frame: Any, label: Any) -> Any:
    try:
        return frame[label]
    except (KeyError, IndexError, TypeError) as error:
        raise StructureError(
            f"column {str(label)!r} of the {type(frame).__name__} cannot be read: {error}; pass a data frame in "
            "memory, or (u, y) with dt"
        ) from None

"""Recordings from anything that quacks like a data frame: it has `columns`, and gives a column by its label."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from datetime import timezone
from typing import Any

import numpy as np
from control import TimeResponseData

from ... import _checks
from ..._checks import labelled
from ..._display import first_of
from ..._units import checked_unit
from ...exceptions import StructureError
from ...io.tables.columns import is_time_label, unit_of_time
from ...io.time_csv import recording as response
from ..data import channels
from .time_record import instants, refuse_contradiction, refuse_short, signal, uniform_time

_SHOWN = 30  # labels of columns listed in a message


def is_data_frame(data: object) -> bool:
    """Whether an object has the two things that are used of a data frame, or of a dataset of xarray."""
    return (hasattr(data, "columns") or hasattr(data, "data_vars")) and hasattr(type(data), "__getitem__")


def recording(
    frame: object,
    input: Any = None,
    output: Any = None,
    *,
    time: object = None,
    dt: float | None = None,
    fs: float | None = None,
    time_unit: str | None = None,
) -> TimeResponseData:
    """Make a recording of columns of a data frame.

    Parameters
    ----------
    frame : pandas.DataFrame, polars.DataFrame, xarray.Dataset, or mapping of labels to arrays
        Signals of shape (T,) by label.  Not modified.
    input, output : str, or list of str, optional
        Labels of the inputs and outputs, with or without their unit.  `input=False` says that there is no input, as in
        a free decay.
        Default: the columns that are left; with neither given and two left, the first is the input.
    time : str, optional
        Label of the time.  Default: the index, where it holds times, else the column labelled `t`, `time` or the like.
        Dates and times become seconds from the first.
    dt, fs : float, optional
        Time between samples, or samples per unit of time, where there is no time; `time=False` says that no column,
        nor the index, is the time.
    time_unit : {'ns', 'us', 'ms', 's', 'min', 'h'}, optional
        Unit of the time.  Default: the one in its label, as in `Time (ms)`; seconds of dates.

    Returns
    -------
    control.TimeResponseData
        What `read_csv` gives of a file with these columns.

    Raises
    ------
    StructureError
        If columns are missing or ambiguous, or hold other things than numbers, or the time is not uniform.
    IdentificationError
        If there are fewer than two samples.

    Notes
    -----
    O(T).  The instants may be off a uniform grid by what rounding in print makes of them.

    See Also
    --------
    read_csv : of a file.
    pem : takes a data frame of one input and one output as it is.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> t = 0.001 * np.arange(2000)
    >>> frame = {"t [s]": t, "hammer [N]": np.sin(t), "accel 1 [g]": np.cos(t), "accel 2 [g]": np.cos(t)}
    >>> data = phc.recording(frame, input="hammer", output=["accel 1", "accel 2"])
    >>> data.inputs.shape, data.outputs.shape, data.time_unit
    ((1, 2000), (2, 2000), 's')
    """
    if fs is not None:
        rate = 1.0 / _checks.sampling_step(fs, name="fs")
        refuse_contradiction(dt, rate, "fs")
        dt = rate
    table = _Table.of(frame, time, dt)
    inputs, outputs = table.roles(input, output)
    u = [signal(f"the input (column {label!r})", table[label]) for label in inputs]
    y = [signal(f"the output (column {label!r})", table[label], missing=True) for label in outputs]
    lengths = {label: len(x) for label, x in zip([*inputs, *outputs], [*u, *y], strict=True)}
    if len(set(lengths.values())) > 1:
        raise StructureError(f"the columns differ in length, {_checks.shown(lengths)}; they must have the same length")
    refuse_short(len(y[0]))
    start, step, unit = table.clock(dt, len(y[0]))
    stated = checked_unit(time_unit)
    grid = instants(len(y[0]), step, start)
    return response(
        grid,
        np.array(u).reshape(len(u), len(grid)),
        np.array(y),
        inputs,
        outputs,
        "",
        unit if stated is None else stated,
    )


def recording_of_frame(frame: object, dt: float | None = None, *, output_needed: bool = True) -> channels.Recording:
    """Recording of a data frame with columns of the time (or none, with `dt`), the input and the output, in that order.

    The time is its index, or recognised by its label as `phc.read_csv` does; of the two that remain the first is the
    input.
    """
    table = _Table.of(frame, None, dt)
    rest = table.signals
    if len(rest) != 2 and (output_needed or len(rest) != 1):
        raise StructureError(
            f"which column is the input and which the output? {len(rest)} columns are left beside the time; choose "
            "with phc.recording(frame, input=.., output=..), or pass (u, y), of a free motion (None, y), with dt "
            f"({_listing(table.labels)})"
        )
    names = [f"the {role} (column {label!r})" for role, label in zip(("input", "output"), rest, strict=False)]
    u = signal(names[0], table[rest[0]])
    y = signal(names[1], table[rest[1]], missing=True) if len(rest) == 2 else np.full(len(u), np.nan)
    inputs, outputs = (rest[0],), (rest[1] if len(rest) == 2 else "y",)
    if table.time is None:
        return channels.recording(None, _checks.sampling_step(dt), [u], [y], inputs, outputs)
    start, step, unit = table.clock(dt)
    # the grid that instants in print stand for, as in a recording that was read from a file
    grid = instants(len(table.time), step, start)
    return channels.recording(grid, step, [u], [y], inputs, outputs, time_unit=unit)


@dataclass(frozen=True)
class _Table:
    """Columns by label, and the time, if there is one: an index, or one of the columns."""

    frame: Any
    keys: dict[str, Hashable]
    clock_label: str
    time: Any

    @classmethod
    def of(cls, frame: Any, time: Any, dt: float | None) -> _Table:
        """Find the columns of a frame and its time; with `time=False` there is none."""
        if not isinstance(frame, Mapping) and not is_data_frame(frame):
            raise StructureError(
                f"frame is {_checks.shown(frame)}; pass a data frame, a dataset, or a mapping of labels to arrays"
            )
        columns = list(getattr(frame, "data_vars", getattr(frame, "columns", frame)))
        labels = [str(column) for column in columns]
        for label in labels:
            if labels.count(label) > 1:
                raise StructureError(f"the data frame has {labels.count(label)} columns called {label!r}; rename them")
        keys = dict(zip(labels, columns, strict=True))
        if time is not None and time is not False:
            if str(time) not in keys:
                raise StructureError(f"time is {_checks.shown(time)}; {_listing(labels)}")
            return cls(frame, keys, str(time), _column(frame, keys[str(time)]))
        candidates = [] if time is False else [label for label in labels if is_time_label(label)]
        if len(candidates) > 1:
            names = " and ".join(repr(label) for label in candidates)
            raise StructureError(
                f"the columns {names} of the data frame may both be the time; drop the one that is not"
            )
        if candidates:
            return cls(frame, keys, candidates[0], _column(frame, keys[candidates[0]]))
        label, index = ("", None) if time is False else _index(frame)
        if index is None and dt is None:
            raise StructureError(
                "no column of the data frame is called time or t, and its index holds no times; rename the one that "
                f"is, or give the time between samples with dt ({_listing(labels)})"
            )
        return cls(frame, keys, label, index)

    @property
    def labels(self) -> list[str]:
        """Of all columns."""
        return list(self.keys)

    @property
    def signals(self) -> list[str]:
        """Labels of the columns beside the time."""
        return [label for label in self.keys if self.time is None or label != self.clock_label]

    def __getitem__(self, label: str) -> Any:
        return _column(self.frame, self.keys[label])

    def clock(self, dt: float | None, samples: int | None = None) -> tuple[float, float, str | None]:
        """First instant, step and unit of the time."""
        if self.time is None:
            return 0.0, _checks.sampling_step(dt), None
        name = f"the time (column {self.clock_label!r})" if self.clock_label in self.keys else "the index"
        values, unit = np.asarray(self.time), unit_of_time(self.clock_label)
        if values.dtype.kind == "O" and hasattr(values.flat[0] if values.size else None, "tzinfo"):
            # clocks without a zone are read as they are, whatever the zone of the machine
            zoned = (i if i.tzinfo is None else i.astimezone(timezone.utc).replace(tzinfo=None) for i in values)
            values = np.array([np.datetime64(instant) for instant in zoned])

        if values.dtype.kind in "mM":
            values, unit = (values - values[:1]) / np.timedelta64(1, "s"), "s"
        recorded = signal(name, values)
        refuse_short(len(recorded))
        if samples not in (None, len(recorded)):
            raise StructureError(
                f"{name} has {len(recorded)} instants for {samples} samples; they must have the same length"
            )
        grid, step = uniform_time(name, recorded, dt)
        return float(grid[0]), step, unit

    def roles(self, input: Any, output: Any) -> tuple[list[str], list[str]]:
        """Labels of the inputs and outputs."""
        chosen = {
            "input": [] if input is False else self._chosen("input", input),
            "output": self._chosen("output", output),
        }
        taken = [label for labels in chosen.values() for label in labels or ()]
        for label in taken:
            if taken.count(label) > 1:
                raise StructureError(f"column {label!r} is chosen twice; give each its own")
        rest = [label for label in self.signals if label not in taken]
        missing = [role for role, labels in chosen.items() if labels is None]
        if missing and len(rest) != len(missing):
            named = " and ".join(f"{role}=" for role in missing)
            raise StructureError(
                f"which column is the {' and which the '.join(missing)}? {len(rest)} are left beside the time "
                f"and the named columns; choose with {named} ({_listing(self.labels)})"
            )
        for role, label in zip(missing, rest, strict=False):
            chosen[role] = [label]
        return chosen["input"] or [], chosen["output"] or []

    def _chosen(self, role: str, wanted: object) -> list[str] | None:
        if wanted is None:
            return None
        chosen = []
        for label in map(str, wanted if isinstance(wanted, list | tuple) else [wanted]):
            matches = [label] if label in self.signals else [self.signals[k] for k in labelled(label, self.signals)]
            if not matches:
                raise StructureError(f"{role} names {label!r}, which is not a signal; {_listing(self.labels)}")
            if len(matches) > 1:
                raise StructureError(
                    f"{role} names {label!r}, which may be {' or '.join(map(repr, matches))}; name it in full"
                )
            chosen += matches
        if not chosen:
            hint = "; pass input=False for a recording without input" * (role == "input")
            raise StructureError(f"{role} is an empty list; name at least one column{hint}")
        return chosen


def _index(frame: Any) -> tuple[str, Any]:
    """Label and values of an index that holds times: dates, durations, doubles, or what has the name of a time."""
    if hasattr(frame, "data_vars"):  # xarray: the coordinate of the one dimension
        names = list(frame.dims)
        coordinate = frame.coords[names[0]] if len(names) == 1 and names[0] in frame.coords else None
        return ("", None) if coordinate is None else (_with_unit(str(names[0]), coordinate), coordinate.values)
    index = getattr(frame, "index", None)
    kind = getattr(getattr(index, "dtype", None), "kind", "")
    label = str(getattr(index, "name", None) or "")
    times = kind in ("M", "m", "f") or (kind in ("i", "u") and is_time_label(label))
    return (label, index) if times else ("", None)


def _with_unit(label: str, coordinate: Any) -> str:
    unit = getattr(coordinate, "attrs", {}).get("units")
    return f"{label} [{unit}]" if isinstance(unit, str) else label


def _listing(labels: list[str]) -> str:
    return f"the columns are {first_of([*map(repr, labels)], _SHOWN)}"


def _column(frame: Any, label: Any) -> Any:
    try:
        column = frame[label]
    except (KeyError, IndexError, TypeError) as error:
        raise StructureError(
            f"column {str(label)!r} of the {type(frame).__name__} cannot be read: {error}; pass a data frame in "
            "memory, or (u, y) with dt"
        ) from None
    return column.values if hasattr(frame, "data_vars") else column

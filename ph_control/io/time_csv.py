"""Recordings: text tables become time responses of python-control."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np
from control import TimeResponseData

from .. import _checks
from .._options import DecimalMark
from .._types import Array
from .._units import checked_unit, with_unit
from ..analysis.time_grid import printed_step
from ..exceptions import FileFormatError, StructureError, printable
from .files import read_bytes, source_name
from .tables.columns import Table
from .tables.text_table import TextOptions, read_table

Column = int | str

_LATEST = 1e300
_DRIFT = 0.01  # of a step: how far two grids may part over the record and still be the same


def read_csv(
    path: str | os.PathLike[str] | BinaryIO | TextIO,
    *,
    input: Column | Sequence[Column] | bool | None = None,
    output: Column | Sequence[Column] | None = None,
    time: Column | bool | None = None,
    dt: float | None = None,
    time_unit: str | None = None,
    header: bool | None = None,
    delimiter: str | None = None,
    decimal: DecimalMark | None = None,
    skiprows: int | None = None,
    comment: str | None = None,
) -> TimeResponseData:
    r"""Read a recording from a text table (CSV, TSV or columns between white space).

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.
    input, output : str, int, or a list of these, optional
        Columns of the input and the output: by label, or by number counted from 0 over all columns of the file.
        A label matches with or without its unit and, failing that, without regard to case; digits that are no
        label are a number.  `input=False` says that there is no input, as in a free decay.
        Default: the one remaining column; with neither given and two columns left, the first is the input and the
        second the output.
    time : str, int or False, optional
        Column of the time: numbers, times of day (`12:00:01.250`), dates with times of day in ISO 8601 or as usual in
        Europe and the United States, or durations (`0.5 sec`).  Default: the one labelled `t`, `time`, `timestamp` or
        the like, else the one with times of day, else the only one with a unit of time, as `Zeit [s]`.
        `time=False` says that no column is the time, and needs `dt`.
    dt : float, optional
        Time between samples.  Needed if there is no time column; if there is one, the two must agree.
    time_unit : {'ns', 'us', 'ms', 's', 'min', 'h'}, optional
        Unit of the time, and of `dt`.  Default: the one in the label of its column, as in `Time (ms)`, `t [s]`, `t / h`
        or `time_us`; not known where that tells none.
    header : bool, optional
        Whether the first row holds labels.  Default: it does if none of its fields is a number.
    delimiter : str, optional
        Separator of the fields; `" "` is any white space.  Default: found from the first rows.
    decimal : {".", ","}, optional
        Decimal sign.  Default: found from the rows.
    skiprows : int, optional
        Lines at the begin of the file to leave out.  Default: the table is found below any preamble.
    comment : str, optional
        Start of lines that are comments, such as `"//"`; `""` for none.  Default: `#` and `%`.

    Returns
    -------
    control.TimeResponseData
        `time` (N,), `inputs` and `outputs` as python-control squeezes them, with the labels of the columns.  The
        time is the exactly uniform grid through the instants in the file, in their unit, which its attribute
        `time_unit` tells: numbers are not converted, so a fit to a file in ms has its frequencies in rad/ms, and tells
        them in Hz too.  Times of day are seconds since the first row.  Missing outputs are NaN.

    Raises
    ------
    FileFormatError
        If the content is not such a table; it names line and column, what was found and what to do.  A missing
        input or time, unequal sampling, and a file of fewer than two rows are such errors too.
    StructureError
        If the arguments do not fit the file, such as a column that it does not have.
    FileMissingError
        If there is no such file.

    Notes
    -----
    Lines above the table are skipped, such as the settings that loggers and oscilloscopes write there; of several
    tables the longest is read.  Blank lines and lines that start with `#` or `%` are skipped; labels may be in such a
    line right above the numbers.  Empty fields, NaN, NA, N/A, null, none, `-` and `?` are missing values.  Columns that
    are not asked for may hold anything.  The instants may be off the grid by a hundredth of a step, as rounding in
    print makes them; the step is the shortest decimal number, or rate, within the uncertainty of a straight line
    through them.  A few seconds for a million rows.

    Examples
    --------
    >>> import pathlib, tempfile, ph_control as phc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "recording.csv")
    ...     _ = path.write_text("t [s],force [N],velocity [m/s]\n0.0,1.0,0.0\n0.1,0.0,0.2\n0.2,0.0,\n")
    ...     data = phc.read_csv(path, input="force", output="velocity")
    >>> data.time.tolist(), data.inputs.tolist(), data.outputs.tolist()
    ([0.0, 0.1, 0.2], [1.0, 0.0, 0.0], [0.0, 0.2, nan])
    >>> data.output_labels, data.time_unit
    (['velocity [m/s]'], 's')
    """
    options = TextOptions(header, delimiter, decimal, skiprows, comment)
    return recording_in(read_table(read_bytes(path), source_name(path), options), input, output, time, dt, time_unit)


def recording_in(
    table: Table, input: Any, output: Any, time: object, dt: object, time_unit: object
) -> TimeResponseData:
    """Recording that a table holds; the arguments are those of `read_csv`."""
    step, unit = None if dt is None else _checks.sampling_step(dt), checked_unit(time_unit)
    if step is None and time in (None, False) and table.step is not None:
        time, step, unit = False, table.step, unit or "s"
    clock = _time_column(table, time, step)
    inputs, outputs = _signal_columns(table, clock, input, output)
    if table.count < 2:
        raise FileFormatError(f"{table.path} has one row of numbers ({table.line(0)}); at least two samples are needed")
    missing = "{} is missing, and only outputs may be: fill it in, or cut the recording there"
    if clock is None:
        assert step is not None
        grid = step * np.arange(table.count, dtype=float)
    else:
        instants, own_unit = table.instants(clock)
        table.refuse(clock, np.isnan(instants), missing.format("the time"))
        grid = _uniform_grid(table, instants, clock, step)
        unit = own_unit if unit is None else unit
    values = table.columns([*inputs, *outputs])
    u, y = values[: len(inputs)], values[len(inputs) :]
    for column, signal in zip(inputs, u, strict=True):
        table.refuse(column, np.isnan(signal), missing.format("the input"))
    for column, signal in zip(outputs, y, strict=True):
        if np.isnan(signal).all():
            raise FileFormatError(f"{table.path}: {table.name(column)} has no values at all; choose another output")
    labels = _signal_labels(table, inputs, "u"), _signal_labels(table, outputs, "y")
    return recording(grid, u, y, *labels, table.path, unit)


def recording(
    grid: Array, u: Array, y: Array, inputs: list[str], outputs: list[str], path: str, unit: str | None
) -> TimeResponseData:
    """Data of python-control: inputs (m, N), outputs (p, N), their labels, and the file they come from."""
    inputs, outputs = ([printable(label, one_line=True) for label in labels] for labels in (inputs, outputs))
    data = TimeResponseData(
        grid, y, inputs=u if len(u) else None, issiso=len(y) == 1 and len(u) <= 1, input_labels=inputs or None,
        output_labels=outputs, title=Path(path).name,
    )  # fmt: skip
    return with_unit(data, unit)


def complete_grid(instants: Array, u: Any, inputs: Sequence[str], path: str) -> Array:
    """Uniform grid of the instants of a recording, whose time and inputs, (m, N), have no gaps."""
    if len(instants) < 2:
        raise FileFormatError(f"{path} holds a recording of one sample; at least two are needed")
    for label, values in (*zip(inputs, u, strict=True), ("the time", instants)):
        if np.isnan(values).any():
            raise FileFormatError(
                f"{path}: {label} has missing values, allowed in outputs only: cut the recording there"
            )
    try:
        _checks.time_vector(instants)
    except StructureError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return np.asarray(instants[0] + printed_step(instants) * np.arange(len(instants)))


def _time_column(table: Table, time: object, step: float | None) -> int | None:
    """Number of the time column, or None where `dt` takes its place."""
    if time is not None and time is not False:
        return table.find(time, "time")
    clock = table.only([] if time is False else table.time_columns(step is None), "time")
    if clock is None and step is None:
        raise StructureError(
            f"{table.path}: no column is the time; name it with time=, or give the time between samples with dt= "
            f"({table.listing()}){_proposed_time(table)}"
        )
    return clock


def _proposed_time(table: Table) -> str:
    """Argument that a message proposes for the time: a step that the file tells, else a column that rises evenly."""
    step, columns = table.proposed_step(), [j for j in range(table.width) if table.holds_numbers(j)]
    for column in columns:
        with suppress(FileFormatError, StructureError):
            instants = table.columns([column])[0]
            _checks.time_vector(instants)
            if step is None or abs(instants[1] - instants[0] - step) < 0.01 * step:
                return f"; for example time={table.key(column)!r}"
            # beside a step that the file tells, numbers that rise evenly number the rows
            outputs = [table.key(j) for j in columns if j != column]
            if outputs:
                return (
                    f"; for example dt={step:.9g}, input=False, output={outputs[0] if len(outputs) == 1 else outputs!r}"
                )
    return "" if step is None else f"; for example dt={step:.9g}"


def _signal_columns(table: Table, clock: int | None, input: Any, output: Any) -> tuple[list[int], list[int]]:
    """Numbers of the input and output columns."""
    for name, value in (("input", input), ("output", output)):
        if isinstance(value, bool) and (value or name == "output"):
            raise StructureError(f"{name} is {value}; give the label of a column or its number, counted from 0")
    chosen = {"input": [] if input is False else _chosen(table, input, "input")}
    chosen["output"] = _chosen(table, output, "output")
    taken = [*([] if clock is None else [clock]), *(chosen["input"] or []), *(chosen["output"] or [])]
    table.refuse_repeats(taken)
    rest = [j for j in range(table.width) if j not in taken and not table.holds_dates(j)]
    missing = [name for name, columns in chosen.items() if columns is None]
    if missing and len(rest) != len(missing):
        few = "input" in missing and len(rest) < len(missing)
        several = "; several columns are passed as a list" * (len(rest) > len(missing))
        free = ", or pass input=False if the recording has no input" * few
        raise StructureError(
            f"{table.path}: which column is the {' and which the '.join(missing)}? {len(rest)} of {table.width} "
            f"columns are left to choose from; say which with {' and '.join(f'{name}=' for name in missing)}{free}"
            f"{several} ({table.listing()}){_proposed_signals(table, rest, missing)}"
        )
    columns = {**chosen, **{name: [column] for name, column in zip(missing, rest, strict=False)}}
    return columns["input"] or [], columns["output"] or []


def _proposed_signals(table: Table, rest: list[int], missing: list[str]) -> str:
    """Arguments that a message proposes for the signals."""
    keys = [table.key(j) for j in rest if table.holds_numbers(j)]
    if not keys:
        return ""
    proposed = {"input": keys[0], "output": keys[1] if len(keys) == 2 else keys[1:4]}
    if len(keys) == 1 or "input" not in missing:
        proposed = {"input": False, "output": keys[0]}
    elif "output" not in missing:
        proposed = {"input": keys[0]}
    return "; for example " + ", ".join(f"{role}={proposed[role]!r}" for role in missing if role in proposed)


def _chosen(table: Table, wanted: object, role: str) -> list[int] | None:
    if wanted is None:
        return None
    if isinstance(wanted, list | tuple):
        if not wanted:
            hint = "; pass input=False for a recording without input" if role == "input" else ""
            raise StructureError(f"{role} is an empty list; name at least one column{hint}")
        return [table.find(column, role) for column in wanted]
    return [table.find(wanted, role)]


def _signal_labels(table: Table, columns: list[int], prefix: str) -> list[str]:
    labels = [table.labels[j] if table.labels else "" for j in columns]
    return [label or f"{prefix}[{k}]" for k, label in enumerate(labels)]


def _uniform_grid(table: Table, instants: Array, column: int, dt: float | None) -> Array:
    """The uniform grid that instants in print stand for."""
    wrong = "the time is {:.3g}, out of the range of doubles; choose another unit"
    table.refuse(column, np.abs(instants) > _LATEST, wrong, instants)
    try:
        _checks.time_vector(instants)
    except StructureError:
        raise FileFormatError(_why_not_uniform(table, instants, column)) from None
    step, count = printed_step(instants), len(instants)
    if dt is not None:
        if abs(dt - step) * (count - 1) > _DRIFT * step:
            raise StructureError(
                f"{table.path}: dt is {dt:.9g}, but the step of {table.name(column)} is {step:.9g}; leave dt out, "
                "or pass time=False if that column is not the time in the wanted unit"
            )
        step = dt
    return instants[0] + step * np.arange(count)


def _step_of_coarse_clock(t: Array, gaps: Array) -> float | None:
    """Step of samples whose instants are rounded to more than it, in a whole number of samples where nearly so."""
    tick, step = gaps.max(), (t[-1] - t[0]) / len(gaps)
    if gaps.min() < 0 or not tick or np.mean(gaps == 0) < 0.3 or np.ptp(t - step * np.arange(len(t))) > 2 * tick:
        return None
    jumps = np.flatnonzero(gaps)
    step = (t[jumps[-1] + 1] - t[jumps[0] + 1]) / (jumps[-1] - jumps[0]) if len(jumps) > 1 else step
    return float(tick / round(tick / step)) if abs(tick / step / round(tick / step) - 1) < 0.02 else float(step)


def _why_not_uniform(table: Table, t: Array, column: int) -> str:
    gaps = np.diff(t)
    median = float(np.median(gaps))
    k = int(np.argmax(gaps <= 0) if (gaps <= 0).any() else np.argmax(np.abs(gaps - median)))
    place = f"{table.place_of(k + 1, column)}: the time is {t[k + 1]:.12g}, after {t[k]:.12g} in {table.line(k)}"
    if gaps[k] == 0 and (step := _step_of_coarse_clock(t, gaps)):
        return (
            f"{place}; the instants are printed in steps of {gaps.max():.6g}, which is longer than the time between "
            f"samples: give that, such as time=False, dt={step:.6g}"
        )
    if gaps[k] <= 0:
        return f"{place}; it must increase: sort the rows, and drop repeats"
    # rows numbered by time=False would close the gaps that lost samples leave, so it is not offered for these
    lost = np.where(gaps > 1.5 * median, np.rint(np.minimum(gaps, 1e9 * median) / median) - 1, 0)
    if np.all(np.abs(gaps - median) <= 0.5 * median):
        advice = f"resample; if the times are only rounded in print, pass time=False, dt={gaps.mean():.9g}"
    elif lost[k]:
        advice = (
            f"samples are lost, {lost[k]:.9g} there and {lost.sum():.9g} in the whole file; add rows for them (time "
            "and input given, output empty), or resample"
        )
    else:
        advice = "the row seems to be one too many there: drop it, or resample"
    return (
        f"{place}: a step of {gaps[k]:.6g}, where the median is {median:.6g}; the sampling must be uniform to a "
        f"hundredth of a step: {advice}"
    )

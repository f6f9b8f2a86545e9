"""Identify a model from each of many recordings, in processes or on a Dask cluster, and track the modes.

Name files one by one or by patterns in quotes. The table has one row for each recording and mode; its column track
identifies the same mode in all recordings. With --store an interrupted run resumes. Exit status 1 if recordings failed;
their rows give the reason.

Examples
--------
  ph-control fit-many 'rec*.csv' --order 2
  ph-control fit-many recording.csv fresh.csv --table modes.csv --plot tracks.png
  ph-control fit-many 'rec*.csv' --store results --workers 2 --json
"""

from __future__ import annotations

import csv
import io
from argparse import Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import ph_control as phc

from ...exceptions import PHControlError, StructureError, installed
from ..inputs import measurements
from ..options import Parser, add_recording, add_written
from ..outcome import DONE, INTERRUPTED, NO, ProgressLine, complain, in_shell_terms
from ..outputs import check_files, conclude, deliver, deliver_picture, picture_format
from .fit import add_fitted, keywords_of

USAGE = "RECORDING [RECORDING ...] [options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("recordings", nargs="+", metavar="RECORDING", help="files, or patterns such as 'data/*.csv'")
    add_recording(parser)
    add_fitted(parser)
    where = parser.add_argument_group("execution")
    where.add_argument("--scheduler", metavar="ADDRESS", help="Dask cluster, such as tcp://host:8786")
    where.add_argument(
        "--store", metavar="FOLDER", help="folder of results; recordings with a result there are skipped"
    )
    out = parser.add_argument_group("output")
    out.add_argument("--table", metavar="FILE", help="a row for each recording and mode (CSV); - for standard output")
    out.add_argument(
        "--plot", metavar="FILE", help="frequencies and damping ratios over the recordings (png, svg, pdf)"
    )
    add_written(out)


def run(options: Namespace) -> int:
    """Fit, print, write."""
    outputs = [options.table, options.plot]
    check_files(options, [options.guess], outputs)
    if "-" in options.recordings:
        raise StructureError("standard input is one recording: ph-control fit - takes it")
    if options.plot is not None:
        picture_format(options.plot)
    reader = partial(recording_of, {name: value for name, value in vars(options).items() if name in _reading()})
    with (
        _workers(options) as workers,
        ProgressLine(_progress_line, options.timeout, always=options.watch_progress) as watch,
    ):
        fits = phc.fit_many(
            options.recordings, workers=workers, store=options.store, callback=watch.callback, reader=reader,
            **keywords_of(options),
        )  # fmt: skip
    tracks = fits.track()
    if options.table is not None:
        deliver(_as_csv(tracks), options.table, options.overwrite)
    if options.plot is not None:
        deliver_picture(tracks.plot(), options.plot, options.overwrite)
    rows = [dict(zip(fits.table.dtype.names or (), row.tolist(), strict=True)) for row in fits.table]
    tracked = [row | {"track": k} for row, k in zip(rows, tracks.ids.tolist(), strict=True)]
    counts = {"failed": len(fits.failures), "interrupted": not fits.complete}
    answer = {"command": "fit-many", "rows": tracked, **counts}
    conclude(options, answer, outputs, in_shell_terms(f"{fits}\n\n{tracks}\n"))
    if not fits.complete:
        why = "the time of --timeout is up" if watch.expired else "interrupted"
        complain(f"{why}; these are the recordings that were done until then")
        return INTERRUPTED
    return NO if len(fits.failures) else DONE


def _reading() -> set[str]:
    """Options that say how a file is read."""
    parser = Parser(None)
    add_recording(parser)
    return {action.dest for action in parser._actions} - {"help"}


def recording_of(reading: Mapping[str, Any], path: Path) -> Any:
    """Data of a file, with weights where a column of them was named."""
    from ...identification.data.experiments import as_measured

    read = measurements([str(path)], Namespace(**reading))
    if read.weights is None:
        return read.whole
    return list(as_measured(read.data, **read.keywords))


@contextmanager
def _workers(options: Namespace) -> Iterator[Any]:
    """Number of processes, or the client of a cluster."""
    if options.scheduler is None:
        yield options.workers
        return
    needs = "--scheduler needs the package distributed"
    distributed = installed("distributed", needs, "pip install 'ph_control[distributed]'")
    try:
        client = distributed.Client(options.scheduler, set_as_default=False)
    except (OSError, ValueError) as error:
        raise PHControlError(f"there is no cluster at {options.scheduler}: {error}; check its address") from None
    with client:
        yield client


def _progress_line(progress: Any) -> str:
    of = "" if progress.total is None else f" of {progress.total}"
    return f"{progress.done}{of} done, {progress.failed} failed, {Path(progress.name).name}"


def _as_csv(tracks: phc.ModeTracks) -> str:
    """Table with the number of the mode that each row belongs to, empty where there is no number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*(tracks.table.dtype.names or ()), "track"])
    for row, k in zip(tracks.table.tolist(), tracks.ids.tolist(), strict=True):
        writer.writerow(["" if value != value else value for value in (*row, k)])
    return text.getvalue()

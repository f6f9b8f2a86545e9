"""Fits to many recordings: the public call."""

from __future__ import annotations

import inspect
import os
import time
import warnings
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from control import InputOutputSystem, TimeResponseData

from ... import _checks
from ..._threads import on_one_thread
from ..._workers import check_workers, completed
from ...exceptions import IdentifiabilityWarning, OutputExistsError, StructureError
from ..data.data_frames import is_data_frame
from ..fit.pem import pem
from ..fit.pem_result import PEMResult
from .fit_table import FitTable, table_of
from .recordings import FitAndKeep, Modes, sources

_LEFT_BEHIND = 3600.0  # seconds after which nobody writes a file any more
_OPTIONS = frozenset(inspect.signature(pem).parameters) - {"data", "workers", "callback"}


@dataclass(frozen=True)
class RecordingFitted:
    """What a callback of `fit_many` is told when a recording is done.

    Attributes
    ----------
    done, failed : int
        Number of recordings so far, and how many of them failed.
    total : int or None
        How many there are; None of an iterator.
    name : str
        The recording.
    message : str
        Verdict of the fit, or what went wrong.

    Examples
    --------
    >>> import ph_control as phc
    >>> progress = phc.RecordingFitted(2, 0, 10, "day 2", "two modes")
    >>> f"{progress.done} of {progress.total}, {progress.failed} failed: {progress.name}"
    '2 of 10, 0 failed: day 2'
    """

    done: int
    failed: int
    total: int | None
    name: str
    message: str


@on_one_thread
def fit_many(
    recordings: Iterable[object],
    *,
    workers: object = 1,
    store: str | os.PathLike[str] | None = None,
    callback: Callable[[RecordingFitted], object] | None = None,
    reader: Callable[[Path], object] | None = None,
    reference: PEMResult | None = None,
    **pem_options: Any,
) -> FitTable:
    """Fit modes to each of many recordings, in any number of processes or on a cluster.

    Parameters
    ----------
    recordings : iterable, or str
        Recordings, each a fit of its own: anything that `pem` takes, the path of a file, or a pattern such as
        `'data/*.csv'` for the files that match, in the order of their names.  Taken one by one as there is room, so an
        iterator may have any length.  A text alone is one path or pattern.
    workers : int, concurrent.futures.Executor or distributed.Client
        Number of processes, -1 for all; or what runs the fits.  The result does not depend on it.
    store : str or path-like, optional
        Folder of results as `save` writes them, made if it is not there.  A recording whose result is in it is not
        fitted again; one that has changed, or is to be fitted with other options, is.
    callback : callable, optional
        Called as `callback(progress)` after each recording, with the fields `done`, `failed`, `total`, `name` and
        `message`.  If it raises `StopIteration`, or on `KeyboardInterrupt`, the table of what is done is returned.
    reader : callable, optional
        Gives the data of a `pathlib.Path`, such as `functools.partial(phc.read_csv, input="force", output="speed")`;
        other processes import it.  By default the suffix chooses between the readers of this package: text tables in
        time or frequency, `.mat`, `.uff`, Touchstone.
    reference : PEMResult, optional
        Fit of the same plant, for `FitTable.changes`: each recording is tested against it as by `PEMResult.changed`
        with ``parameters="poles"``, whether it can be fitted or not.
    **pem_options
        Options of `pem`, the same for all recordings; `rng` is a whole number.

    Returns
    -------
    FitTable
        One row for each recording and mode, in the order of the recordings.  One that fails has a row with its message.

    Raises
    ------
    StructureError
        If `recordings`, `workers`, `callback`, `reference` or `rng` is not of this form.
    OutputExistsError
        If `store` is a file.
    TypeError
        If an option is not one of `pem`.
    PHControlError
        If an executor that was given breaks, or other processes cannot be started: a script has to make the call under
        `if __name__ == "__main__":`.

    See Also
    --------
    pem : fits one plant to several experiments, given as a list.

    Notes
    -----
    Numbers are the same bit by bit for any `workers` on processors of one kind: each fit runs on one thread.

    What is under way takes memory, about two recordings a process, or as many as are fitted in half a second,
    and so does the table.  Files are read where they
    are fitted: a cluster must see them, and `store`, under the same paths.  Arrays travel with the call.

    A result in the store appears whole or not at all.  Where one of our processes is killed it is replaced, and what
    was under way is fitted again, one by one; a recording whose process has died three times fails.  Failures are not
    kept, and tried again with the next call.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(400)
    >>> u = rng.standard_normal(400)
    >>> def recording(d):
    ...     plant = phc.ph(phc.modes([d, 2.0], [1.0, 0.25]))
    ...     y = phc.forced_response(plant, t, u, intersample="zoh").outputs
    ...     return u, y + 0.01 * rng.standard_normal(400)
    >>> fits = phc.fit_many((recording(d) for d in (0.50, 0.51, 0.52)), dt=0.1)
    >>> (2 * np.pi * fits.table["hertz"]).round(2)
    array([0.5 , 2.  , 0.51, 2.  , 0.52, 2.  ])
    >>> fits.track().ids
    array([0, 1, 0, 1, 0, 1])
    """
    check_workers(workers)
    if callback is not None and not callable(callback):
        raise StructureError(f"callback is {_checks.shown(callback)}; pass a function of one argument, or None")
    if not (reference is None or isinstance(reference, PEMResult)):
        raise StructureError(f"reference is {_checks.shown(reference)}; pass the result of a fit by pem, or None")
    unknown = sorted(set(pem_options) - _OPTIONS)
    if unknown:
        raise TypeError(
            f"unexpected keyword argument {unknown[0]!r}; options of pem are {', '.join(sorted(_OPTIONS))}; columns of "
            "files are chosen by fit_many(read_csv(file, input=.., output=..) for file in files)"
        )
    rng = pem_options.get("rng")
    if rng is not None and not _checks.is_whole(rng):
        raise StructureError(f"rng is {_checks.shown(rng)}; expected a whole number, the seed of each fit")
    listed, total = _listed(recordings)
    fit = FitAndKeep(pem_options, reader, None if store is None else _folder(store), reference)
    modes: dict[int, Modes] = {}
    failed, whole = 0, False
    with warnings.catch_warnings(), closing(completed(fit, listed, workers)) as ended:
        # what the data do not show is in each result
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        try:
            for place, recording_modes, error in ended:
                if isinstance(error, OSError):  # the store cannot be written: no fit would be kept
                    raise error
                # without a result: its process died, or it cannot travel to one
                recording_modes = recording_modes or Modes(f"recording {place}", f"{type(error).__name__}: {error}")
                modes[place] = recording_modes
                failed += recording_modes.order < 0
                if callback is not None:
                    callback(RecordingFitted(len(modes), failed, total, recording_modes.name, recording_modes.message))
            whole = True
        except (KeyboardInterrupt, StopIteration):
            pass
    return table_of(modes, whole)


def _listed(recordings: Any) -> tuple[Any, int | None]:
    """Recordings one by one, and how many there are where that is known."""
    if isinstance(recordings, str | os.PathLike):
        recordings = [recordings]
    # systems of python-control have entries, too
    single = isinstance(recordings, TimeResponseData | InputOutputSystem | np.ndarray) or is_data_frame(recordings)
    pair = isinstance(recordings, tuple) and any(isinstance(entry, np.ndarray) for entry in recordings)
    if single or pair or not np.iterable(recordings):
        raise StructureError(
            f"recordings is {_checks.shown(recordings)}; expected a list, or another iterable, of recordings: pass "
            "[data] for one"
        )
    if not isinstance(recordings, list | tuple):
        return sources(recordings), None
    # paths alone may stand for several files each
    listed = list(sources(recordings))
    return listed, len(listed)


def _folder(store: str | os.PathLike[str]) -> Path:
    path = Path(store)
    if path.exists() and not path.is_dir():
        raise OutputExistsError(f"store is {path}, a file; name a folder, which is made if it is not there")
    path.mkdir(parents=True, exist_ok=True)
    for leftover in path.glob(".ph_control-*.tmp"):  # by a process that was killed as it wrote
        if time.time() - leftover.stat().st_mtime > _LEFT_BEHIND:
            leftover.unlink(missing_ok=True)
    return path.resolve()

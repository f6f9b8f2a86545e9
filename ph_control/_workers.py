"""Calls in other processes: a number of these, an executor, a Dask client or a map, all behind one iterator."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

import numpy as np

from . import _checks
from .exceptions import IdentifiabilityWarning, PHControlError, StructureError

_AHEAD = 2  # calls for each process: one that it works on, and one that waits for it
_DEATHS = 3  # of processes that a call was alone in, after which it is given up
_SECONDS = 0.2  # that calls compute that travel together, a hundred times and more what it takes to send them
_WAITING = 5  # times as long such calls may wait, for a file or for a processor
_LEAST = 4  # threads that a cluster is taken to have
_BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

Item = TypeVar("Item")
Result = TypeVar("Result")
Ended = Generator[tuple[int, Any, "BaseException | None"], None, None]


def check_workers(workers: Any) -> None:
    """Check that this is a number of processes, -1 for all, an executor, a Dask client, or a map-like callable."""
    whole = isinstance(workers, int | np.integer) and not isinstance(workers, bool)
    if not (callable(workers) or _submits(workers) or (whole and (workers >= 1 or workers == -1))):
        raise StructureError(
            f"workers is {_checks.shown(workers)}; it must be a number of processes, -1 for all, an executor of "
            "concurrent.futures, a Dask client, or a map"
        )


def _submits(workers: object) -> bool:
    """Whether this is an executor, or a Dask client."""
    return hasattr(workers, "submit")


def mapped(function: Callable[[Item], Result], items: Sequence[Item], workers: Any, kind: type) -> Iterable[Result]:
    """Results of a kind in the order of the items; the first error is raised."""
    if callable(workers) and not _submits(workers):
        try:
            answer = workers(function, items)
        except TypeError as error:
            shown = _checks.shown(workers)
            raise StructureError(
                f"workers is {shown}, which does not take a function and a list as a map does: {error}"
            ) from error
        given = list(islice(answer, len(items) + 1)) if np.iterable(answer) else []
        if len(given) != len(items) or not all(isinstance(result, kind) for result in given):
            raise StructureError(
                f"workers is to give one result for each of {len(items)} items, in their order, as the built-in map "
                f"does; it gave {_checks.shown(given or answer)}"
            )
        return given
    if len(items) < 2 or _is_one(workers):
        return map(function, items)
    if not _submits(workers):
        workers = min(_count(workers), len(items))
    results: list[Any] = [None] * len(items)
    for place, result, failure in completed(function, items, workers):
        if failure is not None:
            raise failure
        results[place] = result
    return results


def completed(function: Callable[[Item], Any], items: Iterable[Item], workers: object) -> Ended:
    """Place, result and error of each call as it ends; items are taken as there is room, so there may be any number.

    Short calls travel together, and each is made again, alone, where one of them fails.  So it is where a process of
    our own dies and all calls under way are lost: one of them may have killed it, and is given up when it has done so
    a few times.
    """
    source = enumerate(items)
    if _is_one(workers):
        for place, item in source:
            yield place, *_called(function, item)
        return
    pool = _pool_of(workers)
    under_way: dict[Future[Any], list[tuple[int, Item]]] = {}
    suspects: list[tuple[int, Item]] = []
    deaths: Counter[int] = Counter()
    size = 1
    try:
        while True:
            for _ in range(1 if suspects else pool.room(len(under_way))):
                calls = [suspects.pop(0)] if suspects else _taken(source, size)
                if not calls:
                    break
                under_way[pool.submit(_together, function, [item for _, item in calls])] = calls
            if not under_way:
                return
            done = wait(under_way, return_when=FIRST_COMPLETED).done
            if any(map(_is_lost, done)):
                done = wait(under_way).done
            lost, again = [], []
            for future in done:
                calls = under_way.pop(future)
                if _is_lost(future):
                    lost += calls
                elif (error := future.exception()) is None:
                    results, seconds = future.result()
                    size = max(1, min(2 * size, int(_SECONDS * len(calls) / max(seconds, _SECONDS / 1000))))
                    yield from ((place, result, None) for (place, _), result in zip(calls, results, strict=True))
                elif len(calls) == 1:
                    yield calls[0][0], None, error
                else:
                    again += calls
            if lost:
                pool.renew()
            if len(lost) == 1:
                place = lost[0][0]
                deaths[place] += 1
                if deaths[place] == _DEATHS:
                    lost = []
                    said = f"each of {_DEATHS} processes that worked on it died, as by a lack of memory"
                    yield place, None, PHControlError(said)
            suspects = sorted(lost + again, key=lambda item: item[0]) + suspects
    finally:
        pool.stop(list(under_way))


def _taken(source: Iterator[Item], size: int) -> list[Item]:
    """The next items, fewer than asked for where they come slowly."""
    taken = []
    end = time.perf_counter() + _SECONDS
    for item in source:
        taken.append(item)
        if len(taken) >= size or time.perf_counter() > end:
            break
    return taken


def _together(function: Callable[[Item], Result], items: Sequence[Item]) -> tuple[list[Result], float]:
    """Results of calls that have travelled together, and the seconds by which their number is chosen."""
    own, wall = time.thread_time(), time.perf_counter()
    results = [function(item) for item in items]
    return results, max(time.thread_time() - own, (time.perf_counter() - wall) / _WAITING)


def _called(function: Callable[[Item], Result], item: Item) -> tuple[Result | None, BaseException | None]:
    try:
        return function(item), None
    except Exception as error:
        return None, error


def _is_lost(future: Future[Any]) -> bool:
    """Whether a call has no end of its own."""
    return future.cancelled() or isinstance(future.exception(), BrokenExecutor)


def _is_one(workers: object) -> bool:
    return isinstance(workers, int | np.integer) and workers == 1


def _count(workers: int) -> int:
    return (os.cpu_count() or 1) if workers == -1 else int(workers)


# --- where calls go --------------------------------------------------------------------------------------------------


def _pool_of(workers: Any) -> _Given:
    if hasattr(workers, "get_executor"):
        return _Cluster(workers)
    if not (_submits(workers) or isinstance(workers, int | np.integer)):
        raise StructureError(
            f"workers is {_checks.shown(workers)}; here it must be a number of processes, -1 for all, an executor of "
            "concurrent.futures, or a Dask client, whose results come one by one"
        )
    return _Given(workers) if _submits(workers) else _Processes(_count(workers))


class _Given:
    """An executor of the user's."""

    def __init__(self, executor: Any) -> None:
        self._executor = executor

    def submit(self, function: Callable[..., Result], *arguments: object) -> Future[Result]:
        """Future of a call, which has failed already where the executor is broken."""
        try:
            future: Future[Result] = self._executor.submit(function, *arguments)
        except BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        return future

    def room(self, under_way: int) -> int:
        """How many more calls are taken."""
        return max(_AHEAD * self._threads() - under_way, 0)

    def _threads(self) -> int:
        # executors of concurrent.futures have this, and others need not
        return int(getattr(self._executor, "_max_workers", os.cpu_count() or 1))

    def renew(self) -> None:
        """Replace what has died."""
        raise PHControlError(
            f"the {type(self._executor).__name__} that was given as workers has broken or cancelled its calls; pass a "
            "new one, or a number of processes, which are replaced when they die: with a store, what is there is not "
            "fitted again"
        )

    def stop(self, under_way: Sequence[Future[Any]]) -> None:
        """End what is still under way."""
        for future in under_way:
            future.cancel()


class _Cluster(_Given):
    """A Dask client, as an executor; the scheduler makes the calls of a dead process again."""

    def __init__(self, client: Any) -> None:
        super().__init__(client.get_executor(pure=False))
        self._client = client

    def _threads(self) -> int:
        # one that grows with its work begins with none
        return max(sum(self._client.nthreads().values()), _LEAST)

    def stop(self, under_way: Sequence[Future[Any]]) -> None:
        """End what is still under way."""
        self._executor.shutdown(wait=False)


class _Processes(_Given):
    """Processes of our own, with one thread for linear algebra in each; they are replaced when one was killed."""

    def __init__(self, count: int) -> None:
        self._size = count
        self.renew()

    def renew(self) -> None:
        """Start processes, and wait until the first one works."""
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor

        # no plain fork: threads hold locks, which would be copied; a server that has imported the package is forked
        server = "forkserver" in multiprocessing.get_all_start_methods()
        context = multiprocessing.get_context("forkserver" if server else "spawn")
        if server:
            context.set_forkserver_preload(["__main__", "ph_control.identification.fit.pem"])
        self._executor = ProcessPoolExecutor(self._size, mp_context=context, initializer=_begin)
        before = {name: os.environ.get(name) for name in _BLAS}
        os.environ.update(dict.fromkeys(_BLAS, "1"))
        try:
            first, *_ = [self._executor.submit(os.getpid) for _ in range(self._size)]
        finally:
            for name, value in before.items():
                os.environ.pop(name) if value is None else os.environ.update({name: value})
        try:
            first.result()
        except BrokenExecutor as error:
            raise PHControlError(
                "no other process could be started to work in; a script has to make the call under "
                "`if __name__ == '__main__':`, since other processes import it"
            ) from error

    def stop(self, under_way: Sequence[Future[Any]]) -> None:
        """End the processes, at once if they still work."""
        if under_way:
            for process in list(self._executor._processes.values()):
                process.terminate()
        self._executor.shutdown(cancel_futures=True)


class _End:
    """Whether this process is to end, and whether that has to wait."""

    requested = waits = False


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let a process of ours that is to end do this first."""
    _End.waits = True
    try:
        yield
    finally:
        _End.waits = False
        if _End.requested:
            os._exit(1)


def _end(*_: object) -> None:
    _End.requested = True
    if not _End.waits:
        os._exit(1)


def _begin() -> None:
    """Prepare a process: what a call warns of is in its result, and interruptions are for the one that asked for it."""
    from multiprocessing import parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
    warnings.simplefilter("ignore", IdentifiabilityWarning)
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    # a killed parent does not tell its processes, which would wait for calls for ever
    threading.Thread(target=follow, daemon=True).start()

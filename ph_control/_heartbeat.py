"""Signs of life of a long computation: stages that tell where it is, to the callback of the call that runs.

Numerical loops call `alive`; it does nothing unless a fit with a callback runs, and that is told once a second at most.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace

from . import _checks
from .exceptions import StructureError

_PAUSE = 1.0  # seconds from one report to the next


@dataclass(frozen=True)
class Progress:
    """State of a fit: number of modes, largest number, iteration, mean squared residual, and what is computed.

    Before the first iteration the order is 0 and the loss is NaN.
    """

    order: int
    max_order: int
    iteration: int
    loss: float
    stage: str = "search"

    def __str__(self) -> str:
        if not self.order:
            return self.stage
        stage = "" if self.stage == "search" else f"{self.stage}: "
        return (
            f"{stage}order {self.order} of at most {self.max_order}, iteration {self.iteration}, rms residual "
            f"{math.sqrt(self.loss):.4g}"
        )


Report = Callable[[int, float], None]  # iteration, loss
Callback = Callable[[Progress], object]


@dataclass
class Heartbeat:
    """A callback that is also told where the computation is between iterations."""

    callback: Callback
    latest: Progress = Progress(0, 0, 0, math.nan)
    reported: float = field(default_factory=time.monotonic)

    def __call__(self, progress: Progress) -> None:
        """Report an iteration."""
        self.latest, self.reported = progress, time.monotonic()
        self.callback(progress)

    def beat(self, stage: str) -> None:
        """Report a stage, unless something was reported just now."""
        if time.monotonic() - self.reported < _PAUSE:
            return
        try:
            self(replace(self.latest, stage=stage))
        except StopIteration:
            raise KeyboardInterrupt from None


_CURRENT: ContextVar[Heartbeat | None] = ContextVar("ph_control_heartbeat", default=None)


def alive(stage: str) -> None:
    """Tell the callback of the fit that runs, if there is one, what is computed."""
    heartbeat = _CURRENT.get()
    if heartbeat is not None:
        heartbeat.beat(stage)


@contextmanager
def heard_by(callback: Callback | None) -> Iterator[Callback | None]:
    """Context in which `alive` reaches a callback; gives what is to be called in its place."""
    heartbeat = Heartbeat(callback) if callable(callback) else callback
    token = _CURRENT.set(heartbeat if callable(callback) else None)
    try:
        yield heartbeat
    finally:
        _CURRENT.reset(token)
        if callback is show_progress:
            _BAR.close()


def reporter(largest: int, callback: Callback | None) -> Callable[[int], Report | None]:
    """Make what reports the iterations of a number of modes to a callback, which ends the fit by `StopIteration`."""
    if callback is not None and not callable(callback):
        raise StructureError(f"callback is {_checks.shown(callback)}; pass a function of one argument, or None")

    def report(order: int) -> Report | None:
        if callback is None:
            return None

        def after_iteration(iteration: int, loss: float) -> None:
            try:
                callback(Progress(order, largest, iteration, loss))
            except StopIteration:
                raise KeyboardInterrupt from None

        return after_iteration

    return report


class _ProgressBar:
    """Bar of the number of modes on standard error, written anew at most five times a second, gone at the end."""

    width, pause = 20, 0.2

    def __init__(self) -> None:
        self.length, self.written = 0, -math.inf

    def __call__(self, progress: Progress) -> None:
        if time.monotonic() - self.written < self.pause:
            return
        full = self.width * progress.order // max(progress.max_order, 1)
        self._put(f"[{'#' * full}{'.' * (self.width - full)}] {progress}")
        self.written = time.monotonic()

    def close(self) -> None:
        """Leave an empty line."""
        if self.length:
            self._put("")
            print(end="\r", file=sys.stderr, flush=True)
        self.written = -math.inf

    def _put(self, line: str) -> None:
        # a carriage return is what terminals and notebooks have in common
        print(f"\r{line.ljust(self.length)}", end="", file=sys.stderr, flush=True)
        self.length = len(line)


_BAR = _ProgressBar()


def show_progress(progress: Progress) -> None:
    """Callback of `pem` that shows a bar in a terminal or notebook while the fit runs.

    Parameters
    ----------
    progress : Progress
        With `order`, `max_order`, `iteration`, `loss` and `stage`.

    Raises
    ------
    StructureError
        If it is called with something else.

    Notes
    -----
    Writes at most five times a second, to standard error, and leaves an empty line when the fit ends.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> u = np.random.default_rng(0).standard_normal(200)
    >>> y = phc.forced_response(phc.ph(phc.modes(1.0, 1.0)), 0.1 * np.arange(200), u, intersample="zoh").outputs
    >>> phc.pem((u, y), 1, dt=0.1, callback=phc.show_progress).order
    1
    """
    if not isinstance(progress, Progress):
        raise StructureError(
            f"progress is {type(progress).__name__}; pass the function itself, as pem(data, callback=show_progress)"
        )
    _BAR(progress)

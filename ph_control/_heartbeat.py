"""Signs of life of a long computation: stages that tell where it is, to the callback of the call that runs.

Numerical loops call `alive`; it does nothing unless a fit with a callback runs, and that is told once a second at most.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any

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


@dataclass
class Heartbeat:
    """A callback that is also told where the computation is between iterations."""

    callback: Callable[[Progress], Any]
    latest: Progress = Progress(0, 0, 0, math.nan)
    told: float = field(default_factory=time.monotonic)

    def __call__(self, progress: Progress) -> None:
        """Report an iteration."""
        self.latest, self.told = progress, time.monotonic()
        self.callback(progress)

    def beat(self, stage: str) -> None:
        """Report a stage, unless something was reported just now."""
        if time.monotonic() - self.told < _PAUSE:
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
def heard_by(callback: Any) -> Iterator[Any]:
    """Context in which `alive` reaches a callback; gives what is to be called in its place."""
    heartbeat = Heartbeat(callback) if callable(callback) else callback
    token = _CURRENT.set(heartbeat if callable(callback) else None)
    try:
        yield heartbeat
    finally:
        _CURRENT.reset(token)

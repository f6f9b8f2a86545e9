"""What a fit tells of its progress while it runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ... import _checks
from ..._heartbeat import Progress
from ...exceptions import StructureError

Report = Callable[[int, float], None]  # iteration, loss


Callback = Callable[[Progress], Any]


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

"""Fits and reductions on one thread of BLAS: for small matrices, threads wait longer for one another than they work."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from threading import Lock
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")

_LIMITED = Lock()


@cache
def _controller() -> ThreadpoolController:
    """Libraries that are loaded, which takes some ten milliseconds to find out."""
    return ThreadpoolController()


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """A function that runs with one thread of BLAS; afterwards there are as many as before.

    The number is that of the process: of calls at the same time, or inside one another, the first sets it and sets it
    back.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        if not _LIMITED.acquire(blocking=False):
            return function(*args, **kwargs)
        try:
            with _controller().limit(limits=1, user_api="blas"):
                return function(*args, **kwargs)
        finally:
            _LIMITED.release()

    return limited

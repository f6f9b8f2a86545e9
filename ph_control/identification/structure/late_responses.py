"""Responses of outputs that come later than those of modes and lags, where poles that stand for the delay show it.

Heavily damped poles imitate a delay within the band, and so do constants and slopes of a background.  So delays are
compared beside the poles of a fit without some of these, and without a background, all on a grid; the likeliest are
refined together with the poles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from ..._types import ComplexArray, Mask
from ..growth.ending import settled
from ..moves.delays import are_heavy
from ..regression.free import Delays, FreeProjection, Lateness
from ..regression.frequency_rows import FreeResponse, typical_distance
from ..regression.tuning import TUNING
from ..search.channel_rows import RowOptions
from ..search.fitted_modes import FreeFit
from ..search.free_search import Responses
from ..search.path import FreePath
from .constrained import constrained
from .coordinates import ChannelLayout
from .late_outputs import WithDelay

_TURN = 1.0  # rad, by which delays of the grid turn the last point
_LONGEST = 120.0  # rad, by which the longest does, unless points are so far apart that
_BETWEEN = 0.5 * np.pi  # rad are turned from one to the next
_POINTS = 120  # of responses that the grid is compared at
_STANDING = 6  # most heavy poles that may be no delay
_ROUNDS = 3  # of comparisons, each with the poles of the one before
_FEW = 12  # iterations, after which delays are compared


class _Late(NamedTuple):
    """Poles with a delay of all outputs and the BIC of both, alone or beside the background of the fit."""

    bic: float
    delay: float
    p: ComplexArray
    alone: bool


@dataclass(frozen=True)
class _LateModels:
    """Models of the responses of a fit with some of its poles and a delay, in the noise of the fit."""

    fit: FreeFit
    quantities: tuple[str, ...]

    @cached_property
    def rows(self) -> list[FreeResponse]:
        """Rows of the fit."""
        return [rows for rows in self.fit.projection.experiments if isinstance(rows, FreeResponse)]

    @property
    def step(self) -> float:
        """Distance of the delays that are compared."""
        return _TURN / max(rows.ceiling for rows in self.rows)

    def likeliest(self) -> _Late:
        """Return the likeliest poles and delay; beside poles that are refined with a delay another may be likelier."""
        best = self._about(self.fit.projection.p)
        for _ in range(_ROUNDS):
            if abs(self._on_grid(best.p, best.alone) - best.delay) <= 2 * self.step:
                break
            other = self._about(best.p)
            if other.bic >= best.bic:
                break
            best = other
        return self._refined(best.delay, best.p, best.alone, None)

    def _about(self, p: ComplexArray) -> _Late:
        """Return the likeliest delay beside some poles or less of the heavy ones, the slowest of which stay."""
        heavy = np.flatnonzero(are_heavy(p))
        heavy = heavy[np.argsort(np.abs(p[heavy]))]
        starts = [np.delete(p, heavy[kept:]) for kept in range(min(len(heavy), _STANDING) + 1)]
        pairs = product(starts, (False, True))
        return min((self._refined(self._on_grid(*pair), *pair, _FEW) for pair in pairs), key=attrgetter("bic"))

    def _on_grid(self, p: ComplexArray, alone: bool) -> float:
        """Return the delay that is likeliest beside some poles as they are."""
        fed = self._felt if alone else self.fit.projection.fed
        fed = None if fed is None else np.tile(fed, (len(self._grid), 1))
        losses = FreeProjection(self._delayed[alone], p, fed).losses.reshape(len(self._grid), -1)
        return self._grid[int(np.argmin(np.log(losses).sum(axis=1)))]

    @cached_property
    def _delayed(self) -> dict[bool, list[FreeResponse]]:
        """Some of the points, as other entries with each delay of the grid; on the background of the fit or without it.

        All delays share the columns of some poles.
        """
        count, turned = len(self.fit.scales), list[FreeResponse]()
        for rows in self.rows:
            some = rows.every(1 + rows.samples // (2 * _POINTS))
            early = [some.response * np.exp(1j * some.frequencies * delay) for delay in self._grid]
            outputs = [some.outputs + place * count for place in range(len(self._grid))]
            turned.append(replace(some, response=np.concatenate(early), outputs=np.concatenate(outputs), delay=None))
        return {False: turned, True: [replace(rows, terms=()) for rows in turned]}

    @cached_property
    def _felt(self) -> Mask:
        """Entries that are fed through in any case."""
        return self._path(0.0).felt

    def _path(self, delay: float) -> FreePath:
        """Return the search with a delay of all outputs, beside the background of the fit."""
        late = Lateness(np.full(len(self.quantities), delay), self.fit.input_delay)
        path = FreePath.of(self.fit.channels, RowOptions(self.quantities, late=late))
        path.add_terms(self.rows)
        return path

    @cached_property
    def _grid(self) -> list[float]:
        """Return delays up to the longest that is looked for."""
        omega = [rows.omega for rows in self.rows]
        turned = min(_BETWEEN * each[-1] / typical_distance(each[len(each) // 2 :]) for each in omega)
        return [self.step * place for place in range(int(min(turned, _LONGEST) / _TURN) + 1)]

    def _refined(self, delay: float, p: ComplexArray, alone: bool, iterations: int | None) -> _Late:
        """Refine poles with a delay of all outputs, in so many iterations."""
        path = self._path(delay)
        fed = self.fit.projection.fed
        if alone:
            _drop_background(path)
            fed = path.felt
        projection, _ = settled(path, p, fed, None)
        inputs = len(path.sizes) // len(self.quantities)
        layout = ChannelLayout(len(self.quantities), inputs, 1.0 / path.sizes, self.quantities, per_entry=True)
        delays = Delays(np.zeros(len(path.sizes), int), np.array([delay]), self.step, 0.0, _LONGEST / _TURN * self.step)
        late = constrained(projection, layout, "free", path.region(projection.p), iterations, delays)
        unknowns = path.unknowns_of(late.p) - (0 if fed is None else int(np.sum(~fed))) + 1
        bic = path.criteria(path.loglik(path.in_data(late.projection.losses)), unknowns).bic
        return _Late(bic, float(delays.values[0] if late.delays is None else late.delays.values[0]), late.p, alone)


def _drop_background(path: FreePath) -> None:
    """Go on without a background."""
    while isinstance(path.search, Responses) and path.search.terms:
        path.search = path.search.without_term(path.search.terms[0])
    path.weigh(path.power)


def with_shown_delay(free: FreeFit, quantities: tuple[str, ...], with_delay: WithDelay) -> FreeFit:
    """Return a fit to responses, or that with a delay of all outputs which its poles show, if that is likelier.

    It is looked for where poles may stand for it, and once more where those that a first one leaves may.
    """
    if not free.per_entry or free.windowed or free.rounding or free.interrupted or free.delay.any():
        return free
    best = free
    for _ in range(_ROUNDS):
        late = _likelier(best, quantities, with_delay)
        if late.interrupted:
            return replace(best, interrupted=True)
        if late is best:
            break
        best = late
    gain = 0.5 * (free.criteria.bic - best.criteria.bic)
    return free if best is free else replace(best, delay_gain=gain).with_delay_open(True)


def _likelier(fit: FreeFit, quantities: tuple[str, ...], with_delay: WithDelay) -> FreeFit:
    """Return a fit, or that with the likeliest delay beside some of its poles where it is likelier."""
    if not are_heavy(fit.projection.p).any():
        return fit
    try:
        best = _LateModels(fit, quantities).likeliest()
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    if best.bic >= fit.criteria.bic - TUNING.sure:
        return fit
    late = with_delay(Lateness(np.full(len(quantities), best.delay), fit.input_delay))
    return late if late.interrupted or late.criteria.bic < fit.criteria.bic - 2 * TUNING.sure else fit

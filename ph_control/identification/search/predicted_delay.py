"""Samples by which outputs come late, as predictors from past inputs and outputs show it before any search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..regression.time_rows import FreeRecord
from .predictor_states import likeliest, predictors_of, signals_of

_ROWS = 100  # of a covariance
_SHARE = 10  # of the shortest record: no delay is longer
_LONGEST = 1000  # samples
_WORSE = 2, 6  # delays one after the other that foretell less than none, or than some, after which none is looked at
_FEW = 8  # delays after which no longer ones are looked at unless states are spared
_SPARED = 0.5  # of the states that a delay spares, which have to show in the criterion


@dataclass(frozen=True)
class _AfterDelay:
    """The best predictor after a delay: its BIC, twice the negative log-likelihood of all of the past.

    What a state costs that a delay spares, and what an input; the longest past; whether inputs foretell anything, and
    are fed through.
    """

    cost: float
    loss: float
    state: float
    input: float
    past: int
    shown: bool
    fed: bool


@dataclass(frozen=True)
class _Delays:
    """Records of so many outputs after delays, of the samples that the most of these leaves."""

    records: Sequence[FreeRecord]
    outputs: int
    most: int
    known: dict[int, _AfterDelay | None] = field(default_factory=dict)

    def after(self, samples: int) -> _AfterDelay | None:
        """Delay by some samples; None where records are too short."""
        if samples not in self.known:
            self.known[samples] = self._after(samples)
        return self.known[samples]

    def _after(self, samples: int) -> _AfterDelay | None:
        late = [rows.delayed(samples * rows.hold.h, 0.0, self.most * rows.hold.h) for rows in self.records]
        signals = signals_of(late, self.outputs)
        predictors = predictors_of(signals, self.outputs, _ROWS) if signals else []
        if not predictors:
            return None
        count = sum(each.shape[1] for each in signals or ())
        longest, price = predictors[0], float(np.log(count * self.outputs))
        cost, states, best = likeliest(predictors, count, longest.largest)[0]
        return _AfterDelay(
            cost, count * float(longest.errors[-1]), best.inputs * (best.signals + self.outputs) * price,
            best.inputs * self.outputs * price, longest.horizon, longest.shows_inputs(count),
            best.feeds_through(states, count),
        )  # fmt: skip

    def where_inputs_show(self, none: _AfterDelay) -> int | None:
        """Return the least delay of some, half a past apart, after which inputs foretell anything.

        Those that are over before the samples that are left foretell nothing.
        """
        lasting = all(np.all(2 * rows.u[:, self.most :].var(axis=1) > rows.u.var(axis=1)) for rows in self.records)
        delays = range(0, self.most + 1 if lasting else 1, max(1, none.past // 2))
        return next((delay for delay in delays if (after := self.after(delay)) and after.shown), None)

    def descent(self, begin: int) -> list[_AfterDelay]:
        """Predictors after a delay and those that follow, until they foretell less, or spare no states."""
        tried = list[_AfterDelay]()
        while begin + len(tried) <= self.most and (after := self.after(begin + len(tried))) is not None:
            tried.append(after)
            first, least = tried[0], min(each.cost for each in tried)
            patience = _WORSE[bool(begin) or first.cost - least > _SPARED * first.state]
            worse = min(each.cost for each in tried[-patience:]) > least
            if worse or (len(tried) > _FEW and first.cost - least < _SPARED * (len(tried) - 1) * first.state):
                break
        return tried


def predicted_delay(records: Sequence[FreeRecord], outputs: int, felt: bool) -> tuple[int, float]:
    """Return by how many samples outputs come later than the response to inputs, so that predictors foretell most.

    Each sample of a delay spares a state for each input.  None come before: in a closed loop inputs answer to outputs.
    Unless inputs are `felt` at once, a first sample of a response that is fed through is one of the response.

    Parameters
    ----------
    records : sequence of FreeRecord
        Records without a delay.
    outputs : int
        Number of outputs.
    felt : bool
        Whether some outputs answer to inputs at once.

    Returns
    -------
    tuple of int and float
        Samples, up to a tenth of the shortest record and 1000, and the log-likelihood that they gain; 0 where records
        are too short, or show no delay.
    """
    delays = _Delays(records, outputs, min(min((rows.length for rows in records), default=0) // _SHARE, _LONGEST))
    none = delays.after(0)
    begin = None if none is None else delays.where_inputs_show(none)
    if none is None or begin is None:
        return 0, 0.0
    tried = delays.descent(begin)
    likely = min(range(len(tried)), key=lambda place: tried[place].cost)
    spared, gain = likely - bool(tried[likely].fed and not felt), none.cost - tried[likely].cost
    if begin + spared <= 0 or gain <= _SPARED * spared * none.state:
        return 0, 0.0
    # states of a short past may hide the last samples
    last = likely
    while last + 1 < len(tried) and tried[last + 1].loss < tried[last].loss + none.input:
        last += 1
    return begin + last - bool(tried[last].fed and not felt), 0.5 * gain

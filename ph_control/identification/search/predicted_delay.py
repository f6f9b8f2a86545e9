"""Samples by which outputs come late, as predictors from past inputs and outputs show it before any search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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

    What a state costs; the shortest past; whether inputs foretell anything, and are fed through.
    """

    cost: float
    loss: float
    spared: float
    charge: float
    past: int
    shown: bool
    fed: bool

    @classmethod
    def by(cls, samples: int, records: Sequence[FreeRecord], outputs: int, most: int) -> _AfterDelay | None:
        """Delay by some samples, of those that are left by the most; None where records are too short."""
        late = [rows.delayed(samples * rows.hold.h, 0.0, most * rows.hold.h) for rows in records]
        signals = signals_of(late, outputs)
        predictors = predictors_of(signals, outputs, _ROWS) if signals else []
        if not predictors:
            return None
        count = sum(each.shape[1] for each in signals or ())
        longest, price = predictors[0], float(np.log(count * outputs))
        cost, states, best = likeliest(predictors, count, longest.largest)[0]
        return cls(
            cost, count * float(longest.errors[-1]), best.inputs * (best.signals + outputs) * price,
            best.inputs * outputs * price, longest.horizon, longest.shows_inputs(count),
            best.feeds_through(states, count),
        )  # fmt: skip


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
    most = min(min((rows.length for rows in records), default=0) // _SHARE, _LONGEST)

    def after(delay: int) -> _AfterDelay | None:
        return _AfterDelay.by(delay, records, outputs, most)

    none = first = after(0)
    begin = 0
    # of a delay that is longer than the past inputs show nothing; nor of inputs that are over by then
    lasting = all(np.all(2 * rows.u[:, most:].var(axis=1) > rows.u.var(axis=1)) for rows in records)
    while first is not None and not first.shown and lasting and begin + first.past // 2 <= most:
        begin += first.past // 2
        first = after(begin)
    if none is None or first is None or not first.shown:
        return 0, 0.0
    tried = [first]
    for delay in range(begin + 1, most + 1):
        tried.append(after(delay) or none)
        least = min(each.cost for each in tried)
        patience = _WORSE[bool(begin) or first.cost > least]
        spared = _SPARED * (delay - begin) * first.spared
        if min(each.cost for each in tried[-patience:]) > least or (len(tried) > _FEW and first.cost - least < spared):
            break
    likely = min(range(len(tried)), key=lambda place: tried[place].cost)
    gain = none.cost - tried[likely].cost
    if gain <= _SPARED * likely * first.spared:
        return 0, 0.0
    # states of a short past may hide the last samples
    last = likely
    while last + 1 < len(tried) and tried[last + 1].loss < tried[last].loss + first.charge:
        last += 1
    delay = begin + last - bool(tried[last].fed and not felt)
    return (delay, 0.5 * gain) if delay > 0 else (0, 0.0)

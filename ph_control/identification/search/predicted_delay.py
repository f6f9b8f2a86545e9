"""Samples by which outputs come late, as predictors from past inputs and outputs show it before any search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..regression.time_rows import FreeRecord
from .predictor_states import likeliest, predictors_of, signals_of

_ROWS = 100  # of a covariance
_SHARE = 10  # of the shortest record: no delay is longer
_WORSE = 2  # delays one after the other that foretell less, after which no longer ones are looked at
_FEW = 8  # delays after which no longer ones are looked at unless states are spared
_SPARED = 0.5  # of the states that a delay spares, which have to show in the criterion


@dataclass(frozen=True)
class _Delayed:
    """BIC of the best predictor, twice the negative log-likelihood of all of the past, whether inputs feed through."""

    cost: float
    loss: float
    fed: bool


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
        Samples, and the log-likelihood that they gain; 0 where records are too short, or show no delay.
    """
    most = min((rows.length for rows in records), default=0) // _SHARE
    delayed, spared = list[_Delayed](), 0.0
    for delay in range(most + 1):
        # of the same samples
        late = [rows.delayed(delay * rows.hold.h, 0.0, most * rows.hold.h) for rows in records]
        signals = signals_of(late, outputs)
        predictors = predictors_of(signals, outputs, _ROWS) if signals else []
        if not predictors:
            return 0, 0.0
        samples = sum(each.shape[1] for each in signals or ())
        price = float(np.log(samples * outputs))
        cost, states, best = likeliest(predictors, samples, predictors[0].largest)[0]
        fed = not felt and best.feeds_through(states, samples)
        delayed.append(_Delayed(cost, samples * float(predictors[0].errors[-1]), fed))
        least, spared = min(each.cost for each in delayed), best.inputs * (best.signals + outputs) * price
        worse = min(each.cost for each in delayed[-_WORSE:]) > least
        if worse or (delay > _FEW and delayed[0].cost - least < _SPARED * delay * spared):
            break
    if not delayed:
        return 0, 0.0
    likely = min(range(len(delayed)), key=lambda delay: delayed[delay].cost)
    gain = delayed[0].cost - delayed[likely].cost
    if gain <= _SPARED * likely * spared:
        return 0, 0.0
    # states of a short past may hide the last samples
    delay, charge = likely, best.inputs * outputs * price
    while delay + 1 < len(delayed) and delayed[delay + 1].loss < delayed[delay].loss + charge:
        delay += 1
    delay -= bool(delayed[delay].fed)
    return (delay, 0.5 * gain) if delay else (0, 0.0)

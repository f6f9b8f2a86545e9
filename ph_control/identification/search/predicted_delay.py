"""Samples by which outputs come late, as predictors from past inputs and outputs show it before any search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..regression.time_rows import FreeRecord
from .predictor_states import likeliest, predictors_of, signals_of

_ROWS = 100  # of a covariance
_SHARE = 10  # of the shortest record: no delay is longer
_WORSE = 4  # delays one after the other that foretell less, after which no longer ones are looked at
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
    shortest = min((rows.length for rows in records), default=0)
    most = shortest // _SHARE
    delayed = list[_Delayed]()
    for delay in range(most + 1):
        # of the same samples
        late = [rows.delayed(delay * rows.hold.h, 0.0, most * rows.hold.h) for rows in records]
        signals = signals_of(late, outputs)
        predictors = predictors_of(signals, outputs, _ROWS) if signals else []
        if not predictors:
            return 0, 0.0
        samples = sum(each.shape[1] for each in signals or ())
        cost, states, best = likeliest(predictors, samples, predictors[0].largest)[0]
        fed = not felt and best.feeds_through(states, samples)
        delayed.append(_Delayed(cost, samples * float(predictors[0].errors[-1]), fed))
        if min(each.cost for each in delayed[-_WORSE:]) > min(each.cost for each in delayed):
            break
    likely = min(range(len(delayed)), key=lambda delay: delayed[delay].cost) if delayed else 0
    delay, charge = likely, best.inputs * outputs * float(np.log(samples * outputs))
    # states of a short past may hide the last samples
    while likely and delay + 1 < len(delayed) and delayed[delay + 1].loss < delayed[delay].loss + charge:
        delay += 1
    delay -= bool(delay and delayed[delay].fed)
    gain = delayed[0].cost - delayed[likely].cost if delay else 0.0
    spared = likely * best.inputs * (best.signals + outputs) * float(np.log(samples * outputs))
    return (delay, 0.5 * gain) if gain > _SPARED * spared else (0, 0.0)

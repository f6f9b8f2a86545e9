"""Samples by which outputs come late, as predictors from past inputs and outputs show it before any search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ..._types import Indices
from ..regression.time_rows import FreeRecord
from .predictor_states import likeliest, predictors_of, signals_of

_ROWS = 100  # of a covariance
_SHARE = 10  # of the shortest record: no delay is longer
_LONGEST = 1000  # samples
_SPARED = 0.5  # of the states that a delay spares, which have to show in the criterion
_NEXT_TO_NOTHING = 0.01  # of what all inputs foretell
_PATIENCE = 2, 6  # delays one after the other that are no likelier, after which none is looked at; more beyond the past


@dataclass(frozen=True)
class _AfterDelay:
    """The best predictor after a delay: its BIC, what a state costs that a delay spares, and the longest past.

    Then whether inputs foretell anything, and for how many samples, the present one first, nothing, or next to nothing.
    """

    cost: float
    state: float
    past: int
    shown: bool
    idle: int
    nearly_idle: int
    together: bool  # whether inputs foretell all outputs as early as one another


@dataclass(frozen=True)
class _Delays:
    """Records of so many outputs after delays, of the samples that the most of these leaves."""

    records: Sequence[FreeRecord]
    outputs: int
    most: int
    known: dict[int, _AfterDelay | None] = field(default_factory=dict)

    @classmethod
    def of(cls, records: Sequence[FreeRecord], outputs: int) -> _Delays:
        """Delays of up to a tenth of the shortest record."""
        return cls(records, outputs, min(min((rows.length for rows in records), default=0) // _SHARE, _LONGEST))

    def after(self, samples: int) -> _AfterDelay | None:
        """Delay by some samples; None where records are too short, or there are no such delays."""
        if samples not in self.known:
            self.known[samples] = self._after(samples) if 0 <= samples <= self.most else None
        return self.known[samples]

    def _after(self, samples: int) -> _AfterDelay | None:
        late = [rows.delayed(samples * rows.hold.h, 0.0, self.most * rows.hold.h) for rows in self.records]
        signals = signals_of(late, self.outputs)
        predictors = predictors_of(signals, self.outputs, _ROWS) if signals else []
        if not predictors:
            return None
        count = sum(each.shape[1] for each in signals or ())
        longest, price = predictors[0], float(np.log(count * self.outputs))
        cost, _, best = likeliest(predictors, count, longest.largest)[0]
        idle, nearly_idle = (longest.idle_inputs(count, share) for share in (0.0, _NEXT_TO_NOTHING))
        return _AfterDelay(
            cost, best.inputs * (best.signals + self.outputs) * price, longest.horizon, longest.shows_inputs(count),
            idle, nearly_idle, longest.answer_together(count),
        )  # fmt: skip

    def where_inputs_show(self, none: _AfterDelay) -> int | None:
        """Return the least delay of some, half a past apart, after which inputs foretell anything.

        Those that are over before the samples that are left foretell nothing.
        """
        lasting = all(np.all(2 * rows.u[:, self.most :].var(axis=1) > rows.u.var(axis=1)) for rows in self.records)
        delays = range(0, self.most + 1 if lasting else 1, max(1, none.past // 2))
        return next((delay for delay in delays if (after := self.after(delay)) and after.shown), None)

    def likeliest(self, begin: int, patience: int) -> tuple[int, _AfterDelay]:
        """Return the delay of the smallest BIC about one to begin with, from where so many are no likelier."""
        known = [(after.cost, begin, after)] if (after := self.after(begin)) else []
        for step in (1, -1):
            samples, missed = min(known)[1], 0
            while missed < patience and (after := self.after(samples := samples + step)):
                missed = missed + 1 if after.cost >= min(known)[0] else 0
                known.append((after.cost, samples, after))
        return min(known)[1:]

    def predicted(self, felt: bool) -> tuple[int, float]:
        """Return the delay with which predictors foretell most, and the log-likelihood that it gains."""
        none = self.after(0)
        begin = None if none is None else self.where_inputs_show(none)
        first = None if begin is None else self.after(begin)
        if none is None or begin is None or first is None:
            return 0, 0.0
        hold = int(not felt)  # samples by which outputs follow inputs without a delay
        jump = max(0, first.nearly_idle - hold) if first.nearly_idle <= first.past else 0
        samples, best = self.likeliest(min(begin + jump, self.most), _PATIENCE[begin > 0])
        # states of a short past may hide the last samples; one that is fed through belongs to the response
        more = best.idle - hold
        gain, spared = none.cost - best.cost, samples - begin + min(more, 0)
        samples = min(max(samples + more, 0), self.most)
        return (samples, 0.5 * gain) if samples and gain > _SPARED * spared * none.state else (0, 0.0)


def predicted_delays(records: Sequence[FreeRecord], outputs: int, felt: bool) -> tuple[Indices, float]:
    """Return by how many samples each output comes later, and the log-likelihood that this gains.

    As `predicted_delay` has it for all of them; where inputs foretell some earlier than others, for each alone, if that
    gains more.
    """
    delays = _Delays.of(records, outputs)
    common, first = delays.predicted(felt), delays.after(0)
    if first is None or first.together:
        return np.full(outputs, common[0]), common[1]
    return likelier_apart(common, partial(predicted_delay, felt=felt), records, outputs)


def likelier_apart(
    common: tuple[int, float], shown: Callable[[Sequence[FreeRecord], int], tuple[int, float]],
    records: Sequence[FreeRecord], outputs: int,
) -> tuple[Indices, float]:  # fmt: skip
    """Return the samples by which all outputs come late, or those that each shows alone, and what these gain, if more.

    `shown` gives samples and gain of so many outputs.
    """
    own = [shown(_of_output(records, output), 1) for output in range(outputs)]
    gain = sum(each for _, each in own)
    if gain > common[1]:
        return np.array([late for late, _ in own]), gain
    return np.full(outputs, common[0]), common[1]


def _of_output(records: Sequence[FreeRecord], output: int) -> list[FreeRecord]:
    """Return records of one of the outputs."""
    seen = (record.among_outputs(record.outputs == output) for record in records if output in record.outputs)
    return [replace(record, outputs=np.zeros(1, int)) for record in seen]


def predicted_delay(records: Sequence[FreeRecord], outputs: int, felt: bool) -> tuple[int, float]:
    """Return by how many samples outputs come later than the response to inputs, so that predictors foretell most.

    For so many samples inputs foretell nothing, and each of them spares a state for each input.  None come before: in a
    closed loop inputs answer to outputs.

    Parameters
    ----------
    records : sequence of FreeRecord
        Records without a delay.
    outputs : int
        Number of outputs.
    felt : bool
        Whether some outputs answer to inputs at once; others follow them by a sample.

    Returns
    -------
    tuple of int and float
        Samples, up to a tenth of the shortest record and 1000, and the log-likelihood that they gain; 0 where records
        are too short, or show no delay.
    """
    return _Delays.of(records, outputs).predicted(felt)

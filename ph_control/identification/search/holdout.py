"""What models of a part of the data foretell of the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ...exceptions import IdentificationError
from ..regression.frequency_rows import FrequencyRows
from ..regression.time_rows import Experiment, Rows
from ..regression.variable_projection import Problem, refine
from .formulation import Formulation
from .steps import Step

Array = NDArray[np.float64]

_POLISH = 1e-15  # relative decrease of the loss at which a refinement ends: what is foretold feels the frequencies


@dataclass(frozen=True)
class HeldOut:
    """The problem of what is not held out, how many rows are, and the errors of a model of each experiment there.

    Of each record the last part is held out, of a response points all over it, since neighbours foretell these.
    """

    training: Problem
    ahead: int
    errors: tuple[Callable[[Array, Array, Array], Array], ...]

    @classmethod
    def of(cls, problem: Problem, part: float) -> HeldOut:
        """Hold out a part of each experiment."""
        parts = [_split(one, part) for one in problem.experiments]
        training = replace(problem, experiments=tuple(first for first, _, _ in parts))
        return cls(training, sum(rows for _, rows, _ in parts), tuple(errors for _, _, errors in parts))

    def loss(self, d: Array) -> float:
        """Mean squared error over what is held out, of the model that fits the rest best about these frequencies."""
        end = refine(self.training, d, rtol=_POLISH)
        if end.interrupted:
            raise KeyboardInterrupt
        at = end.projection
        found = [errors(at.d, at.kappa, own) for errors, own in zip(self.errors, at.own, strict=True)]
        return float(np.mean(np.concatenate(found) ** 2))


def held_out_losses(posed: Formulation, guess: Array, orders: Sequence[int], part: float) -> tuple[int, Array]:
    """Number of equations held out, and the mean squared error of each order there; infinite if too few are left.

    The models are those of a path of their own: frequencies found in all of the data would know what is to be foretold.
    """
    rest = HeldOut.of(posed.problem, part)
    if not rest.ahead or not rest.training.samples:
        raise IdentificationError(
            f"with {part:.3g} of the data held out there are {rest.training.samples} observed outputs to fit and "
            f"{rest.ahead} to foretell; hold out another part, or choose by 'bic'"
        )
    largest = min(max(orders), rest.training.carried)
    path: list[Step] = []
    if largest:
        # under the circumstances that all of the data have decided
        posed = replace(posed, problem=rest.training, open=frozenset(), searched=None)
        path = posed.path(guess, posed.largest_order(largest, largest, guess)).steps
    if path and path[-1].interrupted:
        raise KeyboardInterrupt
    losses = {len(step.d): rest.loss(step.d) for step in path if len(step.d) in orders}
    losses.setdefault(0, rest.loss(np.zeros(0)))
    # a path that ended in rounding has no better model of higher order
    last = rest.loss(path[-1].d) if path and len(path[-1].d) < largest else np.inf
    return rest.ahead, np.array([losses.get(n, last if n <= largest else np.inf) for n in orders])


def _split(one: Rows, part: float) -> tuple[Rows, int, Callable[[Array, Array, Array], Array]]:
    """The part of an experiment to fit to, how many rows the rest has, and the errors of a model there."""
    if isinstance(one, FrequencyRows):
        return _thinned(one, part)
    one = cast(Experiment, one)
    cut = len(one.u) - max(1, round(part * len(one.u)))
    first = replace(one, u=one.u[:cut], y=one.y[:cut], observed=one.observed[:cut])
    kept = one.observed[cut:]

    def errors(d: Array, kappa: Array, own: Array) -> Array:
        return (one.y - one.at(d).predict(kappa, own))[cut:][kept]

    return first, int(kept.sum()), errors


def _thinned(one: FrequencyRows, part: float) -> tuple[Rows, int, Callable[[Array, Array, Array], Array]]:
    """Points held out evenly, real and imaginary part of each."""
    record = one.record
    seen = np.flatnonzero(record.observed)
    # where the running share of what is held out passes a whole number
    out = seen[np.diff(np.floor(part * np.arange(len(seen) + 1) + 0.5)) > 0]
    response = record.response.copy()
    response[out] = np.nan
    first = replace(one, record=replace(record, response=response))

    def errors(d: Array, kappa: Array, own: Array) -> Array:
        left = ((record.response - one.at(d).predict(kappa, own)) * np.sqrt(record.weights))[out]
        return np.concatenate([left.real, left.imag])

    return first, 2 * len(out), errors

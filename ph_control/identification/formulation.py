"""What data and options ask for: the linear problem they pose, where a search for its minimum starts and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from .._units import common_unit
from ..exceptions import IdentificationError, StructureError
from ..modal import ModalForm
from ..propagation import INTERSAMPLE, METHODS
from ..systems import modes
from .data import Record
from .experiment import Experiment
from .experiments import as_experiments
from .forward import grow
from .frequency_data import FrequencyRecord
from .frequency_rows import FrequencyRows
from .regressors import QUANTITIES, Hold
from .response_search import ResponseSearch
from .search import Report, Search, Step, TimeSearch
from .solver import Problem

Array = NDArray[np.float64]
Records = tuple[Record, ...] | tuple[FrequencyRecord, ...]

REPRESENTATIONS = ("observable", "controllable")


@dataclass(frozen=True)
class Progress:
    """What a callback is told after each iteration."""

    order: int
    max_order: int
    iteration: int
    loss: float


Callback = Callable[[Progress], Any]


@dataclass(frozen=True)
class Formulation:
    """The records and the problem that they pose."""

    records: Records
    problem: Problem

    @classmethod
    def of(
        cls, data: Any, dt: Any = None, weights: Any = None, *, method: str = "exact", intersample: str = "zoh",
        initial_state: str = "estimate", offset: bool = False, quantity: str = "velocity",
        representation: str = "observable",
    ) -> Formulation:  # fmt: skip
        """Check data and options, which are those of `pem`."""
        for name, value, allowed in (
            ("method", method, METHODS),
            ("intersample", intersample, INTERSAMPLE),
            ("initial_state", initial_state, ("estimate", "zero")),
            ("quantity", quantity, QUANTITIES),
            ("representation", representation, REPRESENTATIONS),
        ):
            _checks.choice(name, value, allowed)
        _checks.flags(offset=offset)
        records = as_experiments(data, dt, weights=weights)
        _refuse_unobserved(records)
        rest = initial_state == "zero"
        rows = [rows_of(record, method, intersample, quantity, from_rest=rest, offset=offset) for record in records]
        return cls(records, Problem(tuple(rows), structured=representation == "controllable"))

    @property
    def of_equal_weights(self) -> bool:
        """Whether these are frequency responses whose points count alike."""
        return all(isinstance(one, FrequencyRecord) and not np.ptp(one.weights) for one in self.records)

    def weighted(self, weights: Sequence[Array]) -> Formulation:
        """The same with weights for the points that were measured of each response."""
        records, rows = [], []
        for one, shares in zip(self.problem.experiments, weights, strict=True):
            if isinstance(one, FrequencyRows):
                all_shares = np.full(one.record.samples, float(np.median(shares)))
                all_shares[one.record.observed] = shares
                records.append(replace(one.record, weights=all_shares))
                rows.append(replace(one, record=records[-1]))
        return replace(self, records=tuple(records), problem=replace(self.problem, experiments=tuple(rows)))

    @cached_property
    def search(self) -> Search:
        """What adds modes to the problem."""
        problem = self.problem
        return TimeSearch(problem) if isinstance(problem.experiments[0], Experiment) else ResponseSearch(problem)

    @property
    def rtol(self) -> float:
        """Relative decrease of the loss at which a step of the search ends: what the criteria do not feel."""
        return min(1e-4, 0.1 / self.problem.samples)

    def path(
        self, guess: Array, largest: int, *, report: Callable[[int], Report | None] = lambda order: None,
        together: bool = False, stop: Callable[[list[Step]], bool] | None = None,
    ) -> list[Step]:  # fmt: skip
        """One mode after the other, from the guess on."""
        first = self.search.step(guess, self.rtol, report(len(guess)))
        floor = rounding_floor(self.problem)
        return grow(
            self.search, first, largest, rtol=self.rtol, floor=floor, report=report, together=together, stop=stop
        )

    def check_signals(self) -> None:
        """Refuse an output of nothing, and an input that no weight could be told from."""
        if not any(one.largest for one in self.problem.experiments):
            raise IdentificationError("the output is zero throughout the record; there is nothing to model")
        in_time = [one for one in self.problem.experiments if isinstance(one, Experiment) and one.driven]
        constant = [float(one.u[0]) for one in in_time if np.all(one.u == one.u[0])]
        at_rest = any(one.from_rest and one.u[0] != 0 for one in in_time)
        if in_time and len(constant) == len(in_time) and not at_rest:
            raise IdentificationError(
                f"the input is constant ({constant[0]:g}) throughout the record: a lossless model answers it like a "
                "free motion, so no weight r can be told from the initial state; record with an input that varies, "
                "pass initial_state='zero' if a step was applied to a plant at rest, or (None, y) if a free motion is "
                "meant"
            )

    def guess(self, initial_guess: Any) -> Array:
        """Frequencies to start from."""
        common_unit(self.records, initial_guess)
        if initial_guess is None:
            return np.zeros(0)
        if isinstance(initial_guess, tuple | list) and len(initial_guess) == 2:
            model = modes(*initial_guess)
        elif isinstance(own := getattr(initial_guess, "modes", None), ModalForm):
            model = own
        elif isinstance(initial_guess, ModalForm):
            model = initial_guess
        else:
            raise StructureError(
                f"initial_guess is a {type(initial_guess).__name__}; pass a pair (d, r), a ModalForm or a system"
            )
        if model.nports != 1 or not len(model.d):
            raise StructureError(
                f"initial_guess has {model.nports} ports and {len(model.d)} oscillating modes; needed one port "
                "and a mode"
            )
        if model.d.max() > self.problem.ceiling:
            raise StructureError(
                f"initial_guess has a mode at {model.d.max():.6g} rad/time; what the data can show ends at "
                f"{self.problem.ceiling:.6g}"
            )
        return np.array(model.d)

    def largest_order(self, order: int | str, max_order: int, guess: Array) -> int:
        """Largest order to try."""
        problem = self.problem
        own = problem.unknowns(0)
        per_mode = problem.unknowns(1) - own
        carried = problem.carried
        for name, value in (("order", order), ("max_order", max_order)):
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= 1
            if not (whole or (name == "order" and value == "auto")):
                allowed = "'auto' or a whole number >= 1" if name == "order" else "a whole number >= 1"
                raise StructureError(f"{name} is {value!r}; it must be {allowed}")
        what = (
            "observed output samples" if isinstance(problem.experiments[0], Experiment) else "real and imaginary parts"
        )
        if carried == 0:
            raise IdentificationError(
                f"the record has {problem.samples} {what}; one mode alone has {per_mode + own} unknowns, so "
                f"at least {per_mode + own + 1} are needed"
            )
        if order == "auto":
            if len(guess) > min(max_order, carried):
                raise StructureError(
                    f"initial_guess has {len(guess)} modes, more than the {min(max_order, carried)} that 'auto' "
                    "may take"
                )
            return int(min(max_order, carried))
        if int(order) > carried:
            raise IdentificationError(
                f"order {order} has {per_mode * int(order) + own} unknowns, more than the {problem.samples} {what} can "
                f"carry; the largest order for this record is {carried}"
            )
        if len(guess) > int(order):
            raise StructureError(f"initial_guess has {len(guess)} modes, more than the {order} of the order")
        return int(order)


def _refuse_unobserved(records: Records) -> None:
    """Refuse an experiment that says nothing beside others that do."""
    seen = [bool(record.observed.any()) for record in records]
    if len(seen) > 1 and not all(seen):
        place = seen.index(False)
        raise IdentificationError(
            f"experiment {place + 1} has no outputs: all {records[place].samples} of them are NaN; leave it out"
        )


def rows_of(
    record: Record | FrequencyRecord, method: str, intersample: str, quantity: str, *, from_rest: bool, offset: bool
) -> Any:
    """What one record offers to the solver; a frequency response has no samples that a method could meet."""
    if isinstance(record, FrequencyRecord):
        return FrequencyRows(record, quantity)
    hold, rest = Hold(record.dt, method, intersample), from_rest and record.driven
    return Experiment(record.u, record.y, record.observed, hold, rest, offset, quantity, record.driven)


def reporter(problem: Problem, largest: int, callback: Callback | None) -> Callable[[int], Report | None]:
    """What tells a callback of the iterations of each order."""

    def report(order: int) -> Report | None:
        if callback is None:
            return None
        return lambda iteration, loss: callback(Progress(order, largest, iteration, loss / problem.samples))

    return report


def rounding_floor(problem: Problem) -> float:
    """Loss below which residuals are rounding: in recursions run in doubles, errors grow with the samples."""
    largest = max(one.largest for one in problem.experiments)
    return float(problem.samples * (_checks.EPS * problem.samples * largest) ** 2)


def check_workers(workers: Any) -> None:
    """Check that this is a number of processes, -1 for all, or a map-like callable."""
    whole = isinstance(workers, int | np.integer) and not isinstance(workers, bool)
    if not (callable(workers) or (whole and (workers >= 1 or workers == -1))):
        raise StructureError(f"workers is {workers!r}; it must be a number of processes, -1 for all, or a map")

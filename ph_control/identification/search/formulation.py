"""What data and options ask for: the linear problem they pose, where a search for its minimum starts and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ... import _checks
from ..._types import Array
from ..._units import common_unit
from ...exceptions import IdentificationError, StructureError
from ...modal.discretization import INTERSAMPLE, METHODS, Hold
from ...modal.modal_form import ModalForm
from ...systems.port_hamiltonian import modes
from ..data.experiments import as_experiments
from ..data.frequency_record import FrequencyRecord
from ..data.parts import cut, searched_part
from ..data.time_record import Record
from ..regression.frequency_rows import FrequencyRows
from ..regression.modal_regressors import QUANTITIES
from ..regression.time_rows import RecordRows
from ..regression.tuning import TUNING
from ..regression.variable_projection import Problem, refine
from .circumstances import HOLDS, Cause, Finding, beside, delayed, meeting
from .criteria import criteria, crowded, preference
from .free_search import FreeModel
from .modal_search import FreePath
from .path import grow
from .response_search import ResponseSearch
from .steps import Report, Search, Step, TimeSearch

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
class DampedModes:
    """Damped modes, the search that found them in the data of a problem, and their `cost` beside lossless ones.

    They are `plain` where they leave white noise and all decay beyond doubt: no other circumstance does as much.
    """

    problem: Problem
    path: FreePath
    model: FreeModel
    plain: bool

    @cached_property
    def cost(self) -> float:
        """What they are chosen by in comparison to lossless ones."""
        return self.path.cost(self.model)


class Watch(Protocol):
    """What ends a path, and finds damped modes that are better than all of it."""

    def __call__(self, path: list[Step]) -> bool:
        """Whether the path is over."""

    def decided(self, path: list[Step]) -> DampedModes | None:
        """Damped modes that are better than all of a path that has come to its end."""


@dataclass(frozen=True)
class Formulation:
    """The records and the problem that they pose.

    `open` names what is left to the data: the 'hold' of the input, other instants of its 'arrival', and the
    'background' of the output; `findings` say what they decided.  Modes are searched for in the problem `searched`,
    where that is another one.  The `trail` has the steps of all searches under this formulation and those made of it.
    """

    records: Records
    problem: Problem
    open: frozenset[str] = frozenset()
    findings: tuple[Finding, ...] = ()
    searched: Problem | None = None
    trail: list[tuple[Formulation, list[Step]]] = field(default_factory=list)

    @classmethod
    def of(
        cls, data: Any, dt: Any = None, weights: Any = None, *, method: str = "exact", intersample: str = "auto",
        initial_state: str = "estimate", offset: bool | str = "auto", quantity: str = "velocity",
        representation: str = "observable",
    ) -> Formulation:  # fmt: skip
        """Check data and options, which are those of `pem`."""
        for name, value, allowed in (
            ("method", method, METHODS),
            ("intersample", intersample, (*INTERSAMPLE, "auto")),
            ("initial_state", initial_state, ("estimate", "zero")),
            ("quantity", quantity, QUANTITIES),
            ("representation", representation, REPRESENTATIONS),
        ):
            _checks.choice(name, value, allowed)
        if not isinstance(offset, str) or offset != "auto":
            _checks.flags(offset=offset)
        records = as_experiments(data, dt, weights=weights)
        _refuse_unobserved(records)
        rest = initial_state == "zero"
        held, terms = "zoh" if intersample == "auto" else intersample, 0 if offset == "auto" else int(offset)
        rows = [rows_of(record, method, held, quantity, from_rest=rest, offset=terms) for record in records]
        problem = Problem(tuple(rows), structured=representation == "controllable")
        asks = problem.driven and method != "euler"
        open = {"arrival"} if asks else set()
        if asks and intersample == "auto":
            open.add("hold")
        if offset == "auto":
            open.add("background")
        return cls(records, problem, frozenset(open) if isinstance(rows[0], RecordRows) else frozenset())

    @property
    def intersample(self) -> str:
        """Behaviour of the input between samples; of a response, which has none, the default."""
        first = self.problem.experiments[0]
        return first.hold.intersample if isinstance(first, RecordRows) else "zoh"

    @property
    def of_equal_weights(self) -> bool:
        """Whether these are frequency responses whose points count alike."""
        return all(isinstance(one, FrequencyRecord) and not np.ptp(one.weights) for one in self.records)

    def searched_parts(self, size: int) -> list[slice]:
        """Samples of each record in which modes are looked for: of those with more numbers than `size` not all."""
        pairs = zip(self.records, self.problem.experiments, strict=True)
        return [searched_part(one, getattr(rows, "from_rest", False), size) for one, rows in pairs]

    def over(self, parts: Sequence[slice], records: Records) -> Formulation:
        """The same circumstances in parts of records; itself where these are all of its own."""
        cuts: Any = tuple(cut(one, part) for one, part in zip(records, parts, strict=True))
        if all(one is own for one, own in zip(cuts, self.records, strict=True)):
            return self
        rows: list[Any] = []
        for one, record in zip(self.problem.experiments, cuts, strict=True):
            signals = {name: getattr(record, name) for name in ("u", "y", "observed")}
            rows.append(replace(one, **signals) if isinstance(one, RecordRows) else one)
        problem = replace(self.problem, experiments=tuple(rows))
        return replace(self, records=cuts, problem=problem, searched=None, trail=[])

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
        problem = self.searched or self.problem
        found = TimeSearch(problem) if isinstance(problem.experiments[0], RecordRows) else ResponseSearch(problem)
        self.trail.append((self, found.steps))
        return found

    @property
    def rtol(self) -> float:
        """Relative decrease of the loss at which a step of the search ends: what the criteria do not feel."""
        return min(1e-4, 0.1 / self.problem.samples)

    def path(
        self, guess: Array, largest: int, *, report: Callable[[int], Report | None] = lambda order: None,
        together: bool = False, watch: Callable[[Problem], Watch] | None = None,
    ) -> Path:  # fmt: skip
        """One mode after the other, from the guess on, under the circumstances that the data prefer."""
        how: dict[str, Any] = {"report": report, "together": together, "watch": watch}
        search, floor = self.search, self.problem.rounding
        stop = watch(search.problem) if watch else None
        steps = [search.step(guess, self.rtol, report(len(guess)))]

        arrival = "arrival" in self.open  # not yet asked

        def pauses(more: list[Step]) -> bool:
            return self._asks(more[-1], arrival) or (stop is not None and stop([*steps[:-1], *more]))

        while True:
            # what is left of a record without noise is rounding, and says nothing of its circumstances
            if isinstance(search, TimeSearch) and steps[-1].loss > floor and len(steps[-1].candidates):
                other = self._with_background(search, steps[-1])
                if other is not None:
                    return other.path(guess, largest, **how)
                others = self._arrivals(search, steps, True) if arrival and self._doubts(search, steps[-1]) else []
                if others:
                    damped = stop.decided(steps) if stop else None
                    own = Path(self, steps, damped) if damped else None
                    if own and damped and damped.plain:
                        return own
                    best = self._best(own, others, steps, guess, largest, how)
                    if best is not own:
                        return best
                    arrival = False
            before = len(steps)
            steps = [*steps[:-1], *grow(
                search, steps[-1], largest, rtol=self.rtol, floor=floor, report=report, together=together, stop=pauses
            )]  # fmt: skip
            if len(steps) == before or not self._asks(steps[-1], arrival) or (stop is not None and stop(steps)):
                break
        own = Path(self, steps, stop.decided(steps) if stop and steps[-1].loss > floor else None)
        if not isinstance(search, TimeSearch) or steps[-1].loss <= floor or (own.damped and own.damped.plain):
            return own
        others = self._arrivals(search, steps) if arrival and search.unconvinced(steps[-1]) else []
        held = self._held_otherwise(search, steps[-1]) if own.damped is None and "hold" in self.open else None
        if held is not None:
            own = replace(own, posed=held[0])
            others = held[1:] if held[1:] and not (others and others[0].searched) else others
        return self._best(own, others, steps, guess, largest, how) if others else own

    def _best(
        self, own: Path | None, others: list[Formulation], before: list[Step], guess: Array, largest: int,
        how: dict[str, Any],
    ) -> Path:  # fmt: skip
        """The path of least BIC under this formulation and others; one with a delay has to explain the record."""
        paths = [own] if own else []
        most, asked = largest, how
        if own is not None and own.damped is not None:
            # what explains the record without damping needs few modes more, and no look at damping
            most = min(largest, max(len(before[-1].d), len(own.damped.model.p) + TUNING.more_than_damped))
            asked = {**how, "watch": None}
        for one in others:
            path = one.path(guess, most, **asked)
            if not one.is_late or path.explains:
                paths.append(path)
        if own is None and not any(path.explains for path in paths):
            paths.append(replace(self, open=self.open - {"arrival"}).path(guess, most, **asked))
        found = min(paths, key=lambda path: path.value)
        if own is None or found is own:
            return found
        if len(found.steps[-1].d) == most < largest:
            found = found.posed.path(guess, largest, **how)
        gain, arrival = 0.5 * (own.value - found.value), (Cause.HOLD, Cause.DELAY)
        findings = tuple(replace(one, gain=gain) if one.cause in arrival else one for one in found.posed.findings)
        return replace(found, posed=replace(found.posed, findings=findings))

    def so_far(self, most: int) -> Path:
        """The best of what searches had come to that were interrupted, with the least loss of each order up to `most`.

        Raises `KeyboardInterrupt` where they had not found any mode.
        """
        paths = []
        for posed, steps in self.trail:
            best: dict[int, Step] = {}
            for step in sorted(steps, key=lambda step: -step.loss):
                best[len(step.d)] = step
            kept = [best[n] for n in sorted(best) if n <= most]
            if kept and len(kept[-1].d):
                # what a search was cut off from tells nothing of the colour of its noise
                value = min(criteria(posed.problem, step.loss, len(step.d)).bic for step in kept)
                paths.append((value, Path(posed, kept)))
        if not paths:
            raise KeyboardInterrupt
        return min(paths, key=lambda one: one[0])[1]

    @property
    def is_late(self) -> bool:
        """Whether the modes are searched for with an input that comes earlier or later."""
        return any(one.cause is Cause.DELAY for one in self.findings)

    def _asks(self, step: Step, arrival: bool) -> bool:
        """Whether what joined last, or would join next, may be a circumstance rather than a mode."""
        search = self.search
        if not isinstance(search, TimeSearch):
            return False
        return (arrival and self._doubts(search, step)) or ("background" in self.open and search.slow(step))

    def _doubts(self, search: TimeSearch, step: Step) -> bool:
        """Whether a mode has joined next to another while more is left, as where the input arrives otherwise."""
        return crowded(step.d, TUNING.mended_phase * self.problem.bin) and search.unconvinced(step)

    def _with_background(self, search: TimeSearch, step: Step) -> Formulation | None:
        """With a constant or a drift, where that explains more than a slow mode would."""
        if not ("background" in self.open and search.slow(step)):
            return None
        joined = search.step(np.append(step.d, step.candidates[0]), self.rtol)
        now = criteria(self.problem, step.loss, len(step.d)).loglik
        best, chosen = criteria(self.problem, joined.loss, len(joined.d)).bic, None
        present = max(one.offset for one in self.problem.experiments if isinstance(one, RecordRows))
        for terms in range(present + 1, 3):
            problem = beside(self.problem, terms)
            if problem.unknowns(len(step.d)) >= problem.samples:
                break
            at = refine(problem, step.d, rtol=self.rtol).projection
            found = criteria(problem, at.loss, len(step.d))
            if found.bic < best:
                best, chosen = found.bic, (terms, problem, found.loglik - now)
        if chosen is None:
            return None
        terms, problem, gain = chosen
        cause = Cause.CONSTANT if terms == 1 else Cause.DRIFT
        others = tuple(one for one in self.findings if one.cause is not Cause.CONSTANT)
        searched = None if self.searched is None else beside(self.searched, terms)
        return replace(self, problem=problem, searched=searched, findings=(*others, Finding(cause, (), gain)))

    @property
    def _other(self) -> str:
        return "foh" if self.intersample == "zoh" else "zoh"

    def _arrivals(self, search: TimeSearch, steps: list[Step], midway: bool = False) -> list[Formulation]:
        """With an input that arrives otherwise, by what single modes at the peaks say of it, the likeliest first.

        Single modes say little where two peaks are one: the commonest delay is tried in any case, and midway, where
        modes that a wrong hold misled cannot be asked, the other hold.
        """
        if not len(steps[-1].d):
            return []
        pairs = [(self.intersample, delay) for delay in TUNING.delays]
        pairs += [(self._other, delay) for delay in (TUNING.delays if "hold" in self.open else (0,))]
        base = search.arrival(steps[0], self.intersample, 0)
        # the longer a delay, the less likely before any data
        gains = [(search.arrival(steps[0], *pair) - base - TUNING.delay_prior * abs(pair[1]), pair) for pair in pairs]
        gains.sort(key=lambda one: -one[0])
        usual = [(self.intersample, 1)] + [(self._other, 0)] * (midway and "hold" in self.open)
        chosen = [one for one in gains[: TUNING.followed] if one[0] > TUNING.likely or one[1] in usual]
        chosen += [one for one in gains[TUNING.followed :] if one[1] in usual]
        return [self._arriving(*pair, gain) for gain, pair in chosen]

    def _held_otherwise(self, search: TimeSearch, step: Step) -> list[Formulation]:
        """With the hold decided as it is; before one with the other, where that may be better."""
        d = np.sort(step.d)
        if not len(d):
            return [self]
        # modes closer than the data resolve may be there for the hold's sake, and say nothing of it
        close = len(d) > 1 and np.min(np.diff(d)) < self.problem.bin
        gain = search.likelihood(step, self._other) - search.likelihood(step, self.intersample)
        finding = Finding(Cause.HOLD, (float(HOLDS.index(self.intersample)),), max(0.0, -gain))
        decided = replace(self, findings=(*self.findings, finding))
        return [decided, self._arriving(self._other, 0, gain)] if close or gain > TUNING.sure else [decided]

    def _arriving(self, held: str, delay: int, gain: float) -> Formulation:
        """With an input that arrives as told; its hold belongs to the model if that is left to the data."""
        problem = meeting(self.problem, held)
        searched: Problem | None
        if delay:
            finding = Finding(Cause.DELAY, (float(delay),), gain)
            problem, searched = problem if "hold" in self.open else self.problem, delayed(problem, delay)
        else:
            finding = Finding(Cause.HOLD, (float(HOLDS.index(held)),), gain)
            problem, searched = (problem, None) if "hold" in self.open else (self.problem, problem)
        return replace(
            self, problem=problem, searched=searched, open=self.open - {"hold", "arrival"},
            findings=(*self.findings, finding),
        )  # fmt: skip

    def check_signals(self) -> None:
        """Refuse an output of nothing, and an input that no weight could be told from."""
        if not any(one.largest for one in self.problem.experiments):
            raise IdentificationError("the output is zero throughout the record; there is nothing to model")
        in_time = [one for one in self.problem.experiments if isinstance(one, RecordRows) and one.driven]
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
                f"initial_guess has {model.nports} ports and {len(model.d)} oscillating modes; expected one port "
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
        most = _checks.whole_number("max_order", max_order, 1)
        if isinstance(order, str) and order != "auto":
            raise StructureError(f"order is {order!r}; it must be 'auto' or a whole number of at least 1")
        wanted = min(most, carried) if isinstance(order, str) else _checks.whole_number("order", order, 1)
        what = (
            "observed output samples" if isinstance(problem.experiments[0], RecordRows) else "real and imaginary parts"
        )
        if carried == 0:
            raise IdentificationError(
                f"the record has {problem.samples} {what}; one mode alone has {per_mode + own} unknowns, so "
                f"at least {per_mode + own + 1} are needed"
            )
        if wanted > carried:
            raise IdentificationError(
                f"order {_checks.shown(wanted)} has {_checks.shown(per_mode * wanted + own)} unknowns, more than the "
                f"{problem.samples} {what} can carry; the largest order for this record is {carried}"
            )
        if len(guess) > wanted:
            allowed = f"{wanted} that 'auto' may take" if isinstance(order, str) else f"{wanted} of the order"
            raise StructureError(f"initial_guess has {len(guess)} modes, more than the {allowed}")
        return wanted


@dataclass(frozen=True)
class Path:
    """Modes that joined one by one under a formulation, and damped ones that are better than all of them."""

    posed: Formulation
    steps: list[Step]
    damped: DampedModes | None = None

    @cached_property
    def value(self) -> float:
        """Its least BIC, for as many samples as the problem has."""
        searched = self.posed.search.problem
        values = [preference(searched, step, "bic") for step in self.steps]
        values += [self.damped.cost] if self.damped else []
        return min(values) * self.posed.problem.samples / searched.samples

    @property
    def explains(self) -> bool:
        """Whether the best step leaves nothing but noise."""
        search = self.posed.search
        return not search.unconvinced(min(self.steps, key=lambda step: preference(search.problem, step, "bic")))


def _refuse_unobserved(records: Records) -> None:
    """Refuse an experiment that says nothing beside others that do."""
    seen = [bool(record.observed.any()) for record in records]
    if len(seen) > 1 and not all(seen):
        place = seen.index(False)
        raise IdentificationError(
            f"experiment {place + 1} has no outputs: all {records[place].samples} of them are NaN; leave it out"
        )


def rows_of(
    record: Record | FrequencyRecord, method: str, intersample: str, quantity: str, *, from_rest: bool, offset: int
) -> Any:
    """What one record offers to the solver; a frequency response has no samples that a method could meet."""
    if isinstance(record, FrequencyRecord):
        return FrequencyRows(record, quantity)
    hold, rest = Hold(record.dt, method, intersample), from_rest and record.driven
    return RecordRows(record.u, record.y, record.observed, hold, rest, offset, quantity, record.driven)


def reporter(largest: int, callback: Callback | None, samples: int = 1) -> Callable[[int], Report | None]:
    """What tells a callback of the iterations of each order, by a loss or the sum of so many samples."""
    if callback is not None and not callable(callback):
        raise StructureError(f"callback is {_checks.shown(callback)}; pass a function of one argument, or None")

    def report(order: int) -> Report | None:
        if callback is None:
            return None

        def told(iteration: int, loss: float) -> None:
            try:
                callback(Progress(order, largest, iteration, loss / samples))
            except StopIteration:
                raise KeyboardInterrupt from None

        return told

    return report

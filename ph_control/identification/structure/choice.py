"""The structure of a fit, given or the simplest that stands, under the hold of the inputs with which it is simpler."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._options import STRUCTURES
from ..diagnosis.verdict import HypothesisTest
from ..parameters.model_function import ModelFunction
from ..regression.tuning import TUNING
from ..search.circumstances import HOLDS, Cause, Finding
from ..search.fitted_modes import FreeFit, feedthrough_of
from .constrained import StructuredFit, constrained
from .delayed import cost_of
from .hypothesis_tests import LEVEL, choose, given_structure, likelihood_test, structure_tests
from .layout import ChannelLayout
from .parametric import fit_parameters

_SAME = 1.0  # difference of the BIC of models that are the same


@dataclass(frozen=True)
class Request:
    """What a fit is to assume: structure, driving points, quantities of the outputs, and the largest number of modes.

    `assumed` says whether the port is the one that one input and one output have by default, `coloured` whether noise
    of an output may be.
    """

    structure: str
    ports: tuple[tuple[int, int], ...]
    quantities: tuple[str, ...]
    most: int
    assumed: bool = False
    coloured: bool = True
    function: ModelFunction | None = None


@dataclass(frozen=True)
class Choice:
    """A free fit, the structure that was chosen for it, and the tests of all structures."""

    free: FreeFit
    fit: StructuredFit
    tests: tuple[HypothesisTest, ...]

    @classmethod
    def of(cls, free: FreeFit, request: Request) -> Choice:
        """Fit the structure that is given, or the simplest that is not rejected, with the inputs held as they are."""
        layout, given = layout_of(free, request), request.structure
        if request.function is not None and not free.interrupted:
            fitted = fit_parameters(free, layout, request.function)
            free = replace(free, findings=(*free.findings, *fitted.findings))
            return cls(free, fitted.fit, (fitted.test,))
        if not free.states:
            return cls(free, _without_modes(free), ())
        if given == "free" or free.interrupted:
            given = "free" if given == "auto" else given
            steps = 1 if free.interrupted else None
            return cls(free, constrained(free.projection, layout, given, free.region, steps), ())
        if given == "auto":
            return cls(free, *_tested(free, request))
        fit, test = given_structure(free.projection, layout, given, free.region)
        return cls(free, fit, (test,))

    def cost(self) -> float:
        """BIC of the structure with its delays, for as many rows as the data have without them."""
        free = self.free
        rows = sum(int(record.observed.sum()) for record in free.channels) * (1 + free.per_entry)
        delays = 0 if self.fit.delays else len(np.unique(free.delay[free.delay != 0]))
        return float(rows * cost_of(self.fit, free.scales) + delays * np.log(rows))

    def gain(self, other: Choice) -> float:
        """By how much the criterion prefers this structure to another, as a log-likelihood."""
        return 0.5 * (other.cost() - self.cost())

    def stands(self, request: Request) -> bool:
        """Whether the structure is one that is not rejected within the free model."""
        if request.structure == "auto":
            return self.fit.structure in STRUCTURES[:2]
        if request.function is not None:
            return self.tests[0].p >= LEVEL
        projection = self.free.projection
        unknowns = len(projection.x) + int(projection.shown.sum()) - projection.deficiency
        return likelihood_test(projection, self.fit, max(0, unknowns - self.fit.parameters)).p >= LEVEL


def under_either_hold(first: Choice, request: Request) -> Choice:
    """The structure under the hold with which it is simpler, or likelier; that the input is not held is a finding."""
    best = _under_likelier_hold(first, request)
    if best.free.intersample == "zoh" or first.free.rival is None:
        return best
    gain = best.gain(first)
    if best is first:
        gain = 0.5 * (first.free.rival.criteria.bic - first.free.criteria.bic)
    hold = Finding(Cause.HOLD, (float(HOLDS.index("foh")),), float(gain))
    others = (finding for finding in best.free.findings if finding.cause is not Cause.HOLD)
    return replace(best, free=replace(best.free, findings=(*others, hold)))


def _under_likelier_hold(first: Choice, request: Request) -> Choice:
    """The structure under the hold with which it is simpler, or likelier."""
    free = first.free
    if request.structure == "free" or first.stands(request) or free.rival is None:
        return first
    rival = replace(free.rival, findings=free.findings)
    if request.structure == "auto":
        simpler = STRUCTURES[: STRUCTURES.index(first.fit.structure)]
        chosen, tests = _tested(rival, request, simpler)
        stands = chosen.structure in simpler
        if not (stands or (first.fit.structure == "free" and _is_rather_held_as(rival, tests, free, first.tests))):
            return first
    second = Choice.of(rival, request)
    return second if request.structure == "auto" or second.gain(first) > TUNING.sure else first


def _is_rather_held_as(
    rival: FreeFit, tests: tuple[HypothesisTest, ...], free: FreeFit, free_tests: tuple[HypothesisTest, ...]
) -> bool:
    """Whether inputs were rather held as in a rival fit, where no structure stands.

    With what is fed through they are the same model, and only shapes tell them apart.
    """
    preferred = free.criteria.bic - rival.criteria.bic
    if abs(preferred) > _SAME:
        return preferred > 0
    return _classical_cost(free, free_tests) - _classical_cost(rival, tests) > 2 * TUNING.sure


def _classical_cost(free: FreeFit, tests: tuple[HypothesisTest, ...]) -> float:
    """Criterion of the classical model of a fit, short of its unknowns; that of the fit itself where it has none."""
    return free.criteria.bic + sum(test.likelihood_ratio for test in tests if test.hypothesis == "classical")


def layout_of(free: FreeFit, request: Request) -> ChannelLayout:
    """Channels of a fit, with the quantities and driving points that were requested."""
    first = free.channels[0]
    return ChannelLayout(
        len(first.output_labels), len(first.input_labels), free.scales, request.quantities, request.ports,
        per_entry=free.per_entry,
    )  # fmt: skip


def _tested(
    free: FreeFit, request: Request, among: tuple[str, ...] | None = None
) -> tuple[StructuredFit, tuple[HypothesisTest, ...]]:
    """Choose the simplest structure that is not rejected, and return the tests of all, or of those `among` some."""
    tested = structure_tests(free.projection, layout_of(free, request), free.region, among)
    return choose(tested), tested.tests


def _without_modes(free: FreeFit) -> StructuredFit:
    """Make a fit without poles: what is fed through, and constants."""
    projection, entries = free.projection, (len(free.channels[0].output_labels), len(free.channels[0].input_labels))
    return StructuredFit(
        "free", "free", np.zeros(0, complex), np.zeros((0, *entries), complex), feedthrough_of(free), None, None,
        projection.loss, projection.unknowns, free.variance, projection, True, projection,
    )  # fmt: skip

"""The structure of a fit: given, or the simplest that stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._options import STRUCTURES
from ..diagnosis.verdict import HypothesisTest
from ..parameters.model_function import ModelFunction
from ..search.fitted_modes import FreeFit, feedthrough_of
from .constrained import StructuredFit, constrained
from .coordinates import ChannelLayout
from .delayed import cost_of
from .hypothesis_tests import LEVEL, choose, given_structure, likelihood_test, structure_tests
from .parametric import fit_parameters


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

    def ports_of(self, structure: str) -> tuple[tuple[int, int], ...]:
        """Driving points of a structure: one that was not named holds only where the structure does."""
        return () if self.assumed and structure == "free" else self.ports


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
            return cls(free, *tested(free, request))
        fit, test = given_structure(free.projection, layout, given, free.region)
        return cls(free, fit, (test,))

    def cost(self) -> float:
        """BIC of the structure with its delays, for as many rows as the data have without them."""
        free = self.free
        if free.beside is not None:  # rows about the minimum of a likelihood are those of no other
            return bic_of(self.fit.structure, free, self.tests)
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
        unknowns = len(projection.x) + int(projection.excited_unknowns.sum()) - projection.deficiency
        return likelihood_test(projection, self.fit, max(0, unknowns - self.fit.parameters)).p >= LEVEL


def bic_of(structure: str, free: FreeFit, tests: tuple[HypothesisTest, ...]) -> float:
    """Return the BIC of a structure from that of the free fit, and the test within it."""
    charge = float(np.log(free.projection.rows))
    return free.criteria.bic + sum(
        test.likelihood_ratio - test.dof * charge for test in tests if test.hypothesis == structure
    )


def layout_of(free: FreeFit, request: Request) -> ChannelLayout:
    """Channels of a fit, with the quantities and driving points that were requested."""
    first = free.channels[0]
    return ChannelLayout(
        len(first.output_labels), len(first.input_labels), free.scales, request.quantities, request.ports,
        per_entry=free.per_entry,
    )  # fmt: skip


def tested(
    free: FreeFit, request: Request, among: tuple[str, ...] | None = None
) -> tuple[StructuredFit, tuple[HypothesisTest, ...]]:
    """Choose the simplest structure that is not rejected, and return the tests of all, or of those `among` some."""
    tests = structure_tests(free.projection, layout_of(free, request), free.region, among)
    return choose(tests, free.region), tests.tests


def _without_modes(free: FreeFit) -> StructuredFit:
    """Make a fit without poles: what is fed through, and constants."""
    projection, entries = free.projection, (len(free.channels[0].output_labels), len(free.channels[0].input_labels))
    return StructuredFit(
        "free", "free", np.zeros(0, complex), np.zeros((0, *entries), complex), feedthrough_of(free), None, None,
        projection.loss, projection.unknowns, free.variance, projection, True, projection,
    )  # fmt: skip

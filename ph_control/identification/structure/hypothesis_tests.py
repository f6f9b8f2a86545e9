"""Structures tested within the free model by the likelihood that each costs, and the simplest that is not rejected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import fdtrc

from ..._options import HYPOTHESES
from ..data.windowed import have_shared_errors
from ..diagnosis.verdict import HypothesisTest
from ..innovations.joint import JointProjection
from ..regression.free import FreeProjection
from ..regression.sections import PoleRegion
from ..regression.time_rows import FreeRecord
from .constrained import Approach, StructuredFit, constrained, is_crowded, nearest_passive_fit
from .coordinates import ChannelLayout

LEVEL = 0.05
_ITERATIONS = 12  # three are usual
_BEYOND = 100.0  # times the unknowns: a ratio at the nearest point of the free fit from which no way leads back
_HOPELESS = 1e-6
_HELD = 1e-3  # of the variance: squares that a constraint costs which the data push against
_LEAST = 0.1  # of the squares: what errors in common may take away
_AS_WELL = 2.0  # times the squared errors of the free fit that a structure may make from the inputs alone
_SAME_PLANT = 0.5  # of the size of a pole, by which that of a structure may be another


@dataclass(frozen=True)
class StructureTests:
    """Structures that were tested, in the order in which they are preferred, and the fits of all.

    Attributes
    ----------
    tests : tuple of HypothesisTest
        Each within the free model.
    fits : mapping of str to StructuredFit
        Minima of the hypotheses, and of the free model as 'free'.
    """

    tests: tuple[HypothesisTest, ...]
    fits: Mapping[str, StructuredFit]

    def stands(self, hypothesis: str, level: float = LEVEL) -> bool:
        """Whether a hypothesis was tested and not rejected."""
        return any(test.hypothesis == hypothesis and test.p >= level for test in self.tests)


def structure_tests(
    projection: FreeProjection, layout: ChannelLayout, region: PoleRegion, among: Sequence[str] | None = None
) -> StructureTests:
    """Test all structures that the inputs, outputs and ports of a free fit allow to test, or those `among` some.

    Parameters
    ----------
    projection : FreeProjection
        Minimum of the free fit over all that was measured, in rows of one variance.
    layout : ChannelLayout
        Inputs and outputs, their units and ports.
    region : PoleRegion
        Where poles are looked for.

    Returns
    -------
    StructureTests
        Passivity with a port, residues of rank one with two inputs and two outputs, reciprocity with two ports.

    Notes
    -----
    Poles of the free model lie on either side of the axis and its residues are of any phase and sign, so that each
    structure lies inside it, and the law of the likelihood ratio is that of as many squares as unknowns are fewer:
    Fisher's, since the variance is estimated.  Passivity is one-sided, with a mixture of such laws.  The probability
    given the constraints that hold the nearest passive model is that of as many squares as these are; no such model is
    held where the free one is passive, and the hypothesis stands.  So a passive plant is rejected at the level of the
    test at most, and in the middle of passive models never (Wollan and Dykstra 1986; Susko 2013).  Where constraints
    are curved, their curvature counts as well.  Lossless models are classical, and both are passive, reciprocal and of
    rank one: none of these is rejected before them, and has their probability where that is larger.
    """
    fits = {"free": constrained(projection, layout, "free", region)}
    parameters = fits["free"].parameters
    tests: list[HypothesisTest] = []
    for hypothesis in testable(layout):
        if among is not None and hypothesis not in among:
            continue
        simpler = [test for test in tests if test.hypothesis in HYPOTHESES[hypothesis].simpler]
        stands = [test for test in simpler if test.p >= LEVEL]
        if stands and hypothesis == "passive":
            test = replace(max(stands, key=lambda test: test.p), hypothesis=hypothesis)
        elif hypothesis == "passive":
            # the classical model is passive, and was fitted before
            classical = partial(_fit_of, fits, projection, layout, "classical", region)
            fit = nearest_passive_fit(projection, layout, classical, _BEYOND * parameters)
            test, fits[hypothesis] = likelihood_test(projection, fit, parameters - fit.parameters), fit
        else:
            test, fits[hypothesis] = _tested(projection, layout, hypothesis, region, parameters)
        tests.append(replace(test, p=max([test.p, *(each.p for each in simpler)])))
    return StructureTests(tuple(tests), fits)


def _fit_of(
    fits: Mapping[str, StructuredFit],
    projection: FreeProjection,
    layout: ChannelLayout,
    hypothesis: str,
    region: PoleRegion,
) -> StructuredFit:
    """Return the fit of a hypothesis, made if it is not among `fits`."""
    return fits[hypothesis] if hypothesis in fits else constrained(projection, layout, hypothesis, region, _ITERATIONS)


def given_structure(
    projection: FreeProjection, layout: ChannelLayout, hypothesis: str, region: PoleRegion
) -> tuple[StructuredFit, HypothesisTest]:
    """Fit a structure, to the minimum however unlikely it is, and test it within the free model."""
    fit, parameters = (
        constrained(projection, layout, hypothesis, region),
        constrained(projection, layout, "free", region).parameters,
    )
    return fit, likelihood_test(projection, fit, parameters - fit.parameters)


def _tested(
    projection: FreeProjection, layout: ChannelLayout, hypothesis: str, region: PoleRegion, parameters: int
) -> tuple[HypothesisTest, StructuredFit]:
    """Test a hypothesis; the minimum of one that is rejected beyond doubt is not followed to its last digit.

    What crowded poles start from says nothing of their minimum.
    """
    efforts: list[tuple[int | None, float]] = [(0, _BEYOND), (_ITERATIONS, 1.0), (None, 1.0)]
    if is_crowded(projection, region):
        efforts = [(_ITERATIONS, _BEYOND), (None, 1.0)]
    approach = Approach.from_free_fit(projection, layout, hypothesis, region)
    for iterations, beyond in efforts:
        approach = approach.continued(iterations)
        fit = approach.fit
        test = likelihood_test(projection, fit, parameters - fit.parameters)
        if fit.converged or (test.p < _HOPELESS and test.likelihood_ratio > beyond * test.dof):
            break
    return test, fit


def testable(layout: ChannelLayout) -> list[str]:
    """Hypotheses that channels and ports allow to test, the simplest first."""
    channels, ports = min(layout.outputs, layout.inputs), len(layout.ports)
    return [name for name, known in HYPOTHESES.items() if channels >= known.channels and ports >= known.ports]


def likelihood_test(projection: FreeProjection, fit: StructuredFit, dof: int) -> HypothesisTest:
    """A structure against the free model, which has so many unknowns more; the variance is that of the free fit.

    A structure of as many unknowns, as a lag whose residue is positive, has a constraint that the data may push
    against: it counts as one.
    """
    spare = max(1, projection.rows - projection.unknowns)
    least = max(projection.loss, float(projection.rounding.sum()))
    variance, gain = projection.variance_of(least), max(0.0, fit.loss - least) / _inflation(projection, fit, dof)
    if not dof and gain <= _HELD * variance:
        return HypothesisTest(fit.hypothesis, 0.0, 0, 1.0)
    dof = max(dof, 1)
    ratio = (spare + dof) * float(np.log1p(gain / variance / spare))
    return HypothesisTest(fit.hypothesis, ratio, dof, float(fdtrc(dof, spare, gain / variance / dof)))


def _inflation(projection: FreeProjection, fit: StructuredFit, dof: int) -> float:
    """Mean of the squares that a true structure costs over their number, 1 unless entries have errors in common."""
    if not dof or not have_shared_errors(projection.experiments):
        return 1.0
    excess = getattr(fit.point, "excess", None)
    return 1.0 if excess is None else max(_LEAST, 1 + (projection.excess - excess) / dof)


def is_refused(hypothesis: str, tests: Sequence[HypothesisTest]) -> bool:
    """Whether the data reject a hypothesis."""
    return any(test.hypothesis == hypothesis and test.p < LEVEL for test in tests)


def choose(tests: StructureTests, region: PoleRegion, level: float = LEVEL) -> StructuredFit:
    """Return the simplest structure that is not rejected: lossless, classical, passive, free.

    Records that tell little reject little: none of its poles may be those of another plant than the free fit has.
    Beside unmeasured forces, from which the errors that it makes are hardly told, it may not predict far worse from
    the inputs alone.  Of a free model, residues have rank one if that is not rejected, as those of simple poles have.
    """
    free = tests.fits["free"]
    reach = np.maximum(_SAME_PLANT * np.abs(free.p), region.bin)
    forced = isinstance(free.projection, JointProjection)
    most = _AS_WELL * _simulated(free) if forced else np.inf
    for hypothesis, known in HYPOTHESES.items():
        fit = tests.fits.get(hypothesis)
        if fit is None or not (known.chosen and tests.stands(hypothesis, level)):
            continue
        near = np.all(np.any(np.abs(fit.p[:, None] - free.p) <= reach, axis=1))
        if near and (not forced or _simulated(fit) <= most):
            return fit
    return free


def _simulated(fit: StructuredFit) -> float:
    """Squares that a fit leaves of records, of what the inputs and the motion at first make of them."""
    pairs = zip(fit.projection.experiments, fit.projection.predictions(), strict=True)
    return sum(float(np.sum(rows.residuals(y) ** 2)) for rows, y in pairs if isinstance(rows, FreeRecord))

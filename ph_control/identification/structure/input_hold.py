"""The hold of the inputs between samples that a structure prefers: constant, or linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..._options import STRUCTURES
from ..diagnosis.verdict import HypothesisTest
from ..regression.tuning import TUNING
from ..search.findings import HOLDS, Cause, Finding
from ..search.fitted_modes import FreeFit
from .choice import Choice, Request, tested

SAME = 1.0  # difference of the BIC of models that are the same


def under_either_hold(first: Choice, request: Request) -> Choice:
    """The structure under the hold with which it is simpler, or likelier; that the input is not held is a finding."""
    best = _under_likelier_hold(first, request)
    if best.free.intersample == "zoh" or first.free.rival is None:
        return best
    gain = best.gain(first)
    if best is first:
        gain = 0.5 * (first.free.rival.criteria.bic - first.free.criteria.bic)
    return with_finding_of_hold(best, gain)


def with_finding_of_hold(best: Choice, gain: float) -> Choice:
    """The same that says, of an input that is not held, by how much that is likelier."""
    others = tuple(finding for finding in best.free.findings if finding.cause is not Cause.HOLD)
    held = best.free.intersample == "zoh"
    hold = () if held else (Finding(Cause.HOLD, (float(HOLDS.index("foh")),), float(gain)),)
    return replace(best, free=replace(best.free, findings=(*others, *hold)))


def _under_likelier_hold(first: Choice, request: Request) -> Choice:
    """The structure under the hold with which it is simpler, or likelier."""
    free = first.free
    if request.structure == "free" or first.stands(request) or free.rival is None:
        return first
    rival = replace(free.rival, findings=free.findings)
    if request.structure == "auto":
        simpler = STRUCTURES[: STRUCTURES.index(first.fit.structure)]
        chosen, tests = tested(rival, request, simpler)
        # noise of a poor fit lets every structure stand, and a true one is rejected by chance
        stands = chosen.structure in simpler and _bic_of(chosen.structure, rival, tests) < min(
            _bic_of(structure, free, first.tests) for structure in (first.fit.structure, chosen.structure)
        )
        if not (stands or (first.fit.structure == "free" and _is_rather_held_as(rival, tests, free, first.tests))):
            return first
    second = Choice.of(rival, request)
    return second if request.structure == "auto" or second.gain(first) > TUNING.sure else first


def _bic_of(structure: str, free: FreeFit, tests: tuple[HypothesisTest, ...]) -> float:
    """Return the BIC of a structure from that of the free fit, and the test within it."""
    charge = float(np.log(free.projection.rows))
    return free.criteria.bic + sum(
        test.likelihood_ratio - test.dof * charge for test in tests if test.hypothesis == structure
    )


def _is_rather_held_as(
    rival: FreeFit, tests: tuple[HypothesisTest, ...], free: FreeFit, free_tests: tuple[HypothesisTest, ...]
) -> bool:
    """Whether inputs were rather held as in a rival fit, where no structure stands.

    With what is fed through they are the same model, and only shapes tell them apart.
    """
    preferred = free.criteria.bic - rival.criteria.bic
    if abs(preferred) > SAME:
        return preferred > 0
    return _bic_of("classical", free, free_tests) - _bic_of("classical", rival, tests) > 2 * TUNING.sure

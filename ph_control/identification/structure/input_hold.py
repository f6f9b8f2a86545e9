"""The hold of the inputs between samples that a structure prefers: constant, or linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..._options import STRUCTURES
from ..regression.tuning import TUNING
from ..search.findings import HOLDS, Cause, Finding
from ..search.fitted_modes import FreeFit
from .choice import Choice, Request, bic_of, tested

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
        stands = chosen.structure in simpler and bic_of(chosen.structure, rival, tests) < min(
            bic_of(structure, free, first.tests) for structure in (first.fit.structure, chosen.structure)
        )
        if not (stands or (first.fit.structure == "free" and _is_rather_held_as(rival, free, request))):
            return first
    second = Choice.of(rival, request)
    return second if request.structure == "auto" or second.gain(first) > TUNING.sure else first


def _is_rather_held_as(rival: FreeFit, free: FreeFit, request: Request) -> bool:
    """Whether inputs were rather held as in a rival fit, where no structure stands.

    With what is fed through they are the same model, and only shapes of modes tell them apart: real ones are likelier,
    wherever the sensor is, if no port was given.
    """
    if not free.order:
        return free.criteria.bic - rival.criteria.bic > SAME
    wanted = replace(request, ports=()) if request.assumed else request
    costs = np.array([[each.criteria.bic, bic_of("classical", each, tested(each, wanted, ("classical",))[1])]
                      for each in (free, rival)])  # fmt: skip
    likelier, more_real = costs.min(axis=1), costs[:, 1]
    if abs(np.ptp(likelier)) > SAME:
        return bool(likelier[0] > likelier[1])
    return bool(more_real[0] - more_real[1] > 2 * TUNING.sure)

"""The structure of a fit, given or the simplest that stands: under the hold of the inputs with which it is simpler.

The hold is constant or linear between samples.  Delays of the outputs are chosen together with the structure, which
shows them, where free residues absorb them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..._options import STRUCTURES
from ..._types import Mask
from ..._units import feels_force
from ..diagnosis.verdict import HypothesisTest
from ..parameters.model_function import ModelFunction
from ..regression.free import FreeProjection, Lateness
from ..regression.tuning import TUNING
from ..search.findings import HOLDS, Cause, Finding
from ..search.fitted_modes import FreeFit, feedthrough_of
from .constrained import StructuredFit, constrained
from .coordinates import ChannelLayout
from .delayed import cost_of, with_delays
from .hypothesis_tests import LEVEL, choose, given_structure, likelihood_test, structure_tests
from .parametric import fit_parameters

_SEEN = 2.0  # standard errors by which delays that a structure needs differ from 0
_NEARLY = 0.02  # of the likelihood ratio that rejects a structure: what delays may leave of it

WithDelay = Callable[[Lateness], FreeFit]  # searches in rows with these delays

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
        if free.beside is not None:  # rows about the minimum of a likelihood are those of no other
            return _bic_of(self.fit.structure, free, self.tests)
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


def _bic_of(structure: str, free: FreeFit, tests: tuple[HypothesisTest, ...]) -> float:
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


def _tested(
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


def under_hold_and_delays(first: Choice, request: Request, with_delay: WithDelay | None) -> Choice:
    """The structure under the likelier hold of the inputs, with delays of the outputs where these explain more.

    Delays of whole samples are refined, under either hold: a lag that follows a held input looks like one that follows
    a linear input, and is later by a part of a sample.
    """
    free = first.free
    late = bool(free.delay.any())
    # without modes no structure shows a delay, but lags tell where within a sample one lies
    delay_open = free.delay_open and (free.order or late) and free.projection.inputs and not free.interrupted
    if not delay_open or request.function is not None or request.structure == "passive":
        return _under_either_hold(first, request)
    if late:
        return _refined_under_hold(first, request, lambda choice: _with_own_delays(choice, request, with_delay))
    best = _under_either_hold(first, request)
    if best.stands(request):
        return best
    return _likelier_with_delays(best, free.rival if best is first else free, request, with_delay) or best


def _refined_under_hold(first: Choice, request: Request, refined: Callable[[Choice], Choice]) -> Choice:
    """The structure with refined delays under the likelier hold, or the constant one where they are nearly the same."""
    rival = first.free.rival
    if rival is None:
        return refined(first)
    rival = replace(rival, findings=first.free.findings, delay_gain=first.free.delay_gain)
    pair = [refined(choice) for choice in (first, Choice.of(rival, request))]
    held, linear = pair if first.free.intersample == "zoh" else pair[::-1]
    gain = linear.gain(held)
    return _with_finding_of_hold(linear if 2 * gain > _SAME else held, gain)


def _with_own_delays(late: Choice, request: Request, with_delay: WithDelay | None) -> Choice:
    """The structure in late rows, with other delays where these explain more, or its own refined.

    What is fed through after whole samples may be no more than a part of a sample.
    """
    stands = late.stands(request)
    chosen = None if stands else _likelier_with_delays(late, None, request, with_delay)
    if chosen is not None:
        return chosen
    if late.fit.structure == "free":
        return _refined_either(late, request)
    own = _refined(late, late.fit.hypothesis, request) if stands else late
    fed = late.free.projection.fed
    if request.structure != "auto" or fed is None or not np.any(fed & ~_felt(late.free, request)):
        return own
    return min((own, _refined(_freely(late, request), "free", request)), key=Choice.cost)


def _likelier_with_delays(
    best: Choice, other: FreeFit | None, request: Request, with_delay: WithDelay | None
) -> Choice | None:
    """The structure with delays, where these explain more than the best without; None where they do not.

    `other` is the fit under the other hold, if that is open.
    """
    hypothesis = "classical" if request.structure == "auto" else request.structure
    trials = [_delayed(fit, best, hypothesis, request, False) for fit in (best.free, other) if fit is not None]
    trial = min((candidate for candidate in trials if candidate is not None), key=Choice.cost, default=None)
    if trial is None:
        return None
    # what rejects a structure that is given, and free residues explain without a delay, shows none
    without = best if request.structure in ("auto", "free") else _freely(best, request)
    if not _explains(trial, without):
        return None
    chosen = _searched_anew(trial.free, request, with_delay)
    likelier = _explains(chosen, without) and (chosen.stands(request) or chosen.gain(without) > TUNING.sure)
    return chosen if likelier and _is_late(chosen.fit) else None


def _is_late(fit: StructuredFit) -> bool:
    """Whether any delay differs from 0 by more than its errors allow."""
    return fit.delays is None or bool(np.any(np.abs(fit.delays.values) > _SEEN * fit.delay_errors))


def _freely(best: Choice, request: Request) -> Choice:
    """Free residues in place of a structure."""
    free = best.free
    return replace(best, fit=constrained(free.projection, layout_of(free, request), "free", free.region))


def _searched_anew(late: FreeFit, request: Request, with_delay: WithDelay | None) -> Choice:
    """The structure in rows with delays, after a search in these: modes too many may have stood for the delay."""
    anew = late if with_delay is None else with_delay(Lateness(late.delay[places_of(late)], late.input_delay))
    if anew.interrupted:
        raise KeyboardInterrupt
    anew = replace(anew, findings=late.findings, delay_gain=late.delay_gain).with_delay_open(True)
    return min((_in_rows_of(free, request) for free in (late, anew) if free.states), key=Choice.cost)


def _explains(trial: Choice, best: Choice) -> bool:
    """Whether a structure with delays is likelier than the best without, or nearly so.

    Held and linear inputs are models of what goes on between samples, and of smooth inputs that come late free residues
    absorb a little of what is wrong with them.  That must not decide where delays explain nearly all that rejects the
    structure, of more than one mode.
    """
    refused = [test.likelihood_ratio for test in best.tests if test.hypothesis == trial.fit.hypothesis]
    spare = (best.fit.parameters - trial.fit.parameters) * float(np.log(trial.fit.projection.rows))
    several = np.sum(trial.fit.p.imag > 0) > 1
    nearly = spare > 0 and several and spare - 2 * trial.gain(best) < _NEARLY * max([*refused, 0.0])
    return bool(trial.gain(best) > TUNING.sure or nearly)


def _in_rows_of(free: FreeFit, request: Request) -> Choice:
    """The structure in rows with delays, which are refined with it."""

    def refined(choice: Choice) -> Choice:
        """Return a choice with its delays refined, those of its structure where this stands or is given."""
        if choice.stands(request) or request.structure != "auto":
            return _refined(choice, choice.fit.hypothesis, request)
        return _refined_either(choice, request)

    return _refined_under_hold(Choice.of(free, request), request, refined)


def _refined_either(best: Choice, request: Request) -> Choice:
    """Free residues with their refined delays, or a classical structure with its own, whichever is likelier."""
    wider = _refined(best, "free", request) if best.fit.structure == "free" else best
    classical = _delayed(best.free, best, "classical", request, True) if request.structure == "auto" else None
    return min((candidate for candidate in (classical, wider) if candidate is not None), key=Choice.cost)


def _delayed(free: FreeFit, best: Choice, hypothesis: str, request: Request, settled: bool) -> Choice | None:
    """A structure with delays, in the rows of a free fit."""
    layout = layout_of(free, request)
    delayed = with_delays(free.projection, layout, hypothesis, free.region, _felt(free, request), settled=settled)
    if delayed is None or delayed.fit.delays is None:
        return None
    projection, late, delays = delayed.free, Choice(free, delayed.fit, best.tests), delayed.fit.delays
    gain = free.delay_gain + (0.0 if settled else late.gain(best))
    measured = free.measured and FreeProjection(
        delays.rows(free.measured.experiments), projection.p, projection.fed  # type: ignore[type-var]
    )  # fmt: skip
    now = replace(
        free, projection=projection, measured=measured, unknowns=projection.unknowns, delay=delays.by_output,
        delay_gain=gain, held_otherwise=None, delay_open=True, findings=best.free.findings,
    )  # fmt: skip
    return replace(late, free=now)


def _refined(best: Choice, hypothesis: str, request: Request) -> Choice:
    """The same with delays that are no whole samples, and their errors; as it is where the data do not tell them."""
    refined = _delayed(best.free, best, hypothesis, request, True)
    if refined is None or refined.fit.delays is None:
        return best
    # free residues and what is fed through say the same for all delays within a sample
    return refined if np.all(refined.fit.delay_errors < np.pi * refined.fit.delays.step) else best


def places_of(free: FreeFit) -> slice:
    """Where an output of the data is first among those of the projection."""
    return slice(None, None, len(free.channels[0].input_labels) if free.per_entry else 1)


def _felt(free: FreeFit, request: Request) -> Mask:
    """What is fed through in any case (outputs of the projection, inputs): to an accelerometer."""
    felt = np.array([feels_force(quantity) for quantity in request.quantities])
    inputs = len(free.channels[0].input_labels)
    return felt.repeat(inputs)[:, None] if free.per_entry else felt[:, None].repeat(inputs, axis=1)


def _under_either_hold(first: Choice, request: Request) -> Choice:
    """The structure under the hold with which it is simpler, or likelier; that the input is not held is a finding."""
    best = _under_likelier_hold(first, request)
    if best.free.intersample == "zoh" or first.free.rival is None:
        return best
    gain = best.gain(first)
    if best is first:
        gain = 0.5 * (first.free.rival.criteria.bic - first.free.criteria.bic)
    return _with_finding_of_hold(best, gain)


def _with_finding_of_hold(best: Choice, gain: float) -> Choice:
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
        chosen, tests = _tested(rival, request, simpler)
        # noise of a poor fit lets every structure stand, and a true one is rejected by chance
        stands = chosen.structure in simpler and _bic_of(chosen.structure, rival, tests) < min(
            _bic_of(structure, free, first.tests) for structure in (first.fit.structure, chosen.structure)
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
        return free.criteria.bic - rival.criteria.bic > _SAME
    wanted = replace(request, ports=()) if request.assumed else request
    costs = np.array([[each.criteria.bic, _bic_of("classical", each, _tested(each, wanted, ("classical",))[1])]
                      for each in (free, rival)])  # fmt: skip
    likelier, more_real = costs.min(axis=1), costs[:, 1]
    if abs(np.ptp(likelier)) > _SAME:
        return bool(likelier[0] > likelier[1])
    return bool(more_real[0] - more_real[1] > 2 * TUNING.sure)

"""The structure of a fit together with delays of the outputs, which a structure shows and free residues absorb."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..._types import Mask
from ..._units import feels_force
from ..data.channels import Recording
from ..regression.free import FreeProjection, Lateness
from ..regression.tuning import TUNING
from ..search.fitted_modes import FreeFit
from .choice import Choice, Request, layout_of
from .constrained import StructuredFit, constrained
from .delayed import with_delays
from .input_hold import SAME, under_either_hold, with_finding_of_hold

_SEEN = 2.0  # standard errors by which delays that a structure needs differ from 0
_EARLY = 1e-3  # of a sample
_NEARLY = 0.02  # of the likelihood ratio that rejects a structure: what delays may leave of it

WithDelay = Callable[[Lateness], FreeFit]  # searches in rows with these delays


def under_hold_and_delays(first: Choice, request: Request, with_delay: WithDelay | None) -> Choice:
    """The structure under the likelier hold of the inputs, with delays of the outputs where these explain more.

    Delays of whole samples are refined, under either hold: a lag that follows a held input looks like one that follows
    a linear input, and is later by a part of a sample.
    """
    free = first.free
    late = bool(free.delay.any())
    # without modes no structure shows a delay, but lags tell where within a sample one lies
    delay_open = free.delay_open and (free.order or late) and free.projection.inputs and not free.interrupted
    # in noise that outputs share, or that comes through the plant, delays are known to a sample
    unrefined = request.function is not None or request.structure == "passive" or free.beside is not None
    if not delay_open or unrefined:
        return under_either_hold(first, request)
    if late:
        return _refined_under_hold(first, request, lambda choice: _with_own_delays(choice, request, with_delay))
    best = under_either_hold(first, request)
    if best.stands(request):
        return best
    return _likelier_with_delays(best, free.rival if best is first else free, request, with_delay) or best


def _refined_under_hold(first: Choice, request: Request, refined: Callable[[Choice], Choice]) -> Choice:
    """The structure with refined delays under the likelier hold, or the constant one where they are nearly the same.

    Inputs that stay for most samples are held, unless the data are sure of something else: half a sample later, linear
    ones say nearly the same.
    """
    rival = first.free.rival
    if rival is None:
        return refined(first)
    rival = replace(rival, findings=first.free.findings, delay_gain=first.free.delay_gain)
    pair = [refined(choice) for choice in (first, Choice.of(rival, request))]
    held, linear = pair if first.free.intersample == "zoh" else pair[::-1]
    gain = linear.gain(held)
    stays = all(isinstance(data, Recording) and data.mostly_stays for data in first.free.channels)
    return with_finding_of_hold(linear if gain > (TUNING.sure if stays else 0.5 * SAME) else held, gain)


def _with_own_delays(late: Choice, request: Request, with_delay: WithDelay | None) -> Choice:
    """The structure in late rows, with other delays where these explain more, or its own refined.

    What is fed through after whole samples may be no more than a part of a sample: it stays where that explains less.
    """
    stands = late.stands(request)
    chosen = None if stands else _likelier_with_delays(late, None, request, with_delay)
    if chosen is not None:
        return chosen
    fed = late.free.projection.fed
    fed_through = fed is not None and bool(np.any(fed & ~_felt(late.free, request)))
    if late.fit.structure == "free":
        own = _refined_either(late, request)
    else:
        own = _refined(late, late.fit.hypothesis, request) if stands else late
        if fed_through and request.structure == "auto":
            own = _simpler(own, _refined(_freely(late, request), "free", request))
    return late if fed_through and late.gain(own) > TUNING.sure else own


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
    return wider if classical is None else _simpler(classical, wider)


def _simpler(choice: Choice, wider: Choice) -> Choice:
    """A structure, or a wider one where this is likelier and not the same model, as of one lag."""
    return wider if 2 * wider.gain(choice) > SAME else choice


def _delayed(free: FreeFit, best: Choice, hypothesis: str, request: Request, settled: bool) -> Choice | None:
    """A structure with delays, in the rows of a free fit."""
    layout = layout_of(free, request)
    delayed = with_delays(free.projection, layout, hypothesis, free.region, _felt(free, request), settled=settled)
    if delayed is None or delayed.fit.delays is None:
        return None
    if not free.direct and np.any(delayed.fit.delays.values < -_EARLY * free.channels[0].dt):
        return None  # what an input will be answers to the noise
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

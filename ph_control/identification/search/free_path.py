"""From nothing, or from a lossless fit, to the damped modes that the data speak for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._types import Array, ComplexArray, Mask
from ..regression.free import FreeProjection, refine_free
from ..regression.time_rows import RecordRows
from ..regression.tuning import TUNING
from ..regression.variable_projection import Problem
from .circumstances import autoregression, correlations
from .criteria import criteria_of, past_of_noise
from .free_search import FreeSearch, Left, free_unknowns
from .steps import stands_out

_EXACT = 1e-13  # relative decrease of the loss at which the last refinement ends


@dataclass(frozen=True)
class FreeStep:
    """Damped modes and what they leave."""

    at: FreeProjection
    left: Left
    loss: float


def free_criterion(search: FreeSearch, step: FreeStep) -> float:
    """BIC of a damped model; of a loss that is rounding, that of the rounding."""
    return criteria_of(search.samples, max(step.loss, search.rounding), search.unknowns(len(step.at.p))).bic


def free_preference(problem: Problem, step: FreeStep) -> float:
    """BIC of damped modes, with noise as coloured as it prefers."""
    samples, n = problem.samples, len(step.at.p)
    lengths = [len(one.u) for one in problem.experiments if isinstance(one, RecordRows)]
    foretold = (
        autoregression(correlations([one[0] for one in step.left], lengths), min(lengths))[1]
        if n and lengths
        else np.ones(1)
    )
    found = criteria_of(samples, step.loss, free_unknowns(problem, n)).bic
    return found + past_of_noise(samples, foretold, float(np.log(samples)))


def free_step(search: FreeSearch, p: ComplexArray) -> FreeStep:
    """Modes refined from a start, in the end over all that was measured: elsewhere, too, they have to be right."""
    at = refine_free(search.rows, p, search.region)
    if len(p) and search.windowed:
        at = refine_free(lambda _: search.all_rows(True), at.p, search.region, TUNING.rough)
    left = search.left(at)
    return FreeStep(at, left, float(search.losses(left).sum()))


def free_path(search: FreeSearch, start: ComplexArray, order: int | None, most: int) -> FreeStep:
    """Modes join one at a time; the best by the BIC of those that have at least as many as were asked for."""
    wanted = order or 0
    best = current = _sound(search, free_step(search, start))
    missed = 0
    while missed < TUNING.patience and len(current.at.p) < max(most, wanted):
        short = len(current.at.p) < wanted
        more = _joined_by_one(search, current, demanding=not short)
        if more is None:
            break
        current = more
        if short or free_criterion(search, current) < free_criterion(search, best):
            best, missed = current, 0
        else:
            missed += 1
    while wanted < len(best.at.p):
        vague = vagueness(search, best.at)
        weakest = int(np.argmax(vague)) if vague.max() > 1 else int(np.argmin(evidence(search, best.at)))
        fewer = free_step(search, np.delete(best.at.p, weakest))
        if vague.max() <= 1 and free_criterion(search, fewer) >= free_criterion(search, best):
            break
        best = fewer
    return best


def decay_errors(search: FreeSearch, at: FreeProjection) -> Array:
    """Standard errors of the decay rates."""
    n = len(at.p)
    inner = at.covariance(at.loss / max(1, at.rows - search.unknowns(n)))
    return np.sqrt(np.diag(inner)[n : 2 * n])


def vagueness(search: FreeSearch, at: FreeProjection) -> Array:
    """Errors of the widths of peaks, in units of what a resonance may have: beyond, it patches a background."""
    allowed = np.maximum(TUNING.vague * np.abs(at.sigma), TUNING.vague * search.region.bin)
    return np.asarray(decay_errors(search, at) / allowed)


def evidence(search: FreeSearch, at: FreeProjection) -> Array:
    """How much the loss would grow without each mode."""
    whole = FreeProjection(search.rows(at.p), at.p)
    return np.array([whole.without_mode(k).loss - whole.loss for k in range(len(at.p))])


def closest(at: FreeProjection, band: float) -> tuple[float, int]:
    """How far, in units of what is demanded, the closest pair is apart, and the weaker mode of it.

    Two modes that all channels see in different proportions may be as close as they like.
    """
    d, half_width = at.d, np.abs(at.sigma)
    if len(d) < 2:
        return np.inf, 0
    apart = np.abs(d[:, None] - d) / (TUNING.damped_apart * band + half_width[:, None] + half_width)
    apart[~_alike(at)] = np.inf
    np.fill_diagonal(apart, np.inf)
    first, second = np.unravel_index(np.argmin(apart), apart.shape)
    # of a pair that mends one peak the broader is the patch
    weaker = first if half_width[first] > half_width[second] else second
    return float(apart[first, second]), int(weaker)


def _alike(at: FreeProjection) -> Mask:
    """Which pairs of modes have the same shape in all channels, by the modal assurance criterion."""
    n = len(at.p)
    shapes = at.residues.reshape(n, -1)
    if not at.inputs:
        shapes = np.concatenate([own[:n] + 1j * own[n : 2 * n] for own in at.own], axis=1)
    if shapes.shape[1] == 1:
        return np.ones((n, n), bool)
    power = np.sum(np.abs(shapes) ** 2, axis=1)
    products = np.outer(power, power)
    return np.abs(shapes.conj() @ shapes.T) ** 2 >= TUNING.same_shape * np.where(products > 0, products, 1.0)


def is_sound(at: FreeProjection, band: float) -> bool:
    """Whether no mode only mends the shape of another, and none is broader than a mode."""
    return bool(closest(at, band)[0] >= 1 and np.all(np.abs(at.sigma) <= TUNING.broadest * at.d))


def _sound(search: FreeSearch, step: FreeStep) -> FreeStep:
    """A model without the modes that only mend the shape of others."""
    while len(step.at.p) and not is_sound(step.at, search.region.bin):
        distance, weaker = closest(step.at, search.region.bin)
        if distance >= 1:
            weaker = int(np.argmax(np.abs(step.at.sigma) / step.at.d))
        step = free_step(search, np.delete(step.at.p, weaker))
    return step


def _joined_by_one(search: FreeSearch, step: FreeStep, demanding: bool) -> FreeStep | None:
    """One more mode, away from those that are there; if nothing else is left, what is not even that."""
    at = step.at
    candidates, gains = search.candidates(step.left)
    needed = TUNING.damped_apart * search.region.bin + np.abs(at.sigma)
    distant = [
        (complex(p), float(gain)) for p, gain in zip(candidates, gains, strict=True)
        if np.all(np.abs(p.imag - at.p.imag) > needed)
    ]  # fmt: skip
    if demanding and not (distant and _is_more_than_noise(search, step, distant[0][1])):
        return None
    first: FreeStep | None = None
    for p, _ in distant[: TUNING.tried]:
        trial = free_step(search, np.append(at.p, p))
        if is_sound(trial.at, search.region.bin):
            return trial
        first = trial if first is None else first
    return None if demanding else first


def _is_more_than_noise(search: FreeSearch, step: FreeStep, gain: float) -> bool:
    now, then = (search.unknowns(len(step.at.p) + more) for more in (0, 1))
    return stands_out(gain, step.loss, search.samples, now, then - now)


def finished(search: FreeSearch, p: ComplexArray, accelerometer: bool) -> FreeProjection:
    """The minimum over all that was measured; what is fed through only where it stands out, or has to be.

    A force is felt by an accelerometer at once; velocity and displacement follow it.
    """
    at = refine_free(lambda _: search.all_rows(True), p, search.region, _EXACT)
    if accelerometer or not at.has_feedthrough:
        return at
    error = float(np.sqrt(at.covariance(at.loss / max(1, at.rows))[-1, -1]))
    if abs(at.feedthrough[0, 0]) > TUNING.fed_through * error:
        return at
    return refine_free(lambda _: search.all_rows(False), at.p, search.region, _EXACT)

"""Modes and real poles join a model, those first that explain most of what it leaves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..._types import Array, ComplexArray
from ..regression.free import FreeProjection
from ..regression.tuning import TUNING
from ..search.criteria import least_gain, stands_out
from ..search.fitted_modes import are_broad, count_modes, count_real_poles
from ..search.free_search import FreeModel, Responses
from ..search.path import FreePath
from .common_denominator import of_common_denominator
from .soundness import cleaned, is_sound

_FASTEST = 0.8  # of the ceiling: faster real poles are none


def grown(path: FreePath, start: ComplexArray, most: int, automatic: bool,
    after: Callable[[FreeModel], FreeModel] = lambda model: model,
) -> FreeModel:  # fmt: skip
    """Let modes join from a start as long as the criterion prefers it; none is doubted, `after` changes each model."""
    model = after(path.reweighted(path.model(start)))
    best, missed = model, 0
    while missed < TUNING.patience and not path.is_exact(model):
        more = _joined(path, model, most, automatic)
        if more is None:
            break
        model = after(more)
        if not automatic or path.cost(model) < path.cost(best):
            best, missed = model, 0
        else:
            missed += 1
    return best


def _joined(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
    """Let a mode join, or several, or a real pole: what the criterion prefers."""
    more = with_modes(path, model, most, automatic) if count_modes(model.p) < most else None
    lag = _with_lag(path, model, most)
    if lag is not None and more is not None:
        return lag if path.cost(lag) <= path.cost(more) else more
    if more is None and automatic and candidates(path, model)[1].any():
        # what stands out only mends the shape of others: so it is where modes overlap
        more = of_common_denominator(path, lag or model, most, automatic)
    return more or lag


def with_modes(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
    """Let a mode join, or several, that do not only mend the shape of others; of a given order also what does."""
    p, gains = candidates(path, model)
    if not (automatic or gains.any()):
        p, gains = candidates(path, model, every=True)
    if not len(p) or (automatic and not gains.any()):
        return None
    band = path.search.region.bin
    whole = _together(model.projection, p, gains, band, most - count_modes(model.p))
    modal = (gains > 0) & (np.nan_to_num(np.abs(p.real)) <= TUNING.broadest * np.abs(p.imag))
    alone = automatic and len(path.counts) * max(1, model.projection.inputs) == 1
    if alone:
        needed = path.search.crowding + np.abs(model.projection.sigma)
        modal &= np.all(np.abs(p.imag[:, None] - model.p.imag) > needed, axis=1)
    sure = p[modal]
    # beside modes of one channel that are still wrong, others that stand out may be no more than their shadows
    trials = [whole[np.isin(whole, sure if p[0] in sure or not alone else [])] if automatic else whole]
    trials += [sure[k : k + 1] for k in range(min(TUNING.tried, len(sure)))]
    first: FreeModel | None = None
    for joining in trials:
        if len(joining):
            trial = path.model(np.append(model.p, joining))
            lags = int(np.sum(are_broad(model.p)))
            sound = cleaned(path, trial, lags) if automatic else trial
            if len(sound.p) > len(model.p) and is_sound(path, sound, lags):
                return path.reweighted(sound)
            first = first or trial
    return None if automatic or first is None else path.reweighted(first)


def _with_lag(path: FreePath, model: FreeModel, most: int) -> FreeModel | None:
    """Let a real pole join if the criterion prefers it; two may become a mode where there are not `most` yet."""
    given = path.options.real_poles != "auto"
    if given and count_real_poles(model.p) >= int(path.options.real_poles):
        return None
    if not given and not path.search.shows_background(len(model.p) + 1):
        return None
    pole, gain = path.scaled.lag(model.projection, yielding=not path.is_white(model))
    p = np.append(model.p, pole)
    if path.search.unknowns_of(p) >= path.counts.sum() or path.is_exact(model) or path.crowded:
        return None
    if not given and gain < TUNING.nearly_as_strong * candidates(path, model)[1].max(initial=0.0):
        return None
    joint, unknowns = path.search is not path.plain, path.search.unknowns_of(p) - path.search.unknowns_of(model.p)
    if not (given or joint or path.stands_out(model, gain, unknowns)):
        return None
    more = path.reweighted(path.model(p))
    if count_modes(more.p) > most:
        return None
    joins = count_real_poles(more.p) > count_real_poles(model.p) if given else _prefers_lag(path, more, model)
    return more if joins else None


def _prefers_lag(path: FreePath, more: FreeModel, model: FreeModel) -> bool:
    """Whether the criterion prefers one more lag, unless it is at the border and stands for what is fed through."""
    if np.any(more.p[more.p.imag == 0].real < -_FASTEST * path.search.region.ceiling):
        return False
    if path.search is not path.plain:
        return True
    before, after = (float(np.sum(candidate.losses * path.sizes**2)) for candidate in (model, more))
    unknowns = path.search.unknowns_of(more.p) - path.search.unknowns_of(model.p)
    return path.stands_out(model, before - after, unknowns) and path.gain(more, model) > 2 * TUNING.sure


def candidates(path: FreePath, model: FreeModel, every: bool = False) -> tuple[ComplexArray, Array]:
    """Return poles that stand out of what is left, the strongest first, or `every`: gains of what does not are 0."""
    if path.shown is not None and path.shown[0] is model and not every:
        return path.shown[1]
    if path.crowded:  # none stands out by itself
        return np.zeros(0, complex), np.zeros(0)
    if isinstance(path.search, Responses) and path.search.classical:
        # beside modes that are missing nothing stands out of few points: all are doubted at the end
        return path.scaled.candidates(model)
    now, then = path.search.unknowns_of(model.p), path.search.unknowns_of(np.append(model.p, 1j))
    loss, samples = float(np.sum(model.losses * path.sizes**2)), int(path.counts.sum())
    least = 0.0 if every else least_gain(loss, samples, now, then - now)
    p, gains = path.scaled.candidates(model, least)
    shown = [stands_out(gain, loss, samples, now, then - now) for gain in gains.tolist()]
    gains = gains * np.array(shown, bool)
    if not every:
        path.shown = model, (p, gains)
    return p, gains


def _together(projection: FreeProjection, p: ComplexArray, gains: Array, width: float, most: int) -> ComplexArray:
    """Return candidates that may join at once: the strongest, and those nearly as strong far from all others."""
    chosen = [complex(p[0])]
    for pole, gain in zip(p[1:].tolist(), gains[1:].tolist(), strict=True):
        if len(chosen) == most or gain < TUNING.nearly_as_strong * gains[0] or not gain:
            break
        others = np.append(projection.p, chosen)
        apart = TUNING.together_apart * width + np.nan_to_num(np.abs(others.real)) + abs(pole.real)
        if np.all(np.abs(others.imag - pole.imag) > apart):
            chosen.append(pole)
    return np.array(chosen)

"""Modes join, are doubted, and take better places: under given circumstances, as long as the criterion prefers it.

Their number is chosen with noise as coloured as the criterion prefers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..._types import Array, ComplexArray, Mask
from ..data.time_record import cut, searched_part
from ..regression.free import FreeProjection
from ..regression.frequency_rows import FURTHER_TERMS
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments, RowOptions, is_short
from ..search.fitted_modes import are_broad, count_modes, count_real_poles, least_gain, stands_out
from ..search.free_search import FreeModel, Records, Responses
from ..search.path import FreePath

_FASTEST = 0.8  # of the ceiling: faster real poles are none
_GROWING = 3.0  # standard errors of a decay rate beyond which a mode grows
_LARGE = 0.01  # of the power of all outputs: with less no mode is taken to grow
_SWAPS = 6  # modes that are looked for elsewhere, at most
_NO_NOISE = 1.0  # by which the logarithm of the variance falls where what was left is no noise, of any law


def chosen(path: FreePath, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
    """Search for the model of an order, or of the best, with noise as coloured as the criterion prefers."""
    if path.innovations:
        return _joint(path, start, most, automatic)
    model = _in_rows(path, start, most, automatic)
    # coloured noise would take over what a plant lacks that has too few modes, when their number is given; beside
    # modes with a peak it would take over the weak ones, though broad noise is no mode with a peak in any case
    peaks = bool(np.any((model.p.imag > 0) & ~are_broad(model.p)))
    if peaks or not ((automatic or not most) and _coloured(path, model)):
        return model
    # noise of a model that is too small has what this lacks: in its rows others are looked for, and from nothing
    models = [path.in_its_noise(model)]
    if path.options.real_poles == "auto":
        models.append(path.in_its_noise(_in_rows(path, models[0].p, most, automatic)))
    return min([*models, _joint(path, start, most, automatic)], key=path.cost)


def _coloured(path: FreePath, model: FreeModel) -> bool:
    """Whether the criterion prefers coloured noise, where something acts all along; spans of a record may be idle."""
    driven = isinstance(path.plain, Records) and any(
        record.inputs and not is_short(record) for record in path.plain.data
    )
    return driven and bool(path.noise_filters(model)) and not np.any(model.losses <= path.floors_in(model.innovations))


def _joint(path: FreePath, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
    """Grow a model from a start with the noise that belongs to each step."""
    path.whiten((), path.power)
    model = _grown(path, start, most, automatic, path.in_its_noise)
    path.whiten(model.innovations, model.losses)
    return path.in_its_noise(_improved(path, model, most, automatic))


def _in_rows(path: FreePath, start: ComplexArray, most: int, automatic: bool) -> FreeModel:
    """Search for the model of an order, or of the best, in the noise of the present rows."""
    model = _improved(path, _grown(path, start, most, automatic), most, automatic)
    if not automatic and len(model.p) and not (path.is_exact(model) or path.is_white(model)):
        model = _of_common_denominator(path, model, most, automatic) or model
    other = _likelier(path, model, most) if automatic else None
    if other is not None:
        other = _improved(path, _grown(path, other.p, most, automatic), most, automatic)
        model = min(model, other, key=path.cost)
    return model


def may_reach(path: FreePath, model: FreeModel, most: int, bic: float) -> bool:
    """Whether modes that join a model lead to a BIC as small as some, or may yet.

    Given up where a mode more, and the best place of all, lower the BIC so little that as many as are open would not
    reach it.
    """
    gap = path.bic(model) - bic
    while gap > 0:
        before = gap
        for better in (joined, _improved):
            model = better(path, model, most, True) or model
            gap = path.bic(model) - bic
            if gap <= (before - gap) * (most - count_modes(model.p)):
                break
        else:
            return False
    return True


def through_orders(path: FreePath, start: ComplexArray, most: int) -> None:
    """Let modes join one by one from a start up to a number of them; the table has the best of each order.

    The path ends where the data are reproduced to rounding.
    """
    model: FreeModel | None = path.reweighted(path.model(start))
    while model is not None and count_modes(model.p) < most and np.any(model.losses > path.floors):
        model = _with_modes(path, model, count_modes(model.p) + 1, False)


def orders_about(
    channels: Experiments, poles: ComplexArray, most: int, form: RowOptions
) -> list[tuple[ComplexArray, ComplexArray]]:
    """Return poles and residues (n, p, m) of ascending orders, one more mode each: to some poles, and on to the most.

    Real poles stay, and are left out.
    Without inputs the residues are motions in the experiments.
    """
    channels = [cut(channel, searched_part(channel, not form.moving)) for channel in channels]
    path = FreePath.of(channels, form)
    orders = []
    for start, end in ((poles[poles.imag == 0], count_modes(poles) - 1), (poles, min(most, path.carried))):
        model: FreeModel | None = path.reweighted(path.model(start))
        while model is not None:
            modes = model.p.imag > 0
            if modes.any():
                orders.append((model.p[modes], _residues(path, model.projection, channels)[modes]))
            model = _with_modes(path, model, count_modes(model.p) + 1, False) if count_modes(model.p) < end else None
    return orders


def _residues(path: FreePath, projection: FreeProjection, channels: Experiments) -> ComplexArray:
    """Return residues in the units of the data, shape (n, p, m); without inputs motions in the experiments."""
    n, p, m = len(projection.p), len(channels[0].output_labels), len(channels[0].input_labels)
    if m:
        return np.asarray(projection.residues / path.sizes[:, None]).reshape(n, p, m)
    motions = np.zeros((n, p, len(channels)), complex)
    measured, done = np.cumsum([int(channel.observed.any(axis=-1).sum()) for channel in channels]), 0
    for rows, own in zip(projection.experiments, projection.own, strict=True):
        place = int(np.searchsorted(measured, done, side="right"))
        motions[:, rows.outputs, place] = (own[:n] + 1j * own[n : 2 * n]) / path.sizes[rows.outputs]
        done += len(rows.outputs)
    return motions


def _grown(path: FreePath, start: ComplexArray, most: int, automatic: bool,
    after: Callable[[FreeModel], FreeModel] = lambda model: model,
) -> FreeModel:  # fmt: skip
    """Let modes join from a start as long as the criterion prefers it; none is doubted, `after` changes each model."""
    model = after(path.reweighted(path.model(start)))
    best, missed = model, 0
    while missed < TUNING.patience and not path.is_exact(model):
        more = joined(path, model, most, automatic)
        if more is None:
            break
        model = after(more)
        if not automatic or path.cost(model) < path.cost(best):
            best, missed = model, 0
        else:
            missed += 1
    return best


def joined(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
    """Let a mode join, or several, or a real pole: what the criterion prefers.

    Beside a real pole that leaves white noise no mode is looked for.
    """
    lag = _with_lag(path, model, most)
    if lag is not None and automatic and path.is_white(lag):
        return lag
    more = _with_modes(path, model, most, automatic) if count_modes(model.p) < most else None
    if lag is not None and more is not None:
        return lag if path.cost(lag) <= path.cost(more) else more
    if more is None and automatic and candidates(path, model)[1].any():
        # what stands out only mends the shape of others: so it is where modes overlap
        more = _of_common_denominator(path, lag or model, most, automatic)
    return more or lag


def _with_modes(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
    """Let a mode join, or several, that do not only mend the shape of others; of a given order also what does."""
    first: FreeModel | None = None
    lags = int(np.sum(are_broad(model.p)))
    for joining in _joining(path, model, most, automatic):
        trial = path.model(np.append(model.p, joining))
        first = first or trial
        if automatic and len(joining) > 1 and path.cost(trial) > path.cost(model):
            continue  # alone the strongest may be of more use
        sound = cleaned(path, trial, lags, model) if automatic else trial
        if _is_step(path, model, sound) and is_sound(path, sound, lags):
            return path.reweighted(sound)
    return None if automatic or first is None else path.reweighted(first)


def _joining(path: FreePath, model: FreeModel, most: int, automatic: bool) -> list[ComplexArray]:
    """Return which poles may join a model, several together before each alone."""
    p, gains = candidates(path, model)
    if not (automatic or gains.any()):
        p, gains = candidates(path, model, every=True)
    if not len(p) or (automatic and not gains.any()):
        return []
    together = _together(model.projection, p, gains, path.search.region.bin, most - count_modes(model.p))
    modal = (gains > 0) & (np.nan_to_num(np.abs(p.real)) <= TUNING.broadest * np.abs(p.imag))
    alone = automatic and len(path.counts) * max(1, model.projection.inputs) == 1
    if alone:
        needed = path.search.crowding + np.abs(model.projection.sigma)
        modal &= np.all(np.abs(p.imag[:, None] - model.p.imag) > needed, axis=1)
    sure = p[modal]
    if automatic:
        # beside modes of one channel that are still wrong, others that stand out may be no more than their shadows
        together = together[np.isin(together, sure if p[0] in sure or not alone else [])]
    trials = [together, *(sure[k : k + 1] for k in range(min(TUNING.tried, len(sure))))]
    return [joining for joining in trials if len(joining)]


def _with_lag(path: FreePath, model: FreeModel, most: int) -> FreeModel | None:
    """Let a real pole join if the criterion prefers it; two may become a mode where there are not `most` yet."""
    given = path.options.real_poles != "auto"
    if given and count_real_poles(model.p) >= int(path.options.real_poles):
        return None
    if not given and not path.search.shows_background(len(model.p) + 1):
        return None
    path.resume(model)
    # two lags that together leave a response white, as those of a capacitor that is not ideal, are better one
    yielding = isinstance(path.plain, Records) or not path.is_white(model)
    pole, gain = path.scaled.lag(model.projection, yielding)
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
    path.resume(model)
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


def is_sound(path: FreePath, model: FreeModel, lags: int = 0) -> bool:
    """Whether each mode is one of the plant: none mends the shape of another, is too broad, or grows unseen.

    So many as `lags` that have become pairs of complex poles may be broad.  Nothing is doubted of a model that
    reproduces the data to rounding.
    """
    if not len(model.p) or path.is_exact(model):
        return True
    too_broad = int(np.sum(are_broad(model.p))) > lags
    return not _patching(model.projection, path.search.crowding) and not too_broad and not grows(path, model)


def _is_step(path: FreePath, model: FreeModel, more: FreeModel) -> bool:
    """Whether there are more poles, which explain more: where modes of the plant have gone, others explain less."""
    return len(more.p) > len(model.p) and path.loglik(more.losses) > path.loglik(model.losses)


def cleaned(path: FreePath, model: FreeModel, lags: int = 0, before: FreeModel | None = None) -> FreeModel:
    """Drop the modes of a model that are none of the plant, as long as it is a step from the one `before`."""
    while len(model.p) and not is_sound(path, model, lags):
        if not (before is None or _is_step(path, before, model)):
            break
        projection = model.projection
        # what several channels see of a pair changes as others go
        alone = len(path.counts) * max(1, projection.inputs) == 1
        worst = _patching(projection, path.search.crowding)[: None if alone else 1]
        if not worst:
            widths = np.abs(projection.sigma) / np.where(projection.d > 0, projection.d, 1.0)
            widths = np.where(are_broad(projection.p), widths, 0.0)
            worst = [int(np.argmax(widths) if widths.any() else np.argmin(projection.sigma))]
        model = path.model(np.delete(projection.p, worst))
    return model


def growing(path: FreePath, projection: FreeProjection, evidence: Callable[[], Array]) -> Mask:
    """Return which modes grow within the record, and are broad or no large part of any motion.

    They patch records that are not stationary.
    """
    least = np.maximum(_GROWING * _decay_errors(path, projection), TUNING.slowest_growth * path.search.region.bin)
    modes = (projection.p.imag > 0) & (projection.sigma < -least)
    if modes.any():
        large = _LARGE * float(np.sum(path.power * path.sizes**2))
        modes &= (projection.sigma < -TUNING.broadest * projection.d) | (evidence() < large)
    return modes


def grows(path: FreePath, model: FreeModel) -> bool:
    """Whether a model has modes as in `growing`."""
    return bool(growing(path, model.projection, lambda: evidence_of(path, model)).any())


def pruned(path: FreePath, model: FreeModel) -> FreeModel:
    """Drop modes as long as the criterion gets better, or their widths are not known."""
    while len(model.p):
        vague = vagueness(path, model)
        evidence = np.where(given_real_poles(path, model.p), np.inf, evidence_of(path, model))
        weakest = int(np.argmax(vague)) if vague.max() > 1 else int(np.argmin(evidence))
        if vague.max() <= 1 and not np.isfinite(evidence[weakest]):
            break
        fewer = path.model(np.delete(model.p, weakest))
        if vague.max() <= 1 and path.cost(fewer) >= path.cost(model):
            break
        model = path.reweighted(fewer)
    return model


def given_real_poles(path: FreePath, p: ComplexArray) -> Mask:
    """Return which poles stay in any case: the real ones of a number that was given."""
    given = path.options.real_poles != "auto"
    return (p.imag == 0) & (given and count_real_poles(p) <= int(path.options.real_poles))


def vagueness(path: FreePath, model: FreeModel) -> Array:
    """Return the errors of widths of peaks, in units of what a resonance may have: beyond, it patches a background."""
    allowed = TUNING.vague * np.maximum(np.abs(model.projection.sigma), path.search.region.bin)
    lag = (model.p.imag == 0) | (are_broad(model.p) & path.search.kinds_may_change) | path.crowded
    return np.where(lag, 0.0, _decay_errors(path, model.projection) / allowed)


def _decay_errors(path: FreePath, projection: FreeProjection) -> Array:
    """Return the standard errors of the decay rates."""
    n = len(projection.p)
    inner = projection.covariance(projection.loss / max(1, projection.rows - path.search.unknowns_of(projection.p)))
    return np.sqrt(np.maximum(np.diag(inner)[n : 2 * n], 0.0))  # rounding may make them negative


def evidence_of(path: FreePath, model: FreeModel) -> Array:
    """Return how much the loss would grow without each mode."""
    return FreeProjection(path.scaled.rows(model.p), model.p).evidence


def _patching(projection: FreeProjection, distance: float) -> list[int]:
    """Return the weaker mode of each pair that is too close, the closest first, no mode in two of them.

    Two modes that all channels see in different proportions may be as close as they like.
    """
    d, half_width = projection.d, np.abs(projection.sigma)
    apart = np.abs(d[:, None] - d) / (distance + half_width[:, None] + half_width)
    apart[~_alike(projection)] = np.inf
    lag = (projection.p.imag == 0) | are_broad(projection.p)
    apart[lag] = apart[:, lag] = np.inf
    np.fill_diagonal(apart, np.inf)
    weaker, taken = list[int](), set[int]()
    for place in np.argsort(apart, axis=None, kind="stable")[: np.count_nonzero(apart < 1)].tolist():
        pair = divmod(place, len(d))
        if not taken & set(pair):
            taken |= set(pair)
            # of a pair that mends one peak the broader is the patch
            weaker.append(max(reversed(pair), key=lambda k: half_width[k]))
    return weaker


def _alike(projection: FreeProjection) -> Mask:
    """Return which pairs of modes have the same shape in all channels, by the modal assurance criterion."""
    n = len(projection.p)
    shapes = projection.residues.reshape(n, -1)
    if not projection.inputs:
        shapes = np.concatenate([own[:n] + 1j * own[n : 2 * n] for own in projection.own], axis=1)
    if shapes.shape[1] == 1:
        return np.ones((n, n), bool)
    power = np.sum(np.abs(shapes) ** 2, axis=1)
    products = np.outer(power, power)
    return np.abs(shapes.conj() @ shapes.T) ** 2 >= TUNING.same_shape * np.where(products > 0, products, 1.0)


def _improved(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel:
    """Relocate weak modes of a model and, of an order that is chosen, drop needless ones."""
    model = _relocated(path, model, automatic, most)
    if not automatic:
        return model
    return _without_slow_noise(path, _split(path, _patched(path, pruned(path, model), most), most))


def _relocated(path: FreePath, model: FreeModel, sound: bool, most: int) -> FreeModel:
    """Exchange the weakest modes for what stands out of the rest, as long as that is likelier."""
    for _ in range(_SWAPS):
        p, gains = candidates(path, model)
        if not gains.any():
            break
        more = path.model(np.append(model.p, p[0]))
        weakest = int(np.argmin(evidence_of(path, more)))
        other = path.model(np.delete(more.p, weakest))
        gain = path.loglik(other.losses) - path.loglik(model.losses)
        # a mode may come in the place of a real pole
        if gain <= TUNING.sure or count_modes(other.p) > max(most, count_modes(model.p)):
            break
        if sound and not is_sound(path, other, int(np.sum(are_broad(model.p)))):
            break
        model = path.reweighted(other)
    return model


def _patched(path: FreePath, model: FreeModel, most: int) -> FreeModel:
    """Let modes join that are close to others, or broad, where they leave white residuals and others do not.

    Residuals of few modes may pass for white as well, where another is far likelier.
    """
    more = model
    for _ in range(TUNING.patches):
        p, gains = candidates(path, more)
        if not gains.any() or count_modes(more.p) >= most or path.is_exact(more):
            break
        trial = path.reweighted(path.model(np.append(more.p, p[0])))
        if path.is_white(more) and path.cost(trial) > path.cost(more) - 2 * TUNING.likely:
            break
        more = trial
    if more is model or not path.is_white(more):
        return model
    more = pruned(path, _relocated(path, more, False, most))
    better = path.is_white(more) and path.cost(more) < path.cost(model)
    return more if better and not grows(path, more) else model


def _split(path: FreePath, model: FreeModel, most: int) -> FreeModel:
    """Let a peak of one channel be two modes where that is far likelier: what a second one does there never stands out.

    To first order this is what moves the first; coloured noise takes over the rest.
    """
    if len(path.counts) * max(1, model.projection.inputs) > 1:
        return model
    while count_modes(model.p) < most and path.noise_filters(model) and not path.is_exact(model):
        peaks = model.p[(model.p.imag > 0) & ~are_broad(model.p)]
        trials = [path.reweighted(path.model(np.append(model.p, pole + 1j * pole.real))) for pole in peaks]
        other = min(trials, key=path.cost, default=model)
        if path.cost(other) > path.cost(model) - 2 * TUNING.likely or grows(path, other):
            break
        model = other
    return model


def _without_slow_noise(path: FreePath, model: FreeModel) -> FreeModel:
    """Drop the slow poles of a model where the criterion prefers noise of slow colour to these.

    In white noise such poles explain so much that none of them is ever the weakest, and the others are poor without
    them: these are compared in their own noise.
    """
    if path.search is not path.plain:
        return model
    slow = (np.abs(model.p) < TUNING.broad_noise * path.search.region.bin) & ~given_real_poles(path, model.p)
    if not slow.any() or path.is_exact(model) or not path.noise_filters(model):
        return model
    fewer = path.reweighted(path.model(model.p[~slow]))
    costs = [path.cost(path.in_its_noise(candidate)) for candidate in (fewer, model)]
    chosen = fewer if costs[0] < costs[1] else model
    path.whiten((), chosen.losses)
    return chosen


def _likelier(path: FreePath, model: FreeModel, most: int) -> FreeModel | None:
    """Return a much likelier model that the search has come by, of so many modes at `most`, if there is one.

    Where what is left is no noise, as of plants that are not quite linear, the way of a search depends on rounding.
    """
    limit = path.cost(model) - TUNING.likelier * float(path.counts.sum())
    for cost, p in sorted(path.seen, key=lambda pair: pair[0]):
        if cost > limit:
            break
        if count_modes(p) <= most and np.all(np.abs(p.real) <= TUNING.broadest * np.abs(p)):
            other = path.model(p)
            if is_sound(path, other) and vagueness(path, other).max(initial=0.0) <= 1:
                return path.reweighted(other)
    return None


def _of_likeliest_count(
    path: FreePath, together: Responses, model: FreeModel, most: int, automatic: bool
) -> FreeModel:  # fmt: skip
    """Return the likeliest of a model and those whose modes, of any number, `together` have a common denominator."""
    best, missed, count = model, 0, count_modes(model.p) if automatic else most - 1
    while missed < TUNING.patience and (count < most or not automatic):
        count = min(most, count * 5 // 4 + 1) if automatic else count + 1
        p = together.of_common_denominator(count)
        if path.search.unknowns_of(p) >= path.counts.sum():
            break
        missed += 1
        if automatic or count_modes(p) == most:
            more = path.judged(FreeProjection(path.scaled.data, p))
            best, missed = (more, 0) if path.cost(more) < path.cost(best) else (best, missed)
    if best is not model:
        best = path.reweighted(path.model(best.p))
        best = pruned(path, best) if automatic else best
    return best


def _of_common_denominator(path: FreePath, model: FreeModel, most: int, automatic: bool) -> FreeModel | None:
    """Find modes that overlap all at once, as many as the criterion wants; None unless they explain much more.

    From there on modes may mend the shape of others, if they have to.
    """
    if path.separate or path.options.real_poles not in ("auto", 0) or not (
        isinstance(path.search, Responses) and path.search.share_poles
    ):  # fmt: skip
        return None
    plain, path.separate = path.search, True
    path.search = together = replace(path.search, crowded=True)
    path.weigh(model.losses)
    together = together.scaled(path.sizes)
    best = _of_likeliest_count(path, together, model, most, automatic)
    crowded, path.search = path.search, plain
    for term in FURTHER_TERMS:  # what may be no background, but one of further terms
        path.search = path.search.with_term(term)
    path.weigh(best.losses)
    apart = path.reweighted(cleaned(path, path.model(best.p))) if automatic else model
    if path.cost(best) < min(path.cost(apart), path.cost(model)) - _NO_NOISE * path.counts.sum():
        path.search = crowded
        path.weigh(best.losses)
        return best
    path.search = plain
    path.weigh(model.losses)
    other = path.reweighted(path.model(apart.p)) if automatic else model
    return other if path.cost(other) < path.cost(model) else None

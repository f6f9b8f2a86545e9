"""From recordings or response matrices to the damped modes, with any residues, that are most likely.

One mode after the other joins where it explains most of what is left of all channels together, all are refined
jointly, and each output counts by the variance of its own noise, which is estimated along with them.  Searches that
begin or proceed otherwise are taken where they are likelier; of long records, and of those whose noise changes, modes
of parts are refined over all samples.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import f as f_law

from ..._types import Array, ComplexArray
from ..data.channels import Recording, ResponseMatrix
from ..data.time_record import cut, is_long, searched_part, stages
from ..growth.ending import end_of_search, finished
from ..growth.growing import chosen, evidence_of
from ..growth.held_out import foretelling_order
from ..regression.free import FreeProjection
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments, RowOptions
from ..search.fitted_modes import FreeFit, Orders, are_broad, count_modes, count_real_poles
from ..search.free_search import FreeModel, Responses
from ..search.path import FreePath, SearchOptions
from ..uncertainty.residual_tests import is_white
from .assumptions import Assumptions, Fit, Search, alone
from .delays import are_heavy, may_be_late, of_late_lag, of_predicted_delay, on_time, predicted_lateness
from .drifts import are_slow, beside_drift, with_constants
from .feedback import without_direct_answers
from .late_inputs import of_late_inputs, with_dead_times
from .prevailing_noise import InNoise, beside_forces_and_more, in_prevailing_noise, may_be_white
from .response_noise import in_noise_of_the_gain, in_noise_of_the_window, with_first_errors, without_lines_in_error

_FEW_MODES = 5  # that few points of responses do not show beside a background

_SURELY_GROWING = 40.0  # by which the BIC is smaller with a pole that grows, at least
_SHORTEST_SPAN = 32  # samples of one level of noise that are searched


def free_fit(
    channels: Experiments, order: int | str = "auto", *, start: ComplexArray | None = None, **assumptions: Any
) -> FreeFit:
    """Fit modes of any damping and residues to all channels, from nothing or from some poles.

    Parameters
    ----------
    channels : sequence of Recording, or of ResponseMatrix
        Experiments of the same inputs and outputs.
    order : int or 'auto'
        Number of modes; 'auto' takes that which the criterion prefers.
    start : ndarray of complex, optional
        Poles of positive imaginary part to start from, real parts NaN where they are not known.
    **assumptions
        Attributes of `Assumptions` that are not the default.

    Returns
    -------
    FreeFit
        The minimum, its order table, and what belongs to it.

    Raises
    ------
    IdentificationError
        If there are fewer samples than unknowns.
    StructureError
        If an entry of the response matrices was measured in none of them.
    """
    given = Assumptions(**assumptions)
    fit = _decaying_or_growing(channels, order, given, start)
    return without_direct_answers(
        fit, given, lambda other: _decaying_or_growing(channels, order, other, start),
        lambda other: free_refinement(channels, fit, fit.projection.p, **vars(other)),
    )  # fmt: skip


def _decaying_or_growing(
    channels: Experiments, order: int | str, given: Assumptions, start: ComplexArray | None
) -> FreeFit:  # fmt: skip
    """Fit modes, without poles that grow unless these are far likelier."""
    fit = _fitted(channels, order, given, start)
    # a pole that grows may stand for a part of what is more than white noise, or for noise that wanders
    if start is None and _grows(fit) and not fit.interrupted and (order == "auto" or not fit.leaves_white_noise):
        return _or_of_decaying_poles(fit, channels, order, given)
    return fit


def _grows(fit: FreeFit) -> bool:
    """Whether a pole grows more than errors of those that do not decay may have it."""
    return bool(np.any(fit.projection.p.real > TUNING.slowest_growth * fit.region.bin))


def _or_of_decaying_poles(fit: FreeFit, channels: Experiments, order: int | str, given: Assumptions) -> FreeFit:
    """Return the fit, or that whose poles may not grow, unless that is far less likely.

    What grows fits the end of most records of noise that wanders, where it was let in, and none that follow.
    """
    given = replace(given, growing=False)
    try:
        if _must_grow(fit, channels, given):
            return fit
        steady = _fitted(channels, order, given, None)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    if steady.interrupted:
        return replace(fit, interrupted=True)
    margin = _SURELY_GROWING if order == "auto" else 0.0
    return steady if steady.gain_over(fit) > -margin else fit


def _must_grow(fit: FreeFit, channels: Experiments, given: Assumptions) -> bool:
    """Whether poles that may not grow leave so much beside noise of each output that others could hardly do better."""
    if fit.beside is not None or is_long(channels):
        return False
    path = Search(given, fit.projection.p, fit.order, False).path(channels, fit.lateness, fit.offset, fit.intersample)
    model = path.in_its_noise(path.reweighted(path.model(fit.projection.p)))
    limit = fit.criteria.by_name(path.options.criterion) + TUNING.hopeless * fit.criteria.samples
    return path.cost(model) > limit


def free_refinement(channels: Experiments, like: FreeFit, p: ComplexArray, **assumptions: Any) -> FreeFit:
    """Fit poles and residues to other channels from some poles, in the noise, delays and hold of a fit to similar data.

    Parameters
    ----------
    channels : sequence of Recording
        Experiments of the same inputs and outputs.
    like : FreeFit
        The fit whose circumstances are kept.
    p : ndarray of complex, shape (n,)
        Poles to start from, of imaginary part zero or positive; their number is kept.
    **assumptions
        Attributes of `Assumptions` that are not the default.

    Returns
    -------
    FreeFit
        The minimum about these poles.
    """
    given = replace(Assumptions(**assumptions), real_poles=count_real_poles(p))
    if is_long(channels):
        given = replace(given, delay=like.delay, input_delay=like.input_delay, intersample=like.intersample)
        return _fitted(channels, count_modes(p), given, p)
    search = Search(given, p, count_modes(p), False)
    try:
        fit = search.anew(replace(like, channels=tuple(channels)), compared=False)(like.lateness, like.offset, p)
    except KeyboardInterrupt:
        return replace(like, interrupted=True)
    return fit if like.beside is None else given.beside(fit, orders=Orders(), like=like)


def late_fit(channels: Experiments, order: int | str = "auto", **assumptions: Any) -> FreeFit | None:
    """Fit the dead times of inputs, or of a lag, where records begin to show them; None where they do not."""
    search, _ = _prepared(channels, order, Assumptions(**assumptions), None)
    return _late(channels, search)


def _fitted(channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None) -> FreeFit:
    """Fit modes the way that the data and the order ask for: by parts, twice, without some lines, or directly."""
    if is_long(channels):
        return _of_long(channels, order, assumptions, start, _fitted)
    if any(isinstance(channel, Recording) and len(channel.changes) for channel in channels):
        return _in_changing_noise(channels, order, assumptions, start, _fitted)
    if assumptions.real_poles == "auto" and isinstance(order, int):
        if start is None:
            return _with_real_poles(channels, order, assumptions, _fitted)
        assumptions = replace(assumptions, real_poles=0)
    responses = [data for data in channels if isinstance(data, ResponseMatrix)]
    if not responses:
        return _searched(channels, order, assumptions, start)
    windowed = any(data.window is not None for data in responses)
    if assumptions.doubted and not windowed:
        return without_lines_in_error(responses, order, assumptions, start, _fitted)
    responses = with_first_errors(responses, assumptions.weighted) if windowed else responses
    return _searched(responses, order, assumptions, start)


def _searched(channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None) -> FreeFit:
    """Search for modes, then for the noise and the circumstances in which they are likelier."""
    search, path = _prepared(channels, order, assumptions, start)
    fit, forced, in_noise = _in_white_noise_and_beside(channels, search, path, start)
    slow: FreeFit | None = None
    if not forced.interrupted:
        fit, forced, slow = _or_in_own_noise(fit, forced, search)
    if forced.interrupted:
        return forced
    open_delay = assumptions.delay is None and may_be_late(forced)
    if forced.beside is not None and forced.beside.is_coloured:
        return _late_or_not(forced, fit, slow, in_noise, open_delay, search)
    in_white_noise = _beside_all_else(fit.with_delay_open(open_delay), search)
    if forced.beside is not None:
        return _in_likelier_rows(forced, in_white_noise, in_noise, search)
    if _grows(in_white_noise) and not (search.automatic or fit.noise):
        return _or_in_residual_noise(in_white_noise, path, open_delay, search)
    return in_noise(in_white_noise) if _may_hide_noise(in_white_noise, fit, search) else in_white_noise


def _may_hide_noise(changed: FreeFit, fit: FreeFit, search: Search) -> bool:
    """Whether other noise is looked for once more, beside the drifts and delays by which a fit was changed.

    A drift may hide the noise that outputs share, a delay what comes through the plant, and slow poles stand for noise
    that wanders.
    """
    drifts = changed.offset > max(1, fit.offset) and not (changed.delay.any() or changed.noise)
    late = bool(changed.noise) and np.any(changed.delay != fit.delay)
    wanders = are_slow(changed).any() and not np.array_equal(changed.projection.p, fit.projection.p)
    return bool(drifts or (search.automatic and (late or wanders)))


def _late_or_not(
    forced: FreeFit, fit: FreeFit, slow: FreeFit | None, in_noise: InNoise, open_delay: bool, search: Search
) -> FreeFit:  # fmt: skip
    """Return the fit beside forces, with a delay and drifts if these are likelier, or another with a delay."""
    forced = beside_forces_and_more(forced, fit, search, may_be_late=open_delay)
    forced = _late_beside_forces(forced, in_noise, search)
    if slow is not None:
        return _or_late(forced, slow, in_noise, search)
    # modes are told from forces, which may stand for lags that come late
    lags = search.assumptions.delay is None and bool(np.all(are_heavy(forced.projection.p)))
    late = lags or (open_delay and not search.automatic)
    return _or_late(forced, fit, in_noise, search) if late else forced


def _or_late(forced: FreeFit, fit: FreeFit, in_noise: InNoise, search: Search) -> FreeFit:
    """Return the fit beside forces, or another with a delay in white noise or that of each output, if it is likelier.

    Of a number of poles that is given none can stand for the delay, and forces may.
    """
    if forced.interrupted:
        return forced
    late = _beside_all_else(fit.with_delay_open(search.assumptions.delay is None), search)
    if late.interrupted:
        return replace(forced, interrupted=True)
    # integrals of inputs look like noise that wanders
    wanders = forced.beside is not None and forced.beside.sections.apart and bool(are_slow(late).any())
    late = in_noise(late) if wanders else late
    if late.interrupted:
        return replace(forced, interrupted=True)
    least = TUNING.wandering if wanders and late.beside is None else 0.0
    return late if late.delay.any() and late.gain_over(forced) > least else forced


def _prepared(
    channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None
) -> tuple[Search, FreePath]:
    """Return the search, with the largest order that the data carry, or that foretells best, and its path."""
    begin = np.zeros(0, complex) if start is None else np.asarray(start, complex)
    if isinstance(order, int):
        search = Search(assumptions, begin, order, False)
        path = search.path(channels)
        path.check(order)
        return search, path
    search = Search(assumptions, begin, assumptions.max_order, True)
    path = search.path(channels)
    path.check(1)
    search = replace(search, most=min(search.most, path.carried))
    if assumptions.criterion == "holdout":
        foretelling = foretelling_order(channels, begin, search.most, search.path)
        search = replace(search, most=foretelling, automatic=False)
    return search, path


def _in_white_noise_and_beside(
    channels: Experiments, search: Search, path: FreePath, start: ComplexArray | None
) -> tuple[FreeFit, FreeFit, InNoise]:
    """Return the fit in white noise, that in the likeliest other noise, and what makes one of the other.

    Both begin with the path through modes, or with what predicts best, as is likelier.  Of a number of modes that is
    given what predicts is only looked at where these leave more than white noise.
    """
    late, begun = _late(channels, search) if start is None else None, None
    is_open = start is None and late is None
    known = search.along(path, channels) if is_open and not search.automatic else None
    if is_open and (known is None or not (known.interrupted or known.leaves_white_noise)):
        shown, gain = predicted_lateness(channels, search)
        # outputs far from an input seem late, though none of the modes is
        common = replace(shown, outputs=np.full_like(shown.outputs, shown.outputs.min()))
        begun = in_prevailing_noise(channels, search, common)
        if begun is not None and begun.stands:
            return begun.fit, begun.forced, _noise_beside(begun.fit, path, search, start)
        late = of_predicted_delay(channels, search, shown, gain)
        if begun is not None and late is None and not may_be_white(channels, search, common, begun.forced.criteria.bic):
            return begun.fit, begun.forced, _noise_beside(begun.fit, path, search, start)
    fit = _or_likelier(late or known or search.along(path, channels), path, search, start)
    in_noise = _noise_beside(fit, path, search, start)
    forced = fit if fit.interrupted else _beside_noise(fit, in_noise, search)
    if begun is None or forced.interrupted or min(begun.forced.gain_over(each) for each in (fit, forced)) <= 0:
        return fit, forced, in_noise
    return begun.fit, begun.forced, in_noise


def _late(channels: Experiments, search: Search) -> FreeFit | None:
    """Return the fit with dead times of inputs, or of a lag, where records begin to show it; None without."""
    several = search.assumptions.inputs_may_be_late(channels)
    return of_late_inputs(channels, search) if several else of_late_lag(channels, search)


def _beside_noise(fit: FreeFit, in_noise: InNoise, search: Search) -> FreeFit:
    """Return the fit in noise of another kind, or that beside drifts of outputs in place of slow poles, if likelier."""
    forced = in_noise(fit)
    if not (search.assumptions.drifting and not fit.per_entry and are_slow(fit).any()) or forced.interrupted:
        return forced
    try:
        drifting = beside_drift(fit, search.anew(fit))
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    if drifting.offset == fit.offset:
        return forced
    drifting, least = in_noise(drifting), 0.0 if forced.beside is None else 2 * TUNING.sure
    if drifting.interrupted or drifting.gain_over(forced) < least:
        return replace(forced, interrupted=drifting.interrupted)
    return fit if drifting.beside is None else drifting


def _or_in_residual_noise(fit: FreeFit, path: FreePath, open_delay: bool, search: Search) -> FreeFit:
    """Return a fit of a given order, or the likelier one in the noise that residuals of the path show at each output.

    Poles that grow may be what is too many for the plant, in white noise of what is slow in the noise.
    """
    filters = () if path.best is None or fit.interrupted else path.noise_filters(path.best)
    if not filters:
        return fit
    coloured = _beside_all_else(_in_own_noise(fit, filters, search).with_delay_open(open_delay), search)
    return coloured if coloured.interrupted or coloured.gain_over(fit) > 0 else fit


def _or_in_own_noise(fit: FreeFit, forced: FreeFit, search: Search) -> tuple[FreeFit, FreeFit, FreeFit | None]:
    """Return both fits in the noise of each output that the errors of the latter show, if that is likelier.

    Beside them that in such noise, where it may yet be likelier with a delay.
    """
    if not forced.own_noise:
        return fit, forced, None
    if forced.own_likelier:
        if not search.automatic or fit.noise:
            return fit, forced, None
        slow = _in_slow_noise(fit, forced.own_noise, search)
        better = slow.interrupted or forced.beside is None or slow.gain_over(forced) > 0
        return (slow, slow, None) if better else (fit, forced, slow)
    coloured = _likelier_in_own_noise(forced, search) if forced.beside and forced.beside.is_coloured else None
    return (fit, forced, None) if coloured is None else (coloured, coloured, None)


def _in_slow_noise(fit: FreeFit, filters: tuple[Array, ...], search: Search) -> FreeFit:
    """Return the fit in coloured noise of each output, or beside the drift that looks like it, if likelier."""
    drifting = fit
    if search.assumptions.drifting:
        try:
            drifting = beside_drift(fit, search.anew(fit))
        except KeyboardInterrupt:
            return replace(fit, interrupted=True)
    coloured = _in_own_noise(fit, filters, search)
    return drifting if drifting.gain_over(coloured) > 0 and not coloured.interrupted else coloured


def _or_likelier(fit: FreeFit, path: FreePath, search: Search, start: ComplexArray | None) -> FreeFit:
    """Return the fit at the end of a path, or those to responses that begin otherwise and are likelier."""
    given = search.assumptions
    if given.weighted and start is None and not fit.windowed:
        fit = _from_peaks(fit, path, search)
    if search.automatic and given.real_poles in ("auto", 0) and not fit.interrupted:
        fit = _of_few_lines(fit, path, min(given.max_order, path.carried))
    return fit


def _noise_beside(fit: FreeFit, path: FreePath, search: Search, start: ComplexArray | None) -> InNoise:
    """Return what makes the fit in noise of another kind, of as many modes as are open; the fit itself if all are."""
    if search.automatic and fit.order >= search.most:
        return partial(alone, orders=Orders())  # what modes that are missing leave says nothing of the noise
    if search.automatic:
        orders = replace(search.orders, most=min(search.assumptions.max_order, path.carried))
    else:
        orders = search.orders if start is None else Orders()
    return partial(search.assumptions.beside, orders=orders)


def _beside_all_else(fit: FreeFit, search: Search) -> FreeFit:
    """Return the fit with what its data show beside modes: noise of responses that varies, or drifts and delays."""
    weighted = search.assumptions.weighted
    if fit.interrupted or fit.exact or (fit.per_entry and weighted):
        return fit
    try:
        if fit.windowed:
            return in_noise_of_the_window(fit, search)
        # what crowded modes leave is no noise whose law could be told
        if fit.crowded or not (fit.states or fit.noise):
            return fit
        return in_noise_of_the_gain(fit, search) if fit.per_entry else _beside_drifts_and_delays(fit, search)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)


def _beside_drifts_and_delays(fit: FreeFit, search: Search) -> FreeFit:
    """Return the fit beside the drifts of outputs, where these may drift, and with the delays that are open."""
    drifting, dead = search.assumptions.drifting, search.assumptions.inputs_may_be_late(fit.channels)
    anew = search.anew(fit)
    level = beside_drift(fit, anew) if drifting else fit
    late = level
    if fit.delay_open and not (dead and fit.input_delay.any()):
        late = (with_dead_times(level, anew, search) if dead else None) or on_time(level, search)
    if not drifting:
        return late
    # poles that stand for a delay may hide a drift
    if late is not level and late.offset < 2:
        late = beside_drift(late, search.anew(late) if late.input_delay.any() else anew)
    return with_constants(late)


def _in_likelier_rows(forced: FreeFit, changed: FreeFit, in_noise: InNoise, search: Search) -> FreeFit:
    """Return the fit in noise that outputs share, in rows with drifts or delays if white noise shows likelier ones."""
    if changed.interrupted:
        return replace(forced, interrupted=True)
    if changed.offset > forced.offset or np.any(changed.delay != forced.delay):
        again = in_noise(changed)
        if again.gain_over(forced) > 2 * TUNING.sure:
            return again
    return with_constants(forced) if search.assumptions.drifting else forced


def _from_peaks(fit: FreeFit, path: FreePath, search: Search) -> FreeFit:
    """Fit from the poles that responses show where all lines weigh the same, if that is likelier.

    Weighted by its gain, a response is equally large everywhere: its resonances do not stand out in a search for poles.
    """
    channels: Any = fit.channels
    if not fit.per_entry or fit.interrupted or fit.crowded or path.best is None or path.is_white(path.best):
        return fit
    if all(np.ptp(channel.weights[channel.observed]) == 0 for channel in channels):
        return fit
    alike = [replace(channel, weights=np.where(channel.observed, 1.0, channel.weights)) for channel in channels]
    p = search.along(search.path(alike), alike).projection.p
    other = search.along(search.path(channels), channels, p)
    return other if other.criteria.bic < fit.criteria.bic else fit


def _in_own_noise(fit: FreeFit, filters: tuple[Array, ...], search: Search) -> FreeFit:
    """Fit modes that grow together with coloured noise of each output, if that is likelier.

    Beside constants where the order is open: in white noise slow poles may have stood for them.
    """
    path = search.path(fit.channels, terms=None if search.automatic else fit.offset)
    path.whiten(filters, path.power)
    again = search.along(path, fit.channels)
    return again if again.interrupted or again.gain_over(fit) > 0 else fit


def _likelier_in_own_noise(forced: FreeFit, search: Search) -> FreeFit | None:
    """Fit the modes of a fit beside forces in coloured noise of each output instead; None if that is less likely."""
    coloured = _with_own_noise(forced, search)
    return coloured if coloured.interrupted or coloured.gain_over(forced) >= 0 else None


def _with_own_noise(forced: FreeFit, search: Search) -> FreeFit:
    """Fit the modes of a fit beside forces in coloured noise of each output instead."""
    path = search.path(forced.channels, forced.lateness, forced.offset, forced.intersample)
    path.whiten(forced.own_noise, path.power)
    try:
        model = path.in_its_noise(path.model(forced.projection.p))
        # a mode that forces alone moved was that of the noise
        while search.automatic and len(model.p):
            weakest = int(np.argmin(evidence_of(path, model)))
            fewer = path.in_its_noise(path.model(np.delete(model.p, weakest)))
            if path.cost(fewer) > path.cost(model):
                break
            model = fewer
    except KeyboardInterrupt:
        return replace(forced, interrupted=True)
    return finished(path, model, forced.channels)


def _late_beside_forces(forced: FreeFit, in_noise: InNoise, search: Search) -> FreeFit:
    """Return a fit beside forces, or one with a delay that leaves traces, or heavily damped modes in its place.

    It is looked for in coloured noise of each output, and stays if that is likelier.
    """
    on_time = not (forced.interrupted or forced.delay.any() or forced.input_delay.any())
    is_open = search.assumptions.delay is None and search.automatic and on_time
    if not (is_open and forced.own_noise and (are_heavy(forced.projection.p).any() or may_be_late(forced))):
        return forced
    late = _with_own_noise(forced, search)
    late = late if late.interrupted else _beside_all_else(late.with_delay_open(True), search)
    if late.interrupted:
        return replace(forced, interrupted=True)
    if not (late.delay.any() or late.input_delay.any()):
        return forced
    trials = [forced, late, in_noise(late)]
    if trials[-1].beside is None:  # noise of outputs may have modes that forces do without
        try:
            white = search.anew(replace(late, noise=()))(late.lateness, late.offset, forced.projection.p)
        except KeyboardInterrupt:
            return replace(forced, interrupted=True)
        trials.append(in_noise(white))
    if trials[-1].interrupted:
        return replace(forced, interrupted=True)
    best = max(trials, key=lambda fit: fit.gain_over(forced))
    return forced if best is forced else replace(best, delay_gain=0.5 * best.gain_over(forced))


def _of_few_lines(fit: FreeFit, whole: FreePath, most: int) -> FreeFit:
    """Fit few points of responses at the poles that real shapes of damping that decouples ask for, if likelier.

    Where few points show as many residues of any phase, these are too many numbers for the criterion to grant.
    """
    best: FreeModel | None = None
    cost = np.inf
    try:
        for few in _searches_of_few_lines(whole):
            model = _significant(few, chosen(few, np.zeros(0, complex), most, True))
            if few.cost(model) < min(cost, fit.criteria.by_name(few.options.criterion)):
                best, cost, path = model, few.cost(model), few
        if best is None:
            return fit
        rows = [replace(response, classical=False) for response in path.search.data]
        free = path.elsewhere(Responses(rows, False))
        judged = finished(free, free.model(best.p), fit.channels)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    return replace(judged, order_table=tuple(path.table[n] for n in sorted(path.table)))


def _searches_of_few_lines(path: FreePath) -> list[FreePath]:
    """Begin searches for modes with real shapes among responses of few points, without and with a background."""
    if not isinstance(path.search, Responses) or path.search.shows_background(_FEW_MODES):
        return []
    if any(response.quantity == "free" for response in path.search.data):
        return []
    rows = [replace(response, classical=True) for response in path.search.data]
    return [
        path.elsewhere(Responses(each, False), real_poles=0, largest=None)
        for each in (rows, [response.beside_modes_outside() for response in rows])
    ]


def _significant(path: FreePath, model: FreeModel) -> FreeModel:
    """Drop modes of a model that noise alone might show somewhere, the weakest dropped first."""
    each = path.search.unknowns(1) - path.search.unknowns(0)
    while len(model.p):
        evidence, loss = evidence_of(path, model), float(np.sum(model.losses * path.sizes**2))
        weakest, spare = int(np.argmin(evidence)), path.counts.sum() - path.search.unknowns_of(model.p)
        ratio = evidence[weakest] / loss * spare / each if loss > 0 else np.inf
        if spare > 0 and f_law.sf(ratio, each, spare) * path.counts.sum() < TUNING.by_chance:
            break
        model = path.model(np.delete(model.p, weakest))
    return model


def _with_real_poles(channels: Experiments, order: int, assumptions: Assumptions, fitted: Fit) -> FreeFit:
    """Fit a number of modes, pairs of real poles among them, with further real poles if these are likelier.

    They are looked for where modes alone leave what is no noise, or have no peak, as a pair of real poles has none.
    Modes that overlap may be fewer, as a search has them all at once.
    """
    fit = fitted(channels, order, replace(assumptions, real_poles=0), None)
    if fit.interrupted or fit.rounding:
        return fit
    if not are_broad(fit.projection.p).any() and is_white(fit.projection):
        return fit
    open_order = replace(assumptions, max_order=min(order, assumptions.max_order))
    # first under the circumstances that there are
    same = replace(open_order, delay=fit.delay, input_delay=fit.input_delay, intersample=fit.intersample, beside=alone)
    trial = fitted(channels, "auto", same, fit.projection.p)
    if trial.interrupted:
        return replace(fit, interrupted=True)
    if not count_real_poles(trial.projection.p) or trial.gain_over(fit) <= 0:
        return fit
    wider = fitted(channels, "auto", open_order, None)
    real = count_real_poles(wider.projection.p)
    fewer = order - real // 2 - wider.order
    if wider.interrupted:
        return replace(fit, interrupted=True)
    if not real:
        return fit
    if fewer > 0 and not wider.crowded:
        wider = fitted(channels, order - real // 2, replace(assumptions, real_poles=real), wider.projection.p)
    return fit if wider.interrupted else max(fit, trial, wider, key=lambda likely: likely.gain_over(fit))


def _of_long(
    channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None, fitted: Fit
) -> FreeFit:
    """Fit modes to a part of long records, and refine them over longer and longer ones, up to all samples."""
    part = [searched_part(channel, not assumptions.moving) for channel in channels]
    parts = [cut(channel, span) for channel, span in zip(channels, part, strict=True)]
    fit = fitted(parts, order, replace(assumptions, beside=alone, white=False), start)
    if fit.interrupted:
        return fit
    largest = None if isinstance(order, int) else assumptions.max_order
    best, path = FreeModel(fit.projection, [], fit.projection.losses * fit.scales**2), None
    while path is None or any(
        span.stop - span.start < channel.samples for span, channel in zip(part, channels, strict=True)
    ):
        part = [next(stages(span, channel.samples), span) for span, channel in zip(part, channels, strict=True)]
        longer = [cut(channel, span) for channel, span in zip(channels, part, strict=True)]
        path = _path_as_of(fit, longer, assumptions, largest, best)
        projection = path.refined(best.p, TUNING.rough, None)
        path.best = best = FreeModel(projection, [], path.in_data(projection.losses), path.search)
    whole = end_of_search(path, best.p, len(best.p), False, channels, either_hold=assumptions.intersample == "auto")
    whole = whole.with_rival(lambda rival: replace(rival, order_table=fit.order_table))
    return replace(
        whole, order_table=fit.order_table, findings=fit.findings, delay_gain=fit.delay_gain
    ).with_delay_open(fit.delay_open)


def _in_changing_noise(
    channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None, fitted: Fit
) -> FreeFit:
    """Fit modes to spans of one level of recordings whose noise changes, and refine them over all samples.

    Plants at rest before the recordings, which are in motion where others of the spans begin, are looked for in the
    noise of all of them.
    """
    recordings = [channel for channel in channels if isinstance(channel, Recording)]
    moving = assumptions.moving
    spans = [part for data in recordings for part in (_spans_of_one_level(data) if moving else [data.of_one_level])]
    fit = fitted(spans, order, replace(assumptions, beside=alone, white=False), start)
    path = _path_as_of(fit, channels, assumptions)
    path.table = {row.order: row for row in fit.order_table}
    model = FreeModel(fit.projection, [], path.power, path.search)
    if fit.interrupted:
        path.weigh(path.in_data(FreeProjection(path.scaled.data, fit.projection.p).losses))
        return replace(finished(path, model, channels, interrupted=True), interrupted=True)
    path.best = replace(model, losses=path.in_data(path.refined(fit.projection.p, TUNING.rough, None).losses))
    whole = end_of_search(
        path, fit.projection.p, fit.order, False, channels, either_hold=assumptions.intersample == "auto"
    )
    return replace(whole, findings=fit.findings, delay_gain=fit.delay_gain).with_delay_open(fit.delay_open)


def _path_as_of(
    fit: FreeFit, channels: Experiments, assumptions: Assumptions, largest: int | None = None,
    best: FreeModel | None = None,
) -> FreePath:  # fmt: skip
    """Begin a search in other channels, with the hold, offset, delays and noise of a fit."""
    form = RowOptions(
        assumptions.quantities, fit.intersample, fit.offset, assumptions.moving, assumptions.method, fit.lateness,
        fit.direct,
    )  # fmt: skip
    options = SearchOptions(assumptions.criterion, assumptions.reports, assumptions.real_poles, largest=largest)
    return FreePath.of(channels, form, options, best, fit.noise)


def _spans_of_one_level(recording: Recording) -> list[Recording]:
    """Return recordings of the spans in which noise has one level, but for those too short to be searched.

    Spans end at different samples where outputs change by themselves.
    """
    ends = [0, *recording.changes.tolist(), recording.samples]
    return [
        cut(recording, slice(first, last)) for first, last in pairwise(ends)
        if last - first >= min(_SHORTEST_SPAN, max(np.diff(ends)))
    ]  # fmt: skip

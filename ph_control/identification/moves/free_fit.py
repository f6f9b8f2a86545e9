"""From recordings or response matrices to the damped modes, with any residues, that are most likely.

One mode after the other joins where it explains most of what is left of all channels together, all are refined
jointly, and each output counts by the variance of its own noise, which is estimated along with them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray
from ..data.channels import Recording, ResponseMatrix
from ..data.time_record import is_long
from ..growth.held_out import foretelling_order
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments
from ..search.criteria import Orders
from ..search.fitted_modes import FreeFit, count_modes, count_real_poles
from ..search.path import FreePath
from .assumptions import Assumptions, Search, alone
from .delays import are_heavy, may_be_late, of_late_lag, of_predicted_delay, on_time, predicted_lateness
from .drifts import beside_drift, with_constants
from .gain_noise import in_noise_of_the_gain
from .late_inputs import of_late_inputs, with_dead_times
from .long_records import in_changing_noise, of_long
from .prevailing_noise import InNoise, beside_forces_and_more, in_prevailing_noise
from .second_searches import from_peaks, in_own_noise, likelier_in_own_noise, of_few_lines, with_real_poles
from .single_lines import without_lines_in_error
from .window_noise import in_noise_of_the_window, with_first_errors


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
    fit = _fitted(channels, order, given, start)
    grows = np.any(fit.projection.p.real > TUNING.slowest_growth * fit.region.bin)
    # a pole that grows may stand for a part of what is more than white noise
    if start is None and grows and not (fit.interrupted or fit.leaves_white_noise):
        return _or_of_decaying_poles(fit, channels, order, given)
    return fit


def _or_of_decaying_poles(fit: FreeFit, channels: Experiments, order: int | str, given: Assumptions) -> FreeFit:
    """Return the fit, or that whose poles may not grow, where that is likelier."""
    try:
        steady = _fitted(channels, order, replace(given, growing=False), None)
    except KeyboardInterrupt:
        return replace(fit, interrupted=True)
    if steady.interrupted:
        return replace(fit, interrupted=True)
    share = fit.projection.rows / steady.projection.rows
    return steady if steady.criteria.bic * share < fit.criteria.bic else fit


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
        fit = search.anew(replace(like, channels=tuple(channels)))(like.lateness, like.offset, p)
    except KeyboardInterrupt:
        return replace(like, interrupted=True)
    return fit if like.beside is None else given.beside(fit, orders=Orders())


def _fitted(channels: Experiments, order: int | str, assumptions: Assumptions, start: ComplexArray | None) -> FreeFit:
    """Fit modes the way that the data and the order ask for: by parts, twice, without some lines, or directly."""
    if is_long(channels):
        return of_long(channels, order, assumptions, start, _fitted)
    if any(isinstance(channel, Recording) and len(channel.changes) for channel in channels):
        return in_changing_noise(channels, order, assumptions, start, _fitted)
    if assumptions.real_poles == "auto" and isinstance(order, int):
        if start is None:
            return with_real_poles(channels, order, assumptions, _fitted)
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
        forced = beside_forces_and_more(forced, fit, search, may_be_late=open_delay)
        if slow is not None:
            return _or_late(forced, slow, search)
        # modes are told from forces, which may stand for lags that come late
        lags = assumptions.delay is None and bool(np.all(are_heavy(forced.projection.p)))
        return _or_late(forced, fit, search) if lags or (open_delay and not search.automatic) else forced
    in_white_noise = _beside_all_else(fit.with_delay_open(open_delay), search)
    return in_white_noise if forced.beside is None else _in_likelier_rows(forced, in_white_noise, in_noise, search)


def _or_late(forced: FreeFit, fit: FreeFit, search: Search) -> FreeFit:
    """Return the fit beside forces, or another with a delay in white noise or that of each output, if it is likelier.

    Of a number of poles that is given none can stand for the delay, and forces may.
    """
    if forced.interrupted:
        return forced
    late = _beside_all_else(fit.with_delay_open(search.assumptions.delay is None), search)
    if late.interrupted:
        return replace(forced, interrupted=True)
    share = forced.projection.rows / late.projection.rows
    return late if late.delay.any() and late.criteria.bic * share < forced.criteria.bic else forced


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

    Both begin with the path through modes, or with what predicts best, as is likelier.
    """
    late, begun = None, None
    if start is None:
        several = search.assumptions.inputs_may_be_late(channels)
        late = of_late_inputs(channels, search) if several else of_late_lag(channels, search)
    if start is None and late is None:
        shown, gain = predicted_lateness(channels, search)
        # outputs far from an input seem late, though none of the modes is
        common = replace(shown, outputs=np.full_like(shown.outputs, shown.outputs.min()))
        begun = in_prevailing_noise(channels, search, common)
        if begun is not None and begun.stands:
            return begun.fit, begun.forced, _noise_beside(begun.fit, path, search, start)
        late = of_predicted_delay(channels, search, shown, gain)
    fit = _or_likelier(late or search.along(path, channels), path, search, start)
    in_noise = _noise_beside(fit, path, search, start)
    forced = fit if fit.interrupted else in_noise(fit)
    if begun is None or forced.interrupted or begun.forced.criteria.bic >= min(fit.criteria.bic, forced.criteria.bic):
        return fit, forced, in_noise
    return begun.fit, begun.forced, in_noise


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
        better = slow.interrupted or forced.beside is None or slow.criteria.bic < forced.criteria.bic
        return (slow, slow, None) if better else (fit, forced, slow)
    coloured = likelier_in_own_noise(forced, search) if forced.beside and forced.beside.is_coloured else None
    return (fit, forced, None) if coloured is None else (coloured, coloured, None)


def _in_slow_noise(fit: FreeFit, filters: tuple[Array, ...], search: Search) -> FreeFit:
    """Return the fit in coloured noise of each output, or beside the drift that looks like it, if likelier."""
    drifting = fit
    if search.assumptions.drifting:
        try:
            drifting = beside_drift(fit, search.anew(fit))
        except KeyboardInterrupt:
            return replace(fit, interrupted=True)
    coloured = in_own_noise(fit, filters, search)
    return drifting if drifting.criteria.bic < coloured.criteria.bic and not coloured.interrupted else coloured


def _or_likelier(fit: FreeFit, path: FreePath, search: Search, start: ComplexArray | None) -> FreeFit:
    """Return the fit at the end of a path, or those to responses that begin otherwise and are likelier."""
    given = search.assumptions
    if given.weighted and start is None and not fit.windowed:
        fit = from_peaks(fit, path, search)
    if search.automatic and given.real_poles in ("auto", 0) and not fit.interrupted:
        fit = of_few_lines(fit, path, min(given.max_order, path.carried))
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
    if fit.interrupted or fit.rounding or (fit.per_entry and weighted):
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
        late = (with_dead_times(level, anew, search) if dead else None) or on_time(level, anew)
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
        share = forced.projection.rows / again.projection.rows
        if again.criteria.bic * share < forced.criteria.bic - 2 * TUNING.sure:
            return again
    return with_constants(forced) if search.assumptions.drifting else forced

"""Single lines of responses that are wild, or in error, as values of their own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ...exceptions import IdentificationError
from ..data.channels import ResponseMatrix
from ..regression.free import FreeProjection
from ..regression.frequency_rows import FreeResponse
from ..search.channel_rows import Experiments
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit, count_real_poles
from ..uncertainty.residual_tests import is_white
from .assumptions import Assumptions, Fit, alone
from .gain_noise import relative_weights, weighted_bic

Place = tuple[int, int]  # an experiment and a line of it

_ABOUT = 4  # lines on either side, whose median a wild line is so many times as large as
_WILD = 20.0
_HARDLY_MORE = 4.0  # times the squares that a fit without some lines leaves
_EXPLAINED = 0.5  # of a value at a line: what modes that explain it may leave
_FEW_WILD = 3  # lines, or a few in a thousand: more are no accident


def without_lines_in_error(
    responses: Sequence[ResponseMatrix],
    order: int | str,
    assumptions: Assumptions,
    start: ComplexArray | None,
    fitted: Fit,
) -> FreeFit:
    """Fit modes to responses, without lines that are wild, or in error, if they are better values of their own."""
    sure = replace(assumptions, doubted=False, beside=alone)

    def among(
        channels: Experiments, start: ComplexArray | None, order: int | str = order,
        real_poles: int | str = assumptions.real_poles,
    ) -> FreeFit:  # fmt: skip
        return fitted(channels, order, replace(sure, real_poles=real_poles), start)

    wild = [_wild_lines(data) for data in responses]
    if any(map(len, wild)):
        return _with_or_without(wild, responses, among, start)
    return _without_errors(among(responses, start), responses, among)


def _with_or_without(
    wild: Sequence[Indices], channels: Experiments, among: Callable[..., FreeFit], start: ComplexArray | None
) -> FreeFit:
    """Fit all lines of responses, or without those that are wild, if they are better values of their own."""
    calm = among(_without_lines(channels, wild), start)
    if not calm.interrupted:
        whole = among(channels, calm.projection.p)
        explained = whole.order <= calm.order and _explains(whole, calm, wild)
        if explained or not _is_likelier_without(whole, calm, wild):
            return whole
    return _leaving_out(calm, wild)


def _wild_lines(response: ResponseMatrix) -> Indices:
    """Return the places of lines that are far larger than the lines about them in some entry, unless many are.

    In units of their standard errors, where the weights give these.
    """
    size = np.abs(response.response * np.sqrt(response.weights)).reshape(-1, response.samples)
    wild = np.zeros(response.samples, bool)
    for each in size:
        seen = np.flatnonzero(each == each)
        if len(seen) <= 2 * _ABOUT:
            continue
        padded = np.pad(each[seen], _ABOUT, mode="reflect")
        about = np.delete(np.lib.stride_tricks.sliding_window_view(padded, 2 * _ABOUT + 1), _ABOUT, axis=1)
        wild[seen] |= each[seen] > _WILD * np.median(about, axis=1)
    return np.flatnonzero(wild) if 0 < wild.sum() <= max(_FEW_WILD, _ABOUT * len(wild) // 1000) else np.zeros(0, int)


def _without_lines(channels: Experiments, lines: Sequence[Indices]) -> list[ResponseMatrix]:
    responses = []
    for channel, places in zip(channels, lines, strict=True):
        assert isinstance(channel, ResponseMatrix)
        response = channel.response.copy()
        response[..., places] = np.nan
        responses.append(replace(channel, response=response))
    return responses


def _explains(whole: FreeFit, calm: FreeFit, lines: Sequence[Indices]) -> bool:
    """Return whether a fit to all lines explains the values at some, and all others hardly worse than one without.

    Values of few digits next to a resonance may be off by more than the noise of all others, and still belong to it.
    There is no resonance at a frequency of 0.
    """
    if any(np.any(data.omega[far] == 0) for data, far in zip(whole.channels, lines, strict=True)):
        return False
    for rows, predicted in zip(whole.projection.experiments, whole.projection.predictions(), strict=True):
        if isinstance(rows, FreeResponse):
            far = lines[rows.experiment]
            if np.any(np.abs(rows.response - predicted)[:, far] > _EXPLAINED * np.abs(rows.response[:, far])):
                return False
    losses = []
    for fit in (whole, calm):
        losses.append(0.0)
        for rows, predicted in zip(fit.projection.experiments, fit.projection.predictions(), strict=True):
            if isinstance(rows, FreeResponse):
                others = calm.channels[rows.experiment]
                weights = np.where(others.observed, others.weights, 0.0).reshape(-1, others.samples)[rows.outputs]
                size = np.abs(rows.response - predicted) * fit.scales[rows.outputs, None]
                losses[-1] += float(np.nansum(weights * size**2))
    return losses[0] <= _HARDLY_MORE * losses[1]


def _without_errors(whole: FreeFit, channels: Sequence[ResponseMatrix], among: Callable[..., FreeFit]) -> FreeFit:
    """Leave out values that are errors of single lines, where these made a mode, or broadened one.

    A mode that only one line asks for has more unknowns than a value of its own.  Next to a resonance an error looks
    like damping, and residuals are not white: there a line is left out only if nothing else was wrong.
    """
    projection = whole.projection
    if whole.interrupted or whole.rounding or whole.crowded or not len(projection.p):
        return whole

    def leaving(places: Collection[Place], **how: Any) -> FreeFit:
        lines = [np.array(sorted(line for k, line in places if k == j), int) for j in range(len(channels))]
        try:
            calm = among(_without_lines(channels, lines), **how)
        except IdentificationError:  # the other lines do not carry the modes
            return whole
        likelier = not calm.interrupted and _is_likelier_without(whole, calm, lines)
        return _leaving_out(calm, lines) if likelier else whole

    single = _of_single_lines(whole, channels)
    if single:
        rest = np.delete(projection.p, list(single))
        return leaving(set(single.values()), start=rest) if len(set(single.values())) <= _FEW_WILD else whole
    if is_white(projection):
        return whole
    nearest = {
        (k, int(np.argmin(np.where(data.observed.any(axis=(0, 1)), np.abs(data.omega - d), np.inf))))
        for k, data in enumerate(channels) for d in projection.d[projection.p.imag > 0]
    }  # fmt: skip
    order: dict[str, int] = {"order": whole.order, "real_poles": count_real_poles(projection.p)}
    calm = leaving(nearest, **order, start=projection.p)
    if calm is whole or not is_white(calm.projection):
        return whole
    start = calm.projection.p
    fits = [leaving([each], **order, start=start) for each in sorted(nearest)]
    return min((fit for fit in fits if fit is not whole), key=weighted_bic, default=whole)


def _of_single_lines(fit: FreeFit, channels: Sequence[ResponseMatrix]) -> dict[int, Place]:
    """Return modes that the criterion takes for one line alone, each with its experiment and the line."""
    effects = _effects(fit.projection, channels)
    lines = [int(data.observed.sum()) for data in channels]
    places = {}
    for l in np.flatnonzero(fit.projection.p.imag > 0).tolist():
        k = int(np.argmax([part[l].max() for part in effects]))
        others = sum(float(part[l].sum()) for part in effects) - float(effects[k][l].max())
        if others < (2 + 2 * len(fit.scales)) * np.log(2 * sum(lines)):
            places[l] = (k, int(np.argmax(effects[k][l])))
    return places


def _effects(projection: FreeProjection, channels: Sequence[ResponseMatrix]) -> list[Array]:
    """Return the square of what each mode adds to each line of each experiment, all entries together."""
    effects = [np.zeros((len(projection.p), data.samples)) for data in channels]
    for rows in projection.experiments:
        assert isinstance(rows, FreeResponse)
        ahead, behind = rows.peaks(projection.p)[:2]
        for output in rows.outputs.tolist():
            r = projection.residues[:, output, 0][:, None]
            size = np.abs((r * ahead + r.conj() * behind) * rows.weight) ** 2
            effects[rows.experiment][:, rows.observed] += size
    return effects


def _is_likelier_without(whole: FreeFit, calm: FreeFit, lines: Sequence[Indices]) -> bool:
    """Return whether the BIC prefers values of their own at some lines to a fit to all."""
    return weighted_bic(whole) > weighted_bic(calm) + _cost_of_lines(whole, lines)


def _leaving_out(calm: FreeFit, lines: Sequence[Indices]) -> FreeFit:
    """Return the fit without some lines, with the finding that says so."""
    wild = [
        Finding(Cause.WILD_LINES, tuple(data.omega[places].tolist()), 0.0, experiment=k)
        for k, (data, places) in enumerate(zip(calm.channels, lines, strict=True)) if len(places)
    ]  # fmt: skip
    return replace(calm, findings=(*calm.findings, *wild))


def _cost_of_lines(whole: FreeFit, lines: Sequence[Indices]) -> float:
    """Return what it costs by the BIC to take the values at some lines as they are, in the noise of a fit to all lines.

    Two numbers for each value, and one at 0, where responses are real.
    """
    count, cost = 2 * sum(int(channel.observed.sum()) for channel in whole.channels), 0.0
    for channel, places in zip(whole.channels, lines, strict=True):
        variances = (whole.scales**2)[:, None] / relative_weights(channel)[:, places]
        numbers = np.where(channel.omega[places] == 0, 1, 2) * np.log(count)
        cost += float(np.sum(2 * np.log(2 * np.pi * variances) + numbers))
    return cost

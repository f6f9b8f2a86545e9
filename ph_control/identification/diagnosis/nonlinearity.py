"""What a plant does that is not linear: other modes in one half of the recordings, and multiples of modes in decays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations_with_replacement
from typing import Any

import numpy as np
from scipy.stats import chi2

from ..._types import Array, ComplexArray, Mask
from ..data.channels import Recording
from ..data.time_record import is_long
from ..regression.free import FreeProjection, refine_free
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import is_short
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit

_BY_CHANCE = 1e-4  # probability that a plant that does not change shows such a difference in any mode
_KNOWN = 0.3  # relative error of the decay rate of a mode in a half, beyond which nothing is said of it
_SHOWN = 10.0  # times the unknowns of a mode, in squares of standard errors: what a half has to show of it
_FEWEST = 6  # times the unknowns that a half has samples
_ROUGH = 1e-4  # relative decrease of the loss at which the refinement in a half ends
_NEAR = 0.005  # p-value from which on a pole is a multiple of others,
_SMALL = 0.2  # with so much of the amplitude of each of them at most
_ASIDE = 0.02  # relative error of the decay rate of a multiple, beyond which many would agree by chance


def not_linear(fit: FreeFit) -> list[Finding]:
    """Modes that differ between the halves of recordings, and multiples of modes in free motions."""
    channels, projection = fit.channels, fit.projection
    # what forces do in one half and not in the other is no sign of it
    unfit = fit.interrupted or fit.rounding or not fit.order or is_long(channels) or fit.beside is not None
    if unfit or fit.delay.any() or not all(isinstance(channel, Recording) for channel in channels):
        return []
    rows = [record for record in projection.experiments if isinstance(record, FreeRecord)]
    multiples = [] if projection.inputs else _multiples(fit)
    if projection.inputs and any(is_short(record) for record in rows):
        return multiples
    return multiples or _halves(fit, rows)


def _halves(fit: FreeFit, rows: Sequence[FreeRecord]) -> list[Finding]:
    """Modes whose poles in the first halves of recordings are not those in the second.

    Poles that are a step away from those of the whole tell whether any are; those of the halves are refined then.
    """
    p, fed = fit.projection.p, fit.projection.fed
    halves = [[_half(record, second) for record in rows] for second in (False, True)]
    if any(min(record.samples for record in half) < _FEWEST * fit.unknowns for half in halves):
        return []
    if not _apart([_known(FreeProjection(half, p, fed), fit) for half in halves], fit):
        return []
    ends = [_refined(half, fit) for half in halves]
    same = all(len(end.p) == len(p) and np.array_equal(end.p.imag > 0, p.imag > 0) for end in ends)
    return _apart([_known(end, fit) for end in ends], fit) if same else []


def _refined(rows: Sequence[FreeRecord], fit: FreeFit) -> FreeProjection:
    """Modes of a fit refined in some rows."""
    return refine_free(lambda _: rows, fit.projection.p, fit.region, _ROUGH, fit.projection.fed, last=False)


_Known = tuple[ComplexArray, Array, Mask]  # poles, covariance of their imaginary and real parts, and which are shown


def _known(projection: FreeProjection, fit: FreeFit) -> _Known:
    """Poles of half of the recordings, a step of Gauss and Newton from some, and how well they are known."""
    n, variance = len(projection.p), projection.loss / max(1, projection.rows - projection.unknowns)
    spread = projection.covariance(1.0)[: 2 * n, : 2 * n]
    slopes = projection.sections.pole_slopes
    step = -spread @ np.linalg.lstsq(slopes.T, projection.gradient, rcond=None)[0]
    # a mode that has decayed leaves its place to noise
    shown = (projection.p.imag > 0) & (projection.evidence > _SHOWN * variance * projection.unknowns / fit.order)
    return projection.p + step[n:] + 1j * step[:n], variance * spread, shown


def _apart(halves: Sequence[_Known], fit: FreeFit) -> list[Finding]:
    """Modes whose poles in two halves are further apart than chance."""
    (first, first_spread, _), (second, second_spread, _) = halves
    n, findings = len(first), list[Finding]()
    for l in np.flatnonzero(np.logical_and(*(shown for *_, shown in halves))).tolist():
        both = np.ix_([l, n + l], [l, n + l])
        errors = [(np.sqrt(max(spread[n + l, n + l], 0.0)), abs(poles[l].real)) for poles, spread, _ in halves]
        if any(error >= _KNOWN * rate for error, rate in errors):
            continue
        apart = np.array([(first - second)[l].imag, (first - second)[l].real])
        statistic = float(apart @ np.linalg.pinv((first_spread + second_spread)[both], hermitian=True) @ apart)
        if chi2.sf(statistic, 2) * fit.order < _BY_CHANCE:
            values = [abs(first[l]), abs(second[l]), *(-pole.real / abs(pole) for pole in (first[l], second[l]))]
            findings.append(Finding(Cause.CHANGING_MODE, tuple(map(float, values)), 0.5 * statistic))
    return findings


def _half(record: FreeRecord, second: bool) -> FreeRecord:
    """The first half of a record, or the second, in motion where that begins."""
    part = slice(record.length // 2, None) if second else slice(0, record.length // 2)
    return replace(
        record, u=record.u[:, part], y=record.y[:, part], observed=record.observed[part],
        level=None if record.level is None else record.level[part], moving=record.moving or second, whole_record=None,
    )  # fmt: skip


def _multiples(fit: FreeFit) -> list[Finding]:
    """Modes of free motions whose poles are sums of those of two or three stronger ones, of which one may be conjugate.

    A quadratic or cubic law of the spring or the sensor makes these of decays: both frequency and decay rate add up.
    """
    projection, n = fit.projection, len(fit.projection.p)
    p, covariance, sizes = projection.p, fit.covariance[: 2 * n, : 2 * n], _amplitudes(projection)
    modes, findings = np.flatnonzero(p.imag > 0), list[Finding]()
    for l in modes.tolist():
        known = covariance[n + l, n + l] < (_ASIDE * abs(p[l])) ** 2
        strong = [k for k in modes.tolist() if sizes[l] < _SMALL * sizes[k]] if known else []
        likely = 0.0
        for plus, minus in _combinations(strong):
            T = np.zeros((2, 2 * n))
            T[[0, 1], [l, n + l]] = 1.0
            for k, sign in (*((k, 1.0) for k in plus), *((k, -1.0) for k in minus)):
                T[[0, 1], [k, n + k]] -= sign, 1.0
            apart = T @ np.concatenate([p.imag, p.real])
            p_value = float(chi2.sf(apart @ np.linalg.pinv(T @ covariance @ T.T, hermitian=True) @ apart, 2))
            if p_value > max(_NEAR, likely):
                likely, made = p_value, (*(abs(p[k]) for k in plus), *(-abs(p[k]) for k in minus))
        if likely:
            findings.append(Finding(Cause.MULTIPLE, tuple(map(float, (abs(p[l]), *made))), 0.0))
    return findings


def _combinations(modes: Sequence[int]) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Two or three modes whose frequencies are added, and those of them that are subtracted: at most one."""
    for plus in chain.from_iterable(combinations_with_replacement(modes, count) for count in (1, 2, 3)):
        if len(plus) > 1:
            yield plus, ()
        if len(plus) < 3:
            yield from ((plus, (k,)) for k in modes if k not in plus)


def _amplitudes(projection: FreeProjection) -> Array:
    """Largest amplitude of the free motion of each mode in any output and experiment, beside the noise of that."""
    n = len(projection.p)
    motions: list[Any] = [own[:n] + 1j * own[n : 2 * n] for own in projection.own]
    joined: ComplexArray = np.concatenate(motions, axis=1)
    return np.asarray(np.abs(joined).max(axis=1, initial=0.0))

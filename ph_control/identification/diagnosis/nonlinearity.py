"""What a plant does that is not linear: other modes in one half of the recordings, and multiples of modes in decays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations_with_replacement
from typing import Any

import numpy as np
from scipy.stats import chi2

from ..._types import Array, ComplexArray
from ..data.channels import Recording
from ..data.parts import is_long
from ..regression.free import FreeProjection, refine_free
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import is_short
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit

_BY_CHANCE = 1e-4  # probability that a plant that does not change shows such a difference in any mode
_KNOWN = 0.3  # relative error of the decay rate of a mode in a half, beyond which nothing is said of it
_SHOWN = 10.0  # times the unknowns of a mode, in squares of standard errors: what a half has to show of it
_FEWEST = 6  # times the unknowns that a half has samples
_ROUGH = 1e-4  # relative decrease of the loss at which the refinement in a half ends,
_STEPS = 4  # or after so many
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
    """Modes whose poles in the first halves of recordings are not those in the second."""
    p = fit.projection.p
    halves = [[_half(record, second) for record in rows] for second in (False, True)]
    if any(min(record.samples for record in half) < _FEWEST * fit.unknowns for half in halves):
        return []
    each, shown = [], p.imag > 0
    for half in halves:
        projection = _refined(half, p, fit)
        if len(projection.p) != len(p) or np.any((projection.p.imag > 0) != (p.imag > 0)):
            return []
        variance = projection.loss / max(1, projection.rows - projection.unknowns)
        # a mode that has decayed leaves its place to noise
        shown &= projection.evidence > _SHOWN * variance * projection.unknowns / fit.order
        each.append((projection.p, projection.covariance(variance)))
    n, findings = len(p), []
    (first, first_spread), (second, second_spread) = each
    for l in np.flatnonzero(shown).tolist():
        both = np.ix_([l, n + l], [l, n + l])
        known = [np.sqrt(max(spread[n + l, n + l], 0.0)) < _KNOWN * abs(p[l].real) for _, spread in each]
        spread = first_spread[both] + second_spread[both]
        if not all(known):
            continue
        apart = np.array([(first - second)[l].imag, (first - second)[l].real])
        statistic = float(apart @ np.linalg.pinv(spread, hermitian=True) @ apart)
        if chi2.sf(statistic, 2) * fit.order < _BY_CHANCE:
            values = [abs(first[l]), abs(second[l]), *(-pole.real / abs(pole) for pole in (first[l], second[l]))]
            findings.append(Finding(Cause.CHANGING_MODE, tuple(map(float, values)), 0.5 * statistic))
    return findings


def _refined(rows: Sequence[FreeRecord], p: ComplexArray, fit: FreeFit) -> FreeProjection:
    """Modes of a fit refined in some rows."""
    return refine_free(lambda _: rows, p, fit.region, _ROUGH, fit.projection.fed, last=False, steps=_STEPS)


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

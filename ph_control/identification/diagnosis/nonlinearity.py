"""What a plant does that is not linear: other modes in one half of the recordings, and multiples of modes in decays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.stats import chi2

from ..._types import Array, ComplexArray
from ..data.channels import Recording
from ..data.parts import is_long
from ..regression.free import FreeProjection, refine_free
from ..regression.time_rows import FreeRecord
from ..search.circumstances import Cause, Finding
from ..search.modal_search import FreeFit, is_short

_BY_CHANCE = 1e-4  # probability that a plant that does not change shows such a difference in any mode
_KNOWN = 0.3  # relative error of the decay rate of a mode in a half, beyond which nothing is said of it
_SHOWN = 10.0  # times the unknowns of a mode, in squares of standard errors: what a half has to show of it
_FEWEST = 6  # times the unknowns that a half has samples
_STEPS = 4  # of the refinement in a half
_NEAR = 0.05  # p-value from which on a pole is a multiple of others,
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


def _refined_in(half: Sequence[FreeRecord], fit: FreeFit) -> FreeProjection:
    """The minimum in halves of recordings next to that in all."""
    p, fed = fit.projection.p, fit.projection.fed
    return refine_free(lambda _: half, p, fit.region, 1e-4, fed, last=False, steps=_STEPS)


def _halves(fit: FreeFit, rows: Sequence[FreeRecord]) -> list[Finding]:
    """Modes whose poles in the first halves of recordings are not those in the second."""
    p = fit.projection.p
    halves = [[_half(record, second) for record in rows] for second in (False, True)]
    if any(min(record.samples for record in half) < _FEWEST * fit.unknowns for half in halves):
        return []
    each, shown = [], p.imag > 0
    for half in halves:
        projection = _refined_in(half, fit)
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


def _half(record: FreeRecord, second: bool) -> FreeRecord:
    """The first half of a record, or the second, in motion where that begins."""
    part = slice(record.length // 2, None) if second else slice(0, record.length // 2)
    return replace(
        record, u=record.u[:, part], y=record.y[:, part], observed=record.observed[part],
        level=None if record.level is None else record.level[part], moving=record.moving or second, whole_record=None,
    )  # fmt: skip


def _multiples(fit: FreeFit) -> list[Finding]:
    """Modes of free motions that have twice or three times the pole of a stronger one, or sums of two.

    A quadratic or cubic law of the spring or the sensor makes these of decays: both frequency and decay rate add up.
    """
    projection, n = fit.projection, len(fit.projection.p)
    p, covariance, sizes = projection.p, fit.covariance, _amplitudes(projection)
    findings = []
    for l in np.flatnonzero(p.imag > 0).tolist():
        error = np.sqrt(max(covariance[n + l, n + l], 0.0))
        strong = [k for k in np.flatnonzero(p.imag > 0).tolist() if k != l and sizes[l] < _SMALL * sizes[k]]
        if error > _ASIDE * abs(p[l].imag):
            continue
        for terms in (*combinations_with_replacement(strong, 2), *combinations_with_replacement(strong, 3)):
            for signs in ((1,) * len(terms), (*(1,) * (len(terms) - 1), -1)):
                T = np.zeros((2, 2 * n))
                T[0, l], T[1, n + l] = 1.0, 1.0
                for k, sign in zip(terms, signs, strict=True):
                    T[0, k] -= sign
                    T[1, n + k] -= 1.0
                away = T @ np.concatenate([p.imag, p.real])
                # a difference of a mode and itself has no frequency
                if (
                    len({k for k, sign in zip(terms, signs, strict=True) if sign < 0} & set(terms[:-1]))
                    and min(signs) < 0
                ):
                    continue
                spread = T @ covariance[: 2 * n, : 2 * n] @ T.T
                if chi2.sf(float(away @ np.linalg.pinv(spread, hermitian=True) @ away), 2) > _NEAR:
                    parts = [float(sign * abs(p[k])) for k, sign in zip(terms, signs, strict=True)]
                    findings.append(Finding(Cause.MULTIPLE, (float(abs(p[l])), *parts), 0.0))
                    break
            else:
                continue
            break
    return findings


def _amplitudes(projection: FreeProjection) -> Array:
    """Largest amplitude of the free motion of each mode in any output and experiment, beside the noise of that."""
    n = len(projection.p)
    motions: list[Any] = [own[:n] + 1j * own[n : 2 * n] for own in projection.own]
    joined: ComplexArray = np.concatenate(motions, axis=1)
    return np.asarray(np.abs(joined).max(axis=1, initial=0.0))

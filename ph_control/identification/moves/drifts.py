"""Constants of outputs, and outputs that drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..._types import Mask, RealOrComplex
from ..growth.ending import evidence_of_constants, least_of_constants, order_of_noise
from ..regression.elimination import orthogonal, without
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from ..search.whitening import correlations, foretold
from .assumptions import Anew


def beside_drift(fit: FreeFit, anew: Anew) -> FreeFit:
    """Let outputs of a fit drift, where a line explains more than a slow mode or what is left.

    In noise as slow a constant may explain as much.
    """
    if not may_drift(fit):
        return fit
    slow = are_slow(fit)
    trial = anew(fit.lateness, 2, fit.projection.p[~slow])
    # a line in place of a slow pole is simpler
    least = 0.0 if slow.any() else 2 * TUNING.sure
    if trial.gain_over(fit) < least or _gain_of_drift(trial) < TUNING.sure:
        return fit
    again = anew(fit.lateness, 2, None)
    best = again if again.gain_over(trial) >= 0 else trial
    # slow poles may stand for a drift
    level = anew(fit.lateness, 1, fit.projection.p[~slow]) if slow.any() else fit
    if level.gain_over(best) > 0:
        return level
    gain = max(best.criteria.loglik - level.criteria.loglik, 0.5 * best.gain_over(fit))
    return replace(best, findings=(*fit.findings, drift_of(best, gain)), delay_gain=fit.delay_gain)


def may_drift(fit: FreeFit) -> bool:
    """Whether modes are as slow as a drift, or what is left of outputs leans."""
    records = [record for record in fit.projection.experiments if isinstance(record, FreeRecord)]
    pairs = zip(records, fit.projection.predictions(), strict=True)
    return bool(are_slow(fit).any()) or any(_leans(*pair) for pair in pairs)


def are_slow(fit: FreeFit) -> Mask:
    """Return which poles are so slow that a record shows them as a drift."""
    records = [record for record in fit.projection.experiments if isinstance(record, FreeRecord)]
    return np.asarray(fit.projection.d < TUNING.damped_apart * min((record.bin for record in records), default=0.0))


def drift_of(fit: FreeFit, gain: float) -> Finding:
    """Return the finding of the drifts of a fit, per unit time, with the log-likelihood that they gain."""
    drifts = [
        float(slope) for rows, own in zip(fit.projection.experiments, fit.projection.own, strict=True)
        if isinstance(rows, FreeRecord) for slope in fit.scales[rows.outputs] * own[-2] * rows.unit / rows.hold.h
    ]  # fmt: skip
    return Finding(Cause.DRIFT, tuple(drifts), gain)


def _gain_of_drift(fit: FreeFit) -> float:
    """Return the log-likelihood by which drifts explain more than constants, in noise as coloured as a fit leaves.

    Less half of what BIC charges.  Noise of slow colour leans by itself.
    """
    gain = 0.0
    for rows, own, predicted in zip(
        fit.projection.experiments, fit.projection.own, fit.projection.predictions(), strict=True
    ):
        if not isinstance(rows, FreeRecord):
            continue
        t, residuals = np.arange(float(rows.length)), rows.residuals(predicted)
        for residual, slope in zip(residuals, own[-2], strict=True):
            models, variances = foretold(correlations([np.fft.rfft(residual)], [rows.length]))
            past = np.concatenate([[1.0], -models[order_of_noise(rows.samples, variances)]])
            seen = np.convolve(~rows.observed, np.ones(len(past)))[: rows.length] == 0
            seen[: len(past) - 1] = False
            lines = np.stack([np.convolve(x, past)[: rows.length][seen] for x in (np.ones(rows.length), t)])
            drifting = np.convolve(residual + slope * t, past)[: rows.length][seen]
            squares = [float(np.sum(without(drifting[:, None], orthogonal(lines[:k].T)[0]) ** 2)) for k in (1, 2)]
            if squares[1] > 0:
                gain += 0.5 * len(drifting) * float(np.log(squares[0] / squares[1]))
            gain -= 0.5 * float(np.log(max(rows.samples, 2)))
    return gain


def _leans(rows: FreeRecord, predicted: RealOrComplex) -> bool:
    """Return whether a line explains some of what is left of outputs."""
    t = np.flatnonzero(rows.observed) - np.mean(np.flatnonzero(rows.observed))
    residuals = (rows.measured - predicted)[:, rows.observed]
    residuals = residuals - residuals.mean(axis=1, keepdims=True)
    share = (residuals @ t) ** 2 / np.maximum(np.sum(residuals**2, axis=1) * (t @ t), np.finfo(float).tiny)
    return bool(np.any(-0.5 * len(t) * np.log1p(-np.minimum(share, 0.5)) > TUNING.likely))


def with_constants(fit: FreeFit) -> FreeFit:
    """Return the fit with a finding of the constants of its outputs, if these stand out."""
    if fit.offset != 1 or (evidence := evidence_of_constants(fit.projection)) < least_of_constants(fit.projection):
        return fit
    values = [
        float(value) for rows, own in zip(fit.projection.experiments, fit.projection.own, strict=True)
        for value in fit.scales[rows.outputs] * own[-1] * getattr(rows, "unit", 1.0)
    ]  # fmt: skip
    finding = Finding(Cause.CONSTANT, tuple(values), 0.5 * evidence)
    return replace(fit, findings=(*fit.findings, finding))

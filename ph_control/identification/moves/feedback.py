"""Inputs that answer to the noise of outputs in the same sample, as those of a digital controller do.

What such an output seems to be fed, or an input that seems to be linear between its samples, is its own noise, which
its controller has seen.  It goes with what is new in the input, `w_k`, which the past does not foretell: in an
open loop a plant answers to that part of an input as to all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._types import Array
from ..._units import feels_force
from ..data.channels import Recording, bridged
from ..regression.free import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import experiments_of
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from .assumptions import Assumptions

_PAST = 10  # samples of inputs and outputs that foretell an input
_NEW = 0.9  # of an input: from there it is all new, and a plant that is fed through is not told from a feedback
_SIZES = 4.5, np.inf  # of what is new over its median: three standard deviations of what is normal, and any
_ALL = 0.99  # of the squares of errors that go with what is new, at most
_SAMPLE = 0.999  # of a sample: outputs that come later do not answer an input at once


def without_direct_answers(
    fit: FreeFit, given: Assumptions, again: Callable[[Assumptions], FreeFit], refined: Callable[[Assumptions], FreeFit]
) -> FreeFit:
    """Return the fit, or one in which no output answers an input at once, where inputs answer to its noise.

    Parameters
    ----------
    fit : FreeFit
        What was fitted to recordings.
    given : Assumptions
        Under which it was.
    again, refined : callable
        Fit the same data under others, anew and from the same poles.
    """
    if not given.direct or fit.interrupted or fit.rounding or not _answers_at_once(fit, given):
        return fit
    new = [_new_in_inputs(recording) for recording in fit.channels]
    if _are_all_new(new, fit):
        return fit
    given = replace(given, direct=False, intersample="zoh" if given.intersample == "auto" else given.intersample)
    near = refined(given)
    if not near.interrupted and not _may_be_likelier(near, fit, new):
        return fit
    causal = again(given)
    if causal.interrupted:
        return replace(fit, interrupted=True)
    # a reference that seldom jumps hides how an input answers between its jumps, and is all that a relay shows
    for size in _SIZES:
        direct, answers = (_Answers.of(each, new, size) for each in (fit, causal))
        if causal.gain_over(fit) + 2 * answers.gain > max(2 * direct.gain, direct.charge):
            output, correlation = answers.strongest
            finding = Finding(Cause.FEEDBACK, (correlation,), answers.gain, fit.channels[0].output_labels[output])
            return replace(causal, findings=(*causal.findings, finding))
    return fit


def _may_be_likelier(near: FreeFit, fit: FreeFit, new: Sequence[Array]) -> bool:
    """Whether a fit with the same poles is not far less likely, beside what is new in the inputs: others make up."""
    gain = near.gain_over(fit) + 2 * max(_Answers.of(near, new, size).gain for size in _SIZES)
    return gain > -TUNING.hopeless * fit.criteria.samples


def _are_all_new(new: Sequence[Array], fit: FreeFit) -> bool:
    """Whether nearly all of the inputs of recordings is new; short ones tell nothing."""
    every, unforeseen = 0.0, 0.0
    for recording, w in zip(fit.channels, new, strict=True):
        u = recording.u[:, _PAST : _PAST + w.shape[1]]
        every = every + np.sum((u - u.mean(axis=1, keepdims=True)) ** 2, axis=1) if w.size else every
        unforeseen = unforeseen + np.sum(w**2, axis=1)
    return bool(np.all(unforeseen >= _NEW * every))


def _answers_at_once(fit: FreeFit, given: Assumptions) -> bool:
    """Whether an output answers an input at once, which the data have shown; those that feel forces always do."""
    felt = any(map(feels_force, given.quantities or ()))
    if fit.per_entry or felt or not fit.projection.inputs:
        return False
    early = np.broadcast_to(fit.delay, fit.scales.shape) < _SAMPLE * fit.channels[0].dt
    linear = fit.intersample == "foh" and given.intersample == "auto"
    return bool(early.any() and linear) or bool(fit.projection.fed_through[early].any())


@dataclass(frozen=True)
class _Answers:
    """How prediction errors go with what is new in the inputs.

    Attributes
    ----------
    squares, counts : ndarray, shape (p,)
        Sum of squared errors of each output, and their number.
    products : ndarray, shape (p, m)
        Sums of products with what is new in the inputs, of the size that is usual.
    covariance : ndarray, shape (m, m)
        Sums of products of the latter.
    """

    squares: Array
    counts: Array
    products: Array
    covariance: Array

    @classmethod
    def of(cls, fit: FreeFit, new: Sequence[Array], size: float) -> _Answers:
        """Those of a fit to recordings with what is `new` in each, up to a size over its median."""
        p, m = (len(labels) for labels in (fit.channels[0].output_labels, fit.channels[0].input_labels))
        squares, counts, products, covariance = np.zeros(p), np.zeros(p), np.zeros((p, m)), np.zeros((m, m))
        for errors, w in zip(_errors(fit), new, strict=True):
            if not w.size:
                continue
            e, most = np.nan_to_num(errors[:, _PAST : _PAST + w.shape[1]]), size * np.median(np.abs(w), axis=1)
            w = np.clip(w.T, -most, most).T if np.isfinite(size) else w
            squares, counts = squares + np.sum(e**2, axis=1), counts + np.sum(e != 0, axis=1)
            products, covariance = products + e @ w.T, covariance + w @ w.T
        return cls(squares, counts, products, covariance)

    @cached_property
    def responses(self) -> Array:
        """What errors change by for a unit of what is new, (p, m)."""
        return np.asarray(self.products @ np.linalg.pinv(self.covariance, hermitian=True))

    @property
    def gain(self) -> float:
        """Log-likelihood by which what is new in the inputs explains more."""
        shares = np.sum(self.products * self.responses, axis=1) / np.where(self.squares > 0, self.squares, np.inf)
        return float(-0.5 * np.sum(self.counts * np.log1p(-np.minimum(shares, _ALL))))

    @property
    def charge(self) -> float:
        """What the BIC charges for as many responses."""
        return float(self.products.size * np.log(max(self.counts.sum(), 1.0)))

    @property
    def strongest(self) -> tuple[int, float]:
        """The output with the strongest correlation, and that."""
        sizes = np.sqrt(np.outer(self.squares, np.diag(self.covariance)))
        correlations = self.products / np.where(sizes > 0, sizes, np.inf)
        output, source = np.unravel_index(np.argmax(np.abs(correlations)), correlations.shape)
        return int(output), float(correlations[output, source])


def _errors(fit: FreeFit) -> list[Array]:
    """Prediction errors (p, T) of each recording, NaN where missing."""
    errors = [np.full(channel.y.shape, np.nan) for channel in fit.channels]
    every = np.arange(len(fit.scales))
    if fit.beside is not None:
        parts = [(place, every, each) for place, each in enumerate(fit.beside.errors)]
    else:
        records = [rows for rows in fit.projection.experiments if isinstance(rows, FreeRecord)]
        residuals = [
            np.where(rows.observed, rows.measured - predicted, np.nan)
            for rows, predicted in zip(records, fit.projection.predictions(), strict=True)
        ]
        places = experiments_of(records, fit.channels).tolist()
        parts = [(place, rows.outputs, each) for place, rows, each in zip(places, records, residuals, strict=True)]
    for place, outputs, each in parts:  # outputs that come late begin later
        errors[place][outputs, -each.shape[1] :] = each
    return errors


def _new_in_inputs(recording: Recording) -> Array:
    """What the past does not foretell of the inputs, (m, T - past), of a long recording in its beginning."""
    part = np.s_[:, : TUNING.piece // (len(recording.u) + len(recording.y))]
    u, y = recording.u[part], recording.y[part]
    m, spare = len(u), u.shape[1] - _PAST
    signals = np.concatenate([u, bridged(np.where(np.isnan(y).all(axis=1, keepdims=True), 0.0, y))])
    if spare < 4 * _PAST * len(signals):
        return np.zeros((m, 0))
    size = np.abs(signals).max(axis=1, keepdims=True)
    signals = signals / np.where(size > 0, size, 1.0)
    past = np.concatenate([signals[:, _PAST - k : u.shape[1] - k] for k in range(1, _PAST + 1)] + [np.ones((1, spare))])
    present = signals[:m, _PAST:]
    return np.asarray(size[:m] * (present - np.linalg.lstsq(past.T, present.T, rcond=None)[0].T @ past))

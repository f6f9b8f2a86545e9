"""Covariance of the estimates, from the curvature of the loss at its minimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._checks import EPS
from ..._types import Array
from ..regression.elimination import inverse_gram
from ..regression.modal_regressors import output_weight
from ..regression.time_rows import RecordRows
from ..regression.variable_projection import Projection

_TURN = {"velocity": -0.5, "displacement": 0.5, "acceleration": -1.5}  # power of d in a state of unit amplitude


@dataclass(frozen=True)
class Uncertainty:
    """Noise variance, covariance of `(d, r, initial state of each record)`, and standard errors of the offsets."""

    variance: float
    covariance: Array
    offsets: Array


def uncertainty(at: Projection, total: int, quantity: str) -> Uncertainty:
    """Uncertainty of a minimum; of `total` modes those beyond it are NaN.

    Rows and columns of what is held or was not estimated are NaN.
    """
    n = len(at.d)
    J, known = at.jacobian()
    degrees = max(1, at.problem.samples - int(known.sum()))
    variance = at.loss / degrees
    covariance = np.full((len(known), len(known)), np.nan)
    covariance[np.ix_(known, known)] = variance * inverse_gram(J[:, known])
    # no frequency is known to more digits than it has
    np.fill_diagonal(covariance[:n, :n], np.maximum(np.diag(covariance)[:n], (EPS * at.d) ** 2))
    # (d, kappa, alpha and beta of each record); NaN where a record starts at rest
    places, offsets, start = [np.arange(2 * n)], np.full(len(at.own), np.nan), 2 * n
    for k, (own, rows) in enumerate(zip(at.own, at.problem.experiments, strict=True)):
        if isinstance(rows, RecordRows):
            places.append(np.full(2 * n, -1) if rows.from_rest else start + np.arange(2 * n))
            if rows.offset:
                offsets[k] = np.sqrt(covariance[start + len(own) - 1, start + len(own) - 1])
        start += len(own)
    index = np.concatenate(places)
    linear = np.pad(covariance, (0, 1), constant_values=np.nan)[np.ix_(index, index)]
    return Uncertainty(variance, _in_states(linear, at, total, quantity), offsets)


def _in_states(linear: Array, at: Projection, total: int, quantity: str) -> Array:
    """From `(d, kappa, alpha, beta, ...)` to `(d, r, q, p, ...)`.

    `r = kappa / d`, and `q + i p` is the free amplitude divided by `c sqrt(d kappa)`, `c` the weight in the output.
    """
    d, kappa, driven, n = at.d, at.kappa, at.problem.driven, len(at.d)
    states = [at.amplitudes(k) for k, rows in enumerate(at.problem.experiments) if isinstance(rows, RecordRows)]
    # of a combination that leaves no trace the smallest solution is 0: a weight of 0 is not an estimate either
    held = ~at.free | (kappa == 0) if driven else np.zeros(n, bool)
    safe = np.where(held, 1.0, kappa) if driven else d
    k = np.arange(n)
    T = np.zeros((len(linear), len(linear)))
    T[k, k] = 1.0
    T[n + k, k], T[n + k, n + k] = (-kappa / d**2, 1.0 / d) if driven else (0.0, 0.0)
    factor = 1.0 / (output_weight(d, quantity)[0] * np.sqrt(d * safe))
    # without an input r is fixed, so that kappa turns with d
    by_d = (_TURN[quantity] - (0.0 if driven else 0.5)) / d
    for record, amplitude in enumerate(states):
        state = factor * amplitude
        q, p = 2 * n * (1 + record) + k, 2 * n * (1 + record) + n + k
        T[q, q], T[q, p], T[p, q], T[p, p] = factor.real, -factor.imag, factor.imag, factor.real
        for place, part in ((q, state.real), (p, state.imag)):
            T[place, k] = part * by_d
            if driven:
                T[place, n + k] = -0.5 * part / safe
    missing = np.isnan(np.diag(linear))
    missing[n : 2 * n] |= held | (not driven)
    missing[2 * n :] |= np.tile(held, 2 * len(states))
    inner = T @ np.where(np.isnan(linear), 0.0, linear) @ T.T
    inner[missing] = np.nan
    inner[:, missing] = np.nan
    if total == n:
        return inner
    kinds = 2 + 2 * len(states)
    full = np.full((kinds * total, kinds * total), np.nan)
    parts = (np.arange(kinds)[:, None] * total + k).ravel()
    full[np.ix_(parts, parts)] = inner
    return full

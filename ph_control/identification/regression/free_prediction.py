"""What damped modes say of recordings of several channels: their outputs, and the motions that fit these best."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, NDArray
from ...modal.discretization import Hold
from ..data.channels import Recording, ResponseMatrix
from ..data.parts import blocks
from .free import FreeProjection
from .prediction import FittedData
from .time_rows import FreeRecord


@dataclass(frozen=True, eq=False, repr=False)
class FittedChannels(FittedData):
    """What a fit by `pem` says of one experiment of several inputs or outputs.

    Attributes
    ----------
    record : Recording or ResponseMatrix
        The data.
    free_amplitudes : ndarray of complex, shape (n, p)
        Free motion of each mode at each output, `Re(amplitude exp(p t))`; (n, 0) for a frequency response.
    offsets, drifts : ndarray, shape (p,)
        Constant that is added to each output, and its change per unit time; 0 if not estimated.
    predicted : ndarray, shape (p, T) or (p, m, K)
        Predicted outputs; complex for a frequency response.
    """

    record: Recording | ResponseMatrix
    free_amplitudes: ComplexArray
    offsets: Array
    drifts: Array
    predicted: NDArray[Any]

    def __str__(self) -> str:
        """Say how much there is of it, and how well it is fitted."""
        return f"{self.record.samples} samples of {len(self.predicted)} outputs, fit {self.fit_percent:.2f} %"

    @property
    def fit_percent(self) -> float:
        """`100 (1 - sqrt(mean |residual|^2 / |output - mean|^2))`, the mean over outputs or entries."""
        return joint_percent(self.unexplained[None])

    @property
    def unexplained(self) -> Array:
        """`|residual|^2 / |output - mean|^2` of each output, shape (p,), or entry, (p, m); NaN without samples."""
        return unexplained([self])


def unexplained(experiments: Sequence[FittedChannels]) -> Array:
    """Share of each output or entry, over all experiments, that is left unexplained; weighted as in the fit."""
    total, sums, left, whole = 0.0, 0.0, 0.0, 0.0
    for weights, measured, residuals in pieces(experiments):
        total = total + weights.sum(axis=-1)
        sums = sums + np.sum(weights * measured, axis=-1)
        left = left + np.sum(weights * np.abs(residuals) ** 2, axis=-1)
    mean = np.asarray(sums / np.where(np.asarray(total) > 0, total, 1.0))[..., None]
    for weights, measured, _ in pieces(experiments):
        whole = whole + np.sum(weights * np.abs(measured - mean) ** 2, axis=-1)
    return np.where(whole > 0, left / np.where(whole > 0, whole, 1.0), np.nan)


def pieces(experiments: Sequence[FittedChannels]) -> Iterator[tuple[Array, NDArray[Any], NDArray[Any]]]:
    """Weights of values block by block, 0 where one is missing, the values, and what is left of them, 0 there."""
    for one in experiments:
        for part in blocks(one.record.samples, one.predicted[..., 0].size):
            observed, measured = one.record.observed[..., part], one.measured[..., part]
            weights = one.record.weights[..., part] if isinstance(one.record, ResponseMatrix) else 1.0
            residuals = np.where(observed, measured - one.predicted[..., part], 0.0)
            yield np.where(observed, weights, 0.0), np.where(observed, measured, 0.0), residuals


def joint_percent(shares: Array) -> float:
    """Fit of all outputs from the share of each that is left."""
    known = shares[~np.isnan(shares)]
    return 100.0 * (1.0 - float(np.sqrt(known.mean()))) if known.size else np.nan


def natural_jacobian(p: ComplexArray) -> Array:
    """Derivatives of natural frequencies and damping ratios by imaginary and real parts of poles, shape (2n, 2n)."""
    n, w, x, d = len(p), p.imag, p.real, np.abs(p)
    J, k = np.zeros((2 * n, 2 * n)), np.arange(n)
    J[k, k], J[k, n + k] = w / d, x / d
    J[n + k, k], J[n + k, n + k] = x * w / d**3, -(w**2) / d**3
    return J


def predicted_outputs(p: ComplexArray, residues: ComplexArray, through: Array, u: Array, hold: Hold) -> Array:
    """Outputs (q, T) from rest of modes with poles (n,), residues (n, q, m) and feedthrough (q, m); O(T n (m + q))."""
    outputs = residues.shape[1]
    if not len(u):
        return np.zeros((outputs, u.shape[1]))
    y = np.zeros((outputs, u.shape[1]))
    rows = FreeRecord(u, y, np.ones(u.shape[1], bool), hold, moving=False, outputs=np.arange(outputs))
    each = np.moveaxis(residues, 2, 0)
    shared = np.concatenate([each.real, each.imag, through.T[:, None]], axis=1).reshape(-1, outputs)
    return np.asarray(rows.at(p).predict(shared, np.zeros((0, outputs))))


def estimated_motion(p: ComplexArray, record: Recording, forced: Array, hold: Hold, offset: bool) -> Array:
    """Free motion, and constant, that fit what is left of the outputs best, at all samples, (q, T)."""
    nothing = np.zeros((1, record.samples))
    left = np.where(record.observed, record.y - forced, 0.0)
    rows = FreeRecord.by_observation(nothing, left, record.observed, hold, offset=int(offset), driven=False)
    found = np.zeros(left.shape)
    for one in rows:
        at = FreeProjection([replace(one, outputs=np.arange(len(one.outputs)))], p)
        found[one.outputs] = at.predictions()[0]
    return found

"""What damped modes say of recordings of several channels: their outputs, and the motions that fit these best."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Indices, NDArray
from ...modal.discretization import Hold
from ..data.channels import Recording, ResponseMatrix
from .free import FreeProjection
from .prediction import FittedData, ResponseBackground, shares_left
from .time_rows import WHOLE, FreeRecord


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
        Predicted outputs, NaN where they depend on inputs before the record; complex for a frequency response.
    background : ResponseBackground, optional
        What a frequency response has beside the modes.
    offset_stderr : ndarray, shape (p,)
        Standard errors of the offsets; NaN where none was estimated.
    noise_scale : float
        Standard deviation of its noise, beside the root of the `noise_variance` of the result.
    """

    record: Recording | ResponseMatrix
    free_amplitudes: ComplexArray
    offsets: Array
    drifts: Array
    predicted: NDArray[Any]
    background: ResponseBackground | None = None
    offset_stderr: Array = field(default_factory=lambda: np.full(1, np.nan))
    noise_scale: float = 1.0

    def __post_init__(self) -> None:
        errors = np.broadcast_to(self.offset_stderr, np.shape(self.offsets))
        object.__setattr__(self, "offset_stderr", np.array(errors, float))
        super().__post_init__()

    def __str__(self) -> str:
        """Say how much there is of it, and how well it is fitted."""
        return f"{self.record.samples} samples of {len(self.predicted)} outputs, fit {self.fit_percent:.2f} %"

    @property
    def unexplained(self) -> Array:
        """`|residual|^2 / |output - mean|^2` of each output, shape (p,), or entry, (p, m); NaN without samples."""
        return shares_left([(self.record, self.predicted)]) ** 2


def natural_jacobian(p: ComplexArray) -> Array:
    """Derivatives of natural frequencies and damping ratios by imaginary and real parts of poles, shape (2n, 2n)."""
    n, w, x = len(p), p.imag, np.where(p == 0, -(np.finfo(float).tiny ** 0.25), p.real)
    d = np.hypot(x, w)
    J, k = np.zeros((2 * n, 2 * n)), np.arange(n)
    J[k, k], J[k, n + k] = w / d, x / d
    J[n + k, k], J[n + k, n + k] = x * w / d**3, -(w**2) / d**3
    return J


def halved(p: ComplexArray, residues: ComplexArray) -> ComplexArray:
    """Residues (n, q, m) beside those of conjugate poles: of real poles, which are their own, half of each."""
    return np.where(p.imag == 0, 0.5, 1.0)[:, None, None] * residues


def predicted_outputs(
    p: ComplexArray, residues: ComplexArray, through: Array, u: Array, hold: Hold, delay: Array | None = None,
    input_delay: Array | None = None,
) -> Array:  # fmt: skip
    """Outputs (q, T) from rest of modes with poles (n,), residues (n, q, m) and feedthrough (q, m); O(T n (m + q)).

    Each may come later by a `delay` (q,); where it is negative the last input lasts.  Each input may act later by an
    `input_delay` (m,): then outputs are the sums of those of inputs that act together.
    """
    if input_delay is not None and input_delay.any() and len(u):
        q = residues.shape[1]
        own, together = np.zeros(q) if delay is None else delay, np.zeros((q, u.shape[1]))
        for late in np.unique(input_delay):
            which = input_delay == late
            together += predicted_outputs(p, residues[:, :, which], through[:, which], u[which], hold, own + late)
        return together
    if delay is not None and delay.any():
        outputs = np.empty((len(delay), u.shape[1]))
        for late in np.unique(delay):
            which = delay == late
            outputs[which] = _late_outputs(p, residues[:, which], through[which], u, hold, float(late))
        return outputs
    return _late_outputs(p, residues, through, u, hold, 0.0)


def _late_outputs(p: ComplexArray, residues: ComplexArray, through: Array, u: Array, hold: Hold, delay: float) -> Array:
    """Outputs that come later by the same time."""
    outputs = residues.shape[1]
    if not len(u):
        return np.zeros((outputs, u.shape[1]))
    early = max(0, -int(np.floor(delay / hold.h + WHOLE)))
    u = np.concatenate([u, np.repeat(u[:, -1:], early, axis=1)], axis=1) if early else u
    y = np.zeros((outputs, u.shape[1]))
    rows = FreeRecord(u, y, np.ones(u.shape[1], bool), hold, moving=False, outputs=np.arange(outputs))
    rows = rows.delayed(delay + early * hold.h)
    each = np.moveaxis(halved(p, residues), 2, 0)
    shared = np.concatenate([each.real, each.imag, through.T[:, None]], axis=1).reshape(-1, outputs)
    return np.asarray(rows.evaluated(p).predict(shared, np.zeros((0, outputs)))[:, early:])


def unknown_samples(delay: Array, dt: float) -> Indices:
    """First samples of each output that depend on inputs before the record."""
    return np.maximum(np.ceil(delay / dt - WHOLE), 0).astype(int)


def moved_freely(p: ComplexArray, motion: ComplexArray, hold: Hold, samples: int, first: Indices) -> Array:
    """Outputs (q, samples) of free motions (n, q), which before a `first` sample have the size that they have there.

    What inputs before a record have done to an output that comes late is no free motion before it has come, and a fast
    one would have been very large.
    """
    step, samples_from_start = hold.step(p), np.arange(float(samples))
    powers = step.powers(samples_from_start)
    if not first.any():
        return np.asarray((motion.T @ powers).real)
    held = np.abs(step.powers(first.astype(float))).T[..., None]
    sizes = np.where(samples_from_start < first[:, None, None], held, np.abs(powers))
    return np.asarray((motion.T[..., None] * sizes * np.exp(1j * np.angle(powers))).real.sum(axis=1))


def estimated_motion(
    p: ComplexArray, record: Recording, forced: Array, hold: Hold, offset: bool, delay: Array
) -> Array:
    """Free motion, and constant, fitted to the outputs without their forced part, at all samples, (q, T)."""
    nothing, first = np.zeros((1, record.samples)), unknown_samples(delay, hold.h)
    observed = record.observed & (np.arange(record.samples) >= first[:, None])
    residual = np.where(observed, record.y - forced, 0.0)
    rows = FreeRecord.by_observation(nothing, residual, observed, hold, offset=int(offset), driven=False)
    motion = np.zeros(residual.shape)
    for group in rows:
        projection = FreeProjection([replace(group, outputs=np.arange(len(group.outputs)))], p)
        motion[group.outputs] = projection.predictions()[0]
        unknown = first[group.outputs]
        if unknown.any():
            own, n = projection.own[0], len(p)
            before = moved_freely(p, 2 * (own[:n] + 1j * own[n : 2 * n]), hold, int(unknown.max()), unknown)
            before += own[-1][:, None] if offset else 0.0
            some = np.arange(before.shape[1])
            motion[group.outputs, : len(some)] = np.where(
                some < unknown[:, None], before, motion[group.outputs, : len(some)]
            )
    return motion

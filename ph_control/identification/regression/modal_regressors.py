"""What each mode contributes to the samples of a record, and how that changes with its pole.

Given the poles the predicted output is linear in everything else.  A mode `x' = p x + w u` adds

    y_k = Re(a lambda^k + x_k),

`a` its free motion at the output and `x` its response from rest.  Without losses `p = -i d`, and what is measured of
the port is the weight `w`: the residue `kappa` times 1 for its velocity, `i / d` for its displacement, `-i d` (and the
input itself, fed through) for its acceleration.  With sensors anywhere the weight is any complex number, so that the
real and the imaginary part of its column belong to one unknown each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import lfilter

from ..._types import Array, ComplexArray
from ..._units import DERIVATIVES
from ...modal.discretization import Hold, Multipliers
from ...modal.modal_form import imaginary

QUANTITIES = tuple(quantity for quantity in DERIVATIVES if quantity != "free")

SHORT = 32  # samples in a group

_LASTING = 300.0  # logarithm of what modes lose over a piece of a record: the square is still in the range of doubles
_DEAD = 1e-200  # of the largest state: what has died away must not leave the range of doubles, where all is slow


@dataclass(frozen=True)
class SampledModes(Multipliers):
    """One step `x_(k+1) = lambda x_k + b0 u_k + b1 u_(k+1)` of modes (n,), and its derivatives by their poles.

    `turn` is the derivative of the logarithm of `lambda`.  What is seen is `x_k`, or, of a linear input that arrives a
    part of a step late, `x_k + ahead u_(k+1)`.
    """

    b0: ComplexArray
    b1: ComplexArray
    turn: ComplexArray
    b0_slope: ComplexArray
    b1_slope: ComplexArray
    ahead: ComplexArray | None = None
    ahead_slope: ComplexArray | None = None

    @classmethod
    def of(cls, hold: Hold, p: ComplexArray, late: float = 0.0) -> SampledModes:
        """Modes with poles `p` and unit weight, seen a part of a step `late`: then `u_k` is the sample before."""
        growth, phase = hold.log_multiplier(p)
        turn = hold.log_derivative(p)
        if not late:
            b0, b1, b0_slope, b1_slope = hold.weights_and_derivatives(p)
            return cls(growth, phase, b0, b1, turn, b0_slope, b1_slope)
        (b0, b1, ahead), (b0_slope, b1_slope, ahead_slope) = hold.late_weights(p, late)
        if hold.intersample == "zoh":
            return cls(growth, phase, b0, b1, turn, b0_slope, b1_slope)
        # x_k is what is seen without the sample after, so that a step has two samples of the input
        lam = hold.multiplier(p)
        b1_slope = b1_slope + lam * (turn * ahead + ahead_slope)
        return cls(growth, phase, b0, b1 + lam * ahead, turn, b0_slope, b1_slope, ahead, ahead_slope)

    @property
    def doubled(self) -> SampledModes:
        """The same for inputs of twice the size."""
        inputs = ("b0", "b1", "b0_slope", "b1_slope") + ("ahead", "ahead_slope") * (self.ahead is not None)
        return replace(self, **{name: 2 * getattr(self, name) for name in inputs})


def output_weight(d: Array, quantity: str) -> ComplexArray:
    """Weight of each modal state in the output."""
    if quantity == "velocity":
        return np.ones(len(d), complex)
    return imaginary(1.0 / d if quantity == "displacement" else -d)


# --- groups of samples ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ModalColumns:
    """Columns `Re(sum_i amplitude_i motion_i + response to the samples of the group)` over groups of samples.

    `amplitudes` (1 or 2, n, count) belong to `lambda^s`, s counting the samples of a group, and to `s lambda^s` times
    the derivative of the logarithm; `within` (n, SHORT, SHORT) is the response to the samples of an `input`, if any.
    As coefficients are complex, beside the real parts are those of `i` times the same.
    """

    amplitudes: tuple[ComplexArray, ...]
    within: ComplexArray | None = None
    input: int = 0

    @property
    def turned(self) -> list[tuple[tuple[ComplexArray, ...], Array | None]]:
        """Amplitudes and real responses of the real parts, and of those of `i` times the same."""
        real, turned = (None, None) if self.within is None else (self.within.real, -self.within.imag)
        return [(self.amplitudes, real), (tuple(1j * part for part in self.amplitudes), turned)]


@dataclass(frozen=True)
class GroupStates:
    """A piece of a record by groups: its samples, and modal states at the start of each, with their derivatives.

    `samples` are those of the piece in the record, `inputs` (m, count, SHORT), or with the sample after each group
    (m, count, SHORT + 1) where it is seen; `driven` and `driven_slope`
    (m, n, count) the states that each input causes from rest, `free` and `free_slope` (n, count) those of unit motions.
    """

    samples: slice
    inputs: Array
    driven: ComplexArray
    driven_slope: ComplexArray
    free: ComplexArray
    free_slope: ComplexArray

    def after(self, count: int) -> GroupStates:
        """The same without the first groups."""
        states = (part[..., count:] for part in (self.driven, self.driven_slope, self.free, self.free_slope))
        part = slice(self.samples.start + count * SHORT, self.samples.stop)
        return GroupStates(part, self.inputs[:, count:], *states)


class Kernel:
    """What n modes make of a few samples, from which the columns of any record follow by matrix products.

    In `x_k = sum_j g_(k-j) u_j + lambda^k x_0` the samples are taken `SHORT` at a time: what they contribute within
    their own group is a product with the impulse responses `g`, and what all earlier ones do is a free motion.
    """

    def __init__(self, modes: SampledModes) -> None:
        self.modes = modes
        self._powers = modes.powers(np.arange(SHORT + 1.0))
        lam = self._powers[:, 1]
        self.weight = modes.b0 + lam * modes.b1
        weight_slope = modes.b0_slope + lam * (modes.turn * modes.b1 + modes.b1_slope)
        # from the lag 1 on, lambda^(m-1) w and its derivative
        past = self._powers[:, :-1]
        self._impulse = self.weight[:, None] * past
        lags = np.arange(float(SHORT))
        self._impulse_slope = (weight_slope[:, None] + np.outer(modes.turn * self.weight, lags)) * past

    @property
    def n(self) -> int:
        """Number of modes."""
        return len(self.weight)

    @cached_property
    def within(self) -> tuple[ComplexArray, ComplexArray]:
        """Response to the samples of a group at its instants, (n, SHORT, SHORT), and its derivative by the pole."""
        modes = self.modes
        return (
            _response(modes.b1, self._impulse, modes.ahead),
            _response(modes.b1_slope, self._impulse_slope, modes.ahead_slope),
        )

    @cached_property
    def motion(self) -> Array:
        """Real and imaginary part of `lambda^s` and of `s lambda^s d log lambda`, shape (n, 4, SHORT)."""
        free = self._powers[:, :SHORT]
        turning = self.modes.turn[:, None] * np.arange(float(SHORT)) * free
        return np.stack([free.real, -free.imag, turning.real, -turning.imag], axis=1)

    def pieces(self, inputs: Array, size: int, slopes: bool, last: Array | None = None) -> Iterator[GroupStates]:
        """States through a record with inputs (m, T), so many groups at a time; derivatives are 0 if not asked for.

        Where modes see the next sample, the `last` (m,) is that after the record.
        """
        modes, samples = self.modes, inputs.shape[1]
        # what an interpolated first sample adds to the state at once is taken off again
        state, slope = -np.outer(inputs[:, 0], modes.b1), -np.outer(inputs[:, 0], modes.b1_slope)
        leaps = modes.powers(SHORT * np.arange(min(size, -(-samples // SHORT)) + 1.0))
        for first in range(0, samples, size * SHORT):
            part = slice(first, min(first + size * SHORT, samples))
            groups = np.stack([in_groups(u[part]) for u in inputs])
            count = groups.shape[1]
            turns = leaps[:, : count + 1]
            driven = np.empty((len(groups), self.n, count + 1), complex)
            driven_slope = np.zeros_like(driven)
            for k, u in enumerate(groups):
                driven[k] = self._carried(turns, self._impulse[:, ::-1] @ u.T, state[k])
                if slopes:
                    push = self._impulse_slope[:, ::-1] @ u.T
                    push += (SHORT * modes.turn * self._powers[:, SHORT])[:, None] * driven[k, :, :-1]
                    driven_slope[k] = self._carried(turns, push, slope[k])
            free = turns[:, :-1] * modes.powers(np.array([float(first)])) if first else turns[:, :-1]
            free_slope = (modes.turn[:, None] * (first + SHORT * np.arange(float(count)))) * free
            if last is not None:
                next_sample = inputs[:, part.stop] if part.stop < samples else last
                groups = with_next(groups, part.stop - part.start, next_sample)
            yield GroupStates(part, groups, driven[..., :-1], driven_slope[..., :-1], free, free_slope)
            state, slope = driven[..., -1], driven_slope[..., -1]

    def _carried(self, turns: ComplexArray, push: ComplexArray, start: ComplexArray) -> ComplexArray:
        """All `x_k`, `k = 0 .. count`, of `x_(k+1) = leap x_k + push_k`.

        A running sum once every push is turned back to the start; modes that die away cannot be turned back.
        """
        total = np.empty_like(turns)
        total[:, 0] = start
        lasting = self.modes.growth * (SHORT * push.shape[1]) > -_LASTING
        if lasting.all():
            np.multiply(push, 1.0 / turns[:, 1:], out=total[:, 1:])
            return turns * np.cumsum(total, axis=1)
        some = turns[lasting]
        total[lasting, 1:] = push[lasting] / some[:, 1:]
        total[lasting] = some * np.cumsum(total[lasting], axis=1)
        for k in np.flatnonzero(~lasting).tolist():
            leap = self._powers[k, SHORT]
            total[k, 1:], _ = lfilter([1.0], [1.0, -leap], push[k], zi=[leap * start[k]])
        total[np.abs(total) < _DEAD * np.abs(total).max(initial=0.0)] = 0.0
        return total

    def fill(self, columns: ModalColumns, groups: Array, out: Array) -> None:
        """Columns over groups of inputs (count, SHORT or one more), into an array (columns, count, SHORT)."""
        for place, (amplitudes, within) in enumerate(columns.turned):
            here = out[place * self.n : (place + 1) * self.n]
            motion = self.motion[:, : 2 * len(amplitudes)]
            weights = np.concatenate(
                [part for amplitude in amplitudes for part in ([amplitude.real], [amplitude.imag])]
            )
            if within is None:
                np.matmul(weights.transpose(1, 2, 0), motion, out=here)
            else:
                np.matmul(groups, within, out=here)
                here += np.matmul(weights.transpose(1, 2, 0), motion)


def _response(now: ComplexArray, later: ComplexArray, ahead: ComplexArray | None) -> ComplexArray:
    """Toeplitz matrices (n, SHORT or one more, SHORT): `now` on the diagonal, `later` (n, SHORT) above it.

    With what is seen `ahead` of a sample, which is below the diagonal, there is one more row.
    """
    parts = [np.zeros((len(now), SHORT - (ahead is not None))), now[:, None], later[:, : SHORT - 1]]
    if ahead is not None:
        parts.insert(1, ahead[:, None])
    response = np.concatenate(parts, axis=1)
    # row j holds the response to sample j
    rows = np.lib.stride_tricks.sliding_window_view(response, SHORT, axis=1)[:, ::-1]
    return np.ascontiguousarray(rows[:, : SHORT + (ahead is not None)])


def with_next(groups: Array, samples: int, next_sample: Array) -> Array:
    """Groups (m, count, SHORT) of so many samples with the first sample after each, (m, count, SHORT + 1)."""
    after = np.concatenate([groups[:, 1:, :1], np.zeros((len(groups), 1, 1))], axis=1)
    extended = np.concatenate([groups, after], axis=2)
    extended[:, -1, samples - SHORT * (groups.shape[1] - 1)] = next_sample
    return extended


def in_groups(signal: Array) -> Array:
    """Samples `SHORT` at a time, shape (count, SHORT), as doubles, zeros after the last."""
    signal, padding = np.asarray(signal, float), -len(signal) % SHORT
    padded = np.concatenate([signal, np.zeros(padding)]) if padding else signal
    return padded.reshape(-1, SHORT)

"""What each mode contributes to the output, and how that changes with its frequency.

Given the natural frequencies the predicted output is linear in everything else:

    y_k = sum_l  kappa_l F_l(k) + alpha_l Re lambda_l^k - beta_l Im lambda_l^k,

`F_l` the response of a mode of unit residue from rest, `alpha + i beta` its free motion at the output.  What is
measured of the port is a weight `c_l` on the modal state, `F_l = Re(c_l x_l)`: 1 for its velocity, `i / d_l` for its
displacement, `-i d_l` (and the input itself, fed through) for its acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...modal.discretization import Hold, Step
from ...modal.modal_form import imaginary

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

QUANTITIES = ("velocity", "displacement", "acceleration")

SHORT = 32  # samples in a group


def output_weight(d: Array, quantity: str) -> tuple[ComplexArray, ComplexArray]:
    """Weight of each modal state in the output, and its derivative by the frequency."""
    if quantity == "velocity":
        return np.ones(len(d), complex), np.zeros(len(d), complex)
    if quantity == "displacement":
        return imaginary(1.0 / d), imaginary(-1.0 / d**2)
    return imaginary(-d), imaginary(-np.ones(len(d)))


@dataclass(frozen=True)
class Carry:
    """What the past leaves at the start of a piece of a record: sample number, modal states and their derivatives."""

    sample: int
    state: ComplexArray
    slope: ComplexArray


class Kernel:
    """What n modes make of a few samples, from which the columns of any record follow by matrix products.

    In `x_k = sum_j g_(k-j) u_j + lambda^k x_0` the samples are taken `SHORT` at a time: what they contribute within
    their own group is a product with the impulse responses `g`, and what all earlier ones do is a free motion.
    """

    def __init__(self, d: Array, hold: Hold, quantity: str = "velocity") -> None:
        self.n = len(d)
        p = imaginary(-d)
        now, then, *slopes = hold.weights_and_derivatives(p)
        self._step = Step(*hold.log_multiplier(p), now[:, None], then[:, None], np.ones((1, len(d)), complex))
        # derivatives by the frequency: the pole moves down the axis
        db0, self._db1 = (-1j * slope for slope in slopes)
        self._turn = -1j * hold.log_derivative(p)
        self._powers = self._step.powers(np.arange(SHORT + 1.0))
        lam, b0, b1 = self._powers[:, 1], self._step.b0[:, 0], self._step.b1[:, 0]
        self._b1 = b1
        weight = self.weight = b0 + lam * b1
        weight_slope = db0 + lam * (self._turn * b1 + self._db1)
        # from the lag 1 on, lambda^(m-1) w and its derivative
        past = self._powers[:, :-1]
        self._impulse = weight[:, None] * past
        lags = np.arange(float(SHORT))
        self._impulse_slope = (weight_slope[:, None] + np.outer(self._turn * weight, lags)) * past
        self._output, self._output_slope = output_weight(d, quantity)
        self._fed_through = float(quantity == "acceleration")

    def start(self, u: Array) -> Carry:
        """A record from rest: what an interpolated first sample adds to the state at once is taken off again."""
        return Carry(0, -self._b1 * u[0], -self._db1 * u[0])

    @cached_property
    def within(self) -> Array:
        """Output of samples of one group at its instants, shape (n, SHORT, SHORT)."""
        lag_0 = (self._output * self._b1).real + self._fed_through
        return _toeplitz(lag_0, (self._output[:, None] * self._impulse).real)

    @cached_property
    def within_slope(self) -> Array:
        """Its derivative by the frequency."""
        lag_0 = (self._output_slope * self._b1 + self._output * self._db1).real
        later = self._output_slope[:, None] * self._impulse + self._output[:, None] * self._impulse_slope
        return _toeplitz(lag_0, later.real)

    @cached_property
    def motion(self) -> Array:
        """Real and imaginary part of `lambda^i` and of `i lambda^i d log lambda`, shape (n, 4, SHORT)."""
        free = self._powers[:, :SHORT]
        turning = self._turn[:, None] * np.arange(float(SHORT)) * free
        return np.stack([free.real, -free.imag, turning.real, -turning.imag], axis=1)

    def turns(self, count: int) -> ComplexArray:
        """`lambda^k` at the starts of `count` groups and after them, shape (n, count + 1)."""
        return self._step.powers(SHORT * np.arange(count + 1.0))

    def states(
        self, groups: Array, turns: ComplexArray, carry: Carry, slopes: bool
    ) -> tuple[ComplexArray, ComplexArray, Carry]:
        """States at the start of every group (n, count), their derivatives where asked for, and what is carried on.

        `x_(k+1) = leap x_k + push_k` is a running sum once every push is turned back to the start.
        """
        back = 1.0 / turns[:, 1:]
        state = _accumulated(turns, back, self._impulse[:, ::-1] @ groups.T, carry.state)
        slope = np.zeros_like(state)
        if slopes:
            push = self._impulse_slope[:, ::-1] @ groups.T
            push += (SHORT * self._turn * self._powers[:, SHORT])[:, None] * state[:, :-1]
            slope = _accumulated(turns, back, push, carry.slope)
        onward = Carry(carry.sample + len(groups) * SHORT, state[:, -1], slope[:, -1])
        return state[:, :-1], slope[:, :-1], onward

    def free_starts(self, sample: int, turns: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """`lambda^k` at the start of every group, the first of them at `sample`, and its derivative; (n, count)."""
        count = turns.shape[1] - 1
        free = self._step.powers(np.array([float(sample)])) * turns[:, :-1] if sample else turns[:, :-1]
        return free, (self._turn[:, None] * (sample + SHORT * np.arange(float(count)))) * free

    def forced(self, groups: Array, state: ComplexArray, out: Array | None = None) -> Array:
        """Response to the input with unit residue, shape (n, count, SHORT)."""
        out = np.matmul(groups, self.within, out=out)
        out += _real_part(self._output[:, None] * state, self.motion[:, :2])
        return out

    def free(self, starts: ComplexArray, out: Array | None = None) -> Array:
        """`Re(start lambda^i)`, shape (n, count, SHORT)."""
        return _real_part(starts, self.motion[:, :2], out)

    def forced_slope(self, groups: Array, state: ComplexArray, slope: ComplexArray) -> Array:
        """Derivative of `forced` by the frequencies."""
        return self.sensitivity(np.ones(self.n), groups, state, slope)

    def free_slope(self, starts: ComplexArray, slopes: ComplexArray) -> Array:
        """Derivative of `free` by the frequencies, where the starts change as given."""
        return _real_part(np.stack([slopes, starts]), self.motion)

    def sensitivity(
        self, kappa: Array, groups: Array | None, state: ComplexArray, slope: ComplexArray, out: Array | None = None
    ) -> Array:
        """Derivative of the output by the frequencies, with residues `kappa`: all past in `state` and its `slope`."""
        by_slope = self._output_slope[:, None] * state + self._output[:, None] * slope
        return self.moved(kappa, groups, kappa[:, None] * by_slope, (kappa * self._output)[:, None] * state, out)

    def moved(
        self, kappa: Array, groups: Array | None, slope: ComplexArray, state: ComplexArray, out: Array | None = None
    ) -> Array:
        """Derivative of the output by the frequencies, from the output amplitudes of all past and their derivatives."""
        motion = _real_part(np.stack([slope, state]), self.motion, None if groups is not None else out)
        if groups is None:
            return motion
        out = np.matmul(groups, kappa[:, None, None] * self.within_slope, out=out)
        out += motion
        return out

    @property
    def output(self) -> tuple[ComplexArray, ComplexArray]:
        """Weight of the modal states in the output, and its derivative."""
        return self._output, self._output_slope


def _toeplitz(now: Array, later: Array) -> Array:
    """Upper triangular Toeplitz matrices (n, SHORT, SHORT): `now` on the diagonal, `later` (n, SHORT) above it."""
    response = np.concatenate([np.zeros((len(now), SHORT)), now[:, None], later[:, : SHORT - 1]], axis=1)
    # row j holds the response to sample j
    return np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(response, SHORT, axis=1)[:, SHORT:0:-1])


def _real_part(starts: ComplexArray, motion: Array, out: Array | None = None) -> Array:
    """`Re(sum start * motion)` for starts (n, count) or several of them (m, n, count), shape (n, count, SHORT)."""
    several = starts[None] if starts.ndim == 2 else starts
    weights = np.concatenate([part for one in several for part in ([one.real], [one.imag])])
    return np.matmul(np.moveaxis(weights, 0, 2), motion, out=out)


def _accumulated(turns: ComplexArray, back: ComplexArray, push: ComplexArray, start: ComplexArray) -> ComplexArray:
    """All `x_k`, `k = 0 .. count`, of `x_(k+1) = leap x_k + push_k`."""
    total = np.empty_like(turns)
    total[:, 0] = start
    np.multiply(push, back, out=total[:, 1:])
    return turns * np.cumsum(total, axis=1)


class Regressors:
    """Columns of the linear problem and their derivatives over a whole record, each of shape (T, n).

    For frequencies `d` and an input `u`: O(T n), computed when asked for.
    """

    def __init__(self, d: Array, u: Array, hold: Hold, quantity: str = "velocity") -> None:
        self._kernel, self._samples = Kernel(d, hold, quantity), len(u)
        self._groups = in_groups(u)
        self._start = self._kernel.start(u)

    @cached_property
    def _states(self) -> tuple[ComplexArray, ComplexArray, Carry]:
        return self._kernel.states(self._groups, self._turns, self._start, True)

    @cached_property
    def _turns(self) -> ComplexArray:
        return self._kernel.turns(len(self._groups))

    @cached_property
    def _free(self) -> tuple[ComplexArray, ComplexArray]:
        return self._kernel.free_starts(0, self._turns)

    def _flat(self, parts: Array) -> Array:
        return parts.reshape(len(parts), -1)[:, : self._samples].T

    @property
    def forced(self) -> Array:
        """Response to the input with unit residue, from rest."""
        return self._flat(self._kernel.forced(self._groups, self._states[0]))

    @property
    def cosine(self) -> Array:
        """Free motion from a unit amplitude."""
        return self._flat(self._kernel.free(self._free[0]))

    @property
    def sine(self) -> Array:
        """Free motion from an amplitude a quarter of a turn ahead."""
        return self._flat(self._kernel.free(1j * self._free[0]))

    @property
    def forced_slope(self) -> Array:
        """Derivative of `forced` by the frequency."""
        return self._flat(self._kernel.forced_slope(self._groups, *self._states[:2]))

    @property
    def cosine_slope(self) -> Array:
        """Derivative of `cosine`."""
        return self._flat(self._kernel.free_slope(*self._free))

    @property
    def sine_slope(self) -> Array:
        """Derivative of `sine`."""
        starts, slopes = self._free
        return self._flat(self._kernel.free_slope(1j * starts, 1j * slopes))

    def columns(self) -> Array:
        """All columns `[F, Re lambda^k, -Im lambda^k]`, shape (T, 3n)."""
        return np.concatenate([self.forced, self.cosine, self.sine], axis=1)

    def slopes(self) -> Array:
        """Derivative of each column by the frequency of its own mode, shape (T, 3n)."""
        return np.concatenate([self.forced_slope, self.cosine_slope, self.sine_slope], axis=1)


def regressors(d: Array, u: Array, hold: Hold, quantity: str = "velocity") -> Regressors:
    """Columns and exact derivatives for frequencies `d` and input `u`: O(T n)."""
    return Regressors(d, u, hold, quantity)


def in_groups(signal: Array) -> Array:
    """Samples `SHORT` at a time, shape (count, SHORT), zeros after the last."""
    padding = -len(signal) % SHORT
    padded = np.concatenate([signal, np.zeros(padding)]) if padding else signal
    return padded.reshape(-1, SHORT)

"""Modes through time, in blocks of samples.

A recursion `x_{k+1} = lambda x_k + b u_k`, `y_k = Re(c x_k) + D u_k` with one complex state per mode is cut
into blocks of samples.  Inside a block the input acts through a Toeplitz matrix and the state through powers of
`lambda`, both matrix products; from block to block only the modal states are carried, as sums of what every block adds
to them, turned back to a common instant.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate, repeat

import numpy as np
from scipy.linalg import toeplitz

from .._types import Array, ComplexArray
from ..numerics.double_double import Pair, product
from .discretization import DiscreteModes, Hold, MatrixStep
from .modal_form import ModalForm

_SHORT = 32  # samples of a block of states
_SAMPLES = 1 << 14  # held at once
_STATES = 1 << 13  # held at once
_FOLD = 40  # modes from which on folding pays


def discretize(modes: ModalForm, hold: Hold) -> DiscreteModes:
    """One step of the modes; the rigid-body modes follow the oscillating ones."""
    return hold.step(*modes.equations)


def outputs(modes: ModalForm, hold: Hold, u: Array, x0: ComplexArray | None = None) -> Array:
    """Outputs (p, T) of any modal form for input samples (m, T), from rest or from a state of its single modes.

    Clusters start from rest, and are stepped as matrices.
    """
    step = discretize(modes, hold)
    y = simulate(step, u, np.zeros(len(step.growth), complex) if x0 is None else x0)[0]
    y += modes.feedthrough @ u
    for block in modes.clusters:
        y += block.C @ step_through(hold.step_of_matrices(block.A, block.B), u)
    return y


def step_through(step: MatrixStep, u: Array, start: Array | None = None) -> Array:
    """States (k, T) of a block at every sample, from a state at the first one; from rest without it.

    About `sqrt(T)` blocks of samples are stepped side by side, first from rest, then from where the one before ends.
    """
    samples, (F, rest) = u.shape[1], step[:2]
    size = int(np.ceil(np.sqrt(samples)))
    drive = step.held @ u[:, :-1]
    if step.risen.any():
        drive += step.risen @ np.diff(u)
    blocks = np.zeros((len(F), size * size))
    blocks[:, 1:samples] = drive
    if start is not None:
        blocks[:, 0] = start
    # by place in the block, state and block
    x = blocks.reshape(len(F), size, size).transpose(2, 0, 1).copy()
    for k in range(1, size):
        x[k] += F @ x[k - 1]
    pairs = accumulate(repeat((F, rest), size), product if rest.any() else _product_of_doubles)
    powers, ends = np.stack([high for high, _ in pairs]), x[-1].T.copy()
    for block in range(1, size):
        ends[block] += powers[-1] @ ends[block - 1]
    x[:, :, 1:] += powers @ ends[:-1].T
    return x.transpose(1, 2, 0).reshape(blocks.shape)[:, :samples]


def _product_of_doubles(left_factor: Pair, right_factor: Pair) -> Pair:
    return left_factor[0] @ right_factor[0], left_factor[1]


def transfer_function(modes: ModalForm, points: ComplexArray, hold: Hold | None) -> ComplexArray:
    """Transfer function of the modes, sampled or not, term by term; shape (N, m, m)."""
    if hold is None:
        poles, b, c = modes.equations
        later = np.zeros_like(b)
    else:
        step = discretize(modes, hold)
        poles, b, later, c = step.multiplier, step.b0, step.b1, step.c
    # the real part of a sum over half of the poles is a sum over all
    z = np.stack([points, points.conj()])[..., None, None]
    half, conjugate = c @ ((b + later * z) / (z - poles[:, None]))
    return 0.5 * (half + conjugate.conj())


def simulate(
    step: DiscreteModes, u: Array, x0: ComplexArray, *, states: bool = False, block: int | None = None
) -> tuple[Array, ComplexArray | None]:
    """Outputs, and on request all modal states, of a recursion driven by samples.

    Parameters
    ----------
    step : DiscreteModes
        N modes, m inputs and p outputs.
    u : ndarray, shape (m, T)
        Input samples.
    x0 : ndarray, shape (N,)
        Initial modal state, before the first input sample acts.
    states : bool
        Whether to return the states as well.
    block : int, optional
        Samples taken at once, made even; by default about what costs least.

    Returns
    -------
    y : ndarray, shape (p, T)
        Outputs.
    x : ndarray, shape (N, T), or None
        Modal states.
    """
    # with x = w + b1 u the recursion for w needs only the input at the start of a step
    b = step.b0 + step.multiplier[:, None] * step.b1 if step.b1.any() else step.b0
    start = x0 - step.b1 @ u[:, 0]
    turns = _turns(step, min(block or _block(len(x0)), u.shape[1]), u.shape[1])
    forced = _responses(step, b, turns)
    outward = turns.whole[:-1] * step.c[:, None]
    y = np.empty((len(step.c), u.shape[1]))
    for here, blocks, sums in _segments(turns, b, u, start):
        for row, kernels, weights in zip(y, forced, outward, strict=True):
            out = blocks[0] @ kernels[0]
            for more, kernel in zip(blocks[1:], kernels[1:], strict=True):
                out += more @ kernel
            turns.spread(sums * weights[: len(sums)], out)
            row[here] = out.ravel()[: here.stop - here.start]
    return y, _all_states(step, b, u, start) if states else None


def _block(modes: int) -> int:
    """Samples to take at once: short ones leave more states to carry, long ones more products with inputs."""
    return 32 * int(np.clip(np.round(np.sqrt(180.0 * modes) / 32), 1, 6))


# --- blocks ------------------------------------------------------------------------------------------------------


class _Turns:
    """What samples make of the states of a block, and these of samples: powers of `lambda` as real tables.

    Where no mode grows, states are kept turned back to the first block of a piece of the record, `whole` turns them on;
    then what carries them is a sum.
    """

    def __init__(self, step: DiscreteModes, size: int, count: int) -> None:
        self.size, self.grows = size, bool(step.growth.any())
        # from the start of a block to where its states are, and from those with the samples to those of the next one
        self.ahead = self.after = np.ones(len(step.growth), complex)
        if self.grows:
            self.leap, self.rest = _leap(step, size)
            self.whole = np.broadcast_to(self.ahead, (count + 1, len(step.growth)))
        else:
            self.whole = _table(step, 0.0, float(size), count + 1)
        self._tabulate(step)

    def _tabulate(self, step: DiscreteModes) -> None:
        powers = _table(step, 0.0, 1.0, self.size)
        self.inward, self.outward = powers[::-1].copy().view(float), powers.conj().view(float).T

    def gather(self, u: Array) -> ComplexArray:
        """Sums of the samples of blocks (count, size), turned to where the states of the block are, (count, N)."""
        return (u @ self.inward).view(complex)

    def spread(self, x: ComplexArray, y: Array) -> None:
        """Add real parts of the states of blocks (count, N), turned to each sample, to `y` (count, size)."""
        y += np.ascontiguousarray(x).view(float) @ self.outward

    def carry(self, x: ComplexArray) -> None:
        """Make of a state and what every block adds to it the states before the blocks, in place."""
        if not self.grows:
            np.cumsum(x, axis=0, out=x)
            return
        for k in range(1, len(x)):
            x[k] += self.leap * x[k - 1] + self.rest * x[k - 1]


class _Folded(_Turns):
    """The same with half the products for the price of some sums, where no mode grows.

    States are those in the middle of the block: seen from there a sample before turns by what one after turns back, so
    that sums and differences of the two need one real table each, of cosines and of sines.
    """

    def _tabulate(self, step: DiscreteModes) -> None:
        turns = _table(step, 0.5, 1.0, self.size // 2)
        self.ahead, self.after = turns[-1], turns[-1] ** 2
        self.cos, self.sin = np.ascontiguousarray(turns.real), np.ascontiguousarray(turns.imag)

    def gather(self, u: Array) -> ComplexArray:
        half = self.size // 2
        before, behind = u[:, half - 1 :: -1], u[:, half:]
        x = np.empty((len(u), self.cos.shape[1]), complex)
        x.real = (before + behind) @ self.cos
        x.imag = (before - behind) @ self.sin
        return x

    def spread(self, x: ComplexArray, y: Array) -> None:
        half = self.size // 2
        even, odd = np.ascontiguousarray(x.real) @ self.cos.T, np.ascontiguousarray(x.imag) @ self.sin.T
        y[:, half:] += even - odd
        even += odd
        y[:, half - 1 :: -1] += even


def _turns(step: DiscreteModes, size: int, samples: int) -> _Turns:
    """Tables for blocks of so many samples, made even, and pieces of the record."""
    size, modes = size + size % 2, len(step.growth)
    count = max(32, min(_SAMPLES // size, _STATES // max(1, modes)))
    kind = _Turns if step.growth.any() or modes < _FOLD else _Folded
    return kind(step, size, min(count, -(-samples // size)))


def _leap(step: DiscreteModes, size: int) -> tuple[ComplexArray, ComplexArray]:
    """`lambda^size` and what its rounding leaves, which would add up over the blocks where modes grow."""
    turn = size * (step.phase[0].astype(np.longdouble) + step.phase[1])
    fine = np.exp(size * step.growth.astype(np.longdouble)) * (np.cos(turn) + 1j * np.sin(turn))
    leap = fine.astype(complex)
    return leap, (fine - leap).astype(complex)


def _table(step: DiscreteModes, first: float, gap: float, count: int) -> ComplexArray:
    """`lambda^k` for `k = first, first + gap, ..`, shape (count, N): doubling."""
    levels = 2.0 ** np.arange(np.ceil(np.log2(count)))
    start, *factors = step.powers(np.concatenate([[first], gap * levels])).T
    table = np.empty((count, len(start)), complex)
    table[0] = start
    for level, factor in enumerate(factors):
        known = 1 << level
        np.multiply(table[: min(known, count - known)], factor, out=table[known : 2 * known])
    return table


def _responses(step: DiscreteModes, b: ComplexArray, turns: _Turns) -> Array:
    """Outputs of a block from its inputs, by output and input: Toeplitz matrices of the impulse response."""
    (N, inputs), outputs, size = b.shape, len(step.c), turns.size
    response = np.zeros((outputs, inputs, 2 * size))
    response[:, :, size] = (step.c @ step.b1).real
    later = np.zeros((outputs * inputs, size))
    turns.spread((step.c[:, None] * (turns.ahead * b.T)).reshape(outputs * inputs, N), later)
    response[:, :, size + 1 :] = later.reshape(outputs, inputs, size)[:, :, :-1]
    row, column, sample = response.strides
    shape = outputs, inputs, size, size
    return np.ndarray(shape, float, response, size * sample, (row, column, -sample, sample)).copy()


# --- from block to block -----------------------------------------------------------------------------------------


def _segments(
    turns: _Turns, b: ComplexArray, u: Array, start: ComplexArray
) -> Iterator[tuple[slice, Array, ComplexArray]]:
    """Pieces of a record that fit a cache: where they are, inputs by blocks (m, count, size), states of these.

    The states (count, N) are turned back to the first of a piece, `turns.whole` turns them on.
    """
    size, most = turns.size, len(turns.whole) - 1
    inward = turns.whole[1:].conj() * (turns.after * b.T)[:, None]
    start = start * turns.ahead
    for first in range(0, u.shape[1], size * most):
        here = slice(first, min(first + size * most, u.shape[1]))
        blocks = _blocks(u[:, here], size)
        count = blocks.shape[1]
        sums = np.empty((count + 1, len(b)), complex)
        sums[0] = start
        np.multiply(turns.gather(blocks[0]), inward[0, :count], out=sums[1:])
        for more, weights in zip(blocks[1:], inward[1:], strict=True):
            sums[1:] += turns.gather(more) * weights[:count]
        turns.carry(sums)
        start = turns.whole[count] * sums[-1]
        yield here, blocks, sums[:-1]


def _blocks(u: Array, size: int) -> Array:
    """Samples by blocks, shape (m, count, size), zeros after the last."""
    ports, samples = u.shape
    count = -(-samples // size)
    if count * size > samples:
        padded = np.zeros((ports, count * size))
        padded[:, :samples] = u
        u = padded
    return np.ascontiguousarray(u).reshape(ports, count, size)


def _all_states(step: DiscreteModes, b: ComplexArray, u: Array, start: ComplexArray) -> ComplexArray:
    """States at every sample, shape (N, T): what was carried, turned, and what the block itself has contributed."""
    (ports, samples), N = u.shape, len(start)
    turns = _turns(step, _SHORT, samples)
    P = step.powers(np.arange(float(_SHORT)))
    x = np.empty((N, samples), complex)
    inside = np.zeros((N, ports, _SHORT, _SHORT), complex)
    for mode in range(N):
        for j in range(ports):
            inside[mode, j] = toeplitz(np.zeros(_SHORT), np.r_[0.0, b[mode, j] * P[mode, :-1]])
            inside[mode, j, range(_SHORT), range(_SHORT)] = step.b1[mode, j]
    inside = np.moveaxis(inside, 1, 0)
    for here, blocks, sums in _segments(turns, b, u, start):
        carried = (sums * turns.whole[: len(sums)] / turns.ahead).T
        for mode in range(N):
            part = carried[mode][:, None] * P[mode]
            for block, weights in zip(blocks, inside[:, mode], strict=True):
                part += (block @ weights.view(float)).view(complex)
            x[mode, here] = part.ravel()[: here.stop - here.start]
    return x

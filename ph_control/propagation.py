"""Modes through time: discretisation and block propagation.

A recursion `x_{k+1} = lambda x_k + b u_k`, `y_k = Re(c x_k) + D u_k` with one complex state per mode is cut
into blocks of samples.  Inside a block the input acts through a Toeplitz matrix and the initial state
through powers of `lambda`; between blocks only the modal state is carried.  All of it is matrix products.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from . import _twofloat as tf
from .exceptions import StructureError
from .modal import ModalForm, imaginary

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

METHODS = ("exact", "midpoint", "euler")
INTERSAMPLE = ("zoh", "foh")

_BLOCK = 256
_SHORT = 32  # samples of a block of states
_SEGMENT = 1 << 16  # samples held at once
_GROUP = 32  # blocks through which states are carried side by side


@dataclass(frozen=True)
class Step:
    """One time step of all modes: `x_{k+1} = lambda x_k + b0 u_k + b1 u_{k+1}`, `y = Re(c x)`.

    `lambda = exp(growth + i phase)` with the phase as a pair of doubles, so that high powers keep their phase.
    Shapes: `growth`, `phase` (N,); `b0`, `b1` (N, m); `c` (m, N).
    """

    growth: Array
    phase: tf.Pair
    b0: ComplexArray
    b1: ComplexArray
    c: ComplexArray

    @classmethod
    def of(cls, d: Array, b: ComplexArray, c: ComplexArray, h: float, method: str, intersample: str) -> Step:
        """One step of `x' = -i d x + b u`, `y = Re(c x)`."""
        return cls(*step_factors(d, h, method), *input_weights(d, b, h, method, intersample), c)

    def powers(self, k: Array) -> ComplexArray:
        """`lambda^k` for integers k, shape (N, len(k))."""
        rotation = tf.cis_multiples(self.phase, k)
        return rotation * np.exp(np.multiply.outer(self.growth, k)) if self.growth.any() else rotation

    @property
    def multiplier(self) -> ComplexArray:
        """The numbers `lambda`, shape (N,)."""
        return self.powers(np.ones(1))[:, 0]


def discretize(modes: ModalForm, h: float, method: str = "exact", intersample: str = "zoh") -> Step:
    """Discretise the modes with step `h`; the rigid-body modes follow the oscillating ones.

    exact: `lambda = exp(-i d h)` and the exact integral of a held (zoh) or linearly interpolated (foh) input.
    midpoint: the implicit midpoint rule, input at the middle of the step, `lambda = (1 - i d h/2)/(1 + i d h/2)`.
    euler: `x_{k+1} = (1 - i d h) x_k + h nu u_k`, not lossless: the energy grows by `1 + (d h)^2` a step.
    """
    d = np.concatenate([modes.d, np.zeros(len(modes.rigid))])
    b = np.concatenate([modes.nu, modes.rigid])
    c = np.concatenate([modes.d[:, None] * modes.nu.conj(), modes.rigid]).T
    return Step.of(d, b, c, h, method, intersample)


def step_factors(d: Array, h: float, method: str) -> tuple[Array, tf.Pair]:
    """Logarithm of the multiplier: growth and phase per step."""
    zero = np.zeros_like(d)
    if method == "exact":
        p, e = tf.two_prod(d, np.full_like(d, h))
        return zero, (-p, -e)
    if method == "midpoint":
        hi, lo = _arctan(0.5 * h, d)
        return zero, (-2.0 * hi, -2.0 * lo)
    hi, lo = _arctan(h, d)
    return 0.5 * np.log1p((h * d) ** 2), (-hi, -lo)


def _arctan(h: float, d: Array) -> tf.Pair:
    """`arctan(h d)` as a pair of doubles, as far as the platform's long double reaches."""
    fine = np.arctan(np.longdouble(h) * d.astype(np.longdouble))
    hi = fine.astype(float)
    return hi, (fine - hi).astype(float)


def input_weights(
    d: Array, b: ComplexArray, h: float, method: str, intersample: str
) -> tuple[ComplexArray, ComplexArray]:
    """Weights of `u_k` and `u_{k+1}` in one step of `x' = -i d x + b u`."""
    z = imaginary(-h * d)
    if method == "euler":
        if intersample == "foh":
            raise StructureError(
                "method='euler' uses the input at the start of each step only, so intersample must be 'zoh'; "
                "use method='exact' or 'midpoint' for interpolated inputs"
            )
        return h * b, 0 * b
    if method == "midpoint":
        weight = (h / (1.0 - 0.5 * z))[:, None] * b
        return (weight, 0 * b) if intersample == "zoh" else (0.5 * weight, 0.5 * weight)
    phi_1, phi_2 = phi_functions(z, imaginary(step_factors(d, h, "exact")[1][1]))
    if intersample == "zoh":
        return (h * phi_1)[:, None] * b, 0 * b
    return (h * (phi_1 - phi_2))[:, None] * b, (h * phi_2)[:, None] * b


def phi_functions(z: ComplexArray, rest: ComplexArray | float = 0.0) -> tuple[ComplexArray, ComplexArray]:
    """`phi_1 = (e^z - 1)/z` and `phi_2 = (e^z - 1 - z)/z^2`, without cancellation near 0.

    `rest` is the low part of `z`, which many turns in one step need to keep the phase.
    """
    small = np.abs(z) < 0.5
    safe = np.where(z == 0, 1.0, z)
    # not expm1, whose complex version loses digits in some releases of numpy
    half, low = 0.5 * safe, 0.5 * rest
    phi_1 = np.where(z == 0, 1.0, np.exp(half) * np.exp(low) * (np.sinh(half) + low * np.cosh(half)) / half)
    phi_2 = (phi_1 - 1.0) / safe
    if small.any():
        series, near = np.ones(int(small.sum()), complex), z[small]
        for k in range(17, 2, -1):
            series = 1.0 + near * (series / k)
        phi_2[small] = 0.5 * series
    return phi_1, np.asarray(phi_2)


def simulate(
    step: Step, u: Array, x0: ComplexArray, *, states: bool = False, block: int | None = None
) -> tuple[Array, ComplexArray | None]:
    """Outputs, and on request all modal states, of a recursion driven by samples.

    Parameters
    ----------
    step : Step
        N modes and m ports.
    u : ndarray, shape (m, T)
        Input samples.
    x0 : ndarray, shape (N,)
        Initial modal state, before the first input sample acts.
    states : bool
        Whether to return the states as well.
    block : int, optional
        Samples taken at once; by default about what costs least.

    Returns
    -------
    y : ndarray, shape (m, T)
        Outputs.
    x : ndarray, shape (N, T), or None
        Modal states.
    """
    # with x = w + b1 u the recursion for w needs only the input at the start of a step
    b = step.b0 + step.multiplier[:, None] * step.b1
    start = x0 - step.b1 @ u[:, 0]
    size = min(block or _block(len(x0)), u.shape[1])
    P = _powers_below(step, size)
    forced, free = _output_weights(step, b, P)
    y = np.empty(u.shape)
    for here, blocks, carried in _segments(step, b, u, start, P):
        out = blocks @ forced
        out += carried.view(float) @ free
        y[:, here] = _samples(out, len(u))[:, : here.stop - here.start]
    return y, _all_states(step, b, u, start) if states else None


def _block(modes: int) -> int:
    """Samples to take at once: short ones leave more states to carry, long ones more products with inputs."""
    return 1 << int(np.clip(np.round(np.log2(np.sqrt(250.0 * max(1, modes)))), 5, 9))


def _output_weights(step: Step, b: ComplexArray, P: ComplexArray) -> tuple[Array, Array]:
    """Outputs of a block from its inputs, (m size, m size), and from real and imaginary part of the state before it."""
    (ports, N), size = step.c.shape, P.shape[1]
    weights = step.c[:, :, None] * P
    forced = np.zeros((ports, size, ports, size))
    response = np.zeros((ports, ports, size))
    response[:, :, 0] = (step.c @ step.b1).real
    response[:, :, 1:] = np.einsum("inl,nj->ijl", weights[:, :, : size - 1], b).real
    for i in range(ports):
        for j in range(ports):
            forced[j, :, i] = toeplitz(np.r_[response[i, j, 0], np.zeros(size - 1)], response[i, j])
    free = np.moveaxis(np.stack([weights.real, -weights.imag]), (2, 0), (0, 1)).reshape(2 * N, ports * size)
    return forced.reshape(ports * size, ports * size), np.ascontiguousarray(free)


def _powers_below(step: Step, size: int) -> ComplexArray:
    """`lambda^k` for `k = 0 .. size - 1`, shape (N, size): products of two exact powers."""
    few = min(16, size)
    near, far = step.powers(np.arange(float(few))), step.powers(np.arange(0.0, size, few))
    return (far[:, :, None] * near[:, None, :]).reshape(len(near), far.shape[1] * few)[:, :size]


def _segments(
    step: Step, b: ComplexArray, u: Array, start: ComplexArray, P: ComplexArray
) -> Iterator[tuple[slice, Array, ComplexArray]]:
    """Pieces of a record that fit a cache: where they are, inputs by blocks (count, m size), states before these."""
    (ports, samples), size = u.shape, P.shape[1]
    push = (b.T[:, None, :] * P.T[None, ::-1, :]).reshape(ports * size, len(P)).copy().view(float)
    group = int(np.clip(np.sqrt(samples / size), 1, _GROUP))
    leap = np.ascontiguousarray(step.powers(size * np.arange(group + 1.0)).T)
    length = size * group * max(1, _SEGMENT // (size * group))
    for first in range(0, samples, length):
        here = slice(first, min(first + length, samples))
        blocks = _blocks(u[:, here], size, group)
        states, start = _carry((blocks @ push).view(complex), leap, start)
        yield here, blocks, states


def _blocks(u: Array, size: int, multiple: int = 1) -> Array:
    """Samples by blocks, shape (count, m size), zeros after the last, up to a multiple of so many blocks."""
    ports, samples = u.shape
    count = multiple * -(-samples // (size * multiple))
    padded = u
    if count * size > samples or not u.flags.c_contiguous:
        padded = np.zeros((ports, count * size))
        padded[:, :samples] = u
    return np.moveaxis(padded.reshape(ports, count, size), 0, 1).reshape(count, ports * size)


def _samples(blocks: Array, ports: int) -> Array:
    """Undo `_blocks`: shape (m, count size)."""
    count, width = blocks.shape
    return np.moveaxis(blocks.reshape(count, ports, width // ports), 1, 0).reshape(ports, -1)


def _carry(push: ComplexArray, leap: ComplexArray, start: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """All `x_k` of `x_(k+1) = leap x_k + push_k`, and the last: in groups of blocks, all groups at once.

    The exact powers of the leap, (group + 1, N), let rounding add up over the groups only.
    """
    (count, N), group = push.shape, len(leap) - 1
    inside = push.reshape(count // group, group, N)
    for i in range(1, group):
        inside[:, i] += leap[1] * inside[:, i - 1]
    before = np.empty((len(inside), N), complex)
    for k, whole in enumerate(inside[:, -1]):
        before[k] = start
        start = leap[group] * start + whole
    states = before[:, None] * leap[:group]
    states[:, 1:] += inside[:, :-1]
    return states.reshape(count, N), start


def unit_states(step: Step, signal: Array, *, block: int = _BLOCK) -> ComplexArray:
    """`X_k = sum_{j<k} lambda^(k-1-j) u_j` for a signal (T,), shape (N, T): what every mode makes of a unit input."""
    samples = len(signal)
    size = min(block, samples)
    count = -(-samples // size)
    padded = np.zeros(count * size)
    padded[:samples] = signal
    blocks = padded.reshape(count, size)
    P = step.powers(np.arange(size + 1.0))
    lam, leap = P[:, 1], P[:, size]
    N = len(P)
    X = np.empty((N, count, size), complex)
    inside = np.empty((N, count, size), complex)
    for mode in range(N):
        inside[mode] = lfilter([1.0], [1.0, -lam[mode]], blocks, axis=-1)
    carried = np.zeros((N, count), complex)
    for k in range(1, count):
        carried[:, k] = leap * carried[:, k - 1] + inside[:, k - 1, -1]
    np.multiply(carried[:, :, None], P[:, None, :size], out=X)
    X[:, :, 1:] += inside[:, :, :-1]
    return X.reshape(N, count * size)[:, :samples]


def _all_states(step: Step, b: ComplexArray, u: Array, start: ComplexArray) -> ComplexArray:
    """States at every sample, shape (N, T): what was carried, turned, and what the block itself has contributed."""
    (ports, samples), N = u.shape, len(start)
    size = min(_SHORT, samples)
    P = _powers_below(step, size)
    x = np.empty((N, samples), complex)
    inside = np.zeros((N, ports * size, size), complex)
    for mode in range(N):
        for j in range(ports):
            inside[mode, j * size : (j + 1) * size] = toeplitz(
                np.zeros(size), np.r_[0.0, b[mode, j] * P[mode, : size - 1]]
            )
            inside[mode, range(j * size, (j + 1) * size), range(size)] = step.b1[mode, j]
    for here, blocks, carried in _segments(step, b, u, start, P):
        for mode in range(N):
            part = (blocks @ inside[mode].view(float)).view(complex)
            part += carried[:, mode, None] * P[mode]
            x[mode, here] = part.ravel()[: here.stop - here.start]
    return x

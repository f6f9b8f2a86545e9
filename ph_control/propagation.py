"""Modes through time: discretisation and block propagation.

A recursion `x_{k+1} = lambda x_k + b u_k`, `y_k = Re(c x_k) + D u_k` with one complex state per mode is cut
into blocks of samples.  Inside a block the input acts through a Toeplitz matrix and the initial state
through powers of `lambda`; between blocks only the modal state is carried.  All of it is matrix products.
"""

from __future__ import annotations

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
    step: Step, u: Array, x0: ComplexArray, *, states: bool = False, block: int = _BLOCK
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

    Returns
    -------
    y : ndarray, shape (m, T)
        Outputs.
    x : ndarray, shape (N, T), or None
        Modal states.
    """
    # with x = w + b1 u the recursion for w needs only the input at the start of a step
    lam = step.multiplier
    b = step.b0 + lam[:, None] * step.b1
    feedthrough = (step.c @ step.b1).real
    ports, samples = u.shape
    start = x0 - step.b1 @ u[:, 0]
    size = min(block, samples)
    count = -(-samples // size)
    padded = np.zeros((ports, count * size))
    padded[:, :samples] = u
    blocks = padded.reshape(ports, count, size)

    P = step.powers(np.arange(size + 1.0))
    carried = _carry(P, b, blocks, start)
    weights = step.c[:, :, None] * P[:, :size]
    y = np.empty((ports, count, size))
    for i in range(ports):
        y[i] = carried.real @ weights[i].real - carried.imag @ weights[i].imag
        for j in range(ports):
            kernel = np.zeros(size)
            kernel[1:] = (weights[i, :, : size - 1].T @ b[:, j]).real
            y[i] += blocks[j] @ toeplitz(kernel, np.zeros(size)).T
    y = y.reshape(ports, -1)[:, :samples] + feedthrough @ u
    if not states:
        return y, None
    x = _all_states(P, lam, b, blocks, carried)[:, :samples] + step.b1 @ u
    return y, x


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


def _carry(P: ComplexArray, b: ComplexArray, blocks: Array, start: ComplexArray) -> ComplexArray:
    """Modal states at the start of each block, shape (blocks, N)."""
    count, size = blocks.shape[1:]
    reach = P[:, size - 1 :: -1] if size > 1 else P[:, :1]
    driven = np.zeros((count, len(P)), complex)
    for j, samples in enumerate(blocks):
        weights = (b[:, j, None] * reach).T
        driven += samples @ weights.real + 1j * (samples @ weights.imag)
    carried = np.empty_like(driven)
    state, leap = start, P[:, size]
    for k in range(count):
        carried[k] = state
        state = leap * state + driven[k]
    return carried


def _all_states(
    P: ComplexArray, lam: ComplexArray, b: ComplexArray, blocks: Array, carried: ComplexArray
) -> ComplexArray:
    """States at every sample, shape (N, T): the carried part and a first-order filter inside each block."""
    count, size = blocks.shape[1:]
    x = np.empty((len(P), count, size), complex)
    for mode in range(len(P)):
        drive = np.tensordot(b[mode], blocks, axes=(0, 0))
        x[mode] = lfilter([0.0, 1.0], [1.0, -lam[mode]], drive, axis=-1)
        x[mode] += np.multiply.outer(carried[:, mode], P[mode, :size])
    return x.reshape(len(P), count * size)

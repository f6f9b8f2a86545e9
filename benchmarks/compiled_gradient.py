"""The paper's learning scheme, compiled: the steps of `phc.gradient_descent`, in one pass over the record each.

Same parameters, gradient, projection and step rules; what is kept is the best point.  Per sample and step it takes
3 n complex multiplications, where the library's own version makes n^2 passes of `scipy.signal.lfilter`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

try:
    from numba import njit
except ImportError:

    def njit(function):
        """Leave a function as it is: without numba these are the same steps, slow."""
        return function


Array = NDArray[np.float64]

_SLOWEST = 1e-3  # turn (rad) of the slowest mode over the record
_MOMENTUM, _MEMORY, _FLOOR = 0.9, 0.999, 1e-8


@dataclass(frozen=True)
class Descent:
    """Losses before each step and after the last, and the best parameters `(d, v or r, s0)`."""

    losses: Array
    theta: Array
    diverged: bool


def descend(
    u: Array, y: Array, h: float, theta: Array, *, natural: bool, adam: bool, rate: float, epochs: int
) -> Descent:
    """Take the steps from `theta`, whose length is 5n in natural parameters `(d, v, s0)` and 4n in `(d, r, s0)`."""
    n = len(theta) // (5 if natural else 4)
    losses, best, count = _descend(u, y, h, np.array(theta, float), n, natural, adam, rate, epochs)
    return Descent(losses[:count], best, count <= epochs)


@njit
def _descend(u, y, h, theta, n, natural, adam, rate, epochs):
    losses, best, least = np.empty(epochs + 1), theta.copy(), np.inf
    mean, square = np.zeros(len(theta)), np.zeros(len(theta))
    slowest = _SLOWEST / (len(u) * h)
    for epoch in range(epochs + 1):
        loss, gradient = _loss_and_gradient(u, y, h, theta, n, natural)
        if not (np.isfinite(loss) and np.isfinite(gradient).all()):
            return losses, best, epoch
        losses[epoch] = loss
        if loss < least:
            least, best = loss, theta.copy()
        step = gradient
        if adam:
            mean += (1 - _MOMENTUM) * (gradient - mean)
            square += (1 - _MEMORY) * (gradient**2 - square)
            now = epoch + 1
            step = mean / (1 - _MOMENTUM**now) / (np.sqrt(square / (1 - _MEMORY**now)) + _FLOOR)
        theta = theta - rate * step
        theta[:n] = np.maximum(theta[:n], slowest)
        if not natural:
            theta[n : 2 * n] = np.maximum(theta[n : 2 * n], 0.0)
    return losses, best, epochs + 1


@njit
def _loss_and_gradient(u, y, h, theta, n, natural):
    """Mean squared error and its derivative; the recursions of all resonators run side by side."""
    d = theta[:n]
    if natural:
        r, s0 = theta[n : 2 * n] ** 2 + theta[2 * n : 3 * n] ** 2, theta[3 * n :]
    else:
        r, s0 = theta[n : 2 * n], theta[2 * n :]
    rows = _rows(d)
    # the free motion is a fixed combination of the positions and velocities of the chain
    on_position, on_velocity = s0[0::2].copy() @ rows, s0[1::2].copy() @ rows
    turn = 1.0 - 1j * h * d
    forced, chain, slope = np.zeros(n, np.complex128), np.zeros(n, np.complex128), np.zeros(n, np.complex128)
    chain[0] = 1.0
    total = 0.0
    by_d, by_r, by_position, by_velocity = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(len(u)):
        motion, output = 0.0, 0.0
        for l in range(n):
            motion += on_position[l] * (chain[l].imag / -d[l]) + on_velocity[l] * chain[l].real
            output += r[l] * d[l] * forced[l].real
        error = output + motion - y[k]
        total += error * error
        for l in range(n):
            by_d[l] += error * (r[l] * forced[l].real - 2 * d[l] * (slope[l].imag / -d[l]))
            by_r[l] += error * d[l] * forced[l].real
            by_position[l] += error * (chain[l].imag / -d[l])
            by_velocity[l] += error * chain[l].real
        before = 0.0
        for l in range(n):
            slope[l] = turn[l] * slope[l] + h * (r[l] * d[l] * forced[l].real + motion)
            forced[l] = turn[l] * forced[l] + h * u[k]
            position = chain[l].imag / -d[l]
            chain[l] = turn[l] * chain[l] + h * before
            before = position
    gradient = np.empty(len(theta))
    gradient[:n] = by_d
    if natural:
        gradient[n : 2 * n] = 2 * theta[n : 2 * n] * by_r
        gradient[2 * n : 3 * n] = 2 * theta[2 * n : 3 * n] * by_r
    else:
        gradient[n : 2 * n] = by_r
    free = gradient[len(theta) - 2 * n :]
    free[0::2], free[1::2] = rows @ by_position, rows @ by_velocity
    return total / len(u), 2 * gradient / len(u)


@njit
def _rows(d):
    """Even powers of the operator applied to the last position of the chain, as combinations of all positions."""
    n = len(d)
    rows = np.zeros((n, n))
    rows[0, n - 1] = 1.0
    for k in range(1, n):
        for l in range(n):
            rows[k, l] = -(d[l] ** 2) * rows[k - 1, l]
            if l + 1 < n:
                rows[k, l] += rows[k - 1, l + 1]
    return rows

"""The output of the observable form under Euler's rule, and its derivatives by the parameters.

In the operator `delta = (z - 1)/h` of Euler's rule the observable form is

    y = sum_l kappa_l delta/(delta^2 + d_l^2) u  +  sum_k s_k(0) delta^{k-1} / prod_l (delta^2 + d_l^2) impulse,

so the output and its derivatives come from resonators `1/(delta^2 + d^2)` alone, one after the other for the initial
state: nothing is lost where frequencies meet, as they do while descending.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ..._types import Array, Mask
from ..data.time_record import Record

_SLOWEST = 1e-3  # turn (rad) of the slowest mode over the record: slower ones are not told from a pole at 0


def _resonate(d: float, h: float, x: Array) -> tuple[Array, Array]:
    """`1/(delta^2 + d^2) x` and `delta/(delta^2 + d^2) x` from rest: parts of `1/(delta + i d) x`."""
    w = lfilter([0.0, h], [1.0, complex(-1.0, h * d)], x)
    return w.imag / -d, w.real


def columns(d: Array, u: Array, h: float) -> tuple[Array, Array]:
    """Signals of which the output is a sum: forced `delta/(delta^2 + d_l^2) u`, shape (n, T); free, shape (2n, T).

    Free signal k is the output from `s(0) = e_k`: `delta^{k-1} / prod (delta^2 + d_l^2)` of an impulse.
    """
    n = len(d)
    forced = np.array([_resonate(frequency, h, u)[1] for frequency in d])
    impulse = np.zeros(len(u))
    impulse[0] = 1.0
    # one resonator after the other, the first before the step of delay that the others have
    w = lfilter([1.0], [1.0, complex(-1.0, h * d[0])], impulse)
    position, velocity = [w.imag / -d[0]], [w.real]
    for frequency in d[1:]:
        for found, signal in zip((position, velocity), _resonate(frequency, h, position[-1]), strict=True):
            found.append(signal)
    # delta^2 times the last position is the one before it less d^2 times itself, and so on
    links = np.diag(np.ones(n - 1), -1) - np.diag(d**2)
    rows = [np.eye(n)[-1]]
    for _ in range(n - 1):
        rows.append(rows[-1] @ links)
    free = np.empty((2 * n, len(u)))
    free[0::2], free[1::2] = np.array(rows) @ np.array(position), np.array(rows) @ np.array(velocity)
    return forced, free


@dataclass(frozen=True)
class Point:
    """Parameters, their loss on both records, and the derivative of the output by each, shape (parameters, T)."""

    theta: Array
    loss: float
    validation: float
    gradient: Array
    jacobian: Array


@dataclass(frozen=True)
class EulerProblem:
    """A record, what follows on it, and the coordinates to descend in: `theta = (d, v or r, s0)`."""

    u: Array
    y: Array
    learned: Mask
    validated: Mask
    samples: int
    h: float
    n: int
    natural: bool

    @classmethod
    def of(cls, record: Record, after: Record | None, n: int, natural: bool) -> EulerProblem:
        """Put the two records behind one another; missing outputs count in neither."""
        u, y = record.u, record.y
        if after is not None:
            u, y = np.append(u, after.u), np.append(y, after.y)
        seen, early = ~np.isnan(y), np.arange(len(u)) < record.samples
        return cls(u, np.where(seen, y, 0.0), seen & early, seen & ~early, record.samples, record.dt, n, natural)

    @property
    def slowest(self) -> float:
        """Lower bound of the natural frequencies."""
        return _SLOWEST / (self.samples * self.h)

    @property
    def sizes(self) -> tuple[int, int]:
        """Where the second and third part of the parameters start."""
        return self.n, 3 * self.n if self.natural else 2 * self.n

    def split(self, theta: Array) -> tuple[Array, Array, Array]:
        """Frequencies, weights `r`, and initial state."""
        d, p, s0 = np.split(theta, self.sizes)
        return d, weights_of(p) if self.natural else p, s0

    def projected(self, theta: Array) -> Array:
        """Nearest parameters of a port-Hamiltonian system."""
        d, p, s0 = np.split(theta, self.sizes)
        return np.concatenate([np.maximum(d, self.slowest), p if self.natural else np.maximum(p, 0.0), s0])

    def at(self, theta: Array) -> Point:
        """Loss, exact gradient and Jacobian: O(T n^2)."""
        d, r, s0 = self.split(theta)
        forced, free = columns(d, self.u, self.h)
        motion = s0 @ free
        error = (r * d) @ forced + motion - self.y
        loss, validation = (_mean_square(error[part]) for part in (self.learned, self.validated))
        early = slice(self.samples)
        forced, free, motion = forced[:, early], free[:, early], motion[early]
        by_d = np.empty((self.n, self.samples))
        for l in range(self.n):
            chained, _ = _resonate(d[l], self.h, r[l] * d[l] * forced[l] + motion)
            by_d[l] = r[l] * forced[l] - 2 * d[l] * chained
        by_p = d[:, None] * forced
        if self.natural:
            v = theta[self.n : 3 * self.n]
            by_p = 2 * v[:, None] * np.concatenate([by_p, by_p])
        jacobian = np.concatenate([by_d, by_p, free])
        seen = self.learned[early]
        return Point(theta, loss, validation, 2 * jacobian @ (error[early] * seen) / seen.sum(), jacobian * seen)


def weights_of(v: Array) -> Array:
    """Weights `r` of an input vector."""
    n = len(v) // 2
    return v[:n] ** 2 + v[n:] ** 2


def _mean_square(error: Array) -> float:
    return float(error @ error) / len(error) if len(error) else 0.0

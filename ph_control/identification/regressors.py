"""What each mode contributes to the output, and how that changes with its frequency.

Given the natural frequencies the predicted output is linear in everything else:

    y_k = sum_l  kappa_l F_l(k) + alpha_l Re lambda_l^k - beta_l Im lambda_l^k,

`F_l` the response of a mode of unit residue from rest, `alpha + i beta` the initial modal states.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..modal import imaginary
from ..propagation import Step, input_weights, phi_functions, step_factors, unit_states

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_LARGEST_GROWTH = 1e50  # of a mode over a record, where the method makes modes grow


@dataclass(frozen=True)
class Hold:
    """How the continuous modes meet the samples: step, method and behaviour of the input between samples."""

    h: float
    method: str = "exact"
    intersample: str = "zoh"

    def step(self, d: Array) -> Step:
        """One step of the modes `x' = -i d x + u`, `y = Re x`."""
        one = np.ones((len(d), 1), complex)
        weights = input_weights(d, one, self.h, self.method, self.intersample)
        return Step(*step_factors(d, self.h, self.method), *weights, one.T)

    def frequency_of(self, phase: Array) -> Array:
        """Natural frequency whose mode turns by `phase` (rad) in one step."""
        if self.method == "midpoint":
            return 2.0 / self.h * np.tan(0.5 * phase)
        return np.tan(phase) / self.h if self.method == "euler" else phase / self.h

    def largest_phase(self, samples: int) -> float:
        """Largest phase per step of a mode; Euler's modes grow, and must not overflow within the record."""
        if self.method == "euler":
            return float(np.arccos(np.exp(-np.log(_LARGEST_GROWTH) / samples)))
        return np.pi

    def log_derivative(self, d: Array) -> ComplexArray:
        """Derivative of `log lambda` by `d`."""
        if self.method == "exact":
            return imaginary(np.full(len(d), -self.h))
        if self.method == "midpoint":
            return imaginary(-self.h / (1.0 + (0.5 * self.h * d) ** 2))
        return imaginary(-self.h * np.ones(len(d))) / (1.0 - 1j * self.h * d)

    def weight_derivatives(self, d: Array) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives by `d` of the weights of `u_k` and `u_{k+1}`."""
        h = self.h
        z = imaginary(-h * d)
        zero = np.zeros(len(d), complex)
        if self.method == "euler":
            return zero, zero
        if self.method == "midpoint":
            slope = -0.5j * h * h / (1.0 - 0.5 * z) ** 2
            return (slope, zero) if self.intersample == "zoh" else (0.5 * slope, 0.5 * slope)
        # phi_1' = phi_1 - phi_2 and phi_2' = phi_2 - 2 phi_3, and z' = -i h
        phi_1, phi_2 = phi_functions(z)
        first = -1j * h * h * (phi_1 - phi_2)
        if self.intersample == "zoh":
            return first, zero
        second = -1j * h * h * (phi_2 - 2.0 * _phi_3(z, phi_2))
        return first - second, second


def _phi_3(z: ComplexArray, phi_2: ComplexArray) -> ComplexArray:
    """`(phi_2 - 1/2)/z`, by its series near 0."""
    series = np.ones_like(z)
    for k in range(18, 3, -1):
        series = 1.0 + z / k * series
    return np.where(np.abs(z) < 0.5, series / 6.0, (phi_2 - 0.5) / np.where(z == 0, 1.0, z))


class Regressors:
    """Columns of the linear problem and their derivatives, each of shape (T, n), computed when asked for.

    For frequencies `d` and an input `u`: O(T n).
    """

    def __init__(self, d: Array, u: Array, hold: Hold) -> None:
        self._u = u
        self._step = hold.step(d)
        self._slope = hold.log_derivative(d)[:, None]
        self._weight_slopes = [weight[:, None] for weight in hold.weight_derivatives(d)]

    @cached_property
    def _free(self) -> ComplexArray:
        """`lambda^k` for all samples, shape (n, T): an outer product of coarse and fine powers."""
        samples = len(self._u)
        size = int(np.ceil(np.sqrt(samples)))
        coarse = self._step.powers(size * np.arange(float(-(-samples // size))))
        fine = self._step.powers(np.arange(float(size)))
        powers = (coarse[:, :, None] * fine[:, None, :]).reshape(len(coarse), coarse.shape[1] * size)
        return np.asarray(powers[:, :samples])

    @cached_property
    def _response(self) -> ComplexArray:
        """`X_k = sum_j lambda^(k-1-j) u_j`, shape (n, T)."""
        return unit_states(self._step, self._u)

    @cached_property
    def _weight(self) -> ComplexArray:
        return self._step.b0 + self._step.multiplier[:, None] * self._step.b1

    @cached_property
    def _forced(self) -> ComplexArray:
        forced = self._weight * self._response
        # from rest: what an interpolated first sample adds to the state at once is taken off again
        return forced + self._step.b1 * self._from_rest if self._step.b1.any() else forced

    @cached_property
    def _from_rest(self) -> ComplexArray:
        return self._u - self._u[0] * self._free

    @cached_property
    def _forced_slope(self) -> ComplexArray:
        # with j u_j in place of u_j: together they give the derivative by log lambda
        k = np.arange(len(self._u))
        later = unit_states(self._step, k * self._u)
        db0, db1 = self._weight_slopes
        db = db0 + self._step.multiplier[:, None] * (self._slope * self._step.b1 + db1)
        slope = (self._slope * self._weight) * ((k - 1) * self._response - later) + db * self._response
        if self._step.b1.any():
            slope += db1 * self._from_rest - self._step.b1 * self._u[0] * self._free_slope
        return np.asarray(slope)

    @cached_property
    def _free_slope(self) -> ComplexArray:
        return np.asarray(self._slope * np.arange(len(self._u)) * self._free)

    @property
    def forced(self) -> Array:
        """Response to the input with unit residue, from rest."""
        return self._forced.real.T

    @property
    def cosine(self) -> Array:
        """Free motion from a unit state."""
        return self._free.real.T

    @property
    def sine(self) -> Array:
        """Free motion from a state a quarter of a turn ahead."""
        return -self._free.imag.T

    @property
    def forced_slope(self) -> Array:
        """Derivative of `forced` by the frequency."""
        return self._forced_slope.real.T

    @property
    def cosine_slope(self) -> Array:
        """Derivative of `cosine`."""
        return self._free_slope.real.T

    @property
    def sine_slope(self) -> Array:
        """Derivative of `sine`."""
        return -self._free_slope.imag.T

    def columns(self) -> Array:
        """All columns `[F, Re lambda^k, -Im lambda^k]`, shape (T, 3n)."""
        return np.concatenate([self._forced.real, self._free.real, -self._free.imag]).T

    def slopes(self) -> Array:
        """Derivative of each column by the frequency of its own mode, shape (T, 3n)."""
        return np.concatenate([self._forced_slope.real, self._free_slope.real, -self._free_slope.imag]).T


def regressors(d: Array, u: Array, hold: Hold) -> Regressors:
    """Columns and exact derivatives for frequencies `d` and input `u`: O(T n)."""
    return Regressors(d, u, hold)

"""What each mode contributes to the output, and how that changes with its frequency.

Given the natural frequencies the predicted output is linear in everything else:

    y_k = sum_l  kappa_l F_l(k) + alpha_l Re lambda_l^k - beta_l Im lambda_l^k,

`F_l` the response of a mode of unit residue from rest, `alpha + i beta` the initial modal states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..modal import imaginary
from ..propagation import Step, input_weights, phi_functions, simulate, step_factors

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


@dataclass(frozen=True)
class Regressors:
    """Columns of the linear problem and their derivatives, each of shape (T, n)."""

    forced: Array
    cosine: Array
    sine: Array
    forced_slope: Array
    cosine_slope: Array
    sine_slope: Array

    def columns(self) -> Array:
        """All columns `[F, Re lambda^k, -Im lambda^k]`, shape (T, 3n)."""
        return np.concatenate([self.forced, self.cosine, self.sine], axis=1)

    def slopes(self) -> Array:
        """Derivative of each column by the frequency of its own mode, shape (T, 3n)."""
        return np.concatenate([self.forced_slope, self.cosine_slope, self.sine_slope], axis=1)


def regressors(d: Array, u: Array, hold: Hold) -> Regressors:
    """Columns and exact derivatives for frequencies `d` and input `u`: O(T n)."""
    samples = len(u)
    k = np.arange(samples)
    step = hold.step(d)
    slope = hold.log_derivative(d)[:, None]
    free = _free(step, samples)
    # X_k = sum_j lambda^(k-1-j) u_j, and the same with j u_j: together they give the derivative by log lambda
    X = _unit_response(step, u)
    Y = _unit_response(step, k * u)
    b = step.b0 + step.multiplier[:, None] * step.b1
    db0, db1 = hold.weight_derivatives(d)
    db = db0[:, None] + step.multiplier[:, None] * (slope * step.b1 + db1[:, None])
    free_slope = slope * k * free
    # from rest: what an interpolated first sample adds to the state at once is taken off again
    forced = b * X + step.b1 * (u - u[0] * free)
    forced_slope = slope * b * ((k - 1) * X - Y) + db * X + db1[:, None] * (u - u[0] * free)
    forced_slope -= step.b1 * u[0] * free_slope
    return Regressors(
        forced.real.T, free.real.T, -free.imag.T, forced_slope.real.T, free_slope.real.T, -free_slope.imag.T
    )


def _free(step: Step, samples: int) -> ComplexArray:
    """`lambda^k` for all samples, shape (n, T): an outer product of coarse and fine powers."""
    size = int(np.ceil(np.sqrt(samples)))
    coarse = step.powers(size * np.arange(float(-(-samples // size))))
    fine = step.powers(np.arange(float(size)))
    return (coarse[:, :, None] * fine[:, None, :]).reshape(len(coarse), coarse.shape[1] * size)[:, :samples]


def _unit_response(step: Step, u: Array) -> ComplexArray:
    """`X_k = sum_{j<k} lambda^(k-1-j) u_j`, shape (n, T)."""
    one = np.ones_like(step.b0)
    unit = Step(step.growth, step.phase, one, 0 * one, step.c)
    _, states = simulate(unit, u[None, :], np.zeros(len(one), complex), states=True)
    assert states is not None
    return states

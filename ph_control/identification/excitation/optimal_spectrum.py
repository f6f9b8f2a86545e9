"""The spectrum of an input that makes some standard errors least: convex, by a multiplicative update.

    min trace(W F^{-1} W^T),     F = T sum_a P_a Re(D_a^H D_a),     sum of P_a over each input = its power

over the powers `P_a >= 0` of lines.  The sum of `|x_a|^2 / P_a` over all `x` that reproduce `W` is convex in both, and
minimised in turn: `x_a = P_a D_a F^{-1} W^T` for given powers, `P_a ~ |x_a|` for given `x`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._types import Array, ComplexArray, Indices, Mask

_GAP = 1e-3  # relative distance to the least value at which it ends
_FIRST, _MOST = 50, 3000  # iterations on all lines, and on those that have kept some power
_ROUNDS = 20  # of lines that come back
_LITTLE = 1e-7  # of the power of an input: a line with less is left out, until the bound asks for it
_BACK = 1e-3  # of the power of an input: what lines that come back begin with, together


@dataclass(frozen=True)
class Reached:
    """What some powers reach: the criterion, what each line lowers it by per unit of power, and a bound.

    No powers that sum up to the same over each input have a criterion below the bound.
    """

    value: float
    gain: Array
    bound: float

    @property
    def is_least(self) -> bool:
        """Whether the criterion is at the bound, but for a relative 1e-3."""
        return self.value <= (1 + _GAP) * self.bound


@dataclass(frozen=True)
class SpectrumProblem:
    """Lines with sensitivities (A, q, P), the quantities `W` (k, P), and the input that each line belongs to.

    Inputs have the `power` (m,); `samples` is the number of those of the record.
    """

    sensitivities: ComplexArray
    quantities: Array
    inputs: Indices
    power: Array
    samples: int

    @property
    def even(self) -> Array:
        """The power of each input spread evenly over its lines."""
        return (self.power / np.bincount(self.inputs, minlength=len(self.power)))[self.inputs]

    def among(self, lines: Mask) -> SpectrumProblem:
        """The problem on some of the lines."""
        return replace(self, sensitivities=self.sensitivities[lines], inputs=self.inputs[lines])

    @cached_property
    def _rows(self) -> Array:
        """Real and imaginary parts of the sensitivities, shape (2 q A, P), output by output."""
        by_output = np.moveaxis(self.sensitivities, 1, 0).reshape(-1, self.sensitivities.shape[2])
        return np.concatenate([by_output.real, by_output.imag])

    def information(self, power: Array) -> Array:
        """Fisher information (P, P)."""
        weight = np.tile(self.samples * power, len(self._rows) // len(power))
        return np.asarray((self._rows * weight[:, None]).T @ self._rows)

    def on_the_way(self, iterations: int) -> Array:
        """Powers (A,) after some iterations from the even ones."""
        return self._descend(self.even, iterations)

    def solved(self) -> Array:
        """The powers (A,) of the least criterion, within a relative 1e-3."""
        power = self.on_the_way(_FIRST)
        for _ in range(_ROUNDS):
            kept = power > _LITTLE * self.power[self.inputs]
            few = self.among(kept)
            reduced, power = few._normal(power[kept]), np.zeros(len(power))
            power[kept] = few._descend(reduced, _MOST)
            reached = self.judged(power)
            if reached.is_least:
                break
            power = self._with_missing(power, reached.gain)
        return power

    def judged(self, power: Array) -> Reached:
        """Criterion of powers (A,), and the bound that follows from convexity.

        For any other powers `P'`: `criterion(P') >= 2 t J - t^2 sum_a P'_a gain_a` for every t, J being that of these.
        """
        F = self.information(power)
        scale = np.sqrt(np.maximum(np.diag(F), np.finfo(float).tiny))
        inverse = np.linalg.pinv(F / np.outer(scale, scale), rcond=1e-14, hermitian=True)
        X = (inverse @ (self.quantities / scale).T) / scale[:, None]
        value = float(np.sum(self.quantities * X.T))
        squares = np.sum((self._rows @ X) ** 2, axis=1)
        gain = self.samples * squares.reshape(-1, len(power)).sum(axis=0)
        most = np.zeros(len(self.power))
        np.maximum.at(most, self.inputs, gain)
        total = np.bincount(self.inputs, power, minlength=len(self.power))
        return Reached(value, gain, value**2 / float(total @ most))

    def _descend(self, power: Array, iterations: int) -> Array:
        """Powers after some iterations, or at their minimum."""
        for _ in range(iterations):
            reached = self.judged(power)
            if reached.is_least:
                break
            power = self._normal(power * np.sqrt(reached.gain))
        return power

    def _normal(self, power: Array) -> Array:
        """Powers scaled to those that the inputs have."""
        total = np.bincount(self.inputs, power, minlength=len(self.power))
        return np.asarray(power * (self.power / np.where(total > 0, total, 1.0))[self.inputs])

    def _with_missing(self, power: Array, gain: Array) -> Array:
        """Powers with a little on lines that would lower the criterion more than those that have some."""
        power = power.copy()
        for i, size in enumerate(self.power):
            mine = self.inputs == i
            least = float(power[mine] @ gain[mine]) / size
            missing = mine & (gain > least) & (power <= _LITTLE * size)
            power[missing] += _BACK * size / max(1, int(missing.sum()))
        return self._normal(power)

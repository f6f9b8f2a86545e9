"""Sensitivities of records of plants that unmeasured forces move, with inputs or without.

The motion by forces is that of the innovations form

    y = e + sum_l 2 Re c_l x_l,        x_l+ = mu_l x_l + k_l e

at the poles of the plant.  Its shapes `c_l` and gains `k_l` are those of the new record, in which the forces may be
others: they are moved by some steps of Gauss and Newton before the poles are tested.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from ..._types import Array, ComplexArray, Indices
from ..data.channels import Recording
from ..estimates.sensitivities import RecordDerivatives, Sensitivities, directions_of, noise_of, refuse_growth
from ..uncertainty.kalman import KalmanFilter

_ROUNDS = 2  # of these steps
_HALVINGS = 6  # of each
_SAME = 1e-6  # relative difference of a step of a pole from one of the filter


def sensitivities_of(result: Any, record: Recording) -> Sensitivities:
    """Errors and derivatives of a result at a new record, whose channels are those of the result."""
    refuse_growth(result)
    derivatives = RecordDerivatives(result, record)
    noise = result.noise
    if noise is None or noise.forces is None:
        return derivatives.sensitivities()
    return _BesideForces(derivatives, result, record).sensitivities()


@dataclass(frozen=True, eq=False)
class ForcedMotion:
    """Motion by forces: multipliers (k,) of a step, not below the real axis, shapes (p, k) and gains (k, p).

    `places` (k,) are the poles of the result that the multipliers are those of; -1 for none.
    """

    multipliers: ComplexArray
    shapes: ComplexArray
    gains: ComplexArray
    places: Indices

    @classmethod
    def of(cls, filter: KalmanFilter, poles: ComplexArray, dt: float) -> ForcedMotion:
        """That of a steady filter."""
        values, vectors = np.linalg.eig(filter.A)
        gains, shapes = np.linalg.solve(vectors, filter.K.astype(complex)), filter.C @ vectors
        # what forces do not drive has no motion to be told from others
        half = (values.imag >= 0) & np.any(np.abs(gains) > _SAME * np.abs(gains).max(initial=0.0), axis=1)
        values = values[half]
        steps = np.exp(poles * dt)
        distance = np.abs(values[:, None] - steps)
        places = np.where(distance.min(axis=1, initial=np.inf) <= _SAME, distance.argmin(axis=1), -1)
        return cls(values, shapes[:, half], gains[half], places)

    @property
    def twice(self) -> Array:
        """Factor (k,) of real parts: 2 of a pair."""
        return np.where(self.multipliers.imag == 0, 1.0, 2.0)

    @property
    def filter(self) -> KalmanFilter:
        """The same as a filter of real states: real, then imaginary parts."""
        mu, c = self.multipliers, self.shapes * self.twice
        A = np.block([[np.diag(mu.real), -np.diag(mu.imag)], [np.diag(mu.imag), np.diag(mu.real)]])
        C, K = np.concatenate([c.real, -c.imag], axis=1), np.concatenate([self.gains.real, self.gains.imag])
        p = len(c)
        return KalmanFilter(A, np.zeros((len(A), 0)), C, np.zeros((p, 0)), K, np.eye(p))

    @property
    def is_stable(self) -> bool:
        """Whether its predictor forgets the past."""
        filter = self.filter
        return bool(np.abs(np.linalg.eigvals(filter.A - filter.K @ filter.C)).max(initial=0.0) < 1)

    @property
    def parts(self) -> list[tuple[int, complex]]:
        """Each multiplier with 1, and each of a pair with 1j as well."""
        pairs = self.multipliers.imag != 0
        return [(k, part) for k, pair in enumerate(pairs) for part in (1.0, 1j)[: 1 + int(pair)]]

    def moved(self, steps: Array) -> ForcedMotion:
        """The same with other shapes and gains, by steps in the order of `of_forces`."""
        p = len(self.shapes)
        shapes, gains = self.shapes.copy(), self.gains.copy()
        for row, (k, part) in zip(steps.reshape(-1, 2 * p), self.parts, strict=True):
            shapes[:, k] += part * row[:p]
            gains[k] += part * row[p:]
        return replace(self, shapes=shapes, gains=gains)

    def of_forces(self, errors: Array) -> Iterator[Array]:
        """Derivatives (p, T), before they are whitened, by shapes and gains, part by part."""
        for k, part in self.parts:
            c, state = self.shapes[:, k], _recursion(self.multipliers[k], self.gains[k] @ errors)
            for output in range(len(errors)):
                column = np.zeros(errors.shape)
                column[output] = self.twice[k] * (part * state).real
                yield column
            for error in errors:
                yield self.twice[k] * (part * np.outer(c, _recursion(self.multipliers[k], error + 0j))).real

    def of_poles(self, errors: Array, poles: ComplexArray, dt: float) -> Array:
        """The same (2n, p, T) by sizes and damping ratios of the poles."""
        derivatives = np.zeros((2 * len(poles), *errors.shape))
        for k, l in enumerate(self.places.tolist()):
            if l < 0:
                continue
            mu, p = self.multipliers[k], poles[l]
            again = _recursion(mu, _recursion(mu, self.gains[k] @ errors))
            for row, slope in zip((l, len(poles) + l), directions_of(p), strict=False):
                derivatives[row] += self.twice[k] * np.outer(self.shapes[:, k] * (slope * dt * mu), again).real
        return derivatives


@dataclass(frozen=True, eq=False)
class _BesideForces:
    """Sensitivities beside forces."""

    derivatives: RecordDerivatives
    result: Any
    record: Recording

    def sensitivities(self) -> Sensitivities:
        """Move the motion by forces to the record, and take errors and derivatives there."""
        p = len(self.record.y)
        self.derivatives.refuse_large(p)
        own_places, own = self.derivatives.of_outputs()
        # the filter mixes outputs: each unknown has all of them
        spread = np.zeros((p, len(own), *self.record.y.shape))
        outputs = np.arange(p)
        spread[outputs, :, outputs] = np.moveaxis(own, 1, 0)
        own, own_places = spread.reshape(-1, *self.record.y.shape), own_places.T.ravel()
        motion = ForcedMotion.of(self.result._beside_simulation, self.result.poles, self.record.dt)
        amplitudes = np.zeros((len(self.result.poles), p), complex)
        target = self.derivatives.simulation_errors
        if self.result.is_ambient:
            target = target - np.nanmean(target, axis=1, keepdims=True)
        for _ in range(_ROUNDS):
            whitened = self._whitened(target, motion, amplitudes, own, own_places)
            unknowns = noise_of(self.result, whitened)[2]
            if not self.result.is_ambient:
                amplitudes = self._amplitudes(unknowns, own_places)
            motion = self._next(whitened, motion, unknowns, target)
        return self._whitened(target, motion, amplitudes, own, own_places)

    def _whitened(
        self, target: Array, motion: ForcedMotion, amplitudes: ComplexArray, own: Array, own_places: Indices
    ) -> Sensitivities:
        """Whitened errors and derivatives: by poles, by what each output has, by shapes and gains."""
        filter, seen = motion.filter, self.derivatives.observed

        def whitened(values: Array) -> Array:
            visible = np.where(seen, values, np.nan)
            return np.nan_to_num(visible - filter.foretold(np.zeros((0, visible.shape[1])), visible, 1))

        errors = whitened(target)
        poles = self.result.poles
        by_poles = motion.of_poles(errors, poles, self.record.dt)
        if not self.result.is_ambient:
            by_poles = by_poles + self.derivatives.of_poles(amplitudes)
        columns = np.array([whitened(each) for each in (*by_poles, *own, *motion.of_forces(errors))])
        places = np.full(len(columns), -1)
        places[: 2 * len(poles)] = np.arange(2 * len(poles))
        places[2 * len(poles) :][: len(own_places)] = own_places
        p = len(errors)
        nothing = np.zeros((0, *errors.shape))
        return Sensitivities(errors, seen, columns, nothing, places, np.zeros((0, p), int), self.derivatives.floor)

    def _amplitudes(self, unknowns: Array, own_places: Indices) -> ComplexArray:
        """Amplitudes (n, p) of the free motion."""
        p = len(self.record.y)
        first = 2 * len(self.result.poles)
        each = unknowns[first : first + len(own_places)].reshape(p, -1)
        free = own_places.reshape(p, -1) < 0
        return np.array([self.derivatives.amplitudes(row[which]) for row, which in zip(each, free, strict=True)]).T

    def _next(self, whitened: Sensitivities, motion: ForcedMotion, unknowns: Array, target: Array) -> ForcedMotion:
        """The motion after a step of its shapes and gains, halved until the predictor is stable."""
        steps = unknowns[len(unknowns) - len(motion.parts) * 2 * len(target) :]
        for k in range(_HALVINGS):
            candidate = motion.moved(0.5**k * steps)
            if candidate.is_stable:
                return candidate
        return motion


def _recursion(multiplier: complex, drive: ComplexArray) -> ComplexArray:
    """`x[k+1] = multiplier x[k] + drive[k]` from 0."""
    return np.asarray(lfilter([0.0, 1.0], [1.0, -multiplier], drive))

"""What a new record is held against: its errors at the old parameters, and their derivatives by all that may differ.

Errors are those of the simulation, whitened by the predictor of the noise, and so are the derivatives, with that
predictor held: what a change of the predictor itself does to the errors of records with inputs has the mean 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, Mask
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ..data.channels import Recording
from ..regression.prediction import predicted_outputs, unknown_samples

_STEP = 1e-5  # of a pole over its size, and of a delay over the sampling step, in central differences
_MOST = 300_000_000  # numbers in the derivatives
_SINGULAR = 1e-9  # of the largest singular value of free motions: less is rounding
CORRELATED = 1e-11  # of the largest eigenvalue of a correlation matrix: less is rounding of a constraint
_BLIND = 1e-11  # of the squares of unit derivatives: what other unknowns do as well
_ROUNDING = 1e-9  # of the size of an output, below which its errors are no noise


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Errors of a record at the old parameters, and derivatives of its outputs, both whitened; 0 where missing.

    Attributes
    ----------
    errors : ndarray, shape (p, T)
        What the old parameters leave of the outputs.
    observed : ndarray of bool, shape (p, T)
        Which of these count.
    shared : ndarray, shape (s, p, T)
        Derivatives by unknowns that all outputs have in common.
    own : ndarray, shape (w, p, T)
        Derivatives by unknowns of which each output has its own: they are w p unknowns, output by output.
    shared_places, own_places : ndarray of int, shapes (s,) and (w, p)
        Parameter of the result that each unknown is, as in its `covariance`; -1 of what any record has for itself.
    floor : ndarray, shape (p,)
        Standard deviation of rounding.
    """

    errors: Array
    observed: Mask
    shared: Array
    own: Array
    shared_places: Indices
    own_places: Indices
    floor: Array

    @property
    def places(self) -> Indices:
        """Parameter of each unknown (s + p w,): the shared ones, then those of each output."""
        return np.concatenate([self.shared_places, self.own_places.T.ravel()])

    def products(self, weight: Array) -> tuple[Array, Array]:
        """Information (q, q) of the unknowns and score (q,) of the errors, with a weight (p, p) of the outputs."""
        s, (w, p) = len(self.shared), self.own_places.shape
        size = s + w * p
        normal, score = np.zeros((size, size)), np.zeros(size)
        weighted = np.einsum("ij,sjt->sit", weight, self.shared)
        flat = self.shared.reshape(s, -1)
        normal[:s, :s] = weighted.reshape(s, -1) @ flat.T
        errors = weight @ self.errors
        score[:s] = flat @ errors.ravel()
        for i in range(p):
            rows = slice(s + i * w, s + (i + 1) * w)
            normal[rows, :s] = self.own[:, i] @ weighted[:, i].T
            normal[:s, rows] = normal[rows, :s].T
            score[rows] = self.own[:, i] @ errors[i]
            for j in np.flatnonzero(weight[i]).tolist():
                columns = slice(s + j * w, s + (j + 1) * w)
                normal[rows, columns] = weight[i, j] * (self.own[:, i] @ self.own[:, j].T)
        return normal, score

    def rest(self, unknowns: Array) -> Array:
        """Errors (p, T) that some values (s + p w,) of the unknowns leave."""
        s, (w, p) = len(self.shared), self.own_places.shape
        each = unknowns[s:].reshape(p, w)
        return np.asarray(
            self.errors - np.einsum("s,spt->pt", unknowns[:s], self.shared) - np.einsum("pw,wpt->pt", each, self.own)
        )


def refuse_growth(result: Any) -> None:
    """Refuse a result whose simulation leaves the outputs behind."""
    if result._grows:
        raise StructureError(
            "the fit has a pole that grows, so that the simulation of a record leaves its outputs behind, and there is "
            "no score test of it: fit the new record, and use compare"
        )


def least_squares(normal: Array, gradient: Array) -> Array:
    """The least solution of normal equations that may be singular."""
    sizes = np.sqrt(np.maximum(np.diag(normal), 0.0))
    sizes = np.where(sizes > 0, sizes, 1.0)
    inverse = np.linalg.pinv(normal / np.outer(sizes, sizes), rcond=len(sizes) * EPS * 100, hermitian=True)
    return np.asarray(inverse @ (gradient / sizes) / sizes)


def known_parameters(covariance: Array) -> Indices:
    """Places of parameters that have an error."""
    variances = np.diag(covariance)
    return np.flatnonzero(np.isfinite(variances) & (variances > 0))


def root_of_covariance(covariance: Array, places: Indices) -> Array:
    """Square root (k, q) of the covariance of parameters at some places (k,).

    Its columns span what constraints on them allow; along each they have the error 1.
    """
    sizes = np.sqrt(np.diag(covariance)[places])
    values, vectors = np.linalg.eigh(covariance[np.ix_(places, places)] / np.outer(sizes, sizes))
    kept = values > CORRELATED * values.max()
    return np.asarray(sizes[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def without_others(normal: Array, gradient: Array, places: Indices, tested: Indices) -> tuple[Array, Array]:
    """Information and score of the tested parameters, where all other unknowns are those of the new record."""
    first = np.array([int(np.flatnonzero(places == place)[0]) for place in tested])
    others = np.setdiff1d(np.arange(len(places)), first)
    sizes = np.sqrt(np.maximum(np.diag(normal), 0.0))
    sizes = np.where(sizes > 0, sizes, 1.0)
    normal, gradient = normal / np.outer(sizes, sizes), gradient / sizes
    mixed, inner = normal[np.ix_(first, others)], normal[np.ix_(others, others)]
    solved = mixed @ np.linalg.pinv(inner, rcond=len(others) * EPS * 100, hermitian=True) if len(others) else mixed
    information = normal[np.ix_(first, first)] - solved @ mixed.T
    # what the other unknowns do as well is rounding of the difference
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    kept = vectors[:, values > _BLIND]
    information = kept * values[values > _BLIND] @ kept.T
    score = kept @ (kept.T @ (gradient[first] - solved @ gradient[others]))
    own = sizes[first]
    return information * np.outer(own, own), score * own


def mixes_outputs(noise: Any) -> bool:
    """Whether the noise of outputs is correlated."""
    return noise is not None and bool(np.any(noise.covariance != np.diag(np.diag(noise.covariance))))


def noise_of(result: Any, sensitivities: Sensitivities) -> tuple[Array, Array, Array]:
    """Covariance (p, p) of the noise in the new record, what all unknowns leave of it (p, T), and the unknowns."""
    p, noise = len(sensitivities.errors), result.noise
    samples = np.maximum(sensitivities.observed.sum(axis=1), 1)
    spread = np.sum(sensitivities.errors**2, axis=1) / samples + sensitivities.floor**2
    spread = np.where(spread > 0, spread, max(float(spread.max()), 1.0))
    normal, gradient = sensitivities.products(np.diag(1 / spread))
    unknowns = least_squares(normal, gradient)
    rest = sensitivities.rest(unknowns)
    share = len(sensitivities.places) / p
    spare = np.maximum(samples - share, 1.0)
    covariance = rest @ rest.T / np.sqrt(np.outer(spare, spare))
    if not mixes_outputs(noise):
        covariance = np.diag(np.diag(covariance))
    least = sensitivities.floor**2
    least = np.where(least > 0, least, float(least.max()) or 1.0)
    covariance = covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0))
    return covariance, rest, unknowns


def directions_of(p: complex) -> list[complex]:
    """Derivatives of a pole by its size, and by its damping ratio if it is one of a pair."""
    d = abs(p)
    if not p.imag:
        return [p / d if d else -1.0 + 0j]
    zeta = -p.real / d
    return [p / d, d * (-1 - 1j * zeta / np.sqrt(1 - zeta**2))]


@dataclass(frozen=True, eq=False)
class RecordDerivatives:
    """Derivatives of the outputs of a result on a record.

    Without `moving` and `offset` the record has no motion at first, and no constant, of its own.
    """

    result: Any
    record: Recording
    moving: bool = True
    offset: bool = True

    @cached_property
    def hold(self) -> Hold:
        """How the inputs meet the samples."""
        return Hold(self.record.dt, self.result.method, self.result.intersample)

    @cached_property
    def first(self) -> Indices:
        """First sample (p,) of each output that depends on nothing before the record."""
        return unknown_samples(self.result._latest, self.record.dt)

    @cached_property
    def observed(self) -> Mask:
        """Which samples (p, T) count."""
        seen = self.record.observed & (np.arange(self.record.samples) >= self.first[:, None])
        if mixes_outputs(self.result.noise):
            seen = np.broadcast_to(seen.all(axis=0), seen.shape)  # the weight of all outputs is that of whole samples
        return np.asarray(seen)

    @cached_property
    def powers(self) -> ComplexArray:
        """Free motion (n, T) of each pole, of size 1 at the first sample."""
        return self.hold.step(self.result.poles).powers(np.arange(float(self.record.samples)))

    def forced(self, poles: ComplexArray, residues: ComplexArray, through: Array, delay: Array | None = None) -> Array:
        """Outputs (p, T) of other modes from a state of zero, beside inputs that lasted before."""
        late = self.result.delay if delay is None else delay
        return predicted_outputs(
            poles, residues, through, self.record.u, self.hold, late, self.result.input_delay, lasting=True
        )

    # --- with inputs -------------------------------------------------------------------------------------------------

    def sensitivities(self) -> Sensitivities:
        """Errors of the simulation; free motion, constant and delay are those of the new record."""
        self.refuse_large(1)
        places, own = self.of_outputs()
        motion = own[np.all(places < 0, axis=1)]
        # a delay is no motion, though it may look like one
        late = int(np.any(self.result.delay_stderr > 0))
        amplitudes, errors = self._moving(motion[: len(motion) - late], self.simulation_errors)
        return self.whitened(errors, self.of_poles(amplitudes), own, places)

    @cached_property
    def simulation_errors(self) -> Array:
        """Outputs (p, T) less the simulation from rest; NaN where missing."""
        result = self.result
        forced = self.forced(result.poles, result.residues, result.feedthrough) if len(self.record.u) else 0.0
        return np.where(self.observed, self.record.y - forced, np.nan)

    def of_outputs(self) -> tuple[Indices, Array]:
        """Derivatives (w, p, T) by what each output has for itself, and their places (w, p)."""
        shape = self.record.y.shape
        every = [*self._of_residues(), *((np.full(shape[0], -1), each) for each in self._of_record())]
        return np.array([places for places, _ in every]), np.array([column for _, column in every])

    def refuse_large(self, copies: int) -> None:
        """Refuse a record whose derivatives, with so many copies of those of each output, do not fit."""
        poles, p, m = self.result.residues.shape
        unknowns = 2 * poles + copies * (2 * poles * (m + 1) + m + 3)
        if unknowns * p * self.record.samples > _MOST:
            raise StructureError(
                f"the test of {self.record.samples} samples of {p} outputs takes {unknowns * p * self.record.samples} "
                f"numbers, more than {_MOST}: pass a part of the record"
            )

    def _of_residues(self) -> Iterator[tuple[Indices, Array]]:
        """Derivatives (p, T) of each output by its own residues and feedthrough, with their places."""
        result = self.result
        count, p, m = result.residues.shape
        outputs = np.arange(p)
        nothing, still = np.zeros((count, p, m), complex), np.zeros((p, m))
        estimated = ~np.isnan(np.diag(result.covariance))
        for j in range(m):
            for l in range(count):
                parts = (0,) if result.poles[l].imag == 0 else (0, 1)
                for part in parts:
                    unit = nothing[:1].copy()
                    unit[0, :, j] = (1.0, 1j)[part]
                    places = 2 * count + part * count * p * m + (l * p + outputs) * m + j
                    yield places, self.forced(result.poles[l : l + 1], unit, still)
            places = 2 * count * (1 + p * m) + outputs * m + j
            if estimated[places].any() or result.feedthrough[:, j].any():
                through = still.copy()
                through[:, j] = 1.0
                yield places, self.forced(result.poles[:0], nothing[:0], through)

    def _of_record(self) -> Iterator[Array]:
        """Derivatives (p, T) by what each output of a record has for itself."""
        result, shape = self.result, (len(self.record.y), self.record.samples)
        real = result.poles.imag == 0
        columns = [*self.powers.real, *self.powers.imag[~real]] if self.moving else []
        columns += [np.ones(shape[1])] * self.offset
        if self.offset and any(
            np.any(getattr(data, name, 0.0)) for data in result.experiments for name in ("drift", "drifts")
        ):
            columns.append(np.arange(shape[1]) / shape[1])
        yield from (np.broadcast_to(column, shape) for column in columns)
        estimated = result.delay_stderr > 0
        if estimated.any():
            yield np.where(estimated[:, None], self._of_delay(), 0.0)

    def _of_delay(self) -> Array:
        h = _STEP * self.record.dt
        ends = [
            self.forced(self.result.poles, self.result.residues, self.result.feedthrough, self.result.delay + sign * h)
            for sign in (1, -1)
        ]
        return (ends[0] - ends[1]) / (2 * h)

    def _moving(self, columns: Array, errors: Array) -> tuple[ComplexArray, Array]:
        """Amplitudes (n, p) of the free motion, and errors without it and the constant."""
        amplitudes, rest = np.zeros((len(self.result.poles), len(errors)), complex), errors.copy()
        for o, seen in enumerate(self.observed):
            rows = columns[:, o].T
            sizes = np.linalg.norm(rows[seen], axis=0)
            rows = rows / np.where(sizes > 0, sizes, 1.0)
            x = np.linalg.lstsq(rows[seen], errors[o, seen], rcond=_SINGULAR)[0]
            rest[o] = errors[o] - rows @ x
            amplitudes[:, o] = self.amplitudes(x / np.where(sizes > 0, sizes, 1.0))
        return amplitudes, rest

    def amplitudes(self, motion: Array) -> ComplexArray:
        """Complex amplitudes (n,) of the free motion from the factors of its columns, the first of `motion`."""
        real = self.result.poles.imag == 0
        n = len(real)
        each = motion[:n].astype(complex)
        each[~real] -= 1j * motion[n : n + int(np.sum(~real))]
        return each

    def of_poles(self, amplitudes: ComplexArray) -> Array:
        """Derivatives (2n, p, T) by sizes and damping ratios of the poles."""
        count, size = len(self.result.poles), (len(self.record.y), self.record.samples)
        by_size, by_damping = np.zeros((2, count, *size))
        for l, p in enumerate(self.result.poles):
            for out, turn in zip((by_size, by_damping), directions_of(p), strict=False):
                out[l] = self._along(l, turn) + self._moved(l, turn, amplitudes[l])
        return np.concatenate([by_size, by_damping])

    def _along(self, l: int, turn: complex) -> Array:
        """Derivative (p, T) of the forced outputs as a pole moves along a direction."""
        if not len(self.record.u):
            return np.zeros(self.record.y.shape)
        p, residues = self.result.poles[l : l + 1], self.result.residues[l : l + 1]
        length = abs(turn)
        h = _STEP * max(abs(p[0]), 1 / (self.record.samples * self.record.dt)) / length
        still = np.zeros(residues.shape[1:])
        ends = [self.forced(p + sign * h * turn, residues, still) for sign in (1, -1)]
        return (ends[0] - ends[1]) / (2 * h)

    def _moved(self, l: int, turn: complex, amplitude: ComplexArray) -> Array:
        """Derivative (p, T) of the free motion as a pole moves along a direction."""
        t = self.record.dt * np.arange(self.record.samples)
        if self.hold.method != "exact":
            h = _STEP * abs(self.result.poles[l]) / abs(turn)
            ends = [self.hold.step(self.result.poles[l : l + 1] + sign * h * turn) for sign in (1, -1)]
            k = np.arange(float(self.record.samples))
            slope = (ends[0].powers(k)[0] - ends[1].powers(k)[0]) / (2 * h)
            return np.asarray((amplitude[:, None] * slope).real)
        return np.asarray((amplitude[:, None] * (turn * t * self.powers[l])).real)

    # --- whitening ---------------------------------------------------------------------------------------------------

    @property
    def floor(self) -> Array:
        """Standard deviation (p,) of rounding."""
        return _ROUNDING * np.sqrt(np.nanmean(np.where(self.observed, self.record.y, np.nan) ** 2, axis=1))

    def whitened(self, errors: Array, shared: Array, own: Array, own_places: Indices) -> Sensitivities:
        """Errors (p, T) and derivatives, by shared unknowns (s, p, T) and those of each output, whitened."""
        noise, seen = self.result.noise, self.observed

        def innovations(values: Array) -> Array:
            visible = np.where(seen, values, np.nan)
            return np.nan_to_num(self.result._innovations(visible, self.record.dt))

        if noise is not None and not noise.is_white:
            errors, *columns = [innovations(values) for values in (errors, *shared, *own)]
            shared, own = np.array(columns[: len(shared)]), np.array(columns[len(shared) :]).reshape(own.shape)
        else:
            errors, shared, own = (np.where(seen, values, 0.0) for values in (errors, shared, own))
        return Sensitivities(errors, seen, shared, own, np.arange(len(shared)), own_places, self.floor)

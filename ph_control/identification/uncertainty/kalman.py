"""The steady Kalman filter of a plant with its noise, and what it foretells of a record.

The plant is in continuous time, seen at the samples: held or linear inputs, and outputs that come later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import control as ct
import numpy as np
from scipy.linalg import block_diag, expm
from scipy.signal import lfilter

from ..._types import Array, Mask
from ...exceptions import StructureError
from ...modal.discretization import Hold, MatrixStep
from ...modal.propagation import step_through
from ..regression.time_rows import WHOLE
from .noise_model import NoiseModel, intensity_of

_UNSTABLE = 1e-8  # beyond the unit circle: about what a Riccati equation in doubles can tell from a pole on it
_FLOOR = 1e-14  # of the largest variance: an output without noise would leave equations singular

_FAILED = (ValueError, ArithmeticError, RuntimeError, Warning, np.linalg.LinAlgError)  # of scipy, or slycot

Matrices = tuple[Array, Array, Array, Array]


@dataclass(frozen=True)
class NoisyPlant:
    """`x+ = A x + B u + w + E e`, `y = C x + D u + e` with covariances `forces` of w, R of e, and `cross` of both.

    States are those of the plants, then registers of inputs, then the motion by forces where outputs have different
    delays, then the past of the colours; `E` takes the newest sample of a coloured noise into its past.  `moving` (n,)
    are the states that forces drive, or that grow: of all other states of plants the inputs tell everything, once the
    beginning has died away.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    E: Array
    R: Array
    forces: Array
    cross: Array
    moving: Mask

    @classmethod
    def of(cls, system: Matrices, noise: NoiseModel, hold: Hold, delay: Array) -> NoisyPlant:
        """Sample a plant in continuous time and join its noise; delays are those of the inputs."""
        plant = _sampled_plant(*system, hold, delay)
        (p, m), n, orders = plant.D.shape, plant.order, noise.orders
        own = noise.states if noise.apart else None
        apart = own is not None or (noise.forces is not None and plant.plants > 1)  # forces act on all outputs at once
        step, seen = (plant.A[:n, :n], system[2]) if own is None else own
        first, second = len(plant.A), len(plant.A) + len(step) * apart
        by_forces = slice(first, second) if apart else slice(0, n)
        coefficients = np.zeros((p, 0)) if noise.colours is None else noise.colours
        colours = [row[:order] for row, order in zip(coefficients, orders, strict=True)]
        A = block_diag(plant.A, *[step] * apart, *map(_companion, colours))
        C = np.concatenate([plant.C, *[seen] * apart, block_diag(*(row[None] for row in colours))], axis=1)
        count = len(A)
        B, E = np.concatenate([plant.B, np.zeros((count - first, m))]), np.zeros((count, p))
        newest, coloured = second + np.cumsum((0, *orders[:-1])), np.flatnonzero(orders)
        E[newest[coloured], coloured] = 1.0
        moving = np.zeros(count, bool)
        moving[: n * plant.plants] = np.tile(growing(plant.A[:n, :n]), plant.plants)
        if apart and moving.any():
            raise StructureError(
                "forces, outputs with different delays, and a pole that grows have no predictor of this form: give "
                "all outputs one delay"
            )
        forces, cross = np.zeros((count, count)), np.zeros((count, p))
        if noise.forces is not None:
            forces[by_forces, by_forces] = noise.forces
            moving[by_forces] |= _of_parts(step, np.diag(noise.forces) > 0)
            cross[by_forces] = 0.0 if noise.cross is None else noise.cross
        return cls(A, B, C, plant.D, E, noise.covariance, forces, cross, moving)

    @property
    def Q(self) -> Array:
        """Covariance (n, n) of all that drives the states."""
        mixed = self.cross @ self.E.T
        return self.forces + self.E @ self.R @ self.E.T + mixed + mixed.T

    @property
    def S(self) -> Array:
        """Covariance (n, p) of that with the white noise of the outputs."""
        return self.cross + self.E @ self.R

    def steady(self) -> KalmanFilter:
        """The filter that is left when the beginning is forgotten."""
        gain, spread = self.E.copy(), self.R
        if self.moving.any():
            which = self.moving | _past_of(self)
            part = np.ix_(which, which)
            # the newest sample of a coloured noise is what an output shows beside the plant
            A, C = (self.A - self.E @ self.C)[part], self.C[:, which]
            more, spread = steady_gain(A, C, self.forces[part], self.R, self.cross[which])
            gain[which] += more
        return KalmanFilter(self.A, self.B, self.C, self.D, gain, spread)


@dataclass(frozen=True)
class KalmanFilter:
    """`x+ = A x + B u + K e`, `y = C x + D u + e`: e is what could not be foretold, of covariance `spread` (p, p)."""

    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    spread: Array

    @property
    def predictor(self) -> Matrices:
        """Matrices of the system from inputs and outputs to the outputs that are foretold one step ahead."""
        through = np.concatenate([self.D, np.zeros((len(self.C),) * 2)], axis=1)
        return (
            self.A - self.K @ self.C, np.concatenate([self.B - self.K @ self.D, self.K], axis=1), self.C, through,
        )  # fmt: skip

    def foretold(self, u: Array, y: Array, horizon: int, start: Array | None = None) -> Array:
        """Outputs (p, T) foretold so many steps ahead, from a state at the first sample; with NaN nothing is learned.

        Before so many samples have passed, what is foretold follows from that state.  O(T n (n + horizon n)).
        """
        states = self._states(u, y, start)
        late = min(horizon - 1, u.shape[1] - 1)
        # from the state that samples up to k - horizon tell, with the inputs since then
        ahead = states[:, : u.shape[1] - late]
        beginning = [ahead[:, 0]]
        for k in range(late):
            beginning.append(self.A @ beginning[-1] + self.B @ u[:, k])
            ahead = self.A @ ahead + self.B @ u[:, k : u.shape[1] - late + k]
        both = np.concatenate([np.array(beginning[:-1]).reshape(late, len(self.A)).T, ahead], axis=1)
        return np.asarray(self.C @ both + self.D @ u)

    def _states(self, u: Array, y: Array, start: Array | None) -> Array:
        """States (n, T) at each sample, as the samples before it tell."""
        A, B, _, _ = self.predictor
        if not np.isnan(y).any():
            return step_through(MatrixStep(A, 0 * A, B, 0 * B), np.concatenate([u, y]), start)
        states = np.zeros((len(A), u.shape[1]))
        states[:, 0] = 0.0 if start is None else start
        drive, known = self.B @ u, ~np.isnan(y)
        rest = np.where(known, y - self.D @ u, 0.0)
        for k in range(u.shape[1] - 1):
            x = states[:, k]
            states[:, k + 1] = self.A @ x + drive[:, k] + self.K @ np.where(known[:, k], rest[:, k] - self.C @ x, 0.0)
        return states

    def likely_start(self, u: Array, y: Array, offset: bool) -> tuple[Array, Array]:
        """State at the first sample, and constant of each output, that leave the least to be told; O(T n^2 p)."""
        n, p = len(self.A), len(self.C)
        nothing = np.where(np.isnan(y), np.nan, 0.0)
        columns = [nothing - self.foretold(0 * u, nothing, 1, unit) for unit in np.eye(n)]
        if offset:
            columns += [each - self.foretold(0 * u, each, 1) for each in nothing + np.eye(p)[:, :, None]]
        known = ~np.isnan(y)
        weights = np.linalg.inv(np.linalg.cholesky(floored(self.spread)))
        remaining = y - self.foretold(u, y, 1)
        rows = np.array([weights @ np.where(known, each, 0.0) for each in (*columns, remaining)]).reshape(
            len(columns) + 1, -1
        )
        sizes = np.linalg.norm(rows[:-1], axis=1)
        sizes = np.where(sizes > 0, sizes, 1.0)
        best = -np.linalg.lstsq((rows[:-1] / sizes[:, None]).T, rows[-1], rcond=None)[0] / sizes
        return best[:n], -best[n:] if offset else np.zeros(p)


def steady_gain(A: Array, C: Array, Q: Array, R: Array, S: Array) -> tuple[Array, Array]:
    """Gain `K` of the steady filter `x+ = A x + K (y - C x)`, and the covariance of what it cannot foretell."""
    outputs, states = _units(C, R)
    A, C, Q = A / states[:, None] * states, C * states / outputs[:, None], Q / np.outer(states, states)
    R, S = floored(R / np.outer(outputs, outputs)), S / states[:, None] / outputs
    P = _solution(ct.dare, A.T, C.T, Q, R, S)
    spread = C @ P @ C.T + R
    gain = np.linalg.solve(spread, (A @ P @ C.T + S).T).T
    return gain * states[:, None] / outputs, spread * np.outer(outputs, outputs)


def continuous_gain(A: Array, C: Array, noise: NoiseModel) -> Array:
    """Gain `L` of the filter `x' = A x + B u + L (y - C x - D u)` in continuous time; 0 of what nothing moves."""
    n, p = len(A), len(C)
    gain, h = np.zeros((n, p)), noise.dt
    if noise.cross is not None and noise.forces is not None:
        step = expm(A * h)
        discrete, _ = steady_gain(step, C, noise.forces, noise.covariance, noise.cross)
        # the gain whose error dies away from sample to sample as that of the discrete filter
        poles, vectors = np.linalg.eig(step - discrete @ C)
        rates = np.log(np.where(poles == 0, np.finfo(float).tiny, poles).astype(complex))
        closed = np.linalg.solve(vectors.T, (vectors * rates).T).T
        return np.asarray(np.linalg.lstsq(C.T, (A - np.real(closed) / h).T, rcond=None)[0].T)
    Q = np.zeros((n, n)) if noise.forces is None else intensity_of(A, noise.forces, h)
    rates = np.array([np.linalg.eigvals(A[np.ix_(part, part)]).real.max() for part in _parts(A)])
    which = (rates * h > _UNSTABLE) | _of_parts(A, np.diag(Q) > 0)
    if not which.any():
        return gain
    outputs, states = _units(C[:, which], noise.covariance * h)
    part = np.ix_(which, which)
    R = floored(noise.covariance * h / np.outer(outputs, outputs))
    A, Q = A[part] / states[:, None] * states, Q[part] / np.outer(states, states)
    C = C[:, which] * states / outputs[:, None]
    P = _solution(ct.care, A.T, C.T, Q, R)
    gain[which] = np.linalg.solve(R, (P @ C.T).T).T * states[:, None] / outputs
    return gain


def foretold_colour(colours: Array, noise: Array, horizon: int) -> Array:
    """Noise (p, T) of each output foretold so many steps ahead by its autoregression (p, q); 0 before the record.

    A sample that is missing counts as what was foretold of it one step ahead.  O(T p q).
    """
    values, ahead = noise.copy(), np.zeros(noise.shape)
    late = min(horizon - 1, noise.shape[1])
    for row, coefficients, out in zip(values, colours, ahead, strict=True):
        order = len(coefficients)
        for k in np.flatnonzero(np.isnan(row)).tolist():
            past = row[max(0, k - order) : k][::-1]
            row[k] = past @ coefficients[: len(past)]
        weights = np.linalg.matrix_power(_companion(coefficients), late + 1)[0]
        out[late:] = lfilter(np.append(0.0, weights), 1.0, row)[: noise.shape[1] - late]
    return ahead


def _companion(coefficients: Array) -> Array:
    """Step of the past (q,) of an autoregression, the last sample first."""
    step = np.eye(len(coefficients), k=-1)
    step[:1] = coefficients
    return step


def floored(R: Array) -> Array:
    """A covariance that is not singular: of outputs without noise a rounding of that of others, or the identity."""
    largest = float(np.diag(R).max(initial=0.0))
    return R + _FLOOR * largest * np.eye(len(R)) if largest > 0 else np.eye(len(R))


def _solution(solve: Callable[..., Any], *matrices: Array) -> Array:
    """Stabilising solution of a Riccati equation."""
    try:
        return np.asarray(solve(*matrices)[0])
    except _FAILED as error:
        raise StructureError(
            "the Riccati equation of the filter has no stabilising solution: outputs do not show a pole that grows or "
            f"that forces drive, or a pole that nothing drives is on the stability border ({error})"
        ) from None


def _units(C: Array, R: Array) -> tuple[Array, Array]:
    """Units of the outputs (p,), in which their noise has variance 1, and of states (n,), whose effect is about 1."""
    outputs = np.sqrt(np.diag(floored(R)))
    effects = np.linalg.norm(C / outputs[:, None], axis=0)
    return outputs, 1 / np.where(effects > 0, effects, 1.0)


def _past_of(plant: NoisyPlant) -> Mask:
    """States (n,) that hold the past of a coloured noise."""
    first = np.flatnonzero(plant.E.any(axis=1))
    return np.arange(len(plant.A)) >= first.min(initial=len(plant.A))


def _parts(A: Array) -> list[Mask]:
    """For each state (n,), those that act on one another with it."""
    from scipy.sparse.csgraph import connected_components

    labels = connected_components(A != 0, directed=False)[1]
    return [labels == label for label in labels]


def growing(step: Array) -> Mask:
    """Whether each state of a step (n, n) belongs to a part that grows."""
    sizes = [np.abs(np.linalg.eigvals(step[np.ix_(part, part)])).max() for part in _parts(step)]
    return np.array(sizes) > 1 + _UNSTABLE if sizes else np.zeros(0, bool)


def _of_parts(A: Array, some: Mask) -> Mask:
    """The states of all parts that some states belong to."""
    return np.array([bool(some[part].any()) for part in _parts(A)]) if len(A) else some


@dataclass(frozen=True)
class SampledPlant:
    """`x[k+1] = A x[k] + B u[k]`, `y[k] = C x[k] + D u[k]`: the plant, then registers of inputs of earlier samples.

    Outputs of different delays have a plant of their own each, one after the other: `plants` of `order` states.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    order: int
    plants: int


def _sampled_plant(A: Array, B: Array, C: Array, D: Array, hold: Hold, delay: Array) -> SampledPlant:
    """Sample `x' = A x + B u`, `y(t) = (C x + D u)(t - delay)` with a delay (p,) of each output, exactly.

    An input that is held, or linear between samples, and late by `(k + f) h` is two or three of its samples.
    """
    (n, m), p = B.shape, len(C)
    late = np.unique(delay)
    taps = [_Taps.of(A, B, hold, float(each), bool(D[delay == each].any())) for each in late]
    longest = max(max(each.last for each in taps), 0)
    count = len(late) * n
    whole_A = np.zeros((count + longest * m,) * 2)
    whole_B, whole_C, through = np.zeros((len(whole_A), m)), np.zeros((p, len(whole_A))), np.zeros((p, m))
    for g, (each, part) in enumerate(zip(late, taps, strict=True)):
        rows, own = np.flatnonzero(delay == each), slice(g * n, (g + 1) * n)
        step = part.step
        # what an input does to the state at its own sample is no part of the state
        at_once = part.driven.get(-1, np.zeros((n, m)))
        whole_A[own, own], whole_C[rows, own] = step, C[rows]
        whole_B[own] = step @ at_once + part.driven.get(0, np.zeros((n, m)))
        through[rows] = C[rows] @ at_once + part.direct.get(0, 0.0) * D[rows]
        for k in range(1, longest + 1):
            register = slice(count + (k - 1) * m, count + k * m)
            whole_A[own, register] = part.driven.get(k, 0.0)
            whole_C[rows, register] = part.direct.get(k, 0.0) * D[rows]
    if longest:
        whole_B[count : count + m] = np.eye(m)
        earlier = count + np.arange((longest - 1) * m)
        whole_A[earlier + m, earlier] = 1.0
    return SampledPlant(whole_A, whole_B, whole_C, through, n, len(late))


@dataclass(frozen=True)
class _Taps:
    """What the inputs k samples before do in a step: to the states (n, m), `driven[k]`, and to outputs, `direct[k]`."""

    step: Array
    driven: dict[int, Array]
    direct: dict[int, float]

    @property
    def last(self) -> int:
        """The earliest sample that counts, as a number of samples before."""
        return max([*self.driven, *self.direct], default=0)

    @classmethod
    def of(cls, A: Array, B: Array, hold: Hold, delay: float, fed: bool) -> _Taps:
        samples = delay / hold.h
        whole = int(np.ceil(samples - WHOLE))
        # of the step after the sample `whole` before
        part = whole - samples if whole - samples > WHOLE else 0.0
        if part and hold.method != "exact":
            raise StructureError(
                f"a delay of {delay:.6g} is no whole number of steps of {hold.h:.6g}, and method={hold.method!r} says "
                "nothing of what is between samples"
            )
        linear = hold.intersample == "foh"
        full = hold.step_of_matrices(A, B)
        step = full.F + full.rest
        if not part:
            driven = {whole: full.held - full.risen, whole - 1: full.risen}
        else:
            before, after = (replace(hold, h=share * hold.h).step_of_matrices(A, B) for share in (1 - part, part))
            carried = after.F + after.rest
            first, last = carried @ (before.held - before.risen), carried @ before.risen
            second, ahead = after.held - after.risen, after.risen
            # from the input at the beginning to that at the sample, and from there to that at the end
            driven = {
                whole: (1 - part * linear) * first,
                whole - 1: part * linear * first + last + second + (1 - part) * linear * ahead,
                whole - 2: part * linear * ahead,
            }
        direct = {whole: 1 - part * linear, whole - 1: part * linear} if fed else {}
        used = {k: matrix for k, matrix in driven.items() if matrix.any()}
        taps = cls(step, used, {k: share for k, share in direct.items() if share})
        if min(taps.driven, default=0) < -1 or min(taps.direct, default=0) < 0:
            raise StructureError(
                f"an output comes {-delay:.6g} before the response to the inputs, which at a step of {hold.h:.6g} and "
                f"intersample={hold.intersample!r} depends on inputs that are not known yet: shift the inputs of the "
                "record"
            )
        return taps

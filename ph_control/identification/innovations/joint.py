"""The data about the minimum beside noise of any kind: what poles and residues cost there, all else moving along.

That the noise is estimated from the same record adds to the covariance of the plant.

The covariance `Phi = (X^T V^{-1} X)^{-1}` of generalised least squares holds for a noise `V` that is known.  An
estimated `V` weighs a little wrongly, and the maximum of the likelihood finds the noise too small where the numbers of
the plant have followed it: in narrow modes, whose noise few bins of the spectrum show, that is a quarter of a variance.
To second order (Kackar and Harville 1984, Kenward and Roger 1997), with `E_i = -V^{1/2} (dV^{-1}/dtheta_i) V^{1/2}`
and coordinates of the noise in which the covariance of `theta` is 1,

    Phi + Phi [ 2 sum_i (Q_i - P_i Phi P_i) + sum_i tr(Phi P_i) P_i / 2 ] Phi,
    P_i = -X^T V^{-1/2} E_i V^{-1/2} X,    Q_i = X^T V^{-1/2} E_i E_i V^{-1/2} X.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ..regression.free import FreeProjection, FreeRows, GivenResidues, Sensitivity
from ..regression.sections import Sections
from .minimum import LikelihoodEvaluation, Minimum

_UNTOLD = 0.01  # of what the data tell of the plant, at most, in bins that are left out
_DIRECTIONS = 96  # of the noise; of more, so many random combinations stand for all
_LARGEST_ERROR = 3.0  # of noise in a bin over itself, of which errors count the square
_RULE = 1e-10  # of the largest eigenvalue of a covariance


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The likelihood about its maximum as a square `|R (theta - centre)|^2` of poles and shared unknowns.

    `centre` are imaginary and real parts of the poles, then shared unknowns by outputs; `covariance` is their
    covariance. Unknowns of each part of rows follow: `inner` is their covariance for known `theta`, `along` how they
    move with it.
    """

    centre: Array
    root: Array
    covariance: Array
    own: tuple[Array, ...]
    inner: tuple[Array, ...]
    along: tuple[Array, ...]

    @classmethod
    def of(cls, minimum: Minimum) -> Quadratic:
        """The square about a minimum."""
        evaluation = minimum.evaluation
        problem, point = evaluation.problem, evaluation.point
        sections, active = point.noise.sections, problem.active
        size, every = len(sections.x), with_estimated_noise(evaluation, evaluation.information_inverse())
        first, count = problem.numbers_before_shared(point.noise), int(active.sum())
        kept = np.append(np.arange(size), first + np.arange(count))
        poles, shared = sections.pole_slopes, point.shared
        T = np.zeros((len(poles) + shared.size, size + count))
        T[: len(poles), :size] = poles
        numbers = np.arange(shared.size).reshape(shared.shape[::-1]).T[active]
        T[len(poles) + numbers, size + np.arange(count)] = 1.0
        inner = every[np.ix_(kept, kept)]
        information = np.linalg.pinv(inner, rcond=1e-13, hermitian=True)
        values, vectors = np.linalg.eigh(0.5 * (information + information.T))
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).T @ np.linalg.pinv(T)
        own, spreads, along, first = list[Array](), list[Array](), list[Array](), first + count
        for part in point.own:
            mine = np.arange(first, first + part.size)
            moved = every[np.ix_(mine, kept)] @ information
            own.append(part)
            spreads.append(every[np.ix_(mine, mine)] - moved @ every[np.ix_(kept, mine)])
            along.append(moved @ np.linalg.pinv(T))
            first += part.size
        centre = np.concatenate([sections.p.imag, sections.p.real, shared.T.ravel()])
        return cls(centre, root, T @ inner @ T.T, tuple(own), tuple(spreads), tuple(along))


class JointProjection(GivenResidues):
    """Data at some poles and shared unknowns, at the loss that these have beside noise of any kind.

    Rows have variance 1 at the minimum.  With more or fewer poles, or real ones in place of complex ones, no square
    tells the loss: then it is that of white noise, in units of the `variance` that this has at the minimum.
    """

    def __init__(
        self, projection: FreeProjection, shared: Array, quadratic: Quadratic, unknowns: int, variance: float
    ) -> None:
        super().__init__(projection, shared)
        self.quadratic, self._unknowns, self._variance = quadratic, unknowns, variance

    @classmethod
    def of(cls, projection: FreeProjection, shared: Array, quadratic: Quadratic, unknowns: int) -> JointProjection:
        """The data at the minimum."""
        variance = GivenResidues(projection, shared).loss / projection.rows
        return cls(projection, shared, quadratic, unknowns, variance)

    @property
    def unknowns(self) -> int:
        """Number of real unknowns, those of the noise among them."""
        return self._unknowns

    def with_unknowns(
        self, p: ComplexArray, shared: Array, sections: Sections | None = None,
        experiments: Sequence[FreeRows] | None = None,
    ) -> GivenResidues:  # fmt: skip
        """The same data at other poles and shared unknowns."""
        free = FreeProjection(self.experiments if experiments is None else experiments, p, self.fed, sections)
        return JointProjection(free, shared, self.quadratic, self._unknowns, self._variance)

    @cached_property
    def _moved(self) -> Array | None:
        """How far poles and shared unknowns are from the minimum; None where the poles are of other kinds."""
        moved = np.concatenate([self.p.imag, self.p.real, self.shared.T.ravel()])
        n, known = len(self.p), len(self.quadratic.centre) - self.shared.size
        alike = 2 * n == known and np.array_equal(self.quadratic.centre[:n] != 0, self.p.imag != 0)
        return moved - self.quadratic.centre if alike else None

    @cached_property
    def loss(self) -> float:
        """What is left at the minimum, of variance 1, and what the distance from it costs."""
        if self._moved is None:
            return super().loss / self._variance
        return float(self.rows + np.sum((self.quadratic.root @ self._moved) ** 2))

    def sensitivities(self) -> Iterator[Sensitivity]:
        """All outputs, what the distance leaves, and its derivatives by poles and shared unknowns."""
        if self._moved is None:
            unit = np.sqrt(self._variance)
            for outputs, residual, by_poles, by_shared in super().sensitivities():
                yield outputs, residual / unit, by_poles / unit, by_shared / unit
            return
        root, n = self.quadratic.root, len(self.p)
        yield list(range(self.shared.shape[1])), root @ self._moved, root[:, : 2 * n], root[:, 2 * n :]

    def covariance(self, variance: float) -> Array:
        """Covariance of imaginary and real parts of the poles, then `shared` by outputs."""
        return variance * self.quadratic.covariance

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment, shape (unknowns, its outputs)."""
        if self._moved is None:
            return super().own
        pairs = zip(self.quadratic.own, self.quadratic.along, strict=True)
        moved = self._moved
        return [mine + (along @ moved).reshape(mine.shape) for mine, along in pairs]

    def own_covariances(self, experiment: int, covariance: Array, variance: float) -> list[tuple[Array, Array]]:
        """Covariances of what belongs to an experiment, for each output, and with the poles and what `shared` has."""
        mine, rows = self.quadratic.own[experiment], self.experiments[experiment]
        n, width, pairs = len(self.p), len(self.shared), []
        for k, output in enumerate(rows.outputs.tolist()):
            these = np.arange(len(mine)) * mine.shape[1] + k
            along = self.quadratic.along[experiment][these]
            places = np.append(np.arange(2 * n), 2 * n + output * width + np.arange(width)).astype(int)
            crossed = along @ covariance
            spread = variance * self.quadratic.inner[experiment][np.ix_(these, these)] + crossed @ along.T
            pairs.append((spread, crossed[:, places]))
        return pairs


@dataclass(frozen=True)
class _Bins:
    """Some bins: whitened derivatives (bins, p, P) of the mean, and the factors of derivatives of the noise.

    With `V = H L L^T H^*`: `whitening` is `L^{-1} H^{-1}` (bins, p, p), `states` are `(z - A)^{-1} K L` (bins, N, p),
    `seen` is `L^{-1} H^{-1} C (z - A)^{-1}` (bins, p, N).
    """

    mean: ComplexArray
    whitening: ComplexArray
    states: ComplexArray
    seen: ComplexArray

    def slope(self, A: Array, C: Array, K: Array, root: Array) -> ComplexArray:
        """The matrices `E` (bins, p, p) of a direction in `A` (N,), on its diagonal, `C` (p, N) and `K` (N, p)."""
        half = self.whitening @ (C @ self.states) + self.seen @ (A[:, None] * self.states + K @ root)
        return np.asarray(half + half.conj().transpose(0, 2, 1))


def with_estimated_noise(evaluation: LikelihoodEvaluation, covariance: Array) -> Array:
    """Covariance of all numbers of a model, given that for known noise, where noise comes through the plant."""
    problem, noise = evaluation.problem, evaluation.point.noise
    if not problem.coloured or not any(experiment.rows for experiment in problem.experiments):
        return covariance
    few, first = len(noise.sections.x), problem.numbers_before_shared(noise)
    plant = np.append(np.arange(few), np.arange(first, len(covariance)))
    values, vectors = np.linalg.eigh(covariance[np.ix_(plant, plant)])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    bins = _telling_bins(evaluation, plant, root)
    X = bins.mean
    flat = np.concatenate([X.real, X.imag]).reshape(-1, X.shape[2])
    spread, twice = X @ X.conj().transpose(0, 2, 1), np.zeros((len(plant), len(plant)))
    every: ComplexArray = np.zeros(spread.shape, complex)
    downwards: ComplexArray = np.zeros(spread.shape, complex)
    slopes = partial(_slopes, evaluation, bins, covariance[few:first, few:first])
    # where noise is hardly anything its relative error has no bound, and the second order tells nothing
    relative = np.sqrt(sum(np.sum(np.abs(E) ** 2, axis=(1, 2)) for E in slopes()))
    known = _LARGEST_ERROR / np.maximum(_LARGEST_ERROR, relative)[:, None, None]
    for slope in slopes():
        E = known * slope
        through = E @ X
        P = flat.T @ np.concatenate([through.real, through.imag]).reshape(flat.shape)
        every = every + E @ E
        twice = twice + P @ P
        downwards += float(np.sum(E * spread.conj()).real) * E
    added = 2 * (_gram(X, every) - twice) + 0.5 * _gram(X, downwards)
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    changed = covariance.copy()
    changed[np.ix_(plant, plant)] += root @ (vectors * np.maximum(values, 0.0)) @ vectors.T @ root.T
    return changed


def _gram(X: ComplexArray, weights: ComplexArray) -> Array:
    """Sum of `X^* W X` over bins, real part."""
    weighed = weights @ X
    return np.asarray(np.tensordot(X.conj(), weighed, ([0, 1], [0, 1])).real)


def _telling_bins(evaluation: LikelihoodEvaluation, plant: Indices, root: Array) -> _Bins:
    """Bins of all experiments that tell of the plant; derivatives of the mean by numbers of covariance 1."""
    noise, L = evaluation.point.noise, np.linalg.cholesky(evaluation.covariance)
    least = _UNTOLD * len(plant) / sum(len(experiment.z) for experiment in evaluation.problem.experiments)
    parts = []
    for place, experiment in enumerate(evaluation.problem.experiments):
        for bins, counts in evaluation.thinned(experiment):
            z = experiment.z[bins]
            mean, whitening, seen = evaluation.slopes_of_mean(place, bins)
            gains = np.repeat(noise.K[:, :, None].astype(complex), len(z), axis=2)
            states = noise.resolve(z, gains).transpose(2, 0, 1) @ L
            mean = np.sqrt(counts)[:, None, None] * (mean[:, :, plant] @ root)
            # at frequency zero an output has its constant, of which noise that has nothing there would tell all
            telling = (np.sum(np.abs(mean) ** 2, axis=(1, 2)) > least) & experiment.moving[bins]
            parts.append(tuple(each[telling] for each in (mean, whitening, states, seen)))
    return _Bins(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _slopes(evaluation: LikelihoodEvaluation, bins: _Bins, covariance: Array) -> Iterator[ComplexArray]:
    """Matrices `E` (bins, p, p) of directions of the noise that have covariance 1: lags, shapes, gains, then sizes."""
    noise = evaluation.point.noise
    (p, N), lags = noise.C.shape, len(noise.lags)
    L = np.asarray(np.linalg.cholesky(evaluation.covariance), float)
    values, vectors = np.linalg.eigh(covariance)
    kept = values > _RULE * values.max(initial=0.0)
    directions = vectors[:, kept] * np.sqrt(values[kept])
    if directions.shape[1] > _DIRECTIONS:
        mixed = np.random.default_rng(0).standard_normal((directions.shape[1], _DIRECTIONS))
        directions = directions @ mixed / np.sqrt(_DIRECTIONS)
    slopes = np.concatenate([np.zeros(N - lags), -noise.step * np.exp(-noise.lags * noise.step)])
    for direction in directions.T:
        of_lags, C, K = np.split(direction, [lags, lags + p * N])
        along = slopes * np.append(np.zeros(N - lags), of_lags)
        yield bins.slope(along, C.reshape(p, N), K.reshape(N, p), L)
    for a in range(p):
        for b in range(a + 1):
            size = np.zeros((p, p))
            size[a, b] = size[b, a] = np.sqrt((1.0 if a != b else 2.0) / evaluation.problem.samples)
            yield np.broadcast_to(size.astype(complex), (len(bins.mean), p, p))

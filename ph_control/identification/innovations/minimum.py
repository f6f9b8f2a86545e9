"""The minimum of the prediction errors over plant and noise together.

    y = G u + free motion + H e,    e ~ N(0, Sigma):    minimise log det of the mean of e e^T,  e = H^{-1} (y - ...)

in Fourier bins of the whole record, where `H` is a matrix for each bin.  What a record's ends leave of the filters is
free motion of the predictor, which free motions of each output, or those of the states, take up: so the bins say what
the samples say, to rounding.  Poles, residues, free motions, `C` and `K` move together (Gauss-Newton, with Levenberg's
damping); the covariance is the one that the prediction errors have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from ..._checks import EPS
from ..._heartbeat import alive
from ..._types import Array, ComplexArray, Indices, Mask
from ..regression.free import input_places
from ..regression.sections import Sections
from ..regression.time_rows import FreeRecord
from .noise_sections import NoiseSections, bins_of

_AT_A_TIME = 1 << 20  # numbers of a Jacobian
_BINS = 1 << 13  # of an experiment that the information is made of
_IN_WIDTH = 4.0  # of these at least lie within the half-power width of each mode
_ROUNDS = 3  # of linear numbers and the covariance in turn
_STEPS = 60
_APART = 1e-4  # of their distance from 0: so near to one another poles of a section come
_GROWTH, _LARGEST_DAMPING = 4.0, 1e8
_LARGEST_GROWTH = 50.0  # logarithm of how much larger a motion may be at the end of a record: few doubles hold both


@dataclass(frozen=True, eq=False)
class DrivenPart:
    """Outputs of one experiment that share their columns, in Fourier bins: see `FreeRecord`.

    `columns` (c, bins) are those of the own and of the shared unknowns, `derivatives` those by the poles.
    """

    rows: FreeRecord
    columns: ComplexArray
    derivatives: ComplexArray
    own: int

    def at_bins(self, bins: slice) -> DrivenPart:
        """The same in some of the bins."""
        return replace(self, columns=self.columns[:, bins], derivatives=self.derivatives[:, bins])


@dataclass(frozen=True, eq=False)
class Experiment:
    """Outputs (p, T) of an experiment in Fourier bins, and the rows of what is driven or moves freely, if any."""

    z: ComplexArray
    counts: Array
    Y: ComplexArray
    rows: tuple[FreeRecord, ...] = ()
    missing: Mask | None = None

    @classmethod
    def of_outputs(cls, y: Array, rows: Sequence[FreeRecord] = (), missing: Mask | None = None) -> Experiment:
        """An experiment with outputs (p, T), some of which are values in place of `missing` ones."""
        T = y.shape[1]
        bins = np.arange(T // 2 + 1)
        counts = np.where((bins == 0) | (2 * bins == T), 1.0, 2.0)
        return cls(bins_of(T, beside=False), counts, np.fft.rfft(y) / np.sqrt(T), tuple(rows), missing)

    @classmethod
    def of_rows(cls, rows: Sequence[FreeRecord]) -> Experiment:
        """An experiment with the outputs of some rows, all of the same samples."""
        y = np.empty((1 + max(int(part.outputs.max()) for part in rows), rows[0].length))
        missing = np.zeros(y.shape, bool)
        for part in rows:
            y[part.outputs], missing[part.outputs] = part.measured, False if part.filled is None else part.filled
        return cls.of_outputs(y, rows, missing if missing.any() else None)

    @property
    def samples(self) -> int:
        """Number of samples of each output."""
        return round(self.counts.sum())

    @property
    def moving(self) -> Mask:
        """Bins but for that of frequency zero."""
        return np.arange(len(self.z)) > 0

    @property
    def measured(self) -> int:
        """Number of samples that were measured, of the outputs on average."""
        return self.samples if self.missing is None else self.samples - round(self.missing.sum() / len(self.missing))

    def thinned(self, stride: int) -> Experiment:
        """Every so many of the bins, each for all of them; of outputs alone."""
        counts = self.counts[::stride]
        return replace(
            self, z=self.z[::stride], Y=self.Y[:, ::stride], counts=counts * (self.counts.sum() / counts.sum())
        )

    def parts(self, p: ComplexArray) -> list[DrivenPart]:
        """Columns for modes with these poles."""
        parts, n = [], len(p)
        for rows in self.rows:
            columns = np.concatenate(list(rows.evaluated(p).blocks()), axis=1)
            spectra = np.fft.rfft(columns[: len(columns) - len(rows.outputs)]) / np.sqrt(rows.length)
            own = rows.own_unknowns(n)
            width = own + len(input_places(rows, n))
            parts.append(DrivenPart(rows, spectra[:width], spectra[width:], own))
        return parts


@dataclass(frozen=True, eq=False)
class InnovationsModel:
    """A model: noise, numbers `shared` (width, p) by all experiments, and those of each of these.

    `own` are those of each part of rows, (unknowns, its outputs); `states` the motions of the predictor at the start of
    each experiment: (N,), or those of lags alone (l,) where free motions of rows are those of the plant.
    """

    noise: NoiseSections
    shared: Array
    own: tuple[Array, ...] = ()
    states: tuple[Array, ...] = ()

    @property
    def poles(self) -> ComplexArray:
        """Poles of the plant."""
        return self.noise.sections.p


def _beginning(state: Array, count: int, z: ComplexArray, samples: int) -> ComplexArray:
    """What the last of so many states add at the first sample to what drives these, (count, bins)."""
    return np.concatenate([np.zeros(count - len(state)), state])[:, None] * (z / np.sqrt(samples))


def pieces(count: int, size: int, stride: int = 1) -> Iterator[slice]:
    """Slices of so many bins, each of which has a number of numbers; every `stride` of them."""
    every = stride * max(1, _AT_A_TIME // max(1, size))
    for first in range(0, count, every):
        alive("noise")
        yield slice(first, min(count, first + every), stride)


class Problem:
    """Prediction errors of experiments, of the numbers that are `active` (width, p) among the shared ones.

    `coloured` says whether noise comes through the plant; else it is white, with any covariance.  `real_shapes` says
    whether outputs see the first state of each mode alone: what they see of a mode is then one shape, times a motion.
    """

    def __init__(
        self, experiments: Sequence[Experiment], active: Mask, coloured: bool = True, fed: Mask | None = None,
        real_shapes: bool = False,
    ) -> None:  # fmt: skip
        self.experiments, self.active, self.coloured, self.fed = tuple(experiments), active, coloured, fed
        self.real_shapes = real_shapes
        self.samples = sum(experiment.measured for experiment in experiments)

    @property
    def rows(self) -> list[FreeRecord]:
        """Rows of all experiments."""
        return [part for experiment in self.experiments for part in experiment.rows]

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return max((int(part.acting.max(initial=-1)) + 1 for part in self.rows), default=0)

    def evaluated(self, point: InnovationsModel) -> LikelihoodEvaluation:
        """The prediction errors of a model."""
        lags = len(point.noise.lags) if self.coloured else 0
        if self.rows and [len(state) for state in point.states] != [lags] * len(self.experiments):
            point = replace(point, states=tuple(np.zeros(lags) for _ in self.experiments))
        return LikelihoodEvaluation(self, point)

    def that_forgets(self, point: InnovationsModel, like: LikelihoodEvaluation) -> InnovationsModel:
        """The model of the same spectrum whose predictor forgets, with the covariance of an evaluation."""
        return replace(point, noise=point.noise.that_forgets(like.covariance))

    def with_real_shapes(self) -> Problem:
        """The same data for outputs that see the first state of each mode alone."""
        return Problem(self.experiments, self.active, real_shapes=True)

    def thinned(self, most: int) -> Problem:
        """The same with so many bins of each experiment at most, about; of outputs alone."""
        experiments = [each.thinned(max(1, len(each.z) // most)) for each in self.experiments]
        return Problem(experiments, self.active, real_shapes=self.real_shapes)

    def _sections(self, x: Array, before: Sections) -> Sections:
        """Sections with other coordinates; complex or real as before, where numbers belong to each of their poles."""
        sections = before.moved(x)
        if not len(self.active) or sections.keeps_kinds(before):
            return sections
        least = (_APART * np.maximum(np.abs(sections.decay), np.sqrt(np.abs(before.square)))) ** 2
        square = np.where(before.square > 0, np.maximum(sections.square, least), np.minimum(sections.square, -least))
        return before.moved(np.concatenate([sections.decay, sections.decay**2 + square, sections.rates]))

    def vector(self, point: InnovationsModel) -> Array:
        """Numbers that move."""
        noise = [point.noise.lags, point.noise.C.ravel(), point.noise.K.ravel()] if self.coloured else []
        own = (each.ravel() for each in point.own)
        return np.concatenate([point.noise.sections.x, *noise, point.shared[self.active], *own, *point.states])

    def point(self, values: Array, like: InnovationsModel) -> InnovationsModel:
        """The model with these numbers."""
        noise, place = like.noise, 0

        def take(shape: tuple[int, ...]) -> Array:
            nonlocal place
            size = int(np.prod(shape))
            place += size
            return values[place - size : place].reshape(shape)

        sections = self._sections(take(noise.sections.x.shape), noise.sections)
        matrices = noise.lags, noise.C, noise.K
        lags, C, K = (take(each.shape) for each in matrices) if self.coloured else matrices
        shared = np.zeros(like.shared.shape)
        shared[self.active] = take((int(self.active.sum()),))
        own = tuple(take(part.shape) for part in like.own)
        states = tuple(take(part.shape) for part in like.states)
        return InnovationsModel(noise.moved(sections, C, K, lags), shared, own, states)

    def numbers_before_shared(self, noise: NoiseSections) -> int:
        """How many numbers, of sections and of the noise, come before those that inputs drive."""
        return len(noise.x) + noise.C.size + noise.K.size if self.coloured else len(noise.sections.x)

    def driven_best(self, point: InnovationsModel) -> InnovationsModel:
        """The model whose numbers beside poles and noise are best in this noise: errors are linear in them."""
        best = evaluation = self.evaluated(point)
        first = self.numbers_before_shared(point.noise)
        for _ in range(_ROUNDS):  # with the covariance that belongs to them
            if not np.isfinite(evaluation.cost):
                break
            gram, gradient, lengths = evaluation.scaled_normal()
            step = np.zeros(len(gradient))
            step[first:] = -np.linalg.pinv(gram[first:, first:], rcond=1e-12, hermitian=True) @ gradient[first:]
            evaluation = self.evaluated(self.point(self.vector(evaluation.point) + step / lengths, evaluation.point))
            best = evaluation if evaluation.cost < best.cost else best
        return best.point


class _WhitenedBins(NamedTuple):
    """Some bins: Jacobian (bins, p, P), whitening (bins, p, p), what is seen of states, errors (p, bins), counts."""

    J: ComplexArray
    W: ComplexArray
    seen: ComplexArray | None
    errors: ComplexArray
    counts: Array


class LikelihoodEvaluation:
    """The prediction errors of a model, their covariance, and how they depend on its numbers."""

    def __init__(self, problem: Problem, point: InnovationsModel) -> None:
        self.problem, self.point = problem, point
        self.p = len(point.noise.C)

    @cached_property
    def parts(self) -> list[list[DrivenPart]]:
        """Columns of each experiment."""
        return [experiment.parts(self.point.poles) for experiment in self.problem.experiments]

    @cached_property
    def disturbances(self) -> list[ComplexArray]:
        """Noise (p, bins) of each experiment: outputs less what the plant makes of inputs and first states."""
        noises, own = [], iter(self.point.own)
        states = iter(self.point.states)
        for experiment, parts in zip(self.problem.experiments, self.parts, strict=True):
            V = experiment.Y.copy()
            for part in parts:
                shared = self.point.shared[np.ix_(input_places(part.rows, len(self.point.poles)), part.rows.outputs)]
                V[part.rows.outputs] -= np.concatenate([next(own), shared]).T @ part.columns
            if self.point.states:
                V -= self._motion(experiment, next(states))
            noises.append(V)
        return noises

    def _motion(self, experiment: Experiment, state: Array) -> ComplexArray:
        noise = self.point.noise
        beginning = _beginning(state, noise.states, experiment.z, experiment.samples)
        return np.asarray(noise.C @ noise.resolve(experiment.z, beginning))

    def _states(self, place: int, z: ComplexArray, e: ComplexArray) -> ComplexArray:
        """States (N, bins) of an experiment that its errors, and where it began, make."""
        driving = np.asarray(self.point.noise.K @ e)
        if self.point.states:
            samples = self.problem.experiments[place].samples
            driving = driving + _beginning(self.point.states[place], len(driving), z, samples)
        return self.point.noise.resolve(z, driving)

    @cached_property
    def errors(self) -> list[ComplexArray]:
        """Prediction errors (p, bins) of each experiment."""
        if not self.problem.coloured:
            return self.disturbances
        errors, noise = [], self.point.noise
        for experiment, V in zip(self.problem.experiments, self.disturbances, strict=True):
            each = np.empty(V.shape, complex)
            for bins in pieces(len(experiment.z), self.p * (self.p + noise.states)):
                each[:, bins] = noise.errors(experiment.z[bins], V[:, bins])
            errors.append(each)
        return errors

    @property
    def unknowns(self) -> int:
        """Numbers that move, less those of bases, and of the covariance.

        Where lags began is no number of the model: it is noise of before.
        """
        lags = sum(map(len, self.point.states)) if self.problem.rows else 0
        return len(self.problem.vector(self.point)) - lags - self.bases.shape[1] + self.p * (self.p + 1) // 2

    @property
    def values(self) -> int:
        """Number of samples of all outputs."""
        return self.problem.samples * self.p

    @property
    def by_set_up(self) -> list[tuple[Indices, Indices, LikelihoodEvaluation]]:
        """Outputs, experiments and evaluation of each set-up of sensors: here there is one."""
        return [(np.arange(self.p), np.arange(len(self.problem.experiments)), self)]

    @property
    def bic(self) -> float:
        """Value of that criterion."""
        return self.cost + self.unknowns * float(np.log(self.values))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (p, p) of the prediction errors."""
        total = np.zeros((self.p, self.p))
        for experiment, errors in zip(self.problem.experiments, self.errors, strict=True):
            total += ((errors * experiment.counts) @ errors.conj().T).real
        return total / self.problem.samples

    @cached_property
    def cost(self) -> float:
        """Twice the negative logarithm of the likelihood; infinite where there is none.

        So it is where the predictor does not forget, free motions grow beyond all records, or outputs are predicted
        without error.
        """
        samples = max(experiment.samples for experiment in self.problem.experiments)
        growth = float(self.point.poles.real.max(initial=0.0)) * self.point.noise.step * samples
        if growth > _LARGEST_GROWTH or (self.problem.coloured and not self.point.noise.is_stable):
            return np.inf
        try:
            size = 2 * float(np.sum(np.log(np.diag(self._root))))
        except np.linalg.LinAlgError:
            return np.inf
        return self.problem.samples * (size + self.p * (1 + float(np.log(2 * np.pi))))

    @cached_property
    def _root(self) -> Array:
        if not np.isfinite(self.covariance).all():
            raise np.linalg.LinAlgError
        return np.asarray(np.linalg.cholesky(self.covariance))

    def _whitening(self, z: ComplexArray) -> tuple[ComplexArray, ComplexArray | None]:
        """Matrices (bins, p, p) that make errors of covariance 1 of noise, and what outputs see of the states."""
        W: ComplexArray = np.broadcast_to(np.eye(self.p, dtype=complex), (len(z), self.p, self.p))
        seen = None
        if self.problem.coloured:
            seen = self.point.noise.outputs_of_states(z)
            W = np.asarray(np.linalg.inv(np.eye(self.p) + seen @ self.point.noise.K), complex)
        W = solve_triangular(self._root, W.transpose(1, 0, 2).reshape(self.p, -1), lower=True)
        return W.reshape(self.p, len(z), self.p).transpose(1, 0, 2), seen

    def _blocks(self) -> Iterator[_WhitenedBins]:
        """Blocks of bins with the derivatives of whitened errors by all numbers."""
        problem, width = self.problem, len(self.problem.vector(self.point))
        for place, (experiment, errors) in enumerate(zip(problem.experiments, self.errors, strict=True)):
            for bins in pieces(len(experiment.z), width * self.p):
                z, e = experiment.z[bins], errors[:, bins]
                W, seen = self._whitening(z)
                J = np.zeros((len(z), self.p, width), complex)
                block = _WhitenedBins(J, W, seen, e, experiment.counts[bins])
                self._fill(block, place, bins)
                yield block

    def _jacobians(self) -> Iterator[tuple[ComplexArray, ComplexArray, Array]]:
        """Blocks of bins: errors of covariance 1 (rows,), their Jacobian (rows, P), and what each row counts."""
        for block in self._blocks():
            rows = solve_triangular(self._root, block.errors, lower=True).T
            yield rows.ravel(), block.J.reshape(-1, block.J.shape[2]), np.repeat(block.counts, self.p)

    def expected_slope_of_gains(self, fitted: Indices, among: Array) -> Array:
        """Mean (N, p) of half the gradient by gains, in white noise, where other numbers were fitted.

        The errors of covariance 1 are then of covariance `1 - J G J*` in each bin, with the Jacobian `J` of what was
        fitted and the inverse `G` of its Gram matrix, `among`.
        """
        total = np.zeros((self.point.noise.states, self.p))
        for block in self._blocks():
            used = np.flatnonzero(block.J[:, :, fitted].any(axis=(0, 1)))  # inputs act in some experiments alone
            J = block.J[:, :, fitted[used]]
            scatter = np.eye(self.p) - (J @ among[np.ix_(used, used)]) @ J.conj().transpose(0, 2, 1)
            through = (block.W @ np.asarray(block.seen)) * block.counts[:, None, None]
            total -= np.einsum("bin,bim->nm", through.conj(), scatter).real @ self._root.T
        return total

    def _gram_of_noise(self) -> Array:
        """Gram matrix of the Jacobian, of outputs alone: most columns are products of two factors in each bin.

        Bins are thinned where they are many, as far as modes remain wide: the information is smooth over frequency.
        """
        noise, problem, p, N = self.point.noise, self.problem, self.p, self.point.noise.states
        few, both = len(noise.x), 2 * p * N
        size = len(problem.vector(self.point))
        gram = np.zeros((size, size))
        slim = np.concatenate([np.arange(few), np.arange(few + both, size)])  # coordinates of sections, first states
        of_C, of_K = slice(few, few + p * N), slice(few + p * N, few + both)
        for place, (experiment, errors) in enumerate(zip(problem.experiments, self.errors, strict=True)):
            for bins, counts in self.thinned(experiment):
                z, e = experiment.z[bins], errors[:, bins]
                W, seen = self._whitening(z)
                through, states = W @ np.asarray(seen), self._states(place, z, e)
                J = np.zeros((len(z), p, len(slim)), complex)
                for k, (first, block) in enumerate(noise.slopes):
                    these = slice(first, first + len(block))
                    J[:, :, k] -= np.einsum("bpn,nb->bp", through[:, :, these], block @ states[these])
                if self.point.states:
                    start = (z / np.sqrt(experiment.samples))[:, None, None]
                    J[:, :, few + place * N : few + (place + 1) * N] = -through * start
                Jh, Wh, Th = (part.conj().transpose(0, 2, 1) for part in (J, W, through))
                x, e = states.T, e.T
                gram[np.ix_(slim, slim)] += np.einsum("b,bij->ij", counts, Jh @ J).real
                gram[slim, of_C] -= _product(Jh @ W, x[:, None, :], counts)
                gram[slim, of_K] -= _product(Jh @ through, e[:, None, :], counts)
                gram[of_C, of_C] += _product(Wh @ W, x.conj()[:, :, None] * x[:, None, :], counts)
                gram[of_C, of_K] += _product(Wh @ through, x.conj()[:, :, None] * e[:, None, :], counts)
                gram[of_K, of_K] += _product(Th @ through, e.conj()[:, :, None] * e[:, None, :], counts)
        upper = np.triu(np.ones(gram.shape, bool))
        order = np.concatenate([slim, np.arange(few, few + both)])
        ordered = gram[np.ix_(order, order)]
        ordered = np.where(upper, ordered, ordered.T)
        gram[np.ix_(order, order)] = ordered
        return gram

    def thinned(self, experiment: Experiment) -> Iterator[tuple[slice, Array]]:
        """Pieces of bins, and what each of these counts."""
        noise, N = self.point.noise, self.point.noise.states
        width = float(np.abs(noise.sections.p.real).min()) * experiment.samples / np.pi
        stride = int(min(len(experiment.z) // _BINS, width / _IN_WIDTH))
        for bins in pieces(len(experiment.z), 2 * max(N, self.p) ** 2, max(1, stride)):
            yield bins, max(1, stride) * experiment.counts[bins]

    def _slope_of_noise(self) -> Array:
        """Half the gradient, of outputs alone: from all bins, without a Jacobian."""
        noise, N = self.point.noise, self.point.noise.states
        x, C, K = np.zeros(len(noise.x)), np.zeros((self.p, N)), np.zeros((N, self.p))
        starts = []
        for place, (experiment, errors) in enumerate(zip(self.problem.experiments, self.errors, strict=True)):
            start = np.zeros(N)
            for bins in pieces(len(experiment.z), self.p * (self.p + N)):
                z, e = experiment.z[bins], errors[:, bins]
                at_outputs = noise.adjoint_errors(z, cho_solve((self._root, True), e) * experiment.counts[bins])
                at_states = noise.resolve(z, (noise.C.T @ at_outputs).conj(), transposed=True).conj()
                states = self._states(place, z, e)
                C -= (at_outputs @ states.conj().T).real
                K -= (at_states @ e.conj().T).real
                start -= (at_states @ z.conj()).real / np.sqrt(experiment.samples)
                cross = (at_states @ states.conj().T).real
                for k, (first, block) in enumerate(noise.slopes):
                    these = slice(first, first + len(block))
                    x[k] -= np.sum(block * cross[these, these])
            starts.append(start)
        return np.concatenate([x, C.ravel(), K.ravel(), *(starts if self.point.states else [])])

    def _fill(self, block: _WhitenedBins, place: int, bins: slice) -> None:
        """Fill the Jacobian of a block with the derivatives by all numbers."""
        J, W, seen, e, _ = block
        noise, problem, column = self.point.noise, self.problem, len(self.point.noise.sections.x)
        z = problem.experiments[place].z[bins]
        if seen is not None:
            states = self._states(place, z, e)
            through = W @ seen
            for k, (first, slope) in enumerate(noise.slopes):
                section = slice(first, first + len(slope))
                J[:, :, k] -= np.einsum("bpn,nb->bp", through[:, :, section], slope @ states[section])
            N, column = noise.states, len(noise.x)
            of_C = W[:, :, :, None] * states.T[:, None, None, :]
            J[:, :, column : column + self.p * N] = -of_C.reshape(len(z), self.p, -1)
            column += self.p * N
            of_K = through[:, :, :, None] * e.T[:, None, None, :]
            J[:, :, column : column + N * self.p] = -of_K.reshape(len(z), self.p, -1)
            column += N * self.p
        self._fill_driven(J, place, bins, W, column)
        if self.point.states and seen is not None:
            count = len(self.point.states[place])
            first = J.shape[2] - (len(problem.experiments) - place) * count
            start = z / np.sqrt(problem.experiments[place].samples)
            J[:, :, first : first + count] = -through[:, :, noise.states - count :] * start[:, None, None]

    def slopes_of_mean(self, place: int, bins: slice) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Whitened derivatives (bins, p, P) of the outputs' mean by all numbers, what whitens, and the states seen."""
        z, first = self.problem.experiments[place].z[bins], self.problem.numbers_before_shared(self.point.noise)
        W, seen = self._whitening(z)
        J = np.zeros((len(z), self.p, len(self.problem.vector(self.point))), complex)
        self._fill_driven(J, place, bins, W, first)
        return J, W, W @ np.asarray(seen)

    def _fill_driven(self, J: ComplexArray, place: int, bins: slice, W: ComplexArray, column: int) -> None:
        """Derivatives by poles of the plant, shared numbers, and those of the experiment."""
        n, sections, active = len(self.point.poles), self.point.noise.sections, self.problem.active
        numbers = np.full(active.shape, -1)
        numbers[active] = column + np.arange(int(active.sum()))
        column += int(active.sum())
        own = 0
        for k, parts in enumerate(self.parts):
            for part in parts:
                mine = self.point.own[own]
                own += 1
                if k == place:
                    piece = part.at_bins(bins)
                    self._fill_part(J, piece, mine, W, numbers, column)
                    J[:, :, : len(sections.x)] -= self._slopes(piece, mine, W, n) @ sections.pole_slopes
                column += mine.size

    def _fill_part(
        self, J: ComplexArray, part: DrivenPart, mine: Array, W: ComplexArray, numbers: Indices, column: int
    ) -> None:
        F, outputs = part.columns.T, part.rows.outputs
        places = input_places(part.rows, len(self.point.poles))
        for k, output in enumerate(outputs.tolist()):
            along = -W[:, :, output, None]
            J[:, :, column + np.arange(len(mine)) * len(outputs) + k] = along * F[:, None, : part.own]
            number = numbers[places, output]
            J[:, :, number[number >= 0]] = along * F[:, None, part.own :][:, :, number >= 0]

    def _slopes(self, part: DrivenPart, mine: Array, W: ComplexArray, n: int) -> ComplexArray:
        """Derivatives of whitened outputs by imaginary, then real parts of the poles."""
        D, total = part.derivatives, np.zeros((W.shape[0], self.p, 2 * n), complex)
        for k, output in enumerate(part.rows.outputs.tolist()):
            residues = self._residues(output)
            amplitudes = [mine[:n, k] + 1j * mine[n : 2 * n, k]] if part.rows.moving else []
            amplitudes += list(residues.T[part.rows.acting])
            slopes = np.zeros((2 * n, D.shape[1]), complex)
            for i, amplitude in enumerate(amplitudes):
                first, second = D[2 * i * n : (2 * i + 1) * n], D[(2 * i + 1) * n : (2 * i + 2) * n]
                slopes[n:] += first * amplitude.real[:, None] + second * amplitude.imag[:, None]
                slopes[:n] += second * amplitude.real[:, None] - first * amplitude.imag[:, None]
            total += W[:, :, output, None] * slopes.T[:, None, :]
        return total

    def _residues(self, output: int) -> ComplexArray:
        """Residues (n, inputs) of an output."""
        n, width = len(self.point.poles), self.point.shared.shape[0]
        inputs = self.problem.inputs
        each = self.point.shared[:, output].reshape(inputs, width // max(1, inputs))
        return np.asarray((each[:, :n] + 1j * each[:, n : 2 * n]).T)

    @cached_property
    def normal(self) -> tuple[Array, Array]:
        """Gram matrix of the Jacobian of errors of covariance 1, and half the gradient."""
        size = len(self.problem.vector(self.point))
        gram, gradient = np.zeros((size, size)), np.zeros(size)
        alone = self.problem.coloured and not any(experiment.rows for experiment in self.problem.experiments)
        if alone and size:
            gram, gradient = self._gram_of_noise(), self._slope_of_noise()
        for errors, J, counts in self._jacobians() if not alone else ():
            used = np.flatnonzero(J.any(axis=0))
            J = J[:, used]
            gradient[used] += ((J.conj().T * counts) @ errors).real
            both = np.concatenate([J.real, J.imag]) * np.sqrt(np.tile(counts, 2))[:, None]
            gram[np.ix_(used, used)] += both.T @ both
        gradient[self._held], gram[self._held], gram[:, self._held] = 0.0, 0.0, 0.0
        return gram, gradient

    @cached_property
    def _held(self) -> Indices:
        """Places of numbers that stay: what outputs see of the second state of each mode, where shapes are real."""
        noise, first = self.point.noise, len(self.point.noise.x)
        if not (self.problem.real_shapes and self.problem.coloured):
            return np.zeros(0, int)
        second = 2 * np.flatnonzero(noise.sections.square > 0) + 1
        return np.asarray((first + np.arange(self.p)[:, None] * noise.states + second).ravel())

    @cached_property
    def bases(self) -> Array:
        """Directions among all numbers that change nothing but the bases of the noise's states, or that are held."""
        size = len(self.problem.vector(self.point))
        if not self.problem.coloured:
            return np.zeros((size, 0))
        noise, first = self.point.noise, len(self.point.noise.x)
        inner, matrices = noise.bases(self.problem.real_shapes, self.point.states), noise.C.size + noise.K.size
        bases = np.zeros((size, inner.shape[1] + len(self._held)))
        bases[first : first + matrices, : inner.shape[1]] = inner[:matrices]
        bases[size - (len(inner) - matrices) :, : inner.shape[1]] = inner[matrices:]
        bases[self._held, inner.shape[1] + np.arange(len(self._held))] = 1.0
        return bases

    def promised(self, numbers: Indices, others: Indices, chance: Callable[[Array], Array] | None = None) -> float:
        """Twice the log-likelihood that one step of some numbers promises, others moving along.

        Beyond what a slope promises that comes of `chance`, of the inverse (O, O) of the others' Gram matrix.
        """
        gram, gradient = self.normal
        lengths = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
        gram, gradient = gram / np.outer(lengths, lengths), gradient / lengths
        among = np.linalg.pinv(gram[np.ix_(others, others)], rcond=1e-12, hermitian=True)
        # where others are not at their best among themselves, that is no sign of these
        moved = among @ gram[np.ix_(others, numbers)]
        inner = gram[np.ix_(numbers, numbers)] - gram[np.ix_(numbers, others)] @ moved
        slope = gradient[numbers] - moved.T @ gradient[others]
        if chance is not None:
            slope -= chance(among / np.outer(lengths[others], lengths[others])) / lengths[numbers]
        return float(slope @ np.linalg.pinv(inner, rcond=1e-10, hermitian=True) @ slope)

    def scaled_normal(self) -> tuple[Array, Array, Array]:
        """Gram matrix with unit diagonal that is regular in the free bases, gradient, and the lengths of columns."""
        gram, gradient = self.normal
        lengths = np.sqrt(np.maximum(np.diag(gram), 0.0))
        lengths = np.where(lengths > 0, lengths, 1.0)
        null = self.bases * lengths[:, None]
        null = np.linalg.qr(null)[0] if null.shape[1] else null
        return gram / np.outer(lengths, lengths) + null @ null.T, gradient / lengths, lengths

    @property
    def _beside_zero(self) -> LikelihoodEvaluation:
        """The same with noise evaluated half a bin beside frequency zero, where inputs act and noise is coloured."""
        problem = self.problem
        if not (problem.rows and problem.coloured):
            return self
        experiments = [replace(each, z=bins_of(each.samples)) for each in problem.experiments]
        return Problem(experiments, problem.active, problem.coloured, problem.fed).evaluated(self.point)

    def information_inverse(self) -> Array:
        """Covariance of all numbers: of what does not depend on the bases of the states.

        Beside inputs noise is evaluated half a bin beside frequency zero, where it may be nothing at the maximum: what
        one bin told without error would hide all other.
        """
        gram, _, lengths = self._beside_zero.scaled_normal()
        null = self.bases * lengths[:, None]
        null = np.linalg.qr(null)[0] if null.shape[1] else null
        inverse = np.linalg.pinv(gram, rcond=len(gram) * EPS * 100, hermitian=True) - null @ null.T
        inverse[self._held], inverse[:, self._held] = 0.0, 0.0
        return np.asarray(inverse / np.outer(lengths, lengths))


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a minimisation ended."""

    evaluation: LikelihoodEvaluation
    converged: bool
    steps: int
    interrupted: bool = False


def minimise(
    problem: Problem, start: InnovationsModel, tolerance: float = 1e-3, steps: int = _STEPS,
    report: Callable[[int, LikelihoodEvaluation], None] | None = None,
) -> Minimum:  # fmt: skip
    """Go down to a minimum: until a step lowers twice the negative log-likelihood by less than `tolerance`.

    `report` is called with the number of each step and where it led; it ends the minimisation by an interruption.
    """
    best, damping = problem.evaluated(start), 1e-3
    taken = 0
    if not np.isfinite(best.cost) or not len(problem.vector(start)):
        return Minimum(best, np.isfinite(best.cost), 0)
    while taken < steps:
        try:
            alive("noise")
            if report is not None:
                report(taken, best)
        except KeyboardInterrupt:
            return Minimum(best, False, taken, interrupted=True)
        gram, gradient, lengths = best.scaled_normal()
        x = problem.vector(best.point)
        while True:
            with suppress(np.linalg.LinAlgError):  # rounding may leave the Gram matrix indefinite
                factor = cho_factor(gram + damping * np.eye(len(gram)))
                step = -cho_solve(factor, gradient) / lengths
                point = problem.point(x + step, best.point)
                if problem.coloured:  # zeros of the noise on the unit circle are no border
                    point = problem.that_forgets(point, best)
                trial = problem.evaluated(point)
                if trial.cost < best.cost:
                    break
            damping *= _GROWTH
            if damping > _LARGEST_DAMPING:
                return Minimum(best, True, taken)
        gain = best.cost - trial.cost
        best, damping, taken = trial, max(damping / (2 * _GROWTH), 1e-9), taken + 1
        if gain < tolerance:
            return Minimum(best, True, taken)
    return Minimum(best, False, taken)


def followed(
    problem: Problem, start: InnovationsModel, tolerance: float = 1e-3, steps: int = _STEPS
) -> Minimum:  # fmt: skip
    """The minimum from a start; an interruption ends all that was to come of it."""
    minimum = minimise(problem, start, tolerance, steps)
    if minimum.interrupted:
        raise KeyboardInterrupt
    return minimum


def _product(first: ComplexArray, second: ComplexArray, counts: Array) -> Array:
    """Sum over bins of Kronecker products of matrices (bins, i, j) and (bins, k, l), real part (i k, j l)."""
    shape = first.shape[1:] + second.shape[1:]
    rows = (first * counts[:, None, None]).reshape(len(first), -1)
    columns = second.reshape(len(second), -1)
    total = (rows.real.T @ columns.real - rows.imag.T @ columns.imag).reshape(shape)
    return np.asarray(total.transpose(0, 2, 1, 3).reshape(shape[0] * shape[2], shape[1] * shape[3]))

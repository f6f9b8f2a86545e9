"""Dead times of inputs: the whole samples by which each acts later, compared for given poles and noise.

The response of a pole to a late input is its response to the input, later by as many samples, beside a free motion.
So the columns of all dead times are parts of those that an input makes from rest, and one filter of the noise serves
all of them.  Inputs take turns: each gets the dead time that explains most beside the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from ..._heartbeat import alive
from ..._types import Array, ComplexArray, Indices
from ..regression.elimination import orthogonal, without
from ..regression.modal_regressors import SampledModes
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.free_search import NoiseOrders
from ..search.whitening import autoregression, correlations

_TURNS = 8  # of all inputs
_ROUNDS = 3  # of dead times and noise in turn
_SAMPLES = 3000  # of each record that are looked at


def numbers_of(samples: Indices) -> int:
    """Parameters of dead times: those that are not 0, or one that all inputs share."""
    return int(np.count_nonzero(samples)) if np.ptp(samples) else int(samples[0] != 0)


@dataclass(frozen=True)
class DeadTimes:
    """Samples (m,) by which each input acts later, and the log-likelihood of the best model that has these.

    But for a constant that is the same for all dead times and poles of the same records; `noise` are the innovations
    filters of the outputs in which that is.
    """

    samples: Indices
    loglik: float
    noise: tuple[Array, ...] = ()


@dataclass(frozen=True)
class DeadTimeScan:
    """Records without delays, and some poles whose residues are those that explain the outputs best.

    Attributes
    ----------
    records : sequence of FreeRecord
        Rows of all experiments; of long ones the beginning is looked at.
    p : ndarray of complex, shape (n,)
        Poles.
    most : int
        Largest dead time in samples: as many samples are left out of each record.
    each : float
        What a parameter costs, as a log-likelihood.
    inputs : int
        Number of inputs.

    Notes
    -----
    Nothing is fed through: an input that is, a sample later, is the same model with one more parameter.
    """

    records: Sequence[FreeRecord]
    p: ComplexArray
    most: int
    each: float
    inputs: int

    def likeliest(self, start: Indices) -> tuple[DeadTimes, DeadTimes]:
        """No dead times, and those of the best criterion from a start on, each in the noise that its model leaves."""
        none = np.zeros_like(start)
        judged = []
        for samples, moves in ((none, False), (start, True)):
            for _ in range(_ROUNDS):
                noise, before = self._plain.noise(samples), samples
                problem = self._in_noise(noise)
                samples = problem.in_turns(samples) if moves else samples
                if np.array_equal(samples, before):
                    break
            coloured = any(len(coefficients) > 1 for coefficients in noise)
            judged.append(replace(problem.judged(samples), noise=noise if coloured else ()))
        return judged[0], judged[1]

    def refined(self, start: Indices, noise: tuple[Array, ...]) -> DeadTimes:
        """Dead times of the best criterion from a start on, in noise with these innovations filters."""
        problem = self._in_noise(noise)
        return replace(problem.judged(problem.in_turns(start)), noise=noise)

    def cost(self, dead_times: DeadTimes) -> float:
        """Half the BIC of dead times with these poles."""
        states = len(self.p) + int(np.sum(self.p.imag != 0))
        outputs = 1 + max(int(rows.outputs.max()) for rows in self.records)
        unknowns = numbers_of(dead_times.samples) + states * (1 + outputs * self.inputs)
        return self.each * unknowns - dead_times.loglik

    @cached_property
    def _plain(self) -> _DeadTimeProblem:
        return _DeadTimeProblem(self.most, self.each, _groups(self, ()))

    @cached_property
    def _coloured(self) -> dict[tuple[bytes, ...], _DeadTimeProblem]:
        """Problems in the noise of filters that were looked at."""
        return {}

    def _in_noise(self, noise: tuple[Array, ...]) -> _DeadTimeProblem:
        if all(len(coefficients) == 1 for coefficients in noise):
            return self._plain
        key = tuple(coefficients.tobytes() for coefficients in noise)
        if key not in self._coloured:
            self._coloured[key] = _DeadTimeProblem(self.most, self.each, _groups(self, noise))
        return self._coloured[key]

    def columns(self, rows: FreeRecord) -> tuple[Array, Array, Array]:
        """Outputs (q, T), columns (k, T) of the free motion and the constants, and (m, k, T) of inputs from rest."""
        T, modes = min(rows.length, _SAMPLES), SampledModes.of(rows.hold, self.p)
        own = [np.arange(T) ** float(k) for k in range(rows.offset)]
        if rows.moving:
            own += _parts(self.p, rows.hold.step(self.p).powers(np.arange(float(T))))
        driven = np.zeros((self.inputs, len(self.p) + int(np.sum(self.p.imag != 0)), T))
        for u, i in zip(rows.u[: rows.inputs, :T], rows.acting.tolist(), strict=True):
            steps = zip(modes.multiplier, modes.b0, modes.b1, strict=True)
            responses = np.array([lfilter([b1, b0], [1.0, -lam], u) for lam, b0, b1 in steps]).reshape(-1, T)
            driven[i] = [*_parts(self.p, responses)]
        return rows.measured[:, :T], np.reshape(own, (-1, T)), driven


def _parts(p: ComplexArray, values: ComplexArray) -> Iterator[Array]:
    """Real and imaginary parts of rows (n, T); of real poles the real ones."""
    yield from values.real
    yield from values[p.imag != 0].imag


@dataclass(frozen=True)
class _Group:
    """Outputs that the same experiments show in noise of the same filter, without what belongs to an experiment alone.

    `targets` (N, q) are the outputs, `late` (m, most + 1, k, N) the columns of each input for each dead time; `parts`
    are the experiments among the rows.
    """

    outputs: Indices
    targets: Array
    late: Array
    parts: list[slice]

    def columns(self, samples: Indices, inputs: Sequence[int]) -> Array:
        """Columns (k, N) of some inputs with their dead times."""
        return np.concatenate([self.late[i, samples[i]] for i in inputs] or [self.late[0, 0, :0]])

    def loglik(self, losses: Array) -> Array:
        """Log-likelihood of sums of squares (.., q) of the outputs."""
        count = len(self.targets)
        return np.asarray(-0.5 * count * np.sum(np.log(np.maximum(losses, np.finfo(float).tiny) / count), axis=-1))


def _groups(scan: DeadTimeScan, noise: tuple[Array, ...]) -> list[_Group]:
    """The linear problems of some records, in rows in which noise with these innovations filters is white."""
    blocks: dict[tuple[bytes, bytes], list[tuple[Array, Array]]] = {}
    for rows in scan.records:
        filters = [noise[output] if noise else np.ones(1) for output in rows.outputs.tolist()]
        columns = scan.columns(rows)
        for coefficients in {b.tobytes(): b for b in filters}.values():
            members = [k for k, b in enumerate(filters) if np.array_equal(b, coefficients)]
            key = rows.outputs[members].tobytes(), coefficients.tobytes()
            alive("dead times")
            blocks.setdefault(key, []).append(_block(scan, rows, members, coefficients, columns))
    groups = []
    for (outputs, _), parts in blocks.items():
        ends = np.cumsum([0, *(len(targets) for targets, _ in parts)]).tolist()
        targets = np.concatenate([targets for targets, _ in parts])
        late = np.concatenate([late for _, late in parts], axis=-1)
        groups.append(_Group(np.frombuffer(outputs, int), targets, late, [slice(*pair) for pair in pairwise(ends)]))
    return groups


def _block(
    scan: DeadTimeScan, rows: FreeRecord, members: list[int], b: Array, columns: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """Outputs and columns of one experiment in the rows of white noise, as in a group."""
    end = columns[0].shape[1]
    first, past = (scan.most, TUNING.past_of_noise) if rows.moving else (0, 0)
    outputs, own, driven = (np.asarray(lfilter(b, 1.0, part, axis=-1)) if len(b) > 1 else part for part in columns)
    missing = np.convolve(~rows.observed[:end], np.ones(len(b)))[:end] > 0
    seen = np.flatnonzero(~missing[first + past :]) + first + past
    # the free motion of late inputs is one of the same poles: columns may begin anywhere
    padded = np.concatenate([np.zeros((*driven.shape[:-1], scan.most)), driven], axis=-1)
    basis = orthogonal(own[:, seen].T)[0]
    late = np.stack([padded[..., seen + scan.most - k] for k in range(scan.most + 1)], axis=1)
    return without(outputs[members][:, seen].T, basis), late - (late @ basis) @ basis.T


@dataclass(frozen=True)
class _DeadTimeProblem:
    """The linear problems of all groups of outputs, for any dead times up to the `most`; a parameter costs `each`."""

    most: int
    each: float
    groups: list[_Group]

    def in_turns(self, start: Indices) -> Indices:
        """Dead times of the best criterion, of one input after the other, from a start and from common ones."""
        common = [self.judged(np.full(len(start), k)) for k in range(self.most + 1)]
        best = max(common, key=self._value)
        ends = [self._in_turns(samples) for samples in (start, best.samples)]
        return max([best, *map(self.judged, ends)], key=self._value).samples

    def _in_turns(self, samples: Indices) -> Indices:
        for _ in range(_TURNS):
            before, samples = samples, samples.copy()
            for i in range(len(samples)):
                values = self._alone(i, samples)
                values[1:] -= self.each
                samples[i] = int(np.argmax(values))
            if np.array_equal(before, samples):
                break
        return samples

    def judged(self, samples: Indices) -> DeadTimes:
        """Dead times with what they explain."""
        loglik = 0.0
        for group in self.groups:
            alive("dead times")
            rest = _rest(group.columns(samples, range(len(samples))), group.targets)
            loglik += float(group.loglik(np.sum(rest**2, axis=0)))
        return DeadTimes(samples, loglik)

    def noise(self, samples: Indices) -> tuple[Array, ...]:
        """Innovations filters of what models with these dead times leave of each output, in rows as recorded."""
        residuals = dict[int, list[Array]]()
        for group in self.groups:
            rest = _rest(group.columns(samples, range(len(samples))), group.targets)
            for part in group.parts:
                for output, values in zip(group.outputs.tolist(), rest[part].T, strict=True):
                    residuals.setdefault(output, []).append(values)
        filters = []
        for output in sorted(residuals):
            lengths = [len(values) for values in residuals[output]]
            products = correlations([np.fft.rfft(values) for values in residuals[output]], lengths)
            orders = NoiseOrders(*autoregression(products, min(lengths)))
            filters.append(orders.innovations(sum(lengths), 2 * self.each))
        return tuple(filters)

    def _value(self, dead_times: DeadTimes) -> float:
        return dead_times.loglik - self.each * numbers_of(dead_times.samples)

    def _alone(self, i: int, samples: Indices) -> Array:
        """Log-likelihood for every dead time of one input, beside those of the others."""
        values = np.zeros(self.most + 1)
        for group in self.groups:
            others = group.columns(samples, [j for j in range(len(samples)) if j != i])
            rest, late = _rest(others, group.targets), group.late[i]
            onto = np.linalg.solve(_gram(others), others) if len(others) else others
            products = late @ rest
            inner = late @ late.transpose(0, 2, 1) - (late @ others.T) @ (onto @ late.transpose(0, 2, 1))
            explained = np.sum(products * np.linalg.solve(_ridged(inner), products), axis=1)
            values += group.loglik(np.sum(rest**2, axis=0) - explained)
        return values


def _ridged(gram: Array) -> Array:
    """Inner products with a little of their own size more, so that nearly collinear columns stay apart."""
    size = np.diagonal(gram, axis1=-2, axis2=-1)
    return gram + np.where(size > 0, TUNING.ridge * size, 1.0)[..., None] * np.eye(gram.shape[-1])


def _gram(columns: Array) -> Array:
    return _ridged(columns @ columns.T)


def _rest(columns: Array, targets: Array) -> Array:
    """What columns (k, N) do not explain of targets (N, q)."""
    if not len(columns):
        return targets
    return np.asarray(targets - columns.T @ np.linalg.solve(_gram(columns), columns @ targets))

"""Inputs that act later, each by a dead time of its own.

The response of a pole to a late input is its response to the input, later by as many samples, beside a free motion.
So the columns of all dead times are parts of those that an input makes from rest, and one filter of the noise serves
all of them.  Inputs take turns: each gets the whole samples that explain most beside the others, for given poles and
noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from ..._checks import EPS
from ..._heartbeat import alive
from ..._types import Array, ComplexArray, Indices
from ..regression.elimination import orthogonal, without
from ..regression.free import FreeProjection, Lateness
from ..regression.modal_regressors import SampledModes
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.channel_rows import Experiments, is_short
from ..search.findings import Cause, Finding
from ..search.fitted_modes import FreeFit
from ..search.free_search import NoiseOrders
from ..search.path import FreePath
from ..search.predictor_states import ranked_predictors
from ..search.whitening import correlations
from .assumptions import Anew, Search, rows_as_in
from .delays import LONGEST_DELAY, are_heavy, bic_within, leaves_traces

_MOSTLY = 0.5  # of the squares of outputs: lags that leave more of them say little of dead times
_SCANS = 3  # searches with the delays that the last one says
_ROWS = 100  # of the covariance of a predictor
_LAGS = 4  # of different rates, with which delays are looked for

# the comparison of dead times
_TURNS = 8  # of all inputs
_ROUNDS = 3  # of dead times and noise in turn
_SAMPLES = 3000  # of each record that are looked at


def of_late_inputs(channels: Experiments, search: Search) -> FreeFit | None:
    """Fit inputs that act later, each by a time of its own, where a few lags already tell; None elsewhere.

    These have to explain most of the outputs, and of what past outputs and inputs foretell.  The fit has to be likelier
    than what a search without dead times finds that begins with its poles and its noise, with one more mode at most:
    more of them would come to stand for dead times one by one.
    """
    path = search.path(channels)
    rows = [record for record in path.plain.data if isinstance(record, FreeRecord)]
    proposed = _proposed_dead_times(rows, path.felt.shape[1], np.zeros(0, complex))
    if proposed is None:
        return None
    late_path = search.path(channels, _lateness_of(proposed.times, path.felt.shape[0]))
    late_rows = late_path.plain.data
    still, lagging = (FreeProjection(late_rows, p).losses for p in (np.zeros(0, complex), proposed.lags))
    if np.mean(lagging / np.maximum(still, np.finfo(float).tiny)) > _MOSTLY:
        return None
    late_path.whiten(proposed.noise, late_path.power)
    if _is_foretold_better(rows, FreeProjection(late_path.search.data, proposed.lags)):
        return None
    lags = _as_many(late_path, proposed.lags, search.assumptions.real_poles)
    late = search.along(late_path, channels, np.append(search.begin, lags))
    try:
        late = late if late.interrupted else _in_best_dead_times(late, search)
    except KeyboardInterrupt:
        return replace(late, interrupted=True)
    if late.interrupted:
        return late
    path.whiten(late.noise, path.power)
    rival = replace(search, most=min(search.most, late.order + search.automatic))
    return _likelier_late(late, rival.along(path, channels, late.projection.p))


def _as_many(path: FreePath, lags: ComplexArray, real_poles: int | str) -> ComplexArray:
    """Return those of some lags that explain most, as many as real poles are given."""
    while real_poles != "auto" and len(lags) > int(real_poles):
        lags = np.delete(lags, np.argmin(FreeProjection(path.search.data, lags).evidence))
    return lags


def _is_foretold_better(rows: Sequence[FreeRecord], lagging: FreeProjection) -> bool:
    """Whether a predictor from past outputs and inputs leaves less than half of the squares that late lags leave."""
    outputs = len(lagging.losses)
    ranked, _ = ranked_predictors(rows, outputs, _ROWS)
    if not ranked:
        return False
    _, states, best = ranked[0]
    counts = np.zeros(outputs)
    for record in lagging.experiments:
        counts[record.outputs] += record.samples
    errors = float(np.mean(np.log(np.maximum(lagging.losses, np.finfo(float).tiny) / counts)))
    return bool(float(best.errors[states]) / outputs < errors + np.log(_MOSTLY))


def with_dead_times(fit: FreeFit, anew: Anew, search: Search) -> FreeFit | None:
    """Let inputs of a fit act later, each by a time of its own, where that explains more; None elsewhere.

    Nothing is looked for where what is left shows nothing of the inputs, and no pole could stand for a dead time.
    """
    p = fit.projection.p
    mimics = are_heavy(p)
    if fit.rounding or not (fit.noise or mimics.any() or leaves_traces(fit.projection)):
        return None
    proposed = _proposed_dead_times(_of_fit(fit), len(fit.input_delay), p[~mimics]) if not mimics.all() else None
    if proposed is None:  # lags alone were looked at before
        return None
    late = anew(_lateness_of(proposed.times, len(fit.delay)), fit.offset, None)
    return _likelier_late(_in_best_dead_times(late, search), fit)


def _likelier_late(late: FreeFit, on_time: FreeFit) -> FreeFit | None:
    """Return a fit with dead times and findings that say so, where it is likelier than one without; None elsewhere."""
    if on_time.interrupted:
        return replace(late, interrupted=True)
    gain = 0.5 * (_criterion(on_time) - _criterion(late))
    if gain <= TUNING.sure:
        return None
    times = zip(late.channels[0].input_labels, late.input_delay.tolist(), strict=True)
    findings = (Finding(Cause.INPUT_DELAY, (time,), gain, label) for label, time in times if time)
    return replace(late, findings=(*on_time.findings, *findings), delay_gain=gain)


def _in_best_dead_times(fit: FreeFit, search: Search) -> FreeFit:
    """Fit with the dead times that are the likeliest for the slowest poles and the noise, and poles for these.

    Fast poles may stand for a part of a dead time.
    """
    for _ in range(_SCANS):
        before, slowest = _dead_samples(fit), fit.projection.p[np.argsort(np.abs(fit.projection.p))]
        trials = []
        for count in range(len(slowest), 0, -1):
            scan = _scan(_of_fit(fit), slowest[:count], len(before))
            dead = scan.refined(before, fit.noise)
            trials.append((scan.cost(dead), dead.samples, scan.p))
        if not trials:
            break
        _, samples, p = min(trials, key=lambda trial: trial[0])
        if np.array_equal(samples, before) and len(p) == len(slowest):
            break
        lateness = _lateness_of(fit.channels[0].dt * samples, len(fit.delay))
        again = search.anew(fit)(lateness, fit.offset, p)
        if _criterion(again) >= _criterion(fit):
            break
        fit = again
    return fit


@dataclass(frozen=True)
class _Proposal:
    """Times (m,) by which inputs act later, with the lags beside which they are likely, and the noise of these."""

    times: Array
    lags: ComplexArray
    noise: tuple[Array, ...]


def _proposed_dead_times(rows: Sequence[FreeRecord], inputs: int, p: ComplexArray) -> _Proposal | None:
    """Return times by which inputs act later, that some modes and a few lags are likelier with by far than any without.

    A lag of second order looks like one of first order and a dead time: more lags without dead times have to be less
    likely as well.  None where there are no such times.
    """
    steps = [record.hold.h for record in rows]
    if inputs < 2 or np.ptp(steps) > EPS * max(steps) or is_short(rows[0]):
        return None
    start = np.zeros(inputs, int)
    slowest = 6.0 / min(record.length for record in rows)
    lag = np.geomspace(3 * slowest, 0.5, _LAGS)[:, None]
    single = [np.zeros(1), *lag]  # an integrator first
    several = [*(lag[:-1] * [1.0, 3.0]), *(lag * [0.0, 1.0])]
    several += [np.geomspace(slowest, 0.5, count) for count in (3, 4, 6)]
    trials, least = [], np.inf
    for rates in (single, several):
        for lags in (-np.array(row, complex) / steps[0] for row in rates):
            scan = _scan(rows, np.append(p, lags), inputs)
            without, late = scan.likeliest(start)
            least = min(least, scan.cost(without))
            trials.append((scan.cost(late), late, lags))
        cost, late, lags = min(trials, key=lambda trial: trial[0])
        if cost > least - TUNING.likely:
            return None
    return _Proposal(np.asarray(steps[0] * late.samples), lags.astype(complex), late.noise)


def _lateness_of(times: Array, outputs: int) -> Lateness:
    """Return delays that have these dead times of the inputs: what all inputs share is one of the outputs."""
    common = 0.0 if np.ptp(times) else float(times[0])
    return Lateness(np.full(outputs, common), times - common)


def _dead_samples(fit: FreeFit) -> Indices:
    """Return samples by which each input acts later, with what all outputs are late by."""
    return np.asarray(np.rint((fit.input_delay + fit.delay.min()) / fit.channels[0].dt), int)


def _of_fit(fit: FreeFit) -> list[FreeRecord]:
    """Return the records of a fit without delays."""
    moving = any(rows.moving for rows in fit.projection.experiments)
    return rows_as_in(fit, fit.channels, moving)


def _scan(rows: Sequence[FreeRecord], p: ComplexArray, inputs: int) -> _DeadTimeScan:
    """Return the scan of dead times of inputs for some poles."""
    count = sum(record.samples * len(record.outputs) for record in rows)
    return _DeadTimeScan(rows, p, _longest_dead_time(rows), 0.5 * float(np.log(count)), inputs)


def _longest_dead_time(rows: Sequence[FreeRecord]) -> int:
    """Return the samples of the longest dead time that is looked for."""
    return min(LONGEST_DELAY, min(record.length for record in rows) // 10)


def _criterion(fit: FreeFit) -> float:
    """Return the BIC over the samples that the longest dead times leave to all fits, these among the parameters."""
    most = _longest_dead_time(_of_fit(fit)) * fit.channels[0].dt - float(fit.input_delay.max(initial=0.0))
    return bic_within(fit, 0.0, most, _numbers_of(_dead_samples(fit)))


def _numbers_of(samples: Indices) -> int:
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
class _DeadTimeScan:
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
        unknowns = _numbers_of(dead_times.samples) + states * (1 + outputs * self.inputs)
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


def _groups(scan: _DeadTimeScan, noise: tuple[Array, ...]) -> list[_Group]:
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
    scan: _DeadTimeScan, rows: FreeRecord, members: list[int], b: Array, columns: tuple[Array, Array, Array]
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
            filters.append(NoiseOrders.of(products, min(lengths)).innovations(sum(lengths), 2 * self.each))
        return tuple(filters)

    def _value(self, dead_times: DeadTimes) -> float:
        return dead_times.loglik - self.each * _numbers_of(dead_times.samples)

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

"""States of a predictor of outputs beside inputs: what they tell of the number of poles, and of late outputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.stats import chi2

from ..._types import Array, Indices
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING

_RANK = 1e-10  # of a variance: what cannot be told from rounding
_CHANCE = 1e-6  # probability of what inputs that do nothing foretell
_SAMPLES_EACH = 10  # of the records for each sample of the past of each signal

# late outputs
_ROWS = 100  # of a covariance
_SHARE = 10  # of the shortest record: no delay is longer
_LONGEST = 1000  # samples
_SPARED = 0.5  # of the states that a delay spares, which have to show in the criterion
_NEXT_TO_NOTHING = 0.01  # of what all inputs foretell
_PATIENCE = 2, 6  # delays one after the other that are no likelier, after which none is looked at; more beyond the past


def cross_correlations(y: Array, lags: int) -> Array:
    """Correlations, sums of `y_{t+k} y_t^T` (lags + 1, p, p) of outputs (p, T)."""
    size = next_fast_len(y.shape[1] + lags, real=True)
    Y = rfft(y, size)
    return np.stack([irfft(Y[i] * Y.conj(), size)[:, : lags + 1].T for i in range(len(y))], axis=1)


def products_of_past(signals: Sequence[Array], horizon: int) -> Array:
    """Means of products of all signals from a sample to `horizon` samples before, over samples with that past.

    Parameters
    ----------
    signals : sequence of ndarray, shape (q, T)
        Records.
    horizon : int
        Samples r of the past.

    Returns
    -------
    ndarray, shape ((r + 1) q, (r + 1) q)
        In blocks of all signals at one sample, the latest first: correlations less what the ends of records are short
        of.  O(T log T + r^2 q^2).
    """
    q, count = len(signals[0]), horizon + 1
    S = np.zeros((count, q, count, q))
    for x in signals:
        # of the present samples; a sample earlier each sum has one product more at its beginning, one less at its end
        head = cross_correlations(x[:, :horizon], horizon)
        blocks = (cross_correlations(x, horizon) - head).transpose(1, 0, 2)
        S[0] += blocks
        more, less = (np.ascontiguousarray(part[:, ::-1].T) for part in (x[:, :horizon], x[:, -horizon:]))
        for k in range(1, count):
            first, last = more[k - 1], less[k - 1]
            blocks = blocks[:, :-1] + np.einsum("a,sb->asb", first, more[k - 1 :])
            blocks -= np.einsum("a,sb->asb", last, less[k - 1 :])
            S[k, :, k:] += blocks
    products = S.reshape(count * q, count * q)
    lower = np.tril_indices(len(products), -1)
    products[lower] = products.T[lower]
    return np.asarray(products / sum(x.shape[1] - horizon for x in signals))


@dataclass(frozen=True, eq=False)
class PredictorStates:
    """States of a predictor of outputs from what outputs and inputs were in the r samples before.

        y_t = D u_t + sum_k (C (A - K C)^{k-1} (K, B - K D)) (y, u)_{t-k} + e_t

    The coefficients are those of a regression, whose errors are the innovations: so it may be in a closed loop.  As
    products of what is seen of states later and what made them, in the order of their sizes, they tell the states.

    Attributes
    ----------
    products : ndarray, shape ((r + 1) (p + m), (r + 1) (p + m))
        Means of products of `((y, u)_t, (y, u)_{t-1}, .., (y, u)_{t-r})`.
    outputs, inputs : int
        Numbers p and m.
    """

    products: Array
    outputs: int
    inputs: int

    @property
    def signals(self) -> int:
        """Number of outputs and inputs."""
        return self.outputs + self.inputs

    @property
    def horizon(self) -> int:
        """Number r of samples of the past."""
        return len(self.products) // self.signals - 1

    @property
    def largest(self) -> int:
        """Most states that there can be."""
        return self.horizon * self.outputs

    @cached_property
    def _covariance(self) -> Array:
        """The products, with what keeps them definite."""
        # of the largest power of each signal: some are 0 but at the first samples
        power = np.diag(self.products).reshape(-1, self.signals).max(axis=0)
        ridge = _RANK * np.maximum(power, np.finfo(float).tiny)
        return np.asarray(self.products + np.diag(np.tile(ridge, self.horizon + 1)))

    @cached_property
    def _states(self) -> Array:
        """Combinations (r p, (r + 1) (p + m)) of signals, none of the present ones, of variance 1: strongest first."""
        S, p, q, r = self._covariance, self.outputs, self.signals, self.horizon
        known = np.arange(p, len(S))
        coefficients = cho_solve(cho_factor(S[np.ix_(known, known)]), S[known, :p]).T
        innovations = S[:p, :p] - coefficients @ S[known, :p]
        scaled = solve_triangular(np.linalg.cholesky(innovations), coefficients[:, q - p :], lower=True)
        # what is predicted k samples ahead without what comes in between
        ahead = np.zeros((r * p, r * q))
        for k in range(r):
            ahead[k * p : (k + 1) * p, : (r - k) * q] = scaled[:, k * q :]
        root = np.linalg.cholesky(S[q:, q:])
        directions = np.linalg.svd(ahead @ root, full_matrices=False)[2]
        return np.concatenate([np.zeros((r * p, q)), solve_triangular(root.T, directions.T).T], axis=1)

    @cached_property
    def _root(self) -> Array:
        """Triangular root of the covariance of inputs, states and outputs, in this order."""
        p, q = self.outputs, self.signals
        signals = np.eye(q, len(self._covariance))
        combinations = np.concatenate([signals[p:], self._states, signals[:p]])
        S = combinations @ self._covariance @ combinations.T
        return np.linalg.cholesky(S + np.diag(_RANK * np.diag(S)))

    @cached_property
    def errors(self) -> Array:
        """Logarithms (r p + 1,) of determinants of the covariances of prediction errors with 0, 1, .. states."""
        p, inputs = self.outputs, self.inputs
        rows = self._root[-p:]
        columns = rows[:, inputs:-p].T[::-1]
        least = rows[:, -p:] @ rows[:, -p:].T
        explained = np.concatenate([np.zeros((1, p, p)), np.cumsum(columns[:, :, None] * columns[:, None], axis=0)])
        return np.asarray(np.linalg.slogdet(least + explained)[1][::-1])

    def shows_inputs(self, samples: int) -> bool:
        """Return whether inputs of so many samples foretell more than chance beside past outputs."""
        S, p, q = self._covariance, self.outputs, self.signals
        past = (q * np.arange(1, self.horizon + 1)[:, None] + np.arange(p)).ravel()
        coefficients = cho_solve(cho_factor(S[np.ix_(past, past)]), S[past, :p])
        alone = float(np.linalg.slogdet(S[:p, :p] - S[:p, past] @ coefficients)[1])
        numbers = p * self.inputs * (self.horizon + 1)
        return bool(chi2.sf(samples * (alone - self.errors[-1]), numbers) < _CHANCE)

    def feeds_through(self, states: int, samples: int) -> bool:
        """Return whether present inputs foretell more than chance beside so many states, in so many samples."""
        p, signals = self.outputs, np.eye(self.signals, len(self._covariance))
        determinants = []
        for inputs in (signals[p:p], signals[p:]):
            known = np.concatenate([self._states[:states], inputs, signals[:p]])
            S = known @ self._covariance @ known.T
            root = np.linalg.cholesky(S + np.diag(_RANK * np.diag(S)))[-p:, -p:]
            determinants.append(2 * float(np.sum(np.log(np.diag(root)))))
        charge = p * self.inputs * float(np.log(samples * p)) + 2 * TUNING.sure
        return samples * (determinants[0] - determinants[1]) > charge

    def idle_inputs(self, samples: int, share: float = 0.0) -> int:
        """Return for how many samples, the present one first, inputs foretell nothing, in so many samples.

        Given all past outputs and all earlier inputs: no more than chance, or than a share of what all inputs do.
        """
        p = self.outputs
        least, errors = self._without_inputs
        lost = samples * (np.linalg.slogdet(errors)[1] - float(np.linalg.slogdet(least)[1]))
        chance = p * self.inputs * float(np.log(samples * p)) * np.arange(1, len(lost) + 1)
        return int(np.argmax(np.append(lost > np.maximum(chance, share * lost[-1]), True)))

    def answer_together(self, samples: int) -> bool:
        """Return whether inputs foretell all outputs, each by itself, as early as one another, in so many samples."""
        least, errors = self._without_inputs
        lost = samples * np.log(np.diagonal(errors, axis1=1, axis2=2) / np.diag(least))
        chance = self.inputs * float(np.log(samples)) * np.arange(1, len(lost) + 1)[:, None]
        return bool(np.ptp(np.argmax(np.append(lost > chance, np.ones((1, self.outputs), bool), axis=0), axis=0)) == 0)

    @cached_property
    def _without_inputs(self) -> tuple[Array, Array]:
        """Covariances (p, p) of prediction errors, and (r + 1, p, p) of those without the latest inputs, 1, 2, ..."""
        S, p, q = self._covariance, self.outputs, self.signals
        lags = q * np.arange(self.horizon, -1, -1)[:, None]
        past, inputs = (lags[:-1] + np.arange(p)).ravel(), (lags + np.arange(p, q)).ravel()
        order = np.concatenate([past, inputs, np.arange(p)])
        rows = np.linalg.cholesky(S[np.ix_(order, order)])[-p:]
        by_inputs = rows[:, len(past) : -p].reshape(p, -1, q - p).transpose(1, 0, 2)[::-1]
        least = rows[:, -p:] @ rows[:, -p:].T
        return least, least + np.cumsum(by_inputs @ by_inputs.transpose(0, 2, 1), axis=0)

    def _regressed(self, combinations: Array, of: Array) -> Array:
        """Coefficients of some combinations of signals in `combinations` of others."""
        S = self._covariance
        return np.asarray(np.linalg.solve(of @ S @ of.T, of @ S @ combinations.T).T)

    def model(self, states: int) -> tuple[Array, Array, Array]:
        """Matrices A, C and gain K of a model with so many states."""
        p, q = self.outputs, self.signals
        signals = np.eye(q, len(self._covariance))
        known = np.concatenate([self._states[:states], signals[p:]])
        coefficients = self._regressed(signals[:p], known)
        errors = signals[:p] - coefficients @ known
        forward = self._regressed(np.roll(self._states[:states], -q, axis=1), np.concatenate([known, errors]))
        return forward[:, :states], coefficients[:, :states], forward[:, len(known) :]


def longest_past(signals: Sequence[Array], rows: int) -> int:
    """Samples of the longest past that records (channels, T) show, with covariances of so many rows at most."""
    channels, lengths = len(signals[0]), [each.shape[1] for each in signals]
    return min(rows // channels, min(lengths) // 4, sum(lengths) // (_SAMPLES_EACH * channels))


def predictors_of(signals: Sequence[Array], outputs: int, rows: int) -> list[PredictorStates]:
    """Predictors from a long and a shorter past, with covariances of so many rows, of records of outputs and inputs.

    Records `signals` (p + m, T) have means of 0; none if they are too short.
    """
    longest, inputs = longest_past(signals, rows), len(signals[0]) - outputs
    if longest < 2:
        return []
    pasts = longest, max(2, longest // 3)
    return [PredictorStates(products_of_past(signals, horizon), outputs, inputs) for horizon in pasts]


def likeliest(
    predictors: Sequence[PredictorStates], samples: int, most: int
) -> list[tuple[float, int, PredictorStates]]:
    """Numbers of states, up to the `most`, with their predictors: those of the smallest BIC first, with its value."""
    ranked = list[tuple[float, int, PredictorStates]]()
    for each in predictors:
        charge = (each.signals + each.outputs) * float(np.log(samples * each.outputs))
        costs = samples * (each.errors[: most + 1] + each.outputs * (1 + np.log(2 * np.pi)))
        ranked += [(float(cost) + size * charge, size, each) for size, cost in enumerate(costs) if size]
    return sorted(ranked, key=lambda row: row[0])


def ranked_predictors(
    records: Sequence[FreeRecord], outputs: int, rows: int
) -> tuple[list[tuple[float, int, PredictorStates]], int]:
    """Predictors of all outputs as in `likeliest`, with covariances of so many rows, and the samples that they count.

    None where records are too short, or have gaps.
    """
    signals = signals_of(records, outputs)
    predictors = predictors_of(signals, outputs, rows) if signals else []
    samples = sum(each.shape[1] for each in signals or ())
    return likeliest(predictors, samples, max((each.largest for each in predictors), default=0)), samples


def signals_of(records: Sequence[FreeRecord], outputs: int) -> list[Array] | None:
    """Outputs and inputs (p + m, T) less their means; None where samples are missing, or outputs constant."""
    inputs = max((int(rows.acting.max(initial=-1)) + 1 for rows in records), default=0)
    signals = []
    for rows in records:
        if not rows.complete or len(rows.outputs) != outputs or rows.level is not None or not inputs:
            return None
        both = np.zeros((outputs + inputs, rows.length))
        both[rows.outputs], both[outputs + rows.acting] = rows.measured, rows.u[: rows.inputs]
        signals.append(both - both.mean(axis=1, keepdims=True))
    return signals if all(each[:outputs].any(axis=1).all() for each in signals) else None


@dataclass(frozen=True)
class _AfterDelay:
    """The best predictor after a delay: its BIC, what a state costs that a delay spares, and the longest past.

    Then whether inputs foretell anything, and for how many samples, the present one first, nothing, or next to nothing.
    """

    cost: float
    state: float
    past: int
    shown: bool
    idle: int
    nearly_idle: int
    together: bool  # whether inputs foretell all outputs as early as one another


@dataclass(frozen=True)
class _Delays:
    """Records of so many outputs after delays, of the samples that the most of these leaves."""

    records: Sequence[FreeRecord]
    outputs: int
    most: int
    known: dict[int, _AfterDelay | None] = field(default_factory=dict)

    @classmethod
    def of(cls, records: Sequence[FreeRecord], outputs: int) -> _Delays:
        """Delays of up to a tenth of the shortest record."""
        return cls(records, outputs, min(min((rows.length for rows in records), default=0) // _SHARE, _LONGEST))

    def after(self, samples: int) -> _AfterDelay | None:
        """Delay by some samples; None where records are too short, or there are no such delays."""
        if samples not in self.known:
            self.known[samples] = self._after(samples) if 0 <= samples <= self.most else None
        return self.known[samples]

    def _after(self, samples: int) -> _AfterDelay | None:
        late = [rows.delayed(samples * rows.hold.h, 0.0, self.most * rows.hold.h) for rows in self.records]
        signals = signals_of(late, self.outputs)
        predictors = predictors_of(signals, self.outputs, _ROWS) if signals else []
        if not predictors:
            return None
        count = sum(each.shape[1] for each in signals or ())
        longest, price = predictors[0], float(np.log(count * self.outputs))
        cost, _, best = likeliest(predictors, count, longest.largest)[0]
        idle, nearly_idle = (longest.idle_inputs(count, share) for share in (0.0, _NEXT_TO_NOTHING))
        return _AfterDelay(
            cost, best.inputs * (best.signals + self.outputs) * price, longest.horizon, longest.shows_inputs(count),
            idle, nearly_idle, longest.answer_together(count),
        )  # fmt: skip

    def where_inputs_show(self, none: _AfterDelay) -> int | None:
        """Return the least delay of some, half a past apart, after which inputs foretell anything.

        Those that are over before the samples that are left foretell nothing.
        """
        lasting = all(np.all(2 * rows.u[:, self.most :].var(axis=1) > rows.u.var(axis=1)) for rows in self.records)
        delays = range(0, self.most + 1 if lasting else 1, max(1, none.past // 2))
        return next((delay for delay in delays if (after := self.after(delay)) and after.shown), None)

    def likeliest(self, begin: int, patience: int) -> tuple[int, _AfterDelay]:
        """Return the delay of the smallest BIC about one to begin with, from where so many are no likelier."""
        known = [(after.cost, begin, after)] if (after := self.after(begin)) else []
        for step in (1, -1):
            samples, missed = min(known)[1], 0
            while missed < patience and (after := self.after(samples := samples + step)):
                missed = missed + 1 if after.cost >= min(known)[0] else 0
                known.append((after.cost, samples, after))
        return min(known)[1:]

    def predicted(self, felt: bool) -> tuple[int, float]:
        """Return the delay with which predictors foretell most, and the log-likelihood that it gains."""
        none = self.after(0)
        begin = None if none is None else self.where_inputs_show(none)
        first = None if begin is None else self.after(begin)
        if none is None or begin is None or first is None:
            return 0, 0.0
        hold = int(not felt)  # samples by which outputs follow inputs without a delay
        jump = max(0, first.nearly_idle - hold) if first.nearly_idle <= first.past else 0
        samples, best = self.likeliest(min(begin + jump, self.most), _PATIENCE[begin > 0])
        # states of a short past may hide the last samples; one that is fed through belongs to the response
        more = best.idle - hold
        gain, spared = none.cost - best.cost, samples - begin + min(more, 0)
        samples = min(max(samples + more, 0), self.most)
        return (samples, 0.5 * gain) if samples and gain > _SPARED * spared * none.state else (0, 0.0)


def predicted_delays(records: Sequence[FreeRecord], outputs: int, felt: bool) -> tuple[Indices, float]:
    """Return by how many samples each output comes later, and the log-likelihood that this gains.

    As `predicted_delay` has it for all of them; where inputs foretell some earlier than others, for each alone, if that
    gains more.
    """
    delays = _Delays.of(records, outputs)
    common, first = delays.predicted(felt), delays.after(0)
    if first is None or first.together:
        return np.full(outputs, common[0]), common[1]
    return likelier_apart(common, partial(predicted_delay, felt=felt), records, outputs)


def likelier_apart(
    common: tuple[int, float], shown: Callable[[Sequence[FreeRecord], int], tuple[int, float]],
    records: Sequence[FreeRecord], outputs: int,
) -> tuple[Indices, float]:  # fmt: skip
    """Return the samples by which all outputs come late, or those that each shows alone, and what these gain, if more.

    `shown` gives samples and gain of so many outputs.
    """
    own = [shown(_of_output(records, output), 1) for output in range(outputs)]
    gain = sum(each for _, each in own)
    if gain > common[1]:
        return np.array([late for late, _ in own]), gain
    return np.full(outputs, common[0]), common[1]


def _of_output(records: Sequence[FreeRecord], output: int) -> list[FreeRecord]:
    """Return records of one of the outputs."""
    seen = (record.among_outputs(record.outputs == output) for record in records if output in record.outputs)
    return [replace(record, outputs=np.zeros(1, int)) for record in seen]


def predicted_delay(records: Sequence[FreeRecord], outputs: int, felt: bool) -> tuple[int, float]:
    """Return by how many samples outputs come later than the response to inputs, so that predictors foretell most.

    For so many samples inputs foretell nothing, and each of them spares a state for each input.  None come before: in a
    closed loop inputs answer to outputs.

    Parameters
    ----------
    records : sequence of FreeRecord
        Records without a delay.
    outputs : int
        Number of outputs.
    felt : bool
        Whether some outputs answer to inputs at once; others follow them by a sample.

    Returns
    -------
    tuple of int and float
        Samples, up to a tenth of the shortest record and 1000, and the log-likelihood that they gain; 0 where records
        are too short, or show no delay.
    """
    return _Delays.of(records, outputs).predicted(felt)

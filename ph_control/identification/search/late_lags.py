"""Lags that come late: the delay at which one or two of them explain the outputs best.

For lags of given rates the regressions at all delays are correlations of their responses to the input with the outputs,
by the fast Fourier transform.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import lfilter

from ..._checks import EPS
from ..._types import Array, Indices
from ..regression.elimination import orthogonal, without
from ..regression.modal_regressors import SampledModes
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING

_SAMPLES = 20_000  # of each record that are looked at
_RATES = 16  # of late lags, from the slowest to the fastest
_EACH = 3  # of these is looked at first
_PAIRS = 4  # of lags without a delay
_SHARE = 10  # of the shortest record: no delay is longer
_MOSTLY = 0.2  # of the squares of outputs that a late lag leaves at most
_ROUGHLY = 0.35  # of those that the best of a few rates leaves
_CLEARLY = 0.8  # of the squares that lags without a delay leave: a late one leaves less


@dataclass(frozen=True)
class _LateLags:
    """Lags with a delay: twice their negative log-likelihood with its penalty, delay, rates, and squares left over."""

    cost: float
    samples: int
    rates: Array
    losses: Array


@dataclass(frozen=True)
class LateLagScan:
    """Records of one input, of which as many samples as the longest delay has are left out where they may be moving."""

    records: Sequence[FreeRecord]
    outputs: int
    most: int

    @classmethod
    def of(cls, records: Sequence[FreeRecord], outputs: int) -> LateLagScan | None:
        """See the first samples of records of the same step, None where there are too few."""
        most = min((min(record.length, _SAMPLES) for record in records), default=0) // _SHARE
        same = len({record.hold.h for record in records}) == 1
        scan = cls(records, outputs, most)
        return scan if same and most > 1 and scan._counts.sum() > most else None

    def likeliest(self) -> tuple[int, float] | None:
        """Return the samples of the delay that a lag or two show, and the log-likelihood gained; None if none do."""
        slowest, lags = 0.4 / self.most, np.geomspace(0.4 / self.most, 0.5, _RATES)
        still = self._on_time(lags[:0])
        rough = self._likeliest_of([lags[k : k + 1] for k in range(1, _RATES, _EACH)])
        if np.mean(rough.losses / still) > _ROUGHLY:
            return None
        near = np.flatnonzero(np.abs(np.log(lags / rough.rates)) < _EACH * np.log(lags[1] / lags[0]) - EPS)
        likeliest = self._likeliest_of([lags[k : k + 1] for k in near.tolist()])
        if not likeliest.samples or np.mean(likeliest.losses / still) > _MOSTLY:
            return None
        # a lag of second order looks like one of first order that comes later
        double = self._likeliest_of([np.append(likeliest.rates, rate) for rate in lags])
        likeliest = min(likeliest, double, key=lambda late: late.cost)
        pairs = np.geomspace(slowest, 0.25, _PAIRS)[:, None] * [1.0, 2.0]
        several = [*pairs, *(np.geomspace(slowest, 0.5, count) for count in (3, 4, 6))]
        gain = 0.5 * min(float(self._counts @ np.log(self._on_time(rates) / likeliest.losses)) for rates in several)
        least = max(TUNING.likely, -0.5 * float(np.log(_CLEARLY)) * self._counts.sum())
        return (likeliest.samples, gain) if likeliest.samples and gain > least else None

    @cached_property
    def _counts(self) -> Array:
        """Samples of each output."""
        counts = np.zeros(self.outputs)
        for record in self.records:
            counts[record.outputs] += len(self._window(record))
        return counts

    def _likeliest_of(self, several: Sequence[Array]) -> _LateLags:
        """Return the lags of the best criterion, of some rates, with their delay."""
        late = np.stack([self._late(rates) for rates in several])
        unknowns = np.array([(1 + self.outputs) * len(rates) for rates in several])
        costs = np.einsum("o,rod->rd", self._counts, np.log(late)) + np.log(self._counts.sum()) * unknowns[:, None]
        place, samples = (int(k) for k in np.unravel_index(np.argmin(costs), costs.shape))
        return _LateLags(float(costs[place, samples]), samples, several[place], late[place, :, samples])

    def _window(self, record: FreeRecord) -> Indices:
        """Return the samples of a record that are looked at."""
        first = self.most if record.moving else 0
        return first + np.flatnonzero(record.observed[first : min(record.length, _SAMPLES)])

    def _columns(self, record: FreeRecord, rates: Array) -> tuple[Array, Array, Array]:
        """Return outputs (q, N) without what a record has of its own, a basis (k, N) of this, and responses (n, T)."""
        window, instants = self._window(record), np.arange(min(record.length, _SAMPLES))
        own = [instants ** float(power) for power in range(record.offset)]
        own += [*np.exp(-np.multiply.outer(rates, instants))] if record.moving else []
        basis = orthogonal(np.reshape(own, (-1, len(instants)))[:, window].T)[0]
        modes = SampledModes.of(record.hold, (-rates / record.hold.h).astype(complex))
        steps = zip(modes.multiplier.real, modes.b0.real, modes.b1.real, strict=True)
        responses = [lfilter([b1, b0], [1.0, -each], record.u[0, : len(instants)]) for each, b0, b1 in steps]
        return without(record.measured[:, window].T, basis).T, basis.T, np.reshape(responses, (-1, len(instants)))

    def _late(self, rates: Array) -> Array:
        """Return squares (outputs, delays) that lags of some rates leave together with each delay."""
        count, delays = len(rates), self.most + 1
        gram, products = np.zeros((self.outputs, delays, count, count)), np.zeros((self.outputs, delays, count))
        total = np.zeros(self.outputs)
        for record in self.records:
            y, basis, responses = self._columns(record, rates)
            window, whole = self._window(record), np.zeros((len(y) + len(basis) + 1, responses.shape[1]))
            whole[:, window] = [*y, *basis, np.ones(len(window))]
            with_each = _products(whole[:-1], responses, delays)
            products[record.outputs] += with_each[: len(y)]
            own, pairs = with_each[len(y) :], (responses[:, None] * responses).reshape(count**2, -1)
            squares = _products(whole[-1:], pairs, delays).reshape(delays, count, count)
            gram[record.outputs] += squares - np.einsum("kdi,kdj->dij", own, own)
            total[record.outputs] += np.sum(y**2, axis=1)
        return _left_over(total[:, None], gram, products)

    def _on_time(self, rates: Array) -> Array:
        """Return squares (outputs,) that lags of some rates leave together without a delay."""
        count = len(rates)
        gram, products = np.zeros((self.outputs, count, count)), np.zeros((self.outputs, count))
        total = np.zeros(self.outputs)
        for record in self.records:
            y, basis, responses = self._columns(record, rates)
            columns = without(responses[:, self._window(record)].T, basis.T)
            gram[record.outputs] += columns.T @ columns
            products[record.outputs] += y @ columns
            total[record.outputs] += np.sum(y**2, axis=1)
        return _left_over(total, gram, products)


def _products(rows: Array, responses: Array, delays: int) -> Array:
    """Return sums of products (rows, delays, n) with responses (n, T) that come 0, 1, .. samples later."""
    size = next_fast_len(rows.shape[1] + delays, real=True)
    spectra = rfft(rows, size)[:, None] * rfft(responses, size).conj()
    return np.asarray(irfft(spectra, size)[..., :delays].transpose(0, 2, 1))


def _left_over(total: Array, gram: Array, products: Array) -> Array:
    """Return what columns leave of sums of squares (..), of inner products (.., k, k), and (.., k) with the outputs."""
    power = np.diagonal(gram, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(power > 0, power, 1.0))
    gram, products = gram / (scale[..., None] * scale[..., None, :]), products / scale
    solved = np.linalg.solve(gram + TUNING.ridge * np.eye(scale.shape[-1]), products[..., None])[..., 0]
    return np.maximum(total - np.sum(products * solved, axis=-1), EPS * total + np.finfo(float).tiny)

"""The search for damped modes with residues of any phase.

The same path as for lossless modes, one joining at a time where it explains most of what is left.  Around the bins of
what is left of a transform, `z E = lambda E + beta U + gamma z` is a linear problem in the pole `lambda` as well; as
peaks may be much wider than a bin, it is solved over windows of several widths.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..._checks import EPS
from ..._options import Interpolation
from ..._types import Array, ComplexArray, Indices
from ...modal.discretization import Hold
from ..regression.elimination import orthogonal, reduced, tolerance, without
from ..regression.free import ROUNDED, FreeProjection, FreeRows
from ..regression.frequency_rows import FreeResponse, Term
from ..regression.sections import PoleRegion
from ..regression.spectral_rows import ChannelSpectra, FreeWindow, real_rows
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from .whitening import autoregression, correlations, wandering

_WIDTHS = 4  # half-widths of a mode that the half of its window has, at least
_ROUNDS = 3  # of the local problem, weighted with the pole found
_LEAST = 3  # bins: half-width of the narrowest window
_WIDE = (96, 384, 1536)  # half-widths of the windows, in bins, of peaks that much noise hides
_EVERYWHERE = 1 << 12  # bins up to which all are centres of windows, and rows; above, those where most is left
_PEAKS = 200
_ABOUNDING = 10  # points, and four for each pole: with fewer a real pole may stand for modes outside the band
_COMPARED = 16
_RATES = 30  # of real poles that are compared, from one
_APART = 0.02  # of the square of what a real pole adds: with less beside what others can do it is none of its own
_SLOWEST = 0.03  # bins: a fifth of the reciprocal of the length
_PLACES = 8  # of a mode between two of few points, and half-widths in bins there
_DECAYS = (0.01, 0.1, 0.5, 1.5)
_ALL_AT_ONCE = 1 << 14  # real equations up to which poles are those of a common denominator
_RELOCATIONS = 8  # of these
_CROWDED = 0.01  # damping ratio that they begin with
_ABOVE = 2.0  # of the largest frequency: where modes above the band still shape what is in it
_LONGEST_PAST = 64  # samples that a filter of the noise takes


Residuals = list[ComplexArray]  # of the outputs (q, K) of each set of rows, in the frequency domain


@dataclass(frozen=True)
class NoiseOrders:
    """Innovations filters of the noise of an output, their numbers, and their variances over that of the rows."""

    filters: list[Array]
    unknowns: Array
    variances: Array

    @classmethod
    def of(cls, products: Array, shortest: int) -> NoiseOrders:
        """Autoregressions of order 0, 1, ..., and noise that wanders beside white noise, of residuals."""
        models, variances = autoregression(products[: TUNING.past_of_noise + 1], shortest)
        filters = [np.concatenate([[1.0], -phi]) for phi in models]
        others = list(wandering(products, shortest))
        unknowns = np.append(np.arange(len(models)), np.full(len(others), 2))
        return cls(
            filters + [b for b, _ in others], unknowns, np.append(variances, [variance for _, variance in others])
        )

    def costs(self, count: int, each: float) -> Array:
        """What a criterion says of each filter that charges so much for a number."""
        return np.asarray(count * np.log(self.variances) + each * self.unknowns)

    def innovations(self, count: int, each: float) -> Array:
        """The innovations filter that a criterion prefers."""
        return self.filters[int(np.argmin(self.costs(count, each)))]


@dataclass(frozen=True, eq=False)
class FreeModel:
    """Damped modes with their residuals, and the sum of squares of each output in the units of the data."""

    projection: FreeProjection
    residuals: Residuals
    losses: Array
    search: FreeSearch | None = None  # in whose rows these are
    sizes: Array | None = None  # what outputs were multiplied by in these

    @cached_property
    def noise(self) -> list[NoiseOrders]:
        """Autoregressions of the residuals of each output."""
        return [] if self.search is None else self.search.noise(self.residuals)

    @property
    def innovations(self) -> tuple[Array, ...]:
        """Filter of each output that made the rows; none where these are the data."""
        return self.search.innovations if isinstance(self.search, Records) else ()

    @property
    def p(self) -> ComplexArray:
        """Poles."""
        return self.projection.p

    @property
    def loss(self) -> float:
        """Sum of squares."""
        return float(self.losses.sum())


@dataclass(frozen=True)
class FreeSearch:
    """Data, and where poles are looked for in them; whether a mode may become overdamped, and two real poles a mode."""

    data: Sequence[Any]
    kinds_may_change: bool = True

    @property
    def region(self) -> PoleRegion:
        """Where poles are looked for."""
        ends = min(rows.bin for rows in self.data), max(rows.ceiling for rows in self.data)
        return PoleRegion(*ends, self.kinds_may_change)

    @property
    def crowding(self) -> float:
        """Distance of the peaks of two modes, beyond their half-widths, within which one only corrects the other."""
        return TUNING.damped_apart * self.region.bin

    def unknowns(self, modes: int, real_poles: int = 0) -> int:
        """Parameters of a model: poles, residues and what is fed through of each output, nuisance parameters."""
        n, states = modes + real_poles, 2 * modes + real_poles
        own = sum((rows.own_unknowns(n) - real_poles * rows.moving) * len(rows.outputs) for rows in self.data)
        entries = {(output, k) for rows in self.data for output in rows.outputs.tolist() for k in rows.acting.tolist()}
        return states + len(entries) * (states + any(rows.through for rows in self.data)) + own

    def unknowns_of(self, p: ComplexArray) -> int:
        """Those of a model with these poles."""
        real = int(np.sum(p.imag == 0))
        return self.unknowns(len(p) - real, real)

    def with_kinds(self, changing: bool) -> FreeSearch:
        """The same where modes may become overdamped, if the data tell them from a background."""
        return replace(self, kinds_may_change=changing and self.shows_background(2))

    def shows_background(self, n: int) -> bool:
        """Whether the data tell n poles from the background that modes outside the band leave."""
        return True

    def lag(self, projection: FreeProjection, yielding: bool) -> tuple[complex, float]:
        """The real pole that explains most of the residuals of a model, and how much.

        The real poles there are may be `yielding`, to first order: relaxations that lie side by side explain much
        together that none of them does beside the others as they are.
        """
        rates = np.geomspace(_SLOWEST * self.region.bin, self.region.ceiling, _RATES)
        spread = self.spread(projection.experiments)
        gains = np.sum(
            [explained_by_lags(rows, projection, k, rates, yielding) for k, rows in enumerate(spread)], axis=0
        )
        best = int(np.argmax(gains))
        return complex(-rates[best]), float(gains[best])

    def spread(self, rows: Sequence[FreeRows]) -> Sequence[FreeRows]:
        """The rows, or as many spread over the band as show what has no peak."""
        return rows

    def rows(self, p: ComplexArray) -> Sequence[FreeRows]:
        """All of the data, or what of them is about some modes."""
        return self.data

    def scaled(self, sizes: Array) -> FreeSearch:
        """The same with each output multiplied by its entry of `sizes` (q,)."""
        raise NotImplementedError

    def residuals(self, projection: FreeProjection) -> Residuals:
        """Residuals of a model."""
        raise NotImplementedError

    def rounded(self, outputs: int) -> Array:
        """Losses of so many outputs that may be rounding of what was measured; 0 of responses."""
        return np.zeros(outputs)

    def losses(self, residuals: Residuals) -> Array:
        """Sum of squares of each output."""
        raise NotImplementedError

    def candidates(self, model: FreeModel, least: float = 0.0) -> tuple[ComplexArray, Array]:
        """Poles of modes that explain most of what a model leaves, the strongest first, and how much.

        Of those that explain less than the `least` only some.
        """
        raise NotImplementedError

    def model(self, projection: FreeProjection) -> FreeModel:
        """A model with its residuals."""
        residuals = self.residuals(projection)
        return FreeModel(projection, residuals, self.losses(residuals), self)

    def noise(self, residuals: Residuals) -> list[NoiseOrders]:
        """Autoregressions of the residuals of each output; none where these are no records."""
        return []


def _unfiltered(spectrum: ComplexArray, b: Array, length: int) -> ComplexArray:
    """Spectrum of what was filtered; nothing at bins that the filter takes away, as those of a drift."""
    gain = np.fft.rfft(b, length)
    kept = np.abs(gain) > length * EPS * np.abs(gain).max()
    return np.asarray(np.divide(spectrum, gain, out=np.zeros_like(spectrum), where=kept))


def explained_by_lags(
    rows: FreeRows, projection: FreeProjection, experiment: int, rates: Array, yielding: bool
) -> Array:
    """Decrease of the sum of squares by each of some real poles, added to a model whose own may be `yielding`."""
    p, outputs = projection.p, len(rows.outputs)
    known = np.concatenate(list(rows.evaluated(p).blocks(slopes=yielding)), axis=1)
    own = rows.own_unknowns(len(p)) + rows.inputs * (2 * len(p) + rows.through)
    basis, _ = orthogonal(known[:own].T)
    residuals = without(known[-outputs:].T, basis)
    turning = np.flatnonzero(p.imag == 0) if yielding else np.zeros(0, int)
    turned = np.zeros((*residuals.shape, 0))
    if len(turning):
        slopes = without(_turned_by(rows, projection, experiment, turning, known[own:]), basis)
        turned, _ = orthogonal(slopes.reshape(residuals.size, len(turning)))
        residuals = without(residuals.ravel(), turned).reshape(residuals.shape)
        turned = turned.reshape(*residuals.shape, -1)
    lags = rows.lags(rates) if isinstance(rows, FreeWindow) else _lags(rows, rates)
    lags = lags / np.maximum(np.linalg.norm(lags, axis=2, keepdims=True), np.finfo(float).tiny)
    lags = lags - lags @ basis @ basis.T
    sizes, axes = np.linalg.eigh(lags @ lags.transpose(0, 2, 1))
    shown = sizes > tolerance(rows.samples, lags.shape[1])
    lags = np.einsum("kji,kjt->kit", axes, lags) * (shown / np.sqrt(np.where(shown, sizes, 1.0)))[:, :, None]
    shares = lags @ residuals
    if not turned.shape[2]:
        return np.asarray(np.sum(shares**2, axis=(1, 2)))
    gains = np.zeros(len(rates))
    for place, (some, share) in enumerate(zip(lags, shares.reshape(len(rates), -1), strict=True)):
        crossed = np.einsum("ct,tol->col", some, turned).reshape(len(share), turned.shape[2])
        free, directions = np.linalg.eigh(np.eye(len(share)) - crossed @ crossed.T)
        apart = free > _APART
        gains[place] = np.sum((directions.T @ share)[apart] ** 2 / free[apart])
    return gains


def _lags(rows: FreeRows, rates: Array) -> Array:
    """What the motion and the inputs of each of some decaying real poles span, shape (rates, columns, rows)."""
    k, starts = len(rates), [0] * rows.moving
    starts += [rows.own_unknowns(k) + place * (2 * k + rows.through) for place in range(rows.inputs)]
    columns = np.concatenate(list(rows.evaluated((-rates).astype(complex)).blocks(slopes=False)), axis=1)
    return np.asarray(columns[np.arange(k)[:, None] + np.array(starts, int)])


def _turned_by(
    rows: FreeRows, projection: FreeProjection, experiment: int, poles: Indices, derivatives: Array
) -> Array:
    """Derivatives of the outputs by real poles, one column for each output and pole, from those of the columns."""
    n, outputs = len(projection.p), len(rows.outputs)
    sets = int(rows.moving) + rows.inputs
    slopes = derivatives[: 2 * n * sets].reshape(sets, 2 * n, -1)[:, poles]
    weights = [projection.own[experiment][poles]] if rows.moving else []
    weights += [
        projection.shared[place * (2 * n + projection.has_feedthrough) + poles][:, rows.outputs]
        for place in rows.acting.tolist()
    ]
    turned = np.einsum("ilt,ilo->tol", slopes, np.stack(weights))
    return np.asarray(turned.reshape(len(turned), outputs * len(poles)))


@dataclass(frozen=True)
class Records(FreeSearch):
    """Records in time, or what the `innovations` filter of the noise of each output makes of them."""

    data: Sequence[FreeRecord]
    innovations: tuple[Array, ...] = ()

    @cached_property
    def spectra(self) -> list[ChannelSpectra]:
        """Transforms of all records."""
        return [ChannelSpectra.of(record) for record in self.data]

    def spread(self, rows: Sequence[FreeRows]) -> Sequence[FreeRows]:
        """The rows, or bins all over the band in place of those about modes."""
        return [FreeWindow.spread(spectrum) for spectrum in self.spectra] if self.windowed else rows

    @cached_property
    def windowed(self) -> bool:
        """Whether `rows` gives the bins about the modes only, as of long records."""
        return max(record.length for record in self.data) > TUNING.in_time and all(record.whole for record in self.data)

    def rows(self, p: ComplexArray) -> Sequence[FreeRows]:
        """The bins about the modes of long records."""
        return [FreeWindow.thinned(spectrum, p) for spectrum in self.spectra] if self.windowed else self.data

    def held(self, intersample: Interpolation) -> Records:
        """The same with inputs held otherwise between the samples."""
        return replace(self, data=[record.held(intersample) for record in self.data])

    def whitened(self, innovations: tuple[Array, ...]) -> Records:
        """Records in time made to rows in which noise with these innovations filters is white."""
        rows = [row for record in self.data for row in record.filtered(innovations)]
        return replace(self, data=rows, innovations=innovations)

    def noise(self, residuals: Residuals) -> list[NoiseOrders]:
        """Filters of the noise of each output in the data, from the residuals of the rows."""
        orders, count = [], 1 + max(int(record.outputs.max()) for record in self.data)
        rounded = self.rounded(count)
        for output in range(count):
            pairs = zip(self.data, residuals, strict=True)
            seen = [
                (record.length, part[record.outputs == output]) for record, part in pairs if output in record.outputs
            ]
            lengths = [length for length, _ in seen]
            rows = correlations([part[0] for _, part in seen], lengths, _LONGEST_PAST)
            masks = [np.fft.rfft(record.observed.astype(float)) for record in self.data if output in record.outputs]
            pairs_seen = correlations(masks, lengths, _LONGEST_PAST)
            # of means over the pairs of samples that were both measured
            sums = rows * pairs_seen[0] / np.maximum(pairs_seen, 1.0)
            b = self.innovations[output] if self.innovations else np.ones(1)
            if len(b) > 1:
                spectra = [_unfiltered(part[0], b, length) for length, part in seen]
                sums = correlations(spectra, lengths, _LONGEST_PAST)
            noise = NoiseOrders.of(sums, min(lengths))
            share = sums[0] / rows[0] if rows[0] > 0 else 1.0
            # rounding is not foretold: through a filter it is as many times as large as that makes white noise
            powers = np.array([each @ each for each in noise.filters])
            least = rounded[output] * powers / (b @ b * rows[0]) if rows[0] > 0 else 0.0
            orders.append(replace(noise, variances=np.maximum(noise.variances * share, least)))
        return orders

    def rounded(self, outputs: int) -> Array:
        """Losses of so many outputs that may be rounding of what was recorded, and are evidence of nothing."""
        losses = np.zeros(outputs)
        for record in self.data:
            losses[record.outputs] += ROUNDED * record.rounded
        return losses

    def without_constants(self) -> Records:
        """The same with outputs that have no constant."""
        return replace(self, data=[replace(rows, offset=0) for rows in self.data])

    def scaled(self, sizes: Array) -> Records:
        """The same with each output multiplied by its entry of `sizes` (q,)."""
        records = [replace(record, scale=sizes[record.outputs]) for record in self.data]
        search = replace(self, data=records)
        if "spectra" in vars(self):  # of a long record none is ever made
            pairs = zip(self.spectra, records, strict=True)
            vars(search)["spectra"] = [spectrum.scaled(record, sizes[record.outputs]) for spectrum, record in pairs]
        return search

    def residuals(self, projection: FreeProjection) -> Residuals:
        """Transforms of the residuals; 0 of missing samples, and at frequency 0 where an offset is estimated."""
        residuals, windowed = [], isinstance(projection.experiments[0], FreeWindow)
        n, predicted = len(projection.p), [] if windowed or not len(projection.p) else projection.predictions()
        for k, (spectrum, own) in enumerate(zip(self.spectra, projection.own, strict=True)):
            record = spectrum.record
            if not n:
                residual = spectrum.Y.copy()
            elif windowed:
                motion, outputs = own[:n] + 1j * own[n : 2 * n], record.outputs
                residues = projection.residues[:, outputs][:, :, record.acting]
                through = projection.feedthrough[np.ix_(outputs, record.acting)]
                residual = spectrum.unexplained(projection.p, residues, motion, through)
            else:
                residual = np.fft.rfft(record.residuals(predicted[k]))
            if record.offset:
                residual[:, 0] = 0.0
            residuals.append(residual)
        return residuals

    def losses(self, residuals: Residuals) -> Array:
        """Sum of squares over the observed samples of each output."""
        sums = np.zeros(1 + max(int(record.outputs.max()) for record in self.data))
        for part, spectrum in zip(residuals, self.spectra, strict=True):
            sums[spectrum.record.outputs] += spectrum.energies(part)
        return sums

    def candidates(self, model: FreeModel, least: float = 0.0) -> tuple[ComplexArray, Array]:
        """Of windows of all widths, the poles that explain most, of all experiments together."""
        joined: list[tuple[ChannelSpectra, list[ComplexArray]]] = []
        for spectrum, part in zip(self.spectra, model.residuals, strict=True):
            if joined and joined[-1][0].record.u is spectrum.record.u:  # outputs of one experiment
                joined[-1][1].append(part)
            else:
                joined.append((spectrum, [part]))
        experiments = [
            (Channels.of(spectrum), np.concatenate(parts) if parts[1:] else parts[0]) for spectrum, parts in joined
        ]
        shown = [channels.modes(residuals, least / len(experiments)) for channels, residuals in experiments]
        if len(experiments) > 1:
            p, _ = _joined([strongest([each], self.region.bin) for each in shown])
            shown = [(p, np.sum([channels.gains(residuals, p) for channels, residuals in experiments], axis=0))]
        return strongest(shown, self.region.bin)


def strongest(candidates: Sequence[tuple[ComplexArray, Array]], width: float) -> tuple[ComplexArray, Array]:
    """Poles, the strongest first, without those that lie within the peaks of stronger ones."""
    p, gain = _joined(candidates)
    chosen: list[int] = []
    for k in np.argsort(-gain, kind="stable"):
        apart = width + np.abs(p[k].real)
        if all(abs(p[k].imag - p[other].imag) > apart + abs(p[other].real) for other in chosen):
            chosen.append(int(k))
        if len(chosen) == _COMPARED:
            break
    return p[chosen], gain[chosen]


@dataclass(frozen=True)
class Channels:
    """Transforms of the inputs (m, K) of a record of some length, and where modes are looked for in its outputs."""

    U: ComplexArray
    length: int
    hold: Hold
    ceiling: float

    @classmethod
    def of(cls, spectrum: ChannelSpectra) -> Channels:
        """Those of a record."""
        return cls(spectrum.U, spectrum.length, spectrum.hold, spectrum.record.ceiling)

    def modes(self, residuals: ComplexArray, least: float = 0.0) -> tuple[ComplexArray, Array]:
        """Poles of modes that explain something of what is left of outputs (q, K), and how much; O(q T).

        Each within a window, in windows of several widths wherever there is as much as the `least`; bins of any decay
        in records too short for one.
        """
        if (self._last - 1) // 2 < _LEAST:
            bins = np.arange(1, self._last + 1)
            p = np.asarray(np.nan + 2j * np.pi / (self.length * self.hold.h) * bins, complex)
            return p, np.asarray(2.0 / self.length * np.sum(np.abs(residuals[:, bins]) ** 2, axis=0))
        count, square = self._last, 0.5 * self.length * least
        windows = _windows(residuals, 1, count, square, TUNING.widths_of_peaks)
        p, gain = _joined([self._local(residuals, half, centres) for half, centres in windows])
        if np.any(gain > least):
            return p, gain
        # noise pulls the poles of wide peaks away, whose flanks stand out as well
        windows = _windows(residuals, 1, count, square, _WIDE)
        middles = (self._middle(half, centres) for half, centres in windows)
        wide, gains = _joined([(middle, self.gains(residuals, middle)) for middle in middles])
        best = np.argsort(-gains)[:1]
        return _joined([(p, gain), (wide[best], gains[best])])

    def _middle(self, half: int, centres: Indices) -> ComplexArray:
        """Poles of peaks as wide as a window about each bin may have."""
        turn = 2 * np.pi / (self.length * self.hold.h)
        p = turn * (1j * centres - half / _WIDTHS)
        return np.asarray(p[p.imag < self.ceiling])

    def peak(self, residuals: ComplexArray, place: float) -> tuple[float, float]:
        """Half-width of one mode within the narrowest window about a place (in bins), and its share of the power."""
        half = min(TUNING.widths_of_peaks[0], (self._last - 1) // 2)
        if half < _LEAST:
            return 0.0, 0.0
        centre = int(np.clip(np.rint(place), half + 1, self._last - half))
        p, gain = self._local(residuals, half, np.array([centre]))
        power = 2.0 / self.length * float(np.sum(np.abs(residuals[:, centre - half : centre + half + 1]) ** 2))
        return (float(-p[0].real), float(gain[0]) / power) if len(p) and power else (0.0, 0.0)

    @property
    def _last(self) -> int:
        """Last bin below the Nyquist frequency."""
        return (self.length - 1) // 2

    def gains(self, residuals: ComplexArray, p: ComplexArray) -> Array:
        """How much each of some modes (k,) explains by itself of what is left, in a window as wide as it is."""
        bins = self.hold.h * self.length / (2 * np.pi)
        place, width = p.imag * bins, np.abs(np.nan_to_num(p.real)) * bins
        gains = np.zeros(len(p))
        most = (self._last - 1) // 2
        if most < _LEAST:
            nearest = np.clip(np.rint(place).astype(int), 1, self._last)
            return np.asarray(2.0 / self.length * np.sum(np.abs(residuals[:, nearest]) ** 2, axis=0))
        halves = np.array([min(half, most) for half in (*TUNING.widths_of_peaks, _WIDE[-1])])
        halves = halves[np.minimum(np.searchsorted(halves, _WIDTHS * width), len(halves) - 1)]
        for half in np.unique(halves).tolist():
            these = np.flatnonzero(halves == half)
            centres = np.clip(np.rint(place[these]).astype(int), half + 1, self._last - half)
            E, inputs, s = self._windows(residuals, half, centres)
            turned = np.exp(-1j * np.pi * 2 / self.length * centres + (1j * p.imag - width / bins)[these] * self.hold.h)
            weight = 1.0 / (s - (turned - 1.0)[:, None] * (self.length / (2 * np.pi)))
            products, solved = _least_squares(inputs * weight[:, None], E)
            gains[these] = np.sum(products.conj() * solved, axis=(1, 2)).real * (2.0 / self.length)
        return gains

    def _windows(
        self, residuals: ComplexArray, half: int, centres: Indices
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:  # fmt: skip
        """Outputs, inputs and ends (windows, .., K) of windows about bins, and frequencies (1, K) from these."""
        turn = np.expm1(2j * np.pi / self.length * np.arange(-half, half + 1))
        place = centres[:, None] + np.arange(-half, half + 1)
        E, U = (np.ascontiguousarray(np.moveaxis(rows[:, place], 0, 1)) for rows in (residuals, self.U))
        # a smooth input is told from the ends by what it is beside a constant
        size = np.linalg.norm(U, axis=2, keepdims=True)
        ends = np.broadcast_to(1.0 + turn, (len(place), 1, turn.size))
        inputs = np.concatenate([ends, U / np.where(size > 0, size, 1.0)], axis=1)
        return E, inputs, turn[None] * (self.length / (2 * np.pi))

    def _local(self, residuals: ComplexArray, half: int, centres: Indices) -> tuple[ComplexArray, Array]:
        """One mode in each window, frequencies in bins from its centre."""
        T = self.length
        pole, gain = local_modes(*self._windows(residuals, half, centres), np.full(len(centres), float(half)))
        p = self.hold.pole(np.exp(2j * np.pi / T * centres) * (1.0 + pole * (2 * np.pi / T)))
        kept = (np.abs(pole.imag) < half) & (p.imag > 0) & (p.imag < self.ceiling)
        return p[kept], gain[kept] * (2.0 / T)


def local_modes(E: ComplexArray, inputs: ComplexArray, s: ComplexArray, half: Array) -> tuple[ComplexArray, Array]:
    """Pole of one mode in each window, `(s - pole) E = sum beta inputs`, and how much it explains.

    Of outputs (windows, q, K), inputs (windows, k, K), and frequencies `s` (windows or 1, K) from the centre, up to
    `half` (windows,).  The pole is that of all outputs: what inputs explain of `E` and of `s E` is taken out of both.
    """
    count = E.shape[1]
    each = s[:, None]
    weight = np.ones((len(E), 1, s.shape[1]), complex)
    for _ in range(_ROUNDS):
        shown = E * weight
        power = np.sum(np.abs(shown) ** 2, axis=1)
        energy, cross = power.sum(axis=1), np.sum(power * s, axis=1)
        products, solved = _least_squares(inputs * weight, np.concatenate([shown, each * shown], axis=1))
        taken = products[:, :, :count].conj()
        energy = energy - np.sum(taken * solved[:, :, :count], axis=(1, 2)).real
        cross = cross - np.sum(taken * solved[:, :, count:], axis=(1, 2))
        pole = cross / np.where(energy > 0, energy, 1.0)
        width = np.clip(np.abs(pole.real), TUNING.narrowest, 2.0 * half)
        pole = -width + 1j * np.clip(pole.imag, -half, half)
        weight = 1.0 / (each - pole[:, None, None])
    products, solved = _least_squares(inputs * weight, E)
    return pole, np.sum(products.conj() * solved, axis=(1, 2)).real


def _windows(
    residuals: ComplexArray, first: int, count: int, least: float, widths: Sequence[int]
) -> Iterator[tuple[int, Indices]]:
    """Half-widths and centres of windows of several widths among so many columns of what is left, some at a time.

    No mode explains more of a window than there is in it: those with a square of less than the `least` are left out.
    """
    total = np.concatenate([[0.0], np.cumsum(np.sum(np.abs(residuals) ** 2, axis=0))])
    for half in widths:
        if 4 * half > count and half > TUNING.widths_of_peaks[0]:
            return
        half = min(half, (count - 1) // 2)
        if half < _LEAST:
            return
        centres = first + np.arange(half, count - half, max(1, half // 6))
        if count > _EVERYWHERE:
            centres = _peaking(total, half, centres)
        # sums of squares are rounded
        centres = centres[total[centres + half + 1] - total[centres - half] >= least - len(total) * EPS * total[-1]]
        size = max(1, TUNING.piece // (len(residuals) * (2 * half + 1)))
        for k in range(0, len(centres), size):
            yield half, centres[k : k + size]


def highest_peaks(values: Array, most: int) -> Indices:
    """Places of at most so many local maxima, the highest first."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    return peaks[np.argsort(-values[peaks], kind="stable")[:most]]


def _joined(candidates: Sequence[tuple[ComplexArray, Array]]) -> tuple[ComplexArray, Array]:
    """Poles and gains of several windows."""
    p, gain = (np.concatenate(parts) for parts in zip((np.zeros(0, complex), np.zeros(0)), *candidates, strict=True))
    return p, gain


def _peaking(total: Array, half: int, centres: Indices) -> Indices:
    """Centres about which most is left, by the sums of squares `total` up to each column."""
    width = max(1, half // 3)
    power = total[centres + width] - total[centres - width]
    about = highest_peaks(power, _PEAKS)[:, None] + np.arange(-1, 2)
    return centres[np.unique(np.clip(about, 0, len(centres) - 1))]


def _least_squares(columns: ComplexArray, targets: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Products of columns (windows, k, rows) with targets (windows, q, rows), and coefficients, (windows, k, q)."""
    conjugate = columns.conj()
    gram = conjugate @ columns.transpose(0, 2, 1)
    ridge = TUNING.ridge * np.trace(gram, axis1=1, axis2=2).real
    gram += np.where(ridge > 0, ridge, 1.0)[:, None, None] * np.eye(columns.shape[1])
    products = conjugate @ targets.transpose(0, 2, 1)
    return products, np.linalg.solve(gram, products)


@dataclass(frozen=True)
class Responses(FreeSearch):
    """Frequency responses, whose modes may be so `crowded` that poles are those of a common denominator."""

    data: Sequence[FreeResponse]
    crowded: bool = False

    def shows_background(self, n: int) -> bool:
        """Whether points abound: of few of them a real pole may stand for modes outside the band."""
        return all(len(rows.omega) >= _ABOUNDING + 4 * n for rows in self.data)

    @property
    def terms(self) -> list[Term]:
        """Terms of the background of any entry."""
        return sorted({term for rows in self.data for term in rows.terms})

    def without_term(self, term: Term) -> Responses:
        """The same beside a background that lacks a term."""
        return replace(
            self, data=[replace(rows, terms=tuple(t for t in rows.terms if t != term)) for rows in self.data]
        )

    def with_term(self, term: Term) -> Responses:
        """The same beside a background with one more term."""
        return replace(self, data=[rows.with_term(term) for rows in self.data])

    def spread(self, rows: Sequence[FreeRows]) -> Sequence[FreeRows]:
        """A part of the points where there are many."""
        return [
            response.spread(_EVERYWHERE // 2) if len(response.omega) > _EVERYWHERE else part
            for response, part in zip(self.data, rows, strict=True)
        ]

    def rows(self, p: ComplexArray) -> Sequence[FreeRows]:
        """The points about the modes where there are many."""
        return [rows.thinned(p) if len(rows.omega) > _EVERYWHERE else rows for rows in self.data]

    def model(self, projection: FreeProjection) -> FreeModel:
        """A model with its residuals; residues and backgrounds are those of all points."""
        whole = sum(rows.samples * len(rows.outputs) for rows in self.data) == projection.rows
        return super().model(projection if whole else FreeProjection(self.data, projection.p, projection.fed))

    def scaled(self, sizes: Array) -> Responses:
        """The same with each entry multiplied by its element of `sizes` (q,)."""
        return replace(
            self, data=[replace(rows, response=rows.response * sizes[rows.outputs, None]) for rows in self.data]
        )

    def residuals(self, projection: FreeProjection) -> Residuals:
        """Weighted residuals of a model."""
        pairs = zip(self.data, projection.own, strict=True)
        residuals = []
        for rows, own in pairs:
            shared = projection.shared[: 2 * len(projection.p) + rows.through, rows.outputs]
            residuals.append(rows.target - np.concatenate([own, shared]).T @ rows.columns(projection.p))
        return residuals

    def losses(self, residuals: Residuals) -> Array:
        """Weighted sum of squares of each entry."""
        sums = np.zeros(1 + max(int(rows.outputs.max()) for rows in self.data))
        for part, rows in zip(residuals, self.data, strict=True):
            sums[rows.outputs] += np.sum(np.abs(part) ** 2, axis=1)
        return sums

    def candidates(self, model: FreeModel, least: float = 0.0) -> tuple[ComplexArray, Array]:
        """Of windows of several widths, or of many places among few points, the poles that explain most."""
        if self.classical or all(len(rows.frequencies) <= 2 * _LEAST for rows in self.data):
            return self._scanned(model.p)
        joined: list[tuple[Array, list[ComplexArray], list[Array]]] = []
        for rows, part in zip(self.data, model.residuals, strict=True):
            everywhere = np.zeros((len(part), len(rows.frequencies)), complex)
            everywhere[:, rows.observed] = rows.out_of_rows(part)
            weights = np.zeros((len(part), len(rows.frequencies)))
            weights[:, rows.observed] = rows.weight
            if joined and joined[-1][0] is rows.frequencies:
                joined[-1][1].append(everywhere)
                joined[-1][2].append(weights)
            else:
                joined.append((rows.frequencies, [everywhere], [weights]))
        candidates = [_modes_of_lines(omega, np.concatenate(parts), np.concatenate(weights).mean(axis=0), least)
                      for omega, parts, weights in joined]  # fmt: skip
        return strongest(candidates, self.region.bin)

    @property
    def classical(self) -> bool:
        """Whether modes have one number for each entry, as with real shapes."""
        return self.data[0].classical

    @property
    def crowding(self) -> float:
        """Distance of the peaks of two modes, beyond their half-widths, within which one only corrects the other."""
        return self.region.bin if self.classical else super().crowding

    def unknowns(self, modes: int, real_poles: int = 0) -> int:
        """Parameters of a model; of modes with real shapes one number for each entry."""
        entries = sum(len(rows.outputs) for rows in self.data)
        return super().unknowns(modes, real_poles) - self.classical * modes * entries

    @property
    def region(self) -> PoleRegion:
        """Where poles are looked for; those of a common denominator decay, and may be of modes above the band."""
        region = super().region
        return replace(region, ceiling=_ABOVE * region.ceiling, growth=0.0) if self.crowded else region

    @property
    def share_poles(self) -> bool:
        """Whether several entries, of any residues, have poles in common, and are few enough to solve for all at once.

        Poles of a single entry may mend the shape of anything.
        """
        counts = [rows.samples for rows in self.data for _ in rows.outputs]
        return not self.classical and len(counts) > 1 and sum(counts) <= _ALL_AT_ONCE

    def of_common_denominator(self, count: int) -> ComplexArray:
        """Poles of so many modes, some of which may be real ones, that explain all entries best together.

        Vector fitting of Gustavsen and Semlyen: poles all over the band move to the zeros of a common denominator.
        Entries are eliminated one by one as Deschrijver and others do.
        """
        region = self.region
        omega = np.sort(np.concatenate([rows.omega for rows in self.data]))
        places = np.maximum(np.quantile(omega, np.linspace(0.0, 1.0, count)), region.bin)  # as close as the points are
        p = np.asarray(places * (1j - _CROWDED), complex)
        for _ in range(_RELOCATIONS):
            kept = np.append(np.ones(len(p), bool), p.imag > 0)  # a real pole has no imaginary part of a residue
            factors = []
            for rows in self.data:
                columns = rows.columns(p)
                modes = rows.out_of_rows(columns[len(rows.terms) :][: 2 * len(p)][kept])
                basis, _ = orthogonal(real_rows([columns]).T)
                for target in rows.target:
                    rest = without(real_rows([rows.times(target, modes), target[None]]).T, basis)
                    factors.append(reduced(np.asfortranarray(rest)))
            joined = np.concatenate(factors)
            basis, solve = orthogonal(joined[:, :-1])
            # zeros of 1 - sum w_l / (s - p_l): in the states of each mode the input acts on the first
            A = np.block([[np.diag(p.real), np.diag(p.imag)], [np.diag(-p.imag), np.diag(p.real)]])[np.ix_(kept, kept)]
            A[: len(p)] += 2.0 * (solve @ (basis.T @ joined[:, -1]))
            zeros = np.linalg.eigvals(A).astype(complex)
            p = zeros[zeros.imag >= 0]
            p = np.asarray(-np.maximum(np.abs(p.real), EPS * np.abs(p)) + 1j * p.imag)
        inside = (p.imag < region.ceiling) & (-p.real < region.ceiling)
        return np.asarray(p[inside & ((p.imag > 0.5 * region.bin) | ((p.imag == 0) & region.kinds_may_change))])

    def _scanned(self, p: ComplexArray) -> tuple[ComplexArray, Array]:
        """Poles between all points that explain most of what modes leave; of sensors of any kind, as a velocity."""
        omega = np.unique(np.concatenate([rows.omega for rows in self.data]))
        places = np.arange(_PLACES * (len(omega) - 1) + 1) / _PLACES
        rates = self.region.bin * np.array(_DECAYS)
        tried = (np.interp(places, np.arange(len(omega)), omega)[:, None] * 1j - rates).ravel()
        tried = tried[tried.imag > 0]
        gains = np.zeros(len(tried))
        for rows in self.data:
            known = next(rows.evaluated(p).blocks())
            q, n = len(rows.outputs), len(p)
            basis, _ = orthogonal(known[: rows.own_unknowns(n) + 2 * n + rows.through].T)
            real = rows if rows.quantity != "free" else replace(rows, quantity="velocity")
            columns = real_rows([rows.in_rows(real.classical_columns(tried))])
            free = without(columns.T, basis)
            gains += np.sum((free.T @ without(known[-q:].T, basis)) ** 2, axis=1) / np.sum(free**2, axis=0)
        return strongest([(tried, gains)], self.region.bin)


def _modes_of_lines(omega: Array, residuals: ComplexArray, weight: Array, least: float) -> tuple[ComplexArray, Array]:
    """Poles of modes that explain something of what is left of responses (q, K), and how much.

    Each beside a straight line, within a window of so many points, which need not be equidistant.
    """
    windows = _windows(residuals * weight, 0, len(omega), least, TUNING.widths_of_peaks)
    return _joined([_local_lines(omega, residuals, weight, half, centres) for half, centres in windows])


def _local_lines(
    omega: Array, residuals: ComplexArray, weight: Array, half: int, centres: Indices
) -> tuple[ComplexArray, Array]:
    place = centres[:, None] + np.arange(-half, half + 1)
    apart = omega[place] - omega[centres, None]
    span = np.maximum(apart[:, -1] - apart[:, 0], np.finfo(float).tiny)
    unit = span / (2 * half)
    s = 1j * apart / unit[:, None]
    share = weight[place][:, None]
    E = np.ascontiguousarray(np.moveaxis(residuals[:, place], 0, 1)) * share
    inputs = np.stack([np.ones(place.shape, complex), s / half], axis=1) * share
    # the pole may lie anywhere between the ends, which unequal distances put elsewhere than half the span away
    pole, gain = local_modes(E, inputs, s, np.minimum(-apart[:, 0], apart[:, -1]) / unit)
    p = pole * unit + 1j * omega[centres]
    kept = (p.imag > omega[place[:, 0]]) & (p.imag < omega[place[:, -1]]) & (p.imag > 0)
    return p[kept], gain[kept]

"""Records in the frequency domain: where modes are searched for, and fitted first.

The transform of a finite record obeys, exactly and for every mode,

    X_m = ((b_0 + b_1 z_m) U_m + z_m tau) / (z_m - lambda),      z_m = exp(2 pi i m / T),   tau = x_0 - x_T,

so that near its frequency a mode is a few unknowns (residue, complex `tau`) in a linear problem over a few bins,
whatever the length of the record.  Modes have poles of positive imaginary part here, with or without losses.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, RealOrComplex
from ...modal.discretization import Hold
from ...modal.modal_form import imaginary
from .modal_regressors import SampledModes
from .time_rows import Evaluation, FreeRecord
from .tuning import TUNING

Pair = tuple[ComplexArray, ComplexArray]

_NEAR = 1e-3  # turns of a mode away from a bin, below which a series is more accurate
_LOUD = 30.0  # times the mean power of all bins


@dataclass(frozen=True)
class ChannelSpectra:
    """Transforms of the inputs (m, K) and outputs (q, K) of a record of T samples; missing outputs count as 0.

    Those of the inputs one sample after are there where these are seen as well.
    """

    record: FreeRecord
    U: ComplexArray
    Y: ComplexArray
    ahead: ComplexArray | None = None

    @classmethod
    def of(cls, record: FreeRecord) -> ChannelSpectra:
        """Transform a record."""
        ahead = None if record.ahead is None else np.fft.rfft(record.ahead)[: record.inputs]
        return cls(record, np.fft.rfft(record.u)[: record.inputs], np.fft.rfft(record.measured), ahead)

    def scaled(self, record: FreeRecord, sizes: Array) -> ChannelSpectra:
        """Those of the record with outputs (q,) so many times as large."""
        return ChannelSpectra(record, self.U, self.Y * sizes[:, None], self.ahead)

    @property
    def hold(self) -> Hold:
        """How modes meet the samples."""
        return self.record.hold

    @property
    def length(self) -> int:
        """Number of samples T."""
        return self.record.length

    @property
    def last(self) -> int:
        """Last bin below the Nyquist frequency."""
        return (self.length - 1) // 2

    @cached_property
    def loud(self) -> Indices:
        """Bins that hold much of the power of an input, as those of tones."""
        power = np.abs(self.U[:, : self.last + 1]) ** 2
        power[:, 0] = 0.0
        return np.flatnonzero(np.any(power > _LOUD * power.mean(axis=1, keepdims=True), axis=0))

    def place(self, d: Array) -> Array:
        """Frequencies in bins, as the samples show them."""
        return _place(self.hold.log_multiplier(imaginary(d))[1], self.length)

    def energies(self, transform: ComplexArray) -> Array:
        """Sums of squares in time of real signals with these transforms (.., K) (Parseval)."""
        inside = np.sum(np.abs(transform[..., 1 : self.last + 1]) ** 2, axis=-1)
        last = np.abs(transform[..., -1]) ** 2 if self.length % 2 == 0 else 0.0
        return np.asarray((2 * inside + np.abs(transform[..., 0]) ** 2 + last) / self.length)

    @cached_property
    def direct(self) -> ComplexArray:
        """Transforms of the inputs as the outputs meet them."""
        late = self.record.late
        return self.U if self.ahead is None else np.asarray(late * self.U + (1.0 - late) * self.ahead)

    def unexplained(
        self, p: ComplexArray, residues: RealOrComplex, motion: ComplexArray, through: Array
    ) -> ComplexArray:
        """Transforms of the outputs (q, K) without what modes explain of them; O(T n q) time.

        Modes with `residues` (n, q, m), motions (n, q), and what is fed `through` (q, m).
        """
        modes, residuals, at_once = self.record.modes(p), self.Y.copy(), through * (self.ahead is None)
        size = max(1, TUNING.piece // max(1, motion.size))
        for first in range(0, residuals.shape[1], size):
            bins = np.arange(first, min(first + size, residuals.shape[1]))
            residuals[:, bins] -= TransformColumns(self.length, modes, bins).output(self.U, residues, motion, at_once)
        if self.ahead is None or modes.ahead is None:
            return residuals
        seen = 2 * np.einsum("lqi,l->qi", residues, modes.ahead).real
        return np.asarray(residuals - seen @ self.ahead - through @ self.direct)


def _place(phase: tuple[Array, Array], length: int) -> Array:
    return np.abs(phase[0] + phase[1]) * length / (2 * np.pi)


class TransformColumns:
    """Columns of modes (n,) at bins (K,), or (n, K) of their own, that pass smoothly through the bins.

    The ends of the record enter by a motion `x`: `tau = (1 - lambda^T) x - sigma rho`.  The first factor has its zero,
    and `sigma` takes from the column of the residue `rho` its pole, at the bin nearest to the mode.  Each complex
    coefficient has two parts, of its own and of its conjugate, each of shape (n, K).
    """

    def __init__(self, length: int, modes: SampledModes, bins: Indices) -> None:
        self._length, self._modes, self._bins = length, modes, bins
        place = _place(modes.phase, length)
        self._centre = np.rint(place).astype(int)
        self._at_centre = bins == self._centre[:, None]
        self._z, self._z_0 = (np.exp(2j * np.pi / length * each) for each in (bins, self._centre[:, None]))
        lam = modes.multiplier[:, None]
        self._near, behind = 1.0 / np.where(self._at_centre, 1.0, self._z - lam), self._z - lam.conj()
        self._far = 1.0 / np.where(behind == 0, EPS, behind)  # an integrator is its own conjugate
        self._near[self._at_centre] = 0.0
        # log of lambda over the z of the centre; lambda^T; and the sum that a pole with a zero upon it is
        apart = modes.growth + 2j * np.pi / length * (place - self._centre)
        self._back = np.exp(length * apart)[:, None]
        self._total, self._total_slope = (part[:, None] for part in _geometric(apart, length))

    @cached_property
    def motion(self) -> Pair:
        """What belongs to the motion, and to its conjugate."""
        ahead = np.where(self._at_centre, self._total, (1 - self._back) * self._z * self._near)
        return ahead, (1 - self._back).conj() * self._z * self._far

    def numerators(self, U: ComplexArray) -> Pair:
        """What stands over the poles in the columns of the residues of an input with this transform."""
        return self._numerators(U, self._modes.b0, self._modes.b1)

    def forced(self, numerators: Pair) -> Pair:
        """What belongs to the residues of an input, and to their conjugates."""
        return numerators[0] * self._near, numerators[1] * self._far

    def _numerators(self, U: ComplexArray, b0: ComplexArray, b1: ComplexArray) -> Pair:
        """What stands over the pole, 0 at the centre, and over its mirror."""
        sigma, U_bins = self._sigma(U, b0, b1), U[self._bins]
        b0, b1 = b0[:, None], b1[:, None]
        ahead = U_bins * (b0 + b1 * self._z) - sigma * self._z
        return ahead, U_bins * (b0.conj() + b1.conj() * self._z) - sigma.conj() * self._z

    def _sigma(self, U: ComplexArray, b0: ComplexArray, b1: ComplexArray) -> ComplexArray:
        """`sigma` of each mode, shape (n, 1)."""
        U_0 = U[np.minimum(self._centre, self._length // 2)][:, None]
        return (b0[:, None] + b1[:, None] * self._z_0) * U_0 / self._z_0

    @cached_property
    def _pole_slopes(self) -> Pair:
        moving = self._modes.turn[:, None] * self._modes.multiplier[:, None]
        return moving * self._near**2, moving.conj() * self._far**2

    @cached_property
    def motion_slopes(self) -> Pair:
        """Derivatives of `motion` by the poles and their conjugates, or by what these move along."""
        near_slope, far_slope = self._pole_slopes
        turn = self._modes.turn[:, None]
        zero, zero_slope = 1 - self._back, -self._length * turn * self._back
        ahead = self._z * (zero_slope * self._near + zero * near_slope)
        behind = self._z * (zero_slope.conj() * self._far + zero.conj() * far_slope)
        return np.where(self._at_centre, self._total_slope * turn, ahead), behind

    def forced_slopes(self, U: ComplexArray, numerators: Pair) -> Pair:
        """Derivatives of `forced`."""
        (near_slope, far_slope), (ahead, behind) = self._pole_slopes, numerators
        ahead_slope, behind_slope = self._numerators(U, self._modes.b0_slope, self._modes.b1_slope)
        return ahead_slope * self._near + ahead * near_slope, behind_slope * self._far + behind * far_slope

    def output(self, U: ComplexArray, residues: RealOrComplex, motion: ComplexArray, through: Array) -> ComplexArray:
        """Transforms (q, K) of outputs of a model with inputs (m, all bins), without the columns.

        What stands over the poles is a polynomial in `z` and the inputs, whose coefficients meet the poles in products.
        """
        b0, b1 = self._modes.b0, self._modes.b1
        turned = (motion * (1 - self._back)).T
        for k, transform in enumerate(U):
            turned = turned - residues[:, :, k].T * self._sigma(transform, b0, b1)[:, 0]
        Y = self._z * self._over_poles(turned)
        for k, transform in enumerate(U):
            still = self._over_poles(residues[:, :, k].T * b0) + through[:, k, None]
            if b1.any():
                still += self._z * self._over_poles(residues[:, :, k].T * b1)
            Y += transform[self._bins] * still
        place = np.searchsorted(self._bins, self._centre)
        (mode,) = np.nonzero(np.append(self._bins, -1)[place] == self._centre)
        np.add.at(Y.T, place[mode], motion[mode] * self._total[mode])
        return np.asarray(Y)

    def _over_poles(self, over: ComplexArray) -> ComplexArray:
        return np.asarray(over @ self._near + over.conj() @ self._far)


def _geometric(x: ComplexArray, count: int) -> tuple[ComplexArray, ComplexArray]:
    """`sum e^(k x), k < count`, and its derivative by `x`."""
    near = np.abs(count * x) < _NEAR
    safe = np.where(near, 1.0 / count, x)
    top, bottom = _exp_minus_1(count * safe), _exp_minus_1(safe)
    sums = [count, count * (count - 1) / 2, count * (count - 1) * (2 * count - 1) / 6, (count * (count - 1) / 2) ** 2]
    total = sums[0] + x * (sums[1] + x / 2 * (sums[2] + x / 3 * sums[3]))
    slope = sums[1] + x * (sums[2] + x / 2 * sums[3])
    far = (count * (top + 1) - top / bottom * (bottom + 1)) / bottom
    return np.where(near, total, top / bottom), np.where(near, slope, far)


def _exp_minus_1(z: ComplexArray) -> ComplexArray:
    """`e^z - 1` without cancellation near 0, also far to the left."""
    # not expm1, whose complex version loses digits in some releases of numpy
    half = np.where(np.abs(z.real) > 1, 1.0, 0.5 * z)
    return np.where(np.abs(z.real) > 1, np.exp(z) - 1, 2 * np.exp(half) * np.sinh(half))


def stacked(pair: Pair) -> ComplexArray:
    """Columns of the real and the imaginary part of a coefficient, from what belongs to it and to its conjugate."""
    ahead, behind = pair
    return np.concatenate([ahead + behind, 1j * (ahead - behind)])


def real_rows(columns: Sequence[ComplexArray], scale: Array | float = 1.0) -> Array:
    """Real and imaginary parts of complex columns (k, m) beside one another."""
    joined = np.concatenate(columns) * scale
    return np.concatenate([joined.real, joined.imag], axis=1)


def thinned_places(ranges: Iterable[tuple[int, int, int]], count: int, apart: int) -> tuple[Indices, Array]:
    """Places within ranges, of each only those so many steps apart, and a few elsewhere; and what errors there count.

    A place that stands for several counts as the root of their number; later ranges overwrite earlier ones.
    """
    place, steps = np.arange(count), np.zeros(count, int)
    for first, last, step in ranges:
        steps[first:last] = max(1, step)
    kept = ((steps > 0) | (place % apart == apart // 2)) & (place % np.maximum(steps, 1) == 0)
    return place[kept], np.sqrt(np.maximum(steps[kept], 1))


@dataclass(frozen=True, eq=False)
class FreeWindow:
    """The bins of spectra for modes with any damping and residues; one that stands for several `counts` as the root."""

    spectrum: ChannelSpectra
    bins: Indices
    counts: Array | float = 1.0
    moving: ClassVar[bool] = True

    @classmethod
    def thinned(cls, spectrum: ChannelSpectra, p: ComplexArray) -> FreeWindow:
        """The bins about some modes as far as their peaks reach; of wide ones a part, each counting as many.

        A few bins everywhere tell what is fed through from the tails of peaks, and residues have to explain what inputs
        do that have most of their power elsewhere.
        """
        ranges, widths = [], np.abs(p.real) / spectrum.record.bin
        for k in np.argsort(-widths):
            reach = int(min(TUNING.half_width * (1 + widths[k]), spectrum.last))
            centre = int(np.rint(spectrum.place(p.imag[k : k + 1])[0]))
            ranges.append((max(0, centre - reach), centre + reach + 1, 2 * reach // TUNING.thinned))
        bins, counts = thinned_places(ranges, spectrum.last + 1, 1 + spectrum.last // TUNING.everywhere)
        loud = np.setdiff1d(spectrum.loud, bins)
        bins, counts = np.append(bins, loud), np.append(counts, np.ones(len(loud)))
        return cls(spectrum, bins[bins >= 1], counts[bins >= 1])

    @classmethod
    def spread(cls, spectrum: ChannelSpectra) -> FreeWindow:
        """All bins, or as many spread over the band, each counting as those that it stands for."""
        step = 1 + spectrum.last // TUNING.all_over
        bins = np.arange(1, spectrum.last + 1, step)
        return cls(spectrum, bins, np.full(len(bins), np.sqrt(step)))

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return self.spectrum.record.inputs

    @property
    def acting(self) -> Indices:
        """Which of all inputs these are."""
        return self.spectrum.record.acting

    @property
    def outputs(self) -> Indices:
        """Which of all outputs these rows show."""
        return self.spectrum.record.outputs

    @property
    def delay_time(self) -> float:
        """Delay of the outputs."""
        return self.spectrum.record.delay_time

    @property
    def through(self) -> bool:
        """Whether there are columns for what is fed through."""
        return self.spectrum.record.through

    @property
    def samples(self) -> int:
        """Real and imaginary part of each bin."""
        return 2 * len(self.bins)

    def own_unknowns(self, n: int) -> int:
        """The motion at the ends of every mode."""
        return 2 * n

    def evaluated(self, p: ComplexArray) -> FreeWindowEvaluation:
        """The rows for modes with these poles."""
        return FreeWindowEvaluation(self, p)

    def lags(self, rates: Array) -> Array:
        """What the motion and the inputs of each of some decaying real poles span, shape (rates, 1 + m, rows)."""
        spectrum, modes = self.spectrum, self.spectrum.record.modes((-rates).astype(complex))
        z = np.exp(2j * np.pi / spectrum.length * self.bins)
        over = 1.0 / (z - modes.multiplier.real[:, None])
        forced = (modes.b0.real[:, None] + modes.b1.real[:, None] * z) * over
        columns = [z * over, *(forced * transform[self.bins] for transform in spectrum.U)]
        if spectrum.ahead is not None and modes.ahead is not None:
            for column, transform in zip(columns[1:], spectrum.ahead, strict=True):
                column += np.outer(modes.ahead.real, transform[self.bins])
        joined = np.stack(columns, axis=1) * self.counts
        return np.concatenate([joined.real, joined.imag], axis=2)


class FreeWindowEvaluation(Evaluation):
    """The rows of a window for modes with any damping and residues."""

    def __init__(self, window: FreeWindow, p: ComplexArray) -> None:
        self._window, spectrum = window, window.spectrum
        self._modes = spectrum.record.modes(p)
        self._columns = TransformColumns(spectrum.length, self._modes, window.bins)

    def blocks(self, slopes: bool = True) -> Iterator[Array]:
        """All rows in one block; without `slopes` they lack the derivatives."""
        window, columns = self._window, self._columns
        rows, derivatives = [stacked(columns.motion)], [stacked(columns.motion_slopes)] if slopes else []
        spectrum = window.spectrum
        for k, (U, direct) in enumerate(zip(spectrum.U, spectrum.direct, strict=True)):
            numerators = columns.numerators(U)
            forced, seen = columns.forced(numerators), self._modes.ahead
            if spectrum.ahead is not None and seen is not None:
                after = spectrum.ahead[k, window.bins]
                forced = forced[0] + np.outer(seen, after), forced[1] + np.outer(seen.conj(), after)
            rows += [stacked(forced), *([direct[None, window.bins]] * window.through)]
            if slopes:
                derivatives.append(stacked(self._forced_slopes(k, U, numerators)))
        targets = window.spectrum.Y[:, window.bins]
        # squares add up to squares in time
        yield real_rows([*rows, *derivatives, targets], np.sqrt(2.0 / window.spectrum.length) * window.counts)

    def _forced_slopes(self, k: int, U: ComplexArray, numerators: Pair) -> Pair:
        """Derivatives of what belongs to the residues of an input."""
        spectrum, slope = self._window.spectrum, self._columns.forced_slopes(U, numerators)
        seen_slope = self._modes.ahead_slope
        if spectrum.ahead is None or seen_slope is None:
            return slope
        after = spectrum.ahead[k, self._window.bins]
        return slope[0] + np.outer(seen_slope, after), slope[1] + np.outer(seen_slope.conj(), after)

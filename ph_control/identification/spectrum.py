"""Records in the frequency domain: where modes are searched for, and fitted first.

The transform of a finite record obeys, exactly and for every mode,

    X_m = (kappa (b_0 + b_1 z_m) U_m + z_m tau) / (z_m - lambda),      z_m = exp(2 pi i m / T),   tau = x_0 - x_T,

so that near its frequency a mode is three unknowns (`kappa`, complex `tau`) in a linear problem over a few bins,
whatever the length of the record.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .experiment import Experiment
from .regressors import output_weight

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Bins = NDArray[np.intp]
Pair = tuple[ComplexArray, ComplexArray]  # a function and its derivative by the frequency

_OFF_BIN = 1e-3  # bins: on a bin the columns of a mode become parallel, though their span does not
_NEAR = 1e-3  # turns of a mode away from a bin, below which a series is more accurate
_PIECE = 1 << 20  # numbers worked on at a time


@dataclass(frozen=True)
class Smooth:
    """Columns (n, K) of modes, `plus` and `minus` belonging to a motion and its conjugate, and their derivatives."""

    forced: ComplexArray
    plus: ComplexArray
    minus: ComplexArray
    forced_slope: ComplexArray
    plus_slope: ComplexArray
    minus_slope: ComplexArray

    def output(self, kappa: Array, motion: ComplexArray) -> ComplexArray:
        """Transform of a model."""
        return np.asarray(kappa @ self.forced + motion @ self.plus + motion.conj() @ self.minus)

    def sensitivity(self, kappa: Array, motion: ComplexArray) -> ComplexArray:
        """Its derivative by each frequency."""
        motion = motion[:, None]
        moved = motion * self.plus_slope + motion.conj() * self.minus_slope
        return np.asarray(kappa[:, None] * self.forced_slope + moved)


@dataclass(frozen=True)
class Spectrum:
    """Transforms of a record of T samples; missing outputs count as what `filled` puts in their place."""

    experiment: Experiment
    U: ComplexArray
    Y: ComplexArray

    @classmethod
    def of(cls, experiment: Experiment, filled: Array | None = None) -> Spectrum:
        """Transform a record."""
        y = np.where(experiment.observed, experiment.y, 0.0 if filled is None else filled)
        return cls(experiment, np.fft.rfft(experiment.u), np.fft.rfft(y))

    @property
    def length(self) -> int:
        """Number of samples T."""
        return len(self.experiment.u)

    @property
    def last(self) -> int:
        """Last bin below the Nyquist frequency."""
        return (self.length - 1) // 2

    def place(self, d: Array) -> Array:
        """Frequencies in bins, as the samples show them."""
        high, low = self.experiment.hold.step(d).phase
        return np.abs(high + low) * self.length / (2 * np.pi)

    def frequency(self, place: Array) -> Array:
        """Natural frequencies that the samples show at these places."""
        return self.experiment.hold.frequency_of(2 * np.pi * place / self.length)

    def energy(self, transform: ComplexArray) -> float:
        """Sum of squares in time of a real signal with this transform (Parseval)."""
        inside = np.sum(np.abs(transform[1 : self.last + 1]) ** 2)
        ends = np.abs(transform[0]) ** 2 + (np.abs(transform[-1]) ** 2 if self.length % 2 == 0 else 0.0)
        return float((2 * inside + ends) / self.length)

    def columns(self, d: Array, bins: Bins) -> tuple[ComplexArray, ComplexArray]:
        """Columns `(f, g)` of modes at bins that broadcast against `d[..., None]`; of one on a bin, those close by.

        `f` belongs to `kappa`; `g` and `conj` of it at the negative bin to `tau`, so that its columns are `g_+ + g_-`
        and `i (g_+ - g_-)`, kept as the pair `g_+`, `g_-` stacked in front.
        """
        one = self.experiment
        step = one.hold.step(d)
        lam = self._off_bin(d, step.multiplier)[..., None]
        b0, b1 = step.b0[..., 0, None], step.b1[..., 0, None]
        weight = output_weight(d, one.quantity)[0][..., None]
        z = np.exp(2j * np.pi / self.length * bins)
        U = self.U[bins] if one.driven else np.zeros(bins.shape)
        right, left = 0.5 / (z - lam), 0.5 / (z - lam.conj())
        gain, mirrored = weight * (b0 + b1 * z), weight.conj() * (b0.conj() + b1.conj() * z)
        forced = U * (gain * right + mirrored * left)
        if one.quantity == "acceleration":
            forced = forced + U
        return forced, np.stack([z * right, z * left])

    def smooth_columns(self, d: Array, bins: Bins) -> Smooth:
        """Columns of the same span that pass smoothly through the bins, at bins (1, K), and their derivatives.

        The ends are told by a motion, `tau = (1 - lambda^T) x + sigma kappa`: `sigma` takes from the column of `kappa`
        its pole at the bin nearest to the mode, and `1 - lambda^T` has its zero there.
        """
        one, T = self.experiment, self.length
        step, place = one.hold.step(d), self.place(d)
        centre = np.rint(place).astype(int)
        # log of conj(lambda) over the z of that bin, and of its derivative
        apart, turn = step.growth + 2j * np.pi / T * (place - centre), one.hold.log_derivative(d)
        z, z_0 = (np.exp(2j * np.pi / T * each) for each in (bins, centre[:, None]))
        right, left, right_slope, left_slope = _poles(
            z, step.multiplier[:, None], turn[:, None], bins == centre[:, None]
        )
        plus, minus, plus_slope, minus_slope = (z * part for part in (right, left, right_slope, left_slope))
        if one.driven:
            U, U_0 = self.U[bins], self.U[np.minimum(centre, T // 2)][:, None]
            (gain, gain_slope), (mirrored, mirrored_slope) = self._gains(d, z)
            sigma, sigma_slope = (part * U_0 / z_0 for part in self._gains(d, z_0)[1])
            ahead, behind = U * gain - sigma.conj() * z, U * mirrored - sigma * z
            forced = ahead * right + behind * left + (U if one.quantity == "acceleration" else 0.0)
            slope = (U * gain_slope - sigma_slope.conj() * z) * right + (U * mirrored_slope - sigma_slope * z) * left
            slope = slope + ahead * right_slope + behind * left_slope
        else:
            forced = slope = np.zeros(plus.shape, complex)
        # times 1 - lambda^T, which is 0 where there is a pole: there it is a geometric sum
        back = np.exp(T * apart).conj()[:, None]
        zero, zero_slope = 1 - back, -T * turn[:, None] * back
        plus, plus_slope = zero * plus, zero_slope * plus + zero * plus_slope
        minus, minus_slope = zero.conj() * minus, zero_slope.conj() * minus + zero.conj() * minus_slope
        total, by_apart = (0.5 * part[:, None] for part in _geometric(apart, T))
        minus = np.where(bins == centre[:, None], total, minus)
        minus_slope = np.where(bins == centre[:, None], by_apart * turn.conj()[:, None], minus_slope)
        return Smooth(forced, plus, minus, slope, plus_slope, minus_slope)

    def _gains(self, d: Array, z: ComplexArray) -> tuple[Pair, Pair]:
        """What the input is multiplied by ahead of a pole, and of its mirror, with the derivatives."""
        hold = self.experiment.hold
        step, (db0, db1) = hold.step(d), (part[:, None] for part in hold.weight_derivatives(d))
        weight, weight_slope = (part[:, None] for part in output_weight(d, self.experiment.quantity))

        def at(z: ComplexArray) -> Pair:
            through = step.b0 + step.b1 * z
            return weight * through, weight_slope * through + weight * (db0 + db1 * z)

        gain, mirrored = at(z), at(z.conj())
        return gain, (mirrored[0].conj(), mirrored[1].conj())

    def _off_bin(self, d: Array, lam: ComplexArray) -> ComplexArray:
        """The multipliers, those on a bin moved a little off it."""
        place = self.place(d)
        offset = place - np.rint(place)
        wanted = np.where(offset < 0, -_OFF_BIN, _OFF_BIN)
        turn = np.where(np.abs(offset) < _OFF_BIN, wanted - offset, 0.0) * 2 * np.pi / self.length
        return lam * np.exp(-1j * turn)

    def left(self, d: Array, kappa: Array, own: Array) -> ComplexArray:
        """Transform of what modes do not explain, at all bins; O(T n) time."""
        n = len(d)
        residual = self.Y.copy()
        ends = own[:n] + 1j * own[n : 2 * n]
        size = max(1, _PIECE // max(1, n))
        for first in range(0, len(residual), size):
            bins = np.arange(first, min(first + size, len(residual)))
            residual[bins] -= self.smooth_columns(d, bins[None, :]).output(kappa, ends)
        return residual


def _poles(
    z: ComplexArray, lam: ComplexArray, turn: ComplexArray, skipped: NDArray[np.bool_]
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Halves of `1 / (z - lambda)` and of its mirror, which is 0 where skipped, and their derivatives."""
    right, left = 0.5 / (z - lam), np.where(skipped, 0.0, 0.5 / np.where(skipped, 1.0, z - lam.conj()))
    slope = 2 * turn * lam
    return right, left, slope * right**2, slope.conj() * left**2


def _geometric(x: ComplexArray, count: int) -> tuple[ComplexArray, ComplexArray]:
    """`sum e^(k x), k < count`, and its derivative by `x`."""
    near = np.abs(count * x) < _NEAR
    safe = np.where(near, 1.0, x)
    top, bottom = (2 * np.exp(half) * np.sinh(half) for half in (0.5 * count * safe, 0.5 * safe))
    sums = [count, count * (count - 1) / 2, count * (count - 1) * (2 * count - 1) / 6, (count * (count - 1) / 2) ** 2]
    total = sums[0] + x * (sums[1] + x / 2 * (sums[2] + x / 3 * sums[3]))
    slope = sums[1] + x * (sums[2] + x / 2 * sums[3])
    far = (count * (top + 1) - top / bottom * (bottom + 1)) / bottom
    return np.where(near, total, top / bottom), np.where(near, slope, far)


@dataclass(frozen=True)
class Window:
    """The bins of a spectrum about some modes, as rows for the solver."""

    spectrum: Spectrum
    bins: Bins

    @classmethod
    def about(cls, spectrum: Spectrum, d: Array, half_width: int) -> Window:
        """Bins within `half_width` of any of the modes; the constant is never among them."""
        centres = np.rint(spectrum.place(d)).astype(int)
        bins = np.unique(centres[:, None] + np.arange(-half_width, half_width + 1))
        return cls(spectrum, bins[(bins >= 1) & (bins <= spectrum.last)])

    @property
    def samples(self) -> int:
        """Real and imaginary part of each bin."""
        return 2 * len(self.bins)

    @property
    def driven(self) -> bool:
        """Whether there are columns for the residues."""
        return self.spectrum.experiment.driven

    @property
    def bin(self) -> float:
        """Width of a basin of the loss."""
        return self.spectrum.experiment.bin

    @property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""
        return self.spectrum.experiment.ceiling

    @property
    def largest(self) -> float:
        """Largest transform."""
        return float(np.max(np.abs(self.spectrum.Y[self.bins]), initial=0.0))

    def own_unknowns(self, n: int) -> int:
        """The motion at the ends of every mode."""
        return 2 * n

    def at(self, d: Array) -> WindowEvaluation:
        """The rows at frequencies `d`."""
        return WindowEvaluation(self, d)


class WindowEvaluation:
    """The rows of a window at some frequencies."""

    def __init__(self, window: Window, d: Array) -> None:
        self._window, self._d = window, d

    @cached_property
    def _columns(self) -> Smooth:
        return self._window.spectrum.smooth_columns(self._d, self._window.bins[None, :])

    def blocks(self) -> Iterator[Array]:
        """All rows in one block."""
        yield self._joined([])

    def sensitive_blocks(self, kappa: Array, own: Array) -> Iterator[Array]:
        """The same with the derivatives of the output by the frequencies."""
        n = len(self._d)
        yield self._joined([self._columns.sensitivity(kappa, own[:n] + 1j * own[n : 2 * n])])

    def predict(self, kappa: Array, own: Array) -> ComplexArray:
        """Transform of a model at all bins."""
        spectrum = self._window.spectrum
        return spectrum.Y - spectrum.left(self._d, kappa, own)

    def _joined(self, more: list[ComplexArray]) -> Array:
        at = self._columns
        shared = [at.forced] if self._window.driven else []
        target = self._window.spectrum.Y[None, self._window.bins]
        rows = np.concatenate([at.plus + at.minus, 1j * (at.plus - at.minus), *shared, *more, target])
        return np.concatenate([rows.real, rows.imag], axis=1)

"""Records in the frequency domain: where modes are searched for, and fitted first.

The transform of a finite record obeys, exactly and for every mode,

    X_m = (kappa (b_0 + b_1 z_m) U_m + z_m tau) / (z_m - lambda),      z_m = exp(2 pi i m / T),   tau = x_0 - x_T,

so that near its frequency a mode is three unknowns (`kappa`, complex `tau`) in a linear problem over a few bins,
whatever the length of the record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...modal.modal_form import imaginary
from .modal_regressors import output_weight
from .time_rows import Evaluation, Experiment

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Bins = NDArray[np.intp]
Pair = tuple[ComplexArray, ComplexArray]

_OFF_BIN = 1e-3  # bins: on a bin the columns of a mode become parallel, though their span does not
_NEAR = 1e-3  # turns of a mode away from a bin, below which a series is more accurate
_PIECE = 1 << 18  # numbers worked on at a time


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
        high, low = self.experiment.hold.step(imaginary(-d)).phase
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
        step = one.hold.step(imaginary(-d))
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
            residual[bins] -= SmoothColumns(self, d, bins).output(kappa, ends)
        return residual

    def beside_offset(self, residual: ComplexArray) -> ComplexArray:
        """Transform of a residual without its constant, where an offset explains it: no mode is sought there."""
        return np.concatenate([[0.0], residual[1:]]) if self.experiment.offset else residual


class SmoothColumns:
    """Columns of modes (n,) at bins (K,), of the same span, that pass smoothly through the bins; and their derivatives.

    The ends are told by a motion `x`: `tau = (1 - lambda^T) x - sigma kappa`.  The first factor has its zero, and
    `sigma` takes from the column of `kappa` its pole, at the bin nearest to the mode.  Columns are of shape (n, K).
    """

    def __init__(self, spectrum: Spectrum, d: Array, bins: Bins) -> None:
        one, T = spectrum.experiment, spectrum.length
        self._one, self._d, self._step = one, d, one.hold.step(imaginary(-d))
        place = spectrum.place(d)
        centre = np.rint(place).astype(int)
        self._at_centre = bins == centre[:, None]
        self._z, self._z_0 = (np.exp(2j * np.pi / T * each) for each in (bins, centre[:, None]))
        self._U, self._U_0 = spectrum.U[bins], spectrum.U[np.minimum(centre, T // 2)][:, None]
        lam = self._step.multiplier[:, None]
        self._right, self._left = 0.5 / (self._z - lam), 0.5 / np.where(self._at_centre, 1.0, self._z - lam.conj())
        self._left[self._at_centre] = 0.0
        # log of conj(lambda) over the z of the centre; lambda^T; and the sum that a pole with a zero upon it is
        apart = self._step.growth + 2j * np.pi / T * (place - centre)
        self._length, self._back = T, np.exp(T * apart).conj()[:, None]
        self._total, self._total_slope = (0.5 * part[:, None] for part in _geometric(apart, T))

    @cached_property
    def plus(self) -> ComplexArray:
        """What belongs to the motion."""
        return np.asarray((1 - self._back) * self._z * self._right)

    @cached_property
    def minus(self) -> ComplexArray:
        """What belongs to its conjugate."""
        return np.where(self._at_centre, self._total, (1 - self._back).conj() * self._z * self._left)

    @cached_property
    def _weights(self) -> tuple[tuple[Array | ComplexArray, ...], tuple[ComplexArray, ...]]:
        """Weights of the output, and of the input now and a sample later; and their derivatives."""
        step, slopes = self._step, self._one.hold.weights_and_derivatives(imaginary(-self._d))[2:]
        db0, db1 = (-1j * slope for slope in slopes)
        weight, slope = output_weight(self._d, self._one.quantity)
        return (weight[:, None], step.b0, step.b1), (slope[:, None], db0[:, None], db1[:, None])

    def _gain(self, z: ComplexArray) -> ComplexArray:
        """What the input is multiplied by ahead of a pole."""
        weight, b0, b1 = self._weights[0]
        return np.asarray(weight * (b0 + b1 * z))

    def _gain_slope(self, z: ComplexArray) -> ComplexArray:
        (weight, b0, b1), (weight_slope, db0, db1) = self._weights
        return np.asarray(weight_slope * (b0 + b1 * z) + weight * (db0 + db1 * z))

    def _pole(self, gain: Callable[[ComplexArray], ComplexArray]) -> ComplexArray:
        """`sigma` of each mode, shape (n, 1)."""
        return gain(self._z_0.conj()).conj() * self._U_0 / self._z_0

    def _numerators(self, gain: Callable[[ComplexArray], ComplexArray]) -> Pair:
        """What stands over the pole and its mirror, 0 over the latter at the centre."""
        sigma = self._pole(gain)
        return self._U * gain(self._z) - sigma.conj() * self._z, self._U * gain(self._z.conj()).conj() - sigma * self._z

    @cached_property
    def _over_poles(self) -> Pair:
        return self._numerators(self._gain)

    @cached_property
    def forced(self) -> ComplexArray:
        """What belongs to `kappa`."""
        if not self._one.driven:
            return np.zeros(self.plus.shape, complex)
        ahead, behind = self._over_poles
        forced = ahead * self._right + behind * self._left
        return forced + self._U if self._one.quantity == "acceleration" else forced

    @cached_property
    def slopes(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Derivatives of `forced`, `plus` and `minus` by the frequency of each mode."""
        turn = -1j * self._one.hold.log_derivative(imaginary(-self._d))[:, None]
        moving = 2 * turn * self._step.multiplier[:, None]
        right_slope, left_slope = moving * self._right**2, moving.conj() * self._left**2
        zero, zero_slope = 1 - self._back, -self._length * turn * self._back
        plus = self._z * (zero_slope * self._right + zero * right_slope)
        minus = self._z * (zero_slope.conj() * self._left + zero.conj() * left_slope)
        minus = np.where(self._at_centre, self._total_slope * turn.conj(), minus)
        if not self._one.driven:
            return np.zeros(plus.shape, complex), plus, minus
        (ahead, behind), (ahead_slope, behind_slope) = self._over_poles, self._numerators(self._gain_slope)
        forced = ahead_slope * self._right + behind_slope * self._left + ahead * right_slope + behind * left_slope
        return forced, plus, minus

    def output(self, kappa: Array, motion: ComplexArray) -> ComplexArray:
        """Transform of a model, `kappa @ forced + motion @ plus + conj(motion) @ minus`, without these columns.

        What stands over the poles is a polynomial in `z` and the input, whose coefficients meet the poles in products.
        """
        driven, acceleration = self._one.driven, self._one.quantity == "acceleration"
        weight, b0, b1 = (np.ravel(part) for part in self._weights[0])
        turned = motion * (1 - self._back[:, 0])
        if driven:
            turned = turned - kappa * self._pole(self._gain)[:, 0].conj()
        over = np.stack([kappa * weight * b0, kappa * weight * b1, turned])
        still, moving, free = over @ self._right + over.conj() @ self._left
        found = self._z * free
        if driven:
            found += self._U * (still + self._z * moving + (kappa.sum() if acceleration else 0.0))
        mode, place = np.nonzero(self._at_centre)
        np.add.at(found, place, motion[mode].conj() * self._total[mode, 0])
        return np.asarray(found)

    def sensitivity(self, kappa: Array, motion: ComplexArray) -> ComplexArray:
        """Its derivative by each frequency."""
        forced, plus, minus = self.slopes
        return np.asarray(kappa[:, None] * forced + motion[:, None] * plus + motion.conj()[:, None] * minus)


def _geometric(x: ComplexArray, count: int) -> tuple[ComplexArray, ComplexArray]:
    """`sum e^(k x), k < count`, and its derivative by `x`."""
    near = np.abs(count * x) < _NEAR
    safe = np.where(near, 1.0 / count, x)
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


class WindowEvaluation(Evaluation):
    """The rows of a window at some frequencies."""

    def __init__(self, window: Window, d: Array) -> None:
        self._window, self._d = window, d

    @cached_property
    def _columns(self) -> SmoothColumns:
        return SmoothColumns(self._window.spectrum, self._d, self._window.bins)

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

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

_OFF_BIN = 1e-3  # bins: on a bin the columns of a mode become parallel, though their span does not
_PIECE = 1 << 20  # numbers worked on at a time


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

    def columns(self, d: Array, bins: Bins, slopes: bool = False) -> list[tuple[ComplexArray, ComplexArray]]:
        """Columns `[(f, g)]` of modes at bins that broadcast against `d[..., None]`, and their derivatives on request.

        `f` belongs to `kappa`; `g` and `conj` of it at the negative bin to `tau`, so that its columns are `g_+ + g_-`
        and `i (g_+ - g_-)`, kept as the pair `g_+`, `g_-` stacked in front.
        """
        one = self.experiment
        step = one.hold.step(d)
        lam = self._off_bin(d, step.multiplier)[..., None]
        b0, b1 = step.b0[..., 0, None], step.b1[..., 0, None]
        weight, weight_slope = (part[..., None] for part in output_weight(d, one.quantity))
        z = np.exp(2j * np.pi / self.length * bins)
        U = self.U[bins] if one.driven else np.zeros(bins.shape)
        right, left = 0.5 / (z - lam), 0.5 / (z - lam.conj())
        gain, mirrored = weight * (b0 + b1 * z), weight.conj() * (b0.conj() + b1.conj() * z)
        forced = U * (gain * right + mirrored * left)
        if one.quantity == "acceleration":
            forced = forced + U
        found = [(forced, np.stack([z * right, z * left]))]
        if slopes:
            turn = one.hold.log_derivative(d)[..., None] * lam
            right_slope, left_slope = 2 * right**2 * turn, 2 * left**2 * turn.conj()
            db0, db1 = (part[..., None] for part in one.hold.weight_derivatives(d))
            gain_slope = weight_slope * (b0 + b1 * z) + weight * (db0 + db1 * z)
            mirrored_slope = weight_slope.conj() * (b0.conj() + b1.conj() * z) + weight.conj() * (
                db0.conj() + db1.conj() * z
            )
            slope = U * (gain_slope * right + mirrored_slope * left + gain * right_slope + mirrored * left_slope)
            found.append((slope, np.stack([z * right_slope, z * left_slope])))
        return found

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
        tau = own[:n] + 1j * own[n : 2 * n]
        size = max(1, _PIECE // max(1, n))
        for first in range(0, len(residual), size):
            bins = np.arange(first, min(first + size, len(residual)))
            forced, (plus, minus) = self.columns(d, bins)[0]
            residual[bins] -= kappa @ forced + tau @ plus + tau.conj() @ minus
        return residual


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
        """The ends `tau` of every mode."""
        return 2 * n

    def at(self, d: Array) -> WindowEvaluation:
        """The rows at frequencies `d`."""
        return WindowEvaluation(self, d)


class WindowEvaluation:
    """The rows of a window at some frequencies."""

    def __init__(self, window: Window, d: Array) -> None:
        self._window, self._d = window, d

    @cached_property
    def _columns(self) -> list[tuple[ComplexArray, ComplexArray]]:
        return self._window.spectrum.columns(self._d, self._window.bins[None, :], slopes=True)

    def blocks(self) -> Iterator[Array]:
        """All rows in one block."""
        yield self._joined([])

    def sensitive_blocks(self, kappa: Array, own: Array) -> Iterator[Array]:
        """The same with the derivatives of the output by the frequencies."""
        n = len(self._d)
        slope, (plus, minus) = self._columns[1]
        tau = (own[:n] + 1j * own[n : 2 * n])[:, None]
        yield self._joined([kappa[:, None] * slope + tau * plus + tau.conj() * minus])

    def predict(self, kappa: Array, own: Array) -> ComplexArray:
        """Transform of a model at all bins."""
        spectrum = self._window.spectrum
        return spectrum.Y - spectrum.left(self._d, kappa, own)

    def _joined(self, more: list[ComplexArray]) -> Array:
        forced, (plus, minus) = self._columns[0]
        shared = [forced] if self._window.driven else []
        target = self._window.spectrum.Y[None, self._window.bins]
        rows = np.concatenate([plus + minus, 1j * (plus - minus), *shared, *more, target])
        return np.concatenate([rows.real, rows.imag], axis=1)

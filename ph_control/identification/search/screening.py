"""Where to start: forward selection of modes with local fits in the frequency domain.

Around each bin of the transform one mode is three unknowns in a linear problem over a few bins.  The frequencies whose
mode explains most there are compared over all the bins in which anything of the residual lies; the best joins.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ...modal.modal_form import imaginary
from ..regression.modal_regressors import output_weight
from ..regression.spectral_rows import Spectrum
from ..regression.tuning import TUNING

_WINDOW = 12  # bins around a candidate
_OFFSETS = np.array([-0.375, -0.125, 0.125, 0.375])  # candidates in every bin, never on it
_BATCH = 1 << 10  # candidates worked on at a time
_EVERYWHERE = 1 << 15  # samples up to which every bin has candidates; above, those where the residual peaks
_PEAKS = 400  # bins that have candidates then
_COMPARED = 16  # candidates compared over all bins of all of them
_OFF_BIN = 1e-3  # bins: closer to one the columns of a mode are nearly parallel


@dataclass(frozen=True)
class _CandidateColumns:
    """Real columns of candidates over some bins, shape (3, candidates, rows): `kappa`, then the free motion.

    All is scaled so that squares add up to squares in time.
    """

    bins: Indices
    rows: Array
    scale: float

    def with_target(self, target: Array) -> Array:
        """Products of all columns with a target (candidates or 1, rows), shape (3, candidates)."""
        return np.asarray(np.einsum("kcr,cr->kc", self.rows, target))

    @cached_property
    def gram(self) -> Array:
        """Products of the columns with one another, shape (3, 3, candidates)."""
        found = np.empty((3, 3, self.rows.shape[1]))
        for k, column in enumerate(self.rows):
            found[k, k:] = found[k:, k] = np.einsum("lcr,cr->lc", self.rows[k:], column)
        return found

    @cached_property
    def free_inverse(self) -> Array:
        """Inverse of the part of the free motion, shape (2, 2, candidates)."""
        (a, b), (_, c) = self.gram[1:, 1:]
        ridge = np.where(a + c > 0, TUNING.ridge * (a + c), 1.0)
        a, c = a + ridge, c + ridge
        return np.asarray(np.array([[c, -b], [-b, a]]) / (a * c - b * b))


class Screen:
    """All candidates of some experiments; asked again for each new residual."""

    def __init__(self, spectra: list[Spectrum], signed: bool = False) -> None:
        self.spectra, self.signed = spectra, signed
        self._finest = min(spectra, key=lambda one: one.record.bin)
        self._everywhere = self._finest.length <= _EVERYWHERE
        self._kept: dict[tuple[int, int], _CandidateColumns] = {}

    def __getstate__(self) -> dict[str, Any]:
        """What is kept to save work does not travel to other processes."""
        return {**self.__dict__, "_kept": {}}

    def _candidates(self, bins: Indices) -> Array:
        one = self._finest
        places = (bins[:, None] + _OFFSETS).ravel()
        largest = one.record.largest_phase * one.length / (2 * np.pi)
        return np.asarray(one.frequency(places[(places > 0) & (places < largest)]))

    def ranked(self, residuals: list[ComplexArray]) -> tuple[Array, Array]:
        """Candidate frequencies by what they explain of the residuals' transforms, the best first, and how much."""
        every = np.arange(self._finest.length // 2 + 1)
        d = self._candidates(every if self._everywhere else self._peaking(residuals))
        gains = np.concatenate(
            [self._near(d[first : first + _BATCH], first, residuals) for first in range(0, len(d), _BATCH)]
        )
        peaks = highest_peaks(gains, _COMPARED)
        d = d[peaks]
        explained = self._over_all(d, residuals)
        order = np.argsort(-explained, kind="stable")
        return d[order], explained[order]

    def _peaking(self, residuals: list[ComplexArray]) -> Indices:
        """Indices of the longest experiment about which the residual has most energy."""
        place = self.spectra.index(self._finest)
        power = np.abs(residuals[place]) ** 2
        smooth = np.convolve(power, np.ones(3), mode="same")
        return np.unique(highest_peaks(smooth, _PEAKS)[:, None] + np.arange(-1, 2))

    def _near(self, d: Array, first: int, residuals: list[ComplexArray]) -> Array:
        """Energy that each candidate explains in the bins about it."""
        parts = []
        for k, spectrum in enumerate(self.spectra):
            columns = self._kept.get((k, first)) if self._everywhere else None
            if columns is None:
                columns = _about(spectrum, d)
                if self._everywhere:
                    self._kept[k, first] = columns
            parts.append((columns, residuals[k][columns.bins]))
        return self._explained(parts)

    def at_peaks(self, d: Array, residuals: list[ComplexArray]) -> tuple[Array, Array]:
        """Energy that candidates explain in the bins about them, and the energy that is there."""
        parts = [(_about(one, d), one) for one in self.spectra]
        found = [(columns, residual[columns.bins]) for (columns, _), residual in zip(parts, residuals, strict=True)]
        total = sum(columns.scale**2 * np.sum(np.abs(residual) ** 2, axis=1) for columns, residual in found)
        return self._explained(found), np.asarray(total)

    def _over_all(self, d: Array, residuals: list[ComplexArray]) -> Array:
        """Energy that each candidate explains in the bins about all of them.

        A line of the input looks like a mode within its window; only many bins together tell them apart.
        """
        parts = []
        for spectrum, residual in zip(self.spectra, residuals, strict=True):
            bins = np.unique(_window(spectrum, d))[None, :]
            parts.append((_columns(spectrum, d, bins), residual[bins]))
        return self._explained(parts)

    def _explained(self, parts: list[tuple[_CandidateColumns, ComplexArray]]) -> Array:
        """Energy that least squares explain for each candidate, `kappa >= 0` being shared by the experiments."""
        total, pull, stiffness = 0.0, 0.0, 0.0
        for columns, residual in parts:
            rhs = columns.with_target(columns.scale * np.concatenate([residual.real, residual.imag], axis=1))
            solved = np.einsum("ijc,jc->ic", columns.free_inverse, rhs[1:])
            total = total + np.sum(rhs[1:] * solved, axis=0)
            direct, across = columns.gram[0, 0], columns.gram[0, 1:]
            pull = pull + rhs[0] - np.sum(across * solved, axis=0)
            taken = np.einsum("ic,ijc,jc->c", across, columns.free_inverse, across)
            stiffness = stiffness + direct - taken + TUNING.ridge * direct
        force = np.asarray(pull) if self.signed else np.maximum(pull, 0.0)
        return np.asarray(total + force**2 / np.where(stiffness == 0, 1.0, stiffness))


def highest_peaks(values: Array, most: int) -> Indices:
    """Places of at most so many local maxima, the highest first."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    return peaks[np.argsort(-values[peaks], kind="stable")[:most]]


def _window(spectrum: Spectrum, d: Array) -> Indices:
    """Indices about each frequency, shape (candidates, bins)."""
    width = min(_WINDOW, spectrum.length // 2)
    centres = np.rint(spectrum.place(d)).astype(int)
    first = np.clip(centres - width // 2, 0, spectrum.length // 2 - width)
    return np.asarray(first[:, None] + np.arange(width + 1))


def _about(spectrum: Spectrum, d: Array) -> _CandidateColumns:
    return _columns(spectrum, d, _window(spectrum, d))


def _columns(spectrum: Spectrum, d: Array, bins: Indices) -> _CandidateColumns:
    """Columns of the residue and of the ends of modes; of those on a bin, where the pole of one is, a little off it.

    With `(z - lambda) (z - conj(lambda))` below, the numerators of both poles together have real coefficients.
    """
    one, place, turn = spectrum.record, spectrum.place(d), 2j * np.pi / spectrum.length
    offset = place - np.rint(place)
    moved = np.where(np.abs(offset) < _OFF_BIN, np.copysign(_OFF_BIN, offset) - offset, 0.0)
    p, weight = imaginary(d), output_weight(d, one.quantity)[0].conj()
    lam = (one.hold.multiplier(p) * np.exp(turn * moved))[:, None]
    first, last = bins.min(), bins.max() + 1
    z = np.exp(turn * np.arange(first, last))[bins - first] if last - first < bins.size else np.exp(turn * bins)
    below = 1.0 / ((z - lam) * (z - lam.conj()))
    motion = 2.0 * z * below
    columns = [motion * (z - lam.real), -lam.imag * motion]
    if one.driven:
        b0, b1 = ((weight * part)[:, None] for part in one.hold.weights(p))
        over = (b0 - b1 * lam.conj()).real * z - (b0 * lam.conj()).real
        over = over + b1.real * z**2 if b1.any() else over
        forced = over * below + 1.0 if one.quantity == "acceleration" else over * below
        columns.insert(0, forced * spectrum.U[bins])
    scale, half = float(np.sqrt(2.0 / spectrum.length)), bins.shape[1]
    rows = np.zeros((3, len(d), 2 * half))
    for k, column in enumerate(columns, start=3 - len(columns)):
        np.multiply(scale, column.real, out=rows[k, :, :half])
        np.multiply(scale, column.imag, out=rows[k, :, half:])
    return _CandidateColumns(bins, rows, scale)

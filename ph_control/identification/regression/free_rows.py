"""Modes that lose energy and sensors anywhere, `G(s) = D + sum_l rho_l / (s - p_l) + conj(rho_l) / (s - conj(p_l))`.

Residues `rho_l` are of any phase and sign, and poles may lie on either side of the axis, so that every lossless model
is among these.  Given the poles, a record and a frequency response alike are rows of a linear problem; as they depend
on each pole analytically, the same columns and their derivatives by the poles give everything from one factor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ..._checks import EPS
from ...modal.discretization import Hold
from .frequency_rows import FrequencyRows
from .spectral_rows import Bins, Spectrum
from .time_rows import Experiment

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_BLOCK = 1 << 21  # numbers in a block of columns
_FREE = 512  # powers of a multiplier of which all others are products
_NEVER_DEAD = 1e-200  # of the input: what has died away must not leave the range of doubles, where all is slow
_HALF_WIDTH = 12  # bins on either side of a mode, and as many half-widths of its peak
_THINNED = 256  # bins about a mode, at most
_OFF_BIN = 1e-3  # bins: on a bin the columns of a mode without damping have a pole


class FreeRows(Protocol):
    """An experiment as rows of the linear problem for damped modes.

    A block holds columns as rows: `own_unknowns` of this experiment alone, of which the first 2n belong to the modes
    if they may be in motion at the start, then of a driven experiment the residues (2n) and what is fed through, then
    the derivatives of the motion and of the residues' columns, and the output.  A complex coefficient has two columns,
    for its real and its imaginary part.
    """

    @property
    def samples(self) -> int:
        """Number of real rows."""

    @property
    def driven(self) -> bool:
        """Whether there are columns for the residues."""

    @property
    def moving(self) -> bool:
        """Whether the modes may be in motion at the start."""

    @property
    def through(self) -> bool:
        """Whether there is a column for what is fed through."""

    def own_unknowns(self, n: int) -> int:
        """Number of unknowns of this experiment alone."""

    def blocks(self, p: ComplexArray) -> Iterator[Array]:
        """All rows for modes with these poles, block by block."""


@dataclass(frozen=True)
class _Step:
    """Multiplier and input weights of one step of `x' = p x + u`, each (n,), and their derivatives by the pole."""

    multiplier: ComplexArray
    b0: ComplexArray
    b1: ComplexArray
    slopes: tuple[ComplexArray, ...]

    @classmethod
    def of(cls, p: ComplexArray, hold: Hold) -> _Step:
        now, then, *slopes = hold.weights_and_derivatives(p)
        multiplier = hold.multiplier(p)
        return cls(multiplier, now, then, (multiplier * hold.log_derivative(p), *slopes))


def _of_real(values: ComplexArray) -> Array:
    """Columns of the real and of the imaginary part of a coefficient of `2 Re(coefficient value)`."""
    return np.concatenate([2 * values.real, -2 * values.imag])


@dataclass(frozen=True)
class FreeRecord:
    """All observed samples of a record."""

    experiment: Experiment
    through: bool = True

    @property
    def samples(self) -> int:
        """Number of observed outputs."""
        return self.experiment.samples

    @property
    def driven(self) -> bool:
        """Whether there is an input."""
        return self.experiment.driven

    @property
    def moving(self) -> bool:
        """Whether the record may start in motion."""
        return not self.experiment.from_rest

    def own_unknowns(self, n: int) -> int:
        """Free motion of every mode, and the offset."""
        return self.experiment.own_unknowns(n)

    def blocks(self, p: ComplexArray) -> Iterator[Array]:
        """Columns and derivatives at the observed samples."""
        for part, motion, plant in self._pieces(p, slopes=True):
            columns = self._columns(part, motion[0], plant[0])
            slopes = [_of_real(one[1]) for one, kept in ((motion, self.moving), (plant, self.driven)) if kept]
            rows = np.concatenate([*columns, *slopes, self.experiment.y[None, part]])
            yield rows if self.experiment.complete else rows[:, self.experiment.observed[part]]

    def predict(self, p: ComplexArray, own: Array, shared: Array) -> Array:
        """Output of a model at all samples."""
        weights = np.concatenate([own, shared]) if self.driven else own
        parts = (self._columns(part, motion[0], plant[0]) for part, motion, plant in self._pieces(p, slopes=False))
        return np.concatenate([weights @ np.concatenate(columns) for columns in parts])

    def _columns(self, part: slice, motion: ComplexArray, plant: ComplexArray) -> list[Array]:
        one, size = self.experiment, part.stop - part.start
        columns = [_of_real(motion)] if self.moving else []
        columns += [np.arange(part.start, part.stop, dtype=float)[None]] if one.offset > 1 else []
        columns += [np.ones((1, size))] if one.offset else []
        columns += [_of_real(plant)] if self.driven else []
        return columns + ([one.u[None, part]] if self.driven and self.through else [])

    def _pieces(self, p: ComplexArray, slopes: bool) -> Iterator[tuple[slice, ComplexArray, ComplexArray]]:
        """Free motions and forced responses of unit modes (1 or 2, n, m), with their derivatives by the pole."""
        one, T = self.experiment, len(self.experiment.u)
        step = _Step.of(p, one.hold)
        size = max(_FREE, _BLOCK // (8 * len(p) + 4))
        carried = np.zeros((2, len(p), 1), complex)
        log, turn = np.log(step.multiplier), step.slopes[0] / step.multiplier
        powers = np.exp(log[:, None] * np.arange(min(_FREE, T)))
        for first in range(0, T, size):
            part = slice(first, min(first + size, T))
            k = np.arange(part.start, part.stop)
            groups = np.exp(log[:, None] * k[:: powers.shape[1]])
            free = (groups[:, :, None] * powers[:, None]).reshape(len(p), groups.shape[1] * powers.shape[1])
            free = free[:, : len(k)]
            motion = np.stack([free, turn[:, None] * (k * free)] if slopes else [free])
            plant = np.zeros((1 + slopes, len(p), len(k)), complex)
            if one.driven:
                floor = _NEVER_DEAD * np.abs(one.u).max()
                now, later = one.u[part], np.append(one.u, 0.0)[part.start + 1 : part.stop + 1]
                for l in range(len(p)):
                    a = [1.0, -step.multiplier[l]]
                    push = step.b0[l] * now + step.b1[l] * later + floor * one.hold.h
                    plant[0, l], carried[0, l] = lfilter([0.0, 1.0], a, push, zi=carried[0, l])
                    if slopes:
                        d_lam, d_b0, d_b1 = (each[l] for each in step.slopes)
                        push = d_lam * plant[0, l] + d_b0 * now + d_b1 * later
                        plant[1, l], carried[1, l] = lfilter([0.0, 1.0], a, push, zi=carried[1, l])
            yield part, motion, plant


def _stacked(ahead: ComplexArray, mirrored: ComplexArray) -> ComplexArray:
    """Columns of the real and the imaginary part of a coefficient of `ahead`, its conjugate being that of the other."""
    return np.concatenate([ahead + mirrored, 1j * (ahead - mirrored)])


def _real(columns: ComplexArray) -> Array:
    """Real and imaginary parts of complex columns (k, m) beside one another."""
    return np.concatenate([columns.real, columns.imag], axis=1)


@dataclass(frozen=True)
class FreeTransform:
    """Some bins of a record's transform: there the relation of `spectrum` holds with a multiplier off the circle."""

    spectrum: Spectrum
    bins: Bins
    through: bool = True
    counts: Array | float = 1.0
    moving: bool = True

    @classmethod
    def about(cls, spectrum: Spectrum, p: ComplexArray, through: bool = True) -> FreeTransform:
        """The bins about some modes."""
        near = np.rint(spectrum.place(p.imag)).astype(int)[:, None] + np.arange(-_HALF_WIDTH, _HALF_WIDTH + 1)
        bins = np.unique(near)
        return cls(spectrum, bins[(bins >= 1) & (bins <= spectrum.last)], through)

    @classmethod
    def thinned(cls, spectrum: Spectrum, p: ComplexArray, through: bool = True) -> FreeTransform:
        """The bins about some modes as far as their peaks reach; of wide ones a part, each counting as many."""
        steps = np.zeros(spectrum.last + 1, int)
        widths = np.abs(p.real) / spectrum.experiment.bin
        for k in np.argsort(-widths):
            reach = int(min(_HALF_WIDTH * (1 + widths[k]), spectrum.last))
            centre = int(np.rint(spectrum.place(p.imag[k : k + 1])[0]))
            steps[max(0, centre - reach) : centre + reach + 1] = max(1, 2 * reach // _THINNED)
        bins = np.flatnonzero(np.arange(len(steps)) % np.maximum(steps, 1) == 0)
        bins = bins[(bins >= 1) & (steps[bins] > 0)]
        return cls(spectrum, bins, through, np.sqrt(steps[bins]))

    @property
    def samples(self) -> int:
        """Real and imaginary parts."""
        return 2 * len(self.bins)

    @property
    def driven(self) -> bool:
        """Whether there is an input."""
        return self.spectrum.experiment.driven

    def own_unknowns(self, n: int) -> int:
        """The motion at the ends of every mode."""
        return 2 * n

    def blocks(self, p: ComplexArray) -> Iterator[Array]:
        """All rows in one block."""
        columns, slopes = self.columns(p, slopes=True)
        # squares add up to squares in time
        scale = np.sqrt(2.0 / self.spectrum.length) * self.counts
        yield _real(scale * np.concatenate([*columns, *slopes, self.spectrum.Y[None, self.bins]]))

    def columns(self, p: ComplexArray, slopes: bool = False) -> tuple[list[ComplexArray], list[ComplexArray]]:
        """Complex columns of the unknowns, and the derivatives."""
        step = _Step.of(self._off_bins(p), self.spectrum.experiment.hold)
        z = np.exp(2j * np.pi / self.spectrum.length * self.bins)
        U = self.spectrum.U[self.bins]
        lam, b0, b1 = (each[:, None] for each in (step.multiplier, step.b0, step.b1))
        right, left = 1.0 / (z - lam), 1.0 / (z - lam.conj())
        columns = [_stacked(z * right, z * left)]
        ahead, behind = U * (b0 + b1 * z), U * (b0.conj() + b1.conj() * z)
        if self.driven:
            columns += [_stacked(ahead * right, behind * left), *([U[None]] if self.through else [])]
        if not slopes:
            return columns, []
        d_lam, d_b0, d_b1 = (each[:, None] for each in step.slopes)
        right_slope, left_slope = d_lam * right**2, d_lam.conj() * left**2
        found = [_stacked(z * right_slope, z * left_slope)]
        if self.driven:
            by_weight = U * (d_b0 + d_b1 * z) * right, U * (d_b0.conj() + d_b1.conj() * z) * left
            found.append(_stacked(ahead * right_slope + by_weight[0], behind * left_slope + by_weight[1]))
        return columns, found

    def _off_bins(self, p: ComplexArray) -> ComplexArray:
        """Poles, those on a bin moved a little off it."""
        place, width = self.spectrum.place(p.imag), self.spectrum.experiment.bin
        near = np.hypot(place - np.rint(place), p.real / width) < _OFF_BIN
        return p - np.where(near, _OFF_BIN * width, 0.0)


@dataclass(frozen=True)
class FreeResponse:
    """The points of a frequency response, on a background of what modes outside the band leave."""

    rows: FrequencyRows
    driven: bool = True
    moving: bool = False

    @property
    def samples(self) -> int:
        """Real and imaginary parts."""
        return self.rows.samples

    @property
    def through(self) -> bool:
        """A force is felt by an accelerometer at once."""
        return self.rows.quantity == "acceleration"

    @cached_property
    def target(self) -> ComplexArray:
        """Response in the scale of its weights."""
        return np.asarray(self.rows.record.response[self.rows.record.observed] * self.rows.scale)

    def own_unknowns(self, n: int) -> int:
        """The background."""
        return len(self._background(n))

    def _background(self, n: int) -> ComplexArray:
        """Modes far below the band act as a mass, those far above as a spring; only where points abound."""
        omega, quantity = self.rows.omega, self.rows.quantity
        lowest = omega[omega > 0].min(initial=np.inf)
        if len(omega) < 10 + 4 * n or not np.isfinite(lowest):
            return np.zeros((0, len(omega)), complex)
        if quantity == "acceleration":
            # the mass is what is fed through
            return -(omega[None] ** 2).astype(complex)
        factor = 1j * omega if quantity == "velocity" else np.ones(len(omega), complex)
        return np.stack([factor / np.maximum(omega, lowest) ** 2, factor])

    def blocks(self, p: ComplexArray) -> Iterator[Array]:
        """All rows in one block."""
        right, left = self._poles(p)
        rows = np.concatenate([self.columns(p), self.rows.scale * _stacked(right**2, left**2), self.target[None]])
        yield _real(rows)

    def columns(self, p: ComplexArray) -> ComplexArray:
        """Columns of all unknowns."""
        through = np.ones((int(self.through), len(self.rows.omega)))
        columns = np.concatenate([self._background(len(p)), _stacked(*self._poles(p)), through])
        return np.asarray(columns * self.rows.scale)

    def _poles(self, p: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        s, poles = 1j * self.rows.omega, p[:, None]
        gap = s - poles
        gap = np.where(gap == 0, EPS * np.abs(poles), gap)
        return np.asarray(1.0 / gap), np.asarray(1.0 / (s - poles.conj()))

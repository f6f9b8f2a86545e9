"""Where to start: forward selection of modes with local fits in the frequency domain.

The transform of a finite record obeys, exactly and for every mode,

    X_m = (kappa b U_m + z_m tau) / (z_m - lambda),      z_m = exp(2 pi i m / T),   tau = x_0 - x_T,

so around each Fourier bin one mode is three unknowns (`kappa`, complex `tau`) in a linear problem over a few
bins.  The frequency whose mode explains most of the residual is taken, all modes are refined jointly, repeat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .regressors import regressors
from .solver import Problem

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Batch = tuple[NDArray[np.intp], ComplexArray, tuple[Array, Array]]

_WINDOW = 12  # bins around a candidate
_OFFSETS = np.array([-0.375, -0.125, 0.125, 0.375])  # candidates in every bin, never on it
_BATCH = 1 << 14
_KEPT_BATCHES = 8  # of about 14 MB each
_FULL_CANDIDATES = (8, 64)  # fewest and most that are compared over the whole record
_FULL_SAMPLES = 400_000  # times candidates: what that comparison may cost
_RIDGE = 1e-9  # keeps nearly collinear columns apart while screening


def _constrained_energy(rhs: Array, inverse: Array, inverse_without: Array) -> Array:
    """Energy that least squares explain, for each candidate, without the first column where its weight is negative."""
    kappa = np.einsum("ci,ci->c", inverse[:, 0], rhs)
    full = np.einsum("ci,cij,cj->c", rhs, inverse, rhs)
    without = np.einsum("ci,cij,cj->c", rhs[:, 1:], inverse_without, rhs[:, 1:])
    return np.where(kappa >= 0, full, without)


class Screen:
    """All candidates of one problem; asked again for each new residual.

    What does not depend on the residual (the columns and inverse Gram matrices) is kept between questions where it fits
    in memory.
    """

    def __init__(self, problem: Problem) -> None:
        samples = len(problem.u)
        self.problem = problem
        self.half = samples // 2
        self.U = np.fft.rfft(problem.u)
        places = (np.arange(self.half + 1)[:, None] + _OFFSETS).ravel()
        phase = 2 * np.pi * places / samples
        usable = (places > 0) & (phase < problem.largest_phase)
        self.places, self.phase = places[usable], phase[usable]
        self.starts = range(0, len(self.places), _BATCH)
        self.kept: dict[int, Batch] = {}

    def strongest(self, residual: Array) -> float:
        """Natural frequency of the mode that explains most of a residual (T,), missing samples being 0."""
        E = np.fft.rfft(residual)
        gains = np.concatenate([self._explained(E, start) for start in self.starts])
        peaks = self._peaks(gains)
        d = self.problem.hold.frequency_of(self.phase[peaks])
        return float(d[np.argmax(self._explained_in_full(residual, d))])

    def _peaks(self, gains: Array) -> NDArray[np.intp]:
        """Best candidates, no two of them neighbours: as many as a look at the whole record can afford."""
        padded = np.concatenate([[-np.inf], gains, [-np.inf]])
        peaks = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]))
        count = int(np.clip(_FULL_SAMPLES / len(self.problem.u), *_FULL_CANDIDATES))
        return peaks[np.argsort(gains[peaks])[::-1][:count]]

    def _explained_in_full(self, residual: Array, d: Array) -> Array:
        """Energy of the residual that each mode alone explains over the whole record, `kappa >= 0`.

        A line of the input looks like a mode within its window; only the record as a whole tells them apart.
        """
        found = regressors(d, self.problem.u, self.problem.hold)
        parts = [found.forced] if self.problem.from_rest else [found.forced, found.cosine, found.sine]
        # candidate, column, sample
        columns = np.stack([part.T for part in parts], axis=1)
        if not self.problem.observed.all():
            columns = columns[:, :, self.problem.observed]
        columns /= np.where((lengths := np.linalg.norm(columns, axis=2)) > 0, lengths, 1.0)[:, :, None]
        gram = columns @ columns.transpose(0, 2, 1) + _RIDGE * np.eye(len(parts))
        rhs = columns @ residual[self.problem.observed]
        return _constrained_energy(rhs, np.linalg.inv(gram), np.linalg.inv(gram[:, 1:, 1:]))

    def _explained(self, E: ComplexArray, start: int) -> Array:
        """Energy of the residual that one mode at each candidate explains within its window, `kappa >= 0`."""
        if start in self.kept:
            bins, columns, inverses = self.kept[start]
        else:
            bins, columns, inverses = self._columns(slice(start, start + _BATCH))
            if len(self.starts) <= _KEPT_BATCHES:
                self.kept[start] = bins, columns, inverses
        rhs = np.einsum("cwi,cw->ci", columns, E[bins]).real
        return _constrained_energy(rhs, *inverses)

    def _columns(self, part: slice) -> Batch:
        """Bins of each window, conjugate columns for `kappa`, `Re tau`, `Im tau` there, inverse Gram matrices."""
        places, phase = self.places[part], self.phase[part]
        width = min(_WINDOW, self.half)
        first = np.clip(np.rint(places).astype(int) - width // 2, 0, self.half - width)
        bins = first[:, None] + np.arange(width + 1)
        step = self.problem.hold.step(self.problem.hold.frequency_of(phase))
        z = np.exp(2j * np.pi * bins / len(self.problem.u))
        lam, U = step.multiplier[:, None], self.U[bins]
        right, left = 0.5 / (z - lam), 0.5 / (z - lam.conj())
        forced = U * ((step.b0 + step.b1 * z) * right + (step.b0.conj() + step.b1.conj() * z) * left)
        columns = np.stack([forced, z * (right + left), 1j * z * (right - left)], axis=2)
        lengths = np.sqrt(np.sum(np.abs(columns) ** 2, axis=1))
        columns = columns / np.where(lengths > 0, lengths, 1.0)[:, None, :]
        # real and imaginary parts side by side: the unknowns are real
        real = np.concatenate([columns.real, columns.imag], axis=1)
        gram = real.transpose(0, 2, 1) @ real + _RIDGE * np.eye(3)
        return bins, columns.conj(), (np.linalg.inv(gram), np.linalg.inv(gram[:, 1:, 1:]))

"""Where an input has power: its spectral lines if it is made of few, else the band of its spectrum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_closing

from ..._checks import EPS
from ..._display import counted, first_of
from ..._types import Array
from ..._units import rate
from ..regression.elimination import triangle
from ..uncertainty.fisher import listed

_SIGNIFICANT = 1e-4  # of the largest power: 40 dB
_GAP = 4  # bins between two bands that belong together: a periodogram of noise has holes
_LAGS = 16  # distinct lags that a recursion is looked for with, and as many one sample later
_BLOCK = 1 << 14
_ON_CIRCLE = 1e-6  # distance of a root from the unit circle up to which it is a line


@dataclass(frozen=True, eq=False)
class ExcitedBand:
    """Where an input has power.

    Attributes
    ----------
    intervals : tuple of (float, float)
        Bands in rad per unit time whose power is within 40 dB of the largest; a line is half a bin wide either side.
    lines : tuple of float
        Frequencies of the spectral lines other than 0, ascending; empty where the input is not a sum of few sines.
    order : int
        Order of persistent excitation: number of independent lagged copies of the input.  1 for a constant, 2 for
        each sine.
    full : bool
        Whether more copies may be independent than were looked at.
    bin : float
        `2 pi / (T dt)`, the resolution of the record.
    time_unit : str, optional
        Unit of time, where it is known.
    """

    intervals: tuple[tuple[float, float], ...]
    lines: tuple[float, ...]
    order: int
    full: bool
    bin: float
    time_unit: str | None = None

    def __contains__(self, frequency: float) -> bool:
        return any(low <= frequency <= high for low, high in self.intervals)

    def __str__(self) -> str:
        if self.lines:
            lines = listed([f"{line:.4g}" for line in self.lines])
            return f"{counted(len(self.lines), 'spectral line')}, at {lines} {rate(self.time_unit)}"
        if not self.intervals:
            return "none: the input is constant" if self.order else "none: the input is zero"
        shown = first_of([f"{low:.4g} .. {high:.4g}" for low, high in self.intervals], 4, " ...")
        return f"{shown} {rate(self.time_unit)}"

    @property
    def shown_weights(self) -> float:
        """Number of weights `r` that such an input can show beside an unknown free motion; `inf` if not limited.

        A lossless mode answers a sine in quadrature only, so each line gives one equation, and a constant none.
        """
        return np.inf if self.full else self.order // 2


def excited_band(u: Array, dt: float, time_unit: str | None = None) -> ExcitedBand:
    """Where an input (T,) with step `dt` has power: one FFT, and a rank over the record with 32 lags."""
    samples = len(u)
    spacing = 2 * np.pi / (samples * dt)
    order, full, lines = _recursion(u, dt)
    if lines:
        intervals = tuple((max(0.0, line - spacing / 2), line + spacing / 2) for line in lines)
    else:
        intervals = _intervals(u, spacing)
    return ExcitedBand(intervals, lines, order, full, spacing, time_unit)


def _intervals(u: Array, spacing: float) -> tuple[tuple[float, float], ...]:
    """Bands of the spectrum; the mean excites nothing and is taken off."""
    samples = len(u)
    # Hann's window, shifted by half a sample so that no sample is lost
    window = np.sin(np.pi * (np.arange(samples) + 0.5) / samples) ** 2
    centred = u - u @ window / window.sum()
    if np.abs(centred).max() <= samples * EPS * np.abs(u).max():
        return ()
    power = np.abs(np.fft.rfft(centred / np.abs(centred).max() * window)) ** 2
    padded = np.zeros(len(power) + 2 * _GAP, bool)
    padded[_GAP:-_GAP] = power >= _SIGNIFICANT * power.max()
    significant = binary_closing(padded, np.ones(_GAP + 1, bool))[_GAP:-_GAP]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], significant, [False]])))
    return tuple(
        (max(0.0, spacing * (first - 0.5)), min(spacing * samples / 2, spacing * (last - 0.5)))
        for first, last in edges.reshape(-1, 2).tolist()
    )


def _recursion(u: Array, dt: float) -> tuple[int, bool, tuple[float, ...]]:
    """Rank of the lagged copies of an input, whether it is full, and the lines of a sum of few sines.

    Half of the lags are spread over half of the record, so that close lines differ; the others come one sample later,
    so that the shift by one sample, whose eigenvalues are the lines, is seen without aliases.
    """
    peak = float(np.abs(u).max())
    count = min(_LAGS, len(u) // 4)
    if peak == 0 or count == 0:
        return int(peak > 0), peak > 0, ()
    stride = max(2, len(u) // (2 * count))
    lags = stride * np.arange(count)
    shifts, scaled = np.concatenate([lags, lags + 1])[:, None], u / peak
    last = len(u) - int(shifts.max())
    parts = [np.arange(start, min(start + _BLOCK, last)) for start in range(0, last, _BLOCK)]
    _, sigma, vectors = np.linalg.svd(triangle(lambda: (scaled[shifts + part] for part in parts), last))
    order = int(np.sum(sigma > len(u) * EPS * sigma[0]))
    if order > count:
        return order, order == 2 * count, ()
    now, later = vectors[:order, :count].T, vectors[:order, count:].T
    roots = np.linalg.eigvals(np.linalg.lstsq(now, later, rcond=None)[0])
    if np.abs(np.abs(roots) - 1).max() > _ON_CIRCLE:
        return order, False, ()
    phases = np.sort(np.abs(np.angle(roots)))
    # a pair of roots for each line; one alone is a constant, or a line at the Nyquist frequency
    turning = phases[phases > 2 * np.pi / len(u) * 1e-3]
    return order, False, tuple((turning[::2] / dt).tolist())

"""What an input shows of modes whose frequencies are not known yet: a group of them tried all over the band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._frozen import Frozen
from ..._types import Array, Indices
from ..._units import rate
from ..uncertainty.fisher import PortRecord, model_information, work
from .excited_band import ExcitedBand

SPACING = 3.0  # bins between neighbours of a group: what a record separates at moderate noise
_WORTH = 10.0  # times the smallest error, up to which a frequency counts as shown
_PLACES = 40  # most frequencies of a grid
_WORK = 4e9  # operations of all factorisations, but for the three that there are at least


@dataclass(frozen=True, eq=False)
class Scan(Frozen):
    """What an input shows of a group of n modes of equal residue, `SPACING` bins apart, wherever they lie.

    Attributes
    ----------
    frequencies : ndarray, shape (K,)
        Centres of the group, ascending, rad per unit time.
    deficiency : ndarray of int, shape (K,)
        Combinations of parameters that leave no trace.
    error : ndarray, shape (K,)
        Largest relative standard error of a weight of the group, in units of the smallest of the scan; `inf` if blind.
    time_unit : str, optional
        Unit of time, where it is known.
    """

    frequencies: Array
    deficiency: Indices
    error: Array
    time_unit: str | None = None

    @property
    def shown(self) -> tuple[tuple[float, float], ...]:
        """Bands of centres where the errors are within ten times the smallest."""
        good = self.error <= _WORTH
        edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]])))
        return tuple(
            (float(self.frequencies[first]), float(self.frequencies[last - 1]))
            for first, last in edges.reshape(-1, 2).tolist()
        )

    def __str__(self) -> str:
        if not self.shown:
            return "nowhere"
        bands = [f"{low:.3g} .. {high:.3g}" if low < high else f"about {low:.3g}" for low, high in self.shown]
        return ", ".join(bands) + f" {rate(self.time_unit)}"


def scan(problem: PortRecord, n: int, band: ExcitedBand) -> Scan:
    """Information of a group of n modes at each of a grid of frequencies."""
    top = ceiling(problem)
    few = max(3, int(_WORK / work(problem, n)))
    inside = [place for low, high in band.intervals[:8] for place in (low, 0.5 * (low + high), high)][:few]
    grid = np.concatenate([np.geomspace(problem.bin, top, min(_PLACES, few)), inside])
    grid = np.unique(grid[(grid >= problem.bin) & (grid <= top)])
    d = np.array([group(n, centre, problem) for centre in grid])
    informations = [
        model_information(problem, frequencies, 1.0 / frequencies, np.zeros(n, complex)) for frequencies in d
    ]
    error = np.array([np.max(information.stderr(1.0)[n : 2 * n] * d[k]) for k, information in enumerate(informations)])
    best = error.min()
    deficiency = np.array([information.deficiency for information in informations])
    return Scan(grid, deficiency, error / best if np.isfinite(best) else error, band.time_unit)


def ceiling(problem: PortRecord) -> float:
    """Largest frequency that is tried: a little below what the samples carry."""
    phase = min(0.98 * np.pi, problem.largest_phase)
    return float(problem.hold.frequency_of(np.array([phase]))[0])


def group(n: int, centre: float, problem: PortRecord) -> Array:
    """Frequencies of n modes about a centre, `SPACING` bins apart, moved into what the record carries."""
    top = ceiling(problem)
    spacing = min(SPACING * problem.bin, top / (n + 1))
    first = centre - 0.5 * (n - 1) * spacing
    first = min(max(first, min(problem.bin, spacing)), top - (n - 1) * spacing)
    return np.asarray(first + spacing * np.arange(n))


def representative(n: int, problem: PortRecord, band: ExcitedBand) -> Array:
    """Frequencies of n modes spread over the widest excited band, or grouped where it is narrow."""
    top = ceiling(problem)
    if not band.intervals:
        return group(n, np.sqrt(problem.bin * top), problem)
    low, high = max(band.intervals, key=lambda interval: interval[1] - interval[0])
    low, high = max(low, problem.bin), min(high, top)
    if high - low < SPACING * problem.bin * (n + 1):
        return group(n, 0.5 * (low + high), problem)
    return np.asarray(low + (high - low) * np.arange(1, n + 1) / (n + 1))

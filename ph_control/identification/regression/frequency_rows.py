"""Measured frequency responses as rows of the linear problem, on a background of what modes outside the band leave."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, Mask
from .spectral_rows import Pair, real_rows, stacked, thinned_places
from .time_rows import Evaluation
from .tuning import TUNING


def differentiated(omega: Array, quantity: str) -> ComplexArray:
    """What makes the response of a displacement that of a quantity: a power of `i w`."""
    return np.asarray((1j * omega) ** {"displacement": 0, "velocity": 1, "acceleration": 2}[quantity], complex)


def typical_distance(omega: Array) -> float:
    """Median of the distances of ascending frequencies."""
    steps = np.diff(omega)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else float(omega[0])


@dataclass(frozen=True, eq=False)
class FreeResponse:
    """Frequency responses for modes with any damping and residues, on a background of what modes outside leave.

    Of several entries (q, K) that were `observed` (K,) at the same frequencies, with errors in one `scale`.
    """

    frequencies: Array
    response: ComplexArray
    scale: Array
    observed: Mask
    quantity: str = "velocity"
    outputs: Indices = field(default_factory=lambda: np.zeros(1, int))
    moving: ClassVar[bool] = False
    inputs: ClassVar[int] = 1
    acting: ClassVar[Indices] = np.zeros(1, int)

    @cached_property
    def omega(self) -> Array:
        """Frequencies that were measured, rad per unit time."""
        return self.frequencies[self.observed]

    @property
    def samples(self) -> int:
        """Real and imaginary parts."""
        return 2 * len(self.omega)

    @cached_property
    def bin(self) -> float:
        """Typical distance of the frequencies."""
        return typical_distance(self.omega)

    @property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""
        return float(self.omega[-1])

    @property
    def through(self) -> bool:
        """A force is felt by an accelerometer at once."""
        return self.quantity == "acceleration"

    @cached_property
    def weight(self) -> Array:
        """Factor of errors at the frequencies that were measured."""
        return self.scale[self.observed]

    @cached_property
    def target(self) -> ComplexArray:
        """Responses (q, K) that were measured, in the scale of their weights."""
        return np.asarray(self.response[:, self.observed] * self.weight)

    @property
    def largest(self) -> Array:
        """Largest value of each entry, in the scale of its weights."""
        return np.abs(self.target).max(axis=1, initial=0.0)

    def own_unknowns(self, n: int) -> int:
        """The background."""
        return len(self.background(n))

    def background(self, n: int) -> ComplexArray:
        """Modes far below the band act as a mass, those far above as a spring; only where points abound."""
        omega = self.omega
        lowest = omega[omega > 0].min(initial=np.inf)
        if len(omega) < 10 + 4 * n or not np.isfinite(lowest):
            return np.zeros((0, len(omega)), complex)
        factor = differentiated(omega, self.quantity)
        # of an accelerometer the mass is what is fed through
        return factor[None] if self.through else np.stack([factor / np.maximum(omega, lowest) ** 2, factor])

    def thinned(self, p: ComplexArray) -> FreeResponse:
        """The points about some modes as far as their peaks reach, and a few; of wide peaks a part, each for many."""
        omega, reach = self.omega, TUNING.half_width * (self.bin + np.abs(p.real))
        first, last = (np.searchsorted(omega, end) for end in (p.imag - reach, p.imag + reach))
        widest = np.argsort(-reach)
        ranges = zip(first[widest], last[widest], (last - first)[widest] // (4 * TUNING.thinned), strict=True)
        kept, counts = thinned_places(ranges, len(omega), 1 + len(omega) // TUNING.everywhere)
        observed, scale = self.observed.copy(), self.scale.copy()
        observed[self.observed] = np.isin(np.arange(len(omega)), kept)
        scale[observed] *= counts
        return replace(self, observed=observed, scale=scale)

    def at(self, p: ComplexArray) -> FreeResponseEvaluation:
        """The rows for modes with these poles."""
        return FreeResponseEvaluation(self, p)

    def columns(self, p: ComplexArray, poles: Pair | None = None) -> ComplexArray:
        """Columns of all unknowns, in the scale of the weights."""
        through = np.ones((int(self.through), len(self.omega)))
        columns = np.concatenate([self.background(len(p)), stacked(poles or self.poles(p)), through])
        return np.asarray(columns * self.weight)

    def poles(self, p: ComplexArray) -> Pair:
        """`1 / (s - p)` and `1 / (s - conj p)`."""
        s, poles = 1j * self.omega, p[:, None]
        gap = s - poles
        gap = np.where(gap == 0, EPS * np.abs(poles), gap)
        return np.asarray(1.0 / gap), np.asarray(1.0 / (s - poles.conj()))


class FreeResponseEvaluation(Evaluation):
    """The rows of responses for modes with any damping and residues."""

    def __init__(self, rows: FreeResponse, p: ComplexArray) -> None:
        self._rows, self._p = rows, p

    def blocks(self) -> Iterator[Array]:
        """All rows in one block."""
        ahead, behind = self._rows.poles(self._p)
        slopes = self._rows.weight * stacked((ahead**2, behind**2))
        yield real_rows([self._rows.columns(self._p, (ahead, behind)), slopes, self._rows.target])

    def predict(self, shared: Array, own: Array) -> ComplexArray:
        """Responses of a model at all frequencies of the record; NaN where nothing was measured."""
        rows = self._rows
        everywhere = np.full((shared.shape[1], len(rows.frequencies)), np.nan, complex)
        # other entries may be fed through, and these not
        weights = np.concatenate([own, shared[: 2 * len(self._p) + rows.through]])
        everywhere[:, rows.observed] = weights.T @ rows.columns(self._p) / rows.weight
        return everywhere

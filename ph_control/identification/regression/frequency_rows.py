"""A measured frequency response as rows of the linear problem: `G(i w) = sum_l kappa_l i w / (d_l^2 - w^2)`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..._checks import EPS
from ..data.frequency_record import FrequencyRecord
from .time_rows import Evaluation

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class FrequencyRows:
    """A frequency response: real and imaginary part of each point that was measured, in the scale of its weight."""

    record: FrequencyRecord
    quantity: str = "velocity"

    @cached_property
    def omega(self) -> Array:
        """Frequencies that were measured, rad per unit time."""
        return self.record.omega[self.record.observed]

    @cached_property
    def scale(self) -> Array:
        """Factor of the residual at each of them."""
        return np.asarray(np.sqrt(self.record.weights[self.record.observed]))

    @property
    def samples(self) -> int:
        """Real and imaginary parts."""
        return 2 * len(self.omega)

    @property
    def driven(self) -> bool:
        """A response shows the residues."""
        return True

    @cached_property
    def bin(self) -> float:
        """Typical distance of the frequencies: a mode does not pass from one side of a point to the other."""
        steps = np.diff(self.omega)
        return float(np.median(steps[steps > 0])) if (steps > 0).any() else float(self.omega[0])

    @property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""
        return float(self.omega[-1])

    def own_unknowns(self, n: int) -> int:
        """None: there is no free motion in a response."""
        return 0

    def at(self, d: Array) -> FrequencyEvaluation:
        """The rows at frequencies `d`."""
        return FrequencyEvaluation(self, d)

    def elsewhere(self, d: Array, kappa: Array) -> list[tuple[int, float]]:
        """Modes and frequencies at which the loss may have another minimum, close to theirs.

        The loss is infinite at every point that was measured, and where a point stands high on a resonance the minimum
        beside it is narrow: it is where the mode reproduces the point.  Others lie in the middle of the next intervals.
        """
        omega, y = self.omega, self.record.response[self.record.observed]
        columns, _ = modal_columns(d, omega, self.quantity)
        found: list[tuple[int, float]] = []
        for l in np.flatnonzero(kappa > 0).tolist():
            place = int(np.searchsorted(omega, d[l]))
            near = np.arange(max(0, place - 2), min(len(omega), place + 2))
            middle = 0.5 * (omega[near[1:]] + omega[near[:-1]])
            # what the mode alone has to be at each of these points, and where it is
            wanted = y[near] - np.delete(kappa, l) @ np.delete(columns[:, near], l, axis=0)
            gap = (d[l] - omega[near]) * (d[l] + omega[near])
            own = columns[l, near] * np.where(gap == 0, EPS * np.maximum(d[l], omega[near]) ** 2, gap)
            size = np.abs(wanted) ** 2
            squares = omega[near] ** 2 + kappa[l] * (own * wanted.conj()).real / np.where(size > 0, size, np.inf)
            through = np.sqrt(squares[squares > 0])
            within = through[np.abs(through - d[l]) < omega[near[-1]] - omega[near[0]]]
            found += [(l, float(one)) for one in np.concatenate([within, middle])]
        return found

    @cached_property
    def target(self) -> ComplexArray:
        """Response that was measured, in the scale of its weight."""
        return np.asarray(self.record.response[self.record.observed] * self.scale)

    @cached_property
    def largest(self) -> float:
        """Largest response, in the scale of its weight."""
        return float(np.max(np.abs(self.target), initial=0.0))


class FrequencyEvaluation(Evaluation):
    """The rows of a response at some frequencies; O(K n)."""

    def __init__(self, rows: FrequencyRows, d: Array) -> None:
        self._rows, self._d = rows, d
        self._columns, self._slopes = modal_columns(d, rows.omega, rows.quantity)

    def blocks(self) -> Iterator[Array]:
        """All rows in one block."""
        yield self._joined(np.zeros((0, len(self._rows.omega))))

    def sensitive_blocks(self, kappa: Array, own: Array) -> Iterator[Array]:
        """The same with the derivatives by the frequencies."""
        yield self._joined(kappa[:, None] * self._slopes)

    def predict(self, kappa: Array, own: Array) -> ComplexArray:
        """Response of a model at all frequencies of the record, measured or not, shape (K,)."""
        columns, _ = modal_columns(self._d, self._rows.record.omega, self._rows.quantity)
        return np.asarray(kappa @ columns)

    def _joined(self, more: ComplexArray | Array) -> Array:
        record = self._rows.record
        target = record.response[record.observed][None]
        rows = np.concatenate([self._columns, more, target]) * self._rows.scale
        return np.concatenate([rows.real, rows.imag], axis=1)


def modal_columns(d: Array, omega: Array, quantity: str) -> tuple[ComplexArray, ComplexArray]:
    """Response of modes of unit residue at frequencies, and its derivative by `d`, each (n, K).

    Velocity `i w / (d^2 - w^2)`, divided by `i w` for displacement and times it for acceleration.  On a pole they are
    very large rather than infinite.
    """
    gap = (d[:, None] - omega) * (d[:, None] + omega)
    gap = np.where(gap == 0, EPS * np.maximum(d[:, None], omega) ** 2, gap)
    factor: ComplexArray = {
        "velocity": 1j * omega,
        "displacement": np.ones(len(omega), complex),
        "acceleration": -(omega**2) + 0j,
    }[quantity]
    return factor / gap, -2 * d[:, None] * factor / gap**2

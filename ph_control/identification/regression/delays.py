"""Delays of the outputs, as coordinates of a model and in the rows of its data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..._types import Array, Indices
from .frequency_rows import FreeResponse
from .time_rows import FreeRecord

Rows = TypeVar("Rows", FreeRecord, FreeResponse)


@dataclass(frozen=True)
class Delays:
    """Delays that outputs of a projection share, in units of time.

    Attributes
    ----------
    groups : ndarray of int, shape (outputs of the projection,)
        Which delay each output has.
    values : ndarray, shape (k,)
        The delays.
    step : float
        Time within which an answer hardly turns: no step of a search is longer.
    least, most : float or None
        Bounds of a search; the samples of records that any delay between them leaves out are left out for all.
    """

    groups: Indices
    values: Array
    step: float = np.inf
    least: float | None = None
    most: float | None = None

    @classmethod
    def of_outputs(cls, delay: Array) -> Delays:
        """The delays of all outputs."""
        values, groups = np.unique(delay, return_inverse=True)
        return cls(groups, values)

    @property
    def count(self) -> int:
        """Number of delays."""
        return len(self.values)

    @property
    def each(self) -> Array:
        """Delay of each output."""
        return self.values[self.groups]

    def rows(self, experiments: Sequence[Rows]) -> list[Rows]:
        """Rows with these delays, of outputs that share one."""
        found = list[Rows]()
        for one in experiments:
            each = self.groups[one.outputs]
            for group in np.unique(each).tolist():
                part = one if np.all(each == group) else one.among_outputs(each == group)
                found.append(part.delayed(float(self.values[group]), self.least, self.most))
        return found

    def inside(self, values: Array) -> Array:
        """Delays brought to where they are allowed."""
        return np.clip(values, self.least, self.most)

"""Errors that entries of a response matrix share, as each is fitted by itself.

Outputs show the same motion from before a block, so that what they say of a mode is not said twice.  The rows of each
entry are white, and entries are eliminated one by one; what they share enters covariances and tests afterwards, by the
moments of the errors between entries (`WindowErrors`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ..data.line_errors import BandedFactor
from .windowed import WindowErrors


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """What the errors of an entry (output, input) have in common with those of others, by the `law` of all."""

    law: WindowErrors
    entry: tuple[int, int]
    noise: float
    lines: Indices
    factor: BandedFactor  # of the errors of this entry, by the law

    @classmethod
    def of(cls, law: WindowErrors, entry: tuple[int, int], noise: float, lines: Indices) -> SharedErrors:
        """That of an entry at some lines, of an output with such noise."""
        covariance = law.covariance(lines, (entry[0],) * 2, noise)
        return cls(law, entry, noise, lines, BandedFactor.of(covariance, law.relation(lines, entry, entry)))

    def times(self, other: SharedErrors, rows: Array) -> Array:
        """Covariance of the errors of this entry in its rows with those of another, times some of its rows (2 K, k)."""
        turned = _joined(other.factor.turned_back(rows))
        every = np.zeros((self.law.noise.shape[1], rows.shape[1]), complex)
        every[other.lines - self.law.first] = turned
        (a, i), (b, j) = self.entry, other.entry
        ahead, behind = self.law.relation_at(self.entry, other.entry), self.law.relation_at(other.entry, self.entry)
        products = _banded(ahead, behind, every.conj())
        if i == j:
            products = products + _banded(self.law.motion[a, b], self.law.motion[b, a].conj(), every)
        here = 0.5 * products[self.lines - self.law.first]
        return _parted(self.factor.whitened(here.T).T)


def _banded(ahead: ComplexArray, behind: ComplexArray, values: ComplexArray) -> ComplexArray:
    """Product of a banded matrix with columns: entries (k + d, k) of it are `ahead`, (k, k + d) `behind`."""
    product = ahead[0][:, None] * values
    for d in range(1, len(ahead)):
        product[d:] += ahead[d, :-d, None] * values[:-d]
        product[:-d] += behind[d, :-d, None] * values[d:]
    return product


def _joined(parts: Array) -> ComplexArray:
    """Real parts, then imaginary ones, as complex numbers."""
    half = len(parts) // 2
    return np.asarray(parts[:half] + 1j * parts[half:])


def _parted(values: ComplexArray) -> Array:
    return np.concatenate([values.real, values.imag])


def share_errors(experiments: Sequence[Any]) -> bool:
    """Whether rows of several entries have errors in common."""
    return sum(getattr(rows, "shared_errors", None) is not None for rows in experiments) > 1


def crossed_scores(experiments: Sequence[Any], jacobians: Mapping[int, Array]) -> Array:
    """Covariance of `sum J^T e` over the rows of all experiments beyond `sum J^T J`, by what entries share.

    `jacobians[k]` (2 K, unknowns) is that of the rows of experiment k, whose own unknowns have been eliminated.
    """
    places = [k for k in jacobians if getattr(experiments[k], "shared_errors", None) is not None]
    size = next(iter(jacobians.values())).shape[1]
    scores = np.zeros((size, size))
    for place, k in enumerate(places):
        for l in places[:place]:
            first, second = experiments[k].shared_errors, experiments[l].shared_errors
            if first.law is second.law:
                part = jacobians[k].T @ first.times(second, jacobians[l])
                scores += part + part.T
    return scores

"""The score of a record at old parameters, in units of the errors of these, and the step that it asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._checks import EPS
from ..._frozen import Frozen
from ..._types import Array, Indices, Mask

_SHOWN = 1e-9  # of the largest information: a direction with less leaves no trace in the new record
CORRELATED = 1e-11  # of the largest eigenvalue of a correlation matrix: less is rounding of a constraint


@dataclass(frozen=True, eq=False)
class Score(Frozen):
    """Score (q,) and information (q, q) in units in which old errors are independent and of size 1.

    `directions` (k, q) are the parameters that are looked at, by these units.
    """

    score: Array
    information: Array
    directions: Array

    def spectrum(self) -> tuple[Array, Array, Mask]:
        """Eigenvalues and vectors of the information, and which leave a trace."""
        return _spectrum(self.information)

    def step(self) -> tuple[Array, Array, Mask]:
        """Change (k,) of the parameters by one step, a square root of its covariance (k, j), and whether it is seen."""
        values, vectors, shown = self.spectrum()
        seen = self.directions @ vectors[:, shown]
        change = seen @ (vectors[:, shown].T @ self.score / values[shown])
        root = seen * np.sqrt(1.0 + 1.0 / values[shown])
        hidden = np.linalg.norm(self.directions @ vectors[:, ~shown], axis=1)
        sizes = np.linalg.norm(self.directions, axis=1)
        return change, root, hidden <= np.sqrt(EPS) * sizes

    def standardised(self, mean: Array, spread: Array) -> tuple[Array, int]:
        """Score less that of a mean (q,), in units in which its covariance `F + F P F` is the identity, and its rank.

        `F` is the information and `P` the covariance (q, q) of the parameters that it is held against.
        """
        F = self.information
        values, vectors, shown = _spectrum(F + F @ spread @ F)
        kept = vectors[:, shown]
        return kept @ (kept.T @ (self.score - F @ mean) / np.sqrt(values[shown])), int(shown.sum())


def _spectrum(matrix: Array) -> tuple[Array, Array, Mask]:
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return values, vectors, values > _SHOWN * max(float(values.max(initial=0.0)), np.finfo(float).tiny)


def known_parameters(covariance: Array) -> Indices:
    """Places of parameters that have an error."""
    variances = np.diag(covariance)
    return np.flatnonzero(np.isfinite(variances) & (variances > 0))


def root_of_covariance(covariance: Array, places: Indices) -> Array:
    """Square root (k, q) of the covariance of parameters at some places (k,).

    Its columns span what constraints on them allow; along each they have the error 1.
    """
    sizes = np.sqrt(np.diag(covariance)[places])
    values, vectors = np.linalg.eigh(covariance[np.ix_(places, places)] / np.outer(sizes, sizes))
    kept = values > CORRELATED * values.max()
    return np.asarray(sizes[:, None] * vectors[:, kept] * np.sqrt(values[kept]))

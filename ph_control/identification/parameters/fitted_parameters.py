"""Estimated parameters with their covariance, and what of them the data do not show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._frozen import Frozen
from ..._types import Array, Mask

_SHOWN = 1e-6  # of the largest singular value of columns of unit length: below, a combination leaves no trace
HIDDEN_SHARE = 1e-3  # of a combination: a parameter that belongs to it
_NAMED = 0.1  # of the largest share in a combination: from there on a parameter is named


@dataclass(frozen=True, eq=False)
class FittedParameters(Frozen):
    """Parameters of a model function at the minimum.

    Attributes
    ----------
    names : tuple of str
        Of the parameters.
    values : ndarray, shape (P,)
        Estimates.
    covariance : ndarray, shape (P, P)
        Of the estimates; NaN for those that leave no trace, alone or in a combination, or are held at a bound.
    start, lower, upper : ndarray, shape (P,)
        Where the search began, and the bounds.
    hidden : ndarray, shape (k, P)
        Combinations of relative changes, of unit length, that leave no trace.
    evaluations : int
        How often the function was called.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> rng = np.random.default_rng(0)
    >>> def lag(theta):
    ...     return ct.tf([theta[0]], [theta[1], 1.0])
    >>> u = rng.standard_normal(500)
    >>> y = ct.forced_response(ct.c2d(lag([2.0, 0.5]), 0.1), 0.1 * np.arange(500), u).outputs
    >>> y = y + 0.01 * rng.standard_normal(500)
    >>> result = phc.pem((u, y), dt=0.1, model=lag, parameters={"gain": 1.0, "time constant": 1.0}, quantity="free")
    >>> result.fitted_parameters.names, result.fitted_parameters.values.round(2)
    (('gain', 'time constant'), array([2. , 0.5]))
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    start: Array
    lower: Array
    upper: Array
    hidden: Array
    evaluations: int = 0

    @property
    def stderr(self) -> Array:
        """Standard errors (P,); infinite for what leaves no trace, NaN for what is held at a bound."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        lost = np.any(np.abs(self.hidden) > HIDDEN_SHARE, axis=0)
        return np.where(lost, np.inf, errors)

    @property
    def correlations(self) -> Array:
        """Correlations (P, P) of the estimates."""
        size = np.where(np.isfinite(self.stderr) & (self.stderr > 0), self.stderr, 1.0)
        return np.asarray(self.covariance / np.outer(size, size))


@dataclass(frozen=True)
class ParameterInformation:
    """What data show of parameters: the Gram matrix of whitened residuals by relative changes, of the `free` ones.

    Attributes
    ----------
    inverse : ndarray, shape (P, P)
        Of what is shown, 0 for the rest.
    hidden : ndarray, shape (k, P)
        Combinations of unit length that leave no trace.
    rank : int
        Number of combinations that leave one.
    """

    inverse: Array
    hidden: Array
    rank: int

    @classmethod
    def of(cls, jacobian: Array, free: Mask) -> ParameterInformation:
        """Information of a Jacobian (N, P), parameters that are not free held."""
        P, places = jacobian.shape[1], np.flatnonzero(free)
        J = jacobian[:, places]
        lengths = np.linalg.norm(J, axis=0)
        lengths = np.where(lengths > _SHOWN**2 * lengths.max(initial=0.0), lengths, np.inf)
        _, s, V = np.linalg.svd(np.linalg.qr(J / lengths, mode="r"), full_matrices=True)
        s = np.concatenate([s, np.zeros(len(places) - len(s))])
        shown = s > _SHOWN * s.max(initial=np.finfo(float).tiny)
        inverse = np.zeros((P, P))
        root = V[shown].T / s[shown] / lengths[:, None]
        inverse[np.ix_(places, places)] = root @ root.T
        hidden = np.zeros((int((~shown).sum()), P))
        turned = V[~shown] / np.where(np.isinf(lengths), 1.0, lengths)
        hidden[:, places] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        return cls(inverse, hidden, int(shown.sum()))

    @property
    def seen(self) -> Mask:
        """Which parameters belong to no combination without a trace."""
        return np.asarray(~np.any(np.abs(self.hidden) > HIDDEN_SHARE, axis=0))


@dataclass(frozen=True, eq=False)
class ParametricPoint:
    """Covariance of poles and shared unknowns, by the parameters."""

    slopes: Array
    spread: Array
    excess: float | None = None
    deficiency: int = 0

    def covariance(self, variance: float) -> Array:
        """In the coordinates of `FreeProjection.covariance`."""
        return np.asarray(self.slopes @ (variance * self.spread) @ self.slopes.T)


def named_combination(direction: Sequence[float], names: Sequence[str]) -> str:
    """A combination of relative changes by the names of those that have a share, the largest 1: 'k1 - 0.5 m'."""
    values = np.asarray(direction, float)
    values = values / values[int(np.argmax(np.abs(values)))]
    parts = []
    for value, name in zip(values.tolist(), names, strict=True):
        if abs(value) < _NAMED:
            continue
        size = "" if abs(abs(value) - 1) < 0.01 else f"{abs(value):.2g} "
        parts.append(f"{'-' if value < 0 else '+'} {size}{name}")
    return " ".join(parts).removeprefix("+ ")

"""Models of outputs alone, from their correlations: canonical variates of the past and the future.

The correlations are those of the record with zeros about it, a sequence that some stationary process has: so every
model that is made of them is stable, and its predictor forgets.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_are

from ..._types import Array, ComplexArray
from ..regression.sections import Sections
from ..search.fitted_modes import Orders
from .noise_sections import NoiseSections

_ANY = Orders()
_RANK = 1e-10  # of the largest eigenvalue of a covariance
_TURNS = 16  # bases of a section that are tried for a good condition


@dataclass(frozen=True, eq=False)
class CanonicalVariates:
    """Past and future of outputs, r samples each, from correlations (2 r + 1, p, p)."""

    R: Array

    @property
    def horizon(self) -> int:
        """Number r of samples of past and future."""
        return len(self.R) // 2

    @cached_property
    def _two_sided(self) -> Array:
        """Correlations of lags -2 r to 2 r."""
        return np.concatenate([self.R[:0:-1].transpose(0, 2, 1), self.R])

    def _blocks(self, first: int, down: int, along: int) -> Array:
        r, p = np.arange(self.horizon), self.R.shape[1]
        lags = len(self.R) - 1 + first + down * r[:, None] + along * r
        return np.asarray(self._two_sided[lags].transpose(0, 2, 1, 3).reshape(len(r) * p, len(r) * p))

    @cached_property
    def _past(self) -> Array:
        """Covariance of `(y_{-1}, y_{-2}, ..)`."""
        return self._blocks(0, -1, 1)

    @cached_property
    def _with_past(self) -> Array:
        """Covariance of `y_0` with the past."""
        return np.concatenate(self.R[1 : self.horizon + 1], axis=1)

    @cached_property
    def _directions(self) -> Array:
        """Combinations of the past, of variance 1, by what they foretell of the future."""
        past, future = _inverse_root(self._past), _inverse_root(self._blocks(0, 1, -1))
        return np.asarray(np.linalg.svd(future @ self._blocks(1, 1, 1) @ past)[2] @ past)

    @property
    def largest(self) -> int:
        """Most states that there can be."""
        return len(self._past)

    def model(self, states: int) -> tuple[Array, Array, Array] | None:
        """Matrices A, C and gain K of a model with some states; None where there is none."""
        M, past, p = self._directions[:states], self._past, self.R.shape[1]
        kept = len(past) - p
        # the past one sample later begins with y_0
        later = np.concatenate([self._with_past, past[:kept]])
        A, C = M @ later @ M.T, self._with_past @ M.T
        of_new = M @ np.concatenate([self.R[0], self._with_past[:, :kept].T])
        Q, R = np.eye(states) - A @ A.T, self.R[0] - C @ C.T
        S = of_new - A @ C.T
        try:
            P = solve_discrete_are(A.T, C.T, 0.5 * (Q + Q.T), 0.5 * (R + R.T), s=S)
            K = np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T
        except (np.linalg.LinAlgError, ValueError):
            return None
        return A, C, K


def _inverse_root(S: Array) -> Array:
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    values = np.maximum(values, _RANK * values.max(initial=0.0))
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def in_sections(
    A: Array, C: Array, K: Array, step: float, orders: Orders = _ANY
) -> NoiseSections | None:  # fmt: skip
    """A discrete model in sections, of those of its poles that orders allow: by default all that motions in time have.

    None where two poles are one, or all are left out.
    """
    if not np.isfinite(A).all():
        return None
    values, vectors = np.linalg.eig(A)
    chosen = orders.among(values)
    kept, others = np.flatnonzero(chosen), np.flatnonzero((values.imag >= 0) & ~chosen)
    if not len(kept):
        return None
    poles: ComplexArray = np.log(values[kept].astype(complex)) / step
    sections = Sections.of(poles)
    references = np.sqrt(np.maximum(np.abs(sections.square), (1e-3 * sections.decay) ** 2))
    size = 2 * len(sections.decay) + len(sections.rates)
    model = NoiseSections(sections, step, references, np.zeros((len(C), size)), np.zeros((size, len(C))))
    spans = [vectors[:, [kept[k] for k in dict.fromkeys(places)]] for places in sections.places.tolist()]
    spans += [vectors[:, [kept[k]]] for k in sections.single.tolist()]
    columns, first = list[Array](), 0
    for span in spans:
        both = _real_basis(span)
        these = slice(first, first + both.shape[1])
        inner = np.linalg.lstsq(both, A @ both, rcond=None)[0]
        columns.append(np.asarray(both @ _similar(np.asarray(inner, float), model.A[these, these]), float))
        first = these.stop
    T = np.concatenate([*columns, *(_real_basis(vectors[:, [k]]) for k in others.tolist())], axis=1)
    if not np.linalg.cond(T) < 1 / _RANK:
        return None
    return model.moved(sections, C @ T[:, :size], np.asarray(np.linalg.solve(T, K)[:size], float))


def _real_basis(span: ComplexArray) -> Array:
    """Real vectors that span as much as some vectors and their conjugates do."""
    both: Array = np.concatenate([span.real, span.imag], axis=1) if span.imag.any() else span.real
    return both


def _similar(inner: Array, block: Array) -> Array:
    """Matrix X of good condition with `inner X = X block`, for matrices of the same eigenvalues."""
    if len(inner) == 1:
        return np.eye(1)
    system = np.kron(inner, np.eye(2)) - np.kron(np.eye(2), block.T)
    first, second = (row.reshape(2, 2) for row in np.linalg.svd(system)[2][-2:])
    turns = np.linspace(0, np.pi, _TURNS, endpoint=False)[:, None, None]
    bases = np.cos(turns) * first + np.sin(turns) * second
    return np.asarray(bases[np.argmin(np.linalg.cond(bases))])

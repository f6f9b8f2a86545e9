"""Models of outputs alone, from their correlations: canonical variates of the past and the future."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_are

from ..._types import Array, ComplexArray
from ..regression.sections import Sections
from .noise_sections import NoiseSections

_MOST_ROWS = 400  # of a covariance of the past


def correlations(y: Array, lags: int) -> Array:
    """Correlations `E y_{t+k} y_t^T` (lags + 1, p, p) of outputs (p, T), those of a record with zeros about it."""
    p, T = y.shape
    size = 1 << int(np.ceil(np.log2(T + lags)))
    Y = np.fft.rfft(y, size)
    R = np.empty((lags + 1, p, p))
    for i in range(p):
        R[:, i] = np.fft.irfft(Y[i] * Y.conj(), size)[:, : lags + 1].T
    return R / T


@dataclass(frozen=True, eq=False)
class CanonicalVariates:
    """Past and future of outputs, from correlations (2 r + 1, p, p)."""

    R: Array

    @property
    def horizon(self) -> int:
        """Number r of samples of past and future."""
        return len(self.R) // 2

    def _lagged(self, k: int) -> Array:
        return self.R[k] if k >= 0 else self.R[-k].T

    def _blocks(self, first: int, down: int, along: int) -> Array:
        r = self.horizon
        return np.block([[self._lagged(first + down * i + along * j) for j in range(r)] for i in range(r)])

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array, Array]:
        """Covariance of the past, its whitening, singular vectors and values of what it foretells of the future."""
        past = self._blocks(0, -1, 1)  # y_{-1}, y_{-2}, ...
        future = self._blocks(0, 1, -1)
        across = self._blocks(1, 1, 1)
        of_past, of_future = (_inverse_root(S) for S in (past, future))
        _, s, Vt = np.linalg.svd(of_future @ across @ of_past)
        return past, of_past, Vt, s

    @property
    def canonical_correlations(self) -> Array:
        """Correlations of future and past."""
        return self._parts[3]

    def model(self, states: int) -> tuple[Array, Array, Array] | None:
        """Matrices A, C and gain K of a model with some states; None where it has none that is stable."""
        past, of_past, Vt, _ = self._parts
        p, r = self.R.shape[1], self.horizon
        M = Vt[:states] @ of_past  # state of the past
        # y_0 and what is the past one sample later
        next_past = np.concatenate([self._row(r), past], axis=0)[: p * r]
        C = self._row(r) @ M.T
        A = M @ next_past @ M.T
        if np.abs(np.linalg.eigvals(A)).max(initial=0.0) >= 1:
            return None
        new = M @ self._past_of_next() @ M.T
        Q, R = new - A @ A.T, self.R[0] - C @ C.T
        S = M @ np.concatenate([self.R[0], self._row(r).T[: p * (r - 1)]]) - A @ C.T
        try:
            P = solve_discrete_are(A.T, C.T, 0.5 * (Q + Q.T), R, s=S)
        except (np.linalg.LinAlgError, ValueError):
            return None
        K = np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T
        return A, C, K

    def _row(self, r: int) -> Array:
        """Covariance of `y_0` with the past."""
        return np.concatenate([self._lagged(j + 1) for j in range(r)], axis=1)

    def _past_of_next(self) -> Array:
        return self._parts[0]


def _inverse_root(S: Array) -> Array:
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    values = np.maximum(values, 1e-12 * values.max(initial=0.0))
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def in_sections(A: Array, C: Array, K: Array, step: float) -> NoiseSections | None:
    """A discrete model in sections; None where it has poles that no continuous one has."""
    values, vectors = np.linalg.eig(A)
    kept = np.flatnonzero(values.imag >= 0)
    values_kept = values[kept]
    if np.any((values_kept.imag == 0) & (values_kept.real <= 0)):
        return None
    poles: ComplexArray = np.log(values_kept) / step
    sections = Sections.of(poles)
    # poles of two real ones in a section lie apart
    model = NoiseSections(sections, step, np.sqrt(sections.decay**2 + np.abs(sections.square)), C, K)
    inverse = np.linalg.inv(vectors)
    T = np.zeros(A.shape)
    order = []
    for slow, fast in sections.places.tolist():
        order.append([kept[slow]] if slow == fast else [kept[slow], kept[fast]])
    order += [[kept[k]] for k in sections.single.tolist()]
    # real basis of each invariant subspace, and the change to the basis of its block
    first = 0
    for places in order:
        span = vectors[:, places]
        span = np.concatenate([span.real, span.imag], axis=1) if np.iscomplexobj(span) and len(places) == 1 and values[places[0]].imag > 0 else span.real
        size = span.shape[1]
        inner = np.linalg.lstsq(span, A @ span, rcond=None)[0]
        block = model.A[first : first + size, first : first + size]
        T[:, first : first + size] = span @ _similar(inner, block)
        first += size
    del inverse
    return model.moved(sections, C @ T, np.linalg.solve(T, K))


def _similar(inner: Array, block: Array) -> Array:
    """Matrix X with `inner X = X block`, for 2 x 2 or 1 x 1 matrices with the same eigenvalues, of a good condition."""
    if len(inner) == 1:
        return np.eye(1)
    system = np.kron(inner, np.eye(2)) - np.kron(np.eye(2), block.T)
    _, _, Vt = np.linalg.svd(system)
    first, second = Vt[-1].reshape(2, 2), Vt[-2].reshape(2, 2)
    angles = np.linspace(0, np.pi, 16, endpoint=False)
    return min((np.cos(a) * first + np.sin(a) * second for a in angles), key=np.linalg.cond)

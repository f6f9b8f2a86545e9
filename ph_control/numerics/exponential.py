"""Exponentials of matrices, and integrals of quadratic forms along them, with nearly twice the digits of a double.

Scaling and squaring: a short step by its Taylor series, then doubled.  Nothing is divided by differences of
eigenvalues, which may coincide, and the digits beyond those of a double are what cancels where a long step leaves
little.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgebal, dgetrf, dgetrs

from .._types import Array
from .double_double import Pair, add, divide, product, two_prod

_SHORT = 2.0**-4  # norm of the step that is summed as a series
_TERMS = 16  # of the series: the next ones are below 2^-95 of the sum, those of integrals as well
_SETTLING = 5  # doublings after which a held input has had time to move the states
_SURE = 1e-6  # share of a solution by which it is corrected once: twice the digits come from two such corrections
_FAR = 1e6  # steps that the slowest mode may take for one unit of its state
_MOST = 2200  # doublings, which lead from the smallest double to the largest


def integral_of_form(M: Pair, form: Array) -> Array:
    """Matrix `integral_0^1 e^(M^T t) form e^(M t) dt` of a symmetric form."""
    X, doublings = _short(M)
    F, total, term = _exponential_of_short(X), (form, np.zeros_like(form)), (form, np.zeros_like(form))
    for k in range(2, _TERMS + 2):
        half = product(_transposed(X), term)
        term = _over(add(half, _transposed(half)), k)
        total = add(total, term)
    total = total[0] * 0.5**doublings, total[1] * 0.5**doublings
    for _ in range(doublings):
        total = add(total, product(product(_transposed(F), total), F))
        F = product(F, F)
    return 0.5 * (total[0] + total[0].T)


def with_inputs(A: Array, B: Array, h: float) -> tuple[Pair, Array]:
    """Matrix of `x' = A x + B u`, `u' = s`, `s' = 0` over a step `h`, with `s` by step; and the units it is in.

    These are powers of 2 in which the norm of the matrix is that of the fastest mode: inputs have none of their own.
    """
    n, m = B.shape
    states = dgebal(A, scale=1)[3] if n else np.ones(0)
    rows = B / states[:, None]
    _, exponent = np.frexp(h * np.abs(rows).max(axis=0, initial=0.0))
    inputs = np.ldexp(1.0, -exponent)
    high, low = (np.zeros((n + 2 * m, n + 2 * m)) for _ in range(2))
    high[:n, : n + m], low[:n, : n + m] = two_prod(
        np.hstack([A * states / states[:, None], rows * inputs]), np.full((n, n + m), h)
    )
    high[n : n + m, n + m :] = np.eye(m)
    return (high, low), np.concatenate([states, inputs, inputs])


def one_step(A: Array, B: Array, h: float) -> tuple[Pair, Pair, Pair]:
    """What a step of `x' = A x + B u` makes of `x`, of an input that is held, and of one that rises from 0 to 1.

    A held input moves the states towards where it holds them.  What a long step leaves of the way is not the difference
    of what it makes at first and later, where an exact 0 would be lost, but the decay of the distance.
    """
    n, m = B.shape
    M, units = with_inputs(A, B, h)
    X, doublings = _short(M)
    E, parts = _exponential_of_short(X), [slice(n), slice(n, n + m), slice(n + m, None)]
    F, now, then = ((E[0][:n, part], E[1][:n, part]) for part in parts)
    for k in range(doublings, 0, -1):
        # the second half of the step finds the input risen by that of the first
        risen = add((np.ldexp(now[0], -k), np.ldexp(now[1], -k)), then)
        F, now, then = product(F, F), add(product(F, now), now), add(product(F, then), risen)
    if doublings > _SETTLING and (rest := _rest(M, n, m)):
        now = add(product(F, rest), _negative(rest))
    scales = [units[:n, None] / units[part] for part in parts]
    F, now, then = ((high * x, low * x) for (high, low), x in zip((F, now, then), scales, strict=True))
    return F, now, then


def _rest(M: Pair, n: int, m: int) -> Pair | None:
    """Solution `x` of `A x = B`: a held input ends at `-x`.  None where it has fewer digits than the step."""
    (A, low), B = ((M[0][:n, part], M[1][:n, part]) for part in (slice(n), slice(n, n + m)))
    lu, pivots, singular = dgetrf(A)
    if singular or not n:
        return None
    x = dgetrs(lu, pivots, B[0])[0], np.zeros((n, m))
    size = np.abs(x[0]).max(initial=0.0)
    for _ in range(2):
        missing = add(B, _negative(product((A, low), x)))
        more = dgetrs(lu, pivots, missing[0])[0]
        if not np.abs(more).max(initial=0.0) <= _SURE * size <= _SURE * _FAR:
            return None
        x = add(x, (more, np.zeros((n, m))))
    return x


def _short(M: Pair) -> tuple[Pair, int]:
    """A power of 2 of the matrix whose norm is small, and how often that is to be doubled."""
    _, exponent = np.frexp(np.linalg.norm(M[0], 1) / _SHORT) if len(M[0]) else (0, 0)
    doublings = int(np.clip(exponent, 0, _MOST))
    return (np.ldexp(M[0], -doublings), np.ldexp(M[1], -doublings)), doublings


def _exponential_of_short(X: Pair) -> Pair:
    total = term = np.eye(len(X[0])), np.zeros_like(X[0])
    for k in range(1, _TERMS + 1):
        term = _over(product(term, X), k)
        total = add(total, term)
    return total


def _over(pair: Pair, divisor: int) -> Pair:
    return divide(pair, (np.full((), float(divisor)), np.zeros(())))


def _negative(pair: Pair) -> Pair:
    return -pair[0], -pair[1]


def _transposed(pair: Pair) -> Pair:
    return pair[0].T, pair[1].T

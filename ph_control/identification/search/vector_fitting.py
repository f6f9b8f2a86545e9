"""Where the poles of measured frequency responses lie: vector fitting.

With poles `p` taken for known, `G sigma = N`, both with these poles, is linear in the coefficients of `N` and of
`sigma = 1 + ...`; the zeros of `sigma` are better poles.  All modes are found at once, none in the place of another: in
responses weighted by their gain, where antiresonances count as much as resonances, one mode alone explains nothing.

Literature: B. Gustavsen and A. Semlyen, Rational approximation of frequency domain responses by vector fitting, IEEE
Trans. Power Delivery 14 (1999).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..regression.damped import DampedResponse
from ..regression.frequency_rows import FrequencyRows

Array = NDArray[np.float64]

_ROUNDS = 12
_FIRST_RATIO = 0.01  # damping of the first poles
_MOST_DAMPED = 0.5
_LEAST_DAMPED = 1e-9  # of a mode that loses nothing: keeps columns finite


def vector_fit(experiments: Sequence[FrequencyRows], n: int) -> tuple[Array, Array]:
    """Natural frequencies and decay rates of n modes of either sign, shape (n,) each; none where points are few.

    On the background of `DampedResponse`; 12 rounds of O(points n^2).
    """
    responses = [DampedResponse(one) for one in experiments]
    points = np.sort(np.concatenate([one.omega for one in experiments]))
    if 2 * len(points) <= 4 * n + 2 or points[-1] == points[0]:
        return np.zeros(0), np.zeros(0)
    first = np.asarray(np.quantile(points, (np.arange(n) + 0.5) / n))
    first = np.maximum(first, points[points > 0][0])
    d: Array = first
    sigma = _FIRST_RATIO * first
    for _ in range(_ROUNDS):
        c = _denominator(responses, d, sigma)
        poles = np.linalg.eigvals(_companion(d, sigma, c))
        poles = poles[poles.imag > 0]
        # a pair that became real starts anew
        d = np.concatenate([np.abs(poles), first[: n - len(poles)]])
        d = np.clip(d, points[points > 0][0], points[-1])
        ratio = np.concatenate([-poles.real / np.abs(poles), np.full(n - len(poles), _FIRST_RATIO)])
        sigma = d * np.clip(np.abs(ratio), _LEAST_DAMPED, _MOST_DAMPED)
    return d, sigma


def _denominator(responses: Sequence[DampedResponse], d: Array, sigma: Array) -> Array:
    """Coefficients of `sigma - 1` beside `i w / gap` and `d / gap` of each mode, shape (2n,)."""
    rows = []
    for one in responses:
        parts = one.partial_fractions(d, sigma)
        A = np.concatenate([one.factor * parts, one.own(d, sigma), -one.target * parts, one.target[None]])
        rows.append(np.concatenate([A.real, A.imag], axis=1).T)
    A = np.concatenate(rows)
    lengths = np.linalg.norm(A, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    R = np.asarray(np.linalg.qr(A / lengths, mode="r"))[-2 * len(d) - 1 :, -2 * len(d) - 1 :]
    found = np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=None)[0]
    return np.asarray(found / lengths[-2 * len(d) - 1 : -1] * lengths[-1])


def _companion(d: Array, sigma: Array, c: Array) -> Array:
    """Matrix whose eigenvalues are the zeros of `1 + sum(c_l i w / gap_l + c_{n+l} d_l / gap_l)`."""
    n = len(d)
    here = np.arange(n)
    A = np.zeros((2 * n, 2 * n))
    A[here, n + here], A[n + here, here], A[n + here, n + here] = d, -d, -2 * sigma
    A[n:] -= np.concatenate([c[n:], c[:n]])
    return A

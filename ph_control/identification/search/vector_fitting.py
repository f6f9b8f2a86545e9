"""Where the poles of measured frequency responses lie: vector fitting.

With poles `p` taken for known, `G sigma = N`, both with these poles, is linear in the residues of `N` and of
`sigma = 1 + ...`; the zeros of `sigma` are better poles.  All modes are found at once, none in the place of another: in
responses weighted by their gain, where antiresonances count as much as resonances, one mode alone explains nothing.

Literature: B. Gustavsen and A. Semlyen, Rational approximation of frequency domain responses by vector fitting, IEEE
Trans. Power Delivery 14 (1999).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..regression.frequency_rows import FreeResponse

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_ROUNDS = 12
_FIRST_RATIO = 0.01  # damping of the first poles
_MOST_DAMPED = 0.5
_LEAST_DAMPED = 1e-9  # of a mode that loses nothing: keeps columns finite


def vector_fit(responses: Sequence[FreeResponse], n: int) -> ComplexArray:
    """Poles of n modes with residues of any phase, shape (n,); none where points are few.

    On the background of `FreeResponse`; 12 rounds of O(points n^2).
    """
    points = np.sort(np.concatenate([one.rows.omega for one in responses]))
    if 2 * len(points) <= 4 * n + 2 or points[-1] == points[0]:
        return np.zeros(0, complex)
    lowest = points[points > 0][0]
    first = np.maximum(np.quantile(points, (np.arange(n) + 0.5) / n), lowest)
    p = (1j - _FIRST_RATIO) * first
    for _ in range(_ROUNDS):
        found = np.linalg.eigvals(_companion(p, _denominator(responses, p)))
        found = found[found.imag > 0]
        # a pair that became real starts anew
        found = np.concatenate([found, (1j - _FIRST_RATIO) * first[: n - len(found)]])
        d = np.clip(np.abs(found), lowest, points[-1])
        ratio = np.clip(np.abs(found.real) / np.abs(found), _LEAST_DAMPED, _MOST_DAMPED)
        p = d * (1j * np.sqrt(1 - ratio**2) - ratio)
    return p


def _denominator(responses: Sequence[FreeResponse], p: ComplexArray) -> Array:
    """Real and imaginary parts of the residues of `sigma`, shape (2n,)."""
    rows = []
    for one in responses:
        columns = one.columns(p)
        own = one.own_unknowns(len(p))
        modal = columns[own : own + 2 * len(p)]
        A = np.concatenate([columns, -one.target / one.rows.scale * modal, one.target[None]])
        rows.append(np.concatenate([A.real, A.imag], axis=1).T)
    A = np.concatenate(rows)
    lengths = np.linalg.norm(A, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    R = np.asarray(np.linalg.qr(A / lengths, mode="r"))[-2 * len(p) - 1 :, -2 * len(p) - 1 :]
    found = np.linalg.lstsq(R[:, :-1], R[:, -1], rcond=None)[0]
    return np.asarray(found / lengths[-2 * len(p) - 1 : -1] * lengths[-1])


def _companion(p: ComplexArray, c: Array) -> Array:
    """Matrix whose eigenvalues are the zeros of `1 + sum(c_l / (s - p_l) + conj)`."""
    n = len(p)
    re, im = np.diag(p.real), np.diag(p.imag)
    A = np.block([[re, im], [-im, re]])
    A[:n] -= 2 * c
    return A

"""Zeros of a lossless system: between its poles, where the input holds the output at rest.

One port: the roots of `sum_l kappa_l / (d_l^2 - w^2)`, of which each gap between two poles holds one (Foster).  LAPACK
solves such equations for the singular values of a diagonal matrix with a row added.  More ports: the eigenvalues of
the skew dynamics compressed to where the output vanishes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import null_space
from scipy.linalg.lapack import dlasd4

from .. import _checks
from .._types import Array, ComplexArray, Indices
from ..exceptions import StructureError
from ..numerics.double_double import Pair, two_sum
from ..symplectic.forms_and_williamson import skew_normal_form

_ROW = 1e140  # size of the added row: its square is a double, and its reciprocal nothing beside the terms of the sum
_MODERATE = 1e30  # frequencies of which this holds
_SPREAD = 1e100  # of frequencies, and of the roots of residues, up to which all products stay in the range of doubles


def one_port_zeros(d: Array, kappa: Array, kappa_0: float | None) -> Array:
    """Imaginary parts of the zeros of one port, ascending; `kappa_0` is None without a pole at 0."""
    if kappa_0 is None and np.count_nonzero(kappa) == len(d) and np.count_nonzero(d[1:] > d[:-1]) == len(d) - 1:
        return _mirrored(_roots(d, kappa), at_zero=True)
    live = kappa > 0
    # unreached modes, and all but one of several at the same frequency, are cancelled by a zero each
    unreached = d[~live]
    d, copies = np.unique(d[live], return_counts=True)
    kappa = np.add.reduceat(kappa[live], np.cumsum(copies) - copies) if len(d) else d
    cancelled = np.concatenate([unreached, np.repeat(d, copies - 1)])
    at_zero = kappa_0 is None and len(d) > 0
    if kappa_0 is not None:
        d, kappa = np.concatenate([[0.0], d]), np.concatenate([[kappa_0], kappa])
    return _mirrored(np.sort(np.concatenate([cancelled, _roots(d, kappa)])), at_zero)


def _mirrored(w: Array | list[float], at_zero: bool) -> Array:
    """Positive numbers, their opposites, and 0 between them or not."""
    n = len(w)
    both = np.zeros(2 * n + at_zero)
    if n:
        both[-n:] = w
        np.negative(both[: -n - 1 : -1], out=both[:n])
    return both


def zeros_in_gaps(d: Array, kappa: Array, gaps: Indices) -> Pair:
    """Zeros above the poles `d[gaps]` as pairs of doubles, of which the distances from the poles keep all digits."""
    solutions = _solve(d, kappa, gaps.tolist())
    either_side = np.array([distance[k : k + 2] for k, (_, distance) in zip(gaps, solutions, strict=True)])
    nearer = np.abs(either_side).argmin(axis=1)
    return two_sum(d[gaps + nearer], -either_side[np.arange(len(gaps)), nearer])


def _roots(d: Array, kappa: Array) -> list[float]:
    return [root for root, _ in _solve(d, kappa, range(len(d) - 1))]


def _solve(d: Array, kappa: Array, gaps: Sequence[int]) -> list[tuple[float, Array]]:
    """Root in each of these gaps, and all poles less that root."""
    if not gaps:
        return []
    smallest, largest, weights = float(d[0] or d[1]), float(d[-1]), kappa.tolist()
    heaviest = max(weights)
    if largest / smallest > _SPREAD or min(weights) < heaviest * _SPREAD**-2:
        raise _out_of_reach(largest / smallest, weights)
    if not 1 / _MODERATE < largest < _MODERATE:
        # a power of two rounds nothing
        unit = float(2.0 ** np.floor(np.log2(largest)))
        return [(unit * root, unit * distance) for root, distance in _solve(d / unit, kappa, gaps)]
    row, solutions = np.sqrt(kappa / heaviest), []
    for k in gaps:
        distance, root, _, failed = dlasd4(k, d, row, _ROW)
        if failed:
            raise _out_of_reach(largest / smallest, weights)
        solutions.append((root, distance))
    return solutions


def _out_of_reach(spread: float, weights: list[float]) -> StructureError:
    apart = max(weights) / (min(weights) or np.finfo(float).tiny)
    return StructureError(
        f"the largest frequency is {spread:.1e} times the smallest and the largest residue {apart:.1e} times the "
        f"smallest; zeros are found up to {_SPREAD:.0e} and {_SPREAD**2:.0e}: leave out modes that are out of all scale"
    )


def many_port_zeros(d: Array, nu: ComplexArray, rigid: Array) -> Array:
    """Imaginary parts of the zeros of several ports."""
    eta = np.sqrt(d)[:, None] * nu
    B = np.concatenate([eta.real, eta.imag, rigid])
    n = len(d)
    V = null_space(B.T) if len(B) else np.zeros((0, 0))
    rotated = np.concatenate([d[:, None] * V[n : 2 * n], -d[:, None] * V[:n], 0 * V[2 * n :]])
    K = V.T @ rotated
    w, _, _ = skew_normal_form(0.5 * (K - K.T))
    # K is right to rounding of d: what is left of a zero at 0 is no frequency
    w[w <= len(B) * _checks.EPS * np.max(d, initial=0.0)] = 0.0
    return np.sort(np.concatenate([-w, w, np.zeros(len(K) - 2 * len(w))]))

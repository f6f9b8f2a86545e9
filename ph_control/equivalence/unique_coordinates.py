"""Pairs `(d, v)`: the parameters of the canonical forms, what acts on them, and coordinates of what is left.

A group permutes the modes and turns the phase of each.  On canonical pairs, where all `d` differ and no
`r_l = v_l^2 + v_{n+l}^2` is 0, its orbits are the transfer functions, and `(d ascending, r)` are coordinates of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _checks
from .._types import Array, ArrayLike, Indices, RealOrComplex
from ..exceptions import StructureError


def act(sigma: ArrayLike, theta: ArrayLike, d: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Act on a pair `(d, v)` by a permutation of the modes, then by a turn of the phase of each.

    The left action of the semidirect product `S_n x| T^n` (Proposition 4.18 of the paper).

    Parameters
    ----------
    sigma : array_like of int, shape (n,)
        Permutation of `0 .. n-1`; the new mode i is the old mode `sigma[i]`.
    theta : array_like, shape (n,)
        Angles in radians by which the planes `(v_i, v_{n+i})` then turn.
    d : array_like, shape (n,)
        Natural frequencies, positive.
    v : array_like, shape (2n,)
        Input vector in Williamson coordinates.

    Returns
    -------
    d : ndarray, shape (n,)
        The frequencies `d[sigma]`.
    v : ndarray, shape (2n,)
        The permuted and turned vector.

    Raises
    ------
    StructureError
        If `sigma` is no permutation, or the sizes do not fit.

    Notes
    -----
    Exact but for the sines and cosines; O(n).  The product of `(sigma, theta)` after `(tau, phi)` is
    `(tau[sigma], theta + phi[sigma])`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> d, v = phc.act([1, 0], [0.0, np.pi / 2], [1.0, 2.0], [3.0, 4.0, 0.0, 0.0])
    >>> d, v.round(12)
    (array([2., 1.]), array([4., 0., 0., 3.]))
    """
    frequencies, vector = _checks.parameter_pair(d, v)
    n = len(frequencies)
    order = permutation(sigma, n)
    angles = _checks.real_array("theta", theta)
    if angles.shape != (n,):
        raise StructureError(f"theta has shape {angles.shape}; with {n} natural frequencies it must be ({n},)")
    c, s = np.cos(angles), np.sin(angles)
    q, p = vector[:n][order], vector[n:][order]
    return frequencies[order], np.concatenate([c * q - s * p, s * q + c * p])


def to_unique(d: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Global coordinates of a canonical pair: frequencies ascending, and `r_l = v_l^2 + v_{n+l}^2` in that order.

    The quotient map of Proposition 4.20 of the paper.

    Parameters
    ----------
    d : array_like, shape (n,)
        Natural frequencies, positive, all different, in any order.
    v : array_like, shape (2n,)
        Input vector in Williamson coordinates.

    Returns
    -------
    d : ndarray, shape (n,)
        Strictly ascending.
    r : ndarray, shape (n,)
        Positive.

    Raises
    ------
    StructureError
        If `d` and `v` do not fit, the pair is not canonical (two frequencies equal, or an `r` of 0), or an `r` leaves
        the range of doubles.

    Notes
    -----
    Two canonical pairs have the same coordinates iff an element of the group of `act` takes one to the other, iff
    their filters agree.  Of a canonical `PortHamiltonian` they are `sys.d` and `sys.r`.  Full relative accuracy;
    O(n log n).

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.to_unique([2.0, 1.0], [0.0, 3.0, 1.0, 4.0])
    (array([1., 2.]), array([25.,  1.]))
    """
    frequencies, vector = _checks.parameter_pair(d, v)
    order = np.argsort(frequencies, kind="stable")
    r = squared_weights(vector)[order]
    frequencies = frequencies[order]
    _canonical(frequencies, r, "merge them with modes(..).minimal()")
    return frequencies, r


def from_unique(d: ArrayLike, r: ArrayLike) -> tuple[Array, Array]:
    """Pair `(d, v)` with given global coordinates: the section `v = (sqrt(r), 0)` of `to_unique`.

    Parameters
    ----------
    d : array_like, shape (n,)
        Natural frequencies, positive, strictly ascending.
    r : array_like, shape (n,)
        Weights, positive.

    Returns
    -------
    d : ndarray, shape (n,)
        The same frequencies.
    v : ndarray, shape (2n,)
        Input vector `(sqrt(r), 0)`.

    Raises
    ------
    StructureError
        If `d` is not ascending, two frequencies are equal, or a weight is not positive.

    Notes
    -----
    `to_unique` of it gives `(d, r)` back, `r` up to the rounding of a square root.  O(n).

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.from_unique([1.0, 2.0], [4.0, 9.0])
    (array([1., 2.]), array([2., 3., 0., 0.]))
    """
    frequencies = _checks.natural_frequencies(d)
    weights = _checks.residue_weights(r, len(frequencies))
    steps = np.diff(frequencies)
    if steps.size and steps.min() < 0:
        k = int(steps.argmin())
        raise StructureError(
            f"d is not ascending: d[{k}] = {frequencies[k]:.6g}, d[{k + 1}] = {frequencies[k + 1]:.6g}; sort it, and r "
            "with it"
        )
    _canonical(frequencies, weights, "merge them, adding their weights")
    return frequencies, np.concatenate([np.sqrt(weights), np.zeros(len(weights))])


def _canonical(d: Array, r: Array, remedy: str) -> None:
    """Refuse resonance and degeneracy, for ascending `d`."""
    gaps = np.diff(d) / d[1:]
    close = 8 * max(1, len(d)) * _checks.EPS
    if gaps.size and gaps.min() <= close:
        k = int(gaps.argmin())
        raise StructureError(
            f"the pair is not canonical: the frequencies {d[k]:.17g} and {d[k + 1]:.17g} differ by {gaps[k]:.1e} "
            f"of their size, expected more than {close:.1e}; {remedy}"
        )
    if r.size and r.min() <= 0:
        k = int(r.argmin())
        raise StructureError(
            f"the pair is not canonical: r = {r[k]:.6g} at frequency {d[k]:.6g}, expected > 0; no input reaches this "
            "mode, drop it"
        )


# --- arguments ---


def squared_weights(v: Array) -> Array:
    """`r_l = v_l^2 + v_{n+l}^2`, refused where a square leaves the range of doubles."""
    q, p = v.reshape(2, -1)
    r = np.asarray(q**2 + p**2, float)
    _checks.representable("the weights r = v^2", r, nonzero=(q != 0) | (p != 0))
    return r


def permutation(sigma: ArrayLike, n: int) -> Indices:
    """Check a permutation of `0 .. n-1`."""
    try:
        order = np.asarray(sigma)
    except ValueError as error:
        raise StructureError(f"sigma is no permutation of the indices 0 .. {n - 1}: {error}") from None
    if order.shape != (n,) or (n and order.dtype.kind not in "iu") or not np.array_equal(np.sort(order), np.arange(n)):
        raise StructureError(
            f"sigma is {np.array2string(order, threshold=9)}; it must be a permutation of the indices 0 .. {n - 1}"
        )
    return order.astype(np.intp)


def resonances(d: Array, rtol: float | None = None) -> list[Indices]:
    """Groups of indices of equal frequencies, ascending; those closer than `rtol * d`, default `8 n eps`, are equal."""
    close = 8 * max(1, len(d)) * _checks.EPS if rtol is None else _checks.relative_tolerance(rtol)
    order = np.argsort(d, kind="stable")
    gaps = np.diff(d[order])
    return np.split(order, np.flatnonzero(gaps > close * d[order][1:]) + 1) if len(d) else []


def power_of_two(values: RealOrComplex) -> float:
    """Size of the largest of some numbers, as a power of two; 1 if all are 0."""
    largest = float(np.abs(values).max(initial=0.0))
    return float(np.ldexp(0.5, np.frexp(largest)[1])) if 0 < largest < np.inf else 1.0


def norm_of(M: RealOrComplex, axis: int | None = None) -> Any:
    """Euclidean norm, also where squares leave the range of doubles."""
    unit = np.abs(M).max(axis=axis, initial=0.0, keepdims=True)
    unit = np.where((unit > 0) & np.isfinite(unit), unit, 1.0)
    return np.linalg.norm(M / unit, axis=axis) * np.squeeze(unit, axis=axis)

"""Zeros of a lossless system: between its poles, where the input holds the output at rest.

One port: the eigenvalues of `diag(d^2)` compressed to the orthogonal complement of `sqrt(kappa)`, each then refined
between the poles that enclose it.  More ports: those of the skew dynamics compressed to where the output vanishes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import _checks
from .symplectic import skew_normal_form

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def one_port_zeros(d: Array, kappa: Array, kappa_0: float | None) -> Array:
    """Imaginary parts of the zeros of one port; `kappa_0` is None without a pole at 0."""
    rigid = kappa_0 is not None
    live = kappa > 0
    # unreached modes, and all but one of several at the same frequency, are cancelled by a zero each
    unreached = d[~live]
    d, copies = np.unique(d[live], return_counts=True)
    kappa = np.add.reduceat(kappa[live], np.cumsum(copies) - copies) if len(d) else d
    cancelled = np.concatenate([unreached, np.repeat(d, copies - 1)])
    if rigid:
        d, kappa = np.concatenate([[0.0], d]), np.concatenate([[kappa_0], kappa])
    if len(d) > 1:
        # singular values of diag(d) V: the square roots of the eigenvalues, without squaring the frequencies
        V = _complement(np.sqrt(kappa / kappa.max())[:, None])
        # a power of two for the unit of time, so that no square of a frequency leaves the range of doubles
        unit = _power_of_two(d.max())
        w = np.sort(np.linalg.svd(d[:, None] / unit * V, compute_uv=False))
        w = unit * _refine_between_poles(w, d / unit, kappa / kappa.max())
        cancelled = np.concatenate([cancelled, w])
    w = np.sort(cancelled)
    at_zero = [] if rigid or not len(d) else [0.0]
    return np.concatenate([-w[::-1], at_zero, w])


def many_port_zeros(d: Array, nu: ComplexArray, rigid: Array) -> Array:
    """Imaginary parts of the zeros of several ports."""
    eta = np.sqrt(d)[:, None] * nu
    B = np.concatenate([eta.real, eta.imag, rigid])
    n = len(d)
    V = _complement(B)
    rotated = np.concatenate([d[:, None] * V[n : 2 * n], -d[:, None] * V[:n], 0 * V[2 * n :]])
    K = V.T @ rotated
    w, _, _ = skew_normal_form(0.5 * (K - K.T))
    return np.sort(np.concatenate([-w, w, np.zeros(len(K) - 2 * len(w))]))


def _complement(B: Array) -> Array:
    """Orthonormal basis of the complement of the columns of `B`."""
    U, sigma, _ = np.linalg.svd(B)
    rank = int(np.sum(sigma > max(B.shape) * _checks.EPS * sigma.max(initial=0.0)))
    return U[:, rank:]


def _power_of_two(x: float) -> float:
    """Power of two near `x > 0`, so that scaling by it rounds nothing; 1 for `x = 0`."""
    return float(2.0 ** np.floor(np.log2(x))) if x > 0 else 1.0


def _refine_between_poles(w: Array, d: Array, kappa: Array) -> Array:
    """Safeguarded Newton steps on `sum kappa / (d^2 - w^2) = 0`, each root kept between its poles."""
    low, high = d[:-1], d[1:]
    w = np.where((w > low) & (w < high), w, 0.5 * (low + high))
    poles = low, high
    for _ in range(100):
        gap = (d - w[:, None]) * (d + w[:, None])
        with np.errstate(divide="ignore", invalid="ignore"):
            terms = kappa / gap
            value = terms.sum(axis=1)
            newton = w - value / ((terms / gap).sum(axis=1) * 2 * w)
        low, high = np.where(value < 0, w, low), np.where(value < 0, high, w)
        new = np.where((newton > low) & (newton < high), newton, 0.5 * (low + high))
        # at a root rounding may lead a step out of the bracket; next to a pole a short step tells nothing
        close = _checks.EPS * w
        found = (np.abs(newton - w) <= 2 * close) & (np.minimum(w - poles[0], poles[1] - w) > 64 * close)
        new = np.where(found, w, new)
        if np.all(np.abs(new - w) <= 2 * _checks.EPS * w):
            break
        w = new
    return w

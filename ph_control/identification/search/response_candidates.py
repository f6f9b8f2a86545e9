"""Where in a frequency response one more mode explains most: local fits of damped modes between all its points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ..regression.frequency_rows import FreeResponse, FrequencyRows, differentiated
from ..regression.tuning import TUNING
from .screening import highest_peaks

_WINDOW = 8  # points on either side of a candidate
_PLACES = np.array([0.02, 0.125, 0.375, 0.625, 0.875, 0.98])  # candidates between two points
_WIDTHS = np.array([0.003, 0.1, 1.0, 4.0])  # half-widths of a peak that are tried, in distances of points
_BATCH = 1024
_EVERYWHERE = 2000  # points up to which all intervals have candidates; above, those about which most is left
_PEAKS = 300
_COMPARED = 40


def ranked_candidates(experiments: Sequence[FrequencyRows], left: Sequence[ComplexArray]) -> tuple[Array, Array]:
    """Frequencies by what one more mode there explains of what is left of each response, and how much; O(points)."""
    edges = np.unique(np.concatenate([one.omega for one in experiments]))
    steps = np.diff(edges)
    # points that several responses share up to rounding are one
    apart = steps > 1e-9 * edges[1:]
    edges, steps = edges[:-1][apart], steps[apart]
    if len(edges) > _EVERYWHERE:
        near = _peaking(experiments, left, edges)
        edges, steps = edges[near], steps[near]
    d = (edges[:, None] + _PLACES * steps[:, None]).ravel()
    width = np.repeat(steps, len(_PLACES))
    gains = np.zeros((len(_WIDTHS), len(d)))
    for one, residual in zip(experiments, left, strict=True):
        gains += _explained(one, residual, d, width)
    gain = gains.max(axis=0, initial=0.0)
    best = highest_peaks(gain, _COMPARED)
    return d[best], gain[best]


def _peaking(experiments: Sequence[FrequencyRows], left: Sequence[ComplexArray], edges: Array) -> Indices:
    """Intervals about the points at which most is left."""
    chosen = []
    for one, residual in zip(experiments, left, strict=True):
        power = np.convolve(np.abs(residual) ** 2, np.ones(3), mode="same")
        chosen.append(np.searchsorted(edges, one.omega[highest_peaks(power, _PEAKS)]))
    about = np.concatenate(chosen)[:, None] + np.arange(-2, 2)
    return np.unique(np.clip(about, 0, len(edges) - 1))


def _explained(rows: FrequencyRows, residual: ComplexArray, d: Array, width: Array) -> Array:
    """Energy that one damped mode of each width explains in the points about it, beyond a straight line."""
    points = len(rows.omega)
    count = min(2 * _WINDOW + 1, points)
    gains = np.zeros((len(_WIDTHS), len(d)))
    if count < 3:
        return gains
    for first in range(0, len(d), _BATCH):
        part = slice(first, first + _BATCH)
        start = np.clip(np.searchsorted(rows.omega, d[part]) - count // 2, 0, points - count)
        place = start[:, None] + np.arange(count)
        omega, scale = rows.omega[place], rows.scale[place]
        span = np.where(omega[:, -1:] > omega[:, :1], omega[:, -1:] - omega[:, :1], 1.0)
        basis = _orthonormal(scale, (omega - d[part][:, None]) / span * scale)
        target = _without(residual[place], basis)
        for k, factor in enumerate(_WIDTHS):
            mode = _without(
                _modal(d[part][:, None], factor * width[part][:, None], omega, rows.quantity) * scale, basis
            )
            energy = np.sum(np.abs(mode) ** 2, axis=1)
            overlap = np.sum((mode.conj() * target).real, axis=1)
            gains[k, part] = overlap**2 / np.where(energy > 0, energy * (1 + TUNING.ridge), 1.0)
    return gains


def _modal(d: Array, decay: Array, omega: Array, quantity: str) -> ComplexArray:
    gap = (d - omega) * (d + omega) + 2j * decay * omega
    return np.asarray(differentiated(omega, quantity) / np.where(gap == 0, np.finfo(float).tiny, gap))


def _orthonormal(constant: Array, line: Array) -> list[Array]:
    """Rows of unit length that span a constant and a line, in each row."""
    first = constant / np.linalg.norm(constant, axis=1, keepdims=True)
    second = line - np.sum(first * line, axis=1, keepdims=True) * first
    length = np.linalg.norm(second, axis=1, keepdims=True)
    return [first, second / np.where(length > 0, length, 1.0)]


def _without(values: ComplexArray, basis: Sequence[Array]) -> ComplexArray:
    for one in basis:
        values = values - np.sum(one * values, axis=1, keepdims=True) * one
    return values


# --- vector fitting --------------------------------------------------------------------------------------------


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

"""The search for modes in measured frequency responses.

Real plants have some damping, and responses have few points on a peak.  Modes are therefore looked for with a damping
and a residue of either sign of their own, on a smooth background; what the lossless model makes of these frequencies is
judged by the loss.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .frequency_rows import FrequencyRows
from .search import Report, Step, mode_energies, more_than_noise
from .solver import Problem, refine

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_WINDOW = 8  # points on either side of a candidate
_PLACES = np.array([0.125, 0.375, 0.625, 0.875])  # candidates between two points
_WIDTHS = np.array([0.1, 1.0, 4.0])  # half-widths of a peak that are tried, in distances of points
_BATCH = 4096
_RIDGE = 1e-9
_COMPARED = 40


class ResponseSearch:
    """Search in frequency responses."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._rows = [cast(FrequencyRows, one) for one in problem.experiments]
        self._decay = np.zeros(0)

    @property
    def affords_batches(self) -> bool:
        """Modes join one at a time."""
        return False

    def unconvinced(self, step: Step) -> bool:
        """Whether what is left shows a mode that noise alone would hardly show anywhere."""
        return more_than_noise(self.problem, step)

    def step(self, d: Array, rtol: float, report: Report | None = None) -> Step:
        """Refine modes from a start and look for more."""
        decay = np.concatenate([self._decay, np.full(max(0, len(d) - len(self._decay)), self.problem.bin)])[: len(d)]
        d, self._decay = self._damped(d, decay)
        candidates, gains = self._ranked(self._left(d, self._decay))
        end = refine(self.problem, d, rtol=rtol, progress=report)
        at = end.projection
        # the path goes on from the damped frequencies: damping, not noise, is what moves those of the lossless model
        return Step(
            d, at.loss, end.iterations, end.converged, candidates, gains, ~at.free, mode_energies(at), end.interrupted
        )

    # --- damped modes ----------------------------------------------------------------------------------------------

    def _damped(self, d: Array, decay: Array) -> tuple[Array, Array]:
        """Frequencies and decay rates of the best modes with damping, by non-linear least squares."""
        if not len(d):
            return d, decay
        scale = self.problem.bin
        ceiling = self.problem.ceiling

        def unpacked(x: Array) -> tuple[Array, Array]:
            return d + scale * x[: len(d)], scale * np.abs(x[len(d) :])

        def residual(x: Array) -> Array:
            left = self._left(*unpacked(x))
            return np.concatenate([np.concatenate([one.real, one.imag]) for one in left])

        start = np.concatenate([np.zeros(len(d)), decay / scale])
        found = least_squares(residual, start, method="trf", x_scale=1.0, max_nfev=30 + 5 * len(d))
        moved, damping = unpacked(found.x)
        return np.clip(moved, 1e-3 * scale, ceiling), damping

    def _left(self, d: Array, decay: Array) -> list[ComplexArray]:
        """Scaled responses less the best damped modes, their residues shared by all responses, and backgrounds."""
        n = len(d)
        blocks, targets = [], []
        for k, one in enumerate(self._rows):
            columns = np.concatenate([_columns(d, decay, one), _background(one, k, len(self._rows))])
            columns = columns * one.scale
            target = one.record.response[one.record.observed] * one.scale
            blocks.append(np.concatenate([columns.real, columns.imag], axis=1))
            targets.append(np.concatenate([target.real, target.imag]))
        A, y = np.concatenate(blocks, axis=1).T, np.concatenate(targets)
        lengths = np.linalg.norm(A, axis=0)
        A = A / np.where(lengths > 0, lengths, 1.0)
        left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0] if n or A.shape[1] else y
        parts, start = [], 0
        for one in self._rows:
            points = len(one.omega)
            piece = left[start : start + 2 * points]
            parts.append(piece[:points] + 1j * piece[points:])
            start += 2 * points
        return parts

    # --- candidates ------------------------------------------------------------------------------------------------

    def _ranked(self, left: list[ComplexArray]) -> tuple[Array, Array]:
        """Frequencies at which one more mode explains most, and how much."""
        longest = max(self._rows, key=lambda one: len(one.omega))
        edges = np.unique(longest.omega)
        d = (edges[:-1, None] + _PLACES * np.diff(edges)[:, None]).ravel()
        width = np.repeat(np.diff(edges), len(_PLACES))
        gains = np.zeros(len(d))
        for one, residual in zip(self._rows, left, strict=True):
            gains += np.max([_explained(one, residual, d, factor * width) for factor in _WIDTHS], axis=0)
        padded = np.concatenate([[-np.inf], gains, [-np.inf]])
        peaks = np.flatnonzero((gains >= padded[:-2]) & (gains >= padded[2:]))
        best = peaks[np.argsort(-gains[peaks], kind="stable")][:_COMPARED]
        return d[best], gains[best]


def _columns(d: Array, decay: Array, rows: FrequencyRows) -> ComplexArray:
    """Response of damped modes of unit residue, (n, K)."""
    return _modal(d[:, None], decay[:, None], rows.omega, rows.quantity)


def _modal(d: Array, decay: Array, omega: Array, quantity: str) -> ComplexArray:
    factor = {"velocity": 1j * omega, "displacement": 1.0 + 0j * omega, "acceleration": -(omega**2) + 0j}[quantity]
    gap = (d - omega) * (d + omega) + 2j * decay * omega
    return np.asarray(factor / np.where(gap == 0, 1e-300, gap))


def _background(rows: FrequencyRows, place: int, count: int) -> ComplexArray:
    """What modes outside the band leave: in each response a constant, real and imaginary."""
    found = np.zeros((2 * count, len(rows.omega)), complex)
    found[2 * place], found[2 * place + 1] = 1.0, 1j
    return found


def _explained(rows: FrequencyRows, residual: ComplexArray, d: Array, decay: Array) -> Array:
    """Energy that one damped mode explains in the points about it, beyond a straight line."""
    points = len(rows.omega)
    width = min(2 * _WINDOW + 1, points)
    gains = []
    for first in range(0, len(d), _BATCH):
        part = slice(first, first + _BATCH)
        centre = np.searchsorted(rows.omega, d[part])
        start = np.clip(centre - width // 2, 0, points - width)
        place = start[:, None] + np.arange(width)
        omega, scale = rows.omega[place], rows.scale[place]
        mode = _modal(d[part][:, None], decay[part][:, None], omega, rows.quantity) * scale
        line = (omega - d[part][:, None]) / (omega[:, -1:] - omega[:, :1]) * scale
        mode, target = _without_line(mode, scale, line), _without_line(residual[place], scale, line)
        energy = np.sum(np.abs(mode) ** 2, axis=1)
        overlap = np.sum((mode.conj() * target).real, axis=1)
        gains.append(overlap**2 / np.where(energy > 0, energy * (1 + _RIDGE), 1.0))
    return np.concatenate(gains) if gains else np.zeros(0)


def _without_line(values: ComplexArray, constant: Array, line: Array) -> ComplexArray:
    """Values less their best straight line, complex, in each row."""
    basis = np.stack([constant, line], axis=2)
    gram = basis.transpose(0, 2, 1) @ basis
    trace = np.trace(gram, axis1=1, axis2=2)
    solved = np.linalg.solve(
        gram + (_RIDGE * trace)[:, None, None] * np.eye(2), (basis.transpose(0, 2, 1) @ values[:, :, None])
    )
    return np.asarray(values - (basis @ solved)[:, :, 0])

"""The search for modes in measured frequency responses.

Real plants have some damping, and responses have few points on a peak.  Modes are therefore looked for with a damping
and a residue of any phase of their own, on a smooth background; what the lossless model makes of these frequencies is
judged by the loss.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ..regression.free import refine_free
from ..regression.frequency_rows import FreeResponse, FrequencyRows, differentiated
from ..regression.tuning import TUNING
from ..regression.variable_projection import Problem, refine
from ..uncertainty.residual_data import without_peaks
from ..uncertainty.residual_tests import ljung_box
from .free_search import FreeModel, Responses
from .screening import highest_peaks
from .steps import Report, Search, Step

_WINDOW = 8  # points on either side of a candidate
_PLACES = np.array([0.02, 0.125, 0.375, 0.625, 0.875, 0.98])  # candidates between two points
_WIDTHS = np.array([0.003, 0.1, 1.0, 4.0])  # half-widths of a peak that are tried, in distances of points
_BATCH = 1024
_EVERYWHERE = 2000  # points up to which all intervals have candidates; above, those about which most is left
_PEAKS = 300
_COMPARED = 40


class ResponseSearch(Search):
    """Search in frequency responses."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.experiments = [one for one in problem.experiments if isinstance(one, FrequencyRows)]
        self.damped_search = Responses([FreeResponse.of(one) for one in self.experiments])
        self.power = sum(float(np.sum(np.abs(one.target) ** 2)) for one in self.experiments)
        self._poles: dict[float, complex] = {}

    def damped(self, d: Array) -> FreeModel:
        """The best damped modes near some frequencies, from the poles that were found there before."""
        p = np.array([self._poles.get(one, complex(np.nan, one)) for one in d.tolist()], complex)
        found = self.damped_search.model(refine_free(lambda _: self.damped_search.data, p, self.damped_search.region))
        self._poles.update(zip(found.at.d.tolist(), found.p.tolist(), strict=True))
        return found

    def _is_white(self, step: FreeModel) -> bool:
        """Whether what damped modes leave is noise from point to point, but for a few that outweigh all others."""
        parts = [without_peaks(part) for (one,) in step.left for part in (one.real, one.imag)]
        return ljung_box(parts, TUNING.lags) >= TUNING.white

    def _refined(self, d: Array, rtol: float, report: Report | None) -> Step:
        damped = self.damped(d)
        candidates, gains = ranked_candidates(self.experiments, [one for (one,) in damped.left])
        end = refine(self.problem, damped.at.d, rtol=rtol, progress=report)
        at = end.projection
        # the path goes on from the damped frequencies: damping, not noise, is what moves those of the lossless model
        return Step(
            damped.at.d, at.loss, end.iterations, end.converged, candidates, gains, ~at.free, at.energies,
            damped.loss > TUNING.much * self.power and not self._is_white(damped),
        )  # fmt: skip


# --- candidates ------------------------------------------------------------------------------------------------------


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

"""Forces that nobody measured and that move a plant more than its inputs do: modes by the outputs alone come first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data.channels import Recording
from ..data.parts import is_long
from ..regression.sections import Sections
from ..regression.time_rows import FreeRecord
from ..search.fitted_modes import FreeFit
from ..uncertainty.residual_tests import is_white
from .ambient import AmbientFit, ambient_fit
from .forces import beside_known_forces
from .noise_sections import NoiseSections

_MOSTLY = 0.5  # of the squares of outputs: less than that of them inputs explain where forces prevail


def beside_strong_forces(free: FreeFit, order: int | str, max_order: int) -> FreeFit:
    """The fit with the modes that outputs show alone, where inputs explain less than half of these.

    What inputs do is then far below the noise, and a search for it ends early or takes modes for what forces do.

    Parameters
    ----------
    free : FreeFit
        Fit of a search that takes noise for white, or for that of each output.
    order : int or 'auto'
        Number of modes.
    max_order : int
        Largest number of modes.
    """
    recordings = [data for data in free.channels if isinstance(data, Recording)]
    if len(recordings) < len(free.channels) or free.interrupted or free.rounding or is_long(recordings):
        return free
    if any(not data.observed.all() or data.dt != recordings[0].dt for data in recordings):
        return free
    # one that was found beside forces may be wrong as well
    if not _is_mostly_noise(free) or (free.beside is None and is_white(free.projection)):
        return free
    fit = ambient_fit(recordings, order=order if isinstance(order, int) else None, max_order=max_order)
    if fit is not None and fit.minimum.interrupted:
        return replace(free, interrupted=True)
    if fit is None or not np.any(fit.evaluation.point.poles.imag > 0):
        return free
    again = beside_known_forces(free, noise_of(fit, recordings[0].dt))
    if again.interrupted:
        return again
    return again if again is not free and again.criteria.bic < free.criteria.bic else free


def noise_of(fit: AmbientFit, step: float) -> NoiseSections:
    """The noise of a fit to outputs alone, in units of the data and of time."""
    noise = fit.evaluation.point.noise
    x, k = noise.sections.x, len(noise.sections.decay)
    sections = Sections.from_coordinates(np.concatenate([x[:k] / step, x[k : 2 * k] / step**2, x[2 * k :] / step]))
    return NoiseSections(sections, step, noise.references / step, fit.scales[:, None] * noise.C, noise.K / fit.scales)


def _is_mostly_noise(free: FreeFit) -> bool:
    """Whether inputs explain less than half of the squares of the outputs of recordings."""
    explained, outputs = 0.0, 0
    projection = free.projection if free.measured is None else free.measured
    if not projection.inputs:
        return False
    for rows, predicted in zip(projection.experiments, projection.predictions(), strict=True):
        if not isinstance(rows, FreeRecord):
            return False
        y = rows.measured - rows.measured.mean(axis=1, keepdims=True)
        size = np.maximum(np.sum(y**2, axis=1), np.finfo(float).tiny)
        explained += float(np.sum(1 - np.sum((rows.measured - predicted) ** 2, axis=1) / size))
        outputs += len(y)
    return explained < _MOSTLY * outputs

"""Experiments of different quality: how large the noise of each is beside that of the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..._types import Array, Indices
from ..data.channels import Recording
from ..data.time_record import is_long
from ..regression.time_rows import FreeRecord
from ..regression.tuning import TUNING
from ..search.fitted_modes import FreeFit

_ROUNDS = 20  # of the noise of outputs and of experiments in turn
_SETTLED = 1e-3  # relative change
_EQUAL = 0.02  # relative difference of units beyond which a fit is repeated


def experiments_of(rows: Sequence[Any], channels: Sequence[Any]) -> Indices:
    """Which experiment each of some rows is from: experiments have rows for the outputs that they observe."""
    ends = np.cumsum([int(channel.observed.any(axis=-1).sum()) for channel in channels])
    starts = np.cumsum([0, *(len(record.outputs) for record in rows)])[:-1]
    return np.searchsorted(ends, starts, side="right")


def noise_units(fit: FreeFit) -> tuple[Array, float]:
    """Standard deviation of the noise of each experiment, and the log-likelihood beside the same noise in all.

    The residuals of output o in experiment e have the variance `(unit_e sigma_o)^2`, both by maximum likelihood.  The
    geometric mean of the units, over all samples, is 1.  The gain is less what the criterion charges for them.
    """
    channels = fit.channels
    units = np.ones(len(channels))
    if len(channels) == 1 or not isinstance(channels[0], Recording) or fit.rounding or fit.interrupted:
        return units, 0.0
    squares, counts = _squares(fit)
    seen, total = counts.sum(axis=1), counts.sum()
    if np.any(seen == 0) or np.any(squares.sum(axis=1) == 0):
        return units, 0.0

    def variances() -> Array:
        return np.sum(squares / units[:, None] ** 2, axis=0) / np.maximum(counts.sum(axis=0), 1)

    def loglik() -> float:
        known = counts.sum(axis=0) > 0
        return -0.5 * float(counts.sum(axis=0)[known] @ np.log(variances()[known])) - float(seen @ np.log(units))

    alike = loglik()
    for _ in range(_ROUNDS):
        before = units
        units = np.sqrt(np.sum(squares / np.maximum(variances(), np.finfo(float).tiny), axis=1) / seen)
        units = units / np.exp(seen @ np.log(units) / total)
        if np.max(np.abs(units / before - 1)) < _SETTLED:
            break
    return units, loglik() - alike - 0.5 * (len(units) - 1) * float(np.log(total))


def _squares(fit: FreeFit) -> tuple[Array, Array]:
    """Squares of what a fit leaves of each experiment and output, in units of the data, and of how many samples.

    Beside forces that is what the past does not foretell.
    """
    channels, size = fit.channels, (len(fit.channels), len(fit.scales))
    squares, counts = np.zeros(size), np.zeros(size)
    if fit.beside is not None:
        for place, errors in enumerate(fit.beside.errors):
            squares[place] = channels[place].unit ** 2 * np.sum(errors**2, axis=1)
            counts[place] = errors.shape[1]
        return squares, counts
    places = experiments_of(fit.projection.experiments, channels)
    rows = zip(fit.projection.experiments, fit.projection.predictions(), places.tolist(), strict=True)
    for record, predicted, place in rows:
        assert isinstance(record, FreeRecord)
        residuals = record.residuals(predicted)
        squares[place, record.outputs] += channels[place].unit ** 2 * np.sum(residuals**2, axis=1)
        counts[place, record.outputs] += record.samples
    return squares, counts


def in_equal_noise(channels: Sequence[Any], fit: FreeFit) -> tuple[Recording, ...] | None:
    """Recordings in units in which their noise is the same, if that is likelier; None where it is as they are."""
    if is_long(channels):
        return None
    units, gain = noise_units(fit)
    if gain <= TUNING.sure or all(
        abs(u / channel.unit - 1) < _EQUAL for u, channel in zip(units, channels, strict=True)
    ):
        return None
    return tuple(channel.adjusted(unit) for channel, unit in zip(channels, units.tolist(), strict=True))

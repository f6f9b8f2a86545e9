"""Residuals of a fit as noise: whether they are white, and which samples no noise explains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..._types import Array, NDArray
from ..data.channels import Recording
from ..data.time_record import Difference, Record, Signal
from ..diagnosis.fitted_directions import directions_of
from ..diagnosis.noise_levels import level_of, outliers, saturation
from ..estimates.estimates import Estimates
from ..regression.prediction import FittedChannels
from ..regression.tuning import TUNING
from ..search.findings import Cause, Finding
from ..uncertainty.residual_tests import ljung_box, without_peaks

_COUNTED = 400_000  # samples times unknowns up to which these are felt by the test of whiteness, and cheap


def whiteness_of(estimates: Estimates) -> float:
    """p-value of white residuals, 1 of those that are rounding; beside forces, of the prediction errors."""
    if estimates.free.beside is not None:
        return float(estimates.free.beside.whiteness)
    return 1.0 if estimates.rounding else _whiteness(estimates)


def _whiteness(estimates: Estimates) -> float:
    """p-value of white residuals; of one input and output with what was fitted, which is missing from them.

    Short records feel that, and are tested again if they look coloured.
    """
    channels = estimates.free.channels
    rows = [row for pair in zip(estimates.experiments, channels, strict=True) for row in _rows(*pair)]
    p = ljung_box(rows, TUNING.lags)
    single = estimates.shown if estimates.is_single else ()
    samples = sum(experiment.record.samples for experiment in single)
    if not single or p >= TUNING.surely_white or samples * len(estimates.covariance) > _COUNTED:
        return p
    model = estimates.model
    directions = [directions_of(experiment, model) for experiment in single]

    def in_rows(columns: Sequence[NDArray[Any]]) -> list[Array]:
        triples = zip(single, channels, columns, strict=True)
        return [part for experiment, *values in triples for part in _in_rows(experiment.record, *values)]

    shared, local = [each.shared for each in directions], [each.local for each in directions]
    return ljung_box(rows, TUNING.lags, shared=in_rows(shared), local=in_rows(local))


def _rows(experiment: FittedChannels, channel: Any) -> list[Signal]:
    """Real residuals of each output, or real and imaginary parts of those of each entry of a response.

    Of a response without its peaks: a few points at a resonance outweigh all others, and alone look white.
    """
    residuals = list(_residuals(experiment, channel).values())
    if isinstance(experiment.record, Recording):
        return residuals
    return [without_peaks(part) for row in residuals for part in (row[:].real, row[:].imag)]


def _residuals(experiment: FittedChannels, channel: Any) -> dict[str, Signal]:
    """Residuals by label of the output, or of the entry of a response, where they are weighted; of those measured.

    Where the noise of the `channel` changes they are in units of its level.
    """
    outputs, inputs = experiment.record.output_labels, experiment.record.input_labels
    if isinstance(experiment.record, Recording):
        seen = np.flatnonzero(experiment.record.observed.any(axis=1)).tolist()
        if (level := level_of(channel)) is not None:
            return {outputs[k]: experiment.residuals[k] / level[k] for k in seen}
        return {outputs[k]: Difference(experiment.measured[k], experiment.predicted[k]) for k in seen}
    residuals = experiment.record.in_noise(experiment.residuals)
    entries = [
        (f"{o}:{i}", row)
        for o, rows in zip(outputs, residuals, strict=True)
        for i, row in zip(inputs, rows, strict=True)
    ]
    return {label: row for label, row in entries if not np.isnan(row).all()}


def _in_rows(record: Any, channel: Any, values: NDArray[Any]) -> list[Array]:
    """Directions (T, k) of a record as its residuals are; of a response their real and imaginary parts, weighted."""
    if isinstance(record, Record):
        level = level_of(channel)
        return [values if level is None else values / level[0][:, None]]
    if record.errors is None:
        scaled = values * np.sqrt(record.weights)[:, None]
    else:
        scaled = np.nan_to_num(record.errors.whitened(0, 0, np.where(record.observed, values.T, np.nan))).T
    return [scaled.real, scaled.imag]


def saturated(experiments: Sequence[FittedChannels]) -> list[Finding]:
    """Outputs of recordings that stay at an end of their range."""
    every = [
        (k, experiment.record) for k, experiment in enumerate(experiments) if isinstance(experiment.record, Recording)
    ]
    ends = [
        (k, name, saturation(row))
        for k, record in every
        for name, row in zip(record.output_labels, record.y, strict=True)
    ]
    return [Finding(Cause.SATURATION, (float(count), *of), 0.0, name, k) for k, name, (count, of) in ends if count]


def outlying(estimates: Estimates) -> list[Finding]:
    """Values that stand out of the noise of all others of their output and experiment."""
    every = [
        (label, k, row) for k, pair in enumerate(zip(estimates.experiments, estimates.free.channels, strict=True))
        for label, row in _residuals(*pair).items()
    ]  # fmt: skip
    pairs = zip(every, outliers([row for *_, row in every], estimates.likelihood.spare), strict=True)
    return [Finding(Cause.OUTLIERS, tuple(map(float, far)), 0.0, label, k) for (label, k, _), far in pairs if far]

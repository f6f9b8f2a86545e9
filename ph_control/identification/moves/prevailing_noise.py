"""Noise that is far from white, whose model comes before any search: forces that nobody measured, or colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._types import ComplexArray
from ..regression.free import FreeProjection
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import Experiments
from ..search.fitted_modes import FreeFit, are_broad, count_modes
from ..search.predictor_states import likeliest, predictors_of, signals_of
from .assumptions import Search
from .delays import errors_leave_traces, leaves_traces

_ROWS = 100  # of a covariance that only has to tell whether forces prevail
_REAL = 4  # real poles at most beside modes
_CLOSE = 3  # models that are looked at
_DECAYS = 10.0  # time constants of the slowest pole that records last
_PREVAILING = 0.1  # logarithm of the ratio of variances for each output


def in_prevailing_noise(channels: Experiments, search: Search) -> tuple[FreeFit, FreeFit] | None:
    """Fit modes in noise that is far from white: beside forces that nobody measured, or coloured noise of each output.

    White noise tells little of the poles of such records, and a search in it takes modes for what the noise does.  So
    the poles to begin with are those of a predictor.

    Returns
    -------
    tuple of FreeFit or None
        The fit in noise of each output, and that beside forces: the same where noise is coloured.  None where no such
        noise prevails, or where the fit leaves traces.
    """
    given = search.assumptions
    if given.white or given.delay is not None:
        return None
    path = search.path(channels)
    records = [record for record in path.plain.data if isinstance(record, FreeRecord)]
    orders = (0 if search.automatic else search.most), search.most
    p = poles_of_predictor(records, len(path.counts), orders) if records else None
    if p is None:
        return None
    fit = search.from_poles(path, channels, p)
    forced = fit if fit.interrupted else given.beside(fit, orders=orders)
    if forced.interrupted:
        return fit, forced
    if forced.own_noise and search.automatic:
        path.best = None
        path.whiten(forced.own_noise, path.power)
        coloured = search.along(path, channels, p)
        remains = not coloured.interrupted and (not coloured.states or leaves_traces(coloured.projection))
        return None if remains else (coloured, coloured)
    return None if forced.beside is None or errors_leave_traces(forced) else (fit, forced)


def poles_of_predictor(records: Sequence[FreeRecord], outputs: int, orders: tuple[int, int]) -> ComplexArray | None:
    """Return poles of the likeliest predictor, where it foretells far more than inputs alone do from these poles.

    Parameters
    ----------
    records : sequence of FreeRecord
        Records without delays.
    outputs : int
        Number of outputs.
    orders : pair of int
        Smallest and largest number of modes.
    """
    signals = signals_of(records, outputs)
    if signals is None:
        return None
    samples = sum(each.shape[1] for each in signals)
    for _, size, predictor in likeliest(predictors_of(signals, outputs, _ROWS), samples, 2 * orders[1] + _REAL)[
        :_CLOSE
    ]:
        values = np.linalg.eigvals(predictor.model(size)[0])
        values = values[values.imag >= 0].astype(complex)
        if np.any((values.imag == 0) & (values.real <= 0)) or np.any(np.abs(values) >= 1):
            continue
        p = np.log(values) / records[0].hold.h
        if not orders[0] <= count_modes(p) <= orders[1]:
            continue
        # lags and slow noise are told apart by a search
        if not np.any((p.imag > 0) & ~are_broad(p)) or np.max(p.real) * records[0].hold.h * samples > -_DECAYS:
            return None
        projection = FreeProjection(records, p)
        residuals = [
            rows.residuals(predicted) for rows, predicted in zip(records, projection.predictions(), strict=True)
        ]
        covariance = sum(each @ each.T for each in residuals) / samples
        gain = float(np.linalg.slogdet(covariance)[1] - predictor.errors()[size]) / outputs
        return p if gain > _PREVAILING else None
    return None

"""Forces that nobody measured and that move a plant far more than its sensors have noise, before any search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._types import ComplexArray
from ..growth.ending import end_of_search
from ..regression.free import FreeProjection
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import Experiments
from ..search.fitted_modes import FreeFit, count_modes
from ..search.predictor_states import likeliest, predictors_of, signals_of
from .assumptions import Search
from .delays import errors_leave_traces
from .drifts import with_constants

_ROWS = 100  # of a covariance that only has to tell whether forces prevail
_REAL = 4  # real poles at most beside modes
_CLOSE = 3  # models that are looked at
_DECAYS = 10.0  # time constants of the slowest pole that records last
_PREVAILING = 0.1  # logarithm of the ratio of variances for each output


def in_prevailing_forces(channels: Experiments, search: Search) -> FreeFit | None:
    """Fit modes beside forces that nobody measured, where these move the plant far more than sensors have noise.

    White noise tells little of the poles of such records, and a search in it takes modes for what the forces do.  So
    the poles are those of a predictor.  None where no forces prevail, or where the fit beside them leaves traces.
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
    path.best = path.reweighted(path.model(p))
    fit = end_of_search(path, p, count_modes(p), False, channels, either_hold=search.held is None)
    forced = fit if fit.interrupted else given.beside(fit, orders=orders)
    if forced.interrupted or forced.beside is None or errors_leave_traces(forced):
        return None
    return with_constants(forced) if given.drifting else forced


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
        if not orders[0] <= count_modes(p) <= orders[1] or not len(p):
            continue
        if np.max(p.real) * records[0].hold.h * samples > -_DECAYS:
            return None
        projection = FreeProjection(records, p)
        residuals = [
            rows.residuals(predicted) for rows, predicted in zip(records, projection.predictions(), strict=True)
        ]
        covariance = sum(each @ each.T for each in residuals) / samples
        gain = float(np.linalg.slogdet(covariance)[1] - predictor.errors()[size]) / outputs
        return p if gain > _PREVAILING else None
    return None

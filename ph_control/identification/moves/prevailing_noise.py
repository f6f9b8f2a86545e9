"""Noise that is far from white, whose model comes before any search: forces that nobody measured, or colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._types import ComplexArray
from ..regression.free import FreeProjection
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import Experiments
from ..search.criteria import Orders
from ..search.fitted_modes import FreeFit, are_broad
from ..search.predictor_states import likeliest, predictors_of, signals_of
from .assumptions import Search
from .delays import errors_leave_traces, leaves_traces

_SAMPLES = 1500  # of a record whose errors would show what is missing
_ROWS = 100  # of a covariance that only has to tell whether forces prevail
_CLOSE = 3  # models that are looked at
_DECAYS = 10.0  # time constants of the slowest mode that records last
_ROUNDING = 18.0  # logarithm of the ratio of variances for each output: what is left is rounding
_PREVAILING = 0.1  # logarithm of the ratio of variances for each output


def in_prevailing_noise(channels: Experiments, search: Search) -> tuple[FreeFit, FreeFit] | None:
    """Fit modes in noise that is far from white: beside forces that nobody measured, or coloured noise of each output.

    White noise tells little of the poles of such records, and a search in it takes modes for what the noise does.  So
    the poles to begin with are those of a predictor.

    Returns
    -------
    tuple of FreeFit or None
        The fit in noise of each output, and that beside forces: the same where noise is coloured.  None where no such
        noise prevails, records are short, or the fit leaves traces.
    """
    given = search.assumptions
    if given.white or given.delay is not None:
        return None
    path = search.path(channels)
    records = [record for record in path.plain.data if isinstance(record, FreeRecord)]
    orders = search.orders
    foretold = likely_poles(records, len(path.counts), orders) if records else None
    if foretold is None:
        return None
    p, bic = foretold
    fit = search.from_poles(path, channels, p, bic)
    if fit is None:
        return None
    forced = fit if fit.interrupted else given.beside(fit, orders=orders)
    if forced.interrupted:
        return fit, forced
    if forced.beside is None and forced.own_noise and search.automatic:
        path.best = None
        path.whiten(forced.own_noise, path.power)
        coloured = search.along(path, channels, p)
        stands = coloured.interrupted or (coloured.states and not leaves_traces(coloured.projection))
        return (coloured, coloured) if stands else None
    stands = forced.beside is not None and not errors_leave_traces(forced)
    return (fit, forced) if stands else None


def likely_poles(records: Sequence[FreeRecord], outputs: int, orders: Orders) -> tuple[ComplexArray, float] | None:
    """Return the poles of the likeliest predictor, where it foretells far more than inputs alone do from these poles.

    Parameters
    ----------
    records : sequence of FreeRecord
        Records without delays.
    outputs : int
        Number of outputs.
    orders : Orders
        Numbers of poles.

    Returns
    -------
    tuple of ndarray and float or None
        Poles of imaginary part 0 or more, and the smallest BIC of all predictors.
    """
    signals = signals_of(records, outputs)
    if signals is None:
        return None
    samples = sum(each.shape[1] for each in signals)
    if samples < _SAMPLES:
        return None
    ranked = likeliest(predictors_of(signals, outputs, _ROWS), samples, orders.states)
    for _, size, predictor in ranked[:_CLOSE]:
        A, errors = predictor.model(size)[0], predictor.errors
        if not np.isfinite(A).all() or errors[0] - errors[size] > _ROUNDING * outputs:
            return None
        values: ComplexArray = np.asarray(np.linalg.eigvals(A), complex)
        p: ComplexArray = np.asarray(np.log(values[orders.among(values)]) / records[0].hold.h, complex)
        if not orders.admit(p):
            continue
        # lags and slow noise are told apart by a search
        peaks = p[(p.imag > 0) & ~are_broad(p)]
        if not len(peaks) or np.max(peaks.real) * records[0].hold.h * samples > -_DECAYS:
            return None
        projection = FreeProjection(records, p)
        residuals = [
            rows.residuals(predicted) for rows, predicted in zip(records, projection.predictions(), strict=True)
        ]
        covariance = sum(each @ each.T for each in residuals) / samples
        gain = float(np.linalg.slogdet(covariance)[1] - errors[size]) / outputs
        return (p, ranked[0][0]) if gain > _PREVAILING else None
    return None

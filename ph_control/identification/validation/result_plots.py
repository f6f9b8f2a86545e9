"""Pictures of what validation found, as functions: each draws what the object's own `plot` does."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np

from ..._options import Criterion
from ...exceptions import StructureError
from ...plotting.validation_plot import channel_correlations, residual_panels_plot
from ..fit.pem_result import PEMResult
from ..growth.order_selection import OrderSelection
from ..regression.prediction import chosen_experiment
from .comparison import Comparison
from .residual_analysis import ResidualAnalysis

_CHANNELS = 12  # of one picture


def compare_plot(comparison: Comparison, experiment: int = 0, **kwargs: Any) -> ct.ControlPlot:
    """Outputs of several models over the measured one, their errors below, and a few periods enlarged.

    Parameters
    ----------
    comparison : Comparison
        What `compare` gives.
    experiment : int
        Which of several experiments, counted from 0.
    **kwargs
        Labels, units, `ax`, and `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`, as in `Comparison.plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2, 1) or (3, 1); `figure`, `legend`.

    Raises
    ------
    StructureError
        If `comparison` is not a `Comparison`, or there is no such experiment.

    Notes
    -----
    Over frequency magnitude, phase and error are drawn.  Long records are drawn by the extremes of short bins.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> chain, u = phc.frenkel_kontorova(), np.random.default_rng(0).standard_normal(500)
    >>> record = phc.forced_response(chain, 0.1 * np.arange(500), u, intersample="zoh")
    >>> plot = phc.compare_plot(phc.compare(record, chain, phc.modes(1.6, 0.4), labels=["both modes", "one mode"]))
    >>> [text.get_text() for text in plot.legend.get_texts()]
    ['measured', 'both modes (100.00 %)', 'one mode (48.33 %)']
    >>> plt.close(plot.figure)
    """
    return _expected(comparison, Comparison, "compare(data, *models)").plot(experiment, **kwargs)


def residual_plot(analysis: ResidualAnalysis | PEMResult, experiment: int = 0, **kwargs: Any) -> ct.ControlPlot:
    """Autocorrelation of the residuals of a model above their correlation with the input, with bands.

    Parameters
    ----------
    analysis : ResidualAnalysis or PEMResult
        What `residual_analysis` gives, or a fit, of which the residuals of each channel are drawn.
    experiment : int
        Of several responses, the one whose residual is drawn, counted from 0.  Of a fit, the experiment.
    **kwargs
        `ax`, and `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`, as in `ResidualAnalysis.plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2, 1), or (1, 1) for free motions; of a fit a panel for each channel, in rows of
        three; `figure`, `legend`.

    Raises
    ------
    StructureError
        If `analysis` is not a `ResidualAnalysis`, or there is no such experiment.

    Notes
    -----
    Lags outside the band are drawn in another colour.  Of a fit the bands hold white noise with a probability of 99 %,
    at most the first twelve channels are drawn, and residuals of frequency responses are correlated from point to
    point, with their weights.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> rng, chain = np.random.default_rng(0), phc.frenkel_kontorova()
    >>> u = rng.standard_normal(500)
    >>> y = phc.forced_response(chain, 0.1 * np.arange(500), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(500)
    >>> plot = phc.residual_plot(phc.residual_analysis((u, y), chain, dt=0.1))
    >>> [axis.get_xlabel() for axis in plot.axes[:, 0]]
    ['Lag [samples]', 'Lag of the residual behind the input [samples]']
    >>> plt.close(plot.figure)
    """
    if isinstance(analysis, PEMResult):
        return _residuals_of_channels(analysis, experiment, kwargs)
    return _expected(analysis, ResidualAnalysis, "residual_analysis(data, model)").plot(experiment, **kwargs)


def _residuals_of_channels(result: PEMResult, experiment: int, style: dict[str, Any]) -> ct.ControlPlot:
    """Autocorrelation of the residuals of each channel of a fit."""
    experiment_fit = chosen_experiment(result.experiments, experiment)
    record, residuals = experiment_fit.record, np.asarray(experiment_fit.residuals)
    weights = getattr(record, "weights", None)
    if weights is not None:
        residuals = residuals * np.sqrt(weights)
    outputs = record.output_labels
    names = list(outputs)
    if residuals.ndim == 3:
        inputs = record.input_labels
        names = [f"{source} to {sensor}" for sensor in outputs for source in inputs]
    rows = residuals.reshape(-1, residuals.shape[-1])
    panels = channel_correlations(rows[:_CHANNELS], names[:_CHANNELS])
    part = f" ({_CHANNELS} of {len(rows)} channels)" * (len(rows) > _CHANNELS)
    return residual_panels_plot(panels, f"Autocorrelation of the residuals{part}", folded=True, **style)


def order_plot(selection: OrderSelection, criterion: Criterion = "bic", **kwargs: Any) -> ct.ControlPlot:
    """Stabilisation diagram: the natural frequencies of each order, and the criteria beside it.

    Parameters
    ----------
    selection : OrderSelection
        What `order_selection` gives.
    criterion : {'aic', 'aicc', 'bic', 'holdout'}
        Whose choice is marked.
    **kwargs
        `time_unit`, `Hz`, `ax`, and `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`, as in
        `OrderSelection.plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (1, 2), `figure`, `legend`.

    Raises
    ------
    StructureError
        If `selection` is not an `OrderSelection`, or has no such criterion.

    Notes
    -----
    A criterion is drawn above its least value, to a scale that is linear below 10 and logarithmic beyond.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> rng, chain = np.random.default_rng(0), phc.frenkel_kontorova()
    >>> u = rng.standard_normal(500)
    >>> y = phc.forced_response(chain, 0.1 * np.arange(500), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(500)
    >>> plot = phc.order_plot(phc.order_selection((u, y), 3, dt=0.1))
    >>> plot.axes[0, 0].get_ylabel()
    'Order (number of modes)'
    >>> plt.close(plot.figure)
    """
    return _expected(selection, OrderSelection, "order_selection(data, orders)").plot(criterion, **kwargs)


def _expected(given: object, kind: type, call: str) -> Any:
    if not isinstance(given, kind):
        raise StructureError(f"this is a {type(given).__name__}; pass what {call} gives")
    return given

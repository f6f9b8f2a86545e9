"""The picture of a fit: measured and predicted output, what is left, and a part enlarged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import control as ct
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from ..exceptions import StructureError
from .fit_data import FitData, fit_data, percent
from .style import DRAWN, MEASURED, SAMPLES, ZERO, FrameStyle, Look, extremes, labelled, plain, stacked

if TYPE_CHECKING:
    from typing_extensions import Unpack

_PREDICTED: dict[str, Any] = {"color": "C0", "linewidth": 1.0}
_RESIDUAL: dict[str, Any] = {"color": "C3", "linewidth": 0.8}


def fit_plot(
    time: Any,
    measured: ArrayLike | None = None,
    predicted: ArrayLike | None = None,
    *,
    fit_percent: float | None = None,
    time_unit: str | None = None,
    output_label: str | None = None,
    output_unit: str | None = None,
    detail: str | ArrayLike | None = "auto",
    ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Measured and predicted output, the residual below, and a few periods enlarged.

    Parameters
    ----------
    time : array_like, shape (T,), or PEMResult
        Instants, ascending; or the result of a fit alone, for the picture that its `plot` gives.
    measured, predicted : array_like, shape (T,)
        Outputs at these instants; NaN samples are gaps.
    fit_percent : float, optional
        Fit to show in the legend, in percent.
    time_unit : str, optional
        Unit of time, for the label of the axis; by default that of the fitted record, none where it is not known.
    output_label : str, optional
        Name of the output, for the labels; by default "Output", or that of the fitted record.
    output_unit : str, optional
        Its unit, for the labels; by default they have none.
    detail : {'auto'}, or array_like of shape (2,), or None
        Part of the record to enlarge in a panel of its own: from one instant to another, or none.  By default about
        8 periods of the strongest oscillation where the residual is largest, at most a third of the record, if it has
        more than 10 periods or 3000 samples.
    ax : array of matplotlib.axes.Axes, shape (2, 1) or (3, 1), optional
        Axes to draw on, the third for the detail; with two of them there is none.  By default a new figure.
    **style
        `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`, as in `control.time_response_plot`.

    Returns
    -------
    control.ControlPlot
        `lines` and `axes` of shape (2, 1), or (3, 1) with the detail; `figure`, `legend`.

    Raises
    ------
    StructureError
        If the signals are not vectors of one length, time does not ascend, or no sample has both outputs.

    Notes
    -----
    Long records are drawn by the extremes of short bins, which gives the same picture.

    Examples
    --------
    >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
    >>> t = np.linspace(0, 10, 201)
    >>> plot = phc.fit_plot(t, np.sin(t), 0.9 * np.sin(t), fit_percent=90.0, output_label="Velocity", output_unit="m/s")
    >>> plot.axes[0, 0].get_ylabel(), plot.axes[1, 0].get_xlabel()
    ('Velocity [m/s]', 'Time')
    >>> plt.close(plot.figure)
    """
    look = Look.of(style, FrameStyle)
    if measured is None and predicted is None and hasattr(time, "experiments"):
        options = {"time_unit": time_unit, "output_label": output_label, "output_unit": output_unit, "ax": ax, **style}
        if not isinstance(detail, str):
            options["detail"] = detail
        return time.plot(**{name: value for name, value in options.items() if value is not None or name == "detail"})
    if measured is None or predicted is None:
        raise StructureError("pass the time, the measured and the predicted output, or the result of a fit alone")
    numbers = fit_data(time, measured, predicted, None if ax is not None and np.size(ax) == 2 else detail)
    output = output_label or "Output"
    quantity = labelled(output, output_unit)
    residual = plain(f"Residual\n[{output_unit}]") if output_unit else "Residual"
    with look.context():
        heights = [3.0, 1.7] + [3.0] * (numbers.detail is not None)
        figure, axes = stacked(ax, heights, meaning="the record above its residual, and the detail")
        lines = np.empty(axes.shape, dtype=object)
        lines[0, 0] = _draw_record(axes[0, 0], numbers, fit_percent)
        lines[1, 0] = _draw_residual(axes[1, 0], numbers, output_unit or "")
        for axis, name in zip(axes[:, 0], (quantity, residual, quantity), strict=False):
            axis.set_ylabel(name)
            look.lattice(axis)
        if numbers.detail is not None:
            lines[2, 0] = _draw_detail(axes[2, 0], axes[0, 0], numbers, detail)
        for axis in axes[1:, 0]:
            axis.set_xlabel(labelled("Time", time_unit))
        legend = np.array([[look.legend(axis)] for axis in axes[:, 0]], dtype=object)
        look.entitle(figure, ax, f"{output}, measured and predicted")
    return ct.ControlPlot(lines, axes, figure, legend=legend)


def _draw_record(axis: Axes, numbers: FitData, fit_percent: float | None) -> list[Any]:
    label = "predicted" if fit_percent is None else f"predicted (fit {percent(fit_percent)})"
    axis.set_xlim(numbers.time[0], numbers.time[-1])
    return [
        *axis.plot(*extremes(numbers.time, numbers.measured, DRAWN), label="measured", **MEASURED),
        *axis.plot(*extremes(numbers.time, numbers.predicted, DRAWN), label=label, **_PREDICTED),
    ]


def _draw_residual(axis: Axes, numbers: FitData, unit: str) -> list[Any]:
    size = plain(f"RMS {numbers.residual_rms:.3g} {unit}".strip())
    axis.text(
        0.995, 1.0, size, transform=axis.transAxes, ha="right", va="bottom",
        fontsize=mpl.rcParams["legend.fontsize"],
    )  # fmt: skip
    axis.axhline(0.0, **ZERO)
    return list(axis.plot(*extremes(numbers.time, numbers.residual, DRAWN), label="residual", **_RESIDUAL))


def _draw_detail(axis: Axes, top: Axes, numbers: FitData, detail: Any) -> list[Any]:
    part = numbers.detail
    t = numbers.time[part]
    top.axvspan(t[0], t[-1], color="0.85", zorder=0)
    axis.set_xlim(t[0], t[-1])
    where = (
        "Detail (shaded above), where the residual is largest" if isinstance(detail, str) else "Detail (shaded above)"
    )
    axis.set_title(where, loc="left")
    return [
        *axis.plot(*extremes(t, numbers.measured[part], DRAWN), label="measured", **SAMPLES),
        *axis.plot(*extremes(t, numbers.predicted[part], DRAWN), label="predicted", **_PREDICTED),
    ]

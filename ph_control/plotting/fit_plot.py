"""Pictures of outputs: measured and modelled, what is left, and a part enlarged; of one fit or of several models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import control as ct
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from .. import _checks
from .._display import percent
from .._types import Array, Unpack
from ..exceptions import StructureError
from .inputs import is_fit
from .style import (
    MEASURED,
    SAMPLES,
    STYLES,
    ZERO,
    AxesGiven,
    FrameStyle,
    Look,
    Picture,
    extremes,
    labelled,
    picture,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist

_FEW_PERIODS = 10  # that are seen in the whole record
_DETAIL_PERIODS = 8
_DETAIL_SAMPLES = (80, 1000)  # at least, if the record allows it, and where the strongest motion is slower than that
_COLOURS = ("C0", "C3", "C2", "C4", "C5", "C6", "C8", "C9")  # of models: not that of the measurement
_SHADED = "Detail (shaded above)"


def fit_plot(
    time: Any,
    measured: ArrayLike | None = None,
    predicted: ArrayLike | None = None,
    *,
    fit_percent: float | None = None,
    time_unit: str | None = None,
    output_label: str | None = None,
    output_unit: str | None = None,
    detail: Literal["auto"] | ArrayLike | None = "auto",
    ax: AxesGiven = None,
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
    for name, text in (("output_label", output_label), ("output_unit", output_unit), ("time_unit", time_unit)):
        if not isinstance(text, str | None):
            raise StructureError(f"{name} is {_checks.shown(text)}; it must be a text")
    if measured is None and predicted is None and is_fit(time):
        options = {"time_unit": time_unit, "output_label": output_label, "output_unit": output_unit, "ax": ax, **style}
        if not isinstance(detail, str):
            options["detail"] = detail
        return time.plot(**{name: value for name, value in options.items() if value is not None or name == "detail"})
    if measured is None or predicted is None:
        raise StructureError("pass the time, the measured and the predicted output, or the result of a fit alone")
    name = "predicted" if fit_percent is None else f"predicted (fit {percent(fit_percent)})"
    outputs = _checked(time, measured, predicted, name)
    part = outputs.part(detail, ax)
    output = output_label or "Output"
    residual = plain(f"Residual\n[{output_unit}]") if output_unit else "Residual"
    with look.context():
        drawn = _drawn(look, ax, outputs, part, (labelled(output, output_unit), residual), time_unit, 1.7)
        drawn.lines[1, 0] = _draw_errors(drawn.axes[1, 0], outputs, [{"color": "C3", "label": "residual"}])
        size = plain(f"RMS {np.sqrt(np.nanmean(outputs.errors**2)):.3g} {output_unit or ''}".strip())
        corner = {"ha": "right", "va": "bottom", "fontsize": mpl.rcParams["legend.fontsize"]}
        drawn.axes[1, 0].text(0.995, 1.0, size, transform=drawn.axes[1, 0].transAxes, **corner)
        if part is not None:
            drawn.lines[2, 0][1].set_label("predicted")
            where = ", where the residual is largest" if isinstance(detail, str) else ""
            drawn.axes[2, 0].set_title(_SHADED + where, loc="left")
        return drawn.finished(f"{output}, measured and predicted", drawn.legends())


def comparison_plot(
    time: Array,
    measured: Array,
    predicted: Array,
    *,
    labels: Sequence[str],
    time_unit: str | None = None,
    output_label: str = "Output",
    output_unit: str | None = None,
    detail: object = "auto",
    heading: str,
    ax: AxesGiven = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:
    """Outputs of all models over the measured one, their errors below, and a few periods enlarged.

    `predicted` has shape (k, T); the other arguments are those of `fit_plot`.
    """
    look = Look.of(style, FrameStyle)
    outputs = Outputs(time, measured, predicted, labels)
    quantities = labelled(output_label, output_unit), labelled("Error", output_unit)
    with look.context():
        drawn = _drawn(look, ax, outputs, outputs.part(detail, ax), quantities, time_unit, 2.0)
        styles = [{**line_of_model(k), "label": plain(label)} for k, label in enumerate(labels)]
        drawn.lines[1, 0] = _draw_errors(drawn.axes[1, 0], outputs, styles)
        return drawn.finished(heading)


def line_of_model(k: int) -> dict[str, Any]:
    """Colour and style of the line of the k-th of several models."""
    return {"color": _COLOURS[k % len(_COLOURS)], "linestyle": STYLES[k % len(STYLES)]}


# --- numbers ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outputs:
    """Measured output, shape (T,), NaN where missing, and those of models, shape (k, T), with their labels."""

    time: Array
    measured: Array
    predicted: Array
    labels: Sequence[str]

    @property
    def errors(self) -> Array:
        """What the models leave."""
        return self.measured - self.predicted

    def cut(self, part: slice) -> Outputs:
        """Some of the samples."""
        return Outputs(self.time[part], self.measured[part], self.predicted[:, part], self.labels)

    def part(self, detail: object, ax: AxesGiven) -> slice | None:
        """Samples to enlarge; with axes of one's own, only if there is one for them."""
        if detail is None or (ax is not None and np.asarray(ax, object).size == 2):
            return None
        if not isinstance(detail, str):
            return self._between(detail)
        _checks.choice("detail", detail, ("auto",))
        return self._worst_part()

    def _worst_part(self) -> slice | None:
        """A few periods of the strongest oscillation, where the errors are largest, all models counting the same."""
        known = np.isfinite(self.measured)
        signal = np.where(known, self.measured - np.mean(self.measured[known]), 0.0)
        periods = int(np.argmax(np.abs(np.fft.rfft(signal))))
        least, most = _DETAIL_SAMPLES
        if periods > _FEW_PERIODS:
            count = min(max(least, _DETAIL_PERIODS * len(signal) // periods), len(signal) // 3)
        elif 3 * most <= len(signal):
            count = most
        else:
            return None
        errors = np.nan_to_num(self.errors)
        sizes = np.maximum(np.sqrt(np.mean(errors**2, axis=1, keepdims=True)), np.finfo(float).tiny)
        power = np.cumsum(np.concatenate([[0.0], np.sum((errors / sizes) ** 2, axis=0)]))
        start = int(np.argmax(power[count:] - power[:-count]))
        return slice(start, start + count)

    def _between(self, detail: Any) -> slice:
        """Samples between the two instants that the user asked to see enlarged."""
        ends, time = _checks.real_array("detail", detail, 1), self.time
        if len(ends) != 2:
            raise StructureError(f"detail has {len(ends)} entries; give the first and the last instant to enlarge")
        start, stop = (int(k) for k in (np.searchsorted(time, ends[0]), np.searchsorted(time, ends[1], side="right")))
        if stop - start < 2:
            raise StructureError(
                f"detail from {ends[0]:.6g} to {ends[1]:.6g} holds {max(0, stop - start)} samples of the record, which "
                f"reaches from {time[0]:.6g} to {time[-1]:.6g}; expected at least 2"
            )
        return slice(start, stop)


def _checked(time: ArrayLike, measured: ArrayLike, predicted: ArrayLike, label: str) -> Outputs:
    t = _checks.real_array("the time", time, 1)
    y = _checks.real_array("the measured output", measured, 1, missing=True)
    p = _checks.real_array("the predicted output", predicted, 1, missing=True)
    if not len(t) == len(y) == len(p):
        raise StructureError(
            f"the time has {len(t)} samples, the measured output {len(y)} and the predicted output {len(p)}; "
            "they must have the same length"
        )
    if np.any(np.diff(t) <= 0):
        k = int(np.argmax(np.diff(t) <= 0))
        raise StructureError(
            f"the time does not increase: samples {k} and {k + 1} are at {t[k]:.9g} and {t[k + 1]:.9g}"
        )
    if not np.isfinite(y - p).any():
        raise StructureError("no sample has a measured and a predicted output; there is nothing to compare")
    return Outputs(t, y, p[None], [label])


# --- drawing ---------------------------------------------------------------------------------------------------------


def _drawn(
    look: Look, ax: AxesGiven, outputs: Outputs, part: slice | None, quantities: tuple[str, str], time_unit: str | None,
    below: float,
) -> Picture:  # fmt: skip
    """Outputs above, the frame of their errors, and the part that is enlarged; labels and grids of all."""
    heights = [3.0, below] + [3.0] * (part is not None)
    drawn = picture(
        look, ax, (len(heights), 1), (7.2, 1.2 + 0.75 * sum(heights)), tied=2, height_ratios=heights,
        meaning="the record above its errors, and the detail",
    )  # fmt: skip
    axes = drawn.axes[:, 0]
    drawn.lines[0, 0] = draw_outputs(axes[0], outputs, MEASURED)
    if part is not None:
        axes[0].axvspan(outputs.time[part][0], outputs.time[part][-1], color="0.85", zorder=0)
        drawn.lines[2, 0] = draw_outputs(axes[2], outputs.cut(part), SAMPLES)
        if ax is None:
            axes[2].ticklabel_format(axis="x", useOffset=False)
        axes[2].set_title(_SHADED, loc="left")
    for axis, quantity in zip(axes, (*quantities, quantities[0]), strict=False):
        axis.set_ylabel(quantity)
        look.lattice(axis)
    for axis in axes[1:]:
        axis.set_xlabel(labelled("Time", time_unit))
    return drawn


def draw_outputs(axis: Axes, outputs: Outputs, measured: dict[str, Any]) -> list[Any]:
    """Measured output with those of models over it."""
    lines = axis.plot(*extremes(outputs.time, outputs.measured), label="measured", zorder=2, **measured)
    for k, (name, values) in enumerate(zip(outputs.labels, outputs.predicted, strict=True)):
        properties = {"linewidth": 1.1, "zorder": 3, **line_of_model(k)}
        lines += axis.plot(*extremes(outputs.time, values), label=plain(name), **properties)
    axis.set_xlim(outputs.time[0], outputs.time[-1])
    # a model that runs away must not hide the others
    known = outputs.measured[np.isfinite(outputs.measured)]
    if len(known):
        reach = float(np.ptp(known)) or float(np.max(np.abs(known))) or 1.0
        low, high = axis.get_ylim()
        axis.set_ylim(max(low, float(known.min()) - reach), min(high, float(known.max()) + reach))
    return lines


def _draw_errors(axis: Axes, outputs: Outputs, styles: list[dict[str, Any]]) -> list[Artist]:
    axis.axhline(0.0, **ZERO)
    axis.set_xlim(outputs.time[0], outputs.time[-1])
    lines: list[Artist] = []
    # the smaller error is drawn over the larger
    for k in np.argsort([float(np.nanmean(error**2)) for error in outputs.errors])[::-1]:
        lines += axis.plot(*extremes(outputs.time, outputs.errors[k]), linewidth=0.8, **styles[k])
    return lines

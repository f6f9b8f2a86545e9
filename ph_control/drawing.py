"""What all pictures share: style, axes, legends, and lines of more samples than a picture has points."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .exceptions import StructureError

Array = NDArray[np.float64]

DRAWN = 6000  # samples beyond which a line is drawn by the extremes of its bins: the same picture, drawn faster
STYLES = ("-", "--", "-.", ":")
BAND: dict[str, Any] = {"alpha": 0.22, "linewidth": 0.0, "zorder": 1.5}
MINOR = 0.35  # opacity of the grid lines between the main ones


@dataclass(frozen=True)
class Look:
    """How a picture is to look: the keywords that all pictures take, with the meaning they have in python-control."""

    title: str | None = None
    grid: bool = True
    show_legend: bool | None = None
    legend_loc: str | bool | None = None
    rcParams: dict[str, Any] | None = None
    line: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls, title: str | None, grid: bool, show_legend: bool | None, legend_loc: str | bool | None,
        rcParams: dict[str, Any] | None, color: Any, linestyle: str | None, linewidth: float | None,
    ) -> Look:  # fmt: skip
        """Style of these keywords; a property of lines that is None stays what it is."""
        properties = {"color": color, "linestyle": linestyle, "linewidth": linewidth}
        given = {name: value for name, value in properties.items() if value is not None}
        return cls(title, grid, show_legend, legend_loc, rcParams, given)

    def context(self) -> AbstractContextManager[None]:
        """Settings of matplotlib while the picture is drawn: those of python-control, then those given."""
        settings: Any = dict(ct.config.defaults["ctrlplot.rcParams"]) | (self.rcParams or {})
        return plt.rc_context(settings)

    def curve(self, k: int) -> dict[str, Any]:
        """Properties of the line of the k-th system; broken lines after the first, so that equal ones are all seen."""
        return {"linestyle": STYLES[k % len(STYLES)], "linewidth": 1.4, "zorder": 3, **self.line}

    def lattice(self, axis: Axes, *, minor: str | None = None) -> None:
        """Grid lines at the ticks, and paler ones at the minor ticks of one axis."""
        if self.grid:
            axis.grid(True, which="major", linewidth=0.5, alpha=0.6)
            if minor is not None:
                axis.grid(True, which="minor", axis=minor, linewidth=0.3, alpha=MINOR)  # type: ignore[arg-type]

    def legend(self, axis: Axes, least: int = 2) -> Any:
        """Legend outside the data, or where it was asked to be; none for fewer entries than `least`."""
        if self.show_legend is False or (self.legend_loc is False and self.show_legend is None):
            return None
        least = 1 if self.show_legend or isinstance(self.legend_loc, str) else least
        if not isinstance(self.legend_loc, str):
            return legend_above(axis, least)
        place: Any = self.legend_loc
        return axis.legend(loc=place) if len(axis.get_legend_handles_labels()[1]) >= least else None

    def entitle(self, figure: Figure, ax: Any, default: str) -> None:
        """Title of the figure; on axes of one's own only if it was asked for."""
        if self.title is not None or ax is None:
            figure.suptitle(plain(default if self.title is None else self.title))


def new_axes(ax: Any, shape: tuple[int, int], size: tuple[float, float], **options: Any) -> tuple[Figure, NDArray[Any]]:
    """Axes of the given shape in a new figure, or those that were passed."""
    if ax is not None:
        return given_axes(ax, shape)
    figure, axes = plt.subplots(*shape, squeeze=False, layout="constrained", figsize=size, **options)
    figure.align_ylabels()
    return figure, axes


def given_axes(ax: Any, shape: tuple[int, int], meaning: str = "") -> tuple[Figure, NDArray[Any]]:
    """Axes that were passed, in the shape that the picture needs."""
    axes = np.array(ax, dtype=object)
    if axes.size != np.prod(shape):
        raise StructureError(f"ax has {axes.size} axes; needed {shape}{meaning and ': ' + meaning}")
    axes = axes.reshape(shape)
    return axes[0, 0].figure, axes


def labelled(quantity: str, unit: str | None) -> str:
    """Label of an axis, with its unit in brackets if it has one."""
    return plain(f"{quantity} [{unit}]" if unit else quantity)


def check_hertz(Hz: bool, time_unit: str) -> tuple[float, str]:
    """Size of the unit of frequency in rad per unit time, and its name."""
    if Hz and time_unit != "s":
        raise StructureError(f"Hz needs times in s, time_unit is {time_unit!r}; use Hz=False, or convert the times")
    return (2.0 * np.pi, "Hz") if Hz else (1.0, f"rad/{time_unit}")


def plain(text: str) -> str:
    """Text that matplotlib shows as it is: two dollar signs would make a formula of what is between them."""
    return str(text).replace("$", r"\$")


def legend_above(axis: Axes, least: int = 2) -> Any:
    """Legend outside the data, where no line can hide behind it; none for fewer entries than `least`."""
    handles, labels = axis.get_legend_handles_labels()
    if len(labels) < least:
        return None
    # matplotlib fills column by column, each as wide as its longest entry
    widest = [max(map(len, column)) for column in np.array_split(np.array(labels, dtype=object), 4) if len(column)]
    columns = 4 if sum(widest) < 80 else 2
    return axis.legend(
        handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns,
        frameon=False, borderaxespad=0.2,
    )  # fmt: skip


def extremes(time: Array, values: Array, limit: int) -> tuple[Array, Array]:
    """At most about `limit` samples that draw the same line: the least and the greatest of each short bin, in order.

    A bin without any number is a gap.
    """
    if len(values) <= limit:
        return time, values
    size = -(-2 * len(values) // limit)
    padding = -len(values) % size
    bins = np.concatenate([values, np.full(padding, np.nan)]).reshape(-1, size)
    first = size * np.arange(len(bins))
    low = first + np.argmin(np.where(np.isnan(bins), np.inf, bins), axis=1)
    high = first + np.argmax(np.where(np.isnan(bins), -np.inf, bins), axis=1)
    # argmin and argmax of an empty bin are its first sample, a NaN
    kept = np.unique(np.concatenate([low, high]))
    return time[kept], values[kept]

"""What all pictures share: style, axes, legends, and lines of more samples than a picture has points."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, TypedDict

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import RcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatter
from numpy.typing import NDArray

from .. import _checks
from .._types import Array
from .._units import SECONDS, hertz_size, parted, rate
from ..exceptions import StructureError

# axes to draw on: one, or those of each panel; None for a new figure
AxesGiven = Axes | Sequence[Axes] | NDArray[np.object_] | None

STYLES = ("-", "--", "-.", ":")
BAND: dict[str, Any] = {"alpha": 0.22, "linewidth": 0.0, "zorder": 1.5}
ZERO: dict[str, Any] = {"color": "0.3", "linewidth": 0.6, "zorder": 1}
# beneath what is held against it, and wide enough to be seen on both sides of it where they are equal
MEASURED: dict[str, Any] = {"color": "C1", "linewidth": 3.2, "alpha": 0.6}
SAMPLES: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4.0, "color": "C1", "alpha": 0.7}
DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 3.5, "color": "0.4", "zorder": 2.2}

_DRAWN = 6000  # samples beyond which a line is drawn by the extremes of its bins: the same picture, drawn faster
_PER_INCH = 12.5  # letters of a legend, with some room between its columns
_PREFIX = "[pnuµμmkMG]?"
_OHM = re.compile(rf"{_PREFIX}(ohm|Ω|\u2126|V/{_PREFIX}A$)", re.IGNORECASE)
_PLAIN = 100.0  # ratio of the ends of a logarithmic abscissa below which its labels are plain numbers
_MINOR = 0.35  # opacity of the grid lines between the main ones


class FrameStyle(TypedDict, total=False):
    """Keywords that every picture takes, with the meaning they have in python-control."""

    title: str | None
    grid: bool
    show_legend: bool | None
    legend_loc: str | bool | None
    rcParams: dict[str, Any] | None


class MarkStyle(FrameStyle, total=False):
    """Those of pictures whose systems have a colour."""

    color: Any


class LineStyle(MarkStyle, total=False):
    """Those of pictures whose systems have lines."""

    linestyle: str | None
    linewidth: float | None


@dataclass(frozen=True)
class Look:
    """How a picture is to look, as the keywords that all pictures take say it."""

    title: str | None = None
    grid: bool = True
    show_legend: bool | None = None
    legend_loc: str | bool | None = None
    rcParams: dict[str, Any] | None = None
    line: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, style: Mapping[str, Any], known: type = LineStyle) -> Look:
        """Style of these keywords, which `known` lists; one that is None stays what it is."""
        unknown = [name for name in style if name not in known.__annotations__]
        if unknown:
            raise TypeError(f"unexpected keyword argument {unknown[0]!r}; of style: {', '.join(known.__annotations__)}")
        given = {name: value for name, value in style.items() if value is not None}
        frame = {name: given.pop(name) for name in FrameStyle.__annotations__ if name in given}
        _checks.flags(**{name: frame[name] for name in ("grid", "show_legend") if name in frame})
        place = frame.get("legend_loc")
        if isinstance(place, str):
            _checks.choice("legend_loc", place, tuple(Legend.codes))
        # what matplotlib would refuse in the middle of a picture
        try:
            for name, value in given.items():
                if isinstance(value, float | np.number | np.ndarray) and not np.isfinite(value).all():
                    raise ValueError(f"{name} is {_checks.shown(value)}, not finite")
            Line2D([], [], **given)
            RcParams(dict(frame.get("rcParams", {})))
        # OSError of python-control, where something of it is iterated
        except (ValueError, TypeError, KeyError, OverflowError, OSError) as error:
            raise StructureError(f"matplotlib does not know this style: {error}") from None
        return cls(**frame, line=given)

    def context(self) -> AbstractContextManager[None]:
        """Settings of matplotlib while the picture is drawn: those of python-control, then those given."""
        given = {} if self.rcParams is None else self.rcParams
        settings: Any = dict(ct.config.defaults["ctrlplot.rcParams"]) | dict(given)
        return plt.rc_context(settings)

    def curve(self, k: int) -> dict[str, Any]:
        """Properties of the line of the k-th system; broken lines after the first, so that equal ones are all seen."""
        return {"linestyle": STYLES[k % len(STYLES)], "linewidth": 1.4, "zorder": 3, **self.line}

    def lattice(self, axis: Axes, *, minor: str | None = None) -> None:
        """Grid lines at the ticks, and paler ones at the minor ticks of one axis."""
        if self.grid:
            axis.grid(True, which="major", linewidth=0.5, alpha=0.6)
            if minor is not None:
                axis.grid(True, which="minor", axis=minor, linewidth=0.3, alpha=_MINOR)  # type: ignore[arg-type]

    def legend(self, axis: Axes, least: int = 2) -> Legend | None:
        """Legend outside the data, or where it was asked to be; none for fewer entries than `least`."""
        if self.show_legend is False or (self.legend_loc is False and self.show_legend is None):
            return None
        placed = isinstance(self.legend_loc, str)
        handles, labels = axis.get_legend_handles_labels()
        if len(labels) < (1 if self.show_legend or placed else least):
            return None
        where: dict[str, Any] = {"loc": self.legend_loc} if placed else _above(axis, labels)
        return axis.legend(handles, labels, **where)


def _above(axis: Axes, labels: list[str]) -> dict[str, object]:
    """Place of a legend where no line can hide behind it, in as many columns as there is room for."""
    room = _PER_INCH * axis.figure.bbox.width / axis.figure.dpi
    # matplotlib fills column by column, each as wide as its longest entry
    parts = {count: np.array_split(np.array(labels, dtype=object), count) for count in (4, 2)}
    widths = {count: sum(max(map(len, part), default=0) for part in some) for count, some in parts.items()}
    columns = next((count for count, width in widths.items() if width < room), 1)
    return {
        "loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": columns, "frameon": False, "borderaxespad": 0.2,
    }  # fmt: skip


# --- figures ---------------------------------------------------------------------------------------------------------


@dataclass
class Picture:
    """Axes to draw on and, for each of them, the lines that were drawn."""

    look: Look
    figure: Figure
    axes: NDArray[np.object_]
    new: bool
    lines: NDArray[np.object_] = field(init=False)

    def __post_init__(self) -> None:
        self.lines = np.empty(self.axes.shape, dtype=object)

    def finished(self, title: str, legend: Any = None) -> ct.ControlPlot:
        """Entitle the figure, on axes of one's own only if asked for; the legend is that of the first axes by default.

        To be called with the settings that the picture was drawn with.
        """
        legend = self.look.legend(self.axes[0, 0]) if legend is None else legend
        if self.look.title is not None or self.new:
            self.figure.suptitle(plain(title if self.look.title is None else self.look.title))
        return ct.ControlPlot(self.lines, self.axes, self.figure, legend=legend)

    def legend_of_all(self) -> Legend | None:
        """One legend below all axes of a new figure, of all that is in any; on given axes, or placed, of the first."""
        handles: dict[str, Any] = {}
        for axis in self.axes.flat:
            for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        silent = self.look.show_legend is False or (self.look.legend_loc is False and not self.look.show_legend)
        if not self.new or isinstance(self.look.legend_loc, str) or silent or len(handles) < 2:
            return self.look.legend(self.axes[0, 0])
        place: dict[str, Any] = {"loc": "outside lower center", "ncols": len(handles), "frameon": False}
        return self.figure.legend(list(handles.values()), list(handles), **place)

    def legends(self) -> NDArray[np.object_]:
        """Legends of all axes."""
        return np.array([[self.look.legend(axis) for axis in row] for row in self.axes], dtype=object)


def picture(
    look: Look, ax: AxesGiven, shape: tuple[int, int], size: tuple[float, float], *, meaning: str = "", tied: int = 0,
    **options: Any,
) -> Picture:  # fmt: skip
    """Axes of the given shape in a new figure, or those that were passed; the first `tied` rows share their abscissa.

    `meaning` says in errors what the axes are for.
    """
    if ax is not None:
        return Picture(look, *_given_axes(ax, shape, meaning), new=False)
    figure, axes = plt.subplots(*shape, squeeze=False, layout="constrained", figsize=size, **options)
    for row in range(1, tied):
        axes[row, 0].sharex(axes[0, 0])
        axes[row - 1, 0].tick_params(labelbottom=False)
    figure.align_ylabels()
    return Picture(look, figure, axes, new=True)


def panels(look: Look, ax: AxesGiven, count: int, size: tuple[float, float], **options: Any) -> Picture:
    """So many axes of this size each in rows of at most three, or those that were passed, as they lie."""
    if ax is not None:
        given = np.asarray(ax, object)
        shape = (given.shape[0], given.shape[1]) if given.ndim == 2 and given.size == count else (count, 1)
        return picture(look, ax, shape, size, meaning="a panel for each")
    # four are two rows of two
    columns = 2 if count == 4 else min(count, 3)
    rows = -(-count // columns)
    drawn = picture(look, None, (rows, columns), (max(columns * size[0], 4.2), 0.5 + rows * size[1]), **options)
    for k, axis in enumerate(drawn.axes.flat):
        axis.set_visible(k < count)
        drawn.lines.flat[k] = []
    return drawn


def _given_axes(ax: AxesGiven, shape: tuple[int, int], meaning: str) -> tuple[Figure, NDArray[np.object_]]:
    axes = np.array(ax, dtype=object)
    if axes.size != np.prod(shape):
        raise StructureError(
            f"ax has {axes.size} axes; expected {np.prod(shape)}, of shape {shape}{meaning and ': ' + meaning}"
        )
    wrong = [axis for axis in axes.flat if not isinstance(axis, Axes)]
    if wrong:
        raise StructureError(f"ax holds {_checks.shown(wrong[0])}; pass axes of matplotlib, as plt.subplots makes them")
    axes = axes.reshape(shape)
    return axes[0, 0].figure, axes


# --- labels ----------------------------------------------------------------------------------------------------------


def labelled(quantity: str, unit: str | None) -> str:
    """Label of an axis, with its unit in brackets if it has one."""
    return plain(f"{quantity} [{unit}]" if _checks.unit_text(unit) else quantity)


def gain_label(gain_unit: str | None, quantity: str = "Magnitude") -> str:
    """Label of an axis of decibels."""
    unit = _checks.unit_text(gain_unit)
    return labelled(quantity, f"dB re 1 {unit}" if unit else "dB")


def told_gain_units(outputs: Sequence[str], inputs: Sequence[str]) -> list[str] | list[None]:
    """Unit of the response of each output, where names such as "force [N]" tell those of all channels."""
    above, below = ([parted(name)[1] for name in names] for names in (outputs, inputs))
    if not (all(above) and all(below) and len(set(below)) == 1):
        return [None] * len(outputs)
    return [f"{unit}/({below[0]})" if set("/ ") & set(below[0]) else f"{unit}/{below[0]}" for unit in above]


def told_gain_unit(*sources: object) -> str | None:
    """Unit of all responses of the first of these whose names of channels tell one."""
    for source in sources:
        names = [getattr(source, name, None) or [] for name in ("output_labels", "input_labels")]
        units = set(told_gain_units(*names))
        if len(units) == 1 and None not in units:
            return units.pop()
    return None


def imaginary_is_turned(given: bool | None, units: Sequence[str | None]) -> bool:
    """Whether imaginary parts are drawn with their sign changed: as asked for, else those of impedances."""
    if given is not None:
        _checks.flags(negative_imaginary=given)
        return bool(given)
    return any(_OHM.match(unit) is not None for unit in units if unit)


def frequency_axis(Hz: bool | None, time_unit: str | None) -> tuple[float, str]:
    """Size of the unit of frequency in rad per unit time, and its name.

    Without `Hz` it is Hz where the unit of time tells it, else cycles per unit of time; rad per one that is no known
    unit.
    """
    if Hz is None:
        if time_unit is None:
            return 2 * np.pi, "1/time"
        Hz = time_unit in SECONDS
    _checks.flags(Hz=Hz)
    if not Hz:
        return 1.0, rate(time_unit)
    if time_unit is not None and time_unit not in SECONDS:
        raise StructureError(
            f"Hz needs a known unit of time, one of {', '.join(SECONDS)}; time_unit is {time_unit!r}: use Hz=False"
        )
    return hertz_size(time_unit), "Hz"


def checked_limits(given: object) -> tuple[float, float]:
    """Ends of a frequency axis, in its unit, as the caller gave them."""
    ends = _checks.real_array("omega_limits", given, 1)
    if len(ends) != 2 or not 0 <= ends[0] < ends[1]:
        raise StructureError(f"omega_limits is {_checks.shown(given)}; give the lowest and the highest frequency")
    return float(ends[0]), float(ends[1])


def plain(text: str) -> str:
    """Text that matplotlib shows as it is: two dollar signs would make a formula of what is between them."""
    return str(text).replace("$", r"\$")


class PlainLogFormatter(LogFormatter):
    """Labels such as 20 in place of powers of ten times a digit, where the axis has labels between powers of ten."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Label of a tick, if it is to have one."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def plain_log_labels(axis: Axes) -> None:
    """Plain numbers at a logarithmic abscissa that spans less than two decades."""
    low, high = axis.get_xlim()
    if high < _PLAIN * low:
        axis.xaxis.set_major_formatter(PlainLogFormatter())
        axis.xaxis.set_minor_formatter(PlainLogFormatter(labelOnlyBase=False))


# --- long lines ------------------------------------------------------------------------------------------------------


def extremes(time: Array, values: Array, limit: int = _DRAWN) -> tuple[Array, Array]:
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

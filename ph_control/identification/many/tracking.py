"""Modes followed from recording to recording, and their picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from scipy.optimize import linear_sum_assignment
from scipy.special import ndtri

from ... import _checks
from ..._display import Report, aligned, counted
from ..._frozen import Frozen
from ..._types import Array, ComplexArray, Indices, NDArray, Unpack
from ...numerics.modal_assurance import mac
from ...plotting.style import BAND, DOTS, AxesGiven, FrameStyle, Look, labelled, picture

_TREND = 5  # recordings of a mode from which on they have a trend

# the picture
_MARKED = 60  # recordings up to which each has a marker
_NAMED = 8  # modes up to which there is a legend
_PANELS = 5  # of frequencies


@dataclass(frozen=True, eq=False, repr=False)
class ModeTracks(Report, Frozen):
    """Modes that were followed over recordings; made by `FitTable.track`.

    Attributes
    ----------
    table : ndarray, structured, shape (rows,)
        The table of the fits.
    ids : ndarray of int, shape (rows,)
        Number of the mode that each row belongs to, from 0 in the order of their first recordings; -1 for none.
    frequency_unit : str
        Unit of `hertz`, as that of the table of the fits.

    Notes
    -----
    `tracks[k]` is the rows of a mode, in the order of the recordings; `len(tracks)` the number of modes.  Where they
    are printed or drawn, modes count from 1: `tracks[0]` is mode 1.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(400)
    >>> def recording(d):
    ...     u = rng.standard_normal(400)
    ...     y = phc.forced_response(phc.ph(phc.modes(d, 1.0)), t, u, intersample="zoh").outputs
    ...     return u, y + 0.01 * rng.standard_normal(400)
    >>> tracks = phc.fit_many([recording(d) for d in (1.0, 1.01, 1.02)], dt=0.1).track()
    >>> len(tracks), (2 * np.pi * tracks[0]["hertz"]).round(2)
    (1, array([1.  , 1.01, 1.02]))
    """

    table: NDArray[np.void]
    ids: Indices
    frequency_unit: str = "Hz"

    def __len__(self) -> int:
        return int(self.ids.max(initial=-1)) + 1

    def __getitem__(self, k: int) -> NDArray[np.void]:
        return self.table[self.ids == range(len(self))[k]]

    def __str__(self) -> str:
        """Headline, and a line for each mode."""
        unit = self.frequency_unit
        rows = [["mode", "recordings", f"first {unit}", f"last {unit}", "change %", "damping %", "seen in"]]
        for k in range(len(self)):
            track = self[k]
            first, last = track["hertz"][0], track["hertz"][-1]
            rows.append([
                str(k + 1), str(len(track)), f"{first:.6g}", f"{last:.6g}", f"{100 * (last / first - 1):+.3f}",
                f"{100 * np.median(track['damping_ratio']):.3g}",
                f"{track['recording'][0]} to {track['recording'][-1]}",
            ])  # fmt: skip
        return "\n".join([self._headline(), *aligned(rows)])

    def _headline(self) -> str:
        loose = int(((self.ids < 0) & (self.table["mode"] >= 0)).sum())
        recordings = counted(len(np.unique(self.table["recording"])), "recording")
        return f"{counted(len(self), 'mode')} followed over {recordings}, {loose} rows left over"

    def plot(self, *, relative: bool = False, level: float = 0.95, **kwargs: Any) -> ct.ControlPlot:
        """Natural frequencies and damping ratios against the recordings, with bands.

        Parameters
        ----------
        relative : bool
            Whether frequencies are drawn by their change in percent, each from its median.
        level : float
            Probability of the bands, between 0 and 1.
        **kwargs
            `ax`, an array of two axes, and `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`.

        Returns
        -------
        control.ControlPlot
            `axes` of shape (k + 1, 1): frequencies above damping ratios, over a common axis of recordings.

        Raises
        ------
        StructureError
            If an argument is not of this form.

        Notes
        -----
        Modes whose frequencies meet share a panel, k of them; there is one panel for all where these were more than
        five, with `relative`, and on given axes.  Lines end where a mode is missing in a recording.  Rows that belong
        to no mode are grey dots.

        Examples
        --------
        >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
        >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(400)
        >>> def recording(d):
        ...     u = rng.standard_normal(400)
        ...     y = phc.forced_response(phc.ph(phc.modes(d, 1.0)), t, u, intersample="zoh").outputs
        ...     return u, y + 0.01 * rng.standard_normal(400)
        >>> plot = phc.fit_many([recording(d) for d in (1.0, 1.01)], dt=0.1).track().plot()
        >>> [axis.get_ylabel() for axis in plot.axes[:, 0]]
        ['Natural frequency [1/time]', 'Damping ratio [%]']
        >>> plt.close(plot.figure)
        """
        rows = self.table.view(np.recarray)
        lines, loose = [rows[self.ids == k] for k in range(len(self))], rows[(self.ids < 0) & (rows.mode >= 0)]
        return _tracks_plot(lines, loose, self.frequency_unit, relative=relative, level=level, **kwargs)


# --- following -------------------------------------------------------------------------------------------------------


@dataclass
class _Followed:
    """A mode as far as it was followed: its recordings, logarithms of its frequencies, and its shapes."""

    places: list[int] = field(default_factory=list)
    logs: list[float] = field(default_factory=list)
    shapes: list[ComplexArray] = field(default_factory=list)

    def add(self, place: int, log: float, shape: ComplexArray, window: int) -> None:
        """Take what it is in one more recording; as many shapes are kept as that many recordings have."""
        self.places.append(place)
        self.logs.append(log)
        self.shapes = [*self.shapes, shape][-window:]

    def expected(self, place: int, window: int) -> float:
        """Logarithm of its frequency in a recording, by the median of the slopes between the last ones."""
        x, y = np.array(self.places[-window:], float), np.array(self.logs[-window:])
        if len(x) < _TREND:
            return float(y[-1])
        first, second = np.triu_indices(len(x), 1)
        slope = np.median((y[second] - y[first]) / (x[second] - x[first]))
        return float(np.median(y + slope * (place - x)))

    def unlikeness(self, shapes: Sequence[ComplexArray]) -> Array:
        """`1 - MAC` of each given shape, the mean over the last shapes of the mode; 0 where there is one output."""
        dissimilarity = np.zeros(len(shapes))
        for k, shape in enumerate(shapes):
            held = [previous for previous in self.shapes if len(previous) == len(shape)]
            if len(shape) > 1 and held:
                dissimilarity[k] = 1.0 - float(mac(shape[None], np.array(held)).mean())
        return dissimilarity


def followed(
    table: NDArray[np.void], shapes: Sequence[ComplexArray], tolerance: float, least_mac: float, window: int, gap: int,
    shortest: int,
) -> Indices:  # fmt: skip
    """Number of the mode that each row belongs to, -1 for none."""
    ids = np.full(len(table), -1)
    known: list[_Followed] = []
    here = np.flatnonzero(table["hertz"] > 0)
    logs = np.log(np.where(table["hertz"] > 0, table["hertz"], 1.0))
    for place in np.unique(table["recording"][here]).tolist():
        rows = here[table["recording"][here] == place]
        alive = [k for k, mode in enumerate(known) if place - mode.places[-1] <= gap + 1]
        distance = np.array([np.abs(logs[rows] - known[k].expected(place, window)) for k in alive]) / tolerance
        unlike = np.array([known[k].unlikeness([shapes[row] for row in rows]) for k in alive])
        cost = np.zeros((len(alive), len(rows)))
        if alive:
            # a pair outweighs any distance within the bounds, as many as can be are made
            cost = np.where((distance <= 1.0) & (unlike <= 1.0 - least_mac), distance + unlike - 3.0, 0.0)
        for k, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[k, column] < 0:
                ids[rows[column]] = alive[k]
        for row in rows:
            if ids[row] < 0:
                ids[row] = len(known)
                known.append(_Followed())
            known[ids[row]].add(place, float(logs[row]), shapes[row], window)
    kept = [k for k, mode in enumerate(known) if len(mode.places) >= shortest]
    numbers = np.full(len(known) + 1, -1)
    numbers[kept] = np.arange(len(kept))
    return numbers[ids]


def _tracks_plot(
    tracks: Sequence[np.recarray], loose: np.recarray, unit: str, *, relative: bool, level: float, ax: AxesGiven = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:  # fmt: skip
    """Frequencies above damping ratios of the rows of each mode, with bands; loose rows as dots."""
    look = Look.of(style, FrameStyle)
    _checks.flags(relative=relative)
    width = float(ndtri(0.5 + _checks.level("level", level) / 2))
    groups = _groups(tracks) if ax is None and not relative else [list(range(len(tracks)))]
    count = len(groups)
    with look.context():
        drawn = picture(
            look, ax, (count + 1, 1), (7.5, 2.8 + 1.6 * (count + 1)), meaning="frequency and damping", tied=count + 1
        )
        *above, below = drawn.axes[:, 0]
        for row in range(count + 1):
            drawn.lines[row, 0] = []
        for row, k in [(row, k) for row, group in enumerate(groups) for k in group]:
            track, middle = tracks[k], float(np.median(tracks[k].hertz))
            size = 100 / middle if relative else 1.0
            shown, error = size * (track.hertz - middle * relative), size * width * track.hertz_stderr
            named = {"color": f"C{k % 10}", "label": f"mode {k + 1} ({middle:.4g} {unit})"}
            drawn.lines[row, 0] += _curve(above[row], track.recording, shown, error, named)
            part = 100 * track.damping_ratio, 100 * width * track.damping_ratio_stderr
            drawn.lines[count, 0] += _curve(below, track.recording, *part, named)
        for axis in above:
            limits = axis.get_ylim()
            if not relative:
                axis.plot(loose.recording, loose.hertz, **DOTS)
            if count > 1:
                axis.set_ylim(limits)
            quantity = "Natural frequency" if count == 1 else "Frequency"
            axis.set_ylabel("Change of natural frequency [%]" if relative else labelled(quantity, unit))
        below.plot(loose.recording, 100 * loose.damping_ratio, **DOTS)
        below.set_ylabel("Damping ratio [%]")
        below.set_xlabel("Recording")
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
        for axis in drawn.axes[:, 0]:
            look.lattice(axis)
        heading = f"Modes over recordings, with {100 * level:g} % bands"
        few = len(tracks) <= _NAMED or look.show_legend
        return drawn.finished(heading, drawn.legend_of_all() if few else False)


def _groups(tracks: Sequence[np.recarray]) -> list[list[int]]:
    """Modes whose frequencies meet, in the order of these, for a panel each; all in one where these were too many."""
    groups: list[list[int]] = []
    high = -np.inf
    for k in sorted(range(len(tracks)), key=lambda k: float(tracks[k].hertz.min())):
        if tracks[k].hertz.min() > high:
            groups.append([])
        groups[-1].append(k)
        high = max(high, float(tracks[k].hertz.max()))
    return groups[::-1] if 0 < len(groups) <= _PANELS else [list(range(len(tracks)))]


def _curve(axis: Axes, x: Array, y: Array, error: Array, named: dict[str, Any]) -> list[Any]:
    """Line with its band, broken where a recording is missing."""
    ends = np.flatnonzero(np.diff(x) > 1) + 1
    x, y, error = (np.insert(values.astype(float), ends, np.nan) for values in (x, y, error))
    marker = "." if len(x) <= _MARKED else None
    axis.fill_between(x, y - error, y + error, color=named["color"], **BAND)
    return list(axis.plot(x, y, linewidth=1.2, marker=marker, **named))

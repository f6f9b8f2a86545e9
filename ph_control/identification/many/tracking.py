"""Modes followed from recording to recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import control as ct
import numpy as np
from scipy.optimize import linear_sum_assignment

from ..._display import Report, aligned, counted
from ..._frozen import Frozen
from ..._types import Array, ComplexArray, Indices, NDArray
from ...numerics.modal_assurance import mac
from .track_plot import tracks_plot

_TREND = 5  # recordings of a mode from which on they have a trend


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
        return tracks_plot(lines, loose, self.frequency_unit, relative=relative, level=level, **kwargs)


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

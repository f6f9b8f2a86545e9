"""Picture of modes that are followed over many recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from scipy.special import ndtri

from ... import _checks
from ..._types import Array
from ...plotting.style import BAND, DOTS, AxesGiven, FrameStyle, Look, labelled, picture

if TYPE_CHECKING:
    from typing_extensions import Unpack

_MARKED = 60  # recordings up to which each has a marker
_NAMED = 8  # modes up to which there is a legend
_PANELS = 5  # of frequencies


def tracks_plot(
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

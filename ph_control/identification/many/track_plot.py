"""Picture of modes that are followed over many recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import control as ct
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from scipy.special import ndtri

from ... import _checks
from ..._types import Array
from ...plotting.style import BAND, DOTS, FrameStyle, Look, picture

if TYPE_CHECKING:
    from typing_extensions import Unpack

_MARKED = 60  # recordings up to which each has a marker
_NAMED = 8  # modes up to which there is a legend


@dataclass(frozen=True)
class Track:
    """Recordings of a mode, ascending, its frequencies in Hz, its damping ratios, and their standard errors."""

    recording: Array
    hertz: Array
    hertz_stderr: Array
    damping_ratio: Array
    damping_ratio_stderr: Array


def tracks_plot(
    tracks: Sequence[Track], loose: Track, *, relative: bool, level: float, ax: Any = None,
    **style: Unpack[FrameStyle],
) -> ct.ControlPlot:  # fmt: skip
    """Frequencies above damping ratios of all modes, with bands; what belongs to none as dots."""
    look = Look.of(style, FrameStyle)
    _checks.flags(relative=relative)
    width = float(ndtri(0.5 + _checks.level("level", level) / 2))
    with look.context():
        drawn = picture(look, ax, (2, 1), (7.5, 5.6), meaning="frequency and damping", tied=2)
        above, below = drawn.axes[:, 0]
        drawn.lines[0, 0], drawn.lines[1, 0] = [], []
        for k, one in enumerate(tracks):
            middle = float(np.median(one.hertz))
            size = 100 / middle if relative else 1.0
            shown, error = size * (one.hertz - middle * relative), size * width * one.hertz_stderr
            label = f"mode {k} ({middle:.4g} Hz)"
            drawn.lines[0, 0] += _curve(above, one.recording, shown, error, f"C{k % 10}", label)
            part = 100 * one.damping_ratio, 100 * width * one.damping_ratio_stderr
            drawn.lines[1, 0] += _curve(below, one.recording, *part, f"C{k % 10}", label)
        if not relative:
            above.plot(loose.recording, loose.hertz, **DOTS)
        below.plot(loose.recording, 100 * loose.damping_ratio, **DOTS)
        above.set_ylabel("Change of natural frequency [%]" if relative else "Natural frequency [Hz]")
        below.set_ylabel("Damping ratio [%]")
        below.set_xlabel("Recording")
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
        for axis in (above, below):
            look.lattice(axis)
        legend = look.legend(above) if len(tracks) <= _NAMED or look.show_legend else False
        return drawn.finished(f"Modes over recordings, with {100 * level:g} % bands", legend)


def _curve(axis: Axes, x: Array, y: Array, error: Array, colour: str, label: str) -> list[Any]:
    """Line with its band, broken where a recording is missing."""
    ends = np.flatnonzero(np.diff(x) > 1) + 1
    x, y, error = (np.insert(values, ends, np.nan) for values in (x, y, error))
    marker = "." if len(x) <= _MARKED else None
    axis.fill_between(x, y - error, y + error, color=colour, **BAND)
    return list(axis.plot(x, y, color=colour, linewidth=1.2, marker=marker, label=label))

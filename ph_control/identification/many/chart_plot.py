"""Picture of a control chart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import control as ct
import numpy as np
from matplotlib.ticker import MaxNLocator
from scipy.special import ndtri

from ...plotting.style import ZERO, AxesGiven, FrameStyle, Look, picture

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from .control_chart import ControlChart

_NAMED = 8  # modes up to which there is a legend
_BARS = float(ndtri(0.975))


def chart_plot(chart: ControlChart, ax: AxesGiven = None, **style: Unpack[FrameStyle]) -> ct.ControlPlot:
    """Cumulative sum with its limit, above the shifts of the frequencies with 95 % bars."""
    look = Look.of(style, FrameStyle)
    with look.context():
        drawn = picture(look, ax, (2, 1), (7.5, 5.6), meaning="cumulative sum and shifts", tied=2)
        above, below = drawn.axes[:, 0]
        x, sums = chart.recordings, chart.statistic
        every = f"limit: a false alarm in {1 / chart.false_alarm_rate:.0f} recordings"
        drawn.lines[0, 0] = list(above.plot(x, sums, marker=".", color="C0", label="cumulative sum"))
        drawn.lines[0, 0] += [above.axhline(chart.limit, color="C3", linestyle="--", linewidth=1.2, label=every)]
        beyond = sums > chart.limit
        if beyond.any():
            drawn.lines[0, 0] += above.plot(x[beyond], sums[beyond], "o", color="C3", markersize=5, label="alarm")
        above.set_ylabel("Cumulative sum of scores")
        above.set_ylim(0.0, 1.15 * max(chart.limit, float(sums.max(initial=0.0))))
        drawn.lines[1, 0] = [below.axhline(0.0, **ZERO)]
        modes = len(chart.hertz)
        aside = 0.25 * (np.arange(modes) - 0.5 * (modes - 1)) / max(modes, 1)
        for l, f in enumerate(chart.hertz):
            bars = below.errorbar(
                x + aside[l], 100 * chart.frequency_shift[:, l], 100 * _BARS * chart.frequency_shift_stderr[:, l],
                marker=".", linewidth=1.0, elinewidth=0.8, color=f"C{l % 10}",
                label=f"mode {l + 1} ({f:.4g} {chart.frequency_unit})",
            )  # fmt: skip
            drawn.lines[1, 0].append(bars[0])
        below.set_ylabel("Change of natural frequency [%]")
        below.set_xlabel("Recording")
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
        for axis in drawn.axes[:, 0]:
            look.lattice(axis)
        named = look.legend(above)
        if modes <= _NAMED or look.show_legend:
            look.legend(below)
        return drawn.finished("Changes from the reference", named)

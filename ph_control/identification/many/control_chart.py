"""Control chart: has the plant changed in the course of many recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import control as ct
import numpy as np
from scipy.special import chdtrc

from ..._display import Report, aligned, counted, p_value
from ..._frozen import Frozen
from ..._types import Array, Indices
from ..change.cumulative_sum import average_run, limit_for, next_sum
from ..change.score import Score
from .chart_plot import chart_plot

_SHOWN = 40  # lines of a table, beyond which its middle is left out


@dataclass(frozen=True, eq=False, repr=False)
class ControlChart(Report, Frozen):
    """Cumulative sum of the scores of many recordings against a reference; made by `FitTable.changes`.

    Attributes
    ----------
    recordings : ndarray of int, shape (k,)
        Places of the recordings that have a score.
    names : tuple of str
        Their names.
    statistic : ndarray, shape (k,)
        Size of the cumulative sum after each.
    limit : float
        Size beyond which it alarms.
    false_alarm_rate : float
        False alarms for each recording, where nothing changes: the inverse of the mean number of recordings up to the
        first.
    shift : float
        Size of a lasting shift that the chart finds soonest, in standard deviations of the score of a recording.
    start : int or None
        Recording from which on a lasting shift makes the scores up to the first alarm likeliest; None without an alarm.
    p : ndarray, shape (k,)
        p-value of each recording by itself, held against the reference and the recordings before.
    hertz : ndarray, shape (n,)
        Natural frequencies of the reference.
    frequency_shift, frequency_shift_stderr : ndarray, shape (k, n)
        Relative change of each frequency from the reference, with the standard error of both; NaN where a recording
        does not tell.
    unavailable : tuple of (int, str)
        Recordings without a score, and why.
    frequency_unit : str
        Unit of `hertz`.

    Examples
    --------
    See `FitTable.changes`.
    """

    recordings: Indices
    names: tuple[str, ...]
    statistic: Array
    limit: float
    false_alarm_rate: float
    shift: float
    start: int | None
    p: Array
    hertz: Array
    frequency_shift: Array
    frequency_shift_stderr: Array
    unavailable: tuple[tuple[int, str], ...]
    frequency_unit: str

    @property
    def alarms(self) -> Indices:
        """Recordings at which the cumulative sum is beyond the limit."""
        return self.recordings[self.statistic > self.limit]

    def _headline(self) -> str:
        rate = f"one false alarm in {1 / self.false_alarm_rate:.0f} recordings without a change"
        said = f"alarm at recording {self.alarms[0]}, begun at {self.start}" if len(self.alarms) else "no alarm"
        return f"{said} in {counted(len(self.recordings), 'recording')}; limit {self.limit:.3g}: {rate}"

    def __str__(self) -> str:
        """Headline, and a line for each recording; a star marks those beyond the limit."""
        rows = [["recording", "sum", "p", *(f"shift of {f:.4g} {self.frequency_unit} %" for f in self.hertz), "name"]]
        for k, place in enumerate(self.recordings.tolist()):
            size = f"{self.statistic[k]:.2f}" + "*" * bool(self.statistic[k] > self.limit)
            shifts = ("-" if np.isnan(shift) else f"{100 * shift:+.3f}" for shift in self.frequency_shift[k])
            rows.append([str(place), size, p_value(self.p[k]).removeprefix("p = "), *shifts, self.names[k]])
        titles, *lines = aligned(rows)
        if len(lines) > _SHOWN:
            lines = [*lines[: _SHOWN // 2], f"  ... {len(lines) - _SHOWN} more ...", *lines[-_SHOWN // 2 :]]
        missing = [f"  recording {place} has no score: {reason}" for place, reason in self.unavailable]
        return "\n".join([self._headline(), titles, *lines, *missing])

    def plot(self, **kwargs: Any) -> ct.ControlPlot:
        """Cumulative sum with its limit, above the shifts of the frequencies with 95 % bars.

        Parameters
        ----------
        **kwargs
            `ax`, an array of two axes, and `title`, `grid`, `show_legend`, `legend_loc`, `rcParams`.

        Returns
        -------
        control.ControlPlot
            `axes` of shape (2, 1).

        Raises
        ------
        StructureError
            If an argument is not of this form.

        Examples
        --------
        >>> import numpy as np, matplotlib.pyplot as plt, ph_control as phc
        >>> def recording(seed):
        ...     rng = np.random.default_rng(seed)
        ...     plant, u = phc.ph(phc.modes(1.0, 1.0, damping=0.01)), rng.standard_normal(300)
        ...     y = phc.forced_response(plant, 0.5 * np.arange(300), u, intersample="zoh").outputs
        ...     return u, y + rng.standard_normal(300)
        >>> plot = phc.fit_many([recording(seed) for seed in range(4)], order=1, dt=0.5).changes().plot()
        >>> [axis.get_ylabel() for axis in plot.axes[:, 0]]
        ['Cumulative sum of scores', 'Change of natural frequency [%]']
        >>> plt.close(plot.figure)
        """
        return chart_plot(self, **kwargs)


def chart_of(
    scores: Sequence[Score | str], names: Sequence[str], hertz: Array, unit: str, false_alarms: float,
    shift: float,
) -> ControlChart:  # fmt: skip
    """Control chart of the scores of recordings, or of the reasons why there is none.

    Directions of a score are the natural frequencies in Hz and the damping ratios of the reference.
    """
    seen = [(place, score) for place, score in enumerate(scores) if isinstance(score, Score)]
    dimensions = seen[0][1].score.size if seen else 1
    allowance = 0.5 * shift
    limit = limit_for(1 / false_alarms, allowance, dimensions)
    sizes, p, first = _sums([score for _, score in seen], dimensions, allowance, limit)
    shifts = [_frequency_shifts(score, hertz) for _, score in seen]
    each = np.array(shifts, float).reshape(len(seen), 2, len(hertz))
    return ControlChart(
        recordings=np.array([place for place, _ in seen], int), names=tuple(names[place] for place, _ in seen),
        statistic=sizes, limit=limit, false_alarm_rate=1 / average_run(limit, allowance, dimensions), shift=shift,
        start=None if first is None else seen[first][0], p=p, hertz=hertz, frequency_shift=each[:, 0],
        frequency_shift_stderr=each[:, 1],
        unavailable=tuple((place, score) for place, score in enumerate(scores) if isinstance(score, str)),
        frequency_unit=unit,
    )  # fmt: skip


def _sums(scores: Sequence[Score], dimensions: int, allowance: float, limit: float) -> tuple[Array, Array, int | None]:
    """Size of the cumulative sum after each recording, the p-value of each, and where the first alarm began.

    All recordings are held against one reference, whose error they share: each is held against the estimate from the
    reference and the recordings before it, so that they are independent.  After an alarm that estimate stays.
    """
    total, mean, precision = np.zeros(dimensions), np.zeros(dimensions), np.eye(dimensions)
    sizes, p, steps = [], [], list[Array]()
    start: int | None = None
    for recording in scores:
        F = recording.information
        step, rank = recording.standardised(mean, np.asarray(np.linalg.inv(precision)))
        p.append(float(chdtrc(rank, step @ step)) if rank else np.nan)
        total = next_sum(total, step, allowance)
        sizes.append(float(np.linalg.norm(total)))
        steps.append(step)
        if start is None and sizes[-1] > limit:
            start = _likely_start(np.array(steps))
        if start is None:
            mean = np.asarray(np.linalg.solve(precision + F, precision @ mean + recording.score))
            precision = precision + F
    return np.array(sizes), np.array(p), start


def _likely_start(steps: Array) -> int:
    """Place from which on one mean of all steps (k, q) makes these likeliest."""
    tails = np.cumsum(steps[::-1], axis=0)[::-1]
    return int(np.argmax(np.sum(tails**2, axis=1) / np.arange(len(steps), 0, -1.0)))


def _frequency_shifts(recording: Score, hertz: Array) -> tuple[Array, Array]:
    """Relative change (n,) of each frequency, and its standard error; NaN where a recording does not tell."""
    change, root, seen = replace(recording, directions=recording.directions[: len(hertz)]).step()
    error = np.linalg.norm(root, axis=1)
    known = seen & (error > 0)
    return np.where(known, change / hertz, np.nan), np.where(known, error / hertz, np.nan)

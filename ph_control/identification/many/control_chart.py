"""Control chart: has the plant changed in the course of many recordings.

Scores of recordings against one reference are tests of its poles, or differences of fitted ones.  In their cumulative
sum (Crosier 1988) small shifts that last add up, and what no shift makes is taken off.

    c = |S + u|,        S+ = (S + u) max(0, 1 - k / c)        u standard normal in q dimensions if nothing has changed

It alarms where `|S|` exceeds the limit h.  The next size depends on the last one only, as `|S + u|^2` is noncentral
chi-square: how long it runs without a false alarm is a Markov chain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import control as ct
import numpy as np
from matplotlib.ticker import MaxNLocator
from scipy.special import chdtrc, chndtr, ndtri

from ..._display import Report, aligned, counted, p_value
from ..._frozen import Frozen
from ..._types import Array, Indices, Unpack
from ..._units import hertz_size
from ...exceptions import StructureError
from ...plotting.style import ZERO, AxesGiven, FrameStyle, Look, picture
from ..change.score_test import ChangeTest, Score
from ..estimates.sensitivities import known_parameters, root_of_covariance
from .recordings import Modes

_SHOWN = 40  # lines of a table, beyond which its middle is left out

# the limit of a chart
_CELLS = 80  # of the sizes up to the limit
_ROUNDS = 60  # of a bisection

# the picture
_NAMED = 8  # modes up to which there is a legend
_BARS = float(ndtri(0.975))


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
        return _chart_plot(self, **kwargs)


def _chart_of(
    scores: Sequence[Score | str], names: Sequence[str], hertz: Array, unit: str, false_alarms: float,
    shift: float,
) -> ControlChart:  # fmt: skip
    """Control chart of the scores of recordings, or of the reasons why there is none.

    Directions of a score are the natural frequencies in Hz and the damping ratios of the reference.
    """
    seen = [(place, score) for place, score in enumerate(scores) if isinstance(score, Score)]
    dimensions = seen[0][1].score.size if seen else 1
    allowance = 0.5 * shift
    limit = _limit_for(1 / false_alarms, allowance, dimensions)
    sizes, p, first = _sums([score for _, score in seen], dimensions, allowance, limit)
    shifts = [_frequency_shifts(score, hertz) for _, score in seen]
    each = np.array(shifts, float).reshape(len(seen), 2, len(hertz))
    return ControlChart(
        recordings=np.array([place for place, _ in seen], int), names=tuple(names[place] for place, _ in seen),
        statistic=sizes, limit=limit, false_alarm_rate=1 / _average_run(limit, allowance, dimensions), shift=shift,
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
        total = _next_sum(total, step, allowance)
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


def chart_of_recordings(fits: Any, false_alarms: float, shift: float) -> ControlChart:
    """Control chart of the recordings of a table."""
    recordings: tuple[Modes, ...] = fits.recordings
    names = [modes.name for modes in recordings]
    tests = [modes.score for modes in recordings if isinstance(modes.score, ChangeTest)]
    scores: list[Score | str]
    if tests:
        hertz = np.array(tests[0].hertz)
        scores = [_of_test(modes.score) if isinstance(modes.score, ChangeTest) else modes.score for modes in recordings]
    else:
        hertz, scores = _of_fits(fits, recordings)
    if not any(isinstance(score, Score) for score in scores):
        reasons = "; ".join(dict.fromkeys(map(str, scores))) or "there are none"
        raise StructureError(f"no recording can be held against a reference: {reasons}")
    return _chart_of(scores, names, hertz, fits.frequency_unit, false_alarms, shift)


def _of_test(test: ChangeTest) -> Score:
    n, count = len(test.natural_frequencies), len(test.pole_directions) // 2
    places = np.concatenate([np.arange(n), count + np.arange(n)])
    directions = test.pole_directions[places].copy()
    directions[:n] /= hertz_size(test.time_unit)
    return Score(test.score, test.information, directions)


def _of_fits(fits: Any, recordings: tuple[Modes, ...]) -> tuple[Array, list[Score | str]]:
    """Frequencies of the first recording with modes, and differences of fitted poles from its own."""
    fitted = [place for place, modes in enumerate(recordings) if modes.order > 0]
    if not fitted:
        return np.zeros(0), [modes.message for modes in recordings]
    first = recordings[fitted[0]]
    root, known = _root(first.covariance)
    ids, table = fits.track(shortest=1).ids, fits.table
    rows = [ids[table["recording"] == number] for number in np.unique(table["recording"])]
    scores: list[Score | str] = []
    for place, modes in enumerate(recordings):
        if place == fitted[0]:
            scores.append("it is the reference")
        elif modes.order <= 0:
            scores.append(modes.message)
        else:
            scores.append(_difference(first, modes, _partners(rows[fitted[0]], rows[place]), root, known))
    return first.numbers[:, 0], scores


def _partners(reference: Indices, recording: Indices) -> list[tuple[int, int]]:
    """Modes of the reference and of a recording that are the same."""
    return [(k, int(np.flatnonzero(recording == mode)[0])) for k, mode in enumerate(reference) if mode in recording]


def _difference(
    reference: Modes, modes: Modes, partners: list[tuple[int, int]], root: Array, known: Indices
) -> Score | str:  # fmt: skip
    """Score of the poles of a fit at those of the reference, in units of the errors of these."""
    n, other = reference.order, modes.order
    places = np.array([(k + part * n, l + part * other) for part in (0, 1) for k, l in partners], int).reshape(-1, 2)
    usable = np.isin(places[:, 0], known) & (np.diag(modes.covariance)[places[:, 1]] > 0)
    places = places[usable]
    if not len(places):
        return "it has no mode of the reference"
    change = modes.numbers[:, ::2].T.ravel()[places[:, 1]] - reference.numbers[:, ::2].T.ravel()[places[:, 0]]
    covariance = modes.covariance[np.ix_(places[:, 1], places[:, 1])]
    sizes = np.sqrt(np.diag(covariance))
    inverse = np.linalg.pinv(covariance / np.outer(sizes, sizes), hermitian=True) / np.outer(sizes, sizes)
    own = root[places[:, 0]]
    return Score(own.T @ (inverse @ change), own.T @ inverse @ own, root)


def _root(covariance: Array) -> tuple[Array, Indices]:
    """Square root (2n, q) of the covariance of the reference, 0 where nothing is known, and what is known."""
    known = known_parameters(covariance)
    if not len(known):
        raise StructureError("the first recording has no errors of its modes, and cannot be a reference: pass one")
    inner = root_of_covariance(covariance, known)
    root = np.zeros((len(covariance), inner.shape[1]))
    root[known] = inner
    return root, known


def _next_sum(sum: Array, step: Array, allowance: float) -> Array:
    """The cumulative sum (q,) after one step."""
    moved = sum + step
    size = float(np.linalg.norm(moved))
    return moved * max(0.0, 1.0 - allowance / size) if size > 0 else moved


def _average_run(limit: float, allowance: float, dimensions: int) -> float:
    """Mean number of steps from 0 to the first alarm, where nothing has changed; O(80^3)."""
    edges = limit * np.arange(_CELLS + 1) / _CELLS
    middles = np.concatenate([[0.0], 0.5 * (edges[1:] + edges[:-1])])
    reached = chndtr((allowance + edges[None]) ** 2, dimensions, middles[:, None] ** 2)
    # the first state is a sum of exactly 0
    steps = np.concatenate([reached[:, :1], np.diff(reached, axis=1)], axis=1)
    return float(np.linalg.solve(np.eye(len(steps)) - steps, np.ones(len(steps)))[0])


def _limit_for(run: float, allowance: float, dimensions: int) -> float:
    """Limit at which the mean number of steps to a false alarm is as given."""
    low, high = 0.0, 1.0
    while _average_run(high, allowance, dimensions) < run:
        low, high = high, 2 * high
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _average_run(middle, allowance, dimensions) < run else (low, middle)
        if high - low <= 1e-6 * high:
            break
    return high


def _chart_plot(chart: ControlChart, ax: AxesGiven = None, **style: Unpack[FrameStyle]) -> ct.ControlPlot:
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

"""The modes of many recordings as one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import control as ct
import numpy as np

from ... import _checks
from ..._display import Report, aligned, counted, with_error
from ..._frozen import Frozen
from ..._types import ComplexArray, NDArray
from ...exceptions import MissingPackageError, StructureError
from .control_chart import ControlChart, chart_of_recordings
from .recordings import Modes
from .tracking import ModeTracks, followed

if TYPE_CHECKING:
    import pandas

TableKind = Literal["tracks", "changes"]

_SHOWN = 40  # rows, beyond which the middle of a table is left out
_WIDEST = 40  # letters of a message in a table


@dataclass(frozen=True, eq=False, repr=False)
class FitTable(Report, Frozen):
    """Modes of many recordings; made by `fit_many`.

    Attributes
    ----------
    table : ndarray, structured, shape (rows,)
        One row for each recording and mode, with the fields below.  A recording without a mode, and one that failed,
        has one row with `mode` -1 and NaN.
    shapes : tuple of ndarray of complex
        Mode shape of each row, of as many entries as there are outputs; empty where there is no mode.
    complete : bool
        Whether all recordings are in it; not after an interruption.
    frequency_unit : str
        Unit of `hertz`: "Hz", or "1/time" where a recording does not tell its unit of time.
    recordings : tuple of Modes
        Modes of each recording with their covariance, and its test against the reference of `fit_many`.

    Notes
    -----
    Fields of `table` are "recording", its place, counted from 0; "name"; "mode", from 0; "hertz" and "damping_ratio",
    each followed by its standard error, "hertz_stderr" and "damping_ratio_stderr"; "fit_percent"; "structure"; "order",
    the number of modes, -1 where the fit failed; "message", its verdict or what went wrong; "result", the name of the
    file in the store, empty without one.  Where the table is printed, modes count from 1, as in summaries of fits.

    Examples
    --------
    See `fit_many`.
    """

    table: NDArray[np.void]
    shapes: tuple[ComplexArray, ...]
    complete: bool
    frequency_unit: str = "Hz"
    recordings: tuple[Modes, ...] = ()

    def __len__(self) -> int:
        return len(self.table)

    @property
    def failures(self) -> NDArray[np.void]:
        """Rows of the recordings that could not be fitted, with their messages."""
        return self.table[self.table["order"] < 0]

    def to_pandas(self) -> pandas.DataFrame:
        """Table as a data frame of pandas.

        Returns
        -------
        pandas.DataFrame
            One column for each field.

        Raises
        ------
        MissingPackageError
            If pandas is not installed.

        Examples
        --------
        >>> import ph_control as phc
        >>> fits = phc.fit_many(["no such file.csv"])
        >>> try:
        ...     print(fits.to_pandas().shape)
        ... except phc.MissingPackageError:
        ...     print((1, 12))
        (1, 12)
        """
        try:
            import pandas
        except ImportError:
            raise MissingPackageError(
                "a data frame needs pandas, which is not installed: pip install pandas, or use the field table"
            ) from None
        return pandas.DataFrame({name: self.table[name] for name in self.table.dtype.names or ()})

    def track(
        self, *, frequency_tolerance: float = 0.05, least_mac: float = 0.5, window: int = 20, gap: int = 10,
        shortest: int = 2,
    ) -> ModeTracks:  # fmt: skip
        """Follow modes from recording to recording, by their frequencies and their shapes.

        Parameters
        ----------
        frequency_tolerance : float
            Relative distance that a frequency may have from where its mode is expected.
        least_mac : float
            Least mean of the modal assurance between a shape and the last ones of its mode, where there are several
            outputs.
        window : int
            Number of recordings whose trend tells where a mode is expected, and whose shapes it is compared with: more
            than those in which two modes are too close to be told apart.
        gap : int
            Number of recordings in which a mode may be missing, before it is given up.
        shortest : int
            Least number of recordings a mode is in; what is in fewer is followed by nothing.

        Returns
        -------
        ModeTracks
            The number of its mode for each row of the table, with a picture.

        Raises
        ------
        StructureError
            If a number is out of range.

        Notes
        -----
        In each recording modes are assigned to those followed so that as many as can be are, and the sum of relative
        distances in frequency and of `1 - MAC` is least.  A mode is expected on the line through its last frequencies
        of the median slope, so that modes may cross: with several outputs their shapes tell them apart, with one output
        their trends do, as far as these differ by more than the errors over the window.  O(window^2) a mode and
        recording.

        Examples
        --------
        See `fit_many`.
        """
        for name, value in (("frequency_tolerance", frequency_tolerance), ("least_mac", least_mac)):
            _checks.between(name, value, 0.0, 1.0)
        for name, count in (("window", window), ("gap", gap), ("shortest", shortest)):
            _checks.whole_number(name, count, 0 if name == "gap" else 1)
        ids = followed(self.table, self.shapes, frequency_tolerance, least_mac, window, gap, shortest)
        return ModeTracks(self.table, ids, self.frequency_unit)

    def changes(self, *, false_alarms: float = 0.001, shift: float = 1.0) -> ControlChart:
        """Control chart of the recordings: cumulative sum of their scores against the reference.

        Parameters
        ----------
        false_alarms : float
            False alarms for each recording, where nothing changes: with 0.001 the first comes after 1000 recordings in
            the mean.
        shift : float
            Size of a lasting shift that is to be found soonest, in standard deviations of the score of a recording.

        Returns
        -------
        ControlChart
            The sum after each recording, its limit, alarms, and the shift of each frequency.

        Raises
        ------
        StructureError
            If a number is out of range, or no recording has a score.

        See Also
        --------
        PEMResult.changed : tests one record.

        Notes
        -----
        With the `reference` of `fit_many` the scores are those of its poles on each recording.  Without one the first
        recording that could be fitted is the reference, and the differences of fitted poles take the place of scores,
        of modes that `track` follows from it.

        All recordings share the error of the reference.  So each is held against the best estimate from the reference
        and the recordings before it, `u = (F + F P F)^(-1/2) (z - F m)`, which makes the u independent and standard
        normal if nothing changes, whatever the length of the reference.  After the first alarm that estimate stays.
        The sum is that of Crosier, `S = (S + u) max(0, 1 - k / |S + u|)` with `k = shift / 2`; its limit comes from
        the Markov chain of `|S|`, which is exact for normal scores.  A change right after a short reference is found
        late, as it may be an error of this: fit several recordings together for the reference.  O(q^3) for each
        recording with q poles, and 0.2 s for the limit.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> def recording(d, seed):
        ...     rng = np.random.default_rng(seed)
        ...     plant, u = phc.ph(phc.modes(d, 1.0, damping=0.01)), rng.standard_normal(500)
        ...     y = phc.forced_response(plant, 0.5 * np.arange(500), u, intersample="zoh").outputs
        ...     return u, y + 0.5 * rng.standard_normal(500)
        >>> reference = phc.pem([recording(1.0, seed) for seed in range(3)], 1, dt=0.5)
        >>> frequencies = [1.0] * 5 + [0.998] * 3
        >>> fits = phc.fit_many(
        ...     [recording(d, 10 + k) for k, d in enumerate(frequencies)], order=1, dt=0.5, reference=reference
        ... )
        >>> chart = fits.changes()
        >>> chart.alarms, chart.start, round(chart.false_alarm_rate, 4)
        (array([5, 6, 7]), 5, 0.001)
        """
        for name, value, most in (("false_alarms", false_alarms, 0.1), ("shift", shift, 100.0)):
            if not (_checks.is_number(value) and 0 < value <= most):
                raise StructureError(f"{name} is {_checks.shown(value)}; expected a number above 0, up to {most:g}")
        return chart_of_recordings(self, float(false_alarms), float(shift))

    def plot(self, *, kind: TableKind = "tracks", **kwargs: Any) -> ct.ControlPlot:
        """Natural frequencies and damping ratios against the recordings, or the control chart of their changes.

        Parameters
        ----------
        kind : {'tracks', 'changes'}
            Modes followed as by `track()`, or the chart of `changes()`.
        **kwargs
            As for `ModeTracks.plot`, or `ControlChart.plot`.

        Returns
        -------
        control.ControlPlot
            As that of `ModeTracks.plot`, or `ControlChart.plot`.

        Raises
        ------
        StructureError
            If there is no such kind, or as `changes`.

        Examples
        --------
        See `ModeTracks`, and `FitTable.changes`.
        """
        if _checks.choice("kind", kind, get_args(TableKind)) == "changes":
            return self.changes().plot(**kwargs)
        return self.track().plot(**kwargs)

    def __str__(self) -> str:
        """Headline, and a line for each row; of a long table both ends and what failed."""
        rows = np.arange(len(self.table))
        if len(rows) > _SHOWN:
            failed = np.flatnonzero(self.table["order"] < 0)[:_SHOWN]
            rows = np.unique(np.concatenate([rows[: _SHOWN // 2], failed, rows[-_SHOWN // 2 :]]))
        unit = self.frequency_unit
        titles, *lines = aligned([["recording", "mode", unit, "+-", "damping %", "+-", "fit %", "structure", "message"],
                                  *(_cells(self.table[k]) for k in rows)])  # fmt: skip
        left_out = np.diff(rows, prepend=-1) - 1
        shown = [
            text
            for count, line in zip(left_out, lines, strict=True)
            for text in ([f"  ... {count} more ..."] if count else []) + [line]
        ]
        return "\n".join([self._headline(), titles, *shown])

    def _headline(self) -> str:
        modes, recordings = int((self.table["mode"] >= 0).sum()), len(np.unique(self.table["recording"]))
        failed = f", {len(self.failures)} failed" if len(self.failures) else ""
        rest = "" if self.complete else ", interrupted"
        return f"{counted(modes, 'mode')} of {counted(recordings, 'recording')}{failed}{rest}"


def table_of(modes: Mapping[int, Modes], complete: bool) -> FitTable:
    """Table of what was found of each recording, by its place."""
    rows, shapes = [], []
    for place in sorted(modes):
        recording = modes[place]
        seen = [(-1, np.full(4, np.nan), np.zeros(0, complex))]
        if recording.order > 0:
            seen = list(zip(range(recording.order), recording.numbers, recording.shapes, strict=True))
        for mode, numbers, shape in seen:
            rows.append((
                place, recording.name, mode, *numbers, recording.fit_percent, recording.structure, recording.order,
                recording.message, recording.file,
            ))  # fmt: skip
            shapes.append(shape)
    widths = {k: max([1, *(len(row[k]) for row in rows)]) for k in (1, 8, 10, 11)}
    kinds = {
        "recording": "i8", "name": f"U{widths[1]}", "mode": "i4", "hertz": "f8", "hertz_stderr": "f8",
        "damping_ratio": "f8", "damping_ratio_stderr": "f8", "fit_percent": "f8", "structure": f"U{widths[8]}",
        "order": "i4", "message": f"U{widths[10]}", "result": f"U{widths[11]}",
    }  # fmt: skip
    known = all(recording.time_unit for recording in modes.values() if recording.order > 0)
    table = np.array(rows, dtype=list(kinds.items()))
    every = tuple(modes[place] for place in sorted(modes))
    return FitTable(table, tuple(shapes), complete, "Hz" if known else "1/time", every)


def _cells(row: Any) -> list[str]:
    """Texts of a row."""
    message = " ".join(row["message"].split())
    message = message if len(message) <= _WIDEST or row["order"] < 0 else message[: _WIDEST - 3] + "..."
    if row["mode"] < 0:
        return [row["name"], "-", "-", "", "-", "", "-", row["structure"], message]
    fit = f"{row['fit_percent']:.2f}"
    return [row["name"], str(row["mode"] + 1), *with_error(row["hertz"], row["hertz_stderr"]),
            *with_error(100 * row["damping_ratio"], 100 * row["damping_ratio_stderr"]), fit, row["structure"],
            message]  # fmt: skip

"""Two fits side by side: modes paired by frequency and shape, and what has shifted beyond its error.

The p-values of several tests are judged together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import erfc

from ... import _checks
from ..._display import Report, aligned, counted, starred, with_error
from ..._frozen import Frozen
from ..._types import Array, Indices, Mask
from ..._units import common_unit, hertz_size, rate

_FACTOR = 2.0  # by which real poles that are a pair may differ


@dataclass(frozen=True, eq=False, repr=False)
class ModeComparison(Report, Frozen):
    """Modes and real poles of two fits, paired, and their shifts over the errors; made by `PEMResult.compare`.

    Attributes
    ----------
    pairs : ndarray of int, shape (k, 2)
        Modes of the fit before and of the one after that are a pair, counted from 0, by their frequencies.
    mac : ndarray, shape (k,)
        Modal assurance criterion of each pair; NaN where shapes have a single entry, or other outputs.
    hertz : ndarray, shape (k, 2)
        Natural frequencies of each pair in Hz, before and after; times of unknown unit count as seconds.
    hertz_stderr : ndarray, shape (k, 2)
        Their standard errors.
    damping_ratios, damping_ratio_stderr : ndarray, shape (k, 2)
        Damping ratios of each pair and their standard errors.
    real_pole_pairs : ndarray of int, shape (r, 2)
        Places among `real_poles` of both fits.
    real_poles, real_pole_stderr : ndarray, shape (r, 2)
        Real poles of each pair, per unit time, and their standard errors.
    frequency_z, damping_z, real_pole_z : ndarray, shapes (k,), (k,), (r,)
        Shift over its standard error; NaN where no error is known.
    frequency_p, damping_p, real_pole_p : ndarray, shapes (k,), (k,), (r,)
        Probability of a shift as large by chance, each by itself.
    adjusted_frequency_p, adjusted_damping_p, adjusted_real_pole_p : ndarray, shapes (k,), (k,), (r,)
        The same for all these tests together, by the method of Holm.
    only_before, only_after : ndarray of int, shape (j,)
        Modes of one fit without a partner in the other.
    real_poles_only_before, real_poles_only_after : ndarray of int, shape (j,)
        Real poles of one fit without a partner in the other.
    hertz_only_before, hertz_only_after : ndarray, shape (j,)
        Natural frequencies in Hz of the modes without a partner.
    level : float
        Probability of any false shift; adjusted p-values below it count as shifts.
    time_unit : str or None
        Unit of time of the data.

    Examples
    --------
    See `PEMResult.compare`.
    """

    pairs: Indices
    mac: Array
    hertz: Array
    hertz_stderr: Array
    damping_ratios: Array
    damping_ratio_stderr: Array
    real_pole_pairs: Indices
    real_poles: Array
    real_pole_stderr: Array
    frequency_z: Array
    damping_z: Array
    real_pole_z: Array
    frequency_p: Array
    damping_p: Array
    real_pole_p: Array
    adjusted_frequency_p: Array
    adjusted_damping_p: Array
    adjusted_real_pole_p: Array
    only_before: Indices
    only_after: Indices
    real_poles_only_before: Indices
    real_poles_only_after: Indices
    hertz_only_before: Array
    hertz_only_after: Array
    level: float
    time_unit: str | None

    @property
    def frequency_shift(self) -> Array:
        """Relative change of each frequency, shape (k,)."""
        return self.hertz[:, 1] / self.hertz[:, 0] - 1.0

    @property
    def shifted(self) -> Indices:
        """Modes of the fit before whose frequency or damping ratio has shifted."""
        least = np.fmin(self.adjusted_frequency_p, self.adjusted_damping_p)
        return self.pairs[least < self.level, 0]

    @property
    def changed(self) -> bool:
        """Whether any frequency, damping ratio or real pole has shifted, or a mode or pole has no partner."""
        alone = self.only_before, self.only_after, self.real_poles_only_before, self.real_poles_only_after
        return bool(len(self.shifted) or np.any(self.adjusted_real_pole_p < self.level) or sum(map(len, alone)))

    def _headline(self) -> str:
        shifted = len(self.shifted) + int(np.sum(self.adjusted_real_pole_p < self.level))
        pairs = len(self.pairs) + len(self.real_pole_pairs)
        alone = [
            f"{len(modes) + len(poles)} only {when}"
            for modes, poles, when in (
                (self.only_before, self.real_poles_only_before, "before"),
                (self.only_after, self.real_poles_only_after, "after"),
            )
            if len(modes) + len(poles)
        ]
        return ", ".join([f"{counted(shifted, 'shift')} in {counted(pairs, 'pair')} of modes and poles", *alone])

    def __str__(self) -> str:
        """Headline, a line for each pair, and what has no partner; a star marks a shift, p-values are adjusted."""
        unit = "1/time" if self.time_unit is None else "Hz"
        lines = [self._headline()]
        if len(self.pairs):
            head = ["mode", f"before {unit}", "+-", "after", "+-", "shift %", "z", "p", "damping % before", "+-",
                    "after", "+-", "z", "p", "MAC"]  # fmt: skip
            lines += aligned([head, *(self._mode_cells(k) for k in range(len(self.pairs)))])
        if len(self.real_pole_pairs):
            head = ["real pole", f"before {rate(self.time_unit).replace('rad', '1')}", "+-", "after", "+-", "z", "p"]
            lines += aligned([head, *(self._pole_cells(k) for k in range(len(self.real_pole_pairs)))])
        for when, modes, hertz, poles in (
            ("before", self.only_before, self.hertz_only_before, self.real_poles_only_before),
            ("after", self.only_after, self.hertz_only_after, self.real_poles_only_after),
        ):
            names = [f"mode {k + 1} ({f:.6g} {unit})" for k, f in zip(modes, hertz, strict=True)]
            names += [f"real pole {k + 1}" for k in poles]
            lines += [f" only {when}: {', '.join(names)}"] * bool(names)
        return "\n".join(lines)

    def _mode_cells(self, k: int) -> list[str]:
        before, after = self.pairs[k] + 1
        name = str(before) if before == after else f"{before} > {after}"
        damping = 100 * self.damping_ratios[k], 100 * self.damping_ratio_stderr[k]
        return [
            name, *_both(self.hertz[k], self.hertz_stderr[k]), f"{100 * self.frequency_shift[k]:+.3f}",
            _number(self.frequency_z[k]), self._p(self.adjusted_frequency_p[k]), *_both(*damping),
            _number(self.damping_z[k]), self._p(self.adjusted_damping_p[k]),
            "-" if np.isnan(self.mac[k]) else f"{self.mac[k]:.3f}",
        ]  # fmt: skip

    def _pole_cells(self, k: int) -> list[str]:
        before, after = self.real_pole_pairs[k] + 1
        name = str(before) if before == after else f"{before} > {after}"
        return [name, *_both(self.real_poles[k], self.real_pole_stderr[k]), _number(self.real_pole_z[k]),
                self._p(self.adjusted_real_pole_p[k])]  # fmt: skip

    def _p(self, p: float) -> str:
        return starred(p, self.level)


def _both(values: Array, errors: Array) -> list[str]:
    return [cell for each in zip(values.tolist(), errors.tolist(), strict=True) for cell in with_error(*each)]


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:+.2f}"


def compared_modes(
    before: Any, after: Any, frequency_tolerance: float, least_mac: float, level: float
) -> ModeComparison:
    """Pair modes and real poles of two results, and hold their shifts against their errors."""
    for name, value in (("frequency_tolerance", frequency_tolerance), ("least_mac", least_mac)):
        _checks.between(name, value, 0.0, 1.0)
    level = _checks.level("level", level)
    unit = common_unit(before, after)
    alike = before.mac(after) if _have_same_outputs(before, after) else None
    pairs = _mode_pairs(before, after, alike, frequency_tolerance, least_mac)
    poles = _real_pole_pairs(before.real_poles, after.real_poles)
    size = hertz_size(unit)
    both = before, after

    def values(name: str, places: Indices, scale: float = 1.0) -> tuple[Array, Array]:
        """Values (k, 2) of the pairs, and their standard errors."""
        columns = [np.asarray(getattr(result, name))[places[:, k]] for k, result in enumerate(both)]
        errors = [np.asarray(result.stderr[name])[places[:, k]] for k, result in enumerate(both)]
        return np.stack(columns, axis=1) / scale, np.stack(errors, axis=1) / scale

    hertz, hertz_errors = values("natural_frequencies", pairs, size)
    damping, damping_errors = values("damping_ratios", pairs)
    real, real_errors = values("real_poles", poles)
    z = [_over_errors(*each) for each in ((hertz, hertz_errors), (damping, damping_errors), (real, real_errors))]
    p = [two_sided(each) for each in z]
    ends = np.cumsum([len(each) for each in p])[:-1]
    adjusted = np.split(holm(np.concatenate(p)), ends)
    alone = [np.setdiff1d(np.arange(result.order), pairs[:, k]) for k, result in enumerate(both)]
    poles_alone = [np.setdiff1d(np.arange(len(result.real_poles)), poles[:, k]) for k, result in enumerate(both)]
    lonely = [result.natural_frequencies[places] / size for result, places in zip(both, alone, strict=True)]
    return ModeComparison(
        pairs=pairs, mac=np.full(len(pairs), np.nan) if alike is None else alike[pairs[:, 0], pairs[:, 1]],
        hertz=hertz, hertz_stderr=hertz_errors, damping_ratios=damping, damping_ratio_stderr=damping_errors,
        real_pole_pairs=poles, real_poles=real, real_pole_stderr=real_errors,
        frequency_z=z[0], damping_z=z[1], real_pole_z=z[2], frequency_p=p[0], damping_p=p[1], real_pole_p=p[2],
        adjusted_frequency_p=adjusted[0], adjusted_damping_p=adjusted[1], adjusted_real_pole_p=adjusted[2],
        only_before=alone[0], only_after=alone[1], real_poles_only_before=poles_alone[0],
        real_poles_only_after=poles_alone[1], hertz_only_before=lonely[0], hertz_only_after=lonely[1],
        level=level, time_unit=unit,
    )  # fmt: skip


def _have_same_outputs(before: Any, after: Any) -> bool:
    """Whether shapes of two results compare: over several outputs, or over several inputs of one output."""
    shapes = [(len(result.output_labels), len(result.input_labels)) for result in (before, after)]
    (outputs, inputs), (others, other_inputs) = shapes
    if outputs != others:
        return False
    return outputs > 1 or (inputs > 1 and inputs == other_inputs)


def _mode_pairs(before: Any, after: Any, alike: Array | None, tolerance: float, least_mac: float) -> Indices:
    """Pairs (k, 2) of modes: as many as can be within the bounds, then the nearest in frequency and shape."""
    d, other = before.natural_frequencies[:, None], after.natural_frequencies[None]
    distance = np.abs(np.log(d / other)) / np.log1p(tolerance)
    unlike = np.zeros(distance.shape) if alike is None else 1.0 - alike
    within = (distance <= 1.0) & (unlike <= 1.0 - least_mac)
    return _assigned(distance + unlike, within)


def _real_pole_pairs(before: Array, after: Array) -> Indices:
    """Pairs (k, 2) of real poles of one sign whose sizes differ by a factor of 2 at most; poles at 0 are pairs."""
    a, b = before[:, None], after[None]
    both_zero, nonzero = (a == 0) & (b == 0), (a * b) > 0
    ratio = np.abs(np.where(nonzero, a, 1.0) / np.where(nonzero, b, 1.0))
    distance = np.abs(np.log(ratio)) / np.log(_FACTOR)
    return _assigned(distance, both_zero | (nonzero & (distance <= 1.0)))


def _assigned(distance: Array, allowed: Mask) -> Indices:
    """Pairs (k, 2) of the least sum of distances, each from 0 to 2, among the largest numbers of allowed pairs."""
    pair = 2.0 * max(distance.shape) + 1.0  # outweighs all distances together
    cost = np.where(allowed, distance - pair, 0.0)
    rows, columns = linear_sum_assignment(cost)
    kept = cost[rows, columns] < 0
    return np.stack([rows[kept], columns[kept]], axis=1)


def _over_errors(values: Array, errors: Array) -> Array:
    """Difference (k,) of values (k, 2) over its standard error; NaN where no error is known."""
    error = np.hypot(errors[:, 0], errors[:, 1])
    known = np.isfinite(error) & (error > 0)
    return np.where(known, (values[:, 1] - values[:, 0]) / np.where(known, error, 1.0), np.nan)


def holm(p: Array) -> Array:
    """Adjust p-values (k,) by the method of Holm; NaN stands for no test and stays.

    To reject where the adjusted value is below a level keeps the probability of any false rejection below that level,
    however the tests depend on one another.
    """
    p = np.asarray(p, float)
    adjusted = np.full(p.shape, np.nan)
    tested = np.flatnonzero(~np.isnan(p))
    order = tested[np.argsort(p[tested], kind="stable")]
    factors = np.arange(len(order), 0, -1.0)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * p[order]), 1.0)
    return adjusted


def two_sided(z: Array) -> Array:
    """Probability that a standard normal variable is at least as far from 0 as z."""
    return np.asarray(erfc(np.abs(z) / np.sqrt(2.0)))

"""Instants of a time response: the default ones, and the step of given ones."""

from __future__ import annotations

import warnings

import numpy as np

from .. import _checks
from .._display import counted
from .._types import Array, ComplexArray
from .._units import rate
from ..exceptions import ResolutionWarning

_PER_PERIOD = 20  # samples in the shortest period of a default time vector
_PERIODS = 3  # of the slowest mode in it
_LONGEST = 20_000  # samples of a default time vector
_OVERDAMPED = 1e-3  # imaginary part of a pole, of its size, up to which it decays by e^-6000 in a period
_COARSEST = 8  # samples in the shortest period before a mode is given up


def default_time_vector(poles: ComplexArray, tfinal: float | None = None, samples: int | None = None) -> Array:
    """Instants that resolve the fastest of the modes and show the slowest, or a warning about those they do not.

    A mode that does not oscillate has no period, and no warning.
    """
    d = np.abs(poles)
    if d.size == 0:
        return np.linspace(0.0, 10.0 if tfinal is None else tfinal, samples or 101)
    shortest, longest = 2 * np.pi / float(d.max()), 2 * np.pi / float(d.min())
    # fewer periods of the slowest mode before none, but never an unresolved fast one
    affordable = (samples or _LONGEST) * shortest / _COARSEST
    end = min(_PERIODS * longest, affordable) if tfinal is None else tfinal
    count = samples or int(np.clip(np.ceil(end / shortest * _PER_PERIOD) + 1, 101, _LONGEST))
    t = np.linspace(0.0, end, count)
    # what the caller chose is no surprise to the caller
    turning = swing(poles)
    fast = d[turning * (t[1] - t[0]) > 2 * np.pi / 3] if samples is None else d[:0]
    slow = d[(turning > 0) & (d * end < 2 * np.pi * (1 - 1e-9))] if tfinal is None else d[:0]
    _warn_unresolved(t, fast, slow)
    return t


def swing(poles: ComplexArray) -> Array:
    """Frequencies at which modes oscillate, rad per unit time; 0 of those that have decayed long before they turn once.

    Their poles are real, or were before rounding parted several of them.
    """
    turning = np.abs(poles.imag)
    return np.where(turning > _OVERDAMPED * np.abs(poles), turning, 0.0)


def _warn_unresolved(t: Array, fast: Array, slow: Array) -> None:
    parts = []
    if len(fast):
        parts.append(f"too coarse for {listed(fast)} (fewer than 3 samples a period)")
    if len(slow):
        parts.append(f"too short for {listed(slow)} (less than one period)")
    if parts:
        warnings.warn(
            f"the default time vector ({len(t)} samples to t = {t[-1]:.4g}) is {' and '.join(parts)}; "
            "pass the instants you need as timepts",
            ResolutionWarning,
            stacklevel=7,
        )


def listed(d: Array, time_unit: str | None = None) -> str:
    """Text that names modes in a warning."""
    shown = ", ".join(f"{value:.4g}" for value in d[:3])
    unit = rate(time_unit) if time_unit else "rad per unit time"
    return f"{counted(len(d), 'mode')} at d = {shown}{', …' if len(d) > 3 else ''} {unit}"


def printed_step(t: Array) -> float:
    """Step of instants on a line: the shortest decimal step or rate within the uncertainty of the slope."""
    k = np.arange(len(t)) - 0.5 * (len(t) - 1)
    spread = float(k @ k)
    centred = t - t.mean()
    slope = float(k @ centred) / spread
    residual = centred - slope * k
    deviation = np.sqrt(float(residual @ residual) / max(1, len(t) - 2) / spread)
    # the instants are doubles: each is wrong by half an eps of its size
    rounding = 8 * _checks.EPS * float(np.abs(t).max()) / (len(t) - 1)
    return shortest_number(slope, float(3 * deviation + rounding))


def shortest_number(value: float, allowed: float) -> float:
    """Decimal number, or reciprocal of one, of the fewest digits within so much of a value."""
    for digits in range(1, 17):
        for candidate in (float(f"{value:.{digits}g}"), 1.0 / float(f"{1.0 / value:.{digits}g}")):
            if abs(candidate - value) <= allowed:
                return candidate
    return value

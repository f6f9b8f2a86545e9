"""The window of frequency responses estimated from blocks of records, and what it makes of a response and its errors.

Where an input is white, cross spectra of windowed blocks over spectra of the input (H1) have the mean

    E[H1(w)] = sum_k g(k) r(k) exp(-j w k h),        r(k) = sum_i window(i) window(i + k) / sum_i window(i)^2,

`g` the response of the samples of the output to those of the input: the estimate is that of a plant whose answer
fades as the correlation of the window does, and peaks are broader than those of the plant.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy import signal

from .. import _checks
from .._options import ResponseInterpolation
from .._types import Array, ComplexArray, Indices
from ..exceptions import StructureError

_SHORTEST = 8  # samples of a block
_OFF_LINES = 0.02  # of the distance of two lines: frequencies in tables are rounded
_UNRELATED = 1e-3  # of the power of a line: what is shared by lines farther apart


@dataclass(frozen=True, eq=False)
class SpectralWindow:
    """Window of the blocks that a frequency response was estimated from.

    Attributes
    ----------
    name : str
        What it is called; empty where its values were given.
    values : ndarray, shape (N,)
        The window at the samples of a block.
    step : float
        Time between samples.
    hold : {'zoh', 'foh', 'bandlimited'}
        What the input did between the samples.  Responses are divided by that of the hold.
    shift : int
        Samples from one block to the next.
    blocks : int or None
        Blocks that were averaged; None where that is not known.
    """

    name: str
    values: Array = field(repr=False)
    step: float
    hold: ResponseInterpolation
    shift: int
    blocks: int | None = None

    @classmethod
    def of(
        cls, name: object, length: int, step: float, hold: ResponseInterpolation, shift: int | None = None
    ) -> SpectralWindow:
        """The window that scipy knows by a name, of blocks that overlap by half unless a `shift` is given."""
        values = signal.get_window(name, length)
        shown = name if isinstance(name, str) else ""
        return cls(shown, values, step, hold, length // 2 if shift is None else shift)

    @property
    def given(self) -> Any:
        """As it may be given: name, length and number of blocks if that is known, or values."""
        counted = () if self.blocks is None else (self.blocks,)
        return (self.name, self.length, *counted) if self.name else self.values

    @property
    def length(self) -> int:
        """Samples of a block."""
        return len(self.values)

    @property
    def line(self) -> float:
        """Distance of two lines, rad per unit time."""
        return float(2 * np.pi / (self.length * self.step))

    @cached_property
    def correlation(self) -> Array:
        """What is left of an answer after 0, 1, ... samples, shape (N,)."""
        products = self.overlaps(0)[self.length - 1 :].real
        return np.asarray(products / products[0])

    def overlaps(self, apart: int) -> ComplexArray:
        """Sums `window(i + m) window(i) exp(2 pi j apart i / N)` for m from -(N - 1) to N - 1."""
        turned = self.values * np.exp(-2j * np.pi * apart * np.arange(self.length) / self.length)
        return np.asarray(signal.correlate(self.values.astype(complex), turned, "full", "fft"))

    def has_lines(self, omega: Array) -> bool:
        """Whether there are lines at all of some frequencies."""
        place = omega / self.line
        return bool(np.all(np.abs(place - np.rint(place)) <= _OFF_LINES) and np.all(place < self.length / 2 + 0.5))

    def lines(self, omega: Array) -> Indices:
        """Number of the line at each frequency; refuse frequencies between lines or beyond the Nyquist frequency."""
        place = omega / self.line
        lines = np.rint(place).astype(int)
        off = np.abs(place - lines)
        if len(off) and off.max() > _OFF_LINES:
            k = int(np.argmax(off))
            steps = np.diff(np.unique(omega))
            raise StructureError(
                f"blocks of {self.length} samples of step {self.step:.6g} have lines at multiples of {self.line:.6g} "
                f"rad per unit time; point {k} is at {omega[k]:.6g}, between two of them, and points are "
                f"{steps.min(initial=np.inf):.6g} apart: give the length of the blocks, and dt, with which the "
                "response was estimated, without padding by zeros"
            )
        if len(lines) and lines.max() > self.length // 2:
            raise StructureError(
                f"the response reaches {omega.max():.6g} rad per unit time, line {lines.max()}; blocks of "
                f"{self.length} samples end at line {self.length // 2}, {self.length // 2 * self.line:.6g}: give the "
                "length of the blocks with which the response was estimated"
            )
        return lines

    def hold_at(self, omega: Array) -> ComplexArray:
        """Response of the hold."""
        return np.asarray(hold_response(omega * self.step, self.hold), complex)

    @cached_property
    def reach(self) -> int:
        """Lines within which errors of a response are correlated."""
        shared = np.abs(np.fft.fft(self.values**2))[: min(9, self.length // 2)]
        return int(np.flatnonzero(shared > _UNRELATED * shared[0])[-1])


def hold_response(theta: Array, intersample: str) -> ComplexArray | Array:
    """Response of the hold at `theta = omega * step`, without what folds back from beyond the Nyquist frequency."""
    if intersample == "bandlimited":
        return np.ones_like(theta)
    half = np.sinc(theta / (2.0 * np.pi))
    return half * np.exp(-0.5j * theta) if intersample == "zoh" else half**2


def window_of(window: Any, omega: Array, step: float | None, hold: ResponseInterpolation) -> SpectralWindow:
    """Check a window that was given, for responses at some frequencies: its name, length and blocks, or its values.

    Without a step of the samples the frequencies are taken for neighbouring lines.
    """
    name, values, blocks = _named(window)
    if step is None:
        steps = np.diff(np.unique(omega))
        steps = steps[steps > _checks.EPS * omega.max(initial=0.0)]
        if not len(steps):
            raise StructureError(
                f"the response has {len(omega)} frequencies, which do not tell the step of the samples that it was "
                "estimated from; give dt"
            )
        # the median, as tables round; lines that were left out make some distances multiples of it
        apart = float(np.median(steps[steps < 1.5 * steps.min()]))
        step = float(2 * np.pi / (len(values) * _refined(apart, omega)))
    window = SpectralWindow(name, values, step, hold, len(values) // 2, blocks)
    window.lines(omega)
    return window


def _refined(apart: float, omega: Array) -> float:
    """The distance of lines that agrees best with all frequencies, from that of neighbours."""
    place = np.rint(omega / apart)
    power = float(place @ place)
    return float(place @ omega) / power if power else apart


def _named(window: Any) -> tuple[str, Array, int | None]:
    """Name and values of a window, and the number of blocks if it is given."""
    if isinstance(window, tuple | list) and len(window) in (2, 3) and isinstance(window[0], str | tuple):
        name, length = window[0], _checks.whole_number("the length of the window", window[1], _SHORTEST)
        blocks = None if len(window) == 2 else _checks.whole_number("the number of blocks", window[2], 1)
        try:
            values = np.asarray(signal.get_window(name, length), float)
        except (ValueError, TypeError) as error:
            raise StructureError(
                f"window is {_checks.shown(window)}, and scipy.signal.get_window knows no {name!r} ({error}); use "
                "'hann', 'boxcar', 'hamming', 'blackman', 'flattop', ..., or pass the values of the window"
            ) from None
        return (name if isinstance(name, str) else ""), values, blocks
    if isinstance(window, str) or not isinstance(window, np.ndarray | list | tuple):
        raise StructureError(
            f"window is {_checks.shown(window)}; pass the name and the samples of a block, such as ('hann', 512), or "
            "the values of the window"
        )
    values = _checks.real_array("window", window, 1)
    if len(values) < _SHORTEST or not values.any():
        raise StructureError(
            f"window has {len(values)} values, {np.count_nonzero(values)} of them not 0; expected at least {_SHORTEST}"
        )
    return "", values, None


def estimated_response(window: SpectralWindow, answers: Array, omega: Array) -> ComplexArray:
    """Mean of the estimate, over the response of the hold, where samples answer so, shape (.., N), to a unit sample."""
    return np.asarray(np.fft.fft(answers * window.correlation)[..., window.lines(omega)] / window.hold_at(omega))

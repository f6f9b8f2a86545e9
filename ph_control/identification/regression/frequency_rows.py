"""Measured frequency responses as rows of the linear problem, on a background of what modes outside the band leave."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, Mask
from ..._units import DERIVATIVES, feels_force
from ...analysis.spectral_window import SpectralWindow
from ..data.frequency_record import BandedFactor
from ..data.windowed import Peaks, SharedErrors, windowed_peaks
from .spectral_rows import real_rows, stacked, thinned_places
from .time_rows import Evaluation
from .tuning import TUNING


def differentiated(omega: Array, quantity: str) -> ComplexArray:
    """What makes the response of a displacement that of a quantity: a power of `i w`."""
    return np.asarray((1j * omega) ** DERIVATIVES[quantity], complex)


def typical_distance(omega: Array) -> float:
    """Median of the distances of ascending frequencies."""
    steps = np.diff(omega)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else float(omega[0])


class Term(NamedTuple):
    """A term `s^power` of a background with a real coefficient, or `j s^power` where it is `turned`."""

    power: int
    turned: bool = False


_LARGEST_POWER = 2  # of a background
# what is left of modes far below and above the band, `s^(k-2)` and `s^k`; most constants are fed through instead
RESIDUAL_TERMS = {
    quantity: tuple(
        Term(power) for power in (k - 2, k) if power <= _LARGEST_POWER and (power or quantity == "displacement")
    )
    for quantity, k in DERIVATIVES.items()
}
FURTHER_TERMS = Term(0, True), Term(1), Term(1, True)  # of a complex constant and slope
_TERMS_FROM = 30  # points: a background is looked for among fewer once there are modes


@dataclass(frozen=True, eq=False)
class FreeResponse:
    """Frequency responses for modes with any damping and residues, on a background of the `terms`.

    Of several entries (q, K) that were `observed` (K,) at the same frequencies, with errors in one `scale`.  The real
    constant is none of the background but what is fed `through`, except of a displacement.  Residues are of any phase,
    or those of `classical` damping: in place of their real parts stand real numbers `B` of `B s^k / (s - p) (s - p*)`,
    k that of the quantity, in place of their imaginary parts zeros.  Where responses have a `delay`, rows are those of
    the responses without it.  `experiment` is the number of the response matrix that they are of.

    Those estimated with a `window` show modes as it does.  Where errors are correlated, rows are those in which they
    are `white`, in place of a scale; `shared_errors` are those that entries have in common.
    """

    frequencies: Array
    response: ComplexArray
    scale: Array
    observed: Mask
    quantity: str = "velocity"
    outputs: Indices = field(default_factory=lambda: np.zeros(1, int))
    through: bool = False
    terms: tuple[Term, ...] = ()
    classical: bool = False
    delay: float | None = None
    window: SpectralWindow | None = None
    white: BandedFactor | None = None
    shared_errors: SharedErrors | None = None
    experiment: int = 0
    moving: ClassVar[bool] = False
    inputs: ClassVar[int] = 1
    acting: ClassVar[Indices] = np.zeros(1, int)

    def on_background(self) -> FreeResponse:
        """The same on what modes outside the band leave, with what is fed through, if points abound.

        A force is felt by an accelerometer at once, whatever their number.
        """
        if len(self.omega) < _TERMS_FROM:
            return replace(self, through=feels_force(self.quantity))
        return self.beside_modes_outside()

    def beside_modes_outside(self) -> FreeResponse:
        """The same on what modes outside the band leave, with what is fed through."""
        return replace(self, through=self.quantity != "displacement", terms=RESIDUAL_TERMS[self.quantity])

    def with_term(self, term: Term) -> FreeResponse:
        """The same beside one more term, which a constant that is fed through may be."""
        there = term in self.terms or (self.through and term == Term(0))
        return self if there else replace(self, terms=(*self.terms, term))

    @cached_property
    def omega(self) -> Array:
        """Frequencies that were measured, rad per unit time."""
        return self.frequencies[self.observed]

    @property
    def samples(self) -> int:
        """Real and imaginary parts."""
        return 2 * len(self.omega)

    @cached_property
    def bin(self) -> float:
        """Typical distance of the frequencies."""
        return typical_distance(self.omega)

    @property
    def ceiling(self) -> float:
        """Largest frequency that is searched."""
        return float(self.omega[-1])

    @cached_property
    def weight(self) -> Array:
        """Factor of errors at the frequencies that were measured."""
        return self.scale[self.observed] if self.white is None else 1.0 / self.white.deviations

    def in_rows(self, values: ComplexArray) -> ComplexArray:
        """Values (k, K) at the frequencies as they are in the rows, where errors are alike."""
        return np.asarray(self.weight * values) if self.white is None else self.white.whitened(values)

    def out_of_rows(self, rows: ComplexArray) -> ComplexArray:
        """Values at the frequencies that are these rows (k, K)."""
        return np.asarray(rows / self.weight) if self.white is None else self.white.coloured(rows)

    def times(self, target: ComplexArray, values: ComplexArray) -> ComplexArray:
        """Values (k, K) at the frequencies times a response that is given in the rows, in the rows."""
        if self.white is None:
            return np.asarray(values * target)
        return self.in_rows(values * self.out_of_rows(target[None]))

    @property
    def direct(self) -> ComplexArray:
        """What is fed through as the response shows it, shape (1, K): of samples, over the response of the hold."""
        return (
            np.ones((1, len(self.omega)), complex) if self.window is None else 1 / self.window.hold_at(self.omega)[None]
        )

    @cached_property
    def target(self) -> ComplexArray:
        """Responses (q, K) that were measured, in the scale of their weights."""
        early = 1.0 if not self.delay else np.exp(1j * self.omega * self.delay)
        return self.in_rows(self.response[:, self.observed] * early)

    def delayed(self, time: float, least: float | None = None, most: float | None = None) -> FreeResponse:
        """Responses that come so much later."""
        return replace(self, delay=time)

    @property
    def delay_time(self) -> float:
        """The delay per unit time."""
        return self.delay or 0.0

    def among_outputs(self, kept: Mask) -> FreeResponse:
        """Some of the responses."""
        return replace(self, response=self.response[kept], outputs=self.outputs[kept])

    @property
    def largest(self) -> Array:
        """Largest value of each entry, in the scale of its weights."""
        return np.abs(self.target).max(axis=1, initial=0.0)

    def own_unknowns(self, n: int) -> int:
        """The background."""
        return len(self.terms)

    @cached_property
    def background(self) -> ComplexArray:
        """Columns (len(terms), K) of the background, in the scale of the weights."""
        return self.in_rows(background_columns(self.terms, self.omega))

    def thinned(self, p: ComplexArray) -> FreeResponse:
        """The points about some modes as far as their peaks reach, and a few; of wide peaks a part, each for many."""
        omega, reach = self.omega, TUNING.half_width * (self.bin + np.abs(p.real))
        first, last = (np.searchsorted(omega, end) for end in (p.imag - reach, p.imag + reach))
        widest = np.argsort(-reach)
        ranges = zip(first[widest], last[widest], (last - first)[widest] // (4 * TUNING.thinned), strict=True)
        return self._part(*thinned_places(ranges, len(omega), 1 + len(omega) // TUNING.everywhere))

    def spread(self, points: int) -> FreeResponse:
        """About so many of the points, each for as many, and the first ones, which slow poles show in."""
        count = len(self.omega)
        ranges = [(0, count, count // points), (0, points // 4, 1)]
        return self._part(*thinned_places(ranges, count, 1 + count // TUNING.everywhere))

    def every(self, step: int) -> FreeResponse:
        """Each of so many points, counted as it is."""
        kept = np.arange(0, len(self.omega), step)
        return self._part(kept, np.ones(len(kept)))

    def _part(self, kept: Indices, counts: Array) -> FreeResponse:
        """Some of the points, which errors count so much of."""
        if self.white is not None:  # errors of neighbours belong together
            return self
        observed, scale = self.observed.copy(), self.scale.copy()
        observed[self.observed] = np.isin(np.arange(len(self.omega)), kept)
        scale[observed] *= counts
        return replace(self, observed=observed, scale=scale)

    def evaluated(self, p: ComplexArray) -> FreeResponseEvaluation:
        """The rows for modes with these poles."""
        return FreeResponseEvaluation(self, p)

    def columns(self, p: ComplexArray, peaks: Peaks | None = None) -> ComplexArray:
        """Columns of all unknowns, in the scale of the weights."""
        if self.classical:
            modes = self._classical(p)[0]
        else:
            peaks = peaks or self.peaks(p)
            modes = stacked((peaks.pole_term, peaks.conjugate_term))
        fed = [self.in_rows(self.direct)] if self.through else []
        return np.concatenate([self.background, self.in_rows(modes), *fed])

    def slopes(self, p: ComplexArray, peaks: Peaks) -> ComplexArray:
        """Derivatives of the columns by real, then imaginary parts of poles, in the scale of the weights."""
        if self.classical:
            return self.in_rows(self._classical(p)[1])
        return self.in_rows(stacked(peaks.slopes))

    def classical_columns(self, p: ComplexArray) -> ComplexArray:
        """`s^k / (s - p) (s - p*)`."""
        ahead, behind = self.peaks(p)[:2]
        return np.asarray(differentiated(self.omega, self.quantity) * ahead * behind)

    def _classical(self, p: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Columns of modes with classical damping, and their derivatives by real, then imaginary parts of poles."""
        columns = self.classical_columns(p)
        ahead, behind = self.peaks(p)[:2]
        turned = 2 * columns * ahead * behind
        slopes = [turned * (1j * self.omega - p.real[:, None]), -turned * p.imag[:, None]]
        return np.concatenate([columns, np.zeros_like(columns)]), np.concatenate(slopes)

    def peaks(self, p: ComplexArray) -> Peaks:
        """`1 / (s - p)` and `1 / (s - conj p)` with their derivatives, or what a window makes of them."""
        if self.window is not None:
            return windowed_peaks(self.window, self.omega, p)
        s, poles = 1j * self.omega, p[:, None]
        least = EPS * np.maximum(np.abs(poles), self.bin)
        ahead, behind = (np.where(gap == 0, least, gap) for gap in (s - poles, s - poles.conj()))
        return Peaks(np.asarray(1.0 / ahead, complex), np.asarray(1.0 / behind, complex))


def log_weights(experiments: Iterable[object]) -> float:
    """Return the logarithm of the density of responses over that of their rows, where each point has a weight."""
    rows = [each for each in experiments if isinstance(each, FreeResponse) and each.white is None]
    return float(sum(2 * len(each.outputs) * np.log(each.weight[each.weight > 0]).sum() for each in rows))


def terms_in(coefficients: ComplexArray) -> tuple[Term, ...]:
    """Terms of which some coefficient, of `s^-2` to `s^2` along the first axis, is not 0."""
    parts = coefficients.reshape(len(coefficients), -1)
    shown = np.stack([parts.real.any(axis=1), parts.imag.any(axis=1)], axis=1)
    return tuple(Term(int(power) - 2, bool(turned)) for power, turned in np.argwhere(shown))


def background_columns(terms: Sequence[Term], omega: Array) -> ComplexArray:
    """Values (len(terms), K) of terms; at a frequency of 0 those of the lowest other."""
    lowest = omega[omega > 0].min(initial=np.inf)
    s = 1j * np.where(omega > 0, omega, lowest if np.isfinite(lowest) else 1.0)
    columns = [(1j if term.turned else 1.0) * s**term.power for term in terms]
    return np.asarray(columns, complex).reshape(len(terms), len(omega))


class FreeResponseEvaluation(Evaluation):
    """The rows of responses for modes with any damping and residues."""

    def __init__(self, rows: FreeResponse, p: ComplexArray) -> None:
        self._rows, self._p = rows, p

    def blocks(self, slopes: bool = True) -> Iterator[Array]:
        """All rows in one block, with the derivatives also without `slopes`."""
        rows = self._rows
        peaks = rows.peaks(self._p)
        derivatives = [rows.slopes(self._p, peaks)]
        if rows.delay is not None:  # what is fed through changes with s, and modes by the force beside themselves
            s, felt = 1j * rows.omega, rows.direct
            derivatives += [rows.in_rows(s * felt if rows.through else felt)]
            derivatives += [rows.in_rows(s * background_columns(rows.terms, rows.omega))]
        yield real_rows([rows.columns(self._p, peaks), *derivatives, rows.target])

    def predict(self, shared: Array, own: Array) -> ComplexArray:
        """Responses of a model at all frequencies of the record; NaN where nothing was measured."""
        rows = self._rows
        everywhere = np.full((shared.shape[1], len(rows.frequencies)), np.nan, complex)
        # other entries may be fed through, and these not
        weights = np.concatenate([own, shared[: 2 * len(self._p) + rows.through]])
        late = 1.0 if not rows.delay else np.exp(-1j * rows.omega * rows.delay)
        everywhere[:, rows.observed] = rows.out_of_rows(weights.T @ rows.columns(self._p)) * late
        return everywhere

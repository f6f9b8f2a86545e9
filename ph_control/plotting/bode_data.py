"""What a Bode plot shows, as numbers: frequencies that resolve every resonance, responses, measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from ..analysis.spectral_estimate import SpectralEstimate, spectral_estimate
from ..exceptions import StructureError
from ..systems.base import LosslessSystem
from .inputs import as_systems, labels_of, models_around, title_of

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]

_PER_DECADE = 200
_AROUND_ALL = 6000  # grid points on each side of all poles and zeros together
_AROUND_BAND = 400  # and of a band, each of which costs as many responses as there are models
_CLOSEST_BAND = 1e-6
_CLOSEST = 1e-8  # relative distance of the nearest grid points to a pole or zero that is an eigenvalue with rounding
_CLOSEST_PH = 1e-12  # and to one of a PH system: there a nearly cancelled resonance runs off the picture too
_NEGLIGIBLE = 1e-9  # relative size below which a computed pole or zero is at the origin
_DOT = 1 / 1200  # of the width of a picture
_BINS = 150  # of a picture, each eight dots wide
_CROWDED = 8  # poles and zeros in such a bin: a dot cannot tell one from the next
_AROUND_BIN = 9
_WIDE = 3  # bins next to one another: a crowd of fewer is no wider than a line, nor a hole in one
_SEEN = 1e-6  # relative distance of samples on both sides of a pole or zero that no picture resolves
_BEYOND = 1e4  # decibels
_LONE = 40.0  # decibels by which a few samples may stick out of all others before they leave the picture
_COHERENT = 0.5  # dots below this coherence say more about noise and leakage than about the system


@dataclass(frozen=True)
class Curve:
    """A response to draw, shape (p, m, N), at `omega`, shape (N,), rad per unit time.

    `singular` holds its poles and zeros on the imaginary axis, ascending; `doubtful` marks what is mostly noise.
    """

    label: str
    omega: Array
    response: ComplexArray
    singular: Array
    nyquist: float | None = None
    doubtful: Mask | None = None
    tabulated: bool = False

    @property
    def vanishes(self) -> bool:
        """Whether the response is zero throughout, of which a logarithmic picture shows nothing."""
        return not np.any(self.response)

    def times_s(self, power: int) -> Curve:
        """The same response times s, or divided by it."""
        if not power:
            return self
        s = 1j * self.omega
        # a zero without sign leaves the phase of a lossless response at one side of half a turn
        return replace(self, response=(self.response + 0.0) * (s if power > 0 else 1.0 / s))

    def magnitude(self, i: int, j: int) -> Array:
        """Decibels; NaN where infinite or zero."""
        return decibels(self.response[i, j])

    def phase(self, i: int, j: int, *, unwrap: bool = True) -> Array:
        """Degrees; NaN where the response is infinite or zero."""
        values = self.response[i, j]
        usable = np.isfinite(values) & (values != 0)
        angle = np.full(values.shape, np.nan)
        angle[usable] = np.angle(values[usable])
        if unwrap:
            # a pole on the axis turns the phase by half a turn in no time, which is not a wrap
            angle[usable] = np.unwrap(angle[usable], discont=1.5 * np.pi)
        return np.degrees(angle)

    def phase_near(self, i: int, j: int, other: Curve) -> Array:
        """Degrees from -180 to 180, in the turn of the phase of another curve where that has left this range."""
        phase, beside = self.phase(i, j, unwrap=False), other.phase(i, j)
        known = np.isfinite(beside)
        if not known.any():
            return phase
        beside = np.interp(np.log(self.omega), np.log(other.omega[known]), beside[known])
        turns = np.where(np.abs(beside) > 180.0, np.round((beside - phase) / 360.0), 0.0)
        shifted: Array = phase + 360.0 * turns
        return shifted

    def visible(self, low: float, high: float, part: float) -> Mask:
        """Where the curve counts for the range of a picture: inside, and not on an infinite peak.

        Nor within a dot of one: between two peaks that a picture cannot part, it would be as high as they are close.
        """
        inside = (self.omega >= low) & (self.omega <= high)
        dot = _DOT * np.log(high / low) * self.omega if part else 0.0
        return inside & away_from(self.omega, self.singular, part) & (_distance(self.omega, self.singular) >= dot)

    def crowds(self, low: float, high: float) -> list[tuple[float, float]]:
        """Ranges, ascending and apart, where a picture from `low` to `high` cannot part poles from zeros."""
        edges = np.geomspace(low, high, _BINS + 1)
        counts = np.histogram(self.singular, edges)[0]
        # on the average of the bins around, so that chance makes no holes
        crowded = (np.convolve(counts, np.ones(_AROUND_BIN) / _AROUND_BIN, "same") >= _CROWDED) & (counts > 0)
        turns = np.flatnonzero(np.diff(crowded, prepend=False, append=False))
        if self.tabulated or not len(turns):
            return []
        holes = np.flatnonzero(turns[2::2] - turns[1:-1:2] <= _WIDE)
        turns = np.delete(turns, [*(2 * holes + 1), *(2 * holes + 2)])
        runs = zip(turns[::2], turns[1::2], strict=True)
        return [(float(edges[start]), float(edges[end])) for start, end in runs if end - start >= _WIDE]

    def typical(self, level: Array, low: float, high: float) -> tuple[Array, Array]:
        """Median of `level` over frequency in bins of the crowds, with a NaN between any two of these.

        Between a pole and the next zero a lossless response passes through all levels: lines that close fill the
        picture, and tell nothing of the size of what they fill it with.
        """
        weight, known = np.gradient(np.log(self.omega)), np.isfinite(level)
        omega, middle = [np.zeros(0)], [np.zeros(0)]
        for start, end in self.crowds(low, high):
            edges = np.geomspace(start, end, 1 + round(_BINS * np.log(end / start) / np.log(high / low)))
            omega.append(np.append(np.sqrt(edges[1:] * edges[:-1]), end))
            parts = np.split(np.arange(len(level)), np.searchsorted(self.omega, edges))[1:-1]
            medians = [_median(level[part][known[part]], weight[part][known[part]]) for part in parts]
            middle.append(np.append(medians, np.nan))
        return np.concatenate(omega), np.concatenate(middle)

    def gaps(self) -> NDArray[np.intp]:
        """Places before which a line must break: between the two samples there the response is infinite or zero."""
        if self.tabulated or not len(self.singular):
            return np.zeros(0, np.intp)
        k = np.unique(np.searchsorted(self.omega, self.singular))
        k = k[(k > 0) & (k < len(self.omega))]
        # where the samples come close to a peak from both sides it runs off the picture, and the phase steps
        return k[self.omega[k] - self.omega[k - 1] > _SEEN * self.omega[k]]


def _median(values: Array, weight: Array) -> float:
    """Value that half of the weight is below."""
    if not len(values):
        return float("nan")
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(share, 0.5 * share[-1])]])


@dataclass(frozen=True)
class Band:
    """Confidence band of a curve: `magnitude` in decibels and `phase` in degrees, shape (2, N), at `omega`."""

    label: str
    omega: Array
    magnitude: Array
    phase: Array

    def visible(self, curve: Curve, low: float, high: float, part: float) -> Array:
        """Its ends where its curve counts for the range of a picture; beyond them it may run off as that does."""
        return self.magnitude[:, replace(curve, omega=self.omega).visible(low, high, part)]


@dataclass(frozen=True)
class BodeData:
    """All that a Bode plot draws: systems, their curves, bands, dots, and the ends of the frequency axis."""

    systems: list[Any]
    curves: list[Curve]
    bands: list[Band | None]
    measured: Curve | None
    low: float
    high: float
    input_labels: list[str]
    output_labels: list[str]
    title: str

    @property
    def nyquist(self) -> list[float]:
        """Nyquist frequencies inside the picture, ascending."""
        everything = [*self.curves, *([self.measured] if self.measured else [])]
        limits = {curve.nyquist for curve in everything if curve.nyquist is not None}
        return sorted(limit for limit in limits if self.low <= limit <= self.high)


def bode_data(
    sysdata: Any,
    omega: ArrayLike | None,
    data: Any,
    *,
    segments: int,
    intersample: str,
    omega_limits: ArrayLike | None,
    omega_num: int | None,
    unit: float,
    confidence: Any,
    level: float,
    label: str | Sequence[str] | None,
    data_label: str | None,
) -> BodeData:
    """Compute what `bode_plot` draws; its arguments, and the size of the unit of frequencies in rad per unit time."""
    if omega_num is not None:
        _checks.whole_number("omega_num", omega_num, 1)
    systems = as_systems(sysdata, tabulated=True)
    labels = labels_of(sysdata, systems, label)
    models = models_around(confidence, sysdata, systems, "magnitude_band", "phase_band")
    measured = _measurement(data, systems[0], segments, intersample, data_label)
    extents = np.concatenate([_extent(sys) for sys in systems])
    grid, low, high = _frequencies(extents, measured, omega, omega_limits, unit)
    given = list(sysdata) if isinstance(sysdata, list | tuple) else [sysdata]
    powers = [_power_of_s(one) for one in given]
    curves = [
        _curve(sys, name, grid, low, high, omega_num).times_s(power)
        for sys, name, power in zip(systems, labels, powers, strict=True)
    ]
    bands: list[Band | None] = []
    for curve, drawn, power in zip(curves, models, powers, strict=True):
        near = frequency_grid(curve.singular, low, high, _CLOSEST_BAND, omega_num, _AROUND_BAND)
        bands.append(None if drawn is None else band_around(drawn, near if grid is None else grid, level, power))
    title, first = title_of("Bode plot", systems, label is not None), systems[0]
    observed = [getattr(one, "observed_system", sys) for one, sys in zip(given, systems, strict=True)]
    return BodeData(observed, curves, bands, measured, low, high, first.input_labels, first.output_labels, title)


def decibels(values: ComplexArray) -> Array:
    """Decibels; NaN where infinite or zero."""
    size = np.abs(values)
    usable = np.isfinite(size) & (size > 0)
    return np.where(usable, 20.0 * np.log10(np.where(usable, size, 1.0)), np.nan)


def _power_of_s(given: Any) -> int:
    """Power of s that leads from the velocity of a port to the quantity that a fit is of."""
    return {"displacement": -1, "acceleration": 1}.get(getattr(given, "quantity", "velocity"), 0)


def band_around(models: Any, omega: Array, level: float, power: int = 0) -> Band:
    """Band of models drawn around a system, each times a power of s."""
    with np.errstate(divide="ignore"):
        size = 20.0 * np.log10(models.magnitude_band(omega, level)) + 20.0 * power * np.log10(omega)
    # infinite where draws have their pole, zero where they have their zero: beyond any picture
    size = np.clip(size, -_BEYOND, _BEYOND)
    return Band(f"{100 * level:g} % band", omega, size, models.phase_band(omega, level) + 90.0 * power)


def _measurement(data: Any, sys: Any, segments: int, intersample: str, label: str | None) -> Curve | None:
    """The dots: a frequency response as it is, or the spectral estimate of a record."""
    if data is None:
        return None
    data = data.as_response() if hasattr(data, "as_response") else data
    if isinstance(data, ct.TimeResponseData):
        data = spectral_estimate(data, segments=segments, intersample=intersample)
        label = label or f"data (spectral estimate, {data.segments} segments)"
    if not isinstance(data, ct.FrequencyResponseData):
        raise StructureError(
            f"data is a {type(data).__name__}; pass a record as control.TimeResponseData, or a "
            "control.FrequencyResponseData"
        )
    if (data.noutputs, data.ninputs) != (sys.noutputs, sys.ninputs):
        raise StructureError(
            f"the data have {data.noutputs} outputs and {data.ninputs} inputs, the systems {sys.noutputs} and "
            f"{sys.ninputs}; select the same ones"
        )
    curve = _tabulated(data, label or "data")
    if isinstance(data, SpectralEstimate) and data.segments > 1:
        return replace(curve, doubtful=data.coherence[data.omega > 0] < _COHERENT)
    return curve


def _tabulated(data: ct.FrequencyResponseData, label: str) -> Curve:
    seen = data.omega > 0
    if not seen.any():
        raise StructureError("the frequency response data have no frequency above 0; nothing can be drawn")
    return Curve(label, data.omega[seen], data.frdata[:, :, seen], np.zeros(0), _nyquist(data), tabulated=True)


def _curve(sys: Any, label: str, grid: Array | None, low: float, high: float, count: int | None) -> Curve:
    """Response of a system at the given frequencies, or on a grid of its own."""
    if isinstance(sys, ct.FrequencyResponseData):
        return _tabulated(sys, label)
    marks, singular = features(sys)
    if grid is None:
        closest = _CLOSEST_PH if isinstance(sys, LosslessSystem) else _CLOSEST
        grid = frequency_grid(marks, low, high, closest, count)
    nyquist = _nyquist(sys)
    if nyquist is None:
        return Curve(label, grid, sys(1j * grid, squeeze=False, warn_infinite=False), singular)
    grid = grid[grid <= nyquist]
    points = np.exp(1j * grid * _timebase(sys))
    return Curve(label, grid, sys(points, squeeze=False, warn_infinite=False), singular, nyquist)


def _nyquist(sys: Any) -> float | None:
    if isinstance(sys, SpectralEstimate):
        return sys.nyquist
    return float(np.pi) / _timebase(sys) if sys.isdtime(strict=True) else None


def _timebase(sys: Any) -> float:
    """Sampling time of a discrete-time system; 1 where it is unspecified, as python-control takes it."""
    return 1.0 if sys.dt is True else float(sys.dt)


# --- frequency axes --------------------------------------------------------------------------------------------------


def _frequencies(
    extents: Array, measured: Curve | None, omega: Any, omega_limits: Any, unit: float
) -> tuple[Array | None, float, float]:
    """Frequencies asked for, if any, and the ends of the axis, all in rad per unit time."""
    given = None if omega is None else _ascending("omega", omega)
    if given is not None and len(given) > 2:
        ends = given[[0, -1]]
    elif given is not None:
        ends, given = given, None
    else:
        ends = _default_limits(extents, measured, unit)
    if omega_limits is not None:
        ends = _ascending("omega_limits", omega_limits) * unit
        if len(ends) != 2:
            raise StructureError(f"omega_limits has {len(ends)} entries; give the lowest and the highest frequency")
    return given, float(ends[0]), float(ends[1])


def _ascending(name: str, value: Any) -> Array:
    array = _checks.real_array(name, value, 1)
    if len(array) < 2 or array[0] <= 0 or np.any(np.diff(array) <= 0):
        raise StructureError(
            f"{name} must be at least two positive, ascending frequencies; it has {len(array)} entries"
            + (f" from {array.min():.6g} to {array.max():.6g}" if len(array) else "")
        )
    return array


def _default_limits(extents: Array, measured: Curve | None, unit: float) -> Array:
    """Full decades that hold all systems, 0.1 to 10 for none; with a measurement what it covers and they need."""
    if measured is not None:
        top = measured.omega[-1] if measured.nyquist is None else measured.nyquist
        everything = np.concatenate([extents, [measured.omega[0] / 1.1, top * 1.1]])
        return everything[[np.argmin(everything), np.argmax(everything)]]
    if not len(extents):
        return np.array([0.1, 10.0]) * unit
    # a table may end at a decade, to rounding
    low = np.floor(np.log10(extents.min() / unit) + 1e-9)
    high = np.ceil(np.log10(extents.max() / unit) - 1e-9)
    return 10.0 ** np.array([low, high]) * unit


def _extent(sys: Any) -> Array:
    """Ends of what the picture must show: twice as far as the poles and zeros are, or as far as tabulated data are."""
    if isinstance(sys, ct.FrequencyResponseData):
        return _tabulated(sys, "").omega[[0, -1]]
    marks = features(sys)[0]
    return np.array([marks.min() / 2.0, 2.0 * marks.max()]) if len(marks) else marks


def features(sys: Any) -> tuple[Array, Array]:
    """Frequencies of the poles and zeros of a system, ascending, positive, and those of them on the imaginary axis.

    The second kind is where the response is infinite or zero; it includes every pole and zero of a lossless one-port.
    """
    points = np.concatenate([np.zeros(0, complex), sys.poles(), _zeros(sys)])
    if sys.isdtime(strict=True):
        points = points[points != 0]
        points = np.log(points.astype(complex)) / _timebase(sys)
    points = points[np.isfinite(points)]
    if isinstance(sys, LosslessSystem) and sys.issiso():
        on_axis = np.unique(points.imag[points.imag > 0])
        return on_axis, on_axis
    size = np.abs(points)
    # eigenvalue solvers return zeros at infinity as huge numbers, and those at the origin as tiny ones
    poles = np.abs(sys.poles())
    scale = np.max(poles, initial=0.0) if sys.isctime() else np.pi / _timebase(sys)
    points = points[(size > _NEGLIGIBLE * scale) & ((size < scale / _NEGLIGIBLE) | (scale == 0))]
    on_axis = points[(np.abs(points.real) <= 1e-7 * np.abs(points)) & (points.imag > 0)].imag
    # well damped ones have no peak, and of repeated real ones the imaginary parts are rounding
    peaks = points.imag[points.imag > 0.5 * np.abs(points)]
    return np.unique(np.concatenate([np.abs(points), peaks])), np.unique(on_axis)


def _zeros(sys: Any) -> ComplexArray:
    """Zeros of every entry of the response: with several ports those of the system itself are not seen in a picture."""
    if sys.issiso():
        return np.asarray(sys.zeros(), dtype=complex)
    entries = [sys[i, j].zeros() for i in range(sys.noutputs) for j in range(sys.ninputs)]
    return np.concatenate(entries).astype(complex)


def frequency_grid(
    marks: ArrayLike,
    low: float,
    high: float,
    closest: float = _CLOSEST,
    count: int | None = None,
    around: int = _AROUND_ALL,
) -> Array:
    """Frequencies from `low` to `high`, dense on both sides of every mark and never on one.

    Parameters
    ----------
    marks : array_like, shape (N,)
        Frequencies of poles and zeros, positive.
    low, high : float
        Ends of the grid, `0 < low < high`.
    closest : float
        Distance of the nearest points to a mark, relative to its frequency.
    count : int, optional
        Number of frequencies between the ends, those around the marks apart.
    around : int
        Number of those on each side of all marks between the ends together, as far as there are at least 3 and at most
        30 for each.

    Returns
    -------
    ndarray
        Ascending frequencies: 200 a decade, at least 500, and on each side of each mark 3 to 30 points at geometrically
        shrinking distances, from half way to the next mark, or half its frequency, down to `closest`.

    Notes
    -----
    Marks closer than a tenth of `closest` count as one, but for a `closest` of 1e-12 or less have a point between them.

    Examples
    --------
    >>> import numpy as np
    >>> from ph_control.plotting.bode_data import frequency_grid
    >>> grid = frequency_grid([1.0], 0.1, 10.0)
    >>> bool(np.abs(grid - 1.0).min() > 0), bool(np.abs(grid - 1.0).min() < 1e-7)
    (True, True)
    """
    if count is None:
        count = 2 + int(np.ceil(max(500.0, _PER_DECADE * np.log10(high / low))))
    base = np.geomspace(low, high, max(2, count))
    base[0], base[-1] = low, high
    marks = np.unique(np.asarray(marks, dtype=float))
    if not len(marks):
        return base
    groups = marks[np.diff(marks, prepend=-np.inf) > 0.1 * closest * marks]
    gaps = np.diff(groups, prepend=0.0, append=np.inf)
    # fewer for each of very many, which the picture cannot separate anyhow
    inside = int(np.sum((groups >= low) & (groups <= high)))
    shrinking = np.linspace(0.0, 1.0, int(np.clip(around // max(1, inside), 3, 30)))
    parts = [base]
    for side, gap in ((-1.0, gaps[:-1]), (1.0, gaps[1:])):
        far = 0.5 * np.minimum(gap, groups)
        near = np.minimum(closest * groups, far)
        parts.append((groups[:, None] + side * far[:, None] * (near / far)[:, None] ** shrinking).ravel())
    grid = np.unique(np.concatenate(parts))
    grid = grid[(grid >= low) & (grid <= high)]
    grid = grid[_distance(grid, marks) > 0.1 * closest * grid]
    if closest > _CLOSEST_PH:
        return grid
    # marks that are exact are told apart however close they are, as long as a double is between them
    below, above = marks[:-1], marks[1:]
    middle = below + 0.5 * (above - below)
    alone = (np.searchsorted(grid, below) == np.searchsorted(grid, above)) & (middle > below) & (middle < above)
    middle = middle[alone & (middle >= low) & (middle <= high)]
    return np.sort(np.concatenate([grid, middle])) if len(middle) else grid


def _distance(x: Array, marks: Array) -> Array:
    """Distance of each `x` to the nearest of the ascending marks."""
    fenced = np.concatenate([[-np.inf], marks, [np.inf]])
    above = np.searchsorted(fenced, x)
    return np.minimum(x - fenced[above - 1], fenced[above] - x)


def away_from(x: Array, marks: Array, part: float) -> NDArray[np.bool_]:
    """Tell which `x` keep at least `part` of the gap between their two neighbouring marks from both of them."""
    if not len(marks):
        return np.ones(x.shape, bool)
    fenced = np.concatenate([[0.0], marks, [2 * marks[-1]]])
    above = np.clip(np.searchsorted(fenced, x), 1, len(fenced) - 1)
    gap = fenced[above] - fenced[above - 1]
    return _distance(x, marks) >= part * gap


def shown_range(curve: Curve, levels: Array, low: float, high: float, part: float) -> Array:
    """Levels of a curve that a picture from `low` to `high` must hold: no infinite peak, and no lone outlier."""
    kept = levels[curve.visible(low, high, part)]
    kept = kept[np.isfinite(kept)]
    if not curve.tabulated or not len(kept):
        return kept
    bottom, top = np.quantile(kept, [0.02, 0.98])
    return kept[(kept >= bottom - _LONE) & (kept <= top + _LONE)]

"""What a Bode plot shows, as numbers: frequencies that resolve every resonance, responses, measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import matrix_balance

from .. import _checks
from .._types import Array, ComplexArray, Indices, Mask
from .._units import parted
from ..analysis.spectral_estimate import SpectralEstimate, spectral_estimate
from ..exceptions import StructureError
from ..numerics.rational import poles as poles_of
from ..systems.base import in_normal_form
from .inputs import Subject, as_measured, is_fit, models_around, subjects_of, timebase, title_of

_PER_DECADE = 200
_AROUND_ALL = 6000  # grid points on each side of all poles and zeros together
_AROUND_BAND = 400  # and of a band, each of which costs as many responses as there are models
_CLOSEST_BAND = 1e-6
_CLOSEST = 1e-8  # relative distance of the nearest grid points to a pole or zero that is an eigenvalue with rounding
_CLOSEST_PH = 1e-12  # and to one of a PH system: there a nearly cancelled resonance runs off the picture too
_NEGLIGIBLE = 1e-9  # relative size below which a computed pole or zero is at the origin
_SHOWN = 0.02  # of the gap between poles and zeros: nearer than this to one, an infinite peak leaves the picture
_DOT = 1 / 1200  # of the width of a picture
_CROWD = 72  # poles and zeros within so much of that width: a dot cannot tell one from the next
_CROWD_WIDTH = 0.06
_BINS = 150  # of a picture, each eight dots wide
_PER_BIN = 256  # levels of which a median is taken
_SEEN = 1e-6  # relative distance of samples on both sides of a pole or zero that no picture resolves
_BEYOND = 1e4  # decibels
_LONE = 40.0  # decibels by which a few samples may stick out of all others before they leave the picture
_COHERENT = 0.5  # coherence below which dots are pale


@dataclass(frozen=True)
class BodeBand:
    """Confidence band of a curve: `magnitude` in decibels and `phase` in degrees, shape (2, N), at `omega`."""

    label: str
    omega: Array
    magnitude: Array
    phase: Array


@dataclass(frozen=True)
class Curve:
    """A response to draw, shape (p, m, N), at `omega`, shape (N,), rad per unit time.

    `singular` holds its poles and zeros on the imaginary axis, ascending; spectral estimates have a `coherence`.
    """

    label: str
    omega: Array
    response: ComplexArray
    singular: Array
    nyquist: float | None = None
    coherence: Array | None = None
    tabulated: bool = False
    band: BodeBand | None = None

    @property
    def doubtful(self) -> Mask:
        """Where it says more about noise and leakage than about the system."""
        return np.zeros(len(self.omega), bool) if self.coherence is None else self.coherence < _COHERENT

    @property
    def vanishes(self) -> bool:
        """Whether the response is zero throughout, of which a logarithmic picture shows nothing."""
        return not np.any(self.response)

    def magnitude(self, i: int, j: int) -> Array:
        """Decibels; NaN where infinite or zero."""
        return decibels(self.response[i, j])

    def phase(self, i: int, j: int, *, unwrap: bool = True) -> Array:
        """Degrees; NaN where the response is infinite or zero."""
        values = self.response[i, j]
        usable = np.isfinite(values) & (values != 0)
        angle = np.full(values.shape, np.nan)
        angle[usable] = np.angle(values[usable])
        # without losses half a turn has no sign; with small ones the phase falls at a pole
        turned = (values.imag == 0) & (values.real < 0) & usable
        angle[turned] = np.pi if turned[np.argmax(usable)] else -np.pi
        if unwrap:
            # a pole on the axis turns the phase by half a turn in no time, which is not a wrap
            angle[usable] = np.unwrap(angle[usable], discont=1.5 * np.pi)
        return np.degrees(angle)

    def phase_band(self, i: int, j: int, *, unwrap: bool = True) -> Array:
        """Ends of the band of phases, shape (2, N), by whole turns next to the curve."""
        assert self.band is not None
        phase, ends = self.phase(i, j, unwrap=unwrap), self.band.phase
        known = np.isfinite(phase)
        if not known.any():
            return ends
        beside = np.interp(np.log(self.band.omega), np.log(self.omega[known]), phase[known])
        return np.asarray(ends + 360.0 * np.round((beside - ends.mean(axis=0)) / 360.0))

    def phase_near(self, i: int, j: int, other: Curve) -> Array:
        """Degrees within half a turn of the phase of another curve."""
        phase, beside = self.phase(i, j, unwrap=False), other.phase(i, j)
        known = np.isfinite(beside)
        if not known.any():
            return phase
        beside = np.interp(np.log(self.omega), np.log(other.omega[known]), beside[known])
        return np.asarray(phase + 360.0 * np.round((beside - phase) / 360.0))

    def visible(self, low: float, high: float) -> Mask:
        """Where the curve counts for the range of a picture: inside, and not on an infinite peak.

        Nor within a dot of one: between two peaks that a picture cannot part, it would be as high as they are close.
        """
        inside = (self.omega >= low) & (self.omega <= high)
        if not len(self.singular):
            return inside
        fenced = np.concatenate([[0.0], self.singular, [2 * self.singular[-1]]])
        above = np.clip(np.searchsorted(fenced, self.omega), 1, len(fenced) - 1)
        least = np.maximum(_SHOWN * (fenced[above] - fenced[above - 1]), _DOT * np.log(high / low) * self.omega)
        return inside & (distance(self.omega, self.singular) >= least)

    def shown(self, i: int, j: int, low: float, high: float) -> Array:
        """Decibels that a picture must hold: no infinite peak and, of tabulated responses, no lone outlier."""
        kept = self.magnitude(i, j)[self.visible(low, high)]
        kept = kept[np.isfinite(kept)]
        if self.tabulated and len(kept):
            bottom, top = np.quantile(kept, [0.02, 0.98])
            kept = kept[(kept >= bottom - _LONE) & (kept <= top + _LONE)]
        if self.band is not None:
            # beyond nine tenths of it the band may run off as its curve does: next to a resonance it is as high
            seen = self.band.magnitude[:, replace(self, omega=self.band.omega).visible(low, high)]
            kept = np.concatenate([kept, np.quantile(seen, [0.05, 0.95]) if seen.size else []])
        return kept

    def crowds(self, low: float, high: float) -> list[tuple[float, float]]:
        """Ranges, ascending and apart, where a picture from `low` to `high` cannot part poles from zeros."""
        marks = self.singular[(self.singular >= low) & (self.singular <= high)]
        first, last = marks[: 1 - _CROWD], marks[_CROWD - 1 :]
        close = np.log(last / first) < _CROWD_WIDTH * np.log(high / low)
        starts, ends = first[close], last[close]
        if not len(starts):
            return []
        apart = np.flatnonzero(starts[1:] > ends[:-1])
        return list(zip(starts[[0, *(apart + 1)]].tolist(), ends[[*apart, -1]].tolist(), strict=True))

    def typical(self, level: Array, low: float, high: float) -> tuple[Array, Array]:
        """Median of `level` over frequency in bins of the crowds, with a NaN between any two of these.

        Between a pole and the next zero a lossless response passes through all levels: lines that close fill the
        picture, and tell nothing of the size of what they fill it with.
        """
        log_omega, level = np.log(self.omega[np.isfinite(level)]), level[np.isfinite(level)]
        between = 0.5 * (log_omega[1:] + log_omega[:-1])
        omega, middle = [np.zeros(0)], [np.zeros(0)]
        for start, end in self.crowds(low, high):
            bins = max(1, round(_BINS * np.log(end / start) / np.log(high / low)))
            points = np.geomspace(start, end, bins * _PER_BIN).reshape(bins, _PER_BIN)
            # of the nearest samples: those on both sides of a peak are no line
            levels = level[np.searchsorted(between, np.log(points))]
            omega.append(np.append(points[:, _PER_BIN // 2], end))
            middle.append(np.append(np.median(levels, axis=1), np.nan))
        return np.concatenate(omega), np.concatenate(middle)

    def gaps(self) -> Indices:
        """Places before which a line must break: between the two samples there the response is infinite or zero."""
        if self.tabulated or not len(self.singular):
            return np.zeros(0, np.intp)
        k = np.unique(np.searchsorted(self.omega, self.singular))
        k = k[(k > 0) & (k < len(self.omega))]
        # where the samples come close to a peak from both sides it runs off the picture, and the phase steps
        return k[self.omega[k] - self.omega[k - 1] > _SEEN * self.omega[k]]


@dataclass(frozen=True)
class BodeData:
    """All that a Bode plot draws: systems, their curves, bands, dots, and the ends of the frequency axis."""

    systems: list[Any]
    curves: list[Curve]
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
    omega: ArrayLike | None = None,
    data: Any = None,
    *,
    segments: int = 8,
    intersample: str = "zoh",
    omega_limits: ArrayLike | None = None,
    omega_num: int | None = None,
    unit: float = 1.0,
    confidence: Any = None,
    level: float = 0.95,
    label: str | Sequence[str] | None = None,
    data_label: str | None = None,
) -> BodeData:
    """Compute what `bode_plot` draws; its arguments, and the size of the unit of frequencies in rad per unit time."""
    if omega_num is not None:
        _checks.whole_number("omega_num", omega_num, 1)
    subjects = subjects_of(sysdata, label, tabulated=True)
    first = subjects[0].system
    models = models_around(confidence, subjects, "magnitude_band", "phase_band")
    measured = _measurement(data, first, segments, intersample, data_label)
    extents = np.concatenate([_extent(one.system, measured) for one in subjects])
    grid, low, high = _frequencies(extents, measured, omega, omega_limits, unit)
    curves = [_curve(one, grid, low, high, omega_num) for one in subjects]
    for k, (curve, drawn) in enumerate(zip(curves, models, strict=True)):
        if drawn is not None:
            near = frequency_grid(curve.singular, low, high, False, omega_num, _AROUND_BAND, _CLOSEST_BAND)
            curves[k] = replace(curve, band=band_of(drawn, near if grid is None else grid, level))
    observed = [one.given.observed_system if is_fit(one.given) else one.system for one in subjects]
    title = title_of("Bode plot", subjects, label is not None)
    if title == "Bode plot" and first.issiso():
        source, sensor = (parted(one[0])[0] for one in (first.input_labels, first.output_labels))
        title += f", {source} to {sensor}" * (not {source, sensor} & {"u", "y", "u[0]", "y[0]"})
    return BodeData(observed, curves, measured, low, high, first.input_labels, first.output_labels, title)


def decibels(values: ComplexArray) -> Array:
    """Decibels; NaN where infinite or zero."""
    size = np.abs(values)
    usable = np.isfinite(size) & (size > 0)
    return np.where(usable, 20.0 * np.log10(np.where(usable, size, 1.0)), np.nan)


def degrees_from(low: float, values: ComplexArray) -> Array:
    """Degrees from `low` to a turn above it; NaN where the response is infinite or zero."""
    usable = np.isfinite(values) & (values != 0)
    angle = np.degrees(np.angle(np.where(usable, values, 1.0)))
    return np.where(usable, np.mod(angle - low, 360.0) + low, np.nan)


def band_of(models: Any, omega: Array, level: float, **entry: int) -> BodeBand:
    """Band of models drawn around a system."""
    with np.errstate(divide="ignore"):
        size = 20.0 * np.log10(models.magnitude_band(omega, level, **entry))
    # infinite where draws have their pole, zero where they have their zero: beyond any picture
    size = np.clip(size, -_BEYOND, _BEYOND)
    return BodeBand(f"{100 * level:g} % band", omega, size, models.phase_band(omega, level, **entry))


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
        return replace(curve, coherence=data.coherence[data.omega > 0])
    return curve


def _tabulated(data: ct.FrequencyResponseData, label: str) -> Curve:
    seen = data.omega > 0
    if not seen.any():
        raise StructureError("the frequency response data have no frequency above 0; nothing can be drawn")
    nyquist = data.nyquist if isinstance(data, SpectralEstimate) else _nyquist(data)
    return Curve(label, data.omega[seen], data.frdata[:, :, seen], np.zeros(0), nyquist, tabulated=True)


def _curve(subject: Subject, grid: Array | None, low: float, high: float, count: int | None) -> Curve:
    """Response of a system at the given frequencies, or on a grid of its own."""
    sys = subject.system
    if isinstance(sys, ct.FrequencyResponseData):
        return _tabulated(sys, subject.label)
    marks, singular = features(sys)
    grid = frequency_grid(marks, low, high, subject.lossless, count) if grid is None else grid
    nyquist = _nyquist(sys)
    grid = grid if nyquist is None else grid[grid <= nyquist]
    s = 1j * grid
    response = _balanced(sys)(s if nyquist is None else np.exp(s * timebase(sys)), squeeze=False, warn_infinite=False)
    response = as_measured(subject.given, response, grid)
    return Curve(subject.label, grid, response, singular, nyquist)


def _balanced(sys: Any) -> Any:
    """A plain state space in states of like sizes: python-control loses the digits of a response where they differ."""
    if type(sys) is not ct.StateSpace or not sys.nstates:
        return sys
    size = matrix_balance(sys.A, permute=False, separate=True)[1][0]
    return ct.ss(sys.A * size / size[:, None], sys.B / size[:, None], sys.C * size, sys.D, sys.dt)


def _nyquist(sys: Any) -> float | None:
    return float(np.pi) / timebase(sys) if sys.isdtime(strict=True) else None


# --- frequency axes --------------------------------------------------------------------------------------------------


def _frequencies(
    extents: Array, measured: Curve | None, omega: Any, omega_limits: Any, unit: float
) -> tuple[Array | None, float, float]:
    """Frequencies asked for, if any, and the ends of the axis, all in rad per unit time."""
    given = None if omega is None else _ascending("omega", omega)
    ends = _default_limits(extents, measured, unit) if given is None else given[[0, -1]]
    if omega_limits is not None:
        ends = _ascending("omega_limits", omega_limits) * unit
        if len(ends) != 2:
            raise StructureError(f"omega_limits has {len(ends)} entries; give the lowest and the highest frequency")
    # two frequencies are limits
    return (given if given is not None and len(given) > 2 else None), float(ends[0]), float(ends[1])


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
        margin = min(1.1, (top / measured.omega[0]) ** 0.05) if top > measured.omega[0] else 1.1
        everything = np.concatenate([extents, [measured.omega[0] / margin, top * margin]])
        return np.array([everything.min(), everything.max()])
    if not len(extents):
        return np.array([0.1, 10.0]) * unit
    # a table may end at a decade, to rounding
    low = np.floor(np.log10(extents.min() / unit) + 1e-9)
    high = np.ceil(np.log10(extents.max() / unit) - 1e-9)
    return 10.0 ** np.array([low, high]) * unit


def _extent(sys: Any, measured: Curve | None) -> Array:
    """Ends of what the picture must show: twice as far as the poles and zeros are, or as far as tabulated data are.

    Poles and zeros within a measurement ask for no more than it covers.
    """
    if isinstance(sys, ct.FrequencyResponseData):
        return _tabulated(sys, "").omega[[0, -1]]
    marks = features(sys)[0]
    if not len(marks):
        return marks
    ends, wider = marks[[0, -1]], np.array([0.5, 2.0])
    if measured is not None:
        beyond = [ends[0] < measured.omega[0], ends[1] > measured.omega[-1]]
        wider = np.where(beyond, wider, 1.0)
    return np.asarray(ends * wider, float)


def features(sys: Any) -> tuple[Array, Array]:
    """Frequencies of the poles and zeros of a system, ascending, positive, and those of them on the imaginary axis.

    The second kind is where the response is infinite or zero; it includes every pole and zero of a lossless one-port.
    """
    # with several ports the zeros of the system itself are not seen in a picture
    entries = [sys] if sys.issiso() else [sys[i, j] for i in range(sys.noutputs) for j in range(sys.ninputs)]
    poles = poles_of(sys)
    points = np.concatenate([poles, *(np.asarray(entry.zeros(), complex) for entry in entries)])
    if sys.isdtime(strict=True):
        points = np.log(points[points != 0]) / timebase(sys)
    points = points[np.isfinite(points)]
    if in_normal_form(sys) and sys.issiso():
        on_axis = np.unique(points.imag[points.imag > 0])
        return on_axis, on_axis
    size = np.abs(points)
    # eigenvalue solvers return zeros at infinity as huge numbers, and those at the origin as tiny ones
    scale = np.max(np.abs(poles), initial=0.0) if sys.isctime() else np.pi / timebase(sys)
    points = points[(size > _NEGLIGIBLE * scale) & ((size < scale / _NEGLIGIBLE) | (scale == 0))]
    on_axis = points[(np.abs(points.real) <= 1e-7 * np.abs(points)) & (points.imag > 0)].imag
    # well damped ones have no peak, and of repeated real ones the imaginary parts are rounding
    peaks = points.imag[points.imag > 0.5 * np.abs(points)]
    return np.unique(np.concatenate([np.abs(points), peaks])), np.unique(on_axis)


def frequency_grid(
    marks: ArrayLike,
    low: float,
    high: float,
    exact: bool = False,
    count: int | None = None,
    around: int = _AROUND_ALL,
    closest: float | None = None,
) -> Array:
    """Frequencies from `low` to `high`, dense on both sides of every mark and never on one.

    Parameters
    ----------
    marks : array_like, shape (N,)
        Frequencies of poles and zeros, positive.
    low, high : float
        Ends of the grid, `0 < low < high`.
    exact : bool
        Whether marks are told apart however close they are; otherwise those closer than a tenth of `closest` may be one
        that was rounded.
    count : int, optional
        Number of frequencies between the ends, those around the marks apart.
    around : int
        Number of those on each side of all marks between the ends together, as far as there are at least 3 and at most
        30 for each.
    closest : float, optional
        Distance of the nearest points to a mark, relative to its frequency; by default 1e-8, of exact ones 1e-12.

    Returns
    -------
    ndarray
        Ascending frequencies: 200 a decade, at least 500, and on each side of each mark 3 to 30 points at geometrically
        shrinking distances, from half way to the next mark, or half its frequency, down to `closest`.

    Examples
    --------
    >>> import numpy as np
    >>> from ph_control.plotting.bode_data import frequency_grid
    >>> grid = frequency_grid([1.0], 0.1, 10.0)
    >>> bool(np.abs(grid - 1.0).min() > 0), bool(np.abs(grid - 1.0).min() < 1e-7)
    (True, True)
    """
    closest = closest or (_CLOSEST_PH if exact else _CLOSEST)
    if count is None:
        count = 2 + int(np.ceil(max(500.0, _PER_DECADE * np.log10(high / low))))
    base = np.geomspace(low, high, max(2, count))
    base[0], base[-1] = low, high
    marks = np.unique(np.asarray(marks, dtype=float))
    gaps = np.diff(marks, prepend=0.0, append=np.inf)
    # fewer for each of very many, which the picture cannot separate anyhow
    inside = int(np.sum((marks >= low) & (marks <= high)))
    shrinking = np.linspace(0.0, 1.0, int(np.clip(around // max(1, inside), 3, 30)))
    parts = [base]
    for side, gap in ((-1.0, gaps[:-1]), (1.0, gaps[1:])):
        far = 0.5 * np.minimum(gap, marks)
        near = np.minimum(closest * marks, far)
        parts.append((marks[:, None] + side * far[:, None] * (near / far)[:, None] ** shrinking).ravel())
    grid = np.unique(np.concatenate(parts))
    clear = distance(grid, marks) > (0.0 if exact else 0.1 * closest * grid)
    return grid[(grid >= low) & (grid <= high) & clear]


def distance(x: Array, marks: Array) -> Array:
    """Distance of each `x` to the nearest of the ascending marks."""
    fenced = np.concatenate([[-np.inf], marks, [np.inf]])
    above = np.searchsorted(fenced, x)
    return np.minimum(x - fenced[above - 1], fenced[above] - x)

"""Measured frequency responses, checked once; correlated errors of their lines, and rows in which these are white."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from control import FrequencyResponseData
from scipy.linalg import cholesky_banded, solve_banded

from ... import _checks
from ..._types import Array, ArrayLike, ComplexArray, Indices, Mask
from ..._units import with_unit
from ...analysis.spectral_window import SpectralWindow
from ...exceptions import IdentificationError, StructureError
from .time_record import CheckedData, refuse_out_of_range

_RIDGES = 1e-9, 1e-6, 1e-3  # of the variances: what keeps nearly singular correlations positive


class InFrequency(CheckedData):
    """Frequency responses at any frequencies."""

    omega: Array
    response: ComplexArray
    weights: Array
    title: str
    time_unit: str | None
    window: SpectralWindow | None
    errors: LineErrors | None

    def in_noise(self, residuals: ComplexArray) -> ComplexArray:
        """Residuals (.., K) of each entry in units of their errors, made white where these are correlated."""
        if self.errors is None:
            return np.asarray(residuals * np.sqrt(self.weights))
        rows = np.empty(residuals.shape, complex)
        for entry in np.ndindex(residuals.shape[:-1]):
            output, source = entry or (0, 0)
            rows[entry] = self.errors.whitened(output, source, residuals[entry][None])[0]
        return rows

    @property
    def measured(self) -> ComplexArray:
        """Responses; NaN where they are missing."""
        return self.response

    def as_response(self) -> FrequencyResponseData:
        """Return the data as python-control keeps them, which has no weights; names have no dots."""
        names = {"inputs": _checks.without_dots(self.input_labels), "outputs": _checks.without_dots(self.output_labels)}  # type: ignore[attr-defined]
        response = FrequencyResponseData(self.response, self.omega, **names, title=self.title or None)
        if self.window is not None:
            response.window, response.step = self.window.given, self.window.step
            response.intersample = self.window.hold
        return with_unit(response, self.time_unit)


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyRecord(InFrequency):
    """A frequency response from one input to one output, at any frequencies.

    Attributes
    ----------
    omega : ndarray, shape (K,)
        Frequencies in rad per unit of time, ascending, none negative; repeats are repeated measurements.
    response : ndarray of complex, shape (K,)
        Measured values; NaN where one is missing.
    weights : ndarray, shape (K,)
        What the squared error at each frequency counts, in proportion to 1/variance; ones by default.
    input_label, output_label : str
        Names of input and output.
    title : str
        What the response is called; may be empty.
    time_unit : str or None
        Unit of time that `omega` is in radians per; None where it is not known.
    window : SpectralWindow or None
        The window that the response was estimated with.
    errors : LineErrors or None
        Covariances of the errors of such a response, as a fit has estimated them.
    """

    omega: Array
    response: ComplexArray
    weights: Array = None  # type: ignore[assignment]  # ones, as many as there are frequencies
    input_label: str = "u"
    output_label: str = "y"
    title: str = ""
    time_unit: str | None = None
    window: SpectralWindow | None = None
    errors: LineErrors | None = None

    def __post_init__(self) -> None:
        weights = np.ones(len(self.omega)) if self.weights is None else self.weights
        arrays = {"omega": np.array(self.omega, float), "weights": np.array(weights, float)}
        vars(self).update(arrays, response=np.array(self.response, complex))
        super().__post_init__()

    def __repr__(self) -> str:
        return f"<FrequencyRecord: {self.samples} frequencies, {self.output_label!r} from {self.input_label!r}>"

    @property
    def input_labels(self) -> tuple[str, ...]:
        """Name of the input."""
        return (self.input_label,)

    @property
    def output_labels(self) -> tuple[str, ...]:
        """Name of the output."""
        return (self.output_label,)


def checked_points(data: FrequencyResponseData, windowed: bool = False) -> tuple[Array, ComplexArray]:
    """Frequencies (K,) and response (p, m, K) in the order given, NaN where a point is missing."""
    if data.dt and not (windowed and data.dt is not True):
        step = "of unknown step" if data.dt is True else f"dt = {data.dt:g}"
        raise StructureError(
            f"the frequency response is that of a sampled system ({step}), and the model runs in continuous "
            "time; if it was measured on a plant, pass control.frd(response, omega) without dt, or, where it was "
            "estimated with a window, window=('hann', N)"
        )
    omega, response = _checks.real_array("omega", data.omega, 1), np.array(data.frdata, dtype=complex)
    if len(omega) == 0:
        raise IdentificationError("the frequency response has no frequencies; a fit needs at least 2")
    if omega.min() < 0:
        k = int(np.argmax(omega < 0))
        raise StructureError(
            f"omega is negative at point {k}: {omega[k]:.6g}, allowed >= 0; pass one side of the spectrum, since the "
            "other is its conjugate"
        )
    if np.isinf(response).any():
        k = int(np.argmax(np.isinf(response).any(axis=(0, 1))))
        raise StructureError(
            f"the response is infinite at point {k} (omega = {omega[k]:.6g}); mark missing points with NaN"
        )
    refuse_out_of_range("omega", omega)
    refuse_out_of_range("the response", np.abs(response).ravel())
    return omega, response


def title_of(data: FrequencyResponseData) -> str:
    """Title of a response, or the name that its user gave it; else nothing."""
    return str(data.title or ("" if data._generic_name_check() else data.name))


def checked_weights(weights: ArrayLike, count: int) -> Array:
    """One positive weight for each frequency; ones by default."""
    if weights is None:
        return np.ones(count)
    array = _checks.real_array("weights", weights)
    if array.shape != (count,):
        raise StructureError(f"weights have shape {array.shape}; with {count} frequencies they must be ({count},)")
    if array.size and array.min() <= 0:
        k = int(np.argmax(array <= 0))
        raise StructureError(
            f"weights are not positive: entry {k} is {array[k]:.6g}; mark points to leave out by a response of NaN"
        )
    refuse_out_of_range("the largest weight", array)
    return array


@dataclass(frozen=True, eq=False)
class LineErrors:
    """Second moments of the errors `e` of responses estimated with a window, but for one factor of each entry.

    Attributes
    ----------
    covariances, relations : ndarray of complex, shape (p, m, b + 1, K)
        Entry d of each entry of the response is `E[e_(k + d) conj(e_k)]`, or `E[e_(k + d) e_k]`, at points k.
    noise_ratio : ndarray, shape (p,)
        Variance of white noise at each output over that of an input.
    """

    covariances: ComplexArray
    relations: ComplexArray
    noise_ratio: Array
    law: Any = field(default=None, init=False, repr=False)  # of all entries together, where a fit has just made it

    def factor(self, output: int, input: int, observed: Mask) -> BandedFactor:
        """That of the errors of an entry where it was observed (K,)."""
        places = np.flatnonzero(observed)
        return BandedFactor.of(
            among(self.covariances[output, input], places), among(self.relations[output, input], places)
        )

    def whitened(self, output: int, input: int, values: ComplexArray) -> ComplexArray:
        """Residuals (k, K) of an entry with errors made white, NaN where one is missing."""
        observed = np.logical_not(np.isnan(values).any(axis=0))
        rows = np.full(values.shape, np.nan, complex)
        if observed.any():
            rows[:, observed] = self.factor(output, input, observed).whitened(values[:, observed])
        return rows

    @property
    def weights(self) -> Array:
        """Inverse variances, shape (p, m, K)."""
        return np.asarray(1.0 / self.covariances[:, :, 0].real)


def among(bands: ComplexArray, places: Indices) -> ComplexArray:
    """Diagonals of the covariance of some of many errors, at ascending places, from the diagonals (b + 1, K) of all."""
    width = len(bands)
    some = np.zeros((width, len(places)), complex)
    for d in range(min(width, len(places))):
        apart = places[d:] - places[: len(places) - d]
        k = np.flatnonzero(apart < width)
        some[d, k] = bands[apart[k], places[k]]
    return some


@dataclass(frozen=True, eq=False)
class BandedFactor:
    """Factor `L` (lower, banded) of the covariance `L L^T` of the real and imaginary parts of K errors in turn.

    `bands` (2 b + 2, 2 K) are its diagonals.
    """

    bands: Array

    @classmethod
    def of(cls, covariance: ComplexArray, relation: ComplexArray) -> BandedFactor:
        """Factor for moments given by their diagonals (b + 1, K): row d has those of the errors at k + d and k."""
        real = _of_parts(covariance, relation)
        for ridge in _RIDGES:
            raised = real.copy()
            raised[0] *= 1 + ridge
            try:
                return cls(cholesky_banded(raised, lower=True))
            except np.linalg.LinAlgError:
                pass
        return cls(np.sqrt(np.maximum(real[:1], np.finfo(float).tiny)))

    def whitened(self, values: ComplexArray) -> ComplexArray:
        """Rows (q, K) made such that errors have variance 1 in each part, and no correlation."""
        parts = np.ascontiguousarray(values, complex).view(float)
        solved = solve_banded((len(self.bands) - 1, 0), self.bands, parts.T)
        return np.ascontiguousarray(solved.T).view(complex)

    def coloured(self, values: ComplexArray) -> ComplexArray:
        """Rows (q, K) with errors of this covariance, of such rows."""
        parts = np.ascontiguousarray(values, complex).view(float)
        rows = parts * self.bands[0]
        for d in range(1, len(self.bands)):
            rows[:, d:] += parts[:, :-d] * self.bands[d, :-d]
        return rows.view(complex)

    def turned_back(self, rows: Array) -> Array:
        """`L^-T` times columns (2 K, k) of rows, real parts first, as these are in the result."""
        half, width = len(rows) // 2, len(self.bands)
        mixed = np.empty_like(rows)
        mixed[::2], mixed[1::2] = rows[:half], rows[half:]
        upper = np.zeros_like(self.bands)
        for d in range(width):
            upper[width - 1 - d, d:] = self.bands[d, : self.bands.shape[1] - d]
        solved = solve_banded((0, width - 1), upper, mixed)
        return np.concatenate([solved[::2], solved[1::2]])

    @property
    def deviations(self) -> Array:
        """Standard deviations of the parts of the errors, shape (K,), as the mean of both."""
        variances = self.bands[0] ** 2
        for d in range(1, len(self.bands)):
            variances[d:] += self.bands[d, :-d] ** 2
        return np.asarray(np.sqrt(variances.reshape(-1, 2).mean(axis=1)))

    @property
    def log_determinant(self) -> float:
        """Of the covariance."""
        return float(2 * np.sum(np.log(self.bands[0])))


def _of_parts(covariance: ComplexArray, relation: ComplexArray) -> Array:
    """Diagonals (2 b + 2, 2 K) of the covariance of real and imaginary parts, one after the other."""
    width, count = covariance.shape
    both, apart = 0.5 * (covariance + relation), 0.5 * (relation - covariance)
    bands = np.zeros((2 * width, 2 * count))
    bands[::2, ::2], bands[::2, 1::2] = both.real, -apart.real  # of real parts, of imaginary parts
    bands[1::2, ::2] = both.imag  # of an imaginary part with a real one
    bands[1:-1:2, 1::2] = apart.imag[1:]  # of a real part with an imaginary one before
    return bands

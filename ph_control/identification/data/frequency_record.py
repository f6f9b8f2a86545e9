"""Measured frequency responses, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from control import FrequencyResponseData

from ... import _checks
from ..._types import Array, ComplexArray
from ..._units import with_unit
from ...analysis.spectral_window import SpectralWindow
from ...exceptions import IdentificationError, StructureError
from .line_errors import LineErrors
from .time_record import CheckedData, refuse_out_of_range


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


def checked_weights(weights: Any, count: int) -> Array:
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

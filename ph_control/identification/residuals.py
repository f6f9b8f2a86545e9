"""What the residuals of a model say: dynamics that it lacks, feedback, an offset, coloured noise."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import StructureError
from ..validation_plots import percent, residual_plot
from .data import Record
from .regressors import Hold
from .residual_tests import Influence, ResidualData, autocorrelation, cross_correlation, influence
from .simulation import Simulation, simulate_on
from .validation import check_options, fit_percent, names_of, record_to_hold_against

Array = NDArray[np.float64]

_LAGS = 25  # by default, where the record is long enough
_SAMPLES_PER_LAG = 5
_WIDTH = 98


@dataclass(frozen=True, eq=False)
class ResidualAnalysis:
    """What the residuals of a model say; made by `residual_analysis`.

    Attributes
    ----------
    label : str
        Name of the model.
    verdict : str
        The verdict, in a few words.
    message : str
        What it rests on, in sentences.
    autocorrelation : ndarray, shape (L,)
        Autocorrelation of the residuals at lags 1 to L, less its mean for white noise; NaN at lags without a pair.
    autocorrelation_band : ndarray, shape (L,)
        Half the width of the band that holds it with probability `confidence` if the residuals are white.
    lags : ndarray, shape (2L + 1,)
        Lags -L to L of `cross_correlation`, in samples.
    cross_correlation : ndarray, shape (2L + 1,)
        Correlation of each residual with the input so many samples before it; at negative lags, after it.
    cross_correlation_band : ndarray, shape (2L + 1,)
        Half the width of the band that holds it if the residuals, of whatever colour, know nothing of the input.
    outside : tuple (int, int)
        Number of lags at which each correlation leaves its band.
    expected_outside : tuple (float, float)
        How many would by chance.
    ljung_box : float
        Ljung-Box statistic of lags 1 to L.
    whiteness : float
        Its p-value; small means that the residuals are not white.
    response_p_value : float
        p-value of no response to the inputs at and before a residual; small means that one is not in the model.
    feedback_p_value : float
        p-value of no relation to the inputs after a residual; small means feedback in the recording.
    offset_p_value : float
        p-value of a mean of zero.
    noise_order : int
        Number of residuals before each that these three tests allow it to depend on; 0 if they look white.
    confidence : float
        Probability of the bands; p-values below `1 - confidence` make the verdict.
    residuals : ndarray, shape (T,)
        Measured output less that of the model; NaN where missing.
    time : ndarray, shape (T,)
        Instants.
    dt : float
        Time between samples.
    fit_percent : float
        As in `compare`.
    own_record : bool
        Whether the model was fitted to this very record.
    input_label, output_label : str
        Names of the signals.
    """

    label: str
    verdict: str
    message: str
    autocorrelation: Array
    autocorrelation_band: Array
    lags: NDArray[np.intp]
    cross_correlation: Array
    cross_correlation_band: Array
    outside: tuple[int, int]
    expected_outside: tuple[float, float]
    ljung_box: float
    whiteness: float
    response_p_value: float
    feedback_p_value: float
    offset_p_value: float
    noise_order: int
    confidence: float
    residuals: Array
    time: Array
    dt: float
    fit_percent: float
    own_record: bool
    input_label: str
    output_label: str

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                _checks.readonly(value)

    def __str__(self) -> str:
        """Verdict, tests, and what they mean."""
        L = len(self.autocorrelation)
        counts = [
            f"{found} of {total} lags outside {100 * self.confidence:g} % ({expected:.2g} expected)"
            for found, total, expected in zip(self.outside, (L, 2 * L + 1), self.expected_outside, strict=True)
        ]
        lines = [
            f"Residuals of {self.label!r} on {self.output_label!r}: {self.verdict}",
            f"  fit                          {percent(self.fit_percent)}"
            + "  (fitted to this record)" * self.own_record,
            f"  autocorrelation              {counts[0]}",
            f"  Ljung-Box, {L} lags".ljust(31) + f"{self.ljung_box:.4g}, {p_value(self.whiteness)}",
            f"  correlation with the input   {counts[1]}",
            f"  response, lags 0 to {L}".ljust(31) + p_value(self.response_p_value),
            f"  feedback, lags -{L} to -1".ljust(31) + p_value(self.feedback_p_value),
            f"  mean                         {p_value(self.offset_p_value)}",
        ]
        return "\n".join([*lines, "", *(f"  {line}" for line in wrap(self.message, _WIDTH))])

    def plot(self, **kwargs: Any) -> ct.ControlPlot:
        """Picture of both correlations with their bands.

        Parameters
        ----------
        **kwargs
            `title`, and `ax`: an array of two axes.

        Returns
        -------
        control.ControlPlot
            `axes` of shape (2, 1): autocorrelation above cross-correlation.

        Examples
        --------
        See `residual_analysis`.
        """
        titles = (
            f"Autocorrelation of the residuals (Ljung-Box {p_value(self.whiteness)})",
            f"Correlation with the input (response {p_value(self.response_p_value)}, "
            f"feedback {p_value(self.feedback_p_value)})",
        )
        kwargs.setdefault("title", f"Residuals of {self.label}: {self.verdict}")
        return residual_plot(
            self.autocorrelation, self.autocorrelation_band, self.cross_correlation, self.cross_correlation_band,
            confidence=self.confidence, panel_titles=titles, **kwargs,
        )  # fmt: skip


def residual_analysis(
    data: Any,
    model: Any,
    *,
    dt: float | None = None,
    method: str = "exact",
    intersample: str = "zoh",
    initial_state: str = "estimate",
    lags: int | None = None,
    confidence: float = 0.99,
) -> ResidualAnalysis:
    """Ask the residuals of a model what it leaves out: dynamics, an offset, coloured noise, or feedback.

    Parameters
    ----------
    data : control.TimeResponseData, or pair (u, y) of array_like, shape (T,) each
        One input and one output on a uniform grid; NaN outputs are missing samples.  Not modified.
    model : PEMResult, system of this package, ModalForm, control.StateSpace or control.TransferFunction
        Model of one input and one output.
    dt, method, intersample, initial_state
        As in `compare`.
    lags : int, optional
        Largest lag L; by default 25, or a fifth of the observed samples if that is less.
    confidence : float
        Probability of the bands, between 0 and 1.

    Returns
    -------
    ResidualAnalysis
        Correlations, bands, p-values and a verdict; its text is a report.

    Raises
    ------
    StructureError
        As `compare`, or if `lags` or `confidence` is out of range.

    See Also
    --------
    compare : how much of a record a model explains.

    Notes
    -----
    *Autocorrelation.*  Pairs of observed samples only.  What was fitted to this record (the initial state; for a
    `PEMResult` on its own record all its parameters) takes noise out of the residuals: mean and variance of their
    correlation are those of white noise without these directions, also in the Ljung-Box statistic, which is the
    classical one where nothing was fitted and nothing is missing (Ljung and Box, Biometrika 65, 1978).  Like
    that one it is somewhat too strict on short records: of records of 100 white samples it refuses, with 10 lags, 2.7 %
    where 1 % are meant.

    *Correlation with the input.*  The band is `sum_m c_e(m) c_u(m)` with both autocorrelations.  The p-values are those
    of F tests that regress the residuals on shifted inputs: at lags 0 to L for a response, and beside these at lags -L
    to -1 for feedback.  They are exact for white Gaussian noise; for coloured residuals their own past is among the
    regressors (Granger), so that long responses show too.  NaN stands for what the record cannot tell, such as a
    response under a constant input.

    O(T (n + L)^2), and O(T (n + L)) of memory.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u).outputs + 0.01 * rng.standard_normal(400)
    >>> analysis = phc.residual_analysis((u, y), plant, dt=0.1)
    >>> analysis.verdict
    'white, and independent of the input'
    >>> phc.residual_analysis((u, y), ct.tf([1, 0], [1, 0.1, 1]), dt=0.1).verdict
    'NOT all of the response to the input is in the model'
    >>> picture = analysis.plot()
    """
    check_options(method, intersample)
    record = record_to_hold_against(data, dt, [model])
    (name,) = names_of([model], None)
    L = _largest_lag(lags, record)
    level = _level(confidence)
    simulation = simulate_on(model, name, record, Hold(record.dt, method, intersample), initial_state)
    return _analysed(record, name, simulation, L, level)


def _largest_lag(lags: Any, record: Record) -> int:
    count = int(record.observed.sum())
    if lags is None:
        return max(1, min(_LAGS, count // _SAMPLES_PER_LAG))
    if not (isinstance(lags, int | np.integer) and not isinstance(lags, bool) and 1 <= lags < record.samples):
        raise StructureError(f"lags is {lags!r}; it must be a whole number from 1 to {record.samples - 1}")
    return int(lags)


def _level(confidence: Any) -> float:
    try:
        level = float(confidence)
    except (TypeError, ValueError):
        level = np.nan
    if not 0 < level < 1:
        raise StructureError(f"confidence is {confidence!r}; it must be a number between 0 and 1, such as 0.99")
    return level


def _analysed(record: Record, name: str, simulation: Simulation, lags: int, confidence: float) -> ResidualAnalysis:
    residuals = record.y - simulation.output
    largest = float(np.nanmax(np.abs(residuals)))
    unit = largest or 1.0
    data = ResidualData(residuals / unit, record.u / (np.max(np.abs(record.u)) or 1.0), simulation.directions, lags)
    auto, statistic, whiteness = autocorrelation(data, confidence)
    cross = cross_correlation(data, confidence)
    causes = influence(data)
    # rounding of recursions run in doubles grows with the samples
    rounding = largest <= _checks.EPS * record.samples * float(np.nanmax(np.abs(simulation.output)))
    findings = _Findings(
        rounding, whiteness, causes, 1 - confidence, bool(data.v.any()), unit * data.e.sum() / data.count
    )
    return ResidualAnalysis(
        label=name, verdict=findings.headline, message=findings.message(),
        autocorrelation=auto.values, autocorrelation_band=auto.band, lags=cross.lags,
        cross_correlation=cross.values, cross_correlation_band=cross.band,
        outside=(auto.outside, cross.outside),
        expected_outside=((1 - confidence) * auto.expected, (1 - confidence) * cross.expected),
        ljung_box=statistic, whiteness=whiteness, response_p_value=causes.response, feedback_p_value=causes.feedback,
        offset_p_value=causes.offset, noise_order=causes.noise_order, confidence=confidence, residuals=residuals,
        time=record.time.copy(), dt=record.dt, fit_percent=fit_percent(record.y[data.seen], residuals[data.seen]),
        own_record=simulation.own, input_label=record.input_label, output_label=record.output_label,
    )  # fmt: skip


@dataclass(frozen=True)
class _Findings:
    """What the tests found, to be told in words."""

    rounding: bool
    whiteness: float
    causes: Influence
    level: float
    driven: bool
    mean: float

    @property
    def _coloured(self) -> bool:
        return self.whiteness < self.level

    @property
    def headline(self) -> str:
        """Verdict in a line; what matters most to a user of the model comes first."""
        if self.rounding:
            return "at rounding level: the model reproduces the record"
        if self.causes.response < self.level:
            return "NOT all of the response to the input is in the model"
        if self.causes.feedback < self.level:
            return "related to later inputs: feedback in the recording"
        if self.causes.offset < self.level:
            return "about a mean that is not zero"
        if self._coloured:
            return "coloured, though no response to the input is seen" if self.driven else "coloured"
        if np.isnan(self.whiteness):
            return "too few to judge"
        return "white, and independent of the input" if self.driven else "white"

    def message(self) -> str:
        """All sentences."""
        if self.rounding:
            return "What is left is rounding, of which the tests say nothing."
        parts = []
        causes = self.causes
        if causes.response < self.level:
            parts.append(
                f"The residuals respond to the input ({p_value(causes.response)}): dynamics are missing or wrong; "
                "raise the order, or suspect damping, the hold of the input between samples, or the quantity measured."
            )
        if causes.feedback < self.level:
            also = ", or a response longer than the lags looked at" if causes.response < self.level else ""
            parts.append(
                f"Later inputs are related to them ({p_value(causes.feedback)}): the input was made from the output "
                f"by a feedback{also}. An output-error fit is then biased unless the noise is white."
            )
        if causes.offset < self.level:
            parts.append(
                f"Their mean is {self.mean:.3g} ({p_value(causes.offset)}): the sensor has an offset; subtract it "
                "before the fit."
            )
        if self._coloured:
            parts.append(
                f"They are not white (Ljung-Box {p_value(self.whiteness)})"
                + (
                    ": what is missing shows there as well."
                    if causes.response < self.level
                    else ": the noise is coloured, or what is missing remembers too long for this test, as wrong "
                    "damping, wrong frequencies or a free motion do."
                )
            )
        if not self.driven:
            parts.append("The input is constant, so nothing can be said of a response to it.")
        elif np.isnan(causes.response):
            parts.append("The record is too short, or its input too poor, to tell a response to the input.")
        if not parts:
            parts.append("Nothing that these tests can see is left in the residuals.")
        return " ".join(parts)


def p_value(p: float) -> str:
    """Text of a p-value; never 0."""
    if np.isnan(p):
        return "p unknown"
    return "p < 1e-300" if p < 1e-300 else f"p = {p:.2g}"

"""What the residuals of a model say: dynamics that it lacks, feedback, an offset, coloured noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Any, NamedTuple

import control as ct
import numpy as np

from ... import _checks
from ..._display import Report, first_of, p_value, percent
from ..._frozen import Frozen
from ..._options import ComparedState, Discretisation, Interpolation
from ..._types import Array, Indices, NDArray, OneOrEach, RealOrComplex
from ..._units import unit_for
from ...exceptions import StructureError
from ...plotting.validation_plot import CorrelationPanel, ResponsePanel, residual_panels_plot
from ..data.channels import Kind, Recording, ResponseMatrix
from ..data.frequency_record import FrequencyRecord
from ..data.time_record import Record
from ..fit.pem_result import PEMResult
from ..fit.prediction_ahead import checked_horizon, is_simulated
from ..regression.prediction import chosen_experiment
from ..uncertainty.residual_tests import (
    Correlation,
    ResidualData,
    autocorrelation,
    cross_correlation,
    influence,
    noise_scales,
    without_peaks,
)
from .comparison import steps_ahead
from .measured import (
    HeldData,
    HeldExperiment,
    Model,
    experiments_to_hold_against,
    fit_to,
    names_of,
)
from .simulation import Rules, Simulation, simulations_of

_LAGS = 25  # by default, where the data are long enough
_SAMPLES_PER_LAG = 5
_WIDTH = 98
_MOST = 60_000_000  # numbers in the directions that were fitted; with more samples than that they hardly count


@dataclass(frozen=True, eq=False)
class ResidualExperiment(HeldExperiment):
    """What a model leaves in one experiment, predicted and simulated.

    Attributes
    ----------
    record : Record or FrequencyRecord
        The data.
    residuals : ndarray, shape (T,)
        Measured output less that of the model, complex for a frequency response; NaN where missing.
    simulation_residuals : ndarray, shape (T,)
        The same where the output is simulated.
    fit_percent : float
        As in `compare`, here alone.
    own_record : bool
        Whether the model was fitted to these very data.
    """

    residuals: NDArray[Any]
    simulation_residuals: RealOrComplex
    fit_percent: float
    own_record: bool


@dataclass(frozen=True, eq=False, repr=False)
class ResidualAnalysis(Report, HeldData, Frozen):
    """What the residuals of a model say; made by `residual_analysis`.

    Attributes
    ----------
    label : str
        Name of the model.
    autocorrelation : ndarray, shape (L,)
        Autocorrelation of the residuals at lags 1 to L, less its mean for white noise; NaN at lags without a pair.  For
        a frequency response from point to point, weighted.
    autocorrelation_band : ndarray, shape (L,)
        Half the width of the band that holds it with probability `confidence` if the residuals are white.
    lags : ndarray, shape (2L + 1,)
        Lags -L to L of `cross_correlation`, in samples.
    cross_correlation : ndarray, shape (2L + 1,)
        Correlation of each residual with the input so many samples before it; at negative lags, after it.  NaN where
        there is no input, as in free motions and frequency responses.
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
        p-value of a mean of zero in each experiment; for a frequency response, of no constant over frequency.
    noise_order : int
        Number of residuals before each that these three tests allow it to depend on; 0 if they look white.
    means : tuple of float
        Mean of the residuals in each experiment; of frequency responses complex, with their weights.
    rounding : bool
        Whether the residuals are of the size of rounding errors, of which the tests say nothing.
    input_varies : bool
        Whether there is an input that is not constant.
    confidence : float
        Probability of the bands; p-values below `1 - confidence` make the verdict.
    experiments : tuple of ResidualExperiment
        Data, residuals and fit of each experiment.
    fit_percent : float
        As in `compare`, all experiments together.
    own_record : bool
        Whether the model was fitted to any of these very data.
    input_label, output_label : str
        Names of the signals.
    horizon : int or None
        Steps ahead that outputs are predicted, for the residuals that all of this is about; None where past outputs
        tell nothing, so that the residuals are those of the simulation.
    simulation_fit_percent, simulation_whiteness : float
        Fit, and p-value of white residuals, where outputs are simulated.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> analysis = phc.residual_analysis((u, y), plant, dt=0.1)
    >>> analysis.lags.shape, analysis.cross_correlation.shape, analysis.whiteness > 0.01
    ((51,), (51,), True)
    """

    label: str
    autocorrelation: Array
    autocorrelation_band: Array
    lags: Indices
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
    means: tuple[complex, ...]
    rounding: bool
    input_varies: bool
    confidence: float
    experiments: tuple[ResidualExperiment, ...]
    fit_percent: float
    own_record: bool
    input_label: str
    output_label: str
    horizon: int | None
    simulation_fit_percent: float
    simulation_whiteness: float

    @property
    def verdict(self) -> str:
        """The verdict, in a few words."""
        return _verdict_of(self)

    @property
    def message(self) -> str:
        """What it rests on, in sentences."""
        return _message_of(self)

    @property
    def residuals(self) -> RealOrComplex:
        """Measured output less that of the model, all experiments one after the other; NaN where missing."""
        return _checks.readonly(np.concatenate([experiment.residuals for experiment in self.experiments]))

    @property
    def simulation_residuals(self) -> RealOrComplex:
        """Measured output less that of a simulation, all experiments one after the other; NaN where missing."""
        parts = [experiment.simulation_residuals for experiment in self.experiments]
        return _checks.readonly(np.concatenate(parts))

    @property
    def dt(self) -> float:
        """Time between samples; raises `StructureError` where the experiments have none, or several."""
        steps = {experiment.record.dt for experiment in self.experiments if isinstance(experiment.record, Record)}
        if len(steps) != 1:
            reason = "have steps of their own; use experiments[k].record.dt" if steps else "are frequency responses"
            raise StructureError(f"there is no step: these experiments {reason}")
        return steps.pop()

    @property
    def _driven(self) -> bool:
        return any(
            isinstance(experiment.record, Record) and experiment.record.driven for experiment in self.experiments
        )

    @property
    def _spectral(self) -> bool:
        return isinstance(self.experiments[0].record, FrequencyRecord)

    def __str__(self) -> str:
        """Verdict, tests, and what they mean."""
        L = len(self.autocorrelation)
        auto, cross = (
            f"{outside} of {total} lags outside {100 * self.confidence:g} % ({expected:.2g} expected)"
            for outside, total, expected in zip(self.outside, (L, 2 * L + 1), self.expected_outside, strict=True)
        )
        several = len(self.experiments) > 1
        data = "these experiments" if several else f"this {'response' if self._spectral else 'record'}"
        own = f"  (fitted to {data})" * self.own_record
        lines = [
            f"Residuals of {self.label!r} on {self.output_label!r}: {self.verdict}",
            *[f"  experiments                  {len(self.experiments)}, together"] * several,
            *self._fits(own),
            f"  autocorrelation              {auto}",
            f"  Ljung-Box, {L} lags".ljust(31) + f"{self.ljung_box:.4g}, {p_value(self.whiteness)}",
        ]
        if self._driven:
            lines += [
                f"  correlation with the input   {cross}",
                f"  response, lags 0 to {L}".ljust(31) + p_value(self.response_p_value),
                f"  feedback, lags -{L} to -1".ljust(31) + p_value(self.feedback_p_value),
            ]
        mean = "  constant over frequency" if self._spectral else "  mean"
        lines.append(mean.ljust(31) + p_value(self.offset_p_value))
        return "\n".join([*lines, "", *(f"  {line}" for line in wrap(self.message, _WIDTH))])

    def _fits(self, own: str) -> list[str]:
        """Lines on the fit of predictions, and of simulations where these are others."""
        if self.horizon is None:
            return [f"  fit                          {percent(self.fit_percent)}{own}"]
        simulated = f"Ljung-Box {p_value(self.simulation_whiteness)}"
        return [
            f"  fit {steps_ahead(self.horizon)}".ljust(31) + f"{percent(self.fit_percent)}{own}",
            f"  fit of the simulation        {percent(self.simulation_fit_percent)}, {simulated}",
        ]

    def plot(self, experiment: int = 0, **kwargs: Any) -> ct.ControlPlot:
        """Picture of the correlations with their bands; of a response, the residual over frequency above its own.

        Parameters
        ----------
        experiment : int
            Of several responses, the one whose residual is drawn, counted from 0; correlations are those of all.
        **kwargs
            Style as in `fit_plot`, and `ax`: an array of two axes, or one where there is no input.  Over frequency also
            `time_unit`, `Hz` and `gain_unit`, as in `bode_plot`.

        Returns
        -------
        control.ControlPlot
            `axes` of shape (2, 1): autocorrelation above cross-correlation; (1, 1) for free motions; for responses
            residual over frequency above autocorrelation.

        Raises
        ------
        StructureError
            If there is no such experiment.

        Examples
        --------
        See `residual_analysis`.
        """
        residual_experiment = chosen_experiment(self.experiments, experiment)
        record, L, test = (
            residual_experiment.record,
            len(self.autocorrelation),
            f"(Ljung-Box {p_value(self.whiteness)})",
        )
        auto = np.arange(1, L + 1), self.autocorrelation, self.autocorrelation_band, self.confidence
        panels: list[CorrelationPanel | ResponsePanel]
        if isinstance(record, FrequencyRecord):
            units = {name: kwargs.pop(name) for name in ("time_unit", "Hz", "gain_unit") if name in kwargs}
            units["time_unit"] = unit_for(units.get("time_unit"), record)
            title = f"Residual over frequency{self._which(experiment)}"
            panels = [
                ResponsePanel(record.omega, record.response, residual_experiment.residuals, title, **units),
                CorrelationPanel(*auto, f"Autocorrelation from point to point {test}", "Lag [points]"),
            ]
        else:
            panels = [CorrelationPanel(*auto, f"Autocorrelation of the residuals {test}", "Lag [samples]")]
        if self._driven:
            cross = self.lags, self.cross_correlation, self.cross_correlation_band, self.confidence
            tests = f"response {p_value(self.response_p_value)}, feedback {p_value(self.feedback_p_value)}"
            title, lag = f"Correlation with the input ({tests})", "Lag of the residual behind the input [samples]"
            panels.append(CorrelationPanel(*cross, title, lag))
        ahead = "" if self.horizon is None else f", {steps_ahead(self.horizon)}"
        return residual_panels_plot(panels, f"Residuals of {self.label}{ahead}: {self.verdict}", **kwargs)


def residual_analysis(
    data: object,
    model: Model,
    *,
    dt: OneOrEach = None,
    method: Discretisation = "exact",
    intersample: Interpolation = "zoh",
    initial_state: ComparedState = "estimate",
    offset: bool = False,
    weights: OneOrEach = None,
    lags: int | None = None,
    confidence: float = 0.99,
    horizon: int | None = 1,
) -> ResidualAnalysis:
    """Ask the residuals of a model what it leaves out: dynamics, an offset, coloured noise, or feedback.

    They are those of predictions one step ahead, by the `noise` of a `PEMResult`, with those of the simulation beside.

    Parameters
    ----------
    data : control.TimeResponseData, control.FrequencyResponseData, data frame, pair (u, y), or list of these
        One experiment or several, as for `pem`.  `(None, y)` is a free motion.  NaN outputs are missing samples.  Not
        modified.
    model : PEMResult, system of this package, ModalForm, control.StateSpace or control.TransferFunction
        Model of one input and one output.
    dt, method, intersample, initial_state, offset, weights
        As in `compare`.
    lags : int, optional
        Largest lag L; by default 25, or a fifth of the observed samples if that is less.
    confidence : float
        Probability of the bands, between 0 and 1.
    horizon : int or None
        Steps ahead that outputs are predicted; None, or infinity, simulates them.  Residuals more than one step ahead
        are coloured by nature.  Frequency responses, and models without noise, have one kind of residuals only.

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
    *Autocorrelation.* Pairs of observed samples only. What was fitted to this record (the initial state; for a
    `PEMResult` on its own record all its parameters) takes noise out of the residuals: mean and variance of their
    correlation are those of white noise without these directions, also in the Ljung-Box statistic, which is the
    classical one where nothing was fitted and nothing is missing (Ljung and Box, Biometrika 65, 1978). Like that one
    it is somewhat too strict on short records: of records of 100 white samples it refuses, with 10 lags, 2.7 % where
    1 % are meant. Where the colour of the noise was fitted to this record, each of its coefficients takes a degree of
    freedom; as their number was chosen too, residuals look rather whiter than they are. Beyond 6e7 numbers, samples
    times parameters, the correction is left out.

    *Correlation with the input.*  The band is `sum_m c_e(m) c_u(m)` with both autocorrelations.  The p-values are those
    of F tests that regress the residuals on shifted inputs: at lags 0 to L for a response, and beside these at lags -L
    to -1 for feedback.  They are exact for white Gaussian noise; for coloured residuals their own past is among the
    regressors (Granger), so that long responses show too.  NaN stands for what the record cannot tell, such as a
    response under a constant input, or under none.

    *Several experiments* are taken together, each in the scale of its own residuals, since their noise may differ:
    pairs of samples within each of them are added up, and each may have a mean of its own.

    *Frequency responses.*  Residuals are those of real and imaginary parts, weighted, and lags go from one point to the
    next.  Noise of neighbouring points is independent where they were measured one by one; spectral estimates with
    windows that overlap or taper correlate them, which then shows here.  Beside a resonance that a model misses all
    else would be small, so residuals count up to 6 times their median size.  There is no input to correlate with.

    O(T (n + L)^2), and O(T (n + L)) of memory.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> analysis = phc.residual_analysis((u, y), plant, dt=0.1)
    >>> analysis.verdict
    'white, and independent of the input'
    >>> phc.residual_analysis((u, y), ct.tf([1, 0], [1, 0.1, 1]), dt=0.1).verdict
    'NOT all of the response to the input is in the model'
    >>> picture = analysis.plot()
    """
    rules = Rules(method, intersample, initial_state, offset)
    steps = checked_horizon(horizon)
    records = experiments_to_hold_against(data, dt, [model], weights)
    if isinstance(records[0], Recording | ResponseMatrix):
        raise StructureError(
            f"the data have {len(records[0].input_labels)} inputs and {len(records[0].output_labels)} outputs, and "
            "these tests are for one of each: pass one of them with the entry of the model, such as model[0, 0]; "
            "residual_plot(result) shows each channel of a fit, and result.whiteness is of all"
        )
    (name,) = names_of([model], None)
    L = _largest_lag(lags, records)
    level = _checks.level("confidence", confidence)
    simulated = [answer for (answer,) in simulations_of([model], [name], records, rules)]
    if steps is None or not isinstance(records[0], Record) or not isinstance(model, PEMResult) or is_simulated(model):
        return _analysed(records, name, simulated, L, level)
    answers = [answer for (answer,) in simulations_of([model], [name], records, replace(rules, horizon=steps))]
    beside = _analysed(records, name, simulated, L, level)
    return _analysed(records, name, answers, L, level, (steps, simulated, beside.whiteness))


def _largest_lag(lags: object, records: tuple[Kind, ...]) -> int:
    longest = max(record.samples for record in records)
    if lags is None:
        count = sum(int(record.observed.sum()) for record in records)
        return max(1, min(_LAGS, count // _SAMPLES_PER_LAG, longest - 1))
    return _checks.whole_number("lags", lags, 1, longest - 1)


def _analysed(
    records: tuple[Kind, ...], name: str, answers: list[Simulation], lags: int, confidence: float,
    beside: tuple[int, list[Simulation], float] | None = None,
) -> ResidualAnalysis:  # fmt: skip
    """Tests of residuals; `beside` predictions their horizon, the simulations, and how white these leave them."""
    horizon, simulations, simulation_whiteness = beside or (None, answers, np.nan)
    simulated = [(record, answer.output) for record, answer in zip(records, simulations, strict=True)]
    residuals = [record.measured - answer.output for record, answer in zip(records, answers, strict=True)]
    outputs = [(record, answer.output) for record, answer in zip(records, answers, strict=True)]
    data, unit = _residual_data(records, residuals, answers, lags)
    auto, statistic, whiteness = autocorrelation(data, confidence)
    have_input = any(isinstance(record, Record) and record.driven for record in records)
    unknown = np.full(2 * lags + 1, np.nan)
    cross = Correlation(np.arange(-lags, lags + 1), unknown, unknown, np.zeros(2 * lags + 1, int))
    if have_input:
        cross = cross_correlation(data, confidence)
    causes = influence(data)
    largest = max(float(np.nanmax(np.abs(residual))) for residual in residuals)
    size = max(float(np.nanmax(np.abs(output[record.observed]))) for record, output in outputs)
    # rounding of recursions run in doubles grows with the samples
    rounding = largest <= _checks.EPS * sum(record.samples for record in records) * size
    spectral = isinstance(records[0], FrequencyRecord)
    first: Any = records[0]
    return ResidualAnalysis(
        label=name,
        autocorrelation=auto.values, autocorrelation_band=auto.band, lags=cross.lags,
        cross_correlation=cross.values, cross_correlation_band=cross.band,
        outside=(auto.outside, cross.outside),
        expected_outside=((1 - confidence) * auto.expected, (1 - confidence) * cross.expected),
        ljung_box=statistic, whiteness=whiteness, response_p_value=causes.response, feedback_p_value=causes.feedback,
        offset_p_value=causes.offset, noise_order=causes.noise_order,
        means=_means(data, unit, spectral), rounding=rounding, input_varies=bool(data.v.any()), confidence=confidence,
        experiments=tuple(
            ResidualExperiment(output[0], residual, record.measured - simulation, fit_to([output]), answer.own)
            for output, residual, answer, (record, simulation) in zip(
                outputs, residuals, answers, simulated, strict=True
            )
        ),
        fit_percent=fit_to(outputs), own_record=any(answer.own for answer in answers),
        input_label=first.input_label, output_label=first.output_label, horizon=horizon,
        simulation_fit_percent=fit_to(simulated),
        simulation_whiteness=whiteness if beside is None else simulation_whiteness,
    )  # fmt: skip


def _means(data: ResidualData, unit: float, spectral: bool) -> tuple[complex, ...]:
    """Mean of each experiment; of responses with their weights."""
    levels = [np.where(data.seen[part], data.constant[part], 0.0) for part in data.parts]
    means = [
        unit * float(level @ data.e[part]) / float(level @ level or 1.0)
        for level, part in zip(levels, data.parts, strict=True)
    ]
    return tuple(map(complex, means[::2], means[1::2]) if spectral else means)


def _residual_data(
    records: tuple[Kind, ...], residuals: Sequence[RealOrComplex], answers: list[Simulation], lags: int
) -> tuple[ResidualData, float]:
    """Series one after the other, each in the scale of its weights and its own noise; and the unit of all.

    A response has two series, the real and the imaginary parts.
    """
    spectral = isinstance(records[0], FrequencyRecord)

    def series(values: list[NDArray[Any]]) -> list[Array]:
        return [part for array in values for part in (array.real, array.imag)] if spectral else values

    weights = [_weights(record, answer) for record, answer in zip(records, answers, strict=True)]
    largest = max(float(np.max(weight)) for weight in weights)
    scales = [np.sqrt(weight / largest) for weight in weights]
    residuals = [
        _in_noise(residual[:, None], scale, answer)[:, 0]
        for residual, scale, answer in zip(residuals, scales, answers, strict=True)
    ]
    unit = max(float(np.nanmax(np.abs(residual))) for residual in residuals) or 1.0
    residuals = [residual / unit for residual in residuals]
    noise = noise_scales([np.abs(residual) for residual in residuals])
    scales = [scale / size for scale, size in zip(scales, noise, strict=True)]
    joined = np.concatenate(series([residual / size for residual, size in zip(residuals, noise, strict=True)]))
    shared, local = _directions(answers, scales)
    level = np.concatenate([np.repeat(scale[None], 1 + spectral, axis=0).ravel() for scale in scales])
    return ResidualData(
        without_peaks(joined) if spectral else joined, _inputs(records, level), np.concatenate(series(shared)), lags,
        tuple(len(rows) for rows in series(shared)), tuple(series(local)), level,
        max(answer.past for answer in answers),
    ), unit  # fmt: skip


def _inputs(records: tuple[Kind, ...], level: Array) -> Array:
    """Inputs of records one after the other, of size 1, in the weights of least squares; 0 of responses."""
    if isinstance(records[0], FrequencyRecord):
        return np.zeros(len(level))
    u = np.concatenate([record.u for record in records if isinstance(record, Record)])
    return u / (np.max(np.abs(u)) or 1.0) * level


def _directions(answers: list[Simulation], scales: list[Array]) -> tuple[list[RealOrComplex], list[RealOrComplex]]:
    """What was fitted to all experiments, and what to each alone; nothing of very long records."""
    fitted = [answer.directions() for answer in answers]
    if sum(directions.shared.size + directions.local.size for directions in fitted) > _MOST:
        return [directions.shared[:, :0] for directions in fitted], [directions.local[:, :0] for directions in fitted]
    width = max(directions.shared.shape[1] for directions in fitted)
    # poles come last; a free motion has no residues before them
    shared = [np.pad(directions.shared, ((0, 0), (width - directions.shared.shape[1], 0))) for directions in fitted]
    return [
        _in_noise(columns, scale, answer) for columns, scale, answer in zip(shared, scales, answers, strict=True)
    ], [directions.local for directions in fitted]


def _weights(record: Kind, answer: Simulation) -> Array:
    """Weights of squared errors."""
    if answer.errors is not None:
        return np.asarray(answer.errors.weights[0, 0])
    return record.weights if isinstance(record, FrequencyRecord) else np.ones(record.samples)


def _in_noise(columns: RealOrComplex, scale: Array, answer: Simulation) -> RealOrComplex:
    """Columns (T, k) in a scale, made such that errors which are correlated are white."""
    if answer.errors is None:
        return np.asarray(scale[:, None] * columns)
    # the factor beyond the weights
    known = np.median(scale / np.sqrt(answer.errors.weights[0, 0]))
    return np.asarray(known * answer.errors.whitened(0, 0, columns.T).T)


class _Cause(NamedTuple):
    """Something that a test can see in residuals: its p-value, the verdict if it is the first seen, and a sentence."""

    p: float
    verdict: str
    sentence: str


def _verdict_of(analysis: ResidualAnalysis) -> str:
    """Verdict in a line; what matters most to a user of the model comes first."""
    if analysis.rounding:
        return f"at rounding level: the model reproduces the {'response' if analysis._spectral else 'record'}"
    if causes := _seen(analysis):
        return causes[0].verdict
    if np.isnan(analysis.whiteness):
        return "too few to judge"
    return (
        "white over frequency"
        if analysis._spectral
        else "white" + ", and independent of the input" * analysis.input_varies
    )


def _message_of(analysis: ResidualAnalysis) -> str:
    """Explanation of the verdict, in sentences."""
    if analysis.rounding:
        return "What is left is rounding, of which the tests say nothing."
    parts = [cause.sentence for cause in _seen(analysis)]
    parts = parts or ["Nothing that these tests can see is left in the residuals."]
    if analysis._spectral:
        parts.append("A response has no input of its own to hold its residuals against.")
    elif not analysis._driven:
        parts.append("There was no input, so nothing can be said of a response to it, or of feedback.")
    elif not analysis.input_varies:
        parts.append("The input is constant, so nothing can be said of a response to it.")
    elif np.isnan(analysis.response_p_value):
        parts.append("The record is too short, or its input too poor, to tell a response to the input.")
    return " ".join(parts)


def _seen(analysis: ResidualAnalysis) -> list[_Cause]:
    causes = _of_responses(analysis) if analysis._spectral else _of_records(analysis)
    return [cause for cause in causes if cause.p < 1 - analysis.confidence]


def _of_records(analysis: ResidualAnalysis) -> list[_Cause]:
    response, feedback, offset = analysis.response_p_value, analysis.feedback_p_value, analysis.offset_p_value
    missing = response < 1 - analysis.confidence
    also = ", or a response longer than the lags looked at" if missing else ""
    noise = (
        "what is missing shows there as well."
        if missing
        else "the noise is coloured, or what is missing remembers too long for this test, as wrong damping, wrong "
        "frequencies or a free motion do."
    )
    return [
        _Cause(
            response,
            "NOT all of the response to the input is in the model",
            f"The residuals respond to the input ({p_value(response)}): dynamics are missing or wrong; raise "
            "the order, or suspect damping, the hold of the input between samples, or the quantity measured.",
        ),
        _Cause(
            feedback,
            "related to later inputs: feedback in the recording",
            f"Later inputs are related to them ({p_value(feedback)}): the input was made from the output by "
            f"a feedback{also}. An output-error fit is then biased unless the noise is white.",
        ),
        _Cause(
            offset,
            "about a mean that is not zero",
            f"Their mean is {_listed(analysis.means)} ({p_value(offset)}): the sensor has an offset; subtract it "
            "before the fit, or estimate it with offset=True.",
        ),
        _Cause(
            analysis.whiteness,
            "coloured" + ", though no response to the input is seen" * analysis.input_varies,
            f"They are not white (Ljung-Box {p_value(analysis.whiteness)}): {noise}",
        ),
    ]


def _of_responses(analysis: ResidualAnalysis) -> list[_Cause]:
    return [
        _Cause(
            analysis.whiteness,
            "NOT white over frequency: the model lacks part of the response",
            f"The residuals follow one another from point to point (Ljung-Box {p_value(analysis.whiteness)}): dynamics "
            "are missing or wrong there; raise the order, or suspect damping, modes beyond the band, or the "
            "quantity measured. A response that was itself estimated with overlapping or tapered windows has noise "
            "of this kind too.",
        ),
        _Cause(
            analysis.offset_p_value,
            "about a constant over frequency that is not zero",
            f"They lie about the constant {_listed(analysis.means)} ({p_value(analysis.offset_p_value)}): a part that "
            "is fed through, or modes beyond the band.",
        ),
    ]


def _listed(means: Sequence[complex]) -> str:
    shown = [f"{m.real:.3g}{m.imag:+.3g}i" if isinstance(m, complex) else f"{m:.3g}" for m in means]
    return first_of(shown, 4, ", ...")

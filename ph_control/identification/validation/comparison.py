"""Models held against data: how much of what was measured each explains."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import control as ct
import numpy as np

from ... import _checks
from ..._display import Report, counted, percent
from ..._frozen import Frozen
from ..._options import ComparedState, Discretisation, Interpolation, InterpolationOrAuto
from ..._types import Array, NDArray, OneOrEach, RealOrComplex
from ..._units import parted, unit_for
from ...exceptions import StructureError
from ...plotting.fit_plot import comparison_plot
from ...plotting.style import told_gain_unit
from ...plotting.validation_plot import channel_comparison_plot, response_comparison_plot
from ..data.channels import Kind, Recording, ResponseMatrix
from ..data.frequency_record import FrequencyRecord
from ..data.time_record import InTime
from ..fit.pem_result import PEMResult
from ..fit.prediction_ahead import checked_horizon
from ..regression.prediction import Pairs, chosen_experiment
from .measured import (
    HeldData,
    HeldExperiment,
    Model,
    experiments_to_hold_against,
    fit_to,
    fits_of_outputs,
    names_of,
    rms_of,
)
from .simulation import Rules, simulations_of

_SHOWN = 8  # experiments listed one by one


@dataclass(frozen=True, eq=False)
class ComparedExperiment(HeldExperiment):
    """Models beside one another in one experiment.

    Attributes
    ----------
    record : Record, FrequencyRecord, Recording or ResponseMatrix
        The data.
    predicted : ndarray, shape (k, T), (k, p, T) or (k, p, m, K)
        Output of each model; complex for a frequency response.
    fit_percent : ndarray, shape (k,)
        Of each model here; NaN for the fit to an output that is zero throughout.
    output_fit_percent : ndarray, shape (k, p)
        The same of each output.
    rms_error : ndarray, shape (k,) or (k, p)
        Of each model, and of several outputs of each of them.
    own_record : tuple of bool
        Whether the model was fitted to these very data.
    """

    predicted: NDArray[Any]
    fit_percent: Array
    output_fit_percent: Array
    rms_error: Array
    own_record: tuple[bool, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Report, HeldData, Frozen):
    """Models beside one another on the same data; made by `compare`.

    Attributes
    ----------
    labels : tuple of str
        Names of the models, each different.
    fit_percent : ndarray, shape (k,)
        `100 (1 - |y - yhat| / |y - mean(y)|)` of each, all experiments together; of several outputs
        `100 (1 - sqrt(mean |y - yhat|^2 / |y - mean(y)|^2))`, the mean over these.
    output_fit_percent : ndarray, shape (k, p)
        The same of each output; of frequency responses from all inputs together.
    rms_error : ndarray, shape (k,), or (k, p) of several channels
        Root of the mean squared error of each, in the unit of the output.
    own_record : tuple of bool
        Whether the model was fitted to any of these very data, so that its fit flatters it.
    experiments : tuple of ComparedExperiment
        The same for each experiment.
    initial_state : str
        How the initial states were chosen.
    output_labels : tuple of str
        Names of the outputs.
    horizon : int or None
        Steps ahead that outputs are predicted; None of simulations.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> comparison = phc.compare((u, y), plant, phc.pem((u, y), dt=0.1), dt=0.1)
    >>> comparison.fit_percent.round(), comparison.own_record
    (array([98., 98.]), (False, True))
    """

    labels: tuple[str, ...]
    fit_percent: Array
    output_fit_percent: Array
    rms_error: Array
    own_record: tuple[bool, ...]
    experiments: tuple[ComparedExperiment, ...]
    initial_state: str
    output_labels: tuple[str, ...]
    horizon: int | None = None

    @property
    def best(self) -> str:
        """Label of the model with the greatest fit."""
        return self.labels[int(np.argmax(self.fit_percent))]

    @property
    def output_label(self) -> str:
        """Names of the outputs, joined by commas."""
        return ", ".join(self.output_labels)

    @property
    def predicted(self) -> RealOrComplex:
        """Output of each model, shape (k, T), all experiments one after the other; (k, p, T) or (k, p, m, T).

        NaN where an output that comes late answers to inputs before the record, and its state is not `'zero'`: such
        samples do not count.
        """
        return _checks.readonly(np.concatenate([experiment.predicted for experiment in self.experiments], axis=-1))

    @property
    def _several(self) -> bool:
        return isinstance(self.experiments[0].record, Recording | ResponseMatrix)

    @property
    def _outputs(self) -> str:
        return counted(len(self.output_labels), "output") if self._several else repr(self.output_label)

    def __str__(self) -> str:
        """Table of the models in the order given; of several channels, of their outputs as well."""
        width = max(5, *map(len, self.labels))
        lines = [
            f"Fit to {self._outputs}: "
            f"{_described([experiment.record for experiment in self.experiments], self.initial_state)}"
            f"{'' if self.horizon is None else f'; predicted {steps_ahead(self.horizon)}'}",
            f"  {'model':{width}}  {'fit':>14}" + "  RMS error" * (not self._several),
        ]
        for k, (label, fit, error) in enumerate(zip(self.labels, self.fit_percent, self.rms_error, strict=True)):
            row = f"  {label:{width}}  {percent(fit):>14}" + ("" if self._several else f"  {error:9.4g}")
            lines.append(f"{row}   {self._note(k)}".rstrip())
        if self._several:
            lines += ["", *self._by_output()]
        return "\n".join([*lines, *self._one_by_one()])

    @property
    def _how(self) -> str:
        """What outputs of the models in time are."""
        return "simulated" if self.horizon is None else f"predicted {steps_ahead(self.horizon)}"

    def _headline(self) -> str:
        fits = zip(self.labels, self.fit_percent, strict=True)
        kind = "fit" if self.horizon is None else f"fit {steps_ahead(self.horizon)}"
        return f"{kind} to {self._outputs}: " + ", ".join(f"{label} {percent(fit)}" for label, fit in fits)

    def _note(self, k: int) -> str:
        own = sum(experiment.own_record[k] for experiment in self.experiments)
        if not own:
            return ""
        if len(self.experiments) == 1:
            return (
                "fitted to this record" if isinstance(self.experiments[0].record, InTime) else "fitted to this response"
            )
        return f"fitted to {own if own < len(self.experiments) else 'all'} of these experiments"

    def _in_columns(self, texts: Iterable[str]) -> str:
        """A text for each model, below its label."""
        return "  ".join(f"{text:>{max(11, len(label))}}" for text, label in zip(texts, self.labels, strict=True))

    def _by_output(self) -> list[str]:
        """Fit of each model to each output."""
        width = max(6, *map(len, self.output_labels))
        fits = zip(self.output_labels, self.output_fit_percent.T, strict=True)
        rows = [("output", self.labels), *((name, map(percent, each)) for name, each in fits)]
        return [f"  {name:{width}}  {self._in_columns(texts)}" for name, texts in rows]

    def _one_by_one(self) -> list[str]:
        """Fit of each model in each of several experiments."""
        if len(self.experiments) == 1:
            return []
        lines = ["", f"  experiment  samples  {self._in_columns(self.labels)}"]
        for k, experiment in enumerate(self.experiments[:_SHOWN], start=1):
            fits = self._in_columns(map(percent, experiment.fit_percent))
            lines.append(f"  {k:10d}  {experiment.record.samples:7d}  {fits}   {experiment.record.title}".rstrip())
        remaining = len(self.experiments) - _SHOWN
        return [*lines, f"  and {remaining} more"] if remaining > 0 else lines

    def plot(self, experiment: int = 0, **kwargs: Any) -> ct.ControlPlot:
        """Picture of the outputs and errors of all models; of a response, magnitude, phase and error over frequency.

        Parameters
        ----------
        experiment : int
            Which of several experiments, counted from 0.
        **kwargs
            In time: `time_unit`, `output_label`, `output_unit`, `detail`, `ax` and style, as in `fit_plot`; `ax`
            takes one array of axes: outputs, errors and, unless `detail` is None, the detail.  Over frequency:
            `time_unit`, `Hz`, `gain_unit`, `scale` and style, as in `frf_plot`, and `ax` of three axes.  Of several
            channels there is a panel for each output, or entry, at most twelve, of a long record the part `detail` of
            them: of these `time_unit`, `Hz`, `gain_unit`, `scale`, `detail`, style, and `ax` of as many axes.

        Returns
        -------
        control.ControlPlot

        Raises
        ------
        StructureError
            If there is no such experiment.

        Examples
        --------
        See `compare`.
        """
        compared = chosen_experiment(self.experiments, experiment)
        record, which = compared.record, self._which(experiment)
        kwargs["time_unit"] = unit_for(kwargs.get("time_unit"), record)
        kwargs["labels"] = [
            f"{label} ({percent(fit)})" for label, fit in zip(self.labels, compared.fit_percent, strict=True)
        ]
        if isinstance(record, Recording | ResponseMatrix):
            kwargs["labels"] = list(self.labels)
            in_time, outputs = isinstance(record, Recording), np.asarray(compared.measured)
            names = list(record.output_labels)
            if not in_time:
                sensors, sources = ([parted(name)[0] for name in some] for some in (names, record.input_labels))
                names = [f"{source} to {sensor}" for sensor in sensors for source in sources]
                kwargs.setdefault("gain_unit", told_gain_unit(record))
            flat = outputs.reshape(len(names), -1), compared.predicted.reshape(len(self.labels), len(names), -1)
            what = f"Outputs, measured and {self._how}" if in_time else "Frequency responses, measured and modelled"
            grid = record.time if isinstance(record, Recording) else record.omega
            return channel_comparison_plot(grid, *flat, names=names, heading=what + which, **kwargs)
        if isinstance(record, FrequencyRecord):
            sensor, source = parted(self.output_label)[0], parted(record.input_label)[0]
            kwargs["heading"] = f"{sensor} over {source}, measured and modelled{which}"
            kwargs.setdefault("gain_unit", told_gain_unit(record))
            return response_comparison_plot(record.omega, record.response, compared.predicted, **kwargs)
        # a label such as "velocity [m/s]" carries its unit
        name, unit = parted(self.output_label)
        kwargs = {"output_label": name} | ({"output_unit": unit} if unit else {}) | kwargs
        heading = f"{kwargs['output_label']}, measured and {self._how}{which}"
        return comparison_plot(record.time, record.y, compared.predicted, heading=heading, **kwargs)


def compare(
    data: object,
    *models: Model,
    dt: OneOrEach = None,
    method: Discretisation = "exact",
    intersample: InterpolationOrAuto = "auto",
    initial_state: ComparedState = "estimate",
    offset: bool = False,
    weights: OneOrEach = None,
    labels: str | Sequence[str] | None = None,
    horizon: int | None = None,
) -> Comparison:
    """Hold models against data: how many percent of what was measured each explains.

    Parameters
    ----------
    data : control.TimeResponseData, control.FrequencyResponseData, data frame, pair (u, y), or list of these
        One experiment or several, as for `pem`.  `(None, y)` is a free motion.  NaN outputs are missing samples.  Not
        modified.
    *models : PEMResult, system of this package, ModalForm, control.StateSpace or control.TransferFunction
        Models of the inputs and outputs of the data: matched by their labels where these are the same, else in order.
        Those in discrete time must have the step of the record.
    dt : float, or sequence of float, one for each experiment, optional
        Time between samples; required with arrays, unless a model has one.
    method : {'exact', 'midpoint', 'euler'}
        How continuous-time models meet the samples; a `PEMResult` keeps its own.
    intersample : {'auto', 'zoh', 'foh'}
        Input between samples, for continuous-time models; a `PEMResult` keeps its own.  'auto' is that of the first
        `PEMResult` among the models, which the data preferred, and 'zoh' without one.
    initial_state : {'estimate', 'zero', 'fitted'}
        State of each model at the first sample: the one that fits this record best, rest, or for a `PEMResult` the
        one found in its own record.  A free motion is always fitted.
    offset : bool
        Whether a constant is added to the output of each model, the one that fits the record best; a `PEMResult`
        keeps to what it was fitted with.
    weights : array_like, shape (K,), or list of these, optional
        What the squared error at each frequency of a response counts.
    labels : str or sequence of str, optional
        Names of the models; by default their own.  Those that repeat are numbered.
    horizon : int, optional
        Predict each output from the inputs and outputs up to so many samples before, by the `noise` of a `PEMResult`;
        None, or infinity, simulates.  Other models have no noise but a white one, for which prediction and simulation
        are the same.

    Returns
    -------
    Comparison
        Fit of each model, the outputs, and a picture; its text is a table.

    Raises
    ------
    StructureError
        If the data or options are not of this form, a model has other inputs or outputs, another step, or leaves the
        range of doubles, or the record has fewer outputs than a model has states to estimate; for a response, if a
        model has a pole at one of its points, or no response there, or a horizon is given.

    See Also
    --------
    residual_analysis : what is wrong with a model, rather than how much.

    Notes
    -----
    Without a horizon the models are simulated: the measured output is used for the initial state only.  For models of
    the plant alone, without a colour of the noise, forces or poles that grow, prediction and simulation are the same.
    A fit to the record that a model was made from flatters it; compare on another one.  On its own record a `PEMResult`
    keeps the `fit_percent` of the fit, if simulated.

    A `PEMResult` answers with the quantity that it was fitted to, such as a displacement; any other model with its
    output as it is, so pass `result.observed_system` rather than `result.system` to other tools.

    Several experiments have a state, and an offset, each of their own.  Of a frequency response the fit is that of
    complex numbers, weighted if there are weights; `method`, `intersample`, `initial_state` and `offset` do not matter,
    and continuous-time models answer in continuous time.

    Of several outputs each counts by its own size, in the fit as in the initial state of a system, which is common to
    all of them; in a `PEMResult` each output moves freely for itself, as it was fitted.

    Free motion is fitted by least squares on normalised columns.  O(T n) for lossless models, O(T n^2) for others,
    whose matrices are scaled first; a transfer function of high order has lost its digits before.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]), name="plant")
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> damped = ct.tf([1, 0], [1, 0.1, 1], name="damped")
    >>> comparison = phc.compare((u, y), plant, damped, dt=0.1)
    >>> print(comparison)
    Fit to 'y': 400 samples; initial state estimated
      model              fit  RMS error
      plant          97.89 %   0.009959
      damped        -17.69 %     0.5548
    >>> picture = comparison.plot(output_unit="m/s")

    Two experiments, and a frequency response:

    >>> print(phc.compare([(u[:250], y[:250]), (u[250:], y[250:])], plant, dt=0.1))
    Fit to 'y': 2 experiments, 400 samples; initial states estimated
      model             fit  RMS error
      plant         97.90 %    0.00991
    <BLANKLINE>
      experiment  samples        plant
               1      250      97.92 %
               2      150      97.86 %
    >>> omega = np.linspace(0.1, 3.0, 50)
    >>> print(phc.compare(ct.frd(0.9 * plant(1j * omega), omega), plant))
    Fit to 'y[0]': 50 frequencies
      model             fit  RMS error
      plant         88.88 %     0.6437
    """
    automatic = isinstance(intersample, str) and intersample == "auto"
    hold: Interpolation = "zoh" if automatic else cast(Interpolation, intersample)
    rules = Rules(method, hold, initial_state, offset, checked_horizon(horizon))
    if automatic:
        fits = (model for model in models if isinstance(model, PEMResult))
        holds = (fit.intersample for fit in fits if getattr(fit, "method", "exact") == method)
        rules = replace(rules, intersample=next(holds, "zoh"))
    if not models:
        raise StructureError("no model given; pass at least one after the data")
    records = experiments_to_hold_against(data, dt, models, weights)
    if rules.horizon is not None and not isinstance(records[0], InTime):
        raise StructureError(
            f"horizon is {rules.horizon}, and frequency responses have no samples to predict others from: leave it out"
        )
    names = names_of(models, labels)
    experiments = []
    for record, answers in zip(records, simulations_of(models, names, records, rules), strict=True):
        experiments.append(
            ComparedExperiment(
                record,
                predicted=np.array([answer.output for answer in answers]),
                own_record=tuple(answer.own for answer in answers),
                **_measures([[(record, answer.output)] for answer in answers]),
            )
        )
    together = [
        [(experiment.record, experiment.predicted[k]) for experiment in experiments] for k in range(len(models))
    ]
    return Comparison(
        labels=names,
        **_measures(together),
        own_record=tuple(any(own) for own in zip(*(experiment.own_record for experiment in experiments), strict=True)),
        experiments=tuple(experiments),
        initial_state=initial_state,
        output_labels=records[0].output_labels,
        horizon=rules.horizon,
    )


def _measures(answers: Sequence[Pairs]) -> dict[str, Array]:
    """Fit of each model, and of its outputs, with the errors of these, from what it answers to each experiment."""
    return {
        "fit_percent": np.array([fit_to(pairs) for pairs in answers]),
        "output_fit_percent": np.array([fits_of_outputs(pairs) for pairs in answers]),
        "rms_error": np.array([rms_of(pairs) for pairs in answers]),
    }


def steps_ahead(horizon: int) -> str:
    """How far ahead a prediction is, as '1 step ahead'."""
    return f"{counted(horizon, 'step')} ahead"


def _described(records: Sequence[Kind], initial_state: str) -> str:
    """What the data are, in a line."""
    samples = sum(record.samples for record in records)
    missing = sum(int((~record.observed).sum()) for record in records)
    several = len(records) > 1
    tail = f", {missing} missing" * bool(missing)
    if not isinstance(records[0], InTime):
        weighted = any(np.ptp(record.weights) for record in records if not isinstance(record, InTime))
        kind = f"{len(records)} responses, " * several
        return f"{kind}{samples} frequencies{tail}" + ", weighted" * weighted
    states = {"estimate": "estimated", "zero": "zero", "fitted": "as fitted"}[initial_state]
    if initial_state == "zero" and not all(record.driven for record in records if isinstance(record, InTime)):
        states = "zero, of free motions estimated"
    return f"{len(records)} experiments, " * several + f"{samples} samples{tail}; initial state{'s' * several} {states}"

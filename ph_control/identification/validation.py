"""Models held against a record: how much of its output each explains."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import StructureError
from ..propagation import INTERSAMPLE, METHODS
from ..validation_plots import comparison_plot, percent
from .data import Record, as_record
from .prediction import fit_percent, unit_norm
from .regressors import Hold
from .result import PEMResult
from .simulation import simulate_on

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Models beside one another on one record; made by `compare`.

    Attributes
    ----------
    labels : tuple of str
        Names of the models, each different.
    fit_percent : ndarray, shape (k,)
        `100 (1 - |y - yhat| / |y - mean(y)|)` of each.
    rms_error : ndarray, shape (k,)
        Root of the mean squared error of each, in the unit of the output.
    own_record : tuple of bool
        Whether the model was fitted to this very record, so that its fit flatters it.
    predicted : ndarray, shape (k, T)
        Output of each model.
    measured : ndarray, shape (T,)
        Output of the record; NaN where missing.
    time : ndarray, shape (T,)
        Instants.
    initial_state : str
        How the initial states were chosen.
    output_label : str
        Name of the output.
    """

    labels: tuple[str, ...]
    fit_percent: Array
    rms_error: Array
    own_record: tuple[bool, ...]
    predicted: Array
    measured: Array
    time: Array
    initial_state: str
    output_label: str

    def __post_init__(self) -> None:
        for array in (self.fit_percent, self.rms_error, self.predicted, self.measured, self.time):
            _checks.readonly(array)

    @property
    def best(self) -> str:
        """Label of the model with the greatest fit."""
        return self.labels[int(np.argmax(self.fit_percent))]

    def __str__(self) -> str:
        """Table of the models in the order given."""
        states = {"estimate": "estimated", "zero": "zero", "fitted": "as fitted"}[self.initial_state]
        missing = int(np.isnan(self.measured).sum())
        width = max(5, *map(len, self.labels))
        lines = [
            f"Fit to {self.output_label!r}: {len(self.time)} samples"
            + (f", {missing} missing" if missing else "")
            + f"; initial state {states}",
            f"  {'model':{width}}  {'fit':>14}  RMS error",
        ]
        for label, fit, error, own in zip(self.labels, self.fit_percent, self.rms_error, self.own_record, strict=True):
            note = "   fitted to this record" * own
            lines.append(f"  {label:{width}}  {percent(fit):>14}  {error:9.4g}{note}")
        return "\n".join(lines)

    def plot(self, **kwargs: Any) -> ct.ControlPlot:
        """Picture of the outputs and errors of all models.

        Parameters
        ----------
        **kwargs
            `time_unit`, `output_label`, `output_unit`, `detail`, `title` and `ax`, as in `fit_plot`; `ax` takes one
            array of axes: outputs, errors and, unless `detail` is None, the detail.

        Returns
        -------
        control.ControlPlot

        Examples
        --------
        See `compare`.
        """
        kwargs = _labels_of_output(self.output_label) | kwargs
        return comparison_plot(
            self.time, self.measured, self.predicted, labels=self.labels, fit_percent=self.fit_percent, **kwargs
        )


def compare(
    data: Any,
    *models: Any,
    dt: float | None = None,
    method: str = "exact",
    intersample: str = "zoh",
    initial_state: str = "estimate",
    labels: str | Sequence[str] | None = None,
) -> Comparison:
    """Hold models against a record: how many percent of its output each explains.

    Parameters
    ----------
    data : control.TimeResponseData, or pair (u, y) of array_like, shape (T,) each
        One input and one output on a uniform grid; NaN outputs are missing samples.  Not modified.
    *models : PEMResult, system of this package, ModalForm, control.StateSpace or control.TransferFunction
        Models of one input and one output.  Those in discrete time must have the step of the record.
    dt : float, optional
        Time between samples; needed with arrays, unless a model has one.
    method : {'exact', 'midpoint', 'euler'}
        How continuous-time models meet the samples; a `PEMResult` keeps its own.
    intersample : {'zoh', 'foh'}
        Input between samples, for continuous-time models; a `PEMResult` keeps its own.
    initial_state : {'estimate', 'zero', 'fitted'}
        State of each model at the first sample: the one that fits this record best, rest, or for a `PEMResult` the
        one found in its own record.
    labels : str or sequence of str, optional
        Names of the models; by default their own.  Those that repeat are numbered.

    Returns
    -------
    Comparison
        Fit of each model, the outputs, and a picture; its text is a table.

    Raises
    ------
    StructureError
        If the data or options are not of this form, a model has several inputs or outputs, another step, or leaves the
        range of doubles, or the record has fewer outputs than a model has states to estimate.

    See Also
    --------
    residual_analysis : what is wrong with a model, rather than how much.

    Notes
    -----
    The models are simulated: the measured output is used for the initial state only.  For models of the plant alone,
    as these are, prediction and simulation are the same.  A fit to the record that a model was made from flatters
    it; compare on another one.  On its own record a `PEMResult` keeps the `fit_percent` of the fit.

    Free motion is fitted by least squares on normalised columns.  O(T n) for lossless models, O(T n^2) for others,
    whose matrices are scaled first; a transfer function of high order has lost its digits before.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]), name="plant")
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u).outputs + 0.01 * rng.standard_normal(400)
    >>> damped = ct.tf([1, 0], [1, 0.1, 1], name="damped")
    >>> comparison = phc.compare((u, y), plant, damped, dt=0.1)
    >>> print(comparison)
    Fit to 'y': 400 samples; initial state estimated
      model              fit  RMS error
      plant          97.89 %   0.009959
      damped        -17.69 %     0.5548
    >>> picture = comparison.plot(output_unit="m/s")
    """
    check_options(method, intersample)
    if not models:
        raise StructureError("no model given; pass at least one after the data")
    record = record_to_hold_against(data, dt, models)
    names = names_of(models, labels)
    hold = Hold(record.dt, method, intersample)
    simulations = [
        simulate_on(model, name, record, hold, initial_state) for model, name in zip(models, names, strict=True)
    ]
    errors = [(record.y - simulation.output)[record.observed] for simulation in simulations]
    return Comparison(
        labels=names,
        fit_percent=np.array([fit_percent(record.y[record.observed], error) for error in errors]),
        rms_error=np.array([_rms(error) for error in errors]),
        own_record=tuple(simulation.own for simulation in simulations),
        predicted=np.array([simulation.output for simulation in simulations]),
        measured=record.y.copy(),
        time=record.time.copy(),
        initial_state=initial_state,
        output_label=record.output_label,
    )


def check_options(method: str, intersample: str) -> None:
    """Refuse unknown names of methods and holds."""
    _checks.choice("method", method, METHODS)
    _checks.choice("intersample", intersample, INTERSAMPLE)


def record_to_hold_against(data: Any, dt: float | None, models: Sequence[Any]) -> Record:
    """The record, its step from a model where nothing else tells it; refused without any output."""
    if dt is None and isinstance(data, tuple | list):
        fitted = [model.record.dt for model in models if isinstance(model, PEMResult)]
        sampled = [getattr(model, "dt", None) for model in models]
        steps = fitted + [step for step in sampled if step and not isinstance(step, bool)]
        dt = steps[0] if steps else None
    record = as_record(data, dt)
    if not record.observed.any():
        raise StructureError("the record has no outputs; there is nothing to hold a model against")
    if not np.nan_to_num(record.y).any():
        raise StructureError("the output is zero throughout the record; no share of it can be explained")
    return record


def names_of(models: Sequence[Any], labels: str | Sequence[str] | None) -> tuple[str, ...]:
    """One name for each model, all different."""
    given = [labels] if isinstance(labels, str) else labels
    if given is not None and len(given) != len(models):
        raise StructureError(f"{len(given)} labels for {len(models)} models; give one for each")
    names = [_name(model) for model in models] if given is None else [str(label) for label in given]
    repeated = Counter(names)
    counts: Counter[str] = Counter()
    for k, name in enumerate(names):
        if repeated[name] > 1:
            counts[name] += 1
            names[k] = f"{name} #{counts[name]}"
    return tuple(names)


def _name(model: Any) -> str:
    system = model.system if isinstance(model, PEMResult) else model
    if isinstance(system, ct.InputOutputSystem) and not system._generic_name_check():
        return str(system.name)
    kind = "fit" if isinstance(model, PEMResult) else type(model).__name__
    n = getattr(system, "n", None)
    if isinstance(n, int):
        return f"{kind} ({n} mode{'s' * (n != 1)})"
    states = getattr(system, "nstates", None)
    return f"{kind} ({states} states)" if isinstance(model, ct.StateSpace) else kind


def _rms(error: Array) -> float:
    return unit_norm(error, 1.0) / float(np.sqrt(len(error)))


def _labels_of_output(label: str) -> dict[str, Any]:
    """A label such as "velocity [m/s]" carries its unit."""
    name, bracket, unit = label.partition(" [")
    return {"output_label": name} | ({"output_unit": unit.removesuffix("]")} if bracket else {})

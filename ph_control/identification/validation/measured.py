"""Data that models are held against: taken in, told apart, joined; and the share of them that a model explains."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import control as ct
import numpy as np

from ... import _checks
from ..._display import counted, counted_poles
from ..._frozen import Frozen
from ..._types import Array, OneOrEach, RealOrComplex
from ..._units import common_unit
from ...exceptions import StructureError
from ...plotting.inputs import given_name
from ...systems.base import Convertible
from ..data.channels import Kind
from ..data.data_frames import is_data_frame
from ..data.experiments import as_measured
from ..data.frequency_record import FrequencyRecord, InFrequency
from ..data.time_record import InTime
from ..fit.pem_result import PEMResult
from ..regression.prediction import Pairs, joint_percent, shares_left, unit_norm

Model: TypeAlias = PEMResult | Convertible


@dataclass(frozen=True, eq=False)
class HeldExperiment(Frozen):
    """An experiment that models are held against."""

    record: Kind

    @property
    def measured(self) -> RealOrComplex:
        """What was measured; NaN where missing."""
        return self.record.measured


class HeldData:
    """All experiments that models are held against, one after the other."""

    experiments: tuple[Any, ...]

    @property
    def measured(self) -> RealOrComplex:
        """What was measured, shape (T,), all experiments one after the other; NaN where missing.

        Of several channels (p, T), or (p, m, T) of frequency responses.
        """
        return _checks.readonly(np.concatenate([experiment.measured for experiment in self.experiments], axis=-1))

    @property
    def time(self) -> Array:
        """Instants of all experiments, shape (T,); raises `StructureError` for frequency responses."""
        return self._joined(InTime, "time", "frequency responses and have no time; use omega")

    @property
    def omega(self) -> Array:
        """Frequencies of all responses, shape (T,), rad per unit time; raises `StructureError` for records in time."""
        return self._joined(InFrequency, "omega", "records in time and have no frequencies; use time")

    def _joined(self, kind: type, name: str, what: str) -> Array:
        parts = [
            getattr(experiment.record, name) for experiment in self.experiments if isinstance(experiment.record, kind)
        ]
        if not parts:
            raise StructureError(f"these data are {what}")
        return _checks.readonly(np.concatenate(parts))

    def _which(self, place: int) -> str:
        """Which of several experiments a picture shows."""
        return f" (experiment {place + 1} of {len(self.experiments)})" if len(self.experiments) > 1 else ""


def experiments_to_hold_against(
    data: object, dt: OneOrEach, models: Sequence[Model], weights: OneOrEach = None
) -> tuple[Kind, ...]:
    """The experiments, their step from a model where nothing else tells it; refused without any output."""
    if dt is None and _lacks_step(data):
        fitted = [
            experiment.record for model in models if isinstance(model, PEMResult) for experiment in model.experiments
        ]
        sampled = [getattr(model, "dt", None) for model in models]
        steps = [record.dt for record in fitted if isinstance(record, InTime)]
        steps += [step for step in sampled if step and not isinstance(step, bool)]
        dt = steps[0] if steps else None
    records: tuple[Kind, ...] = as_measured(data, dt, weights=weights)
    common_unit(records, models)
    several = len(records) > 1
    for k, record in enumerate(records, start=1):
        if not record.observed.any():
            name = f"experiment {k}" if several else "the record" if isinstance(record, InTime) else "the response"
            raise StructureError(f"{name} has no outputs to compare a model with")
    if not any(np.nan_to_num(record.measured).any() for record in records):
        where = "throughout" if several else "throughout the record"
        raise StructureError(f"the output is zero {where}; no share of it can be explained")
    return records


def _lacks_step(data: object) -> bool:
    """Whether any of the data may be arrays, which have no step of their own."""
    known = Kind | ct.TimeResponseData | ct.FrequencyResponseData
    return isinstance(data, tuple | list) and not all(
        isinstance(entry, known) or is_data_frame(entry) for entry in data
    )


# --- names and numbers -----------------------------------------------------------------------------------------------


def names_of(models: Sequence[Model], labels: str | Sequence[str] | None) -> tuple[str, ...]:
    """One name for each model, all different."""
    names = [_name(model) for model in models] if labels is None else _checks.labels(labels, len(models), "models")
    repeated, counts = Counter(names), Counter[str]()
    for k, name in enumerate(names):
        if repeated[name] > 1:
            counts[name] += 1
            names[k] = f"{name} #{counts[name]}"
    return tuple(names)


def _name(model: Model) -> str:
    system = model.system if isinstance(model, PEMResult) else model
    if isinstance(system, ct.InputOutputSystem) and (name := given_name(system)):
        return name
    if isinstance(model, PEMResult):
        return f"fit ({', '.join(counted_poles(model.order, len(model.real_poles)))})"
    kind = type(model).__name__
    n = getattr(system, "n", None)
    if isinstance(n, int):
        return f"{kind} ({counted(n, 'mode')})"
    return f"{kind} ({system.nstates} states)" if isinstance(system, ct.StateSpace) else kind


def fit_to(pairs: Pairs) -> float:
    """Fit percent of a model in some experiments together; of responses in the scale of their weights."""
    return joint_percent(shares_left(pairs))


def fits_of_outputs(pairs: Pairs) -> Array:
    """Fit percent of each output, shape (p,)."""
    return np.array(
        [joint_percent(shares) for shares in shares_left(pairs).reshape(len(pairs[0][0].output_labels), -1)]
    )


def rms_of(pairs: Pairs) -> Any:
    """Root of the mean squared error of a model in some experiments together, of each output or entry.

    Of a response from one input to one output it is weighted as the fit.
    """
    weighted = [record.weights if isinstance(record, FrequencyRecord) else 1.0 for record, _ in pairs]
    heaviest = max(float(np.max(weight)) for weight in weighted)
    residuals = np.concatenate([record.measured - output for record, output in pairs], axis=-1)
    shares = [weight / heaviest * record.observed for weight, (record, _) in zip(weighted, pairs, strict=True)]
    share = np.concatenate(shares, axis=-1).reshape(-1, residuals.shape[-1])
    rows = np.abs(np.nan_to_num(residuals)).reshape(share.shape)
    rms = [unit_norm(np.sqrt(s) * row, 1.0) / np.sqrt(s.sum()) if s.any() else np.nan
             for s, row in zip(share, rows, strict=True)]  # fmt: skip
    return rms[0] if residuals.ndim == 1 else np.array(rms)

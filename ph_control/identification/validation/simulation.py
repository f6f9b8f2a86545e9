"""What a model of any kind says of an experiment: its output there, and the directions in which it was fitted to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from ... import _checks
from ...analysis.time_response import forced_response
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ...modal.modal_form import ModalForm, imaginary
from ...systems.affine import AffineHamiltonian
from ...systems.base import LosslessSystem
from ...systems.canonical_forms import ObservableHamiltonian
from ...systems.port_hamiltonian import ph
from ..data.frequency_record import FrequencyRecord
from ..data.time_record import Record
from ..diagnosis.fitted_directions import Directions, of_record, of_response, same_data
from ..fit.result import PEMResult
from ..regression.prediction import estimated_state, response_on
from ..uncertainty.residual_data import factor_of
from .linear_simulation import STEP_TOLERANCE, sampled_system

Array = NDArray[np.float64]

INITIAL_STATES = ("estimate", "zero", "fitted")

_DIVERGED = 1e10  # times the measured output: forced and free motion then cancel to a few digits


@dataclass(frozen=True)
class Simulation:
    """Output of a model in an experiment, and what of it was fitted to that experiment.

    `output` has shape (T,), or is complex of shape (K,) for a frequency response.  `directions()` are its derivatives
    by all that was estimated from these data: noise along them is missing from the residuals.  `own` tells the data
    that the model itself was fitted to.
    """

    output: NDArray[Any]
    directions: Callable[[], Directions]
    own: bool = False


@dataclass(frozen=True)
class Rules:
    """How models meet a record: hold, initial state, and whether a constant is added where a model has none."""

    method: str
    intersample: str
    initial_state: str
    offset: bool

    def hold(self, dt: float) -> Hold:
        """The hold at a step."""
        return Hold(dt, self.method, self.intersample)

    def estimates(self, record: Record) -> bool:
        """Whether the initial state is fitted; without it nothing moves in a record without input."""
        return self.initial_state == "estimate" or not record.driven


def simulate_on(model: Any, label: str, record: Record, rules: Rules) -> Simulation:
    """Output of a `PEMResult`, a system of this package, or a linear system of python-control along a record."""
    if isinstance(model, PEMResult):
        return _fitted_model(model, label, record, rules)
    if rules.initial_state == "fitted":
        raise StructureError(
            f"initial_state='fitted' is that of a PEMResult; model {label!r} is a {type(model).__name__}, which keeps "
            "none: use 'estimate' or 'zero'"
        )
    if isinstance(model, ModalForm | LosslessSystem):
        return _lossless_system(model, label, record, rules)
    refuse_unknown_model(model, label)
    one_port(label, model.ninputs, model.noutputs, "record")
    sampled = sampled_system(model, label, record.dt, rules.hold(record.dt))
    return _completed(sampled.forced(record.u), sampled.free, label, record, rules, sampled.growth)


def refuse_unknown_model(model: Any, label: str) -> None:
    """Refuse what is no linear system of python-control in matrices or polynomials."""
    if not isinstance(model, ct.StateSpace | ct.TransferFunction):
        raise StructureError(
            f"model {label!r} is a {type(model).__name__}; pass a PEMResult, a system of this package, or a "
            "control.StateSpace or control.TransferFunction"
        )


def one_port(label: str, inputs: int, outputs: int, data: str) -> None:
    """Refuse several inputs or outputs."""
    if (inputs, outputs) != (1, 1):
        raise StructureError(
            f"model {label!r} has {inputs} inputs and {outputs} outputs, the {data} one of each; pass the entry that "
            "was measured, such as model[0, 0]"
        )


def _completed(forced: Array, free_columns: Any, label: str, record: Record, rules: Rules, growth: float) -> Simulation:
    """Add the free motion and the constant that fit the outputs best, where they are asked for."""
    if not np.isfinite(forced).all():
        where = int(np.argmin(np.isfinite(forced)))
        raise StructureError(
            f"model {label!r} is unstable: its modes grow by up to {growth:.6g} a sample, and its output leaves the "
            f"range of doubles at sample {where}; compare on a shorter record, or stabilise the model"
        )
    estimate = rules.estimates(record)
    target = (record.y - forced)[record.observed]
    size, measured = float(np.max(np.abs(forced))), float(np.nanmax(np.abs(record.y)))
    if estimate and growth > 1 and size > _DIVERGED * measured:
        raise StructureError(
            f"model {label!r} is unstable: its modes grow by up to {growth:.6g} a sample, and from rest it reaches "
            f"{size:.3g} where {measured:.3g} was measured: no initial state can be told from that; use "
            "initial_state='zero' or a shorter record"
        )
    parts = [free_columns(record.samples)] if estimate else []
    columns = np.concatenate([*parts, np.ones((record.samples, int(rules.offset)))], axis=1)
    _refuse_few(label, len(target), columns.shape[1])
    lengths = np.linalg.norm(columns[record.observed], axis=0)
    columns = columns / np.where(lengths > 0, lengths, 1.0)
    found = _least_squares(columns[record.observed], target)
    return Simulation(forced + columns @ found, lambda: Directions(np.zeros((record.samples, 0)), columns))


def _refuse_few(label: str, observed: int, unknowns: int) -> None:
    if unknowns and unknowns >= observed:
        raise StructureError(
            f"the record has {observed} observed output samples and model {label!r} {unknowns} states to estimate "
            "from them, so that nothing is left to judge it by; use a longer record, or initial_state='zero'"
        )


def _least_squares(columns: Array, target: Array) -> Array:
    """Smallest solution, from the triangular factor: columns of unit length keep their singular values in it."""
    size = columns.shape[1]
    factor = factor_of(np.concatenate([columns.T, target[None]]))
    found = np.linalg.lstsq(factor[:size, :size], factor[:size, size], rcond=len(target) * _checks.EPS)[0]
    return np.asarray(found)


# --- results of a fit ------------------------------------------------------------------------------------------------


def _fitted_model(model: PEMResult, label: str, record: Record, rules: Rules) -> Simulation:
    place = own_place(model, record)
    if place is not None and _keeps_its_state(model, place, rules.initial_state):
        return Simulation(model.experiments[place].predicted, lambda: fitted_directions(model, place), True)
    steps = [one.record.dt for one in model.experiments if isinstance(one.record, Record)]
    if model.method != "exact" and steps and all(abs(record.dt - h) > STEP_TOLERANCE * record.dt for h in steps):
        raise StructureError(
            f"the record has the step {record.dt:.6g}, model {label!r} was fitted with method={model.method!r} at the "
            f"step {steps[0]:.6g}, and holds at that step only"
        )
    hold = Hold(record.dt, model.method, model.intersample)
    estimate, constant = rules.estimates(record), has_offset(model)
    unknowns = 2 * int(np.count_nonzero(model.r > 0)) * estimate + constant
    if rules.initial_state != "fitted":
        _refuse_few(label, int(record.observed.sum()), unknowns)
    state, offset = _state(model, label, record, hold, rules)
    predicted = np.reshape(response_on(model.system, record, state, hold, model.quantity, offset).y, -1)

    def directions() -> Directions:
        parts = [np.zeros((record.samples, 0))]
        if rules.initial_state != "fitted":
            parts += [_lossless_columns(model.system, record.samples, hold)] * estimate
            parts += [np.ones((record.samples, 1))] * constant
        shared = np.zeros((record.samples, 0))
        if place is not None:
            own = fitted_directions(model, place)
            shared, parts = own.shared, [*parts, own.local]
        return Directions(shared, np.concatenate(parts, axis=1))

    return Simulation(predicted, directions, place is not None)


def has_offset(model: PEMResult) -> bool:
    """Whether a constant was estimated in each record."""
    return bool(np.isfinite(model.offset_stderr).any())


def _state(model: PEMResult, label: str, record: Record, hold: Hold, rules: Rules) -> tuple[Array, float]:
    """State at the first sample, and offset: by the rule of the fit, for these data."""
    if rules.initial_state == "fitted":
        return _kept_state(model, label)
    if rules.estimates(record):
        return estimated_state(model.system, record, hold, model.quantity, has_offset(model))
    rest = np.zeros(2 * model.order)
    if not has_offset(model):
        return rest, 0.0
    forced = np.reshape(response_on(model.system, record, rest, hold, model.quantity, 0.0).y, -1)
    return rest, float(np.mean((record.y - forced)[record.observed]))


def _kept_state(model: PEMResult, label: str) -> tuple[Array, float]:
    if len(model.experiments) > 1:
        raise StructureError(
            f"model {label!r} was fitted to {len(model.experiments)} experiments, each with a state of its own, and "
            "this record is none of them; use initial_state='estimate' or 'zero'"
        )
    if not isinstance(model.experiments[0].record, Record):
        raise StructureError(
            f"model {label!r} was fitted to a frequency response, which has no initial state; use "
            "initial_state='estimate' or 'zero'"
        )
    return model.initial_state, float(model.offsets[0])


def _keeps_its_state(model: PEMResult, place: int, initial_state: str) -> bool:
    """Whether the prediction of the fit itself is asked for: that from its state, estimated on these very data."""
    one = model.experiments[place]
    driven = isinstance(one.record, Record) and one.record.driven
    from_rest = driven and not one.free_amplitudes.any()
    return initial_state == "fitted" or (initial_state == "zero" and driven) == from_rest


def own_place(model: PEMResult, record: Any) -> int | None:
    """Which of its own experiments these data are, if any."""
    return next((k for k, one in enumerate(model.experiments) if same_data(record, one.record)), None)


# --- lossless systems ------------------------------------------------------------------------------------------------


def _lossless_system(model: Any, label: str, record: Record, rules: Rules) -> Simulation:
    ports = model.nports if isinstance(model, ModalForm) else model.ninputs
    one_port(label, ports, ports, "record")
    system = ph(model) if isinstance(model, ModalForm) else model
    hold = rules.hold(record.dt)
    response = forced_response(
        system, record.time, record.u, method=hold.method, intersample=hold.intersample, return_states=False
    )
    growth = float(np.hypot(1.0, hold.h * system.modes.d.max(initial=0.0))) if hold.method == "euler" else 1.0

    def columns(samples: int) -> Array:
        return _lossless_columns(system, samples, hold)

    return _completed(np.reshape(response.y, -1), columns, label, record, rules, growth)


def _lossless_columns(system: LosslessSystem, samples: int, hold: Hold) -> Array:
    """Free motions at the output: sines and cosines, and powers of time where there are poles at 0 or repeated ones.

    An observable form shows every mode, whatever its weight, and for repeated frequencies motions that grow.
    """
    modes = system.modes
    everything = isinstance(system, ObservableHamiltonian)
    d = modes.d[modes.nu.any(axis=1) | everything]
    k = np.arange(float(samples))
    repeats = np.arange(len(d)) - np.searchsorted(d, d)
    motions = hold.step(imaginary(-d)).powers(k) * (k / samples) ** (repeats if everything else 0 * repeats)[:, None]
    if everything:
        powers = 2 * len(modes.rigid)
    else:
        powers = int(modes.rigid.any()) * (2 if isinstance(system, AffineHamiltonian) else 1)
    return np.concatenate([motions.real, motions.imag, (k / samples) ** np.arange(powers)[:, None]]).T


def fitted_directions(model: PEMResult, place: int) -> Directions:
    """Derivatives of the prediction of one experiment of a fit by `(d, kappa)`, and by its free motion and offset."""
    one = model.experiments[place]
    seen = [l for l in range(model.order) if l not in model.unseen]
    weighted = np.array([l not in model.active for l in seen], bool)
    d, kappa = model.d[seen], model.modes.kappa[seen]
    if isinstance(one.record, FrequencyRecord):
        return of_response(one.record, d, kappa, weighted, model.quantity)
    hold = Hold(one.record.dt, model.method, model.intersample)
    moving = weighted if model.representation == "controllable" else np.ones(len(seen), bool)
    offset = int(np.isfinite(model.offset_stderr[place])) + (one.drift != 0)
    return of_record(one.record, d, kappa, one.free_amplitudes[seen], weighted, moving, hold, model.quantity, offset)

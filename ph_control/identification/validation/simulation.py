"""What a model of any kind says of an experiment: its output there, and the directions in which it was fitted to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import control as ct
import numpy as np

from ... import _checks
from ..._options import COMPARED_STATES, DISCRETISATIONS, INTERPOLATIONS, ComparedState, Discretisation, Interpolation
from ..._types import Array, ComplexArray, Indices, RealOrComplex
from ...analysis.spectral_window import estimated_response
from ...analysis.time_response import forced_response
from ...exceptions import StructureError
from ...modal.discretization import Hold, MatrixStep
from ...modal.modal_form import ModalForm, imaginary
from ...modal.propagation import step_through
from ...numerics.invariant_subspaces import equilibrated
from ...numerics.rational import LinearSystem, state_space
from ...systems.affine import AffineHamiltonian
from ...systems.base import LosslessSystem, in_normal_form
from ...systems.canonical_forms import ObservableHamiltonian
from ...systems.port_hamiltonian import ph
from ..data.channels import Kind, Recording, ResponseMatrix, recording, several
from ..data.frequency_record import FrequencyRecord, InFrequency, LineErrors
from ..data.time_record import InTime, Record
from ..data.windowed import windowed_response
from ..diagnosis.fitted_directions import Directions, directions_of, same_data
from ..fit.pem_result import PEMResult
from ..fit.prediction_ahead import ahead, ahead_of_growth, grows, is_simulated
from ..regression.prediction import FittedChannels, FittedExperiment, halved, unknown_samples
from .measured import Model

_STEP_TOLERANCE = 0.01  # as between the time of a record and its dt
_DIVERGED = 1e10  # times the measured output: forced and free motion then cancel to a few digits
_ROUNDING = 1e-9  # relative: a frequency at the Nyquist frequency may round beyond it


@dataclass(frozen=True)
class Simulation:
    """Output of a model in an experiment, and what of it was fitted to that experiment.

    `output` has shape (T,), or is complex of shape (K,) for a frequency response; (p, T) or (p, m, K) of several
    channels, of which there are no directions.  `directions()` are its derivatives
    by all that was estimated from these data: noise along them is missing from the residuals.  `own` tells the data
    that the model itself was fitted to, and `past` how many coefficients of the noise foretell it there.  `errors` are
    those of a response that was estimated with a window.
    """

    output: RealOrComplex
    directions: Callable[[], Directions]
    own: bool = False
    past: int = 0
    errors: LineErrors | None = None


@dataclass(frozen=True)
class Motions:
    """Output from rest, free motions at the output along one axis more, and the growth of a mode in a step.

    Of shapes (T,) and (T, n), or (p, T) and (p, T, n) of several channels.
    """

    forced: Array
    free: Callable[[], Array]
    growth: float


@dataclass(frozen=True)
class Rules:
    """How models meet a record: hold, initial state, and whether a constant is added where a model has none.

    Outputs are predicted a `horizon` of steps ahead by models with a noise, and simulated without one.
    """

    method: Discretisation
    intersample: Interpolation
    initial_state: ComparedState
    offset: bool
    horizon: int | None = None

    def __post_init__(self) -> None:
        _checks.choice("method", self.method, DISCRETISATIONS)
        _checks.choice("intersample", self.intersample, INTERPOLATIONS)
        _checks.choice("initial_state", self.initial_state, COMPARED_STATES)
        _checks.flags(offset=self.offset)

    def hold(self, dt: float) -> Hold:
        """The hold at a step."""
        return Hold(dt, self.method, self.intersample)


def simulations_of(
    models: Sequence[Model], labels: Sequence[str], records: Sequence[Kind], rules: Rules
) -> list[list[Simulation]]:
    """What each model says of each experiment; errors name the experiment if there are several."""
    simulations = []
    for place, record in enumerate(records, start=1):
        try:
            simulations.append(
                [_simulation_of(model, label, record, rules) for model, label in zip(models, labels, strict=True)]
            )
        except StructureError as error:
            if len(records) == 1:
                raise
            raise type(error)(f"experiment {place}: {error}") from None
    return simulations


def _simulation_of(model: Model, label: str, record: Kind, rules: Rules) -> Simulation:
    """What a `PEMResult`, a system of this package, or a linear system of python-control says of an experiment."""
    if isinstance(model, PEMResult):
        return _prediction_ahead(_simulation_of_fit(model, label, record, rules), model, record, rules)
    if isinstance(record, FrequencyRecord | ResponseMatrix):
        return Simulation(_response(model, label, record), lambda: _no_directions(record))
    _refuse_fitted(model, label, rules)
    system, hold = _system_of(model, label, record), rules.hold(record.dt)
    if isinstance(record, Record) and in_normal_form(system):
        return _with_free_motion(_lossless_motions(system, record, hold), label, record, rules)
    return _with_free_motion(_linear_motions(system, label, record, hold), label, record, rules)


def _refuse_fitted(model: Model, label: str, rules: Rules) -> None:
    if rules.initial_state == "fitted":
        raise StructureError(
            f"initial_state='fitted' is that of a PEMResult; model {label!r} is a {type(model).__name__}, which keeps "
            "none: use 'estimate' or 'zero'"
        )


def _keeps_its_state(experiment_fit: FittedExperiment | FittedChannels, initial_state: str) -> bool:
    """Whether the rules want the prediction of the fit itself, from the initial state that it has estimated."""
    if isinstance(experiment_fit.record, InFrequency) or initial_state == "fitted":
        return True
    from_rest = experiment_fit.record.driven and not experiment_fit.free_amplitudes.any()
    return bool((initial_state == "zero" and experiment_fit.record.driven) == from_rest)


def _no_directions(record: Kind) -> Directions:
    return Directions(*np.zeros((2, record.samples, 0)))


def _system_of(model: Model, label: str, record: Kind) -> LinearSystem:
    """The system of a model; refuse what is no linear system, or has not the channels of the data."""
    system = _system_of_form(model) if isinstance(model, ModalForm) else model
    if not isinstance(system, ct.StateSpace | ct.TransferFunction):
        raise StructureError(
            f"model {label!r} is a {type(system).__name__}; pass a PEMResult, a system of this package, or a "
            "control.StateSpace or control.TransferFunction"
        )
    _matching_channels(system, label, record)
    return system


def _system_of_form(form: Any) -> ct.StateSpace:
    """System of a modal form; one that is not passive has a state space only."""
    try:
        return ph(form)
    except StructureError:
        return form.state_space()


def _matching_channels(model: LinearSystem, label: str, record: Kind) -> tuple[Indices, Indices]:
    """Which outputs and inputs of a model are those of the data: by their labels if these are the same, or in order.

    Without an input all those of the model are at rest.
    """
    outputs, inputs = list(model.output_labels), list(model.input_labels)
    multichannel = isinstance(record, Recording | ResponseMatrix)
    rows = list(record.output_labels) if isinstance(record, Recording | ResponseMatrix) else outputs[:1]
    columns = list(record.input_labels) if isinstance(record, Recording | ResponseMatrix) else inputs[:1]
    if len(outputs) != len(rows) or (columns and len(inputs) != len(columns)) or (not multichannel and len(inputs) > 1):
        data_channels = f"{len(columns)} inputs and {len(rows)} outputs" if multichannel else "one of each"
        data = "response" if isinstance(record, InFrequency) else "record"
        raise StructureError(
            f"model {label!r} has {len(inputs)} inputs and {len(outputs)} outputs, the {data} {data_channels}; pass "
            "the entries that were measured, such as model[0, 0]"
        )
    indices = [
        np.array(
            [names.index(name) for name in wanted] if sorted(names) == sorted(wanted) else np.arange(len(names)), int
        )
        for names, wanted in ((outputs, rows), (inputs, columns))
    ]
    return indices[0], indices[1]


def _with_free_motion(motions: Motions, label: str, record: Record | Recording, rules: Rules) -> Simulation:
    """Add the free motion and the constants that fit the outputs best, where they are asked for."""
    forced, growth = motions.forced, motions.growth
    if not np.isfinite(forced).all():
        sample = int(np.argmin(np.isfinite(forced).reshape(-1, record.samples).all(axis=0)))
        raise StructureError(
            f"model {label!r} is unstable: its modes grow by up to {growth:.6g} a sample, and its output leaves the "
            f"range of doubles at sample {sample}; compare on a shorter record, or stabilise the model"
        )
    # without it nothing moves in a record without input
    estimate = rules.initial_state == "estimate" or not record.driven
    target = (record.y - forced)[record.observed]
    size, measured = float(np.max(np.abs(forced))), float(np.nanmax(np.abs(record.y)))
    if estimate and growth > 1 and size > _DIVERGED * measured:
        raise StructureError(
            f"model {label!r} is unstable: its modes grow by up to {growth:.6g} a sample, and from rest it reaches "
            f"{size:.3g} where {measured:.3g} was measured: no initial state can be told from that; use "
            "initial_state='zero' or a shorter record"
        )
    free_motions = [motions.free()] if estimate else []
    # a constant of each output
    constants = np.ones((record.samples, 1)) if forced.ndim == 1 else np.eye(len(forced))[:, None]
    constants = np.broadcast_to(constants, (*forced.shape, constants.shape[-1]))
    columns = np.concatenate([*free_motions, constants[..., : constants.shape[-1] * rules.offset]], axis=-1)
    if 0 < columns.shape[-1] >= len(target):
        raise StructureError(
            f"the record has {len(target)} observed output samples and model {label!r} {columns.shape[-1]} states to "
            "estimate from them, so that nothing is left to judge it by; use a longer record, or initial_state='zero'"
        )
    # outputs of other units count alike
    scale = np.nanstd(record.y, axis=-1, keepdims=True) if forced.ndim > 1 else np.ones(1)
    scale = np.broadcast_to(np.where(scale > 0, scale, 1.0), forced.shape)[record.observed]
    norms = np.linalg.norm(columns[record.observed] / scale[:, None], axis=0)
    columns = columns / np.where(norms > 0, norms, 1.0)
    # the smallest solution, where the columns depend on one another
    rows = columns[record.observed] / scale[:, None]
    coefficients = np.linalg.lstsq(rows, target / scale, rcond=len(target) * _checks.EPS)[0]
    return Simulation(forced + columns @ coefficients, lambda: Directions(np.zeros((record.samples, 0)), columns))


# --- results of a fit ------------------------------------------------------------------------------------------------


def _simulation_of_fit(model: PEMResult, label: str, record: Kind, rules: Rules) -> Simulation:
    """What a fit says of an experiment: its own prediction where it was fitted to it, by its own rules elsewhere."""
    _matching_channels(model, label, record)
    place = next((k for k, data in enumerate(model.experiments) if same_data(record, data.record)), None)
    if place is not None and _keeps_its_state(model.experiments[place], rules.initial_state):
        own_directions = partial(_own_directions, model, place)
        return Simulation(model.experiments[place].predicted, own_directions, True, errors=_errors_at(model, record))
    if isinstance(record, FrequencyRecord | ResponseMatrix):
        output = _response(model, label, record)
        return Simulation(output, lambda: _no_directions(record), errors=_errors_at(model, record))
    steps = [data.record.dt for data in model.experiments if isinstance(data.record, InTime)]
    if model.method != "exact" and steps and all(abs(record.dt - h) > _STEP_TOLERANCE * record.dt for h in steps):
        raise StructureError(
            f"the record has the step {record.dt:.6g}, model {label!r} was fitted with method={model.method!r} at the "
            f"step {steps[0]:.6g}, and holds at that step only"
        )
    data, outputs = _in_order_of(model, label, record)
    state = "estimate" if rules.initial_state == "zero" and not data.driven else rules.initial_state
    output = np.reshape(model.predict(data, initial_state=state).outputs, (len(outputs), -1))
    if state == "zero" and model.offsets.any():
        # a constant is that of the sensor, whatever the plant does
        output = output + np.nanmean(np.where(data.observed, data.y - output, np.nan), axis=1, keepdims=True)
    if state != "zero":  # of late outputs the first samples answer to inputs that nobody has recorded
        output[np.arange(data.samples) < unknown_samples(model._latest, data.dt, data.u)[:, None]] = np.nan
    output = output[0] if isinstance(record, Record) else output[outputs]
    return Simulation(
        output, lambda: _no_directions(record) if place is None else _own_directions(model, place), place is not None
    )


def _in_order_of(model: PEMResult, label: str, record: Record | Recording) -> tuple[Recording, Indices]:
    """A recording with its channels in the order of a fit, and the places of its outputs there; u is 0 without any."""
    data = several(record)
    outputs, inputs = _matching_channels(model, label, data)
    u, y = np.zeros((len(inputs), data.samples)), np.empty_like(data.y)
    u[inputs] = data.u if len(data.u) else 0.0
    y[outputs] = data.y
    return replace(data, u=u, y=y, input_labels=model.input_labels), outputs


def _prediction_ahead(simulation: Simulation, model: PEMResult, record: Kind, rules: Rules) -> Simulation:
    """What a fit foretells some steps ahead, and in which directions it was fitted; of a response its simulation."""
    horizon = rules.horizon
    if horizon is None or isinstance(record, FrequencyRecord | ResponseMatrix) or is_simulated(model):
        return simulation
    data, outputs = _in_order_of(model, "model", record)
    u, y, simulated = data.u, data.y, np.empty_like(data.y)
    simulated[outputs] = np.reshape(simulation.output, data.y.shape)

    def shaped(values: Array) -> Array:
        return values[outputs][0] if isinstance(record, Record) else values[outputs]

    def directions() -> Directions:
        """Derivatives of the prediction `simulated + F (y - simulated)` with a linear filter F, and by this filter."""
        if grows(model):
            return _no_directions(record)
        fitted, nothing = simulation.directions(), np.where(np.isnan(y), np.nan, 0.0)
        shared, local = (
            np.array([ahead(model, column[None], nothing, data.dt, horizon)[0] for column in columns.T])
            .reshape(columns.T.shape).T
            for columns in (fitted.shared, fitted.local)
        )  # fmt: skip
        return Directions(shared, local)

    past = max(model.noise.orders) * simulation.own if model.noise else 0
    moving = rules.initial_state != "zero" or not data.driven
    predicted = ahead_of_growth(model, u, y, data.dt, horizon, moving) if grows(model) else (
        ahead(model, simulated, y, data.dt, horizon)
    )  # fmt: skip
    return Simulation(shaped(predicted), directions, simulation.own, past)


def _errors_at(model: PEMResult, record: Kind) -> LineErrors | None:
    """Errors of windowed responses at the frequencies of a record, as a fit to such has them."""
    if not isinstance(record, InFrequency) or record.window is None:
        return None
    responses: list[Any] = [data.record for data in model.experiments if isinstance(data.record, InFrequency)]
    return next((data.errors for data in responses if np.array_equal(data.omega, record.omega)), None)


def _own_directions(model: PEMResult, place: int) -> Directions:
    """Derivatives of the prediction of one experiment of a fit by its parameters; none of several channels."""
    data: Any = model.experiments[place]
    if isinstance(data.record, Recording | ResponseMatrix):
        return _no_directions(data.record)
    return directions_of(data, model)


# --- lossless systems ------------------------------------------------------------------------------------------------


def _lossless_motions(system: LosslessSystem, record: Record, hold: Hold) -> Motions:
    """Motions of a system of the package without losses."""
    forced = forced_response(system, record.time, record.u, method=hold.method, intersample=hold.intersample).y
    growth = float(np.hypot(1.0, hold.h * system.modes.d.max(initial=0.0))) if hold.method == "euler" else 1.0
    return Motions(np.reshape(forced, -1), lambda: _lossless_columns(system, record.samples, hold), growth)


def _lossless_columns(system: LosslessSystem, samples: int, hold: Hold) -> Array:
    """Free motions at the output: sines and cosines, and powers of time where there are poles at 0 or repeated ones.

    An observable form shows every mode, whatever its weight, and for repeated frequencies motions that grow.
    """
    modes = system.modes
    observable = isinstance(system, ObservableHamiltonian)
    d = modes.d[modes.nu.any(axis=1) | observable]
    k = np.arange(float(samples))
    repeats = np.arange(len(d)) - np.searchsorted(d, d)
    motions = hold.step(imaginary(-d)).powers(k) * (k / samples) ** (repeats if observable else 0 * repeats)[:, None]
    if observable:
        powers = 2 * len(modes.rigid)
    else:
        powers = int(modes.rigid.any()) * (2 if isinstance(system, AffineHamiltonian) else 1)
    return np.concatenate([motions.real, motions.imag, (k / samples) ** np.arange(powers)[:, None]]).T


# --- other linear systems --------------------------------------------------------------------------------------------


def _linear_motions(model: Model, label: str, record: Record | Recording, hold: Hold) -> Motions:
    """Motions of a linear system: of one in discrete time as it is, by the rule of `hold` otherwise."""
    try:
        system = state_space(model)
    except StructureError as error:
        raise StructureError(f"model {label!r} has no state-space form, so it cannot be simulated: {error}") from None
    A, B, C, D = (np.asarray(matrix, float) for matrix in (system.A, system.B, system.C, system.D))
    for name, matrix in (("A", A), ("B", B), ("C", C), ("D", D)):
        _checks.finite(f"{name} of model {label!r}", matrix)
    A, B, C = equilibrated(A, B, C)
    step = MatrixStep(A, 0 * A, B, 0 * B)
    if system.isctime():
        try:
            step = hold.step_of_matrices(A, B)
        except StructureError as error:
            raise StructureError(f"model {label!r} cannot be simulated: {error}") from None
        if not (np.isfinite(step.F).all() and np.isfinite(step.held).all()):
            raise StructureError(
                f"model {label!r} is unstable: within one step of {hold.h:.6g} its state leaves the range of doubles; "
                "check its unit of time"
            )
    elif not isinstance(system.dt, bool) and abs(system.dt - hold.h) > _STEP_TOLERANCE * hold.h:
        raise StructureError(
            f"model {label!r} is discrete-time with dt = {system.dt:g}, the record has the step {hold.h:.6g}; resample "
            "one of them, or pass the continuous-time model"
        )
    growth = float(np.max(np.abs(np.linalg.eigvals(step.F)), initial=0.0))
    rows, columns = _matching_channels(system, label, record)
    u, C, D = np.zeros((len(columns), record.samples)), C[rows], D[rows]
    u[columns] = record.u if len(record.u) else 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        forced = C @ step_through(step, u) + D @ u
    outputs = slice(None) if isinstance(record, Recording) else 0
    return Motions(forced[outputs], lambda: _free_motions(step.F, C, record.samples)[outputs], growth)


@np.errstate(over="ignore", invalid="ignore")
def _free_motions(F: Array, C: Array, samples: int) -> Array:
    """Free motions at the outputs from each unit state, shape (p, T, n): the columns of observability."""
    rows = C[:, None]
    while rows.shape[1] < samples:
        rows, F = np.concatenate([rows, rows @ F], axis=1), F @ F
    return rows[:, :samples]


# --- frequency responses ---------------------------------------------------------------------------------------------


def _response(model: Model, label: str, record: FrequencyRecord | ResponseMatrix) -> ComplexArray:
    """Response at the frequencies of a record; refused where it is infinite at a point that was measured."""
    background = getattr(model, "background", None)
    delays = np.add.outer(model.delay, model.input_delay) if isinstance(model, PEMResult) else np.zeros((1, 1))
    system = _system_of(getattr(model, "observed_system", model), label, record)
    points = 1j * record.omega if system.isctime() else np.exp(1j * _sampled_phases(system, label, record))
    if record.window is not None:
        response = _windowed_response(model, system, label, record)
    else:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            response = system.horner(points, warn_infinite=False)
    response = response if background is None else response + background.response(record.omega)
    if delays.any():
        with np.errstate(invalid="ignore"):
            response = response * np.exp(-1j * np.multiply.outer(delays, record.omega))
    response = (
        response[np.ix_(*_matching_channels(system, label, record))] if record.observed.ndim > 1 else response[0, 0]
    )
    infinite = ~np.isfinite(response)
    offending = np.flatnonzero((infinite & record.observed).reshape(-1, record.samples).any(axis=0))
    if len(offending):
        k = int(offending[0])
        raise StructureError(
            f"model {label!r} has a pole at omega = {record.omega[k]:.6g}, point {k} of the response: it is infinite "
            "there, and no finite measurement agrees with that; mark the point as missing with NaN to leave it out"
        )
    return np.asarray(response, complex)


def _windowed_response(model: Any, system: Any, label: str, record: FrequencyRecord | ResponseMatrix) -> ComplexArray:
    """Response of a model as the window of the data shows it, in the order of the channels of the model.

    Of a system that is no fit, inputs without content beyond the Nyquist frequency are taken for held ones.
    """
    window = record.window
    assert window is not None
    if isinstance(model, PEMResult):
        half_residues = halved(model.poles, model.residues)
        return windowed_response(window, record.omega, model.poles, half_residues, model.feedthrough)
    hold = Hold(window.step, "exact", "zoh" if window.hold == "bandlimited" else window.hold)
    held_window = replace(window, hold=hold.intersample)
    m, count = len(system.input_labels), window.length + 1
    impulse_responses = []
    for k in range(m):
        u = np.zeros((m, count))
        u[k, 1] = 1.0  # a linear input rises before
        impulse = recording(
            None, window.step, list(u), list(np.zeros((len(system.output_labels), count))),
            tuple(system.input_labels), tuple(system.output_labels),
        )  # fmt: skip
        impulse_responses.append(_linear_motions(system, label, impulse, hold).forced[:, 1:])
    return estimated_response(held_window, np.stack(impulse_responses, axis=1), record.omega)


def _sampled_phases(system: LinearSystem, label: str, record: FrequencyRecord | ResponseMatrix) -> Array:
    """Phase between samples of a discrete-time system at each frequency, below half a turn."""
    if isinstance(system.dt, bool):
        raise StructureError(
            f"model {label!r} is discrete-time with an unspecified step, so that its response has no frequencies in "
            "rad per unit of time; give it a dt"
        )
    nyquist = np.pi / system.dt
    if record.omega[-1] > nyquist * (1 + _ROUNDING):
        raise StructureError(
            f"model {label!r} is discrete-time with dt = {system.dt:g}, and is not defined above its Nyquist frequency "
            f"{nyquist:.6g}; the response reaches {record.omega[-1]:.6g}: leave these points out"
        )
    return np.asarray(record.omega * system.dt)

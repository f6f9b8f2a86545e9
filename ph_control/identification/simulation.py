"""What a model of any kind says of a record: its output there, and the directions in which it was fitted to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, matrix_balance, toeplitz

from .. import _checks
from ..affine import AffineHamiltonian
from ..canonical_forms import ObservableHamiltonian
from ..exceptions import StructureError
from ..lossless_system import LosslessSystem
from ..modal import ModalForm
from ..response import forced_response
from ..systems import ph
from .data import Record
from .regressors import Hold, regressors
from .result import PEMResult

Array = NDArray[np.float64]

INITIAL_STATES = ("estimate", "zero", "fitted")

_BLOCK = 256  # samples between which only the state is carried
_DIVERGED = 1e10  # times the measured output: forced and free motion then cancel to a few digits
_STEP_TOLERANCE = 0.01  # as between the time of a record and its dt


@dataclass(frozen=True)
class Simulation:
    """Output of a model along a record, shape (T,), and what of it was fitted to the outputs of that record.

    `directions`, shape (T, k), are the derivatives of the output by all that was estimated from this record: noise
    along them is missing from the residuals.  `own` tells the record that the model itself was fitted to.
    """

    output: Array
    directions: Array
    own: bool = False


def simulate_on(model: Any, label: str, record: Record, hold: Hold, initial_state: str) -> Simulation:
    """Output of a `PEMResult`, a system of this package, or a linear system of python-control along a record."""
    _checks.choice("initial_state", initial_state, INITIAL_STATES)
    if isinstance(model, PEMResult):
        return _fitted_model(model, label, record, initial_state)
    if initial_state == "fitted":
        raise StructureError(
            f"initial_state='fitted' is that of a PEMResult; model {label!r} is a {type(model).__name__}, which keeps "
            "none: use 'estimate' or 'zero'"
        )
    estimate = initial_state == "estimate"
    if isinstance(model, ModalForm | LosslessSystem):
        return _lossless_system(model, label, record, hold, estimate)
    if not isinstance(model, ct.StateSpace | ct.TransferFunction):
        raise StructureError(
            f"model {label!r} is a {type(model).__name__}; pass a PEMResult, a system of this package, or a "
            "control.StateSpace or control.TransferFunction"
        )
    _one_port(label, model.ninputs, model.noutputs)
    sampled = _sampled(model, label, record.dt, hold)
    return _completed(sampled.forced(record.u), sampled.free, label, record, estimate, sampled.growth)


def _one_port(label: str, inputs: int, outputs: int) -> None:
    if (inputs, outputs) != (1, 1):
        raise StructureError(
            f"model {label!r} has {inputs} inputs and {outputs} outputs, the record one of each; pass the entry that "
            "was measured, such as model[0, 0]"
        )


def _completed(
    forced: Array, free_columns: Any, label: str, record: Record, estimate: bool, growth: float
) -> Simulation:
    """Add the free motion that fits the outputs best, or none."""
    if not np.isfinite(forced).all():
        where = int(np.argmin(np.isfinite(forced)))
        raise StructureError(
            f"model {label!r} is unstable: its modes grow by up to {growth:.6g} a sample, and its output leaves the "
            f"range of doubles at sample {where}; compare on a shorter record, or stabilise the model"
        )
    if not estimate:
        return Simulation(forced, np.zeros((record.samples, 0)))
    target = (record.y - forced)[record.observed]
    size, measured = float(np.max(np.abs(forced))), float(np.nanmax(np.abs(record.y)))
    if growth > 1 and size > _DIVERGED * measured:
        raise StructureError(
            f"model {label!r} is unstable: its modes grow by up to {growth:.6g} a sample, and from rest it reaches "
            f"{size:.3g} where {measured:.3g} was measured: no initial state can be told from that; use "
            "initial_state='zero' or a shorter record"
        )
    columns = free_columns(record.samples)
    if columns.shape[1] >= len(target):
        raise StructureError(
            f"the record has {len(target)} observed output samples and model {label!r} {columns.shape[1]} states to "
            "estimate from them, so that nothing is left to judge it by; use a longer record, or initial_state='zero'"
        )
    lengths = np.linalg.norm(columns[record.observed], axis=0)
    columns = columns / np.where(lengths > 0, lengths, 1.0)
    found = np.linalg.lstsq(columns[record.observed], target, rcond=None)[0]
    return Simulation(forced + columns @ found, columns)


# --- results of a fit ------------------------------------------------------------------------------------------------


def _fitted_model(model: PEMResult, label: str, record: Record, initial_state: str) -> Simulation:
    own = _same(record, model.record)
    if own and _keeps_its_state(model, initial_state):
        return Simulation(model.predicted, _fitted_directions(model), own)
    if model.method != "exact" and abs(record.dt - model.record.dt) > _STEP_TOLERANCE * record.dt:
        raise StructureError(
            f"the record has the step {record.dt:.6g}, model {label!r} was fitted with method={model.method!r} at the "
            f"step {model.record.dt:.6g}, and holds at that step only"
        )
    predicted = np.reshape(model.predict(record, initial_state=initial_state).y, -1)
    hold = Hold(record.dt, model.method, model.intersample)
    columns = _lossless_columns(model.system, record.samples, hold)
    directions = [columns] if initial_state == "estimate" else []
    if own:
        directions.append(_fitted_directions(model))
    return Simulation(predicted, np.concatenate([np.zeros((record.samples, 0)), *directions], axis=1), own)


def _keeps_its_state(model: PEMResult, initial_state: str) -> bool:
    """Whether the prediction of the fit itself is asked for: that from its state, estimated on this very record."""
    from_rest = not model.free_amplitudes.any()
    return initial_state == "fitted" or (initial_state == "zero") == from_rest


def _same(one: Record, other: Record) -> bool:
    if one is other:
        return True
    return (
        one.samples == other.samples
        and abs(one.dt - other.dt) <= _checks.EPS * one.samples * one.dt
        and np.array_equal(one.u, other.u)
        and np.array_equal(one.y, other.y, equal_nan=True)
    )


def _fitted_directions(model: PEMResult) -> Array:
    """Derivative of the prediction of a fit by `(d, kappa, alpha, beta)`, or by `(d, kappa)` of one from rest."""
    seen = [l for l in range(model.order) if l not in model.unseen]
    d, kappa, free = model.d[seen], model.modes.kappa[seen], model.free_amplitudes[seen]
    found = regressors(d, model.record.u, Hold(model.record.dt, model.method, model.intersample))
    by_d = kappa * found.forced_slope + free.real * found.cosine_slope + free.imag * found.sine_slope
    weighted = [l not in model.active for l in seen]
    parts = [by_d, found.forced[:, weighted]]
    if free.any():
        parts += [found.cosine, found.sine]
    return np.concatenate(parts, axis=1)


# --- lossless systems ------------------------------------------------------------------------------------------------


def _lossless_system(model: Any, label: str, record: Record, hold: Hold, estimate: bool) -> Simulation:
    ports = model.nports if isinstance(model, ModalForm) else model.ninputs
    _one_port(label, ports, ports)
    system = ph(model) if isinstance(model, ModalForm) else model
    response = forced_response(
        system, record.time, record.u, method=hold.method, intersample=hold.intersample, return_states=False
    )
    growth = float(np.hypot(1.0, hold.h * system.modes.d.max(initial=0.0))) if hold.method == "euler" else 1.0

    def columns(samples: int) -> Array:
        return _lossless_columns(system, samples, hold)

    return _completed(np.reshape(response.y, -1), columns, label, record, estimate, growth)


def _lossless_columns(system: LosslessSystem, samples: int, hold: Hold) -> Array:
    """Free motions at the output: sines and cosines, and powers of time where there are poles at 0 or repeated ones.

    An observable form shows every mode, whatever its weight, and for repeated frequencies motions that grow.
    """
    modes = system.modes
    everything = isinstance(system, ObservableHamiltonian)
    d = modes.d[modes.nu.any(axis=1) | everything]
    k = np.arange(float(samples))
    repeats = np.arange(len(d)) - np.searchsorted(d, d)
    motions = hold.step(d).powers(k) * (k / samples) ** (repeats if everything else 0 * repeats)[:, None]
    if everything:
        powers = 2 * len(modes.rigid)
    else:
        powers = int(modes.rigid.any()) * (2 if isinstance(system, AffineHamiltonian) else 1)
    return np.concatenate([motions.real, motions.imag, (k / samples) ** np.arange(powers)[:, None]]).T


# --- any linear system -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Sampled:
    """Recursion `w_{k+1} = F w_k + G u_k`, `y_k = C w_k + D u_k`, from rest at `w_0 = start u_0`; one port."""

    F: Array
    G: Array
    C: Array
    D: float
    start: Array

    @property
    def growth(self) -> float:
        """Largest factor by which a mode grows in a step."""
        return float(np.max(np.abs(np.linalg.eigvals(self.F)), initial=0.0))

    def _powers(self, size: int) -> tuple[Array, Array, Array]:
        """`C F^j`, shape (size, n); `F^j G`, shape (n, size); and `F^size`."""
        rows, columns = [self.C], [self.G]
        for _ in range(size - 1):
            rows.append(rows[-1] @ self.F)
            columns.append(self.F @ columns[-1])
        return np.array(rows), np.array(columns).T, np.linalg.matrix_power(self.F, size)

    @np.errstate(over="ignore", invalid="ignore")
    def forced(self, u: Array) -> Array:
        """Output from rest: blocks of samples as matrix products, the state carried between them."""
        size = min(_BLOCK, len(u))
        rows, columns, leap = self._powers(size)
        kernel = np.concatenate([[self.D], rows[:-1] @ self.G])
        within = toeplitz(kernel, np.zeros(size))
        blocks = np.concatenate([u, np.zeros(-len(u) % size)]).reshape(-1, size)
        driven, state = blocks @ columns[:, ::-1].T, self.start * u[0]
        out = blocks @ within.T
        for block, drive in enumerate(driven):
            out[block] += rows @ state
            state = leap @ state + drive
        return np.asarray(out.reshape(-1)[: len(u)])

    @np.errstate(over="ignore", invalid="ignore")
    def free(self, samples: int) -> Array:
        """Free motions at the output from each unit state, shape (T, n): the columns of observability."""
        size = min(_BLOCK, samples)
        rows, _, leap = self._powers(size)
        parts, states = [], np.eye(len(self.F))
        for _ in range(-(-samples // size)):
            parts.append(rows @ states)
            states = leap @ states
        return np.concatenate(parts)[:samples]


def _sampled(model: Any, label: str, h: float, hold: Hold) -> _Sampled:
    """A linear system at the instants of a record: as it is in discrete time, by the rule of `hold` otherwise."""
    try:
        system = ct.ss(model, name=model.name, remove_useless_states=False)
    except ValueError as error:
        raise StructureError(f"model {label!r} has no state-space form, so it cannot be simulated: {error}") from None
    A, B, C, D = (np.asarray(matrix, float) for matrix in (system.A, system.B, system.C, system.D))
    for name, matrix in (("A", A), ("B", B), ("C", C), ("D", D)):
        _checks.finite(f"{name} of model {label!r}", matrix)
    b, c = B[:, 0], C[0]
    if len(A):
        # scaled by powers of 2, so that states of very different size are told apart
        A, (scale, _) = matrix_balance(A, permute=False, separate=True)
        b, c = b / scale, c * scale
    rest = np.zeros(len(A))
    if not model.isdtime(strict=True):
        return _discretised(A, b, c, float(D[0, 0]), label, hold)
    if not isinstance(model.dt, bool) and abs(model.dt - h) > _STEP_TOLERANCE * h:
        raise StructureError(
            f"model {label!r} is discrete-time with dt = {model.dt:g}, the record has the step {h:.6g}; resample one "
            "of them, or pass the continuous-time model"
        )
    return _Sampled(A, b, c, float(D[0, 0]), rest)


def _discretised(A: Array, b: Array, c: Array, D: float, label: str, hold: Hold) -> _Sampled:
    """Weights of `u_k` and `u_{k+1}` in a step; the second is moved into the state, as `x = w + then u`."""
    if (hold.method, hold.intersample) == ("euler", "foh"):
        raise StructureError("method='euler' uses the input at the start of each step only; intersample must be 'zoh'")
    n, h = len(A), hold.h
    F: Any
    now: Any
    now, then = h * b, 0 * b
    if hold.method == "exact":
        M = np.zeros((n + 2, n + 2))
        M[:n, :n], M[:n, n], M[n, n + 1] = h * A, h * b, 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            E = expm(M)
        F, now = E[:n, :n], E[:n, n]
        if hold.intersample == "foh":
            then = E[:n, n + 1]
            now = now - then
    elif hold.method == "midpoint":
        left = np.eye(n) - 0.5 * h * A
        try:
            F, now = np.linalg.solve(left, np.eye(n) + 0.5 * h * A), np.linalg.solve(left, h * b)
        except np.linalg.LinAlgError:
            raise StructureError(
                f"model {label!r} is unstable: it has a pole at 2/h = {2 / h:.6g}, where the midpoint rule has no "
                "step; use method='exact'"
            ) from None
        if hold.intersample == "foh":
            now = then = 0.5 * now
    else:
        F = np.eye(n) + h * A
    if not (np.isfinite(F).all() and np.isfinite(now).all()):
        raise StructureError(
            f"model {label!r} is unstable: within one step of {h:.6g} its state leaves the range of doubles; check its "
            "unit of time"
        )
    return _Sampled(F, now + F @ then, c, D + float(c @ then), -then)

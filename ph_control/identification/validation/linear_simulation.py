"""Any linear system of one port at the instants of a record: its recursion, free motions, and the response they give.

The response to an input is its convolution with the response to a pulse, by the fast Fourier transform.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance
from scipy.signal import oaconvolve

from ... import _checks
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ..data.time_record import Record

Array = NDArray[np.float64]

STEP_TOLERANCE = 0.01  # as between the time of a record and its dt

_BLOCK = 256  # samples between which only the state is carried


@dataclass(frozen=True)
class Motions:
    """Output from rest, shape (T,), free motions at the output, shape (T, n), and the growth of a mode in a step."""

    forced: Array
    free: Callable[[], Array]
    growth: float


def linear_motions(model: Any, label: str, record: Record, hold: Hold) -> Motions:
    """Motions of a linear system: of one in discrete time as it is, by the rule of `hold` otherwise."""
    try:
        system = ct.ss(model, name=model.name, remove_useless_states=False)
    except ValueError as error:
        raise StructureError(f"model {label!r} has no state-space form, so it cannot be simulated: {error}") from None
    A, B, C, D = (np.asarray(matrix, float) for matrix in (system.A, system.B, system.C, system.D))
    for name, matrix in (("A", A), ("B", B), ("C", C), ("D", D)):
        _checks.finite(f"{name} of model {label!r}", matrix)
    b, c, through = B[:, 0], C[0], float(D[0, 0])
    if len(A):
        # scaled by powers of 2, so that states of very different size are told apart
        A, (scale, _) = matrix_balance(A, permute=False, separate=True)
        b, c = b / scale, c * scale
    now, then = b, 0 * b
    if system.isctime():
        try:
            A, *weights = hold.step_of_matrices(A, b[:, None])
        except StructureError as error:
            raise StructureError(f"model {label!r} cannot be simulated: {error}") from None
        now, then = (weight[:, 0] for weight in weights)
        if not (np.isfinite(A).all() and np.isfinite(now).all()):
            raise StructureError(
                f"model {label!r} is unstable: within one step of {hold.h:.6g} its state leaves the range of doubles; "
                "check its unit of time"
            )
    elif not isinstance(system.dt, bool) and abs(system.dt - hold.h) > STEP_TOLERANCE * hold.h:
        raise StructureError(
            f"model {label!r} is discrete-time with dt = {system.dt:g}, the record has the step {hold.h:.6g}; resample "
            "one of them, or pass the continuous-time model"
        )
    # the weight of the input at the end of a step is moved into the state, x = w + then u
    free = _free_motions(A, c, record.samples)
    with np.errstate(over="ignore", invalid="ignore"):
        pulse = np.concatenate([[c @ then], (free @ (now + A @ then))[:-1]])
        known = len(pulse) if np.isfinite(pulse).all() else int(np.argmin(np.isfinite(pulse)))
        forced = np.full(record.samples, np.nan)
        forced[:known] = oaconvolve(record.u[:known], pulse[:known])[:known] if known else 0.0
        forced += through * record.u - free @ (then * record.u[0])
    return Motions(forced, lambda: free, float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0)))


@np.errstate(over="ignore", invalid="ignore")
def _free_motions(F: Array, c: Array, samples: int) -> Array:
    """Free motions at the output from each unit state, shape (T, n): the columns of observability."""
    rows = [c]
    for _ in range(min(_BLOCK, samples) - 1):
        rows.append(rows[-1] @ F)
    block, leap = np.array(rows), np.linalg.matrix_power(F, len(rows))
    parts, states = [], np.eye(len(F))
    for _ in range(-(-samples // len(rows))):
        parts.append(block @ states)
        states = leap @ states
    return np.concatenate(parts)[:samples]

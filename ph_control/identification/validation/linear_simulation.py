"""Any linear system of one port at the instants of a record: a recursion of matrices, taken in blocks of samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance, toeplitz

from ... import _checks
from ...exceptions import StructureError
from ...modal.discretization import Hold

Array = NDArray[np.float64]

STEP_TOLERANCE = 0.01  # as between the time of a record and its dt

_BLOCK = 256  # samples between which only the state is carried


@dataclass(frozen=True)
class SampledSystem:
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


def sampled_system(model: Any, label: str, h: float, hold: Hold) -> SampledSystem:
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
    if not isinstance(model.dt, bool) and abs(model.dt - h) > STEP_TOLERANCE * h:
        raise StructureError(
            f"model {label!r} is discrete-time with dt = {model.dt:g}, the record has the step {h:.6g}; resample one "
            "of them, or pass the continuous-time model"
        )
    return SampledSystem(A, b, c, float(D[0, 0]), rest)


def _discretised(A: Array, b: Array, c: Array, D: float, label: str, hold: Hold) -> SampledSystem:
    """Weights of `u_k` and `u_{k+1}` in a step; the second is moved into the state, as `x = w + then u`."""
    try:
        F, *weights = hold.step_of_matrices(A, b[:, None])
    except StructureError as error:
        raise StructureError(f"model {label!r} cannot be simulated: {error}") from None
    now, then = (weight[:, 0] for weight in weights)
    if not (np.isfinite(F).all() and np.isfinite(now).all()):
        raise StructureError(
            f"model {label!r} is unstable: within one step of {hold.h:.6g} its state leaves the range of doubles; "
            "check its unit of time"
        )
    return SampledSystem(F, now + F @ then, c, D + float(c @ then), -then)

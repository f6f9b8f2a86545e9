"""Models of pyMOR from systems, and back: its reductors are a call away."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np

from .._types import Array
from ..exceptions import StructureError, installed
from ..systems.dissipative import parts_of
from ..systems.port_hamiltonian import PortHamiltonian, ph


def to_pymor(sys: ct.StateSpace) -> Any:
    """Make a model of pyMOR.

    Parameters
    ----------
    sys : control.StateSpace
        Continuous-time system.

    Returns
    -------
    pymor.models.iosys.PHLTIModel or pymor.models.iosys.LTIModel
        The first of a `PortHamiltonian` without sensors, with its `J`, `R`, `G`, `P`, `S`, `N` and `Q`.

    Raises
    ------
    MissingPackageError
        If pyMOR is not installed.
    StructureError
        If `sys` is not such a system.

    Notes
    -----
    Matrices are copied: O(n^2), without rounding.

    Examples
    --------
    >>> import ph_control as phc
    >>> from pymor.reductors.ph.ph_irka import PHIRKAReductor  # doctest: +SKIP
    >>> model = phc.to_pymor(phc.msd_chain(50))  # doctest: +SKIP
    >>> small = phc.from_pymor(PHIRKAReductor(model).reduce(10))  # doctest: +SKIP
    """
    if not isinstance(sys, ct.StateSpace) or sys.isdtime(strict=True):
        raise StructureError(
            f"this is a {type(sys).__name__}, expected a StateSpace in continuous time: ph(sys), or control.ss(sys)"
        )
    iosys = _iosys()
    if isinstance(sys, PortHamiltonian):
        parts = {name: np.array(part, float) for name, part in parts_of(sys).items()}
        if not len(parts["sensor_rows"]):
            given = (parts[name] if parts[name].any() else None for name in "PSN")
            P, S, N = given
            return iosys.PHLTIModel.from_matrices(parts["J"], parts["R"], parts["G"], P=P, S=S, N=N, Q=parts["Q"])
    A, B, C, D = (np.array(getattr(sys, name), float) for name in "ABCD")
    return iosys.LTIModel.from_matrices(A, B, C, D)


def from_pymor(model: Any) -> ct.StateSpace:
    """Make a system of a model of pyMOR.

    Parameters
    ----------
    model : pymor.models.iosys.PHLTIModel or pymor.models.iosys.LTIModel
        Continuous-time model without parameters.

    Returns
    -------
    PortHamiltonian or control.StateSpace
        The first of a `PHLTIModel`: of `E x' = (J - R) Q x + ..` with the energy `x^T Q^T E x / 2` in the states `E x`.

    Raises
    ------
    MissingPackageError
        If pyMOR is not installed.
    StructureError
        If it is no such model, or its `E` is singular.

    Notes
    -----
    O(n^3) with `E`, which is inverted.

    Examples
    --------
    See `to_pymor`.
    """
    iosys = _iosys()
    if not isinstance(model, iosys.LTIModel) or model.sampling_time:
        raise StructureError(
            f"this is a {type(model).__name__}, expected an LTIModel or PHLTIModel of pyMOR in continuous time"
        )
    if isinstance(model, iosys.PHLTIModel):
        J, R, G, P, S, N, E, Q = (_dense(matrix) for matrix in model.to_matrices())
        n = len(J)
        energy = np.eye(n) if Q is None else Q
        if E is not None:
            energy = _divided(energy.T, E.T).T
        return ph(0.5 * (energy + energy.T), G, J=J, R=np.zeros((n, n)) if R is None else R, P=P, S=S, N=N)
    A, B, C, D, E = (_dense(matrix) for matrix in model.to_matrices()[:5])
    if E is not None:
        A, B = _divided(A, E), _divided(B, E)
    return ct.ss(A, B, C, np.zeros((len(C), B.shape[1])) if D is None else D)


def _divided(matrix: Array, E: Array) -> Array:
    """`E^-1 matrix`."""
    if not np.linalg.cond(E) < 1 / np.finfo(float).eps:
        raise StructureError(
            f"E of the model is singular, of condition {np.linalg.cond(E):.1e}: it has algebraic equations; eliminate "
            "them first"
        )
    return np.asarray(np.linalg.solve(E, matrix), float)


def _dense(matrix: Any) -> Any:
    if matrix is None:
        return None
    return np.array(matrix.toarray() if hasattr(matrix, "toarray") else matrix, float)


def _iosys() -> Any:
    return installed("pymor.models.iosys", "models of pyMOR need pyMOR", "pip install pymor")

"""The energy along a response: what is stored against what was supplied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from .. import _checks
from .._display import Report
from .._units import common_unit
from ..exceptions import StructureError
from ..modal.discretization import INTERSAMPLE, METHODS, Hold
from ..symplectic.forms_and_williamson import apply_form
from ..systems.port_hamiltonian import PortHamiltonian

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class EnergyBalance(Report):
    """Stored and supplied energy along a response.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Instants.
    stored : ndarray, shape (T,)
        Energy `z^T Q z / 2` at each.
    supplied : ndarray, shape (T,)
        Energy that went in through the ports since the first instant.
    defect : ndarray, shape (T,)
        What was stored since the first instant less what was supplied: 0 where nothing is lost or made.
    time_unit : str or None
        Unit of time that the response tells; None where it tells none.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> t = np.linspace(0.0, 10.0, 101)
    >>> balance = phc.energy_balance(phc.forced_response(sys, t, np.sin(t)), sys)
    >>> bool(np.abs(balance.defect).max() < 1e-12 * balance.stored.max())
    True
    """

    time: Array
    stored: Array
    supplied: Array
    defect: Array
    time_unit: str | None = None

    def __str__(self) -> str:
        """Say over what time, and how much was stored, supplied and found or lost."""
        stored, supplied, defect = (
            float(np.max(np.abs(e), initial=0.0)) for e in (self.stored, self.supplied, self.defect)
        )
        return (
            f"{len(self.time)} instants from {self.time[0]:.6g} to {self.time[-1]:.6g}, at most {stored:.4g} stored, "
            f"{supplied:.4g} supplied, {defect:.2g} between them"
        )

    def plot(self, **kwargs: Any) -> ct.ControlPlot:
        """Picture of the energies and their difference.

        Parameters
        ----------
        **kwargs
            Keywords of `energy_plot`.

        Returns
        -------
        control.ControlPlot

        Examples
        --------
        See `energy_plot`.
        """
        from ..plotting.energy_plot import energy_plot

        return energy_plot(self, **kwargs)


def energy_balance(
    response: ct.TimeResponseData, sys: PortHamiltonian, *, method: str | None = None, intersample: str | None = None
) -> EnergyBalance:
    """Energy stored by a system and supplied to it along a response.

    Parameters
    ----------
    response : control.TimeResponseData
        Response with inputs and states, of one trace: what `forced_response` of this package gives.
    sys : PortHamiltonian
        The system that responded.
    method, intersample : str, optional
        How the response was computed, and what the input did between the samples.  By default as a response of this
        package says; 'exact' and 'foh' for any other, which is what `control.forced_response` computes.

    Returns
    -------
    EnergyBalance
        Stored and supplied energy, and their difference.

    Raises
    ------
    StructureError
        If the response is none, has no states, several traces, sizes that do not fit the system or one another,
        numbers that are not real and finite, or energies beyond the range of doubles.

    Notes
    -----
    The supplied energy is the work of the input along the motion between samples, in closed form: `integral y^T u dt`
    of the exact solution for 'exact', and `h u_mid^T y_mid` a step for 'midpoint', whose balance is exact as well
    (discrete Lagrange-d'Alembert principle).  For 'euler' it is `h u_k^T y_k`, and the defect is what Euler's rule
    makes from nothing.  O(T n^2).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> t = np.linspace(0.0, 1.0, 11)
    >>> euler = phc.forced_response(sys, t, 0.0, [1.0, 0.0], method="euler")
    >>> phc.energy_balance(euler, sys).defect[1].round(3)
    np.float64(0.08)
    """
    if not isinstance(sys, PortHamiltonian):
        raise StructureError(f"this is a {type(sys).__name__}; the energy is that of a PortHamiltonian: use ph(sys)")
    if not isinstance(response, ct.TimeResponseData):
        raise StructureError(f"this is a {type(response).__name__}; pass the response that forced_response gives")
    rule = getattr(response, "rule", None) or Hold(0.0, "exact", "foh")
    method = rule.method if method is None else _checks.choice("method", method, METHODS)
    intersample = rule.intersample if intersample is None else _checks.choice("intersample", intersample, INTERSAMPLE)
    t, h = _checks.time_vector(response.time)
    z = _trace(response.x, "states", sys.nstates, len(t))
    u = _trace(response.u, "inputs", sys.ninputs, len(t))
    stored = np.asarray(sys.hamiltonian(z))
    with np.errstate(over="ignore", invalid="ignore"):
        supplied = np.concatenate([[0.0], np.cumsum(_work(sys, z, u, h, method, intersample))])
        defect = stored - stored[0] - supplied
    _checks.representable("the energies supplied", supplied, defect)
    return EnergyBalance(t.copy(), stored, supplied, defect, common_unit(response))


def _trace(value: Any, what: str, rows: int, samples: int) -> Array:
    if value is None or np.size(value) == 0:
        raise StructureError(f"the response has no {what}; compute it with forced_response and return_states=True")
    array = _checks.real_array(f"the list of {what} of the response", value)
    if array.ndim == 3 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 2 or array.shape[0] != rows:
        raise StructureError(f"the {what} of the response have shape {array.shape}; needed one trace of {rows} rows")
    if array.shape[1] != samples:
        raise StructureError(f"the response has {array.shape[1]} samples of {what} at {samples} instants")
    return array


def _work(sys: PortHamiltonian, z: Array, u: Array, h: float, method: str, intersample: str) -> Array:
    """Work of the input in each step."""
    now, then = u[:, :-1], u[:, 1:]
    if method == "euler":
        return h * np.sum(now * (sys.C @ z[:, :-1]), axis=0)
    if method == "midpoint":
        middle = now if intersample == "zoh" else 0.5 * (now + then)
        return h * np.sum(middle * (sys.C @ (0.5 * (z[:, :-1] + z[:, 1:]))), axis=0)
    # y = B^T Q z = B^T J^T (z' - B u), and u^T B^T J B u vanishes: the work is the area swept by B u and z
    pushed = sys.B @ u
    if intersample == "zoh":
        return _area(np.diff(z, axis=1), pushed[:, :-1])
    swept = np.diff(_area(z, pushed))
    return swept - _area(_time_integrals(sys, z, u, h), np.diff(pushed, axis=1) / h)


def _area(z: Array, w: Array) -> Array:
    """`z^T J w` of each column."""
    area: Array = np.sum(z * apply_form(w), axis=0)
    return area


def _time_integrals(sys: PortHamiltonian, z: Array, u: Array, h: float) -> Array:
    """Integral of the state over each step under an interpolated input."""
    n, m = sys.nstates, sys.ninputs
    M = np.zeros((2 * n + 2 * m, 2 * n + 2 * m))
    M[:n, :n], M[:n, n : n + m], M[n : n + m, n + m : n + 2 * m] = h * sys.A, h * sys.B, np.eye(m)
    M[n + 2 * m :, :n] = h * np.eye(n)
    row = expm(M)[n + 2 * m :]
    return row[:, :n] @ z[:, :-1] + row[:, n : n + m] @ u[:, :-1] + row[:, n + m : n + 2 * m] @ np.diff(u, axis=1)

"""The energy along a response: what is stored against what was supplied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np

from .. import _checks
from .._display import Report
from .._options import DISCRETISATIONS, INTERPOLATIONS, Discretisation, Interpolation
from .._types import Array, ArrayLike
from .._units import common_unit
from ..exceptions import StructureError
from ..modal.discretization import Hold
from ..numerics.exponential import integral_of_form, with_inputs
from ..systems.dissipative import DissipativePortHamiltonian
from ..systems.port_hamiltonian import PortHamiltonian

_ROUNDING = 1e3  # roundings for each state and sample: what transformations to modes and sums over samples cost


@dataclass(frozen=True, eq=False, repr=False)
class EnergyBalance(Report):
    """Stored, supplied and dissipated energy along a response.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Instants.
    stored : ndarray, shape (T,)
        Energy `z^T Q z / 2` at each.
    supplied : ndarray, shape (T,)
        Energy that went in through the ports since the first instant.
    defect : ndarray, shape (T,)
        What was stored and dissipated since the first instant less what was supplied: 0 of an exact computation.
    dissipated : ndarray, shape (T,)
        Energy lost since the first instant; 0 of a lossless system.
    time_unit : str or None
        Unit of time of the response or the system; None where it is not known.

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
    dissipated: Array
    time_unit: str | None = None

    def __str__(self) -> str:
        """Say over what time, how much was stored, supplied and dissipated, and what is left of the balance."""
        stored, supplied, defect = (
            float(np.max(np.abs(e), initial=0.0)) for e in (self.stored, self.supplied, self.defect)
        )
        lost = f"{self.dissipated[-1]:.4g} dissipated, " if self.dissipated.any() else ""
        return (
            f"{len(self.time)} instants from {self.time[0]:.6g} to {self.time[-1]:.6g}, at most {stored:.4g} stored, "
            f"{supplied:.4g} supplied, {lost}{defect:.2g} between them"
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
    response: ct.TimeResponseData,
    sys: PortHamiltonian,
    *,
    method: Discretisation | None = None,
    intersample: Interpolation | None = None,
) -> EnergyBalance:
    """Energy stored by a system and supplied to it along a response.

    Parameters
    ----------
    response : control.TimeResponseData
        Response with states, of one trace: what `forced_response` and `initial_response` of this package give, or
        `step_response(sys, t, input=k)`.  Without inputs it is a free motion; inputs that it does not name are 0.
    sys : PortHamiltonian
        The system that responded.
    method, intersample : str, optional
        How the response was computed, and what the input did between the samples.  By default as a response of this
        package says; 'exact' and 'foh' for any other, which is what `control.forced_response` computes.

    Returns
    -------
    EnergyBalance
        Stored, supplied and dissipated energy, and what is left of their balance.

    Raises
    ------
    StructureError
        If the response is not a `TimeResponseData`, has no states, several traces, sizes that do not fit the system or
        one another, numbers that are not real and finite, or energies beyond the range of doubles.  If the balance is
        not kept to rounding, apart from Euler's rule: the response is not one of the system, not by the rule given, or
        was computed with few digits.

    Notes
    -----
    The flows are integrals of quadratic forms of state and input over the motion between samples, in closed form:
    `integral y^T u dt` of the exact solution for 'exact', and `h u_mid^T y_mid` a step for 'midpoint', whose balance is
    exact as well (discrete Lagrange-d'Alembert principle).  For 'euler' it is `h u_k^T y_k`, and the defect is what
    Euler's rule makes from nothing.  O(T n^2).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> t = np.linspace(0.0, 1.0, 11)
    >>> euler = phc.forced_response(sys, t, 0.0, [1.0, 0.0], method="euler")
    >>> phc.energy_balance(euler, sys).defect[1].round(3).item()
    0.08
    """
    if not isinstance(sys, PortHamiltonian):
        raise StructureError(f"this is a {type(sys).__name__}; the energy is that of a PortHamiltonian: use ph(sys)")
    if not isinstance(response, ct.TimeResponseData):
        raise StructureError(f"this is a {type(response).__name__}; pass the response that forced_response gives")
    rule = getattr(response, "rule", None) or Hold(0.0, "exact", "foh")
    method = rule.method if method is None else _checks.choice("method", method, DISCRETISATIONS)
    intersample = (
        rule.intersample if intersample is None else _checks.choice("intersample", intersample, INTERPOLATIONS)
    )
    t, h = _checks.time_vector(response.time)
    z = _trace(response.x, "states", sys.nstates, len(t))
    u = _inputs(response, sys, len(t))
    stored = np.asarray(sys.hamiltonian(z))
    with np.errstate(over="ignore", invalid="ignore"):
        steps = _flows(sys, z, u, h, method, intersample)
        supplied, dissipated = (np.concatenate([[0.0], np.cumsum(step)]) for step in steps)
        defect = stored - stored[0] + dissipated - supplied
    _checks.representable("the energies supplied", supplied, dissipated, defect)
    if method != "euler":
        # what rounding of the states makes of the stored energy, and sums of the flows
        extent = np.abs(z).max(axis=1)
        size = 0.5 * float(extent @ np.abs(sys.Q) @ extent) + sum(float(np.abs(step).sum()) for step in steps)
        _refuse_imbalance(defect, size, _ROUNDING * _checks.EPS * (len(z) + len(t)), f"{method!r} and {intersample!r}")
    return EnergyBalance(t.copy(), stored, supplied, defect, dissipated, common_unit(response, sys))


def _refuse_imbalance(defect: Array, size: float, share: float, rule: str) -> None:
    """Refuse what is no motion of the system: rounding explains such a share of the energies, and no more."""
    worst = float(np.abs(defect).max())
    if worst > share * size:
        raise StructureError(
            f"stored, dissipated and supplied energy differ by {worst:.3g}, and rounding of energies of {size:.3g} "
            f"explains {share * size:.2g}: these are not states of the system that respond to these inputs by the rule "
            f"{rule}; pass the method and intersample of the response, or compute it with forced_response"
        )


def _flows(sys: PortHamiltonian, z: Array, u: Array, h: float, method: str, intersample: str) -> list[Array]:
    """Energy that is supplied and dissipated in each step: integrals of quadratic forms of state and input."""
    n, m = sys.B.shape
    C, D = sys.C[:m], sys.D[:m]
    forms = [np.block([[np.zeros((n, n)), 0.5 * C.T], [0.5 * C, 0.5 * (D + D.T)]])]
    if isinstance(sys, DissipativePortHamiltonian):
        to_efforts = np.block([[sys.Q, np.zeros((n, m))], [np.zeros((m, n)), np.eye(m)]])
        forms.append(to_efforts.T @ np.block([[sys.R, sys.P], [sys.P.T, sys.S]]) @ to_efforts)
    now, then = u[:, :-1], u[:, 1:]
    if method == "exact":
        rise = then - now if intersample == "foh" else 0.0 * now
        points = np.concatenate([z[:, :-1], now, rise])
        M, units = with_inputs(sys.A, sys.B, h)
        padded = [np.pad(form, (0, m)) * units * units[:, None] for form in forms]
        forms = [h * integral_of_form(M, form) / units / units[:, None] for form in padded]
    else:
        held = now if intersample == "zoh" or method == "euler" else 0.5 * (now + then)
        points = np.concatenate([z[:, :-1] if method == "euler" else 0.5 * (z[:, :-1] + z[:, 1:]), held])
        forms = [h * form for form in forms]
    flows = [np.sum(points * (form @ points), axis=0) for form in forms]
    return flows if len(flows) > 1 else [*flows, 0.0 * flows[0]]


def _inputs(response: ct.TimeResponseData, sys: PortHamiltonian, samples: int) -> Array:
    """Inputs of all ports: 0 in a free motion, and where the response names some of them only, as to one step."""
    u = np.zeros((sys.ninputs, samples))
    if response.u is None:
        return u
    names, known = list(response.input_labels or []), list(sys.input_labels)
    if 0 < len(set(names)) == len(names) < len(known) and set(names) <= set(known):
        u[[known.index(name) for name in names]] = _trace(response.u, "inputs", len(names), samples)
        return u
    return _trace(response.u, "inputs", sys.ninputs, samples)


def _trace(value: ArrayLike, what: str, rows: int, samples: int) -> Array:
    if value is None or np.size(value) == 0:
        raise StructureError(f"the response has no {what}; compute it with forced_response and return_states=True")
    array = _checks.real_array(f"the list of {what} of the response", value)
    if array.ndim == 3 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 2 or array.shape[0] != rows:
        raise StructureError(
            f"the {what} of the response have shape {array.shape}; expected one trace of {rows} rows: of a system with "
            "several ports, forced_response with all inputs gives it"
        )
    if array.shape[1] != samples:
        raise StructureError(f"the response has {array.shape[1]} samples of {what} at {samples} instants")
    return array

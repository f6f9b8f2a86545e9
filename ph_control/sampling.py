"""Sampled systems: one step of an integrator as a discrete-time state space, and the energy on the way."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from . import _checks
from ._instants import listed
from .discrete import check_method
from .exceptions import ResolutionWarning, StructureError
from .lossless_system import LosslessSystem, inherited_names
from .motion import Rule, check_finite, trajectory
from .propagation import INTERSAMPLE, METHODS
from .symplectic import apply_form
from .systems import PortHamiltonian

Array = NDArray[np.float64]


def sample(sys: Any, h: float, method: str = "exact", *, intersample: str = "zoh", **names: Any) -> ct.StateSpace:
    """Sample a lossless system: one step of an integrator as a discrete-time state space.

    Parameters
    ----------
    sys : PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian or AffineHamiltonian
        System to sample.
    h : float
        Sampling step, in the unit of time of the system.
    method : {'exact', 'midpoint', 'euler'}
        Exact solution, implicit midpoint rule (by the discrete Lagrange-d'Alembert principle, the input acting at the
        middle of the step), or explicit Euler.
    intersample : {'zoh', 'foh'}
        Input between samples: held, or interpolated linearly.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; those of the system are kept.

    Returns
    -------
    control.StateSpace
        `s_{k+1} = F s_k + G u_k`, `y_k = C s_k + D u_k` with `dt = h`, in the coordinates of the system.  With 'foh'
        the state is `z_k - G_1 u_k`, where `G_1` is what a step makes of the input at its end.

    Raises
    ------
    StructureError
        If the system is not one of these, or `h` is not positive.

    Warns
    -----
    ResolutionWarning
        If `method` is 'exact' and modes turn by half a period or more in a step: beyond the frequency of Nyquist they
        cannot be told from slower ones, and after whole half periods the input may not reach them.

    See Also
    --------
    ph : with `method`, the way back.
    forced_response : the same steps, without matrices.

    Notes
    -----
    `F` is symplectic for 'exact' and 'midpoint', and conserves the energy; for 'euler' it does neither.  With
    'midpoint' and 'foh' the transfer function is that of the bilinear (Tustin) transformation.  O(n^3).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> oscillator = phc.ph(np.eye(2), [0.0, 1.0])
    >>> phc.sample(oscillator, np.pi / 2).A.round(12) + 0.0
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    if not isinstance(sys, LosslessSystem):
        raise StructureError(
            f"this is a {type(sys).__name__}, not a lossless system of this package; convert it with ph(sys), or use "
            "control.sample_system"
        )
    rule = Rule(
        _checks.sampling_step(h, name="h"),
        check_method(method),
        _checks.choice("intersample", intersample, INTERSAMPLE),
    )
    if rule.method == "exact":
        _warn_of_aliases(sys.modes.d, rule.h)
    size, ports = sys.nstates, sys.ninputs
    rest = np.zeros(size)
    with np.errstate(over="ignore", invalid="ignore"):
        F = np.array([_one_step(sys, np.zeros((ports, 2)), z, rule) for z in np.eye(size)]).T
        now, then = (
            np.array([_one_step(sys, _pulse(ports, port, k), rest, rule) for port in range(ports)]).T for k in (0, 1)
        )
    F, now, then = F.reshape(size, size), now.reshape(size, ports), then.reshape(size, ports)
    check_finite(F, now, 1.0, rule)
    kept = inherited_names(sys, names, "inputs", "outputs", "states")
    return ct.ss(F, now + F @ then, sys.C, sys.C @ then, rule.h, **kept)


def _warn_of_aliases(d: Array, h: float) -> None:
    beyond = d[d * h >= np.pi * (1 - 4 * _checks.EPS)]
    if len(beyond):
        warnings.warn(
            f"the step {h:.4g} is half a period or more of {listed(beyond)}: sampled, they cannot be told from slower "
            f"ones, or are not reached; take a step below {np.pi / d.max():.4g}",
            ResolutionWarning,
            stacklevel=3,
        )


def _pulse(ports: int, port: int, k: int) -> Array:
    u = np.zeros((ports, 2))
    u[port, k] = 1.0
    return u


def _one_step(sys: LosslessSystem, u: Array, z: Array, rule: Rule) -> Array:
    _, states = trajectory(sys, u, z, rule, states=True)
    assert states is not None
    return states[:, 1]


@dataclass(frozen=True, eq=False)
class EnergyBalance:
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


def energy_balance(
    response: ct.TimeResponseData, sys: PortHamiltonian, *, method: str = "exact", intersample: str = "zoh"
) -> EnergyBalance:
    """Energy stored by a system and supplied to it along a response.

    Parameters
    ----------
    response : control.TimeResponseData
        Response with inputs and states, of one trace: what `forced_response` of this package gives.
    sys : PortHamiltonian
        The system that responded.
    method, intersample
        How the response was computed; they say what the input did between the samples.

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
    >>> phc.energy_balance(euler, sys, method="euler").defect[1].round(3)
    np.float64(0.08)
    """
    if not isinstance(sys, PortHamiltonian):
        raise StructureError(f"this is a {type(sys).__name__}; the energy is that of a PortHamiltonian: use ph(sys)")
    if not isinstance(response, ct.TimeResponseData):
        raise StructureError(f"this is a {type(response).__name__}; pass the response that forced_response gives")
    _checks.choice("method", method, METHODS)
    _checks.choice("intersample", intersample, INTERSAMPLE)
    t, _ = _checks.time_vector(response.time)
    z = _trace(response.x, "states", sys.nstates, len(t))
    u = _trace(response.u, "inputs", sys.ninputs, len(t))
    stored = np.asarray(sys.hamiltonian(z))
    h = float((t[-1] - t[0]) / (len(t) - 1)) if len(t) > 1 else 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        supplied = np.concatenate([[0.0], np.cumsum(_work(sys, z, u, h, method, intersample))])
        defect = stored - stored[0] - supplied
    _checks.representable("the energies supplied", supplied, defect)
    return EnergyBalance(t.copy(), stored, supplied, defect)


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

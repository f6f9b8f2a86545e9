"""Sampled systems: one step of an integrator as a discrete-time state space."""

from __future__ import annotations

import warnings

import control as ct
import numpy as np

from .. import _checks
from .._options import INTERPOLATIONS, Discretisation, Interpolation
from .._types import Array, SystemNames, Unpack
from .._units import common_unit, with_unit
from ..exceptions import ResolutionWarning
from ..modal.discretization import Hold, check_method
from ..systems.base import Convertible, LosslessSystem, inherited_names
from ..systems.canonical_forms import ControllableHamiltonian, ObservableHamiltonian, warn_of_lost_digits
from ..systems.dissipative import DissipativePortHamiltonian
from .other_systems import as_system, sampled
from .time_grid import listed, swing
from .trajectories import check_finite, companion_step, modes_cancel, trajectory


def sample(
    sys: Convertible, h: float, method: Discretisation = "exact", *, intersample: Interpolation = "zoh",
    **names: Unpack[SystemNames],
) -> ct.StateSpace:  # fmt: skip
    """Sample a system: one step of an integrator as a discrete-time state space.

    Parameters
    ----------
    sys : PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian, AffineHamiltonian; or any linear system
        System to sample.  Those of python-control in continuous time are sampled by the formulas of scipy.
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
        `s_{k+1} = F s_k + G u_k`, `y_k = C s_k + D u_k` with `dt = h`, in the coordinates of the system, and with its
        `time_unit`.  With 'foh' the state is `z_k - G_1 u_k`, where `G_1` is what a step makes of the input at its end.

    Raises
    ------
    StructureError
        If the system is not one of these, `h` is not positive, or `method` is not for it.

    Warns
    -----
    ResolutionWarning
        If `method` is 'exact' and modes turn by half a period or more in a step: beyond the frequency of Nyquist they
        cannot be told from slower ones, and after whole half periods the input may not reach them.
    ConditioningWarning
        If the rounding of the matrix of a canonical form to doubles leaves fewer than six digits of the frequencies.

    See Also
    --------
    ph : with `method`, the way back.
    forced_response : the same steps, without matrices.

    Notes
    -----
    `F` is symplectic for 'exact' and 'midpoint', and conserves the energy; for 'euler' it does neither.  With
    'midpoint' and 'foh' the transfer function is that of the bilinear (Tustin) transformation.  Every entry of
    that of a canonical form is right to the last place.  O(n^3).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> oscillator = phc.ph(np.eye(2), [0.0, 1.0])
    >>> phc.sample(oscillator, np.pi / 2).A.round(12) + 0.0
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    unit, sys = common_unit(sys), as_system(sys)
    rule = Hold(
        _checks.sampling_step(h, name="h"),
        check_method(method),
        _checks.choice("intersample", intersample, INTERPOLATIONS),
    )
    if not isinstance(sys, LosslessSystem):
        return with_unit(sampled(sys, rule.h, method, intersample, names), unit)
    if rule.method == "exact":
        _warn_of_aliases(np.sort(swing(sys.modes.mode_poles)), rule.h)
    _checks.signal_names(names, inputs=sys.ninputs, outputs=sys.noutputs, states=sys.nstates)
    matrices = _companion if isinstance(sys, ControllableHamiltonian | ObservableHamiltonian) else _matrices
    with np.errstate(over="ignore", invalid="ignore"):
        F, G, D = matrices(sys, rule)
    check_finite(F, G, 1.0, rule)
    made = ct.ss(F, G, sys.C, D, rule.h, **inherited_names(sys, names, "inputs", "outputs", "states"))
    return with_unit(made, unit)


def _companion(sys: LosslessSystem, rule: Hold) -> tuple[Array, Array, Array]:
    """`F`, `G` and `D` of a canonical form, each entry right to the last place."""
    step = companion_step(sys, rule)
    warn_of_lost_digits(sys.n, step.digits(), "sampled matrix", stacklevel=4)
    ahead, _ = trajectory(sys, np.array([[0.0, 1.0]]), np.zeros(sys.nstates), rule, states=False)
    return step.matrices()[0], step.shifted()[:, None], ahead[:, 1:]


def _matrices(sys: LosslessSystem, rule: Hold) -> tuple[Array, Array, Array]:
    """`F`, `G` and `D` of any other system."""
    if isinstance(sys, DissipativePortHamiltonian) and modes_cancel(sys, rule, 1):
        F, _, held, risen = rule.step_of_matrices(sys.A, sys.B)
        return F, held + (F @ risen - risen), sys.C @ risen + sys.D
    size, ports = sys.nstates, sys.ninputs
    F = np.array([_one_step(sys, np.zeros((ports, 2)), z, rule) for z in np.eye(size)]).T.reshape(size, size)
    pulses = np.einsum("ij,kl->kijl", np.eye(ports), np.eye(2))  # by instant and port
    now, then = (np.array([_one_step(sys, u, np.zeros(size), rule) for u in part]).T for part in pulses)
    return F, now + F @ then, sys.C @ then + sys.D


def _warn_of_aliases(d: Array, h: float) -> None:
    """Warn of the frequencies of free motions that samples are too far apart for."""
    beyond = d[d * h >= np.pi * (1 - 4 * _checks.EPS)]
    if len(beyond):
        warnings.warn(
            f"the step {h:.4g} is half a period or more of {listed(beyond)}: sampled, they cannot be told from slower "
            f"ones, or are not reached; take a step below {np.pi / d.max():.4g}",
            ResolutionWarning,
            stacklevel=3,
        )


def _one_step(sys: LosslessSystem, u: Array, z: Array, rule: Hold) -> Array:
    _, states = trajectory(sys, u, z, rule, states=True)
    assert states is not None
    return states[:, 1]

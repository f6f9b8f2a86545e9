"""Trajectories: from an input and an initial state in the coordinates of a system to its outputs and states.

Outputs run on modal coordinates for every class.  Port-Hamiltonian states are brought back from there; those of a
canonical form too, as long as doubles have the digits for it.  Where frequencies are many or close, its companion
matrix is near to one with Jordan blocks, or has them, and is stepped in decimal numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from .. import _checks
from .._types import Array, ComplexArray
from ..exceptions import StructureError
from ..modal.discretization import Hold
from ..modal.modal_form import imaginary
from ..modal.propagation import discretize, simulate, step_through
from ..numerics.polynomials import companion_maps
from ..symplectic.forms_and_williamson import apply_form, symplectic_inverse
from ..systems.affine import AffineHamiltonian
from ..systems.base import LosslessSystem
from ..systems.canonical_forms import ControllableHamiltonian, ObservableHamiltonian, warn_of_lost_digits
from ..systems.dissipative import DissipativePortHamiltonian
from ..systems.port_hamiltonian import PortHamiltonian
from .companion_step import CompanionStep

_DENSE = 64  # states of systems that are stepped by their matrices
_WORK = 1e8  # multiplications that this may take
_SETTLED = 3.0  # logarithm of what a step leaves of a mode that is at rest after a few
_DIGITS = 10.0  # of the largest value of a state that modes must leave, so that they give those of a canonical form


def trajectory(sys: LosslessSystem, u: Array, z0: Array, rule: Hold, *, states: bool) -> tuple[Array, Array | None]:
    """Outputs (m, T) and, on request, states (2n, T) of a system for input samples (m, T) and an initial state."""
    if isinstance(sys, DissipativePortHamiltonian):
        return _dissipative(sys, u, z0, rule, states)
    if isinstance(sys, PortHamiltonian):
        return _port_hamiltonian(sys, u, z0, rule, states)
    if isinstance(sys, AffineHamiltonian):
        # the same states as those of the derivative, another output
        _, z = _port_hamiltonian(sys.derivative(), u, z0, rule, True)
        assert z is not None
        return sys.C @ z, z if states else None
    assert isinstance(sys, ControllableHamiltonian | ObservableHamiltonian)
    return _canonical(sys, u, z0, rule, states)


# --- with losses -------------------------------------------------------------------------------------------------


def _dissipative(
    sys: DissipativePortHamiltonian, u: Array, z0: Array, rule: Hold, states: bool
) -> tuple[Array, Array | None]:
    """Outputs and states by the modes, or by the matrices where modes cancel; poles not parted by those of their block.

    In both the matrices are exact for states as they are given, of which a first and a second difference is a response.
    """
    if modes_cancel(sys, rule, u.shape[1]):
        z = step_through(rule.step_of_matrices(sys.A, sys.B), u, z0)
        return sys.C @ z + sys.D @ u, z if states else None
    form, m, p = sys._split, sys.ninputs, sys.noutputs
    rows = slice(None) if states else slice(p)
    poles, b, c = form.equations
    y = simulate(rule.step(poles, b[:, :m], c[rows]), u, b[:, m:] @ z0)[0]
    for block in form.clusters:
        step = rule.step_of_matrices(block.A, block.B[:, :m])
        y += block.C[rows] @ step_through(step, u, block.B[:, m:] @ z0)
    if not states:
        return y + sys.D @ u, None
    z = y[p:].copy()
    z[:, 0] = z0
    return sys.C @ z + sys.D @ u, z


def modes_cancel(sys: DissipativePortHamiltonian, rule: Hold, samples: int) -> bool:
    """Whether the response is much smaller than the motions of the modes that add up to it.

    It is where some mode hardly moves while the record lasts, or hardly anything is left of one after a step: a mode
    has a part in each state, and together they make a state of rest or of balance.  Coincident poles are alike.
    """
    size = sys.nstates
    if rule.method != "exact" or size > _DENSE or size * size * samples > _WORK:
        return False
    z = rule.h * sys.modes.poles
    still = (z != 0) & (np.abs(z) * samples < 1.0)
    return bool(still.any() or (z.real < -_SETTLED).any() or sys.modes.clusters)


# --- port-Hamiltonian --------------------------------------------------------------------------------------------


def _port_hamiltonian(
    sys: PortHamiltonian, u: Array, z0: Array, rule: Hold, states: bool
) -> tuple[Array, Array | None]:
    d, E, E0 = sys._energy
    x0 = np.zeros(len(d) + len(E0), complex)
    if z0.any():
        x0 = np.concatenate([(E @ z0) / np.sqrt(d), E0 @ z0])
    modes = sys.modes
    y, x = simulate(discretize(modes, rule), u, x0, states=states)
    return y, None if x is None else _phase_space_states(sys, x[: len(d)], x0[: len(d)], z0, u, rule)


def _phase_space_states(
    sys: PortHamiltonian, x: ComplexArray, x0: ComplexArray, z0: Array, u: Array, rule: Hold
) -> Array:
    """Phase-space trajectory (2n, T) from that of the oscillating modes; rigid-body motion is integrated."""
    d, E, E0 = sys._energy
    root = np.sqrt(d)[:, None]
    if 2 * len(d) == sys.nstates:
        rows = E / root
        z: Array = symplectic_inverse(np.concatenate([rows.real, rows.imag])) @ np.concatenate([x.real, x.imag])
        z[:, 0] = z0  # S^-1 S z0 rounds with the condition of S
        return z
    U, W = _input_integrals(u, rule)
    X = ((E @ sys.B) @ U - root * (x - x0[:, None])) / (1j * d[:, None])
    X0 = np.outer(E0 @ z0, rule.h * np.arange(u.shape[1])) + (E0 @ sys.B) @ W
    return z0[:, None] + apply_form((E.conj().T @ X).real + E0.T @ X0) + sys.B @ U


def _input_integrals(u: Array, rule: Hold) -> tuple[Array, Array]:
    """First and second integral of the input over time, by the rule of the method; shape (m, T) each."""
    h = rule.h
    now, then = u[:, :-1], u[:, 1:]
    mean = now if rule.intersample == "zoh" else 0.5 * (now + then)
    zero = np.zeros((len(u), 1))
    U = np.concatenate([zero, h * np.cumsum(mean, axis=1)], axis=1)
    if rule.method == "euler":
        gain = h * U[:, :-1]
    elif rule.method == "midpoint":
        gain = 0.5 * h * (U[:, :-1] + U[:, 1:])
    elif rule.intersample == "zoh":
        gain = h * U[:, :-1] + 0.5 * h * h * now
    else:
        gain = h * U[:, :-1] + h * h * (now / 3 + then / 6)
    return U, np.concatenate([zero, np.cumsum(gain, axis=1)], axis=1)


# --- canonical forms ---------------------------------------------------------------------------------------------


def _poles(sys: LosslessSystem) -> tuple[Array, Array]:
    """`d` and residue `kappa` of each mode of a canonical form, poles `-i d`, those at 0 first."""
    modes = sys.modes
    d, at_zero = np.concatenate([np.zeros(len(modes.rigid)), modes.d]), modes.rigid[:, 0] ** 2
    return d, np.concatenate([at_zero, modes.kappa])


def companion_step(sys: Any, rule: Hold) -> CompanionStep:
    """One step of a canonical form in its own coordinates."""
    d, kappa = _poles(sys)
    return CompanionStep(
        d, kappa, rule.h, rule.method, rule.intersample, transposed=isinstance(sys, ObservableHamiltonian)
    )


def _canonical(
    sys: ControllableHamiltonian | ObservableHamiltonian, u: Array, s0: Array, rule: Hold, states: bool
) -> tuple[Array, Array | None]:
    """In modal coordinates, and from there back to those of the form, where the frequencies are apart.

    They are `w' = -i d w + u`, `y = sum kappa Re w` of the controllable form, defined for repeated frequencies too, and
    `w' = -i d w + kappa u`, `y = sum Re w` of the observable one.
    """
    d, kappa = _poles(sys)
    observable, residues = isinstance(sys, ObservableHamiltonian), kappa.astype(complex)
    W, L = companion_maps(d)
    into, back = (L, W) if observable else (W, L)
    # after an impulse every mode starts from its residue, which need not be taken out of the state
    struck = observable and bool(s0.any()) and np.array_equal(s0, sys.B[:, 0])
    start = residues if struck else into @ s0 if s0.any() else 0 * residues
    error = np.abs(into) @ np.abs(s0) if s0.any() and not struck else np.abs(start)
    weights = (residues[:, None], None) if observable else (None, residues[None, :])
    y, w = simulate(rule.step(imaginary(-d), *weights), u, start, states=states)
    exact = cache(lambda: companion_step(sys, rule).states(u[0], None if struck else s0))
    if observable and s0.any() and not struck:
        y = _with_digits(sys, y, error.sum()[None], lambda: exact()[-1:])
    if w is None:
        return y, None
    return y, _with_digits(sys, (back.T @ w).real, np.abs(back).T @ (error + np.abs(w).max(axis=1)), exact)


def _with_digits(sys: Any, rows: Array, error: Array, exact: Callable[[], Array]) -> Array:
    """Rows computed in modal coordinates, with an error of so many roundings, if they have digits, else exact ones.

    Where these would take too long, a warning says how many digits there are; without any the error is raised.
    """
    size = np.abs(rows).max(axis=1)
    with np.errstate(all="ignore"):
        worst = np.nan_to_num(np.where(size == 0, 0.0, error / size), nan=np.inf).max()
        digits = -float(np.log10(_checks.EPS * worst))
    if digits >= _DIGITS:
        return rows
    try:
        return exact()
    except StructureError:
        if digits <= 0:
            raise
    warn_of_lost_digits(sys.n, digits, "modal form, in which so many samples of states are computed,", stacklevel=2)
    return rows


def check_finite(y: Array, z: Array | None, growth: float, rule: Hold) -> None:
    """Refuse a response that left the range of doubles."""
    if np.isfinite(y).all() and (z is None or np.isfinite(z).all()):
        return
    cure = "use method='exact' or a smaller step" if growth > 1 else "scale the input, the state or time"
    raise StructureError(
        f"the response exceeds the range of doubles: with method={rule.method!r} and step {rule.h:.4g} the fastest "
        f"mode grows by {growth:.4g} a step; {cure}"
    )

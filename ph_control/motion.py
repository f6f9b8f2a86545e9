"""Trajectories: from an input and an initial state in the coordinates of a system to its outputs and states.

Outputs run on modal coordinates for every class.  Port-Hamiltonian states are brought back from there; those of a
canonical form too, as long as the frequencies are apart.  Where they are not, its companion matrix is close to or has
Jordan blocks, and a chain of resonators, each driven by the one before, takes the place of the modes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_triangular

from .affine_system import AffineHamiltonian
from .canonical_forms import ControllableHamiltonian, ObservableHamiltonian
from .coefficients import cofactors
from .exceptions import StructureError
from .lossless_system import LosslessSystem
from .propagation import Step, discretize, simulate
from .symplectic import apply_form, symplectic_inverse
from .systems import PortHamiltonian

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_DIGITS = 10.0  # that separate modes must carry, so that a state of a canonical form is taken apart into them


class Rule(NamedTuple):
    """How to step through time: step, method and what the input does between samples."""

    h: float
    method: str
    intersample: str


def trajectory(sys: LosslessSystem, u: Array, z0: Array, rule: Rule, *, states: bool) -> tuple[Array, Array | None]:
    """Outputs (m, T) and, on request, states (2n, T) of a system for input samples (m, T) and an initial state."""
    if isinstance(sys, PortHamiltonian):
        return _port_hamiltonian(sys, u, z0, rule, states)
    if isinstance(sys, AffineHamiltonian):
        # the same states as those of the derivative, another output
        _, z = _port_hamiltonian(sys.derivative(), u, z0, rule, True)
        assert z is not None
        return sys.C @ z, z if states else None
    if isinstance(sys, ControllableHamiltonian):
        return _controllable(sys, u, z0, rule, states)
    assert isinstance(sys, ObservableHamiltonian)
    return _observable(sys, u, z0, rule, states)


# --- port-Hamiltonian --------------------------------------------------------------------------------------------


def _port_hamiltonian(
    sys: PortHamiltonian, u: Array, z0: Array, rule: Rule, states: bool
) -> tuple[Array, Array | None]:
    d, E, E0 = sys._energy
    x0 = np.zeros(len(d) + len(E0), complex)
    if z0.any():
        x0 = np.concatenate([(E @ z0) / np.sqrt(d), E0 @ z0])
    modes = sys.modes
    y, x = simulate(discretize(modes, *rule), u, x0, states=states)
    return y, None if x is None else _phase_space_states(sys, x[: len(d)], x0[: len(d)], z0, u, rule)


def _phase_space_states(
    sys: PortHamiltonian, x: ComplexArray, x0: ComplexArray, z0: Array, u: Array, rule: Rule
) -> Array:
    """Phase-space trajectory (2n, T) from that of the oscillating modes; rigid-body motion is integrated."""
    d, E, E0 = sys._energy
    root = np.sqrt(d)[:, None]
    if 2 * len(d) == sys.nstates:
        rows = E / root
        return symplectic_inverse(np.concatenate([rows.real, rows.imag])) @ np.concatenate([x.real, x.imag])
    U, W = _input_integrals(u, rule)
    X = ((E @ sys.B) @ U - root * (x - x0[:, None])) / (1j * d[:, None])
    X0 = np.outer(E0 @ z0, rule.h * np.arange(u.shape[1])) + (E0 @ sys.B) @ W
    return z0[:, None] + apply_form((E.conj().T @ X).real + E0.T @ X0) + sys.B @ U


def _input_integrals(u: Array, rule: Rule) -> tuple[Array, Array]:
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


class _Poles(NamedTuple):
    """Pole `-i d` and residue of each mode of a canonical form, those at 0 first."""

    d: Array
    kappa: Array


def _poles(sys: Any) -> _Poles:
    modes = sys.modes
    return _Poles(
        np.concatenate([np.zeros(len(modes.rigid)), modes.d]),
        np.concatenate([modes.rigid[:, 0] ** 2, modes.kappa]),
    )


def _controllable(
    sys: ControllableHamiltonian, u: Array, s0: Array, rule: Rule, states: bool
) -> tuple[Array, Array | None]:
    """In modal coordinates `w' = -i d w + u`, `y = sum kappa Re w`: defined for every `d`, repeated ones included."""
    d, kappa = _poles(sys)
    apart = _apart(sys)
    step = Step.of(d, np.ones((sys.n, 1), complex), kappa[None, :].astype(complex), *rule)
    y, w = simulate(step, u, _cofactor_map(d) @ s0, states=states and apart)
    if not states:
        return y, None
    return y, _lagrange_states(d, w) if w is not None else _Chain(sys).controllable(u, s0, rule)


def _observable(
    sys: ObservableHamiltonian, u: Array, s0: Array, rule: Rule, states: bool
) -> tuple[Array, Array | None]:
    """In modal coordinates `w' = -i d w + kappa u`, `y = sum Re w`, where the frequencies are apart."""
    d, kappa = _poles(sys)
    apart = _apart(sys)
    # after an impulse every mode starts from its residue, which need not be taken out of the state
    struck = bool(s0.any()) and np.array_equal(s0, sys.B[:, 0])
    if struck:
        start = kappa.astype(complex)
    else:
        start = _lagrange_map(d) @ s0 if apart else np.zeros(sys.n, complex)
    step = Step.of(d, kappa[:, None].astype(complex), np.ones((1, sys.n), complex), *rule)
    y, w = simulate(step, u, start, states=states and apart)
    if apart:
        return y, (_cofactor_map(d).T @ w).real if w is not None else None
    chain = _Chain(sys)
    if s0.any() and not struck:
        y = y + chain.observable(np.zeros_like(u), s0, rule)[0]
    return y, chain.observable(u, s0, rule)[1] if states else None


def _apart(sys: Any) -> bool:
    """Whether the states of a canonical form can be taken apart into modes: single poles, well separated."""
    return not len(sys.modes.rigid) and sys.digits >= _DIGITS


def _cofactor_map(d: Array) -> ComplexArray:
    """Rows `sum_k b_k (lambda s_{2k+1} + s_{2k+2})` with the coefficients of the other modes' polynomial."""
    b = cofactors(d)
    W = np.empty((len(d), 2 * len(d)), complex)
    W[:, 0::2], W[:, 1::2] = -1j * d[:, None] * b, b
    return W


def _lagrange_map(d: Array) -> ComplexArray:
    """Rows `lambda^{k-1} / (lambda prod_{j != l} (d_j^2 - d_l^2))`: residues of `s^{k-1}/P(s)`, twice."""
    n = len(d)
    gaps = (d - d[:, None]) * (d + d[:, None])
    np.fill_diagonal(gaps, 1.0)
    # interleaved, so that powers and products do not leave the range of doubles one after the other
    ratio = (d[:, None] ** 2 / np.where(np.eye(n, dtype=bool), d**2, gaps)).prod(axis=1)
    exponents = np.arange(2 * n) - 1 - 2 * (n - 1)
    return ratio[:, None] * d[:, None] ** exponents * (-1j) ** (np.arange(2 * n) - 1)


def _lagrange_states(d: Array, w: ComplexArray) -> Array:
    states: Array = (_lagrange_map(d).T @ w).real
    return states


class _Chain:
    """A canonical form as a chain of resonators `xi_l'' = -d_l^2 xi_l + xi_{l-1}`, the first driven by the input.

    With time in a unit in which the frequencies are about 1, and `xi_n` the first state.  Higher states are derivatives
    of it: sums of terms of one sign, so nothing is lost however close the frequencies are.
    """

    def __init__(self, sys: Any) -> None:
        d = _poles(sys).d
        n = len(d)
        live = d[d > 0]
        self.unit = float(2.0 ** np.round(np.mean(np.log2(live)))) if len(live) else 1.0
        links = np.diag(np.ones(n - 1), -1) - np.diag((d / self.unit) ** 2)
        rows = np.eye(n)[-1:]
        while len(rows) < n:
            rows = np.concatenate([rows, rows[-1:] @ links])
        self.rows = rows
        self.motion = np.block([[np.zeros((n, n)), np.eye(n)], [links, np.zeros((n, n))]])
        self.scale = self.unit ** np.arange(2 * n, 0, -1.0)
        self.readout = sys._readout()

    def controllable(self, u: Array, s0: Array, rule: Rule) -> Array:
        """States of the controllable form."""
        n = len(self.rows)
        start = self._halves(s0 * self.scale, lambda part: self._solve(part))
        drive = np.eye(2 * n)[:, n]
        x = _recursion(self.unit * self.motion, self.unit * drive, u[0], start, rule)
        sigma = np.empty_like(x)
        sigma[0::2], sigma[1::2] = self.rows @ x[:n], self.rows @ x[n:]
        return sigma / self.scale[:, None]

    def observable(self, u: Array, s0: Array, rule: Rule) -> tuple[Array, Array]:
        """Outputs and states of the observable form: the transpose of the same chain."""
        n = len(self.rows)
        start, drive = (self._halves(s / self.scale, lambda part: self.rows.T @ part) for s in (s0, self.readout))
        x = _recursion(self.unit * self.motion.T, drive, u[0], start, rule)
        rho = np.empty_like(x)
        rho[0::2], rho[1::2] = (self._solve(part, transposed=True) for part in (x[:n], x[n:]))
        s = rho * self.scale[:, None]
        return s[-1:], s

    def _halves(self, s: Array, act: Any) -> Array:
        return np.concatenate([act(s[0::2]), act(s[1::2])])

    def _solve(self, part: Array, *, transposed: bool = False) -> Array:
        """Invert `rows`, triangular once its columns are read backwards."""
        turned = self.rows[:, ::-1]
        if transposed:
            solution = solve_triangular(turned, part[::-1], lower=True, trans="T", unit_diagonal=True)
            return np.asarray(solution)
        return np.asarray(solve_triangular(turned, part, lower=True, unit_diagonal=True))[::-1]


def _recursion(F: Array, g: Array, u: Array, x0: Array, rule: Rule) -> Array:
    """States (N, T) of `x' = F x + g u` stepped by the rule."""
    N, h = len(F), rule.h
    one = np.eye(N)
    if rule.method == "euler":
        step: Array = one + h * F
        now, then = h * g, 0 * g
    elif rule.method == "midpoint":
        both = np.asarray(np.linalg.solve(one - 0.5 * h * F, np.column_stack([one + 0.5 * h * F, h * g])), float)
        step, gain = both[:, :N], both[:, N]
        now, then = (gain, 0 * g) if rule.intersample == "zoh" else (0.5 * gain, 0.5 * gain)
    else:
        M = np.zeros((N + 2, N + 2))
        M[:N, :N], M[:N, N], M[N, N + 1] = h * F, h * g, 1.0
        M = np.asarray(expm(M), float)
        step, whole, late = M[:N, :N], M[:N, N], M[:N, N + 1]
        now, then = (whole, 0 * g) if rule.intersample == "zoh" else (whole - late, late)
    x = np.empty((N, len(u)))
    x[:, 0] = x0
    for k in range(len(u) - 1):
        x[:, k + 1] = step @ x[:, k] + now * u[k] + then * u[k + 1]
    return x


def check_finite(y: Array, z: Array | None, growth: float, rule: Rule) -> None:
    """Refuse a response that left the range of doubles."""
    if np.isfinite(y).all() and (z is None or np.isfinite(z).all()):
        return
    cure = "use method='exact' or a smaller step" if growth > 1 else "scale the input, the state or time"
    raise StructureError(
        f"the response exceeds the range of doubles: with method={rule.method!r} and step {rule.h:.4g} the fastest "
        f"mode grows by {growth:.4g} a step; {cure}"
    )

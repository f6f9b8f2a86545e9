"""Observers and output feedback whose Lyapunov function is an energy."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import cast

import control as ct
import numpy as np
from scipy.linalg import eig, solve_continuous_are, solve_continuous_lyapunov, svd

from .. import _checks
from .._types import Array, ArrayLike, SystemNames, Unpack
from .._units import with_unit
from ..exceptions import StructureError
from ..reduction.modal_truncation import energy_basis, sees
from ..systems.dissipative import parts_of
from ..systems.port_hamiltonian import PortHamiltonian, ph
from .damping_injection import controller_of, plant, port_numbers
from .optimal_damping import energy_coordinates, optimal_damping, refuse_feedthrough

_OSCILLATES = 1e-7  # of the fastest rate: an imaginary part of a pole that is more than rounding of a double one
_REACHED = 1e-12  # of the size of a port: a mode that moves there
_SOLVED = 1e-6  # of its terms: what the solution may miss of a Riccati equation
_STEPS = 4  # of Newton's method, of which the last shows what the ones before have missed
_ROUNDING = 64  # times `n EPS`: negative eigenvalues that are taken for rounding


def observer(
    sys: PortHamiltonian, gain: ArrayLike | None = None, *, ports: Sequence[int | str] | None = None,
    **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    """Observer of the states from inputs and outputs of ports, with the energy of the error as Lyapunov function.

    Parameters
    ----------
    sys : PortHamiltonian
        The plant, without feedthrough at the ports that are measured.
    gain : float, array_like of shape (k,) or (k, k), optional
        `K` of the correction `B K (y - C x)`, with `K + K^T >= 0`.  Default: that which maximises the smallest damping
        ratio of the error, see `optimal_damping`; at a port that reaches no mode that oscillates, as of an overdamped
        plant, the size of its impedance at the geometric mean of the rates of the plant.
    ports : sequence of int or str, optional
        Ports whose outputs are measured, by number or the name of their input.  Default: all.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Returns
    -------
    PortHamiltonian
        Inputs: the m inputs of the plant, then the k measured outputs.  Outputs: those of its own m + k ports, then the
        estimates of all states of the plant, which are also its states.

    Raises
    ------
    StructureError
        If a measured port has feedthrough, or `K + K^T` has a negative eigenvalue.

    Notes
    -----
    `xhat' = (J - R - B_k K B_k^T) Q xhat + (B - P) u + B_k K y`: the error `e` obeys the same equation without inputs,
    so that its energy `e^T Q e / 2` never rises; with losses or where ports see all modes it falls to 0.  Sensors away
    from the ports have no such law; for these use `control.lqe`.

    Examples
    --------
    >>> import numpy as np, control as ct, ph_control as phc
    >>> sys = phc.spring_chain([1.0, 1.0], [2.0], ground=1.0)
    >>> estimator = phc.observer(sys)
    >>> t, u = np.linspace(0.0, 60.0, 601), np.zeros(601)
    >>> seen = phc.forced_response(sys, t, u, [0.1, 0.2, 0.0, 0.0])
    >>> estimated = phc.forced_response(estimator, t, np.vstack([u, seen.outputs]))
    >>> bool(np.abs(estimated.outputs[2:] - seen.states)[:, -1].max() < 1e-3)
    True
    """
    plant(sys)
    port_indices = port_numbers(sys, ports)
    refuse_feedthrough(sys, port_indices)
    chosen = _default_gain(sys, port_indices) if gain is None else gain
    if isinstance(chosen, ct.InputOutputSystem):
        raise StructureError("the gain of an observer is a matrix; it is a system")
    K = np.asarray(controller_of(chosen, len(port_indices)))
    part = parts_of(sys)
    B = (part["G"] + part["P"])[:, port_indices]
    into = (part["G"] - part["P"])[:, port_indices]
    correction = into @ K
    loss = into @ K @ B.T
    n = len(part["G"])
    skew = part["J"] - 0.5 * (loss - loss.T)
    R = part["R"] + 0.5 * (loss + loss.T)
    G, P = np.hstack([part["G"], correction]), np.hstack([part["P"], np.zeros_like(correction)])
    through = [np.pad(part[name], ((0, len(port_indices)), (0, len(port_indices)))) for name in "SN"]
    labels = _named(sys, port_indices, names)
    made = ph(part["Q"], G, J=skew, R=R, P=P, S=through[0], N=through[1], sensors=np.eye(n), **labels)
    return with_unit(made, sys.time_unit)


def _default_gain(sys: PortHamiltonian, ports: list[int]) -> Array:
    """Gain of each port: that of the largest damping ratio where a mode oscillates at it, else its impedance."""
    A, into, _, _ = energy_coordinates(sys, ports)
    p, left_vectors, right_vectors = eig(A, left=True, right=True)
    overlap = np.abs(np.einsum("ij,ij->j", left_vectors.conj(), right_vectors))
    reached = np.abs(left_vectors.conj().T @ into[:, ports]) * np.abs(right_vectors.T @ into[:, ports])
    size, turning = np.abs(p), p.imag > _OSCILLATES * np.abs(p).max(initial=0.0)
    seen = reached > _REACHED * overlap[:, None] * np.linalg.norm(into[:, ports], axis=0) ** 2
    swings = [k for k in range(len(ports)) if seen[turning, k].any()]
    gains = np.zeros(len(ports))
    if swings:
        gains[swings] = optimal_damping(sys, [ports[k] for k in swings], criterion="damping").gains
    moving = size[size > _ROUNDING * len(A) * _checks.EPS * size.max(initial=0.0)]
    rate = float(np.exp(np.mean(np.log(moving)))) if len(moving) else 1.0
    admittance = np.abs(np.diag(np.asarray(sys.horner(1j * rate))[: sys.ninputs, :, 0])[ports])
    still = np.isin(np.arange(len(ports)), swings, invert=True) & (admittance > 0)
    gains[still] = 1.0 / admittance[still]
    return gains


def _named(sys: PortHamiltonian, ports: list[int], names: SystemNames) -> SystemNames:
    """Names of the signals of an observer: of the plant where they have any."""
    measured = [sys.output_labels[k] for k in ports]
    inputs = [*sys.input_labels, *measured]
    outputs = [*(f"{label} of the observer" for label in sys.output_labels[: sys.ninputs]),
               *(f"correction at {label}" for label in measured), *sys.state_labels]  # fmt: skip
    given = {"inputs": inputs, "outputs": outputs, "states": list(sys.state_labels)}
    unique = {kind: labels for kind, labels in given.items() if len(set(labels)) == len(labels)}
    return cast(SystemNames, {**unique, **names})


def lqg(
    sys: PortHamiltonian, effort: ArrayLike = 1.0, *, weight: ArrayLike | None = None,
    ports: Sequence[int | str] | None = None, **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    r"""Output feedback that is optimal for a quadratic cost, and passive.

    Parameters
    ----------
    sys : PortHamiltonian
        The plant, without feedthrough at the ports that are used.
    effort : float or array_like, shape (k, k)
        Weight `E > 0` of the inputs in the cost; small ones make a strong controller.
    weight : array_like, shape (n, n), optional
        Weight of the states, symmetric positive semidefinite.  Default: the energy, `Q`.
    ports : sequence of int or str, optional
        Ports for feedback, by number or the name of their input.  Default: all.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Returns
    -------
    PortHamiltonian
        The controller from the outputs of the ports to what is subtracted from their inputs, with as many states as the
        plant has energies: `damping_injection(sys, controller, ports=ports)` is the closed loop.

    Raises
    ------
    StructureError
        If a port has feedthrough, `effort` is not positive definite, or `weight` not semidefinite; if the effort is so
        far from the impedances of the plant, by some ten digits, that rounding leaves nothing of the controller.

    Notes
    -----
    In coordinates of unit energy, `Q = I` and `C = B^T`: the noise of the measurement has the covariance `E`, that of
    the states `2 R + B E^{-1} B^T`, such as thermal noise; the covariance of the estimates is then the identity and
    the gain of the filter `B E^{-1}`.  With the cost `x^T (W + B E^{-1} B^T) x + u^T E u` and the solution `X` of its
    Riccati equation, `u = -E^{-1} B^T X xhat`, and

        `X A_c + A_c^T X = -W - (X B + B) E^{-1} (X B + B)^T`

    for the dynamics `A_c` of the controller: its energy is `xhat^T X xhat / 2`, and it is passive (Lozano-Leal and
    Joshi).  The loop is stable with every passive plant, not only with the one it was made for.

    Examples
    --------
    >>> import ph_control as phc
    >>> sys = phc.spring_chain([1.0, 1.0], [2.0], ground=1.0)
    >>> controller = phc.lqg(sys, 0.1)
    >>> closed = phc.damping_injection(sys, controller)
    >>> phc.passivity(controller).is_passive, bool(closed.poles().real.max() < -0.05)
    (True, True)
    """
    plant(sys)
    port_indices = port_numbers(sys, ports)
    A, into, _, _ = energy_coordinates(sys, port_indices)
    B, E = into[:, port_indices], _effort(effort, len(port_indices))
    W = np.eye(len(A)) if weight is None else _weight(sys, weight)
    root = np.linalg.cholesky(E)
    scaled = np.linalg.solve(root, B.T)
    gained = np.linalg.solve(root.T, scaled)
    X = _riccati(A, scaled.T, W)
    if X is None:
        natural = np.linalg.norm(B, 2) ** 2 / (np.linalg.norm(A, 2) or 1.0)
        raise StructureError(
            f"the effort {_checks.shown(effort)} leaves no digits of the controller: its Riccati equation is not "
            f"solved to {_SOLVED:.0e} of its terms by a positive definite matrix; take an effort nearer to "
            f"{natural:.3g}, with which the ports damp as fast as the plant moves, and a weight like the energy"
        )
    lead = np.linalg.solve(root, B.T @ X + B.T)
    inverse = np.linalg.inv(X)
    loss = inverse @ (W + lead.T @ lead) @ inverse
    dynamics = A - B @ gained @ X - gained.T @ B.T
    flow = dynamics @ inverse
    labels: SystemNames = {
        "inputs": [sys.output_labels[k] for k in port_indices],
        "outputs": [f"{sys.input_labels[k]} feedback" for k in port_indices],
        **names,
    }
    made = ph(0.5 * (X + X.T), gained.T, J=0.5 * (flow - flow.T), R=0.25 * (loss + loss.T), **labels)
    return with_unit(made, sys.time_unit)


def _riccati(A: Array, S: Array, W: Array) -> Array | None:
    """Solution of `X A + A^T X - X S S^T X + W + S S^T = 0`, or None where rounding leaves no positive definite one.

    In the time of the plant, with `S` along the first states, and as the difference from the identity: terms in
    `S S^T`, which may exceed all others by many digits, then do not hide `W`.  Steps of Newton's method follow, each of
    a Lyapunov equation, as the eigenvectors of the Riccati equation have lost digits.
    """
    n, k = len(A), S.shape[1]
    rate = np.linalg.norm(A, 2) or 1.0
    U, s, V = svd(S / np.sqrt(rate))
    S = np.zeros((n, k))
    S[: len(s)] = s[:, None] * V[: len(s)]
    A, W = U.T @ A @ U / rate, U.T @ W @ U / rate
    F, Q = A - S @ S.T, W + A + A.T
    unit = max(1.0, float(np.sqrt(np.linalg.norm(Q, 2)) / (np.linalg.norm(S, 2) or 1.0)))  # of a solution far above 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # what is missed tells
        try:
            Y = unit * solve_continuous_are(F, np.sqrt(unit) * S, 0.5 * (Q + Q.T) / unit, np.eye(k))
            change = np.zeros((n, n))
            for _ in range(_STEPS):
                Y = Y + 0.5 * (change + change.T)
                closed = F - S @ S.T @ Y
                off = Y @ closed + F.T @ Y + Q
                size = 2 * np.linalg.norm(Y @ F) + np.linalg.norm(Y @ S) ** 2 + np.linalg.norm(Q)
                change = solve_continuous_lyapunov(closed.T, -0.5 * (off + off.T))
        except (np.linalg.LinAlgError, ValueError):
            return None
    X = np.eye(n) + Y
    solved = np.linalg.norm(off) <= _SOLVED * size and np.linalg.eigvalsh(X)[0] > 0
    return U @ X @ U.T if solved else None


def _effort(effort: ArrayLike, k: int) -> Array:
    E = _checks.real_array("the effort", effort)
    if E.shape == ():
        E = E * np.eye(k)
    if E.shape != (k, k):
        raise StructureError(f"the effort has shape {E.shape}; it must be a number, or of shape ({k}, {k})")
    E = _checks.symmetric_matrix(E, name="the effort", even=False)
    least = float(np.linalg.eigvalsh(E).min(initial=np.inf))
    if not least > 0:
        raise StructureError(f"the effort has the eigenvalue {least:.3g}; it must be positive definite")
    return E


def _weight(sys: PortHamiltonian, weight: ArrayLike) -> Array:
    """Weight of the states in coordinates of unit energy."""
    W = _checks.symmetric_matrix(weight, name="the weight", even=False)
    n = sys.nstates
    if W.shape != (n, n):
        raise StructureError(f"the weight has shape {W.shape}; it must be ({n}, {n})")
    least, largest = (float(f(np.linalg.eigvalsh(W), initial=0.0)) for f in (np.min, np.max))
    if least < -_ROUNDING * n * _checks.EPS * largest:
        raise StructureError(f"the weight has the eigenvalue {least:.3g}; allowed are none below 0")
    Q = parts_of(sys)["Q"]
    _, back, still = energy_basis(Q)
    if sees(W, still, Q).any():
        raise StructureError("the weight sees a rigid displacement, which has no energy; leave it out")
    return back.T @ W @ back

"""Answers to plain valid input, held against 50 digits or dense matrices that do not use the package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control as ct
import mpmath as mp
import numpy as np

import ph_control as phc

DIGITS = 50
CLOSE = 1e-9  # relative; what is drawn is well conditioned


class Wrong(Exception):
    """An answer that is not the one of the reference."""


def hold(found: Any, right: Any, size: Any = None) -> None:
    """Compare with the reference, relative to its largest entry."""
    found, right = np.asarray(found), np.asarray(right)
    if found.shape != right.shape:
        raise Wrong(f"shape {found.shape}, right {right.shape}")
    scale = np.max(np.abs(right), initial=1e-300) if size is None else size
    error = float(np.max(np.abs(found - right), initial=0.0) / scale)
    if not error <= CLOSE:
        raise Wrong(f"relative error {error:.1e}")


def _exact(A: Any, B: Any, C: Any, s: complex) -> Any:
    """Transfer function of the very doubles."""
    with mp.workdps(DIGITS):
        matrix = mp.mpc(s) * mp.eye(len(A)) - mp.matrix(A.tolist())
        found = mp.matrix(C.tolist()) * mp.lu_solve(matrix, mp.matrix(B.tolist())) if B.shape[1] == 1 else (
            mp.matrix(C.tolist()) * matrix**-1 * mp.matrix(B.tolist()))  # fmt: skip
        return np.array(found.tolist(), dtype=complex)


def _plant(rng: Any, ports: int = 1) -> Any:
    """A dense Q of modest condition, frequencies apart."""
    n = int(rng.integers(1, 4))
    d = np.cumsum(rng.uniform(0.4, 1.5, n))
    U, _ = np.linalg.qr(rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))
    squeeze = np.exp(rng.uniform(-0.5, 0.5, n))
    S = np.block([[U.real, -U.imag], [U.imag, U.real]]) * np.concatenate([squeeze, 1 / squeeze])
    Q = S.T @ np.diag(np.tile(d, 2)) @ S
    return (Q + Q.T) / 2, rng.standard_normal((2 * n, ports)) + 0.1


def _matrices(Q: Any, B: Any) -> tuple[Any, Any, Any]:
    n = len(Q) // 2
    return np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(n)) @ Q, B, B.T @ Q


def _points(rng: Any) -> Any:
    """Off the axis, where no pole is near."""
    return rng.uniform(0.3, 1, 2) * rng.choice([-1, 1], 2) + 1j * rng.uniform(0.1, 4, 2)


def _same_everywhere(found: Any, Q: Any, B: Any, rng: Any) -> None:
    for s in _points(rng):
        right = _exact(*_matrices(Q, B), s)
        hold(found.horner(s)[..., 0], right)
        hold(_exact(found.A, found.B, found.C, s), right)


def frequency_response(rng: Any) -> None:
    Q, B = _plant(rng, int(rng.integers(1, 3)))
    plant = phc.ph(Q, B)
    d = plant.d
    w = np.append(d[:-1] + np.diff(d) * rng.uniform(0.3, 0.7), d[-1] * 1.3)
    right = np.stack([_exact(*_matrices(Q, B), 1j * x) for x in w], axis=-1)
    hold(plant.horner(1j * w), right)
    hold(plant.modes.freqresp(w), right.reshape(np.shape(plant.modes.freqresp(w))))


def canonical_forms(rng: Any) -> None:
    Q, B = _plant(rng)
    form = pick_form(rng)
    _same_everywhere(form(phc.ph(Q, B)), Q, B, rng)
    _same_everywhere(phc.ph(form(phc.ph(Q, B))), Q, B, rng)


def pick_form(rng: Any) -> Callable[..., Any]:
    return phc.ch if rng.random() < 0.5 else phc.oh


def from_python_control(rng: Any) -> None:
    Q, B = _plant(rng, int(rng.integers(1, 3)))
    A, B, C = _matrices(Q, B)
    T = rng.standard_normal(A.shape) + 3 * np.eye(len(A))
    other = ct.ss(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), 0)
    found = phc.ph(other)
    for s in _points(rng):
        hold(found.horner(s)[..., 0], _exact(A, B, C, s))


def minimal_realization(rng: Any) -> None:
    Q, B = _plant(rng)
    other, _ = _plant(rng)
    n, k = len(Q) // 2, len(other) // 2
    order = np.r_[0:n, 2 * n : 2 * n + k, n : 2 * n, 2 * n + k : 2 * n + 2 * k]
    whole = np.block([[Q, np.zeros((2 * n, 2 * k))], [np.zeros((2 * k, 2 * n)), other]])[np.ix_(order, order)]
    found = phc.minreal(phc.ph(whole, np.concatenate([B, np.zeros((2 * k, 1))])[order]))
    if found.nstates != 2 * n:
        raise Wrong(f"{found.nstates} states, right {2 * n}")
    _same_everywhere(found, Q, B, rng)


def _steps(A: Any, B: Any, h: float) -> tuple[Any, Any, Any]:
    """State, held and sloping input over one step."""
    n, m = B.shape
    with mp.workdps(DIGITS):
        M = mp.zeros(n + 2 * m)
        for i in range(n):
            for j in range(n):
                M[i, j] = mp.mpf(float(A[i, j])) * mp.mpf(h)
            for j in range(m):
                M[i, n + j] = mp.mpf(float(B[i, j])) * mp.mpf(h)
        for j in range(m):
            M[n + j, n + m + j] = mp.mpf(1)
        E = np.array(mp.expm(M).tolist(), dtype=float)
    return E[:n, :n], E[:n, n : n + m], E[:n, n + m :]


def sampled(rng: Any) -> None:
    Q, B = _plant(rng)
    h = float(rng.uniform(0.05, 0.5))
    F, held, _ = _steps(*_matrices(Q, B)[:2], h)
    found = phc.sample(phc.ph(Q, B), h, intersample="zoh")
    hold(found.A, F)
    hold(found.B, held)


def simulated(rng: Any) -> None:
    Q, B = _plant(rng)
    A, B, C = _matrices(Q, B)
    h, hold_ = float(rng.uniform(0.05, 0.5)), str(rng.choice(["zoh", "foh"]))
    F, held, slope = _steps(A, B, h)
    u, z = rng.standard_normal(15), rng.standard_normal(len(A))
    found = phc.forced_response(phc.ph(Q, B), h * np.arange(15), u, z, intersample=hold_)
    states = [z]
    for k in range(14):
        rise = (u[k + 1] - u[k]) * (hold_ == "foh")
        states.append(F @ states[-1] + held[:, 0] * u[k] + slope[:, 0] * rise)
    hold(found.outputs, (C @ np.array(states).T)[0])


def normal_form(rng: Any) -> None:
    Q, _ = _plant(rng)
    d, S = phc.williamson(Q)
    hold(S.T @ np.diag(np.tile(d, 2)) @ S, Q)
    J = np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(len(d)))
    hold(S.T @ J @ S, J, np.linalg.norm(S, 2) ** 2)
    hold(np.sort(np.abs(np.linalg.eigvals(J @ Q).imag))[::2], np.sort(d))


def same_after_a_change_of_coordinates(rng: Any) -> None:
    Q, B = _plant(rng)
    S = phc.williamson(_plant_of(rng, len(Q) // 2))[1]
    back = np.linalg.inv(S)
    moved = back.T @ Q @ back
    verdict = phc.same_filter(phc.ph(Q, B), phc.ph((moved + moved.T) / 2, S @ B))
    if not verdict.holds:
        raise Wrong(f"not the same filter: {verdict.residual:.1e}")


def _plant_of(rng: Any, n: int) -> Any:
    while True:
        Q, _ = _plant(rng)
        if len(Q) == 2 * n:
            return Q


ORACLES: dict[str, Callable[[Any], None]] = {
    "frequency response": frequency_response, "canonical forms": canonical_forms, "conversion": from_python_control,
    "minimal realization": minimal_realization, "sampling": sampled, "simulation": simulated,
    "normal form": normal_form, "same filter": same_after_a_change_of_coordinates,
}  # fmt: skip

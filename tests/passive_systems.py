"""Random passive systems, and what is measured of a port-Hamiltonian form of them: plain matrices only."""

from __future__ import annotations

import control as ct
import numpy as np
from scipy.linalg import block_diag, qr

KINDS = ("dense", "chain", "modal")


def passive_system(seed, states=24, kind=None, hidden=None, scales=9.0, condition=1.5):
    """Passive state space of up to `states` states: energy, losses and ports of three kinds, in random coordinates.

    Some have states that ports do not reach or do not see, and undamped, hardly damped and overdamped modes.
    Returns the system and its kind.
    """
    rng = np.random.default_rng(seed)
    kind = kind or KINDS[int(rng.integers(len(KINDS)))]
    m = int(rng.integers(1, 7)) if states > 12 else int(rng.integers(1, 4))
    A, B, C, D = {"dense": _dense, "chain": _chain, "modal": _modal}[kind](rng, states, m)
    m = B.shape[1]
    D = D + _feedthrough(rng, m)
    if rng.integers(0, 4) == 0 if hidden is None else hidden:
        k = int(rng.integers(1, 4))
        extra = rng.normal(size=(k, k))
        extra = extra - extra.T - np.eye(k) * rng.integers(0, 2)
        size = np.linalg.norm(A, 2)
        if rng.integers(0, 2):  # not reached, but seen
            B, C = np.vstack([B, np.zeros((k, m))]), np.hstack([C, rng.normal(size=(m, k))])
        else:
            B, C = np.vstack([B, rng.normal(size=(k, m))]), np.hstack([C, np.zeros((m, k))])
        A = block_diag(A, size * extra)
    n = len(A)
    T = qr(rng.normal(size=(n, n)))[0] * 10 ** rng.uniform(0, condition, n)
    if rng.integers(0, 3):
        A, B, C = np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T
    time, gain = 10 ** rng.uniform(-scales, scales, 2)
    size = np.linalg.norm(A, 2) or 1.0
    return ct.ss(A / size * time, B * np.sqrt(gain * time / size), C * np.sqrt(gain * time / size), D * gain), kind


def _dense(rng, states, m):
    n = int(rng.integers(1, states + 1))
    root = rng.normal(size=(n, n))
    Q = root @ root.T / n + 0.1 * np.eye(n)
    J, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    loss = rng.normal(size=(n, int(rng.integers(1, n + 1)))) * 10 ** rng.uniform(-2, 0.5)
    A = (J - J.T - loss @ loss.T) @ Q
    return A, B, B.T @ Q, np.zeros((m, m))


def _chain(rng, states, m):
    n = max(1, int(rng.integers(1, states // 2 + 1)))
    mass, spring = 10 ** rng.uniform(-0.5, 0.5, n), 10 ** rng.uniform(-0.5, 0.5, n)
    incidence = np.eye(n) - np.eye(n, k=-1)
    K = incidence.T @ np.diag(spring) @ incidence
    style = rng.integers(0, 4)
    if style == 0:  # Rayleigh
        R = 10 ** rng.uniform(-3, 0.5) * K + 10 ** rng.uniform(-3, 0.5) * np.diag(mass) * rng.integers(0, 2)
    elif style == 1:  # dashpots to the ground at some masses
        R = np.diag(10 ** rng.uniform(-3, 1, n) * (rng.uniform(size=n) < 0.5))
    elif style == 2:  # dashpots between some masses
        R = incidence.T @ np.diag(10 ** rng.uniform(-3, 1, n) * (rng.uniform(size=n) < 0.5)) @ incidence
    else:
        root = rng.normal(size=(n, n))
        R = 10 ** rng.uniform(-3, 0) * root @ root.T
    F = np.eye(n)[:, rng.permutation(n)[: min(m, n)]]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / mass[:, None], -R / mass[:, None]]])
    none = np.zeros((n, F.shape[1]))
    return A, np.vstack([none, F / mass[:, None]]), np.vstack([none, F]).T, np.zeros((F.shape[1],) * 2)


def _modal(rng, states, m):
    n = max(1, int(rng.integers(1, states // 2 + 1)))
    d = np.sort(10 ** rng.uniform(-1, 1, n))
    zeta = 10 ** rng.uniform(-5, 0.5, n) * (rng.uniform(size=n) < 0.9)
    psi = rng.normal(size=(n, m))
    A = np.block([[np.zeros((n, n)), np.diag(d)], [-np.diag(d), -np.diag(2 * zeta * d)]])
    B = np.vstack([np.zeros((n, m)), psi])
    return A, B, B.T, np.zeros((m, m))


def _feedthrough(rng, m):
    skew = rng.normal(size=(m, m)) * rng.integers(0, 2)
    root = rng.normal(size=(m, (0, m, int(rng.integers(0, m + 1)))[int(rng.integers(0, 3))]))
    return 10 ** rng.uniform(-2, 0) * (root @ root.T + skew - skew.T)


def band(system):
    """Frequencies of interest: at, between and beside the poles."""
    poles = np.linalg.eigvals(system.A)
    size = np.abs(poles)
    size = size[size > 1e-8 * size.max(initial=0.0)] if size.any() else np.ones(1)
    near = np.abs(poles.imag[:, None] + np.abs(poles.real[:, None]) * [-1.0, 0.0, 1.0]).ravel()
    return np.unique(np.concatenate([np.geomspace(size.min() / 30, size.max() * 30, 60), near]))


def values(A, B, C, D, omega):
    """`C (j omega - A)^-1 B + D`, shape (N, p, m), by LU; not finite at a pole."""
    eye = np.eye(len(A))
    with np.errstate(all="ignore"):
        try:
            return (
                C @ np.linalg.solve(1j * omega[:, None, None] * eye - A, np.broadcast_to(B, (len(omega), *B.shape))) + D
            )
        except np.linalg.LinAlgError:
            return np.array([_value(A, B, C, D, w) for w in omega])


def _value(A, B, C, D, w):
    try:
        return C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B.astype(complex)) + D
    except np.linalg.LinAlgError:
        return np.full(D.shape, np.nan + 0j)


def measured(form, system):
    """What a form misses: energy, losses, structure and transfer function, all relative.

    The transfer function is held against the largest value in the band, of which points are left out where rounding of
    the given matrices alone moves the response by more than 1e-12 of it.
    """
    S = np.zeros_like(form.N) if form.is_lossless else form.S  # without losses S is Williamson's
    W = np.block([[form.R, form.P], [form.P.T, S]])
    size = np.linalg.norm(W, 2) or 1.0
    m = system.ninputs
    omega = band(system)
    A, B, C, D = (np.array(getattr(system, name), float) for name in "ABCD")
    wanted = values(A, B, C, D, omega)
    scale = np.linalg.norm(A, 2) or 1.0
    moved = np.abs(values(A * (1 + 1e-14), B, C, D, omega) - wanted)
    for _ in range(2):
        noise = np.random.default_rng(0).normal(size=A.shape) * 1e-15 * scale / np.sqrt(len(A) or 1)
        moved = np.maximum(moved, np.abs(values(A + noise, B, C, D, omega) - wanted))
    moved = moved.max(axis=(1, 2))
    JRQ = (form.J - form.R) @ form.Q
    got = values(JRQ, form.G - form.P, (form.G + form.P).T @ form.Q, S + form.N, omega)
    finite = np.isfinite(wanted).all(axis=(1, 2)) & np.isfinite(got).all(axis=(1, 2))
    largest = np.abs(wanted[finite]).max(initial=np.linalg.norm(D))
    clear = finite & (moved <= 1e-12 * largest)
    off = np.abs(got - wanted)[clear].max(initial=0.0) / (largest or 1.0)
    return {
        "losses": float(np.linalg.eigvalsh(W)[0] / size) if len(W) else 0.0,
        "energy": float(np.linalg.eigvalsh(form.Q)[0] / np.linalg.norm(form.Q, 2)) if form.nstates else 1.0,
        "skew": bool(np.array_equal(form.J, -form.J.T) and np.array_equal(form.N, -form.N.T)),
        "transfer": float(off), "clear": int(clear.sum()), "points": len(omega), "ports": m,
    }  # fmt: skip

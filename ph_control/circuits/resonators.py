"""Resonators side by side of which a transfer function is the sum: what the branches of a circuit are made of.

In coordinates in which the energy of a system is half the sum of squares,

    p' = E v,      v' = -E^T p - L v + F u,      y = F^T v

is classically damped where `L` is diagonal with the right singular vectors of `E`: then modes are the resonators
`f f^T s / (s^2 + l s + d^2)`.  The two halves of the states are told by which of them the structure matrix joins.  No
poles are parted, so that modes may be as close to each other, and as weakly seen by the ports, as they will.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import control as ct
import numpy as np
from scipy.linalg import LinAlgError, cholesky, eig, eigh, svd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from .._checks import EPS
from .._types import Array, ComplexArray, NDArray
from ..exceptions import NotLosslessError, StructureError
from ..modal.modal_form import ModalForm
from ..systems.base import Convertible
from ..systems.dissipative import DissipativePortHamiltonian
from ..systems.passive_form import Conversion, PortRows, passive_parts
from ..systems.port_hamiltonian import ph

_REAL = 1e-9  # imaginary part of the residues of a circuit without gyrators, relative
_SAME = 8 * EPS  # of frequencies and losses: modes that are one
_EXACT = 1e-11  # of the largest response: what a form that was recognised may differ by
_CLOSE = 1e-4  # of their sum: squares of frequencies whose modes rounding may turn into each other
_SWEEPS = 30
_CERTAIN = 1e-4  # imaginary part of a residue, relative: damping that is surely not classical
_SURELY = 100.0  # times the estimated error of a residue


@dataclass(frozen=True)
class Resonator:
    """Resonator `kappa s / (s^2 + loss s + x)` seen with the ratios `psi`; without a spring `kappa / (s + loss)`."""

    kappa: float
    psi: Array
    loss: float = 0.0
    flexibility: float = 0.0  # kappa / x


@dataclass(frozen=True)
class Resonators:
    """What a transfer function is the sum of."""

    ports: int
    modes: list[Resonator]
    poles_at_zero: list[Resonator]
    relaxations: list[Resonator]
    feedthrough: Array


OnePort = tuple[Array, Array, float]


def resonators_of(sys: Convertible) -> tuple[Resonators, OnePort | None]:
    """Resonators of a system, and frequencies, weights and pole at 0 of a lossless one-port."""
    system = sys if isinstance(sys, ModalForm) and sys.is_lossless else ph(sys)
    if isinstance(system, DissipativePortHamiltonian):
        if len(system.sensors[0]):
            raise StructureError(
                f"the system has {len(system.sensors[0])} sensors beside its ports, and a circuit has ports only; "
                "leave them out"
            )
        resonators = _of_energy(system)
        if resonators is not None:
            return resonators, None
        # whatever coordinates and energy the matrices have
        given = PortRows(system.A, system.B, system.C, system.D)
        try:
            system = ph(ct.ss(system.A, system.B, system.C, system.D), lossless=True)
        except NotLosslessError:
            _refuse_complex_residues(given)
            return _of_responses(*passive_parts(given, "auto", None, minimal=True)), None
    modes = (system if isinstance(system, ModalForm) else system.modes).minimal()
    parts = _of_lossless(modes)
    return parts, None if modes.nports > 1 else (modes.d, modes.r, float(np.sum(modes.rigid**2)))


def _of_lossless(modes: ModalForm) -> Resonators:
    resonators = []
    for d, nu, r in zip(modes.d, modes.nu, modes.r, strict=True):
        psi, size = (np.ones(1), float(r)) if modes.nports == 1 else _ratios(nu)
        resonators.append(Resonator(d * size, psi, flexibility=size / d))
    at_zero = [Resonator(size, psi) for psi, size in map(_ratios, modes.rigid)]
    return Resonators(modes.nports, resonators, at_zero, [], np.zeros(modes.nports))


def _ratios(nu: Array | ComplexArray) -> tuple[Array, float]:
    """Real ratios, the largest 1, and the square of what they are multiplied by, of the weights of a mode."""
    lead = nu[np.abs(nu).argmax()]
    psi = nu / lead
    if np.abs(psi.imag).max() > _REAL:
        raise StructureError(
            f"a mode reaches the ports with different phases (imaginary part {np.abs(psi.imag).max():.2g} of the "
            f"largest, allowed {_REAL:g}): the transfer function is not symmetric, and its circuit needs gyrators"
        )
    return np.where(np.abs(psi.real) > EPS, psi.real, 0.0), float(np.abs(lead) ** 2)


# --- by the energy -----------------------------------------------------------------------------------------------


def _of_energy(system: DissipativePortHamiltonian) -> Resonators | None:
    """Resonators of a system with losses whose damping is classical by its own energy; None where that is not seen."""
    if system.P.any():
        return None
    root = _root(system.Q)
    J, R, G = root @ system.J @ root.T, root @ system.R @ root.T, root @ system.G
    J, R = _without_noise(J, R)
    all_modes: list[tuple[float, float, Array]] = []  # frequency, loss and part in the ports of each mode
    joined = coo_array((J != 0) | (R != 0))
    count, label = connected_components(joined, directed=False)
    for states in np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label, minlength=count))[:-1]):
        if not len(states):
            continue
        j, r, g = J[np.ix_(states, states)], R[np.ix_(states, states)], G[states]
        moving = _moving(j, r, g)
        if moving is None:
            return None
        modes = _modes_of_halves(j[np.ix_(~moving, moving)], r[np.ix_(moving, moving)], g[moving])
        if modes is None:
            return None
        all_modes += modes
    through = system.S + system.N
    if not any(loss for _, loss, _ in all_modes) and not through.any():
        return None  # lossless, which has more forms
    return _sorted(all_modes, _diagonal(through))


def _root(Q: Array) -> Array:
    """Rows F with `Q = F^T F`, as many as its rank; as sparse as Q allows."""
    if np.count_nonzero(Q) == np.count_nonzero(np.diag(Q)):
        return np.diag(np.sqrt(np.diag(Q)))[np.diag(Q) > 0]
    scale = np.sqrt(np.where(np.diag(Q) > 0, np.diag(Q), 1.0))
    count, label = connected_components(coo_array(Q), directed=False)
    rows = []
    for block in range(count):
        states = np.flatnonzero(label == block)
        inner = Q[np.ix_(states, states)] / scale[states] / scale[states, None]
        try:
            part = cholesky(inner)
        except LinAlgError:
            part = np.zeros((0, 0))
        if not len(part) or np.diag(part).min() <= len(part) * np.sqrt(EPS):
            sigma, U = eigh(inner)
            kept = sigma > len(sigma) * EPS * sigma[-1]
            part = np.sqrt(sigma[kept, None]) * U[:, kept].T
        row = np.zeros((len(part), len(Q)))
        row[:, states] = part * scale[states]
        rows.append(row)
    return np.vstack(rows)


def _without_noise(J: Array, R: Array) -> tuple[Array, Array]:
    """Matrices without entries off the diagonal that are rounding of others in their rows."""
    noise = len(J) * EPS
    size = np.maximum(np.abs(J), np.abs(R)).max(axis=1, initial=0.0)
    J = np.where(np.abs(J) > noise * np.minimum(size, size[:, None]), 0.5 * (J - J.T), 0.0)
    least = np.sqrt(np.maximum(np.diag(R), 0.0))
    kept = np.abs(R) > noise * least * least[:, None]
    return J, np.where(kept | np.eye(len(R), dtype=bool), 0.5 * (R + R.T), 0.0)


def _moving(J: Array, R: Array, G: Array) -> NDArray[np.bool_] | None:
    """Which of the states of a connected part are velocities: ports and losses are at these, and J joins both halves.

    None if there are no such halves.
    """
    n = len(J)
    order, before = breadth_first_order(coo_array((J != 0) | (R != 0)), 0, directed=False)
    side: NDArray[np.bool_] = np.zeros(n, np.bool_)
    for k in order[1:]:
        side[k] = side[before[k]] ^ bool(J[k, before[k]])
    same = side[:, None] == side
    if J[same].any() or R[~same].any():
        return None
    busy = (np.diag(R) != 0) | G.any(axis=1)
    if busy[side].any() and busy[~side].any():
        return None
    return side if busy[side].any() else ~side


def _modes_of_halves(E: Array, L: Array, F: Array) -> list[tuple[float, float, Array]] | None:
    """Modes of `p' = E v`, `v' = -E^T p - L v + F u` that ports reach; None where damping is not classical."""
    n = len(L)
    _, s, W = svd(E) if E.size else (None, np.zeros(0), np.eye(n))
    d = np.concatenate([s, np.zeros(n - len(s))])
    d[d <= max(E.shape) * EPS * d.max(initial=0.0)] = 0.0
    L, F = W @ L @ W.T, W @ F
    X, L, F = _turned_together(d * d, L, F)
    d, loss = np.where(d == np.sqrt(np.diag(X)), d, np.sqrt(np.maximum(np.diag(X), 0.0))), np.maximum(np.diag(L), 0.0)
    between = _between(X, n), _between(L, n)
    off = between[0] + between[1]
    if n > 1:
        F = np.where(np.linalg.norm(F, axis=1, keepdims=True) > n * EPS * np.linalg.norm(F), F, 0.0)
    # modes that ports reach, if only through others
    count, label = connected_components(coo_array(off), directed=False)
    reached = np.isin(label, label[F.any(axis=1)]) if count else np.zeros(n, bool)
    d, loss, F = d[reached], loss[reached], F[reached]
    stiff, lossy = (matrix[np.ix_(reached, reached)] for matrix in between)
    if (stiff.any() or lossy.any()) and not _beside(d, loss, F, stiff, lossy) <= _EXACT:
        return None
    return [(float(a), float(b), row) for a, b, row in zip(d, loss, F, strict=True) if row.any()]


def _between(M: Array, n: int) -> Array:
    """Sizes of what a positive semidefinite matrix has off its diagonal beyond rounding."""
    root = np.sqrt(np.maximum(np.diag(M), 0.0))
    return np.where((np.abs(M) > 4 * n * EPS * root * root[:, None]) & ~np.eye(len(M), dtype=bool), np.abs(M), 0.0)


def _turned_together(x: Array, L: Array, F: Array) -> tuple[Array, Array, Array]:
    """Squares of frequencies, losses and ports of modes, turned where they are so close that rounding may mix them.

    Jacobi rotations of pairs make `diag(x)` and `L` as diagonal as they get together.
    """
    n, L, F, X = len(x), L.copy(), F.copy(), np.diag(x).copy()
    sizes = [np.abs(M).max(initial=0.0) or 1.0 for M in (X, L)]
    for _ in range(_SWEEPS):
        flagged = np.triu(_between(L, n) + _between(X, n)) > 0
        flagged &= np.abs(np.subtract.outer(x, x)) <= _CLOSE * np.add.outer(x, x)
        turned = False
        for i, j in np.argwhere(flagged):
            h = np.array([[M[i, i] - M[j, j], 2 * M[i, j]] for M in (X / sizes[0], L / sizes[1])])
            on, both = float(h[:, 0] @ h[:, 0] - h[:, 1] @ h[:, 1]), float(2 * h[:, 0] @ h[:, 1])
            angle = 0.25 * np.arctan2(both, on)
            if abs(angle) <= EPS:
                continue
            turned, pair = True, [i, j]
            Q = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            for M in (X, L):
                M[pair] = Q @ M[pair]
                M[:, pair] = M[:, pair] @ Q.T
            F[pair] = Q @ F[pair]
        if not turned:
            break
    return X, L, F


def _beside(d: Array, loss: Array, F: Array, stiff: Array, lossy: Array) -> float:
    """Bound of what is between modes changes of the response at the resonances, over the largest response there.

    With `D_i = d_i^2 - w^2 + i w loss_i`, `N = |D|^-1/2 (stiff + w lossy) |D|^-1/2` and `h_i = |f_i| sqrt(w / |D_i|)`
    the change is at most `h^T N (1 - N)^-1 h`, which is `h^T N h + 2 |N h|^2` for N up to 1/2.
    """
    joined = (stiff + lossy).any(axis=1)
    pick = np.ix_(joined, joined)
    d, loss, stiff, lossy = d[joined], loss[joined], stiff[pick], lossy[pick]
    weight = np.linalg.norm(F[joined], axis=1)
    w = np.where(d > 0, d, loss)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):  # of a mode without losses no bound is known
        root = 1 / np.sqrt(np.abs(d * d - w * w + 1j * w * loss))
        h = root * np.sqrt(w) * weight
        if not np.max(root * (root @ stiff + w * (root @ lossy))) <= 0.5:
            return np.inf
    once = root * ((root * h) @ stiff + w * ((root * h) @ lossy))
    changed = np.sum(h * once, axis=1) + 2 * np.sum(once * once, axis=1)
    return float(np.max(changed) / np.max(np.sum(h * h, axis=1)))


def _sorted(modes: list[tuple[float, float, Array]], feedthrough: Array) -> Resonators:
    """Resonators by their frequency; modes of one frequency and one loss are as few as their parts in the ports."""
    result = Resonators(len(feedthrough), [], [], [], feedthrough)
    for d, loss, F in _merged(sorted(modes, key=lambda mode: mode[:2])):
        psi, kappa = _ratios(F)
        kind = result.modes if d else result.relaxations if loss else result.poles_at_zero
        kind.append(Resonator(kappa, psi, loss, kappa / d**2 if d else 0.0))
    return result


def _merged(modes: list[tuple[float, float, Array]]) -> Iterator[tuple[float, float, Array]]:
    start = 0
    for k in range(1, len(modes) + 1):
        (d, loss, _), (other, more, _) = modes[start], modes[min(k, len(modes) - 1)]
        if k < len(modes) and abs(other - d) <= _SAME * d and abs(more - loss) <= _SAME * loss:
            continue
        rows = np.array([F for _, _, F in modes[start:k]])
        if len(rows) > 1:
            _, s, Vh = svd(rows, full_matrices=False)
            rows = (s[:, None] * Vh)[s > len(rows) * EPS * s[0]]
        yield from ((d, loss, row) for row in rows)
        start = k


# --- by the transfer function ------------------------------------------------------------------------------------


def _refuse_complex_residues(given: PortRows) -> None:
    """Refuse a system of which a residue at a single damped pole is known, and is none of classical damping."""
    poles, left_vectors, right_vectors = eig(given.A, left=True)
    product = np.sum(left_vectors.conj() * right_vectors, axis=0)
    with np.errstate(all="ignore"):
        condition = 1.0 / np.abs(product)
        gap = np.abs(poles[:, None] - poles) + np.where(np.eye(len(poles)), np.inf, 0.0)
        error = len(poles) * EPS * np.linalg.norm(given.A) * condition * condition.max() / gap.min(axis=1)
        b, c = (left_vectors.conj().T @ given.B) / product[:, None], given.C @ right_vectors
        K: ComplexArray = np.einsum("pl,lm->lpm", c, b) * (2j * poles.imag / poles)[:, None, None]
    size = np.linalg.norm(K, axis=(1, 2))
    damped = (poles.imag > 0) & (poles.real < -_CERTAIN * _CERTAIN * np.abs(poles))
    seen = size > _CERTAIN * size[np.isfinite(size)].max(initial=0.0)
    if np.any(damped & seen & (np.linalg.norm(K.imag, axis=(1, 2)) > np.maximum(_CERTAIN, _SURELY * error) * size)):
        raise _not_classical()


def _not_classical() -> NotLosslessError:
    return NotLosslessError(
        [], "the damping of the system is not classical: its modes are not resonators "
        "kappa s/(s^2 + 2 zeta d s + d^2) side by side, so that it has no circuit of one branch for each; "
        "keep the netlist that it was read from, or take the nearest one of such modes, with their damping ratios: "
        "phc.modes(d, r, damping=zeta), or of data pem(data, structure='classical')",
    )  # fmt: skip


def _diagonal(through: Array) -> Array:
    if np.count_nonzero(through - np.diag(np.diag(through))):
        raise StructureError(
            "the feedthrough joins the ports, and a circuit of branches has one resistor at each port; its feedthrough "
            "is diagonal"
        )
    return np.diag(through)


def _of_responses(matrices: dict[str, Array], conversion: Conversion) -> Resonators:
    """Resonators with losses, side by side in Williamson coordinates; see `passive_form.classical_parts`."""
    if conversion.energy != "modal":
        raise _not_classical()
    G, J = matrices["G"], matrices["J"]
    k, d, losses = int(np.count_nonzero(J.any(axis=0))) // 2, np.diag(matrices["Q"]), np.diag(matrices["R"])
    resonators: list[Resonator] = []
    at_zero: list[Resonator] = []
    relaxations: list[Resonator] = []
    for row in range(k, 2 * k):
        psi, size = _ratios(G[row] - 1j * G[row - k])
        resonators.append(Resonator(d[row] * size, psi, losses[row] * d[row], size / d[row]))
    for row in range(2 * k, len(G)):
        psi, size = _ratios(G[row])
        (relaxations if losses[row] else at_zero).append(Resonator(size, psi, losses[row]))
    return Resonators(G.shape[1], resonators, at_zero, relaxations, _diagonal(matrices["S"] + matrices["N"]))

"""Modal truncation in the inner product of the energy: modes kept as they are, and what the others do statically.

Static deflections get dampers: lightly damped they would resonate where the system has no such resonance.

In coordinates `z` with the energy `|z|^2 / 2` a port-Hamiltonian system is `z' = (J - R) z + (G - P) u`, and its
projection on any subspace by an orthonormal basis is one too.  On an invariant subspace of `J - R` it keeps the poles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eig, eigh, qr, schur, svd
from scipy.linalg.lapack import dtrsen
from scipy.optimize import linear_sum_assignment

from .._checks import EPS
from .._types import Array, ComplexArray, Mask
from ..exceptions import StructureError
from ..modal.modal_form import ModalForm
from ..systems.passive_form import equations
from ..systems.port_hamiltonian import ph

_NEW = 1e-9  # of its length: what a static deflection has beside the modes, to be kept
_SAME = 1e-9  # of the largest: natural frequencies that are one

Parts = dict[str, Array]


@dataclass(frozen=True)
class Wanted:
    """Which modes to keep: at most so many states, in a band of natural frequencies, and static deflections beside."""

    order: int | None
    band: tuple[float, float] | None
    residual_modes: bool

    def chosen(self, d: Array, states: Array, weight: Array, extra: int) -> Mask:
        """Modes to keep of natural frequencies, numbers of states and weights, with room for so many other states."""
        low, high = self.band or (0.0, np.inf)
        kept = (d >= low) & (d <= high)
        if self.order is None:
            return np.asarray(kept, bool)
        room = self.order - extra
        chosen = np.zeros(len(d), bool)
        for k in np.lexsort((d, -weight)):
            if kept[k] and states[k] <= room:
                chosen[k] = True
                room -= states[k]
        return chosen


def with_unit_energy(parts: Parts) -> Parts:
    """The same system in coordinates in which the energy is `|z|^2 / 2`, without states that have none."""
    T, back, still = energy_basis(parts["Q"])
    rows = parts["sensor_rows"]
    if sees(rows, still, parts["Q"]).any():
        raise StructureError(
            "a sensor sees a state without energy, such as the position of a free mass, which no reduced model keeps; "
            "leave the sensor out"
        )
    moved = {name: T @ parts[name] @ T.T for name in ("J", "R")} | {name: T @ parts[name] for name in ("G", "P")}
    return parts | moved | {"Q": np.eye(len(T)), "sensor_rows": rows @ back}


def energy_basis(Q: Array) -> tuple[Array, Array, Array]:
    """Matrices `T`, `back`, `still`: `Q = T^T T`, `T back = 1`, and states of no energy, each column one.

    Told apart at unit diagonal, so that units of states do not matter: in SI stiffness and mobility are far apart.
    """
    scale = _scale(Q)
    energies, vectors = eigh(Q / np.outer(scale, scale))
    kept = energies > 64 * len(energies) * EPS * energies.max(initial=0.0)
    root, inverse = np.sqrt(energies[kept]), vectors / scale[:, None]
    return root[:, None] * vectors[:, kept].T * scale, inverse[:, kept] / root, inverse[:, ~kept]


def _scale(Q: Array) -> Array:
    diagonal = np.diag(Q)
    return np.asarray(np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))


def sees(rows: Array, still: Array, Q: Array) -> Mask:
    """Which rows see a state of no energy, by more than rounding."""
    reach = np.abs(rows / _scale(Q)).max(axis=1, initial=0.0)
    return np.asarray(np.abs(rows @ still).max(axis=1, initial=0.0) > 1e-9 * reach)


def projected(parts: Parts, V: Array) -> Parts:
    """A system of unit energy on the span of orthonormal columns."""
    moved = {name: V.T @ parts[name] @ V for name in ("J", "R")} | {name: V.T @ parts[name] for name in ("G", "P")}
    moved |= {"J": 0.5 * (moved["J"] - moved["J"].T), "R": 0.5 * (moved["R"] + moved["R"].T)}
    return parts | moved | {"Q": np.eye(V.shape[1]), "sensor_rows": parts["sensor_rows"] @ V}


def truncated(parts: Parts, wanted: Wanted) -> Parts:
    """Modes of a system of unit energy, and one or two states for the static deflections of each port."""
    F, B, C, _ = equations(parts)
    static = _static_deflections(F, B) if wanted.residual_modes else np.zeros((len(F), 0))
    if wanted.order is not None and static.shape[1] + 2 > wanted.order:
        static = static[:, :0]
    T, Z = schur(F, output="real")
    select = _selected(T, Z.T @ B, C @ Z, wanted, static.shape[1])
    count = int(select.sum())
    V = np.zeros((len(F), 0))
    if count:
        V = dtrsen(select, T, Z, job="N", lwork=len(F))[1][:, :count]
    deflections, motions = np.hsplit(static, 2)
    shapes = _beside(V, deflections)
    moving = _beside(np.hstack([V, shapes]), motions)
    V = np.hstack([V, shapes, moving])
    if not V.shape[1]:
        raise StructureError(_nothing(wanted))
    if parts["R"].any():
        parts = parts | {"R": parts["R"] + _damping(F, shapes, moving)}
    return projected(parts, V)


def _damping(F: Array, shapes: Array, moving: Array) -> Array:
    """Dampers at the velocities of static deflections, of the damping ratio without a resonance.

    The deflections under constant forces do not feel them.
    """
    U, frequencies, _ = svd(moving.T @ F @ shapes, full_matrices=False)
    U = moving @ U
    return np.asarray(np.sqrt(2.0) * (U * frequencies) @ U.T)


def _nothing(wanted: Wanted) -> str:
    if wanted.band is not None:
        return f"the system has no natural frequency in the band {wanted.band}; widen it"
    return f"no mode has {wanted.order} state or fewer; allow order=2"


def _static_deflections(F: Array, B: Array) -> Array:
    """Solutions `F x = B`, `F^2 x = B`: the response at zero frequency and its first derivative."""
    k = np.linalg.svd(F, compute_uv=False)
    if not k[-1] > len(F) * EPS * k[0]:
        return np.zeros((len(F), 0))  # a free body has none
    first = np.linalg.solve(F, B)
    both = np.hstack([first, np.linalg.solve(F, first)])
    return np.asarray(both / np.maximum(np.linalg.norm(both, axis=0), np.finfo(float).tiny), float)


def _beside(V: Array, static: Array) -> Array:
    """Orthonormal directions of static deflections that the modes do not have."""
    for _ in range(2):
        static = static - V @ (V.T @ static)
    U, s, _ = svd(static, full_matrices=False)
    new = U[:, s > _NEW]
    if new.shape[1]:
        new = qr(new - V @ (V.T @ new), mode="economic")[0]
    return np.asarray(new, float)


def _selected(T: Array, B: Array, C: Array, wanted: Wanted, extra: int) -> Mask:
    """Rows of a real Schur form whose modes are kept, by the height of their resonances."""
    eigenvalues, left_vectors, right_vectors = eig(T, left=True, right=True)
    with np.errstate(all="ignore"):
        norm = np.abs(np.sum(left_vectors.conj() * right_vectors, axis=0))
        height = np.linalg.norm(C @ right_vectors, axis=0) * np.linalg.norm(left_vectors.conj().T @ B, axis=1) / norm
        height = height / np.abs(eigenvalues.real)
    height = np.where(np.isfinite(height), height, np.inf)
    poles = np.diag(T).astype(complex)
    pairs = np.flatnonzero(np.diag(T, -1))
    beside = np.sqrt(np.abs(T[pairs, pairs + 1] * T[pairs + 1, pairs]))
    poles[pairs] += 1j * beside
    poles[pairs + 1] -= 1j * beside
    # eigenvalues may come in another order than in the form
    height = height[linear_sum_assignment(np.abs(poles[:, None] - eigenvalues))[1]]
    first = np.flatnonzero(poles.imag >= 0)
    states = np.where(poles.imag[first] > 0, 2, 1)
    chosen = wanted.chosen(np.abs(poles[first]), states, height[first], extra)
    select = np.zeros(len(poles), bool)
    for k in first[chosen]:
        select[k : k + (2 if poles[k].imag > 0 else 1)] = True
    return select


# --- lossless -----------------------------------------------------------------------------------------------------


def lossless_truncated(modes: ModalForm, wanted: Wanted) -> tuple[ModalForm, float]:
    """Modes of a lossless system and stiff ones beside, and the largest difference over the band.

    Below the modes left out their sum, less its part in the stiff modes, grows with frequency (Gauss quadrature), and
    above them it falls: the band ends with the largest values.
    """
    m = modes.nports
    weight = np.linalg.norm(modes.nu, axis=1) ** 2
    d = np.concatenate([np.zeros(len(modes.rigid)), modes.d])
    states = np.full(len(d), 2)
    size = np.concatenate([np.full(len(modes.rigid), np.inf), weight])
    extra = 2 * m if wanted.residual_modes and (wanted.order is None or wanted.order >= 2 * m + 2) else 0
    kept = wanted.chosen(d, states, size, extra)
    rigid, elastic = kept[: len(modes.rigid)], kept[len(modes.rigid) :]
    if not kept.any():
        raise StructureError(_nothing(wanted))
    low, high = wanted.band or (0.0, float(modes.d[elastic].max(initial=0.0)))
    omitted = ~elastic
    above = omitted & (modes.d > high * (1 + _SAME))
    stiff = _stiff_modes(modes.d[above], modes.nu[above]) if extra and above.any() else None
    d_kept, nu_kept = modes.d[elastic], modes.nu[elastic]
    if stiff is not None:
        d_kept, nu_kept = np.append(d_kept, stiff.d), np.concatenate([nu_kept, stiff.nu])
    bound = 0.0
    below = omitted & (modes.d < low * (1 - _SAME))
    if (omitted & ~above & ~below).any() or (not rigid.all() and low == 0):
        bound = np.inf
    elif high > 0:
        tail = _value(modes.d[above], modes.nu[above], high, m)
        if stiff is not None:
            tail = tail - _value(stiff.d, stiff.nu, high, m)
        bound = float(np.linalg.norm(tail, 2))
        if below.any() or not rigid.all():
            lost = ModalForm(modes.d[below], modes.nu[below], modes.rigid[~rigid])
            bound += float(np.linalg.norm(np.atleast_2d(lost.freqresp(low).reshape(m, m)), 2))
    return ModalForm(d_kept, nu_kept, modes.rigid[rigid]), bound


def _value(d: Array, nu: ComplexArray, w: float, m: int) -> ComplexArray:
    if not len(d):
        return np.zeros((m, m), complex)
    value: ComplexArray = np.asarray(ModalForm(d, nu, np.zeros((0, m))).freqresp(w), complex).reshape(m, m)
    return value


def _stiff_modes(d: Array, nu: ComplexArray) -> ModalForm:
    """Modes of the static deflections of modes left out, as many as ports."""
    weighted = np.sqrt(d)[:, None] * nu
    B: Array = np.concatenate([weighted.real, weighted.imag])
    n = len(d)

    def solved(X: Array) -> Array:
        return np.concatenate([-X[n:] / d[:, None], X[:n] / d[:, None]])

    first = solved(B)
    both = np.hstack([first, solved(first)])
    U, s, _ = svd(both / np.maximum(np.linalg.norm(both, axis=0), np.finfo(float).tiny), full_matrices=False)
    V = U[:, s > _NEW * s[0]]
    moved = np.concatenate([d[:, None] * V[n:], -d[:, None] * V[:n]])
    J = V.T @ moved
    return ph(np.eye(V.shape[1]), V.T @ B, J=0.5 * (J - J.T)).modes

"""From any passive system to a port-Hamiltonian one, `D` being what it is.

What is known of the energy decides its form: matrices that show a mass and a stiffness keep them, symmetric residues
with classical damping are resonators side by side, and any other system gets the storage that is asked for.

Matrices of `q' = E v`, `v' = -M^-1 E^T K q - M^-1 C v + M^-1 F u`, `y = F^T v` have the energy
`q^T K q / 2 + v^T M v / 2`.  With `E = I` the states are positions and velocities; with momenta in place of velocities
`E` is the inverse of the mass, and stands for `M` too.  Residues of classical damping are those of

    G(s) = D + sum_l K_l s / (s^2 + 2 zeta_l d_l s + d_l^2) + sum_l K_l / (s + a_l),    K_l real symmetric, >= 0
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import control as ct
import numpy as np
from scipy.linalg import LinAlgError, block_diag, eig, eigh, svd
from slycot import sb03od
from slycot.exceptions import SlycotError, SlycotResultWarning

from .. import _checks
from .._checks import EPS
from .._types import Array, ArrayLike, ComplexArray, PortPairs
from ..exceptions import ConditioningWarning, NotLosslessError, NotPassiveError, StructureError
from ..modal.general_form import GeneralModalForm
from ..modal.modal_form import Cluster
from ..modal.positive_real import (
    Matrices,
    Passivity,
    ResponseError,
    Split,
    is_positive,
    split_axis,
    violations,
    well_conditioned,
)  # fmt: skip
from ..modal.storage import KnownDirections, dissipation, semidefinite, storage_coordinates
from ..numerics.invariant_subspaces import EliminationResolvent, SchurResolvent, equilibrated

Parts = dict[str, Array]

_UNSEEN = 1e-13  # of the largest Hankel singular value: a state that ports do not reach or do not see
_AGREES, _LOST = 1e-10, 1e-4  # of the largest response: a difference that is worth a warning, and one that is an error
_GIVEN = 4.0  # roundings of each entry that is given
_EXACT = 1e-11  # of it: what a form that was recognised may differ by
_CERTAIN = 1e4  # roundings, times the number of states: losses beyond doubt
_BESIDE = np.array([0.31, 0.93, 2.9])  # of the median of the poles: where they are looked for
_SURE = 16.0  # roundings, times the size of matrices: what is missed by rounding alone
_FITS = 1e-11  # of its terms: what matrices may miss of the form
_NEW = 1e-7  # of its length: what a direction has outside the known ones, to be a new one
_CONDITION = 1e8  # of the modes: beyond, poles are not parted
_FEW = 60  # states up to which each point is solved by elimination
_SAME = 1e-8  # of the largest: poles that are one
_RESIDUE = 1e-9  # of its size: what a residue may miss of the form, before the response decides
_NONE = 1e-13  # of the largest: an eigenvalue of a residue that is 0


@dataclass(frozen=True)
class Conversion:
    """Record of how a port-Hamiltonian system was made of another.

    Attributes
    ----------
    energy : {"given", "modal", "available", "required", "mean"}
        Whose energy it has: that of the matrices, that of its classically damped modes, or a storage of its ports.
    hidden : int
        States that were left out because ports do not reach or do not see them.
    error : float
        Largest difference of the transfer functions over that of the given one, over the band of its poles.
    """

    energy: str
    hidden: int
    error: float


@dataclass(frozen=True)
class PortRows:
    """Matrices of a system whose first outputs are those of its ports, in the order of its inputs, before sensors.

    `error` bounds that of the response beyond roundings of the matrices.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    error: ResponseError | None = None

    @property
    def ports(self) -> int:
        """Number of ports."""
        return self.B.shape[1]


def in_port_order(sys: ct.StateSpace, pairs: PortPairs) -> ct.StateSpace:
    """The system with the outputs of its ports first, each in the place of its input; the others follow as sensors."""
    p, m = sys.noutputs, sys.ninputs
    port_pairs = _checks.port_pairs(pairs, sys.output_labels, sys.input_labels)
    outputs, inputs = [output for output, _ in port_pairs], [entry for _, entry in port_pairs]
    missing = sorted(set(range(m)) - set(inputs))
    if missing:
        raise StructureError(
            f"ports={_checks.shown(pairs)} has no output for input {missing[0]} ({sys.input_labels[missing[0]]!r}); "
            "each input needs the output at its port, or leave the input out with sys[:, inputs]"
        )
    outputs += [k for k in range(p) if k not in outputs]
    A, B, C, D = (np.array(getattr(sys, name), float) for name in "ABCD")
    names = {} if sys._generic_name_check() else {"name": sys.name}
    return ct.ss(
        A, B[:, inputs], C[outputs], D[np.ix_(outputs, inputs)], **names,
        inputs=[sys.input_labels[k] for k in inputs], outputs=[sys.output_labels[k] for k in outputs],
    )  # fmt: skip


def passive_parts(
    given: PortRows, storage: str, refusal: NotLosslessError | None, *, minimal: bool = False
) -> tuple[Parts, Conversion]:
    """Parts of a `DissipativePortHamiltonian` with the transfer function of a passive system.

    If `minimal`, without the states that ports do not reach or do not see, even where the matrices show a mass.

    Raises
    ------
    NotPassiveError
        If there is none, with the bands; `refusal` says why the system is not lossless.
    StructureError
        If sensors see what ports do not, or rounding hides that the system is passive.
    """
    _checks.in_range("the matrices", np.concatenate([M.ravel() for M in (given.A, given.B, given.C, given.D)]))
    with well_conditioned("convert"):
        return _passive_parts(given, storage, refusal, minimal)


def hides_states(given: PortRows) -> bool:
    """Whether ports do not reach or do not see a state."""
    with well_conditioned("convert"):
        split = split_axis(given.A, given.B, given.C)
        axis = [(w, K[: given.ports]) for w, K in _met_by_ports(split.axis, given)]
        if not all(np.isfinite(K).all() for _, K in axis):
            return True  # a pole at 0 that is not simple, which ports alone do not see
        # at 0 a state, elsewhere a pair of them for each direction of the residue
        met = sum((2 if w else 1) * len(_factors(K)[0]) for w, K in axis)
        return met + len(minimal_part(*split.rest, given.ports)[0]) < len(given.A)


def _passive_parts(
    given: PortRows, storage: str, refusal: NotLosslessError | None, minimal: bool
) -> tuple[Parts, Conversion]:
    physical = physical_parts(given) if storage == "auto" and not minimal else None
    if physical is not None:
        parts, passive = physical
        error = _GivenResponse(given, np.linalg.eigvals(given.A)).difference(parts, same_states=True)
        if error <= _EXACT:
            if not passive:
                _refuse_active(split_axis(given.A, given.B, given.C), given, refusal)
            return parts, Conversion("given", 0, error)
    m, D = given.ports, given.D
    split = split_axis(given.A, given.B, given.C)
    singular = _refuse_active(split, given, refusal)
    response = _GivenResponse(
        given, np.concatenate([np.linalg.eigvals(split.rest[0]), [1j * w for w, _ in split.axis]])
    )
    if minimal:
        split = replace(split, axis=_met_by_ports(split.axis, given), rest=minimal_part(*split.rest, m))
    modal = classical_parts(*split.rest, D, split.axis) if storage == "auto" and len(D) == m else None
    if modal is not None and (error := response.difference(modal)) <= _EXACT:
        parts, energy = modal, "modal"
    else:
        energy = "mean" if storage == "auto" else storage
        stored = stored_parts(PortRows(*split.rest, D), energy, singular)
        parts = joined([stored, *lossless_parts(split.axis, m)], D[m:])
        error = response.difference(parts)
    if minimal:
        response.refuse_lost_sensors(parts)
    if not error <= _LOST:
        raise StructureError(
            f"the system is too ill-conditioned to convert: its port-Hamiltonian form differs from it by {error:.2g} "
            f"of its largest response, allowed {_LOST:.0e}; give it in better scaled states, or with fewer"
        )
    if error > _AGREES:
        warnings.warn(
            f"the port-Hamiltonian form has {-np.log10(error):.0f} digits of the transfer function: the given matrices "
            "are ill-conditioned, or have states that ports hardly reach or see",
            ConditioningWarning,
            stacklevel=5,
        )
    return parts, Conversion(energy, len(given.A) - len(parts["Q"]), error)


# --- is it lossless? ----------------------------------------------------------------------------------------------


def loses_energy(sys: ct.StateSpace) -> bool:
    """Whether `G + G^H` is surely not 0 at some frequency, so that the system is not lossless: O(n^3), with no doubt.

    False where it is not sure.
    """
    A, B, C, D = (np.asarray(getattr(sys, name), float) for name in "ABCD")
    if not len(A) or len(D) != len(D.T) or not all(np.isfinite(M).all() for M in (A, B, C, D)):
        return False
    with np.errstate(all="ignore"):
        try:
            rate = float(np.median(np.abs(np.linalg.eigvals(A))))
        except LinAlgError:
            return False  # numbers at the end of the range of doubles
        solver = EliminationResolvent(A)
        points = 1j * rate * _BESIDE
        for x, y in zip(solver.columns(points, B), solver.rows(points, C), strict=True):
            G, (x, y) = C @ x + D, (np.abs(x), np.abs(y))
            rounding = EPS * (y @ (np.abs(A) @ x + np.abs(B)) + np.abs(C) @ x + np.abs(D))
            if np.any(np.abs(G + G.conj().T) > _CERTAIN * len(A) * (rounding + rounding.T)):
                return True
    return False


# --- is it passive? -----------------------------------------------------------------------------------------------


def _refuse_active(split: Split, given: PortRows, refusal: NotLosslessError | None) -> Array:
    """Refuse a system whose ports give energy; the frequencies at which `G + G^H` of the others is singular."""
    m, (A, B, C) = given.ports, split.rest
    D = given.D[:m]
    ports = Split([(w, K[:m]) for w, K in split.axis], (A, B, C[:m]), split.unstable)
    matrices = given.A, given.B, given.C[:m], D
    tested = None
    if not len(split.unstable):
        tested = Passivity((*ports.rest, D), scattering=False, given=matrices, error=given.error)
    bands = violations(ports, tested, scattering=False)
    if not bands and tested is not None:
        return tested.singular
    sentences = refusal.violations if refusal is not None and not len(A) and not D.any() else ()
    raise NotPassiveError(
        [(band.low, band.high) for band in bands], [band.excess for band in bands], [band.worst for band in bands],
        [complex(p) for p in split.unstable], signs=_signs(ports, matrices), reasons=sentences,
    )  # fmt: skip


def _signs(split: Split, given: Matrices) -> tuple[int, ...]:
    """Signs of the outputs with which the system is passive, if all others or one other than given make it so."""
    D = given[3]
    m = len(D)
    if len(split.unstable):
        return ()
    for signs in [-np.ones(m), *(np.ones(m) - 2 * row for row in np.eye(m) if m > 1)]:
        A, B, C = split.rest
        turned = Split([(w, signs[:, None] * K) for w, K in split.axis], split.rest, split.unstable)
        matrices = *given[:2], signs[:, None] * given[2], signs[:, None] * D
        tested = Passivity((A, B, signs[:, None] * C, matrices[3]), scattering=False, given=matrices)
        if all(is_positive(K) for _, K in turned.axis) and tested.is_passive():
            return tuple(int(sign) for sign in signs)
    return ()


# --- the storage of the ports -------------------------------------------------------------------------------------


def stored_parts(system: PortRows, storage: str, singular: Array | None = None) -> Parts:
    """The system in coordinates in which the storage that is asked for is the unit matrix.

    `singular` are the frequencies at which `G + G^H` is singular, where they are known.
    """
    m = system.ports
    rate = float(np.linalg.norm(system.A)) or 1.0
    root = np.sqrt(rate)
    A, B, C = minimal_part(system.A / rate, system.B / root, system.C / root, m)
    D, n = system.D[:m], len(A)
    size = float(np.linalg.norm(D)) + float(np.linalg.norm(B)) * float(np.linalg.norm(C[:m])) or 1.0
    level = np.sqrt(size)
    B, C, D = B / level, C / level, D / size
    if n:
        coordinates = storage_coordinates(A, B, C[:m], D, storage, None if singular is None else singular / rate)
        A, B, C = coordinates.T @ A @ coordinates.inverse, coordinates.T @ B, C @ coordinates.inverse
    W = 0.5 * semidefinite(dissipation(A, B, C[:m], D), n)
    gain = level * root
    return {
        "Q": np.eye(n), "J": 0.5 * rate * (A - A.T), "R": rate * W[:n, :n], "G": 0.5 * gain * (C[:m].T + B),
        "P": gain * W[:n, n:], "S": size * W[n:, n:], "N": 0.5 * size * (D - D.T), "sensor_rows": gain * C[m:],
        "sensor_feedthrough": system.D[m:],
    }  # fmt: skip


def _met_by_ports(axis: list[tuple[float, ComplexArray]], given: PortRows) -> list[tuple[float, ComplexArray]]:
    """Poles on the axis whose residue at the ports is more than rounding."""
    m = given.ports
    _, B, C = equilibrated(given.A, given.B, given.C)
    unseen = _UNSEEN * float(np.linalg.norm(B) * np.linalg.norm(C[:m]))
    return [(w, K) for w, K in axis if not np.linalg.norm(K[:m]) <= unseen]


def minimal_part(A: Array, B: Array, C: Array, m: int) -> tuple[Array, Array, Array]:
    """Balanced coordinates of what ports reach and see, by the Hankel singular values of the first m outputs."""
    if not len(A):
        return A, B, C
    rate = float(np.linalg.norm(A)) or 1.0
    unit = np.sqrt(rate)
    A, B, C = A / rate, B / unit, C / unit
    seen, reached = gramian_root(A, C[:m]), gramian_root(A.T, B.T).T
    U, s, V = svd(seen @ reached)
    kept = s > _UNSEEN * max(s[0], np.finfo(float).tiny)
    root = np.sqrt(s[kept])
    from_balanced, to_balanced = reached @ V[kept].T / root, (U[:, kept] / root).T @ seen
    return rate * (to_balanced @ A @ from_balanced), unit * (to_balanced @ B), unit * (C @ from_balanced)


def gramian_root(A: Array, C: Array) -> Array:
    """Upper triangular `U` with the observability Gramian `U^T U`."""
    n = len(A)
    if len(C) > n:
        C = np.asarray(np.linalg.qr(C, mode="r"), float)
    rows = np.zeros((n, n), order="F")
    rows[: len(C)] = C
    with warnings.catch_warnings():
        warnings.simplefilter("error", SlycotResultWarning)
        try:
            U, scale, _ = sb03od(n, len(C), np.array(A, order="F"), np.zeros((n, n), order="F"), rows, "C")
        except (SlycotError, SlycotResultWarning):
            raise LinAlgError("a pole is unstable by rounding") from None
    return np.asarray(np.triu(U[:n, :n]) / scale, float)


# --- parts --------------------------------------------------------------------------------------------------------


def lossless_parts(axis: Sequence[tuple[float, ComplexArray]], m: int) -> list[Parts]:
    """Modes of poles on the axis, whose residues are Hermitian positive semidefinite, as parts for `joined`."""
    return [_side_by_side(_axis_modes(axis, m), np.zeros((m, m)))] if axis else []


def joined(members: Sequence[Parts], through: Array) -> Parts:
    """Parallel connection of parts, with the feedthrough of the sensors."""
    parts = {name: block_diag(*(member[name] for member in members)) for name in ("Q", "J", "R")}
    n = len(parts["Q"])
    parts = {name: matrix.reshape(n, n) for name, matrix in parts.items()}
    parts |= {name: np.vstack([member[name] for member in members]) for name in ("G", "P")}
    parts |= {name: np.sum([member[name] for member in members], axis=0) for name in ("S", "N")}
    sensor_rows = np.hstack([member["sensor_rows"] for member in members])
    return parts | {"sensor_rows": sensor_rows, "sensor_feedthrough": through}


def equations(parts: Parts) -> tuple[Array, Array, Array, Array]:
    """`A`, `B`, `C` and `D` of a system, the outputs of its ports before those of its sensors."""
    Q, G, P = parts["Q"], parts["G"], parts["P"]
    C, D = (G + P).T @ Q, parts["S"] + parts["N"]
    through = np.vstack([D, parts["sensor_feedthrough"]])
    return (parts["J"] - parts["R"]) @ Q, G - P, np.vstack([C, parts["sensor_rows"]]), through


# --- held against what was given ----------------------------------------------------------------------------------


class _GivenResponse:
    """Response of the given system in its band, with what roundings of the given entries make of it."""

    def __init__(self, given: PortRows, poles: ArrayLike) -> None:
        self.given, self.points = given, np.asarray(1j * _band(np.asarray(poles, complex)), complex)
        resolvent = _resolvent(given.A)
        A, B, C = given.A, given.B, given.C
        self.into, self.out = resolvent.columns(self.points, B), resolvent.rows(self.points, C)
        self.values = C @ self.into + given.D
        x, y = np.abs(self.into), np.abs(self.out)
        moved = y @ (np.abs(A) @ x) + y @ np.abs(B) + np.abs(C) @ x
        lost = np.linalg.norm(x, axis=1, keepdims=True) * np.linalg.norm(y, axis=2, keepdims=True) * resolvent.rounding
        self.rounding = _GIVEN * EPS * moved + lost

    def difference(self, parts: Parts, *, same_states: bool = False) -> float:
        """Largest difference of a form beyond these roundings, over the largest response."""
        off, size = self._differences(parts, same_states)
        return _ratio(off.max(initial=0.0), size.max(initial=0.0))

    def refuse_lost_sensors(self, parts: Parts) -> None:
        """Refuse to leave out states that a sensor sees."""
        m = self.given.ports
        for k, (off, size) in enumerate(zip(*self._differences(parts), strict=True)):
            if k >= m and not _ratio(off, size) <= _LOST:
                raise StructureError(
                    f"sensor {k - m} (output {k}) sees states that ports do not reach or do not see: without them its "
                    f"response differs by {_ratio(off, size):.2g} of its largest value, allowed {_LOST:.0e}; leave the "
                    "sensor out, or keep all states"
                )

    def _differences(self, parts: Parts, same_states: bool = False) -> tuple[Array, Array]:
        """Largest difference of each output beyond the roundings, and its largest response."""
        given, (A, B, C, D) = self.given, equations(parts)
        with np.errstate(invalid="ignore", over="ignore"):
            if same_states:  # the difference of matrices that nearly agree, to first order
                change = self.out @ ((A - given.A) @ self.into + B - given.B) + (C - given.C) @ self.into + D - given.D
            else:
                change = C @ _resolvent(A).columns(self.points, B) + D - self.values
            off = np.max(np.abs(change) - self.rounding, axis=2, initial=0.0)
        clear = np.isfinite(off).all(axis=1)  # not at a pole
        return off[clear].max(axis=0, initial=0.0), np.abs(self.values[clear]).max(axis=(0, 2), initial=0.0)


def _resolvent(A: Array) -> SchurResolvent | EliminationResolvent:
    return EliminationResolvent(A) if len(A) <= _FEW else SchurResolvent(A)


def _ratio(off: float, size: float) -> float:
    return float(off / size if size else off)


def _band(poles: ComplexArray) -> Array:
    """Frequencies between and beside poles, and at those that are damped by more than rounding."""
    size = np.abs(poles)
    size = size[size > np.sqrt(EPS) * size.max(initial=0.0)] if size.any() else np.ones(1)
    damped = poles[np.abs(poles.real) > 1e-6 * np.abs(poles)]
    near = np.abs(damped.imag[:, None] + damped.real[:, None] * [-1.0, 0.0, 1.0]).ravel()
    # off the frequencies themselves, at which an undamped system has no response
    even = np.geomspace(size.min() / 31, size.max() * 29, 61)
    return np.unique(np.concatenate([even, near]))


# --- mass and stiffness ----------------------------------------------------------------------------------------


def physical_parts(given: PortRows) -> tuple[Parts, bool] | None:
    """Parts of a `DissipativePortHamiltonian` in the given coordinates, or None where they show no mass.

    And whether the given matrices are passive but for rounding, so that nothing else need be asked of them.
    """
    A, B, C, D = given.A, given.B, given.C, given.D
    n, m = B.shape
    if n % 2 or not n or not B.any():
        return None
    k = n // 2
    for order in (np.arange(n), np.roll(np.arange(n), k)):
        a, b, c = A[np.ix_(order, order)], B[order], C[:, order]
        if a[:k, :k].any() or b[:k].any() or c[:m, :k].any():
            continue
        energy = _energy(a[:k, k:], a[k:, :k], a[k:, k:], b[k:], c[:m, k:])
        if energy is not None:
            back = np.argsort(order)
            parts = _of_second_order(energy.K, energy.M, a[:k, k:], a[k:, k:], b[k:], D[:m])
            square = {name: parts[name][np.ix_(back, back)] for name in ("Q", "J", "R")}
            through = eigh(D[:m] + D[:m].T, eigvals_only=True)
            passive = energy.missed <= _SURE * k * EPS and through[0] >= -_SURE * m * EPS * np.abs(through).max()
            return parts | square | {
                "G": parts["G"][back], "P": parts["P"][back], "sensor_rows": C[m:].copy(), "sensor_feedthrough": D[m:]
            }, bool(passive)  # fmt: skip
    return None


class _SecondOrder(NamedTuple):
    """Stiffness and mass matrices, and what the given ones miss of symmetry and of signs, over their sizes."""

    K: Array
    M: Array
    missed: float


def _energy(E: Array, F: Array, damping: Array, b: Array, c: Array) -> _SecondOrder | None:
    """Stiffness `K` and mass `M` of `q' = E v`, `v' = F q + damping v + b u`, `y = c v`."""
    if not np.linalg.cond(E) < 1 / np.sqrt(EPS):
        return None
    for M in _masses(E, F, damping, b, c):
        if M is None or not _is_positive(M):
            continue
        K = -np.linalg.solve(E.T, M @ F)
        loss = -0.5 * (M @ damping + damping.T @ M)
        size = np.linalg.norm(M, 2) * np.linalg.norm(damping, 2)
        least = eigh(loss, eigvals_only=True)[0]
        stiff = eigh(0.5 * (K + K.T), eigvals_only=True)
        missed = max(
            _ratio(float(off), float(whole)) for off, whole in (
                (np.linalg.norm(K - K.T), np.linalg.norm(K)), (max(-stiff[0], 0.0), max(stiff[-1], 0.0)),
                (max(-least, 0.0), size), (np.linalg.norm(M @ b - c.T), np.linalg.norm(c)),
            )
        )  # fmt: skip
        if missed <= _FITS:
            return _SecondOrder(0.5 * (K + K.T), M, missed)
    return None


def _masses(E: Array, F: Array, damping: Array, b: Array, c: Array) -> list[Array | None]:
    """Candidates of the mass matrix: that of momenta, of unit mass, lumped, and that which the ports determine."""
    momenta = 0.5 * (E + E.T) if np.linalg.norm(E - E.T) <= _FITS * np.linalg.norm(E) else None
    if momenta is not None and np.linalg.norm(momenta - np.eye(len(E))) == 0:
        momenta = None
    return [momenta, np.eye(len(E)), _lumped(F @ E, b, c), _determined(F @ E, damping, b, c)]


def _lumped(stiffness: Array, b: Array, c: Array) -> Array | None:
    """The diagonal `M` with `M b = c^T` and `M stiffness` symmetric, followed from mass to mass."""
    mass = np.zeros(len(b))
    known = np.abs(b).max(axis=1) > 0
    mass[known] = np.sum(c.T * b, axis=1)[known] / np.sum(b * b, axis=1)[known]
    front = list(np.flatnonzero(known))
    while front:
        k = front.pop()
        new = np.flatnonzero(~known & (stiffness[k] != 0) & (stiffness[:, k] != 0))
        known[new] = True
        mass[new] = mass[k] * stiffness[k, new] / stiffness[new, k]
        front += list(new)
    return np.diag(mass) if np.isfinite(mass).all() and mass.all() else None


def _determined(stiffness: Array, damping: Array, b: Array, c: Array) -> Array | None:
    """The symmetric `M` with `M b = c^T`, `M F` and `M damping` symmetric, by all directions that follow from `b`."""
    known = KnownDirections(np.zeros((len(b), 0)), np.zeros((len(b), 0)))
    maps = [M / (np.linalg.norm(M, 2) or 1.0) for M in (stiffness, damping)]
    new, value = b / (np.linalg.norm(b, 2) or 1.0), c.T / (np.linalg.norm(b, 2) or 1.0)
    count = -1
    while known.V.shape[1] > count:
        count = known.V.shape[1]
        known = known.with_directions(new, value, _NEW)
        V, Y = known.V[:, count:], known.Y[:, count:]
        new, value = np.hstack([M @ V for M in maps]), np.hstack([M.T @ Y for M in maps])
    M = known.Y @ known.V.T
    return 0.5 * (M + M.T) if count == len(b) else None


def _is_positive(M: Array) -> bool:
    k = eigh(M, eigvals_only=True)
    return bool(k[0] > EPS * len(M) * k[-1])


def _of_second_order(K: Array, M: Array, E: Array, damping: Array, b: Array, D: Array) -> dict[str, Array]:
    k, m = b.shape
    inverse = np.linalg.inv(M)
    inverse = 0.5 * (inverse + inverse.T)
    lower = damping @ inverse
    zero = np.zeros((k, k))
    J = np.block([[zero, E @ inverse], [-(E @ inverse).T, 0.5 * (lower - lower.T)]])
    R = _not_negative(-0.5 * (lower + lower.T))
    return {
        "Q": np.block([[_not_negative(K), zero], [zero, M]]), "J": J, "R": np.block([[zero, zero], [zero, R]]),
        "G": np.vstack([np.zeros((k, m)), b]), "P": np.zeros((2 * k, m)), "S": _not_negative(0.5 * (D + D.T)),
        "N": 0.5 * (D - D.T),
    }  # fmt: skip


def _not_negative(M: Array) -> Array:
    """The matrix itself, or without what rounding has made negative."""
    k, U = eigh(M)
    if k[0] >= 0:
        return M
    part = (U * np.maximum(k, 0.0)) @ U.T
    return np.asarray(0.5 * (part + part.T), float)


# --- classical damping -----------------------------------------------------------------------------------------


class _PassiveMode(NamedTuple):
    """A mode and its part in the ports (m,) and in the sensors (k,).

    A resonator has a frequency `d` and a damping ratio, a relaxation no frequency and a rate.
    """

    d: float
    loss: float
    psi: ComplexArray
    sensed: ComplexArray


def classical_parts(
    A: Array, B: Array, C: Array, D: Array, axis: Sequence[tuple[float, ComplexArray]]
) -> dict[str, Array] | None:
    """Parts of a `DissipativePortHamiltonian` in Williamson coordinates, or None where the damping is not classical."""
    modes = _of_modes(A, B, C) if len(A) else []
    return None if modes is None else _side_by_side([*_axis_modes(axis, D.shape[1]), *modes], D)


def parts_of_resonators(form: GeneralModalForm) -> Parts | None:
    """Parts of modes each of which is a resonator or a relaxation by itself, of as many outputs as inputs, or None.

    Such modes are passive however close they are; none is parted from another.
    """
    if form.noutputs != form.ninputs or form.feedthrough.any() or not form.n:
        return None
    resonators, damped = [], form.single
    _, shapes, participation = damped._both_halves
    residues = shapes[:, :, None] * participation[:, None, :]
    real: list[tuple[float, ComplexArray]] = []
    for p, residue in zip(damped.poles, residues, strict=True):
        if p.imag > 0:
            resonators.append((abs(p), -p.real / abs(p), residue * (2j * p.imag / p)))
        elif p.imag == 0:
            real.append((-p.real, residue))
    for block in form.clusters:
        square = float(np.linalg.det(block.A)) if len(block.A) == 2 and _no_response_at_zero(block) else 0.0
        if not square > 0:
            return None
        d = float(np.sqrt(square))
        resonators.append((d, -0.5 * float(np.trace(block.A)) / d, (block.C @ block.B).astype(complex)))
    modes = []
    for resonator in resonators:
        mode = _resonator(*resonator)
        if mode is None:
            return None
        modes.append(mode)
    relaxations = _of_real_poles(real) if all(rate >= 0 for rate, _ in real) else None
    return None if relaxations is None else _side_by_side([*modes, *relaxations], form.feedthrough)


def _resonator(d: float, zeta: float, K: ComplexArray) -> _PassiveMode | None:
    """Mode of the response `K s / (s^2 + 2 zeta d s + d^2)`, or None where this is not passive."""
    size = _GIVEN * EPS * np.linalg.norm(K)
    if not zeta >= 0 or np.linalg.norm(K - K.T) > size or np.linalg.norm(K.imag) > size:
        return None
    sigma, W = eigh(K.real)
    if sigma[0] < -size:
        return None
    row = np.sqrt(np.maximum(sigma[-1], 0.0)) * W[:, -1]
    return _PassiveMode(d, zeta, 1j * row * np.sign(row[np.abs(row).argmax()] or 1.0), np.zeros(0, complex))


def _no_response_at_zero(block: Cluster) -> bool:
    """Whether a pair of poles that are not parted is a resonator, `C A^-1 B = 0`."""
    try:
        x = np.linalg.solve(block.A, block.B)
    except np.linalg.LinAlgError:
        return False
    return bool(np.linalg.norm(block.C @ x) <= 8 * _GIVEN * EPS * np.linalg.norm(block.C) * np.linalg.norm(x))


def _axis_modes(axis: Sequence[tuple[float, ComplexArray]], m: int) -> list[_PassiveMode]:
    modes: list[_PassiveMode] = []
    for w, K in axis:
        sigma, W = _factors(K[:m])
        # the mode with the weight on the momenta, where it has a choice
        rows = (1j * np.sqrt(2 * sigma) if w else np.sqrt(sigma))[:, None] * W.T
        sensed = (2 * np.sqrt(w) if w else 1.0) * K[m:] @ (rows / np.sum(np.abs(rows) ** 2, axis=1, keepdims=True)).T
        modes += [_PassiveMode(w, 0.0, *parts) for parts in zip(rows, sensed.T, strict=True)]
    return modes


def _of_modes(A: Array, B: Array, C: Array) -> list[_PassiveMode] | None:
    poles, V = eig(A)
    if not np.linalg.cond(V) < _CONDITION:
        return None
    b, c = np.linalg.solve(V, B), C @ V
    modes: list[_PassiveMode] = []
    none = np.zeros(0, complex)
    real: list[tuple[float, ComplexArray]] = []
    scale = float(np.abs(poles).max())
    remaining = np.flatnonzero(poles.imag >= 0)
    while len(remaining):
        group = remaining[np.abs(poles[remaining] - poles[remaining[0]]) <= _SAME * scale]
        remaining = np.setdiff1d(remaining, group)
        p, residue = complex(poles[group].mean()), c[:, group] @ b[group]
        if p.imag > 0:
            K = residue * (p - p.conjugate()) / p
            if np.linalg.norm(K.imag) > _RESIDUE * np.linalg.norm(K) or not is_positive(K):
                return None
            sigma, W = _factors(K.real)
            modes += [_PassiveMode(abs(p), -p.real / abs(p), 1j * row, none) for row in np.sqrt(sigma)[:, None] * W.T]
            continue
        real.append((-p.real, residue))
    relaxations = _of_real_poles(real)
    return None if relaxations is None else modes + relaxations


def _of_real_poles(real_poles: Sequence[tuple[float, ComplexArray]]) -> list[_PassiveMode] | None:
    """Overdamped resonators, each of two real poles, and relaxations, of rates and residues."""
    slow: list[tuple[float, float, Array]] = []
    fast: list[tuple[float, float, Array]] = []
    modes: list[_PassiveMode] = []
    none = np.zeros(0, complex)
    for rate, residue in real_poles:
        sigma, W = eigh(0.5 * (residue.real + residue.real.T))
        if np.linalg.norm(residue - residue.T) > _RESIDUE * np.abs(sigma).max():
            return None
        for k in np.flatnonzero(np.abs(sigma) > _NONE * np.abs(sigma).max()):
            (fast if sigma[k] > 0 else slow).append((rate, abs(float(sigma[k])), W[:, k]))
    for rate, weight, u in slow:
        partners = [candidate for candidate in fast if _is_pair((rate, weight, u), candidate)]
        if not partners:
            return None
        partner = min(partners, key=lambda candidate: abs(candidate[1] * rate - weight * candidate[0]))
        fast = [candidate for candidate in fast if candidate is not partner]
        d = np.sqrt(rate * partner[0])
        psi = np.sqrt(weight * (partner[0] - rate) / rate) * u
        modes.append(_PassiveMode(d, (rate + partner[0]) / (2 * d), 1j * psi, none))
    return modes + [_PassiveMode(0.0, rate, np.sqrt(weight) * u + 0j, none) for rate, weight, u in fast]


def _is_pair(slow: tuple[float, float, Array], fast: tuple[float, float, Array]) -> bool:
    """Whether two real poles are those of one overdamped resonator."""
    (a, weight, u), (rate, other, w) = slow, fast
    return bool(rate > a and abs(other * a - weight * rate) <= 1e-6 * weight * rate and abs(u @ w) > 1 - 1e-9)


def _factors(K: Array | ComplexArray) -> tuple[Array, Array | ComplexArray]:
    """Positive eigenvalues and vectors of the Hermitian part of a residue; the largest entry of each is positive."""
    sigma, W = eigh(0.5 * (K + K.conj().T))
    kept = sigma > max(_NONE, len(K) * EPS) * sigma[-1]
    vectors = W[:, kept]
    lead = vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])]
    return sigma[kept], vectors * (np.abs(lead) / lead)


def _side_by_side(modes: Sequence[_PassiveMode], D: Array) -> Parts:
    """Coordinates `(q, p)` of the resonators, by frequency, and after them the states of relaxations."""
    m, sensors = len(D), len(modes[0].sensed) if modes else 0
    modes = sorted(modes, key=lambda mode: mode.d or np.inf)
    d, loss = (np.array([getattr(mode, name) for mode in modes], float) for name in ("d", "loss"))
    psi = np.array([mode.psi for mode in modes], complex).reshape(len(modes), m)
    sensed = np.array([mode.sensed for mode in modes], complex).reshape(len(modes), sensors)
    k = int(np.count_nonzero(d))
    n = k + len(modes)
    nu, d, zeta, rate = psi[:k] / np.sqrt(d[:k, None]), d[:k], loss[:k], loss[k:]
    J = np.zeros((n, n))
    J[:k, k : 2 * k], J[k : 2 * k, :k] = np.eye(k), -np.eye(k)
    return {
        "Q": np.diag(np.concatenate([d, d, np.ones(len(rate))])), "J": J,
        "R": np.diag(np.concatenate([np.zeros(k), 2 * zeta, rate])),
        "G": np.concatenate([nu.real, nu.imag, psi[k:].real]),
        "P": np.zeros((n, m)), "S": _not_negative(0.5 * (D + D.T)), "N": 0.5 * (D - D.T),
        "sensor_rows": np.concatenate([sensed[:k].real, sensed[:k].imag, sensed[k:].real]).T.copy(),
        "sensor_feedthrough": np.zeros((sensors, m)),
    }  # fmt: skip

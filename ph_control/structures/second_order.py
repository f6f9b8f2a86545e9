"""Structures by their mass, damping and stiffness matrices, `M q'' + C q' + K q = F u`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from .. import _checks
from .._types import Array, ArrayLike, SystemNames, Unpack
from ..exceptions import StructureError
from ..numerics import definiteness as _definite
from ..numerics.shift_invert import Eigensolver
from ..symplectic.forms_and_williamson import symplectic_form
from ..systems.dissipative import checked_rows, refuse_negative, restored
from ..systems.models import force_names, named, numbered
from ..systems.port_hamiltonian import PortHamiltonian
from .base_motion import absolute, base_directions, base_forces, motion_of_modes, motion_of_structure
from .massless import Structure, inverse, refuse_massless, symmetric, with_mass
from .modal_reduction import (
    NOTES,
    ModeChoice,
    StructuralModes,
    dense,
    projected_damping,
    projected_gyroscopic,
    sparse_matrix,
    sparse_skew_matrix,
    structural_modes,
)
from .rigid import FAINT, energy_parts, rigid_modes

_FEW = 64  # modes that are looked at, in a large structure; more are not rigid

_KEYWORDS = (
    "C", "G", "sensors", "base", "modes", "band", "residual_modes", "eigensolver", "condense", "rtol"
)  # fmt: skip
_ADVICE = {
    "D": "the damping matrix is C; a feedthrough follows from M, K and sensors of acceleration",
    "B": "the forces act where the third argument, F, says",
    "E": "a descriptor matrix E is not taken: degrees of freedom without mass are eliminated by condense=True",
    "J": "a skew matrix of velocities is G, the gyroscopic one; any other J is taken by ph(Q, B, J=J)",
    "R": "the damping matrix is C",
    "N": "a circulatory matrix, the skew part of K, makes energy: pass (K + K.T)/2, and close the loop "
    "u = -(K - K.T)/2 q with control.feedback",
}
_KINDS = ("position", "displacement", "velocity", "acceleration")


def from_second_order(
    M: ArrayLike | sparse.sparray,
    K: ArrayLike | sparse.sparray,
    F: ArrayLike | sparse.sparray | None = None,
    *,
    C: ArrayLike | sparse.sparray | None = None,
    G: ArrayLike | sparse.sparray | None = None,
    sensors: Mapping[str, ArrayLike] | ArrayLike | None = None,
    base: ArrayLike | None = None,
    modes: int | None = None,
    band: tuple[float, float] | None = None,
    residual_modes: bool = True,
    eigensolver: Eigensolver | None = None,
    condense: bool = False,
    rtol: float | None = None,
    **names: Unpack[SystemNames],
) -> PortHamiltonian:
    """Structure `M q'' + (C + G) q' + K q = F u` with the velocities at the forces, `y = F^T q'`, as its outputs.

    With `base` it stands on a base that moves, whose acceleration `a` is an input beside the forces.

    Parameters
    ----------
    M : array_like, shape (n, n)
        Mass matrix, symmetric positive definite.  All matrices may be sparse (`scipy.sparse`) with `modes` or `band`.
    K : array_like, shape (n, n)
        Stiffness matrix, symmetric positive semidefinite; its kernel makes rigid-body modes.
    F : array_like, shape (n,) or (n, m), optional
        Where the forces act, one column for each port; may be left out with `base`.
    C : array_like, shape (n, n), optional
        Damping matrix, symmetric positive semidefinite; default none.
    G : array_like, shape (n, n), optional
        Gyroscopic matrix, skew-symmetric, as of rotors; default none.
    sensors : dict of array_like, shape (k, n), or array_like, optional
        Rows of further outputs by what they measure: 'position' or 'displacement', which are the same, 'velocity',
        'acceleration'.  An array alone holds rows of positions.  On a moving `base` accelerations are absolute, as
        accelerometers measure them, positions and velocities relative to the base.
    base : array_like, shape (n,) or (n, r), optional
        Motion of each degree of freedom when the base moves by 1 and nothing deforms, for each direction: 1 for the
        horizontal displacements of all storeys.
    modes : int, optional
        Keep so many of the lowest modes; where the last belongs to repeated natural frequencies, all of these.
    band : (float, float), optional
        Keep the modes with natural frequencies in this interval, rad per unit time.
    residual_modes : bool
        Keep, with `modes` or `band`, one stiff mode for each port that makes the static response to its force right,
        and the rigid modes.
    eigensolver : callable, optional
        Used in place of ARPACK: `eigensolver(K, M, k, sigma)` gets sparse matrices and returns `(d2, phi)`, shapes
        (k,) and (n, k): the eigenpairs `K phi = d2 M phi` with `d2` nearest to `sigma`, which may be negative.
    condense : bool
        Eliminate motions without kinetic energy (the kernel of `M`: zero rows, or combinations of degrees of freedom),
        on which no force, damper or gyroscope may act.  They follow the others without delay, so nothing is lost: `K`
        is replaced by its Schur complement.  `M` may be rounded, as by an exporter: see Notes.
    rtol : float, optional
        Modes with `w^2` of at most `rtol` times the largest are rigid.  By default those that the rounding of `K` may
        have made of rigid ones: see Notes.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default as for `spring_chain`, sensors by what
        they measure, and states `q_i, p_i` with the numbers, from 1, of the degrees of freedom that have mass; where
        combinations of them are eliminated, `q_i` stands for the i-th together with what moves the same mass.

    Returns
    -------
    PortHamiltonian
        From force to velocity.  States: displacements and momenta `p = M q'`, those of the modes with `modes` or
        `band`, where the attribute `structural_modes` has the shapes and their accuracy.  With damping or sensors a
        `DissipativePortHamiltonian`, whose `J` has `-G`.  With `G` alone the momenta are `p = M q' + G q / 2`.  With
        `base` the attribute `base_motion` has participation factors and effective masses.

    Raises
    ------
    StructureError
        If a matrix is not square, symmetric and of the size of the others, `K` or `C` is indefinite, or `M` is singular
        and cannot be, or is not to be, condensed: the message names the massless degrees of freedom.  If `G` is not
        skew-symmetric.  With `modes` or `band` also if modes are missing by the count of a factorisation, or do not
        meet their equation.
    UnknownKeywordError
        If a keyword is not among these; the message says what takes the place of `D`, `E` and others.

    Warns
    -----
    ConditioningWarning
        If that count is not certain, or with `modes` if there are more rigid modes than these and the six of a free
        body, which are all kept: loose parts or mechanisms.

    Notes
    -----
    `Q = diag(K, M^{-1})`, `R = diag(0, C)`, `J = [[0, I], [-I, -G]]`, `B = (0, F)`, `M^{-1}` by Cholesky after scaling
    to unit diagonal.  The undamped natural frequencies are those of `scipy.linalg.eigh(K, M)` to about `eps cond(M)`.
    An accelerometer is `q'' = M^{-1} (F u - K q - C q')`, with feedthrough.  Without `modes` and `band` all is dense:
    O(n^3).

    With them it costs a sparse factorisation of `K - sigma M` and some three solutions with it for every mode (ARPACK
    by `scipy.sparse.linalg.eigsh`), and another factorisation behind the last mode, of which the negative pivots count
    the modes below (Sylvester): a mode that the iteration has missed is searched for in the complement of the others.
    No matrix is made dense.  `Q = diag(d^2, I)`, `R = diag(0, Phi^T C Phi)`, which is diagonal for classical damping.
    Without residual modes the static response lacks what the modes left out add to `K^{-1} F`; with them it is right to
    rounding, and at the ports so is its slope, which is the damping there.  The system is passive, and its modes are
    Ritz values of the structure.  Of a band above zero the residual modes stand for modes on either side, and may lie
    inside.  `C` is checked for what it does to these modes, and `M` beyond its diagonal for positive modal masses.

    `G` does no work.  With it alone the structure is lossless, and its momenta `M q' + G q / 2` make `J` the canonical
    one; `d` are then the frequencies of its whirling modes.  With `modes` or `band`, `G` is projected on the modes of
    `M` and `K`, like damping that is not classical: keep modes beyond the frequencies of interest.  A skew part of `K`
    (circulatory: follower forces, dampers in rotating parts) may feed a motion with energy, and is refused.

    With `condense=True`, eigenvalues of `M`, scaled to unit diagonal, of at most 1e-8 and a thousand times less than
    the next are zeros that were rounded, and the motions without mass are known to as much: forces and dampers are
    refused that act on them by more than 1e-8 of their size.

    Where entries of `K` are rounded, as by an exporter, its rigid-body modes get a small `w^2` of either sign.  By
    default a mode is rigid if its energy is less than ten times the most negative one (which is refused beyond 1e-9),
    or less than 1e-10 and a thousand times less than that of the next; all relative to what the entries of `K` would
    store if nothing cancelled.  `K` is then cleared of them: the number of rigid modes is `rigid_modes` of the system.
    A suspension as soft as that needs `rtol=0`.

    On a base that moves by `x`, displacements `q` are relative to it, and forces `-M base x''` act: the last ports,
    from the acceleration of the base `a_g` to `p_g = -base^T M q'`.  Participation factors `phi^T M base` are those of
    undamped modes of unit modal mass, their squares the effective masses, with the sum `base^T M base` over all modes.
    What modes left out would carry moves with the base in the absolute accelerations.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.from_second_order([[1, 0], [0, 1]], [[5, -4], [-4, 5]], [1, 0]).d
    array([1., 3.])
    >>> floating = phc.from_second_order([[1, 0], [0, 3]], [[1, -1], [-1, 1]], [1, 0])
    >>> round(floating.modes.kappa_0, 12)  # as one rigid body: 1 / (1 + 3)
    0.25
    >>> M, K = [[1, 0], [0, 1]], [[5, -4], [-4, 5]]
    >>> damped = phc.from_second_order(M, K, [1, 0], C=[[0.2, 0], [0, 0.2]], sensors={"acceleration": [0, 1]})
    >>> damped.damping_ratios.round(6), damped.output_labels
    (array([0.1     , 0.033333]), ['v', 'acceleration'])

    Two storeys on the ground that shakes, and the acceleration of the roof:

    >>> frame = phc.from_second_order(M, [[20, -10], [-10, 10]], base=[1, 1], sensors={"acceleration": [0, 1]})
    >>> frame.input_labels, frame.output_labels
    (['a_g'], ['p_g', 'acceleration'])
    >>> frame.base_motion.effective_masses[:, 0].round(4)
    array([1.8944, 0.1056])

    The ten lowest of 10 000 modes of a membrane, and the residual mode of its port:

    >>> import numpy as np
    >>> from scipy import sparse
    >>> row = 2 * sparse.eye_array(100) - sparse.eye_array(100, k=1) - sparse.eye_array(100, k=-1)
    >>> K = sparse.kronsum(row, row, format="csc")
    >>> F = np.zeros(10_000)
    >>> F[5_050] = 1.0
    >>> membrane = phc.from_second_order(sparse.eye_array(10_000), K, F, modes=10)
    >>> membrane.structural_modes.natural_frequencies[:3].round(4), membrane.n
    (array([0.044 , 0.0695, 0.0695]), 11)
    """
    _checks.known_keywords("from_second_order", names, _KEYWORDS, _ADVICE)
    _checks.flags(condense=condense, residual_modes=residual_modes)
    if F is None and base is None:
        raise StructureError("there are neither forces F nor a base that moves; give one of them, or both")
    choice = ModeChoice(modes, band, residual_modes, eigensolver)
    mass, stiffness, damping, gyroscopic = _matrices(M, K, C, G, choice)
    directions = base_directions(base, mass.shape[0])
    force = _forces(F, mass, directions)
    measured = measured_rows(sensors, mass.shape[0])
    if rtol is not None:
        _checks.relative_tolerance(rtol)
    if choice.few:
        refuse_massless(mass, (damping, gyroscopic), force, condense)
        kept = structural_modes(mass, stiffness, force, choice, rtol)
        built, number = _on_modes(kept, damping, gyroscopic, force), "mode_"
    else:
        built, kept, number = with_mass(mass, damping, gyroscopic, stiffness, force, condense), None, ""
        built = built._replace(K=_with_exact_kernel(built.M, built.K, rtol))
    states = [f"{letter}_{number}{k + 1}" for letter in "qp" for k in built.kept]
    system = _system(built, inverse(built.M), measured, states, names, directions)
    system.structural_modes = kept
    if directions.size:
        momenta = -force[:, -directions.shape[1] :]  # of masses that move with the base by 1
        moving = np.asarray(np.einsum("ij,ij->j", directions, momenta))
        system.base_motion = (
            motion_of_structure(built.M, built.K, momenta[built.kept], moving, built.motion)
            if kept is None
            else motion_of_modes(kept.natural_frequencies, kept.shapes.T @ momenta, moving, kept.shapes)
        )
    return system


def _matrices(M: Any, K: Any, C: Any, G: Any, choice: ModeChoice) -> tuple[Any, Any, Any, Any]:
    """Check mass, stiffness, damping and gyroscopic matrix: sparse where few modes are kept, else arrays."""
    if choice.modes is not None and choice.band is not None:
        raise StructureError("modes and band are both given; give only one")
    if choice.few:
        if choice.eigensolver is not None and not callable(choice.eigensolver):
            raise StructureError(f"eigensolver is {_checks.shown(choice.eigensolver)}; it must be a function, or None")
        mass = sparse_matrix("M", M)
        n = mass.shape[0]
        damping = None if C is None else sparse_matrix("C", C, n)
        return mass, sparse_matrix("K", K, n), damping, None if G is None else sparse_skew_matrix("G", G, n)
    if choice.eigensolver is not None:
        raise StructureError("an eigensolver needs modes= or band=; give one of them")
    if any(sparse.issparse(matrix) for matrix in (M, K, C, G)):
        raise StructureError(
            "M, K, C or G is sparse, and all modes would need dense matrices; give modes= (how many of the lowest) or "
            "band=, or the toarray() of each"
        )
    mass, stiffness = _square("M", M), _square("K", K)
    if mass.shape != stiffness.shape:
        raise StructureError(f"M has shape {mass.shape} and K {stiffness.shape}; they must be the same")
    return mass, stiffness, _damping(C, len(mass)), _gyroscopic(G, len(mass))


def _forces(F: ArrayLike | sparse.sparray | None, M: Array | sparse.csc_array, directions: Array) -> Array:
    """Check forces (n, m), and put those of a moving base beside them."""
    force = np.zeros((len(directions), 0)) if F is None else _checks.port_matrix(dense(F), len(directions), name="F")
    return np.hstack([force, base_forces(M, directions)]) if directions.size else force


def _on_modes(
    kept: StructuralModes, damping: sparse.csc_array | None, gyroscopic: sparse.csc_array | None, force: Array
) -> Structure:
    """Structure in modal coordinates: the modes wanted, then residual modes."""
    basis = np.hstack([kept.shapes, kept.residual_shapes])
    squares = np.concatenate([kept.natural_frequencies, kept.residual_frequencies]) ** 2
    reduced = None if damping is None else projected_damping(damping, basis)
    if reduced is not None:
        refuse_negative("C on the modes", reduced, {"C": slice(0, len(reduced))})
    turning = None if gyroscopic is None else projected_gyroscopic(gyroscopic, basis)
    number = np.arange(len(squares))
    return Structure(np.eye(len(squares)), reduced, turning, np.diag(squares), basis.T @ force, basis, number)


def _system(
    built: Structure, inverse_mass: Array, measured: dict[str, Array], states: list[str], names: SystemNames,
    directions: Array,
) -> PortHamiltonian:  # fmt: skip
    """System of a structure, of the class that its damping and sensors ask for; the last ports are of the base."""
    n, ports = built.F.shape
    Q, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, ports))
    Q[:n, :n], Q[n:, n:], B[n:] = built.K, inverse_mass, built.F
    inputs, outputs = _port_names(ports - directions.shape[1], directions.shape[1])
    if built.C is None and not measured:
        if built.G is not None:  # in the momenta M q' + G q / 2
            half = 0.5 * built.G
            Q[:n, n:], Q[:n, :n] = half @ inverse_mass, symmetric(built.K + half.T @ inverse_mass @ half)
            Q[n:, :n] = Q[:n, n:].T
        _checks.in_range("the matrix of the energy, of K, G and the inverse of M,", Q)
        return PortHamiltonian._from_matrices(Q, B, **named(names, inputs, outputs, states))
    _checks.in_range("the matrix diag(K, inverse of M)", Q)
    J, R, none = symplectic_form(n), np.zeros((2 * n, 2 * n)), np.zeros((ports, ports))
    if built.C is not None:
        R[n:, n:] = built.C
    if built.G is not None:
        J[n:, n:] = -built.G
    rows, through = _sensor_matrices(measured, built.motion, Q, J - R, B)
    if directions.size:
        through = _of_moving_base(measured, through, directions)
    for kind, wanted in measured.items():
        outputs = outputs + ([kind] if len(wanted) == 1 else numbered(kind, len(wanted)))
    parts = {
        "Q": Q, "G": B, "J": J, "R": R, "P": np.zeros((2 * n, ports)), "S": none, "N": none,
        "sensor_rows": rows, "sensor_feedthrough": through,
    }  # fmt: skip
    return restored(parts, named(names, inputs, outputs, states), None)


def _port_names(forces: int, directions: int) -> tuple[list[str], list[str]]:
    """Names of forces and velocities, then of accelerations of the base and what these supply power through."""
    inputs, outputs = force_names(forces) if forces else ([], [])
    if directions == 1:
        return [*inputs, "a_g"], [*outputs, "p_g"]
    return inputs + numbered("a_g", directions), outputs + numbered("p_g", directions)


def _of_moving_base(measured: Mapping[str, Array], through: Array, directions: Array) -> Array:
    """Feedthrough with accelerations that are absolute."""
    through, first = through.copy(), 0
    for kind, rows in measured.items():
        part = slice(first, first + len(rows))
        if kind == "acceleration":
            through[part, -directions.shape[1] :] = absolute(through[part, -directions.shape[1] :], rows, directions)
        first += len(rows)
    return through


def _gyroscopic(G: ArrayLike | None, n: int) -> Array | None:
    """Check a gyroscopic matrix; None where there is none."""
    if G is None:
        return None
    array = _checks.real_array("G", G, 2)
    if array.shape != (n, n):
        raise StructureError(f"G has shape {array.shape}; it must be {(n, n)}, as M and K are")
    _checks.in_range("G", array)
    return _checks.skew_matrix("G", array) if array.any() else None


def _damping(C: ArrayLike | None, n: int) -> Array | None:
    """Check a damping matrix; None where there is no damping."""
    if C is None:
        return None
    array = _checks.real_array("C", C, 2)
    if array.shape != (n, n):
        raise StructureError(f"C has shape {array.shape}; it must be {(n, n)}, as M and K are")
    if not array.any():
        return None
    array = symmetric(_checks.symmetric_matrix(array, name="C", even=False, note=NOTES["C"]))
    refuse_negative("C", array, {"C": slice(0, n)})
    return array


def measured_rows(sensors: Mapping[str, ArrayLike] | ArrayLike | None, n: int) -> dict[str, Array]:
    """Check rows of sensors by what they measure."""
    if sensors is None:
        return {}
    given = sensors if isinstance(sensors, Mapping) else {"position": sensors}
    unknown = [kind for kind in given if kind not in _KINDS]
    if unknown:
        raise StructureError(
            f"the sensors measure {_checks.shown(unknown[0])}; known are {', '.join(map(repr, _KINDS))}"
        )
    checked = {kind: checked_rows(f"the sensors of {kind}", dense(value), n) for kind, value in given.items()}
    return {kind: rows for kind, rows in checked.items() if len(rows)}


def _sensor_matrices(
    measured: Mapping[str, Array], motion: Array, Q: Array, flow: Array, B: Array
) -> tuple[Array, Array]:
    """State and input rows: positions, velocities `M^{-1} p`, and accelerations `M^{-1} p'`."""
    n = motion.shape[1]
    none, still, inverse = np.zeros((n, n)), np.zeros((n, B.shape[1])), Q[n:, n:]
    A = flow @ Q
    of_kind = {
        "position": (np.eye(n, 2 * n), still),
        "displacement": (np.eye(n, 2 * n), still),
        "velocity": (np.hstack([none, inverse]), still),
        "acceleration": (inverse @ A[n:], inverse @ B[n:]),
    }
    parts = [tuple(rows @ motion @ matrix for matrix in of_kind[kind]) for kind, rows in measured.items()]
    empty = np.zeros((0, 2 * n)), np.zeros((0, B.shape[1]))
    rows, through = (np.vstack(blocks) for blocks in zip(empty, *parts, strict=True))
    return rows, through


def _square(name: str, value: ArrayLike) -> Array:
    """Check of a mass or stiffness matrix what O(n^2) steps can: square, symmetric, not surely indefinite."""
    array = _checks.real_array(name, value, 2)
    n = len(array)
    if array.shape != (n, n) or n == 0:
        raise StructureError(f"{name} has shape {array.shape}; it must be (n, n) with at least one degree of freedom")
    return symmetric(_checks.symmetric_matrix(array, name=name, even=False, note=NOTES.get(name, "")))


def _with_exact_kernel(M: Array, K: Array, rtol: float | None) -> Array:
    """Stiffness of which no mode that rounding leaves of a rigid one has any; a negative one is refused."""
    factor = _definite.definite_factor(K)
    if rtol is None and factor is not None and factor[1] < 1 / FAINT:
        return K
    n = len(K)
    few = [0, _FEW - 1] if rtol is None and n > 2 * _FEW else None
    squares, shapes = eigh(K, M, subset_by_index=few)
    exact = np.einsum("ij,ij->j", shapes, K @ shapes)  # of the shapes; the others are rounded by the largest
    energy = energy_parts(np.diag(K), exact, shapes, float((np.abs(np.diag(K)) / np.diag(M)).max()))
    rigid = rigid_modes(squares, energy, n, rtol, float(squares.max()))
    if (np.abs(energy.part[rigid]) <= 2 * _checks.EPS + energy.noise[rigid]).all():
        return K
    still = shapes[:, rigid]
    momenta, forces = M @ still, K @ still
    change = forces @ momenta.T
    return symmetric(K - change - change.T + momenta @ (still.T @ forces) @ momenta.T)

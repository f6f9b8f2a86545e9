"""Error bounds of modal data, and what follows from them: which frequencies are one, and which modes no port reaches.

A system given by modes is exact.  The modes of a Hamiltonian matrix carry its rounding errors: a frequency that of
`w^H dQ w` for the mode shape `w`, an input weight one that grows as other frequencies come near.  Frequencies
closer than their errors form a group, of which only the subspace is determined, and with it the total weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import _checks
from .._types import Array, ComplexArray, Indices, Mask, NDArray, Numbers, RealOrComplex
from ..numerics.graphs import components, coupled_pairs
from .modal_form import ModalForm

Labels = NDArray[np.int32]
Energy = tuple[Array, ComplexArray, Array]  # what `symplectic.energy_coordinates` returns

_EXACT = 4.0  # roundings of each exact frequency, for each degree of freedom


@dataclass(frozen=True)
class ModalErrors:
    """Bounds of the errors of modal data.

    Attributes
    ----------
    d : ndarray, shape (n,)
        Of each frequency; two that are no farther apart than the sum of theirs cannot be told apart.
    nu : ndarray, shape (n,)
        Of each row of input weights, as a norm, as far as modes outside its group disturb it.
    rigid : ndarray, shape (k,)
        Of each row of rigid-body weights.
    """

    d: Array
    nu: Array
    rigid: Array


@dataclass(frozen=True)
class Group:
    """Modes that cannot be told apart, with the rotation that parts what ports reach from what they do not.

    Attributes
    ----------
    members : ndarray of int, shape (k,)
        Indices of the modes, ascending.
    rotation : ndarray, shape (k, k)
        Unitary; its rows map the k modal states to the reached ones, then to the hidden ones.
    d : ndarray, shape (k,)
        Frequencies in the order of these rows.
    nu : ndarray, shape (rank, m)
        Input weights of the reached states; for one port real and positive.
    strength, lost : float
        Norms of all input weights, and of those of the hidden states, which count as zero.
    """

    members: Indices
    rotation: ComplexArray
    d: Array
    nu: ComplexArray
    strength: float
    lost: float

    @property
    def rank(self) -> int:
        """Number of states that ports reach; for one port 0 or 1."""
        return len(self.nu)


@dataclass(frozen=True)
class Separation:
    """A modal form, parted.

    Attributes
    ----------
    modes : ModalForm
        The whole.
    groups : tuple of Group
        Its oscillating modes, in the order of frequencies.
    rigid : ndarray, shape (rank, m)
        Input weights of the reached rigid-body modes.
    errors : ModalErrors
        The bounds that were used.
    strength : ndarray, shape (n,)
        For each mode the norm of all input weights at its frequency: unreached if no larger than its bound.
    """

    modes: ModalForm
    groups: tuple[Group, ...]
    rigid: Array
    errors: ModalErrors
    strength: Array

    def minimal(self) -> ModalForm:
        """Modal form of what ports reach: the same transfer function with the fewest modes."""
        reached = [g for g in self.groups if g.rank]
        d = np.concatenate([np.zeros(0), *(g.d[: g.rank] for g in reached)])
        nu = np.concatenate([np.zeros((0, self.modes.nports), complex), *(g.nu for g in reached)])
        order = np.argsort(d, kind="stable")
        if self.modes.nports > 1:
            return ModalForm._of(d[order], nu[order], self.rigid.copy())
        # the weight of a group is the sum of those of its modes, whatever rotation was found
        r = np.array([self.modes.r[g.members].sum() for g in reached])[order]
        return ModalForm._of(d[order], np.sqrt(r).astype(complex)[:, None], self.rigid.copy(), r)

    def hidden(self) -> Array:
        """Frequencies that no port reaches, ascending."""
        return np.sort(np.concatenate([np.zeros(0), *(g.d[g.rank :] for g in self.groups)]))

    @property
    def is_minimal(self) -> bool:
        """Whether each mode is reached on its own, rigid-body modes too."""
        return len(self.rigid) == len(self.modes.rigid) and all(g.rank == len(g.members) for g in self.groups)


def separate(
    modes: ModalForm,
    given: tuple[Array, Array] | None = None,
    energy: Energy | None = None,
    *,
    rtol: float | None = None,
) -> Separation:
    """Group the modes of a system, and part in each group what ports reach from what they do not.

    Parameters
    ----------
    modes : ModalForm
        The modes.
    given : tuple of ndarray, optional
        `(Q, B)` if the modes come from matrices; without, they are exact.
    energy : tuple of ndarray, optional
        The energy coordinates of `Q`, required with `given`.
    rtol : float, optional
        Instead of error bounds: frequencies closer than `rtol * d` are one, and a residue `d |nu|^2` of at most
        `rtol` times the largest is zero.

    Returns
    -------
    Separation
        The groups, and the bounds that they were found with.

    Raises
    ------
    StructureError
        If `rtol` is no number from 0 to 1.

    Notes
    -----
    A group is a connected component of "no farther apart than the sum of the error bounds".  Exact frequencies
    have the bound `4 n eps d` and exact weights none.  A mode of matrices whose weight is lost in its error joins
    the neighbour that may have lent it, so that no residue is dropped.  O(n^2), and O(k^3) for a group of k.

    Examples
    --------
    >>> import ph_control as phc
    >>> from ph_control.modal.error_bounds import separate
    >>> [group.rank for group in separate(phc.modes([1.0, 1.0, 3.0], [0.25, 0.5, 0.0])).groups]
    [1, 0]
    """
    if rtol is not None:
        errors = _chosen_tolerances(modes, _checks.relative_tolerance(rtol))
    elif given is None or energy is None:
        close = exact_closeness(modes.n) * modes.d
        errors = ModalErrors(close, np.zeros(len(modes.d)), np.zeros(len(modes.rigid)))
    else:
        return _separate_computed(modes, _rounding_noise(modes, *given, energy))
    return _split(modes, _components(modes.d, errors.d), errors)


def as_decided(modes: ModalForm, starts: Indices, reached: Mask) -> tuple[Group, ...]:
    """Groups of neighbouring modes of one port, of which it is known where they begin and whether they are reached."""
    counts = np.diff(starts, append=len(modes.d))
    tolerance = np.repeat(np.where(reached, 0.0, np.inf), counts)
    label = np.repeat(np.arange(len(starts), dtype=np.int32), counts)
    return _split(modes, label, ModalErrors(0 * modes.d, tolerance, np.zeros(len(modes.rigid)))).groups


def exact_closeness(n: int) -> float:
    """Relative error of each of n exact frequencies: those no farther apart than the sum of theirs are equal."""
    return _EXACT * max(1, n) * _checks.EPS


def rounding_unit(n: int) -> float:
    """`c eps` of the errors `|dQ_ij| <= c eps sqrt(Q_ii Q_jj)` of n degrees of freedom; measured ones grow slower."""
    return float((4 + np.sqrt(n)) * _checks.EPS)


def _chosen_tolerances(modes: ModalForm, rtol: float) -> ModalErrors:
    residues = modes.d * np.sum(np.abs(modes.nu) ** 2, axis=1)
    smallest = rtol * max(residues.max(initial=0.0), float(np.sum(modes.rigid**2)))
    return ModalErrors(0.5 * rtol * modes.d, np.sqrt(smallest / modes.d), np.full(len(modes.rigid), np.sqrt(smallest)))


def _components(d: Array, radius: Array) -> Labels:
    near = np.abs(d[:, None] - d) <= radius[:, None] + radius
    return components(near)[1]


# --- groups ----------------------------------------------------------------------------------------------------


def _split(modes: ModalForm, label: Labels, errors: ModalErrors) -> Separation:
    order = np.argsort(label, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(label) else []
    members = sorted(parts, key=lambda part: int(part[0]))
    groups = tuple((_group if len(g) > 1 else _alone)(modes, g, float(errors.nu[g].max())) for g in members)
    _, sigma, Vh, rank = _reached(modes.rigid, float(errors.rigid.max(initial=0.0)))
    strength = np.empty(len(modes.d))
    for group in groups:
        strength[group.members] = group.strength
    return Separation(modes, groups, sigma[:rank, None] * Vh[:rank], errors, strength)


def _alone(modes: ModalForm, members: Indices, tolerance: float) -> Group:
    """`_group` of a single mode, whose rotation is a change of phase."""
    row = modes.nu[members]
    size = float(np.linalg.norm(row))
    if size <= max(tolerance, row.size * _checks.EPS * size):
        return Group(members, np.ones((1, 1), complex), modes.d[members], row[:0], size, size)
    lead = row[0, np.abs(row).argmax()]
    turn = np.abs(lead) / lead
    nu = np.array([[size]], complex) if row.size == 1 else turn * row
    return Group(members, np.full((1, 1), turn), modes.d[members], nu, size, 0.0)


def _group(modes: ModalForm, members: Indices, tolerance: float) -> Group:
    W, sigma, Vh, rank = _reached(modes.nu[members], tolerance)
    nu = sigma[:rank, None] * Vh[:rank]
    parts = [_diagonal_rows(W[:, part].conj().T, modes.d[members]) for part in (slice(rank), slice(rank, None))]
    nu = (parts[0][1] @ W[:, :rank]) @ nu
    # gauge: the largest weight of each reached state is real and positive
    lead = nu[np.arange(rank), np.abs(nu).argmax(axis=1)] if rank else np.ones(0)
    turn = (np.abs(lead) / lead)[:, None]
    rotation = np.concatenate([turn * parts[0][1], parts[1][1]])
    d = np.concatenate([parts[0][0], parts[1][0]])
    nu = turn * nu
    if modes.nports == 1:
        nu = np.abs(nu).astype(complex)
    return Group(members, rotation, d, nu, float(np.linalg.norm(sigma)), float(np.linalg.norm(sigma[rank:])))


def _reached(rows: Numbers, tolerance: float) -> tuple[Numbers, Array, Numbers, int]:
    """Singular value decomposition of input weights, and how many of the values stand out."""
    W, sigma, Vh = np.linalg.svd(rows)
    rounding = max(rows.shape) * _checks.EPS * float(sigma.max(initial=0.0))
    return W, sigma, Vh, int(np.sum(sigma > max(tolerance, rounding)))


def _diagonal_rows(rows: ComplexArray, d: Array) -> tuple[Array, ComplexArray]:
    """Turn orthonormal rows among themselves so that the motion `diag(d)` does not couple them."""
    if np.ptp(d) == 0 or len(rows) == 0:
        return np.full(len(rows), d[0]), rows
    # about the mean, so that frequencies that nearly coincide keep their differences
    mean = float(d.mean())
    spread, Y = np.linalg.eigh((rows * (d - mean)) @ rows.conj().T)
    return mean + spread, Y.conj().T @ rows


# --- modes of matrices -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Noise:
    """First-order effects of rounding on modal data.

    `coupling` (n, n) bounds the coupling between modes, in the unit of frequencies; its diagonal is the error of `d`.
    `rigid` (k,) bounds the error of the rigid weights.
    """

    coupling: Array
    rigid: Array


def _rounding_noise(modes: ModalForm, Q: Array, B: Array, energy: Energy) -> _Noise:
    """Bounds for errors `|dQ_ij| <= c eps sqrt(Q_ii Q_jj)` in Q, which no choice of units changes.

    Cholesky factors err as much, and so does `S^T diag(d, d) S` however it was computed.  Reducing `F^T J F` adds
    errors of the size of its norm.
    """
    d, E, E0 = energy
    n = len(Q) // 2
    unit = rounding_unit(n)
    root = np.sqrt(np.maximum(np.diag(Q), 0.0))
    scale = np.where(root > 0, root, 1.0)
    blocks = coupled_pairs(Q)[1]
    inside, inside_rigid = (np.concatenate([blocks, blocks])[_support(rows)] for rows in (E, E0))
    sizes = _norms(blocks, root[:n] * root[n:])
    inputs = _norms(np.concatenate([blocks, blocks]), np.linalg.norm(root[:, None] * B, axis=1))

    rows = E / np.sqrt(d)[:, None]
    # the columns of the inverse of a symplectic matrix are its rows, positions and momenta exchanged
    shape = np.linalg.norm(np.concatenate([rows[:, n:], rows[:, :n]], axis=1) * root, axis=1) / np.sqrt(2)
    size = sizes[inside]
    ratio = np.sqrt(d[:, None] / d)
    together = inside[:, None] == inside
    coupling = together * (np.multiply.outer(shape, shape) + size * 0.5 * (ratio + 1 / ratio))

    # a rigid-body mode is as far from every other as that one's frequency
    dual = np.linalg.pinv(np.concatenate([E.real, E.imag, E0]) / scale)[:, 2 * len(E) :] if len(E0) else E0.T
    weight = np.linalg.norm(modes.nu, axis=1)
    mixed = np.multiply.outer(np.linalg.norm(dual, axis=0), shape) + size / np.sqrt(d)
    rigid = ((inside_rigid[:, None] == inside) * mixed) @ weight
    rigid = rigid + np.linalg.norm(E0 / scale, axis=1) * inputs[inside_rigid]
    return _Noise(unit * coupling, unit * rigid)


def _norms(label: Labels, values: Array) -> Array:
    """Norm of the values of each label, whatever their size."""
    peak = float(np.abs(values).max(initial=0.0)) or 1.0
    return peak * np.sqrt(np.bincount(label, (values / peak) ** 2))


def _support(rows: RealOrComplex) -> Indices:
    """For each row a state that it involves."""
    return np.abs(rows).argmax(axis=1) if len(rows) else np.zeros(0, np.intp)


def _separate_computed(modes: ModalForm, noise: _Noise) -> Separation:
    """Groups of modes with rounding errors: by frequency, then joined where weight is lost to a neighbour."""
    label = _components(modes.d, np.diag(noise.coupling))
    by_frequency = separation = _split(modes, label, _computed_errors(modes, noise, label))
    while True:
        joined = _join_lenders(separation, _lent_weight(modes, noise, label), label)
        if np.array_equal(joined, label):
            return replace(separation, errors=by_frequency.errors, strength=by_frequency.strength)
        label = joined
        separation = _split(modes, label, _computed_errors(modes, noise, label))


def _computed_errors(modes: ModalForm, noise: _Noise, label: Labels) -> ModalErrors:
    # the part that mixes with the conjugate modes also covers the rounding of the product S B
    conjugates = noise.coupling / (modes.d[:, None] + modes.d) @ np.linalg.norm(modes.nu, axis=1)
    error = _lent_weight(modes, noise, label).sum(axis=1) + conjugates
    of_group = np.sqrt(np.bincount(label, error**2))[label] if len(label) else error
    return ModalErrors(np.diag(noise.coupling).copy(), of_group, noise.rigid)


def _lent_weight(modes: ModalForm, noise: _Noise, label: Labels) -> Array:
    """Entry (l, j): the weight that mode l may owe to mode j of another group, more the nearer they are."""
    apart = label[:, None] != label
    gap = np.where(apart, np.abs(modes.d[:, None] - modes.d), np.inf)
    return noise.coupling / gap * np.linalg.norm(modes.nu, axis=1)


def _join_lenders(separation: Separation, lent: Array, label: Labels) -> Labels:
    """Join each group that would lose weight with the one that most of it may come from.

    Dropped, the weight would be missing in the total; rotated back into the joint subspace, it is not.
    """
    joined = label.copy()
    strength = {int(label[g.members[0]]): g.strength for g in separation.groups}
    for group in separation.groups:
        lender = int(label[np.unravel_index(lent[group.members].argmax(), (len(group.members), len(label)))[1]])
        rounding = len(label) * _checks.EPS * strength[lender] ** 2
        if group.lost**2 > rounding and lent[group.members].any():
            joined[joined == joined[group.members[0]]] = joined[np.flatnonzero(label == lender)[0]]
    return joined

"""Isomorphisms between linear systems, and verdicts on whether there is one.

Two routes.  For port-Hamiltonian systems the frequencies and weights decide, and Williamson's normal form gives the
isomorphism.  For any other systems the eigenvalues are matched, each cluster of them as one block, and a small
linear problem is solved in each block; nothing needs powers of a matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import control as ct
import numpy as np

from .. import _checks
from .._types import Array, ComplexArray, Indices
from ..exceptions import StructureError
from ..numerics.invariant_subspaces import SAFETY, clusters, eigenvalues_of, invariant_block, schur_form
from ..numerics.polynomials import companion_maps
from ..symplectic.forms_and_williamson import symplectic_inverse
from ..systems.base import LosslessSystem
from ..systems.canonical_forms import ControllableHamiltonian, ObservableHamiltonian
from ..systems.port_hamiltonian import PortHamiltonian
from .filters import MARGIN, Verdict, compare_filters, separation_of
from .morphisms import balanced, comparable, is_morphism
from .unique_coordinates import norm_of

_NEAR = (1e-12, 1e-9, 1e-6, 1e-3)  # relative distances of frequencies below which modes are taken to mix
_SMALL = 16  # states up to which all eigenvalues may be treated as one block
_LARGEST_BLOCK = 24  # eigenvalues in one block up to which its k^2 equations are solved at once, in O(k^6)
_PARALLEL = 1e-8  # ports whose weights in a group of modes differ by less give no direction of their own


def are_isomorphic(sys1: ct.StateSpace, sys2: ct.StateSpace, *, rtol: float | None = None) -> Verdict:
    """Tell whether two systems are the same up to an invertible change of states, `~sys` of the paper.

    Parameters
    ----------
    sys1, sys2 : control.StateSpace
        Any two linear systems with the same inputs, outputs and time base.
    rtol : float, optional
        Relative tolerance of frequencies, weights and residuals; default a bound of their rounding errors.

    Returns
    -------
    Verdict
        With the isomorphism `L`, shape (N, N), from the states of `sys1` to those of `sys2` as witness, its largest
        relative residual (see `is_morphism`) and what was allowed.

    Raises
    ------
    StructureError
        If they are no state-space systems, ports or time bases differ, `rtol` is no tolerance, or more than 24
        eigenvalues coincide that are not semisimple.

    Notes
    -----
    Minimal systems have one isomorphism or none.  Two port-Hamiltonian systems, minimal or not, are isomorphic iff
    their frequencies agree with their multiplicities and, at each distinct frequency, the sums of the weights `r`
    agree (for m ports, of the matrices `nu^H nu`): in modal coordinates an isomorphism takes the weights of a
    frequency to one another by a matrix `G` with `G nu_1 = nu_2` and `G^H nu_2 = nu_1`, so their lengths agree; and if
    they do, a unitary `G` exists.  Other systems are compared through their eigenvalues.  O(N^3), and more where many
    eigenvalues coincide.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> verdict = phc.are_isomorphic(phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]), phc.ph(np.diag([1.0, 4.0]), [1.0, 0.0]))
    >>> bool(verdict), verdict.witness
    (True, array([[ 0.,  1.],
           [-1.,  0.]]))
    >>> print(phc.are_isomorphic(phc.ph(np.eye(2), [1.0, 0.0]), phc.ph(2 * np.eye(2), [1.0, 0.0])).reason)
    the frequencies differ: 1 and 2
    """
    comparable(sys1, sys2)
    if rtol is not None:
        _checks.relative_tolerance(rtol)
    if sys1.nstates != sys2.nstates:
        return Verdict(False, 1.0, 0.0, None, f"they have {sys1.nstates} and {sys2.nstates} states")
    if sys1.nstates == 0:
        return _judge([np.zeros((0, 0))], sys1, sys2, 0.0 if rtol is None else rtol)
    if _definite(sys1) and _definite(sys2):
        return _compare_lossless(sys1, sys2, rtol)
    return _compare_eigenblocks(sys1, sys2, rtol)


def system_isomorphism(sys1: ct.StateSpace, sys2: ct.StateSpace, *, rtol: float | None = None) -> Array | None:
    """Invertible matrix from the states of one system to those of another that keeps inputs and outputs.

    Parameters
    ----------
    sys1, sys2 : control.StateSpace
        Any two linear systems with the same inputs, outputs and time base.
    rtol : float, optional
        Relative tolerance; default a bound of the rounding errors.

    Returns
    -------
    ndarray, shape (N, N), or None
        `L` with `L A1 = A2 L`, `L B1 = B2`, `C1 = C2 L`; None if there is none, for the reason that
        `are_isomorphic` gives.

    Raises
    ------
    StructureError
        As for `are_isomorphic`.

    Notes
    -----
    As for `are_isomorphic`.

    Examples
    --------
    How the states of a plain system map to those of its port-Hamiltonian form:

    >>> import control as ct, ph_control as phc
    >>> plain = ct.ss([[0.0, -4.0], [1.0, 0.0]], [[1.0], [0.0]], [[1.0, 0.0]], 0.0)
    >>> phc.system_isomorphism(plain, phc.ph(plain)).round(12) + 0.0
    array([[ 0.70710678,  0.        ],
           [ 0.        , -1.41421356]])
    """
    verdict = are_isomorphic(sys1, sys2, rtol=rtol)
    return verdict.witness if verdict else None


def _judge(
    candidates: list[Array], sys1: ct.StateSpace, sys2: ct.StateSpace, allowed: float, *, invertible: bool = False
) -> Verdict:
    """Measure candidates of an isomorphism and decide on the best."""
    checks = [is_morphism(L, sys1, sys2) for L in candidates]
    best = min(range(len(checks)), key=lambda k: checks[k].residual)
    L, check = candidates[best], checks[best]
    invertible = invertible or check.rank == len(L)
    if check.residual > allowed:
        return Verdict(False, check.residual, allowed, None, "no change of states takes one to the other")
    if not invertible:
        return Verdict(False, check.residual, allowed, None, f"every morphism found is singular, of rank {check.rank}")
    return Verdict(True, check.residual, allowed, L, "an invertible change of states takes one to the other")


# --- port-Hamiltonian systems ----------------------------------------------------------------------------------------


def _definite(sys: ct.StateSpace) -> bool:
    """Whether a system is port-Hamiltonian or a canonical form of one, without rigid-body modes."""
    kinds = PortHamiltonian, ControllableHamiltonian, ObservableHamiltonian
    return isinstance(sys, kinds) and sys._in_normal_form and len(sys.modes.d) == sys.n


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # what overflows is refused
def _compare_lossless(sys1: LosslessSystem, sys2: LosslessSystem, rtol: float | None) -> Verdict:
    first, second = separation_of(sys1), separation_of(sys2)
    d1, d2 = first.modes.d, second.modes.d
    # sorted, so equal multisets agree entry by entry
    gap = np.abs(d1 - d2) / d1
    allowed = np.full(len(gap), max(rtol or 0.0, _checks.EPS))
    if rtol is None:
        allowed = MARGIN * (first.errors.d + second.errors.d) / d1
    l = int(np.argmax(gap / allowed))
    if gap[l] > allowed[l]:
        reason = f"the frequencies differ: {d1[l]:.6g} and {d2[l]:.6g}"
        return Verdict(False, float(gap[l]), float(allowed[l]), None, reason)
    filters = compare_filters(first, second, rtol)
    if not filters:
        return filters
    # the largest relative errors of frequencies
    worst = sum(
        float(np.max(separation.errors.d / separation.modes.d, initial=_checks.EPS)) for separation in (first, second)
    )
    floor = MARGIN * sys1.n * worst if rtol is None else rtol
    if isinstance(sys1, PortHamiltonian) and isinstance(sys2, PortHamiltonian):
        return _judge(_williamson_candidates(sys1, sys2, float(allowed.max())), sys1, sys2, floor)
    if type(sys1) is type(sys2):
        # the same frequencies and residues make the same coefficients
        return _judge([np.eye(2 * sys1.n)], sys1, sys2, floor)
    for separation in (first, second):
        if not separation.is_minimal:
            reason = "of two canonical forms, only canonical pairs make them isomorphic, and this one is not"
            return Verdict(False, 1.0, 0.0, None, reason)
    L = _modal_coordinates(sys2)[1] @ _modal_coordinates(sys1)[0]
    _checks.representable("the entries of the isomorphism", L, nonzero=(L != 0) | ~L.any(axis=1, keepdims=True))
    return _judge([L], sys1, sys2, floor, invertible=True)


def _modal_coordinates(sys: LosslessSystem) -> tuple[Array, Array]:
    """Matrix to `(Re w, Im w)` of a canonical system, `w_l = x_l / nu_l` in the order of ascending d, and its inverse.

    Both by formula, so that no digits are lost by elimination.
    """
    if isinstance(sys, PortHamiltonian):
        nu = _complex_rows(sys.S @ sys.B)[:, 0]
        return real_form(np.diag(1 / nu)) @ sys.S, symplectic_inverse(sys.S) @ real_form(np.diag(nu))
    # `w` are the states of the normal form with unit weights
    W, L = companion_maps(sys.modes.d)
    there, back = np.concatenate([W.real, W.imag]), np.concatenate([L.real, -L.imag]).T
    if isinstance(sys, ControllableHamiltonian):
        return there, back
    # the transpose of it: s_{2k+1} = sum_l kappa_l b_k d_l Im w_l and s_{2k+2} = sum_l kappa_l b_k Re w_l
    kappa = np.concatenate([sys.modes.kappa, -sys.modes.kappa])
    return back.T / kappa[:, None], there.T * kappa


def _complex_rows(v: Array) -> ComplexArray:
    n = len(v) // 2
    return np.asarray(v[:n] + 1j * v[n:])


def _williamson_candidates(sys1: PortHamiltonian, sys2: PortHamiltonian, close: float) -> list[Array]:
    """Isomorphisms through Williamson coordinates, by one unitary matrix for each group of frequencies."""
    S1, S2 = sys1.S, sys2.S
    nu1, nu2, back = _complex_rows(S1 @ sys1.B), _complex_rows(S2 @ sys2.B), np.linalg.inv(S2)
    # equal frequencies share a block; what rounding mixes among near ones is put right by the smallest rotation
    equal = clusters(sys1.d.astype(complex), 4 * sys1.n * _checks.EPS * sys1.d)
    U = block_unitary(nu1, nu2, equal)
    candidates = [back @ real_form(U) @ S1]
    for distance in (*_NEAR, close):
        groups = clusters(sys1.d.astype(complex), distance * sys1.d / 2)
        if len(groups) < len(equal):
            candidates.append(back @ real_form(_smallest_rotation(U @ nu1, nu2, groups) @ U) @ S1)
    return candidates


def block_unitary(nu1: ComplexArray, nu2: ComplexArray, groups: list[Indices]) -> ComplexArray:
    """Unitary matrix, block-diagonal over groups of indices, that takes `nu1` nearest to `nu2`."""
    U = np.zeros((len(nu1), len(nu1)), complex)
    for group in groups:
        left_vectors, _, right_vectors = np.linalg.svd(nu2[group] @ nu1[group].conj().T)
        U[np.ix_(group, group)] = left_vectors @ right_vectors
    return U


def _smallest_rotation(nu1: ComplexArray, nu2: ComplexArray, groups: list[Indices]) -> ComplexArray:
    """Unitary matrix near the identity, block-diagonal over groups, that takes `nu1` to `nu2` of nearly equal size."""
    R = np.zeros((len(nu1), len(nu1)), complex)
    for group in groups:
        from_, to = (np.linalg.pinv(nu[group], rcond=_PARALLEL) for nu in (nu1, nu2))
        I = np.eye(len(group))
        turned = nu2[group] @ from_ + (I - nu2[group] @ to) @ (I - nu1[group] @ from_)
        left_vectors, _, right_vectors = np.linalg.svd(turned)
        R[np.ix_(group, group)] = left_vectors @ right_vectors
    return R


def real_form(U: ComplexArray) -> Array:
    """Real matrix on `(Re x, Im x)` of a complex one on x."""
    return np.block([[U.real, -U.imag], [U.imag, U.real]])


# --- any systems ---------------------------------------------------------------------------------------------------


def _compare_eigenblocks(sys1: ct.StateSpace, sys2: ct.StateSpace, rtol: float | None) -> Verdict:
    """Match the eigenvalues in clusters and solve for one block of the isomorphism in each."""
    first, second = _BalancedSchur.of(sys1), _BalancedSchur.of(sys2)
    n = len(first.values)
    values = np.concatenate([first.values, second.values])
    radius = np.concatenate([first.radius, second.radius]) * SAFETY
    if rtol is not None:
        radius = np.maximum(radius, 0.5 * rtol * np.abs(values))
    for group in clusters(values, radius):
        ours = int(np.sum(group < n))
        if 2 * ours != len(group):
            center = values[group].mean()
            reason = f"{ours} and {len(group) - ours} of their eigenvalues are at {center:.6g}"
            return Verdict(False, 1.0, float(radius[group].max() / (abs(center) or 1.0)), None, reason)
        # below the real axis are the conjugates of what is above
        above = values[group].imag.max() >= -radius[group].max()
        offence = _seen_by_one_only(first, second, group) if above else None
        if offence is not None:
            return offence
    candidates, floor = [], 0.0
    partitions = [clusters(values, np.maximum(radius, 0.5 * close * np.abs(values))) for close in (0.0, *_NEAR)]
    if n <= _SMALL:
        partitions.append([np.arange(2 * n)])
    for k, groups in enumerate(partitions):
        if k == 0 or len(groups) < len(partitions[k - 1]):
            L, error = _from_blocks(first, second, groups, radius)
            if L is None and k == 0:
                raise StructureError(
                    f"more than {_LARGEST_BLOCK} eigenvalues coincide in each system and are not semisimple; linking k "
                    "of them needs the solution of k^2 equations at once"
                )
            if L is not None:
                candidates.append(L * second.scale[:, None] / first.scale)
                floor = max(floor, error)
    return _judge(candidates, sys1, sys2, SAFETY * floor if rtol is None else rtol)


def _seen_by_one_only(first: _BalancedSchur, second: _BalancedSchur, group: Indices) -> Verdict | None:
    """Refusal if inputs reach, or outputs see, these eigenvalues in one system but not in the other.

    A morphism would be singular there; its smallest singular value would be rounding, which looks like any number.
    """
    n = len(first.values)
    first_block, second_block = first.block(group[group < n]), second.block(group[group >= n] - n)
    error = SAFETY * _checks.EPS * n * (1 / first_block.separation + 1 / second_block.separation)
    center = (np.trace(first_block.T) + np.trace(second_block.T)) / len(group)
    for what, a, b, whole in (
        ("inputs reach", first_block.inputs, second_block.inputs, (first.B, second.B)),
        ("outputs see", first_block.outputs, second_block.outputs, (first.C, second.C)),
    ):
        size = [float(norm_of(part) / (norm_of(M) or 1.0)) for part, M in zip((a, b), whole, strict=True)]
        if min(size) <= error and max(size) > np.sqrt(error):
            return Verdict(False, max(size), error, None, f"the {what} the eigenvalue {center:.6g} in one of them only")
    return None


def _from_blocks(
    first: _BalancedSchur, second: _BalancedSchur, groups: list[Indices], radius: Array
) -> tuple[Array | None, float]:
    """Isomorphism from one block for each group of eigenvalues, and the error of the worst of them.

    None where a block is too large for its equations to be solved at once.
    """
    n = len(first.values)
    values = np.concatenate([first.values, second.values])
    L, worst = np.zeros((n, n)), 0.0
    for group in groups:
        ours, theirs = group[group < n], group[group >= n] - n
        around = values[group].imag
        if len(ours) != len(theirs) or around.max() < -radius[group].max():
            continue
        first_block, second_block = first.block(ours), second.block(theirs)
        error = SAFETY * _checks.EPS * n * (1 / first_block.separation + 1 / second_block.separation)
        G = _block_solution(first_block, second_block, max(first.size, second.size), error)
        if G is None:
            return None, worst
        part = (second_block.columns @ G @ first_block.rows).real
        L += 2 * part if around.min() > radius[group].max() else part
        worst = max(worst, error)
    return L, worst


class _PortBlock(NamedTuple):
    """An invariant block of a system, with its bases in the states of the system and what ports do to it."""

    columns: ComplexArray
    rows: ComplexArray
    T: ComplexArray
    inputs: ComplexArray
    outputs: ComplexArray
    separation: float


@dataclass(frozen=True, eq=False)
class _BalancedSchur:
    """Schur form of a balanced system, with its eigenvalues and how far rounding may have moved them."""

    scale: Array
    T: ComplexArray
    Z: ComplexArray
    B: Array
    C: Array
    values: ComplexArray
    radius: Array
    size: float
    blocks: dict[bytes, _PortBlock] = field(default_factory=dict)

    @classmethod
    def of(cls, sys: ct.StateSpace) -> _BalancedSchur:
        scale, A, B, C, _ = balanced(sys)
        T, Z = schur_form(A)
        eigenvalues, size = eigenvalues_of(T), float(norm_of(A))
        # the eigenvalues of a Jordan block of size k scatter by eps^(1/k)
        radius = np.minimum(len(A) * _checks.EPS * size / eigenvalues.separation, _checks.EPS**0.25 * size)
        return cls(scale, T, Z, B, C, eigenvalues.values, radius, size)

    def block(self, group: Indices) -> _PortBlock:
        """Split a cluster of eigenvalues off, once."""
        key = group.tobytes()
        if key not in self.blocks:
            part = invariant_block(self.T, group)
            columns, rows = self.Z @ part.columns, part.rows @ self.Z.conj().T
            self.blocks[key] = _PortBlock(columns, rows, part.T, rows @ self.B, self.C @ columns, part.separation)
        return self.blocks[key]


def _block_solution(first: _PortBlock, second: _PortBlock, size: float, error: float) -> ComplexArray | None:
    """Best `G` with `G T1 = T2 G`, `G b1 = b2`, `c1 = c2 G`; where it is not unique, a well-conditioned one."""
    I = np.eye(k := len(first.T))
    scale_b = max(norm_of(first.inputs), norm_of(second.inputs)) or 1.0
    scale_c = max(norm_of(first.outputs), norm_of(second.outputs)) or 1.0
    # the two blocks have the same center but for rounding
    T1, T2 = (block.T - np.trace(block.T) / k * I for block in (first, second))
    if norm_of(T1) + norm_of(T2) <= error * size:
        # semisimple: any G commutes, and only the ports remain
        from_b = _cut_inverse(first.inputs, error * scale_b)
        from_c = _cut_inverse(second.outputs, error * scale_c)
        G = second.inputs @ from_b
        G = G + from_c @ (first.outputs - second.outputs @ G)
        unseen, unreached = I - from_c @ second.outputs, I - first.inputs @ from_b
        return _best_conditioned(G, lambda X: unseen @ X @ unreached)
    if k > _LARGEST_BLOCK:
        return None
    commuting = (np.kron(T1.T, I) - np.kron(I, T2)) / (size or 1.0)
    ports = np.kron(first.inputs.T, I) / scale_b, np.kron(I, second.outputs) / scale_c
    system = np.concatenate([commuting, *ports])
    wanted = [part.ravel(order="F") for part in (second.inputs / scale_b, first.outputs / scale_c)]
    U, sigma, Vh = np.linalg.svd(system, full_matrices=False)
    rank = int(np.sum(sigma > error))
    particular = Vh[:rank].conj().T @ (
        (U[:, :rank].conj().T @ np.concatenate([np.zeros(k * k), *wanted])) / sigma[:rank]
    )
    free = Vh[rank:].conj().T

    def project(X: ComplexArray) -> ComplexArray:
        return np.asarray((free @ (free.conj().T @ X.ravel(order="F"))).reshape(k, k, order="F"), complex)

    return _best_conditioned(particular.reshape(k, k, order="F"), project)


def _cut_inverse(M: ComplexArray, smallest: float) -> ComplexArray:
    """Pseudoinverse, singular values up to the smallest taken for 0."""
    return np.asarray(np.linalg.pinv(M, rcond=smallest / max(float(np.linalg.norm(M, 2)), smallest)), complex)


def _best_conditioned(particular: ComplexArray, project: Callable[[ComplexArray], ComplexArray]) -> ComplexArray:
    """Add a projection onto the homogeneous solutions: invertible unless chosen badly, if anything is."""
    k, rng = len(particular), np.random.default_rng(0)  # nearest the identity, then at random
    typical = norm_of(particular) / np.sqrt(k) or 1.0
    starts = [np.eye(k), *(rng.standard_normal((k, k)) + 1j * rng.standard_normal((k, k)) for _ in range(4))]
    choices = [particular + typical * project(start) for start in starts]
    return min(choices, key=lambda G: 1 / max(np.linalg.svd(G, compute_uv=False)[-1], 1e-300) * norm_of(G))

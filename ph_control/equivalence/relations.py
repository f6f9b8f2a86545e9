"""When two lossless systems, or two pairs `(d, v)`, are the same.

`~filter` asks for the same transfer function.  On pairs `(d, v)` the relation `~star` is what isomorphism is on
port-Hamiltonian systems; on canonical pairs its classes are the orbits of `act`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

import control as ct
import numpy as np

from .. import _checks
from .._types import Array, ArrayLike, ComplexArray, Indices
from ..exceptions import StructureError
from ..modal.error_bounds import ModalErrors, Separation, separate
from ..modal.foster_test import Judged, hamiltonian_form, lossless_modes_with_errors
from ..modal.modal_form import ModalForm
from ..symplectic.forms_and_williamson import apply_form
from ..systems.base import Convertible, in_normal_form, refuse_losses
from ..systems.canonical_forms import ControllableHamiltonian, ObservableHamiltonian
from ..systems.port_hamiltonian import full_port_hamiltonian
from .filters import Verdict, compare_filters, separation_of
from .isomorphism import block_unitary, real_form
from .unique_coordinates import power_of_two, resonances, squared_weights

_Comparable: TypeAlias = Convertible | tuple[ArrayLike, ArrayLike]

# --- the same transfer function ---------------------------------------------------------------------------------------


def same_filter(sys1: _Comparable, sys2: _Comparable, *, rtol: float | None = None) -> Verdict:
    """Tell whether two lossless systems have the same transfer function, `~filter` of the paper.

    Parameters
    ----------
    sys1, sys2 : PortHamiltonian, ModalForm, any lossless system, or tuple
        Systems that `ph` takes, or pairs `(d, v)`; as many ports each.
    rtol : float, optional
        Relative tolerance of poles, and of residues relative to the largest; default bounds of their errors.

    Returns
    -------
    Verdict
        With the common minimal modal form as witness; residual and bound are those of the residue that speaks most
        against it, relative to what is at its frequency, or with `rtol` to the largest.

    Raises
    ------
    StructureError, NotLosslessError
        If the arguments are no lossless systems, or their numbers of ports differ.

    Notes
    -----
    Compares the minimal coordinates: equal poles are merged, unreached modes have the residue 0.  The paper's
    criterion, Theorem 4.5 (II), compares `e_1 .. e_n`, which is not enough: see `filter_coefficients`.  O(n^3) at
    most, for the modes of matrices.

    Examples
    --------
    >>> import ph_control as phc
    >>> bool(phc.same_filter(phc.modes([1.0, 1.0, 5.0], [0.5, 0.25, 0.0]), ([1.0], [0.0, 0.75**0.5])))
    True
    >>> print(phc.same_filter(phc.modes(1.0, 2.0), phc.modes(2.0, 1.0)).reason)
    the residues at frequency 1 differ: 2 and 0
    """
    if rtol is not None:
        _checks.relative_tolerance(rtol)
    first, second = _separated(sys1), _separated(sys2)
    ports = first.modes.nports, second.modes.nports
    if ports[0] != ports[1]:
        raise StructureError(f"the systems have {ports[0]} and {ports[1]} ports; filters of as many ports compare")
    verdict = compare_filters(first, second, rtol)
    witness = first if rtol is None else separate(first.modes, rtol=rtol)
    return replace(verdict, witness=witness.minimal(), reason="poles and residues agree") if verdict else verdict


def _separated(sys: _Comparable) -> Separation:
    """Modes of anything lossless, with the bounds of their errors."""
    refuse_losses(sys, "this comparison is")
    if isinstance(sys, tuple):
        if len(sys) != 2:
            raise StructureError(f"a tuple of {len(sys)} is no system; a pair (d, v) has two parts")
        return separation_of(ControllableHamiltonian(*_checks.parameter_pair(*sys)))
    if isinstance(sys, ModalForm | ControllableHamiltonian | ObservableHamiltonian):
        return separation_of(sys)
    normal = isinstance(sys, ct.StateSpace) and sys.isctime() and hamiltonian_form(sys) is not None
    if normal or in_normal_form(sys):
        return separation_of(full_port_hamiltonian(sys))
    return _with_judged_errors(lossless_modes_with_errors(sys))


def _with_judged_errors(judged: Judged) -> Separation:
    """Modes of a plain system, with the bounds that held when its poles and residues were judged."""
    separation = separate(judged.modes)
    d, total = separation.modes.d, np.sum(np.abs(separation.modes.nu) ** 2, axis=1)
    rigid = np.sum(separation.modes.rigid**2, axis=1)
    whole = max((d * total).max(initial=0.0), rigid.max(initial=0.0))
    errors = ModalErrors(
        separation.errors.d + judged.d_error,
        separation.errors.nu + 0.5 * judged.kappa_error / (d * np.sqrt(total)),
        separation.errors.rigid + 8 * max(1, separation.modes.n) * _checks.EPS * whole / np.sqrt(rigid),
    )
    return replace(separation, errors=errors)


@np.errstate(over="ignore")  # what overflows is refused
def filter_coefficients(d: ArrayLike, v: ArrayLike) -> Array:
    """Return the 2n coefficients that determine the transfer function of CH(d, v).

    They are the Markov parameters `e_m = C A^{2(m-1)} B`; those of odd powers are 0.

    Parameters
    ----------
    d : array_like, shape (n,)
        Natural frequencies, positive, in any order.
    v : array_like, shape (2n,)
        Input vector in Williamson coordinates.

    Returns
    -------
    ndarray, shape (2n,)
        `e_m = (-1)^{m-1} sum_l r_l d_l^{2m-1}`.

    Raises
    ------
    StructureError
        If `d` and `v` do not fit, or a coefficient exceeds the range of doubles.

    Notes
    -----
    The paper prints n of them (Theorem 4.5 (II)) and claims `e_m = 0` beyond; corrected here: they follow
    `e_m = -a_{2n-2} e_{m-1} - .. - a_0 e_{m-n}` for `m > n`, and two systems of n modes can agree in the first 2n - 1.
    A sum of positive terms each: full relative accuracy.  O(n^2).

    Examples
    --------
    The counterexample to the printed theorem: `e_1` agrees, the transfer functions `2 s / (s^2 + 1)` and
    `2 s / (s^2 + 4)` do not.

    >>> import ph_control as phc
    >>> phc.filter_coefficients([1.0], [2**0.5, 0.0]).round(12)
    array([ 2., -2.])
    >>> phc.filter_coefficients([2.0], [1.0, 0.0])
    array([ 2., -8.])
    >>> bool(phc.same_filter(([1.0], [2**0.5, 0.0]), ([2.0], [1.0, 0.0])))
    False
    """
    frequencies, vector = _checks.parameter_pair(d, v)
    n = len(frequencies)
    r = squared_weights(vector)
    with np.errstate(over="ignore", invalid="ignore"):
        powers = np.vander(frequencies**2, 2 * n, increasing=True).T
        e = (powers @ (r * frequencies)) * np.where(np.arange(2 * n) % 2, -1.0, 1.0)
    _checks.representable(f"the filter coefficients of {n} modes", e)
    return e


# --- pairs (d, v) -----------------------------------------------------------------------------------------------------


def star_equivalent(
    d1: ArrayLike, v1: ArrayLike, d2: ArrayLike, v2: ArrayLike, *, rtol: float | None = None
) -> Verdict:
    """Tell whether two pairs `(d, v)` stand for isomorphic port-Hamiltonian systems, `~star` of the paper.

    Parameters
    ----------
    d1 : array_like, shape (n,)
        Natural frequencies of the first pair, positive, in any order.
    v1 : array_like, shape (2n,)
        Its input vector.
    d2 : array_like, shape (n,)
        Natural frequencies of the second pair.
    v2 : array_like, shape (2n,)
        Its input vector.
    rtol : float, optional
        Relative tolerance of frequencies, and of weights relative to all of them; default `32 n eps`, and weights
        relative to those at their frequency.

    Returns
    -------
    Verdict
        The witness is `(P, A)`, a permutation matrix (n, n) and an invertible matrix (2n, 2n) with
        `P Dhat1 P^T = Dhat2`, `A^T Dhat1 A v1 = Dhat1 v1`, `A J Dhat1 = J Dhat1 A` and `v2 = P A v1`, where P also
        stands for `diag(P, P)` and `Dhat = diag(d, d)`; the residual is the largest of these four conditions.

    Raises
    ------
    StructureError
        If `d` and `v` of a pair do not fit, or `rtol` is no tolerance.

    Notes
    -----
    Holds iff the frequencies agree with their multiplicities and, at each distinct frequency, the sums of
    `r_l = v_l^2 + v_{n+l}^2`: A is then a unitary matrix for each frequency.  By the same token `~star` and equality
    of the coefficients `a` and `c` coincide for all pairs, not only for canonical ones.  O(n^3).

    Examples
    --------
    >>> import ph_control as phc
    >>> verdict = phc.star_equivalent([1.0, 2.0], [1.0, 0.0, 0.0, 3.0], [2.0, 1.0], [3.0, 0.0, 0.0, -1.0])
    >>> bool(verdict)
    True
    >>> P, A = verdict.witness
    >>> P
    array([[0., 1.],
           [1., 0.]])
    """
    (first, ours), (second, theirs) = (_named_pair(k, *pair) for k, pair in ((1, (d1, v1)), (2, (d2, v2))))
    n = len(first)
    allowed = 32 * max(1, n) * _checks.EPS if rtol is None else _checks.relative_tolerance(rtol)
    if len(second) != n:
        return Verdict(False, 1.0, allowed, None, f"they have {n} and {len(second)} modes")
    sigma = np.empty(n, int)
    sigma[np.argsort(second, kind="stable")] = np.argsort(first, kind="stable")
    nu1 = (ours[:n] + 1j * ours[n:])[:, None]
    nu2 = np.empty((n, 1), complex)
    nu2[sigma, 0] = theirs[:n] + 1j * theirs[n:]
    P = np.eye(n)[sigma]
    groups = resonances(first, allowed)
    A = real_form(block_unitary(nu1, nu2, groups))
    energy, motions = reduced_residuals(A, first, ours)
    residuals = {
        "frequencies": float(np.max(np.abs(P @ first - second) / np.maximum(P @ first, second), initial=0.0)),
        "energies of the inputs": energy,
        "motions": motions,
        "input weights": _weights_apart(A, nu1, nu2, groups if rtol is None else [np.arange(n)]),
    }
    worst = max(residuals, key=lambda name: residuals[name])
    residual = residuals[worst]
    if residual > allowed:
        return Verdict(False, residual, allowed, None, f"the {worst} differ")
    return Verdict(True, residual, allowed, (P, A), "a permutation and turns within frequencies link them")


def _named_pair(k: int, d: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    try:
        return _checks.parameter_pair(d, v)
    except StructureError as error:
        raise StructureError(f"pair {k}: {error}") from None


def _weights_apart(A: Array, nu1: ComplexArray, nu2: ComplexArray, groups: list[Indices]) -> float:
    """Relative residual of `A nu1 = nu2` in the group of modes where it is largest."""
    n = len(nu1)
    U = A[:n, :n] + 1j * A[n:, :n]
    worst = 0.0
    for group in groups:
        # largest entries, which have no squares that leave the range of doubles
        off, size = np.abs(U[np.ix_(group, group)] @ nu1[group] - nu2[group]), np.abs([nu1[group], nu2[group]])
        worst = max(worst, float(off.max(initial=0.0)) / (float(size.max(initial=0.0)) or 1.0))
    return worst


@np.errstate(over="ignore", invalid="ignore")  # what overflows is no arrow
def reduced_residuals(A: Array, d: Array, v: Array) -> tuple[float, float]:
    """Relative residuals of `A^T Dhat A v = Dhat v` and `A J Dhat = J Dhat A`."""
    # neither condition depends on the units of d and v, the second not on the size of A
    D, v, unit = np.tile(d / power_of_two(d), 2), v / power_of_two(v), A / power_of_two(A)
    products = np.abs(A).T @ (D * (np.abs(A) @ np.abs(v)))
    scale = max(float(np.linalg.norm(products)), float(np.linalg.norm(D * v))) or 1.0
    energy = float(np.linalg.norm(A.T @ (D * (A @ v)) - D * v)) / scale
    generator = apply_form(np.diag(D))
    size = float(np.linalg.norm(unit) * D.max(initial=0.0)) or 1.0
    return (energy if energy < np.inf else np.inf), float(np.linalg.norm(unit @ generator - generator @ unit)) / size

"""Linear maps between the states of systems that keep inputs and outputs as they are.

A morphism from `(A1, B1, C1)` to `(A2, B2, C2)` is a matrix `L` with `L A1 = A2 L`, `L B1 = B2` and `C1 = C2 L`: it
takes the motions of the one system to motions of the other, for the same input, with the same output.  Morphisms
compose by the matrix product.
"""

from __future__ import annotations

from dataclasses import dataclass

import control as ct
import numpy as np
from scipy.linalg import null_space
from scipy.linalg.lapack import dgebal

from .. import _checks
from .._frozen import Frozen
from .._types import Array, ArrayLike
from ..exceptions import StructureError
from ..numerics.polynomials import cofactors
from ..symplectic.forms_and_williamson import symplectic_inverse
from ..systems.base import refuse_losses
from ..systems.lifting import lifted_size
from ..systems.port_hamiltonian import PortHamiltonian
from .unique_coordinates import norm_of, power_of_two, resonances

# --- the morphisms of the paper ----------------------------------------------------------------------------------


@np.errstate(over="ignore", invalid="ignore")  # what overflows is refused
def controllable_morphism(d: ArrayLike, v: ArrayLike | None = None, S: ArrayLike | None = None) -> Array:
    """Morphism from the controllable Hamiltonian system CH(d, v) to a port-Hamiltonian one.

    The target is `Q = S^T diag(d, d) S`, `B = S^{-1} v` (Theorem 3.3 (i) of the paper): structure is preserved for
    every symplectic `S`, and the image is the reachable part.

    Parameters
    ----------
    d : array_like, shape (n,)
        Natural frequencies, positive, in any order.
    v : array_like, shape (2n,)
        Input vector in Williamson coordinates; without it, an error says how to get both from a system.
    S : array_like, shape (2n, 2n), optional
        Symplectic matrix; default the identity.  The morphism to a `PortHamiltonian` has its `sys.d`,
        `sys.v` and `sys.S`.

    Returns
    -------
    ndarray, shape (2n, 2n)
        `L = S^{-1} [L_1 v .. L_{2n} v]`.  It is invertible iff the port-Hamiltonian system is canonical: all `d`
        differ and no `v_l^2 + v_{n+l}^2` is 0.  What it misses otherwise is told by `expressive_power`.

    Raises
    ------
    StructureError
        If `d`, `v` and `S` do not fit, `S` is not symplectic, or an entry of `L` exceeds the range of doubles.

    Notes
    -----
    The matrices `L_k` are never formed.  In the complex coordinate `x_l = q_l + i p_l` of mode l, whose pole is
    `-i d_l`, column k of `[L_1 v .. L_{2n} v]` is `v_l + i v_{n+l}` times the coefficient of `s^{k-1}` in
    `prod (s^2 + d_j^2) / (s + i d_l)`.  Nothing cancels: for `S = I` every entry has full relative accuracy.  O(n^3).

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.controllable_morphism([2.0], [1.0, 3.0])
    array([[ 6.,  1.],
           [-2.,  3.]])
    """
    frequencies, vector = _checks.parameter_pair(d, v)
    n = len(frequencies)
    b = cofactors(frequencies)
    low, high = vector[:n, None] * b, vector[n:, None] * b
    L = np.empty((2 * n, 2 * n))
    # -i d nu = d (v_low - i v_high) at the even places, nu at the odd ones
    L[:n, 0::2], L[n:, 0::2] = frequencies[:, None] * high, 0.0 - frequencies[:, None] * low
    L[:n, 1::2], L[n:, 1::2] = low, high
    _checks.representable(f"the entries of the morphism for {n} modes", L)
    if S is not None:
        L = symplectic_inverse(_checks.symplectic_matrix(S, 2 * n)) @ L
    return L


@np.errstate(over="ignore", invalid="ignore")  # what overflows is refused
def observable_morphism(sys: PortHamiltonian) -> Array:
    """Morphism from a port-Hamiltonian system to its observable Hamiltonian system OH(d, v).

    Theorem 3.3 (ii) of the paper, with `v = S B` (Section 3 prints `S^{-1} B` in places).  The image has all of the
    outputs; the kernel is what no output shows.

    Parameters
    ----------
    sys : PortHamiltonian
        System with one port and n degrees of freedom.

    Returns
    -------
    ndarray, shape (2n, 2n)
        `L` with the rows `B^T Q L_k`; the target has the frequencies `sys.d`, ascending, and 0 for rigid-body modes.
        It is invertible iff the system is canonical.

    Raises
    ------
    StructureError
        If the system is not a `PortHamiltonian` with one port, or an entry of `L` exceeds the range of doubles.

    Notes
    -----
    In modal coordinates row k is a sum over the modes of coefficients of `prod (s^2 + d_j^2) / (s + i d_l)`, as in
    `controllable_morphism`: no power of `J Q` is formed, and nothing cancels but what the coordinates of `sys` make
    cancel.  O(n^3).

    The composition with a lifting is the morphism to an observable system of any higher dimension, which has full
    expressive power although n is not known; see the example.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> sys = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> phc.observable_morphism(sys)
    array([[-4.,  0.],
           [ 0.,  1.]])

    A system of two modes with the same filter, the morphism to it, and the composition onto OH of dimension 4:

    >>> lifted = phc.ph(np.diag([4.0, 9.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 0.0])
    >>> phc.observable_morphism(lifted) @ phc.lift_morphism(sys, 2)
    array([[-36.,   0.],
           [  0.,   9.],
           [ -4.,   0.],
           [  0.,   1.]])
    """
    refuse_other_coordinates(sys, "morphisms to canonical forms", one_port=True)
    d, E, E0 = sys._energy
    rigid = sys.n - len(d)
    b = cofactors(np.concatenate([np.zeros(rigid), d]))
    # C z = Re((E B)^H E z) + (E0 B)^T E0 z, mode by mode
    seen = (E @ sys.B).conj() * E
    L = np.empty((2 * sys.n, 2 * sys.n))
    L[0::2] = b[rigid:].T @ (d[:, None] * seen.imag)
    L[1::2] = b[rigid:].T @ seen.real
    if rigid:
        L[1::2] += np.outer(b[0], (E0 @ sys.B)[:, 0] @ E0)
    _checks.representable(f"the entries of the morphism for {sys.n} modes", L)
    return L


def lift_morphism(sys: PortHamiltonian, m: int) -> Array:
    """Morphism from a port-Hamiltonian system to a lifted one with m degrees of freedom.

    The injective map `z -> O [I; 0] z` of Theorem 5.1 (ii) of the paper: `(q, p)` goes to `(q, 0, p, 0)`.

    Parameters
    ----------
    sys : PortHamiltonian
        System with n degrees of freedom and any number of ports.
    m : int
        Degrees of freedom of the lifted system, at least n.

    Returns
    -------
    ndarray, shape (2m, 2n)
        `L`; a morphism to `(O diag(Q, P) O^T, O [B; 0])` for every positive definite `P`.

    Raises
    ------
    StructureError
        If `sys` is not a `PortHamiltonian`, or `m` is not a whole number from n to 100000.

    Notes
    -----
    Exact: its entries are 0 and 1.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> phc.lift_morphism(phc.ph(np.eye(2), [1.0, 0.0]), 2)
    array([[1., 0.],
           [0., 0.],
           [0., 1.],
           [0., 0.]])
    """
    refuse_other_coordinates(sys, "morphisms", one_port=False)
    n = sys.n
    m = lifted_size(m, n)
    L = np.zeros((2 * m, 2 * n))
    L[:n, :n] = L[m : m + n, n:] = np.eye(n)
    return L


@dataclass(frozen=True, eq=False)
class ExpressivePower(Frozen):
    """States of a port-Hamiltonian system that the controllable form CH(d, v) can express; see `expressive_power`.

    Attributes
    ----------
    rank : int
        Rank of the morphism, the dimension of its image: the reachable states.
    dark : tuple of int
        Indices l of the modes that no input excites: `v_l = v_{n+l} = 0`.
    resonant : tuple of tuple of int
        Groups of modes with the same frequency; of each only one combination is excited.
    missing : ndarray, shape (2n, 2n - rank)
        Basis of the states that are missed, in the coordinates of the port-Hamiltonian system: the complement of
        the image that is orthogonal in the energy.  The output does not see it either, so it is also the kernel of
        the observable morphism.  Orthonormal for `S = I`.

    Examples
    --------
    >>> import ph_control as phc
    >>> power = phc.expressive_power([1.0, 2.0], [1.0, 0.0, 0.0, 0.0])
    >>> power.rank, power.dark, power.missing.shape
    (2, (1,), (4, 2))
    """

    rank: int
    dark: tuple[int, ...]
    resonant: tuple[tuple[int, ...], ...]
    missing: Array

    @property
    def is_full(self) -> bool:
        """Whether nothing is missed: the morphism is an isomorphism, the system canonical."""
        return self.missing.shape[1] == 0


def expressive_power(
    d: ArrayLike, v: ArrayLike | None = None, S: ArrayLike | None = None, *, rtol: float | None = None
) -> ExpressivePower:
    """Tell which states `controllable_morphism(d, v, S)` reaches, and which modes it cannot express.

    Parameters
    ----------
    d : array_like, shape (n,)
        Natural frequencies, positive, in any order.
    v : array_like, shape (2n,)
        Input vector in Williamson coordinates; without it, an error says how to get both from a system.
    S : array_like, shape (2n, 2n), optional
        Symplectic matrix; default the identity.
    rtol : float, optional
        Frequencies closer than `rtol * d` are one, and modes with `r d` below `rtol` times the largest are dark.
        Default `8 n eps` for frequencies, and exact zeros only for `r`, as in `ModalForm.minimal`.

    Returns
    -------
    ExpressivePower
        Rank, dark and resonant modes, and a basis of the missing states.

    Raises
    ------
    StructureError
        If `d`, `v` and `S` do not fit, `S` is not symplectic, or `rtol` is no tolerance.

    Notes
    -----
    Decided from the frequencies and weights, never from singular values of the morphism, whose columns may differ by
    a hundred orders of magnitude.  O(n^3) at worst, for the basis.

    Examples
    --------
    >>> import ph_control as phc
    >>> power = phc.expressive_power([1.0, 1.0, 2.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    >>> power.rank, power.dark, power.resonant
    (2, (1, 2), ((0, 1),))
    """
    frequencies, vector = _checks.parameter_pair(d, v)
    n = len(frequencies)
    nu = vector[:n] + 1j * vector[n:]
    root = np.sqrt(frequencies) * np.abs(nu)
    dark = (nu == 0) if rtol is None else root <= np.sqrt(_checks.relative_tolerance(rtol)) * root.max(initial=0.0)
    nu = np.where(dark, 0.0, nu)
    groups = resonances(frequencies, rtol)
    columns = [np.zeros((n, 0), complex)]
    for group in groups:
        unreached = null_space(nu[group].conj()[None]) if nu[group].any() else np.eye(len(group))
        columns.append(np.zeros((n, unreached.shape[1]), complex))
        columns[-1][group] = unreached
    W = np.concatenate(columns, axis=1)
    # a complex direction is two real ones, w and i w
    missing = np.concatenate([np.block([[W.real], [W.imag]]), np.block([[-W.imag], [W.real]])], axis=1)
    if S is not None:
        missing = symplectic_inverse(_checks.symplectic_matrix(S, 2 * n)) @ missing
    return ExpressivePower(
        2 * n - missing.shape[1],
        tuple(int(l) for l in np.flatnonzero(dark)),
        tuple(tuple(int(l) for l in group) for group in groups if len(group) > 1),
        missing,
    )


# --- what is a morphism ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MorphismCheck:
    """Residuals of a matrix as a morphism; true if it is one.  See `is_morphism`.

    Attributes
    ----------
    dynamics : float
        Relative size of `L A1 - A2 L`.
    input : float
        Relative size of `L B1 - B2`.
    output : float
        Relative size of `C1 - C2 L`, and of `D1 - D2`.
    allowed : float
        What the three are held against.
    rank : int
        Numerical rank of `L`, after scaling its rows and columns.
    injective : bool
        Whether the rank is the number of columns: no state of the first system is lost.
    surjective : bool
        Whether the rank is the number of rows: every state of the second system is reached.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> spring = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> check = phc.is_morphism(2 * np.eye(2), spring, spring)
    >>> bool(check), check.dynamics, check.injective
    (False, 0.0, True)
    """

    dynamics: float
    input: float
    output: float
    allowed: float
    rank: int
    injective: bool
    surjective: bool

    @property
    def residual(self) -> float:
        """Largest of the three residuals."""
        return max(self.dynamics, self.input, self.output)

    def __bool__(self) -> bool:
        return self.residual <= self.allowed


@np.errstate(over="ignore", invalid="ignore")  # what overflows is refused
def is_morphism(L: ArrayLike, sys1: ct.StateSpace, sys2: ct.StateSpace, *, rtol: float | None = None) -> MorphismCheck:
    """Measure whether `L` is a morphism: `L A1 = A2 L`, `L B1 = B2`, `C1 = C2 L` (and `D1 = D2`).

    Parameters
    ----------
    L : array_like, shape (n2, n1)
        Matrix from the states of `sys1` to those of `sys2`.
    sys1, sys2 : control.StateSpace
        Systems of n1 and n2 states with the same numbers of inputs and outputs and the same time base.
    rtol : float, optional
        Allowed relative residual; default `100 N eps` with N the larger number of states.

    Returns
    -------
    MorphismCheck
        The three residuals, the rank, and whether `L` is injective and surjective; true if `L` is a morphism.

    Raises
    ------
    StructureError
        If the shapes, the ports or the time bases do not fit, or `rtol` is no tolerance.

    Notes
    -----
    The states of both systems are balanced first, by powers of two, so that their units do not matter; then
    `||L A1 - A2 L|| / (||L|| ||A1|| + ||A2|| ||L||)` in the Frobenius norm, and for each port
    `||L b1 - b2|| / (||L|| ||b1|| + ||b2||)` and `||c1 - c2 L|| / (||c1|| + ||c2|| ||L||)`, where of a
    port-Hamiltonian system the size of the terms of `B^T Q` counts for `||c||`: so much of it is rounding.  Invertible
    morphisms are isomorphisms.  O(N^3).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> spring = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> check = phc.is_morphism(np.eye(2), spring, spring)
    >>> bool(check), check.residual, check.rank
    (True, 0.0, 2)
    >>> bool(phc.is_morphism(2 * np.eye(2), spring, spring))
    False
    """
    comparable(sys1, sys2)
    matrix = _checks.real_array("L", L, 2)
    if matrix.shape != (sys2.nstates, sys1.nstates):
        raise StructureError(
            f"L has shape {matrix.shape}; from {sys1.nstates} states to {sys2.nstates} it must be "
            f"({sys2.nstates}, {sys1.nstates})"
        )
    size = max(matrix.shape)
    allowed = 100 * max(1, size) * _checks.EPS if rtol is None else _checks.relative_tolerance(rtol)
    scale1, A1, B1, C1, D1 = balanced(sys1)
    scale2, A2, B2, C2, D2 = balanced(sys2)
    matrix = matrix * scale1 / scale2[:, None]
    whole = float(norm_of(matrix))
    dynamics = _ratio(norm_of(matrix @ A1 - A2 @ matrix), whole * (norm_of(A1) + norm_of(A2)))
    entering = _ratio(norm_of(matrix @ B1 - B2, axis=0), whole * norm_of(B1, axis=0) + norm_of(B2, axis=0))
    seen1, seen2 = _rounded_readout(sys1) * scale1, _rounded_readout(sys2) * scale2
    leaving = _ratio(norm_of(C1 - C2 @ matrix, axis=1), norm_of(seen1, axis=1) + whole * norm_of(seen2, axis=1))
    direct = _ratio(np.abs(D1 - D2), np.maximum(np.abs(D1), np.abs(D2)))
    _checks.representable("the products of L and these systems", matrix, np.array([dynamics, entering, leaving]))
    rank, (rows, columns) = _scaled_rank(matrix), matrix.shape
    return MorphismCheck(dynamics, entering, max(leaving, direct), allowed, rank, rank == columns, rank == rows)


def _rounded_readout(sys: ct.StateSpace) -> Array:
    """Size of the terms that make up each entry of C, of which it has the rounding error."""
    terms = np.abs(sys.B).T @ np.abs(sys.Q) if isinstance(sys, PortHamiltonian) else np.abs(sys.C)
    return np.asarray(terms, float)


def _ratio(residual: Array | float, scale: Array | float) -> float:
    """Largest quotient, 0/0 = 0."""
    return float(np.max(residual / np.where(scale > 0, scale, 1.0), initial=0.0))


def balanced(sys: ct.StateSpace) -> tuple[Array, Array, Array, Array, Array]:
    """`(t, A, B, C, D)` in the states `z / t`, with powers of two `t` such that the units of states drop out."""
    A, B, C, D = (np.asarray(M, dtype=float) for M in (sys.A, sys.B, sys.C, sys.D))
    for name, M in zip("ABCD", (A, B, C, D), strict=True):
        _checks.finite(f"{name} of a system", M)
    n = len(A)
    if n == 0:
        return np.ones(0), A, B, C, D
    # A and B per rate, so that the unit of time drops out as well: A and B carry it, C does not
    rate = float(norm_of(dgebal(A / power_of_two(A), scale=1)[0])) * power_of_two(A) or 1.0
    whole = A / rate
    if len(C) == B.shape[1]:
        whole = np.block([[whole, B / rate], [C, np.zeros((len(C), B.shape[1]))]])
    t = dgebal(whole, scale=1)[3][:n]
    power = np.frexp(t)[1]
    return t, np.ldexp(A, power - power[:, None]), B / t[:, None], C * t, D


def _scaled_rank(L: Array) -> int:
    """Numerical rank of `L` after scaling rows and columns to largest entries near 1, those of mere rounding apart."""
    size = np.abs(L)
    noise = max(L.shape) * _checks.EPS * size.max(initial=0.0)
    L = L[np.ix_(size.max(axis=1, initial=0.0) > noise, size.max(axis=0, initial=0.0) > noise)]
    if L.size == 0:
        return 0
    for axis in (1, 0, 1, 0):
        L = L / np.abs(L).max(axis=axis, keepdims=True)
    return int(np.linalg.matrix_rank(L))


# --- arguments ---------------------------------------------------------------------------------------------------


def comparable(sys1: ct.StateSpace, sys2: ct.StateSpace) -> None:
    """Refuse two systems between which no morphism can be: kinds, ports, time bases."""
    for name, sys in (("sys1", sys1), ("sys2", sys2)):
        if not isinstance(sys, ct.StateSpace):
            raise StructureError(
                f"{name} is of type {type(sys).__name__}; a morphism goes between states, so pass a "
                "control.StateSpace (control.ss of a transfer function)"
            )
    if (sys1.ninputs, sys1.noutputs) != (sys2.ninputs, sys2.noutputs):
        raise StructureError(
            f"the systems have {sys1.ninputs} inputs and {sys1.noutputs} outputs, and {sys2.ninputs} and "
            f"{sys2.noutputs}; a morphism keeps inputs and outputs, so the numbers must agree"
        )
    try:
        ct.common_timebase(sys1.dt, sys2.dt)
    except ValueError:
        raise StructureError(
            f"the systems have the time bases dt = {sys1.dt} and dt = {sys2.dt}; both must be continuous, or discrete "
            "with the same step"
        ) from None


def refuse_other_coordinates(sys: PortHamiltonian, what: str, *, one_port: bool) -> None:
    """Refuse what has no states `(q, p)`, or several ports where one is needed."""
    refuse_losses(sys, f"{what} are")
    if not isinstance(sys, PortHamiltonian):
        raise StructureError(
            f"this is a {type(sys).__name__}, expected a PortHamiltonian: {what} are those of its states; convert it "
            "by ph(sys)"
        )
    if one_port and sys.ninputs != 1:
        raise StructureError(f"the system has {sys.ninputs} ports, expected 1: {what} are those of one port")

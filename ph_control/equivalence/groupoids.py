"""The two groupoids whose orbits are the equivalence classes of port-Hamiltonian systems and of pairs `(d, v)`.

An instance is an arrow, from its source to its target.  `g @ f` is the arrow f followed by the arrow g, for
`f.target` equal to `g.source`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .. import _checks
from .._frozen import Frozen
from .._types import Array, ArrayLike
from ..exceptions import StructureError
from ..numerics import definiteness as _definite
from ..symplectic.forms_and_williamson import apply_form
from ..systems.port_hamiltonian import PortHamiltonian
from .isomorphism import are_isomorphic
from .morphisms import refuse_other_coordinates
from .relations import reduced_residuals, star_equivalent
from .unique_coordinates import power_of_two


class _Arrow(Frozen):
    """Base of the arrows of both groupoids."""

    __array_ufunc__ = None  # an array beside an arrow is an error, not a table of arrows

    @classmethod
    def _takes(cls, *parts: object) -> bool:
        """Whether the constructor takes them."""
        try:
            cls(*parts)
        except StructureError:
            return False
        return True


@dataclass(frozen=True, eq=False)
class PortHamiltonianGroupoid(_Arrow):
    """Arrow `(L, (Q, B))` of the port-Hamiltonian groupoid, an isomorphism of systems of one port with its source.

    Its target is `(J^T L J Q L^{-1}, L B)`.  Definition 4.10 of the paper; the orbits are the classes of `~sys`.

    Parameters
    ----------
    L : array_like, shape (2n, 2n)
        Invertible matrix such that `J^T L J Q L^{-1}` is symmetric positive definite and `B = J^T L^T J L B`.
    source : PortHamiltonian
        The system `(Q, B)`, with one port and a positive definite Q.

    Raises
    ------
    StructureError
        If the source is no such system, or `L` is not an arrow from it, with what was measured.

    Notes
    -----
    `L` need be symplectic only on the reachable part.  Each condition is held against `1000 * 2n * eps` of the
    products that it is made of.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> arrow = phc.PortHamiltonianGroupoid(np.diag([2.0, 0.5]), phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]))
    >>> arrow.target.Q, arrow.target.B
    (array([[1., 0.],
           [0., 4.]]), array([[0. ],
           [0.5]]))
    >>> (arrow.inverse() @ arrow).L
    array([[1., 0.],
           [0., 1.]])
    """

    L: Array
    source: PortHamiltonian

    def __post_init__(self) -> None:
        _one_port(self.source)
        object.__setattr__(self, "L", _invertible("L", self.L, self.source.nstates))
        super().__post_init__()
        self._refuse_no_arrow()

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is no arrow
    def _refuse_no_arrow(self) -> None:
        """Hold `L` against the conditions, none of which depends on the units of Q and B."""
        L, Q, B = self.L, self.source.Q / power_of_two(self.source.Q), self.source.B / power_of_two(self.source.B)
        inverse, turned = np.linalg.inv(L), _conjugate(L)
        moved = turned @ Q @ inverse
        products = np.abs(turned) @ np.abs(Q) @ np.abs(inverse)
        port_products = np.abs(L).T @ np.abs(apply_form(np.abs(L) @ np.abs(B)))
        refused = "L is not an arrow from this system: "
        residuals = {
            "J^T L J Q L^-1 is not symmetric: off": _relative(moved - moved.T, products),
            "B differs from J^T L^T J L B": _relative(B + apply_form(L.T @ apply_form(L @ B)), port_products),
        }
        _refuse_off(refused, len(L), residuals)
        smallest, tolerance = _definite.smallest_scaled_eigenvalue(0.5 * (moved + moved.T))
        if smallest <= tolerance or np.diag(moved).min(initial=np.inf) <= 0:
            raise StructureError(
                f"{refused}J^T L J Q L^-1 is not positive definite: smallest eigenvalue after scaling {smallest:.3g}, "
                f"expected > {tolerance:.1e}"
            )

    @cached_property
    def target(self) -> PortHamiltonian:
        """System `(J^T L J Q L^{-1}, L B)` at which the arrow ends."""
        moved = np.linalg.solve(self.L.T, (_conjugate(self.L) @ self.source.Q).T).T
        return PortHamiltonian(0.5 * (moved + moved.T), self.L @ self.source.B)

    def __matmul__(self, other: PortHamiltonianGroupoid) -> PortHamiltonianGroupoid:
        """Arrow `other` followed by this one, `(L1 L2, (Q2, B2))`."""
        if not isinstance(other, PortHamiltonianGroupoid):
            return NotImplemented
        target, source = ((system.Q, system.B) for system in (other.target, self.source))
        _composable(target, source, _condition(other.L))
        return PortHamiltonianGroupoid(self.L @ other.L, other.source)

    def inverse(self) -> PortHamiltonianGroupoid:
        """Arrow `(L^{-1}, target)` from the target back to the source.

        Returns
        -------
        PortHamiltonianGroupoid
            The inverse.

        Examples
        --------
        See `PortHamiltonianGroupoid`.
        """
        return PortHamiltonianGroupoid(np.asarray(np.linalg.inv(self.L), float), self.target)

    @classmethod
    def identity(cls, source: PortHamiltonian) -> PortHamiltonianGroupoid:
        """Arrow from a system to itself that changes nothing.

        Parameters
        ----------
        source : PortHamiltonian
            The system.

        Returns
        -------
        PortHamiltonianGroupoid
            The unit at this system.

        Raises
        ------
        StructureError
            If it is no `PortHamiltonian` of one port with a positive definite Q.

        Examples
        --------
        See `PortHamiltonianGroupoid`.
        """
        _one_port(source)
        return cls(np.eye(source.nstates), source)

    @classmethod
    def between(
        cls, source: PortHamiltonian, target: PortHamiltonian, *, rtol: float | None = None
    ) -> PortHamiltonianGroupoid:
        """Arrow from one system to another that is isomorphic to it.

        Parameters
        ----------
        source, target : PortHamiltonian
            Systems of one port with positive definite Hamiltonians.
        rtol : float, optional
            Tolerance of `are_isomorphic`.

        Returns
        -------
        PortHamiltonianGroupoid
            An arrow; if the systems are canonical, the only one.

        Raises
        ------
        StructureError
            If the systems are not isomorphic, for the reason that `are_isomorphic` gives.

        Examples
        --------
        See `PortHamiltonianGroupoid`.
        """
        _one_port(source)
        _one_port(target)
        verdict = are_isomorphic(source, target, rtol=rtol)
        if not verdict:
            raise StructureError(f"there is no arrow between systems that are not isomorphic: {verdict.reason}")
        return cls(verdict.witness, source)

    @classmethod
    def is_arrow(cls, L: ArrayLike, source: PortHamiltonian) -> bool:
        """Tell whether `(L, source)` is an arrow.

        Parameters
        ----------
        L : array_like, shape (2n, 2n)
            Matrix.
        source : PortHamiltonian
            System.

        Returns
        -------
        bool
            Whether the constructor takes them.

        Raises
        ------
        StructureError
            If an argument is no array of numbers.

        Examples
        --------
        See `PortHamiltonianGroupoid`.
        """
        return cls._takes(L, source)


@dataclass(frozen=True, eq=False)
class ReducedGroupoid(_Arrow):
    """Arrow `((P, A), (d, v))` of the reduced port-Hamiltonian groupoid.

    Its source is `(d, v)`, its target `(P d, diag(P, P) A v)`; the orbits are the classes of `~star`.  Definition 4.12
    of the paper prints these two the other way round, so that the pairs it calls composable have no product in the
    groupoid; corrected here.

    Parameters
    ----------
    P : array_like, shape (n, n)
        Permutation matrix.
    A : array_like, shape (2n, 2n)
        Invertible matrix with `A^T Dhat A v = Dhat v` and `A J Dhat = J Dhat A`, `Dhat = diag(d, d)`.
    d : array_like, shape (n,)
        Natural frequencies of the source.
    v : array_like, shape (2n,)
        Input vector of the source.

    Raises
    ------
    StructureError
        If `(P, A)` is not an arrow from `(d, v)`, with what was measured.

    Notes
    -----
    Each condition is held against `1000 * 2n * eps` of the products that it is made of.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> arrow = phc.ReducedGroupoid(np.eye(2)[[1, 0]], np.eye(4), [1.0, 2.0], [3.0, 4.0, 0.0, 0.0])
    >>> arrow.target
    (array([2., 1.]), array([4., 3., 0., 0.]))
    >>> (arrow.inverse() @ arrow).P
    array([[1., 0.],
           [0., 1.]])
    """

    P: Array
    A: Array
    d: Array
    v: Array

    def __post_init__(self) -> None:
        d, v = _checks.parameter_pair(self.d, self.v)
        P = _checks.real_array("P", self.P, 2)
        n = len(d)
        A = _invertible("A", self.A, 2 * n)
        for name, value in (("P", P), ("A", A), ("d", d), ("v", v)):
            object.__setattr__(self, name, value)
        super().__post_init__()
        if P.shape != (n, n) or not (np.isin(P, (0, 1)).all() and np.array_equal(P @ P.T, np.eye(n))):
            raise StructureError(
                f"P is not a permutation matrix of {n} modes: its shape is {P.shape}; it needs a single 1 in each row "
                "and column, and 0 elsewhere"
            )
        conditions = "A^T Dhat A v = Dhat v is off", "A J Dhat = J Dhat A is off"
        residuals = dict(zip(conditions, reduced_residuals(A, d, v), strict=True))
        _refuse_off("(P, A) is not an arrow from this (d, v): ", 2 * n, residuals)

    @property
    def source(self) -> tuple[Array, Array]:
        """Pair `(d, v)` at which the arrow starts."""
        return self.d, self.v

    @cached_property
    def target(self) -> tuple[Array, Array]:
        """Pair `(P d, diag(P, P) A v)` at which the arrow ends."""
        return _checks.readonly(self.P @ self.d), _checks.readonly(np.kron(np.eye(2), self.P) @ (self.A @ self.v))

    def __matmul__(self, other: ReducedGroupoid) -> ReducedGroupoid:
        """Arrow `other` followed by this one, `((P2 P1, P1^T A2 P1 A1), (d1, v1))`."""
        if not isinstance(other, ReducedGroupoid):
            return NotImplemented
        _composable(other.target, self.source, _condition(other.A))
        both = np.kron(np.eye(2), other.P)
        return ReducedGroupoid(self.P @ other.P, both.T @ self.A @ both @ other.A, *other.source)

    def inverse(self) -> ReducedGroupoid:
        """Arrow `((P^T, P A^{-1} P^T), target)` from the target back to the source.

        Returns
        -------
        ReducedGroupoid
            The inverse.

        Examples
        --------
        See `ReducedGroupoid`.
        """
        both = np.kron(np.eye(2), self.P)
        return ReducedGroupoid(self.P.T, both @ np.linalg.inv(self.A) @ both.T, *self.target)

    @classmethod
    def identity(cls, d: ArrayLike, v: ArrayLike) -> ReducedGroupoid:
        """Arrow from a pair to itself that changes nothing.

        Parameters
        ----------
        d : array_like, shape (n,)
            Natural frequencies.
        v : array_like, shape (2n,)
            Input vector.

        Returns
        -------
        ReducedGroupoid
            The unit at this pair.

        Raises
        ------
        StructureError
            If `d` and `v` do not fit.

        Examples
        --------
        See `ReducedGroupoid`.
        """
        frequencies, vector = _checks.parameter_pair(d, v)
        n = len(frequencies)
        return cls(np.eye(n), np.eye(2 * n), frequencies, vector)

    @classmethod
    def between(
        cls, d1: ArrayLike, v1: ArrayLike, d2: ArrayLike, v2: ArrayLike, *, rtol: float | None = None
    ) -> ReducedGroupoid:
        """Arrow from one pair to another that is `~star` equivalent to it.

        Parameters
        ----------
        d1 : array_like, shape (n,)
            Natural frequencies of the source.
        v1 : array_like, shape (2n,)
            Its input vector.
        d2 : array_like, shape (n,)
            Natural frequencies of the target.
        v2 : array_like, shape (2n,)
            Its input vector.
        rtol : float, optional
            Tolerance of `star_equivalent`.

        Returns
        -------
        ReducedGroupoid
            An arrow.

        Raises
        ------
        StructureError
            If the pairs are not equivalent, for the reason that `star_equivalent` gives.

        Examples
        --------
        See `ReducedGroupoid`.
        """
        verdict = star_equivalent(d1, v1, d2, v2, rtol=rtol)
        if not verdict:
            raise StructureError(f"there is no arrow between pairs that are not equivalent: {verdict.reason}")
        P, A = verdict.witness
        return cls(P, A, *_checks.parameter_pair(d1, v1))

    @classmethod
    def is_arrow(cls, P: ArrayLike, A: ArrayLike, d: ArrayLike, v: ArrayLike) -> bool:
        """Tell whether `((P, A), (d, v))` is an arrow.

        Parameters
        ----------
        P : array_like, shape (n, n)
            Matrix.
        A : array_like, shape (2n, 2n)
            Matrix.
        d : array_like, shape (n,)
            Natural frequencies.
        v : array_like, shape (2n,)
            Input vector.

        Returns
        -------
        bool
            Whether the constructor takes them.

        Raises
        ------
        StructureError
            If an argument is no array of numbers.

        Examples
        --------
        See `ReducedGroupoid`.
        """
        return cls._takes(P, A, d, v)


def _one_port(system: PortHamiltonian) -> None:
    """Refuse what is no object of the groupoid."""
    refuse_other_coordinates(system, "groupoids", one_port=True)
    if len(system.d) != system.n:
        raise StructureError(
            f"Q is only positive semidefinite: {system.n - len(system.d)} of {system.n} degrees of freedom have no "
            "frequency; the groupoid is that of positive definite Q"
        )


def _invertible(name: str, M: ArrayLike, size: int) -> Array:
    """Check an invertible matrix of given size."""
    array = _checks.real_array(name, M, 2)
    if array.shape != (size, size):
        raise StructureError(f"{name} has shape {array.shape}, expected ({size}, {size})")
    condition = _condition(array)
    if not condition * _checks.EPS < 1:
        raise StructureError(
            f"{name} is not invertible: its condition number is {condition:.1e}, allowed {1 / _checks.EPS:.1e}"
        )
    return array


def _condition(M: Array) -> float:
    return float(np.linalg.cond(M)) if M.size else 1.0


def _composable(target: tuple[Array, Array], source: tuple[Array, Array], condition: float) -> None:
    """Refuse two arrows if the target of the first is not the source of the second."""
    size, other = len(target[1]), len(source[1])
    if size != other:
        raise StructureError(f"the arrows do not compose: they are of {size} and {other} states")
    mismatch = max(_relative(a - b, np.maximum(np.abs(a), np.abs(b))) for a, b in zip(target, source, strict=True))
    allowed = _allowed(size) * condition
    if mismatch > allowed:
        raise StructureError(
            "the arrows do not compose: the target of the right one differs from the source of the left one by "
            f"{mismatch:.1e} of their size, allowed {allowed:.1e}"
        )


def _conjugate(L: Array) -> Array:
    """`J^T L J` without forming J."""
    return apply_form(apply_form(L.T).T)


def _refuse_off(refused: str, size: int, residuals: dict[str, float]) -> None:
    for condition, residual in residuals.items():
        if residual > _allowed(size):
            raise StructureError(
                f"{refused}{condition} by {residual:.1e} of the products in it, allowed {_allowed(size):.1e}"
            )


def _allowed(size: int) -> float:
    return 1000 * max(1, size) * _checks.EPS


def _relative(residual: Array, products: Array) -> float:
    unit = power_of_two(products)
    size = float(np.linalg.norm(products / unit))
    ratio = float(np.linalg.norm(residual / unit)) / (size or 1.0)
    return ratio if ratio < np.inf else np.inf

"""Large structures as they are: sparse matrices, their response, their models of few modes and what these leave out."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu

from .. import _checks
from .._types import Array, ComplexArray, SystemNames, Unpack
from .._units import DERIVATIVES
from ..exceptions import StructureError
from ..numerics.shift_invert import Pencil
from ..systems.port_hamiltonian import PortHamiltonian
from .massless import refuse_massless
from .modal_reduction import StructuralModes, dense, projected_damping, sparse_matrix
from .second_order import from_second_order, measured_rows

_ORDERS = {"position": 0, **DERIVATIVES}
_UNCOUPLED = 1e-10  # of the forces of dampers: what does not couple modes kept to those left out
_SPREAD = np.array([-8.0, -4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0, 8.0])  # damping ratios beside a resonance
_BETWEEN = 200  # further frequencies at which the bound is evaluated
_UNDAMPED, _APART = 1e-12, 1e-6  # damping ratio of a mode that has none, and how far from it, of the band
_LOWEST = 1e-3  # of the band: the least of them


class SecondOrderSystem:
    """Large structure `M q'' + C q' + K q = F u`, `y = F^T q'`, whose matrices stay sparse.

    `reduce` makes a port-Hamiltonian system of it, without a dense matrix of its size.

    Parameters
    ----------
    M, K : array_like or sparse array, shape (n, n)
        Mass matrix, symmetric positive definite, and stiffness matrix, symmetric positive semidefinite.
    F : array_like or sparse array, shape (n,) or (n, m)
        Where the forces act, one column for each port.
    C : array_like or sparse array, shape (n, n), optional
        Damping matrix, symmetric positive semidefinite; default none.
    sensors : dict of array_like, shape (k, n), or array_like, optional
        Rows of further outputs, as of `from_second_order`.
    condense : bool
        Whether degrees of freedom may have no mass; they follow the others.
    **names
        `name`, `inputs`, `outputs` of the systems that are made of it.

    Raises
    ------
    StructureError
        As by `from_second_order`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> from scipy import sparse
    >>> row = 2 * sparse.eye_array(60) - sparse.eye_array(60, k=1) - sparse.eye_array(60, k=-1)
    >>> M, K = sparse.eye_array(3600), sparse.kronsum(row, row, format="csc")
    >>> plate = phc.SecondOrderSystem(M, K, np.eye(3600)[1000], C=0.002 * K)
    >>> small = phc.reduce(plate, 12)
    >>> small.nstates, bool(abs(small(0.1j) - plate(0.1j)) < small.error_bound)
    (12, True)
    """

    def __init__(
        self,
        M: ArrayLike | sparse.sparray,
        K: ArrayLike | sparse.sparray,
        F: ArrayLike | sparse.sparray,
        *,
        C: ArrayLike | sparse.sparray | None = None,
        sensors: Mapping[str, ArrayLike] | ArrayLike | None = None,
        condense: bool = False,
        **names: Unpack[SystemNames],
    ) -> None:
        advice = {"G": "a gyroscopic matrix couples all modes: from_second_order takes it"}
        _checks.known_keywords("SecondOrderSystem", names, ("C", "sensors", "condense"), advice)
        _checks.flags(condense=condense)
        self.M = sparse_matrix("M", M)
        n = self.M.shape[0]
        self.K = sparse_matrix("K", K, n)
        self.C = None if C is None else sparse_matrix("C", C, n)
        self.F = _checks.port_matrix(dense(F), n, name="F")
        self.sensors = measured_rows(sensors, n)
        self._condense, self._names = condense, names
        refuse_massless(self.M, (self.C,), self.F, condense)

    def __repr__(self) -> str:
        """Say how large it is."""
        sensed = sum(len(rows) for rows in self.sensors.values())
        return f"<SecondOrderSystem: {len(self.F)} degrees of freedom, {self.F.shape[1]} ports, {sensed} sensors>"

    def __call__(self, s: ArrayLike) -> complex | ComplexArray:
        """Transfer function at complex points, by a sparse factorisation for each.

        Parameters
        ----------
        s : complex or array_like, shape (N,)
            Points, such as `1j * omega`; none of them a pole.

        Returns
        -------
        complex or ndarray
            A number for one port without sensors at a number `s`, else of shape (p, m), (N,) or (p, m, N); outputs
            of the ports before those of the sensors.
        """
        points = _checks.complex_points("the points", s)
        values = np.empty((len(self.rows), self.F.shape[1], len(points)), complex)
        none = sparse.csc_array(self.K.shape)
        for k, point in enumerate(points):
            try:
                lu = splu((self.K + point * (none if self.C is None else self.C) + point**2 * self.M).tocsc())
            except RuntimeError:
                raise StructureError(f"s = {point:.6g} is a pole of the structure; choose another point") from None
            values[:, :, k] = point ** self.derivatives[:, None] * (self.rows @ lu.solve(self.F + 0j))
        if values.shape[:2] == (1, 1):
            values = values[0, 0]
        return values if np.ndim(s) else values[..., 0]

    def modal_model(self, modes: int | None = None, band: tuple[float, float] | None = None) -> PortHamiltonian:
        """Model of the lowest modes, or those in a band, and residual modes: `from_second_order` of these matrices.

        Parameters
        ----------
        modes : int, optional
            Number of the lowest modes.
        band : (float, float), optional
            Natural frequencies to keep, rad per unit time.

        Returns
        -------
        PortHamiltonian
            With the modes in `structural_modes`.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> K = 2 * np.eye(50) - np.eye(50, k=1) - np.eye(50, k=-1)
        >>> phc.SecondOrderSystem(np.eye(50), K, np.eye(50)[0]).modal_model(modes=3).d[:3].round(4)
        array([0.0616, 0.1231, 0.1845])
        """
        return from_second_order(
            self.M, self.K, self.F, C=self.C, sensors=self.sensors or None, modes=modes, band=band,
            condense=self._condense, **self._names,
        )  # fmt: skip

    @cached_property
    def rows(self) -> Array:
        """Rows of the outputs of displacement, of which they are derivatives."""
        return np.vstack([self.F.T, *self.sensors.values()])

    @cached_property
    def derivatives(self) -> Array:
        """Number of time derivatives that each output takes."""
        orders = [np.full(len(rows), _ORDERS[kind]) for kind, rows in self.sensors.items()]
        return np.concatenate([np.ones(self.F.shape[1], int), *orders]).astype(int)


def truncation_errors(
    structure: SecondOrderSystem, kept: StructuralModes, low: float, high: float
) -> tuple[Array, Array]:
    """Frequencies of a band, dense at resonances, and bounds of the difference of a structure from its modes there."""
    if not high < kept.complete_below:
        return np.array([high]), np.array([np.inf])
    truncation = _Truncation(structure, kept)
    omega = _frequencies(kept, truncation.damping, low, high)
    return omega, np.array([truncation.bound(w) for w in omega])


class _Truncation:
    """Bound of what a model of modes leaves out, at any frequency below the modes that it leaves out.

    With `A(s) = K + s C + s^2 M`, the displacements `x = V q` of the model leave forces `r = F - A V q` that do no work
    on `V`, so that outputs `l^T x` are wrong by `r_l^T A^{-1} r`, `r_l` those that are left of `l`.  Beside the modes
    kept, which have all natural frequencies below `D`,

        Re z^H A(j w) z >= (1 - w^2 / D^2 - delta) z^H K z,

    where `delta` is what dampers make of the motion of the modes kept; so the error is at most the product of both
    forces in the norm of `K^{-1}` over that factor.  All forces are combinations of few, which are solved for once.
    """

    def __init__(self, structure: SecondOrderSystem, kept: StructuralModes) -> None:
        modes, stiff = kept.shapes, kept.residual_shapes
        self.structure, self.kept, self.edge = structure, kept, kept.complete_below
        basis = np.hstack([modes, stiff])
        self.squares = np.concatenate([kept.natural_frequencies, kept.residual_frequencies]) ** 2
        damping = None if structure.C is None else projected_damping(structure.C, basis)
        self.damping = np.zeros((basis.shape[1],) * 2) if damping is None else damping
        self.reached, self.seen = basis.T @ structure.F, basis.T @ structure.rows.T
        momenta = structure.M @ modes

        def beside(forces: Array) -> Array:
            return forces - momenta @ (modes.T @ forces)

        damped = np.zeros_like(basis) if structure.C is None else structure.C @ basis
        by_modes = beside(damped[:, : modes.shape[1]])
        if np.linalg.norm(by_modes) <= _UNCOUPLED * np.linalg.norm(damped):
            by_modes = np.zeros_like(by_modes)
        blocks = [beside(structure.rows.T), structure.K @ stiff, structure.M @ stiff]
        blocks += [beside(damped[:, modes.shape[1] :]), by_modes[:, by_modes.any(axis=0)]]
        self.coupled = by_modes.any(axis=0)
        self.ends = np.cumsum([block.shape[1] for block in blocks])
        forces = np.hstack(blocks)
        pencil = Pencil(structure.K, structure.M)
        moved = pencil.factor(pencil.low).solve(forces)
        moved -= modes @ (momenta.T @ moved)
        gram = forces.T @ moved
        # by the shift below zero the factor is of a stiffer matrix
        self.gram = 0.5 * (gram + gram.T) * (1 - pencil.low / self.edge**2)

    def bound(self, w: float) -> float:
        """Bound of the difference of the responses at a frequency."""
        s, k = 1j * w, self.kept.shapes.shape[1]
        A = np.diag(self.squares - w**2) + s * self.damping
        ports = self.reached.shape[1]
        q = np.linalg.solve(A, self.seen.astype(complex))
        q_modes, q_stiff = q[:k], q[k:]
        unit = np.eye(q.shape[1])
        parts = np.vstack([unit, -q_stiff, w**2 * q_stiff, -s * q_stiff, -s * q_modes[self.coupled]])
        forces = parts.conj().T @ self.gram @ parts
        rates = w ** self.structure.derivatives.astype(float)
        into = np.linalg.norm(forces[:ports, :ports], 2)
        out = np.linalg.norm(rates[:, None] * forces * rates, 2)
        margin = 1 - (w / self.edge) ** 2 - self._by_dampers(w, A[:k, :k])
        return float(np.sqrt(into * out) / margin) if margin > 0 else np.inf

    def _by_dampers(self, w: float, A: ComplexArray) -> float:
        """Part of the stiffness beside the modes that the motion of the modes may take away, by dampers."""
        if not self.coupled.any():
            return 0.0
        inside = self.gram[self.ends[-2] :, self.ends[-2] :]
        k, U = np.linalg.eigh(inside)
        root = U * np.sqrt(np.maximum(k, 0.0))
        answers = np.linalg.inv(A)[np.ix_(self.coupled, self.coupled)]
        return float(w**2 * np.linalg.norm(root.T @ answers @ root, 2))


def _frequencies(kept: StructuralModes, damping: Array, low: float, high: float) -> Array:
    """Frequencies of a band, dense at resonances."""
    d = kept.natural_frequencies
    widths = np.minimum(np.diag(damping)[: len(d)] / 2, 0.1 * d)
    near = (d[:, None] + widths[:, None] * _SPREAD).ravel()
    even = np.linspace(max(low, _LOWEST * high), high, _BETWEEN)
    omega = np.unique(np.concatenate([even, near[(near > even[0]) & (near < high)]]))
    # not at a pole
    away = np.abs(omega[:, None] - d[widths <= _UNDAMPED * d]) > _APART * high
    return np.asarray(omega[away.all(axis=1)], float)

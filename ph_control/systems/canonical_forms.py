"""Controllable and observable Hamiltonian canonical forms.

Both are views of the pairs `(d, v)`: companion matrices made of positive products.
They compute on modal coordinates; the coefficients are for looking at and for handing on.
"""

from __future__ import annotations

import warnings
from typing import TypeVar, cast

import numpy as np

from .. import _checks
from .._types import Array, ArrayLike, SystemNames, Unpack
from ..exceptions import ConditioningWarning, StructureError
from ..modal.modal_form import ModalForm
from ..numerics.polynomials import digits
from ..symplectic.forms_and_williamson import symplectic_inverse
from .base import Convertible, LosslessSystem, View, inherited_names, refuse_losses, restored
from .port_hamiltonian import PortHamiltonian, full_port_hamiltonian

Form = TypeVar("Form", bound="_CanonicalForm")

_ENOUGH = 6.0  # decimal digits of the frequencies that a companion matrix should carry


class _CanonicalForm(LosslessSystem):
    """Base of both forms: the parameters, their modes, and the coefficients."""

    def __init__(self, d: ArrayLike, v: ArrayLike, **names: Unpack[SystemNames]) -> None:
        self._fill(*_checks.hamiltonian_parameters(d, v), names)

    def _fill(self, d: Array, v: Array, names: SystemNames) -> None:
        self._d, self._v = _checks.readonly(d), _checks.readonly(v)
        self._setup(len(self._v), 1, names)

    @property
    def d(self) -> Array:
        """Natural frequencies in the order given, shape (n,); of a semidefinite energy (2n,), `(d_1, d_2)`."""
        return self._d

    @property
    def v(self) -> Array:
        """Williamson input vector `v = S B`, shape (2n,)."""
        return self._v

    @View
    @np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what overflows is refused below
    def modes(self) -> ModalForm:
        """Modal form: frequencies ascending, with their weights."""
        n = self.n
        q, p = np.split(self._v, 2)
        d1, d2 = self._d[:n], self._d[-n:]
        free = (d1 == 0) | (d2 == 0)
        still = np.sqrt(d1[free]) * q[free] + np.sqrt(d2[free]) * p[free]
        d1, d2, q, p = (part[~free] for part in (d1, d2, q, p))
        # a squeeze that makes both halves of the energy of a mode alike
        d, squeeze = d1 * np.sqrt(d2 / d1), (d1 / d2) ** 0.25
        q, p = q * squeeze, p / squeeze
        order = np.argsort(d, kind="stable")
        modes = ModalForm._of(d[order], (q + 1j * p)[order, None], still[:, None], (q * q + p * p)[order])
        what = "the modal weights of this d and v"
        _checks.representable(what, modes.r, modes.kappa, nonzero=modes.nu[:, 0] != 0)
        _checks.representable(what, modes.rigid**2, nonzero=modes.rigid != 0)
        return modes

    @View
    def a(self) -> Array:
        """Coefficients `(a_0 .. a_{2n-1})` of the characteristic polynomial, shape (2n,); odd ones are exactly 0."""
        return self.modes.coefficients()[0]

    @View
    def c(self) -> Array:
        """Coefficients `(c_1, c_3 .. c_{2n-1})` of the numerator, shape (n,), as `ModalForm.coefficients`."""
        return self.modes.coefficients()[1]

    @property
    def digits(self) -> float:
        """Decimal digits of the frequencies that survive in a companion matrix of doubles; 0 for repeated ones."""
        # a pole at 0 costs none: its coefficients are exactly 0
        return digits(self.modes.d)

    def _companion(self) -> Array:
        """Companion matrix with the coefficients in its last row."""
        warn_of_lost_digits(self.n, self.digits, "companion matrix", stacklevel=5)
        A = np.eye(len(self.a), k=1)
        A[-1:] = 0.0 - self.a
        return A

    def _readout(self) -> Array:
        """Row `[0, c_{2n-1}, 0, c_{2n-3} .. 0, c_1]`."""
        row = np.zeros(2 * self.n)
        row[1::2] = self.c[::-1]
        return row

    def _unit(self) -> Array:
        """Column `(0 .. 0, 1)`."""
        return np.eye(2 * self.n, 1, k=1 - 2 * self.n)

    def port_hamiltonian(self, S: ArrayLike | None = None, **names: Unpack[SystemNames]) -> PortHamiltonian:
        """Port-Hamiltonian system `(S^T diag(d, d) S, S^{-1} v)` with the same transfer function, of the same size.

        Parameters
        ----------
        S : array_like, shape (2n, 2n), optional
            Symplectic matrix; default the identity.
        **names
            `name`, `inputs`, `outputs`, `states` as for `control.ss`.

        Returns
        -------
        PortHamiltonian
            Linked with this system by `controllable_morphism` or `observable_morphism`; isomorphic to it iff the
            parameters are canonical.

        Raises
        ------
        StructureError
            If `S` is not symplectic.

        Notes
        -----
        The map `phi_S` of the paper's representation theorem (i).  `ph(sys)` gives the minimal system instead.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.ch([1.0, 2.0], [1.0, 0.0, 0.0, 0.0]).port_hamiltonian().n
        2
        """
        n = self.n
        weights = np.concatenate([self._d, self._d]) if len(self._d) == n else self._d
        if S is None:
            return PortHamiltonian(np.diag(weights), self._v, **inherited_names(self, names, "inputs", "outputs"))
        matrix = _checks.symplectic_matrix(S, 2 * n)
        Q = matrix.T @ (weights[:, None] * matrix)
        B = symplectic_inverse(matrix) @ self._v
        return PortHamiltonian(0.5 * (Q + Q.T), B, **inherited_names(self, names, "inputs", "outputs"))

    def _full_port_hamiltonian(self) -> PortHamiltonian:
        return self.port_hamiltonian()

    def _converted(self, **names: Unpack[SystemNames]) -> PortHamiltonian:
        modes = self.modes.minimal()
        return PortHamiltonian._from_modes(modes, **inherited_names(self, names, "inputs", "outputs"))

    def __reduce__(self) -> tuple[object, ...]:
        return restored, (type(self), self._d.copy(), self._v.copy(), self._names())

    def _repr_eval_(self) -> str:
        return self._repr_of(self._d, self._v)


class ControllableHamiltonian(_CanonicalForm):
    """Controllable Hamiltonian canonical form `s' = g1(d) s + e_{2n} u`, `y = g2(d, v) s`.

    Controllable by construction, and always the preimage of a port-Hamiltonian system; observable iff that is
    canonical.  Use `ch` to make one.

    Parameters
    ----------
    d : array_like, shape (n,) or (2n,)
        Natural frequencies, positive, rad per unit time; or `(d_1, d_2)`, not negative, of a semidefinite energy
        `diag(d_1, d_2)`.
    v : array_like, shape (2n,)
        Williamson input vector.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Raises
    ------
    StructureError
        If the sizes do not fit, or a frequency is not positive.

    See Also
    --------
    ch, ObservableHamiltonian

    Notes
    -----
    `g1` is the companion matrix of `prod (s^2 + d_l^2)`, `g2 = [0, c_{2n-1}, 0, c_{2n-3} .. 0, c_1]`.  The matrices are
    computed when first looked at, O(n^2); a `ConditioningWarning` says if fewer than six digits of the frequencies
    survive in them.  Frequency and time responses never use them.

    Examples
    --------
    >>> import ph_control as phc
    >>> sys = phc.ch([1.0, 2.0], [1.0, 1.0, 0.0, 0.0])
    >>> sys.A
    array([[ 0.,  1.,  0.,  0.],
           [ 0.,  0.,  1.,  0.],
           [ 0.,  0.,  0.,  1.],
           [-4.,  0., -5.,  0.]])
    >>> sys.C
    array([[0., 6., 0., 3.]])
    """

    _factory = "ch(d, v)"

    @View
    def A(self) -> Array:
        """Companion matrix `g1(d)`, shape (2n, 2n), read-only."""
        return self._companion()

    @View
    def B(self) -> Array:
        """Input matrix `e_{2n}`, shape (2n, 1), read-only."""
        return self._unit()

    @View
    def C(self) -> Array:
        """Output matrix `g2(d, v)`, shape (1, 2n), read-only."""
        return self._readout()[None, :]


class ObservableHamiltonian(_CanonicalForm):
    """Observable Hamiltonian canonical form `s' = g1(d)^T s + g2(d, v)^T u`, `y = e_{2n}^T s`.

    Observable by construction: every motion of a port-Hamiltonian system with these parameters is one of it.
    The converse holds iff that system is canonical.  Use `oh` to make one.

    Parameters
    ----------
    d, v, **names
        As for `ControllableHamiltonian`.

    Raises
    ------
    StructureError
        As `ControllableHamiltonian`.

    See Also
    --------
    oh, ControllableHamiltonian

    Notes
    -----
    The transpose of the controllable form.  With a repeated `d` the matrix has Jordan blocks: some initial states
    then give free motions that grow with time, which no port-Hamiltonian system has.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.oh([1.0, 2.0], [1.0, 1.0, 0.0, 0.0]).B.T
    array([[0., 6., 0., 3.]])
    """

    _factory = "oh(d, v)"

    @View
    def A(self) -> Array:
        """Transposed companion matrix `g1(d)^T`, shape (2n, 2n), read-only."""
        return self._companion().T.copy()

    @View
    def B(self) -> Array:
        """Input matrix `g2(d, v)^T`, shape (2n, 1), read-only."""
        return self._readout()[:, None]

    @View
    def C(self) -> Array:
        """Output matrix `e_{2n}^T`, shape (1, 2n), read-only."""
        return self._unit().T.copy()


def ch(d: ArrayLike | Convertible, v: ArrayLike | None = None, **names: Unpack[SystemNames]) -> ControllableHamiltonian:
    """Make a controllable Hamiltonian canonical form, from its parameters or from a lossless system.

    Parameters
    ----------
    d : array_like, shape (n,) or (2n,), or a system
        Natural frequencies (see `ControllableHamiltonian`); or, without `v`, any one-port that `ph` takes.
    v : array_like, shape (2n,), optional
        Williamson input vector.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; signal names of a given system are kept.

    Returns
    -------
    ControllableHamiltonian
        Of the size of a given port-Hamiltonian system or canonical form; minimal for any other.

    Raises
    ------
    StructureError
        If the parameters do not fit, or the system has several ports.
    NotLosslessError
        If the system has no port-Hamiltonian form.

    Notes
    -----
    The preimage under the paper's representation theorem (i).  O(n^3) for a system given by `Q` and `B`, else O(n).

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.ch(phc.frenkel_kontorova(2)).a.round(12)
    array([1., 0., 3., 0.])
    """
    return _make(ControllableHamiltonian, d, v, names)


def oh(d: ArrayLike | Convertible, v: ArrayLike | None = None, **names: Unpack[SystemNames]) -> ObservableHamiltonian:
    """Make an observable Hamiltonian canonical form, from its parameters or from a lossless system.

    Parameters
    ----------
    d, v, **names
        As for `ch`.

    Returns
    -------
    ObservableHamiltonian
        As `ch`.

    Raises
    ------
    StructureError, NotLosslessError
        As `ch`.

    Notes
    -----
    The image under the paper's representation theorem (ii).  Cost as `ch`.

    Examples
    --------
    >>> import ph_control as phc
    >>> sys = phc.oh(phc.ch([1.0, 2.0], [1.0, 1.0, 0.0, 0.0]))
    >>> sys.d, sys.v
    (array([1., 2.]), array([1., 1., 0., 0.]))
    """
    return _make(ObservableHamiltonian, d, v, names)


def _make(kind: type[Form], d: ArrayLike | Convertible, v: ArrayLike | None, names: SystemNames) -> Form:
    if v is not None:
        return kind(cast(ArrayLike, d), v, **names)
    source, names = d, inherited_names(d, names, "inputs", "outputs")
    if isinstance(source, _CanonicalForm):
        return kind(source.d, source.v, **names)
    sys = full_port_hamiltonian(source)
    refuse_losses(sys, "canonical forms are")
    if sys.ninputs != 1:
        raise StructureError(
            f"the system has {sys.ninputs} ports; canonical forms are those of one port: pick one with "
            "ph(sys.Q, sys.B[:, k])"
        )
    modes = sys.modes
    d, nu, still = modes.d, modes.nu[:, 0], np.zeros(sys.n - len(modes.d))
    if len(still) == 0:
        return kind(d, np.concatenate([nu.real, nu.imag]), **names)
    moved = np.eye(1, len(still))[0] * np.linalg.norm(modes.rigid)
    doubled = np.concatenate([still, d, still + 1.0, d])
    return kind(doubled, np.concatenate([still, nu.real, moved, nu.imag]), **names)


def warn_of_lost_digits(n: int, kept: float, what: str, *, stacklevel: int) -> None:
    """Warn where so many digits of the frequencies are not enough."""
    if kept < _ENOUGH:
        warnings.warn(
            f"the {what} of {n} modes carries {kept:.1f} decimal digits: rounding to doubles loses the others; work "
            "with the system itself, whose responses use d and v, or with ph(sys)",
            ConditioningWarning,
            stacklevel=stacklevel,
        )

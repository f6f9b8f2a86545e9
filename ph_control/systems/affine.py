"""Affine Hamiltonian systems, whose output is conjugate to their input, and the symmetry of transfer functions.

Displacement under a force, charge under a voltage: `z' = J Q z - J B u`, `y = B^T z`.  The transfer function is even,
and its product with `s` that of the port-Hamiltonian system `(Q, -J B)`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import control as ct
import numpy as np

from .. import _checks
from .._types import Array, ArrayLike, ComplexArray, SystemNames, Unpack
from ..exceptions import NotLosslessError, StructureError
from ..modal.modal_form import ModalForm
from ..numerics import definiteness as _definite
from ..numerics.pole_residue import Resolvent
from ..symplectic.forms_and_williamson import apply_form
from .base import LosslessSystem, View, in_normal_form, inherited_names, refuse_losses, restored
from .port_hamiltonian import PortHamiltonian, ph


class AffineHamiltonian(LosslessSystem):
    """Affine Hamiltonian input-output system `z' = J Q z - J B u`, `y = B^T z`.

    A `control.StateSpace`.  Use `affine` to make one.

    Parameters
    ----------
    Q : array_like, shape (2n, 2n)
        Hamiltonian matrix, symmetric positive semidefinite.
    B : array_like, shape (2n,) or (2n, m)
        Interaction `B^T z` of m ports with their inputs: what is measured, and what the inputs act on.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Raises
    ------
    StructureError
        If `Q` or `B` is not as `PortHamiltonian` needs them.

    See Also
    --------
    affine, PortHamiltonian

    Notes
    -----
    `G(s) = sum_l kappa_l / (s^2 + d_l^2) + kappa_0 / s^2` with the residues of `derivative()`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> spring = phc.affine(np.diag([4.0, 1.0]), [1.0, 0.0])
    >>> spring([0.0])
    array([0.25+0.j])
    """

    _factory = "affine(Q, B)"
    _integrated = True

    def __init__(self, Q: ArrayLike, B: ArrayLike, **names: Unpack[SystemNames]) -> None:
        matrix = _checks.symmetric_matrix(Q)
        ports = _checks.port_matrix(B, len(matrix))
        _definite.not_surely_indefinite(matrix)
        bracket = ports.T @ apply_form(ports)
        size = float(np.max(np.abs(bracket), initial=0.0))
        allowed = 8 * len(matrix) * _checks.EPS * float(np.linalg.norm(ports)) ** 2
        if size > allowed:
            raise StructureError(
                f"the outputs of the ports do not commute: max |B^T J B| = {size:.3g}, allowed {allowed:.1e}; the "
                "inputs would then act on the derivatives of the outputs directly, which has no port-Hamiltonian form"
            )
        self._fill(PortHamiltonian._from_matrices(matrix, apply_form(0.0 - ports)), ports, names)

    def _fill(self, velocity: PortHamiltonian, ports: Array, names: SystemNames) -> None:
        self._velocity = velocity
        self._interaction = _checks.readonly(ports)
        self._setup(len(ports), ports.shape[1], names)

    @View
    def Q(self) -> Array:
        """Hamiltonian matrix, shape (2n, 2n), read-only."""
        return self._velocity.Q

    @View
    def A(self) -> Array:
        """Dynamics matrix `J Q`, shape (2n, 2n), read-only."""
        return self._velocity.A

    @View
    def B(self) -> Array:
        """Input matrix `-J B` of the state equation, shape (2n, m), read-only."""
        return self._velocity.B

    @View
    def C(self) -> Array:
        """Output matrix `B^T`, shape (m, 2n), read-only."""
        return self._interaction.T.copy()

    @property
    def modes(self) -> ModalForm:
        """Modal form of `derivative()`; this system has the same frequencies, and an integrator more."""
        return self._velocity.modes

    @property
    def d(self) -> Array:
        """Natural frequencies, ascending, rad per unit time."""
        return self._velocity.d

    def derivative(self, **names: Unpack[SystemNames]) -> PortHamiltonian:
        """Port-Hamiltonian system `(Q, -J B)`: the same states, the time derivative of the output.

        Parameters
        ----------
        **names
            `name`, `inputs`, `outputs`, `states` as for `control.ss`; inputs and states keep their names.

        Returns
        -------
        PortHamiltonian
            In the same coordinates.

        Notes
        -----
        `y' = B^T J Q z = (-J B)^T Q z`, since `B^T J B` is skew; for several ports it must vanish.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> phc.affine(np.diag([4.0, 1.0]), [1.0, 0.0]).derivative().B.T + 0.0
        array([[0., 1.]])
        """
        return ph(self._velocity, **inherited_names(self, names, "inputs", "states"))

    _converted = derivative

    def _full_port_hamiltonian(self) -> PortHamiltonian:
        raise StructureError(
            "the transfer function of an affine Hamiltonian system is even, that of a port-Hamiltonian system odd; "
            "pass sys.derivative(), which has the same states, if the time derivative of the output is meant"
        )

    def horner(self, x: ArrayLike, warn_infinite: bool = True) -> ComplexArray:
        """Transfer function at complex points, shape (m, m, N); `inf` at a pole, 0 at infinity, never NaN.

        Values beyond the range of doubles, next to a double pole at 0, are `inf` too.
        """
        s = _checks.complex_points("the points", x)
        velocity = self.modes.evaluate(s)
        with np.errstate(all="ignore"):
            out = self._one_port(s, velocity) if self.ninputs == 1 else self.modes._off_axis(s, integrated=True)
        out[:, :, np.isinf(s)] = 0.0
        return np.where(np.isinf(velocity) | ~np.isfinite(out), complex(np.inf, 0.0), out)

    def _one_port(self, s: ComplexArray, velocity: ComplexArray) -> ComplexArray:
        """`velocity / s`; and well below all frequencies the static value, as rounding leaves no other."""
        modes = self.modes
        static = not len(modes.rigid) and np.abs(s) <= 1e-9 * np.min(modes.d, initial=np.inf)
        return np.where(static, np.sum(modes.kappa / modes.d / modes.d), velocity / s)

    def zeros(self) -> ComplexArray:
        """Zeros: those of the derivative but the one at 0, which the integrator takes away."""
        zeros = self.modes.zeros
        at_zero = np.flatnonzero(zeros == 0)
        return np.delete(zeros, at_zero[:1]) if not len(self.modes.rigid) else zeros.copy()

    def __reduce__(self) -> tuple[object, ...]:
        return restored, (type(self), self._velocity, self._interaction, self._names())

    def _repr_eval_(self) -> str:
        return self._repr_of(self.Q, self._interaction)


def affine(
    Q: ArrayLike | ct.StateSpace | ct.TransferFunction, B: ArrayLike | None = None, **names: Unpack[SystemNames]
) -> AffineHamiltonian:
    """Make an affine Hamiltonian system, from its matrices or from a system with an even transfer function.

    Parameters
    ----------
    Q : array_like, shape (2n, 2n), or a system
        Hamiltonian matrix; or, without `B`, a continuous-time one-port `control.StateSpace` or
        `control.TransferFunction` whose transfer function is even and lossless: with poles on the imaginary axis and
        `s G(s)` that of a port-Hamiltonian system.
    B : array_like, shape (2n,) or (2n, m), optional
        Interaction of the ports.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Returns
    -------
    AffineHamiltonian
        Minimal and in Williamson coordinates if made from a system.

    Raises
    ------
    StructureError
        If the matrices do not fit, or the argument is no system.
    NotLosslessError
        If the transfer function is not even, or `s G(s)` is not lossless.

    Notes
    -----
    The converse of the symmetry (Brockett; Maschke and van der Schaft): an even lossless transfer function has an
    affine Hamiltonian realization.  O(n^3).

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> phc.affine(ct.tf([1], [1, 0, 4])).d
    array([2.])
    """
    if B is not None:
        return AffineHamiltonian(Q, B, **names)
    if isinstance(Q, AffineHamiltonian):
        names = inherited_names(Q, names, "inputs", "outputs", "states")
        return AffineHamiltonian(Q.Q, Q._interaction, **names)
    refuse_losses(Q, "affine Hamiltonian systems are")
    if isinstance(Q, PortHamiltonian):
        raise StructureError(
            "the transfer function of a port-Hamiltonian system is odd, that of an affine one even; if the time "
            "integral of its output is meant (displacement in place of velocity), use affine(Q, J B): "
            "affine(sys.Q, symplectic_form(sys.n) @ sys.B)"
        )
    velocity = ph(_derivative(Q), lossless=True)
    # -J (J B) = B
    return AffineHamiltonian(velocity.Q, apply_form(velocity.B), **inherited_names(Q, names, "inputs", "outputs"))


def _derivative(sys: ct.StateSpace | ct.TransferFunction) -> ct.StateSpace | ct.TransferFunction:
    """`s G(s)` of a one-port, in the class of `G`."""
    _continuous(sys, "give Q and B, or a continuous-time StateSpace or TransferFunction")
    if not sys.issiso():
        raise StructureError(f"the system has {sys.ninputs} inputs and {sys.noutputs} outputs; expected one of each")
    if isinstance(sys, ct.TransferFunction):
        return ct.tf(np.append(sys.num_list[0][0], 0.0), sys.den_list[0][0])
    if np.any(sys.D):
        raise NotLosslessError([f"feedthrough D = {sys.D[0, 0]:.6g}, allowed 0"])
    product = float((sys.C @ sys.B)[0, 0])
    allowed = 8 * max(1, sys.nstates) * _checks.EPS * float(np.linalg.norm(sys.C) * np.linalg.norm(sys.B))
    if abs(product) > allowed:
        raise NotLosslessError([f"the transfer function is not even: C B = {product:.6g}, allowed {allowed:.1e}"])
    return ct.ss(sys.A, sys.B, sys.C @ sys.A, 0.0)


@dataclass(frozen=True)
class Symmetry:
    """Whether a transfer function has a symmetry, and how far off it is.  True where it holds.

    Attributes
    ----------
    holds : bool
        `residual <= allowed`.
    residual : float
        Largest `|G(s) ± G(-s)|` over the points tried, over the size of `G` there.
    allowed : float
        What rounding makes of it.

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> bool(phc.is_odd(ct.tf([1, 0], [1, 0, 1]))), bool(phc.is_odd(ct.tf([1], [1, 1])))
    (True, False)
    """

    holds: bool
    residual: float
    allowed: float

    def __bool__(self) -> bool:
        return self.holds


def is_odd(sys: ct.StateSpace | ct.TransferFunction, *, rtol: float | None = None) -> Symmetry:
    """Tell whether `G(-s) = -G(s)`, as for every port-Hamiltonian system.

    Parameters
    ----------
    sys : control.StateSpace or control.TransferFunction
        Continuous-time system.
    rtol : float, optional
        Allowed residual; default what rounding of the matrices or coefficients makes of it.

    Returns
    -------
    Symmetry
        True where it holds, with the measured residual.

    Raises
    ------
    StructureError
        If the argument is no continuous-time system, or `rtol` no number from 0 to 1.

    Notes
    -----
    Compared at `4n + 4` points of the complex plane, more than two different rational functions of this order can
    share.  O(n^3) for a state-space system, whose matrix is brought to triangular form once.

    Examples
    --------
    >>> import ph_control as phc
    >>> bool(phc.is_odd(phc.lc_circuit([1.0, 2.0], [1.0, 1.0])))
    True
    """
    return _symmetry(sys, +1.0, rtol)


def is_even(sys: ct.StateSpace | ct.TransferFunction, *, rtol: float | None = None) -> Symmetry:
    """Tell whether `G(-s) = G(s)`, as for every affine Hamiltonian system.

    Parameters
    ----------
    sys : control.StateSpace or control.TransferFunction
        Continuous-time system.
    rtol : float, optional
        As in `is_odd`.

    Returns
    -------
    Symmetry
        As `is_odd`.

    Raises
    ------
    StructureError
        As `is_odd`.

    Notes
    -----
    Accuracy and cost as `is_odd`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> bool(phc.is_even(phc.affine(np.diag([4.0, 1.0]), [1.0, 0.0])))
    True
    """
    return _symmetry(sys, -1.0, rtol)


def _symmetry(sys: ct.StateSpace | ct.TransferFunction, sign: float, rtol: float | None) -> Symmetry:
    _continuous(sys, "give a continuous-time StateSpace or TransferFunction")
    tolerance = None if rtol is None else _checks.relative_tolerance(rtol)
    with np.errstate(all="ignore"):
        poles, order, values_at = _poles_and_values(sys)
        away = np.abs(poles[poles != 0])
        low, high = (away.min(), away.max()) if len(away) else (1.0, 1.0)
        count = 4 * max(1, order) + 4
        # between the axes and away from both: a lossless pole is on one of them, a damped one seldom near these rays
        angles = np.pi * np.where(np.arange(count) % 2, 0.37, 0.21)
        s = np.geomspace(low / 3, 3 * high, count) * np.exp(1j * angles)
        values, rounding = values_at(np.concatenate([s, -s]))
        here, there = np.split(values.reshape(-1, 2 * count), 2, axis=1)
        size = np.abs(here) + np.abs(there)
        residual = float(np.max(np.where(size > 0, np.abs(here + sign * there) / np.where(size > 0, size, 1), 0.0)))
    if not np.isfinite(residual) or np.isnan(rounding):
        raise StructureError("the transfer function leaves the range of doubles; choose another unit of time")
    allowed = rounding if tolerance is None else tolerance
    return Symmetry(residual <= allowed, residual, allowed)


def _continuous(sys: ct.StateSpace | ct.TransferFunction, remedy: str) -> None:
    if not isinstance(sys, ct.StateSpace | ct.TransferFunction) or not sys.isctime():
        raise StructureError(f"this is a {type(sys).__name__}; {remedy}")


def _poles_and_values(
    sys: ct.StateSpace | ct.TransferFunction,
) -> tuple[ComplexArray, int, Callable[[ComplexArray], tuple[ComplexArray, float]]]:
    """Poles, order, and a call that gives values (p, m, N) at points.

    With the values comes the relative error that rounding of the data of the system makes in them, to first order with
    some room.
    """
    if in_normal_form(sys):
        return sys.poles(), sys.nstates, lambda s: (sys.horner(s), 1e4 * _checks.EPS)
    if isinstance(sys, ct.StateSpace):
        A, B, C, D = (_checks.real_array(name, getattr(sys, name), 2) for name in "ABCD")
        resolvent, size = Resolvent.of(A, B, C), float(np.linalg.norm(A))

        def from_matrices(s: ComplexArray) -> tuple[ComplexArray, float]:
            values, error = resolvent.evaluate(s)
            error = 32 * error * (np.abs(s) / (size or 1.0) + 1)
            return np.moveaxis(values + D, 0, 2), _largest_ratio(error, np.abs(values).max(axis=(1, 2), initial=0.0))

        return np.diag(resolvent.T), len(A), from_matrices
    entries = [pair for row in zip(sys.num_list, sys.den_list, strict=True) for pair in zip(*row, strict=True)]

    def from_polynomials(s: ComplexArray) -> tuple[ComplexArray, float]:
        worst = max(
            len(p) * _largest_ratio(np.polyval(np.abs(p), np.abs(s)), np.abs(np.polyval(p, s)))
            for pair in entries
            for p in pair
        )
        return sys.horner(s), 32 * _checks.EPS * worst

    # not sys.poles(), which takes the numerators apart as well and warns of small ones
    poles = np.concatenate([np.roots(den).astype(complex) for _, den in entries])
    return poles, max(len(p) - 1 for pair in entries for p in pair), from_polynomials


def _largest_ratio(errors: Array, values: Array) -> float:
    """Largest error relative to its value, where this is not 0."""
    return float(np.max(errors / np.where(values > 0, values, np.inf), initial=0.0))

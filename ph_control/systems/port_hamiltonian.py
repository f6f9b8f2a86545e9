"""Port-Hamiltonian systems that are `control.StateSpace` systems."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, cast

import control as ct
import numpy as np
import scipy.signal
from scipy.linalg import svdvals

from .. import _checks
from .._display import latex_matrix
from .._options import STORAGES, Discretisation, Interpolation, Storage
from .._types import Array, ArrayLike, ComplexArray, PortPairs, SystemNames, Unpack
from .._units import common_unit, with_unit
from ..exceptions import ConditioningWarning, NotLosslessError, StructureError
from ..modal import foster_test
from ..modal import minimal as reachability
from ..modal.error_bounds import Separation, separate
from ..modal.general_form import GeneralModalForm, from_pole_residues, from_state_space, from_vectors, with_damping
from ..modal.minimal import Reduction
from ..modal.modal_form import ModalForm, from_frequencies
from ..numerics import definiteness as _definite
from ..numerics.rational import LinearSystem, state_space
from ..symplectic.darboux_and_casimirs import normal_form
from ..symplectic.forms_and_williamson import (
    apply_form,
    energy_coordinates,
    frequency_conditions,
    port_spectrum,
    symplectic_form,
    williamson,
)
from .base import Convertible, LosslessSystem, View, inherited_names, refuse_losses, restored
from .passive_form import Conversion, in_port_order, loses_energy, parts_of_resonators

if TYPE_CHECKING:
    from .canonical_forms import ControllableHamiltonian, ObservableHamiltonian

_SMALL = 16  # degrees of freedom up to which frequencies alone are hardly cheaper than all modes
_SIGNALS = ("inputs", "outputs", "states")
_UNCERTAIN = 1e-3  # of a frequency: what rounding of Q may move it by without a word
_OF_Q = ("_proven", "_energy", "_frequencies", "S")  # views that take O(n^3) steps, of Q alone
_KEYWORDS = ("R", "P", "S", "N", "J", "sensors", "storage", "lossless", "ports", "method", "intersample")
_ADVICE = {
    "E": "a descriptor matrix E is not taken: eliminate its algebraic equations first, as from_second_order does with "
    "condense=True for motions without mass",
    "D": "the feedthrough D of ports is S=(D + D.T)/2 and N=(D - D.T)/2, that of sensors the second of sensors=(C, D)",
    "C": "the outputs of ports are (B + P)^T Q z; rows of others are sensors=C",
    "G": "the port matrix is the second argument, B; a gyroscopic matrix is part of J",
    "K": "the matrices of M q'' + C q' + K q = F u are taken by from_second_order",
    "M": "the matrices of M q'' + C q' + K q = F u are taken by from_second_order",
}
_OF_Q_AND_B = (*_OF_Q, "_seen")


class PortHamiltonian(LosslessSystem):
    """Linear port-Hamiltonian system `z' = J Q z + B u`, `y = B^T Q z`.

    A `control.StateSpace`: every function of python-control takes it.  Use `ph` to make one from matrices, from
    a modal form or from any lossless system.

    Parameters
    ----------
    Q : array_like, shape (2n, 2n)
        Hamiltonian matrix, symmetric positive semidefinite: the stored energy is `z^T Q z / 2`,
        `z = (q_1 .. q_n, p_1 .. p_n)`.
    B : array_like, shape (2n,) or (2n, m)
        Input matrix for m ports.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Raises
    ------
    StructureError
        If `Q` is not square, even, symmetric, finite, real and positive semidefinite, `B` does not fit it, or the
        names do not fit the sizes.  Beyond 32 degrees of freedom an indefinite `Q` of which no diagonal entry is
        negative and no `Q_ij^2` exceeds `Q_ii Q_jj` is an error of the first call that computes anything from it.

    Notes
    -----
    Building costs O(n^2).  What takes O(n^3), modes and matrices, is computed on first access, kept, and shared with
    copies and pickles.  Matrices are read-only copies of those given.
    Frequency responses, poles and zeros run on modal coordinates.  `+` of two PH systems and multiplication by a
    positive number stay PH; `0 + sys` is `sys`; every other operation gives a plain `StateSpace`, or what a
    `TransferFunction` on its left makes of it.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> oscillator = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])
    >>> oscillator.d, oscillator.r
    (array([2.]), array([0.5]))
    >>> oscillator([1j])
    array([0.+0.33333333j])
    """

    _factory = "ph(Q, B)"
    structural_modes: Any = None  # `StructuralModes`, where `from_second_order` has kept some modes of a structure
    base_motion: Any = None  # `BaseMotion`, of a structure on a base that moves
    error_bound: float | None = None  # of `reduce`: the largest difference from the system that was reduced
    cost: float | None = None  # of `nearest_passive`: squared distance from the system that was not passive
    _modes: ModalForm | None
    _given: tuple[Array, Array] | None

    def __init__(self, Q: ArrayLike, B: ArrayLike, **names: Unpack[SystemNames]) -> None:
        matrix = _checks.symmetric_matrix(Q)
        ports = _checks.port_matrix(B, len(matrix))
        inverse = _definite.not_surely_indefinite(matrix)
        self._fill((matrix, ports), None, names)
        if may_lose_digits(matrix, inverse):
            warn_of_ill_conditioning(matrix, self._energy)

    def _fill(
        self,
        given: tuple[Array, Array] | None,
        modes: ModalForm | None,
        names: SystemNames,
        kept: dict[str, object] | None = None,
    ) -> None:
        """Take matrices that have been checked, or modes, and views of them that are known."""
        self._given, self._modes = given, modes
        if given is not None:
            self._setup(len(given[1]), given[1].shape[1], names)
        elif modes is not None:
            self._setup(2 * modes.n, modes.nports, names)
        for name, view in (kept or {}).items():
            self._views[name] = _checks.readonly(view) if isinstance(view, np.ndarray) else view

    @classmethod
    def _from_modes(cls, modes: ModalForm, **names: Unpack[SystemNames]) -> PortHamiltonian:
        """System in Williamson coordinates, its matrices not built until somebody looks."""
        return restored(cls, None, modes, names)

    @classmethod
    def _from_matrices(cls, Q: Array, B: Array, **names: Unpack[SystemNames]) -> PortHamiltonian:
        """System from arrays that have been checked as the constructor does."""
        return restored(cls, (Q, B), None, names)

    # --- matrices ------------------------------------------------------------------------------------------------

    @View
    def Q(self) -> Array:
        """Hamiltonian matrix, shape (2n, 2n), read-only."""
        if self._given is not None:
            return self._given[0]
        still = np.zeros(len(self.modes.rigid))
        return np.diag(np.concatenate([still, self.d, still + 1.0, self.d]))

    @View
    def B(self) -> Array:
        """Input matrix, shape (2n, m), read-only."""
        if self._given is not None:
            return self._given[1]
        modes = self.modes
        return np.concatenate([0 * modes.rigid, modes.nu.real, modes.rigid, modes.nu.imag])

    @View
    def A(self) -> Array:
        """Dynamics matrix `J Q`, shape (2n, 2n), read-only."""
        return apply_form(self._proven)

    @View
    def C(self) -> Array:
        """Output matrix `B^T Q`, shape (m, 2n), read-only."""
        return self.B.T @ self._proven

    @View
    def _proven(self) -> Array:
        """Q, of which is proved what building has left open; an indefinite one raises."""
        if self._given is not None and len(self.Q) > _definite.AT_ONCE and "_energy" not in self._views:
            _definite.not_indefinite(self.Q)
        return self.Q

    # --- modal coordinates -----------------------------------------------------------------------------------------

    @View
    def _energy(self) -> tuple[Array, ComplexArray, Array]:
        """`energy_coordinates` of Q: frequencies, complex rows and rigid rows."""
        if self._given is not None:
            Q = self._given[0]
            energy = energy_coordinates(Q)
            if len(Q) > _definite.AT_ONCE:  # a smaller one has been judged when it was built
                warn_of_ill_conditioning(Q, energy)
            return energy
        d, k = self.d, len(self.modes.rigid)
        root, n = np.sqrt(d), self.n
        E = np.zeros((len(d), 2 * n), complex)
        E[:, k:n], E[:, n + k :] = np.diag(root), 1j * np.diag(root)
        E0 = np.zeros((k, 2 * n))
        E0[:, n : n + k] = np.eye(k)
        return d, E, E0

    @property
    def _squares(self) -> tuple[Array | ComplexArray, ...]:
        """Rows whose products with a state have the energy as half the sum of their squares."""
        return self._energy[1:]

    @property
    def modes(self) -> ModalForm:
        """Modal form: the truth behind the matrices, computed once (O(n^3)) and kept."""
        if self._modes is None:
            self._modes = foster_test.modes_of_energy(self._energy, self.B)
        return self._modes

    @View
    def _port(self) -> tuple[Array, Array, float | None] | None:
        """`port_spectrum`, where it can be had."""
        if self._given is None or self.ninputs != 1 or "_energy" in self._views:
            return None
        return port_spectrum(self.Q, self.B[:, 0])

    @View
    def _seen(self) -> ModalForm | None:
        """Frequencies and residues alone, where they come cheaper than `modes`."""
        return None if self._port is None else reachability.plain_modes(self._port[0], self._port[1] / self._port[0])

    @View
    def _reduction(self) -> Reduction | None:
        """Modes that the port reaches, where frequencies and residues alone tell them; else None."""
        if self._given is None:
            return reachability.of_exact(self.modes)
        if self._modes is not None or self._port is None:
            return None
        d, kappa, inverse = self._port
        if inverse is None:
            return reachability.of_pairs(d, kappa)
        return reachability.of_matrix(d, kappa, inverse, np.diag(self.Q))

    @View
    def _minimal(self) -> ModalForm:
        """Modal form of what ports reach, kept."""
        return (self._reduction or self._separation()).minimal()

    def _separation(self, rtol: float | None = None) -> Separation:
        """Modes parted into those that ports reach and those that they do not."""
        return separate(self.modes, self._given, None if self._given is None else self._energy, rtol=rtol)

    def horner(self, x: ArrayLike, warn_infinite: bool = True) -> ComplexArray:
        """Transfer function at complex points, shape (m, m, N); `inf` at a pole, never NaN.

        On modal coordinates, O(n) a point: the response of the frequencies `d` and weights `r` as they are known at the
        time, right to 5e-14 however close to a pole.

        For a system given by `Q` and `B` the errors of `d` and `r` come on top.  Rounding `d` to doubles alone moves
        the term of a resonance by `eps d / |w - d|` of its size; more is not lost up to 16 degrees of freedom and where
        `modes` have been asked for.  Frequencies and weights alone come in a third of the time, with errors two to ten
        times as large: of a full `Q` of condition 100 and size 200, 400 or 1000 the median of relative errors within
        the band is 2e-14, 2e-13 or 8e-13, against 1e-14, 2e-14 or 5e-14 by modes; beyond the band both reach 1e-15.  A
        value asked for before `modes` may differ from the same one after by as much.
        """
        return self._spectrum.evaluate(x)

    @property
    def _spectrum(self) -> ModalForm:
        """Frequencies and weights: of the modes, or alone, where these are not known and are many."""
        cheap = self._modes is not None or self.n <= _SMALL or "_energy" in self._views
        return self.modes if cheap or self._seen is None else self._seen

    @View
    def _frequencies(self) -> Array | None:
        """Frequencies alone of many positions and momenta that `Q` does not couple, where both halves are definite."""
        halves = () if self._given is None else _definite.uncoupled_halves(self.Q)
        if self.n <= _SMALL or len(halves) != 2:
            return None
        factors = [_definite.definite_factor(half) for half in halves]
        if factors[0] is None or factors[1] is None:
            return None
        # of Q = diag(K, T), K = F F^T and T = H H^T, the squares are eigenvalues of (F^T H)^T F^T H
        d = svdvals(factors[0][0].T @ factors[1][0], check_finite=False)[::-1].copy()
        return d if d[0] > 0 and np.isfinite(d[-1]) else None

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies, ascending, rad per unit time: `d`, without the modes where these are not known yet.

        Of `Q = diag(K, M^{-1})` they cost less than twice what eigenvalues of the pencil `K, M` do, and are known to a
        few `eps d_max`.
        """
        known = self._modes is not None or "_energy" in self._views
        frequencies = None if known else self._frequencies
        return self.modes.natural_frequencies if frequencies is None else frequencies

    @property
    def d(self) -> Array:
        """Natural frequencies (symplectic eigenvalues of Q), ascending, rad per unit time; no rigid-body modes.

        Of one port and more than 16 degrees of freedom they are found without mode shapes, in a third of the time, with
        an error of a few `eps d_max`, where the largest is at most 64 times the smallest.  Once something has asked for
        `modes`, they are those of `modes`, which may differ by as much.
        """
        return self._spectrum.d

    @property
    def r(self) -> Array:
        """Weights `r_l = v_l^2 + v_{n+l}^2` in the order of `d`; (n, m) for several ports.

        An error of d comes with one of `r` that is `r_l / gap` times as large, with the gap to the next frequency.
        """
        return self._spectrum.r

    def poles(self) -> ComplexArray:
        """Eigenvalues of A, shape (2n,): `±i d`, and 0 twice for each degree of freedom without a frequency.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5])).poles().imag
        array([-2., -1.,  1.,  2.])
        """
        return self._poles(self.d)

    @View
    def v(self) -> Array:
        """Williamson input vector `v = S B`, shape (2n,), or (2n, m) for several ports."""
        v = self.S @ self.B
        return v[:, 0].copy() if self.ninputs == 1 else v

    @View
    def S(self) -> Array:
        """Symplectic matrix of Williamson's normal form, `Q = S^T diag(d, d) S`, shape (2n, 2n).

        With losses `S` is the symmetric part of the feedthrough, which is 0 here.  A degree of freedom that stores no
        energy comes first, with a zero in place of its `d`.  Raises `StructureError` if there are rigid-body modes: see
        `williamson_semidefinite`.
        """
        if self._given is None and not len(self.modes.rigid):
            return np.eye(2 * self.n)
        return williamson(self.Q)[1]

    # --- the terms of a system with losses: here all but J are 0 ---------------------------------------------------

    @View
    def J(self) -> Array:
        """Skew structure matrix `[[0, I], [-I, 0]]`, shape (2n, 2n), read-only."""
        return symplectic_form(self.n)

    @property
    def G(self) -> Array:
        """Port matrix, shape (2n, m), read-only: `B`, as nothing is lost between states and ports."""
        return self.B

    @View
    def R(self) -> Array:
        """Dissipation matrix: zeros, shape (2n, 2n), read-only."""
        return np.zeros((self.nstates, self.nstates))

    @View
    def P(self) -> Array:
        """Dissipation between states and ports: zeros, shape (2n, m), read-only."""
        return np.zeros((self.nstates, self.ninputs))

    @View
    def N(self) -> Array:
        """Skew part of the feedthrough: zeros, shape (m, m), read-only; the symmetric part is 0 as well."""
        return np.zeros((self.ninputs, self.ninputs))

    @property
    def sensors(self) -> tuple[Array, Array]:
        """State rows (0, 2n) and input rows (0, m) of outputs after those of the ports: there are none."""
        return np.zeros((0, self.nstates)), np.zeros((0, self.ninputs))

    @property
    def is_canonical(self) -> bool:
        """Whether the system is controllable, which is the same as observable: all `d` differ and all `r > 0`."""
        if self._reduction is not None:
            return self._reduction.is_minimal
        return len(self.modes.d) == self.n and self._separation().is_minimal

    def hamiltonian(self, z: ArrayLike) -> float | Array:
        """Stored energy `z^T Q z / 2`.

        Parameters
        ----------
        z : array_like, shape (2n,) or (2n, T)
            One state, or one state a column, as in the `states` of a time response.

        Returns
        -------
        float or ndarray, shape (T,)
            The energy of each.

        Raises
        ------
        StructureError
            If `z` has the wrong number of rows, is not real and finite, or its energy exceeds the range of doubles.

        Notes
        -----
        A sum of squares in modal coordinates, so never negative.  O(n^2) for each state.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0]).hamiltonian([[1.0, 0.0], [2.0, 1.0]])
        array([4. , 0.5])
        """
        states = _checks.real_array("z", z)
        if states.ndim not in (1, 2) or states.shape[0] != self.nstates:
            raise StructureError(f"z has shape {states.shape}; it must be ({self.nstates},) or ({self.nstates}, T)")
        with np.errstate(over="ignore", invalid="ignore"):
            energy = 0.5 * sum(np.sum(np.abs(rows @ states) ** 2, axis=0) for rows in self._squares)
        if not np.isfinite(energy).all():
            raise StructureError(
                f"z is out of range: its largest entry is {np.max(np.abs(states)):.3g}, whose energy exceeds the range "
                "of doubles; choose another unit of amplitude"
            )
        return float(energy) if states.ndim == 1 else energy

    # --- what python-control asks a system ------------------------------------------------------------------------

    def __add__(self, other: ct.StateSpace | ArrayLike) -> ct.StateSpace:
        """Parallel connection; PH with a PH system of the same number of ports, or with a gain that takes energy."""
        from .interconnection import parallel

        if _checks.is_number(other) and other == 0:
            return self
        connection = parallel(self, other)
        return super().__add__(other) if connection is None else connection

    def __radd__(self, other: ct.StateSpace | ArrayLike) -> ct.StateSpace:
        """Parallel connection; `0 + sys` is `sys`, so that `sum` of PH systems is PH."""
        # Python asks the subclass first; a StateSpace on the left is to do its own adding
        return NotImplemented if isinstance(other, ct.StateSpace) else self + other

    def __mul__(self, other: ct.StateSpace | ArrayLike) -> ct.StateSpace:
        """Series connection; PH if `other` is a positive number: `B` is scaled by its square root."""
        if _checks.is_number(other) and 0 < other < np.inf:
            return self._scaled(float(other))
        return super().__mul__(other)

    def __rmul__(self, other: ct.StateSpace | ArrayLike) -> ct.StateSpace:
        """Series connection; PH if `other` is a positive number."""
        if _checks.is_number(other) and 0 < other < np.inf:
            return self._scaled(float(other))
        # Python asks the subclass first; StateSpace.__rmul__ would hand the question back without end
        return NotImplemented if isinstance(other, ct.StateSpace) else super().__rmul__(other)

    def feedback(self, other: ct.StateSpace | ArrayLike = 1, sign: int = -1) -> PortHamiltonian | ct.StateSpace:
        """Feedback loop, PH for negative feedback through a PH system or a matrix that only takes energy.

        Parameters
        ----------
        other : PortHamiltonian, control.StateSpace, number or matrix
            The system in the feedback path; a matrix `K` needs `K + K^T >= 0`.
        sign : {-1, 1}
            Sign of the feedback.

        Returns
        -------
        DissipativePortHamiltonian or control.StateSpace

        Raises
        ------
        TypeError
            If `other` is no system, number or matrix.

        Examples
        --------
        >>> import control as ct, ph_control as phc
        >>> closed = ct.feedback(phc.frenkel_kontorova(2), 0.1)
        >>> type(closed).__name__, bool(closed.poles().real.max() < 0)
        ('DissipativePortHamiltonian', True)
        """
        from .interconnection import feedback

        closed = feedback(self, other) if sign == -1 else None
        if closed is not None:
            return closed
        try:
            return super().feedback(other, sign)
        except AttributeError:  # of python-control, which finds no system in it
            raise TypeError(f"a {type(other).__name__} cannot be the feedback of a system") from None

    def append(self, other: ct.StateSpace | ArrayLike) -> PortHamiltonian | ct.StateSpace:
        """Systems side by side, PH with a PH system or with a gain that takes energy.

        Parameters
        ----------
        other : PortHamiltonian, control.LTI, number or matrix
            What comes after this system.

        Returns
        -------
        PortHamiltonian or control.StateSpace

        Examples
        --------
        >>> import control as ct, ph_control as phc
        >>> two = ct.append(phc.frenkel_kontorova(2), phc.frenkel_kontorova(1))
        >>> type(two).__name__, two.ninputs, two.nstates
        ('PortHamiltonian', 2, 6)
        """
        from .interconnection import append

        combined = append(self, other)
        return super().append(other) if combined is None else combined

    def _converted(self, **names: Unpack[SystemNames]) -> PortHamiltonian:
        names = inherited_names(self, names, *_SIGNALS)
        return restored(PortHamiltonian, self._given, self._modes, names, self._kept(_OF_Q_AND_B))

    def _scaled(self, factor: float) -> PortHamiltonian:
        root = np.sqrt(factor)
        with np.errstate(over="ignore"):
            if self._given is not None:
                B = root * self.B
                _checks.in_range(f"B times the square root of {factor:.3g}", B, _checks.SMALLEST_SQUARED)
                return restored(PortHamiltonian, (self.Q, B), None, {}, self._kept(_OF_Q))
            m = self.modes
            scaled = ModalForm._of(m.d, root * m.nu, root * m.rigid, factor * m.r)
            what = f"the modal weights times {factor:.3g}"
            _checks.representable(what, scaled.r, scaled.kappa, nonzero=m.r > 0)
            _checks.representable(what, scaled.rigid**2, nonzero=m.rigid != 0)
        return PortHamiltonian._from_modes(scaled)

    def _kept(self, names: tuple[str, ...]) -> dict[str, object]:
        """Views of these names, as far as they have been computed, of a system that was given by matrices."""
        return {} if self._given is None else {name: self._views[name] for name in names if name in self._views}

    def _attached(self) -> dict[str, object]:
        """Attributes that are set after a system was made, for pickles."""
        names = "_time_unit", "structural_modes", "base_motion", "error_bound", "cost"
        return {name: getattr(self, name) for name in names}

    def __reduce__(self) -> tuple[object, ...]:
        known = self._given, self._modes, self._names(), self._kept(_OF_Q_AND_B)
        return restored, (type(self), *known), self._attached()

    def _repr_eval_(self) -> str:
        if self._given is not None:
            return self._repr_of(self.Q, self.B)
        labels = self._label_repr()
        return f"ph({self.modes!r}" + (f",\n{labels})" if labels else ")")

    def _equations(self) -> str:
        Q, B = latex_matrix(self.Q), latex_matrix(self.B)
        return rf"\dot z = J Q z + B u, \quad y = B^\top Q z, \quad Q = {Q}, \quad B = {B}"

    def controllable_form(self, **names: Unpack[SystemNames]) -> ControllableHamiltonian:
        """Controllable Hamiltonian canonical form with the same parameters: what `ch` makes of this system.

        Parameters
        ----------
        **names
            `name`, `inputs`, `outputs`, `states` as for `control.ss`; signal names are kept.

        Returns
        -------
        ControllableHamiltonian
            Of the size of this system; isomorphic to it iff it is canonical.

        Raises
        ------
        StructureError
            If the system has several ports.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.frenkel_kontorova(2).controllable_form().a.round(12)
        array([1., 0., 3., 0.])
        """
        from .canonical_forms import ch

        return ch(self, **names)

    def observable_form(self, **names: Unpack[SystemNames]) -> ObservableHamiltonian:
        """Observable Hamiltonian canonical form with the same parameters: what `oh` makes of this system.

        Parameters
        ----------
        **names
            As for `controllable_form`.

        Returns
        -------
        ObservableHamiltonian
            Of the size of this system; isomorphic to it iff it is canonical.

        Raises
        ------
        StructureError
            If the system has several ports.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.frenkel_kontorova(2).observable_form().B.T.round(12)
        array([[0., 1., 0., 1.]])
        """
        from .canonical_forms import oh

        return oh(self, **names)


def ph(
    Q: ArrayLike | Convertible,
    B: ArrayLike | None = None,
    *,
    R: ArrayLike | None = None,
    P: ArrayLike | None = None,
    S: ArrayLike | None = None,
    N: ArrayLike | None = None,
    J: ArrayLike | None = None,
    sensors: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    storage: Storage = "auto",
    lossless: bool = False,
    ports: PortPairs | None = None,
    method: Discretisation | None = None,
    intersample: Interpolation = "zoh",
    **names: Unpack[SystemNames],
) -> PortHamiltonian:
    """Make a port-Hamiltonian system.

    Parameters
    ----------
    Q : array_like, shape (2n, 2n), or a system
        Hamiltonian matrix (see `PortHamiltonian`); or, without `B`, a system to convert: a `ModalForm`, a passive
        continuous-time `control.StateSpace` or `control.TransferFunction`, or one of `scipy.signal`.
    B : array_like, shape (2n,) or (2n, m), optional
        Input matrix.
    R : array_like, shape (2n, 2n), optional
        Dissipation matrix, symmetric positive semidefinite.
    P, S, N : array_like, shapes (2n, m), (m, m), (m, m), optional
        Dissipation between states and ports, and the symmetric and the skew part of the feedthrough of the equations
        `z' = (J - R) Q z + (B - P) u`, `y = (B + P)^T Q z + (S + N) u`; `[[R, P], [P^T, S]] >= 0`.
    J : array_like, shape (2n, 2n), optional
        Any skew matrix; default the canonical one.  Without losses and sensors it must be invertible, and the states
        become `darboux(J) z`; beside them it stays as it is, and may be of odd size.
    sensors : array_like, shape (k, 2n), or (array_like, array_like), shapes (k, 2n) and (k, m), optional
        Rows of outputs that are no port variables, `y_s = C_s z + D_s u`; they come after those of the ports.
    storage : {'auto', 'available', 'required', 'mean'}
        Energy of a passive system with losses. 'available' is the least that explains its ports, what can be taken out
        of it; 'required' the largest, what it takes to bring it there; 'mean' their geometric mean. 'auto' is that of
        the matrices where they show mass and stiffness, that of the modes where damping is classical, else the mean.
    lossless : bool
        Whether to refuse a system with losses.
    ports : list of (output, input), or mapping from output to input, optional
        Numbers or names of the output at the port of each input; the other outputs become sensors. Default: output k
        belongs to input k.
    method : {'exact', 'midpoint', 'euler'}, optional
        How a discrete-time system was sampled; required for such a system, and for no other.
    intersample : {'zoh', 'foh'}
        What its input did between samples; 'midpoint' with 'foh' is the bilinear (Tustin) transformation.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; names of a given system are kept.

    Returns
    -------
    PortHamiltonian
        A state-space system that already is in PH normal form keeps its coordinates; any other lossless one arrives in
        Williamson coordinates, minimal.  Of an `AffineHamiltonian` it is the derivative.  With losses, feedthrough or
        sensors a `DissipativePortHamiltonian`, whose `conversion` says whose energy it has, how many hidden states were
        left out, and what the transfer functions differ by: in the coordinates given, in Williamson coordinates of
        classically damped modes, or with `Q = I`.

    Raises
    ------
    NotPassiveError
        If the system has no PH form, with the bands in which it gives energy.
    NotLosslessError
        If it has losses and `lossless` is asked for, or a pole of a sampled system comes from no frequency below that
        of Nyquist; it names each offending pole and residue with its size and the tolerance.
    StructureError
        If the arguments are not of one of these kinds, or a sampled system has repeated poles and losses.

    Warns
    -----
    ConditioningWarning
        If the transfer functions differ by more than 1e-10 of the largest value, or rounding of the entries of `Q`
        moves a natural frequency by more than 1e-3 of itself, whatever the units; rigid modes do not count.  Beyond 32
        degrees of freedom this is told when modes are computed.

    Notes
    -----
    Whether a system is lossless is decided by Foster's theorem: simple poles on the imaginary axis with positive
    residues.  Every tolerance is a first-order bound of the rounding error of the pole or residue it is held
    against.  A state-space system never passes through polynomials.  O(n^3).

    With losses the energy is a solution of the Kalman-Yakubovich-Popov inequality.  `D` stays what it is: without
    feedthrough `X B = C^T` is known, and all that follows from it, and only the rest of `X` is left to a Riccati
    equation.  Poles on the axis are split off first.  O(n^3).

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> sys = phc.ph(ct.tf([2, 0], [1, 0, 4]))
    >>> sys.d, sys.r
    (array([2.]), array([1.]))
    >>> damped = phc.ph(ct.tf([2, 1], [1, 1, 4]))
    >>> damped.conversion.energy, damped.is_lossless
    ('mean', False)
    """
    _checks.known_keywords("ph", names, _KEYWORDS, _ADVICE)
    _checks.choice("storage", storage, STORAGES)
    losses = {"R": R, "P": P, "S": S, "N": N}
    if B is None:
        if J is not None:
            raise StructureError("J is given without B; it belongs to the matrices Q and B of z' = J Q z + B u")
        if sensors is not None or any(value is not None for value in losses.values()):
            raise StructureError("R, P, S, N and sensors belong to the matrices Q and B, and B is not given")
        system = _of_system(Q, storage, lossless, ports, method, intersample, names)
        return with_unit(system, common_unit(Q))
    _refuse_sampling(method, intersample)
    Q = cast(ArrayLike, Q)
    if storage != "auto" or ports is not None:
        raise StructureError("storage and ports say how to convert a system; Q and B are given, which say it already")
    if sensors is not None or any(v is not None and _checks.real_array(name, v).any() for name, v in losses.items()):
        from .dissipative import DissipativePortHamiltonian

        return DissipativePortHamiltonian(Q, B, **losses, J=J, sensors=sensors, **names)
    if J is not None:
        Q, B = normal_form(Q, B, J)
    return PortHamiltonian(Q, B, **names)


def may_lose_digits(Q: Array, inverse: float) -> bool:
    """Whether a bound for the norm of the inverse of `Q`, scaled to unit diagonal, leaves open that digits are lost."""
    return len(Q) * inverse * _checks.EPS > _UNCERTAIN


def warn_of_ill_conditioning(Q: Array, energy: tuple[Array, ComplexArray, Array]) -> None:
    """Warn where rounding of the entries of `Q` moves a natural frequency by more than it should."""
    moved = _checks.EPS * frequency_conditions(Q, energy)
    if moved.max(initial=0.0) > _UNCERTAIN:
        worst = int(moved.argmax())
        warnings.warn(
            f"Q is ill-conditioned in any units: the last digit of its entries moves the natural frequency "
            f"{energy[0][worst]:.4g} by {min(moved[worst], 1.0):.0e} of itself, allowed {_UNCERTAIN:.0e}; frequencies "
            "and responses have no more digits than that. Give the system by its modes, by M, K and from_second_order, "
            "or in states in which the energy is not a small difference of large terms",
            ConditioningWarning,
            stacklevel=4,
        )


def _refuse_sampling(method: str | None, intersample: str) -> None:
    """Refuse to be told how a system was sampled that was not."""
    if method is not None or not (isinstance(intersample, str) and intersample == "zoh"):
        raise StructureError(
            f"method={_checks.shown(method)} and intersample={_checks.shown(intersample)} say how a discrete-time "
            "system was sampled; this one is not sampled"
        )


def _of_system(
    source: Convertible,
    storage: str,
    lossless: bool,
    ports: PortPairs | None,
    method: Discretisation | None,
    intersample: Interpolation,
    names: SystemNames,
) -> PortHamiltonian:
    """Port-Hamiltonian form of any linear system."""
    sampled = isinstance(source, ct.InputOutputSystem) and source.isdtime(strict=True)
    if not sampled:
        _refuse_sampling(method, intersample)
    known = _as_it_is(source, storage, lossless, ports, names)
    if known is not None:
        return known
    if isinstance(source, GeneralModalForm):
        source = source.state_space()
    sensors_last = False
    if ports is not None:
        source = in_port_order(_state_space(source, None), ports)
        sensors_last = source.noutputs > source.ninputs
    kept = inherited_names(source, names, "inputs", "outputs")
    tested = _of_ports(source) if sensors_last else source
    plain = isinstance(tested, ct.StateSpace) and tested.isctime() and not isinstance(tested, LosslessSystem)
    if plain and not sensors_last and (matrices := foster_test.hamiltonian_form(tested)):
        return PortHamiltonian._from_matrices(*matrices, **inherited_names(source, names, *_SIGNALS))
    modes: ModalForm | None = None
    refusal: NotLosslessError | None = None
    if lossless or not plain or not loses_energy(tested):
        required = lossless or isinstance(source, scipy.signal.dlti)
        modes, refusal = _lossless_modes(tested, required, method, intersample)
    if modes is not None and not sensors_last:
        return PortHamiltonian._from_modes(modes, **kept)
    from .dissipative import of_passive

    error = None
    if sampled:
        form = foster_test.of_sampled(source, method, intersample)
        source, error = from_pole_residues(form).state_space(), form.error
    system = _state_space(source, refusal)
    if not sensors_last:
        _refuse_unpaired(system)
    return of_passive(system, storage, refusal, kept, error)


def _as_it_is(
    source: Convertible, storage: str, lossless: bool, ports: PortPairs | None, names: SystemNames
) -> PortHamiltonian | None:
    """Form of lossless modes, or, unless storage or ports are given, of other modes and of systems of this package."""
    if isinstance(source, ModalForm) and source.is_lossless:
        return PortHamiltonian._from_modes(source, **names)
    if storage != "auto" or ports is not None:
        return None
    if isinstance(source, GeneralModalForm) and not lossless and (parts := parts_of_resonators(source)):
        from .dissipative import restored as with_losses

        return with_losses(parts, names, None, Conversion("modal", 0, 0.0))
    if not isinstance(source, LosslessSystem):
        return None
    if lossless and isinstance(source, PortHamiltonian):
        refuse_losses(source, "frequencies d and weights r are")
    return source._converted(**names)


def _lossless_modes(
    system: LinearSystem, required: bool, method: Discretisation | None, intersample: Interpolation
) -> tuple[ModalForm | None, NotLosslessError | None]:
    """Modes of a system if it is lossless, or why it is not, which is raised where that is required."""
    try:
        return foster_test.lossless_modes_with_errors(system, method, intersample).modes, None
    except NotLosslessError as refusal:
        if required:
            raise
        return None, refusal


def _refuse_unpaired(system: ct.StateSpace) -> None:
    """Refuse a system of other numbers of inputs and outputs."""
    if system.ninputs != system.noutputs or not system.ninputs:
        raise StructureError(
            f"the system has {system.ninputs} inputs and {system.noutputs} outputs; each input needs the output at its "
            "port: say which with ports=[(output, input), ..], the others become sensors"
        )


def _of_ports(sys: ct.StateSpace) -> ct.StateSpace:
    """The system without its sensors."""
    m = sys.ninputs
    return ct.ss(sys.A, sys.B, sys.C[:m], sys.D[:m])


def _state_space(source: LinearSystem, refusal: NotLosslessError | None) -> ct.StateSpace:
    """A system as matrices, or the refusal of one that has none."""
    lti = isinstance(source, scipy.signal.lti)
    if not lti and not isinstance(source, ct.StateSpace | ct.TransferFunction):
        raise StructureError(
            f"no port-Hamiltonian form of an object of type {type(source).__name__}; pass a StateSpace, a "
            "TransferFunction, a zero-pole-gain system, a ModalForm, or the matrices Q and B"
        )
    if not lti and source.isdtime(strict=True):
        raise StructureError(f"the system is in discrete time, dt = {source.dt}; ports are chosen in continuous time")
    if isinstance(source, ct.StateSpace):
        return source
    if isinstance(source, scipy.signal.StateSpace):
        return ct.ss(source.A, source.B, source.C, source.D)
    try:
        if lti:
            with warnings.catch_warnings():  # of coefficients that have no digits
                warnings.simplefilter("error")
                plain = source.to_tf()
                source = ct.tf(plain.num, plain.den)
        _refuse_improper(source)
        return state_space(source)
    except StructureError:
        raise
    except (ValueError, ArithmeticError, Warning) as error:  # improper, or out of range
        raise refusal or StructureError(f"the transfer function has no state space: {error}") from None


def _refuse_improper(source: ct.TransferFunction) -> None:
    """Refuse a transfer function that grows with frequency, and say what to convert in its place."""
    pairs = (pair for rows in zip(source.num_list, source.den_list, strict=True) for pair in zip(*rows, strict=True))
    above, below = max(((len(b) - 1, len(a) - 1) for b, a in pairs), key=lambda degrees: degrees[0] - degrees[1])
    if above <= below:
        return
    advice = (
        "its inverse has the same energy, with the two port variables exchanged, as the admittance of an impedance "
        "R + s L: convert ph(1 / G)"
        if source.issiso()
        else "exchange the two variables of the ports that carry it, as from impedance to admittance"
    )
    if above > below + 1:
        advice = "no passive system grows faster than s, so neither it nor its inverse has a port-Hamiltonian form"
    raise StructureError(
        f"the transfer function is improper: numerator of degree {above} over degree {below}; a port-Hamiltonian "
        f"system has a finite response at infinity; {advice}"
    )


def modes(
    d: ArrayLike | Convertible, r: ArrayLike | None = None, participation: ArrayLike | None = None, *,
    damping: ArrayLike | None = None,
) -> ModalForm:  # fmt: skip
    """Modal form of a system, or from frequencies and weights, or from poles and vectors.

    Parameters
    ----------
    d : array_like, shape (n,), or a system
        Natural frequencies, positive, rad per unit time, in any order; or poles, one of each pair of conjugates, with
        imaginary parts that are not negative; or, alone, any linear system of continuous time.
    r : array_like, shape (n,), or (n, p) beside poles
        Weights, not negative; or mode shapes at p outputs.
    participation : array_like, shape (n, m), optional
        What m inputs make of each mode; makes of `d` poles and of `r` mode shapes.
    damping : array_like, shape (n,), or a number, optional
        Damping ratios `zeta` of the modes `kappa s / (s^2 + 2 zeta d s + d^2)`, `kappa = r d`.

    Returns
    -------
    ModalForm
        Natural frequencies ascending; of a lossless system with `d` and `r`, the paper's unique identification
        coordinates, of any other with poles, `shapes` and `participation`.

    Raises
    ------
    StructureError, NotLosslessError
        If the arguments do not describe a linear system of continuous time.

    Notes
    -----
    The transfer function is `D + sum_l c_l b_l^T / (s - p_l)` over all poles, with shapes `c` and participation `b`.
    Poles that no well-conditioned transformation parts, as at critical damping, stay together as `clusters`: frequency
    responses keep their digits, and `residues` are refused where they would have none.  O(n^3) for a system.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.modes([3.0, 1.0], [0.5, 2.0])
    modes([1.0, 3.0], [2.0, 0.5])
    >>> damped = phc.modes([3.0, 1.0], [0.5, 2.0], damping=0.01)
    >>> damped.natural_frequencies, damped.damping_ratios.round(6)
    (array([1., 3.]), array([0.01, 0.01]))
    >>> damped.freqresp(1.0).round(3).item()
    (100.001+0.187j)
    """
    if participation is not None:
        if r is None or damping is not None:
            raise StructureError("with participation give poles and shapes, and no damping: the poles have it")
        return from_vectors(cast(ArrayLike, d), r, participation)
    if r is None and damping is not None:
        raise StructureError("damping is that of natural frequencies and weights; give d and r")
    if r is not None:
        d = cast(ArrayLike, d)
        return from_frequencies(d, r) if damping is None else with_damping(d, r, damping)
    if isinstance(d, ModalForm):
        return d
    try:
        return full_port_hamiltonian(d).modes
    except StructureError:
        if not isinstance(d, ct.StateSpace | ct.TransferFunction) or d.isdtime(strict=True) or not d.ninputs:
            raise
        return from_state_space(state_space(d))


def full_port_hamiltonian(sys: Convertible) -> PortHamiltonian:
    """Port-Hamiltonian system with the transfer function of `sys`, and with its hidden modes where it has a size."""
    if isinstance(sys, PortHamiltonian):
        return sys
    if isinstance(sys, LosslessSystem):
        return sys._full_port_hamiltonian()
    return ph(sys, lossless=True)

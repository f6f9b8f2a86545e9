"""Port-Hamiltonian systems that lose energy, with feedthrough, other structure matrices and sensors anywhere."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NoReturn

import control as ct
import numpy as np
from scipy.linalg import block_diag, eigh, qr

from .. import _checks
from .._checks import EPS
from .._display import latex_matrix, literal
from .._types import Array, ArrayLike, ComplexArray, SystemNames, Unpack
from .._units import with_unit
from ..exceptions import NotLosslessError, NotPassiveError, StructureError
from ..modal.general_form import GeneralModalForm, from_state_space, refined
from ..modal.modal_form import Cluster, ModalForm
from ..modal.positive_real import ResponseError, staircase
from ..numerics.definiteness import AT_ONCE, definite_factor, inverse_bound, uncoupled_halves, unit_diagonal
from ..numerics.double_double import exactly, product, two_sum
from ..symplectic.forms_and_williamson import energy_coordinates, symplectic_form
from .base import View, inherited_names, refuse_losses
from .passive_form import Conversion, PortRows, equations, hides_states, passive_parts
from .port_hamiltonian import PortHamiltonian, may_lose_digits, warn_of_ill_conditioning

_ROUNDING = 64  # times `size EPS`: negative eigenvalues that are taken for rounding
_COUPLED = 1e-9  # of the rates of the states: a coupling that is more than rounding of the matrices
PARTS = ("Q", "G", "J", "R", "P", "S", "N", "sensor_rows", "sensor_feedthrough")
_SHOWN = {"G": "B", "sensor_rows": "the matrix C of the sensors", "sensor_feedthrough": "the matrix D of the sensors"}


def _lossless_only(name: str, what: str) -> Any:
    def refuse(self: DissipativePortHamiltonian, *args: object, **kwargs: object) -> NoReturn:
        refuse_losses(self, what)
        raise AssertionError

    refuse.__name__, refuse.__doc__ = name, getattr(PortHamiltonian, name).__doc__
    return refuse


class DissipativePortHamiltonian(PortHamiltonian):
    """Port-Hamiltonian system with losses: `x' = (J - R) Q x + (G - P) u`, `y = (G + P)^T Q x + (S + N) u`.

    Made by `ph` with any of `R`, `P`, `S`, `N`, `J`, `sensors`.  A `PortHamiltonian` and a `control.StateSpace`: its
    `B` and `C` are those of the state space, `G` is the `B` that `ph` was given.

    Parameters
    ----------
    Q : array_like, shape (n, n)
        Hamiltonian matrix, symmetric positive semidefinite: the stored energy is `x^T Q x / 2`.
    B : array_like, shape (n,) or (n, m)
        Port matrix; the attribute `G`.
    R : array_like, shape (n, n), optional
        Symmetric dissipation matrix.
    P : array_like, shape (n, m), optional
        Dissipation between states and ports.
    S, N : array_like, shape (m, m), optional
        Symmetric and skew part of the feedthrough of the ports.
    J : array_like, shape (n, n), optional
        Skew structure matrix; default the canonical one.
    sensors : array_like, shape (k, n), or (array_like, array_like), shapes (k, n) and (k, m), optional
        State and input rows of outputs that are no port variables; they come after those of the ports.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Raises
    ------
    StructureError
        If `Q` or `[[R, P], [P^T, S]]` has a negative eigenvalue, `J` or `N` is not skew, or sizes do not fit.

    Notes
    -----
    `dH/dt = u^T y - [e; u]^T W [e; u]` with `e = Q x` and `W = [[R, P], [P^T, S]] >= 0`.  Matrices are read-only.
    Frequency responses, poles and simulations run on the modal form, O(n) a point; what takes O(n^3) is computed on
    first access and kept.  Up to 500 states, modes are corrected by residuals of twice the digits: where a
    transformation parts the poles, they are right to their own rounding.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> damped = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.4]))
    >>> damped.natural_frequencies, damped.damping_ratios
    (array([2.]), array([0.1]))
    >>> damped.is_lossless, phc.passivity(damped).is_passive
    (False, True)
    """

    _factory = "ph(Q, B, R=R)"
    conversion: Conversion | None = None  # how `ph` made it of another system
    _in_normal_form = False

    def __init__(
        self, Q: ArrayLike, B: ArrayLike, *, R: ArrayLike | None = None, P: ArrayLike | None = None,
        S: ArrayLike | None = None, N: ArrayLike | None = None, J: ArrayLike | None = None,
        sensors: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None, **names: Unpack[SystemNames],
    ) -> None:  # fmt: skip
        Q = _checks.symmetric_matrix(Q, even=J is None)
        n = len(Q)
        refuse_negative("Q", Q, {"Q": slice(0, n)})
        B = _checks.port_matrix(B, n)
        m = B.shape[1]
        parts = {
            "Q": Q, "G": B,
            "J": symplectic_form(n // 2) if J is None else _checks.skew_matrix("J", _shaped("J", J, (n, n))),
            "R": _symmetric("R", R, n), "P": _shaped("P", P, (n, m)), "S": _symmetric("S", S, m),
            "N": _checks.skew_matrix("N", _shaped("N", N, (m, m))),
        }  # fmt: skip
        W = np.block([[parts["R"], parts["P"]], [parts["P"].T, parts["S"]]])
        refuse_negative("W = [[R, P], [P^T, S]]", W, {"R": slice(0, n), "S": slice(n, n + m)})
        rows, through = sensors if isinstance(sensors, tuple) and len(sensors) == 2 else (sensors, None)
        parts["sensor_rows"] = checked_rows("the sensors", rows, n)
        parts["sensor_feedthrough"] = _shaped("the feedthrough of the sensors", through, (len(parts["sensor_rows"]), m))
        self._take(parts, names)
        # with another J the states are not those of which Q tells the frequencies
        if n <= AT_ONCE and is_canonical(parts["J"]) and may_lose_digits(Q, inverse_bound(Q)):
            with suppress(StructureError):  # an energy that is negative by more than rounding has no frequencies
                warn_of_ill_conditioning(Q, energy_coordinates(Q))

    def _take(self, parts: dict[str, Array], names: SystemNames) -> None:
        for name in PARTS:
            _checks.in_range(_SHOWN.get(name, name), parts[name])
        self._parts = {name: _checks.readonly(parts[name]) for name in PARTS}
        self._given, self._modes = None, None
        n, m = self._parts["G"].shape
        self._setup(n, m, names, m + len(self._parts["sensor_rows"]))

    # --- matrices ------------------------------------------------------------------------------------------------

    Q = property(lambda self: self._parts["Q"], doc="Hamiltonian matrix, shape (n, n), read-only.")
    G = property(lambda self: self._parts["G"], doc="Port matrix, shape (n, m), read-only: the `B` that `ph` takes.")
    J = property(lambda self: self._parts["J"], doc="Skew structure matrix, shape (n, n), read-only.")
    R = property(lambda self: self._parts["R"], doc="Dissipation matrix, shape (n, n), read-only.")
    P = property(lambda self: self._parts["P"], doc="Dissipation between states and ports, shape (n, m), read-only.")
    S = property(lambda self: self._parts["S"], doc="Symmetric part of the feedthrough, shape (m, m), read-only.")
    N = property(lambda self: self._parts["N"], doc="Skew part of the feedthrough, shape (m, m), read-only.")

    @property
    def sensors(self) -> tuple[Array, Array]:
        """State rows (k, n) and input rows (k, m) of the outputs after those of the ports."""
        return self._parts["sensor_rows"], self._parts["sensor_feedthrough"]

    @View
    def A(self) -> Array:
        """Dynamics matrix `(J - R) Q`, shape (n, n), read-only."""
        return (self.J - self.R) @ self.Q

    @View
    def B(self) -> Array:
        """Input matrix `G - P` of the state space, shape (n, m), read-only."""
        return self.G - self.P

    @View
    def C(self) -> Array:
        """Output matrix, `(G + P)^T Q` above the rows of the sensors, shape (m + k, n), read-only."""
        return np.vstack([(self.G + self.P).T @ self.Q, self.sensors[0]])

    @View
    def D(self) -> Array:
        """Feedthrough, `S + N` above that of the sensors, shape (m + k, m), read-only."""
        return np.vstack([self.S + self.N, self.sensors[1]])

    # --- modal coordinates -----------------------------------------------------------------------------------------

    @View
    def _split(self) -> GeneralModalForm:
        """Modes with all states for inputs and outputs beside those of the system."""
        n = len(self.Q)
        rows, columns = np.vstack([self.C, np.eye(n)]), np.hstack([self.B, np.eye(n)])
        none = np.zeros((len(rows), n + self.ninputs))
        form = from_state_space(ct.ss(self.A, columns, rows, none))
        return refined(form, product(two_sum(self.J, -self.R), exactly(self.Q)), columns, rows, none)

    @property
    def modes(self) -> ModalForm:
        """Modal form, O(n^3) once."""
        return self._of_split

    @View
    def _of_split(self) -> GeneralModalForm:
        form, p, m = self._split, self.noutputs, self.ninputs
        blocks = [Cluster(block.A, block.B[:, :m].copy(), block.C[:p].copy()) for block in form.clusters]
        return GeneralModalForm(
            form._poles.copy(), form._shapes[:, :p].copy(), form._participation[:, :m].copy(), self.D.copy(), blocks
        )

    @property
    def is_lossless(self) -> bool:
        """Whether `R = P = S = 0`: nothing is lost whatever the input."""
        return not (self.R.any() or self.P.any() or self.S.any())

    def lossless_part(self) -> PortHamiltonian:
        """Port-Hamiltonian system of the same `Q`, `B` and `J` without losses, feedthrough and sensors.

        Returns
        -------
        PortHamiltonian
            In the coordinates `(q, p)`; with another `J` in Darboux coordinates.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.4])).lossless_part().d
        array([2.])
        """
        from .port_hamiltonian import ph

        part = ph(self.Q, self.G) if is_canonical(self.J) else ph(self.Q, self.G, J=self.J)
        return with_unit(part, self.time_unit)

    def _beyond_lossless(self) -> list[str]:
        matrices = {"R": "losses R", "P": "losses P", "S": "feedthrough S", "N": "feedthrough N"}
        terms = [text for name, text in matrices.items() if self._parts[name].any()]
        sensors = len(self._parts["sensor_rows"])
        if not is_canonical(self.J):
            terms.append("a structure matrix J of its own")
        return terms + ([f"{sensors} sensor{'s' * (sensors > 1)}"] if sensors else []) or ["room for losses"]

    @property
    def _spectrum(self) -> ModalForm:
        return self.modes

    def frequency_response(
        self, omega: ArrayLike | None = None, squeeze: bool | None = None
    ) -> ct.FrequencyResponseData:
        """Frequency response as data, from the modes."""
        return ct.StateSpace.frequency_response(self, omega, squeeze)

    def poles(self) -> ComplexArray:
        """Eigenvalues of A, shape (n,)."""
        return self.modes.poles

    @View
    def _squares(self) -> tuple[Array, ...]:
        # in units of the states, where no energy is below the rounding of others; that of free motions is
        scaled, scale = unit_diagonal(self.Q)
        k, U = eigh(scaled)
        return (np.sqrt(np.where(k > 8 * len(k) * EPS, k, 0.0))[:, None] * U.T * scale,)

    d = property(_lossless_only("d", "the frequencies d and weights r are"))
    r = property(_lossless_only("r", "the frequencies d and weights r are"))
    v = property(_lossless_only("v", "Williamson coordinates are"))
    is_canonical = property(_lossless_only("is_canonical", "canonical systems are"))
    _energy = property(_lossless_only("_energy", "Williamson coordinates are"))
    _reduction = property(_lossless_only("_reduction", "the canonical part and its margins are"))
    rigid_modes = property(_lossless_only("rigid_modes", "rigid-body modes are"))
    _separation = _lossless_only("_separation", "the canonical part and its margins are")

    def _converted(self, **names: Unpack[SystemNames]) -> DissipativePortHamiltonian:
        names = inherited_names(self, names, "inputs", "outputs", "states")
        return restored(self._parts, names, self.time_unit, self.conversion)

    # --- what python-control asks a system ------------------------------------------------------------------------

    def _scaled(self, factor: float) -> DissipativePortHamiltonian:
        """Input and output of the ports each by the square root; those of the sensors by both."""
        root = np.sqrt(factor)
        scale = {"G": root, "P": root, "S": factor, "N": factor, "sensor_rows": root, "sensor_feedthrough": factor}
        parts = {name: scale.get(name, 1.0) * part for name, part in self._parts.items()}
        _checks.in_range(f"B times the square root of {factor:.3g}", parts["G"], _checks.SMALLEST_SQUARED)
        return restored(parts, {}, self.time_unit)

    def __reduce__(self) -> tuple[object, ...]:
        known = dict(self._parts), self._names(), self.time_unit, self.conversion
        return restored, known, self._attached()

    def _shown(self) -> list[str]:
        """Names of the parts beside Q and B that are not what they are by default."""
        return [name for name in "RPSN" if self._parts[name].any()] + ["J"] * (not is_canonical(self.J))

    def _repr_eval_(self) -> str:
        given = [literal(self.Q), literal(self.G)]
        given += [f"{name}={literal(self._parts[name])}" for name in self._shown()]
        rows, through = self.sensors
        if len(rows):
            given.append(
                f"sensors=({literal(rows)},\n{literal(through)})" if through.any() else f"sensors={literal(rows)}"
            )
        labels = [text for text in [self._label_repr()] if text]
        # of none of them `ph` makes a lossless system of its own class
        maker = "ph" if len(given) > 2 and given[2][0] != "J" else type(self).__name__
        return f"{maker}(\n" + ",\n".join(given + labels) + ")"

    def _equations(self) -> str:
        shown, sensors = self._shown(), bool(len(self.sensors[0]))
        loss = "(J - R)" if "R" in shown else "J"
        into, out = ("(B - P)", "(B + P)") if "P" in shown else ("B", "B")
        through = " + ".join(name for name in "SN" if name in shown)
        through = f" + ({through}) u" if len(through) > 1 else f" + {through} u" if through else ""
        text = rf"\dot x = {loss} Q x + {into} u, \quad y = {out}^\top Q x{through}"
        matrices = {"Q": self.Q, "B": self.G} | {name: self._parts[name] for name in shown}
        if sensors:
            text += r", \quad y_s = C_s x" + (" + D_s u" if self.sensors[1].any() else "")
            matrices |= {"C_s": self.sensors[0]} | ({"D_s": self.sensors[1]} if self.sensors[1].any() else {})
        return text + "".join(rf", \quad {name} = {latex_matrix(matrix)}" for name, matrix in matrices.items())


def is_canonical(J: Array) -> bool:
    """Whether a structure matrix is `[[0, I], [-I, 0]]`."""
    return len(J) % 2 == 0 and np.array_equal(J, symplectic_form(len(J) // 2))


def parts_of(sys: PortHamiltonian) -> dict[str, Array]:
    """Matrices of the equations of any port-Hamiltonian system."""
    if isinstance(sys, DissipativePortHamiltonian):
        return sys._parts
    (n, m), none = sys.B.shape, np.zeros
    return {
        "Q": sys.Q, "G": sys.B, "J": symplectic_form(n // 2), "R": none((n, n)), "P": none((n, m)), "S": none((m, m)),
        "N": none((m, m)), "sensor_rows": none((0, n)), "sensor_feedthrough": none((0, m)),
    }  # fmt: skip


def restored(
    parts: dict[str, Array], names: SystemNames, time_unit: str | None, conversion: Conversion | None = None
) -> DissipativePortHamiltonian:
    """System of matrices that have been checked."""
    system = DissipativePortHamiltonian.__new__(DissipativePortHamiltonian)
    system._take(parts, names)
    system.time_unit, system.conversion = time_unit, conversion
    return system


def of_passive(
    sys: ct.StateSpace, storage: str, refusal: NotLosslessError | None, names: SystemNames,
    error: ResponseError | None = None,
) -> DissipativePortHamiltonian:  # fmt: skip
    """Port-Hamiltonian form of a passive system, whose first outputs are those of its ports.

    `error` bounds those of its response beyond roundings of its matrices.
    """
    A, B, C, D = (np.array(getattr(sys, name), float) for name in "ABCD")
    given = PortRows(A, B, C, D, error)
    for name in "ABCD":
        _checks.finite(name, getattr(given, name))
    parts, conversion = passive_parts(given, storage, refusal)
    return restored(parts, names, None, conversion)


def minimal_of(system: DissipativePortHamiltonian) -> DissipativePortHamiltonian:
    """System of the same transfer function with the states that ports reach and see; as it is if these are all."""
    parts = _with_definite_energy(system._parts)
    still = len(system.Q) - len(parts["Q"])
    conversion = Conversion("given", 0, 0.0)
    given = PortRows(*equations(parts))
    if not _is_clearly_minimal(parts) and hides_states(given):
        try:
            parts, conversion = passive_parts(given, "auto", None, minimal=True)
        except NotPassiveError as error:  # it is passive, by its matrices
            cause = (
                "a sensor sees what ports do not, such as the position of a free mass; leave it out"
                if len(system.sensors[0])
                else "its matrices are ill-conditioned; give it in better scaled states"
            )
            raise StructureError(f"no minimal form of {system.name!r} is known to be passive: {cause}") from error
    names: SystemNames = {"inputs": system.input_labels, "outputs": system.output_labels}
    return restored(parts, names, system.time_unit, replace(conversion, hidden=conversion.hidden + still))


def _is_clearly_minimal(parts: dict[str, Array]) -> bool:
    """Whether ports reach and see all states, each by a coupling that is no rounding, however little of it arrives."""
    factor = definite_factor(parts["Q"])
    if factor is None:
        return False
    F, G, P = factor[0], parts["G"], parts["P"]
    kept, _, _ = staircase(F.T @ (parts["J"] - parts["R"]) @ F, F.T @ (G - P), (G + P).T @ F, _COUPLED)
    return len(kept) == len(F)


def _with_definite_energy(parts: dict[str, Array]) -> dict[str, Array]:
    """Matrices of the equations without the states that store no energy, as they are if there is none or one is sensed.

    With `Q = L^T Q' L` the states `L x` obey equations of the same form, in which the kernel of `Q`, such as the
    position of a floating structure, does not appear.
    """
    L, Q = _energetic(parts["Q"])
    if len(Q) == len(L.T) or _sensed(parts["sensor_rows"], L):
        return parts
    skew, loss = L @ parts["J"] @ L.T, L @ parts["R"] @ L.T
    return parts | {
        "Q": Q, "J": 0.5 * (skew - skew.T), "R": 0.5 * (loss + loss.T), "G": L @ parts["G"], "P": L @ parts["P"],
        "sensor_rows": np.linalg.lstsq(L.T, parts["sensor_rows"].T)[0].T,
    }  # fmt: skip


def _energetic(Q: Array) -> tuple[Array, Array]:
    """Rows `L` and definite `Q'` with `Q = L^T Q' L`; positions and momenta that `Q` does not couple stay apart."""
    rows, energies = [], []
    for half in uncoupled_halves(Q):
        if definite_factor(half) is not None:
            rows.append(np.eye(len(half)))
            energies.append(half)
            continue
        scaled, scale = unit_diagonal(half)
        k, U = eigh(scaled)
        kept = k > 8 * len(Q) * EPS
        rows.append(np.sqrt(k[kept])[:, None] * U[:, kept].T * scale)
        energies.append(np.eye(int(kept.sum())))
    return block_diag(*rows), block_diag(*energies)


def _sensed(rows: Array, L: Array) -> bool:
    """Whether a sensor sees what is no combination of the rows `L`."""
    scale = np.linalg.norm(L, axis=0)
    scale[scale == 0] = scale.max(initial=0.0) or 1.0
    basis = qr((L / scale).T, mode="economic")[0]
    seen = rows / scale
    beside, size = (float(np.abs(M).max(initial=0.0)) for M in (seen - seen @ basis @ basis.T, seen))
    return beside > _ROUNDING * len(scale) * EPS * size


# --- checks ------------------------------------------------------------------------------------------------------


def _shaped(name: str, value: ArrayLike | None, shape: tuple[int, int]) -> Array:
    if value is None:
        return np.zeros(shape)
    array = _checks.real_array(name, value)
    if array.ndim < 2 and array.size == shape[0] * shape[1]:
        array = array.reshape(shape)
    if array.shape != shape:
        raise StructureError(f"{name} has shape {np.shape(value)}; it must be {shape}")
    return array


def checked_rows(name: str, value: ArrayLike | None, columns: int) -> Array:
    """Check rows of outputs, none of them where `value` is None."""
    if value is None:
        return np.zeros((0, columns))
    array = np.atleast_2d(_checks.real_array(name, value))
    if array.ndim != 2 or array.shape[1] != columns:
        raise StructureError(f"{name} have shape {np.shape(value)}; they must be (k, {columns}), one row an output")
    return array


def _symmetric(name: str, value: ArrayLike | None, size: int) -> Array:
    array = _shaped(name, value, (size, size))
    return array if value is None else 0.5 * array + 0.5 * _checks.symmetric_matrix(array, name=name, even=False).T


def refuse_negative(name: str, matrix: Array, blocks: dict[str, slice]) -> None:
    """Refuse a symmetric matrix with a negative eigenvalue, and say in which block its eigenvector lies."""
    if not matrix.any():
        return
    # scaled to a unit diagonal, so that small blocks count as much as large ones
    diagonal = np.diag(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, np.abs(matrix).max()))
    k, U = eigh(matrix / scale[:, None] / scale, subset_by_index=(0, 0))
    if k[0] >= -_ROUNDING * len(matrix) * EPS * np.abs(matrix / scale[:, None] / scale).max():
        return
    shares = {block: float(np.sum(U[rows, 0] ** 2)) for block, rows in blocks.items()}
    block = max(shares, key=lambda label: shares[label])
    where = f", with {100 * shares[block]:.0f} % of its eigenvector in the rows of {block}" if len(blocks) > 1 else ""
    raise StructureError(
        f"{name} has a negative eigenvalue: {k[0]:.3g} after scaling to unit diagonal{where}; it must be positive "
        "semidefinite, or the system makes energy"
    )

"""Fewer states behind one filter: minimal realisation and Kalman decomposition.

Two faces of one map, of which lifting is the third.  In Williamson coordinates the modes of one frequency turn among
themselves until a single one meets the port; what does so is canonical, what does not is a system of its own that
nobody sees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, SupportsIndex

import control as ct
import numpy as np

from .. import _checks
from .._types import Array, ComplexArray
from ..exceptions import StructureError
from ..modal.error_bounds import Group, Separation, as_decided
from ..modal.minimal import minimal_of_exact
from ..modal.modal_form import ModalForm
from .base import Convertible, LosslessSystem, in_normal_form, refuse_losses
from .dissipative import DissipativePortHamiltonian, minimal_of
from .port_hamiltonian import PortHamiltonian, full_port_hamiltonian, ph

_NEAR = 1e-9  # relative distance of frequencies that a symmetric structure may mean to be one
_SURE_GAP = 2e-6  # relative gap of frequencies beyond which weights, however computed, agree to 1e-10


@dataclass(frozen=True, eq=False, repr=False)
class KalmanDecomposition(Sequence["PortHamiltonian | Array"]):
    """A system as the direct sum of what its port reaches and what it does not; made by `kalman_decomposition`.

    A sequence of three: `reachable, hidden, T = kalman_decomposition(sys)`.

    Attributes
    ----------
    reachable : PortHamiltonian
        Canonical, in Williamson coordinates, with the transfer function of the whole.
    hidden : PortHamiltonian
        In Williamson coordinates, with an input matrix that is exactly 0; possibly without states.
    T : ndarray, shape (2n, 2n)
        Symplectic; maps the states `z` of the system to `(q_reachable, q_hidden, p_reachable, p_hidden)`.  Computed
        when it is first looked at.

    Examples
    --------
    See `kalman_decomposition`.
    """

    __array_ufunc__ = None  # it is compared with an array as a whole, not entry by entry

    reachable: PortHamiltonian
    hidden: PortHamiltonian
    _transformation: Callable[[], Array]

    @cached_property
    def T(self) -> Array:
        """Symplectic matrix onto the states of the direct sum, shape (2n, 2n), read-only."""
        return _checks.readonly(self._transformation())

    def __len__(self) -> int:
        return 3

    def __getitem__(self, index: SupportsIndex | slice) -> Any:
        names = ("reachable", "hidden", "T")[index]
        return getattr(self, names) if isinstance(names, str) else tuple(getattr(self, name) for name in names)

    def __repr__(self) -> str:
        return f"KalmanDecomposition(reachable=<{self.reachable.n} modes>, hidden=<{self.hidden.n} modes>)"

    def __reduce__(self) -> tuple[object, ...]:
        return _restored, (self.reachable, self.hidden, self.T.copy())


def _restored(reachable: PortHamiltonian, hidden: PortHamiltonian, T: Array) -> KalmanDecomposition:
    return KalmanDecomposition(reachable, hidden, lambda: T)


@dataclass(frozen=True)
class CanonicalMargins:
    """Distance of a system from those that their port does not determine; made by `canonical_margins`.

    Attributes
    ----------
    is_canonical : bool
        Whether the system is controllable, which is the same as observable.
    resonance : float
        Relative distance `|d_j - d_l| / max(d_j, d_l)` of the pair that is nearest to one frequency; infinite for
        a single mode.
    resonance_tolerance : float
        The distance that errors of these two frequencies allow.
    pair : tuple of int, or None
        Their indices in `d`, from 0; the text counts from 1.
    degeneracy : float
        Residue of the mode that is nearest to being unreached, over the largest: `kappa_l / max kappa`.  Modes that
        count as one frequency count with their total.
    degeneracy_tolerance : float
        The ratio that the error of its weight allows.
    mode : int or None
        Its index in `d`.
    rigid : int
        Degrees of freedom without a frequency: with one, a system is never canonical.
    near_pairs : int
        Pairs of frequencies that `minreal` keeps apart although they lie within 1e-9 of each other, as those of a
        symmetric structure whose matrices are rounded; `minreal(sys, rtol=1e-9)` merges them.

    Examples
    --------
    >>> import ph_control as phc
    >>> margins = phc.canonical_margins(phc.ph(phc.modes([1.0, 2.0], [1.0, 0.25])))
    >>> margins.is_canonical, margins.resonance, margins.pair
    (True, 0.5, (0, 1))
    >>> margins.degeneracy, margins.mode
    (0.5, 1)
    """

    is_canonical: bool
    resonance: float
    resonance_tolerance: float
    pair: tuple[int, int] | None
    degeneracy: float
    degeneracy_tolerance: float
    mode: int | None
    rigid: int
    near_pairs: int = 0

    def __str__(self) -> str:
        lines = [f"the system is {'' if self.is_canonical else 'not '}canonical"]
        if self.pair is not None:
            lines.append(
                f"  resonance: the frequencies of modes {self.pair[0] + 1} and {self.pair[1] + 1} differ by "
                f"{self.resonance:.3g} of their size, one frequency up to {self.resonance_tolerance:.1e}"
            )
        if self.mode is not None:
            lines.append(
                f"  degeneracy: the residue of mode {self.mode + 1} is {self.degeneracy:.3g} of the largest, "
                f"unreached up to {self.degeneracy_tolerance:.1e}"
            )
        if self.rigid:
            lines.append(f"  degrees of freedom without a frequency: {self.rigid}, in a canonical system 0")
        if self.near_pairs:
            lines.append(
                f"  pairs of frequencies within {_NEAR:.0e}, kept apart: {self.near_pairs}; if each is one, as in a "
                f"symmetric structure, minreal(sys, rtol={_NEAR:.0e}) merges them"
            )
        return "\n".join(lines)


def minreal(sys: Convertible, *, rtol: float | None = None) -> PortHamiltonian:
    """Minimal port-Hamiltonian system with the same transfer function.

    Parameters
    ----------
    sys : PortHamiltonian, or anything that `ph` takes
        System with any number of ports, with losses or without; its `Q` may be semidefinite.
    rtol : float, optional
        Relative tolerance, instead of bounds of the rounding errors: frequencies closer than `rtol * d` are one, and
        a residue of at most `rtol` times the largest is 0.  Of lossless systems only.

    Returns
    -------
    PortHamiltonian
        In Williamson coordinates; inputs and outputs keep their names.  With losses, feedthrough or sensors a
        `DissipativePortHamiltonian` whose `conversion` has the number of states left out, `hidden`.

    Raises
    ------
    NotPassiveError, NotLosslessError
        If the system has no port-Hamiltonian form, or has losses and `rtol` is given.
    StructureError
        If it is of no kind that `ph` takes, a sensor sees states that would be left out, or `rtol` is no number from
        0 to 1.

    Warns
    -----
    ConditioningWarning
        If with losses the transfer functions differ by more than 1e-10 of the largest value.

    See Also
    --------
    canonical_margins, kalman_decomposition

    Notes
    -----
    For one port, modes of equal frequency are one whose weight is the sum of theirs, and unreached modes are
    dropped.  Where frequencies are closer than they are known, nothing can tell them apart, and merging them keeps
    their total residue.  With m ports a frequency stays up to m times.  A rigid-body mode stays as one
    degree of freedom for each pole at 0, although its position is not observable: no smaller system is
    port-Hamiltonian.

    Symmetric structures have pairs of modes that rounding of `Q`, more than that of doubles, has taken apart:
    `canonical_margins` says how many lie within 1e-9, and `rtol=1e-9` merges them.

    With losses, states that store no energy go first, such as the position of a structure that no spring ties to the
    ground.  Where ports reach and see all others by couplings of more than 1e-9 of their rates, that is all: the rest
    keeps its energy, and momenta their coordinates.  Else states are left out whose Hankel singular values are 0 to
    1e-13 of the largest, and undamped modes without a residue.  What is left has the energy of its modes where damping
    is classical, else the mean storage of its ports, as from `ph`.  A system without hidden states is returned in its
    own coordinates, with its own energy.  O(n^3).

    Modes that are known are merged in O(n).  Of a matrix it is O(n^3), and for one port mostly without mode shapes:
    each bound of an error lies between two that need none, and where both lead to the same decision it is made.  `d`
    and `r` are then as accurate as those of a system that has not been asked for `sys.modes`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> equal_branches = phc.lc_circuit([1.0, 1.0, 4.0], 1.0)
    >>> small = phc.minreal(equal_branches)
    >>> small.d, small.r
    (array([0.5, 1. ]), array([2., 2.]))
    >>> damped = phc.minreal(phc.lc_circuit([1.0, 1.0, 4.0], 1.0, R=0.1))
    >>> damped.nstates, damped.conversion.hidden
    (4, 2)
    """
    if rtol is None and isinstance(sys, ModalForm) and sys.is_lossless and (known := minimal_of_exact(sys)) is not None:
        return PortHamiltonian._from_modes(known)
    system = full_port_hamiltonian(sys) if isinstance(sys, LosslessSystem) else ph(sys)
    if isinstance(system, DissipativePortHamiltonian):
        if rtol is not None:
            refuse_losses(system, "tolerances of frequencies are")
        small = minimal_of(system)
        if system is not sys and system.conversion is not None and small.conversion is not None:
            hidden = system.conversion.hidden + small.conversion.hidden
            small.conversion = replace(small.conversion, hidden=hidden)
        return small
    return _named_like(system, system._minimal if rtol is None else system._separation(rtol).minimal())


def kalman_decomposition(sys: Convertible, *, rtol: float | None = None) -> KalmanDecomposition:
    """Split a system into a canonical one and one that the port neither moves nor sees.

    For `Q > 0` the reachable subspace is symplectic and its `Q`-orthogonal complement is the unobservable one, so
    that both parts are port-Hamiltonian.

    Parameters
    ----------
    sys : PortHamiltonian, or anything that `ph` takes
        System with one port and positive definite `Q`.
    rtol : float, optional
        Relative tolerance as for `minreal`.

    Returns
    -------
    reachable : PortHamiltonian
        Canonical, `k` degrees of freedom, Williamson coordinates, `B = (sqrt(r), 0)`.
    hidden : PortHamiltonian
        The other `n - k`, with `B = 0` exactly; without states if the system is canonical.
    T : ndarray, shape (2n, 2n)
        Symplectic matrix.  In the states `T z`, ordered `(q_reachable, q_hidden, p_reachable, p_hidden)`, the
        system is the direct sum: `T^{-T} Q T^{-1}` and `T B` are `Q` and `B` of `reachable + hidden`.

    Raises
    ------
    NotLosslessError
        If the system has no port-Hamiltonian form.
    StructureError
        If it has several ports, `Q` is only semidefinite, or `rtol` is no number from 0 to 1.

    See Also
    --------
    minreal

    Notes
    -----
    Of k modes of one frequency, which have no coordinates of their own, an element of `U(k)` takes one onto the
    input.  The direct sum holds within the error bounds by which modes were called equal or unreached.  O(n^3).  Where
    frequencies differ by more than 2e-6 of their size or not at all, the two systems cost no more than `minreal`, and
    `T`, which takes all mode shapes, is computed when it is looked at; elsewhere all come from the same mode shapes.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> reachable, hidden, T = phc.kalman_decomposition(phc.ph(np.eye(4), [3.0, 4.0, 0.0, 0.0]))
    >>> reachable.B.ravel(), hidden.n
    (array([5., 0.]), 1)
    >>> (T @ [3.0, 4.0, 0.0, 0.0]).round(12) + 0.0
    array([5., 0., 0., 0.])
    """
    system = _with_hidden_modes(sys, "the Kalman decomposition is that of one port")
    reduction = system._reduction if rtol is None else None
    if reduction is not None and reduction.gap < _SURE_GAP:
        reduction = None
    if reduction is None and len(system.d) < system.n:
        raise StructureError(
            f"Q is only positive semidefinite: {system.n - len(system.d)} of {system.n} degrees of freedom have no "
            "frequency, and what is reachable is then more than what is observable; use minreal"
        )
    split = reduction or system._separation(rtol)
    hidden = split.hidden()
    unseen = ModalForm._of(hidden, np.zeros((len(hidden), 1), complex), np.zeros((0, 1)))

    def transformation() -> Array:
        if isinstance(split, Separation):
            return _transformation(system, split.groups)
        return _transformation(system, as_decided(system.modes, split.starts, split.reached))

    return KalmanDecomposition(_named_like(system, split.minimal()), _named_like(system, unseen), transformation)


def canonical_margins(sys: Convertible) -> CanonicalMargins:
    """Tell whether a system is canonical, and by how much.

    A system with `Q > 0` is canonical iff its frequencies differ (non-resonance) and each mode is reached
    (non-degeneracy).

    Parameters
    ----------
    sys : PortHamiltonian, or anything that `ph` takes
        System with one port.

    Returns
    -------
    CanonicalMargins
        The verdict, the smallest distances, and the tolerances each was held against; printable.

    Raises
    ------
    NotLosslessError
        If the system has no port-Hamiltonian form.
    StructureError
        If it has several ports.

    See Also
    --------
    minreal

    Notes
    -----
    The tolerances are bounds of the rounding errors: of a few units in the last place for a system given by its
    modes, of what the condition of `Q` makes of them for one given by matrices.  Smallest means with the least room
    above the tolerance.  For `Q > 0`, canonical iff `minreal` has the same order.  O(n^3).

    Examples
    --------
    >>> import ph_control as phc
    >>> print(phc.canonical_margins(phc.modes([1.0, 2.0, 2.5], [1.0, 0.5, 0.01])))
    the system is canonical
      resonance: the frequencies of modes 2 and 3 differ by 0.2 of their size, one frequency up to 4.8e-15
      degeneracy: the residue of mode 3 is 0.025 of the largest, unreached up to 0.0e+00
    """
    system = _with_hidden_modes(sys, "the canonical margins are those of one port")
    separation = system._separation()
    rigid = system.n - len(system.d)
    resonance, close, pair = _least_distance(system.d, separation.errors.d)
    degeneracy, faint, mode = _least_residue(separation)
    near = int(np.count_nonzero(np.diff(separation.minimal().d) <= _NEAR * separation.minimal().d[1:]))
    canonical = rigid == 0 and separation.is_minimal
    return CanonicalMargins(canonical, resonance, close, pair, degeneracy, faint, mode, rigid, near)


def _with_hidden_modes(sys: Convertible, limit: str) -> PortHamiltonian:
    """Port-Hamiltonian system of one port with all that `sys` has; refused where a conversion left states behind."""
    system = full_port_hamiltonian(sys)
    if system.ninputs != 1:
        raise StructureError(f"the system has {system.ninputs} ports; {limit}: choose one by its column of B")
    if not isinstance(sys, ct.StateSpace) or in_normal_form(sys) or sys.nstates == system.nstates:
        return system
    visible = 2 * len(system.d) + len(system.modes.rigid)
    if visible < sys.nstates:
        raise StructureError(
            f"the system has {sys.nstates} states, of which {visible} take part in its transfer function; what "
            "the others store cannot be told from these matrices, so they are no part of its port-Hamiltonian form: "
            "use minreal(sys), or give the energy, ph(Q, B)"
        )
    return system


def _named_like(system: PortHamiltonian, modes: ModalForm) -> PortHamiltonian:
    named = PortHamiltonian._from_modes(modes)
    named.input_index, named.output_index = system.input_index.copy(), system.output_index.copy()
    return named


def _transformation(system: PortHamiltonian, groups: tuple[Group, ...]) -> Array:
    """Symplectic matrix whose rows are those of Williamson's `S`, rotated as the groups are."""
    d, E, _ = system._energy
    rows = E / np.sqrt(d)[:, None]
    reached, hidden = (_rows_by_frequency(groups, rows, reached=part) for part in (True, False))
    return np.concatenate([reached.real, hidden.real, reached.imag, hidden.imag])


def _rows_by_frequency(groups: tuple[Group, ...], rows: ComplexArray, *, reached: bool) -> ComplexArray:
    """Williamson rows `S_l + i S_{n+l}` of one part, rotated as its groups are, in ascending order of frequency."""
    parts = [(g, slice(g.rank) if reached else slice(g.rank, None)) for g in groups]
    d = np.concatenate([np.zeros(0), *(g.d[part] for g, part in parts)])
    turned = [g.rotation[part] @ rows[g.members] for g, part in parts]
    return np.concatenate([rows[:0], *turned])[np.argsort(d, kind="stable")]


# --- margins -------------------------------------------------------------------------------------------------


def _least_distance(d: Array, error: Array) -> tuple[float, float, tuple[int, int] | None]:
    """The pair of frequencies with the least room above its tolerance: relative distance, tolerance, indices."""
    if len(d) < 2:
        return np.inf, 0.0, None
    larger = np.maximum(d[:, None], d)
    distance, allowed = np.abs(d[:, None] - d) / larger, (error[:, None] + error) / larger
    room = np.where(np.tri(len(d), dtype=bool), np.inf, distance - allowed)
    j, l = (int(k) for k in np.unravel_index(room.argmin(), room.shape))
    return float(distance[j, l]), float(allowed[j, l]), (j, l)


def _least_residue(separation: Separation) -> tuple[float, float, int | None]:
    """The mode with the least room above its tolerance: residue over the largest, tolerance, index."""
    d = separation.modes.d
    if len(d) == 0:
        return 1.0, 0.0, None
    residue, allowed = d * separation.strength**2, d * separation.errors.nu**2
    largest = float(residue.max()) or 1.0
    mode = int((residue - allowed).argmin())
    return float(residue[mode]) / largest, float(allowed[mode]) / largest, mode

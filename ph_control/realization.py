"""Fewer and more states behind one filter: minimal realisation, Kalman decomposition, lifting.

Three faces of one map.  In Williamson coordinates the modes of one frequency turn among themselves until a single
one meets the port; what does so is canonical, what does not is a system of its own that nobody sees, and adding
such a system changes nothing.
"""

from __future__ import annotations

import heapq
import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _checks
from .conditioning import Energy, Group, Separation, separate
from .exceptions import StructureError
from .lossless_system import LosslessSystem
from .modal import ModalForm
from .systems import PortHamiltonian, full_port_hamiltonian

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_LARGEST = 100_000  # degrees of freedom of a lifted system, whose matrices have 4 m^2 entries


class KalmanDecomposition(NamedTuple):
    """A system as the direct sum of what its port reaches and what it does not; made by `kalman_decomposition`.

    Attributes
    ----------
    reachable : PortHamiltonian
        Canonical, in Williamson coordinates, with the transfer function of the whole.
    hidden : PortHamiltonian
        In Williamson coordinates, with an input matrix that is exactly 0; possibly without states.
    T : ndarray, shape (2n, 2n)
        Symplectic; maps the states `z` of the system to `(q_reachable, q_hidden, p_reachable, p_hidden)`.

    Examples
    --------
    See `kalman_decomposition`.
    """

    reachable: PortHamiltonian
    hidden: PortHamiltonian
    T: Array


@dataclass(frozen=True)
class CanonicalMargins:
    """How far a system is from one that its port does not determine; made by `canonical_margins`.

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
    """

    is_canonical: bool
    resonance: float
    resonance_tolerance: float
    pair: tuple[int, int] | None
    degeneracy: float
    degeneracy_tolerance: float
    mode: int | None
    rigid: int

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
        return "\n".join(lines)


def minreal(sys: Any, *, rtol: float | None = None) -> PortHamiltonian:
    """Minimal port-Hamiltonian system with the same transfer function.

    Parameters
    ----------
    sys : PortHamiltonian, or anything that `ph` takes
        System with any number of ports; its `Q` may be semidefinite.
    rtol : float, optional
        Relative tolerance, instead of bounds of the rounding errors: frequencies closer than `rtol * d` are one, and
        a residue of at most `rtol` times the largest is 0.

    Returns
    -------
    PortHamiltonian
        In Williamson coordinates.  Inputs and outputs keep their names.

    Raises
    ------
    NotLosslessError
        If the system has no port-Hamiltonian form.
    StructureError
        If it is of no kind that `ph` takes, or `rtol` is no number from 0 to 1.

    See Also
    --------
    canonical_margins, kalman_decomposition

    Notes
    -----
    For one port, modes of equal frequency are one whose weight is the sum of theirs, and unreached modes are
    dropped.  Where frequencies are closer than they are known, nothing can tell them apart, and merging them keeps
    their total residue.  With m ports a frequency stays up to m times.  A rigid-body mode stays as one
    degree of freedom for each pole at 0, although its position is not observable: no smaller system is
    port-Hamiltonian.  O(n^3).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> equal_branches = phc.lc_circuit([1.0, 1.0, 4.0], 1.0)
    >>> small = phc.minreal(equal_branches)
    >>> small.d, small.r
    (array([0.5, 1. ]), array([2., 2.]))
    """
    system = full_port_hamiltonian(sys)
    return _named_like(system, _separation(system, rtol).minimal())


def kalman_decomposition(sys: Any, *, rtol: float | None = None) -> KalmanDecomposition:
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
    input.  The direct sum holds within the error bounds by which modes were called equal or unreached.  O(n^3).

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> reachable, hidden, T = phc.kalman_decomposition(phc.ph(np.eye(4), [3.0, 4.0, 0.0, 0.0]))
    >>> reachable.B.ravel(), hidden.n
    (array([5., 0.]), 1)
    >>> (T @ [3.0, 4.0, 0.0, 0.0]).round(12) + 0.0
    array([5., 0., 0., 0.])
    """
    system = _with_hidden_modes(sys)
    if system.ninputs != 1:
        raise StructureError(
            f"the system has {system.ninputs} ports; the Kalman decomposition is that of one port: choose one by "
            "its column of B, or use minreal"
        )
    d, E, _ = system._energy
    if len(d) < system.n:
        raise StructureError(
            f"Q is only positive semidefinite: {system.n - len(d)} of {system.n} degrees of freedom have no frequency, "
            "and what is reachable is then more than what is observable; use minreal"
        )
    found = _separation(system, rtol)
    rows = E / np.sqrt(d)[:, None]
    reached = _rows_by_frequency(found.groups, rows, reached=True)
    complement = _rows_by_frequency(found.groups, rows, reached=False)
    T = np.concatenate([reached.real, complement.real, reached.imag, complement.imag])
    hidden = found.hidden()
    unseen = ModalForm(hidden, np.zeros((len(hidden), 1), complex), np.zeros((0, 1)))
    return KalmanDecomposition(_named_like(system, found.minimal()), _named_like(system, unseen), _checks.readonly(T))


def lift(sys: Any, m: int, *, padding: ArrayLike | str | None = None) -> PortHamiltonian:
    """System of m degrees of freedom with the same filter.

    Theorem "(i) for any m >= n ..." of the paper's section on restrictions of higher dimensional systems:
    `Q' = O diag(Q, P) O^T`, `B' = O [B; 0]`.

    Parameters
    ----------
    sys : PortHamiltonian, or anything that `ph` takes
        System of n degrees of freedom.
    m : int
        Degrees of freedom wanted, at least n.
    padding : array_like of shape (m - n,), "ones", or None
        Frequencies of the added modes, `P = diag(padding, padding)`, positive.  `"ones"` is the `P = I` of the
        paper.  Default: distinct ones, evenly spread on a logarithmic axis between those of the system and up to
        an octave beyond them, up to four octaves where many are added.

    Returns
    -------
    PortHamiltonian
        States `(q, q_added, p, p_added)`, those of the system in its own coordinates.  Inputs and outputs keep
        their names.  For `m = n` the system itself.

    Raises
    ------
    NotLosslessError
        If the system has no port-Hamiltonian form.
    StructureError
        If `m` is less than n, more than 100000 or no whole number, or the padding is not of the kind above.

    Warns
    -----
    UserWarning
        If a padding frequency repeats another frequency, as `"ones"` does for `m - n >= 2`.

    See Also
    --------
    minreal

    Notes
    -----
    Corrects the paper: with `P = I` and `m - n >= 2` the frequency 1 is repeated, and the observable Hamiltonian
    companion matrix of the lifted system has Jordan blocks, that is, free responses that grow.  Distinct
    frequencies avoid it.  The modes of the system stay as they are, to the last bit of their frequencies; the
    arrays have `4 m^2` entries.

    Examples
    --------
    >>> import ph_control as phc
    >>> large = phc.lift(phc.modes([1.0, 4.0], [0.5, 0.25]), 3)
    >>> large.d, large.r
    (array([1., 2., 4.]), array([0.5 , 0.  , 0.25]))
    """
    system = full_port_hamiltonian(sys)
    n = system.n
    m = lifted_size(m, n)
    added = _padding(system.d, m - n, padding)
    if m == n:
        return system
    _warn_of_jordan_blocks(system, added)
    old, new = np.r_[0:n, m : m + n], np.r_[n:m, m + n : 2 * m]
    Q, B = np.zeros((2 * m, 2 * m)), np.zeros((2 * m, system.ninputs))
    Q[np.ix_(old, old)] = system.Q
    Q[new, new] = np.concatenate([added, added])
    B[old] = system.B
    lifted = PortHamiltonian(Q, B, inputs=system.input_labels, outputs=system.output_labels)
    lifted._views["_energy"] = _lifted_energy(system._energy, added, old, new)
    return lifted


def canonical_margins(sys: Any) -> CanonicalMargins:
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
    system = _with_hidden_modes(sys)
    if system.ninputs != 1:
        raise StructureError(
            f"the system has {system.ninputs} ports; the canonical margins are those of one port: choose one by its "
            "column of B"
        )
    found = _separation(system, None)
    rigid = system.n - len(system.d)
    resonance, close, pair = _least_distance(system.d, found.errors.d)
    degeneracy, faint, mode = _least_residue(found)
    return CanonicalMargins(rigid == 0 and found.is_minimal, resonance, close, pair, degeneracy, faint, mode, rigid)


def _with_hidden_modes(sys: Any) -> PortHamiltonian:
    """Port-Hamiltonian system with all that `sys` has; refused where the conversion has left states behind."""
    system = full_port_hamiltonian(sys)
    visible = 2 * len(system.d) + len(system.modes.rigid)
    if (
        isinstance(sys, ct.StateSpace)
        and not isinstance(sys, LosslessSystem)
        and visible < sys.nstates != system.nstates
    ):
        raise StructureError(
            f"the system has {sys.nstates} states, of which {visible} take part in its transfer function; what "
            "the others store cannot be told from these matrices, so they are no part of its port-Hamiltonian form: "
            "use minreal(sys), or give the energy, ph(Q, B)"
        )
    return system


def _separation(system: PortHamiltonian, rtol: float | None) -> Separation:
    energy = None if system._given is None else system._energy
    return separate(system.modes, system._given, energy, rtol=rtol)


def _named_like(system: PortHamiltonian, modes: ModalForm) -> PortHamiltonian:
    return PortHamiltonian._from_modes(modes, inputs=system.input_labels, outputs=system.output_labels)


def _rows_by_frequency(groups: tuple[Group, ...], rows: ComplexArray, *, reached: bool) -> ComplexArray:
    """Williamson rows `S_l + i S_{n+l}` of one part, rotated as its groups are, in ascending order of frequency."""
    parts = [(g, slice(g.rank) if reached else slice(g.rank, None)) for g in groups]
    d = np.concatenate([np.zeros(0), *(g.d[part] for g, part in parts)])
    turned = [g.rotation[part] @ rows[g.members] for g, part in parts]
    return np.concatenate([rows[:0], *turned])[np.argsort(d, kind="stable")]


def _lifted_energy(
    energy: Energy, added: Array, old: NDArray[np.intp], new: NDArray[np.intp]
) -> tuple[Array, ComplexArray, Array]:
    """Energy coordinates of the lifted system: those of the system, to the last bit, and of the added modes."""
    d, E, E0 = energy
    n, size, root = len(d), len(old) + len(new), np.sqrt(added)
    rows, rigid = np.zeros((n + len(added), size), complex), np.zeros((len(E0), size))
    rows[:n, old], rigid[:, old] = E, E0
    rows[n:, new] = np.concatenate([np.diag(root), 1j * np.diag(root)], axis=1)
    frequencies = np.concatenate([d, added])
    order = np.argsort(frequencies, kind="stable")
    return frequencies[order], rows[order], rigid


def lifted_size(m: Any, n: int) -> int:
    """Check the degrees of freedom of a lifted system: a whole number of at least n, and not beyond all memory."""
    if not isinstance(m, int | np.integer) or isinstance(m, bool) or not n <= m <= max(n, _LARGEST):
        raise StructureError(
            f"m is {_checks.shown(m)}, the system has n = {n} degrees of freedom; needed a whole number of at least n "
            f"and at most {_LARGEST}: take hidden modes off with minreal first, if there are any"
        )
    return int(m)


# --- padding -------------------------------------------------------------------------------------------------


def _padding(d: Array, count: int, padding: ArrayLike | str | None) -> Array:
    if padding is None:
        return _frequencies_between(d, count)
    if isinstance(padding, str):
        _checks.choice("padding", padding, ("ones",))
        return np.ones(count)
    added = np.atleast_1d(_checks.real_array("padding", padding))
    if added.shape != (count,):
        raise StructureError(
            f"padding has shape {added.shape}; m - n = {count} frequencies are to be added: ({count},)"
        )
    if count and added.min() <= 0:
        worst = int(added.argmin())
        raise StructureError(
            f"padding is not positive: padding[{worst}] = {added[worst]:.6g}; natural frequencies are > 0 (rad/s)"
        )
    return added


def _frequencies_between(d: Array, count: int) -> Array:
    """Frequencies in the largest logarithmic gaps of `d`, and of a band of one to four octaves on either side.

    One after the other goes to the gap whose points, evenly spaced, are then farthest apart.  The more, the wider the
    band: companion matrices are well conditioned while neighbours differ by about half an octave.
    """
    reach = min(max(1.0, count / 4), 4.0)
    known = np.log2(np.unique(d)) if len(d) else np.zeros(1)
    edges = np.concatenate([[known[0] - reach], known, [known[-1] + reach]])
    gaps = np.diff(edges)
    points = [0] * len(gaps)
    outer = [k in (0, len(gaps) - 1) for k in range(len(gaps))]
    # no frequency stands at the ends of the band, so a point of an outer gap may
    intervals = [1 if out else 2 for out in outer]
    heap = [(-gap / need, out, k) for k, (gap, need, out) in enumerate(zip(gaps, intervals, outer, strict=True))]
    heapq.heapify(heap)
    for _ in range(count):
        _, out, k = heap[0]
        points[k] += 1
        heapq.heapreplace(heap, (-gaps[k] / (points[k] + intervals[k]), out, k))
    added = [
        edges[k] + gaps[k] * (np.arange(number) + (k > 0)) / (number + (not outer[k]))
        for k, number in enumerate(points)
    ]
    return np.exp2(np.concatenate(added))


def _warn_of_jordan_blocks(system: PortHamiltonian, added: Array) -> None:
    close = 2 * _checks.EPS * added
    d, error = np.concatenate([system.d, added]), np.concatenate([_separation(system, None).errors.d, close])
    distance = np.abs(d[:, None] - added)
    distance[np.arange(len(system.d), len(d)), np.arange(len(added))] = np.inf
    repeated = added[(distance <= error[:, None] + close).any(axis=0)]
    if len(repeated):
        warnings.warn(
            f"the padding frequency {repeated[0]:.6g} is repeated in the lifted system: the transfer function is the "
            "same, but the observable Hamiltonian companion matrix has Jordan blocks there, that is, free responses "
            "that grow; the default padding has distinct frequencies",
            UserWarning,
            stacklevel=3,
        )


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


def _least_residue(found: Separation) -> tuple[float, float, int | None]:
    """The mode with the least room above its tolerance: residue over the largest, tolerance, index."""
    d = found.modes.d
    if len(d) == 0:
        return 1.0, 0.0, None
    residue, allowed = d * found.strength**2, d * found.errors.nu**2
    largest = float(residue.max()) or 1.0
    mode = int((residue - allowed).argmin())
    return float(residue[mode]) / largest, float(allowed[mode]) / largest, mode

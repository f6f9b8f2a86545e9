"""More states behind the same filter: lifting, and the frequencies that are added for it."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np

from .. import _checks
from .._types import Array, ArrayLike, Indices
from ..exceptions import StructureError
from ..modal.error_bounds import Energy
from ..symplectic.forms_and_williamson import direct_sum
from .base import Convertible, refuse_losses
from .port_hamiltonian import PortHamiltonian, full_port_hamiltonian

_LARGEST = 100_000  # degrees of freedom of a lifted system, whose matrices have 4 m^2 entries


def lift(sys: Convertible, m: int, *, padding: ArrayLike | Literal["ones"] | None = None) -> PortHamiltonian:
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
    refuse_losses(system, "lifted systems are")
    n = system.n
    m = lifted_size(m, n)
    added = _padding(system.d, m - n, padding)
    if m == n:
        return system
    _warn_of_jordan_blocks(system, added)
    old, new = np.r_[0:n, m : m + n], np.r_[n:m, m + n : 2 * m]
    beside = np.diag(np.concatenate([added, added])), np.zeros((2 * len(added), system.ninputs))
    Q, B = direct_sum((system.Q, system.B), beside)
    lifted = PortHamiltonian(Q, B, inputs=system.input_labels, outputs=system.output_labels)
    lifted._views["_energy"] = _lifted_energy(system._energy, added, old, new)
    return lifted


def _lifted_energy(energy: Energy, added: Array, old: Indices, new: Indices) -> Energy:
    """Energy coordinates of the lifted system: those of the system, to the last bit, and of the added modes."""
    d, E, E0 = energy
    n, size, root = len(d), len(old) + len(new), np.sqrt(added)
    rows, rigid = np.zeros((n + len(added), size), complex), np.zeros((len(E0), size))
    rows[:n, old], rigid[:, old] = E, E0
    rows[n:, new] = np.concatenate([np.diag(root), 1j * np.diag(root)], axis=1)
    frequencies = np.concatenate([d, added])
    order = np.argsort(frequencies, kind="stable")
    return frequencies[order], rows[order], rigid


def lifted_size(m: int, n: int) -> int:
    """Check the degrees of freedom of a lifted system: a whole number of at least n, and not beyond all memory."""
    if not isinstance(m, int | np.integer) or isinstance(m, bool) or not n <= m <= max(n, _LARGEST):
        raise StructureError(
            f"m is {_checks.shown(m)}, the system has n = {n} degrees of freedom; expected a whole number from n "
            f"to {_LARGEST}: remove hidden modes with minreal first, if there are any"
        )
    return int(m)


# --- padding -------------------------------------------------------------------------------------------------


def _padding(d: Array, count: int, padding: ArrayLike | Literal["ones"] | None) -> Array:
    if padding is None:
        return _frequencies_between(d, count)
    if isinstance(padding, str):
        _checks.choice("padding", padding, ("ones",))
        return np.ones(count)
    added = _checks.natural_frequencies(padding, name="padding")
    if added.shape != (count,):
        raise StructureError(
            f"padding has shape {added.shape}; m - n = {count} frequencies are to be added: ({count},)"
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
    gaps, points = np.diff(edges), np.zeros(len(edges) - 1, int)
    # no frequency stands at the ends of the band, so a point of an outer gap may
    outer = np.isin(np.arange(len(gaps)), (0, len(gaps) - 1))
    inner_first = np.argsort(outer, kind="stable")
    for _ in range(count):
        points[inner_first[np.argmax((gaps / (points + 2 - outer))[inner_first])]] += 1
    parts = [
        edges[k] + gaps[k] * (np.arange(number) + (k > 0)) / (number + 1 - outer[k]) for k, number in enumerate(points)
    ]
    return np.exp2(np.concatenate(parts))


def _warn_of_jordan_blocks(system: PortHamiltonian, added: Array) -> None:
    close = 2 * _checks.EPS * added
    d, error = np.concatenate([system.d, added]), np.concatenate([system._separation().errors.d, close])
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

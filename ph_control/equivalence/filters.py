"""Comparing transfer functions: frequencies and residues, each held against the bound of its own error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _checks
from .._types import Array, Indices
from ..modal.error_bounds import Separation, separate
from ..modal.modal_form import ModalForm
from ..numerics.graphs import components
from ..systems.base import LosslessSystem
from ..systems.port_hamiltonian import PortHamiltonian

MARGIN = 4.0  # between a bound of an error and what is called a difference


@dataclass(frozen=True, eq=False)
class Verdict:
    """Answer to a question of equivalence, as of `same_filter`; true if it holds.

    Attributes
    ----------
    holds : bool
        The answer.
    residual : float
        Relative size of what speaks against it.
    allowed : float
        What the residual is held against: a multiple of the rounding errors of the data, or what was asked for.
    witness : object
        What proves it, or None: the matrix `L`, the pair `(P, A)`, or the common modal form.
    reason : str
        The answer in words.

    Examples
    --------
    >>> import ph_control as phc
    >>> verdict = phc.same_filter(phc.modes(1.0, 2.0), phc.modes(2.0, 1.0))
    >>> verdict.holds, verdict.reason
    (False, 'the residues at frequency 1 differ: 2 and 0')
    """

    holds: bool
    residual: float
    allowed: float
    witness: Any
    reason: str

    def __bool__(self) -> bool:
        return self.holds


def separation_of(sys: LosslessSystem | ModalForm) -> Separation:
    """Modes with the bounds of their errors; those of matrices `(Q, B)` carry the rounding of these."""
    if isinstance(sys, PortHamiltonian):
        return sys._separation()
    return separate(sys if isinstance(sys, ModalForm) else sys.modes)


def compare_filters(first: Separation, second: Separation, rtol: float | None = None) -> Verdict:
    """Compare the transfer functions of two systems, residue by residue.

    Poles whose error disks overlap count as one, with the sum of their residues.  What is left of it is held against
    the errors of these residues, however small they are beside others; with `rtol`, against the largest of all.
    A rigid-body mode has the frequency 0.
    """
    both = first, second
    still = [np.zeros(len(s.modes.rigid)) for s in both]
    d = np.concatenate([first.modes.d, still[0], second.modes.d, still[1]])
    d_error = MARGIN * np.concatenate([first.errors.d, still[0], second.errors.d, still[1]])
    d_error = d_error if rtol is None else 0.5 * rtol * d
    sign = np.repeat([1.0, -1.0], [s.modes.n for s in both])
    weights = np.concatenate([w for s in both for w in (np.sqrt(s.modes.d)[:, None] * s.modes.nu, s.modes.rigid)])
    error = np.concatenate([e for s in both for e in (np.sqrt(s.modes.d) * s.errors.nu, s.errors.rigid)])
    rounding = np.repeat([2 * max(1, s.modes.n) * _checks.EPS for s in both], [s.modes.n for s in both])
    residues = weights.conj()[:, :, None] * weights[:, None, :]
    # largest entries: their squares would leave the range of doubles
    size, amplitude = np.abs(residues).max(axis=(1, 2), initial=0.0), np.abs(weights).max(axis=1, initial=0.0)
    error = MARGIN * (error + rounding * amplitude)
    allowed = error * (2 * amplitude + error) + 8 * max(1, len(d)) * _checks.EPS * size
    allowed += size * (d_error / np.where(d > 0, d, 1.0))
    groups = [] if rtol is not None else [g.members + k * first.modes.n for k, s in enumerate(both) for g in s.groups]
    worst, allowance, reason = 0.0, _checks.EPS, ""
    for group in _common_poles(d, d_error, groups):
        difference = float(np.abs(np.tensordot(sign[group], residues[group], axes=1)).max())
        whole = float(size[group].sum() if rtol is None else size.max()) or 1.0
        bound = float(allowed[group].sum()) / whole if rtol is None else max(rtol, _checks.EPS)
        if difference / whole * allowance > worst * bound:
            totals = [float(np.trace(residues[group][sign[group] == s].sum(axis=0)).real) for s in (1.0, -1.0)]
            place = f"at frequency {d[group].mean():.6g}" if d[group].any() else "at 0"
            worst, allowance = difference / whole, bound
            reason = f"the residues {place} differ: {totals[0]:.6g} and {totals[1]:.6g}"
    return Verdict(bool(worst <= allowance), float(worst), float(allowance), None, reason)


def _common_poles(d: Array, error: Array, groups: Sequence[Indices]) -> list[Indices]:
    """Poles whose error disks overlap, or that are in a group, in sets that have none in common."""
    together = np.abs(d[:, None] - d) <= error[:, None] + error
    for members in groups:
        together[np.ix_(members, members)] = True
    label = components(together)[1]
    return [np.flatnonzero(label == k) for k in range(label.max(initial=-1) + 1)]

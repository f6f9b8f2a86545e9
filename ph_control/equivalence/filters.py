"""Comparing transfer functions: frequencies and residues, each held against the bound of its own error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..modal.error_bounds import separate
from ..modal.modal_form import ModalForm
from ..numerics.graphs import components
from ..systems.base import LosslessSystem

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Indices = NDArray[np.intp]

MARGIN = 4.0  # between a bound of an error and what is called a difference


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Modes of a system with bounds of the errors of `d` and of the norms of the rows of `nu` and `rigid`, absolute.

    `groups` are modes of which only the total weight is determined; `minimal` has one mode for what each shows.
    """

    modes: ModalForm
    d_error: Array
    nu_error: Array
    rigid_error: Array
    groups: tuple[Indices, ...]
    minimal: ModalForm

    @property
    def conditioning(self) -> float:
        """Largest relative error of a frequency."""
        return float(np.max(self.d_error / self.modes.d, initial=_checks.EPS))


def modal_spectrum(modes: ModalForm, given: tuple[Array, Array] | None = None, energy: Any = None) -> Spectrum:
    """Spectrum of modes that were given, or computed from the matrices `(Q, B)`."""
    found = separate(modes, given, energy)
    rounding = 2 * max(1, modes.n) * _checks.EPS
    nu_error, rigid_error = (
        error + rounding * np.abs(rows).max(axis=1, initial=0.0)
        for error, rows in ((found.errors.nu, modes.nu), (found.errors.rigid, modes.rigid))
    )
    groups = tuple(group.members for group in found.groups)
    return Spectrum(modes, found.errors.d, nu_error, rigid_error, groups, found.minimal())


def lossless_spectrum(sys: LosslessSystem) -> Spectrum:
    """Spectrum of a system of this package; those of matrices `(Q, B)` carry their rounding."""
    given = getattr(sys, "_given", None)
    return modal_spectrum(sys.modes, given, None if given is None else sys._energy)


@dataclass(frozen=True)
class Mismatch:
    """What speaks most against the equality of two spectra."""

    residual: float
    allowed: float
    reason: str

    @property
    def decides(self) -> bool:
        """Whether it is more than rounding explains."""
        return self.residual > self.allowed


def filter_mismatch(first: Spectrum, second: Spectrum, rtol: float | None = None) -> Mismatch:
    """Compare the transfer functions of two spectra, residue by residue.

    Poles whose error disks overlap count as one, with the sum of their residues.  What is left of it is held against
    the errors of these residues, however small they are beside others; with `rtol`, against the largest of all.
    A rigid-body mode has the frequency 0.
    """
    both = first, second
    d = np.concatenate([_padded(s.modes.d, s) for s in both])
    d_error = MARGIN * np.concatenate([_padded(s.d_error, s) for s in both]) if rtol is None else 0.5 * rtol * d
    sign = np.repeat([1.0, -1.0], [s.modes.n for s in both])
    weights = np.concatenate([w for s in both for w in (np.sqrt(s.modes.d)[:, None] * s.modes.nu, s.modes.rigid)])
    error = np.concatenate([e for s in both for e in (np.sqrt(s.modes.d) * s.nu_error, s.rigid_error)])
    residues = weights.conj()[:, :, None] * weights[:, None, :]
    # largest entries: their squares would leave the range of doubles
    size, amplitude = np.abs(residues).max(axis=(1, 2), initial=0.0), np.abs(weights).max(axis=1, initial=0.0)
    allowed = MARGIN * error * (2 * amplitude + MARGIN * error) + 8 * max(1, len(d)) * _checks.EPS * size
    allowed += size * (d_error / np.where(d > 0, d, 1.0))
    together = np.abs(d[:, None] - d) <= d_error[:, None] + d_error
    if rtol is None:
        for members in (*first.groups, *(members + first.modes.n for members in second.groups)):
            together[np.ix_(members, members)] = True
    label = components(together)[1]
    worst = Mismatch(0.0, _checks.EPS, "")
    for group in (np.flatnonzero(label == k) for k in range(label.max(initial=-1) + 1)):
        left = float(np.abs(np.tensordot(sign[group], residues[group], axes=1)).max())
        whole = float(size[group].sum() if rtol is None else size.max()) or 1.0
        bound = float(allowed[group].sum()) / whole if rtol is None else max(rtol, _checks.EPS)
        if left / whole * worst.allowed > worst.residual * bound:
            totals = [float(np.trace(residues[group][sign[group] == s].sum(axis=0)).real) for s in (1.0, -1.0)]
            at = f"at frequency {d[group].mean():.6g}" if d[group].any() else "at 0"
            worst = Mismatch(left / whole, bound, f"the residues {at} differ: {totals[0]:.6g} and {totals[1]:.6g}")
    return worst


def _padded(values: Array, spectrum: Spectrum) -> Array:
    """Values of the oscillating modes, and 0 for the rigid-body modes."""
    return np.concatenate([values, np.zeros(len(spectrum.modes.rigid))])

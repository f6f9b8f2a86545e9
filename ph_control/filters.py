"""Comparing transfer functions: frequencies and residues, each held against the bound of its own error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from . import _checks
from .conditioning import separate
from .lossless_system import LosslessSystem
from .modal import ModalForm

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Indices = NDArray[np.intp]

MARGIN = 4.0  # between a bound of an error and what is called a difference


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Modes of a system with bounds of the errors of `d` and of the norms of `nu`, both absolute.

    `groups` are modes of which only the total weight is determined; `minimal` has one mode for what each shows.
    """

    modes: ModalForm
    d_error: Array
    nu_error: Array
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
    nu_error = found.errors.nu + rounding * np.linalg.norm(modes.nu, axis=1)
    groups = tuple(group.members for group in found.groups)
    return Spectrum(modes, found.errors.d, nu_error, groups, found.minimal())


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

    Poles whose error disks overlap count as one, with the sum of their residues.
    """
    d = np.concatenate([first.modes.d, second.modes.d])
    d_error = np.concatenate([first.d_error, second.d_error]) * MARGIN if rtol is None else 0.5 * rtol * d
    K = np.concatenate([_residues(first.modes), _residues(second.modes)])
    size = np.linalg.norm(K, axis=(1, 2))
    rigid = max(float(np.linalg.norm(np.atleast_1d(s.modes.kappa_0))) for s in (first, second))
    whole = max(float(size.max(initial=0.0)), rigid)
    sign = np.repeat([1.0, -1.0], [len(first.modes.d), len(second.modes.d)])
    worst = _rigid_mismatch(first.modes, second.modes, whole, rtol)
    if whole == 0.0:
        return worst
    nu_error = np.concatenate([first.nu_error, second.nu_error]) * MARGIN
    error = nu_error * (2 * np.sqrt(d * size) + d * nu_error) + size * d_error / d
    together = np.abs(d[:, None] - d) <= d_error[:, None] + d_error
    for members in (*first.groups, *(members + len(first.modes.d) for members in second.groups)):
        together[np.ix_(members, members)] |= rtol is None
    label = connected_components(together, directed=False)[1]
    for group in (np.flatnonzero(label == k) for k in range(label.max(initial=-1) + 1)):
        residual = float(np.linalg.norm(np.tensordot(sign[group], K[group], axes=1))) / whole
        rounding = 8 * max(1, len(d)) * _checks.EPS
        allowed = float(error[group].sum()) / whole + rounding if rtol is None else max(rtol, _checks.EPS)
        found = Mismatch(residual, allowed, _describe(group, d, K, sign))
        worst = max(worst, found, key=lambda m: m.residual / m.allowed)
    return worst


def _residues(modes: ModalForm) -> ComplexArray:
    return modes.d[:, None, None] * modes.nu.conj()[:, :, None] * modes.nu[:, None, :]


def _rigid_mismatch(first: ModalForm, second: ModalForm, whole: float, rtol: float | None) -> Mismatch:
    difference = float(np.linalg.norm(np.atleast_1d(first.kappa_0 - second.kappa_0)))
    allowed = 8 * MARGIN * max(1, first.n, second.n) * _checks.EPS if rtol is None else rtol
    return Mismatch(difference / whole if whole else 0.0, max(allowed, _checks.EPS), "the residues at 0 differ")


def _describe(group: Indices, d: Array, K: ComplexArray, sign: Array) -> str:
    """Say what differs at one frequency."""
    totals = [float(np.trace(K[group[sign[group] == s]].sum(axis=0)).real) for s in (1.0, -1.0)]
    return f"the residues at frequency {d[group].mean():.6g} differ: {totals[0]:.6g} and {totals[1]:.6g}"

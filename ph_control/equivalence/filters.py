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

_NOTHING = -(1 << 20)  # exponent of a residue that is 0
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
    """
    table = _Residues.of(first, second)
    d, d_error = table.d, np.concatenate([_padded(s.d_error, s) for s in (first, second)]) * MARGIN
    if rtol is not None:
        d_error = 0.5 * rtol * d
    together = np.abs(d[:, None] - d) <= d_error[:, None] + d_error
    for members in (*first.groups, *(members + first.modes.n for members in second.groups)):
        together[np.ix_(members, members)] |= rtol is None
    label = components(together)[1]
    worst = Mismatch(0.0, _checks.EPS, "")
    for group in (np.flatnonzero(label == k) for k in range(label.max(initial=-1) + 1)):
        unit = int(table.exponent[group if rtol is None else slice(None)].max())
        K, size = table.at(group, unit)
        residual = float(np.linalg.norm(np.tensordot(table.sign[group], K, axes=1)))
        if rtol is None:
            relative = d_error[group] / np.where(d[group] > 0, d[group], 1.0)
            allowed = float(np.sum(table.error_at(group, unit) + size * relative))
            allowed += 8 * max(1, len(d)) * _checks.EPS * float(size.sum())
            whole = float(size.sum()) or 1.0
        else:
            whole = float(table.at(np.arange(len(d)), unit)[1].max()) or 1.0
            allowed = max(rtol, _checks.EPS) * whole
        if residual * worst.allowed > worst.residual * allowed:
            worst = Mismatch(residual / whole, allowed / whole, _describe(group, table))
    return worst


def _padded(errors: Array, spectrum: Spectrum) -> Array:
    """Errors of the frequencies, with 0 for those of the rigid-body modes."""
    return np.concatenate([errors, np.zeros(len(spectrum.modes.rigid))])


@dataclass(frozen=True, eq=False)
class _Residues:
    """Residues `w^H w 4^exponent` of the modes of two systems, with the errors of the weights `w`.

    Each mode has a power of two as its unit, since the squares of weights may leave the range of doubles.  A
    rigid-body mode has the frequency 0.
    """

    d: Array
    sign: Array
    weights: ComplexArray
    error: Array
    exponent: NDArray[np.int64]

    @classmethod
    def of(cls, first: Spectrum, second: Spectrum) -> _Residues:
        """Residues of two systems, those of the second to be subtracted."""
        both = first, second
        root = np.concatenate([x for s in both for x in (np.sqrt(s.modes.d), np.ones(len(s.modes.rigid)))])
        factor, shift = np.frexp(root)
        weights = factor[:, None] * np.concatenate([x for s in both for x in (s.modes.nu, s.modes.rigid)])
        error = MARGIN * factor * np.concatenate([x for s in both for x in (s.nu_error, s.rigid_error)])
        size = np.maximum(np.abs(weights).max(axis=1, initial=0.0), error)
        unit = np.frexp(size)[1].astype(np.int64)
        return cls(
            np.concatenate([_padded(s.modes.d, s) for s in both]),
            np.repeat([1.0, -1.0], [s.modes.n for s in both]),
            _times_power(weights, -unit[:, None]),
            np.ldexp(error, -unit),
            np.where(size > 0, unit + shift, _NOTHING),
        )

    def at(self, group: Indices, unit: int) -> tuple[ComplexArray, Array]:
        """Residues of some modes, and their sizes, in units of `4^unit`."""
        w, power = self.weights[group], 2 * (self.exponent[group] - unit)
        K = _times_power(w.conj()[:, :, None] * w[:, None, :], power[:, None, None])
        return K, np.linalg.norm(K, axis=(1, 2))

    def error_at(self, group: Indices, unit: int) -> Array:
        """What the errors of the weights make of the residues."""
        w, error = np.linalg.norm(self.weights[group], axis=1), self.error[group]
        return np.ldexp(error * (2 * w + error), 2 * (self.exponent[group] - unit))


def _times_power(values: ComplexArray, power: NDArray[np.int64]) -> ComplexArray:
    """`values 2^power`."""
    return np.asarray(np.ldexp(values.real, power) + 1j * np.ldexp(values.imag, power), complex)


@np.errstate(over="ignore", under="ignore")
def _describe(group: Indices, table: _Residues) -> str:
    """Say what differs at one frequency."""
    K, sign = table.at(group, 0)[0], table.sign[group]
    totals = [float(np.trace(K[sign == s].sum(axis=0)).real) for s in (1.0, -1.0)]
    frequency = table.d[group].mean()
    if frequency == 0:
        return f"the residues at 0 differ: {totals[0]:.6g} and {totals[1]:.6g}"
    return f"the residues at frequency {frequency:.6g} differ: {totals[0]:.6g} and {totals[1]:.6g}"

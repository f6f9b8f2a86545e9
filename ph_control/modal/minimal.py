"""Modes that one port reaches, decided from frequencies and weights alone, where that is safe.

`conditioning.py` bounds the error of each mode by its shape, which takes all modes of a matrix.  Frequencies and
residues come at a fraction of their cost, and with them alone each of its bounds lies between two others: shapes are
between those of the largest and of the smallest eigenvalue of the scaled `Q`.  Where both ends lead to the same
decision it is made; where they do not, nothing is decided here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import _checks
from .._types import Array, Indices, Mask
from .error_bounds import exact_closeness, rounding_unit
from .modal_form import ModalForm

_FEW = 100  # modes that a loop is as fast for as array operations
_LEAST, _MOST = 5 / 3, 2 + 2 / np.sqrt(3)  # errors of the frequency of a pair in roundings: eigenvalues 1/2 to 3/2
_MARGIN = 2.0  # between a quantity and the bound that it is held against, for the errors of both
_NO_RIGID = _checks.readonly(np.zeros((0, 1)))


@dataclass(frozen=True)
class Reduction:
    """Modes of one port in groups of one frequency each.

    Attributes
    ----------
    d, r : ndarray, shape (n,)
        Frequencies, ascending, and weights of all modes.
    starts : ndarray of int
        First mode of each group.
    reached : ndarray of bool
        Whether the port reaches the group.
    """

    d: Array
    r: Array
    starts: Indices
    reached: Mask

    def _counts(self) -> Indices:
        return np.append(self.starts[1:], len(self.d)) - self.starts

    @property
    def is_minimal(self) -> bool:
        """Whether each mode is reached on its own."""
        return len(self.starts) == len(self.d) and bool(self.reached.all())

    @property
    def gap(self) -> float:
        """Smallest relative distance of frequencies of different groups; infinite if there is but one."""
        above = self.d[self.starts[1:]]
        return float(np.min((above - self.d[self.starts[1:] - 1]) / above, initial=np.inf))

    def minimal(self) -> ModalForm:
        """One mode for each group that is reached, at the mean of its frequencies, with the sum of its weights."""
        if self.is_minimal:
            d, r = self.d, self.r
        else:
            total = np.add.reduceat(self.r, self.starts)
            first = self.d[self.starts]
            moved = np.add.reduceat(self.r * (self.d - np.repeat(first, self._counts())), self.starts)
            r = total[self.reached]
            d = first[self.reached] + moved[self.reached] / r
        return plain_modes(d, r)

    def hidden(self) -> Array:
        """Frequencies that the port does not reach, ascending: of k modes in a reached group, k - 1."""
        if self.is_minimal:
            return np.zeros(0)
        counts = self._counts()
        first = self.starts[self.reached & (counts == 2)]
        (low, high), (light, heavy) = ((x[first], x[first + 1]) for x in (self.d, self.r))
        # of two what is left has the weights exchanged
        pairs = low + (high - low) * (light / (light + heavy))
        several = np.flatnonzero(self.reached & (counts > 2)).tolist()
        parts = [slice(self.starts[k], self.starts[k] + counts[k]) for k in several]
        remaining = [_beside(self.d[part], self.r[part]) for part in parts]
        return np.sort(np.concatenate([self.d[np.repeat(~self.reached, counts)], pairs, *remaining]))


def plain_modes(d: Array, r: Array) -> ModalForm:
    """Modes of one port whose weights are real and positive."""
    return ModalForm._of(d, np.sqrt(r).astype(complex)[:, None], _NO_RIGID, r)


def _beside(d: Array, r: Array) -> Array:
    """Frequencies of a group that are left when the combination of its modes that the port reaches is taken out."""
    basis = np.linalg.qr(np.sqrt(r)[:, None], mode="complete")[0][:, 1:]
    return d[0] + np.linalg.eigvalsh((basis.T * (d - d[0])) @ basis)


def minimal_of_exact(modes: ModalForm) -> ModalForm | None:
    """`of_exact(modes).minimal()`; a few modes pass through a loop in less time than an array operation begins in."""
    n = len(modes.d)
    if n > _FEW or len(modes.rigid) or modes.nports != 1:
        reduction = of_exact(modes)
        return None if reduction is None else reduction.minimal()
    close, d, r = exact_closeness(n), [], []
    previous, first, total, moment = -1.0, 0.0, 0.0, 0.0
    for frequency, weight in zip(modes.d.tolist(), modes.r.tolist(), strict=True):
        if frequency - previous > close * (frequency + previous):
            if total > 0.0:
                d.append(first + moment / total)
                r.append(total)
            first, total, moment = frequency, 0.0, 0.0
        total += weight
        moment += weight * (frequency - first)
        previous = frequency
    if total > 0.0:
        d.append(first + moment / total)
        r.append(total)
    return plain_modes(np.array(d), np.array(r))


def of_exact(modes: ModalForm) -> Reduction | None:
    """Decide for modes that are given, not computed: equal up to a few roundings is equal, and 0 is unreached."""
    if modes.nports != 1 or len(modes.rigid) or not len(modes.d):
        return None
    d, r = modes.d, modes.r
    close = exact_closeness(modes.n)
    apart = d[1:] - d[:-1] > close * (d[1:] + d[:-1])
    if np.count_nonzero(apart) == len(apart):
        return Reduction(d, r, np.arange(len(d)), r > 0)
    starts = _starts(apart)
    return Reduction(d, r, starts, np.add.reduceat(r, starts) > 0)


def of_pairs(d: Array, kappa: Array) -> Reduction | None:
    """`of_matrix` where `Q` couples no pair to another, and `2 |Q_qp|` is no more than `sqrt(Q_qq Q_pp)`.

    The error of a frequency is then between two multiples of it, and no mode lends weight to another.
    """
    unit = rounding_unit(len(d))
    together, gaps = d[1:] + d[:-1], d[1:] - d[:-1]
    apart = gaps > _MARGIN * _MOST * unit * together
    if not (apart | (_MARGIN * gaps <= _LEAST * unit * together)).all():
        return None
    r, starts = kappa / d, _starts(apart)
    return Reduction(d, r, starts, np.add.reduceat(r, starts) > 0)


def of_matrix(d: Array, kappa: Array, inverse: float, diagonal: Array) -> Reduction | None:
    """Decide for frequencies and residues of a definite `Q` that couples all; None where their errors leave it open.

    The bounds are those of `conditioning.separate`, between ends that follow from the diagonal of `Q` and a bound for
    the norm of the inverse of `Q` scaled to unit diagonal.  O(n^2).
    """
    n = len(d)
    unit = rounding_unit(n)
    root = np.sqrt(diagonal)
    size = unit * float(np.linalg.norm(root[:n] * root[n:]))
    # what rounding makes of the square of a shape, in units of its frequency: at least, at most
    least, most = unit / (2 * n), unit * inverse
    together = d[1:] + d[:-1]
    gaps = d[1:] - d[:-1]
    apart = gaps > _MARGIN * (most * together + 2 * size)
    if not (apart | (_MARGIN * gaps <= least * together + 2 * size)).all():
        return None
    r, starts = kappa / d, _starts(apart)
    strength = np.sqrt(np.add.reduceat(r, starts))
    few, many = (np.sqrt(np.add.reduceat(e**2, starts)) for e in _weight_errors(d, kappa, apart, size, (least, most)))
    reached = strength > _MARGIN * np.maximum(many, n * _checks.EPS * strength)
    if not (reached | (_MARGIN * strength <= few)).all() or not reached.any():
        return None
    # what is dropped is so little that it need not be given back to a neighbour
    lost = float(np.max(strength[~reached], initial=0.0))
    if _MARGIN * lost**2 > n * _checks.EPS * strength[reached].min() ** 2:
        return None
    return Reduction(d, r, starts, reached)


def _starts(apart: Mask) -> Indices:
    return np.concatenate([[0], np.flatnonzero(apart) + 1])


def _weight_errors(d: Array, kappa: Array, apart: Mask, size: float, shapes: tuple[float, ...]) -> list[Array]:
    """Bounds of the errors of the weights `nu`, one for each of `shapes`: what other groups and the conjugates lend."""
    label = np.concatenate([[0], np.cumsum(apart)])
    gap = np.abs(d[:, None] - d)
    gap[label[:, None] == label] = np.inf
    lent = 1.0 / gap + 1.0 / (d[:, None] + d)
    amplitude, root = np.sqrt(kappa), np.sqrt(d)
    by_residue, by_weight = lent @ amplitude, lent @ (amplitude / d)
    common = 0.5 * size * (root * by_weight + by_residue / root)
    return [shape * root * by_residue + common for shape in shapes]

"""Whether a Hamiltonian matrix is definite: what a stored energy must be, told in the units of its own diagonal."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from .._checks import EPS, symmetric_matrix
from .._types import Array, ArrayLike
from ..exceptions import StructureError

AT_ONCE = 64  # rows of a matrix up to which its eigenvalues cost no more than the rest of building a system
_CACHED = 1 << 13  # entries of a matrix looked at together
_NEAR = 10.0  # by how much the smallest eigenvalue is less than its estimate at most


def hamiltonian_matrix(Q: ArrayLike, *, even: bool = True) -> Array:
    """Check a Hamiltonian matrix: square, even, symmetric, positive semidefinite.  O(n^3)."""
    array = symmetric_matrix(Q, even=even)
    not_indefinite(array)
    return array


def not_surely_indefinite(Q: Array) -> float:
    """Refuse an indefinite Hamiltonian matrix when a system is built of it, a large one as far as O(n^2) steps tell.

    Returns its `inverse_bound`, and 0 for a large matrix, of which nothing is known yet.
    """
    return not_indefinite(Q) if len(Q) <= AT_ONCE or surely_indefinite(Q) else 0.0


def not_indefinite(Q: Array) -> float:
    """Refuse a Hamiltonian matrix with a negative eigenvalue, and return its `inverse_bound`.  O(n^3)."""
    bounds = [0.0]
    for part in uncoupled_halves(Q):
        bounds.append(inverse_bound(part))
        if np.isinf(bounds[-1]):
            refuse_indefinite("Q", smallest_scaled_eigenvalue(part)[0], 8 * len(Q) * EPS)
    return max(bounds)


def inverse_bound(Q: Array) -> float:
    """Bound the norm of the inverse of `Q` scaled to unit diagonal; infinite where it is not clearly definite."""
    factor = definite_factor(Q)
    return np.inf if factor is None else factor[1]


def uncoupled_halves(Q: Array) -> tuple[Array, ...]:
    """The parts of positions and of momenta where a matrix does not couple these; else the whole."""
    n = len(Q) // 2
    return (Q,) if len(Q) % 2 or Q[:n, n:].any() or Q[n:, :n].any() else (Q[:n, :n], Q[n:, n:])


def refuse_indefinite(name: str, smallest: float, tolerance: float) -> None:
    """Refuse a smallest scaled eigenvalue that is negative by more than rounding."""
    if smallest < -tolerance:
        raise StructureError(
            f"{name} is indefinite: smallest eigenvalue after scaling to unit diagonal {smallest:.3g}, "
            f"allowed >= {-tolerance:.1e}; a stored energy cannot be negative, so check the signs in {name}"
        )


def surely_indefinite(Q: Array) -> bool:
    """Whether entries show in O(n^2) that a symmetric matrix has a negative eigenvalue; False leaves it open.

    A diagonal entry may be negative, or a pair of rows have `Q_ij^2 > Q_ii Q_jj`.
    """
    diagonal = Q.diagonal()
    if diagonal.min(initial=0.0) < 0:
        return True
    root = np.sqrt(diagonal)
    bound = (1 + 16 * len(Q) * EPS) * root
    step = max(1, _CACHED // len(Q))
    bands = [slice(start, start + step) for start in range(0, len(Q), step)]
    return any(bool((np.abs(Q[band]) > bound[band, None] * root).any()) for band in bands)


def unit_diagonal(Q: Array) -> tuple[Array, Array]:
    """Return `(Q_ij / sqrt(Q_ii Q_jj), sqrt(diag Q))`: definiteness does not depend on units."""
    scale = np.sqrt(np.abs(Q.diagonal()))
    if np.count_nonzero(scale) < len(scale):
        # a zero diagonal is left unscaled: then any entry in its row shows up as a negative eigenvalue
        scale[scale == 0] = scale.max() or 1.0
    scaled = Q + Q.T
    scaled *= 0.5
    scaled /= scale[:, None]
    scaled /= scale
    return scaled, scale


def definite_factor(Q: Array) -> tuple[Array, float] | None:
    """Lower `F` with `F F^T = Q` if `Q` is clearly definite, and a bound for `||Q^{-1}||`, `Q` scaled to unit diagonal.

    None leaves open what it is.  Clearly definite: the smallest eigenvalue of `Q` scaled to unit diagonal is more than
    twice what counts as zero.  Where a few solutions with the factor show that it is not even near, a factorisation of
    what is left when the bound is taken off the diagonal need not decide.
    """
    if Q.size == 0:
        return np.zeros((0, 0)), 0.0
    scaled, scale = unit_diagonal(Q)
    bound = 16 * len(Q) * EPS
    # of a symmetric matrix the transpose, which is in the order of LAPACK
    factor, failed = dpotrf(scaled.T, lower=1, overwrite_a=1)
    if failed:
        return None
    smallest = _near_smallest_eigenvalue(factor) / _NEAR
    if smallest < bound:
        scaled, _ = unit_diagonal(Q)
        scaled[np.diag_indices_from(scaled)] -= bound
        if dpotrf(scaled.T, lower=1, overwrite_a=1)[1]:
            return None
    factor *= scale[:, None]
    return factor, 1.0 / max(smallest, bound)


def _near_smallest_eigenvalue(factor: Array) -> float:
    """Estimate from above, in O(n^2), by two steps of inverse iteration from a vector without any symmetry."""
    start, _ = dpotrs(factor, np.sin(np.arange(1.0, len(factor) + 1) ** 2), lower=1)
    end, _ = dpotrs(factor, start, lower=1)
    return float(np.sqrt((start @ start) / (end @ end)))


def smallest_scaled_eigenvalue(Q: Array) -> tuple[float, float]:
    """Smallest eigenvalue of `Q` scaled to unit diagonal, and what counts as zero there."""
    if Q.size == 0:
        return np.inf, 0.0
    scaled, _ = unit_diagonal(Q)
    return float(np.linalg.eigvalsh(scaled)[0]), 8 * len(Q) * EPS

"""Symplectic linear algebra: Williamson's normal form and the energy coordinates behind it.

Arrays in, arrays out.  The order of a phase-space vector is `z = (q_1 .. q_n, p_1 .. p_n)`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import hessenberg, solve_triangular, svd
from scipy.linalg.lapack import dgehrd

from . import _checks
from ._graphs import coupled_pairs
from ._lapack import bidiagonal_components
from ._twofloat import Pair, divide, two_prod, two_sum
from .exceptions import StructureError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_LARGEST = 10**8  # degrees of freedom of a matrix that memory could be addressed for
_MODERATE = 1e100  # entries of Q and B whose products stay in the range of doubles
_SPREAD = 64.0  # largest frequency over the smallest, up to which errors relative to the largest are small enough
_SLICES = 4  # of 21 bits or more each: twice the digits of a double with some to spare for terms that cancel


def symplectic_form(n: int) -> Array:
    """Canonical symplectic matrix `J = [[0, I], [-I, 0]]`.

    Parameters
    ----------
    n : int
        Number of degrees of freedom.

    Returns
    -------
    ndarray, shape (2n, 2n)
        The matrix `J`.

    Raises
    ------
    StructureError
        If `n` is not a whole number, negative, or more than a matrix has room for.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.symplectic_form(1)
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 0:
        raise StructureError(
            f"n is {_checks.shown(n)}; the number of degrees of freedom is a whole number, not negative"
        )
    if n > _LARGEST:
        raise StructureError(
            f"n is too large for a matrix in memory: allowed up to {_LARGEST}; apply J by swapping halves"
        )
    J = np.zeros((2 * n, 2 * n))
    J[:n, n:] = np.eye(n)
    J[n:, :n] = -np.eye(n)
    return J


def apply_form(M: Array) -> Array:
    """Return `J M` without forming `J`: swap the halves, negate the lower."""
    n = len(M) // 2
    return np.concatenate([M[n:], 0.0 - M[:n]])


def symplectic_inverse(S: Array) -> Array:
    """`S^{-1} = J^T S^T J` of a symplectic matrix, exactly."""
    return apply_form(apply_form(S).T)


def is_symplectic(S: ArrayLike, *, rtol: float | None = None) -> bool:
    """Tell whether `S^T J S = J`, relative to the size of `S`.

    Parameters
    ----------
    S : array_like, shape (2n, 2n)
        Matrix to test.
    rtol : float, optional
        Allowed `max |S^T J S - J| / max(1, ||S||_2^2)`; default `100 * 2n * eps`.

    Returns
    -------
    bool
        False too for a matrix that is not square of even size.

    Raises
    ------
    StructureError
        If `S` is not a real, finite matrix, or `rtol` no number from 0 to 1.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> phc.is_symplectic(np.diag([2.0, 0.5])), phc.is_symplectic(2 * np.eye(2))
    (True, False)
    """
    array = _checks.real_array("S", S, 2)
    rows, columns = array.shape
    if rows != columns or rows % 2:
        return False
    allowed = 100 * rows * _checks.EPS if rtol is None else _checks.relative_tolerance(rtol)
    residual = array.T @ apply_form(array) - symplectic_form(rows // 2)
    scale = max(1.0, float(np.linalg.norm(array, 2)) ** 2) if rows else 1.0
    return bool(np.max(np.abs(residual), initial=0.0) <= allowed * scale)


def is_hamiltonian_matrix(A: ArrayLike, *, rtol: float | None = None) -> bool:
    """Tell whether `A = J Q` with a symmetric `Q`, relative to the size of `A`.

    Parameters
    ----------
    A : array_like, shape (2n, 2n)
        Matrix to test.
    rtol : float, optional
        Allowed `max |J A - (J A)^T| / max |A|`; default `100 * 2n * eps`.

    Returns
    -------
    bool
        False too for a matrix that is not square of even size.

    Raises
    ------
    StructureError
        If `A` is not a real, finite matrix, or `rtol` no number from 0 to 1.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.is_hamiltonian_matrix([[0, 1], [-4, 0]]), phc.is_hamiltonian_matrix([[1, 0], [0, 1]])
    (True, False)
    """
    array = _checks.real_array("A", A, 2)
    rows, columns = array.shape
    if rows != columns or rows % 2:
        return False
    allowed = 100 * rows * _checks.EPS if rtol is None else _checks.relative_tolerance(rtol)
    product = apply_form(array)
    asymmetry = np.max(np.abs(product - product.T), initial=0.0)
    return bool(asymmetry <= allowed * np.max(np.abs(array), initial=0.0))


def williamson(Q: ArrayLike, *, rtol: float | None = None) -> tuple[Array, Array]:
    """Williamson's normal form of a positive definite matrix, or a semidefinite one with a symplectic kernel.

    Finds `d >= 0` ascending and a symplectic `S` with `Q = S^T diag(d, d) S`
    (Theorem "Williamson's normal form" of the paper, and the remark after it).

    Parameters
    ----------
    Q : array_like, shape (2n, 2n)
        Symmetric positive semidefinite matrix, for a Hamiltonian `H = z^T Q z / 2`.
    rtol : float, optional
        Relative tolerance of the symmetry test, default `1000 * 2n * eps`.

    Returns
    -------
    d : ndarray, shape (n,)
        Symplectic eigenvalues, ascending: the natural frequencies of `z' = J Q z` (rad per unit time).  All are
        positive if `Q` is definite; otherwise half as many as the kernel has dimensions are exactly 0.
    S : ndarray, shape (2n, 2n)
        Symplectic matrix.

    Raises
    ------
    StructureError
        If `Q` is not square, even, symmetric and positive semidefinite, or its kernel is not symplectic: there are
        free momenta (rigid-body modes), for which `williamson_semidefinite` has a place; or if `rtol` is no
        number from 0 to 1.

    Notes
    -----
    Cholesky `Q = L L^T`; the skew matrix `L^T J L` goes by Householder reflections to a tridiagonal and,
    shuffled, to a bidiagonal one, whose singular values are `d`; Newton steps, as a rule one, take `S` back to
    the symplectic group.  Products in which large terms cancel are formed with twice the digits.  Degrees of freedom
    that `Q` does not couple are treated apart, so that each keeps its own relative accuracy.  Cost O(n^3); the residual
    `S^T diag(d, d) S - Q` is of size `n eps` relative to `||Q||`, those of `S J S^T = J` and `S^T J S = J` are what
    rounding the exact `S` leaves, `eps ||S||^2`.

    What counts as kernel: eigenvalues below `8 * 2n * eps` of `Q` scaled to unit diagonal.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> d, S = phc.williamson(np.diag([1.0, 9.0, 4.0, 1.0]))
    >>> d
    array([2., 3.])
    >>> phc.is_symplectic(S)
    True
    >>> phc.williamson(np.diag([0.0, 2.0, 0.0, 2.0]))[0]
    array([0., 2.])
    """
    array = _checks.hamiltonian_matrix(Q, rtol=rtol)
    d1, d2, S = normal_form_rows(array)
    free, n = int(np.sum(d1 != d2)), len(d1)
    if free:
        symplectic = 2 * int(np.sum(d2 == 0))
        kernel = free + symplectic
        raise StructureError(
            f"Q is only positive semidefinite and its kernel is not symplectic: rank {2 * n - kernel}, kernel of "
            f"dimension {kernel}, its symplectic part of dimension {symplectic} (eigenvalues below "
            f"{8 * len(array) * _checks.EPS:.1e} after scaling to unit diagonal count as zero); no S gives diag(d, d): "
            f"use williamson_semidefinite(Q), or ground or remove the {free} rigid-body mode(s)"
        )
    order = np.argsort(d1, kind="stable")
    return d1[order], S[np.concatenate([order, order + n])]


def energy_coordinates(Q: Array) -> tuple[Array, ComplexArray, Array]:
    """Coordinates in which the energy is a sum of squares and the motion a set of rotations.

    For symmetric `Q >= 0` returns `d > 0` ascending, complex rows `E` and real rows `E0` such that with
    `x = E z` and `x0 = E0 z`

        z^T Q z = |x|^2 + |x0|^2,    x' = -i d x + E B u,    x0' = E0 B u,    y = Re((E B)^H x) + (E0 B)^T x0.

    `x0` collects what the energy sees but no spring holds: the momenta of rigid-body modes.
    """
    size = len(Q)
    frequencies: list[Array] = [np.zeros(0)]
    rotating: list[ComplexArray] = [np.zeros((0, size), complex)]
    rigid: list[Array] = [np.zeros((0, size))]
    for block in _decoupled(Q):
        d, S, still = _reduce_block(Q[np.ix_(block, block)])
        x = np.sqrt(d)[:, None] * (S[0][: len(d)] + 1j * S[0][len(d) :])
        frequencies.append(d)
        rotating.append(_embed(x, block, size))
        rigid.append(_embed(still[0], block, size))
    d = np.concatenate(frequencies)
    order = np.argsort(d, kind="stable")
    return d[order], np.concatenate(rotating)[order], np.concatenate(rigid)


def port_spectrum(Q: Array, B: Array) -> tuple[Array, Array] | None:
    """Frequencies and residues `(d, kappa)` of one port, without the modes behind them: a fraction of their cost.

    With `Q = F F^T` the transfer function is `b^T (s - K)^{-1} b`, `K = F^T J F` skew and `b = F^T B`.  Householder
    reflections that begin with one of `b` make `K` tridiagonal; with it come frequencies, and as squares of the first
    entries of its eigenvectors the residues.  Errors are of the size of `eps d_max`, so None where `d` is spread
    wide, and for whatever else needs more care: parts that are not coupled, a semidefinite `Q`, sizes far from 1.
    """
    if Q.size == 0:
        return None
    size = np.abs(np.concatenate([np.diag(Q), B]))
    moderate = size.max() < _MODERATE and np.diag(Q).min() > 1 / _MODERATE and size[len(Q) :].max() > 1 / _MODERATE
    if not moderate or len(_decoupled(Q)) > 1 or not _checks.clearly_definite(Q):
        return None
    n = len(Q) // 2
    F = np.linalg.cholesky(0.5 * (Q + Q.T))
    half = F[:n].T @ F[n:]
    K, b = half - half.T, F.T @ B
    length = float(np.linalg.norm(b))
    v = b.copy()
    v[0] += np.copysign(length, v[0])
    v /= np.linalg.norm(v)
    turned = np.outer(2 * v, K @ v)
    H, _, _ = dgehrd(K + (turned - turned.T), lwork=64 * len(K))
    superdiagonal = 0.5 * np.abs(np.diag(H, 1) - np.diag(H, -1))
    # of the tridiagonal matrix, even places meet odd ones only: a bidiagonal one whose first column is that of `b`
    along = np.zeros(n)
    along[0] = length
    d, first, _ = bidiagonal_components(superdiagonal[0::2], superdiagonal[1::2], along)
    return (d[::-1].copy(), first[::-1] ** 2) if d[-1] * _SPREAD > d[0] else None


def normal_form_rows(Q: Array) -> tuple[Array, Array, Array]:
    """`(d1, d2, S)` with `Q = S^T diag(d1, d2) S` for symmetric `Q >= 0`, `S` symplectic.

    Pairs in the order oscillating (`d1 = d2`, ascending), free (0, 1), cyclic (0, 0).
    """
    n = len(Q) // 2
    kinds: list[Array] = [np.zeros((3, 0))]
    upper: list[Array] = [np.zeros((0, 2 * n))]
    lower: list[Array] = [np.zeros((0, 2 * n))]
    for block in _decoupled(Q):
        half = len(block) // 2
        d, S, still = _reduce_block(Q[np.ix_(block, block)])
        free = len(still[0])
        cyclic = half - len(d) - free
        rows = _complete(d, S, still) if free or cyclic else S[0]
        d1 = np.concatenate([d, np.zeros(free + cyclic)])
        d2 = np.concatenate([d, np.ones(free), np.zeros(cyclic)])
        kinds.append(np.stack([np.repeat([0.0, 1.0, 2.0], [len(d), free, cyclic]), d1, d2]))
        upper.append(_embed(rows[:half], block, 2 * n))
        lower.append(_embed(rows[half:], block, 2 * n))
    kind, d1, d2 = np.concatenate(kinds, axis=1)
    order = np.lexsort([d1, kind])
    return d1[order], d2[order], np.concatenate([np.concatenate(upper)[order], np.concatenate(lower)[order]])


def _decoupled(Q: Array) -> list[NDArray[np.intp]]:
    """Split the indices of phase space into groups of (q, p) pairs that `Q` does not couple."""
    count, label = coupled_pairs(Q)
    groups = [np.flatnonzero(label == k) for k in range(count)]
    return [np.concatenate([group, group + len(label)]) for group in groups]


def _embed(rows: NDArray, block: NDArray[np.intp], size: int) -> NDArray:
    full = np.zeros((len(rows), size), rows.dtype)
    full[:, block] = rows
    return full


def _reduce_block(Q: Array) -> tuple[Array, Pair, Pair]:
    """Frequencies, symplectic rows `S` and free momenta of one coupled block, from the skew `F^T J F`, `Q = F F^T`.

    `Q = S^T diag(d, d) S + E^T E`, where the rows `E` commute (in Poisson's sense) with one another and with `S`.
    """
    F, smallest = _factor(Q)
    K = _poisson(_pair(F.T))
    sigma, left, right = skew_normal_form(K)
    pairs, size = len(sigma), len(F)
    # A singular value at rounding level belongs to free momenta.  That level: rounding the scaled Q by eps moves F by
    # eps / sqrt(its smallest eigenvalue), in units in which the largest plane (q_i, p_i) sets the size of F^T J F.
    # No subspace of rank r has more than 2n - r directions that commute with all of it; for a definite Q that is none.
    amplitude = np.sqrt(np.abs(np.diag(Q)))
    plane = np.max(amplitude[: size // 2] * amplitude[size // 2 :], initial=0.0)
    noise = 8 * _checks.EPS * max(plane / np.sqrt(smallest), size * max(plane, sigma.max(initial=0.0)))
    zero = min(int(np.sum(sigma <= noise)), (size - F.shape[1]) // 2)
    planes = np.concatenate([left[:, zero:pairs], right[:, zero:pairs]], axis=1)
    still = np.concatenate([left[:, :zero], right[:, :zero], left[:, pairs:], right[:, pairs:]], axis=1)
    d = sigma[zero:]
    root = np.sqrt(np.concatenate([d, d]))[:, None]
    rows = _product(_pair(planes.T), _pair(F))
    S, excess = _back_to_symplectic(np.concatenate([d, d]), divide(rows, (root, np.zeros_like(root))))
    # what the steps did to the length of the rows belongs to d: its Rayleigh quotient, free of the rounding of roots
    square, rest = two_prod(root[: len(d), 0], root[: len(d), 0])
    return square + (rest + square * excess), S, _product(_pair(still.T), _pair(F))


def _back_to_symplectic(weight: Array, S: Pair) -> tuple[Pair, Array]:
    """Newton steps on `S J S^T = J`; also by how much `q_l J p_l^T` was more than 1 before them.

    Rounding leaves a skew defect of about `eps d_max / sqrt(d_j d_l)`.  Of two rows the one with the smaller
    weight takes most of their correction, so that the energy `S^T diag(weight) S` stays as it is.  In pairs of
    doubles: a correction of what rounding to doubles does to S would be amplified by ||S||^2.
    """
    n = len(weight) // 2
    total = weight[:, None] + weight
    share = np.where(total > 0, weight / np.where(total > 0, total, 1.0), 0.5)
    excess = np.zeros(n)
    for _ in range(5):
        defect = _poisson(S, symplectic_form(n))
        # bounded, so that d stays positive where nothing can be told from rounding
        step = np.clip(np.diag(defect, n), -0.5, 0.5)
        excess = excess + step + excess * step
        S = two_sum(S[0], S[1] + (share * defect) @ apply_form(S[0]))
        # a step squares the defect
        if np.max(np.abs(defect), initial=0.0) ** 2 <= _checks.EPS:
            break
    return S, excess


def _complete(d: Array, S: Pair, still: Pair) -> Array:
    """Symplectic matrix from oscillating rows `S`, free momenta `still`, and what these lack of a basis.

    To each momentum the shortest position that fits, and an orthogonal start for the cyclic pairs; these rows carry
    no energy and take every correction.
    """
    unit = _balancing_units(np.sqrt(np.concatenate([d, d]))[:, None] * S[0], still[0])
    x = (S[0] * unit, S[1] * unit)
    # |still z|^2 stays as it is under rotations; one makes the momenta orthogonal
    U, size, _ = np.linalg.svd(still[0] * unit, full_matrices=False)
    rotated = _product(_pair(U.T), ((still[0] * unit).T, (still[1] * unit).T))
    momenta = divide(rotated, (size[:, None], np.zeros((len(size), 1))))
    basis, R = np.linalg.qr(np.concatenate([x[0], momenta[0]]).T)
    positions = apply_form(basis @ solve_triangular(R, np.eye(len(R))[:, len(x[0]) :], trans="T")).T
    positions = positions + 0.5 * _poisson(_pair(positions)) @ momenta[0]
    q, p = _cyclic_pairs(np.concatenate([x[0], momenta[0], positions]))
    half, cyclic = len(d), np.zeros(len(q))
    rows = (
        np.concatenate([x[0][:half], positions, q, x[0][half:], momenta[0], p]),
        np.concatenate([x[1][:half], 0 * positions, 0 * q, x[1][half:], momenta[1], 0 * p]),
    )
    (full, _), _ = _back_to_symplectic(np.concatenate([d, 0 * size, cyclic, d, size**2, cyclic]), rows)
    one = np.ones_like(d)
    return full * np.concatenate([one, 1 / size, 1 + cyclic, one, size, 1 + cyclic])[:, None] / unit


def _balancing_units(*rows: Array) -> Array:
    """Powers of two that make position and momentum columns of a degree of freedom alike; `q` and `p` inversely."""
    size = np.sqrt(sum(np.sum(part**2, axis=0) for part in rows))
    q, p = np.split(size, 2)
    known = (q > 0) & (p > 0)
    typical = np.sqrt(np.max(q * p, initial=0.0, where=known)) if known.any() else 1.0
    q, p = np.where(q > 0, q, typical**2 / np.where(p > 0, p, typical)), np.where(p > 0, p, typical)
    stretch = np.exp2(np.round(0.5 * (np.log2(p) - np.log2(q))))
    return np.concatenate([stretch, 1 / stretch])


def _cyclic_pairs(rows: Array) -> tuple[Array, Array]:
    """Conjugate rows that commute (in Poisson's sense) with all the given ones and complete them to a basis."""
    basis, _ = np.linalg.qr(rows.T, mode="complete")
    free = apply_form(basis[:, len(rows) :]).T
    sigma, a, b = skew_normal_form(_poisson(_pair(free)))
    return (a / np.sqrt(sigma)).T @ free, (b / np.sqrt(sigma)).T @ free


def _factor(Q: Array) -> tuple[Array, float]:
    """Return `F` of full column rank with `F F^T = Q`: Cholesky if definite, else by eigenvectors.

    With it the smallest eigenvalue, of `Q` scaled to unit diagonal, that counts as more than zero; of a definite `Q`,
    where none is zero, at times only the bound 1.
    """
    scaled, scale = _checks.unit_diagonal(Q)
    if _checks.clearly_definite(Q):
        return scale[:, None] * np.linalg.cholesky(scaled), 1.0
    smallest, tolerance = _checks.smallest_scaled_eigenvalue(Q)
    if smallest > tolerance:
        return scale[:, None] * np.linalg.cholesky(scaled), smallest
    values, vectors = np.linalg.eigh(scaled)
    kept = values > tolerance
    return scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]), float(np.min(values[kept], initial=1.0))


def skew_normal_form(K: Array) -> tuple[Array, Array, Array]:
    """Orthogonal normal form of a real skew matrix: `K = sum_l sigma_l (a_l b_l^T - b_l a_l^T)`.

    Returns `sigma >= 0` ascending and orthonormal columns `a`, `b`; where there are more columns than
    singular values, the last ones span the kernel.  The Hessenberg form of a skew matrix is tridiagonal, so
    its even rows meet only odd columns: a bidiagonal matrix of half the size, and an SVD of that.
    """
    if len(K) < 2:
        return np.zeros(0), np.eye(len(K)), np.zeros((len(K), 0))
    H, P = hessenberg(K, calc_q=True)
    superdiagonal = 0.5 * (np.diag(H, 1) - np.diag(H, -1))
    T = np.diag(superdiagonal, 1) - np.diag(superdiagonal, -1)
    # rows are odd and columns even indices, which makes the bidiagonal an upper one
    U, sigma, Vt = svd(-T[1::2, 0::2], lapack_driver="gesvd")
    a = P[:, 0::2] @ Vt.T
    b = P[:, 1::2] @ U
    count = len(sigma)
    a[:, :count] = a[:, :count][:, ::-1]
    b[:, :count] = b[:, :count][:, ::-1]
    return sigma[::-1].copy(), a, b


def _pair(array: Array) -> Pair:
    return array, np.zeros_like(array)


def _poisson(rows: Pair, canonical: Array | float = 0.0) -> Array:
    """Poisson brackets `rows J rows^T` less their canonical values, formed with twice the digits."""
    n = rows[0].shape[1] // 2
    high, low = _product((rows[0][:, :n], rows[1][:, :n]), (rows[0][:, n:], rows[1][:, n:]))
    skew, rest = two_sum(high, -high.T)
    return (skew - canonical) + (rest + (low - low.T))


def _product(left: Pair, right: Pair) -> Pair:
    """`left @ right^T` with twice the digits, by ordinary products of slices that are exact."""
    bits = (53 - left[0].shape[1].bit_length()) // 2
    first, second = _slices(left, bits), _slices(right, bits)
    high = low = np.zeros((len(left[0]), len(right[0])))
    for total in range(_SLICES):
        for i in range(total + 1):
            high, rest = two_sum(high, first[i] @ second[total - i].T)
            low = low + rest
    return two_sum(high, low)


def _slices(rows: Pair, bits: int) -> list[Array]:
    """Summands of `bits` bits each, relative to the largest entry of the row: products of two add up exactly."""
    rest, low = rows
    _, exponent = np.frexp(np.max(np.abs(rest), axis=1, initial=0.0))
    out = []
    for k in range(1, _SLICES + 1):
        # adding and taking away a large number rounds to a multiple of its last place
        large = np.ldexp(0.75, exponent - k * bits + 53)[:, None]
        out.append((rest + large) - large)
        rest = rest - out[-1]
        if k == 2:
            rest = rest + low
    return out

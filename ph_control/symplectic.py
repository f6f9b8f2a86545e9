"""Symplectic linear algebra: Williamson's normal form and the energy coordinates behind it.

Arrays in, arrays out.  The order of a phase-space vector is `z = (q_1 .. q_n, p_1 .. p_n)`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import hessenberg, svd
from scipy.sparse.csgraph import connected_components

from . import _checks
from .exceptions import StructureError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


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
        If `n` is not a whole number, or negative.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.symplectic_form(1)
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 0:
        raise StructureError(f"n is {n!r}; the number of degrees of freedom is a whole number, not negative")
    J = np.zeros((2 * n, 2 * n))
    J[:n, n:] = np.eye(n)
    J[n:, :n] = -np.eye(n)
    return J


def apply_form(M: Array) -> Array:
    """Return `J M` without forming `J`: swap the halves, negate the lower."""
    n = len(M) // 2
    return np.concatenate([M[n:], 0.0 - M[:n]])


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
        If `S` is not a real, finite matrix.

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
    allowed = 100 * rows * _checks.EPS if rtol is None else rtol
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
        If `A` is not a real, finite matrix.

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
    allowed = 100 * rows * _checks.EPS if rtol is None else rtol
    product = apply_form(array)
    asymmetry = np.max(np.abs(product - product.T), initial=0.0)
    return bool(asymmetry <= allowed * np.max(np.abs(array), initial=0.0))


def williamson(Q: ArrayLike, *, rtol: float | None = None) -> tuple[Array, Array]:
    """Williamson's normal form of a positive definite matrix.

    Finds `d > 0` ascending and a symplectic `S` with `Q = S^T diag(d, d) S`
    (Theorem "Williamson's normal form" of the paper).

    Parameters
    ----------
    Q : array_like, shape (2n, 2n)
        Symmetric positive definite matrix, for a Hamiltonian `H = z^T Q z / 2`.
    rtol : float, optional
        Relative tolerance of the symmetry test, default `1000 * 2n * eps`.

    Returns
    -------
    d : ndarray, shape (n,)
        Symplectic eigenvalues, ascending: the natural frequencies of `z' = J Q z` (rad per unit time).
    S : ndarray, shape (2n, 2n)
        Symplectic matrix.

    Raises
    ------
    StructureError
        If `Q` is not square, even, symmetric and positive definite.

    Notes
    -----
    Cholesky `Q = L L^T`; the skew matrix `L^T J L` goes by Householder reflections to a tridiagonal and,
    shuffled, to a bidiagonal one, whose singular values are `d`; Newton steps, as a rule one, take `S` back to
    the symplectic group.  Degrees of freedom that `Q` does not couple are treated apart, so that each keeps its
    own relative accuracy.  Cost O(n^3); the residuals `S^T diag(d, d) S - Q` and `S J S^T - J` are of size
    `n eps` relative to `||Q||` and `||S||^2`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> d, S = phc.williamson(np.diag([1.0, 9.0, 4.0, 1.0]))
    >>> d
    array([2., 3.])
    >>> phc.is_symplectic(S)
    True
    """
    array = _checks.hamiltonian_matrix(Q, definite=True, rtol=rtol)
    d, rows, _ = energy_coordinates(array)
    rows = rows / np.sqrt(d)[:, None]
    return d, np.concatenate([rows.real, rows.imag])


def energy_coordinates(Q: Array) -> tuple[Array, ComplexArray, Array]:
    """Coordinates in which the energy is a sum of squares and the motion a set of rotations.

    For symmetric `Q >= 0` returns `d > 0` ascending, complex rows `E` and real rows `E0` such that with
    `x = E z` and `x0 = E0 z`

        z^T Q z = |x|^2 + |x0|^2,    x' = -i d x + E B u,    x0' = E0 B u,    y = Re((E B)^H x) + (E0 B)^T x0.

    `x0` collects what the energy sees but no spring holds: the momenta of rigid-body modes.
    """
    size = len(Q)
    frequencies: list[Array] = []
    rotating: list[ComplexArray] = []
    rigid: list[Array] = []
    for block in _decoupled(Q):
        d, x, x0 = _reduce_block(Q[np.ix_(block, block)])
        frequencies.append(d)
        rotating.append(_embed(x, block, size))
        rigid.append(_embed(x0, block, size))
    d = np.concatenate([np.zeros(0), *frequencies])
    order = np.argsort(d, kind="stable")
    rows = np.concatenate([np.zeros((0, size), complex), *rotating])
    return d[order], rows[order], np.concatenate([np.zeros((0, size)), *rigid])


def _decoupled(Q: Array) -> list[NDArray[np.intp]]:
    """Split the indices of phase space into groups of (q, p) pairs that `Q` does not couple."""
    n = len(Q) // 2
    pattern = Q != 0
    coupled = pattern[:n, :n] | pattern[:n, n:] | pattern[n:, :n] | pattern[n:, n:]
    count, label = connected_components(coupled, directed=False)
    groups = [np.flatnonzero(label == k) for k in range(count)]
    return [np.concatenate([group, group + n]) for group in groups]


def _embed(rows: NDArray, block: NDArray[np.intp], size: int) -> NDArray:
    full = np.zeros((len(rows), size), rows.dtype)
    full[:, block] = rows
    return full


def _reduce_block(Q: Array) -> tuple[Array, ComplexArray, Array]:
    """`energy_coordinates` of one coupled block, through the skew matrix `F^T J F` of `Q = F F^T`."""
    F = _factor(Q)
    K = F.T @ apply_form(F)
    sigma, left, right = skew_normal_form(0.5 * (K - K.T))
    pairs = len(sigma)
    # a singular value at rounding level belongs to a rigid-body momentum; a definite Q has none
    zero = 0 if len(F) == F.shape[1] else int(np.sum(sigma <= 8 * len(F) * _checks.EPS * sigma.max(initial=0.0)))
    x = (left[:, zero:pairs] + 1j * right[:, zero:pairs]).T @ F.T
    still = np.concatenate([left[:, :zero], right[:, :zero], left[:, pairs:], right[:, pairs:]], axis=1)
    return sigma[zero:], _back_to_symplectic(sigma[zero:], x), still.T @ F.T


def _back_to_symplectic(d: Array, x: ComplexArray) -> ComplexArray:
    """Newton steps on `S J S^T = J` for the rows `S` of `x / sqrt(d)`.

    Rounding leaves a skew defect of about `eps d_max / sqrt(d_j d_l)`.  Of two rows the one with the smaller
    `d` takes most of their correction, so that the energy `S^T diag(d, d) S` stays as it is.
    """
    weight = np.concatenate([d, d])
    share = weight / (weight[:, None] + weight)
    S = np.concatenate([x.real, x.imag]) / np.sqrt(weight)[:, None]
    for _ in range(5):
        defect = S @ apply_form(S.T) - symplectic_form(len(d))
        S = S + (share * defect) @ apply_form(S)
        # a step squares the defect
        if np.max(np.abs(defect), initial=0.0) ** 2 <= _checks.EPS:
            break
    S = np.sqrt(weight)[:, None] * S
    return S[: len(d)] + 1j * S[len(d) :]


def _factor(Q: Array) -> Array:
    """Return `F` of full column rank with `F F^T = Q`: Cholesky if definite, else by eigenvectors."""
    scaled, scale = _checks.unit_diagonal(Q)
    smallest, tolerance = _checks.smallest_scaled_eigenvalue(Q)
    if smallest > tolerance:
        return scale[:, None] * np.linalg.cholesky(scaled)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > tolerance
    return scale[:, None] * vectors[:, kept] * np.sqrt(values[kept])


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

"""Symplectic linear algebra: Williamson's normal form and the energy coordinates behind it.

Arrays in, arrays out.  The order of a phase-space vector is `z = (q_1 .. q_n, p_1 .. p_n)`.
"""

from __future__ import annotations

from collections.abc import Iterator
from decimal import localcontext

import numpy as np
from scipy.linalg import solve_triangular

from .. import _checks
from .._types import Array, ArrayLike, ComplexArray, Indices, NDArray
from ..exceptions import StructureError
from ..numerics.double_double import Pair, divide, exactly, product
from ..numerics.graphs import coupled_pairs
from ..numerics.polynomials import WIDE, decimals, transfer_coefficients
from .skew_tridiagonal import (
    apply_form,
    back_to_symplectic,
    bounded_spectrum,
    pair_spectrum,
    poisson,
    reduce_block,
    skew_normal_form,
)

_LARGEST = 10**8  # degrees of freedom of a matrix that memory could be addressed for
_MODERATE = 1e100  # entries of Q and B whose products stay in the range of doubles
_SPREAD = 64.0  # largest frequency over the smallest, up to which errors relative to the largest are small enough


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
    _checks.whole_number("n", n, 0, _LARGEST)
    J = np.zeros((2 * n, 2 * n))
    J[:n, n:] = np.eye(n)
    J[n:, :n] = -np.eye(n)
    return J


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
        If `S` is not a real, finite matrix, its products leave the range of doubles, or `rtol` is no number from 0
        to 1.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> phc.is_symplectic(np.diag([2.0, 0.5])), phc.is_symplectic(2 * np.eye(2))
    (True, False)
    """
    array, allowed = _even_square("S", S, rtol)
    return allowed is not None and _checks.symplectic_defect(array) <= allowed


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
    array, allowed = _even_square("A", A, rtol)
    if allowed is None:
        return False
    product = apply_form(array)
    asymmetry = np.max(np.abs(product - product.T), initial=0.0)
    return bool(asymmetry <= allowed * np.max(np.abs(array), initial=0.0))


def _even_square(name: str, M: ArrayLike, rtol: float | None) -> tuple[Array, float | None]:
    """Check a matrix that is to be tested, and the tolerance; None for that if the matrix is of no size it could be."""
    array = _checks.real_array(name, M, 2)
    rows, columns = array.shape
    allowed = 100 * rows * _checks.EPS if rtol is None else _checks.relative_tolerance(rtol)
    return array, allowed if rows == columns and rows % 2 == 0 else None


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
    the symplectic group.  Products in which large terms cancel have as many digits more as that costs.  Degrees of
    freedom that `Q` does not couple are treated apart, so that each keeps its own relative accuracy.  A block
    `diag(K, W)`, as of a mechanical system with stiffness `K` and `W = M^{-1}`, is recognised by its zeros and reduced
    by the singular vectors of `L_K^T L_W`, a matrix of half the size, in about a quarter of the time.  Cost O(n^3); the
    residual `S^T diag(d, d) S - Q` is of size `n eps` relative to `||Q||`, those of `S J S^T = J` and `S^T J S = J` are
    what rounding the exact `S` leaves, `eps ||S||^2`.

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
    array = _checks.symmetric_matrix(Q, rtol=rtol)
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


def williamson_semidefinite(Q: ArrayLike, *, rtol: float | None = None) -> tuple[Array, Array, Array]:
    """Williamson's normal form of any positive semidefinite matrix.

    Finds `d1, d2 >= 0` and a symplectic `S` with `Q = S^T diag(d1, d2) S` (the remark after Theorem "Williamson's
    normal form" of the paper), normalised so that each degree of freedom is one of three kinds, in this order:

    * oscillating, `d1 = d2 = d`, natural frequencies ascending;
    * free, `(d1, d2) = (0, 1)`: a rigid-body mode, energy `p^2 / 2` and a position that no spring holds;
    * cyclic, `(0, 0)`: a pair that the energy does not see.

    Parameters
    ----------
    Q : array_like, shape (2n, 2n)
        Symmetric positive semidefinite matrix, for a Hamiltonian `H = z^T Q z / 2`.
    rtol : float, optional
        Relative tolerance of the symmetry test, default `1000 * 2n * eps`.

    Returns
    -------
    d1 : ndarray, shape (n,)
        Energies of the positions; with the kinds of above.
    d2 : ndarray, shape (n,)
        Energies of the momenta.
    S : ndarray, shape (2n, 2n)
        Symplectic matrix.

    Raises
    ------
    StructureError
        If `Q` is not square, even, symmetric and positive semidefinite, or `rtol` is no number from 0 to 1.

    Notes
    -----
    The oscillating pairs and the free momenta are those of the skew matrix `F^T J F`, `Q = F F^T`; each free momentum
    gets the shortest position that fits, and the rest of phase space, which is symplectic, any basis.  O(n^3).

    What counts as zero is relative: eigenvalues of `Q` scaled to unit diagonal below `8 * 2n * eps`, and frequencies
    below what rounding that matrix can make of 0.  Degrees of freedom that `Q` does not couple are treated apart.
    `S J S^T = J` holds to the rounding of `S`, and `S^T diag(d1, d2) S = Q` to `n eps ||Q||`; with two or more free
    momenta of very different size to that times the root of the condition number of the scaled `Q` on its range, since
    rounding `Q` makes them fail to commute by as much.

    See Also
    --------
    williamson : for a kernel that is symplectic, with one `d`.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> two_masses_and_a_spring = [[2, -2, 0, 0], [-2, 2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> d1, d2, S = phc.williamson_semidefinite(two_masses_and_a_spring)
    >>> d1, d2
    (array([2., 0.]), array([2., 1.]))
    """
    return normal_form_rows(_checks.symmetric_matrix(Q, rtol=rtol))


def semidefinite_coefficients(d: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Coefficients of the canonical forms, with the doubled `d` of a positive semidefinite Hamiltonian.

    For the port-Hamiltonian system with `Q = diag(d)` and the input vector `v`: the denominator is
    `P(s) = prod_l (s^2 + d_l d_{n+l})`, and `c_{2k+1} = v^T diag(F_{k,0}, F_{k,1}) v` with the diagonal entries
    `f_{l,p} = d_{pn+l} e_k({d_j d_{n+j} : j != l})`, `e_k` the elementary symmetric polynomial.

    Parameters
    ----------
    d : array_like, shape (2n,)
        Energies of the positions, then of the momenta, none negative: `(d1, d2)` of `williamson_semidefinite`.
    v : array_like, shape (2n,)
        Input vector in the coordinates of the normal form, `v = S B`.

    Returns
    -------
    a : ndarray, shape (2n,)
        `(a_0 .. a_{2n-1})` of the denominator `s^{2n} + sum a_i s^i`; odd ones are exactly 0.
    c : ndarray, shape (n,)
        `(c_1, c_3 .. c_{2n-1})`, with which the numerator is `sum c_{2k+1} s^{2(n-k)-1}`.

    Raises
    ------
    StructureError
        If `d` is not a vector of even length without negative entries, `v` does not fit it, or a coefficient exceeds
        the range of doubles.

    Notes
    -----
    A binary tree of sums of fractions `kappa_l / (x + d_l d_{n+l})`, `kappa_l = d_l v_l^2 + d_{n+l} v_{n+l}^2`; every
    term is positive, so each coefficient has full relative accuracy.  O(n^2).

    The paper prints the products as `d_{j_1} .. d_{j_k} d_{j_{n+1}} .. d_{j_{n+k}}`; what is meant, and computed here,
    is `d_{j_1} .. d_{j_k} d_{n+j_1} .. d_{n+j_k}`.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.semidefinite_coefficients([4.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 2.0])  # s/(s^2 + 4) + 4/s
    (array([0., 0., 4., 0.]), array([ 5., 16.]))
    """
    energies, weights = _checks.real_array("d", d, 1), _checks.real_array("v", v, 1)
    n, odd = divmod(len(energies), 2)
    if odd or len(weights) != 2 * n:
        raise StructureError(
            f"d has {len(energies)} entries and v has {len(weights)}; each holds n of the positions and n of momenta"
        )
    if energies.min(initial=0.0) < 0:
        worst = int(energies.argmin())
        raise StructureError(f"d[{worst}] = {energies[worst]:.6g}; a stored energy cannot be negative")
    with localcontext(WIDE):
        x, weight = decimals(energies).reshape(2, n), decimals(weights).reshape(2, n)
        denominator, numerator = transfer_coefficients(x[0] * x[1], (x * weight**2).sum(axis=0))
    for part in (denominator, numerator):
        what = f"the coefficients of these {n} degrees of freedom"
        _checks.representable(what, part.to_doubles(), nonzero=part.mantissa > 0)
    return denominator.to_doubles(), numerator.to_doubles()


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
    for block, d, S, still in _reduced_blocks(Q):
        x = np.sqrt(d)[:, None] * (S[0][: len(d)] + 1j * S[0][len(d) :])
        frequencies.append(d)
        rotating.append(_embed(x, block, size))
        rigid.append(_embed(still[0], block, size))
    d = np.concatenate(frequencies)
    order = np.argsort(d, kind="stable")
    return d[order], np.concatenate(rotating)[order], np.concatenate(rigid)


def frequency_conditions(Q: Array, energy: tuple[Array, ComplexArray, Array]) -> Array:
    """How many times the rounding of the entries of `Q` each frequency moves, relative to itself.

    `energy` is `energy_coordinates(Q)`.  With the vector `x` of a mode, a change of `Q` moves its frequency by
    `x^H dQ x / x^H Q x` of itself, at most `|x|^T |Q| |x| / x^H Q x` times the largest relative change of an entry.
    No units of states change this, and rigid modes have no part in it.
    """
    d, E, _ = energy
    scale = np.sqrt(Q.diagonal())
    scale = np.where(scale > 0, scale, 1.0)
    # of x = J E^H the energy is 2 d^2
    with np.errstate(over="ignore", invalid="ignore"):
        x = scale[:, None] * np.abs(apply_form((E / d[:, None]).conj().T))
        return np.einsum("il,il->l", x, np.abs(Q / scale[:, None] / scale) @ x) / 2


def direct_sum(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[Array, Array]:
    """Q and B of two systems side by side, states `(q1, q2, p1, p2)`."""
    n1, n = len(first[0]) // 2, (len(first[0]) + len(second[0])) // 2
    Q, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, first[1].shape[1]))
    ours = np.r_[0:n1, n : n + n1]
    theirs = np.r_[n1:n, n + n1 : 2 * n]
    Q[np.ix_(ours, ours)], Q[np.ix_(theirs, theirs)] = first[0], second[0]
    B[ours], B[theirs] = first[1], second[1]
    return Q, B


def port_spectrum(Q: Array, B: Array) -> tuple[Array, Array, float | None] | None:
    """Frequencies and residues `(d, kappa)` of one port, without the modes behind them: a fraction of their cost.

    With them a bound for the norm of the inverse of `Q` scaled to unit diagonal, or None if it couples no pair
    `(q_l, p_l)` to another: then there is a formula, and each has its full relative accuracy.

    With `Q = F F^T` the transfer function is `b^T (s - K)^{-1} b`, `K = F^T J F` skew and `b = F^T B`.  Householder
    reflections that begin with one of `b` make `K` tridiagonal; with it come frequencies, and as squares of the first
    entries of its eigenvectors the residues.  Errors are of the size of `eps d_max`, so None where `d` is spread
    wide, and for whatever else needs more care: parts that are not coupled, a semidefinite `Q`, sizes far from 1.
    """
    if Q.size == 0:
        return None
    size = np.abs(np.concatenate([np.diag(Q), B]))
    moderate = size.max() < _MODERATE and np.diag(Q).min() > 1 / _MODERATE and size[len(Q) :].max() > 1 / _MODERATE
    if not moderate:
        return None
    parts, _ = coupled_pairs(Q)
    if parts == len(Q) // 2 and (pairs := pair_spectrum(Q, B)) is not None:
        return *pairs, None
    if parts > 1:
        return None
    spectrum = bounded_spectrum(Q, B)
    return None if spectrum is None or spectrum[0][0] * _SPREAD <= spectrum[0][-1] else spectrum


def normal_form_rows(Q: Array) -> tuple[Array, Array, Array]:
    """`(d1, d2, S)` with `Q = S^T diag(d1, d2) S` for symmetric `Q >= 0`, `S` symplectic.

    Pairs in the order oscillating (`d1 = d2`, ascending), free (0, 1), cyclic (0, 0).
    """
    n = len(Q) // 2
    kinds: list[Array] = [np.zeros((3, 0))]
    upper: list[Array] = [np.zeros((0, 2 * n))]
    lower: list[Array] = [np.zeros((0, 2 * n))]
    for block, d, S, still in _reduced_blocks(Q):
        half = len(block) // 2
        free = len(still[0])
        cyclic = half - len(d) - free
        if len(d) == n:
            order = np.argsort(d, kind="stable")
            return d[order], d[order], S[0][np.concatenate([order, order + n])]
        rows = _complete(d, S, still) if free or cyclic else S[0]
        d1 = np.concatenate([d, np.zeros(free + cyclic)])
        d2 = np.concatenate([d, np.ones(free), np.zeros(cyclic)])
        kinds.append(np.stack([np.repeat([0.0, 1.0, 2.0], [len(d), free, cyclic]), d1, d2]))
        upper.append(_embed(rows[:half], block, 2 * n))
        lower.append(_embed(rows[half:], block, 2 * n))
    kind, d1, d2 = np.concatenate(kinds, axis=1)
    order = np.lexsort([d1, kind])
    return d1[order], d2[order], np.concatenate([*upper, *lower])[np.concatenate([order, order + n])]


def _reduced_blocks(Q: Array) -> Iterator[tuple[Indices, Array, Pair, Pair]]:
    """`reduce_block` of each group of (q, p) pairs that `Q` does not couple to others, with its indices before it."""
    count, label = coupled_pairs(Q)
    for k in range(count):
        group = np.flatnonzero(label == k)
        block = np.concatenate([group, group + len(label)])
        d, S, still = reduce_block(Q[np.ix_(block, block)] if count > 1 else Q)
        _checks.representable("the rows of the normal form of this Q", d, S[0])
        yield block, d, S, still


def _embed(rows: NDArray, block: Indices, size: int) -> NDArray:
    full = np.zeros((len(rows), size), rows.dtype)
    full[:, block] = rows
    return full


def _complete(d: Array, S: Pair, still: Pair) -> Array:
    """Symplectic matrix from oscillating rows `S`, free momenta `still`, and what these lack of a basis.

    To each momentum the shortest position that fits, and an orthogonal start for the cyclic pairs; these rows carry
    no energy and take every correction.
    """
    unit = _balancing_units(np.sqrt(np.concatenate([d, d]))[:, None] * S[0], still[0])
    x = (S[0] * unit, S[1] * unit)
    # |still z|^2 stays as it is under rotations; one makes the momenta orthogonal
    U, size, _ = np.linalg.svd(still[0] * unit, full_matrices=False)
    rotated = product(exactly(U.T), (still[0] * unit, still[1] * unit))
    momenta = divide(rotated, (size[:, None], np.zeros((len(size), 1))))
    basis, R = np.linalg.qr(np.concatenate([x[0], momenta[0]]).T)
    positions = apply_form(basis @ solve_triangular(R, np.eye(len(R))[:, len(x[0]) :], trans="T")).T
    positions = positions + 0.5 * poisson(exactly(positions)) @ momenta[0]
    q, p = _cyclic_pairs(np.concatenate([x[0], momenta[0], positions]))
    half, cyclic = len(d), np.zeros(len(q))
    rows = (
        np.concatenate([x[0][:half], positions, q, x[0][half:], momenta[0], p]),
        np.concatenate([x[1][:half], 0 * positions, 0 * q, x[1][half:], momenta[1], 0 * p]),
    )
    weight = np.concatenate([d, 0 * size, cyclic, d, size**2, cyclic])
    (full, _), _ = back_to_symplectic(weight, rows, modal=False)
    _checks.representable("the rows of the normal form of this Q", full)
    ones = np.ones_like(d)
    return full * np.concatenate([ones, 1 / size, 1 + cyclic, ones, size, 1 + cyclic])[:, None] / unit


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
    sigma, a, b = skew_normal_form(poisson(exactly(free)))
    return (a / np.sqrt(sigma)).T @ free, (b / np.sqrt(sigma)).T @ free

"""Positive semidefinite Hamiltonians: their normal form, and the coefficients with the doubled `d`."""

from __future__ import annotations

from decimal import localcontext

from .. import _checks
from .._types import Array, ArrayLike
from ..exceptions import StructureError
from ..numerics.polynomials import WIDE, decimals, transfer_coefficients
from .forms_and_williamson import normal_form_rows


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
    energies = _checks.real_array("d", d, 1)
    n, odd = divmod(len(energies), 2)
    if odd:
        raise StructureError(f"d has {len(energies)} entries; it holds n of the positions and n of the momenta")
    if energies.min(initial=0.0) < 0:
        worst = int(energies.argmin())
        raise StructureError(f"d[{worst}] = {energies[worst]:.6g}; a stored energy cannot be negative")
    weights = _checks.real_array("v", v, 1)
    if len(weights) != 2 * n:
        raise StructureError(f"v has {len(weights)} entries; with d of {2 * n} it must have {2 * n}")
    with localcontext(WIDE):
        x, weight = decimals(energies).reshape(2, n), decimals(weights).reshape(2, n)
        denominator, numerator = transfer_coefficients(x[0] * x[1], (x * weight**2).sum(axis=0))
    for part in (denominator, numerator):
        what = f"the coefficients of these {n} degrees of freedom"
        _checks.representable(what, part.to_doubles(), nonzero=part.mantissa > 0)
    return denominator.to_doubles(), numerator.to_doubles()

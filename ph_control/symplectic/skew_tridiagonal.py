"""Frequencies and mode shapes of one coupled energy `z^T Q z / 2`: what Williamson's normal form is computed by.

With `Q = F F^T` the modes are the planes of the skew matrix `F^T J F`: orthonormal columns `P` bring it to the form
`diag(d) J`, and the symplectic rows are `S = diag(d, d)^{-1/2} P^T F^T`.  Where positions and momenta are not coupled,
`F = diag(F_q, F_p)`, and the singular vectors of `F_q^T F_p`, a matrix of half the size, do the same.  Products in
which large terms cancel have more digits than a double.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.blas import dger, dtrmm
from scipy.linalg.lapack import dgehrd, dorghr

from .. import _checks
from .._types import Array
from ..numerics import definiteness as _definite
from ..numerics.double_double import Pair, divide, exactly, product, product_parts, two_prod, two_sum
from ..numerics.lapack import bidiagonal_components, bidiagonal_svd, components

Slices = int  # how many slices of the factors a product is made of, see `product_parts`

_AMPLIFIED = 2.0**20  # by how much rounding may be amplified for two slices to leave no more than a double's
_HARMLESS = 16.0  # by how much more than a double's the rounding of a product may be before it has twice the digits
_TIGHT = 2.0  # size of the terms of a bracket over that of the bracket, up to which doubles have its digits
_REPEATED = 64  # rows of a matrix up to which a second reduction costs less than products with more digits
_STEPS = 5
_NO_NUMBER = 1e-200  # residues whose squares are out of range
_TURN = 2.0**-30  # largest turn, in radians, whose square is no more than rounding
_BLOCKED = 64  # columns of workspace with which LAPACK applies reflections in blocks


def apply_form(M: Array) -> Array:
    """Return `J M` without forming `J`: swap the halves, negate the lower."""
    n = len(M) // 2
    return np.concatenate([M[n:], 0.0 - M[:n]])


# --- a block with all its modes -------------------------------------------------------------------------------


@np.errstate(over="ignore", invalid="ignore")  # who asks holds the rows to be finite
def reduce_block(Q: Array) -> tuple[Array, Pair, Pair]:
    """Frequencies, symplectic rows `S` and free momenta `E` of one coupled block.

    `Q = S^T diag(d, d) S + E^T E`, where the rows `E` commute (in Poisson's sense) with one another and with `S`.
    """
    Q, unit = _in_common_units(Q)
    factors, _ = _factors_and_inverse(Q)
    none = np.zeros((0, len(Q)))
    if factors and len(Q) == 2:
        d, S = _single_plane(*factors)
        return d, exactly(S / unit), exactly(none)
    definite = _definite_rows(factors) if factors else None
    if definite is not None:
        return definite[0], exactly(definite[1] / unit), exactly(none)
    d, rows, still = _semidefinite_rows(Q)
    return d, (rows[0] / unit, rows[1] / unit), (still[0] / unit, still[1] / unit)


def bounded_spectrum(Q: Array, b: Array) -> tuple[Array, Array, float] | None:
    """Frequencies and residues of one port for a clearly definite block, in doubles; None for any other.

    With them a bound for the norm of the inverse of `Q` scaled to unit diagonal.
    """
    Q, unit = _in_common_units(Q)
    factors, inverse = _factors_and_inverse(Q)
    b, n = b / unit, len(Q) // 2
    if len(factors) == 2:
        Fq, Fp = factors
        d, of_momenta, of_positions = components(_transposed_times(Fq, Fp), Fp.T @ b[n:], Fq.T @ b[:n])
        return d[::-1].copy(), (of_positions**2 + of_momenta**2)[::-1], inverse
    if not factors:
        return None
    (F,) = factors
    b, half = F.T @ b, _transposed_times(F[:n, :n], F[n:])
    # in the memory of F, which nobody needs any more: what is new has to be cleared by the system first
    K = np.ascontiguousarray(F.T)
    K[:n, :n], K[:n, n:] = half[:, :n] - half[:, :n].T, half[:, n:]
    K[n:, :n], K[n:, n:] = -half[:, n:].T, 0.0
    length = _turn_to_first_axis(K, b)
    _, superdiagonal = _reflected(K, overwrite=True)
    # of a tridiagonal matrix, even places meet odd ones only: a bidiagonal one, whose first column is that of `b`
    along = length * np.eye(1, n)[0]
    d, first, _ = bidiagonal_components(np.abs(superdiagonal[0::2]), np.abs(superdiagonal[1::2]), along)
    return d[::-1].copy(), first[::-1] ** 2, inverse


def _turn_to_first_axis(K: Array, b: Array) -> float:
    """Reflect a skew matrix, in place and in the order of C, as takes `b` to the first axis; return the length of `b`.

    With `K v = w` and the unit vector `v` of the reflection that is `K + 2 (v w^T - w v^T)`.
    """
    length = float(np.linalg.norm(b))
    if length > 0:
        v = b / length
        v[0] += np.copysign(1.0, v[0])
        v /= np.linalg.norm(v)
        w = K @ v
        # LAPACK sees the transpose
        dger(2.0, w, v, a=K.T, overwrite_a=1)
        dger(-2.0, v, w, a=K.T, overwrite_a=1)
    return length


def pair_spectrum(Q: Array, b: Array) -> tuple[Array, Array] | None:
    """Frequencies and residues where `Q` couples no pair `(q_l, p_l)` to another; None where terms may cancel."""
    q, p = np.split(np.diag(Q), 2)
    x, y = np.split(b, 2)
    c = 0.5 * (np.diag(Q, len(q)) + np.diag(Q, -len(q)))
    if not ((q > 0) & (p > 0) & (4 * c * c <= q * p)).all():
        return None
    # exactly `d` of `diag(d, d)`
    root = np.sqrt(q * p)
    d, kappa = root * np.sqrt((1 - c / root) * (1 + c / root)), q * x * x + p * y * y + 2 * c * x * y
    if (((x != 0) | (y != 0)) & (kappa < _NO_NUMBER)).any():
        return None
    order = np.argsort(d, kind="stable")
    return d[order], kappa[order]


def _factors_and_inverse(Q: Array) -> tuple[list[Array], float]:
    """Lower factor of a clearly definite `Q`, or those of positions and momenta where it does not couple these.

    The list is empty if `Q` may be semidefinite.  With it a bound for the norm of the inverse of `Q` scaled to unit
    diagonal.
    """
    factors = [_definite.definite_factor(part) for part in _definite.uncoupled_halves(Q)]
    known = [factor for factor in factors if factor is not None]
    return ([F for F, _ in known], max(inverse for _, inverse in known)) if len(known) == len(factors) else ([], np.inf)


def _in_common_units(Q: Array) -> tuple[Array, Array]:
    """`Q` in units in which positions and momenta have entries of one size; powers of two, by which states divide."""
    diagonal, n = np.diag(Q), len(Q) // 2
    if not (diagonal > 0).all():
        return Q, np.ones(len(Q))
    size = np.log2(diagonal)
    stretch = np.exp2(np.round(0.25 * (size[n:] - size[:n])))
    unit = np.concatenate([stretch, 1 / stretch])
    return (Q if (unit == 1.0).all() else unit[:, None] * Q * unit), unit


def _transposed_times(lower: Array, right: Array) -> Array:
    return np.asarray(dtrmm(1.0, lower, right, lower=1, trans_a=1))


# --- definite blocks ------------------------------------------------------------------------------------------


def _definite_rows(factors: list[Array]) -> tuple[Array, Array] | None:
    """Frequencies and rows `S` of `Q`, given its triangular factors; None if rounding leaves a frequency of zero."""
    reduce = _coupled_rows if len(factors) == 1 else _separate_rows
    # how many digits products need shows when frequencies and vectors are known; more often than not the fewest do
    first = 2 if len(factors) == 1 and len(factors[0]) > _REPEATED else 1
    attempts = (reduce(slices, *factors) for slices in range(first, 4))
    return next((attempt for attempt in attempts if attempt is not None), None)


def _single_plane(*factors: Array) -> tuple[Array, Array]:
    """Frequency and rows of one degree of freedom: `S = F^T / sqrt(d)`, `d` the product of the diagonal of `F`."""
    F = factors[0] if len(factors) == 1 else np.diag([factors[0][0, 0], factors[1][0, 0]])
    q, p = np.diag(F)
    d, squeeze = q * p, np.sqrt(q / p)
    return np.array([d]), np.array([[squeeze, F[1, 0] / np.sqrt(d)], [0.0, 1 / squeeze]])


def _coupled_rows(slices: Slices, F: Array) -> tuple[Array, Array] | None:
    """Frequencies and rows `S` of `Q = F F^T`; None if that needs more slices."""
    n = len(F) // 2
    K = np.zeros((2 * n, 2 * n))
    for part in product_parts(exactly(F[:n, :n].T), exactly(F[n:]), slices, lambda a, b: _transposed_times(a.T, b)):
        # differences of large terms that are equal but for the rounding of what follows are exact
        K[:n] += part
        K[:, :n] -= part.T
    sigma, planes = _planes(K)
    attempt = _rows(slices, sigma, (F, planes))
    if attempt is None:
        return None
    (rows,), length, _ = attempt
    S, excess = back_to_symplectic(np.concatenate([sigma, sigma]), rows, max(2, slices))
    return sigma + sigma * _quotient(excess, length), S[0]


def _separate_rows(slices: Slices, Fq: Array, Fp: Array) -> tuple[Array, Array] | None:
    """As `_coupled_rows`, of `Q = diag(Fq Fq^T, Fp Fp^T)`."""
    n = len(Fq)
    parts = product_parts(exactly(Fq.T), exactly(Fp), slices, lambda a, b: _transposed_times(a.T, b))
    U, sigma, Vt = np.linalg.svd(sum(parts[1:], parts[0]))
    sigma = sigma[::-1].copy()
    attempt = _rows(slices, sigma, (Fq, U[:, ::-1]), (Fp, Vt[::-1].T))
    if attempt is None:
        return None
    rows, length, tight = attempt
    X, Y, excess = _back_to_inverses(sigma, rows[0], rows[1], 1 if tight else max(2, slices))
    S = np.zeros((2 * n, 2 * n))
    S[:n, :n], S[n:, n:] = X, Y
    return sigma + sigma * _quotient(excess, length), S


def _quotient(excess: Array, length: Array) -> Array:
    """By how much `(1 + excess) / length`, Rayleigh's quotient, is more than 1."""
    return (excess - (length - 1.0)) / length


def _rows(slices: Slices, sigma: Array, *factors: tuple[Array, Array]) -> tuple[list[Pair], Array, bool] | None:
    """Products `vectors^T F^T / sqrt(sigma)` with the digits that they need; None if these are more slices than given.

    Also the product of the lengths of the two vectors of each plane, 1 but for rounding, and whether terms hardly
    cancel in brackets.
    """
    if not sigma.min() > 0:
        return None
    root = np.sqrt(sigma if len(factors) == 2 else np.concatenate([sigma, sigma]))
    scaled: list[tuple[Array, Array, Array]] = []
    size, squares = np.empty((2, len(factors), len(root)))
    for k, (F, vectors) in enumerate(factors):
        right = np.divide(vectors, root, order="F")
        column, entries = np.einsum("ij,ij->j", F, F), right * right
        scaled.append((F, np.sqrt(column), right))
        size[k], squares[k] = column @ entries, entries.sum(axis=0)
    x, y = np.sqrt(size.reshape(2, -1))
    if len(factors) == 1:
        x = y = np.maximum(x, y)
    harmless = max(_cost_of_rounding(sigma, x, y), _cost_of_rounding(sigma, y, x)) <= _HARMLESS
    needed = 1 if harmless else 2 if x.max() * y.max() <= _AMPLIFIED else 3
    if needed > slices:
        return None
    rows = []
    for F, column, right in scaled:
        if needed > 1:
            # powers of two after which the sizes within a row or a column say what rounding does
            unit = np.exp2(np.round(np.log2(column)))
            F, right = F / unit, unit[:, None] * right
        high, low = product(exactly(F), exactly(right), needed, lambda a, b: dtrmm(1.0, a, b, lower=1))
        rows.append((high.T, low.T))
    return rows, sigma * np.sqrt(squares).reshape(2, -1).prod(axis=0), bool(np.max(x * y) <= _TIGHT)


def _cost_of_rounding(d: Array, x: Array, y: Array) -> float:
    """Bound of the error that rounding of rows makes, in units of `eps` times the largest energy of a row.

    With `x` and `y` the sizes that terms of conjugate rows have before they cancel, rounding makes a defect of
    `eps x_j y_l`.  The row with less energy takes it away, at the cost of `d_l x_l x_j` for each part, `d_l <= d_j`.
    """
    energy = d * x * x
    first, second = np.maximum.accumulate(d * x * y), np.maximum.accumulate(energy)
    return float(max(np.max(x * x * first), np.max(x * y * second)) / energy.max())


@np.errstate(over="ignore", invalid="ignore")  # where rounding leaves the form open the steps may diverge
def back_to_symplectic(weight: Array, S: Pair, slices: Slices = 3, *, modal: bool = True) -> tuple[Pair, Array]:
    """Newton steps on `S J S^T = J`; also by how much `q_l J p_l^T` was more than 1 before them.

    Rounding leaves a skew defect of about `eps d_max / sqrt(d_j d_l)`.  Of two rows the one with the smaller
    weight takes most of their correction, so that the energy `S^T diag(weight) S` stays nearly as it is.  Where `S` is
    `modal`, turns of planes leave it exactly so.  In pairs of doubles: a correction of what rounding to doubles does to
    S would be amplified by ||S||^2.
    """
    n = len(weight) // 2
    share = _shares(weight)
    excess = np.zeros(n)
    for _ in range(_STEPS):
        defect = poisson(S, slices, less=1.0)
        step = _bounded(np.diag(defect, n))
        excess = excess + step + excess * step
        move = share * defect
        if modal:
            even, odd = 0.5 * (defect[:n, :n] + defect[n:, n:]), 0.5 * (defect[:n, n:] - defect[n:, :n])
            even, odd = _turns(weight[:n], even, odd)
            move[:n, :n] += even
            move[n:, n:] += even
            move[:n, n:] += odd
            move[n:, :n] -= odd
        S = two_sum(S[0], S[1] + move @ apply_form(S[0]))
        if _quadratic(defect):
            break
    return S, excess


def _back_to_inverses(d: Array, X: Pair, Y: Pair, slices: Slices) -> tuple[Array, Array, Array]:
    """As `back_to_symplectic` for `S = diag(X, Y)`, whose brackets are `X Y^T`."""
    share = _shares(d)
    excess = np.zeros(len(d))
    for k in range(_STEPS):
        if k:
            X, Y = two_sum(*X), two_sum(*Y)
        defect, *rest = product_parts(X, (Y[0].T, Y[1].T), slices)
        defect[np.diag_indices(len(d))] -= 1.0
        for part in rest:
            defect += part
        step = _bounded(np.diag(defect))
        excess = excess + step + excess * step
        (turn,) = _turns(d, 0.5 * (defect + defect.T))
        X = X[0], X[1] - (share * defect + turn) @ X[0]
        Y = Y[0], Y[1] - (share * defect.T + turn) @ Y[0]
        if _quadratic(defect):
            break
    return X[0] + X[1], Y[0] + Y[1], excess


def _turns(d: Array, *parts: Array) -> list[Array]:
    """Turns of modes into each other, beside their shares, that undo a defect as it is between harmonic modes.

    Zero where frequencies are too near for a small turn.
    """
    # of opposite sign, to the last bit, for the two modes of a turn: what is left of one is no turn
    rate = (d - d[:, None]) / (d + d[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = 0.5 * (1.0 / rate - rate)
        turns = [rate * part for part in parts]
        small = [np.abs(turn) <= _TURN for turn in turns]
    for turn in turns:
        turn[~np.logical_and.reduce(small)] = 0.0
    return turns


def _shares(weight: Array) -> Array:
    """Of the correction that rows j and l share, the part of j: the less, the more energy it has."""
    total = weight[:, None] + weight
    if weight.min(initial=1.0) > 0:
        return np.divide(weight, total, out=total)
    return np.where(total > 0, weight / np.where(total > 0, total, 1.0), 0.5)


def _bounded(step: Array) -> Array:
    """So that d stays positive where nothing can be told from rounding."""
    return np.clip(step, -0.5, 0.5)


def _quadratic(defect: Array) -> bool:
    """Whether the square of a defect, which a step leaves, is no more than rounding."""
    return bool(np.max(np.abs(defect), initial=0.0) ** 2 <= _checks.EPS)


def poisson(rows: Pair, slices: Slices = 3, *, less: float = 0.0) -> Array:
    """Poisson brackets `rows J rows^T`, less a multiple of their canonical values."""
    n = rows[0].shape[1] // 2
    high, low = rows
    q = high[:, :n], low[:, :n] if low.ndim else low
    p = high[:, n:].T, low[:, n:].T if low.ndim else low
    parts = product_parts(q, p, slices)
    skew = parts[0] - parts[0].T
    if less:
        pairs = np.arange(len(skew) // 2)
        skew[pairs, pairs + len(pairs)] -= less
        skew[pairs + len(pairs), pairs] += less
    for part in parts[1:]:
        skew += part - part.T
    return skew


# --- skew matrices --------------------------------------------------------------------------------------------


def skew_normal_form(K: Array) -> tuple[Array, Array, Array]:
    """Orthogonal normal form of a real skew matrix: `K = sum_l sigma_l (a_l b_l^T - b_l a_l^T)`.

    Returns `sigma >= 0` ascending and orthonormal columns `a`, `b`; where there are more columns than
    singular values, the last ones span the kernel.
    """
    if len(K) < 2:
        return np.zeros(0), np.eye(len(K)), np.zeros((len(K), 0))
    sigma, basis = _planes(K)
    first = (len(K) + 1) // 2
    return sigma, basis[:, :first], basis[:, first:]


def _planes(K: Array) -> tuple[Array, Array]:
    """Values `sigma` and columns `(a, b)` of `skew_normal_form`, of at least two rows.

    The Hessenberg form of a skew matrix is tridiagonal, so its even rows meet only odd columns: a bidiagonal matrix of
    half the size, and an SVD of that.
    """
    reflections, superdiagonal = _reflected(K)
    P = reflections()
    pairs, odd = divmod(len(K), 2)
    if odd:
        # rows are odd and columns even indices, which makes the bidiagonal an upper one
        bidiagonal = np.zeros((pairs, pairs + 1))
        place = np.arange(pairs)
        bidiagonal[place, place], bidiagonal[place, place + 1] = superdiagonal[0::2], -superdiagonal[1::2]
        U, sigma, Vt = np.linalg.svd(bidiagonal)
    else:
        U, sigma, Vt = bidiagonal_svd(superdiagonal[0::2], -superdiagonal[1::2])
    basis = np.empty((len(K), len(K)), order="F")
    ascending = np.concatenate([Vt[:pairs][::-1], Vt[pairs:]]) if odd else Vt[::-1]
    np.matmul(P[:, 0::2], ascending.T, out=basis[:, : pairs + odd])
    np.matmul(P[:, 1::2], U[:, ::-1], out=basis[:, pairs + odd :])
    return sigma[::-1].copy(), basis


def _reflected(K: Array, *, overwrite: bool = False) -> tuple[Callable[[], Array], Array]:
    """Superdiagonal of the tridiagonal form of a skew matrix, and a call that gives the orthogonal basis it is in."""
    work = _BLOCKED * max(1, len(K))
    # the transpose, which is in the order of LAPACK, is -K
    H, scales, _ = dgehrd(K.T, lwork=work, overwrite_a=overwrite)
    return lambda: np.asarray(dorghr(H, scales, lwork=work)[0]), 0.5 * (np.diag(H, -1) - np.diag(H, 1))


# --- semidefinite blocks --------------------------------------------------------------------------------------


def _semidefinite_rows(Q: Array) -> tuple[Array, Pair, Pair]:
    """`reduce_block` of a block that may have a kernel, whose modes of frequency zero are told from rounding."""
    F, smallest = _factor(Q)
    sigma, left_vectors, right_vectors = skew_normal_form(poisson(exactly(F.T)))
    pairs, size = len(sigma), len(F)
    # A singular value at rounding level belongs to free momenta.  That level: rounding the scaled Q by eps moves F by
    # eps / sqrt(its smallest eigenvalue), in units in which the largest plane (q_i, p_i) sets the size of F^T J F.
    # No subspace of rank r has more than 2n - r directions that commute with all of it; for a definite Q that is none.
    amplitude = np.sqrt(np.abs(np.diag(Q)))
    plane = np.max(amplitude[: size // 2] * amplitude[size // 2 :], initial=0.0)
    noise = 8 * _checks.EPS * max(plane / np.sqrt(smallest), size * max(plane, sigma.max(initial=0.0)))
    zero = min(int(np.sum(sigma <= noise)), (size - F.shape[1]) // 2)
    planes = np.concatenate([left_vectors[:, zero:pairs], right_vectors[:, zero:pairs]], axis=1)
    still = np.concatenate(
        [left_vectors[:, :zero], right_vectors[:, :zero], left_vectors[:, pairs:], right_vectors[:, pairs:]], axis=1
    )
    d = sigma[zero:]
    root = np.sqrt(np.concatenate([d, d]))[:, None]
    rows = product(exactly(planes.T), exactly(F.T))
    S, excess = back_to_symplectic(np.concatenate([d, d]), divide(rows, (root, np.zeros_like(root))))
    # what the steps did to the length of the rows belongs to d: its Rayleigh quotient, free of the rounding of roots
    square, rest = two_prod(root[: len(d), 0], root[: len(d), 0])
    return square + (rest + square * excess), S, product(exactly(still.T), exactly(F.T))


def _factor(Q: Array) -> tuple[Array, float]:
    """Return `F` of full column rank with `F F^T = Q`: Cholesky if definite, else by eigenvectors.

    With it the smallest eigenvalue, of `Q` scaled to unit diagonal, that counts as more than zero.
    """
    scaled, scale = _definite.unit_diagonal(Q)
    smallest, tolerance = _definite.smallest_scaled_eigenvalue(Q)
    if smallest > tolerance:
        return scale[:, None] * np.linalg.cholesky(scaled), smallest
    _definite.refuse_indefinite("Q", smallest, tolerance)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > tolerance
    return scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]), float(np.min(values[kept], initial=1.0))

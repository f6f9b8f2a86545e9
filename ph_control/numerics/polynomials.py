"""Coefficients of a lossless transfer function, and the modes back from them.

`sum_l kappa_l s / (s^2 + x_l) = s N(s^2) / P(s^2)` with `x_l = d_l^2`.  Forwards every term is positive, so nothing
cancels; numbers are decimal where doubles would overflow.  Backwards the roots of `P` and the
residues there are computed with twice the digits: what remains is the rounding of the coefficients themselves.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from itertools import accumulate

import numpy as np

from .. import _checks
from .._frozen import Frozen
from .._types import Array, ComplexArray, NDArray

Exponents = NDArray[np.int64]
Decimals = NDArray[np.object_]

COEFFICIENT_LIMIT = 1e-4  # relative error of a frequency beyond which coefficients no longer tell it
# of products with more digits and exponents than doubles have
WIDE = Context(prec=30, Emax=MAX_EMAX, Emin=MIN_EMIN, traps=[])
_PLAIN = 1000  # binary exponents that doubles surely hold
_SMALLEST = -1074  # binary exponent of the smallest double
_ROOM = np.finfo(np.longdouble).maxexp - 24  # binary exponents up to which plain numbers are used


@dataclass(frozen=True, eq=False)
class ScaledCoefficients(Frozen):
    """Numbers `mantissa * 2**exponent`, none negative, beyond the range of doubles.

    Attributes
    ----------
    mantissa : ndarray, shape (N,)
        From 1/2 to 1, or 0.
    exponent : ndarray of int, shape (N,)
        Binary exponents; 0 where the mantissa is 0.

    Examples
    --------
    >>> import ph_control as phc
    >>> a, c = phc.modes([1e200, 2e200], [1.0, 1.0]).scaled_coefficients()
    >>> a.log10().round(1)
    array([800.6,  -inf, 400.7,  -inf])
    """

    mantissa: Array
    exponent: Exponents

    @classmethod
    def _of(cls, values: Decimals) -> ScaledCoefficients:
        near = [int(value.adjusted() * math.log2(10)) if value else 0 for value in values]
        mantissa, carry = np.frexp([float(value / Decimal(2) ** k) for value, k in zip(values, near, strict=True)])
        return cls(mantissa, np.array(near, np.int64) + carry)

    def log10(self) -> Array:
        """Decimal logarithms: what to plot, or to print.

        Returns
        -------
        ndarray, shape (N,)
            `-inf` for 0.

        Examples
        --------
        >>> import ph_control as phc
        >>> a, _ = phc.modes(1e100, 1.0).scaled_coefficients()
        >>> a.log10().round(9)
        array([200., -inf])
        """
        with np.errstate(divide="ignore"):
            return np.log10(self.mantissa) + self.exponent * np.log10(2.0)

    def to_doubles(self) -> Array:
        """Return the numbers as doubles.

        Returns
        -------
        ndarray, shape (N,)
            Infinite or 0 where a number leaves the range of doubles; `fit_doubles` tells whether any does.

        Examples
        --------
        >>> import ph_control as phc
        >>> a, c = phc.modes(2.0, 1.0).scaled_coefficients()
        >>> a.to_doubles(), c.to_doubles()
        (array([4., 0.]), array([2.]))
        """
        with np.errstate(over="ignore", under="ignore"):
            return np.ldexp(self.mantissa, np.clip(self.exponent, -5000, 5000).astype(np.int32))

    @property
    def fit_doubles(self) -> bool:
        """Whether doubles hold all of them with all their digits."""
        live = self.exponent[self.mantissa > 0]
        return bool(np.all((live > -1021) & (live <= 1024)))


def transfer_coefficients(x: Decimals, kappa: Decimals) -> tuple[ScaledCoefficients, ScaledCoefficients]:
    """`(a_0 .. a_{2n-1})`, odd ones 0, and `(c_1, c_3 .. c_{2n-1})` of `sum_l kappa_l s / (s^2 + x_l)`, none negative.

    Binary tree of sums `(P1 P2, N1 P2 + N2 P1)` of polynomials in `s^2`, in which all terms are positive: O(n^2).
    """
    with localcontext(WIDE):
        P, N = common_fraction(x, kappa)
        a = np.full(2 * len(x), Decimal(0))
        a[0::2] = P[:-1]
        return ScaledCoefficients._of(a), ScaledCoefficients._of(N[::-1])


def common_fraction(x: Decimals, kappa: Decimals) -> tuple[Decimals, Decimals]:
    """`P` and `N` of `sum_l kappa_l / (z + x_l) = N(z) / P(z)`, ascending, in the digits of the context."""
    sums = [(np.array([a, Decimal(1)]), np.array([b])) for a, b in zip(x, kappa, strict=True)]
    while len(sums) > 1:
        pairs = zip(sums[0::2], sums[1::2], strict=False)
        added = [(np.convolve(P, Q), np.convolve(N, Q) + np.convolve(M, P)) for (P, N), (Q, M) in pairs]
        sums = added + sums[2 * len(added) :]
    return sums[0] if sums else (np.array([Decimal(1)]), np.empty(0, object))


def plain_coefficients(d: Array, r: Array) -> tuple[Array, Array] | None:
    """As `transfer_coefficients`, in doubles, of modes `d` ascending; None where a number on the way may be too large.

    With `e` so small that its square is nothing, `P + i e N = prod (s^2 + x_l + i e kappa_l)`: a product of complex
    numbers, in whose real and imaginary parts all terms are positive still.
    """
    n = len(d)
    if n == 0:
        return None
    # bounds of binary logarithms: of the frequencies, of the largest weight, of all coefficients
    reach = max(abs(math.log2(d[0])), abs(math.log2(d[-1])))
    weight = math.log2(max(r.tolist()) or 1.0)
    largest = n * (2 * reach + 1)
    if largest > _PLAIN / 2:
        x = 2 * np.log2(d)
        largest = float(max(np.logaddexp2(0, x).sum(), -np.minimum(0, x).sum()))
    small = int(3 * reach + weight) + 40 + n.bit_length()
    # on the way, the smallest weight may be the smallest double beside the largest
    if largest + reach + abs(weight) + n.bit_length() + small > min(_PLAIN, _ROOM + _SMALLEST):
        return None
    wide, epsilon = d.astype(np.longdouble), 0.5**small
    factors = np.zeros(n + n % 2, np.clongdouble)
    factors.real[:n], factors.imag[:n] = wide * wide, wide * (r * epsilon)
    first, second = factors[0::2], factors[1::2]
    pairs = np.empty((len(first), 3), np.clongdouble)
    pairs[:, 0], pairs[:, 1], pairs[:, 2] = first * second, first + second, 1.0
    whole = functools.reduce(np.convolve, pairs)[n % 2 :]
    a = np.zeros(2 * n)
    a[0::2] = whole.real[:n]
    return a, whole.imag[n - 1 :: -1].astype(float) / epsilon


def decimals(values: Array) -> Decimals:
    """Numbers without bounds of their exponents."""
    return np.array([Decimal(value) for value in values.tolist()], object)


def cofactors(d: Array) -> Array:
    """Coefficients of `prod_{j != l} (x + d_j^2)`, ascending in x, one row for each l: shape (n, n).

    The polynomial of all modes but one, for each of them: products of what comes before it and of what comes after it,
    in which all terms are positive.
    """
    factors = [np.array([x, 1.0]) for x in np.asarray(d, float) ** 2]
    unit = np.ones(1)
    before = accumulate(factors[:-1], np.convolve, initial=unit)
    after = list(accumulate(factors[:0:-1], np.convolve, initial=unit))[::-1]
    rows = [np.convolve(low, high) for low, high in zip(before, after, strict=True)]
    return np.array(rows[: len(factors)]).reshape(len(factors), len(factors))


def companion_maps(d: Array) -> tuple[ComplexArray, ComplexArray]:
    """Maps `W` of states of a companion matrix to its modes, poles `lambda = -i d`, and `L`, shape (n, 2n) each.

    Rows of `W` are `sum_k b_k (lambda s_{2k+1} + s_{2k+2})` with the coefficients of the other modes' polynomial, rows
    of `L` are `lambda^{k-1} / (lambda prod_{j != l} (d_j^2 - d_l^2))`: residues of `s^{k-1}/P(s)`, twice.  States of
    the controllable form are `Re L^T w` of what is `w = W s`, those of the observable one `Re W^T w` of `w = L s`.
    """
    n, b = len(d), cofactors(d)
    W = np.empty((n, 2 * n), complex)
    W[:, 0::2], W[:, 1::2] = -1j * d[:, None] * b, b
    gaps = (d - d[:, None]) * (d + d[:, None])
    np.fill_diagonal(gaps, 1.0)
    # interleaved, so that powers and products do not leave the range of doubles one after the other
    with np.errstate(all="ignore"):
        ratio = (d[:, None] ** 2 / np.where(np.eye(n, dtype=bool), d**2, gaps)).prod(axis=1)
        sizes = ratio[:, None] * d[:, None] ** (np.arange(2 * n) - 1 - 2 * (n - 1))
    return W, sizes * np.resize([1j, 1.0, -1j, -1.0], 2 * n)


# --- how many digits coefficients carry, and the way back --------------------------------------------------------


def amplification(d: Array) -> Array:
    """Relative error of each frequency over that of the coefficients: `prod_{j != l} (d_l^2 + d_j^2)/|d_l^2 - d_j^2|`.

    Infinite for a repeated frequency.  Times `eps`, what a companion matrix or a transfer function in doubles can
    promise at best.
    """
    x, y = d[:, None], d
    with np.errstate(divide="ignore", over="ignore"):
        # sum and difference of squares in a form that neither cancels nor overflows
        larger, smaller = np.maximum(x, y), np.minimum(x, y)
        ratio = smaller / larger
        factors = np.log2(1 + ratio**2) - np.log2((larger - smaller) / larger) - np.log2(1 + ratio)
        np.fill_diagonal(factors, 0.0)
        return np.exp2(np.minimum(factors.sum(axis=1), 1e4))


def digits(d: Array) -> float:
    """Decimal digits of the frequencies that survive the rounding of the coefficients to doubles; at least 0."""
    worst = float(amplification(d).max(initial=1.0))
    return max(0.0, -float(np.log10(worst) + np.log10(_checks.EPS)))


def fractions_from_coefficients(a: Array, *numerators: Array) -> list[tuple[Array, Array]] | None:
    """Frequencies `d` of `P(s^2) = s^{2n} + sum a_k s^{2k}`, and `N(-d^2) / P'(-d^2)` of numerators, with their errors.

    Coefficients ascend, with `a > 0`.  The errors are what a relative error `eps` of every coefficient moves them by,
    to first order.  None if the roots of `P` are not n distinct negative numbers, or are not told apart by these
    errors.
    """
    n = len(a)
    unit = round(float(np.log2(a[0])) / (2 * n))
    with np.errstate(over="ignore", under="ignore"):
        scaled = np.ldexp(np.append(a, 1.0), -2 * unit * np.arange(n, -1, -1))
    if not (np.isfinite(scaled).all() and scaled.min() > 0):
        return None
    with localcontext(WIDE):
        y = _simple_positive_roots(scaled)
        if y is None:
            return None
        y, P, eps = y * Decimal(4) ** unit, decimals(np.append(1.0, a[::-1])), Decimal(_checks.EPS)
        slope, curvature = (np.polyval(np.polyder(P, order), -y) for order in (1, 2))
        error_y = eps * np.polyval(P, y) / np.abs(slope)
        fractions = [(np.sqrt(y), error_y / (2 * np.sqrt(y)))]
        for numerator in (decimals(c[::-1]) for c in numerators):
            value = np.polyval(numerator, -y) / slope
            moved = np.abs(np.polyval(np.polyder(numerator), -y)) + np.abs(value * curvature)
            rounding = np.polyval(np.abs(numerator), y) + np.abs(value) * np.polyval(np.polyder(P), y)
            fractions.append((value, (moved * error_y + eps * rounding) / np.abs(slope)))
        return [(values.astype(float), errors.astype(float)) for values, errors in fractions]


def _simple_positive_roots(P: Array) -> Decimals | None:
    """The n roots `-y` of a polynomial with positive coefficients, `y` ascending, if a change of sign shows each."""
    n = len(P) - 1
    start = np.sort(np.roots((P * (-1.0) ** np.arange(n + 1))[::-1]).real)
    if len(start) < n or start[0] <= 0:
        return None
    wide = decimals(P[::-1])
    slope, y = np.polyder(wide), decimals(np.maximum.accumulate(start * (1 + 1e-9 * np.arange(n))))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(60):
            newton, rounded = np.polyval(wide, -y) / np.polyval(slope, -y), y.astype(float)
            # the other roots repel (Ehrlich and Aberth), so that no two approximations run into one root
            gaps = rounded - rounded[:, None]
            np.fill_diagonal(gaps, np.inf)
            step = newton / decimals(1 + newton.astype(float) * np.sum(1 / gaps, axis=1))
            y = y + step
            rounded = y.astype(float)
            if not (np.isfinite(rounded).all() and rounded.min() > 0):
                return None
            if np.all(np.abs(step.astype(float)) <= 1e-20 * rounded):
                break
    y = np.sort(y)
    rounded, radius = y.astype(float), decimals(4 * _checks.EPS * y.astype(float))
    apart = np.diff(rounded) > 2 * (radius[1:] + radius[:-1]).astype(float)
    return y if apart.all() and np.all(np.polyval(wide, radius - y) * np.polyval(wide, -radius - y) < 0) else None

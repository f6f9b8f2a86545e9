"""Expansions of a lossless one-port `G(s) = kappa_0/s + sum_l kappa_l s/(s^2 + d_l^2)`: what its circuits are made of.

All of them begin with the measure with the weights `kappa` at the points `x = d^2`, and `kappa_0` at 0.  Its Jacobi
matrix comes from Lanczos vectors in decimal arithmetic: the digits are doubled until none of those that a double holds
changes, so that elements are right to their last digit however the modes lie.
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Context, Decimal, getcontext, localcontext
from itertools import pairwise

import numpy as np

from .._types import Array

_DIGITS = 50  # to begin with
_AGREED = Decimal("1e-18")  # relative change that no double shows
_MOST = 1 << 16  # digits; far beyond what any modes apart by a unit in the last place need
_WIDE = Context(Emax=10**9, Emin=-(10**9))

Measure = tuple[list[Decimal], list[Decimal]]  # points and weights


def continued_fraction(d: Array, r: Array, kappa_0: float) -> list[float]:
    """Coefficients a of `1/G = a_1 s + 1/(a_2 s + 1/(a_3 s + ..))`: 2n of them, with a pole at 0 one more."""
    return _settled(lambda: _stieltjes(*_measure(d, r, kappa_0), singular=kappa_0 > 0))


def continued_fraction_at_zero(d: Array, r: Array) -> list[float]:
    """The 2n coefficients b of `1/G = b_1/s + 1/(b_2/s + 1/(b_3/s + ..))` for `kappa_0 = 0`.

    With `1/s` in the place of `s` they are those of `continued_fraction`: frequencies `1/d`, residues `kappa/d^2`.
    """

    def expand() -> list[Decimal]:
        x, weights = _measure(d, r, 0.0)
        return _stieltjes([1 / p for p in x], [w / p for w, p in zip(weights, x, strict=True)], singular=False)

    return _settled(expand)


def reciprocal(d: Array, r: Array, kappa_0: float) -> tuple[float, float, list[tuple[float, float]]]:
    """Partial fractions of `1/G = a s + k_0/s + sum_l h_l s/(s^2 + w_l^2)`: `a`, `1/k_0` and pairs `(1/h, h/w^2)`.

    `1/k_0` is infinite where G has a pole at 0.
    """

    def expand() -> list[Decimal]:
        x, weights = _measure(d, r, kappa_0)
        flexibility = Decimal(0) if kappa_0 > 0 else sum((w / p for w, p in zip(weights, x, strict=True)), Decimal(0))
        coefficients = [1 / sum(weights, Decimal(0)), flexibility]
        order = sorted(range(len(x)), key=x.__getitem__)
        for low, high in pairwise(order):
            z, slope = _zero(x, weights, x[low], x[high])
            coefficients += [z * slope, 1 / (z * z * slope)]
        return coefficients

    a, flexibility, *pairs = _settled(expand)
    tanks = list(zip(pairs[::2], pairs[1::2], strict=True))
    return a, flexibility if kappa_0 == 0 else np.inf, tanks


def _measure(d: Array, r: Array, kappa_0: float) -> Measure:
    frequencies, weights = [Decimal(float(frequency)) for frequency in d], [Decimal(float(weight)) for weight in r]
    points = [frequency * frequency for frequency in frequencies]
    residues = [frequency * weight for frequency, weight in zip(frequencies, weights, strict=True)]
    at_zero = [Decimal(kappa_0)] if kappa_0 > 0 else []
    return [Decimal(0)] * len(at_zero) + points, at_zero + residues


def _settled(expand: Callable[[], list[Decimal]]) -> list[float]:
    """Positive values, computed with more and more digits until they stay the same."""
    digits, before = _DIGITS, None
    while digits <= _MOST:
        with localcontext(_WIDE) as context:
            context.prec = digits
            try:
                values = expand()
            except ArithmeticError:  # a divisor that vanished by cancellation
                values = [Decimal(-1)]
            positive = all(value >= 0 for value in values)
            if before is not None and positive:
                if all(abs(new - old) <= _AGREED * new for new, old in zip(values, before, strict=True)):
                    return [float(value) for value in values]
            before = values if positive else None
        digits *= 2
    raise AssertionError("decimal arithmetic did not settle")


def _stieltjes(x: list[Decimal], weights: list[Decimal], singular: bool) -> list[Decimal]:
    """Coefficients of the continued fraction of `G/s = sum w/(s^2 + x)`, by Lanczos vectors on the diagonal matrix x.

    The Jacobi matrix is factored as it arises: `alpha_j = q_j + e_{j-1}`, `beta_j = q_j e_j`.
    """
    n, total = len(x), sum(weights, Decimal(0))
    # vectors without scale: w_l v_l^2 is what a normalised vector would have as the square of its entry
    last, vector, norm, e = [Decimal(0)] * n, [Decimal(1)] * n, total, Decimal(0)
    beta, coefficients = Decimal(0), [1 / total]
    for j in range(n):
        squares = [w * v * v for w, v in zip(weights, vector, strict=True)]
        alpha = sum((p * square for p, square in zip(x, squares, strict=True)), Decimal(0)) / norm
        q = alpha - e
        if singular and j == n - 1:
            break
        coefficients.append(1 / (coefficients[-1] * q))
        if j == n - 1:
            break
        new = [(p - alpha) * v - beta * u for p, v, u in zip(x, vector, last, strict=True)]
        size = sum((w * v * v for w, v in zip(weights, new, strict=True)), Decimal(0))
        beta, last, vector, norm = size / norm, vector, new, size
        e = beta / q
        coefficients.append(1 / (coefficients[-1] * e))
    return coefficients


def _zero(x: list[Decimal], weights: list[Decimal], low: Decimal, high: Decimal) -> tuple[Decimal, Decimal]:
    """Root `z` of `f = sum w/(x - z)` between two neighbouring points, and the slope `sum w/(x - z)^2` there.

    Newton's rule on `f (z - low)(high - z)`, which is finite at both ends, within a bracket that is halved where the
    rule would leave it.
    """
    lower, upper, z = low, high, (low + high) / 2
    for _ in range(8 * getcontext().prec):
        inverse = [1 / (p - z) for p in x]
        terms = [w * factor for w, factor in zip(weights, inverse, strict=True)]
        value = sum(terms, Decimal(0))
        slope = sum((term * factor for term, factor in zip(terms, inverse, strict=True)), Decimal(0))
        # f rises from -inf to inf
        lower, upper = (z, upper) if value < 0 else (lower, z)
        product, change = (z - low) * (high - z), low + high - 2 * z
        tilt = slope * product + value * change
        new = z - value * product / tilt if tilt > 0 else lower
        if not lower < new < upper:
            new = (lower + upper) / 2
        # to the digits of the distances from both points
        if value == 0 or abs(new - z) <= Decimal("1e-22") * min(z - low, high - z):
            return z, slope
        z = new
    raise ArithmeticError("too few digits for the distance of a zero from a pole")

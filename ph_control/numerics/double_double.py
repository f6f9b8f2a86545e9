"""Error-free transformations: a number as the unevaluated sum of two doubles.

`(hi, lo)` carries about 106 bits.  Two places need them: the phase of a mode after many time steps,
and the frequency response near a transmission zero, where large terms cancel.
The algorithms are those of Dekker and Knuth; all work elementwise on arrays.  Products of matrices in which large
terms cancel have a few halves of the digits more.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._types import Array, ComplexArray

Pair = tuple[Array, Array]
Multiply = Callable[[Array, Array], Array]

_SPLITTER = 134217729.0  # 2^27 + 1


def two_sum(a: Array, b: Array) -> Pair:
    """Return `(s, e)` with `s = fl(a + b)` and `s + e = a + b` exactly."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def two_prod(a: Array, b: Array) -> Pair:
    """Return `(p, e)` with `p = fl(a b)` and `p + e = a b` exactly (short of over- and underflow)."""
    p = a * b
    a_hi, a_lo = _split(a)
    b_hi, b_lo = _split(b)
    return p, ((a_hi * b_hi - p) + a_hi * b_lo + a_lo * b_hi) + a_lo * b_lo


def _split(a: Array) -> Pair:
    c = _SPLITTER * a
    hi = c - (c - a)
    return hi, a - hi


def exactly(array: Array) -> Pair:
    """Pair of doubles as they are, for `product_parts`."""
    return array, np.zeros(())


def add(x: Pair, y: Pair) -> Pair:
    """Sum of two pairs."""
    s, e = two_sum(x[0], y[0])
    return two_sum(s, e + x[1] + y[1])


def multiply(x: Pair, y: Pair) -> Pair:
    """Product of two pairs."""
    p, e = two_prod(x[0], y[0])
    return two_sum(p, e + x[0] * y[1] + x[1] * y[0])


def divide(x: Pair, y: Pair) -> Pair:
    """Quotient of two pairs: long division, two digits of base 2^53."""
    q = x[0] / y[0]
    p, e = two_prod(q, y[0])
    rest = ((x[0] - p) - e + x[1]) - q * y[1]
    return two_sum(q, rest / y[0])


def total(x: Pair) -> Pair:
    """Sum of pairs along their first axis, halving it until one is left."""
    hi, lo = x
    if len(hi) == 0:
        return np.zeros(hi.shape[1:]), np.zeros(hi.shape[1:])
    while len(hi) > 1:
        half = len(hi) // 2
        top = add((hi[:half], lo[:half]), (hi[half : 2 * half], lo[half : 2 * half]))
        if len(hi) % 2:
            top[0][0], top[1][0] = add((top[0][0], top[1][0]), (hi[-1], lo[-1]))
        hi, lo = top
    return hi[0], lo[0]


def cis_multiples(step: Pair, k: Array) -> ComplexArray:
    """Return `exp(i k step)` for integers `k`, shape `step.shape + k.shape`.

    The phase `k * step` is formed without rounding, so the result is right to a few units in the
    last place however large `k` is; `k * hi` in doubles alone would lose `log2(k)` bits.
    """
    hi, lo = step[0][..., None], step[1][..., None]
    phase, rest = two_prod(hi, k)
    rest = rest + k * lo
    result: ComplexArray = np.exp(1j * phase)
    # to first order where the next one is below the rounding of 1
    result *= 1.0 + 1j * rest if np.abs(rest).max(initial=0.0) < 1e-8 else np.exp(1j * rest)
    return result


def product_parts(
    left_factor: Pair, right_factor: Pair, slices: int = 3, multiply: Multiply = np.matmul
) -> list[Array]:
    """Matrices, the largest first, whose sum is `left_factor @ right_factor` with more digits than a double has.

    Each operand is cut into slices of so few bits, relative to the largest entry of a row of the left one and of a
    column of the right one, that sums of products of two slices are exact.  All but the last of the matrices are such
    sums.  The last has the rest, and its rounding is the error: with 2 slices, at the cost of 3 ordinary products,
    2^-74 of those largest entries, with 3, at that of 6, 2^-95; with 1 it is that of an ordinary product.  `multiply`
    may use what is known of the operands, such as zeros.
    """
    if slices == 1:
        return [multiply(left_factor[0], right_factor[0])]
    bits = (53 - left_factor[0].shape[1].bit_length()) // 2
    (a, *others), (b, *more) = _sliced(left_factor, 1, bits, slices), _sliced(right_factor, 0, bits, slices)
    if slices == 2:
        return [multiply(a, b), multiply(a, more[0]) + multiply(others[0], right_factor[0])]
    middle = multiply(a, more[0]) + multiply(others[0], b)
    return [
        multiply(a, b), middle,
        multiply(a, more[1]) + multiply(others[0], more[0] + more[1]) + multiply(others[1], right_factor[0]),
    ]  # fmt: skip


def product(left_factor: Pair, right_factor: Pair, slices: int = 3, multiply: Multiply = np.matmul) -> Pair:
    """`left_factor @ right_factor` as one pair; cost and error as of `product_parts`."""
    high, *parts = product_parts(left_factor, right_factor, slices, multiply)
    low = np.zeros(())
    for part in parts:
        high, low = two_sum(high, part + low)
    return high, low if low.ndim else np.zeros_like(high)


def _sliced(pair: Pair, axis: int, bits: int, count: int) -> list[Array]:
    """Slices of `bits` bits, relative to the largest entry along an axis, and the rest."""
    rest, low = pair
    _, exponent = np.frexp(np.max(np.abs(rest), axis=axis, keepdims=True, initial=0.0))
    out = []
    for k in range(1, count):
        # adding and taking away a large number rounds to a multiple of its last place
        large = np.ldexp(0.75, exponent - k * bits + 53)
        out.append((rest + large) - large)
        rest = rest - out[-1]
    return [*out, rest + low if low.ndim else rest]

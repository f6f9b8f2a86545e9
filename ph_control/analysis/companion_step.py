"""One step of a companion matrix, in whole numbers of as many digits as it takes.

Powers and exponentials of the companion matrix `A` of a polynomial `P` are polynomials in `s` modulo `P`: the row i of
`f(A)` holds the coefficients of `s^i f(s) mod P`.  In doubles the large terms of these cancel to nothing from some 15
modes on.  Whole numbers, scaled by a power of two and in a unit of time in which no frequency exceeds 1, have the bits
that this takes, and repeated frequencies and poles at 0 are no exception.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from .._types import Array
from ..exceptions import StructureError
from ..numerics.polynomials import cofactors

Whole = NDArray[np.object_]

_MOST = 1e8  # products of whole numbers of 500 bits, half a minute of them
_TAYLOR = 4.0  # largest step of a Taylor series


class CompanionStep:
    """Step of `s' = A s + e_{2n} u`, or of its transpose with `s' = A^T s + c u`, for frequencies and residues.

    Parameters
    ----------
    d, kappa : ndarray, shape (n,)
        Frequencies, 0 among them, and residues, whose polynomials are `P` and `c`.
    h, method, intersample
        The rule of stepping.
    transposed : bool
        Whether to step the transpose.
    """

    def __init__(self, d: Array, kappa: Array, h: float, method: str, intersample: str, *, transposed: bool) -> None:
        self.n, self.transposed, self.rule = len(d), transposed, (h, method, intersample)
        self.size = size = 2 * self.n
        live = d[d > 0]
        self.unit = math.frexp(max(1.0 / h, float(live.max(initial=0.0))))[1]  # its binary logarithm
        self.d, theta = np.ldexp(d, -self.unit), Fraction(h) * Fraction(2) ** self.unit
        fine = -2.0 * float(np.log2(self.d[d > 0]).sum())
        guard = size * (3.0 + math.log2(1.0 + float(theta)) + math.log2(size + 1.0))
        self.bits = 128 + math.ceil(fine + guard)
        self._affordable(20.0)
        self.gain = math.frexp(float(kappa.max(initial=0.0)) or 1.0)[1]
        self.P, self.c = self._polynomials(np.ldexp(kappa, -self.gain))
        self.theta = self._whole(theta)
        polynomial, now, then = self._step(method, intersample)
        F = np.empty((size, size), object)
        for row in F:
            row[:] = polynomial
            polynomial = self._times_s(polynomial, self.P)
        self.F = F.T if transposed else F
        self.now, self.then = (self._column(g) for g in (now, then))

    def _affordable(self, steps: float) -> None:
        if steps * self.size**2 * (1.0 + self.bits / 500.0) ** 1.6 > _MOST:
            raise StructureError(
                f"states of a canonical form of {self.n} modes take {self.bits} bits to step without loss, which would "
                f"take too long for {steps:.0f} steps; take fewer, or those of ph(sys)"
            )

    # --- the matrices ------------------------------------------------------------------------------------------------

    def matrices(self) -> tuple[Array, Array, Array]:
        """`F`, `G_0` and `G_1` of `s_{k+1} = F s_k + G_0 u_k + G_1 u_{k+1}`, rounded to doubles."""
        units, drive = self._units(), self._drive()
        now, then = (self._doubles(g, units + drive) for g in (self.now, self.then))
        return self._doubles(self.F, units[:, None] - units), now, then

    def shifted(self) -> Array:
        """`G_0 + F G_1`: what drives the state `s_k - G_1 u_k`."""
        return self._doubles(self.now + (self.F.dot(self.then) >> self.bits), self._units() + self._drive())

    def digits(self) -> float:
        """Decimal digits of the frequencies that `F` carries once it is rounded to doubles; at least 0.

        By the first-order bound of its eigenvalues.  A pole at 0 is not counted.
        """
        live = self.d > 0
        if not live.any():
            return -math.log10(_checks.EPS)
        # in a unit of time in which the frequencies are about 1
        middle = round(float(np.log2(self.d[live]).mean()))
        d, power = np.ldexp(self.d, -middle), -middle * np.arange(self.size)
        F = np.abs(self._doubles(self.F.T if self.transposed else self.F, power[:, None] - power))
        turn = np.ldexp(self.d, self.unit) * self.rule[0]
        slope = turn / (1.0 + (turn / 2) ** 2) if self.rule[1] == "midpoint" else turn
        x, y, b = d[:, None], d, cofactors(d)
        right, left = x ** np.arange(self.size), np.stack([x * b, b], axis=2).reshape(self.n, self.size)
        gaps = np.abs((x - y) * (x + y))
        np.fill_diagonal(gaps, 2.0 * d)
        with np.errstate(all="ignore"):
            moved = np.sum((left @ F) * right, axis=1) / gaps.prod(axis=1) / slope
        worst = float(np.nan_to_num(moved[live], nan=np.inf).max())
        return max(0.0, -math.log10(0.5 * _checks.EPS * max(1.0, worst))) if worst < np.inf else 0.0

    # --- motion ------------------------------------------------------------------------------------------------------

    def states(self, u: Array, start: Array | None) -> Array:
        """States (2n, T) for input samples (T,), from a start or, without one, from that after a unit impulse."""
        self._affordable(float(len(u)))
        units, drive = self._units(), self._drive()
        # in one fixed point, that of the smallest of what is in the input and the start
        at = units[:0] if start is None else np.frexp(start)[1][start != 0] - units[start != 0]
        shift = int(np.min(at, initial=drive + np.frexp(np.abs(u).max())[1] * bool(u.any())))
        force = self._wholes(u, drive - shift)
        state = self._column(self._one()) if start is None else self._wholes(start, -units - shift)
        state = state << max(0, drive - shift) if start is None else state
        step = np.column_stack([self.F, self.now, self.then])
        states = np.empty((len(u), self.size), object)
        states[0] = state
        for k in range(len(u) - 1):
            states[k + 1] = step.dot(np.concatenate([states[k], force[k : k + 2]])) >> self.bits
        return self._doubles(states.T, np.broadcast_to((units + shift)[:, None], (self.size, len(u))))

    # --- polynomials modulo P ----------------------------------------------------------------------------------------

    def _step(self, method: str, intersample: str) -> tuple[Whole, Whole, Whole]:
        """Polynomials of the step of the state, and of what an input does at the start and at the end of it."""
        one, none = self._one(), 0 * self._one()
        if method == "exact":
            # the exponential modulo s^2 P, less its first two terms, is s^2 times the second integral
            late = self._exponential()[2:]
            whole = self._times_s(late, self.P) + self._scaled(one, self.theta)
            step = self._times_s(whole, self.P) + one
            ramp = (late << self.bits) // self.theta
            return step, whole - ramp if intersample == "foh" else whole, ramp if intersample == "foh" else none
        if method == "euler":
            return one + self._scaled(self._times_s(one, self.P), self.theta), self._scaled(one, self.theta), none
        # 1/(z - s) = (P(z) - P(s))/(z - s) / P(z) with z = 2/theta; all terms are positive
        z = (2 << 2 * self.bits) // self.theta
        quotient, term = none.copy(), 1 << self.bits
        for j in range(self.size - 1, -1, -1):
            quotient[j] = term
            term = self.P[j] + ((z * term) >> self.bits)
        inverse = self._scaled(quotient, (z << self.bits) // term)
        gain = self._scaled(inverse, self.theta)
        half = gain >> 1
        return 2 * inverse - one, half if intersample == "foh" else gain, half if intersample == "foh" else none

    def _exponential(self) -> Whole:
        """`exp(theta s)` modulo `s^2 P`: Taylor series of a part of the step, then squared."""
        modulus = np.concatenate([np.zeros(2, int).astype(object), self.P])
        halvings = max(0, math.ceil(math.log2(self.theta / 2**self.bits / _TAYLOR)))
        part = self.theta >> halvings
        term = np.concatenate([self._one(), np.zeros(2, int).astype(object)])
        total, k = term.copy(), 1
        while max(map(abs, term)) > 1:
            term = (self._times_s(term, modulus) * part >> self.bits) // k
            total, k = total + term, k + 1
        for _ in range(halvings):
            total = self._product(total, total, modulus)
        return total

    def _times_s(self, f: Whole, modulus: Whole) -> Whole:
        shifted: Whole = np.concatenate([np.zeros(1, int).astype(object), f[:-1]])
        return shifted - (f[-1] * modulus >> self.bits)

    def _product(self, f: Whole, g: Whole, modulus: Whole) -> Whole:
        size = len(modulus)
        product = np.zeros(2 * size - 1, int).astype(object)
        for k in range(size):
            product[k : k + size] += f[k] * g
        product >>= self.bits
        for k in range(2 * size - 2, size - 1, -1):
            product[k - size : k] -= product[k] * modulus >> self.bits
        return product[:size]

    def _column(self, f: Whole) -> Whole:
        """`f(A) e_{2n}`, or `f(A^T) c`."""
        if self.transposed:
            return self._product(self.c, f, self.P)
        column = np.empty(self.size, object)
        for k in range(self.size):
            column[k] = f[-1]
            f = self._times_s(f, self.P)
        return column

    def _polynomials(self, kappa: Array) -> tuple[Whole, Whole]:
        """Coefficients of `P` but the first, 1, and of `c`, ascending; every other one is 0."""
        bits = self.bits
        even, odd = [1 << bits], [0]
        for x, weight in zip(self.d, kappa, strict=True):
            square, part = self._whole(Fraction(x) ** 2), self._whole(Fraction(weight))
            grown = [(b * square + p * part) >> bits for b, p in zip([*odd, 0], [*even, 0], strict=True)]
            odd = [low + up for low, up in zip(grown, [0, *odd], strict=False)]
            even = [((p * square) >> bits) + up for p, up in zip([*even, 0], [0, *even], strict=True)]
        P, c = np.zeros(self.size, int).astype(object), np.zeros(self.size, int).astype(object)
        P[0::2], c[1::2] = even[:-1], odd[: self.n]
        return P, c

    # --- whole numbers -----------------------------------------------------------------------------------------------

    def _units(self) -> NDArray[np.int64]:
        """Binary exponents of the states over those in scaled time."""
        power = self.unit * np.arange(self.size)
        return -power if self.transposed else power

    def _drive(self) -> int:
        """Binary exponent of what an input does to the states in scaled time."""
        return self.gain + self.unit * (self.size - 2) if self.transposed else -self.unit * self.size

    def _one(self) -> Whole:
        one = np.zeros(self.size, int).astype(object)
        one[0] = 1 << self.bits
        return one

    def _scaled(self, f: Whole, factor: int) -> Whole:
        return f * factor >> self.bits

    def _whole(self, value: Fraction) -> int:
        return (value.numerator << self.bits) // value.denominator

    def _wholes(self, values: Array, exponents: Any) -> Whole:
        out = np.zeros(len(values), object)
        powers = np.broadcast_to(exponents, values.shape).tolist()
        for k, (value, exponent) in enumerate(zip(values.tolist(), powers, strict=True)):
            numerator, denominator = value.as_integer_ratio()
            places = self.bits + exponent - denominator.bit_length() + 1
            out[k] = numerator << places if places >= 0 else numerator >> -places
        return out

    def _doubles(self, values: Whole, exponents: Any) -> Array:
        return np.array(
            [_double(v, e - self.bits) for v, e in zip(values.flat, np.ravel(exponents).tolist(), strict=True)]
        ).reshape(values.shape)


def _double(value: int, exponent: int) -> float:
    """`value 2^exponent`, infinite beyond the range of doubles."""
    spare = max(0, value.bit_length() - 64)
    try:
        return math.ldexp(float(value >> spare), exponent + spare)
    except OverflowError:
        return math.copysign(math.inf, value)

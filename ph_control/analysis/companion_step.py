"""One step of a companion matrix, in decimal numbers of as many digits as it takes.

Powers and exponentials of the companion matrix `A` of a polynomial `P` are polynomials in `s` modulo `P`: the row i of
`f(A)` holds the coefficients of `s^i f(s) mod P`.  In doubles the large terms of these cancel to nothing from some 15
modes on.  Numbers of enough digits, in a unit of time in which no frequency exceeds 1, survive this, and repeated
frequencies and poles at 0 are no exception.
"""

from __future__ import annotations

import math
from decimal import Context, Decimal, localcontext
from typing import Any

import numpy as np

from .. import _checks
from .._types import Array
from ..exceptions import StructureError
from ..numerics.polynomials import Decimals, cofactors, common_fraction, decimals

_MOST = 1e8  # products of numbers of 500 bits, a minute of them
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
        self.d, self.h, self.method, self.transposed, self.size = d, h, method, transposed, 2 * len(d)
        unit = math.frexp(max(1.0 / h, float(d.max(initial=0.0))))[1]  # binary logarithm of that of frequencies
        scaled, theta = np.ldexp(d, -unit), math.ldexp(h, unit)
        fine = -2.0 * float(np.log2(scaled[d > 0]).sum())
        self.bits = 128 + math.ceil(fine + self.size * (3.0 + math.log2(1.0 + theta) + math.log2(self.size + 1.0)))
        self._affordable(20.0)
        self.context = Context(prec=math.ceil(self.bits * math.log10(2.0)))
        with localcontext(self.context):
            even, odd = common_fraction(decimals(scaled) ** 2, decimals(kappa))
            # every other coefficient is 0
            self.P, self.c = np.full((2, self.size), Decimal(0))
            self.P[0::2], self.c[1::2] = even[:-1], odd
            self.theta = Decimal(theta)
            polynomial, now, then = self._step(method, intersample)
            rows = []
            for _ in range(self.size):
                rows.append(polynomial)
                polynomial = _times_s(polynomial, self.P)
            F = np.array(rows, object).reshape(self.size, self.size)
            # back in the unit of time of the frequencies
            power = _power_of_two(-unit if transposed else unit, self.size)
            self.F = (F.T if transposed else F) * power[:, None] / power
            gain = power * Decimal(2) ** (unit * (self.size - 2) if transposed else -unit * self.size)
            self.now, self.then, self.struck = (gain * self._column(f) for f in (now, then, _constant(1, self.size)))

    def _affordable(self, steps: float) -> None:
        if steps * self.size**2 * (1.0 + self.bits / 500.0) ** 1.6 > _MOST:
            raise StructureError(
                f"states of a canonical form of {self.size // 2} modes take {self.bits} bits to step without loss, "
                f"which would take too long for {steps:.0f} steps; take fewer, or those of ph(sys)"
            )

    # --- the matrices ------------------------------------------------------------------------------------------------

    def matrices(self) -> tuple[Array, Array, Array]:
        """`F`, `G_0` and `G_1` of `s_{k+1} = F s_k + G_0 u_k + G_1 u_{k+1}`, rounded to doubles."""
        return self.F.astype(float), self.now.astype(float), self.then.astype(float)

    def shifted(self) -> Array:
        """`G_0 + F G_1`: what drives the state `s_k - G_1 u_k`."""
        with localcontext(self.context):
            return (self.now + self.F @ self.then).astype(float)

    def digits(self) -> float:
        """Decimal digits of the frequencies that `F` carries once it is rounded to doubles; at least 0.

        By the first-order bound of its eigenvalues.  A pole at 0 is not counted.
        """
        live = self.d > 0
        if not live.any():
            return -math.log10(_checks.EPS)
        # in a unit of time in which the frequencies are about 1
        middle = round(float(np.log2(self.d[live]).mean()))
        with localcontext(self.context):
            power = _power_of_two(middle, self.size)
            F = np.abs(((self.F.T if self.transposed else self.F) * power / power[:, None]).astype(float))
        d, turn = np.ldexp(self.d, -middle), self.d * self.h
        slope = turn / (1.0 + (turn / 2) ** 2) if self.method == "midpoint" else turn
        x, y, b = d[:, None], d, cofactors(d)
        columns, rows = x ** np.arange(self.size), np.stack([x * b, b], axis=2).reshape(len(d), self.size)
        gaps = np.abs((x - y) * (x + y))
        np.fill_diagonal(gaps, 2.0 * d)
        with np.errstate(all="ignore"):
            moved = np.sum((rows @ F) * columns, axis=1) / gaps.prod(axis=1) / slope
        worst = float(np.nan_to_num(moved[live], nan=np.inf).max())
        return max(0.0, -math.log10(0.5 * _checks.EPS * max(1.0, worst))) if worst < np.inf else 0.0

    # --- motion ------------------------------------------------------------------------------------------------------

    def states(self, u: Array, start: Array | None) -> Array:
        """States (2n, T) for input samples (T,), from a start or, without one, from that after a unit impulse."""
        self._affordable(float(len(u)))
        force = decimals(u)
        states = np.empty((len(u), self.size), object)
        states[0] = self.struck if start is None else decimals(start)
        with localcontext(self.context):
            step = np.column_stack([self.F, self.now, self.then])
            for k in range(len(u) - 1):
                states[k + 1] = step @ np.concatenate([states[k], force[k : k + 2]])
        return states.T.astype(float)

    # --- polynomials modulo P ----------------------------------------------------------------------------------------

    def _step(self, method: str, intersample: str) -> tuple[Decimals, Decimals, Decimals]:
        """Polynomials of the step of the state, and of what an input does at the start and at the end of it."""
        unit, none, theta = _constant(1, self.size), _constant(0, self.size), self.theta
        if method == "exact":
            # the exponential modulo s^2 P, less its first two terms, is s^2 times the second integral
            late = self._exponential()[2:]
            whole = _times_s(late, self.P) + theta * unit
            step, ramp = _times_s(whole, self.P) + unit, late / theta
            return (step, whole - ramp, ramp) if intersample == "foh" else (step, whole, none)
        if method == "euler":
            return unit + theta * _times_s(unit, self.P), theta * unit, none
        # 1/(z - s) = (P(z) - P(s))/(z - s) / P(z) with z = 2/theta; all terms are positive
        z, quotient, term = 2 / theta, none.copy(), Decimal(1)
        for j in range(self.size - 1, -1, -1):
            quotient[j] = term
            term = self.P[j] + z * term
        inverse = quotient * (z / term)
        gain = theta * inverse
        return (2 * inverse - unit, *((gain / 2, gain / 2) if intersample == "foh" else (gain, none)))

    def _exponential(self) -> Decimals:
        """`exp(theta s)` modulo `s^2 P`: Taylor series of a part of the step, then squared."""
        modulus = np.concatenate([_constant(0, 2), self.P])
        halvings = max(0, math.ceil(math.log2(self.theta / Decimal(_TAYLOR))))
        part, least = self.theta / 2**halvings, Decimal(2) ** -self.bits
        term = total = _constant(1, len(modulus))
        k = 1
        while np.abs(term).max() > least:
            term = _times_s(term, modulus) * (part / k)
            total, k = total + term, k + 1
        for _ in range(halvings):
            total = _product(total, total, modulus)
        return total

    def _column(self, f: Decimals) -> Decimals:
        """`f(A) e_{2n}`, or `f(A^T) c`."""
        if self.transposed:
            return _product(self.c, f, self.P)
        column = np.empty(self.size, object)
        for k in range(self.size):
            column[k] = f[-1]
            f = _times_s(f, self.P)
        return column


def _times_s(f: Decimals, modulus: Decimals) -> Decimals:
    shifted: Decimals = np.roll(f, 1)
    shifted[0] = Decimal(0)
    return shifted - f[-1] * modulus


def _product(f: Decimals, g: Decimals, modulus: Decimals) -> Decimals:
    size = len(modulus)
    product = np.convolve(f, g)
    for k in range(2 * size - 2, size - 1, -1):
        product[k - size : k] -= product[k] * modulus
    return product[:size]


def _constant(value: int, size: int) -> Decimals:
    """Polynomial of degree 0, with so many coefficients."""
    return np.array([Decimal(value), *[Decimal(0)] * (size - 1)], object)


def _power_of_two(unit: int, size: int) -> Any:
    return np.array([Decimal(2) ** (unit * k) for k in range(size)], object)

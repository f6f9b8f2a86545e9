"""The response of one port on the imaginary axis, `G(i w)/i`: a real function that rises between its poles.

Foster's reactance `X(w) = sum_l kappa_l w / (d_l^2 - w^2)` is a sum whose terms cancel next to its zeros.  There a
zero `w_0` helps: `X(w) = w (w^2 - w_0^2) sum_l kappa_l / ((d_l^2 - w^2) (d_l^2 - w_0^2))`, between two poles a sum of
positive terms.  Zeros are kept as pairs of doubles, so that `w - w_0` has all its digits too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from .._types import Array, Indices
from ..numerics import double_double as tf
from .zeros import zeros_in_gaps

_BLOCK = 1 << 15  # entries of a (mode x frequency) table that stays in a cache
_RUN = 256  # rows added up by one product of matrices, so that rounding errors grow no further
_CANCELLED = 32  # sum of sizes over the size of the sum, beyond which it is formed with the help of a zero
_MODERATE = 1e60  # frequencies up to which, and from whose reciprocal on, products of four stay in the range of doubles


class Reactance:
    """`X(w)` of the modes `d > 0`, ascending, with `r > 0`, and of a pole at 0 with the residue `kappa_0 >= 0`."""

    def __init__(self, d: Array, r: Array, kappa_0: float) -> None:
        # residues with twice the digits, in a unit that leaves them, and products with them, in the range of doubles
        factors = d, r
        if kappa_0 > 0:
            factors, d = (np.append(kappa_0, d), np.append(1.0, r)), np.append(0.0, d)
        (d_mantissa, p), (r_mantissa, q) = (np.frexp(factor) for factor in factors)
        unit = int((p + q).max(initial=0)) - 2
        high, low = (np.ldexp(part, p + q - unit) for part in tf.two_prod(d_mantissa, r_mantissa))
        self._gain, self._d, self._kappa = math.ldexp(1.0, unit), d, (high, low)
        ones = np.ones_like(d)
        # tables of `d - w` and `d + w` come as products of matrices, each entry of which is rounded once
        self._columns = np.stack([d, -ones], axis=1), np.stack([d, ones], axis=1)
        first = np.flatnonzero(np.diff(d, prepend=-1.0))
        self._poles = d[first]
        self._weights = np.add.reduceat(self._kappa[0], first) if len(first) else d
        positive = d[d > 0]
        heaviest = self._weights.max(initial=0.0)
        self._ordinary = not len(positive) or bool(
            1 / _MODERATE < positive[0] and positive[-1] < _MODERATE and self._weights.min() > heaviest / _MODERATE**2
        )
        # those between the poles, as soon as they are needed
        self._zeros = np.full((2, max(0, len(first) - 1)), np.nan)

    def __call__(self, w: Array) -> Array:
        """Values at the frequencies `w`, shape (N,); not finite at a pole."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return self._gain * (self._sum(w) if self._moderate(w) else self._sum_of_any_size(w))

    def _moderate(self, w: Array) -> bool:
        """Whether `(d - w)(d + w)` and products of two such stay in the range of doubles."""
        largest = max(float(w.max(initial=0.0)), -float(w.min(initial=0.0)))
        if not len(self._d) or self._d[0] > 0:
            return self._ordinary and largest < _MODERATE
        # at the pole itself nothing is lost
        smallest = float(np.abs(w[w != 0]).min(initial=1.0))
        return self._ordinary and 1 / _MODERATE < smallest and largest < _MODERATE

    def _sum(self, w: Array) -> Array:
        value, size = np.empty((2, len(w)))
        for part, table in self._blocks(w):
            value[part] = _weighted_sum(self._kappa[0], table)
            size[part] = _weighted_sum(self._kappa[0], np.abs(table, out=table))
        cancelled = np.flatnonzero(size > _CANCELLED * np.abs(value))
        value *= w
        if len(cancelled):
            value[cancelled] = self._beside_a_zero(w[cancelled])
        return value

    def _blocks(self, w: Array) -> Iterator[tuple[slice, Array]]:
        """Tables of `1/((d - w)(d + w))`, one row for each mode."""
        for part, down, up in self._tables(w):
            down *= up
            yield part, np.divide(1.0, down, out=down)

    def _tables(self, w: Array) -> Iterator[tuple[slice, Array, Array]]:
        """Tables of `d - w` and `d + w`, one row for each mode."""
        n = len(self._d)
        step = max(32, _BLOCK // max(1, n))
        rows, room = np.empty((2, len(w))), np.empty((2, n * min(step, len(w))))
        rows[0], rows[1] = 1.0, w
        for start in range(0, len(w), step):
            part = slice(start, start + step)
            count = min(step, len(w) - start)
            down, up = (space[: n * count].reshape(n, count) for space in room)
            np.dot(self._columns[0], rows[:, part], out=down)
            np.dot(self._columns[1], rows[:, part], out=up)
            yield part, down, up

    def _beside_a_zero(self, w: Array) -> Array:
        x = np.abs(w)
        high, low = self._zeros_between(np.searchsorted(self._poles, x) - 1)
        value, d = np.empty_like(x), self._d[:, None]
        for part, table in self._blocks(x):
            table /= ((d - high[part]) - low[part]) * (d + high[part])
            value[part] = _weighted_sum(self._kappa[0], table)
        value *= w * ((x - high) - low) * (x + high)
        return value

    def _zeros_between(self, gaps: Indices) -> Array:
        """Zeros above the poles with these indices, as pairs of doubles, shape (2, N)."""
        zeros = self._zeros[:, gaps]
        unknown = np.isnan(zeros[0])
        if not unknown.any():
            return zeros
        new, step = np.unique(gaps[unknown]), max(1, _BLOCK // len(self._d))
        for start in range(0, len(new), step):
            part = new[start : start + step]
            self._zeros[:, part] = self._refined(zeros_in_gaps(self._poles, self._weights, part))
        return self._zeros[:, gaps]

    def _refined(self, zero: tf.Pair) -> tf.Pair:
        """Zeros after a step of Newton's rule with twice the digits."""
        (high, low), d = zero, self._d[:, None]
        product = tf.multiply(*(tf.add(tf.two_sum(d, sign * high), (sign * low, 0.0 * low)) for sign in (-1.0, 1.0)))
        value = tf.total(tf.divide((self._kappa[0][:, None], self._kappa[1][:, None]), product))[0]
        slope = 2 * high * _weighted_sum(self._kappa[0], 1 / product[0] ** 2)
        step = value / slope
        return tf.two_sum(high, low - np.where(np.isfinite(step), step, 0.0))

    def _sum_of_any_size(self, w: Array) -> Array:
        """The same where `(d - w)(d + w)` may leave the range of doubles; slower."""
        value, size = np.empty((2, len(w)))
        ones = np.ones(len(self._d))
        for part, down, up in self._tables(w):
            terms = self._kappa[0][:, None] * (w[part] / up) / down
            value[part], size[part] = _weighted_sum(ones, terms), _weighted_sum(ones, np.abs(terms))
        cancelled = size > _CANCELLED * np.abs(value)
        d, high, low = (x[:, None] for x in (self._d, *self._kappa))
        value[cancelled] = sum_with_twice_the_digits(d, (high, low), w[cancelled])
        return value


def _weighted_sum(weights: Array, rows: Array) -> Array:
    """`weights @ rows`, in runs."""
    runs = len(weights) // _RUN
    whole = runs * _RUN
    total: Array = weights[whole:] @ rows[whole:]
    if runs:
        total += np.matmul(weights[:whole].reshape(runs, 1, _RUN), rows[:whole].reshape(runs, _RUN, -1)).sum(axis=0)[0]
    return total


def sum_with_twice_the_digits(d: Array, kappa: tf.Pair, w: Array) -> Array:
    """`sum_l kappa_l w / (d_l^2 - w^2)` in pairs of doubles, at a pole without its term.

    `d` and the pair `kappa` have one row for each mode, and a column for each of the N frequencies `w`, or one for all.
    """
    total = np.empty(len(w))
    step = max(32, _BLOCK // max(1, len(d)))
    for start in range(0, len(w), step):
        part = slice(start, start + step)
        frequency, high, low = (v if v.shape[1] == 1 else v[:, part] for v in (d, *kappa))
        x = w[part], np.zeros_like(w[part])
        away = np.where(np.abs(x[0]) == frequency, 0.0, x[0])
        up, down = tf.two_sum(frequency, away), tf.two_sum(frequency, -away)
        value = tf.total(tf.divide(tf.multiply((high, low), tf.divide(x, up)), down))
        total[part] = value[0] + value[1]
    return total

"""State spaces of transfer functions, and transfer functions of state spaces, in any units of time and gain.

Coefficients of degree 12 in nanoseconds range over a hundred decades, and the tolerances of the routines for such
conversions are numbers.  So time and gain are scaled by powers of two, which round nothing, before anything is done.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import control as ct
import numpy as np
import scipy.signal
from scipy.linalg import block_diag

from .. import _checks
from .._types import Array, ComplexArray
from ..exceptions import StructureError
from .invariant_subspaces import balanced, equilibrated

LinearSystem: TypeAlias = ct.StateSpace | ct.TransferFunction | scipy.signal.lti
Table = list[list[Array]]

_SAME = 4  # roundings of each coefficient that denominators of one column may differ by, and be one


def state_space(sys: ct.StateSpace | ct.TransferFunction) -> ct.StateSpace:
    """Controllable companion forms of the columns of a transfer function, or observable ones of its rows, balanced.

    Parameters
    ----------
    sys : control.StateSpace or control.TransferFunction
        A state space is returned as it is.

    Returns
    -------
    control.StateSpace
        With the names of `sys`.  Entries of `A` and `C` are coefficients over the leading one, but for powers of two;
        what cancels is not left out.  The form has as many states as the columns, or the rows, need one by one.

    Raises
    ------
    StructureError
        If an entry is improper, or its coefficients leave the range of doubles.
    """
    if isinstance(sys, ct.StateSpace):
        return sys
    num, den = _tables(sys)
    for b, a in (pair for rows in zip(num, den, strict=True) for pair in zip(*rows, strict=True)):
        if len(b) > len(a):
            raise StructureError(
                f"the transfer function is improper: numerator of degree {len(b) - 1} over degree {len(a) - 1}; it has "
                "no state space"
            )
    return _realized(sys, num, den)


def split_infinity(sys: ct.TransferFunction) -> tuple[ct.StateSpace, Array]:
    """State space of `G(s) - s L`, and `L`: 0 of a proper `G`, not finite where the pole at infinity is not simple."""
    num, den = _tables(sys)
    L = np.zeros((len(num), len(num[0])))
    for i, rows in enumerate(zip(num, den, strict=True)):
        for j, (b, a) in enumerate(zip(*rows, strict=True)):
            if len(b) <= len(a):
                continue
            L[i, j] = b[0] / a[0] if len(b) == len(a) + 1 else np.nan
            carried = L[i, j] * np.append(a[1:], 0.0)
            rest = b[1:] - carried
            lost = np.abs(rest) <= _SAME * _checks.EPS * (np.abs(b[1:]) + np.abs(carried))
            num[i][j] = np.where(lost, 0.0, rest) if np.isfinite(L[i, j]) else np.zeros(1)
    return _realized(sys, num, den), L


def _tables(sys: ct.TransferFunction) -> tuple[Table, Table]:
    """Numerators and denominators."""
    num, den = (
        [[_checks.real_array(name, polynomial, 1) for polynomial in row] for row in table]
        for name, table in (("the numerator", sys.num_list), ("the denominator", sys.den_list))
    )
    return num, den


def _realized(sys: ct.TransferFunction, num: Table, den: Table) -> ct.StateSpace:
    unit = _binary_rate(num, den)
    by_columns = _blocks(num, den, unit)
    by_rows = _blocks(_transposed(num), _transposed(den), unit)
    if len(by_columns[0]) <= len(by_rows[0]):
        A, B, C, D = by_columns
    else:
        A, C, B, D = (matrix.T for matrix in by_rows)
    A, B, C = balanced(A, B, C)
    gain = unit + sum(_exponent(part) for part in (B, C)) if len(A) else 0
    B, C = (np.ldexp(part, -_exponent(part) + share) for part, share in ((B, gain // 2), (C, gain - gain // 2)))
    A = np.ldexp(A, unit)
    _checks.representable("the state space of the transfer function", A, B, C, D)
    realization = ct.StateSpace(A, B, C, D, sys.dt, inputs=sys.input_labels, outputs=sys.output_labels)
    if not sys._generic_name_check():
        realization.name = sys.name
    return realization


def transfer_function(sys: ct.StateSpace, **names: Any) -> ct.TransferFunction:
    """Transfer function of a state space by `control.ss2tf`, in units in which `A`, `B` and `C` are of size 1.

    Parameters
    ----------
    sys : control.StateSpace
        Any.
    **names
        `name`, `inputs`, `outputs` of the transfer function; those of signals are kept.

    Raises
    ------
    StructureError
        If a coefficient leaves the range of doubles.
    """
    A, B, C, D = (np.array(getattr(sys, name), float) for name in "ABCD")
    A, B, C = equilibrated(A, B, C)
    rate, into, out = (_exponent(matrix) for matrix in (A, B, C))
    rate = 0 if sys.isdtime(strict=True) else rate
    gain = into + out - rate
    scaled = ct.StateSpace(np.ldexp(A, -rate), np.ldexp(B, -into), np.ldexp(C, -out), np.ldexp(D, -gain), sys.dt)
    converted = ct.ss2tf(scaled)
    num, den = (
        [[np.trim_zeros(p, "f") for p in row] for row in table] for table in (converted.num_list, converted.den_list)
    )
    with np.errstate(over="ignore", under="ignore"):
        num, den = (
            [
                [_in_units(p, len(a) - len(p), rate, power) for p, a in zip(row, under, strict=True)]
                for row, under in zip(table, den, strict=True)
            ]
            for table, power in ((num, gain), (den, 0))
        )
    coefficients = (p for table in (num, den) for row in table for p in row)
    _checks.representable("the coefficients of the transfer function", *coefficients)
    for kind, labels in (("inputs", sys.input_labels), ("outputs", sys.output_labels)):
        if names.get(kind) is None and names.get(kind[:-1]) is None:
            names[kind] = labels
    return ct.TransferFunction(num, den, sys.dt, **names)


def poles(sys: ct.StateSpace | ct.TransferFunction) -> ComplexArray:
    """Poles of a state space, or roots of the denominators of a transfer function, those of equal ones once."""
    if isinstance(sys, ct.StateSpace):
        return np.asarray(sys.poles(), complex)
    different: list[Array] = []
    for polynomial in (p for row in sys.den_list for p in row):
        if not any(_is_same(known / known[0], polynomial) for known in different):
            different.append(polynomial)
    return np.concatenate([np.roots(polynomial).astype(complex) for polynomial in different])


def _in_units(polynomial: Array, below: int, rate: int, gain: int) -> Array:
    """A polynomial in `s / 2**rate`, of a degree that is so much below that of the denominator, as one in `s`."""
    if not len(polynomial):
        return np.zeros(1)
    return np.asarray(np.ldexp(polynomial, rate * (np.arange(len(polynomial)) + below) + gain), float)


def _exponent(M: Array) -> int:
    """Power of 2 next to the size of a matrix."""
    size = float(np.linalg.norm(M))
    return round(float(np.log2(size))) if 0 < size < np.inf else 0


def _transposed(table: Table) -> Table:
    return [list(column) for column in zip(*table, strict=True)]


def _binary_rate(num: Table, den: Table) -> int:
    """Power of 2 next to the median of what roots are in size, those of denominators if any is not 0."""
    for table in (den, num):
        sizes = []
        for polynomial in (p for row in table for p in row):
            live = np.flatnonzero(polynomial)
            if len(live) > 1:
                first, last = np.log2(np.abs(polynomial[live[[0, -1]]]))
                sizes.append((last - first) / (live[-1] - live[0]))
        if sizes:
            return round(float(np.median(sizes)))
    return 0


def _blocks(num: Table, den: Table, unit: int) -> tuple[Array, Array, Array, Array]:
    """Companion forms of the columns side by side, in units of `2**unit` of the frequency."""
    p, m = len(num), len(num[0])
    D = np.zeros((p, m))
    parts: list[tuple[Array, Array, Array]] = []
    for j in range(m):
        rows = [i for i in range(p) if num[i][j].any()]
        while rows:
            a = den[rows[0]][j]
            monic = a / a[0]
            group = [i for i in rows if _is_same(monic, den[i][j])]
            rows = [i for i in rows if i not in group]
            n = len(a) - 1
            powers = -unit * np.arange(n + 1)
            a = np.ldexp(monic, powers)
            B, C = np.zeros((n, m)), np.zeros((p, n))
            B[:1, j] = 1.0
            for i in group:
                b = np.concatenate([np.zeros(n + 1 - len(num[i][j])), num[i][j]]) / den[i][j][0]
                b, D[i, j] = np.ldexp(b, powers), b[0]
                C[i] = b[1:] - b[0] * a[1:]
            parts.append((np.vstack([-a[1:], np.eye(n - 1, n)]) if n else np.zeros((0, 0)), B, C))
    entries = [D.ravel(), *(matrix.ravel() for part in parts for matrix in part)]
    _checks.finite("the coefficients over the leading one", np.concatenate(entries))
    n = sum(len(part[0]) for part in parts)
    A = block_diag(*(part[0] for part in parts if len(part[0]))) if n else np.zeros((0, 0))
    B = np.vstack([part[1] for part in parts]) if parts else np.zeros((0, m))
    C = np.hstack([part[2] for part in parts]) if parts else np.zeros((p, 0))
    return A, B, C, D


def _is_same(monic: Array, other: Array) -> bool:
    """Whether a denominator is a multiple of another."""
    if len(monic) != len(other):
        return False
    return bool(np.all(np.abs(other / other[0] - monic) <= _SAME * _checks.EPS * np.abs(monic)))

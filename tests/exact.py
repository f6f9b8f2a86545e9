"""Whether a rational matrix is lossless, decided in exact arithmetic.

Polynomials are lists of fractions in ascending powers, without trailing zeros; the zero polynomial is empty.
Independent of the package: no eigenvalue, no root, no tolerance.
"""

from fractions import Fraction
from functools import reduce
from itertools import combinations, pairwise


def polynomial(coefficients):
    """From numbers in ascending powers."""
    out = [Fraction(c) for c in coefficients]
    while out and out[-1] == 0:
        out.pop()
    return out


def add(p, q):
    longest = max(len(p), len(q))
    p, q = (list(x) + [Fraction(0)] * (longest - len(x)) for x in (p, q))
    return polynomial(a + b for a, b in zip(p, q, strict=True))


def multiply(p, q):
    out = [Fraction(0)] * max(0, len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            out[i + j] += a * b
    return polynomial(out)


def divide(p, q):
    """Quotient and remainder."""
    rest, quotient = list(p), [Fraction(0)] * max(0, len(p) - len(q) + 1)
    while len(rest) >= len(q):
        shift, factor = len(rest) - len(q), rest[-1] / q[-1]
        quotient[shift] = factor
        rest = add(rest[:-1], [Fraction(0)] * shift + [-factor * c for c in q[:-1]])
    return polynomial(quotient), rest


def greatest_common_divisor(p, q):
    while q:
        p, q = q, divide(p, q)[1]
        q = [c / q[-1] for c in q]
    return p


def derivative(p):
    return polynomial(k * c for k, c in enumerate(p) if k)


def mirrored(p):
    """`p(-s)`."""
    return [c * (-1) ** k for k, c in enumerate(p)]


def cauchy_index(numerator, denominator):
    """Jumps of `numerator/denominator` from -inf to +inf less those down, over the real axis: Sturm's theorem."""
    chain = [denominator, divide(numerator, denominator)[1]]
    while chain[-1]:
        chain.append([-c for c in divide(chain[-2], chain[-1])[1]])
    chain.pop()
    at_plus = [p[-1] for p in chain]
    at_minus = [p[-1] * (-1) ** (len(p) - 1) for p in chain]
    changes = [sum(a * b < 0 for a, b in pairwise(signs)) for signs in (at_minus, at_plus)]
    return changes[0] - changes[1]


def sum_of_signs(p, roots_of):
    """Sum of the signs of `p` at the real roots of another polynomial (a Tarski query)."""
    return cauchy_index(multiply(p, derivative(roots_of)), roots_of)


def determinant(matrix):
    """Of a matrix of polynomials, by expansion."""
    if not matrix:
        return [Fraction(1)]
    total = []
    for j, entry in enumerate(matrix[0]):
        minor = determinant([row[:j] + row[j + 1 :] for row in matrix[1:]])
        total = add(total, [(-1) ** j * c for c in multiply(entry, minor)])
    return total


def is_lossless(numerators, denominator):
    """Whether `numerators / denominator` is strictly proper, odd, with simple poles on the axis and residues >= 0.

    After cancelling what all entries share, the poles are the roots of the denominator `D`, so: `D` is even or odd
    and, as a polynomial in `x = s^2` (times x if odd), has only real, different, non-positive roots; `G(-s)^T = -G(s)`;
    each principal minor of the residue `N(s)/D'(s)` is non-negative at every root.  On the axis `D'(s)` and `D'(-s)`
    are conjugate, so its sign is that of the even part of `det N_S(s) D'(-s)^k`, a polynomial in x.
    """
    entries = [entry for row in numerators for entry in row]
    if not any(entries):
        return True
    common = reduce(greatest_common_divisor, entries, denominator)
    D = divide(denominator, common)[0]
    N = [[divide(entry, common)[0] for entry in row] for row in numerators]
    ports = range(len(N))
    if any(len(entry) >= len(D) for row in N for entry in row):
        return False
    degree = len(D) - 1
    if mirrored(D) != [(-1) ** degree * c for c in D]:
        return False
    if any(mirrored(N[i][j]) != [-((-1) ** degree) * c for c in N[j][i]] for i in ports for j in ports):
        return False
    roots = [Fraction(0), *D[1::2]] if degree % 2 else D[0::2]
    count = len(roots) - 1
    all_real_and_different = sum_of_signs([Fraction(1)], roots) == count
    none_positive = all(c * roots[-1] >= 0 for c in roots)
    if not (all_real_and_different and none_positive):
        return False
    conjugate = mirrored(derivative(D))
    for size in range(1, len(N) + 1):
        for chosen in combinations(ports, size):
            minor = determinant([[N[i][j] for j in chosen] for i in chosen])
            sign = polynomial(reduce(multiply, [conjugate] * size, minor)[0::2])
            # every sign is 0 or 1 iff they sum to those of the square
            if sum_of_signs(sign, roots) != sum_of_signs(multiply(sign, sign), roots):
                return False
    return True


def state_space_fractions(A, B, C, D):
    """Numerators and common denominator of `C (sI - A)^{-1} B + D`, by the Leverrier-Faddeev recursion."""
    A, B, C, D = ([[Fraction(x) for x in row] for row in M] for M in (A, B, C, D))
    n, p, m = len(A), len(C), len(D[0])
    M = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    denominator, adjugate = [Fraction(1)], []
    for k in range(1, n + 1):
        adjugate.append(_product(_product(C, M), B) if n else [])
        M = _product(A, M)
        c = -sum(M[i][i] for i in range(n)) / k
        for i in range(n):
            M[i][i] += c
        denominator.append(c)
    denominator = polynomial(denominator[::-1])
    numerators = [
        [
            add(
                polynomial(step[i][j] for step in adjugate[::-1]), [D[i][j] * c for c in denominator] if D[i][j] else []
            )
            for j in range(m)
        ]
        for i in range(p)
    ]
    return numerators, denominator


def _product(X, Y):
    return [[sum(a * b for a, b in zip(row, column, strict=True)) for column in zip(*Y, strict=True)] for row in X]

"""Slow, obvious, independent implementations that the fast ones must agree with.

Nothing here uses the package: transfer functions in mpmath, exact fractions, dense matrices, recursions.
"""

from fractions import Fraction
from itertools import pairwise

import mpmath as mp
import numpy as np
from scipy.linalg import expm

EPS = float(np.finfo(float).eps)
DIGITS = 60


def symplectic_form(n):
    return np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(n))


def random_orthogonal_symplectic(n, rng):
    """From a random unitary matrix: `[[Re, -Im], [Im, Re]]`."""
    U, _ = np.linalg.qr(rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))
    return np.block([[U.real, -U.imag], [U.imag, U.real]])


def random_symplectic(n, rng, squeeze=1.0):
    """Two rotations around a squeeze by `exp(±squeeze)` at most."""
    s = np.exp(rng.uniform(-squeeze, squeeze, n))
    return random_orthogonal_symplectic(n, rng) @ np.diag(np.r_[s, 1 / s]) @ random_orthogonal_symplectic(n, rng)


def random_hamiltonian(d, rng, squeeze=1.0):
    """`(Q, S)` with the symplectic eigenvalues `d` (zeros allowed) up to rounding, exactly symmetric."""
    S = random_symplectic(len(d), rng, squeeze)
    Q = S.T @ np.diag(np.r_[d, d]) @ S
    return 0.5 * (Q + Q.T), S


# --- transfer functions ------------------------------------------------------------------------------------------


def on_axis(d, r, w, kappa_0=0.0):
    """Imaginary parts of `G(i w)` for one port at several `w`, with many digits."""
    with mp.workdps(DIGITS):
        pairs = [(mp.mpf(float(a)), mp.mpf(float(b))) for a, b in zip(d, r, strict=True) if b]
        values = []
        for x in map(mp.mpf, np.asarray(w, float).tolist()):
            terms = [a * b * x / ((a - x) * (a + x)) for a, b in pairs]
            values.append(mp.fsum([*terms, -mp.mpf(float(kappa_0)) / x]) if kappa_0 else mp.fsum(terms))
        return values


def largest_error(values, truths):
    """Largest relative error; absolute where the truth is 0."""
    with mp.workdps(DIGITS):
        pairs = [(mp.mpf(float(value)), truth) for value, truth in zip(values, truths, strict=True)]
        return max((float(abs(value - truth) / (abs(truth) or 1)) for value, truth in pairs), default=0.0)


def foster_zeros(d, kappa, kappa_0=0.0):
    """Positive zeros of `kappa_0/s + sum kappa s/(s^2 + d^2)`, by bisection between neighbouring poles."""
    with mp.workdps(DIGITS):
        d = [mp.mpf(float(x)) for x in d]
        kappa = [mp.mpf(float(x)) for x in kappa]
        if kappa_0:
            d, kappa = [mp.mpf(0), *d], [mp.mpf(float(kappa_0)), *kappa]
        zeros = []
        for low, high in pairwise(d):
            # to 2^-80 of the gap
            for _ in range(80):
                middle = (low + high) / 2
                value = mp.fsum(k / (x * x - middle * middle) for k, x in zip(kappa, d, strict=True))
                low, high = (middle, high) if value < 0 else (low, middle)
            zeros.append(low)
        return zeros


def coefficients(d, r):
    """`a_0, a_2 ..` and `c_1, c_3 ..` as exact fractions, adding one mode after the other."""
    denominator, numerator = [Fraction(1)], [Fraction(0)]
    for x, y in zip(d, r, strict=True):
        square, kappa = Fraction(float(x)) ** 2, Fraction(float(x)) * Fraction(float(y))
        grown = _times(numerator, square)
        numerator = [a + kappa * b for a, b in zip(grown, [*denominator, Fraction(0)], strict=True)]
        denominator = _times(denominator, square)
    return denominator[:-1], numerator[:-1]


def _times(ascending, square):
    """`ascending * (x + square)`."""
    return [a + square * b for a, b in zip([Fraction(0), *ascending], [*ascending, Fraction(0)], strict=True)]


def dense_matrices(Q, B):
    """`(A, B, C)` of `z' = J Q z + B u`, `y = B^T Q z`."""
    Q = np.array(Q, dtype=float)
    B = np.array(B, dtype=float).reshape(len(Q), -1)
    return symplectic_form(len(Q) // 2) @ Q, B, B.T @ Q


def dense_transfer_function(A, B, C, s):
    return C @ np.linalg.solve(s * np.eye(len(A)) - A, B.astype(complex))


# --- time ----------------------------------------------------------------------------------------------------------


def dense_step(A, B, h, method, intersample):
    """`z_{k+1} = F z_k + G0 u_k + G1 u_{k+1}`."""
    n, m = B.shape
    I = np.eye(n)
    if method == "euler":
        return I + h * A, h * B, 0 * B
    if method == "midpoint":
        F = np.linalg.solve(I - 0.5 * h * A, I + 0.5 * h * A)
        G = np.linalg.solve(I - 0.5 * h * A, h * B)
        return (F, G, 0 * B) if intersample == "zoh" else (F, 0.5 * G, 0.5 * G)
    M = np.zeros((n + 2 * m, n + 2 * m))
    M[:n, :n], M[:n, n : n + m], M[n : n + m, n + m :] = A * h, B * h, np.eye(m)
    E = expm(M)
    F, now, slope = E[:n, :n], E[:n, n : n + m], E[:n, n + m :]
    return (F, now, 0 * B) if intersample == "zoh" else (F, now - slope, slope)


def dense_simulation(A, B, C, u, z0, h, method="exact", intersample="zoh"):
    """Outputs and states at every sample."""
    F, G0, G1 = dense_step(A, B, h, method, intersample)
    z = np.empty((len(A), u.shape[1]))
    z[:, 0] = z0
    for k in range(u.shape[1] - 1):
        z[:, k + 1] = F @ z[:, k] + G0 @ u[:, k] + G1 @ u[:, k + 1]
    return C @ z, z


def _long(numbers):
    """mpmath complex numbers as long doubles, high and low part of each."""
    out = np.zeros(len(numbers), np.clongdouble)
    for k, x in enumerate(numbers):
        for unit, part in ((1, x.real), (1j, x.imag)):
            high = float(part)
            out[k] += unit * (np.longdouble(high) + np.longdouble(float(part - high)))
    return out


def long_double_recursion(d, r, h, u, x0):
    """Exact responses of `x' = -i d x + kappa u`, `y = sum Re x` to a held and to an interpolated input.

    The coefficients come from mpmath, the recursion runs in long doubles, sample by sample.
    """
    with mp.workdps(DIGITS):
        lam, hold, start, end = [], [], [], []
        for a, b in zip(d, r, strict=True):
            z = mp.mpc(0, -mp.mpf(float(a)) * mp.mpf(float(h)))
            step = mp.mpf(float(a)) * mp.mpf(float(b)) * mp.mpf(float(h))
            phi_1 = mp.expm1(z) / z
            phi_2 = (phi_1 - 1) / z
            lam.append(mp.exp(z))
            hold.append(step * phi_1)
            start.append(step * (phi_1 - phi_2))
            end.append(step * phi_2)
        lam, b0, b1 = _long(lam * 2), _long(hold + start), _long([mp.mpc(0)] * len(d) + end)
    n = len(d)
    x = np.concatenate([x0, x0]).astype(np.clongdouble)
    u = u.astype(np.longdouble)
    y = np.empty((2, u.size), np.longdouble)
    for k in range(u.size):
        y[0, k], y[1, k] = x[:n].real.sum(), x[n:].real.sum()
        if k + 1 < u.size:
            x = lam * x + b0 * u[k] + b1 * u[k + 1]
    return y


def exact_steps(A, B, h):
    """`F`, `G`, `S` of `x_{k+1} = F x_k + G u_k + S (u_{k+1} - u_k)` of these very doubles, as matrices of mpmath."""
    (n, m), h = B.shape, mp.mpf(float(h))
    # long steps leave little of large terms of either sign
    with mp.workdps(3 * DIGITS):
        M = mp.zeros(n + 2 * m)
        M[:n, :n], M[:n, n : n + m] = h * mp.matrix(A.tolist()), h * mp.matrix(B.tolist())
        M[n : n + m, n + m :] = mp.eye(m)
        E = mp.expm(M)
    return E[:n, :n], E[:n, n : n + m], E[:n, n + m :]


def exact_motion(steps, u, z0, hold):
    """States at every sample for an input held or interpolated, as columns of mpmath."""
    F, G, S = steps
    z = [mp.matrix(np.reshape(z0, (-1, 1)).tolist())]
    with mp.workdps(DIGITS):
        for now, then in pairwise(mp.matrix(column.tolist()) for column in u.T):
            z.append(F * z[-1] + G * now + (S * (then - now) if hold == "foh" else 0 * G * now))
    return z


def share_of_largest(values, truths):
    """Largest error of any of these numbers, of the largest of them."""
    with mp.workdps(DIGITS):
        pairs = list(zip(np.ravel(values).tolist(), truths, strict=True))
        return float(max(abs(mp.mpf(value) - truth) for value, truth in pairs) / max(abs(truth) for truth in truths))

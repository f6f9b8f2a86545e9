"""The Cramer-Rao bound of a recording and the best fit near the truth, without the package that is judged by them.

With `w_l = q_l + i p_l` and `lambda_l` its factor in a step the output is

    y_k = sum_l  sqrt(r_l) d_l Re(lambda_l^k w_l(0)) + r_l d_l Re(b_l X_l(k)),    X_l(k+1) = lambda_l X_l(k) + u_k,

and the derivative of `X` by `lambda` obeys the same recursion, driven by `X`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from .recordings import Recording

Array = NDArray[np.float64]


def output_and_jacobian(theta: Array, u: Array, h: float = 1.0, method: str = "exact") -> tuple[Array, Array]:
    """Output (T,) and its derivatives (T, 4n) by `theta = (d, r, q, p)`; method 'exact' (held input) or 'euler'."""
    d, r, q, p = np.split(np.asarray(theta, float), 4)
    n, k = len(d), np.arange(float(len(u)))
    y, J = np.zeros(len(u)), np.empty((len(u), 4 * n))
    for l in range(n):
        lam, lam_d, b, b_d = _step(d[l], h, method)
        X = lfilter([0.0, 1.0], [1.0, -lam], u.astype(complex))
        X_d = lam_d * lfilter([0.0, 1.0], [1.0, -lam], X)
        power = lam**k
        free = power * (q[l] + 1j * p[l])
        free_d = lam_d / lam * k * free
        root = np.sqrt(r[l])
        y += root * d[l] * free.real + r[l] * d[l] * (b * X).real
        J[:, l] = root * (free + d[l] * free_d).real + r[l] * (b * X + d[l] * (b_d * X + b * X_d)).real
        J[:, n + l] = 0.5 * d[l] / root * free.real + d[l] * (b * X).real
        J[:, 2 * n + l], J[:, 3 * n + l] = root * d[l] * power.real, -root * d[l] * power.imag
    return y, J


def _step(d: float, h: float, method: str) -> tuple[complex, complex, complex, complex]:
    """Factor of a step, weight of the input in it, and their derivatives by the frequency."""
    if method == "euler":
        return 1 - 1j * h * d, -1j * h, h, 0.0
    lam = np.exp(-1j * h * d)
    return lam, -1j * h * lam, (1 - lam) / (1j * d), (h * lam - (1 - lam) / (1j * d)) / d


def standard_errors(recording: Recording) -> Array:
    """Square roots of the Cramer-Rao bounds of `(d, r, q, p)` at the truth, shape (4n,)."""
    _, J = output_and_jacobian(recording.theta, recording.u, recording.h, recording.method)
    lengths = np.linalg.norm(J, axis=0)
    J /= lengths
    return np.asarray(recording.deviation * np.sqrt(np.diag(np.linalg.inv(J.T @ J))) / lengths)


@dataclass(frozen=True)
class LocalFit:
    """Minimum of the squared error next to the truth."""

    theta: Array
    loss: float


def fit_from_truth(recording: Recording) -> LocalFit:
    """Minimise the squared error over all parameters at once, from the truth on; loss per sample."""
    u, h, method = recording.u, recording.h, recording.method

    def residual(theta: Array) -> Array:
        return output_and_jacobian(theta, u, h, method)[0] - recording.y

    def jacobian(theta: Array) -> Array:
        return output_and_jacobian(theta, u, h, method)[1]

    low = np.full(len(recording.theta), -np.inf)
    low[: len(recording.theta) // 2] = 0.0
    found = least_squares(
        residual, recording.theta, jacobian, (low, np.inf), x_scale=standard_errors(recording), xtol=1e-12, ftol=1e-12,
        gtol=1e-12,
    )  # fmt: skip
    return LocalFit(found.x, 2 * found.cost / len(u))

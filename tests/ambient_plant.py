"""Three floors in the wind: the plant of tests of outputs alone."""

import numpy as np
from scipy.linalg import expm, solve_discrete_lyapunov

STEP = 0.02
HERTZ, ZETA = np.array([3.4, 8.7, 11.9]), np.array([0.01, 0.012, 0.015])
SHAPES = np.array([[0.4, 1.0, -0.6], [0.8, 0.3, 1.0], [1.0, -0.9, -0.7]])  # of three floors, a column each mode


def sampled(shapes=SHAPES, hertz=HERTZ, zeta=ZETA, of_displacement=0.0):
    """Matrices of one step, and the covariance of what white forces add in it; outputs are velocities."""
    n, w = len(hertz), 2 * np.pi * hertz
    A, B, i = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n)), np.arange(n)
    A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = w, -w, -2 * zeta * w
    B[2 * i + 1, i] = np.sqrt(2 * zeta * w)
    C = np.zeros((len(shapes), 2 * n))
    C[:, 1::2], C[:, ::2] = shapes, of_displacement * np.roll(shapes, 1, axis=0)
    both = expm(STEP * np.block([[-A, B @ B.T], [np.zeros(A.shape), A.T]]))
    step = both[2 * n :, 2 * n :].T
    Q = step @ both[: 2 * n, 2 * n :]
    return step, C, 0.5 * (Q + Q.T)


def ambient(seed, samples=3000, noise=0.2, **how):
    """Outputs in steady motion, with noise of a share of each."""
    (A, C, Q), rng = sampled(**how), np.random.default_rng(seed)
    P = solve_discrete_lyapunov(A, Q)
    x = np.empty((len(A), samples))
    x[:, 0] = np.linalg.cholesky(P) @ rng.standard_normal(len(A))
    added = np.linalg.cholesky(Q) @ rng.standard_normal((len(A), samples))
    for t in range(1, samples):
        x[:, t] = A @ x[:, t - 1] + added[:, t]
    y = C @ x
    return y + noise * np.sqrt(np.diag(C @ P @ C.T))[:, None] * rng.standard_normal(y.shape)

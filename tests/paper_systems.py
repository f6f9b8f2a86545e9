"""Pairs `(d, v)` of every kind, and the systems that the paper makes of them, as dense matrices."""

import control as ct
import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from reference import coefficients, symplectic_form

import ph_control as phc

SETTINGS = settings(deadline=None, max_examples=25, derandomize=True)
SPECTRA = ("decade", "wide", "clustered", "repeated", "dark")
SQUEEZE = np.log(1e4) / 2  # condition of S up to 1e4

cases = st.tuples(st.integers(1, 8), st.sampled_from(SPECTRA), st.integers(0, 10**6))


def pair(n, kind, seed):
    """`(d, v)` of a kind, in random order."""
    rng = np.random.default_rng(seed)
    d = {
        "wide": lambda: 10 ** rng.uniform(-2, 2, n),
        "clustered": lambda: 3.0 * (1 + 1e-6 * np.arange(n)),
        "repeated": lambda: np.repeat([1.0, 2.0, 5.0], [(n + 1) // 2, n // 2, 0]),
    }.get(kind, lambda: 10 ** rng.uniform(0, 1, n))()
    v = rng.standard_normal(2 * n)
    if kind == "dark":
        v[[0, n]] = 0.0
    order = rng.permutation(n)
    return d[order], v[np.r_[order, n + order]], rng


def companion(d, v):
    """CH(d, v) as dense matrices, coefficients by exact fractions rounded once."""
    n = len(d)
    r = v[:n] ** 2 + v[n:] ** 2
    a, c = coefficients(d, r)
    A = np.diag(np.ones(2 * n - 1), 1)
    A[-1, 0::2] = [-float(x) for x in a]
    B = np.eye(2 * n)[:, -1:]
    C = np.zeros((1, 2 * n))
    C[0, 1::2] = [float(x) for x in c]
    return A, B, C


def plain(A, B, C):
    return ct.StateSpace(A, B, C, np.zeros((C.shape[0], B.shape[1])), remove_useless_states=False)


def transposed(A, B, C):
    return plain(A.T, C.T, B.T)


def target(d, v, S):
    """`(S^T Dhat S, S^{-1} v)`."""
    J = symplectic_form(len(d))
    Q = S.T @ np.diag(np.r_[d, d]) @ S
    return phc.ph(0.5 * (Q + Q.T), J.T @ S.T @ J @ v)

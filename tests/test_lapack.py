"""Components along singular vectors, against dense singular value decompositions and mpmath."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS

from ph_control.numerics.lapack import bidiagonal_components, bidiagonal_svd, components

relaxed = settings(deadline=None, max_examples=20, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def bidiagonal(diagonal, above):
    return np.diag(diagonal) + np.diag(above, 1)[: len(diagonal), : len(diagonal)]


def truth_of(M, right, left):
    """Singular values, and what a function of them is told by the vectors: `left^T f(M) right` for odd f, and so on."""
    U, sigma, Vt = np.linalg.svd(M)
    return sigma, Vt @ right, U.T @ left


def moments(sigma, x, y, top):
    """`|M right|^2`, `|M^T left|^2` and `left^T M right`, which do not depend on how equal values choose vectors."""
    s = sigma / top
    return np.array([s**2 @ x**2, s**2 @ y**2, y @ (s * x), s**4 @ x**2, y @ (s**3 * x)])


@relaxed
@given(st.integers(1, 70), st.sampled_from(["random", "repeated", "singular", "zero", "graded"]), seeds)
def test_singular_values_and_components_are_those_of_the_matrix(n, kind, seed):
    rng = np.random.default_rng(seed)
    U, V = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    sigma = {
        "random": rng.random(n), "repeated": np.repeat([1.0, 2.0], [n // 2, n - n // 2]), "zero": np.zeros(n),
        "singular": np.where(np.arange(n) % 3 == 0, 0.0, 1.0), "graded": np.logspace(0, -200, n),
    }[kind]  # fmt: skip
    M, (x, y) = (U * sigma) @ V.T, rng.standard_normal((2, n))
    kept = M.copy(), x.copy(), y.copy()
    found, right, left = components(M, x, y)
    assert all(np.array_equal(a, b) for a, b in zip(kept, (M, x, y), strict=True))
    top = max(float(sigma.max()), 1e-300)
    assert np.all(np.diff(found) <= 0)
    assert np.abs(found - np.sort(sigma)[::-1]).max() <= 20 * n * EPS * top
    size = np.array([x @ x, y @ y, *3 * [np.linalg.norm(x) * np.linalg.norm(y)]])
    scaled = M / top
    wanted = [
        scaled @ x @ (scaled @ x), y @ scaled @ (scaled.T @ y), y @ scaled @ x,
        np.sum((scaled.T @ (scaled @ x)) ** 2), y @ (scaled @ (scaled.T @ (scaled @ x))),
    ]  # fmt: skip
    assert np.all(np.abs(moments(found, right, left, top) - wanted) <= 100 * n * EPS * size)
    assert abs(right @ right - x @ x) <= 20 * n * EPS * (x @ x)
    assert abs(left @ left - y @ y) <= 20 * n * EPS * (y @ y)


@pytest.mark.parametrize("n", [1, 2, 7, 60])
@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_single_components_are_those_along_single_vectors(n, scale):
    rng = np.random.default_rng(n)
    M, (x, y) = rng.standard_normal((n, n)), rng.standard_normal((2, n))
    sigma, right, left = truth_of(M, x, y)
    found = components(scale * M, x, y)
    gap = np.abs(np.subtract.outer(sigma, sigma) + np.diag(np.full(n, np.inf))).min(axis=1)
    allowed = 20 * n * EPS * sigma[0] / np.minimum(gap, sigma)
    assert np.all(np.abs(found[0] / scale - sigma) <= 20 * n * EPS * sigma[0])
    assert np.all(np.abs(np.abs(found[1]) - np.abs(right)) <= allowed * np.linalg.norm(x))
    assert np.all(np.abs(np.abs(found[2]) - np.abs(left)) <= allowed * np.linalg.norm(y))


@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize("n", [1, 2, 6])
def test_a_bidiagonal_matrix_keeps_the_digits_of_each_singular_value(n, both):
    rng = np.random.default_rng(n)
    diagonal, above = np.logspace(0, -40, n) * rng.uniform(1, 2, n), np.logspace(1, -30, n)[1:]
    x, y = rng.standard_normal((2, n))
    sigma, right, left = bidiagonal_components(diagonal, above, x, y if both else None)
    with mp.workdps(120):
        U, exact, Vt = mp.svd_r(mp.matrix(bidiagonal(diagonal, above).tolist()))
        order = sorted(range(n), key=lambda k: -exact[k])
        for place, k in enumerate(order):
            assert abs(float(mp.mpf(sigma[place]) / exact[k] - 1)) < 20 * n * EPS
            along = sum(Vt[k, j] * mp.mpf(x[j]) for j in range(n))
            assert abs(abs(right[place]) - float(abs(along))) < 100 * n * EPS * np.linalg.norm(x)
            if both:
                along = sum(U[j, k] * mp.mpf(y[j]) for j in range(n))
                assert abs(abs(left[place]) - float(abs(along))) < 100 * n * EPS * np.linalg.norm(y)


@pytest.mark.parametrize("seed", range(6))
def test_singular_values_are_right_to_the_last_places_though_vectors_turn_with_them(seed):
    rng = np.random.default_rng(seed)
    diagonal, above = rng.uniform(0.1, 1, 20), rng.uniform(0.1, 1, 19)
    sigma, _, _ = bidiagonal_components(diagonal, above, np.ones(20))
    with mp.workdps(40):
        M = mp.matrix(bidiagonal(diagonal, above).tolist())
        exact = sorted(map(mp.sqrt, mp.eigsy(M.T * M, eigvals_only=True)), reverse=True)
        assert max(abs(float(mp.mpf(x) / y - 1)) for x, y in zip(sigma.tolist(), exact, strict=True)) < 10 * EPS


def test_nothing_has_no_components():
    nothing = np.zeros(0)
    for found in (components(np.zeros((0, 0)), nothing, nothing), bidiagonal_components(nothing, nothing, nothing)):
        assert [len(part) for part in found] == [0, 0, 0]


@pytest.mark.parametrize("n", [1, 2, 5, 30, 90])
@pytest.mark.parametrize("kind", ["random", "repeated", "graded", "zero"])
@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_a_bidiagonal_matrix_is_its_singular_values_between_orthonormal_vectors(n, kind, scale):
    rng = np.random.default_rng(n)
    diagonal, above = {
        "random": (rng.standard_normal(n), rng.standard_normal(n - 1)),
        "repeated": (np.ones(n), np.zeros(n - 1)),
        "graded": (np.logspace(0, -30, n), np.logspace(0, -30, n)[1:]),
        "zero": (np.zeros(n), np.zeros(n - 1)),
    }[kind]
    M, kept = scale * bidiagonal(diagonal, above), (scale * diagonal, scale * above)
    U, sigma, Vt = bidiagonal_svd(*(x.copy() for x in kept))
    top = max(np.linalg.norm(M, 2), 1e-300)
    assert np.all(np.diff(sigma) <= 0) and np.all(sigma >= 0)
    assert np.abs((U * sigma) @ Vt - M).max() <= 20 * n * EPS * top
    assert np.abs(sigma - np.linalg.svd(M, compute_uv=False)).max() <= 20 * n * EPS * top
    for W in (U, Vt):
        assert np.abs(W @ W.T - np.eye(n)).max() <= 20 * n * EPS

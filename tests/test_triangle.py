"""Triangular factors of tall matrices: the same Gram matrix and the same norms as the matrix, at any condition."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control.identification.regression.elimination as module
from ph_control.identification.regression.elimination import reduced, reflect, triangle

EPS = np.finfo(float).eps
SHORT, LONG = 300, 12_000  # rows of eight columns: reflected at once, and by way of the Gram matrix


def blocks_of(matrix, size=2048):
    """Blocks as the solver makes them: columns as rows, some samples at a time."""
    return lambda: (np.ascontiguousarray(matrix[first : first + size].T) for first in range(0, len(matrix), size))


def of_unit_columns(matrix):
    lengths = np.linalg.norm(matrix, axis=0)
    return matrix / np.where(lengths > 0, lengths, 1.0)


def assert_same_norms(factor, matrix):
    """`R^T R = A^T A`, and `|R x| = |A x|` along the singular vectors of A, small singular values among them."""
    lengths = np.linalg.norm(matrix, axis=0)
    safe = np.where(lengths > 0, lengths, 1.0)
    R, A = factor / safe, matrix / safe
    size = len(R)
    allowed = 20 * size * EPS
    assert np.array_equal(factor, np.triu(factor)) and factor.shape == (size, size)
    assert np.abs(R.T @ R - A.T @ A).max() <= allowed
    _, sigma, Vt = np.linalg.svd(A, full_matrices=False)
    assert np.abs(np.linalg.norm(R @ Vt.T, axis=0) - sigma).max() <= allowed


def with_condition(rows, condition, rng, columns=8):
    U, _ = np.linalg.qr(rng.standard_normal((rows, columns)))
    V, _ = np.linalg.qr(rng.standard_normal((columns, columns)))
    return U * np.geomspace(1.0, 1.0 / condition, columns) @ V.T


@pytest.mark.parametrize("condition", [1.0, 1e4, 1e8, 1e12, 1e17])
@pytest.mark.parametrize("rows", [SHORT, LONG])
def test_factor_has_the_norms_of_the_matrix_at_any_condition(rows, condition):
    matrix = with_condition(rows, condition, np.random.default_rng(int(np.log10(condition))))
    assert_same_norms(triangle(blocks_of(matrix), rows), matrix)


def deficient(kind, rng):
    """Matrices of less than full rank, dependent columns first, last, or absent."""
    A = rng.standard_normal((LONG, 8))
    if kind == "zero column":
        A[:, 3] = 0.0
    elif kind == "zero output":
        A[:, 7] = 0.0
    elif kind == "nothing":
        A[:] = 0.0
    elif kind == "twice the same":
        A[:, 3] = A[:, 2]
    elif kind == "output explained":
        A[:, 7] = A[:, :7] @ rng.standard_normal(7)
    else:
        A[:, 2:6] = A[:, :2] @ rng.standard_normal((2, 4))
    return A


@pytest.mark.parametrize(
    "kind", ["zero column", "zero output", "nothing", "twice the same", "output explained", "four dependent"]
)
def test_factor_of_a_rank_deficient_matrix_has_its_norms(kind):
    matrix = deficient(kind, np.random.default_rng(1))
    assert_same_norms(triangle(blocks_of(matrix), LONG), matrix)


@settings(deadline=None, max_examples=15, derandomize=True)
@given(gap=st.floats(-14, 0), seed=st.integers(0, 10**6))
def test_columns_after_two_nearly_equal_ones_keep_their_digits(gap, seed):
    # what tells the two apart is also seen in later columns, so that an error made there would spread
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((6000, 7))
    A[:, 2] = A[:, 1] + 10.0**gap * A[:, 5]
    A[:, 4] = 0.3 * A[:, 4] + A[:, 5]
    assert_same_norms(triangle(blocks_of(A), len(A)), A)


@settings(deadline=None, max_examples=10, derandomize=True)
@given(exponents=st.lists(st.integers(-100, 100), min_size=6, max_size=6), seed=st.integers(0, 10**6))
def test_units_of_the_columns_do_not_matter(exponents, seed):
    A = np.random.default_rng(seed).standard_normal((6000, 6))
    scale = np.ldexp(1.0, exponents)
    plain, scaled = triangle(blocks_of(A), len(A)), triangle(blocks_of(A * scale), len(A))
    assert np.abs(scaled / scale - plain).max() <= 6 * EPS * np.abs(plain).max()


def test_columns_are_read_as_often_as_their_condition_asks_for():
    reads = []

    def counted(matrix):
        def blocks():
            reads.append(1)
            return blocks_of(matrix)()

        return blocks

    rng = np.random.default_rng(2)
    for matrix, allowed in [
        (rng.standard_normal((LONG, 8)), 1),
        (np.pad(rng.standard_normal((LONG, 7)), ((0, 0), (0, 1))), 1),  # nothing is lost where nothing is
        (with_condition(LONG, 1e5, rng), 2),
        (with_condition(LONG, 1e12, rng), 3),
        (deficient("four dependent", rng), 3),
    ]:
        reads.clear()
        triangle(counted(matrix), LONG)
        assert len(reads) == allowed


def test_way_by_the_gram_matrix_and_by_reflections_agree(monkeypatch):
    matrix = with_condition(LONG, 1e10, np.random.default_rng(3))
    fast, slow = triangle(blocks_of(matrix), LONG), reflect(blocks_of(matrix)())
    size = np.linalg.norm(matrix, axis=0)
    assert np.abs(np.abs(fast) - np.abs(slow)).max() <= 1e-5 * size.max()  # the last rows are as good as they are seen
    assert_same_norms(slow, matrix)
    monkeypatch.setattr(module, "_PASSES", 1)
    assert_same_norms(triangle(blocks_of(matrix), LONG), matrix)


@pytest.mark.parametrize("rows", [1, 3, 8, 9])
def test_fewer_rows_than_columns_leave_zero_rows(rows):
    matrix = np.random.default_rng(4).standard_normal((rows, 8))
    for factor in (triangle(blocks_of(matrix, 2), rows), reduced(matrix), triangle(blocks_of(matrix), rows)):
        assert_same_norms(factor, matrix)
        assert not factor[rows:].any()


def test_empty_blocks_count_for_nothing():
    matrix = np.random.default_rng(5).standard_normal((LONG, 4))
    pieces = [matrix[:100], matrix[:0], matrix[100:], matrix[:0]]
    for blocks in (pieces, pieces[::-1]):
        assert_same_norms(triangle(lambda blocks=blocks: (one.T for one in blocks), LONG), matrix)


def test_without_rows_there_is_no_factor():
    with pytest.raises(ValueError, match="no rows"):
        reflect([])

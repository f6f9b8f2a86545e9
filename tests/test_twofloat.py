"""Pairs of doubles: exact where exactness is claimed, twice the digits elsewhere."""

from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS

from ph_control.numerics import double_double as tf

numbers = st.floats(-1e60, 1e60).map(lambda x: x if abs(x) > 1e-60 else 1.0)
relaxed = settings(deadline=None, max_examples=50, derandomize=True)

# about 106 bits, less the few that the operations cost
TWICE = 16 * EPS**2


def exact(pair):
    return Fraction(float(pair[0])) + Fraction(float(pair[1]))


def pair(a, b):
    """The pair nearest to `a (1 + b eps / 4)`."""
    return tf.two_sum(np.array(a), np.array(a * b * EPS / 4))


small = st.floats(-1, 1)


@relaxed
@given(numbers, numbers)
def test_the_sum_and_its_error_make_the_exact_sum(a, b):
    s, e = tf.two_sum(np.array(a), np.array(b))
    assert s == a + b
    assert exact((s, e)) == Fraction(a) + Fraction(b)


@relaxed
@given(numbers, numbers)
def test_the_product_and_its_error_make_the_exact_product(a, b):
    p, e = tf.two_prod(np.array(a), np.array(b))
    assert p == a * b
    assert exact((p, e)) == Fraction(a) * Fraction(b)


@relaxed
@given(numbers, small, numbers, small)
def test_the_sum_of_pairs_has_twice_the_digits_of_its_terms(a, da, b, db):
    x, y = pair(a, da), pair(b, db)
    error = abs(exact(tf.add(x, y)) - (exact(x) + exact(y)))
    assert error <= TWICE * (abs(exact(x)) + abs(exact(y)))


@relaxed
@given(numbers, small, numbers, small)
def test_the_product_and_the_quotient_of_pairs_have_twice_the_digits(a, da, b, db):
    x, y = pair(a, da), pair(b, db)
    product, quotient = exact(x) * exact(y), exact(x) / exact(y)
    assert abs(exact(tf.multiply(x, y)) - product) <= TWICE * abs(product)
    assert abs(exact(tf.divide(x, y)) - quotient) <= TWICE * abs(quotient)


def test_the_low_part_matters():
    third = tf.divide((np.array(1.0), np.array(0.0)), (np.array(3.0), np.array(0.0)))
    assert abs(exact(third) - Fraction(1, 3)) < TWICE / 3
    assert abs(Fraction(float(third[0])) - Fraction(1, 3)) > EPS / 16


@pytest.mark.parametrize("k", [0, 1, 255, 10**5, 10**9, 10**12])
@pytest.mark.parametrize("step", [1e-9, 0.3, 3.0, 1e6])
def test_rotations_keep_their_phase_however_many_steps_there_are(k, step):
    low = 0.3 * EPS * step
    got = tf.cis_multiples((np.array([step]), np.array([low])), np.array([float(k)]))[0, 0]
    with mp.workdps(60):
        truth = mp.expj(k * (mp.mpf(step) + mp.mpf(low)))
        assert abs(mp.mpc(complex(got)) - truth) < 8 * EPS
    if k * step > 1e4:
        assert abs(got - np.exp(1j * k * step)) > 8 * EPS


def test_rotations_of_many_modes_and_many_powers_have_one_row_a_mode():
    step = np.array([0.1, 0.2, 0.3])
    got = tf.cis_multiples((step, 0 * step), np.arange(5.0))
    assert got.shape == (3, 5)
    assert np.max(np.abs(got - np.exp(1j * np.outer(step, np.arange(5))))) < 8 * EPS


# --- products of matrices ---------------------------------------------------------------------------------------------


def exact_product(left, right):
    rows = [[Fraction(x) + Fraction(y) for x, y in zip(*row, strict=True)] for row in zip(*left, strict=True)]
    turned = zip(right[0].T, right[1].T, strict=True)
    columns = [[Fraction(x) + Fraction(y) for x, y in zip(*column, strict=True)] for column in turned]
    return [[sum(a * b for a, b in zip(row, column, strict=True)) for column in columns] for row in rows]


@relaxed
@given(
    st.integers(1, 5), st.integers(1, 40), st.sampled_from([1, 2, 3]), st.sampled_from([1e-100, 1.0, 1e100]),
    st.booleans(), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_a_product_of_matrices_has_the_error_that_its_slices_promise(rows, inner, slices, scale, paired, seed):
    rng = np.random.default_rng(seed)
    spread = 10.0 ** rng.uniform(-6, 6, inner)
    left, right = rng.standard_normal((rows, inner)) * spread * scale, rng.standard_normal((inner, rows)) / scale
    lows = [EPS / 4 * rng.uniform(-1, 1, x.shape) * np.abs(x) * paired for x in (left, right)]
    pairs = (left, lows[0]), (right, lows[1])
    truth = exact_product((left, lows[0]), (right, lows[1]))
    allowed = inner * np.outer(np.abs(left).max(axis=1), np.abs(right).max(axis=0))
    allowed = allowed * {1: 2.0 * EPS, 2: 2.0**-72, 3: 2.0**-93}[slices]
    parts = tf.product_parts(*pairs, slices)
    assert len(parts) == slices
    high, low = tf.product(*pairs, slices)
    for j in range(rows):
        for k in range(rows):
            bound = Fraction(float(allowed[j, k]))
            assert abs(sum(Fraction(float(part[j, k])) for part in parts) - truth[j][k]) <= bound
            if slices > 1:
                assert abs(exact((high[j, k], low[j, k])) - truth[j][k]) <= bound + abs(truth[j][k]) * Fraction(TWICE)


def test_the_slices_of_a_matrix_add_up_and_products_of_the_first_ones_are_exact():
    rng = np.random.default_rng(0)
    left, right = rng.standard_normal((3, 100)), rng.standard_normal((100, 3))
    parts = tf.product_parts(tf.exactly(left), tf.exactly(right), 3)
    bits = (53 - (100).bit_length()) // 2
    slices = tf._sliced(tf.exactly(left), 1, bits, 3), tf._sliced(tf.exactly(right), 0, bits, 3)
    assert np.array_equal(sum(slices[0][1:], slices[0][0]), left)
    first = exact_product((slices[0][0], 0 * left), (slices[1][0], 0 * right))
    assert [[Fraction(float(x)) for x in row] for row in parts[0]] == first


def test_a_product_takes_what_is_known_of_its_operands_from_the_caller():
    rng = np.random.default_rng(1)
    left, right = np.tril(rng.standard_normal((6, 6))), rng.standard_normal((6, 6))
    asked = []

    def multiply(a, b):
        asked.append(a)
        return a @ b

    high, low = tf.product(tf.exactly(left), tf.exactly(right), 3, multiply)
    assert len(asked) == 6 and all(np.array_equal(a, np.tril(a)) for a in asked)
    assert np.array_equal(high + low, high)
    assert np.allclose(high, left @ right, rtol=0, atol=20 * EPS)

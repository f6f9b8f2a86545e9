"""Pairs of doubles: exact where exactness is claimed, twice the digits elsewhere."""

from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS

from ph_control import _twofloat as tf

numbers = st.floats(-1e60, 1e60).map(lambda x: x if abs(x) > 1e-60 else 1.0)
relaxed = settings(deadline=None, max_examples=100, derandomize=True)

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

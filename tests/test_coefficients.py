"""Coefficients of a transfer function: forwards to the last place, backwards as far as they themselves go."""

import functools
from fractions import Fraction
from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, coefficients

import ph_control as phc
from ph_control.numerics import polynomials as engine

relaxed = settings(deadline=None, max_examples=20, derandomize=True)

RNG = np.random.default_rng(20)
LARGE = {
    "squares of 1 to 500": np.arange(1.0, 501.0) ** 2,
    "slow": np.arange(1, 31) * 1e-9,
    "fast": np.arange(1, 41) * 1e9,
    "spread": np.logspace(-8, 8, 100),
    "two groups": np.r_[np.linspace(1e-3, 2e-3, 60), np.full(40, 1e4)],
    "random": np.sort(RNG.uniform(1.0, 10.0, 200)),
    "squares": np.arange(1.0, 201.0) ** 2,
    "chain": 2 * np.sin((2 * np.arange(1.0, 201.0) - 1) * np.pi / 802),
}
SPECTRA = {
    "one": [3.0],
    "decade": np.logspace(0, 1, 8),
    "wide 1e4": np.logspace(-2, 2, 8),
    "clustered 1e-6": 1 + 1e-6 * np.arange(8),
    "repeated": [1.0, 1.0, 2.0, 2.0, 2.0],
}


def weights(n):
    return np.random.default_rng(n).uniform(0.1, 1.0, n)


def relative_error(found, truth):
    """Largest error of scaled numbers against numbers of mpmath."""
    with mp.workdps(40):
        pairs = zip(found.mantissa, found.exponent, truth, strict=True)
        return max(float(abs(mp.ldexp(mp.mpf(float(m)), int(e)) / t - 1)) for m, e, t in pairs)


@functools.cache
def many_digits(name):
    """Coefficients of a large system, ascending, one mode after the other with 40 digits."""
    d = LARGE[name]
    with mp.workdps(40):
        P, N = [mp.mpf(1)], [mp.mpf(0)]
        for x, r in zip(d.tolist(), weights(len(d)).tolist(), strict=True):
            square, kappa = mp.mpf(x) ** 2, mp.mpf(x) * mp.mpf(r)
            N = _grown(N, P, square, kappa)
            P = [square * a + b for a, b in zip([*P, 0], [0, *P], strict=True)]
        return P[:-1], N[:-1]


def _grown(N, P, square, kappa):
    grown = [square * a + b for a, b in zip([*N, 0], [0, *N], strict=True)]
    return [a + kappa * b for a, b in zip(grown, [*P, 0], strict=True)]


# --- forwards ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SPECTRA)
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_coefficients_are_right_to_the_last_places(name, scale):
    d = scale * np.array(SPECTRA[name])
    a, c = phc.modes(d, weights(len(d))).coefficients()
    even, odd = coefficients(d, weights(len(d)))
    assert not a[1::2].any()
    assert max(abs(float(Fraction(x) / t - 1)) for x, t in zip(a[0::2].tolist(), even, strict=True)) < 8 * EPS
    assert max(abs(float(Fraction(x) / t - 1)) for x, t in zip(c[::-1].tolist(), odd, strict=True)) < 8 * EPS


def test_the_order_of_c_is_that_of_the_paper():
    """`c_{2k+1} = sum_l r_l d_l e_k({d_j^2 : j != l})`."""
    d, r = [1.0, 2.0, 3.0], [0.5, 1.0, 2.0]
    _, c = phc.modes(d, r).coefficients()
    kappa = np.multiply(d, r)
    assert c[0] == kappa.sum()
    assert c[1] == kappa[0] * (4 + 9) + kappa[1] * (1 + 9) + kappa[2] * (1 + 4)
    assert c[2] == kappa[0] * 36 + kappa[1] * 9 + kappa[2] * 4


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("name", LARGE)
def test_hundreds_of_modes_keep_fifteen_digits(name):
    d = LARGE[name]
    a, c = phc.modes(d, weights(len(d))).scaled_coefficients()
    even, odd = many_digits(name)
    assert not a.mantissa[1::2].any()
    assert relative_error(type(a)(a.mantissa[0::2].copy(), a.exponent[0::2].copy()), even) < 3e-15
    assert relative_error(c, odd[::-1]) < 3e-15


@pytest.mark.parametrize("name", ["slow", "fast", "spread", "two groups", "squares of 1 to 500"])
def test_coefficients_that_leave_the_range_of_doubles_are_refused_not_returned_as_zero(name):
    modes = phc.modes(LARGE[name], weights(len(LARGE[name])))
    assert not all(part.fit_doubles for part in modes.scaled_coefficients())
    with pytest.raises(
        phc.StructureError, match=f"coefficients of {modes.n} modes from .* exceed the range of doubles"
    ):
        modes.coefficients()


def test_a_product_that_leaves_the_range_only_on_the_way_is_right():
    d = 2.0 ** np.array([-256.6, -256.59, 255.79, 255.8])
    a, c = phc.modes(d, np.ones(4)).coefficients()
    even, odd = coefficients(d, np.ones(4))
    assert max(abs(float(Fraction(x) / t - 1)) for x, t in zip(a[0::2].tolist(), even, strict=True)) < 8 * EPS
    assert max(abs(float(Fraction(x) / t - 1)) for x, t in zip(c[::-1].tolist(), odd, strict=True)) < 8 * EPS


@relaxed
@given(
    st.integers(1, 12), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 3.0, 6.0]), st.sampled_from([-90, -9, 0, 90])
)
def test_plain_doubles_are_right_to_the_last_place(n, seed, decades, gain):
    rng = np.random.default_rng(seed)
    d = np.sort(10.0 ** rng.uniform(-decades / 2, decades / 2, n))
    r = 10.0 ** (rng.uniform(-12, 0, n) + gain) * (rng.random(n) < 0.8)
    found = engine.plain_coefficients(d, r)
    assert found is not None
    for values, truths in zip((found[0][0::2], found[1][::-1]), coefficients(d, r), strict=True):
        assert all(abs(Fraction(x) - t) <= Fraction(EPS) * t for x, t in zip(values.tolist(), truths, strict=True))


@pytest.mark.parametrize("name", ["slow", "fast", "spread", "two groups", "squares of 1 to 500"])
def test_plain_doubles_are_left_alone_where_they_could_overflow(name):
    assert engine.plain_coefficients(LARGE[name], weights(len(LARGE[name]))) is None


def test_without_modes_there_is_nothing_to_multiply():
    assert engine.plain_coefficients(np.zeros(0), np.zeros(0)) is None


def test_coefficients_of_a_system_that_no_port_reaches_are_those_of_zero_over_its_poles():
    a, c = phc.modes([1.0, 2.0], [0.0, 0.0]).coefficients()
    assert np.array_equal(a, [4, 0, 5, 0])
    assert np.array_equal(c, [0, 0])


def test_a_rigid_body_mode_is_a_pair_of_poles_at_0():
    a, c = phc.ph(np.diag([0.0, 4.0, 1.0, 1.0]), [0.0, 0.0, 3.0, 1.0]).modes.coefficients()
    # 9/s + s/(s^2 + 4) = (10 s^3 + 36 s)/(s^4 + 4 s^2)
    assert np.allclose(a, [0, 0, 4, 0], rtol=8 * EPS, atol=0) and np.allclose(c, [10, 36], rtol=8 * EPS, atol=0)


def test_coefficients_need_one_port():
    modes = phc.ph(np.eye(2), np.eye(2)).modes
    for call in (modes.coefficients, modes.scaled_coefficients):
        with pytest.raises(phc.StructureError, match="one-port; this system has 2 ports"):
            call()


@pytest.mark.parametrize("name", SPECTRA)
def test_cofactors_are_the_products_of_all_modes_but_one(name):
    d = np.array(SPECTRA[name])
    rows = engine.cofactors(d)
    for l, row in enumerate(rows):
        others = np.delete(d, l)
        exact, _ = coefficients(others, np.zeros(len(others)))
        truth = [*exact, Fraction(1)]
        assert max(abs(float(Fraction(x) / t - 1)) for x, t in zip(row.tolist(), truth, strict=True)) < 16 * EPS


# --- backwards -----------------------------------------------------------------------------------------------------


def roots_of(a, c, near):
    """What the rounded coefficients themselves say: frequencies and residues, by Newton's rule with many digits."""
    with mp.workdps(60):
        P = [mp.mpf(x) for x in [*a[0::2].tolist(), 1.0]]
        N = [mp.mpf(x) for x in c[::-1].tolist()]
        x = [-(mp.mpf(v) ** 2) for v in near.tolist()]

        def value(coefficients, t):
            return mp.fsum(q * t**k for k, q in enumerate(coefficients))

        slope = [k * q for k, q in enumerate(P)][1:]
        for _ in range(12):
            x = [t - value(P, t) / value(slope, t) for t in x]
        assert max(abs(value(P, t) / value(slope, t) / t) for t in x) < mp.mpf(10) ** -40
        assert all(s < t for t, s in pairwise(x)), "two starts ran into one root"
        return [mp.sqrt(-t) for t in x], [value(N, t) / value(slope, t) for t in x]


def worst(found, truth):
    return max(float(abs(mp.mpf(float(x)) / t - 1)) for x, t in zip(found, truth, strict=True))


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 5, 10, 20])
@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_modes_from_coefficients_are_as_good_as_the_coefficients(n, spacing, scale):
    d = scale * (np.linspace(1, 10, n) if spacing == "linear" else np.logspace(0, 1, n))
    a, c = phc.modes(d, weights(n)).coefficients()
    found = phc.ModalForm.from_coefficients(a, c)
    truth_d, truth_kappa = roots_of(a, c, d)
    # the coefficients as given are solved to the last places ..
    assert worst(found.d, truth_d) < 4 * EPS
    assert worst(found.kappa, truth_kappa) < 8 * EPS
    # .. so the error is what their rounding costs, and the estimate of that is honest
    floor = max(float(abs(t / mp.mpf(x) - 1)) for x, t in zip(d.tolist(), truth_d, strict=True))
    error = np.max(np.abs(found.d / d - 1))
    assert error <= 10 * floor + 4 * EPS
    assert error <= 4 * 10.0 ** -engine.digits(d)


def test_the_floor_is_what_it_is_known_to_be():
    floors = {}
    for n in (10, 20):
        d = np.linspace(1.1, 11, n)
        truth, _ = roots_of(*phc.modes(d, weights(n)).coefficients(), d)
        floors[n] = max(float(abs(t / mp.mpf(x) - 1)) for x, t in zip(d.tolist(), truth, strict=True))
    assert 1e-14 < floors[10] < 1e-12
    assert 1e-9 < floors[20] < 1e-6


@pytest.mark.parametrize("n", [25, 30, 40])
def test_coefficients_that_tell_fewer_than_four_digits_are_refused_with_the_figure(n):
    a, c = phc.modes(np.linspace(1, 10, n), weights(n)).coefficients()
    with pytest.raises(phc.StructureError, match=r"the coefficients carry (no digit|[0-3]\.\d digits) of the freq"):
        phc.ModalForm.from_coefficients(a, c)


def test_a_repeated_frequency_is_refused():
    a, c = phc.modes([1.0, 1.0, 2.0], [1.0, 1.0, 1.0]).coefficients()
    with pytest.raises(phc.StructureError, match="the coefficients carry no digit"):
        phc.ModalForm.from_coefficients(a, c)


def test_a_negative_residue_is_named():
    with pytest.raises(phc.NotLosslessError, match="residue -1 of the pole 1i is negative"):
        phc.ModalForm.from_coefficients([1.0, 0.0], [-1.0])


@pytest.mark.parametrize(
    ("a", "c", "message"),
    [
        ([1.0, 0.0, 1.0], [1.0], "a has 3 entries and c has 1"),
        ([1.0, 0.1], [1.0], r"a\[1\] is 0.1, expected 0"),
        ([-1.0, 0.0], [1.0], r"a\[0\] is -1, expected > 0"),
        ([np.nan, 0.0], [1.0], "not finite"),
    ],
)
def test_coefficients_of_another_form_are_refused(a, c, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.ModalForm.from_coefficients(a, c)


def test_no_coefficients_are_no_modes():
    assert phc.ModalForm.from_coefficients([], []).n == 0


@relaxed
@given(st.integers(1, 8), st.integers(0, 2**32 - 1), st.sampled_from([1e-9, 1.0, 1e9]))
def test_there_and_back(n, seed, scale):
    rng = np.random.default_rng(seed)
    d = scale * np.cumprod(rng.uniform(1.3, 3.0, n))
    r = 10 ** rng.uniform(-3, 3, n)
    modes = phc.modes(d, r)
    back = phc.ModalForm.from_coefficients(*modes.coefficients())
    cost = 16 * EPS * np.max(engine.amplification(d))
    assert np.max(np.abs(back.d / d - 1)) < cost
    truth_d, truth_kappa = roots_of(*modes.coefficients(), d)
    assert worst(back.d, truth_d) < 4 * EPS
    assert worst(back.kappa, truth_kappa) < 16 * EPS


@relaxed
@given(st.integers(2, 10), st.integers(0, 2**32 - 1))
def test_the_amplification_is_the_first_order_bound_of_the_roots(n, seed):
    """`sum |a_i| x^i / (2 x |P'|)`, from the polynomial itself."""
    d = np.sort(np.random.default_rng(seed).uniform(1.0, 10.0, n))
    with mp.workdps(60):
        x = [mp.mpf(v) ** 2 for v in d.tolist()]
        for l, found in enumerate(engine.amplification(d)):
            slope = mp.fprod(x[j] - x[l] for j in range(n) if j != l)
            bound = mp.fprod(v + x[l] for v in x) / (2 * x[l] * abs(slope))
            assert abs(mp.mpf(float(found)) / bound - 1) < 1e-9

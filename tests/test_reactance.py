"""The reactance of one port between its poles and next to its zeros, and these zeros to twice the digits."""

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import DIGITS, EPS, largest_error, on_axis

import ph_control as phc
from ph_control import ModalForm
from ph_control.modal.reactance import Reactance

relaxed = settings(deadline=None, max_examples=30, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
KINDS = ["even", "wide", "close"]
EXTREME = {
    "tiny frequencies beside one": ([1e-170, 2e-170, 1.0], [1.0, 1.0, 1.0], 0.0),
    "frequencies of all sizes": ([1e-300, 1e-200, 1.0, 1e150], [1.0, 1.0, 1.0, 1.0], 0.0),
    "residues of all sizes": ([1.0, 2.0, 3.0, 4.0], [1e-300, 1e290, 1e-150, 1.0], 0.0),
    "a weak pole at 0": ([1.0, 2.0], [1.0, 1.0], 1e-300),
    "all far from 1": ([1e-200, 2e-200, 5e-200], [1e180, 3e180, 2e180], 0.0),
}


def spectrum(rng, n, kind):
    """Frequencies: spread evenly, over twelve decades, within a millionth, or equal by threes."""
    if kind == "equal":
        return np.sort(np.repeat(rng.uniform(1, 2, n // 3 + 1), 3)[:n])
    x = rng.random(n)
    return np.sort({"even": 1 + 49 * x, "wide": 10 ** (12 * x - 6), "close": 1 + 1e-6 * x}[kind])


def one_port(d, r, kappa_0):
    rigid = np.full((int(kappa_0 > 0), 1), np.sqrt(kappa_0))
    return ModalForm(np.array(d), np.sqrt(r)[:, None] + 0j, rigid, np.array(r))


def places(rng, d, zeros):
    """Anywhere, next to poles, and on and next to zeros; never on a pole."""
    gaps = 10 ** rng.uniform(-16, -1, 12) * rng.choice([-1, 1], 12)
    w = [rng.uniform(0, 1.2 * d[-1], 8), rng.choice(d, 12) * (1 + gaps)]
    if len(zeros):
        w += [rng.choice(zeros, 12) * (1 + gaps), rng.choice(zeros, 4)]
    w = np.concatenate(w)
    return w[~np.isin(w, d) & (w > 0)]


@relaxed
@given(
    st.integers(1, 40), seeds, st.sampled_from(["even", "wide", "close", "equal"]), st.sampled_from([0.0, 1e-9, 2.0])
)
def test_the_reactance_is_right_to_the_last_digits_everywhere_between_the_poles(n, seed, kind, kappa_0):
    rng = np.random.default_rng(seed)
    d, r = spectrum(rng, n, kind), 10 ** rng.uniform(-4, 2, n)
    zeros = one_port(d, r, kappa_0).zeros.imag
    w = places(rng, d, zeros[zeros > 0])
    X = Reactance(d, r, kappa_0)
    values = X(w)
    assert largest_error(values, on_axis(d, r, w, kappa_0)) < 225 * EPS  # 5e-14
    assert np.array_equal(X(-w), -values)
    # found zeros are kept, and change nothing
    assert np.array_equal(X(w), values)


@pytest.mark.parametrize("n", [255, 256, 257, 3000])
def test_many_equal_terms_add_up_without_a_drift(n):
    d, r = np.linspace(1.0, 1.0 + 1e-9, n), np.full(n, 1 / 3)
    w = np.array([0.5, 0.999, 1.001, 7.0])
    assert largest_error(Reactance(d, r, 0.0)(w), on_axis(d, r, w)) < 32 * EPS


@relaxed
@given(st.integers(0, 9), st.integers(0, 50), seeds)
def test_differences_and_sums_of_frequencies_are_rounded_once(n, points, seed):
    rng = np.random.default_rng(seed)
    d, w = np.sort(10 ** rng.uniform(-9, 9, n)), 10 ** rng.uniform(-9, 9, points) * rng.choice([-1, 1], points)
    blocks = [table.copy() for _, table in Reactance(d, np.ones(n), 0.0)._blocks(w)]
    table = np.concatenate([np.zeros((n, 0)), *blocks], axis=1)
    assert np.array_equal(table, 1.0 / ((d[:, None] - w) * (d[:, None] + w)))


@pytest.mark.parametrize("kappa_0", [0.0, 3.0])
def test_at_a_pole_the_reactance_is_not_finite_and_beside_it_it_is(kappa_0):
    d = np.array([1.0, 2.0, 2.0, 3.0])
    X = Reactance(d, np.ones(4), kappa_0)
    assert not np.isfinite(X(np.array([1.0, -2.0, 3.0]))).any()
    assert np.isfinite(X(np.nextafter(d, 9.0))).all() and np.isfinite(X(np.nextafter(-d, 0.0))).all()
    assert np.isfinite(X(np.zeros(1)))[0] == (kappa_0 == 0)
    assert X(np.array([0.0, 0.5]))[1] == X(np.array([0.5]))[0]
    # beside a pole at 0, tiny frequencies take the other way
    assert X._moderate(np.array([0.0, 0.5])) and X._moderate(np.array([1e-100, 0.5])) == (kappa_0 == 0)
    assert largest_error(X(np.array([1e-100])), on_axis(d, np.ones(4), [1e-100], kappa_0)) < 8 * EPS


@relaxed
@given(st.integers(2, 30), seeds, st.sampled_from(KINDS), st.booleans())
def test_zeros_are_known_to_twice_the_digits_after_one_step(n, seed, kind, at_zero):
    rng = np.random.default_rng(seed)
    d, r = np.unique(spectrum(rng, n, kind)), 10 ** rng.uniform(-9, 9, n)
    kappa_0 = 0.5 if at_zero else 0.0
    X = Reactance(d, r[: len(d)], kappa_0)
    high, low = X._zeros_between(np.arange(len(X._poles) - 1))
    with mp.workdps(DIGITS):
        kappa = [mp.mpf(a) * mp.mpf(b) for a, b in zip(d.tolist(), r[: len(d)].tolist(), strict=True)]
        terms = [(mp.mpf(kappa_0), mp.mpf(0))] * at_zero + [
            (k, mp.mpf(x)) for k, x in zip(kappa, d.tolist(), strict=True)
        ]
        for a, b in zip(high.tolist(), low.tolist(), strict=True):
            w = mp.mpf(a) + mp.mpf(b)
            step = sum(k / (x**2 - w**2) for k, x in terms) / sum(2 * w * k / (x**2 - w**2) ** 2 for k, x in terms)
            assert abs(step) < 1e-26 * w


@relaxed
@given(st.integers(2, 12), seeds)
def test_next_to_zeros_close_to_weak_poles_the_response_keeps_its_digits(n, seed):
    rng = np.random.default_rng(seed)
    d, r = np.sort(rng.uniform(1.0, 100.0, n)), 10 ** rng.uniform(-300, 0, n)
    # zeros nearer to a pole than the next double
    r[rng.choice(n, 2, replace=False)] = 1e-250, 1.0
    near = np.concatenate([d, 0.5 * (d[1:] + d[:-1])])
    w = np.concatenate([np.nextafter(near, 0.0), np.nextafter(near, np.inf), near * (1 + 1e-13)])
    with mp.workdps(DIGITS):
        kappa = [mp.mpf(a) * mp.mpf(b) for a, b in zip(d.tolist(), r.tolist(), strict=True)]
        for x, found in zip(w.tolist(), phc.modes(d, r).freqresp(w).imag.tolist(), strict=True):
            if x in d:
                continue
            terms = [k * x / ((mp.mpf(a) - x) * (mp.mpf(a) + x)) for k, a in zip(kappa, d.tolist(), strict=True)]
            if abs(sum(terms)) > 1e-15 * sum(map(abs, terms)):
                assert abs(found / sum(terms) - 1) < 5e-14


@pytest.mark.parametrize("name", EXTREME)
def test_zeros_of_extreme_numbers_are_refused_and_responses_are_not(name):
    d, r, kappa_0 = EXTREME[name]
    modes = one_port(d, r, kappa_0)
    w = np.concatenate([1.1 * np.array(d), 0.9 * np.array(d)])
    w = w[w > 1e-200 * max(d)]
    assert largest_error(modes.freqresp(w).imag, on_axis(d, r, w, kappa_0)) < 5e-14
    assert not np.isnan(modes.freqresp(np.concatenate([d, [0.0, 1e-320, 1e300]]))).any()
    if name == "all far from 1":
        assert np.all((modes.zeros.imag[-2:] > d[:-1]) & (modes.zeros.imag[-2:] < d[1:]))
        return
    with pytest.raises(phc.StructureError, match="leave out modes that are out of all scale"):
        modes.zeros  # noqa: B018

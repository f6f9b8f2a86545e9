"""Statistics of residuals against formulas, dense regressions and chance: correlations, their bands, and influence."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, chi2, f, kstest

from ph_control.identification.uncertainty import residual_tests
from ph_control.identification.uncertainty.residual_tests import (
    ResidualData,
    autocorrelation,
    cross_correlation,
    influence,
    ljung_box,
)

EPS = np.finfo(float).eps
# p-values of n draws stay this close to uniform in 999 of 1000 seedings (Kolmogorov)
KOLMOGOROV = 1.95


def colour(rng, samples, pole):
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(samples + 200))[200:]


def residual_data(e, u=None, directions=None, lags=10):
    u = np.random.default_rng(9).standard_normal(len(e)) if u is None else u
    return ResidualData(e, u, np.zeros((len(e), 0)) if directions is None else directions, lags)


def test_without_gaps_and_fitting_the_statistic_is_that_of_Ljung_and_Box():
    e = np.random.default_rng(0).standard_normal(150)
    rho = np.array([np.sum(e[k:] * e[:-k]) for k in range(1, 11)]) / np.sum(e**2)
    statistic = 150 * 152 * np.sum(rho**2 / (150 - np.arange(1, 11)))
    found, value, p = autocorrelation(residual_data(e), 0.95)
    assert value == pytest.approx(statistic, rel=1e-12)
    assert p == pytest.approx(chi2.sf(statistic, 10), rel=1e-9)
    np.testing.assert_allclose(found.values, rho * 150 / found.pairs, rtol=1e-12)
    np.testing.assert_allclose(found.band, 1.959964 * np.sqrt(150 / (found.pairs * 152)), rtol=1e-6)


def test_gaps_leave_the_pairs_that_there_are():
    e = np.random.default_rng(0).standard_normal(90)
    e[1::3] = np.nan
    found = autocorrelation(residual_data(e, lags=6), 0.95)[0]
    seen = ~np.isnan(e)
    for lag, value, pairs in zip(found.lags, found.values, found.pairs, strict=True):
        products = [e[k] * e[k - lag] for k in range(lag, 90) if seen[k] and seen[k - lag]]
        assert pairs == len(products)
        assert value == pytest.approx(np.mean(products) / np.nanmean(e**2), rel=1e-10)
    e[1::2] = np.nan
    e[::2] = 1.0
    found, statistic, p = autocorrelation(residual_data(e, lags=3), 0.95)
    assert np.isnan(found.values).tolist() == [True, False, True]
    assert np.isfinite(statistic) and 0 <= p <= 1


def test_the_cross_correlation_is_that_of_residuals_with_the_input_before_them():
    rng = np.random.default_rng(1)
    e, u = rng.standard_normal((2, 80))
    e[[3, 40]] = np.nan
    found = cross_correlation(residual_data(e, u, lags=4), 0.99)
    e_c, u_c = e - np.nanmean(e), u - u.mean()
    for lag, value in zip(found.lags, found.values, strict=True):
        products = [e_c[k] * u_c[k - lag] for k in range(80) if 0 <= k - lag < 80 and not np.isnan(e[k])]
        expected = np.mean(products) / np.sqrt(np.nanmean(e_c**2) * np.mean(u_c**2))
        assert value == pytest.approx(expected, rel=1e-9, abs=1e-14)


def test_moments_of_the_autocorrelation_of_projected_noise_are_those_of_chance():
    """The mean and spread that the bands use, against 4000 draws: a tenth of the record is fitted."""
    rng = np.random.default_rng(2)
    k = np.arange(60)
    directions = np.stack([np.cos(0.3 * k), np.sin(0.3 * k), np.cos(1.1 * k), np.sin(1.1 * k), np.ones(60)]).T
    noise = rng.standard_normal((60, 4000))
    basis = np.linalg.qr(directions)[0]
    e = noise - basis @ (basis.T @ noise)
    raw = np.array([np.sum(e[lag:] * e[:-lag], axis=0) for lag in (1, 2, 3)]) / np.sum(e**2, axis=0)
    found = [autocorrelation(residual_data(column, directions=directions, lags=3), 0.95)[0] for column in e.T[:50]]
    mean = raw[:, :50].T * 60 / found[0].pairs - np.array([one.values for one in found])
    np.testing.assert_allclose(mean, mean[:1].repeat(50, axis=0), atol=1e3 * EPS)
    error = raw.std(axis=1) / np.sqrt(4000) * 60 / found[0].pairs
    assert np.all(np.abs(raw.mean(axis=1) * 60 / found[0].pairs - mean[0]) < 4 * error)
    spread = found[0].band / 1.959964
    np.testing.assert_allclose(raw.std(axis=1) * 60 / found[0].pairs, spread, rtol=4 / np.sqrt(2 * 4000))
    # the correction is no trifle here
    assert np.max(np.abs(mean[0]) / spread) > 0.3


# --- residuals: chance -----------------------------------------------------------------------------------------------


def null_draws(runs, samples, lags, *, e_pole=0.0, u_pole=0.0, missing=0.0):
    """p-values (whiteness, offset, response, feedback), and parts of the lags outside 95 % bands."""
    p_values, outside = [], []
    for seed in range(runs):
        rng = np.random.default_rng([7, seed])
        e, u = colour(rng, samples, e_pole), colour(rng, samples, u_pole)
        e[rng.random(samples) < missing] = np.nan
        data = residual_data(e, u, lags=lags)
        auto, _, white = autocorrelation(data, 0.95)
        cross, causes = cross_correlation(data, 0.95), influence(data)
        p_values.append([white, causes.offset, causes.response, causes.feedback])
        outside.append([auto.outside / lags, cross.outside / (2 * lags + 1)])
    return np.array(p_values), np.mean(outside, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("samples, lags, missing", [(40, 5, 0.0), (60, 6, 0.25), (300, 20, 0.1)])
def test_p_values_of_white_residuals_are_uniform_and_bands_cover(samples, lags, missing):
    p_values, outside = null_draws(300, samples, lags, missing=missing)
    for column in p_values.T:
        assert kstest(column, "uniform").statistic * np.sqrt(300) < KOLMOGOROV
    # of 300 (2 L + 1) correlations, nearly independent, 5 % are outside
    assert np.all(np.abs(outside - 0.05) < 0.012)


@pytest.mark.slow
def test_bands_and_p_values_hold_where_residuals_and_input_are_both_coloured():
    p_values, outside = null_draws(150, 500, 20, e_pole=0.8, u_pole=0.8)
    for column in p_values.T[1:]:
        assert kstest(column, "uniform").statistic * np.sqrt(150) < KOLMOGOROV
    # a band of 1.96/sqrt(T), made for white signals, would be left by 35 % of the correlations
    assert outside[1] == pytest.approx(0.05, abs=0.02)
    assert p_values[:, 0].max() < 1e-6 and outside[0] > 0.3


# --- several records -------------------------------------------------------------------------------------------------


def two_records(seed=0, missing=0.0):
    """Residual data of two records with one direction fitted to both, and one to each."""
    rng = np.random.default_rng(seed)
    lengths = (50, 34)
    e, u = rng.standard_normal(84), rng.standard_normal(84)
    e[rng.random(84) < missing] = np.nan
    shared = np.cos(0.4 * np.arange(84))[:, None]
    local = tuple(np.cos(1.3 * np.arange(length))[:, None] for length in lengths)
    return e, u, shared, lengths, local


def projected(noise, shared, lengths, local):
    """What is left of noise beside all directions, each record's own standing where the record does."""
    columns = np.zeros((84, 3))
    columns[:, :1] = shared
    columns[:50, 1:2], columns[50:, 2:] = local
    Q = np.linalg.qr(columns)[0]
    return noise - Q @ (Q.T @ noise)


def test_pairs_of_samples_are_those_within_each_record():
    e, u, _, lengths, _ = two_records(missing=0.2)
    none = np.zeros((84, 0))
    data = ResidualData(e, u, none, 5, lengths)
    auto, cross = autocorrelation(data, 0.95)[0], cross_correlation(data, 0.95)
    parts = [(e[:50], u[:50]), (e[50:], u[50:])]
    for lag, value, pairs in zip(auto.lags, auto.values, auto.pairs, strict=True):
        products = [a[k] * a[k - lag] for a, _ in parts for k in range(lag, len(a))]
        products = [product for product in products if not np.isnan(product)]
        assert pairs == len(products)
        assert value == pytest.approx(np.mean(products) / np.nanmean(e**2), rel=1e-9)
    centred = [(a - np.nanmean(a), v - v.mean()) for a, v in parts]
    size = np.sqrt(
        np.nanmean(np.concatenate([a for a, _ in centred]) ** 2) * np.mean(np.concatenate([v for _, v in centred]) ** 2)
    )
    for lag, value, pairs in zip(cross.lags, cross.values, cross.pairs, strict=True):
        products = [a[k] * v[k - lag] for a, v in centred for k in range(len(a)) if 0 <= k - lag < len(a)]
        products = [product for product in products if not np.isnan(product)]
        assert pairs == len(products)
        assert value == pytest.approx(np.mean(products) / size, rel=1e-9, abs=1e-14)


def test_moments_of_projected_noise_in_several_records_are_those_of_chance():
    _, u, shared, lengths, local = two_records()
    rng = np.random.default_rng(1)
    e = projected(rng.standard_normal((84, 4000)), shared, lengths, local)
    raw = np.array(
        [np.sum(e[lag:50] * e[: 50 - lag], axis=0) + np.sum(e[50 + lag :] * e[50:-lag], axis=0) for lag in (1, 2, 3)]
    )
    raw = raw / np.sum(e**2, axis=0)
    found = [autocorrelation(ResidualData(one, u, shared, 3, lengths, local), 0.95)[0] for one in e.T[:20]]
    per_pair = 84 / found[0].pairs
    mean = raw[:, :20].T * per_pair - np.array([one.values for one in found])
    np.testing.assert_allclose(mean, mean[:1].repeat(20, axis=0), atol=1e3 * EPS)
    assert np.all(np.abs(raw.mean(axis=1) * per_pair - mean[0]) < 4 * raw.std(axis=1) / np.sqrt(4000) * per_pair)
    np.testing.assert_allclose(raw.std(axis=1) * per_pair, found[0].band / 1.959964, rtol=4 / np.sqrt(2 * 4000))
    # the correction is no trifle here
    assert np.max(np.abs(mean[0]) * 1.959964 / found[0].band) > 0.1


def test_the_tests_of_influence_are_those_of_dense_regressions():
    """White residuals of two records: regressors built one by one, F tests from two sums of squares."""
    noise, u, shared, lengths, local = two_records(seed=3)
    e, L = projected(noise, shared, lengths, local), 4
    data = ResidualData(e, u, shared, L, lengths, local)
    found = influence(data)
    assert found.noise_order == 0
    blocks = [[], [], [], []]
    for start, stop, own in ((0, 50, local[0]), (50, 84, local[1])):
        v = u[start:stop] - u[start:stop].mean()
        whole = np.zeros((84, 1))
        whole[start:stop] = own
        blocks[0].append(whole)
        mean = np.zeros((84, 1))
        mean[start:stop] = 1.0
        blocks[1].append(mean)
        for kind, lags in ((2, range(L + 1)), (3, range(-L, 0))):
            shifted = np.zeros((84, len(lags)))
            for column, lag in enumerate(lags):
                for k in range(stop - start):
                    if 0 <= k - lag < stop - start:
                        shifted[start + k, column] = v[k - lag]
            blocks[kind].append(shifted)
    steps = [
        np.column_stack([shared, *blocks[0]]), np.column_stack(blocks[1]), blocks[2][0] + blocks[2][1],
        blocks[3][0] + blocks[3][1],
    ]  # fmt: skip
    sums, ranks = [], []
    for count in range(1, 5):
        X = np.column_stack(steps[:count])
        left = e - X @ np.linalg.lstsq(X, e)[0]
        sums.append(left @ left)
        ranks.append(np.linalg.matrix_rank(X))
    expected = [
        f.sf(
            (sums[k - 1] - sums[k]) / (ranks[k] - ranks[k - 1]) / (sums[k] / (84 - ranks[k])),
            ranks[k] - ranks[k - 1],
            84 - ranks[k],
        )
        for k in (1, 2, 3)
    ]
    np.testing.assert_allclose([found.offset, found.response, found.feedback], expected, rtol=1e-8)


def test_a_long_record_worked_in_pieces_gives_the_statistics_of_one_worked_whole(monkeypatch):
    rng = np.random.default_rng(4)
    e, u = lfilter([1.0], [1.0, -0.5], rng.standard_normal((2, 700)))
    data = [ResidualData(e, u, rng.standard_normal((700, 3)), 12) for _ in range(2)]
    data[1] = ResidualData(e, u, data[0].directions, 12)
    whole = autocorrelation(data[0], 0.99), cross_correlation(data[0], 0.99), influence(data[0])
    monkeypatch.setattr(residual_tests, "_PIECE", 64)
    monkeypatch.setattr(residual_tests, "_ROWS", 90)
    monkeypatch.setattr(residual_tests, "_TOGETHER", 1500)
    monkeypatch.setattr(residual_tests, "_CACHED", 100)
    pieces = autocorrelation(data[1], 0.99), cross_correlation(data[1], 0.99), influence(data[1])
    assert pieces[0][1:] == pytest.approx(whole[0][1:], rel=1e-9)
    np.testing.assert_allclose(pieces[0][0].band, whole[0][0].band, rtol=1e-10)
    np.testing.assert_allclose(pieces[1].band, whole[1].band, rtol=1e-10)
    np.testing.assert_allclose(pieces[1].values, whole[1].values, atol=1e-13)
    assert vars(pieces[2]) == pytest.approx(vars(whole[2]), rel=1e-8)
    assert whole[2].noise_order >= 1


def test_the_p_value_of_a_fit_counts_gaps_as_gaps():
    e = np.random.default_rng(0).standard_normal(400)
    e[::2] = np.nan
    # every other sample: only even lags have pairs, and those are as many as half the record gives
    compressed = ljung_box([e[1::2]], 10)
    assert ljung_box([e], 20) == pytest.approx(compressed, rel=0.1)
    assert ljung_box([np.zeros(50)], 5) == 1.0 == ljung_box([np.full(50, np.nan)], 5) == ljung_box([np.ones(3)], 5)
    slow = lfilter([1.0], [1.0, -0.8], np.random.default_rng(1).standard_normal(200))
    assert ljung_box([slow[:100], slow[100:]], 10) < 1e-9


def test_experiments_of_very_different_noise_are_told_by_no_more_chance_than_others():
    """Were they added up as they are, the loud one would stand for all, and its pairs be too few for the band."""
    refused, runs = 0, 150
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        parts = [10.0 * rng.standard_normal(40), rng.standard_normal(400)]
        refused += ljung_box(parts, 10) < 0.05
    assert refused <= binom.isf(1e-3, runs, 0.05)

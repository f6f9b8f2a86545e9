"""Intervals, draws and bands, against closed forms, numerical integrals, mpmath and brute force."""

import copy
import math
import pickle

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lossless import lossless_draws
from reference import DIGITS, EPS, foster_zeros, on_axis
from scipy.stats import kstest, norm, truncnorm
from slow import slowly

import ph_control as phc
from ph_control.identification.uncertainty import draws as module
from ph_control.identification.uncertainty.draws import draw, normal_interval

relaxed = settings(deadline=None, max_examples=13, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
levels = st.sampled_from([0.5, 0.68, 0.95, 0.999])
NOT_A_LEVEL = [0, 1, -0.1, 1.5, np.nan, np.inf, None, "0.95", True]

# chance of refusing what is right in a test of a distribution, with seeds that never change
UNLIKELY = 1e-3


def random_covariance(size, rank, rng):
    A = rng.standard_normal((size, rank))
    return A @ A.T


# --- intervals -------------------------------------------------------------------------------------------------------


@relaxed
@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3), st.floats(0.01, 0.9999))
def test_a_normal_interval_holds_its_level_of_the_normal_distribution(value, stderr, level):
    low, high = normal_interval(value, stderr, level)
    rounding = 8 * EPS * (abs(value) + 4 * stderr) / stderr
    assert abs(math.erf((high - value) / stderr / math.sqrt(2)) - level) < rounding + 8 * EPS
    assert abs((high - value) - (value - low)) <= 4 * EPS * (abs(value) + 4 * stderr)


def test_an_interval_is_cut_off_at_the_bound_and_left_alone_above_it():
    free = normal_interval([5.0, 1.0, 0.0], 1.0, 0.95)
    cut = normal_interval([5.0, 1.0, 0.0], 1.0, 0.95, lower=0.0)
    assert np.array_equal(cut[0], free[0]) and np.array_equal(cut[:, 1], free[:, 1])
    assert np.array_equal(cut[1:, 0], [0.0, 0.0]) and np.all(free[1:, 0] < 0)
    each = normal_interval([5.0, 1.0, 0.0], 1.0, 0.95, lower=[-np.inf, -0.5, 0.0])
    assert np.array_equal(each[:, 0], [free[0, 0], -0.5, 0.0])


def test_intervals_of_what_is_held_exact_or_unknown():
    interval = normal_interval([1.0, 2.0, 3.0], [np.nan, 0.0, np.inf], 0.95, lower=0.0)
    assert np.array_equal(interval, [[np.nan, np.nan], [2.0, 2.0], [0.0, np.inf]], equal_nan=True)


def test_intervals_keep_the_shape_and_the_arguments():
    value, stderr = np.arange(6.0).reshape(2, 3), np.ones(3)
    before = value.copy(), stderr.copy()
    interval = normal_interval(value, stderr, 0.9)
    assert interval.shape == (2, 3, 2)
    assert np.array_equal(interval[1, 2], normal_interval(5.0, 1.0, 0.9))
    assert np.array_equal(value, before[0]) and np.array_equal(stderr, before[1])
    assert normal_interval([], [], 0.9).shape == (0, 2)


@pytest.mark.parametrize("level", NOT_A_LEVEL)
def test_a_level_is_a_number_between_0_and_1(level):
    samples = lossless_draws([[1.0], [2.0]], [[1.0], [1.0]])
    bands = (samples.magnitude_band, samples.phase_band, samples.step_band, samples.impulse_band)
    calls = [lambda: normal_interval(0.0, 1.0, level), *(lambda band=band: band([0.5], level) for band in bands)]
    for call in calls:
        with pytest.raises(phc.StructureError, match=r"level is .* between 0 and 1"):
            call()


# --- draws without restrictions --------------------------------------------------------------------------------------


@relaxed
@given(st.integers(1, 6), st.integers(1, 6), seeds)
def test_draws_have_the_mean_and_the_covariance_in_whatever_units(size, rank, seed):
    rng = np.random.default_rng(seed)
    C = random_covariance(size, min(rank, size), rng)
    units = 10.0 ** rng.integers(-9, 10, size)
    mean = units * rng.standard_normal(size)
    k = 4000
    x = (draw(mean, C * units[:, None] * units, k, seed) - mean) / units / np.sqrt(np.diag(C))
    R = C / np.sqrt(np.outer(np.diag(C), np.diag(C)))
    assert np.abs(x.mean(axis=0)).max() < 5 / np.sqrt(k)
    # the variance of a product of two normal numbers of variance 1 is at most 2
    assert np.abs(x.T @ x / k - R).max() < 5 * np.sqrt(2 / k)


@relaxed
@given(st.integers(1, 5), seeds)
def test_draws_follow_a_change_of_units_exactly(size, seed):
    rng = np.random.default_rng(seed)
    C, mean = random_covariance(size, size, rng), np.abs(rng.standard_normal(size))
    units = 2.0 ** rng.integers(-400, 400, size)
    mask = rng.random(size) < 0.5
    plain = draw(mean, C, 20, seed, nonnegative=mask)
    assert np.array_equal(draw(units * mean, C * units[:, None] * units, 20, seed, nonnegative=mask), units * plain)


@relaxed
@given(st.integers(2, 8), seeds)
def test_draws_stay_in_the_directions_that_have_variance(size, seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((size, size - 1))
    C, (null, *_) = A @ A.T, np.linalg.svd(A.T)[2][::-1]
    x = draw(np.zeros(size), C, 200, seed)
    assert np.abs(x @ null).max() < 8 * size * np.linalg.cond(A) ** 2 * EPS * np.abs(x).max()
    z = x @ np.linalg.pinv(A).T
    assert np.abs(z.T @ z / 200 - np.eye(size - 1)).max() < 5 * np.sqrt(2 / 200)


def test_held_components_and_those_without_variance_stay_at_their_mean():
    C = np.full((4, 4), np.nan)
    C[np.ix_([0, 2], [0, 2])] = [[4.0, 1.0], [1.0, 1.0]]
    C[3, [0, 2, 3]] = C[[0, 2, 3], 3] = 0.0
    mean = np.array([1.0, 1 / 3, 2.0, 0.1])
    x = draw(mean, C, 4000, 0, nonnegative=[False, True, False, True])
    assert np.all(x[:, [1, 3]] == mean[[1, 3]])
    free = draw(mean[[0, 2]], [[4.0, 1.0], [1.0, 1.0]], 4000, 0)
    assert np.array_equal(x[:, [0, 2]], free)
    assert abs(np.corrcoef(free.T)[0, 1] - 0.5) < 5 / np.sqrt(4000)


@pytest.mark.parametrize("C", [np.zeros((3, 3)), np.full((3, 3), np.nan)])
def test_without_any_variance_every_draw_is_the_mean(C):
    mean = np.array([1e-9, 0.0, 1e9])
    x = draw(mean, C, 5, 0, nonnegative=[True] * 3, positive=[True, False, True])
    assert np.array_equal(x, np.repeat(mean[None], 5, axis=0))


@pytest.mark.parametrize("k", [0, 1, 7, np.int64(3)])
def test_as_many_draws_as_asked_for(k):
    mask = [True, False]
    assert draw([1.0, 2.0], np.eye(2), k, 0, nonnegative=mask).shape == (k, 2)
    wedge = draw([1e-6, 1e-6], [[1, -1], [-1, 1]], k, 0, nonnegative=[True, True])
    assert wedge.shape == (k, 2)
    assert draw([], np.empty((0, 0)), k, 0).shape == (k, 0)


# --- draws with restrictions -----------------------------------------------------------------------------------------


@relaxed
@given(st.integers(1, 6), st.integers(1, 6), seeds)
def test_draws_respect_the_restrictions(size, rank, seed):
    rng = np.random.default_rng(seed)
    C = random_covariance(size, min(rank, size), rng)
    weak, strict = rng.random((2, size)) < 0.5
    mean = 10.0 ** rng.uniform(-6, 1, size) * np.where(rng.random(size) < 0.2, 1.0 - strict, 1.0)
    mean = np.where(strict, np.maximum(mean, 1e-6), mean)
    x = draw(mean, C, 50, seed, nonnegative=weak, positive=strict)
    assert np.isfinite(x).all()
    assert np.all(x[:, weak] >= 0)
    assert np.all(x[:, strict] > 0)


@pytest.mark.variants
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("ratio", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("rounds", [100, 0])
def test_one_restricted_component_follows_the_truncated_normal_distribution(monkeypatch, rounds, ratio, scale):
    monkeypatch.setattr(module, "_ROUNDS", rounds)
    x = draw([ratio * scale], [[scale**2]], 4000, 3, nonnegative=[True])[:, 0] / scale
    assert kstest(x, truncnorm(-ratio, np.inf, loc=ratio).cdf).pvalue > UNLIKELY
    # the test can tell it from draws moved to the bound, and from draws that are folded there
    normal = ratio + np.random.default_rng(3).standard_normal(4000)
    if ratio < 1:
        assert kstest(np.maximum(normal, 0), truncnorm(-ratio, np.inf, loc=ratio).cdf).pvalue < 1e-6
    if ratio == 0.3:
        assert kstest(np.abs(normal), truncnorm(-ratio, np.inf, loc=ratio).cdf).pvalue < 1e-2


def distribution_function(density, end):
    """Of a density on an interval from 0, by the midpoint rule."""
    grid = np.linspace(0, end, 100_001)
    mass = np.concatenate([[0.0], np.cumsum(density(0.5 * (grid[:-1] + grid[1:])))])
    return lambda x: np.interp(x, grid, mass / mass[-1])


def first_marginal(mean, rho):
    """Distribution function of the first of two normal numbers of variance 1, both restricted to >= 0."""

    def density(x):
        return norm.pdf(x - mean[0]) * norm.cdf((mean[1] + rho * (x - mean[0])) / math.sqrt(1 - rho**2))

    return distribution_function(density, mean[0] + 9)


@pytest.mark.variants
@pytest.mark.parametrize("rounds", [100, 0])
@pytest.mark.parametrize("rho", [0.9, *slowly(0.0, -0.8)])
@pytest.mark.parametrize("mean", [(0.0, 0.0), (0.2, 1.5)])
def test_two_correlated_restricted_components_follow_their_distribution(monkeypatch, mean, rho, rounds):
    monkeypatch.setattr(module, "_ROUNDS", rounds)
    x = draw(mean, [[1, rho], [rho, 1]], 4000, 1, nonnegative=[True, True])
    assert kstest(x[:, 0], first_marginal(mean, rho)).pvalue > UNLIKELY
    assert kstest(x[:, 1], first_marginal(mean[::-1], rho)).pvalue > UNLIKELY
    # and so do they together: their correlation is that of the truncated distribution
    mass, first, second, both = (moment(mean, rho, i, j) for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)))
    expected = both / mass - first * second / mass**2
    product = (x[:, 0] - x[:, 0].mean()) * (x[:, 1] - x[:, 1].mean())
    assert abs(product.mean() - expected) < 4 * product.std() / np.sqrt(len(x))


def moment(mean, rho, i, j):
    """Integral of `x^i y^j` over the positive quadrant, with a rule of Gauss and Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(120)
    x, w = 5 * (nodes + 1), 5 * weights
    a, b = x[:, None] - mean[0], x - mean[1]
    density = np.exp(-0.5 * (a * a - 2 * rho * a * b + b * b) / (1 - rho**2))
    return float((w * x**i) @ density @ (w * x**j))


@pytest.mark.variants
@pytest.mark.parametrize("spread, width", [(1e-3, 0.0), (1e-5, 1e-4), (1e-6, 1e-6)])
def test_two_weights_of_which_only_the_sum_is_known_follow_their_distribution(spread, width):
    """Nearly nothing of the normal distribution is allowed, so that drawing again is hopeless."""
    assert norm.pdf(0) * (2 * width + 4 * spread) < 1 / 500
    rho = spread**2 / 2 - 1
    x = draw([width, width], [[1, rho], [rho, 1]], 4000, 7, nonnegative=[True, True])
    assert np.all(x >= 0)
    deviation = spread * math.sqrt(1 - spread**2 / 4)

    def density(x):
        # mean and deviation of the other one given this one, rearranged so that they are not rounded
        return norm.pdf(x - width) * norm.cdf((2 * width - x + spread**2 / 2 * (x - width)) / deviation)

    for column in x.T:
        assert kstest(column, distribution_function(density, 2 * width + 12 * spread)).pvalue > UNLIKELY
        # the chains do not follow one another
        assert abs(np.corrcoef(column[:-1], column[1:])[0, 1]) < 4 / np.sqrt(len(x))


@pytest.mark.variants
@pytest.mark.parametrize("total", [1e-4, 1e-9, 1e-15])
def test_weights_whose_sum_is_known_exactly_keep_it_and_fill_the_segment(total):
    x = draw([0.3 * total, 0.7 * total], [[1, -1], [-1, 1]], 4000, 2, nonnegative=[True, True])
    assert np.all(x >= 0)
    assert np.abs(x.sum(axis=1) - total).max() < 32 * EPS * total
    assert kstest(x[:, 0] / total, "uniform").pvalue > UNLIKELY


def test_rounding_takes_no_draw_across_its_bound(monkeypatch):
    """A sampler at the very edge, whose numbers a rounding has moved over it."""
    mean, C = np.array([1 / 3, 0.1, 1e-9]), np.diag([2.0, 3.0, 1e-20])
    monkeypatch.setattr(module, "_correlated", lambda factor, slack, k, rng: -np.tile(slack, (k, 1)) * (1 + 4 * EPS))
    assert np.array_equal(draw(mean, C, 2, 0, nonnegative=[True] * 3), np.zeros((2, 3)))
    edge = draw(mean, C, 2, 0, positive=[True] * 3)
    assert np.all(edge > 0) and np.all(edge <= EPS * mean)


@pytest.mark.parametrize("low, high", [(9.0, np.inf), (-np.inf, -9.0), (30.0, 30.05), (-0.5, 2.0), (-40.0, -1.0)])
def test_a_move_of_the_sampler_is_a_normal_number_on_an_interval_in_the_tails_too(low, high):
    rng, centre = np.random.default_rng(0), 1.5
    moves = module._normal_between(
        np.full(4000, low + centre), np.full(4000, high + centre), np.full(4000, centre), rng
    )
    assert kstest(moves, truncnorm(low, high, loc=centre).cdf).pvalue > UNLIKELY


@pytest.mark.slow
def test_twenty_weak_weights_are_each_half_a_normal_distribution():
    n, k = 20, 1000
    x = draw(np.zeros(n), np.eye(n), k, 5, nonnegative=np.ones(n, bool))
    assert kstest(x.ravel(), "halfnorm").pvalue > UNLIKELY
    correlations = np.corrcoef(x.T)[np.triu_indices(n, 1)]
    assert np.abs(correlations).max() < 5 / np.sqrt(k)


def test_what_depends_on_a_restricted_component_follows_it():
    """The second is the first plus noise: its mean moves with that of the truncated first."""
    x = draw([0.0, 0.0], [[1, 1], [1, 1.25]], 20000, 0, nonnegative=[True, False])
    half_normal = math.sqrt(2 / math.pi)
    assert abs(x[:, 1].mean() - half_normal) < 5 * x[:, 1].std() / np.sqrt(len(x))
    assert kstest(2 * (x[:, 1] - x[:, 0]), "norm").pvalue > UNLIKELY


def test_components_far_from_their_bound_cost_no_draws():
    """With nothing near a bound the draws are those without restriction, number by number."""
    mean, C = [1e3, 2.0], [[1.0, 5e-3], [5e-3, 1e-4]]
    assert np.array_equal(draw(mean, C, 50, 0, positive=[True, True]), draw(mean, C, 50, 0))


def test_positive_components_stay_positive_however_badly_they_are_known():
    x = draw([1e-9, 1.0], np.diag([1e6, 1.0]), 2000, 0, positive=[True, False])
    assert x[:, 0].min() > 0
    assert x[:, 1].min() < 0
    assert kstest(x[:, 0] / 1e3, "halfnorm").pvalue > UNLIKELY


# --- random numbers and refusals -------------------------------------------------------------------------------------


def test_a_seed_repeats_the_draws_and_a_generator_goes_on():
    arguments = [0.5, 1.0], [[1.0, 0.3], [0.3, 1.0]], 10
    first = draw(*arguments, 1, nonnegative=[True, True])
    assert np.array_equal(first, draw(*arguments, 1, nonnegative=[True, True]))
    assert not np.array_equal(first, draw(*arguments, 2, nonnegative=[True, True]))
    assert not np.array_equal(draw(*arguments), draw(*arguments))
    rng = np.random.default_rng(1)
    assert np.array_equal(first, draw(*arguments, rng, nonnegative=[True, True]))
    assert not np.array_equal(first, draw(*arguments, rng, nonnegative=[True, True]))


def test_the_arguments_of_a_draw_are_not_modified():
    mean, C, mask = np.array([0.1, 0.0]), np.array([[1.0, -0.5], [-0.5, 1.0]]), np.array([True, True])
    before = mean.copy(), C.copy(), mask.copy()
    draw(mean, C, 10, 0, nonnegative=mask, positive=np.array([True, False]))
    for array, copied in zip((mean, C, mask), before, strict=True):
        assert np.array_equal(array, copied)


@pytest.mark.parametrize("k", [-1, 2.0, None, "3", True, np.nan])
def test_the_number_of_draws_is_a_whole_number(k):
    with pytest.raises(phc.StructureError, match=r"k is .* whole number"):
        draw([1.0], [[1.0]], k, 0)


@pytest.mark.parametrize("rng", [-1, "seed", 1.5])
def test_what_gives_no_random_numbers_is_refused(rng):
    with pytest.raises(phc.StructureError, match=r"rng is .* seed"):
        draw([1.0], [[1.0]], 1, rng)


def test_rounding_of_a_covariance_is_allowed():
    drawn = draw([0.0, 0.0], [[1.0, 1.0 + 1e-9], [1.0, 1.0]], 5, 0)
    assert np.allclose(drawn[:, 0], drawn[:, 1], rtol=0, atol=1e-3)


# --- samples as a container ------------------------------------------------------------------------------------------


def random_samples(k, n, seed, *, scale=1.0, spread=0.01):
    """Models with weights over two decades, every fifth of them 0."""
    rng = np.random.default_rng(seed)
    d = scale * np.sort(rng.uniform(1, 10, n)) * (1 + spread * rng.standard_normal((k, n)))
    r = 10 ** rng.uniform(-2, 0, n) * np.exp(spread * rng.standard_normal((k, n)))
    r[:, 4::5] = 0.0
    return lossless_draws(d, r)


def weights_of(samples):
    """Weights `r` of lossless draws, shape (k, n)."""
    return 2 * samples.residues[:, :, 0, 0].real / samples.d


def test_samples_have_a_row_for_each_draw():
    samples = lossless_draws([[1.0, 2.0], [2.5, 1.5], [1.2, 2.2]], np.ones((3, 2)))
    assert len(samples) == 3 and "3 draws of 2 modes" in repr(samples)
    # modes that changed places stay in their columns
    assert np.array_equal(samples.d, [[1.0, 2.0], [2.5, 1.5], [1.2, 2.2]])
    assert np.array_equal(samples.natural_frequencies, samples.d) and not samples.damping_ratios.any()


def test_samples_are_locked_copies():
    poles, residues = np.full((2, 1), 1j), np.full((2, 1, 1, 1), 0.5 + 0j)
    samples = phc.ModalSamples(poles, residues, np.zeros((2, 1, 1)), np.ones((2, 1, 1)))
    poles[0], residues[0] = 7j, 7.0
    assert samples.poles[0] == 1j and samples.residues[0] == 0.5
    for array in (samples.poles, samples.residues, samples.feedthrough, samples.shapes):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
    with pytest.raises(AttributeError):
        samples.poles = poles
    for twin in (copy.deepcopy(samples), pickle.loads(pickle.dumps(samples))):
        assert np.array_equal(twin.step_band([0.5]), samples.step_band([0.5]))


def test_no_draws_have_a_response_of_no_rows_and_no_band():
    samples = lossless_draws(np.empty((0, 2)), np.empty((0, 2)))
    assert len(samples) == 0
    assert samples.freqresp([1.0, 2.0]).shape == (0, 2)
    for band in (samples.magnitude_band, samples.phase_band, samples.step_band, samples.impulse_band):
        with pytest.raises(phc.StructureError, match="no samples"):
            band([1.0])


def test_models_without_modes_have_the_response_0():
    samples = lossless_draws(np.empty((3, 0)), np.empty((3, 0)))
    assert np.array_equal(samples.magnitude_band([0.0, 1.0]), np.zeros((2, 2)))
    assert np.array_equal(samples.step_band([0.0, 1.0]), np.zeros((2, 2)))


def test_no_points_have_a_band_of_no_columns():
    samples = random_samples(5, 2, 0)
    assert samples.freqresp([]).shape == (5, 0)
    for band in (samples.magnitude_band, samples.phase_band, samples.step_band, samples.impulse_band):
        assert band([]).shape == (2, 0)


RIGHT = {
    "poles": [[1j], [2j]], "residues": [[[[0.5]]], [[[1.0]]]], "feedthrough": [[[0.0]], [[0.0]]],
    "shapes": [[[1.0]], [[1.0]]],
}  # fmt: skip


@pytest.mark.parametrize(
    "name, value",
    [
        ("poles", [[1j, 2j]]), ("poles", [1j, 2j]), ("poles", [[np.nan], [1j]]), ("poles", None), ("poles", {}),
        ("poles", 1.0), ("residues", [[0.5], [1.0]]), ("residues", [[[[np.inf]]], [[[1.0]]]]), ("residues", "draws"),
        ("feedthrough", [[[1j]], [[0.0]]]), ("feedthrough", [[[0.0]]]), ("feedthrough", [[[np.nan]], [[0.0]]]),
        ("shapes", [[[1.0]]]), ("shapes", 3.0),
    ],
    ids=repr,
)  # fmt: skip
def test_what_are_no_samples_is_refused(name, value):
    assert len(phc.ModalSamples(**RIGHT)) == 2
    with pytest.raises(phc.StructureError):
        phc.ModalSamples(**RIGHT | {name: value})


@pytest.mark.parametrize("points", [[[1.0]], 1.0, [np.nan], [np.inf], ["a"]])
def test_what_are_no_points_is_refused(points):
    samples = random_samples(5, 2, 0)
    for call in (samples.freqresp, samples.magnitude_band, samples.phase_band, samples.step_band, samples.impulse_band):
        with pytest.raises(phc.StructureError, match=r"omega|time"):
            call(points)


# --- frequency response ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("n", [1, 2, 12])
def test_each_response_is_right_to_the_rounding_of_its_terms_next_to_poles_and_zeros(n, scale):
    samples = random_samples(4, n, n, scale=scale)
    row, weights = samples.d[2], weights_of(samples)
    live = weights[2] > 0
    order = np.argsort(row[live])
    zeros = foster_zeros(row[live][order], (row * weights[2])[live][order])
    w = np.concatenate([np.logspace(-3, 2, 11) * scale, row * (1 + 1e-12), row * (1 - 1e-9), [float(z) for z in zeros]])
    got = samples.freqresp(w)
    assert got.shape == (4, len(w)) and np.all(got.real == 0)
    for i in range(4):
        # at a zero, terms much larger than their sum cancel
        size = np.sum(np.abs(0.5 * weights[i] * samples.d[i] / (w[:, None] - samples.d[i])), axis=1)
        error = [
            float(abs(mp.mpf(a) - b)) for a, b in zip(got[i].imag, on_axis(samples.d[i], weights[i], w), strict=True)
        ]
        assert np.all(error <= 8 * EPS * n * (size + np.abs(got[i])))


@relaxed
@given(st.integers(1, 6), seeds)
def test_each_response_is_that_of_its_modal_form_at_poles_too(n, seed):
    samples = random_samples(3, n, seed)
    weights = weights_of(samples)
    w = np.concatenate([[0.0], samples.d[1], -samples.d[2], np.linspace(0.1, 12, 20)])
    for row, d, r in zip(samples.freqresp(w), samples.d, weights, strict=True):
        expected = phc.modes(d, r).freqresp(w)
        assert np.array_equal(np.isinf(row), np.isinf(expected))
        finite = np.isfinite(row)
        size = np.sum(r * d / np.maximum(np.abs(np.abs(w)[:, None] - d), EPS * d), axis=1)
        assert np.all(np.abs(row[finite] - expected[finite]) <= 32 * EPS * n * size[finite])
    # a pole at exactly this frequency is infinite, unless its weight is 0
    assert np.array_equal(np.isinf(samples.freqresp(w)[1, 1 : n + 1]), weights[1] > 0)


@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_responses_of_any_poles_are_sums_over_poles_and_their_conjugates(delay):
    poles, residues = np.array([-0.1 + 1j, 0.02 + 2j, -0.7, 0.0]), np.array([0.5 - 0.2j, 1j, 0.3, 0.2])
    draws = phc.ModalSamples(
        [poles] * 2, [residues.reshape(4, 1, 1)] * 2, [[[0.4]]] * 2, np.ones((2, 2, 1)), delay=delay
    )
    every, weights = np.append(poles, poles[:2].conj()), np.append(residues, residues[:2].conj())
    w, t = np.array([0.1, 0.5, 2.0, 7.0]), np.array([0.0, 0.3, 4.0, 11.0])
    expected = (np.sum(weights / (1j * w[:, None] - every), axis=1) + 0.4) * np.exp(-1j * w * delay)
    np.testing.assert_allclose(draws.freqresp(w), [expected] * 2, rtol=1e-14)
    np.testing.assert_allclose(draws.magnitude_band(w)[0], np.abs(expected), rtol=1e-14)
    turns = (draws.phase_band(w)[0] - np.degrees(np.angle(expected))) / 360
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-14)
    moved = np.exp(every * t[:, None])
    np.testing.assert_allclose(draws.impulse_band(t + delay)[0], (moved @ weights).real, rtol=1e-13)
    # the pole at 0 integrates the step
    integral = (moved - 1)[:, every != 0] @ (weights / np.where(every == 0, 1, every))[every != 0] + 0.2 * t
    np.testing.assert_allclose(draws.step_band(t + delay)[0], integral.real + 0.4, rtol=1e-13)


def test_equal_frequencies_are_one_mode_with_the_sum_of_the_weights():
    d, r = np.array([[1.0, 1.0, 3.0], [1.1, 1.1, 2.9]]), np.array([[0.2, 0.3, 1.0], [0.25, 0.25, 1.1]])
    apart, merged = lossless_draws(d, r), lossless_draws(d[:, 1:], np.column_stack([r[:, 0] + r[:, 1], r[:, 2]]))
    w, t = np.array([0.5, 1.0, 2.0, 5.0]), np.linspace(0, 10, 7)
    assert np.allclose(apart.freqresp(w).imag, merged.freqresp(w).imag, rtol=32 * EPS, atol=0)
    assert np.allclose(apart.magnitude_band(w), merged.magnitude_band(w), rtol=32 * EPS, atol=0)
    assert np.allclose(apart.impulse_band(t), merged.impulse_band(t), rtol=0, atol=64 * EPS)


# --- bands of the gain and the phase ---------------------------------------------------------------------------------


@relaxed
@given(st.integers(1, 4), st.integers(1, 40), levels, seeds)
def test_the_band_of_the_gain_holds_the_percentiles_of_the_gains(n, k, level, seed):
    samples = random_samples(k, n, seed)
    w = np.linspace(0.1, 12, 30)
    gains = np.abs(samples.freqresp(w))
    expected = np.quantile(gains, [0.5 - level / 2, 0.5 + level / 2], axis=0)
    assert np.allclose(samples.magnitude_band(w, level), expected, rtol=64 * EPS, atol=0)


@relaxed
@given(levels, seeds)
def test_bands_hold_their_share_of_the_draws_and_no_more(level, seed):
    k = 500
    samples = random_samples(k, 3, seed, spread=0.1)
    w, t = np.linspace(0.1, 12, 9), np.linspace(0.1, 9, 9)
    for values, band in (
        (np.abs(samples.freqresp(w)), samples.magnitude_band(w, level)),
        (responses(samples, t, weights_of(samples), np.sin), samples.step_band(t, level)),
        (responses(samples, t, weights_of(samples) * samples.d, np.cos), samples.impulse_band(t, level)),
    ):
        rounding = 1e-12 * np.abs(values).max()
        for outside in (values < band[0] - rounding, values > band[1] + rounding):
            assert np.all(np.abs(outside.sum(axis=0) - k * (1 - level) / 2) <= 1)


def responses(samples, t, amplitudes, wave):
    """`sum_l amplitudes_l wave(d_l t)` of every draw, shape (k, K)."""
    return np.einsum("kl,klt->kt", amplitudes, wave(samples.d[:, :, None] * t))


def test_wider_levels_have_wider_bands():
    samples = random_samples(3000, 2, 3, spread=0.05)
    w, t = np.linspace(0.1, 12, 40), np.linspace(0.1, 9, 40)
    for band, at in ((samples.magnitude_band, w), (samples.step_band, t), (samples.impulse_band, t)):
        narrow, usual, wide = (band(at, level) for level in (0.5, 0.95, 0.999))
        assert np.all(wide[0] < usual[0]) and np.all(usual[0] < narrow[0])
        assert np.all(narrow[1] < usual[1]) and np.all(usual[1] < wide[1])
        assert np.array_equal(band(at), usual)


def test_bands_do_not_depend_on_how_the_points_are_split_in_blocks(monkeypatch):
    samples = random_samples(50, 3, 0)
    w, t = np.linspace(0.1, 12, 101), np.linspace(0, 9, 101)
    bands = samples.magnitude_band, samples.phase_band, samples.step_band, samples.impulse_band
    whole = [band(at) for band, at in zip(bands, (w, w, t, t), strict=True)]
    for block in (1, 333):
        monkeypatch.setattr(module, "_BLOCK", block)
        for band, at, expected in zip(bands, (w, w, t, t), whole, strict=True):
            assert np.array_equal(band(at), expected)


def test_no_table_is_larger_than_a_block(monkeypatch):
    seen = []

    def noted(table, tail):
        seen.append(table.size)
        return original(table, tail)

    original = module._percentiles
    monkeypatch.setattr(module, "_percentiles", noted)
    monkeypatch.setattr(module, "_BLOCK", 1000)
    random_samples(300, 2, 0).magnitude_band(np.linspace(1, 2, 100))
    assert max(seen) <= 1000 and sum(seen) == 300 * 100


@relaxed
@given(st.integers(1, 5), st.integers(1, 9), seeds)
def test_without_variance_the_bands_collapse_onto_the_response(n, k, seed):
    one = random_samples(1, n, seed)
    same = lossless_draws(np.repeat(one.d, k, axis=0), np.repeat(weights_of(one), k, axis=0))
    w, t = np.concatenate([[0.0], one.d[0], np.linspace(0.1, 12, 10)]), np.linspace(0, 9, 10)
    gain = np.abs(one.freqresp(w)[0])
    assert np.array_equal(same.magnitude_band(w), [gain, gain])
    assert np.array_equal(np.isinf(gain[1 : n + 1]), weights_of(one)[0] > 0)
    for band in (same.step_band, same.impulse_band):
        low, high = band(t)
        assert np.array_equal(low, high)
    low, high = same.phase_band(w[1:])
    assert np.array_equal(low, high) and set(low) <= {90.0, -90.0}
    assert not same.phase_band([0.0]).any()  # that of nothing


@pytest.mark.parametrize("n", [1, 3])
def test_a_time_in_other_units_changes_nothing_but_the_scale(n):
    samples, unit = random_samples(100, n, 0), 2.0**30
    slow = lossless_draws(samples.d / unit, weights_of(samples))
    w, t = np.linspace(0.1, 12, 20), np.linspace(0, 9, 20)
    assert np.array_equal(slow.magnitude_band(w / unit), samples.magnitude_band(w))
    assert np.array_equal(slow.phase_band(w / unit), samples.phase_band(w))
    assert np.array_equal(slow.step_band(t * unit), samples.step_band(t))
    assert np.array_equal(slow.impulse_band(t * unit), samples.impulse_band(t) / unit)


def test_across_a_pole_the_upper_end_is_the_gain_at_the_distance_that_few_draws_fall_below():
    """With one mode `|G| = r d w / |d^2 - w^2|`, about `r w / (2 |d - w|)`: the quantile of `|d - w|` is known."""
    d, sigma, k, level = 2.0, 1e-4, 40_000, 0.95
    samples = lossless_draws(d + sigma * np.random.default_rng(0).standard_normal((k, 1)), np.ones((k, 1)))
    low, high = samples.magnitude_band([d], level)[:, 0]
    tail = (1 - level) / 2
    near, far = sigma * norm.ppf(0.5 + tail / 2), sigma * norm.ppf(1 - tail / 2)
    scatter = 5 * math.sqrt(1 / (k * tail))
    assert abs(high * 2 * near / d - 1) < scatter
    assert abs(low * 2 * far / d - 1) < scatter / 4
    assert np.isfinite(high) and high > 1e5


def test_a_pole_exactly_at_a_frequency_makes_the_upper_end_infinite_once_enough_draws_have_it():
    k = 101
    d = np.full((k, 1), 3.0)
    ends = []
    for hits in (0, 2, 3, 4, 101):
        d[:hits] = 2.0
        ends.append(lossless_draws(d, np.ones((k, 1))).magnitude_band([2.0], 0.95)[:, 0])
    # 2.5 % of 101 draws lie between the second and the third
    assert np.array_equal(np.isinf(np.array(ends)[:, 1]), [False, False, True, True, True])
    assert np.array_equal(np.isinf(np.array(ends)[:, 0]), [False, False, False, False, True])


def linearised(d, r, C, w):
    """Gain and its standard deviation by the gradient of `|sum_l r_l d_l w / (d_l^2 - w^2)|`."""
    down = d**2 - w[:, None] ** 2
    X = (r * d * w[:, None] / down).sum(axis=1)
    gradient = np.concatenate([-r * w[:, None] * (d**2 + w[:, None] ** 2) / down**2, d * w[:, None] / down], axis=1)
    return np.abs(X), np.sqrt(np.einsum("wi,ij,wj->w", gradient, C, gradient))


def test_far_from_poles_the_band_is_the_linearised_one_and_near_a_pole_it_is_not():
    d, r, k = np.array([1.0, 3.0]), np.array([1.0, 0.5]), 4000
    deviations = np.array([1e-3, 2e-3, 1e-2, 1e-2])
    R = np.array([[1, 0.3, -0.5, 0], [0.3, 1, 0, 0.2], [-0.5, 0, 1, 0.4], [0, 0.2, 0.4, 1]])
    C = R * np.outer(deviations, deviations)
    x = draw(np.concatenate([d, r]), C, k, 11, nonnegative=[True] * 4)
    samples = lossless_draws(x[:, :2], x[:, 2:])
    factor = norm.ppf(0.975)

    far = np.array([0.2, 0.6, 1.5, 4.0, 30.0])
    gain, sigma = linearised(d, r, C, far)
    low, high = samples.magnitude_band(far)
    # the scatter of a percentile of k draws is 0.042 standard deviations
    assert np.all(np.abs((high - low) / (2 * factor * sigma) - 1) < 0.06)
    assert np.all(np.abs(0.5 * (high + low) - gain) < 0.15 * sigma)

    near = 1.0 + np.array([-1e-3, 5e-4, 2e-3])
    gain, sigma = linearised(d, r, C, near)
    low, high = samples.magnitude_band(near)
    assert np.all(gain - factor * sigma < 0.5 * low)
    assert np.all(low > 0)
    assert np.all(high - low > 1.5 * 2 * factor * sigma)


def test_bands_of_a_weight_near_0_do_not_go_below_it():
    x = draw([2.0, 0.1], np.diag([1e-6, 1.0]), 4000, 0, nonnegative=[False, True], positive=[True, False])
    samples = lossless_draws(x[:, :1], x[:, 1:])
    w = np.array([0.5, 1.0])
    low, high = samples.magnitude_band(w)
    weights = truncnorm(-0.1, np.inf, loc=0.1).ppf([0.025, 0.975])
    gain = 2 * w / (4 - w**2)
    assert np.all(np.abs(low / (gain * weights[0]) - 1) < 0.5) and np.all(low > 0)
    assert np.all(np.abs(high / (gain * weights[1]) - 1) < 0.05)


@relaxed
@given(st.integers(1, 4), st.integers(1, 60), levels, seeds)
def test_the_phase_is_open_where_too_many_draws_have_the_other_sign(n, k, level, seed):
    samples = random_samples(k, n, seed, spread=0.1)
    w = np.linspace(0.1, 12, 30)
    low, high = samples.phase_band(w, level)
    positive = (samples.freqresp(w).imag > 0).sum(axis=0)
    # a percentile of k draws has (k - 1) p of them beyond it, and is between two neighbours
    allowed = (k - 1) * (1 - level) / 2
    for end, others, here in ((low, k - positive, 90.0), (high, positive, -90.0)):
        assert np.all(end[others <= allowed] == here) and np.all(end[others >= allowed + 1] == -here)
        assert np.all(np.abs(end) <= 90)


def test_at_a_pole_the_phase_is_that_just_above():
    samples = lossless_draws([[1.0, 7.0]], [[7.0, 1.0]])
    w = np.array([-7.0, -6.0, -3.0, -1.0, -0.5, 0.5, 1.0, 3.0, 6.0, 7.0, 9.0])
    got = samples.freqresp(w)[0]
    assert np.array_equal(w[np.isinf(got)], [-7.0, -1.0, 1.0, 7.0])
    low, high = samples.phase_band(w)
    assert np.array_equal(low, high)
    assert np.array_equal(low, np.degrees(np.angle(samples.freqresp(w + 1e-9)[0])))
    assert np.array_equal(np.degrees(np.angle(samples.freqresp(w - 1e-9)[0])), np.where(np.isinf(got), -low, low))


def test_the_phase_is_sure_however_large_the_errors_between_poles_that_stay_apart():
    rng = np.random.default_rng(0)
    d = np.column_stack([rng.uniform(0.5, 1.5, 1000), rng.uniform(8, 12, 1000)])
    r = np.column_stack([rng.uniform(5, 10, 1000), rng.uniform(0.1, 0.2, 1000)])
    # the zero lies above sqrt(2.5 * 64 / (2.5 + 2.4))
    low, high = lossless_draws(d, r).phase_band([0.1, 0.4, 1.0, 1.6, 5.7, 10.0, 12.1, 20.0], 0.999)
    assert np.array_equal(low, [90, 90, -90, -90, -90, -90, -90, -90])
    assert np.array_equal(high, [90, 90, 90, -90, -90, 90, -90, -90])


# --- bands in time ---------------------------------------------------------------------------------------------------


def in_time(d, r, t, *, step):
    """Step or impulse response of one draw with many digits."""
    with mp.workdps(DIGITS):
        pairs = [(mp.mpf(float(a)), mp.mpf(float(b))) for a, b in zip(d, r, strict=True)]
        value = [
            mp.fsum(b * mp.sin(a * x) if step else a * b * mp.cos(a * x) for a, b in pairs)
            for x in map(mp.mpf, np.asarray(t, float).tolist())
        ]
        return np.array([float(x) for x in value])


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("periods", [1, 1e6])
def test_responses_in_time_are_right_to_rounding_after_many_periods(scale, periods):
    one = random_samples(1, 6, 1, scale=scale)
    t = np.linspace(0, 1, 21) * periods / scale
    for band, step in ((one.step_band, True), (one.impulse_band, False)):
        low, high = band(t)
        assert np.array_equal(low, high)
        r = weights_of(one)[0]
        size = r if step else r * one.d[0]
        # the phase is known to the rounding of the number of turns
        allowed = 8 * EPS * np.sum(size * (1 + one.d[0] * t[:, None]), axis=1)
        assert np.all(np.abs(low - in_time(one.d[0], r, t, step=step)) <= allowed)


@relaxed
@given(st.integers(1, 4), st.integers(1, 30), levels, seeds)
def test_bands_in_time_hold_the_percentiles_of_the_responses(n, k, level, seed):
    samples = random_samples(k, n, seed)
    t = np.linspace(0, 5, 21)
    tails = [0.5 - level / 2, 0.5 + level / 2]
    for response, band in ((phc.step_response, samples.step_band), (phc.impulse_response, samples.impulse_band)):
        models = (phc.modes(d, r) for d, r in zip(samples.d, weights_of(samples), strict=True))
        outputs = [response(phc.ph(modes.minimal()), t).outputs for modes in models]
        size = float(np.max(np.abs(outputs)))
        assert np.abs(band(t, level) - np.quantile(outputs, tails, axis=0)).max() < 1e-12 * size


def test_before_the_step_the_response_is_0_and_the_order_of_the_instants_does_not_matter():
    samples = random_samples(40, 2, 0)
    t = np.array([3.0, -1.0, 0.5, 0.0, -1e-9])
    for band in (samples.step_band, samples.impulse_band):
        shuffled, ordered = band(t), band(np.sort(t))
        assert np.array_equal(shuffled[:, np.argsort(t)], ordered)
        assert np.all(ordered[:, :2] == 0)
        assert np.all(ordered[:, 3:] != 0)
    assert np.all(samples.step_band(t)[:, 3] == 0)
    assert np.all(samples.impulse_band(t)[:, 3] > 0)


def test_the_band_of_the_step_response_widens_until_the_phase_is_lost():
    sigma = 1e-3
    samples = lossless_draws(2.0 + sigma * np.random.default_rng(0).standard_normal((4000, 1)), np.ones((4000, 1)))
    crossing = np.pi * np.array([2.0, 20.0]) / 2
    low, high = samples.step_band(crossing)
    # at a crossing of 0 the response is the phase error
    assert np.all(np.abs((high - low) / (2 * norm.ppf(0.975) * sigma * crossing) - 1) < 0.05)
    low, high = samples.step_band(np.linspace(10, 12, 50) / sigma)
    assert np.all(high > 0.99) and np.all(low < -0.99)


@pytest.mark.parametrize("k", [2**31, 2**63, 10**400])
def test_a_number_of_draws_that_no_memory_holds_is_refused(k):
    with pytest.raises(phc.StructureError, match="a whole number from 0 to 1000000000"):
        draw([1.0], [[1.0]], k, 0)
    with pytest.raises(phc.StructureError, match="rng is StateSpace"):
        draw([1.0], [[1.0]], 1, ct.ss([[-1.0]], [[1.0]], [[1.0]], 0))

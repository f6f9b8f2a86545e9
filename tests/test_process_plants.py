"""Process plants: dead times, lags, and noise that is coloured and as large as the response.

The references are recursions of `scipy.signal.lfilter`, whose poles and autoregressions are known.
"""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from scipy.stats import chi2
from slow import slowly

import ph_control as phc


def levels(rng, samples, each):
    """Input of two levels, each for some time."""
    return np.where(np.cumsum(rng.random(samples) < 1 / each) % 2, 1.0, -1.0)


def chained(u, multipliers, delay=0):
    """Output of lags of unit gain in a row, from sample to sample, after a dead time."""
    x = np.concatenate([np.zeros(delay), u[: len(u) - delay]])
    for a in multipliers:
        x = lfilter([0.0, 1 - a], [1.0, -a], x)
    return x


def autoregressive(rng, samples, a):
    """Noise of variance 1 that is `a` times what it was, and white noise, in its steady state."""
    white = rng.standard_normal(samples)
    white[0] /= np.sqrt(1 - a**2)
    return np.sqrt(1 - a**2) * lfilter([1.0], [1.0, -a], white)


def simulated_percent(result, u, x):
    """Fit in percent of what a model makes of an input to the response without noise."""
    y = result.predict(u, initial_state="zero").outputs
    return 100 * (1 - np.linalg.norm(y - x) / np.linalg.norm(x - x.mean()))


@pytest.mark.slow
def test_a_lag_is_found_beside_load_noise_of_its_size_and_its_interval_covers():
    off = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u = levels(rng, 1500, 20)
        x = chained(u, (0.9,))
        result = phc.pem((u, 3.0 + x + np.std(x) * autoregressive(rng, 1500, 0.97)), dt=1.0, quantity="free")
        assert result.states == 1 and result.outcome.name != "CONSISTENT"
        off.append(float((result.real_poles[0] - np.log(0.9)) / result.stderr["real_poles"][0]))
        assert "COLOURED_RESIDUALS" in {one.cause.name for one in result.findings}
        assert simulated_percent(result, u, x) > 70
    assert np.mean(np.square(off)) < 2.5 and np.sum(np.abs(off) < 1.96) >= 2


@pytest.mark.parametrize(("late", "seed"), [(30, 1), *slowly((3, 2), (10, 1), (15, 0), (30, 2))])
def test_a_dead_time_of_many_samples_is_found(late, seed):
    # its steps repeat before the response to the first has ended; lags and modes stand for it
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 20)
    y = 1.5 * chained(u, (0.95,), late) + 0.03 * rng.standard_normal(len(u))
    result = phc.pem((u, y), dt=0.1, quantity="free")
    assert result.states == 1 and abs(result.delay[0] - 0.1 * late) < 3.5 * result.stderr["delay"][0]
    assert abs(result.real_poles[0] - np.log(0.95) / 0.1) < 3.5 * result.stderr["real_poles"][0]


@pytest.mark.parametrize("late", [5, *slowly(12, 20)])
def test_the_response_to_a_single_step_shows_its_dead_time(late):
    # an integrator and a heavily damped mode explain it nearly as well
    u = np.where((np.arange(300) >= 30) & (np.arange(300) < 150), 10.0, 0.0)
    y = 60 + 0.9 * chained(u, (0.96,), late) + 0.18 * np.random.default_rng(2).standard_normal(300)
    result = phc.pem((u, y), dt=2.0, quantity="free")
    assert result.states == 1 and abs(result.delay[0] - 2.0 * late) < 3 * result.stderr["delay"][0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 5, 6, 7])
def test_two_lags_and_a_dead_time_are_no_three_lags(seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 20), 30)
    late = np.concatenate([np.zeros(4), u[:-4]])
    sampled = cont2discrete(([2.0], [30.0, 13.0, 1.0]), 0.5)
    y = lfilter(sampled[0].ravel(), sampled[1], late) + 0.03 * rng.standard_normal(600)
    result = phc.pem((u, y), dt=0.5, quantity="free")
    assert result.states == 2
    assert abs(result.delay[0] - 2.0) < 3 * np.nan_to_num(result.stderr["delay"][0], nan=0.5)
    assert np.all(np.abs(1 / result.time_constants - [0.1, 1 / 3]) < 3 * result.stderr["real_poles"])


def heated(seed, samples):
    """Input, response of two lags, and output with load noise of its size."""
    rng = np.random.default_rng(seed)
    u = levels(rng, samples, 25)
    x = chained(u, (np.exp(-1 / 20), np.exp(-1 / 5)))
    return u, x, x + np.std(x) * autoregressive(rng, samples, 0.95)


def test_lags_of_a_given_number_are_found_beside_load_noise():
    u, x, y = heated(9, 1200)
    result = phc.pem((u, y), 0, real_poles=2, dt=1.0)
    assert np.allclose(np.sort(result.time_constants), [5, 20], rtol=0.3) and simulated_percent(result, u, x) > 90


def test_where_noise_hides_the_plant_no_other_one_is_taken_for_it():
    # an integrator is not rejected: nearly all of the likelihood is that of the noise
    u, x, y = heated(35, 700)
    result = phc.pem((u, y), dt=1.0)
    assert result.structure == "classical" and result.time_constants[0] < 100 and simulated_percent(result, u, x) > 50


@pytest.mark.slow
def test_a_plant_that_a_noise_model_could_swallow_is_found_with_its_dead_time():
    rng = np.random.default_rng(3)
    u = levels(rng, 1500, 25)
    x = chained(u, (0.95, 0.8), 5)
    result = phc.pem((u, x + 0.3 * np.std(x) * autoregressive(rng, 1500, 0.95)), dt=1.0, quantity="free")
    assert abs(result.delay[0] - 6) <= 1  # the hold between the two lags is up to a sample more
    assert "DELAY" in {one.cause.name for one in result.findings}
    assert simulated_percent(result, u, x) > 80


@pytest.mark.slow
def test_a_lag_that_only_its_dead_time_tells_from_the_load_is_found():
    # without the dead time, noise alone is likelier
    rng = np.random.default_rng(11)
    u = levels(rng, 1200, 25)
    x = chained(u, (0.95,), 6)
    result = phc.pem((u, x + 1.2 * np.std(x) * autoregressive(rng, 1200, 0.96)), dt=1.0, quantity="free")
    assert result.states == 1 and abs(result.delay[0] - 6) <= 2
    assert simulated_percent(result, u, x) > 50


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, *slowly(12)])
def test_a_dead_time_is_none_of_several_lags(seed):
    # with zeros of their own, lags of a few samples are a rational approximation of it
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([0.0, 1.0], 14), 10)
    noise = lfilter([0.002], [1.0, -0.95], rng.standard_normal(140)) + 0.002 * rng.standard_normal(140)
    result = phc.pem((u, chained(u, (np.exp(-1 / 24),), 3) + noise), dt=1.0, quantity="free")
    assert result.states == 1 and abs(result.delay[0] - 3) <= 1
    assert abs(result.time_constants[0] - 24) < 2


@pytest.mark.slow
def test_noise_that_wanders_without_end_is_modelled():
    # its autoregression takes the constant away: what was there before has no value at 0 Hz
    rng = np.random.default_rng(10)
    u = rng.standard_normal(200)
    wandering = np.cumsum(rng.standard_normal(200)) + 0.02 * np.arange(200) ** 1.5
    y = np.convolve(u, 0.8 ** np.arange(40))[:200] + 0.3 * wandering
    result = phc.pem((u, y), dt=1.0, quantity="free", offset=False)
    assert np.min(np.abs(np.exp(result.poles) - 0.8)) < 0.1


@pytest.mark.slow
def test_modes_beside_autoregressive_noise_have_errors_that_hold():
    poles = np.array([-0.01 + 0.6j, -0.02 + 1.4j])
    scores = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(1200)
        x = sum(2 * lfilter([0.0, 1.0], [1.0, -np.exp(p)], u + 0j).real for p in poles)
        result = phc.pem((u, x + 0.2 * np.std(x) * autoregressive(rng, 1200, 0.9)), dt=1.0, quantity="free")
        assert result.order == 2 and result.states == 4
        scores += ((np.abs(result.poles) - np.abs(poles)) / result.stderr["natural_frequencies"]).tolist()
        scores += ((result.damping_ratios + poles.real / np.abs(poles)) / result.stderr["damping_ratios"]).tolist()
    low, high = chi2.ppf([1e-3, 1 - 1e-3], len(scores))
    assert low < np.sum(np.square(scores)) < high


@pytest.mark.slow
def test_slow_poles_of_a_search_in_white_noise_do_not_take_the_level_of_an_output():
    rng, samples = np.random.default_rng([0, 7]), 1250
    switches = np.cumsum(rng.random((5, 2 * samples)) < 1 / 30, axis=1) + rng.integers(0, 2, (5, 1))
    u = np.where(switches % 2, 1.0, -1.0)
    lags, late, gains = (30.0, 12.0, 30.0, 6.0, 12.0), (0, 3, 7, 1, 12), (1.0, -0.6, 0.5, 0.8, -0.4)
    x = sum(
        gain * chained(each, (np.exp(-1 / lag),), dead)
        for gain, each, lag, dead in zip(gains, u, lags, late, strict=True)
    )
    load = lfilter([0.5 * x.std() * np.sqrt(1 - 0.95**2)], [1.0, -0.95], rng.standard_normal(2 * samples))
    result = phc.pem((u[:, :samples], (5 + x + load)[:samples]), dt=1.0, quantity="free", input_delay=late)
    assert abs(np.ravel(result.offsets)[0] - 5) < 0.5 and "CONSTANT" in [
        finding.cause.name for finding in result.findings
    ]

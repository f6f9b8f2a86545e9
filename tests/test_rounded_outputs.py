"""Outputs that were rounded to steps larger than their noise: by a converter, an encoder, or a table of few digits."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter
from scipy.stats import norm
from slow import slowly

import ph_control as phc


def causes(result):
    return {finding.cause.name for finding in result.findings}


def response(u, time_constant, gain=2.0, delay=0):
    """Output of a lag at the samples of a held input that acts some samples later."""
    a = np.exp(-1 / time_constant)
    return gain * lfilter([0, 1 - a], [1, -a], np.concatenate([np.zeros(delay), u])[: len(u)])


def rounded(y, levels, place=0.3, noise=0.0, rng=None):
    """Output in so many steps of which 0 is at some place, after noise in units of the step; and the step."""
    step = np.ptp(y) / levels
    y = y / step + place + (0.0 if rng is None else noise * rng.standard_normal(len(y)))
    return np.round(y) * step, step


def step_input(samples=400, first=30):
    return np.where(np.arange(samples) < first, 0.0, 1.0)


def steps_up_and_down(rng, samples=600, hold=30):
    return np.repeat(rng.choice([-1.0, 1.0], samples // hold + 1), hold)[:samples]


@pytest.mark.parametrize("levels", [12, 60])
def test_a_step_response_of_few_levels_is_that_of_a_lag(levels):
    y, step = rounded(response(step_input(), 20.0), levels)
    result = phc.pem((step_input(), y), dt=1.0)
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert "consistent" in str(result.verdict) and "SATURATION" not in causes(result)
    finding = next(finding for finding in result.findings if finding.cause.name == "ROUNDED")
    np.testing.assert_allclose(finding.values, (step, len(np.unique(y))))
    low, high = np.ravel(result.confidence_interval(0.9999)["time_constants"])
    assert low < 20.0 < high and high - low < 10.0 / levels * 20.0


def test_a_dead_time_is_told_from_lags_in_steps():
    y, _ = rounded(response(step_input(600), 36.0, delay=17), 12)
    result = phc.pem((step_input(600), y), dt=1.0)
    assert (result.order, len(result.real_poles)) == (0, 1)
    np.testing.assert_allclose(result.delay, 17.0, atol=1.5)


def test_a_mode_is_the_only_one_in_few_levels():
    t = np.arange(800)
    decay = np.exp(-0.01 * t) * np.cos(0.31 * t)
    result = phc.pem((None, rounded(decay, 16)[0]), dt=1.0)
    assert (result.order, len(result.real_poles)) == (1, 0)
    np.testing.assert_allclose(result.poles, -0.01 + 0.31j, rtol=2e-3)


@pytest.mark.parametrize("noise", [0.0, 0.3, *slowly(0.15)])
def test_errors_of_rounded_outputs_hold(noise):
    deviations = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u, time_constant = steps_up_and_down(rng), rng.uniform(8, 30)
        y, _ = rounded(response(u, time_constant), 25, rng.uniform(), noise, rng)
        result = phc.pem((u, y), dt=1.0, delay=0.0)
        assert (result.order, len(result.real_poles)) == (0, 1)
        deviations.append((result.time_constants[0] - time_constant) / result.stderr["time_constants"][0])
    assert np.max(np.abs(deviations)) < 3.5 and 0.1 < np.mean(np.square(deviations)) < 2.5


def test_the_fit_is_the_most_likely_one():
    rng = np.random.default_rng(5)
    u = steps_up_and_down(rng)
    y, step = rounded(response(u, 15.0), 20, 0.4, 0.12, rng)
    result = phc.pem((u, y), dt=1.0, delay=0.0, initial_state="zero")

    def unlikely(x):
        ahead = (y - response(u, x[1], x[0]) - x[2]) / step
        deviation = np.exp(x[3])
        each = norm.cdf((0.5 + ahead) / deviation) - norm.cdf((-0.5 + ahead) / deviation)
        return -np.sum(np.log(np.maximum(each, 1e-300)))

    best = minimize(unlikely, [2.0, 15.0, 0.4 * step, np.log(0.12)], method="Nelder-Mead",
                    options={"xatol": 1e-7, "fatol": 1e-7, "maxiter": 4000}).x  # fmt: skip
    assert abs(result.time_constants[0] - best[1]) < 0.05 * result.stderr["time_constants"][0]
    assert abs(result.system.dcgain() - best[0]) < 0.01 * best[0]


def test_noise_of_a_step_and_more_is_noise():
    rng = np.random.default_rng(2)
    u = steps_up_and_down(rng)
    clean = response(u, 12.0)
    y, step = rounded(clean, 20, 0.0, 1.0, rng)
    result = phc.pem((u, y), dt=1.0)
    assert (result.order, len(result.real_poles)) == (0, 1) and "ROUNDED" not in causes(result)
    np.testing.assert_allclose(result.noise_variance, step**2 * (1 + 1 / 12), rtol=0.2)


def test_of_two_outputs_one_may_be_rounded():
    rng = np.random.default_rng(3)
    u = steps_up_and_down(rng)
    y = response(u, 14.0)
    fine = -0.7 * y + 0.02 * np.std(y) * rng.standard_normal(len(u))
    coarse, _ = rounded(y, 15)
    result = phc.pem((u, np.stack([coarse, fine])), dt=1.0)
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert [f.output for f in result.findings if f.cause.name == "ROUNDED"] == ["y1"]
    np.testing.assert_allclose(result.time_constants, 14.0, rtol=0.01)


def test_resamples_and_files_of_rounded_outputs(tmp_path):
    rng = np.random.default_rng(4)
    u = steps_up_and_down(rng)
    y, _ = rounded(response(u, 18.0), 30)
    result = phc.pem((u, y), dt=1.0, delay=0.0)
    drawn = result.bootstrap(80, rng=1)
    np.testing.assert_allclose(np.std(-1 / drawn.real_poles), result.stderr["time_constants"][0], rtol=0.5)
    phc.save(result, tmp_path / "fit.json")
    assert phc.load(tmp_path / "fit.json").findings == result.findings
    assert "rounded to steps" in result.message


def test_of_several_experiments_one_may_be_rounded():
    rng = np.random.default_rng(6)
    u = steps_up_and_down(rng)
    coarse = rounded(response(u, 16.0), 15)[0]
    fine = response(-u, 16.0) + 0.05 * rng.standard_normal(len(u))
    result = phc.pem([(u, coarse), (-u, fine)], dt=1.0)
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert {finding.experiment for finding in result.findings if finding.cause.name == "ROUNDED"} <= {0}
    np.testing.assert_allclose(result.time_constants, 16.0, rtol=0.02)


def test_a_broad_mode_is_no_random_walk_of_steps():
    # each sample foretells the next to less than what rounding leaves
    u, damping, size = step_input(600), 0.25, np.exp((-0.25 + 1j * np.sqrt(1 - 0.25**2)) / 15.0)
    y = 3.0 * lfilter([0, 1 - 2 * size.real + abs(size) ** 2], [1, -2 * size.real, abs(size) ** 2], u)
    result = phc.pem((u, rounded(y, 60)[0]), dt=1.0, intersample="zoh", delay=0.0)
    assert (result.order, len(result.real_poles)) == (1, 0)
    np.testing.assert_allclose(result.damping_ratios, damping, rtol=0.05)


def test_a_broad_mode_beside_steps_of_a_tenth_of_the_range_is_not_noise():
    rng = np.random.default_rng(34)
    u, damping, size = steps_up_and_down(rng, hold=50), 0.32, np.exp((-0.32 + 1j * np.sqrt(1 - 0.32**2)) / 15.0)
    y = 2.0 * lfilter([0, 1 - 2 * size.real + abs(size) ** 2], [1, -2 * size.real, abs(size) ** 2], u)
    result = phc.pem((u, rounded(y, 10, 0.2, 0.1, rng)[0]), dt=1.0, intersample="zoh", delay=0.0)
    assert (result.order, len(result.real_poles)) == (1, 0)
    np.testing.assert_allclose(result.damping_ratios, damping, rtol=0.1)

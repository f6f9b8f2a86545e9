"""Modes and lags that hide behind each other, behind a controller or in noise, and the searches that find them."""

import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

STEP = 0.1


def sections(poles, gains, u):
    """Response to held inputs (m, T) of pairs of complex poles and of real ones, whose `gains` are (n, p, m)."""
    y = np.zeros((gains.shape[1], u.shape[1]))
    for pole, gain in zip(poles, gains, strict=True):
        z = np.exp(pole * STEP)
        size = (z - 1) / pole * abs(pole) * (1 if pole.imag == 0 else 0.5)
        moved = lfilter([0, size], [1, -z], u.astype(complex))
        y += gain @ (moved.real * (1 if pole.imag == 0 else 2))
    return y


def in_a_loop(poles, gains, controller, seed, samples, noise, colour=0.0, hold=1, at_input=False):
    """Input and output of one channel under proportional and integral control, which a random reference moves."""
    rng = np.random.default_rng(seed)
    z = np.exp(np.asarray(poles) * STEP)
    size = (z - 1) / poles * np.abs(poles) * np.where(np.imag(poles) == 0, 1, 0.5)
    reference = np.repeat(rng.choice([-1.0, 1.0], samples + 500), hold)[: samples + 500]
    e = lfilter([1], [1, -colour], rng.standard_normal(samples + 500))
    weights = np.asarray(gains) * np.where(np.imag(poles) == 0, 1, 2)

    def run(amplitude):
        x, total, u, y = np.zeros(len(z), complex), 0.0, [], []
        for r, disturbance in zip(reference, e, strict=True):
            y.append(float((weights @ x).real) + amplitude * disturbance)
            error = (0 if at_input else r) - y[-1]
            u.append(controller[0] * error + total + (r if at_input else 0))
            total += controller[1] * STEP * error
            x = z * x + size * u[-1]
        return np.array(u[500:]), np.array(y[500:])

    return run(noise * np.std(run(0.0)[1]) / np.std(e))


def mode(frequency, damping):
    return frequency * complex(-damping, np.sqrt(1 - damping**2))


def counts(result):
    return result.order, len(result.real_poles)


@pytest.mark.parametrize("seed", [0, *slowly(2)])
def test_two_lags_that_one_explains_well_are_found_in_a_loop(seed):
    # what is left of one lag is white, and a second beside it as it is explains nothing of it
    u, y = in_a_loop([-1.4, -3.8], [1.0, 1.2], (0.4, 0.3), seed, 800, 0.15)
    result = phc.pem((u, y), dt=STEP)
    assert counts(result) == (0, 2)
    assert np.all(
        np.abs(np.sort(result.real_poles) - [-3.8, -1.4])
        < 3 * result.stderr["real_poles"][np.argsort(result.real_poles)]
    )


@pytest.mark.parametrize("seed", [6, *slowly(8)])
def test_a_slow_lag_is_found_in_records_too_long_to_be_searched_in_time(seed):
    # half of the evidence was lost with the bins that were left out about the fast lag
    u, y = in_a_loop([-0.17, -2.2], [-0.62, 1.7], (2.5, 1.5), seed, 1600, 0.09, at_input=True)
    assert counts(phc.pem((u, y), dt=STEP)) == (0, 2)


@pytest.mark.parametrize("seed", [0, *slowly(4)])
def test_two_close_modes_in_coloured_noise_are_no_unmeasured_force(seed):
    # less than a bin apart: to first order a second one only moves the first
    poles = [mode(0.94, 0.015), mode(1.05, 0.028), -0.39, -2.5]
    u, y = in_a_loop(poles, [0.3, 0.3, 1.0, 1.0], (1.3, 0.0), seed, 500, 0.013, 0.5, at_input=True)
    result = phc.pem((u, y), dt=STEP)
    assert counts(result) == (2, 2) and not any(finding.cause.name == "FORCES" for finding in result.findings)
    assert np.all(np.abs(result.natural_frequencies - [0.94, 1.05]) < 4 * result.stderr["natural_frequencies"])


@pytest.mark.parametrize("seed", [3, *slowly(7)])
def test_noise_of_a_model_that_was_too_small_does_not_stay(seed):
    u, y = in_a_loop([mode(0.93, 0.0107), mode(1.58, 0.01), -7.25], [0.3, 0.2, 1.0], (0.5, 0.0), seed, 620, 0.04, 0.5)
    assert counts(phc.pem((u, y), dt=STEP, intersample="zoh", delay=0.0)) == (2, 1)


@pytest.mark.parametrize("seed", [2, *slowly(4)])
def test_a_wide_peak_that_noise_hides_is_found(seed):
    rng = np.random.default_rng(seed)
    u, gains = rng.standard_normal((1, 12000)), np.array([[[1.0], [0.5]], [[0.07], [-0.07]]])
    y = sections([mode(2.9, 0.01), mode(11.0, 0.06)], gains, u)
    result = phc.pem((u, y + np.std(y, axis=1, keepdims=True) * rng.standard_normal(y.shape)), dt=STEP)
    assert result.order == 2 and result.structure == "classical"
    assert abs(result.natural_frequencies[1] - 11.0) < 4 * result.stderr["natural_frequencies"][1] < 0.5


def test_a_lag_too_many_is_no_drift_of_slow_noise():
    # in white noise the lag that the plant lacks grows with what is slow in the noise
    rng = np.random.default_rng(1)
    u = lfilter([1], [1, -0.8], rng.standard_normal((1, 1200)))
    y = sections([mode(1.06, 0.054), mode(1.97, 0.01), -0.5], rng.standard_normal((3, 2, 1)), u)
    e = lfilter([1], [1, -0.95], rng.standard_normal(y.shape))
    y = y + 0.3 * np.std(y, axis=1, keepdims=True) * e / np.std(e, axis=1, keepdims=True)
    given = phc.pem((u, y), 2, real_poles=2, dt=STEP, intersample="zoh", delay=0.0)
    assert counts(given) == (2, 2) and given.poles.real.max() < 0.01


@pytest.mark.parametrize("seed", [2, *slowly(5)])
def test_close_modes_that_decay_are_no_motion_that_forces_keep_up(seed):
    rng, t = np.random.default_rng(seed), np.arange(900)
    poles = np.array(
        [mode(0.068, 0.0011), mode(0.193, 0.003), mode(0.254, 0.039), mode(0.375, 0.015), mode(0.386, 0.008)]
    )
    sizes = rng.standard_normal((2, 5)) + 1j * rng.standard_normal((2, 5))
    decays = [(None, (size @ np.exp(poles[:, None] * t)).real[None]) for size in sizes]
    decays = [(None, y + 0.01 * np.std(y) * rng.standard_normal(y.shape)) for _, y in decays]
    result = phc.pem(decays, dt=1.0)
    assert not result.is_ambient and result.order == 5
    assert np.all(np.abs(result.natural_frequencies - np.abs(poles)) < 4 * result.stderr["natural_frequencies"])

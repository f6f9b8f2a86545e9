"""Plants that integrate: positions of motors, levels of tanks, masses that are free, with and without a dead time."""

import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

H, FINE = 0.1, 20


def fine_response(poles, u):
    """Output of a cascade of integrators and lags for a held input, on a grid twenty times finer."""
    y = np.repeat(u, FINE)
    for pole in poles:
        step = np.exp(pole * H / FINE)
        weight = H / FINE if pole == 0 else (step - 1) / pole
        y = lfilter([0.0, weight], [1.0, -step], y)
    return y


def record(poles, samples=1500, hold=40, delay=0.0, noise=0.01, seed=0):
    """Steps of random heights, and the noisy output after a dead time."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // hold + 1), hold)[:samples]
    late = round(delay * FINE / H)
    y = np.concatenate([np.zeros(late), fine_response(poles, u)])[: FINE * samples : FINE]
    return u, y + noise * np.std(y) * rng.standard_normal(samples)


def integrators(result):
    """Number of poles that may be 0, as a fit says."""
    return sum(int(finding.values[0]) for finding in result.findings if finding.cause.name == "INTEGRATOR")


@pytest.mark.parametrize(
    ("poles", "count"), [([0.0], 1), ([0.0, -1.0], 1), ([0.0, 0.0], 2), ([-1.0], 0), *slowly(([0.0, -3.0, -40.0], 1))]
)
def test_poles_that_may_be_0_are_said(poles, count):
    result = phc.pem(record(poles), dt=H)
    assert integrators(result) == count
    assert ("may be 0" in result.message) == bool(count)
    assert "grow" not in result.message
    assert result.outcome.name == "CONSISTENT"


def test_a_mode_slower_than_the_record_is_said_beside_an_integrator():
    """It turns for three quarters of a time."""
    u, y = record_of_mode(0.032)
    tank = fine_response([0.0], u)[::FINE]
    tank += 1e-3 * np.random.default_rng(4).standard_normal(len(u))
    result = phc.pem((u, [y / np.std(y), tank]), dt=H, noise="white", intersample="zoh")
    assert integrators(result) == 1
    assert result.order == 1
    assert "Mode 1" in result.message


@pytest.mark.parametrize("share", [0.3, *slowly(0.6)])
def test_a_lag_that_a_record_shows_is_no_integrator(share):
    """Its time constant is a part of the record."""
    result = phc.pem(record([-1 / (share * 1500 * H)]), dt=H, noise="white", intersample="zoh")
    assert not integrators(result)
    assert np.isclose(result.time_constants[0], share * 1500 * H, rtol=0.1)


def test_a_slow_oscillation_is_no_double_integrator():
    result = phc.pem(record_of_mode(0.1), dt=H, noise="white", intersample="zoh")
    assert not integrators(result)
    assert np.isclose(result.natural_frequencies[0], 0.1, rtol=0.02)


def record_of_mode(frequency):
    """Displacement of a mass on a spring."""
    step = np.exp(1j * frequency * H)
    u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 38), 40)[:1500]
    x = lfilter([0.0, (step - 1) / (1j * frequency)], [1.0, -step], u.astype(complex))
    y = x.imag / frequency
    return u, y + 0.01 * np.std(y) * np.random.default_rng(2).standard_normal(1500)


@pytest.mark.parametrize(("lag", "delay"), [(0.0, 1.04), (1.0, 2.5), *slowly((0.3, 0.8), (3.0, 0.0))])
def test_integrators_and_their_lags_may_come_late(lag, delay):
    poles = [0.0, -1 / lag] if lag else [0.0]
    result = phc.pem(record(poles, delay=delay, noise=0.003), dt=H, noise="white", intersample="zoh")
    assert integrators(result) == 1
    assert result.order == 0
    assert len(result.real_poles) == len(poles)
    shift, error = float(np.max(result.delay)), 0.03 + 4 * float(np.nan_to_num(np.max(result.delay_stderr)))
    assert abs(shift - delay) < error
    if lag:
        assert np.isclose(result.time_constants[-1], lag, rtol=0.15)


@pytest.mark.parametrize(
    ("lag", "delays"),
    [(2.4, (0.42, 0.0)), (2.5, (0.92, 1.76)), *slowly((0.0, (1.01, 0.0)), (0.7, (0.35, 1.75)))],
)
def test_inputs_of_an_integrator_have_dead_times_of_their_own(lag, delays):
    """What flows into a tank, in part through a pipe and another tank, and what flows out."""
    slow = [0.0, -1 / lag] if lag else [0.0]
    flow, inward = record(slow, hold=25, delay=delays[0], noise=0.0, seed=1)
    drain, outward = record([0.0], hold=40, delay=delays[1], noise=0.0, seed=2)
    level = inward - 0.7 * outward
    level = level + 0.005 * np.std(level) * np.random.default_rng(3).standard_normal(len(level))
    result = phc.pem(([flow, drain], level), dt=H, noise="white")
    assert result.order == 0
    assert len(result.real_poles) == len(slow)
    assert integrators(result) == 1
    late = result.input_delay + np.max(result.delay)
    assert np.all(np.abs(late - delays) < 0.25)

"""Frequency responses of plants with dead time, beside transfer functions written out."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from slow import slowly

import ph_control as phc


def measured(gains, rates, omega, *, modes=(), delay=0.0, noise=0.005, seed=0):
    """Lags of unit rates of some gains (n, p, m), modes of residues, frequency and damping, all late, with noise."""
    rng, s = np.random.default_rng(seed), 1j * np.asarray(omega)
    values = sum(np.asarray(gain)[..., None] * rate / (s + rate) for gain, rate in zip(gains, rates, strict=True))
    for shape, frequency, damping in modes:
        values = values + np.asarray(shape)[..., None] * s / (s * s + 2 * damping * frequency * s + frequency**2)
    values = values * np.exp(-s * delay)
    size = noise * np.sqrt(np.mean(np.abs(values) ** 2, axis=-1, keepdims=True))
    errors = size * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / np.sqrt(2)
    return ct.frd(values + errors, omega, smooth=False)


ONE = [[1.0]]
LOG, LINEAR = np.geomspace(0.03, 30.0, 100), np.linspace(0.1, 16.0, 120)
PLANTS = {  # gains, rates, modes, delay, points: what turns the last point from a part of a radian to ten turns
    "lag": ((ONE,), (1.0,), (), 0.4, LOG),
    "long dead time": ((ONE,), (0.2,), (), 4.0, LINEAR),
    "motor": ((ONE, [[-0.4]]), (0.5, 4.0), (), 0.05, LOG),
    "three lags": ((ONE, [[0.7]], [[-0.5]]), (0.1, 0.8, 6.0), (), 0.5, LOG),
    "lag and mode": ((ONE,), (0.7,), (([[0.8]], 5.0, 0.02),), 0.3, LINEAR),
    "two outputs": (([[1.0], [0.4]], [[0.3], [-1.2]]), (0.3, 2.0), (), 0.1, LOG),
}


@pytest.mark.parametrize("name", [*(name for name in PLANTS if name != "three lags"), *slowly("three lags")])
def test_dead_time_of_responses_is_found_with_lags_and_modes(name):
    gains, rates, modes, delay, omega = PLANTS[name]
    response = measured(gains, rates, omega, modes=modes, delay=delay)
    fit = phc.pem(response)
    assert fit.success
    assert (fit.order, len(fit.real_poles)) == (len(modes), len(rates))
    errors = fit.stderr["delay"]  # of a passive structure none is known
    assert np.all(np.abs(fit.delay - delay) < np.where(np.isnan(errors), 0.01 * delay, 4 * errors))
    assert np.all(np.abs(np.sort(-fit.real_poles) / rates - 1) < 0.15)
    assert any(finding.cause.name == "DELAY" for finding in fit.findings)
    # the system is the plant without its delay
    s, data = 1j * omega, response.frdata
    plant = np.moveaxis(np.array([np.atleast_2d(fit.system(point)) for point in s]), 0, -1)
    assert np.linalg.norm(plant * np.exp(-s * fit.delay[0]) - data) < 0.01 * np.linalg.norm(data)
    assert fit.fit_percent > 99


@pytest.mark.slow
def test_errors_of_delays_hold(seeds=24):
    def normalized(seed):
        fit = phc.pem(measured((ONE, [[-0.4]]), (0.5, 4.0), LOG, delay=0.15, noise=0.02, seed=seed))
        assert (fit.order, len(fit.real_poles)) == (0, 2)
        return float((fit.delay[0] - 0.15) / fit.stderr["delay"][0])

    z = np.array([normalized(seed) for seed in range(seeds)])
    assert 0.4 < np.mean(z**2) < 1.9


@pytest.mark.parametrize("seed", [0, 1, *slowly(2, 3, 4, 5)])
def test_lags_on_time_are_not_late(seed):
    fit = phc.pem(measured(([[1.0], [0.4]], [[0.3], [-1.2]]), (0.3, 2.0), LOG, noise=0.02, seed=seed))
    assert (fit.order, len(fit.real_poles)) == (0, 2)
    np.testing.assert_array_equal(fit.delay, 0.0)


def test_a_delay_that_is_given_stays():
    response = measured((ONE,), (1.0,), LOG, delay=0.4)
    assert phc.pem(response, delay=0.4).delay == 0.4
    assert phc.pem(response, delay=0.0).delay == 0.0

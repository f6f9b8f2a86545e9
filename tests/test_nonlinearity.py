"""Plants that are not linear: modes that change within a recording, and multiples of modes in decays, are named."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ph_control as phc

STEP, SAMPLES = 0.1, 3000
T = STEP * np.arange(SAMPLES)


def named(result, cause):
    return [finding for finding in result.findings if finding.cause.name == cause]


def test_a_frequency_that_depends_on_the_amplitude_is_named():
    rng = np.random.default_rng(0)
    amplitude = np.exp(-0.01 * T)
    phase = np.cumsum(STEP * (1 + 0.002 * amplitude**2))
    result = phc.pem((None, amplitude * np.cos(phase) + 0.01 * rng.standard_normal(SAMPLES)), 1, dt=STEP)
    (finding,) = named(result, "CHANGING_MODE")
    first, second, *damping = finding.values
    # the slope of the phase in each half, weighted by the amplitude
    slopes = [
        np.polyfit(t, part, 1, w=weight)[0]
        for t, part, weight in zip(*(np.split(values, 2) for values in (T, phase, amplitude)), strict=True)
    ]
    np.testing.assert_allclose((first, second), slopes, atol=8e-5)
    np.testing.assert_allclose(damping, 0.01, rtol=0.1)
    assert "first half" in result.message and not named(result, "MULTIPLE")


def test_a_driven_plant_that_changes_is_named():
    rng = np.random.default_rng(0)
    d = np.where(T < T[SAMPLES // 2], 1.0, 1.003)
    u, p, state, y = rng.standard_normal(SAMPLES), -0.01 + 1j * d, 0j, np.zeros(SAMPLES)
    for k in range(SAMPLES):
        y[k] = 2 * state.real
        state = np.exp(p[k] * STEP) * state + STEP * u[k]
    data = u, y + 0.3 * y.std() * rng.standard_normal(SAMPLES)
    result = phc.pem(data, dt=STEP, structure="free", noise="white")  # what changes may pass for a force
    (finding,) = named(result, "CHANGING_MODE")
    assert finding.values[1] - finding.values[0] == pytest.approx(0.003, abs=0.0015)


def test_what_a_quadratic_sensor_makes_of_a_decay_is_no_mode():
    rng = np.random.default_rng(0)
    q = np.exp(-0.01 * T) * np.cos(T) + 0.6 * np.exp(-0.012 * T) * np.cos(2.3 * T + 1)
    result = phc.pem((None, q + 0.05 * q**2 + 0.002 * rng.standard_normal(SAMPLES)), dt=STEP)
    multiples = {round(finding.values[0], 2): np.round(finding.values[1:], 2).tolist()
                 for finding in named(result, "MULTIPLE")}  # fmt: skip
    assert multiples[2.0] == [1.0, 1.0] and multiples[4.6] == [2.3, 2.3]
    assert not {1.0, 2.3} & set(multiples)


@pytest.mark.variants
@pytest.mark.parametrize("driven", [True, False])
def test_linear_plants_are_not_called_otherwise(driven):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        poles = np.array([-0.004, -0.02]) + 1j * rng.uniform([0.8, 1.7], [1.2, 2.3])
        u = rng.standard_normal(1200) if driven else np.r_[10.0, np.zeros(1199)]
        y = sum(2 * lfilter([0, STEP], [1, -np.exp(p * STEP)], u.astype(complex)).real for p in poles)[1:]
        y = y + 0.03 * y.std() * rng.standard_normal(len(y))
        result = phc.pem((u[:-1] if driven else None, y), dt=STEP, structure="free")
        assert not named(result, "CHANGING_MODE") and not named(result, "MULTIPLE")

"""Records of digital control loops: a controller sees the noise of an output before the output answers to it."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

STEP, SAMPLES = 0.1, 1500
PLANTS = {
    "lag": ([-1.0], [1.0], 0),
    "two lags": ([-0.5, -2.0], [1.0, -1.0], 0),
    "late lag": ([-0.5], [0.5], 4),
    "integrator and lag": ([0.0, -1.5], [0.3, -0.3], 2),
}


def controlled(plant, controller, seed, samples=SAMPLES):
    """Input and output of a loop with a relay, or with a PI controller whose reference steps now and then."""
    poles, residues, late = (np.array(part) for part in PLANTS[plant])
    rng = np.random.default_rng([seed, 211])
    steps = np.where(poles == 0, STEP, np.expm1(poles * STEP) / np.where(poles == 0, 1.0, poles)) * residues
    references = rng.choice([-1.0, -0.5, 0.5, 1.0], samples // 200 + 1)
    x, u, y, integral, relay = np.zeros(len(poles)), np.zeros(samples + late), np.zeros(samples), 0.0, 1.0
    for k in range(samples):
        y[k] = x.sum() + 0.02 * rng.standard_normal()
        error = references[k // 200] - y[k]
        integral += STEP * error * (0.05 if 0 in poles else 0.6)
        relay = relay if abs(y[k]) < 0.1 else -np.sign(y[k])
        u[k + late] = relay if controller == "relay" else 0.8 * error + integral
        x = np.exp(poles * STEP) * x + steps * u[k]
    return u[late:], y, np.sort(poles)


def causes(result):
    return [finding.cause.name for finding in result.findings]


@pytest.mark.parametrize("seed", [0, *slowly(1, 2, 3)])
@pytest.mark.parametrize("controller", ["relay", "steps"])
@pytest.mark.parametrize("plant", PLANTS)
def test_noise_that_a_controller_sees_is_not_fed_through(plant, controller, seed):
    u, y, poles = controlled(plant, controller, seed)
    result = phc.pem((u, y), dt=STEP)
    assert (result.order, len(result.real_poles)) == (0, len(poles))
    assert result.intersample == "zoh" and not result.feedthrough.any() and result.delay[0] >= 0
    order = np.argsort(result.real_poles)
    z = (np.array(result.real_poles)[order] - poles) / np.array(result.stderr["real_poles"])[order]
    assert np.all(np.abs(z) < 4)


def test_feedback_is_named_with_its_correlation():
    u, y, _ = controlled("lag", "steps", 0)
    result = phc.pem((u, y), dt=STEP)
    (finding,) = [finding for finding in result.findings if finding.cause.name == "FEEDBACK"]
    assert finding.output == "y" and -1 < finding.values[0] < -0.5 and finding.gain > 100
    assert "goes with the noise of 'y' in the same sample" in str(result)


def moved(kind, seed, samples=1000):
    """An input that its own past foretells in part."""
    rng = np.random.default_rng([seed, 5])
    if kind == "coloured":
        return lfilter([1.0], [1.0, -0.9], rng.standard_normal(samples)), rng
    return np.repeat(rng.standard_normal(samples // 20), 20), rng


@pytest.mark.parametrize("seed", [0, *slowly(1, 2, 3, 4)])
@pytest.mark.parametrize("kind", ["coloured", "stairs"])
def test_a_lead_in_an_open_loop_stays(kind, seed):
    u, rng = moved(kind, seed)
    y = 0.3 * u + lfilter([0.0, -np.expm1(-STEP)], [1.0, -np.exp(-STEP)], u)
    y += 0.03 * y.std() * rng.standard_normal(len(y))
    result = phc.pem((u, y), dt=STEP)
    assert "FEEDBACK" not in causes(result) and len(result.real_poles) == 1
    assert abs(result.feedthrough[0, 0] - 0.3) < 0.02 or result.intersample == "foh"


@pytest.mark.parametrize("seed", [0, *slowly(1, 2, 3, 4)])
def test_an_input_that_is_linear_between_samples_stays(seed):
    u, rng = moved("coloured", seed)
    plant = ct.tf([1.0, 0.0], [1.0, 0.2, 1.0]) + ct.tf([0.5, 0.0], [1.0, 0.3, 6.0])
    y = ct.forced_response(plant, STEP * np.arange(len(u)), u).outputs
    result = phc.pem((u, y + 0.03 * y.std() * rng.standard_normal(len(u))), dt=STEP)
    assert "FEEDBACK" not in causes(result) and result.order == 2 and result.intersample == "foh"


def unstable(seed, samples=1000):
    """A pole at 0.3 behind a controller, over 100 units of time."""
    rng = np.random.default_rng([seed, 41])
    x, u, y = 0.0, np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        y[k] = x + 0.02 * rng.standard_normal()
        u[k] = -1.5 * y[k] + 0.5 * rng.choice([-1.0, 1.0])
        x = np.exp(0.3 * STEP) * x + np.expm1(0.3 * STEP) / 0.3 * 0.8 * u[k]
    return u, y


def test_a_plant_that_grows_by_too_much_is_named_and_its_parts_show_it():
    u, y = unstable(0)
    whole = phc.pem((u, y), 0, real_poles=1, dt=STEP)
    assert whole.outcome.name == "DOUBTFUL" and "FASTEST_GROWTH" in causes(whole)
    assert "cut recordings into parts" in str(whole)
    parts = phc.pem([(u[k : k + 250], y[k : k + 250]) for k in range(0, 1000, 250)], 0, real_poles=1, dt=STEP)
    (pole,), (error,) = parts.real_poles, parts.stderr["real_poles"]
    assert abs(pole - 0.3) < 4 * error < 0.03 and "FASTEST_GROWTH" not in causes(parts)

"""Sensors that wander: noise that is a random walk beside white noise, and delays beside noise through the plant."""

import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

# what most of these tests are not about, and searches would take time for
KNOWN = {"quantity": "free", "intersample": "zoh"}


def through(u, poles, residues, delay=0):
    """Response (p, T) of poles to held inputs (m, T), with residues (p, m) of each, later by so many samples."""
    u = np.concatenate([np.zeros((len(u), delay)), u[:, : u.shape[1] - delay]], axis=1)
    y = np.zeros((len(residues[0]), u.shape[1]))
    for pole, residue in zip(poles, residues, strict=True):
        a = np.exp(pole)
        states = lfilter([0, (a - 1) / pole], [1, -a], u.astype(complex), axis=1)
        y += (2 if np.imag(pole) else 1) * np.real(np.asarray(residue) @ states)
    return y


def random_walk(rng, shape, share):
    """White noise beside a random walk of so much of it in each sample."""
    return rng.standard_normal(shape) + share * np.cumsum(rng.standard_normal(shape), axis=1)


def wandering_lag(seed, m=5, samples=750):
    """A lag of several white inputs, and a sensor that wanders by as much as it responds."""
    rng = np.random.default_rng([seed, 41])
    u = rng.standard_normal((m, samples))
    x = through(u, [-0.06], [0.02 * np.array([[1.0, -0.8, 0.6, 0.9, -1.1]])[:, :m]])
    return u, x, x + 0.1 * random_walk(rng, x.shape, 0.05)


@pytest.mark.parametrize("seed", [0, *slowly(1, 3, 4, 5)])
def test_a_sensor_that_wanders_is_no_slow_pole_of_the_plant(seed):
    """Integrals of several inputs look like a random walk, but foretell nothing."""
    u, x, y = wandering_lag(seed)
    result = phc.pem((u, y[0]), dt=1.0, **KNOWN)
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert abs(result.poles[0].real + 0.06) < 4 * result.stderr["real_poles"][0]
    assert "SLOW_NOISE" in {finding.cause.name for finding in result.findings}
    # noise of one state, apart from the plant
    assert result.noise.states[0].shape == (1, 1)
    forced = result.predict(u, initial_state="zero", dt=1.0).outputs
    assert np.std(forced - x) < 0.25 * np.std(x)


@pytest.mark.parametrize("seed", [2, *slowly(0, 3)])
def test_a_plant_is_found_late_beside_a_sensor_that_wanders(seed):
    rng = np.random.default_rng([seed, 42])
    u = rng.standard_normal((2, 800))
    poles, residues = [-0.03, -0.04 + 1.3j], [[[0.02, 0.03]], [[0.01, 0.02j]]]
    x = through(u, poles, residues, delay=4)
    y = x + 0.03 * random_walk(rng, x.shape, 0.1)
    result = phc.pem((u, y[0]), dt=1.0, **KNOWN)
    assert (result.order, len(result.real_poles)) == (1, 1)
    assert result.delay[0] == pytest.approx(4.0, abs=0.5)
    np.testing.assert_allclose(np.sort_complex(result.poles), [-0.04 + 1.3j, -0.03], atol=0.01)


@pytest.mark.parametrize("seed", [9, 10, *slowly(0, 3, 12)])
@pytest.mark.parametrize("drifts", [False, True])
def test_a_sensor_that_wanders_does_not_drift(drifts, seed):
    """A line explains much of a random walk where its end is taken for a jump back to its beginning."""
    rng = np.random.default_rng([seed, 44])
    u = np.repeat(rng.choice([-1.0, 1.0], (1, 200)), 5, axis=1)
    x = through(u, [-0.05], [[[0.05]]])
    noise = rng.standard_normal(x.shape) + np.linspace(0, 3, 1000) if drifts else random_walk(rng, x.shape, 0.05)
    result = phc.pem((u[0], (x + 0.3 * x.std() * noise)[0]), dt=1.0, **KNOWN)
    causes = {finding.cause.name for finding in result.findings}
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert ("DRIFT" in causes, "SLOW_NOISE" in causes) == (drifts, not drifts)


@pytest.mark.parametrize("seed", [1, *slowly(0, 2, 9)])
def test_the_unit_of_an_output_changes_nothing(seed):
    """Coloured noise and delays take some samples each, so that likelihoods are of other numbers of these."""
    rng = np.random.default_rng([seed, 44])
    u = np.repeat(rng.choice([-1.0, 1.0], (1, 1000))[:, :200], 5, axis=1)
    x = through(u, [-0.05], [[[0.05]]])
    y = x + 0.3 * x.std() * random_walk(rng, x.shape, 0.05)
    small, large = (phc.pem((u[0], unit * y[0]), dt=1.0, **KNOWN) for unit in (1e-6, 1e6))
    np.testing.assert_allclose(small.poles, large.poles, rtol=1e-5)
    assert [each.cause for each in small.findings] == [each.cause for each in large.findings]


@pytest.mark.parametrize("seed", [2, *slowly(0, 3)])
def test_what_grows_at_the_end_of_noise_that_wanders_is_no_pole(seed):
    """A free motion that grows fits the end of a record, and nothing that follows."""
    rng = np.random.default_rng([seed, 46])
    u = np.sign(np.repeat(rng.uniform(-1, 1, (1, 94)), 8, axis=1))[:, :750]
    x = through(u, [-0.0096, -0.02 + 0.84j], [[[0.01], [-0.008]], [[0.02], [0.03j]]])
    y = x + 0.07 * np.std(x, axis=1, keepdims=True) * random_walk(rng, x.shape, 0.15)
    result = phc.pem((u[0], y), dt=1.0, **KNOWN)
    assert result.poles.real.max() < 0
    assert (result.order, len(result.real_poles)) == (1, 1)


@pytest.mark.parametrize(("seed", "late"), [(0, 7), *slowly((1, 7), (2, 7), (3, 7), (1, 20))])
def test_a_dead_time_is_found_beside_noise_through_the_plant(seed, late):
    """Fast modes may stand for a dead time where forces hide what is left."""
    rng = np.random.default_rng([seed, 43])
    u, force = rng.standard_normal((2, 2, 1500))
    poles, residues = [-0.0107 + 0.113j], [[[0.02 + 0.01j, -0.03j]]]
    x = through(u, poles, residues, delay=late)
    load = through(force, poles, residues)
    y = x + 0.8 * load * np.std(x) / np.std(load) + 0.05 * np.std(x) * rng.standard_normal(x.shape)
    result = phc.pem((u, y[0]), dt=1.0, **KNOWN)
    assert (result.order, len(result.real_poles)) == (1, 0)
    assert {"FORCES", "DELAY"} <= {finding.cause.name for finding in result.findings}
    assert result.delay[0] == pytest.approx(late, abs=0.5)
    assert abs(result.poles[0] - poles[0]) < 0.006


@pytest.mark.parametrize("seed", [2, *slowly(0, 1, 3, 4, 5)])
def test_a_peak_of_the_noise_is_no_mode(seed):
    """An autoregression that rings for twenty samples is noise, in a record of 400."""
    rng = np.random.default_rng([seed, 44])
    u = rng.standard_normal((2, 400))
    x = through(u, [-0.115 + 0.45j], [[[0.2, 0.1 - 0.2j]]])
    ringing = 0.9 * np.exp(1.5j)
    noise = lfilter([1], [1, -2 * ringing.real, abs(ringing) ** 2], rng.standard_normal(x.shape), axis=1)
    y = x + 0.3 * np.std(x) * noise / np.std(noise)
    result = phc.pem((u, y[0]), dt=1.0, **KNOWN)
    assert (result.order, len(result.real_poles)) == (1, 0)
    assert abs(result.poles[0] - (-0.115 + 0.45j)) < 0.03


def test_a_number_of_real_poles_holds_where_inputs_come_late():
    """Before the search starts inputs show six lags."""
    rng = np.random.default_rng([12, 45])
    u = np.sign(np.repeat(rng.uniform(-1, 1, (5, 188)), 8, axis=1))[:, :1500]
    residues = rng.standard_normal((2, 2, 5)) * np.array([0.01, 0.06])[:, None, None]
    x = through(u, [-0.0104, -0.0647], residues, delay=3)
    y = x + 0.1 * np.std(x) * random_walk(rng, x.shape, 0.02)
    result = phc.pem((u, y), 0, dt=1.0, real_poles=2, **KNOWN)
    assert (result.order, len(result.real_poles)) == (0, 2)
    np.testing.assert_allclose(np.sort(result.real_poles), [-0.0647, -0.0104], rtol=0.15)

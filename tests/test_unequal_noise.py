"""Experiments whose noise differs: each counts by its own, and is said to."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ph_control as phc

STEP, SAMPLES = 0.3, 800
POLES = np.array([-0.01 + 1j, -0.03 + 2j, -0.02 + 3.3j])
SHAPES = np.random.default_rng(5).standard_normal((3, 2))


def velocities(u):
    """Outputs (2, T) of three modes, pushed where the first sensor is."""
    y = np.zeros((2, len(u)))
    for p, shape in zip(POLES, SHAPES, strict=True):
        z = np.exp(p * STEP)
        q = lfilter([0, (z - 1) / p], [1, -z], (shape[0] * u).astype(complex))
        y += 2 * np.outer(shape, (p / (p - p.conj()) * q).real)
    return y


SIZES = velocities(np.random.default_rng(11).standard_normal(SAMPLES)).std(axis=1)


def experiments(*sizes, seed=0):
    """Recordings with noise of these parts of the outputs."""
    rng, data = np.random.default_rng(seed), []
    for k, size in enumerate(sizes):
        u = np.random.default_rng(11 + k).standard_normal(SAMPLES)
        data.append((u[None], velocities(u) + size * SIZES[:, None] * rng.standard_normal((2, SAMPLES))))
    return data


def fit_of(data, order="auto"):
    return phc.pem(data, order, dt=STEP, ports=[(0, 0)])


@pytest.fixture(scope="module")
def both():
    """Fit to a quiet and a loud experiment."""
    return fit_of(experiments(0.02, 0.5, seed=0))


@pytest.mark.slow
def test_a_loud_experiment_does_not_spoil_a_quiet_one():
    data = [experiments(0.02, 0.5, seed=seed) for seed in range(3)]
    fits = [(fit_of(pair), fit_of(pair[:1], 3)) for pair in data]
    errors = np.array([[f.natural_frequencies - np.abs(POLES) for f in pair] for pair in fits])
    both, quiet = np.sqrt(np.mean(errors**2, axis=0))
    assert np.all(both < 1.15 * quiet)
    z = np.array([f.natural_frequencies - np.abs(POLES) for f, _ in fits]) / [
        f.stderr["natural_frequencies"] for f, _ in fits
    ]
    assert np.mean(z**2) < 2.0
    assert {f.structure for f, _ in fits} == {"classical"}


@pytest.mark.slow
def test_the_noise_of_each_experiment_is_said(both):
    result = both
    quiet, loud = (experiment.noise_scale for experiment in result.experiments)
    np.testing.assert_allclose(loud / quiet, 25, rtol=0.1)
    np.testing.assert_allclose(loud * quiet, 1, rtol=1e-9)
    np.testing.assert_allclose(result.noise_variance, (quiet * loud * 0.02 * 0.5) * SIZES**2, rtol=0.15)
    spread = [np.nanstd(experiment.residuals, axis=1) / experiment.noise_scale for experiment in result.experiments]
    np.testing.assert_allclose(spread, np.sqrt(np.tile(result.noise_variance, (2, 1))), rtol=0.06)
    (finding,) = [finding for finding in result.findings if finding.cause.name == "UNEQUAL_NOISE"]
    np.testing.assert_allclose(finding.values, (quiet, loud))
    assert finding.gain > 1000 and "The noise of experiment 2 is 25" in result.message


def test_residuals_and_predictions_are_in_the_units_of_the_data(both):
    result, data = both, experiments(0.02, 0.5)
    for experiment, (u, y) in zip(result.experiments, data, strict=True):
        np.testing.assert_array_equal(experiment.record.u, u)
        np.testing.assert_array_equal(experiment.record.y, y)
        missed = np.sum((experiment.predicted - velocities(u[0])) ** 2) / np.sum(velocities(u[0]) ** 2)
        assert missed < 1e-3 * experiment.noise_scale**2


@pytest.mark.slow
def test_experiments_of_the_same_noise_share_it():
    for seed in range(2):
        result = phc.pem(experiments(0.1, 0.1, seed=seed), dt=STEP, ports=[(0, 0)])
        assert [experiment.noise_scale for experiment in result.experiments] == [1, 1]
        assert "UNEQUAL_NOISE" not in {finding.cause.name for finding in result.findings}


@pytest.mark.slow
def test_files_and_resamples_know_the_noise_of_each_experiment(both, tmp_path):
    result = both
    result.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert [e.noise_scale for e in again.experiments] == [e.noise_scale for e in result.experiments]
    spread = result.bootstrap(20, rng=0).natural_frequencies.std(axis=0)
    np.testing.assert_allclose(spread, result.stderr["natural_frequencies"], rtol=0.6)


@pytest.mark.slow
def test_the_motion_at_the_start_has_the_units_of_its_experiment():
    rng = np.random.default_rng(3)
    t, data = STEP * np.arange(SAMPLES), []
    for size, noise in ((1.0, 0.01), (5.0, 1.0)):
        free = 2 * size * (0.25 * np.exp(np.outer(POLES[:1], t))).real[0]
        u = rng.standard_normal(SAMPLES)
        p = POLES[0]
        z = np.exp(p * STEP)
        forced = 2 * (0.5 * lfilter([0, (z - 1) / p], [1, -z], u.astype(complex))).real
        data.append((u, forced + free + 2.0 * size + noise * rng.standard_normal(SAMPLES)))
    result = phc.pem(data, dt=STEP, structure="free")
    assert result.order == 1 and result.experiments[1].noise_scale / result.experiments[0].noise_scale > 50
    for experiment, size in zip(result.experiments, (1.0, 5.0), strict=True):
        amplitude = experiment.free_amplitudes[0]
        error = experiment.initial_stderr
        assert abs(amplitude.real - 0.5 * size) < 4 * error[0] and abs(amplitude.imag) < 4 * error[1]
        assert abs(experiment.offset - 2.0 * size) < 4 * experiment.offset_stderr
        assert experiment.offset_stderr < 0.3 * experiment.noise_scale * np.sqrt(result.noise_variance[0])
    assert result.experiments[1].offset_stderr / result.experiments[0].offset_stderr > 50

"""Tones that no input drives, as of the mains: they are named, and are no modes."""

import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

STEP, SAMPLES = 0.1, 2000
POLES, RESIDUES = np.array([-0.01 + 1j, -0.03 + 2j]), np.array([0.5, 0.4])


def velocity(u, poles=POLES, residues=RESIDUES):
    """Output of modes at rest for an input that is held between samples."""
    y = np.zeros(len(u))
    for p, r in zip(poles, residues, strict=True):
        z = np.exp(p * STEP)
        y += 2 * (r * lfilter([0, (z - 1) / p], [1, -z], u.astype(complex))).real
    return y


def humming(seed, share, *frequencies):
    """Input and output with tones of this part of the output, and noise of 2 %."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(SAMPLES)
    y = velocity(u)
    tones = [np.cos(w * STEP * np.arange(SAMPLES) + k) for k, w in enumerate(frequencies)]
    return u, y + np.std(y) * (share * np.sqrt(2) * sum(tones) + 0.02 * rng.standard_normal(SAMPLES))


def hums(result):
    """Findings of hum."""
    return [finding for finding in result.findings if finding.cause.name == "HUM"]


@pytest.mark.variants
@pytest.mark.parametrize("seed, share", [(0, 0.01), (2, 0.3), *slowly((1, 0.05))])
def test_hum_is_named_with_its_frequency_and_is_no_mode(seed, share):
    frequency = np.random.default_rng([seed, 3]).uniform(2.5, 8)
    u, y = humming(seed, share, frequency)
    result = phc.pem((u, y), dt=STEP)
    (hum,) = hums(result)
    assert result.order == 2 and result.outcome.name == "CONSISTENT"
    size = np.std(velocity(u))
    # bounds of the errors of a tone in white noise: frequency sqrt(12) s / (a T^1.5 h), amplitude s / sqrt(T / 2)
    ratio = 0.02 / (share * np.sqrt(2))
    assert abs(hum.values[0] - frequency) < 4 * np.sqrt(24) * ratio / SAMPLES**1.5 / STEP
    assert abs(np.hypot(*hum.values[1:]) - share * np.sqrt(2) * size) < 5 * 0.02 * size / np.sqrt(SAMPLES / 2)
    np.testing.assert_allclose(result.natural_frequencies, np.abs(POLES), rtol=2e-3)
    assert "is hum and no mode" in result.message
    # what is predicted has it
    assert np.std(y - result.experiments[0].predicted) < 0.021 * size
    np.testing.assert_array_equal(result.experiments[0].record.y, y)


def test_hum_and_its_harmonics_are_named_together():
    result = phc.pem(humming(1, 0.1, 2.9, 5.8, 8.7), dt=STEP)
    assert result.order == 2
    np.testing.assert_allclose(sorted(hum.values[0] for hum in hums(result)), [2.9, 5.8, 8.7], atol=4e-4)


@pytest.mark.slow
def test_hum_next_to_a_mode_leaves_the_mode():
    result = phc.pem(humming(2, 0.2, 2.06), dt=STEP)
    assert result.order == 2 and len(hums(result)) == 1
    errors = (result.natural_frequencies - np.abs(POLES)) / result.stderr["natural_frequencies"]
    assert np.max(np.abs(errors)) < 4


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.1, *slowly(0.5)])
def test_an_order_that_is_given_is_that_of_the_modes(share):
    result = phc.pem(humming(3, share, 5.0), 2, dt=STEP)
    assert result.order == 2 and len(hums(result)) == 1
    np.testing.assert_allclose(result.natural_frequencies, np.abs(POLES), rtol=2e-3)


@pytest.mark.slow
def test_hum_beside_a_lag_whose_number_is_given_is_no_coloured_noise():
    rng, t = np.random.default_rng(0), STEP * np.arange(SAMPLES)
    u, z = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 20), 20), np.exp(-STEP / 8)
    y = lfilter([0, 1 - z], [1, -z], u)
    y += np.std(y) * (0.05 * rng.standard_normal(SAMPLES) + 0.1 * np.sin(3.1 * t))
    result = phc.pem((u, y), 0, dt=STEP, real_poles=1, quantity="free")
    assert [abs(hum.values[0] - 3.1) < 0.01 for hum in hums(result)] == [True]
    assert abs(result.time_constants[0] - 8) < 3 * result.stderr["time_constants"][0]


def test_hum_of_each_experiment_has_its_own_phase():
    pair = [humming(4, 0.1, 5.0), humming(5, 0.3, 5.0)]
    result = phc.pem(pair, dt=STEP, intersample="zoh", delay=0.0)
    first, second = hums(result)
    assert result.order == 2 and (first.experiment, second.experiment) == (0, 1)
    assert first.values[0] == second.values[0]
    ratio = np.hypot(*second.values[1:]) / np.hypot(*first.values[1:])
    np.testing.assert_allclose(ratio, 3 * np.std(velocity(pair[1][0])) / np.std(velocity(pair[0][0])), rtol=0.05)


def test_modes_that_inputs_drive_are_no_hum():
    rng = np.random.default_rng(6)
    u = rng.standard_normal(SAMPLES)
    y = velocity(u, [1e-12 + 1j, 1e-12 + 2j, 1e-12 + 5j], [0.5, 0.4, 0.01])
    result = phc.pem((u, y + 0.02 * np.std(y) * rng.standard_normal(SAMPLES)), dt=STEP)
    assert result.order == 3 and not hums(result)


def short(seed, tone):
    """Input and output of a mode in a short record, with noise of a tenth, and a tone beside it."""
    u, z = (rng := np.random.default_rng(seed)).standard_normal(200), np.exp(-0.02 + 1.2j)
    y = np.real(lfilter([0, (z - 1) / (-0.02 + 1.2j)], [1, -z], u + 0j))
    return u, y + 0.1 * np.std(y) * (rng.standard_normal(200) + tone * np.cos(2.1 * np.arange(200)))


def test_hum_is_named_that_hardly_stands_out_of_the_noise():
    result = phc.pem(short(3, 0.7), dt=1.0, quantity="velocity", delay=0)
    (hum,) = hums(result)
    assert result.order == 1 and abs(hum.values[0] - 2.1) < np.pi / 200


def test_a_second_mode_that_is_given_where_there_is_noise_alone_is_no_hum():
    result = phc.pem(short(26, 0.0), 2, dt=1.0, quantity="velocity", delay=0)
    assert result.order == 2 and not hums(result)


def test_a_mode_of_noise_beyond_those_there_are_is_no_hum():
    plant, rng = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25])), np.random.default_rng(1)
    t, u = 0.1 * np.arange(1000), rng.standard_normal(1000)
    y = phc.forced_response(plant, t, u, intersample="zoh").outputs + 0.05 * rng.standard_normal(1000)
    result = phc.pem((u, y), 3, dt=0.1, intersample="zoh", structure="lossless")
    assert result.order == 3 and not result.findings


@pytest.mark.slow
def test_files_and_resamples_keep_hum(tmp_path):
    result = phc.pem(humming(7, 0.2, 4.0), dt=STEP)
    result.save(tmp_path / "fit.json")
    assert hums(phc.load(tmp_path / "fit.json")) == hums(result)
    spread = result.bootstrap(20, rng=0).natural_frequencies.std(axis=0)
    np.testing.assert_allclose(spread, result.stderr["natural_frequencies"], rtol=0.6)

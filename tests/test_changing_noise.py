"""Noise that changes within a recording: it is named, and each sample counts by the noise of its span."""

import numpy as np
import pytest
from known import HELD
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

STEP, SAMPLES = 0.3, 900
POLES = np.array([-0.01 + 1j, -0.03 + 2j])
SHAPES = np.array([[1.0, 0.7], [-0.6, 0.9]])
LOUD = slice(400, 700)


def velocities(u):
    """Outputs (2, T) of two modes, pushed where the first sensor is."""
    y = np.zeros((2, len(u)))
    for p, shape in zip(POLES, SHAPES, strict=True):
        z = np.exp(p * STEP)
        q = lfilter([0, (z - 1) / p], [1, -z], (shape[0] * u).astype(complex))
        y += 2 * np.outer(shape, (p / (p - p.conj()) * q).real)
    return y


def recorded(seed, factors, size=0.03):
    """Input and outputs of one recording with so many times the noise in the loud span."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(SAMPLES)
    y = velocities(u)[: len(factors)]
    level = np.ones(y.shape)
    level[:, LOUD] = np.array(factors)[:, None]
    return u, y + size * y.std(axis=1, keepdims=True) * level * rng.standard_normal(y.shape)


def changes_in(result):
    return [finding for finding in result.findings if finding.cause.name == "CHANGING_NOISE"]


@pytest.fixture(scope="module")
def fits():
    """Fits to recordings of one output, ten times louder in a third of them; and without that third."""
    pairs = []
    for seed in range(3):
        u, y = recorded(seed, [10.0])
        gap = y.copy()
        gap[:, LOUD] = np.nan
        pairs.append([phc.pem((u, values), 2, dt=STEP, structure="free", **HELD) for values in (y, gap)])
    return pairs


@pytest.mark.slow
def test_the_span_and_its_size_are_named(fits):
    for result, _ in fits:
        (finding,) = changes_in(result)
        starts, sizes = np.reshape(finding.values, (-1, 2)).T
        at_centre = sizes[np.searchsorted(starts, 550, side="right") - 1]
        assert at_centre == pytest.approx(10 * sizes[0], rel=0.2) and at_centre == max(sizes)
        assert min(abs(starts - 400)) <= 16 and min(abs(starts - 700)) <= 16
        assert finding.gain > 200 and "times from sample" in result.message
        assert result.verdict == "consistent with the record"
    assert phc.pem(recorded(0, [10.0]), dt=STEP, structure="free").order == 2


def test_a_loud_span_takes_nothing_from_a_fit(fits):
    errors = np.array([[fit.natural_frequencies - np.abs(POLES) for fit in pair] for pair in fits])
    stderr = np.array([[fit.stderr["natural_frequencies"] for fit in pair] for pair in fits])
    weighed, without = np.sqrt(np.mean(errors**2, axis=0))
    assert np.all(weighed < 1.3 * without)
    # the loud span adds a little, and the motion through it
    assert np.all(stderr[:, 0] < 1.02 * stderr[:, 1])
    assert 0.4 < np.mean((errors / stderr)[:, 0] ** 2) < 2.0


def test_a_result_has_the_recording_that_was_given(fits, tmp_path):
    result, (u, y) = fits[0][0], recorded(0, [10.0])
    (experiment,) = result.experiments
    np.testing.assert_array_equal(experiment.record.y, y[0])
    assert experiment.predicted.shape == (SAMPLES,) and result.unknowns < 25
    clean = velocities(u)[0]
    assert np.std(experiment.predicted - clean) < 0.3 * np.std(y[0, :400] - clean[:400])
    (finding,) = changes_in(result)
    quiet = min(finding.values[1::2])
    spread = np.std((experiment.record.y - experiment.predicted)[:400])
    np.testing.assert_allclose(quiet * np.sqrt(result.noise_variance[0]), spread, rtol=0.1)
    result.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert changes_in(again) == [finding]
    resampled = again.bootstrap(20, rng=0).natural_frequencies.std(axis=0)
    np.testing.assert_allclose(resampled, result.stderr["natural_frequencies"], rtol=0.5)


def test_noise_that_triples_for_half_of_a_recording_is_no_outliers():
    u, y = recorded(0, [1.0])
    y[0, 450:] += np.sqrt(8) * 0.03 * y.std() * np.random.default_rng(1).standard_normal(450)
    result = phc.pem((u, y), 2, dt=STEP, structure="free")
    (finding,) = changes_in(result)
    assert abs(finding.values[2] - 450) < 20 and abs(finding.values[3] / finding.values[1] - 3) < 0.5
    assert result.outcome.name == "CONSISTENT"


def test_noise_that_looks_correlated_may_change():
    """So few loud samples count that outputs look alike by chance; here they are."""
    u, y = recorded(0, [10.0, 10.0])
    clean = velocities(u)
    noise = y - clean
    noise[1] += 0.3 * noise[0]
    result = phc.pem((u, clean + noise), 2, dt=STEP, structure="free", **HELD)
    correlated = phc.pem((u, clean + noise), 2, dt=STEP, structure="free", noise="correlated", **HELD)
    assert changes_in(result)
    assert np.all(result.stderr["natural_frequencies"] < 0.5 * correlated.stderr["natural_frequencies"])


@pytest.mark.parametrize("sign", [1, *slowly(-1)])
def test_the_last_loud_sample_is_no_outlier(sign):
    """Which one output alone shows: had it been left outside, nothing would be told of the noise."""
    u, y = recorded(0, [10.0, 10.0])
    clean = velocities(u)
    y[:, 699] = clean[:, 699] + np.array([25.0 * sign, 0.1]) * 0.03 * clean.std(axis=1)
    y[:, 698] = clean[:, 698] + np.array([0.2, 0.1]) * 0.03 * clean.std(axis=1)
    (finding,) = changes_in(phc.pem((u, y), 2, dt=STEP, structure="free", **HELD))
    assert abs(finding.values[2] - 400) < 5 and abs(finding.values[4] - 700) < 5


@pytest.mark.slow
def test_outputs_change_together_or_alone():
    together = changes_in(phc.pem(recorded(3, [8.0, 8.0]), 2, dt=STEP))
    assert [finding.output for finding in together] == [""]
    alone = changes_in(phc.pem(recorded(3, [1.0, 8.0]), 2, dt=STEP))
    assert [finding.output for finding in alone] == ["y2"]


@pytest.mark.variants
@pytest.mark.parametrize("noise", ["white", "coloured", "outlier", "saturated", "decay"])
def test_other_circumstances_are_no_change_of_the_noise(noise):
    u, y = recorded(0, [1.0])
    rng = np.random.default_rng([0, 1])
    if noise == "coloured":
        y = y + 0.02 * lfilter([1.0], [1.0, -0.9], rng.standard_normal(y.shape))
    elif noise == "outlier":
        y[0, 30] += 5 * y.std()
    elif noise == "saturated":
        y = np.clip(y, -1.5 * y.std(), 1.5 * y.std())
    elif noise == "decay":
        decay = np.exp(POLES[:1, None] * STEP * np.arange(SAMPLES)).real
        u, y = None, decay + 0.02 * rng.standard_normal(decay.shape)
    result = phc.pem((u, y), 2 if noise == "saturated" else "auto", dt=STEP, structure="free")
    assert not changes_in(result)


def test_a_free_decay_may_be_noisy_at_first():
    t, rng = STEP * np.arange(SAMPLES), np.random.default_rng(0)
    noise = 0.01 * np.where(t < 100, 12.0, 1.0) * rng.standard_normal(SAMPLES)
    result = phc.pem((None, 2 * (np.exp(np.outer(POLES[:1], t))).real[0] + noise), dt=STEP)
    (finding,) = changes_in(result)
    starts, sizes = np.reshape(finding.values, (-1, 2)).T
    assert sizes[0] == pytest.approx(12 * sizes[-1], rel=0.25) and abs(starts[1] - 334) <= 16
    z = (result.natural_frequencies[0] - np.abs(POLES[0])) / result.stderr["natural_frequencies"][0]
    assert abs(z) < 3.5


@pytest.mark.slow
def test_missing_samples_and_a_delay_go_with_changing_noise():
    u, y = recorded(5, [10.0])
    y[0, 100:130] = np.nan
    late = 3
    result = phc.pem((u[late:], y[:, :-late]), 2, dt=STEP, structure="free", offset=False)
    names = {finding.cause.name for finding in result.findings}
    assert {"CHANGING_NOISE", "DELAY"} <= names
    assert abs(result.delay[0] - late * STEP) < 0.3 * STEP
    np.testing.assert_allclose(result.natural_frequencies, np.abs(POLES), atol=4e-3)


@pytest.mark.parametrize("seed", [2, *slowly(0, 7)])
def test_noise_is_coloured_in_spans_in_which_little_goes_on(seed):
    rng, k = np.random.default_rng(seed), np.arange(600)
    u = np.where((k > 20) & (k < 300), np.repeat(rng.choice([-1.0, 1.0], 60), 10), 0.0)
    u[340:350] = 1.0
    y = lfilter([0.0, 1 - np.exp(-1 / 8)], [1.0, -np.exp(-1 / 8)], u)
    y += np.where(k < 330, 0.03, 0.18) * lfilter([1.0], [1.0, -0.9], rng.standard_normal(600))
    result = phc.pem((u, y), dt=1.0, quantity="free", **HELD)
    assert changes_in(result) and result.noise.orders[0] > 0 and result.states == 1
    assert abs(result.time_constants[0] - 8) < 3 * result.stderr["time_constants"][0] < 1.0


@pytest.mark.parametrize("seed", [8, *slowly(4, 10)])
def test_an_output_that_rests_on_a_digit_has_the_noise_of_its_digits(seed):
    rng, u = np.random.default_rng(seed), np.zeros(300)
    for k in np.sort(rng.integers(5, 270, 5)):
        u[k:] = rng.uniform(-1, 1)
    y = lfilter([0.0, 1 - np.exp(-1 / 15)], [1.0, -np.exp(-1 / 15)], np.append(np.zeros(4), u)[:300])
    digit = 0.1 * y.std()
    y = np.round((y + 0.01 * y.std() * rng.standard_normal(300)) / digit) * digit
    result = phc.pem((u, y), dt=1.0, quantity="free")
    assert result.states == 1 and not changes_in(result)
    assert abs(result.time_constants[0] - 15) < 3 * result.stderr["time_constants"][0] < 1.5

"""What shapes a record beside the modes, and the orders that `pem` finds in spite of it."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

TWO_POLES = np.array([-0.01 + 0.3j, -0.02 + 1.2j])


def recording(seed, *, n=3, samples=1200, snr=20.0, intersample="zoh"):
    """Plant, input, and output with white noise of a random lossless plant."""
    rng = np.random.default_rng([seed, n])
    d = np.linspace(0.3, 2.6, n) + rng.uniform(-0.2, 0.2, n)
    plant, u = phc.ph(phc.modes(d, rng.uniform(0.3, 1.0, n) / d)), rng.standard_normal(samples)
    y = phc.forced_response(plant, np.arange(samples), u, intersample=intersample).outputs
    size = np.std(y) * 10 ** (-snr / 20)
    return plant, u, y, y + size * rng.standard_normal(samples), size


def causes(result):
    return {one.cause.name: one for one in result.findings}


def found_all(result, plant, samples):
    """Whether every mode of the plant is there, and no other."""
    return result.order == plant.n and bool(np.all(np.abs(result.d - plant.d) < 0.1 * np.pi / samples))


def two_modes(seed):
    """Generator, a white input of 1500 samples, and what two damped modes make of it."""
    rng, y = np.random.default_rng(seed), np.zeros(1500)
    u = rng.standard_normal(1500)
    for p, residue in zip(TWO_POLES, (1.0, 0.7), strict=True):
        z = np.exp(p)
        y += 2 * np.real(residue * lfilter([0, (z - 1) / p], [1, -z], u + 0j))
    return rng, u, y


# --- constants and drifts --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples, order", [(400, 1), (5000, "auto"), *slowly((400, "auto"), (2000, 1))])
def test_a_constant_of_the_sensor_is_estimated_and_named(samples, order):
    rng = np.random.default_rng(0)
    y = 2 + np.cos(1.3 * np.arange(samples)) + 0.05 * rng.standard_normal(samples)
    result = phc.pem((None, y), order, dt=1.0)
    assert result.success
    np.testing.assert_allclose(result.d, [1.3], atol=1e-3 * 2 * np.pi / samples * 10)
    np.testing.assert_allclose(result.offsets, [2.0], atol=0.02)
    np.testing.assert_allclose(causes(result)["CONSTANT"].values, result.offsets)


def test_a_drift_of_a_third_of_the_motion_is_named_in_a_short_record():
    u, z = (rng := np.random.default_rng(3)).standard_normal(200), np.exp(-0.02 + 1.2j)
    y = np.real(lfilter([0, (z - 1) / (-0.02 + 1.2j)], [1, -z], u + 0j))
    noise = 0.3 * rng.standard_normal(200)
    result = phc.pem((u, y + np.std(y) * (noise + 0.3 * np.arange(200) / 200)), dt=1.0, quantity="velocity", delay=0)
    assert (result.order, len(result.real_poles)) == (1, 0) and causes(result).keys() == {"DRIFT", "LOSSES"}


@pytest.mark.parametrize("seed", [1, *slowly(4, 5)])
def test_a_drift_beside_a_constant_is_no_pole_that_grows(seed):
    rng, u, y = two_modes(seed)
    y += np.std(y) * (0.1 * rng.standard_normal(1500) + 3 + 0.5 * np.linspace(0, 1, 1500))
    result = phc.pem((u, y), dt=1.0, intersample="zoh", delay=0.0)
    assert (result.order, len(result.real_poles)) == (2, 0) and "DRIFT" in causes(result)


@pytest.mark.slow
def test_a_drift_of_the_sensor_is_estimated_and_named():
    samples = 600
    plant, u, _, y, size = recording(1, samples=samples)
    drift = 50 * size / samples
    result = phc.pem((u, y + 1.0 + drift * np.arange(samples)), dt=1.0)
    assert found_all(result, plant, samples)
    np.testing.assert_allclose(result.experiments[0].drift, drift, rtol=0.05)
    np.testing.assert_allclose(result.offsets, [1.0], atol=size)
    assert causes(result)["DRIFT"].gain > 100
    assert phc.pem((u, y), dt=1.0).experiments[0].drift == 0


def test_a_drift_comes_back_from_a_file_and_a_bootstrap_refits_it(tmp_path):
    plant, u, _, y, size = recording(2, n=1, samples=300)
    result = phc.pem((u, y + 3 * size * np.arange(300) / 10), dt=1.0)
    result.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert again.experiments[0].drift == result.experiments[0].drift != 0
    assert again.findings == result.findings
    assert result.bootstrap(5, rng=0).d.shape == (5, 1)
    ahead = result.predict(np.zeros(3), initial_state="final").outputs
    level = result.offsets[0] + result.experiments[0].drift * 300
    assert abs(ahead[0] - level) < abs(plant.r[0]) * 50


def test_a_motion_slower_than_the_record_stays_a_mode():
    k = np.arange(2000.0)
    y = 5 * np.cos(0.5 * np.pi * k / 2000 + 0.3) + np.cos(1.3 * k)
    result = phc.pem((None, y + 0.05 * np.random.default_rng(0).standard_normal(2000)), dt=1.0)
    np.testing.assert_allclose(result.d, [0.25 * np.pi / 1000, 1.3], rtol=0.02)
    assert not {"CONSTANT", "DRIFT"} & set(causes(result))


def test_the_loss_never_rises_along_the_path():
    rng = np.random.default_rng(0)
    for slow in (0.0, 0.1, 0.3, 0.6):
        y = 2 * np.cos(2 * np.pi * slow * np.arange(2000) / 2000) + np.cos(1.3 * np.arange(2000))
        result = phc.pem((None, y + 0.05 * rng.standard_normal(2000)), dt=1.0)
        losses = np.array([row.loss for row in result.order_table])
        assert np.all(np.diff(losses) <= 0.01 * losses[1:])


def test_no_constant_is_estimated_where_it_is_forbidden():
    rng = np.random.default_rng(0)
    y = 2 + np.cos(1.3 * np.arange(500)) + 0.05 * rng.standard_normal(500)
    result = phc.pem((None, y), dt=1.0, offset=False, real_poles=0)
    assert np.isnan(result.stderr["offset"]).all() and not {"CONSTANT", "DRIFT"} & set(causes(result))
    slow = phc.pem((None, y), dt=1.0, offset=False)
    assert slow.structure == "lossless" and slow.real_poles.tolist() == [0.0] and not slow.offsets.any()
    with pytest.raises(phc.StructureError, match="offset"):
        phc.pem((None, y), dt=1.0, offset="yes")


# --- when the input arrives ------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize(
    "intersample, order, samples", [("zoh", 3, 800), ("foh", 3, 2500), ("zoh", "auto", 2500), ("foh", "auto", 800)]
)
def test_the_hold_is_the_one_that_the_data_prefer(intersample, order, samples):
    plant, u, _, y, _ = recording(3, samples=samples, intersample=intersample)
    result = phc.pem((u, y), order, dt=1.0)
    assert result.intersample == intersample
    # a held input is the default, and no finding
    assert "HOLD" not in causes(result) if intersample == "zoh" else causes(result)["HOLD"].gain > 3
    assert found_all(result, plant, samples)
    assert result.verdict == phc.pem((u, y), order, dt=1.0, intersample=intersample).verdict


def test_two_modes_three_bins_apart_do_not_hide_the_hold():
    samples = 1000
    rng = np.random.default_rng(1)
    place = rng.uniform(150, 450)
    plant = phc.ph(phc.modes(2 * np.pi / samples * np.array([0.5 * place, place, place + 3]), [0.5, 0.2, 0.2]))
    u, start = rng.standard_normal(samples), rng.standard_normal(6)
    y = phc.forced_response(plant, np.arange(float(samples)), u, start, intersample="foh").outputs
    result = phc.pem((u, y + 0.1 * np.std(y) * rng.standard_normal(samples)), dt=1.0)
    assert result.intersample == "foh" and found_all(result, plant, samples)


def test_where_the_data_cannot_tell_the_input_counts_as_held():
    plant = phc.ph(phc.modes(0.02, 1.0))
    rng = np.random.default_rng(0)
    u = np.sin(0.03 * np.arange(1500))
    y = phc.forced_response(plant, np.arange(1500), u, intersample="foh").outputs + rng.standard_normal(1500)
    result = phc.pem((u, y), 1, dt=1.0)
    assert result.intersample == "zoh" and "HOLD" not in causes(result)


def test_a_hold_that_the_likelihood_does_not_tell_is_called_undecided():
    # with what is fed through, an input that is held and one that is linear are the same model
    rng = np.random.default_rng(0)
    u = np.convolve(np.repeat(rng.choice([-1.0, 1.0], 20), 10), np.ones(5) / 5)[:200]
    pendulum = ct.tf([1.0, 0.0, 0.0], [1.0, 0.06, 1.0])
    y = phc.forced_response(pendulum, 0.2 * np.arange(200), u, intersample="foh").outputs
    y = y + 0.02 * np.std(y) * rng.standard_normal(200)
    result = phc.pem((u, y), 1, dt=0.2, quantity="free", real_poles=0)
    assert abs(causes(result)["HOLD"].gain) < 1e-6
    assert "does not tell whether the input between samples was held or linear" in result.message
    assert "over the other" not in result.message


def test_the_table_of_orders_takes_the_hold_of_the_data_too():
    _, u, _, y, _ = recording(4, n=2, samples=600, intersample="foh")
    assert phc.order_selection((u, y), 4, dt=1.0).chosen() == 2


@pytest.mark.variants
@pytest.mark.parametrize("delay, samples", [(1, 900), (-1, 900), *slowly((3, 2500))])
def test_a_delay_is_named_and_the_order_stays(delay, samples):
    plant, u, _, y, _ = recording(5, samples=samples)
    late = (u[delay:], y[:-delay]) if delay > 0 else (u[:delay], y[-delay:])
    result = phc.pem(late, dt=1.0)
    finding = causes(result)["DELAY"]
    found, error = finding.values
    assert abs(found - delay) < 4 * error < 0.05 and finding.gain > 8
    assert result.order == plant.n and result.structure == "lossless"
    assert f"{'later' if delay > 0 else 'earlier'} than the response to the input" in result.message
    assert result.delay[0] == found and result.outcome.name == "CONSISTENT"


def test_a_mode_slower_than_the_record_is_called_a_drift():
    rng, plant = np.random.default_rng(8), phc.ph(phc.modes(3.0, 0.33, damping=0.01))
    t, u = 0.05 * np.arange(1500), rng.standard_normal(1500)
    y = phc.forced_response(plant, t, u, intersample="zoh").outputs + 0.01 * rng.standard_normal(1500)
    result = phc.pem((u, y + 0.5 * np.sin(2 * np.pi * t / 110)), 2, dt=0.05, offset=False)
    assert result.order == 2 and result.natural_frequencies[0] < 2 * np.pi / t[-1]
    assert "Mode 1 would complete less than one period in the record" in result.message
    assert "less than one period" not in phc.pem((u, y), dt=0.05).message


# --- noise -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("drift, order, delays", [(0.0, "auto", (1,)), (1.0, 2, (8,)), *slowly((0.0, "auto", (8,)))])
def test_a_delay_of_a_damped_plant_is_named_and_none_where_there_is_none(drift, order, delays):
    rng = np.random.default_rng(5)
    plant = phc.ph(phc.modes([3.0, 7.0], [0.33, 0.09], damping=[0.01, 0.009]))
    u = rng.standard_normal(1400)
    y = phc.forced_response(plant, 0.05 * np.arange(1400), u, intersample="zoh").outputs
    y = y + np.std(y) * (0.03 * rng.standard_normal(1400) + drift * np.arange(1400) / 700)
    on_time = phc.pem((u, y), order, dt=0.05, real_poles=0)
    assert "DELAY" not in causes(on_time)
    # one or four heavily damped modes mimic the shortest and the longest of these, and leave white residuals
    for delay in delays:
        late = phc.pem((u[delay:], y[:-delay]), order, dt=0.05, real_poles=0)
        found, error = causes(late)["DELAY"].values
        assert abs(found - 0.05 * delay) < 4 * error < 0.02 * 0.05
        assert "later than the response to the input" in late.message
        assert late.experiments[0].record.samples == len(u) - delay
        assert [one.cause.name for one in late.findings].count("DRIFT") == (drift > 0)
        assert late.order == 2 and late.structure == "classical"
        np.testing.assert_allclose(late.damping_ratios, on_time.damping_ratios, rtol=0.02)


@pytest.mark.parametrize("seed", [4, *slowly(3)])
def test_samples_that_are_missing_do_not_make_coloured_noise_modes(seed):
    rng, u, y = two_modes(seed)
    y += 0.1 * np.std(y) * lfilter([0.436], [1, -0.9], rng.standard_normal(1500))
    y[rng.random(1500) < 0.1] = np.nan
    result = phc.pem((u, y), dt=1.0, intersample="zoh", delay=0.0)
    assert (result.order, len(result.real_poles)) == (2, 0) and result.noise.orders[0] > 0
    errors = result.poles - TWO_POLES
    assert np.all(np.abs(errors) < 5 * result.stderr["natural_frequencies"])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *slowly(1)])
def test_coloured_noise_is_named_and_adds_no_modes(seed):
    plant, u, clean, _, size = recording(6 + seed)
    rng = np.random.default_rng(seed)
    noise = np.zeros(1400)
    for k, white in enumerate(rng.standard_normal(1399), start=1):
        noise[k] = 0.9 * noise[k - 1] + white
    result = phc.pem((u, clean + 0.5 * size * noise[200:] / np.std(noise)), dt=1.0)
    assert found_all(result, plant, 120)
    low, high, density, share = causes(result)["COLOURED_RESIDUALS"].values
    # half the power of an autoregression of first order lies below (1 - phi) / sqrt(phi) rad per sample
    assert low == 0 and 0.05 < high < 0.2 and density > 20 and abs(share - 0.5) < 0.1
    assert result.outcome.name == "COLOURED"


@pytest.mark.slow
def test_noise_on_the_input_is_named_and_adds_few_modes():
    _, u, _, y, _ = recording(11)
    result = phc.pem((u + 0.1 * np.random.default_rng(0).standard_normal(1200), y), 3, dt=1.0)
    finding = causes(result)["INPUT_NOISE"]
    np.testing.assert_allclose(finding.values[0], 0.1, rtol=0.5)


def test_white_noise_gives_no_finding():
    for seed in range(3):
        _, u, _, y, _ = recording(seed, samples=600)
        assert not causes(phc.pem((u, y), dt=1.0))


def test_a_hold_that_was_given_stays_and_the_other_is_named():
    plant, u, _, y, _ = recording(12, samples=900, intersample="foh")
    result = phc.pem((u, y), dt=1.0, intersample="zoh")
    assert result.intersample == "zoh" and result.order == plant.n
    assert causes(result)["HOLD"].values == (1.0,)
    assert "intersample='foh'" in result.message


def test_of_several_arrivals_the_one_that_explains_the_record_is_taken():
    rng = np.random.default_rng(2)
    plant = phc.ph(phc.modes([0.36, 0.37, 2.41], [1.0, 1.5, 0.2]))
    u = rng.standard_normal(2000)
    y = phc.forced_response(plant, np.arange(2000.0), u, intersample="foh").outputs
    result = phc.pem((u, y + 0.1 * np.std(y) * rng.standard_normal(2000)), dt=1.0)
    assert result.intersample == "foh" and found_all(result, plant, 2000)
    assert set(causes(result)) == {"HOLD"}


def test_a_drift_beside_one_mode_that_starts_at_rest_is_no_motion_of_the_mode():
    rng = np.random.default_rng(0)
    t, u = 0.1 * np.arange(600), rng.standard_normal(600)
    y = phc.forced_response(phc.ph(phc.modes(1.3, 1.0)), t, u, intersample="zoh").outputs
    y = y + 0.5 + 0.03 * t + 0.02 * rng.standard_normal(600)
    result = phc.pem((u, y), 1, dt=0.1, initial_state="zero")
    assert "DRIFT" in causes(result) and not result.initial_state.any()
    np.testing.assert_allclose(result.d, 1.3, atol=4 * result.stderr["d"][0])
    left = result.residuals - result.residuals.mean()
    assert np.std(left) < 0.022


def test_a_disturbance_that_grows_is_no_mode_of_the_plant(capfd):
    rng, t = np.random.default_rng(1), np.arange(300)
    u, z = rng.standard_normal(300), np.exp(0.2 * (-0.02 + 1j))
    y = 2 * lfilter([0, (z - 1) / (-0.02 + 1j)], [1, -z], 0.5 * u + 0j).real
    y = y + 0.15 * np.std(y) * np.exp((t - 300) / 80) * np.cos(0.9 * t)
    result = phc.pem((u, y + 0.05 * np.std(y) * rng.standard_normal(300)), dt=0.2, intersample="zoh", quantity="free")
    np.testing.assert_allclose(result.poles, [-0.02 + 1j], atol=0.01)
    assert capfd.readouterr() == ("", ""), "libraries have nothing to say"


def test_a_weak_mode_without_losses_is_not_taken_to_grow_for_the_error_of_its_decay():
    u = (rng := np.random.default_rng(4)).standard_normal(600)
    y = 0.0
    for d, size in ((0.5, 1.0), (1.3, 0.05)):
        z = np.exp(1j * d)
        y = y + 2 * size / d * lfilter([0, z - 1], [1, -z], u + 0j).imag
    result = phc.pem((u, y + 0.05 * np.std(y) * rng.standard_normal(600)), dt=1.0)
    assert (result.order, result.structure, result.outcome.name) == (2, "lossless", "CONSISTENT")

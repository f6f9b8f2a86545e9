"""Outputs that come later than the response to the inputs, by whole samples or parts of them."""

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.signal import lfilter
from shell import without_pictures
from slow import slowly

import ph_control as phc

SHAPES, OMEGA, DAMPING = np.array([[1.0, 0.9], [0.8, -0.7], [0.9, 0.6]]), [1.3, 2.9, 5.1], [0.012, 0.02, 0.01]
DT, FINE = 0.2, 20


def structure():
    """Velocities at two places, from a force at the first, of a plant whose damping its modes decouple."""
    d, none = np.array(OMEGA), np.zeros((3, 3))
    A = np.block([[none, np.eye(3)], [-np.diag(d**2), -np.diag(2 * d * DAMPING)]])
    B = np.concatenate([np.zeros((3, 1)), SHAPES[:, :1]])
    return ct.ss(A, B, np.concatenate([np.zeros((2, 3)), SHAPES.T], axis=1), np.zeros((2, 1)))


def skewed(seed, delays, noise=0.02, samples=2000):
    """Held input at the first of two places, velocities at both, late by multiples of a twentieth of a sample."""
    rng = np.random.default_rng(seed)
    d, zeta = np.array(OMEGA), np.array(DAMPING)
    poles = d * (-zeta + 1j * np.sqrt(1 - zeta**2))
    u = rng.standard_normal(samples)
    fine, often = np.zeros((2, samples * FINE)), np.repeat(u, FINE) + 0j
    for p, shape in zip(poles, SHAPES, strict=True):
        z = np.exp(p * DT / FINE)
        motion = p / (2j * p.imag) * lfilter([0, (z - 1) / p], [1, -z], often)
        fine += 2 * np.outer(shape, shape[0] * motion.real)
    outputs = []
    for row, delay in zip(fine[: len(delays)], delays, strict=True):
        k = round(delay * FINE)
        late = np.concatenate([np.zeros(max(k, 0)), row[max(-k, 0) :]])[: samples * FINE]
        outputs.append(np.pad(late, (0, samples * FINE - len(late)))[::FINE])
    y = np.array(outputs)
    return u, y + noise * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape), poles


def fitted(u, y, **options):
    return phc.pem((u[None], y) if len(y) > 1 else (u, y[0]), dt=DT, intersample="zoh", ports=[(0, 0)], **options)


def test_channels_that_are_skewed_keep_their_structure():
    u, y, poles = skewed(0, (0.35, 0.75), samples=1000)
    result = fitted(u, y)
    assert (result.order, result.structure) == (3, "classical")
    assert np.all(np.abs(result.delay / DT - (0.35, 0.75)) < 4 * result.stderr["delay"] / DT)
    assert np.all(result.stderr["delay"] < 0.01 * DT)
    np.testing.assert_allclose(result.poles, poles, rtol=2e-3)
    low, high = np.moveaxis(np.array(result.confidence_interval()["delay"]), -1, 0)
    np.testing.assert_allclose(high - low, 2 * 1.96 * result.stderr["delay"], rtol=1e-2)
    findings = [one for one in result.findings if one.cause.name == "DELAY"]
    assert [one.output for one in findings] == ["y1", "y2"]
    np.testing.assert_allclose([one.values[0] for one in findings], result.delay)
    assert "later than the response to the input" in result.message and "delay  " in str(result)


@pytest.mark.parametrize("order", [3, *slowly("auto")])
def test_a_common_delay_is_one_number(order):
    # of three modes that are given none can stand for the delay, but forces that nobody measured may
    u, y, _ = skewed(2, (1.6, 1.6), samples=1000)
    result = fitted(u, y, order=order)
    assert result.structure == "classical" and np.ptp(result.delay) == 0
    assert abs(result.delay[0] - 1.6 * DT) < 4 * result.stderr["delay"][0]
    assert sum(one.cause.name == "DELAY" for one in result.findings) == 1


@pytest.mark.slow
def test_data_and_predictions_are_those_of_the_user():
    u, y, _ = skewed(2, (2.4, 2.4))
    result = fitted(u[:1400], y[:, :1400])
    record = result.experiments[0].record
    np.testing.assert_array_equal(record.y, y[:, :1400])
    np.testing.assert_array_equal(np.isnan(result.experiments[0].predicted).sum(axis=1) <= 6, True)
    again = result.predict((u[None, 1400:], y[:, 1400:]))
    assert np.isfinite(again.outputs).all()
    left = again.outputs[:, 3:] - y[:, 1403:]
    assert np.all(left.std(axis=1) < 1.1 * np.sqrt(result.noise_variance))
    compared = phc.compare((u[None, 1400:], y[:, 1400:]), result, dt=DT)
    assert compared.fit_percent[0] > 97
    without = phc.compare((u[None, 1400:], y[:, 1400:]), result.observed_system, dt=DT, intersample="zoh")
    assert without.fit_percent[0] < 80
    # from rest, inputs before the record are 0: what was made is what is predicted
    start = result.predict((u[None, :1400], y[:, :1400]), initial_state="zero").outputs
    assert np.all((start - y[:, :1400]).std(axis=1) < 1.1 * np.sqrt(result.noise_variance))
    fitted_state = result.predict((u[None, :1400], y[:, :1400]), initial_state="fitted").outputs
    known = ~np.isnan(result.experiments[0].predicted)
    np.testing.assert_allclose(fitted_state[known], result.experiments[0].predicted[known], atol=1e-9)


@pytest.fixture(scope="module")
def late():
    """Record of two channels with the same delay, and its fit."""
    u, y, _ = skewed(3, (0.6, 0.6), samples=1000)
    return u, y, fitted(u, y, order=3, noise="white")


def test_what_answers_to_inputs_before_a_record_is_not_compared(late):
    u, y, result = late
    compared = phc.compare((u[None, 500:], y[:, 500:]), result, dt=DT)
    predicted = compared.predicted[0]
    assert np.isnan(predicted[:, 0]).all() and np.isfinite(predicted[:, 1:]).all()
    assert compared.fit_percent[0] > 97
    # from rest nothing is missing: what is before the record is 0
    from_rest = phc.compare((u[None], y), result, dt=DT, initial_state="zero")
    assert np.isfinite(from_rest.predicted).all()


def test_files_and_pages_have_the_delay(late, tmp_path, monkeypatch):
    without_pictures(monkeypatch)
    u, y, result = late
    assert result.delay[0] > 0
    result.save(tmp_path / "late.json")
    again = phc.load(tmp_path / "late.json")
    np.testing.assert_array_equal(again.delay, result.delay)
    np.testing.assert_array_equal(again.stderr["delay"], result.stderr["delay"])
    np.testing.assert_allclose(again.predict((u[None], y)).outputs, result.predict((u[None], y)).outputs)
    result.report(tmp_path / "late.html")
    page = (tmp_path / "late.html").read_text(encoding="utf-8")
    assert "in predictions and not in system" in page and "delay=[0.1" in page
    analysed = phc.compare((u[None], y), result, dt=DT)
    assert abs(analysed.fit_percent[0] - result.fit_percent) < 0.1


@pytest.mark.slow
def test_pictures_of_a_response_have_the_delay(late):
    *_, result = late
    omega = np.linspace(0.8, 5.5, 30)
    exact = result.observed_system(1j * omega)[:, 0] * np.exp(-1j * np.multiply.outer(result.delay, omega))
    pictures = phc.frf_plot(result, Hz=False).lines[1], phc.bode_plot(result, Hz=False).lines[1::2, 0]
    for phases in pictures:
        for k, (line, *_) in enumerate(phases):
            drawn = np.interp(omega, *line.get_data())
            np.testing.assert_allclose(np.exp(1j * np.radians(drawn)), exact[k] / np.abs(exact[k]), atol=2e-2)
    for k in range(2):
        low, high = result.sample(100, 0).phase_band(omega, output=k)
        middle = np.exp(0.5j * np.radians(low + high))
        np.testing.assert_allclose(middle, exact[k] / np.abs(exact[k]), atol=2e-2)


@pytest.mark.slow
def test_a_rational_approximation_has_the_phase_of_the_delay():
    u, y, _ = skewed(4, (0.9, 0.0))
    result = fitted(u, y, order=3)
    assert result.delay[1] == 0 or abs(result.delay[1]) < 4 * result.stderr["delay"][1]
    omega = np.linspace(0.2, 6.0, 40)
    near = result.with_delay(pade=4)(1j * omega)[:, 0]
    exact = result.observed_system(1j * omega)[:, 0] * np.exp(-1j * np.multiply.outer(result.delay, omega))
    np.testing.assert_allclose(near, exact, atol=1e-5 * np.abs(exact).max())


@pytest.mark.slow
def test_a_delay_that_is_given_is_taken_as_it_is():
    u, y, _ = skewed(5, (0.45, 0.8))
    result = fitted(u, y, delay=[0.45 * DT, 0.8 * DT])
    assert result.structure == "classical" and not result.stderr["delay"].any()
    assert not any(one.cause.name == "DELAY" for one in result.findings)
    assert fitted(u, y, delay=0).structure != "classical"
    with pytest.raises(phc.StructureError, match=r"delay has shape \(3,\).*each of the 2 outputs"):
        fitted(u, y, delay=[0.1, 0.2, 0.3])
    with pytest.raises(phc.StructureError, match="delay"):
        fitted(u, y, delay="some")


def test_no_delay_is_found_where_there_is_none():
    late = [fitted(*skewed(seed, (0.0, 0.0), samples=700)[:2]).delay.any() for seed in range(5)]
    assert sum(late) == 0


@pytest.mark.parametrize("seed, samples", [(134, 300), (219, 200)])
def test_residues_that_noise_alone_turns_show_no_delay(seed, samples):
    # classical damping is rejected by chance, and delays explain a little of that, or most with large errors
    result = fitted(*skewed(seed, (0.0, 0.0), noise=0.1, samples=samples)[:2], order=3, noise="white")
    assert not result.delay.any() and result.tests[1].p < 0.05


def test_a_delay_that_loud_noise_nearly_hides_is_found():
    result = fitted(*skewed(2, (0.4, 0.4), noise=0.5, samples=500)[:2], order=3, noise="white")
    assert result.structure == "classical" and abs(result.delay[0] - 0.4 * DT) < 3 * result.stderr["delay"][0]


def test_a_smooth_input_that_comes_late_is_linear_between_its_samples():
    # free residues absorb a little of what goes on between samples, which a held input explains without a delay
    rng, y = np.random.default_rng(2), 0.0
    u = lfilter([0.1], [1.0, -0.9], rng.standard_normal(501))
    fine = np.interp(np.arange(500 * FINE) / FINE, np.arange(501), u)
    for p in np.array([-0.02 + 0.4j, -0.03 + 0.9j]) / FINE:
        z = np.exp(p)
        y = y + (p / (1j * p.imag) * lfilter([0, (z - 1) / p / FINE], [1, -z], fine + 0j)).real
    y = np.append(np.zeros(26), y)[: len(fine)][::FINE]
    y = y + 0.05 * np.std(y) * rng.standard_normal(500)
    result = phc.pem((u[:500], y), 2, dt=1.0, quantity="velocity", noise="white")
    assert result.intersample == "foh" and abs(result.delay[0] - 1.3) < 0.05


def test_a_delay_of_a_twentieth_of_a_sample_is_found():
    result = fitted(*skewed(3, (0.05, 0.05), noise=0.1, samples=400)[:2], order=3, noise="white")
    assert result.structure == "classical" and abs(result.delay[0] - 0.05 * DT) < 3 * result.stderr["delay"][0]


@pytest.mark.slow
def test_the_error_of_a_delay_is_what_it_errs_by():
    delays = 0.05 * np.random.default_rng(0).integers(1, 40, 6)
    z = []
    for seed, delay in enumerate(delays.tolist()):
        result = fitted(*skewed(100 + seed, (delay,) * 2, samples=900)[:2], order=3, noise="white")
        assert result.structure == "classical"
        z.append((result.delay[0] - delay * DT) / result.stderr["delay"][0])
    assert 0.4 < np.mean(np.square(z)) < 1.9


@pytest.mark.parametrize("late", [7, *slowly(31, 90)])
def test_modes_that_come_later_than_the_past_of_predictors_are_no_more_modes(late):
    u, y, poles = skewed(3, (float(late), float(late)), samples=1500)
    result = fitted(u, y)
    assert (result.order, result.states) == (3, 6)
    np.testing.assert_allclose(result.delay / DT, late, atol=0.02)
    np.testing.assert_allclose(result.poles, poles, rtol=3e-3)


@pytest.mark.parametrize("seed", [0, *slowly(1, 2)])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_hold_of_an_input_is_told_together_with_its_delay(hold, seed):
    # in whole samples a mode that is late by 2.4 has the same likelihood under either hold, with something fed through
    rng, times = np.random.default_rng(seed), np.arange(1500 * FINE) / FINE - 2.4
    u = np.repeat(rng.choice([-1.0, 1.0], 300), 5) + 0.2 * rng.standard_normal(1500)
    p = -0.4 + 0.1j
    z = np.exp(p / FINE)
    held = u[np.clip(np.floor(times + 1e-9).astype(int), 0, None)]
    fine = held if hold == "zoh" else np.interp(times, np.arange(1500), u)
    y = ((0.2 - 1.7j) * lfilter([0, (z - 1) / p], [1, -z], fine + 0j)).real[::FINE]
    result = phc.pem((u, y + 0.01 * np.std(y) * rng.standard_normal(1500)), dt=1.0, noise="white")
    assert (result.intersample, result.structure) == (hold, "free")
    assert ("HOLD" in [finding.cause.name for finding in result.findings]) == (hold == "foh")
    assert abs(result.delay[0] - 2.4) < 0.05 and abs(result.poles[0] - p) < 0.01


@pytest.fixture(scope="module")
def late_lag():
    """Fit of a lag of 4 samples, late by 2.6 samples, after steps of its input."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], 15), 20)
    z = np.exp(-1 / (4 * FINE))
    fine = lfilter([0.0, 1 - z], [1.0, -z], np.repeat(u, FINE))
    y = np.append(np.zeros(52), fine)[: len(fine)][::FINE] + 0.02 * rng.standard_normal(len(u))
    return phc.pem((u, y), 0, dt=DT, real_poles=1, quantity="free", intersample="zoh", noise="white")


def test_a_lag_tells_where_within_a_sample_its_dead_time_is(late_lag):
    error = late_lag.stderr["delay"][0]
    assert 0 < error < 0.1 * DT and abs(late_lag.delay[0] - 2.6 * DT) < 3 * error
    assert abs(late_lag.time_constants[0] - 4 * DT) < 3 * late_lag.stderr["time_constants"][0]
    assert "(+- " in next(sentence for sentence in late_lag.message.split(". ") if "later than" in sentence)


@pytest.mark.parametrize("seed, each", [(4, 12), (6, 1)])
def test_the_part_of_a_sample_by_which_a_lag_is_late_is_no_second_lag(seed, each):
    # a lag that is over within a sample explains as much, beside steps and beside an input that changes with each
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(300) if each == 1 else np.repeat(rng.choice([-1.0, 1.0], 300 // each), each)
    z = np.exp(-1 / (10 * FINE))
    fine = lfilter([0.0, 1 - z], [1.0, -z], np.repeat(u, FINE))
    y = np.append(np.zeros(FINE // 2), fine)[: len(fine)][::FINE]
    y += 0.02 * np.std(y) * rng.standard_normal(300)
    result = phc.pem((u, y), dt=1.0, quantity="free", noise="white")
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert abs(result.delay[0] - 0.5) < 3 * result.stderr["delay"][0] < 0.2


@pytest.mark.parametrize("seed", [9, *slowly(17)])
def test_two_lags_that_come_late_keep_both_lags_after_a_few_steps(seed):
    # without the delay the faster of them stands for most of it
    rng, u = np.random.default_rng(seed), np.zeros(400)
    for begin in np.sort(rng.integers(5, 360, 5)):
        u[begin:] = rng.uniform(-1.0, 1.0)
    late = np.append(np.zeros(3), u)[:400]
    slow, fast = (lfilter([0.0, 1 - z], [1.0, -z], late) for z in np.exp(-1 / np.array([15.0, 5.0])))
    y = 1.5 * slow - 0.5 * fast
    result = phc.pem((u, y + 0.02 * np.std(y) * rng.standard_normal(400)), dt=1.0, quantity="free")
    assert abs(result.delay[0] - 3) < 3 * result.stderr["delay"][0] < 1.5
    assert np.all(np.abs(result.time_constants - [15, 5]) < 3 * result.stderr["time_constants"])


def test_a_step_is_drawn_with_the_dead_time_and_the_poles_are_named(late_lag):
    plot = phc.step_plot(late_lag, confidence=True)
    t, y = plot.lines[0, 0][0].get_data()
    after = np.maximum(t - late_lag.delay[0], 0.0)
    gain = float(ct.dcgain(late_lag.system))
    np.testing.assert_allclose(y, gain * -np.expm1(-after / late_lag.time_constants[0]), atol=1e-6)
    assert plot.axes[0, 0].get_legend_handles_labels()[1][0] == "fit (1 real pole)"
    plt.close(plot.figure)
    band = late_lag.sample(50, 0).step_band([0.99 * late_lag.delay[0], 1.5 * late_lag.delay[0]])
    assert np.all(band[:, 0] == 0) and np.all(band[:, 1] > 0)


def test_a_response_shows_the_delay_of_a_lossy_plant():
    rng, omega = np.random.default_rng(6), np.linspace(0.4, 7.0, 300)
    response = structure()(1j * omega)[0, 0] * np.exp(-1j * omega * 0.17)
    response = response + 0.003 * np.abs(response).max() * (rng.standard_normal(300) + 1j * rng.standard_normal(300))
    result = phc.pem(ct.frd(response[None, None], omega), quantity=["velocity"], delay=0.17)
    assert result.order == 3 and np.isclose(result.delay[0], 0.17)
    np.testing.assert_allclose(np.angle(result.residues[:, 0, 0]), 0.0, atol=0.05)
    compared = phc.compare(ct.frd(response[None, None], omega), result)
    assert compared.fit_percent[0] > 90


@pytest.mark.variants
@pytest.mark.parametrize("seed", [0, 16])
def test_a_delay_does_not_stand_for_the_damping_that_a_given_structure_lacks(seed):
    """Free residues explain the data without a delay, so that the lossless model is refused, and nothing else named."""
    rng = np.random.default_rng(seed)
    u, t, p = rng.standard_normal(2000), np.arange(2000.0), np.array([0.5, 1.3, 2.2]) * (-1e-4 + 1j)
    plant = phc.modes(p, [[1.0], [0.6], [0.8]], [[1.0], [1.0], [1.0]]).state_space()
    y = ct.forced_response(ct.c2d(plant, 1.0), t, u).outputs
    result = phc.pem((u, y + 0.05 * y.std() * rng.standard_normal(2000)), 3, dt=1.0, structure="lossless")
    assert result.tests[0].p < 1e-6 and not result.delay.any()
    assert {finding.cause.name for finding in result.findings}.isdisjoint({"DELAY", "INPUT_NOISE"})


@pytest.mark.parametrize("seed", [0, *slowly(1)])
def test_a_gain_alone_may_come_late(seed):
    rng, late = np.random.default_rng(seed), 12
    u = np.repeat(rng.choice([-1.0, 1.0], 12), 25)[:150]
    y = np.concatenate([np.zeros(late), 0.8 * u[:-late]]) + rng.standard_normal(150)
    result = phc.pem((u, y), dt=1.0)
    assert not len(result.poles) and result.delay[0] == late
    np.testing.assert_allclose(result.feedthrough[0, 0], 0.8, atol=0.3)


# --- plants with dead times ------------------------------------------------------------------------------------------


def lagging(u, time_constant, late):
    """Output of a lag of unit gain, at the samples of a held input, after a dead time in samples."""
    a = np.exp(-1 / time_constant)
    return lfilter([0.0, 1 - a], [1.0, -a], np.concatenate([np.zeros(late), u[: len(u) - late]]))


def switched(seed, samples):
    rng = np.random.default_rng(seed)
    return rng, np.repeat(rng.choice([-1.0, 1.0], samples // 8 + 1), 8)[:samples]


@pytest.mark.parametrize(
    ("late", "time_constants"), [((5, 2), (15, 15)), *slowly(((0, 4), (15, 15)), ((3, 1), (15, 6)), ((2, 2), (15, 6)))]
)
def test_outputs_with_dead_times_of_their_own_share_lags(late, time_constants):
    rng, u = switched(0, 400)
    y = np.array([lagging(u, *pair) for pair in zip(time_constants, late, strict=True)])
    y += 0.03 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    result = phc.pem((u, y), dt=1.0, quantity="free", noise="white", intersample="zoh")
    assert result.states == len(set(time_constants))
    np.testing.assert_allclose(result.delay, late, atol=0.2)


@pytest.mark.parametrize("lags", [(15,), (15, 5)])
def test_exact_data_show_a_dead_time_and_nothing_that_is_fed_through(lags):
    _, u = switched(1, 300)
    y = u
    for place, time_constant in enumerate(lags):
        y = lagging(y, time_constant, 0 if place else 4)
    result = phc.pem((u, y), dt=1.0, quantity="free", noise="white")
    assert result.delay[0] == pytest.approx(3 + len(lags)) and result.intersample == "zoh"
    np.testing.assert_allclose(np.sort(result.time_constants), sorted(lags))
    np.testing.assert_array_equal(result.system.D, 0.0)


def test_errors_are_those_of_the_noise_beside_the_delay_where_a_search_ended():
    # and not beside that where it began, a sample later with something that is fed through
    rng, u = switched(1, 300)
    y = lagging(u, 15, 4)
    y += 1e-3 * y.std() * rng.standard_normal(300)
    result = phc.pem((u, y), dt=1.0, quantity="free", noise="white")
    assert result.stderr["time_constants"][0] < 0.01 and result.stderr["delay"][0] < 0.002
    assert abs(result.time_constants[0] - 15) < 3 * result.stderr["time_constants"][0]


def test_phases_of_a_few_lines_are_no_delay():
    rng, t = np.random.default_rng(0), np.arange(1000)
    u = sum(np.sin(w * t + rng.uniform(0, 2 * np.pi)) for w in (0.05, 0.15, 0.4, 0.55, 0.9))
    plant = ct.c2d(ct.tf([0.25], np.polymul([15, 1], [1, 0.1, 0.25])), 1.0, "foh")
    y = ct.forced_response(plant, None, u).outputs
    y += 0.03 * y.std() * rng.standard_normal(1000)
    result = phc.pem((u, y), dt=1.0, quantity="free", noise="white")
    assert not result.delay.any() and result.states == 3
    assert abs(result.time_constants[0] - 15) < 4 * result.stderr["time_constants"][0]


def late_by(seed, delay, time_constant, noise, samples=1200):
    """Steps up and down, and the output of a lag of gain 2 that is late by some samples."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 20 + 1), 20)[:samples]
    a = np.exp(-1 / time_constant / FINE)
    late = np.concatenate([np.zeros(round(delay * FINE)), np.repeat(u, FINE)])[: samples * FINE]
    y = 2 * lfilter([0, 1 - a], [1, -a], late)[::FINE]
    return u, y + noise * y.std() * rng.standard_normal(samples)


@pytest.mark.parametrize(("seed", "delay"), [(1, 42.8), *slowly((0, 31.35))])
def test_parts_of_a_sample_are_told_of_long_delays(seed, delay):
    u, y = late_by(seed, delay, 60.0, 0.005)
    result = phc.pem((u, y), dt=1.0)
    assert (result.order, len(result.real_poles), result.structure) == (0, 1, "classical")
    assert abs(result.delay[0] - delay) < 4 * result.stderr["delay"][0] < 0.2
    assert "INPUT_NOISE" not in {finding.cause.name for finding in result.findings}


def test_outputs_may_be_sampled_less_often_than_inputs():
    u, y = late_by(1, 23.85, 55.0, 0.03, 1000)
    seen = np.where(np.arange(1000) % 10 == 0, y, np.nan)
    result = phc.pem((u, seen), dt=1.0, noise="white", intersample="zoh")
    assert (result.order, len(result.real_poles)) == (0, 1)
    np.testing.assert_allclose(result.time_constants, 55.0, rtol=0.06)
    np.testing.assert_allclose(result.delay, 23.85, atol=3.0)


@pytest.mark.parametrize(("seed", "structure"), [(1, "free"), *slowly((0, "auto"))])
def test_what_is_fed_through_may_come_late(seed, structure):
    # half of the output follows the input at once, as later as the lag does: no part of a sample says as much
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 41), 20)[:800]
    y = 0.5 * np.concatenate([np.zeros(8), u[:-8]]) + 0.5 * lagging(u, 20, 8)
    y += 0.01 * y.std() * rng.standard_normal(800)
    result = phc.pem((u, y), dt=1.0, quantity="free", structure=structure, noise="white", intersample="zoh")
    assert (result.order, len(result.real_poles), result.delay[0]) == (0, 1, 8.0)
    np.testing.assert_allclose(result.system.D, 0.5, rtol=0.02)
    np.testing.assert_allclose(result.time_constants, 20.0, rtol=0.02)

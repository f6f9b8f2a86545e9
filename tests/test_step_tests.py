"""Step tests: an input that changes seldom, soon after the record begins."""

import control as ct
import numpy as np
import pytest
from slow import slowly

import ph_control as phc

# what most of these tests are not about, and searches would take time for
KNOWN = {"quantity": "free", "noise": "white", "intersample": "zoh"}


def step_test(delay, first, *, gain=2.0, constant=12.0, samples=200, seed=0, noise=0.005):
    """Input from 5 to 7 at a sample, and a lag that is late, at rest with the first input, in noise."""
    u = np.where(np.arange(samples) < first, 5.0, 7.0)
    fine = 20
    late = np.concatenate([np.full(round(delay * fine), 5.0), np.repeat(u, fine)])[: samples * fine] - 5.0
    y = ct.forced_response(ct.c2d(ct.tf([gain], [constant, 1]), 1 / fine), np.arange(len(late)) / fine, late).outputs
    return u, 30.0 + y[::fine] + 2 * gain * noise * np.random.default_rng(seed).standard_normal(samples)


@pytest.mark.parametrize(("delay", "first", "seed"), [(2.4, 8, 2), (5.0, 12, 3), *slowly((3.0, 10, 1))])
def test_the_only_step_is_not_left_out_for_the_sake_of_delays(delay, first, seed):
    """Of what is left without the step, a lag in motion tells as much with any delay and gain."""
    result = phc.pem(step_test(delay, first, seed=seed), dt=1.0, quantity="free")
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert ct.dcgain(result.system).item() == pytest.approx(2.0, rel=0.05)
    assert result.delay[0] == pytest.approx(delay, abs=0.5)
    assert result.time_constants[0] == pytest.approx(12.0, rel=0.05)


@pytest.mark.parametrize(("delay", "intersample"), [(4.0, "zoh"), (4.3, "foh"), *slowly((4.0, "foh"), (4.3, "zoh"))])
def test_an_input_that_changes_once_lasted_before_the_record(delay, intersample):
    u, y = step_test(4.0, 2)
    known = {"real_poles": 1, "delay": delay, "intersample": intersample, "noise": "white"}
    result = phc.pem((u, y), 0, dt=1.0, quantity="free", **known)
    (experiment,) = result.experiments
    assert np.isfinite(experiment.predicted).all()
    # what a result states of motion, constant and poles gives the same
    again = np.ravel(result.predict(u, initial_state="fitted").outputs)
    np.testing.assert_allclose(again, experiment.predicted, rtol=0, atol=1e-9)
    assert np.std(experiment.predicted - y) < 0.03


@pytest.mark.parametrize("delay", [0.0, 2.4, *slowly(3.0)])
def test_a_step_from_an_operating_point_tells_what_one_from_zero_does(delay):
    u, y = step_test(delay, 20, noise=0.02)
    result, from_zero = (phc.pem((inputs, y), dt=1.0, quantity="free") for inputs in (u, u - u[0]))
    np.testing.assert_allclose(result.poles, from_zero.poles, rtol=1e-6)
    np.testing.assert_allclose(result.residues, from_zero.residues, rtol=1e-6)
    np.testing.assert_allclose(result.delay, from_zero.delay, rtol=1e-6, atol=1e-9)
    (gain,) = np.ravel(ct.dcgain(result.system))
    # the constant is that of the plant without an input
    np.testing.assert_allclose(result.offsets[0], from_zero.offsets[0] - 5 * gain, rtol=1e-9)
    assert abs(result.offsets[0] - (30 - 5 * 2.0)) < 4 * result.stderr["offset"]
    assert abs(gain - 2.0) < 0.1
    assert result.stderr["offset"] > 3 * from_zero.stderr["offset"]
    again = np.ravel(result.predict(u, initial_state="fitted").outputs)
    predicted = result.experiments[0].predicted
    np.testing.assert_allclose(again, predicted, rtol=0, atol=1e-9)
    # so has what is estimated of the motion anew
    np.testing.assert_allclose(np.ravel(result.predict((u, y)).outputs), predicted, rtol=0, atol=0.1)


@pytest.mark.parametrize("kind", ["noise", "steps"])
def test_fitted_motions_beside_dead_times_of_inputs_predict_what_was_fitted(kind):
    rng, k = np.random.default_rng(0), np.arange(600)
    steps = np.array([np.where(k < 30, 3.0, 4.0), np.where(k < 200, -2.0, -1.0)])
    u = rng.standard_normal((2, 600)) if kind == "noise" else steps
    late = np.array([np.r_[np.full(dead, x[0]), x[:-dead]] for x, dead in zip(u, (5, 9), strict=True)])
    plant = ct.c2d(ct.ss(ct.tf([[[1.0], [0.5]]], [[[10, 1], [25, 1]]])), 1.0)
    y = ct.forced_response(plant, k, late - u[:, :1]).outputs + 3 + 0.01 * rng.standard_normal(600)
    result = phc.pem((u, y), 0, real_poles=2, dt=1.0, input_delay=[5.0, 9.0], delay=0, **KNOWN)
    predicted = np.ravel(result.experiments[0].predicted)
    again = np.ravel(result.predict(u, initial_state="fitted").outputs)
    known = ~np.isnan(predicted)
    assert known.sum() >= 591
    np.testing.assert_allclose(again[known], predicted[known], rtol=0, atol=1e-9)


@pytest.mark.parametrize("first", [1, 2])
def test_a_step_just_after_the_first_sample_shows_the_gain(first):
    k = np.arange(300)
    y = ct.forced_response(ct.c2d(ct.tf([2.0], [12, 1]), 1.0), k, np.where(k < first, 0.0, 1.0)).outputs
    y += 0.02 * np.random.default_rng(first).standard_normal(300)
    result = phc.pem((np.where(k < first, 5.0, 6.0), y), dt=1.0, **KNOWN)
    assert (result.order, len(result.time_constants)) == (0, 1)
    np.testing.assert_allclose(np.ravel(ct.dcgain(result.system)), 2.0, rtol=0.01)


@pytest.mark.parametrize("hum", [0.0, 2.0])
def test_bootstrap_of_a_record_at_rest_is_of_one_at_rest(tmp_path, hum):
    u, y = step_test(0.0, 20, noise=0.02, samples=300)
    y += hum * np.sin(1.9 * np.arange(300) + 0.3)
    result = phc.pem((u, y), 0, dt=1.0, real_poles=1, delay=0.0, **KNOWN)
    drawn = result.bootstrap(60, rng=0)
    stated = np.array([result.stderr["real_poles"][0], result.stderr["offset"][0]])
    spread = np.std(np.column_stack([drawn.poles.real, drawn.offset]), axis=0)
    assert np.all(np.abs(np.log(spread / stated)) < 0.3)
    result.save(tmp_path / "step.json")
    assert phc.load(tmp_path / "step.json").experiments[0].resting


@pytest.mark.parametrize(
    ("early", "intersample"), [(-2.0, "zoh"), (-1.6, "foh"), *slowly((-2.0, "foh"), (-1.6, "zoh"))]
)
def test_outputs_that_come_before_their_inputs_begin_where_these_held_them(early, intersample):
    u, y = step_test(0.0, 20, noise=0.02)
    known = {"real_poles": 1, "delay": early, "noise": "white", "intersample": intersample}
    result, from_zero = (
        phc.pem((inputs, y[2:]), 0, dt=1.0, quantity="free", **known) for inputs in (u[:-2], u[:-2] - u[0])
    )
    np.testing.assert_allclose(result.poles, from_zero.poles, rtol=1e-6)
    predicted = result.experiments[0].predicted
    known_samples = ~np.isnan(predicted)
    assert known_samples.sum() > 190
    again = np.ravel(result.predict(u[:-2], initial_state="fitted").outputs)
    np.testing.assert_allclose(again[known_samples], predicted[known_samples], rtol=0, atol=1e-9)


def test_a_step_from_an_operating_point_is_one_beside_hum():
    u, y = step_test(0.0, 20, noise=0.01, samples=600)
    result = phc.pem((u, y + 0.3 * np.sin(1.9 * np.arange(600) + 0.3)), dt=1.0, **KNOWN)
    assert {finding.cause.name for finding in result.findings} >= {"HUM", "CONSTANT"}
    assert result.experiments[0].resting
    np.testing.assert_allclose(result.time_constants, 12.0, rtol=0.05)
    assert abs(result.offsets[0] - 20) < 4 * result.stderr["offset"][0]


def test_steps_of_two_inputs_from_operating_points():
    rng = np.random.default_rng(0)
    k = np.arange(400)
    u = np.array([np.where(k < 15, 3.0, 4.0), np.where(k < 150, -2.0, -1.0)])
    gain = np.array([[1.0, 0.5], [-0.3, 2.0]])
    plant = ct.tf(gain[:, :, None].tolist(), [[[10, 1], [25, 1]], [[25, 1], [10, 1]]])
    y = ct.forced_response(ct.c2d(ct.ss(plant), 1.0), k, u - u[:, :1]).outputs
    y += np.array([[7.0], [-4.0]]) + gain @ u[:, :1] + 0.01 * rng.standard_normal(y.shape)
    result = phc.pem((u, y), dt=1.0, delay=0.0, input_delay=0.0, **KNOWN)
    assert np.abs(np.sort(result.time_constants) / [10, 25] - 1).max() < 0.03
    (experiment,) = result.experiments
    assert np.all(np.abs(experiment.offsets - [7, -4]) < 4 * experiment.offset_stderr)
    again = result.predict(u, initial_state="fitted").outputs
    np.testing.assert_allclose(again, experiment.predicted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["in motion", "without a constant", "integrator"])
def test_what_is_not_at_rest_at_an_operating_point_may_move(kind):
    rng = np.random.default_rng(3)
    k = np.arange(400)
    u = np.where(k < 12, 5.0, 7.0)
    plant = ct.tf([1], [10, 1, 0]) if kind == "integrator" else ct.tf([2.0], [16, 0.8, 1])
    state = np.zeros(2) if kind == "integrator" else -np.linalg.solve(ct.ss(plant).A, ct.ss(plant).B[:, 0] * 5.0)
    state = state + np.array([40.0, 0.0]) * (kind == "in motion")
    y = ct.forced_response(ct.c2d(ct.ss(plant), 1.0), k, u - 5.0 * (kind == "integrator"), state).outputs
    y = y + 0.02 * rng.standard_normal(400)
    offset = False if kind == "without a constant" else "auto"
    options = {**KNOWN, "delay": 0.0} if kind == "integrator" else {"quantity": "free"}
    result = phc.pem((u, y), dt=1.0, offset=offset, **options)
    if kind == "integrator":
        assert np.abs(result.real_poles).min() < 1e-3
    else:
        np.testing.assert_allclose(2 * np.pi * result.hertz, 0.25, rtol=0.01)
        np.testing.assert_allclose(np.ravel(ct.dcgain(result.system)), 2.0, rtol=0.02)
    assert result.fit_percent > 97
    assert np.any(result.experiments[0].free_amplitudes)


def tank(seed, inflow, balance, noise=0.02):
    """Input that steps up and down about its first value, and an integrator that the `balance` leaves at rest."""
    rng = np.random.default_rng(seed)
    k = np.arange(500)
    u = inflow + ((k >= 60) & (k < 160)) - 1.0 * ((k >= 230) & (k < 380))
    return u, -20.0 + 0.04 * np.cumsum(np.append(0.0, u[:-1] - balance)) + noise * rng.standard_normal(500)


@pytest.mark.parametrize("seed", [0, *slowly(1)])
def test_an_integrator_may_be_in_balance_at_an_operating_point(seed):
    u, y = tank(seed, 7.0, 7.0)
    result = phc.pem((u, y), dt=1.0, intersample="zoh")
    assert (result.order, len(result.real_poles)) == (0, 1) and abs(result.real_poles[0]) < 1e-3
    assert "consistent" in str(result.verdict)
    assert "INPUT_NOISE" not in {finding.cause.name for finding in result.findings}
    np.testing.assert_allclose(result.residues.real.ravel(), 0.04, rtol=0.01)
    again = np.ravel(result.predict(u, initial_state="fitted").outputs)
    np.testing.assert_allclose(again, result.experiments[0].predicted, rtol=0, atol=1e-5)


def test_an_integrator_without_losses_is_drawn_and_predicted_in_balance():
    u, y = tank(4, 7.0, 7.0)
    result = phc.pem((u, y), dt=1.0, structure="lossless", noise="white", intersample="zoh")
    assert result.real_poles[0] == 0
    again = np.ravel(result.predict(u, initial_state="fitted").outputs)
    np.testing.assert_allclose(again, result.experiments[0].predicted, rtol=0, atol=1e-9)
    drawn = result.bootstrap(40, rng=0)
    np.testing.assert_allclose(np.std(drawn.offset), np.ravel(result.stderr["offset"])[0], rtol=0.5)


def test_an_integrator_that_runs_from_the_beginning_is_not_in_balance():
    u, y = tank(0, 2.0, 0.0)
    result = phc.pem((u, y), dt=1.0, noise="white", intersample="zoh")
    assert np.abs(result.real_poles).min() < 1e-3 and not result.experiments[0].resting
    np.testing.assert_allclose(result.residues.real.ravel()[0], 0.04, rtol=0.03)


@pytest.mark.parametrize(("delay", "seed"), [(4.0, 0), *slowly((6.0, 4))])
def test_lags_that_fall_together_hide_no_constant(delay, seed):
    # those that stand for a dead time that is not looked for leave no errors of the constant to judge by
    u = np.select([np.arange(300) < 20, np.arange(300) < 200], [5.0, 7.0], 6.3)
    late = np.concatenate([np.full(round(delay), 5.0), u])[:300] - 5.0
    y = 30.0 + ct.forced_response(ct.c2d(ct.tf([2.0], [12, 1]), 1.0), np.arange(300.0), late).outputs
    y += 0.02 * np.random.default_rng(seed).standard_normal(300)
    result = phc.pem((u, y), dt=1.0, delay=0.0)
    assert ct.dcgain(result.system).item() == pytest.approx(2.0, rel=0.02)
    assert np.std(result.experiments[0].predicted - y) < 0.023

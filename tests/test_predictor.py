"""The noise of a fit: its predictor, its Kalman gain, and outputs some steps ahead, beside textbook formulas."""

from __future__ import annotations

import functools
import pickle
from dataclasses import replace
from typing import Any

import control as ct
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_discrete_are
from scipy.signal import lfilter

import ph_control as phc
from ph_control import NoSuchQuantityError, StructureError

STEP = 0.1


def simulated(system: Any, u: Any, step: float = STEP) -> Any:
    """Outputs (p, T) of a system from rest, its inputs held, by matrices of `control.c2d`."""
    discrete = ct.c2d(ct.ss(system), step)
    x, y = np.zeros(discrete.nstates), np.zeros((discrete.noutputs, u.shape[1]))
    for k in range(u.shape[1]):
        y[:, k] = discrete.C @ x + discrete.D @ u[:, k]
        x = discrete.A @ x + discrete.B @ u[:, k]
    return y


def run(system: Any, signals: Any) -> Any:
    """Outputs of a discrete system from rest."""
    x, y = np.zeros(system.nstates), np.zeros((system.noutputs, signals.shape[1]))
    for k in range(signals.shape[1]):
        y[:, k] = system.C @ x + system.D @ signals[:, k]
        x = system.A @ x + system.B @ signals[:, k]
    return y


def autoregression(rng: Any, samples: int, *coefficients: float) -> Any:
    return lfilter([1.0], [1.0, *(-a for a in coefficients)], rng.standard_normal(samples))


@functools.cache
def arm() -> Any:
    return phc.ph(phc.modes([1.0, 2.5], [1.0, 0.5], damping=[0.03, 0.02]))


@functools.cache
def in_coloured_noise() -> tuple[Any, Any, Any]:
    """Fit to two modes in noise that is 0.9 times what it was a sample before, of standard deviation 0.4; its data."""
    rng = np.random.default_rng(4)
    u = rng.standard_normal((1, 4000))
    y = simulated(arm(), u) + 0.4 * np.sqrt(1 - 0.9**2) * autoregression(rng, 4000, 0.9)
    return phc.pem((u[0, :2000], y[0, :2000]), 2, dt=STEP), u, y


@functools.cache
def of_two_outputs() -> Any:
    """Fit in white noise of a mode and a real pole, two inputs and two outputs."""
    rng = np.random.default_rng(1)
    plant = ct.ss([[-0.1, -2, 0], [2, -0.1, 0], [0, 0, -1]], [[1, 0.3], [0, 1], [1, 1]],
                  [[1, 0.5, 1], [0.2, 1, -1]], np.zeros((2, 2)))  # fmt: skip
    u = rng.standard_normal((2, 800))
    return phc.pem((u, simulated(plant, u) + 0.1 * rng.standard_normal((2, 800))), 1, real_poles=1, dt=STEP)


def with_forces(result: Any, intensity: float = 0.3, **more: Any) -> Any:
    n = result.observed_system.nstates
    entry = np.linspace(-1.0, 1.0, 2 * n).reshape(n, 2)
    noise = phc.NoiseModel.driven(
        result.observed_system, entry, intensity * np.eye(2), result.noise.covariance, result.noise.dt, **more
    )
    return replace(result, noise=noise)


def innovations_model(result: Any) -> tuple[Any, Any, Any, Any, Any]:
    """A, B, C, D and K of a predictor, as its documentation says."""
    P, m = result.predictor, len(result.input_labels)
    K = P.B[:, m:]
    return P.A + K @ P.C, P.B[:, :m] + K @ P.D[:, :m], P.C, P.D[:, :m], K


# --- white and coloured noise ----------------------------------------------------------------------------------------


def test_with_white_noise_the_predictor_is_the_simulation():
    result, rng = of_two_outputs(), np.random.default_rng(2)
    assert result.noise.is_white and not innovations_model(result)[4].any() and not result.kalman_gain.any()
    u, y = rng.standard_normal((2, 2, 300))
    expected = result.predict(u, initial_state="zero").outputs
    np.testing.assert_allclose(run(result.predictor, np.concatenate([u, y])), expected, atol=1e-12)
    assert result.predictor.input_labels == ["u1", "u2", "y1", "y2"]
    assert result.predictor.output_labels == ["predicted y1", "predicted y2"] and result.predictor.dt == STEP
    record = result.record
    np.testing.assert_array_equal(result.predict(record, horizon=1).outputs, result.predict(record).outputs)


@pytest.mark.slow
def test_of_noise_of_first_order_the_predictor_is_the_formula_of_textbooks():
    """`yhat[k] = G u[k] + a (y[k-1] - G u[k-1])`."""
    result, u, y = in_coloured_noise()
    a = result.noise.colours[0, 0]
    assert abs(a - 0.9) < 0.03 and result.noise.orders == (1,)
    plant = result.predict(u[0], initial_state="zero").outputs
    expected = plant + a * np.append(0.0, (y[0] - plant)[:-1])
    predicted = run(result.predictor, np.concatenate([u, y]))[0]
    np.testing.assert_allclose(predicted, expected, atol=1e-12)
    assert not result.kalman_gain.any()  # inputs tell the states, whatever the colour


@pytest.mark.slow
def test_the_error_one_step_ahead_on_new_data_has_the_variance_of_the_innovations():
    result, u, y = in_coloured_noise()
    fresh = u[0, 2000:], y[0, 2000:]
    error = fresh[1] - result.predict(fresh, horizon=1).outputs
    true = (0.4 * np.sqrt(1 - 0.9**2)) ** 2
    # the variance of 2000 samples has a standard error of 3.2 %
    assert abs(np.mean(error**2) / result.noise.covariance[0, 0] - 1) < 0.12
    assert abs(result.noise.covariance[0, 0] / true - 1) < 0.1
    assert np.mean(error**2) < 0.3 * np.mean((fresh[1] - result.predict(fresh).outputs) ** 2)


def test_far_ahead_noise_is_forgotten_as_its_autoregression_does():
    result, u, y = in_coloured_noise()
    fresh = u[0, 2000:], y[0, 2000:]
    variance = result.noise.covariance[0, 0]
    errors = [fresh[1] - result.predict(fresh, horizon=h).outputs for h in (1, 3, 10)]
    a = result.noise.colours[0, 0]
    expected = [variance * np.sum(a ** (2 * np.arange(h))) for h in (1, 3, 10)]
    np.testing.assert_allclose([np.mean(error**2) for error in errors], expected, rtol=0.25)
    np.testing.assert_array_equal(
        result.predict(fresh, horizon=5000).outputs, result.predict(fresh).outputs
    )  # no sample is so long ago


def test_a_missing_sample_counts_as_what_was_predicted_of_it():
    result, u, y = in_coloured_noise()
    known = y[0, 2000:2100].copy()
    plant = result.predict((u[0, 2000:2100], known)).outputs
    a, gap = result.noise.colours[0, 0], known.copy()
    gap[50:52] = np.nan
    ahead = result.predict((u[0, 2000:2100], gap), horizon=1).outputs
    simulation = result.predict((u[0, 2000:2100], gap)).outputs
    last = gap[49] - simulation[49]
    np.testing.assert_allclose(ahead[50:53] - simulation[50:53], [a * last, a**2 * last, a**3 * last], atol=1e-12)
    assert np.abs(simulation - plant).max() < 0.2


def test_noise_of_two_outputs_has_a_colour_each():
    result = of_two_outputs()
    noise = phc.NoiseModel(np.diag([0.1, 0.2]), STEP, [[0.5, 0.2], [0.8, 0.0]])
    coloured, rng = replace(result, noise=noise), np.random.default_rng(3)
    u, y = rng.standard_normal((2, 2, 200))
    rest = y - result.predict(u, initial_state="zero").outputs
    past = np.pad(rest, ((0, 0), (2, 0)))
    expected = y - rest + np.array([[0.5], [0.8]]) * past[:, 1:-1] + np.array([[0.2], [0.0]]) * past[:, :-2]
    np.testing.assert_allclose(run(coloured.predictor, np.concatenate([u, y])), expected, atol=1e-12)
    assert coloured.predictor.nstates == result.predictor.nstates + 3


def test_the_spectrum_of_an_autoregression_integrates_to_its_variance():
    noise = phc.NoiseModel([[0.19, 0.05], [0.05, 0.5]], STEP, [[0.9], [0.0]])
    omega = np.linspace(-np.pi / STEP, np.pi / STEP, 20001)[1:]
    covariance = noise.spectrum(omega).mean(axis=2) / STEP
    np.testing.assert_allclose(covariance, [[1.0, 0.05], [0.05, 0.5]], atol=1e-6)
    with pytest.raises(StructureError, match=r"up to pi / dt = 31\.4159"):
        noise.spectrum([40.0])


# --- forces ----------------------------------------------------------------------------------------------------------


def test_with_forces_the_gain_is_that_of_the_discrete_riccati_equation():
    result = with_forces(of_two_outputs())
    A, _, C, _, K = innovations_model(result)
    Q, R = result.noise.forces, result.noise.covariance
    P = solve_discrete_are(A.T, C.T, Q, R)
    np.testing.assert_allclose(K, A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(K, ct.dlqe(A, np.eye(len(A)), C, Q, R)[0], rtol=1e-8, atol=1e-12)


def test_forces_that_outputs_feel_at_once_count_in_the_gain():
    result = with_forces(of_two_outputs())
    Q, R = result.noise.forces, result.noise.covariance
    rng = np.random.default_rng(0)
    through = 0.5 * rng.standard_normal((2, len(Q)))
    noise = phc.NoiseModel(R + through @ Q @ through.T, STEP, forces=Q, cross=Q @ through.T)
    A, _, C, _, K = innovations_model(replace(result, noise=noise))
    R, S = noise.covariance, noise.cross
    P = solve_discrete_are(A.T, C.T, Q, R, s=S)
    np.testing.assert_allclose(K, (A @ P @ C.T + S) @ np.linalg.inv(C @ P @ C.T + R), rtol=1e-8, atol=1e-12)


def test_forces_beside_colours_have_the_spectrum_of_the_innovations():
    """The Kalman filter factors the spectrum: `S = h H spread H^H` with `H = 1 + C (z - A)^-1 K`."""
    result = with_forces(of_two_outputs(), colours=[[0.7], [0.3]])
    A, _, C, _, K = innovations_model(result)
    assert np.abs(np.linalg.eigvals(A - K @ C)).max() < 1
    omega = np.array([0.0, 1.5, 8.0, 31.0])
    H = [np.eye(2) + C @ np.linalg.solve(z * np.eye(len(A)) - A, K) for z in np.exp(1j * omega * STEP)]
    spectra = np.moveaxis(result.noise.spectrum(omega), 2, 0) / STEP
    spread = [np.linalg.inv(h) @ S @ np.linalg.inv(h).conj().T for h, S in zip(H, spectra, strict=True)]
    for each in spread:  # the same at all frequencies, and real
        np.testing.assert_allclose(each, spread[0].real, rtol=1e-9)


def test_white_forces_in_continuous_time_leave_the_covariance_of_many_short_steps():
    plant = ct.ss([[-0.3, -5.0], [5.0, -0.3]], np.eye(2), np.eye(2), 0)
    entry, intensity = np.array([[1.0], [0.5]]), 2.0
    noise = phc.NoiseModel.driven(plant, entry, intensity, np.eye(2), STEP)
    short = STEP / 20000
    step, total = np.asarray(ct.c2d(plant, short).A), np.zeros((2, 2))
    middle = np.asarray(ct.c2d(plant, short / 2).A) @ entry
    for _ in range(20000):
        total = step @ total @ step.T + short * intensity * middle @ middle.T
    np.testing.assert_allclose(noise.forces, total, rtol=1e-7)


def test_the_gain_in_continuous_time_is_that_of_lqe():
    result = with_forces(of_two_outputs())
    plant = result.observed_system
    entry = np.linspace(-1.0, 1.0, 2 * plant.nstates).reshape(-1, 2)
    expected = ct.lqe(plant.A, entry, plant.C, 0.3 * np.eye(2), STEP * result.noise.covariance)[0]
    np.testing.assert_allclose(result.kalman_gain, expected, rtol=1e-6, atol=1e-9)
    P = solve_continuous_are(plant.A.T, plant.C.T, 0.3 * entry @ entry.T, STEP * result.noise.covariance)
    by_hand = P @ plant.C.T @ np.linalg.inv(STEP * result.noise.covariance)
    np.testing.assert_allclose(result.kalman_gain, by_hand, rtol=1e-6, atol=1e-9)


def test_the_gain_is_for_the_states_of_the_system_of_a_fit():
    """A port-Hamiltonian system has other states, and the same filter."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((1, 1000))
    y = simulated(arm(), u) + 0.1 * rng.standard_normal((1, 1000))
    result = with_forces(phc.pem((u[0], y[0]), 2, dt=STEP, structure="classical"))
    system, plain = result.system, result.observed_system
    assert isinstance(system, phc.PortHamiltonian) and not np.allclose(system.A, plain.A)
    entry = np.linspace(-1.0, 1.0, 2 * plain.nstates).reshape(-1, 2)
    L = ct.lqe(plain.A, entry, plain.C, 0.3 * np.eye(2), STEP * result.noise.covariance)[0]
    s = 1j * np.array([0.3, 1.0, 2.6, 9.0])
    own, other = (
        [C @ np.linalg.solve(each * np.eye(len(A)) - A + gain @ C, gain) for each in s]
        for A, C, gain in ((plain.A, plain.C, L), (system.A, system.C, result.kalman_gain))
    )
    np.testing.assert_allclose(other, own, rtol=1e-6)


def test_the_likelihood_one_step_ahead_is_largest_near_the_true_force():
    """A lag driven by a white force that nobody measured, half as strong, right, and twice as strong."""
    rng, samples = np.random.default_rng(5), 4000
    lag = ct.ss([[-1.0]], [[1.0]], [[1.0]], 0)
    a, variance = np.exp(-STEP), 0.5 * (1 - np.exp(-2 * STEP)) * 0.8
    u, x, y = rng.standard_normal(samples), 0.0, np.zeros(samples)
    for k in range(samples):
        y[k] = x + 0.1 * rng.standard_normal()
        x = a * x + (1 - a) * u[k] + np.sqrt(variance) * rng.standard_normal()
    result = phc.pem((u[:200], simulated(lag, u[None])[0, :200] + 1e-6 * rng.standard_normal(200)), dt=STEP)
    plant, gain = result.observed_system, result.observed_system.C[0, 0]

    def likelihood(times: float) -> float:
        forces = phc.NoiseModel.driven(plant, [[1 / gain]], 0.8 * times, [[0.01]], STEP)
        some = replace(result, noise=forces)
        A, _, C, _, _ = innovations_model(some)
        P = solve_discrete_are(A.T, C.T, forces.forces, forces.covariance)
        spread = (C @ P @ C.T + forces.covariance)[0, 0]
        error = y - run(some.predictor, np.stack([u, y]))[0]
        return float(-0.5 * np.sum(np.log(spread) + error**2 / spread))

    low, right, high = (likelihood(times) for times in (0.6, 1.0, 1.6))
    assert right > low + 10 and right > high + 10
    forced = replace(result, noise=phc.NoiseModel.driven(plant, [[1 / gain]], 0.8, [[0.01]], STEP))
    ahead = forced.predict((u, y), horizon=1, initial_state="zero").outputs
    np.testing.assert_allclose(ahead, run(forced.predictor, np.stack([u, y]))[0], atol=1e-10)
    A, B, C, D, K = innovations_model(forced)
    x, expected = np.zeros(len(A)), []
    for k in range(300):  # four steps ahead, from the state that is known then
        later = x
        for i in range(3):
            later = A @ later + B @ u[k + i : k + i + 1]
        expected.append((C @ later + D @ u[k + 3 : k + 4])[0])
        x = A @ x + B @ u[k : k + 1] + K @ (y[k : k + 1] - C @ x - D @ u[k : k + 1])
    ahead = forced.predict((u, y), horizon=4, initial_state="zero").outputs
    np.testing.assert_allclose(ahead[3:303], expected, atol=1e-10)


# --- poles that grow -------------------------------------------------------------------------------------------------


@functools.cache
def in_closed_loop() -> tuple[Any, Any, Any]:
    """Fit of an unstable plant of first order under a feedback, its data."""
    rng, step = np.random.default_rng(3), 0.05
    a, b = np.exp(0.5 * step), np.exp(0.5 * step) - 1
    u, y, x = np.zeros(3000), np.zeros(3000), 0.0
    for k in range(3000):
        y[k] = x + 0.05 * rng.standard_normal()
        u[k] = 3.0 * (rng.choice([-1.0, 1.0]) - y[k])
        x = a * x + 2 * b * u[k]
    return phc.pem((u[:400], y[:400]), dt=step), u, y


def test_of_a_pole_that_grows_the_gain_mirrors_it():
    """Without forces the filter of `x+ = a x` has the pole `1 / a`: `K c = a - 1 / a`."""
    result, _, _ = in_closed_loop()
    a = float(np.exp(result.real_poles[0] * result.noise.dt))
    assert a > 1
    _, _, C, _, K = innovations_model(result)
    np.testing.assert_allclose(K @ C, [[a - 1 / a]], rtol=1e-6)
    np.testing.assert_allclose(result.predictor.A, [[1 / a]], rtol=1e-6)
    L = result.kalman_gain @ result.system.C
    np.testing.assert_allclose(L, 2 * result.real_poles[0], rtol=1e-6)


def test_an_unstable_plant_is_predicted_where_its_simulation_has_left_the_record():
    result, u, y = in_closed_loop()
    error = y - result.predict((u, y), horizon=1).outputs
    assert np.std(error) < 0.06  # the noise is 0.05
    assert np.std(y - result.predict((u, y), horizon=20).outputs) < 0.1
    assert phc.compare((u, y), result, horizon=1).fit_percent[0] > 80


# --- delays ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("late", [0.0, 0.03, 0.1, 0.17, 0.4])
def test_a_predictor_has_the_delays_of_its_fit(hold, late):
    result, rng = of_two_outputs(), np.random.default_rng(2)
    delayed = replace(result, delay=np.array([late, 0.1]), intersample=hold)
    u, y = rng.standard_normal((2, 2, 400))
    u[:, :10] = 0.0  # inputs before the record are not known
    expected = delayed.predict(u, initial_state="zero").outputs
    np.testing.assert_allclose(run(delayed.predictor, np.concatenate([u, y])), expected, atol=1e-10)


def test_an_output_before_its_input_has_no_predictor():
    result = replace(of_two_outputs(), delay=np.array([-0.25, 0.0]))
    with pytest.raises(StructureError, match=r"comes 0\.25 before .* not known yet"):
        result.predictor  # noqa: B018
    # half a step, held, is known
    early, rng = replace(of_two_outputs(), delay=np.array([-0.05, -0.05])), np.random.default_rng(2)
    u, y = rng.standard_normal((2, 2, 300))
    u[:, 0] = 0.0
    expected = early.predict(u, initial_state="zero").outputs
    predicted = run(early.predictor, np.concatenate([u, y]))
    np.testing.assert_allclose(predicted, expected, atol=1e-10)


def test_forces_act_on_all_outputs_at_once_whatever_the_delays_of_inputs():
    result = with_forces(of_two_outputs())
    same, different = (replace(result, delay=np.array(each)) for each in ([0.2, 0.2], [0.2, 0.3]))
    u, y = np.zeros((2, 200)), np.random.default_rng(0).standard_normal((2, 200))
    signals = np.concatenate([u, y])
    expected = run(result.predictor, signals)
    for each in (same, different):
        np.testing.assert_allclose(run(each.predictor, signals), expected, atol=1e-9)
    with pytest.raises(NoSuchQuantityError, match="different delays"):
        different.kalman_gain  # noqa: B018


# --- reports and files -----------------------------------------------------------------------------------------------


def test_residuals_one_step_ahead_are_white_beside_those_of_the_simulation():
    result, u, y = in_coloured_noise()
    fresh = u[0, 2000:], y[0, 2000:]
    analysis = phc.residual_analysis(fresh, result)
    assert analysis.horizon == 1 and analysis.whiteness > 0.01 and analysis.simulation_whiteness < 1e-10
    np.testing.assert_allclose(analysis.residuals, fresh[1] - result.predict(fresh, horizon=1).outputs, atol=1e-9)
    np.testing.assert_allclose(analysis.simulation_residuals, fresh[1] - result.predict(fresh).outputs, atol=1e-9)
    assert analysis.verdict == "white, and independent of the input"
    assert "fit 1 step ahead" in str(analysis) and "fit of the simulation" in str(analysis)
    plain = phc.residual_analysis(fresh, result, horizon=None)
    assert plain.horizon is None and plain.whiteness == plain.simulation_whiteness == analysis.simulation_whiteness
    assert "1 step ahead" in analysis.plot().figure.get_suptitle()


@pytest.mark.slow
def test_the_test_of_white_residuals_keeps_its_level_where_the_noise_was_fitted():
    """What was fitted, coefficients of the noise among it, is missing from the residuals one step ahead."""
    rng, p_values = np.random.default_rng(11), []
    u = rng.standard_normal((1, 300))
    clean = simulated(phc.ph(phc.modes(1.0, 1.0, damping=0.05)), u)[0]
    for _ in range(8):
        fit = phc.pem((u[0], clean + 0.3 * autoregression(rng, 300, 0.8)), 1, dt=STEP, structure="free", delay=0)
        p_values.append(phc.residual_analysis(fit.record, fit, lags=8).whiteness)
    assert min(p_values) > 1e-3 and sum(p < 0.5 for p in p_values) >= 2


def test_a_comparison_names_its_horizon():
    result, u, y = in_coloured_noise()
    fresh = u[0, 2000:], y[0, 2000:]
    one, ten, simulation = (phc.compare(fresh, result, horizon=h) for h in (1, 10, None))
    assert one.fit_percent[0] > ten.fit_percent[0] > simulation.fit_percent[0]
    assert one.horizon == 1 and str(one).startswith(
        "Fit to 'y': 2000 samples; initial state estimated; predicted 1 step"
    )
    assert "predicted 10 steps ahead" in ten.plot().figure.get_suptitle()
    assert simulation.horizon is None and "simulated" in simulation.plot().figure.get_suptitle()
    np.testing.assert_array_equal(phc.compare(fresh, result, horizon=np.inf).predicted, simulation.predicted)
    np.testing.assert_array_equal(one.predicted[0], result.predict(fresh, horizon=1).outputs)


def test_comparisons_of_several_channels_predict_each_in_its_order():
    result = replace(
        of_two_outputs(), noise=phc.NoiseModel(np.diag([0.01, 0.01]), STEP, [[0.5], [-0.5]])
    )  # fmt: skip
    rng = np.random.default_rng(8)
    u, y = rng.standard_normal((2, 2, 300))
    swapped = ct.TimeResponseData(
        STEP * np.arange(300), y[::-1], inputs=u, output_labels=["y2", "y1"], input_labels=["u1", "u2"],
        issiso=False,
    )  # fmt: skip
    predicted = phc.compare(swapped, result, horizon=1).predicted[0]
    np.testing.assert_allclose(predicted[::-1], result.predict((u, y), horizon=1).outputs, atol=1e-10)


@pytest.mark.parametrize("make", [lambda: in_coloured_noise()[0], lambda: with_forces(of_two_outputs())])
def test_a_file_has_the_noise(make, tmp_path):
    result = make()
    result.save(tmp_path / "fit.json")
    for again in (phc.load(tmp_path / "fit.json"), pickle.loads(pickle.dumps(result))):
        for name in "ABCD":
            np.testing.assert_array_equal(getattr(again.predictor, name), getattr(result.predictor, name))
        np.testing.assert_array_equal(again.noise.spectrum([0.5]), result.noise.spectrum([0.5]))


def test_a_response_has_no_samples_to_predict():
    omega = np.linspace(0.2, 4.0, 200)
    rng = np.random.default_rng(0)
    response = arm()(1j * omega) + 0.01 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
    result = phc.pem(ct.frd(response, omega), 2)
    assert result.noise is None
    for name in ("predictor", "kalman_gain"):
        with pytest.raises(NoSuchQuantityError, match="no samples to predict"):
            getattr(result, name)
    with pytest.raises(StructureError, match="horizon is 1, and frequency responses have no samples"):
        phc.compare(ct.frd(response, omega), result, horizon=1)
    assert phc.residual_analysis(ct.frd(response, omega), result).horizon is None


@pytest.mark.parametrize(
    "given, message",
    [
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "no covariance: at unit variances its least eigenvalue is -1"),
        ({"covariance": [[1.0, 0.5], [0.4, 1.0]]}, "not symmetric"),
        ({"covariance": [[1.0]], "colours": [[1.2]]}, r"of output 0 grows: its largest pole has the size 1\.2"),
        ({"covariance": [[1.0]], "colours": [[0.2], [0.1]]}, "a row for each of the 1 outputs"),
        ({"covariance": [[1.0]], "cross": [[0.2]]}, "give forces too"),
        ({"covariance": [[1.0]], "forces": [[1.0]], "cross": [[2.0]]}, "the joint covariance is no covariance"),
    ],
)  # fmt: skip
def test_noise_that_is_none_is_refused(given, message):
    with pytest.raises(StructureError, match=message):
        phc.NoiseModel(**{"dt": STEP, **given})


@pytest.mark.parametrize("horizon", [0, -1, 1.5, "one", True])
def test_a_horizon_is_a_number_of_steps(horizon):
    result, u, y = in_coloured_noise()
    with pytest.raises(StructureError, match=r"horizon is .*; it must be a whole number of at least 1"):
        result.predict((u[0], y[0]), horizon=horizon)


def test_what_does_not_go_with_a_fit_is_refused():
    result, u, y = in_coloured_noise()
    with pytest.raises(StructureError, match="forces on 3 states; the plant has 4"):
        replace(result, noise=phc.NoiseModel([[1.0]], STEP, forces=np.eye(3)))
    with pytest.raises(StructureError, match="the noise is of 2 outputs, the fit of 1"):
        replace(result, noise=phc.NoiseModel(np.eye(2), STEP))
    with pytest.raises(StructureError, match=r"has the step 0\.2, and the noise of this fit is known at the step 0\.1"):
        result.predict((u[0], y[0]), dt=0.2, horizon=1)
    with pytest.raises(StructureError, match="no outputs to predict others from"):
        result.predict(u[0], horizon=1)
    with pytest.raises(NoSuchQuantityError, match=r"outputs have a colour; predictor has all of them"):
        with_forces(result, colours=[[0.5]]).kalman_gain  # noqa: B018

"""Inputs with dead times of their own, by whole samples: found with the plant, and repeated by all that uses a fit."""

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc

DT = 0.5
LAGS = np.array([8.0, 3.0])  # in units of time
GAINS = np.array([[1.0, -0.7, 0.5], [0.4, 0.8, -0.6]])  # of two outputs, from three inputs
DEAD = np.array([0, 4, 9])  # samples


def lagging(u, lag):
    """A lag of unit gain under a held input, from rest."""
    a = np.exp(-DT / lag)
    return lfilter([0.0, 1 - a], [1.0, -a], u, axis=-1)


def late(u, dead):
    return np.array([np.concatenate([np.zeros(k), row])[: len(row)] for row, k in zip(u, dead, strict=True)])


def plant(u, dead=DEAD, outputs=1):
    """Inputs in turn through the slow and the fast lag."""
    acting = late(u, dead)
    each = np.array([lagging(row, LAGS[k % 2]) for k, row in enumerate(acting)])
    return GAINS[:outputs, : len(u)] @ each


def recorded(seed, dead=DEAD, *, samples=700, outputs=1, noise=0.05, colour=0.0, inputs=3):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], (inputs, samples // 7)), 7, axis=1)
    y = plant(u, dead[:inputs], outputs)
    e = lfilter([1.0], [1.0, -colour], rng.standard_normal(y.shape), axis=1) * np.sqrt(1 - colour**2)
    return u, y + noise * y.std(axis=1, keepdims=True) * e


RECORD = recorded(2, samples=490)


@pytest.fixture(scope="module")
def fit():
    return phc.pem(RECORD, dt=DT)


def test_dead_times_of_inputs_are_found_with_the_plant(fit):
    np.testing.assert_allclose(fit.input_delay, DT * DEAD)
    np.testing.assert_array_equal(fit.delay, [0.0])
    np.testing.assert_allclose(np.sort(fit.time_constants), np.sort(LAGS), rtol=0.1)
    slow, fast = (fit.residues[k, 0] / -fit.real_poles[k] for k in range(2))
    np.testing.assert_allclose(slow.real, GAINS[0] * [1, 0, 1], atol=0.1)
    np.testing.assert_allclose(fast.real, GAINS[0] * [0, 1, 0], atol=0.1)
    findings = [finding for finding in fit.findings if finding.cause.name == "INPUT_DELAY"]
    assert [(finding.output, finding.values) for finding in findings] == [("u2", (2.0,)), ("u3", (4.5,))]
    assert all(finding.gain > 10 for finding in findings)
    assert "dead times      'u2' 2, 'u3' 4.5, in predictions and not in system" in str(fit)
    assert "2 inputs act later ('u2', 'u3')" in fit.message
    # beyond lags that stand for them, by half the difference of the criterion; modes may stand for a part
    on_time = phc.pem(RECORD, dt=DT, delay=0.0, input_delay=0.0, noise="white")
    lags = phc.pem(RECORD, 0, real_poles=2, dt=DT, delay=0.0, input_delay=0.0, noise="white")
    assert 0.5 * (lags.bic - fit.bic) > findings[0].gain > 0.5 * (on_time.bic - fit.bic) > 50


@pytest.mark.parametrize(
    ("data", "options"),
    [
        ({"samples": 140, "outputs": 2, "noise": 0.05}, {"order": 0, "real_poles": 2, "noise": "white"}),
        *slowly(({"samples": 1400, "colour": 0.9, "noise": 0.3}, {})),
    ],
)
def test_dead_times_are_common_to_all_outputs_and_stand_beside_coloured_noise(data, options):
    result = phc.pem(recorded(1, **data), dt=DT, **options)
    np.testing.assert_allclose(result.input_delay, DT * DEAD)
    np.testing.assert_array_equal(result.delay, 0.0)


@pytest.mark.slow
def test_dead_times_are_common_to_all_experiments():
    pairs = [recorded(seed, samples=280) for seed in (2, 3)]
    result = phc.pem(pairs, 0, dt=[DT, DT], noise="white", real_poles=2)
    np.testing.assert_allclose(result.input_delay, DT * DEAD)
    assert len(result.experiments) == 2 and all(data.fit_percent > 90 for data in result.experiments)


def test_dead_times_are_found_beside_a_mode():
    rng = np.random.default_rng(4)
    u, dead, pole = rng.standard_normal((2, 300)), (5, 0), -0.02 + 0.9j
    x = ct.forced_response(
        ct.c2d(phc.modes([pole], [[1.0]], [[1.0, 0.6j]]).state_space(), DT), None, late(u, dead)
    ).outputs
    y = np.atleast_2d(x) + 0.05 * np.std(x) * rng.standard_normal((1, 300))
    result = phc.pem((u, y), 1, dt=DT, real_poles=0)
    np.testing.assert_allclose(result.input_delay, DT * np.array(dead))
    np.testing.assert_allclose(result.poles, [pole], rtol=0.01)


@pytest.mark.variants
@pytest.mark.parametrize("dead", [(0, 0, 0), (3, 3, 3)])
def test_inputs_that_act_together_have_no_dead_times_of_their_own(dead):
    result = phc.pem(recorded(5, np.array(dead)), 0, dt=DT, real_poles=2)
    np.testing.assert_array_equal(result.input_delay, 0.0)
    assert np.all(np.abs(result.delay - DT * dead[0]) <= 3 * result.stderr["delay"])


def test_a_second_lag_is_no_dead_time():
    rng = np.random.default_rng(6)
    u = np.repeat(rng.choice([-1.0, 1.0], (2, 100)), 7, axis=1)
    y = (lagging(u[0], 8.0) + lagging(lagging(u[1], 8.0), 2.0))[None]
    result = phc.pem((u, y + 0.03 * rng.standard_normal(y.shape)), dt=DT)
    np.testing.assert_array_equal(result.input_delay, 0.0)
    np.testing.assert_allclose(np.sort(result.time_constants), [2.0, 8.0], rtol=0.15)


def test_dead_times_that_are_given_are_those_of_shifted_inputs():
    u, y = recorded(7)
    given = phc.pem((u, y), dt=DT, input_delay=DT * DEAD, delay=0)
    shifted = phc.pem((late(u, DEAD)[:, DEAD.max() :], y[:, DEAD.max() :]), dt=DT, input_delay=0, delay=0)
    np.testing.assert_allclose(given.poles, shifted.poles, rtol=1e-6)
    np.testing.assert_allclose(given.residues, shifted.residues, rtol=1e-5)
    np.testing.assert_allclose(given.predicted[:, DEAD.max() :], shifted.predicted, atol=1e-6)
    assert np.isnan(given.predicted[:, : DEAD.max()]).all() and given.loglik == pytest.approx(shifted.loglik)
    assert not any(finding.cause.name == "INPUT_DELAY" for finding in given.findings)


def test_from_rest_no_sample_is_left_out():
    u, y = recorded(8, noise=0.0)
    result = phc.pem((u, y), dt=DT, input_delay=DT * DEAD, delay=0, initial_state="zero", offset=False)
    np.testing.assert_allclose(np.sort(result.time_constants), np.sort(LAGS), rtol=1e-6)
    np.testing.assert_allclose(result.predicted, y, atol=1e-8)


def test_predictions_have_the_dead_times(fit):
    u, y = recorded(9, noise=0.0)
    from_rest = fit.predict(u, initial_state="zero")
    assert np.std(from_rest.outputs - y) < 0.05 * np.std(y)
    on_time = ct.forced_response(ct.c2d(fit.observed_system, DT), None, u).outputs
    assert np.std(on_time - y) > 0.3 * np.std(y)
    estimated = fit.predict((u, y))
    assert np.std((np.atleast_2d(estimated.outputs) - y)[:, DEAD.max() :]) < 0.05 * np.std(y)
    assert phc.compare((u, y), fit, dt=DT).fit_percent[0] > 95
    # half a sample is as good a step, for which the dead times are other samples
    fine = fit.predict(np.repeat(u, 2, axis=1), initial_state="zero", dt=DT / 2)
    np.testing.assert_allclose(np.atleast_2d(fine.outputs)[:, ::2], np.atleast_2d(from_rest.outputs), atol=1e-9)


def test_a_prediction_goes_on_where_the_record_ended(fit):
    (u, _), (more, _) = RECORD, recorded(10)
    both = plant(np.concatenate([u, more], axis=1))[:, u.shape[1] :]
    final = fit.predict(more, initial_state="final").outputs
    assert np.std(final - both) < 0.05 * np.std(both)


def test_responses_bands_and_rational_delays_have_the_dead_times(fit):
    omega = np.array([0.05, 0.2])
    turned = np.exp(-1j * omega * DT * DEAD[1])
    plain = fit.observed_system[0, 1](1j * omega)
    np.testing.assert_allclose(fit.with_delay(4)[0, 1](1j * omega), plain * turned, rtol=1e-4)
    assert fit.with_delay(4).input_labels == ["u1", "u2", "u3"] and fit.with_delay(4).nstates == fit.states + 8
    draws = fit.sample(50, rng=0)
    np.testing.assert_allclose(np.mean(draws.freqresp(omega, 0, 1), axis=0), plain * turned, rtol=0.1)
    omega = np.linspace(0.01, 1.0, 50)
    lags = GAINS[0] / (1 + 1j * np.multiply.outer(omega, LAGS[[0, 1, 0]]))
    true = lags * np.exp(-1j * np.multiply.outer(omega, DT * DEAD))
    assert np.min(phc.compare(ct.frd(true.T[None], omega), fit).fit_percent) > 85


def test_a_file_keeps_the_dead_times(fit, tmp_path):
    fit.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.input_delay, fit.input_delay)
    u, _ = recorded(11)
    same = (model.predict(u, initial_state="zero").outputs for model in (again, fit))
    np.testing.assert_array_equal(*same)


def test_resamples_and_pictures_keep_the_dead_times(fit):
    again = fit.bootstrap(20, rng=0)
    assert again.failed == 0
    np.testing.assert_array_equal(again.input_delay, fit.input_delay)
    np.testing.assert_allclose(again.stderr["real_poles"], fit.stderr["real_poles"], rtol=0.6)
    fit.plot()
    plt.close("all")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("some", "input_delay"),
        ([1.0, 2.0], "one for each of the 3 inputs"),
        ([0.0, -0.5, 0.0], "an input may act later than recorded, not earlier"),
        ([0.0, 0.6, 0.0], "1.2 samples of 0.5; it must be whole samples"),
        ([0.0, 200.0, 0.0], "half of a record at most"),
    ],
)
def test_dead_times_that_cannot_be_are_refused(value, message):
    with pytest.raises((phc.StructureError, ValueError), match=message):
        phc.pem(recorded(13), dt=DT, input_delay=value)


def test_a_single_input_has_a_delay_and_responses_have_none():
    u, y = recorded(13, inputs=1)
    with pytest.raises(phc.StructureError, match="what all inputs have in common is a delay"):
        phc.pem((u, y), dt=DT, input_delay=DT)
    omega = np.linspace(0.1, 3.0, 60)
    matrix = ct.frd(1 / (1 + 1j * omega * LAGS[:, None])[None], omega)
    with pytest.raises(phc.StructureError, match="multiply a response"):
        phc.pem(matrix, input_delay=[0.0, 0.5])

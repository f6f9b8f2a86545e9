"""Step tests: an input that changes seldom, soon after the record begins."""

import control as ct
import numpy as np
import pytest

import ph_control as phc


def step_test(delay, first, *, gain=2.0, constant=12.0, samples=200, seed=0, noise=0.005):
    """Input from 5 to 7 at a sample, and a lag that is late, at rest with the first input, in noise."""
    u = np.where(np.arange(samples) < first, 5.0, 7.0)
    fine = 20
    late = np.concatenate([np.full(round(delay * fine), 5.0), np.repeat(u, fine)])[: samples * fine] - 5.0
    y = ct.forced_response(ct.c2d(ct.tf([gain], [constant, 1]), 1 / fine), np.arange(len(late)) / fine, late).outputs
    return u, 30.0 + y[::fine] + 2 * gain * noise * np.random.default_rng(seed).standard_normal(samples)


@pytest.mark.parametrize(("delay", "first", "seed"), [(3.0, 10, 1), (2.4, 8, 2), (5.0, 12, 3)])
def test_the_only_step_is_not_left_out_for_the_sake_of_delays(delay, first, seed):
    """Of what is left without the step, a lag in motion tells as much with any delay and gain."""
    result = phc.pem(step_test(delay, first, seed=seed), dt=1.0, quantity="free")
    assert (result.order, len(result.real_poles)) == (0, 1)
    assert ct.dcgain(result.system).item() == pytest.approx(2.0, rel=0.05)
    assert result.delay[0] == pytest.approx(delay, abs=0.5)
    assert result.time_constants[0] == pytest.approx(12.0, rel=0.05)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("delay", [4.0, 4.3])
def test_an_input_that_changes_once_lasted_before_the_record(delay, intersample):
    u, y = step_test(4.0, 2)
    known = {"real_poles": 1, "delay": delay, "intersample": intersample, "noise": "white"}
    result = phc.pem((u, y), 0, dt=1.0, quantity="free", **known)
    (experiment,) = result.experiments
    assert np.isfinite(experiment.predicted).all()
    # what a result states of motion, constant and poles gives the same from the first sample that known inputs act in
    again = np.ravel(result.predict(u, initial_state="fitted").outputs)
    np.testing.assert_allclose(again[5:], experiment.predicted[5:], rtol=0, atol=1e-9)
    assert np.std(experiment.predicted - y) < 0.03

"""Fits of damped modes to data whose noise is not white, or not constant."""

import numpy as np
import pytest

import ph_control as phc
from benchmarks.real_noise import SHARE, plant, response, study


def causes(result):
    return {one.cause.name: one for one in result.findings}


# --- frequency responses ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("outputs", "inputs"), [(1, 1), (3, 2)])
def test_noise_that_grows_with_the_gain_adds_no_modes_and_its_intervals_hold(outputs, inputs):
    found = study(3, outputs, inputs, "gain", 3, structure="free")
    assert found.right == 1 and found.cover > 0.8


def test_the_share_of_the_gain_is_found_for_each_response_and_each_point_has_its_weight():
    result = phc.pem(response(3, 2, 1, "both", 0))
    finding = causes(result)["GAIN_NOISE"]
    assert finding.gain > 50
    np.testing.assert_allclose(finding.values, SHARE, rtol=0.25)
    assert "grows with the gain" in result.message
    weights, gain = result.record.weights, np.abs(result.predicted)
    assert np.all(weights[gain == gain.max(axis=-1, keepdims=True)] < 0.1 * weights.max(axis=(1, 2)))
    np.testing.assert_allclose(result.noise_variance, 1.0, rtol=0.2)


def test_constant_noise_keeps_equal_weights_and_given_ones_stay():
    data = response(3, 2, 1, "constant", 1)
    assert "GAIN_NOISE" not in causes(phc.pem(data)) and np.ptp(phc.pem(data).record.weights) == 0
    data = response(3, 2, 1, "gain", 1)
    given = phc.pem(data, 3, weights=np.ones(data.frdata.shape))
    assert "GAIN_NOISE" not in causes(given) and np.ptp(given.record.weights) == 0
    own = phc.pem(data, 3)
    true = np.abs(plant(3, 2, 1, 1)[0])
    assert np.abs(own.d - true).max() < np.abs(given.d - true).max()

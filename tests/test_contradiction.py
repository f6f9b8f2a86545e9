"""A doubtful fit says what contradicts it: damping and residues of opposite sign, and nothing that is not there."""

from __future__ import annotations

import re
from functools import partial
from types import SimpleNamespace

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm

import ph_control as phc
from ph_control.identification.data.experiments import as_experiments
from ph_control.identification.diagnosis.damping import sentence
from ph_control.identification.regression.free import FreeProjection
from ph_control.identification.regression.frequency_rows import FreeResponse, FrequencyRows
from ph_control.identification.regression.sections import Sections
from ph_control.identification.regression.spectral_rows import ChannelSpectra, FreeWindow
from ph_control.identification.regression.time_rows import FreeRecord, RecordRows
from ph_control.modal.discretization import Hold

D = np.array([0.5, 1.9, 2.6])
lossless_fit = partial(phc.pem, structure="lossless")

H = 0.1
SAMPLES = 1000


def simulated(damping, residues, u, *, quantity="velocity", d=D, state=None):
    """Output of second-order transfer functions under a held input, by the exponential of dense matrices."""
    y = np.zeros(len(u))
    for frequency, ratio, residue in zip(d, damping, residues, strict=True):
        numerator = {"velocity": [residue, 0], "displacement": [residue], "acceleration": [residue, 0, 0]}[quantity]
        plant = ct.ss(ct.tf(numerator, [1, 2 * ratio * frequency, frequency**2]))
        step = expm(np.block([[plant.A * H, plant.B * H], [np.zeros((1, 3))]]))
        x = np.zeros(2) if state is None else np.array(state)
        for k, value in enumerate(u):
            y[k] += (plant.C @ x + plant.D[0] * value)[0]
            x = step[:2, :2] @ x + step[:2, 2] * value
    return y


def recording(damping, residues, *, seed=0, noise=0.1, quantity="velocity", samples=SAMPLES):
    """White input, and the output of a plant with white noise of a part of its size."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = simulated(damping, residues, u, quantity=quantity)
    return u, y + noise * np.std(y) * rng.standard_normal(samples)


def examined(u, y, order):
    """The damped modes beside a lossless fit."""
    return lossless_fit((u, y), order, dt=H).damped


def accused(model):
    return model is not None and (model.damped.any() or model.negative.any())


CLEAN = (0.0, 0.0, 0.0)
POSITIVE = (1.0, 0.5, 0.7)


@pytest.mark.parametrize("noise", [0.1, 0.4])
def test_lossless_records_with_white_noise_are_never_accused(noise):
    for seed in range(6):
        u, y = recording(CLEAN, POSITIVE, seed=seed, noise=noise)
        assert not accused(examined(u, y, 3))
        assert "would be explained" not in lossless_fit((u, y), 3, dt=H).message


def test_lossless_records_are_not_accused_where_the_order_is_too_low():
    for seed in range(3):
        u, y = recording(CLEAN, POSITIVE, seed=seed)
        result = lossless_fit((u, y), 1, dt=H)
        assert "would be explained" not in result.message
        assert "a higher one may fit better" in result.message


def test_damping_is_estimated_within_its_standard_error():
    errors = []
    for seed in range(6):
        found = examined(*recording((0.01, 0.01, 0.02), POSITIVE, seed=seed), 3)
        assert found.damped.all() and not found.negative.any()
        assert np.allclose(found.natural_frequencies, D, rtol=0.01)
        errors.append((found.damping_ratios - [0.01, 0.01, 0.02]) / found.stderr["damping_ratios"])
    assert np.abs(errors).max() < 4
    # standard errors that mean something are neither far too small nor far too large
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_sensor_away_from_the_actuator_is_told_by_the_sign():
    errors = []
    for seed in range(5):
        u, y = recording(CLEAN, (1.0, -0.5, 0.7), seed=seed)
        found = examined(u, y, 3)
        assert found.negative.tolist() == [False, True, False] and not found.damped.any()
        errors.append((found.weights[0] - [1.0, -0.5, 0.7]) / found.weights[1])
    assert np.abs(errors).max() < 4
    told = sentence(found)
    assert told.endswith("the sensor is not at the actuator.") and "loses energy" not in told
    assert "residues of opposite sign (mode 2 negative)" in told and told in lossless_fit((u, y), 3, dt=H).message


@pytest.mark.parametrize(
    "quantity, order", [("velocity", 3), ("displacement", 3), ("acceleration", 3), ("displacement", "auto")]
)
def test_both_are_told_and_the_frequencies_are_those_of_the_plant(quantity, order):
    u, y = recording((0.01, 0.005, 0.02), (1.0, -0.5, 0.7), quantity=quantity)
    result = lossless_fit((u, y), order, dt=H, quantity=quantity)
    assert result.order == 3
    found = result.damped
    for name, truth in (("natural_frequencies", D), ("damping_ratios", (0.01, 0.005, 0.02))):
        assert np.all(np.abs(getattr(found, name) - truth) < 4 * found.stderr[name])
    # the lossless modes are at a minimum of their own, next to these
    assert np.allclose(result.d, D, rtol=0.05)
    assert result.active == (1,) and result.r[1] == 0
    assert result.outcome.name == "NOT_DESCRIBED"
    assert "the plant loses energy, and the sensor is not at the actuator" in result.message
    assert "mode 2 negative" in result.message and "suspect" not in result.message
    assert f"lossless {quantity} model" in result.message
    share = float(re.search(r"([\d.]+) % would be explained", result.message)[1])
    assert 88 < share < 92 and result.fit_percent < share - 5


def test_damping_changes_no_frequency_by_the_modes_that_would_mimic_it():
    u, y = recording((0.01, 0.01, 0.01), POSITIVE)
    result = lossless_fit((u, y), dt=H)
    assert result.order == 3 and np.allclose(result.damped.natural_frequencies, D, rtol=0.003)
    assert np.allclose(result.d, D, rtol=0.02)


def test_reversed_sensor_is_told_as_such():
    u, y = recording(CLEAN, POSITIVE)
    found = examined(u, -y, 3)
    assert found.negative.all() and not found.damped.any()
    assert "the polarity of the sensor is reversed" in sentence(found) and "opposite" not in sentence(found)


@pytest.mark.parametrize("taken, as_if", [("displacement", "velocity"), ("acceleration", "velocity")])
def test_another_quantity_than_said_is_not_taken_for_damping(taken, as_if):
    u, y = recording(CLEAN, POSITIVE, quantity=taken)
    result = lossless_fit((u, y), 3, dt=H, quantity=as_if)
    assert "would be explained" not in result.message
    assert "an output that is not the velocity (displacement, acceleration)" in result.message


def test_a_residue_that_may_be_zero_is_no_opposite_of_negative_ones():
    found = examined(*recording(CLEAN, (-1.0, -0.5, -0.7)), 3)
    values, errors = found.weights
    names = ("damping_ratios", "stderr", "damped", "negative", "residues", "fit_percent")

    def reweighted(first):
        known = {name: getattr(found, name) for name in names}
        return SimpleNamespace(**known, weights=(values * [first, 1.0, 1.0], errors))

    unsure, sure = reweighted(-3 * errors[0]), reweighted(-1.0)
    assert "negative residues only" in sentence(unsure)
    assert "displacement and acceleration are mixed up" in sentence(unsure)
    assert "opposite sign" in sentence(sure) and "the sensor is not at the actuator" in sentence(sure)


def test_growing_modes_are_told_as_such():
    found = examined(*recording((-0.002, -0.002, -0.002), POSITIVE), 3)
    assert np.all(found.damping_ratios[found.damped] < 0)
    assert "energy is fed in" in sentence(found) and "loses" not in sentence(found)


def test_one_more_mode_than_asked_for_is_not_told_of():
    u, y = recording((0.01, 0.01, 0.01), (1.0, 0.3, 1.0))
    found = examined(u, y, 2)
    assert np.allclose(found.natural_frequencies, D[[0, 2]], rtol=0.01)
    assert len(found.damping_ratios) == len(found.residues) == 2


def test_missing_outputs_do_not_change_what_is_found():
    u, y = recording((0.01, 0.01, 0.02), (1.0, -0.5, 0.7))
    whole = examined(u, y, 3)
    holes = np.where(np.random.default_rng(1).random(len(y)) < 0.2, np.nan, y)
    found = examined(u, holes, 3)
    errors, fewer = found.stderr["damping_ratios"], whole.stderr["damping_ratios"]
    assert np.all(np.abs(found.damping_ratios - whole.damping_ratios) < 3 * errors)
    assert np.all(np.abs(found.damping_ratios - [0.01, 0.01, 0.02]) < 4 * errors)
    assert found.negative.tolist() == whole.negative.tolist()
    assert np.mean(errors / fewer) > 1.03


def test_several_records_are_told_of_together():
    records = [recording((0.01, 0.01, 0.01), (1.0, -0.5, 0.7), seed=seed) for seed in (0, 1)]
    together = lossless_fit(records, 3, dt=H)
    assert "mode 2 negative" in together.message
    assert np.allclose(together.damped.natural_frequencies, D, rtol=0.005)


# --- free motion ---------------------------------------------------------------------------------------------------


def motion(ratio, seed):
    t = H * np.arange(SAMPLES)
    rng = np.random.default_rng(seed)
    parts = [(0.7, 1.0, 0.3), (2.1, 0.6, 1.0)]
    clean = sum(a * np.exp(-ratio * d * t) * np.cos(d * np.sqrt(1 - ratio**2) * t + phase) for d, a, phase in parts)
    return clean + 0.05 * rng.standard_normal(SAMPLES)


@pytest.mark.parametrize("order", [2, "auto"])
def test_a_free_motion_that_decays_is_said_to_with_its_damping(order):
    for ratio in (0.003, 0.02):
        result = lossless_fit((None, motion(ratio, 0)), order, dt=H)
        assert np.allclose(result.damped.natural_frequencies, [0.7, 2.1], rtol=0.01)
        told = re.search(r"damping ratios of (\S+) \+- (\S+) % and (\S+) \+- (\S+) %", result.message)
        first, first_error, second, second_error = (float(one) for one in told.groups())
        # two digits of a value are shown, and one of its error
        assert abs(first - 100 * ratio) < 4 * first_error + 0.06 * 100 * ratio
        assert abs(second - 100 * ratio) < 4 * second_error + 0.06 * 100 * ratio
        assert "the motion decays" in result.message and "sensor" not in result.message


def test_a_free_motion_that_does_not_decay_is_not_accused():
    for seed in range(6):
        for order in (2, "auto"):
            assert "decays" not in lossless_fit((None, motion(0.0, seed)), order, dt=H).message


# --- the linear problem --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("quantity", ["velocity", "displacement", "acceleration"])
@pytest.mark.parametrize("state", [None, (0.3, -0.2)])
def test_columns_reproduce_a_damped_plant_to_rounding(quantity, intersample, state):
    d, ratio, kappa = np.array([1.3]), np.array([0.03]), 0.8
    rng = np.random.default_rng(0)
    u = rng.standard_normal(301)
    if intersample == "zoh":
        y = simulated(ratio, [kappa], u, quantity=quantity, d=d, state=state)
    else:
        numerator = {"velocity": [kappa, 0], "displacement": [kappa], "acceleration": [kappa, 0, 0]}[quantity]
        plant = ct.ss(ct.tf(numerator, [1, 2 * ratio[0] * d[0], d[0] ** 2]))
        y = ct.forced_response(plant, H * np.arange(301), u, 0.0 if state is None else state).outputs
    experiment = RecordRows(u, y, np.ones(301, bool), Hold(H, "exact", intersample), quantity=quantity)
    spectrum = ChannelSpectra.of(FreeRecord.of(experiment))
    p = d * (-ratio + 1j * np.sqrt(1 - ratio**2))
    size = np.linalg.norm(y)
    weight = kappa * p ** {"velocity": 1, "displacement": 0, "acceleration": 2}[quantity] / (2j * p.imag)
    for rows in (FreeRecord.of(experiment), FreeWindow(spectrum, np.arange(1, spectrum.last + 1))):
        at = FreeProjection([rows], p)
        assert np.sqrt(at.loss) < 1e5 * np.finfo(float).eps * size
        assert at.residues[:, 0, 0] == pytest.approx(weight, rel=1e-7)
        assert at.feedthrough[0, 0] == pytest.approx(kappa if quantity == "acceleration" else 0.0, abs=1e-7)
        wrong = FreeProjection([rows], p * (1 + 0.01j))
        assert np.sqrt(wrong.loss) > 1e-4 * size


@pytest.mark.parametrize("seed", [1, 7])
def test_a_pair_closer_than_the_record_resolves_stays_lossless(seed):
    rng, step = np.random.default_rng(seed), 2 * np.pi / 2000
    plant = phc.ph(phc.modes(1.0 + np.array([0.0, 0.2]) * step, [1.0, 0.5]))
    u, t = rng.standard_normal(2000), np.arange(2000.0)
    y = np.asarray(phc.forced_response(plant, t, u, return_states=False, intersample="zoh").outputs)
    found = phc.pem((u, y + 0.01 * np.std(y) * rng.standard_normal(2000)), dt=1.0)
    assert found.structure == "lossless" and found.outcome.name == "CONSISTENT"
    assert np.allclose((found.d - plant.d) / step, 0.0, atol=0.05)


@pytest.mark.parametrize("method", ["exact", "midpoint"])
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("kind", ["record", "from rest", "bins", "response"])
def test_gradient_of_the_damped_loss_is_that_of_differences(kind, method, intersample):
    p = np.array([-0.004 + 0.52j, -0.02 + 1.93j])
    rng = np.random.default_rng(0)
    if kind == "response":
        omega = np.linspace(0.1, 3.0, 60)
        data = ct.frd(rng.standard_normal(60) + 1j * rng.standard_normal(60), omega)
        rows = FreeResponse.of(FrequencyRows(*as_experiments(data)))
    else:
        u, y = recording((0.01, 0.01, 0.01), POSITIVE)
        seen = rng.random(len(y)) < (1.0 if kind == "bins" else 0.9)
        experiment = RecordRows(u, y, seen, Hold(H, method, intersample), from_rest=kind == "from rest", offset=True)
        spectrum = ChannelSpectra.of(FreeRecord.of(experiment))
        rows = FreeRecord.of(experiment) if kind != "bins" else FreeWindow(spectrum, np.arange(1, spectrum.last + 1))

    def loss(x):
        return FreeProjection([rows], Sections.from_coordinates(x).p).loss

    residual, jacobian = FreeProjection([rows], p).condensed
    x, nudge = Sections.of(p).x, 1e-6
    differences = [(loss(x + nudge * one) - loss(x - nudge * one)) / (2 * nudge) for one in np.eye(4)]
    assert np.allclose(2 * jacobian.T @ residual, differences, rtol=1e-4, atol=1e-6 * np.abs(differences).max())

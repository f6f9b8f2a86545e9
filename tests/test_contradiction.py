"""What contradicts a lossless model is found: damping, and residues of opposite sign; and nothing that is not there."""

from __future__ import annotations

from functools import partial

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm

import ph_control as phc
from ph_control.identification.regression.free import FreeProjection
from ph_control.identification.regression.frequency_rows import FreeResponse
from ph_control.identification.regression.sections import Sections
from ph_control.identification.regression.spectral_rows import ChannelSpectra, FreeWindow
from ph_control.identification.regression.time_rows import FreeRecord
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


CLEAN = (0.0, 0.0, 0.0)
POSITIVE = (1.0, 0.5, 0.7)


def causes(result):
    return {one.cause.name for one in result.findings}


def signed_weights(result, quantity="velocity"):
    """Weights of modes of real shapes, of either sign, with standard errors, from free residues."""
    p, residues, errors = result.poles, result.residues[:, 0, 0], result.stderr["residues"][:, 0, 0]
    unit = p ** {"velocity": 1, "displacement": 0, "acceleration": 2}[quantity] / (2j * p.imag)
    turn = np.conj(unit) / np.abs(unit) ** 2
    spread = np.hypot(turn.real * errors.real, turn.imag * errors.imag)
    return (residues * turn).real, spread


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("noise", [0.1, 0.4])
def test_lossless_records_with_white_noise_are_not_accused(noise):
    accused = 0
    for seed in range(4):
        u, y = recording(CLEAN, POSITIVE, seed=seed, noise=noise)
        (test,) = lossless_fit((u, y), 3, dt=H).tests
        assert test.p > 1e-3
        accused += test.p < 0.05
    assert accused <= 2


@pytest.mark.slow
def test_damping_is_estimated_within_its_standard_error():
    errors = []
    for seed in range(4):
        data = recording((0.01, 0.01, 0.02), POSITIVE, seed=seed)
        result = phc.pem(data, 3, dt=H, structure="classical", intersample="zoh", delay=0.0, noise="white")
        assert np.allclose(result.natural_frequencies, D, rtol=0.01)
        errors.append((result.damping_ratios - [0.01, 0.01, 0.02]) / result.stderr["damping_ratios"])
    lossless = lossless_fit(data, 3, dt=H)
    assert "LOSSES" in causes(lossless) and lossless.outcome.name == "NOT_DESCRIBED"
    assert np.abs(errors).max() < 4
    # standard errors that mean something are neither far too small nor far too large
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


@pytest.mark.slow
def test_a_sensor_away_from_the_actuator_is_seen_by_the_sign():
    errors = []
    for seed in range(3):
        u, y = recording(CLEAN, (1.0, -0.5, 0.7), seed=seed)
        result = phc.pem((u, y), 3, dt=H, structure="free")
        values, spread = signed_weights(result)
        assert (values < -3 * spread).tolist() == [False, True, False]
        assert np.all(np.abs(result.damping_ratios) < 4 * result.stderr["damping_ratios"])
        errors.append((values - [1.0, -0.5, 0.7]) / spread)
        lossless = lossless_fit((u, y), 3, dt=H, intersample="zoh")
        assert "LOSSES" in causes(lossless) and lossless.r[1] == 0 and np.isnan(lossless.stderr["r"][1])
    assert np.abs(errors).max() < 4


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    "quantity, order", [("velocity", 3), ("displacement", 3), ("acceleration", 3), ("displacement", "auto")]
)
def test_both_are_found_and_the_frequencies_are_those_of_the_plant(quantity, order):
    u, y = recording((0.01, 0.005, 0.02), (1.0, -0.5, 0.7), quantity=quantity)
    result = phc.pem((u, y), order, dt=H, quantity=quantity)
    assert result.order == 3 and result.outcome.name == "CONSISTENT"
    for name, truth in (("natural_frequencies", D), ("damping_ratios", (0.01, 0.005, 0.02))):
        assert np.all(np.abs(getattr(result, name) - truth) < 4 * result.stderr[name])
    assert (signed_weights(result, quantity)[0] < 0).tolist() == [False, True, False]
    # the lossless modes are at a minimum of their own, next to these
    lossless = lossless_fit((u, y), order, dt=H, quantity=quantity)
    assert lossless.order == 3 and np.allclose(lossless.d, D, rtol=0.05) and lossless.r[1] == 0
    assert lossless.outcome.name == "NOT_DESCRIBED" and lossless.fit_percent < result.fit_percent - 5


def test_a_reversed_sensor_has_residues_below_0_and_no_lossless_model():
    u, y = recording(CLEAN, POSITIVE)
    assert np.all(signed_weights(phc.pem((u, -y), 3, dt=H, structure="free"))[0] < 0)
    result = lossless_fit((u, -y), 3, dt=H)
    assert not result.kappa.any() and result.outcome.name == "NOT_DESCRIBED"


def test_growing_modes_are_said_to_grow():
    result = phc.pem(recording((-0.002, -0.002, -0.002), POSITIVE), 3, dt=H)
    assert np.all(result.damping_ratios < 0) and "poles grow" in result.message


def test_missing_outputs_do_not_change_what_is_found():
    u, y = recording((0.01, 0.01, 0.02), (1.0, -0.5, 0.7))
    whole = phc.pem((u, y), 3, dt=H, structure="free")
    holes = np.where(np.random.default_rng(1).random(len(y)) < 0.2, np.nan, y)
    result = phc.pem((u, holes), 3, dt=H, structure="free")
    errors, fewer = result.stderr["damping_ratios"], whole.stderr["damping_ratios"]
    assert np.all(np.abs(result.damping_ratios - whole.damping_ratios) < 3 * errors)
    assert np.all(np.abs(result.damping_ratios - [0.01, 0.01, 0.02]) < 4 * errors)
    assert np.mean(errors / fewer) > 1.03


# --- free motion ---------------------------------------------------------------------------------------------------


def motion(ratio, seed):
    t = H * np.arange(SAMPLES)
    rng = np.random.default_rng(seed)
    parts = [(0.7, 1.0, 0.3), (2.1, 0.6, 1.0)]
    clean = sum(a * np.exp(-ratio * d * t) * np.cos(d * np.sqrt(1 - ratio**2) * t + phase) for d, a, phase in parts)
    return clean + 0.05 * rng.standard_normal(SAMPLES)


@pytest.mark.variants
@pytest.mark.parametrize("order", [2, "auto"])
def test_a_free_motion_that_decays_has_its_damping(order):
    for ratio in (0.003, 0.02):
        result = phc.pem((None, motion(ratio, 0)), order, dt=H)
        assert np.allclose(result.natural_frequencies, [0.7, 2.1], rtol=0.01)
        assert np.all(np.abs(result.damping_ratios - ratio) < 4 * result.stderr["damping_ratios"])
        assert "LOSSES" in causes(lossless_fit((None, motion(ratio, 0)), order, dt=H))


def test_a_free_motion_that_does_not_decay_is_not_accused():
    for order in (2, "auto"):
        tests = [lossless_fit((None, motion(0.0, seed)), order, dt=H).tests[0].p for seed in range(3)]
        assert min(tests) > 1e-3 and sum(p < 0.05 for p in tests) <= 1


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
    record = FreeRecord(u[None], y[None], np.ones(301, bool), Hold(H, "exact", intersample))
    spectrum = ChannelSpectra.of(record)
    p = d * (-ratio + 1j * np.sqrt(1 - ratio**2))
    size = np.linalg.norm(y)
    weight = kappa * p ** {"velocity": 1, "displacement": 0, "acceleration": 2}[quantity] / (2j * p.imag)
    for rows in (record, FreeWindow(spectrum, np.arange(1, spectrum.last + 1))):
        at = FreeProjection([rows], p)
        assert np.sqrt(at.loss) < 1e5 * np.finfo(float).eps * size
        assert at.residues[:, 0, 0] == pytest.approx(weight, rel=1e-7)
        assert at.feedthrough[0, 0] == pytest.approx(kappa if quantity == "acceleration" else 0.0, abs=1e-7)
        wrong = FreeProjection([rows], p * (1 + 0.01j))
        assert np.sqrt(wrong.loss) > 1e-4 * size


@pytest.mark.slow
def test_a_pair_closer_than_the_record_resolves_stays_lossless():
    """Free poles of such a pair may lie anywhere near it; the lossless minimum is not judged by where they are."""
    step, rejected = 2 * np.pi / 2000, 0
    plant = phc.ph(phc.modes(1.0 + np.array([0.0, 0.2]) * step, [1.0, 0.5]))
    for seed in range(2):
        rng = np.random.default_rng(seed)
        u, t = rng.standard_normal(2000), np.arange(2000.0)
        y = np.asarray(phc.forced_response(plant, t, u, return_states=False, intersample="zoh").outputs)
        result = phc.pem((u, y + 0.01 * np.std(y) * rng.standard_normal(2000)), dt=1.0)
        (test,) = [each for each in result.tests if each.hypothesis == "lossless"]
        assert result.outcome.name == "CONSISTENT" and test.p > 1e-3, seed
        # a true structure is rejected once in twenty by chance
        rejected += result.structure != "lossless"
        if result.structure == "lossless":
            assert np.allclose((result.d - plant.d) / step, 0.0, atol=0.05)
    assert rejected <= 1


@pytest.mark.variants
@pytest.mark.parametrize("method", ["exact", "midpoint"])
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("kind", ["record", "from rest", "bins", "response"])
def test_gradient_of_the_damped_loss_is_that_of_differences(kind, method, intersample):
    p = np.array([-0.004 + 0.52j, -0.02 + 1.93j])
    rng = np.random.default_rng(0)
    if kind == "response":
        omega = np.linspace(0.1, 3.0, 60)
        response = rng.standard_normal((1, 60)) + 1j * rng.standard_normal((1, 60))
        rows = FreeResponse(omega, response, np.ones(60), np.ones(60, bool))
    else:
        u, y = recording((0.01, 0.01, 0.01), POSITIVE)
        seen = rng.random(len(y)) < (1.0 if kind == "bins" else 0.9)
        record = FreeRecord(u[None], y[None], seen, Hold(H, method, intersample), kind != "from rest", 1)
        spectrum = ChannelSpectra.of(record)
        rows = record if kind != "bins" else FreeWindow(spectrum, np.arange(1, spectrum.last + 1))

    def loss(x):
        return FreeProjection([rows], Sections.from_coordinates(x).p).loss

    residual, jacobian = FreeProjection([rows], p).condensed
    x, nudge = Sections.of(p).x, 1e-6
    differences = [(loss(x + nudge * one) - loss(x - nudge * one)) / (2 * nudge) for one in np.eye(4)]
    assert np.allclose(2 * jacobian.T @ residual, differences, rtol=1e-4, atol=1e-6 * np.abs(differences).max())

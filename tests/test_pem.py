"""Prediction-error fitting: accuracy, order, uncertainty, verdicts."""

import json
from functools import cache, partial

import control as ct
import numpy as np
import pytest
import scipy.io
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from slow import slowly

import ph_control as phc

lossless_fit = partial(phc.pem, structure="lossless")


def record_of(d, r, *, samples=1000, h=0.1, snr=20.0, seed=0, method="exact", intersample="zoh", z0=None):
    """Plant, input and noisy output of a recording with white input."""
    rng = np.random.default_rng(seed)
    plant = phc.ph(phc.modes(d, r))
    u = rng.standard_normal(samples)
    start = rng.standard_normal(plant.nstates) if z0 is None else z0
    t = h * np.arange(samples)
    y = phc.forced_response(plant, t, u, start, method=method, intersample=intersample, return_states=False).outputs
    deviation = np.std(y) * 10 ** (-snr / 20)
    return plant, u, np.asarray(y) + deviation * rng.standard_normal(samples), deviation


# --- the paper's two experiments: Euler data written out independently of the package ------------------------------


def euler_recording(A, B, C, z0, inputs, h=0.01):
    """Explicit Euler on dense matrices, sample by sample."""
    z, y = np.array(z0, float), []
    for u in inputs:
        y.append(C @ z)
        z = z + h * (A @ z + B * u)
    return np.array(y)


def paper_system(name):
    """Dense (A, B, C) of the circuit with all C = L = 1 and of the chain of two masses."""
    n = {"circuit": 5, "chain": 2}[name]
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    Q = np.eye(2 * n)
    B = np.r_[np.zeros(n), np.ones(n)]
    if name == "chain":
        Q[:2, :2] = [[2, -1], [-1, 1]]
        B = np.array([0.0, 0.0, 1.0, 0.0])
    return J @ Q, B, B @ Q


@pytest.mark.variants
@pytest.mark.parametrize("name, seed", [("circuit", 0), ("circuit", 1), ("chain", 0)])
@pytest.mark.parametrize("order", ["true", "auto"])
def test_paper_experiments_are_continued_to_1e_8_over_the_next_4000_samples(name, order, seed):
    A, B, C = paper_system(name)
    z0 = [2, 1, -3, -3] if name == "chain" else np.random.default_rng(seed).standard_normal(10)
    u = np.sin(0.01 * np.arange(5000))
    y = euler_recording(A, B, C, z0, u)
    n = {"circuit": 5, "chain": 2}[name]
    result = phc.pem((u[:1000], y[:1000]), n if order == "true" else order, dt=0.01, method="euler")
    ahead = result.predict(u[1000:], initial_state="final").outputs
    assert np.abs(ahead - y[1000:]).max() <= 1e-8 * np.abs(y[1000:]).max()
    # the five equal branches are one mode seen from the port, whatever order is given
    assert result.order == {"circuit": 1, "chain": 2}[name]
    fewer = [finding.values for finding in result.findings if finding.cause.name == "FEWER_MODES"]
    assert fewer == [(5.0, 1.0)] * (name == "circuit" and order == "true")
    truth = {"circuit": ([1.0], [5.0]), "chain": ([0.6180339887498949, 1.618033988749895], [0.2**0.5, 0.2**0.5])}[name]
    assert np.allclose(result.modes.minimal().d, truth[0], rtol=1e-10)
    assert np.allclose(result.modes.minimal().r, truth[1], rtol=1e-8)


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(2))
def test_circuit_learned_from_a_sine_predicts_other_inputs_to_1e_6(seed):
    A, B, C = paper_system("circuit")
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(5000)
    sine = np.sin(t[:1000])
    result = phc.pem((sine, euler_recording(A, B, C, rng.standard_normal(10), sine)), order=5, dt=0.01, method="euler")
    for u in (np.ones(5000), np.sign(np.sin(t) + 1e-12), 0.1 * t):
        y = euler_recording(A, B, C, np.zeros(10), u)
        predicted = result.predict(u, initial_state="zero").outputs
        assert np.abs(predicted - y).max() <= 1e-6 * np.abs(y).max()


CHAIN_STATE = np.array([0.3, -0.2, 0.5, 0.1])

# where many fits are made, nothing but the parameters is looked for
KNOWN = {"intersample": "zoh", "delay": 0.0, "noise": "white", "offset": False}


@pytest.mark.variants
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_chain_with_an_exact_hold_does_not_show_its_weights_and_the_fit_warns(noise):
    # sin t drives a transmission zero of the chain: G(i) = 0
    chain, t = phc.frenkel_kontorova(2), 0.01 * np.arange(1000)
    y = phc.forced_response(chain, t, np.sin(t), CHAIN_STATE, return_states=False, intersample="zoh").outputs
    with pytest.warns(phc.IdentifiabilityWarning, match=r"r_1 and r_2 .* cannot be learned from this record") as told:
        result = lossless_fit((np.sin(t), y + noise * np.random.default_rng(0).standard_normal(1000)), 2, dt=0.01)
    assert [one.filename for one in told] == [__file__], "it names the line that asked for the fit"
    assert np.abs(result.d - chain.d).max() <= max(1e-6, 5 * noise)
    assert result.blind and np.all(np.isinf(result.stderr["r"])) and np.all(result.stderr["d"] < 1e-2)
    assert "white or multisine" in result.message
    assert result.outcome.name == "DOUBTFUL"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["white", *slowly("multisine")])
def test_another_input_of_the_same_length_shows_the_weights_to_the_cramer_rao_bound(kind):
    chain, t = phc.frenkel_kontorova(2), 0.01 * np.arange(1000)
    white = np.random.default_rng(9).standard_normal(1000)
    u = white if kind == "white" else sum(np.sin(w * t + w * w) for w in (0.31, 0.62, 1.3, 1.9))
    clean = phc.forced_response(chain, t, u, CHAIN_STATE, return_states=False, intersample="zoh").outputs
    size = phc.excitation((u, clean), chain, dt=0.01, noise_std=1e-3).stderr["r"]
    errors = []
    for seed in range(20):
        y = clean + 1e-3 * np.random.default_rng(seed).standard_normal(1000)
        errors.append((lossless_fit((u, y), 2, dt=0.01, **KNOWN).r - chain.r) / size)
    # of 20 squares of normal numbers the mean is 1 within sqrt(2/20) = 0.32, twice
    assert np.all(np.abs(np.mean(np.square(errors), axis=0) - 1.0) < 0.67)
    assert size.max() < 0.1 * chain.r.min()


# --- noise-free data of every kind come back exactly ----------------------------------------------------------------

KINDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]


@pytest.mark.variants
@pytest.mark.parametrize("method, intersample", KINDS)
def test_noise_free_record_gives_the_plant_and_its_state(method, intersample):
    h = 0.002 if method == "euler" else 0.1
    plant, u, y, _ = record_of(
        [1.0, 2.0, 5.0], [1.0, 0.3, 0.1], h=h, snr=np.inf, method=method, intersample=intersample,
        samples=6000 if h < 0.01 else 1000,
    )  # fmt: skip
    z0 = np.random.default_rng(0)
    z0.standard_normal(len(u))
    state = z0.standard_normal(6)
    result = phc.pem((u, y), order=3, dt=h, method=method, intersample=intersample)
    assert np.allclose(result.d, plant.d, rtol=1e-10)
    assert np.allclose(result.r, plant.r, rtol=1e-8)
    assert np.allclose(result.initial_state, state, atol=1e-7)
    assert result.fit_percent > 99.999999
    assert "reproduced to rounding" in result.message


@cache
def fit_of_two_modes(seed):
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3], samples=400, seed=seed)
    return u, y, phc.pem((u, y), dt=0.1)


@settings(deadline=None, max_examples=6, derandomize=True)
@given(time=st.sampled_from([1e-9, 1e-3, 1.0, 1e9]), gain=st.sampled_from([1e-9, 1.0, 1e9]), seed=st.integers(0, 1))
def test_units_of_time_and_output_do_not_change_the_answer(time, gain, seed):
    u, y, reference = fit_of_two_modes(seed)
    scaled = phc.pem((u, gain * y), dt=0.1 * time)
    assert scaled.order == reference.order
    assert np.allclose(scaled.d * time, reference.d, rtol=1e-9)
    assert np.allclose(scaled.r / gain, reference.r, rtol=1e-5, atol=1e-9 * reference.r.max())
    assert np.isclose(scaled.fit_percent, reference.fit_percent, atol=1e-6)


# --- noise -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "n, samples, snr, bins",
    [(2, 1000, 20, 3), (5, 1000, 20, 1.5), *slowly((5, 1000, 20, 3), (5, 2000, 10, 3), (10, 4000, 20, 3))],
)
def test_random_plants_are_found_without_a_guess_within_4_standard_errors(n, samples, snr, bins):
    for seed in range(3):
        rng = np.random.default_rng([n, samples, seed])
        d = np.zeros(n)
        while np.diff(d, append=np.inf).min() < bins * 2 * np.pi / samples:
            d = np.sort(rng.uniform(0.1, 2.8, n))
        _, u, y, _ = record_of(d, rng.uniform(0.3, 1.0, n) / d, samples=samples, h=1.0, snr=snr, seed=seed)
        result = phc.pem((u, y), n, dt=1.0)
        assert result.success
        assert (np.abs(result.d - d) < 4.5 * result.stderr["d"]).all()


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_noise():
    plant, u, clean, _ = record_of([0.5, 1.9], [1.0, 0.3], samples=500, snr=np.inf)
    rng = np.random.default_rng(5)
    z0 = lossless_fit((u, clean), 2, dt=0.1).initial_state
    scores = []
    for _ in range(30):
        noisy = clean + 0.3 * np.std(clean) * rng.standard_normal(500)
        result = lossless_fit((u, noisy), 2, dt=0.1, **KNOWN)
        scores.append(
            np.concatenate(
                [
                    (result.d - plant.d) / result.stderr["d"],
                    (result.r - plant.r) / result.stderr["r"],
                    (result.initial_state - z0) / result.stderr["initial_state"],
                ]
            )
        )
    spread = np.mean(np.square(scores), axis=0)
    # mean of 30 squared standard normal scores: 1 +- sqrt(2/30); 3 deviations either side
    assert (np.abs(spread - 1) < 3 * np.sqrt(2 / 30)).all()


def test_noise_variance_and_likelihood_are_those_of_the_residuals():
    _, u, y, deviation = record_of([0.5, 1.9], [1.0, 0.3])
    result = phc.pem((u, y), 2, dt=0.1)
    assert np.isclose(result.noise_variance, deviation**2, rtol=5 * np.sqrt(2 / 1000))
    sse = np.sum(result.residuals**2)
    assert np.isclose(result.loss, sse / 1000)
    assert np.isclose(result.noise_variance, sse / (1000 - 8))
    assert np.isclose(result.loglik, -500 * (np.log(2 * np.pi * sse / 1000) + 1))
    assert np.isclose(result.bic, 9 * np.log(1000) - 2 * result.loglik)
    assert np.isclose(result.aic, 18 - 2 * result.loglik)
    assert np.allclose(result.predicted + result.residuals, y)
    assert result.whiteness > 1e-3 and "residuals are white" in result.message


@pytest.mark.parametrize("n", [2, 5, *slowly(1)])
def test_auto_finds_the_number_of_modes(n):
    for seed in range(3):
        rng = np.random.default_rng([n, seed])
        d = np.linspace(0.4, 2.7, n) + 0.1 * rng.uniform(-1, 1, n)
        _, u, y, _ = record_of(d, rng.uniform(0.5, 1.0, n) / d, h=1.0, seed=seed)
        result = phc.pem((u, y), dt=1.0)
        assert result.order == n
        orders = [row.order for row in result.order_table]  # several modes may join at once
        assert orders == sorted(set(orders)) and orders[0] == 0
        assert min(result.order_table, key=lambda row: row.bic).order == n


@pytest.mark.slow
@pytest.mark.parametrize("outputs", [1, 2])
def test_no_more_modes_than_the_largest_order_and_it_is_said(outputs):
    d = np.linspace(0.9, 11.0, 8)
    rng = np.random.default_rng([outputs, 0])
    shapes = rng.uniform(0.5, 1.0, (8, outputs)) * np.sqrt(d)[:, None]
    plant = phc.modes(d * (-0.012 + 1j), shapes, shapes[:, :1]).state_space()
    u = rng.standard_normal((1, 1000))
    y = ct.forced_response(ct.c2d(plant, 0.1), 0.1 * np.arange(1000), u, squeeze=False).outputs
    y = y + 0.02 * np.std(y, axis=1, keepdims=True) * rng.standard_normal(y.shape)
    result = phc.pem((u, y), dt=0.1, max_order=4, **KNOWN)
    assert result.order == 4
    assert [f.values for f in result.findings if f.cause.name == "LARGEST_ORDER"] == [(4.0,)]


def test_auto_finds_nothing_in_noise():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        result = phc.pem((rng.standard_normal(800), rng.standard_normal(800)), dt=1.0)
        assert result.order == 0
        assert "Nothing to model" in result.message
        assert "Nothing to model" in result.summary()
        assert result.system(1j) == 0


# --- real structures and recordings ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lund_modes(data_folder):
    """The eight modes with the largest residue below 40 Hz for force and velocity at the first degree of freedom."""
    folder = data_folder / "structures"
    K, M = (scipy.io.mmread(folder / f"lund_{kind}.mtx").toarray() for kind in ("stiffness", "mass"))
    squared, shapes = scipy.linalg.eigh(K, M)
    d, kappa = np.sqrt(squared), shapes[0] ** 2
    low = np.flatnonzero(d < 2 * np.pi * 40)
    chosen = np.sort(low[np.argsort(kappa[low])[::-1][:8]])
    return d[chosen], kappa[chosen] / d[chosen]


@pytest.mark.slow
def test_eight_modes_of_a_structure_are_found_to_1e_4(lund_modes):
    d, r = lund_modes
    _, u, y, _ = record_of(d, r, samples=8192, h=1 / 128, z0=np.zeros(16))
    result = phc.pem((u, y), dt=1 / 128)
    assert result.order == 8
    assert np.abs(result.d / d - 1).max() < 1e-4


@pytest.mark.slow
def test_recording_of_a_robot_arm_is_not_flattered(data_folder):
    torque, acceleration = np.loadtxt(data_folder / "measured" / "robot_arm.dat", unpack=True)
    result = lossless_fit((torque, acceleration), dt=1.0, max_order=4)
    assert result.fit_percent < 90 and result.outcome.name == "NOT_DESCRIBED"
    text = " ".join(result.summary().split())
    assert "they reject 'lossless'" in text
    assert "does not describe the data" in text
    assert f"{result.fit_percent:.2f} %" in text


# --- data and options ------------------------------------------------------------------------------------------


def test_time_response_data_and_arrays_give_the_same():
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3])
    t = 7.0 + 0.1 * np.arange(1000)
    data = ct.TimeResponseData(t, y, inputs=u, issiso=True, input_labels=["force"], output_labels=["speed"])
    from_data, from_arrays = phc.pem(data, 2), phc.pem((u, y), 2, dt=0.1)
    assert np.allclose(from_data.d, from_arrays.d, rtol=1e-9)
    assert from_data.system.input_labels == ["force"] and from_data.system.output_labels == ["speed"]
    assert "'speed' from 'force'" in from_data.summary()
    assert np.array_equal(from_data.record.time, t)


def test_labels_that_python_control_does_not_take_as_names_are_adapted():
    _, u, y, _ = record_of([0.5], [1.0], samples=100)
    data = ct.TimeResponseData(
        0.1 * np.arange(100), y, inputs=u, issiso=True, input_labels=["F [0.1 N]"], output_labels=["v.1"]
    )
    result = lossless_fit(data, 1, **KNOWN)
    assert result.system.input_labels == ["F [0_1 N]"] and result.system.output_labels == ["v_1"]
    assert "'v.1' from 'F [0.1 N]'" in result.summary()


def test_inputs_of_the_call_are_not_modified_and_results_are_locked():
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3])
    before = u.copy(), y.copy()
    result = phc.pem((u, y), 2, dt=0.1)
    assert np.array_equal(u, before[0]) and np.array_equal(y, before[1])
    u[:], y[:] = 0.0, 0.0
    assert np.array_equal(result.record.u, before[0])
    with pytest.raises(ValueError, match="read-only"):
        result.predicted[0] = 1.0
    with pytest.raises(AttributeError):
        result.loss = 0.0


def test_missing_outputs_are_left_out():
    plant, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3], snr=np.inf)
    gaps = y.copy()
    gaps[np.random.default_rng(1).choice(1000, 100, replace=False)] = np.nan
    result = phc.pem((u, gaps), 2, dt=0.1)
    assert np.allclose(result.d, plant.d, rtol=1e-9)
    assert np.isnan(result.residuals).sum() == 100
    assert not np.isnan(result.predicted).any()
    assert "100 values missing" in result.summary()


@pytest.mark.slow
@pytest.mark.parametrize("samples, order", [(3000, 2), *slowly((1000, "auto"), (17_000, 2))])
def test_a_large_constant_of_the_sensor_changes_nothing_where_an_offset_is_fitted(samples, order):
    d, r = np.array([1.0, 2.5]), np.array([0.3, 0.2])
    _, u, y, deviation = record_of(d, r, samples=samples, h=0.2, snr=30.0)
    plain = phc.pem((u, y), order, dt=0.2, offset=True)
    for size in (1e3, 1e6):
        constant = size * np.std(y)
        shifted = phc.pem((u, y + constant), order, dt=0.2, offset=True)
        assert np.abs(shifted.d - d).max() <= 5 * shifted.stderr["d"].max()
        # the minimum is found to a part of the standard errors
        assert np.abs(shifted.d - plain.d).max() <= 3e-3 * plain.stderr["d"].max()
        assert np.abs(shifted.r - plain.r).max() <= 1e-3 * plain.stderr["r"].max()
        assert abs(shifted.experiments[0].offset - plain.experiments[0].offset - constant) <= deviation * 1e-3


def test_a_plant_at_rest_may_be_said_to_be_at_rest():
    plant, _, _, _ = record_of([0.5, 1.9], [1.0, 0.3])
    t = 0.1 * np.arange(1000)
    y = phc.forced_response(plant, t, 1.0, intersample="zoh").outputs
    result = phc.pem((np.ones(1000), y), 2, dt=0.1, initial_state="zero")
    assert np.allclose(result.r, plant.r, rtol=1e-8)
    assert not result.initial_state.any()


@pytest.mark.parametrize("method, intersample", [("exact", "foh"), ("midpoint", "foh"), ("exact", "zoh")])
def test_a_plant_at_rest_under_any_input_is_fitted_exactly(method, intersample):
    kind = {"method": method, "intersample": intersample}
    plant, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3], snr=np.inf, z0=np.zeros(4), **kind)
    result = phc.pem((u, y), 2, dt=0.1, initial_state="zero", **kind)
    assert np.allclose(result.r, plant.r, rtol=1e-9)
    assert not result.initial_state.any()


def test_a_weight_of_the_wrong_sign_is_zero_and_the_structure_rejected():
    # a mode seen with the opposite sign: sensor away from the actuator
    t, rng = 0.1 * np.arange(1000), np.random.default_rng(0)
    u = rng.standard_normal(1000)
    parts = [
        phc.forced_response(phc.ph(phc.modes(d, r)), t, u, intersample="zoh").outputs
        for d, r in ((0.7, 1.0), (2.0, 0.1))
    ]
    result = lossless_fit((u, parts[0] - parts[1]), 2, dt=0.1)
    assert result.r[0] == pytest.approx(1.0, abs=4 * result.stderr["r"][0])
    assert result.r[1] == 0 and np.isnan(result.stderr["r"][1]) and np.isfinite(result.stderr["d"]).all()
    # the errors are those of what the lossless modes leave, though any residues would leave rounding only
    assert 0.2 < result.noise_variance[0] / np.var(parts[1]) < 1.1 and result.stderr["r"][0] > 1e-3
    assert result.outcome.name == "NOT_DESCRIBED" and "rounding" not in result.message
    assert [one.cause.name for one in result.findings] == ["LOSSES"]


def test_callback_sees_every_iteration():
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3], samples=500)
    seen = []
    result = phc.pem((u, y), dt=0.1, max_order=3, callback=seen.append)
    assert {2} <= {progress.order for progress in seen} <= {1, 2, 3}
    assert all(progress.max_order == 3 and progress.loss > 0 for progress in seen)
    assert min(progress.loss for progress in seen if progress.order == 2) == pytest.approx(result.loss, rel=0.05)


def test_prediction_starts_where_it_is_told():
    plant, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3], snr=np.inf, samples=1200)
    result = phc.pem((u[:800], y[:800]), 2, dt=0.1)
    scale = 1e-8 * np.abs(y).max()
    assert np.abs(result.predict(u).outputs - y).max() < scale
    assert np.abs(result.predict((u, y)).outputs - y).max() < scale
    assert np.abs(result.predict((u[400:], y[400:])).outputs - y[400:]).max() < scale
    assert np.abs(result.predict(u[800:], initial_state="final").outputs - y[800:]).max() < scale
    from_rest = phc.forced_response(plant, 0.1 * np.arange(1200), u, intersample="zoh").outputs
    assert np.abs(result.predict(u, initial_state="zero").outputs - from_rest).max() < scale
    assert np.abs(from_rest - y).max() > 1e3 * scale
    with pytest.raises(phc.StructureError, match="no outputs to estimate the motion from"):
        result.predict(u, initial_state="estimate")


def test_result_is_a_python_control_system():
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3])
    system = phc.pem((u, y), 2, dt=0.1).system
    assert isinstance(system, ct.StateSpace) and isinstance(system, phc.PortHamiltonian)
    assert isinstance(ct.feedback(system, 1), ct.StateSpace)
    assert ct.step_response(system).outputs.shape == ct.step_response(system).time.shape


# --- bad input --------------------------------------------------------------------------------------------------

GOOD = np.random.default_rng(0).standard_normal((2, 100))


@pytest.mark.parametrize(
    "data, options, error, message",
    [
        (([1.0], [1.0]), {}, phc.IdentificationError, "the record has 1 sample; a fit needs at least 5"),
        (([], []), {}, phc.IdentificationError, "the record has 0 samples"),
        (([1.0, 2.0, 1.0], [1.0, 0.0, 1.0]), {}, phc.IdentificationError, "3 observed samples can carry; a mode needs"),
        (
            (np.r_[GOOD[0, :9], np.nan, GOOD[0, 10:]], GOOD[1]),
            {},
            phc.StructureError,
            "the input is not finite.*index 9",
        ),
        (
            (GOOD[0], np.r_[GOOD[1, :9], np.inf, GOOD[1, 10:]]),
            {},
            phc.StructureError,
            "the output is infinite at sample 9",
        ),
        ((GOOD[0], np.full(100, np.nan)), {}, phc.StructureError, "output 'y' has no sample"),
        ((np.ones(100), GOOD[1]), {}, phc.IdentificationError, "input 'u' is constant.*leave it out"),
        ((np.zeros(100), GOOD[1]), {"initial_state": "zero"}, phc.IdentificationError, "input 'u' is constant"),
        ((GOOD[0], np.zeros(100)), {}, phc.IdentificationError, "output 'y' is zero throughout"),
        (GOOD, {"order": 25}, phc.IdentificationError, "25 modes have 152 unknowns.*largest order.*16"),
        ((GOOD[0], GOOD[1, :-1]), {}, phc.StructureError, "input has 100 samples, the output 99"),
        (GOOD, {"order": 0}, phc.StructureError, "order is 0"),
        (GOOD, {"order": 2.5}, phc.StructureError, "order is 2.5"),
        (GOOD, {"order": True}, phc.StructureError, "order is True"),
        (GOOD, {"order": "best"}, phc.StructureError, "'auto' or a whole number"),
        (GOOD, {"max_order": 0}, phc.StructureError, "max_order is 0"),
        (GOOD, {"dt": 0.0}, phc.StructureError, "dt is 0.0"),
        (GOOD, {"dt": None}, phc.StructureError, "dt is missing"),
        (GOOD, {"dt": "fast"}, phc.StructureError, "dt is 'fast'"),
        (GOOD, {"method": "rk4"}, phc.StructureError, "method is 'rk4'.*'exact', 'midpoint', 'euler'"),
        (GOOD, {"intersample": "spline"}, phc.StructureError, "intersample is 'spline'"),
        (GOOD, {"method": "euler", "intersample": "foh"}, phc.StructureError, "intersample must be 'zoh'"),
        (GOOD, {"initial_state": "guess"}, phc.StructureError, "initial_state is 'guess'"),
        ((GOOD[0], 1j * GOOD[1]), {}, phc.StructureError, "the output is complex"),
        ((["a"] * 100, GOOD[1]), {}, phc.StructureError, "the input does not hold real numbers"),
        ((GOOD.T, GOOD), {}, phc.StructureError, r"the inputs have shape \(100, 2\)"),
        ((GOOD, GOOD), {"method": "midpoint"}, phc.StructureError, "method='midpoint' is for lossless models"),
        ((GOOD, GOOD), {"ports": [("y3", "u1")]}, phc.StructureError, "no output 'y3'.*'y1', 'y2'"),
        ((GOOD, GOOD), {"ports": [(0, 0), (0, 1)]}, phc.StructureError, "output 'y1' is at 2 ports"),
        ((GOOD, GOOD), {"ports": "y1:u1"}, phc.StructureError, "not a list of pairs"),
        ((GOOD, GOOD), {"quantity": ["velocity"]}, phc.StructureError, "1 entries for 2 outputs"),
        ((GOOD, GOOD), {"quantity": {"y3": "free"}}, phc.StructureError, "quantity names 'y3'"),
        ((GOOD, GOOD), {"structure": "damped"}, phc.StructureError, "structure is 'damped'"),
        ((GOOD, 0 * GOOD), {}, phc.IdentificationError, "output 'y1' is zero throughout"),
        ((0 * GOOD, GOOD), {}, phc.IdentificationError, "input 'u1' is constant in every experiment"),
        (3.0, {}, phc.StructureError, "data is a float"),
        (None, {}, phc.StructureError, "data is a NoneType"),
    ],
)
def test_bad_records_and_options_are_refused_with_what_was_measured(data, options, error, message):
    arguments = {"dt": 0.1} | options
    order = arguments.pop("order", "auto")
    if isinstance(data, np.ndarray):
        data = tuple(data)
    with pytest.raises(error, match="(?s)" + message):
        phc.pem(data, order, **arguments)


def test_records_of_unequal_steps_are_refused():
    t = np.arange(10.0)
    t[6:] += 0.5
    uneven = ct.TimeResponseData(t, np.ones(10), inputs=np.arange(10.0), issiso=True)
    with pytest.raises(phc.StructureError, match="not equally spaced: the step from sample 5 to 6"):
        phc.pem(uneven)
    even = ct.TimeResponseData(np.arange(10.0), np.ones(10), inputs=np.arange(10.0), issiso=True)
    with pytest.raises(phc.StructureError, match="dt = 2 contradicts"):
        phc.pem(even, dt=2.0)


def test_unknown_keywords_are_errors():
    with pytest.raises(TypeError, match="unexpected keyword"):
        phc.pem(tuple(GOOD), dt=0.1, ordre=2)


# --- on disk --------------------------------------------------------------------------------------------------------


def test_a_result_comes_back_from_its_file_bit_by_bit(tmp_path):
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3])
    y[[5, 50]] = np.nan
    result = lossless_fit((u, y), "auto", dt=0.1)
    assert np.isnan(result.stderr["offset"]).all(), "the record is meant to have NaN standard errors"
    result.save(tmp_path / "result.json")
    back = phc.load(tmp_path / "result.json")
    assert type(back) is phc.PEMResult
    for name in ("initial_state", "covariance", "predicted", "residuals", "poles", "residues", "d", "r"):
        assert np.array_equal(getattr(back, name), getattr(result, name), equal_nan=True)
    for name in ("noise_variance", "loss", "loglik", "aic", "bic", "fit_percent", "structure", "tests", "findings",
                 "message", "blind", "whiteness", "success", "outcome", "method", "intersample"):  # fmt: skip
        assert getattr(back, name) == getattr(result, name)
    assert back.summary() == result.summary()
    assert np.array_equal(back.record.y, result.record.y, equal_nan=True) and back.record.dt == result.record.dt
    assert [(row.order, row.bic, *row.d) for row in back.order_table] == [
        (row.order, row.bic, *row.d) for row in result.order_table
    ]
    assert np.array_equal(back.predict(u).outputs, result.predict(u).outputs)
    with pytest.raises(phc.OutputExistsError):
        result.save(tmp_path / "result.json")


@pytest.mark.variants
@pytest.mark.parametrize(
    "field, value, message",
    [
        ("structure", "lossy", "structure is 'lossy'"),
        ("method", "rk4", "method is 'rk4'"),
        ("predicted", [1.0], "predicted"),
        ("success", "yes", "success"),
    ],
)
def test_a_result_whose_file_was_changed_is_refused(tmp_path, field, value, message):
    _, u, y, _ = record_of([0.5], [1.0], samples=100)
    path = tmp_path / "result.json"
    lossless_fit((u, y), 1, dt=0.1, **KNOWN).save(path)
    document = json.loads(path.read_text())
    del document["sha256"]
    document["data"][field] = value
    path.write_text(json.dumps(document))
    with pytest.raises(phc.FileFormatError, match=message):
        phc.load(path)


# --- records at the edge ----------------------------------------------------------------------------------------------


def test_quality_of_a_fit_to_a_handful_of_samples_is_not_judged():
    _, u, y, _ = record_of([0.8], [1.0], samples=14, h=1.0)
    result = phc.pem((u, y), 1, dt=1.0)
    spare = 14 - (result.unknowns - 1)
    assert result.outcome.name == "UNJUDGED" and f"only {spare} samples more than unknowns" in result.message
    assert "white" not in result.message


def test_constant_output_is_held_against_its_own_size():
    result = phc.pem((np.random.default_rng(0).standard_normal(300), np.ones(300)), 1, dt=1.0)
    assert -100 < result.fit_percent <= 100


@pytest.mark.parametrize("factor", [1e150, 1e-150])
def test_signals_whose_squares_leave_the_range_of_doubles_are_refused(factor):
    with pytest.raises(phc.StructureError, match=r"the output is of size.*choose another unit"):
        phc.pem((GOOD[0], factor * GOOD[1]), dt=0.1)
    with pytest.raises(phc.StructureError, match=r"the input is of size.*choose another unit"):
        phc.pem((factor * GOOD[0], GOOD[1]), dt=0.1)


def test_euler_fit_of_white_noise_does_not_overflow():
    u = np.random.default_rng(0).standard_normal(500)
    assert np.isfinite(phc.pem((u, u), 2, dt=1.0, method="euler").loss)


def test_plant_at_rest_needs_fewer_samples():
    with pytest.raises(phc.IdentificationError, match=r"1 mode has 6 unknowns.* 2 observed samples.* at least 7"):
        phc.pem(([1.0, 2.0], [0.0, 1.0]), dt=1.0, initial_state="zero")


def multisine(samples, lines, seed):
    """A sum of cosines of random frequencies and phases."""
    rng = np.random.default_rng(seed)
    phases = np.outer(np.arange(samples), rng.uniform(0, np.pi, lines)) + rng.uniform(0, 2 * np.pi, lines)
    return np.cos(phases).sum(axis=1)


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(6))
def test_lines_of_the_input_are_not_taken_for_modes(seed):
    rng = np.random.default_rng(seed)
    d, u = rng.uniform(0.3, 2.9), multisine(500, 10, seed)
    y = phc.forced_response(
        phc.ph(phc.modes(d, 1 / d)), np.arange(500), u, rng.standard_normal(2), intersample="zoh"
    ).outputs
    y = y + 0.01 * np.std(y) * rng.standard_normal(500)
    result = phc.pem((u, y), dt=1.0)
    assert result.order == 1
    assert abs(result.d[0] - d) < 4.5 * result.stderr["d"][0]


@pytest.mark.slow
def test_reversed_sensor_is_suspected():
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3], z0=np.zeros(4))
    result = lossless_fit((u, -y), 2, dt=0.1)
    assert np.all(result.r < 1e-9)
    assert result.outcome.name == "NOT_DESCRIBED"
    assert "check the polarity of the sensor" in result.message
    assert "POLARITY" in [one.cause.name for one in phc.pem((u, -y), 2, dt=0.1).findings]
    assert "polarity" not in phc.pem((u, y), 2, dt=0.1).message


def test_a_constant_is_named_where_there_is_one_of_the_sensor():
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3])
    level = 10 * np.std(y)
    result = phc.pem((u, y + level), dt=0.1)
    assert result.order == 2 and abs(result.offsets[0] - level) < 4 * result.stderr["offset"][0]
    assert "The output has a constant of" in result.message
    assert "constant" not in phc.pem((u, y), dt=0.1).message


def test_verdict_in_a_few_words_stands_above_the_table():
    _, u, y, _ = record_of([0.5, 1.9, 2.6], [1.0, 0.3, 0.3])
    good, poor = phc.pem((u, y), dt=0.1), lossless_fit((u, y), 1, dt=0.1)
    assert good.outcome.name == "CONSISTENT"
    assert poor.outcome.name == "DOUBTFUL"
    assert "more than 1 mode may fit better" in poor.message and "better" not in good.message
    assert good.summary().index(good.verdict) < good.summary().index("mode  ")


def test_masked_outputs_are_missing_and_masked_inputs_refused():
    _, u, y, _ = record_of([0.5, 1.9], [1.0, 0.3])
    mask = np.random.default_rng(1).random(1000) < 0.1
    masked = phc.pem((u, np.ma.array(y, mask=mask)), 2, dt=0.1, **KNOWN)
    assert np.array_equal(masked.d, phc.pem((u, np.where(mask, np.nan, y)), 2, dt=0.1, **KNOWN).d)
    with pytest.raises(phc.StructureError, match=f"the input is not finite at sample {mask.argmax()}"):
        phc.pem((np.ma.array(u, mask=mask), y), 2, dt=0.1)


@pytest.mark.variants
@pytest.mark.parametrize("method, intersample", KINDS)
def test_a_record_that_goes_on_is_predicted_from_where_it_ended(method, intersample):
    h = 0.002 if method == "euler" else 0.1
    _, u, y, _ = record_of(
        [1.0, 2.0], [1.0, 0.3], h=h, snr=np.inf, method=method, intersample=intersample, samples=7000
    )
    result = phc.pem((u[:6000], y[:6000]), 2, dt=h, method=method, intersample=intersample)
    ahead = result.predict(u[6000:], initial_state="final").outputs
    assert np.abs(ahead - y[6000:]).max() < 1e-7 * np.abs(y).max()


def test_the_data_of_a_result_are_locked():
    _, u, y, _ = record_of([0.5], [1.0], samples=100)
    result = lossless_fit((u, y), 1, dt=0.1, **KNOWN)
    for array in (result.record.u, result.record.y, result.stderr["d"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(TypeError):
        result.stderr["d"] = 0.0


@pytest.mark.parametrize("dt", [10**400, 1e-300, 1e300, float("nan"), True])
def test_steps_out_of_range_are_refused(dt):
    with pytest.raises(phc.StructureError, match=r"dt is .*between 1e-100 and 1e100"):
        phc.pem(tuple(GOOD), dt=dt)


def test_an_experiment_that_a_fit_does_not_have_cannot_be_drawn():
    u = np.random.default_rng(0).standard_normal(200)
    fit = phc.pem(
        (u, phc.forced_response(phc.frenkel_kontorova(), 0.1 * np.arange(200), u, intersample="zoh").outputs), 2, dt=0.1
    )
    with pytest.raises(phc.StructureError, match="experiment is 1; the experiments are counted from 0 to 0"):
        fit.plot(1)

"""Unmeasured forces beside measured ones, noise of inputs, sensors that share noise: named, with errors that hold."""

import control as ct
import numpy as np
import pytest
from known import HELD
from scipy.linalg import expm
from scipy.signal import butter, lfilter
from scipy.stats import chi2
from slow import slowly

import ph_control as phc

W, ZETA = np.array([0.6, 1.1, 1.7]), np.array([0.012, 0.008, 0.015])
SHAPES = np.array([[0.8, 1.0, -0.7], [1.2, -0.5, 0.9], [0.6, -1.1, -0.8]])  # of three floors, a column each mode
PORTS = [(0, 0)]


def steps():
    """Matrices of one step of 1, from held forces at the floors, and the covariance of what white forces add in it."""
    n, i = len(W), np.arange(len(W))
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n)), np.zeros((n, 2 * n))
    A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = 1, -(W**2), -2 * ZETA * W
    B[1::2], C[:, 1::2] = SHAPES.T, SHAPES
    held = expm(np.block([[A, B], [np.zeros((n, 3 * n))]]))[: 2 * n]
    both = expm(np.block([[-A, B @ B.T], [np.zeros(A.shape), A.T]]))
    Q = held[:, : 2 * n] @ both[: 2 * n, 2 * n :]
    return held[:, : 2 * n], held[:, 2 * n :], C, 0.5 * (Q + Q.T)


def responses(seed, samples, inputs=1):
    """Measured forces (m, T), the outputs that these make, and those of white forces at all floors, of equal size."""
    A, B, C, Q = steps()
    rng, early = np.random.default_rng(seed), 1500
    values, V = np.linalg.eig(A)
    u = rng.standard_normal((inputs, samples + early))
    forces = np.linalg.cholesky(Q + 1e-14 * np.eye(len(Q))) @ rng.standard_normal((len(Q), samples + early))
    outputs = []
    for force in (B[:, :inputs] @ u, forces):
        modal = np.linalg.solve(V, force)
        states = [lfilter([0, 1], [1, -value], row) for value, row in zip(values, modal, strict=True)]
        outputs.append((C @ (V @ np.array(states)).real)[:, early:])
    outputs[1] *= outputs[0].std() / outputs[1].std()
    return u[:, early:], *outputs, rng


def record(seed, samples=2000, *, forces=0.0, inputs=0.0, sensors=0.02, correlation=0.0, count=1):
    """Recorded inputs and outputs; sizes are those of noise over those of what it is on."""
    u, y, moved, rng = responses(seed, samples, count)
    root = np.linalg.cholesky((1 - correlation) * np.eye(3) + correlation)
    y = y + forces * moved + sensors * y.std() * root @ rng.standard_normal(y.shape)
    return u + inputs * rng.standard_normal(u.shape), y


def causes(result):
    return {finding.cause.name for finding in result.findings}


def fit_of(data, *order, **options):
    return phc.pem(data, *order, dt=1.0, quantity="velocity", ports=PORTS, **options)


@pytest.fixture(scope="module")
def forced():
    """The fit of a record in which forces make three tenths of the outputs."""
    return fit_of(record(0, forces=0.3), 3, real_poles=0, noise="forces", **HELD)


@pytest.mark.slow
def test_forces_are_named_with_their_share_and_add_no_modes():
    forced = fit_of(record(0, forces=0.3))
    assert forced.order == 3 and not len(forced.real_poles) and forced.structure == "classical"
    (finding,) = (finding for finding in forced.findings if finding.cause.name == "FORCES")
    np.testing.assert_allclose(finding.values, 0.3 / np.hypot(1, 0.3), atol=0.1)
    assert finding.gain > 100 and "were not measured" in forced.message
    assert forced.success and forced.whiteness > 1e-3
    # what white noise would be told with is far too sure: it takes the forces for noise that modes do not filter
    white = fit_of(record(0, forces=0.3), 3, noise="white")
    assert white.loglik < forced.loglik - 100 and "FORCES" not in causes(white)


@pytest.mark.slow
@pytest.mark.parametrize("size", [{"forces": 0.03}, *slowly({"inputs": 0.05})])
def test_modes_lie_within_their_intervals(size):
    z = []
    for seed in range(2):
        result = fit_of(record(seed + 12, **size))
        assert result.order == 3 and not len(result.real_poles)
        z += [(result.natural_frequencies - W) / result.stderr["natural_frequencies"]]
        z += [(result.damping_ratios - ZETA) / result.stderr["damping_ratios"]]
    low, high = chi2.ppf([1e-3, 1 - 1e-3], np.size(z))
    assert low < np.sum(np.square(z)) < high


def test_shapes_scale_to_the_force_at_its_port(forced):
    assert forced.shapes_scaled
    error = forced.shapes.real - (SHAPES * np.sign(SHAPES[0])).T
    assert np.all(np.abs(error) < 4.5 * np.abs(forced.stderr["shapes"].real) + 1e-12)


@pytest.mark.slow
def test_a_given_number_of_modes_is_kept_beside_forces():
    data = record(1, forces=0.3)
    result = fit_of(data, 3)
    assert result.order == 3 and "FORCES" in causes(result)
    assert fit_of(data, 2, noise="forces").order == 2 and fit_of(data, noise="forces").order == 3


def test_white_noise_names_nothing_and_the_fit_is_that_of_white_noise():
    data = record(30)
    result, white = fit_of(data), fit_of(data, noise="white")
    assert not causes(result) & {"FORCES", "CORRELATED_NOISE"}
    np.testing.assert_array_equal(result.poles, white.poles)


@pytest.mark.slow
def test_sensors_that_share_noise_are_named_and_intervals_are_those_of_all_outputs():
    correlation = 0.5
    data = record(3, sensors=0.3, correlation=correlation)
    result = fit_of(data)
    (finding,) = (finding for finding in result.findings if finding.cause.name == "CORRELATED_NOISE")
    np.testing.assert_allclose(finding.values, correlation, atol=0.1)
    covariance = result.noise.covariance
    sizes = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((covariance / np.outer(sizes, sizes))[np.triu_indices(3, 1)], correlation, atol=0.1)
    assert result.noise.is_white
    alone = fit_of(data, 3, noise="white", structure=result.structure)
    assert result.loglik > alone.loglik + 100
    # weights that know the correlation make sharper estimates of the same plant
    ratio = result.stderr["natural_frequencies"] / alone.stderr["natural_frequencies"]
    assert np.mean(np.log(ratio)) < 0
    np.testing.assert_allclose(result.natural_frequencies, W, atol=5 * alone.stderr["natural_frequencies"].max())


def test_the_noise_of_forces_predicts_a_step_ahead(forced):
    u, y = record(50, forces=0.3)
    simulated = phc.compare((u, y), forced, dt=1.0)
    ahead = phc.compare((u, y), forced, dt=1.0, horizon=1)
    assert np.all(np.mean(ahead.fit_percent) > np.mean(simulated.fit_percent) + 10)
    errors = y - forced.predict((u, y), horizon=1).outputs
    np.testing.assert_allclose(np.cov(errors), forced.noise.covariance, atol=0.15 * forced.noise.covariance.max())


def test_a_file_keeps_the_noise_of_forces(forced, tmp_path):
    forced.save(tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    np.testing.assert_array_equal(again.noise.covariance, forced.noise.covariance)
    np.testing.assert_array_equal(again.kalman_gain, forced.kalman_gain)
    assert again.findings == forced.findings and str(again) == str(forced)


@pytest.mark.parametrize("outputs", [1, *slowly(3)])
def test_slow_noise_of_a_sensor_is_no_force(outputs):
    rng, (u, y) = np.random.default_rng(4), record(4, sensors=0.0)
    slow = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], rng.standard_normal((3, 3000)))[:, 1000:]
    result = fit_of((u, (y + 0.3 * y.std() * slow)[:outputs]), **HELD)
    assert result.order == 3 and "FORCES" not in causes(result)
    np.testing.assert_allclose(result.damping_ratios, ZETA, atol=5 * result.stderr["damping_ratios"].max())


def test_slow_noise_is_no_force_where_it_makes_poles_grow_in_white_noise():
    rng, plant = np.random.default_rng(0), phc.frenkel_kontorova(2)
    t, u = 0.1 * np.arange(1000), rng.standard_normal(1000)
    y = phc.forced_response(plant, t, u, intersample="zoh").outputs
    slow = lfilter([0.2], [1.0, -0.95], np.random.default_rng(2).standard_normal(1500))[500:]
    result = phc.pem((u, y + slow), 2, dt=0.1, **HELD)
    assert "FORCES" not in causes(result)
    errors = result.natural_frequencies - np.sort(np.abs(plant.poles().imag))[::2]
    assert np.all(np.abs(errors) < 4 * result.stderr["natural_frequencies"])
    assert phc.residual_analysis((u, y + slow), result).whiteness > 1e-3


def test_two_modes_within_a_bin_are_no_forces_beside_one():
    rng = np.random.default_rng(17)
    u, y = rng.standard_normal(1500), np.zeros(1500)
    for d, k in ((0.6, 0.9), (0.6 + 1.06 * 2 * np.pi / 1500, 0.4)):
        z = np.exp(1j * d)
        y += 2 * k * lfilter([0, (z - 1) / (1j * d)], [1, -z], u.astype(complex)).real
    result = phc.pem((u, y + 0.1 * y.std() * rng.standard_normal(1500)), dt=1.0)
    assert result.order == 2 and not causes(result)


def test_a_delay_is_told_from_what_forces_do():
    late = 6
    u, y = record(7, 2000 + late, forces=0.2)
    result = fit_of((u[:, late:], y[:, :-late]))
    assert result.order == 3 and not len(result.real_poles) and "FORCES" in causes(result)
    np.testing.assert_array_equal(result.delay, late)
    np.testing.assert_allclose(result.damping_ratios, ZETA, atol=5 * result.stderr["damping_ratios"].max())


@pytest.mark.slow
def test_a_drift_is_found_beside_forces():
    u, y = record(8, forces=0.2)
    slopes = np.array([1.0, -2.0, 0.5]) * y.std() / 2000
    result = fit_of((u, y + slopes[:, None] * np.arange(2000)), 3, offset="auto", real_poles=0)
    assert result.order == 3 and not len(result.real_poles) and {"FORCES", "DRIFT"} <= causes(result)
    (drift,) = [finding for finding in result.findings if finding.cause.name == "DRIFT"]
    np.testing.assert_allclose(drift.values, slopes, atol=0.1 * abs(slopes).max())


@pytest.mark.slow
def test_inputs_that_answer_to_outputs_are_no_traces():
    """A controller makes inputs of outputs, and so of forces: what it does later says nothing of the model."""
    A, B, C, Q = steps()
    rng, x, u, y = np.random.default_rng(9), np.zeros(6), np.empty((1, 3000)), np.empty((3, 3000))
    moves = 0.3 * np.linalg.cholesky(Q + 1e-14 * np.eye(6)) @ rng.standard_normal((6, 3000))
    for t in range(3000):
        y[:, t] = C @ x + 0.05 * rng.standard_normal(3)
        u[0, t] = rng.standard_normal() - 0.2 * y[0, t]
        x = A @ x + B[:, 0] * u[0, t] + moves[:, t]
    result = fit_of((u[:, 500:], y[:, 500:]))
    assert result.order == 3 and not len(result.real_poles) and "FORCES" in causes(result)
    assert not result.delay.any()
    assert np.all(np.abs(result.damping_ratios - ZETA) < 4 * result.stderr["damping_ratios"])


def test_forces_that_are_given_are_refused_where_many_samples_are_missing():
    u, y = record(3, 300, forces=0.3)
    y[1, 100:160] = np.nan
    with pytest.raises(phc.StructureError, match="20 % of the samples of an output are missing, and noise='forces'"):
        fit_of((u, y), noise="forces")


@pytest.mark.parametrize(("share", "outputs", "samples"), [(0.02, 2, 700), *slowly((0.02, 3, 2000), (0.08, 3, 2000))])
def test_samples_are_missing_beside_forces(share, outputs, samples):
    """Scattered samples that are missing take the modes and their errors nowhere."""
    u, y = record(4, samples, forces=0.3)
    y = y[:outputs]
    whole = fit_of((u, y), 3, real_poles=0, **HELD)
    y[np.random.default_rng(4).random(y.shape) < share] = np.nan
    result = fit_of((u, y), **HELD)
    assert result.order == 3 and not len(result.real_poles) and {"FORCES"} <= causes(result) <= {"FORCES", "LOSSES"}
    errors = result.stderr["damping_ratios"]
    assert np.all(np.abs(result.damping_ratios - ZETA) < 3 * errors)
    assert np.all(np.abs(result.damping_ratios - whole.damping_ratios) < errors)
    np.testing.assert_allclose(errors, whole.stderr["damping_ratios"], rtol=0.2)


def test_forces_that_do_nothing_at_frequency_zero_leave_errors_that_hold():
    """Velocities of a structure have next to no noise of forces there, and one force comes to both outputs."""
    step, w, zeta = 0.1, np.array([1.0, 2.2, 3.5]), np.array([0.01, 0.012, 0.02])
    poles, shapes = w * (-zeta + 1j * np.sqrt(1 - zeta**2)), np.array([[0.4, 0.6, 0.7], [0.7, 0.3, -0.6]])
    rng = np.random.default_rng([27, 5])
    forces, y = np.stack([rng.standard_normal(2000), 0.3 * rng.standard_normal(2000)]), np.zeros((2, 2000))
    for pole, shape, drive in zip(poles, shapes.T, np.array([[0.4, 0.6], [0.6, -0.7], [0.7, 0.4]]), strict=True):
        z = np.exp(pole * step)
        y += shape[:, None] * lfilter([0, 1], [1, -z], (z - 1) / pole * (drive @ forces)).real
    y += 0.02 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    result = phc.pem((forces[:1], y), 3, dt=step, real_poles=0, **HELD)
    assert "FORCES" in causes(result)
    assert np.all(np.abs(result.damping_ratios - zeta) < 3 * result.stderr["damping_ratios"])
    assert np.all(result.stderr["damping_ratios"] < 0.01)


def test_a_bootstrap_beside_forces_is_refused(forced):
    with pytest.raises(phc.StructureError, match="forces that nobody measured come through this plant"):
        forced.bootstrap(3)


def test_a_noise_that_is_unknown_is_refused():
    with pytest.raises(phc.StructureError, match="noise is 'wind'; it must be one of 'auto', 'white', 'correlated'"):
        fit_of(record(0, 300), noise="wind")


# --- forces as large as the response to the input --------------------------------------------------------------------


def shaken(seed, *, modes=2, lags=0, inputs=1, outputs=1):
    """Inputs, outputs and the part of these that answers to the inputs, of a plant that a coloured force moves too."""
    rng = np.random.default_rng([seed, 11])
    share, colour, samples = rng.choice([0.2, 0.5, 1.0]), rng.choice([0, 0.5, 0.9]), int(rng.choice([800, 2000]))
    w, zeta = np.sort(rng.uniform(0.15, 1.6, modes)), rng.uniform(0.008, 0.05, modes)
    rates = [rng.uniform(0.02, 0.4) for _ in range(lags)]
    n = 2 * modes + lags
    A = np.zeros((n, n))
    for k, (rate, damping) in enumerate(zip(w, zeta, strict=True)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-damping * rate, rate], [-rate, -damping * rate]]
    for k, rate in enumerate(rates, 2 * modes):
        A[k, k] = -rate
    B, C = rng.standard_normal((n, inputs + 1)), rng.standard_normal((outputs, n))
    held = expm(np.block([[A, B], [np.zeros((inputs + 1, n + inputs + 1))]]))[:n]
    kind = rng.integers(3)
    if kind == 0:
        u = rng.standard_normal((inputs, samples))
    elif kind == 1:
        b, a = butter(2, [0.05, 0.5], "band")
        u = lfilter(b, a, rng.standard_normal((inputs, samples + 300)))[:, 300:]
    else:
        u = np.repeat(rng.choice([-1.0, 1.0], (inputs, samples // 5 + 1)), 5, axis=1)[:, :samples]
    u = u / u.std(axis=1, keepdims=True)
    force = lfilter([1], [1, -colour], rng.standard_normal((1, samples + 300)))[:, 300:]
    parts = []
    for columns, signals in ((held[:, n:-1], u), (held[:, -1:], force)):
        x, y = np.zeros(n), np.zeros((outputs, samples))
        for k, values in enumerate(signals.T):
            y[:, k] = C @ x
            x = held[:, :n] @ x + columns @ values
        parts.append(y / y.std(axis=1, keepdims=True))
    y = parts[0] + share * parts[1] + 0.03 * rng.standard_normal((outputs, samples))
    half = samples // 2
    return tuple(each[:, :half].squeeze() for each in (u, y, parts[0]))


def missed(result, u, clean):
    """Size of what a fit predicts wrongly of the response to the input, over that of the response."""
    predicted = np.reshape(result.predict(u, initial_state="zero", dt=1.0).outputs, clean.shape)
    return np.linalg.norm(predicted - clean) / np.linalg.norm(clean)


@pytest.mark.parametrize(
    ("seed", "plant", "most"),
    [(144, {}, 0.2), *slowly((121, {}, 0.25), (238, {"modes": 1, "lags": 1, "outputs": 2}, 0.5))],
)
def test_forces_are_found_where_white_noise_tells_little_of_the_plant(seed, plant, most):
    u, y, clean = shaken(seed, **plant)
    result = phc.pem((u, y), dt=1.0, **HELD)
    assert causes(result) >= {"FORCES"}
    assert result.order == plant.get("modes", 2)
    assert missed(result, u, clean) < most


@pytest.mark.slow
def test_a_structure_that_is_not_rejected_predicts_as_well_as_free_residues():
    u, y, clean = shaken(24, inputs=2, outputs=2)
    result = phc.pem((u, y), dt=1.0)
    assert missed(result, u, clean) < 0.5


@pytest.mark.parametrize("seed", [222, *slowly(235, 255)])
def test_the_colour_of_a_force_is_neither_a_lag_nor_a_mode_of_the_plant(seed):
    u, y, _ = shaken(seed, modes=1, lags=1, outputs=2)
    result = phc.pem((u, y), dt=1.0)
    assert causes(result) >= {"FORCES"}
    assert (result.order, len(result.time_constants)) == (1, 1)


@pytest.mark.parametrize("seed", [300, 309])
def test_slow_noise_is_no_constant_of_the_output(seed):
    u, y, _ = shaken(seed, modes=0, lags=1)
    level = 30 * y.std()
    for constant in (0.0, level):
        result = phc.pem((u, y + constant), 0, dt=1.0, real_poles=1, **HELD)
        assert ("CONSTANT" in causes(result)) == (constant > 0)
        assert abs(result.offsets[0] - constant) < 5 * result.stderr["offset"][0]


def test_a_drift_does_not_hide_noise_that_outputs_share():
    rng, t = np.random.default_rng(5), np.arange(800.0)
    plant = ct.ss([[-0.02, 1.0], [-1.0, -0.02]], [[0.0], [1.0]], [[0.0, 1.0], [0.4, 0.7]], 0)
    u = rng.standard_normal(800)
    y = ct.forced_response(ct.c2d(plant, 0.5), 0.5 * t, u).outputs
    noise = np.linalg.cholesky([[1.0, 0.9], [0.9, 1.0]]) @ rng.standard_normal((2, 800))
    size = y.std(axis=1, keepdims=True)
    result = phc.pem((u[None], y + size * (0.1 * noise + t / 800)), dt=0.5, quantity="free", **HELD)
    assert result.order == 1 and causes(result) >= {"DRIFT", "CORRELATED_NOISE"}
    covariance = result.noise.covariance
    assert abs(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]) - 0.9) < 0.03


def test_noise_with_nothing_at_frequency_zero_leaves_errors_that_hold():
    u, y, _ = shaken(236, modes=1, lags=1, outputs=2)
    result = phc.pem((u, y), dt=1.0)
    assert (result.order, len(result.time_constants)) == (1, 1)
    assert result.stderr["natural_frequencies"].max() < 0.01


def far_from_the_force(seed, samples=3000):
    """Held force on the first of three masses, and the velocity of the last, which other forces move as much."""
    M, k = np.array([2.0, 2.0, 1.5]), np.array([0.8, 0.6, 0.5])
    K = np.diag(k + np.append(k[1:], 0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-K / M[:, None], -0.02 * K / M[:, None]]])
    system = np.block([[A, np.concatenate([np.zeros((3, 3)), np.diag(1 / M)])], [np.zeros((3, 9))]])
    rng, early, fine, outputs = np.random.default_rng(seed), 1000, 8, []
    u = rng.standard_normal(samples + early)
    others = rng.standard_normal((3, fine * len(u)))
    for often, force in ((1, np.outer([1, 0, 0], u)), (fine, others)):
        step = expm(system / often)
        values, V = np.linalg.eig(step[:6, :6])
        modal = np.linalg.solve(V, step[:6, 6:] @ force)
        states = [lfilter([0, 1], [1, -value], row) for value, row in zip(values, modal, strict=True)]
        outputs.append((V @ np.array(states)).real[5, ::often][early:])
    y, moved = outputs
    y = y + moved * y.std() / moved.std()
    return u[early:], y + 0.05 * y.std() * rng.standard_normal(samples)


@pytest.mark.parametrize("seed", [6, *slowly(5)])
def test_the_hold_is_told_beside_forces_wherever_the_sensor_is(seed):
    # residues are real with the hold that there was; the default takes the sensor to be where the force is
    result = phc.pem(far_from_the_force(seed), dt=1.0)
    assert result.order == 3 and result.intersample == "zoh" and "HOLD" not in causes(result)
    assert np.all(np.abs(result.residues.imag) < 4 * result.stderr["residues"].imag)


def test_forces_are_found_beside_a_few_hits():
    _, _, wind, rng = responses(2, 3000)
    hits = np.zeros(3000)
    hits[50::600], hits[51::600] = 1.0, 0.6
    A, B, C, _ = steps()
    values, V = np.linalg.eig(A)
    modal = np.linalg.solve(V, np.outer(B[:, 0], hits))
    states = [lfilter([0, 1], [1, -value], row) for value, row in zip(values, modal, strict=True)]
    y = (C[:1] @ (V @ np.array(states)).real)[0]
    y = y + 0.5 * wind[0] * y.std() / wind[0].std() + 0.03 * y.std() * rng.standard_normal(3000)
    result = phc.pem((hits, y), dt=1.0, intersample="zoh")
    assert result.order == 3 and "FORCES" in causes(result) and "CHANGING_NOISE" not in causes(result)
    assert np.all(np.abs(result.natural_frequencies - W) < 3 * result.stderr["natural_frequencies"])
    assert np.all(np.abs(result.damping_ratios - ZETA) < 3 * result.stderr["damping_ratios"])


@pytest.mark.slow
def test_poles_that_stand_for_coloured_noise_do_not_grow():
    u, y, _ = shaken(9)
    assert phc.pem((u, y), dt=1.0).poles.real.max() * len(u) < 1.0


def test_the_noise_of_states_of_any_size_is_a_covariance():
    u, y, _ = shaken(149)
    result = phc.pem((u, y), dt=1.0, **HELD)
    assert result.order == 2 and np.all(np.linalg.eigvalsh(result.noise.forces) >= -1e-9 * result.noise.forces.max())

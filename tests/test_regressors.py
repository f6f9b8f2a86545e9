"""The columns of the linear problem and their derivatives, against dense simulation and differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_simulation
from scipy.linalg import expm

import ph_control as phc
from ph_control._units import DERIVATIVES
from ph_control.identification.fit.pem_result import residue_of_unit_weight
from ph_control.identification.regression import time_rows as experiment
from ph_control.identification.regression.free import FreeProjection, GivenResidues
from ph_control.identification.regression.frequency_rows import FreeResponse
from ph_control.identification.regression.spectral_rows import ChannelSpectra, FreeWindow
from ph_control.identification.regression.time_rows import FreeRecord, FreeTimeEvaluation, Modal, Shared, gram
from ph_control.identification.search.free_search import Channels
from ph_control.modal.discretization import Hold

HOLDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]


def blocks_of(p, u, hold):
    """Columns of the motions and of the residues (2, 2n, T), and their derivatives by the poles."""
    n = len(p)
    record = FreeRecord(u[None], u[None], np.ones(len(u), bool), hold)
    rows = np.concatenate(list(record.evaluated(p).blocks()), axis=1)
    columns = np.stack([rows[: 2 * n], rows[2 * n : 4 * n]])
    assert np.array_equal(rows[4 * n], u) and np.array_equal(rows[-1], u)
    return columns, rows[4 * n + 1 : -1].reshape(2, 2 * n, -1)


def columns_of(p, u, hold):
    """Motions, then residues, real parts before imaginary ones, shape (T, 4n)."""
    return np.concatenate(blocks_of(p, u, hold)[0]).T


@pytest.mark.parametrize("method, intersample", HOLDS)
def test_columns_reproduce_a_simulation_with_initial_state(method, intersample):
    rng = np.random.default_rng(2)
    h, d, r, u = 0.05, np.array([0.7, 3.0, 11.0]), np.array([1.0, 0.2, 0.5]), rng.standard_normal(300)
    plant = phc.ph(phc.modes(d, r))
    z0 = rng.standard_normal(6)
    y = phc.forced_response(plant, h * np.arange(300), u, z0, method=method, intersample=intersample).outputs
    # a mode turns as exp(-i d t) in the states of the plant, its conjugate as exp(i d t)
    motion = 0.5 * d * np.sqrt(r) * (z0[:3] - 1j * z0[3:])
    predicted = columns_of(1j * d, u, Hold(h, method, intersample)) @ np.concatenate([
        motion.real, motion.imag, 0.5 * r * d, np.zeros(3)
    ])  # fmt: skip
    assert np.abs(predicted - y).max() <= 4e3 * EPS * np.abs(y).max()


def poles_of(method):
    """Slow, damped and undamped modes, and a real pole, each within what the method can follow."""
    if method == "euler":
        return np.array([1e-3j, -0.02 + 0.3j, -0.1 + 1.0j, -0.4 + 2.0j, -0.7])
    return np.array([1e-3j, -0.02 + 0.3j, -0.5 + 4.0j, 29.0j, -0.7])


@pytest.mark.parametrize("block", [0, 1])
@pytest.mark.parametrize("turn", [1.0, 1j])
@pytest.mark.parametrize("method, intersample", HOLDS)
def test_slopes_are_the_derivatives_of_the_columns(method, intersample, turn, block):
    rng = np.random.default_rng(3)
    u, hold, step, p = rng.standard_normal(250), Hold(0.1, method, intersample), 1e-5, poles_of(method)
    n = len(p)
    (columns, slopes), ahead, behind = (blocks_of(p + s * turn, u, hold) for s in (0.0, step, -step))
    difference = (ahead[0][block] - behind[0][block]) / (2 * step)
    # along the imaginary axis a complex coefficient turns by a quarter
    slope = slopes[block] if turn == 1 else np.concatenate([slopes[block][n:], -slopes[block][:n]])
    # a central difference is right to step^2 |third derivative| / 6 plus rounding / step
    third = (250 * 0.1) ** 3 * np.abs(columns[block]).max()
    allowed = third * step**2 / 6 + 1e3 * EPS * np.abs(slope).max() / step
    assert np.abs(slope - difference).max() <= allowed
    assert np.abs(slope).max() > 1e2 * allowed


@settings(deadline=None, max_examples=15, derandomize=True)
@given(phase=st.floats(1e-6, 1.5), h=st.floats(1e-9, 1e9), method=st.sampled_from(["exact", "midpoint", "euler"]))
def test_frequency_of_a_phase_turns_a_mode_by_that_phase(phase, h, method):
    hold = Hold(h, method)
    d = hold.frequency_of(np.array([phase]))
    assert np.isclose(np.angle(hold.multiplier(1j * d)[0]), phase, rtol=1e-12)


# --- every kind of sensor -------------------------------------------------------------------------------------------


def simulated(p, weight, start, u, h, method, intersample):
    """Outputs `Re(weight x)` of `x' = p x + u` from a state, by dense matrices, sample by sample."""
    A = np.array([[p.real, -p.imag], [p.imag, p.real]])
    C = np.array([[weight.real, -weight.imag]])
    y, _ = dense_simulation(A, np.eye(2)[:, :1], C, u[None], np.array([start.real, start.imag]), h, method, intersample)
    return y[0]


@pytest.mark.parametrize("method, intersample", HOLDS)
def test_columns_are_those_of_a_dense_simulation(method, intersample):
    rng = np.random.default_rng(4)
    samples, h, p = 301, 0.05, np.array([0.7j, -0.05 + 3.0j, -0.4 + 11.0j, -0.3, 0.01 + 0.9j])
    u, nil = rng.standard_normal(samples), np.zeros(samples)
    motions, forced = np.split(columns_of(p, u, Hold(h, method, intersample)), 2, axis=1)
    for l, pole in enumerate(p):
        for part, turn in enumerate([2.0 + 0j, 2j]):
            place = l + part * len(p)
            for column, expected in (
                (motions[:, place], simulated(pole, turn, 1.0 + 0j, nil, h, method, intersample)),
                (forced[:, place], simulated(pole, turn, 0j, u, h, method, intersample)),
            ):
                # of a real pole the imaginary part of a coefficient does nothing
                size = max(np.abs(expected).max(), 1.0 if pole.imag == 0 else 0.0)
                assert np.abs(column - expected).max() <= 10 * samples * EPS * size


@pytest.mark.parametrize("quantity", DERIVATIVES)
@pytest.mark.parametrize("zeta", [0.0, 0.03])
def test_residues_of_unit_weight_give_what_a_sensor_of_every_quantity_measures(zeta, quantity):
    rng = np.random.default_rng(5)
    samples, h, d, power = 301, 0.05, np.array([0.7, 3.0, 11.0]), DERIVATIVES[quantity]
    u = rng.standard_normal(samples)
    # a weight r = 1 is a residue kappa = d: a unit mass that takes d times the input
    expected = np.zeros(samples)
    for frequency in d:
        A = np.array([[0.0, 1.0], [-(frequency**2), -2 * zeta * frequency]])
        C = np.array([[1.0, 0.0], [0.0, 1.0], A[1]])[power]
        y, _ = dense_simulation(A, np.array([[0.0], [frequency]]), C[None], u[None], np.zeros(2), h)
        expected += y[0] + frequency * u * (power == 2)
    residues = residue_of_unit_weight(d, power, zeta)
    p = d * (-zeta + 1j * np.sqrt(1 - zeta**2))
    found = columns_of(p, u, Hold(h))[:, 6:] @ np.concatenate([residues.real, residues.imag]) + d.sum() * u * (
        power == 2
    )
    assert np.abs(found - expected).max() <= 1e3 * samples * EPS * np.abs(expected).max()


# --- blocks ---------------------------------------------------------------------------------------------------------

POLES = np.array([0.2j, -0.02 + 0.9j, -0.3 + 1.4j])


def record_for(samples, offset, moving, driven, missing, method, intersample, seed):
    """A record of two inputs and two outputs of noise."""
    rng = np.random.default_rng(seed)
    observed = np.arange(samples) % 7 != 3 if missing else np.ones(samples, bool)
    u = rng.standard_normal((2, samples)) * driven
    y = np.where(observed, rng.standard_normal((2, samples)), np.nan)
    hold = Hold(0.1, method, intersample)
    return FreeRecord(u, y, observed, hold, moving, int(offset), True, driven, np.arange(2)), rng


@pytest.mark.variants
@pytest.mark.parametrize("method, intersample", HOLDS)
@pytest.mark.parametrize("offset, moving, driven, missing", [
    (False, True, True, False), (True, True, True, True), (False, False, True, True), (True, True, False, False),
])  # fmt: skip
def test_blocks_of_a_long_record_are_those_of_one_piece(
    monkeypatch, method, intersample, offset, moving, driven, missing
):
    samples, n = 1000, len(POLES)
    record, rng = record_for(samples, offset, moving, driven, missing, method, intersample, 6)
    own, shared = rng.standard_normal((record.own_unknowns(n), 2)), rng.standard_normal((2 * (2 * n + 1), 2))

    def rows():
        evaluation = record.evaluated(POLES)
        blocks = list(evaluation.blocks())
        return len(blocks), np.concatenate(blocks, axis=1), evaluation.predict(shared, own)

    whole = rows()
    parts = [blocks_of(POLES, u, record.hold) for u in record.u]
    monkeypatch.setattr(experiment, "_BLOCK", 1)
    monkeypatch.setattr(experiment, "_FEWEST", 3)
    pieces = rows()
    assert whole[0] == 1 and pieces[0] == 11
    for piece, entire in zip(pieces[1:], whole[1:], strict=True):
        size = np.abs(entire).max(axis=-1, keepdims=True)
        assert (np.abs(piece - entire) <= 200 * samples * EPS * size).all()
    # and they are the columns and slopes over the whole record
    expected = [parts[0][0][0]] * moving + [np.ones((1, samples))] * offset
    for (columns, _), u in zip(parts, record.u, strict=True):
        expected += [columns[1], u[None]] * driven
    of_model = np.concatenate(expected)
    expected += [parts[0][1][0]] * moving
    for _, slopes in parts:
        expected += [slopes[1]] * driven
    everything = np.concatenate([*expected, record.y])
    size = np.abs(everything[:, record.observed]).max(axis=1, keepdims=True)
    assert (np.abs(whole[1] - everything[:, record.observed]) <= 1e3 * EPS * size).all()
    weights = np.concatenate([own, shared[: len(shared) * driven]])
    assert np.allclose(whole[2], weights.T @ of_model, rtol=0, atol=1e4 * EPS * np.abs(whole[2]).max())


# --- inner products without columns -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method, intersample", HOLDS)
@pytest.mark.parametrize("offset, moving, driven, samples", [
    (False, True, True, 1000), (True, True, True, 31), (False, False, True, 992), (True, True, False, 1),
    (True, False, True, 993), (False, False, False, 70),
])  # fmt: skip
def test_inner_products_by_groups_are_those_of_the_columns(
    monkeypatch, method, intersample, offset, moving, driven, samples
):
    record, _ = record_for(samples, offset, moving, driven, False, method, intersample, 8)
    evaluation = record.evaluated(POLES)
    assert evaluation.gram() is None
    columns = np.concatenate(list(evaluation.blocks()), axis=1)
    expected = columns @ columns.T
    lengths = np.sqrt(np.diag(expected))
    monkeypatch.setattr(FreeTimeEvaluation, "_by_gram", True)
    for piece in (1, 1 << 19):
        monkeypatch.setattr(experiment, "_BLOCK", piece)
        monkeypatch.setattr(experiment, "_FEWEST", 3)
        found = evaluation.gram()
        assert found.shape == expected.shape
        # sums of that many products, each of some
        allowed = 4 * (samples + 30) * EPS * np.outer(lengths, lengths)
        assert (np.abs(found - expected) <= allowed).all()


def test_inner_products_of_a_record_with_gaps_are_left_to_its_columns():
    samples = experiment._LONG
    u, observed, every = np.ones((1, samples)), np.arange(samples) != 7, np.ones(samples, bool)
    p, hold = np.array([0.3j]), Hold(1.0)
    assert FreeRecord(u, u, observed, hold).evaluated(p).gram() is None
    # two motions, two parts of a residue, what is fed through, a derivative of each but the last, the output
    assert FreeRecord(u, u, every, hold).evaluated(p).gram().shape == (10, 10)
    assert FreeRecord(u[:, 1:], u[:, 1:], every[1:], hold).evaluated(p).gram() is None


def test_parts_that_name_the_same_columns_add_up():
    rng = np.random.default_rng(9)
    V, phi, weights = rng.standard_normal((7, 40)), rng.standard_normal((2, 2, 5)), rng.standard_normal((2, 3, 5))
    columns = np.zeros((3, 40, 5))
    columns[:2] += V[:2, :, None] * phi[0][:, None] + V[2:4, :, None] * phi[1][:, None]
    columns[1:] += np.einsum("jk,ljs->lks", V[4:], weights)
    modal = [Modal(slice(2), slice(2), phi[0]), Modal(slice(2), slice(2, 4), phi[1])]
    found = gram(3, modal, [Shared(slice(1, 3), slice(4, 7), weights)], V @ V.T)
    assert np.allclose(found, np.einsum("iks,jks->ij", columns, columns), rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("noise", [0.1, 1e-6])
def test_a_long_record_gives_the_same_projection_with_and_without_columns(monkeypatch, noise):
    """Also where the output is explained so well that inner products alone would lose digits."""
    samples, p = experiment._LONG + 17, np.array([0.4j, 0.41j, -0.001 + 1.9j])
    rng = np.random.default_rng(10)
    u = rng.standard_normal(samples)
    hold = Hold(1.0)
    y = columns_of(p, u, hold) @ np.array([3.0, -1.0, 0.5, 0.2, 0.1, -3.0, 1.0, 0.5, 2.0, 0.3, -0.2, 0.1])
    y += noise * np.std(y) * rng.standard_normal(samples)
    record = FreeRecord(u[None], y[None], np.ones(samples, bool), hold)

    def projected():
        at = FreeProjection([record], p)
        return at, np.linalg.solve(at.gram, at.gradient)

    fast, fast_step = projected()
    monkeypatch.setattr(experiment, "_LONG", samples + 1)
    slow, slow_step = projected()
    assert np.isclose(fast.loss, slow.loss, rtol=1e-9 if noise > 1e-3 else 1e-6, atol=0)
    # in units of the standard error
    variance = slow.loss / samples
    assert (np.abs(fast.shared - slow.shared) <= 1e-6 * np.sqrt(variance) * slow.shared_errors).all()
    assert (np.abs(fast_step - slow_step) <= 1e-6 * np.sqrt(variance * np.diag(np.linalg.inv(slow.gram)))).all()


@pytest.mark.parametrize("offset", [0, 1])
@pytest.mark.parametrize("samples", [70, experiment._LONG + 5])
def test_a_record_without_modes_has_its_mean_and_output_only(samples, offset):
    y = np.linspace(0.0, 1.0, samples)[None]
    record = FreeRecord(y, y, np.ones(samples, bool), Hold(1.0), offset=offset, through=False)
    here = FreeProjection([record], np.zeros(0, complex))
    assert np.isclose(here.loss, np.sum((y - offset * 0.5) ** 2), rtol=1e-11) and here.gram.shape == (0, 0)


# --- delays ----------------------------------------------------------------------------------------------------------

LATE_POLES = np.array([-0.06 + 1.1j, -0.15 + 4.6j, -1.7 + 0j])
LATE_RESIDUES = np.array([0.4 + 0.3j, -0.2 + 0.5j, 0.6])
LATE_THROUGH, LATE_STEP, LATE_SAMPLES, LATE_BEFORE = 0.4, 0.2, 130, 10


def between(pole, state, value, slope, time):
    """State after some time under an input `value + slope t`, by an exponential of the augmented matrix."""
    A = np.array([[pole, value, slope], [0, 0, 0], [0, 1, 0]], complex)
    return (expm(A * time) @ np.array([state, 1, 0]))[0]


def late_output(u, delay, intersample):
    """Output at `k - delay`, inputs known before and after the record."""
    slopes = np.diff(u) / LATE_STEP if intersample == "foh" else np.zeros(len(u) - 1)
    y = np.zeros(LATE_SAMPLES)
    for pole, residue in zip(LATE_POLES, LATE_RESIDUES, strict=True):
        states = np.zeros(len(u), complex)
        for k in range(len(u) - 1):
            states[k + 1] = between(pole, states[k], u[k], slopes[k], LATE_STEP)
        for k in range(LATE_SAMPLES):
            place = LATE_BEFORE + k - delay
            j = int(np.floor(place))
            seen = between(pole, states[j], u[j], slopes[j], (place - j) * LATE_STEP)
            y[k] += 2 * (residue * seen).real
    for k in range(LATE_SAMPLES):
        place = LATE_BEFORE + k - delay
        j = int(np.floor(place))
        y[k] += LATE_THROUGH * (u[j] + slopes[j] * (place - j) * LATE_STEP)
    return y


def record_of(u, y, intersample):
    inside = u[None, LATE_BEFORE : LATE_BEFORE + LATE_SAMPLES]
    return FreeRecord(inside, y[None], np.ones(LATE_SAMPLES, bool), Hold(LATE_STEP, "exact", intersample))


@pytest.mark.variants
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("delay", [0.35, 1.0, 3.6, -0.45, -1.2])
def test_rows_with_a_delay_are_those_of_the_exact_motion(intersample, delay):
    u = np.random.default_rng(1).standard_normal(LATE_SAMPLES + 2 * LATE_BEFORE)
    y = late_output(u, delay, intersample)
    rows = record_of(u, y, intersample).delayed(delay * LATE_STEP)
    for data in (rows, FreeWindow(spectra := ChannelSpectra.of(rows), np.arange(1, spectra.last + 1))):
        at = FreeProjection([data], LATE_POLES)
        np.testing.assert_allclose(at.residues[:, 0, 0], LATE_RESIDUES, atol=1e-12)
        np.testing.assert_allclose(at.feedthrough, LATE_THROUGH, atol=1e-12)
    predicted = rows.placed(FreeProjection([rows], LATE_POLES).predictions()[0])[0]
    unknown = np.isnan(predicted)
    assert unknown[: int(np.ceil(max(delay, 0)))].all() and unknown.sum() <= np.ceil(abs(delay))
    np.testing.assert_allclose(predicted[~unknown], y[~unknown], atol=1e-12)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_the_derivative_by_the_delay_is_that_of_the_loss(intersample):
    rng = np.random.default_rng(2)
    u = rng.standard_normal(LATE_SAMPLES + 2 * LATE_BEFORE)
    y = late_output(u, 1.3, intersample) + 0.2 * rng.standard_normal(LATE_SAMPLES)
    record = record_of(u, y, intersample).delayed(0.0, 0.0, 3 * LATE_STEP)
    shared = 1.2 * FreeProjection([record.delayed(1.3 * LATE_STEP)], LATE_POLES).shared

    def at(delay):
        return GivenResidues(FreeProjection([record.delayed(delay)], LATE_POLES), shared)

    here, e = at(1.4 * LATE_STEP), 1e-6
    ((_, left, _, _),) = here.sensitivities()
    numerical = (at(1.4 * LATE_STEP + e).loss - at(1.4 * LATE_STEP - e).loss) / (2 * e)
    np.testing.assert_allclose(-2 * left @ here.delay_slopes(0), numerical, rtol=1e-5)


def test_inner_products_of_long_records_are_those_of_the_columns():
    rng = np.random.default_rng(3)
    u, y = rng.standard_normal((2, 20_000)), rng.standard_normal((1, 20_000))
    rows = FreeRecord(u, y, np.ones(20_000, bool), Hold(LATE_STEP, "exact", "foh")).delayed(0.7 * LATE_STEP)
    evaluation = rows.evaluated(LATE_POLES)
    columns = np.concatenate(list(evaluation.blocks()), axis=1)
    expected = columns @ columns.T
    np.testing.assert_allclose(evaluation.gram(), expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_responses_with_a_delay_turn_with_the_frequency(quantity):
    rng, omega, delay = np.random.default_rng(4), np.linspace(0.3, 7.0, 90), 0.6
    s = 1j * omega
    response = sum(r / (s - p) + r.conj() / (s - p.conj()) for r, p in zip(LATE_RESIDUES, LATE_POLES, strict=True))
    response = (response + LATE_THROUGH * (quantity == "acceleration")) * np.exp(-s * delay)
    felt = {"through": quantity == "acceleration"}
    exact = FreeResponse(omega, response[None], np.ones(90), np.ones(90, bool), quantity, **felt)
    at = FreeProjection([exact.delayed(delay)], LATE_POLES)
    np.testing.assert_allclose(at.residues[:, 0, 0], LATE_RESIDUES, atol=1e-10)
    np.testing.assert_allclose(at.predictions()[0][0], response, atol=1e-10)
    noisy = exact.response + 0.1 * (rng.standard_normal(90) + 1j * rng.standard_normal(90))
    rows = FreeResponse(omega, noisy, np.ones(90), np.ones(90, bool), quantity, **felt)
    shared, e = 1.2 * at.shared, 1e-6

    def loss(time):
        return GivenResidues(FreeProjection([rows.delayed(time)], LATE_POLES), shared)

    here = loss(delay)
    ((_, left, _, _),) = here.sensitivities()
    numerical = (loss(delay + e).loss - loss(delay - e).loss) / (2 * e)
    np.testing.assert_allclose(-2 * left @ here.delay_slopes(0), numerical, rtol=1e-5)


def test_windows_with_less_than_a_mode_has_to_explain_are_left_out_and_no_other():
    rng = np.random.default_rng(0)
    t = np.arange(3000.0)
    y = np.exp(-0.002 * t) * np.cos(0.7 * t) + 0.3 * np.cos(1.9 * t) + 0.2 * rng.standard_normal(3000)
    rows = FreeRecord(rng.standard_normal((1, 3000)), y[None], np.ones(3000, bool), Hold(1.0))
    spectrum = ChannelSpectra.of(rows)
    places, residuals = Channels.of(spectrum), np.fft.rfft(y)[None]
    (every, gains), (some, larger) = (places.modes(residuals, least) for least in (0.0, 20.0))
    assert 0 < len(some) < 0.5 * len(every)
    expected = gains >= 20.0
    kept = larger >= 20.0
    np.testing.assert_allclose(some[kept], every[expected])
    np.testing.assert_allclose(larger[kept], gains[expected])


@pytest.mark.parametrize("intersample, late", [("zoh", 0.0), ("foh", 0.0), ("foh", 0.4)])
def test_lags_span_what_a_real_pole_adds_to_the_columns_of_a_window(intersample, late):
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal((2, 400)), rng.standard_normal((1, 400))
    rows = FreeRecord(u, y, np.ones(400, bool), Hold(0.5, intersample=intersample)).delayed(0.5 * late)
    window, rates = FreeWindow.spread(ChannelSpectra.of(rows)), np.array([0.01, 0.3, 2.0])
    for lag, rate in zip(window.lags(rates), rates, strict=True):
        columns = next(window.evaluated(np.array([-rate + 0j])).blocks())
        expected = columns[[0, 2, 5]]  # real parts of the motion and of each input, whose other columns follow
        weights = np.linalg.lstsq(lag.T, expected.T, rcond=None)[0]
        np.testing.assert_allclose(weights.T @ lag, expected, atol=1e-10 * np.abs(expected).max())


def test_weighted_rows_are_those_divided_by_the_level():
    poles = np.array([-0.01 + 1j, -0.03 + 2j])
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal((1, 200)), rng.standard_normal((1, 200))
    observed = rng.random(200) > 0.1
    level = rng.uniform(0.5, 3.0, 200)
    plain = FreeRecord(u, y, observed, Hold(0.3), offset=1)
    weighted = FreeRecord(u, y, observed, Hold(0.3), offset=1, level=level)
    columns = np.concatenate(list(plain.evaluated(poles).blocks()), axis=1) / level[observed]
    R = weighted.evaluated(poles).factor(200)
    np.testing.assert_allclose(R.T @ R, columns @ columns.T, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("offset, moving, driven", [(False, True, True), (True, False, True), (True, True, False)])
def test_poles_by_frequency_fit_the_same_data_as_in_any_order(offset, moving, driven):
    poles = np.append(POLES[[2, 0, 1]], -0.4 + 0j)
    record, _ = record_for(300, offset, moving, driven, True, "exact", "zoh", 9)
    sorted_ = FreeProjection([record], poles).ascending()
    anew = FreeProjection([record], poles[np.argsort(np.abs(poles))])
    assert np.array_equal(sorted_.p, anew.p)
    np.testing.assert_allclose(sorted_.losses, anew.losses, rtol=1e-10)
    for known, other in ((sorted_.shared, anew.shared), (sorted_.own[0], anew.own[0]), (sorted_.gram, anew.gram)):
        np.testing.assert_allclose(known, other, rtol=0, atol=1e-7 * np.abs(other).max(initial=0.0))


@pytest.mark.parametrize("moving", [False, True])
def test_a_record_without_its_delay_is_as_before(moving):
    u = np.where(np.arange(40) < 2, 5.0, 7.0)[None]
    record = FreeRecord(u, 0 * u, np.ones(40, bool), Hold(1.0, "exact", "zoh"), moving=moving)
    again = record.delayed(3.0).delayed(0.0)
    assert again.delay == 0 and np.array_equal(again.u, u)

"""The columns of the linear problem and their derivatives, against dense simulation and differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_simulation
from scipy.linalg import expm

import ph_control as phc
from ph_control.identification.regression import time_rows as experiment
from ph_control.identification.regression.free import FreeProjection, GivenResidues
from ph_control.identification.regression.frequency_rows import FreeResponse
from ph_control.identification.regression.spectral_rows import ChannelSpectra, FreeWindow
from ph_control.identification.regression.time_rows import FreeRecord, Modal, RecordColumns, RecordRows, Shared, gram
from ph_control.identification.regression.variable_projection import Problem
from ph_control.modal.discretization import Hold

HOLDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
BLOCKS = ["forced", "cosine", "sine"]


def columns(d, u, hold, quantity="velocity"):
    """Response of each mode to the input, and its free motions from a unit amplitude and a quarter of a turn ahead."""
    one = RecordRows(u, u, np.ones(len(u), bool), hold, quantity=quantity)
    return one.sensitivities(d, np.zeros(len(d)), np.zeros(len(d), complex))[:, len(d) :]


def block_of(d, u, hold, block, quantity="velocity"):
    """One kind of these columns, shape (T, n)."""
    return np.split(columns(d, u, hold, quantity), 3, axis=1)[BLOCKS.index(block)]


def slope_of(d, u, hold, block, quantity="velocity"):
    """The derivative of each of them by the frequency of its mode."""
    n, place = len(d), BLOCKS.index(block)
    one = RecordRows(u, u, np.ones(len(u), bool), hold, quantity=quantity)
    amplitude = np.full(n, [0, 1, 1j][place])
    return one.sensitivities(d, np.full(n, float(place == 0)), amplitude)[:, :n]


@pytest.mark.parametrize("method, intersample", HOLDS)
def test_columns_reproduce_a_simulation_with_initial_state(method, intersample):
    rng = np.random.default_rng(2)
    h, d, r, u = 0.05, np.array([0.7, 3.0, 11.0]), np.array([1.0, 0.2, 0.5]), rng.standard_normal(300)
    plant = phc.ph(phc.modes(d, r))
    z0 = rng.standard_normal(6)
    y = phc.forced_response(plant, h * np.arange(300), u, z0, method=method, intersample=intersample).outputs
    hold = Hold(h, method, intersample)
    amplitude = d * np.sqrt(r) * (z0[:3] + 1j * z0[3:])
    predicted = columns(d, u, hold) @ np.concatenate([r * d, amplitude.real, amplitude.imag])
    assert np.abs(predicted - y).max() <= 4e3 * np.finfo(float).eps * np.abs(y).max()


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("method, intersample", HOLDS)
def test_slopes_are_the_derivatives_of_the_columns(method, intersample, block):
    rng = np.random.default_rng(3)
    u, hold, step = rng.standard_normal(250), Hold(0.1, method, intersample), 1e-5
    d = np.array([1e-3, 0.3, 4.0, 29.0]) if method != "euler" else np.array([1e-3, 0.3, 1.0, 2.0])
    difference = (block_of(d + step, u, hold, block) - block_of(d - step, u, hold, block)) / (2 * step)
    slope = slope_of(d, u, hold, block)
    # a central difference is right to step^2 |f'''| / 6 plus rounding / step
    third = (250 * 0.1) ** 3 * np.abs(block_of(d, u, hold, block)).max()
    allowed = third * step**2 / 6 + 1e3 * np.finfo(float).eps * np.abs(slope).max() / step
    assert np.abs(slope - difference).max() <= allowed
    assert np.abs(slope).max() > 1e2 * allowed


@settings(deadline=None, max_examples=30, derandomize=True)
@given(phase=st.floats(1e-6, 1.5), h=st.floats(1e-9, 1e9), method=st.sampled_from(["exact", "midpoint", "euler"]))
def test_frequency_of_a_phase_turns_a_mode_by_that_phase(phase, h, method):
    hold = Hold(h, method)
    d = hold.frequency_of(np.array([phase]))
    assert np.isclose(np.angle(hold.multiplier(1j * d)[0]), phase, rtol=1e-12)


# --- every kind of sensor -------------------------------------------------------------------------------------------

QUANTITIES = ["velocity", "displacement", "acceleration"]


def simulated(d, kappa, start, u, h, method, intersample, quantity):
    """Outputs of `x' = -i d x + kappa u` from the states `start`, by dense matrices, sample by sample."""
    n = len(d)
    A = np.block([[np.zeros((n, n)), np.diag(d)], [-np.diag(d), np.zeros((n, n))]])
    B = np.concatenate([kappa, np.zeros(n)])[:, None]
    weight = {"velocity": np.ones(n), "displacement": 1j / d, "acceleration": -1j * d}[quantity] + 0j
    C = np.concatenate([weight.real, -weight.imag])[None]
    y, _ = dense_simulation(A, B, C, u[None], np.concatenate([start.real, start.imag]), h, method, intersample)
    return y[0] + (u * kappa.sum() if quantity == "acceleration" else 0.0)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("method, intersample", HOLDS)
def test_columns_of_every_sensor_are_those_of_a_dense_simulation(method, intersample, quantity):
    rng = np.random.default_rng(4)
    samples, h, d = 301, 0.05, np.array([0.7, 3.0, 11.0])
    u, free = rng.standard_normal(samples), {"velocity": 1, "displacement": 1j / d, "acceleration": -1j * d}[quantity]
    hold = Hold(h, method, intersample)
    for l in range(3):
        one, nil = np.array([1.0 + 0j]), np.zeros(samples)
        # a free motion is named by what it shows at the output
        start = one / np.broadcast_to(free, 3)[l]
        expected = {
            "forced": simulated(d[[l]], np.ones(1), 0 * one, u, h, method, intersample, quantity),
            "cosine": simulated(d[[l]], np.zeros(1), start, nil, h, method, intersample, quantity),
            "sine": simulated(d[[l]], np.zeros(1), 1j * start, nil, h, method, intersample, quantity),
        }
        for block in BLOCKS:
            column = block_of(d, u, hold, block, quantity)[:, l]
            size = np.abs(expected[block]).max()
            assert np.abs(column - expected[block]).max() <= 10 * samples * EPS * size, block


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("method, intersample", HOLDS)
def test_slopes_of_every_sensor_are_the_derivatives_of_its_columns(method, intersample, quantity):
    rng = np.random.default_rng(5)
    u, hold, step = rng.standard_normal(130), Hold(0.1, method, intersample), 1e-5
    d = np.array([0.05, 0.3, 1.0, 2.0])
    for block in BLOCKS:
        ahead, here, behind = (block_of(d + s, u, hold, block, quantity) for s in (step, 0.0, -step))
        slope = slope_of(d, u, hold, block, quantity)
        # relative changes of the frequency, and of the weights 1/d of a displacement, bound the third derivative
        reach = 13.0 + 3 / d
        allowed = step**2 * reach**3 * np.abs(here).max(axis=0) + 1e3 * EPS * np.abs(here).max(axis=0) / step
        assert (np.abs(slope - (ahead - behind) / (2 * step)).max(axis=0) <= allowed).all(), block
        assert np.abs(slope).max() > 1e3 * allowed.min()


# --- blocks ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("method, intersample", HOLDS)
@pytest.mark.parametrize("offset, from_rest, driven, missing", [
    (False, False, True, False), (True, False, True, True), (False, True, True, True), (True, False, False, False),
])  # fmt: skip
def test_blocks_of_a_long_record_are_those_of_one_piece(
    monkeypatch, method, intersample, quantity, offset, from_rest, driven, missing
):
    rng = np.random.default_rng(6)
    samples, d = 1000, np.array([0.2, 0.9, 1.4])
    observed = np.arange(samples) % 7 != 3 if missing else np.ones(samples, bool)
    u = rng.standard_normal(samples) if driven else np.zeros(samples)
    y = np.where(observed, rng.standard_normal(samples), np.nan)
    one = RecordRows(u, y, observed, Hold(0.1, method, intersample), from_rest, offset, quantity, driven)
    kappa, own = rng.random(3), rng.standard_normal(one.own_unknowns(3))

    def rows():
        at = one.at(d)
        blocks, sensitive = list(at.blocks()), list(at.sensitive_blocks(kappa, own))
        assert len(blocks) == len(sensitive)
        return len(blocks), np.concatenate(blocks, axis=1), np.concatenate(sensitive, axis=1), at.predict(kappa, own)

    whole = rows()
    F, cos, sin = (block_of(d, u, one.hold, block, quantity)[observed].T for block in BLOCKS)
    slopes = [slope_of(d, u, one.hold, block, quantity)[observed].T for block in BLOCKS]
    monkeypatch.setattr(experiment, "_BLOCK", 1)
    monkeypatch.setattr(experiment, "_FEWEST", 3)
    pieces = rows()
    assert whole[0] == 1 and pieces[0] == 11
    for piece, entire in zip(pieces[1:], whole[1:], strict=True):
        size = np.abs(entire).max(axis=-1, keepdims=True)
        assert (np.abs(piece - entire) <= 200 * samples * EPS * size).all()
    # and they are the columns and slopes over the whole record
    expected = [] if from_rest else [cos, sin]
    expected += [np.ones((1, int(observed.sum())))] * offset + [F] * driven + [y[None, observed]]
    assert np.allclose(whole[1], np.concatenate(expected), rtol=0, atol=1e3 * EPS * np.abs(F).max() + 1e3 * EPS)
    moving = (np.zeros(3), np.zeros(3)) if from_rest else (own[:3], own[3:6])
    by_d = sum(c[:, None] * slope for c, slope in zip((kappa * driven, *moving), slopes, strict=True))
    assert np.allclose(whole[2][-4:-1], by_d, rtol=0, atol=1e4 * EPS * np.abs(by_d).max())


# --- inner products without columns -----------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("method, intersample", HOLDS)
@pytest.mark.parametrize("offset, from_rest, driven, samples", [
    (False, False, True, 1000), (True, False, True, 31), (False, True, True, 992), (True, False, False, 1),
    (True, True, True, 993), (False, True, False, 70),
])  # fmt: skip
def test_inner_products_by_groups_are_those_of_the_columns(
    monkeypatch, method, intersample, quantity, offset, from_rest, driven, samples
):
    rng = np.random.default_rng(8)
    u, y = rng.standard_normal((2, samples)) * ((driven,), (1,))
    hold, d = Hold(0.1, method, intersample), np.array([0.2, 0.9, 1.4])
    at = RecordRows(u, y, np.ones(samples, bool), hold, from_rest, offset, quantity, driven).at(d)
    own = rng.standard_normal(2 * 3 * (not from_rest) + offset)
    # a residue of nothing leaves a column of nothing, where there is no free motion either
    kappa = np.array([0.5, 0.0, 2.0])
    assert at.gram() is None and at.sensitive_gram(kappa, own) is None
    columns = np.concatenate(list(at.blocks()), axis=1), np.concatenate(list(at.sensitive_blocks(kappa, own)), axis=1)
    monkeypatch.setattr(RecordColumns, "_by_gram", True)
    for piece in (1, 1 << 19):
        monkeypatch.setattr(experiment, "_BLOCK", piece)
        monkeypatch.setattr(experiment, "_FEWEST", 3)
        for found, whole in zip((at.gram(), at.sensitive_gram(kappa, own)), columns, strict=True):
            expected = whole @ whole.T
            lengths = np.sqrt(np.diag(expected))
            assert found.shape == expected.shape
            # sums of that many products, each of some
            allowed = 4 * (samples + 30) * EPS * np.outer(lengths, lengths)
            assert (np.abs(found - expected) <= allowed).all()


def test_inner_products_of_a_record_with_gaps_are_left_to_its_columns():
    samples = experiment._LONG
    u, observed = np.ones(samples), np.arange(samples) != 7
    d, hold = np.array([0.3]), Hold(1.0)
    assert RecordRows(u, u, observed, hold).at(d).gram() is None
    assert RecordRows(u, u, np.ones(samples, bool), hold).at(d).gram().shape == (4, 4)
    assert RecordRows(u[1:], u[1:], np.ones(samples - 1, bool), hold).at(d).gram() is None


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
    samples, d = experiment._LONG + 17, np.array([0.4, 0.41, 1.9])
    rng = np.random.default_rng(10)
    u = rng.standard_normal(samples)
    hold = Hold(1.0)
    y = columns(d, u, hold) @ np.array([1.0, 0.5, 2.0, 3.0, -1.0, 0.5, 0.2, 0.1, -3.0])
    y += noise * np.std(y) * rng.standard_normal(samples)
    problem = Problem((RecordRows(u, y, np.ones(samples, bool), hold),))
    fast, slow = problem.project(d), problem.project(d)
    fast_step = np.linalg.solve(fast.gram, fast.gradient)
    monkeypatch.setattr(experiment, "_LONG", samples + 1)
    slow_step = np.linalg.solve(slow.gram, slow.gradient)
    assert np.isclose(fast.loss, slow.loss, rtol=1e-9 if noise > 1e-3 else 1e-6, atol=0)
    assert np.allclose(fast.kappa, slow.kappa, rtol=1e-11)
    # steps in units of the standard error
    error = np.sqrt(fast.loss / samples * np.diag(np.linalg.inv(fast.gram)))
    assert (np.abs(fast_step - slow_step) <= 1e-6 * error).all()


@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("samples", [70, experiment._LONG + 5])
def test_a_record_without_modes_has_its_mean_and_output_only(samples, offset):
    y, one = np.linspace(0.0, 1.0, samples), np.ones(samples, bool)
    here = Problem((RecordRows(y, y, one, Hold(1.0), offset=offset),)).project(np.zeros(0))
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
    evaluation = rows.at(LATE_POLES)
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

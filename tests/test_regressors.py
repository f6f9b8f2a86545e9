"""The columns of the linear problem and their derivatives, against dense simulation and differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_simulation

import ph_control as phc
from ph_control.identification import experiment
from ph_control.identification.experiment import Experiment
from ph_control.identification.regressors import Hold, regressors

HOLDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
BLOCKS = ["forced", "cosine", "sine"]


@pytest.mark.parametrize("method, intersample", HOLDS)
def test_columns_reproduce_a_simulation_with_initial_state(method, intersample):
    rng = np.random.default_rng(2)
    h, d, r, u = 0.05, np.array([0.7, 3.0, 11.0]), np.array([1.0, 0.2, 0.5]), rng.standard_normal(300)
    plant = phc.ph(phc.modes(d, r))
    z0 = rng.standard_normal(6)
    y = phc.forced_response(plant, h * np.arange(300), u, z0, method=method, intersample=intersample).outputs
    hold = Hold(h, method, intersample)
    amplitude = d * np.sqrt(r) * (z0[:3] + 1j * z0[3:])
    predicted = regressors(d, u, hold).columns() @ np.concatenate([r * d, amplitude.real, amplitude.imag])
    assert np.abs(predicted - y).max() <= 4e3 * np.finfo(float).eps * np.abs(y).max()


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("method, intersample", HOLDS)
def test_slopes_are_the_derivatives_of_the_columns(method, intersample, block):
    rng = np.random.default_rng(3)
    u, hold, step = rng.standard_normal(250), Hold(0.1, method, intersample), 1e-5
    d = np.array([1e-3, 0.3, 4.0, 29.0]) if method != "euler" else np.array([1e-3, 0.3, 1.0, 2.0])
    difference = (getattr(regressors(d + step, u, hold), block) - getattr(regressors(d - step, u, hold), block)) / (
        2 * step
    )
    slope = getattr(regressors(d, u, hold), block + "_slope")
    # a central difference is right to step^2 |f'''| / 6 plus rounding / step
    third = (250 * 0.1) ** 3 * np.abs(getattr(regressors(d, u, hold), block)).max()
    allowed = third * step**2 / 6 + 1e3 * np.finfo(float).eps * np.abs(slope).max() / step
    assert np.abs(slope - difference).max() <= allowed
    assert np.abs(slope).max() > 1e2 * allowed


@settings(deadline=None, max_examples=30, derandomize=True)
@given(phase=st.floats(1e-6, 1.5), h=st.floats(1e-9, 1e9), method=st.sampled_from(["exact", "midpoint", "euler"]))
def test_frequency_of_a_phase_turns_a_mode_by_that_phase(phase, h, method):
    hold = Hold(h, method)
    d = hold.frequency_of(np.array([phase]))
    assert np.isclose(-np.angle(hold.step(d).multiplier[0]), phase, rtol=1e-12)


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
    found = regressors(d, u, Hold(h, method, intersample), quantity)
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
            column = getattr(found, block)[:, l]
            size = np.abs(expected[block]).max()
            assert np.abs(column - expected[block]).max() <= 10 * samples * EPS * size, block


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("method, intersample", HOLDS)
def test_slopes_of_every_sensor_are_the_derivatives_of_its_columns(method, intersample, quantity):
    rng = np.random.default_rng(5)
    u, hold, step = rng.standard_normal(130), Hold(0.1, method, intersample), 1e-5
    d = np.array([0.05, 0.3, 1.0, 2.0])
    for block in BLOCKS:
        ahead, here, behind = (getattr(regressors(d + s, u, hold, quantity), block) for s in (step, 0.0, -step))
        slope = getattr(regressors(d, u, hold, quantity), block + "_slope")
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
    one = Experiment(u, y, observed, Hold(0.1, method, intersample), from_rest, offset, quantity, driven)
    kappa, own = rng.random(3), rng.standard_normal(one.own_unknowns(3))

    def rows():
        at = one.at(d)
        blocks, sensitive = list(at.blocks()), list(at.sensitive_blocks(kappa, own))
        assert len(blocks) == len(sensitive)
        return len(blocks), np.concatenate(blocks, axis=1), np.concatenate(sensitive, axis=1), at.predict(kappa, own)

    whole = rows()
    monkeypatch.setattr(experiment, "_BLOCK", 1)
    monkeypatch.setattr(experiment, "_FEWEST", 3)
    pieces = rows()
    assert whole[0] == 1 and pieces[0] == 11
    for piece, entire in zip(pieces[1:], whole[1:], strict=True):
        size = np.abs(entire).max(axis=-1, keepdims=True)
        assert (np.abs(piece - entire) <= 200 * samples * EPS * size).all()
    # and they are the columns and slopes over the whole record
    found = regressors(d, u, one.hold, quantity)
    F, cos, sin = (getattr(found, block)[observed].T for block in BLOCKS)
    expected = [] if from_rest else [cos, sin]
    expected += [np.ones((1, int(observed.sum())))] * offset + [F] * driven + [y[None, observed]]
    assert np.allclose(whole[1], np.concatenate(expected), rtol=0, atol=1e3 * EPS * np.abs(F).max() + 1e3 * EPS)
    slopes = [getattr(found, block + "_slope")[observed].T for block in BLOCKS]
    moving = (np.zeros(3), np.zeros(3)) if from_rest else (own[:3], own[3:6])
    by_d = sum(c[:, None] * slope for c, slope in zip((kappa * driven, *moving), slopes, strict=True))
    assert np.allclose(whole[2][-4:-1], by_d, rtol=0, atol=1e4 * EPS * np.abs(by_d).max())

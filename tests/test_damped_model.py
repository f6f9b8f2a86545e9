"""Damped plants: the lossless model of them is a minimum of its own, and rejected; errors of the damped one hold."""

from __future__ import annotations

from functools import partial

import control as ct
import numpy as np
import pytest
from known import KNOWN
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

import ph_control as phc

lossless_fit = partial(phc.pem, structure="lossless")

H = 0.1
D, RATIOS, WEIGHTS = np.array([0.5, 1.9, 2.6]), np.array([0.01, 0.005, 0.02]), np.array([1.0, -0.5, 0.7])
NUMERATORS = {"velocity": [1.0, 0.0], "displacement": [1.0], "acceleration": [1.0, 0.0, 0.0]}


def recorded(u, ratios, weights, *, noise=0.1, seed=0, quantity="velocity", d=D, h=H):
    """Output of second-order transfer functions under a held input, sampled by python-control, and white noise."""
    rng, y = np.random.default_rng(seed), np.zeros(len(u))
    for frequency, ratio, weight in zip(d, ratios, weights, strict=True):
        plant = ct.c2d(weight * ct.tf(NUMERATORS[quantity], [1, 2 * ratio * frequency, frequency**2]), h, "zoh")
        denominator = plant.den_array[0, 0]
        numerator = np.concatenate([np.zeros(len(denominator)), plant.num_array[0, 0]])[-len(denominator) :]
        y += lfilter(numerator, denominator, u)
    return y + noise * np.std(y) * rng.standard_normal(len(u))


def white(samples, seed=0):
    return np.random.default_rng([seed, 1]).standard_normal(samples)


def hammer(seed=0, *, samples=20_000, noise=0.01, d=(120.0, 310.0, 540.0), ratios=(0.005, 0.012, 0.02)):
    """Half-sine pulse of 0.8 ms and an accelerometer away from it, at 20 kHz."""
    h, d = 5e-5, 2 * np.pi * np.array(d)
    t = h * np.arange(samples)
    u = np.where((t >= 0.01) & (t <= 0.0108), 100 * np.sin(np.pi * (t - 0.01) / 8e-4), 0.0)
    y = recorded(u, ratios, (1.0, -0.6, 0.8), noise=noise, seed=seed, quantity="acceleration", d=d, h=h)
    return u, y, h


# --- a minimum of its own ------------------------------------------------------------------------------------------


def lossless_loss(u, y, d, intersample):
    """Mean square of what the best lossless modes at these frequencies leave, their columns simulated one by one."""
    t = H * np.arange(len(u))
    forced = [phc.forced_response(phc.ph(phc.modes(w, 1 / w)), t, u, intersample=intersample).outputs for w in d]
    columns = np.column_stack([*forced, np.cos(np.outer(t, d)), np.sin(np.outer(t, d))])
    found = lsq_linear(columns, y, (np.repeat([0.0, -np.inf], [len(d), 2 * len(d)]), np.inf), method="bvls")
    return float(np.mean((y - columns @ found.x) ** 2))


@pytest.mark.variants
@pytest.mark.parametrize("order, seed", [(3, 0), ("auto", 1)])
def test_a_fit_to_damped_data_is_a_minimum_of_the_lossless_problem(order, seed):
    u = white(1000, seed)
    y = recorded(u, [0.004] * 3, WEIGHTS, seed=seed, noise=0.05)
    result = lossless_fit((u, y), order, dt=H, offset=False)
    own = lossless_loss(u, y, result.d, result.intersample)
    assert result.success and own == pytest.approx(np.mean((y - result.predicted) ** 2), rel=1e-8)
    for l in range(result.order):
        for step in (3e-4, 1e-5, -1e-5, -3e-4):
            moved = result.d + step * (np.arange(result.order) == l)
            assert lossless_loss(u, y, moved, result.intersample) > own * (1 - 1e-9)


# --- what it holds -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_parameters_lie_within_their_standard_errors():
    scores = []
    for seed in range(5):
        u = white(1000, seed)
        model = phc.pem((u, recorded(u, RATIOS, WEIGHTS, seed=seed)), 3, dt=H, structure="free")
        poles = D * (-RATIOS + 1j * np.sqrt(1 - RATIOS**2))
        truth = WEIGHTS * poles / (2j * poles.imag)
        residues, errors = model.residues[:, 0, 0] - truth, model.stderr["residues"][:, 0, 0]
        scores += [
            (model.natural_frequencies - D) / model.stderr["natural_frequencies"],
            (model.damping_ratios - RATIOS) / model.stderr["damping_ratios"],
            residues.real / errors.real,
            residues.imag / errors.imag,
        ]
        assert model.feedthrough == 0.0
    assert np.abs(scores).max() < 4.5
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.25


@pytest.mark.variants
@pytest.mark.parametrize("taken, said", [("velocity", "velocity"), ("acceleration", "velocity"),
                                         ("displacement", "acceleration")])  # fmt: skip
def test_it_survives_a_wrong_quantity_and_its_system_predicts_the_record(taken, said):
    u = white(1000)
    y = recorded(u, RATIOS, WEIGHTS, quantity=taken, noise=0.02)
    model = phc.pem((u, y), dt=H, quantity=said, intersample="zoh")
    assert np.allclose(model.natural_frequencies, D, rtol=2e-3)
    assert np.allclose(model.damping_ratios, RATIOS, rtol=0.1)
    assert model.fit_percent > 97
    sampled = ct.c2d(model.observed_system, H, "zoh")
    again = ct.forced_response(sampled, H * np.arange(len(u)), u, model.initial_state).outputs + model.offsets[0]
    assert np.allclose(again, model.predicted, atol=1e-6 * np.abs(y).max())


def test_records_with_gaps_offsets_and_rest_share_one_model():
    u, v = white(1000), white(800, 1)
    first = recorded(u, RATIOS, WEIGHTS) + 3.0
    second = recorded(v, RATIOS, WEIGHTS, seed=1) - 2.0
    first[np.random.default_rng(0).random(1000) < 0.1] = np.nan
    model = phc.pem([(u, first), (v, second)], 3, dt=H, offset=True, initial_state="zero", **KNOWN)
    assert np.allclose(model.offsets, [3, -2], atol=0.05) and len(model.experiments) == 2
    assert not any(np.any(one.free_amplitudes) for one in model.experiments)
    assert np.all(np.abs(model.damping_ratios - RATIOS) < 4 * model.stderr["damping_ratios"])


def test_a_lossless_record_is_not_rejected():
    u = white(1000)
    result = lossless_fit((u, recorded(u, [0, 0, 0], np.abs(WEIGHTS))), dt=H)
    assert result.tests[0].p > 1e-3 and result.outcome.name == "CONSISTENT"


# --- the test of the lossless model --------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_lossless_model_is_refused_by_chance_as_often_as_it_should():
    found = []
    for seed in range(30):
        u = white(300, seed)
        found.append(
            lossless_fit((u, recorded(u, [0, 0], [1.0, 0.6], d=D[:2], h=1.0, seed=seed)), 2, dt=1.0, **KNOWN).tests[0]
        )
    p = np.array([one.p for one in found])
    assert {one.dof for one in found} == {4}
    assert np.mean(p < 0.05) < 0.15 and p.min() > 1e-4
    assert 0.3 < np.mean(p) < 0.7
    assert 2.5 < np.mean([one.likelihood_ratio for one in found]) < 5.5


@pytest.mark.slow
def test_damping_that_leaves_residuals_white_is_not_consistent():
    told = 0
    for seed in range(2):
        u = white(2000, seed)
        y = recorded(u, [1e-4] * 3, np.abs(WEIGHTS), d=[0.5, 1.3, 2.2], h=1.0, noise=0.05, seed=seed)
        result = lossless_fit((u, y), 3, dt=1.0)
        (test,) = result.tests
        told += test.p < 1e-3
        assert (test.p < 1e-3) == (result.outcome.name != "CONSISTENT")
    assert told == 2


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["displacement", "acceleration"])
@pytest.mark.parametrize("options", [{}, {"initial_state": "zero"}])
def test_other_quantities_and_rest_are_judged_alike(quantity, options):
    p = []
    for seed in range(8):
        u = white(400, seed)
        y = recorded(u, [0, 0], [1.0, 0.6], d=D[:2], h=1.0, seed=seed, quantity=quantity)
        p.append(lossless_fit((u, y), 2, dt=1.0, quantity=quantity, **options).tests[0].p)
    assert np.sum(np.array(p) < 0.05) <= 2 and np.mean(p) > 0.25


# --- the search ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("said", ["velocity", "acceleration"])
def test_a_hammer_test_ends_with_its_damped_modes(said):
    u, y, h = hammer()
    model = phc.pem((u, y), dt=h, quantity=said)
    assert model.order == 3 and len(model.order_table) < 9
    assert np.allclose(model.damping_ratios, [0.005, 0.012, 0.02], rtol=0.01)
    assert np.all(np.abs(model.damping_ratios - [0.005, 0.012, 0.02]) < 4.5 * model.stderr["damping_ratios"])
    assert np.allclose(model.hertz, [120, 310, 540], rtol=1e-4)


def test_modes_without_damping_that_stand_close_together_are_not_taken_for_one_with():
    d = np.array([0.5, 0.5 + 2 * 2 * np.pi / 2000, 1.4])
    u = white(2000)
    result = phc.pem((u, recorded(u, [0, 0, 0], [1.0, 0.8, 0.7], d=d, h=1.0, noise=0.03)), dt=1.0)
    assert result.order == 3 and result.structure == "lossless" and np.allclose(result.d, d, rtol=1e-3)

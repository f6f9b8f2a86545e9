"""Comparison of models, analysis of residuals and choice of the order, held against slow references and chance."""

import warnings

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom, kstest, norm

import ph_control as phc
from ph_control import StructureError, compare, order_selection, residual_analysis

EPS = np.finfo(float).eps
STEP = 0.1
quick = settings(deadline=None, max_examples=10, derandomize=True)


def plant(name="plant"):
    return phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]), name=name)


def recording(samples=400, noise=0.01, seed=0, system=None, z0=None, missing=0.0):
    """Input and output under a white input, with white noise of a deviation relative to the output."""
    rng = np.random.default_rng(seed)
    system = plant() if system is None else system
    u = rng.standard_normal(samples)
    start = rng.standard_normal(system.nstates) if z0 is None else z0
    y = np.array(
        phc.forced_response(system, STEP * np.arange(samples), u, start, return_states=False, intersample="zoh").outputs
    )
    y += noise * np.std(y) * rng.standard_normal(samples)
    y[rng.random(samples) < missing] = np.nan
    return u, y


def dense_output(A, B, C, D, u, x0):
    """Recursion of a sampled system, sample by sample."""
    x, y = np.array(x0, float), []
    for value in u:
        y.append(float(C @ x + D * value))
        x = A @ x + B * value
    return np.array(y)


def fit_of(y, predicted):
    seen = ~np.isnan(y)
    return 100 * (1 - np.linalg.norm((y - predicted)[seen]) / np.linalg.norm(y[seen] - y[seen].mean()))


def damped_plant(name="damped"):
    """A modal model of python-control: the plant with damping."""
    sys = plant()
    return ct.ss(sys.A - 0.05 * np.eye(4), sys.B, sys.C, 0, name=name)


# --- comparison ------------------------------------------------------------------------------------------------------


def test_a_damped_model_of_python_control_is_simulated_with_the_initial_state_that_fits_best():
    u, y = recording(noise=0.1)
    damped = damped_plant()
    sampled = ct.c2d(damped, STEP)
    matrices = sampled.A, sampled.B[:, 0], sampled.C[0], 0.0
    forced = dense_output(*matrices, u, np.zeros(4))
    free = np.array([dense_output(*matrices, 0 * u, state) for state in np.eye(4)]).T
    expected = forced + free @ np.linalg.lstsq(free, y - forced)[0]
    found = compare((u, y), damped, dt=STEP)
    np.testing.assert_allclose(found.predicted[0], expected, atol=1e4 * EPS * np.abs(y).max())
    assert found.fit_percent[0] == pytest.approx(fit_of(y, expected), abs=1e-9)
    assert found.rms_error[0] == pytest.approx(np.sqrt(np.mean((y - expected) ** 2)), rel=1e-9)
    assert found.fit_percent[0] < 95 < compare((u, y), plant(), dt=STEP).fit_percent[0] + 10


RULES = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]


@pytest.mark.parametrize("initial_state", ["zero", "estimate"])
@pytest.mark.parametrize("method, intersample", RULES)
def test_every_form_of_one_system_gives_one_output(method, intersample, initial_state):
    u, y = recording(noise=0.1, samples=300)
    sys = plant()
    sampled = phc.sample(sys, STEP, method, intersample=intersample)
    forms = [sys, sys.modes, phc.ch(sys), phc.oh(sys), ct.ss(sys), phc.tf(sys)]
    # the state of a system sampled with an interpolated input is not the one from rest
    forms += [sampled] * (intersample == "zoh" or initial_state == "estimate")
    options = {"dt": STEP, "method": method, "intersample": intersample, "initial_state": initial_state}
    found = compare((u, y), *forms, **options).predicted
    if initial_state == "zero":
        expected = phc.forced_response(sys, STEP * np.arange(300), u, method=method, intersample=intersample).outputs
        np.testing.assert_allclose(found[0], expected, atol=100 * EPS * np.abs(expected).max())
    # coefficients of a transfer function carry fewer digits than modes
    np.testing.assert_allclose(found, found[:1].repeat(len(forms), axis=0), atol=1e6 * EPS * np.abs(y).max())


def test_the_fit_of_a_result_on_its_own_record_is_that_of_the_fit_and_is_marked():
    data = recording(noise=0.1, missing=0.1)
    result = phc.pem(data, order=2, dt=STEP)
    found = compare(data, result, result.system)
    assert found.own_record == (True, False)
    assert found.fit_percent[0] == pytest.approx(result.fit_percent, abs=1e-9)
    # the same system without its history: its initial state is estimated anew, and comes out the same
    assert found.fit_percent[1] == pytest.approx(result.fit_percent, abs=1e-6)
    assert str(found).count("fitted to this record") == 1
    fresh = recording(noise=0.1, seed=1)
    assert compare(fresh, result).own_record == (False,)


@pytest.mark.parametrize("initial_state", ["estimate", "zero", "fitted"])
def test_a_result_on_another_record_predicts_with_the_initial_state_asked_for(initial_state):
    result = phc.pem(recording(noise=0.1), order=2, dt=STEP)
    u, y = recording(noise=0.1, seed=1, samples=300)
    expected = result.predict((u, y), initial_state=initial_state).outputs
    found = compare((u, y), result, initial_state=initial_state)
    np.testing.assert_allclose(found.predicted[0], expected, atol=100 * EPS * np.abs(y).max())
    assert found.fit_percent[0] == pytest.approx(fit_of(y, expected), abs=1e-9)


def test_a_fit_from_rest_is_its_own_only_from_rest():
    u, y = recording(noise=0.1, z0=np.zeros(4))
    result = phc.pem((u, y), order=2, dt=STEP, initial_state="zero")
    rest, free = (compare((u, y), result, initial_state=state) for state in ("zero", "estimate"))
    np.testing.assert_array_equal(rest.predicted[0], result.predicted)
    assert free.fit_percent[0] > rest.fit_percent[0]
    assert free.own_record == rest.own_record == (True,)


def test_missing_outputs_count_nowhere():
    u, y = recording(noise=0.1, missing=0.3)
    filled = np.where(np.isnan(y), 0.0, y)
    found = compare((u, y), plant(), damped_plant(), dt=STEP)
    seen = ~np.isnan(y)
    for fit, predicted in zip(found.fit_percent, found.predicted, strict=True):
        assert fit == pytest.approx(fit_of(y, predicted), abs=1e-9)
    assert np.isfinite(found.predicted).all()
    assert f"400 samples, {int((~seen).sum())} missing" in str(found)
    assert compare((u, filled), plant(), dt=STEP).fit_percent[0] < found.fit_percent[0]


@quick
@given(st.integers(-60, 60), st.integers(-60, 60), st.integers(-30, 30))
def test_units_of_time_input_and_output_change_no_percentage(input_exponent, output_exponent, time_exponent):
    a, b, c = 2.0**input_exponent, 2.0**output_exponent, 2.0**time_exponent
    u, y = recording(noise=0.1, samples=120)
    base = ct.tf([1.0, 0.2], [1.0, 0.1, 4.0])
    scaled = ct.ss(ct.ss(base).A / c, ct.ss(base).B / c, ct.ss(base).C * b / a, 0.0)
    reference = compare((u, y), ct.ss(base), dt=STEP)
    found = compare((a * u, b * y), scaled, dt=c * STEP)
    np.testing.assert_allclose(found.fit_percent, reference.fit_percent, atol=1e5 * EPS * 100)
    one = residual_analysis((u, y), ct.ss(base), dt=STEP)
    other = residual_analysis((a * u, b * y), scaled, dt=c * STEP)
    np.testing.assert_allclose(other.cross_correlation, one.cross_correlation, atol=1e6 * EPS)
    assert other.response_p_value == pytest.approx(one.response_p_value, rel=1e-6)
    assert other.verdict == one.verdict


def test_poles_at_the_origin_leave_a_constant_and_for_displacements_a_drift():
    t = STEP * np.arange(300)
    u = np.random.default_rng(3).standard_normal(300)
    free = phc.ph(
        np.diag([0.0, 0.0, 4.0, 1.0])[np.ix_([0, 2, 1, 3], [0, 2, 1, 3])] + np.diag([0, 0, 1.0, 0]), [0, 0, 1, 1]
    )
    y = phc.forced_response(free, t, u, intersample="zoh").outputs
    assert len(free.modes.rigid) == 1
    assert compare((u, y + 5.0), free, dt=STEP).fit_percent[0] == pytest.approx(100.0, abs=1e-9)
    spring = phc.affine(free.Q, [1.0, 1.0, 0.0, 0.0])
    y = phc.forced_response(spring, t, u, intersample="zoh").outputs
    assert len(spring.modes.rigid) == 1
    assert compare((u, y + 5.0 - 3.0 * t), spring, dt=STEP).fit_percent[0] == pytest.approx(100.0, abs=1e-8)


def test_the_observable_form_shows_modes_without_weight_and_growing_motions_of_repeated_frequencies():
    k = np.arange(300)
    u = np.random.default_rng(3).standard_normal(300)
    for sys, motion in (
        (phc.oh([1.0, 2.0], [1.0, 0.0, 0.0, 0.0]), np.cos(2.0 * STEP * k)),
        (phc.oh([1.0, 1.0], [1.0, 0.0, 0.0, 0.0]), STEP * k * np.cos(STEP * k)),
    ):
        y = phc.forced_response(sys, STEP * k, u, intersample="zoh").outputs + motion
        assert compare((u, y), sys, dt=STEP).fit_percent[0] == pytest.approx(100.0, abs=1e-8)
        assert compare((u, y), phc.ph(sys), dt=STEP).fit_percent[0] < 99.0


def test_a_static_gain_and_a_model_without_modes_are_models_too():
    u, y = recording(noise=0.1)
    silent = phc.pem((u, np.random.default_rng(4).standard_normal(400)), dt=STEP)
    assert silent.order == 0
    found = compare((u, y), ct.tf([2.0], [1.0]), silent, dt=STEP)
    np.testing.assert_array_equal(found.predicted[0], 2.0 * u)
    np.testing.assert_array_equal(found.predicted[1], 0.0 * u)


def test_models_are_named_by_their_names_and_repeats_are_numbered():
    u, y = recording()
    fit = phc.pem((u, y), order=2, dt=STEP)
    found = compare((u, y), plant("twin"), plant("twin"), plant().modes, fit, ct.tf([1], [1, 1]), dt=STEP)
    assert found.labels == ("twin #1", "twin #2", "ModalForm (2 modes)", "fit (2 modes)", "TransferFunction")
    assert compare((u, y), plant(), dt=STEP, labels="mine").labels == ("mine",)
    assert compare((u, y), plant(), fit, labels=["a", "b"]).best in ("a", "b")
    with pytest.raises(StructureError, match="3 labels for 2 models"):
        compare((u, y), plant(), fit, labels=["a", "b", "c"])


def test_the_step_is_that_of_a_model_where_the_data_have_none():
    u, y = recording()
    fit = phc.pem((u, y), order=2, dt=STEP)
    assert compare((u, y), plant(), fit).time[1] == STEP
    assert compare((u, y), plant(), phc.sample(plant(), STEP)).time[1] == STEP
    with pytest.raises(StructureError, match="dt is missing"):
        compare((u, y), plant())


def two_ports():
    return ct.ss(-np.eye(2), np.eye(2), np.eye(2), 0, name="table")


@pytest.mark.parametrize(
    "model, options, complaint",
    [
        (two_ports(), {}, "model 'table' has 2 inputs and 2 outputs, the record one of each"),
        (phc.spring_chain([1.0, 2.0], 1.0, ground=1.0, port=[0, 1]).modes, {}, "has 2 inputs and 2 outputs"),
        (
            ct.tf([1], [1, 0.5], 0.3, name="slow"),
            {},
            "'slow' is discrete-time with dt = 0.3, the record has the step 0.1",
        ),
        (ct.tf([1], [1, -9.0], name="wild"), {}, "'wild' is unstable: its modes grow by up to 2.4596 a sample"),
        (ct.tf([1], [1, -30.0], name="wild"), {"initial_state": "zero"}, "leaves the range of doubles at sample"),
        (ct.tf([1], [1, -9000.0], name="wild"), {}, "within one step of 0.1 its state leaves the range of doubles"),
        (ct.tf([1], [1, -20.0], name="wild"), {"method": "midpoint"}, "pole at 2/h = 20"),
        (ct.tf([1, 0, 0], [1, 1], name="rough"), {}, "'rough' has no state-space form"),
        (ct.tf([1], [1, 1]), {"initial_state": "fitted"}, "'fitted' is that of a PEMResult"),
        (ct.tf([1], [1, 1]), {"initial_state": "final"}, "initial_state is 'final'; it must be one of"),
        (ct.tf([1], [1, 1]), {"method": "runge"}, "method is 'runge'"),
        (ct.tf([1], [1, 1]), {"method": "euler", "intersample": "foh"}, "intersample must be 'zoh'"),
        (ct.frd([1.0, 2.0], [1.0, 2.0]), {}, "is a FrequencyResponseData; pass a PEMResult"),
        (3.0, {}, "is a float; pass a PEMResult"),
    ],
)
def test_what_is_no_usable_model_is_refused_with_its_name_and_the_reason(model, options, complaint):
    u, y = recording()
    for call in (compare, residual_analysis):
        with pytest.raises(StructureError, match=complaint):
            call((u, y), model, dt=STEP, **options)


def test_records_that_show_nothing_are_refused():
    u, y = recording()
    with pytest.raises(StructureError, match="no model given"):
        compare((u, y), dt=STEP)
    with pytest.raises(StructureError, match="has no outputs"):
        compare((u, np.full(400, np.nan)), plant(), dt=STEP)
    with pytest.raises(StructureError, match="zero throughout"):
        compare((u, 0 * y), plant(), dt=STEP)
    with pytest.raises(StructureError, match="4 observed output samples and model 'plant' 4 states"):
        compare((u[:4], y[:4]), plant(), dt=STEP)
    assert np.isfinite(compare((u[:4], y[:4]), plant(), dt=STEP, initial_state="zero").fit_percent).all()


def test_a_result_of_a_stepping_rule_holds_at_its_step_only():
    fits = {method: phc.pem(recording(), order=2, dt=STEP, method=method) for method in ("exact", "midpoint")}
    u, y = recording()
    slower = ct.TimeResponseData(2 * STEP * np.arange(200), y[::2], inputs=u[::2], issiso=True)
    assert compare(slower, fits["exact"]).fit_percent.shape == (1,)
    with pytest.raises(StructureError, match=r"method='midpoint' at the step 0\.1, and holds at that step only"):
        compare(slower, fits["midpoint"])
    for wrong in ("method", "intersample"):
        with pytest.raises(StructureError, match=f"{wrong} is"):
            compare(slower, fits["exact"], **{wrong: np.zeros(2)})


def test_nothing_given_is_modified_and_no_result_can_be():
    u, y = recording(missing=0.1)
    before = u.copy(), y.copy()
    found, analysis = compare((u, y), plant(), dt=STEP), residual_analysis((u, y), plant(), dt=STEP)
    selection = order_selection((u, y), 2, dt=STEP)
    np.testing.assert_array_equal(u, before[0])
    np.testing.assert_array_equal(y, before[1])
    for array in (
        found.predicted,
        found.measured,
        analysis.residuals,
        analysis.lags,
        selection.bic,
        selection.frequencies[2],
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


# --- residuals: chance -----------------------------------------------------------------------------------------------

# p-values of n draws stay this close to uniform in 999 of 1000 seedings (Kolmogorov)
KOLMOGOROV = 1.95


def colour(rng, samples, pole):
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(samples + 200))[200:]


@pytest.mark.slow
def test_p_values_of_a_fit_to_its_own_short_record_are_uniform():
    """8 parameters are fitted to 100 samples: without the correction Ljung and Box reject twice too often or more."""
    p_values = []
    for seed in range(40):
        rng = np.random.default_rng([8, seed])
        u = rng.standard_normal(100)
        y = phc.forced_response(
            phc.ph(phc.modes([0.7, 2.0], [1.0, 0.5])), 0.3 * np.arange(100), u, intersample="zoh"
        ).outputs
        y = y + 0.1 * rng.standard_normal(100)
        fit = phc.pem((u, y), order=2, dt=0.3, offset=False, intersample="zoh", delay=0.0, noise="white")
        analysis = residual_analysis((u, y), fit, lags=8)
        assert analysis.own_record
        p_values.append(
            [analysis.whiteness, analysis.offset_p_value, analysis.response_p_value, analysis.feedback_p_value]
        )
    for column in np.array(p_values).T:
        assert kstest(column, "uniform").statistic * np.sqrt(40) < KOLMOGOROV
        assert np.sum(column < 0.05) <= binom.isf(1e-3, 40, 0.05)


# --- residuals: findings ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_missing_mode_is_found_as_a_response():
    u, y = recording(samples=1000, noise=0.1)
    result = phc.pem((u, y), order=1, dt=STEP, real_poles=0)  # a real pole would stand for a part of the mode
    analysis = residual_analysis((u, y), result)
    # an autoregression takes over what the simulation lacks, but not what goes with the input
    assert analysis.response_p_value < 1e-6 and analysis.simulation_whiteness < 1e-6
    assert analysis.verdict == "NOT all of the response to the input is in the model"
    assert "raise the order" in analysis.message
    complete = residual_analysis((u, y), phc.pem((u, y), order=2, dt=STEP))
    assert complete.verdict == "white, and independent of the input"
    assert min(complete.response_p_value, complete.whiteness, complete.feedback_p_value) > 0.01


def test_feedback_is_found_at_negative_lags():
    rng = np.random.default_rng(5)
    noise = 0.3 * rng.standard_normal(600)
    u = rng.standard_normal(600)
    u[2:] += 2.0 * noise[:-2]
    y = phc.forced_response(plant(), STEP * np.arange(600), u, intersample="zoh").outputs + noise
    analysis = residual_analysis((u, y), plant(), dt=STEP)
    assert analysis.feedback_p_value < 1e-6 < 0.01 < analysis.response_p_value
    assert analysis.verdict == "related to later inputs: feedback in the recording"
    assert analysis.lags[np.argmax(np.abs(analysis.cross_correlation))] == -2


def test_coloured_noise_and_an_offset_are_told_from_a_response():
    u, y = recording(samples=1000, noise=0.0)
    rng = np.random.default_rng(6)
    noisy = residual_analysis((u, y + 0.1 * colour(rng, 1000, 0.9)), plant(), dt=STEP)
    assert noisy.verdict == "coloured, though no response to the input is seen"
    assert noisy.noise_order >= 1 and noisy.outside[0] > 10
    shifted = residual_analysis((u, y + 0.3 + 0.1 * rng.standard_normal(1000)), plant(), dt=STEP)
    assert shifted.verdict == "about a mean that is not zero"
    assert "Their mean is 0.29" in shifted.message or "Their mean is 0.3" in shifted.message


def test_residuals_at_rounding_level_are_not_judged():
    u, y = recording(noise=0.0)
    analysis = residual_analysis((u, y), plant(), dt=STEP)
    assert analysis.verdict == "at rounding level: the model reproduces the record"
    perfect = residual_analysis((u, 2.0 * u), ct.tf([2.0], [1.0]), dt=STEP)
    assert perfect.verdict == analysis.verdict and perfect.whiteness == 1.0
    assert perfect.outside == (0, 0) and not perfect.cross_correlation.any()
    perfect.plot()


def test_what_an_input_cannot_tell_is_said():
    rng = np.random.default_rng(7)
    u = np.ones(300)
    y = phc.forced_response(plant(), STEP * np.arange(300), u, intersample="zoh").outputs + 0.1 * rng.standard_normal(
        300
    )
    analysis = residual_analysis((u, y), plant(), dt=STEP)
    assert np.isnan(analysis.response_p_value) and np.isnan(analysis.feedback_p_value)
    assert analysis.verdict == "white" and "input is constant" in analysis.message
    assert "p unknown" in str(analysis)
    # more lags than a short record can carry
    u, y = recording(samples=30, noise=0.1)
    crowded = residual_analysis((u, y), plant(), dt=STEP, lags=25)
    assert np.isnan(crowded.response_p_value) and "too short" in crowded.message


def test_the_report_names_the_tests_and_counts():
    u, y = recording(samples=500, noise=0.1)
    text = str(residual_analysis((u, y), plant(), dt=STEP))
    assert text.splitlines()[0] == "Residuals of 'plant' on 'y': white, and independent of the input"
    for part in ("of 25 lags outside 99 % (0.25 expected)", "of 51 lags outside 99 % (0.51 expected)", "Ljung-Box"):
        assert part in text
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.parametrize("options, complaint", [
    ({"lags": 0}, "lags is 0; it must be a whole number from 1 to 399"),
    ({"lags": 400}, "lags is 400"),
    ({"lags": 2.5}, "lags is 2.5"),
    ({"lags": True}, "lags is True"),
    ({"confidence": 1.0}, "confidence is 1.0; it must be a number between 0 and 1"),
    ({"confidence": "high"}, "confidence is 'high'"),
])  # fmt: skip
def test_options_of_the_analysis_out_of_range_are_refused(options, complaint):
    with pytest.raises(StructureError, match=complaint):
        residual_analysis(recording(), plant(), dt=STEP, **options)


# --- the order -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_table_is_the_path_of_the_fit_and_BIC_finds_the_order():
    data = recording(noise=0.1)
    selection = order_selection(data, 5, dt=STEP)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = phc.pem(data, order=5, dt=STEP, structure="free").order_table
    assert selection.orders.tolist() == [0, 1, 2, 3, 4, 5]
    for name in ("loss", "aic", "bic"):
        np.testing.assert_allclose(getattr(selection, name), [getattr(row, name) for row in path], rtol=1e-9)
    # of each mode pole, residue and motion; what is fed through, a constant and the variance
    parameters = 6 * selection.orders + 3
    correction = 2 * parameters * (parameters + 1) / (400 - parameters - 1)
    np.testing.assert_allclose(selection.aicc - selection.aic, correction, rtol=1e-9)
    assert selection.chosen() == selection.chosen("bic") == 2
    assert [len(d) for d in selection.frequencies] == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(selection.frequencies[2], [0.5, 2.0], rtol=0.01)
    # both modes of the plant stay; the one that is new is not stable
    assert selection.stable[3].sum() == 2
    nearest = np.abs(selection.frequencies[3][:, None] - [0.5, 2.0]).argmin(axis=0)
    assert selection.stable[3][nearest].all()


def test_a_mode_is_stable_where_the_order_before_has_it_within_a_hundredth_or_two_bins():
    selection = order_selection(recording(noise=0.1), 6, dt=STEP)
    two_bins = 2 * 2 * np.pi / (400 * STEP)
    for before, now, marks in zip(selection.frequencies, selection.frequencies[1:], selection.stable[1:], strict=False):
        for d, stable in zip(now, marks, strict=True):
            partner = min(before, key=lambda other: abs(other - d), default=np.inf)
            mutual = all(abs(d - partner) <= abs(other - partner) for other in now)
            assert stable == (mutual and abs(d - partner) <= max(0.01 * d, two_bins))
    marks = np.concatenate(selection.stable)
    assert marks.any() and not marks.all()


def test_the_held_out_part_is_foretold_by_models_of_what_comes_before():
    u, y = recording(noise=0.1, samples=500, missing=0.1)
    # an accelerometer, so that what is fed through stays in all models
    same = {"dt": STEP, "quantity": "acceleration", "intersample": "zoh", "offset": True}
    selection = order_selection((u, y), [0, 1, 2, 4], holdout=0.3, **same)
    assert selection.orders.tolist() == [0, 1, 2, 4]
    seen = ~np.isnan(y[350:])
    assert selection.held_out == seen.sum() and selection.samples == np.sum(~np.isnan(y))
    columns, known = np.column_stack([u, np.ones(500)]), ~np.isnan(y[:350])
    constant = columns @ np.linalg.lstsq(columns[:350][known], y[:350][known])[0]
    result = phc.pem((u[:350], y[:350]), order=2, structure="free", delay=0, **same)
    ahead = result.predict(u[350:], initial_state="final").outputs
    expected = [np.mean((y[350:] - guess)[seen] ** 2) for guess in (constant[350:], ahead)]
    np.testing.assert_allclose(selection.holdout[[0, 2]], expected, rtol=1e-5)
    assert selection.chosen("holdout") == 2
    assert "hold-out" in str(selection)


def test_the_table_marks_the_best_of_each_criterion():
    lines = str(order_selection(recording(noise=0.1), 4, dt=STEP)).splitlines()
    assert lines[0].split() == ["order", "loss", "AIC", "AICc", "BIC", "stable"]
    assert len(lines) == 6 and sum(line.count("*") for line in lines) == 3
    assert lines[3].split()[4].endswith("*") and lines[3].endswith("1 of 2")


def test_a_path_that_ends_in_rounding_has_no_more_orders():
    selection = order_selection(recording(noise=0.0), 6, dt=STEP)
    assert selection.orders[-1] == 2 and selection.chosen() == 2
    with pytest.raises(StructureError, match="2 modes already reproduce the record"):
        order_selection(recording(noise=0.0), [4, 5], dt=STEP)


def test_by_default_the_orders_are_those_that_a_short_record_carries():
    u, y = recording(samples=16, noise=0.1)
    assert order_selection((u, y), dt=STEP).orders[-1] == 2
    # 15 parameters and 16 samples: no correction is large enough
    assert np.isinf(order_selection((u, y), dt=STEP).aicc[-1])
    order_selection((u, y), dt=STEP).plot()


@pytest.mark.parametrize("orders", [0, 2.5, "many", [], [0], [-1, 2], True, [1.5]])
def test_orders_that_are_none_are_refused(orders):
    with pytest.raises(StructureError, match="orders"):
        order_selection(recording(), orders, dt=STEP)


def test_other_options_of_the_selection_are_checked_too():
    data = recording()
    with pytest.raises(StructureError, match="holdout is 1; it must be the part"):
        order_selection(data, 2, dt=STEP, holdout=1)
    with pytest.raises(TypeError, match="the orders to try are the argument orders"):
        order_selection(data, 2, dt=STEP, max_order=3)
    with pytest.raises(TypeError, match="no_such_keyword"):
        order_selection(data, 2, dt=STEP, no_such_keyword=1)
    with pytest.raises(StructureError, match="no part of the record was held out"):
        order_selection(data, 2, dt=STEP).chosen("holdout")
    with pytest.raises(StructureError, match="criterion is 'best'"):
        order_selection(data, 2, dt=STEP).chosen("best")


# --- pictures --------------------------------------------------------------------------------------------------------


def legend_texts(axis):
    return [text.get_text() for text in axis.get_legend().get_texts()]


def test_the_picture_of_a_comparison_shows_outputs_errors_and_fits():
    u, y = recording(noise=0.1)
    data = ct.TimeResponseData(STEP * np.arange(400), y, inputs=u, issiso=True, output_labels=["speed [m/s]"])
    found = compare(data, plant(), damped_plant())
    plot = found.plot(detail=None)
    assert isinstance(plot, ct.ControlPlot) and plot.axes.shape == plot.lines.shape == (2, 1)
    measured, first, second = plot.lines[0, 0]
    np.testing.assert_array_equal(measured.get_ydata(), y)
    np.testing.assert_array_equal(first.get_ydata(), found.predicted[0])
    np.testing.assert_array_equal(second.get_ydata(), found.predicted[1])
    errors = {line.get_label(): line.get_ydata() for line in plot.lines[1, 0]}
    name = f"damped ({found.fit_percent[1]:.2f} %)"
    np.testing.assert_array_equal(errors[name], y - found.predicted[1])
    assert legend_texts(plot.axes[0, 0])[2] == name
    assert [axis.get_ylabel() for axis in plot.axes[:, 0]] == ["speed [m/s]", "Error [m/s]"]
    assert plot.axes[1, 0].get_xlabel() == "Time"


def test_part_of_a_long_comparison_is_enlarged():
    u, y = recording(noise=0.1, samples=3000)
    plot = compare((u, y), plant(), dt=STEP).plot(time_unit="ms")
    assert plot.axes.shape == (3, 1)
    low, high = plot.axes[2, 0].get_xlim()
    assert 0 <= low < high <= 300 and high - low < 101
    assert plot.axes[2, 0].get_xlabel() == "Time [ms]"
    chosen = compare((u, y), plant(), dt=STEP).plot(detail=[10.0, 20.0])
    assert chosen.axes[2, 0].get_xlim() == pytest.approx((10.0, 20.0))


def test_a_model_that_runs_away_does_not_hide_the_others():
    u, y = recording(noise=0.1)
    wild = ct.tf([1], [1, -0.5], name="wild")
    plot = compare((u, y), plant(), wild, dt=STEP, initial_state="zero").plot(detail=None)
    low, high = plot.axes[0, 0].get_ylim()
    assert high - low <= 3.01 * np.ptp(y)


def test_pictures_are_drawn_on_axes_that_are_given():
    data = recording(noise=0.1)
    found, analysis = compare(data, plant(), dt=STEP), residual_analysis(data, plant(), dt=STEP)
    selection = order_selection(data, 3, dt=STEP)
    for result, shape in ((found, (2, 1)), (analysis, (2, 1)), (selection, (1, 2))):
        figure, axes = plt.subplots(*shape)
        plot = result.plot(ax=axes)
        assert plot.figure is figure and list(plot.axes.ravel()) == list(axes)
        assert all(axis.lines for axis in axes)
        with pytest.raises(StructureError, match="ax has 3 axes"):
            result.plot(ax=plt.subplots(3)[1], **({"detail": None} if result is found else {}))


@pytest.mark.slow
def test_the_picture_of_residuals_shows_both_correlations_and_their_bands():
    u, y = recording(noise=0.1, samples=1000)
    analysis = residual_analysis((u, y), phc.pem((u, y), order=1, dt=STEP), horizon=None)
    plot = analysis.plot()
    assert plot.axes.shape == plot.lines.shape == (2, 1)
    for lines, values, band, lags in (
        (plot.lines[0, 0], analysis.autocorrelation, analysis.autocorrelation_band, np.arange(1, 26)),
        (plot.lines[1, 0], analysis.cross_correlation, analysis.cross_correlation_band, analysis.lags),
    ):
        inside, outside = lines
        out = np.abs(values) > band
        np.testing.assert_array_equal(outside.get_xdata(), lags[out])
        np.testing.assert_array_equal(inside.get_ydata(), values[~out])
        reach = np.concatenate([path.vertices[:, 1] for path in lines[0].axes.collections[0].get_paths()])
        assert reach.max() == pytest.approx(band.max())
    assert len(plot.lines[0, 0][1].get_xdata()) > 10
    assert legend_texts(plot.axes[0, 0]) == ["99 % band", "inside", "outside"]
    assert plot.axes[0, 0].get_xlabel() == "Lag [samples]"
    assert analysis.whiteness == 0.0 and "p < 1e-300" in plot.axes[0, 0].get_title(loc="left")


def test_the_stabilisation_diagram_shows_frequencies_by_order_and_criteria_beside():
    selection = order_selection(recording(noise=0.1), 4, dt=STEP, holdout=0.2)
    plot = selection.plot(time_unit="ms")
    assert plot.axes.shape == plot.lines.shape == (1, 2)
    stable, new = plot.lines[0, 0]
    np.testing.assert_array_equal(
        np.sort(np.concatenate([stable.get_xdata(), new.get_xdata()])), np.sort(np.concatenate(selection.frequencies))
    )
    assert np.sum(stable.get_ydata() == 3) == selection.stable[3].sum() == 2
    assert plot.axes[0, 0].get_xlabel() == "Natural frequency [rad/ms]"
    assert plot.axes[0, 0].get_ylabel() == "Order (number of modes)"
    assert legend_texts(plot.axes[0, 0]) == ["stable", "new", "modes of order 2", "BIC chooses 2"]
    curves = {line.get_label(): line for line in plot.lines[0, 1]}
    assert list(curves) == ["AIC", "AICc", "BIC", "hold-out"]
    np.testing.assert_allclose(curves["BIC"].get_xdata(), selection.bic - selection.bic.min())
    assert curves["BIC"].get_xdata()[2] == 0 and curves["BIC"].get_ydata()[2] == 2
    assert "AIC chooses" in legend_texts(selection.plot("aic").axes[0, 0])[-1]
    hertz = selection.plot(Hz=True)
    np.testing.assert_allclose(hertz.lines[0, 0][0].get_xdata(), stable.get_xdata() / (2 * np.pi))
    assert hertz.axes[0, 0].get_xlabel() == "Natural frequency [Hz]"
    limited = order_selection(recording(noise=0.1), 1, dt=STEP).plot()
    assert legend_texts(limited.axes[0, 0])[-1] == "BIC chooses 1, the largest tried"


def test_dollar_signs_in_names_are_drawn_as_they_are():
    u, y = recording(noise=0.1)
    found = compare((u, y), plant(), dt=STEP, labels=["$a$"])
    plot = found.plot(title="$b$", output_label="$c$", output_unit="$d$", time_unit="$e$")
    plot.figure.canvas.draw()
    assert r"\$a\$" in legend_texts(plot.axes[0, 0])[1]
    assert plot.axes[0, 0].get_ylabel() == r"\$c\$ [\$d\$]"


def test_bands_of_a_correlation_are_quantiles_of_its_law():
    u, y = recording(noise=0.1, samples=500, z0=np.zeros(plant().nstates))
    analysis = residual_analysis((u, y), plant(), dt=STEP, initial_state="zero")
    k, T = np.arange(1, len(analysis.autocorrelation) + 1), 500
    expected = norm.isf(0.005) * np.sqrt((T - k) / (T * (T + 2))) * T / (T - k)
    np.testing.assert_allclose(analysis.autocorrelation_band, expected, rtol=1e-6)

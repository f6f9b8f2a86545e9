"""Validation with data of every kind: several experiments, frequency responses, free motions, quantities, offsets."""

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom, kstest
from slow import slowly

import ph_control as phc
from ph_control import IdentificationError, StructureError

EPS = np.finfo(float).eps
STEP = 0.2
D, R = np.array([0.7, 2.0]), np.array([1.0, 0.5])
QUANTITIES = ("velocity", "displacement", "acceleration")
quick = settings(deadline=None, max_examples=12, derandomize=True)

# p-values of n draws stay this close to uniform in 999 of 1000 seedings (Kolmogorov)
KOLMOGOROV = 1.95


def sensed(quantity):
    """The plant in matrices of its own: velocity `B^T Q z`, its integral, or its derivative."""
    Q = np.diag(np.concatenate([D, D]))
    B = np.concatenate([np.sqrt(R), np.zeros(2)])[:, None]
    A = np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(2)) @ Q
    C = B.T @ Q
    if quantity == "displacement":
        C = np.linalg.solve(A.T, C.T).T
    through = C @ B if quantity == "acceleration" else 0.0
    return ct.ss(A, B, C @ A if quantity == "acceleration" else C, through, name=f"dense {quantity}")


def recorded(quantity="velocity", samples=150, noise=0.0, seed=0, free=False, offset=0.0):
    """Input (None of a free motion) and output, sample by sample, from a random state."""
    rng = np.random.default_rng(seed)
    sampled = ct.c2d(sensed(quantity), STEP)
    u = np.zeros(samples) if free else rng.standard_normal(samples)
    x, y = rng.standard_normal(4), np.empty(samples)
    for k, value in enumerate(u):
        y[k] = (sampled.C @ x + sampled.D[:, 0] * value).item()
        x = sampled.A @ x + sampled.B[:, 0] * value
    y += offset + noise * np.std(y) * rng.standard_normal(samples)
    return (None if free else u), y


def experiments(quantity="velocity", noise=0.0, offset=0.0, seed=0):
    return [
        recorded(quantity, 150, noise, [seed, 1], offset=offset),
        recorded(quantity, 90, noise, [seed, 2], free=True, offset=offset),
        recorded(quantity, 210, noise, [seed, 3], offset=offset),
    ]


OMEGA = np.linspace(0.05, 3.0, 120)


def response(quantity="velocity", noise=0.0, seed=0, omega=OMEGA):
    rng = np.random.default_rng(seed)
    G = np.array(sensed(quantity)(1j * omega))
    G = G + noise * (rng.standard_normal(len(omega)) + 1j * rng.standard_normal(len(omega)))
    return ct.frd(G, omega)


def fit_of(y, predicted):
    seen = ~np.isnan(y)
    return 100 * (1 - np.linalg.norm((y - predicted)[seen]) / np.linalg.norm(y[seen] - y[seen].mean()))


# --- comparison: several experiments, quantities, offsets ------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_plant_explains_all_of_its_noise_free_data_of_every_kind(quantity):
    data = experiments(quantity, offset=3.0)
    fit = phc.pem(data, 2, dt=STEP, quantity=quantity, offset=True, intersample="zoh", delay=0.0)
    found = phc.compare(data, fit, fit.observed_system, sensed(quantity), dt=STEP, offset=True)
    np.testing.assert_allclose(found.fit_percent, 100.0, atol=1e-8)
    assert found.own_record == (True, False, False)
    for one in found.experiments:
        np.testing.assert_allclose(one.fit_percent, 100.0, atol=1e-8)
    fresh = recorded(quantity, seed=9, offset=-1.0)
    np.testing.assert_allclose(
        phc.compare(fresh, fit, sensed(quantity), dt=STEP, offset=True).fit_percent, 100.0, atol=1e-8
    )
    # without the constant, and of another quantity, there is much left
    assert phc.compare(data, sensed(quantity), dt=STEP).fit_percent[0] < 90
    other = QUANTITIES[QUANTITIES.index(quantity) - 1]
    assert phc.compare(fresh, sensed(other), dt=STEP, offset=True).fit_percent[0] < 90
    spectral = phc.compare(response(quantity), fit, fit.observed_system, sensed(quantity))
    np.testing.assert_allclose(spectral.fit_percent, 100.0, atol=1e-6)


@pytest.mark.parametrize(
    "options", [{}, {"offset": True}, {"initial_state": "zero", "delay": 0, "intersample": "zoh", "noise": "white"}]
)
def test_the_fit_of_a_result_on_its_own_experiments_is_that_of_the_fit(options):
    data = experiments("displacement", noise=0.2, offset=0.5)
    fit = phc.pem(data, 2, dt=STEP, quantity="displacement", **options)
    found = phc.compare(data, fit, dt=STEP, initial_state=options.get("initial_state", "estimate"))
    assert found.fit_percent[0] == pytest.approx(fit.fit_percent, abs=1e-9)
    for one, own in zip(found.experiments, fit.experiments, strict=True):
        np.testing.assert_array_equal(one.predicted[0], own.predicted)
        assert one.fit_percent[0] == pytest.approx(own.fit_percent, abs=1e-9)
        assert one.own_record == (True,)
    np.testing.assert_array_equal(found.predicted[0], fit.predicted)
    assert str(found).count("fitted to all of these experiments") == 1
    part = phc.compare([data[2], recorded("displacement", seed=5)], fit, dt=STEP)
    assert [one.own_record for one in part.experiments] == [(True,), (False,)]
    assert "fitted to 1 of these experiments" in str(part)


@pytest.mark.slow
@quick
@given(st.permutations(range(3)), st.integers(0, 5))
def test_neither_the_order_of_experiments_nor_their_company_changes_what_a_model_says_of_each(order, seed):
    data = experiments(noise=0.3, seed=seed)
    model = phc.ph(phc.modes(D, R))
    together = phc.compare([data[k] for k in order], model, sensed("velocity"), dt=STEP)
    analysis = phc.residual_analysis([data[k] for k in order], model, dt=STEP)
    straight = phc.residual_analysis(data, model, dt=STEP)
    for place, k in enumerate(order):
        alone = phc.compare(data[k], model, sensed("velocity"), dt=STEP)
        np.testing.assert_array_equal(together.experiments[place].predicted, alone.predicted)
        np.testing.assert_array_equal(together.experiments[place].fit_percent, alone.fit_percent)
    # all together it is the fit to the records put end to end
    y = np.concatenate([data[k][1] for k in order])
    assert together.fit_percent[0] == pytest.approx(fit_of(y, together.predicted[0]), abs=1e-9)
    assert analysis.fit_percent == pytest.approx(together.fit_percent[0], abs=1e-9)
    for name in ("whiteness", "response_p_value", "feedback_p_value", "offset_p_value", "ljung_box"):
        assert getattr(analysis, name) == pytest.approx(getattr(straight, name), rel=1e-6)
    np.testing.assert_allclose(analysis.cross_correlation_band, straight.cross_correlation_band, rtol=1e-9)


@quick
@given(st.integers(40, 160))
def test_a_record_cut_in_two_is_explained_as_well_and_the_halves_start_where_they_like(cut):
    u, y = recorded(samples=200)
    halves = [(u[:cut], y[:cut]), (u[cut:], y[cut:])]
    model = phc.ph(phc.modes(D, R))
    assert phc.compare(halves, model, dt=STEP).fit_percent[0] == pytest.approx(100.0, abs=1e-8)
    noisy = y + 0.3 * np.random.default_rng(cut).standard_normal(200)
    halves = [(u[:cut], noisy[:cut]), (u[cut:], noisy[cut:])]
    # two states fit better than one
    assert phc.compare(halves, model, dt=STEP).rms_error[0] <= phc.compare((u, noisy), model, dt=STEP).rms_error[0]


def test_a_constant_is_estimated_with_the_state_or_kept_as_fitted():
    u, y = recorded(noise=0.2, offset=2.0)
    model = sensed("velocity")
    sampled = ct.c2d(model, STEP)
    powers = [np.linalg.matrix_power(sampled.A, k) for k in range(150)]
    free = np.array([(sampled.C @ power)[0] for power in powers])
    forced = np.array(
        [sum((sampled.C @ powers[k - j - 1] @ sampled.B).item() * u[j] for j in range(k)) for k in range(150)]
    )
    columns = np.column_stack([free, np.ones(150)])
    expected = forced + columns @ np.linalg.lstsq(columns, y - forced)[0]
    np.testing.assert_allclose(
        phc.compare((u, y), model, dt=STEP, offset=True).predicted[0], expected, atol=1e5 * EPS * np.abs(y).max()
    )
    fit = phc.pem((u, y), 2, dt=STEP, offset=True)
    fresh = recorded(noise=0.2, seed=3, offset=-5.0)
    again, kept = (phc.compare(fresh, fit, dt=STEP, initial_state=rule) for rule in ("estimate", "fitted"))
    assert again.fit_percent[0] > 75 > 0 > kept.fit_percent[0]
    # from rest too the constant is that of the new record
    rest = phc.compare(fresh, fit, dt=STEP, initial_state="zero")
    assert np.mean(rest.measured - rest.predicted[0]) == pytest.approx(0.0, abs=1e-12)


def test_a_free_motion_has_a_state_whatever_the_rule():
    data = recorded(free=True, noise=0.1)
    for model in (phc.ph(phc.modes(D, R)), sensed("velocity"), phc.pem(data, 2, dt=STEP)):
        found = phc.compare(data, model, dt=STEP, initial_state="zero")
        assert found.fit_percent[0] == pytest.approx(90, abs=3)
    assert "initial state zero, of free motions estimated" in str(found)


# --- comparison: frequency responses ---------------------------------------------------------------------------------


def weighted_fit(G, predicted, w):
    mean = np.sum(w * G) / np.sum(w)
    return 100 * (1 - np.sqrt(np.sum(w * abs(G - predicted) ** 2) / np.sum(w * abs(G - mean) ** 2)))


def test_a_response_is_held_against_models_of_every_kind_at_its_own_frequencies():
    data = response(noise=0.1)
    G, plant = data.frdata[0, 0], phc.ph(phc.modes(D, R))
    damped = ct.tf([1.0, 0.0], [1.0, 0.1, 4.0])
    sampled = ct.c2d(damped, STEP)
    fit = phc.pem(data, 2)
    timed = phc.pem(recorded("acceleration", noise=0.01), 2, dt=STEP, quantity="acceleration")
    models = (plant, plant.modes, phc.oh(plant), damped, ct.ss(damped), sampled, fit, timed)
    found = phc.compare(data, *models)
    z = np.exp(1j * OMEGA * STEP)
    reference = [*[plant(1j * OMEGA)] * 3, *[damped(1j * OMEGA)] * 2, sampled(z), fit.system(1j * OMEGA)]
    reference.append(timed.observed_system(1j * OMEGA))
    # what an accelerometer feels at once is estimated along with the modes
    assert timed.feedthrough[0, 0] == pytest.approx(timed.kappa.sum(), rel=0.01)
    for row, values, fitted in zip(found.predicted, reference, found.fit_percent, strict=True):
        np.testing.assert_allclose(row, values, rtol=1e-9)
        assert fitted == pytest.approx(weighted_fit(G, values, np.ones(120)), abs=1e-7)
    assert found.own_record == (False,) * 6 + (True, False)
    assert found.fit_percent[6] == pytest.approx(fit.fit_percent, abs=1e-9)
    np.testing.assert_array_equal(found.omega, OMEGA)
    assert "120 frequencies" in str(found) and "fitted to this response" in str(found)
    assert "initial state" not in str(found)


@quick
@given(st.integers(0, 50), st.floats(-30, 30))
def test_weights_count_by_their_proportions_and_missing_points_not_at_all(seed, exponent):
    rng = np.random.default_rng(seed)
    w, missing = rng.uniform(0.1, 10.0, 120), rng.random(120) < 0.2
    G = np.where(missing, np.nan, response(noise=0.3, seed=seed).frdata[0, 0])
    model = sensed("velocity")
    found = phc.compare(ct.frd(G, OMEGA), model, weights=10.0**exponent * w)
    predicted = model(1j * OMEGA)
    kept = ~missing
    assert found.fit_percent[0] == pytest.approx(weighted_fit(G[kept], predicted[kept], w[kept]), abs=1e-8)
    error = np.sqrt(np.sum(w[kept] * abs(G - predicted)[kept] ** 2) / w[kept].sum())
    assert found.rms_error[0] == pytest.approx(error, rel=1e-9)
    assert f"{missing.sum()} missing, weighted" in str(found)
    # two halves of the points are the same data
    halves = [ct.frd(G[part], OMEGA[part]) for part in (slice(0, 50), slice(50, None))]
    parts = phc.compare(halves, model, weights=[w[:50], w[50:]])
    assert parts.fit_percent[0] == pytest.approx(found.fit_percent[0], abs=1e-8)


# --- what is refused -------------------------------------------------------------------------------------------------


def two_step_fit():
    return phc.pem(experiments(noise=0.1), 2, dt=STEP, intersample="zoh", delay=0.0)


@pytest.mark.parametrize(
    "data, model, options, complaint",
    [
        (response(omega=np.array([0.1, 0.5])), lambda: phc.modes(0.5, 1.0), {}, r"has a pole at omega = 0\.5, point 1"),
        (response(), lambda: ct.tf([1], [1, 0.2], 5.0), {}, "above its Nyquist frequency"),
        (response(), lambda: ct.tf([1], [1, 0.2], True), {}, "unspecified step"),
        (response(), lambda: ct.ss(-1, [[1, 1]], 1, 0), {}, "2 inputs and 1 outputs, the response one of each"),
        (response(), lambda: 3.0, {}, "is a float; pass a PEMResult"),
        (response(), lambda: sensed("velocity"), {"dt": 0.1}, "leave dt out"),
        (response(), lambda: sensed("velocity"), {"initial_state": "final"}, "initial_state is 'final'"),
        (recorded(), lambda: sensed("velocity"), {"dt": STEP, "weights": np.ones(150)}, "weights belong to frequency"),
        (
            [recorded(), (np.ones(9), np.full(9, np.nan))], lambda: sensed("velocity"), {"dt": STEP},
            "experiment 2 has no outputs",
        ),
        (
            [recorded(), (np.arange(4.0), np.arange(4.0))], lambda: sensed("velocity"), {"dt": STEP},
            "experiment 2: the record has 4 observed output samples and model 'dense velocity' 4 states",
        ),
        ([response(), recorded()], lambda: sensed("velocity"), {"dt": None}, "fit the two kinds one by one"),
        (recorded(seed=8), two_step_fit, {"initial_state": "fitted"}, "fitted to 3 experiments, each with a motion"),
        (
            recorded(), lambda: phc.pem(response(), 2), {"dt": STEP, "initial_state": "fitted"},
            "fit is to a frequency response, which has no motion",
        ),
        ((None, np.zeros(30)), lambda: sensed("velocity"), {"dt": STEP}, "zero throughout"),
    ],
)  # fmt: skip
def test_what_cannot_be_held_against_one_another_is_refused_with_words(data, model, options, complaint):
    for call in (phc.compare, phc.residual_analysis):
        with pytest.raises(StructureError, match=complaint):
            call(data, model(), **options)


def test_time_frequency_and_step_are_those_of_the_kind_of_data():
    in_time = (
        phc.compare(recorded(), sensed("velocity"), dt=STEP),
        phc.residual_analysis(recorded(), sensed("velocity"), dt=STEP),
    )
    spectral = (
        phc.compare(response(noise=0.1), sensed("velocity")),
        phc.residual_analysis(response(noise=0.1), sensed("velocity")),
    )
    for one in in_time:
        assert len(one.time) == 150
        with pytest.raises(StructureError, match="records in time and have no frequencies"):
            _ = one.omega
    for one in spectral:
        np.testing.assert_array_equal(one.omega, OMEGA)
        with pytest.raises(StructureError, match="frequency responses and have no time"):
            _ = one.time
    assert in_time[1].dt == STEP
    with pytest.raises(StructureError, match="are frequency responses"):
        _ = spectral[1].dt
    mixed = phc.residual_analysis([recorded(), recorded()], sensed("velocity"), dt=[STEP, 2 * STEP])
    with pytest.raises(StructureError, match="have steps of their own"):
        _ = mixed.dt
    for one in (*in_time, *spectral):
        with pytest.raises(StructureError, match="experiment is 1; the experiments are counted from 0 to 0"):
            one.plot(experiment=1)


# --- residuals: chance -----------------------------------------------------------------------------------------------


def short_data(kind, seed):
    if kind == "experiments":
        return [recorded(samples=60, noise=0.1, seed=[seed, k]) for k in (1, 2)], {"dt": STEP}
    if kind == "free motion":
        return recorded(samples=100, noise=0.1, seed=seed, free=True), {"dt": STEP}
    return response("displacement", noise=0.05, seed=seed, omega=np.linspace(0.06, 3.0, 60)), {
        "quantity": "displacement"
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["experiments", "free motion", "response"])
def test_p_values_of_fits_to_short_data_of_every_kind_are_uniform(kind):
    """Of these data a tenth is fitted: a test that does not know would refuse too often, or too seldom."""
    runs, p_values = 20, []
    for seed in range(runs):
        data, options = short_data(kind, seed)
        # a constant that was estimated leaves no mean to test
        known = {"weights": np.ones(60)} if kind == "response" else {"offset": False, "noise": "white"}
        fit = phc.pem(
            data, 2, **options, **known, **({"intersample": "zoh", "delay": 0.0} if kind == "experiments" else {})
        )
        analysis = phc.residual_analysis(data, fit, lags=8, **{k: v for k, v in options.items() if k == "dt"})
        assert analysis.own_record
        row = [analysis.whiteness, analysis.offset_p_value]
        p_values.append(row + [analysis.response_p_value, analysis.feedback_p_value] * (kind == "experiments"))
        if fit.whiteness < 0.05 and kind != "response":
            # a fit that doubts its residuals asks in the same way
            same = phc.residual_analysis(data, fit, lags=20, dt=STEP)
            assert fit.whiteness == pytest.approx(same.whiteness, rel=1e-6)
    for column in np.array(p_values).T:
        assert kstest(column, "uniform").statistic * np.sqrt(runs) < KOLMOGOROV
        assert np.sum(column < 0.05) <= binom.isf(1e-3, runs, 0.05)


# --- residuals: findings ---------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("quantity", [QUANTITIES[1], *slowly(QUANTITIES[0], *QUANTITIES[2:])])
def test_a_missing_mode_shows_in_the_residuals_of_every_kind_of_data(quantity):
    data = experiments(quantity, noise=0.05)
    poor, good = (phc.pem(data, n, dt=STEP, quantity=quantity, noise="white", delay=0.0) for n in (1, 2))
    found = phc.residual_analysis(data, poor)
    assert found.verdict == "NOT all of the response to the input is in the model"
    # what an accelerometer feels at once of the missing mode is in the feedthrough, and leaves less to see
    assert found.response_p_value < (0.05 if quantity == "acceleration" else 1e-6)
    assert phc.residual_analysis(data, good).verdict == "white, and independent of the input"
    spectral = phc.residual_analysis(response(quantity, noise=0.01), poor)
    assert spectral.verdict == "NOT white over frequency: the model lacks part of the response"
    assert "raise the order" in spectral.message
    # the frequencies of a fit in time are not exact to a response on a peak; the plant is
    assert phc.residual_analysis(response(quantity, noise=0.01), sensed(quantity)).verdict == "white over frequency"


def test_a_peak_that_a_model_misses_does_not_hide_all_else():
    """One point on a lossless resonance is a thousand times the rest: alone it would look like white noise."""
    omega = np.sort(np.concatenate([np.linspace(0.05, 3.0, 120), [0.7 * (1 + 1e-6)]]))
    data = response(noise=0.01, omega=omega)
    found = phc.residual_analysis(data, ct.tf([1.0, 0.0], [1.0, 0.3, 4.0]))
    assert found.whiteness < 1e-10
    assert np.abs(found.residuals).max() > 1e4


def test_a_constant_over_frequency_is_told_from_dynamics():
    data = response(noise=0.1)
    shifted = ct.frd(data.frdata[0, 0] + 0.5 - 0.25j, OMEGA)
    found = phc.residual_analysis(shifted, sensed("velocity"))
    assert found.offset_p_value < 1e-4
    assert "constant 0.5" in found.message and "fed through" in found.message
    assert phc.residual_analysis(data, sensed("velocity")).offset_p_value > 0.01


def test_each_experiment_may_have_a_mean_of_its_own():
    """Offsets of opposite sign would cancel in a common mean."""
    data = [recorded(noise=0.1, seed=1, offset=0.2), recorded(noise=0.1, seed=2, offset=-0.2)]
    found = phc.residual_analysis(data, sensed("velocity"), dt=STEP)
    assert found.verdict == "about a mean that is not zero" and found.offset_p_value < 1e-6
    assert "Their mean is 0.2" in found.message or "Their mean is 0.1" in found.message
    quiet = phc.residual_analysis(data, sensed("velocity"), dt=STEP, offset=True)
    # what was fitted cannot be tested
    assert quiet.verdict == "white, and independent of the input" and np.isnan(quiet.offset_p_value)


def test_feedback_is_found_within_records_and_not_across_them():
    rng = np.random.default_rng(5)
    data = []
    for seed in (1, 2):
        u, y = recorded(samples=300, seed=seed)
        noise = 0.3 * rng.standard_normal(300)
        u = rng.standard_normal(300)
        u[2:] += 2.0 * noise[:-2]
        y = (
            np.array(phc.forced_response(phc.ph(phc.modes(D, R)), STEP * np.arange(300), u, intersample="zoh").outputs)
            + noise
        )
        data.append((u, y))
    found = phc.residual_analysis(data, phc.ph(phc.modes(D, R)), dt=STEP)
    assert found.verdict == "related to later inputs: feedback in the recording"
    assert found.lags[np.argmax(np.abs(found.cross_correlation))] == -2


def test_a_free_motion_has_no_input_and_damping_shows_as_colour():
    data = recorded(samples=300, noise=0.05, free=True)
    found = phc.residual_analysis(data, phc.pem(data, 2, dt=STEP))
    assert found.verdict == "white" and "There was no input" in found.message
    assert np.isnan(found.cross_correlation).all() and np.isnan(found.response_p_value)
    assert found.outside[1] == 0 == found.expected_outside[1]
    assert "input " not in "".join(str(found).splitlines(keepends=True)[:6])
    t = STEP * np.arange(300)
    decaying = np.exp(-0.02 * t) * np.cos(0.7 * t) + 0.02 * np.random.default_rng(0).standard_normal(300)
    assert (
        phc.residual_analysis((None, decaying), phc.pem((None, decaying), 1, dt=STEP, structure="lossless")).verdict
        == "coloured"
    )


# --- the order -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("quantity", [QUANTITIES[2], *slowly(*QUANTITIES[:2])])
def test_the_order_is_found_in_data_of_every_kind(quantity):
    for data, options in (
        (experiments(quantity, noise=0.1), {"dt": STEP}),
        (recorded(quantity, noise=0.02, free=True, seed=3), {"dt": STEP}),
        (experiments(quantity, noise=0.1, offset=2.0), {"dt": STEP, "offset": True}),
        (response(quantity, noise=0.05), {}),
    ):
        selection = phc.order_selection(data, 4, quantity=quantity, holdout=0.3, **options)
        assert selection.orders.tolist() == [0, 1, 2, 3, 4]
        assert selection.chosen() == 2
        np.testing.assert_allclose(selection.frequencies[2], D, rtol=0.02)
        assert selection.stable[3].sum() == 2
        # one mode foretells nothing of the other
        assert selection.holdout[2] < 0.5 * selection.holdout[1]


def test_the_path_takes_one_mode_at_a_time_also_through_a_long_record():
    d = np.array([0.5, 1.1, 1.9, 2.6])
    rng = np.random.default_rng(0)
    u = rng.standard_normal(6000)
    y = phc.forced_response(
        phc.ph(phc.modes(d, np.ones(4))), STEP * np.arange(6000), u, return_states=False, intersample="zoh"
    ).outputs
    selection = phc.order_selection((u, y + 0.1 * rng.standard_normal(6000)), 6, dt=STEP)
    assert selection.orders.tolist() == list(range(7))
    assert selection.chosen() == 4
    np.testing.assert_allclose(selection.frequencies[4], d, rtol=1e-3)
    # each mode is refined over the bins about it: less than a unit of log-likelihood is as good
    assert np.all(6000 / 2 * np.diff(np.log(selection.loss)) < 0.5)


@pytest.mark.slow
@quick
@given(st.permutations(range(3)))
def test_the_order_of_experiments_changes_no_table(order):
    data = experiments(noise=0.2)
    one, other = (phc.order_selection([data[k] for k in places], 3, dt=STEP) for places in (range(3), order))
    for name in ("loss", "aic", "aicc", "bic"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-6)
    assert other.samples == one.samples == 450


def test_what_is_held_out_is_counted_in_every_kind_of_data():
    records = phc.order_selection(experiments(noise=0.1), 2, dt=STEP, holdout=0.3)
    assert records.held_out == 45 + 27 + 63
    spectral = phc.order_selection(response(noise=0.1), 2, holdout=0.25)
    assert spectral.held_out == 2 * 30 and spectral.samples == 240
    most = phc.order_selection(response(noise=0.1), 2, holdout=0.75)
    assert most.held_out == 2 * 90


@pytest.mark.slow
def test_models_of_the_rest_know_nothing_of_what_is_held_out():
    """With frequencies from all of the data, modes of noise would foretell part of the noise."""
    data = [recorded(samples=200, noise=0.3, seed=seed) for seed in range(6)]
    gained = []
    for u, y in data:
        losses = phc.order_selection((u, y), 4, dt=STEP, holdout=0.3).holdout
        gained.append(losses[4] / losses[2])
    # beyond the order of the plant every mode makes it worse
    assert np.median(gained) > 1.0


def test_options_of_the_path_are_those_of_a_fit_and_no_others():
    data = recorded(noise=0.1)
    told = []
    phc.order_selection(data, 2, dt=STEP, callback=told.append)
    assert {one.order for one in told} == {1, 2} and all(one.max_order == 2 for one in told)
    from_guess = phc.order_selection(data, 3, dt=STEP, initial_guess=(D, R))
    assert from_guess.orders.tolist() == [2, 3]
    for name in ("criterion", "max_order", "order"):
        with pytest.raises(TypeError, match="the orders to try are the argument orders"):
            phc.order_selection(data, 2, dt=STEP, **{name: 1})
    with pytest.raises(StructureError, match="quantity is 'force'"):
        phc.order_selection(data, 2, dt=STEP, quantity="force")
    with pytest.raises(IdentificationError, match="no observed outputs in what is held out; hold out more"):
        phc.order_selection((data[0], np.where(np.arange(150) < 100, data[1], np.nan)), 2, dt=STEP, holdout=0.2)

    def stop(progress):
        if progress.order == 2:
            raise StopIteration

    assert phc.order_selection(data, 4, dt=STEP, callback=stop).orders.tolist() == [0, 1, 2]


# --- pictures --------------------------------------------------------------------------------------------------------


def test_the_picture_of_a_response_shows_magnitude_phase_and_error():
    data, model = response("displacement", noise=0.05), sensed("displacement")
    plot = phc.compare(data, model, ct.tf([1.0], [1.0, 0.1, 4.0])).plot(Hz=True, gain_unit="m/N")
    assert plot.axes.shape == plot.lines.shape == (3, 1)
    G = data.frdata[0, 0]
    measured, first, _ = plot.lines[0, 0]
    np.testing.assert_allclose(measured.get_ydata(), 20 * np.log10(abs(G)))
    np.testing.assert_allclose(measured.get_xdata(), OMEGA / 2 / np.pi)
    np.testing.assert_allclose(first.get_ydata(), 20 * np.log10(abs(model(1j * OMEGA))))
    errors = {line.get_label(): line.get_ydata() for line in plot.lines[2, 0]}
    np.testing.assert_allclose(errors[first.get_label()], 20 * np.log10(abs(G - model(1j * OMEGA))))
    assert [axis.get_ylabel() for axis in plot.axes[:, 0]] == [
        "Magnitude [dB re 1 m/N]", "Phase [deg]", "Error [dB re 1 m/N]",
    ]  # fmt: skip
    assert plot.axes[2, 0].get_xlabel() == "Frequency [Hz]" and plot.axes[0, 0].get_xscale() == "linear"
    # phases about 0 and 180 degrees with noise on both sides: none is thrown to the other end
    phase = plot.lines[1, 0][0].get_ydata()
    assert np.max(np.abs(np.exp(1j * np.radians(phase)) - G / abs(G))) < 1e-9
    sure = phase[abs(G) > 0.3]
    assert np.all((np.abs(sure) < 30) | (np.abs(np.abs(sure) - 180) < 30))


def test_the_picture_of_an_experiment_is_that_of_the_one_asked_for():
    data = experiments(noise=0.1)
    found = phc.compare(data, phc.ph(phc.modes(D, R)), dt=STEP)
    plot = found.plot(experiment=1, detail=None)
    np.testing.assert_array_equal(plot.lines[0, 0][0].get_ydata(), data[1][1])
    assert plot.figure.get_suptitle() == "y, measured and simulated (experiment 2 of 3)"
    assert f"({found.experiments[1].fit_percent[0]:.2f} %)" in plot.lines[0, 0][1].get_label()
    both = phc.residual_analysis([response(noise=0.1), response(noise=0.1, seed=1)], sensed("velocity"))
    plot = both.plot(experiment=1)
    left = both.experiments[1].residuals
    np.testing.assert_allclose(plot.lines[0, 0][1].get_ydata(), 20 * np.log10(abs(left)))
    assert plot.axes[0, 0].get_title(loc="left") == "Residual over frequency (experiment 2 of 2)"
    assert plot.axes[1, 0].get_xlabel() == "Lag [points]"


def test_residuals_without_an_input_have_one_picture_and_axes_may_be_given():
    data = recorded(noise=0.1, free=True)
    free = phc.residual_analysis(data, phc.ph(phc.modes(D, R)), dt=STEP)
    assert free.plot().axes.shape == (1, 1)
    spectral = phc.residual_analysis(response(noise=0.1), sensed("velocity"))
    compared = phc.compare(response(noise=0.1), sensed("velocity"))
    for result, count in ((free, 1), (spectral, 2), (compared, 3)):
        figure, axes = plt.subplots(count)
        plot = result.plot(ax=axes)
        assert plot.figure is figure and list(plot.axes.ravel()) == list(np.atleast_1d(axes))
        with pytest.raises(StructureError, match="ax has 4 axes"):
            result.plot(ax=plt.subplots(4)[1])


def test_the_tables_list_experiments_and_say_how_many_more():
    data = [recorded(samples=40, noise=0.1, seed=k) for k in range(10)]
    text = str(phc.compare(data, sensed("velocity"), dt=STEP))
    assert text.splitlines()[0] == "Fit to 'y': 10 experiments, 400 samples; initial states estimated"
    assert text.splitlines()[-1] == "  and 2 more"
    report = str(phc.residual_analysis(data, sensed("velocity"), dt=STEP))
    assert "  experiments                  10, together" in report
    assert max(map(len, report.splitlines())) <= 100

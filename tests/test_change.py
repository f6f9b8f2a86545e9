"""Has the plant changed: modes of two fits, a new record at old parameters, a chart of many recordings."""

import functools

import control as ct
import numpy as np
import pytest
from ambient_plant import ambient
from hypothesis import given, settings
from hypothesis import strategies as st
from known import HELD
from scipy.signal import lfilter
from scipy.special import chdtrc
from scipy.stats import norm

import ph_control as phc
from ph_control import StructureError

STEP = 0.5
D, ZETA = np.array([1.0, 2.0]), np.array([0.01, 0.02])


def outputs(theta, u, state=(0.0, 0.0, 0.0, 0.0)):
    """Output of two modes by held inputs: theta is frequencies, damping ratios, residues (real, imaginary parts)."""
    d, zeta, re, im = np.reshape(theta, (4, 2))
    y, start = np.zeros(len(u)), np.reshape(state, (2, 2)) @ [1, 1j]
    for p, residue, beginning in zip(d * (-zeta + 1j * np.sqrt(1 - zeta**2)), re + 1j * im, start, strict=True):
        step = np.exp(p * STEP)
        driven = lfilter([0.0, 1.0], [1.0, -step], (step - 1) / p * residue * u)
        y += 2 * (driven + beginning * step ** np.arange(len(u))).real
    return y


def record(seed, d=D, noise=0.5, samples=600, plant=None, zeta=ZETA):
    """Input and noisy velocity of two modes."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    if plant is None:
        plant = phc.modes(d, [1.0, 1.0], damping=zeta).state_space()
    y = ct.forced_response(ct.c2d(ct.ss(plant), STEP), inputs=u).outputs
    return u, y + noise * rng.standard_normal(y.shape)


@functools.cache
def fitted():
    return phc.pem(record(0), 2, dt=STEP, structure="free")


# --- the score test --------------------------------------------------------------------------------------------------


def dense_test(result, u, y, tested=slice(0, 8)):
    """The same statistic by dense matrices: numerical derivatives, projection, weighted squares."""
    theta = np.concatenate([
        result.natural_frequencies, result.damping_ratios, result.residues.real.ravel(), result.residues.imag.ravel()
    ])  # fmt: skip
    motion = np.array([outputs(theta, 0 * u, unit) for unit in np.eye(4)] + [np.ones(len(u))]).T
    start = np.linalg.lstsq(motion, y - outputs(theta, u), rcond=None)[0]
    state = start[:4]

    def of(values):
        return outputs(values, u, state)

    e = y - of(theta) - start[4]
    J = np.array([(of(theta + h) - of(theta - h)) / (2 * h.sum()) for h in np.diag(1e-6 * np.maximum(theta, 0.01))]).T
    others = np.delete(J, np.arange(8)[tested], axis=1)
    everything = np.concatenate([J, motion], axis=1)
    left_over = e - everything @ np.linalg.lstsq(everything, e, rcond=None)[0]
    variance = left_over @ left_over / (len(e) - everything.shape[1])
    Q = np.linalg.qr(np.concatenate([others, motion], axis=1))[0]
    projected = J[:, tested] - Q @ (Q.T @ J[:, tested])
    z, F = projected.T @ e / variance, projected.T @ projected / variance
    C = result.covariance[:8, :8][tested, tested]
    change, spread = np.linalg.solve(F, z), np.linalg.inv(F) + C
    return z @ np.linalg.solve(F + F @ C @ F, z), change, np.sqrt(np.diag(spread))


@pytest.mark.parametrize("parameters, tested", [("all", slice(0, 8)), ("poles", slice(0, 4))])
def test_the_statistic_is_that_of_dense_matrices(parameters, tested):
    u, y = record(5, d=[1.0, 2.002])
    test = fitted().changed((u, y), parameters=parameters)
    statistic, change, error = dense_test(fitted(), u, y, tested)
    assert test.statistic == pytest.approx(statistic, rel=1e-4)
    assert test.dof == tested.stop and test.p == pytest.approx(chdtrc(test.dof, statistic), rel=1e-3)
    assert np.concatenate([test.frequency_shift, test.damping_shift]) == pytest.approx(change[:4], rel=1e-3)
    assert test.frequency_shift_stderr == pytest.approx(error[:2], rel=1e-4)
    assert test.damping_shift_stderr == pytest.approx(error[2:4], rel=1e-4)


def test_a_shift_of_three_in_a_thousand_is_seen_in_the_mode_that_has_it():
    test = fitted().changed(record(7, d=[0.997, 2.0]))
    assert test and test.changed and test.p < 1e-4
    assert test.modes.tolist() == [0]
    assert test.frequency_shift[0] == pytest.approx(-0.003, abs=4 * test.frequency_shift_stderr[0])
    assert abs(test.frequency_shift[1]) < 4 * test.frequency_shift_stderr[1]
    assert str(test).startswith("changed: chi-square") and "*" in str(test).splitlines()[2]
    assert test.hertz == pytest.approx(fitted().hertz)


@pytest.mark.slow
def test_a_record_of_the_same_plant_is_no_alarm_more_often_than_the_level_says():
    """With 20 records of one plant and 20 fits, 5 % are one; without the errors of the old fit nearly half alarm."""
    alarms, naive, known = 0, 0, {"intersample": "zoh", "delay": 0.0, "noise": "white"}
    for seed in range(20):
        result = phc.pem(record([seed, 0], samples=300), 2, dt=STEP, structure="free", **known)
        test = result.changed(record([seed, 1], samples=300))
        alarms += test.changed
        naive += chdtrc(test.dof, test.score @ np.linalg.solve(test.information, test.score)) < 0.05
    assert alarms <= 3 < naive


def test_initial_motion_and_constant_of_the_new_record_are_no_change():
    u, y = record(8)
    plain = fitted().changed((u, y))
    theta = np.concatenate([fitted().natural_frequencies, fitted().damping_ratios, np.zeros(4)])
    moved = y + 7.0 + outputs(theta, 0 * u, (0.02, -0.01, 0.01, 0.03))
    assert fitted().changed((u, moved)).statistic == pytest.approx(plain.statistic, rel=0.05)
    assert fitted().changed((u, moved + 20 * outputs(theta, 0 * u, (1.0, 0, 0, 2.0)))).p > 0.01


def test_a_gain_is_a_change_of_residues_and_none_of_poles():
    u, y = record(9)
    assert fitted().changed((u, 1.3 * y)).p < 1e-6
    assert fitted().changed((u, 1.3 * y), parameters="poles").p > 0.01


@pytest.mark.variants
@pytest.mark.parametrize("size, scale", [(1e-9, 1.0), (1e9, 1.0), (1.0, 1e-9), (1.0, 1e9)])
def test_units_do_not_count(size, scale):
    u, y = record(0)
    result = phc.pem((u, size * y), 2, dt=STEP * scale, structure="free")
    fresh, measured = record(11, d=[1.001, 2.0])
    expected = fitted().changed((fresh, measured))
    test = result.changed((fresh, size * measured))
    assert test.statistic == pytest.approx(expected.statistic, rel=1e-3)
    assert test.frequency_shift * scale == pytest.approx(expected.frequency_shift, rel=1e-3)


def test_missing_samples_count_as_less_of_the_record():
    u, y = record(12, d=[0.995, 2.0])
    holes = y.copy()
    holes[100:200] = np.nan
    whole, part = fitted().changed((u, y)), fitted().changed((u, holes))
    assert part.changed and part.frequency_shift_stderr[0] > whole.frequency_shift_stderr[0]


def test_the_level_is_what_modes_are_judged_by():
    test = fitted().changed(record(7, d=[0.9995, 2.0]), level=0.2)
    assert test.level == 0.2 and test.changed == (test.p < 0.2)
    assert test.modes.tolist() == np.flatnonzero(test.mode_p < 0.2).tolist()


@functools.cache
def frame():
    """Two inputs and two outputs."""
    return phc.spring_chain([1.0, 1.0], [1.0], ground=[1.0, 0.5], c=0.02, ground_c=0.01, port=[0, 1])


def channels(seed, plant=None, colour=0.0, shared=0.0, samples=800):
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((2, samples)), rng.standard_normal((2, samples))
    for k in range(1, samples):
        e[:, k] += colour * e[:, k - 1]
    y = phc.forced_response(plant or frame(), STEP * np.arange(samples), u, intersample="zoh").outputs
    return u, y + 0.3 * (e + shared * rng.standard_normal(samples))


@functools.cache
def stiffer():
    return phc.spring_chain([1.0, 1.0], [1.0], ground=[1.02, 0.5], c=0.02, ground_c=0.01, port=[0, 1])


@pytest.mark.variants
@pytest.mark.parametrize("noise, how", [("coloured", {"colour": 0.9}), ("correlated", {"shared": 2.0})])
def test_noise_of_other_kinds_is_whitened(noise, how):
    result = phc.pem(channels(0, **how), 2, dt=STEP, noise=noise, structure="free", **HELD)
    assert result.noise.colours is not None if noise == "coloured" else result.noise.covariance[0, 1] > 0
    same, other = (result.changed(channels(3, plant, **how)) for plant in (frame(), stiffer()))
    assert same.p > 0.01 and same.whiteness > 0.01
    assert other.p < 1e-3
    assert same.noise_ratio == pytest.approx([1.0, 1.0], abs=0.15)


def test_unmeasured_forces_are_no_change():
    def pushed(seed, plant):
        rng = np.random.default_rng(seed)
        u, w = rng.standard_normal((1, 2000)), 0.5 * rng.standard_normal((1, 2000))
        y = phc.forced_response(plant, STEP * np.arange(2000), np.concatenate([u, w]), intersample="zoh").outputs
        return u, y + 0.1 * rng.standard_normal(y.shape)

    result = phc.pem(pushed(0, frame()), 2, dt=STEP, noise="forces", **HELD)
    assert result.noise.forces is not None
    assert result.changed(pushed(1, frame())).p > 0.01
    assert result.changed(pushed(2, stiffer())).p < 1e-3


def test_outputs_alone_in_another_wind_are_no_change_and_a_softer_structure_is_one():
    result = phc.pem((None, ambient(0)), 3, dt=0.02, noise="forces")
    assert result.is_ambient
    same = result.changed((None, 1.7 * ambient(1)))
    assert same.dof == 6 and same.p > 0.01 and same.noise_ratio == pytest.approx([1.7] * 3, rel=0.1)
    softer = result.changed((None, ambient(2, hertz=np.array([3.4, 8.55, 11.9]))))
    assert softer.modes.tolist() == [1]
    assert softer.frequency_shift[1] / result.d[1] == pytest.approx(-0.0172, abs=0.01)


def test_a_decay_has_its_own_amplitudes():
    def decaying(seed, d, sizes):
        rng = np.random.default_rng(seed)
        theta = np.concatenate([d, ZETA, np.zeros(4)])
        return None, outputs(theta, np.zeros(500), sizes) + 0.02 * rng.standard_normal(500)

    result = phc.pem(decaying(0, D, (1.0, 0, 0, 1.0)), 2, dt=STEP, noise="white")
    assert result.changed(decaying(1, D, (0.3, 2.0, -1.0, 0.5))).p > 0.01
    test = result.changed(decaying(2, [1.0, 2.01], (0.3, 2.0, -1.0, 0.5)))
    assert test.modes.tolist() == [1] and test.dof == 4


def test_a_delay_that_was_estimated_is_that_of_the_new_record():
    def late(seed, d):
        u, y = record(seed, d=d, samples=603)
        return u[3:], y[:-3]

    result = phc.pem(late(0, D), 2, dt=STEP, quantity="free")
    assert result.delay[0] == pytest.approx(3 * STEP, abs=0.1)
    assert result.changed(late(1, D)).p > 0.01
    assert result.changed(late(2, [0.99, 2.0])).modes.tolist() == [0]


def test_real_poles_are_tested_too():
    def motor(seed, rate):
        return record(seed, plant=ct.tf([1.0], [1.0, rate]), noise=0.3)

    result = phc.pem(motor(0, 0.3), dt=STEP, real_poles=1, quantity="free")
    assert not result.order
    assert result.changed(motor(1, 0.3)).p > 0.01
    test = result.changed(motor(2, 0.36))
    assert test.real_pole_shift[0] == pytest.approx(-0.06, abs=4 * test.real_pole_shift_stderr[0])
    assert test.modes.tolist() == [0] and "real pole" in str(test)


def test_a_fit_to_a_frequency_response_tests_a_record_in_time():
    w = np.linspace(0.05, 3.0, 300)
    plant, rng = phc.modes(D, [1.0, 1.0], damping=ZETA).state_space(), np.random.default_rng(0)
    noise = 0.2 * (rng.standard_normal(300) + 1j * rng.standard_normal(300))
    result = phc.pem(ct.frd(plant(1j * w) + noise, w), 2, structure="free")
    same = result.changed(record(1), dt=STEP)
    assert same.p > 0.01 and np.isnan(same.noise_ratio).all()
    assert result.changed(record(1, d=[0.98, 2.0]), dt=STEP).changed


def test_what_cannot_be_tested_is_refused_with_the_reason():
    u, y = record(0)
    for data, reason in (
        ((u, np.stack([y, y])), "2 outputs; the fit has 1 and 1"),
        ((None, y), "0 inputs"),
        ((u, None), "no outputs"),
        ((u[:15], y[:15]), "15 observed samples"),
        ((0 * u, 0 * y), "none of the parameters"),
        (ct.frd([1.0, 2.0], [1.0, 2.0]), "1 experiments; pass one time record"),
    ):
        with pytest.raises(StructureError, match=reason):
            fitted().changed(data)
    with pytest.raises(StructureError, match="parameters is 'shapes'"):
        fitted().changed((u, y), parameters="shapes")
    with pytest.raises(StructureError, match="level is 2"):
        fitted().changed((u, y), level=2)
    grown = phc.pem(
        record(0, plant=ct.tf([1.0], [1.0, -0.02]), noise=0.1), 0, dt=STEP, real_poles=1, quantity="free", **HELD
    )
    with pytest.raises(StructureError, match="a pole that grows"):
        grown.changed((u, y))


def test_inputs_are_not_modified():
    u, y = record(3)
    before = u.copy(), y.copy()
    fitted().changed((u, y))
    assert np.array_equal(u, before[0]) and np.array_equal(y, before[1])


# --- two fits --------------------------------------------------------------------------------------------------------


@functools.cache
def later():
    return phc.pem(record(1, d=[0.99, 2.0]), 2, dt=STEP, structure="free")


def step_down(p):
    """Adjusted p-values by the definition of Holm: the largest of the products of all that are not larger."""
    m = len(p)
    order = sorted(range(m), key=lambda k: p[k])
    adjusted = [0.0] * m
    for rank, k in enumerate(order):
        adjusted[k] = min(1.0, max((m - j) * p[order[j]] for j in range(rank + 1)))
    return adjusted


def test_shifts_are_held_against_the_errors_of_both_fits():
    before, after = fitted(), later()
    comparison = before.compare(after)
    z = np.concatenate([comparison.frequency_z, comparison.damping_z])
    p = np.concatenate([comparison.frequency_p, comparison.damping_p])
    np.testing.assert_allclose(p, 2 * norm.sf(np.abs(z)), rtol=1e-12)
    assert comparison.pairs.tolist() == [[0, 0], [1, 1]] and comparison.shifted.tolist() == [0] and comparison.changed
    for name, z in (("natural_frequencies", comparison.frequency_z), ("damping_ratios", comparison.damping_z)):
        error = np.hypot(before.stderr[name], after.stderr[name])
        assert z == pytest.approx((getattr(after, name) - getattr(before, name)) / error)
    p = [*comparison.frequency_p, *comparison.damping_p]
    assert [*comparison.adjusted_frequency_p, *comparison.adjusted_damping_p] == pytest.approx(step_down(p))
    assert np.isnan(comparison.mac).all() and comparison.frequency_shift[0] == pytest.approx(-0.01, abs=0.002)
    table = str(comparison).splitlines()
    assert table[0] == "1 shift in 2 pairs of modes and poles" and "*" in table[2] and "*" not in table[3]


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=4), st.integers(0, 3))
def test_p_values_are_adjusted_together(shifts, where):
    """Fits whose errors are known: the arrays of the comparison are those of the definition, whatever the shifts."""
    base, changed = fitted(), np.array(fitted().poles)
    size = base.stderr["natural_frequencies"]
    changed *= 1 + np.resize(np.roll(shifts, where), 2) * 4 * size / base.natural_frequencies
    comparison = base.compare(phc.PEMResult(**{**_fields(base), "poles": changed}))
    p = np.concatenate([comparison.frequency_p, comparison.damping_p])
    adjusted = np.concatenate([comparison.adjusted_frequency_p, comparison.adjusted_damping_p])
    assert adjusted == pytest.approx(step_down(p.tolist()))
    assert np.all(adjusted >= p) and np.all(adjusted <= 1)


def _fields(result):
    return {field: getattr(result, field) for field in result.__dataclass_fields__ if field != "stderr"}


def test_a_mode_that_only_one_fit_has_is_listed():
    more = phc.pem(record(2, plant=phc.ph(phc.modes([1.0, 1.5, 2.0], [1.0, 0.5, 1.0], damping=0.01))), 3, dt=STEP)
    comparison = fitted().compare(more)
    assert comparison.pairs.tolist() == [[0, 0], [1, 2]] and comparison.only_after.tolist() == [1]
    assert comparison.hertz_only_after == pytest.approx(more.hertz[[1]]) and comparison.changed
    assert "only after: mode 2" in str(comparison) and "2 > 3" in str(comparison)
    assert more.compare(fitted()).only_before.tolist() == [1]


@pytest.mark.slow
def test_shapes_tell_modes_apart_whose_frequencies_have_crossed():
    def crossed(d, seed):
        shapes = np.array([[1.0, 0.9], [1.0, -0.8]])
        poles = np.array(d) * (-0.01 + 1j)
        return record(seed, plant=phc.modes(poles, shapes, [[0.5], [0.5]]).state_space(), noise=0.1)

    before, after = (phc.pem(crossed(d, k), 2, dt=STEP) for k, d in enumerate(([1.0, 1.05], [1.05, 1.0])))
    comparison = before.compare(after)
    assert comparison.pairs.tolist() == [[0, 1], [1, 0]] and np.all(comparison.mac > 0.99)
    assert comparison.frequency_shift == pytest.approx([0.05, -0.0476], abs=0.002)


def test_real_poles_are_paired_and_held_against_their_errors():
    def lag(seed, rate):
        return phc.pem(
            record(seed, plant=ct.tf([1.0], [1.0, rate]), noise=0.3), dt=STEP, real_poles=1, quantity="free", **HELD
        )

    before, after = lag(0, 0.3), lag(1, 0.4)
    comparison = before.compare(after)
    error = np.hypot(before.stderr["real_poles"], after.stderr["real_poles"])
    assert comparison.real_pole_z == pytest.approx((after.real_poles - before.real_poles) / error)
    assert comparison.adjusted_real_pole_p[0] < 1e-3 and comparison.changed and "real pole" in str(comparison)
    far = before.compare(lag(1, 1.5))
    assert far.real_poles_only_before.tolist() == [0] and far.real_poles_only_after.tolist() == [0]


def test_what_cannot_be_compared_is_refused():
    for other in (None, phc.ph(phc.modes(1.0, 1.0)), "fit"):
        with pytest.raises(StructureError, match="pass the result of another fit"):
            fitted().compare(other)
    for bounds in ({"frequency_tolerance": 0.0}, {"least_mac": 1.0}, {"level": 1.0}, {"frequency_tolerance": True}):
        with pytest.raises(StructureError, match=next(iter(bounds))):
            fitted().compare(later(), **bounds)


# --- many recordings -------------------------------------------------------------------------------------------------


@functools.cache
def monitored():
    """Six recordings, three of a structure 0.4 % softer, and one that cannot be fitted."""
    recordings = [record(20 + k, d=[1.0 if k < 4 else 0.996, 2.0], samples=400) for k in range(7)]
    return phc.fit_many([*recordings, (np.ones(3), np.ones(3))], order=2, dt=STEP, structure="free",
                        reference=fitted())  # fmt: skip


@pytest.mark.slow
def test_a_chart_of_many_recordings_alarms_where_the_plant_has_changed():
    chart = monitored().changes(false_alarms=0.01)
    assert chart.alarms.tolist() == [4, 5, 6] and chart.start == 4
    assert chart.false_alarm_rate == pytest.approx(0.01, rel=1e-3)
    assert chart.recordings.tolist() == list(range(7)) and [place for place, _ in chart.unavailable] == [7]
    expected = np.array([0.0] * 4 + [-0.004] * 3)
    assert np.all(np.abs(chart.frequency_shift[:, 0] - expected) < 4 * chart.frequency_shift_stderr[:, 0])
    assert chart.hertz == pytest.approx(fitted().hertz)
    assert "alarm at recording 4, begun at 4" in str(chart) and "recording 7 has no score" in str(chart)


def test_scores_need_no_fit_of_their_recording():
    """The second recording is too short for the order of its own fit, and is tested all the same."""
    short = record(30, samples=40)
    fits = phc.fit_many([short], order=9, dt=STEP, reference=fitted())
    assert len(fits.failures) == 1 and fits.changes().recordings.tolist() == [0]


@pytest.mark.slow
def test_without_a_reference_the_first_recording_is_one():
    chart = phc.fit_many(
        [record(20 + k, d=[1.0 if k < 5 else 0.99, 2.0], samples=400) for k in range(7)], order=2, dt=STEP
    ).changes()
    assert chart.recordings.tolist() == [1, 2, 3, 4, 5, 6] and chart.unavailable == ((0, "it is the reference"),)
    assert chart.alarms.tolist()[0] == 5


def test_the_limit_is_that_of_the_rate_of_false_alarms():
    """Runs of normal scores by random numbers: their mean length is the inverse of the rate that is said."""
    chart = monitored().changes(false_alarms=0.05, shift=1.0)
    rng, runs, q = np.random.default_rng(0), 4000, 4
    total, length, alive = np.zeros((runs, q)), np.zeros(runs), np.ones(runs, bool)
    while alive.any():
        moved = total + rng.standard_normal((runs, q))
        size = np.linalg.norm(moved, axis=1)
        total = moved * np.maximum(0.0, 1 - 0.5 / size)[:, None]
        length += alive
        alive &= np.linalg.norm(total, axis=1) <= chart.limit
    assert length.mean() == pytest.approx(20.0, rel=0.06)
    assert chart.false_alarm_rate == pytest.approx(0.05, rel=1e-3)


def test_the_picture_of_the_chart_has_the_sum_its_limit_and_the_shifts():
    plot = monitored().plot(kind="changes", title="Bridge")
    assert isinstance(plot, ct.ControlPlot) and plot.axes.shape == (2, 1)
    assert [axis.get_ylabel() for axis in plot.axes[:, 0]] == [
        "Cumulative sum of scores", "Change of natural frequency [%]"
    ]  # fmt: skip
    assert plot.lines[0, 0][0].get_ydata() == pytest.approx(monitored().changes().statistic)
    assert plot.lines[0, 0][1].get_ydata()[0] == pytest.approx(monitored().changes().limit)
    assert monitored().plot().axes.shape[0] > 1


def test_a_chart_of_nothing_and_bad_numbers_are_refused():
    with pytest.raises(StructureError, match="no recording can be held against a reference"):
        phc.fit_many([]).changes()
    for bad in ({"false_alarms": 0.0}, {"shift": -1.0}, {"false_alarms": True}):
        with pytest.raises(StructureError, match=next(iter(bad))):
            monitored().changes(**bad)
    with pytest.raises(StructureError, match="kind is 'scores'"):
        monitored().plot(kind="scores")
    with pytest.raises(StructureError, match="reference is"):
        phc.fit_many([record(0)], reference=fitted().system)

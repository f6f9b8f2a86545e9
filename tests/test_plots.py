"""Pictures: their numbers without drawing, and their artists."""

import itertools

import control as ct
import matplotlib
import matplotlib.pyplot as plt
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lossless import lossless_draws
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from slow import slowly

import ph_control as phc
from ph_control import (
    StructureError,
    bode_plot,
    fit_plot,
    frenkel_kontorova,
    lc_circuit,
    spectral_estimate,
    spring_chain,
)
from ph_control.analysis.spectral_estimate import SpectralEstimate
from ph_control.plotting.bode_plot import bode_data, features, frequency_grid
from ph_control.plotting.response_picture import Curve, FrequencyAxis, is_logarithmic
from ph_control.plotting.style import extremes

EPS = np.finfo(float).eps
quick = settings(deadline=None, max_examples=30, derandomize=True)
frequencies = st.lists(st.floats(0.01, 1000.0), min_size=1, max_size=12, unique=True)


def record(system, samples=8192, step=0.1, noise=0.0, seed=1, intersample="zoh"):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    response = phc.forced_response(system, step * np.arange(samples), u, intersample=intersample)
    y = response.outputs + noise * np.std(response.outputs) * rng.standard_normal(samples)
    return ct.TimeResponseData(response.time, y, inputs=u, issiso=True)


def fir_record(samples=16384, noise=0.5, seed=2):
    """A system that forgets: y_k = u_k + 0.5 u_{k-1} plus white noise of known size."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = u + 0.5 * np.concatenate([[0.0], u[:-1]]) + noise * rng.standard_normal(samples)
    return ct.TimeResponseData(np.arange(samples) * 1.0, y, inputs=u, issiso=True)


def legend_texts(axis):
    return [text.get_text() for text in axis.get_legend().get_texts()]


# --- the frequency grid ---


@quick
@given(frequencies)
def test_the_grid_resolves_every_mark_from_both_sides_and_meets_none(values):
    marks = np.sort(values)
    grid = frequency_grid(marks, 0.001, 10_000.0)
    assert np.all(np.diff(grid) > 0)
    assert (grid[0], grid[-1]) == (0.001, 10_000.0)
    assert not np.isin(grid, marks).any()
    for k, mark in enumerate(marks):
        gap = np.min(np.abs(np.delete(marks, k) - mark), initial=mark)
        if gap < 1e-6 * mark:
            continue
        for side in (grid[grid < mark], grid[grid > mark]):
            distance = np.abs(side - mark)
            assert distance.min() <= 1.1e-8 * mark
            assert np.sum(distance < 0.3 * gap) >= 10


@quick
@given(frequencies)
def test_between_two_neighbouring_marks_there_is_always_a_grid_point(values):
    marks = np.sort(values)
    grid = frequency_grid(marks, 0.001, 10_000.0)
    for low, high in itertools.pairwise(marks):
        if high - low > 1e-7 * high:
            assert np.any((grid > low) & (grid < high))


def test_the_grid_shows_both_peaks_of_two_modes_that_differ_by_one_in_a_million():
    sys = phc.ph(phc.modes([1.0, 1.000001], [1.0, 1.0]))
    grid = frequency_grid(features(sys)[0], 0.1, 10.0)
    phase = np.sign(sys(1j * grid).imag)
    # a pole, a zero, a pole: three changes of sign; a grid of 2000 points alone sees one
    assert np.count_nonzero(np.diff(phase)) == 3
    assert np.count_nonzero(np.diff(np.sign(sys(1j * np.geomspace(0.1, 10.0, 2000)).imag))) == 1


def test_the_grid_never_returns_an_infinite_or_vanishing_response():
    rng = np.random.default_rng(0)
    sys = phc.ph(phc.modes(10 ** rng.uniform(0, 3, 50), 10 ** rng.uniform(-3, 0, 50)))
    response = sys(1j * frequency_grid(features(sys)[0], 0.1, 1e4, exact=True))
    assert np.all(np.isfinite(response))
    assert np.all(response != 0)


def test_the_features_of_a_lossless_system_are_its_poles_and_zeros_also_as_a_plain_system():
    chain = frenkel_kontorova(4)
    expected = np.sort(np.concatenate([chain.d, chain.zeros().imag[chain.zeros().imag > 0]]))
    for sys in (chain, ct.ss(chain), ct.tf(chain)):
        everything, on_axis = features(sys)
        np.testing.assert_allclose(np.unique(everything.round(9)), expected, rtol=1e-8)
        np.testing.assert_allclose(on_axis, expected, rtol=1e-8)


def test_a_damped_resonance_is_a_feature_but_not_an_infinite_one():
    everything, on_axis = features(ct.tf([1], [1, 0.02, 1]))
    np.testing.assert_allclose(everything, [np.sqrt(1 - 1e-4), 1.0], rtol=1e-12)
    assert len(on_axis) == 0


def test_repeated_real_poles_are_features_at_their_size_and_not_at_the_rounding_of_their_imaginary_parts():
    marks, singular = features(ct.tf([20], [1, 3, 3, 1]))
    assert len(marks) and np.allclose(marks, 1.0, rtol=1e-3) and not len(singular)
    assert bode_plot(ct.tf([20], [1, 3, 3, 1])).axes[0, 0].get_xlim() == (0.1, 10.0)


def test_a_part_of_two_thousand_modes_is_drawn_as_finely_as_a_small_system():
    sys = phc.modes(0.5 * np.arange(1, 2001), 2.0 / np.arange(1, 2001))
    numbers = bode_data(sys, [500.1, 510.1])
    (curve,) = numbers.curves
    assert curve.crowds(numbers.axis) == []
    between = np.count_nonzero((curve.omega > 504.0) & (curve.omega < 504.5))
    # 30 points on each side of a pole and of the zero between two of them
    assert between >= 4 * 29


def test_the_median_of_a_crowd_is_that_over_frequency_not_over_samples():
    # three of five samples crowd behind every second one, with a quarter of the axis to themselves
    even = np.geomspace(1.0, 10.0, 6001)
    crowded = np.concatenate([even[::2] * (1 + k * 1e-7) for k in (1, 2, 3)])
    omega = np.concatenate([even, crowded])
    level = np.repeat([0.0, 5.0], [len(even), len(crowded)])[np.argsort(omega)]
    curve = Curve("c", np.sort(omega), np.ones((1, 1, len(omega))), np.geomspace(1.0, 10.0, 5000))
    assert np.median(level) == 5.0
    x, middle = curve.typical(level, FrequencyAxis(1.0, 10.0, 1.0, ""))
    assert np.isnan(middle[-1]) and (np.diff(x) > 0).all()
    assert len(x) > 100 and (middle[:-1] == 0.0).all()


def test_the_grid_has_three_to_thirty_points_on_each_side_of_a_mark_by_their_number_in_the_picture():
    def per_side(marks, low, high):
        grid = frequency_grid(marks, low, high, count=2)
        middle = marks[len(marks) // 2]
        following = marks[len(marks) // 2 + 1]
        return np.count_nonzero((grid > middle) & (grid <= 0.5 * (middle + following)))

    many = np.linspace(1.0, 100.0, 5000)
    assert per_side(many, 0.1, 1000.0) == 3
    assert per_side(many, 50.0, 51.0) == 30
    assert per_side(np.linspace(1.0, 100.0, 300), 0.1, 1000.0) == 20


def test_a_discrete_time_system_has_its_features_where_the_continuous_one_has_them():
    continuous = ct.tf([1], [1, 0.1, 4])
    sampled = ct.sample_system(continuous, 0.05)
    assert np.min(np.abs(features(sampled)[0] - 2.0)) < 1e-9


def test_points_near_a_mark_are_told_by_their_part_of_the_gap():
    marks = np.array([1.0, 3.0])
    x = np.array([0.97, 0.99, 1.03, 1.05, 2.0, 2.95, 2.97, 3.1, 100.0])
    expected = [True, False, False, True, True, True, False, True, True]
    curve = Curve("", x, np.ones((1, 1, len(x))), marks)
    assert curve.visible(FrequencyAxis(0.9, 110.0, 1.0, "")).tolist() == expected
    assert Curve("", x, curve.response, np.zeros(0)).visible(FrequencyAxis(0.9, 110.0, 1.0, "")).all()


# --- phase and magnitude ---


@pytest.mark.slow
@quick
@given(frequencies, st.integers(0, 2**32 - 1))
def test_the_phase_of_a_one_port_is_exactly_plus_or_minus_90_degrees(values, seed):
    weights = np.random.default_rng(seed).uniform(0.1, 10.0, len(values))
    plot = bode_plot(phc.modes(values, weights))
    phase = plot.lines[1, 0][0].get_ydata()
    plt.close(plot.figure)
    assert set(phase.tolist()) == {-90.0, 90.0}


def test_the_phase_steps_at_each_pole_and_zero_and_nowhere_else():
    chain = frenkel_kontorova()
    line = bode_plot(chain).lines[1, 0][0]
    steps = line.get_xdata()[:-1][np.diff(line.get_ydata()) != 0]
    np.testing.assert_allclose(steps, [chain.d[0], 1.0, chain.d[1]], rtol=1e-11)


def test_a_pole_at_zero_starts_the_phase_at_minus_90_degrees():
    phase = bode_plot(spring_chain([1.0, 2.0, 3.0])).lines[1, 0][0].get_ydata()
    assert (phase[0], phase[-1]) == (-90.0, -90.0)
    assert set(phase.tolist()) == {-90.0, 90.0}


def test_the_magnitude_is_twenty_times_the_decimal_logarithm():
    plot = bode_plot(phc.modes(2.0, 0.5), [1.0, 1.5, 1.75])
    expected = 20 * np.log10([1 / 3, 1.5 / 1.75, 1.75 / (4 - 1.75**2)])
    np.testing.assert_allclose(plot.lines[0, 0][0].get_ydata(), expected, rtol=1e-14)


def test_a_frequency_on_a_pole_or_zero_leaves_a_gap_and_no_warning():
    plot = bode_plot(phc.ph(phc.modes([1.0, 3.0], [1.0, 1 / 3])), [0.5, 1.0, np.sqrt(5.0), 3.0, 4.0])
    for row in (0, 1):
        w, values = plot.lines[row, 0][0].get_data()
        assert np.isnan(values[np.isin(w, [1.0, 3.0])]).all()
        assert np.isfinite(values[np.isin(w, [0.5, 4.0])]).all()


def test_the_phase_of_an_ordinary_system_is_continuous_past_minus_180_degrees():
    phase = bode_plot(ct.tf([1], [1, 3, 3, 1])).lines[1, 0][0].get_ydata()
    assert phase[-1] < -250.0
    assert np.max(np.abs(np.diff(phase))) < 5.0


def test_a_lossless_system_in_plain_form_keeps_the_phase_between_the_same_two_levels():
    phase = bode_plot(ct.tf(frenkel_kontorova())).lines[1, 0][0].get_ydata()
    np.testing.assert_allclose(np.abs(phase), 90.0, atol=1e-4)


def test_infinite_peaks_leave_the_picture_and_everything_between_them_is_in_it():
    rng = np.random.default_rng(0)
    sys = phc.ph(phc.modes(10 ** rng.uniform(0, 3, 50), 10 ** rng.uniform(-3, 0, 50)))
    plot = bode_plot(sys)
    low, high = plot.axes[0, 0].get_ylim()
    w, level = plot.lines[0, 0][0].get_data()
    for pole in sys.d:
        assert level[np.argmin(np.abs(w - pole))] > high
    zeros = sys.zeros().imag
    for zero in zeros[zeros > 0]:
        assert level[np.argmin(np.abs(w - zero))] < low
    halfway = np.sqrt(sys.d[:-1] * sys.d[1:])
    clear = np.min(np.abs(halfway[:, None] - zeros), axis=1) > 0.1 * np.diff(sys.d)
    # four decades in a picture: closer ones are a single line
    clear &= np.diff(sys.d) > 0.02 * halfway
    assert clear.sum() > 5
    between = 20 * np.log10(np.abs(sys(1j * halfway[clear])))
    assert np.all((between > low) & (between < high))
    assert high - low < 100.0


def test_two_resonances_that_a_picture_cannot_part_do_not_flatten_it():
    plain, paired = (phc.modes(d, np.ones(len(d))) for d in ([1.0, 10.0], [1.0, 3.0, 3.0 + 1e-9, 10.0]))
    (_, high), (_, paired_high) = (bode_plot(sys).axes[0, 0].get_ylim() for sys in (plain, paired))
    assert paired_high < high + 10.0
    # halfway between the two it is a hundred times as high
    assert 20 * np.log10(np.abs(paired.freqresp([3.0 + 2e-10])))[0] > high + 100.0
    # until one looks closely
    zoomed = bode_plot(paired, omega_limits=[3.0 - 1e-9, 3.0 + 2e-9])
    assert zoomed.axes[0, 0].get_ylim()[1] > 150.0


def test_a_lone_measured_point_does_not_flatten_the_picture_but_a_measured_resonance_is_in_it():
    chain, w = frenkel_kontorova(), np.geomspace(0.1, 10.0, 200) * 1.0001
    response = chain(1j * w)
    usual = bode_plot(chain, data=ct.frd(response, w)).axes[0, 0].get_ylim()
    for factor in (1e12, 1e-12):
        wrong = response.copy()
        wrong[17] *= factor
        np.testing.assert_allclose(bode_plot(chain, data=ct.frd(wrong, w)).axes[0, 0].get_ylim(), usual, atol=1.0)
    twice = bode_plot(chain, data=ct.frd(10 * response, w)).axes[0, 0].get_ylim()
    assert twice[1] >= 20 * np.log10(10 * np.abs(response).max())


@pytest.mark.slow
def test_a_finite_peak_is_in_the_picture():
    plot = bode_plot([frenkel_kontorova(), ct.tf([1, 0], [1, 1e-4, 1])])
    assert plot.axes[0, 0].get_ylim()[1] > 80.0
    assert plot.axes[0, 0].get_ylim()[1] < 100.0


# --- artists of the Bode plot ---


def test_states_of_very_different_sizes_cost_a_plain_state_space_no_digits():
    M, K = 2.5e5 * np.eye(8), 3e8 * (2 * np.eye(8) - np.eye(8, k=1) - np.eye(8, k=-1))
    C, (first, *_, last) = 0.1 * M + 2e-3 * K, np.eye(8)
    building = phc.from_second_order(M, K, first, C=C, sensors={"displacement": last})
    omega = np.array([3.0, 10.0, 60.0])
    exact = [last @ np.linalg.solve(K + 1j * w * C - w**2 * M, first) for w in omega]
    plot = bode_plot(ct.ss(building)[1, 0], omega)
    np.testing.assert_allclose(plot.lines[0, 0][0].get_ydata(), 20 * np.log10(np.abs(exact)), atol=1e-9)
    plt.close(plot.figure)


def test_the_axes_name_their_quantities_and_units():
    plot = bode_plot(frenkel_kontorova())
    assert isinstance(plot, ct.ControlPlot)
    assert plot.axes.shape == plot.lines.shape == (2, 1)
    labels = [axis.get_ylabel() for axis in plot.axes[:, 0]]
    assert labels == ["Magnitude [dB]", "Phase [deg]"]
    assert plot.axes[1, 0].get_xlabel() == "Frequency [rad/time]"
    assert bode_plot(frenkel_kontorova(), gain_unit="m/s/N").axes[0, 0].get_ylabel() == "Magnitude [dB re 1 m/s/N]"


@pytest.mark.variants
@pytest.mark.parametrize(("limits", "labels"), [([6, 80], {"10", "20", "60"}), ([2.8, 3.6], {"3"}), ([0.2, 3], {"1"})])
def test_a_narrow_range_of_frequencies_is_labelled_in_plain_numbers(limits, labels):
    plot = bode_plot(phc.modes([3.0, 10.0], [1.0, 1.0]), omega_limits=limits)
    plot.figure.canvas.draw()
    axis = plot.axes[1, 0].xaxis
    texts = {tick.get_text() for tick in (*axis.get_ticklabels(), *axis.get_ticklabels(minor=True))} - {""}
    if matplotlib.__version_info__ < (3, 11):
        labels = labels - {"20", "60"}  # older ones label decades alone where one is in the range
    assert labels <= texts and not any("$" in text for text in texts)
    plt.close(plot.figure)


def test_in_hertz_the_axis_says_so_and_the_curve_is_the_same():
    chain = frenkel_kontorova()
    plot = bode_plot(chain, Hz=True, omega_limits=[0.05, 0.5])
    assert plot.axes[1, 0].get_xlabel() == "Frequency [Hz]"
    np.testing.assert_allclose(plot.axes[1, 0].get_xlim(), [0.05, 0.5])
    f, level = plot.lines[0, 0][0].get_data()
    np.testing.assert_allclose(level, 20 * np.log10(np.abs(chain(2j * np.pi * f))), atol=0.01)


def test_frequencies_are_labelled_per_unit_of_time():
    sys = frenkel_kontorova()
    plot = bode_plot(sys, data=record(sys, 2048, step=0.2), time_unit="ms")
    assert plot.axes[1, 0].get_xlabel() == "Frequency [rad/ms]"
    assert legend_texts(plot.axes[0, 0])[-1] == "Nyquist frequency (15.71 rad/ms)"
    in_hertz = bode_plot(sys, data=record(sys, 2048, step=0.2), Hz=True)
    assert legend_texts(in_hertz.axes[0, 0])[-1] == "Nyquist frequency (2.5 Hz)"
    assert "Frequency [rad/\\$]" == bode_plot(sys, time_unit="$").axes[1, 0].get_xlabel()
    in_ms = bode_plot(sys, data=record(sys, 2048, step=0.2), Hz=True, time_unit="ms")
    assert legend_texts(in_ms.axes[0, 0])[-1] == "Nyquist frequency (2500 Hz)"
    with pytest.raises(StructureError, match=r"Hz needs a known unit of time.*time_unit is 'days'.*use Hz=False"):
        bode_plot(sys, Hz=True, time_unit="days")


def test_several_Nyquist_frequencies_share_a_legend_entry():
    sampled = [ct.tf([1.0], [1.0, -0.5], step) for step in (0.1, 0.5)]
    plot = bode_plot(sampled, [0.1, 100.0])
    assert legend_texts(plot.axes[0, 0])[2:] == ["Nyquist frequency (6.283, 31.42 rad/time)"]


def test_systems_without_a_name_are_called_models():
    data = ct.frd([1.0, 2.0], [1.0, 2.0])
    for sys in (phc.ph(phc.modes(1.0, 1.0)), phc.modes(1.0, 1.0)):
        assert legend_texts(bode_plot(sys, data=data).axes[0, 0]) == ["model", "data"]
        assert legend_texts(bode_plot([sys], data=data, label="mine").axes[0, 0]) == ["mine", "data"]
    named = phc.ph(phc.modes(1.0, 1.0), name="mode")
    assert legend_texts(bode_plot(named, data=data).axes[0, 0]) == ["mode", "data"]
    two = [phc.ph(phc.modes(1.0, 1.0)), phc.ph(phc.modes(2.0, 1.0))]
    assert legend_texts(bode_plot(two).axes[0, 0]) == ["model #1", "model #2"]
    plain = ct.tf([1], [1, 1])
    assert legend_texts(bode_plot(plain, data=data).axes[0, 0]) == ["model", "data"]


@pytest.mark.parametrize(
    "sys",
    [
        phc.modes([1.0, 2.0], [0.0, 0.0]),
        ct.tf([0], [1, 0.5], 0.1),
        *slowly(ct.tf([0], [1, 1]), ct.ss([[-1.0]], [[1.0]], [[0.0]], [[0.0]])),
    ],
    ids=["modes", "sampled", "tf", "ss"],
)
def test_a_system_that_does_not_respond_is_called_zero_in_the_legend(sys):
    plot = bode_plot(sys, label="model", omega_limits=[0.1, 10.0])
    plot.figure.canvas.draw()
    assert legend_texts(plot.axes[0, 0]) == ["model: zero"]
    assert plot.legend is plot.axes[0, 0].get_legend()
    pair = bode_plot([sys, ct.tf([1], [1, 1])], label=["still", "lag"], omega_limits=[0.1, 10.0])
    assert legend_texts(pair.axes[0, 0]) == ["still: zero", "lag"]


def test_a_system_without_a_name_that_does_not_respond_is_the_zero_model():
    sys = phc.ph(phc.modes([1.0, 2.0], [0.0, 0.0]))
    assert legend_texts(bode_plot(sys).axes[0, 0]) == ["model: zero"]
    assert legend_texts(bode_plot(sys, data=record(frenkel_kontorova(), 512)).axes[0, 0])[0] == "model: zero"
    # a faint response is not none
    assert bode_plot(phc.ph(phc.modes([1.0, 2.0], [0.0, 1e-200]))).legend is None


def test_two_frequencies_are_limits_and_more_are_the_grid():
    chain = frenkel_kontorova()
    limited = bode_plot(chain, [0.2, 3.0])
    assert limited.axes[0, 0].get_xlim() == (0.2, 3.0)
    assert len(limited.lines[0, 0][0].get_xdata()) > 500
    given = bode_plot(chain, [0.2, 0.5, 3.0])
    w = given.lines[0, 0][0].get_xdata()
    assert w[np.isfinite(w)].tolist() == [0.2, 0.5, 3.0]


def test_the_line_breaks_where_frequencies_of_ones_own_straddle_a_pole_or_zero():
    chain = frenkel_kontorova()
    w = np.geomspace(0.1, 10.0, 40)
    for row in (0, 1):
        x, y = bode_plot(chain, w).lines[row, 0][0].get_data()
        assert np.isnan(x).sum() == np.isnan(y).sum() == 3
        for mark in (chain.d[0], 1.0, chain.d[1]):
            k = np.searchsorted(w, mark)
            place = np.flatnonzero(x == w[k])[0]
            assert np.isnan(x[place - 1]) and x[place - 2] == w[k - 1]
    # a line between two frequencies that have each a break beside them would not be seen
    assert bode_plot(chain, w).lines[0, 0][0].get_marker() == "."
    assert bode_plot(chain).lines[0, 0][0].get_marker() == "None"


def test_frequencies_that_come_close_to_a_peak_from_both_sides_need_no_break():
    chain = frenkel_kontorova()
    grid = frequency_grid(features(chain)[0], 0.1, 10.0)
    assert np.isfinite(bode_plot(chain, grid).lines[0, 0][0].get_xdata()).all()


def test_measured_responses_have_no_breaks():
    w = np.geomspace(0.1, 10.0, 40)
    x = bode_plot(ct.frd(frenkel_kontorova()(1j * w), w)).lines[0, 0][0].get_xdata()
    assert x.tolist() == w.tolist()


@pytest.mark.variants
@pytest.mark.parametrize("n", [5, 20, 100])
def test_all_changes_of_the_reactance_are_drawn_and_the_curve_agrees_with_mpmath(n):
    rng = np.random.default_rng(n)
    d, r = np.sort(10 ** rng.uniform(0, 2, n)), 10 ** rng.uniform(-2, 0, n)
    plot = bode_plot(phc.ph(phc.modes(d, r)))
    (w, level), phase = plot.lines[0, 0][0].get_data(), plot.lines[1, 0][0].get_ydata()
    assert set(phase.tolist()) == {-90.0, 90.0}
    assert np.count_nonzero(np.diff(phase)) == 2 * n - 1
    assert np.isfinite(level).all()
    # no break, so no gap either: the samples come close to every pole and zero from both sides
    marks = features(phc.ph(phc.modes(d, r)))[0]
    beside = np.searchsorted(w, rng.choice(marks, min(len(marks), 40), replace=False))
    chosen = range(len(w)) if n == 5 else {*rng.integers(0, len(w), 100), *beside, *(beside - 1)}
    with mpmath.workdps(40):
        for k in chosen:
            x = mpmath.mpf(w[k])
            G = sum(mpmath.mpf(b) * mpmath.mpf(a) * x / (mpmath.mpf(a) ** 2 - x**2) for a, b in zip(d, r, strict=True))
            assert np.sign(float(G)) == np.sign(phase[k])
            # a relative error of 1e-12 in decibels, and the rounding of the decibels themselves
            assert abs(level[k] - float(20 * mpmath.log10(abs(G)))) <= 20 / np.log(10) * 1e-12 + 4 * EPS * abs(level[k])


@pytest.mark.variants
@pytest.mark.parametrize("gap", [1e-9, 1e-12, 1e-13, 1e-14, 3e-15])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_modes_that_differ_in_their_last_digits_change_the_phase_as_well(gap, scale):
    d, r = scale * np.array([1.0, 1.0 + gap, 7.0]), [2.0, 1.0, 0.5]
    plot = bode_plot(phc.ph(phc.modes(d, r)))
    (w, level), phase = plot.lines[0, 0][0].get_data(), plot.lines[1, 0][0].get_ydata()
    assert set(phase.tolist()) == {-90.0, 90.0} and np.isfinite(level).all()
    assert np.count_nonzero(np.diff(phase)) == 5
    with mpmath.workdps(60):
        for k in np.flatnonzero((w >= d[0] * (1 - 1e-11)) & (w <= d[1] * (1 + 1e-11))):
            x = mpmath.mpf(w[k])
            G = sum(mpmath.mpf(b) * mpmath.mpf(a) * x / (mpmath.mpf(a) ** 2 - x**2) for a, b in zip(d, r, strict=True))
            assert np.sign(float(G)) == np.sign(phase[k])
            assert abs(level[k] - float(20 * mpmath.log10(abs(G)))) <= 20 / np.log(10) * 1e-12 + 4 * EPS * abs(level[k])


def test_magnitudes_and_phases_can_be_drawn_in_other_units():
    chain = frenkel_kontorova()
    decibels, absolute = bode_plot(chain), bode_plot(chain, dB=False, deg=False, gain_unit="m/s/N")
    np.testing.assert_allclose(
        absolute.lines[0, 0][0].get_ydata(), 10 ** (decibels.lines[0, 0][0].get_ydata() / 20), rtol=1e-12
    )
    np.testing.assert_allclose(absolute.axes[0, 0].get_ylim(), 10 ** (np.array(decibels.axes[0, 0].get_ylim()) / 20))
    assert absolute.axes[0, 0].get_yscale() == "log"
    assert absolute.axes[0, 0].get_ylabel() == "Magnitude [m/s/N]"
    assert set(absolute.lines[1, 0][0].get_ydata().tolist()) == {-np.pi / 2, np.pi / 2}
    assert absolute.axes[1, 0].get_ylabel() == "Phase [rad]"
    absolute.figure.canvas.draw()
    assert "0.5π" in [text.get_text() for text in absolute.axes[1, 0].get_yticklabels()]


@pytest.mark.parametrize("dB", [True, False])
@pytest.mark.parametrize("deg", [True, False])
def test_margins_are_drawn_and_told(dB, deg):
    chain, lag = phc.frenkel_kontorova(name="chain"), ct.tf([20], [1, 3, 3, 1], name="lag")
    plot = bode_plot([chain, lag], display_margins=True, dB=dB, deg=deg)
    gm, pm, wcg, wcp = ct.margin(lag)
    _, ours, _, crossing = phc.margin(chain)
    told = [text.get_text() for text in plot.axes[0, 0].texts]
    assert told == [
        f"chain: gain margin inf, phase margin {ours:.4g}° at {crossing:.4g} rad/time\n"
        f"lag: gain margin {20 * np.log10(gm):.4g} dB at {wcg:.4g} rad/time, "
        f"phase margin {pm:.4g}° at {wcp:.4g} rad/time"
    ]
    vertical = [
        [line.get_xydata() for line in axis.lines if len(line.get_xdata()) == 2 and np.ptp(line.get_xdata()) == 0]
        for axis in plot.axes[:, 0]
    ]
    (gain,) = vertical[0]
    assert np.allclose(gain[0], [wcg, -20 * np.log10(gm) if dB else 1 / gm]) and gain[1][1] == (0.0 if dB else 1.0)
    turn = 1.0 if deg else np.pi / 180
    assert np.allclose(vertical[1][0], [[crossing, -180.0 * turn], [crossing, (ours - 180.0) * turn]])
    assert np.allclose(vertical[1][1], [[wcp, -180.0 * turn], [wcp, (pm - 180.0) * turn]])
    assert plot.axes[1, 0].get_ylim()[0] < -180.0 * turn
    assert (
        bode_plot(2.0 * chain, display_margins=True, plot_phase=False).axes[0, 0].texts[0].get_text().startswith("gain")
    )


def test_margins_are_those_of_one_port():
    with pytest.raises(StructureError, match=r"margins are those of one port; the systems have 2 outputs and 2 inputs"):
        bode_plot(phc.ph(np.eye(4), np.eye(4)[:, 2:]), display_margins=True)


def test_phases_are_continuous_unless_they_are_wrapped():
    three = ct.tf([1], [1, 3, 3, 1]) * ct.tf([1], [1, 3, 3, 1])
    whole, wrapped = (bode_plot(three, wrap_phase=wrap).lines[1, 0][0].get_ydata() for wrap in (False, True))
    assert whole.min() < -500.0 and -180.0 <= wrapped.min() and wrapped.max() <= 180.0
    assert np.allclose(np.mod(whole - wrapped + 1.0, 360.0), 1.0, atol=1e-9)


@pytest.mark.parametrize("row", ["magnitude", "phase"])
def test_magnitude_or_phase_alone_can_be_drawn(row):
    both = bode_plot(frenkel_kontorova())
    one = bode_plot(frenkel_kontorova(), plot_magnitude=row == "magnitude", plot_phase=row == "phase")
    assert one.axes.shape == (1, 1)
    kept = 0 if row == "magnitude" else 1
    assert np.array_equal(one.lines[0, 0][0].get_ydata(), both.lines[kept, 0][0].get_ydata())
    assert one.axes[0, 0].get_ylabel() == both.axes[kept, 0].get_ylabel()
    assert one.axes[0, 0].get_xlabel() == "Frequency [rad/time]"


def test_the_number_of_frequencies_can_be_chosen():
    few, many = (len(bode_plot(frenkel_kontorova(), omega_num=k).lines[0, 0][0].get_xdata()) for k in (10, 2000))
    assert 1900 < many - few <= 1990


def test_style_keywords_of_python_control_reach_the_picture():
    chain = frenkel_kontorova(name="chain")
    before = dict(plt.rcParams.copy())
    plot = bode_plot(chain, color="C7", linestyle="-.", linewidth=3.0, show_legend=True, grid=False,
                     rcParams={"axes.labelsize": 21.0})  # fmt: skip
    line = plot.lines[0, 0][0]
    assert (line.get_color(), line.get_linestyle(), line.get_linewidth()) == ("C7", "-.", 3.0)
    assert [text.get_text() for text in plot.legend.get_texts()] == ["chain"]
    assert plot.axes[0, 0].yaxis.label.get_size() == 21.0
    assert not plot.axes[0, 0].xaxis.get_gridlines()[0].get_visible()
    assert bode_plot(chain).axes[0, 0].xaxis.get_gridlines()[0].get_visible()
    assert dict(plt.rcParams.copy()) == before
    assert bode_plot([chain, chain], legend_loc=False).legend is None
    assert bode_plot([chain, chain], show_legend=False).legend is None
    assert bode_plot([chain, chain], legend_loc="lower left").legend._loc_real == 3


# --- bands ---


def drawn_models(k=200, spread=0.01, seed=3):
    rng = np.random.default_rng(seed)
    d, r = np.array([1.0, 3.0]), np.array([1.0, 0.5])
    return lossless_draws(*(x * (1 + spread * rng.standard_normal((k, 2))) for x in (d, r)))


def bands_of(axis):
    return [artist for artist in axis.collections if "band" in str(artist.get_label())]


def test_the_band_is_that_of_the_models_under_its_curve():
    models = drawn_models()
    plot = bode_plot(phc.modes([1.0, 3.0], [1.0, 0.5]), confidence=models, level=0.9)
    assert legend_texts(plot.axes[0, 0]) == ["model", "90 % band"]
    for row, band_of in enumerate((lambda w: 20 * np.log10(models.magnitude_band(w, 0.9)), models.phase_band)):
        (band,) = bands_of(plot.axes[row, 0])
        vertices = band.get_paths()[0].vertices
        assert np.allclose(band.get_facecolor()[0, :3], to_rgb(plot.lines[row, 0][0].get_color()))
        w = np.unique(vertices[:, 0])
        low, high = band_of(w)
        for x, bottom, top in list(zip(w, low, high, strict=True))[1:-1:37]:
            ends = vertices[vertices[:, 0] == x, 1]
            np.testing.assert_allclose([ends.min(), ends.max()], [bottom, top], rtol=1e-9)


def test_the_band_reaches_across_the_poles_and_the_picture_holds_its_curve():
    plot = bode_plot(phc.modes([1.0, 3.0], [1.0, 0.5]), confidence=drawn_models(spread=0.1))
    vertices = bands_of(plot.axes[0, 0])[0].get_paths()[0].vertices
    assert np.isfinite(vertices).all()
    alone = bode_plot(phc.modes([1.0, 3.0], [1.0, 0.5]))
    (low, high), (bottom, top) = (picture.axes[0, 0].get_ylim() for picture in (plot, alone))
    assert low <= bottom and high >= top and high - low < 2 * (top - bottom)


def test_a_result_of_a_fit_draws_its_own_band_always_the_same():
    rng = np.random.default_rng(0)
    plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(300)
    y = phc.forced_response(plant, 0.1 * np.arange(300), u, intersample="zoh").outputs + 0.3 * rng.standard_normal(300)
    result = phc.pem((u, y), 1, dt=0.1)
    one, other = (bode_plot([result, plant], confidence=result) for _ in range(2))
    first, second = (bands_of(plot.axes[0, 0])[0].get_paths()[0].vertices for plot in (one, other))
    assert np.array_equal(first, second)
    level = one.lines[0, 0][0].get_ydata()
    np.testing.assert_array_equal(level, bode_plot(result.system).lines[0, 0][0].get_ydata()[: len(level)])
    listed = bode_plot([plant, result], confidence=[None, result])
    assert len(bands_of(listed.axes[0, 0])) == 1


@pytest.mark.variants
@pytest.mark.parametrize("draw", [bode_plot, lambda *systems, **k: phc.step_plot(*systems, 5.0, **k)])
def test_true_stands_for_the_bands_of_the_fits_in_the_picture(draw):
    chain = frenkel_kontorova()
    fit = phc.pem(record(chain, samples=300, noise=0.1), 2)
    (given,), (asked,) = (bands_of(draw([chain, fit], confidence=c).axes[0, 0]) for c in ([None, fit], True))
    np.testing.assert_array_equal(given.get_paths()[0].vertices, asked.get_paths()[0].vertices)


@pytest.mark.variants
@pytest.mark.parametrize("quantity", ["displacement", "acceleration"])
def test_a_fit_of_another_quantity_is_drawn_as_that_with_its_band(quantity):
    chain = frenkel_kontorova()
    omega = np.linspace(0.1, 3.0, 200)
    turn = 1j * omega if quantity == "acceleration" else 1 / (1j * omega)
    rng = np.random.default_rng(0)
    measured = chain.modes.freqresp(omega) * turn + 0.02 * rng.standard_normal(200) + 0.02j * rng.standard_normal(200)
    data = ct.frd(measured, omega, smooth=False)
    fit = phc.pem(data, 2, quantity=quantity)
    plot = bode_plot(fit, omega[::3], data=data, confidence=fit)
    magnitude, phase = (plot.lines[row, 0][0].get_ydata() for row in (0, 1))
    assert plot.figure._suptitle.get_text() == "Bode plot"
    exact = fit.observed_system(1j * plot.lines[0, 0][0].get_xdata())
    np.testing.assert_allclose(magnitude, 20 * np.log10(np.abs(exact)), rtol=1e-9)
    assert set(phase[np.isfinite(phase)]) == ({0.0, -180.0} if quantity == "displacement" else {0.0, 180.0})
    for row, curve in enumerate((magnitude, phase)):
        band = plot.axes[row, 0].collections[0].get_paths()[0].vertices
        at = plot.lines[row, 0][0].get_xdata()
        for w, y in zip(at[np.isfinite(at)], curve[np.isfinite(at)], strict=True):
            here = band[np.isclose(band[:, 0], w), 1]
            assert here.min() - 1e-9 <= y <= here.max() + 1e-9
    plt.close(plot.figure)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"confidence": 3}, "confidence is a int; pass the result of pem"),
        ({"confidence": [None, None]}, "confidence has 2 entries for 1 systems"),
        ({"confidence": True}, "confidence is True, but none of the systems is the result of a fit"),
        ({"sysdata": ct.rss(2, 2, 2), "confidence": drawn_models(3)}, "bands are those of one input and one output"),
        ({"confidence": drawn_models(3), "level": 2.0}, "level is 2.0"),
        ({"plot_magnitude": False, "plot_phase": False}, "there is nothing to draw"),
    ],
)
def test_a_band_that_cannot_be_drawn_says_why(arguments, message):
    with pytest.raises(StructureError, match=message):
        bode_plot(**({"sysdata": frenkel_kontorova()} | arguments))


def test_the_phase_axis_is_ticked_at_multiples_of_90_degrees():
    plot = bode_plot(frenkel_kontorova())
    low, high = plot.axes[1, 0].get_ylim()
    major = [t for t in plot.axes[1, 0].yaxis.get_majorticklocs() if low <= t <= high]
    minor = [t for t in plot.axes[1, 0].yaxis.get_minorticklocs() if low <= t <= high]
    assert major == [-90.0, 0.0, 90.0]
    assert minor == [-45.0, 45.0]


def test_a_mixed_list_has_a_line_and_a_legend_entry_for_each():
    chain = frenkel_kontorova(name="chain")
    w = np.linspace(0.1, 3.0, 30)
    tabulated = ct.frd(1 / (1j * w + 1), w, name="tabulated")
    sampled = ct.sample_system(ct.tf([1], [1, 1], name="lag"), 0.5, name="sampled")
    plot = bode_plot([chain, ct.ss(chain, name="plain"), ct.tf([1], [1, 1], name="lag"), tabulated, sampled])
    names = ["chain", "plain", "lag", "tabulated", "sampled"]
    assert legend_texts(plot.axes[0, 0]) == [*names, "Nyquist frequency (6.283 rad/time)"]
    assert plot.legend is plot.axes[0, 0].get_legend()
    assert [len(lines) for lines in plot.lines[:, 0]] == [5, 5]
    assert plot.lines[0, 0][3].get_xdata().tolist() == w.tolist()
    np.testing.assert_allclose(plot.lines[0, 0][4].get_xdata().max(), 2 * np.pi, rtol=1e-2)
    assert plot.lines[0, 0][4].get_xdata().max() <= 2 * np.pi
    # equal curves must not hide each other
    assert plot.lines[0, 0][0].get_linestyle() != plot.lines[0, 0][1].get_linestyle()


def test_a_sampled_system_is_evaluated_on_the_unit_circle():
    sampled = ct.tf([1.0], [1.0, -0.5], 0.25, name="sampled")
    w, level = bode_plot(sampled).lines[0, 0][0].get_data()
    np.testing.assert_allclose(level, -20 * np.log10(np.abs(np.exp(0.25j * w) - 0.5)), atol=1e-10)


def test_one_curve_needs_no_legend_and_the_title_has_its_name():
    plot = bode_plot(frenkel_kontorova(name="chain"))
    assert plot.legend is None
    assert plot.figure.get_suptitle() == "Bode plot of chain"
    assert bode_plot(frenkel_kontorova()).figure.get_suptitle() == "Bode plot, F to v"
    assert bode_plot(ct.tf([1], [1, 0.1, 1])).figure.get_suptitle() == "Bode plot"


def test_units_that_the_labels_tell_are_those_of_the_gain():
    chain = frenkel_kontorova(inputs="F [N]", outputs="v [m/s]")
    plot = bode_plot(chain)
    assert plot.axes[0, 0].get_ylabel() == "Magnitude [dB re 1 m/s/N]"
    assert plot.figure.get_suptitle() == "Bode plot, F to v"
    assert bode_plot(chain, gain_unit="kg/s").axes[0, 0].get_ylabel() == "Magnitude [dB re 1 kg/s]"
    assert bode_plot(frenkel_kontorova(), title="Mine").figure.get_suptitle() == "Mine"


def test_labels_replace_names():
    chain = frenkel_kontorova(name="chain")
    assert legend_texts(bode_plot([chain, chain], label=["before", "after"]).axes[0, 0]) == ["before", "after"]
    assert legend_texts(bode_plot([chain, chain]).axes[0, 0]) == ["chain #1", "chain #2"]


def test_systems_of_one_name_are_told_apart_by_step_or_size():
    chain = ct.ss(frenkel_kontorova(name="chain"))
    short = ct.ss([[-1.0]], [[1.0]], [[1.0]], 0, name="chain")
    plot = bode_plot([chain, short, ct.c2d(chain, 0.1), ct.ss(short.A, short.B, short.C, 0, name="other")])
    assert legend_texts(plot.axes[0, 0])[:4] == ["chain (4 states)", "chain (1 state)", "chain (dt = 0.1)", "other"]


def test_names_are_shown_without_what_python_control_adds_to_them():
    tower = spring_chain([1.0, 1.0], 4.0, ground=1.0, c=0.1, port=[0, 1], name="tower")
    assert "$" in tower[0, 1].name
    assert bode_plot(tower[0, 1]).figure.get_suptitle() == "Bode plot of tower"
    unnamed = ct.c2d(ct.tf([1, 0], [1, 0.1, 1]), 0.1)
    assert bode_plot(unnamed).figure.get_suptitle() == "Bode plot"


def test_a_measurement_of_a_narrow_band_fills_the_picture():
    resonator = phc.ph(phc.modes([99.9, 100.1], [0.01, 0.01], damping=1e-4))
    omega = np.linspace(99.0, 101.0, 50)
    low, high = bode_plot(resonator, data=ct.frd(resonator(1j * omega), omega)).axes[1, 0].get_xlim()
    assert 98.8 < low <= 99 and 101 <= high < 101.2
    # a mode beyond the measurement is shown with what surrounds it
    low, high = (
        bode_plot(phc.ph(phc.modes([99.9, 500.0], [0.01, 0.01])), data=ct.frd(resonator(1j * omega), omega))
        .axes[1, 0]
        .get_xlim()
    )
    assert high >= 1000


def test_a_new_figure_is_made_unless_axes_are_given():
    before = len(plt.get_fignums())
    first = bode_plot(frenkel_kontorova())
    second = bode_plot(frenkel_kontorova())
    assert len(plt.get_fignums()) == before + 2
    assert first.figure is not second.figure
    figure, axes = plt.subplots(2, 1)
    third = bode_plot(frenkel_kontorova(), ax=axes)
    assert len(plt.get_fignums()) == before + 3
    assert third.figure is figure
    assert third.axes[:, 0].tolist() == list(axes)
    assert figure.get_suptitle() == ""


def test_no_picture_is_shown_and_no_setting_leaks(monkeypatch):
    monkeypatch.setattr(plt, "show", lambda *a, **k: pytest.fail("a library does not show pictures"))
    before = dict(plt.rcParams.copy())
    data = record(frenkel_kontorova(), 2048)
    bode_plot(frenkel_kontorova(), data=data)
    fit_plot(data.time, data.outputs, data.outputs)
    assert dict(plt.rcParams.copy()) == before


def test_several_ports_are_a_table_of_magnitudes_above_phases():
    sys = ct.ss(spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=[0, 2]))
    plot = bode_plot(sys)
    assert plot.axes.shape == plot.lines.shape == (4, 2)
    assert [axis.get_title(loc="left") for axis in plot.axes[::2].ravel()] == [
        "F_1 to v_1", "F_2 to v_1", "F_1 to v_2", "F_2 to v_2",
    ]  # fmt: skip
    w, level = plot.lines[2, 0][0].get_data()
    np.testing.assert_allclose(level[0], 20 * np.log10(abs(sys(1j * w[0])[1, 0])), rtol=1e-12)
    assert [axis.get_xlabel() for axis in plot.axes[-1]] == ["Frequency [rad/time]"] * 2


def test_with_several_ports_the_antiresonances_of_every_entry_are_resolved():
    sys = ct.ss(spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=[0, 2]))
    plot = bode_plot(sys)
    for i, single in ((0, 0), (1, 2)):
        alone = spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=single)
        w, level = plot.lines[2 * i, i][0].get_data()
        for zero in alone.zeros().imag[alone.zeros().imag > 0]:
            assert level[np.argmin(np.abs(w - zero))] < plot.axes[2 * i, i].get_ylim()[0]


def drawn_texts(figure):
    """What matplotlib draws of each text: with the dollar signs that it takes for a formula still in their formula."""
    figure.canvas.draw()
    parsed = [(text, text._preprocess_math(text.get_text())) for text in figure.findobj(Text)]
    return {string for text, (string, formula) in parsed if text.get_text() and formula is not True}


HOSTILE = "v_{$ [m/s] 5$ \\$"


@pytest.mark.slow
def test_dollar_signs_in_names_labels_and_units_of_a_bode_plot_are_drawn_as_they_are():
    one = phc.ph(phc.modes(1.0, 1.0), name=HOSTILE)
    data = record(one, 1024, noise=2.0)
    texts = drawn_texts(bode_plot(one, data=data, data_label="$a$", gain_unit="$b$").figure)
    assert {HOSTILE, "Bode plot of " + HOSTILE, "$a$", "Magnitude [dB re 1 $b$]"} <= texts
    two = ct.ss(spring_chain([1.0, 2.0], 1.0, ground=1.0, port=[0, 1]), inputs=["F$", "G"], outputs=["v$", HOSTILE])
    texts = drawn_texts(bode_plot([two, two], label=["$c$", "d$$"], title="$e$").figure)
    assert {"F$ to v$", "G to " + HOSTILE, "$c$", "d$$", "$e$"} <= texts


def test_dollar_signs_in_the_labels_of_a_fit_plot_are_drawn_as_they_are():
    signals = [0.0, 1.0], [1.0, 2.0], [1.0, 1.0]
    texts = drawn_texts(fit_plot(*signals, output_label=HOSTILE, output_unit="$x$", time_unit="$y$").figure)
    expected = {HOSTILE + " [$x$]", "Residual\n[$x$]", "RMS 0.707 $x$", "Time [$y$]"}
    assert expected | {HOSTILE + ", measured and predicted"} <= texts
    assert "$z$" in drawn_texts(fit_plot(*signals, title="$z$").figure)


# --- measurements in the Bode plot ---


def test_a_record_is_drawn_as_dots_with_the_Nyquist_limit():
    sys = lc_circuit([1.0, 0.3], [1.0, 0.2], name="circuit")
    plot = bode_plot(sys, data=record(sys, step=0.2, noise=0.1))
    texts = legend_texts(plot.axes[0, 0])
    assert texts[:2] == ["circuit", "data (spectral estimate, 8 segments)"]
    assert texts[-1] == "Nyquist frequency (15.71 rad/time)"
    for row in (0, 1):
        dots = plot.lines[row, 0][1]
        assert (dots.get_linestyle(), dots.get_marker()) == ("None", ".")
        verticals = [line for line in plot.axes[row, 0].get_lines() if line.get_label() == texts[-1]]
        np.testing.assert_allclose(verticals[0].get_xdata(), np.pi / 0.2)
    low, high = plot.axes[0, 0].get_xlim()
    assert low < sys.d[0] and high > np.pi / 0.2


def test_the_record_of_a_fit_is_drawn_as_the_record_it_was_made_of():
    data = record(frenkel_kontorova(), samples=2048, noise=0.05)
    fit = phc.pem(data, 2)
    kept, given = (bode_plot(fit, data=one).lines[0, 0] for one in (fit.record, data))
    for one, other in zip(kept, given, strict=True):
        np.testing.assert_array_equal(one.get_ydata(), other.get_ydata())


def test_dots_without_coherence_are_pale_and_named():
    sys = frenkel_kontorova()
    estimate = spectral_estimate(record(sys, noise=1.0))
    doubtful = estimate.coherence < 0.5
    assert doubtful.any() and not doubtful.all()
    plot = bode_plot(sys, data=estimate, data_label="test")
    sure, pale = plot.lines[0, 0][1:]
    assert (sure.get_label(), pale.get_label()) == ("test", "coherence below 0.5")
    assert pale.get_xdata().tolist() == estimate.omega[doubtful].tolist()
    assert sure.get_xdata().tolist() == estimate.omega[~doubtful].tolist()


def test_a_measured_frequency_response_is_drawn_as_it_is():
    w = np.array([0.0, 0.5, 0.9, 2.0])
    plot = bode_plot(frenkel_kontorova(), data=ct.frd(np.array([1.0, 2.0j, -3.0, 1 - 1j]), w))
    magnitude, phase = plot.lines[0, 0][1], plot.lines[1, 0][1]
    assert magnitude.get_xdata().tolist() == [0.5, 0.9, 2.0]
    np.testing.assert_allclose(magnitude.get_ydata(), 20 * np.log10([2, 3, np.sqrt(2)]))
    np.testing.assert_allclose(phase.get_ydata(), [90, -180, -45])  # beside the model
    assert not any("Nyquist" in text for text in legend_texts(plot.axes[0, 0]))


def test_dots_are_in_the_turn_of_a_curve_that_has_left_half_a_turn():
    lag = ct.tf([1], [1, 3, 3, 1]) * ct.tf([1], [1, 3, 3, 1])
    omega = np.geomspace(0.1, 30.0, 40)
    measured = ct.frd(lag(1j * omega), omega)
    curve, dots = bode_plot(lag, data=measured).lines[1, 0]
    expected = np.interp(np.log(omega), np.log(curve.get_xdata()), curve.get_ydata())
    assert np.min(dots.get_ydata()) < -500.0
    assert np.max(np.abs(dots.get_ydata() - expected)) < 1.0
    wrapped = bode_plot(lag, data=measured, wrap_phase=True).lines[1, 0][1].get_ydata()
    assert -180.0 <= wrapped.min() and wrapped.max() <= 180.0


def test_a_tabulated_response_is_drawn_from_its_first_to_its_last_frequency():
    omega = np.geomspace(0.1, 10.0, 60)
    table = ct.frd(phc.frenkel_kontorova()(1j * omega), omega)
    assert np.allclose(bode_plot(table).axes[0, 0].get_xlim(), [0.1, 10.0], rtol=1e-12)
    # a system needs room around its poles and zeros
    assert np.allclose(bode_plot([table, phc.modes(9.0, 1.0)]).axes[0, 0].get_xlim(), [0.1, 100.0], rtol=1e-12)


def test_a_title_that_does_not_fit_leaves_the_names_to_the_legend():
    names = ["mechanical structure as measured in spring", "model that was fitted to it by hand"]
    plot = bode_plot([ct.tf([1], [1, 1], name=name) for name in names])
    assert plot.figure.get_suptitle() == "Bode plot" and legend_texts(plot.axes[0, 0]) == names
    assert bode_plot(ct.tf([1], [1, 1], name=names[0])).figure.get_suptitle() == f"Bode plot of {names[0]}"


@pytest.mark.parametrize(
    "response, first",
    [
        (lambda s: 1 / s**2, -180.0), (lambda s: 1 / (s**2 * (s + 1)), -180.0),
        (lambda s: s**2 / (s**2 + 0.1 * s + 1), 180.0),
        (lambda s: -1 / (s**2 + 0.1 * s + 1), 180.0), (lambda s: 1 / (s + 1), 0.0), (lambda s: 1 / s, -90.0),
    ],
    ids=["double integrator", "with a lag", "acceleration", "negative gain", "lag", "integrator"],
)  # fmt: skip
@pytest.mark.parametrize("rounding", [1.0, 1 + 1e-9j, 1 - 1e-9j])
def test_a_phase_begins_in_the_branch_that_the_slope_of_the_gain_tells(response, first, rounding):
    omega = np.geomspace(0.01, 10.0, 400)
    phase = Curve("", omega, rounding * response(1j * omega)[None, None]).phase(0, 0)
    assert abs(phase[0] - first) < 5.0
    assert np.abs(np.diff(phase)).max() < 90.0


def test_noise_in_a_table_draws_no_strokes_and_turns_nothing():
    rng, omega = np.random.default_rng(0), np.linspace(0.1, 5.0, 400)
    response = 1 / (1 - omega**2 + 0.2j * omega)
    noisy = (omega > 2.0) & (omega < 3.0)
    response[noisy] = np.exp(2j * np.pi * rng.uniform(size=noisy.sum()))
    plot = bode_plot(ct.frd(response, omega))
    line, dots = plot.axes[1, 0].lines
    x, phase = line.get_data()
    assert np.isnan(phase[(x > 2.1) & (x < 2.9)]).mean() > 0.9 and np.isfinite(phase[(x < 1.9) | (x > 3.1)]).all()
    steps = np.abs(np.diff(phase))
    assert np.nanmax(steps) < 150.0
    np.testing.assert_allclose(phase[x > 3.2], -180.0, atol=5.0)
    assert len(dots.get_xdata()) == np.isnan(phase).sum()


LOG, LINEAR = np.geomspace(0.1, 5.0, 50), np.linspace(0.1, 5.0, 50)


@pytest.mark.parametrize(
    "scale, ends, grid, modes, logarithmic",
    [
        (None, (0.1, 5.0), LOG, None, True), (None, (0.1, 5.0), LINEAR, None, False),
        (None, (0.1, 20.0), None, None, True), (None, (0.1, 20.0), 4 * LINEAR, np.array([5.0, 15.0]), False),
        (None, (0.1, 20.0), 4 * LINEAR, np.array([0.3]), True),
        (None, (0.1, 5.0), LINEAR, np.zeros(0), True), (None, (1.0, 1.01), np.geomspace(1.0, 1.01, 9), None, False),
        ("linear", (0.1, 20.0), LOG, None, False), ("log", (1.0, 2.0), LINEAR, None, True),
        (None, (0.0, 20.0), None, None, False),
    ],
)  # fmt: skip
def test_a_frequency_axis_is_logarithmic_for_such_a_grid_or_beyond_two_decades(scale, ends, grid, modes, logarithmic):
    assert is_logarithmic(scale, *ends, grid, modes) == logarithmic


def test_the_scale_of_a_frequency_axis_can_be_said():
    chain = frenkel_kontorova()
    for draw in (bode_plot, phc.frf_plot):
        for scale in ("linear", "log"):
            assert draw(chain, scale=scale).axes[1, 0].get_xscale() == scale
        with pytest.raises(StructureError, match="scale is 'decades'; it must be one of 'log', 'linear'"):
            draw(chain, scale="decades")


def test_the_phase_of_dots_is_not_unwrapped():
    curve = Curve("", np.arange(1.0, 4.0), np.exp(1j * np.radians([[[170.0, -170.0, 170.0]]])), np.zeros(0))
    np.testing.assert_allclose(curve.phase(0, 0, unwrap=False), [170, -170, 170])
    np.testing.assert_allclose(curve.phase(0, 0), [170, 190, 170])


@pytest.mark.parametrize("first", [0, 1])
def test_the_phase_of_a_table_is_beside_that_of_the_model_in_the_same_list(first):
    chain = phc.spring_chain([3.0, 2.0, 1.0], 40.0, ground=[60.0, 0, 0], c=0.1, port=[0, 2])
    both = [chain, ct.frd(chain, np.geomspace(0.1, 30, 50))]
    plot = bode_plot(both if first else both[::-1])
    for row, column in ((1, 0), (1, 1), (3, 0), (3, 1)):
        model, table = plot.lines[row, column][:2] if first else plot.lines[row, column][1::-1]
        beside = np.interp(table.get_xdata(), model.get_xdata(), model.get_ydata())
        assert np.nanmax(np.abs(table.get_ydata() - beside)) < 2.0  # NaN where it steps in all directions
    plt.close(plot.figure)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sysdata": []}, "the list of systems is empty"),
        ({"sysdata": 3}, "a int has no frequency response"),
        ({"sysdata": [ct.tf(1, [1, 1]), ct.rss(2, 2, 2)]}, "the systems differ in"),
        ({"omega": [1.0]}, "omega must be at least two positive, ascending frequencies; it has 1 "),
        ({"omega": [0.0, 1.0, 2.0]}, "omega must be .* from 0 to 2"),
        ({"omega": [1.0, 3.0, 2.0]}, "omega must be at least two positive, ascending"),
        ({"omega": [1.0, np.nan]}, "omega is not finite"),
        ({"omega_limits": [1.0, 2.0, 3.0]}, "omega_limits has 3 entries"),
        ({"data": [1, 2, 3]}, "data is a list; pass a record"),
        ({"data": ct.frd(np.ones((2, 2, 3)), [1.0, 2.0, 3.0])}, "the data have 2 outputs and 2 inputs"),
        ({"data": ct.frd([1.0], [0.0])}, "no frequency above 0"),
        ({"label": ["a", "b"]}, "2 labels for 1 systems"),
        ({"ax": np.array([None])}, "ax has 1 axes"),
    ],
)
def test_a_bode_plot_that_cannot_be_drawn_says_why(arguments, message):
    with pytest.raises(StructureError, match=message):
        bode_plot(**({"sysdata": frenkel_kontorova()} | arguments))


def test_an_unknown_keyword_is_an_error():
    with pytest.raises(TypeError, match="colour"):
        bode_plot(frenkel_kontorova(), colour="red")


# --- the spectral estimate ---


def test_the_estimate_of_a_known_system_is_right_within_its_own_statistics():
    estimate = spectral_estimate(fir_record(), segments=32, intersample="bandlimited")
    truth = 1 + 0.5 * np.exp(-1j * estimate.omega)
    error = np.abs(estimate.complex / truth - 1) / estimate.relative_error
    # real and imaginary part each of the stated standard deviation: the mean square is 2, and 1 would be too small
    assert 1.6 < np.mean(error**2) < 2.4
    assert np.max(error) < 6.0


def test_the_coherence_is_the_part_of_the_output_power_that_the_input_explains():
    estimate = spectral_estimate(fir_record(noise=0.5), segments=64, intersample="bandlimited")
    signal = np.abs(1 + 0.5 * np.exp(-1j * estimate.omega)) ** 2
    expected = signal / (signal + 0.25)
    assert np.abs(np.mean(estimate.coherence - expected)) < 0.01
    assert np.max(np.abs(estimate.coherence - expected)) < 0.35
    assert np.all((estimate.coherence >= 0) & (estimate.coherence <= 1))


def test_the_estimate_agrees_with_a_slow_average_of_periodograms():
    data = fir_record(samples=999)
    estimate = spectral_estimate(data, segments=5, intersample="bandlimited")
    half = 999 // 6
    length = 2 * half
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    cross, power = 0.0, 0.0
    for k in range(5):
        u, y = (x[k * half : k * half + length] for x in (data.inputs, data.outputs))
        U, Y = np.fft.rfft(window * (u - u.mean())), np.fft.rfft(window * (y - y.mean()))
        cross, power = cross + np.conj(U) * Y, power + np.abs(U) ** 2
    np.testing.assert_allclose(estimate.complex, (cross / power)[2:-1], rtol=1e-10)
    np.testing.assert_allclose(estimate.omega, 2 * np.pi * np.arange(2, half) / length, rtol=1e-14)
    assert estimate.segments == 5


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_the_hold_is_taken_out_so_that_the_phase_of_a_lossless_system_is_90_degrees(intersample):
    sys = phc.ph(phc.modes([1.0, 2.5], [1.0, 0.3]))
    data = record(sys, 16384, 0.5, intersample=intersample)
    matched = spectral_estimate(data, intersample=intersample)
    tail = (matched.omega > 3.5) & (matched.omega < 6.0)
    assert np.max(np.abs(np.degrees(np.angle(matched.complex[tail])) + 90)) < 10.0
    raw = spectral_estimate(data, intersample="bandlimited")
    lag = np.degrees(np.angle(raw.complex[tail] / matched.complex[tail]))
    expected = -np.degrees(raw.omega[tail] * 0.5 / 2) if intersample == "zoh" else np.zeros(tail.sum())
    np.testing.assert_allclose(lag, expected, atol=1e-9)


def test_away_from_its_resonances_the_estimate_meets_the_lossless_system():
    sys = lc_circuit([1.0, 0.3, 0.05], [1.0, 0.2, 0.4])
    estimate = spectral_estimate(record(sys, 16384, 0.05))
    # up to a fifth of the Nyquist frequency, folding back is a few percent
    sure = (estimate.coherence > 0.99) & (estimate.omega < 0.2 * estimate.nyquist)
    assert sure.sum() > 50
    ratio = estimate.complex[sure] / sys(1j * estimate.omega[sure])
    assert np.median(np.abs(ratio - 1)) < 0.05


def test_near_the_Nyquist_frequency_the_folded_response_lifts_the_estimate_even_without_noise():
    sys = phc.ph(phc.modes([1.0, 2.5], [1.0, 0.3]))
    estimate = spectral_estimate(record(sys, 16384, 0.5))
    top = (estimate.omega > 0.8 * estimate.nyquist) & (estimate.omega < 0.95 * estimate.nyquist)
    # the held response at w + k * 2 pi / step, all k, over that of the hold at w: the sampled response
    images = estimate.omega[top] + 2 * np.pi / 0.5 * np.arange(-2000, 2001)[:, None]
    hold = np.sinc(images * 0.5 / (2 * np.pi)) * np.exp(-0.25j * images)
    folded = np.sum(hold * sys(1j * images.ravel()).reshape(images.shape), axis=0) / hold[2000]
    assert np.median(np.abs(estimate.complex[top] / sys(1j * estimate.omega[top]))) > 1.5
    np.testing.assert_allclose(np.median(np.abs(estimate.complex[top] / folded)), 1.0, atol=0.05)


def test_the_estimate_is_frequency_response_data_of_continuous_time_with_the_names_of_the_record():
    data = phc.forced_response(
        frenkel_kontorova(), 0.1 * np.arange(512), np.random.default_rng(0).normal(size=512), intersample="zoh"
    )
    estimate = spectral_estimate(data)
    assert isinstance(estimate, ct.FrequencyResponseData) and isinstance(estimate, SpectralEstimate)
    assert estimate.isctime() and estimate.dt == 0
    assert (estimate.input_labels, estimate.output_labels) == (["F"], ["v"])
    assert (estimate.step, estimate.nyquist) == pytest.approx((0.1, np.pi / 0.1))
    assert estimate.omega.max() < estimate.nyquist and estimate.omega.min() > 0
    assert isinstance(estimate.plot(), ct.ControlPlot)
    with pytest.raises(ValueError, match="read-only"):
        estimate.coherence[0] = 1.0


def test_bins_without_input_power_are_left_out():
    t = 0.1 * np.arange(4096)
    u = np.sin(t) + np.sin(3 * t)
    estimate = spectral_estimate(ct.TimeResponseData(t, 2 * u, inputs=u, issiso=True))
    # the Hann window falls by 60 dB within ten bins
    ten_bins = 10 * 2 * np.pi / (0.1 * 2 * (4096 // 9))
    assert np.all((np.abs(estimate.omega - 1) < ten_bins) | (np.abs(estimate.omega - 3) < ten_bins))
    assert np.any(np.abs(estimate.omega - 1) < 0.05) and np.any(np.abs(estimate.omega - 3) < 0.05)
    white = fir_record(4096)
    assert len(spectral_estimate(white).omega) == len(white.time) // 9 - 2


def test_bins_with_a_thousandth_of_the_input_power_are_kept():
    data = fir_record(4096)
    t, weak = data.time, 0.02 * data.inputs
    u = weak + np.sin(np.pi / 4 * t / t[1])
    estimate = spectral_estimate(ct.TimeResponseData(t, 2 * u, inputs=u, issiso=True))
    assert len(estimate.omega) >= len(t) // 9 - 10  # but for some about the strong line


def test_segments_do_not_reach_across_missing_samples():
    data = fir_record(8192)
    y = data.outputs.copy()
    y[4000:4010] = np.nan
    gapped = ct.TimeResponseData(data.time, y, inputs=data.inputs, issiso=True)
    estimate = spectral_estimate(gapped, segments=15, intersample="bandlimited")
    assert np.isfinite(estimate.complex).all()
    assert estimate.segments == 13
    truth = 1 + 0.5 * np.exp(-1j * estimate.omega)
    assert np.mean((np.abs(estimate.complex / truth - 1) / estimate.relative_error) ** 2) < 3.0


def test_one_segment_tells_nothing_of_its_error():
    estimate = spectral_estimate(fir_record(256), segments=1)
    np.testing.assert_allclose(estimate.coherence, 1.0, rtol=1e-9)
    assert np.isnan(estimate.relative_error).all()


def test_a_shortest_record_is_estimated_and_a_shorter_one_refused():
    t = np.arange(8.0)
    u = np.random.default_rng(0).standard_normal(8)
    assert len(spectral_estimate(ct.TimeResponseData(t, u, inputs=u, issiso=True), segments=1).omega) == 2
    with pytest.raises(StructureError, match="the record has 7 samples; a spectral estimate needs at least 8"):
        spectral_estimate(ct.TimeResponseData(t[:7], u[:7], inputs=u[:7], issiso=True), segments=1)


def damaged(change, **keywords):
    t, u, y = np.arange(64.0), np.random.default_rng(0).standard_normal(64), np.ones(64)
    t, u, y = change(t, u, y)
    return lambda: spectral_estimate(ct.TimeResponseData(t, y, inputs=u, issiso=True), **keywords)


def replaced(array, index, value):
    return np.concatenate([array[:index], [value], array[index + 1 :]])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (damaged(lambda t, u, y: (t, 0.1 + 0 * u, y)), "the input of the record is constant"),
        (
            damaged(lambda t, u, y: (t, (t > 62.0) + 0.0, y), segments=5),
            "the input of the record is constant in all 5 segments, or nearly so, .*; use fewer segments",
        ),
        (damaged(lambda t, u, y: (replaced(t, 5, 5.5), u, y)), "the time of the record is not equally spaced"),
        (damaged(lambda t, u, y: (t, replaced(u, 3, np.nan), y)), "the input of the record is not finite"),
        (damaged(lambda t, u, y: (t, u, replaced(y, 3, np.inf))), "the output of the record is not finite"),
        (damaged(lambda t, u, y: (t, u, np.nan * y)), "the longest stretch of the output .* has 0 samples"),
        (damaged(lambda t, u, y: (t, u, y), segments=16), "16 segments of a record of 64 .*; use at most 15"),
        (damaged(lambda t, u, y: (t, u, y), segments=0), "segments is 0"),
        (damaged(lambda t, u, y: (t, u, y), segments=2.5), "segments is 2.5"),
        (damaged(lambda t, u, y: (t, u, y), intersample="linear"), "intersample is 'linear'; it must be one of 'zoh'"),
        (damaged(lambda t, u, y: (t, None, y)), "data have 0 inputs, 1 outputs"),
        (lambda: spectral_estimate((1, 2)), "data is a tuple; pass a record as control.TimeResponseData"),
    ],
)
def test_a_record_that_cannot_be_estimated_says_why(call, message):
    with pytest.raises(StructureError, match=message):
        call()


def test_the_largest_number_of_segments_that_the_message_names_does_work():
    assert damaged(lambda t, u, y: (t, u, y), segments=15)().segments == 15


# --- measured against predicted ---


def long_record(samples=8000):
    t = np.arange(samples) / 100.0
    predicted = np.sin(2 * np.pi * t)
    measured = predicted + 0.01 * np.random.default_rng(0).standard_normal(samples)
    measured[3000:3100] += 0.5
    return t, measured, predicted


def test_the_picture_of_a_fit_has_units_on_every_axis_where_they_are_known():
    t, y, p = long_record()
    plot = fit_plot(t, y, p, time_unit="ms", output_label="Velocity", output_unit="m/s")
    assert isinstance(plot, ct.ControlPlot)
    assert [axis.get_ylabel() for axis in plot.axes[:, 0]] == ["Velocity [m/s]", "Residual\n[m/s]", "Velocity [m/s]"]
    assert [axis.get_xlabel() for axis in plot.axes[1:, 0]] == ["Time [ms]", "Time [ms]"]
    assert plot.axes[1, 0].texts[0].get_text().endswith(" m/s")


@pytest.mark.variants
@pytest.mark.parametrize("unit", [{}, {"output_unit": None}, {"output_unit": ""}])
def test_an_unknown_unit_is_left_out_of_every_label(unit):
    t, y, p = long_record()
    plot = fit_plot(t, y, p, output_label="current", **unit)
    assert [axis.get_ylabel() for axis in plot.axes[:, 0]] == ["current", "Residual", "current"]
    assert plot.axes[1, 0].texts[0].get_text() == f"RMS {np.sqrt(np.mean((y - p) ** 2)):.3g}"
    assert plot.axes[1, 0].get_xlabel() == "Time"
    assert fit_plot(t, y, p).axes[0, 0].get_ylabel() == "Output"


def test_the_residual_is_measured_minus_predicted_on_the_time_axis_of_both():
    t = np.linspace(0, 1, 50)
    y, p = np.cos(t), 0.9 * np.cos(t)
    plot = fit_plot(t, y, p)
    assert np.array_equal(plot.lines[1, 0][0].get_ydata(), y - p)
    measured, predicted = plot.lines[0, 0]
    assert np.array_equal(measured.get_ydata(), y) and np.array_equal(predicted.get_ydata(), p)
    assert plot.axes[0, 0].get_shared_x_axes().joined(plot.axes[0, 0], plot.axes[1, 0])
    rms = f"RMS {np.sqrt(np.mean((y - p) ** 2)):.3g}"
    assert rms in [text.get_text() for text in plot.axes[1, 0].texts]


@pytest.mark.parametrize(
    ("fit", "shown"),
    [
        (None, "predicted"),
        (93.456, "predicted (fit 93.46 %)"),
        (-12.0, "predicted (fit -12.00 %)"),
        (99.994, "predicted (fit 99.99 %)"),
        (99.9999, "predicted (fit above 99.99 %)"),
        (100.0, "predicted (fit 100.00 %)"),
    ],
)
def test_the_legend_gives_the_fit_and_never_rounds_it_up_to_perfect(fit, shown):
    plot = fit_plot([0.0, 1.0], [1.0, 2.0], [1.0, 2.0], fit_percent=fit)
    assert legend_texts(plot.axes[0, 0]) == ["measured", shown]


def test_a_long_record_has_its_worst_periods_enlarged():
    t, y, p = long_record()
    plot = fit_plot(t, y, p)
    assert plot.axes.shape == (3, 1)
    start, stop = plot.axes[2, 0].get_xlim()
    assert start <= 30.0 and stop >= 30.99
    assert 7.0 <= stop - start <= 9.0
    dots, line = plot.lines[2, 0]
    assert np.array_equal(dots.get_xdata(), line.get_xdata())
    assert "where the residual is largest" in plot.axes[2, 0].get_title(loc="left")


def test_a_short_record_is_not_enlarged_and_a_part_can_be_chosen_or_none():
    t, y, p = long_record()
    assert fit_plot(t[:300], y[:300], p[:300]).axes.shape == (2, 1)
    assert fit_plot(t, y, p, detail=None).axes.shape == (2, 1)
    chosen = fit_plot(t, y, p, detail=[10.0, 11.0])
    assert chosen.axes[2, 0].get_xlim() == (10.0, 11.0)
    assert len(chosen.lines[2, 0][0].get_xdata()) == 101
    assert "largest" not in chosen.axes[2, 0].get_title(loc="left")


@pytest.mark.parametrize("samples", [30, 200, 1200, 20_000])
def test_a_record_of_more_than_ten_periods_has_a_part_of_it_enlarged_and_one_of_ten_not(samples):
    t = np.arange(samples) / samples
    for periods, panels in ((10, 2), (11, 3), (13, 3)):
        y = np.sin(2 * np.pi * periods * t)
        plot = fit_plot(t, y, y, detail="auto")
        assert len(plot.axes) == (panels if samples < 3000 else 3)
        if panels == 3:
            start, stop = plot.axes[2, 0].get_xlim()
            assert 0.2 < stop - start <= 1 / 3


def test_the_measured_output_is_seen_around_a_prediction_equal_to_it():
    t, _, p = long_record()
    for part in (slice(200), slice(2000), slice(None)):
        plot = fit_plot(t[part], p[part], p[part])
        measured, predicted = plot.lines[0, 0]
        assert measured.get_linewidth() > 2 * predicted.get_linewidth()
        assert measured.get_color() != predicted.get_color()
        if len(plot.axes) == 3:
            dots, line = plot.lines[2, 0]
            assert (dots.get_linestyle(), dots.get_marker(), line.get_marker()) == ("None", "o", "None")
            assert dots.get_markersize() > 2 * line.get_linewidth()


def test_a_fit_is_drawn_on_axes_of_ones_own_with_the_detail_if_there_is_one_for_it():
    t, y, p = long_record()
    for panels in (2, 3):
        figure, axes = plt.subplots(panels, 1)
        plot = fit_plot(t, y, p, ax=axes)
        assert plot.figure is figure and plot.axes[:, 0].tolist() == list(axes)
        assert figure.get_suptitle() == ""
    with pytest.raises(StructureError, match="ax has 4 axes"):
        fit_plot(t, y, p, ax=plt.subplots(2, 2)[1])


def test_missing_samples_are_gaps():
    t, y, p = long_record(200)
    y[50:60] = np.nan
    plot = fit_plot(t, y, p)
    assert np.flatnonzero(np.isnan(plot.lines[0, 0][0].get_ydata())).tolist() == list(range(50, 60))
    assert np.flatnonzero(np.isnan(plot.lines[1, 0][0].get_ydata())).tolist() == list(range(50, 60))
    assert not np.isnan(plot.lines[0, 0][1].get_ydata()).any()


@quick
@given(st.integers(1, 3000), st.integers(0, 2**32 - 1))
def test_a_thinned_line_keeps_every_extreme_of_its_bins_in_order(samples, seed):
    t = np.arange(samples, dtype=float)
    y = np.random.default_rng(seed).standard_normal(samples)
    thin_t, thin_y = extremes(t, y, 100)
    assert len(thin_t) <= max(100, 2)
    assert np.all(np.diff(thin_t) > 0)
    assert np.array_equal(thin_y, y[thin_t.astype(int)])
    assert (thin_y.min(), thin_y.max()) == (y.min(), y.max())
    if samples <= 100:
        assert np.array_equal(thin_y, y)


def test_a_thinned_line_keeps_long_gaps_and_ignores_single_missing_samples():
    y = np.sin(np.arange(10_000.0))
    y[4000:6000] = np.nan
    y[1234] = np.nan
    thin_t, thin_y = extremes(np.arange(10_000.0), y, 100)
    inside = (thin_t > 4200) & (thin_t < 5800)
    assert inside.any() and np.isnan(thin_y[inside]).all()
    assert not np.isnan(thin_y[thin_t < 3800]).any()


def test_a_record_of_a_quarter_million_samples_is_drawn_with_few_points():
    t = np.arange(250_000) * 1e-3
    y = np.sin(40 * t)
    plot = fit_plot(t, y, 0.9 * y)
    assert all(len(line.get_xdata()) <= 6000 for lines in plot.lines[:, 0] for line in lines)
    np.testing.assert_allclose(plot.lines[0, 0][0].get_ydata().max(), 1.0, rtol=1e-3)


def test_the_signals_are_left_alone():
    t, y, p = long_record()
    y[7] = np.nan
    copies = t.copy(), y.copy(), p.copy()
    fit_plot(t, y, p)
    for array, copy in zip((t, y, p), copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 1], [1, 2, 3], [1, 2]), "the time has 2 samples, the measured output 3 and the predicted output 2"),
        (([0, 0], [1, 2], [1, 2]), "the time does not increase: samples 0 and 1"),
        (([0, np.nan], [1, 2], [1, 2]), "the time is not finite"),
        (([0, 1], [1, np.inf], [1, 2]), "the measured output is not finite"),
        (([0, 1], [1, 2], [1j, 2]), "the predicted output is complex"),
        (([0, 1], [np.nan, 2], [1, np.nan]), "no sample has a measured and a predicted output"),
        (([0, 1], [[1, 2]], [1, 2]), "the measured output has 2 dimensions"),
        (([0, 1], [1, 2], [1, 2], {"detail": [5, 6]}), "detail from 5 to 6 holds 0 samples"),
        (([0, 1], [1, 2], [1, 2], {"detail": [0.5]}), "detail has 1 entries"),
        (([0, 1], [1, 2], [1, 2], {"detail": "all"}), "detail is 'all'; it must be one of 'auto'"),
        (([], [], []), "no sample has"),
    ],
)
def test_a_fit_that_cannot_be_drawn_says_why(arguments, message):
    *signals, keywords = arguments if isinstance(arguments[-1], dict) else (*arguments, {})
    with pytest.raises(StructureError, match=message):
        fit_plot(*signals, **keywords)


@pytest.mark.parametrize("scale", [(1e160, 1.0), (1.0, 1e160), (1e-160, 1.0), (1.0, 1e-160)])
def test_the_spectra_of_a_record_out_of_range_are_refused(scale):
    u, y = np.random.default_rng(0).standard_normal((2, 100))
    record = ct.TimeResponseData(0.1 * np.arange(100), scale[1] * y, inputs=scale[0] * u, issiso=True)
    with pytest.raises(phc.StructureError, match="out of range"):
        phc.spectral_estimate(record)

"""Pictures of systems: transients that no sampling aliases, modes, poles and zeros, energies."""

import itertools
import re

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lossless import lossless_draws
from matplotlib.colors import to_rgb

import ph_control as phc
from ph_control import (
    NotLosslessError,
    StructureError,
    energy_plot,
    impulse_plot,
    modes_plot,
    pole_zero_plot,
    step_plot,
)
from ph_control.plotting import time_plot as transients
from ph_control.plotting.inputs import subjects_of
from ph_control.plotting.mode_plot import PoleZeroMap, pole_zero_map, strips
from ph_control.plotting.time_plot import response_of, transient_data

EPS = np.finfo(float).eps
quick = settings(deadline=None, max_examples=10, derandomize=True)
frequencies = st.lists(st.floats(0.01, 1000.0), min_size=1, max_size=6, unique=True)
PLOTS = {"step": step_plot, "impulse": impulse_plot}
RESPONSES = {"step": phc.step_response, "impulse": phc.impulse_response}


def legend_texts(axis):
    return [text.get_text() for text in axis.get_legend().get_texts()]


def labelled(axis, part):
    """Filled areas whose legend entry holds this text."""
    return [artist for artist in axis.collections if part in str(artist.get_label())]


def gyroscopic(ports=2):
    rng = np.random.default_rng(0)
    root, B = rng.standard_normal((6, 6)), rng.standard_normal((6, ports))
    return root @ root.T, B


# --- responses as numbers ---


@pytest.mark.parametrize("kind", PLOTS)
def test_responses_of_several_ports_are_those_of_the_system(kind):
    sys = phc.ph(*gyroscopic())
    t = np.linspace(0.0, 5.0, 51)
    expected = RESPONSES[kind](sys, t, squeeze=False).outputs
    found = response_of(sys.modes, t, ["impulse", "step"].index(kind))
    np.testing.assert_allclose(found, expected, atol=1000 * EPS * np.abs(expected).max())


@pytest.mark.parametrize("kind", PLOTS)
@pytest.mark.parametrize("form", ["ch", "oh", "affine", "free", "modes"])
def test_the_curve_is_the_response_of_the_system_in_every_form(kind, form):
    Q, B = gyroscopic(1)
    sys = {
        "ch": phc.ch(phc.ph(Q, B)), "oh": phc.oh(phc.ph(Q, B)), "affine": phc.affine(Q, B),
        "free": phc.spring_chain([1.0, 2.0, 3.0]), "modes": phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0])),
    }[form]  # fmt: skip
    shown = sys.modes if form == "modes" else sys
    t = np.linspace(0.0, 3.0, 201)
    (line,) = PLOTS[kind](shown, t).lines[0, 0]
    expected = RESPONSES[kind](sys, t).outputs
    np.testing.assert_allclose(line.get_ydata(), expected, atol=1e4 * EPS * np.abs(expected).max())
    assert line.get_xdata().tolist() == t.tolist()


@quick
@given(frequencies, st.sampled_from(["step", "impulse"]))
def test_a_line_has_at_least_eight_samples_in_every_period_and_three_periods_of_the_slowest(d, kind):
    numbers = transient_data(phc.modes(d, np.ones(len(d))), kind, None, None)
    (trace,) = numbers.traces
    resolved = np.setdiff1d(d, trace.fast)
    step = np.diff(trace.time).max()
    assert numbers.end == trace.time[-1] == pytest.approx(6 * np.pi / min(d))
    assert np.all(resolved * step <= 2 * np.pi / 8 * (1 + 1e-9))
    assert len(trace.time) >= 501
    # up to ten thousand periods are drawn; with these ratios of frequencies only the widest need an envelope
    assert trace.resolved or max(d) / min(d) > 2000


def test_python_control_has_a_third_of_a_sample_in_a_period_where_this_has_twenty():
    sys = phc.ph(phc.modes([1.0, 3000.0], [1.0, 1.0]))
    theirs, ours = ct.step_response(ct.ss(sys)).time, transient_data(ct.ss(sys), "step", None, None).traces[0].time
    samples_per_period = [2 * np.pi / 3000.0 / np.diff(t).max() for t in (theirs, ours)]
    assert samples_per_period[0] < 0.5 and samples_per_period[1] > 19


def test_modes_too_fast_to_draw_are_an_envelope_and_the_legend_names_them():
    sys = phc.ph(phc.modes([1.0, 3.0, 1e6], [1.0, 0.5, 0.05]), name="wide")
    plot = step_plot(sys)
    line = plot.lines[0, 0][0]
    t = line.get_xdata()
    slow = np.sin(t) + 0.5 * np.sin(3 * t)
    np.testing.assert_allclose(line.get_ydata(), slow, atol=100 * EPS)
    (envelope,) = labelled(plot.axes[0, 0], "envelope")
    vertices = envelope.get_paths()[0].vertices
    for k in range(1, len(t), 50):
        ends = vertices[np.isclose(vertices[:, 0], t[k], rtol=1e-12, atol=0), 1]
        np.testing.assert_allclose([ends.min(), ends.max()], [slow[k] - 0.05, slow[k] + 0.05], rtol=1e-9)
    assert legend_texts(plot.axes[0, 0]) == [
        "wide", "envelope with 1 mode at d = 1e+06 rad per unit time, too fast for these instants",
    ]  # fmt: skip
    assert len(t) < 2000


@pytest.mark.parametrize(("kind", "reach"), [("step", 0.05), ("impulse", 5e4 * np.sqrt(2))])
def test_an_envelope_holds_the_response_and_is_filled_by_it(kind, reach):
    # no whole multiple of the slow one, of which the default instants would show nothing at all
    modes = phc.modes([1.0, 1e6 * np.sqrt(2)], [1.0, 0.05])
    (trace,) = transient_data(modes, kind, None, None).traces
    np.testing.assert_allclose(trace.reach, [[reach]])
    rest = response_of(modes, trace.time, ["impulse", "step"].index(kind)) - trace.slow
    assert 0.9 * reach < np.abs(rest).max() <= reach * (1 + 1e-9)


def test_the_envelope_of_several_ports_lies_around_the_mean_of_the_fast_modes():
    # a gyroscopic pair: the step response of one port to the other is 1 - cos, always positive
    modes = phc.ModalForm(np.array([1e6]), np.array([[1.0, 1.0j]]), np.zeros((0, 2)))
    slow = phc.ModalForm(np.array([1.0]), np.array([[1.0, 0.0]], complex), np.zeros((0, 2)))
    both = phc.ModalForm(*(np.concatenate([getattr(s, k) for s in (slow, modes)]) for k in ("d", "nu")), modes.rigid)
    (trace,) = transient_data(both, "step", None, None).traces
    assert trace.fast.tolist() == [1e6]
    fine = response_of(modes, np.linspace(0.0, 1e-4, 5001), 1)
    for i, j in itertools.product(range(2), repeat=2):
        middle = trace.slow[i, j] - response_of(slow, trace.time, 1)[i, j]
        np.testing.assert_allclose(middle, middle[0], atol=1e-12)
        ends = [middle[0] - trace.reach[i, j], middle[0] + trace.reach[i, j]]
        np.testing.assert_allclose([fine[i, j].min(), fine[i, j].max()], ends, atol=0.001)


def test_instants_of_ones_own_that_are_too_coarse_are_dots_in_an_envelope():
    sys = phc.modes([1.0, 30.0], [1.0, 0.2])
    t = np.linspace(0.0, 20.0, 101)
    plot = step_plot(sys, t)
    (dots,) = plot.lines[0, 0]
    assert (dots.get_linestyle(), dots.get_marker()) == ("None", ".")
    np.testing.assert_allclose(dots.get_ydata(), np.sin(t) + 0.2 * np.sin(30 * t), atol=100 * EPS)
    assert legend_texts(plot.axes[0, 0])[0].endswith("(samples)")
    assert len(labelled(plot.axes[0, 0], "1 mode at d = 30 ")) == 1
    # the same number of instants, asked for
    assert step_plot(sys, 20.0, timepts_num=101).lines[0, 0][0].get_linestyle() == "None"
    fine = step_plot(sys, np.linspace(0.0, 20.0, 2001))
    assert fine.lines[0, 0][0].get_linestyle() == "-" and fine.legend is None


def test_instants_need_not_be_equally_spaced():
    t = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.01, 2.0, 30)])
    np.testing.assert_allclose(step_plot(phc.modes(2.0, 1.0), t).lines[0, 0][0].get_ydata(), np.sin(2 * t), atol=1e-14)


def test_a_response_of_thousands_of_periods_is_thinned_but_keeps_its_extremes():
    (line,) = impulse_plot(phc.modes([1.0, 1500.0], [1.0, 1.0])).lines[0, 0]
    assert len(line.get_xdata()) <= 6000
    assert 1490 < line.get_ydata().max() <= 1501.0
    assert -1501.0 <= line.get_ydata().min() < -1490


# --- pictures of responses ---


def test_a_mixed_list_has_a_line_for_each_on_one_axis_of_time():
    chain = phc.frenkel_kontorova(name="chain")
    lag = ct.tf([1], [1, 1], name="lag")
    damped = ct.tf([1, 0.1], [1, 0.2, 1], name="damped")
    sampled = ct.sample_system(lag, 0.5, name="sampled")
    plot = step_plot([chain, ct.ss(chain, name="plain"), ct.tf(chain, name="tf"), damped, lag, sampled])
    assert legend_texts(plot.axes[0, 0]) == ["chain", "plain", "tf", "damped", "lag", "sampled"]
    lines = plot.lines[0, 0]
    for line in lines[1:3]:
        np.testing.assert_allclose(line.get_ydata(), lines[0].get_ydata(), atol=1e-9)
    for line, sys in zip(lines[3:5], (damped, lag), strict=True):
        np.testing.assert_allclose(line.get_ydata(), ct.step_response(sys, line.get_xdata()).outputs, atol=1e-9)
    assert lines[5].get_drawstyle() == "steps-post"
    np.testing.assert_allclose(np.diff(lines[5].get_xdata()), 0.5)
    np.testing.assert_allclose(lines[5].get_ydata(), 1 - np.exp(-lines[5].get_xdata()), atol=1e-12)
    longest = ct.step_response(damped).time[-1]
    assert longest > 6 * np.pi / chain.d[0]
    assert plot.axes[0, 0].get_xlim() == pytest.approx((0.0, longest), rel=1e-12)
    assert plot.axes[0, 0].get_ylabel() == "Output"


def test_an_undamped_system_in_plain_form_is_not_stepped_but_summed():
    sys = phc.ph(phc.modes([1.0, 1000.0], [1.0, 0.1]))
    (trace,) = transient_data(ct.ss(sys), "step", None, None).traces
    exact = np.sin(trace.time) + 0.1 * np.sin(1000 * trace.time)
    np.testing.assert_allclose(trace.values[0, 0], exact, atol=1e-9)


def test_an_ordinary_system_too_fast_for_its_horizon_is_shown_in_part_and_says_so():
    stiff = ct.tf([1], [1, 1, 0.01], name="slow") + ct.tf([1e4, 0], [1, 1e-4, 1e8])
    stiff = ct.ss(stiff, name="stiff")
    numbers = transient_data(stiff, "step", 1000.0, None)
    (trace,) = numbers.traces
    assert trace.label.startswith("stiff (to ") and "1e+04 rad per unit time" in trace.label
    assert 1e4 * np.diff(trace.time).max() <= 2 * np.pi / 8 * (1 + 1e-9)
    assert trace.time[-1] < 1000.0
    dots = step_plot(stiff, np.linspace(0.0, 1.0, 50)).lines[0, 0][0]
    assert dots.get_linestyle() == "None"


def measured_response(system, kind, t, **keywords):
    respond = phc.step_response if kind == "step" else phc.impulse_response
    return respond(system, t, **keywords)


@pytest.mark.parametrize("kind, plot_function", [("step", step_plot), ("impulse", impulse_plot)])
def test_a_measured_response_is_drawn_as_dots_for_as_long_as_it_was_measured(kind, plot_function):
    chain, t = phc.frenkel_kontorova(name="chain"), np.linspace(0.0, 7.0, 36)
    record = measured_response(chain, kind, t)
    record.y[..., 3] = np.nan
    plot = plot_function(chain, data=record, data_label="sensor <1>", color="C2")
    line, dots = plot.lines[0, 0]
    assert np.array_equal(dots.get_xdata(), t) and np.array_equal(dots.get_ydata(), record.y.ravel(), equal_nan=True)
    assert dots.get_linestyle() == "None" and dots.get_color() != line.get_color() == "C2"
    assert plot.axes[0, 0].get_xlim() == (0.0, 7.0) and line.get_xdata()[-1] == 7.0
    assert legend_texts(plot.axes[0, 0]) == ["chain", "sensor <1>"]
    assert plot_function(chain, 20.0, data=record).axes[0, 0].get_xlim() == (0.0, 20.0)


def test_measured_steps_at_several_inputs_have_a_trace_each():
    system, t = phc.ph(*gyroscopic()), np.linspace(0.0, 5.0, 51)
    record = phc.step_response(system, t)
    plot = step_plot(system, data=record)
    for (i, j), lines in np.ndenumerate(plot.lines):
        assert np.array_equal(lines[1].get_ydata(), record.y[i, j])


@pytest.mark.parametrize(
    "data, message",
    [
        ([1.0, 2.0], "data is a list; pass the measured response as control.TimeResponseData"),
        (
            ct.TimeResponseData(np.arange(3.0), np.zeros((1, 3)), inputs=np.full((1, 3), 5.0), issiso=True),
            "is not a unit step: it is between 5 and 5, allowed 1 +- 0.01; divide the outputs by its height, or use",
        ),
        (
            ct.TimeResponseData(np.arange(3.0), np.zeros((2, 3)), inputs=np.ones((1, 3))),
            "outputs of shape (2, 3); expected those of 1 outputs for a step at each of 1 inputs",
        ),
        (ct.TimeResponseData(np.arange(3.0), np.zeros((1, 3)), issiso=True), None),
    ],
    ids=["list", "height", "outputs", "without inputs"],
)
def test_data_that_are_no_step_response_say_why(data, message):
    if message is None:
        assert len(step_plot(phc.modes(1.0, 1.0), data=data).lines[0, 0]) == 2
        return
    with pytest.raises(StructureError, match=re.escape(message)):
        step_plot(phc.modes(1.0, 1.0), data=data)


@pytest.mark.parametrize("kind", PLOTS)
def test_titles_labels_and_units(kind):
    chain = phc.frenkel_kontorova(name="chain")
    plot = PLOTS[kind](chain, output_unit="m/s", time_unit="ms")
    assert plot.axes[0, 0].get_ylabel() == "v [m/s]"
    assert plot.axes[0, 0].get_xlabel() == "Time [ms]"
    assert plot.figure.get_suptitle() == f"{kind.capitalize()} response of chain"
    assert plot.legend is None
    assert PLOTS[kind](chain, title="Mine").figure.get_suptitle() == "Mine"
    assert legend_texts(PLOTS[kind]([chain, chain], label=["a", "b"]).axes[0, 0]) == ["a", "b"]


def test_several_ports_are_a_table_of_outputs_below_and_inputs_beside():
    sys = ct.ss(phc.spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=[0, 2]))
    plot = step_plot(sys)
    assert plot.axes.shape == plot.lines.shape == (2, 2)
    assert [axis.get_title(loc="left") for axis in plot.axes[0]] == ["From F_1", "From F_2"]
    assert [axis.get_ylabel() for axis in plot.axes[:, 0]] == ["v_1", "v_2"]
    t, y = plot.lines[1, 0][0].get_data()
    np.testing.assert_allclose(y, ct.step_response(sys, t).outputs[1, 0], atol=1e-9)


@pytest.mark.parametrize("plot_function", [*PLOTS.values(), modes_plot, pole_zero_plot])
def test_axes_of_ones_own_and_style_keywords_are_used(plot_function):
    before = dict(plt.rcParams.copy())
    figure, axes = plt.subplots()
    chain = phc.frenkel_kontorova(name="chain")
    plot = plot_function(chain, ax=axes, color="C7", rcParams={"axes.labelsize": 21.0}, show_legend=True, grid=False)
    assert plot.figure is figure and plot.axes[0, 0] is axes
    assert figure.get_suptitle() == ""
    assert plot.lines[0, 0][0].get_color() == "C7"
    assert plot.legend is not None
    assert dict(plt.rcParams.copy()) == before
    assert plot_function(chain, rcParams={"axes.labelsize": 21.0}).axes[0, 0].xaxis.label.get_size() == 21.0
    with pytest.raises(StructureError, match="ax has"):
        plot_function(chain, ax=plt.subplots(3, 3)[1])
    with pytest.raises(TypeError, match="colour"):
        plot_function(chain, colour="red")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sysdata": []}, "the list of systems is empty"),
        ({"sysdata": 3}, "a int has no poles"),
        ({"sysdata": ct.frd([1.0], [1.0])}, "has no poles"),
        ({"sysdata": [ct.tf(1, [1, 1]), ct.rss(2, 2, 2)]}, "the systems differ in"),
        ({"timepts": [0.0]}, "the time vector has 1 entries"),
        ({"timepts": [-1.0, 1.0]}, "none before 0"),
        ({"timepts": [0.0, 2.0, 1.0]}, "ascending"),
        ({"timepts": -1.0}, "the last instant"),
        ({"timepts_num": 1}, "timepts_num is 1"),
        ({"confidence": 3}, "confidence is a int"),
        ({"label": ["a", "b"]}, "2 labels for 1 systems"),
    ],
)
def test_a_response_that_cannot_be_drawn_says_why(arguments, message):
    with pytest.raises(StructureError, match=message):
        step_plot(**({"sysdata": phc.frenkel_kontorova()} | arguments))


# --- bands of responses ---


def models(k=100, n=2):
    rng = np.random.default_rng(3)
    d, r = np.arange(1.0, 2 * n, 2.0), np.ones(n)
    return lossless_draws(*(x * (1 + 0.01 * rng.standard_normal((k, n))) for x in (d, r)))


@pytest.mark.parametrize("kind", PLOTS)
def test_the_band_of_a_response_is_that_of_the_models(kind):
    drawn = models()
    plot = PLOTS[kind](phc.modes([1.0, 3.0], [1.0, 1.0]), 10.0, confidence=drawn, level=0.8)
    (band,) = labelled(plot.axes[0, 0], "80 % band")
    line = plot.lines[0, 0][0]
    assert np.allclose(band.get_facecolor()[0, :3], to_rgb(line.get_color()))
    t = line.get_xdata()[1:-1:29]
    low, high = (drawn.step_band if kind == "step" else drawn.impulse_band)(t, 0.8)
    vertices = band.get_paths()[0].vertices
    for x, bottom, top in zip(t, low, high, strict=True):
        ends = vertices[vertices[:, 0] == x, 1]
        np.testing.assert_allclose([ends.min(), ends.max()], [bottom, top], atol=1e-12)


def test_a_band_that_costs_too_much_is_drawn_for_the_beginning_and_says_so(monkeypatch):
    monkeypatch.setattr(transients, "_MOST_IN_BAND", 100_000)
    drawn = models(k=100, n=4)
    plot = step_plot(phc.modes(drawn.d[0], np.ones(4)), 1000.0, confidence=drawn)
    (band,) = labelled(plot.axes[0, 0], "band")
    end = band.get_paths()[0].vertices[:, 0].max()
    assert 0.0 < end < 1000.0
    assert band.get_label() == f"95 % band (to {end:.3g})"


def test_a_band_is_not_drawn_where_it_would_be_aliased():
    with pytest.raises(StructureError, match="do not resolve 1 mode at d = 1e"):
        step_plot(phc.modes([1.0, 1e6], [1.0, 1.0]), confidence=models())


@pytest.mark.parametrize("kind", PLOTS)
def test_a_band_is_drawn_around_systems_of_every_kind(kind):
    damped = phc.ph(phc.modes(1.0, 1.0, damping=0.02))
    assert damped.nstates == 2 and not damped.is_lossless
    for sys in (damped, ct.ss(damped), ct.tf([1], [1, 1]), phc.affine(np.eye(2), [1, 0])):
        plot = PLOTS[kind](sys, 10.0, confidence=models(n=1))
        assert labelled(plot.axes[0, 0], "95 % band")


# --- modes ---


@pytest.mark.variants
@pytest.mark.parametrize("quantity", ["kappa", "r"])
def test_a_stem_stands_at_every_frequency_as_high_as_its_weight(quantity):
    modes = phc.modes([1.0, 2.0, 5.0], [1.0, 0.25, 0.5])
    plot = modes_plot(modes, quantity=quantity, gain_unit="m/s/N")
    heads = plot.lines[0, 0][0]
    np.testing.assert_array_equal(heads.get_xdata(), modes.d)
    np.testing.assert_array_equal(heads.get_ydata(), getattr(modes, quantity))
    segments = plot.axes[0, 0].collections[0].get_segments()
    np.testing.assert_array_equal([(s[0][1], s[1][1]) for s in segments], [(0.0, h) for h in heads.get_ydata()])
    expected = {"kappa": "Residue κ = r d [(m/s/N)/time]", "r": "Weight r [m/s/N]"}
    assert plot.axes[0, 0].get_ylabel() == expected[quantity]
    assert plot.axes[0, 0].get_xlabel() == "Natural frequency [rad/time]"
    assert plot.axes[0, 0].get_ylim()[1] > heads.get_ydata().max()


def test_frequencies_can_be_in_hertz_of_any_unit_of_time_that_is_known():
    plot = modes_plot(phc.modes([1.0, 2.0], [1.0, 1.0]), Hz=True)
    np.testing.assert_allclose(plot.lines[0, 0][0].get_xdata(), np.array([1.0, 2.0]) / (2 * np.pi))
    assert plot.axes[0, 0].get_xlabel() == "Natural frequency [Hz]"
    assert modes_plot(phc.modes(1.0, 1.0), time_unit="ms").axes[0, 0].get_xlabel() == "Natural frequency [rad/ms]"
    in_ms = modes_plot(phc.modes([1.0, 2.0], [1.0, 1.0]), Hz=True, time_unit="ms")
    np.testing.assert_allclose(in_ms.lines[0, 0][0].get_xdata(), np.array([1e3, 2e3]) / (2 * np.pi))
    with pytest.raises(StructureError, match="Hz needs a known unit of time"):
        modes_plot(phc.modes(1.0, 1.0), Hz=True, time_unit="samples")


@pytest.mark.parametrize(
    ("d", "r", "scales"),
    [
        ([1.0, 99.0], [1.0, 1.0], ("linear", "linear")),
        ([1.0, 101.0], [1.0, 1.0], ("log", "linear")),
        ([1.0, 2.0], [1.0, 1e-3], ("linear", "linear")),
        ([1.0, 2.0], [1.0, 1e-4], ("linear", "log")),
    ],
)
def test_scales_are_logarithmic_where_the_modes_span_decades(d, r, scales):
    axis = modes_plot(phc.modes(d, r)).axes[0, 0]
    assert (axis.get_xscale(), axis.get_yscale()) == scales
    low, high = axis.get_xlim()
    assert low < d[0] and high > d[1]
    bottom, top = axis.get_ylim()
    assert bottom < min(np.multiply(d, r)) and top > max(np.multiply(d, r))


def test_an_unreached_mode_has_a_hollow_head():
    plot = modes_plot(phc.modes([1.0, 2.0, 3.0], [1.0, 0.0, 1.0]))
    (hollow,) = [line for line in plot.axes[0, 0].lines if "not reached" in str(line.get_label())]
    assert hollow.get_xdata().tolist() == [2.0] and hollow.get_markerfacecolor() == "white"
    assert not [line for line in modes_plot(phc.modes(1.0, 1.0)).axes[0, 0].lines if "not" in str(line.get_label())]


def test_a_pole_at_zero_has_its_residue_at_zero_or_in_the_legend():
    free = phc.spring_chain([1.0, 2.0, 3.0], name="free")
    plot = modes_plot(free)
    heads = [line.get_xydata() for line in plot.axes[0, 0].lines if line.get_xdata()[0] == 0]
    np.testing.assert_allclose(heads, [[[0.0, free.modes.kappa_0]]])
    wide = phc.ph(phc.modes([0.01, 100.0], [1.0, 1.0]), name="wide")
    assert legend_texts(modes_plot([free, wide]).axes[0, 0])[0] == "free (and 0.167 at 0)"


def test_every_port_has_a_panel():
    plot = modes_plot(phc.spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=[0, 2]))
    assert plot.axes.shape == (2, 1)
    sys = phc.spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=[0, 2])
    for port in (0, 1):
        np.testing.assert_array_equal(plot.lines[port, 0][0].get_ydata(), sys.modes.kappa[:, port])
    assert [axis.get_title(loc="left") for axis in plot.axes[:, 0]] == ["Port v_1", "Port v_2"]


def fitted(noise=0.5):
    rng = np.random.default_rng(0)
    plant, u = phc.ph(phc.modes([1.0, 2.5], [1.0, 0.3])), rng.standard_normal(400)
    y = phc.forced_response(plant, 0.2 * np.arange(400), u, intersample="zoh").outputs
    y = y + noise * rng.standard_normal(400)
    return phc.pem((u, y), 2, dt=0.2), plant


def test_a_fit_is_drawn_with_its_intervals():
    result, plant = fitted()
    intervals = result.confidence_interval(0.9)
    plot = modes_plot([result, plant], quantity="r", level=0.9, label=["fit", "truth"])
    (bars,) = plot.axes[0, 0].containers
    assert bars.get_label() == "90 % intervals"
    horizontal, vertical = (np.array(c.get_segments()) for c in bars[2])
    np.testing.assert_allclose(vertical[:, :, 1], intervals["r"])
    np.testing.assert_allclose(horizontal[:, :, 0], intervals["d"])
    np.testing.assert_array_equal(vertical[:, 0, 0], result.d)
    assert legend_texts(plot.axes[0, 0]) == ["fit", "truth", "90 % intervals"]
    assert bars.has_yerr and not bars.has_xerr  # in the legend
    assert plot.axes[0, 0].get_ylim()[1] > vertical[:, :, 1].max()


@pytest.mark.slow
def test_intervals_of_residues_follow_from_those_of_weights_and_frequencies():
    result, _ = fitted(noise=1.0)
    ends = result.confidence_interval(0.9)["kappa"]
    (bars,) = modes_plot(result, level=0.9).axes[0, 0].containers
    np.testing.assert_allclose(np.array(bars[2][1].get_segments())[:, :, 1], ends)
    draws = 2 * result.sample(100_000, rng=2).residues[:, :, 0, 0].real
    # of many more residuals than parameters Student's distribution is the normal one to half a percent
    np.testing.assert_allclose(ends[:, 1] - result.kappa, 1.645 * draws.std(axis=0), rtol=0.015)
    np.testing.assert_allclose(ends.mean(axis=1), result.kappa)


def test_modes_are_those_of_continuous_time():
    np.testing.assert_allclose(modes_plot(ct.tf([2, 0], [1, 0, 4])).lines[0, 0][0].get_xdata(), [2.0])
    np.testing.assert_allclose(modes_plot(ct.tf([3], [1, 2])).lines[0, 0][0].get_xydata(), [[2.0, 3.0]])
    with pytest.raises(NotLosslessError, match="discrete-time"):
        modes_plot(ct.tf([1], [1, 0.5], 0.1))
    with pytest.raises(StructureError, match="quantity is 'v'"):
        modes_plot(phc.modes(1.0, 1.0), quantity="v")


# --- poles and zeros ---


def test_poles_and_zeros_lie_on_the_axis_where_they_are_and_alternate():
    chain = phc.frenkel_kontorova(5)
    plot = pole_zero_plot(chain)
    poles, zeros = plot.lines[0, 0]
    np.testing.assert_array_equal(poles.get_xdata(), chain.d)
    np.testing.assert_array_equal(zeros.get_xdata(), [w for w in chain.zeros().imag if w >= 0])
    assert (poles.get_marker(), zeros.get_marker(), zeros.get_markerfacecolor()) == ("x", "o", "none")
    assert set(poles.get_ydata()) == set(zeros.get_ydata()) == {0.0}
    assert legend_texts(plot.axes[0, 0]) == ["5 poles", "5 zeros, alternating"]
    assert plot.axes[0, 0].get_xlabel() == "Imaginary part, upper half [rad/time]"
    low, high = plot.axes[0, 0].get_xlim()
    assert low < 0 and high > chain.d[-1]


@quick
@given(st.lists(st.floats(0.1, 10.0), min_size=1, max_size=10, unique_by=lambda d: round(d, 4)))
def test_lossless_systems_alternate_and_a_swapped_pair_does_not(d):
    one = pole_zero_map(*subjects_of(phc.modes(d, np.ones(len(d))), None))
    assert one.alternating and one.cancelled == 0
    swapped = PoleZeroMap("", one.zeros, one.poles, True, False)
    assert swapped.alternating
    if len(d) > 1:
        doubled = PoleZeroMap("", one.poles, np.concatenate([one.zeros, one.zeros[-1:] * 1.0001]), True, False)
        assert not doubled.alternating


def test_a_mode_that_the_port_does_not_reach_is_counted_as_cancelled():
    plot = pole_zero_plot(phc.modes([1.0, 2.0, 3.0], [1.0, 0.0, 1.0]))
    assert legend_texts(plot.axes[0, 0]) == ["3 poles", "3 zeros, 1 cancelled"]


def test_a_hundred_modes_are_parted_into_strips_that_show_each_once():
    rng = np.random.default_rng(0)
    sys = phc.ph(phc.modes(np.cumsum(rng.uniform(0.3, 1.7, 100)), rng.uniform(0.1, 1.0, 100)))
    plot = pole_zero_plot(sys)
    assert len(plot.axes) == 5
    shown = [np.concatenate([lines[k].get_xdata() for lines in plot.lines[:, 0]]) for k in (0, 1)]
    np.testing.assert_array_equal(shown[0], sys.d)
    np.testing.assert_array_equal(shown[1], [w for w in sys.zeros().imag if w >= 0])
    for axis, (poles, zeros) in zip(plot.axes[:, 0], plot.lines[:, 0], strict=True):
        low, high = axis.get_xlim()
        assert len(poles.get_xdata()) <= 26
        for w in (poles.get_xdata(), zeros.get_xdata()):
            assert np.all((w > low) & (w < high))
    assert -0.05 * plot.axes[0, 0].get_xlim()[1] < plot.axes[0, 0].get_xlim()[0] < 0
    # the strips join
    limits = [axis.get_xlim() for axis in plot.axes[:, 0]]
    assert all(a[1] == b[0] for a, b in itertools.pairwise(limits))
    one = pole_zero_map(*subjects_of(sys, None))
    assert len(strips([one], 2)) == 2


def test_the_axis_is_parted_where_there_is_room():
    # groups of five: equally many poles in each strip would part most of the groups that it meets
    d = np.arange(1.0, 25.0).repeat(5) + np.tile(0.02 * np.arange(5), 24)
    one = pole_zero_map(*subjects_of(phc.modes(d, np.ones(120)), None))
    ranges = strips([one])
    assert len(ranges) == 5
    marks = np.concatenate(one.upper)
    for low, high in ranges:
        assert np.abs(marks[:, None] - [low, high]).min() > 0.1
        assert 18 <= np.count_nonzero((d > low) & (d < high)) <= 30


def test_several_systems_have_a_row_each_with_their_names():
    systems = [phc.frenkel_kontorova(2, name="short"), phc.frenkel_kontorova(4, name="long")]
    plot = pole_zero_plot(systems)
    heights = [set(line.get_ydata()) for line in plot.lines[0, 0]]
    assert heights == [{0.0}, {0.0}, {-1.0}, {-1.0}]
    assert [text.get_text() for text in plot.axes[0, 0].get_yticklabels()] == ["short", "long"]
    texts = [text.get_text() for text in plot.axes[0, 0].texts]
    assert texts == ["2 poles, 2 zeros, alternating", "4 poles, 4 zeros, alternating"]
    assert legend_texts(plot.axes[0, 0]) == ["poles", "zeros"]


def test_a_free_mass_shows_one_pole_at_zero_as_its_transfer_function_has():
    poles, zeros = pole_zero_plot(phc.spring_chain([1.0, 2.0, 3.0])).lines[0, 0]
    assert np.count_nonzero(poles.get_xdata() == 0) == 1 and not (zeros.get_xdata() == 0).any()


def test_frequencies_over_decades_are_logarithmic_with_zero_at_the_edge():
    plot = pole_zero_plot(phc.modes([0.01, 1.0, 100.0], [1.0, 1.0, 1.0]))
    axis = plot.axes[0, 0]
    assert axis.get_xscale() == "log"
    assert plot.lines[0, 0][1].get_xdata()[0] == axis.get_xlim()[0] < 0.01
    assert [text.get_text() for text in axis.texts] == ["0"]


def test_a_system_off_the_axis_is_drawn_in_the_complex_plane():
    damped = ct.tf([1, 0.1], [1, 0.2, 2], name="damped")
    plot = pole_zero_plot([phc.frenkel_kontorova(name="chain"), damped], Hz=True)
    assert plot.axes.shape == (1, 1)
    poles, zeros = (line.get_xydata() @ [1, 1j] * 2 * np.pi for line in plot.lines[0, 0][2:])
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(damped.poles()))
    np.testing.assert_allclose(zeros, [-0.1])
    assert (plot.axes[0, 0].get_xlabel(), plot.axes[0, 0].get_ylabel()) == ("Real part [Hz]", "Imaginary part [Hz]")
    assert legend_texts(plot.axes[0, 0]) == ["chain: poles", "chain: zeros", "damped: poles", "damped: zeros"]


def test_discrete_time_poles_are_drawn_with_the_unit_circle():
    plot = pole_zero_plot(phc.sample(phc.frenkel_kontorova(), 0.1))
    assert plot.axes[0, 0].get_xlabel() == "Real part"
    circle = max(plot.axes[0, 0].lines, key=lambda line: len(line.get_xdata()))
    np.testing.assert_allclose(np.hypot(*circle.get_data()), 1.0)
    with pytest.raises(StructureError, match="different planes"):
        pole_zero_plot([phc.frenkel_kontorova(), phc.sample(phc.frenkel_kontorova(), 0.1)])


# --- energy ---


def balance(method="exact", force=1.0):
    sys, t = phc.frenkel_kontorova(), np.linspace(0.0, 30.0, 601)
    response = phc.forced_response(sys, t, force * np.sin(t), [1.0, 0.0, 0.0, 0.0], method=method, intersample="zoh")
    return phc.energy_balance(response, sys, method=method)


def test_stored_and_supplied_energy_are_above_and_their_difference_below():
    one = balance()
    plot = energy_plot(one, time_unit="ms", energy_unit="mJ")
    stored, supplied = plot.lines[0, 0]
    (difference,) = plot.lines[1, 0]
    np.testing.assert_array_equal(stored.get_ydata(), one.stored)
    np.testing.assert_array_equal(supplied.get_ydata(), one.supplied)
    np.testing.assert_allclose(
        difference.get_ydata(), one.stored - one.stored[0] - one.supplied, atol=8 * EPS * one.stored.max()
    )
    assert legend_texts(plot.axes[0, 0]) == ["stored", "supplied since the start"]
    assert [axis.get_ylabel() for axis in plot.axes[:, 0]] == ["Energy [mJ]", "Stored less\nsupplied [mJ]"]
    assert plot.axes[1, 0].get_xlabel() == "Time [ms]"
    assert plot.axes[1, 0].get_xlim() == (0.0, 30.0)
    assert plot.figure.get_suptitle() == "Energy balance"
    assert energy_plot(one, energy_unit=None).axes[0, 0].get_ylabel() == "Energy"


def test_several_balances_are_told_apart_by_name_and_colour():
    plot = energy_plot([balance(), balance("euler", 0.0)], label=["exact", "Euler"])
    names = ["exact: stored", "exact: supplied since the start", "Euler: stored", "Euler: supplied since the start"]
    assert legend_texts(plot.axes[0, 0]) == names
    assert len({line.get_color() for line in plot.lines[0, 0]}) == 4
    assert [line.get_color() for line in plot.lines[1, 0]] == [line.get_color() for line in plot.lines[0, 0][::2]]
    # Euler's rule makes energy from nothing
    assert plot.lines[1, 0][1].get_ydata()[-1] > 0.1 > 1e3 * np.abs(plot.lines[1, 0][0].get_ydata()).max()


def test_a_balance_that_is_none_says_why():
    with pytest.raises(StructureError, match="this is a int; pass what energy_balance"):
        energy_plot(3)
    with pytest.raises(StructureError, match="1 labels for 2 balances"):
        energy_plot([balance(), balance()], label="one")
    with pytest.raises(StructureError, match="ax has 1 axes"):
        energy_plot(balance(), ax=plt.subplots()[1])


@pytest.mark.parametrize(
    "keywords",
    [
        {"ax": "a"}, {"ax": []}, {"ax": 3}, {"ax": [1, 2]}, {"legend_loc": "nowhere"}, {"rcParams": 3},
        {"rcParams": {"no.such": 1}}, {"label": 3}, {"color": "nocolour"}, {"linestyle": "zz"}, {"linewidth": "a"},
        {"grid": 3}, {"show_legend": np.ones(2)}, {"rcParams": phc.frenkel_kontorova()}, {"label": np.array("a")},
    ],
)  # fmt: skip
def test_keywords_of_pictures_are_refused_before_anything_is_drawn(keywords):
    chain, t = phc.frenkel_kontorova(), 0.1 * np.arange(100)
    balance = phc.energy_balance(phc.forced_response(chain, t, np.sin(t)), chain)
    pictures = [
        lambda **k: phc.bode_plot(chain, **k), lambda **k: phc.step_plot(chain, **k),
        lambda **k: phc.modes_plot(chain, **k), lambda **k: phc.pole_zero_plot(chain, **k),
        lambda **k: phc.energy_plot(balance, **k), lambda **k: phc.fit_plot(t, np.sin(t), np.cos(t), **k),
    ]  # fmt: skip
    ours = {"ax", "legend_loc", "rcParams"}
    for draw in pictures[: None if ours & set(keywords) else 3]:
        before = plt.get_fignums()
        with pytest.raises(StructureError, match=r"ax h|legend_loc is|matplotlib does not know|label is|True or False"):
            draw(**keywords)
        assert plt.get_fignums() == before


@pytest.mark.parametrize("unit", [3, np.ones(2), b"m"], ids=repr)
def test_a_unit_that_is_no_text_is_refused(unit):
    chain = phc.frenkel_kontorova()
    for draw in (phc.bode_plot, phc.modes_plot):
        with pytest.raises(StructureError, match="is not a text; give its name"):
            draw(chain, gain_unit=unit)


def test_a_system_whose_zeros_python_control_does_not_know_is_refused():
    system = ct.tf([[[1.0]] * 2] * 2, [[[1.0, 1.0]] * 2] * 2)
    with pytest.raises(StructureError, match=r"Convert the system with control\.ss"):
        phc.pole_zero_plot(system)

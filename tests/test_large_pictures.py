"""Pictures of many modes, and of systems that share a name: what cannot be told apart is said, not smeared."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

import ph_control as phc


def evenly_spaced(n=2000, step=0.5, kappa=1.0):
    d = step * np.arange(1, n + 1)
    return phc.ph(phc.modes(d, kappa / d), name="bar")


def texts(plot):
    return [text.get_text() for text in plot.legend.get_texts()]


@pytest.mark.slow
def test_two_thousand_modes_are_drawn_with_their_median_where_they_close_to_a_block():
    sys = evenly_spaced()
    plot = phc.bode_plot(sys)
    curve, phase = plot.lines[0, 0][0], plot.lines[1, 0][0]
    w, level = curve.get_data()
    turns = np.diff(phase.get_ydata())
    assert np.count_nonzero(turns) == 2 * 2000 - 1 and set(np.abs(turns[turns != 0])) == {180.0}
    assert np.isfinite(level).all() and len(w) < 40_000
    (median,) = (line for line in plot.axes[0, 0].lines if line is not curve)
    assert texts(plot) == ["bar", "bar: median where resonances are closer than dots"]
    x, middle = (values[np.isfinite(median.get_ydata())] for values in median.get_data())
    # equal residues at equal distances: a cotangent and the poles beyond the ends, of which the median is known
    inside = (x > 50.0) & (x < 900.0)
    x, middle = x[inside], middle[inside]
    slope, offset = np.pi / (2 * 0.5), np.log((1000.25 - x) / (1000.25 + x)) + np.log((x + 0.25) / (x - 0.25))
    assert len(x) > 20
    assert np.max(np.abs(middle - 20 * np.log10(np.hypot(slope, offset)))) < 0.5
    low, high = plot.axes[0, 0].get_ylim()
    assert low < middle.min() and middle.max() < high


@pytest.mark.slow
def test_the_block_is_pale_and_other_curves_and_dots_are_above_it():
    plot = phc.bode_plot([evenly_spaced(), ct.tf([100.0], [1.0, 30.0], name="mean")])
    block, other = plot.lines[0, 0][:2]
    for axis in plot.axes[:, 0]:
        fades = [patch for patch in axis.patches if patch.get_alpha() == 0.7]
        assert len(fades) == 1
        assert block.zorder < fades[0].zorder < other.zorder
        start, end = fades[0].get_x(), fades[0].get_x() + fades[0].get_width()
        assert 5.0 < start < 50.0 and 900.0 < end < 1100.0


def test_a_hundred_modes_are_told_apart_without_a_median():
    plot = phc.bode_plot(phc.modes(np.geomspace(1.0, 100.0, 100), np.ones(100)))
    assert plot.legend is None and len(plot.axes[0, 0].lines) == 1


def test_modes_of_which_each_has_a_dot_and_a_half_close_to_a_block():
    plot = phc.bode_plot(phc.modes(np.geomspace(1.0, 1000.0, 200), np.ones(200)))
    assert texts(plot)[1].endswith("median where resonances are closer than dots")


def test_a_fit_without_a_name_is_called_a_fit_and_a_sampled_twin_by_its_step():
    chain = phc.frenkel_kontorova(name="chain")
    u = np.random.default_rng(0).standard_normal(300)
    fit = phc.pem((u, phc.forced_response(chain, 0.1 * np.arange(300), u, intersample="zoh").outputs), 2, dt=0.1)
    systems = [fit, chain, phc.sample(chain, 0.5)]
    wanted = ["fit (2 modes)", "chain", "chain (dt = 0.5)"]
    assert texts(phc.bode_plot(systems))[:3] == wanted
    assert texts(phc.step_plot(systems)) == wanted
    assert [label.get_text() for label in phc.pole_zero_plot(systems[:2]).axes[0, 0].get_yticklabels()] == wanted[:2]
    assert texts(phc.modes_plot([fit, chain]))[:2] == wanted[:2]


@pytest.mark.parametrize(
    "sys, entries",
    [
        (phc.modes(1.0, 1.0), ["1 pole", "1 zero, alternating"]),
        (phc.modes([1.0, 2.0], [1.0, 0.0]), ["2 poles", "2 zeros, 1 cancelled"]),
        # zeros of several ports need not lie between the poles
        (phc.ph(np.diag([1.0, 4.0, 9.0, 1.0, 4.0, 9.0]), np.eye(6)[:, 3:5]), ["3 poles", "3 zeros"]),
    ],
    ids=["one", "hidden", "two ports"],
)
def test_poles_and_zeros_are_counted_in_words(sys, entries):
    assert texts(phc.pole_zero_plot(sys)) == entries


def test_a_single_mode_is_seen_from_zero_on_and_two_close_ones_are_spread_out():
    low, high = phc.modes_plot(phc.modes(3.0, 1.0)).axes[0, 0].get_xlim()
    assert low < 0 < 3.0 < high < 4.0
    low, high = phc.modes_plot(phc.modes([3.0, 3.1], [1.0, 1.0])).axes[0, 0].get_xlim()
    assert 2.8 < low < 3.0 and 3.1 < high < 3.3


def test_many_stems_have_small_heads():
    sizes = [
        phc.modes_plot(phc.modes(np.arange(1.0, n + 1), np.ones(n))).lines[0, 0][0].get_markersize() for n in (5, 100)
    ]
    assert sizes[1] < sizes[0]


def test_two_thousand_poles_stay_on_a_page_in_small_marks():
    modes = phc.modes(0.5 * np.arange(1.0, 2001), np.ones(2000))
    few, many = phc.pole_zero_plot(phc.modes(np.arange(1.0, 11), np.ones(10))), phc.pole_zero_plot(modes)
    assert many.axes.shape == (12, 1) and many.figure.get_size_inches()[1] < 14.0
    drawn = np.concatenate([lines[0].get_xdata() for lines in many.lines[:, 0]])
    assert np.array_equal(drawn, modes.d)
    assert many.lines[0, 0][0].get_markersize() < 0.6 * few.lines[0, 0][0].get_markersize()
    assert texts(many) == ["2000 poles", "2000 zeros, alternating"]


def test_a_crowd_has_no_holes_where_single_bins_happen_to_hold_few():
    rng = np.random.default_rng(3)
    sys = phc.ph(phc.modes(np.sort(10 ** rng.uniform(0, 3, 600)), np.ones(600)))
    fades = [patch for patch in phc.bode_plot(sys).axes[0, 0].patches if patch.get_alpha() == 0.7]
    assert len(fades) == 1 and fades[0].get_x() >= 0.9 and fades[0].get_x() + fades[0].get_width() <= 1100.0
    assert fades[0].get_width() > 800.0


def test_a_legend_too_long_for_one_line_has_one_entry_a_line():
    plot = phc.step_plot(phc.modes([1.0, 3e5, 4e5, 5e5], np.ones(4)))
    plot.figure.canvas.draw()
    assert plot.legend._ncols == 1
    assert plot.legend.get_window_extent().x0 >= 0
    assert phc.step_plot([phc.frenkel_kontorova(name="one"), phc.modes(1.0, 1.0)]).legend._ncols == 4

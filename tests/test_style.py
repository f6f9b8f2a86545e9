"""Every picture is a `control.ControlPlot`, and takes the keywords of style that python-control's pictures take."""

from __future__ import annotations

import functools

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest

import ph_control as phc
from ph_control import StructureError


@functools.cache
def plants():
    return [phc.frenkel_kontorova(name="chain"), ct.tf([1.0, 0.0], [1.0, 0.2, 4.0], name="damped")]


@functools.cache
def record():
    rng = np.random.default_rng(0)
    t, u = 0.1 * np.arange(400), rng.standard_normal(400)
    y = phc.forced_response(plants()[0], t, u, intersample="zoh").outputs + 0.01 * rng.standard_normal(400)
    return ct.TimeResponseData(t, y, inputs=u, input_labels=["F"], output_labels=["v"], issiso=True)


@functools.cache
def response():
    omega = np.linspace(0.05, 3.0, 60)
    noise = 0.01 * np.random.default_rng(1).standard_normal((60, 2)) @ [1, 1j]
    return ct.frd(plants()[0](1j * omega) + noise, omega)


@functools.cache
def fitted():
    return phc.pem(record(), 2)


@functools.cache
def balance():
    t = np.linspace(0.0, 20.0, 401)
    return phc.energy_balance(phc.forced_response(plants()[0], t, np.sin(t)), plants()[0])


@functools.cache
def residuals(data):
    return phc.residual_analysis(data(), plants()[0])


@functools.cache
def comparison(data):
    return phc.compare(data(), *plants())


@functools.cache
def orders():
    return phc.order_selection(record(), 2)


@functools.cache
def structure():
    return phc.modes([-0.1 + 10j, -0.5 + 40j], [[1.0, 0.5], [1.0, -1.0]], [[0.1], [0.2j]]).state_space()


# each with the shape of its axes, and with the object whose method `plot` draws the same
PICTURES = {
    "bode": (lambda **k: phc.bode_plot(plants(), **k), (2, 1)),
    "step": (lambda **k: phc.step_plot(plants(), **k), (1, 1)),
    "impulse": (lambda **k: phc.impulse_plot(plants(), **k), (1, 1)),
    "modes": (lambda **k: phc.modes_plot([plants()[0], fitted()], **k), (1, 1)),
    "poles": (lambda **k: phc.pole_zero_plot(plants()[0], **k), (1, 1)),
    "plane": (lambda **k: phc.pole_zero_plot(plants(), **k), (1, 1)),
    "energy": (lambda **k: phc.energy_plot(balance(), **k), (2, 1)),
    "fit": (lambda **k: phc.fit_plot(fitted(), detail=[5.0, 15.0], **k), (3, 1)),
    "comparison": (lambda **k: phc.compare_plot(comparison(record), detail=[5.0, 15.0], **k), (3, 1)),
    "comparison of responses": (lambda **k: phc.compare_plot(comparison(response), **k), (3, 1)),
    "residuals": (lambda **k: phc.residual_plot(residuals(record), **k), (2, 1)),
    "residual response": (lambda **k: phc.residual_plot(residuals(response), **k), (2, 1)),
    "responses": (lambda **k: phc.frf_plot(fitted(), segments=2, **k), (2, 1)),
    "nyquist": (lambda **k: phc.nyquist_plot(structure(), ct.frd(structure(), np.arange(1.0, 90.0)), **k), (1, 2)),
    "circles": (lambda **k: phc.circle_plot(structure(), ct.frd(structure(), np.arange(1.0, 90.0)), **k), (1, 2)),
    "shapes": (lambda **k: phc.shape_plot(np.array([[1.0, 0.5j, 0.3], [1.0, 0.2, -1.0]]), **k), (1, 2)),
    "stabilisation": (lambda **k: phc.stabilisation_plot([[1j], [1j, -1 + 2j]], chosen=2, **k), (1, 1)),
    "residuals of a fit": (lambda **k: phc.residual_plot(fitted(), **k), (1, 1)),
    "order": (lambda **k: phc.order_plot(orders(), **k), (1, 2)),
}
all_pictures = pytest.mark.parametrize("picture, shape", PICTURES.values(), ids=PICTURES)


def legends(axes):
    return [axis.get_legend() for axis in axes.ravel() if axis.get_legend()]


@all_pictures
def test_every_picture_is_a_control_plot_with_lines_and_labels_on_every_panel(picture, shape):
    plot = picture()
    assert isinstance(plot, ct.ControlPlot)
    assert plot.axes.shape == plot.lines.shape == shape
    assert plot.figure.get_suptitle()
    for axis, lines in zip(plot.axes.ravel(), plot.lines.ravel(), strict=True):
        assert axis.figure is plot.figure
        assert len(lines) and all(line.axes is axis for line in lines)
        assert (
            axis.get_ylabel() or axis.get_yticks().size == 0 or axis.get_shared_y_axes().joined(axis, plot.axes[0, 0])
        )
    assert all(axis.get_xlabel() for axis in plot.axes[-1])


@pytest.mark.variants
@all_pictures
def test_every_picture_is_drawn_on_axes_of_ones_own(picture, shape):
    figure, axes = plt.subplots(*shape, squeeze=False)
    plot = picture(ax=axes)
    assert plot.figure is figure and plot.axes.tolist() == axes.tolist()
    assert figure.get_suptitle() == ""
    assert all(axis.lines for axis in axes.ravel())
    with pytest.raises(StructureError, match=r"ax has 7 axes[;,] (expected|but there are poles for)"):
        picture(ax=plt.subplots(7)[1])


@pytest.mark.variants
@all_pictures
def test_every_picture_takes_a_title_a_grid_a_legend_and_settings(picture, shape):
    plot = picture(title="$T$", grid=False, show_legend=False, rcParams={"axes.facecolor": "#fafaf0"})
    assert plot.figure.get_suptitle() == r"\$T\$"
    assert not legends(plot.axes)
    for axis in plot.axes.ravel():
        assert not any(line.get_visible() for line in axis.get_xgridlines() + axis.get_ygridlines())
        assert axis.get_facecolor()[:3] == pytest.approx((0xFA / 255, 0xFA / 255, 0xF0 / 255))
    assert any(line.get_visible() for axis in picture().axes.ravel() for line in axis.get_xgridlines())
    assert legends(picture(legend_loc="lower left").axes)[0]._loc == 3


@all_pictures
def test_an_unknown_keyword_of_style_is_an_error_that_names_the_known_ones(picture, shape):
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'colour'; of style: title, grid, show_legend"):
        picture(colour="red")


def test_a_width_beyond_all_numbers_is_an_error():
    with pytest.raises(phc.StructureError, match="matplotlib does not know this style"):
        PICTURES["bode"][0](linewidth=10**400)


@pytest.mark.parametrize("name", ["bode", "step", "impulse", "modes", "energy", "poles"])
def test_curves_take_the_colour_that_was_asked_for(name):
    lines = PICTURES[name][0](color="#123456").lines.ravel()
    assert {line.get_color() for panel in lines for line in panel} == {"#123456"}


def same_picture(one, other):
    """Whether two pictures hold the same data on each of their lines."""
    pairs = [
        (a.get_xydata(), b.get_xydata())
        for left, right in zip(one.axes.ravel(), other.axes.ravel(), strict=True)
        for a, b in zip(left.lines, right.lines, strict=True)
    ]
    return len(pairs) > 0 and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


@pytest.mark.variants
@pytest.mark.parametrize(
    "function, make",
    [
        (phc.energy_plot, balance),
        (phc.fit_plot, fitted),
        (phc.compare_plot, lambda: comparison(record)),
        (phc.residual_plot, lambda: residuals(record)),
        (phc.order_plot, orders),
    ],
    ids=["energy", "fit", "comparison", "residuals", "order"],
)
def test_the_function_draws_what_the_method_draws(function, make):
    found = make()
    one, other = function(found, title="same"), found.plot(title="same")
    assert same_picture(one, other)
    assert [axis.get_ylabel() for axis in one.axes.ravel()] == [axis.get_ylabel() for axis in other.axes.ravel()]
    assert one.figure.get_suptitle() == other.figure.get_suptitle() == "same"


@pytest.mark.parametrize(
    "function, call",
    [
        (phc.compare_plot, r"compare\(data, \*models\)"),
        (phc.residual_plot, r"residual_analysis\(data, model\)"),
        (phc.order_plot, r"order_selection\(data, orders\)"),
        (phc.energy_plot, r"energy_balance\(response, sys\)"),
    ],
)
def test_what_is_no_such_result_is_refused_with_the_call_that_makes_one(function, call):
    with pytest.raises(StructureError, match=f"this is a PortHamiltonian; pass what {call} gives"):
        function(plants()[0])


def test_a_fit_is_drawn_from_its_result_or_from_three_signals_but_not_from_fewer():
    assert phc.fit_plot(fitted(), detail=None).axes.shape == (2, 1)
    assert (
        phc.fit_plot(fitted(), output_label="velocity", output_unit="m/s").axes[0, 0].get_ylabel() == "velocity [m/s]"
    )
    with pytest.raises(StructureError, match="pass the time, the measured and the predicted output, or the result"):
        phc.fit_plot(record().time, record().outputs)

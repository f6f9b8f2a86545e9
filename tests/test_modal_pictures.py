"""Pictures of modal tests: frequency responses with data, circles, stabilisation, mode shapes, assurance, residuals."""

from types import SimpleNamespace

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from slow import slowly

import ph_control as phc
from ph_control import StructureError

EPS = np.finfo(float).eps
HERTZ, RATIOS = np.array([20.0, 45.0, 80.0]), np.array([0.01, 0.005, 0.02])


def legend_texts(legend):
    return [text.get_text() for text in legend.get_texts()]


def result(p=3, m=1, k=2, **more):
    """What a fit of `p` outputs and `m` inputs has: classical damping, outputs that are displacements times `s**k`."""
    x = np.arange(1, p + 1) / p
    psi = np.array([np.sin(0.5 * np.pi * (2 * l + 1) * x) + 0.1 for l in range(3)])
    d = 2 * np.pi * HERTZ
    poles = d * (-RATIOS + 1j * np.sqrt(1 - RATIOS**2))
    b = np.array([np.cos(l * np.arange(1, m + 1)) for l in range(3)])
    residues = psi[:, :, None] * b[:, None, :] * (poles**k / (2j * poles.imag))[:, None, None]
    return SimpleNamespace(
        poles=poles, residues=residues, feedthrough=np.zeros((p, m)), shapes=psi.astype(complex), time_unit="s",
        natural_frequencies=d, hertz=HERTZ, damping_ratios=RATIOS, stderr={"shapes": np.full(psi.shape, 0.02 + 0.03j)},
        output_labels=[f"y{i + 1}" for i in range(p)], input_labels=[f"u{i + 1}" for i in range(m)], order=3, **more,
    )  # fmt: skip


def exact(fit, omega):
    """Sum over the fractions, written out."""
    s = 1j * np.asarray(omega)
    terms = [
        rho[:, :, None] / (s - p) + rho.conj()[:, :, None] / (s - np.conj(p))
        for rho, p in zip(fit.residues, fit.poles, strict=True)
    ]
    return sum(terms) + fit.feedthrough[:, :, None]


def measured(fit, noise=0.0, count=200, low=5.0, high=100.0):
    omega = 2 * np.pi * np.linspace(low, high, count)
    values, rng = exact(fit, omega), np.random.default_rng(0)
    scale = noise * np.abs(values).mean(axis=2, keepdims=True)
    values = values + scale * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    return ct.frd(values, omega)


# --- frequency responses ---------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("k", [0, 1, 2], ids=["displacement", "velocity", "acceleration"])
def test_curves_are_the_response_of_the_quantity_measured(k):
    fit = result(2, 2, k)
    plot = phc.frf_plot(fit, time_unit="s")
    assert plot.axes.shape == (4, 2)
    for i in range(2):
        for j in range(2):
            gain, phase = plot.lines[2 * i, j][0], plot.lines[2 * i + 1, j][0]
            expected = exact(fit, 2 * np.pi * gain.get_xdata())[i, j]
            np.testing.assert_allclose(10 ** (gain.get_ydata() / 20), np.abs(expected), rtol=1e-9)
            seen = np.isfinite(phase.get_ydata())
            turns = np.exp(1j * np.radians(phase.get_ydata()[seen])) * np.abs(expected[seen])
            np.testing.assert_allclose(turns, expected[seen], rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
def test_peaks_and_notches_are_resolved():
    fit = result(1)
    frequency, gain = phc.frf_plot(fit).lines[0, 0][0].get_data()
    fine = np.linspace(15.0, 90.0, 2_000_001)
    truth = 20 * np.log10(np.abs(exact(fit, 2 * np.pi * fine)[0, 0]))
    for extreme in (np.argmax, np.argmin):
        assert abs(gain[extreme(gain)] - truth[extreme(truth)]) < 0.1
        assert abs(frequency[extreme(gain)] - fine[extreme(truth)]) < 0.02


def test_measured_phases_are_beside_the_model_and_no_model_jumps_in_the_middle():
    """Noise about 180 degrees must not throw dots to the other end."""
    fit = result(3, 1)
    plot = phc.frf_plot(fit, measured(fit, noise=0.02))
    for column in range(3):
        model, dots = plot.lines[1, column]
        phase = np.interp(dots.get_xdata(), model.get_xdata(), np.nan_to_num(model.get_ydata()))
        near = np.abs(dots.get_ydata() - phase) < 20.0
        assert near.mean() > 0.95
        low, high = plot.axes[1, column].get_ylim()
        assert ((low < dots.get_ydata()) & (dots.get_ydata() < high)).mean() > 0.97
    np.testing.assert_allclose(plot.lines[0, 1][1].get_ydata(), 20 * np.log10(np.abs(measured(fit, 0.02).frdata[1, 0])))


PANELS = {(1, 1): (2, 1), (4, 1): (4, 2), (5, 1): (4, 3), (9, 1): (6, 3), (9, 2): (18, 2), (1, 3): (2, 3)}


@pytest.mark.parametrize("p, m", [*list(PANELS)[:2], *slowly(*list(PANELS)[2:])])
def test_panels_stay_wide_enough_to_read(p, m):
    shape = PANELS[p, m]
    plot = phc.frf_plot(result(p, m))
    assert plot.axes.shape == shape
    shown = [axis for axis in plot.axes.flat if axis.get_visible()]
    assert len(shown) == 2 * p * m
    width, height = plot.figure.get_size_inches()
    assert width <= 11 and height <= 16 and width / shape[1] >= 3
    assert not plot.figure.canvas.draw()
    if p * m > 1:
        titles = [axis.get_title(loc="left") for axis in shown if axis.get_title(loc="left")]
        assert titles == [f"u{j + 1} to y{i + 1}" for i in range(p) for j in range(m)]


@pytest.mark.slow
def test_of_many_channels_the_first_are_drawn_and_the_title_says_so():
    fit = result(28, 4)
    plot = phc.frf_plot(fit)
    assert plot.axes.shape == (18, 3)
    assert "outputs 1 to 9 of 28, inputs 1 to 3 of 4" in plot.figure.get_suptitle()
    some = phc.frf_plot(fit, outputs=["y28", 2], inputs=[3])
    expected = exact(fit, 2 * np.pi * some.lines[0, 0][0].get_xdata())[27, 3]
    np.testing.assert_allclose(some.lines[0, 0][0].get_ydata(), 20 * np.log10(np.abs(expected)), rtol=1e-9)
    assert "2 of 28 outputs, 1 of 4 inputs" in some.figure.get_suptitle()


def test_systems_modal_forms_and_fits_have_the_same_picture():
    fit = result(2, 1)
    participation = (fit.residues[:, 0, :] / fit.shapes[:, :1]).reshape(3, 1)
    form = phc.modes(fit.poles, fit.shapes, participation)
    plots = [phc.frf_plot(one, omega_limits=[10, 90], time_unit="s") for one in (fit, form, form.state_space())]
    for plot in plots[1:]:
        for row in (0, 1):
            x, y = plot.lines[row, 1][0].get_data()
            x0, y0 = plots[0].lines[row, 1][0].get_data()
            off = np.abs(np.interp(x0, x, y) - y0)
            assert np.nanquantile(off, 0.98) < 1e-6  # grids differ where a phase turns


def test_a_fit_is_drawn_with_its_own_data_and_units_of_time_reach_the_axis():
    rng, plant = np.random.default_rng(0), phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5]))
    u = rng.standard_normal(400)
    y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    fit = phc.pem((u, y + 0.01 * rng.standard_normal(400)), 2, dt=0.1)
    plot = phc.frf_plot(fit, Hz=False, segments=2)
    assert [line.get_label() for line in plot.lines[0, 0]][:2] == ["fit (2 modes)", "measured (spectral estimate)"]
    assert plot.axes[1, 0].get_xlabel() == "Frequency [rad/time]"
    gain = plot.lines[0, 0][0]
    assert np.isfinite(plot.axes[0, 0].get_ylim()).all() and plot.axes[0, 0].get_ylim()[1] < 60
    np.testing.assert_allclose(10 ** (gain.get_ydata() / 20), np.abs(fit.system(1j * gain.get_xdata())), rtol=1e-6)


@pytest.mark.parametrize("intersample", ["zoh", "bandlimited"])
def test_a_step_shows_no_frequency_response(intersample):
    rng, plant = np.random.default_rng(0), phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5]))
    step = phc.step_response(plant, 0.1 * np.arange(400))
    fit = phc.pem((np.ones(400), step.outputs + 0.01 * rng.standard_normal(400)), 2, dt=0.1, initial_state="zero",
                  structure="lossless")  # fmt: skip
    labels = [line.get_label() for line in phc.frf_plot(fit, intersample=intersample).lines[0, 0]]
    assert labels == ["fit (2 modes)"]
    for picture in (phc.frf_plot, phc.circle_plot):
        with pytest.raises(StructureError, match="or their inputs are constant"):
            picture(result(1), step, intersample=intersample)


@pytest.mark.parametrize("samples", [990, 999])  # of which the mean rounds in one segment
def test_a_constant_input_beside_others_hides_none_of_them(samples):
    u = np.stack([np.random.default_rng(0).standard_normal(samples), np.full(samples, 0.1)])
    data = ct.TimeResponseData(2e-3 * np.arange(samples), u[:1], inputs=u)
    plot = phc.frf_plot(result(1, 2), data, intersample="bandlimited", Hz=False)
    gains = [[line.get_ydata() for line in column if "measured" in str(line.get_label())] for column in plot.lines[0]]
    assert len(gains[0]) == 1 and len(gains[0][0]) > 30 and np.abs(gains[0][0]).max() < 1e-9 and not gains[1]


@pytest.mark.slow
def test_recordings_are_estimated_together_also_of_roving_hammers_and_sensors():
    fit, h = result(2, 2), 2e-3
    T, rng = 6000, np.random.default_rng(1)
    form = [
        phc.modes(fit.poles, fit.shapes, fit.residues[:, 0, j, None] / fit.shapes[:, :1]).state_space() for j in (0, 1)
    ]
    plants = [ct.sample_system(one, h, "zoh") for one in form]

    def recorded(u):
        y = sum(ct.forced_response(plant, h * np.arange(T), one).outputs for plant, one in zip(plants, u, strict=True))
        return ct.TimeResponseData(h * np.arange(T), y, inputs=u)

    noise = recorded(rng.standard_normal((2, T)))
    hits = [recorded(np.outer([k == 0, k == 1], np.arange(T) == 5).astype(float)) for k in (0, 1)]
    hits[1].y[1] = np.nan
    for data, within in ((noise, 0.35), (hits, 0.02)):
        plot = phc.frf_plot(fit, data, omega_limits=[10, 95])
        dots = next(line for line in plot.lines[0, 0] if line.get_linestyle() == "None")
        expected = exact(fit, 2 * np.pi * dots.get_xdata())[0, 0]
        assert np.quantile(np.abs(10 ** (dots.get_ydata() / 20) / np.abs(expected) - 1), 0.9) < within
    assert [len(cell) for cell in plot.lines[::2].ravel()] == [2, 2, 2, 1]  # what was never measured has no dots


def test_hits_that_last_beyond_the_end_of_the_recording_are_beneath_the_fit():
    rng, plant = np.random.default_rng(0), ct.ss(ct.tf([1.0, 0.0, 0.0], [1.0, 0.01, 1.0]))
    u = np.where(np.arange(300) == 5, 1.0, 0.0)
    y = ct.forced_response(ct.sample_system(plant, 0.4), 0.4 * np.arange(300), u).outputs
    y = y + 1e-3 * np.abs(y).max() * rng.standard_normal(300)
    fit = phc.pem((u, y), 1, dt=0.4, quantity="acceleration", intersample="zoh", initial_state="zero", real_poles=0)
    curve, dots = phc.frf_plot(fit, Hz=False, omega_limits=[0.5, 2.0]).lines[0, 0]
    raw = phc.frf_plot(fit, ct.TimeResponseData(0.4 * np.arange(300), y, inputs=u, issiso=True), Hz=False).lines[0, 0]
    off, raw_off = (
        np.abs(line.get_ydata() - np.interp(line.get_xdata(), *curve.get_data())) for line in (dots, raw[1])
    )
    assert len(off) > 20 and off.max() < 1.0 and raw_off.max() > 3.0  # dB


def test_a_bode_plot_of_a_fit_to_a_response_is_as_wide_as_this():
    rng, omega = np.random.default_rng(0), np.geomspace(5.0, 200.0, 60)
    response = ct.tf([2500.0], [1.0, 3.0, 2500.0])(1j * omega) * (1 + 0.01 * rng.standard_normal(60))
    fit = phc.pem(ct.frd(response, omega), 1, quantity="free", real_poles=0)
    np.testing.assert_allclose(phc.bode_plot(fit).axes[0, 0].get_xlim(), [5.0 / 1.1, 200.0 * 1.1])
    # a system beside it asks for what it has beyond
    both = phc.bode_plot([fit, ct.tf([1.0], [1e-3, 1.0])])
    np.testing.assert_allclose(both.axes[0, 0].get_xlim(), [5.0 / 1.1, 2000.0])


def drawn_around(fit, spread):
    """Models as those that `sample` of a result draws: of residues larger and smaller by the same share."""
    factors = 1 + spread * np.linspace(-1, 1, 101)

    def scaled(omega, output, input):
        return factors[:, None] * exact(fit, omega)[output, input]

    return SimpleNamespace(
        residues=factors[:, None, None, None] * fit.residues,
        magnitude_band=lambda omega, level, output, input: np.quantile(
            np.abs(scaled(omega, output, input)), [0.5 - level / 2, 0.5 + level / 2], axis=0
        ),
        phase_band=lambda omega, level, output, input: (
            np.degrees(np.angle(exact(fit, omega)[output, input])) + np.array([[-10.0], [20.0]])
        ),
    )


def test_a_band_is_that_of_the_models_drawn_around_a_fit_and_its_phase_beside_the_curve():
    fit = result(2, 2)
    fit.sample = lambda k, rng: drawn_around(fit, 0.1)
    plot = phc.frf_plot(fit, confidence=True, level=0.8)
    for (i, j), (gain, angle) in {(0, 1): plot.axes[:2, 1], (1, 0): plot.axes[2:, 0]}.items():
        (band,), curve = gain.collections, plot.lines[2 * i, j][0]
        low = band.get_paths()[0].vertices[:, 1].min() - curve.get_ydata().min()
        assert abs(low - 20 * np.log10(1 - 0.8 * 0.1)) < 1e-6
        middle = plot.lines[2 * i + 1, j][0].get_ydata()
        assert len(angle.collections[0].get_paths())
        vertices = np.concatenate([path.vertices[:, 1] for path in angle.collections[0].get_paths()])
        assert np.nanmin(middle) - 10.01 <= vertices.min() and vertices.max() <= np.nanmax(middle) + 20.01
    assert "80 % band" in legend_texts(plot.legend)


def test_the_band_of_a_lossless_fit_is_that_of_what_was_measured():
    rng, plant = np.random.default_rng(0), ct.ss(ct.tf([1.0], [1, 0, 1.0]) + ct.tf([1.08], [1, 0, 7.29]))
    u = rng.standard_normal(300)
    y = ct.forced_response(ct.sample_system(plant, 0.1), 0.1 * np.arange(300), u).outputs
    fit = phc.pem((u, y + 0.01 * rng.standard_normal(300)), 2, dt=0.1, quantity="displacement")
    plot = phc.frf_plot(fit, confidence=True, segments=2, Hz=False, omega_limits=[0.3, 3.0])
    curve, (band,) = plot.lines[0, 0][0], plot.axes[0, 0].collections
    expected = 20 * np.log10(fit.sample(300, 0).magnitude_band([0.31], 0.95)[:, 0])
    vertices = np.concatenate([path.vertices for path in band.get_paths()])
    near = vertices[np.abs(vertices[:, 0] - 0.31) < 0.003]
    np.testing.assert_allclose([near[:, 1].min(), near[:, 1].max()], expected, atol=0.2)
    assert near[:, 1].min() <= np.interp(0.31, *curve.get_data()) <= near[:, 1].max()


def test_panels_have_short_names_and_names_tell_the_unit_of_a_response():
    fit = result(2, 1)
    fit.output_labels = ["acceleration of the first storey [m/s^2]", "tilt [rad]"]
    fit.input_labels = ["force of the hammer [N]"]
    plot = phc.frf_plot(fit)
    names = [plot.axes[0, column].get_title(loc="left") for column in (0, 1)]
    assert names == ["acceleration of the first storey", "force of the hammer to tilt"]
    assert plot.axes[0, 0].get_ylabel() == "Magnitude [dB re 1 m/s^2/N]"
    fit.input_labels = ["force"]
    assert phc.frf_plot(fit).axes[0, 0].get_ylabel() == "Magnitude [dB]"


def test_names_of_a_measurement_tell_the_unit_where_those_of_the_model_do_not():
    fit = result(2, 1)
    names = {"inputs": ["force [N]"], "outputs": ["top [m/s^2]", "base [m/s]"]}
    data = ct.FRD(measured(fit).frdata, measured(fit).omega, **names)
    assert phc.frf_plot(fit, data, outputs=[1]).axes[0, 0].get_ylabel() == "Magnitude [dB re 1 m/s/N]"
    assert phc.frf_plot(fit, [measured(fit), data], gain_unit="g").axes[0, 0].get_ylabel() == "Magnitude [dB re 1 g]"
    assert phc.frf_plot(fit, measured(fit)).axes[0, 0].get_ylabel() == "Magnitude [dB]"


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: phc.frf_plot(result(1), confidence=True), "confidence is True, but a SimpleNamespace"),
        (lambda: phc.frf_plot(3), "a int; pass what pem gives"),
        (lambda: phc.frf_plot(result(2), measured(result(3))), "3 outputs and 1 inputs, the model 2 and 1"),
        (lambda: phc.frf_plot(result(2), outputs=["z"]), "outputs has 'z'; there are 2: y1, y2"),
        (lambda: phc.frf_plot(result(2), inputs=[1]), "inputs has 1; there are 1"),
        (lambda: phc.frf_plot(result(2), outputs=[]), "outputs is empty"),
        (lambda: phc.frf_plot(result(2), data=[3]), "data hold a int"),
        (lambda: phc.frf_plot(result(2), omega_limits=[3, 1]), "omega_limits is"),
        (lambda: phc.frf_plot(result(2), gain_unit=["m"]), "1 labels for 2 outputs"),
        (lambda: phc.frf_plot(result(1), ax=plt.subplots(3)[1]), "ax has 3 axes; expected 2"),
        (lambda: phc.frf_plot(result(1), intersample="none"), "intersample is 'none'"),
        (lambda: phc.frf_plot(SimpleNamespace(poles=[1j], residues=np.ones((2, 1, 1)))), "residues have shape"),
        (lambda: phc.frf_plot(SimpleNamespace(poles=[1j], residues=np.ones((1, 2, 0)))), "no input, as that of a free"),
        (
            lambda: phc.frf_plot(result(1), ct.TimeResponseData([0.0, 1.0, 2.0], np.ones((1, 3)), issiso=True)),
            "free motions",
        ),
        (lambda: phc.circle_plot(phc.ph(phc.modes([1.0], [1.0]))), "no mode of the model oscillates with damping"),
        (lambda: phc.circle_plot(phc.ph(phc.modes([1.0], [1.0])), modes=[0]), "is a line, not a circle"),
        (lambda: phc.circle_plot(result(1), modes=[5]), "modes has 5; there are 3"),
    ],
)
def test_what_has_no_picture_of_responses_is_refused(call, words):
    with pytest.raises(StructureError, match=words):
        call()


@pytest.mark.variants
@pytest.mark.parametrize(
    "options, label, size",
    [
        ({}, "1/time", 1.0), ({"time_unit": "s"}, "Hz", 1.0), ({"time_unit": "ms"}, "Hz", 1e3),
        ({"time_unit": "T_0"}, "rad/T_0", 2 * np.pi), ({"Hz": True}, "Hz", 1.0), ({"Hz": False}, "rad/time", 2 * np.pi),
    ],
)  # fmt: skip
def test_a_unit_of_frequency_that_nobody_told_is_not_shown(options, label, size):
    fit = result(2)
    fit = phc.modes(fit.poles, fit.shapes, np.ones((3, 1)))
    for plot in (phc.frf_plot(fit, **options), phc.stabilisation_plot(path(), **options)):
        assert plot.axes[-1, 0].get_xlabel().endswith(f"requency [{label}]")
    assert phc.circle_plot(fit, **options).axes[0, 0].get_title(loc="left") == f"{20 * size:.4g} {label}, 1.00 %"
    if "Hz" not in options:
        assert phc.shape_plot(fit, **options).axes[0, 0].get_title(loc="left") == f"{20 * size:.4g} {label}, 1.00 %"
        assert phc.mac_plot(fit, **options).axes[0, 0].get_xlabel() == f"Mode [{label}]"


# --- circles ---------------------------------------------------------------------------------------------------------


def test_a_single_mode_draws_a_circle_of_its_diameter_through_its_points():
    p = -0.5 + 60j
    fit = SimpleNamespace(poles=[p], residues=np.array([[[2.0 - 1.0j]]]), feedthrough=np.zeros((1, 1)))
    omega = np.linspace(55, 65, 101)
    data = ct.frd(exact(fit, omega), omega)
    plot = phc.circle_plot(fit, data, Hz=False)
    curve, dots, cross = (line.get_xdata() + 1j * line.get_ydata() for line in plot.lines[0, 0])
    # but for its conjugate, far away
    rest = np.conj(fit.residues[0, 0, 0]) / (1j * 60 - np.conj(p))
    centre = rest + fit.residues[0, 0, 0] / abs(p.real) / 2
    radius = abs(fit.residues[0, 0, 0] / p.real) / 2
    for points in (curve, dots, cross):
        np.testing.assert_allclose(np.abs(points - centre), radius, rtol=2e-3)
    inside = np.abs(omega - 60) <= 4 * 0.5
    assert len(dots) == inside.sum()
    assert plot.axes[0, 0].get_title(loc="left") == "60 rad/time, 0.83 %"


def test_the_labels_of_a_circle_of_a_small_response_do_not_overlap():
    beam = phc.modes([-0.5 + 100j, -1 + 630j], [[0.1, 1.0], [0.5, 1.0]], [[0.01j], [-0.01j]])
    plot = phc.circle_plot(beam)
    plot.figure.canvas.draw()
    for axis in plot.axes.flat:
        ends = np.array([label.get_window_extent().intervalx for label in axis.get_xticklabels() if label.get_text()])
        assert len(ends) > 2 and np.all(ends[:-1, 1] < ends[1:, 0])


def test_each_mode_is_drawn_where_it_moves_most_or_where_it_is_asked_for():
    fit = result(3, 1)
    plot = phc.circle_plot(fit, measured(fit, count=2000))
    assert [axis.get_title(loc="left") for axis in plot.axes.flat] == [
        "20 Hz, 1.00 %",
        "45 Hz, 0.50 %",
        "80 Hz, 2.00 %",
    ]
    for l, axis in enumerate(plot.axes.flat):
        most = int(np.abs(fit.residues[l, :, 0]).argmax())
        assert axis.texts[0].get_text() == f"u1 to y{most + 1}"
    (axis,) = phc.circle_plot(fit, modes=[1], output="y1").axes.flat
    assert axis.texts[0].get_text() == "u1 to y1" and axis.get_title(loc="left") == "45 Hz, 0.50 %"


# --- mode shapes -----------------------------------------------------------------------------------------------------


def test_a_panel_shows_the_real_part_of_a_turned_shape_over_sorted_positions():
    fit = result(5)
    places = np.array([0.3, 0.1, 0.9, 0.5, 0.7])
    turned = SimpleNamespace(**{**vars(fit), "shapes": fit.shapes * np.exp(2.1j)})
    plot = phc.shape_plot(turned, places, position_unit="m", shape_unit="1/kg")
    assert [axis.get_title(loc="left") for axis in plot.axes.flat] == [
        "20 Hz, 1.00 %",
        "45 Hz, 0.50 %",
        "80 Hz, 2.00 %",
    ]
    assert {axis.get_title(loc="right") for axis in plot.axes.flat} == {"MPC 1.000"}
    assert plot.axes[0, 0].get_xlabel() == "Position [m]" and plot.axes[0, 0].get_ylabel() == "Mode shape [1/kg]"
    for psi, (line,) in zip(fit.shapes.real, plot.lines.flat, strict=True):
        expected = psi * np.sign(psi[np.abs(psi).argmax()])
        assert line.get_xdata().tolist() == sorted(places)
        np.testing.assert_allclose(line.get_ydata(), expected[np.argsort(places)], atol=20 * EPS)


def test_intervals_of_a_shape_are_those_of_the_part_that_is_drawn():
    fit = result(4)
    ends = {}
    for angle in (0.0, 0.5 * np.pi):
        turned = SimpleNamespace(**{**vars(fit), "shapes": fit.shapes * np.exp(1j * angle)})
        axis = phc.shape_plot(turned, level=0.95).axes[0, 0]
        (bars,) = [part for part in axis.collections if len(part.get_segments()) == 4]
        ends[angle] = np.array([np.ptp(segment[:, 1]) / 2 for segment in bars.get_segments()])
        assert axis.get_figure().legends[0].get_texts()[-1].get_text() == "95 % interval"
    np.testing.assert_allclose(ends[0.0], 1.959964 * 0.02, rtol=1e-6)
    np.testing.assert_allclose(ends[0.5 * np.pi], 1.959964 * 0.03, rtol=1e-6)


def test_a_complex_shape_shows_its_imaginary_part_and_its_collinearity():
    shape = np.array([[1.0, 0.8 + 0.3j, -0.5 + 0.2j, 0.1 - 0.4j]])
    (axis,) = phc.shape_plot(shape).axes.flat
    real, imaginary = (line.get_ydata() for line in axis.get_lines()[1:])
    np.testing.assert_allclose(np.abs(real + 1j * imaginary), np.abs(shape[0]), rtol=1e-12)
    found = float(axis.get_title(loc="right").split()[1])
    assert abs(found - np.abs(np.sum(shape**2)) ** 2 / np.sum(np.abs(shape) ** 2) ** 2) < 6e-4 and found < 0.9


def test_sensors_have_numbers_or_names():
    fit = result(4)
    labels = [text.get_text() for text in phc.shape_plot(fit).axes[0, 0].get_xticklabels()]
    assert labels == ["y1", "y2", "y3", "y4"]
    (axis,) = phc.shape_plot(np.ones((1, 30))).axes.flat
    assert axis.get_xlabel() == "Sensor" and axis.get_lines()[1].get_xdata().tolist() == list(range(1, 31))
    assert axis.get_title(loc="left") == "Mode 1"


@pytest.mark.parametrize("dimensions", [2, 3])
def test_marks_in_the_plane_have_the_size_and_sign_of_the_entries(dimensions):
    places = np.random.default_rng(0).uniform(size=(6, dimensions))
    shape = np.array([[1.0, -0.5, 0.25, -1.0, 0.5, 0.1]])
    (marks,) = phc.shape_plot(shape, places).lines.flat
    areas = [part.get_sizes() for part in marks]
    np.testing.assert_allclose(areas[0] / areas[0].max(), [1, 1 / 16, 1 / 4, 1 / 100])
    np.testing.assert_allclose(areas[1] / areas[0].max(), [1 / 4, 1])
    assert len(marks[0].get_facecolor()) and not len(marks[1].get_facecolor())
    if dimensions == 2:
        np.testing.assert_allclose(marks[1].get_offsets(), places[[1, 3]])


def test_modal_forms_have_shapes_and_many_modes_are_shared_out():
    fit = result(3)
    form = phc.modes(fit.poles, fit.shapes, np.ones((3, 1)))
    assert phc.shape_plot(form, modes=[2], time_unit="s").axes[0, 0].get_title(loc="left") == "80 Hz, 2.00 %"
    plot = phc.shape_plot(np.eye(20))
    assert plot.axes.shape == (4, 3) and plot.figure.get_suptitle() == "Mode shapes (12 of 20)"


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: phc.shape_plot("text"), "shapes are a str"),
        (lambda: phc.shape_plot([1.0, 2.0]), r"shapes have shape \(2,\); expected"),
        (lambda: phc.shape_plot([[1.0, np.nan]]), "shapes is not finite"),
        (lambda: phc.shape_plot(np.eye(3), [1.0, 2.0]), r"positions have shape \(2,\); those of 3 sensors"),
        (lambda: phc.shape_plot(np.eye(3), np.ones((3, 4))), "positions have shape"),
        (lambda: phc.shape_plot(np.eye(3), poles=[1j]), "1 poles for 3 shapes"),
        (lambda: phc.shape_plot(np.eye(3), modes=[3]), "modes has 3; there are 3"),
        (lambda: phc.shape_plot(np.eye(3), level=2), "level is 2"),
        (lambda: phc.shape_plot(np.eye(3), ax=plt.subplots()[1]), "ax has 1 axes; expected 3"),
        (lambda: phc.shape_plot(np.eye(3), np.eye(3), lines=[(0, 1)]), "say with directions"),
        (
            lambda: phc.shape_plot(np.eye(3), np.eye(3), directions="x", lines=[(0, 3)]),
            "give pairs of nodes, from 0 to 2",
        ),
        (lambda: phc.shape_plot(np.eye(3), np.eye(3), directions=["x", "y"]), "2 directions for 3 sensors"),
        (lambda: phc.shape_plot(np.eye(3), np.eye(3), directions="w"), "directions is 'w'"),
        (lambda: phc.shape_plot(np.eye(3), np.eye(3), directions=[(0, 0, 0)] * 3), "give 3 numbers, not all 0"),
        (
            lambda: phc.shape_plot(np.eye(3), np.eye(3), directions="x", nodes=np.eye(3)[:2]),
            "sensor 2, .* is at no node",
        ),
        (lambda: phc.shape_plot(np.eye(3), [1, 2, 3], lines=[(0, 1)]), "in a plane or in space"),
        (lambda: phc.mac_plot(np.eye(3), np.eye(2)), "shapes of 3 and of 2 outputs"),
        (lambda: phc.mac_plot(np.eye(3), label=["one"]), "1 labels for 2 sets of shapes"),
    ],
)
def test_what_has_no_picture_of_shapes_is_refused(call, words):
    with pytest.raises(StructureError, match=words):
        call()


def test_a_wire_frame_moves_each_node_as_its_sensors_say():
    nodes = np.array([[0.0, 0], [0, 3], [2, 3], [2, 0]])
    plot = phc.shape_plot(
        [[0.5, 1.0, 0.25]],
        nodes[[1, 2, 2]],
        directions=["x", "-x", (0, 2.0)],
        nodes=nodes,
        lines=[(0, 1), (1, 2), (2, 3)],
    )
    rest, shape = (np.transpose(line.get_data()) for line in plot.lines[0, 0])
    moved = 3 / 7 / np.hypot(1.0, 0.25) * np.array([[0, 0], [0.5, 0], [-1, 0.25], [0, 0]])
    at = [0, 1, 4, 7]  # of both ends of each line and a gap
    np.testing.assert_allclose(rest[at], nodes)
    np.testing.assert_allclose(shape[at] - rest[at], moved, atol=1e-12)
    assert np.isnan(shape[2::3]).all() and legend_texts(plot.legend) == ["at rest", "mode shape"]


def test_sensors_of_a_plate_move_across_it():
    places = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]
    rest, shape = phc.shape_plot([[0.0, 1.0, -0.5]], places, lines=[(0, 1), (1, 2)]).lines[0, 0]
    assert np.nanmax(np.abs(shape.get_xdata() - rest.get_xdata())) < 1e-12
    up = np.cos(np.radians(25.0)) / 7
    np.testing.assert_allclose(shape.get_ydata() - rest.get_ydata(), [0, up, np.nan, up, -up / 2, np.nan], atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_frequencies_on_a_nyquist_curve_stand_outside_of_it(sign):
    plot = phc.nyquist_plot(0.01 + sign * ct.tf([0.02], [0.1, 1.0]), Hz=False, omega_limits=[0.5, 200.0])
    rings = [text for text in plot.axes[0, 0].texts if text.get_text()]
    assert [text.get_text() for text in rings] == ["1 rad/time", "10 rad/time", "100 rad/time"]
    from_centre = np.array([text.xy for text in rings]) - [0.01 + sign * 0.01, 0.0]
    away = np.array([text.xyann for text in rings])
    cosines = np.sum(from_centre * away, axis=1) / np.linalg.norm(from_centre, axis=1) / np.linalg.norm(away, axis=1)
    assert np.all(cosines > 0.95)


def test_nyquist_curves_have_the_sign_of_electrochemists_for_impedances_only():
    omega = np.geomspace(0.01, 1e4, 80)
    cell = 0.01 + 0.02 / (1 + 0.5j * omega)
    table = ct.frd(cell, omega, outputs="v [V]", inputs="i [A]")
    plot = phc.nyquist_plot(table, Hz=False)
    (dots,) = plot.lines[0, 0]
    np.testing.assert_allclose(dots.get_xdata() + 1j * dots.get_ydata(), cell.conj())
    assert plot.axes[0, 0].get_ylabel() == "−Im [V/A]"
    for volts, amperes in (("V", "mA"), ("mV", "A"), ("µV", "nA"), ("kV", "kA")):
        scaled = ct.frd(cell, omega, outputs=f"v [{volts}]", inputs=f"i [{amperes}]")
        assert phc.nyquist_plot(scaled, Hz=False).axes[0, 0].get_ylabel() == f"−Im [{volts}/{amperes}]"
    admittance = ct.frd(1 / cell, omega, outputs="i [mA]", inputs="v [mV]")
    assert phc.nyquist_plot(admittance, Hz=False).axes[0, 0].get_ylabel() == "Im [mA/mV]"
    model = ct.tf([0.005, 0.03], [0.5, 1.0])
    for options, sign in (({"gain_unit": "Ω"}, -1), ({}, 1), ({"gain_unit": "Ω", "negative_imaginary": False}, 1)):
        curve = phc.nyquist_plot(model, **options).lines[0, 0][0].get_ydata()
        assert (sign * np.nanmean(curve) < 0) and abs(np.nanmax(np.abs(curve)) - 0.01) < 1e-4
    parts = phc.frf_plot(model, parts="real-imaginary", gain_unit="mohm")
    assert [axis.get_ylabel() for axis in parts.axes[:, 0]] == ["Re [mohm]", "−Im [mohm]"]
    assert parts.lines[1, 0][0].get_ydata().min() > 0.0


# --- modal assurance -------------------------------------------------------------------------------------------------


def test_the_matrix_of_modal_assurance_has_its_numbers_in_the_cells():
    one = result(4)
    other = SimpleNamespace(shapes=one.shapes[:2] + 0.2, natural_frequencies=one.natural_frequencies[:2])
    plot = phc.mac_plot(one, other, label=["test", "model"], time_unit="s")
    axis, image = plot.axes[0, 0], plot.lines[0, 0][0]
    c, b = one.shapes, other.shapes
    expected = np.abs(c.conj() @ b.T) ** 2 / np.outer(np.sum(np.abs(c) ** 2, 1), np.sum(np.abs(b) ** 2, 1))
    np.testing.assert_allclose(image.get_array(), expected, rtol=1e-12)
    assert [text.get_text() for text in axis.texts] == [f"{value:.2f}" for value in expected.ravel()]
    assert axis.get_xlabel() == "Mode of model [Hz]" and axis.get_ylabel() == "Mode of test [Hz]"
    assert [text.get_text() for text in axis.get_yticklabels()] == ["20", "45", "80"]


def test_of_many_modes_the_cells_are_empty():
    axis = phc.mac_plot(np.eye(30)).axes[0, 0]
    assert not axis.texts and len(axis.get_xticks()) <= 24 and axis.get_xlabel() == "Mode"


# --- poles of several orders -----------------------------------------------------------------------------------------


def path(orders=8, sensors=4, seed=0):
    """Poles and shapes of models of ascending order: three true modes first, then any others."""
    fit, rng, rows = result(sensors), np.random.default_rng(seed), []
    for n in range(1, orders + 1):
        k = min(n, 3)
        d = 2 * np.pi * rng.uniform(5, 100, n - k)
        strays = d * (-rng.uniform(0.05, 0.3, n - k) + 1j)
        noise = 1e-4 * rng.standard_normal(k)
        poles = np.concatenate([fit.poles[:k] * (1 + noise), strays])
        rows.append((poles, np.concatenate([fit.shapes[:k], rng.standard_normal((n - k, sensors))])))
    return rows


def test_true_modes_are_stable_from_the_second_order_that_has_them():
    plot = phc.stabilisation_plot(path(), time_unit="s")
    new, _, _, shape = plot.lines[0, 0]
    for l, hertz in enumerate(HERTZ):
        x, order = shape.get_data()
        assert set(order[np.abs(x / hertz - 1) < 1e-3]) >= set(range(l + 2, 9))
        assert l + 1 in new.get_ydata()[np.abs(new.get_xdata() / hertz - 1) < 1e-3]
    assert sum(len(line.get_xdata()) for line in plot.lines[0, 0]) == sum(range(1, 9))
    assert plot.axes[0, 0].get_xlabel() == "Natural frequency [Hz]"
    wanted = ["new", "stable frequency (1 %)", "and damping (5 %)", "and shape (MAC 0.95)"]
    assert [line.get_label() for line in plot.lines[0, 0]] == wanted
    assert len({line.get_marker() for line in plot.lines[0, 0]}) == 4  # told apart in grey


def test_the_diagram_is_as_wide_as_the_stable_modes_and_no_wider_than_what_was_measured():
    data = measured(result(4), low=1.0, high=400.0)
    low, high = phc.stabilisation_plot(path(), data, time_unit="s").axes[0, 0].get_xlim()
    assert 1.0 <= low < 20.0 and 80.0 < high < 150.0
    chosen = phc.stabilisation_plot(path(), data, chosen=3, time_unit="s").axes[0, 0].get_xlim()
    assert 1.0 <= chosen[0] < 0.75 * 20.0 and 80.0 / 0.75 < chosen[1] < 150.0
    assert phc.stabilisation_plot(path(), data, omega_limits=[0, 300], time_unit="s").axes[0, 0].get_xlim() == (0, 300)
    far = [np.array([-0.01 + 1j]), np.array([-0.01 + 1j, -5 + 900j]), np.array([-0.01 + 1j, -5 + 900j])]
    assert phc.stabilisation_plot(far).axes[0, 0].get_xscale() == "log"
    assert phc.stabilisation_plot(far, scale="linear").axes[0, 0].get_xscale() == "linear"


def test_tolerances_decide_and_stand_in_the_legend():
    rows = [(np.array([-1 + 100j]), np.array([[1.0, 1.0]])), (np.array([-1.1 + 102j]), np.array([[1.0, 0.9]]))]
    for options, counts in (
        ({}, [2, 0, 0, 0]),
        ({"frequency_tolerance": 0.03}, [1, 1, 0, 0]),
        ({"frequency_tolerance": 0.03, "damping_tolerance": 0.1}, [1, 0, 0, 1]),
        ({"frequency_tolerance": 0.03, "damping_tolerance": 0.1, "least_mac": 0.999}, [1, 0, 1, 0]),
    ):
        plot = phc.stabilisation_plot(rows, orders=[3, 4], **options)
        assert [len(line.get_xdata()) for line in plot.lines[0, 0]] == counts
        assert f"({100 * options.get('frequency_tolerance', 0.01):g} %)" in plot.lines[0, 0][1].get_label()


def test_results_bring_their_orders_and_data_and_responses_stand_behind():
    fit = result(4)
    data = measured(fit)
    made = SimpleNamespace(
        stabilisation=lambda: path(), order=3, time_unit="s", experiments=[SimpleNamespace(record=data)]
    )
    plot = phc.stabilisation_plot(made)
    (twin,) = [axis for axis in plot.figure.axes if axis is not plot.axes[0, 0]]
    (curve,) = twin.lines
    expected = np.abs(data.frdata[:, 0])
    expected = np.sum(expected / np.sqrt(np.mean(expected**2, axis=1, keepdims=True)), axis=0)
    np.testing.assert_allclose(10 ** (curve.get_ydata() / 20), expected, rtol=1e-9)
    assert twin.get_ylabel() == "Sum of |FRF| [dB]" and twin.get_zorder() < plot.axes[0, 0].get_zorder()
    assert "order 3" in legend_texts(plot.legend)


def test_spectra_of_recordings_have_their_peaks_at_the_modes():
    t = 2e-3 * np.arange(20_000)
    motion = np.stack([1e-6 * np.sin(2 * np.pi * 20 * t), np.sin(2 * np.pi * 45 * t)])
    plot = phc.stabilisation_plot(path(), ct.TimeResponseData(t, motion, inputs=t))
    (twin,) = [axis for axis in plot.figure.axes if axis is not plot.axes[0, 0]]
    frequency, level = twin.lines[0].get_data()
    highest = frequency[np.argsort(level)[-2:]]
    assert np.abs(np.sort(highest) - [20, 45]).max() < 0.3 and twin.get_ylabel() == "Output spectra [dB]"


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: phc.stabilisation_plot(3), "poles is a int"),
        (lambda: phc.stabilisation_plot([]), "there are no orders"),
        (lambda: phc.stabilisation_plot([[-1 - 2j]]), "lower half-plane"),
        (lambda: phc.stabilisation_plot([[1j], [np.nan]]), "not numbers"),
        (lambda: phc.stabilisation_plot([([1j], [[1.0], [2.0]])]), r"shapes of order 0, counted from 0, has shape"),
        (lambda: phc.stabilisation_plot([([1j], [[1.0, 2.0]]), [1j]]), "differ in the outputs of their shapes"),
        (lambda: phc.stabilisation_plot(path(), orders=[1]), "1 orders for the poles of 8"),
        (lambda: phc.stabilisation_plot(path(), least_mac=2), "least_mac is 2"),
        (lambda: phc.stabilisation_plot(path(), frequency_tolerance=np.nan), "frequency_tolerance is nan"),
        (lambda: phc.stabilisation_plot(path(), chosen=0), "chosen is 0"),
        (lambda: phc.stabilisation_plot(path(), data=3), "data hold a int"),
        (lambda: phc.hypothesis_plot([]), "a list without tests"),
        (lambda: phc.hypothesis_plot([1]), "a list without tests"),
        (lambda: phc.hypothesis_plot([], level=2), "level is 2"),
    ],
)
def test_what_has_no_diagram_or_table_is_refused(call, words):
    with pytest.raises(StructureError, match=words):
        call()


# --- tests and residuals ---------------------------------------------------------------------------------------------


def test_the_table_says_which_hypotheses_the_data_reject():
    rows = [("lossless", 812.25, 20, 0.0), ("classical", 18.3, 16, 0.31), ("rank one", 33.1, 12, 0.00093)]
    names = ("hypothesis", "likelihood_ratio", "dof", "p")
    tests = [SimpleNamespace(**dict(zip(names, row, strict=True))) for row in rows]
    for given, level, said in ((tests, 0.05, 2), (SimpleNamespace(tests=tests), 0.5, 3)):
        table = phc.hypothesis_plot(given, level=level).lines[0, 0][0]
        texts = {place: cell.get_text().get_text() for place, cell in table.get_celld().items()}
        assert [texts[0, j] for j in range(4)] == ["hypothesis", "likelihood ratio", "dof", "p-value"]
        assert texts[0, 4] == f"at {100 * level:g} %"
        assert [texts[2, j] for j in range(4)] == ["classical", "18.3", "16", "0.31"]
        assert texts[1, 3] == "< 1e-300"
        assert sum(texts[i, 4] == "rejected" for i in (1, 2, 3)) == said


def test_residuals_of_a_fit_are_those_of_each_channel_with_the_band_of_white_noise():
    rng, plant = np.random.default_rng(0), phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5]))
    u = rng.standard_normal(2000)
    y = phc.forced_response(plant, 0.1 * np.arange(2000), u, intersample="zoh").outputs
    fit = phc.pem((u, y + 0.1 * rng.standard_normal(2000)), 2, dt=0.1)
    plot = phc.residual_plot(fit)
    inside, outside = plot.lines[0, 0]
    e = fit.residuals - np.mean(fit.residuals)
    expected = [np.mean(e[k:] * e[:-k]) / np.mean(e**2) for k in range(1, 26)]
    found = np.concatenate([line.get_ydata() for line in (inside, outside)])
    order = np.argsort(np.concatenate([line.get_xdata() for line in (inside, outside)]))
    np.testing.assert_allclose(found[order], expected, rtol=1e-9, atol=1e-12)
    assert len(outside.get_xdata()) <= 2
    assert plot.axes[0, 0].get_title(loc="left") == "y"


# --- results of fits -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted():
    """Two modes of three sensors and one force, fitted from a frequency response."""
    true = result(3, 1, 0)
    rng, omega = np.random.default_rng(0), 2 * np.pi * np.linspace(5, 100, 300)
    values = exact(true, omega)
    noise = 0.01 * np.abs(values).mean() * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    data = ct.frd(values + noise, omega, outputs=["a", "b", "c"], inputs=["force"])
    return phc.pem(data, 3, structure="free", quantity="displacement")


PICTURES_OF_A_FIT = {
    "responses": (lambda fit: phc.frf_plot(fit), (2, 3)), "circles": (lambda fit: phc.circle_plot(fit), (1, 3)),
    "shapes": (lambda fit: phc.shape_plot(fit), (1, 3)), "assurance": (lambda fit: phc.mac_plot(fit), (1, 1)),
    "residuals": (lambda fit: phc.residual_plot(fit), (1, 3)),
}  # fmt: skip


@pytest.mark.parametrize("kind", PICTURES_OF_A_FIT)
def test_a_fit_of_several_channels_draws_each_kind_of_picture(fitted, kind):
    function, shape = PICTURES_OF_A_FIT[kind]
    one, other = fitted.plot(kind=kind), function(fitted)
    assert one.axes.shape == other.axes.shape == shape
    for left, right in zip(one.axes.flat, other.axes.flat, strict=True):
        assert left.get_title(loc="left") == right.get_title(loc="left")
        for a, b in zip(left.lines, right.lines, strict=True):
            np.testing.assert_array_equal(a.get_xydata(), b.get_xydata())


def test_the_pictures_of_a_fit_show_its_data_names_and_errors(fitted):
    responses = fitted.plot(kind="responses", confidence=True)
    assert [axis.get_title(loc="left") for axis in responses.axes[0]] == [f"force to {name}" for name in "abc"]
    assert legend_texts(responses.legend) == ["fit (3 modes)", "95 % band", "measured"]
    shapes = fitted.plot(kind="shapes")
    for l, axis in enumerate(shapes.axes.flat):
        assert axis.get_title(loc="left").startswith(
            f"{fitted.hertz[l]:.4g} 1/time, {100 * fitted.damping_ratios[l]:.2f}"
        )
        assert [text.get_text() for text in axis.get_xticklabels()] == ["a", "b", "c"]
    assert "95 % interval" in legend_texts(shapes.legend)
    with pytest.raises(StructureError, match="kind is 'all'; it must be one of 'fit', 'responses'"):
        fitted.plot(kind="all")


@pytest.mark.variants
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_dots_of_an_accelerometer_lie_on_the_curve_up_to_the_nyquist_frequency(hold):
    """The feedthrough is held for no step, and the modes fold back."""
    rng, plant, T = np.random.default_rng(0), ct.ss(ct.tf([1, 0, 0], [1, 0.1, 1])), 6000
    t, u = 0.5 * np.arange(T), rng.standard_normal(T)
    y = ct.forced_response(ct.c2d(plant, 0.5) if hold == "zoh" else plant, t, u).outputs
    data = ct.TimeResponseData(t, y, inputs=u)
    for model, kind, limit in ((plant, hold, 0.1), (ct.c2d(plant, 0.5), "zoh", 0.1 if hold == "zoh" else np.inf)):
        plot = phc.frf_plot(model, data, intersample=kind, Hz=False, omega_limits=[0.1, 6.0])
        for row in (0, 1):
            dots = plot.lines[row, 0][1]
            at, values = dots.get_data()
            high = (at > 1.5) & (at < 5.8)
            unit = 20 / np.log(10) if row == 0 else np.degrees(1)
            expected = model(1j * at[high]) if model is plant else model(np.exp(0.5j * at[high]))
            expected = 20 * np.log10(np.abs(expected)) if row == 0 else np.degrees(np.angle(expected))
            off = np.mod(values[high] - expected + 180, 360) - 180
            assert high.sum() > 50 and np.abs(np.median(off)) < limit * unit and np.abs(off).mean() < limit * unit
    plt.close("all")


def test_shapes_of_one_sensor_are_those_over_the_inputs():
    one = result(p=1, m=9)
    one.participation = one.residues[:, 0] / one.shapes
    one.quantities, one.output_labels, one.input_labels = ("acceleration",), ["a"], [f"hit {k}" for k in range(9)]
    plot = phc.shape_plot(one)
    assert plot.axes[0, 0].get_xlabel() == "Input"
    assert [text.get_text() for text in plot.axes[0, 0].get_xticklabels()] == one.input_labels
    for l, lines in enumerate(plot.lines.flat):
        drawn, true = lines[0].get_ydata(), np.cos(l * np.arange(1, 10))
        np.testing.assert_allclose(drawn / np.abs(drawn).max(), np.sign(drawn @ true) * true / np.abs(true).max())
    assurance = phc.mac_plot(one).lines[0, 0][0].get_array()
    assert np.abs(assurance - np.eye(3)).max() < 0.2
    plt.close("all")


def test_sensors_of_a_shape_are_named_without_the_unit_of_their_signal():
    one = result(p=2)
    one.output_labels = ["top [m/s]", "low (m/s)"]
    labels = [text.get_text() for text in phc.shape_plot(one).axes[0, 0].get_xticklabels()]
    assert labels == ["top", "low"]
    plt.close("all")

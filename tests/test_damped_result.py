"""Results of fits: parameters with errors that hold, systems, predictions, files, pictures, of any channels."""

from __future__ import annotations

import copy
import pickle

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from modal_plants import Plant, data_of
from slow import slowly

import ph_control as phc

KINDS = ("time", "response", "decay")
PLANT = Plant.of(2, 3, 2, seed=1)


def fitted(kind, structure="free", *, samples=500, noise=0.1, seed=1, **options):
    options |= {} if kind == "response" else {"dt": 1.0}
    ports = [] if kind == "decay" else [(0, 0), ("y2", "u2") if kind == "time" else (1, 1)]
    return phc.pem(data_of(PLANT, kind, samples, seed, noise), structure=structure, ports=ports, **options)


@pytest.fixture(scope="module", params=KINDS)
def result(request):
    return fitted(request.param)


@pytest.fixture(scope="module")
def single():
    """One input and one output, found by itself to be damped."""
    u, y = data_of(PLANT, "time", 1000, 1, 0.05)
    return phc.pem((u[0], phc_output(u)[0] + y[0] - PLANT.velocities(u)[0]), dt=1.0)


def phc_output(u):
    return PLANT.velocities(np.stack([u[0], 0 * u[1]]))


# --- parameters ------------------------------------------------------------------------------------------------------


@pytest.mark.variants
def test_all_modes_are_found_and_lie_within_their_errors(result):
    truth = PLANT.truth
    assert result.order == 2 and isinstance(result, phc.PEMResult) and result.structure == "free"
    for name in ("natural_frequencies", "damping_ratios"):
        assert np.all(np.abs(getattr(result, name) - truth[name]) < 4.5 * result.stderr[name])
    assert np.allclose(result.mac(PLANT.shapes).diagonal(), 1, atol=0.01)
    assert result.outcome.name == "CONSISTENT" and result.whiteness > 1e-3


def parts(values):
    """Real and imaginary parts."""
    return np.stack([values.real, values.imag])


@pytest.mark.slow
@pytest.mark.parametrize("kind, structure", [("time", "free"), *slowly(("response", "classical"), ("decay", "free"))])
def test_errors_are_as_large_as_the_bound_and_intervals_cover(kind, structure):
    """Of 18 seeds: a mean of 36 squares of 1 has a standard deviation of 0.24, residues have many more."""
    options = {"order": 2, "samples": 300}
    # most of the time would go into the search for dead times and for noise that grows with the gain
    options |= {"weights": np.ones((3, 2, 150))} if kind == "response" else {"delay": 0.0, "intersample": "zoh"}
    quiet, truth = fitted(kind, structure, noise=1e-4, **options), dict(PLANT.truth)
    if kind == "decay":
        lead = np.abs(PLANT.shapes).argmax(axis=1)
        truth["shapes"] = PLANT.shapes / PLANT.shapes[np.arange(2), lead][:, None] + 0j
        truth.pop("residues")
    fits = [fitted(kind, structure, seed=seed, initial_guess=quiet, **options) for seed in range(1, 19)]
    for name, true in truth.items():
        bound = 1e3 * parts(quiet.stderr[name])
        shown = bound > 1e-6 * np.abs(true).max()  # some are fixed by the scale, or by the structure
        errors = np.array([(parts(getattr(fit, name)) - parts(true))[shown] / bound[shown] for fit in fits])
        ends = [np.moveaxis(parts(fit.confidence_interval()[name]), -1, 0) for fit in fits]
        cover = np.mean([((low <= parts(true)) & (parts(true) <= high))[shown] for low, high in ends])
        few = name in ("natural_frequencies", "damping_ratios")
        assert (0.5 if few else 0.7) < np.mean(errors**2) < (1.6 if few else 1.4), name
        assert cover > (0.86 if few else 0.9), name


@pytest.mark.slow
def test_a_driving_point_sets_the_scale_and_without_one_the_largest_is_1():
    scaled, unscaled = fitted("time"), phc.pem(data_of(PLANT, "time", 500, 1, 0.1), dt=1.0, structure="free")
    assert scaled.shapes_scaled and not unscaled.shapes_scaled
    assert np.allclose(scaled.shapes, PLANT.shapes, atol=0.05)
    assert np.allclose(np.abs(unscaled.shapes).max(axis=1), 1)
    assert np.allclose(scaled.mac(unscaled).diagonal(), 1)
    assert np.allclose(scaled.phase_collinearity, 1, atol=0.01)
    largest = np.abs(unscaled.shapes).argmax(axis=1)
    assert np.allclose(np.take_along_axis(unscaled.stderr["shapes"], largest[:, None], 1), 0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("quantity", ["displacement", "acceleration", ("velocity", "acceleration", "displacement")])
def test_shapes_are_the_same_whatever_the_outputs_are(quantity):
    power = {"displacement": -1, "velocity": 0, "acceleration": 1}
    each = [quantity] * 3 if isinstance(quantity, str) else quantity
    omega = np.linspace(0.2, 2.8, 300)
    response = PLANT.response(1j * omega) * ((1j * omega) ** np.array([[power[q]] for q in each]))[:, None]
    rng = np.random.default_rng(0)
    errors = rng.standard_normal(response.shape) + 1j * rng.standard_normal(response.shape)
    response = response + 0.02 * np.std(response, axis=2, keepdims=True) * errors
    found = phc.pem(ct.frd(response, omega), 2, structure="classical", ports=[(0, 0), (1, 1)], quantity=quantity)
    assert np.all(np.abs(found.shapes - PLANT.shapes) < 4.5 * np.abs(found.stderr["shapes"]))
    factor = found.shapes[:, :, None] * found.participation[:, None, :]
    same = [o for o in range(3) if each[o] == each[0]]
    assert np.allclose(factor[:, same], found.residues[:, same], rtol=1e-6)


def test_shapes_of_fits_to_different_quantities_compare():
    K, u = np.array([[3.0, -2.0], [-2.0, 3.0]]), np.random.default_rng(0).standard_normal(800)
    frame = phc.from_second_order(np.eye(2), K, [[1.0], [0.0]], C=0.02 * K, sensors={"acceleration": np.eye(2)})
    motion = phc.forced_response(frame, 0.1 * np.arange(800), u, intersample="zoh").outputs
    velocity, acceleration = motion[0], motion[1:]
    # the port of the plant is the velocity of the first mass
    known = {"dt": 0.1, "structure": "free", "intersample": "zoh", "noise": "white"}
    mixed = phc.pem((u, np.stack([velocity, acceleration[1]])), 2, quantity=("velocity", "acceleration"), **known)
    same = phc.pem((u, acceleration), 2, quantity="acceleration", **known)
    np.testing.assert_allclose(mixed.mac(same), np.eye(2), atol=1e-6)


@pytest.mark.variants
def test_draws_scatter_as_the_errors_say(result):
    if not result.input_labels:
        return
    draws = result.sample(4000, rng=0)
    assert np.allclose(draws.natural_frequencies.std(axis=0), result.stderr["natural_frequencies"], rtol=0.1)
    assert np.allclose(draws.damping_ratios.std(axis=0), result.stderr["damping_ratios"], rtol=0.1)
    assert np.allclose(draws.residues.real.std(axis=0), result.stderr["residues"].real, rtol=0.1)
    assert np.allclose(draws.shapes.real.std(axis=0), result.stderr["shapes"].real, rtol=0.1)
    low, high = draws.magnitude_band([0.4, 1.0], output=2, input=1)
    middle = np.abs(result.observed_system(1j * np.array([0.4, 1.0]))[2, 1])
    assert np.all((low < middle) & (middle < high))
    with pytest.raises(phc.StructureError, match="output is 3"):
        draws.step_band([0.0], output=3)


# --- models ----------------------------------------------------------------------------------------------------------


def test_the_observed_system_has_the_residues(result):
    if not result.input_labels:
        return
    s = 1j * np.array([0.3, 1.1]) + 0.1
    terms = result.residues[:, :, :, None] / (s - result.poles[:, None, None, None])
    mirrored = result.residues[:, :, :, None].conj() / (s - result.poles[:, None, None, None].conj())
    assert np.allclose(result.observed_system(s), (terms + mirrored).sum(axis=0) + result.feedthrough[:, :, None])
    assert tuple(result.observed_system.input_labels) == tuple(result.input_labels)


@pytest.mark.slow
def test_a_classical_model_with_ports_is_port_hamiltonian_with_sensors():
    found = fitted("time", "classical")
    assert isinstance(found.system, phc.PortHamiltonian) and found.system.sensors[0].shape == (1, 4)
    w = 1j * np.array([0.3, 1.1])
    assert np.allclose(found.system(w), found.observed_system(w), rtol=1e-8)
    assert not isinstance(fitted("time", "free").system, phc.PortHamiltonian)


def test_the_model_predicts_new_data_from_a_motion_fitted_to_them():
    found = fitted("time", noise=0.02)
    u = np.random.default_rng(5).standard_normal((2, 400))
    y = PLANT.velocities(u)
    start = (PLANT.shapes[:, :, None] * np.exp(np.outer(PLANT.poles, np.arange(400)))[:, None]).real.sum(axis=0)
    for moving, given in ((y + start, "estimate"), (y, "zero")):
        again = found.predict((u, moving), initial_state=given)
        assert np.linalg.norm(again.outputs - moving) < 0.03 * np.linalg.norm(moving)
    assert np.allclose(found.predict(u).outputs, found.predict((u, y), initial_state="fitted").outputs)
    assert list(again.output_labels) == list(found.output_labels)
    own = found.predict(data_of(PLANT, "time", 500, 1, 0.02)[0], initial_state="fitted")
    assert np.allclose(own.outputs, found.predicted, atol=1e-9)
    with pytest.raises(phc.StructureError, match="1 inputs and 3 outputs"):
        found.predict((u[0], y))
    with pytest.raises(phc.StructureError, match="initial_state"):
        found.predict(u, initial_state="estimate")


# --- one input and one output ----------------------------------------------------------------------------------------


def test_one_channel_is_answered_without_dimensions_for_it(single):
    assert isinstance(single, phc.PEMResult) and single.structure == "classical" and single.shapes_scaled
    assert single.predicted.shape == single.record.y.shape and single.shapes.shape == (2, 1)
    assert isinstance(single.system, phc.PortHamiltonian) and isinstance(single.experiments[0], phc.FittedExperiment)
    t, u = single.record.time, single.record.u
    motion = single.experiments[0].initial_state
    again = ct.forced_response(ct.c2d(single.observed_system, 1.0), t, u, motion).outputs + single.offsets[0]
    assert np.allclose(again, single.predicted, atol=1e-6 * np.abs(again).max())


def test_it_is_compared_and_drawn_as_other_models_are(single):
    comparison = phc.compare(single.record, single, single.observed_system)
    assert np.allclose(comparison.fit_percent, single.fit_percent, atol=0.05)
    new = np.random.default_rng(8).standard_normal((2, 400)) * np.array([[1.0], [0.0]])
    fit = phc.compare((new[0], PLANT.velocities(new)[0]), single, dt=1.0).fit_percent[0]
    assert fit > 90
    assert phc.residual_analysis(single.record, single).verdict
    for picture in (
        single.plot(),
        phc.bode_plot(single, confidence=True),
        phc.modes_plot(single),
        phc.fit_plot(single),
    ):
        assert picture.figure is not None
    plt.close("all")


@pytest.mark.parametrize(
    "use",
    [phc.ph, phc.modes, phc.passivity, phc.margin, phc.tf, lambda fit: phc.reduce(fit, 2), phc.step_response,
     lambda fit: phc.couple(fit, fit), lambda fit: phc.damping_injection(fit, 1.0)],
)  # fmt: skip
def test_what_takes_systems_tells_where_that_of_a_fit_is(single, use):
    with pytest.raises(phc.StructureError, match="PEMResult, whose model is its attribute `system`"):
        use(single)


# --- files and text --------------------------------------------------------------------------------------------------


@pytest.mark.variants
def test_it_comes_back_from_files_and_copies(result, single, tmp_path):
    for k, one in enumerate((result, single)):
        one.save(tmp_path / f"{k}.json")
        for other in (phc.load(tmp_path / f"{k}.json"), pickle.loads(pickle.dumps(one)), copy.deepcopy(one)):
            assert type(other) is phc.PEMResult and str(other) == str(one)
            for name, value in vars(one).items():
                if isinstance(value, np.ndarray):
                    assert np.array_equal(value, getattr(other, name), equal_nan=True)
                    assert not getattr(other, name).flags.writeable
            assert (other.tests, other.findings, other.ports) == (one.tests, one.findings, one.ports)
            for name in one.stderr:
                assert np.array_equal(other.stderr[name], one.stderr[name], equal_nan=True)
            assert np.array_equal(other.predicted, one.predicted, equal_nan=True)


def test_it_tells_hertz_and_percent_in_a_hundred_columns(result, single):
    for one in (result, single):
        assert all(len(line) <= 100 for line in one.summary().splitlines())
        assert "damping [%]" in one.summary() and one.verdict in one.summary()
        assert repr(one).startswith("<PEMResult: 2 modes") and "<table" in one._repr_html_()
    plt.close(result.plot().figure)


def test_recordings_that_have_other_inputs_keep_the_names_of_all():
    rng, recordings = np.random.default_rng(4), []
    for k in range(2):
        u = np.zeros((2, 400))
        u[k] = rng.standard_normal(400)
        y = PLANT.velocities(u)[0] + 0.05 * rng.standard_normal(400)
        recordings.append(ct.TimeResponseData(
            np.arange(400.0), y, inputs=u[k], issiso=True, input_labels=[f"hit {k + 1}"], output_labels=["v"]
        ))  # fmt: skip
    found = phc.pem(recordings, 2, structure="classical", ports={"v": "hit 2"}, noise="white", intersample="zoh")
    assert found.input_labels == ("hit 1", "hit 2") and found.residues.shape == (2, 1, 2)
    assert "hit 1" in found.summary() and "v:hit 2" in found.summary().replace("'", "")


def test_models_are_drawn_around_a_free_decay_which_has_no_residues():
    t = 0.1 * np.arange(300)
    y = np.exp(-0.05 * t) * np.cos(2.0 * t) + 0.01 * np.random.default_rng(0).standard_normal(300)
    fit = phc.pem((None, y), 1, dt=0.1, structure="free")
    draws = fit.sample(5, 0)
    assert draws.residues.shape == (5, 1, 1, 0) and draws.feedthrough.shape == (5, 1, 0)
    assert np.abs(draws.natural_frequencies / fit.natural_frequencies - 1).max() < 0.01


# --- ascending orders ------------------------------------------------------------------------------------------------


def test_true_modes_are_stable_in_all_orders_beyond_and_the_result_is_among_them(result):
    found = result.stabilisation(beyond=3)
    assert found.orders.tolist() == [1, 2, 3, 4, 5] and found.order == 2
    assert np.array_equal(found.poles[1], result.poles) and np.allclose(np.diag(result.mac(found.shapes[1])), 1)
    for poles, hertz, stable, level, assurance in zip(
        found.poles[2:], found.hertz[2:], found.stable[2:], found.stability[2:], found.mac[2:], strict=True
    ):
        true = np.abs(poles[:, None] - result.poles).argmin(axis=0)
        assert stable[true].all() and np.all(level[true] == 3) and np.all(assurance[true] > 0.95)
        assert np.allclose(hertz, np.abs(poles) / (2 * np.pi)) and len(poles) > np.sum(level > 0)
    table = found.table
    assert len(table) == 15 and np.array_equal(table.order, np.repeat(found.orders, found.orders))
    assert np.array_equal(table.hertz, np.concatenate(found.hertz)) and table.stable.sum() == sum(
        map(np.sum, found.stable)
    )


@pytest.mark.slow
@pytest.mark.variants
def test_tolerances_of_a_diagram_are_those_of_its_picture(result):
    found = result.stabilisation(beyond=1, frequency_tolerance=0.5, damping_tolerance=0.0)
    assert not any(level.max() > 1 for level in found.stability[1:]) and not any(map(np.any, found.stable))
    plot = found.plot()
    assert [line.get_label() for line in plot.lines[0, 0]][1] == "stable frequency (50 %)"
    drawn = sum(len(line.get_xdata()) for line in plot.lines[0, 0])
    assert drawn == sum(found.orders) and len(plot.figure.axes) == 2  # over what was measured
    again = phc.stabilisation_plot(result)
    assert max(line.get_ydata().max(initial=0) for line in again.lines[0, 0]) == result.order + 5
    plt.close("all")


def test_a_diagram_of_one_output_asks_for_no_shape_and_comes_of_files_as_well(single, tmp_path):
    found = single.stabilisation(beyond=1)
    assert max(map(np.max, found.stability)) == 2 and found.stable[-1].sum() >= single.order
    assert all(np.isnan(one).all() for one in found.mac) and "shape" not in str(found)
    single.save(tmp_path / "result.json")
    again = pickle.loads(pickle.dumps(phc.load(tmp_path / "result.json"))).stabilisation(beyond=1)
    assert all(np.array_equal(*pair) for pair in zip(found.poles, again.poles, strict=True))


@pytest.mark.variants
@pytest.mark.parametrize("options", [{"beyond": -1}, {"least_mac": 2}, {"frequency_tolerance": np.nan}])
def test_a_diagram_refuses_what_is_out_of_range(single, options):
    with pytest.raises(phc.StructureError, match=next(iter(options))):
        single.stabilisation(**options)


def test_lossless_modes_have_a_diagram_of_frequencies():
    rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    u = rng.standard_normal(400)
    y = phc.forced_response(plant, 0.5 * np.arange(400), u, intersample="zoh").outputs
    lossless = phc.pem((u, y + 0.1 * rng.standard_normal(400)), dt=0.5, structure="lossless")
    found = lossless.stabilisation(beyond=2)
    assert found.orders.tolist() == [1, 2, 3, 4] and np.array_equal(found.poles[1], 1j * lossless.d)
    assert all(np.abs(np.abs(poles)[:, None] - lossless.d).min(axis=0).max() < 0.01 for poles in found.poles[1:])
    assert found.stable[-1].sum() >= 2 and not np.any(found.damping_ratios[-1])


# --- bands -----------------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("structure", ["auto", "free"])
def test_bands_of_what_was_measured_lie_about_its_curve(structure):
    """A displacement: neither the velocity of the port nor a power of s more is drawn."""
    rng, plant = np.random.default_rng(0), ct.ss(ct.tf([1], [1, 0.1, 1]))
    u = rng.standard_normal(800)
    y = ct.forced_response(ct.c2d(plant, 0.5), 0.5 * np.arange(800), u).outputs
    y = y + 0.1 * np.std(y) * rng.standard_normal(800)
    found = phc.pem((u, y), 1, dt=0.5, quantity="displacement", structure=structure)
    picture = phc.bode_plot(found, confidence=True)
    for row, true in ((0, lambda g: 20 * np.log10(np.abs(g))), (1, lambda g: np.degrees(np.angle(g)))):
        axis = picture.axes[row, 0]
        omega, drawn = picture.lines[row, 0][0].get_data()
        expected = true(found.observed_system(1j * omega))
        assert np.all(np.abs(np.mod(drawn - expected + 180, 360) - 180) < 1e-6)
        near = np.abs(omega - 0.5) < 0.02
        assert near.any() and np.all(np.abs(drawn[near] - true(plant(1j * omega[near]))) < (1 if row == 0 else 5))
        (band,) = [one for one in axis.collections if "95 %" in str(one.get_label())]
        ends = band.get_paths()[0].vertices
        near = ends[np.abs(ends[:, 0] - 0.5) < 0.02]
        assert len(near) and np.all(np.abs(near[:, 1] - np.interp(0.5, omega, drawn)) < (1 if row == 0 else 5))
    for draw, response in ((phc.step_plot, ct.step_response), (phc.impulse_plot, ct.impulse_response)):
        picture = draw(found, 20.0, confidence=True)
        time, drawn = picture.lines[0, 0][0].get_data()
        fine = np.linspace(0, 20, 401)
        assert np.allclose(np.interp(fine, time, drawn), response(plant, fine).outputs, atol=0.05)
        assert [one for one in picture.axes[0, 0].collections if "95 %" in str(one.get_label())]
    plt.close("all")


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("seed", [0, 3, 6])
def test_a_hammer_that_hits_after_few_samples_is_no_riddle(seed):
    """Six quiet samples do not tell the motion there was, which free residues would be told apart from."""
    frame = phc.spring_chain(
        [80.0, 60.0, 40.0], [4e5, 2.5e5], ground=[6e5, 0, 0], c=[60.0, 40.0], ground_c=[80.0, 0, 0], port=2
    )
    t = np.arange(2000) / 500
    force = np.where((t > 0.01) & (t < 0.02), 800 * np.sin(np.pi * (t - 0.01) / 0.01), 0.0)
    states = phc.forced_response(frame, t, force, intersample="foh").states
    acceleration = (frame.A @ states + frame.B * force)[-1] / 40.0
    noise = 0.01 * acceleration.std() * np.random.default_rng(seed).standard_normal(t.size)
    found = phc.pem((force, acceleration + noise), dt=1 / 500, quantity="acceleration", ports=[(0, 0)])
    assert found.order == 3 and found.structure in ("classical", "passive")
    for name, truth in (("natural_frequencies", frame.natural_frequencies), ("damping_ratios", frame.damping_ratios)):
        assert np.all(np.abs(getattr(found, name) - truth) < 4.5 * found.stderr[name])


def test_a_motion_before_the_input_is_estimated_where_it_shows():
    plant, t = phc.spring_chain([1.0, 1.0], 2.0, ground=[1.0, 0.0], c=0.02, ground_c=0.01), 0.2 * np.arange(800)
    force = np.where(np.arange(800) == 8, 5.0, 0.0)
    rng = np.random.default_rng(0)
    for start in ([0.2, 0.1, 0.0, 0.0], [5.0, 3.0, 0.0, 0.0]):  # less than what follows, and more
        y = phc.forced_response(plant, t, force, start, intersample="zoh").outputs + 0.01 * rng.standard_normal(800)
        found = phc.pem((force, y), dt=0.2, structure="free", noise="white", intersample="zoh")
        assert found.order == 2 and found.experiments[0].free_amplitudes.any()
        assert np.all(np.abs(found.damping_ratios - plant.damping_ratios) < 4.5 * found.stderr["damping_ratios"])


@pytest.mark.parametrize("electrodes", [5e-12, 0.0])
def test_the_summary_tells_of_a_background_that_the_system_does_not_contain(electrodes):
    rng, s = np.random.default_rng(0), 2j * np.pi * (1e7 + np.linspace(-3e3, 3e3, 101))
    crystal = 1 / (15 + 12.665e-3 * s + 1 / (20e-15 * s)) + electrodes * s
    data = ct.frd(crystal + 1e-7 * (rng.standard_normal(101) + 1j * rng.standard_normal(101)), s.imag)
    result = phc.pem(data, 1, ports=[(0, 0)])
    assert ("  background      " in result.summary()) is bool(electrodes)
    rest = (result.predicted - result.system(s)).ravel()
    assert np.allclose(rest, electrodes * s, atol=1e-7)

"""Models beside data of several channels: fits of each output and of all, initial states, labels, pictures."""

from __future__ import annotations

import json

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from modal_plants import Plant, data_of
from shell import run

import ph_control as phc

PLANT = Plant.of(2, 3, 2, seed=1)
FORM = phc.modes(PLANT.poles, PLANT.shapes, (PLANT.poles / (2j * PLANT.poles.imag))[:, None] * PLANT.shapes[:, :2])

SOME = np.array([1.0, 1.0, np.nan])


@pytest.fixture(scope="module")
def recording():
    return data_of(PLANT, "time", 600, 1, 0.1)


@pytest.fixture(scope="module")
def result(recording):
    u, y = recording
    return phc.pem((u[:, :400], y[:, :400]), 2, dt=1.0, structure="free")


def percents(y, model):
    """Fit of each output, and the joint one."""
    shares = np.sum(np.abs(y - model) ** 2, axis=-1) / np.sum(np.abs(y - y.mean(axis=-1, keepdims=True)) ** 2, axis=-1)
    return 100 * (1 - np.sqrt(shares)), 100 * (1 - np.sqrt(shares.mean()))


def test_on_its_own_record_a_result_keeps_the_fit_of_the_fit(recording, result):
    u, y = recording
    found = phc.compare((u[:, :400], y[:, :400]), result, dt=1.0)
    each, joint = percents(y[:, :400], result.predicted)
    np.testing.assert_allclose(found.output_fit_percent[0], each, rtol=1e-12)
    assert np.isclose(found.fit_percent[0], joint, rtol=1e-12) and np.isclose(joint, result.fit_percent, rtol=1e-9)
    assert found.own_record == (True,) and "fitted to this record" in str(found)
    np.testing.assert_allclose(found.rms_error[0], np.sqrt(np.mean((y[:, :400] - result.predicted) ** 2, axis=1)))


@pytest.mark.parametrize("kind", ["form", "continuous", "sampled"])
def test_a_system_moves_from_the_state_that_fits_all_outputs(recording, kind):
    """Against dense least squares over the state, each output by its own size."""
    u, y = recording[0][:, 100:220], np.array(recording[1][:, 100:220])
    y[1] *= 1e3  # another unit
    form = phc.modes(PLANT.poles, PLANT.shapes * [1, 1e3, 1], FORM.participation)
    sampled = ct.c2d(form.state_space(), 1.0)
    model = {"form": form, "continuous": form.state_space(), "sampled": sampled}[kind]
    y[0, 7:11] = np.nan
    found = phc.compare((u, y), model, dt=1.0)
    F, C = np.asarray(sampled.A), np.asarray(sampled.C)
    t = np.arange(120.0)
    forced = ct.forced_response(sampled, t, u, squeeze=False).outputs
    free = np.stack([C @ np.linalg.matrix_power(F, k) for k in range(120)], axis=1)
    weight = 1 / np.nanstd(y, axis=1)
    seen = ~np.isnan(y)
    rows = (free * weight[:, None, None])[seen]
    state = np.linalg.lstsq(rows, ((y - forced) * weight[:, None])[seen], rcond=None)[0]
    np.testing.assert_allclose(found.predicted[0], forced + free @ state, rtol=1e-7, atol=1e-7 * np.nanmax(np.abs(y)))
    assert found.fit_percent[0] > 85
    rested = phc.compare((u, y), model, dt=1.0, initial_state="zero")
    np.testing.assert_allclose(rested.predicted[0], forced, rtol=1e-7, atol=1e-7 * np.nanmax(np.abs(y)))
    assert rested.fit_percent[0] < found.fit_percent[0]


def test_a_system_beside_a_fit_meets_the_samples_as_the_fit_does():
    rng = np.random.default_rng(3)
    plant = phc.ph(phc.modes([1.0, 2.5], [1.0, 0.3], damping=[0.01, 0.02]))
    u = rng.standard_normal(600)
    y = phc.forced_response(plant, 0.4 * np.arange(600), u, intersample="foh").outputs
    y = y + 0.02 * np.std(y) * rng.standard_normal(600)
    fit = phc.pem((u[:300], y[:300]), dt=0.4)
    assert fit.intersample == "foh"
    beside, alone = phc.compare((u[300:], y[300:]), plant, fit, dt=0.4), phc.compare((u[300:], y[300:]), plant, dt=0.4)
    assert beside.fit_percent.min() > 97
    assert alone.fit_percent[0] < 95


def test_new_data_several_experiments_and_free_motions(recording, result):
    u, y = recording
    new = u[:, 400:], y[:, 400:]
    found = phc.compare([(u[:, :400], y[:, :400]), new], result, FORM, dt=1.0, labels=["fit", "truth"])
    np.testing.assert_allclose(found.experiments[1].predicted[0], result.predict(new).outputs, rtol=1e-9)
    assert np.abs(np.diff(found.fit_percent)) < 1 and found.own_record == (True, False)
    assert found.output_fit_percent.shape == (2, 3) and found.measured.shape == (3, 600) == found.predicted.shape[1:]
    lines = str(found).splitlines()
    assert lines[0].startswith("Fit to 3 outputs: 2 experiments, 600 samples") and "fit" in lines[5]
    assert "fitted to 1 of these experiments" in lines[2] and max(map(len, lines)) <= 100
    _, decay = data_of(PLANT, "decay", 300, 2, 0.05)
    free = phc.compare((None, decay), result, FORM, dt=1.0, initial_state="zero")
    assert free.fit_percent.min() > 90  # nothing moves from rest without an input


def test_channels_in_another_order_are_matched_by_their_labels(recording, result):
    u, y = recording
    t = np.arange(200.0)
    named = result.observed_system
    for outputs, inputs in (([2, 0, 1], [1, 0]), ([0, 1, 2], [0, 1])):
        data = ct.TimeResponseData(
            t, y[outputs, 400:], inputs=u[inputs, 400:], output_labels=[f"y{k + 1}" for k in outputs],
            input_labels=[f"u{k + 1}" for k in inputs],
        )  # fmt: skip
        found = phc.compare(data, result, named)
        assert found.output_labels == tuple(f"y{k + 1}" for k in outputs) and found.fit_percent.min() > 85


def test_frequency_responses_are_matrices_with_a_fit_for_each_output():
    data = data_of(PLANT, "response", 200, 1, 0.05)
    result = phc.pem(data, 2, structure="free")
    found = phc.compare(data, result, FORM, FORM.state_space())
    model = PLANT.response(1j * data.omega)
    left = np.sum(np.abs(data.frdata - model) ** 2, axis=2)
    whole = np.sum(np.abs(data.frdata - data.frdata.mean(axis=2, keepdims=True)) ** 2, axis=2)
    shares = left / whole
    np.testing.assert_allclose(found.fit_percent[1:], 100 * (1 - np.sqrt(shares.mean())))
    np.testing.assert_allclose(found.output_fit_percent[1], 100 * (1 - np.sqrt(shares.mean(axis=1))))
    assert np.isclose(found.fit_percent[0], result.fit_percent) and found.own_record == (True, False, False)
    plot = found.plot(time_unit="s", Hz=True)
    assert [axis.get_title(loc="left") for axis in plot.axes.flat[:2]] == ["u[0] to y[0]", "u[1] to y[0]"]
    assert len(plot.lines.flat[0]) == 4 and plot.axes.flat[-1].get_xlabel() == "Frequency [Hz]"
    plt.close(plot.figure)


def test_the_picture_has_a_panel_for_each_output(recording, result):
    u, y = recording
    found = phc.compare((u, y), result, FORM, dt=1.0, labels=["fit", "truth"])
    whole = found.plot(detail=None, time_unit="s")
    part = phc.compare_plot(found, detail=[100, 150])
    for plot, count in ((whole, 600), (part, 51)):
        shown = [axis for axis in plot.axes.flat if axis.get_visible()]
        assert [axis.get_title(loc="left") for axis in shown] == ["y1", "y2", "y3"]
        assert [text.get_text() for text in plot.legend.get_texts()] == ["measured", "fit", "truth"]
        assert len(plot.lines.flat[1][0].get_ydata()) == count
    assert whole.axes.flat[0].get_xlabel() == "Time [s]" and found.plot() is not None
    plt.close("all")


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda u, y, fit: phc.compare((u, y), phc.modes(1.0, 1.0), dt=1.0), "1 inputs and 1 outputs, the record 2 in"),
        (lambda u, y, fit: phc.compare((u[0], y[0]), fit, dt=1.0), "2 inputs and 3 outputs, the record one of each"),
        (lambda u, y, fit: phc.compare((u, y[:2]), fit, dt=1.0), "the record 2 inputs and 2 outputs"),
        (lambda u, y, fit: phc.compare((u, y), FORM, dt=1.0, initial_state="fitted"), "which keeps none"),
        (lambda u, y, fit: phc.compare((u, 0 * y), fit, dt=1.0), "zero throughout"),
        (lambda u, y, fit: phc.residual_analysis((u, y), fit, dt=1.0), r"one of each: .* residual_plot\(result\)"),
        (lambda u, y, fit: phc.compare((u[:, :3], y[:, :3] / SOME), FORM, dt=1.0, offset=True), "states to"),
    ],
)
def test_what_does_not_fit_is_refused(recording, result, call, words):
    with pytest.raises(phc.StructureError, match=words):
        call(*recording, result)


def test_the_command_line_compares_channels(recording, result, tmp_path):
    u, y = recording
    table = np.concatenate([np.arange(600.0)[None], u, y])
    path = tmp_path / "new.csv"
    np.savetxt(path, table.T, delimiter=",", header="t [s],u1,u2,y1,y2,y3", comments="")
    result.save(tmp_path / "fit.json")
    chosen = ["--inputs", "u1,u2", "--outputs", "y1,y2,y3"]
    done = run("compare", path, tmp_path / "fit.json", *chosen, "--plot", tmp_path / "new.png")
    assert done.status == 0 and "Fit to 3 outputs: 600 samples" in done.out and (tmp_path / "new.png").exists()
    answer = json.loads(run("compare", path, tmp_path / "fit.json", *chosen, "--json").out)["models"][0]
    expected = phc.compare(recording, result, dt=1.0)
    assert np.isclose(answer["fit_percent"], expected.fit_percent[0])
    assert np.allclose([answer["outputs"][name] for name in ("y1", "y2", "y3")], expected.output_fit_percent[0])

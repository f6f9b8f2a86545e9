"""The command line: models against recordings, and pictures."""

from __future__ import annotations

import io
import json
import re
import struct
import sys
from pathlib import Path

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from shell import run
from slow import slowly

import ph_control as phc
from ph_control.cli import main

PLANT = phc.frenkel_kontorova(2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings of a plant, models of it, and one that is lossy."""
    path = tmp_path_factory.mktemp("pictures")
    rng, t = np.random.default_rng(0), 0.1 * np.arange(400)
    pairs = []
    for name in ("first", "second"):
        u = rng.standard_normal(400)
        y = phc.forced_response(PLANT, t, u, intersample="zoh").outputs + 0.05 * rng.standard_normal(400)
        np.savetxt(path / f"{name}.csv", np.c_[t, u, y], delimiter=",", header="time,F [N],v [m/s]", comments="")
        pairs.append((u, y))
    omega = np.linspace(0.2, 2.5, 40)
    response = PLANT.modes.freqresp(omega)
    shaker = np.c_[omega, response.real, response.imag, 1 / np.abs(response)]
    np.savetxt(path / "shaker.csv", shaker, delimiter=",", header="omega,re,im,weight", comments="")
    phc.save(PLANT, path / "plant.json")
    phc.save(phc.affine(PLANT.Q, PLANT.B[:, 0]), path / "affine.json")
    phc.save(phc.ph(np.diag([1.0, 2, 1, 2]), np.eye(4, 2, k=-2)), path / "two.json")
    (path / "lossy.txt").write_text("1 0\n1 0.1 1\n")
    (path / "nothing.txt").write_text("0\n1 0 4\n")
    data = [phc.read_csv(path / f"{name}.csv") for name in ("first", "second")]
    phc.pem(data[0], 2).save(path / "result.json")
    phc.pem(data, 2).save(path / "both.json")
    return path


@pytest.fixture
def here(folder, tmp_path, monkeypatch):
    """The working folder: that of the files, with a folder for what is written."""
    monkeypatch.chdir(folder)
    return tmp_path


# --- compare ---------------------------------------------------------------------------------------------------------


def test_compare_prints_the_table_of_the_library(here):
    done = run("compare", "second.csv", "plant.json", "lossy.txt", "result.json")
    models = [phc.load("plant.json"), ct.tf([1, 0], [1, 0.1, 1]), phc.load("result.json")]
    expected = phc.compare(phc.read_csv("second.csv"), *models, labels=["plant", "lossy", "result"])
    assert (done.status, done.error) == (0, "")
    assert done.out.strip() == str(expected)
    answer = json.loads(run("compare", "second.csv", "plant.json", "lossy.txt", "result.json", "--json").out)
    assert [one["fit_percent"] for one in answer["models"]] == expected.fit_percent.tolist()
    assert answer["best"] == expected.best and [one["label"] for one in answer["models"]] == list(expected.labels)


def test_the_options_of_the_comparison_reach_it(here):
    chosen = ("--intersample", "foh", "--initial-state", "zero", "--offset", "--method", "midpoint")
    answer = json.loads(run("compare", "first.csv", "plant.json", "--json", *chosen).out)
    expected = phc.compare(
        phc.read_csv("first.csv"), PLANT, intersample="foh", initial_state="zero", offset=True, method="midpoint"
    )
    assert answer["models"][0]["fit_percent"] == expected.fit_percent[0]


def test_the_input_between_samples_is_that_of_the_fits(here):
    linear = phc.pem(phc.read_csv("first.csv"), 2, intersample="foh")
    linear.save(here / "linear.json")
    answer = json.loads(run("compare", "second.csv", "plant.json", here / "linear.json", "--json").out)
    expected = phc.compare(phc.read_csv("second.csv"), PLANT, linear)
    assert [one["fit_percent"] for one in answer["models"]] == expected.fit_percent.tolist()


def test_several_recordings_a_pipe_and_labels(here):
    done = run(
        "compare", "-", "plant.json", "plant.json", "--recording", "second.csv", "--label", "one", "--label", "other",
        "--json", stdin=Path("first.csv").read_bytes(),
    )  # fmt: skip
    answer = json.loads(done.out)
    assert [one["label"] for one in answer["models"]] == ["one", "other"]
    assert [one["samples"] for one in answer["experiments"]] == [400, 400]
    data = [phc.read_csv("first.csv"), phc.read_csv("second.csv")]
    assert answer["models"][0]["fit_percent"] == phc.compare(data, PLANT).fit_percent[0]


def test_frequency_responses_are_compared_with_their_weights(here):
    plain, weighted = (
        json.loads(run("compare", "shaker.csv", "lossy.txt", "--json", *more).out)["models"][0]["fit_percent"]
        for more in ((), ("--weights", "weight"))
    )
    data, values = phc.read_frequency_csv("shaker.csv"), np.loadtxt("shaker.csv", delimiter=",", skiprows=1)
    lossy = ct.tf([1, 0], [1, 0.1, 1])
    assert plain == phc.compare(data, lossy).fit_percent[0]
    assert weighted == phc.compare(data, lossy, weights=values[:, 3]).fit_percent[0] != plain


def test_a_fit_below_the_one_asked_for_is_status_1(here):
    assert run("compare", "first.csv", "plant.json", "--at-least", 90).status == 0
    done = run("compare", "first.csv", "lossy.txt", "--at-least", 90)
    assert done.status == 1 and "below the 90 % of --at-least" in done.error and "lossy" in done.out
    answered = run("compare", "first.csv", "lossy.txt", "--at-least", 90, "--json")
    assert answered.status == 1 and json.loads(answered.out)["best"] == "lossy"


# --- plot ------------------------------------------------------------------------------------------------------------

PICTURES = {
    "bode": ["plant.json", "lossy.txt", "--recording", "first.csv", "--omega", "0.1,10", "--hz", "--unit", "m/s/N"],
    "step": ["result.json", "plant.json", "--band", "0.9", "--until", "20", "--unit", "m/s"],
    "impulse": ["--num", "1,0", "--den", "1,0.1,4", "--title", "$ 50 %"],
    "modes": ["result.json", "plant.json", "--hz"],
    "poles": ["plant.json", "--label", "the plant"],
    "energy": ["plant.json", "result.json", "--recording", "first.csv", "--until", "20", "--unit", "J"],
    "fit": ["both.json", "--experiment", "2"],
}
MARKS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.parametrize(
    "kind, suffix",
    [*((kind, "svg") for kind in PICTURES), ("bode", "png"), ("bode", "pdf"),
     *slowly(*((kind, suffix) for kind in PICTURES if kind != "bode" for suffix in ("png", "pdf")))],
)  # fmt: skip
def test_every_picture_is_drawn_in_every_format(here, kind, suffix):
    target = here / f"{kind}.{suffix}"
    done = run("plot", kind, *PICTURES[kind], "--out", target)
    assert (done.status, done.out, done.error) == (0, f"Written: {target}\n", "")
    assert target.read_bytes().startswith(MARKS[suffix])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bode", "step", "impulse", "modes", "poles", "energy"])
def test_models_without_more_ado_are_drawn(here, kind):
    for name in ("plant.json", "two.json", "result.json"):
        done = run("plot", kind, name, "-o", here / f"{name}.svg")
        assert (done.status, done.error) == (0, ""), name


@pytest.mark.slow
def test_the_same_picture_has_the_same_bytes_also_through_a_pipe(here):
    for kind in MARKS:
        first, second = (run("plot", "bode", "plant.json", "--out", "-", "--format", kind).output for _ in range(2))
        assert first == second and first.startswith(MARKS[kind])
    piped = run("plot", "bode", "-", "--out", here / "a.svg", stdin=Path("plant.json").read_bytes())
    assert piped.status == 0


def test_size_and_dots_of_a_picture_can_be_said(here):
    target = here / "small.png"
    run("plot", "bode", "plant.json", "--size", "5,4", "--dpi", "50", "--out", target)
    assert struct.unpack(">II", target.read_bytes()[16:24]) == (250, 200)


def test_titles_and_labels_are_in_the_picture(here):
    target = here / "a.svg"
    run("plot", "step", "plant.json", "lossy.txt", "--label", "one", "--label", "other", "--out", target)
    assert "Step response of one, other" in target.read_text()
    run("plot", "step", "plant.json", "--title", "A title", "--out", target, "--overwrite")
    assert "A title" in target.read_text() and "Step response" not in target.read_text()


@pytest.mark.parametrize("kind", ["step", "impulse"])
def test_a_fit_with_damping_and_a_delay_is_drawn_with_its_band(here, kind, monkeypatch):
    rng, t = np.random.default_rng(0), 0.5 * np.arange(300)
    u = rng.standard_normal(300)
    y = phc.forced_response(phc.ph(phc.modes(1.0, 1.0, damping=0.1)), t, u, intersample="zoh").outputs
    late = np.append(np.zeros(4), y[:-4]) + 0.01 * rng.standard_normal(300)
    result = phc.pem((u, late), 1, dt=0.5, structure="free", noise="white", delay=2.0, real_poles=0)
    result.save(here / "damped.json")
    drawn = []
    monkeypatch.setattr("ph_control.cli.commands.plot.deliver_picture", lambda plot, *args, **more: drawn.append(plot))
    done = run("plot", kind, here / "damped.json", "--band", "0.95", "--until", "20", "--out", here / "a.svg")
    assert (done.status, done.error) == (0, "")
    (axis,) = drawn[0].axes.ravel()
    assert any("95 % band" in str(part.get_label()) for part in axis.collections)
    time, values = axis.lines[0].get_data()
    assert np.all(values[time < 2.0] == 0) and np.abs(values).max() > 0.5
    plt.close(drawn[0].figure)


def test_plot_answers_as_json(here):
    answer = json.loads(run("plot", "poles", "plant.json", "--out", here / "p.png", "--json").out)
    assert answer == {"command": "plot", "kind": "poles", "models": ["plant"], "written": [str(here / "p.png")]}


@pytest.mark.slow
def test_a_comparison_is_drawn(here):
    for recording, more in (("first.csv", ["--recording", "second.csv", "--experiment", "2"]), ("shaker.csv", [])):
        target = here / f"{recording}.png"
        done = run("compare", recording, "plant.json", "lossy.txt", *more, "--plot", target)
        assert done.status == 0 and f"Written: {target}" in done.out
        assert target.read_bytes().startswith(MARKS["png"])
    piped = run("compare", "first.csv", "plant.json", "--plot", here / "x.svg")
    assert piped.status == 0


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["plot"], "required: -o/--out|required: KIND"),
        (["plot", "bode", "plant.json"], "required: -o/--out"),
        (["plot", "bode", "--out", "{}"], "no model given"),
        (["plot", "pie", "plant.json", "--out", "{}"], "invalid choice: 'pie'"),
        (["plot", "bode", "plant.json", "--out", "x.doc"], "no known picture format"),
        (["plot", "bode", "plant.json", "--out", "-"], "no suffix to tell the format of a picture; pass --format png"),
        (["plot", "bode", "plant.json", "--out", "-", "--format", "doc"], "no known picture format"),
        (["plot", "bode", "plant.json", "--out", "-", "--format", "png", "--json"], "both want standard output"),
        (["plot", "bode", "plant.json", "two.json", "--out", "{}"], "the systems differ"),
        (["plot", "bode", "plant.json", "--until", "3", "--out", "{}"], "--until has no meaning for bode; it is"),
        (["plot", "step", "plant.json", "--hz", "--out", "{}"], "--hz has no meaning for step"),
        (["plot", "step", "plant.json", "--until", "0", "--out", "{}"], "argument --until: 0 is not between"),
        (["plot", "bode", "plant.json", "--omega", "2,1", "--out", "{}"], "omega_limits must be at least two positive"),
        (["plot", "bode", "result.json", "--band", "2", "--out", "{}"], "level is 2.0; it must be a number between 0"),
        (["plot", "bode", "plant.json", "--band", "0.9", "--out", "{}"], "--band is drawn around results of fits"),
        (["plot", "bode", "plant.json", "--size", "9,0", "--out", "{}"], "'9,0' is not width,height"),
        (["plot", "bode", "plant.json", "--dpi", "1e9", "--out", "{}"], "1e9 is not between 10 and 2400"),
        (["plot", "bode", "plant.json", "--hz", "--time-unit", "days", "--out", "{}"], "leave --hz out"),
        (["plot", "bode", "plant.json", "--label", "a", "--label", "b", "--out", "{}"], "2 labels for 1 models"),
        (["plot", "bode", "plant.json", "--recording", "absent.csv", "--out", "{}"], "there is no file absent.csv"),
        (["plot", "fit", "plant.json", "--out", "{}"], "fit draws one result of a fit"),
        (["plot", "fit", "both.json", "--experiment", "3", "--out", "{}"], "--experiment is 3; there are 2"),
        (["plot", "energy", "two.json", "--recording", "first.csv", "--out", "{}"], "no recorded input for the 2"),
        (["plot", "energy", "plant.json", "--recording", "shaker.csv", "--out", "{}"], "no recorded input"),
        (["plot", "energy", "plant.json", "--recording", "first.csv", "--until", "0.01", "--out", "{}"], "1 sample"),
        (["plot", "energy", "nothing.txt", "--out", "{}"], "has no modes, so it stores no energy"),
        (["plot", "modes", "affine.json", "--out", "{}"], "its derivative has"),
        (["compare", "first.csv"], "no model given"),
        (["compare", "first.csv", "absent.json"], "there is no file absent.json"),
        (["compare", "plant.json", "first.csv"], "holds JSON|lines of text"),
        (["compare", "-", "-"], "more than once for standard input"),
        (["compare", "first.csv", "two.json"], "has 2 inputs and 2 outputs"),
        (["compare", "first.csv", "plant.json", "--initial-state", "fitted"], "--initial-state fitted is that of"),
        (["compare", "first.csv", "plant.json", "--experiment", "0"], "--experiment is 0; there are 1"),
        (["compare", "first.csv", "plant.json", "--label", "a", "--label", "b"], "2 labels for 1 models"),
        (["compare", "first.csv", "plant.json", "--plot", "-", "--json"], "both want standard output"),
        (["compare", "first.csv", "--num", "1,0", "--den", "1,0,-400"], "is unstable"),
    ],
)  # fmt: skip
def test_mistakes_end_in_one_line_with_a_remedy_and_draw_nothing(here, arguments, message):
    done = run(*[argument.format(here / "p.png") for argument in arguments])
    assert (done.status, done.out) == (2, "")
    assert re.search(message, done.error) and done.error.count("\n") == 1, done.error
    assert not list(here.iterdir())


def test_the_energy_of_a_passive_system_is_drawn(here):
    assert run("plot", "energy", "lossy.txt", "--out", here / "p.png").status == 0
    assert (here / "p.png").stat().st_size > 0


def test_modes_with_losses_are_drawn_and_those_of_an_active_system_are_not(here):
    assert run("plot", "modes", "lossy.txt", "--out", here / "p.png").status == 0
    assert (here / "p.png").stat().st_size > 0
    (here / "active.txt").write_text("1 0\n1 -0.1 1\n")
    done = run("plot", "modes", here / "active.txt", "--out", here / "q.png")
    assert done.status == 1 and "not passive" in done.error and not (here / "q.png").exists()


@pytest.mark.slow
def test_modal_forms_that_are_not_passive_are_drawn(here):
    phc.save(phc.modes([-0.1 + 2j, -0.2 + 5j], [[1.0], [-1.0]], [[1.0], [0.5j]]), here / "free.json")
    for kind in ("bode", "step", "impulse", "modes", "poles"):
        done = run("plot", kind, here / "free.json", "--out", here / f"{kind}.png")
        assert (done.status, done.error) == (0, ""), kind
    done = run("reduce", here / "free.json", here / "q.json", "--order", 1)
    assert done.status == 1 and "not passive" in done.error and not (here / "q.json").exists()


def test_existing_pictures_and_inputs_are_kept(here):
    target = here / "mine.png"
    target.write_text("mine")
    for command in (["plot", "bode", "plant.json", "--out"], ["compare", "first.csv", "plant.json", "--plot"]):
        done = run(*command, target)
        assert done.status == 2 and "--overwrite" in done.error and target.read_text() == "mine"
        own = run(*command, command[2] if command[0] == "plot" else "first.csv", "--overwrite", "--json")
        assert own.status == 2 and "is one of the inputs" in own.error
    assert run("plot", "bode", "plant.json", "--out", target, "--overwrite").status == 0


def test_a_picture_is_not_sent_to_a_terminal(here):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = Terminal(), io.StringIO()
    try:
        assert main(["plot", "bode", "plant.json", "--out", "-", "--format", "png"]) == 2
        said = sys.stderr.getvalue()
    finally:
        sys.stdout, sys.stderr = streams
    assert "terminal" in said

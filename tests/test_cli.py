"""The command line: fitting, the demonstration, and how runs end."""

from __future__ import annotations

import importlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import control as ct
import numpy as np
import pytest
from shell import run, streams, without_pictures

import ph_control as phc
from ph_control import cli

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"


def table(path: Path, header: str, *columns: np.ndarray) -> Path:
    """A recording as a file."""
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.12g")
    return path


def chain_recording(rng, samples):
    """Time, input and noisy output of a chain of two masses, which moves at the start."""
    t, u = 0.1 * np.arange(samples), rng.standard_normal(samples)
    y = phc.forced_response(phc.frenkel_kontorova(2), t, u, [2.0, 1.0, -3.0, -3.0], intersample="zoh").outputs
    return t, u, y + 0.1 * np.std(y) * rng.standard_normal(samples)


@pytest.fixture
def recording(tmp_path):
    """A noisy recording, as a file."""
    t, u, y = chain_recording(np.random.default_rng(1), 600)
    return table(tmp_path / "recording.csv", "time,force,speed", t, u, y)


@pytest.fixture
def damped(tmp_path):
    """A recording that no lossless model describes."""
    t, u = 0.1 * np.arange(600), np.random.default_rng(1).standard_normal(600)
    y = ct.forced_response(ct.tf([1, 0], [1, 0.2, 1]), t, u).outputs
    return table(tmp_path / "damped.csv", "time,force,speed", t, u, y)


def strict_json(text: str):
    """JSON without the words that Python adds to it."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


# --- fit -------------------------------------------------------------------------------------------------------------


def test_fit_prints_the_summary_and_writes_model_and_picture(recording, tmp_path):
    model, picture = tmp_path / "model.json", tmp_path / "fit.png"
    done = run("fit", recording, "--input", "force", "--output", "speed", "--model", model, "--plot", picture)
    assert (done.status, done.error) == (0, "")
    assert "2 modes of 'speed' from 'force'" in done.out
    assert f"Written: {model}, {picture}" in done.out
    system = phc.load(model)
    assert isinstance(system, phc.PortHamiltonian) and system.input_labels == ["force"]
    assert np.allclose(system.d, [0.6180, 1.6180], atol=2e-3)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_columns_may_be_numbers_and_the_step_given(recording, tmp_path):
    values = np.loadtxt(recording, delimiter=",", skiprows=1)
    bare = tmp_path / "bare.dat"
    np.savetxt(bare, values[:, 1:])
    done = run("fit", bare, "--input", 0, "--output", 1, "--dt", 0.1, "--order", 2)
    assert done.status == 0 and "2 modes" in done.out


def test_layout_of_the_table_can_be_said(recording, tmp_path):
    values = np.loadtxt(recording, delimiter=",", skiprows=1)
    odd = tmp_path / "odd.txt"
    odd.write_text("\n".join("|".join(f"{x:.10g}" for x in row) for row in values))
    chosen = ("--time", 0, "--input", 1, "--output", 2, "--order", 2)
    done = run("fit", odd, "--delimiter", "|", "--no-header", *chosen)
    assert (done.status, done.error) == (0, "") and "2 modes" in done.out
    by_step = run("fit", recording, "--no-time", "--dt", 0.1, "--input", "force", "--output", "speed", "--order", 2)
    assert by_step.out == run("fit", recording, "--order", 2).out


def test_result_and_bode_picture_are_written_on_request(recording, tmp_path):
    result, bode = tmp_path / "result.json", tmp_path / "bode.svg"
    done = run("fit", recording, "--order", 2, "--result", result, "--bode", bode)
    assert done.status == 0 and str(bode) in done.out
    assert isinstance(phc.load(result), phc.PEMResult)
    assert bode.read_text().lstrip().startswith("<?xml")
    shown = run("info", result)
    assert shown.status == 0 and shown.out.strip() == phc.load(result).summary().strip()


@pytest.mark.parametrize("option", ["--model", "--result"])
@pytest.mark.parametrize("suffix, writer", [("mat", "convert"), ("csv", "convert"), ("cir", "netlist")])
def test_json_is_not_written_under_the_suffix_of_another_format(recording, option, suffix, writer, tmp_path):
    target = tmp_path / f"m.{suffix}"
    done = run("fit", recording, "--order", 2, option, target)
    assert done.status == 2 and not done.out and not target.exists()
    assert "end its name in .json" in done.error and f"`ph-control {writer} m.json m.{suffix}`" in done.error


@pytest.mark.parametrize("structure", ["lossless", "classical", "free"])
def test_info_as_json_tells_whether_a_fit_is_lossless(damped, structure, tmp_path):
    result = tmp_path / "result.json"
    run("fit", damped, "--order", 1, "--structure", structure, "--noise", "white", "--result", result)
    answer = strict_json(run("info", result, "--json").out)
    assert answer["lossless"] is (structure == "lossless") and answer["structure"] == structure


def test_a_recording_may_come_in_and_the_model_go_out_through_pipes(recording):
    piped = run("fit", "-", "--order", 2, "--model", "-", stdin=recording.read_bytes())
    assert (piped.status, piped.error) == (0, "")
    shown = run("info", "-", "--json", stdin=piped.output)
    fitted = strict_json(run("fit", recording, "--order", 2, "--json").out)
    assert strict_json(shown.out)["d"] == fitted["d"]


def test_the_answer_as_json_has_all_numbers_in_full(recording, tmp_path):
    result = tmp_path / "result.json"
    done = run("fit", recording, "--order", 3, "--json", "--result", result)
    answer, kept = strict_json(done.out), phc.load(result)
    for key in ("d", "r"):
        assert answer[key] == getattr(kept, key).tolist()
    for key in ("verdict", "message", "fit_percent", "bic", "order", "success", "whiteness"):
        assert answer[key] == getattr(kept, key)
    assert answer["stderr"]["r"] == kept.stderr["r"].tolist()
    # no offset was estimated, and so no error of it: null, not NaN
    assert answer["stderr"]["offset"] == [None] and np.isnan(kept.stderr["offset"]).all()
    assert answer["written"] == [str(result)] and answer["described"] is True
    assert answer["experiments"][0]["step"] == 0.1
    assert [row["order"] for row in answer["order_table"]] == [row.order for row in kept.order_table]


@pytest.mark.slow
def test_several_recordings_are_several_experiments(recording, tmp_path):
    t, u, y = chain_recording(np.random.default_rng(2), 400)
    other = table(tmp_path / "other.csv", "time,force,speed", t, u, y + 5.0)
    picture = tmp_path / "second.svg"
    chosen = ("--order", 2, "--offset", "--plot", picture, "--experiment", 2)
    done = run("fit", recording, other, *chosen, "--json")
    answer = strict_json(done.out)
    assert [one["samples"] for one in answer["experiments"]] == [600, 400]
    assert [one["title"] for one in answer["experiments"]] == ["recording.csv", "other.csv"]
    assert abs(answer["experiments"][1]["offset"] - 5.0) < 0.1
    result = phc.pem([phc.read_csv(recording), phc.read_csv(other)], 2, offset=True)
    assert answer["d"] == result.d.tolist()
    assert picture.exists()


def test_a_free_motion_of_another_quantity_is_fitted(tmp_path):
    plant, t = phc.frenkel_kontorova(2), 0.1 * np.arange(500)
    speed = phc.initial_response(plant, t, [1.0, 0.0, 0.0, -0.5]).outputs
    decay = table(tmp_path / "decay.csv", "t,x", t, speed)
    answer = strict_json(run("fit", decay, "--no-input", "--quantity", "displacement", "--json").out)
    assert np.allclose(answer["d"], plant.d, rtol=1e-6) and answer["quantity"] == "displacement"
    assert "r" not in answer and "r" not in answer["stderr"]


@pytest.fixture
def shaker(tmp_path):
    """A frequency response as a file, with weights."""
    plant, omega = phc.frenkel_kontorova(2), np.linspace(0.205, 2.5, 80)
    response = plant.modes.freqresp(omega)
    noise = 1e-3 * np.random.default_rng(0).standard_normal((2, 80)) @ np.eye(80)
    response = response * (1 + noise[0]) + 1j * noise[1]
    path = tmp_path / "shaker.csv"
    gain, phase = np.abs(response), np.degrees(np.angle(response))
    columns = omega / 2 / np.pi, 20 * np.log10(gain), phase, 1 / gain**2
    return table(path, "f [Hz],gain [dB],phase [deg],weight", *columns)


def test_a_frequency_response_is_recognised_by_its_labels(shaker):
    plant = phc.frenkel_kontorova(2)
    done = run("fit", shaker, "--order", 2, "--json")
    answer = strict_json(done.out)
    assert done.status == 0 and np.allclose(answer["d"], plant.d, rtol=1e-2)
    assert answer["experiments"][0]["step"] is None
    assert answer["d"] == phc.pem(phc.read_frequency_csv(shaker), 2).d.tolist()


@pytest.mark.slow
def test_columns_units_and_weights_of_a_frequency_response_can_be_said(shaker):
    plain = strict_json(run("fit", shaker, "--order", 2, "--json").out)
    told = ("--frequency", 0, "--magnitude", 1, "--phase", 2, "--frequency-unit", "Hz", "--magnitude-unit", "dB",
            "--phase-unit", "deg")  # fmt: skip
    assert strict_json(run("fit", shaker, "--order", 2, "--json", *told).out)["d"] == plain["d"]
    weighted = strict_json(run("fit", shaker, "--order", 2, "--json", "--weights", "weight").out)
    values = np.loadtxt(shaker, delimiter=",", skiprows=1)
    expected = phc.pem(phc.read_frequency_csv(shaker), 2, weights=values[:, 3])
    assert weighted["d"] == expected.d.tolist() != plain["d"]
    assert "in frequency" not in run("fit", shaker, shaker, "--order", 2).error


def test_the_options_of_the_fit_reach_it(recording, tmp_path, monkeypatch):
    seen, pem = {}, phc.pem

    def watched(data, order, **keywords):
        seen.update(keywords, order=order)
        return pem(data, 2)

    guess = tmp_path / "guess.json"
    phc.save(phc.modes([0.6, 1.6], [1.0, 1.0]), guess)
    monkeypatch.setattr(phc, "pem", watched)
    run(
        "fit", recording, "--order", 2, "--max-order", 7, "--criterion", "aicc", "--method", "midpoint",
        "--intersample", "foh", "--initial-state", "zero", "--offset", "--quantity", "acceleration",
        "--representation", "controllable", "--guess", guess, "--seed", 5, "--workers", 2,
        "--real-poles", 1, "--noise", "white",
    )  # fmt: skip
    assert seen.pop("initial_guess").d.tolist() == [0.6, 1.6]
    assert seen == {
        "order": 2, "max_order": 7, "criterion": "aicc", "method": "midpoint", "intersample": "foh",
        "initial_state": "zero", "offset": True, "quantity": "acceleration", "representation": "controllable", "rng": 5,
        "workers": 2, "callback": None, "structure": "auto", "ports": None, "delay": "auto",
        "input_delay": "auto", "real_poles": 1, "noise": "white",
    }  # fmt: skip


@pytest.mark.parametrize(
    "keyword", ["method", "intersample", "quantity", "criterion", "representation", "frequency_unit"]
)
def test_choices_are_those_of_the_library(keyword):
    with pytest.raises(phc.StructureError, match=rf"{keyword} is 'no such'; it must be one of") as caught:
        if keyword == "frequency_unit":
            phc.read_frequency_csv(io.StringIO("w,re,im\n1,2,3\n"), frequency_unit="no such")
        else:
            asked = {"structure": "free"} if keyword == "quantity" else {}  # any sensor
            phc.pem((np.sin(np.arange(99.0)), np.cos(np.arange(99.0))), dt=0.1, **{keyword: "no such"}, **asked)
    refused = run("fit", "x.csv", f"--{keyword.replace('_', '-')}", "no such")
    assert refused.status == 2
    assert set(re.findall(r"'([\w/]+)'", refused.error)) == set(re.findall(r"'([\w/]+)'", str(caught.value)))


@pytest.mark.slow
def test_a_refusal_is_status_1_and_the_model_is_written_all_the_same(damped, tmp_path):
    model = tmp_path / "model.json"
    done = run("fit", damped, "--structure", "lossless", "--max-order", 2, "--model", model)
    assert done.status == 1 and done.error == ""
    assert "NOT described by a model of this structure" in done.out and f"Written: {model}" in done.out
    assert isinstance(phc.load(model), phc.PortHamiltonian)
    piped = run("fit", damped, "--structure", "lossless", "--max-order", 2, "--model", "-")
    assert piped.status == 1 and piped.output == model.read_bytes()
    assert piped.error.startswith("ph-control: the verdict is: NOT described") and piped.error.count("\n") == 1
    answer = strict_json(run("fit", damped, "--structure", "lossless", "--max-order", 2, "--json").out)
    assert answer["described"] is False


def test_noise_alone_is_nothing_to_model_with_status_1(tmp_path):
    noise = np.random.default_rng(3).standard_normal((2, 300))
    path = table(tmp_path / "noise.csv", "t,u,y", 0.1 * np.arange(300), *noise)
    outputs = [tmp_path / name for name in ("m.json", "r.json", "p.png", "b.png")]
    chosen = [part for pair in zip(("--model", "--result", "--plot", "--bode"), outputs, strict=True) for part in pair]
    done = run("fit", path, *chosen)
    assert done.status == 1 and "nothing to model" in done.out
    assert all(path.exists() for path in outputs)


@pytest.mark.slow
def test_robot_arm_goes_through_without_crash_or_flattery(tmp_path):
    arm = DATA / "measured" / "robot_arm.dat"
    if not arm.exists():
        pytest.skip("the third-party recordings are not beside the project")
    chosen = ("--input", 0, "--output", 1, "--dt", 1, "--structure", "lossless", "--max-order", 4)
    done = run("fit", arm, *chosen, "--model", tmp_path / "arm.json", "--plot", tmp_path / "arm.png")
    assert (done.status, done.error) == (1, "")
    text = " ".join(done.out.split())
    assert float(re.search(r"fit +([\d.]+) %", text)[1]) < 90
    assert "structure lossless" in text and "does not describe the data" in text
    assert (tmp_path / "arm.json").exists() and (tmp_path / "arm.png").exists()


# --- what is not done ------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("option", ["--model", "--result", "--plot", "--bode"])
def test_existing_files_are_refused_before_the_fit_and_replaced_only_on_request(recording, tmp_path, option):
    path = tmp_path / ("out.png" if option in ("--plot", "--bode") else "out.json")
    path.write_text("mine")
    done = run("fit", recording, option, path)
    assert (done.status, done.out) == (2, "")
    assert f"{path} exists" in done.error and "--overwrite" in done.error
    assert path.read_text() == "mine"
    done = run("fit", recording, option, path, "--order", 2, "--overwrite")
    assert done.status == 0 and path.read_bytes() != b"mine"


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--input", "torque"], "torque.*force"),
        (["--input", "force", "--no-input"], "contradict"),
        (["--time", "force", "--no-time"], "contradict"),
        (["--no-time"], "name it with --time, or give the time between samples with --dt"),
        (["--dt", "0.2"], "dt is 0.2, but the step .* is 0.1; leave dt out, or pass --no-time"),
        (["--no-time", "--dt", "-1"], "dt is -1.0; it must be one positive number"),
        (["--no-time", "--dt", "inf"], "dt is inf; it must be one positive number"),
        (["--order", "200"], "200 modes have .* the largest order"),
        (["--order", "0"], "order is 0"),
        (["--max-order", "0"], "max_order is 0"),
        (["--workers", "0"], "workers is 0"),
        (["--plot", "{tmp}/fit.doc"], "no known picture format.*png"),
        (["--plot", "-"], "no suffix .* pass --format"),
        (["--model", "{tmp}/nowhere/model.json"], "the folder .* does not exist"),
        (["--model", "{tmp}"], "is a folder; pass the name of a file in it"),
        (["--model", "{tmp}/" + "a" * 300], "cannot be the name of a file: File name too long"),
        (["--model", "{tmp}/a.json", "--result", "{tmp}/a.json"], "two of the output files"),
        (["--model", "-", "--result", "-"], "more than once for standard output"),
        (["--model", "-", "--json"], "--json and - both want standard output"),
        (["--experiment", "2"], "--experiment is 2; there are 1"),
        (["--guess", "{tmp}/absent.json"], "there is no file"),
        (["--guess", "{tmp}/recording.csv"], "601 lines of text"),
        (["--frequency", "0", "--dt", "1"], "--frequency is for frequency responses and --dt for recordings"),
        (["--weights", "force"], "which column is the frequency|which column is the magnitude"),
        (["--delimiter", "ab"], "delimiter is 'ab'"),
        (["-"], "more than once|standard input is empty"),
    ],
)
def test_mistakes_end_in_one_line_with_a_remedy_and_write_nothing(recording, tmp_path, arguments, message):
    before = set(tmp_path.iterdir())
    done = run("fit", recording, *[argument.format(tmp=tmp_path) for argument in arguments])
    assert (done.status, done.out) == (2, "")
    assert done.error.startswith("ph-control: ") and re.search(message, done.error)
    assert done.error.count("\n") == 1
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", "standard input is empty; the command before the pipe"),
        (b"t,u,y\n", "standard input has a header in line 1 and no rows"),
        (b"t,u,y\n0,1,2\n", "at least two samples are needed"),
        (b"t,u,y\n0,1,2\n1,x,3\n", r"standard input, line 3, column 1 \('u'\): 'x' is not a number"),
        (b"t,u,y\n0,1,2\n1,2,3\n", "a mode needs at least 9"),
        (b"a,b\n1,2\n3,4\n", "no column is the time; name it with --time"),
        (b"t,u,y\n" + b"".join(b"%d,%d,1e200\n" % (k, k % 3) for k in range(9)), "end of the range of doubles"),
        (b"t,u,y\n" + b"".join(b"%d,1,%d\n" % (k, k % 3) for k in range(9)), "input 'u' is constant.*--no-input"),
        (b"\x00\x01\xff", "standard input is not a text file"),
        (b'{"format": "ph_control"}', "holds JSON, perhaps a model"),
    ],
)
def test_what_is_no_recording_is_said_to_be_so(content, message):
    done = run("fit", "-", stdin=content)
    assert (done.status, done.out) == (2, "")
    assert re.search(message, done.error) and done.error.count("\n") == 1


def test_who_types_a_recording_is_told_how_to_end_it():
    with streams(b"t,u\n") as (_, error):
        sys.stdin.isatty = lambda: True
        assert cli.main(["fit", "-"]) == 2
    assert "it ends with Ctrl-D" in error.getvalue().splitlines()[0]


def test_a_guess_that_is_not_lossless_is_bad_input_and_no_verdict_of_the_fit(recording, tmp_path):
    guess = tmp_path / "guess.txt"
    guess.write_text("1 0\n1 0.1 4\n")
    done = run("fit", recording, "--guess", guess)
    assert done.status == 2 and "--guess: " in done.error and "off the imaginary axis" in done.error


def test_a_recording_is_never_overwritten_by_what_is_made_of_it(recording):
    before = recording.read_bytes()
    done = run("fit", recording, "--model", recording, "--overwrite")
    assert done.status == 2 and "is one of the inputs" in done.error
    assert recording.read_bytes() == before


def test_what_is_no_regular_file_is_refused(recording, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    done = run("fit", recording, "--model", tmp_path / "pipe", "--overwrite")
    assert done.status == 2 and "not a regular file" in done.error
    assert "is a folder" in run("fit", tmp_path).error


@pytest.mark.parametrize(
    "arguments, message",
    [
        ([], "required: COMMAND; see ph-control --help"),
        (["fly"], "invalid choice: 'fly'"),
        (["fit"], "required: RECORDING; see ph-control fit --help"),
        (["fit", "x", "--order", "many"], "invalid order value: 'many'"),
        (["fit", "x", "--order", "9" * 5000], "invalid order value: '99999.*...9"),
        (["fit", "x", "--method", "rk4"], "invalid choice: 'rk4'"),
        (["fit", "x", "--ordr", "3"], "--ordr is not an option or argument of this command; did you mean --order?"),
        (["fit", "x", "--order=3", "--nonsense"], "--nonsense is not an option or argument of this command"),
        (["fit", "x", "--dt", "abc"], "argument --dt: invalid float value: 'abc'"),
        (["fit", "x", "--seed", "-1"], "argument --seed: -1 is not between 0 and"),
        (["fit", "x", "--max-order", "1.5"], "invalid int value: '1.5'"),
    ],
)
def test_wrong_usage_is_status_2_and_one_line(arguments, message):
    done = run(*arguments)
    assert (done.status, done.out) == (2, "")
    assert re.search(message, done.error) and done.error.count("\n") == 1 and "--help" in done.error


def test_after_two_dashes_names_may_begin_with_one(recording, monkeypatch):
    monkeypatch.chdir(recording.parent)
    recording.rename("-odd.csv")
    assert run("fit", "--order", 2, "--", "-odd.csv").status == 0
    assert "-odd.csv is not an option" in run("fit", "-odd.csv", "x.csv").error


def test_messages_speak_of_options_and_not_of_keywords(recording, monkeypatch):
    def refuse(*arguments, **keywords):
        raise phc.StructureError(
            "pass header=True or header=False; use initial_state='estimate', max_order=30 or say which with input= "
            "and output=; several columns are passed as a list; (intersample='foh'); pass "
            "(None, y), offset=True; time=False, dt=0.1."
        )

    monkeypatch.setattr(phc, "pem", refuse)
    assert run("fit", recording).error == (
        "ph-control: pass --header or --no-header; use --initial-state estimate, --max-order 30 or say which with "
        "--input and --output; several columns need --inputs or --outputs; (--intersample foh); "
        "pass --no-input, --offset; --no-time, --dt 0.1.\n"
    )


# --- demo, help, progress --------------------------------------------------------------------------------------------


def test_demo_leaves_recordings_models_and_pictures_and_finds_the_truth(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run("demo")
    assert (done.status, done.error) == (0, "")
    folder = tmp_path / "ph_control_demo"
    names = {f"{plant}{end}" for plant in ("circuit", "chain") for end in (".csv", ".json", "_bode.png")}
    assert {path.name for path in folder.iterdir()} == names | {f"structure{end}" for end in (".csv", ".json", ".html")}
    assert done.out.count("3 of 3 visible modes found") == 1 and "f [Hz] true" in done.out
    assert "1 of 1 visible modes found" in done.out and "2 of 2 visible modes found" in done.out
    assert np.allclose(phc.load(folder / "circuit.json").d, [1.0], rtol=1e-3)
    assert np.allclose(phc.load(folder / "chain.json").d, [0.6180339887, 1.6180339887], rtol=1e-3)
    # a folder with something in it is refused
    refused = run("demo", "--folder", folder)
    assert refused.status == 2 and "not an empty folder" in refused.error
    # what the demonstration proposes to do next works
    without_pictures(monkeypatch)
    command = re.search(r"Next: ph-control (.*)", done.out)[1].split()
    assert run(*command).status == 0 and (tmp_path / "my_model.json").exists()


@pytest.mark.slow
def test_a_second_demo_finds_a_free_folder_and_the_truth(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ph_control_demo").mkdir()
    (tmp_path / "ph_control_demo" / "kept.txt").touch()
    without_pictures(monkeypatch)
    answer = strict_json(run("demo", "--seed", 1, "--json").out)
    assert answer["folder"] == "ph_control_demo-2" and (tmp_path / "ph_control_demo-2" / "chain.json").exists()
    structure, _, chain = answer["plants"]
    assert np.allclose(chain["fit"]["d"], chain["true"]["d"], rtol=1e-3)
    assert np.allclose(structure["fit"]["hertz"], structure["true"]["hertz"], rtol=1e-3)
    assert np.allclose(structure["fit"]["damping_ratios"], structure["true"]["damping_ratios"], rtol=0.1)


def test_progress_is_shown_on_a_terminal_only(recording):
    with streams(b"") as (output, error):
        error.isatty = lambda: True
        assert cli.main(["fit", str(recording), "--order", "2"]) == 0
    assert "order 2 of at most 2, iteration" in error.getvalue() and error.getvalue().endswith("\r\033[K")
    assert b"\r" not in output.getvalue()
    assert run("fit", recording, "--order", 2).error == ""


def test_an_interrupted_fit_gives_the_best_until_then_and_status_130(recording, tmp_path):
    def interrupt(text):
        if "order 2 of" in text:
            error.write = write
            raise KeyboardInterrupt
        return write(text)

    with streams(b"") as (output, error):
        error.isatty = lambda: True
        write, error.write = error.write, interrupt
        status = cli.main(["fit", str(recording), "--order", "9", "--json", "--model", str(tmp_path / "best.json")])
    assert status == 130 and "best model found until then" in error.getvalue()
    answer = strict_json(output.getvalue().decode())
    assert answer["interrupted"] is True and (tmp_path / "best.json").exists()


def slow(seconds, answer):
    """A fit that takes that long, unless it is interrupted; then it keeps its best."""

    def pem(data, order, **keywords):
        quick = answer(data, order, callback=lambda progress: None)
        try:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                time.sleep(0.01)
        except KeyboardInterrupt:
            return answer(data, order, callback=stop)
        return quick

    def stop(progress):
        raise StopIteration

    return pem


def test_the_time_allowed_ends_a_fit_with_the_best_so_far(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(phc, "pem", slow(60.0, phc.pem))
    done = run("fit", recording, "--order", 2, "--timeout", 1, "--model", tmp_path / "best.json")
    assert done.status == 130 and "the time of --timeout is up; this is the best model" in done.error
    assert (tmp_path / "best.json").exists()


@pytest.mark.slow
def test_what_is_silent_for_long_shows_the_time_so_far(recording, monkeypatch):
    monkeypatch.setattr(phc, "pem", slow(2.5, phc.pem))
    with streams(b"") as (_, error):
        error.isatty = lambda: True
        assert cli.main(["fit", str(recording), "--order", "2", "--timeout", "100"]) == 0
    assert ", 1 of at most 100 s" in error.getvalue() or ", 2 of at most 100 s" in error.getvalue()


def test_a_model_that_the_time_allowed_does_not_give_is_said_to_be_missing(recording, monkeypatch):
    def pem(*arguments, **keywords):
        for _ in range(6000):
            time.sleep(0.01)

    monkeypatch.setattr(phc, "pem", pem)
    done = run("fit", recording, "--timeout", 0.2)
    assert done.status == 2 and "no model was found in 0.2 s; allow more by --timeout" in done.error


def test_an_interrupt_elsewhere_writes_nothing(recording, tmp_path, monkeypatch):
    def interrupt(*arguments, **keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr(phc, "pem", interrupt)
    done = run("fit", recording, "--model", tmp_path / "model.json")
    assert (done.status, done.out) == (130, "") and "no file is written in part" in done.error
    assert not (tmp_path / "model.json").exists()


@pytest.mark.parametrize("command", ["", *cli.COMMANDS])
def test_every_command_has_a_help_with_examples(command):
    done = run(*[command] * bool(command), "--help")
    assert done.status == 0 and done.error == ""
    assert f"usage: ph-control{' ' * bool(command)}{command}" in done.out and "\nexamples:\n  ph-control" in done.out
    assert max(map(len, done.out.splitlines())) <= 100


def test_version_is_told():
    done = run("--version")
    assert done.status == 0 and done.out.startswith("ph-control ")


# --- errors of the program and of the streams ------------------------------------------------------------------------


def test_an_error_of_the_program_is_one_line_and_status_3_unless_its_traceback_is_wanted(recording, monkeypatch):
    def broken(*arguments, **keywords):
        raise TypeError("no such\nthing")

    monkeypatch.setattr(phc, "pem", broken)
    done = run("fit", recording)
    assert done.status == 3 and "TypeError: no such thing" in done.error and done.error.count("\n") == 1
    with pytest.raises(TypeError, match="no such"):
        run("--traceback", "fit", recording)


@pytest.mark.parametrize(
    "error, status, message",
    [
        (MemoryError(), 2, "not enough memory"),
        (PermissionError(13, "Permission denied", "x.csv"), 2, "x.csv: Permission denied; check"),
        (OSError(5, "Input/output error"), 2, "Input/output error"),
        (RecursionError("deep"), 3, "RecursionError: deep"),
    ],
)
def test_what_goes_wrong_outside_the_program_is_said_in_one_line(recording, monkeypatch, error, status, message):
    def failing(*arguments, **keywords):
        raise error

    monkeypatch.setattr("ph_control.io.measurements.read_table", failing)
    done = run("fit", recording)
    assert done.status == status and message in done.error and done.error.count("\n") == 1


def command(*arguments: str, **settings) -> subprocess.Popen:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = os.environ | {"PYTHONPATH": path} | settings.pop("env", {})
    return subprocess.Popen(
        [sys.executable, "-m", "ph_control", *arguments], env=environment, stderr=subprocess.PIPE, **settings
    )


def test_the_help_comes_without_the_libraries_of_numbers_and_pictures():
    code = "import sys; from ph_control.cli import main; main(['--help']); main(['fit', '--help']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "ph_control.cli.commands.fit" in loaded and not loaded & {"numpy", "scipy", "matplotlib", "control"}


@pytest.mark.slow
def test_a_reader_that_has_gone_is_no_error_to_speak_of(tmp_path):
    model = tmp_path / "model.json"
    phc.save(phc.modes([1.0], [1.0]), model)
    reader, writer = os.pipe()
    os.close(reader)
    process = command("info", str(model), stdout=writer, env={"MPLBACKEND": "no such backend"})
    os.close(writer)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 141 and error == b""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device")
def test_an_output_that_takes_nothing_is_an_error():
    for arguments in (["--help"], ["info", "--num", "1,0", "--den", "1,0,4"]):
        with open("/dev/full", "w") as full:
            process = command(*arguments, stdout=full)
            _, error = process.communicate(timeout=60)
        assert process.returncode == 2
        assert error.decode().startswith("ph-control: standard output cannot be written: No space")
        assert error.count(b"\n") == 1


@pytest.mark.slow
def test_the_interrupt_key_ends_a_process_with_status_130():
    # a process that a shell sent to the background ignores the key, and its children do, too
    code = (
        "import signal, sys; from ph_control.cli import main; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); print('here', flush=True); "
        "sys.exit(main(['fit', '-']))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.readline() == b"here\n"
    # more than a pipe holds: when all is written, it has begun to read, and waits for the rest
    process.stdin.write(b"0,1,2\n" * 40_000)
    process.stdin.flush()
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130 and error.strip() == b"ph-control: interrupted; no file is written in part"


def test_the_entry_point_is_the_function_that_the_installation_calls():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    module, function = re.search(r'^ph-control = "([\w.]+):(\w+)"$', text, re.M).groups()
    assert getattr(importlib.import_module(module), function) is cli.main

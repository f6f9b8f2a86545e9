"""The command line: what it prints, writes and refuses."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ph_control as phc
from ph_control import cli, demo

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def recording(tmp_path):
    """A noisy recording of a chain of two masses, as a file."""
    t, u, y = demo.record(demo.plants()[1], np.random.default_rng(1), samples=600)
    path = tmp_path / "recording.csv"
    np.savetxt(path, np.c_[t, u, y], delimiter=",", header="time,force,speed", comments="", fmt="%.12g")
    return path


def run(capsys, *arguments):
    """Status, standard output and standard error of one call."""
    status = cli.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_fit_prints_the_summary_and_writes_model_and_picture(capsys, recording, tmp_path):
    model, picture = tmp_path / "model.json", tmp_path / "fit.png"
    status, out, err = run(
        capsys, "fit", recording, "--input", "force", "--output", "speed", "--order", "auto",
        "--model", model, "--plot", picture,
    )  # fmt: skip
    assert (status, err) == (0, "")
    assert "Port-Hamiltonian model of 'speed' from 'force': 2 modes" in out
    assert f"Written: {model}, {picture}" in out
    system = phc.load(model)
    assert isinstance(system, phc.PortHamiltonian) and system.input_labels == ["force"]
    assert np.allclose(system.d, [0.6180, 1.6180], atol=2e-3)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_columns_may_be_numbers_and_the_step_given(capsys, recording, tmp_path):
    table = np.loadtxt(recording, delimiter=",", skiprows=1)
    bare = tmp_path / "bare.dat"
    np.savetxt(bare, table[:, 1:])
    status, out, _ = run(capsys, "fit", bare, "--input", 0, "--output", 1, "--dt", 0.1, "--order", 2)
    assert status == 0 and "2 modes" in out


def test_result_and_bode_picture_are_written_on_request(capsys, recording, tmp_path):
    result, bode = tmp_path / "result.json", tmp_path / "bode.svg"
    status, out, _ = run(capsys, "fit", recording, "--order", 2, "--result", result, "--bode", bode)
    assert status == 0 and str(bode) in out
    assert isinstance(phc.load(result), phc.PEMResult)
    assert bode.read_text().lstrip().startswith("<?xml")
    status, shown, _ = run(capsys, "info", result)
    assert status == 0 and shown.strip() == phc.load(result).summary().strip()


def test_info_shows_what_a_model_is(capsys, tmp_path):
    path = tmp_path / "model.json"
    phc.save(phc.ph(phc.modes([1.0, 2.0], [0.5, 0.25]), name="plant"), path)
    status, out, _ = run(capsys, "info", path)
    assert status == 0
    assert "PortHamiltonian plant: 2 degrees of freedom, 4 states, 1 port" in out
    assert "canonical (controllable and observable): yes" in out
    assert re.search(r"2\s+2\s+0\.3183\d+\s+0\.25\s+0\.5", out)


def test_robot_arm_goes_through_without_crash_or_flattery(capsys, tmp_path):
    arm = DATA / "measured" / "robot_arm.dat"
    if not arm.exists():
        pytest.skip("the third-party recordings are not beside the project")
    status, out, err = run(
        capsys, "fit", arm, "--input", 0, "--output", 1, "--dt", 1, "--order", "auto",
        "--model", tmp_path / "arm.json", "--plot", tmp_path / "arm.png",
    )  # fmt: skip
    assert (status, err) == (0, "")
    text = " ".join(out.split())
    assert float(re.search(r"fit +([\d.]+) %", text)[1]) < 90
    assert "constraint r >= 0 is active" in text and "does not describe this record" in text
    assert (tmp_path / "arm.json").exists() and (tmp_path / "arm.png").exists()


@pytest.mark.parametrize("option", ["--model", "--result", "--plot", "--bode"])
def test_existing_files_are_refused_before_the_fit_and_replaced_only_on_request(capsys, recording, tmp_path, option):
    path = tmp_path / ("out.png" if option in ("--plot", "--bode") else "out.json")
    path.write_text("mine")
    status, out, err = run(capsys, "fit", recording, option, path)
    assert (status, out) == (1, "")
    assert f"{path} exists" in err and "--overwrite" in err
    assert path.read_text() == "mine"
    status, _, _ = run(capsys, "fit", recording, option, path, "--order", 1, "--overwrite")
    assert status == 0 and path.read_bytes() != b"mine"


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--input", "torque"], "torque.*force"),
        (["--order", "200"], "order 200 has 800 unknowns"),
        (["--plot", "{tmp}/fit.doc"], "no known picture format.*png"),
        (["--model", "{tmp}/nowhere/model.json"], "its folder does not exist"),
        (["--model", "{tmp}/a.json", "--result", "{tmp}/a.json"], "two of the output files"),
        (["--dt", "-1"], "dt is -1"),
    ],
)
def test_mistakes_end_in_a_message_and_write_nothing(capsys, recording, tmp_path, arguments, message):
    before = set(tmp_path.iterdir())
    filled = [argument.format(tmp=tmp_path) for argument in arguments]
    status, out, err = run(capsys, "fit", recording, *filled)
    assert (status, out) == (1, "")
    assert err.startswith("ph-control: ") and re.search(message, err, re.S)
    assert set(tmp_path.iterdir()) == before


def test_missing_and_damaged_files_are_said_to_be_so(capsys, tmp_path):
    status, _, err = run(capsys, "fit", tmp_path / "absent.csv")
    assert status == 1 and "absent.csv" in err
    broken = tmp_path / "broken.json"
    broken.write_text("{")
    status, _, err = run(capsys, "info", broken)
    assert status == 1 and "broken.json" in err and "Traceback" not in err


@pytest.mark.parametrize(
    "arguments", [[], ["fly"], ["fit"], ["fit", "x", "--order", "many"], ["fit", "x", "--method", "rk4"]]
)
def test_wrong_usage_ends_with_status_2(capsys, arguments):
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 2
    assert "usage: ph-control" in capsys.readouterr().err


def test_demo_leaves_recordings_models_and_pictures_and_finds_the_truth(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, "demo")
    assert (status, err) == (0, "")
    folder = tmp_path / "ph_control_demo"
    names = {f"{plant}{end}" for plant in ("circuit", "chain") for end in (".csv", ".json", "_fit.png", "_bode.png")}
    assert {path.name for path in folder.iterdir()} == names
    assert "1 of 1 visible modes found" in out and "2 of 2 visible modes found" in out
    assert np.allclose(phc.load(folder / "circuit.json").d, [1.0], rtol=1e-3)
    assert np.allclose(phc.load(folder / "chain.json").d, [0.6180339887, 1.6180339887], rtol=1e-3)
    # a second run finds a free folder; a folder with something in it is refused
    status, out, _ = run(capsys, "demo", "--seed", 1)
    assert status == 0 and (tmp_path / "ph_control_demo-2" / "chain.json").exists()
    status, _, err = run(capsys, "demo", "--folder", folder)
    assert status == 1 and "not an empty folder" in err


def test_demo_recording_can_be_fitted_by_the_command_it_suggests(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, out, _ = run(capsys, "demo", "--folder", "here")
    command = re.search(r"Next: ph-control (.*)", out)[1].split()
    status, _, _ = run(capsys, *command)
    assert status == 0 and (tmp_path / "my_model.json").exists()


def test_progress_is_shown_on_a_terminal_only(capsys, recording, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    _, _, err = run(capsys, "fit", recording, "--order", 2)
    assert "order 2 of at most 2, iteration" in err and err.endswith("\r\033[K")


def test_module_runs_as_a_script():
    done = subprocess.run(
        [sys.executable, "-m", "ph_control.cli", "--help"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and "demo" in done.stdout


def test_a_recording_is_never_overwritten_by_what_is_made_of_it(capsys, recording):
    before = recording.read_bytes()
    status, _, err = run(capsys, "fit", recording, "--model", recording, "--overwrite")
    assert status == 1 and "is the recording itself" in err
    assert recording.read_bytes() == before


def test_what_is_no_regular_file_is_refused(capsys, recording, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    status, _, err = run(capsys, "fit", recording, "--model", tmp_path / "pipe", "--overwrite")
    assert status == 1 and "not a regular file" in err


def test_layout_of_the_table_can_be_said(capsys, recording, tmp_path):
    table = np.loadtxt(recording, delimiter=",", skiprows=1)
    odd = tmp_path / "odd.txt"
    odd.write_text("\n".join("|".join(f"{x:.10g}" for x in row) for row in table))
    status, out, err = run(
        capsys, "fit", odd, "--delimiter", "|", "--no-header", "--time", 0, "--input", 1, "--output", 2, "--order", 2
    )
    assert (status, err) == (0, "") and "2 modes" in out


def test_version_is_told(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["--version"])
    assert stop.value.code == 0 and capsys.readouterr().out.startswith("ph-control ")

"""What the helps and the page of the command line show is what happens when it is typed."""

from __future__ import annotations

import doctest
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from shell import Shell, run, without_pictures
from slow import slowly

import ph_control as phc
from ph_control import cli

PAGE = Path(__file__).resolve().parents[1] / "docs" / "command_line.md"
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def write_shaker(path: Path) -> None:
    """A frequency response such as an analyser exports, rounded."""
    f = np.concatenate([0.02 + 0.04 * np.arange(9), [0.4, 0.7, 1.0]])
    response = phc.frenkel_kontorova(2).modes.freqresp(2 * np.pi * f)
    rows = zip(f, 20 * np.log10(np.abs(response)), np.degrees(np.angle(response)), strict=True)
    # the phase of an analyser is never exact
    noise = np.tile([0.4, -0.5, 0.2], 4)
    lines = [f"{x:.2f},{gain:.1f},{phase + e:.1f}" for (x, gain, phase), e in zip(rows, noise, strict=True)]
    path.write_text("\n".join(["f [Hz],gain [dB],phase [deg]", *lines]) + "\n")


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A shell in a folder with the files that the examples of the helps name."""
    folder = tmp_path_factory.mktemp("workshop")
    plant, rng, t = phc.frenkel_kontorova(2, name="plant"), np.random.default_rng(0), 0.1 * np.arange(600)
    for name in ("recording", "fresh", "first", "second"):
        u = rng.standard_normal(600)
        y = phc.forced_response(plant, t, u, intersample="zoh").outputs + 0.02 * rng.standard_normal(600)
        np.savetxt(folder / f"{name}.csv", np.c_[t, u, y], delimiter=",", header="time,force,velocity", comments="")
    decay = phc.initial_response(plant, t, [1.0, 0.0, 0.0, -0.5]).outputs
    np.savetxt(folder / "decay.csv", np.c_[t, decay], delimiter=",", header="time,displacement", comments="")
    write_shaker(folder / "shaker.csv")
    scipy.io.savemat(folder / "plant.mat", {"A": plant.A, "B": plant.B, "C": plant.C, "D": plant.D})
    result = phc.pem(phc.read_csv(folder / "recording.csv"), 2)
    result.save(folder / "result.json")
    phc.save(result.system, folder / "fitted.json")
    machine = phc.spring_chain([1.0, 1.0, 1.0], 2.0, ground=[1.0, 0.0, 0.0], c=0.05, port=[0, 1])
    u = rng.standard_normal((2, 600))
    y = phc.forced_response(machine, t, u, intersample="zoh").outputs
    head = "time,u1,u2,y1,y2"
    np.savetxt(folder / "machine.csv", np.vstack([t, u, y]).T, delimiter=",", header=head, comments="")
    phc.save(machine, folder / "machine.json")
    return Shell(folder)


def examples(text: str) -> list[str]:
    """Lines of examples at the end of a help."""
    return re.findall(r"^  ((?:cat .*)?ph-control .*)$", text.split("\nexamples:\n")[1], flags=re.M)


def every_example() -> list[str]:
    return [line for name in ("", *cli.COMMANDS) for line in examples(run(*[name] * bool(name), "--help").out)]


def test_every_command_and_every_kind_of_picture_has_an_example():
    lines = every_example()
    for name in cli.COMMANDS:
        assert sum(f"ph-control {name}" in line for line in lines) >= 3, name
    kinds = {found[1] for line in lines if (found := re.search(r"ph-control plot (\w+)", line))}
    assert kinds == {"bode", "step", "impulse", "modes", "poles", "energy", "fit"}


def but_costly_ones(lines: list[str]) -> list[Any]:
    """Without what other tests run each time: the demonstration, and many recordings in other processes."""
    slow = [line for line in lines if line.startswith("ph-control demo") or "--workers" in line]
    return [line for line in lines if line not in slow] + slowly(*slow)


@pytest.mark.variants
@pytest.mark.parametrize("line", but_costly_ones(list(dict.fromkeys(every_example()))))
def test_an_example_of_a_help_works_as_it_stands(workshop, line, monkeypatch):
    if line.startswith("ph-control demo"):  # which are drawn in the tests of the command
        without_pictures(monkeypatch)
    targets = re.findall(r"(?:--out|--plot|--model|--bode|--result|>) ([\w.]+)", line)
    if "ph-control convert" in line and not line.startswith("cat") and " - " not in line:
        targets += re.findall(r"[\w]+\.(?:json|mat|txt|csv)", line)[-1:]
    kept = {"fitted.json": (workshop.folder / "fitted.json").read_bytes()}
    for target in targets:
        (workshop.folder / target).unlink(missing_ok=True)
    done = workshop.line(line)
    assert (done.status, done.error) == (0, ""), done.error
    for target in targets:
        assert (workshop.folder / target).stat().st_size > 0, target
    for name, content in kept.items():
        (workshop.folder / name).write_bytes(content)


# --- the page --------------------------------------------------------------------------------------------------------


def sessions() -> list[tuple[str, str]]:
    """Lines that are typed on the page, and what is printed."""
    blocks = re.findall(r"^```console\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S)
    found = [re.split(r"^\$ (.*)\n", block, flags=re.M)[1:] for block in blocks]
    return [pair for block in found for pair in zip(block[::2], block[1::2], strict=True)]


def test_the_page_prints_what_its_lines_print(tmp_path, monkeypatch):
    without_pictures(monkeypatch)
    monkeypatch.setattr(phc.PEMResult, "report", lambda self, path, **options: Path(path).touch())  # has its own tests
    shell = Shell(tmp_path)
    write_shaker(tmp_path / "shaker.csv")
    checker = doctest.OutputChecker()
    typed = sessions()
    assert len(typed) > 20
    for line, expected in typed:
        done = shell.line(line)
        # a line that is refused prints on standard error
        printed = done.out or done.error
        assert checker.check_output(expected, printed, FLAGS), f"$ {line}\n{printed}\nexpected\n{expected}"


def test_the_page_tells_every_command_and_status():
    text = PAGE.read_text(encoding="utf-8")
    for name in cli.COMMANDS:
        assert f"| `{name}` |" in text
    statuses = set(map(int, re.findall(r"^\| (\d+) \|", text, flags=re.M)))
    outcome = cli.outcome
    assert statuses == {
        outcome.DONE, outcome.NO, outcome.BAD, outcome.BROKEN, outcome.INTERRUPTED, outcome.UNREAD
    }  # fmt: skip


def test_the_page_tells_the_keys_of_every_answer(workshop, monkeypatch):
    without_pictures(monkeypatch)
    demonstrated = cli.commands.demo.plants()[-1:]  # the keys are those of every plant
    monkeypatch.setattr(cli.commands.demo, "plants", lambda: demonstrated)
    text = PAGE.read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([\w-]+)` \| (`(?:verdict|source|output|kind|folder|rows).*) \|$", text, flags=re.M))
    assert set(rows) == set(cli.COMMANDS)
    lines = {
        "fit": "ph-control fit recording.csv --order 2 --json",
        "fit-many": "ph-control fit-many recording.csv --order 2 --json",
        "info": "ph-control info plant.mat --json",
        "convert": "ph-control convert plant.mat keys.json --json --overwrite",
        "reduce": "ph-control reduce plant.mat keys.json --order 2 --json --overwrite",
        "netlist": "ph-control netlist plant.mat keys.cir --json",
        "compare": "ph-control compare fresh.csv fitted.json --json",
        "plot": "ph-control plot poles plant.mat --out keys.png --json --overwrite",
        "demo": "ph-control demo --folder keys --json",
    }
    lossy = {"natural_frequencies", "damping_ratios", "sensors"}  # of a system with losses, which plant.mat is not
    for name, line in lines.items():
        answer = json.loads(workshop.line(line).out)
        told = set(re.findall(r"`(\w+)`", rows[name]))
        if name == "info":  # what it says of losses instead
            answer |= json.loads(workshop.line("ph-control info --num 1,0 --den 1,0.2,4 --json").out)
        inner = {"models", "plants", "rows"}
        nested = {key for part in inner & set(answer) for one in answer[part] if isinstance(one, dict) for key in one}
        assert told - {"models", "fit"} <= set(answer) | nested | (lossy if name == "info" else set()), name
        assert answer["command"] == name

"""What the README says works when it is done word for word."""

from __future__ import annotations

import doctest
import re
import shlex
import subprocess
from pathlib import Path

import pytest
from scripts import ROOT, run
from shell import run as shell
from shell import without_pictures

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """Code blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.M | re.S)


@pytest.fixture(scope="module")
def after_python(tmp_path_factory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Folder in which all Python blocks have run as one script, and how that went."""
    folder = tmp_path_factory.mktemp("readme")
    script = folder / "script.py"
    script.write_text("\n".join(blocks("python")), encoding="utf-8")
    return folder, run(folder, str(script))


def test_the_first_two_shell_blocks_are_one_line_each():
    first, second = blocks("sh")[:2]
    assert first.count("\n") == second.count("\n") == 1
    assert first.startswith("python3 -m venv .venv && ") and first.rstrip().endswith(".venv/bin/ph-control demo")
    assert second.startswith("python3 -m venv .venv && ") and " && .venv/bin/python -m pytest " in second


def test_the_first_plant_is_identified_as_the_readme_shows():
    first = blocks("pycon")[0]
    example = doctest.DocTestParser().get_doctest(first, {}, "README", None, None)
    assert len(example.examples) >= 7
    assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example).failed == 0


def test_the_python_code_runs_and_leaves_what_it_says(after_python):
    folder, done = after_python
    assert done.returncode == 0, done.stderr
    assert "3 modes" in done.stdout
    assert {"recording.csv", "fit.json", "fit.html", "response.png"} <= {path.name for path in folder.iterdir()}


def test_the_python_code_prints_what_the_readme_shows(after_python):
    """Word for word, and numbers to what depends on the processor."""
    _, done = after_python
    (shown,) = blocks("text")
    number = r"-?\d+\.?\d*(?:e-?\d+)?"
    assert re.sub(number, "#", done.stdout).split() == re.sub(number, "#", shown).split()
    printed, promised = ([float(x) for x in re.findall(number, text)] for text in (done.stdout, shown))
    assert printed == pytest.approx(promised, rel=1e-4)


def test_the_fit_on_the_command_line_runs_in_the_folder_that_the_python_code_left(after_python, monkeypatch):
    folder, done = after_python
    assert done.returncode == 0, done.stderr
    (command,) = [
        shlex.split(line) for block in blocks("sh") for line in block.splitlines() if "ph-control fit" in line
    ]
    assert command[0].endswith("ph-control")
    monkeypatch.chdir(folder)
    without_pictures(monkeypatch)
    fit = shell(*command[1:])
    assert fit.status == 0, fit.error
    assert "3 modes" in fit.out
    made = {command[command.index(option) + 1] for option in ("--model", "--plot")}
    assert made <= {path.name for path in folder.iterdir()}


def test_every_path_that_the_readme_refers_to_exists():
    targets = re.findall(r"\]\(([^)\s]+)\)", README)
    local = [target.split("#")[0] for target in targets if not target.startswith("http")]
    assert "docs/plants.png" in local
    assert [target for target in local if not (ROOT / target).exists()] == []

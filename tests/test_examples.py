"""Every example runs as it stands, and the pictures of the documentation are made by the examples."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from scripts import ROOT, run, run_script
from slow import slowly

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
# the gallery of the documentation runs all of them
QUICK = {"hammer_to_damper", "lc_circuit", "tuned_absorber"}


def shown() -> set[str]:
    """Names of the pictures that the documentation shows."""
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    return {Path(target).name for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+)\)", text)}


def named(script: Path) -> set[str]:
    """Names of pictures in the source of an example."""
    return set(re.findall(r"\"([^\"/]+\.png)\"", script.read_text(encoding="utf-8")))


def test_there_are_examples():
    assert EXAMPLES


def test_quick_examples_exist():
    assert {script.stem for script in EXAMPLES} > QUICK


@pytest.mark.parametrize(
    "script",
    [
        *(script for script in EXAMPLES if script.stem in QUICK),
        *slowly(*(script for script in EXAMPLES if script.stem not in QUICK)),
    ],
    ids=lambda script: script.stem,
)
def test_an_example_runs_in_an_empty_folder(script, tmp_path):
    """It writes the pictures that it names into the folder it runs in."""
    done = run_script(tmp_path, script)
    assert done.returncode == 0, done.stderr
    assert named(script) == {path.name for path in tmp_path.rglob("*.png")}


def test_every_picture_of_the_documentation_is_made_by_an_example():
    """Some example names it; that an example makes what it names is held where it runs."""
    made = set().union(*map(named, EXAMPLES))
    assert shown(), "the documentation shows no picture"
    # those of measured times and of measured data come from runs of the benchmarks, which no test repeats
    report, data = ((ROOT / "benchmarks" / name).read_text(encoding="utf-8") for name in ("report.py", "measured.py"))
    kinds = ("performance_", "measured_")
    measured = {name for name in shown() if name.startswith(kinds) and (ROOT / "docs" / name).exists()}
    assert not measured or 'f"performance_{family}.png"' in report
    assert all(f'"{name}"' in data for name in measured if name.startswith("measured_"))
    drawn = {"architecture.svg"}  # by docs/architecture.py, from the folders
    assert shown() - measured - drawn <= made, f"no example writes {sorted(shown() - measured - made)}"


@pytest.mark.parametrize(
    "source, works",
    [
        ("import warnings; warnings.warn('look')", False),
        ("import matplotlib; assert matplotlib.get_backend().lower() == 'agg'", True),
        ("import ph_control", True),
    ],
)
def test_scripts_run_with_the_package_and_without_a_display_and_no_warning_passes(tmp_path, source, works):
    assert (run(tmp_path, "-c", source).returncode == 0) == works


@pytest.mark.parametrize(
    "source, works",
    [
        ("import warnings; warnings.warn('look')", False),
        ("assert __name__ == '__main__'; import matplotlib; assert matplotlib.get_backend().lower() == 'agg'", True),
        ("import sys; sys.exit(3)", False),
        ("raise ValueError('no')", False),
    ],
)
def test_a_script_runs_as_the_main_program_and_no_warning_passes(tmp_path, source, works):
    script = tmp_path / "script.py"
    script.write_text(source)
    done = run_script(tmp_path, script)
    assert (done.returncode == 0) == works
    assert ("look" in done.stderr) == ("look" in source) and ("ValueError: no" in done.stderr) == ("raise" in source)

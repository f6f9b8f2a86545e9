"""Every example runs as it stands, and the pictures of the documentation are made by the examples."""

from __future__ import annotations

import functools
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from scripts import ROOT, run

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

# in one process: each example runs once for all tests
pytestmark = pytest.mark.xdist_group("examples")

Finished = tuple[subprocess.CompletedProcess[str], Path]


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Callable[[Path], Finished]:
    """Run an example in a folder of its own, once for all tests."""

    @functools.cache
    def once(script: Path) -> Finished:
        folder = tmp_path_factory.mktemp(script.stem)
        return run(folder, str(script)), folder

    return once


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_an_example_runs_in_an_empty_folder(script, finished):
    done, _ = finished(script)
    assert done.returncode == 0, done.stderr


def test_every_picture_of_the_documentation_is_made_by_an_example(finished):
    """An example writes its pictures into the folder it runs in, under the names that the documentation uses."""
    made = {path.name for script in EXAMPLES for path in finished(script)[1].rglob("*.png")}
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    shown = {Path(target).name for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+)\)", text)}
    assert shown, "the documentation shows no picture"
    # those of measured times and of measured data come from runs of the benchmarks, which no test repeats
    report, data = ((ROOT / "benchmarks" / name).read_text(encoding="utf-8") for name in ("report.py", "measured.py"))
    kinds = ("performance_", "measured_")
    measured = {name for name in shown if name.startswith(kinds) and (ROOT / "docs" / name).exists()}
    assert not measured or 'f"performance_{family}.png"' in report
    assert all(f'"{name}"' in data for name in measured if name.startswith("measured_"))
    drawn = {"architecture.svg"}  # by docs/architecture.py, from the folders
    assert shown - measured - drawn <= made, f"no example writes {sorted(shown - measured - made)}"


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

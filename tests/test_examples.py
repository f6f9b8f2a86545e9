"""Every example runs as it stands, and the pictures of the documentation are made by the examples."""

from __future__ import annotations

import functools
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

Finished = tuple[subprocess.CompletedProcess[str], Path]


def run(script: Path, folder: Path) -> Finished:
    """Run a script in a folder, without a display, every warning an error."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script)], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
        capture_output=True, text=True,
    )  # fmt: skip
    return done, folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Callable[[Path], Finished]:
    """Run an example in a folder of its own, once for all tests."""
    return functools.cache(lambda script: run(script, tmp_path_factory.mktemp(script.stem)))


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
    assert shown <= made, f"no example writes {sorted(shown - made)}"


def test_a_warning_in_an_example_is_an_error(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("import warnings\nwarnings.warn('look')\n", encoding="utf-8")
    assert run(script, tmp_path)[0].returncode != 0
    script.write_text("import matplotlib\nassert matplotlib.get_backend().lower() == 'agg'\n", encoding="utf-8")
    assert run(script, tmp_path)[0].returncode == 0

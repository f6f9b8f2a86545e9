"""Run Python as a user would, in a process and a folder of its own."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import subprocess
import sys
import warnings
from pathlib import Path

import matplotlib

ROOT = Path(__file__).resolve().parents[1]


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder with this package, without a display, every warning an error."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    # pyparsing, which matplotlib uses, takes -W error alone as a wish for diagnostics of grammars
    return subprocess.run(
        [sys.executable, "-W", "error", "-W", "ignore:::pyparsing", *arguments], cwd=folder,
        env=os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": path}, stdin=subprocess.DEVNULL, capture_output=True,
        text=True,
    )  # fmt: skip


def run_script(folder: Path, script: Path) -> subprocess.CompletedProcess[str]:
    """Run a script in a folder as `run` does; where processes can fork, from one that has loaded what scripts use."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return run(folder, str(script))
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["ph_control", "control", "matplotlib.pyplot", "scipy.signal", "scipy.optimize"])
    said = folder.with_name(folder.name + "_said.txt")
    process = context.Process(target=_as_main, args=(str(folder), str(script), str(said)))
    process.start()
    process.join()
    return subprocess.CompletedProcess([str(script)], process.exitcode or 0, "", said.read_text(encoding="utf-8"))


def _as_main(folder: str, script: str, said: str) -> None:
    """Run a script as the main program, every warning an error; what it says goes to a file."""
    with open(said, "w", encoding="utf-8") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    sys.argv = [script]
    os.chdir(folder)
    matplotlib.use("Agg")
    warnings.simplefilter("error")
    warnings.filterwarnings("ignore", module="pyparsing")
    runpy.run_path(script, run_name="__main__")

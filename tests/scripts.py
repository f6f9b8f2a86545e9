"""Run Python as a user would, in a process and a folder of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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

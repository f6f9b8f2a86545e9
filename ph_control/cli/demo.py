"""`ph-control demo`: known plants, recorded, identified and compared with the truth."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from ..exceptions import OutputExistsError
from .answers import emit_json, fit_of, modes_of
from .options import Parser, add_json, seed
from .outcome import DONE, emit

USAGE = "[options]"

DESCRIPTION = """Record two known plants with noise, a circuit and a chain of masses, identify models and compare them
with the truth. Recordings (CSV), models (JSON) and pictures (PNG) are left in a folder."""

EXAMPLES = """
  ph-control demo
  ph-control demo --folder trial --seed 7
  ph-control demo --json
"""


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("--folder", type=Path, help="new or empty folder for what it makes (default: a new one here)")
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of input and noise (default 0)")
    add_json(parser)


def run(options: Namespace) -> int:
    """Make the folder, and run."""
    from . import demonstration as demo

    folder = options.folder or _new_folder(Path("ph_control_demo"))
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputExistsError(f"{folder} exists and is not an empty folder; name another one, or leave --folder out")
    folder.mkdir(parents=True, exist_ok=True)
    found = demo.run(folder, options.seed, _silent if options.json else _line)
    if options.json:
        plants = [
            {"plant": plant.name, "true": modes_of(plant.system.modes.minimal()), "fit": fit_of(result)}
            for plant, result in found
        ]
        emit_json({"command": "demo", "folder": str(folder), "seed": options.seed, "plants": plants})
        return DONE
    _line(f"All of it is in {folder.resolve()}")
    _line(f"Next: ph-control fit {folder / 'chain.csv'} --model my_model.json --plot my_fit.png")
    return DONE


def _line(text: str) -> None:
    emit(text + "\n")


def _silent(text: str) -> Any:
    return text


def _new_folder(wanted: Path) -> Path:
    candidate, number = wanted, 1
    while candidate.exists():
        number += 1
        candidate = wanted.with_name(f"{wanted.name}-{number}")
    return candidate

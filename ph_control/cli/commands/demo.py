"""Record two known plants with noise, a circuit and a chain of masses, and identify them.

The models are compared with the truth. Recordings (CSV), models (JSON) and pictures (PNG) are left in a folder.

Examples
--------
  ph-control demo
  ph-control demo --folder trial --seed 7
  ph-control demo --json
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import ph_control as phc

from ...exceptions import OutputExistsError
from ..options import Parser, add_json, within
from ..outcome import DONE, emit
from ..outputs import emit_json, fit_of, modes_of

USAGE = "[options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("--folder", type=Path, help="new or empty folder for what it makes (default: a new one here)")
    parser.add_argument(
        "--seed", type=within(int, 0, inf), default=0, metavar="N", help="seed of input and noise (default 0)"
    )
    add_json(parser)


@dataclass(frozen=True)
class Plant:
    """A known plant, the state its recording starts from, and what its signals are."""

    title: str
    system: phc.PortHamiltonian
    initial_state: Any
    output_unit: str

    @property
    def name(self) -> str:
        """Name of the plant and of its files."""
        return str(self.system.name)


def plants() -> list[Plant]:
    """Return the two systems of the paper: a five-branch LC circuit and a chain of two masses."""
    import numpy as np

    circuit = phc.lc_circuit(np.ones(5), np.ones(5), name="circuit")
    chain = phc.frenkel_kontorova(2, name="chain")
    return [
        Plant("LC circuit, five equal branches (one visible mode)", circuit, np.linspace(-1.0, 1.0, 10), "A"),
        Plant("Chain of two masses", chain, np.array([2.0, 1.0, -3.0, -3.0]), "m/s"),
    ]


def record(plant: Plant, rng: Any, samples: int = 2000, step: float = 0.1) -> tuple[Any, Any, Any]:
    """Time, input and noisy output: white input held between samples, noise 20 dB below the output."""
    import numpy as np

    t = step * np.arange(samples)
    u = rng.standard_normal(samples)
    y = phc.forced_response(plant.system, t, u, plant.initial_state, return_states=False, intersample="zoh").outputs
    return t, u, y + 0.1 * np.std(y) * rng.standard_normal(samples)


def run(options: Namespace) -> int:
    """Record, identify, compare and save, into a new or empty folder."""
    import numpy as np

    folder = options.folder or _new_folder(Path("ph_control_demo"))
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputExistsError(f"{folder} exists and is not an empty folder; name another one, or leave --folder out")
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for plant, rng in zip(plants(), np.random.default_rng(options.seed).spawn(2), strict=True):
        table, recording = np.column_stack(record(plant, rng)), folder / f"{plant.name}.csv"
        header = ",".join(["time [s]", *plant.system.input_labels, *plant.system.output_labels])
        np.savetxt(recording, table, delimiter=",", header=header, comments="", fmt="%.12g")
        result = phc.pem(phc.read_csv(recording))
        phc.save(result.system, folder / f"{plant.name}.json")
        _draw(plant, result, folder)
        if not options.json:
            files = f"   {plant.name}.csv, {plant.name}.json, {plant.name}_fit.png, {plant.name}_bode.png"
            emit("\n".join([f"== {plant.title}", *_against_truth(plant, result), files, "", ""]))
        truth = modes_of(plant.system.modes.minimal())
        found.append({"plant": plant.name, "true": truth, "fit": fit_of(result)})
    if options.json:
        emit_json({"command": "demo", "folder": str(folder), "seed": options.seed, "plants": found})
    else:
        emit(f"All of it is in {folder.resolve()}\n")
        emit(f"Next: ph-control fit {folder / 'chain.csv'} --model my_model.json --plot my_fit.png\n")
    return DONE


def _new_folder(wanted: Path) -> Path:
    candidate, number = wanted, 1
    while candidate.exists():
        number += 1
        candidate = wanted.with_name(f"{wanted.name}-{number}")
    return candidate


def _against_truth(plant: Plant, result: phc.PEMResult) -> Iterator[str]:
    truth = plant.system.modes.minimal()
    yield f"   fit {result.fit_percent:.2f} %, {result.order} of {truth.n} visible modes found. {result.message}"
    if result.order != truth.n:
        return
    yield "   mode   d true       d found      +-         r true       r found      +-"
    rows = zip(truth.d, result.d, result.stderr["d"], truth.r, result.r, result.stderr["r"], strict=True)
    for number, (d, d_found, d_error, r, r_found, r_error) in enumerate(rows, 1):
        yield (
            f"   {number:4d}   {d:<11.8g}  {d_found:<11.8g}  {d_error:<9.1g}  "
            f"{r:<11.8g}  {r_found:<11.8g}  {r_error:<.1g}"
        )


def _draw(plant: Plant, result: phc.PEMResult, folder: Path) -> None:
    import matplotlib.pyplot as plt

    response = result.record.as_response()
    pictures = {
        "fit": result.plot(output_label=plant.system.output_labels[0], output_unit=plant.output_unit),
        "bode": phc.bode_plot([result.system, plant.system], data=response, label=["identified", "true"]),
    }
    for name, picture in pictures.items():
        picture.figure.savefig(folder / f"{plant.name}_{name}.png", dpi=120)
        plt.close(picture.figure)

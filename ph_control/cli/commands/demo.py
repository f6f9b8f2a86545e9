"""Simulate noisy recordings of three known plants, identify them, and compare the models with the truth.

The plants are a damped structure with two shakers and the two systems of the paper. Recordings (CSV), models (JSON),
plots (PNG) and a report (HTML) are written to a folder.

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

from ..._display import aligned
from ...exceptions import OutputExistsError
from ..options import Parser, add_json, within
from ..outcome import DONE, emit
from ..outputs import emit_json, fit_of, modes_of

USAGE = "[options]"


def add_options(parser: Parser) -> None:
    """Declare the options."""
    parser.add_argument("--folder", type=Path, help="new or empty folder for the output (default: a new folder here)")
    parser.add_argument(
        "--seed", type=within(int, 0, inf), default=0, metavar="N", help="seed of input and noise (default 0)"
    )
    add_json(parser)


@dataclass(frozen=True)
class Plant:
    """A known plant, the state its recording starts from, the step, and the units of its inputs and outputs."""

    title: str
    system: phc.PortHamiltonian
    initial_state: Any
    step: float
    units: tuple[str, str]

    @property
    def name(self) -> str:
        """Name of the plant and of its files."""
        return str(self.system.name)

    @property
    def labels(self) -> tuple[list[str], list[str]]:
        """Inputs and outputs with their units."""
        sides = self.system.input_labels, self.system.output_labels
        inputs, outputs = ([f"{name} [{unit}]" for name in side] for side, unit in zip(sides, self.units, strict=True))
        return inputs, outputs


def plants() -> list[Plant]:
    """Return a damped tower with two ports and a sensor, and the LC circuit and the chain of masses of the paper."""
    import numpy as np

    mass, between, ground = [300.0, 200.0, 100.0], np.array([[2, -1, 0], [-1, 2, -1], [0, -1, 1]]), np.diag([1, 0, 0])
    tower = phc.from_second_order(
        np.diag(mass), 4e5 * between + 2e5 * ground, np.eye(3)[:, [0, 2]], C=150.0 * between - 50.0 * ground,
        sensors={"velocity": np.eye(3)[1]}, inputs=["force_low", "force_top"], outputs=["low", "top", "middle"],
        name="structure",
    )  # fmt: skip
    circuit = phc.lc_circuit(np.ones(5), np.ones(5), name="circuit")
    chain = phc.frenkel_kontorova(2, name="chain")
    amperes = np.linspace(-1.0, 1.0, 10)
    return [
        Plant("Damped tower, two shakers", tower, np.zeros(6), 0.01, ("N", "m/s")),
        Plant("LC circuit, five equal branches (one visible mode)", circuit, amperes, 0.1, ("V", "A")),
        Plant("Chain of two masses", chain, np.array([2.0, 1.0, -3.0, -3.0]), 0.1, ("N", "m/s")),
    ]


def record(plant: Plant, rng: Any, samples: int = 2000) -> Any:
    """Columns of time, inputs and noisy outputs: white inputs held between samples, noise 20 dB below each output."""
    import numpy as np

    t, u = plant.step * np.arange(samples), rng.standard_normal((plant.system.ninputs, samples))
    run = phc.forced_response(plant.system, t, u, plant.initial_state, return_states=False, intersample="zoh")
    y = run.outputs.reshape(-1, samples)
    return np.column_stack([t, *u, *(y + 0.1 * np.std(y, axis=1, keepdims=True) * rng.standard_normal(y.shape))])


def run(options: Namespace) -> int:
    """Record, identify, compare and save, into a new or empty folder."""
    import numpy as np

    folder = options.folder or _new_folder(Path("ph_control_demo"))
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputExistsError(f"{folder} exists and is not an empty folder; name another one, or leave --folder out")
    folder.mkdir(parents=True, exist_ok=True)
    reports, known = [], plants()
    for plant, rng in zip(known, np.random.default_rng(options.seed).spawn(len(known)), strict=True):
        recording, (inputs, outputs) = folder / f"{plant.name}.csv", plant.labels
        header = ",".join(["time [s]", *inputs, *outputs])
        np.savetxt(recording, record(plant, rng), delimiter=",", header=header, comments="", fmt="%.12g")
        several = len(inputs) > 1
        columns: dict[str, Any] = {"input": inputs, "output": outputs} if several else {}
        ports: dict[str, Any] = {"ports": list(zip(outputs, inputs, strict=False))} if several else {}
        result = phc.pem(phc.read_csv(recording, **columns), **ports)
        phc.save(result.system, folder / f"{plant.name}.json")
        if several:
            result.report(folder / f"{plant.name}.html", title=plant.title)
        else:
            _draw(plant, result, folder)
        if not options.json:
            made = (".csv", ".json", ".html") if several else (".csv", ".json", "_bode.png")
            files = "   " + ", ".join(plant.name + end for end in made)
            emit("\n".join([f"== {plant.title}", *_against_truth(plant, result), files, "", ""]))
        reports.append({"plant": plant.name, "true": _truth(plant), "fit": fit_of(result)})
    if options.json:
        emit_json({"command": "demo", "folder": str(folder), "seed": options.seed, "plants": reports})
    else:
        emit(f"Everything is in {folder.resolve()}; structure.html opens in a browser.\n")
        emit(f"Next: ph-control fit {folder / 'chain.csv'} --model my_model.json --plot my_fit.png\n")
    return DONE


def _new_folder(wanted: Path) -> Path:
    candidate, number = wanted, 1
    while candidate.exists():
        number += 1
        candidate = wanted.with_name(f"{wanted.name}-{number}")
    return candidate


def _truth(plant: Plant) -> dict[str, Any]:
    """Modes that the ports of a plant show."""
    if plant.system.is_lossless:
        return modes_of(plant.system.modes.minimal())
    return {
        name: getattr(plant.system, name) for name in ("natural_frequencies", "hertz", "damping_ratios")
    }  # fmt: skip


def _against_truth(plant: Plant, result: phc.PEMResult) -> Iterator[str]:
    lossless, true = plant.system.is_lossless, _truth(plant)
    n = len(true["d"] if lossless else true["hertz"])
    said = result.message if lossless else f"Structure {result.structure}, {result.verdict}."
    yield f"   fit {result.fit_percent:.2f} %, {result.order} of {n} visible modes found. {said}"
    if result.order != n:
        return
    columns = [("d", "d [rad/s]"), ("r", "r")] if lossless else [("hertz", "f [Hz]"), ("damping_ratios", "damping [%]")]
    rows = [["mode"]] + [[str(number)] for number in range(1, n + 1)]
    for name, title in columns:
        size = 100.0 if name == "damping_ratios" else 1.0
        rows[0] += [f"{title} true", "found", "+-"]
        for row, *values in zip(rows[1:], true[name], getattr(result, name), result.stderr[name], strict=True):
            row += [f"{size * value:.{digits}g}" for value, digits in zip(values, (7, 7, 1), strict=True)]
    yield from (f"   {line}" for line in aligned(rows))


def _draw(plant: Plant, result: phc.PEMResult, folder: Path) -> None:
    import matplotlib.pyplot as plt

    record: Any = result.record
    names = ["identified", "true"]
    picture = phc.bode_plot([result.system, plant.system], data=record.as_response(), label=names)
    picture.figure.savefig(folder / f"{plant.name}_bode.png", dpi=120)
    plt.close(picture.figure)

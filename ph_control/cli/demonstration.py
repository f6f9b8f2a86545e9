"""The demonstration: recordings of two known plants, identified and compared with the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from .._units import with_unit
from ..analysis.time_response import forced_response
from ..identification.fit.pem import pem
from ..identification.fit.result import PEMResult
from ..io.codecs import save
from ..plotting.bode_plot import bode_plot
from ..systems.models import frenkel_kontorova, lc_circuit
from ..systems.port_hamiltonian import PortHamiltonian

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plant:
    """A known plant, the state its recording starts from, and what its signals are."""

    name: str
    title: str
    system: PortHamiltonian
    initial_state: Array
    output_unit: str


def plants() -> list[Plant]:
    """Return the two systems of the paper: a five-branch LC circuit and a chain of two masses."""
    circuit = lc_circuit(np.ones(5), np.ones(5), name="circuit")
    chain = frenkel_kontorova(2, name="chain")
    return [
        Plant(
            "circuit", "LC circuit, five equal branches (one visible mode)", circuit, np.linspace(-1.0, 1.0, 10), "A"
        ),
        Plant("chain", "Chain of two masses", chain, np.array([2.0, 1.0, -3.0, -3.0]), "m/s"),
    ]


def record(
    plant: Plant, rng: np.random.Generator, samples: int = 2000, step: float = 0.1
) -> tuple[NDArray, NDArray, NDArray]:
    """Time, input and noisy output: white input held between samples, noise 20 dB below the output."""
    t = step * np.arange(samples)
    u = rng.standard_normal(samples)
    y = forced_response(plant.system, t, u, plant.initial_state, return_states=False, intersample="zoh").outputs
    return t, u, y + 0.1 * np.std(y) * rng.standard_normal(samples)


def run(folder: Path, seed: int, report: Callable[[str], Any]) -> list[tuple[Plant, PEMResult]]:
    """Record, identify, compare and save; everything goes into the existing, empty `folder`.

    Parameters
    ----------
    folder : Path
        Where recordings (CSV), models (JSON) and pictures (PNG) are written.
    seed : int
        Seed of the random input and noise.
    report : callable
        Receives the lines to show.

    Returns
    -------
    list of tuple of Plant and PEMResult
        What was recorded, and what was found.
    """
    found = []
    for plant, rng in zip(plants(), np.random.default_rng(seed).spawn(2), strict=True):
        t, u, y = record(plant, rng)
        names = plant.system.input_labels[0], plant.system.output_labels[0]
        table = np.column_stack([t, u, y])
        recording = folder / f"{plant.name}.csv"
        np.savetxt(recording, table, delimiter=",", header=",".join(["time [s]", *names]), comments="", fmt="%.12g")
        data = ct.TimeResponseData(t, y, inputs=u, input_labels=names[:1], output_labels=names[1:])
        result = pem(with_unit(data, "s"))
        report(f"== {plant.title}")
        for line in _against_truth(plant, result):
            report(line)
        save(result.system, folder / f"{plant.name}.json")
        _pictures(plant, result, folder)
        report(f"   {recording.name}, {plant.name}.json, {plant.name}_fit.png, {plant.name}_bode.png")
        report("")
        found.append((plant, result))
    return found


def _against_truth(plant: Plant, result: PEMResult) -> Iterator[str]:
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


def _pictures(plant: Plant, result: PEMResult, folder: Path) -> None:
    import matplotlib.pyplot as plt

    fit = result.plot(output_label=plant.system.output_labels[0], output_unit=plant.output_unit)
    fit.figure.savefig(folder / f"{plant.name}_fit.png", dpi=120)
    bode = bode_plot([result.system, plant.system], data=result.record.as_response(), label=["identified", "true"])
    bode.figure.savefig(folder / f"{plant.name}_bode.png", dpi=120)
    plt.close(fit.figure)
    plt.close(bode.figure)

"""Elements of circuits from their impedance: fits of simulated spectra, and of measured ones beside impedance.py.

python -m benchmarks.impedance [--seeds N] [--folder FOLDER]

The folder has example data of impedance.py: Circuit1_EIS_1.z to Circuit3_EIS_1.z and exampleData.csv.  Each is fitted
by its published circuit with impedance.py too, if that is installed.  Of the battery a line says what the best sum of
real poles with positive elements leaves, by non-negative least squares with 400 time constants.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
from scipy.optimize import nnls

import ph_control as phc

NOISE = 0.005  # of |Z|, standard deviation of the complex error

# elements by the names that `netlist` gives them, between nodes
CIRCUITS: dict[str, tuple[dict[str, tuple[str, float]], Any]] = {
    "R0 + two RC": (
        {"R1": ("1 2", 0.02), "C1": ("2 3", 400.0), "R2": ("2 3", 0.03), "C2": ("3 0", 2.0), "R3": ("3 0", 0.015)},
        np.geomspace(0.005, 1000, 80),
    ),
    "RC + RL + mode": (
        {
            "C1": ("1 2", 1e-4), "R1": ("1 2", 40.0), "R2": ("2 3", 25.0), "L1": ("2 3", 2e-3), "C2": ("3 0", 1e-6),
            "R3": ("3 0", 300.0), "L2": ("3 0", 4e-3),
        },
        np.geomspace(1, 1e5, 100),
    ),
}  # fmt: skip


def spectrum(Z: Any, hertz: Any) -> ct.FrequencyResponseData:
    """Frequency response of an impedance, in seconds."""
    data = ct.frd(np.asarray(Z), 2 * np.pi * np.asarray(hertz))
    data.time_unit = "s"
    return data


def text_of(elements: dict[str, tuple[str, float]], scale: float = 1.0) -> str:
    """Netlist with a current source, values times a number."""
    lines = [f"{name} {nodes} {scale * value!r}" for name, (nodes, value) in elements.items()]
    return "\n".join(["circuit", "I1 0 1", *lines, ".end"])


def simulated(name: str, seed: int) -> ct.FrequencyResponseData:
    """Impedance of a circuit with relative noise."""
    elements, hertz = CIRCUITS[name]
    rng, Z = np.random.default_rng(seed), np.squeeze(phc.read_netlist(text_of(elements))(2j * np.pi * hertz))
    noise = rng.standard_normal(len(hertz)) + 1j * rng.standard_normal(len(hertz))
    return spectrum(Z * (1 + NOISE / np.sqrt(2) * noise), hertz)


def by_default(data: Any, _: Any) -> tuple[Any, dict[str, tuple[float, float]]]:
    """Elements of the default fit."""
    fit = phc.pem(data)
    return fit, {part.name: (part.value, part.stderr) for part in phc.netlist(fit, kind="impedance").elements}


def by_structure(data: Any, _: Any) -> tuple[Any, dict[str, tuple[float, float]]]:
    """Elements of the fit with the structure 'passive'."""
    fit = phc.pem(data, structure="passive")
    return fit, {part.name: (part.value, part.stderr) for part in phc.netlist(fit, kind="impedance").elements}


def by_circuit(data: Any, elements: Any) -> tuple[Any, dict[str, tuple[float, float]]]:
    """Elements as parameters of a given circuit, from 1.5 times their values."""
    circuit = phc.read_netlist(text_of(elements, 1.5), parameters=list(elements))
    fit = phc.pem(data, model=circuit, quantity="free")
    return fit, dict(zip(elements, zip(fit.parameters, fit.stderr["parameters"], strict=True), strict=True))


CALLS: dict[str, Callable[[Any, Any], tuple[Any, dict[str, tuple[float, float]]]]] = {
    "default": by_default, "structure='passive'": by_structure, "model=circuit": by_circuit,
}  # fmt: skip


def coverage(name: str, call: str, seeds: int) -> None:
    """Print one line: whether elements, their errors and passivity are right."""
    elements, _ = CIRCUITS[name]
    z, right, passive, spent = [], 0, 0, 0.0
    for seed in range(seeds):
        data, begin = simulated(name, seed), time.perf_counter()
        try:
            fit, fitted = CALLS[call](data, elements)
        except phc.StructureError:
            continue
        finally:
            spent += time.perf_counter() - begin
        right += set(fitted) == set(elements)
        passive += phc.passivity(fit.system).is_passive
        if set(fitted) >= set(elements):
            z.append([(fitted[key][0] - value) / fitted[key][1] for key, (_, value) in elements.items()])
    each = np.array(z)
    covered = 100 * np.mean(np.abs(each) < 1.96, axis=0)
    print(
        f"| {name} | {call} | {len(each)} | {right} | {passive} | {covered.mean():.1f} ({covered.min():.0f} to "
        f"{covered.max():.0f}) | {np.mean(each**2):.2f} ({np.mean(each**2, axis=0).min():.2f} to "
        f"{np.mean(each**2, axis=0).max():.2f}) | {spent / seeds:.2f} |"
    )


# --- measured spectra ------------------------------------------------------------------------------------------------


def read_zplot(path: Path) -> tuple[Any, Any]:
    """Frequencies in Hz, ascending, and impedance of a file of ZPlot."""
    lines = path.read_text(encoding="latin-1").splitlines()
    begin = next(k for k, line in enumerate(lines) if "End Comments" in line) + 1
    table = np.array([[float(cell) for cell in line.split()] for line in lines[begin:] if line.strip()])
    table = table[np.argsort(table[:, 0])]
    return table[:, 0], table[:, 4] + 1j * table[:, 5]


def read_battery(path: Path) -> tuple[Any, Any]:
    """Frequencies in Hz and impedance of the battery."""
    table = np.loadtxt(path, delimiter=",")
    table = table[np.argsort(table[:, 0])]
    return table[:, 0], table[:, 1] + 1j * table[:, 2]


def remaining(predicted: Any, Z: Any) -> float:
    """Root mean square of relative residuals, per cent."""
    return float(100 * np.sqrt(np.mean(np.abs(predicted / Z - 1) ** 2)))


def scatter(hertz: Any, Z: Any) -> float:
    """Noise by what cubics through seven neighbouring lines leave, per cent of |Z|."""
    x, left = np.log(hertz), []
    for k in range(3, len(x) - 3):
        near = slice(k - 3, k + 4)
        basis = np.vander(x[near] - x[k], 4)
        residual = Z[near] - basis @ np.linalg.lstsq(basis, Z[near], rcond=None)[0]
        left.append(np.sum(np.abs(residual) ** 2) / 3 / np.abs(Z[k]) ** 2)
    return float(100 * np.sqrt(np.mean(left)))


def best_of_real_poles(hertz: Any, Z: Any, inductive: bool) -> float:
    """What R, L, C and 400 RC elements leave at least, and as many RL elements, with positive values."""
    s, tau = 2j * np.pi * hertz, np.geomspace(1e-7, 1e4, 400)
    columns = [np.ones_like(s), s, 1 / s, *(1 / (1 + s * t) for t in tau)]
    columns += [s * t / (1 + s * t) for t in tau] * inductive
    A = np.array(columns).T / Z[:, None]
    A = np.vstack([A.real, A.imag])
    A /= np.linalg.norm(A, axis=0)
    one = np.concatenate([np.ones(len(s)), np.zeros(len(s))])
    return float(100 * nnls(A, one, maxiter=100_000)[1] / np.sqrt(len(s)))


def other(circuit: str, guess: Sequence[float], hertz: Any, Z: Any, **options: Any) -> Any:
    """Fit of a circuit by impedance.py; None if it is not installed."""
    try:
        from impedance.models.circuits import CustomCircuit
    except ImportError:
        return None
    fitted = CustomCircuit(circuit, initial_guess=list(guess))
    fitted.fit(hertz, Z, **options)
    return fitted


def test_circuits(folder: Path) -> None:
    """Print elements of resistor and RC, by both programs."""
    for number, guess in ((1, (100, 400, 1e-5)), (2, (100, 400, 1e-7)), (3, (1000, 4000, 1e-8))):
        hertz, Z = read_zplot(folder / f"Circuit{number}_EIS_1.z")
        print(f"Circuit{number}_EIS_1, {len(hertz)} lines, scatter {scatter(hertz, Z):.2f} %")
        fits = {"default": {}, "real_poles=1": {"real_poles": 1, "structure": "passive"}}
        for call, options in fits.items():
            fit = phc.pem(spectrum(Z, hertz), 0 if "real_poles" in options else "auto", **options)
            parts = phc.netlist(fit, kind="impedance").elements
            shown = ", ".join(f"{part.name} = {part.value:.5g} +- {part.stderr:.2g}" for part in parts)
            print(f"  {call}: {shown}; rms {remaining(fit.predicted, Z):.2f} %; {fit.verdict}")
        for circuit, start in (("R0-p(R1,C1)", guess), ("L0-R0-p(R1,C1)", (1e-5, *guess))):
            peer = other(circuit, start, hertz, Z, weight_by_modulus=True)
            if peer is not None:
                shown = ", ".join(f"{v:.5g} +- {e:.2g}" for v, e in zip(peer.parameters_, peer.conf_, strict=True))
                print(f"  impedance.py {circuit}: {shown}; rms {remaining(peer.predict(hertz), Z):.2f} %")


def battery(folder: Path) -> None:
    """Print what models of the battery leave."""
    hertz, Z = read_battery(folder / "exampleData.csv")
    for lines in (np.flatnonzero(Z.imag < 0), np.arange(len(Z))):
        f, z = hertz[lines], Z[lines]
        print(f"battery, {len(f)} lines to {f[-1]:.4g} Hz, scatter {scatter(f, z):.2f} %")
        best = [best_of_real_poles(f, z, inductive) for inductive in (False, True)]
        print(f"  best of RC elements {best[0]:.2f} %, of RC and RL elements {best[1]:.2f} %")
        for options in ({}, {"structure": "passive", "real_poles": 9}, {"structure": "passive", "real_poles": 10}):
            begin = time.perf_counter()
            fit = phc.pem(spectrum(z, f), **options)
            print(
                f"  pem({', '.join(f'{key}={value!r}' for key, value in options.items())}): {len(fit.real_poles)} real "
                f"poles, {fit.order} modes, {fit.structure}, passive {phc.passivity(fit.system).is_passive}, "
                f"rms {remaining(fit.predicted, z):.2f} %, {time.perf_counter() - begin:.2f} s"
            )
        peers = {
            "R0-p(R1,C1)-p(R2-Wo1,C2)": (0.01, 0.01, 100, 0.01, 0.05, 100, 1),
            "L0-R0-p(R1,CPE1)-p(R2-Wo1,CPE2)": (1e-7, 0.015, 0.01, 3, 0.8, 0.005, 0.01, 100, 0.2, 0.8),
        }
        for circuit, guess in peers.items():
            peer = other(circuit, guess, f, z)
            if peer is not None:
                print(f"  impedance.py {circuit}: rms {remaining(peer.predict(f), z):.2f} %")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark and print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--folder", type=Path, help="with measured spectra")
    options = parser.parse_args(arguments)
    print("| circuit | call | all elements | no others | passive | cover [%] | mean z² | s |")
    print("|---|---|---|---|---|---|---|---|")
    for name in CIRCUITS:
        for call in CALLS if options.seeds else ():
            coverage(name, call, options.seeds)
    if options.folder:
        test_circuits(options.folder)
        battery(options.folder)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

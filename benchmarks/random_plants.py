"""Random process plants: what the default call foretells of the second half of a record, beside subspace methods.

    python -m benchmarks.random_plants [--seeds N] [--first N] [--peers]

Up to two lags and two modes, a common dead time or none, one to five inputs and one or two outputs, 800 to 3000
samples.  Inputs are white, binary, of many levels, or a few steps; noise of 5 to 100 % of the outputs is white, a lag,
a peak, a random walk beside white noise, or comes through the plant.  Some plants of one input and output are in a
closed loop.  Each is fitted to the first half of its record; fits are those of its outputs without noise in the second
half, from rest, and their constants do not count.
"""

from __future__ import annotations

import argparse
import logging
import warnings
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

import ph_control as phc

from .process import Plant, peers, percent, squeezed

Array = NDArray[np.float64]


def drawn(rng: np.random.Generator, p: int, m: int) -> Plant:
    """A plant of one to four sections, told apart by its response."""
    lags = int(rng.choice([0, 1, 1, 2, 2]))
    modes = int(rng.choice([0, 0, 1, 2])) if lags else int(rng.choice([1, 2]))
    times = np.exp(rng.uniform(np.log(4), np.log(120), lags))
    if lags == 2 and times.max() < 1.5 * times.min():
        times[1] = 3 * times[0]
    omega = np.sort(np.exp(rng.uniform(np.log(0.05), np.log(1.5), modes)))
    if modes == 2 and omega[1] < 1.2 * omega[0]:
        omega[1] = min(1.6 * omega[0], 2.5)
    zeta = np.exp(rng.uniform(np.log(0.01), np.log(0.4), modes))
    poles = np.concatenate([-1 / times + 0j, omega * (-zeta + 1j * np.sqrt(1 - zeta**2))])
    sizes = np.where(poles.imag > 0, np.sqrt(np.abs(poles.real * poles)), np.abs(poles))
    sizes = sizes * np.exp(rng.uniform(-0.7, 0.7, len(poles)))
    phases = np.where(poles.imag > 0, np.exp(1j * rng.uniform(-1, 1, len(poles))), 1.0)
    residues = rng.standard_normal((len(poles), p, m)) * (sizes * phases)[:, None, None]
    return Plant(poles, residues, int(rng.choice([0, 0, 0, 2, 7, 20])))


def in_loop(plant: Plant, reference: Array, noise: Array) -> tuple[Array, Array]:
    """Input and output without noise (1, T) of a loop with a gain that is a third of that of the plant inverted."""
    a = np.exp(plant.poles)
    b = plant.residues[:, 0, 0] * (a - 1) / plant.poles * np.where(plant.poles.imag > 0, 2.0, 1.0)
    gain = -0.3 / float(np.sum(b / (1 - a)).real)
    u, x, states = np.zeros(reference.shape), np.zeros(reference.shape), np.zeros(len(a), complex)
    for k in range(reference.shape[1]):
        x[0, k] = float(np.sum(b * states).real)
        u[0, k] = reference[0, k] + np.clip(gain * (x[0, k] + noise[0, k]), -3, 3)
        states = a * states + (u[0, k - plant.late] if k >= plant.late else 0.0)
    return u, x


def inputs_of(rng: np.random.Generator, m: int, samples: int) -> tuple[str, Array]:
    """A kind of inputs (m, T), and these; in each half there are more levels than inputs."""
    kind = str(rng.choice(["binary", "levels", "white", "steps"]))
    if kind == "white":
        return kind, rng.standard_normal((m, samples))
    lasting = {"binary": [3, 8, 20], "levels": [10, 40, 100], "steps": [samples // 4, samples // 8]}[kind]
    each = min(int(rng.choice(lasting)), samples // (8 * m) if m > 1 else samples)
    u = np.repeat(rng.uniform(-1, 1, (m, samples // each + 1)), each, axis=1)[:, :samples]
    return kind, np.sign(u) if kind == "binary" else u


def noise_of(rng: np.random.Generator, plant: Plant, samples: int) -> tuple[str, Array]:
    """A kind of noise (p, T), and noise of this kind with variance 1."""
    kind = str(rng.choice(["white", "lag", "peak", "walk", "load"]))
    p, m = plant.residues.shape[1:]
    white = rng.standard_normal((p, samples))
    noise = white
    if kind == "lag":
        noise = lfilter([1], [1, -float(rng.choice([0.5, 0.8, 0.9, 0.95, 0.98]))], white, axis=1)
    elif kind == "peak":
        pole = 0.9 * np.exp(1j * rng.uniform(0.05, 2))
        noise = lfilter([1], [1, -2 * pole.real, abs(pole) ** 2], white, axis=1)
    elif kind == "walk":
        noise = rng.standard_normal(white.shape) + 0.05 * np.cumsum(white, axis=1)
    elif kind == "load":
        load = plant.outputs(rng.standard_normal((m, samples)), 1.0)
        noise = load / np.std(load, axis=1, keepdims=True) + 0.2 * white
    return kind, np.asarray(noise / np.std(noise, axis=1, keepdims=True))


@dataclass(frozen=True)
class Case:
    """A plant, its record, outputs without noise, and what it was made of."""

    plant: Plant
    u: Array
    y: Array
    x: Array
    words: str

    @classmethod
    def of(cls, seed: int) -> Case:
        """The case of a seed."""
        rng = np.random.default_rng([seed, 77])
        samples, m, p = (int(rng.choice(each)) for each in ([800, 1500, 3000], [1, 1, 1, 2, 3, 5], [1, 1, 1, 2]))
        plant = drawn(rng, p, m)
        driven, u = inputs_of(rng, m, samples)
        kind, noise = noise_of(rng, plant, samples)
        share = float(np.exp(rng.uniform(np.log(0.05), 0.0)))
        x = plant.outputs(u, 1.0)
        noise = noise * share * np.std(x, axis=1, keepdims=True)
        closed = bool(m == p == 1 and rng.random() < 0.2)
        if closed:
            u, x = in_loop(plant, u, noise)
        level = float(rng.choice([0.0, 2.0])) * np.std(x) * rng.standard_normal((p, 1))
        words = f"{p} x {m}, {samples} samples, {driven} inputs, {kind} of {100 * share:.0f} %, {plant.late} late"
        return cls(plant, u, x + noise + level, x, words + ", closed loop" * closed)


def beside_constants(x: Array, predicted: Array) -> float:
    """Fit in percent, whatever constants outputs have."""
    return percent(x, predicted + np.mean(x - predicted, axis=1, keepdims=True))


def best_of_others(case: Case) -> tuple[float, str]:
    """Fit and name of the subspace method, and of the order up to 6, that is best in the second half."""
    half = case.u.shape[1] // 2
    u, y = (each - each[:, :half].mean(axis=1, keepdims=True) for each in (case.u, case.y))
    with np.errstate(all="ignore"):
        models = peers(u[:, :half], y[:, :half])
        fits = {name: beside_constants(case.x[:, half:], model(u, case.x)[:, half:]) for name, model in models.items()}
    name = max(fits, key=lambda key: fits[key] if np.isfinite(fits[key]) else -np.inf)
    return fits[name], name


def main() -> None:
    """Print a line for each plant, and how many are as good as the best of others."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--peers", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    fits, others, right, seconds = list[float](), list[float](), 0, 0.0
    for seed in range(options.first, options.first + options.seeds):
        case = Case.of(seed)
        half, plant = case.u.shape[1] // 2, case.plant
        start = process_time()
        result: Any = phc.pem(squeezed(case.u[:, :half], case.y[:, :half]), dt=1.0)
        spent = process_time() - start
        u = case.u[0] if len(case.u) == len(case.y) == 1 else case.u
        predicted = np.reshape(result.predict(u, initial_state="zero", dt=1.0).outputs, case.y.shape)
        fits.append(beside_constants(case.x[:, half:], predicted[:, half:]))
        right += len(result.poles) == len(plant.poles)
        seconds += spent
        line = f"{seed:4d} {fits[-1]:7.1f} {len(plant.poles)} {len(result.poles)} {result.bic:10.1f} {spent:5.1f} s"
        if options.peers:
            fit, name = best_of_others(case)
            others.append(fit)
            line += f" {fit:7.1f} {name:12}"
        causes = ", ".join(sorted({finding.cause.name for finding in result.findings} - {"LOSSES", "COMPLEX_SHAPES"}))
        print(f"{line}  {case.words}; {causes}", flush=True)
    print(
        f"fit: median {np.median(fits):.1f}, 10 % below {np.quantile(fits, 0.1):.1f}, least {min(fits):.1f};", end=" "
    )
    print(f"as many poles as the plant in {right} of {len(fits)}, {seconds / len(fits):.1f} s each")
    if others:
        gap = np.array(fits) - np.array(others)
        print(
            f"within 1 point of the best of others, or above it, in {np.sum(gap > -1)}, within 3 in {np.sum(gap > -3)}"
        )


if __name__ == "__main__":
    main()

"""Monte Carlo of the tests of structures: how often true ones are rejected and false ones found; a chain's damping.

python -m benchmarks.structure_tests [--seeds N] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ph_control.identification.regression.free import FreeProjection, PoleRegion, refine_free
from ph_control.identification.regression.frequency_rows import FreeResponse
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.identification.structure.constrained import constrained
from ph_control.identification.structure.coordinates import ChannelLayout
from ph_control.identification.structure.hypothesis_tests import structure_tests
from ph_control.modal.discretization import Hold
from tests.structure_plants import CASES, SAMPLES, chain, plant, recorded

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LEVEL = 0.05


def free_fit(u: Array, y: Array, p: ComplexArray, through: bool = False) -> tuple[FreeProjection, Array, PoleRegion]:
    """Free maximum likelihood from the true poles, one noise variance for each output."""
    region = PoleRegion(2 * np.pi / SAMPLES, np.pi)
    scales = np.std(y, axis=1)
    for _ in range(3):
        rows = FreeRecord.by_observation(u, y / scales[:, None], np.ones(y.shape, bool), Hold(1.0), through=through)
        at = refine_free(lambda _, rows=rows: rows, p, region, 1e-12)
        left = y / scales[:, None] - at.predictions()[0]
        scales, p = scales * np.sqrt(np.mean(left**2, axis=1)), at.p
    return at, scales, region


def shares(kind: str, seeds: int, through: bool = False) -> dict[str, float]:
    """Share of seeds in which each hypothesis is rejected."""
    p, residues, ports = plant(kind)
    rejected: dict[str, list[bool]] = {}
    for seed in range(seeds):
        u, y = recorded(p, residues, seed)
        at, scales, region = free_fit(u, y, p, through)
        layout = ChannelLayout(len(y), len(u), scales, ("velocity",) * len(y), ports)
        for test in structure_tests(at, layout, region).tests:
            rejected.setdefault(test.hypothesis, []).append(test.p < LEVEL)
    return {name: float(np.mean(each)) for name, each in rejected.items()}


def calibration(seeds: int) -> None:
    """Shares of rejections, those of true hypotheses and those of false ones."""
    for kind, (true, false) in CASES.items():
        start = time.process_time()
        found = shares(kind, seeds)
        each = [
            f"{name} {100 * found[name]:.1f} %{' (true)' * (name in true)}{' (false)' * (name in false)}"
            for name in found
        ]
        print(f"{kind}: {', '.join(each)}; {(time.process_time() - start) / seeds:.3f} s", flush=True)


# --- the damping of a chain ---------------------------------------------------------------------------------------


def receptance(p: ComplexArray, weights: Array, s: ComplexArray) -> ComplexArray:
    """Displacement of modes with weights."""
    return np.asarray(weights @ (1 / ((s - p[:, None]) * (s - p.conj()[:, None]))))


def efficiency(seeds: int) -> None:
    """Relative errors of damping ratios of three masses, one response, and the bound for real weights."""
    d, shapes = chain(3, np.zeros(3))
    d = d.imag * np.sqrt(13000 / 0.3)
    ratios, weights = 0.6 / 13000 * d / 2, shapes[:, 0] * shapes[:, 2] / 0.3
    p = d * (-ratios + 1j * np.sqrt(1 - ratios**2))
    omega, noise = np.linspace(0, 500, 512)[50:450], 8.7e-6
    clean, region = receptance(p, weights, 1j * omega), PoleRegion(500 / 511, 500.0)
    layout = ChannelLayout(1, 1, np.array([noise]), ("displacement",), per_entry=True)
    errors = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        parts = rng.standard_normal((2, len(omega)))
        response = clean / noise + parts[0] + 1j * parts[1]
        rows = [FreeResponse(omega, response[None], np.ones(len(omega)), np.ones(len(omega), bool), "displacement")]
        at = refine_free(lambda _, rows=rows: rows, p, region, 1e-12)
        structured = constrained(at, layout, "classical", region)
        errors.append([-one.real / np.abs(one) / ratios - 1 for one in (at.p, structured.p)])
    bound = damping_bound(d, ratios, weights, omega, noise)
    for name, each in zip(("free", "classical"), np.moveaxis(errors, 1, 0), strict=True):
        rms = np.sqrt(np.mean(each**2, axis=0))
        print(f"damping of three masses, {name}: {100 * rms} %, {rms / bound} of the bound {100 * bound} %", flush=True)


def damping_bound(d: Array, ratios: Array, weights: Array, omega: Array, noise: float) -> Array:
    """Cramer-Rao bound of relative damping ratios, beside frequencies, real weights, a mass and a spring."""

    def response(x: Array) -> Array:
        w, z, k = x[:3] * d, x[3:6] * ratios, x[6:9] * weights
        G = receptance(w * (-z + 1j * np.sqrt(1 - z**2)), k, 1j * omega)
        return np.concatenate([G.real, G.imag])

    steps = 1e-6 * np.eye(9)
    J = np.array([(response(1 + one) - response(1 - one)) / 2e-6 for one in steps]).T / noise
    beside = np.concatenate([np.array([1 / omega**2, np.ones(len(omega))]), np.zeros((2, len(omega)))], axis=1)
    J = np.concatenate([J, (beside / np.linalg.norm(beside, axis=1)[:, None]).T], axis=1)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(J.T @ J))[3:6]))


STUDIES: dict[str, Callable[[int], None]] = {"calibration": calibration, "efficiency": efficiency}


def main() -> None:
    """Run the studies."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.structure_tests", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--only", nargs="*", choices=list(STUDIES), default=list(STUDIES))
    options = parser.parse_args()
    for name in options.only:
        STUDIES[name](options.seeds)


if __name__ == "__main__":
    main()

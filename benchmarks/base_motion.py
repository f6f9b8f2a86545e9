"""Effective masses of six storeys from the accelerations of ground and floors: their sum, errors and cover.

python -m benchmarks.base_motion [--seeds N]
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

import ph_control as phc

Array = NDArray[np.float64]

MASSES = np.array([2.0, 2.0, 2.0, 1.5, 1.5, 1.0])
STEP, SAMPLES, NOISE = 0.02, 3000, 0.05


def frame() -> tuple[Array, Array, Array]:
    """Mass, damping and stiffness of a frame of six rigid floors."""
    k = 900.0 * np.linspace(1.5, 1.0, 6)
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    return np.diag(MASSES), 0.1 * np.diag(MASSES) + 0.0005 * K, K


def main() -> None:
    """Fit records of other ground motions and other noise each time."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.base_motion", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    M, C, K = frame()
    plant = phc.from_second_order(M, K, C=C, base=np.ones(6), sensors={"acceleration": np.eye(6)}, modes=6)
    _, shapes = eigh(K, M)
    true = (shapes.T @ MASSES) ** 2
    scores, totals, relative, orders = [], [], [], 0
    seeds = parser.parse_args().seeds
    for seed in range(seeds):
        rng, t = np.random.default_rng(seed), STEP * np.arange(SAMPLES)
        ground = rng.standard_normal(SAMPLES)
        floors = phc.forced_response(plant, t, ground).outputs[1:]
        floors = floors + NOISE * floors.std(axis=1, keepdims=True) * rng.standard_normal(floors.shape)
        fit = phc.pem((ground, floors), dt=STEP, quantity="acceleration")
        motion = phc.base_motion(fit, masses=MASSES)
        orders += fit.order == 6
        totals.append((motion.total[0] - MASSES.sum()) / motion.stderr["total"][0])
        if fit.order == 6:
            scores.append((motion.effective_masses[:, 0] - true) / motion.stderr["effective_masses"][:, 0])
            relative.append(motion.effective_masses[:, 0] / true - 1)
    z, total = np.array(scores), np.array(totals)
    print(
        f"{orders} of {seeds} with six modes; relative rms errors of effective masses "
        f"{np.sqrt(np.mean(np.square(relative), axis=0)).round(4)}, cover of 95 % intervals "
        f"{100 * np.mean(np.abs(z) < 1.96):.1f} %, rms z-score {np.sqrt(np.mean(z**2)):.2f}; sum: cover "
        f"{100 * np.mean(np.abs(total) < 1.96):.1f} %, rms z-score {np.sqrt(np.mean(total**2)):.2f}"
    )


if __name__ == "__main__":
    main()

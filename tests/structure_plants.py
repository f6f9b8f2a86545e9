"""Plants whose damping, sensors and couplings make some structures true and others false, and recordings of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

Plant = tuple[ComplexArray, ComplexArray, tuple[tuple[int, int], ...]]  # poles, residues, ports

SAMPLES = 1000
NOISE = 0.1  # 20 dB


def chain(masses: int, ratios: Array) -> tuple[ComplexArray, Array]:
    """Poles of a chain of equal masses between walls, with these damping ratios, and its shapes (n, masses)."""
    stiffness = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    squares, shapes = np.linalg.eigh(stiffness)
    d = np.sqrt(squares)
    return d * (-ratios + 1j * np.sqrt(1 - ratios**2)), shapes.T


def velocities(p: ComplexArray, matrices: NDArray[Any]) -> ComplexArray:
    """Residues of velocities for `matrices` of modal amplitudes, shape (n, outputs, inputs)."""
    return (p / (2j * p.imag))[:, None, None] * matrices


def with_dampers(dampers: Array, ports: int, sensors: int) -> Plant:
    """Forces and velocities at the first masses of a chain, and sensors at some more, with any damping matrix."""
    masses = len(dampers)
    stiffness = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    poles, shapes = np.linalg.eig(np.block([[np.zeros((masses, masses)), np.eye(masses)], [-stiffness, -dampers]]))
    weights, upper = np.linalg.inv(shapes), poles.imag > 0
    seen, driven = shapes[masses : masses + sensors, upper].T, weights[upper, masses : masses + ports]
    return poles[upper], seen[:, :, None] * driven[:, None], tuple((k, k) for k in range(ports))


def plant(kind: str) -> Plant:
    """Poles, residues and ports."""
    half, one, three = np.array([0.005, 0.01]), np.array([5e-4, 5e-4]), np.array([0.005, 0.01, 0.01])
    if kind == "dashpot":
        return with_dampers(np.diag([0.0, 0.0, 0.3]), 1, 1)
    if kind == "viscous":
        return with_dampers(np.array([[0.02, -0.01, 0.0], [-0.01, 0.05, -0.04], [0.0, -0.04, 0.3]]), 2, 3)
    if kind in ("lossless", "classical", "lightly damped", "sensor beside"):
        p, shapes = chain(2, {"lossless": 0 * half, "lightly damped": one}.get(kind, half))
        sensor = shapes[:, 1] if kind == "sensor beside" else shapes[:, 0]
        return p, velocities(p, (sensor * shapes[:, 0])[:, None, None]), ((0, 0),)
    p, shapes = chain(3, three)
    turned = shapes * np.exp(1j * np.array([[0.4, 0.0, -0.7], [-0.3, 0.5, 0.0], [0.0, 0.8, 0.2]]))
    if kind == "two ports":
        return p, velocities(p, shapes[:, :, None] * shapes[:, None, :2]), ((0, 0), (1, 1))
    if kind == "rank one":
        return p, velocities(p, turned[:, :, None] * shapes[:, None, :2]), ()
    if kind == "reciprocal":
        return p, velocities(p, turned[:, :, None] * turned[:, None, :2]), ((0, 0), (1, 1))
    # a gyroscope between the ports: neither reciprocal nor of rank one
    twist = np.zeros((3, 3, 2))
    twist[:, 0, 1], twist[:, 1, 0] = 0.3, -0.3
    return p, velocities(p, shapes[:, :, None] * shapes[:, None, :2] + twist), ((0, 0), (1, 1))


def recorded(p: ComplexArray, residues: ComplexArray, seed: int) -> tuple[Array, Array]:
    """White inputs, outputs from rest with white noise."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((residues.shape[2], SAMPLES))
    y = np.zeros((residues.shape[1], SAMPLES))
    for pole, rho in zip(p, residues, strict=True):
        states = [lfilter([0.0, np.expm1(pole) / pole], [1.0, -np.exp(pole)], one + 0j) for one in u]
        y += 2 * (rho @ np.array(states)).real
    return u, y + NOISE * np.std(y, axis=1, keepdims=True) * rng.standard_normal(y.shape)


# which hypotheses hold, and which have to be found false
CASES: dict[str, tuple[list[str], list[str]]] = {
    "lossless": (["lossless", "classical", "passive"], []),
    "classical": (["classical", "passive"], ["lossless"]),
    "lightly damped": (["classical", "passive"], ["lossless"]),
    "dashpot": (["passive"], ["lossless", "classical"]),
    "sensor beside": ([], ["lossless", "classical", "passive"]),
    "two ports": (["classical", "passive", "rank one", "reciprocal"], ["lossless"]),
    "rank one": (["rank one"], ["lossless", "classical"]),
    "reciprocal": (["rank one", "reciprocal"], ["lossless", "classical"]),
    "viscous": (["passive", "rank one", "reciprocal"], ["lossless", "classical"]),
    "gyroscope": ([], ["lossless", "classical", "rank one", "reciprocal"]),
}

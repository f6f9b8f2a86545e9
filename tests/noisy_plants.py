"""Plants of several damped modes, and their responses and recordings under noise as it is."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LINES = 600
FLOOR, SHARE = 0.01, 0.03  # of the root mean square of a response, and of each value
DELAY = 3  # samples
SIZES = ((1, 1), (3, 2))  # outputs, inputs


def plant(modes: int, outputs: int, inputs: int, seed: int) -> tuple[ComplexArray, ComplexArray]:
    """Poles with damping ratios of 0.1 to 2 %, and residues of velocities."""
    rng = np.random.default_rng([seed, 1])
    d, zeta = np.linspace(0.5, 2.4, modes) + rng.uniform(-0.1, 0.1, modes), 10 ** rng.uniform(-3, -1.7, modes)
    poles = d * (-zeta + 1j * np.sqrt(1 - zeta**2))
    shapes = rng.uniform(0.6, 1.4, (modes, max(outputs, inputs)))
    shapes *= np.sign(rng.standard_normal(shapes.shape))
    factor = (poles / (2j * poles.imag))[:, None, None]
    return poles, factor * shapes[:, :outputs, None] * shapes[:, None, :inputs]


def response(modes: int, outputs: int, inputs: int, noise: str, seed: int) -> Any:
    """Frequency responses whose noise is constant, grows with the gain, or both."""
    poles, residues = plant(modes, outputs, inputs, seed)
    omega = np.linspace(0.2, 2.8, LINES)
    s = 1j * omega
    pairs = zip(poles, residues[..., None], strict=True)
    G = np.asarray(sum(rho / (s - p) + rho.conj() / (s - p.conjugate()) for p, rho in pairs))
    floor, share = FLOOR * np.sqrt(np.mean(np.abs(G) ** 2, axis=2, keepdims=True)), SHARE * np.abs(G)
    size = {"constant": 5 * floor, "gain": share, "both": np.hypot(floor, share)}[noise]
    real, imaginary = np.random.default_rng([seed, 2]).standard_normal((2, *G.shape))
    return ct.frd(G + size * (real + 1j * imaginary), omega)


def velocities(poles: ComplexArray, residues: ComplexArray, u: Array) -> Array:
    """Outputs (p, T) under held inputs (m, T) from rest, one sample a unit of time."""
    y = np.zeros((residues.shape[1], u.shape[1]))
    for pole, rho in zip(poles, residues, strict=True):
        states = [lfilter([0.0, np.expm1(pole) / pole], [1.0, -np.exp(pole)], one + 0j) for one in u]
        y += 2 * (rho @ np.array(states)).real
    return y


def recording(modes: int, outputs: int, inputs: int, noise: str, seed: int, samples: int = 1000) -> tuple[Array, Array]:
    """Inputs and outputs with white or coloured noise, noise on the input, unknown forces, a drift, delay, outlier."""
    poles, residues = plant(modes, outputs, inputs, seed)
    rng = np.random.default_rng([seed, 5])
    u = rng.standard_normal((inputs, samples + DELAY))
    clean = velocities(poles, residues, u)
    size, white = np.std(clean, axis=1, keepdims=True), rng.standard_normal(clean.shape)
    y = clean + 0.1 * size * white
    if noise == "coloured":
        y = clean + 0.1 * size * np.sqrt(1 - 0.9**2) * lfilter([1.0], [1.0, -0.9], white)
    elif noise == "input":
        u, y = u + 0.1 * rng.standard_normal(u.shape), clean + 0.01 * size * white
    elif noise == "forces":
        y = clean + 0.02 * size * white + velocities(poles, residues, 0.1 * rng.standard_normal(u.shape))
    elif noise == "drift":
        y += 3 * size * np.arange(u.shape[1]) / samples
    elif noise == "outlier":
        y[0, samples // 3] += 3 * size[0, 0]
    elif noise == "delay":
        return u[:, DELAY:], y[:, :-DELAY]
    return u[:, :samples], y[:, :samples]

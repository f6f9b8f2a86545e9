"""Plants of damped modes with real shapes, and their recordings, responses and free decays with white noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

import ph_control as phc

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Plant:
    """Poles, and shapes of unit modal mass at the sensors; the first sensors are at the actuators."""

    poles: ComplexArray
    shapes: Array
    inputs: int

    @classmethod
    def of(cls, modes: int = 3, outputs: int = 4, inputs: int = 2, seed: int = 0) -> Plant:
        """One with real modes, well apart."""
        rng = np.random.default_rng(seed)
        d = np.linspace(0.5, 2.4, modes) + rng.uniform(-0.1, 0.1, modes)
        zeta = rng.uniform(0.005, 0.02, modes)
        shapes = rng.standard_normal((modes, outputs))
        shapes *= np.sign(shapes[:, :1])
        shapes[:, 0] += 0.5
        return cls(d * (-zeta + 1j * np.sqrt(1 - zeta**2)), shapes, inputs)

    @property
    def residues(self) -> ComplexArray:
        """Of velocities by forces."""
        factor = self.poles / (2j * self.poles.imag)
        return factor[:, None, None] * self.shapes[:, :, None] * self.shapes[:, None, : self.inputs]

    @property
    def truth(self) -> dict[str, NDArray[Any]]:
        """The parameters that are estimated."""
        d = np.abs(self.poles)
        return {
            "natural_frequencies": d, "damping_ratios": -self.poles.real / d, "residues": self.residues,
            "shapes": self.shapes + 0j,
        }  # fmt: skip

    def response(self, s: ComplexArray) -> ComplexArray:
        """Transfer functions (p, m, K)."""
        gaps = s - self.poles[:, None], s - self.poles[:, None].conj()
        pairs = zip((self.residues, self.residues.conj()), gaps, strict=True)
        return np.asarray(sum(np.einsum("lpm,lk->pmk", rho, 1 / gap) for rho, gap in pairs))

    def velocities(self, u: Array) -> Array:
        """Outputs (p, T) under held inputs (m, T) from rest, one sample a unit of time."""
        form = phc.modes(
            self.poles, self.shapes, (self.poles / (2j * self.poles.imag))[:, None] * self.shapes[:, : len(u)]
        )
        sampled = ct.c2d(form.state_space(), 1.0)
        return np.asarray(ct.forced_response(sampled, np.arange(u.shape[1]) * 1.0, u, squeeze=False).outputs)


def data_of(plant: Plant, kind: str, samples: int, seed: int, noise: float) -> Any:
    """Data of a kind with white noise, as `pem` takes them."""
    rng = np.random.default_rng([seed, 7])
    if kind == "response":
        omega = np.linspace(0.2, 2.8, samples // 2)
        clean = plant.response(1j * omega)
        size = noise * np.std(clean, axis=2, keepdims=True)
        errors = rng.standard_normal((2, *clean.shape))
        return ct.frd(clean + size * (errors[0] + 1j * errors[1]), omega)
    if kind == "decay":
        start = plant.shapes[:, :, None] * np.exp(np.outer(plant.poles, np.arange(samples)) + 0.3j)[:, None]
        u, clean = None, 2 * start.real.sum(axis=0)
    else:
        u = np.random.default_rng(11).standard_normal((plant.inputs, samples))
        clean = plant.velocities(u)
    return u, clean + noise * np.std(clean, axis=1, keepdims=True) * rng.standard_normal(clean.shape)

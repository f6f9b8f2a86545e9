"""Random lossless plants and noisy recordings of them, the same for the same seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import ph_control as phc

Array = NDArray[np.float64]

BAND = (0.1, 0.9)  # of the Nyquist frequency
POWER_RATIO = 4.0  # between the strongest and the weakest mode, at most


@dataclass(frozen=True)
class Configuration:
    """Modes, samples, signal-to-noise ratio (dB), and the smallest distance of two modes in bins `2 pi / T`."""

    n: int
    samples: int
    snr: float
    bins: float

    def __str__(self) -> str:
        return f"n={self.n}, T={self.samples}, {self.snr:g} dB, {self.bins:g} bins"


@dataclass(frozen=True)
class Recording:
    """A recording and the truth behind it: `state` (2n,) in Williamson coordinates, output free of noise, and noise."""

    d: Array
    r: Array
    state: Array
    u: Array
    clean: Array
    deviation: float
    y: Array
    h: float = 1.0
    method: str = "exact"

    @property
    def plant(self) -> phc.PortHamiltonian:
        """The plant that was recorded."""
        return phc.ph(phc.modes(self.d, self.r))

    @property
    def theta(self) -> Array:
        """True parameters `(d, r, state)`, shape (4n,)."""
        return np.concatenate([self.d, self.r, self.state])

    def again(self, rng: np.random.Generator) -> Recording:
        """Record once more: same plant, state and input, other noise."""
        y = self.clean + self.deviation * rng.standard_normal(len(self.u))
        return Recording(self.d, self.r, self.state, self.u, self.clean, self.deviation, y, self.h, self.method)


def random_recording(config: Configuration, rng: np.random.Generator) -> Recording:
    """White input, a random plant in random motion, white noise at the output; step 1.

    The powers of the modes at the output lie within a factor of `POWER_RATIO`, free and forced motion together; the
    free motion is of the size of the forced one.
    """
    d = spaced_frequencies(config.n, config.bins * 2 * np.pi / config.samples, (BAND[0] * np.pi, BAND[1] * np.pi), rng)
    u = rng.standard_normal(config.samples)
    r, state = balanced_modes(d, u, rng)
    return record(d, r, state, u, config.snr, rng)


def balanced_modes(
    d: Array, u: Array, rng: np.random.Generator, h: float = 1.0, method: str = "exact", moving: bool = True
) -> tuple[Array, Array]:
    """Weights (n,) and initial state (2n,) with which each mode moves the output by a power of `1/POWER_RATIO .. 1`."""
    n = len(d)
    power = POWER_RATIO ** rng.uniform(-1.0, 0.0, n)
    direction = rng.standard_normal((n, 2))
    kappa, state = np.empty(n), np.zeros((n, 2))
    for l in range(n):
        mode = (d[l : l + 1], 1 / d[l : l + 1])
        motion = simulate(*mode, np.zeros(2), u, h, method)
        if moving:
            # a state of length 1 moves the output by sqrt(d)
            start = direction[l] * np.sqrt(np.mean(motion**2) / d[l])
            motion = simulate(*mode, start, u, h, method)
            state[l] = start
        kappa[l] = np.sqrt(power[l] / np.mean(motion**2))
        state[l] *= np.sqrt(kappa[l])
    return kappa / d, state.T.ravel()


def record(
    d: Array, r: Array, state: Array, u: Array, snr: float, rng: np.random.Generator, h: float = 1.0,
    method: str = "exact",
) -> Recording:  # fmt: skip
    """Record a plant with noise `snr` dB below the power of the output."""
    clean = simulate(d, r, state, u, h, method)
    deviation = float(np.sqrt(np.mean(clean**2) / 10 ** (snr / 10)))
    y = clean + deviation * rng.standard_normal(len(u))
    return Recording(d, r, state, u, clean, deviation, y, h, method)


def simulate(d: Array, r: Array, state: Array, u: Array, h: float = 1.0, method: str = "exact") -> Array:
    """Output of a plant, without noise."""
    plant, t = phc.ph(phc.modes(d, r)), h * np.arange(float(len(u)))
    return np.asarray(
        phc.forced_response(plant, t, u, state, method=method, return_states=False, intersample="zoh").outputs
    )


def spaced_frequencies(n: int, gap: float, band: tuple[float, float], rng: np.random.Generator) -> Array:
    """Random frequencies in a band, ascending: two of them `gap` apart, the others at least as far."""
    low, high = band
    if high - low < (n - 1) * gap:
        raise ValueError(f"{n} modes at distances of {gap:.3g} do not fit between {low:.3g} and {high:.3g}")
    # what is left of the band when all gaps are taken out; the closest pair are neighbours without any more between
    place = np.sort(rng.uniform(low, high - (n - 1) * gap, max(1, n - 1)))
    if n > 1:
        pair = int(rng.integers(n - 1))
        place = np.insert(place, pair, place[pair])
    return np.asarray(place + gap * np.arange(n))

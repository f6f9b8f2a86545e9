"""Records of `golden`: plants with known poles and residues, and what is measured of them, each from its seed.

A plant is `sum_l R_l / (s - p_l) + conj. + D`; its samples are those of the modal states under inputs that are held, or
linear between samples, exactly.  Nothing here calls the package.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from control import FrequencyResponseData
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[Any]
Rng = np.random.Generator

STEP = 0.08
NYQUIST = np.pi / STEP
POWERS = {"displacement": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True)
class Plant:
    """Poles (n,) of the upper half-plane, residues (n, p, m) and feedthrough (p, m)."""

    poles: Array
    residues: Array
    feedthrough: Array

    def response(self, omega: Array) -> Array:
        """Frequency response, shape (p, m, K)."""
        s = 1j * omega
        forward = self.residues[..., None] / (s - self.poles[:, None, None, None])
        backward = self.residues.conj()[..., None] / (s - self.poles.conj()[:, None, None, None])
        return np.asarray((forward + backward).sum(axis=0) + self.feedthrough[..., None])

    def output(self, u: Array, start: Array, hold: str = "zoh") -> Array:
        """Outputs (p, T) of inputs (m, T), with free motions `2 Re sum start_l exp(p_l t)`, start (n, p)."""
        y = self.feedthrough @ u
        for p, residue, amplitude in zip(self.poles, self.residues, start, strict=True):
            z, drive = np.exp(p * STEP), residue @ u
            mean = np.expm1(p * STEP) / p
            end = (mean - STEP) / (p * STEP) if hold == "foh" else 0.0
            later, earlier = np.zeros_like(drive), np.zeros_like(drive)
            earlier[:, 1:], later[:, 1:] = drive[:, :-1], drive[:, 1:]
            x = lfilter([1.0], [1.0, -z], (mean - end) * earlier + end * later, axis=1)
            y = y + 2 * (x + amplitude[:, None] * z ** np.arange(u.shape[1])).real
        return np.asarray(y)


@dataclass(frozen=True)
class Record:
    """A plant, data of it, and the keywords of the fit."""

    plant: Plant
    data: Any
    keywords: dict[str, Any] = field(default_factory=dict)


# --- plants ----------------------------------------------------------------------------------------------------------


def frequencies(rng: Rng, n: int, low: float = 0.02, high: float = 0.7, gap: float = 0.3) -> Array:
    """Frequencies between parts of the Nyquist frequency, apart by the share `gap` of their mean distance, or more."""
    edges = low * NYQUIST, high * NYQUIST
    spare = np.sort(rng.uniform(0.0, 1.0, n)) * (1 - gap * (n - 1) / n)
    return np.asarray(edges[0] + (edges[1] - edges[0]) * (spare + gap * np.arange(n) / n))


def collocated(rng: Rng, d: Array, zeta: Any = 0.0, quantity: str = "velocity") -> Plant:
    """Plant with one port at the place of the sensor."""
    return structure(rng.uniform(0.5, 1.4, (len(d), 1)), d, zeta, [0], [0], quantity)


def structure(shapes: Array, d: Array, zeta: Any, outputs: Any, inputs: Any, quantity: str = "velocity") -> Plant:
    """Classically damped plant of real shapes (n, places), of unit modal mass."""
    p = d * (-np.broadcast_to(zeta, d.shape) + 1j * np.sqrt(1 - np.broadcast_to(zeta, d.shape) ** 2))
    pairs = shapes[:, outputs, None] * shapes[:, None, inputs]
    residues = pairs * (p ** POWERS[quantity] / (2j * p.imag))[:, None, None]
    return Plant(p, residues, pairs.sum(axis=0) if quantity == "acceleration" else np.zeros(pairs.shape[1:]))


def scattered(rng: Rng, d: Array, zeta: Any, p: int, m: int) -> Plant:
    """Plant of complex residues of rank one."""
    poles = d * (-zeta + 1j * np.sqrt(1 - zeta**2))
    shapes, participation = (rng.standard_normal((len(d), k, 2)) @ [1, 1j] for k in (p, m))
    return Plant(poles, 0.5 * shapes[:, :, None] * participation[:, None, :], np.zeros((p, m)))


# --- measurements ----------------------------------------------------------------------------------------------------


def noisy(rng: Rng, y: Array, level: float, colour: float = 0.0) -> Array:
    """Outputs with noise of a share of their size, white or of first order."""
    e = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(y.shape), axis=-1)
    return np.asarray(y + level * y.std(axis=-1, keepdims=True) * e)


def moving(rng: Rng, plant: Plant, size: float = 1.0) -> Array:
    """Free motions of the size of the residues."""
    phases = np.exp(2j * np.pi * rng.uniform(size=len(plant.poles)))
    return np.asarray(size * phases[:, None] * np.abs(plant.residues).max(axis=2))


def recorded(
    rng: Rng, plant: Plant, samples: int, level: float = 0.04, *, hold: str = "zoh", colour: float = 0.0,
    start: float = 0.0, u: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Inputs, white by default, and outputs; of one channel vectors."""
    u = rng.standard_normal((plant.residues.shape[2], samples)) if u is None else np.atleast_2d(u)
    y = noisy(rng, plant.output(u, moving(rng, plant, start), hold), level, colour)
    return (u[0], y[0]) if len(u) == len(y) == 1 else (u, y)


def responded(rng: Rng, plant: Plant, lines: int, level: float = 0.01, high: float = 0.8) -> FrequencyResponseData:
    """Frequency response with noise of a share of the median of each entry."""
    omega = np.linspace(0.01, high, lines) * NYQUIST
    H = plant.response(omega)
    e = rng.standard_normal((*H.shape, 2)) @ [1, 1j]
    return FrequencyResponseData(H + level * np.median(np.abs(H), axis=-1, keepdims=True) * e, omega)


def hits(samples: int, count: int = 1) -> Array:
    """Force of a hammer, blows of five samples."""
    u = np.zeros(samples)
    for k in range(count):
        u[20 + k * samples // count :][:5] = [0.3, 0.9, 1.0, 0.8, 0.25]
    return u


# --- kinds -----------------------------------------------------------------------------------------------------------

Maker = Callable[[Rng, int], Record]
KINDS: dict[str, tuple[int, Maker]] = {}


def kind(count: int) -> Callable[[Maker], Maker]:
    """Make a function a kind of which so many seeds are recorded."""

    def added(make: Maker) -> Maker:
        KINDS[make.__name__] = count, make
        return make

    return added


def record(name: str, place: int) -> tuple[int, Record]:
    """Seed, and the record made from it."""
    seed = zlib.crc32(f"{name} {place}".encode())
    return seed, KINDS[name][1](np.random.default_rng(seed), place)


def _lossless(
    rng: Rng, n: int, samples: int, level: float = 0.04, *, keywords: dict[str, Any] | None = None, **how: Any
) -> Record:
    plant = collocated(rng, frequencies(rng, n))
    return Record(plant, recorded(rng, plant, samples, level, **how), {"dt": STEP, **(keywords or {})})


@kind(6)
def plain(rng: Rng, k: int) -> Record:
    return _lossless(rng, k + 1, 1200)


@kind(8)
def close_together(rng: Rng, k: int) -> Record:
    """Some modes in few bins, some of them two bins apart."""
    plant = collocated(rng, frequencies(rng, 4 + k % 3, 0.008, 0.065, 0.1))
    return Record(plant, recorded(rng, plant, 2000, 0.03), {"dt": STEP})


@kind(4)
def exact(rng: Rng, k: int) -> Record:
    return _lossless(rng, k + 1, 900, 0.0)


@kind(4)
def faint_noise(rng: Rng, k: int) -> Record:
    return _lossless(rng, k + 1, 1000, 2e-6)


@kind(5)
def loud_noise(rng: Rng, k: int) -> Record:
    return _lossless(rng, 3, 2400, 1.1)


@kind(7)
def order_given(rng: Rng, k: int) -> Record:
    n = (1, 2, 3, 5, 8, 13, 20)[k]
    return _lossless(rng, n, 400 * n + 600, keywords={"order": n})


@kind(3)
def many(rng: Rng, k: int) -> Record:
    return _lossless(rng, 11 + 3 * k, 3500)


@kind(2)
def many_exact(rng: Rng, k: int) -> Record:
    return _lossless(rng, 9 + k, 2600, 0.0)


@kind(1)
def crowd(rng: Rng, k: int) -> Record:
    return _lossless(rng, 23, 5500, keywords={"max_order": 36})


@kind(2)
def long(rng: Rng, k: int) -> Record:
    return _lossless(rng, 2 + k, 35_000)


@kind(1)
def very_long(rng: Rng, k: int) -> Record:
    return _lossless(rng, 3, 100_000)


@kind(6)
def short(rng: Rng, k: int) -> Record:
    return _lossless(rng, 1 + k % 2, 60, 0.02)


@kind(3)
def brief(rng: Rng, k: int) -> Record:
    return _lossless(rng, 1 + k, 130)


@kind(4)
def tiny(rng: Rng, k: int) -> Record:
    return _lossless(rng, 1, 38)


@kind(4)
def decay(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, k + 1))
    _, y = recorded(rng, plant, 1100, u=np.zeros(1100), start=1.0)
    return Record(plant, (None, y), {"dt": STEP})


@kind(4)
def linear_hold(rng: Rng, k: int) -> Record:
    return _lossless(rng, k + 2, 1400, hold="foh")


@kind(3)
def moving_at_first(rng: Rng, k: int) -> Record:
    return _lossless(rng, k + 2, 1000, start=3.0)


@kind(4)
def delayed(rng: Rng, k: int) -> Record:
    made = _lossless(rng, k + 1, 1500)
    u, y = made.data
    lag = 2 + k
    return Record(made.plant, (u[lag:], np.r_[y[:-lag]]), made.keywords)


@kind(4)
def offset(rng: Rng, k: int) -> Record:
    made = _lossless(rng, k + 1, 1300)
    u, y = made.data
    return Record(made.plant, (u, y + (1.7 + k) * y.std()), made.keywords)


@kind(2)
def drifting(rng: Rng, k: int) -> Record:
    made = _lossless(rng, k + 2, 1300)
    u, y = made.data
    return Record(made.plant, (u, y + y.std() * np.linspace(-1.5, 2.0, len(y))), made.keywords)


@kind(4)
def missing(rng: Rng, k: int) -> Record:
    made = _lossless(rng, 3, 1800)
    u, y = made.data
    return Record(made.plant, (u, np.where(rng.random(len(y)) < 0.12, np.nan, y)), made.keywords)


@kind(3)
def gap(rng: Rng, k: int) -> Record:
    made = _lossless(rng, 2 + k, 1600)
    u, y = made.data
    y[500:760] = np.nan
    return Record(made.plant, (u, y), made.keywords)


@kind(3)
def two_experiments(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, k + 2))
    parts = [recorded(rng, plant, samples, start=1.0) for samples in (700, 950)]
    return Record(plant, parts, {"dt": STEP})


@kind(4)
def coloured(rng: Rng, k: int) -> Record:
    return _lossless(rng, k + 2, 2100, 0.06, colour=0.85)


@kind(3)
def tones(rng: Rng, k: int) -> Record:
    t = STEP * np.arange(2000)
    return _lossless(rng, 3, 2000, u=sum(np.sin(w * t + w) for w in NYQUIST * np.array([0.03, 0.09, 0.17, 0.4, 0.62])))


@kind(3)
def near_nyquist(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, 3, 0.5, 0.97))
    return Record(plant, recorded(rng, plant, 1900), {"dt": STEP})


@kind(3)
def step(rng: Rng, k: int) -> Record:
    return _lossless(rng, k + 2, 1700, u=(np.arange(1700) > 60).astype(float))


@kind(4)
def close(rng: Rng, k: int) -> Record:
    d = 0.3 * NYQUIST + np.array([0.0, (3.5 - 0.5 * k) * np.pi / (1500 * STEP)])
    plant = collocated(rng, d)
    return Record(plant, recorded(rng, plant, 1500), {"dt": STEP})


@kind(4)
def response(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, k + 1))
    return Record(plant, responded(rng, plant, 450))


@kind(4)
def noisy_response(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, k + 2))
    return Record(plant, responded(rng, plant, 450, 0.06))


@kind(1)
def crowded_response(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, 14))
    return Record(plant, responded(rng, plant, 1400), {"max_order": 25})


@kind(6)
def few_lines(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, 1), 0.02)
    return Record(plant, responded(rng, plant, 12 + 2 * k, 0.004), {"order": 1} if k % 2 else {})


def _damped(rng: Rng, n: int, zeta: tuple[float, float], quantity: str = "velocity") -> Plant:
    return collocated(rng, frequencies(rng, n), rng.uniform(*zeta, n), quantity)


@kind(5)
def light_damping(rng: Rng, k: int) -> Record:
    plant = _damped(rng, k + 1, (8e-4, 1.5e-3))
    return Record(plant, recorded(rng, plant, 1600), {"dt": STEP})


@kind(5)
def damped(rng: Rng, k: int) -> Record:
    plant = _damped(rng, k + 1, (4e-3, 4e-2))
    return Record(plant, recorded(rng, plant, 1600), {"dt": STEP})


@kind(1)
def many_damped(rng: Rng, k: int) -> Record:
    plant = _damped(rng, 10, (3e-3, 2e-2))
    return Record(plant, recorded(rng, plant, 5000), {"dt": STEP})


@kind(3)
def damped_linear_hold(rng: Rng, k: int) -> Record:
    plant = _damped(rng, k + 1, (4e-3, 3e-2))
    return Record(plant, recorded(rng, plant, 1500, hold="foh"), {"dt": STEP, "intersample": "foh"})


@kind(3)
def damped_decay(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((2 + k, 3)), frequencies(rng, 2 + k), 0.006, [0, 1, 2], [0])
    _, y = recorded(rng, plant, 900, u=np.zeros((1, 900)), start=1.0)
    return Record(plant, (None, y), {"dt": STEP})


@kind(6)
def quantities(rng: Rng, k: int) -> Record:
    quantity = tuple(POWERS)[k % 3]
    plant = collocated(rng, frequencies(rng, 2), 0.012 if k > 2 else 0.0, quantity)
    return Record(plant, recorded(rng, plant, 1500), {"dt": STEP, "quantity": quantity})


@kind(4)
def damped_order_given(rng: Rng, k: int) -> Record:
    plant = scattered(rng, frequencies(rng, 2 + k), rng.uniform(4e-3, 3e-2, 2 + k), 2, 1)
    return Record(plant, recorded(rng, plant, 1300), {"dt": STEP, "order": 2 + k, "structure": "free"})


@kind(12)
def structures(rng: Rng, k: int) -> Record:
    name = ("lossless", "classical", "passive", "free")[k % 4]
    shapes, d = rng.standard_normal((3, 3)), frequencies(rng, 3)
    plant = structure(shapes, d, 0.0 if name == "lossless" else 0.01, [0, 1], [0])
    if k % 12 > 7:
        plant = collocated(rng, d, 0.0 if name == "lossless" else 0.01)
    keywords = {"dt": STEP, "structure": name, "order": 3, "ports": [(0, 0)]}
    return Record(plant, recorded(rng, plant, 1200), keywords)


@kind(3)
def one_by_four(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((3, 4)), frequencies(rng, 3), 0.01, [0, 1, 2, 3], [0])
    return Record(plant, recorded(rng, plant, 1200), {"dt": STEP, "ports": [(0, 0)]})


@kind(4)
def two_by_three(rng: Rng, k: int) -> Record:
    plant = scattered(rng, frequencies(rng, 3), rng.uniform(4e-3, 3e-2, 3), 3, 2)
    return Record(plant, recorded(rng, plant, 1300), {"dt": STEP})


@kind(3)
def three_by_three(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((3, 3)), frequencies(rng, 3), 0.008, [0, 1, 2], [0, 1, 2])
    return Record(plant, recorded(rng, plant, 1200), {"dt": STEP, "ports": [(0, 0), (1, 1), (2, 2)]})


@kind(3)
def coloured_channels(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((2, 2)), frequencies(rng, 2), 0.012, [0, 1], [0])
    return Record(plant, recorded(rng, plant, 1600, 0.08, colour=0.8), {"dt": STEP})


@kind(3)
def several_experiments(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((2 + k, 3)), frequencies(rng, 2 + k), 0.01, [0, 1, 2], [1])
    parts = [recorded(rng, plant, samples, start=0.5) for samples in (600, 800, 500)]
    return Record(plant, parts, {"dt": STEP})


@kind(2)
def missing_channels(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((2, 3)), frequencies(rng, 2), 0.01, [0, 1, 2], [0])
    u, y = recorded(rng, plant, 1400)
    y[1, 300:420], y[2, rng.random(1400) < 0.1] = np.nan, np.nan
    return Record(plant, (u, y), {"dt": STEP})


@kind(6)
def response_of_quantity(rng: Rng, k: int) -> Record:
    quantity = tuple(POWERS)[k % 3]
    plant = structure(rng.standard_normal((3, 2)), frequencies(rng, 3), 0.012, [0, 1], [0], quantity)
    keywords = {"quantity": quantity, "ports": [(0, 0)]} | ({"order": 3} if k > 2 else {})
    return Record(plant, responded(rng, plant, 350), keywords)


@kind(2)
def response_of_four(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((3, 4)), frequencies(rng, 3), 0.01, [0, 1, 2, 3], [2], "acceleration")
    return Record(plant, responded(rng, plant, 400), {"quantity": "acceleration", "ports": [(2, 0)]})


@kind(4)
def response_matrix(rng: Rng, k: int) -> Record:
    plant = structure(rng.standard_normal((3, 3)), frequencies(rng, 3), 0.01, [0, 1, 2][: 2 + k % 2], [0, 1])
    return Record(plant, responded(rng, plant, 300), {"ports": [(0, 0), (1, 1)]})


@kind(3)
def response_of_phase(rng: Rng, k: int) -> Record:
    plant = scattered(rng, frequencies(rng, 3), rng.uniform(5e-3, 3e-2, 3), 3, 1)
    return Record(plant, responded(rng, plant, 350))


@kind(6)
def hammer(rng: Rng, k: int) -> Record:
    shapes = rng.standard_normal((3, 1 if k < 3 else 3))
    plant = structure(shapes, frequencies(rng, 3, 0.03, 0.4), 0.008, list(range(shapes.shape[1])), [0], "acceleration")
    data = recorded(rng, plant, 2400, 0.02, u=hits(2400, 3))
    return Record(plant, data, {"dt": STEP, "quantity": "acceleration"})


@kind(3)
def roving_hammer(rng: Rng, k: int) -> Record:
    plant = structure(
        rng.standard_normal((3, 3)), frequencies(rng, 3, 0.03, 0.4), 0.008, [0], [0, 1, 2], "acceleration"
    )
    parts = []
    for place in range(3):
        u = np.zeros((3, 900))
        u[place] = hits(900)
        parts.append(recorded(rng, plant, 900, 0.02, u=u))
    return Record(plant, parts, {"dt": STEP, "quantity": "acceleration", "ports": [(0, 0)]})


@kind(4)
def rigid_body(rng: Rng, k: int) -> Record:
    plant = collocated(rng, frequencies(rng, 2), 0.01 if k else 0.0, "acceleration")
    heavy = Plant(plant.poles, plant.residues, plant.feedthrough + 0.4)
    return Record(heavy, recorded(rng, heavy, 1300), {"dt": STEP, "quantity": "acceleration"})


@kind(3)
def pure_noise(rng: Rng, k: int) -> Record:
    nothing = Plant(np.zeros(0, complex), np.zeros((0, 1, 1)), np.zeros((1, 1)))
    return Record(nothing, tuple(rng.standard_normal((2, 500 + 300 * k))), {"dt": STEP})

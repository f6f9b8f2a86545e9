"""Monte Carlo of the search for damped modes with free residues, from nothing but data and the order.

python -m benchmarks.modal_convergence [--configuration NAME ...] [--seeds N] [--first SEED]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from time import process_time

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ph_control.identification.data.experiments import as_channels
from ph_control.identification.moves.free_fit import free_fit
from ph_control.identification.search.fitted_modes import FreeFit

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

ALLOWED = 5.0  # standard errors of every frequency and damping ratio
SAME = 1e-3  # difference of log-likelihoods that counts as none
DISTANCE = 3.0  # bins between modes, beside their half-widths
BAND = (0.05 * np.pi, 0.9 * np.pi)  # rad per sample
SHARES = 10.0  # ratio of the powers that the strongest and the weakest mode contribute, at most


@dataclass(frozen=True)
class Modal:
    """Modes, samples, signal-to-noise ratio in dB, damping ratios between two ends, inputs, outputs."""

    n: int
    samples: int
    snr: float
    lowest: float
    highest: float
    inputs: int = 1
    outputs: int = 1


CONFIGURATIONS = {
    "2": Modal(2, 1000, 20, 1e-3, 2e-2),
    "5": Modal(5, 2000, 20, 1e-3, 2e-2),
    "5-noisy": Modal(5, 4000, 10, 2e-3, 2e-2),
    "10": Modal(10, 8000, 20, 1e-3, 1e-2),
    "20": Modal(20, 20_000, 20, 5e-4, 5e-3),
    "5-2x4": Modal(5, 4000, 20, 1e-3, 2e-2, 2, 4),
    "10-2x4": Modal(10, 4000, 20, 1e-3, 1e-2, 2, 4),
}


def drawn_poles(case: Modal, rng: np.random.Generator) -> ComplexArray:
    """Frequencies uniform in the band, logarithms of damping ratios uniform; peaks apart by three bins and more."""
    p = np.zeros(0, complex)
    while len(p) < case.n:
        d, zeta = rng.uniform(*BAND), np.exp(rng.uniform(np.log(case.lowest), np.log(case.highest)))
        one = d * complex(-zeta, np.sqrt(1 - zeta**2))
        apart = DISTANCE * 2 * np.pi / case.samples + abs(one.real) + np.abs(p.real)
        if np.all(np.abs(p.imag - one.imag) > apart):
            p = np.append(p, one)
    return p[np.argsort(np.abs(p))]


def drawn(case: Modal, seed: int) -> tuple[ComplexArray, Array, Array]:
    """Poles, inputs (white) and outputs; residues have any sign and phase, and one noise for each output."""
    rng = np.random.default_rng(seed)
    p = drawn_poles(case, rng)
    u = rng.standard_normal((case.inputs, case.samples))
    y = np.zeros((case.outputs, case.samples))
    for one in p:
        parts = rng.standard_normal((2, case.outputs + case.inputs))
        c, b = np.split(parts[0] + 1j * parts[1], [case.outputs])
        lam = np.exp(one)
        states = lfilter([0.0, (lam - 1) / one], [1.0, -lam], u.astype(complex))
        motion = 2 * (np.outer(c, b) @ states).real
        y += motion * np.sqrt(SHARES ** rng.uniform(-1, 0) / np.mean(motion**2))
    noise = 10 ** (-case.snr / 20) * np.std(y, axis=1, keepdims=True)
    return p, u, y + noise * rng.standard_normal(y.shape)


def scores(fit: FreeFit, p: ComplexArray) -> Array:
    """Errors of natural frequencies and damping ratios in standard errors."""
    n, found = len(p), fit.projection.p
    w, x, d = found.imag, found.real, np.abs(found)
    k, T = np.arange(n), np.zeros((2 * n, 2 * n))
    T[k, k], T[k, n + k], T[n + k, k], T[n + k, n + k] = w / d, x / d, x * w / d**3, -(w**2) / d**3
    errors = np.sqrt(np.diag(T @ fit.covariance[: 2 * n, : 2 * n] @ T.T))
    return np.concatenate([d - np.abs(p), -x / d + p.real / np.abs(p)]) / errors


def one_seed(case: Modal, seed: int) -> tuple[bool, float, float, float]:
    """Whether the search succeeds; largest score, log-likelihood short of that from the truth, and seconds."""
    p, u, y = drawn(case, seed)
    channels = as_channels((u, y), 1.0)
    start = process_time()
    fit = free_fit(channels, case.n, intersample="zoh")
    seconds = process_time() - start
    best = free_fit(channels, case.n, intersample="zoh", start=p)
    largest = float(np.abs(scores(fit, p)).max())
    short = best.criteria.loglik - fit.criteria.loglik
    return largest < ALLOWED and short < SAME, largest, short, seconds


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.modal_convergence", description=__doc__.splitlines()[0])
    parser.add_argument("--configuration", nargs="*", choices=CONFIGURATIONS, default=list(CONFIGURATIONS))
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    for name in options.configuration:
        case, times, good = CONFIGURATIONS[name], [], 0
        for seed in range(options.first, options.first + options.seeds):
            success, largest, short, seconds = one_seed(case, seed)
            times.append(seconds)
            good += success
            if not success:
                print(f"{name}, seed {seed}: largest score {largest:.1f}, log-likelihood {short:.3g} short", flush=True)
        print(f"{case}: {good} of {options.seeds}; median {np.median(times):.2f} s, at most {np.max(times):.2f} s",
              flush=True)  # fmt: skip


if __name__ == "__main__":
    main()

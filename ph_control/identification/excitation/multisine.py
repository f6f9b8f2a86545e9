"""Sums of sines with given powers and a low peak factor: phases by rounds of clipping."""

from __future__ import annotations

import numpy as np

from ..._types import Array, ComplexArray, Indices

_ROUNDS = 800  # of clipping, from each start
_WORK = 8e6  # samples of all rounds from a start, of a long signal
_FEWEST = 60
_STARTS = 3  # sets of phases: Schroeder's, and random ones
_CLIP = (0.70, 0.98)  # of the peak that is kept, in the first and the last round


def low_peak_multisine(power: Array, lines: Indices, samples: int, effort: float = 1.0) -> Array:
    """Signal (samples,) whose Fourier frequencies `lines` have these mean powers; `effort` is a part of all rounds.

    Each round clips the peaks, keeps the phases of what is left, and restores the powers (van der Ouderaa, Schoukens
    and Renneboog, 1988); the signal of the lowest peak of all is returned.
    """
    rounds = int(max(_FEWEST, effort * min(_ROUNDS, _WORK / samples)))
    amplitudes = samples * np.sqrt(0.5 * power)
    rng, best, lowest = np.random.default_rng(0), np.zeros(samples), np.inf
    starts = [_schroeder(power), *(2 * np.pi * rng.random(len(lines)) for _ in range(_STARTS - 1))]
    for phases in starts:
        spectrum = amplitudes * np.exp(1j * phases)
        for keep in np.linspace(*_CLIP, rounds):
            signal = _synthesised(spectrum, lines, samples)
            peak = float(np.abs(signal).max())
            if peak < lowest:
                best, lowest = signal, peak
            turned = np.fft.rfft(np.clip(signal, -keep * peak, keep * peak))[lines]
            spectrum = amplitudes * np.exp(1j * np.angle(turned))
    return best


def _schroeder(power: Array) -> Array:
    """Phases of a sweep with this spectrum (Schroeder, 1970)."""
    share = np.concatenate([[0.0], np.cumsum(power)[:-1]]) / power.sum()
    return np.asarray(-2 * np.pi * np.cumsum(share))


def _synthesised(spectrum: ComplexArray, lines: Indices, samples: int) -> Array:
    whole = np.zeros(samples // 2 + 1, complex)
    whole[lines] = spectrum
    return np.asarray(np.fft.irfft(whole, samples))

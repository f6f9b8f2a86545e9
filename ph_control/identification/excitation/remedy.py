"""What input would show what this one does not: each answer is tried before it is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..._types import Array, ComplexArray
from ..._units import rate
from ..uncertainty.fisher import PortRecord, listed, model_information, work
from .excited_band import ExcitedBand

_WORK = 1e10  # operations of the factorisations that are tried, up to one for each mode; beyond, none is tried
_MARGIN = (0.5, 1.25)  # of the lowest and highest frequency: the band of a broadband input
_MOST_LINES = 6  # that are advised one by one
_FEWEST_LINES = 16  # of a multisine


def input_remedy(
    problem: PortRecord,
    d: Array,
    r: Array,
    amplitudes: ComplexArray,
    band: ExcitedBand,
    *,
    missing: int,
    lengthen: bool,
) -> str | None:
    """Change of the input that makes every combination of a model (n,) visible, in words; None if there is none.

    `missing` combinations are blind now.  With `lengthen`, longer records are tried where no input of this length is
    enough.
    """
    low, high = _MARGIN[0] * float(d.min()), min(_MARGIN[1] * float(d.max()), 0.95 * np.pi / problem.hold.h)
    if low >= high:
        return None
    unit = rate(band.time_unit)
    over = f"over {low:.2g} .. {high:.2g} {unit}"
    broadband = f"use a white or multisine input of the same length {over}"
    if len(d) * work(problem, len(d)) > _WORK:
        return broadband

    def shows_all(u: Array) -> bool:
        observed = problem.observed if len(u) == len(problem.u) else np.ones(len(u), bool)
        other = replace(problem, u=u, y=np.zeros(len(u)), observed=observed)
        return not model_information(other, d, r, amplitudes).is_weak

    size = _amplitude(problem.u)
    parts = []
    # beside a free motion that is not known, a line shows one combination of weights
    fewest = 1 if problem.from_rest else min(max(1, missing), len(d))
    lines = _lines_to_add(problem, d[r > 0], band, size, fewest, shows_all) if fewest <= _MOST_LINES else []
    if lines:
        several = len(lines) > 1
        parts.append(f"add {'frequencies' if several else 'a frequency'} near {listed(lines)} {unit} to the input")
    if shows_all(size * multisine(len(problem.u), problem.hold.h, low, high)):
        parts.append(broadband)
    if parts:
        return ", or ".join(parts)
    for factor in (2, 4, 8) if lengthen else ():
        samples = factor * len(problem.u)
        if shows_all(size * multisine(samples, problem.hold.h, low, high)):
            return f"record {factor} times as long ({samples} samples) with a white or multisine input {over}"
    return None


def multisine(samples: int, dt: float, low: float, high: float) -> Array:
    """Sum of sines of unit power over a band, with Schroeder's phases: the Fourier frequencies in it, or 16 if more."""
    spacing = 2 * np.pi / (samples * dt)
    bins = np.arange(int(np.ceil(low / spacing)), min(int(high / spacing) + 1, samples // 2))
    if len(bins) >= _FEWEST_LINES:
        k = np.arange(len(bins))
        spectrum = np.zeros(samples // 2 + 1, complex)
        spectrum[bins] = np.exp(1j * np.pi * k * k / len(bins))
        return np.asarray(np.fft.irfft(spectrum, samples) * samples / np.sqrt(2.0 * len(bins)))
    k = np.arange(_FEWEST_LINES)
    omega = low + (high - low) * k / (_FEWEST_LINES - 1)
    waves = np.cos(np.outer(omega, dt * np.arange(samples)) + (np.pi * k * k / _FEWEST_LINES)[:, None])
    return np.asarray(waves.sum(axis=0) * np.sqrt(2.0 / _FEWEST_LINES))


def _amplitude(u: Array) -> float:
    """Size of a sine as strong as the input; 1 where there is none."""
    deviation = float(np.std(u / peak) * peak) if (peak := float(np.abs(u).max())) > 0 else 0.0
    return np.sqrt(2.0) * deviation or peak or 1.0


def _lines_to_add(
    problem: PortRecord, d: Array, band: ExcitedBand, size: float, fewest: int, shows_all: Callable[[Array], bool]
) -> list[str]:
    """Fewest frequencies, of those of the modes, that cure the input when added; empty if they do not."""
    centres = np.array([0.5 * (low + high) for low, high in band.intervals])
    distance = np.abs(d[:, None] - centres).min(axis=1) if len(centres) else d
    t = problem.hold.h * np.arange(len(problem.u))
    u, added = problem.u, []
    for mode in np.argsort(-distance, kind="stable"):
        word = f"{d[mode]:.2g}"
        if word in added or float(word) >= np.pi / problem.hold.h:
            continue
        u = u + size * np.sin(float(word) * t)
        added.append(word)
        if len(added) >= fewest and shows_all(u):
            return sorted(added, key=float)
    return []

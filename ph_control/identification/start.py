"""Where to start: forward selection of modes with local fits in the frequency domain.

The transform of a finite record obeys, exactly and for every mode,

    X_m = (kappa b U_m + z_m tau) / (z_m - lambda),      z_m = exp(2 pi i m / T),   tau = x_0 - x_T,

so around each Fourier bin one mode is three unknowns (`kappa`, complex `tau`) in a linear problem over a few
bins.  The frequency whose mode explains most of the residual is taken, all modes are refined jointly, repeat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .solver import Problem

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_WINDOW = 12  # bins around a candidate
_OFFSETS = np.array([-0.375, -0.125, 0.125, 0.375])  # candidates in every bin, never on it
_BATCH = 1 << 14


def strongest_mode(problem: Problem, residual: Array) -> float:
    """Natural frequency of the mode that explains most of a residual (T,), missing samples being 0."""
    samples = len(residual)
    half = samples // 2
    E, U = np.fft.fft(residual), np.fft.fft(problem.u)
    places = (np.arange(half + 1)[:, None] + _OFFSETS).ravel()
    phase = 2 * np.pi * places / samples
    usable = (places > 0) & (phase < problem.hold.largest_phase * (1 - 1e-9))
    places, phase = places[usable], phase[usable]
    gains = np.concatenate(
        [
            _explained(problem, E, U, places[i : i + _BATCH], phase[i : i + _BATCH], half)
            for i in range(0, len(places), _BATCH)
        ]
    )
    return float(problem.hold.frequency_of(phase[[int(np.argmax(gains))]])[0])


def _explained(problem: Problem, E: ComplexArray, U: ComplexArray, places: Array, phase: Array, half: int) -> Array:
    """Energy of the residual that one mode at each candidate explains within its window, `kappa >= 0`."""
    samples = len(E)
    width = min(_WINDOW, half)
    first = np.clip(np.rint(places).astype(int) - width // 2, 0, half - width)
    bins = first[:, None] + np.arange(width + 1)
    step = problem.hold.step(problem.hold.frequency_of(phase))
    z = np.exp(2j * np.pi * bins / samples)
    lam = step.multiplier[:, None]
    drive = (step.b0 + step.b1 * z) * U[bins]
    mirrored = (step.b0.conj() + step.b1.conj() * z) * U[bins]
    right, left = 0.5 / (z - lam), 0.5 / (z - lam.conj())
    columns = np.stack([drive * right + mirrored * left, z * (right + left), 1j * z * (right - left)], axis=2)
    scale = np.sqrt(np.sum(np.abs(columns) ** 2, axis=1))
    columns = columns / np.where(scale > 0, scale, 1.0)[:, None, :]
    gram = np.einsum("cwi,cwj->cij", columns.conj(), columns).real + 1e-9 * np.eye(3)
    rhs = np.einsum("cwi,cw->ci", columns.conj(), E[bins]).real
    full = np.linalg.solve(gram, rhs[:, :, None])[:, :, 0]
    states_only = np.linalg.solve(gram[:, 1:, 1:], rhs[:, 1:, None])[:, :, 0]
    return np.where(full[:, 0] >= 0, np.sum(full * rhs, axis=1), np.sum(states_only * rhs[:, 1:], axis=1))

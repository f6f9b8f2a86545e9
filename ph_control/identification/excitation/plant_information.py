"""Fisher information of a plant with losses: of a record, and of each line in the spectrum of an input.

    F = sum_k J_k^H S_k^{-1} J_k,          J_k = d(G(z_k) U_k + free motion) / d theta

at the Fourier frequencies of a record, with the noise of spectrum `S`; free motions are unknown and eliminated.  Beside
them the information is linear in the power of each line of the input.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ... import _checks
from ..._types import Array, ComplexArray, Indices, Mask, RealOrComplex
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ..data.channels import Recording
from ..regression.elimination import eliminate, reduced
from ..regression.free import pole_derivatives
from ..regression.modal_regressors import SampledModes
from ..regression.time_rows import FreeRecord
from ..uncertainty.fisher import Information
from ..uncertainty.noise_model import NoiseModel
from .planned_plant import PlannedPlant, acting_together

_MOST_NUMBERS = 1 << 28  # in the sensitivities of outputs that are looked at together: 2 GB


def plant_information(
    plant: PlannedPlant, inputs: Sequence[Array], holds: Sequence[Hold], noise: NoiseModel,
    motions: Sequence[ComplexArray] | None = None, *, observed: Sequence[Mask] | None = None, from_rest: bool = False,
) -> Information:  # fmt: skip
    """Information of records with inputs (m, T) about the unknowns of a plant.

    `motions` (N, q) of each record are free motions `2 Re(motion exp(p t))`, by default 0; they are unknown unless the
    record is known to begin `from_rest`.  Outputs count where they are `observed` (q, T), by default everywhere.
    """
    parts, rows = [], 0
    for k, (u, hold) in enumerate(zip(inputs, holds, strict=True)):
        motion = np.zeros((len(plant.p), plant.outputs), complex) if motions is None else motions[k]
        record = RecordSensitivities(plant, u, hold, motion, from_rest)
        seen = np.ones((plant.outputs, u.shape[1]), bool) if observed is None else observed[k]
        parts += [record.of(group, noise, seen[group]) for group in acting_together(noise)]
        rows += u.shape[1] * plant.outputs
    return Information.of(np.concatenate(parts), plant.unknowns.names, rows=rows)


class RecordSensitivities:
    """Sensitivities of the outputs of a record: at its samples beside white noise, else at the Fourier frequencies."""

    def __init__(self, plant: PlannedPlant, u: Array, hold: Hold, motion: ComplexArray, from_rest: bool) -> None:
        self._plant, self._u, self._hold, self._rest = plant, u, hold, from_rest
        self._free_motion, n, through = motion, len(plant.p), plant.has_feedthrough
        self._rows = FreeRecord(
            u, np.zeros((1, u.shape[1])), np.ones(u.shape[1], bool), hold, through=through, among=np.arange(len(u))
        )
        columns = np.concatenate(list(self._rows.evaluated(plant.p).blocks()), axis=1)[:-1].T
        own, shared = 2 * n, (2 * n + through) * plant.inputs
        self._motion, self._shared = columns[:, :own], columns[:, own : own + shared]
        self._slopes = columns[:, own + shared :]

    def of(self, outputs: Indices, noise: NoiseModel, observed: Mask) -> Array:
        """Sensitivities of some outputs in units of their noise, free motions eliminated, in a few rows."""
        unknowns = self._plant.unknowns
        own = 0 if self._rest else self._motion.shape[1]
        # residues of other outputs do nothing here
        near = np.any(unknowns.by_poles, axis=0) | np.any(unknowns.by_shared[outputs], axis=(0, 1))
        width = int(near.sum()) + own * len(outputs)
        refuse_size(self._u.shape[1] * len(outputs) * width)
        J = np.zeros((self._u.shape[1], len(outputs), width))
        for k, o in enumerate(outputs.tolist()):
            if own:
                J[:, k, k * own : (k + 1) * own] = self._motion
            amplitudes = np.concatenate([self._free_motion[:, o].real, self._free_motion[:, o].imag])
            slopes = pole_derivatives(self._slopes, self._rows, amplitudes, self._plant.residues[:, o])
            J[:, k, len(outputs) * own :] = slopes @ unknowns.by_poles[:, near]
            J[:, k, len(outputs) * own :] += self._shared @ unknowns.by_shared[o][:, near]
        _checks.representable("the sensitivities of the outputs", J)
        factor = reduced(np.asfortranarray(self._in_units_of(noise, J, outputs, observed)))
        below = eliminate(factor, own * len(outputs), self._u.shape[1]).below
        sensitivities = np.zeros((len(below), len(near)))
        sensitivities[:, near] = below
        return sensitivities

    def _in_units_of(self, noise: NoiseModel, J: Array, outputs: Indices, observed: Mask) -> Array:
        """Rows (T, q, r) in which the noise is white and of unit size, one under another."""
        everywhere = observed.all(axis=0)
        if noise.is_white:
            factor = _factor(noise.covariance[np.ix_(outputs, outputs)])
            return np.asarray(np.linalg.solve(factor, J[everywhere]).reshape(-1, J.shape[2]))
        if not everywhere.all():
            raise StructureError(
                f"the noise has colours or comes from forces, and {int(np.sum(~everywhere))} samples are missing: pass "
                "a record without gaps, or give noise_std"
            )
        T, transforms = len(J), np.fft.rfft(J, axis=0)
        omega = np.asarray(2 * np.pi * np.arange(len(transforms)) / (T * self._hold.h), float)
        # of real signals each line stands for two but at both ends
        weight = np.full(len(omega), np.sqrt(2.0 / T))
        weight[0] = np.sqrt(1.0 / T)
        weight[-1] = np.sqrt((1.0 + T % 2) / T)
        white = (whitened(transforms, noise, omega, outputs) * weight[:, None, None]).reshape(-1, J.shape[2])
        return np.concatenate([white.real, white.imag])

    def fitted(self, record: Recording) -> tuple[ComplexArray, Array, Array]:
        """Free motions (N, q) next to the outputs of a record, squares that remain, and values to spare (q,)."""
        n, outputs = len(self._plant.p), self._plant.outputs
        motion, squares, spare = np.zeros((n, outputs), complex), np.zeros(outputs), np.zeros(outputs)
        residues, columns = self._plant.residues, np.zeros((len(self._u.T), 0)) if self._rest else self._motion
        for o in range(outputs):
            each = np.stack([residues[:, o].real, residues[:, o].imag], axis=0).transpose(2, 0, 1)
            known = each.reshape(self._plant.inputs, 2 * n)
            if self._plant.has_feedthrough:
                known = np.column_stack([known, self._plant.feedthrough[o]])
            seen = record.observed[o]
            residual = (record.y[o] - self._shared @ known.ravel())[seen]
            amplitudes = np.linalg.lstsq(columns[seen], residual, rcond=None)[0]
            residual = residual - columns[seen] @ amplitudes
            if len(amplitudes):
                motion[:, o] = amplitudes[:n] + 1j * amplitudes[n:]
            squares[o], spare[o] = residual @ residual, len(residual) - len(amplitudes)
        return motion, squares, spare


def refuse_size(numbers: int) -> None:
    """Refuse sensitivities of so many real numbers."""
    if numbers > _MOST_NUMBERS:
        raise StructureError(
            f"the sensitivities of the outputs are {numbers:.3g} numbers; allowed are {_MOST_NUMBERS:.3g}: take a "
            "shorter record, a narrower band, or a system of the few outputs that see the modes best; of noise that is "
            "white and independent give noise_std"
        )


def whitened(J: ComplexArray, noise: NoiseModel, omega: Array, outputs: Indices) -> ComplexArray:
    """Values (K, q, r) of outputs at frequencies in units in which their noise is white and independent."""
    density = np.moveaxis(noise.spectrum(omega), 2, 0)[np.ix_(np.arange(len(omega)), outputs, outputs)] / noise.dt
    return np.asarray(np.linalg.solve(_factor(density), J))


def _factor(covariance: RealOrComplex) -> RealOrComplex:
    """Triangular root of covariances of noise."""
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        raise StructureError(
            "the covariance of the noise is singular: some combination of outputs has no noise, and its errors would "
            "be 0; give noise_std for each output"
        ) from None


def line_sensitivities(plant: PlannedPlant, omega: Array, hold: Hold, noise: NoiseModel) -> ComplexArray:
    """Sensitivities `S^{-1/2} dG(z)/d theta` at frequencies (K,), shape (K, m, q, P).

    A line of mean power `P` of a record of T samples adds `T P Re(D^H D)` to the information.
    """
    unknowns, (q, m) = plant.unknowns, plant.feedthrough.shape
    refuse_size(2 * len(omega) * q * m * len(unknowns.names))
    z = np.exp(1j * hold.h * omega)[:, None]
    near, far = (_gains(SampledModes.of(hold, p), z) for p in (plant.p, plant.p.conj()))
    D = np.empty((len(omega), m, q, len(unknowns.names)), complex)
    columns = [near[0] + far[0], 1j * (near[0] - far[0]), *[np.ones((len(omega), 1))] * plant.has_feedthrough]
    width, by_shared = unknowns.by_shared.shape[1] // m, np.concatenate(columns, axis=1)
    for i in range(m):
        for o in range(q):
            rho = plant.residues[:, o, i]
            turned = rho * near[1], rho.conj() * far[1]
            slopes = np.concatenate([1j * (turned[0] - turned[1]), turned[0] + turned[1]], axis=1)
            D[:, i, o] = slopes @ unknowns.by_poles
            D[:, i, o] += by_shared @ unknowns.by_shared[o, i * width : (i + 1) * width]
    together = np.moveaxis(D, 1, 2).reshape(len(omega), q, -1)
    for group in acting_together(noise):
        together[:, group] = whitened(together[:, group], noise, omega, group)
    return np.moveaxis(together.reshape(len(omega), q, m, -1), 2, 1)


def _gains(sampled: SampledModes, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Responses of modes at points (K, 1), and their derivatives by the pole, shape (K, N)."""
    lam = sampled.multiplier
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (z - lam)
        above, slope = sampled.b0 + sampled.b1 * z, sampled.b0_slope + sampled.b1_slope * z
        return above * inverse, (slope + above * lam * sampled.turn * inverse) * inverse

"""All numbers of a result, each made from the fitted structure when it is first needed.

The likelihood, the criteria made of it, and the variance of the noise of each output; of each experiment predicted
outputs, first states and free motions with errors, and the shapes of modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray
from ..._units import DERIVATIVES
from ..data.channels import Recording, ResponseMatrix, single
from ..data.frequency_record import FrequencyRecord
from ..diagnosis.fitted_directions import FittedModel
from ..diagnosis.noise_levels import level_of
from ..regression.frequency_rows import FreeResponse
from ..regression.modal_regressors import output_weight
from ..regression.prediction import (
    FittedChannels,
    FittedExperiment,
    ResponseBackground,
    joint_percent,
    natural_jacobian,
    pieces,
    shares_left,
    state_of,
)
from ..regression.time_rows import FreeRecord
from ..search.channel_rows import experiments_of
from ..search.findings import Cause
from ..search.fitted_modes import FreeFit
from ..structure.coordinates import residue_of_unit_weight, weights_of
from .covariance import FittedStructure, covariance_of, roots
from .scaled_shapes import ModeShapes, blocks_of_modes, shape_errors

_Rows = Sequence[tuple[int, Any, Any, Any]]  # place, rows, what belongs to them alone, prediction


@dataclass(frozen=True, eq=False)
class Estimates(FittedStructure):
    """A fitted structure with the covariance of its parameters, mode shapes, experiments and likelihood."""

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters, in the order of `PEMResult.covariance`."""
        return covariance_of(self)

    @cached_property
    def experiments(self) -> tuple[FittedChannels, ...]:
        """Predictions and what belongs to each experiment."""
        return _fitted_channels(self)

    @cached_property
    def shown(self) -> Any:
        """The experiments as a result shows them: those of one input and one output without dimensions for these."""
        return _squeezed(self, self.experiments) if self.is_single else self.experiments

    @cached_property
    def shapes(self) -> tuple[ModeShapes, ComplexArray]:
        """Mode shapes, and their standard errors."""
        return _fitted_shapes(self, self.covariance, self.experiments)

    @cached_property
    def likelihood(self) -> _FittedLikelihood:
        """Likelihood and criteria."""
        return _FittedLikelihood.of(self, self.experiments)

    @cached_property
    def fit_percent(self) -> float:
        """How much of the outputs the prediction has, in per cent."""
        return joint_percent(shares_left([(each.record, each.predicted) for each in self.experiments]))

    @property
    def model(self) -> FittedModel:
        """What the directions of the fit depend on."""
        free, delay = self.free, self.delays[0]
        return FittedModel(
            self.poles, self.residues, self.fit.feedthrough, self.covariance, delay, self.request.quantities,
            free.method, free.intersample,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _FittedLikelihood:
    """Gaussian likelihood of a fit.

    Attributes
    ----------
    samples, unknowns : int
        Number of real samples, and of estimated numbers, variances of the noise among them.
    loss : float
        Mean squared residual; of several outputs the geometric mean of theirs.
    loglik : float
        The logarithm.
    noise_variance : ndarray, shape (p,) or (p, m)
        Of the noise of each output, or entry of a response.
    spare : int
        Samples beyond the unknowns.
    """

    samples: int
    unknowns: int
    loss: float
    loglik: float
    noise_variance: Array
    spare: int

    @classmethod
    def of(cls, structure: FittedStructure, experiments: Sequence[FittedChannels]) -> _FittedLikelihood:
        """Likelihood of a structure by what it leaves of the experiments."""
        fit, free, unknowns = structure.fit, structure.free, _unknowns(structure)
        counts, variances = _variances(experiments, free)
        samples, known = int(counts.sum()), counts > 0
        loglik = float(-0.5 * np.sum(counts[known] * (np.log(2 * np.pi * variances[known]) + 1)))
        loglik += sum(_log_density(data) for data in experiments)
        if free.noise or free.beside is not None:  # that of the innovations, less what a structure costs
            loglik = free.criteria.loglik - 0.5 * (fit.loss - free.projection.loss) / free.variance
        # as variances are divided by it, they are none of the unknowns
        spare = max(1, samples - (unknowns - len(free.scales)))
        noise_variance = (variances * samples / spare).reshape(fit.feedthrough.shape[: 1 + free.per_entry])
        loss = float(np.exp(counts @ np.log(variances) / max(1, samples)))
        return cls(samples, unknowns, loss, loglik, noise_variance, spare)

    @property
    def aic(self) -> float:
        """Criterion of Akaike."""
        return 2 * self.unknowns - 2 * self.loglik

    @property
    def bic(self) -> float:
        """Criterion of Schwarz."""
        return self.unknowns * float(np.log(self.samples)) - 2 * self.loglik


def _unknowns(structure: FittedStructure) -> int:
    """Number of estimated numbers: those of the free fit, less what the structure saves, with delays and variances."""
    fit, free = structure.fit, structure.free
    delays = 0 if fit.delays is None else fit.delays.count
    extra = fit.parameters - delays - (len(free.projection.x) + int(free.projection.excited_unknowns.sum()))
    late = sum(finding.cause is Cause.INPUT_DELAY for finding in free.findings)
    return free.unknowns + min(0, extra) + delays + len(free.scales) + late


def _variances(experiments: Sequence[FittedChannels], free: FreeFit) -> tuple[Array, Array]:
    """Number of real residuals of each output or entry, and the mean square of these, in the same noise.

    That is no smaller than what rounding leaves of outputs.
    """
    counts: Any = 0
    losses: Any = 0.0
    rounded: Any = 0.0
    for data, channel in zip(experiments, free.channels, strict=True):
        known = data.record.observed & ~np.isnan(data.predicted)
        counts = counts + known.sum(axis=-1) * (1 + free.per_entry)
        if isinstance(data.record, ResponseMatrix) and data.record.errors is not None:
            losses = losses + np.nansum(np.abs(data.record.in_noise(data.residuals)) ** 2, axis=-1)
            continue
        if isinstance(channel, Recording):
            rounded = rounded + known.sum(axis=-1) / 12 * (channel.steps * channel.unit / data.noise_scale) ** 2
        if (level := level_of(channel)) is not None:
            rounding = np.broadcast_to(getattr(channel, "rounding", 0.0), level.shape)
            residuals = np.where(known, (data.residuals - rounding) / level, 0.0)
            losses = losses + np.sum(residuals**2, axis=-1) / data.noise_scale**2
            continue
        for weights, _, residuals in pieces([(data.record, data.predicted)]):
            losses = losses + np.sum(weights * np.abs(residuals) ** 2, axis=-1) / data.noise_scale**2
    divisor = np.maximum(np.ravel(counts), 1)
    losses = np.maximum(np.ravel(losses), np.ravel(rounded))
    return np.ravel(counts), np.maximum(losses, np.finfo(float).tiny * divisor) / divisor


def _log_density(data: FittedChannels) -> float:
    """Logarithm of the density of responses over that of their weighted values."""
    if not isinstance(data.record, ResponseMatrix) or data.record.errors is not None:
        return 0.0
    weighted = data.record.observed & (data.record.weights > 0)
    return float(np.log(data.record.weights[weighted]).sum())


def _fitted_channels(structure: FittedStructure) -> tuple[FittedChannels, ...]:
    """Predictions, free motions, offsets and backgrounds of each experiment, from the rows of its outputs."""
    projection, channels = structure.measured, structure.free.channels
    parts = zip(projection.experiments, projection.own, projection.predictions(), strict=True)
    rows: list[list[Any]] = [[] for _ in channels]
    for k, (place, part) in enumerate(zip(experiments_of(projection.experiments, channels), parts, strict=True)):
        rows[place].append((k, *part))
    return tuple(
        _of_recording(structure, channel, mine) if isinstance(channel, Recording)
        else _of_response(structure, channel, mine)
        for channel, mine in zip(channels, rows, strict=True)
    )  # fmt: skip


def _of_recording(structure: FittedStructure, channel: Recording, rows: _Rows) -> FittedChannels:
    """What the fit says of a recording, from its rows."""
    projection, free = structure.measured, structure.free
    n, m, outputs = len(projection.p), len(channel.input_labels), len(free.scales)
    seen = channel.observed.any(axis=1)
    predicted = np.empty((outputs, channel.samples))
    predicted[~seen] = np.nan
    motion, offsets, drifts = np.zeros((n, outputs), complex), np.zeros(outputs), np.zeros(outputs)
    errors = np.full(outputs, np.nan)
    for place, part, own, values in rows:
        which = part.outputs
        scale = free.scales[which] * getattr(part, "unit", 1.0)
        residues = projection.residues[:, which] if n else np.zeros((0, len(which), m), complex)
        if isinstance(part, FreeRecord):
            motion[:, which] = 2 * scale * part.motion_at_start(projection.p, residues, own)[structure.rank]
            offsets[which], drifts[which] = scale * part.offset_at_start(own)
            offsets[which] -= scale * projection.held_outputs(part)
            drifts[which] -= scale * projection.integrated_outputs(part)
            if part.offset or part.steady is not None:
                errors[which] = scale * roots(_variances_of_constants(structure, place, part))
            values = part.placed(values)
        if len(which) == outputs:
            predicted = np.multiply(values, scale[:, None], out=values if values.flags.writeable else None)
        else:
            predicted[which] = values * scale[:, None]
        if np.any(channel.hum):
            predicted[which] += np.broadcast_to(channel.hum, predicted.shape)[which]
    return FittedChannels(
        channel.original, motion, offsets, drifts, predicted, offset_stderr=errors, noise_scale=channel.unit,
        resting=bool(np.any(channel.steady)),
    )  # fmt: skip


def _variances_of_constants(structure: FittedStructure, place: int, rows: FreeRecord) -> list[float]:
    """Variance of the constant of each output of some rows, without what the inputs were that were subtracted."""
    projection, covariance, spreads = structure.measured, structure.of_shared, structure.own_spreads(place)
    if rows.steady is None:
        return [spread[-1, -1] for spread, _ in spreads]
    n, steady, inverse = len(projection.p), np.zeros(projection.inputs), np.zeros(len(projection.p), complex)
    np.divide(1, projection.p, out=inverse, where=projection.p != 0)
    steady[rows.acting] = rows.steady
    gains = np.concatenate([-2 * inverse.real, 2 * inverse.imag, np.ones(int(projection.has_feedthrough))])
    by_shared, variances = np.outer(steady, gains).ravel(), list[float]()
    for output, (spread, cross) in zip(rows.outputs.tolist(), spreads, strict=True):
        slopes = 2 * (projection.residues[:, output] @ steady) * inverse**2
        gradient = np.concatenate([-slopes.imag, slopes.real, by_shared])
        places = np.append(np.arange(2 * n), 2 * n + output * len(by_shared) + np.arange(len(by_shared)))
        variance = gradient @ covariance[np.ix_(places, places)] @ gradient
        variances.append(variance + (spread[-1, -1] - 2 * cross[-1] @ gradient if rows.offset else 0.0))
    return variances


def _of_response(structure: FittedStructure, channel: ResponseMatrix, rows: _Rows) -> FittedChannels:
    """What the fit says of a response matrix, from its rows."""
    free, n = structure.free, len(structure.measured.p)
    p, m, entries = len(channel.output_labels), len(channel.input_labels), len(free.scales)
    predicted = np.full((entries, channel.samples), complex(np.nan, 0.0))
    terms = np.zeros((2, 5, entries), complex)  # of the background, and their standard errors
    for place, part, own, values in rows:
        which = part.outputs
        scale = free.scales[which] * getattr(part, "unit", 1.0)
        if isinstance(part, FreeResponse):
            spread = np.array([np.diag(inner) for inner, _ in structure.own_spreads(place)]).T
            for term, *values_of in zip(part.terms, own, np.sqrt(np.maximum(spread, 0.0)), strict=True):
                terms[:, term.power + 2, which] += (1j if term.turned else 1.0) * scale * np.array(values_of)
        predicted[which] = values * scale[:, None]
    coefficients, errors = terms.reshape(2, 5, p, m)
    background = ResponseBackground(coefficients, errors, structure.request.quantities) if terms.any() else None
    nothing = np.zeros((n, 0), complex), np.zeros(p), np.zeros(p)
    return FittedChannels(channel, *nothing, predicted.reshape(p, m, channel.samples), background)


def _squeezed(structure: FittedStructure, experiments: Sequence[FittedChannels]) -> tuple[FittedExperiment, ...]:
    """Experiments of one input and one output without dimensions for these, with their initial states."""
    fit, rank, quantity = structure.fit, structure.rank, structure.request.quantities[0]
    r = None
    if fit.structure == "lossless" and fit.residues.shape[2] == 1 and bool(np.all(fit.p.imag > 0)):
        r = weights_of(fit.p[rank], fit.residues[rank, 0, 0], quantity)
    shown = []
    errors = _state_errors(structure, r is not None)
    for data, error in zip(experiments, errors, strict=True):
        record = single(data.record)
        if isinstance(record, FrequencyRecord):
            nothing = np.zeros(0), np.zeros(0, complex), 0.0
            shown.append(FittedExperiment(record, *nothing, data.predicted[0, 0], background=data.background))
            continue
        motion = data.free_amplitudes[:, 0]
        # among several experiments a free motion has an input of 0
        record = replace(record, time=record.clock, driven=bool(record.u.any()))
        shown.append(FittedExperiment(
            record, state_of(fit.p[rank], motion, quantity, r), motion, float(data.offsets[0]), data.predicted[0],
            float(data.drifts[0]), initial_stderr=error, offset_stderr=float(data.offset_stderr[0]),
            noise_scale=data.noise_scale, resting=data.resting,
        ))  # fmt: skip
    return tuple(shown)


def _state_errors(structure: FittedStructure, lossless: bool) -> list[Array]:
    """Standard errors of the initial state in each experiment of one input and one output; NaN if it began at rest.

    Of lossless modes, `q + i p = conj(a) / (c d sqrt(r))` with the motion `a` and the weight `c` of the state in the
    output; else the state is the motion.
    """
    projection, fit, free, rank = structure.measured, structure.fit, structure.free, structure.rank
    n, scale, state_errors, rows = len(fit.p), float(free.scales[0]), [], 0
    size = 2 * n if lossless else int(np.sum(np.where(fit.p.imag == 0, 1, 2)))
    for data in free.channels:
        seen = bool(data.observed.any()) and isinstance(data, Recording)
        moving = seen and projection.experiments[rows].moving and n > 0
        if not moving:
            state_errors.append(np.full(size * isinstance(data, Recording), np.nan))
        elif lossless:
            state_errors.append(data.unit * _modal_state_errors(structure, rows))
        else:
            ((spread, _),) = structure.own_spreads(rows)
            each = 2 * scale * roots(np.diag(spread)[: 2 * n].reshape(2, n).T)[rank]
            state_errors.append(data.unit * each[np.stack([np.ones(n, bool), fit.p[rank].imag != 0], axis=1)])
        rows += int(data.observed.any())
    return state_errors


def _modal_state_errors(structure: FittedStructure, rows: int) -> Array:
    """Standard errors of `(q, p)` of lossless modes, in some of the rows."""
    projection, fit, quantity = structure.measured, structure.fit, structure.request.quantities[0]
    scale, ((spread, crossed),) = float(structure.free.scales[0]), structure.own_spreads(rows)
    n, power, d = len(fit.p), DERIVATIVES[quantity], np.abs(fit.p)
    own, shared = projection.own[rows][:, 0], projection.shared[:, 0]
    per_weight = residue_of_unit_weight(d, power)
    r = (scale * (shared[:n] + 1j * shared[n : 2 * n]) / per_weight).real
    shown = r > 0
    gain = 1.0 / (output_weight(d, quantity) * d * np.sqrt(np.where(shown, r, 1.0)))
    motion = 2 * scale * (own[:n] - 1j * own[n : 2 * n])
    state, l, width = gain * motion, np.arange(n), 2 * n + len(shared)
    T = np.zeros((n, width + len(own)), complex)
    T[l, l] = state / d * ((0.0, -1.0, -2.0)[power] + 0.5 * power)
    T[l, 2 * n + l] = -0.5 * state / np.where(shown, r, 1.0) * scale * (1 / per_weight).real
    T[l, 3 * n + l] = -0.5 * state / np.where(shown, r, 1.0) * scale * (1j / per_weight).real
    T[l, width + l], T[l, width + n + l] = 2 * scale * gain, -2j * scale * gain
    joint = np.block([[fit.covariance, crossed.T], [crossed, spread]])
    both = np.concatenate([T.real, T.imag])
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", both, joint, both), 0.0)).reshape(2, n)
    return np.where(shown, errors, np.nan)[:, structure.rank].ravel()


def _fitted_shapes(
    structure: FittedStructure, covariance: Array, experiments: Sequence[FittedChannels]
) -> tuple[ModeShapes, ComplexArray]:
    """Shapes with their standard errors: of residues, or of a free motion."""
    request, poles, residues = structure.request, structure.poles, structure.residues
    n, m = int(np.sum(poles.imag != 0)), residues.shape[2]
    ports = request.ports_of(structure.fit.structure)
    if m:
        blocks = blocks_of_modes(covariance, residues, n)
        shapes = ModeShapes.of(poles[:n], residues[:n], request.quantities, ports)
        return shapes, shape_errors(poles[:n], residues[:n], request.quantities, ports, blocks)
    poles = poles[:n]
    motions = np.stack([experiment.free_amplitudes[:n] for experiment in experiments], axis=2)
    shapes = ModeShapes.of(poles, motions, request.quantities, ())
    shapes = ModeShapes(shapes.shapes, np.zeros((n, 0), complex), shapes.scaled)
    return shapes, shape_errors(poles, motions, request.quantities, (), _motion_covariances(structure)[:n])


def _motion_covariances(structure: FittedStructure) -> list[Array]:
    """Covariance of `(d, zeta, Re, Im of the free motions)` of each mode, outputs by experiments, of a free motion."""
    projection, fit, free = structure.measured, structure.fit, structure.free
    n, count, runs = len(fit.p), len(free.scales), len(free.channels)
    J, inner = natural_jacobian(fit.p), fit.covariance[: 2 * n, : 2 * n]
    places, size = experiments_of(projection.experiments, free.channels).tolist(), count * runs
    covariances = [np.zeros((2 + 2 * size, 2 + 2 * size)) for _ in range(n)]
    for l, total in enumerate(covariances):
        total[:2, :2] = J[[l, n + l]] @ inner @ J[[l, n + l]].T
    for k, (rows, place) in enumerate(zip(projection.experiments, places, strict=True)):
        for output, (spread, with_poles) in zip(rows.outputs.tolist(), structure.own_spreads(k), strict=True):
            scale = 2 * free.scales[output] * getattr(rows, "unit", 1.0)
            for l, total in enumerate(covariances):
                both = [2 + output * runs + place, 2 + size + output * runs + place]
                total[np.ix_(both, both)] = scale**2 * spread[np.ix_([l, n + l], [l, n + l])]
                total[np.ix_(both, [0, 1])] = scale * with_poles[[l, n + l], : 2 * n] @ J[[l, n + l]].T
                total[np.ix_([0, 1], both)] = total[np.ix_(both, [0, 1])].T
    return [covariances[l] for l in structure.rank.tolist()]

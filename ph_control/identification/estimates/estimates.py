"""All numbers of a result, each made from the fitted structure when it is first needed.

Poles, residues and delays in the units of a result, with their covariance; the likelihood, the criteria made of it, and
the variance of the noise of each output; of each experiment predicted outputs, first states and free motions with
errors, and the shapes of modes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..._types import Array, ArrayLike, ComplexArray, Indices, Mask, NDArray
from ..._units import DERIVATIVES
from ..data.channels import Recording, ResponseMatrix, single
from ..data.frequency_record import FrequencyRecord
from ..diagnosis.fitted_directions import FittedModel
from ..diagnosis.noise_levels import level_of
from ..diagnosis.verdict import HypothesisTest
from ..regression.free import FreeProjection, GivenResidues
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
from ..search.findings import Cause
from ..search.fitted_modes import FreeFit
from ..structure.choice import Choice, Request, places_of
from ..structure.constrained import StructuredFit
from ..structure.coordinates import residue_of_unit_weight, weights_of
from ..structure.hypothesis_tests import is_refused
from .scaled_shapes import ModeShapes, shape_errors

_Rows = Iterator[tuple[int, tuple[Any, Any, Any]]]  # place, rows, what belongs to them alone, prediction


@dataclass(frozen=True, eq=False)
class _FittedStructure:
    """A structure that was chosen, as it was requested.

    Attributes
    ----------
    choice : Choice
        The free fit, the structure, and its tests.
    request : Request
        What was to be assumed.
    """

    choice: Choice
    request: Request

    @property
    def free(self) -> FreeFit:
        """The free fit that the structure is next to."""
        return self.choice.free

    @property
    def tests(self) -> tuple[HypothesisTest, ...]:
        """Tests of the structures."""
        return self.choice.tests

    @cached_property
    def refused(self) -> bool:
        """Whether the data reject the structure that was given."""
        return is_refused(self.request.structure, self.tests)

    @cached_property
    def fit(self) -> StructuredFit:
        """The structure at its minimum; if it was refused, with the variance of what it leaves."""
        fit, projection = self.choice.fit, self.free.projection
        if not self.refused:
            return fit
        # who insists on it gets the errors of what it leaves
        rows_to_spare = max(1, projection.rows - projection.unknowns)
        return replace(fit, variance=max(fit.variance, fit.loss / rows_to_spare))

    @property
    def rounding(self) -> bool:
        """Whether residuals are rounding, and no noise."""
        return self.free.rounding and not self.refused

    @cached_property
    def rank(self) -> Indices:
        """Places of the poles of a result among those of the fit: modes by their frequencies, then real poles."""
        return np.lexsort((np.abs(self.fit.p), self.fit.p.imag == 0))

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles of the result."""
        return self.fit.p[self.rank]

    @cached_property
    def residues(self) -> ComplexArray:
        """Residues of the result (n, p, m)."""
        return self.fit.residues[self.rank] * np.where(self.poles.imag == 0, 2.0, 1.0)[:, None, None]

    @property
    def is_single(self) -> bool:
        """Whether there is one output, and at most one input."""
        return self.residues.shape[1] == 1 and self.residues.shape[2] <= 1

    @cached_property
    def measured(self) -> FreeProjection:
        """The data as they were measured at this model, also at one that was fitted in other rows."""
        fit, measured = self.fit, self.free.measured
        if measured is None:
            return fit.projection
        rows = measured.experiments
        if fit.delays is not None:
            rows = fit.delays.rows(rows)  # type: ignore[type-var]
        return GivenResidues(FreeProjection(rows, fit.p, measured.fed), fit.projection.shared)

    def own_spreads(self, experiment: int) -> list[tuple[Array, Array]]:
        """Covariance of what belongs to rows of an experiment, for each output, and with poles and shared unknowns."""
        fit = self.fit
        every = fit.covariance if len(fit.p) else self.measured.covariance(fit.variance)
        return self.measured.own_covariances(experiment, every, fit.variance)

    @cached_property
    def delays(self) -> tuple[Array, Array]:
        """Delay of each output and its standard error: NaN if known to a sample only, 0 if it was given."""
        fit, free, places = self.fit, self.free, places_of(self.free)
        if fit.delays is not None:
            return fit.delays.by_output[places], fit.delay_errors[fit.delays.groups][places]
        late = np.broadcast_to(free.delay, free.scales.shape)[places]
        return late.copy(), np.where(late != 0, np.nan if free.delay_open else 0.0, 0.0)


def _roots(variances: ArrayLike) -> Array:
    """Standard errors; NaN where so little is shown that rounding leaves less than nothing."""
    each = np.asarray(variances, float)
    return np.sqrt(np.where(each >= 0, each, np.nan))


def _covariance_of(structure: _FittedStructure) -> Array:
    """Covariance in the coordinates of a result from that in those of the projection, NaN for what leaves no trace."""
    fit, free, rank = structure.fit, structure.free, structure.rank
    n, projection = len(fit.p), fit.projection
    width, count = projection.shared.shape[0] if projection.shared.size else 0, len(free.scales)
    places = (2 * n + np.arange(width * count)).reshape(count, width).T
    scales = np.broadcast_to(free.scales, (width, count))
    inputs = 0 if not width else projection.inputs
    entries = fit.residues.shape[1:]

    def split(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Real and imaginary parts (n, p, m) and feedthrough (p, m) of numbers of the shared unknowns."""
        each = values.reshape(inputs, -1 if inputs else 2 * n, count)
        real, imag = (np.moveaxis(each[:, k * n : (k + 1) * n], 0, 2).reshape(n, *entries) for k in (0, 1))
        if each.shape[1] > 2 * n:
            return real, imag, each[:, 2 * n].T.reshape(entries)
        return real, imag, np.full(entries, -1 if values.dtype.kind in "iu" else 1, values.dtype)

    real, imag, through = split(places)
    order = np.concatenate([rank, n + rank, real[rank].ravel(), imag[rank].ravel(), through.ravel()]).astype(int)
    unit = [np.ones(2 * n), *(part.ravel() for part in (split(scales)[0], split(scales)[1], split(scales)[2]))]
    seen = split(projection.excited_unknowns.astype(float))
    lost = np.concatenate([np.zeros(2 * n), *((part == 0).ravel() for part in (seen[0][rank], seen[1][rank], seen[2]))])
    given = fit.covariance if n else projection.covariance(fit.variance)
    J, inner = natural_jacobian(fit.p), given.copy()
    inner[: 2 * n] = J @ inner[: 2 * n]
    inner[:, : 2 * n] = inner[:, : 2 * n] @ J.T
    inner = 0.5 * (inner + inner.T)  # but for rounding
    size = np.concatenate(unit)
    twice = np.where(fit.p[rank].imag == 0, 2.0, 1.0).repeat(int(np.prod(entries)))
    size[2 * n :][: 2 * len(twice)] *= np.tile(twice, 2)  # a real pole has its residue in two halves
    if not inner.size:
        return np.full((len(order), len(order)), np.nan)
    covariance = inner[np.ix_(order, order)] * np.outer(size, size)
    # a structure may tell of residues that free ones do not show
    unknown = split(_blind(structure).astype(float))
    hidden = np.concatenate(
        [np.zeros(2 * n), *(part.ravel() for part in (unknown[0][rank], unknown[1][rank], unknown[2]))]
    )
    nothing = np.tile((fit.residues[rank] == 0).ravel(), 2)  # weights that are held at 0
    still = np.all(fit.residues[rank] == 0, axis=(1, 2)) & (np.diag(covariance)[:n] == 0)  # poles that leave no trace
    held = np.concatenate([np.tile(still, 2), nothing, np.zeros(through.size, bool)])
    absent = (order < 0) | ((lost > 0) & (np.diag(covariance) == 0)) | (hidden > 0) | held
    covariance[absent] = np.nan
    covariance[:, absent] = np.nan
    return covariance


def _blind(structure: _FittedStructure) -> Mask:
    """Which numbers of the shared unknowns free residues leave without a trace, if those of the structure do too."""
    fit, free = structure.fit, structure.free
    if not fit.point.deficiency:
        return np.zeros(fit.projection.shared.shape, bool)
    if len(free.projection.p) == len(fit.p):
        return free.projection.unidentifiable_unknowns
    # a pair of the free model may be two real poles under a structure
    return FreeProjection(free.projection.experiments, fit.p, free.projection.fed).unidentifiable_unknowns


@dataclass(frozen=True, eq=False)
class Estimates(_FittedStructure):
    """A fitted structure with the covariance of its parameters, mode shapes, experiments and likelihood."""

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters, in the order of `PEMResult.covariance`."""
        return _covariance_of(self)

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
    def of(cls, structure: _FittedStructure, experiments: Sequence[FittedChannels]) -> _FittedLikelihood:
        """Likelihood of a structure by what it leaves of the experiments."""
        fit, free, unknowns = structure.fit, structure.free, _unknowns(structure)
        counts, variances = _variances(experiments, free)
        samples, known = int(counts.sum()), counts > 0
        loglik = float(-0.5 * np.sum(counts[known] * (np.log(2 * np.pi * variances[known]) + 1)))
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


def _unknowns(structure: _FittedStructure) -> int:
    """Number of estimated numbers: those of the free fit, less what the structure saves, with delays and variances."""
    fit, free = structure.fit, structure.free
    delays = 0 if fit.delays is None else fit.delays.count
    extra = fit.parameters - delays - (len(free.projection.x) + int(free.projection.excited_unknowns.sum()))
    late = sum(finding.cause is Cause.INPUT_DELAY for finding in free.findings)
    return free.unknowns + min(0, extra) + delays + len(free.scales) + late


def _variances(experiments: Sequence[FittedChannels], free: FreeFit) -> tuple[Array, Array]:
    """Number of real residuals of each output or entry, and the mean square of these, in the same noise."""
    counts: Any = 0
    losses: Any = 0.0
    for data, channel in zip(experiments, free.channels, strict=True):
        known = data.record.observed & ~np.isnan(data.predicted)
        counts = counts + known.sum(axis=-1) * (1 + free.per_entry)
        if isinstance(data.record, ResponseMatrix) and data.record.errors is not None:
            losses = losses + np.nansum(np.abs(data.record.in_noise(data.residuals)) ** 2, axis=-1)
            continue
        if (level := level_of(channel)) is not None:
            residuals = np.where(known, data.residuals / level, 0.0)
            losses = losses + np.sum(residuals**2, axis=-1) / data.noise_scale**2
            continue
        for weights, _, residuals in pieces([(data.record, data.predicted)]):
            losses = losses + np.sum(weights * np.abs(residuals) ** 2, axis=-1) / data.noise_scale**2
    divisor = np.maximum(np.ravel(counts), 1)
    return np.ravel(counts), np.maximum(np.ravel(losses), np.finfo(float).tiny * divisor) / divisor


def _fitted_channels(structure: _FittedStructure) -> tuple[FittedChannels, ...]:
    """Predictions, free motions, offsets and backgrounds of each experiment, from the rows of its outputs."""
    projection = structure.measured
    rows = enumerate(zip(projection.experiments, projection.own, projection.predictions(), strict=True))
    return tuple(
        _of_recording(structure, channel, rows) if isinstance(channel, Recording)
        else _of_response(structure, channel, rows)
        for channel in structure.free.channels
    )  # fmt: skip


def _of_recording(structure: _FittedStructure, channel: Recording, rows: _Rows) -> FittedChannels:
    """What the fit says of a recording, from the next of the rows."""
    projection, free = structure.measured, structure.free
    n, m, outputs = len(projection.p), len(channel.input_labels), len(free.scales)
    seen = channel.observed.any(axis=1)
    predicted = np.empty((outputs, channel.samples))
    predicted[~seen] = np.nan
    motion, offsets, drifts = np.zeros((n, outputs), complex), np.zeros(outputs), np.zeros(outputs)
    errors = np.full(outputs, np.nan)
    remaining = int(seen.sum())
    while remaining > 0:
        place, (part, own, values) = next(rows)
        which = part.outputs
        scale = free.scales[which] * getattr(part, "unit", 1.0)
        remaining -= len(which)
        residues = projection.residues[:, which] if n else np.zeros((0, len(which), m), complex)
        if isinstance(part, FreeRecord):
            motion[:, which] = 2 * scale * part.motion_at_start(projection.p, residues, own)[structure.rank]
            offsets[which], drifts[which] = scale * part.offset_at_start(own)
            if part.offset:
                errors[which] = scale * _roots([spread[-1, -1] for spread, _ in structure.own_spreads(place)])
            values = part.placed(values)
        if len(which) == outputs:
            predicted = np.multiply(values, scale[:, None], out=values if values.flags.writeable else None)
        else:
            predicted[which] = values * scale[:, None]
        predicted[which] += np.broadcast_to(channel.hum, predicted.shape)[which]
    return FittedChannels(
        channel.original, motion, offsets, drifts, predicted, offset_stderr=errors, noise_scale=channel.unit
    )


def _of_response(structure: _FittedStructure, channel: Any, rows: _Rows) -> FittedChannels:
    """What the fit says of a response matrix, from the next of the rows."""
    free, n = structure.free, len(structure.measured.p)
    p, m, entries = len(channel.output_labels), len(channel.input_labels), len(free.scales)
    predicted = np.full((entries, channel.samples), complex(np.nan, 0.0))
    terms = np.zeros((2, 5, entries), complex)  # of the background, and their standard errors
    remaining = int(channel.observed.reshape(entries, -1).any(axis=1).sum())
    while remaining > 0:
        place, (part, own, values) = next(rows)
        which = part.outputs
        scale = free.scales[which] * getattr(part, "unit", 1.0)
        remaining -= len(which)
        if isinstance(part, FreeResponse):
            spread = np.array([np.diag(inner) for inner, _ in structure.own_spreads(place)]).T
            for term, *values_of in zip(part.terms, own, np.sqrt(np.maximum(spread, 0.0)), strict=True):
                terms[:, term.power + 2, which] += (1j if term.turned else 1.0) * scale * np.array(values_of)
        predicted[which] = values * scale[:, None]
    coefficients, errors = terms.reshape(2, 5, p, m)
    background = ResponseBackground(coefficients, errors, structure.request.quantities) if terms.any() else None
    nothing = np.zeros((n, 0), complex), np.zeros(p), np.zeros(p)
    return FittedChannels(channel, *nothing, predicted.reshape(p, m, channel.samples), background)


def _squeezed(structure: _FittedStructure, experiments: Sequence[FittedChannels]) -> tuple[FittedExperiment, ...]:
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
            noise_scale=data.noise_scale,
        ))  # fmt: skip
    return tuple(shown)


def _state_errors(structure: _FittedStructure, lossless: bool) -> list[Array]:
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
            each = 2 * scale * _roots(np.diag(spread)[: 2 * n].reshape(2, n).T)[rank]
            state_errors.append(data.unit * each[np.stack([np.ones(n, bool), fit.p[rank].imag != 0], axis=1)])
        rows += int(data.observed.any())
    return state_errors


def _modal_state_errors(structure: _FittedStructure, rows: int) -> Array:
    """Standard errors of `(q, p)` of lossless modes, in some of the rows."""
    projection, fit, quantity = structure.measured, structure.fit, structure.request.quantities[0]
    scale, ((spread, crossed),) = float(structure.free.scales[0]), structure.own_spreads(rows)
    n, power, d = len(fit.p), DERIVATIVES[quantity], np.abs(fit.p)
    own, shared = projection.own[rows][:, 0], projection.shared[:, 0]
    per_weight = residue_of_unit_weight(d, power)
    r = (scale * (shared[:n] + 1j * shared[n : 2 * n]) / per_weight).real
    shown = r > 0
    gain = 1.0 / (output_weight(d, quantity)[0] * d * np.sqrt(np.where(shown, r, 1.0)))
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
    structure: _FittedStructure, covariance: Array, experiments: Sequence[FittedChannels]
) -> tuple[ModeShapes, ComplexArray]:
    """Shapes with their standard errors: of residues, or of a free motion."""
    request, poles, residues = structure.request, structure.poles, structure.residues
    n, (_, p, m) = int(np.sum(poles.imag != 0)), residues.shape
    count, size = len(poles), residues.size
    poles, residues = poles[:n], residues[:n]
    # a port that was not named holds only where the structure does
    ports = () if request.assumed and structure.fit.structure == "free" else request.ports
    if m:
        shapes = ModeShapes.of(poles, residues, request.quantities, ports)
        entries = np.arange(n * p * m).reshape(n, p * m)
        places = [[l, count + l, *(2 * count + entries[l]), *(2 * count + size + entries[l])] for l in range(n)]
        blocks = [np.nan_to_num(covariance[np.ix_(indices, indices)]) for indices in places]
        return shapes, shape_errors(poles, residues, request.quantities, ports, blocks)
    motions = np.stack([experiment.free_amplitudes[:n] for experiment in experiments], axis=2)
    shapes = ModeShapes.of(poles, motions, request.quantities, ())
    shapes = ModeShapes(shapes.shapes, np.zeros((n, 0), complex), shapes.scaled)
    return shapes, shape_errors(poles, motions, request.quantities, (), _motion_covariances(structure)[:n])


def _motion_covariances(structure: _FittedStructure) -> list[Array]:
    """Covariance of `(d, zeta, Re, Im of the free motions)` of each mode, outputs by experiments, of a free motion."""
    projection, fit, free = structure.measured, structure.fit, structure.free
    n, count, runs = len(fit.p), len(free.scales), len(free.channels)
    J, inner = natural_jacobian(fit.p), fit.covariance[: 2 * n, : 2 * n]
    measured = np.cumsum([int(data.observed.any(axis=-1).sum()) for data in free.channels])
    size, done = count * runs, 0
    covariances = [np.zeros((2 + 2 * size, 2 + 2 * size)) for _ in range(n)]
    for l, total in enumerate(covariances):
        total[:2, :2] = J[[l, n + l]] @ inner @ J[[l, n + l]].T
    for k, rows in enumerate(projection.experiments):
        place = int(np.searchsorted(measured, done, side="right"))
        done += len(rows.outputs)
        for output, (spread, with_poles) in zip(rows.outputs.tolist(), structure.own_spreads(k), strict=True):
            scale = 2 * free.scales[output] * getattr(rows, "unit", 1.0)
            for l, total in enumerate(covariances):
                both = [2 + output * runs + place, 2 + size + output * runs + place]
                total[np.ix_(both, both)] = scale**2 * spread[np.ix_([l, n + l], [l, n + l])]
                total[np.ix_(both, [0, 1])] = scale * with_poles[[l, n + l], : 2 * n] @ J[[l, n + l]].T
                total[np.ix_([0, 1], both)] = total[np.ix_(both, [0, 1])].T
    return [covariances[l] for l in structure.rank.tolist()]

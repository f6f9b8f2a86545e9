"""Noise of the force of a hammer within its contacts: each hit errs by it, and so do the residues that hits scale.

With a recorded force u, in error by e at the samples of contacts, outputs are `y = G (u + e) + v`.  The size of e is
known from what the channel shows between hits, so that the likeliest e comes of the same least squares as poles and
residues: it is what one hit has apart from the others.  What all may have in common widens the errors of residues.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ..._checks import EPS
from ..._options import STRUCTURES
from ..._types import Array
from ..data.channels import Recording
from ..data.hammer import Hits
from ..diagnosis.verdict import Outcome
from ..regression.prediction import predicted_outputs
from ..search.findings import Cause, Finding
from ..structure.choice import Request
from .scaled_shapes import places_of_modes, shape_errors
from .sensitivities import RecordDerivatives, least_squares, noise_of

Fit = Callable[..., Any]

_MOST = 30_000_000  # numbers in the responses to all samples of the contacts of a record
_ROUNDS = 4  # of corrections and fits
_NEAR = 0.1  # standard errors that a correction may still move the estimates by
_WORTH_SAYING = 1.1  # times that standard errors of residues grow


@dataclass(frozen=True, eq=False)
class ForceNoise:
    """Errors of the forces of hits, over their standard deviation, beside the parameters of a fit.

    Attributes
    ----------
    result : PEMResult
        The fit.
    spreads : sequence of ndarray or None
        Standard deviation (m, T) of the errors in each recording.
    errors : ndarray, shape (c,)
        What forces were corrected by already.
    information, score : ndarray, shapes (c, c) and (c,)
        Information of the outputs on the errors at given parameters, and the gradient of the log-likelihood.
    crossed, parameter_score : ndarray, shapes (k, c) and (k,)
        Information that errors share with the parameters, and the gradient by these.
    of_parameters : ndarray, shape (k, k)
        Information of the outputs on the parameters.
    """

    result: Any
    spreads: Sequence[Array | None]
    errors: Array
    information: Array
    score: Array
    crossed: Array
    parameter_score: Array
    of_parameters: Array

    @classmethod
    def of(cls, result: Any, recordings: Sequence[Any], hits: Hits, errors: Array | None = None) -> ForceNoise:
        """That of a fit to recordings, whose forces were corrected by some errors."""
        parts = [
            _of_recording(result, recording, experiment, spread)
            for recording, experiment, spread in zip(recordings, result.experiments, hits.spreads, strict=True)
            if spread is not None
        ]  # fmt: skip
        information, score, crossed, *by_parameters = zip(*parts, strict=True)
        scores = np.concatenate(score)
        return cls(
            result, hits.spreads, np.zeros(len(scores)) if errors is None else errors, block_diag(*information), scores,
            np.concatenate(crossed, axis=1), *(np.sum(each, axis=0) for each in by_parameters),
        )  # fmt: skip

    @cached_property
    def covariance(self) -> Array:
        """Covariance (k, k) of the parameters where forces have no errors, along the directions of the structure."""
        stated = np.nan_to_num(self.result.covariance)
        sizes = np.sqrt(np.maximum(np.diag(stated), 0.0))
        sizes = np.where(sizes > 0, sizes, 1.0)
        values, vectors = np.linalg.eigh(stated / np.outer(sizes, sizes))
        basis = sizes[:, None] * vectors[:, values > len(values) * EPS * values.max(initial=0.0)]
        return np.asarray(basis @ np.linalg.pinv(basis.T @ self.of_parameters @ basis, hermitian=True) @ basis.T)

    @cached_property
    def posterior(self) -> Array:
        """Covariance (c, c) of the errors."""
        own = self.information - self.crossed.T @ self.covariance @ self.crossed
        return np.linalg.inv(np.eye(len(own)) + 0.5 * (own + own.T))

    @cached_property
    def step(self) -> Array:
        """What is to be added to the errors (c,)."""
        score = self.score - self.errors - self.crossed.T @ (self.covariance @ self.parameter_score)
        return np.asarray(self.posterior @ score)

    @property
    def shift(self) -> float:
        """Standard errors that the step moves an estimate by, at most."""
        moved = self.covariance @ (self.crossed @ self.step)
        sizes = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return float(np.max(np.abs(moved[sizes > 0]) / sizes[sizes > 0], initial=0.0))

    @cached_property
    def widened(self) -> Array:
        """Covariance (k, k) of the parameters beside errors of the forces, NaN where it was."""
        moved = self.covariance @ self.crossed
        return np.asarray(self.result.covariance + moved @ self.posterior @ moved.T)

    @property
    def growth(self) -> float:
        """How many times the standard errors of residues are those without errors of the forces, at most."""
        stated, beside = (
            np.diag(each)[2 * len(self.result.poles) :] for each in (self.result.covariance, self.widened)
        )
        return float(np.sqrt(np.max((beside[stated > 0] / stated[stated > 0]), initial=1.0)))

    @property
    def loglik(self) -> float:
        """Log-likelihood of the fit beside errors of the forces."""
        return float(self.result.loglik) + self.loglik_beside

    @property
    def loglik_beside(self) -> float:
        """What errors of the forces cost of the log-likelihood, integrated over them."""
        return -0.5 * float(
            self.errors @ self.errors + np.linalg.slogdet(np.eye(len(self.errors)) + self.information)[1]
        )

    def corrections(self, errors: Array) -> list[Array | None]:
        """Corrections (m, T) of the force of each recording by errors (c,)."""
        corrections: list[Array | None] = []
        rest = errors
        for spread in self.spreads:
            if spread is None:
                corrections.append(None)
                continue
            each = np.zeros(spread.shape)
            count = int(np.sum(spread > 0))
            each[spread > 0] = spread[spread > 0] * rest[:count]
            corrections.append(each)
            rest = rest[count:]
        return corrections


def is_small(hits: Hits, result: Any) -> bool:
    """Whether responses to all samples of contacts can be held."""
    sizes = [np.sum(spread > 0) * spread.shape[1] for spread in hits.spreads if spread is not None]
    return len(result.residues[0]) * max(sizes) <= _MOST


def _of_recording(result: Any, recording: Recording, experiment: Any, spread: Array) -> tuple[Array, ...]:
    """Information and score of the errors of a recording; that shared with parameters; score, information of these."""
    moving = bool(np.any(experiment.free_amplitudes))
    stderr = np.append(experiment.offset_stderr, np.nan)
    derivatives = RecordDerivatives(result, recording, moving, bool(np.any(np.isfinite(stderr))))
    left_over = np.nan_to_num(recording.y - np.atleast_2d(experiment.predicted))
    places, own = derivatives.of_outputs()
    forces = _responses_to_errors(result, derivatives, spread)
    amplitudes = np.reshape(experiment.free_amplitudes, (len(result.poles), -1))
    shared = np.concatenate([derivatives.of_poles(amplitudes), forces])
    whitened = derivatives.whitened(left_over, shared, own, places)
    weight = np.asarray(np.linalg.pinv(noise_of(result, whitened)[0], hermitian=True))
    normal, score = whitened.products(weight)
    # what is the record's own is projected out
    known, c = ~np.isnan(np.diag(result.covariance)), len(forces)
    places = np.append(whitened.shared_places[: len(shared) - c], np.full(c, -2))
    places = np.append(places, whitened.places[len(shared) :])
    record_own, of_errors = places == -1, places == -2
    of_parameters = (places >= 0) & np.append(known, False)[np.maximum(places, -1)]
    moved = np.array([least_squares(normal[np.ix_(record_own, record_own)], row) for row in normal[:, record_own]])
    normal, score = normal - moved @ normal[record_own], score - moved @ score[record_own]
    crossed, parameter_score = np.zeros((len(known), c)), np.zeros(len(known))
    crossed[places[of_parameters]] = normal[np.ix_(of_parameters, of_errors)]
    parameter_score[places[of_parameters]] = score[of_parameters]
    by_parameters = np.zeros((len(known), len(known)))
    by_parameters[np.ix_(places[of_parameters], places[of_parameters])] = normal[np.ix_(of_parameters, of_parameters)]
    return normal[np.ix_(of_errors, of_errors)], score[of_errors], crossed, parameter_score, by_parameters


def _responses_to_errors(result: Any, derivatives: RecordDerivatives, spread: Array) -> Array:
    """Responses (c, p, T) to an error of one standard deviation at each sample of the contacts."""
    responses = []
    for place in np.argwhere(spread):
        u = np.zeros(spread.shape)
        u[tuple(place)] = spread[tuple(place)]
        responses.append(predicted_outputs(
            result.poles, result.residues, result.feedthrough, u, derivatives.hold, result.delay, result.input_delay
        ))  # fmt: skip
    return np.array(responses)


def beside_force_noise(first: Any, hits: Hits, request: Request, fit: Fit) -> Any:
    """The fit to hits whose forces are corrected by their likeliest errors, with the standard errors beside these.

    The errors are those beside classical damping, where that is not rejected then: what errors have in common shows in
    phases of residues only.

    Parameters
    ----------
    first : PEMResult
        Fit to the hits in plain noise.
    hits : Hits
        What was measured, and the noise of the forces.
    request : Request
        What is assumed.
    fit : callable
        Fits recordings, of a `structure`: from some poles and of a given order in `plain` noise, or anew.
    """
    named = Finding(Cause.HAMMER_NOISE, (hits.noise, hits.peak), 0.0)
    if not is_small(hits, first):
        return fit(hits.records, findings=(named,))

    def corrected(latest: Any, records: Any, errors: Array | None, **how: Any) -> tuple[Any, Any, ForceNoise]:
        """Fit and correct forces in turn, from a fit to records of some errors."""
        for _ in range(_ROUNDS):
            noise = ForceNoise.of(latest, records, hits, errors)
            if noise.shift < _NEAR:
                break
            errors = noise.errors + noise.step
            records = hits.with_forces(noise.corrections(errors))
            latest = fit(records, latest.poles, order=latest.order, **how)
            if not latest.states or latest.outcome is Outcome.INTERRUPTED:
                break
        return latest, records, noise

    structure = "classical" if request.structure == "auto" else request.structure
    start = fit(hits.records, first.poles, order=first.order, plain=True, structure=structure)
    before = ForceNoise.of(start, hits.records, hits).loglik
    latest, records, noise = corrected(start, hits.records, None, plain=True, structure=structure)
    if fit(records, latest.poles, order=latest.order, plain=True).structure not in (structure, *STRUCTURES[:2]):
        start = fit(hits.records, latest.poles, order=latest.order, plain=True, structure="free")
        latest, records, noise = corrected(start, hits.records, None, plain=True, structure="free")
    known = [named]
    if noise.growth > _WORTH_SAYING:
        sizes = hits.noise, hits.peak, noise.growth
        known.append(Finding(Cause.CONTACT_NOISE, sizes, max(noise.loglik - before, 0.0)))
    how = {"findings": tuple(known)}
    latest, records, noise = corrected(fit(records, **how), records, noise.errors, **how)
    if not latest.states or latest.outcome is Outcome.INTERRUPTED or not is_small(hits, latest):
        return latest
    return _widened(noise, request)


def _widened(noise: ForceNoise, request: Request) -> Any:
    """The result with the errors and the likelihood that it has beside errors of the forces."""
    result, covariance = noise.result, noise.widened
    ports = () if request.assumed and result.structure == "free" else request.ports
    modes = int(np.sum(result.poles.imag != 0))
    shape_stderr = shape_errors(
        result.poles[:modes], result.residues[:modes], request.quantities, ports,
        [np.nan_to_num(covariance[np.ix_(places, places)]) for places in places_of_modes(result.residues, modes)],
    )  # fmt: skip
    cost = noise.loglik_beside
    return replace(
        result, covariance=covariance, shape_stderr=shape_stderr, loglik=noise.loglik, aic=result.aic - 2 * cost,
        bic=result.bic - 2 * cost,
    )  # fmt: skip

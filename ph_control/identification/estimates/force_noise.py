"""Noise of the force of a hammer: outside its contacts there is no force, and within them each hit errs by the noise.

With a recorded force u, in error by e at the samples of contacts, outputs are `y = G (u + e) + v`.  The size of e is
known from what the channel shows between hits, so that the likeliest e comes of the same least squares as poles and
residues: it is what one hit has apart from the others.  What all may have in common widens the errors of residues.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ..._options import STRUCTURES
from ..._types import Array, Indices
from ..data.channels import Channels, Recording
from ..data.hammer import Hits
from ..diagnosis.verdict import Outcome
from ..regression.prediction import predicted_outputs
from ..search.findings import Cause, Finding
from ..structure.choice import Request
from .scaled_shapes import blocks_of_modes, shape_errors
from .sensitivities import RecordDerivatives, known_parameters, noise_of, root_of_covariance, without_others

Fit = Callable[..., Any]

_MOST = 30_000_000  # numbers in the responses to all samples of the contacts of a record
_ROUNDS = 4  # of corrections and fits
_NEAR = 0.1  # standard errors that a correction may still move the estimates by
_TOLD = 2.0  # standard errors: smaller residues may be none
_WORTH_SAYING = 1.1  # times that standard errors of residues grow


def beside_hammer_noise(channels: Channels, request: Request, fit: Fit, *, is_open: bool) -> Any:
    """The fit with a hammer's force 0 outside its contacts and in error within, where that explains the outputs better.

    Forces are corrected by their likeliest errors, and standard errors are those beside them.  The errors are those
    beside classical damping, where that is not rejected then: what hits have in common shows in phases of residues.

    Parameters
    ----------
    channels : tuple
        What was measured.
    request : Request
        What is assumed.
    fit : callable
        Fits recordings, of a `structure`: from some poles and of a given order in `plain` noise, or anew.
    is_open : bool
        Whether the number of modes is left to the data.
    """
    hits = Hits.of(channels)
    if hits is None:
        return fit(channels)
    named = Finding(Cause.HAMMER_NOISE, (hits.noise, hits.peak), 0.0)
    first = fit(hits.records, plain=True, findings=(named,))
    if first.outcome is Outcome.INTERRUPTED:
        return first
    # what the channel shows between hits may be a force
    if first.states:
        rival = fit(channels, first.poles, order=first.order, plain=True)
        if rival.outcome is not Outcome.INTERRUPTED and rival.loglik > first.loglik:
            return fit(channels)
    if not first.states or hits.responses > _MOST:
        return fit(hits.records, findings=(named,))
    begun, noise = _in_plain_noise(first, hits, request, fit, named)
    if noise.is_over:
        return noise.result
    known = [named]
    if noise.growth > _WORTH_SAYING:
        sizes = hits.noise, hits.peak, noise.growth
        known.append(Finding(Cause.CONTACT_NOISE, sizes, max(noise.loglik - begun.loglik, 0.0)))
    result = fit(hits.corrected(noise.errors), findings=tuple(known))
    noise = ForceNoise.of(result, hits, noise.errors).settled(fit, findings=tuple(known))
    if is_open:
        noise = _without_needless_modes(noise, fit, tuple(known))
    return noise.result if noise.is_over else _widened(noise, request)


def _without_needless_modes(noise: ForceNoise, fit: Fit, findings: tuple[Finding, ...]) -> ForceNoise:
    """Leave out modes with residues of the size of their errors beside those of forces, where the BIC prefers it."""
    while not noise.is_over and noise.result.order > 1:
        weakest = noise.least_mode
        if weakest is None:
            break
        records, p = noise.hits.corrected(noise.errors), np.delete(noise.result.poles, weakest)
        fewer = fit(records, p, order=noise.result.order - 1, findings=findings)
        settled = ForceNoise.of(fewer, noise.hits, noise.errors).settled(fit, findings=findings)
        if settled.is_over or settled.bic >= noise.bic:
            break
        noise = settled
    return noise


def _in_plain_noise(
    first: Any, hits: Hits, request: Request, fit: Fit, named: Finding
) -> tuple[ForceNoise, ForceNoise]:  # fmt: skip
    """Errors of the forces before and after they were corrected, of the simplest structure that is not rejected."""
    structure = "classical" if request.structure == "auto" else request.structure
    how = {"plain": True, "findings": (named,)}
    start = first if first.structure == structure else _again(first, hits.records, fit, structure=structure, **how)
    begun = ForceNoise.of(start, hits, np.zeros(hits.samples))
    noise = begun.settled(fit, structure=structure, **how)
    if noise.is_over:
        return begun, noise
    if _again(noise.result, hits.corrected(noise.errors), fit, **how).structure not in (structure, *STRUCTURES[:2]):
        start = _again(noise.result, hits.records, fit, structure="free", **how)
        noise = ForceNoise.of(start, hits, np.zeros(hits.samples)).settled(fit, structure="free", **how)
    return begun, noise


def _again(result: Any, records: Any, fit: Fit, **how: Any) -> Any:
    """The fit of other records from the poles of a result."""
    return fit(records, result.poles, order=result.order, **how)


def _is_over(result: Any) -> bool:
    """Whether a fit was interrupted, or has no poles."""
    return not result.states or result.outcome is Outcome.INTERRUPTED


@dataclass(frozen=True, eq=False)
class ForceNoise:
    """Errors of the forces of hits, over their standard deviation, beside the parameters of a fit.

    Attributes
    ----------
    result : PEMResult
        The fit to hits that were corrected by the errors.
    hits : Hits
        What was measured.
    errors : ndarray, shape (c,)
        What forces were corrected by.
    known : ndarray of int, shape (k,)
        Places in the covariance of the parameters that have an error.
    information, score : ndarray, shapes (k + c, k + c) and (k + c,)
        Information of the outputs on parameters and errors, and the gradient of the log-likelihood; nothing of a fit
        that was interrupted, or has no poles.
    """

    result: Any
    hits: Hits
    errors: Array
    known: Indices
    information: Array
    score: Array

    @classmethod
    def of(cls, result: Any, hits: Hits, errors: Array) -> ForceNoise:
        """That of a fit to hits that were corrected by some errors."""
        known = known_parameters(result.covariance)
        if _is_over(result):
            return cls(result, hits, errors, known, np.zeros((0, 0)), np.zeros(0))
        records = zip(hits.corrected(errors), hits.spreads, result.experiments, strict=True)
        parts = [
            _of_recording(result, known, recording, spread, experiment) for recording, spread, experiment in records
            if spread is not None
        ]  # fmt: skip
        k = len(known)
        shared, own = sum(normal[:k, :k] for normal, _ in parts), block_diag(*(normal[k:, k:] for normal, _ in parts))
        crossed = np.concatenate([normal[:k, k:] for normal, _ in parts], axis=1)
        score = np.concatenate([sum(score[:k] for _, score in parts), *(score[k:] for _, score in parts)])
        return cls(result, hits, errors, known, np.block([[shared, crossed], [crossed.T, own]]), score)

    @property
    def is_over(self) -> bool:
        """Whether the fit was interrupted, or has no poles."""
        return _is_over(self.result)

    def settled(self, fit: Fit, **how: Any) -> ForceNoise:
        """Errors and a fit that agree, by fits and corrections in turn."""
        latest = self
        for _ in range(_ROUNDS):
            if latest.is_over or latest.shift < _NEAR:
                break
            errors = latest.errors + latest.step
            again = _again(latest.result, self.hits.corrected(errors), fit, **how)
            latest = ForceNoise.of(again, self.hits, errors)
        return latest

    @cached_property
    def covariance(self) -> Array:
        """Covariance (k, k) of the parameters where forces have no errors, along the directions of the structure."""
        k, basis = len(self.known), root_of_covariance(self.result.covariance, self.known)
        return np.asarray(basis @ np.linalg.pinv(basis.T @ self.information[:k, :k] @ basis, hermitian=True) @ basis.T)

    @cached_property
    def moved(self) -> Array:
        """Change (k, c) of the parameters for each error of the forces, but for the sign."""
        k = len(self.known)
        return np.asarray(self.covariance @ self.information[:k, k:])

    @cached_property
    def posterior(self) -> Array:
        """Covariance (c, c) of the errors."""
        k = len(self.known)
        own = self.information[k:, k:] - self.information[k:, :k] @ self.moved
        return np.linalg.inv(np.eye(len(own)) + 0.5 * (own + own.T))

    @cached_property
    def step(self) -> Array:
        """What is to be added to the errors (c,)."""
        k = len(self.known)
        return np.asarray(self.posterior @ (self.score[k:] - self.errors - self.moved.T @ self.score[:k]))

    @property
    def shift(self) -> float:
        """Standard errors that the step moves an estimate by, at most."""
        sizes = np.sqrt(np.diag(self.covariance))
        return float(np.max(np.abs(self.moved @ self.step) / np.where(sizes > 0, sizes, np.inf), initial=0.0))

    @cached_property
    def widened(self) -> Array:
        """Covariance of all parameters beside errors of the forces, NaN where it was."""
        covariance = np.array(self.result.covariance)
        covariance[np.ix_(self.known, self.known)] += self.moved @ self.posterior @ self.moved.T
        return covariance

    @property
    def growth(self) -> float:
        """How many times the standard errors of residues are those without errors of the forces, at most."""
        residues = self.known[self.known >= 2 * len(self.result.poles)]
        ratios = np.diag(self.widened)[residues] / np.diag(self.result.covariance)[residues]
        return float(np.sqrt(ratios.max(initial=1.0)))

    @property
    def least_mode(self) -> int | None:
        """Place of the mode with the smallest residues beside their errors, none twice as large; None without."""
        modes = np.flatnonzero(self.result.poles.imag)
        if not len(modes):
            return None
        blocks = blocks_of_modes(self.widened, self.result.residues, len(modes))
        variances = np.array([np.diagonal(block)[2:].reshape(2, -1).sum(axis=0) for block in blocks])
        sizes = np.abs(self.result.residues[modes].reshape(len(modes), -1))
        ratios = (sizes / np.sqrt(np.where(variances > 0, variances, np.inf))).max(axis=1)
        return int(modes[np.argmin(ratios)]) if ratios.min() < _TOLD else None

    @property
    def bic(self) -> float:
        """BIC of the fit beside errors of the forces."""
        return float(self.result.bic - 2 * (self.loglik - self.result.loglik))

    @property
    def loglik(self) -> float:
        """Log-likelihood of the fit beside errors of the forces, integrated over these."""
        k = len(self.known)
        determinant = np.linalg.slogdet(np.eye(len(self.errors)) + self.information[k:, k:])[1]
        return float(self.result.loglik - 0.5 * (self.errors @ self.errors + determinant))


def _of_recording(
    result: Any, known: Indices, recording: Recording, spread: Array, experiment: Any
) -> tuple[Array, Array]:  # fmt: skip
    """Information of a recording on known parameters and on the errors of its force, and the score of both."""
    moving = bool(np.any(experiment.free_amplitudes))
    offset = bool(np.any(np.isfinite(experiment.offset_stderr)))
    derivatives = RecordDerivatives(result, recording, moving, offset)
    left_over = np.nan_to_num(recording.y - np.atleast_2d(experiment.predicted))
    places, own = derivatives.of_outputs()
    poles = derivatives.of_poles(np.reshape(experiment.free_amplitudes, (len(result.poles), -1)))
    forces = _responses_to_errors(result, derivatives, spread)
    whitened = derivatives.whitened(left_over, np.concatenate([poles, forces]), own, places)
    errors = len(result.covariance) + np.arange(len(forces))  # places behind those of the parameters
    whitened = replace(whitened, shared_places=np.append(np.arange(len(poles)), errors))
    weight = np.asarray(np.linalg.pinv(noise_of(result, whitened)[0], hermitian=True))
    return without_others(*whitened.products(weight), whitened.places, np.append(known, errors))


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


def _widened(noise: ForceNoise, request: Request) -> Any:
    """The result with the errors and the likelihood that it has beside errors of the forces."""
    result, cost = noise.result, noise.loglik - noise.result.loglik
    modes = int(np.sum(result.poles.imag != 0))
    errors = shape_errors(
        result.poles[:modes], result.residues[:modes], request.quantities, request.ports_of(result.structure),
        blocks_of_modes(noise.widened, result.residues, modes),
    )  # fmt: skip
    return replace(
        result, covariance=noise.widened, shape_stderr=errors, loglik=noise.loglik, aic=result.aic - 2 * cost,
        bic=result.bic - 2 * cost,
    )  # fmt: skip

"""The result of a fit to outputs alone, under forces that nobody measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from ..._display import p_value
from ..._types import Array, ComplexArray
from ..data.channels import Recording, single
from ..diagnosis.verdict import CUT_SHORT, WHITE, HypothesisTest, Outcome
from ..innovations.ambient import AmbientFit, AmbientOrder, shapes_of
from ..innovations.forces import FittedNoise
from ..regression.free_prediction import FittedChannels, natural_jacobian
from ..regression.prediction import FittedExperiment, joint_percent, shares_left
from ..regression.tuning import TUNING
from ..search.circumstances import Cause, Finding, sentence_of
from ..structure.hypothesis_tests import LEVEL
from ..uncertainty.residual_tests import ljung_box
from .pem_result import PEMResult
from .result import OrderRow
from .scaled_shapes import ModeShapes, shape_errors


def ambient_result(
    channels: Sequence[Recording], fit: AmbientFit, quantities: tuple[str, ...], gain: float, most: int | None,
    beside: Sequence[Finding] = (), tests: Sequence[HypothesisTest] = (),
) -> PEMResult:  # fmt: skip
    """Modes with their errors, prediction errors and a judgement.

    Parameters
    ----------
    channels : sequence of Recording
        The data.
    fit : AmbientFit
        The maximum of the likelihood.
    quantities : tuple of str
        Of the outputs.
    gain : float
        Log-likelihood by which this explains more than free decays; 0 if that was not asked.
    most : int or None
        Largest number of modes of the search; None where the order was given.
    beside : sequence of Finding
        What the data show beside the modes.
    tests : sequence of HypothesisTest
        Of structures.
    """
    interrupted = fit.minimum.interrupted
    step, p = channels[0].dt, len(fit.scales)
    evaluation, noise = fit.evaluation, fit.evaluation.point.noise
    unknowns = fit.unknowns
    spare = max(1, fit.samples - unknowns)
    every = evaluation.information_inverse() * (fit.samples / spare)
    poles = noise.sections.p / step
    rank = np.lexsort((np.abs(poles), poles.imag == 0))
    J = natural_jacobian(poles) @ noise.sections.pole_slopes / step
    J = J[np.append(rank, len(poles) + rank)]
    size = len(noise.sections.x)
    poles = poles[rank]
    modes = int(np.sum(poles.imag > 0))
    shapes, errors = _shapes(fit, every, J, poles, quantities)
    experiments, whiteness = _experiments(channels, fit, len(poles))
    findings = [Finding(Cause.AMBIENT, (), gain), *beside]
    if most is not None and modes >= most:
        findings.append(Finding(Cause.LARGEST_ORDER, (float(modes),), 0.0))
    outcome = Outcome.INTERRUPTED if interrupted else Outcome.CONSISTENT if whiteness >= WHITE else Outcome.COLOURED
    if not len(poles):
        outcome = Outcome.NOTHING
    fitted = joint_percent(shares_left([(experiment.record, experiment.predicted) for experiment in experiments]))
    variances = np.diag(evaluation.covariance) * fit.scales**2
    shown = experiments if p > 1 else tuple(_squeezed(experiment) for experiment in experiments)
    covariance = J @ every[:size, :size] @ J.T
    table = {model.order: model for model in sorted(fit.orders, key=lambda model: -model.bic)}
    return PEMResult(
        structure="classical" if evaluation.problem.real_shapes else "free",
        poles=poles,
        residues=np.zeros((len(poles), p, 0), complex),
        feedthrough=np.zeros((p, 0)),
        covariance=covariance,
        shapes=shapes.shapes,
        participation=np.zeros((modes, 0), complex),
        shape_stderr=errors,
        shapes_scaled=False,
        ports=(),
        quantities=quantities,
        noise_variance=variances * fit.samples / spare,
        experiments=shown,
        loss=float(np.exp(np.mean(np.log(variances)))),
        loglik=fit.criteria.loglik,
        aic=fit.criteria.aic,
        bic=fit.criteria.bic,
        fit_percent=fitted,
        unknowns=unknowns,
        whiteness=whiteness,
        order_table=tuple(_row(table[order], fit, step) for order in sorted(table)),
        tests=tuple(tests),
        findings=tuple(findings),
        success=fit.minimum.converged and not interrupted,
        outcome=outcome,
        message=_message(findings, tests, outcome, whiteness, channels[0], p),
        intersample="zoh",
        delay=np.zeros(p),
        delay_stderr=np.zeros(p),
        noise=FittedNoise.of(evaluation, fit.scales).model(step),
    )  # fmt: skip


def _row(model: AmbientOrder, fit: AmbientFit, step: float) -> OrderRow:
    """A row of the order table, in the units of the data."""
    p, sections = len(fit.scales), model.noise.sections
    size = float(np.sum(np.log(fit.scales)))
    loglik = 0.5 * (2 * model.unknowns - model.criteria.aic) - fit.samples / p * size
    loss = float(np.exp(-2 * loglik / fit.samples - 1) / (2 * np.pi))
    shift = 2 * fit.samples / p * size
    frequencies = np.sort(np.abs(sections.p[sections.p.imag > 0])) / step
    return OrderRow(model.order, loss, model.criteria.aic + shift, model.criteria.bic + shift, frequencies)


def _message(
    findings: Sequence[Finding], tests: Sequence[HypothesisTest], outcome: Outcome, whiteness: float,
    channel: Recording, outputs: int,
) -> str:  # fmt: skip
    """What the judgement rests on, in sentences."""
    if outcome is Outcome.NOTHING:
        return "Nothing to model: no mode improves the BIC."
    parts = [CUT_SHORT] * (outcome is Outcome.INTERRUPTED)
    parts += [sentence_of(finding, "zoh", channel.time_unit) for finding in findings]
    kept = [f"{test.hypothesis} ({p_value(test.p)})" for test in tests if test.p >= LEVEL]
    parts += [f"Not rejected: {', '.join(kept)}."] * bool(kept)
    parts += ["Mode shapes are unscaled, as no force was measured: the largest entry is 1."] * (outputs > 1)
    tested = f"Ljung-Box {p_value(whiteness)}"
    white = f"The prediction errors are white ({tested}): the model explains the data."
    coloured = f"The prediction errors are not white ({tested}): something is left unexplained, and errors are larger."
    return " ".join([*parts, white if whiteness >= WHITE else coloured])


def _shapes(
    fit: AmbientFit, every: Array, J: Array, poles: ComplexArray, quantities: tuple[str, ...]
) -> tuple[ModeShapes, ComplexArray]:
    """Shapes of the modes and their standard errors."""
    noise = fit.evaluation.point.noise
    sections, p = noise.sections, len(fit.scales)
    motions = shapes_of(noise) * fit.scales
    units = np.flatnonzero(sections.square > 0)
    order = np.argsort(np.abs(sections.p[sections.p.imag > 0]), kind="stable")
    motions, units = motions[order], units[order]
    first, k, states = len(sections.x), len(sections.decay), noise.states
    blocks = []
    for row, unit in enumerate(units.tolist()):
        turn = np.sqrt(sections.square[unit]) / noise.references[unit]
        T = np.zeros((2 + 2 * p, len(every)))
        T[0, : len(sections.x)], T[1, : len(sections.x)] = J[row], J[len(poles) + row]
        for output in range(p):
            place = first + output * states + 2 * unit
            T[2 + output, place] = fit.scales[output]
            T[2 + p + output, place + 1] = turn * fit.scales[output]
            T[2 + p + output, k + unit] = 0.5 * turn / sections.square[unit] * motions[row, output].imag / turn
        blocks.append(T @ every @ T.T)
    shapes = ModeShapes.of(poles[: len(units)], motions[:, :, None], quantities, ())
    return shapes, shape_errors(poles[: len(units)], motions[:, :, None], quantities, (), blocks)


def _experiments(
    channels: Sequence[Recording], fit: AmbientFit, poles: int
) -> tuple[tuple[FittedChannels, ...], float]:
    """What the fit says of each experiment, predictions one step ahead; and the p-value of white prediction errors."""
    experiments, errors, p = [], list[Array](), len(fit.scales)
    root = np.linalg.cholesky(fit.evaluation.covariance)
    triples = zip(channels, fit.evaluation.problem.experiments, fit.evaluation.errors, strict=True)
    for k, (channel, experiment, spectrum) in enumerate(triples):
        left = np.fft.irfft(spectrum, channel.samples) * np.sqrt(experiment.samples)
        # the test takes series that are independent of one another
        errors.extend(solve_triangular(root, left, lower=True))
        predicted = channel.y - left * fit.scales[:, None]
        experiments.append(FittedChannels(channel, np.zeros((poles, p), complex), fit.means[k], np.zeros(p), predicted))
    return tuple(experiments), ljung_box(errors, TUNING.lags)


def _squeezed(experiment: FittedChannels) -> FittedExperiment:
    """The experiment of one output without dimensions for it."""
    record: Any = single(experiment.record)
    return FittedExperiment(
        replace(record, time=record.clock, driven=False), np.zeros(0), experiment.free_amplitudes[:, 0],
        float(experiment.offsets[0]), experiment.predicted[0],
    )  # fmt: skip

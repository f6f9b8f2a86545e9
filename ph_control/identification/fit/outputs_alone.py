"""Outputs alone: a motion that decays, or one that forces keep up which nobody measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_lyapunov, solve_triangular
from scipy.special import chdtrc

from ..._display import counted, p_value
from ..._heartbeat import reporter
from ..._types import Array, ComplexArray
from ...exceptions import IdentificationError, StructureError
from ..data.channels import Channels, Recording, single
from ..diagnosis.hum import Tones, tones_near
from ..diagnosis.verdict import CUT_SHORT, WHITE, HypothesisTest, Outcome
from ..estimates.scaled_shapes import ModeShapes, shape_errors
from ..innovations.ambient import AmbientFit, AmbientOrder, ambient_fit, shapes_of
from ..innovations.forces import FittedNoise
from ..innovations.noise_sections import NoiseSections
from ..regression.prediction import FittedChannels, FittedExperiment, joint_percent, natural_jacobian, shares_left
from ..regression.tuning import TUNING
from ..search.findings import Cause, Finding, sentences_of
from ..structure.choice import Request
from ..structure.hypothesis_tests import LEVEL
from ..uncertainty.residual_tests import ljung_box
from .judgement import rejections
from .options import Options
from .pem_result import PEMResult
from .result import OrderRow

_FEW_MODES = 4  # that are tried for a motion that may be no decay
_DECAYED = 4.0  # times the squares of the last quarter of a record in its first
_FADED = 30.0  # times these: no motion that forces keep up, unless they make what is there at the end
_STILL = 3.0  # standard errors, or one over the record, that a decay rate of a tone may have
_TONES = 12  # at most

_Search = Callable[[Sequence[Recording]], AmbientFit | None]


def are_alone(channels: Channels, structure: str, options: Options) -> bool:
    """Whether the data are outputs without inputs or gaps, which unmeasured forces may have kept in motion.

    Set-ups of different sensors have at least one in common.
    """
    recordings = [data for data in channels if isinstance(data, Recording) and not data.u.any()]
    seen = [data.observed.all(axis=1) for data in recordings]
    alone = len(recordings) == len(channels) and bool(np.all(seen, axis=0).any()) and all(
        np.array_equal(every, data.observed.any(axis=1)) for every, data in zip(seen, recordings, strict=True)
    )  # fmt: skip
    steps = {data.dt for data in channels if isinstance(data, Recording)}
    if options.noise == "forces" and not alone and not any(getattr(data, "driven", True) for data in channels):
        raise StructureError(
            "noise='forces' of outputs alone needs recordings without missing samples that have an output in common: "
            "cut recordings where samples are missing, and fit set-ups without a common sensor one by one"
        )
    lossless = structure == "lossless" or options.method != "exact"
    return alone and len(steps) == 1 and options.noise in ("auto", "forces") and not lossless


def of_outputs_alone(
    channels: list[Recording], request: Request, options: Options, order: int | str, of_modes: Callable[..., PEMResult]
) -> PEMResult:
    """Take the likelier of a motion that decays and of one that forces keep up; the former where its noise is white."""
    if options.noise == "forces":
        return _of_forces(channels, request, options, order, None) or of_modes()
    faded = _faded(channels)
    complete = faded > _DECAYED or order != "auto"
    result = of_modes() if complete else of_modes(_FEW_MODES)
    if result.whiteness >= WHITE or not result.success:
        return result
    forced = _of_forces(channels, request, options, order, result, faded > _FADED)
    if forced is not None:
        return forced
    return result if complete else of_modes()


def _of_forces(
    channels: list[Recording], request: Request, options: Options, order: int | str, decaying: PEMResult | None,
    faded: bool = False,
) -> PEMResult | None:  # fmt: skip
    """The motion that forces keep up; None if there is none, or if that of a result which decays is likelier.

    Nor where outputs have `faded`, unless forces make what is there at the end.
    """
    count, real_poles = (value if isinstance(value, int) else None for value in (order, options.real_poles))
    search: _Search = partial(
        ambient_fit, order=count, real_poles=real_poles, max_order=options.max_order,
        criterion="bic" if options.criterion == "holdout" else options.criterion,
        reports=reporter(options.largest, options.callback),
    )  # fmt: skip
    fit = search(channels)
    if fit is None:
        if decaying is None:
            raise IdentificationError(_nothing_fits(channels, count, real_poles))
        return None
    likelier = decaying is None or _bic_of(decaying) > fit.criteria.bic or fit.minimum.interrupted
    if not likelier or (faded and not _keep_up_the_end(fit, channels)):
        return None
    gain = 0.0 if decaying is None else fit.criteria.loglik - decaying.loglik
    findings = list[Finding]()
    if order == "auto":
        fit, findings = _beside_tones(fit, channels, search)
    fit, tests = _of_structure(fit, request)
    most = options.max_order if order == "auto" else None
    return _result(channels, fit, request.quantities, gain, most, [*findings, *rejections(tests)], tests)


def _nothing_fits(channels: Sequence[Recording], order: int | None, real_poles: int | None) -> str:
    lengths = ", ".join(str(data.samples) for data in channels)
    if order is None and real_poles is None:
        return (
            f"records of {lengths} samples are too short for a model of forces that nobody measured, or one of the "
            f"{counted(len(channels[0].y), 'output')} is a combination of others: leave that one out, record longer, "
            "or leave noise out"
        )
    wanted = [f"{count} {name}" for count, name in ((order, "modes"), (real_poles, "real poles")) if count is not None]
    return (
        f"records of {lengths} samples show no model of forces that nobody measured with {' and '.join(wanted)}: leave "
        "order and real_poles to the data, or record longer"
    )


def _bic_of(result: PEMResult) -> float:
    return result.bic if np.isfinite(result.bic) else np.inf


def _faded(channels: Sequence[Recording]) -> float:
    """How many times the squares of the last quarter of the records outputs have in the first."""
    first = last = 0.0
    for data in channels:
        y = data.y[data.observed.any(axis=1)]
        y = y - y.mean(axis=1, keepdims=True)
        size = np.maximum(np.sum(y**2, axis=1), np.finfo(float).tiny)
        part = max(1, data.samples // 4)
        first += float(np.sum(np.sum(y[:, :part] ** 2, axis=1) / size))
        last += float(np.sum(np.sum(y[:, -part:] ** 2, axis=1) / size))
    return first / max(last, float(np.finfo(float).tiny))


def _keep_up_the_end(fit: AmbientFit, channels: Sequence[Recording]) -> bool:
    """Whether forces and noise, steady by themselves, have half of the squares of the last quarter of records."""
    shares = list[float]()
    for outputs, members, evaluation in fit.evaluation.by_set_up:
        noise, S = evaluation.point.noise, evaluation.covariance
        P = solve_discrete_lyapunov(noise.A, noise.K @ S @ noise.K.T)
        steady = np.diag(noise.C @ P @ noise.C.T + S) * fit.scales[outputs] ** 2
        for place in members.tolist():
            y = channels[place].y[outputs] - fit.means[place, outputs][:, None]
            end = np.mean(y[:, -max(1, y.shape[1] // 4) :] ** 2, axis=1)
            shares += (steady / np.maximum(end, np.finfo(float).tiny)).tolist()
    return bool(np.mean(shares) > 0.5)


# --- shapes ----------------------------------------------------------------------------------------------------------


def _of_structure(fit: AmbientFit, request: Request) -> tuple[AmbientFit, list[HypothesisTest]]:
    """Take real shapes where these are asked for, or where the data do not reject them."""
    alike = len(fit.scales) > 1 and len(set(request.quantities)) == 1
    wanted = request.structure in ("auto", "classical")
    if not (wanted and alike and fit.order) or fit.minimum.interrupted:
        return fit, []
    real = fit.with_real_shapes()
    if real.minimum.interrupted:
        return replace(fit, minimum=replace(fit.minimum, interrupted=True)), []
    ratio, dof = max(0.0, 2 * (fit.criteria.loglik - real.criteria.loglik)), fit.unknowns - real.unknowns
    test = HypothesisTest("classical", ratio, dof, float(chdtrc(dof, ratio)))
    return real if request.structure == "classical" or test.p >= LEVEL else fit, [test]


# --- tones -----------------------------------------------------------------------------------------------------------


def _beside_tones(
    fit: AmbientFit, channels: Sequence[Recording], search: _Search
) -> tuple[AmbientFit, list[Finding]]:  # fmt: skip
    """The fit beside tones of machines, in place of modes that do not decay, where the criterion agrees.

    One after the other, that of the slowest decay first: a tone must not carry a mode along that only seems still.
    """
    findings = list[Finding]()
    for _ in range(_TONES):
        trials = (_beside_tone(fit, findings, int(section), channels, search) for section in _still(fit, channels))
        better = None if fit.minimum.interrupted else next((trial for trial in trials if trial is not None), None)
        if better is None:
            break
        fit, findings = better
    return fit, findings


def _beside_tone(
    fit: AmbientFit, findings: Sequence[Finding], section: int, channels: Sequence[Recording], search: _Search
) -> tuple[AmbientFit, list[Finding]] | None:
    """The fit beside one more tone, in place of the mode of a section, with all tones; None where that is no better."""
    known, step = Tones.of(findings, channels), channels[0].dt
    frequencies = np.append(known.frequencies, fit.noise.sections.root[section] / step)
    weights = 1.0 / (np.sqrt(_density_at(fit, frequencies * step, np.array([section]))) * fit.scales)
    levelled = [data.y - mean[:, None] for data, mean in zip(channels, fit.means, strict=True)]
    tones = tones_near(frequencies, levelled, [weights] * len(channels), channels)
    again = search(tones.taken_from(channels))
    if again is None or again.minimum.interrupted:
        return None
    charge = (tones.unknowns - known.unknowns) * float(np.log(fit.samples))
    saved = 0.5 * (fit.criteria.bic - again.criteria.bic - charge)
    return (again, tones.findings(saved)) if saved > 0 else None


def _still(fit: AmbientFit, channels: Sequence[Recording]) -> np.ndarray:
    """Sections of modes that show no decay, or none that a record could show, the slowest first."""
    sections, longest = fit.noise.sections, max(data.samples for data in channels)
    modes = np.flatnonzero(sections.square > 0)
    if not len(modes):
        return modes
    errors = np.sqrt(np.maximum(np.diag(fit.evaluation.information_inverse())[modes], 0.0))
    still = modes[sections.decay[modes] < np.maximum(_STILL * errors, 1.0 / longest)]
    return still[np.argsort(sections.decay[still])]


def _density_at(fit: AmbientFit, angles: np.ndarray, still: np.ndarray) -> np.ndarray:
    """Density (p,) of the outputs at some frequencies, the mean over these, without modes that are still."""
    total, count = np.zeros((2, len(fit.scales)))
    for outputs, _, evaluation in fit.evaluation.by_set_up:
        noise: NoiseSections = evaluation.point.noise
        K = noise.K.copy()
        K[np.concatenate([2 * still, 2 * still + 1])] = 0.0
        H = np.eye(len(outputs)) + noise.outputs_of_states(np.exp(1j * angles)) @ K
        total[outputs] += np.einsum("bij,jk,bik->bi", H, evaluation.covariance, H.conj()).real.mean(axis=0)
        count[outputs] += 1
    return np.asarray(total / count)


# --- the result ------------------------------------------------------------------------------------------------------


def _result(
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
    variances, set_ups = fit.variances, fit.evaluation.by_set_up
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
        noise=FittedNoise.of(evaluation, fit.scales).model(step) if len(set_ups) == 1 else None,
    )  # fmt: skip


def _row(model: AmbientOrder, fit: AmbientFit, step: float) -> OrderRow:
    """A row of the order table, in the units of the data."""
    sections, criteria, shift = model.noise.sections, model.criteria, 2 * fit.size
    loss = model.loss * float(np.exp(shift / fit.samples))
    frequencies = np.sort(np.abs(sections.p[sections.p.imag > 0])) / step
    return OrderRow(model.order, loss, criteria.aic + shift, criteria.bic + shift, frequencies)


def _message(
    findings: Sequence[Finding], tests: Sequence[HypothesisTest], outcome: Outcome, whiteness: float,
    channel: Recording, outputs: int,
) -> str:  # fmt: skip
    """What the judgement rests on, in sentences."""
    if outcome is Outcome.NOTHING:
        return "Nothing to model: no mode improves the BIC."
    parts = [CUT_SHORT] * (outcome is Outcome.INTERRUPTED)
    parts += sentences_of(findings, "zoh", channel.time_unit)
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
    predictions = [np.full(channel.y.shape, np.nan) for channel in channels]
    errors, p = list[Array](), len(fit.scales)
    for outputs, members, evaluation in fit.evaluation.by_set_up:
        root = np.linalg.cholesky(evaluation.covariance)
        for place, spectrum in zip(members.tolist(), evaluation.errors, strict=True):
            samples = channels[place].samples
            residuals = np.fft.irfft(spectrum, samples) * np.sqrt(samples)
            # the test takes series that are independent of one another
            errors.extend(solve_triangular(root, residuals, lower=True))
            predictions[place][outputs] = channels[place].y[outputs] - residuals * fit.scales[outputs, None]
    experiments = [
        FittedChannels(channel, np.zeros((poles, p), complex), np.nan_to_num(mean), np.zeros(p), predicted)
        for channel, mean, predicted in zip(channels, fit.means, predictions, strict=True)
    ]
    return tuple(experiments), ljung_box(errors, TUNING.lags)


def _squeezed(experiment: FittedChannels) -> FittedExperiment:
    """The experiment of one output without dimensions for it."""
    record: Any = single(experiment.record)
    return FittedExperiment(
        replace(record, time=record.clock, driven=False), np.zeros(0), experiment.free_amplitudes[:, 0],
        float(experiment.offsets[0]), experiment.predicted[0],
    )  # fmt: skip

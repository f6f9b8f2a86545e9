"""Outputs alone: a motion that decays, or one that forces keep up which nobody measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_lyapunov, solve_triangular
from scipy.ndimage import maximum_filter1d
from scipy.special import chdtrc

from ..._display import counted, p_value
from ..._heartbeat import reporter
from ..._types import Array, ComplexArray, Mask
from ...exceptions import IdentificationError, StructureError
from ..data.channels import Channels, Recording, single
from ..data.time_record import is_long
from ..diagnosis.hum import Tones, tones_near
from ..diagnosis.noise_levels import findings_of, levels_of_noise, outliers
from ..diagnosis.verdict import CUT_SHORT, WHITE, HypothesisTest, Outcome
from ..estimates.scaled_shapes import ModeShapes, shape_errors
from ..growth.growing import may_reach
from ..innovations.ambient import AmbientFit, AmbientOrder, ambient_fit, errors_beside, shapes_of
from ..innovations.forces import MOST_MISSING, FittedNoise
from ..innovations.noise_sections import NoiseSections
from ..regression.prediction import FittedChannels, FittedExperiment, joint_percent, natural_jacobian, shares_left
from ..regression.tuning import TUNING
from ..search.channel_rows import RowOptions
from ..search.findings import Cause, Finding, sentences_of
from ..search.path import FreePath
from ..structure.choice import Request
from ..structure.hypothesis_tests import LEVEL
from ..uncertainty.residual_tests import ljung_box
from .judgement import DOUBTS, at_rest, doubt_about, rejections, saturated
from .options import Options
from .pem_result import PEMResult
from .result import OrderRow

_DECAYED = 4.0  # times the squares of the last quarter of a record in its first
_FADED = 30.0  # times these: no motion that forces keep up, unless they make what is there at the end
_FURTHER = 3  # modes that those of a motion without end may lack of one that decays
_MOST = 0.8  # of the squares of an output, which a motion that decays leaves at most
_STILL = 3.0  # standard errors, or one over the record, that a decay rate of a tone may have
_TONES = 12  # at most
_SLOW = 1.0  # decay of a real pole in a record, below which a line may explain it
_PASSES = 50  # over values that stand out
_REACH = 41  # samples about one in which another is judged without it
_ALONE = 5.0  # times the slow motion of other outputs, that of one by itself

_Search = Callable[[Sequence[Recording]], AmbientFit | None]


def are_alone(channels: Channels, structure: str, options: Options) -> bool:
    """Whether the data are outputs without inputs, and few gaps, which unmeasured forces may have kept in motion.

    Set-ups of different sensors have at least one in common.
    """
    recordings = [data for data in channels if isinstance(data, Recording) and not data.u.any()]
    shares = [data.observed.mean(axis=1) for data in recordings]
    alone = len(recordings) == len(channels) and bool(np.all(shares, axis=0).any()) and all(
        np.all((share == 0) | (share >= 1 - MOST_MISSING)) for share in shares
    )  # fmt: skip
    steps = {data.dt for data in channels if isinstance(data, Recording)}
    if options.noise == "forces" and not alone and not any(getattr(data, "driven", True) for data in channels):
        raise StructureError(
            "noise='forces' of outputs alone needs recordings that have an output in common, and in which no more than "
            f"{100 * MOST_MISSING:.0f} % of the samples of an output are missing: cut recordings where samples are "
            "missing, and fit set-ups without a common sensor one by one"
        )
    lossless = structure == "lossless" or options.method != "exact"
    return alone and len(steps) == 1 and options.noise in ("auto", "forces") and not lossless


def _refuse_dead(channels: Sequence[Recording]) -> None:
    """Refuse outputs that are constant beside others that move."""
    still = np.all([(np.nanmax(data.y, axis=1, initial=-np.inf) <= np.nanmin(data.y, axis=1, initial=np.inf))
                    | ~data.observed.any(axis=1) for data in channels], axis=0)  # fmt: skip
    if still.any() and not still.all():
        label = channels[0].output_labels[int(np.argmax(still))]
        raise IdentificationError(f"output {label!r} is constant, as that of a sensor that is dead: leave it out")


def of_outputs_alone(
    channels: list[Recording], request: Request, options: Options, order: int | str, of_modes: Callable[[], PEMResult]
) -> PEMResult:
    """Take the likelier of a motion that decays and of one that forces keep up; the former where its noise is white."""
    _refuse_dead(channels)
    search: _Search = partial(
        ambient_fit, order=_given(order), real_poles=_given(options.real_poles), max_order=options.max_order,
        criterion="bic" if options.criterion == "holdout" else options.criterion,
        reports=reporter(options.largest, options.callback),
    )  # fmt: skip
    beside_all = partial(_beside_all, channels, request, options, order, search)
    if options.noise == "forces":
        fit = search(channels)
        if fit is None:
            raise IdentificationError(_nothing_fits(channels, _given(order), _given(options.real_poles)))
        return beside_all(fit, 0.0)
    faded = _faded(channels)
    if faded > _DECAYED or order != "auto":
        decaying = of_modes()
        fit = search(channels) if decaying.success and decaying.whiteness < WHITE else None
        if fit is None or not (fit.minimum.interrupted or fit.criteria.bic < _bic_of(decaying)):
            return decaying
        if faded > _FADED and not _keep_up_the_end(fit):
            return decaying
        return beside_all(fit, fit.criteria.loglik - decaying.loglik)
    fit = search(channels)
    if fit is not None:
        try:
            gain = _gain_over_decay(channels, fit, options)
        except KeyboardInterrupt:
            return beside_all(fit.cut, 0.0)
        if gain is not None:
            return beside_all(fit, gain)
    decaying = of_modes()
    if fit is None or decaying.whiteness >= WHITE or not decaying.success:
        return decaying
    forced = beside_all(fit, fit.criteria.loglik - decaying.loglik)
    return decaying if _bic_of(decaying) < forced.bic else forced


def _given(count: int | str) -> int | None:
    """A number of modes or poles; None where the data choose it."""
    return None if isinstance(count, str) else count


def _gain_over_decay(channels: Sequence[Recording], fit: AmbientFit, options: Options) -> float | None:
    """What a motion that forces keep up gains in log-likelihood over one that decays from the same poles.

    None where the latter is likelier, or explains most of an output and may be likelier with more modes.
    """
    if fit.minimum.interrupted:
        return 0.0
    path = FreePath.of(channels, RowOptions(None, "zoh", int(bool(options.offset)), options.moving))
    poles = fit.noise.sections.p / channels[0].dt
    # what forces keep up moves about its mean
    decay = path.reweighted(path.model(poles if options.offset else np.append(poles, 0.0)))
    if np.any(decay.losses < _MOST * path.power):
        most = min(options.max_order, path.carried, fit.order + _FURTHER)
        may_decay = may_reach(path, decay, most, fit.criteria.bic)
    else:
        may_decay = path.bic(decay) < fit.criteria.bic
    return None if may_decay else fit.criteria.loglik - path.loglik(decay.losses)


def _beside_all(
    channels: list[Recording], request: Request, options: Options, order: int | str, search: _Search,
    fit: AmbientFit, gain: float,
) -> PEMResult:  # fmt: skip
    """The result of a fit beside drifts, tones and changes of level, with what it gains over a decay."""
    forced = _Forced.of(fit, channels, gain)
    if options.real_poles == "auto" and options.offset == "auto":
        forced = _beside_drift(forced, search)
    if order == "auto":
        forced = _beside_tones(forced, search)
    forced = _in_their_levels(forced, search)
    fit, tests = _of_structure(forced.fit, request)
    most = options.max_order if order == "auto" else None
    forced = replace(forced, fit=fit, findings=(*forced.findings, *rejections(tests)))
    return _result(forced, request.quantities, most, tests)


@dataclass(frozen=True, eq=False)
class _Forced:
    """A fit of recordings as they would be without what disturbs them.

    Attributes
    ----------
    channels, parts : sequence of Recording
        Recordings as they were measured, and as they were fitted: without drifts and tones, in parts of one level.
    places : tuple of int
        Of which recording each part is.
    fit : AmbientFit
        The maximum of the likelihood.
    findings : tuple of Finding
        What the data show beside the modes.
    slopes : ndarray, shape (E, p)
        Drift of each output per unit time.
    levels : tuple of ndarray or None, shapes (p, T)
        Level of the noise of each recording.
    """

    channels: Sequence[Recording]
    parts: Sequence[Recording]
    places: tuple[int, ...]
    fit: AmbientFit
    findings: tuple[Finding, ...]
    slopes: Array
    levels: tuple[Array | None, ...]

    @classmethod
    def of(cls, fit: AmbientFit, channels: Sequence[Recording], gain: float) -> _Forced:
        """The fit of recordings as they are, with what it gains over a decay."""
        slopes = np.zeros((len(channels), len(fit.scales)))
        findings = (Finding(Cause.AMBIENT, (), gain),)
        return cls(channels, channels, tuple(range(len(channels))), fit, findings, slopes, (None,) * len(channels))

    @property
    def lines(self) -> list[Array]:
        """What drifts add to the outputs (p, T) of each recording."""
        times = (data.dt * (np.arange(data.samples) - 0.5 * (data.samples - 1)) for data in self.channels)
        return [slope[:, None] * t for slope, t in zip(self.slopes, times, strict=True)]

    @cached_property
    def errors(self) -> list[Array]:
        """Prediction errors (p, samples) of each part, in its units; NaN of outputs that were not measured."""
        return errors_beside(self.fit, [np.zeros(y.shape, bool) for y in self.fit.outputs])

    def in_noise(self, errors: Sequence[Array]) -> list[Array]:
        """Errors of parts as those of each recording (p, T), over the level of the noise; NaN where missing."""
        joined = self.joined([part.unit * each for part, each in zip(self.parts, errors, strict=True)])
        return [
            np.where(data.observed, each if level is None else each / level, np.nan)
            for data, each, level in zip(self.channels, joined, self.levels, strict=True)
        ]

    def parted(self, values: Sequence[Mask]) -> list[Mask]:
        """What recordings have at their samples (p, T), of each part; nothing of outputs that were not measured."""
        parts, first = list[Mask](), [0] * len(self.channels)
        for place, y in zip(self.places, self.fit.outputs, strict=True):
            last = first[place] + y.shape[1]
            parts.append(values[place][:, first[place] : last] & np.isfinite(y))
            first[place] = last
        return parts

    def joined(self, values: Sequence[Array]) -> list[Array]:
        """Values (p, samples) of parts one after the other, of each recording."""
        pairs = list(zip(self.places, values, strict=True))
        return [np.concatenate([each for k, each in pairs if k == e], axis=1) for e in range(len(self.channels))]


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
        y = y - np.nanmean(y, axis=1, keepdims=True)
        size = np.maximum(np.nansum(y**2, axis=1), np.finfo(float).tiny)
        part = max(1, data.samples // 4)
        first += float(np.sum(np.nansum(y[:, :part] ** 2, axis=1) / size))
        last += float(np.sum(np.nansum(y[:, -part:] ** 2, axis=1) / size))
    return first / max(last, float(np.finfo(float).tiny))


def _keep_up_the_end(fit: AmbientFit) -> bool:
    """Whether forces and noise, steady by themselves, have half of the squares of the last quarter of records."""
    shares = list[float]()
    for outputs, members, evaluation in fit.evaluation.by_set_up:
        noise, S = evaluation.point.noise, evaluation.covariance
        P = solve_discrete_lyapunov(noise.A, noise.K @ S @ noise.K.T)
        steady = np.diag(noise.C @ P @ noise.C.T + S) * fit.scales[outputs] ** 2
        for place in members.tolist():
            y = fit.outputs[place][outputs] - fit.means[place, outputs][:, None]
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
        return fit.cut, []
    ratio, dof = max(0.0, 2 * (fit.criteria.loglik - real.criteria.loglik)), fit.unknowns - real.unknowns
    test = HypothesisTest("classical", ratio, dof, float(chdtrc(dof, ratio)))
    return real if request.structure == "classical" or test.p >= LEVEL else fit, [test]


# --- beside disturbances ---------------------------------------------------------------------------------------------


def _beside_drift(forced: _Forced, search: _Search) -> _Forced:
    """The fit of outputs less lines, in place of real poles that hardly decay in a record, where that is likelier."""
    fit, channels = forced.fit, forced.channels
    rates = fit.noise.sections.p
    longest = max(data.samples for data in channels)
    if fit.minimum.interrupted or not np.any((rates.imag == 0) & (-rates.real * longest < _SLOW)):
        return forced
    slopes = np.zeros(forced.slopes.shape)
    for row, data, y in zip(slopes, channels, fit.outputs, strict=True):
        t = data.dt * (np.arange(data.samples) - 0.5 * (data.samples - 1))
        row[:] = np.nan_to_num(y @ t / (t @ t))
    trial = replace(forced, slopes=slopes)
    again = search([data.adjusted(hum=line) for data, line in zip(channels, trial.lines, strict=True)])
    if again is None:
        return forced
    if again.minimum.interrupted:
        return replace(forced, fit=fit.cut)
    charge = np.count_nonzero(slopes) * float(np.log(fit.samples))
    gain = 0.5 * (fit.criteria.bic - again.criteria.bic - charge)
    if gain <= 0:
        return forced
    drift = Finding(Cause.DRIFT, tuple(slopes[slopes != 0].tolist()), gain)
    return replace(trial, fit=again, findings=(*forced.findings, drift))


def _beside_tones(forced: _Forced, search: _Search) -> _Forced:
    """The fit beside tones of machines, in place of modes that do not decay, where the criterion agrees.

    One after the other, that of the slowest decay first: a tone must not carry a mode along that only seems still.
    """
    for _ in range(_TONES):
        if forced.fit.minimum.interrupted:
            break
        trials = (_beside_tone(forced, int(section), search) for section in _still(forced.fit, forced.channels))
        better = next((trial for trial in trials if trial is not None), None)
        if better is None:
            break
        forced = better
    return _without_tones(forced)


def _without_tones(forced: _Forced, tones: Tones | None = None) -> _Forced:
    """The same with recordings less drifts and tones as parts, by default those among the findings."""
    channels = forced.channels
    tones = Tones.of(forced.findings, channels) if tones is None else tones
    pairs = zip(channels, forced.lines, tones.signals(channels), strict=True)
    return replace(forced, parts=[data.adjusted(hum=line + signal) for data, line, signal in pairs])


def _beside_tone(forced: _Forced, section: int, search: _Search) -> _Forced | None:
    """The fit beside one more tone, in place of the mode of a section, with all tones; None where that is no better."""
    fit, channels = forced.fit, forced.channels
    known, step = Tones.of(forced.findings, channels), channels[0].dt
    frequencies = np.append(known.frequencies, fit.noise.sections.root[section] / step)
    weights = 1.0 / (np.sqrt(_density_at(fit, frequencies * step, np.array([section]))) * fit.scales)
    triples = zip(channels, forced.lines, fit.means, strict=True)
    levelled = [data.y - line - mean[:, None] for data, line, mean in triples]
    tones = tones_near(frequencies, levelled, [weights] * len(channels), channels)
    again = search(_without_tones(forced, tones).parts)
    if again is None or again.minimum.interrupted:
        return None
    charge = (tones.unknowns - known.unknowns) * float(np.log(fit.samples))
    saved = 0.5 * (fit.criteria.bic - again.criteria.bic - charge)
    others = [finding for finding in forced.findings if finding.cause is not Cause.HUM]
    return replace(forced, fit=again, findings=(*others, *tones.findings(saved))) if saved > 0 else None


def _in_their_levels(forced: _Forced, search: _Search) -> _Forced:
    """The fit of spans in units of their level, where forces and noise change together and that is likelier.

    A level that is not taken into account is a finding of no gain.
    """
    fit, channels = forced.fit, forced.channels
    if fit.minimum.interrupted or not fit.order:
        return forced
    levels = levels_of_noise(channels, forced.in_noise(forced.errors), fit.unknowns)
    if levels is None:
        return forced
    shared, gain = tuple(_shared(*pair) for pair in zip(channels, levels, strict=True)), 0.0
    together = all((each is None) == (level is None) for each, level in zip(shared, levels, strict=True))
    levels = shared if together else levels
    forced = replace(forced, levels=levels)
    if together:
        spans = [_spans(*each) for each in zip(forced.parts, levels, strict=True)]
        parts, places = [part for each in spans for part in each], np.repeat(range(len(spans)), list(map(len, spans)))
        again = search(parts)
        if again is not None and again.minimum.interrupted:
            return replace(forced, fit=fit.cut)
        if again is not None and (saved := 0.5 * (fit.criteria.bic - again.criteria.bic)) > 0:
            gain, forced = saved, replace(forced, fit=again, parts=parts, places=tuple(places.tolist()))
    changed = [
        data if level is None else data.adjusted(level=level) for data, level in zip(channels, levels, strict=True)
    ]
    findings = findings_of(changed, gain)
    if together:
        findings = [replace(finding, cause=Cause.CHANGING_FORCES, output="") for finding in findings]
    return replace(forced, findings=(*forced.findings, *findings))


def _shared(data: Recording, level: Array | None) -> Array | None:
    """The level of the noise (p, T) of a recording where all outputs that were measured have the same; else None."""
    rows = None if level is None else level[data.observed.any(axis=1)]
    return None if rows is None or np.ptp(rows, axis=0).any() else np.broadcast_to(rows[0], data.y.shape)


def _spans(part: Recording, level: Array | None) -> list[Recording]:
    """Spans of a recording less its hum, each in units of its level, which all outputs share."""
    if level is None:
        return [part]
    ends = [0, *(np.flatnonzero(np.diff(level[0])) + 1).tolist(), part.samples]
    whole, hum, spans = part.original, np.broadcast_to(part.hum, part.y.shape), list[Recording]()
    for first, last in pairwise(ends):
        some = slice(first, last)
        span = replace(whole, time=whole.clock[some], u=whole.u[:, some], y=whole.y[:, some])
        spans.append(span.adjusted(float(level[0, first]), hum[:, some]))
    return spans


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
    forced: _Forced, quantities: tuple[str, ...], most: int | None, tests: Sequence[HypothesisTest]
) -> PEMResult:
    """Modes with their errors, prediction errors and a judgement.

    Parameters
    ----------
    forced : _Forced
        The fit.
    quantities : tuple of str
        Of the outputs.
    most : int or None
        Largest number of modes of the search; None where the order was given.
    tests : sequence of HypothesisTest
        Of structures.
    """
    fit, channels = forced.fit, forced.channels
    interrupted = fit.minimum.interrupted
    step, p = channels[0].dt, len(fit.scales)
    evaluation, noise = fit.evaluation, fit.evaluation.point.noise
    unknowns, spare = fit.unknowns, fit.spare
    every = evaluation.information_inverse() * (fit.samples / spare)
    poles = noise.sections.p / step
    rank = np.lexsort((np.abs(poles), poles.imag == 0))
    J = natural_jacobian(poles) @ noise.sections.pole_slopes / step
    J = J[np.append(rank, len(poles) + rank)]
    size = len(noise.sections.x)
    poles = poles[rank]
    modes = int(np.sum(poles.imag > 0))
    shapes, errors = _shapes(fit, every, J, poles, quantities)
    experiments, whiteness = _experiments(forced, len(poles))
    findings = [*forced.findings, *_slow_noise(fit, channels[0]), *saturated(experiments), *at_rest(experiments)]
    if most is not None and modes >= most:
        findings.append(Finding(Cause.LARGEST_ORDER, (float(modes),), 0.0))
    if whiteness >= WHITE and not interrupted:
        findings += _wild(forced)
    outcome = _outcome(findings, whiteness, interrupted, bool(len(poles)))
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


def _outcome(findings: Sequence[Finding], whiteness: float, interrupted: bool, poles: bool) -> Outcome:
    """What the fit amounts to; values that are no measurements cast doubt."""
    if interrupted or not poles:
        return Outcome.NOTHING if not poles else Outcome.INTERRUPTED
    if any(finding.cause in DOUBTS for finding in findings):
        return Outcome.DOUBTFUL
    return Outcome.CONSISTENT if whiteness >= WHITE else Outcome.COLOURED


def _wild(forced: _Forced) -> list[Finding]:
    """Values that stand out of the noise of all others of their output.

    Each disturbs the predictions of all outputs for a while: the largest are set missing before others are judged.
    """
    channels, errors = forced.channels, forced.errors
    wild = [~data.observed for data in channels]
    reach = 1 if is_long(channels) else _REACH
    for _ in range(_PASSES):
        noise = [np.where(far, np.nan, each) for far, each in zip(wild, forced.in_noise(errors), strict=True)]
        sizes = _far_out(noise, forced.fit.spare)
        if not any(each.any() for each in sizes):
            break
        largest = [(each > 0) & (each == maximum_filter1d(each.max(axis=0), reach)) for each in sizes]
        wild = [far | more for far, more in zip(wild, largest, strict=True)]
        if is_long(channels):
            break
        errors = errors_beside(forced.fit, forced.parted(wild))
    return [
        Finding(Cause.OUTLIERS, tuple(np.flatnonzero(row).astype(float).tolist()), 0.0, label, k)
        for k, (far, data) in enumerate(zip(wild, channels, strict=True))
        for label, row in zip(data.output_labels, far & data.observed, strict=True) if row.any()
    ]  # fmt: skip


def _far_out(noise: Sequence[Array], spare: int) -> list[Array]:
    """Errors (p, T) that stand out of all others of their output and recording, over their median size; 0 of others."""
    seen = [np.flatnonzero(np.isfinite(each).any(axis=1)) for each in noise]
    rows = [each[output] for each, outputs in zip(noise, seen, strict=True) for output in outputs]
    places, sizes = iter(outliers(rows, spare)), [np.zeros(each.shape) for each in noise]
    for size, each, outputs in zip(sizes, noise, seen, strict=True):
        for output in outputs.tolist():
            far = np.array(next(places), int)
            size[output, far] = np.abs(each[output, far]) / np.nanmedian(np.abs(each[output]))
    return sizes


def _slow_noise(fit: AmbientFit, channel: Recording) -> list[Finding]:
    """Real poles, with the output that alone shows their motion, if there is such a one."""
    noise, sections, labels = fit.noise, fit.noise.sections, channel.output_labels
    rates = np.sort(-sections.p[sections.p.imag == 0].real) / channel.dt
    if not len(rates):
        return []
    pairs = np.repeat(sections.square <= 0, 2)
    states = np.append(pairs, np.ones(noise.states - len(pairs), bool))
    sizes = np.zeros(len(labels))
    for outputs, _, evaluation in fit.evaluation.by_set_up:
        each = evaluation.point.noise
        driven = each.C[:, states] @ each.K[states] @ np.linalg.cholesky(evaluation.covariance)
        sizes[outputs] = np.maximum(sizes[outputs], np.linalg.norm(driven, axis=1))
    largest = int(np.argmax(sizes))
    alone = len(labels) > 1 and sizes[largest] > _ALONE * np.delete(sizes, largest).max()
    return [Finding(Cause.SLOW_NOISE, tuple(rates.tolist()), 0.0, labels[largest] if alone else "")]


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
    if outcome is Outcome.DOUBTFUL:
        parts.append(doubt_about(findings))
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


def _experiments(forced: _Forced, poles: int) -> tuple[tuple[FittedChannels, ...], float]:
    """What the fit says of each experiment, predictions one step ahead; and the p-value of white prediction errors."""
    fit, p, every, whitened = forced.fit, len(forced.fit.scales), forced.errors, list[Array]()
    for outputs, members, evaluation in fit.evaluation.by_set_up:
        root = np.linalg.cholesky(evaluation.covariance) * fit.scales[outputs, None]
        for place in members.tolist():
            # the test takes series that are independent of one another
            whitened.extend(solve_triangular(root, every[place][outputs], lower=True))
    triples = zip(forced.parts, fit.outputs, every, strict=True)
    predictions = forced.joined([part.unit * (y - errors) + part.hum for part, y, errors in triples])
    means = [
        np.mean(each, axis=1) for each in forced.joined([
            np.broadcast_to(part.unit * mean[:, None], part.y.shape)
            for part, mean in zip(forced.parts, fit.means, strict=True)
        ])
    ]  # fmt: skip
    experiments = [
        FittedChannels(channel, np.zeros((poles, p), complex), np.nan_to_num(mean) + line[:, 0], slopes, predicted)
        for channel, mean, slopes, line, predicted in zip(
            forced.channels, means, forced.slopes, forced.lines, predictions, strict=True
        )
    ]
    return tuple(experiments), ljung_box(whitened, TUNING.lags)


def _squeezed(experiment: FittedChannels) -> FittedExperiment:
    """The experiment of one output without dimensions for it."""
    record: Any = single(experiment.record)
    return FittedExperiment(
        replace(record, time=record.clock, driven=False), np.zeros(0), experiment.free_amplitudes[:, 0],
        float(experiment.offsets[0]), experiment.predicted[0], float(experiment.drifts[0]),
    )  # fmt: skip

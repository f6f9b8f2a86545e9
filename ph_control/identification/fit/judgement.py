"""The judgement of a fit: what speaks for and against it, what it amounts to, and that in sentences.

Residuals are looked at as noise: whether they are white, and which samples no noise explains; columns for mistakes in
their choice: the same one twice, or input and output exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from scipy.stats import chi2

from ..._display import counted, p_value
from ..._types import Array, ComplexArray, Indices, NDArray, RealOrComplex
from ..._units import DERIVATIVES
from ...modal.discretization import Hold
from ..data.channels import Recording, ResponseMatrix
from ..data.time_record import Difference, Record, Signal, blocks
from ..diagnosis.fitted_directions import directions_of
from ..diagnosis.noise_levels import level_of, outliers, rounded_outputs, saturation, stuck
from ..diagnosis.nonlinearity import not_linear
from ..diagnosis.verdict import CUT_SHORT, GOOD_FIT, POOR_FIT, WHITE, HypothesisTest, Outcome, slower_than_record
from ..estimates.estimates import Estimates
from ..excitation.excitation import examine
from ..regression.prediction import FittedChannels, FittedExperiment
from ..regression.tuning import TUNING
from ..search.findings import HOLDS, REJECTED, Cause, Finding, sentences_of
from ..search.fitted_modes import FreeFit
from ..structure.choice import layout_of
from ..structure.hypothesis_tests import LEVEL
from ..uncertainty.fisher import PortRecord
from ..uncertainty.residual_tests import ljung_box, without_peaks

_HALF = 0.05  # of half a sample: what a delay may differ from it by
_OPPOSED = 0.7  # cosine of the angle within which a residue points against the force
_FEW = 20  # samples beyond the unknowns, with fewer of which nothing can be judged

# what casts doubt on the data
DOUBTS = {
    Cause.STUCK: "an output stays at one value", Cause.OUTLIERS: "some values are far out of the noise",
    Cause.SWAPPED: "columns are probably swapped", Cause.SATURATION: "an output stays at an end of its range",
}  # fmt: skip

# poles in words
_CERTAIN = 3.0  # standard errors beyond which a mode is said to grow
_AT_ZERO = 0.01  # p-value from which on poles may be 0

# residuals
_COUNTED = 400_000  # samples times unknowns up to which these are felt by the test of whiteness, and cheap

# mistakes in the choice of columns
_SAME = 1e-12  # share of the power by which two columns may differ, as rounding in print makes them
_BROAD = 0.4  # flatness of the spectrum of a test signal
_RESONANT = 4.0  # times flatter than what answers to it
_LONGEST = 1 << 20  # samples that show whether a signal is broad
_BLOCKS = 16  # of a record, over which its spectrum is averaged


@dataclass(frozen=True)
class Evidence:
    """What the judgement of a fit rests on.

    Attributes
    ----------
    estimates : Estimates
        The numbers of the fit.
    whiteness : float
        p-value of white residuals.
    findings : tuple of Finding
        What the data show beside the modes, and which assumptions they reject.
    blind : str
        What the inputs do not show; empty if they show all.
    """

    estimates: Estimates
    whiteness: float
    findings: tuple[Finding, ...]
    blind: str

    @classmethod
    def of(cls, estimates: Estimates, findings: Sequence[Finding]) -> Evidence:
        """Test the residuals, and add to findings of the search those that the estimates show."""
        free, whiteness = estimates.free, _whiteness_of(estimates)
        findings = [
            *(_in_model(finding, estimates.experiments) for finding in findings), *_lateness(estimates),
            *rejections(estimates.tests), *_reversed(estimates), *saturated(estimates.experiments, free.findings),
            *not_linear(free), *_integrators(estimates),
        ]  # fmt: skip
        findings += _same_columns(free.channels)
        if estimates.fit_percent < GOOD_FIT:
            findings += _swapped_columns(free.channels)
        if whiteness >= WHITE and not (estimates.rounding or free.interrupted):
            findings += _outlying(estimates)
        blind = _what_is_blind(estimates) if estimates.fit.point.deficiency else ""
        return cls(estimates, whiteness, tuple(findings), blind)

    def shows(self, cause: Cause) -> bool:
        """Whether there is a finding of a cause."""
        return any(finding.cause is cause for finding in self.findings)

    @property
    def is_close(self) -> bool:
        """Whether the prediction has nearly all of the outputs."""
        return self.estimates.fit_percent >= GOOD_FIT

    @cached_property
    def outcome(self) -> Outcome:
        """The judgement; values far out of the noise and blind parameters cast doubt."""
        estimates = self.estimates
        if estimates.free.interrupted:
            return Outcome.INTERRUPTED
        if not estimates.free.states:
            return Outcome.NOTHING
        if estimates.refused:
            return Outcome.DOUBTFUL if self.is_close or self.whiteness >= WHITE else Outcome.NOT_DESCRIBED
        if self.whiteness < WHITE:
            return Outcome.COLOURED if self.is_close else Outcome.DOUBTFUL
        if self.blind or any(map(self.shows, (Cause.OUTLIERS, Cause.SWAPPED, Cause.FASTEST_GROWTH))):
            return Outcome.DOUBTFUL
        enough = estimates.likelihood.spare >= _FEW or estimates.free.rounding
        if not enough:
            return Outcome.UNJUDGED
        return Outcome.CONSISTENT if estimates.fit_percent >= POOR_FIT else Outcome.MOSTLY_NOISE


def _in_model(finding: Finding, experiments: Sequence[FittedChannels]) -> Finding:
    """A finding of constants or drifts with the values that the model has."""
    if finding.cause not in (Cause.CONSTANT, Cause.DRIFT):
        return finding
    each = [experiment.offsets if finding.cause is Cause.CONSTANT else experiment.drifts for experiment in experiments]
    kept = [
        values[experiment.record.observed.any(axis=-1)] for values, experiment in zip(each, experiments, strict=True)
    ]
    return replace(finding, values=tuple(np.concatenate(kept).tolist()))


def rejections(tests: Sequence[HypothesisTest]) -> list[Finding]:
    """What the data object to structures that they reject."""
    return [
        Finding(REJECTED[test.hypothesis], (test.p, float(test.dof)), 0.5 * test.likelihood_ratio)
        for test in tests if test.hypothesis in REJECTED and test.p < LEVEL
    ]  # fmt: skip


def _reversed(estimates: Estimates) -> list[Finding]:
    """Sensors at driving points that point against the force, by the residues of all modes in units of velocity."""
    free, request, findings = estimates.free, estimates.request, list[Finding]()
    projection = free.projection
    if not (projection.inputs and free.order) or projection.deficiency:
        return findings
    residues, _ = layout_of(free, request).split(projection.shared, len(projection.p))
    modes, labels = projection.p.imag > 0, free.channels[0].output_labels
    for output, driven in request.ports:
        power = DERIVATIVES.get(request.quantities[output])
        if power is not None:
            along = residues[modes, output, driven] * projection.p[modes] ** (1 - power)
            if np.all(along.real < -_OPPOSED * np.abs(along)):
                findings.append(Finding(Cause.POLARITY, (), 0.0, labels[output]))
    return findings


def _lateness(estimates: Estimates) -> tuple[Finding, ...]:
    """What is found of delays that are left to the data: one of all outputs, or of each."""
    free, (delay, errors) = estimates.free, estimates.delays
    labels = free.channels[0].output_labels
    if not (free.delay_open and delay.any()):
        return ()
    if np.ptp(delay) == 0:
        finding = Finding(Cause.DELAY, (float(delay[0]), float(errors[0])), free.delay_gain)
        return (finding, *_of_other_hold(free, float(delay[0]), float(errors[0])))
    each = zip(labels, delay.tolist(), errors.tolist(), strict=True)
    return tuple(Finding(Cause.DELAY, (late, error), free.delay_gain, label) for label, late, error in each if late)


def _of_other_hold(free: FreeFit, delay: float, error: float) -> tuple[Finding, ...]:
    """Name the other hold where all outputs come half a sample early, as a linear input does after one that is held."""
    other = "foh" if free.intersample == "zoh" else "zoh"
    half = (0.5 if other == "zoh" else -0.5) * getattr(free.channels[0], "dt", np.nan)
    if not abs(delay - half) < _HALF * abs(half) + 2 * np.nan_to_num(error):
        return ()
    return (Finding(Cause.HOLD, (float(HOLDS.index(other)),), free.delay_gain),)


def _what_is_blind(estimates: Estimates) -> str:
    """Say what the inputs do not show, and of one record which input would."""
    free, poles, (data, *others) = estimates.free, estimates.poles, estimates.shown
    quantity = estimates.request.quantities[0]
    driven = estimates.residues.shape[2] > 0
    if not others and isinstance(data, FittedExperiment) and np.all(poles.imag) and driven:
        record, n = data.record, len(poles)
        if isinstance(record, Record) and quantity != "free":
            hold = Hold(record.dt, free.method, free.intersample)
            y = np.where(record.observed, record.y, 0.0)
            rest = not data.free_amplitudes.any()
            port = PortRecord(record.u, y, record.observed, hold, rest, quantity, record.driven)
            shown = examine(port, np.abs(poles), np.ones(n), data.free_amplitudes.conj(), time_unit=record.time_unit)
            if shown.information.is_weak:
                return f"The record {shown.headline}. {shown.message}"
    return (
        "The inputs do not show the residues: others, with other initial motions, give the same outputs. Record with "
        "inputs of more frequencies, independent of one another; phc.excitation says which."
    )


def message_of(evidence: Evidence) -> str:
    """What the judgement rests on, in sentences."""
    estimates, outcome = evidence.estimates, evidence.outcome
    free, shapes, fitted = estimates.free, estimates.shapes[0], f"{estimates.fit_percent:.0f} %"
    if outcome is Outcome.NOTHING:
        causes = [finding for finding in evidence.findings if finding.cause in (Cause.SAME_COLUMNS, Cause.SWAPPED)]
        suspected = sentences_of(causes, free.intersample, free.channels[0].time_unit)
        return " ".join(["Nothing to model: no mode improves the BIC.", *suspected])
    parts = [CUT_SHORT] * (outcome is Outcome.INTERRUPTED)
    parts += [evidence.blind] * bool(evidence.blind)
    if outcome is Outcome.NOT_DESCRIBED:
        parts.append(f"With a fit of {fitted} a model of this structure does not describe the data.")
    elif outcome is Outcome.DOUBTFUL and not evidence.blind:
        parts += _doubts(evidence)
    parts += sentences_of(evidence.findings, free.intersample, free.channels[0].time_unit)
    kept = [f"{test.hypothesis} ({p_value(test.p)})" for test in estimates.tests if test.p >= LEVEL and test.dof]
    if kept:
        parts.append(f"Not rejected: {', '.join(kept)}.")
    parts += _about_poles(evidence)
    if shapes.shapes.shape[1] > 1:
        parts.append(
            "Mode shapes are those of unit modal mass."
            if shapes.scaled.all()
            else "Mode shapes are unscaled, as no driving point was named: the largest entry is 1."
        )
    return " ".join([*parts, _about_residuals(evidence)])


def _doubts(evidence: Evidence) -> list[str]:
    """Why a fit is doubtful, and what may be done about it."""
    estimates, most = evidence.estimates, evidence.estimates.request.most
    if not (evidence.whiteness < WHITE and estimates.fit_percent < GOOD_FIT):
        return [doubt_about(evidence.findings)]
    sentences = [
        f"Doubtful, as the fit is {estimates.fit_percent:.0f} %, less than {GOOD_FIT:.0f} %, and what is left is no "
        "white noise."
    ]
    if estimates.free.order == most and not evidence.shows(Cause.LARGEST_ORDER):
        sentences.append(f"A model of more than {counted(most, 'mode')} may fit better.")
    if not any(len(channel.input_labels) for channel in estimates.free.channels):
        sentences.append(
            "This is no free decay if forces that were not measured, such as wind or traffic, act all along: "
            "noise='forces' takes it as such, of recordings with few missing samples and without a given structure."
        )
    return sentences


def doubt_about(findings: Sequence[Finding]) -> str:
    """Which of some findings casts doubt on the data, or that these reject the structure."""
    causes = {finding.cause for finding in findings}
    reasons = [reason for cause, reason in DOUBTS.items() if cause in causes]
    return f"Doubtful, as {(reasons or ['the data reject the structure that was given'])[0]}."


def _integrators(estimates: Estimates) -> list[Finding]:
    """Two poles, or one, which are 0 within errors that move them by less than what the longest record shows.

    Of two, sum and product are tested: these have errors also where the poles meet.
    """
    fit, n, slowest = estimates.fit, len(estimates.poles), _slowest(estimates)
    if not n or estimates.free.interrupted:
        return []
    near = np.argsort(np.abs(fit.p))[:2]
    near = near[:1] if fit.p[near[0]].imag else near[fit.p[near].imag == 0]
    trials = [_sum_and_product(fit.p, near)] if fit.p[near[0]].imag or len(near) > 1 else []
    if not fit.p[near[0]].imag:
        trials.append((fit.p.real[near[:1]], np.eye(2 * n)[n + near[:1]]))
    for values, slopes in trials:
        most = np.array([slowest] if len(values) == 1 else [2 * slowest, 4 * slowest**2])
        chance = _chance_of_zero(values, slopes @ fit.covariance[: 2 * n, : 2 * n] @ slopes.T, most)
        if chance > _AT_ZERO:
            return [Finding(Cause.INTEGRATOR, (float(len(values)), chance), 0.0)]
    return []


def _slowest(estimates: Estimates) -> float:
    """Rate at which a pole changes a motion by a factor of e over the longest record."""
    return TUNING.slowest_growth * estimates.free.region.bin


def _sum_and_product(p: ComplexArray, places: Indices) -> tuple[Array, Array]:
    """Sum and product of two real poles, or of one and its conjugate, and derivatives by the parts of all poles."""
    slopes, n = np.zeros((2, 2 * len(p))), len(p)
    first, last = p[places[0]], p[places[-1]].conj()
    slopes[:, n + places[0]] += 1.0, last.real
    slopes[:, n + places[-1]] += 1.0, first.real
    slopes[1, places[0]] = 2 * first.imag
    return np.array([(first + last).real, (first * last).real]), slopes


def _chance_of_zero(values: Array, covariance: Array, most: Array) -> float:
    """The p-value of numbers that are all 0; 0 where some may be larger than `most`."""
    values, covariance = values / most, covariance / np.outer(most, most)
    if not np.all(np.abs(values) + 2 * np.sqrt(np.diag(covariance)) <= 1):
        return 0.0
    return float(chi2.sf(values @ np.linalg.pinv(covariance, hermitian=True) @ values, len(values)))


def _about_poles(evidence: Evidence) -> list[str]:
    """Say which poles grow, and which modes are slower than the longest record; not of those that may be 0."""
    estimates, sentences = evidence.estimates, list[str]()
    poles = estimates.poles
    modes = int(np.sum(poles.imag != 0))
    spread = np.sqrt(np.maximum(np.diag(estimates.covariance), 0.0))
    errors = np.append(spread[len(poles) :][:modes] * np.abs(poles[:modes]), spread[modes : len(poles)])
    near = evidence.shows(Cause.INTEGRATOR) & (np.abs(poles) <= 2 * _slowest(estimates))
    growing = np.flatnonzero((poles.real > _CERTAIN * errors) & ~near)
    if len(growing):
        grow = "grows" if len(growing) == 1 else "grow"
        sentences.append(f"{counted(len(growing), 'pole')} {grow}: {', '.join(map(str, growing + 1))}.")
    lengths = (channel.dt * channel.samples for channel in estimates.free.channels if isinstance(channel, Recording))
    turns = np.abs(poles[:modes]) * max(lengths, default=np.inf) / (2 * np.pi)
    slow = np.flatnonzero((turns < 1 - 1e-6) & ~near[:modes])
    if len(slow):
        sentences.append(slower_than_record(slow.tolist()))
    return sentences


def _about_residuals(evidence: Evidence) -> str:
    """Say whether what is left is white, or why this cannot be told."""
    estimates = evidence.estimates
    if evidence.outcome is Outcome.UNJUDGED:
        spare = counted(estimates.likelihood.spare, "sample")
        return f"There are only {spare} more than unknowns, too few to judge the model."
    if estimates.free.rounding and evidence.whiteness == 1:
        return "The data are reproduced to rounding."
    if evidence.whiteness < WHITE:
        remark = "something is left unexplained"
        if estimates.free.measured is not None:
            remark = "errors and tests are those of noise with their spectrum"
        return f"The residuals are not white (Ljung-Box {p_value(evidence.whiteness)}): {remark}."
    if evidence.outcome is Outcome.MOSTLY_NOISE:
        noise = 100 - estimates.fit_percent
        return (
            f"The residuals are white, but {noise:.0f} % of the outputs in size: the model predicts little of a new "
            "record, and its standard errors hold if the rest is noise."
        )
    return f"The residuals are white{': the model explains the data' * (evidence.outcome is not Outcome.DOUBTFUL)}."


def _whiteness_of(estimates: Estimates) -> float:
    """p-value of white residuals, 1 of those that are rounding; beside forces, of the prediction errors."""
    if estimates.free.beside is not None:
        return float(estimates.free.beside.whiteness)
    return 1.0 if estimates.rounding else _whiteness(estimates)


def _whiteness(estimates: Estimates) -> float:
    """p-value of white residuals; of one input and output with what was fitted, which is missing from them.

    Short records feel that, and are tested again if they look coloured.
    """
    channels = estimates.free.channels
    rows = [row for pair in zip(estimates.experiments, channels, strict=True) for row in _rows(*pair)]
    p = ljung_box(rows, TUNING.lags)
    single = estimates.shown if estimates.is_single else ()
    samples = sum(experiment.record.samples for experiment in single)
    if not single or p >= TUNING.surely_white or samples * len(estimates.covariance) > _COUNTED:
        return p
    model = estimates.model
    directions = [directions_of(experiment, model) for experiment in single]

    def in_rows(columns: Sequence[RealOrComplex]) -> list[Array]:
        triples = zip(single, channels, columns, strict=True)
        return [part for experiment, *values in triples for part in _in_rows(experiment.record, *values)]

    shared, local = [each.shared for each in directions], [each.local for each in directions]
    return ljung_box(rows, TUNING.lags, shared=in_rows(shared), local=in_rows(local))


def _rows(experiment: FittedChannels, channel: Recording | ResponseMatrix) -> list[Signal]:
    """Real residuals of each output, or real and imaginary parts of those of each entry of a response.

    Of a response without its peaks: a few points at a resonance outweigh all others, and alone look white.
    """
    residuals = list(_residuals(experiment, channel).values())
    if isinstance(experiment.record, Recording):
        return residuals
    return [without_peaks(part) for row in residuals for part in (row[:].real, row[:].imag)]


def _residuals(experiment: FittedChannels, channel: Recording | ResponseMatrix) -> dict[str, Signal]:
    """Residuals by label of the output, or of the entry of a response, where they are weighted; of those measured.

    Where the noise of the `channel` changes they are in units of its level.
    """
    outputs, inputs = experiment.record.output_labels, experiment.record.input_labels
    if isinstance(experiment.record, Recording):
        seen = np.flatnonzero(experiment.record.observed.any(axis=1)).tolist()
        if (level := level_of(channel)) is not None:
            return {outputs[k]: experiment.residuals[k] / level[k] for k in seen}
        return {outputs[k]: Difference(experiment.measured[k], experiment.predicted[k]) for k in seen}
    residuals = experiment.record.in_noise(experiment.residuals)
    entries = [
        (f"{o}:{i}", row)
        for o, rows in zip(outputs, residuals, strict=True)
        for i, row in zip(inputs, rows, strict=True)
    ]
    return {label: row for label, row in entries if not np.isnan(row).all()}


def _in_rows(record: Any, channel: Recording | ResponseMatrix, values: NDArray[Any]) -> list[Array]:
    """Directions (T, k) of a record as its residuals are; of a response their real and imaginary parts, weighted."""
    if isinstance(record, Record):
        level = level_of(channel)
        return [values if level is None else values / level[0][:, None]]
    if record.errors is None:
        scaled = values * np.sqrt(record.weights)[:, None]
    else:
        scaled = np.nan_to_num(record.errors.whitened(0, 0, np.where(record.observed, values.T, np.nan))).T
    return [scaled.real, scaled.imag]


def saturated(experiments: Sequence[FittedChannels], known: Sequence[Finding] = ()) -> list[Finding]:
    """Outputs of recordings that stay at an end of their range, but for those that are known to be rounded."""
    records = [experiment.record for experiment in experiments if isinstance(experiment.record, Recording)]
    ends = [
        (k, name, saturation(row))
        for k, (record, rounded) in enumerate(zip(records, rounded_outputs(known, records), strict=True))
        for name, row in zip(np.array(record.output_labels)[~rounded].tolist(), record.y[~rounded], strict=True)
    ]
    return [Finding(Cause.SATURATION, (float(count), *of), 0.0, name, k) for k, name, (count, of) in ends if count]


def at_rest(experiments: Sequence[FittedChannels]) -> list[Finding]:
    """Outputs of recordings that stay at one value for a part of them."""
    findings = []
    for k, experiment in enumerate(experiments):
        for name, row in zip(experiment.record.output_labels, experiment.measured, strict=True):
            part = stuck(row)
            if part is not None:
                findings.append(Finding(Cause.STUCK, (*map(float, part), float(row[part[0]])), 0.0, name, k))
    return findings


def _outlying(estimates: Estimates) -> list[Finding]:
    """Values that stand out of the noise of all others of their output and experiment."""
    every = [
        (label, k, row) for k, pair in enumerate(zip(estimates.experiments, estimates.free.channels, strict=True))
        for label, row in _residuals(*pair).items()
    ]  # fmt: skip
    pairs = zip(every, outliers([row for *_, row in every], estimates.likelihood.spare), strict=True)
    return [Finding(Cause.OUTLIERS, tuple(map(float, far)), 0.0, label, k) for (label, k, _), far in pairs if far]


def _same_columns(records: Sequence[object]) -> list[Finding]:
    """Pairs of channels that are the same in all recordings, up to a factor."""
    recordings = [record for record in records if isinstance(record, Recording)]
    if not recordings or len(recordings) < len(records):
        return []
    labels = (*recordings[0].input_labels, *recordings[0].output_labels)
    products = np.zeros((len(labels), len(labels)))
    for record in recordings:
        for part in blocks(record.samples, len(labels)):
            signals = np.concatenate([record.u[:, part], record.y[:, part]])
            signals = signals[:, np.isfinite(signals).all(axis=0)]
            products += signals @ signals.T
    powers = np.diag(products)
    findings = []
    for j, k in combinations(range(len(labels)), 2):
        if powers[j] > 0 and powers[k] > 0:
            factor = products[j, k] / powers[j]
            if powers[k] - factor * products[j, k] <= _SAME * powers[k]:
                findings.append(Finding(Cause.SAME_COLUMNS, (float(factor),), 0.0, f"{labels[j]!r} and {labels[k]!r}"))
    return findings


def _swapped_columns(records: Sequence[object]) -> list[Finding]:
    """Input and output of recordings of one each, where the output is broad and the input resonates."""
    findings = []
    for record in records:
        if isinstance(record, Recording) and len(record.u) == len(record.y) == 1 and np.isfinite(record.y).all():
            into, out = _flatness(record.u[0]), _flatness(record.y[0])
            if out > max(_BROAD, _RESONANT * into):
                names = f"{record.input_labels[0]!r}"
                findings.append(Finding(Cause.SWAPPED, (into, out), 0.0, names))
    return findings if len(findings) == len(records) else []


def _flatness(signal: Array) -> float:
    """Geometric over arithmetic mean of the spectrum, 1 for white noise; averaged over blocks."""
    length = min(len(signal), _LONGEST) // _BLOCKS
    if length < 8:
        return 0.1  # neither broad nor resonant
    signal = signal[: _BLOCKS * length]
    blocks = (signal - signal.mean()).reshape(_BLOCKS, length) * np.hanning(length)
    spectrum = np.mean(np.abs(np.fft.rfft(blocks, axis=1)[:, 1:-1]) ** 2, axis=0)
    if not spectrum.all():
        return 0.0
    return float(np.exp(np.mean(np.log(spectrum))) / np.mean(spectrum))

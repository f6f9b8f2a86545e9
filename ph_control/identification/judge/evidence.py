"""What speaks for and against a fit, and what it amounts to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._units import DERIVATIVES
from ...modal.discretization import Hold
from ..data.time_record import Record
from ..diagnosis.nonlinearity import not_linear
from ..diagnosis.verdict import GOOD_FIT, POOR_FIT, WHITE, HypothesisTest, Outcome
from ..estimates.estimates import Estimates
from ..excitation.excitation import examine
from ..regression.prediction import FittedChannels, FittedExperiment
from ..search.findings import HOLDS, REJECTED, Cause, Finding
from ..search.fitted_modes import FreeFit
from ..structure.choice import layout_of
from ..structure.hypothesis_tests import LEVEL
from ..uncertainty.fisher import PortRecord
from .columns import same_columns, swapped_columns
from .residuals import outlying, saturated, whiteness_of

_HALF = 0.05  # of half a sample: what a delay may differ from it by
_OPPOSED = 0.7  # cosine of the angle within which a residue points against the force
_FEW = 20  # samples beyond the unknowns, with fewer of which nothing can be judged


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
        free, whiteness = estimates.free, whiteness_of(estimates)
        findings = [
            *(_in_model(finding, estimates.experiments) for finding in findings), *_lateness(estimates),
            *rejections(estimates.tests), *_reversed(estimates), *saturated(estimates.experiments), *not_linear(free),
        ]  # fmt: skip
        findings += same_columns(free.channels)
        if estimates.fit_percent < GOOD_FIT:
            findings += swapped_columns(free.channels)
        if whiteness >= WHITE and not (estimates.rounding or free.interrupted):
            findings += outlying(estimates)
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
        if self.blind or self.shows(Cause.OUTLIERS) or self.shows(Cause.SWAPPED):
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

"""The judgement of a fit in sentences."""

from __future__ import annotations

import numpy as np

from ..._display import counted, p_value
from ..data.channels import Recording
from ..diagnosis.verdict import CUT_SHORT, GOOD_FIT, WHITE, Outcome, slower_than_record
from ..estimates.estimates import Estimates
from ..search.findings import Cause, sentences_of
from ..structure.hypothesis_tests import LEVEL
from .evidence import Evidence

_CERTAIN = 3.0  # standard errors beyond which a mode is said to grow


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
    parts += _about_poles(estimates)
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
        reasons = {
            Cause.OUTLIERS: "some values are far out of the noise", Cause.SWAPPED: "columns are probably swapped",
        }  # fmt: skip
        shown = [reason for cause, reason in reasons.items() if evidence.shows(cause)]
        return [f"Doubtful, as {(shown or ['the data reject the structure that was given'])[0]}."]
    sentences = [
        f"Doubtful, as the fit is {estimates.fit_percent:.0f} %, less than {GOOD_FIT:.0f} %, and what is left is no "
        "white noise."
    ]
    if estimates.free.order == most and not evidence.shows(Cause.LARGEST_ORDER):
        sentences.append(f"A model of more than {counted(most, 'mode')} may fit better.")
    if not any(len(channel.input_labels) for channel in estimates.free.channels):
        sentences.append(
            "This is no free decay if forces that were not measured, such as wind or traffic, act all along: "
            "noise='forces' takes it as such, of recordings without missing samples and without a given structure."
        )
    return sentences


def _about_poles(estimates: Estimates) -> list[str]:
    """Say which poles grow, and which modes are slower than the longest record."""
    poles, sentences = estimates.poles, list[str]()
    modes = int(np.sum(poles.imag != 0))
    spread = np.sqrt(np.maximum(np.diag(estimates.covariance), 0.0))
    errors = np.append(spread[len(poles) :][:modes] * np.abs(poles[:modes]), spread[modes : len(poles)])
    growing = np.flatnonzero(poles.real > _CERTAIN * errors)
    if len(growing):
        grow = "grows" if len(growing) == 1 else "grow"
        sentences.append(f"{counted(len(growing), 'pole')} {grow}: {', '.join(map(str, growing + 1))}.")
    lengths = (channel.dt * channel.samples for channel in estimates.free.channels if isinstance(channel, Recording))
    slow = np.flatnonzero(np.abs(poles[:modes]) * max(lengths, default=np.inf) < 2 * np.pi * (1 - 1e-6))
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

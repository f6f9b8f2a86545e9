"""What tests of residuals found, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..._display import first_of, p_value

if TYPE_CHECKING:
    from .residual_analysis import ResidualAnalysis


class _Cause(NamedTuple):
    """Something that a test can see in residuals: its p-value, the verdict if it is the first seen, and a sentence."""

    p: float
    verdict: str
    sentence: str


def verdict_of(analysis: ResidualAnalysis) -> str:
    """Verdict in a line; what matters most to a user of the model comes first."""
    if analysis.rounding:
        return f"at rounding level: the model reproduces the {'response' if analysis._spectral else 'record'}"
    if causes := _seen(analysis):
        return causes[0].verdict
    if np.isnan(analysis.whiteness):
        return "too few to judge"
    return (
        "white over frequency"
        if analysis._spectral
        else "white" + ", and independent of the input" * analysis.input_varies
    )


def message_of(analysis: ResidualAnalysis) -> str:
    """Explanation of the verdict, in sentences."""
    if analysis.rounding:
        return "What is left is rounding, of which the tests say nothing."
    parts = [cause.sentence for cause in _seen(analysis)]
    parts = parts or ["Nothing that these tests can see is left in the residuals."]
    if analysis._spectral:
        parts.append("A response has no input of its own to hold its residuals against.")
    elif not analysis._driven:
        parts.append("There was no input, so nothing can be said of a response to it, or of feedback.")
    elif not analysis.input_varies:
        parts.append("The input is constant, so nothing can be said of a response to it.")
    elif np.isnan(analysis.response_p_value):
        parts.append("The record is too short, or its input too poor, to tell a response to the input.")
    return " ".join(parts)


def _seen(analysis: ResidualAnalysis) -> list[_Cause]:
    causes = _of_responses(analysis) if analysis._spectral else _of_records(analysis)
    return [cause for cause in causes if cause.p < 1 - analysis.confidence]


def _of_records(analysis: ResidualAnalysis) -> list[_Cause]:
    response, feedback, offset = analysis.response_p_value, analysis.feedback_p_value, analysis.offset_p_value
    missing = response < 1 - analysis.confidence
    also = ", or a response longer than the lags looked at" if missing else ""
    noise = (
        "what is missing shows there as well."
        if missing
        else "the noise is coloured, or what is missing remembers too long for this test, as wrong damping, wrong "
        "frequencies or a free motion do."
    )
    return [
        _Cause(
            response,
            "NOT all of the response to the input is in the model",
            f"The residuals respond to the input ({p_value(response)}): dynamics are missing or wrong; raise "
            "the order, or suspect damping, the hold of the input between samples, or the quantity measured.",
        ),
        _Cause(
            feedback,
            "related to later inputs: feedback in the recording",
            f"Later inputs are related to them ({p_value(feedback)}): the input was made from the output by "
            f"a feedback{also}. An output-error fit is then biased unless the noise is white.",
        ),
        _Cause(
            offset,
            "about a mean that is not zero",
            f"Their mean is {_listed(analysis.means)} ({p_value(offset)}): the sensor has an offset; subtract it "
            "before the fit, or estimate it with offset=True.",
        ),
        _Cause(
            analysis.whiteness,
            "coloured" + ", though no response to the input is seen" * analysis.input_varies,
            f"They are not white (Ljung-Box {p_value(analysis.whiteness)}): {noise}",
        ),
    ]


def _of_responses(analysis: ResidualAnalysis) -> list[_Cause]:
    return [
        _Cause(
            analysis.whiteness,
            "NOT white over frequency: the model lacks part of the response",
            f"The residuals follow one another from point to point (Ljung-Box {p_value(analysis.whiteness)}): dynamics "
            "are missing or wrong there; raise the order, or suspect damping, modes beyond the band, or the "
            "quantity measured. A response that was itself estimated with overlapping or tapered windows has noise "
            "of this kind too.",
        ),
        _Cause(
            analysis.offset_p_value,
            "about a constant over frequency that is not zero",
            f"They lie about the constant {_listed(analysis.means)} ({p_value(analysis.offset_p_value)}): a part that "
            "is fed through, or modes beyond the band.",
        ),
    ]


def _listed(means: Sequence[complex]) -> str:
    shown = [f"{m.real:.3g}{m.imag:+.3g}i" if isinstance(m, complex) else f"{m:.3g}" for m in means]
    return first_of(shown, 4, ", ...")

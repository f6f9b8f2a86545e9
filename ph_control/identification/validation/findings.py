"""What tests of residuals found, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..._display import p_value

if TYPE_CHECKING:
    from .residual_analysis import ResidualAnalysis


class _Cause(NamedTuple):
    """Something that a test can see in residuals: its p-value, the verdict if it is the first seen, and a sentence."""

    p: float
    verdict: str
    sentence: str


def verdict_of(found: ResidualAnalysis) -> str:
    """Verdict in a line; what matters most to a user of the model comes first."""
    if found.rounding:
        return f"at rounding level: the model reproduces the {'response' if found._spectral else 'record'}"
    if causes := _seen(found):
        return causes[0].verdict
    if np.isnan(found.whiteness):
        return "too few to judge"
    return (
        "white over frequency" if found._spectral else "white" + ", and independent of the input" * found.input_varies
    )


def message_of(found: ResidualAnalysis) -> str:
    """All sentences."""
    if found.rounding:
        return "What is left is rounding, of which the tests say nothing."
    parts = [cause.sentence for cause in _seen(found)]
    parts = parts or ["Nothing that these tests can see is left in the residuals."]
    if found._spectral:
        parts.append("A response has no input of its own to hold its residuals against.")
    elif not found._driven:
        parts.append("There was no input, so nothing can be said of a response to it, or of feedback.")
    elif not found.input_varies:
        parts.append("The input is constant, so nothing can be said of a response to it.")
    elif np.isnan(found.response_p_value):
        parts.append("The record is too short, or its input too poor, to tell a response to the input.")
    return " ".join(parts)


def _seen(found: ResidualAnalysis) -> list[_Cause]:
    causes = _of_responses(found) if found._spectral else _of_records(found)
    return [cause for cause in causes if cause.p < 1 - found.confidence]


def _of_records(found: ResidualAnalysis) -> list[_Cause]:
    response, feedback, offset = found.response_p_value, found.feedback_p_value, found.offset_p_value
    missing = response < 1 - found.confidence
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
            f"Their mean is {_listed(found.means)} ({p_value(offset)}): the sensor has an offset; subtract it before "
            "the fit, or estimate it with offset=True.",
        ),
        _Cause(
            found.whiteness,
            "coloured" + ", though no response to the input is seen" * found.input_varies,
            f"They are not white (Ljung-Box {p_value(found.whiteness)}): {noise}",
        ),
    ]


def _of_responses(found: ResidualAnalysis) -> list[_Cause]:
    return [
        _Cause(
            found.whiteness,
            "NOT white over frequency: the model lacks part of the response",
            f"The residuals follow one another from point to point (Ljung-Box {p_value(found.whiteness)}): dynamics "
            "are missing or wrong there; raise the order, or suspect damping, modes beyond the band, or the "
            "quantity measured. A response that was itself estimated with overlapping or tapered windows has noise "
            "of this kind too.",
        ),
        _Cause(
            found.offset_p_value,
            "about a constant over frequency that is not zero",
            f"They lie about the constant {_listed(found.means)} ({p_value(found.offset_p_value)}): a part that is fed "
            "through, or modes beyond the band.",
        ),
    ]


def _listed(means: Sequence[complex]) -> str:
    shown = [f"{m.real:.3g}{m.imag:+.3g}i" if isinstance(m, complex) else f"{m:.3g}" for m in means[:4]]
    return ", ".join(shown) + ", ..." * (len(means) > 4)

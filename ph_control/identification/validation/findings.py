"""What tests of residuals found, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..._display import p_value
from ..uncertainty.residual_tests import Influence


class _Cause(NamedTuple):
    """Something that a test can see in residuals: its p-value, the verdict if it is the first seen, and a sentence."""

    p: float
    verdict: str
    sentence: str


@dataclass(frozen=True)
class Findings:
    """What the tests found, to be told in words.

    `driven` tells whether an input varies, `have_input` whether there is one at all, `spectral` that the residuals are
    those of frequency responses, of which `means` has the constants over frequency.
    """

    rounding: bool
    whiteness: float
    causes: Influence
    level: float
    driven: bool
    have_input: bool
    spectral: bool
    means: list[complex]

    @property
    def headline(self) -> str:
        """Verdict in a line; what matters most to a user of the model comes first."""
        if self.rounding:
            return f"at rounding level: the model reproduces the {'response' if self.spectral else 'record'}"
        if self._seen:
            return self._seen[0].verdict
        if np.isnan(self.whiteness):
            return "too few to judge"
        return "white over frequency" if self.spectral else "white" + ", and independent of the input" * self.driven

    def message(self) -> str:
        """All sentences."""
        if self.rounding:
            return "What is left is rounding, of which the tests say nothing."
        parts = [cause.sentence for cause in self._seen]
        parts = parts or ["Nothing that these tests can see is left in the residuals."]
        if self.spectral:
            parts.append("A response has no input of its own to hold its residuals against.")
        elif not self.have_input:
            parts.append("There was no input, so nothing can be said of a response to it, or of feedback.")
        elif not self.driven:
            parts.append("The input is constant, so nothing can be said of a response to it.")
        elif np.isnan(self.causes.response):
            parts.append("The record is too short, or its input too poor, to tell a response to the input.")
        return " ".join(parts)

    @property
    def _seen(self) -> list[_Cause]:
        causes = self._of_responses() if self.spectral else self._of_records()
        return [cause for cause in causes if cause.p < self.level]

    def _of_records(self) -> list[_Cause]:
        found, white = self.causes, p_value(self.whiteness)
        missing = found.response < self.level
        also = ", or a response longer than the lags looked at" if missing else ""
        noise = (
            "what is missing shows there as well."
            if missing
            else "the noise is coloured, or what is missing remembers too long for this test, as wrong damping, wrong "
            "frequencies or a free motion do."
        )
        return [
            _Cause(
                found.response,
                "NOT all of the response to the input is in the model",
                f"The residuals respond to the input ({p_value(found.response)}): dynamics are missing or wrong; raise "
                "the order, or suspect damping, the hold of the input between samples, or the quantity measured.",
            ),
            _Cause(
                found.feedback,
                "related to later inputs: feedback in the recording",
                f"Later inputs are related to them ({p_value(found.feedback)}): the input was made from the output by "
                f"a feedback{also}. An output-error fit is then biased unless the noise is white.",
            ),
            _Cause(
                found.offset,
                "about a mean that is not zero",
                f"Their mean is {self._listed} ({p_value(found.offset)}): the sensor has an offset; subtract it before "
                "the fit, or estimate it with offset=True.",
            ),
            _Cause(
                self.whiteness,
                "coloured" + ", though no response to the input is seen" * self.driven,
                f"They are not white (Ljung-Box {white}): {noise}",
            ),
        ]

    def _of_responses(self) -> list[_Cause]:
        return [
            _Cause(
                self.whiteness,
                "NOT white over frequency: the model lacks part of the response",
                f"The residuals follow one another from point to point (Ljung-Box {p_value(self.whiteness)}): dynamics "
                "are missing or wrong there; raise the order, or suspect damping, modes beyond the band, or the "
                "quantity measured. A response that was itself estimated with overlapping or tapered windows has noise "
                "of this kind too.",
            ),
            _Cause(
                self.causes.offset,
                "about a constant over frequency that is not zero",
                f"They lie about the constant {self._listed} ({p_value(self.causes.offset)}): a part that is fed "
                "through, or modes beyond the band.",
            ),
        ]

    @property
    def _listed(self) -> str:
        means = self.means[:4]
        shown = [f"{m.real:.3g}{m.imag:+.3g}i" if isinstance(m, complex) else f"{m:.3g}" for m in means]
        return ", ".join(shown) + ", ..." * (len(self.means) > 4)

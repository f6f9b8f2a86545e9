"""What tests of residuals found, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._display import p_value
from ..uncertainty.residual_tests import Influence


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
    def _coloured(self) -> bool:
        return self.whiteness < self.level

    @property
    def headline(self) -> str:
        """Verdict in a line; what matters most to a user of the model comes first."""
        if self.rounding:
            return f"at rounding level: the model reproduces the {'response' if self.spectral else 'record'}"
        if self.spectral:
            return self._over_frequency
        if self.causes.response < self.level:
            return "NOT all of the response to the input is in the model"
        if self.causes.feedback < self.level:
            return "related to later inputs: feedback in the recording"
        if self.causes.offset < self.level:
            return "about a mean that is not zero"
        if self._coloured:
            return "coloured, though no response to the input is seen" if self.driven else "coloured"
        if np.isnan(self.whiteness):
            return "too few to judge"
        return "white, and independent of the input" if self.driven else "white"

    @property
    def _over_frequency(self) -> str:
        if self._coloured:
            return "NOT white over frequency: the model lacks part of the response"
        if self.causes.offset < self.level:
            return "about a constant over frequency that is not zero"
        return "too few to judge" if np.isnan(self.whiteness) else "white over frequency"

    def message(self) -> str:
        """All sentences."""
        if self.rounding:
            return "What is left is rounding, of which the tests say nothing."
        parts = self._of_responses() if self.spectral else self._of_records()
        if not parts:
            parts.append("Nothing that these tests can see is left in the residuals.")
        if self.spectral:
            parts.append("A response has no input of its own to hold its residuals against.")
        elif not self.have_input:
            parts.append("There was no input, so nothing can be said of a response to it, or of feedback.")
        elif not self.driven:
            parts.append("The input is constant, so nothing can be said of a response to it.")
        elif np.isnan(self.causes.response):
            parts.append("The record is too short, or its input too poor, to tell a response to the input.")
        return " ".join(parts)

    def _of_records(self) -> list[str]:
        parts, causes = [], self.causes
        if causes.response < self.level:
            parts.append(
                f"The residuals respond to the input ({p_value(causes.response)}): dynamics are missing or wrong; "
                "raise the order, or suspect damping, the hold of the input between samples, or the quantity measured."
            )
        if causes.feedback < self.level:
            also = ", or a response longer than the lags looked at" if causes.response < self.level else ""
            parts.append(
                f"Later inputs are related to them ({p_value(causes.feedback)}): the input was made from the output "
                f"by a feedback{also}. An output-error fit is then biased unless the noise is white."
            )
        if causes.offset < self.level:
            parts.append(
                f"Their mean is {self._listed} ({p_value(causes.offset)}): the sensor has an offset; subtract it "
                "before the fit, or estimate it with offset=True."
            )
        if self._coloured:
            parts.append(
                f"They are not white (Ljung-Box {p_value(self.whiteness)})"
                + (
                    ": what is missing shows there as well."
                    if causes.response < self.level
                    else ": the noise is coloured, or what is missing remembers too long for this test, as wrong "
                    "damping, wrong frequencies or a free motion do."
                )
            )
        return parts

    def _of_responses(self) -> list[str]:
        parts = []
        if self._coloured:
            parts.append(
                f"The residuals follow one another from point to point (Ljung-Box {p_value(self.whiteness)}): dynamics "
                "are missing or wrong there; raise the order, or suspect damping, modes beyond the band, or the "
                "quantity measured. A response that was itself estimated with overlapping or tapered windows has noise "
                "of this kind too."
            )
        if self.causes.offset < self.level:
            parts.append(
                f"They lie about the constant {self._listed} ({p_value(self.causes.offset)}): a part that is fed "
                "through, or modes beyond the band."
            )
        return parts

    @property
    def _listed(self) -> str:
        means = self.means[:4]
        shown = [f"{m.real:.3g}{m.imag:+.3g}i" if isinstance(m, complex) else f"{m:.3g}" for m in means]
        return ", ".join(shown) + ", ..." * (len(self.means) > 4)

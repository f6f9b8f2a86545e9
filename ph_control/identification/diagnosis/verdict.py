"""What to tell the user about a fit, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from ..._display import counted, p_value
from ..search.circumstances import far_out
from ..uncertainty.fisher import named_modes

WHITE = 1e-3  # p-value below which residuals are called coloured
GOOD_FIT = 90.0  # percent
CUT_SHORT = "The fit was interrupted; the numbers above are the best found until then."
_FEW = 20  # samples to spare below which nothing is said of the quality


class Outcome(Enum):
    """What a fit amounts to; the value is its line in a report."""

    CONSISTENT = "consistent with the record"
    COLOURED = "consistent with the record, noise not white"
    UNJUDGED = "too few samples to judge"
    DOUBTFUL = "doubtful, see below"
    NOT_DESCRIBED = "NOT described by a collocated lossless model"
    NO_RESPONSE = "NOT a model: it does not respond to the input"
    NOTHING = "nothing to model"
    INTERRUPTED = "none, the fit was interrupted"

    @property
    def leaves_a_model(self) -> bool:
        """Whether there is a model that may describe the data."""
        return self not in (Outcome.NOT_DESCRIBED, Outcome.NO_RESPONSE, Outcome.NOTHING)


SOUND = (Outcome.CONSISTENT, Outcome.COLOURED, Outcome.UNJUDGED)  # nothing speaks against the model


@dataclass(frozen=True)
class HypothesisTest:
    """A hypothesis within a wider model, by the likelihood that it costs.

    Attributes
    ----------
    hypothesis : str
        What is tested: 'lossless'.
    likelihood_ratio : float
        Twice the log-likelihood that the wider model gains.
    dof : int
        Unknowns that it has more.
    p : float
        Probability of as much by chance.
    """

    hypothesis: str
    likelihood_ratio: float
    dof: int
    p: float


@dataclass(frozen=True)
class FitVerdict:
    """What to tell the user about a fit."""

    n: int
    order: int
    from_rest: bool
    spare: int
    fit_percent: float
    active: tuple[int, ...]
    blind: str
    remark: str
    whiteness: float
    converged: bool
    noiseless: bool
    at_limit: bool
    order_given: bool
    silent: bool
    reversed_sign: bool
    drifting: tuple[int, ...]
    interrupted: bool
    driven: bool
    contradiction: str = ""
    refused: HypothesisTest | None = None
    quantity: str = "velocity"
    in_time: bool = True
    alike: bool = False
    share: float = 0.0
    circumstances: tuple[str, ...] = ()
    explained: bool = False
    named: bool = False
    outliers: tuple[tuple[int, ...], ...] = ()

    @property
    def _coloured(self) -> bool:
        return self.whiteness < WHITE

    @property
    def _unexplained(self) -> bool:
        return self._coloured and not self.explained

    @cached_property
    def outcome(self) -> Outcome:
        """What the fit amounts to."""
        if self.interrupted:
            return Outcome.INTERRUPTED
        if self.n == 0:
            return Outcome.NOTHING
        if self.silent and self.driven and not self.blind:
            return Outcome.NO_RESPONSE
        # weights that leave no trace may come out as 0 and say nothing
        held = not self.blind and 2 * len(self.active) >= self.n
        poor = self.fit_percent < GOOD_FIT or self.at_limit or held
        refuted = self._unexplained or self.contradiction or self.refused
        if refuted and poor:
            return Outcome.NOT_DESCRIBED
        if refuted or self.active or self.blind or not self.converged or any(self.outliers):
            return Outcome.DOUBTFUL
        if self._coloured:
            return Outcome.COLOURED
        return Outcome.UNJUDGED if self.spare < _FEW and not self.noiseless else Outcome.CONSISTENT

    def message(self) -> str:
        """All sentences."""
        parts = []
        if not self.driven and self.n:
            parts.append(
                "Without an input the weights r cannot be estimated: they are 1 by convention; only frequencies and "
                "initial states are estimated."
            )
        if self.silent and self.driven and self.n and not self.blind:
            parts.append(
                "All weights are zero: the model does not respond to the input and fits free motion only."
                + (" Unconstrained, all residues are negative: check the polarity of the sensor." * self.reversed_sign)
            )
        if self.interrupted:
            parts.append(CUT_SHORT)
        elif not self.converged:
            parts.append("The refinement did not converge; the numbers above are the best found.")
        if self.n == 0:
            return "Nothing to model: no mode improves the BIC. " + " ".join(parts)
        if self.order > self.n:
            parts.append(
                f"The record shows {counted(self.n, 'mode')}, the residual is at rounding level; the other "
                f"{self.order - self.n} of the {self.order} requested have r = 0 and placeholder frequencies."
            )
        if self.at_limit:
            parts.append(
                f"The BIC still decreases at the largest order tried ({self.order}): more modes would fit "
                "better, as when many lossless modes imitate a damped one; raise max_order or "
                "question the model."
            )
        if self.drifting and not self.blind:
            parts.append(slower_than_record(self.drifting))
        if self.active and not self.blind:
            asked = (
                "the record needs a residue that no lossless model with input and output at the same port has."
                if self._unexplained or self.contradiction
                else "noise hides whether the input reaches it."
            )
            parts.append(f"The constraint r >= 0 is active for {named_modes([l + 1 for l in self.active])}: {asked}")
        if self.blind or self.remark:
            parts.append(self.blind or self.remark)
        if self.contradiction:
            parts.append(self.contradiction)
        elif self.refused:
            parts.append(
                f"Modes with damping and residues of any phase reject the lossless model (likelihood ratio "
                f"{self.refused.likelihood_ratio:.4g} for {self.refused.dof} degrees of freedom, "
                f"{p_value(self.refused.p)}): its standard errors are not valid."
            )
        parts += self.circumstances
        if self._unexplained:
            parts.append(
                f"The residuals are not white (Ljung-Box {p_value(self.whiteness)}): the model misses part of the data."
            )
        if self.alike and (self._unexplained or self.contradiction):
            parts.append(
                "All points have equal weights, and noise proportional to the gain looks like this too; if yours "
                "is, pass weights=1/(standard deviation)**2 of each point."
            )
        if not self.outcome.leaves_a_model:
            if self.order_given and not self.contradiction:
                parts.append("The order was given; a higher one may fit better: try order='auto'.")
            parts.append(self._refusal())
            if self.from_rest and not self.contradiction:
                parts.append("The plant was assumed to start at rest; otherwise use initial_state='estimate'.")
        if self.spare < _FEW and not self.noiseless:
            parts.append(
                f"The record has only {counted(self.spare, 'sample')} more than the model has unknowns: "
                "its quality cannot be judged."
            )
        if any(self.outliers) and not (self._coloured or self.contradiction):
            parts.append(self._standing_out())
        if self.share:
            parts.append(
                f"The noise grows with the gain, by an estimated {100 * self.share:.2g} % of it, and each point "
                "is weighted accordingly."
            )
        if len(parts) == (not self.driven and self.n > 0) + bool(self.share):
            parts.append(
                "The record is reproduced to rounding."
                if self.noiseless
                else "The residuals are white: the model explains the record."
            )
        return " ".join(parts)

    def _standing_out(self) -> str:
        """Which samples stand out of the noise."""
        several = len(self.outliers) > 1
        named = [
            f"{k}" + f" of experiment {place}" * several
            for place, one in enumerate(self.outliers, start=1)
            for k in one
        ]
        return far_out("Samples" if self.in_time else "Points", named)

    def _refusal(self) -> str:
        """That no such model describes the data, and what to suspect where nothing was found to contradict it."""
        found = (
            f"With a fit of {self.fit_percent:.1f} % a collocated lossless {self.quantity} model does not describe "
            f"this {'record' if self.in_time else 'response'}"
        )
        if self.contradiction or self.named:
            return found + "."
        others = [one for one in ("velocity", "displacement", "acceleration") if one != self.quantity]
        return (
            f"{found}: suspect damping, a sensor away from the actuator, an output that is not the {self.quantity} "
            f"({', '.join(others)})."
        )


def slower_than_record(modes: Sequence[int]) -> str:
    """What modes, numbered from 0, are that would complete less than one period in the record, and what to do."""
    return (
        f"{named_modes([l + 1 for l in modes]).capitalize()} would complete less than one period in the record: "
        "probably an offset or a drift; subtract the mean or the trend first."
    )

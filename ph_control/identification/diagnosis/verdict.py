"""What to tell the user about a fit, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from ..uncertainty.fisher import named_modes

WHITE = 1e-3  # p-value below which residuals are called coloured
GOOD_FIT = 90.0  # percent
POOR_FIT = 50.0  # percent, of what a plant explains
CUT_SHORT = "The fit was interrupted; the numbers above are the best found until then."


class Outcome(Enum):
    """What a fit amounts to; the value is its line in a report."""

    CONSISTENT = "consistent with the record"
    COLOURED = "consistent with the record, noise not white"
    MOSTLY_NOISE = "little of the record explained, the rest is noise"
    UNJUDGED = "too few samples to judge"
    DOUBTFUL = "doubtful, see below"
    NOT_DESCRIBED = "NOT described by a model of this structure"
    NOTHING = "nothing to model"
    INTERRUPTED = "none, the fit was interrupted"

    @property
    def leaves_a_model(self) -> bool:
        """Whether there is a model that may describe the data."""
        return self not in (Outcome.NOT_DESCRIBED, Outcome.NOTHING)


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


def slower_than_record(modes: Sequence[int]) -> str:
    """What modes, numbered from 0, are that would complete less than one period in the record, and what to do."""
    return (
        f"{named_modes([l + 1 for l in modes]).capitalize()} would complete less than one period in the record: "
        "probably an offset or a drift; subtract the mean or the trend first."
    )

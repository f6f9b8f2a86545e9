"""What every report on the excitation of a plant says of the information."""

from __future__ import annotations

from ..._types import Array
from ..uncertainty.fisher import Combination, Information


class OfInformation:
    """Names, rank and combinations without a trace, of a report that has the `information`."""

    information: Information

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, modes and poles counted from 1."""
        return self.information.names

    @property
    def rank(self) -> int:
        """Number of independent combinations of unknowns that the records show."""
        return self.information.rank

    @property
    def singular_values(self) -> Array:
        """Singular values of the sensitivities scaled to unit length, descending; squared, those of the information."""
        return self.information.singular_values

    @property
    def condition(self) -> float:
        """Condition number of the information scaled to unit diagonal; `inf` where a combination is blind."""
        return self.information.condition

    @property
    def blind(self) -> tuple[Combination, ...]:
        """Combinations of unknowns that leave no trace in the outputs."""
        return self.information.blind

    @property
    def nearly_blind(self) -> tuple[Combination, ...]:
        """Combinations whose errors are inflated more than a hundred times."""
        return self.information.nearly_blind

    @property
    def blind_parameters(self) -> tuple[str, ...]:
        """Names of the unknowns that the records do not determine, however little the noise."""
        return self.information.blind_parameters

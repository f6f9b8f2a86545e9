"""Errors and warnings of the package.

Every error that bad input can cause derives from `PHControlError`; its message says what was
measured, what is allowed, and what to do.
"""

from __future__ import annotations

from collections.abc import Sequence


class PHControlError(Exception):
    """Root of all errors raised by this package."""


class StructureError(PHControlError, ValueError):
    """The input is not what the call needs: shape, symmetry, definiteness, range or content."""


class NotLosslessError(StructureError):
    """A linear system is not lossless, so that no port-Hamiltonian system has its transfer function.

    Parameters
    ----------
    violations : sequence of str
        One sentence for every pole, residue or feedthrough that contradicts losslessness, with its
        size and the tolerance it was held against.

    Attributes
    ----------
    violations : tuple of str
        The sentences above.
    """

    def __init__(self, violations: Sequence[str]) -> None:
        self.violations = tuple(violations)
        shown = self.violations[:8]
        more = len(self.violations) - len(shown)
        lines = ["the system is not lossless, so it has no port-Hamiltonian form:"]
        lines += [f"  - {line}" for line in shown]
        if more:
            lines.append(f"  - and {more} more; see the attribute violations")
        lines.append("  a lossless system is sum_l kappa_l s/(s^2 + d_l^2) + kappa_0/s with every kappa positive")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[type[NotLosslessError], tuple[tuple[str, ...]]]:
        return type(self), (self.violations,)


class IdentificationError(PHControlError):
    """A model cannot be fitted to this record."""


class FileFormatError(StructureError):
    """A file is not what it should be: damaged, of another kind, or of a newer schema."""


class FileMissingError(PHControlError, FileNotFoundError):
    """A file to be read, or the folder of a file to be written, does not exist."""


class OutputExistsError(PHControlError, FileExistsError):
    """The file to be written exists already and overwriting was not asked for."""


class IdentifiabilityWarning(UserWarning):
    """The data do not determine some of the fitted parameters."""


class ResolutionWarning(UserWarning):
    """A time grid does not resolve, or does not show, some of the modes."""


class ConditioningWarning(UserWarning):
    """Rounding to doubles leaves fewer digits in a result than a user would expect."""

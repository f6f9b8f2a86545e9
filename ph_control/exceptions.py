"""Errors and warnings of the package.

Every error that bad input can cause derives from `PHControlError`; its message says what was
measured, what is allowed, and what to do.
"""

from __future__ import annotations

import re
from collections.abc import Sequence


class PHControlError(Exception):
    """Root of all errors raised by this package.

    Examples
    --------
    >>> import ph_control as phc
    >>> try:
    ...     phc.ph(phc.modes([-1.0], [1.0]))
    ... except phc.PHControlError as error:
    ...     print(type(error).__name__)
    StructureError
    """

    def __str__(self) -> str:
        """Return the message, without the middle of what is too long to be read, such as a label."""
        return shortened(super().__str__())


def shortened(text: str) -> str:
    """Text without the middle of words of hundreds of letters, nor that of thousands of words."""
    text = re.sub(r"\S{400,}", lambda found: f"{found[0][:150]}...{found[0][-150:]}", text)
    return text if len(text) < 8000 else f"{text[:5000]} ... {text[-2000:]}"


class StructureError(PHControlError, ValueError):
    """The input is not what the call needs: shape, symmetry, definiteness, range or content.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.williamson([[1.0, 0.5], [0.0, 1.0]])
    Traceback (most recent call last):
    ...
    ph_control.exceptions.StructureError: Q is not symmetric: ...
    """


class NotLosslessError(StructureError):
    """A linear system is not lossless where only lossless ones are defined.

    Parameters
    ----------
    violations : sequence of str
        One sentence for every pole, residue or feedthrough that contradicts losslessness, with its
        size and the tolerance it was held against.
    message : str, optional
        Message in place of the default one, which says that the system has no lossless port-Hamiltonian form.

    Attributes
    ----------
    violations : tuple of str
        The sentences above.

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> try:
    ...     phc.ph(ct.tf([1, 0], [1, 0.1, 4]))
    ... except phc.NotLosslessError as error:
    ...     print(len(error.violations), error.violations[0].split(":")[0])
    1 pole -0.05+1.99937i is off the imaginary axis
    """

    def __init__(self, violations: Sequence[str], message: str | None = None) -> None:
        self.violations, self._message = tuple(violations), message
        if message is not None:
            super().__init__(message)
            return
        shown = self.violations[:8]
        more = len(self.violations) - len(shown)
        lines = ["the system is not lossless, so it has no port-Hamiltonian form:"]
        lines += [f"  - {line}" for line in shown]
        if more:
            lines.append(f"  - and {more} more; see the attribute violations")
        lines.append("  a lossless system is sum_l kappa_l s/(s^2 + d_l^2) + kappa_0/s with every kappa positive")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[type[NotLosslessError], tuple[tuple[str, ...], str | None]]:
        return type(self), (self.violations, self._message)


class IdentificationError(PHControlError):
    """A model cannot be fitted to this record.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> phc.pem((np.ones(4), np.ones(4)), 3, dt=0.1)
    Traceback (most recent call last):
    ...
    ph_control.exceptions.IdentificationError: ...
    """


class FileFormatError(StructureError):
    r"""A file is not what it should be: damaged, of another kind, or of a newer schema.

    Examples
    --------
    >>> import io, ph_control as phc
    >>> phc.read_csv(io.BytesIO(b"time,u,y\n0,1,2\n1,1,x\n"))
    Traceback (most recent call last):
    ...
    ph_control.exceptions.FileFormatError: ...
    """


class FileMissingError(PHControlError, FileNotFoundError):
    """A file to be read, or the folder of a file to be written, does not exist.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.load("no such file.json")
    Traceback (most recent call last):
    ...
    ph_control.exceptions.FileMissingError: ...
    """


class OutputExistsError(PHControlError, FileExistsError):
    """The file to be written exists already and overwriting was not asked for.

    Examples
    --------
    >>> import pathlib, tempfile, ph_control as phc
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "model.json"
    >>> phc.save(phc.frenkel_kontorova(), path)
    >>> phc.save(phc.frenkel_kontorova(), path)
    Traceback (most recent call last):
    ...
    ph_control.exceptions.OutputExistsError: ...
    """


class IdentifiabilityWarning(UserWarning):
    """The data do not determine some of the fitted parameters.

    Examples
    --------
    >>> import warnings, numpy as np, ph_control as phc
    >>> t = 0.1 * np.arange(400)
    >>> chain, u = phc.frenkel_kontorova(2), np.sin(t)  # the frequency of a zero of the chain
    >>> y = phc.forced_response(chain, t, u, [1.0, 0.0, 0.0, 1.0], intersample="zoh").outputs
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always")
    ...     result = phc.pem((u, y), 2, dt=0.1)
    >>> [warning.category.__name__ for warning in told]
    ['IdentifiabilityWarning']
    """


class ResolutionWarning(UserWarning):
    """A time grid does not resolve, or does not show, some of the modes.

    Examples
    --------
    >>> import warnings, ph_control as phc
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always")
    ...     response = phc.step_response(phc.ph(phc.modes([1.0, 1e7], [1.0, 1.0])))
    >>> {warning.category.__name__ for warning in told}
    {'ResolutionWarning'}
    """


class ConditioningWarning(UserWarning):
    """Rounding to doubles leaves fewer digits in a result than a user would expect.

    Examples
    --------
    >>> import warnings, numpy as np, ph_control as phc
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always")
    ...     matrix = phc.oh(np.arange(1.0, 31.0), np.ones(60)).A
    >>> {warning.category.__name__ for warning in told}
    {'ConditioningWarning'}
    """

"""Errors and warnings of the package.

Every error that bad input can cause derives from `PHControlError`; its message says what was
measured, what is allowed, and what to do.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import import_module
from typing import Any

# control characters but for tab and line feed, marks that turn the direction of reading, and halves of characters
_UNSEEN = "\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff"
_CONTROLS, _CONTROLS_AND_BREAKS = re.compile(f"[{_UNSEEN}]"), re.compile(f"[{_UNSEEN}\t\n]")


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
        """Return the message, without the middle of what is too long to be read, such as a label, and printable."""
        return printable(shortened(super().__str__()))


def shortened(text: str) -> str:
    """Text without the middle of words of hundreds of letters, nor that of thousands of words."""
    text = re.sub(r"\S{400,}", lambda match: f"{match[0][:150]}...{match[0][-150:]}", text)
    return text if len(text) < 8000 else f"{text[:5000]} ... {text[-2000:]}"


def printable(text: str, *, one_line: bool = False) -> str:
    """Text with the characters that steer a terminal, or are not seen, as escapes; in one line also its breaks."""
    return (_CONTROLS_AND_BREAKS if one_line else _CONTROLS).sub(
        lambda match: match[0].encode("unicode_escape").decode(), text
    )


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


class NoSuchQuantityError(StructureError, AttributeError):
    """A result has no such attribute, as its model has no such quantity; also an `AttributeError`, so `hasattr` works.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> y = np.exp(-0.1 * np.arange(50)) * np.cos(np.arange(50))
    >>> hasattr(phc.pem((None, y), 1, dt=1.0, structure="free"), "r")
    False
    """


class UnknownKeywordError(StructureError, TypeError):
    """A keyword is none of those that the call takes; also a `TypeError`, as for any other function.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> try:
    ...     phc.ph(np.eye(2), [0, 1], E=np.eye(2))
    ... except phc.UnknownKeywordError as error:
    ...     print(str(error).split(":")[0])
    unexpected keyword 'E'
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
    is_refusal : bool
        Whether the message is another than the default one.

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> try:
    ...     phc.ph(ct.tf([1, 0], [1, 0.1, 4]), lossless=True)
    ... except phc.NotLosslessError as error:
    ...     print(len(error.violations), error.violations[0].split(":")[0])
    1 pole -0.05+1.99937i is off the imaginary axis
    """

    def __init__(self, violations: Sequence[str], message: str | None = None) -> None:
        self.violations, self._message = tuple(violations), message
        self.is_refusal = message is not None
        if message is not None:
            super().__init__(message)
            return
        form = "a lossless system is sum_l kappa_l s/(s^2 + d_l^2) + kappa_0/s with every kappa positive"
        super().__init__(_itemized("the system is not lossless:", self.violations, form))

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.violations, self._message)


def _itemized(head: str, violations: Sequence[str], remedy: str) -> str:
    """Message with an item for each of the first violations."""
    items = [f"- {line}" for line in violations[:8]]
    if len(violations) > 8:
        items.append(f"- and {len(violations) - 8} more; see the attribute violations")
    return "\n  ".join([head, *items, remedy])


class NotPassiveError(NotLosslessError):
    """A linear system is not passive, so that no port-Hamiltonian system has its transfer function.

    Parameters
    ----------
    bands : sequence of (float, float)
        Frequencies between which it gives energy, `(low, high)` in rad per unit time; both the same at a pole on the
        imaginary axis.
    sizes, frequencies : sequence of float
        Largest violation in each band, minus the smallest eigenvalue of `(G + G^H) / 2`, and where it is.
    unstable : sequence of complex
        Poles in the right half plane.
    signs : sequence of int
        Signs of the outputs, 1 or -1, with which it is passive; empty if there are none of few changes.
    reasons : sequence of str
        More about single poles.

    Attributes
    ----------
    bands, sizes, frequencies, unstable, signs : tuple
        As above.
    violations : tuple of str
        One sentence for each of them.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> try:
    ...     phc.ph(ct.tf([-1, 0], [1, 0.1, 4]))
    ... except phc.NotPassiveError as error:
    ...     print(np.round(error.bands, 6), error.signs)
    [[ 0. inf]] (-1,)
    """

    def __init__(
        self, bands: Sequence[tuple[float, float]], sizes: Sequence[float], frequencies: Sequence[float],
        unstable: Sequence[complex] = (), signs: Sequence[int] = (), reasons: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.bands, self.unstable, self.signs = [(low, high) for low, high in bands], tuple(unstable), tuple(signs)
        self.sizes, self.frequencies = tuple(sizes), tuple(frequencies)
        self._reasons, self.is_refusal = tuple(reasons), True
        lines = [f"pole {p.real:.6g}{p.imag:+.6g}i lies in the right half plane" for p in self.unstable]
        lines += [_of_band(*of) for of in zip(self.bands, self.sizes, self.frequencies, strict=True)]
        self.violations = (*lines, *self._reasons)
        head = "the system is not passive, so it has no port-Hamiltonian form:"
        StructureError.__init__(self, _itemized(head, self.violations, self._remedy()))

    def _remedy(self) -> str:
        turned = [k for k, sign in enumerate(self.signs) if sign < 0]
        if turned and len(turned) == len(self.signs):
            return "with the other sign of the outputs it is passive: turn the sensors or the actuators round, ph(-sys)"
        if turned:
            return f"with the other sign of output {turned[0]}, counted from 0, it is passive: turn that sensor round"
        return (
            "each output must be the velocity at the force of its input (s times a displacement, 1/s times an "
            "acceleration), or the current at its voltage, with the same sign; ports=[(output, input), ..] "
            "chooses the outputs that are, and the others become sensors"
        )

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (
            self.bands, self.sizes, self.frequencies, self.unstable, self.signs, self._reasons
        )  # fmt: skip


def _of_band(band: tuple[float, float], size: float, frequency: float) -> str:
    low, high = band
    if low == high:
        return f"pole {low:.6g}i on the imaginary axis is repeated, or its residue is not positive semidefinite"
    where = f"from {low:.6g} to {high:.6g} rad per unit time"
    return f"{where} it gives energy, at {frequency:.6g} most: (G + G^H)/2 has the eigenvalue {-size:.4g}, allowed 0"


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


class MissingPackageError(PHControlError, ImportError):
    """A package that reads a format is not installed; the message names the extra that brings it.

    Examples
    --------
    >>> import ph_control as phc
    >>> issubclass(phc.MissingPackageError, ImportError)
    True
    """


def installed(module: str, needs: str, remedy: str = "pip install 'ph_control[formats]'") -> Any:
    """Module of a package that need not be there; `needs` says of a missing one what needs it."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingPackageError(f"{needs}, which is not installed: {remedy}") from None


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

"""Measured networks in Touchstone files: impedance, admittance or scattering matrices."""

from __future__ import annotations

import io
import os
import re
import warnings
from typing import Any, BinaryIO, TextIO

import numpy as np
from control import FrequencyResponseData

from .. import _checks
from .._options import NETWORK_PARAMETERS, NetworkParameter
from ..exceptions import FileFormatError, StructureError, installed
from .files import read_bytes, source_name
from .frequency_csv import response_matrix
from .tables.text_table import text_lines

# signals that drive the ports, and what answers
_SIGNALS = {"Z": ("i", "v"), "Y": ("v", "i"), "S": ("a", "b")}
# words of the line that begins with #, in the order in which scikit-rf takes them; the first of each is the default
_OPTIONS = ("ghz", "hz", "khz", "mhz"), ("s", "y", "z", "g", "h"), ("ma", "db", "ri")
_SINGULAR = 1e-12  # of I - S or I + S: no digits of the immittance would be left


def read_touchstone(
    path: str | os.PathLike[str] | BinaryIO | TextIO, *, parameter: NetworkParameter = "Z"
) -> FrequencyResponseData:
    r"""Read a measured network from a Touchstone file (.s1p, .s2p, ..., .ts) as impedances, admittances or waves.

    Parameters
    ----------
    path : str, path-like, or file object open for reading
        The file.  Version 1 tells the number of ports in the suffix only, so a file object needs its `name`.
    parameter : {'Z', 'Y', 'S'}, optional
        What is wanted, whatever the file holds: `'Z'`, impedances, from the currents into the ports to their voltages;
        `'Y'`, admittances, from voltages to currents; `'S'`, scattering parameters, for the reference impedances of the
        file.  Passive networks have positive real `'Z'` and `'Y'`, which `pem` and `ph` take for those of a
        port-Hamiltonian system; `passivity(..., kind="scattering")` is for `'S'`.

    Returns
    -------
    control.FrequencyResponseData
        Shape (m, m, K), in ohm or siemens, at ascending frequencies in rad/s, with `time_unit` 's'; the inputs of `'Z'`
        are called `i1`, `i2`, ..., its outputs `v1`, `v2`, ....

    Raises
    ------
    FileFormatError
        If the file is damaged or of another kind.
    StructureError
        If `parameter` is another word, or the network has no such matrix: an open circuit has no impedance, and a
        through connection has neither.
    MissingPackageError
        If scikit-rf is not installed; `pip install "ph_control[formats]"` brings it.
    FileMissingError
        If there is no such file.

    See Also
    --------
    read_frequency_csv : frequency responses from text tables.

    Notes
    -----
    From scattering parameters `Z = (I - S)^{-1} (I + S) R` for equal real references `R`.  What is far from the
    reference loses digits: the error of `S` is multiplied by the condition of `I - S`, or of `I + S` for `'Y'`.
    Noise parameters are passed over.  O(K m^3).

    Examples
    --------
    >>> import io, ph_control as phc
    >>> file = io.StringIO("# MHz S RI R 50\n1.0 0.0 0.0\n2.0 0.5 0.0\n")
    >>> file.name = "load.s1p"
    >>> data = phc.read_touchstone(file)
    >>> data.frdata[0, 0].real.round(6), data.omega.round(-3)
    (array([ 50., 150.]), array([ 6283000., 12566000.]))
    """
    _checks.choice("parameter", parameter, NETWORK_PARAMETERS)
    name = source_name(path)
    text = "\n".join(text_lines(read_bytes(path), name))
    network = _network(text, name)
    _refuse_cut(text, len(network.f), name)
    matrix = np.asarray(network.s)
    if parameter != "S":
        _refuse_singular(matrix, network.f, parameter, name)
        matrix = np.asarray(network.z if parameter == "Z" else network.y)
    ports = range(1, matrix.shape[1] + 1)
    inputs, outputs = ([f"{signal}{k}" for k in ports] for signal in _SIGNALS[parameter])
    omega = 2 * np.pi * np.asarray(network.f, float)
    return response_matrix(omega, matrix.transpose(1, 2, 0), inputs, outputs, name)


def is_touchstone(name: str) -> bool:
    """Whether a file is one by its suffix."""
    suffix = os.path.splitext(name)[1].casefold()
    return re.fullmatch(r"\.(ts|[sghyz][0-9]+p)", suffix) is not None


def _complete_options(line: re.Match[str]) -> str:
    """Option line with each of its words in its place: in files they stand in any order, and may be left out."""
    words, chosen = line[1].lower().split(), []
    for kind in _OPTIONS:
        chosen.append(next((word for word in words if word in kind), kind[0]))
        if chosen[-1] in words:
            words.remove(chosen[-1])
    # the reference is left; other words are left to be refused
    return " ".join(["#", *chosen, *words]) if words[:1] in ([], ["r"]) else line[0]


def _network(text: str, name: str) -> Any:
    """Network of scikit-rf."""
    skrf = installed("skrf", "Touchstone files are read by scikit-rf")
    stream: Any = io.StringIO(re.sub(r"^[ \t]*#([^!\n]*)", _complete_options, text, count=1, flags=re.MULTILINE))
    stream.name = os.path.basename(name)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            network = skrf.Network(stream)
            S, frequencies, impedances = np.asarray(network.s), np.asarray(network.f), np.asarray(network.z0)
        except Exception as error:
            # a damaged file ends in errors of every kind
            reason = str(error).split(".")[0][:100] or type(error).__name__
            raise FileFormatError(
                f"{name} is not a Touchstone file, or damaged ({reason}); the suffix gives the number of ports (.s2p); "
                "export it again in version 1 or 2"
            ) from None
    if not len(frequencies):
        raise FileFormatError(f"{name} holds no frequencies; export the measurement again")
    if not all(np.isfinite(part).all() for part in (S, frequencies, impedances)):
        raise FileFormatError(
            f"{name} holds numbers that are not finite, or beyond the range of doubles; export it again"
        )
    if (impedances.real <= 0).any():
        raise FileFormatError(
            f"{name} has a reference impedance of {impedances.real.min():.6g} ohm (R in the line that begins with #); "
            "it must be positive"
        )
    return network


def _refuse_cut(text: str, count: int, name: str) -> None:
    """Refuse a file of version 2 with fewer frequencies than it announces."""
    stated = re.search(r"^\s*\[number of frequencies\]\s*(\d+)", text, re.IGNORECASE | re.MULTILINE)
    if stated and int(stated[1]) != count:
        raise FileFormatError(f"{name} has {count} frequencies, and says {stated[1]}; copy or export it again")


def _refuse_singular(S: Any, f: Any, parameter: str, name: str) -> None:
    sign = -1.0 if parameter == "Z" else 1.0
    least = np.linalg.svd(np.eye(S.shape[1]) + sign * S, compute_uv=False)[:, -1]
    if (least <= _SINGULAR).any():
        where, other = f[int(np.argmin(least))], "Y" if parameter == "Z" else "Z"
        raise StructureError(
            f"{name}: at {where:.6g} Hz the network has no matrix {parameter}: I {'+' if sign > 0 else '-'} S has the "
            f"singular value {least.min():.1e}; read parameter='{other}', or 'S'"
        )

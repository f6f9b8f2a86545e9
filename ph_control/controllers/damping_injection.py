"""Feedback at ports that only takes energy out, so that the closed loop is port-Hamiltonian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control as ct
import numpy as np
import scipy.signal

from .. import _checks
from .._types import Array, ArrayLike, SystemNames, Unpack
from ..exceptions import StructureError
from ..systems.interconnection import through_ports
from ..systems.port_hamiltonian import PortHamiltonian

_ROUNDING = 64  # times `m EPS`: negative eigenvalues of a gain that are taken for rounding


def damping_injection(
    sys: PortHamiltonian, gain: ArrayLike | PortHamiltonian, *, ports: Sequence[int | str] | None = None,
    **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    """Close a loop around ports by a gain or a system that only takes energy, `u = -K y + w`.

    Parameters
    ----------
    sys : PortHamiltonian
        The plant; its sensors stay.
    gain : float, array_like of shape (k,) or (k, k), or PortHamiltonian
        `K` at k ports: one number for all, one for each, or a matrix with `K + K^T >= 0`; or a controller with k ports,
        such as an absorber, a shunt circuit or what `lqg` gives, which gets `y` as its input.
    ports : sequence of int or str, optional
        Ports of the plant, by number or by the name of their input.  Default: all.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`.

    Returns
    -------
    PortHamiltonian
        From `w` to `y`, with all ports of the plant.  Its energy is that of the plant, and of the controller.

    Raises
    ------
    StructureError
        If the gain makes energy or is another system (give `ph(system)`), its size is not that of the ports, a port
        with a gain is named twice, or there is no such port.

    Notes
    -----
    `R` grows by `B (K + K^T) B^T / 2` and `J` by the skew part.  As energy never rises without input, no choice of such
    a gain can destabilise the loop, nor any passive plant that is not the one the controller was designed for.

    Examples
    --------
    >>> import ph_control as phc
    >>> chain = phc.spring_chain([1.0, 1.0], [2.0], ground=1.0)
    >>> closed = phc.damping_injection(chain, 0.3, ports=[0])
    >>> closed.damping_ratios.round(4)
    array([0.0752, 0.0334])
    """
    plant(sys)
    controller, port_indices = feedback(sys, gain, ports)
    return through_ports(sys, controller, port_indices, **names)


def plant(sys: object) -> None:
    """Refuse what is no port-Hamiltonian system."""
    if not isinstance(sys, PortHamiltonian):
        raise StructureError(f"the plant is a {_checks.type_of(sys)}; pass a PortHamiltonian system, made by ph")


def port_numbers(sys: PortHamiltonian, ports: Any, *, repeated: bool = False) -> list[int]:
    """Numbers of ports, given by numbers or the names of their inputs; all by default.

    `repeated` allows several devices at one port.
    """
    if ports is None:
        ports = range(sys.ninputs)
    # an array without axes has the method, but cannot be iterated
    if isinstance(ports, str) or not hasattr(type(ports), "__iter__") or getattr(ports, "shape", None) == ():
        ports = [ports]
    numbers = [_checks.signal_number("input", port, sys.input_labels) for port in ports]
    if not numbers:
        raise StructureError("no port is named, or the plant has none; name at least one")
    twice = [k for k, port in enumerate(numbers) if port in numbers[:k]]
    if twice and not repeated:
        raise StructureError(
            f"ports={_checks.shown(ports)} names port {sys.input_labels[numbers[twice[0]]]!r} twice, where its gain "
            "would count as often; name each port once"
        )
    return numbers


def feedback(
    sys: PortHamiltonian, gain: ArrayLike | PortHamiltonian, ports: object
) -> tuple[PortHamiltonian | Array, list[int]]:
    """A gain or controller that takes energy, and the numbers of its ports."""
    port_indices = port_numbers(sys, ports, repeated=isinstance(gain, PortHamiltonian))
    return controller_of(gain, len(port_indices)), port_indices


def controller_of(gain: ArrayLike | PortHamiltonian, k: int) -> PortHamiltonian | Array:
    """A system with k ports, or a matrix of a gain at k ports that takes energy."""
    if isinstance(gain, PortHamiltonian):
        if gain.ninputs != k:
            raise StructureError(f"the controller has {gain.ninputs} ports and the plant is fed back at {k}; name them")
        return gain
    if isinstance(gain, ct.InputOutputSystem | scipy.signal.lti):
        kind = type(gain).__name__
        raise StructureError(
            f"the controller is a {kind}; pass ph(controller), its port-Hamiltonian form, which refuses one that "
            "is not passive"
        )
    K = _checks.real_array("the gain", gain)
    if K.shape == () or K.shape == (k,):
        K = np.diag(np.broadcast_to(K, k))
    if K.shape != (k, k):
        raise StructureError(f"the gain has shape {K.shape}; it must be a number, or of shape ({k},) or ({k}, {k})")
    _checks.in_range("the gain", K)
    least = float(np.linalg.eigvalsh(0.5 * (K + K.T)).min(initial=0.0))
    if least < -_ROUNDING * k * _checks.EPS * float(np.abs(K).max()):
        raise StructureError(
            f"the gain gives energy: (K + K^T) / 2 has the eigenvalue {least:.3g}; allowed are none below 0"
        )
    return K

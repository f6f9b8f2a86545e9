"""Circuits of controlled sources for any passive model: a capacitor for each state, and sources for its matrices."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from .. import _checks
from .._types import Array
from ..exceptions import StructureError
from ..modal.general_form import matrices_of
from ..systems.base import Convertible
from ..systems.port_hamiltonian import PortHamiltonian, modes, ph
from .elements import Element, Netlist

TITLE = "State space"


def controlled_sources(sys: Convertible, kind: str) -> Netlist:
    """Netlist of a passive model whose first outputs are its ports, further ones voltages of nodes of their own."""
    A, B, C, D = _matrices(sys)
    m = B.shape[1]
    if len(C) < m:
        raise StructureError(
            f"the model has {m} inputs and {len(C)} outputs; a circuit has an output, current or voltage, at each port"
        )
    # capacitors such that the largest conductance between states is 1
    rate = float(np.abs(A).max(initial=0.0)) or 1.0
    _checks.in_range("the largest entry of the modal matrix", np.array([rate]))
    B, C = _of_one_size(A, B / rate, C)
    draft = _Sources(m, len(C), kind == "impedance")
    draft.states(A / rate, B, 1.0 / rate)
    draft.outputs(C, D)
    letter = "I" if kind == "impedance" else "V"
    ports = tuple(
        Element(f"{letter}{k}", ("0", str(k)) if letter == "I" else (str(k), "0"), 0.0) for k in range(1, m + 1)
    )
    return Netlist(tuple(draft.elements), ports, "state-space", kind, f"{TITLE} of an {kind}")


def _matrices(sys: Convertible) -> tuple[Array, Array, Array, Array]:
    """Real state space of a passive model in modal coordinates, of few entries."""
    inputs = getattr(sys, "ninputs", None)
    if not isinstance(sys, PortHamiltonian):
        several = isinstance(inputs, int) and getattr(sys, "noutputs", inputs) > inputs
        sys = ph(sys, ports=[(k, k) for k in range(inputs)]) if several and inputs else ph(sys)
    form = modes(sys)
    return *matrices_of(form), np.asarray(form.feedthrough, float)


def _of_one_size(A: Array, B: Array, C: Array) -> tuple[Array, Array]:
    """B and C of states scaled such that rows of one and columns of the other are of one size.

    States that A links have one scale, so that A stays as it is.
    """
    B, C = B.copy(), C.copy()
    count, block = connected_components(A != 0, directed=False) if len(A) else (0, np.zeros(0, int))
    b, c = np.abs(B).max(axis=1, initial=0.0), np.abs(C).max(axis=0, initial=0.0)
    for k in range(count):
        together = block == k
        size = float(c[together].max() / (b[together].max() or 1.0))
        scale = np.sqrt(size) if size > 0 else 1.0
        B[together], C[:, together] = B[together] * scale, C[:, together] / scale
    return B, C


class _Sources:
    """Elements: ports are the nodes 1 to m, and states have a node each."""

    def __init__(self, ports: int, outputs: int, impedance: bool) -> None:
        self.elements: list[Element] = []
        self._impedance, self._ports, self._outputs, self._count = impedance, ports, outputs, 0
        self._inputs = [f"u{k}" if impedance else str(k) for k in range(1, ports + 1)]
        self._states: list[str] = []
        if not impedance:
            return
        for k, node in enumerate(self._inputs, start=1):  # the current at a port as the voltage of a node
            self._add(f"VS{k}", (str(k), f"e{k}"), 0.0)
            self._add(f"E{k}", (f"e{k}", "0", f"y{k}", "0"), 1.0)
            self._add(f"F{k}", ("0", node, f"VS{k}"), 1.0)
            self._add(f"RU{k}", (node, "0"), 1.0)

    def _add(self, name: str, nodes: tuple[str, ...], value: float) -> None:
        self.elements.append(Element(name, nodes, float(value)))

    def _drive(self, begin: str, end: str, by: list[str], values: Array) -> None:
        """Currents from one node to another, in proportion to voltages."""
        for node, value in zip(by, values.tolist(), strict=True):
            if value:
                self._count += 1
                self._add(f"G{self._count}", (begin, end, node, "0"), value)

    def states(self, A: Array, B: Array, capacitance: float) -> None:
        """Capacitors, with the currents that charge them."""
        self._states = [f"x{k}" for k in range(1, len(A) + 1)]
        for k, node in enumerate(self._states):
            self._add(f"C{k + 1}", (node, "0"), capacitance)
            self._drive("0", node, self._states, A[k])
            self._drive("0", node, self._inputs, B[k])

    def outputs(self, C: Array, D: Array) -> None:
        """Currents into the ports of an admittance; voltages of nodes y for those of an impedance, and for sensors."""
        for k in range(self._outputs):
            begin, end = (str(k + 1), "0") if k < self._ports and not self._impedance else ("0", f"y{k + 1}")
            self._drive(begin, end, self._states, C[k])
            self._drive(begin, end, self._inputs, D[k])
            if begin == "0":
                self._add(f"RY{k + 1}", (end, "0"), 1.0)

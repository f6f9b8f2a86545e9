"""Circuits of given systems: Foster's and Cauer's forms, branches with resistors, ideal transformers.

Of any passive model a circuit of controlled sources: a capacitor for each state, and sources for its matrices.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from .. import _checks
from .._options import CIRCUIT_FORMS, IMMITTANCES, CircuitForm, Immittance
from .._types import Array
from .._units import SECONDS, common_unit
from ..exceptions import StructureError
from ..modal.general_form import matrices_of
from ..systems.base import Convertible
from ..systems.port_hamiltonian import PortHamiltonian, modes, ph
from .elements import Element, Netlist
from .expansions import continued_fraction, continued_fraction_at_zero, reciprocal
from .fitted import fitted_elements, is_fit, is_fitted_one_port
from .resonators import Resonator, Resonators, resonators_of

# the partial fractions of the transfer function itself
_DIRECT: dict[Immittance, CircuitForm] = {
    "admittance": "foster2",
    "impedance": "foster1",
}
_TITLES = {"foster1": "Foster I", "foster2": "Foster II", "cauer1": "Cauer I", "cauer2": "Cauer II"}

TITLE = "State space"


def netlist(sys: Any, form: CircuitForm | None = None, *, kind: Immittance = "admittance") -> Netlist:
    """Circuit with the transfer function of a system: positive elements, or controlled sources.

    Parameters
    ----------
    sys : PortHamiltonian, ModalForm, any linear system of continuous time, or PEMResult
        Lossless, or with classical damping; with the form 'state-space' any passive one.  Elements of a fit of one port
        have standard errors.
    form : {'foster1', 'foster2', 'cauer1', 'cauer2', 'state-space'}, optional
        'foster1': tanks (inductor and capacitor side by side) in series, from the partial fractions of the impedance.
        'foster2': branches (inductor and capacitor in series) side by side, from those of the admittance.
        'cauer1': ladder of inductors along and capacitors across, from the continued fraction at infinity.
        'cauer2': ladder of capacitors along and inductors across, from that at zero.
        'state-space': a capacitor for each state, and current sources that voltages control; for any passive system,
        with further outputs (sensors) as voltages of nodes `y`.
        Default: the partial fractions of the system itself, 'foster2' of an admittance, 'foster1' of an impedance.
    kind : {'admittance', 'impedance'}
        Whether the input of the system is the voltage and its output the current into the port, as for `lc_circuit`, or
        the other way round, as for `rcl_ladder`.

    Returns
    -------
    Netlist
        With as few inductors and capacitors as the system has states; modes that no port reaches are left out, but
        in the form 'state-space'.  Of a fit, in the default form, with `stderr` of each element.

    Raises
    ------
    StructureError
        If there is no circuit of this form: several ports or losses in another form than the default one, a system that
        no port reaches, residues that ask for gyrators, elements of a fit that would be negative.
    NotPassiveError, NotLosslessError
        If the system is not passive, or its damping is not classical.

    Notes
    -----
    SPICE counts in seconds: of a fit or system of a known unit of time elements are in henry and farad, and else in the
    unit that frequencies have.

    Of an admittance a mode `kappa s / (s^2 + 2 zeta d s + d^2)` is the branch `L = 1/kappa`, `R = 2 zeta d/kappa`,
    `C = kappa/d^2`, and a pole at 0 the inductor `1/kappa_0`; of an impedance the dual tank.  The form 'foster1' of an
    admittance, and 'foster2' of an impedance, are made of the zeros in the same way.

    With several ports, a mode whose residue is `kappa psi psi^T` lies behind ideal transformers with the ratios `psi`,
    unless it lies at one port alone; each transformer is a pair of controlled sources, and a voltage source of 0 that
    measures its current.

    The ladder 'cauer1' of an impedance is the twin of a chain of masses (capacitors) and springs (inductors, 1/k) with
    the first mass at the port, as `spring_chain` makes it.  Elements of ladders come from the Jacobi matrix of the
    modes, by Lanczos vectors in decimal arithmetic; these, and those made of zeros, are right to the last place for
    the `d` and `r` of `ph(sys).modes`.  O(n^2) operations, O(n^3) for the forms made of zeros.

    Of a fit of one port in the default form errors follow from its covariance, to first order.  A real pole of an
    impedance is C and R, or L and R, side by side; a mode is C, R and L, where need be with a resistor in series with
    L.  A resistor that is 0 within three standard errors is left out, and all other values and errors are those given
    that it is.  What the fit has in its `background` in proportion to `s` and `1/s` is an element as well.

    The form 'state-space' is `x' = A x + B u`, `y = C x + D u` in modal coordinates: the states are the voltages of the
    nodes `x1`, `x2` .., on capacitors of one size, which currents `G` charge.  Of an admittance the currents `y` are
    drawn from the ports; of an impedance the current at a port is the voltage of the node `u`, and its voltage that of
    the node `y`.  It needs no passive elements, and `read_netlist`, which reads these, does not read it.

    Examples
    --------
    >>> import ph_control as phc
    >>> sys = phc.lc_circuit(C=[1.0, 0.5], L=[1.0, 0.25])
    >>> [(element.name, round(element.value, 6)) for element in phc.netlist(sys).elements]
    [('L1', 1.0), ('C1', 1.0), ('L2', 0.25), ('C2', 0.5)]
    >>> ladder = phc.netlist(sys, "cauer1")
    >>> [(element.name, round(element.value, 6), element.nodes) for element in ladder.elements]
    [('L1', 0.2, ('1', '2')), ('C1', 0.757576, ('2', '0')), ('L2', 1.111224, ('2', '3')), ('C2', 0.742424, ('3', '0'))]

    A fit of 50 ohm in series with 1 kohm beside 1 uF:

    >>> import control as ct, numpy as np
    >>> s, rng = 2j * np.pi * np.geomspace(10, 1e4, 60), np.random.default_rng(0)
    >>> Z = 50 + 1000 / (1 + 1e-3 * s) + rng.standard_normal(60) + 1j * rng.standard_normal(60)
    >>> fit = phc.pem(ct.frd(Z, s.imag))
    >>> for element in phc.netlist(fit, kind="impedance").elements:
    ...     print(f"{element.name} = {element.value:.4g} +- {element.stderr:.1g}")
    R1 = 50.26 +- 0.2
    C1 = 1.001e-06 +- 6e-10
    R2 = 999.6 +- 0.3
    """
    circuit, second = _circuit(sys, form, kind), SECONDS[common_unit(sys) or "s"]
    elements = (
        replace(element, value=second * element.value, stderr=element.stderr and second * element.stderr)
        if element.letter in "LC" else element for element in circuit.elements
    )  # fmt: skip
    return replace(circuit, elements=tuple(elements))


def _circuit(sys: Any, form: CircuitForm | None, kind: Immittance) -> Netlist:
    """Circuit in the unit of time of the system."""
    kind = _checks.choice("kind", kind, IMMITTANCES)
    form = _DIRECT[kind] if form is None else _checks.choice("form", form, CIRCUIT_FORMS)
    if form == _DIRECT[kind] and is_fitted_one_port(sys):
        return Netlist(fitted_elements(sys, kind), _ports(kind, 1), form, kind, f"{_TITLES[form]} form of an {kind}")
    if is_fit(sys):
        sys = sys.system
    if form == "state-space":
        return _controlled_sources(sys, kind)
    parts, one_port = resonators_of(sys)
    if not parts.modes and not parts.poles_at_zero and not parts.relaxations and not parts.feedthrough.any():
        raise StructureError("no port reaches any mode: the transfer function is 0, and has no circuit")
    title = f"{_TITLES[form]} form of an {kind}"
    draft = _Draft(kind, parts.ports)
    if form == _DIRECT[kind]:
        draft.side_by_side(parts)
    elif one_port is None:
        what = f"{parts.ports} ports" if parts.ports > 1 else "losses"
        raise StructureError(
            f"the system has {what}, and form={form!r} is that of a lossless one-port; take form={_DIRECT[kind]!r}, "
            f"which is made of the modes of an {kind}"
        )
    elif form.startswith("foster"):
        draft.reciprocal(*reciprocal(*one_port))
    else:
        draft.ladder(form, *one_port)
    return draft.netlist(form, title)


def _ports(kind: Immittance, count: int) -> tuple[Element, ...]:
    """Sources at the ports: of voltage for an admittance, of current for an impedance."""
    if kind == "impedance":
        return tuple(Element(f"I{k}", ("0", str(k)), 0.0) for k in range(1, count + 1))
    return tuple(Element(f"V{k}", (str(k), "0"), 0.0) for k in range(1, count + 1))


class _Draft:
    """Elements as they are added; of an impedance the dual of what an admittance has."""

    def __init__(self, kind: Immittance, ports: int) -> None:
        self._dual, self._kind = kind == "impedance", kind
        self._elements: list[Element] = []
        self._counts: dict[str, int] = {}
        self._nodes = ports
        # where the next part in series begins, for each port of an impedance
        self._ends = [str(k + 1) for k in range(ports)]

    def netlist(self, form: str, title: str) -> Netlist:
        return Netlist(tuple(self._elements), _ports(self._kind, len(self._ends)), form, self._kind, title)

    def _node(self) -> str:
        self._nodes += 1
        return str(self._nodes)

    def _add(self, letter: str, nodes: tuple[str, ...], value: float) -> str:
        """Add an element, of the next number of its letter."""
        if not np.isfinite(value) or (letter in "RLC" and value < _checks.SMALLEST):
            raise StructureError(
                f"an element would have the value {value:.3g}, outside the range of doubles; scale time or the output"
            )
        self._counts[letter] = self._counts.get(letter, 0) + 1
        name = f"{letter}{self._counts[letter]}"
        self._elements.append(Element(name, nodes, float(value)))
        return name

    # --- partial fractions ---------------------------------------------------------------------------------------

    def side_by_side(self, parts: Resonators) -> None:
        """Branches across the ports of an admittance; tanks in series at those of an impedance."""
        every = [*parts.poles_at_zero, *parts.relaxations, *parts.modes]
        plain = [resonator for resonator in every if np.count_nonzero(resonator.psi) == 1]
        turned = [resonator for resonator in every if np.count_nonzero(resonator.psi) > 1]
        # of each port the number of parts in series, of which the last one ends at ground
        remaining = [0] * parts.ports
        conductances = [(k, float(g)) for k, g in enumerate(parts.feedthrough) if g > 0]
        for k in [*(k for k, _ in conductances), *(int(np.flatnonzero(resonator.psi)[0]) for resonator in plain)]:
            remaining[k] += 1
        for resonator in turned:
            for port in np.flatnonzero(resonator.psi):
                remaining[port] += 1
        for k, g in conductances:
            begin, end = self._place(k, remaining)
            self._add("R", (begin, end), g if self._dual else 1 / g)
        for resonator in plain:
            self._resonator(resonator, *self._place(int(np.flatnonzero(resonator.psi)[0]), remaining))
        for resonator in turned:
            self._behind_transformers(resonator, remaining)
        for k, (end, node) in enumerate(zip(self._ends, map(str, range(1, parts.ports + 1)), strict=True)):
            if self._dual and end == node:  # nothing at this port: no voltage whatever the current
                raise StructureError(f"no mode reaches port {k}, counted from 0; leave that port out")

    def _place(self, port: int, remaining: list[int]) -> tuple[str, str]:
        """Nodes of the next part at a port."""
        if not self._dual:
            return str(port + 1), "0"
        begin, remaining[port] = self._ends[port], remaining[port] - 1
        self._ends[port] = self._node() if remaining[port] else "0"
        return begin, self._ends[port]

    def _resonator(self, mode: Resonator, begin: str, end: str) -> None:
        """A branch, or the tank that is its dual, between two nodes."""
        values = {"C" if self._dual else "L": 1 / mode.kappa}
        if mode.loss:
            values["R"] = mode.kappa / mode.loss if self._dual else mode.loss / mode.kappa
        if mode.flexibility:
            values["L" if self._dual else "C"] = mode.flexibility
        self._branch(values, begin, end, in_series=not self._dual)

    def _branch(self, values: dict[str, float], begin: str, end: str, in_series: bool) -> None:
        for count, (letter, value) in enumerate(values.items(), start=1):
            far = end if not in_series or count == len(values) else self._node()
            self._add(letter, (begin, far), value)
            begin = far if in_series else begin

    def _behind_transformers(self, mode: Resonator, remaining: list[int]) -> None:
        """A resonator to ground behind ideal transformers, one for each port that it reaches.

        Admittance: the branch has the voltage `sum psi_k v_k`, each port the current `psi_k i`.  Impedance: the
        tank has the current `sum psi_k i_k`, and each port the voltage `psi_k v`.
        """
        reached = [(int(k), float(mode.psi[k])) for k in np.flatnonzero(mode.psi)]
        inner = self._node()
        if self._dual:
            for k, ratio in reached:
                begin, end = self._place(k, remaining)
                middle = self._node()
                sense = self._add("VS", (begin, middle), 0.0)
                self._add("E", (middle, end, inner, "0"), ratio)
                self._add("F", ("0", inner, sense), ratio)
        else:
            begin = self._node()
            sense = self._add("VS", (begin, inner), 0.0)
            for count, (k, ratio) in enumerate(reached, start=1):
                end = self._node() if count < len(reached) else "0"
                self._add("E", (begin, end, str(k + 1), "0"), ratio)
                self._add("F", (str(k + 1), "0", sense), ratio)
                begin = end
        self._resonator(mode, inner, "0")

    def reciprocal(self, a: float, flexibility: float, tanks: list[tuple[float, float]]) -> None:
        """Partial fractions of 1/G: tanks in series for an admittance, branches side by side for an impedance."""
        along, across = ("C", "L") if self._dual else ("L", "C")
        pieces = [{along: a}]
        pieces += [{across: flexibility}] if np.isfinite(flexibility) else []
        pieces += [{across: heavy, along: light} for heavy, light in tanks]
        begin = "1"
        for count, values in enumerate(pieces, start=1):
            if self._dual:
                self._branch(values, "1", "0", in_series=True)
                continue
            end = self._node() if count < len(pieces) else "0"
            self._branch(values, begin, end, in_series=False)
            begin = end

    # --- continued fractions -------------------------------------------------------------------------------------

    def ladder(self, form: str, d: Array, r: Array, kappa_0: float) -> None:
        """Elements along and across by turns; an admittance begins with one along, an impedance with one across.

        Of `cauer2` a pole of G at 0 is the first element, before the ladder of what is left of G.
        """
        along, across = ("L", "C") if form == "cauer1" else ("C", "L")
        if form == "cauer1":
            values = continued_fraction(d, r, kappa_0)
        else:
            values = [1 / b for b in continued_fraction_at_zero(d, r)] if len(d) else []
            if kappa_0:
                values.insert(0, 1 / kappa_0)
        is_along = self._dual if form == "cauer2" and kappa_0 else not self._dual
        begin = "1"
        for count, value in enumerate(values, start=1):
            last = count == len(values)
            if is_along:
                end = "0" if last else self._node()
                self._add(along, (begin, end), value)
                begin = end
            else:
                self._add(across, (begin, "0"), value)
            is_along = not is_along


def _controlled_sources(sys: Convertible, kind: Immittance) -> Netlist:
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
    return Netlist(tuple(draft.elements), _ports(kind, m), "state-space", kind, f"{TITLE} of an {kind}")


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

"""Port-Hamiltonian system of a circuit: charges of capacitors and flux linkages of inductors as states.

Kirchhoff's voltage law makes every branch voltage a combination `v = F v_t` of those of a tree, and his current law
reads `F^T i = 0`.  The tree takes voltage sources first, then capacitors, resistors and inductors, and current sources
last.  A capacitor outside of the tree closes a loop of capacitors, and an inductor inside it belongs to a cut set of
inductors: each leaves one state fewer.  Ideal transformers are constraints on the voltages, met before all others, and
so are coils without leakage: the voltages of coupled coils are those of as many as their inductance matrix has rank.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import IO, Any, overload

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, cholesky, solve_triangular
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .. import _checks
from .._frozen import Frozen
from .._types import Array, ArrayLike, SystemNames, Unpack
from .._units import with_unit
from ..exceptions import FileFormatError, StructureError
from ..systems.dissipative import DissipativePortHamiltonian
from ..systems.models import named
from .elements import Element
from .hierarchy import elements_of
from .spice_text import content_of

_VALUED = "RLCK"  # elements whose values may be left open
_TREE = "VCRLI"  # which branches a tree takes first
_SINGULAR = 1e4  # condition of a capacitance or inductance matrix in units of its diagonal
_ROUNDING = 8  # times size and EPS, of what was added up: what elimination leaves of 0


@overload
def read_netlist(
    source: str | os.PathLike[str] | IO[Any], *, parameters: None = None, **names: Unpack[SystemNames]
) -> DissipativePortHamiltonian: ...
@overload
def read_netlist(
    source: str | os.PathLike[str] | IO[Any], *, parameters: Sequence[str], **names: Unpack[SystemNames]
) -> NetlistFunction: ...
def read_netlist(
    source: str | os.PathLike[str] | IO[Any], *, parameters: Sequence[str] | None = None, **names: Unpack[SystemNames]
) -> DissipativePortHamiltonian | NetlistFunction:
    """Port-Hamiltonian system of a SPICE netlist of resistors, inductors, capacitors and sources.

    Parameters
    ----------
    source : str, path-like or file object
        Name of a file, an open file, or, if it has several lines, the text itself.
    parameters : sequence of str, optional
        Elements R, L, C or K whose values are left open: then the answer is a function from these values to the system,
        for `pem(data, model=..)`.  Of `R2` in the subcircuit `X1` the name is `R.X1.R2`.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default inputs and outputs are called after the
        sources (`v_V1`, `i_V1`), and states after the elements (`q_C1`, `phi_L1`).

    Returns
    -------
    DissipativePortHamiltonian
        Each source is a port, in the order of the lines: of a voltage source the voltage is the input and the current
        that it delivers the output, of a current source (current from its first node through the source to its second)
        the current is the input and the voltage at which it delivers it the output.  States: the charges of capacitors
        (C) and the flux linkages of inductors (Wb); of a loop of capacitors those of all but one, of a cut set of
        inductors likewise, of coils without leakage (`K = 1`) that of the first.  Of coils with hardly any, the flux
        linkage beyond that which those before it induce.  Its `time_unit` is 's'.

    NetlistFunction
        With `parameters`: called with their values it returns that system; `names` and `values` are those of the text.

    Raises
    ------
    FileFormatError
        If a line is not understood, with its number; a value is negative; an element is not linear; or another file is
        named (`.include`, `.lib`): none but the given one is opened.
    FileMissingError
        If there is no such file.
    StructureError
        If there is no port or no ground, a part is not connected to ground, sources contradict each other,
        a source charges capacitors or cuts inductors without anything between (its current would contain the derivative
        of its voltage), couplings supply energy, or controlled sources are no transformer; or if `parameters` are
        not names of elements with a value, or one of them is named twice.

    Notes
    -----
    Read are R, L, C, K (coupled inductors, `|K| <= 1`), V, I, subcircuits (`.subckt`, `.ends`, X, also nested and with
    parameters), `.param`, `.global`, and pairs of E and F that make ideal transformers as `netlist` writes them.  Of an
    inductor or capacitor `Rser`, `Lser`, `Rpar`, `Cpar` and `Rlshunt` are elements of their own, as in LTspice but 0 by
    default, and of a voltage source `Rser` and `Cpar`; `m` is a number of elements side by side.  R = 0 and L = 0 are
    wires, and C = 0 is nothing.  Resistors alone are a gain, a system without states.

    Values have suffixes t, g, meg, k, mil, m, u, n, p, f with any unit behind them (f is 1e-15 and m 1e-3, in either
    case).  In braces or single quotation marks stands arithmetic of numbers and parameters: `+ - * / **` (also `^`),
    parentheses, `pi`, `abs, sqrt, exp, ln, log, log10, min, max, pow, sin, cos, tan`.  Comments are `*`, `;`, `$`,
    `//`, continuation lines begin with `+`.  Passed over are analyses, control blocks, `.model`, initial conditions,
    temperatures, and what a source is set to.  The first line is the title, unless it is that of an element.  Names of
    elements in subcircuits are those of ngspice: `L.X1.L2` is L2 in X1, and its state is `phi_L_X1_L2`.

    `H = q^T C^{-1} q / 2 + phi^T L^{-1} phi / 2`.  Branch voltages are eliminated exactly, on incidence matrices of
    0, 1 and -1.  Coils without leakage are an ideal transformer and the inductance of as many of them as the rank of
    their inductance matrix.  Dense matrices, O(n^3).

    Examples
    --------
    >>> import ph_control as phc
    >>> circuit = phc.read_netlist('''series resonator
    ... V1 in 0 AC 1
    ... R1 in a 50
    ... L1 a b 1m
    ... C1 b 0 10n
    ... .end''')
    >>> circuit.state_labels, circuit.hertz.round(1)
    (['q_C1', 'phi_L1'], array([50329.2]))
    >>> circuit.damping_ratios.round(4)
    array([0.0791])
    >>> resonator = phc.read_netlist('''V1 1 0
    ... R1 1 2 50
    ... L1 2 3 1m
    ... C1 3 0 10n''', parameters=["R1", "C1"])
    >>> resonator.values, resonator([50.0, 40e-9]).hertz.round(1)
    (array([5.e+01, 1.e-08]), array([25164.6]))
    """
    text, name = content_of(source)
    elements = elements_of(text, name)
    return _system(elements, names) if parameters is None else _opened(elements, parameters, names)


@dataclass(frozen=True, eq=False)
class NetlistFunction(Frozen):
    """A circuit as a function of the values of some elements; made by `read_netlist` with `parameters`.

    Attributes
    ----------
    names : tuple of str
        Elements whose values are open, as the netlist names them.
    values : ndarray, shape (P,)
        What these are in the netlist: ohm, henry, farad, coupling.

    See Also
    --------
    read_netlist, pem

    Examples
    --------
    >>> import ph_control as phc
    >>> low_pass = phc.read_netlist('''V1 1 0
    ... R1 1 2 1k
    ... C1 2 0 1u''', parameters=["R1", "C1"])
    >>> low_pass.names, low_pass([2000.0, 1e-6]).poles().real
    (('R1', 'C1'), array([-500.]))
    """

    names: tuple[str, ...]
    values: Array
    _elements: tuple[Element, ...] = field(repr=False)
    _places: tuple[int, ...] = field(repr=False)
    _labels: SystemNames = field(repr=False)

    def __call__(self, theta: ArrayLike) -> DissipativePortHamiltonian:
        """System of the circuit with these values, shape (P,)."""
        values = _checks.real_array("theta", theta)
        if values.shape != self.values.shape:
            raise StructureError(f"theta has shape {values.shape}; the netlist has {len(self.names)} open values")
        elements = list(self._elements)
        for k, name, value in zip(self._places, self.names, values.tolist(), strict=True):
            element = elements[k]
            if not (value > 0 or element.letter == "K") or abs(value) > (1 if element.letter == "K" else np.inf):
                raise StructureError(f"{name} is {value:.6g}; R, L and C must be positive, and couplings from -1 to 1")
            elements[k] = replace(element, value=value)
        return _system(elements, self._labels)


def _opened(elements: Sequence[Element], parameters: Sequence[str], labels: SystemNames) -> NetlistFunction:
    """A circuit with the values of some elements left open."""
    named = isinstance(parameters, list | tuple) and all(isinstance(name, str) for name in parameters)
    if not named:
        raise StructureError(f"parameters are {_checks.shown(parameters)}; they must be names of elements, ['R1', ..]")
    known = {element.name.upper(): k for k, element in enumerate(elements) if element.letter in _VALUED}
    wanted = [name.upper() for name in parameters]
    missing = [name for name, upper in zip(parameters, wanted, strict=True) if upper not in known]
    if missing or not wanted or len(set(wanted)) < len(wanted):
        what = f"there is no {missing[0]!r}" if missing else "they must be different, and one at least"
        raise StructureError(
            f"parameters are {_checks.shown(list(parameters))}: {what}; elements with a value are "
            f"{', '.join(elements[k].name for k in known.values()) or 'none'}"
        )
    places = tuple(known[name] for name in wanted)
    values = _checks.readonly(np.array([elements[k].value for k in places]))
    return NetlistFunction(tuple(elements[k].name for k in places), values, tuple(elements), places, labels)


def _system(elements: Sequence[Element], names: SystemNames) -> DissipativePortHamiltonian:
    coils = _Coils(elements)
    turns = _Transformers(elements, coils)
    left_out = turns.sensing | coils.dependent
    each = [part for letter in _TREE for part in elements if part.letter == letter and part.name not in left_out]
    ports = [part for part in elements if part.letter in "VI" and part.name not in turns.sensing]
    _refuse_unconnected(elements)
    if not ports:
        raise StructureError("the netlist has no source; put a voltage or a current source at each port")
    branches = _Branches(each, *_fundamental(each, turns))
    _refuse_contradictions(branches)
    capacitance, inductance = _storage(branches, coils.inductance)
    K = _kirchhoff(branches)
    n = len(capacitance) + len(inductance)
    sources = branches.of("V") + branches.of("I")
    pick = np.array([*range(n), *(n + sources.index(each.index(port)) for port in ports)])
    energies, turns_of_states = zip(*map(_energy, (capacitance, inductance)), strict=True)
    Q, turn = block_diag(*energies), block_diag(*turns_of_states, np.eye(len(ports)))
    K = turn @ K[np.ix_(pick, pick)] @ turn.T
    skew, symmetric = 0.5 * (K - K.T), 0.5 * (K + K.T)
    system = DissipativePortHamiltonian(
        Q, -skew[:n, n:], R=symmetric[:n, :n], P=symmetric[:n, n:], S=symmetric[n:, n:], N=skew[n:, n:],
        J=-skew[:n, :n], **named(names, *_signals(branches, ports)),
    )  # fmt: skip
    return with_unit(system, "s")


@dataclass(frozen=True)
class _Branches:
    """Branches of a circuit, their voltages by those of a tree, `F`, and the places of the tree among them."""

    each: list[Element]
    F: Array
    tree: list[int]

    def of(self, letter: str, inside: bool | None = None) -> list[int]:
        """Places of branches of a kind: of all, or of those inside or outside of the tree."""
        return [
            k for k, branch in enumerate(self.each)
            if branch.letter == letter and (inside is None or (k in self.tree) == inside)
        ]  # fmt: skip

    def block(self, places: list[int], letter: str) -> Array:
        """Voltages of some branches by those of a kind in the tree."""
        return self.F[np.ix_(places, [self.tree.index(k) for k in self.of(letter, True)])]

    def values(self, letter: str) -> Array:
        """Values of all branches of a kind."""
        return np.array([self.each[k].value for k in self.of(letter)])


def _storage(branches: _Branches, inductance: Array) -> tuple[Array, Array]:
    """Capacitance matrix by voltages of the tree, and inductance matrix by currents outside of it."""
    every_L, link_L = branches.of("L"), branches.of("L", False)
    # currents of all inductors by those outside of the tree
    W = np.zeros((len(every_L), len(link_L)))
    W[[every_L.index(k) for k in link_L], range(len(link_L))] = 1.0
    W[[every_L.index(k) for k in branches.of("L", True)]] = -branches.block(link_L, "L").T
    charge = branches.block(branches.of("C"), "C")
    return charge.T @ (branches.values("C")[:, None] * charge), W.T @ inductance @ W


def _signals(branches: _Branches, ports: list[Element]) -> tuple[list[str], list[str], list[str]]:
    """Names of inputs, outputs and states after the elements."""
    kinds = [("v", "i") if port.letter == "V" else ("i", "v") for port in ports]
    stores = [("q", k) for k in branches.of("C", True)] + [("phi", k) for k in branches.of("L", False)]
    inputs = [f"{kind[0]}_{_label(port.name)}" for kind, port in zip(kinds, ports, strict=True)]
    outputs = [f"{kind[1]}_{_label(port.name)}" for kind, port in zip(kinds, ports, strict=True)]
    return inputs, outputs, [f"{kind}_{_label(branches.each[k].name)}" for kind, k in stores]


def _label(name: str) -> str:
    """Name of an element as that of a signal, which has no dots."""
    return name.replace(".", "_")


def _energy(matrix: Array) -> tuple[Array, Array]:
    """Hamiltonian matrix `T^-T M^-1 T^-1` of a capacitance or inductance matrix M, and the coordinates T of the states.

    T is the unit matrix, unless M is nearly singular, as of coils with hardly any leakage: differences of the states
    would then lose digits, and each stands for what it exceeds that by which those before it induce.
    """
    n = len(matrix)
    if np.count_nonzero(matrix) == n:
        return np.diag(1.0 / np.diag(matrix)), np.eye(n)
    scale = np.sqrt(np.diag(matrix))
    inner = matrix / scale / scale[:, None]
    if np.linalg.cond(inner) < _SINGULAR:
        inverse = cho_solve(cho_factor(inner), np.eye(n)) / scale / scale[:, None]
        return np.asarray(0.5 * (inverse + inverse.T)), np.eye(n)
    lower = cholesky(inner, lower=True)
    root = np.diag(lower)
    turn = solve_triangular(lower / root, np.eye(n), lower=True, unit_diagonal=True)
    return np.diag(1.0 / (root * scale) ** 2), scale[:, None] * turn / scale


class _Coils:
    """Inductors with their couplings.

    A coil that others determine, because nothing leaks between them, has no flux linkage of its own: its voltage is
    `ratios` times theirs, and its current, which that constraint takes, does no work beside theirs.

    Attributes
    ----------
    inductance : ndarray
        Inductance matrix of the other coils, in their order.
    dependent : set of str
        Names of coils that others determine.
    constraints : list of (Element, list of (Element, float))
        Such a coil, and the others with the ratio of its voltage to theirs.
    """

    def __init__(self, elements: Sequence[Element]) -> None:
        coils = [element for element in elements if element.letter == "L"]
        root, coupling = np.sqrt([coil.value for coil in coils]), _couplings(coils, elements)
        tolerance = _ROUNDING * max(1, len(coils)) * _checks.EPS
        independent: list[int] = []
        self.constraints: list[tuple[Element, list[tuple[Element, float]]]] = []
        for group in _groups(coupling):
            L, kept = np.zeros((0, 0)), list[int]()
            for k in group:
                row = solve_triangular(L, coupling[kept, k], lower=True) if kept else np.zeros(0)
                rest = 1.0 - row @ row
                if rest > tolerance:
                    L = np.block([[L, np.zeros((len(L), 1))], [row[None, :], np.full((1, 1), np.sqrt(rest))]])
                    kept.append(k)
                    continue
                ratios = root[k] * solve_triangular(L, row, lower=True, trans="T") / root[kept]
                self.constraints.append((coils[k], [(coils[j], x) for j, x in zip(kept, ratios, strict=True) if x]))
            independent += kept
        kept = sorted(independent)
        self.dependent = {coil.name for coil, _ in self.constraints}
        self.inductance = np.asarray(root[kept, None] * coupling[np.ix_(kept, kept)] * root[kept])


def _couplings(coils: list[Element], elements: Sequence[Element]) -> Array:
    """Symmetric matrix of couplings, with a diagonal of 1; one with a negative eigenvalue is refused."""
    number = {coil.name.upper(): k for k, coil in enumerate(coils)}
    coupling = np.eye(len(coils))
    for element in elements:
        if element.letter != "K":
            continue
        missing = [name for name in element.nodes if name.upper() not in number]
        if missing or element.nodes[0].upper() == element.nodes[1].upper():
            raise FileFormatError(
                f"{element.name} couples {element.nodes[0]} and {element.nodes[1]}: "
                + (f"there is no inductor {missing[0]}" if missing else "name two inductors")
            )
        i, j = (number[name.upper()] for name in element.nodes)
        if coupling[i, j]:
            raise FileFormatError(f"{element.name}: {element.nodes[0]} and {element.nodes[1]} are coupled twice")
        coupling[i, j] = coupling[j, i] = element.value
    least = min((float(np.linalg.eigvalsh(coupling[np.ix_(g, g)])[0]) for g in _groups(coupling)), default=1.0)
    if least < -_ROUNDING * len(coils) * _checks.EPS:
        raise StructureError(
            "the inductances of the coupled inductors are not positive semidefinite: the least eigenvalue of their "
            f"couplings is {least:.3g}, expected >= 0; make the couplings smaller"
        )
    return coupling


def _groups(coupling: Array) -> list[list[int]]:
    """Coils that are coupled, directly or through others; each alone where it is not."""
    count, label = connected_components(coo_array(coupling), directed=False)
    return [np.flatnonzero(label == k).tolist() for k in range(count)]


# --- Kirchhoff's laws --------------------------------------------------------------------------------------------


def _incidence(elements: Sequence[Element], number: dict[str, int]) -> Array:
    """Voltages of elements by those of the nodes, one row each; ground is no column."""
    A = np.zeros((len(elements), len(number)))
    for row, element in zip(A, elements, strict=True):
        for node, sign in zip(element.nodes[:2], (1.0, -1.0), strict=True):
            if node != "0":
                row[number[node]] += sign
    return A


class _Transformers:
    """Controlled sources and coils without leakage as constraints: of the voltages, and of the currents they take."""

    def __init__(self, elements: Sequence[Element], coils: _Coils) -> None:
        names = {
            node
            for element in elements
            if element.letter != "K"
            for node in element.nodes[: 4 if element.letter == "E" else 2]
        }
        self.number = {node: k for k, node in enumerate(sorted(names - {"0"}))}
        sources = {element.name.upper(): element for element in elements if element.letter == "V"}
        voltages = [element for element in elements if element.letter == "E"]
        currents = [element for element in elements if element.letter == "F"]
        for source in currents:
            if source.nodes[2].upper() not in sources:
                raise FileFormatError(
                    f"{source.name} is controlled by {source.nodes[2]}, and there is no such voltage source"
                )
        sensing = {source.nodes[2].upper(): sources[source.nodes[2].upper()] for source in currents}
        self.sensing = {source.name for source in sensing.values()}
        output, sense = _incidence(voltages, self.number), _incidence(list(sensing.values()), self.number)
        control = _incidence([Element(source.name, source.nodes[2:], 0.0) for source in voltages], self.number)
        gain = np.array([source.value for source in voltages])
        # coils: the constraint does no work, so that the currents which it takes are those of the same rows
        wound = _incidence([coil for coil, _ in coils.constraints], self.number)
        for row, (_, others) in zip(wound, coils.constraints, strict=True):
            row -= np.array([x for _, x in others]) @ _incidence([coil for coil, _ in others], self.number)
        self.controlled = len(output) + len(sense)
        self.of_voltages = np.vstack([output - gain[:, None] * control, sense, wound])
        taken = sense.copy()
        for row, source in zip(_incidence(currents, self.number), currents, strict=True):
            taken[list(sensing).index(source.nodes[2].upper())] += source.value * row
        self.of_currents = np.vstack([output, taken, wound])


def _fundamental(branches: list[Element], turns: _Transformers) -> tuple[Array, list[int]]:
    """Branch voltages by those of a tree, and the branches of the tree in their order."""
    A = _incidence(branches, turns.number)
    if not len(turns.of_voltages):
        return _echelon(A)
    of_voltages, tree = _allowed(turns.of_voltages, A, turns.controlled)
    of_currents, _ = _allowed(turns.of_currents, A, turns.controlled)
    # voltages that are allowed do no work on currents that are: the two spaces are one
    both = np.hstack([of_voltages, of_currents])
    if of_voltages.shape != of_currents.shape or np.linalg.matrix_rank(both, rtol=1e-9) > len(tree):
        raise StructureError(
            "the controlled sources are no ideal transformers: they give or take energy; an E with the ratio n of the "
            "voltage of a port needs an F with the same ratio of its current at that port"
        )
    return of_voltages, tree


def _allowed(constraints: Array, A: Array, controlled: int) -> tuple[Array, list[int]]:
    """Branch voltages under constraints, the first of them of controlled sources, by those of a tree."""
    table, basis = _echelon(np.vstack([constraints, A]))
    if basis[:controlled] != list(range(controlled)):
        raise StructureError("the controlled sources contradict or repeat each other; leave out those that do")
    k = len(constraints)
    met = sum(row < k for row in basis)  # coils side by side may repeat a constraint
    return table[k:, met:], [row - k for row in basis[met:]]


def _echelon(rows: Array) -> tuple[Array, list[int]]:
    """Rows by a basis of them that takes each as early as it can: `(rows by basis, basis)`.

    Columns are eliminated; of incidence matrices all entries stay 0, 1 and -1.  An entry is 0 where it is rounding of
    what was added up to it.
    """
    table, size, free, basis, columns = rows.copy(), np.abs(rows), np.arange(rows.shape[1]), [], []
    tolerance = _ROUNDING * max(1, rows.shape[1]) * _checks.EPS
    for k in range(len(table)):
        if not len(free):
            break
        pivot = free[int(np.abs(table[k, free]).argmax())]
        if not table[k, pivot]:
            continue
        size[:, pivot] /= abs(table[k, pivot])
        table[:, pivot] /= table[k, pivot]
        others = table[k].copy()
        others[pivot] = 0.0
        # most entries are 0 and stay it
        met, moved = np.flatnonzero(size[:, pivot]), np.flatnonzero(others)
        entries = np.ix_(met, moved)
        changed = table[entries] - np.outer(table[met, pivot], others[moved])
        size[entries] += np.outer(size[met, pivot], np.abs(others[moved]))
        table[entries] = np.where(np.abs(changed) <= tolerance * size[entries], 0.0, changed)
        table[k, :] = 0.0
        table[k, pivot] = 1.0
        free = free[free != pivot]
        basis.append(k)
        columns.append(pivot)
    return table[:, columns], basis


def _kirchhoff(branches: _Branches) -> Array:
    """Matrix K of `(q', phi', -y) = -K (v_C, i_L, u)`, with `K + K^T >= 0`.

    States: voltages of the tree's capacitors, currents of the other inductors; u: voltages, then currents, of sources.
    """
    block, sources, link_L = branches.block, branches.of("I"), branches.of("L", False)
    C_R, V_R, R_R = (block(branches.of("R"), letter) for letter in "CVR")
    conductances = 1.0 / branches.values("R")
    # resistors have the voltages `T (v_C, i_L, V, I)` plus `R_R v_r`, and `v_r` follows from the currents at them
    nl, ni = len(link_L), len(sources)
    T = np.hstack([C_R, np.zeros((len(C_R), nl)), V_R, np.zeros((len(C_R), ni))])
    if R_R.shape[1]:
        drawn = np.hstack([
            np.zeros((R_R.shape[1], C_R.shape[1])), block(link_L, "R").T,
            np.zeros((R_R.shape[1], V_R.shape[1])), block(sources, "R").T,
        ])  # fmt: skip
        # as a least-squares problem of resistors, for which conductances may differ by many decades
        root = np.sqrt(conductances)[:, None]
        normal = (root * R_R).T @ (root * R_R)
        factor = cho_factor(normal)
        v_r = -cho_solve(factor, drawn + (conductances[:, None] * R_R).T @ T)
        T = T + R_R @ v_r
    else:
        v_r = np.zeros((0, T.shape[1]))
    current = conductances[:, None] * T
    nc, nv = C_R.shape[1], V_R.shape[1]
    K = np.zeros((nc + nl + nv + ni,) * 2)
    c, j, v, i = np.split(np.arange(len(K)), np.cumsum([nc, nl, nv]))
    # currents out of the nodes of the capacitors and of the sources of voltage
    for place, letter, of_R in ((c, "C", C_R), (v, "V", V_R)):
        K[place] += of_R.T @ current
        K[np.ix_(place, j)] += block(link_L, letter).T
        K[np.ix_(place, i)] += block(sources, letter).T
    # voltages of inductors, and of the sources of current
    for place, some in ((j, link_L), (i, sources)):
        K[np.ix_(place, c)] -= block(some, "C")
        K[np.ix_(place, v)] -= block(some, "V")
        K[place] -= block(some, "R") @ v_r
    return K


# --- circuits that have no port-Hamiltonian form -------------------------------------------------------------------


def _refuse_unconnected(elements: Sequence[Element]) -> None:
    joined = [element.nodes[:2] for element in elements if element.letter != "K"]
    names = sorted({node for pair in joined for node in pair})
    if "0" not in names:
        raise StructureError("the netlist has no ground; call one node 0")
    number = {node: k for k, node in enumerate(names)}
    ends = np.array([[number[a], number[b]] for a, b in joined]).T
    graph = coo_array((np.ones(len(joined)), (ends[0], ends[1])), shape=(len(names),) * 2)
    _, label = connected_components(graph, directed=False)
    apart = [node for node, component in zip(names, label, strict=True) if component != label[number["0"]]]
    if apart:
        raise StructureError(
            f"node {', '.join(apart[:5])} is not connected to ground, also through no other node; join that part to "
            "node 0 by an element, at one place of each side of a transformer"
        )


def _refuse_contradictions(circuit: _Branches) -> None:
    branches, F, tree = circuit.each, circuit.F, circuit.tree
    inside, letters = set(tree), [branches[t].letter for t in tree]
    for k, branch in enumerate(branches):
        if k not in inside and branch.letter in "VC":
            met = np.flatnonzero(F[k])
            loop = ", ".join([branch.name, *(branches[tree[t]].name for t in met)])
            if branch.letter == "V" and not len(met):
                raise StructureError(f"{branch.name} is short-circuited; open the circuit, or leave the source out")
            if branch.letter == "V":
                raise StructureError(f"{loop} are a loop of voltage sources, whose voltages cannot be chosen; open it")
            if any(letters[t] == "V" for t in met):
                raise StructureError(
                    f"{loop} are a loop of capacitors and a voltage source: its current contains the derivative of its "
                    "voltage, which no port-Hamiltonian system has; put a resistor in series with the source, or "
                    "drive it by a current source"
                )
        if k in inside and branch.letter in "LI":
            others = [m for m in np.flatnonzero(F[:, tree.index(k)]) if m != k]
            cut = ", ".join([branch.name, *(branches[m].name for m in others)])
            if branch.letter == "I":
                raise StructureError(
                    f"{cut} are a cut set of current sources, whose currents cannot be chosen; join the two sides"
                )
            if any(branches[m].letter == "I" for m in others):
                raise StructureError(
                    f"{cut} are a cut set of inductors and a current source: its voltage contains the derivative of "
                    "its current, which no port-Hamiltonian system has; put a resistor beside the source, or drive it "
                    "by a voltage source"
                )

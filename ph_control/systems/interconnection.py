"""Connections of port-Hamiltonian systems that conserve or dissipate power, which are port-Hamiltonian again."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, matrix_balance

from .. import _checks
from .._checks import EPS
from .._types import Array, SystemNames, Unpack
from .._units import common_unit, with_unit
from ..exceptions import StructureError
from ..symplectic.darboux_and_casimirs import split_casimirs
from ..symplectic.forms_and_williamson import direct_sum
from .base import LETTERS
from .dissipative import PARTS, is_canonical, parts_of, restored
from .port_hamiltonian import PortHamiltonian

Ports = tuple[int | str, int | str] | Sequence[tuple[int | str, int | str]]

_ROUNDING = 64  # times `size EPS`: what is taken for rounding of 0


class _Label(NamedTuple):
    """Name of a signal, None where nobody gave one, and the number of the system that it is of."""

    owner: int
    text: str | None


class _Whole(NamedTuple):
    """Systems side by side: their matrices as one system, and the labels of its signals."""

    parts: dict[str, Array]
    inputs: list[_Label]
    outputs: list[_Label]
    states: list[_Label]
    owners: list[str]
    time_unit: str | None


# --- connections through a matrix ----------------------------------------------------------------------------------


def interconnect(systems: Sequence[PortHamiltonian], F: ArrayLike, **names: Unpack[SystemNames]) -> PortHamiltonian:
    """Connect port-Hamiltonian systems through their ports, `u = F y + w`.

    Parameters
    ----------
    systems : sequence of PortHamiltonian
        Their ports one after another make `u` and `y`.  Sensors stay, after all ports.
    F : array_like, shape (m, m)
        Connection of all m ports; it must not make energy: `F + F^T <= 0`.  A skew `F` conserves power.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default signals keep their names, and where two
        systems have the same ones, these begin with the name of the system.

    Returns
    -------
    PortHamiltonian
        With the ports `w` and `y`, and the sum of the energies, `Q = diag(Q_1, Q_2, ..)`.  With losses a
        `DissipativePortHamiltonian`; without any a lossless system, in Darboux coordinates of the new structure matrix,
        and without its Casimirs (see `split_casimirs`).

    Raises
    ------
    StructureError
        If `F` makes energy, or the loop of feedthroughs is singular.

    Notes
    -----
    With `M = S + N` and `L = (I - F M)^{-1}`: `J - R` grows by `(B - P) L F (B + P)^T`, inputs become `(B - P) L`,
    outputs `(I + M L F) (B + P)^T`, and the feedthrough `M L`.

    Examples
    --------
    A mass on a spring with an absorber at its port, that is, negative feedback:

    >>> import numpy as np, control as ct, ph_control as phc
    >>> plant = phc.ph(np.diag([1.0, 1.0]), [0.0, 1.0])
    >>> absorber = phc.ph(np.diag([0.2, 5.0]), [1.0, 0.0], R=np.diag([0.3, 0.0]))
    >>> closed = phc.interconnect([plant, absorber], [[0.0, -1.0], [1.0, 0.0]])
    >>> bool(closed.poles().real.max() < 0), phc.passivity(closed).is_passive
    (True, True)
    >>> loop = ct.feedback(plant, absorber)
    >>> type(loop).__name__, bool(np.allclose(loop(1j), closed[0, 0](1j)))
    ('DissipativePortHamiltonian', True)
    """
    if isinstance(systems, PortHamiltonian) or not isinstance(systems, Sequence):
        raise StructureError(f"the systems are a {type(systems).__name__}; pass a list of PortHamiltonian systems")
    members = [_member(system) for system in systems]
    ports = sum(member.ninputs for member in members)
    matrix = _checks.real_array("F", F)
    if matrix.shape != (ports, ports):
        raise StructureError(f"F has shape {matrix.shape}; it must be {(ports, ports)}, for all ports of the systems")
    _checks.in_range("F", matrix, _checks.SMALLEST_SQUARED)
    if not members:
        raise StructureError("the list of systems is empty; give at least one")
    largest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).max(initial=0.0))
    if largest > _ROUNDING * ports * EPS * float(np.linalg.norm(matrix)):
        raise StructureError(
            f"F makes energy: F + F^T has the eigenvalue {2 * largest:.3g}, allowed are none above 0; power-conserving "
            "connections are skew"
        )
    return _looped(_side_by_side(members), matrix, np.eye(ports), names=names)


def gyrator(
    first: PortHamiltonian, second: PortHamiltonian, ratio: ArrayLike = 1.0, *, ports: Ports = (0, 0),
    **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    """Connect ports of two systems by a gyrator: each takes its input from the output of the other.

    Parameters
    ----------
    first, second : PortHamiltonian
        The systems.
    ratio : float, or array_like, shape (number of pairs,)
        Gyration `r` of `u_1 = -r y_2 + w_1`, `u_2 = r y_1 + w_2`.
    ports : tuple, or list of tuples
        Number, from 0, or name of the input of a port of the first and one of the second system; or several such pairs.
    **names
        As for `interconnect`.

    Returns
    -------
    PortHamiltonian
        With all ports of the first, then of the second system, and the sum of the energies.

    Raises
    ------
    StructureError
        If there is no such port, or a port is named twice.

    Notes
    -----
    `interconnect` with a skew `F`.  A gyrator makes an inductor of a capacitor; with ratio 1 it is the negative
    feedback of python-control.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> mass = phc.ph(np.diag([0.0, 1.0]), [0.0, 1.0])
    >>> pair = phc.gyrator(mass, mass, 3.0)
    >>> pair.d.round(12)
    array([3.])
    """
    members = [_member(first), _member(second)]
    pairs, ratios = _pairs(members, ports, ratio)
    F = np.zeros((first.ninputs + second.ninputs,) * 2)
    for (i, j), r in zip(pairs, ratios, strict=True):
        j += first.ninputs
        F[i, j], F[j, i] = -r, r
    _checks.in_range("the ratio", F, _checks.SMALLEST_SQUARED)
    return _looped(_side_by_side(members), F, np.eye(len(F)), names=names)


def feedback(first: PortHamiltonian, other: object) -> PortHamiltonian | None:
    """Negative feedback of a PH system through another, or through a matrix `K + K^T >= 0`; None where it is not PH."""
    m = first.ninputs
    second = _partner(first, other, np.eye(m))
    return None if second is None else through_ports(first, second, range(m))


def through_ports(
    first: PortHamiltonian, other: PortHamiltonian | Array, ports: Sequence[int], **names: Unpack[SystemNames]
) -> PortHamiltonian:
    """Negative feedback between chosen ports of a system and those of another, or a matrix `K + K^T >= 0`.

    The ports of `first` stay, and the sensors of both.
    """
    m, k = first.ninputs, len(ports)
    joint = np.eye(m)[:, list(ports)]
    if not isinstance(other, PortHamiltonian):
        return _looped(_side_by_side([first]), -joint @ other @ joint.T, np.eye(m), names=names)
    F = np.block([[np.zeros((m, m)), -joint], [joint.T, np.zeros((k, k))]])
    return _looped(_side_by_side([first, other]), F, np.eye(m + k)[:, :m], kept=m, names=names)


def parallel(first: PortHamiltonian, other: object) -> PortHamiltonian | None:
    """Sum of a PH system and another, or a matrix `K + K^T >= 0`; None where it is not PH."""
    m = first.ninputs
    second = _partner(first, other, np.ones((m, m)))
    if second is None:
        return None
    members: list[PortHamiltonian | Array] = [first, second]
    named = True
    if isinstance(second, PortHamiltonian):
        named = all(_labels_of(first, kind, 0) == _labels_of(second, kind, 0) for kind in ("inputs", "outputs"))
        if first._in_normal_form and second._in_normal_form and not (_has_names(first) or _has_names(second)):
            plain = PortHamiltonian._from_matrices(*direct_sum((first.Q, first.B), (second.Q, second.B)))
            plain.time_unit = common_unit(first, second)
            return plain
    whole = _side_by_side(members, canonical=True)
    if not named:
        nameless = [_Label(0, None)] * m
        whole = whole._replace(inputs=nameless, outputs=nameless)
    return _looped(whole, np.zeros((2 * m, 2 * m)), np.vstack([np.eye(m)] * 2), kept=m)


def append(first: PortHamiltonian, other: Any) -> PortHamiltonian | None:
    """Two systems side by side, the second one PH or a matrix `K + K^T >= 0`; None where that is not PH."""
    second = other
    if not isinstance(other, PortHamiltonian):
        size = len(other) if np.ndim(other) == 2 else 1
        second = _gain(other, size, np.eye(1))
        if second is None:
            return None
    # the ports of the second come before the sensors of the first, which is not the order of python-control
    if first.noutputs != first.ninputs:
        return None
    ports = first.ninputs + (second.ninputs if isinstance(second, PortHamiltonian) else len(second))
    return _looped(_side_by_side([first, second], canonical=True), np.zeros((ports, ports)), np.eye(ports))


# --- rigid connections ---------------------------------------------------------------------------------------------


def couple(
    first: PortHamiltonian, second: PortHamiltonian, *, ports: Ports = (0, 0), **names: Unpack[SystemNames]
) -> PortHamiltonian:
    """Join ports of two systems rigidly: equal outputs, opposite inputs, the force between them eliminated.

    Parameters
    ----------
    first, second : PortHamiltonian
        The systems, such as two structures with forces as inputs and velocities as outputs.
    ports : tuple, or list of tuples
        Number, from 0, or name of the input of a port of the first and one of the second system; or several such
        pairs, which are joined one after another.
    **names
        As for `interconnect`.

    Returns
    -------
    PortHamiltonian
        With all ports of the first system and those of the second that were not joined: a joint is the port of the
        first.  Sensors stay, after all ports.

    Raises
    ------
    StructureError
        If there is no such port, or a port is named twice; if joined ports move together already, or the difference of
        their outputs contains an input directly.

    Notes
    -----
    `transformer` with ratio 1.  With `E = B_1 - B_2` at the joint and `Pi = I - E (E^T Q E)^{-1} E^T Q` the structure
    matrices become `Pi J Pi^T` and `Pi R Pi^T`, in coordinates of the states with equal outputs: of two masses one
    remains, whose momentum is the sum.  What its position was in the second system is dropped where nothing drives
    their difference, which is taken to be 0.  Ports with feedthrough, such as resistors, are joined without loss of a
    state.  The energy is the sum of both.  O(n^3).

    Examples
    --------
    Two chains of one mass each, joined to one of three springs and a mass of 2 kg:

    >>> import ph_control as phc
    >>> first, second = (phc.spring_chain([1.0], ground=k) for k in (3.0, 5.0))
    >>> joined = phc.couple(first, second)
    >>> joined.d, joined.Q.diagonal()
    (array([2.]), array([8. , 0.5]))
    """
    return transformer(first, second, 1.0, ports=ports, **names)


def transformer(
    first: PortHamiltonian, second: PortHamiltonian, ratio: ArrayLike = 1.0, *, ports: Ports = (0, 0),
    **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    """Join ports of two systems by a transformer, lever or gear: `y_2 = n y_1`, the force between them eliminated.

    Parameters
    ----------
    first, second : PortHamiltonian
        The systems.
    ratio : float, or array_like, shape (number of pairs,)
        Ratio `n` of the outputs, not 0; the inputs are `u_1 = n f + w` and `u_2 = -f`.
    ports : tuple, or list of tuples
        As for `couple`.
    **names
        As for `interconnect`.

    Returns
    -------
    PortHamiltonian
        As of `couple`.

    Raises
    ------
    StructureError
        As for `couple`; if a ratio is 0.

    Notes
    -----
    With `E = n B_1 - B_2` at the joint, and as for `couple` otherwise.  O(n^3).

    Examples
    --------
    A spring behind a lever that doubles the way has four times the stiffness:

    >>> import ph_control as phc
    >>> mass, spring = phc.spring_chain([2.0]), phc.spring_chain([0.25], ground=1.0)
    >>> levered = phc.transformer(mass, spring, 2.0)
    >>> levered.Q.diagonal().round(12)
    array([4.        , 0.33333333])
    """
    members = [_member(first), _member(second)]
    pairs, ratios = _pairs(members, ports, ratio)
    if not np.all(ratios):
        raise StructureError("the ratio of a transformer is 0, which joins nothing; it must be another number")
    whole, live = _side_by_side(members, canonical=True), list(range(first.ninputs + second.ninputs))
    for (i, j), n in zip(pairs, ratios, strict=True):
        joint = np.zeros(len(live))
        drop = live.index(first.ninputs + j)
        joint[i], joint[drop] = n, -1.0
        whole = _joined(whole, joint / np.abs(joint).max(), drop)
        del live[drop]
    return _made(whole, names)


def _joined(whole: _Whole, c: Array, drop: int) -> _Whole:
    """System with `c^T y = 0`, held by inputs `c f`; without the port `drop`, to which an input would do the same."""
    part = dict(whole.parts)
    kept = np.delete(np.eye(len(c)), drop, axis=1)
    D = part["S"] + part["N"]
    resistance = float(c @ part["S"] @ c)
    size = float(np.abs(c) @ np.abs(D) @ np.abs(c))
    whole = whole._replace(inputs=_without(whole.inputs, drop), outputs=_without(whole.outputs, drop))
    if resistance > _ROUNDING * len(c) * EPS * size:
        return whole._replace(parts=_through(part, c, kept, resistance))
    if np.abs(c @ D @ kept).max(initial=0.0) > _ROUNDING * len(c) * EPS * float(np.abs(D).max(initial=0.0)):
        raise StructureError(
            "the difference of the joined outputs contains an input directly, so that the force between them would "
            "contain its rate; join ports whose outputs are states"
        )
    return _constrained(whole._replace(parts=part), c, kept)


def _through(part: dict[str, Array], c: Array, kept: Array, resistance: float) -> dict[str, Array]:
    """Schur complement of the force: `c^T y = 0` is solved for it, `f = -c^T (C e + D w) / (c^T S c)`."""
    into, out, D = part["G"] - part["P"], (part["G"] + part["P"]).T, part["S"] + part["N"]
    states, inputs = -(c @ out) / resistance, -(c @ D) / resistance
    change = np.outer(into @ c, states)
    into = (into + np.outer(into @ c, inputs)) @ kept
    out = kept.T @ (out + np.outer(D @ c, states))
    D = kept.T @ (D + np.outer(D @ c, inputs)) @ kept
    at_sensors = part["sensor_feedthrough"] @ c
    return {
        **_structure(part["J"] - part["R"] + change, into, out, D), "Q": part["Q"],
        "sensor_rows": part["sensor_rows"] + np.outer(at_sensors, states @ part["Q"]),
        "sensor_feedthrough": (part["sensor_feedthrough"] + np.outer(at_sensors, inputs)) @ kept,
    }  # fmt: skip


def _constrained(whole: _Whole, c: Array, kept: Array) -> _Whole:
    """States on which `c^T y = E^T Q x` is 0, in coordinates that the force `E f` leaves alone."""
    part = whole.parts
    E, Q = part["G"] @ c, part["Q"]
    normal = Q @ E
    mobility = float(E @ normal)
    if mobility <= _ROUNDING * len(E) * EPS * float(np.abs(E) @ np.abs(Q) @ np.abs(E)):
        raise StructureError(
            "the joined ports move together already, or not at all: no force between them changes their outputs, so it "
            "is not determined; leave this pair out"
        )
    K = part["J"] - part["R"]
    force = -(normal @ K @ Q) / mobility, -(normal @ (part["G"] - part["P"])) / mobility
    # the variable that takes the larger share is eliminated: nothing cancels in what remains
    share = np.abs(E) * np.sqrt(np.maximum(np.diag(Q), 0.0))
    gone = int(np.flatnonzero(share >= (1 - 1e-9) * share.max())[-1])
    rest = np.delete(np.arange(len(E)), gone)
    rows = np.eye(len(E))[rest]
    rows[:, gone] = -E[rest] / E[gone]
    columns = np.eye(len(E))[:, rest] - np.outer(E, normal[rest]) / mobility
    at_sensors = part["sensor_feedthrough"] @ c
    new = _in_coordinates(part, rows, columns)
    new["sensor_rows"] = (part["sensor_rows"] + np.outer(at_sensors, force[0])) @ columns
    new["sensor_feedthrough"] = (part["sensor_feedthrough"] + np.outer(at_sensors, force[1])) @ kept
    new |= {"G": new["G"] @ kept, "P": new["P"] @ kept, "S": kept.T @ part["S"] @ kept, "N": kept.T @ part["N"] @ kept}
    whole = whole._replace(states=_without(whole.states, gone))
    # `J k = E`: k^T x is the difference of what the outputs are the rates of
    conserved = part["J"].T @ E  # where J is orthogonal, as the canonical one
    if not np.array_equal(part["J"] @ conserved, E):
        conserved = np.linalg.lstsq(part["J"], E, rcond=None)[0]
        conserved = np.where(np.abs(conserved) > _ROUNDING * len(E) * EPS * np.abs(conserved).max(), conserved, 0.0)
    k = conserved[rest]
    if not k.any() or any(_acts(new[name], k) for name in "JRGP"):
        return whole._replace(parts=new)
    partner = int(np.argmax(np.abs(part["J"][gone, rest] * k)))
    others = np.delete(np.arange(len(k)), partner)
    columns = np.eye(len(k))[:, others]
    columns[partner] = -k[others] / k[partner]
    final = _in_coordinates(new, np.eye(len(k))[others], columns)
    final["sensor_rows"] = new["sensor_rows"] @ columns
    return whole._replace(parts={**new, **final}, states=_without(whole.states, partner))


def _in_coordinates(part: dict[str, Array], rows: Array, columns: Array) -> dict[str, Array]:
    """Matrices of states `x = columns z`, `rows columns = I`."""
    Q, J, R = columns.T @ part["Q"] @ columns, rows @ part["J"] @ rows.T, rows @ part["R"] @ rows.T
    return {
        "Q": 0.5 * (Q + Q.T), "J": 0.5 * (J - J.T), "R": 0.5 * (R + R.T), "G": rows @ part["G"], "P": rows @ part["P"],
    }  # fmt: skip


def _acts(matrix: Array, k: Array) -> bool:
    """Whether `k^T matrix` is other than the rounding of 0."""
    return bool(np.any(np.abs(k @ matrix) > _ROUNDING * len(k) * EPS * (np.abs(k) @ np.abs(matrix))))


# --- one system of several -----------------------------------------------------------------------------------------


def _side_by_side(members: Sequence[PortHamiltonian | Array], canonical: bool = False) -> _Whole:
    """Systems and constant gains as one; `canonical` sorts positions before momenta where all have canonical ones."""
    systems = [member for member in members if isinstance(member, PortHamiltonian)]
    each = [parts_of(member) if isinstance(member, PortHamiltonian) else _constant(member) for member in members]
    parts = {}
    for name in PARTS:
        shape = tuple(sum(part[name].shape[k] for part in each) for k in (0, 1))
        # of blocks without rows or columns scipy makes what it can
        parts[name] = block_diag(*(part[name] for part in each)).reshape(-1)[: shape[0] * shape[1]].reshape(shape)
    counts = [part["G"].shape for part in each]
    signals = {kind: [_labels_of(member, kind, k) for k, member in enumerate(members)] for kind in LETTERS}
    inputs, states = (list(chain.from_iterable(signals[kind])) for kind in ("inputs", "states"))
    split = [(labels[:m], labels[m:]) for labels, (_, m) in zip(signals["outputs"], counts, strict=True)]
    outputs = list(chain(*(ports for ports, _ in split), *(sensors for _, sensors in split)))
    whole = _Whole(parts, inputs, outputs, states, _owners(members), common_unit(systems))
    if canonical and all(is_canonical(part["J"]) for part in each):
        return _positions_first(whole, [n for n, _ in counts])
    return whole


def _positions_first(whole: _Whole, sizes: Sequence[int]) -> _Whole:
    """Positions of all systems of such numbers of states, then their momenta."""
    ends = np.cumsum(sizes, dtype=int)
    halves = [(end - n, end - n // 2, end) for n, end in zip(sizes, ends, strict=True)]
    spans = [(start, middle) for start, middle, _ in halves] + [(middle, end) for _, middle, end in halves]
    order = np.concatenate([np.zeros(0, int), *(np.arange(*span) for span in spans)])
    parts = {name: whole.parts[name][np.ix_(order, order)] for name in "QJR"}
    parts |= {name: whole.parts[name][order] for name in "GP"} | {"sensor_rows": whole.parts["sensor_rows"][:, order]}
    return whole._replace(parts={**whole.parts, **parts}, states=[whole.states[k] for k in order])


def _constant(K: Array) -> dict[str, Array]:
    """Parts of a system without states."""
    none = np.zeros((0, len(K)))
    square = np.zeros((0, 0))
    return _structure(square, none, none.T, K) | {"Q": square, "sensor_rows": square, "sensor_feedthrough": none}


def _looped(
    whole: _Whole, F: Array, inputs: Array, *, kept: int | None = None, names: SystemNames | None = None
) -> PortHamiltonian:
    """Systems with `u = F y + E w`, `y_w = E^T y`; the names of the ports are those of the first `kept`."""
    part = whole.parts
    into, out, M = part["G"] - part["P"], (part["G"] + part["P"]).T, part["S"] + part["N"]
    loop = np.eye(len(F)) - F @ M
    # units of force and velocity have nothing to say about it
    if len(loop) and not np.linalg.cond(matrix_balance(loop, permute=False)[0]) < 1 / np.sqrt(EPS):
        raise StructureError("the loop of feedthroughs is singular: I - F (S + N) cannot be inverted")
    L = np.linalg.inv(loop)
    forward, rows, through = into @ L, part["sensor_rows"], part["sensor_feedthrough"]
    connected = _structure(
        part["J"] - part["R"] + forward @ F @ out, forward @ inputs,
        inputs.T @ (np.eye(len(F)) + M @ L @ F) @ out, inputs.T @ M @ L @ inputs,
    )  # fmt: skip
    connected |= {
        "Q": part["Q"], "sensor_rows": rows + through @ L @ F @ out @ part["Q"],
        "sensor_feedthrough": through @ L @ inputs,
    }  # fmt: skip
    ports, sensors = F.shape[0], whole.outputs[F.shape[0] :]
    first = slice(0, ports if kept is None else kept)
    named = whole._replace(parts=connected, inputs=whole.inputs[first], outputs=whole.outputs[:ports][first] + sensors)
    return _made(named, names or {})


def _structure(K: Array, into: Array, out: Array, D: Array) -> dict[str, Array]:
    """Structure matrices of `x' = K e + into u`, `y = out e + D u`."""
    return {
        "J": 0.5 * (K - K.T), "R": -0.5 * (K + K.T), "G": 0.5 * (out.T + into), "P": 0.5 * (out.T - into),
        "S": 0.5 * (D + D.T), "N": 0.5 * (D - D.T),
    }  # fmt: skip


def _made(whole: _Whole, names: SystemNames) -> PortHamiltonian:
    """System of these matrices, lossless where nothing is lost and the structure matrix is invertible."""
    part = whole.parts
    named: dict[str, Any] = {kind: _texts(getattr(whole, kind), kind, whole.owners) for kind in LETTERS}
    Q, G = part["Q"], part["G"]
    lossless = not (any(part[name].any() for name in "RPSN") or len(part["sensor_rows"]))
    if lossless and not is_canonical(part["J"]):
        split = split_casimirs(Q, G, part["J"])
        Q, G, named["states"] = split.Q, split.B, None
    named = {kind: labels for kind, labels in named.items() if labels and names.get(kind, names.get(kind[:-1])) is None}
    if not lossless:
        return restored(part, cast(SystemNames, {**names, **named}), whole.time_unit)
    return with_unit(PortHamiltonian._from_matrices(Q, G, **names, **named), whole.time_unit)


# --- names ---------------------------------------------------------------------------------------------------------


def _labels_of(member: PortHamiltonian | Array, kind: str, owner: int) -> list[_Label]:
    """Labels of the signals of a system, None for all where they are those that python-control gives."""
    if not isinstance(member, PortHamiltonian):
        return [_Label(owner, None)] * (0 if kind == "states" else len(member))
    labels: Sequence[str | None] = member._given_labels(kind) or [None] * getattr(member, f"n{kind}")
    return [_Label(owner, label) for label in labels]


def _has_names(system: PortHamiltonian) -> bool:
    return any(label.text for kind in LETTERS for label in _labels_of(system, kind, 0))


def _owners(members: Sequence[PortHamiltonian | Array]) -> list[str]:
    """Names of the systems, or numbers where they have none of their own."""
    known = [
        member.name if isinstance(member, PortHamiltonian) and not member._generic_name_check() else None
        for member in members
    ]
    return [name if name and known.count(name) == 1 else f"sys{k}" for k, name in enumerate(known, 1)]


def _texts(labels: list[_Label], kind: str, owners: list[str]) -> list[str] | None:
    """Names of signals, all different: those that are there twice begin with the name of their system."""
    texts = [label.text for label in labels]
    if not any(texts):
        return None
    names: list[str] = []
    for place, (owner, text) in enumerate(labels):
        name = f"{LETTERS[kind]}[{place}]" if text is None else text
        if text is not None and texts.count(text) > 1:
            name = f"{owners[owner]}_{text}"
        while name in names:
            name += "_"
        names.append(name)
    return names


def _without(labels: list[_Label], place: int) -> list[_Label]:
    return labels[:place] + labels[place + 1 :]


# --- checks --------------------------------------------------------------------------------------------------------


def _member(system: object) -> PortHamiltonian:
    if not isinstance(system, PortHamiltonian):
        raise StructureError(f"this is a {_checks.type_of(system)}; pass PortHamiltonian systems, made by ph")
    return system


def _partner(first: PortHamiltonian, other: object, spread: Array) -> PortHamiltonian | Array | None:
    """System or gain with as many ports as the first; None where their connection is not port-Hamiltonian."""
    m = first.ninputs
    if first.noutputs != m:
        return None
    if isinstance(other, PortHamiltonian):
        return other if other.ninputs == other.noutputs == m else None
    return _gain(other, m, spread)


def _gain(value: object, m: int, spread: Array) -> Array | None:
    """Matrix of a constant gain that makes no energy, of a number times `spread`; None where it is none such."""
    if _checks.is_number(value):
        value = np.array(float(value))
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf" or not np.isfinite(value).all():
        return None
    K = np.asarray(value, float) * (spread if value.ndim == 0 else 1.0)
    if K.shape != (m, m):
        return None
    _checks.in_range("the gain", K)
    return K if np.linalg.eigvalsh(K + K.T).min(initial=0.0) >= 0 else None


def _pairs(members: Sequence[PortHamiltonian], ports: Ports, ratio: ArrayLike) -> tuple[list[tuple[int, int]], Array]:
    """Numbers of the ports of each pair, and its ratio."""
    is_pair = isinstance(ports, tuple) and len(ports) == 2 and not any(isinstance(port, tuple | list) for port in ports)
    listed = [ports] if is_pair else ports
    if not isinstance(listed, list | tuple) or not listed:
        raise StructureError(f"ports is {_checks.shown(ports)}; give a pair (i, j), or a list of pairs")
    pairs = []
    for pair in listed:
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise StructureError(f"one of the ports is {_checks.shown(pair)}; give pairs (i, j), of both systems one")
        pairs.append((_port(members[0], pair[0], "first"), _port(members[1], pair[1], "second")))
    for which, side in (("first", 0), ("second", 1)):
        used = [pair[side] for pair in pairs]
        if len(set(used)) < len(used):
            raise StructureError(f"a port of the {which} system is there twice in {ports}; join each once")
    ratios = _checks.real_array("the ratio", ratio)
    if ratios.shape not in ((), (len(pairs),)):
        raise StructureError(
            f"the ratio has shape {ratios.shape}; give a number, or one for each of {len(pairs)} pairs"
        )
    return pairs, np.broadcast_to(ratios, len(pairs))


def _port(system: PortHamiltonian, port: object, which: str) -> int:
    try:
        return _checks.signal_number("input", port, system.input_labels)
    except StructureError as error:
        raise StructureError(f"no such port of the {which} system: {error}") from None

"""Nodal analysis of netlists with 60 digits, and random lossless one-ports whose circuits it is held against."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np

import ph_control as phc

DIGITS = 60
UNIT = 2.0**-53  # relative error of a value that was rounded to a double
FORMS = ("foster1", "foster2", "cauer1", "cauer2")
KINDS = ("admittance", "impedance")


def random_one_port(seed: int, modes: int = 30) -> phc.ModalForm:
    """Lossless one-port of 1 to `modes` modes, every fifth with a pole at 0; frequencies and weights over decades."""
    rng = np.random.default_rng(seed)
    n, decades = int(rng.integers(1, modes + 1)), rng.uniform(0.3, 3.0)
    d = np.sort(10 ** rng.uniform(-decades / 2, decades / 2, n)) * 10 ** rng.uniform(-3, 9)
    r = 10 ** rng.uniform(-2, 2, n)
    rigid = np.sqrt(r[:1, None] * d[0]) if seed % 5 == 0 else np.zeros((0, 1))
    return phc.ModalForm(d, np.sqrt(r)[:, None].astype(complex), rigid, r)


def exact_response(modes: phc.ModalForm, w: float) -> Any:
    """Transfer function of a one-port at `i w`, from its frequencies and weights."""
    s = mpmath.mpc(0, w)
    at_zero = sum((mpmath.mpf(float(one)) ** 2 for one in modes.rigid[:, 0]), mpmath.mpf(0))
    pairs = [(mpmath.mpf(float(d)), mpmath.mpf(float(r))) for d, r in zip(modes.d, modes.r, strict=True)]
    return at_zero / s + sum(d * r * s / (s * s + d * d) for d, r in pairs)


def nodal_response(text: str, w: float) -> tuple[Any, list[tuple[str, Any, Any]]]:
    """Response of the ports of a netlist at `i w`, and `(name, admittance, voltages for each port)` of its elements.

    Modified nodal analysis: unknowns are the voltages of the nodes and the currents of sources and coupled inductors.
    The matrix has the currents delivered by voltage sources, and the voltages at current sources, one column for each.
    """
    s = mpmath.mpc(0, w)
    words = [line.split() for line in text.splitlines()[1:] if line[0] not in ".*"]
    listed = [(one[0], one[1:]) for one in words]
    sensed = {one[2] for name, one in listed if name[0] == "F"}
    ports = [name for name, one in listed if name[0] in "VI" and name not in sensed]
    coupled = {name for kind, one in listed if kind[0] == "K" for name in one[:2]}
    values = {name: mpmath.mpf(float(one[-1])) for name, one in listed if name not in ports}
    rows: dict[str, dict[str, Any]] = {}
    right: dict[str, list[Any]] = {}

    def add(row: str, column: str, value: Any) -> None:
        if row != "0" and column != "0":
            rows.setdefault(row, {})
            rows[row][column] = rows[row].get(column, 0) + value

    branches = []
    for name, one in listed:
        plus, minus = one[:2]
        if name[0] in "RLC" and name not in coupled:
            y = {"R": lambda v: 1 / v, "L": lambda v: 1 / (s * v), "C": lambda v: s * v}[name[0]](values[name])
            branches.append((name, y, plus, minus))
            for a, sign in ((plus, 1), (minus, -1)):
                add(a, plus, sign * y)
                add(a, minus, -sign * y)
        elif name[0] in "VEL":
            current = f"i({name})"
            for a, sign in ((plus, 1), (minus, -1)):
                add(a, current, mpmath.mpf(sign))
                add(current, a, mpmath.mpf(sign))
            rows.setdefault(current, {})
            if name[0] == "E":
                add(current, one[2], -values[name])
                add(current, one[3], values[name])
            if name in ports:
                right[current] = [mpmath.mpf(port == name) for port in ports]
            if name[0] == "L":
                add(current, current, -s * values[name])
        elif name[0] == "F":
            for a, sign in ((plus, 1), (minus, -1)):
                add(a, f"i({one[2]})", sign * values[name])
        elif name[0] == "G":
            for a, sign in ((plus, 1), (minus, -1)):
                add(a, one[2], sign * values[name])
                add(a, one[3], -sign * values[name])
        elif name[0] == "K":
            mutual = values[name] * mpmath.sqrt(values[plus] * values[minus])
            add(f"i({plus})", f"i({minus})", -s * mutual)
            add(f"i({minus})", f"i({plus})", -s * mutual)
        elif name[0] == "I":
            for a, sign in ((plus, -1), (minus, 1)):
                if a != "0":
                    right[a] = [
                        x + mpmath.mpf(sign * (port == name))
                        for x, port in zip(right.get(a, [0] * len(ports)), ports, strict=True)
                    ]
    x = _solved(rows, right, len(ports))
    x["0"] = [mpmath.mpf(0)] * len(ports)
    ends = {name: one[:2] for name, one in listed}
    answer = [
        [-v for v in x[f"i({name})"]]
        if name[0] == "V"
        else [b - a for a, b in zip(x[ends[name][0]], x[ends[name][1]], strict=True)]
        for name in ports
    ]
    voltages = [(name, y, [a - b for a, b in zip(x[p], x[m], strict=True)]) for name, y, p, m in branches]
    return mpmath.matrix(answer), voltages


def _solved(rows: dict[str, dict[str, Any]], right: dict[str, list[Any]], count: int) -> dict[str, list[Any]]:
    """Solution of a sparse system of equations: the row of fewest entries first, with its largest as the pivot."""
    rows = {name: dict(row) for name, row in rows.items()}
    right = {name: list(right.get(name, [mpmath.mpf(0)] * count)) for name in rows}
    done = []
    while rows:
        name = min(rows, key=lambda one: len(rows[one]))
        row, known = rows.pop(name), right.pop(name)
        column = max(row, key=lambda one: abs(row[one]))
        pivot = row.pop(column)
        done.append((column, pivot, row, known))
        for other in [one for one, entries in rows.items() if column in entries]:
            factor = rows[other].pop(column) / pivot
            for k, value in row.items():
                rows[other][k] = rows[other].get(k, 0) - factor * value
            right[other] = [a - factor * b for a, b in zip(right[other], known, strict=True)]
    x: dict[str, list[Any]] = {}
    for column, pivot, row, known in reversed(done):
        x[column] = [
            (value - sum((entry * x[k][port] for k, entry in row.items()), mpmath.mpf(0))) / pivot
            for port, value in enumerate(known)
        ]
    return x


def errors(modes: phc.ModalForm, circuit: phc.Netlist, w: float) -> tuple[float, float]:
    """Relative error of the response at `i w`, and what rounded element values would explain of it.

    By Tellegen's theorem an element of the admittance y with the voltage v changes the response by `y v^2` times its
    own relative change.
    """
    with mpmath.workdps(DIGITS):
        exact = exact_response(modes, w)
        found, voltages = nodal_response(circuit.spice(), w)
        condition = sum(abs(y * v[0] ** 2) for _, y, v in voltages) / abs(exact)
        return float(abs(found[0, 0] - exact) / abs(exact)), float(condition) * UNIT


def round_trip(circuit: phc.Netlist) -> float:
    """Largest relative change of an element from netlist to port-Hamiltonian system and back."""
    again = phc.netlist(phc.read_netlist(circuit.spice()), circuit.form, kind=circuit.kind)
    if [one.name for one in again.elements] != [one.name for one in circuit.elements]:
        return float("inf")
    return max(abs(a.value / b.value - 1) for a, b in zip(again.elements, circuit.elements, strict=True))

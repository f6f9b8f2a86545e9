"""Known systems in physical coordinates: circuits, ladders, chains of masses, springs and dampers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from .. import _checks
from .._types import Array, ArrayLike, SystemNames, Unpack
from ..exceptions import StructureError
from .port_hamiltonian import PortHamiltonian, ph

_LARGEST = 10**6  # masses of a chain: its matrices are dense


def lc_circuit(C: ArrayLike, L: ArrayLike, *, R: ArrayLike = 0.0, **names: Unpack[SystemNames]) -> PortHamiltonian:
    """Circuit of n parallel branches across a voltage source, each an inductor, a capacitor and a resistor in series.

    The paper's non-dissipative circuit, and Foster's second form of a lossless admittance: branch l has the
    natural frequency `1 / sqrt(L_l C_l)` and contributes `(s / L_l) / (s^2 + 1 / (L_l C_l))`.  Resistors damp it by
    the ratio `R_l sqrt(C_l / L_l) / 2`.

    Parameters
    ----------
    C : array_like, shape (n,), or a number
        Capacitances, positive, farad.  A number is the capacitance of every branch.
    L : array_like, shape (n,), or a number
        Inductances, positive, henry.  A number is the inductance of every branch.
    R : array_like, shape (n,), or a number
        Resistances in series, not negative, ohm; default none.  A number is the resistance of every branch.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default the input is `V`, the output `I`
        and the states are `Q_1 .. Q_n, phi_1 .. phi_n`.

    Returns
    -------
    PortHamiltonian
        From source voltage (V) to source current (A).  States: charges (C) and flux linkages (Wb).  With resistors a
        `DissipativePortHamiltonian`.

    Raises
    ------
    StructureError
        If a value is not positive (a resistance not negative) and finite, or the sizes differ.

    Notes
    -----
    `H = sum_l Q_l^2 / (2 C_l) + phi_l^2 / (2 L_l)`, `B = (0 .. 0, 1 .. 1)`, `R = diag(0 .. 0, R_l)`.  Branches with
    equal products `L C` resonate as one: without resistors the system is then not canonical.

    Examples
    --------
    >>> import ph_control as phc
    >>> circuit = phc.lc_circuit([1.0, 0.25], [1.0, 4.0 / 9.0])
    >>> circuit.d, circuit.modes.kappa
    (array([1., 3.]), array([1.  , 2.25]))
    >>> phc.lc_circuit([1.0, 0.25], [1.0, 4.0 / 9.0], R=[0.2, 0.0]).damping_ratios
    array([0.1, 0. ])
    """
    capacitance = _values("C", C, "a capacitance", positive=True)
    inductance = _values("L", L, "an inductance", positive=True)
    n = max(capacitance.size, inductance.size)
    if {capacitance.size, inductance.size} - {1, n}:
        raise StructureError(
            f"C has {capacitance.size} entries and L has {inductance.size}; give one of each for every branch, or a "
            "number for all"
        )
    energy = np.concatenate([np.ones(n) / capacitance, np.ones(n) / inductance])
    port = np.repeat([0.0, 1.0], n)
    resistance = _values("R", R, "a resistance", n, f"the {n} branches")
    signals = named(names, ["V"], ["I"], numbered("Q", n) + numbered("phi", n))
    return ph(np.diag(energy), port, R=_losses(resistance), **signals)


def spring_chain(
    masses: ArrayLike, stiffnesses: ArrayLike = 1.0, *, ground: ArrayLike = 0.0, c: ArrayLike = 0.0,
    ground_c: ArrayLike = 0.0, port: int | Sequence[int] = 0, **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    """Chain of masses, each tied to the next by a spring and a damper, and to the ground by others where wanted.

    Parameters
    ----------
    masses : array_like, shape (n,)
        Masses, positive, kg.
    stiffnesses : array_like, shape (n - 1,), or a number
        Stiffnesses of the springs between neighbours, not negative, N/m.  A number is the stiffness of each.
    ground : array_like, shape (n,), or a number
        Stiffnesses of the springs from each mass to the ground, not negative, N/m; default none.  Without any the
        chain floats: its Hamiltonian is only positive semidefinite, and the system has a pole at 0.
    c : array_like, shape (n - 1,), or a number
        Viscosities of the dampers beside the springs between neighbours, not negative, N s/m; default none.
    ground_c : array_like, shape (n,), or a number
        Viscosities of the dampers from each mass to the ground, not negative, N s/m; default none.
    port : int, or a sequence of int
        The mass on which the force acts and whose velocity is the output, counted from 0; several make a system
        with as many ports.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default the input is `F`, the output `v`
        (several ports: `F_1, F_2 ..` and `v_1, v_2 ..` in the order of `port`) and the states are
        `q_1 .. q_n, p_1 .. p_n`.

    Returns
    -------
    PortHamiltonian
        From force (N) to velocity (m/s).  States: displacements (m) and momenta (kg m/s).  With dampers a
        `DissipativePortHamiltonian`.

    Raises
    ------
    StructureError
        If a mass is not positive, a stiffness or viscosity negative, the sizes do not fit, or there is no mass `port`.

    Notes
    -----
    `H = sum_i p_i^2 / (2 m_i) + k_i (q_{i+1} - q_i)^2 / 2 + g_i q_i^2 / 2`, `B` the unit vector of the momentum of
    the mass `port`.  The dampers take `sum_i c_i (v_{i+1} - v_i)^2 + ground_c_i v_i^2`.  The matrices are dense.

    Examples
    --------
    >>> import ph_control as phc
    >>> wall_to_wall = phc.spring_chain([1.0, 1.0], 4.0, ground=[1.0, 1.0])
    >>> wall_to_wall.d
    array([1., 3.])
    >>> round(phc.spring_chain([1.0, 3.0]).modes.kappa_0, 12)  # the whole chain as one rigid body: 1 / (1 + 3)
    0.25
    >>> phc.spring_chain([1.0, 1.0], 4.0, ground=1.0, c=0.5).damping_ratios.round(6)
    array([0.      , 0.166667])
    """
    mass = _values("masses", masses, "a mass", positive=True)
    n = mass.size
    between = _values("stiffnesses", stiffnesses, "a stiffness", n - 1, f"the {n - 1} springs between {n} masses")
    to_ground = _values("ground", ground, "a stiffness", n, f"the {n} masses")
    dampers = _values("c", c, "a viscosity", n - 1, f"the {n - 1} dampers between {n} masses")
    drag = _values("ground_c", ground_c, "a viscosity", n, f"the {n} masses")
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n] = np.diag(to_ground) + _laplacian(between)
    Q[n:, n:] = np.diag(1.0 / mass)
    ports = _port_indices(port, n)
    B = np.zeros((2 * n, len(ports)))
    B[n + np.array(ports), np.arange(len(ports))] = 1.0
    loss = np.diag(drag) + _laplacian(dampers) if dampers.any() or drag.any() else np.zeros(n)
    return ph(Q, B, R=_losses(loss), **named(names, *force_names(len(ports)), numbered("q", n) + numbered("p", n)))


def frenkel_kontorova(n: int = 2, **names: Unpack[SystemNames]) -> PortHamiltonian:
    """Chain of n unit masses and unit springs, the first mass tied to the origin, the last one free.

    The paper's positive definite Frenkel-Kontorova model,
    `H = sum_i p_i^2 / 2 + sum_i (q_{i+1} - q_i)^2 / 2 + q_1^2 / 2`, with the force on, and the velocity of, the first
    mass.

    Parameters
    ----------
    n : int
        Number of masses, at least 1; 2 in the paper.
    **names
        As for `spring_chain`.

    Returns
    -------
    PortHamiltonian
        From force to velocity.  States: `q_1 .. q_n, p_1 .. p_n`.

    Raises
    ------
    StructureError
        If `n` is not a positive whole number.

    Notes
    -----
    Natural frequencies `2 sin((2 l - 1) pi / (2 (2 n + 1)))`, `l = 1 .. n`; all are reached: the system is canonical.

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.frenkel_kontorova().d.round(6)
    array([0.618034, 1.618034])
    """
    n = _checks.whole_number("n", n, 1, _LARGEST)
    return spring_chain(np.ones(n), 1.0, ground=np.eye(1, n)[0], **names)


def msd_chain(
    n: int = 50, *, m: ArrayLike = 4.0, k: ArrayLike = 4.0, c: ArrayLike = 1.0, ports: int = 2,
    **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    """Chain of masses with dampers to the ground, the last mass on a spring to a wall: a benchmark of model reduction.

    Parameters
    ----------
    n : int
        Number of masses, at least 1.
    m : array_like, shape (n,), or a number
        Masses, positive, kg.
    k : array_like, shape (n,), or a number
        Stiffnesses, not negative, N/m: of the springs to the next mass, the last one of that to the wall.
    c : array_like, shape (n,), or a number
        Viscosities of the dampers between each mass and the ground, not negative, N s/m.
    ports : int
        Number of ports: forces on, and velocities of, the first masses.
    **names
        As for `spring_chain`.

    Returns
    -------
    PortHamiltonian
        From forces to velocities.  States: `q_1 .. q_n, p_1 .. p_n`; the benchmark sorts them `q_1, p_1, q_2, ..`.

    Raises
    ------
    StructureError
        If a number or a size is not as said.

    Notes
    -----
    The chain of Gugercin, Polyuga, Beattie and van der Schaft (Automatica, 2012), which the port-Hamiltonian benchmark
    collection has too; its H2 norm is 0.36462 with the default values.  The matrices are dense.

    Examples
    --------
    >>> import ph_control as phc
    >>> chain = phc.msd_chain()
    >>> chain(0.1j)[0].round(6)
    array([0.125712+0.073217j, 0.122624+0.050628j])
    """
    n = _checks.whole_number("n", n, 1, _LARGEST)
    stiffness = _values("k", k, "a stiffness", n, f"the {n} masses")
    m = _values("m", m, "a mass", n, f"the {n} masses", positive=True)
    return spring_chain(
        m, stiffness[:-1], ground=stiffness[-1] * np.eye(1, n, n - 1)[0], ground_c=c,
        port=range(_checks.whole_number("ports", ports, 1, n)), **names,
    )  # fmt: skip


def rcl_ladder(
    n: int = 50, *, R: ArrayLike = 0.2, C: ArrayLike = 1.0, L: ArrayLike = 1.0, load: float = 0.4, ports: int = 1,
    **names: Unpack[SystemNames],
) -> PortHamiltonian:  # fmt: skip
    """Ladder of n cells, each a capacitor across and a resistor and an inductor along: a benchmark of model reduction.

    Parameters
    ----------
    n : int
        Number of cells, at least 1.
    R, C, L : array_like, shape (n,), or a number
        Resistances (not negative, ohm), capacitances (positive, farad) and inductances (positive, henry).
    load : float
        Resistance that ends the ladder, in series with the last inductor, not negative, ohm.
    ports : {1, 2}
        1: the current into, and the voltage of, the first capacitor; 2: also a voltage source at the end, with its
        current.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default `I` and `V` (two ports: `I, V_end` and
        `V, I_end`), and the states `Q_1 .. Q_n, phi_1 .. phi_n`.

    Returns
    -------
    PortHamiltonian
        States: charges (C) and flux linkages (Wb); the benchmark sorts them `Q_1, phi_1, Q_2, ..`.

    Raises
    ------
    StructureError
        If a number or a size is not as said.

    Notes
    -----
    `V_k = Q_k / C_k`, `I_k = phi_k / L_k`; `Q_k' = I_{k-1} - I_k`, `phi_k' = V_k - V_{k+1} - R_k I_k`.  The defaults
    are the ladder of Polyuga and van der Schaft (Automatica, 2010); that of Gugercin, Polyuga, Beattie and van der
    Schaft (Automatica, 2012) is `rcl_ladder(R=3.0, C=0.1, L=0.1, load=1.0, ports=2)`.  The matrices are dense.

    Examples
    --------
    >>> import ph_control as phc
    >>> ladder = phc.rcl_ladder(3)
    >>> ladder(0.0).real.round(12).item()  # all resistors in series
    1.0
    """
    n = _checks.whole_number("n", n, 1, _LARGEST)
    resistance = _values("R", R, "a resistance", n, f"the {n} cells")
    end = _values("load", load, "a resistance", 1, "the end")
    capacitance = _values("C", C, "a capacitance", n, f"the {n} cells", positive=True)
    inductance = _values("L", L, "an inductance", n, f"the {n} cells", positive=True)
    resistance[-1] += end[0]
    J, G = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, _checks.whole_number("ports", ports, 1, 2)))
    J[:n, n:] = np.eye(n, k=-1) - np.eye(n)
    J[n:, :n] = -J[:n, n:].T
    G[0, 0] = 1.0
    signals = (["I"], ["V"])
    if ports == 2:
        G[-1, 1], signals = 1.0, (["I", "V_end"], ["V", "I_end"])
    return ph(
        np.diag(1.0 / np.concatenate([capacitance, inductance])), G, J=J, R=_losses(resistance),
        **named(names, *signals, numbered("Q", n) + numbered("phi", n)),
    )  # fmt: skip


def _laplacian(stiffness: Array) -> Array:
    """Stiffness matrix of springs between neighbours: `sum_i k_i (e_{i+1} - e_i) (e_{i+1} - e_i)^T`."""
    inner = np.concatenate([[0.0], stiffness, [0.0]])
    return np.diag(inner[:-1] + inner[1:]) - np.diag(stiffness, 1) - np.diag(stiffness, -1)


def _losses(block: Array) -> Array | None:
    """`R = diag(0, block)`, where there is any; of a vector its diagonal matrix."""
    if not block.any():
        return None
    n, R = len(block), np.zeros((2 * len(block), 2 * len(block)))
    R[n:, n:] = np.diag(block) if block.ndim == 1 else block
    return R


def _values(
    name: str, value: ArrayLike, what: str, count: int | None = None, of: str = "every branch", positive: bool = False
) -> Array:
    """Check physical values, one each `of` something or a number for all; positive ones, or not negative."""
    array = _checks.real_array(name, value)
    if array.ndim == 0:
        array = np.full(1 if count is None else count, float(array))
    if array.ndim != 1 or len(array) != (max(1, len(array)) if count is None else count):
        raise StructureError(f"{name} has shape {array.shape}; it must be a number, or a vector with one for {of}")
    if array.min(initial=1.0) < 0 or (positive and not array.all()):
        worst = int(array.argmin())
        raise StructureError(f"{name}[{worst}] = {array[worst]:.6g}; {what} is {'> 0' if positive else 'not negative'}")
    if positive:
        with np.errstate(over="ignore"):
            _checks.representable(f"the reciprocals of {name}", 1.0 / array)
    return array


def _port_indices(port: Any, n: int) -> list[int]:
    several = isinstance(port, list | tuple | range) or (isinstance(port, np.ndarray) and port.ndim == 1)
    ports = list(port) if several else [port]
    if not ports or not all(_checks.is_whole(index) and 0 <= index < n for index in ports):
        raise StructureError(f"port is {_checks.shown(port)}; masses are counted from 0 to {n - 1}; name at least one")
    return [int(index) for index in ports]


def force_names(count: int) -> tuple[list[str], list[str]]:
    """Names of so many forces, and of the velocities there."""
    return (["F"], ["v"]) if count == 1 else (numbered("F", count), numbered("v", count))


def numbered(letter: str, count: int) -> list[str]:
    """Names with numbers from 1."""
    return [f"{letter}_{k}" for k in range(1, count + 1)]


def named(names: SystemNames, inputs: list[str], outputs: list[str], states: list[str]) -> SystemNames:
    """The user's names, and these where the user gave none; python-control takes `input` as well as `inputs`."""
    defaults = {"inputs": inputs, "outputs": outputs, "states": states}
    new = {key: value for key, value in defaults.items() if names.get(key, names.get(key[:-1])) is None}
    return cast(SystemNames, {**names, **new})

"""Known systems: LC circuits and chains of masses and springs, in physical coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _checks
from .exceptions import StructureError
from .systems import PortHamiltonian, ph

Array = NDArray[np.float64]


def lc_circuit(C: ArrayLike, L: ArrayLike, **names: Any) -> PortHamiltonian:
    """Circuit of n parallel branches, in each an inductor in series with a capacitor, across a voltage source.

    The paper's non-dissipative circuit, and Foster's second form of a lossless admittance: branch l has the
    natural frequency `1 / sqrt(L_l C_l)` and contributes `(s / L_l) / (s^2 + 1 / (L_l C_l))`.

    Parameters
    ----------
    C : array_like, shape (n,), or a number
        Capacitances, positive, farad.  A number is the capacitance of every branch.
    L : array_like, shape (n,), or a number
        Inductances, positive, henry.  A number is the inductance of every branch.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default the input is `V`, the output `I`
        and the states are `Q_1 .. Q_n, phi_1 .. phi_n`.

    Returns
    -------
    PortHamiltonian
        From source voltage (V) to source current (A).  States: charges (C) and flux linkages (Wb).

    Raises
    ------
    StructureError
        If a value is not positive and finite, or the sizes differ.

    Notes
    -----
    `H = sum_l Q_l^2 / (2 C_l) + phi_l^2 / (2 L_l)`, `B = (0 .. 0, 1 .. 1)`.  Branches with equal products `L C`
    resonate as one: the system is then not canonical.

    Examples
    --------
    >>> from ph_control.models import lc_circuit
    >>> circuit = lc_circuit([1.0, 0.25], [1.0, 4.0 / 9.0])
    >>> circuit.d, circuit.modes.kappa
    (array([1., 3.]), array([1.  , 2.25]))
    """
    capacitance = _positive("C", C, "a capacitance")
    inductance = _positive("L", L, "an inductance")
    n = max(capacitance.size, inductance.size)
    if {capacitance.size, inductance.size} - {1, n}:
        raise StructureError(
            f"C has {capacitance.size} entries and L has {inductance.size}; give one of each for every branch, or a "
            "number for all"
        )
    energy = np.concatenate([np.ones(n) / capacitance, np.ones(n) / inductance])
    port = np.repeat([0.0, 1.0], n)
    return ph(np.diag(energy), port, **_named(names, ["V"], ["I"], _numbered("Q", n) + _numbered("phi", n)))


def spring_chain(
    masses: ArrayLike,
    stiffnesses: ArrayLike = 1.0,
    *,
    ground: ArrayLike = 0.0,
    port: int | Sequence[int] = 0,
    **names: Any,
) -> PortHamiltonian:
    """Chain of masses, each tied to the next by a spring, and to the ground by another where wanted.

    Parameters
    ----------
    masses : array_like, shape (n,)
        Masses, positive, kg.
    stiffnesses : array_like, shape (n - 1,), or a number
        Stiffnesses of the springs between neighbours, not negative, N/m.  A number is the stiffness of each.
    ground : array_like, shape (n,), or a number
        Stiffnesses of the springs from each mass to the ground, not negative, N/m; default none.  Without any the
        chain floats: its Hamiltonian is only positive semidefinite, and the system has a pole at 0.
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
        From force (N) to velocity (m/s).  States: displacements (m) and momenta (kg m/s).

    Raises
    ------
    StructureError
        If a mass is not positive, a stiffness is negative, the sizes do not fit, or there is no mass `port`.

    Notes
    -----
    `H = sum_i p_i^2 / (2 m_i) + k_i (q_{i+1} - q_i)^2 / 2 + g_i q_i^2 / 2`, `B` the unit vector of the momentum of
    the mass `port`.  The matrices are dense.

    Examples
    --------
    >>> from ph_control.models import spring_chain
    >>> wall_to_wall = spring_chain([1.0, 1.0], 4.0, ground=[1.0, 1.0])
    >>> wall_to_wall.d
    array([1., 3.])
    >>> round(spring_chain([1.0, 3.0]).modes.kappa_0, 12)  # the whole chain as one rigid body: 1 / (1 + 3)
    0.25
    """
    mass = _positive("masses", masses, "a mass")
    n = mass.size
    between = _stiffness("stiffnesses", stiffnesses, n - 1, f"the {n - 1} springs between {n} masses")
    to_ground = _stiffness("ground", ground, n, f"the {n} masses")
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n] = np.diag(to_ground) + _laplacian(between)
    Q[n:, n:] = np.diag(1.0 / mass)
    ports = _port_indices(port, n)
    B = np.zeros((2 * n, len(ports)))
    B[n + np.array(ports), np.arange(len(ports))] = 1.0
    inputs, outputs = (["F"], ["v"]) if len(ports) == 1 else (_numbered("F", len(ports)), _numbered("v", len(ports)))
    return ph(Q, B, **_named(names, inputs, outputs, _numbered("q", n) + _numbered("p", n)))


def frenkel_kontorova(n: int = 2, **names: Any) -> PortHamiltonian:
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
    >>> from ph_control.models import frenkel_kontorova
    >>> frenkel_kontorova().d.round(6)
    array([0.618034, 1.618034])
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise StructureError(f"n is {n!r}; the number of masses is a whole number, at least 1")
    return spring_chain(np.ones(n), 1.0, ground=np.eye(1, int(n))[0], **names)


def _laplacian(stiffness: Array) -> Array:
    """Stiffness matrix of springs between neighbours: `sum_i k_i (e_{i+1} - e_i) (e_{i+1} - e_i)^T`."""
    inner = np.concatenate([[0.0], stiffness, [0.0]])
    return np.diag(inner[:-1] + inner[1:]) - np.diag(stiffness, 1) - np.diag(stiffness, -1)


def _positive(name: str, value: ArrayLike, what: str) -> Array:
    array = np.atleast_1d(_checks.real_array(name, value))
    if array.ndim != 1 or array.size == 0:
        raise StructureError(f"{name} has shape {array.shape}; it must be a number or a vector with at least one entry")
    if array.min() <= 0:
        worst = int(array.argmin())
        raise StructureError(f"{name}[{worst}] = {array[worst]:.6g}; {what} is > 0")
    return array


def _stiffness(name: str, value: ArrayLike, count: int, of: str) -> Array:
    array = _checks.real_array(name, value)
    if array.ndim == 0:
        array = np.full(count, float(array))
    if array.shape != (count,):
        raise StructureError(f"{name} has shape {array.shape}; it must be a number or ({count},), one for {of}")
    if count and array.min() < 0:
        worst = int(array.argmin())
        raise StructureError(f"{name}[{worst}] = {array[worst]:.6g}; a stiffness is not negative")
    return array


def _port_indices(port: Any, n: int) -> list[int]:
    ports = list(port) if isinstance(port, Sequence | np.ndarray) and not isinstance(port, str) else [port]
    if not ports:
        raise StructureError("port is empty; name at least one mass")
    for index in ports:
        if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < n:
            raise StructureError(f"port is {port!r}; masses are counted from 0 to {n - 1}")
    return [int(index) for index in ports]


def _numbered(letter: str, count: int) -> list[str]:
    return [f"{letter}_{k}" for k in range(1, count + 1)]


def _named(names: dict[str, Any], inputs: list[str], outputs: list[str], states: list[str]) -> dict[str, Any]:
    """The user's names, and these where the user gave none; python-control takes `input` as well as `inputs`."""
    defaults = {"inputs": inputs, "outputs": outputs, "states": states}
    return names | {key: value for key, value in defaults.items() if names.get(key, names.get(key[:-1])) is None}

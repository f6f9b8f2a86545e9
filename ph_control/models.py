"""Known systems in physical coordinates: LC circuits, chains of masses and springs, mass and stiffness matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from . import _checks, _definite
from .exceptions import StructureError
from .systems import PortHamiltonian, ph

Array = NDArray[np.float64]

_LARGEST = 10**6  # masses of a chain: its matrices are dense


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
    >>> import ph_control as phc
    >>> circuit = phc.lc_circuit([1.0, 0.25], [1.0, 4.0 / 9.0])
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
    >>> import ph_control as phc
    >>> wall_to_wall = phc.spring_chain([1.0, 1.0], 4.0, ground=[1.0, 1.0])
    >>> wall_to_wall.d
    array([1., 3.])
    >>> round(phc.spring_chain([1.0, 3.0]).modes.kappa_0, 12)  # the whole chain as one rigid body: 1 / (1 + 3)
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
    >>> import ph_control as phc
    >>> phc.frenkel_kontorova().d.round(6)
    array([0.618034, 1.618034])
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or not 1 <= n <= _LARGEST:
        raise StructureError(
            f"n is {_checks.shown(n)}; the number of masses is a whole number, at least 1 and at most {_LARGEST}"
        )
    return spring_chain(np.ones(n), 1.0, ground=np.eye(1, int(n))[0], **names)


def from_second_order(
    M: ArrayLike, K: ArrayLike, b: ArrayLike, *, condense: bool = False, **names: Any
) -> PortHamiltonian:
    """Undamped structure `M q'' + K q = b u` with the velocity at the force, `y = b^T q'`, as its output.

    Parameters
    ----------
    M : array_like, shape (n, n)
        Mass matrix, symmetric positive definite.
    K : array_like, shape (n, n)
        Stiffness matrix, symmetric positive semidefinite; its kernel makes rigid-body modes.
    b : array_like, shape (n,) or (n, m)
        Where the forces act, one column for each port.
    condense : bool
        Eliminate massless degrees of freedom (zero rows of `M`), on which no force may act.  They follow the others
        without delay, so nothing is lost: `K` is replaced by its Schur complement.
    **names
        `name`, `inputs`, `outputs`, `states` as for `control.ss`; by default as for `spring_chain`, `q_i, p_i` with
        the numbers, from 1, of the degrees of freedom that have mass.

    Returns
    -------
    PortHamiltonian
        From force to velocity.  States: displacements and momenta `p = M q'`.

    Raises
    ------
    StructureError
        If a matrix is not square, symmetric and of the size of the others, `K` is indefinite, or `M` is singular and
        cannot be, or is not to be, condensed: the message names the massless degrees of freedom.

    Notes
    -----
    `Q = diag(K, M^{-1})`, `B = (0, b)`, `M^{-1}` by Cholesky after scaling to unit diagonal.  The natural frequencies
    are those of `scipy.linalg.eigh(K, M)` to about `eps cond(M)`.  All is dense: O(n^3).

    Examples
    --------
    >>> import ph_control as phc
    >>> phc.from_second_order([[1, 0], [0, 1]], [[5, -4], [-4, 5]], [1, 0]).d
    array([1., 3.])
    >>> floating = phc.from_second_order([[1, 0], [0, 3]], [[1, -1], [-1, 1]], [1, 0])
    >>> round(floating.modes.kappa_0, 12)  # as one rigid body: 1 / (1 + 3)
    0.25
    """
    _checks.flags(condense=condense)
    mass, stiffness = _square("M", M), _square("K", K)
    if mass.shape != stiffness.shape:
        raise StructureError(f"M has shape {mass.shape} and K {stiffness.shape}; they must be the same")
    force = _forces(b, len(mass))
    kept = np.diag(mass) > 0
    if not kept.all():
        stiffness, force = _condensed(stiffness, force, kept, condense)
        mass = mass[np.ix_(kept, kept)]
    n, ports = force.shape
    Q, B = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, ports))
    Q[:n, :n], Q[n:, n:], B[n:] = stiffness, _inverse_mass(mass), force
    inputs, outputs = (["F"], ["v"]) if ports == 1 else (_numbered("F", ports), _numbered("v", ports))
    states = [f"{letter}_{k + 1}" for letter in "qp" for k in np.flatnonzero(kept)]
    return ph(Q, B, **_named(names, inputs, outputs, states))


def _square(name: str, value: ArrayLike) -> Array:
    """Check a mass or stiffness matrix: square, symmetric, positive semidefinite."""
    array = _checks.real_array(name, value, 2)
    n = len(array)
    if array.shape != (n, n) or n == 0:
        raise StructureError(f"{name} has shape {array.shape}; it must be (n, n) with at least one degree of freedom")
    padded = np.zeros((2 * n, 2 * n))
    padded[:n, :n] = array
    checked = _definite.hamiltonian_matrix(padded, name=name)[:n, :n]
    return _symmetric(checked)


def _symmetric(A: Array) -> Array:
    return 0.5 * (A + A.T)


def _forces(b: ArrayLike, n: int) -> Array:
    array = _checks.real_array("b", b)
    if array.ndim not in (1, 2) or array.shape[0] != n or array.size == 0:
        raise StructureError(
            f"b has shape {array.shape}; with {n} degrees of freedom it must be ({n},) or ({n}, ports)"
        )
    return array.reshape(n, -1)


def _condensed(K: Array, b: Array, kept: NDArray[np.bool_], condense: bool) -> tuple[Array, Array]:
    """Stiffness and forces on the degrees of freedom that have mass."""
    massless = ~kept
    where = _listed(np.flatnonzero(massless))
    if not condense:
        raise StructureError(
            f"M is singular: {massless.sum()} of {len(K)} degrees of freedom have no mass ({where}, counted from 1); "
            "from_second_order(M, K, b, condense=True) eliminates them statically, or give them mass"
        )
    if not kept.any():
        raise StructureError("M is zero: no degree of freedom has mass, so nothing would be left")
    loaded = np.flatnonzero(massless & np.any(b != 0, axis=1))
    if len(loaded):
        raise StructureError(
            f"a force acts on degrees of freedom without mass ({_listed(loaded)}, counted from 1), which would make "
            "their velocity depend on the rate of the force; move the force, or give them mass"
        )
    inner = K[np.ix_(massless, massless)]
    smallest, tolerance = _definite.smallest_scaled_eigenvalue(inner)
    if smallest <= tolerance:
        raise StructureError(
            f"the degrees of freedom without mass ({where}, counted from 1) cannot be eliminated: the smallest "
            f"eigenvalue of their stiffness, scaled to unit diagonal, is {smallest:.3g}, needed > {tolerance:.1e}; one "
            "of their motions meets no spring"
        )
    W = _solve_root(inner, K[np.ix_(massless, kept)])
    return _symmetric(K[np.ix_(kept, kept)] - W.T @ W), b[kept]


def _inverse_mass(M: Array) -> Array:
    """Inverse of a mass matrix, exactly symmetric."""
    smallest, tolerance = _definite.smallest_scaled_eigenvalue(M)
    if smallest <= tolerance:
        raise StructureError(
            f"M is singular: its smallest eigenvalue after scaling to unit diagonal is {smallest:.3g}, needed > "
            f"{tolerance:.1e}; a combination of degrees of freedom moves without kinetic energy; choose coordinates in "
            "which it is one of them, or give it mass"
        )
    root = _solve_root(M, np.eye(len(M)))
    return _symmetric(root.T @ root)


def _solve_root(A: Array, right: Array) -> Array:
    """`X` with `X^T X = right^T A^{-1} right` for a positive definite `A`."""
    scaled, scale = _definite.unit_diagonal(A)
    return solve_triangular(np.linalg.cholesky(scaled), right / scale[:, None], lower=True)


def _listed(indices: NDArray[np.intp]) -> str:
    shown = ", ".join(str(k + 1) for k in indices[:8])
    return shown + (f" .. {indices[-1] + 1}" if len(indices) > 8 else "")


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
    with np.errstate(over="ignore"):
        _checks.representable(f"the reciprocals of {name}", 1.0 / array)
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
    several = isinstance(port, Sequence) or (isinstance(port, np.ndarray) and port.ndim)
    ports = list(port) if several and not isinstance(port, str | bytes) else [port]
    if not ports:
        raise StructureError("port is empty; name at least one mass")
    for index in ports:
        if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < n:
            raise StructureError(f"port is {_checks.shown(port)}; masses are counted from 0 to {n - 1}")
    return [int(index) for index in ports]


def _numbered(letter: str, count: int) -> list[str]:
    return [f"{letter}_{k}" for k in range(1, count + 1)]


def _named(names: dict[str, Any], inputs: list[str], outputs: list[str], states: list[str]) -> dict[str, Any]:
    """The user's names, and these where the user gave none; python-control takes `input` as well as `inputs`."""
    defaults = {"inputs": inputs, "outputs": outputs, "states": states}
    return names | {key: value for key, value in defaults.items() if names.get(key, names.get(key[:-1])) is None}

"""Dampers and tuned mass dampers whose constants minimise the response of a plant, or damp its modes best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import control as ct
import numpy as np
from numpy.typing import DTypeLike
from scipy.linalg import eig, solve_continuous_lyapunov
from scipy.optimize import minimize

from .. import _checks
from .._checks import EPS
from .._frozen import Frozen
from .._types import Array, ArrayLike
from .._units import rate
from ..exceptions import StructureError
from ..reduction.modal_truncation import energy_basis, sees
from ..systems.dissipative import parts_of
from ..systems.interconnection import interconnect, through_ports
from ..systems.port_hamiltonian import PortHamiltonian, ph
from .damping_injection import plant, port_numbers

Criteria = Literal["h2", "damping", "fixed points"]
Performance = Literal["energy", "displacement", "velocity"]
_REACH = 1e4  # constants are looked for within this factor of those to start from
_AT_BORDER = 0.99  # of that reach, in logarithms: where no optimum was found
_FLAT = 1e-8  # relative difference of costs that is rounding
_EDGE = 1e-9  # of the largest pole: damping of the plant with dampers that are as good as none
_TUNED = 3  # modes that an absorber is tuned to, to begin with


@dataclass(frozen=True, eq=False)
class OptimalDamping(Frozen):
    """Dampers or tuned mass dampers found by `optimal_damping`, and the closed loop.

    Attributes
    ----------
    plant, controller, system : PortHamiltonian
        The plant, what is joined to its ports, and both together.
    ports : tuple of str
        Inputs of the plant where the devices are, one for each.
    gains : ndarray, shape (k,)
        Damping constants, such as N s/m.
    stiffnesses, masses : ndarray, shape (k,), or None
        Of tuned mass dampers; None of dashpots.
    criterion : str
        What was optimised.
    cost, cost_before : float
        H2 norm with and without the devices, infinite where a mode of the plant has no damping; of the criterion
        'damping' the smallest damping ratio.

    Examples
    --------
    >>> import ph_control as phc
    >>> best = phc.optimal_damping(phc.spring_chain([1.0], ground=1.0))
    >>> best.gains.shape, best.stiffnesses, best.cost < best.cost_before
    ((1,), None, True)
    """

    plant: PortHamiltonian
    controller: PortHamiltonian
    system: PortHamiltonian
    ports: tuple[str, ...]
    gains: Array
    stiffnesses: Array | None
    masses: Array | None
    criterion: str
    cost: float
    cost_before: float

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Array:
        return np.array(self.gains, dtype=dtype)

    @property
    def tuned_frequencies(self) -> Array | None:
        """Natural frequencies of tuned mass dampers on a fixed base, rad per unit time; None of dashpots."""
        return None if self.masses is None or self.stiffnesses is None else np.sqrt(self.stiffnesses / self.masses)

    @property
    def tuned_damping_ratios(self) -> Array | None:
        """Damping ratios of tuned mass dampers on a fixed base; None of dashpots."""
        if self.masses is None or self.stiffnesses is None:
            return None
        return self.gains / (2 * np.sqrt(self.stiffnesses * self.masses))

    def plot(self, **kwargs: Any) -> ct.ControlPlot:
        """Picture of the damping of all modes over the gain, see `damping_plot`.

        Parameters
        ----------
        **kwargs
            Keywords of `damping_plot`.

        Returns
        -------
        control.ControlPlot

        Examples
        --------
        See `damping_plot`.
        """
        from ..plotting.damping_plot import damping_plot

        return damping_plot(self.plant, self.controller, ports=self.ports, **kwargs)

    def __str__(self) -> str:
        """Table of the devices, and what they bring."""
        count = len(self.gains)
        kind = ("dashpot" if self.masses is None else "tuned mass damper") + "s" * (count != 1)
        cost = "smallest damping ratio" if self.criterion == "damping" else "H2 norm"
        rows = [f"{count} {kind}, criterion {self.criterion}: {cost} {self.cost:.6g}, before {self.cost_before:.6g}"]
        rows += [f"  {port:12s} damping {gain:.6g}" for port, gain in zip(self.ports, self.gains, strict=True)]
        frequencies, ratios = self.tuned_frequencies, self.tuned_damping_ratios
        if self.masses is not None and self.stiffnesses is not None and frequencies is not None and ratios is not None:
            table = zip(self.masses, self.stiffnesses, frequencies, 100 * ratios, strict=True)
            for k, (m, stiffness, frequency, percent) in enumerate(table, 1):
                rows[k] += (
                    f"   mass {m:.6g}   stiffness {stiffness:.6g}   on a fixed base {frequency:.6g} "
                    f"{rate(self.plant.time_unit)} and {percent:.4g} %"
                )
        return "\n".join(rows)


def optimal_damping(
    sys: PortHamiltonian,
    ports: Sequence[int | str] | None = None,
    *,
    mass: ArrayLike | None = None,
    criterion: Criteria = "h2",
    outputs: Performance | Sequence[int | str] = "energy",
    inputs: Sequence[int | str] | None = None,
    mode: int | None = None,
) -> OptimalDamping:
    r"""Best constants of dashpots, or of tuned mass dampers, at ports of a plant.

    Parameters
    ----------
    sys : PortHamiltonian
        The plant, such as a structure with forces as inputs and velocities as outputs.
    ports : sequence of int or str, optional
        Where the devices are, one for each: numbers of ports, or names of their inputs.  Default: a device at each.
    mass : float or array_like, shape (k,), optional
        Masses of tuned mass dampers, each on a spring and a dashpot.  Default: dashpots to the ground.
    criterion : {'h2', 'damping', 'fixed points'}
        'h2' minimises the H2 norm from `inputs` to `outputs`, the root mean square of the response to white noise;
        'damping' maximises the smallest damping ratio, and the slowest decay where all poles are real; 'fixed points'
        gives the closed form of den Hartog for one mode, a first choice where the force is a sine of any frequency
        (tuned mass dampers only).
    outputs : {'energy', 'displacement', 'velocity'} or sequence of int or str
        For 'h2': the stored energy of the plant (the H2 norm is then `sqrt(2 E)` of its mean `E`), the outputs of all
        ports or their integrals, or outputs of the plant by number or name.
    inputs : sequence of int or str, optional
        For 'h2': ports at which the noise acts.  Default: all; for the stored energy none, the cost is then that of all
        initial states of one energy alike, `sqrt(tr X)` with `A X + X A^T + I = 0`.
    mode : int, optional
        Number of the mode, from 0 by frequency, that tuned mass dampers start from.  Default: several are tried; for
        'fixed points' the one that gives most of the displacement at the port.

    Returns
    -------
    OptimalDamping
        The constants, the closed loop, and the cost; it can be used as an array of damping constants.

    Raises
    ------
    StructureError
        If a port has feedthrough; if a mode is not damped by any device, or the cost falls with the gain without end,
        as that of a single mass with a dashpot.

    Notes
    -----
    With `A(theta) = A - sum_j theta_j b_j c_j^T`, `A X + X A^T + B B^T = 0` and `A^T Y + Y A + C^T C = 0`, the square
    of the H2 norm is `tr(C X C^T)` and its derivatives are `-2 c_j^T X Y b_j`.  The optimum is local, found by a
    quasi-Newton method from several starts; O(n^3) an iteration.

    Examples
    --------
    A tuned mass damper of 5 % of the mass, for white noise: the closed form of Warburton.

    >>> import ph_control as phc
    >>> tuned = phc.optimal_damping(phc.spring_chain([1.0], ground=1.0), mass=0.05, outputs="displacement")
    >>> print(f"{tuned.tuned_frequencies[0]:.7f} {tuned.tuned_damping_ratios[0]:.7f}")
    0.9642122 0.1097722
    """
    plant(sys)
    _checks.choice("criterion", criterion, get_args(Criteria))
    port_indices = port_numbers(sys, ports, repeated=mass is not None)
    masses = None if mass is None else _masses(mass, len(port_indices))
    loop = _Loop.of(sys, port_indices, masses, outputs, inputs)
    if criterion == "fixed points":
        if masses is None:
            raise StructureError("the fixed points are those of tuned mass dampers; give their mass")
        theta = _tuned(loop, port_indices, masses, _dominant(loop, mode)[0], _fixed_points)
    else:
        starts = _starts(loop, sys, port_indices, masses, mode)
        theta = _best(loop, starts, loop.h2 if criterion == "h2" else loop.damping)
    return _result(sys, port_indices, masses, theta, criterion, loop)


# --- the loop as a function of its constants -------------------------------------------------------------------------


@dataclass(frozen=True)
class _Loop:
    """Closed loop `x' = (A - sum_j theta_j b_j c_j^T) x + B w`, `z = C x`, in coordinates of unit energy."""

    A: Array
    b: Array
    c: Array
    B: Array
    C: Array
    own: int  # states of the plant, which come first

    @classmethod
    def of(
        cls, sys: PortHamiltonian, ports: list[int], masses: Array | None, outputs: str | Sequence[int | str],
        inputs: Sequence[int | str] | None,
    ) -> _Loop:  # fmt: skip
        """Loop of a plant with devices whose constants are still 0."""
        A, B, Cy, sensors = energy_coordinates(sys, ports)
        C = _performance(sys, A, Cy, sensors, outputs)
        every = inputs is None and isinstance(outputs, str) and outputs == "energy"
        noise = np.eye(len(A)) if every else B[:, port_numbers(sys, inputs)]
        n, k = len(A), len(ports)
        if masses is None:
            return cls(A, B[:, ports], Cy[ports].T, noise, C, n)
        # displacement and velocity of each absorber, relative and absolute, beside the plant
        whole = np.zeros((n + 2 * k, n + 2 * k))
        whole[:n, :n] = A
        b, c = np.zeros((n + 2 * k, 2 * k)), np.zeros((n + 2 * k, 2 * k))
        for j, port in enumerate(ports):
            stretch, speed = n + 2 * j, n + 2 * j + 1
            whole[stretch, :n], whole[stretch, speed] = Cy[port], -1.0
            for kind in (0, 1):
                b[:n, 2 * j + kind], b[speed, 2 * j + kind] = B[:, port], -1.0 / masses[j]
            c[stretch, 2 * j] = 1.0
            c[:n, 2 * j + 1], c[speed, 2 * j + 1] = Cy[port], -1.0
        pad = ((0, 2 * k), (0, 0))
        return cls(whole, b, c, np.pad(noise, pad), np.pad(C.T, pad).T, n)

    @cached_property
    def _fastest(self) -> float:
        """Size of the largest pole of the plant."""
        return float(np.abs(np.linalg.eigvals(self.A[: self.own, : self.own])).max())

    def matrix(self, theta: Array) -> Array:
        """Dynamics matrix at these constants."""
        return self.A - (self.b * theta) @ self.c.T

    def h2(self, theta: Array) -> tuple[float, Array]:
        """Logarithm of the H2 norm, and its gradient by the logarithms of the constants; infinite if not stable."""
        A = self.matrix(theta)
        if np.linalg.eigvals(A).real.max(initial=-np.inf) >= 0:
            return np.inf, np.zeros(len(theta))
        X = solve_continuous_lyapunov(A, -self.B @ self.B.T)
        square = float(np.trace(self.C @ X @ self.C.T))
        if square <= 0:
            return -np.inf, np.zeros(len(theta))
        Y = solve_continuous_lyapunov(A.T, -self.C.T @ self.C)
        slope = -2 * np.einsum("ij,ij->j", self.c, X @ Y @ self.b)
        return 0.5 * np.log(square), 0.5 * theta * slope / square

    def damping(self, theta: Array) -> tuple[float, Array]:
        """Minus the smallest damping ratio, and its gradient by the logarithms of the constants.

        Where all poles are real, which is ratio 1 for any larger gain, that less the slowest decay.
        """
        p, left_vectors, right_vectors = eig(self.matrix(theta), left=True, right=True)
        size = np.maximum(np.abs(p), np.finfo(float).tiny)
        zeta = np.where(np.abs(p) > _EDGE * np.abs(p).max(), -p.real / size, np.inf)
        saturated = zeta.min() >= 1 - len(p) * EPS
        l = int(np.argmin(np.where(zeta < np.inf, -p.real, np.inf) if saturated else zeta))
        w, v = left_vectors[:, l].conj(), right_vectors[:, l]
        slope = -((w @ self.b) * (self.c.T @ v)) / (w @ v)
        if saturated:
            return -1.0 + float(p[l].real) / self._fastest, theta * slope.real / self._fastest
        change = -slope.real / size[l] + p[l].real * (np.conj(p[l]) * slope).real / size[l] ** 3
        return -float(zeta[l]), -theta * change


def refuse_feedthrough(sys: PortHamiltonian, ports: Sequence[int]) -> None:
    """Refuse ports with feedthrough, beside which a gain is another one."""
    part = parts_of(sys)
    through = part["S"] + part["N"]
    for port in ports:
        if through[port].any() or through[:, port].any():
            raise StructureError(
                f"port {sys.input_labels[port]!r} has feedthrough; devices are chosen for ports without any, such as a "
                "velocity at a mass"
            )


def energy_coordinates(sys: PortHamiltonian, ports: Sequence[int]) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """`A, B, C` of the ports and the rows of the sensors, for states `x` of the energy `|x|^2 / 2`.

    Raises
    ------
    StructureError
        If one of the ports has feedthrough, beside which a gain is another one.
    """
    refuse_feedthrough(sys, ports)
    part = parts_of(sys)
    T, back, still = energy_basis(part["Q"])
    rows, through = part["sensor_rows"], part["sensor_feedthrough"]
    unseen = sees(rows, still, part["Q"])
    seen = np.where(unseen[:, None], np.nan, rows @ back)
    C = (part["G"] + part["P"]).T @ T.T
    return T @ (part["J"] - part["R"]) @ T.T, T @ (part["G"] - part["P"]), C, (seen, through)


def _performance(
    sys: PortHamiltonian, A: Array, C: Array, sensors: tuple[Array, Array], outputs: str | Sequence[int | str]
) -> Array:
    """Rows of what is kept small."""
    if isinstance(outputs, str):
        _checks.choice("outputs", outputs, get_args(Performance))
        if outputs == "energy":
            return np.eye(len(A))
        if outputs == "velocity":
            return C
        if not np.linalg.cond(A) < 1e12:
            raise StructureError("the plant has a rigid mode, whose displacement has no mean; use outputs='velocity'")
        return np.linalg.solve(A.T, C.T).T
    rows = np.vstack([C, sensors[0]])
    if not isinstance(outputs, Sequence | np.ndarray) or getattr(outputs, "shape", None) == ():
        raise StructureError(
            f"outputs is {_checks.shown(outputs)}; pass 'energy', 'displacement', 'velocity', or a list of outputs of "
            "the plant by number or name"
        )
    numbers = [_checks.signal_number("output", output, sys.output_labels) for output in outputs]
    for k in numbers:
        through = sys.D[k]
        if through.any() or np.isnan(rows[k]).any():
            why = "has feedthrough, so that white noise makes it infinite" if through.any() else "sees a rigid mode"
            raise StructureError(f"output {sys.output_labels[k]!r} {why}; take another one, or outputs='energy'")
    return rows[numbers]


# --- where to start --------------------------------------------------------------------------------------------------


def _masses(mass: ArrayLike, k: int) -> Array:
    masses = _checks.real_array("the mass", mass)
    if masses.shape not in ((), (k,)):
        raise StructureError(f"the mass has shape {masses.shape}; give a number, or one for each of {k} devices")
    if not np.all(masses > 0):
        raise StructureError(f"a mass is {float(masses.min()):.4g}; masses of tuned mass dampers are positive")
    return np.array(np.broadcast_to(masses, k))


def _modal_weights(loop: _Loop) -> tuple[Array, Array]:
    """Natural frequencies that are not 0, ascending, and inverse modal masses at the port of each device."""
    n, devices = loop.own, slice(None) if loop.own == len(loop.A) else slice(1, None, 2)
    p, left_vectors, right_vectors = eig(loop.A[:n, :n], left=True, right=True)
    residues = (right_vectors.T @ loop.c[:n, devices]) * (left_vectors.conj().T @ loop.b[:n, devices])
    residues /= np.einsum("ij,ij->j", left_vectors.conj(), right_vectors)[:, None]
    order = np.argsort(np.abs(p))
    order = order[p.imag[order] > _EDGE * np.abs(p).max(initial=0.0)]
    p, residues = p[order], residues[order]
    return np.abs(p), np.maximum((2j * p.imag[:, None] * residues / p[:, None]).real, 0.0)


def _dominant(loop: _Loop, mode: int | None) -> list[int]:
    """Modes by their share of the displacements at the ports, or the one that is asked for."""
    d, weights = _modal_weights(loop)
    if not len(d):
        raise StructureError("the plant has no mode that oscillates; there is nothing to damp")
    if mode is not None:
        return [_checks.whole_number("mode", mode, 0, len(d) - 1)]
    return [int(k) for k in np.argsort(-(weights.sum(axis=1) / d**2))[:_TUNED]]


def _warburton(mu: float) -> tuple[float, float]:
    return np.sqrt(1 + mu / 2) / (1 + mu), np.sqrt(mu * (1 + 3 * mu / 4) / ((1 + mu) * (1 + mu / 2))) / 2


def _fixed_points(mu: float) -> tuple[float, float]:
    return 1 / (1 + mu), np.sqrt(3 * mu / (8 * (1 + mu)))


def _tuned(
    loop: _Loop, ports: list[int], masses: Array, mode: int, rule: Callable[[float], tuple[float, float]]
) -> Array:
    """Stiffness and damping constant of each absorber, tuned to a mode by its modal mass at the port."""
    d, weights = _modal_weights(loop)
    theta = np.empty(2 * len(ports))
    for j, port in enumerate(ports):
        ratio, zeta = rule(float(masses[j] * weights[mode, j]))
        # absorbers at one port begin beside each other
        twins = [k for k, other in enumerate(ports) if other == port]
        frequency = d[mode] * ratio * 1.05 ** (twins.index(j) - 0.5 * (len(twins) - 1))
        theta[2 * j : 2 * j + 2] = masses[j] * frequency**2, 2 * zeta * masses[j] * frequency
    return theta


def _starts(loop: _Loop, sys: PortHamiltonian, ports: list[int], masses: Array | None, mode: int | None) -> list[Array]:
    if masses is not None:
        return [_tuned(loop, ports, masses, dominant, _warburton) for dominant in _dominant(loop, mode)]
    d, weights = _modal_weights(loop)
    reached = weights > 1e-12 * weights.max(initial=0.0)
    # the impedance of a mode at its port, with which a dashpot damps it by half
    impedance = np.where(reached, d[:, None] / np.where(reached, weights, 1.0), np.nan)
    if np.isnan(impedance).all(axis=0).any():
        dead = int(np.flatnonzero(np.isnan(impedance).all(axis=0))[0])
        raise StructureError(f"port {sys.input_labels[ports[dead]]!r} reaches no mode that oscillates")
    low, high = np.nanmin(impedance, axis=0), np.nanmax(impedance, axis=0)
    return [low ** (1 - t) * high**t * factor for t in (0.0, 0.5, 1.0) for factor in (0.1, 1.0)]


# --- the search ------------------------------------------------------------------------------------------------------


def _best(loop: _Loop, starts: list[Array], cost: Callable[[Array], tuple[float, Array]]) -> Array:
    """Constants of the least cost that is reached from any start."""
    _refuse_undamped(loop, starts[0])
    optima = []
    for start in starts:
        reach = [(-np.log(_REACH), np.log(_REACH))] * len(start)

        def shifted(x: Array, start: Array = start) -> tuple[float, Array]:
            value, slope = cost(start * np.exp(x))
            return (value, slope) if np.isfinite(value) else (1e3, slope)

        solution = minimize(shifted, np.zeros(len(start)), jac=True, method="L-BFGS-B", bounds=reach,
                            options={"ftol": 1e-16, "gtol": 1e-11, "maxiter": 1000})  # fmt: skip
        if cost == loop.damping:  # two poles meet at the optimum, where there is no gradient
            solution = minimize(lambda x: shifted(x)[0], solution.x, method="Nelder-Mead",
                                options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 400 * len(start)})  # fmt: skip
        optima.append((float(solution.fun), np.abs(solution.x).max(), start * np.exp(solution.x)))
    least, reached, theta = min(optima, key=lambda optimum: optimum[0])
    if reached > _AT_BORDER * np.log(_REACH):
        # where a mode that no device reaches sets the cost it is flat, and rounding alone improves it out there
        within = [optimum for optimum in optima if optimum[1] <= _AT_BORDER * np.log(_REACH)]
        flat = [optimum for optimum in within if optimum[0] <= least + _FLAT * abs(least)]
        if flat:
            return min(flat, key=lambda optimum: optimum[1])[2]
        raise StructureError(
            f"no optimum: the criterion still improves with constants {_REACH:.0e} times those to start from; another "
            "choice of ports, outputs or criterion has one, or set the gain by damping_injection"
        )
    return theta


def _refuse_undamped(loop: _Loop, theta: Array) -> None:
    p = np.linalg.eigvals(loop.matrix(theta))
    still = p.real > -_EDGE * 1e-3 * np.abs(p).max()
    if still.any():
        w = float(np.abs(p[np.flatnonzero(still)[0]]))
        which = f"the mode at {w:.6g} rad/time" if w > _EDGE * np.abs(p).max() else "a rigid mode"
        raise StructureError(
            f"{which} cannot be damped by any device: no port moves in it, or a tuned mass damper moves with it; "
            "add a port that moves, or a dashpot"
        )


def _result(
    sys: PortHamiltonian, ports: list[int], masses: Array | None, theta: Array, criterion: str, loop: _Loop
) -> OptimalDamping:
    if masses is None:
        gains, stiffnesses = theta, None
        controller = ph(np.zeros((0, 0)), np.zeros((0, len(gains))), S=np.diag(gains))
    else:
        stiffnesses, gains = theta[::2], theta[1::2]
        each = [_absorber(*constants) for constants in zip(masses, stiffnesses, gains, strict=True)]
        controller = each[0] if len(each) == 1 else interconnect(each, np.zeros((len(each),) * 2))
    cost = min(1.0, -loop.damping(theta)[0]) if criterion == "damping" else float(np.exp(loop.h2(theta)[0]))
    before = np.linalg.eigvals(loop.A[: loop.own, : loop.own])
    bare = _Loop(loop.A[: loop.own, : loop.own], loop.b[: loop.own, :0], loop.c[: loop.own, :0], loop.B[: loop.own],
                 loop.C[:, : loop.own], loop.own)  # fmt: skip
    if criterion == "damping":
        without = min(1.0, -bare.damping(np.empty(0))[0])
    elif before.real.max(initial=-1.0) > -1e-13 * np.abs(before).max(initial=0.0):
        without = np.inf
    else:
        without = float(np.exp(bare.h2(np.empty(0))[0]))
    return OptimalDamping(
        sys, controller, through_ports(sys, controller, ports), tuple(sys.input_labels[k] for k in ports), gains,
        stiffnesses, masses, criterion, cost, without,
    )  # fmt: skip


def _absorber(m: float, k: float, c: float) -> PortHamiltonian:
    """Mass on a spring and a dashpot, from the velocity of its base to the force on it."""
    return ph(
        np.diag([k, 1 / m]), [-1.0, 0.0], R=np.diag([0.0, c]), P=[[0.0], [-c]], S=[[c]], inputs=["base velocity"],
        outputs=["base force"], states=["q", "p"],
    )  # fmt: skip

"""What the package does with a system, beside what others do with the same one: the tasks of the report.

A task builds its data once and gives one function for each contender, ours first, and a reference that none of them
computes.  Everything is seeded.
"""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import control as ct
import mpmath as mp
import numpy as np
import scipy.linalg
import scipy.signal

import ph_control as phc

from .cold import imported, measure

OURS = "ph_control"


@dataclass
class Task:
    """One row of the report.

    `runs` maps a contender to a call without arguments; `error` takes its result to an error against the reference,
    where there is one; `needed` maps a contender to the ratio that ours must reach, `limits` maps "seconds",
    "megabytes" (peak memory) or "error" to what ours must not pass.  The calls of a task `apart` measure processes of
    their own, and give seconds and peak bytes.
    """

    name: str
    size: str
    runs: dict[str, Callable[[], Any]]
    error: Callable[[Any], float] | None = None
    needed: dict[str, float] = field(default_factory=dict)
    growth: float = 0.0  # what the time is drawn against
    limits: dict[str, float] = field(default_factory=dict)
    apart: bool = False


def dense_hamiltonian(n: int, condition: float = 100.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A full positive definite matrix with eigenvalues spread evenly on a logarithmic axis, and an input vector."""
    rng = np.random.default_rng(seed)
    X, _ = np.linalg.qr(rng.standard_normal((2 * n, 2 * n)))
    Q = (X * np.logspace(0, np.log10(condition), 2 * n)) @ X.T
    return 0.5 * (Q + Q.T), rng.standard_normal(2 * n)


def matrices(Q: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices `J Q`, `B`, `B^T Q`, 0 of the plain state-space system."""
    n = len(Q) // 2
    return np.concatenate([Q[n:], -Q[:n]]), B[:, None], (B @ Q)[None], np.zeros((1, 1))


def modal_plant(n: int, low: float = 0.5, high: float = 50.0, seed: int = 0) -> phc.PortHamiltonian:
    rng = np.random.default_rng(seed)
    return phc.ph(phc.modes(np.sort(rng.uniform(low, high, n)), rng.uniform(0.1, 1.0, n)))


def plain(system: phc.PortHamiltonian) -> ct.StateSpace:
    """The same system without its structure."""
    return ct.StateSpace(*(np.array(M) for M in (system.A, system.B, system.C, system.D)))


# --- references -------------------------------------------------------------------------------------------------


def exact_response(d: np.ndarray, r: np.ndarray, w: np.ndarray) -> np.ndarray:
    """`G(i w) / i` of the modes as given, with 40 digits."""
    with mp.workdps(40):
        pairs = [(mp.mpf(float(a)), mp.mpf(float(b))) for a, b in zip(d, r, strict=True)]
        return np.array([float(sum(a * b * x / ((a - x) * (a + x)) for a, b in pairs)) for x in map(mp.mpf, w)])


def exact_dense_response(Q: np.ndarray, B: np.ndarray, w: np.ndarray) -> np.ndarray:
    """`G(i w) / i` of matrices as given: `B^T Q (i w - J Q)^-1 B`, solutions refined with residuals in long doubles."""
    A, port, _, _ = matrices(Q, B)
    wide, b = A.astype(np.longdouble), port[:, 0].astype(np.longdouble)
    c, values = Q.astype(np.longdouble) @ b, []
    for x in w:
        factors, z = scipy.linalg.lu_factor(1j * x * np.eye(len(A)) - A), np.zeros(len(A), np.clongdouble)
        for _ in range(5):
            residual = (b + wide @ z.real + x * z.imag) + 1j * (wide @ z.imag - x * z.real)
            z = z + scipy.linalg.lu_solve(factors, residual.astype(complex))
        values.append(float((c @ z).imag))
    return np.array(values)


def exact_outputs(d: np.ndarray, r: np.ndarray, h: float, u: np.ndarray, intersample: str) -> np.ndarray:
    """Outputs from rest under a held or interpolated input, by a recursion in long doubles."""
    d, kappa = d.astype(np.longdouble), (d * r).astype(np.longdouble)
    z = -1j * (d * np.longdouble(h))
    turn = np.exp(z)
    whole, late = (turn - 1) / z * h * kappa, (turn - 1 - z) / z**2 * h * kappa
    now, then = (whole, 0 * whole) if intersample == "zoh" else (whole - late, late)
    x, y = np.zeros(len(d), np.clongdouble), np.empty(len(u))
    for k in range(len(u)):
        y[k] = float(x.real.sum())
        x = turn * x + now * u[k] + then * u[min(k + 1, len(u) - 1)]
    return y


def exact_coefficients(d: np.ndarray) -> list[mp.mpf]:
    """Coefficients of `prod (x + d^2)`, ascending, with 60 digits."""
    with mp.workdps(60):
        P = [mp.mpf(1)]
        for x in (mp.mpf(float(v)) ** 2 for v in d):
            P = [x * a + b for a, b in zip([*P, mp.mpf(0)], [mp.mpf(0), *P], strict=True)]
        return P


def relative(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest error relative to each entry."""
    return float(np.max(np.abs(np.asarray(found) - truth) / np.abs(truth)))


# --- tasks ------------------------------------------------------------------------------------------------------


def frequency_response(n: int, points: int = 1000) -> Task:
    """A system that has been looked at before, at 1000 frequencies across its band and beyond."""
    system = modal_plant(n)
    w = np.linspace(0.1, 60.0, points)
    other, s = plain(system), 1j * w
    few = slice(None, None, max(1, points // 100))
    truth = exact_response(system.d, system.r, w[few])
    runs = {OURS: lambda: system(s), "python-control": lambda: other(s)}
    if n <= 100:
        runs["scipy.signal"] = lambda: scipy.signal.freqresp((other.A, other.B, other.C, other.D), w)[1]
        pymor = _pymor(other) if points == 1000 and n <= 50 else None
        if pymor is not None:
            runs["pyMOR"] = lambda: pymor.transfer_function.freq_resp(w)
    needed = {"python-control": 300.0 if n >= 200 else 25.0} if points == 1000 else {}

    def error(values: np.ndarray) -> float:
        values = np.ravel(values)
        return relative(values[few].imag, truth)

    name = "frequency response, warm" if points == 1000 else "frequency response, N frequencies"
    growth = points if points != 1000 else n
    return Task(name, f"n = {n}, N = {points}", runs, error, needed, growth, {"error": 1e-13})


def cold_frequency_response(n: int) -> Task:
    """From a dense `Q` to 1000 values."""
    Q, B = dense_hamiltonian(n)
    A, B_, C, D = matrices(Q, B)
    w = np.linspace(0.1, 110.0, 1000)
    runs = {OURS: lambda: phc.ph(Q, B)(1j * w), "python-control": lambda: ct.ss(A, B_, C, D)(1j * w)}
    few = slice(5, 500, 50)
    truth = exact_dense_response(Q, B, w[few])

    def error(values: np.ndarray) -> float:
        """Median of relative errors in the band: beside a resonance the rounding of `d` alone moves a value by more."""
        return float(np.median(np.abs(np.ravel(values)[few].imag / truth - 1)))

    return Task("frequency response, from dense Q", f"n = {n}", runs, error, {"python-control": 9.0}, n)


def simulation(n: int, samples: int, intersample: str = "zoh", *, dense: bool = False, peers: bool = True) -> Task:
    """White input from rest, the modes being known; python-control interpolates its input whatever one asks.

    The reference has the modes that the system knows: its error is that of the simulation, not that of finding them.
    """
    system = phc.ph(*dense_hamiltonian(n)) if dense else modal_plant(n)
    modes = system.modes
    h, u = 0.02, np.random.default_rng(1).standard_normal(samples)
    t, other = h * np.arange(samples), plain(system)
    runs = {OURS: lambda: phc.forced_response(system, t, u, intersample=intersample).outputs}
    if peers:
        runs["python-control"] = lambda: ct.forced_response(other, t, u).outputs
    needed = {"python-control": 600.0 if n >= 500 else 250.0 if samples >= 100_000 else 60.0}
    if samples not in (10_000, 100_000):
        needed = {}
    truth = exact_outputs(modes.d, modes.r, h, u, intersample)

    def error(y: np.ndarray) -> float:
        found = float(np.abs(np.asarray(y) - truth).max() / np.abs(truth).max())
        # a held input is another task than the interpolated one of python-control
        return found if found < 1e-3 else np.nan

    kind = f"simulation of dense Q, {intersample}" if dense else f"simulation, {intersample}"
    return Task(kind, f"n = {n}, T = {samples}", runs, error, needed, samples)


def simulation_of_dense(n: int, samples: int) -> Task:
    return simulation(n, samples, "foh", dense=True)


def million_samples() -> Task:
    rng = np.random.default_rng(0)
    u, t = rng.standard_normal(10**6), np.arange(10.0**6)
    system = phc.ph(phc.modes(np.sort(rng.uniform(0.1, 2.8, 50)), rng.uniform(0.1, 1.0, 50)))
    runs = {
        OURS: lambda: phc.forced_response(system, t, u, intersample="zoh").outputs,
        "one biquad, lfilter": lambda: scipy.signal.lfilter([0.0, 0.1, 0.2], [1.0, -1.2, 0.99], u),
    }
    return Task("a million samples", "n = 50, T = 1000000", runs, None, {"one biquad, lfilter": 0.2}, 10**6)


def damped_structure(n: int) -> phc.PortHamiltonian:
    """Full stiffness and damping matrices, damping ratios about half a per cent, one port."""
    rng = np.random.default_rng(n)
    X, _ = np.linalg.qr(rng.standard_normal((n, n)))
    d, Y = np.linspace(1.5, 50.0, n) + rng.uniform(-5.0, 5.0, n) / n, rng.standard_normal((n, n))
    C = (0.01 * X * d) @ X.T + 1e-3 * Y @ Y.T
    return phc.from_second_order(np.eye(n), (X * d**2) @ X.T, rng.standard_normal(n), C=C)


def damped_frequency_response(n: int) -> Task:
    """A structure with damping, looked at before, at 1000 frequencies; errors relative to the sum of all modes."""
    system = damped_structure(n)
    w = np.linspace(0.1, 60.0, 1000)
    other, s, modes, few = plain(system), 1j * w, system.modes, slice(5, 1000, 100)
    runs = {OURS: lambda: system(s), "python-control": lambda: other(s)}
    wide, sizes, truth = np.longdouble, [], []
    A = (system.J.astype(wide) - system.R.astype(wide)) @ system.Q.astype(wide)
    b, c = system.G[:, 0].astype(wide), system.G[:, 0].astype(wide) @ system.Q.astype(wide)
    for x in w[few]:
        factors, z = scipy.linalg.lu_factor(1j * x * np.eye(2 * n) - other.A), np.zeros(2 * n, np.clongdouble)
        for _ in range(6):
            z = z + scipy.linalg.lu_solve(factors, (b + A @ z - 1j * x * z).astype(complex))
        truth.append(complex(c @ z))
        apart = np.abs(modes.single.residues[:, 0, 0] / (1j * x - modes.single.poles)).sum()
        sizes.append(apart + abs(modes.evaluate(1j * x) - modes.single.evaluate(1j * x)).item())

    def error(values: np.ndarray) -> float:
        return float(np.max(np.abs(np.ravel(values)[few] - truth) / sizes))

    # modes that are not parted, which are there among many, are known to the rounding of the matrix
    limits = {"error": 1e-12 if modes.clusters else 1e-13}
    return Task("frequency response with damping", f"n = {n}", runs, error, {"python-control": 25.0}, n, limits)


def damped_simulation(n: int, samples: int = 10_000) -> Task:
    """White input from rest, interpolated; the reference is the recursion of the known modes in long doubles."""
    system = damped_structure(n)
    h, u = 0.02, np.random.default_rng(1).standard_normal(samples)
    t, other, modes = h * np.arange(samples), plain(system), system.modes
    runs = {
        OURS: lambda: phc.forced_response(system, t, u).outputs,
        "python-control": lambda: ct.forced_response(other, t, u).outputs,
    }
    if modes.clusters:
        poles, right = np.linalg.eig(system.A)
        rho = (system.C @ right)[0] * np.linalg.solve(right, system.B)[:, 0] * h
    else:
        poles, rho = modes.poles, modes.residues[:, 0, 0] * h
    z = poles.astype(np.clongdouble) * h
    turn = np.exp(z)
    whole, late = (turn - 1) / z * rho, (turn - 1 - z) / z**2 * rho
    x, truth = np.zeros(len(z), np.clongdouble), np.empty(samples)
    for k in range(samples):
        truth[k] = float(x.sum().real)
        x = turn * x + (whole - late) * u[k] + late * u[min(k + 1, samples - 1)]

    def error(y: np.ndarray) -> float:
        return float(np.abs(np.asarray(y) - truth).max() / np.abs(truth).max())

    needed = {"python-control": 60.0} if n >= 20 else {}
    return Task("simulation with damping", f"n = {n}, T = {samples}", runs, error, needed, samples, {"error": 1e-12})


def damped_balance() -> Task:
    """Stored, supplied and dissipated energy along a million midpoint steps: the largest defect of one, of all flow."""
    system, steps = damped_structure(10), 10**6
    t, u = 0.02 * np.arange(steps + 1), np.random.default_rng(1).standard_normal(steps + 1)

    def run() -> float:
        found = phc.energy_balance(phc.forced_response(system, t, u, method="midpoint"), system)
        flow = max(np.abs(part).max() for part in (found.stored, found.supplied, found.dissipated))
        return float(np.abs(np.diff(found.defect)).max() / flow)

    return Task(
        "balance of a million midpoint steps", "n = 10", {OURS: run}, lambda value: value, {}, 0.0, {"error": 1e-14}
    )


def williamson(n: int) -> Task:
    Q, _ = dense_hamiltonian(n, 1e12)
    runs: dict[str, Callable[[], Any]] = {OURS: lambda: phc.williamson(Q)}
    try:
        from thewalrus.decompositions import williamson as theirs
    except ImportError:
        pass
    else:
        runs["thewalrus"] = lambda: theirs(Q)
    J = phc.symplectic_form(n)

    def error(found: tuple[np.ndarray, np.ndarray]) -> float:
        """How far `S` is from symplectic, relative to the square of its size."""
        S = found[1]
        return float(np.abs(S.T @ J @ S - J).max() / max(1.0, np.linalg.norm(S, 2) ** 2))

    return Task("Williamson, cond 1e12", f"n = {n}", runs, error, {"thewalrus": 3.0}, n, {"error": 1e-13})


def mechanical(n: int) -> Task:
    """`diag(K, M^-1)` beside a matrix of the same size that couples positions with momenta."""
    rng = np.random.default_rng(0)
    X, Y = rng.standard_normal((2, n, n))
    K, inverse = X @ X.T + n * np.eye(n), Y @ Y.T / n + np.eye(n)
    Q = np.block([[K, np.zeros((n, n))], [np.zeros((n, n)), inverse]])
    coupled, _ = dense_hamiltonian(n)

    def error(found: tuple[np.ndarray, np.ndarray]) -> float:
        d, S = found
        residual = float(np.abs((S.T * np.concatenate([d, d])) @ S - Q).max() / np.abs(Q).max())
        # the general path has a matrix of its own
        return residual if residual < 1e-3 else np.nan

    runs = {OURS: lambda: phc.williamson(Q), "general path": lambda: phc.williamson(coupled)}
    return Task("mechanical Williamson", f"n = {n}", runs, error, {"general path": 5.0}, n, {"error": 2e-15})


def frequencies_and_weights(n: int) -> Task:
    """What a port shows of a dense matrix; the others have poles, and with mode shapes a modal state space."""
    Q, B = dense_hamiltonian(n)
    other = ct.ss(*matrices(Q, B))

    def ours() -> tuple[np.ndarray, np.ndarray]:
        system = phc.ph(Q, B)
        return system.d, system.r

    runs = {
        OURS: ours,
        "with mode shapes (ours)": lambda: phc.ph(Q, B).modes,
        "ct.poles": other.poles,
        "ct.modal_form": lambda: ct.modal_form(other),
    }
    return Task(
        "frequencies and weights of dense Q", f"n = {n}", runs, None, {"ct.poles": 2.0, "ct.modal_form": 2.0}, n
    )


def coefficients(n: int) -> Task:
    system = modal_plant(n, 0.5, 2.0)
    modes, other = system.modes, plain(system)
    runs = {
        OURS: lambda: modes.coefficients()[0][::2],
        "python-control": lambda: ct.ss2tf(other).den[0][0][:0:-1][::2],
        "scipy.signal": lambda: scipy.signal.ss2tf(other.A, other.B, other.C, other.D)[1][:0:-1][::2],
    }
    truth = np.array([float(a) for a in exact_coefficients(modes.d)[:-1]])
    needed, limits = {"python-control": 10.0}, {"error": 3e-15}
    return Task("coefficients", f"n = {n}", runs, lambda a: relative(a, truth), needed, n, limits)


def zeros(n: int) -> Task:
    """Of a system that is there, as it is asked the first time: what was kept is forgotten before each call."""
    system = modal_plant(n)
    other, modes = plain(system), system.modes

    def first() -> np.ndarray:
        vars(modes).pop("zeros", None)
        return system.zeros()

    runs = {
        OURS: first,
        "from d and r (ours)": lambda: phc.modes(system.d, system.r).zeros,
        "python-control": other.zeros,
    }

    def error(found: np.ndarray) -> float:
        """Distance from the imaginary axis, relative to the largest zero."""
        return float(np.abs(found.real).max() / np.abs(found).max())

    return Task("zeros", f"n = {n}", runs, error, {"python-control": 5.0}, n)


def reducible_modes(n: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Modes of which some have one frequency and some are unreached, and the number of states that count."""
    d = np.linspace(1.0, 2.0, n)
    d[1::5] = d[0::5][: len(d[1::5])]
    nu = np.random.default_rng(0).standard_normal((2, n))
    nu[:, 2::3] = 0.0
    return d, nu, 2 * len(np.unique(d[np.abs(nu).max(axis=0) > 0]))


def reducible(n: int, coupled: bool = False) -> tuple[np.ndarray, np.ndarray, int]:
    """The matrices of such a system, positions among themselves and momenta too, or all with all."""
    d, nu, order = reducible_modes(n)
    rng = np.random.default_rng(1)
    X = np.eye(n) + 0.3 * rng.standard_normal((n, n)) / np.sqrt(n)
    zero = np.zeros((n, n))
    S = np.block([[X, zero], [zero, np.linalg.inv(X).T]])
    if coupled:
        U, _ = np.linalg.qr(rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))
        S = S @ np.block([[U.real, -U.imag], [U.imag, U.real]])
    Q = (S.T * np.concatenate([d, d])) @ S
    return 0.5 * (Q + Q.T), np.linalg.solve(S, nu.ravel()), order


def minimal_of_modes(n: int) -> Task:
    """A system that is known by its modes; others need its matrices, which they are given."""
    d, nu, order = reducible_modes(n)
    known = phc.modes(d, np.sum(nu**2, axis=0))
    other = plain(phc.ph(known))
    runs = {
        OURS: lambda: phc.minreal(known).nstates,
        "Kalman (ours)": lambda: phc.kalman_decomposition(known).reachable.nstates,
        "slycot": lambda: ct.minreal(other, verbose=False).nstates,
    }
    return Task(
        "minimal realisation, known by modes", f"n = {n}", runs, lambda k: float(abs(k - order)), {"slycot": 5.0}, n
    )


def minimal(n: int, coupled: bool = False) -> Task:
    """From matrices; python-control also with a system that it has built before."""
    Q, B, order = reducible(n, coupled)
    parts = matrices(Q, B)
    other = ct.StateSpace(*parts, remove_useless_states=False)
    runs = {
        OURS: lambda: phc.minreal(phc.ph(Q, B)).nstates,
        "slycot": lambda: ct.minreal(other, verbose=False).nstates,
        "slycot and ss": lambda: ct.minreal(ct.ss(*parts), verbose=False).nstates,
    }
    name = f"minimal realisation, from {'dense' if coupled else 'mechanical'} Q"
    return Task(name, f"n = {n}", runs, lambda k: float(abs(k - order)), {"slycot": 5.0}, n)


def kalman(n: int) -> Task:
    """Both parts, without and with the transformation; the others have the minimal part alone."""
    Q, B, order = reducible(n, True)
    other = ct.StateSpace(*matrices(Q, B), remove_useless_states=False)

    def with_transformation() -> int:
        reachable, _, T = phc.kalman_decomposition(phc.ph(Q, B))
        return int(reachable.nstates) if T.shape == Q.shape else -1

    runs = {
        OURS: lambda: phc.kalman_decomposition(phc.ph(Q, B)).reachable.nstates,
        "with T (ours)": with_transformation,
        "slycot, minimal part": lambda: ct.minreal(other, verbose=False).nstates,
    }
    needed = {"slycot, minimal part": 5.0}
    return Task("Kalman decomposition", f"n = {n}", runs, lambda k: float(abs(k - order)), needed, n)


def construction(n: int) -> Task:
    Q, B = dense_hamiltonian(n)
    system, parts, modal = phc.ph(Q, B), matrices(Q, B), modal_plant(n).modes
    runs = {
        OURS: lambda: phc.ph(Q, B),
        "from modes (ours)": lambda: phc.ph(modal),
        "copy (ours)": lambda: copy.deepcopy(system),
        "pickle (ours)": lambda: pickle.loads(pickle.dumps(system)),
        "python-control": lambda: ct.ss(*parts),
    }
    return Task("building a system", f"n = {n}", runs, None, {}, n)


def plain_chain(masses: int) -> ct.StateSpace:
    """Spring chain with proportional damping as a plain state space, driven at its end."""
    n = masses
    K = 250.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    C, F, none = 1e-3 * K + 0.02 * np.eye(n), np.eye(n)[:, -1:], np.zeros((n, 1))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]])
    return ct.ss(A, np.vstack([none, F]), np.vstack([none, F]).T, 0)


def rotated_resonators(n: int, stray: float) -> ct.StateSpace:
    """Damped resonators in random orthogonal states; a stray part of the outputs makes them active."""
    rng = np.random.default_rng(n)
    d = np.linspace(1.0, 40.0, n)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(d**2), -np.diag(0.03 * d)]])
    b = rng.standard_normal(n)
    T, none = np.linalg.qr(rng.standard_normal((2 * n, 2 * n)))[0], 0 * b
    c = b + stray * rng.standard_normal(n)
    return ct.ss(T @ A @ T.T, (T @ np.r_[none, b])[:, None], (np.r_[none, c] @ T.T)[None], 0)


def _eigenproblem(order: int) -> dict[str, Callable[[], Any]]:
    matrix = np.random.default_rng(0).standard_normal((order, order))
    return {"eigenvalues of twice the states (numpy)": lambda: np.linalg.eigvals(matrix)}


def conversion(masses: int) -> Task:
    """`ph` of matrices that show mass and stiffness; the eigenproblem is that of as many states twice."""
    system = plain_chain(masses)
    runs = {OURS: lambda: phc.ph(system)} | _eigenproblem(4 * masses)
    return Task("ph of a spring chain", f"{2 * masses} states", runs, limits={"seconds": 2.0}, growth=masses)


def passivity_test(n: int, stray: float) -> Task:
    """`passivity` of resonators, two states each; three eigenproblems of twice the states are allowed."""
    system = rotated_resonators(n, stray)
    runs = {OURS: lambda: phc.passivity(system)} | _eigenproblem(4 * n)
    needed = {name: 1 / 3 for name in runs if name != OURS}
    kind = "active" if stray else "passive"
    return Task(f"passivity, {kind}", f"{2 * n} states", runs, needed=needed, growth=n)


def package_import() -> Task:
    """The first import in a process of its own: what the package adds to python-control, and what a name adds then."""
    runs = {
        OURS: lambda: (imported("import control", "import ph_control"), np.nan),
        "with ph (ours)": lambda: (imported("import control", "import ph_control; ph_control.ph"), np.nan),
        "python-control": lambda: (imported("import numpy", "import control"), np.nan),
    }
    return Task("import", "after python-control", runs, limits={"seconds": 0.03}, apart=True)


def projection_step(n: int, samples: int) -> Task:
    """Residual, Jacobian by the frequencies and their reduction, of a whole record."""

    def step() -> tuple[float, float]:
        found = measure(n, samples, "step")
        return found["seconds"], found["peak"]

    limits = {"seconds": 3.0, "megabytes": 500.0}
    return Task("one step of variable projection", f"n = {n}, T = {samples}", {OURS: step}, limits=limits, apart=True)


def _pymor(system: ct.StateSpace) -> Any:
    try:
        from pymor.core.cache import disable_caching
        from pymor.core.logger import set_log_levels
        from pymor.models.iosys import LTIModel
    except ImportError:
        return None
    disable_caching()
    set_log_levels({"pymor": "ERROR"})
    return LTIModel.from_matrices(system.A, system.B, system.C)


@dataclass(frozen=True)
class Family:
    """Tasks of one kind, and the picture of their times: its title, and the axis of what the time is drawn against."""

    make: Callable[..., Task]
    sizes: list[tuple[Any, ...]]
    title: str = ""
    axis: str = "modes n"


def _each(*sizes: int) -> list[tuple[Any, ...]]:
    return [(n,) for n in sizes]


FAMILIES: dict[str, Family] = {
    "import": Family(package_import, [()]),
    "frequency": Family(
        frequency_response, _each(5, 20, 50, 100, 200, 500), "Frequency response at 1000 frequencies, modes known"
    ),
    "points": Family(
        frequency_response,
        [(50, 100), (50, 10_000), (50, 100_000)],
        "Frequency response of 50 modes, modes known",
        "frequencies N",
    ),
    "cold": Family(
        cold_frequency_response, _each(100, 200, 500), "Frequency response at 1000 frequencies from a dense Q"
    ),
    "simulation": Family(
        simulation,
        [(n, T, rule) for T in (10_000, 100_000) for n in (20, 50, 100) for rule in ("zoh", "foh")],
    ),
    "samples": Family(
        simulation,
        [(50, 1000, "foh"), (50, 3000, "foh"), (50, 30_000, "foh"), (50, 300_000, "foh")],
        "Simulation of 50 modes, input interpolated",
        "samples T",
    ),
    "dense": Family(simulation_of_dense, [(n, T) for T in (10_000, 100_000) for n in (20, 50, 100)]),
    "large": Family(simulation, [(500, 100_000)]),
    "million": Family(million_samples, [()]),
    "damped_frequency": Family(damped_frequency_response, _each(5, 20, 50, 100, 200)),
    "damped_simulation": Family(damped_simulation, _each(5, 20, 50, 100, 200)),
    "damped_balance": Family(damped_balance, [()]),
    "williamson": Family(williamson, _each(20, 50, 100, 200, 500), "Williamson's form of a dense Q of condition 1e12"),
    "mechanical": Family(mechanical, _each(500, 1500)),
    "modes": Family(frequencies_and_weights, _each(50, 100, 200, 500), "Frequencies and weights of a dense Q"),
    "coefficients": Family(coefficients, _each(5, 20, 50, 100, 200), "Coefficients of the denominator, modes known"),
    "zeros": Family(zeros, _each(5, 20, 50, 100, 200, 500), "Zeros, modes known"),
    "reduction": Family(minimal_of_modes, _each(5, 20, 50, 100, 200), "Minimal realisation, modes known"),
    "minimal": Family(minimal, [(n, True) for n in (5, 20, 50, 100, 200)], "Minimal realisation from a dense Q"),
    "uncoupled": Family(minimal, _each(5, 20, 50, 100, 200), "Minimal realisation from a mechanical Q"),
    "kalman": Family(kalman, _each(5, 20, 50, 100, 200), "Kalman decomposition from a dense Q"),
    "conversion": Family(
        conversion, _each(50, 75, 100, 150), "Port-Hamiltonian form of a plain spring chain", "masses"
    ),
    "passivity": Family(passivity_test, [(n, stray) for stray in (0.0, 0.3) for n in (50, 100, 150)]),
    "construction": Family(construction, _each(1, 10, 100, 200, 500), "Building and copying a system"),
    "step": Family(projection_step, [(50, 1_000_000)]),
}


def tasks(families: list[str] | None = None, largest: int | None = None) -> Iterator[tuple[str, Task]]:
    """Build the tasks of the families one after the other, those with `n` up to `largest`."""
    for name in families or FAMILIES:
        family = FAMILIES[name]
        for arguments in family.sizes:
            if largest is None or not arguments or arguments[0] <= largest:
                yield name, family.make(*arguments)

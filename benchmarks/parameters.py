"""Physical parameters from records: cover, error over the bound, false and right rejections; and model updating.

python -m benchmarks.parameters [--seeds N] [--first-seed K] [--only chain netlist frame update]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import expm

import ph_control as phc

Array = NDArray[np.float64]
LEVEL = 0.05


@dataclass(frozen=True)
class Case:
    """A system function with the truth, a wrong function, and what makes a record of a seed."""

    function: Callable[[Array], Any]
    truth: Array
    start: Array
    wrong: Callable[[Array], Any]
    wrong_start: Array
    record: Callable[[int], Any]
    options: dict[str, Any]
    bound: Callable[[], Array]  # standard errors that no unbiased estimate is below


# --- a chain of five masses in motion, a force on the last -----------------------------------------------------------


def chain_matrices(k: Array) -> tuple[Array, Array]:
    """Stiffness and damping of a chain of unit masses on a wall."""
    K = np.diag(np.append(k[:-1] + k[1:], k[-1])) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    return K, 0.002 * K + 0.01 * np.eye(len(k))


def chain(k: Array) -> ct.StateSpace:
    """Displacements of all masses by a force on the last."""
    k, n = np.asarray(k), len(k)
    K, C = chain_matrices(k)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]])
    B = np.append(np.zeros(2 * n - 1), 1.0)[:, None]
    return ct.ss(A, B, np.eye(n, 2 * n), np.zeros((n, 1)))


def grounded_chain(k: Array) -> ct.StateSpace:
    """The same without the spring to the wall: two masses share another spring instead."""
    n = len(k)
    K, C = chain_matrices(np.append(k[1:], k[0]))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]])
    B = np.append(np.zeros(2 * n - 1), 1.0)[:, None]
    B[n], B[-1] = 0.2, 1.0  # the shaker pushes the first mass as well
    return ct.ss(A, B, np.eye(n, 2 * n), np.zeros((n, 1)))


def chain_case(samples: int = 2000, dt: float = 0.05, noise: float = 0.05) -> Case:
    """Five springs from records that start in motion."""
    truth = np.array([100.0, 120.0, 90.0, 110.0, 80.0])
    plant = chain(truth)
    size = _size(plant, samples, dt)

    u = known_input(1, samples)
    state = 0.1 * np.random.default_rng(1).standard_normal(plant.nstates)
    y = simulated(plant, u, dt, state)

    def record(seed: int) -> Any:
        return u[0], y + noise * size * np.random.default_rng(seed).standard_normal(y.shape)

    return Case(
        chain, truth, np.full(5, 100.0), grounded_chain, np.full(5, 100.0), record,
        {"dt": dt, "quantity": "displacement", "intersample": "zoh"},
        lambda: bound_in_time(chain, truth, dt, np.full(5, noise * size), u, state),
    )  # fmt: skip


def _size(plant: ct.StateSpace, samples: int, dt: float) -> float:
    u = known_input(plant.ninputs, samples)
    return float(simulated(plant, u, dt, np.zeros(plant.nstates)).std())


def known_input(inputs: int, samples: int) -> Array:
    """The input of all records of a case, of which only the noise differs."""
    return np.random.default_rng(10**6).standard_normal((inputs, samples))


def simulated(plant: ct.StateSpace, u: Array, dt: float, state: Array) -> Array:
    """Outputs for inputs that are held, step by step."""
    A, B, C, D = (np.asarray(each) for each in (plant.A, plant.B, plant.C, plant.D))
    n, m = B.shape
    both = expm(dt * np.block([[A, B], [np.zeros((m, n + m))]]))
    F, G = both[:n, :n], both[:n, n:]
    states, driven = np.empty((n, u.shape[1])), G @ u
    for k in range(u.shape[1]):
        states[:, k] = state
        state = F @ state + driven[:, k]
    return np.asarray(C @ states + D @ u)


def bound_in_time(
    function: Callable[[Array], Any], truth: Array, dt: float, noise: Array, u: Array, state: Array
) -> Array:
    """Cramér-Rao bound of a record that begins in some state, which is not known."""
    plant, columns = function(truth), []
    for k in range(len(truth)):
        h = 1e-6 * truth[k] * np.eye(len(truth))[k]
        change = simulated(function(truth + h), u, dt, state) - simulated(function(truth - h), u, dt, state)
        columns.append((change / noise[:, None]).ravel() / (2 * h[k]))
    states = [(simulated(plant, 0 * u, dt, each) / noise[:, None]).ravel() for each in np.eye(plant.nstates)]
    J, S = np.stack(columns, axis=1), np.stack(states, axis=1)
    U, s, _ = np.linalg.svd(S, full_matrices=False)
    U = U[:, s > 1e-10 * s[0]]
    J = J - U @ (U.T @ J)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(J.T @ J))))


# --- a circuit of a measured response --------------------------------------------------------------------------------

CIRCUIT = """band-pass behind a coil with losses
V1 1 0
R1 1 2 50
L1 2 3 1m
C1 3 0 10n
R2 3 0 20k
"""
WRONG = CIRCUIT.replace("R2 3 0 20k", "R2 3 4 20\nC2 4 0 5n")


def netlist_case(lines: int = 300, noise: float = 0.002) -> Case:
    """Resistance, inductance and capacitance from a measured admittance."""
    function, wrong = (phc.read_netlist(text, parameters=["R1", "L1", "C1"]) for text in (CIRCUIT, WRONG))
    truth = np.array([47.0, 1.08e-3, 9.3e-9])
    omega = 2 * np.pi * np.geomspace(5e3, 3e5, lines)
    exact = np.squeeze(function(truth)(1j * omega))
    size = noise * np.abs(exact).max() / np.sqrt(2)

    def record(seed: int) -> Any:
        rng = np.random.default_rng(seed)
        error = size * (rng.standard_normal(lines) + 1j * rng.standard_normal(lines))
        return ct.frd(exact + error, omega)

    def bound() -> Array:
        columns = []
        for k in range(3):
            h = 1e-6 * truth[k] * np.eye(3)[k]
            change = np.squeeze(function(truth + h)(1j * omega) - function(truth - h)(1j * omega)) / (2 * h[k])
            columns.append(np.concatenate([change.real, change.imag]) / size)
        J = np.stack(columns, axis=1)
        unit = np.linalg.norm(J, axis=0)
        return np.asarray(np.sqrt(np.diag(np.linalg.inv((J / unit).T @ (J / unit)))) / unit)

    return Case(function, truth, function.values, wrong, wrong.values, record, {"quantity": "free"}, bound)


# --- a frame of 2 100 degrees of freedom -----------------------------------------------------------------------------

STOREYS, COLUMNS, HEIGHT, BAY = 20, 12, 3.0, 5.0
E_RHO_A_I = 210e9, 7850.0, 149e-4, 25170e-8  # steel, HEB 300
SENSORS = 12


def element(length: float, standing: bool) -> tuple[Array, Array]:
    """Stiffness and mass of a piece of a beam."""
    E, rho, A, I = E_RHO_A_I
    l, L = length, np.diag([1.0, 1.0, length] * 2)
    K, M = np.zeros((6, 6)), np.zeros((6, 6))
    axial, bending = np.ix_([0, 3], [0, 3]), np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    K[axial], M[axial] = E * A / l * np.array([[1, -1], [-1, 1]]), rho * A * l / 6 * np.array([[2, 1], [1, 2]])
    K[bending] = E * I / l**3 * np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    M[bending] = rho * A * l / 420 * np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22],
                                               [-13, -3, -22, 4]])  # fmt: skip
    turn = np.kron(np.eye(2), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) if standing else np.eye(6)
    return turn.T @ L @ K @ L @ turn, turn.T @ L @ M @ L @ turn


@cache
def frame_matrices() -> tuple[list[Any], Any, Array, Array]:
    """Stiffness of lower columns, upper columns and beams, mass, force on the roof, and rows of the sensors."""
    joint = np.arange((STOREYS + 1) * COLUMNS).reshape(STOREYS + 1, COLUMNS)
    half, groups, masses, count = STOREYS // 2, [], [], joint.size
    sets = (
        (True, joint[:half].ravel(), joint[1 : half + 1].ravel(), HEIGHT, 1.0),
        (True, joint[half:-1].ravel(), joint[half + 1 :].ravel(), HEIGHT, 1.0),
        (False, joint[1:, :-1].ravel(), joint[1:, 1:].ravel(), BAY, 3.0),
    )
    pieces = []
    for standing, first, last, length, load in sets:
        middle = count + np.arange(len(first))
        count += len(first)
        ends = np.concatenate([np.column_stack([first, middle]), np.column_stack([middle, last])])
        places = (3 * ends[:, :, None] + np.arange(3)).reshape(-1, 6)
        pieces.append((places, *element(length / 2, standing), load))
    size = 3 * count

    def summed(places: Any, matrix: Array) -> Any:
        rows, columns = np.repeat(places, 6, axis=1).ravel(), np.tile(places, 6).ravel()
        every = sparse.coo_array((np.tile(matrix.ravel(), len(places)), (rows, columns)), (size, size)).tocsc()
        return every[3 * COLUMNS :][:, 3 * COLUMNS :]

    for places, stiffness, mass, load in pieces:
        groups.append(summed(places, stiffness))
        masses.append(load * summed(places, mass))
    n = size - 3 * COLUMNS
    sideways = [3 * (joint[storey, 0] - COLUMNS) for storey in np.linspace(2, STOREYS, SENSORS).round().astype(int)]
    F, rows = np.zeros((n, 1)), np.zeros((SENSORS - 1, n))
    F[sideways[-1], 0] = 1.0
    rows[np.arange(SENSORS - 1), sideways[:-1]] = 1.0
    return groups, sum(masses[1:], masses[0]), F, rows


def frame(theta: Array) -> Any:
    """Velocities at twelve floors by a force on the roof; factors of lower and upper columns and of beams."""
    parts, M, F, rows = frame_matrices()
    K = sum((factor * part for factor, part in zip(theta[1:], parts[1:], strict=True)), theta[0] * parts[0])
    return phc.from_second_order(M, K, F, C=0.02 * M + 2e-4 * K, modes=10, sensors={"velocity": rows})


def wrong_frame(theta: Array) -> Any:
    """The same with beams that are rigid against turning of the upper joints: factors of columns act together."""
    return frame(np.array([theta[0], theta[0], theta[1]]))


def frame_case(samples: int = 3000, dt: float = 0.02, noise: float = 0.05) -> Case:
    """Three stiffness factors from 12 sensors."""
    truth = np.array([0.9, 1.15, 1.05])
    plant = frame(truth)
    size = _size(plant, samples, dt)

    u = known_input(1, samples)
    y = simulated(plant, u, dt, np.zeros(plant.nstates))

    def record(seed: int) -> Any:
        return u[0], y + noise * size * np.random.default_rng(seed).standard_normal(y.shape)

    return Case(
        frame, truth, np.ones(3), wrong_frame, np.ones(2), record,
        {"dt": dt, "quantity": "velocity", "intersample": "zoh", "noise": "white"},
        lambda: bound_in_time(frame, truth, dt, np.full(SENSORS, noise * size), u, np.zeros(plant.nstates)),
    )  # fmt: skip


CASES: dict[str, Callable[[], Case]] = {"chain": chain_case, "netlist": netlist_case, "frame": frame_case}


def measure(name: str, seeds: Sequence[int]) -> None:
    """Fit the right and the wrong function to the record of each seed."""
    case = CASES[name]()
    bound = case.bound()
    errors, covered, right, wrong, calls, took = [], [], [], [], [], []
    for seed in seeds:
        data, began = case.record(seed), time.process_time()
        result = phc.pem(data, model=case.function, parameters=case.start, **case.options)
        took.append(time.process_time() - began)
        low, high = result.confidence_interval()["parameters"].T
        errors.append(result.parameters - case.truth)
        covered.append((low < case.truth) & (case.truth < high))
        right.append(result.tests[0].p)
        calls.append(result.fitted_parameters.evaluations / len(case.truth))
        other = phc.pem(data, model=case.wrong, parameters=case.wrong_start, **case.options)
        wrong.append(other.tests[0].p)
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    print(
        f"{name}: {len(seeds)} seeds, cover {100 * np.mean(covered):.1f} %, rms over bound "
        f"{' '.join(f'{each:.2f}' for each in ratio)} (together {np.sqrt(np.mean(ratio**2)):.3f}), "
        f"true rejected {100 * np.mean(np.array(right) < LEVEL):.1f} %, "
        f"wrong rejected {100 * np.mean(np.array(wrong) < LEVEL):.1f} %, "
        f"calls for a parameter {np.mean(calls):.1f}, at most {np.max(calls):.1f}, {np.mean(took):.2f} s",
        flush=True,
    )


# --- model updating --------------------------------------------------------------------------------------------------


def building(k: Array) -> Any:
    """Velocity of the roof, where the force acts, and displacements of the floors below."""
    n = len(k)
    K, C = chain_matrices(np.asarray(k))
    F = np.append(np.zeros(n - 1), 1.0)
    return phc.from_second_order(np.eye(n), K, F, C=1.5 * C, sensors=np.eye(n - 1, n))


def measure_updating(seeds: Sequence[int], samples: int = 3000, dt: float = 0.05, noise: float = 0.1) -> None:
    """One storey of 0.7 times the stiffness, from the modes of a fit and from the record itself."""
    start, truth = np.full(4, 100.0), np.array([100.0, 70.0, 100.0, 100.0])
    plant, covered, errors, direct, p = building(truth), [], [], [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(samples)
        y = simulated(plant, u[None], dt, np.zeros(plant.nstates))
        data = u, y + noise * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
        options: dict[str, Any] = {"dt": dt, "quantity": ["velocity"] + ["displacement"] * 3}
        update = phc.update_model(building, start, phc.pem(data, **options))
        low, high = update.confidence_interval().T
        covered.append((low < truth) & (truth < high))
        errors.append(update.parameters - truth)
        p.append(update.p)
        direct.append(phc.pem(data, model=building, parameters=start, **options).parameters - truth)
    rms = [np.sqrt(np.mean(np.square(each), axis=0)) for each in (errors, direct)]
    print(
        f"update: {len(seeds)} seeds, damaged storey within its interval {100 * np.mean(covered, axis=0)[1]:.1f} %, "
        f"all {100 * np.mean(covered):.1f} %, rejected {100 * np.mean(np.array(p) < LEVEL):.1f} %, rms from modes "
        f"{' '.join(f'{each:.3f}' for each in rms[0])}, from the record {' '.join(f'{each:.3f}' for each in rms[1])}"
    )


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=[*CASES, "update"], choices=[*CASES, "update"])
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for name in options.only:
        measure_updating(seeds) if name == "update" else measure(name, seeds)


if __name__ == "__main__":
    main()

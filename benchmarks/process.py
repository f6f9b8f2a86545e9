"""Plants of control and of process industry: order, errors, and what is foretold, beside subspace methods.

    python -m benchmarks.process control [--seeds N] [--name NAME ...]
    python -m benchmarks.process foretell [--seeds N] [--name NAME ...] [--no-peers]
    python -m benchmarks.process predict [--seeds N] [--name NAME ...] [--no-peers]

`control` fits plants with real poles, alone and beside modes, to 2000 samples with white noise of 3 %, by the default
call, in open loops and behind controllers that see the noise, and counts right orders, squared errors of the poles over
their variances, and how often 95 % intervals cover.
`foretell` fits the first half of records of process plants, whose noise is coloured and as large as they are, by the
default call, and foretells the second half; beside it stand the plant itself, with the mean of the noise in the first
half, and the best of some subspace methods at the order that is best there.
`predict` predicts each output of the second half one step ahead, by the Kalman filters of the fits and of subspace
methods at the order that is best there; beside it stand the p-values of white errors.
"""

from __future__ import annotations

import argparse
import logging
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import linear_sum_assignment
from scipy.signal import butter, lfilter
from scipy.stats import chi2

import ph_control as phc

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

STEP, SAMPLES, NOISE = 0.01, 2000, 0.03
BEGINNING = 100  # samples of the second half that the motion at its first sample is estimated from
MOST = 6  # states of the models of others
HORIZON = 15

# --- plants of control -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plant:
    """Poles of positive imaginary part and real ones, shape (n,), residues (n, p, m), and samples of dead time."""

    poles: ComplexArray
    residues: ComplexArray
    late: int = 0

    @classmethod
    def of(cls, *terms: tuple[complex, Any], late: int = 0) -> Plant:
        """Poles with their residues: numbers, or matrices (p, m)."""
        residues = np.array([np.atleast_2d(np.asarray(residue, complex)) for _, residue in terms])
        return cls(np.array([pole for pole, _ in terms], complex), residues, late)

    def outputs(self, u: Array, step: float) -> Array:
        """Outputs (p, T) of the plant at rest under inputs (m, T) that are held between samples."""
        return held(self.poles, self.residues, np.pad(u, ((0, 0), (self.late, 0)))[:, : u.shape[1]], step)


def held(poles: ComplexArray, residues: ComplexArray, u: Array, step: float, linear: bool = False) -> Array:
    """Outputs (p, T) of poles and residues from rest; inputs (m, T) are held, or `linear` between samples."""
    y = np.zeros((residues.shape[1], u.shape[1]))
    for pole, residue in zip(poles, residues, strict=True):
        # exact steps of x' = pole x + v, v' = (next - now) / step between samples
        E = expm(np.array([[pole * step, step, 0], [0, 0, 1], [0, 0, 0]], complex))
        now, ahead = (E[0, 1] - E[0, 2], E[0, 2]) if linear else (E[0, 1], 0.0)
        states = np.array([lfilter([ahead, now], [1.0, -E[0, 0]], signal + 0j) for signal in u])
        if linear:  # the first sample is the beginning, not a step
            states -= ahead * u[:, :1] * np.exp(pole * step * np.arange(u.shape[1]))
        y += (2.0 if pole.imag else 1.0) * (residue @ states).real
    return y


CONTROL = {
    "lag": Plant.of((-5.0, 5.0)),
    "lag of negative gain": Plant.of((-5.0, -5.0)),
    "motor": Plant.of((-2.0, 2.2), (-20.0, -2.2)),
    "RC ladder of three": Plant.of((-0.5, 0.4), (-4.0, 2.0), (-30.0, 12.0)),
    "lag and mode": Plant.of((-1.0, 1.0), (-0.15 + 12j, 0.5 - 0.2j)),
    "motor and shaft mode": Plant.of((-0.8, 1.0), (-9.0, -0.7), (-0.3 + 25j, 0.6j)),
    "critical damping": Plant.of((-6 + 0.01j, -50j)),
    "integrator and lag": Plant.of((0.0, 1.0), (-3.0, -1.0)),
    "two modes and two lags": Plant.of((-0.02 + 3j, 0.3), (-0.1 + 14j, -0.4j), (-1.5, 0.8), (-15.0, -3.0)),
    "overdamped mass": Plant.of((-5.0, 1 / 15), (-20.0, -1 / 15)),
    "2 x 2": Plant.of(
        (-2.0, [[1.0, 0.4], [0.4, 0.8]]), (-0.2 + 9j, [[0.3, 0.2j], [0.1, 0.4]]),
        (-0.3 + 21j, [[0.5j, 0.2], [0.1, 0.3]]),
    ),
    "unstable in closed loop": Plant.of((0.5, 2.0)),
    "lag, 5 samples late": Plant.of((-5.0, 5.0), late=5),
    "lag, 60 samples late": Plant.of((-5.0, 5.0), late=60),
    "motor, 15 samples late": Plant.of((-2.0, 2.2), (-20.0, -2.2), late=15),
    "lag and mode, 30 samples late": Plant.of((-1.0, 1.0), (-0.15 + 12j, 0.5 - 0.2j), late=30),
}  # fmt: skip
LOOPS = {  # with a sensor whose noise is a fiftieth of the reference
    "lag": Plant.of((-10.0, 10.0)),
    "two lags": Plant.of((-5.0, 10.0), (-20.0, -10.0)),
    "lag, 4 samples late": Plant.of((-5.0, 5.0), late=4),
    "integrator and lag, 2 samples late": Plant.of((0.0, 3.0), (-15.0, -3.0), late=2),
}
CONTROL |= {f"{name}, {by}": plant for by in ("steps of a PI loop", "relay") for name, plant in LOOPS.items()}
QUANTITIES = {"overdamped mass": "displacement"}  # of outputs that are no velocities


def controlled(name: str, seed: int) -> tuple[Array, Array]:
    """Inputs (m, T) and outputs (p, T) of a plant of control with white noise of 3 %."""
    plant, rng = CONTROL[name], np.random.default_rng([seed, list(CONTROL).index(name)])
    if name.endswith(("loop", "relay")):
        return looped(plant, rng, name.endswith("relay"))
    m = plant.residues.shape[2]
    levels = np.repeat(rng.choice([-1.0, 1.0], (m, SAMPLES // 10)), 10, axis=1)
    u = levels + 0.3 * rng.standard_normal((m, SAMPLES))
    white = rng.standard_normal((plant.residues.shape[1], SAMPLES))
    if name != "unstable in closed loop":
        y = plant.outputs(u, STEP)
        return u, y + NOISE * np.std(y, axis=1, keepdims=True) * white
    # u = 3 (r - y), with noise of the sensor in the loop
    lam = np.exp(plant.poles[0].real * STEP)
    drive = (lam - 1) / plant.poles[0].real * plant.residues[0, 0, 0].real
    state, size, rows = 0.0, NOISE * 0.4, np.zeros((2, SAMPLES))
    for k in range(SAMPLES):
        measured = state + size * white[0, k]
        force = 3.0 * (u[0, k] - measured)
        rows[:, k] = force, measured
        state = lam * state + drive * force
    return rows[:1], rows[1:]


def looped(plant: Plant, rng: np.random.Generator, relay: bool) -> tuple[Array, Array]:
    """Input and output of real poles with a relay, or a digital PI controller whose reference steps now and then."""
    p, residues = plant.poles.real, plant.residues[:, 0, 0].real
    drive = np.where(p == 0, STEP, np.expm1(p * STEP) / np.where(p == 0, 1.0, p)) * residues
    references, integral, push = rng.choice([-1.0, -0.5, 0.5, 1.0], SAMPLES // 200), 0.0, 1.0
    x, u, y = np.zeros(len(p)), np.zeros(SAMPLES + plant.late), np.zeros(SAMPLES)
    for k in range(SAMPLES):
        y[k] = x.sum() + 0.02 * rng.standard_normal()
        error = references[k // 200] - y[k]
        integral += STEP * error * (0.5 if 0 in p else 6.0)
        push = push if abs(y[k]) < 0.1 else -np.sign(y[k])
        u[k + plant.late] = push if relay else 0.8 * error + integral
        x = np.exp(p * STEP) * x + drive * u[k]
    return u[None, plant.late :], y[None]


def squeezed(u: Array, y: Array) -> tuple[Array, Array]:
    """Inputs and outputs without the axis of channels where there is one of each."""
    return (u[0], y[0]) if len(u) == len(y) == 1 else (u, y)


@dataclass(frozen=True)
class Judged:
    """Whether the order of a fit is right, squared errors over variances of its poles, those covered, its time."""

    right: bool
    squares: list[float]
    covered: list[bool]
    seconds: float
    structure: str


def judged(name: str, seed: int) -> Judged:
    """The default call on a plant of control."""
    true, (u, y) = CONTROL[name].poles, controlled(name, seed)
    start = process_time()
    result: Any = phc.pem(squeezed(u, y), dt=STEP, quantity=QUANTITIES.get(name))
    seconds = process_time() - start
    poles = np.asarray(getattr(result, "poles", np.zeros(0)), complex)
    states = int(np.sum(1 + (poles.imag > 0)))
    right = states == int(np.sum(1 + (true.imag > 0)))
    squares: list[float] = []
    late = STEP * CONTROL[name].late
    if right and late and 0 < result.stderr["delay"][0] < np.inf:
        squares.append(float(((result.delay[0] - late) / result.stderr["delay"][0]) ** 2))
    if right and name != "critical damping":  # whose poles go together or apart by chance
        same = int(np.sum(poles.imag > 0)) == int(np.sum(true.imag > 0))
        modes, real = (np.flatnonzero(poles.imag > 0), np.flatnonzero(poles.imag == 0)) if same else ([], [])
        for kind, places in ((true.imag > 0, modes), (true.imag == 0, real)):
            if not len(places):
                continue
            mine, theirs = true[kind], poles[places]
            rows, columns = linear_sum_assignment(np.abs(mine[:, None] - theirs))
            mine, theirs = mine[rows], theirs[columns]
            if np.all(mine.imag > 0):
                errors = result.stderr["natural_frequencies"][columns], result.stderr["damping_ratios"][columns]
                off = np.abs(theirs) - np.abs(mine), theirs.real / np.abs(theirs) - mine.real / np.abs(mine)
                squares += [float(x) for some, each in zip(off, errors, strict=True) for x in (some / each) ** 2]
            else:
                squares += (((theirs - mine).real / result.stderr["real_poles"][columns]) ** 2).tolist()
    return Judged(right, squares, [x < 1.96**2 for x in squares], seconds, result.structure)


def control_table(names: Sequence[str], seeds: int) -> None:
    """Print a line for each plant."""
    print(f"{'plant':29} {'order':>8} {'z^2':>6} {'cover':>7} {'median s':>9} {'worst s':>8}  structures")
    for name in names:
        rows = [judged(name, seed) for seed in range(seeds)]
        squares = [x for row in rows for x in row.squares]
        cover = 100 * np.mean([x for row in rows for x in row.covered] or [np.nan])
        seconds = [row.seconds for row in rows]
        kinds = {kind: sum(row.structure == kind for row in rows) for kind in sorted({row.structure for row in rows})}
        print(
            f"{name:29} {sum(row.right for row in rows):4d}/{seeds:<3d} {np.mean(squares or [np.nan]):6.2f} "
            f"{cover:5.1f} % {np.median(seconds):9.2f} {max(seconds):8.2f}  {kinds}",
            flush=True,
        )


# --- process plants --------------------------------------------------------------------------------------------------


def levels(rng: np.random.Generator, m: int, samples: int, each: int) -> Array:
    """Inputs (m, T) that keep each of two levels for a random time of some mean."""
    switches = np.cumsum(rng.random((m, samples)) < 1.0 / each, axis=1)
    return np.where((switches + rng.integers(0, 2, (m, 1))) % 2, 1.0, -1.0)


def chained(u: Array, steps: Sequence[float], delay: int = 0) -> Array:
    """Outputs of lags of unit gain in a row, each of so many samples, after a dead time in samples."""
    x = np.concatenate([np.zeros(delay), u[: len(u) - delay]])
    for steps_of_lag in steps:
        a = np.exp(-1.0 / steps_of_lag)
        x = lfilter([0.0, 1 - a], [1.0, -a], x)
    return np.asarray(x)


def loaded(rng: np.random.Generator, samples: int, a: float) -> Array:
    """Noise of variance 1 that is `a` times what it was a sample before, and white noise."""
    white = rng.standard_normal(samples)
    white[0] /= np.sqrt(1 - a**2)
    return np.asarray(np.sqrt(1 - a**2) * lfilter([1.0], [1.0, -a], white))


Simulated = tuple[Array, Array, Array]  # inputs (m, T), outputs (p, T), and these without noise and load


def _heater(rng: np.random.Generator, a: float, samples: int = 2400) -> Simulated:
    u = levels(rng, 1, samples, 25)
    x = chained(u[0], (20.0, 5.0), 4)
    load = np.std(x) * loaded(rng, samples, a) + 0.02 * rng.standard_normal(samples)
    return u, (20 + x + load)[None], (20 + x)[None]


def _loop(rng: np.random.Generator, samples: int = 2000) -> Simulated:
    """A flow under a PI controller, with coloured load noise and a reference that steps."""
    reference, noise = levels(rng, 1, samples, 60)[0], 0.4 * loaded(rng, samples, 0.9)
    a, b, integral = np.exp(-1 / 8.0), np.exp(-1 / 3.0), 0.0
    u, y, x = np.zeros(samples), np.zeros(samples), np.zeros(2)
    for k in range(samples):
        y[k] = x[1] + noise[k]
        error = reference[k] - y[k]
        integral += 0.04 * error
        u[k] = 0.6 * error + integral + 0.3 * rng.standard_normal()
        late = u[k - 1] if k else 0.0  # a dead time of one sample beside the hold
        x = np.array([a * x[0] + (1 - a) * late, b * x[1] + (1 - b) * x[0]])
    return u[None], y[None], (y - noise)[None]


def _five_inputs(rng: np.random.Generator, samples: int = 2500) -> Simulated:
    u = levels(rng, 5, samples, 30)
    lags, delays, gains = (30.0, 12.0, 30.0, 6.0, 12.0), (0, 3, 7, 1, 12), (1.0, -0.6, 0.5, 0.8, -0.4)
    x = sum(g * chained(signal, (lag,), d) for g, signal, lag, d in zip(gains, u, lags, delays, strict=True))
    return u, (5 + x + 0.5 * np.std(x) * loaded(rng, samples, 0.95))[None], np.reshape(5 + x, (1, -1))


def _column(rng: np.random.Generator, samples: int = 2500) -> Simulated:
    """A distillation column: 3 outputs and 2 inputs, lags that all share."""
    u = levels(rng, 2, samples, 40)
    slow, fast = (np.array([chained(signal, (lag,)) for signal in u]) for lag in (40.0, 8.0))
    x = np.array([[0.9, -0.8], [0.6, -0.7], [0.3, 0.5]]) @ slow + np.array([[0.1, 0.1], [0.4, 0.2], [-0.3, 0.4]]) @ fast
    noise = np.array([loaded(rng, samples, a) for a in (0.95, 0.9, 0.8)])
    return u, x + 0.4 * np.std(x, axis=1, keepdims=True) * noise, x


def _thermal(rng: np.random.Generator, samples: int = 3000) -> Simulated:
    """A wall between two temperatures, with one of the surroundings that wanders."""
    u = levels(rng, 2, samples, 50)
    x = chained(u[0], (150.0,)) + 0.5 * chained(u[1], (60.0, 10.0))
    wandering = np.cumsum(rng.standard_normal(samples))
    wandering *= 0.3 * np.std(x) / np.std(wandering)
    return u, (x + wandering + 0.02 * np.std(x) * rng.standard_normal(samples))[None], x[None]


def _servo(rng: np.random.Generator, samples: int = 2000) -> Simulated:
    """An arm with friction: the speed of a motor, a dry friction that opposes it, and a mode of the shaft."""
    u = levels(rng, 1, samples, 20)[0] + 0.3 * rng.standard_normal(samples)
    speed, y = 0.0, np.zeros(samples)
    for k in range(samples):
        y[k] = speed
        speed = 0.95 * speed + 0.05 * (u[k] - 0.25 * np.tanh(20 * speed))
    shaft = held(np.array([-0.04 + 0.9j]), np.array([[[0.02j]]]), u[None], 1.0)[0]
    noise = 0.1 * np.std(y) * loaded(rng, samples, 0.97) + 0.01 * rng.standard_normal(samples)
    return u[None], (y + shaft + noise)[None], (y + shaft)[None]


def _wing(rng: np.random.Generator, share: float, samples: int = 1024) -> Simulated:
    """Two modes of a wing under a shaker, and turbulence whose response is `share` times as large."""
    b, a = butter(4, [0.1, 0.35], "band")
    u = lfilter(b, a, rng.standard_normal((1, samples + 200)))[:, 200:]
    turbulence = lfilter([1.0], [1.0, -0.7], rng.standard_normal((1, samples)))
    poles = np.array([-0.02 + 0.55j, -0.012 + 0.72j])
    y, moved = (
        held(poles, np.reshape(residues, (2, 1, 1)), signal, 1.0)
        for residues, signal in (([0.3 - 0.1j, -0.2 + 0.1j], u), ([0.1 + 0.2j, 0.4j], turbulence))
    )
    x = y / np.std(y)
    return u, x + share * moved / np.std(moved) + 0.03 * rng.standard_normal((1, samples)), x


PROCESS: dict[str, Callable[[np.random.Generator], Simulated]] = {
    "heater, load 0.95": lambda rng: _heater(rng, 0.95),
    "heater, load 0.99": lambda rng: _heater(rng, 0.99),
    "flow in closed loop": _loop,
    "five inputs, dead times": _five_inputs,
    "column, 3 x 2": _column,
    "thermal, drifting": _thermal,
    "servo with friction": _servo,
    "wing, turbulence 0.6": lambda rng: _wing(rng, 0.6),
    "wing, turbulence 1": lambda rng: _wing(rng, 1.0),
}


def percent(y: Array, predicted: Array) -> float:
    """Fit of several outputs in percent: 100 (1 - |error| / |output - mean|), the mean of all outputs."""
    size = np.linalg.norm(y - y.mean(axis=1, keepdims=True), axis=1)
    return float(100 * np.mean(1 - np.linalg.norm(y - predicted, axis=1) / size))


def foretold(result: Any, u: Array, y: Array) -> Array:
    """Outputs of a fit on other data, of which the beginning tells the motion at the first sample."""
    inputs = u[0] if len(u) == len(y) == 1 else u
    forced = np.reshape(result.predict(inputs, initial_state="zero", dt=1.0).outputs, y.shape)
    forced = forced + np.reshape(result.offsets, (-1, len(y)))[0][:, None]
    return forced + beginning(np.exp(np.outer(result.poles, np.arange(u.shape[1]))), y - forced)


def beginning(motions: ComplexArray, rest: Array) -> Array:
    """Motions (n, T), of each output its own, that are least squares over the beginning of what is left."""
    columns = np.concatenate([motions.real, motions.imag]).T
    weights = np.linalg.lstsq(columns[:BEGINNING], rest[:, :BEGINNING].T, rcond=1e-6)[0]
    return (columns @ weights).T


def state_space(A: Array, B: Array, C: Array, D: Array, u: Array, y: Array) -> Array:
    """Outputs of a discrete model on other data, its first state estimated from their beginning."""
    state, x = np.eye(len(A)), np.zeros(len(A))
    forced, free = np.zeros((len(C), u.shape[1])), np.zeros((len(C), u.shape[1], len(A)))
    for k in range(u.shape[1]):
        forced[:, k], free[:, k] = C @ x + D @ u[:, k], C @ state
        x, state = A @ x + B @ u[:, k], A @ state
    columns = free[:, :BEGINNING].reshape(-1, len(A))
    first = np.linalg.lstsq(columns, (y - forced)[:, :BEGINNING].ravel(), rcond=1e-6)[0]
    return forced + free @ first


def peers(u: Array, y: Array) -> dict[str, Callable[[Array, Array], Array]]:
    """Models of subspace methods at every order up to `MOST`, by name and order."""
    import pandas as pd
    from nfoursid.nfoursid import NFourSID
    from sippy_unipi import system_identification

    logging.disable(logging.WARNING)
    models: dict[str, Callable[[Array, Array], Array]] = {}

    def keep(name: str, matrices: Sequence[Array]) -> None:
        A, B, C, D = (np.asarray(matrix, float) for matrix in matrices)
        models[name] = lambda u, y: state_space(A, B, C, D, u, y)

    for order in range(1, MOST + 1):
        for method in ("N4SID", "MOESP", "CVA", "PARSIM-K"):
            try:
                model = system_identification(
                    y, u, method, SS_fixed_order=order, SS_f=HORIZON, SS_p=HORIZON, tsample=1.0, SS_D_required=True
                )
                keep(f"{method} {order}", (model.A, model.B, model.C, model.D))
            except Exception:  # a method that fails at this order has no model
                continue
        try:
            names = [f"u{k}" for k in range(len(u))], [f"y{k}" for k in range(len(y))]
            frame = pd.DataFrame(np.concatenate([u, y]).T, columns=[*names[0], *names[1]])
            subspace = NFourSID(frame, names[1], names[0], num_block_rows=HORIZON)
            subspace.subspace_identification()
            model, _ = subspace.system_identification(rank=order)
            keep(f"nfoursid {order}", (model.a, model.b, model.c, model.d))
        except Exception:
            continue
    return models


def foretell_table(names: Sequence[str], seeds: int, with_peers: bool) -> None:
    """Print a line for each record."""
    columns = f"{'states':>6} {'fit 1':>6} {'fit 2':>6} {'plant':>6} {'s':>6}  {'outcome':13} best of others"
    print(f"{'record':26} {'seed':>4} {columns}")
    for name in names:
        for seed in range(seeds):
            u, y, x = PROCESS[name](np.random.default_rng([seed, 7]))
            half = u.shape[1] // 2
            level = (y - x)[:, :half].mean(axis=1, keepdims=True)
            plant = percent(y[:, half:], x[:, half:] + level)
            start = process_time()
            result: Any = phc.pem(squeezed(u[:, :half], y[:, :half]), dt=1.0)
            seconds = process_time() - start
            fit = percent(y[:, half:], foretold(result, u[:, half:], y[:, half:]))
            states = int(np.sum(1 + (result.poles.imag > 0)))
            best = ""
            if with_peers:
                means = [channel[:, :half].mean(axis=1, keepdims=True) for channel in (u, y)]
                models = peers(*(channel[:, :half] - mean for channel, mean in zip((u, y), means, strict=True)))
                u2, y2 = (channel[:, half:] - mean for channel, mean in zip((u, y), means, strict=True))
                with np.errstate(all="ignore"):
                    fits = {key: percent(y2, model(u2, y2)) for key, model in models.items()}
                top = max(fits, key=lambda key: fits[key] if np.isfinite(fits[key]) else -np.inf)
                best = f"{fits[top]:6.1f} {top}"
            delays = [finding.values for finding in result.findings if finding.cause.name == "DELAY"]
            print(
                f"{name:26} {seed:4d} {states:6d} {result.fit_percent:6.1f} {fit:6.1f} {plant:6.1f} {seconds:6.2f}  "
                f"{result.outcome.name:13} {best} {delays or ''}",
                flush=True,
            )


# --- one step ahead --------------------------------------------------------------------------------------------------


def _modes(rng: np.random.Generator, samples: int = 3000) -> Simulated:
    """Two modes at two sensors under noise that is 0.9 times what it was a sample before."""
    u = rng.standard_normal((1, samples))
    poles = np.array([-0.006 + 0.4j, -0.01 + 1.1j])
    x = held(poles, np.array([[[0.02], [0.01j]], [[0.03j], [0.02]]]), u, 1.0)
    noise = np.array([loaded(rng, samples, 0.9) for _ in x])
    return u, x + 0.5 * np.std(x, axis=1, keepdims=True) * noise, x


PREDICTED = {**PROCESS, "modes, noise 0.9": _modes}

Matrices = tuple[Array, Array, Array, Array]  # of a predictor, from inputs and outputs to outputs one step ahead


def errors_of(predictor: Matrices, u: Array, y: Array) -> Array:
    """Errors (p, T) one step ahead; the first state is that of the least errors in the beginning."""
    A, B, C, D = predictor
    x, signals, errors = np.zeros(len(A)), np.concatenate([u, y]), np.zeros(y.shape)
    free, state = np.zeros((*y.shape, len(A))), np.eye(len(A))
    for k in range(u.shape[1]):
        errors[:, k], free[:, k] = y[:, k] - C @ x - D @ signals[:, k], C @ state
        x, state = A @ x + B @ signals[:, k], A @ state
    columns = free[:, :BEGINNING].reshape(-1, len(A))
    return errors - free @ np.linalg.lstsq(columns, errors[:, :BEGINNING].ravel(), rcond=1e-6)[0]


def with_gain(A: Array, B: Array, C: Array, D: Array, K: Array) -> Matrices:
    """Predictor of `x+ = A x + B u + K e`, `y = C x + D u + e`."""
    both = np.concatenate([B - K @ D, K], axis=1)
    return A - K @ C, both, C, np.concatenate([D, np.zeros((len(C),) * 2)], axis=1)


def riccati_gain(A: Array, C: Array, Q: Array, R: Array, S: Array) -> Array:
    """Gain of the Kalman filter."""
    P = solve_discrete_are(A.T, C.T, Q, R, s=S)
    return np.asarray(np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T)


def predicting_peers(u: Array, y: Array) -> dict[str, Matrices]:
    """Predictors of subspace methods at every order up to `MOST`, by name and order."""
    import pandas as pd
    from nfoursid.nfoursid import NFourSID
    from sippy_unipi import system_identification

    logging.disable(logging.WARNING)
    predictors: dict[str, Matrices] = {}
    names = [f"u{k}" for k in range(len(u))], [f"y{k}" for k in range(len(y))]
    frame, p = pd.DataFrame(np.concatenate([u, y]).T, columns=[*names[0], *names[1]]), len(y)
    for order in range(1, MOST + 1):
        for method in ("N4SID", "CVA"):
            try:
                model = system_identification(
                    y, u, method, SS_fixed_order=order, SS_f=HORIZON, SS_p=HORIZON, tsample=1.0, SS_D_required=True
                )
                matrices = (np.asarray(getattr(model, name), float) for name in "ABCDK")
                predictors[f"{method} {order}"] = with_gain(*matrices)
            except Exception:  # a method that fails at this order has no model
                continue
        try:
            subspace = NFourSID(frame, names[1], names[0], num_block_rows=HORIZON)
            subspace.subspace_identification()
            model, noise = subspace.system_identification(rank=order)
            K = riccati_gain(model.a, model.c, noise[p:, p:], noise[:p, :p], noise[p:, :p])
            predictors[f"nfoursid {order}"] = with_gain(model.a, model.b, model.c, model.d, K)
        except Exception:
            continue
    return predictors


def whiteness(errors: Array, lags: int = 20) -> float:
    """p-value of the Ljung-Box test of errors (p, T), the least over outputs times their number."""
    p_values = []
    for e in errors - errors.mean(axis=1, keepdims=True):
        r = np.array([e[k:] @ e[: len(e) - k] for k in range(lags + 1)]) / (e @ e)
        p_values.append(chi2.sf(len(e) * (len(e) + 2) * np.sum(r[1:] ** 2 / (len(e) - np.arange(1, lags + 1))), lags))
    return float(min(1.0, len(errors) * min(p_values)))


def predict_table(names: Sequence[str], seeds: int, with_peers: bool) -> None:
    """Print a line for each record: percent of the outputs that are predicted, and p-values of white errors."""
    print(f"{'record':26} {'seed':>4} {'simulated':>9} {'one step':>8} {'white 1':>8} {'white 2':>8}  best of others")
    for name in names:
        for seed in range(seeds):
            u, y, _ = PREDICTED[name](np.random.default_rng([seed, 7]))
            half = u.shape[1] // 2
            first, second = slice(None, half), slice(half, None)
            result: Any = phc.pem(squeezed(u[:, first], y[:, first]), dt=1.0)
            predictor, offset = result.predictor, np.reshape(result.offsets, (-1, len(y)))[0][:, None]
            matrices: Any = tuple(np.asarray(getattr(predictor, name)) for name in "ABCD")
            parts = (first, second)
            errors = [errors_of(matrices, u[:, part], y[:, part] - offset)[:, BEGINNING:] for part in parts]
            later = y[:, second][:, BEGINNING:]
            fit = percent(later, later - errors[1])
            simulated = percent(y[:, second], foretold(result, u[:, second], y[:, second]))
            best = ""
            if with_peers:
                means = [each[:, first].mean(axis=1, keepdims=True) for each in (u, y)]
                centred = [each - mean for each, mean in zip((u, y), means, strict=True)]
                models = predicting_peers(*(each[:, first] for each in centred))
                with np.errstate(all="ignore"):
                    each_error = {
                        key: errors_of(model, *(each[:, second] for each in centred))[:, BEGINNING:]
                        for key, model in models.items()
                    }
                    fits = {key: percent(later, later - error) for key, error in each_error.items()}
                for method in ("nfoursid", "N4SID", "CVA"):
                    known = {key: value for key, value in fits.items() if key.startswith(method) and value > -np.inf}
                    top = max(known, key=lambda key: known[key], default="")
                    best += f"{known[top]:6.2f} {top:11}" if top else f"{'-':>6} {method:11}"
            p_values = [whiteness(each) for each in errors]
            print(
                f"{name:26} {seed:4d} {simulated:9.1f} {fit:8.2f} {p_values[0]:8.1g} {p_values[1]:8.1g}  {best}",
                flush=True,
            )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("control", "foretell", "predict"))
    parser.add_argument("--seeds", type=int, default=None)
    parser.add_argument("--name", action="append")
    parser.add_argument("--no-peers", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.what == "control":
        control_table(options.name or list(CONTROL), options.seeds or 25)
    elif options.what == "predict":
        predict_table(options.name or list(PREDICTED), options.seeds or 2, not options.no_peers)
    else:
        foretell_table(options.name or list(PROCESS), options.seeds or 2, not options.no_peers)


if __name__ == "__main__":
    main()

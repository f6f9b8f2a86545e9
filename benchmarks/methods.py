"""The methods that `peers` holds beside each other, each behind the same call.

A method is given the recording, the order and one of its own settings (horizon, step size), and returns what it
identified.  Packages that are not installed are left out by name, never by an error.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

import ph_control as phc

from .recordings import Recording

Array = NDArray[np.float64]

EPOCHS = 1500
RATES = (0.02, 0.1)  # those of the paper's two experiments
MORE_RATES = (*RATES, 0.005, 0.001, 0.0001)
HORIZONS = (10, 20, 40, 80)  # block rows of the subspace methods


@dataclass(frozen=True)
class Model:
    """What a method identified: natural frequencies (n,), NaN where it found none, and its response from rest.

    `steps` is the number of steps of a descent: fewer than asked for if it left the range of doubles.
    """

    d: Array
    response: Callable[[Array], Array]
    steps: int = EPOCHS


@dataclass(frozen=True)
class Method:
    """A named method, the package it needs, and its settings: all are tried, the best one counts.

    Setting None stands for the defaults of the package.
    """

    name: str
    identify: Callable[[Recording, Any, int], Model]
    settings: tuple[Any, ...] = (None,)
    package: str = "ph_control"

    @property
    def installed(self) -> bool:
        """Whether its package is there."""
        return importlib.util.find_spec(self.package) is not None

    @property
    def state_space(self) -> bool:
        """Whether it identifies a state space of any kind, with a horizon for its setting."""
        return self.package not in ("ph_control", "numba")


def _pem(recording: Recording, setting: None, seed: int) -> Model:
    n, h, method = len(recording.d), recording.h, recording.method
    result = phc.pem((recording.u, recording.y), order=n, dt=h, method=method, structure="lossless")

    def response(u: Array) -> Array:
        t = h * np.arange(float(len(u)))
        return np.asarray(
            phc.forced_response(result.system, t, u, method=method, return_states=False, intersample="zoh").outputs
        )

    return Model(result.d, response)


# --- the paper's scheme ----------------------------------------------------------------------------------------------


def _gradient(parameters: str, optimizer: str) -> Callable[[Recording, float, int], Model]:
    def identify(recording: Recording, rate: float, seed: int) -> Model:
        n, start = len(recording.d), kind_start(recording, parameters, seed)
        result = phc.gradient_descent(
            (recording.u, recording.y), n, dt=recording.h, parameters=parameters, optimizer=optimizer,
            learning_rate=rate, epochs=EPOCHS, initial_guess=(start[:n], start[n : -2 * n], start[-2 * n :]),
        )  # fmt: skip
        response = _euler_response(result.d, result.r, recording.h)
        return Model(np.sort(result.d), response, len(result.loss_history) - 1)

    return identify


def _compiled(parameters: str, optimizer: str) -> Callable[[Recording, float, int], Model]:
    def identify(recording: Recording, rate: float, seed: int) -> Model:
        from .compiled_gradient import descend

        n, natural = len(recording.d), parameters == "natural"
        found = descend(
            recording.u, recording.y, recording.h, kind_start(recording, parameters, seed), natural=natural,
            adam=optimizer == "adam", rate=rate, epochs=EPOCHS,
        )  # fmt: skip
        d, p = found.theta[:n], found.theta[n : -2 * n]
        r = p[:n] ** 2 + p[n:] ** 2 if natural else p
        return Model(np.sort(d), _euler_response(d, r, recording.h), len(found.losses) - 1)

    return identify


def kind_start(recording: Recording, parameters: str, seed: int) -> Array:
    """Random start `(d, v or r, s0)`: its band, its mean weight and its state of rest are those of the truth."""
    rng, n = np.random.default_rng([seed, 2]), len(recording.d)
    d = np.sort(rng.uniform(0.5 * recording.d[0], 1.2 * recording.d[-1], n))
    size = float(recording.r.mean())
    if parameters == "natural":
        p = rng.standard_normal(2 * n) * np.sqrt(size / 2)
    else:
        p = rng.exponential(size, n)
    return np.concatenate([d, p, np.zeros(2 * n)])


def disagreement(recording: Recording, parameters: str, optimizer: str, rate: float, epochs: int) -> float:
    """Largest relative difference between the losses of the compiled steps and of the library's."""
    from .compiled_gradient import descend

    n, start = len(recording.d), kind_start(recording, parameters, 0)
    ours = phc.gradient_descent(
        (recording.u, recording.y), n, dt=recording.h, parameters=parameters, optimizer=optimizer, learning_rate=rate,
        epochs=epochs, initial_guess=(start[:n], start[n : -2 * n], start[-2 * n :]),
    ).loss_history  # fmt: skip
    compiled = descend(
        recording.u, recording.y, recording.h, start, natural=parameters == "natural", adam=optimizer == "adam",
        rate=rate, epochs=epochs,
    ).losses  # fmt: skip
    if len(ours) != len(compiled):
        return np.inf
    return float(np.max(np.abs(compiled - ours) / ours))


def _euler_response(d: Array, r: Array, h: float) -> Callable[[Array], Array]:
    """The scheme predicts by Euler's rule, as it learns."""

    def response(u: Array) -> Array:
        y = np.zeros(len(u))
        with np.errstate(over="ignore", invalid="ignore"):
            for frequency, weight in zip(d, r, strict=True):
                A = np.array([[0.0, frequency], [-frequency, 0.0]])
                y += _recursion(np.eye(2) + h * A, np.array([h, 0.0]), np.array([weight * frequency, 0.0]), 0.0, u)
        return y

    return response


# --- state-space methods ---------------------------------------------------------------------------------------------


def _era(recording: Recording, setting: int | None, seed: int) -> Model:
    """Markov parameters by least squares, then the eigensystem realisation of all of them."""
    n = len(recording.d)
    markov = ct.markov(recording.y, recording.u, setting)
    size = None if setting is None else (setting - 1) // 2
    system, _ = ct.eigensys_realization(markov, 2 * n, m=size, n=size)
    return _discrete(recording, system.A, system.B, system.C, system.D)


def _nfoursid(recording: Recording, setting: int | None, seed: int) -> Model:
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    frame = pd.DataFrame({"u": recording.u, "y": recording.y})
    rows = {} if setting is None else {"num_block_rows": setting}
    search = NFourSID(frame, output_columns=["y"], input_columns=["u"], **rows)
    search.subspace_identification()
    system, _ = search.system_identification(rank=2 * len(recording.d))
    return _discrete(recording, system.a, system.b, system.c, system.d)


def _sippy(name: str) -> Callable[[Recording, int | None, int], Model]:
    def identify(recording: Recording, setting: int | None, seed: int) -> Model:
        from sippy_unipi import system_identification

        horizons = {} if setting is None else {"SS_f": setting, "SS_p": setting}
        with contextlib.redirect_stdout(io.StringIO()):
            system = system_identification(
                recording.y, recording.u, name, SS_fixed_order=2 * len(recording.d), **horizons
            )
        return _discrete(recording, system.A, system.B, system.C, system.D)

    return identify


def _okid(recording: Recording, setting: int | None, seed: int) -> Model:
    import ssid

    matrices = ssid.system(recording.u, recording.y, method="okid-era", m=setting, r=2 * len(recording.d))
    return _discrete(recording, *matrices)


def _discrete(recording: Recording, A: Any, B: Any, C: Any, D: Any) -> Model:
    """Model of a discrete-time state space; a mode is a pair of complex poles."""
    A, b, c = np.asarray(A), np.ravel(B), np.ravel(C)
    feedthrough = float(np.ravel(D)[0])
    n, h = len(recording.d), recording.h
    poles = np.linalg.eigvals(A)
    upper = poles[poles.imag > 0]
    d = np.sort((upper.imag if recording.method == "euler" else np.angle(upper)) / h)
    d = np.concatenate([d, np.full(max(0, n - len(d)), np.nan)])[:n]
    return Model(d, lambda u: _recursion(A, b, c, feedthrough, u))


def _recursion(A: Array, b: Array, c: Array, feedthrough: float, u: Array) -> Array:
    x, y = np.zeros(len(b)), np.empty(len(u))
    with np.errstate(over="ignore", invalid="ignore"):
        for k, now in enumerate(u):
            y[k] = c @ x + feedthrough * now
            x = A @ x + b * now
    return y


COORDINATES = {"natural": "(d, v)", "unique": "(d, r)"}

METHODS = (
    Method("ph_control pem", _pem),
    *(Method(f"paper, {name}, its rates", _gradient(kind, "plain"), RATES) for kind, name in COORDINATES.items()),
    *(
        Method(f"paper, {name}, {label}, compiled", _compiled(kind, optimizer), rates, "numba")
        for optimizer, label, rates in (
            ("plain", "its rates", RATES),
            ("plain", "more rates", MORE_RATES),
            ("adam", "Adam", MORE_RATES),
        )
        for kind, name in COORDINATES.items()
    ),
    Method("python-control markov + ERA", _era, (50, 100, 200, 400), "control"),
    Method("nfoursid N4SID", _nfoursid, HORIZONS, "nfoursid"),
    *(Method(f"SIPPY {name}", _sippy(name), HORIZONS, "sippy_unipi") for name in ("N4SID", "MOESP", "CVA", "PARSIM-K")),
    Method("ssid OKID-ERA", _okid, (50, 100, 200), "ssid"),
)

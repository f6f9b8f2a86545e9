"""Values for the fuzzer: what a call is meant to get, and what an unlucky or hostile user gives it.

Every value is a function of a generator of random numbers, so that a call can be made again from its seed.
"""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import scipy.io
import scipy.sparse

import ph_control as phc

Rng = np.random.Generator


def pick(rng: Rng, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


# --- what calls are meant to get -----------------------------------------------------------------------------------


class Draw:
    """Valid arguments of one call: sizes are drawn once, so that matrices fit one another."""

    def __init__(self, rng: Rng) -> None:
        self.rng = rng
        self.n = int(rng.integers(1, 5))
        self.m = int(rng.choice([1, 1, 1, 2]))
        self.record = pick(rng, ("small", "odd"))

    def __call__(self, name: str, owner: str = "") -> Any:
        """Value of the parameter `name` of the callable `owner`."""
        for key in (f"{owner}.{name}", name):
            if key in ROLES:
                return ROLES[key](self)
        raise KeyError(f"no valid values are known for {name!r} of {owner}; add them to ROLES")

    def knows(self, name: str, owner: str = "") -> bool:
        return name in ROLES or f"{owner}.{name}" in ROLES

    def frequencies(self) -> Any:
        """Mostly apart; now and then equal, nearly equal, or decades apart."""
        d = np.cumsum(self.rng.uniform(0.2, 2.0, self.n)) * float(self.rng.choice([1.0, 1.0, 1e-6, 1e6]))
        odd: tuple[Callable[[], Any], ...] = (
            lambda: np.full(self.n, d[0]), lambda: d[0] * (1 + 1e-14 * self.rng.integers(0, 9, self.n)),
            lambda: 10.0 ** self.rng.uniform(-40, 40, self.n), lambda: d[::-1].copy(),
        )  # fmt: skip
        return pick(self.rng, odd)() if self.n and self.rng.random() < 0.2 else d

    def weights(self) -> Any:
        v = self.rng.standard_normal(2 * self.n)
        return v * self.rng.integers(0, 2, 2 * self.n) if self.rng.random() < 0.2 else v

    def hamiltonian(self) -> Any:
        """Mostly well conditioned; now and then in units decades apart, or of whole numbers."""
        M = self.rng.standard_normal((2 * self.n, 2 * self.n))
        Q = M @ M.T + 0.1 * np.eye(2 * self.n)
        odd = self.rng.random()
        if odd < 0.1:
            unit = 10.0 ** self.rng.uniform(-20, 20, 2 * self.n)
            return (Q * unit).T * unit
        return np.diag(self.rng.integers(1, 4, 2 * self.n).astype(float)) if odd < 0.2 else Q

    def semidefinite(self) -> Any:
        return self.rng.choice([self.hamiltonian, lambda: np.diag(self.rng.choice([0.0, 1.0, 4.0], 2 * self.n))])()

    def symplectic(self) -> Any:
        M = self.rng.standard_normal((2 * self.n, 2 * self.n))
        return phc.williamson(M @ M.T + 0.1 * np.eye(2 * self.n))[1]

    def ports(self) -> Any:
        B = self.rng.standard_normal((2 * self.n, self.m))
        return B[:, 0] if self.m == 1 and self.rng.random() < 0.5 else B

    def skew(self) -> Any:
        M = self.rng.standard_normal((2 * self.n, 2 * self.n))
        return M - M.T

    def stiffness(self) -> Any:
        M = self.rng.standard_normal((self.n, self.n))
        return M @ M.T

    def pair(self) -> tuple[Any, Any]:
        return self.frequencies(), self.weights()

    def system(self) -> Any:
        return pick(self.rng, pool("system"))

    def lossless(self) -> Any:
        return pick(self.rng, pool("PortHamiltonian"))

    def any_system(self) -> Any:
        return pick(self.rng, pool("system") + pool("foreign") + pool("modes"))

    def shown(self) -> Any:
        several = self.rng.random() < 0.2
        choice = pool("system") + pool("modes") + pool("foreign")[:3]
        return [pick(self.rng, choice) for _ in range(2)] if several else pick(self.rng, choice)

    def omega(self) -> Any:
        return pick(self.rng, [1.3, np.linspace(0.1, 5, 7), np.logspace(-3, 3, 5), self.frequencies(), [1.0, 2.0]])

    def points(self) -> Any:
        return pick(self.rng, [1j, 0.0, np.array([1 + 1j, 2.0]), 1j * self.frequencies(), complex(np.inf), [0.5j]])

    def time(self) -> Any:
        h = pick(self.rng, [0.1, 1e-3, 0.5])
        return h * np.arange(int(self.rng.integers(2, 40))) + pick(self.rng, [0.0, 0.0, 2.0])

    def level(self) -> float:
        return float(self.rng.uniform(0.5, 0.999))

    def data(self) -> Any:
        return pick(self.rng, pool("data"))


def _oscillators(theta: Any) -> Any:
    """Two modes by a frequency and a damping ratio."""
    return phc.ph(phc.modes(theta[0] * np.array([1.0, 2.5]), [1.0, 0.5], damping=theta[-1]))


def _label(draw: Draw) -> Any:
    return pick(draw.rng, ["a plant", None, ["one"], ["one", "two"]])


def _axes(draw: Draw) -> Any:
    rows = pick(draw.rng, [1, 2])
    return plt.subplots(rows, 1)[1]


def _permutation(draw: Draw) -> Any:
    return draw.rng.permutation(draw.n)


def _choice(*values: Any) -> Callable[[Draw], Any]:
    return lambda draw: pick(draw.rng, values)


def _of(kind: str) -> Callable[[Draw], Any]:
    return lambda draw: pick(draw.rng, pool(kind))


def _model(draw: Draw) -> Any:
    return pick(draw.rng, pool("PEMResult") + pool("system")[:4] + pool("modes")[:2])


def _inputs(draw: Draw) -> Any:
    return pick(draw.rng, [0.0, 1.0, draw.rng.standard_normal(10)])


def _order(draw: Draw) -> Any:
    return pick(draw.rng, [1, 1, 2, "auto", np.int64(1)])


def _integers(*values: int) -> Callable[[Draw], Any]:
    return lambda draw: pick(draw.rng, [*values, np.int64(values[0])])


def _file(kind: str) -> Callable[[Draw], Any]:
    return lambda draw: written(draw.rng, kind)


def _coefficients(which: int) -> Callable[[Draw], Any]:
    return lambda draw: phc.modes([1.0, 2.5, 4.0][: draw.n], [1.0, 0.5, 2.0][: draw.n]).coefficients()[which]


METHODS = ("exact", "midpoint", "euler")
HOLDS = ("zoh", "foh")

# name of a parameter, with that of the callable before it where it means something else there
_JOINS = ("couple", "gyrator", "transformer")

ROLES: dict[str, Callable[[Draw], Any]] = {
    "Q": Draw.hamiltonian,
    "affine.Q": Draw.hamiltonian,
    "ph.Q": lambda draw: draw.any_system() if draw.rng.random() < 0.4 else draw.semidefinite(),
    "williamson_semidefinite.Q": Draw.semidefinite,
    "B": Draw.ports,
    "R": lambda draw: np.diag(draw.rng.uniform(0.0, 1.0, 2 * draw.n)),
    "ph.P": lambda draw: np.zeros((2 * draw.n, draw.m)),
    "N": lambda draw: np.zeros((draw.m, draw.m)),
    "ph.S": lambda draw: np.eye(draw.m), "DissipativePortHamiltonian.S": lambda draw: np.eye(draw.m),
    "sensors": lambda draw: draw.rng.standard_normal((1, 2 * draw.n)),
    "damping_injection.gain": lambda draw: pick(draw.rng, [0.5, np.eye(draw.m), phc.lqg(pool("system")[0])]),
    "damping_plot.controller": lambda draw: pick(draw.rng, [0.5, 2.0]),
    "fit_many.recordings": lambda draw: [_record(1)[1:]] * int(draw.rng.integers(0, 3)),
    "nearest_passive.sys_or_result": Draw.any_system,
    "interconnect.systems": lambda draw: [phc.ph(draw.hamiltonian(), draw.ports()) for _ in range(2)],
    "interconnect.F": lambda draw: np.kron([[0.0, -1.0], [1.0, 0.0]], np.eye(draw.m)),
    **{f"{join}.first": lambda draw: phc.ph(draw.hamiltonian(), draw.ports()) for join in _JOINS},
    **{f"{join}.second": lambda draw: phc.ph(draw.hamiltonian(), draw.ports()) for join in _JOINS},
    "ports": lambda draw: (0, 0),
    "ratio": lambda draw: float(draw.rng.uniform(0.5, 2.0)),
    "report": _of("PassivityReport"),
    "affine.B": lambda draw: draw.rng.standard_normal(2 * draw.n),
    "J": Draw.skew,
    "A": lambda draw: phc.symplectic_form(draw.n) @ draw.hamiltonian(),
    "S": Draw.symplectic,
    "d": Draw.frequencies, "d1": Draw.frequencies, "d2": Draw.frequencies,
    "v": Draw.weights, "v1": Draw.weights, "v2": Draw.weights,
    "r": lambda draw: draw.rng.uniform(0.0, 2.0, draw.n),
    "nu": lambda draw: draw.rng.standard_normal((draw.n, draw.m)) + 1j * draw.rng.standard_normal((draw.n, draw.m)),
    "rigid": lambda draw: draw.rng.standard_normal((int(draw.rng.integers(0, 2)), draw.m)),
    "modes.d": lambda draw: pick(draw.rng, pool("system")) if draw.rng.random() < 0.3 else draw.frequencies(),
    "a": _coefficients(0), "c": _coefficients(1),
    "mantissa": lambda draw: draw.rng.standard_normal(draw.n),
    "exponent": lambda draw: draw.rng.integers(-9, 9, draw.n),
    "M": lambda draw: draw.stiffness() + 0.1 * np.eye(draw.n),
    "K": Draw.stiffness,
    "from_second_order.F": lambda draw: draw.rng.standard_normal((draw.n, draw.m)),
    "SecondOrderSystem.F": lambda draw: draw.rng.standard_normal((draw.n, draw.m)),
    "NoiseModel.covariance": lambda draw: 0.1 * np.eye(2), "NoiseModel.dt": _choice(0.1, 1.0),
    "NoiseModel.driven.system": lambda draw: ct.ss(-np.eye(2), np.eye(2), np.eye(2), 0),
    "NoiseModel.driven.entry": lambda draw: draw.rng.standard_normal((2, 1)),
    "NoiseModel.driven.intensity": lambda draw: np.array([[0.5]]),
    "NoiseModel.driven.covariance": lambda draw: 0.1 * np.eye(2), "NoiseModel.driven.dt": _choice(0.1, 1.0),
    "SecondOrderSystem.C": Draw.stiffness,
    "SecondOrderSystem.sensors": lambda draw: {"acceleration": draw.rng.standard_normal((1, draw.n))},
    "from_second_order.C": Draw.stiffness,
    "from_second_order.G": lambda draw: np.triu(np.ones((draw.n, draw.n)), 1) - np.tril(np.ones((draw.n, draw.n)), -1),
    "from_second_order.modes": _choice(None, None, 1),
    "from_second_order.band": _choice(None, None, (0.0, 2.0)),
    "from_second_order.eigensolver": _choice(None),
    "from_second_order.sensors": lambda draw: {"acceleration": draw.rng.standard_normal((1, draw.n))},
    "C": lambda draw: draw.rng.uniform(0.5, 2, draw.n), "lc_circuit.L": lambda draw: draw.rng.uniform(0.5, 2, draw.n),
    "masses": lambda draw: draw.rng.uniform(0.5, 2, draw.n),
    "stiffnesses": lambda draw: draw.rng.uniform(0.5, 2, draw.n - 1),
    "ground": lambda draw: draw.rng.uniform(0, 2, draw.n),
    "port": lambda draw: pick(draw.rng, [0, [0]]),
    "n": _integers(1, 2, 3), "lift.m": _integers(3, 5, 4), "lift_morphism.m": _integers(3, 5, 4),
    "condense": _choice(False, True),
    "damping": lambda draw: draw.rng.uniform(0, 0.05, draw.n),
    "sys": Draw.system, "sys1": Draw.system, "sys2": Draw.system, "source": Draw.lossless, "target": Draw.lossless,
    "same_filter.sys1": Draw.any_system, "same_filter.sys2": Draw.any_system,
    "is_even.sys": Draw.any_system, "is_odd.sys": Draw.any_system, "minreal.sys": Draw.any_system,
    "sysdata": Draw.shown,
    "forced_response.sysdata": Draw.any_system, "step_response.sysdata": Draw.any_system,
    "impulse_response.sysdata": Draw.any_system, "initial_response.sysdata": Draw.any_system,
    "stability_margins.sysdata": Draw.any_system, "margin.args": Draw.any_system,
    "kalman_decomposition.sys": Draw.lossless, "lift.sys": Draw.lossless, "observable_morphism.sys": Draw.lossless,
    "lift_morphism.sys": Draw.lossless, "canonical_margins.sys": Draw.lossless, "energy_balance.sys": Draw.lossless,
    "L": lambda draw: draw.symplectic(),
    "sigma": _permutation, "theta": lambda draw: draw.rng.uniform(-4, 4, draw.n),
    "P": lambda draw: np.eye(draw.n)[draw.rng.permutation(draw.n)],
    "ReducedGroupoid.A": lambda draw: np.eye(2 * draw.n), "ReducedGroupoid.is_arrow.A": lambda draw: np.eye(2 * draw.n),
    "padding": lambda draw: pick(draw.rng, [None, "zero", "spread", draw.rng.uniform(1, 2, 3)]),
    "rtol": _choice(None, 1e-9, 0.0, 1e-3),
    "h": lambda draw: float(draw.rng.uniform(0.01, 1)),
    "method": _choice(*METHODS), "intersample": _choice(*HOLDS),
    "stability_margins.method": _choice("best", "poly", "frd"),
    "omega": Draw.omega, "s": Draw.points, "x": Draw.points, "z": lambda draw: draw.rng.standard_normal(2 * draw.n),
    "time": Draw.time, "timepts": Draw.time, "T": Draw.time, "timepts_num": _integers(5, 20),
    "inputs": _inputs, "U": _inputs,
    "initial_state": _choice(0.0, 0.0, 1.0), "X0": _choice(0.0),
    "input_indices": _choice(None, 0), "output_indices": _choice(None, 0),
    "transpose": _choice(False, True), "return_states": _choice(False, True), "squeeze": _choice(None, True, False),
    "warn_infinite": _choice(True, False), "returnall": _choice(False, True), "epsw": _choice(0.0, 1e-6),
    "level": Draw.level, "confidence": lambda draw: pick(draw.rng, [0.99, 0.9]),
    "bode_plot.confidence": lambda draw: pick(draw.rng, [None, True, *pool("PEMResult")]),
    "step_plot.confidence": lambda draw: pick(draw.rng, [None, True, *pool("PEMResult")]),
    "impulse_plot.confidence": lambda draw: pick(draw.rng, [None, True, *pool("PEMResult")]),
    "k": _integers(1, 3, 10), "rng": lambda draw: pick(draw.rng, [None, 0, np.random.default_rng(1)]),
    # identification
    "data": Draw.data, "record": Draw.data, "dt": _choice(None, None, 0.1), "order": _order,
    "excitation.order": lambda draw: pick(draw.rng, [1, 2, [1.0, 2.0], *pool("system")[:2]]),
    "gradient_descent.order": _integers(1, 2), "orders": lambda draw: pick(draw.rng, [1, 2, [1, 2]]),
    "excitation.data": lambda draw: pick(draw.rng, [draw.data(), np.sin(np.arange(60.0))]),
    "PEMResult.predict.data": lambda draw: pick(draw.rng, [np.ones(12), *pool("data")]),
    "predict.u": lambda draw: np.ones(12), "u": lambda draw: np.ones(12),
    "pem.initial_state": _choice("estimate", "zero"), "compare.initial_state": _choice("estimate", "zero"),
    "base_motion.masses": _choice(None, [1.0]), "base": lambda draw: pick(draw.rng, [None, np.ones(draw.n)]),
    "base_motion.model": lambda draw: pick(draw.rng, [*pool("PEMResult")[:2], *pool("system")[:2]]),
    "for_": _choice("damping_ratios", "natural_frequencies", "poles", "residues"), "rms": _choice(None, 1.0),
    "peak": _choice(1.0, 2.0), "samples": _integers(60, 120), "design_input.dt": _choice(0.1),
    "design_input.noise_std": _choice(0.1), "design_input.band": _choice(None, (0.5, 20.0)),
    "design_input.model": lambda draw: pick(draw.rng, [*pool("PEMResult")[:2], *pool("system")[:2]]),
    "excitation.initial_state": _choice("estimate", "zero"), "order_selection.initial_state": _choice("estimate"),
    "residual_analysis.initial_state": _choice("estimate", "zero"),
    "PEMResult.predict.initial_state": _choice(None, "fitted", "final", "zero", "estimate"),
    "GradientResult.predict.initial_state": _choice("fitted", "zero"),
    "offset": _choice(False, True), "quantity": _choice("velocity", "displacement", "acceleration"),
    "modes_plot.quantity": _choice("kappa", "r"), "representation": _choice("observable", "controllable"),
    "initial_guess": lambda draw: pick(draw.rng, [None, ([1.0], [1.0]), *pool("modes")[:2]]),
    "gradient_descent.initial_guess": _choice(None),
    "weights": lambda draw: pick(draw.rng, [None, np.ones(30)]), "noise_std": _choice(None, 0.1),
    "update_model.f": lambda draw: _oscillators, "update_model.theta0": _choice([1.0, 0.02], {"d": 1.2, "zeta": 0.01}),
    "update_model.result": _of("PEMResult"), "update_model.prior": _choice(None, 0.5, [1.0, 0.01]),
    "update_model.outputs": _choice(None, [0]), "update_model.modes": _choice(None, [0]),
    "update_model.quantities": _choice(None, ["natural_frequencies"], ["natural_frequencies", "shapes"]),
    "update_model.bounds": _choice(None, (0.0, np.inf)), "pem.bounds": _choice(None, None, (0.0, np.inf)),
    "pem.model": lambda draw: pick(draw.rng, [None, None, None, _oscillators]),
    "pem.parameters": _choice(None, None, None, [1.0, 0.02]), "read_netlist.parameters": _choice(None, None, ["R1"]),
    "criterion": _choice("bic", "aic", "aicc"), "pem.criterion": _choice("bic", "aic", "aicc", "holdout"),
    "max_order": _integers(1, 2), "workers": lambda draw: pick(draw.rng, [1, map, lambda f, xs: [f(x) for x in xs]]),
    "progress": lambda draw: _progress(),
    "callback": lambda draw: pick(draw.rng, [None, lambda progress: None, _stop]),
    "holdout": _choice(0.0, 0.3), "parameters": _choice("natural", "unique"), "optimizer": _choice("plain", "adam"),
    "learning_rate": _choice(0.1, 1e-3), "epochs": _integers(1, 5), "validation": _choice(None, 0.3),
    "model": _model, "models": _model, "labels": _choice(None, "one", ["one"]), "lags": _choice(None, 5),
    "experiment": _integers(0),
    # data of results
    "response": _of("response"), "balance": _of("EnergyBalance"), "comparison": _of("Comparison"),
    "selection": _of("OrderSelection"), "analysis": _of("ResidualAnalysis"),
    "fit_plot.time": lambda draw: pick(draw.rng, [np.arange(12) * 0.1, *pool("PEMResult")]),
    "measured": lambda draw: draw.rng.standard_normal(12), "predicted": lambda draw: draw.rng.standard_normal(12),
    "spectral_estimate.data": _of("response"), "segments": _integers(2, 4),
    # pictures
    "bode_plot.data": lambda draw: pick(draw.rng, [None, *pool("response")]),
    "step_plot.data": lambda draw: pick(draw.rng, [None, *pool("response")]),
    "impulse_plot.data": lambda draw: pick(draw.rng, [None, *pool("response")]),
    "shapes": lambda draw: pick(draw.rng, [_shapes(draw), _shapes(draw), *pool("modes")]),
    "mac_plot.other": lambda draw: pick(draw.rng, [None, _shapes(draw)]),
    "positions": lambda draw: pick(draw.rng, [None, *(draw.rng.uniform(size=(3, k)) for k in (1, 2, 3))]),
    "shape_plot.poles": lambda draw: 1j * draw.frequencies() - 0.01,
    **{f"{name}.modes": _choice(None, [0], [0, -1]) for name in ("shape_plot", "circle_plot")},
    "frf_plot.outputs": _choice(None, [0], [-1, 0]), "frf_plot.inputs": _choice(None, [0]),
    "circle_plot.output": _choice(None, 0), "circle_plot.input": _choice(None, 0),
    **{f"nyquist_plot.{name}": _choice(None, [0]) for name in ("outputs", "inputs")},
    "nyquist_plot.model": Draw.any_system, "frf_plot.model": Draw.any_system, "circle_plot.model": Draw.any_system,
    "stabilisation_plot.poles": lambda draw: [1j * draw.frequencies()[:k] - 0.01 for k in range(1, draw.n + 1)],
    "stabilisation_plot.orders": _choice(None), "chosen": _choice(None, 1), "stabilisation_plot.data": _of("response"),
    "frequency_tolerance": _choice(0.01, 0.1), "damping_tolerance": _choice(0.05), "least_mac": _choice(0.9, 1.0),
    "tests": _of("PEMResult"),
    "PEMResult.compare.other": _of("PEMResult"), "PEMResult.changed.parameters": _choice("all", "poles"),
    "fit_many.reference": lambda draw: pick(draw.rng, [None, *pool("PEMResult")]),
    "false_alarms": _choice(0.001, 0.05), "shift": _choice(0.5, 1.0, 3.0),
    "position_label": _choice(None, "Place"), "position_unit": _choice(None, "m"), "shape_unit": _choice(None, "1/kg"),
    "omega_limits": _choice(None, [0.1, 10.0]), "omega_num": _integers(20, 50),
    **{name: _choice(False, True) for name in (
        "Hz", "dB", "deg", "plot_magnitude", "plot_phase", "wrap_phase", "display_margins", "grid", "show_legend")},
    "time_unit": _choice("s", "ms", "min"), "gain_unit": _choice(None, "m/N"), "output_unit": _choice(None, "m"),
    "energy_unit": _choice("J", None), "label": _label, "data_label": _choice(None, "measured"),
    "output_label": _choice(None, "y"), "detail": _choice("auto", None, [0.0, 0.5]), "fit_percent": _choice(None, 90.0),
    "ax": _axes, "title": _choice(None, "A title"), "legend_loc": _choice(None, "upper right"),
    "rcParams": _choice(None, {"font.size": 8}), "color": _choice(None, "C1"), "linestyle": _choice(None, "--"),
    "linewidth": _choice(None, 2.0),
    # names
    "name": _choice("plant", None), "states": lambda draw: [f"s{k}" for k in range(2 * draw.n)],
    "outputs": lambda draw: pick(draw.rng, ["y", ["y"], [f"y{k}" for k in range(draw.m)]]),
    "names.inputs": lambda draw: pick(draw.rng, ["u", ["u"], [f"u{k}" for k in range(draw.m)]]),
    # files
    "load.path": _file("json"), "read_csv.path": _file("csv"), "read_frequency_csv.path": _file("frequency"),
    "read_uff.path": _file("uff"), "read_touchstone.path": _file("s1p"), "read_mat.path": _file("table"),
    "read_frequency_mat.path": _file("table"), "read_frequency_mat.frequency": _choice("f", "t"),
    "read_frequency_mat.response": _choice("H", ["H", "y"]), "read_frequency_mat.frequency_unit": _choice("Hz"),
    "read_netlist.source": _file("cir"),
    "netlist.form": _choice(None, "foster1", "foster2", "cauer1", "cauer2", "state-space"),
    "to_c.name": _choice("plant", "loop"), "to_python.name": _choice("plant", "loop"),
    "to_c.sys": lambda draw: _sampled(), "to_python.sys": lambda draw: _sampled(),
    "netlist.kind": _choice("admittance", "impedance"),
    "parameter": _choice("Z", "Y", "S"), "read_mat.input": _choice(None, "u", False, ["u"]),
    "read_mat.output": _choice(None, "y", ["y"]), "read_mat.time": _choice(None, "t", False),
    "write_uff.result": lambda draw: pick(draw.rng, pool("PEMResult")), "places": _choice(["1+Z"], "4-Y"),
    "read_uff.input": _choice(None, "1+Z"), "read_uff.output": _choice(None, ["1+Z"]),
    "obj": lambda draw: pick(draw.rng, pool("system") + pool("modes") + pool("PEMResult")),
    "path": lambda draw: pick(draw.rng, [f"out{draw.rng.integers(100)}.json", Path(f"{draw.rng.integers(100)}.json")]),
    "overwrite": _choice(False, True), "input": _choice(None, "u", 1, False), "output": _choice(None, "y", -1, 2),
    "recording.frame": lambda draw: dict(zip("tuy", [np.arange(40.0), *draw.rng.random((2, 40))], strict=True)),
    "recording.input": _choice(None, "u", False), "recording.output": _choice(None, "y", ["y"]),
    "recording.time": _choice(None, "t"), "fs": _choice(None, 10),
    "read_csv.time": _choice(None, "t", 0, False), "header": _choice(None, True, False),
    "delimiter": _choice(None, ",", ";"), "decimal": _choice(None, ".", ","),
    **{name: _choice(None, 0, 1, 2, name) for name in ("frequency", "magnitude", "phase", "real", "imag")},
    "frequency_unit": _choice(None, "Hz", "rad/s"), "magnitude_unit": _choice(None, "dB", "linear"),
    "phase_unit": _choice(None, "deg", "rad"),
    # objects of methods
    "other": Draw.any_system, "Ts": _choice(0.1, 0.5), "form": _choice("ph", "ch", "oh"), "index": _integers(0, 1, -1),
}  # fmt: skip


def _shapes(draw: Draw) -> Any:
    """Of three sensors, as `positions` are."""
    c = draw.rng.standard_normal((2, draw.n, 3))
    return c[0] + 1j * c[1] * draw.rng.integers(0, 2)


@cache
def _progress() -> Any:
    """What a callback is called with."""
    calls: list[Any] = []
    phc.pem((None, np.cos(np.arange(30.0))), 1, dt=1.0, structure="lossless", callback=calls.append)
    return calls[0]


def _stop(progress: Any) -> None:
    raise StopIteration


def _record(seed: int, samples: int = 80, driven: bool = True, missing: bool = False) -> Any:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples) if driven else np.zeros(samples)
    plant = phc.ph(phc.modes([1.0, 2.7], [1.0, 0.4]))
    found = phc.forced_response(plant, 0.1 * np.arange(samples), u, [0.5, 0.1, 0.0, 0.2])
    y = found.outputs + 0.01 * rng.standard_normal(samples)
    if missing:
        y[3:6] = np.nan
    return found.time, u, y


def _lossy(seed: int) -> phc.DissipativePortHamiltonian:
    rng = np.random.default_rng(seed)
    n, m = 2 * (1 + seed % 3), 1 + seed % 2
    W = rng.standard_normal((n + m, n))
    W = W @ W.T
    parts = {"R": W[:n, :n], "P": W[:n, n:], "S": W[n:, n:]} if seed % 2 else {"R": W[:n, :n]}
    sensors = rng.standard_normal((1, n)) if seed == 3 else None
    return phc.ph(np.eye(n), rng.standard_normal((n, m)), **parts, sensors=sensors)


def _scaled() -> list[phc.DissipativePortHamiltonian]:
    """Critical damping, overdamping in nanoseconds and in millions of years, and a mass that hangs on nothing."""
    return [
        phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 4.0])),
        phc.ph(np.diag([1e18, 1.0]), [0.0, 1.0], R=np.diag([0.0, 1e12])),
        phc.spring_chain([1.0, 2.0], 3e-28, ground=[1e-28, 0.0], c=1e-14),
        phc.spring_chain([1.0, 2.0, 1.0], [3.0, 0.0], c=0.1),
    ]


def _as_data(t: Any, u: Any, y: Any) -> Any:
    return ct.TimeResponseData(t, y, inputs=u, issiso=True, input_labels=["force [N]"], output_labels=["v [m/s]"])


@cache
def pool(kind: str) -> list[Any]:
    """Valid objects, small, the same in every run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return list(_POOLS[kind]())


def _on_a_background() -> phc.ResponseBackground:
    """Background of a mode in series with a coil."""
    s, rng = 1j * np.linspace(0.1, 3.0, 120), np.random.default_rng(0)
    noise = 1e-3 * (rng.standard_normal(120) + 1j * rng.standard_normal(120))
    return phc.pem(ct.frd(s / (s**2 + 0.04 * s + 1) + 0.05 * s + noise, s.imag), 1, structure="free").background


def _sampled() -> ct.StateSpace:
    return phc.sample(pool("system")[0], 0.1)


def _damped_mode() -> Any:
    return phc.modes([2.0], [1.0], damping=0.05)


def _written_modes() -> list[Any]:
    phc.write_uff(pool("PEMResult")[0], "modes.uff", places=["1+Z"], overwrite=True)
    return list(phc.read_uff("modes.uff"))


def _systems() -> list[Any]:
    rng = np.random.default_rng(7)
    M = rng.standard_normal((6, 6))
    plain = [
        phc.frenkel_kontorova(2),
        phc.ph(M @ M.T + np.eye(6), rng.standard_normal(6), name="dense"),
        phc.ph(phc.modes([1.0, 3.0], [0.5, 0.0])),
        phc.spring_chain([1.0, 2.0, 1.0], [1.0, 3.0], port=[0, 2]),
        phc.ph(np.diag([1.0, 1.0, 4.0, 4.0]), [0.0, 0.0, 1.0, 0.0]),
        phc.lc_circuit([1.0, 0.5], [1.0, 2.0]),
    ]
    return [
        *plain,
        phc.ch(plain[0]), phc.oh(plain[0]), phc.ch([1.0, 2.0], [1.0, 0.5, 0.0, 1.0]), phc.oh([2.0], [1.0, 0.0]),
        phc.affine(np.eye(4) + 0.1, [1.0, 0.0, 0.0, 2.0]),
    ]  # fmt: skip


def _foreign() -> list[Any]:
    return [
        ct.tf([1, 0], [1, 0, 4]),
        ct.ss(phc.frenkel_kontorova(2).A, phc.frenkel_kontorova(2).B, phc.frenkel_kontorova(2).C, 0),
        ct.zpk([0], [1j, -1j], 1.0),
        ct.ss(np.diag([-1.0, -2.0]), [[1], [1]], [[1, 1]], 0),
        ct.tf([1, 2, 3], [1, 1]),
        ct.ss([[0.5]], [[1]], [[1]], 0, 0.1),
        ct.ss(np.zeros((2, 2)), np.eye(2), np.eye(2), np.ones((2, 2))),
        ct.ss([], [], [], [[1.0]]),
        ct.tf([1], [1, 0, 4]),
        ct.tf([[[1, 0], [1]], [[1], [1, 0]]], [[[1, 0, 4], [1, 2]], [[1, 2], [1, 0, 9]]]),
        ct.frd([1j, 2j, 3j, 1j], [1.0, 2.0, 3.0, 4.0]),
        phc.sample(phc.frenkel_kontorova(2), 0.1),
        ct.ss([[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]], [[0], [1], [0], [1]], [[0, 1, 0, 1]], 0),
        ct.ss(np.full((2, 2), 1e200), [[1], [1]], [[1, 1]], 0),
        ct.nlsys(lambda t, x, u, p: -x, None, inputs=1, states=1),
    ]


def _data() -> list[Any]:
    full, gaps, free = _record(1), _record(2, missing=True), _record(3, driven=False)
    w = np.linspace(0.2, 4.0, 30)
    response = phc.modes([1.0, 2.7], [1.0, 0.4]).freqresp(w).reshape(-1)
    noise = np.random.default_rng(4).standard_normal((2, 30)) @ np.eye(30)
    frd = ct.FrequencyResponseData(response + 0.01 * (noise[0] + 1j * noise[1]), w)
    return [
        _as_data(*full), _as_data(*gaps), (full[1], full[2]), (None, free[2]), [_as_data(*full), _as_data(*gaps)], frd,
        _as_data(*_record(5, samples=30)), phc.forced_response(phc.frenkel_kontorova(2), 0.1 * np.arange(50), 1.0),
    ]  # fmt: skip


_POOLS: dict[str, Callable[[], list[Any]]] = {
    "system": _systems,
    "PortHamiltonian": lambda: _systems()[:6],
    "foreign": _foreign,
    "modes": lambda: [
        phc.modes([1.0, 3.0], [0.5, 0.25]), phc.modes([2.0], [1.0]), phc.spring_chain([1.0, 2.0]).modes,
        phc.spring_chain([1.0, 2.0, 3.0], port=[0, 1]).modes,
        phc.modes([], []),
    ],
    "data": _data,
    "response": lambda: [
        _as_data(*_record(1)), phc.forced_response(phc.frenkel_kontorova(2), 0.1 * np.arange(60), np.arange(60) % 5),
        phc.forced_response(_systems()[3], 0.1 * np.arange(20), np.ones((2, 20)), return_states=True),
        phc.forced_response(phc.frenkel_kontorova(2), 0.1 * np.arange(60), 1.0, return_states=True),
    ],
}  # fmt: skip


def _fits() -> list[Any]:
    t, u, y = _record(1)
    return [
        phc.pem((u, y), 2, dt=0.1), phc.pem(_data()[5], 1),
        phc.pem([_as_data(t, u, y), _as_data(*_record(2, missing=True))], 2),
        phc.pem((None, _record(3, driven=False)[2]), 1, dt=0.1, quantity="displacement", offset=True),
        phc.pem((u, np.stack([y, -0.5 * y])), 2, dt=0.1, structure="free", ports=[(0, 0)]),
        phc.pem((None, np.stack([y, -0.5 * y])), 1, dt=0.1, structure="free"),
    ]  # fmt: skip


_POOLS |= {
    "AffineHamiltonian": lambda: _systems()[10:],
    "ControllableHamiltonian": lambda: [_systems()[6], _systems()[8]],
    "ObservableHamiltonian": lambda: [_systems()[7], _systems()[9]],
    "ModalForm": lambda: pool("modes"),
    "Symmetry": lambda: [phc.is_even(_systems()[0]), phc.is_odd(_systems()[0])],
    "CasimirSplit": lambda: [phc.split_casimirs(np.eye(3), np.ones(3), [[0, 1, 0], [-1, 0, 0], [0, 0, 0]])],
    "ScaledCoefficients": lambda: [*phc.modes([1.0, 3.0], [0.5, 0.25]).scaled_coefficients(),
                                   *phc.modes(np.arange(1.0, 200), np.ones(199)).scaled_coefficients()],
    "DissipativePortHamiltonian": lambda: [*(_lossy(k) for k in range(4)), *_scaled()],
    "PassivityReport": lambda: [phc.passivity(one) for one in (*pool("DissipativePortHamiltonian")[:2], _systems()[0])],
    "EnergyBalance": lambda: [phc.energy_balance(pool("response")[3], _systems()[0])],
    "PortHamiltonianGroupoid": lambda: [phc.PortHamiltonianGroupoid.identity(_systems()[0])],
    "ReducedGroupoid": lambda: [phc.ReducedGroupoid.identity([1.0, 2.0], [1.0, 0.0, 0.5, 1.0])],
    "NoiseModel": lambda: [phc.NoiseModel([[0.19]], 0.1, [[0.9]]), phc.NoiseModel(0.1 * np.eye(2), 1.0)],
    "SecondOrderSystem": lambda: [phc.SecondOrderSystem(np.eye(9), 2 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1),
                                                        np.eye(9)[0], C=0.1 * np.eye(9))],
    "StructuralModes": lambda: [
        phc.from_second_order(np.eye(3), np.diag([1.0, 4.0, 9.0]), np.ones(3), modes=2).structural_modes
    ],
    "PEMResult": _fits,
    "FittedChannels": lambda: [
        one for result in pool("PEMResult") for one in result.experiments if isinstance(one, phc.FittedChannels)
    ],
    "ModalSamples": lambda: [one.sample(4, 0) for one in pool("PEMResult")],
    "Bootstrap": lambda: [pool("PEMResult")[0].bootstrap(3)],
    "FitTable": lambda: [phc.fit_many([_record(1)[1:], (None, None)], dt=0.1)],
    "ModeTracks": lambda: [pool("FitTable")[0].track()],
    "ModeComparison": lambda: [pool("PEMResult")[0].compare(pool("PEMResult")[0])],
    "ChangeTest": lambda: [pool("PEMResult")[0].changed(_record(5)[1:], dt=0.1)],
    "ControlChart": lambda: [
        phc.fit_many([_record(1)[1:], (None, None)], dt=0.1, reference=pool("PEMResult")[0]).changes()
    ],
    "OptimalDamping": lambda: [phc.optimal_damping(phc.spring_chain([1.0, 1.0], ground=1.0))],
    "RecordingFitted": lambda: [phc.RecordingFitted(1, 0, 2, "first", "consistent with the record")],
    "ModelUpdate": lambda: [phc.update_model(_oscillators, [1.0, 0.02], pool("PEMResult")[0])],
    "FittedParameters": lambda: [pool("ModelUpdate")[0].fitted_parameters],
    "NetlistFunction": lambda: [phc.read_netlist("V1 1 0\nR1 1 2 5\nL1 2 3 1\nC1 3 0 1\n", parameters=["R1", "C1"])],
    "Stabilisation": lambda: [pool("PEMResult")[0].stabilisation(1)],
    "UniversalModes": lambda: _written_modes(),
    "Excitation": lambda: [phc.excitation((u, None), 2, dt=0.1) for u in (np.sin(np.arange(80.0)), _record(1)[1])],
    "BaseMotion": lambda: [phc.from_second_order(np.eye(2), np.diag([1.0, 4.0]), base=[1.0, 1.0]).base_motion],
    "PlantExcitation": lambda: [phc.excitation((np.sin(np.arange(80.0)), None), _damped_mode(), dt=0.1)],
    "InputDesign": lambda: [phc.design_input(_damped_mode(), 80, 0.1, peak=1.0, noise_std=0.1)],
    "GradientResult": lambda: [phc.gradient_descent(_record(1)[1:], 1, dt=0.1, epochs=2)],
    "OrderSelection": lambda: [phc.order_selection(_record(1)[1:], 2, dt=0.1)],
    "FittedExperiment": lambda: [
        one for result in pool("PEMResult") for one in result.experiments if isinstance(one, phc.FittedExperiment)
    ],
    "ResponseBackground": lambda: [_on_a_background()],
    "ResidualAnalysis": lambda: [
        phc.residual_analysis(_record(5)[1:], pool("PEMResult")[0], dt=0.1),
        phc.residual_analysis(_data()[5], pool("PEMResult")[1]),
    ],
    "Comparison": lambda: [
        phc.compare(_record(5)[1:], pool("PEMResult")[0], _systems()[0], dt=0.1),
        phc.compare(_data()[5], pool("PEMResult")[1]),
    ],
    "Verdict": lambda: [phc.are_isomorphic(_systems()[0], _systems()[0]), phc.same_filter(*_systems()[:2])],
    "ExpressivePower": lambda: [phc.expressive_power([1.0, 1.0], [1.0, 0, 0, 0])],
    "Netlist": lambda: [phc.netlist(phc.modes([1.0, 2.0], [1.0, 0.5]), form) for form in ("foster1", "cauer2")],
    "MorphismCheck": lambda: [phc.is_morphism(np.eye(4), _systems()[0], _systems()[0])],
    "CanonicalMargins": lambda: [phc.canonical_margins(_systems()[0])],
    "KalmanDecomposition": lambda: [phc.kalman_decomposition(_systems()[2]), phc.kalman_decomposition(_systems()[4])],
}  # fmt: skip


# --- files ---------------------------------------------------------------------------------------------------------


@cache
def _contents(kind: str) -> list[bytes]:
    """Whole files of a kind."""
    if kind == "json":
        found = []
        for thing in [*pool("system"), *pool("modes"), *pool("PEMResult")[:2]]:
            path = Path("whole.json")
            phc.save(thing, path, overwrite=True)
            found.append(path.read_bytes())
        return [*found, json.dumps([1, 2]).encode(), b"{}"]
    if kind == "csv":
        t, u, y = _record(1, samples=12)
        rows = "".join(f"{a:.3f},{b:.6g},{c:.6g}\n" for a, b, c in zip(t, u, y, strict=True))
        return [
            ("t [s],u [N],y [m/s]\n" + rows).encode(), ("Time (ms),u,y\n" + rows).encode(), rows.encode(),
            ("t;u;y\n" + rows.replace(",", ";").replace(".", ",")).encode(), ("# a comment\n" + rows).encode("utf-16"),
            ('"t","u","y"\n' + rows).encode(), rows.replace(",", "\t").encode(),
        ]  # fmt: skip
    if kind == "frequency":
        w = np.linspace(0.1, 3, 12)
        rows = "".join(f"{x:.4f},{-x:.4f},{90 * x:.3f}\n" for x in w)
        heads = (
            "Frequency (Hz),Magnitude (dB),Phase (deg)\n",
            "omega [rad/s],real,imag\n",
            "f [kHz],mag,phase [rad]\n",
        )
        return [(head + rows).encode() for head in heads]
    if kind == "cir":
        coupled = (
            "t\nV1 1 0 AC 1\nR1 1 2 4.7k\nL1 2 0 1m\nL2 3 0 2u ; coil\nK1 L1 L2 .5\n+\nC1 3 0 10nF\nI1 0 3\n"
            ".param a={2*b} b=3\n.subckt s p q c=1n\nC1 p q {c*a} Rser='b'\n.ends\nX1 3 0 s c=2n\n.end\n"
        )
        return [coupled.encode(), *(one.spice().encode() for one in pool("Netlist"))]
    if kind in ("uff", "s1p", "table"):
        return [_measured(kind)]
    buffer = io.BytesIO()
    system = pool("system")[0]
    scipy.io.savemat(buffer, {"A": system.A, "B": system.B, "C": system.C, "D": system.D})
    other = io.BytesIO()
    scipy.io.savemat(other, {"num": [1.0, 0.0], "den": [1.0, 0.0, 4.0]}, do_compression=True)
    return [buffer.getvalue(), other.getvalue()]


def _measured(kind: str) -> bytes:
    """A file of another program: twelve samples, or twelve frequencies."""
    t, u, y = _record(1, samples=12)
    if kind == "s1p":
        rows = [f"{10 * k + 1} {a:.4f} {b:.4f}\n" for k, (a, b) in enumerate(zip(u, y, strict=True))]
        return ("# Hz S RI R 50\n" + "".join(rows)).encode()
    if kind == "table":
        buffer = io.BytesIO()
        scipy.io.savemat(buffer, {"t": t, "u": u, "y": y, "f": 1.0 + t, "H": u + 1j * y})
        return buffer.getvalue()
    sets = []
    for force, x in ((13, u), (12, y)):
        values = "".join(f"{v:13.5e}" + "\n" * (k % 6 == 5) for k, v in enumerate(x))
        head = f"{1:5d}{0:10d}{0:5d}{0:10d} NONE      {1:10d}{3:4d} NONE      {1:10d}{3:4d}\n"
        head += f"{2:10d}{12:10d}{1:10d}{0.0:13.5e}{0.1:13.5e}{0.0:13.5e}\n"
        head += "".join(
            f"{axis:10d}{0:5d}{0:5d}{0:5d} NONE                 NONE                \n" for axis in (17, force, 0, 0)
        )
        sets.append(f"    -1\n    58\n{'NONE' + chr(10):s}" + 4 * "NONE\n" + head + values + "    -1\n")
    return "".join(sets).encode()


_TOKENS = (
    b"nan", b"inf", b"-1e999", b"1e400", b'"', b"'", b",", b";", b"\n", b"\r\n", b"\x00", b"\xff\xfe", b"[", b"]", b"{",
    b"}", b"null", b"true", b"-", b"1" * 400, b"\xe2\x88\x92", b"1_000", b"0x10", b"[" * 2000, b"1e-320", b"A" * 3000,
)  # fmt: skip


def damaged(rng: Rng, content: bytes) -> bytes:
    """A file some of whose bytes are changed, cut out, doubled, or replaced by others that mean something."""
    data = bytearray(content)
    for _ in range(int(rng.integers(0, 4))):
        place = int(rng.integers(0, len(data) + 1))
        length = int(rng.choice([1, 1, 4, 40]))
        way = int(rng.integers(6))
        if way == 0:
            data[place : place + length] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif way == 1:
            del data[place : place + length]
        elif way == 2:
            data[place:place] = data[place : place + length]
        elif way == 3:
            data[place:place] = pick(rng, _TOKENS)
        elif way == 4:
            del data[place:]
        else:
            lines = bytes(data).split(b"\n")
            lines[int(rng.integers(len(lines)))] = pick(rng, _TOKENS)
            data = bytearray(b"\n".join(lines))
    return bytes(data)


def written(rng: Rng, kind: str) -> Any:
    """A file in the working folder with drawn content, as a name, a path or an open file."""
    content = pick(rng, _contents(kind))
    if kind == "json" and rng.random() < 0.5:
        content = _reworded(rng, content)
    content = damaged(rng, content) if rng.random() < 0.8 else content
    form = int(rng.integers(5))
    if form == 0:
        return io.BytesIO(content)
    if form == 1:
        return io.StringIO(content.decode("latin-1"))
    suffix = {"mat": "mat", "table": "mat", "json": "json", "uff": "uff", "s1p": "s1p", "cir": "cir"}.get(kind, "csv")
    name = f"drawn{int(rng.integers(8))}.{suffix}"
    Path(name).write_bytes(content)
    return Path(name) if form == 2 else name


def _reworded(rng: Rng, content: bytes) -> bytes:
    """A document with one value changed and no checksum: what `load` must hold against the kind."""
    document = json.loads(content)
    if not isinstance(document, dict) or "data" not in document:
        return content
    document.pop("sha256", None)
    place: Any = document if rng.random() < 0.1 else document["data"]
    for _ in range(6):
        key = pick(rng, list(place)) if isinstance(place, dict) else int(rng.integers(len(place)))
        if isinstance(place[key], dict | list) and place[key] and rng.random() < 0.8:
            place = place[key]
            continue
        new = (
            None,
            True,
            -1,
            0,
            1,
            2.5,
            1e300,
            -1e-300,
            "nan",
            "inf",
            "x",
            "",
            [],
            [1.0],
            [[1.0, 2.0]],
            {},
            10**12,
            2**70,
        )
        if rng.random() < 0.2:
            del place[key]
        else:
            place[key] = pick(rng, new)
        break
    return json.dumps(document).encode()


# --- what calls may get as well ------------------------------------------------------------------------------------


class Rude:
    """An object that has nothing that numpy could want."""

    def __repr__(self) -> str:
        return "Rude()"


_HUGE = (2**31, 2**63, 2**64, 10**30, 10**400)
_NUMBERS = (
    0, 1, -1, 2, 7, 0.5, 2.5, -0.0, 1e300, -1e300, 1e-300, 5e-324, 1e154, 1e-160, float("nan"), float("inf"),
    -float("inf"), 1j, 1 + 0j, complex("nan"), complex(float("inf"), 1), *_HUGE,
)  # fmt: skip
_WORDS = ("", "auto", "x", "é\u2028", "a" * 1000, "exact", "1", "nan", "best", "zoh", "\x00", "$\\frac{$", "%d {} {0}")


def _things(rng: Rng) -> Any:
    """Something of another kind than any argument."""
    makers: tuple[Callable[[], Any], ...] = (
        lambda: None, lambda: True, lambda: False, lambda: pick(rng, _WORDS), lambda: pick(rng, _WORDS).encode(),
        lambda: bytearray(b"ab"), Rude, object, lambda: Rude, lambda: len, lambda: (lambda *a, **k: None),
        lambda: {}, lambda: {"a": 1}, set, lambda: {1.0, 2.0}, lambda: range(3), lambda: (k for k in range(3)),
        lambda: [], lambda: (), lambda: [[]], lambda: [[1.0], [1.0, 2.0]], lambda: [1.0, [2.0]], lambda: [None],
        lambda: ["a", "b"], lambda: [1.0, "b"], lambda: [np.nan, 1.0], lambda: Decimal("1.5"), lambda: Fraction(1, 3),
        lambda: np.array(1.5), lambda: np.array([]), lambda: np.zeros((0, 0)), lambda: np.zeros((0, 3)),
        lambda: np.zeros((2, 2, 2)), lambda: np.array([1.0, 2.0], dtype=object), lambda: np.array([None, 1]),
        lambda: np.array(["a"]), lambda: np.array(["2020-01-01"], "datetime64[D]"), lambda: np.array([True, False]),
        lambda: np.ma.masked_array([1.0, 2.0], [True, False]), lambda: np.ma.masked_array([1.0, 2.0]),
        lambda: scipy.sparse.eye(2).tocsr(), lambda: scipy.sparse.coo_array(np.eye(4)), lambda: np.float32(0.5),
        lambda: np.longdouble(1) / 3, lambda: np.array([1.0, 2.0], dtype=np.longdouble), lambda: np.int8(3),
        lambda: np.uint64(2**63), lambda: np.bool_(True), lambda: np.random.default_rng(0), lambda: io.StringIO("1,2"),
        lambda: Ellipsis, lambda: NotImplemented, lambda: slice(None), lambda: np.zeros(3, dtype=[("a", float)]),
        lambda: np.array([10**30], dtype=object), lambda: np.array([1.0], dtype=">f8"), lambda: memoryview(b"abcd"),
    )  # fmt: skip
    return pick(rng, makers)()


def _mutated(rng: Rng, value: Any) -> Any:
    """The array, or number, that was meant, with one thing about it changed."""
    array = np.array(value)
    if array.dtype.kind not in "biufc":
        return _things(rng)
    numbers = array.astype(complex if array.dtype.kind == "c" else float)
    way = int(rng.integers(22))
    if way < 6 and numbers.size:  # one entry
        place = tuple(int(rng.integers(k)) for k in numbers.shape)
        new = pick(rng, (np.nan, np.inf, -np.inf, 0.0, -0.0, 1e300, 1e-300, -1.0, 1e155, 5e-324, numbers.flat[0]))
        numbers[place] = new
        return numbers
    if way < 9:  # size
        with np.errstate(all="ignore"):
            return numbers * pick(rng, (0.0, -1.0, 1e150, 1e-160, 1e300, 1e-300, 1e12, np.nan))
    if way < 12:  # shape
        changes: tuple[Callable[[], Any], ...] = (
            lambda: numbers[..., :-1] if numbers.ndim else numbers[None], lambda: numbers[None],
            lambda: numbers[..., None], lambda: numbers.T, lambda: numbers.ravel(),
            lambda: numbers[:0] if numbers.ndim else np.array([]),
            lambda: np.concatenate([numbers, numbers]) if numbers.ndim else np.array([numbers, numbers]),
            lambda: numbers[:1] if numbers.ndim else np.ones(3), lambda: numbers[::-1] if numbers.ndim else -numbers,
        )  # fmt: skip
        return pick(rng, changes)()
    matrix = numbers if numbers.ndim == 2 else np.atleast_2d(numbers)
    wide = np.repeat(numbers, 2, axis=-1) if numbers.ndim else np.array([numbers, numbers])
    forms: tuple[Callable[[], Any], ...] = (
        lambda: numbers + 0j, lambda: numbers + 1j, lambda: numbers.astype(object), lambda: numbers.tolist(),
        lambda: np.matrix(matrix), lambda: np.ma.masked_array(numbers), lambda: _masked(numbers),
        lambda: _locked(numbers), lambda: wide[..., ::2], lambda: np.asfortranarray(numbers),
        lambda: scipy.sparse.csr_matrix(matrix.real), lambda: numbers.real.astype(np.float32),
        lambda: numbers.real.astype(np.longdouble), lambda: [str(x) for x in numbers.ravel()],
        lambda: iter(numbers.ravel().tolist()), lambda: numbers.real.astype(">f8"),
        lambda: tuple(numbers.ravel().tolist()),
        lambda: np.nan_to_num(numbers.real).clip(-9, 9).astype(int), lambda: numbers.real > 0,
    )  # fmt: skip
    return pick(rng, forms)()


def _masked(array: Any) -> Any:
    mask = np.zeros(array.shape, bool)
    if mask.size:
        mask.flat[0] = True
    return np.ma.masked_array(array, mask)


def _locked(array: Any) -> Any:
    copy = np.array(array)
    copy.flags.writeable = False
    return copy


def hostile(rng: Rng, value: Any, name: str) -> Any:
    """A value in place of a valid one."""
    kind = rng.random()
    numeric = isinstance(value, int | float | complex | np.ndarray | list | np.generic) and not isinstance(value, bool)
    try:
        if numeric and kind < 0.55:
            return _mutated(rng, value)
        if isinstance(value, tuple) and kind < 0.55 and value:
            k = int(rng.integers(len(value)))
            return (*value[:k], hostile(rng, value[k], name), *value[k + 1 :])
    except ValueError:  # a list of lists of different lengths
        pass
    if isinstance(value, ct.TimeResponseData) and kind < 0.6:
        return _mutated_record(rng, value)
    if kind < 0.75:
        return pick(rng, _NUMBERS)
    if kind < 0.87:
        return _things(rng)
    return pick(rng, pool("foreign") + pool("system") + pool("modes") + pool("data") + pool("PEMResult"))


def _mutated_record(rng: Rng, data: Any) -> Any:
    parts = {"time": np.array(data.t), "outputs": np.array(data.y), "inputs": np.array(data.u)}
    name = pick(rng, list(parts))
    try:
        parts[name] = np.asarray(_mutated(rng, parts[name]), dtype=float)
        return ct.TimeResponseData(parts["time"], parts["outputs"], inputs=parts["inputs"])
    except Exception:  # python-control refuses it, too
        return tuple(parts.values())

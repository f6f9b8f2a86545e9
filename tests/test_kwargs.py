"""A keyword that a call does not know is an error, never ignored."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from types import FunctionType, SimpleNamespace
from typing import Any

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest

import ph_control as phc

UNKNOWN = "no_such_keyword"
REFUSAL = "unexpected keyword|unrecognized keyword|takes no arguments"


def public_callables() -> dict[str, Callable[..., Any]]:
    """Functions, constructors and methods that a user can call, by their qualified names."""
    found: dict[str, Callable[..., Any]] = {}
    for name in phc.__all__:
        value = getattr(phc, name)
        if inspect.isfunction(value):
            found[name] = value
        elif inspect.isclass(value) and not issubclass(value, Exception):
            found[name] = value
            found |= {
                f"{name}.{key}": getattr(value, key)
                for base in value.__mro__
                if base.__module__.startswith("ph_control")
                for key, member in vars(base).items()
                if not key.startswith("_") and isinstance(member, FunctionType | classmethod | staticmethod)
                # what a public class has from another one is tried there
                if base is value or base.__name__ not in phc.__all__
            }
    return found


def takes_any_keyword(function: Callable[..., Any]) -> bool:
    kinds = [p.kind for p in inspect.signature(function).parameters.values()]
    return inspect.Parameter.VAR_KEYWORD in kinds


CLOSED = sorted(name for name, function in public_callables().items() if not takes_any_keyword(function))
OPEN = sorted(name for name, function in public_callables().items() if takes_any_keyword(function))


@functools.cache
def plant() -> phc.PortHamiltonian:
    return phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0])


TESTED = SimpleNamespace(hypothesis="lossless", likelihood_ratio=1.0, dof=2, p=0.6)


@functools.cache
def fitted() -> Any:
    u = np.random.default_rng(0).standard_normal(200)
    y = phc.forced_response(plant(), 0.1 * np.arange(200), u).outputs
    return phc.pem((u, y), order=1, dt=0.1)


@functools.cache
def damped_fit() -> Any:
    record = fitted().record
    return phc.pem((record.u, record.y), order=1, dt=0.1, structure="free")


@functools.cache
def recording() -> ct.TimeResponseData:
    return phc.forced_response(plant(), 0.1 * np.arange(64), np.arange(64) % 7)


T = np.linspace(0.0, 1.0, 5)
SYSTEMS = (plant(), phc.ch([1.0], [1.0, 0.0]), phc.oh([1.0], [1.0, 0.0]), phc.affine(np.eye(2), [1, 0]))

# a valid call of each function that collects keywords, once for each way its arguments can go
CALLS: dict[str, list[Callable[..., Any]]] = {
    "OrderSelection.plot": [lambda **k: phc.order_selection(fitted().record, 2).plot(**k)],
    "PEMResult.plot": [lambda **k: fitted().plot(**k), lambda **k: damped_fit().plot(**k)],
    "Stabilisation.plot": [lambda **k: damped_fit().stabilisation(1).plot(**k)],
    "AffineHamiltonian": [lambda **k: phc.AffineHamiltonian(np.eye(2), [1, 0], **k)],
    "AffineHamiltonian.derivative": [lambda **k: phc.affine(np.eye(2), [1, 0]).derivative(**k)],
    "Comparison.plot": [lambda **k: phc.compare(fitted().record, plant()).plot(**k)],
    "ControllableHamiltonian": [lambda **k: phc.ControllableHamiltonian([1.0], [1.0, 0.0], **k)],
    "ControllableHamiltonian.port_hamiltonian": [lambda **k: phc.ch([1.0], [1.0, 0.0]).port_hamiltonian(**k)],
    "ObservableHamiltonian": [lambda **k: phc.ObservableHamiltonian([1.0], [1.0, 0.0], **k)],
    "ObservableHamiltonian.port_hamiltonian": [
        lambda **k: phc.oh([1.0], [1.0, 0.0]).port_hamiltonian(np.diag([2.0, 0.5]), **k)
    ],
    "ResidualAnalysis.plot": [lambda **k: phc.residual_analysis(fitted().record, fitted()).plot(**k)],
    "EnergyBalance.plot": [lambda **k: phc.energy_balance(recording(), plant()).plot(**k)],
    "affine": [
        lambda **k: phc.affine(np.eye(2), [1, 0], **k),
        lambda **k: phc.affine(ct.tf([1], [1, 0, 4]), **k),
        lambda **k: phc.affine(phc.affine(np.eye(2), [1, 0]), **k),
    ],
    **{f"{type(sys).__name__}.bode_plot": [lambda sys=sys, **k: sys.bode_plot(**k)] for sys in SYSTEMS},
    "bode_plot": [lambda **k: phc.bode_plot(plant(), **k)],
    "ch": [
        lambda **k: phc.ch([1.0], [1.0, 0.0], **k),
        lambda **k: phc.ch(plant(), **k),
        lambda **k: phc.ch(phc.ch(plant()), **k),
        lambda **k: phc.ch(ct.tf([1, 0], [1, 0, 4]), **k),
    ],
    "circle_plot": [lambda **k: phc.circle_plot(damped().modes.state_space(), **k)],
    "compare_plot": [lambda **k: phc.compare_plot(phc.compare(fitted().record, plant()), **k)],
    "energy_plot": [lambda **k: phc.energy_plot(phc.energy_balance(recording(), plant()), **k)],
    "frf_plot": [lambda **k: phc.frf_plot(plant(), **k)],
    "nyquist_plot": [lambda **k: phc.nyquist_plot(plant(), **k)],
    "hypothesis_plot": [lambda **k: phc.hypothesis_plot([TESTED], **k)],
    "stabilisation_plot": [lambda **k: phc.stabilisation_plot([[1j], [1j]], **k)],
    "mac_plot": [lambda **k: phc.mac_plot(np.eye(2), **k)],
    "shape_plot": [lambda **k: phc.shape_plot(np.eye(2), **k)],
    "fit_many": [lambda **k: phc.fit_many([], **k)],
    "FitTable.plot": [lambda **k: phc.fit_many([]).plot(**k)],
    "ControlChart.plot": [lambda **k: phc.fit_many([recording()], reference=fitted()).changes().plot(**k)],
    "ModeTracks.plot": [lambda **k: phc.fit_many([]).track().plot(**k)],
    "fit_plot": [lambda **k: phc.fit_plot(T, T, T, **k), lambda **k: phc.fit_plot(fitted(), **k)],
    "SecondOrderSystem": [lambda **k: phc.SecondOrderSystem(np.eye(2), np.diag([1.0, 4.0]), [1.0, 0.0], **k)],
    "from_second_order": [lambda **k: phc.from_second_order([[1.0]], [[4.0]], [1.0], **k)],
    "oh": [lambda **k: phc.oh([1.0], [1.0, 0.0], **k), lambda **k: phc.oh(plant(), **k)],
    "sample": [lambda **k: phc.sample(plant(), 0.1, **k)],
    "tf": [lambda **k: phc.tf(plant(), **k), lambda **k: phc.tf(phc.ph(np.eye(2), np.eye(2)), **k)],
    "PortHamiltonian.controllable_form": [lambda **k: plant().controllable_form(**k)],
    "PortHamiltonian.observable_form": [lambda **k: plant().observable_form(**k)],
    "DissipativePortHamiltonian": [
        lambda **k: phc.DissipativePortHamiltonian(np.eye(2), [0, 1], R=np.eye(2), **k),
    ],
    "DissipativePortHamiltonian.bode_plot": [lambda **k: damped().bode_plot(**k)],
    "passivity_plot": [lambda **k: phc.passivity_plot(phc.passivity(plant()), **k)],
    "PassivityReport.plot": [lambda **k: phc.passivity(ct.ss(plant())).plot(**k)],
    "interconnect": [lambda **k: phc.interconnect([plant(), damped()], np.zeros((2, 2)), **k)],
    "damping_injection": [lambda **k: phc.damping_injection(plant(), 0.5, **k)],
    "damping_plot": [lambda **k: phc.damping_plot(plant(), 0.5, factors=[0.5, 1.0, 2.0], **k)],
    "lqg": [lambda **k: phc.lqg(plant(), **k)],
    "observer": [lambda **k: phc.observer(plant(), **k)],
    "OptimalDamping.plot": [lambda **k: phc.optimal_damping(plant()).plot(factors=[0.5, 1.0, 2.0], **k)],
    "gyrator": [lambda **k: phc.gyrator(plant(), damped(), **k), lambda **k: phc.gyrator(plant(), plant(), **k)],
    "couple": [lambda **k: phc.couple(plant(), damped(), **k), lambda **k: phc.couple(plant(), plant(), **k)],
    "transformer": [lambda **k: phc.transformer(plant(), damped(), 2.0, **k)],
    "PortHamiltonian": [lambda **k: phc.PortHamiltonian(np.eye(2), [0, 1], **k)],
    "forced_response": [lambda **k: phc.forced_response(plant(), T, 1.0, **k)],
    "frenkel_kontorova": [lambda **k: phc.frenkel_kontorova(2, **k)],
    "impulse_plot": [lambda **k: phc.impulse_plot(plant(), **k)],
    "impulse_response": [lambda **k: phc.impulse_response(plant(), T, **k)],
    "initial_response": [lambda **k: phc.initial_response(plant(), T, 1.0, **k)],
    "lc_circuit": [lambda **k: phc.lc_circuit([1.0, 2.0], 1.0, **k)],
    "msd_chain": [lambda **k: phc.msd_chain(3, **k)],
    "read_netlist": [lambda **k: phc.read_netlist("V1 1 0\nR1 1 2 5\nC1 2 0 1\n", **k)],
    "rcl_ladder": [lambda **k: phc.rcl_ladder(3, **k)],
    "modes_plot": [lambda **k: phc.modes_plot(plant(), **k)],
    "order_plot": [lambda **k: phc.order_plot(phc.order_selection(fitted().record, 2), **k)],
    "order_selection": [lambda **k: phc.order_selection(fitted().record, 2, **k)],
    "pole_zero_plot": [lambda **k: phc.pole_zero_plot(plant(), **k)],
    "ph": [
        lambda **k: phc.ph(np.eye(2), [0, 1], **k),
        lambda **k: phc.ph(plant(), **k),
        lambda **k: phc.ph(plant().modes, **k),
        lambda **k: phc.ph(ct.ss(plant()), **k),
        lambda **k: phc.ph(ct.tf([1, 0], [1, 0, 4]), **k),
        lambda **k: phc.ph(phc.ch(plant()), **k),
        lambda **k: phc.ph(phc.affine(np.eye(2), [1, 0]), **k),
        lambda **k: phc.ph(phc.sample(plant(), 0.1), method="exact", **k),
        lambda **k: phc.ph(np.eye(2), [0, 1], J=[[0, 2], [-2, 0]], **k),
    ],
    "residual_plot": [lambda **k: phc.residual_plot(phc.residual_analysis(fitted().record, fitted()), **k)],
    "spectral_estimate": [lambda **k: phc.spectral_estimate(recording(), **k)],
    "spring_chain": [lambda **k: phc.spring_chain([1.0, 2.0], 1.0, ground=1.0, **k)],
    "step_plot": [lambda **k: phc.step_plot(plant(), **k)],
    "step_response": [lambda **k: phc.step_response(plant(), T, **k)],
}


@pytest.fixture(autouse=True)
def _close_figures():
    yield
    plt.close("all")


def damped():
    return phc.ph(np.eye(2), [0, 1], R=np.eye(2))


def test_the_callables_are_found():
    """Guards the search: were it empty, the tests below would pass on anything."""
    assert {"williamson", "modes", "ModalForm", "ModalForm.freqresp", "PortHamiltonian.horner"} <= set(CLOSED)
    assert {"ph", "PortHamiltonian", "forced_response"} <= set(OPEN)


@pytest.mark.variants
@pytest.mark.parametrize("name", CLOSED)
def test_a_call_with_fixed_keywords_refuses_another(name):
    with pytest.raises(TypeError, match=REFUSAL):
        public_callables()[name](**{UNKNOWN: 1})


def test_every_call_that_collects_keywords_is_tried_below():
    missing = sorted(set(OPEN) - set(CALLS))
    assert missing == [], f"add a valid call of {missing} to CALLS of test_kwargs.py"


@pytest.mark.parametrize("name, way", [(name, way) for name in OPEN for way in range(len(CALLS.get(name, ())))])
def test_a_call_that_collects_keywords_refuses_an_unknown_one(name, way):
    call = CALLS[name][way]
    call()
    with pytest.raises(TypeError, match=REFUSAL) as refusal:
        call(**{UNKNOWN: 1})
    assert UNKNOWN in str(refusal.value)


MATRIX = np.array([[0.0, 1.0], [-1.0, 0.0]])


@pytest.mark.parametrize(
    "call, keyword, remedy",
    [
        (lambda **k: phc.from_second_order(np.eye(2), np.eye(2), [1, 0], **k), "D", "the damping matrix is C"),
        (lambda **k: phc.from_second_order(np.eye(2), np.eye(2), [1, 0], modes=1, **k), "E", "condense=True"),
        (lambda **k: phc.from_second_order(np.eye(2), np.eye(2), [1, 0], **k), "N", "control.feedback"),
        (lambda **k: phc.ph(np.eye(2), [1, 0], J=MATRIX, **k), "E", "from_second_order"),
        (lambda **k: phc.ph(np.eye(2), [1, 0], **k), "D", r"S=\(D \+ D.T\)/2"),
        (lambda **k: phc.ph(np.eye(2), [1, 0], R=np.eye(2), **k), "G", "second argument, B"),
        (lambda **k: phc.ph(np.eye(2), [1, 0], **k), "Gyro", "check its spelling"),
        (lambda **k: phc.spring_chain([1.0, 2.0], **k), "damping", "check its spelling"),
        (lambda **k: phc.tf(plant(), **k), "E", "check its spelling"),
    ],
)
def test_an_unknown_keyword_is_named_with_what_is_allowed_and_what_to_do(call, keyword, remedy):
    with pytest.raises(
        phc.UnknownKeywordError, match=rf"'{keyword}': .* takes .*name.* as keywords; .*{remedy}"
    ) as error:
        call(**{keyword: MATRIX})
    assert isinstance(error.value, TypeError | phc.StructureError) and "[[" not in str(error.value)


def test_names_given_by_the_user_are_not_changed():
    names = {"name": "frame", "input": "force"}
    phc.ph(np.eye(2), [1, 0], **names)
    assert names == {"name": "frame", "input": "force"}

"""Records that show little or nothing, and fits that are cut short: an answer or a refusal, never less."""

import functools
import inspect
import sys
from pathlib import Path

import control as ct
import numpy as np
import pytest
from slow import slowly

import ph_control as phc

RNG = np.random.default_rng(0)
TIME = 0.1 * np.arange(300)
PLANT = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
INPUT = RNG.standard_normal(300)
NOISE = 0.05 * RNG.standard_normal(300)
PACKAGE = str(Path(phc.__file__).parent)


def answer(u, offset=0.0):
    return phc.forced_response(PLANT, TIME, u, intersample="zoh").outputs + NOISE + offset


def interrupted_at(call, function):
    """Run a function, and raise KeyboardInterrupt at a call inside the package; its answer and the calls there were."""
    count = 0

    def profile(frame, event, argument):
        nonlocal count
        # what is raised where a generator is closed is lost
        inside = frame.f_code.co_filename.startswith(PACKAGE) and not frame.f_code.co_flags & inspect.CO_GENERATOR
        if event == "call" and inside:
            count += 1
            if count == call:
                raise KeyboardInterrupt

    sys.setprofile(profile)
    try:
        return function(), count
    finally:
        sys.setprofile(None)


@functools.cache
def uncut(function):
    """The answer of a function that nothing interrupts, and the calls there are."""
    return interrupted_at(0, function)


def contradicted():
    """Judging takes most of the calls: damping contradicts the model."""
    return phc.pem((INPUT, answer(INPUT) * np.exp(-0.02 * TIME)), 2, dt=0.1, structure="lossless")


def of_two_inputs(structure):
    data = np.stack([INPUT, INPUT[::-1]]), np.stack([answer(INPUT), answer(INPUT[::-1])])
    return phc.pem(data, 2, dt=0.1, structure=structure, intersample="zoh")


DAMPED = {structure: functools.partial(of_two_inputs, structure) for structure in ("auto", "classical")}


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.9, *slowly(0.5, 0.99)])
def test_an_interruption_of_the_judgement_keeps_the_fit(part):
    whole, calls = uncut(contradicted)
    cut, _ = interrupted_at(int(part * calls), contradicted)
    assert not cut.success and cut.outcome.name == "INTERRUPTED" and "interrupted" in cut.summary()
    assert cut.order == 2 and np.isfinite(cut.loss) and whole.success


@pytest.mark.variants
@pytest.mark.parametrize(
    "part, structure",
    [(0.6, "classical"), (0.95, "auto"), *slowly((0.3, "auto"), (0.99, "classical"))],
)
def test_an_interruption_of_a_damped_fit_keeps_the_modes(part, structure):
    fit = DAMPED[structure]
    whole, calls = uncut(fit)
    cut, _ = interrupted_at(int(part * calls), fit)
    assert not cut.success and cut.outcome.name == "INTERRUPTED" and "interrupted" in cut.summary()
    assert 1 <= cut.order <= 2 and np.isfinite(cut.loglik) and whole.success


@pytest.mark.parametrize("options", [{}, {"offset": True}])
def test_an_experiment_without_outputs_is_refused_by_its_number(options):
    missing = np.full(300, np.nan)
    for data in ([(INPUT, answer(INPUT)), (INPUT, missing)], [(None, answer(INPUT)), (None, missing)]):
        for call in (phc.pem, phc.order_selection):
            with pytest.raises(phc.IdentificationError, match="experiment 2 has no outputs"):
                call(data, 2, dt=0.1, **options)
    omega = np.linspace(0.1, 3.0, 40)
    with pytest.raises(phc.IdentificationError, match="experiment 1 has no outputs"):
        phc.pem([ct.frd(np.full(40, np.nan + 0j), omega), ct.frd(PLANT(1j * omega), omega)], 2)


def test_the_number_of_modes_that_are_judged_is_bounded_by_the_record():
    few, many = (INPUT[:200], None), np.arange(1.0, 301.0)
    for order in (300, 10**30, (many, np.ones(300)), phc.modes(many, np.ones(300))):
        with pytest.raises(phc.IdentificationError, match="200 observed samples; the largest number here is 49"):
            phc.excitation(few, order, dt=0.01)
    assert phc.excitation(few, 3, dt=0.1).n == 3
    assert phc.excitation((INPUT[:6], None), 3, dt=0.1).observed == 6, "of few modes it is told how much they need"


@pytest.mark.parametrize("quantity", ["velocity", "displacement", "acceleration"])
def test_a_state_is_given_as_a_vector_or_as_one_number(quantity):
    result = phc.pem((INPUT, answer(INPUT)), 2, dt=0.1, quantity=quantity)
    rest, ones = result.predict(INPUT, initial_state="zero"), result.predict(INPUT, initial_state=np.ones(4))
    assert np.array_equal(result.predict(INPUT, initial_state=0.0).outputs, rest.outputs)
    assert np.array_equal(result.predict(INPUT, initial_state=1).outputs, ones.outputs)
    for wrong in (np.ones(3), np.ones((4, 1)), [], [[1.0]], np.nan, "rest", [1j] * 4, {}):
        with pytest.raises(phc.StructureError, match="initial_state"):
            result.predict(INPUT, initial_state=wrong)


LAST, RAMP = np.eye(1, 300, 299)[0], TIME.copy()


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.filterwarnings("ignore::ph_control.exceptions.IdentifiabilityWarning")
@pytest.mark.parametrize(
    "u, options",
    [
        (LAST, {}), (LAST, {"offset": True}), (LAST, {"initial_state": "zero"}), (LAST, {"method": "midpoint"}),
        (np.sin(2.0 * TIME), {"representation": "controllable", "noise": "white", "delay": 0.0}),
        (np.sin(0.5 * TIME), {"delay": 0.0}),
        (RAMP, {"offset": True}), (RAMP, {"offset": True, "quantity": "acceleration"}),
        (RAMP, {"offset": True, "representation": "controllable"}),
    ],
)  # fmt: skip
def test_inputs_that_show_no_weight_give_no_number_for_its_error(u, options):
    result = phc.pem((u, answer(u, offset=1.0)), 2, dt=0.1, **options)
    # what was estimated has an error, and what the input does not show an infinite one; RuntimeWarnings are errors here
    shown = np.isfinite(result.stderr["residues"])
    assert shown.all() or result.blind or not result.residues[~shown].any()
    assert not np.isinf(result.covariance).any() and result.summary()


@pytest.mark.parametrize("fit", [phc.pem, phc.order_selection])
@pytest.mark.parametrize("callback", [1.0, "x", 1j, False])
def test_a_callback_that_cannot_be_called_is_refused(fit, callback):
    with pytest.raises(phc.StructureError, match="callback is "):
        fit((INPUT, answer(INPUT)), 2, dt=0.1, callback=callback)


@pytest.mark.parametrize("order", [np.array(["auto", "auto"]), [1], 10**5000], ids=["two", "list", "huge"])
def test_an_order_that_is_no_number_is_refused(order):
    with pytest.raises((phc.StructureError, phc.IdentificationError)):
        phc.pem((INPUT, answer(INPUT)), order, dt=0.1)

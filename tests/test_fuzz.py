"""Every public name under valid, odd and hostile arguments, in short; and that the fuzzer finds what it is for."""

import sys
import time
import warnings

import numpy as np
import pytest
from scripts import ROOT
from slow import slowly

import ph_control as phc

sys.path.insert(0, str(ROOT))  # the benchmarks are not installed with the package

from benchmarks import fuzz, fuzz_oracles, fuzz_scales, fuzz_values


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def findings_of(call, *values, kind="function"):
    """What the fuzzer has to say about one function, called with these values."""

    class Drawn(fuzz.Session):
        def _drawn(self, *_):
            return list(values), {}

    session = Drawn(0)
    session.attempt(fuzz.Target("planted", "", call, kind), None, None, 0.0)
    return [one.kind for one in session.findings]


def test_every_public_name_is_called_and_every_parameter_has_valid_values():
    names = {target.name for target in fuzz.targets()}
    public = {name for name in phc.__all__ if not issubclass(type(getattr(phc, name)), type)}
    assert public <= names
    assert {"PortHamiltonian", "ModalForm.freqresp", "ModalForm.zeros", "PEMResult: pickle", "ph-control fit"} <= names
    assert fuzz.unknown_parameters() == []


def _changes(array):
    array[0] = 7.0


def _waits():
    end = time.process_time() + 30.0
    while time.process_time() < end:
        pass


@pytest.mark.parametrize(
    ("call", "values", "kinds"),
    [
        (lambda: [][0], (), ["IndexError"]),
        (lambda x: phc.williamson(x)[0], (np.ones((3, 3)),), []),
        (lambda x: warnings.warn("overflow", RuntimeWarning, stacklevel=1), (1,), ["RuntimeWarning"]),
        (lambda x: x * np.nan, (1.0,), ["NaN"]),
        (lambda x: np.array([x, np.inf]), (1.0,), ["infinite"]),
        (lambda x: {"a": [x]}, (np.ones(3),), ["keeps an argument"]),
        (lambda x: {"a": [x.copy()]}, (np.ones(3),), []),
        (_changes, (np.ones(3),), ["changed an argument"]),
        (lambda x: x.setflags(write=False), (np.ones(3),), ["changed an argument"]),
        (print, ("word",), ["printed"]),
        (lambda: np.seterr(all="ignore") and None, (), ["changed global state"]),
        (lambda **names: None, (1,), []),
        (lambda x: float(x), ("a",), ["ValueError"]),
    ],
)
def test_what_no_call_may_do_is_found(call, values, kinds):
    before = np.geterr()
    try:
        assert findings_of(call, *values) == kinds
    finally:
        np.seterr(**before)


@pytest.mark.skipif(not hasattr(fuzz.signal, "setitimer"), reason="no timer of processor time on this system")
def test_a_call_that_takes_too_long_is_ended(monkeypatch):
    monkeypatch.setattr(fuzz, "SECONDS", 0.2)
    assert findings_of(_waits) == ["hang"]


@pytest.mark.parametrize("name", fuzz_oracles.ORACLES)
def test_answers_agree_with_those_of_50_digits(name):
    for seed in range(2):
        fuzz_oracles.ORACLES[name](np.random.default_rng(seed))


@pytest.mark.parametrize("name", fuzz_scales.ORACLES)
def test_answers_do_not_depend_on_units_and_keep_their_digits_at_critical_damping(name):
    for seed in range(3):
        fuzz_scales.ORACLES[name](np.random.default_rng(seed))


def test_rounding_of_poles_is_no_error_where_half_turns_leave_hardly_any_speed():
    rng = np.random.default_rng([7102, 70394])  # a mass that turns by 7.0004 half turns a step
    rng.random(2), rng.integers(1, 5), rng.choice([1, 1, 1, 2]), rng.integers(2)
    fuzz_scales.long_steps(rng)


def test_an_answer_that_depends_on_the_unit_of_time_is_found(monkeypatch):
    right = phc.PortHamiltonian.hamiltonian
    monkeypatch.setattr(phc.PortHamiltonian, "hamiltonian", lambda *given: right(*given) * (1 + 1e-10))
    monkeypatch.setattr("ph_control.analysis.energy._ROUNDING", 1e9)
    with pytest.raises(fuzz_scales.Wrong):
        fuzz_scales.energy_of_a_push(np.random.default_rng(0))


def test_an_answer_that_is_wrong_in_the_eighth_digit_is_found(monkeypatch):
    right = phc.PortHamiltonian.horner
    monkeypatch.setattr(phc.PortHamiltonian, "horner", lambda *given: right(*given) * (1 + 1e-8))
    with pytest.raises(fuzz_oracles.Wrong):
        fuzz_oracles.frequency_response(np.random.default_rng(0))


def test_a_call_is_the_same_when_it_is_made_again(folder):
    def drawn(number):
        seen = []

        class Watched(fuzz.Session):
            def _drawn(self, *given):
                values = super()._drawn(*given)
                seen.append((given[0].name, repr(fuzz.fingerprint(values))[:60]))
                return values

        session = Watched(3)
        session.one(number)
        return [name for name, _ in seen]

    assert [drawn(number) for number in range(6)] == [drawn(number) for number in range(6)]


def test_files_are_damaged_in_many_ways():
    rng = np.random.default_rng(0)
    made = {fuzz_values.damaged(rng, b"t,u,y\n0,1,2\n1,2,3\n") for _ in range(200)}
    assert len(made) > 100


@pytest.mark.parametrize("calls", [300, *slowly(1000)])
def test_calls_are_answered_or_refused(folder, calls):
    session = fuzz.Session(0)
    session.run(0, calls)
    assert sum(session.counts.values()) >= calls and session.answered > calls / 2
    assert session.findings == [], fuzz.table(session.findings, 0)

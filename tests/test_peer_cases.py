"""Systems from the tests of other packages are accepted exactly where they are lossless."""

import json
from fractions import Fraction

import control as ct
import numpy as np
import pytest
from exact import is_lossless, polynomial, state_space_fractions

import ph_control as phc

# --- the exact decision itself -----------------------------------------------------------------------------------


def one_port(num, den):
    """Descending powers, as python-control writes them."""
    return is_lossless([[polynomial(num[::-1])]], polynomial(den[::-1]))


@pytest.mark.parametrize(
    ("num", "den", "expected"),
    [
        ([0], [1, 2, 1], True),
        ([1], [1, 0], True),
        ([-1], [1, 0], False),
        ([1, 0], [1, 0, 4], True),
        ([-1, 0], [1, 0, 4], False),
        ([1], [1, 0, 4], False),
        ([1, 0], [1, 0, -4], False),
        ([1, 0], [1, 1e-9, 4], False),
        ([1, 0, 0], [1, 0, 4], False),
        ([1, 0, 0, 0], [1, 0, 4], False),
        ([1, 0, 2, 0], [1, 0, 4, 0, 3], True),
        ([1, 0, 4, 0], [1, 0, 4, 0, 3], False),
        ([1, 0, 0.5, 0], [1, 0, 4, 0, 3], False),
        ([1, 0, 1], [1, 0, 4, 0], True),
        ([1, 0, 5], [1, 0, 4, 0], False),
        ([1, 0], [1, 0, 2, 0, 1], False),
        ([1, 0, 1, 0], [1, 0, 2, 0, 1], True),
        ([1], [1, 0, 0], False),
        ([1, 0], [1, 0, 1, 0, 1], False),
        ([1, 1, 0], [1, 1, 4, 4], True),
        ([1, -1, 0], [1, -1, 4, -4], True),
    ],
)
def test_the_exact_decision_knows_lossless_one_ports_from_others(num, den, expected):
    assert one_port(num, den) is expected


@pytest.mark.parametrize(
    ("A", "B", "C", "expected"),
    [
        # two oscillators seen through both ports, residues of full rank and of rank one
        ([[0, 2], [-2, 0]], [[1, 0], [0, 1]], [[1, 0], [0, 1]], True),
        ([[0, 2], [-2, 0]], [[1, 1], [0, 0]], [[1, 0], [1, 0]], True),
        # output and input change places: the residue is not Hermitian
        ([[0, 2], [-2, 0]], [[1, 0], [0, 1]], [[1, 0], [1, 1]], False),
        # diagonal residues positive, but the matrix of them is indefinite
        ([[0, 0], [0, 0]], [[1, 0], [0, 1]], [[1, 2], [2, 1]], False),
        ([[0, 0], [0, 0]], [[1, 0], [0, 1]], [[2, 1], [1, 2]], True),
        ([[0, 0], [0, 0]], [[1, 0], [0, 1]], [[-2, 1], [1, -2]], False),
    ],
)
def test_the_exact_decision_knows_lossless_two_ports_from_others(A, B, C, expected):
    assert is_lossless(*state_space_fractions(A, B, C, [[0, 0], [0, 0]])) is expected


def test_the_exact_recursion_gives_the_transfer_function():
    A, B, C, D = [[0, 1], [-2, -3]], [[0], [1]], [[5, 1]], [[7]]
    (numerator,), denominator = state_space_fractions(A, B, C, D)
    assert denominator == [2, 3, 1]
    assert numerator == [[5 + 7 * 2, 1 + 7 * 3, 7]]
    assert all(isinstance(c, Fraction) for c in denominator)


# --- the cases ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cases(data_folder):
    return json.loads((data_folder / "models" / "peer_cases.json").read_text())


def build(case):
    """The system as python-control makes it; its sampling time, where discrete, does not matter."""
    timebase = [True] if case["discrete"] else []
    if case["kind"] == "tf":
        return ct.tf(case["num"], case["den"], *timebase)
    A, B, C, D = (case[key] for key in "ABCD")
    # the collection writes a zero D in whatever shape the source had
    D = D if np.any(D) else np.zeros((len(C), len(B[0])))
    return ct.ss(A, B, C, D, *timebase, remove_useless_states=False)


def expected(case):
    """Lossless in exact arithmetic, square and in continuous time."""
    if case["discrete"]:
        return False
    if case["kind"] == "tf":
        return one_port(case["num"], case["den"])
    sys = build(case)
    return sys.noutputs == sys.ninputs and is_lossless(
        *state_space_fractions(*(M.tolist() for M in (sys.A, sys.B, sys.C, sys.D)))
    )


def test_every_peer_case_is_accepted_exactly_where_it_is_lossless(cases):
    wrong, accepted = [], []
    for number, case in enumerate(cases):
        try:
            phc.ph(build(case), lossless=True)
            accepted.append(number)
        except phc.StructureError:
            pass
        if (number in accepted) != expected(case):
            wrong.append((number, case["file"], case["line"]))
    assert not wrong
    # nearly all are damped; the lossless ones are integrators and systems without a transfer function
    assert len(cases) == 272
    assert len(accepted) == 11


def test_an_accepted_peer_case_keeps_its_transfer_function(cases):
    checked = 0
    for case in cases:
        if expected(case):
            sys = build(case)
            ours = phc.ph(sys)
            for s in (0.3 + 0.1j, 2.0, -1.5j):
                value, truth = np.atleast_2d(ours(s)), np.atleast_2d(sys(s))
                assert np.allclose(value, truth, rtol=1e-14, atol=0)
            checked += 1
    assert checked == 11


def test_a_refusal_of_a_peer_case_names_a_reason(cases):
    for case in cases:
        if not expected(case):
            with pytest.raises(phc.StructureError) as refusal:
                phc.ph(build(case), lossless=True)
            reasons = getattr(refusal.value, "violations", [str(refusal.value)])
            words = ("off the imaginary axis", "repeated", "negative", "not real", "not Hermitian", "feedthrough")
            words += ("improper", "discrete-time", "inputs and")
            assert all(any(word in reason for word in words) for reason in reasons), reasons

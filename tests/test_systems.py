"""Port-Hamiltonian systems: what they hold, what stays PH, what is locked, what is kept."""

import copy
import operator
import pickle

import control as ct
import mpmath as mp
import numpy as np
import pytest
import reference as ref
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc

EPS = ref.EPS
PH, SS, TF = phc.PortHamiltonian, ct.StateSpace, ct.TransferFunction
LOSSY = phc.DissipativePortHamiltonian
SETTINGS = settings(deadline=None, max_examples=20, derandomize=True)


def one_port(**names):
    return phc.ph(np.diag([4.0, 1.0, 1.0, 2.0]), [0.0, 0.5, 1.0, -1.0], **names)


def two_port():
    Q, _ = ref.random_hamiltonian([1.0, 2.5], np.random.default_rng(1))
    return phc.ph(Q, np.random.default_rng(2).standard_normal((4, 2)))


def floating():
    """A free mass: the energy does not see its position, the transfer function is 1/(2 s)."""
    return phc.ph(np.diag([0.0, 0.5]), [0.0, 1.0])


def nothing(ports=1):
    return phc.ph(np.zeros((0, 0)), np.zeros((0, ports)))


def dense(sys, s):
    """Transfer function by a linear solve with the matrices a user sees."""
    return ref.dense_transfer_function(sys.A, sys.B, sys.C, s) + sys.D


# --- type closure ------------------------------------------------------------------------------------------------

OPERANDS = {
    "ph": one_port,
    "modal": lambda: phc.ph(phc.modes([1.0, 3.0], [0.5, 2.0])),
    "floating": floating,
    "nothing": nothing,
    "lossy": lambda: phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.3]), S=[[0.2]]),
    "lossy two": lambda: phc.ph(np.diag([4.0, 1.0]), np.eye(2), R=np.diag([0.0, 0.3]), N=[[0.0, 1.0], [-1.0, 0.0]]),
    "sensors": lambda: phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.3]), sensors=([[1.0, 0.0]], [[0.4]])),
    "two": two_port,
    "ss": lambda: ct.ss([[-1.0, 2.0], [0.0, -3.0]], [[1.0], [1.0]], [[1.0, 0.5]], [[0.25]]),
    "ss two": lambda: ct.ss([[-1.0]], [[1.0, 2.0]], [[1.0], [3.0]], np.eye(2)),
    "tf": lambda: ct.tf([1.0, 2.0], [1.0, 3.0]),
    "sampled": lambda: ct.ss([[-0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1),
    "2": lambda: 2,
    "0.5": lambda: np.float64(0.5),
    "int64": lambda: np.int64(3),
    "-2": lambda: -2.0,
    "0": lambda: 0,
    "0.0": lambda: 0.0,
    "True": lambda: True,
    "0d": lambda: np.array(2.0),
    "array": lambda: np.array([[2.0]]),
    "matrix": lambda: np.array([[1.0, 2.0], [0.0, 3.0]]),
    "rising": lambda: np.array([[1.0, 3.0], [0.0, 1.0]]),
    "text": lambda: "two",
    "None": lambda: None,
}


def value_at(operand, s):
    """Value of any operand as a matrix."""
    if isinstance(operand, SS):
        return dense(operand, s)
    return np.atleast_2d(operand(s) if isinstance(operand, TF) else operand)


def promoted(a, b, one):
    """Single-port operands act on each port of the other: through all pairs (sum) or the diagonal (product)."""
    if a.size == 1 < b.size:
        a = a * one(len(b))
    if b.size == 1 < a.size:
        b = b * one(len(a))
    return a, b


def total(a, b):
    a, b = promoted(a, b, lambda n: np.ones((n, n)))
    return a + b


def chain(a, b):
    if a.size == 1 or b.size == 1:
        return a.item() * b if a.size == 1 else a * b.item()
    return a @ b


def block(a, b):
    return np.block([[a, np.zeros((len(a), b.shape[1]))], [np.zeros((len(b), a.shape[1])), b]])


OPERATIONS = {
    "+": (operator.add, total),
    "-": (operator.sub, lambda a, b: total(a, -b)),
    "*": (operator.mul, chain),
    "/": (operator.truediv, lambda a, b: chain(a, np.linalg.inv(b))),
    "parallel": (ct.parallel, total),
    "series": (ct.series, lambda a, b: chain(b, a)),
    "feedback": (ct.feedback, lambda a, b: np.linalg.solve(np.eye(len(a)) + a @ b, a)),
    "append": (ct.append, block),
}

TABLE = [
    # sums: PH with PH of as many ports, and with the number 0
    ("ph", "+", "ph", PH), ("ph", "+", "modal", PH), ("modal", "+", "ph", PH), ("ph", "+", "floating", PH),
    ("ph", "+", "nothing", PH), ("nothing", "+", "ph", PH), ("nothing", "+", "nothing", PH), ("two", "+", "two", PH),
    ("ph", "+", "0", PH), ("0", "+", "ph", PH), ("ph", "+", "0.0", PH), ("two", "+", "0", PH), ("ph", "-", "0", PH),
    ("ph", "+", "two", SS), ("two", "+", "ph", SS),
    ("ph", "+", "ss", SS), ("ss", "+", "ph", SS), ("two", "+", "ss two", SS), ("ss two", "+", "two", SS),
    ("two", "+", "ss", SS), ("ss", "+", "two", SS), ("ph", "+", "ss two", SS), ("ss two", "+", "ph", SS),
    ("ph", "+", "tf", SS), ("tf", "+", "ph", TF), ("ph", "+", "True", SS),
    ("ph", "+", "lossy", LOSSY), ("lossy", "+", "ph", LOSSY), ("lossy", "+", "lossy", LOSSY),
    ("two", "+", "lossy two", LOSSY), ("lossy", "+", "0", LOSSY), ("0", "+", "lossy", LOSSY), ("lossy", "+", "ss", SS),
    ("ss", "+", "lossy", SS), ("lossy", "+", "lossy two", SS), ("lossy", "+", "sampled", ValueError),
    ("sensors", "+", "ss two", ValueError), ("lossy", "+", "text", TypeError), ("nothing", "+", "lossy", LOSSY),
    # and with a gain that takes energy: a resistor beside
    ("ph", "+", "2", LOSSY), ("2", "+", "ph", LOSSY), ("ph", "+", "0.5", LOSSY), ("0.5", "+", "ph", LOSSY),
    ("ph", "+", "array", LOSSY), ("array", "+", "ph", LOSSY), ("two", "+", "matrix", LOSSY),
    ("matrix", "+", "two", LOSSY), ("two", "+", "2", LOSSY), ("nothing", "+", "2", LOSSY), ("lossy", "+", "0.5", LOSSY),
    ("ph", "+", "-2", SS), ("lossy", "+", "-2", SS), ("two", "+", "rising", SS), ("rising", "+", "two", SS),
    ("nothing", "+", "ss", SS), ("ss", "+", "nothing", SS),
    ("ph", "+", "sampled", ValueError), ("sampled", "+", "ph", ValueError),
    ("ph", "+", "text", TypeError), ("text", "+", "ph", TypeError), ("ph", "+", "None", TypeError),
    # differences: never, except from nothing
    ("ph", "-", "ph", SS), ("ph", "-", "modal", SS), ("two", "-", "two", SS), ("nothing", "-", "ph", SS),
    ("ph", "-", "ss", SS), ("ss", "-", "ph", SS), ("ph", "-", "tf", SS), ("tf", "-", "ph", TF),
    ("ph", "-", "2", SS), ("2", "-", "ph", SS), ("0", "-", "ph", SS), ("ph", "-", "array", SS),
    ("array", "-", "ph", SS), ("lossy", "-", "lossy", SS), ("lossy", "-", "0", LOSSY), ("ph", "-", "-2", LOSSY),
    # products: PH with a positive number
    ("ph", "*", "2", PH), ("2", "*", "ph", PH), ("ph", "*", "0.5", PH), ("0.5", "*", "ph", PH),
    ("int64", "*", "ph", PH),
    ("modal", "*", "2", PH), ("2", "*", "modal", PH), ("floating", "*", "2", PH), ("nothing", "*", "2", PH),
    ("two", "*", "2", PH), ("0.5", "*", "two", PH),
    ("ph", "*", "-2", SS), ("-2", "*", "ph", SS), ("ph", "*", "0", SS), ("0", "*", "ph", SS), ("ph", "*", "True", SS),
    ("ph", "*", "array", SS), ("array", "*", "ph", SS), ("ph", "*", "matrix", SS), ("matrix", "*", "ph", SS),
    ("two", "*", "matrix", SS), ("matrix", "*", "two", SS),
    ("ph", "*", "ph", SS), ("ph", "*", "modal", SS), ("ph", "*", "two", SS), ("two", "*", "ph", SS),
    ("nothing", "*", "ph", SS), ("ph", "*", "ss", SS), ("ss", "*", "ph", SS), ("two", "*", "ss two", SS),
    ("ss two", "*", "two", SS), ("ss", "*", "two", SS), ("ss two", "*", "ph", SS), ("ph", "*", "tf", SS),
    ("lossy", "*", "2", LOSSY), ("0.5", "*", "lossy", LOSSY), ("sensors", "*", "2", LOSSY),
    ("2", "*", "sensors", LOSSY),
    ("lossy two", "*", "int64", LOSSY), ("lossy", "*", "-2", SS), ("-2", "*", "lossy", SS), ("lossy", "*", "0", SS),
    ("lossy", "*", "True", SS), ("lossy", "*", "ph", SS), ("ph", "*", "lossy", SS), ("lossy", "*", "array", SS),
    ("tf", "*", "lossy", TF), ("lossy", "*", "tf", SS), ("ss", "*", "lossy", SS), ("lossy", "*", "text", TypeError),
    ("tf", "*", "ph", TF), ("ph", "*", "sampled", ValueError), ("sampled", "*", "ph", ValueError),
    ("ph", "*", "text", TypeError), ("None", "*", "ph", TypeError),
    # quotients: PH by a positive number; a strictly proper system has no inverse
    ("ph", "/", "2", PH), ("modal", "/", "0.5", PH), ("two", "/", "2", PH), ("nothing", "/", "2", PH),
    ("ph", "/", "0d", PH), ("ph", "/", "-2", SS), ("ph", "/", "array", SS), ("ph", "/", "tf", SS),
    ("ph", "/", "0", ZeroDivisionError), ("ph", "/", "ph", TypeError), ("2", "/", "ph", TypeError),
    ("ss", "/", "ph", TypeError), ("lossy", "/", "2", LOSSY), ("sensors", "/", "0.5", LOSSY), ("lossy", "/", "-2", SS),
    ("lossy", "/", "0", ZeroDivisionError),
    # connections
    ("ph", "parallel", "ph", PH), ("two", "parallel", "two", PH), ("ph", "parallel", "ss", SS),
    ("ss", "parallel", "ph", SS), ("tf", "parallel", "ph", TF), ("ph", "parallel", "2", LOSSY),
    ("lossy", "parallel", "ph", LOSSY), ("ph", "parallel", "-2", SS), ("lossy", "series", "2", LOSSY),
    ("lossy", "series", "ph", SS),
    ("ph", "series", "2", PH), ("2", "series", "ph", PH), ("ph", "series", "ph", SS), ("ph", "series", "ss", SS),
    ("ss", "series", "ph", SS), ("ph", "series", "tf", TF), ("tf", "series", "ph", SS),
    ("two", "series", "ss two", SS), ("ph", "series", "-2", SS),
    ("ph", "feedback", "ph", PH), ("ph", "feedback", "2", LOSSY), ("ph", "feedback", "ss", SS),
    ("ss", "feedback", "ph", SS), ("2", "feedback", "ph", SS), ("tf", "feedback", "ph", TF),
    ("ph", "feedback", "tf", SS), ("two", "feedback", "two", PH),
    ("two", "feedback", "matrix", LOSSY), ("nothing", "feedback", "ph", PH), ("ph", "feedback", "nothing", PH),
    ("ph", "feedback", "two", ValueError), ("ph", "feedback", "sampled", ValueError),
    ("ph", "feedback", "text", TypeError),
    ("ph", "feedback", "lossy", LOSSY), ("lossy", "feedback", "ph", LOSSY), ("lossy", "feedback", "2", LOSSY),
    ("lossy", "feedback", "-2", SS), ("ph", "feedback", "-2", SS), ("two", "feedback", "rising", SS),
    ("lossy two", "feedback", "two", LOSSY), ("lossy", "feedback", "ss", SS), ("lossy", "feedback", "text", TypeError),
    # side by side: PH with PH, and with a gain that takes energy
    ("ph", "append", "ph", PH), ("two", "append", "ph", PH), ("modal", "append", "two", PH),
    ("ph", "append", "nothing", PH), ("nothing", "append", "two", PH), ("ph", "append", "0", PH),
    ("lossy", "append", "ph", LOSSY),
    ("ph", "append", "lossy two", LOSSY), ("two", "append", "2", LOSSY), ("ph", "append", "matrix", LOSSY),
    ("ph", "append", "rising", SS), ("two", "append", "-2", SS), ("ph", "append", "ss", SS), ("ss", "append", "ph", SS),
    ("ph", "append", "tf", SS), ("sensors", "append", "ph", SS), ("ph", "append", "sensors", LOSSY),
]  # fmt: skip


@pytest.mark.parametrize(("left", "operation", "right", "expected"), TABLE)
def test_each_operation_gives_the_documented_type_and_the_right_transfer_function(left, operation, right, expected):
    combine, values = OPERATIONS[operation]
    a, b = OPERANDS[left](), OPERANDS[right]()
    if issubclass(expected, Exception):
        with pytest.raises(expected):
            combine(a, b)
        return
    result = combine(a, b)
    assert type(result) is expected
    for s in (0.4 + 0.3j, -1.5 + 0.8j, 5.0):
        truth = values(value_at(a, s), value_at(b, s))
        got = value_at(result, s)
        assert got.shape == truth.shape
        assert np.max(np.abs(got - truth)) < 1000 * EPS * max(1.0, np.max(np.abs(truth)))
        if expected in (PH, LOSSY):
            # the modal path agrees with the matrices
            assert np.max(np.abs(np.atleast_2d(result(s)) - truth)) < 1000 * EPS * max(1.0, np.max(np.abs(truth)))


UNARY = [
    ("neg", lambda sys: -sys, SS, lambda G: -G),
    ("power 0", lambda sys: sys**0, SS, lambda G: np.eye(len(G))),
    ("power 1", lambda sys: sys**1, PH, lambda G: G),
    ("power 2", lambda sys: sys**2, SS, lambda G: G @ G),
    ("power -1", lambda sys: sys**-1, TypeError, None),
    ("power 0.5", lambda sys: sys**0.5, ValueError, None),
    (
        "feedback",
        lambda sys: sys.feedback(np.eye(sys.ninputs)),
        LOSSY,
        lambda G: np.linalg.solve(np.eye(len(G)) + G, G),
    ),
    ("sum of one", lambda sys: sum([sys]), PH, lambda G: G),
    ("sum", lambda sys: sum([sys, sys, sys]), PH, lambda G: 3 * G),
    ("entry", lambda sys: sys[0, 0], SS, lambda G: G[:1, :1]),
    ("slice", lambda sys: sys[:, :], SS, lambda G: G),
    ("label", lambda sys: sys["y[0]", "u[0]"], SS, lambda G: G[:1, :1]),
    ("copy.copy", copy.copy, PH, lambda G: G),
    ("copy.deepcopy", copy.deepcopy, PH, lambda G: G),
    ("copy", lambda sys: sys.copy(), PH, lambda G: G),
    ("pickle", lambda sys: pickle.loads(pickle.dumps(sys)), PH, lambda G: G),
    ("phc.ph", phc.ph, PH, lambda G: G),
    ("ct.ss", ct.ss, SS, lambda G: G),
    ("ct.tf", ct.tf, TF, lambda G: G),
    ("ct.ss2tf", ct.ss2tf, TF, lambda G: G),
    ("minreal", lambda sys: sys.minreal(), SS, lambda G: G),
    ("ct.minreal", lambda sys: ct.minreal(sys, verbose=False), SS, lambda G: G),
    ("similarity", lambda sys: ct.similarity_transform(sys, 2 * np.eye(sys.nstates)), SS, lambda G: G),
    ("linearize", lambda sys: ct.linearize(sys, 0, 0), SS, lambda G: G),
    (
        "interconnect",
        lambda sys: ct.interconnect([sys], inputs=sys.input_labels, outputs=sys.output_labels),
        None,
        lambda G: G,
    ),
]


@pytest.mark.variants
@pytest.mark.parametrize("operand", ["ph", "modal", "floating", "two", "nothing"])
@pytest.mark.parametrize(("what", "change", "expected", "values"), UNARY, ids=[row[0] for row in UNARY])
def test_each_change_of_one_system_gives_the_documented_type_and_transfer_function(
    operand, what, change, expected, values
):
    sys = OPERANDS[operand]()
    if isinstance(expected, type) and issubclass(expected, Exception):
        with pytest.raises(expected):
            change(sys)
        return
    result = change(sys)
    if expected is LOSSY and not sys.nstates:
        expected = PH  # of nothing nothing is lost
    # an interconnection is a StateSpace of python-control's own subclass
    assert type(result) is expected if expected else isinstance(result, SS) and not isinstance(result, PH)
    for s in (0.4 + 0.3j, 5.0):
        truth = values(dense(sys, s))
        assert np.max(np.abs(value_at(result, s) - truth)) < 1000 * EPS * max(1.0, np.max(np.abs(truth)))


@pytest.mark.parametrize("operand", ["lossy", "lossy two"])
@pytest.mark.parametrize(
    ("what", "change", "expected", "values"),
    [row for row in UNARY if row[0] != "power -1"],  # with feedthrough there is an inverse
    ids=[row[0] for row in UNARY if row[0] != "power -1"],
)
def test_each_change_of_a_system_with_losses_gives_one_with_losses_where_it_gives_a_port_hamiltonian_one(
    operand, what, change, expected, values
):
    test_each_change_of_one_system_gives_the_documented_type_and_transfer_function(
        operand, what, change, LOSSY if expected is PH else expected, values
    )


@pytest.mark.parametrize("sample", [lambda sys, h: sys.sample(h), ct.sample_system, ct.c2d])
@pytest.mark.parametrize("operand", ["ph", "modal", "floating", "two", "nothing"])
def test_a_sampled_system_is_a_discrete_state_space_with_the_exact_step(operand, sample):
    sys, h = OPERANDS[operand](), 0.1
    result = sample(sys, h)
    assert type(result) is SS
    assert result.dt == h
    F, G, _ = ref.dense_step(sys.A, sys.B, h, "exact", "zoh")
    assert np.allclose(result.A, F, rtol=0, atol=100 * EPS)
    assert np.allclose(result.B, G, rtol=0, atol=100 * EPS)


@SETTINGS
@given(st.lists(st.integers(0, 3), min_size=1, max_size=5), st.integers(1, 2), st.integers(0, 2**32 - 1))
def test_the_sum_of_any_systems_is_ph_and_its_transfer_function_the_sum(sizes, ports, seed):
    rng = np.random.default_rng(seed)
    systems = [
        phc.ph(ref.random_hamiltonian(rng.uniform(0.5, 3, n), rng)[0], rng.standard_normal((2 * n, ports)))
        for n in sizes
    ]
    result = sum(systems)
    assert type(result) is PH
    assert result.n == sum(sizes)
    s = 0.5 + 1.0j
    parts = [dense(sys, s) for sys in systems]
    size = sum(np.max(np.abs(part)) for part in parts)
    assert np.max(np.abs(result.horner(s)[:, :, 0] - sum(parts))) <= 1e4 * EPS * max(1.0, size)
    assert np.array_equal(np.sort(np.concatenate([sys.d for sys in systems])), result.d)


@SETTINGS
@given(st.floats(1e-9, 1e9), st.sampled_from(["ph", "modal", "floating", "two"]))
def test_a_positive_factor_scales_the_residues_and_leaves_the_frequencies(factor, operand):
    sys = OPERANDS[operand]()
    for scaled in (factor * sys, sys * factor):
        assert type(scaled) is PH
        assert np.array_equal(scaled.d, sys.d)
        assert np.allclose(scaled.r, factor * sys.r, rtol=8 * EPS, atol=0)
        assert np.allclose(scaled.modes.kappa_0, factor * sys.modes.kappa_0, rtol=8 * EPS, atol=0)


def test_a_sum_with_zero_is_the_system_itself():
    sys = one_port()
    assert sys + 0 is sys
    assert 0 + sys is sys
    assert sys + 1 is not sys


# --- what a system holds -----------------------------------------------------------------------------------------


@SETTINGS
@given(st.lists(st.floats(0.1, 10), min_size=1, max_size=5), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_the_matrices_are_those_of_the_definition_and_the_modal_data_those_of_williamson(d, ports, seed):
    rng = np.random.default_rng(seed)
    n = len(d)
    Q, _ = ref.random_hamiltonian(d, rng)
    B = rng.standard_normal((2 * n, ports))
    sys = phc.ph(Q, B)
    J = ref.symplectic_form(n)
    assert (sys.n, sys.nstates, sys.ninputs, sys.noutputs, sys.dt) == (n, 2 * n, ports, ports, 0)
    assert np.array_equal(sys.Q, Q)
    assert np.array_equal(sys.B, B)
    assert np.array_equal(sys.A, J @ Q)
    assert np.array_equal(sys.D, np.zeros((ports, ports)))
    assert np.allclose(sys.C, B.T @ Q, rtol=0, atol=4 * n * EPS * np.linalg.norm(B) * np.linalg.norm(Q))
    tolerance = 100 * n * EPS * np.linalg.norm(Q, 2) * np.linalg.norm(sys.S, 2) ** 2
    assert np.all(np.diff(sys.d) >= 0)
    assert np.allclose(sys.d, np.sort(d), rtol=0, atol=tolerance)
    assert np.allclose(sys.S.T @ np.diag(np.r_[sys.d, sys.d]) @ sys.S, Q, rtol=0, atol=tolerance)
    v = (sys.S @ B)[:, 0] if ports == 1 else sys.S @ B
    assert np.array_equal(sys.v, v)
    weights = sys.v[:n] ** 2 + sys.v[n:] ** 2
    assert sys.r.shape == weights.shape == ((n,) if ports == 1 else (n, ports))
    # a nearly repeated frequency leaves its weights free to mix: only their sum is determined
    assert np.isclose(sys.r.sum(), weights.sum(), rtol=1e4 * EPS * np.linalg.norm(sys.S, 2) ** 4)


def test_the_energy_is_that_of_the_matrix_for_one_state_and_for_many():
    sys = two_port()
    z = np.random.default_rng(0).standard_normal((4, 7))
    truth = 0.5 * np.einsum("it,ij,jt->t", z, sys.Q, z)
    assert np.allclose(sys.hamiltonian(z), truth, rtol=100 * EPS)
    one = sys.hamiltonian(z[:, 0])
    assert isinstance(one, float)
    assert np.isclose(one, truth[0], rtol=100 * EPS)
    assert floating().hamiltonian([100.0, 2.0]) == pytest.approx(1.0, rel=8 * EPS)
    assert floating().hamiltonian([100.0, 0.0]) == 0.0


def test_the_dynamics_conserve_what_the_ports_do_not_deliver():
    sys = two_port()
    rng = np.random.default_rng(1)
    z, u = rng.standard_normal(4), rng.standard_normal(2)
    power = sys.Q @ z @ sys.dynamics(0, z, u)
    assert power == pytest.approx(u @ sys.output(0, z, u), rel=1000 * EPS)


def test_a_system_is_canonical_iff_all_frequencies_differ_and_all_modes_are_reached():
    assert phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0])).is_canonical
    assert not phc.ph(phc.modes([1.0, 2.0], [1.0, 0.0])).is_canonical
    assert not phc.ph(phc.modes([1.0, 1.0], [1.0, 1.0])).is_canonical
    assert not floating().is_canonical
    assert nothing().is_canonical
    assert phc.ph(np.eye(4), np.array([[1.0, 0], [0, 1], [0, 0], [0, 0]])).is_canonical


def test_poles_are_those_of_the_matrix_and_exactly_on_the_axis():
    sys = two_port()
    assert np.all(sys.poles().real == 0)
    eigenvalues = np.sort(np.linalg.eigvals(sys.A).imag)
    assert np.allclose(sys.poles().imag, eigenvalues, rtol=0, atol=1e4 * EPS)
    assert np.array_equal(floating().poles(), [0, 0])
    assert len(nothing().poles()) == 0


def test_zeros_are_where_the_transfer_function_vanishes():
    sys = one_port()
    zeros = sys.zeros()
    assert np.all(zeros.real == 0)
    assert len(zeros) == 2 * sys.n - 1
    step = 1e-6
    slope = np.abs(sys(zeros + step) - sys(zeros)) / step
    assert np.all(np.abs(sys(zeros)) <= 100 * EPS * slope)
    assert np.all(slope > 0.1)


def test_the_matrices_of_a_modal_system_are_not_built_before_somebody_looks():
    sys = phc.ph(phc.modes(np.arange(1.0, 40_001.0), np.ones(40_000)))
    # dense, these would be 51 GB each
    assert abs(sys(1.5j)) < np.inf
    assert len(sys.poles()) == sys.nstates == 80_000


# --- never NaN ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("operand", ["ph", "modal", "floating", "two", "nothing"])
def test_a_pole_gives_infinity_and_no_point_gives_nan(operand):
    sys = OPERANDS[operand]()
    at_poles = sys.horner(sys.poles())
    assert at_poles.shape == (sys.ninputs, sys.ninputs, sys.nstates)
    assert np.all(np.isinf(at_poles).any(axis=(0, 1)))
    points = np.concatenate([sys.poles(), sys.poles() + 1e-300, [0, 1e-300, 1e300j, 1e154 + 1e154j, np.inf]])
    values = sys.horner(points)
    assert not np.isnan(values.real).any()
    assert not np.isnan(values.imag).any()


def test_close_to_a_pole_the_value_is_that_of_the_pole():
    sys = one_port()
    offset = 1e-9
    value = sys(1j * sys.d[0] + offset)
    assert value == pytest.approx(0.5 * sys.r[0] * sys.d[0] / offset, rel=1e-6)


# --- locks and copies --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["A", "B", "C", "D", "Q", "v", "S"])
@pytest.mark.parametrize("operand", ["ph", "modal", "two"])
def test_a_matrix_can_be_neither_replaced_nor_written(operand, name):
    sys = OPERANDS[operand]()
    before = getattr(sys, name).copy()
    with pytest.raises(AttributeError) as refusal:
        setattr(sys, name, 2 * before)
    assert str(refusal.value) == (
        f"{name} of a PortHamiltonian cannot be changed: the system would no longer be lossless; "
        "make a new one with ph(Q, B), or a free StateSpace with control.ss(sys)"
    )
    with pytest.raises(ValueError, match="read-only"):
        getattr(sys, name)[...] = 0
    assert np.array_equal(getattr(sys, name), before)


@pytest.mark.parametrize(
    "sys",
    [phc.ph(np.eye(2), [0.0, 1.0], R=np.diag([0.0, 0.1])), phc.ph(phc.modes(1.0, 1.0)), phc.ch([1.0], [1.0, 0.0]),
     phc.affine(np.eye(2), [1.0, 0.0])],
    ids=lambda sys: type(sys).__name__,
)  # fmt: skip
def test_the_time_base_cannot_be_changed(sys):
    for dt in (0.1, True, None):
        with pytest.raises(AttributeError, match=f"dt of a {type(sys).__name__} cannot be changed: .* sample"):
            sys.dt = dt
    for twin in (sys, copy.deepcopy(sys), sys.copy("twin"), pickle.loads(pickle.dumps(sys)), ct.ss(sys)):
        assert twin.dt == 0 and twin.isctime(strict=True)


@pytest.mark.parametrize("name", ["d", "r"])
def test_modal_data_can_be_neither_replaced_nor_written(name):
    sys = one_port()
    with pytest.raises(AttributeError):
        setattr(sys, name, np.ones(2))
    with pytest.raises(ValueError, match="read-only"):
        getattr(sys, name)[0] = 5.0


def test_a_free_state_space_of_a_system_can_be_changed_without_touching_it():
    sys = one_port()
    free = ct.ss(sys)
    before = sys.A.copy()
    free.A[0, 0] = -1.0
    assert np.array_equal(sys.A, before)


def test_arrays_of_the_user_are_neither_changed_nor_shared():
    Q, B = np.diag([4.0, 1.0]), np.array([0.0, 1.0])
    sys = phc.ph(Q, B)
    assert Q.flags.writeable
    assert B.flags.writeable
    Q[0, 0], B[1] = 9.0, 3.0
    assert np.array_equal(sys.Q, np.diag([4.0, 1.0]))
    assert np.array_equal(sys.B, [[0.0], [1.0]])
    assert np.array_equal(sys.d, [2.0])


def test_arrays_of_a_converted_state_space_are_not_shared():
    free = ct.ss(one_port())
    sys = phc.ph(free)
    before = sys.Q.copy()
    free.A[...] = 0
    free.B[...] = 0
    assert np.array_equal(sys.Q, before)
    assert sys.B.any()


COPIES = [copy.copy, copy.deepcopy, lambda sys: pickle.loads(pickle.dumps(sys)), phc.ph]


@pytest.mark.parametrize("duplicate", COPIES, ids=["copy", "deepcopy", "pickle", "ph"])
@pytest.mark.parametrize("operand", ["ph", "modal", "floating", "two", "nothing"])
def test_a_copy_is_equal_in_every_matrix_mode_and_name_and_locked_too(duplicate, operand):
    sys = OPERANDS[operand]()
    sys.update_names(name="plant", inputs=[f"F{i}" for i in range(sys.ninputs)])
    twin = duplicate(sys)
    assert type(twin) is PH
    assert twin is not sys
    for name in "ABCDQ":
        assert np.array_equal(getattr(twin, name), getattr(sys, name))
    for name in ("d", "nu", "rigid", "r"):
        assert np.array_equal(getattr(twin.modes, name), getattr(sys.modes, name))
    assert (twin.name, twin.input_labels, twin.output_labels, twin.state_labels) == (
        sys.name, sys.input_labels, sys.output_labels, sys.state_labels,
    )  # fmt: skip
    with pytest.raises(AttributeError, match="cannot be changed"):
        twin.A = 0
    with pytest.raises(ValueError, match="read-only"):
        twin.Q[...] = 0
    twin.update_names(name="other")
    assert sys.name == "plant"


def test_a_pickle_taken_before_any_look_gives_the_same_modes_after_it():
    untouched, looked_at = one_port(), one_port()
    looked_at.S, looked_at.zeros()
    first, second = (pickle.loads(pickle.dumps(sys)) for sys in (untouched, looked_at))
    assert np.array_equal(first.modes.nu, second.modes.nu)
    assert np.array_equal(first.zeros(), second.zeros())


# --- what is computed when ---------------------------------------------------------------------------------------


def large(n=40, seed=0, low=1.0, high=8.0, ports=1):
    """Of more degrees of freedom than are checked and computed at once."""
    rng = np.random.default_rng(seed)
    Q, _ = ref.random_hamiltonian(np.sort(rng.uniform(low, high, n)), rng, 0.3)
    return Q, rng.standard_normal((2 * n, ports))


def hidden_sign(n=40):
    """An indefinite matrix that no diagonal entry and no pair of rows gives away: one eigenvalue is -0.5."""
    u = np.ones(2 * n) / np.sqrt(2 * n)
    return np.eye(2 * n) - 1.5 * np.outer(u, u)


@pytest.fixture
def no_cubic_work(monkeypatch):
    def refused(*args, **kwargs):
        raise AssertionError("this takes O(n^3) steps")

    for place, name in [
        ("numerics.definiteness", "definite_factor"), ("numerics.definiteness", "smallest_scaled_eigenvalue"),
        ("systems.port_hamiltonian", "williamson"), ("systems.port_hamiltonian", "energy_coordinates"),
        ("systems.port_hamiltonian", "port_spectrum"),
    ]:  # fmt: skip
        monkeypatch.setattr(f"ph_control.{place}.{name}", refused)


@pytest.mark.parametrize("make", [phc.ph, phc.affine])
def test_building_and_copying_a_large_system_takes_no_cubic_work(make, no_cubic_work):
    Q, B = large()
    sys = make(Q, B)
    for duplicate in (copy.copy, copy.deepcopy, lambda sys: pickle.loads(pickle.dumps(sys)), lambda sys: sys.copy()):
        twin = duplicate(sys)
        assert np.array_equal(twin.Q, Q)
    with pytest.raises(AssertionError, match="O\\(n\\^3\\)"):
        _ = sys.modes


MISTAKES = {
    "sign": lambda Q: Q - 2 * np.diag(np.diag(Q)) * (np.arange(len(Q)) == 5),
    "pair": lambda Q: (
        Q + 1e3 * (np.eye(len(Q))[:, [3]] * np.eye(len(Q))[7] + np.eye(len(Q))[:, [7]] * np.eye(len(Q))[3])
    ),
    "asymmetric": lambda Q: Q + np.eye(len(Q))[:, [3]] * np.eye(len(Q))[7],
    "NaN": lambda Q: Q * np.where(np.eye(len(Q)) == 1, np.nan, 1.0),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_that_the_entries_show_is_refused_when_a_large_system_is_built(mistake):
    Q, B = large()
    with pytest.raises(phc.StructureError, match=r"Q is (indefinite|not symmetric|not finite)"):
        phc.ph(MISTAKES[mistake](Q), B)


def test_a_small_system_is_refused_when_it_is_built_whatever_the_mistake():
    with pytest.raises(phc.StructureError, match="Q is indefinite"):
        phc.ph(hidden_sign(32), np.ones(64))


USES = {
    "modes": lambda sys: sys.modes, "d": lambda sys: sys.d, "r": lambda sys: sys.r, "A": lambda sys: sys.A,
    "C": lambda sys: sys.C, "S": lambda sys: sys.S, "v": lambda sys: sys.v, "poles": lambda sys: sys.poles(),
    "zeros": lambda sys: sys.zeros(), "response": lambda sys: sys(1j), "canonical": lambda sys: sys.is_canonical,
    "energy": lambda sys: sys.hamiltonian(np.ones(80)), "simulation": lambda sys: ct.step_response(sys, [0, 1]),
    "minreal": phc.minreal, "copy": lambda sys: copy.copy(sys).d, "scaled": lambda sys: (2 * sys).d,
    "sum": lambda sys: (sys + sys).d, "linear": lambda sys: ct.ss(sys), "tf": ct.tf,
}  # fmt: skip


@pytest.mark.parametrize("use", USES)
def test_a_large_indefinite_matrix_is_refused_by_the_first_use_of_it(use):
    sys = phc.ph(hidden_sign(), np.ones(80))
    with pytest.raises(
        phc.StructureError, match=r"Q is indefinite: smallest eigenvalue .* -0\.51, allowed >= -1\.4e-13"
    ):
        USES[use](sys)


@pytest.mark.parametrize("use", ["modes", "A", "response"])
def test_so_is_one_of_an_affine_system(use):
    sys = phc.affine(hidden_sign(), np.eye(80)[0])
    with pytest.raises(phc.StructureError, match="Q is indefinite"):
        USES[use](sys)


@pytest.mark.parametrize("n", [17, 40, 120])
def test_frequencies_and_weights_alone_are_those_of_the_modes_and_give_way_to_them(n):
    Q, B = large(n)
    sys, whole = phc.ph(Q, B), phc.ph(Q, B).modes
    alone = sys.d, sys.r
    assert "_energy" not in sys._views
    assert np.max(np.abs(alone[0] - whole.d)) <= 4 * n * EPS * whole.d[-1]
    gap = np.min(np.abs(whole.d[:, None] - whole.d) + np.diag(np.full(n, np.inf)), axis=1)
    assert np.all(np.abs(alone[1] - whole.r) <= 4 * n * EPS * whole.d[-1] / gap * whole.r.max())
    assert np.array_equal(sys.poles()[n:].imag, alone[0])
    assert alone[0] is sys.d
    assert sys.modes.d is sys.d and sys.modes.r is sys.r
    assert np.array_equal(sys.d, whole.d)


def test_small_systems_and_many_ports_take_frequencies_from_the_modes():
    for Q, B in (large(16), large(20, ports=2)):
        sys = phc.ph(Q, B)
        assert sys.d is sys.modes.d


@pytest.mark.variants
@pytest.mark.parametrize("n", [12, 20])
def test_the_response_is_that_of_the_frequencies_shown_before_and_after_the_modes_are_asked_for(n):
    Q, B = large(n)
    sys, w = phc.ph(Q, B), np.random.default_rng(n).uniform(0.1, 3.0, 5)
    before, whole = sys(1j * w), sys.modes
    after = sys(1j * w)
    assert (n <= 16) == np.array_equal(before, after)
    with mp.workdps(40):
        exact, b = mp.matrix(Q.tolist()), mp.matrix(B.tolist())
        A = mp.matrix(ref.symplectic_form(n).tolist()) * exact
        truth = [(b.T * exact * mp.lu_solve(mp.mpc(0, x) * mp.eye(2 * n) - A, b))[0] for x in w.tolist()]
    gap = np.min(np.abs(whole.d[:, None] - whole.d) + np.diag(np.full(n, np.inf)), axis=1)
    for x, one, other, value in zip(w, before, after, truth, strict=True):
        away = np.abs(whole.d - x)
        # frequencies move terms, and weights by how close the next frequency is
        allowed = EPS * whole.d[-1] * np.sum(whole.kappa / away * (1 / away + 1 / gap))
        assert abs(complex(value) - one) <= 4 * allowed
        assert abs(complex(value) - other) <= allowed


@pytest.mark.parametrize("duplicate", COPIES, ids=["copy", "deepcopy", "pickle", "ph"])
def test_copies_share_what_has_been_computed(duplicate, monkeypatch):
    sys, alone = phc.ph(*large()), phc.ph(*large())
    modes, S, d = sys.modes, sys.S, alone.d
    twin, other = duplicate(sys), duplicate(alone)
    for name in ("energy_coordinates", "williamson", "port_spectrum"):
        monkeypatch.setattr(f"ph_control.systems.port_hamiltonian.{name}", None)
    assert np.array_equal(twin.modes.nu, modes.nu) and np.array_equal(twin.S, S) and np.array_equal(other.d, d)
    assert twin.hamiltonian(np.ones(80)) == sys.hamiltonian(np.ones(80))
    assert not twin.S.flags.writeable and not twin.Q.flags.writeable
    # and a multiple has the same Q
    assert np.array_equal((3.0 * sys).d, sys.d)


# --- names -------------------------------------------------------------------------------------------------------

NAMES = {"name": "beam", "inputs": ["force"], "outputs": ["speed"], "states": ["q1", "q2", "p1", "p2"]}


def names_of(sys):
    return {
        "name": sys.name,
        "inputs": sys.input_labels,
        "outputs": sys.output_labels,
        "states": sys.state_labels,
    }


def test_names_are_taken_as_python_control_takes_them():
    assert names_of(one_port(**NAMES)) == NAMES
    assert names_of(one_port(name="beam", input="force", output="speed", states=NAMES["states"])) == NAMES
    assert one_port().input_labels == ["u[0]"]
    assert one_port().output_labels == ["y[0]"]
    assert one_port().state_labels == ["x[0]", "x[1]", "x[2]", "x[3]"]
    assert one_port(inputs=1, states=4).state_labels == ["x[0]", "x[1]", "x[2]", "x[3]"]
    assert one_port(inputs="F").input_labels == ["F"]


def test_names_can_be_changed_and_are_checked_for_their_number():
    sys = one_port()
    sys.update_names(**NAMES)
    assert names_of(sys) == NAMES
    with pytest.raises(ValueError, match="number of inputs"):
        sys.update_names(inputs=["a", "b"])
    with pytest.raises(ValueError, match="number of states"):
        sys.update_names(states=["a", "b"])
    assert names_of(sys) == NAMES


@pytest.mark.parametrize(
    "source",
    [
        lambda: one_port(**NAMES),
        lambda: ct.ss(one_port(), **NAMES),
        lambda: ct.ss(one_port(**NAMES)),
    ],
)
def test_a_converted_system_keeps_all_names_with_its_coordinates(source):
    assert names_of(phc.ph(source())) == NAMES


def test_names_given_to_a_conversion_win_over_those_of_its_source():
    source = one_port(**NAMES)
    assert phc.ph(source, name="mast").name == "mast"
    assert phc.ph(source, inputs=["f"]).input_labels == ["f"]
    assert phc.ph(source, input="f").input_labels == ["f"]
    assert phc.ph(source, input="f").output_labels == ["speed"]
    assert phc.ph(source, states=list("abcd")).state_labels == list("abcd")
    assert phc.ph(source, inputs=None).input_labels == ["force"]
    assert phc.ph(ct.tf([1, 0], [1, 0, 4], inputs="f", outputs="v", name="t"), output="w").output_labels == ["w"]


def test_a_conversion_to_other_coordinates_keeps_the_names_of_the_ports_only():
    source = ct.tf([2, 0], [1, 0, 4], name="t", inputs=["f"], outputs=["v"])
    assert names_of(phc.ph(source)) == {"name": "t", "inputs": ["f"], "outputs": ["v"], "states": ["x[0]", "x[1]"]}


def test_a_generic_name_is_not_inherited():
    source = one_port()
    assert source.name.startswith("sys[")
    assert phc.ph(source).name != source.name


# --- printing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("operand", ["ph", "modal", "floating", "two", "nothing"])
@pytest.mark.parametrize("named", [False, True])
def test_the_printed_form_evaluates_to_the_same_system(operand, named):
    sys = OPERANDS[operand]()
    if named:
        sys.update_names(name="its", inputs=[f"F {i}" for i in range(sys.ninputs)], states=sys.nstates)
    words = {"ph": phc.ph, "modes": phc.modes, "ModalForm": phc.ModalForm, "array": np.array}
    twin = eval(repr(sys), words)
    assert type(twin) is PH
    assert np.array_equal(twin.Q, sys.Q)
    assert np.array_equal(twin.B, sys.B)
    assert np.array_equal(twin.modes.nu, sys.modes.nu)
    assert names_of(twin) == names_of(sys) if named else twin.state_labels == sys.state_labels


@SETTINGS
@given(st.lists(st.floats(1e-100, 1e100), min_size=2, max_size=4))
def test_the_printed_form_keeps_every_digit(numbers):
    words = {"ph": phc.ph, "modes": phc.modes, "ModalForm": phc.ModalForm, "array": np.array}
    sys = phc.ph(phc.modes(numbers, numbers[::-1]))
    twin = eval(repr(sys), words)
    assert np.array_equal(twin.d, sys.d)
    assert np.array_equal(twin.modes.nu, sys.modes.nu)


def test_the_printed_form_of_a_large_system_is_short_and_builds_no_matrices():
    assert len(repr(phc.ph(phc.modes(np.arange(1.0, 40_001.0), np.ones(40_000)), states=80_000))) < 1000


def test_the_printed_form_for_people_names_the_class_and_the_matrices():
    text = str(one_port(name="beam"))
    assert text.startswith("<PortHamiltonian>: beam")
    assert "A = [[" in text


# --- constructors ------------------------------------------------------------------------------------------------


def test_a_vector_is_one_port_and_a_column_the_same():
    assert np.array_equal(phc.ph(np.eye(2), [0, 1]).B, phc.ph(np.eye(2), [[0], [1]]).B)


def test_lists_integers_booleans_and_single_precision_are_numbers():
    for Q in ([[4, 0], [0, 1]], np.diag([4, 1]).astype(np.float32), np.diag([4, 1]).astype(np.int8)):
        sys = phc.ph(Q, (False, True))
        assert sys.Q.dtype == sys.B.dtype == float
        assert sys.d[0] == pytest.approx(2.0, rel=4 * EPS)
    assert phc.ph(np.eye(2) + 0j, [0, 1]).Q.dtype == float


def test_a_system_from_modes_is_in_williamson_coordinates():
    sys = phc.ph(phc.modes([3.0, 1.0], [0.25, 4.0]))
    assert np.array_equal(sys.d, [1.0, 3.0])
    assert np.array_equal(sys.r, [4.0, 0.25])
    assert np.array_equal(sys.Q, np.diag([1.0, 3.0, 1.0, 3.0]))
    assert np.array_equal(sys.S, np.eye(4))
    assert np.array_equal(sys.v, [2.0, 0.5, 0.0, 0.0])


def test_the_modes_of_a_system_are_kept_not_computed_anew():
    form = phc.modes([1.0, 2.0], [1.0, 1.0])
    assert phc.ph(form).modes is form
    assert phc.modes(form) is form
    assert np.array_equal(phc.modes(phc.ph(form)).d, form.d)


def test_an_almost_symmetric_matrix_is_accepted_up_to_rounding_and_not_beyond():
    Q = np.diag([4.0, 1.0])
    allowed = 1000 * 2 * EPS * 4.0
    Q[0, 1] = 0.9 * allowed
    assert phc.ph(Q, [0, 1]).n == 1
    Q[0, 1] = 1.1 * allowed
    with pytest.raises(phc.StructureError, match="Q is not symmetric"):
        phc.ph(Q, [0, 1])


@pytest.mark.parametrize("scale", [1e-150, 1e-9, 1e9, 1e150])
def test_units_of_energy_do_not_matter(scale):
    sys = phc.ph(scale * np.diag([4.0, 1.0]), [0.0, 1.0])
    assert sys.d[0] == pytest.approx(2 * scale, rel=8 * EPS)
    assert sys.r[0] == pytest.approx(0.5, rel=8 * EPS)


def test_springs_and_masses_of_very_different_units_are_positive_definite():
    sys = phc.ph(np.diag([1e12, 1e-12]), [0.0, 1.0])
    assert sys.d[0] == pytest.approx(1.0, rel=8 * EPS)
    assert len(sys.modes.rigid) == 0


# --- the range of doubles ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("B", [[1e-200, 0.0], [1e-154, 0.0], [1e154, 0.0]])
def test_an_input_matrix_whose_squares_leave_the_range_is_refused_and_not_taken_for_zero(B):
    with pytest.raises(phc.StructureError, match=r"B is out of range: .* allowed 1e-153 to 1e"):
        phc.ph(np.eye(2), B)
    assert phc.ph(np.eye(2), [1e-153, 0.0]).r > 0 and phc.ph(np.eye(2), [0.0, 0.0]).r == 0


@pytest.mark.parametrize(
    ("Q", "B"),
    [
        (np.diag([1.0, 4.0, 1.0, 1.0]), [1.0, 1e-200, 0.0, 0.0]),
        (1e-10 * np.eye(2), [1e-150, 0.0]),
        (np.diag([0.0, 1.0, 1.0, 1.0]), [0.0, 1.0, 1e-200, 0.0]),
    ],
    ids=["one of two modes", "residue", "rigid body"],
)
def test_a_mode_reached_with_a_weight_whose_square_underflows_is_not_one_that_no_port_reaches(Q, B):
    with pytest.raises(phc.StructureError, match="the modal weights of this Q and B leave the range of doubles"):
        _ = phc.ph(Q, B).modes


def test_the_rounding_of_a_small_input_matrix_is_no_weight():
    Q, _ = ref.random_hamiltonian(np.arange(1.0, 6.0), np.random.default_rng(0), 0.5)
    _, S = phc.williamson(Q)
    small = 1e-145 * np.linalg.inv(S)[:, 0]
    weights = phc.ph(Q, small).r
    assert abs(weights[0] - 1e-290) < 1e-12 * 1e-290 and np.all(weights[1:] < 1e-12 * weights[0])


@pytest.mark.parametrize("factor", [1e308, 1e-308])
@pytest.mark.parametrize(
    "sys",
    [
        phc.ph(phc.modes([1.0], [1.0])),
        phc.ph(np.eye(2), [0.0, 1.0]),
        phc.ph(phc.ph(np.diag([0.0, 1.0]), [0.0, 1.0]).modes),
    ],
    ids=["modes", "matrices", "rigid body"],
)
def test_a_factor_that_leads_out_of_the_range_is_refused(sys, factor):
    with pytest.raises(phc.StructureError, match=r"(times .* leave the range of doubles|times .* is out of range)"):
        for _ in range(3):
            sys = factor * sys


class Plant(phc.PortHamiltonian):
    """A class of a user, whose constructor takes something else."""

    def __init__(self, stiffness):
        super().__init__(np.diag([stiffness, 1.0]), [0.0, 1.0])


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda sys: pickle.loads(pickle.dumps(sys))])
def test_a_copy_of_a_subclass_is_of_that_class(duplicate):
    sys = Plant(4.0)
    twin = duplicate(sys)
    assert type(twin) is Plant and np.array_equal(twin.Q, sys.Q)
    assert type(duplicate(Plant._from_modes(sys.modes))) is Plant
    assert type(phc.ph(sys)) is phc.PortHamiltonian


@pytest.mark.parametrize("z", [[1e200, 0.0], [[1.0, 0.0], [0.0, 1.7e308]]])
def test_a_state_whose_energy_exceeds_the_range_is_refused_with_the_figure(z):
    with pytest.raises(
        phc.StructureError, match=r"z is out of range: its largest entry is 1.*e\+[23]0[08], whose energy"
    ):
        phc.ph(np.eye(2), [0.0, 1.0]).hamiltonian(z)


@pytest.mark.parametrize(
    "make",
    [
        lambda **k: phc.ph(np.eye(2), [0, 1], **k),
        lambda **k: phc.ph(np.eye(2), [0, 1], J=[[0, 2], [-2, 0]], **k),
        lambda **k: phc.ph(phc.modes(1.0, 1.0), **k),
        lambda **k: phc.ph(phc.ch([1.0], [1.0, 0.0]), **k),
        lambda **k: phc.ph(ct.tf([1, 0], [1, 0, 4]), **k),
    ],
)
@pytest.mark.parametrize("keyword", [{"method": "exact"}, {"intersample": "foh"}], ids=str)
def test_how_it_was_sampled_is_not_ignored_of_a_system_that_is_not_sampled(make, keyword):
    with pytest.raises(phc.StructureError, match="this one is not sampled"):
        make(**keyword)

"""Affine Hamiltonian systems: even transfer functions, whose derivatives are port-Hamiltonian."""

import copy
import pickle

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_transfer_function, random_hamiltonian, symplectic_form

import ph_control as phc

relaxed = settings(deadline=None, max_examples=15, derandomize=True)
POINTS = np.array([0.3 + 1j, -2.0 + 0.1j, 5.0])


def random_affine(n, seed, squeeze=0.5):
    rng = np.random.default_rng(seed)
    Q, _ = random_hamiltonian(np.cumsum(rng.uniform(0.5, 1.5, n)), rng, squeeze)
    return Q, rng.standard_normal(2 * n)


@relaxed
@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_the_transfer_function_is_that_of_the_equations_and_even(n, seed):
    Q, b = random_affine(n, seed)
    J = symplectic_form(n)
    sys = phc.affine(Q, b)
    assert np.array_equal(sys.B[:, 0], -J @ b) and np.array_equal(sys.C[0], b)
    truth = np.array([dense_transfer_function(J @ Q, -(J @ b)[:, None], b[None, :], s)[0, 0] for s in POINTS])
    assert np.max(np.abs(sys(POINTS) - truth)) < 1e4 * n * EPS * np.max(np.abs(truth))
    assert np.max(np.abs(sys(-POINTS) - sys(POINTS))) < 64 * EPS * np.max(np.abs(truth))
    assert phc.is_even(sys) and not phc.is_odd(sys)


@relaxed
@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_the_derivative_of_the_output_is_port_hamiltonian(n, seed):
    Q, b = random_affine(n, seed)
    sys = phc.affine(Q, b)
    velocity = sys.derivative()
    assert type(velocity) is phc.PortHamiltonian
    assert np.array_equal(velocity.Q, Q) and np.array_equal(velocity.B[:, 0], -symplectic_form(n) @ b)
    assert np.max(np.abs(velocity(POINTS) - POINTS * sys(POINTS))) < 64 * EPS * np.max(np.abs(velocity(POINTS)))
    assert phc.is_odd(velocity) and not phc.is_even(velocity)
    assert np.array_equal(phc.ph(sys).Q, velocity.Q) and np.array_equal(phc.ph(sys).B, velocity.B)


@relaxed
@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.booleans())
def test_an_even_lossless_transfer_function_has_an_affine_realization(n, seed, polynomial):
    """The converse, from a state space in any coordinates and from polynomials."""
    rng = np.random.default_rng(seed)
    d, kappa = np.cumsum(rng.uniform(0.5, 1.5, n)), rng.uniform(0.1, 1.0, n)
    G = sum(ct.tf([k], [1, 0, x * x]) for x, k in zip(d, kappa, strict=True))
    if not polynomial:
        T = np.linalg.qr(rng.standard_normal((2 * n, 2 * n)))[0]
        blocks = ct.append(
            *(ct.ss([[0, x], [-x, 0]], [[0], [k]], [[1 / x, 0]], 0) for x, k in zip(d, kappa, strict=True))
        )
        A, B, C = blocks.A, blocks.B.sum(axis=1, keepdims=True), blocks.C.sum(axis=0, keepdims=True)
        G = ct.ss(T @ A @ T.T, T @ B, C @ T.T, 0)
    sys = phc.affine(G)
    assert sys.n == n
    truth = np.array([np.sum(kappa / (s * s + d * d)) for s in POINTS])
    assert np.max(np.abs(sys(POINTS) - truth)) < 1e-9 * np.max(np.abs(truth))
    assert np.max(np.abs(sys.d / d - 1)) < 1e-9


def test_poles_zeros_and_values_at_both():
    sys = phc.affine(np.diag([1.0, 4.0, 1.0, 1.0]), [1.0, 1.0, 0.0, 0.0])
    # 1/(s^2+1) + 1/(s^2+4) = (2 s^2 + 5)/..
    assert np.array_equal(sys.poles(), [-2j, -1j, 1j, 2j]) and np.allclose(
        sys.zeros().imag, [-np.sqrt(2.5), np.sqrt(2.5)]
    )
    assert sys([0.0])[0] == 1.25
    assert np.isposinf(sys([1j])[0].real) and np.isposinf(sys([-2j])[0].real)
    assert abs(sys([1j * np.sqrt(2.5)])[0]) < 8 * EPS


def test_a_rigid_body_has_a_double_pole_at_0():
    sys = phc.affine(np.diag([0.0, 2.0]), [1.0, 0.0])
    assert np.isposinf(sys([0.0])[0].real)
    assert abs(sys([2j])[0] - 2.0 / (2j) ** 2) < 4 * EPS
    G = phc.tf(sys)
    assert np.allclose(G.num_list[0][0], [2], rtol=4 * EPS) and np.array_equal(G.den_list[0][0], [1, 0, 0])
    assert phc.is_even(ct.tf([1], [1, 0, 0])) and phc.affine(ct.tf([2], [1, 0, 0])).n == 1


def test_the_static_gain_is_the_compliance():
    Q, b = np.diag([3.0, 5.0, 1.0, 2.0]), np.array([1.0, 2.0, 0.0, 0.0])
    assert abs(phc.affine(Q, b)([0.0])[0] - b @ np.linalg.solve(Q, b)) < 8 * EPS


def test_an_affine_system_copies_pickles_prints_itself_and_is_locked():
    sys = phc.affine(np.diag([4.0, 1.0]), [1.0, 0.0], name="spring", inputs="force", outputs="position")
    for twin in (
        pickle.loads(pickle.dumps(sys)),
        copy.deepcopy(sys),
        eval(repr(sys), vars(np) | {name: getattr(phc, name) for name in phc.__all__}),
        phc.affine(sys),
    ):
        assert type(twin) is type(sys) and np.array_equal(twin.Q, sys.Q) and np.array_equal(twin.C, sys.C)
        assert twin.output_labels == ["position"]
    assert type(sys + sys) is ct.StateSpace
    assert sys.derivative().input_labels == ["force"]
    with pytest.raises(AttributeError, match=r"B of a AffineHamiltonian cannot be changed: .* affine\(Q, B\)"):
        sys.B = np.eye(2)


@pytest.mark.parametrize(
    ("sys", "odd", "even"),
    [
        (ct.tf([1, 0], [1, 0, 4]), True, False),
        (ct.tf([1], [1, 0, 4]), False, True),
        (ct.tf([1], [1, 0]), True, False),
        (ct.tf([1, 1], [1, 0, 4]), False, False),
        (ct.tf([1], [1, 1]), False, False),
        (ct.ss([[0, 1], [-4, 0]], [[0], [1]], [[0, 1]], 0), True, False),
        (ct.ss([[0, 1], [-4, 0]], [[0], [1]], [[1, 0]], 0), False, True),
        (ct.ss([[0, 1], [-4, 0]], [[0], [1]], [[1, 0]], 3), False, True),
        (ct.ss([[0, 1], [-4, -1e-9]], [[0], [1]], [[0, 1]], 0), False, False),
        (1e-12 * ct.tf([1e6, 0], [1, 0, 4e12]), True, False),
        (ct.tf([1, 0], [1, 0, -4]), True, False),
    ],
)
def test_the_symmetries_of_a_transfer_function(sys, odd, even):
    assert bool(phc.is_odd(sys)) is odd and bool(phc.is_even(sys)) is even
    for verdict in (phc.is_odd(sys), phc.is_even(sys)):
        assert verdict.holds == (verdict.residual <= verdict.allowed)
        assert verdict.holds or verdict.residual > 1e-10


def test_the_tolerance_of_a_symmetry_can_be_given():
    nearly = ct.tf([1, 1e-6], [1, 0, 4])
    assert not phc.is_odd(nearly) and phc.is_odd(nearly, rtol=1e-3)


BAD = {
    "damped": (lambda: phc.affine(ct.tf([1], [1, 0.1, 4])), phc.NotLosslessError, "off the imaginary axis"),
    "odd": (lambda: phc.affine(ct.tf([1, 0], [1, 0, 4])), phc.NotLosslessError, "feedthrough"),
    "not even": (
        lambda: phc.affine(ct.ss([[0, 1], [-4, 0]], [[0], [1]], [[1, 1]], 0)),
        phc.NotLosslessError,
        "the transfer function is not even: C B = 1",
    ),
    "negative": (lambda: phc.affine(ct.tf([-1], [1, 0, 4])), phc.NotLosslessError, "negative"),
    "feedthrough": (lambda: phc.affine(ct.ss(ct.tf([1, 0, 5], [1, 0, 4]))), phc.NotLosslessError, "feedthrough D = 1"),
    "discrete": (lambda: phc.affine(ct.tf([1], [1, 0, 4], 0.1)), phc.StructureError, "continuous-time"),
    "port-Hamiltonian": (
        lambda: phc.affine(phc.ph(np.eye(2), [0, 1])),
        phc.StructureError,
        r"affine\(sys.Q, symplectic",
    ),
    "no system": (lambda: phc.affine("spring"), phc.StructureError, "this is a str"),
    "two ports": (
        lambda: phc.affine(np.eye(2), np.eye(2)),
        phc.StructureError,
        r"the outputs of the ports do not commute: max \|B\^T J B\| = 1",
    ),
    "symmetry of a number": (lambda: phc.is_odd(3.0), phc.StructureError, "this is a float"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_has_no_affine_form_is_refused_with_the_reason(name):
    call, error, message = BAD[name]
    with pytest.raises(error, match=message):
        call()


def test_what_takes_an_odd_transfer_function_does_not_take_an_affine_system_for_its_derivative():
    sys = phc.affine(np.diag([4.0, 1.0]), [1.0, 0.0])
    for call in (phc.ch, phc.oh, phc.minreal, phc.kalman_decomposition, lambda s: phc.same_filter(s, s)):
        with pytest.raises(phc.StructureError, match=r"is even, .* odd; pass sys.derivative\(\)"):
            call(sys)
    assert phc.modes(sys.derivative()).d == 2


@pytest.mark.parametrize("rtol", ["a", [1e-6], np.nan, np.inf, 1.0, -1])
@pytest.mark.parametrize("test", [phc.is_odd, phc.is_even])
def test_a_tolerance_of_no_meaning_is_refused(test, rtol):
    with pytest.raises(phc.StructureError, match=r"rtol is .*; a relative tolerance is a number from 0 to 1"):
        test(ct.tf([1, 0], [1, 0, 1]), rtol=rtol)


# --- values at and beyond the ends of the range ----------------------------------------------------------------------


@pytest.mark.parametrize("point", [complex(0, np.inf), complex(np.inf, 0), complex(-np.inf, np.inf), np.inf])
def test_at_infinity_the_value_is_0(point):
    for Q in (np.eye(2), np.diag([0.0, 1.0])):
        assert phc.affine(Q, [1.0, 0.0])([point])[0] == 0
    two = phc.affine(np.eye(4), np.eye(4)[:, :2])
    assert not two.horner([point, 1.0])[:, :, 0].any()


@pytest.mark.parametrize("point", [1e-200j, 1e-160, 5e-324j, 0.0])
def test_next_to_the_double_pole_of_a_rigid_body_the_value_is_beyond_doubles(point):
    assert phc.affine(np.diag([0.0, 1.0]), [1.0, 0.0])([point])[0] == complex(np.inf, 0)
    B = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    values = phc.affine(np.diag([0.0, 4.0, 1.0, 1.0]), B).horner([point])[:, :, 0]
    assert values[0, 0] == complex(np.inf, 0) and values[0, 1] == values[1, 0] == 0
    assert abs(values[1, 1] - 0.25) < 4 * EPS


@pytest.mark.parametrize("point", [0.0, 5e-324j, 1e-300, 1e-100j, 1e-20, 1e-12, 1e-9j])
def test_well_below_its_frequencies_a_system_has_its_static_value(point):
    Q, S = random_hamiltonian(np.array([1.0, 2.0, 3.5]), np.random.default_rng(3), 0.5)
    B = np.linalg.inv(S) @ np.random.default_rng(4).standard_normal((6, 1))
    other = symplectic_form(3) @ np.linalg.qr(np.column_stack([B, np.eye(6)]))[0][:, 1:2]
    other = other - symplectic_form(3) @ B * (B.T @ symplectic_form(3) @ other) / -(B.T @ B)
    for ports in (B, np.column_stack([B, other])):
        compliance = ports.T @ np.linalg.solve(Q, ports)
        off = np.abs(phc.affine(Q, ports).horner([point])[:, :, 0] - compliance)
        # linear in s off the diagonal
        assert np.max(off) < (1e3 * EPS + 10 * abs(point)) * np.max(np.abs(compliance))


# --- symmetry of large state spaces ----------------------------------------------------------------------------------


@pytest.mark.parametrize("ports", [1, 2])
def test_the_symmetry_of_a_state_space_is_decided_without_dense_solutions_at_points(ports, monkeypatch):
    rng = np.random.default_rng(0)
    Q, _ = random_hamiltonian(np.linspace(1, 3, 12), rng, 0.3)
    lossless = phc.ph(Q, rng.standard_normal((24, ports)))
    plain = ct.StateSpace(lossless.A, lossless.B, lossless.C, lossless.D)
    damped = ct.StateSpace(lossless.A - 1e-6 * np.eye(24), lossless.B, lossless.C, lossless.D)
    monkeypatch.setattr(np.linalg, "solve", None)
    monkeypatch.setattr(ct.StateSpace, "horner", None)
    assert bool(phc.is_odd(plain)) is (ports == 1)  # the skew part of several ports is even
    assert not phc.is_odd(damped) and not phc.is_even(damped)


@relaxed
@given(st.integers(1, 6), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_the_residual_of_a_symmetry_is_that_of_dense_solutions(n, ports, seed):
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, ports)), rng.standard_normal((2, n))
    D = rng.standard_normal((2, ports))
    found = phc.is_odd(ct.StateSpace(A, B, C, D))
    poles = np.abs(np.linalg.eigvals(A))
    angles = np.pi * np.where(np.arange(4 * n + 4) % 2, 0.37, 0.21)
    s = np.geomspace(poles.min() / 3, 3 * poles.max(), 4 * n + 4) * np.exp(1j * angles)
    here, there = (np.array([dense_transfer_function(A, B, C, x) + D for x in part]) for part in (s, -s))
    truth = np.max(np.abs(here + there) / (np.abs(here) + np.abs(there)))
    assert not found and abs(found.residual - truth) <= found.allowed


def test_a_small_transfer_function_is_odd_without_a_warning():
    assert phc.is_odd(phc.tf(phc.ph(phc.modes([1.0], [1e-14]))))
    assert not phc.is_odd(ct.tf([1e-14, 1e-15], [1, 0, 1]))


def test_a_static_or_improper_system_has_a_symmetry_too():
    assert phc.is_even(ct.ss([], [], [], 3.0)) and not phc.is_odd(ct.ss([], [], [], 3.0))
    assert phc.is_odd(ct.tf([1, 0, 0, 0], [1])) and not phc.is_odd(ct.tf([1, 0, 0, 1], [1]))


class Spring(phc.AffineHamiltonian):
    """A class of a user, whose constructor takes something else."""

    def __init__(self, stiffness):
        super().__init__(np.diag([stiffness, 1.0]), [1.0, 0.0])


def test_a_copy_of_a_subclass_is_of_that_class():
    sys = Spring(4.0)
    for twin in (pickle.loads(pickle.dumps(sys)), copy.copy(sys), copy.deepcopy(sys)):
        assert type(twin) is Spring and np.array_equal(twin.Q, sys.Q)


def test_the_affine_system_of_a_port_hamiltonian_one_is_found_as_its_refusal_says():
    sys = phc.spring_chain([1.0, 2.0], 10.0, ground=1.0)
    position = phc.affine(sys.Q, phc.symplectic_form(sys.n) @ sys.B)
    assert np.array_equal(position.derivative().B, sys.B)

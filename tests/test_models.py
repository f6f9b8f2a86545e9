"""Known systems against independent matrices, closed formulas and a published benchmark."""

import json

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import mmread
from scipy.linalg import eigh
from scipy.sparse import csr_array

from ph_control import (
    PortHamiltonian,
    StructureError,
    frenkel_kontorova,
    from_second_order,
    lc_circuit,
    msd_chain,
    rcl_ladder,
    spring_chain,
)

EPS = np.finfo(float).eps
quick = settings(deadline=None, max_examples=13, derandomize=True)
positive = st.floats(0.1, 10.0)


@pytest.fixture
def published(data_folder):
    """Parameters and answers of published models."""
    return json.loads((data_folder / "models" / "phbench_params_and_refs.json").read_text())


def energy_by_springs(z, masses, springs, ground):
    """The energy of a chain, spring by spring, mass by mass."""
    n = len(masses)
    q, p = z[:n], z[n:]
    total = sum(p[i] ** 2 / (2 * masses[i]) for i in range(n))
    total += sum(springs[i] * (q[i + 1] - q[i]) ** 2 / 2 for i in range(n - 1))
    return total + sum(ground[i] * q[i] ** 2 / 2 for i in range(n))


def dense_response(sys, s):
    A, B, C = (np.asarray(M) for M in (sys.A, sys.B, sys.C))
    return C @ np.linalg.solve(s * np.eye(len(A)) - A, B)


# --- LC circuit ---


def test_the_papers_circuit_has_its_Hamiltonian_and_port():
    C, L = [1.0, 2.0, 4.0], [0.5, 0.25, 8.0]
    sys = lc_circuit(C, L)
    assert np.array_equal(sys.Q, np.diag([1.0, 0.5, 0.25, 2.0, 4.0, 0.125]))
    assert np.array_equal(sys.B, [[0.0], [0.0], [0.0], [1.0], [1.0], [1.0]])
    assert isinstance(sys, PortHamiltonian)


def test_the_circuit_is_the_sum_of_its_branch_admittances():
    C, L = np.array([1.0, 0.3, 0.05]), np.array([2.0, 0.7, 0.4])
    sys = lc_circuit(C, L)
    for s in (0.3j, 1j, 0.2 + 5j):
        by_impedance = np.sum(1.0 / (s * L + 1.0 / (s * C)))
        assert abs(sys(s) / by_impedance - 1) < 100 * EPS


def test_the_circuit_resonates_at_one_over_root_L_C_with_residue_one_over_L():
    C, L = np.array([1.0, 0.5, 0.01]), np.array([3.0, 1.0, 0.2])
    sys = lc_circuit(C, L)
    np.testing.assert_allclose(sys.d, 1 / np.sqrt(L * C), rtol=10 * EPS)
    np.testing.assert_allclose(sys.modes.kappa, 1 / L, rtol=10 * EPS)


def test_five_equal_branches_are_not_canonical_and_five_different_ones_are():
    assert not lc_circuit(np.ones(5), np.ones(5)).is_canonical
    assert lc_circuit(np.ones(5), np.arange(1.0, 6.0)).is_canonical


def test_a_number_stands_for_every_branch():
    assert np.array_equal(lc_circuit(2.0, [1.0, 3.0]).Q, lc_circuit([2.0, 2.0], [1.0, 3.0]).Q)
    assert np.array_equal(lc_circuit([1.0, 3.0], 2.0).Q, lc_circuit([1.0, 3.0], [2.0, 2.0]).Q)
    assert lc_circuit(2.0, 2.0).n == 1


def test_the_circuit_names_its_signals_and_takes_the_users_names():
    sys = lc_circuit([1.0, 2.0], 1.0)
    assert (sys.input_labels, sys.output_labels) == (["V"], ["I"])
    assert sys.state_labels == ["Q_1", "Q_2", "phi_1", "phi_2"]
    named = lc_circuit([1.0, 2.0], 1.0, name="tank", input="source", outputs=["current"])
    assert (named.name, named.input_labels, named.output_labels) == ("tank", ["source"], ["current"])


@pytest.mark.parametrize(
    ("C", "L", "message"),
    [
        ([1.0, -2.0], 1.0, r"C\[1\] = -2; a capacitance is > 0"),
        (1.0, [1.0, 0.0], r"L\[1\] = 0; an inductance is > 0"),
        ([1.0, 2.0], [1.0, 2.0, 3.0], "C has 2 entries and L has 3"),
        ([], 1.0, r"C has shape \(0,\)"),
        ([[1.0]], 1.0, r"C has shape \(1, 1\)"),
        ([np.nan], 1.0, "C is not finite"),
        (1j, 1.0, "C is complex"),
        ("farad", 1.0, "C does not hold real numbers"),
    ],
)
def test_a_bad_circuit_is_refused_by_name(C, L, message):
    with pytest.raises(StructureError, match=message):
        lc_circuit(C, L)


# --- chains ---


def test_the_papers_chain_has_the_golden_frequencies_and_its_zero_at_one():
    sys = frenkel_kontorova()
    golden = (1 + np.sqrt(5)) / 2
    np.testing.assert_allclose(sys.d, [golden - 1, golden], rtol=8 * EPS)
    np.testing.assert_allclose(sys.zeros().imag, [-1, 0, 1], rtol=8 * EPS, atol=8 * EPS)
    assert np.array_equal(sys.Q, [[2, -1, 0, 0], [-1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert np.array_equal(sys.B, [[0], [0], [1], [0]])


@pytest.mark.parametrize("n", [1, 3, 20, 100])
def test_the_chain_of_n_has_the_fixed_free_frequencies_and_is_canonical(n):
    sys = frenkel_kontorova(n)
    expected = 2 * np.sin((2 * np.arange(1, n + 1) - 1) * np.pi / (2 * (2 * n + 1)))
    # the squares are eigenvalues of a matrix of norm 4: absolute accuracy there, divided by the smallest here
    np.testing.assert_allclose(sys.d, expected, rtol=0, atol=16 * n * EPS * 4 / expected[0])
    assert sys.is_canonical


@pytest.mark.parametrize("n", [0, -1, 2.0, True, "two", None])
def test_a_number_of_masses_that_is_none_is_refused(n):
    with pytest.raises(StructureError, match=r"n is .*; it must be a whole number from 1 to"):
        frenkel_kontorova(n)


@quick
@given(st.integers(1, 6), st.data())
def test_the_Hamiltonian_of_a_chain_is_the_energy_of_its_springs_and_masses(n, data):
    masses = data.draw(st.lists(positive, min_size=n, max_size=n))
    springs = data.draw(st.lists(positive, min_size=n - 1, max_size=n - 1))
    ground = data.draw(st.lists(st.floats(0.0, 5.0), min_size=n, max_size=n))
    port = data.draw(st.integers(0, n - 1))
    sys = spring_chain(masses, springs, ground=ground, port=port)
    z = np.array(data.draw(st.lists(st.floats(-3, 3), min_size=2 * n, max_size=2 * n)))
    expected = energy_by_springs(z, masses, springs, ground)
    scale = 1 + 0.5 * np.max(np.abs(sys.Q)) * np.sum(z**2)
    assert abs(0.5 * z @ sys.Q @ z - expected) <= 100 * n * EPS * scale
    momentum = np.zeros(2 * n)
    momentum[n + port] = 1
    assert np.array_equal(sys.B[:, 0], momentum)
    # the output is the velocity of that mass
    assert np.isclose((sys.C @ z)[0], z[n + port] / masses[port], rtol=4 * EPS, atol=0)


def test_a_floating_chain_has_one_rigid_body_mode_with_the_whole_mass():
    masses = np.array([0.3, 1.7, 2.2, 0.9])
    for port in range(4):
        sys = spring_chain(masses, [3.1, 0.7, 1.9], port=port)
        assert len(sys.d) == 3
        assert abs(sys.modes.kappa_0 * masses.sum() - 1) < 100 * EPS


def test_one_ground_spring_is_enough_to_hold_the_chain():
    assert len(spring_chain([1.0, 1.0, 1.0], 1.0, ground=[0, 0, 1e-3]).d) == 3
    assert len(spring_chain([1.0, 1.0, 1.0], 1.0, ground=[0, 0, 0]).d) == 2


def test_a_chain_between_two_walls_has_the_textbook_frequencies():
    n, m, k = 7, 2.0, 8.0
    sys = spring_chain(np.full(n, m), k, ground=[k, *np.zeros(n - 2), k])
    expected = 2 * np.sqrt(k / m) * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    np.testing.assert_allclose(sys.d, expected, rtol=1000 * EPS)


def test_several_ports_are_several_columns_in_the_given_order():
    both = spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=[2, 0])
    assert (both.input_labels, both.output_labels) == (["F_1", "F_2"], ["v_1", "v_2"])
    assert np.array_equal(both.B, np.eye(6)[:, [5, 3]])
    single = spring_chain([1.0, 2.0, 3.0], 1.0, ground=1.0, port=2)
    assert (single.input_labels, single.output_labels) == (["F"], ["v"])
    assert np.array_equal(single.B, both.B[:, :1])


def test_the_chain_names_its_states_and_is_a_system_of_python_control():
    sys = spring_chain([1.0, 1.0], ground=1.0, name="beam")
    assert sys.state_labels == ["q_1", "q_2", "p_1", "p_2"]
    assert sys.name == "beam"
    assert isinstance(sys, ct.StateSpace)


def test_the_chain_leaves_its_arguments_alone():
    masses, springs, ground = np.ones(3), np.ones(2), np.ones(3)
    sys = spring_chain(masses, springs, ground=ground)
    masses[0] = springs[0] = ground[0] = 99.0
    assert np.array_equal(sys.Q, spring_chain(np.ones(3), np.ones(2), ground=np.ones(3)).Q)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"masses": [1.0, 0.0]}, r"masses\[1\] = 0; a mass is > 0"),
        ({"masses": []}, r"masses has shape \(0,\)"),
        ({"masses": [1.0, np.inf]}, "masses is not finite"),
        ({"masses": [1.0, 1.0], "stiffnesses": [1.0, 1.0]}, r"stiffnesses has shape \(2,\).* the 1 springs between 2"),
        ({"masses": [1.0, 1.0], "stiffnesses": [-1.0]}, r"stiffnesses\[0\] = -1; a stiffness is not negative"),
        ({"masses": [1.0, 1.0], "ground": [1.0]}, r"ground has shape \(1,\).* the 2 masses"),
        ({"masses": [1.0, 1.0], "ground": [0.0, -2.0]}, r"ground\[1\] = -2; a stiffness is not negative"),
        ({"masses": [1.0, 1.0], "port": 2}, "port is 2; masses are counted from 0 to 1"),
        ({"masses": [1.0, 1.0], "port": -1}, "port is -1; masses are counted from 0 to 1"),
        ({"masses": [1.0, 1.0], "port": 0.5}, "port is 0.5"),
        ({"masses": [1.0, 1.0], "port": True}, "port is True"),
        ({"masses": [1.0, 1.0], "port": "first"}, "port is 'first'"),
        ({"masses": [1.0, 1.0], "port": []}, "port is .*; name at least one"),
    ],
)
def test_a_bad_chain_is_refused_by_name(arguments, message):
    with pytest.raises(StructureError, match=message):
        spring_chain(**arguments)


# --- mass and stiffness matrices ---


def random_structure(n, rng, rigid=0):
    """Random M > 0 and K >= 0 with a kernel of dimension `rigid`."""
    F = rng.standard_normal((n, n + 2))
    G = rng.standard_normal((n, n - rigid))
    return F @ F.T, G @ G.T


def dynamic_stiffness(M, K, b, s):
    """`b^T s (s^2 M + K)^{-1} b`, straight from the equations of motion."""
    b = np.asarray(b, float).reshape(len(M), -1)
    return s * b.T @ np.linalg.solve(s**2 * M + K, b.astype(complex))


@quick
@given(st.integers(1, 8), st.integers(1, 3), st.booleans(), st.integers(0, 2**32 - 1))
def test_a_second_order_model_has_the_response_of_its_equations_of_motion(n, ports, floating, seed):
    rng = np.random.default_rng(seed)
    M, K = random_structure(n, rng, int(floating))
    b = rng.standard_normal((n, ports))
    sys = from_second_order(M, K, b)
    assert (sys.n, len(sys.d)) == (n, n - floating)
    inverse = np.linalg.inv(M)
    assert np.max(np.abs(sys.Q[n:, n:] - inverse)) < 100 * n * EPS * np.linalg.cond(M) * np.max(np.abs(inverse))
    assert np.array_equal(sys.Q, sys.Q.T)
    assert not sys.Q[:n, n:].any() and np.array_equal(sys.B, np.r_[0 * b, b])
    condition = np.linalg.cond(M) * np.linalg.norm(K, 2) * np.linalg.norm(inverse, 2)
    for s in (1.0 + 2j, 0.5, 0.1 + 10j):
        truth = dynamic_stiffness(M, K, b, s)
        assert np.max(np.abs(sys.horner(s)[:, :, 0] - truth)) < 1e3 * n * EPS * (1 + condition) * np.max(np.abs(truth))


def test_a_chain_by_its_matrices_is_the_chain():
    masses = np.array([1.0, 2.0, 4.0])
    chain = spring_chain(masses, [3.0, 5.0], ground=[1.0, 0.0, 0.0])
    same = from_second_order(np.diag(masses), chain.Q[:3, :3], [1.0, 0.0, 0.0])
    assert np.max(np.abs(same.Q - chain.Q)) <= 2 * EPS
    assert np.array_equal(same.B, chain.B)
    assert (same.input_labels, same.output_labels, same.state_labels) == (["F"], ["v"], chain.state_labels)


def test_massless_degrees_of_freedom_are_refused_by_number_and_condensed_on_request():
    # mass - spring - massless joint - spring - mass: the joint makes the two springs one
    M = np.diag([1.0, 0.0, 3.0])
    K = np.array([[2.0, -2.0, 0.0], [-2.0, 5.0, -3.0], [0.0, -3.0, 3.0]])
    b = [1.0, 0.0, 0.0]
    with pytest.raises(
        StructureError, match=r"M is singular: 1 of 3 .* have no mass \(2, counted from 1\); .*condense=True"
    ):
        from_second_order(M, K, b)
    sys = from_second_order(M, K, b, condense=True)
    same = spring_chain([1.0, 3.0], 1 / (1 / 2 + 1 / 3))
    assert np.max(np.abs(sys.Q - same.Q)) < 8 * EPS
    assert sys.state_labels == ["q_1", "q_3", "p_1", "p_3"]
    # nothing is lost: the response is that of the full equations
    for s in (0.3 + 1j, 2.0):
        assert abs(sys(s) / dynamic_stiffness(M, K, b, s)[0, 0] - 1) < 100 * EPS


def test_condensing_where_every_degree_of_freedom_has_mass_changes_nothing():
    M, K = random_structure(3, np.random.default_rng(0))
    plain, condensed = (from_second_order(M, K, [1, 0, 0], condense=flag) for flag in (False, True))
    assert np.array_equal(plain.Q, condensed.Q)


STRUCTURE = {"M": np.eye(2), "K": np.array([[2.0, -1.0], [-1.0, 2.0]]), "F": [1.0, 0.0]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"M": np.eye(3)}, r"M has shape \(3, 3\) and K \(2, 2\); they must be the same"),
        ({"M": np.ones((2, 3))}, r"M has shape \(2, 3\); it must be \(n, n\)"),
        ({"K": np.zeros((0, 0))}, "K has shape .*at least one degree of freedom"),
        ({"M": [[1.0, 0.1], [0.0, 1.0]]}, "M is not symmetric"),
        ({"K": np.diag([1.0, -1.0])}, "K is indefinite"),
        ({"M": np.ones((2, 2))}, "M is singular: its smallest eigenvalue .* a combination of degrees of freedom"),
        ({"M": np.ones((2, 2)), "condense": True}, "a force acts on degrees of freedom without mass"),
        ({"M": np.zeros((2, 2)), "condense": True}, "M is zero"),
        ({"M": np.diag([0.0, 1.0]), "condense": True}, r"a force acts on .* without mass \(1, counted from 1\)"),
        (
            {"M": np.diag([1.0, 0.0]), "K": np.diag([1.0, 0.0]), "condense": True},
            "one of their motions deforms no spring",
        ),
        ({"F": [1.0, 0.0, 0.0]}, r"F has shape \(3,\); .* it must be \(2,\) or \(2, number of ports\)"),
        ({"F": np.zeros((2, 0))}, "F has no columns"),
        ({"F": 1.0}, r"F has shape \(\)"),
        ({"C": [[1.0, 0.0], [0.0, -0.5]]}, "C has a negative eigenvalue: -0.5 "),
        ({"C": [[1.0, 3.0], [3.0, 1.0]]}, "C has a negative eigenvalue: -2 "),
        ({"C": [[1.0, 0.5], [0.0, 1.0]]}, r"C is not symmetric: .* a skew part is gyroscopic: pass it as G="),
        ({"C": np.eye(3)}, r"C has shape \(3, 3\); it must be \(2, 2\)"),
        ({"C": np.nan * np.eye(2)}, "C is not finite"),
        ({"sensors": {"speed": [1.0, 0.0]}}, "the sensors measure 'speed'; known are 'position', 'displacement'"),
        ({"sensors": {"velocity": [1.0, 0.0, 0.0]}}, "the sensors of velocity have shape"),
        (
            {"M": np.diag([1.0, 0.0]), "C": np.eye(2), "condense": True},
            "dampers act on degrees of freedom without mass .among 2,",
        ),
        ({"M": csr_array(np.eye(2))}, "M, K, C or G is sparse, .*give modes=.* or the toarray"),
    ],
)
def test_a_bad_structure_is_refused_by_name(change, message):
    with pytest.raises(StructureError, match=message):
        from_second_order(**(STRUCTURE | change))


@quick
@given(st.integers(1, 6), st.integers(1, 2), st.integers(0, 2**32 - 1))
def test_damping_and_sensors_are_those_of_the_equations_of_motion(n, ports, seed):
    rng = np.random.default_rng(seed)
    M, K = random_structure(n, rng)
    half = rng.standard_normal((n, rng.integers(1, n + 1)))
    C, F = 0.3 * half @ half.T, rng.standard_normal((n, ports))
    rows = {kind: rng.standard_normal((2, n)) for kind in ("acceleration", "position", "velocity")}
    rows["displacement"] = rows["position"]
    sys = from_second_order(M, K, F, C=C, sensors=rows)
    inverse, condition = np.linalg.inv(M), np.linalg.cond(M) * np.linalg.cond(K)
    assert np.array_equal(sys.R[n:, n:], 0.5 * (C + C.T)) and not sys.R[:n].any() and not sys.is_lossless
    for s in (1.0 + 2j, 0.5, 0.1 + 10j):
        q = np.linalg.solve(s**2 * M + s * C + K, F.astype(complex))
        factor = {"position": 1, "displacement": 1, "velocity": s, "acceleration": s**2}
        truth = np.vstack([s * F.T @ q, *(factor[kind] * part @ q for kind, part in rows.items())])
        assert np.max(np.abs(sys.horner(s)[:, :, 0] - truth)) < 1e4 * n * EPS * condition * np.max(np.abs(truth))
    np.testing.assert_allclose(sys.D[ports : ports + 2], rows["acceleration"] @ inverse @ F, rtol=1e-8, atol=1e-10)
    assert sys.output_labels[ports:] == [f"{kind}_{k}" for kind in rows for k in (1, 2)]


def test_without_damping_and_sensors_a_structure_is_what_it_was():
    plain = from_second_order(**STRUCTURE)
    for same in ({"C": np.zeros((2, 2))}, {"sensors": {}}, {"sensors": {"velocity": np.zeros((0, 2))}}):
        other = from_second_order(**STRUCTURE, **same)
        assert type(plain) is type(other) is PortHamiltonian and np.array_equal(plain.Q, other.Q)
    seen = from_second_order(**STRUCTURE, sensors=[0.0, 1.0])
    assert seen.is_lossless and seen.output_labels == ["v", "position"]
    np.testing.assert_array_equal(seen.C[1], [0, 1, 0, 0])


def test_sensors_see_the_degrees_of_freedom_that_were_condensed():
    """Mass - spring - massless joint - spring - mass, dampers to the ground; and the same in turned coordinates."""
    M, C = np.diag([1.0, 0.0, 3.0]), np.diag([0.2, 0.0, 0.4])
    K = np.array([[3.0, -2.0, 0.0], [-2.0, 5.0, -3.0], [0.0, -3.0, 3.0]])
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    rows = {"position": np.eye(3), "velocity": np.eye(3), "acceleration": np.eye(3)}
    for T in (np.eye(3), turn):
        F = T.T @ [1.0, 0.0, 0.0]
        M_, C_, K_ = (T.T @ A @ T for A in (M, C, K))
        sys = from_second_order(M_, K_, F, C=C_, sensors=rows, condense=True)
        assert sys.n == 2
        for s in (0.3 + 1j, 2.0):
            q = np.linalg.solve(s**2 * M_ + s * C_ + K_, F)
            np.testing.assert_allclose(sys(s)[1:, 0], np.concatenate([q, s * q, s**2 * q]), rtol=1e-10, atol=1e-13)


def test_ports_and_names_of_a_structure():
    two = from_second_order(np.eye(2), STRUCTURE["K"], np.eye(2), name="frame")
    assert (two.name, two.input_labels, two.output_labels) == ("frame", ["F_1", "F_2"], ["v_1", "v_2"])
    assert from_second_order(**STRUCTURE, inputs="hammer").input_labels == ["hammer"]


# --- structures of others ---


def matrix(folder, name):
    found = mmread(folder / "structures" / f"{name}.mtx")
    return np.asarray(found.todense() if hasattr(found, "todense") else found, dtype=float)


def test_a_free_structure_has_six_rigid_modes_and_the_elastic_frequencies_of_its_finite_element_program(data_folder):
    with np.load(data_folder / "structures" / "nas2cam_k0.npz") as file:
        M, K, squares = file["M"], file["K"], file["lam_ref"]
    sys = from_second_order(M, K, np.eye(len(M))[0])
    assert (sys.n, len(sys.d), len(sys.modes.rigid)) == (54, 48, 6)
    assert np.max(np.abs(sys.d**2 / squares[6:] - 1)) < 1e-6
    assert np.count_nonzero(sys.poles() == 0) == 12


def test_a_wing_has_its_reference_frequencies(data_folder):
    with np.load(data_folder / "structures" / "wingbeam75.npz") as file:
        M, K, reference = file["M"], file["K"], file["f_ref_hz"]
    frequencies = from_second_order(M, K, np.eye(len(M))[0]).d / (2 * np.pi)
    # as near as the condition of the structure, 4e8, allows
    assert np.max(np.abs(frequencies / reference - 1)) < EPS * np.linalg.cond(K)


@pytest.mark.parametrize("names", [("lund_mass", "lund_stiffness"), ("bcsstm02", "bcsstk02")])
def test_the_frequencies_of_a_structure_are_those_of_its_eigenproblem(data_folder, names):
    M, K = (matrix(data_folder, name) for name in names)
    squares = eigh(K, M, eigvals_only=True)
    found = from_second_order(M, K, np.eye(len(M))[0]).d ** 2
    # the eigenproblem is as good as its size allows
    allowed = len(M) * EPS * squares.max() + EPS * np.linalg.cond(M) * squares
    assert np.all(np.abs(found - squares) < allowed)


def test_a_structure_with_massless_degrees_of_freedom_is_refused_with_the_reason_or_condensed(data_folder):
    M, K = matrix(data_folder, "bcsstm01"), matrix(data_folder, "bcsstk01")
    b = np.eye(48)[0]
    with pytest.raises(StructureError, match=r"24 of 48 degrees of freedom have no mass \(4, 5, 6, 10, .* \.\. 48"):
        from_second_order(M, K, b)
    sys = from_second_order(M, K, b, condense=True)
    hertz = sys.d / (2 * np.pi)
    assert (sys.n, len(sys.d)) == (24, 24)
    assert (round(hertz[0], 2), round(hertz[-1], 1)) == (0.83, 37.7)
    # the pencil itself, by its inverse: M v = mu K v has the massless motions at mu = 0
    mu = eigh(M, K, eigvals_only=True)[24:][::-1]
    assert np.all(np.abs(1 / sys.d**2 - mu) < EPS * np.linalg.cond(K) * mu)


# --- published references ---


def test_the_benchmark_chain_without_damping_has_the_analytic_frequencies(published):
    case = published["SingleMSD_Gugercin"]
    n, m, k = case["n_cells"], case["m"], case["k"]
    sys = spring_chain(np.full(n, m), k, ground=k * np.eye(n)[-1])
    expected = 2 * np.sqrt(k / m) * np.sin((2 * np.arange(1, n + 1) - 1) * np.pi / (2 * (2 * n + 1)))
    np.testing.assert_allclose(sys.d, expected, rtol=0, atol=16 * n * EPS * 4 / expected[0])


def test_the_benchmark_chain_with_its_dampers_added_has_the_published_response(published):
    case = published["SingleMSD_Gugercin"]
    n, m, k, c = case["n_cells"], case["m"], case["k"], case["c"]
    sys = spring_chain(np.full(n, m), k, ground=k * np.eye(n)[-1], port=[0, 1])
    by_dampers = msd_chain()
    damped = ct.ss(sys.A - np.diag(np.repeat([0.0, c], n)) @ sys.Q, sys.B, sys.C, sys.D)
    for reference in case["H_ref"]:
        s = complex(*reference["s"])
        expected = np.array(reference["H_re"]) + 1j * np.array(reference["H_im"])
        np.testing.assert_allclose(dense_response(damped, s), expected, rtol=0, atol=case["tol"])
        # all digits that are printed there
        shown = [[complex(float(f"{x.real:.6g}"), float(f"{x.imag:.6g}")) for x in row] for row in by_dampers(s)]
        np.testing.assert_array_equal(shown, expected)
    assert by_dampers.nstates == 2 * n and not by_dampers.is_lossless


def test_the_benchmark_chain_has_its_published_H2_norm():
    sys = msd_chain()
    assert abs(ct.system_norm(ct.ss(sys), 2) - 0.36462) < 5e-6


@quick
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_a_ladder_has_the_impedance_of_its_elements(n, seed):
    """From the far end: in series with R and L, and across C, cell by cell."""
    rng = np.random.default_rng(seed)
    R, C, L, load = rng.uniform(0, 2, n), rng.uniform(0.1, 2, n), rng.uniform(0.1, 2, n), rng.uniform(0, 1)
    one, two = rcl_ladder(n, R=R, C=C, L=L, load=load), rcl_ladder(n, R=R, C=C, L=L, load=load, ports=2)
    for s in (0.7j, 0.3 + 1j, 2.0):
        impedance = load
        for k in range(n)[::-1]:
            impedance = 1 / (s * C[k] + 1 / (s * L[k] + R[k] + impedance))
        assert abs(one(s) / impedance - 1) < 1e-11
        assert abs(two(s)[0, 0] / impedance - 1) < 1e-11
        back = 0.0  # admittance that is seen from the end, inductors first
        for k in range(n):
            back = 1 / (s * L[k] + R[k] + load * (k == n - 1) + 1 / (s * C[k] + back))
        assert abs(two(s)[1, 1] / back - 1) < 1e-11
    assert one.is_lossless == (not R.any() and load == 0)


def test_the_benchmark_ladders_are_those_of_the_collection(published):
    cases = published
    for name, sys in (
        ("RCLLadder_PS10", rcl_ladder()), ("RCLLadder_GPBS12", rcl_ladder(R=3, C=0.1, L=0.1, load=1, ports=2)),
    ):  # fmt: skip
        case = cases[name]
        n = case["n_cells"]
        # in the order of the collection, charge and flux cell by cell
        J = np.diag(np.ones(2 * n - 1), -1) - np.diag(np.ones(2 * n - 1), 1)
        first, last = (float(part.partition("*")[0].strip("[]")) for part in case["R"].split("+"))
        R = np.diag(np.tile([0.0, first], n))
        R[-1, -1] += last
        A = (J - R) @ np.diag(np.tile([1 / case["C"], 1 / case["L"]], n))
        order = np.arange(2 * n).reshape(2, n).T.ravel()
        np.testing.assert_array_equal(sys.A[np.ix_(order, order)], A)
        assert sys.ninputs == case["io_dim"]


@quick
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_a_chain_with_dampers_has_the_response_of_its_equations_of_motion(n, seed):
    rng = np.random.default_rng(seed)
    m, k, g = rng.uniform(0.5, 2, n), rng.uniform(0, 2, n - 1), rng.uniform(0, 2, n)
    c, drag = rng.uniform(0, 1, n - 1), rng.uniform(0, 1, n)
    sys = spring_chain(m, k, ground=g, c=c, ground_c=drag, port=n - 1)
    D = np.diff(np.eye(n), axis=0)
    for s in (0.4j, 1.3j, 0.5 + 1j):
        dynamic = s**2 * np.diag(m) + s * (np.diag(drag) + D.T @ (c[:, None] * D)) + np.diag(g) + D.T @ (k[:, None] * D)
        assert abs(sys(s) / (s * np.linalg.inv(dynamic)[-1, -1]) - 1) < 1e-10
    assert sys.state_labels[0] == "q_1" and sys.input_labels == ["F"]


def test_resistors_damp_the_branches_they_are_in():
    C, L, R = np.array([1.0, 0.3, 0.05]), np.array([2.0, 0.7, 0.4]), np.array([0.1, 0.0, 2.0])
    sys = lc_circuit(C, L, R=R)
    for s in (0.3j, 1j, 0.2 + 5j):
        assert abs(sys(s) / np.sum(1 / (s * L + R + 1 / (s * C))) - 1) < 1e-13
    np.testing.assert_allclose(np.sort(sys.damping_ratios), np.sort(R * np.sqrt(C / L) / 2), atol=1e-15)
    assert type(lc_circuit(C, L, R=0.0)) is type(spring_chain([1.0, 2.0], c=0)) is PortHamiltonian
    np.testing.assert_array_equal(lc_circuit(C, L, R=0.2).R, np.diag([0, 0, 0, 0.2, 0.2, 0.2]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: lc_circuit(1.0, 1.0, R=-1.0), r"R\[0\] = -1; a resistance is not negative"),
        (lambda: lc_circuit([1.0, 1.0], 1.0, R=[1.0, 2.0, 3.0]), "the 2 branches"),
        (lambda: spring_chain([1.0, 1.0], c=[1.0, 1.0]), "the 1 dampers"),
        (lambda: spring_chain([1.0, 1.0], ground_c=[0.0, -2.0]), r"ground_c\[1\] = -2; a viscosity"),
        (lambda: msd_chain(0), "n is 0; it must be a whole number from 1"),
        (lambda: msd_chain(3, m=[1.0, 2.0]), "m has shape .* the 3 masses"),
        (lambda: msd_chain(3, ports=4), "ports is 4; it must be a whole number from 1 to 3"),
        (lambda: rcl_ladder(2, C=[1.0, 1.0, 1.0]), "C has shape .* the 2 cells"),
        (lambda: rcl_ladder(2, load=-1.0), "load"),
        (lambda: rcl_ladder(2, ports=3), "ports is 3; it must be a whole number from 1 to 2"),
    ],
)
def test_bad_losses_are_refused_by_name(make, message):
    with pytest.raises(StructureError, match=message):
        make()


def test_the_benchmark_ladder_without_resistors_is_a_chain_with_capacitors_for_masses(published):
    case = published["RCLLadder_PS10"]
    cells, C, L = case["n_cells"], case["C"], case["L"]
    J = np.diag(np.ones(2 * cells - 1), -1) - np.diag(np.ones(2 * cells - 1), 1)
    Q = np.diag(np.tile([1 / C, 1 / L], cells))
    port = np.eye(2 * cells)[:, :1]
    ladder = ct.ss(J @ Q, port, port.T @ Q, 0)
    chain = spring_chain(np.full(cells, C), 1 / L, ground=np.eye(cells)[-1] / L)
    for s in (0.1 + 0.3j, 0.01 + 1j, 2.5j):
        assert abs(chain(s) / dense_response(ladder, s)[0, 0] - 1) < 1e4 * EPS * cells


@pytest.mark.parametrize("make", [lambda: lc_circuit([5e-324], 1.0), lambda: spring_chain([1.0, 5e-324])])
def test_values_whose_reciprocals_leave_the_range_of_doubles_are_refused(make):
    with pytest.raises(StructureError, match="leave the range of doubles"):
        make()


@pytest.mark.parametrize(
    "port", [np.array(0), b"\x00", np.array([None]), 10**5000, "0"], ids=["0-d", "bytes", "none", "huge", "text"]
)
def test_a_port_that_is_no_number_of_a_mass_is_refused(port):
    with pytest.raises(StructureError, match="masses are counted from 0 to 1"):
        spring_chain([1.0, 1.0], port=port)


@pytest.mark.parametrize("n", [2**63, 10**5000], ids=["2**63", "huge"])
def test_a_chain_that_no_memory_holds_is_refused(n):
    with pytest.raises(StructureError, match=r"n is .*; it must be a whole number from 1 to 1000000"):
        frenkel_kontorova(n)


# --- rounded stiffness and singular mass ---


def free_truss(rng, n=12):
    """Point masses in space, each pair tied by a spring: six rigid-body modes."""
    X, K = rng.normal(size=(n, 3)), np.zeros((3 * n, 3 * n))
    for i in range(n):
        for j in range(i):
            u = (X[i] - X[j]) / np.linalg.norm(X[i] - X[j])
            along = np.zeros(3 * n)
            along[3 * i : 3 * i + 3], along[3 * j : 3 * j + 3] = u, -u
            K += 10 ** rng.uniform(0, 4) * np.outer(along, along)
    return np.diag(np.repeat(rng.uniform(1, 3, n), 3)), K


@pytest.mark.variants
@pytest.mark.parametrize("rounding", [0.0, 1e-15, 1e-14, 1e-13, 1e-12])
def test_rigid_modes_of_a_stiffness_that_was_rounded_are_rigid_and_counted(rounding):
    for seed in range(12):
        rng = np.random.default_rng(seed)
        M, K = free_truss(rng)
        true = np.sqrt(eigh(K, M, eigvals_only=True)[6:])
        noise = np.triu(rng.uniform(-1, 1, K.shape)) * rounding * np.linalg.norm(K, 2)
        sys = from_second_order(M, K + noise + np.triu(noise, 1).T, np.eye(len(M))[0])
        assert (sys.rigid_modes, len(sys.d)) == (6, len(M) - 6)
        assert np.max(np.abs(sys.d / true - 1)) < 1e-11 + 1e4 * rounding


def test_a_stiffness_of_an_exporter_keeps_its_six_rigid_modes(data_folder):
    with np.load(data_folder / "structures" / "nas2cam_k0.npz") as file:
        M, K, squares = file["M"], file["K"], file["lam_ref"]
    for digits in (13, 11, 9):
        written = np.array([[float(f"{x:.{digits - 1}e}") for x in row] for row in K])
        sys = from_second_order(M, written, np.eye(len(M))[0])
        assert (sys.rigid_modes, len(sys.d)) == (6, 48)
        assert np.max(np.abs(sys.d**2 / squares[6:] - 1)) < 1e-4
    sys = from_second_order(M, K.astype(np.float32).astype(float), np.eye(len(M))[0], rtol=1e-8)
    assert sys.rigid_modes == 6


def test_a_soft_suspension_is_kept_and_what_is_rigid_can_be_said():
    K = np.array([[1.0, -1.0], [-1.0, 1.0]])
    for soft in (1e-8, 1e-12):
        held = K + np.diag([soft, soft])
        sys = from_second_order(np.eye(2), held, [1.0, 0.0], rtol=0)
        assert sys.rigid_modes == 0 and abs(sys.d[0] / np.sqrt(soft) - 1) < 1e-3
        assert from_second_order(np.eye(2), held, [1.0, 0.0], rtol=1e-6).rigid_modes == 1
    assert from_second_order(np.eye(2), K + np.diag([1e-8, 1e-8]), [1.0, 0.0]).rigid_modes == 0
    # a light mass beside it makes no spring of any size indefinite by rounding
    with pytest.raises(StructureError, match="K is indefinite"):
        from_second_order(np.diag([1e-12, 1.0]), np.diag([1.0, -1.0]), [1.0, 0.0])


@pytest.mark.parametrize("rtol", [None, 0, 1e-9])
def test_a_stiffness_that_is_negative_altogether_is_no_rounding(rtol):
    for K in (-np.diag([1.0, 2.0, 3.0]), np.array([[-1.0, 2.0], [2.0, -1.0]])):
        with pytest.raises(StructureError, match="K is indefinite"):
            from_second_order(np.eye(len(K)), K, np.ones(len(K)), rtol=rtol)


def test_motions_without_mass_are_condensed_in_any_coordinates():
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 9))
        massless = int(rng.integers(1, n))
        F, G = rng.normal(size=(n, n - massless)), rng.normal(size=(n, n + 1))
        M, K = F @ F.T, G @ G.T
        b = F @ rng.normal(size=(n - massless, 2))
        with pytest.raises(StructureError, match="condense=True"):
            from_second_order(M, K, b)
        sys = from_second_order(M, K, b, condense=True)
        assert sys.n == n - massless
        for s in (0.3 + 0.4j, 1 + 3j):
            truth = dynamic_stiffness(M, K, b, s)
            assert np.abs(sys.horner(s)[:, :, 0] - truth).max() < 1e-8 * np.abs(truth).max()


def test_what_is_refused_is_refused_before_any_factorisation(monkeypatch):
    def never(*_):
        raise AssertionError("a factorisation")

    monkeypatch.setattr("ph_control.numerics.definiteness.definite_factor", never)
    monkeypatch.setattr("ph_control.numerics.definiteness.smallest_scaled_eigenvalue", never)
    one, massless = np.eye(3), np.diag([1.0, 0.0, 1.0])
    for M, K, message in (
        (one, 1j * one, "K is complex"),
        (1j * one, one, "M is complex"),
        (massless, one, "singular"),
    ):
        with pytest.raises(StructureError, match=message):
            from_second_order(M, K, [1.0, 0.0, 0.0])


@pytest.mark.parametrize("power", [1, 2, 3])
def test_natural_frequencies_alone_are_as_exact_as_those_of_the_modes(power):
    n = 24
    K = np.linalg.matrix_power(2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1), power)
    masses = 1 + 0.1 * np.random.default_rng(power).random(n)
    sys = from_second_order(np.diag(masses), K, np.eye(n)[3])
    with mp.workdps(40):
        pencil = mp.matrix(n, n)
        for i, j in np.ndindex(n, n):
            pencil[i, j] = mp.mpf(K[i, j]) / mp.sqrt(mp.mpf(masses[i]) * mp.mpf(masses[j]))
        exact = np.array([float(mp.sqrt(square)) for square in mp.eigsy(pencil, eigvals_only=True)])
    alone = sys.natural_frequencies
    # rounding of K moves the squares by eps of the largest
    allowed = 4 * n * EPS * exact[-1] ** 2 / exact
    assert (np.abs(alone - exact) < allowed).all() and (np.diff(alone) > 0).all()
    assert (np.abs(sys.modes.natural_frequencies - alone) < allowed).all()
    np.testing.assert_array_equal(sys.natural_frequencies, sys.modes.natural_frequencies)

"""Known systems against independent matrices, closed formulas and a published benchmark."""

import json
from pathlib import Path

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ph_control import PortHamiltonian, StructureError
from ph_control.models import frenkel_kontorova, lc_circuit, spring_chain

EPS = np.finfo(float).eps
BENCHMARK = Path(__file__).resolve().parents[2] / "shared" / "data" / "models" / "phbench_params_and_refs.json"
quick = settings(deadline=None, max_examples=25, derandomize=True)
positive = st.floats(0.1, 10.0)


def benchmark():
    if not BENCHMARK.exists():
        pytest.skip("the benchmark references are not on this machine")
    return json.loads(BENCHMARK.read_text())


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
    with pytest.raises(StructureError, match=r"n is .*number of masses is a whole number, at least 1"):
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
        ({"masses": [1.0, 1.0], "port": []}, "port is empty"),
    ],
)
def test_a_bad_chain_is_refused_by_name(arguments, message):
    with pytest.raises(StructureError, match=message):
        spring_chain(**arguments)


# --- published references ---


def test_the_benchmark_chain_without_damping_has_the_analytic_frequencies():
    case = benchmark()["SingleMSD_Gugercin"]
    n, m, k = case["n_cells"], case["m"], case["k"]
    sys = spring_chain(np.full(n, m), k, ground=k * np.eye(n)[-1])
    expected = 2 * np.sqrt(k / m) * np.sin((2 * np.arange(1, n + 1) - 1) * np.pi / (2 * (2 * n + 1)))
    np.testing.assert_allclose(sys.d, expected, rtol=0, atol=16 * n * EPS * 4 / expected[0])


def test_the_benchmark_chain_with_its_dampers_added_has_the_published_response():
    case = benchmark()["SingleMSD_Gugercin"]
    n, m, k, c = case["n_cells"], case["m"], case["k"], case["c"]
    sys = spring_chain(np.full(n, m), k, ground=k * np.eye(n)[-1], port=[0, 1])
    damped = ct.ss(sys.A - np.diag(np.repeat([0.0, c], n)) @ sys.Q, sys.B, sys.C, sys.D)
    for reference in case["H_ref"]:
        s = complex(*reference["s"])
        expected = np.array(reference["H_re"]) + 1j * np.array(reference["H_im"])
        np.testing.assert_allclose(dense_response(damped, s), expected, rtol=0, atol=case["tol"])


def test_the_benchmark_ladder_without_resistors_is_a_chain_with_capacitors_for_masses():
    case = benchmark()["RCLLadder_PS10"]
    cells, C, L = case["n_cells"], case["C"], case["L"]
    J = np.diag(np.ones(2 * cells - 1), -1) - np.diag(np.ones(2 * cells - 1), 1)
    Q = np.diag(np.tile([1 / C, 1 / L], cells))
    port = np.eye(2 * cells)[:, :1]
    ladder = ct.ss(J @ Q, port, port.T @ Q, 0)
    chain = spring_chain(np.full(cells, C), 1 / L, ground=np.eye(cells)[-1] / L)
    for s in (0.1 + 0.3j, 0.01 + 1j, 2.5j):
        assert abs(chain(s) / dense_response(ladder, s)[0, 0] - 1) < 1e4 * EPS * cells

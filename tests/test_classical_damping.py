"""Circuits of damped modes: damping is classical by construction or by the energy, however close modes are.

References are the formula of the modes, and the equations of motion solved in complex numbers or in mpmath.
"""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc

SETTINGS = settings(deadline=None, max_examples=20, derandomize=True)


def branches(circuit):
    """Inductance, resistance and capacitance of each of the branches of an admittance of one port."""
    values = {element.name: element.value for element in circuit.elements}
    count = sum(name[0] == "L" for name in values)
    return np.array([[values[f"{letter}{k}"] for letter in "LRC"] for k in range(1, count + 1)])


def series(circuit, w):
    L, R, C = branches(circuit).T
    return np.sum(1 / (R + 1j * (w * L - 1 / (w * C))))


def moving(M, C, K, b, w):
    """Velocity at the force of `M q'' + C q' + K q = b u`."""
    return 1j * w * b.T @ np.linalg.solve(K - w * w * M + 1j * w * C, b)


def structure(M, C, K, b):
    zero = np.zeros_like(M)
    Q = np.block([[K, zero], [zero, np.linalg.inv(M)]])
    return phc.ph(0.5 * (Q + Q.T), np.concatenate([0 * b, b]), R=np.block([[zero, zero], [zero, C]]))


def random_structure(rng, d, zeta, ports=1):
    """Full mass, damping and stiffness matrices of modes with their damping ratios, and forces."""
    n = len(d)
    mass = rng.standard_normal((n, n))
    M = mass @ mass.T + n * np.eye(n)
    lower = np.linalg.cholesky(M)
    shapes = lower @ np.linalg.qr(rng.standard_normal((n, n)))[0]
    return M, shapes * (2 * zeta * d) @ shapes.T, shapes * d**2 @ shapes.T, rng.standard_normal((n, ports))


@pytest.mark.parametrize("make", [lambda form: form, phc.ph], ids=["modes", "ph"])
@pytest.mark.parametrize("gap", [1e-3, 1e-5, 3e-6, 1e-7, 2e-9, 1e-12])
def test_modes_at_any_distance_have_branches_of_their_own(gap, make):
    d, r, zeta = np.array([2.0, 2.0 * (1 + gap), 7.0]), np.array([0.5, 1.5, 2.0]), np.array([0.004, 0.004, 0.1])
    found = branches(phc.netlist(make(phc.modes(d, r, damping=zeta))))
    np.testing.assert_allclose(found, np.array([1 / (d * r), 2 * zeta / r, r / d]).T, rtol=1e-14)


def test_modes_of_one_frequency_and_damping_are_one_branch():
    found = branches(phc.netlist(phc.ph(phc.modes([2.0, 2.0, 3.0], [0.5, 1.5, 1.0], damping=[0.01, 0.01, 0.02]))))
    np.testing.assert_allclose(found, [[0.25, 0.01, 1.0], [1 / 3, 0.04, 1 / 3]], rtol=1e-14)
    # of another damping each is its own
    assert len(branches(phc.netlist(phc.ph(phc.modes([2.0, 2.0], [0.5, 1.5], damping=[0.01, 0.02]))))) == 2


@pytest.mark.parametrize("weight", [1e-4, 1e-8, 1e-13, 1e-20])
def test_a_mode_that_the_port_hardly_sees_has_its_branch(weight):
    d, r = np.array([1.0, 1.5, 4.0]), np.array([2.0, weight, 1.0])
    found = branches(phc.netlist(phc.ph(phc.modes(d, r, damping=0.003))))
    np.testing.assert_allclose(found, np.array([1 / (d * r), 0.006 / r, r / d]).T, rtol=1e-14)


def test_many_lightly_damped_modes():
    rng = np.random.default_rng(5)
    d, r = np.sort(rng.uniform(1.0, 300.0, 180)), 10 ** rng.uniform(-4, 1, 180)
    d[1::9] = d[::9] * (1 + 1e-7)
    order = np.argsort(d)
    found = branches(phc.netlist(phc.ph(phc.modes(d[order], r[order], damping=0.005))))
    np.testing.assert_allclose(found[:, 0], 1 / (d * r)[order], rtol=1e-13)


@SETTINGS
@given(st.integers(0, 10**6))
def test_modes_from_under_to_overdamping_are_converted_one_by_one(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    d, r = 10 ** rng.uniform(-3, 3, n), 10 ** rng.uniform(-3, 2, n)
    zeta = np.where(
        rng.uniform(size=n) < 0.3, 1 + rng.choice([0.0, 1e-12, -1e-9, 1e-4], n), 10 ** rng.uniform(-4, 2, n)
    )
    circuit = phc.netlist(phc.ph(phc.modes(d, r, damping=zeta)))
    for w in (*d, 0.3, 40.0):
        terms = d * r * 1j * w / (d * d - w * w + 2j * zeta * d * w)
        # what rounding of d makes of a resonance
        assert abs(series(circuit, w) - terms.sum()) <= 1e-14 / min(1.0, zeta.min()) * np.abs(terms).sum()


@SETTINGS
@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-9, 1e-7, 1e-5, 1e-2]), st.integers(1, 3))
def test_full_matrices_of_classical_damping(seed, gap, ports):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    d = np.sort(rng.uniform(1.0, 5.0, n))
    d[1] = d[0] * (1 + gap)
    zeta = rng.uniform(0.002, 0.05, n) if seed % 2 else np.full(n, 0.005)
    M, C, K, b = random_structure(rng, d, zeta, ports)
    circuit = phc.netlist(structure(M, C, K, b))
    assert all(element.value > 0 for element in circuit.elements if element.letter in "RLC")
    back = phc.read_netlist(circuit.spice())
    assert back.nstates <= 2 * n
    for w in (0.6, d[0], d[-1]):
        expected = moving(M, C, K, b, w)
        A = 1j * w * np.eye(back.nstates) - back.A
        np.testing.assert_allclose(
            back.C @ np.linalg.solve(A, back.B), expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max()
        )


def test_rayleigh_damping_of_a_chain():
    n, (alpha, beta) = 60, (0.01, 2e-4)
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    M, b = np.diag(np.linspace(1.0, 2.0, n)), np.eye(n)[:, [3]]
    circuit = phc.netlist(structure(M, alpha * M + beta * K, K, b))
    for w in (0.05, 0.7, 1.9):
        expected = moving(M, alpha * M + beta * K, K, b, w)[0, 0]
        assert series(circuit, w) == pytest.approx(expected, rel=1e-10)
    L, R, _ = branches(circuit).T
    d = np.sqrt(1 / (L * branches(circuit)[:, 2]))
    np.testing.assert_allclose(R / L, alpha + beta * d**2, rtol=1e-10)


def test_repeated_frequencies_with_losses_of_their_own():
    # two equal masses on equal springs, coupled by a damper alone: the sum and the difference of their motions
    M, K, b = np.eye(2), 4 * np.eye(2), np.array([[1.0], [0.0]])
    C = np.array([[0.3, -0.2], [-0.2, 0.3]])
    found = branches(phc.netlist(structure(M, C, K, b)))
    np.testing.assert_allclose(found, [[2, 0.2, 0.125], [2, 1.0, 0.125]], rtol=1e-13)


@SETTINGS
@given(st.integers(0, 10**6))
def test_losses_of_modes_of_one_frequency_lie_in_any_directions(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    loss = rng.standard_normal((n, n))
    C, K, b = 0.05 * (loss @ loss.T + 0.1 * np.eye(n)), 4 * np.eye(n), rng.standard_normal((n, 1))
    if seed % 2:
        b[1:] = 0.0
    circuit = phc.netlist(structure(np.eye(n), C, K, b))
    for w in (0.5, 2.0, 2.1):
        assert series(circuit, w) == pytest.approx(moving(np.eye(n), C, K, b, w)[0, 0], rel=1e-11)


def test_netlists_of_branches_are_found_again_whatever_their_distance():
    rng = np.random.default_rng(8)
    L, R = 10 ** rng.uniform(-4, -2, 12), 10 ** rng.uniform(-1, 1, 12)
    C = 1 / (L * (1e4 * (1 + 1e-7 * np.arange(12))) ** 2)
    lines = [f"L{k} 1 a{k} {L[k]}\nR{k} a{k} b{k} {R[k]}\nC{k} b{k} 0 {C[k]}" for k in range(12)]
    found = branches(phc.netlist(phc.read_netlist("\n".join(["t", "V1 1 0", *lines, ".end"]))))
    np.testing.assert_allclose(found, np.array([L, R, C]).T, rtol=1e-13)


def test_what_the_port_does_not_reach_need_not_be_classical():
    M, K = np.eye(3), np.diag([1.0, 4.0, 4.5])
    C = np.array([[0.1, 0, 0], [0, 0.2, 0.1], [0, 0.1, 0.3]])
    found = branches(phc.netlist(structure(M, C, K, np.array([[2.0], [0], [0]]))))
    np.testing.assert_allclose(found, [[0.25, 0.025, 4.0]], rtol=1e-14)


@pytest.mark.parametrize("gap", [1e-1, 1e-4, 1e-6])
@pytest.mark.parametrize("between", [0.3, 1e-5])
@pytest.mark.parametrize("second", [0.4, 0.0])
def test_damping_between_close_modes_is_not_classical(gap, between, second):
    K, C = np.diag([4.0, 4.0 * (1 + gap)]), 0.02 * np.array([[1.0, between], [between, 1.0]])
    with pytest.raises(phc.NotLosslessError, match="not classical"):
        phc.netlist(structure(np.eye(2), C, K, np.array([[1.0], [second]])))


def test_a_large_structure_of_other_damping_is_refused():
    n = 100
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    C = np.diag(np.where(np.arange(n) % 7, 0.001, 0.2))
    with pytest.raises(phc.NotLosslessError, match="not classical"):
        phc.netlist(structure(np.eye(n), C, K, np.eye(n)[:, [0]]))


def test_critical_damping_has_the_digits_of_its_elements():
    d, kappa = 3.0, 0.75
    ((L, R, C),) = branches(phc.netlist(phc.ph(phc.modes([d], [kappa / d], damping=1.0))))
    with mpmath.workdps(40):
        exact = [1 / mpmath.mpf(kappa), 2 * mpmath.mpf(d) / kappa, mpmath.mpf(kappa) / d**2]
    assert [L, R, C] == pytest.approx([float(value) for value in exact], rel=1e-15)

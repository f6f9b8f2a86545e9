"""Connections of port-Hamiltonian systems against the equations of the joint, and what becomes of energy and names."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc

SEEDS = given(seed=st.integers(0, 2**31))
SETTINGS = settings(max_examples=20, deadline=None)


def drawn(rng, ports, *, through=False, sensors=0, lossless=False):
    """Random system of so many ports; with `through`, a feedthrough of full rank."""
    n = 2 * int(rng.integers(1, 4))
    root = rng.normal(size=(n, n))
    Q, B = root @ root.T + 0.3 * np.eye(n), rng.normal(size=(n, ports))
    if lossless:
        return phc.ph(Q, B)
    loss = rng.normal(size=(n + ports, n + ports if through else n))
    if not through:
        loss[n:] = 0.0
    W = loss @ loss.T
    rows = (rng.normal(size=(sensors, n)), rng.normal(size=(sensors, ports))) if sensors else None
    return phc.ph(Q, B, R=W[:n, :n], P=W[:n, n:], S=W[n:, n:], sensors=rows)


def response(systems, s):
    """Transfer function of systems side by side, ports first, then sensors."""
    whole, m = None, sum(one.ninputs for one in systems)
    rows = sum(one.noutputs for one in systems)
    whole, at, port, sensor = np.zeros((rows, m), complex), 0, 0, m
    for one in systems:
        plain = ct.ss(np.array(one.A), np.array(one.B), np.array(one.C), np.array(one.D))
        value = plain(s, squeeze=False)
        columns = slice(at, at + one.ninputs)
        whole[port : port + one.ninputs, columns] = value[: one.ninputs]
        whole[sensor : sensor + one.noutputs - one.ninputs, columns] = value[one.ninputs :]
        at, port, sensor = at + one.ninputs, port + one.ninputs, sensor + one.noutputs - one.ninputs
    return whole


def joined(G, joints, drop):
    """Transfer function with `c^T y = 0` for each joint, held by inputs along `c`."""
    c = np.array(joints).T
    kept = np.delete(np.arange(G.shape[1]), drop)
    rows = np.delete(np.arange(G.shape[0]), drop)
    m = G.shape[1]
    force = np.linalg.solve(c.T @ G[:m] @ c, c.T @ G[:m])
    return (G - G @ c @ force)[np.ix_(rows, kept)]


def is_port_hamiltonian(system):
    if type(system) is phc.PortHamiltonian:
        return np.linalg.eigvalsh(system.Q)[0] > -1e-12 * np.linalg.norm(system.Q)
    W = np.block([[system.R, system.P], [system.P.T, system.S]])
    least = min(np.linalg.eigvalsh(M)[0] / max(np.linalg.norm(M), 1e-300) for M in (W, system.Q))
    return least > -1e-12 and np.array_equal(system.J, -system.J.T) and np.array_equal(system.N, -system.N.T)


KINDS = st.sampled_from([{}, {"lossless": True}, {"through": True}, {"sensors": 2}])
POINTS = (0.7j, 0.4 + 1.1j, 3.0)


@SETTINGS
@given(seed=st.integers(0, 2**31), kinds=st.tuples(KINDS, KINDS), pairs=st.integers(1, 2))
def test_joined_ports_have_outputs_of_the_given_ratio_and_one_force(seed, kinds, pairs):
    rng = np.random.default_rng(seed)
    systems = [drawn(rng, 2, **kind) for kind in kinds]
    ports = [(1, 0), (0, 1)][:pairs]
    ratio = rng.uniform(0.5, 2.0, pairs) * rng.choice([-1.0, 1.0], pairs)
    # of a system of two states all outputs are fixed by two joints, and so is one of the two with one
    if min(one.nstates for one in systems) < 4:
        pairs, ports, ratio = 1, ports[:1], ratio[:1]
    got = phc.transformer(*systems, ratio, ports=ports)
    joints = [n * np.eye(4)[i] - np.eye(4)[2 + j] for (i, j), n in zip(ports, ratio, strict=True)]
    for s in POINTS:
        truth = joined(response(systems, s), joints, [2 + j for _, j in ports])
        assert np.abs(got(s, squeeze=False) - truth).max() <= 1e-9 * max(1.0, np.abs(truth).max())
    assert is_port_hamiltonian(got)
    assert (type(got) is phc.PortHamiltonian) == all(type(one) is phc.PortHamiltonian for one in systems)


@SETTINGS
@SEEDS
def test_substructures_joined_at_their_masses_are_the_assembled_structure(seed):
    rng = np.random.default_rng(seed)
    masses = [rng.uniform(0.5, 2.0, size=rng.integers(1, 5)) * 10 ** rng.uniform(-4, 4) for _ in range(2)]
    springs = [rng.uniform(0.5, 2.0, len(m)) for m in masses]
    left, right = (
        phc.spring_chain(m, k[1:], ground=k[0] * np.eye(1, len(m))[0], port=[len(m) - 1] if last else [0])
        for m, k, last in zip(masses, springs, (True, False), strict=True)
    )
    got = phc.couple(left, right)
    n1, n = len(masses[0]), len(masses[0]) + len(masses[1]) - 1
    T = np.zeros((n1 + len(masses[1]), n))
    T[:n1, :n1], T[n1:, n1 - 1 :] = np.eye(n1), np.eye(len(masses[1]))
    K = np.block([
        [left.Q[:n1, :n1], np.zeros((n1, len(masses[1])))],
        [np.zeros((len(masses[1]), n1)), right.Q[: len(masses[1]), : len(masses[1])]],
    ])  # fmt: skip
    M = np.diag(np.concatenate(masses))
    whole = phc.from_second_order(T.T @ M @ T, T.T @ K @ T, np.eye(n)[n1 - 1])
    assert type(got) is phc.PortHamiltonian and got.nstates == 2 * n
    np.testing.assert_allclose(got.d, whole.d, rtol=1e-10)
    np.testing.assert_allclose(got.r, whole.r, rtol=1e-8)
    # displacements stay what they were, and the momentum of the joint is the sum
    np.testing.assert_allclose(np.sort(np.diag(got.Q)), np.sort(np.diag(whole.Q)), rtol=1e-12)


def test_a_joint_in_a_structure_with_dampers_keeps_its_energy_and_loss():
    left = phc.ph(np.diag([3.0, 0.5]), [0.0, 1.0], R=np.diag([0.0, 0.2]), inputs="F", outputs="v", states=["q", "p"])
    right = phc.ph(np.diag([5.0, 2.0]), [0.0, 1.0], R=np.diag([0.0, 0.3]), inputs="F", outputs="v", states=["q", "p"])
    both = phc.couple(left, right, name="both")
    assert (both.input_labels, both.output_labels, both.name) == (["F"], ["v"], "both")
    np.testing.assert_allclose(both.Q, np.diag([8.0, 0.4]), rtol=1e-14)
    np.testing.assert_allclose(both.R, np.diag([0.0, 0.5]), rtol=1e-14)
    assert both.state_labels == ["q", "p"]


def test_an_accelerometer_at_the_joint_sees_the_force_in_it():
    """Of each part alone the force of the other is an input to it."""
    loss = np.diag([0.0, 0.1])
    one, two = (
        phc.ph(np.diag([1.0, 1 / m]), [0.0, 1.0], R=loss, sensors=([[-1 / m, -0.1 / m**2]], [[1 / m]]))
        for m in (2.0, 3.0)
    )
    both = phc.couple(one, two)
    assert both.noutputs == 3
    s = 0.3 + 2.0j
    v = both(s)[0, 0]
    np.testing.assert_allclose(both(s).ravel(), [v, s * v, s * v], rtol=1e-12)
    np.testing.assert_allclose(v, s / (5.0 * s**2 + 0.2 * s + 2.0), rtol=1e-12)


def test_ports_that_cannot_be_joined_are_refused():
    chain = phc.spring_chain([1.0, 2.0], ground=1.0, port=[0, 1])
    point = phc.spring_chain([1.0], ground=1.0)
    with pytest.raises(phc.StructureError, match="no such port of the second"):
        phc.couple(chain, point, ports=(0, 1))
    with pytest.raises(phc.StructureError, match="twice"):
        phc.couple(chain, chain, ports=[(0, 0), (0, 1)])
    with pytest.raises(phc.StructureError, match="ratio"):
        phc.transformer(chain, point, 0.0)
    with pytest.raises(phc.StructureError, match="StateSpace"):
        phc.couple(chain, ct.ss(-1, 1, 1, 0))
    for ports in ("F", 3, [], [(0,)], [(True, 0)], (0, 0.5)):
        with pytest.raises(phc.StructureError):
            phc.couple(chain, point, ports=ports)
    two_at_one = phc.ph(np.diag([1.0, 1.0]), [[0.0, 0.0], [1.0, 1.0]])
    with pytest.raises(phc.StructureError, match="move together"):
        phc.couple(two_at_one, two_at_one, ports=[(0, 0), (1, 1)])
    crossed = phc.ph(np.eye(2), [[0.0, 0.0], [1.0, 2.0]], N=[[0.0, 1.0], [-1.0, 0.0]])
    with pytest.raises(phc.StructureError, match="contains an input"):
        phc.couple(crossed, point)


def test_resistors_and_dampers_without_states_join_like_ports():
    """Dashpots in series: equal forces, so velocities add; the joint leaves one of half the viscosity."""
    damper = phc.ph(np.zeros((0, 0)), np.zeros((0, 2)), S=np.array([[2.0, 2.0], [2.0, 2.0]]))
    both = phc.couple(damper, damper, ports=(1, 0))
    np.testing.assert_allclose(both.S, joined(response([damper, damper], 1.0), [[0, 1, -1, 0]], [2]).real)


@SETTINGS
@SEEDS
def test_a_gyrator_is_feedback_through_the_square_of_its_ratio(seed):
    rng = np.random.default_rng(seed)
    one, two = drawn(rng, 1, lossless=bool(seed % 2)), drawn(rng, 1)
    r = rng.uniform(0.2, 3.0)
    got = phc.gyrator(one, two, r)
    for s in POINTS:
        G1, G2 = (response([sys], s)[0, 0] for sys in (one, two))
        truth = np.array([[G1, -r * G1 * G2], [r * G1 * G2, G2]]) / (1 + r**2 * G1 * G2)
        np.testing.assert_allclose(got(s), truth, rtol=1e-8)
    assert is_port_hamiltonian(got)


@pytest.mark.parametrize(
    "join", [phc.couple, phc.gyrator, phc.transformer, lambda a, b: phc.interconnect([a, b], [[0, -1], [1, 0]])]
)
def test_energies_add_and_the_energy_never_rises_without_input(join):
    plant = phc.spring_chain([1.0, 2.0, 0.5], 4.0, ground=1.0)
    absorber = phc.ph(np.diag([1.0, 3.0]), [0.0, 1.0], R=np.diag([0.0, 0.4]))
    loop = join(plant, absorber)
    t = np.linspace(0.0, 20.0, 201)
    driven = phc.forced_response(loop, t, np.vstack([np.sin(t)] * loop.ninputs))
    balance = phc.energy_balance(driven, loop)
    flow = max(np.abs(part).max() for part in (balance.stored, balance.supplied, balance.dissipated))
    assert np.abs(balance.defect).max() <= 1e-11 * flow and balance.dissipated[-1] > 0
    free = phc.forced_response(loop, t, 0.0, driven.states[:, -1])
    energy = loop.hamiltonian(free.states)
    assert np.all(np.diff(energy) <= 1e-12 * energy[0]) and energy[-1] < 0.9 * energy[0]


def named(name, **signals):
    return phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.1]), name=name, **signals)


def test_names_of_ports_survive_and_those_that_meet_tell_their_system():
    force = {"inputs": "F", "outputs": "v", "states": ["q", "p"]}
    plant, other = named("plant", **force), named("absorber", **force)
    own = named("shaker", inputs="i", outputs="e", states=["x", "y"])
    both = phc.interconnect([plant, other], np.zeros((2, 2)))
    assert both.input_labels == ["plant_F", "absorber_F"] and both.output_labels == ["plant_v", "absorber_v"]
    assert both.state_labels == ["plant_q", "plant_p", "absorber_q", "absorber_p"]
    assert phc.gyrator(plant, own).input_labels == ["F", "i"]
    assert phc.gyrator(plant, plant).input_labels == ["sys1_F", "sys2_F"]
    assert phc.gyrator(plant, named("bare")).output_labels == ["v", "y[1]"]
    assert phc.couple(plant, other).input_labels == ["F"] == ct.feedback(plant, other).input_labels
    assert (plant + other).input_labels == ["F"] and (plant + own).input_labels == ["u[0]"]
    assert ct.append(plant, own).input_labels == ["F", "i"] and ct.append(plant, 1.0).input_labels == ["F", "u[1]"]
    assert phc.gyrator(plant, own, inputs=["a", "b"], name="pair").input_labels == ["a", "b"]
    with pytest.raises((TypeError, phc.StructureError)):
        phc.couple(plant, other, nonsense=1)


def test_units_of_time_go_along_and_two_of_them_are_refused():
    one, two = named("one"), named("two")
    one.time_unit = "ms"
    assert phc.couple(one, two).time_unit == phc.gyrator(two, one).time_unit == "ms" == (one + two).time_unit
    two.time_unit = "s"
    with pytest.raises(phc.StructureError, match="ms here and in s there"):
        phc.couple(one, two)

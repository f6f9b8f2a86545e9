"""Port-Hamiltonian systems with losses against dense matrices, python-control and 50 digits."""

from __future__ import annotations

import copy
import pickle

import control as ct
import matplotlib.pyplot as plt
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import ph_control as phc

EPS = np.finfo(float).eps


def drawn(seed, sensors=True):
    """Random system, any ports, feedthrough of any rank, sensors; and the same as plain matrices."""
    rng = np.random.default_rng(seed)
    n, m, k = 2 * int(rng.integers(1, 6)), int(rng.integers(1, 4)), int(rng.integers(0, 3)) if sensors else 0
    root = rng.normal(size=(n, n))
    Q = root @ root.T + 0.1 * np.eye(n)
    loss = rng.normal(size=(n + m, int(rng.integers(1, n + m + 1)))) * 10 ** rng.uniform(-2, 0)
    loss[n:] *= rng.integers(0, 2)
    W = loss @ loss.T
    skew = rng.normal(size=(m, m))
    B = rng.normal(size=(n, m))
    parts = {"R": W[:n, :n], "P": W[:n, n:], "S": W[n:, n:], "N": skew - skew.T}
    rows, through = rng.normal(size=(k, n)), rng.normal(size=(k, m))
    system = phc.ph(Q, B, **parts, sensors=(rows, through) if k else None)
    J = np.kron([[0, 1], [-1, 0]], np.eye(n // 2))
    A = (J - parts["R"]) @ Q
    C = np.vstack([(B + parts["P"]).T @ Q, rows])
    return system, ct.ss(A, B - parts["P"], C, np.vstack([parts["S"] + parts["N"], through])), rng


SEEDS = given(seed=st.integers(0, 2**31))


@settings(max_examples=15, deadline=None)
@SEEDS
def test_matrices_responses_and_simulations_are_those_of_the_equations(seed):
    system, dense, rng = drawn(seed)
    for name in "ABCD":
        np.testing.assert_allclose(getattr(system, name), getattr(dense, name), rtol=1e-12, atol=1e-13)
    omega = np.abs(np.concatenate([dense.poles().imag, rng.uniform(0, 10, 5)]))
    wanted = dense(1j * omega, squeeze=False)
    resolvent = np.array([np.linalg.norm(np.linalg.inv(1j * w * np.eye(dense.nstates) - dense.A), 2) for w in omega])
    # rounding of A moves a response by the square of the resolvent
    size = resolvent * np.linalg.norm(dense.B) * np.linalg.norm(dense.C) * (1 + resolvent * np.linalg.norm(dense.A))
    error = np.abs(system(1j * omega, squeeze=False) - wanted).max(axis=(0, 1))
    assert np.all(error <= 1e-13 * (size + np.linalg.norm(dense.D)))
    t = np.linspace(0.0, 3.0, 61)
    u, x0 = rng.normal(size=(system.ninputs, 61)), rng.normal(size=system.nstates)
    got, peer = phc.forced_response(system, t, u, x0), ct.forced_response(dense, t, u, x0)
    for a, b in ((got.outputs, peer.outputs), (got.states, peer.states)):
        assert np.abs(a - b).max() <= 1e-10 * np.abs(b).max()
    h = 1.0 / np.abs(dense.poles()).max()
    sampled = phc.sample(system, h)
    np.testing.assert_allclose(sampled.A, expm(h * dense.A), atol=1e-10 * np.abs(sampled.A).max())


@pytest.mark.variants
@pytest.mark.parametrize("rule", [("exact", "foh"), ("exact", "zoh"), ("midpoint", "foh"), ("midpoint", "zoh")])
@settings(max_examples=15, deadline=None)
@SEEDS
def test_what_is_supplied_is_stored_or_dissipated(rule, seed):
    system, _, rng = drawn(seed)
    t = np.linspace(0.0, 5.0, 101)
    u, x0 = rng.normal(size=(system.ninputs, 101)), rng.normal(size=system.nstates)
    response = phc.forced_response(system, t, u, x0, method=rule[0], intersample=rule[1])
    balance = phc.energy_balance(response, system)
    flow = max(np.abs(e).max() for e in (balance.stored, balance.supplied, balance.dissipated))
    assert np.abs(balance.defect).max() <= 1e-10 * flow
    assert np.all(np.diff(balance.dissipated) >= -1e-12 * flow) and balance.dissipated[-1] > 0


def test_the_energy_lost_by_a_dashpot_is_that_of_the_integral():
    """Free decay of a mass on a spring: in the end all that was stored is lost."""
    system = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.8]))
    response = phc.initial_response(system, np.linspace(0.0, 60.0, 601), [1.0, 0.0], return_states=True)
    forced = phc.forced_response(system, np.linspace(0.0, 60.0, 601), 0.0, [1.0, 0.0])
    balance = phc.energy_balance(forced, system)
    np.testing.assert_allclose(balance.dissipated[-1], 2.0, rtol=1e-12)
    np.testing.assert_allclose(response.outputs, forced.outputs, atol=1e-13)
    plot = balance.plot()
    assert [text.get_text() for text in plot.axes[0, 0].get_legend().get_texts()] == [
        "stored", "supplied since the start", "dissipated since the start"
    ]  # fmt: skip
    plt.close(plot.figure)


def in_50_digits(Q, B, R, t, x0):
    """State of `x' = (J - R) Q x` at one instant, from numbers as they are."""
    n = len(Q)
    with mp.workdps(50):
        J = mp.matrix(np.kron([[0, 1], [-1, 0]], np.eye(n // 2)).tolist())
        A = (J - mp.matrix(R.tolist())) * mp.matrix(Q.tolist())
        return np.array([float(x) for x in mp.expm(A * t) * mp.matrix(x0.tolist())])


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("distance", [0.0, 1e-12, 1e-8, 1e-4, 1e-1])
def test_critical_damping_keeps_its_digits(n, distance):
    """All modes at and beside the point where two poles of each meet, which is one for all of them."""
    Q, zeta = np.eye(2 * n), 1.0 + distance * np.arange(1, n + 1)
    R = np.diag(np.concatenate([np.zeros(n), 2.0 * zeta]))
    B = np.concatenate([np.zeros(n), np.arange(1.0, n + 1)])
    system = phc.ph(Q, B, R=R)
    x0 = np.arange(1.0, 2 * n + 1)
    t = np.linspace(0.0, 6.0, 13)
    got = phc.forced_response(system, t, 0.0, x0).states
    for k in (1, 5, 12):
        assert np.abs(got[:, k] - in_50_digits(Q, B, R, t[k], x0)).max() <= 1e-12 * x0.max()
    with mp.workdps(50):
        for w in (0.1, 1.0, 3.0):
            s = mp.mpc(0, w)
            exact = sum(mp.mpf(b) ** 2 * s / (s**2 + 2 * mp.mpf(z) * s + 1) for b, z in zip(B[n:], zeta, strict=True))
            assert abs(system(1j * w) - complex(exact)) <= 1e-12 * np.sum(B**2)


@pytest.mark.variants
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("distance", [0.0, 1e-12, 1e-8, 1e-4, 1e-1])
def test_poles_of_one_chain_that_all_meet_keep_their_digits(n, distance):
    """One Jordan block of size 2n, turned: no transformation parts the poles at and beside the point."""
    N = 2 * n
    turn = np.linalg.qr(np.random.default_rng(n).normal(size=(N, N)))[0]
    A = turn @ (-np.diag(1.0 + distance * np.arange(N)) + 0.9 * np.eye(N, k=1)) @ turn.T
    B = turn @ np.ones(N)
    system = phc.ph(np.eye(N), B, J=0.5 * (A - A.T), R=-0.5 * (A + A.T))
    x0, t = turn @ np.arange(1.0, N + 1), np.linspace(0.0, 6.0, 13)
    free = phc.forced_response(system, t, 0.0, x0).states
    step = phc.step_response(system, t).outputs
    size = 1e-12 * max(1, 4 ** (n - 3))  # a block of 2n turns rounding of its entries into powers of them
    with mp.workdps(50):
        exact = mp.matrix(system.J.tolist()) - mp.matrix(system.R.tolist())
        port, one = mp.matrix(B.tolist()), mp.eye(N)
        for k in (1, 5, 12):
            motion = mp.expm(exact * mp.mpf(t[k]))
            wanted = np.array([float(x) for x in motion * mp.matrix(x0.tolist())])
            assert np.abs(free[:, k] - wanted).max() <= size * np.abs(x0).max()
            risen = (port.T * mp.lu_solve(exact, (motion - one) * port))[0]
            assert abs(step[k] - float(risen)) <= size * np.abs(step).max()
        for w in (0.1, 1.0, 3.0):
            value = complex((port.T * mp.lu_solve(mp.mpc(0, w) * one - exact, port))[0])
            assert abs(system(1j * w) - value) <= size * abs(value)


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**31), size=st.floats(-5.0, 0.0))
def test_responses_and_simulations_are_those_of_50_digits(seed, size):
    """Chains with dampers, down to damping ratios of 1e-6 where a pole is known to the rounding of its frequency."""
    rng = np.random.default_rng(seed)
    n, low = int(rng.integers(2, 6)), 10.0**size
    system = phc.spring_chain(
        rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n - 1), ground=rng.uniform(0.1, 1.0, n),
        c=low * rng.uniform(0.01, 0.1, n - 1), ground_c=low * rng.uniform(0.01, 0.1, n), port=[0, n - 1],
    )  # fmt: skip
    N, modes, h, T = 2 * n, system.modes, 0.1, 60
    u = rng.normal(size=(2, T + 1))
    got = phc.forced_response(system, h * np.arange(T + 1), u, intersample="zoh").outputs
    with mp.workdps(50):
        Q, G = mp.matrix(system.Q.tolist()), mp.matrix(system.G.tolist())
        A, C = (mp.matrix(system.J.tolist()) - mp.matrix(system.R.tolist())) * Q, G.T * Q
        for w in [*modes.natural_frequencies, *rng.uniform(0.1, 3.0, 3)]:
            wanted = C * mp.lu_solve(mp.mpc(0, float(w)) * mp.eye(N) - A, G[:, 0])
            terms = np.abs(modes.residues[:, :, 0] / (1j * w - modes.poles)[:, None]).sum(axis=0)
            error = np.abs(system(1j * w)[:, 0] - np.array([complex(x) for x in wanted]))
            assert np.all(error <= max(1e-13, 4 * EPS / modes.damping_ratios.min()) * terms)
        whole = mp.zeros(N + 2)
        whole[:N, :N], whole[:N, N:] = A, G
        step, x, exact = mp.expm(whole * mp.mpf(h)), mp.zeros(N, 1), []
        for k in range(T + 1):
            exact.append([float(y) for y in C * x])
            x = step[:N, :N] * x + step[:N, N:] * mp.matrix(u[:, k].tolist())
    assert np.abs(got - np.array(exact).T).max() <= 1e-12 * np.abs(exact).max()


@settings(max_examples=8, deadline=None)
@SEEDS
def test_the_midpoint_rule_keeps_the_balance_of_power_in_every_step(seed):
    """Ten thousand steps: each to 1e-14 of the energy that flows, and by the equation of the balance itself."""
    system, _, rng = drawn(seed, sensors=False)
    steps, h = 10_000, 0.05
    t, u = h * np.arange(steps + 1), rng.normal(size=(system.ninputs, steps + 1))
    response = phc.forced_response(system, t, u, method="midpoint", intersample="foh")
    balance = phc.energy_balance(response, system)
    flow = max(balance.stored.max(), np.abs(balance.supplied).max(), balance.dissipated.max())
    assert np.abs(np.diff(balance.defect)).max() <= 1e-14 * flow
    x, middle = response.states, 0.5 * (u[:, 1:] + u[:, :-1])
    e = system.Q @ (0.5 * (x[:, 1:] + x[:, :-1]))
    both = np.vstack([e, middle])
    W = np.block([[system.R, system.P], [system.P.T, system.S]])
    y = (system.G + system.P).T @ e + (system.S + system.N) @ middle
    supplied, lost = h * np.sum(middle * y, axis=0), h * np.sum(both * (W @ both), axis=0)
    gained = np.sum(e * np.diff(x), axis=0)  # of a quadratic energy the difference of stored ones
    assert np.abs(gained - supplied + lost).max() <= 1e-12 * np.max(np.abs(supplied) + lost + balance.stored[1:])


@pytest.mark.parametrize("ports", [0, [0, 2]])
def test_values_at_real_points_are_real(ports):
    sys = phc.spring_chain([3.0, 2.0, 1.0], 40.0, ground=[60.0, 0, 0], c=0.1, port=ports)
    gain, plain = sys.dcgain(), ct.ss(sys).dcgain()
    assert np.isrealobj(gain)
    assert np.shape(gain) == np.shape(plain)
    np.testing.assert_allclose(gain, plain, atol=1e-15)
    assert not sys(np.array([0.0, 0.5, 2.0, -7.0])).imag.any()
    lags = phc.ph(ct.tf([1, 3, 2.5], [1, 3, 3, 1]))  # its poles stay together in a cluster
    assert np.isrealobj(lags.dcgain())
    assert round(lags.dcgain(), 12) == 2.5
    integrator = phc.ph([[1.0]], [1.0], J=[[0.0]], S=[[1.0]])
    assert integrator.dcgain() == np.inf


def test_poles_on_the_axis_give_infinity_and_never_nan():
    system = phc.ph(np.diag([1.0, 4.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 1.0], R=np.diag([0.0, 0.0, 0.0, 0.1]))
    assert np.isinf(system(1j)) and np.isfinite(system(2j)) and not np.isnan(system(1j))


@settings(max_examples=10, deadline=None)
@SEEDS
def test_the_ports_of_any_such_system_are_passive(seed):
    system, dense, _ = drawn(seed)
    assert phc.passivity(dense[: system.ninputs, :]).is_passive


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s)), phc.ph])
def test_copies_are_the_same_and_locked(duplicate):
    system = phc.ph(drawn(5)[0], name="plant")
    system.time_unit = "ms"
    twin = duplicate(system)
    assert type(twin) is type(system) and twin.name == system.name and twin.time_unit == "ms"
    for name in "ABCDQGJRPSN":
        assert np.array_equal(getattr(twin, name), getattr(system, name))
        assert not getattr(twin, name).flags.writeable
    with pytest.raises((AttributeError, ValueError)):
        system.Q[0, 0] = 2.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_file_gives_the_same_system_back(tmp_path, seed):
    system = drawn(seed)[0]
    phc.save(system, tmp_path / "plant.json")
    twin = phc.load(tmp_path / "plant.json")
    for name in "ABCDQGJRPSN":
        assert np.array_equal(getattr(twin, name), getattr(system, name))
    assert twin.state_labels == system.state_labels and twin.name == system.name


def test_the_names_of_a_system_survive_and_unknown_ones_are_refused():
    Q, R = np.diag([4.0, 1.0]), np.diag([0.0, 0.1])
    system = phc.ph(Q, [0.0, 1.0], R=R, sensors=[1.0, 0.0], name="plant", outputs=["velocity", "position"])
    assert system.output_labels == ["velocity", "position"] and phc.ph(system, name="other").name == "other"
    with pytest.raises((TypeError, phc.StructureError)):
        phc.ph(Q, [0.0, 1.0], R=R, nonsense=1)


def test_without_losses_and_sensors_it_is_the_lossless_system():
    Q, zero = np.diag([4.0, 1.0]), np.zeros((2, 2))
    assert type(phc.ph(Q, [0.0, 1.0], R=zero, P=np.zeros(2), S=0.0, N=[[0.0]])) is phc.PortHamiltonian
    plain = phc.ph(Q, [0.0, 1.0])
    np.testing.assert_array_equal((plain.J - plain.R) @ plain.Q, plain.A)
    np.testing.assert_array_equal(plain.G - plain.P, plain.B)
    np.testing.assert_array_equal(plain.N, [[0.0]])
    assert [rows.shape for rows in plain.sensors] == [(0, 2), (0, 1)]
    with_sensor = phc.ph(Q, [0.0, 1.0], sensors=[[1.0, 0.0]])
    assert with_sensor.is_lossless and with_sensor.noutputs == 2 and isinstance(with_sensor, phc.PortHamiltonian)
    np.testing.assert_allclose(with_sensor.lossless_part().d, [2.0])


def test_an_odd_number_of_states_needs_a_structure_matrix():
    J = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    system = phc.ph(np.diag([1.0, 2.0, 3.0]), [1.0, 0.0, 0.0], J=J, R=np.diag([0.1, 0.0, 0.0]))
    assert system.nstates == 3 and phc.passivity(system).is_passive
    with pytest.raises(phc.StructureError, match="odd size 3"):
        phc.ph(np.diag([1.0, 2.0, 3.0]), [1.0, 0.0, 0.0], R=np.diag([0.1, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"R": np.diag([0.0, -0.1])}, "rows of R"),
        ({"S": [[-1.0]]}, "rows of S"),
        ({"R": np.diag([0.0, 0.1]), "P": [0.0, 1.0]}, "negative eigenvalue"),
        ({"R": [[0.0, 1.0], [0.0, 0.0]]}, "not symmetric"),
        ({"R": np.eye(3)}, "shape"),
        ({"R": np.eye(2), "N": [[1.0]]}, "N is not skew"),
        ({"R": np.eye(2), "J": np.eye(2)}, "J is not skew"),
        ({"sensors": [[1.0, 0.0, 0.0]]}, "sensors"),
        ({"R": np.full((2, 2), np.nan)}, "R"),
    ],
)
def test_what_makes_energy_or_does_not_fit_is_refused(parts, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], **parts)


@settings(max_examples=10, deadline=None)
@SEEDS
def test_connections_are_port_hamiltonian_and_those_of_python_control(seed):
    one, dense, rng = drawn(seed, sensors=False)
    m = one.ninputs
    W = rng.normal(size=(2 * 2, 3))
    W = W @ W.T
    other = phc.ph(np.diag(rng.uniform(0.5, 2, 2)), rng.normal(size=(2, m)), R=W[:2, :2])
    plain = ct.ss(*(np.array(getattr(other, name)) for name in "ABCD"))
    s = 1j * rng.uniform(0.1, 5.0, 4)
    K = rng.normal(size=(m, m))
    K = K - K.T + np.eye(m)
    for got, wanted in (
        (ct.feedback(one, other), ct.feedback(dense, plain)),
        (ct.feedback(one, K), ct.feedback(dense, ct.ss([], [], [], K))),
        (one + other, dense + plain),
        (other + one, plain + dense),
        (3.0 * one, 3.0 * dense),
        (one * 0.5, 0.5 * dense),
    ):
        assert isinstance(got, phc.PortHamiltonian)
        np.testing.assert_allclose(got(s, squeeze=False), wanted(s, squeeze=False), rtol=1e-8, atol=1e-9)
        W = np.block([[got.R, got.P], [got.P.T, got.S]])
        assert np.linalg.eigvalsh(W)[0] >= -1e-12 * np.linalg.norm(W)
        assert np.array_equal(got.J, -got.J.T)
    assert isinstance(0 + one, phc.PortHamiltonian)
    assert not isinstance(ct.feedback(one, other, sign=1), phc.PortHamiltonian)


@settings(max_examples=10, deadline=None)
@SEEDS
def test_the_energy_of_a_loop_with_an_absorber_never_rises_without_input(seed):
    rng = np.random.default_rng(seed)
    plant = phc.spring_chain(rng.uniform(0.5, 2.0, 3), 4.0, ground=1.0)
    absorber = phc.ph(np.diag(rng.uniform(0.1, 5, 2)), [0.0, 1.0], R=np.diag([0.0, 10 ** rng.uniform(-2, 1)]))
    loop = ct.feedback(plant, absorber)
    x0 = rng.normal(size=loop.nstates)
    motion = phc.forced_response(loop, np.linspace(0.0, 20.0, 201), 0.0, x0)
    energy = loop.hamiltonian(motion.states)
    assert np.all(np.diff(energy) <= 1e-12 * energy[0])


def test_a_connection_that_makes_energy_is_refused():
    one = phc.frenkel_kontorova(2)
    with pytest.raises(phc.StructureError, match="F makes energy"):
        phc.interconnect([one], [[0.5]])
    with pytest.raises(phc.StructureError, match="empty"):
        phc.interconnect([], np.zeros((0, 0)))
    with pytest.raises(phc.StructureError, match="StateSpace"):
        phc.interconnect([ct.ss(-1, 1, 1, 0)], [[0.0]])


def test_python_control_and_the_pictures_take_it():
    system = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.1]), name="plant")
    for draw in (phc.bode_plot, phc.pole_zero_plot, phc.step_plot, ct.bode_plot, ct.nyquist_plot, ct.pole_zero_plot):
        draw(system)
        plt.close("all")
    response = ct.step_response(system)
    np.testing.assert_allclose(response.outputs, phc.step_response(system, response.time).outputs, atol=1e-10)
    assert "plant" in str(system) and "plant" in system._repr_html_()


def with_hidden(seed):
    """Random system with losses of which ports reach and see `order` of its states, mixed by a rotation."""
    rng = np.random.default_rng(seed)
    seen, hidden = int(rng.integers(1, 8)), int(rng.integers(1, 5))
    m, n = int(rng.integers(1, 3)), seen + hidden
    Q, J, R, B = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, m))
    for part in (slice(0, seen), slice(seen, n)):
        size = part.stop - part.start
        root, skew, loss = (rng.normal(size=(size, size)) for _ in range(3))
        Q[part, part], J[part, part] = root @ root.T / size + np.eye(size), skew - skew.T
        R[part, part] = 0.1 * loss @ loss.T
    B[:seen] = rng.normal(size=(seen, m))
    U = np.linalg.qr(rng.normal(size=(n, n)))[0]
    loss = rng.normal(size=(m, m))
    parts = {"R": U @ R @ U.T, "S": loss @ loss.T, "J": U @ (J - J.T) @ U.T / 2}
    # a sensor of what ports see
    rows = np.concatenate([rng.normal(size=(1, seen)), np.zeros((1, hidden))], axis=1) @ U.T
    return phc.ph(U @ Q @ U.T, U @ B, **parts, sensors=rows if rng.integers(2) else None, inputs=m), seen


@settings(max_examples=20, deadline=None)
@SEEDS
def test_minreal_leaves_out_hidden_states_and_keeps_the_transfer_function(seed):
    system, seen = with_hidden(seed)
    small = phc.minreal(system)
    assert type(small) is phc.DissipativePortHamiltonian
    assert (small.nstates, small.conversion.hidden) == (seen, system.nstates - seen)
    assert small.input_labels == system.input_labels and small.output_labels == system.output_labels
    s = 1j * np.geomspace(1e-2, 1e2, 40)
    wanted = system(s, squeeze=False)
    np.testing.assert_allclose(small(s, squeeze=False), wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())
    assert np.linalg.eigvalsh(small.Q)[0] > 0
    again = phc.minreal(small)
    assert again.conversion.hidden == 0
    np.testing.assert_array_equal(again.Q, small.Q)


def test_minreal_keeps_modes_that_are_not_damped_and_takes_what_ph_takes():
    system = phc.ph(np.diag([1.0, 4.0, 9.0, 1.0, 1.0, 1.0]), [0, 0, 0, 1, 1, 0], R=np.diag([0, 0, 0, 0.1, 0, 0]))
    small = phc.minreal(system)
    assert (small.nstates, small.conversion.hidden, small.conversion.energy) == (4, 2, "modal")
    np.testing.assert_allclose(small.damping_ratios, [0.05, 0.0], atol=1e-14)
    equal = phc.minreal(phc.modes([1.0, 2.0, 2.0], [1.0, 1.0, 1.0], damping=0.02))
    assert (equal.nstates, equal.conversion.hidden) == (4, 2)
    given = phc.minreal(ct.ss(np.diag([-1.0, -2.0]), [[1.0], [0.0]], [[1.0, 1.0]], [[0.5]]))
    assert (given.nstates, given.conversion.hidden) == (1, 1)
    with pytest.raises(phc.NotPassiveError):
        phc.minreal(ct.tf([1, -3], [1, 1]))


def test_minreal_of_a_minimal_system_keeps_its_coordinates_and_energy():
    damped = phc.ph(np.diag([4.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.4]))
    small = phc.minreal(damped)
    assert small.conversion.hidden == 0 and small.conversion.energy == "given"
    np.testing.assert_array_equal(small.Q, damped.Q)


@pytest.mark.parametrize("R", [np.diag([0.0, 0.0, 0.1, 0.2]), np.diag([0.0, 0.0, 0.0, 0.2])])
def test_minreal_refuses_sensors_of_what_ports_do_not_see(R):
    # the position of a free mass
    free = phc.ph(np.diag([0.0, 4.0, 1.0, 1.0]), [0, 0, 1.0, 1.0], R=R, sensors=[[1.0, 0, 0, 0]])
    with pytest.raises(phc.StructureError, match=r"sees .*what ports do not|sees states that ports do not .*leave"):
        phc.minreal(free)
    assert phc.minreal(phc.ph(free.Q, free.G, R=R)).nstates == 3


def test_modes_plot_draws_weights_and_damping_ratios():
    classical = phc.modes([1.0, 2.0, 3.0], [1.0, 2.0, 0.5], damping=[0.1, 0.9, 0.02])
    for quantity, weights in (("kappa", [1.0, 4.0, 1.5]), ("r", [1.0, 2.0, 0.5])):
        plot = phc.modes_plot(phc.ph(classical), quantity=quantity, Hz=True, time_unit="s")
        assert plot.lines.shape == (2, 1)
        heads, ratios = plot.lines[0, 0][0], plot.lines[1, 0][0]
        np.testing.assert_allclose(2 * np.pi * heads.get_xdata(), [1.0, 2.0, 3.0])
        np.testing.assert_allclose(heads.get_ydata(), weights)
        np.testing.assert_allclose(ratios.get_xydata(), np.transpose([heads.get_xdata(), [0.1, 0.9, 0.02]]))
        assert plot.axes[1, 0].get_xlabel() == "Natural frequency [Hz]"
        assert plot.axes[1, 0].get_ylabel() == "Damping ratio [%]"
        assert plot.axes[1, 0].yaxis.get_major_formatter()(0.05, None) == "5"
    # beside a lossless one, on axes of one's own
    _, axes = plt.subplots(2, 1)
    both = phc.modes_plot([phc.ph(classical), phc.modes([1.0, 2.0], [1.0, 1.0])], ax=axes)
    np.testing.assert_array_equal(both.lines[1, 0][1].get_ydata(), [0.0, 0.0])
    assert both.axes[0, 0].get_xlim() == both.axes[1, 0].get_xlim()
    plt.close("all")


def test_modes_plot_marks_modes_without_a_weight_of_their_own():
    critical = phc.ph(np.diag([1.0, 9.0, 1.0, 1.0]), [0, 0, 1.0, 1.0], R=np.diag([0, 0, 2.0, 0.1]), sensors=np.eye(4))
    plot = phc.modes_plot(critical)
    assert plot.lines.shape == (2, 1)  # no row for the sensors
    np.testing.assert_allclose(plot.lines[1, 0][0].get_ydata()[1:], 1.0)
    assert [text.get_text() for text in plot.legend.get_texts()][-1] == "poles not parted: no weight of their own"
    # not reached, and a free mass
    free = phc.ph(np.diag([0.0, 9.0, 4.0, 1.0, 1.0, 1.0]), [0, 0, 0, 1.0, 1.0, 0], R=np.diag([0, 0, 0, 0, 0.1, 0.1]))
    axis = phc.modes_plot(free).axes[0, 0]
    heads = {line.get_label(): line.get_xydata() for line in axis.lines}
    np.testing.assert_allclose(heads["not reached, or not shown by the data"], [[2.0, 0.0]])
    assert any(np.allclose(line.get_xydata(), [[0.0, 1.0]]) for line in axis.lines)
    alone = phc.modes_plot(phc.ph(np.eye(2), [0.0, 1.0], R=np.diag([0.0, 2.0])))
    assert np.isnan(alone.lines[0, 0][0].get_ydata()).all()
    plt.close("all")


@pytest.mark.variants
@pytest.mark.parametrize(
    "method, intersample",
    [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")],
)
def test_a_sampled_system_with_losses_comes_back(method, intersample):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        d, zeta = np.cumsum(rng.uniform(0.3, 1.0, 3)), np.array([0.003, 0.1, 1.6])
        system = phc.ph(phc.modes(d, rng.uniform(0.5, 1.0, 3), damping=zeta))
        sampled = phc.sample(system, 0.2, method=method, intersample=intersample)
        back = phc.ph(sampled, method=method, intersample=intersample)
        s = 1j * np.geomspace(0.01, 100, 50)
        np.testing.assert_allclose(
            back.horner(s), system.horner(s), rtol=0, atol=1e-10 * np.abs(system.horner(s)).max()
        )
        assert np.linalg.eigvalsh(back.R)[0] >= -1e-12 * np.linalg.norm(back.R)


@pytest.mark.parametrize("ground_c, n, method", [(0.0, 2, "midpoint"), (0.1, 3, "exact"), (0.1, 5, "midpoint")])
def test_rounding_of_sampled_matrices_makes_no_system_active(ground_c, n, method):
    chain = phc.spring_chain(np.ones(n), 4.0, ground=1.0, c=0.1, ground_c=ground_c, port=0)
    h = 0.005 if n < 5 else 0.01
    sampled = phc.sample(chain, h, method)
    back = phc.ph(sampled, method=method)
    w = np.geomspace(0.1, 8.0, 50)
    np.testing.assert_allclose(back(1j * w), chain(1j * w), rtol=1e-9, atol=1e-11)
    A, B, C, D = sampled.A, sampled.B, sampled.C, sampled.D
    with pytest.raises(phc.NotPassiveError, match="it gives energy"):
        phc.ph(ct.ss(A, B, C, D - 1e-12, h), method=method)
    if ground_c == 0:  # with a mode that has no losses
        with pytest.raises(phc.NotPassiveError, match="right half plane"):
            phc.ph(ct.ss(A * (1 + 1e-9 * h), B, C, D, h), method=method)


def test_a_sampled_system_with_repeated_poles_and_losses_is_refused_by_name():
    system = phc.ph(phc.modes(1.0, 1.0, damping=1.0))
    with pytest.raises(phc.StructureError, match="repeated poles"):
        phc.ph(phc.sample(system, 0.2), method="exact")


def test_a_floating_damped_structure_keeps_its_losses_without_its_position():
    sys = phc.spring_chain([1.0, 3.0], 5.0, c=0.2, port=[0, 1])
    small, s = phc.minreal(sys), np.array([0.3j, 2.0j, 0.5 + 1j])
    assert small.nstates == 3
    np.testing.assert_allclose(small(s), sys(s), rtol=1e-12)

"""Damping injection, tuned mass dampers, observers and passive LQG, against closed forms and python-control."""

from __future__ import annotations

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import minimize_scalar

import ph_control as phc

CHAIN = phc.spring_chain(np.ones(5), np.linspace(1.0, 2.0, 4), ground=[1.0, 0, 0, 0, 0], c=0.01, port=[0, 2, 4])


def plain(sys):
    return ct.ss(sys.A, sys.B, sys.C, sys.D)


def random_plant(seed, m=2):
    """Port-Hamiltonian system with random energy and losses, in any coordinates."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    J = rng.normal(size=(n, n))
    L = rng.normal(size=(n, n))
    loss = rng.normal(size=(n, int(rng.integers(1, n + 1))))
    return phc.ph(L @ L.T + 0.1 * np.eye(n), rng.normal(size=(n, m)), J=J - J.T, R=loss @ loss.T)


def random_gain(rng, m):
    K = rng.normal(size=(m, m))
    return K @ K.T + (K - K.T)


# --- closed loops --------------------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("seed", range(20))
def test_closed_loops_are_port_hamiltonian_and_those_of_python_control(seed):
    rng = np.random.default_rng(seed)
    sys = random_plant(seed)
    for controller in (random_gain(rng, 2), random_plant(seed + 100), phc.lqg(sys, 0.3)):
        closed = phc.damping_injection(sys, controller)
        assert isinstance(closed, phc.PortHamiltonian)
        assert np.linalg.eigvalsh(closed.R).min() >= -1e-12 * np.abs(closed.R).max()
        other = plain(controller) if isinstance(controller, ct.StateSpace) else ct.ss([], [], [], controller)
        expected = ct.feedback(plain(sys), other)
        s = 1j * np.geomspace(0.01, 100.0, 9)
        np.testing.assert_allclose(closed(s), expected(s), rtol=1e-6, atol=1e-9)
        assert closed.poles().real.max() <= 1e-12 * np.abs(closed.poles()).max()


@pytest.mark.parametrize("seed", range(10))
def test_energy_never_rises_without_input(seed):
    sys = random_plant(seed)
    closed = phc.damping_injection(sys, random_plant(seed + 50))
    t = np.linspace(0.0, 5.0, 400)
    start = np.random.default_rng(seed).normal(size=closed.nstates)
    states = phc.forced_response(closed, t, np.zeros((2, 400)), start).states
    energy = 0.5 * np.einsum("it,ij,jt->t", states, closed.Q, states)
    assert np.diff(energy).max() <= 1e-12 * energy[0]


def test_gain_at_chosen_ports_and_its_forms():
    at_ends = phc.damping_injection(CHAIN, [0.5, 0.2], ports=["F_1", 2])
    whole = phc.damping_injection(CHAIN, np.diag([0.5, 0.0, 0.2]))
    np.testing.assert_array_equal(at_ends.A, whole.A)
    assert at_ends.input_labels == CHAIN.input_labels
    sensed = phc.ph(np.eye(2), [0.0, 1.0], R=np.zeros((2, 2)), sensors=[[1.0, 0.0]], outputs=["v", "x"])
    closed = phc.damping_injection(sensed, 0.5)
    assert closed.output_labels == ["v", "x"]
    np.testing.assert_allclose(closed.damping_ratios, [0.25])


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_a_loop_of_feedthroughs_is_judged_without_its_units(size):
    plant, dashpot = phc.spring_chain([1.0], ground=1.0), phc.ph(np.zeros((0, 0)), np.zeros((0, 1)), S=[[size]])
    np.testing.assert_array_equal(phc.damping_injection(plant, dashpot).A, phc.damping_injection(plant, size).A)


@pytest.mark.parametrize(
    ("gain", "options", "message"),
    [
        (-0.1, {}, "gives energy"),
        ([[1.0, 3.0, 0], [3.0, 1.0, 0], [0, 0, 1]], {}, "gives energy"),
        ([1.0, 2.0], {}, "shape"),
        (1.0, {"ports": ["F_9"]}, "no input 'F_9'"),
        (np.nan, {}, "not finite"),
        (phc.spring_chain([1.0]), {}, "1 ports"),
    ],
)
def test_gains_that_do_not_fit_are_refused(gain, options, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.damping_injection(CHAIN, gain, **options)
    with pytest.raises(phc.StructureError, match="StateSpace"):
        phc.damping_injection(plain(CHAIN), 1.0)


@pytest.mark.parametrize("system", [ct.tf([1.0], [1.0, 1.0]), ct.ss(-1.0, 1.0, 1.0, 0.0)])
def test_a_controller_of_another_class_is_asked_for_in_port_hamiltonian_form(system):
    for call in (phc.damping_injection, phc.damping_plot):
        with pytest.raises(phc.StructureError, match=rf"is a {type(system).__name__}; pass ph\(controller\)"):
            call(CHAIN, system, ports=[0])
    with pytest.raises(phc.StructureError, match="gain of an observer is a matrix"):
        phc.observer(CHAIN, system, ports=[0])
    assert phc.damping_injection(CHAIN, phc.ph(system), ports=[0]).nstates == CHAIN.nstates + 1


def test_a_port_that_is_named_twice_does_not_double_its_gain():
    for call in (
        lambda: phc.damping_injection(CHAIN, 1.0, ports=[0, 0]), lambda: phc.lqg(CHAIN, 0.1, ports=[0, "F_1"]),
        lambda: phc.observer(CHAIN, 1.0, ports=[0, 2, 0]), lambda: phc.damping_plot(CHAIN, 1.0, ports=[0, 0]),
        lambda: phc.optimal_damping(CHAIN, [0, 0]),
    ):  # fmt: skip
        with pytest.raises(phc.StructureError, match="port 'F_1' twice"):
            call()
    # two devices at one place are no mistake
    absorber = phc.ph(np.diag([1.0, 2.0]), [1.0, 0.0], R=np.diag([0.0, 0.1]))
    both = phc.damping_injection(CHAIN, absorber + absorber, ports=[0])
    each = phc.damping_injection(CHAIN, phc.interconnect([absorber, absorber], np.zeros((2, 2))), ports=[0, 0])
    np.testing.assert_allclose(each(0.7j), both(0.7j), rtol=1e-9)


def test_a_controller_without_ports_is_refused():
    for call in (
        lambda: phc.lqg(CHAIN, 0.1, ports=[]), lambda: phc.observer(CHAIN, ports=[]),
        lambda: phc.damping_injection(CHAIN, 1.0, ports=[]), lambda: phc.optimal_damping(CHAIN, []),
        lambda: phc.damping_plot(CHAIN, 1.0, ports=[]),
    ):  # fmt: skip
        with pytest.raises(phc.StructureError, match="no port"):
            call()


# --- optimal dampers -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mu", [0.01, 0.05, 0.1, 0.2])
@pytest.mark.parametrize("start", [0, None])
def test_tuned_mass_damper_under_white_noise_is_that_of_warburton(mu, start):
    m, k = 3.0, 7.0
    found = phc.optimal_damping(phc.spring_chain([m], ground=k), mass=mu * m, outputs="displacement", mode=start)
    ratio = np.sqrt(1 + mu / 2) / (1 + mu)
    zeta = np.sqrt(mu * (1 + 3 * mu / 4) / ((1 + mu) * (1 + mu / 2))) / 2
    assert found.tuned_frequencies[0] / np.sqrt(k / m) == pytest.approx(ratio, rel=1e-6)
    assert found.tuned_damping_ratios[0] == pytest.approx(zeta, rel=1e-6)
    # nothing near it is better, by a norm that is computed elsewhere
    assert found.cost == pytest.approx(displacement_norm(found.system), rel=1e-9)
    for factor in (0.999, 1.001):
        for kind in (0, 1):
            k_a, c_a = found.stiffnesses[0], found.gains[0]
            k_a, c_a = (k_a * factor, c_a) if kind else (k_a, c_a * factor)
            absorber = phc.ph(
                np.diag([k_a, 1 / (mu * m)]), [-1.0, 0.0], R=np.diag([0, c_a]), P=[[0.0], [-c_a]], S=[[c_a]]
            )
            other = phc.damping_injection(phc.spring_chain([m], ground=k), absorber)
            assert displacement_norm(other) > found.cost


def displacement_norm(closed):
    """H2 norm from force to displacement."""
    integrated = ct.ss(closed.A, closed.B, np.linalg.solve(closed.A.T, closed.C.T).T, 0)
    return float(
        np.sqrt(np.trace(integrated.C @ ct.lyap(integrated.A, integrated.B @ integrated.B.T) @ integrated.C.T))
    )


def test_tuned_mass_damper_finds_the_optimum_from_another_mode_of_a_structure():
    found = [phc.optimal_damping(CHAIN, [2], mass=0.3, outputs="displacement", mode=k) for k in (0, 1, None)]
    assert found[2].cost <= min(found[0].cost, found[1].cost) * (1 + 1e-9)
    assert found[2].cost < 0.5 * found[2].cost_before


@pytest.mark.parametrize("mu", [0.02, 0.05, 0.2])
def test_fixed_points_are_den_hartogs_and_equally_high(mu):
    found = phc.optimal_damping(phc.spring_chain([1.0], ground=1.0), mass=mu, criterion="fixed points")
    assert found.tuned_frequencies[0] == pytest.approx(1 / (1 + mu), rel=1e-12)
    assert found.tuned_damping_ratios[0] == pytest.approx(np.sqrt(3 * mu / (8 * (1 + mu))), rel=1e-12)
    omega = np.linspace(0.6, 1.4, 20001)
    gain = np.abs(found.system(1j * omega) / (1j * omega))
    peaks = gain[1:-1][(gain[1:-1] > gain[:-2]) & (gain[1:-1] > gain[2:])]
    assert len(peaks) == 2
    np.testing.assert_allclose(peaks, np.sqrt(1 + 2 / mu), rtol=5e-3)


@pytest.mark.parametrize(
    "criterion, cost", [("h2", "H2 norm"), ("fixed points", "H2 norm"), ("damping", "smallest damping ratio")]
)
def test_the_printed_cost_says_what_it_is(criterion, cost):
    found = phc.optimal_damping(phc.spring_chain([1.0], ground=1.0), mass=0.05, criterion=criterion)
    assert f"criterion {criterion}: {cost} {found.cost:.6g}, before" in str(found)


def test_one_dashpot_minimises_the_mean_energy():
    sys = phc.spring_chain([1.0, 2.0, 1.0], [3.0, 1.0], ground=[1.0, 0, 0])

    def energy(g):
        A = phc.damping_injection(sys, g).A
        T = np.linalg.cholesky(sys.Q).T
        A = T @ A @ np.linalg.inv(T)
        return np.trace(solve_continuous_lyapunov(A, -np.eye(len(A))))

    best = minimize_scalar(lambda x: energy(np.exp(x)), bracket=(-2.0, 1.0), options={"xtol": 1e-9})
    found = phc.optimal_damping(sys)
    assert found.cost == pytest.approx(np.sqrt(best.fun), rel=1e-9)
    assert found.gains[0] == pytest.approx(np.exp(best.x), rel=1e-5)
    assert found.cost_before == np.inf
    np.testing.assert_array_equal(np.asarray(found), found.gains)


def test_units_of_the_states_do_not_matter():
    # in SI a storey has 1e8 N/m and 1e5 kg: the roots of the energies are 13 decades apart
    M, K = np.diag([2.0, 2.0, 2.0]), np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    plain = phc.from_second_order(M, K, [1.0, 0.0, 0.0], C=0.02 * K)
    heavy = phc.from_second_order(1e5 * M, 2.5e8 * K, [1.0, 0.0, 0.0], C=0.02 * 5e6 * K)  # times 50 in frequency
    gains = [phc.optimal_damping(sys).gains[0] for sys in (plain, heavy)]
    assert gains[1] == pytest.approx(5e6 * gains[0], rel=1e-5)
    free = phc.from_second_order(1e5 * M, 2.5e8 * (K - np.diag([1.0, 0.0, 0.0])), [1.0, 0.0, 0.0])
    with pytest.raises(phc.StructureError, match="rigid"):
        phc.lqg(free, 1.0, weight=np.eye(6))


@pytest.mark.slow
def test_several_dashpots_damp_the_least_damped_mode_best():
    found = phc.optimal_damping(CHAIN, ["F_1", "F_3"], criterion="damping")
    zeta = found.system.damping_ratios.min()
    assert found.cost == pytest.approx(zeta, rel=1e-9)
    assert found.cost_before == pytest.approx(CHAIN.damping_ratios.min(), rel=1e-6)
    rng = np.random.default_rng(0)
    for _ in range(200):
        gains = found.gains * np.exp(rng.normal(scale=0.3, size=2))
        assert phc.damping_injection(CHAIN, gains, ports=["F_1", "F_3"]).damping_ratios.min() <= zeta * (1 + 1e-6)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_modes_that_can_be_critically_damped_are_not_damped_by_more(unit):
    oscillator = phc.optimal_damping(phc.ph(np.diag([4 * unit, 1.0]), [0.0, 1.0]), criterion="damping")
    np.testing.assert_allclose(oscillator.gains, 4 * np.sqrt(unit), rtol=1e-9)
    assert oscillator.cost == pytest.approx(1.0)
    # modes at 1 and 3 with the same dashpot: the gain at which the faster is critical
    pair = phc.spring_chain(np.full(2, unit), 4 * unit, ground=unit, port=[0, 1])
    two = phc.optimal_damping(pair, criterion="damping")
    assert two.cost == pytest.approx(1.0)
    np.testing.assert_allclose(two.gains, 6 * unit, rtol=1e-6)


def test_what_no_damper_reaches_is_refused_by_its_frequency():
    symmetric = phc.spring_chain([1.0, 1.0, 1.0], ground=[1.0, 0.0, 1.0], port=1)
    with pytest.raises(phc.StructureError, match=r"mode at 1\.41421"):
        phc.optimal_damping(symmetric)
    with pytest.raises(phc.StructureError, match="rigid mode"):
        phc.optimal_damping(phc.spring_chain([1.0, 1.0]), mass=0.1, outputs="velocity")
    with pytest.raises(phc.StructureError, match="feedthrough"):
        phc.optimal_damping(phc.ph([[1.0]], [1.0], J=[[0.0]], R=[[1.0]], S=[[1.0]]))
    with pytest.raises(phc.StructureError, match="positive"):
        phc.optimal_damping(CHAIN, mass=-1.0)
    for outputs in (2.0, CHAIN, np.array(0)):
        with pytest.raises(phc.StructureError, match="or a list of outputs of the plant by number or name"):
            phc.optimal_damping(CHAIN, outputs=outputs)


def test_an_array_without_axes_names_no_port():
    with pytest.raises(phc.StructureError, match=r"there is no input array\(1\)"):
        phc.damping_injection(CHAIN, 0.5, ports=np.array(1))
    with pytest.raises(phc.StructureError, match="give their mass"):
        phc.optimal_damping(CHAIN, criterion="fixed points")


# --- observers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(8))
def test_energy_of_the_error_of_an_observer_never_rises(seed):
    rng = np.random.default_rng(seed)
    sys = random_plant(seed)
    estimator = phc.observer(sys, random_gain(rng, 2))
    t = np.linspace(0.0, 8.0, 500)
    u = np.sin(np.outer([1.0, 1.7], t))
    plant = phc.forced_response(sys, t, u, rng.normal(size=sys.nstates))
    # outputs of the plant bend where the input does: a joint simulation has no error of interpolation
    n, m = sys.nstates, sys.ninputs
    joint = ct.ss(
        np.block([[sys.A, np.zeros((n, n))], [estimator.B[:, m:] @ sys.C, estimator.A]]),
        np.vstack([sys.B, estimator.B[:, :m]]), np.eye(2 * n), 0,
    )  # fmt: skip
    start = np.r_[plant.states[:, 0], np.zeros(n)]
    both = ct.forced_response(joint, t, u, start).outputs
    error = both[:n] - both[n:]
    energy = 0.5 * np.einsum("it,ij,jt->t", error, sys.Q, error)
    assert np.diff(energy).max() <= 1e-9 * energy[0]
    np.testing.assert_allclose(estimator.C[-n:], np.eye(n))


def test_gain_of_an_observer_is_chosen_where_none_is_given():
    estimator = phc.observer(CHAIN, ports=[0, 2])
    best = phc.optimal_damping(CHAIN, [0, 2], criterion="damping")
    assert estimator.damping_ratios.min() == pytest.approx(best.cost, rel=1e-9)
    assert estimator.input_labels == ["F_1", "F_2", "F_3", "v_1", "v_3"]


@pytest.mark.parametrize("c", [2.0, 2.1, 5.0, 1e4])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_an_observer_of_an_overdamped_plant_takes_the_impedance_of_its_port(c, unit):
    sys = phc.spring_chain([1.0], ground=unit**2, ground_c=c * unit)
    made = phc.observer(sys)
    # at the geometric mean of its two rates the response of the mass is 1 / c
    np.testing.assert_allclose(made.R[1, 1], 2 * c * unit, rtol=1e-6)
    error = np.linalg.eigvals((made.J - made.R) @ made.Q)
    assert error.real.max() < 0
    np.testing.assert_allclose(np.sort(error.real), np.sort(np.roots([1.0, 2 * c * unit, unit**2])), rtol=1e-6)


@pytest.mark.parametrize(
    "sys",
    [
        phc.ph([[2.0]], [1.0], R=[[0.3]], J=[[0.0]]),
        phc.rcl_ladder(1),
        phc.spring_chain([1.0, 2.0], 1.0, ground=0.5, ground_c=9.0, port=(0, 1)),
        # the first port oscillates, the second does not
        phc.ph(np.diag([4.0, 4.0, 1.0, 1.0]), np.eye(4)[:, 2:], R=np.diag([0.0, 0.0, 0.01, 9.0])),
    ],
)
def test_an_observer_without_a_gain_finds_the_states_of_any_plant(sys):
    made = phc.observer(sys)
    x = np.ones(sys.nstates)
    A = (made.J - made.R) @ made.Q
    rates = np.linalg.eigvals(A).real
    assert rates.max() < 0
    error = expm(A * 40 / -rates.max()) @ x
    assert np.linalg.norm(error) < 1e-9
    for t in np.geomspace(1e-3, 10, 5):
        moved = expm(A * t) @ x
        assert moved @ made.Q @ moved <= x @ made.Q @ x * (1 + 1e-12)


# --- passive LQG ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_lqg_is_passive_and_minimises_its_cost(seed):
    sys = random_plant(seed)
    E = random_gain(np.random.default_rng(seed), 2)
    E = E + E.T + 0.1 * np.eye(2)
    controller = phc.lqg(sys, E)
    assert phc.passivity(controller).is_passive

    # the cost of any controller of this form, by the covariance of plant and controller under the noise of the notes
    def cost(K):
        A, B, C = sys.A, sys.B, sys.C
        n, k = len(A), K.nstates
        closed = np.block([[A, -B @ K.C], [K.B @ C, K.A]])
        noise = np.zeros((n + k, n + k))
        inverse = np.linalg.inv(sys.Q)
        noise[:n, :n] = 2 * sys.R + B @ np.linalg.solve(E, B.T)
        noise[n:, n:] = K.B @ E @ K.B.T
        X = solve_continuous_lyapunov(closed, -noise)
        assert np.linalg.eigvals(closed).real.max() < 0 and np.isfinite(inverse).all()
        weight = sys.Q + C.T @ np.linalg.solve(E, C)
        return np.trace(weight @ X[:n, :n]) + np.trace(E @ K.C @ X[n:, n:] @ K.C.T)

    best = cost(controller)
    rng = np.random.default_rng(seed + 1)
    for _ in range(5):
        changed = ct.ss(
            controller.A, controller.B * (1 + 0.02 * rng.normal(size=controller.B.shape)),
            controller.C * (1 + 0.02 * rng.normal(size=controller.C.shape)), 0,
        )  # fmt: skip
        assert cost(changed) >= best * (1 - 1e-10)


@pytest.mark.parametrize("effort", [1e-8, 1e-4, 1.0, 1e8, 1e14])
def test_lqg_does_not_depend_on_the_unit_of_mass(effort):
    M, K = np.diag([1.0, 2.0, 1.5]), np.array([[5.0, -4, 0], [-4, 9, -4], [0, -4, 5]])
    poles = []
    for unit in (1.0, 1e-9, 1e-5, 1e6):
        sys = phc.from_second_order(unit * M, unit * K, [1.0, 0, 0], C=0.01 * unit * K)
        controller = phc.lqg(sys, effort / unit)
        assert phc.passivity(controller).is_passive
        poles.append(np.sort_complex(controller.poles()))
    np.testing.assert_allclose(poles[1:], np.array(poles[:1] * 3), rtol=1e-4)


def test_lqg_refuses_an_effort_that_leaves_no_digits():
    sys = phc.spring_chain(np.full(3, 1e-9), 4e-9, ground=1e-9, c=1e-11, port=0)
    with pytest.raises(phc.StructureError, match=r"effort 1e-14 .* nearer to 2\.\d*e\+08"):
        phc.lqg(sys, 1e-14)


def test_lqg_is_stable_with_every_passive_plant():
    controller = phc.lqg(CHAIN, 0.05)
    for seed in range(10):
        closed = phc.damping_injection(random_plant(seed, 3), controller)
        assert closed.poles().real.max() <= 1e-10
    weight = np.zeros((10, 10))
    weight[0, 0] = 4.0
    strong = phc.damping_injection(CHAIN, phc.lqg(CHAIN, 0.05, weight=weight))
    assert strong.poles().real.max() < CHAIN.poles().real.max()
    for bad in (0.0, -1.0, np.eye(2)):
        with pytest.raises(phc.StructureError, match="effort"):
            phc.lqg(CHAIN, bad)
    with pytest.raises(phc.StructureError, match="weight"):
        phc.lqg(CHAIN, weight=-np.eye(10))


@pytest.fixture(scope="module")
def noisy_fit():
    """Fit of three masses with ports at both ends to a short record."""
    plant = phc.spring_chain([1.0] * 3, 300.0, ground=[300.0, 0, 0], c=0.4, ground_c=0.3, port=[0, 2])
    rng = np.random.default_rng(0)
    t, u = 0.05 * np.arange(300), rng.normal(size=(2, 300))
    y = phc.forced_response(plant, t, u, intersample="zoh").outputs
    y = y + 0.5 * y.std() * rng.normal(size=y.shape)
    return phc.pem((u, y), 3, dt=0.05, structure="passive", ports=[(0, 0), (1, 1)])


@pytest.mark.slow
def test_passive_controllers_are_stable_with_every_passive_sample_of_a_fit(noisy_fit):
    samples = noisy_fit.sample_systems(8, rng=1)
    damping = [sample.damping_ratios.min() for sample in samples]
    assert np.std(damping) > 0.3 * noisy_fit.stderr["damping_ratios"].min()
    rng = np.random.default_rng(2)
    controllers = [phc.lqg(noisy_fit.system, effort) for effort in (1e-3, 0.1)] + [
        random_gain(rng, 2) for _ in range(3)
    ]
    for sample in samples:
        assert isinstance(sample, phc.PortHamiltonian) and phc.passivity(plain(sample)).is_passive
        for controller in controllers:
            assert phc.damping_injection(sample, controller).poles().real.max() < 0
    # feedback that gives energy, small enough for the estimate, is unstable with some
    K = np.array([[0.0, 1.0], [0.0, 0.0]])
    gains = -np.geomspace(0.1, 10.0, 401)
    stable = [ct.feedback(plain(noisy_fit.system), gain * K).poles().real.max() < 0 for gain in gains]
    gain = 0.97 * gains[np.argmin(stable)]
    assert ct.feedback(plain(noisy_fit.system), gain * K).poles().real.max() < 0
    growing = [ct.feedback(plain(sample), gain * K).poles().real.max() > 0 for sample in samples]
    assert 0 < sum(growing) < len(samples)


@pytest.mark.slow
def test_sampled_systems_are_those_of_the_samples(noisy_fit):
    samples, systems = noisy_fit.sample(3, rng=5), noisy_fit.sample_systems(3, rng=5)
    omega = np.linspace(1.0, 40.0, 50)
    for k, system in enumerate(systems):
        drawn = samples.freqresp(omega, 0, 1)[k]
        # a draw moves where it is active, by less than its own scatter
        scatter = np.abs(samples.freqresp(omega, 0, 1) - noisy_fit.observed_system(1j * omega)[0, 1]).max()
        assert np.abs(system(1j * omega)[0, 1] - drawn).max() < 0.5 * scatter
        assert system.input_labels == noisy_fit.system.input_labels
    lossless = phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5]))
    rng, t = np.random.default_rng(0), 0.1 * np.arange(400)
    u = rng.normal(size=400)
    y = phc.forced_response(lossless, t, u, intersample="zoh").outputs + 0.1 * rng.normal(size=400)
    fit = phc.pem((u, y), 2, dt=0.1, structure="lossless")
    for d, system in zip(fit.sample(4, rng=3).d, fit.sample_systems(4, rng=3), strict=True):
        assert system.is_lossless
        np.testing.assert_allclose(system.d, np.sort(d))


def test_damping_plot_shows_the_loop_at_each_factor():
    found = phc.optimal_damping(CHAIN, [2], criterion="damping")
    plot = found.plot(factors=[0.5, 1.0, 2.0], Hz=True, time_unit="s")
    drawn = np.array([line.get_ydata()[1] for line in plot.lines[0, 0]])
    zeta = 100 * found.system.damping_ratios
    np.testing.assert_allclose(np.sort(drawn[drawn < 100]), np.sort(zeta[zeta < 100]), rtol=1e-9)
    assert plot.axes[0, 1].get_xlabel() == "Natural frequency [Hz]"
    plt.close(plot.figure)
    with pytest.raises(phc.StructureError, match="ascend"):
        phc.damping_plot(CHAIN, 1.0, factors=[1.0, 0.5])


def test_a_mode_that_a_gyroscopic_gain_makes_oscillate_has_no_mark_before():
    Q, R, turn = np.diag([1.0, 2.0, 1.0, 1.0]), np.diag([0.0, 0.0, 4.0, 5.0]), np.array([[0.0, 20.0], [-20.0, 0.0]])
    plant = phc.ph(Q, np.eye(4)[:, 2:], R=R)
    plot = phc.damping_plot(plant, turn, factors=[1e-3, 1.0])
    assert np.all(np.linalg.eigvals(plant.A - 1e-3 * plant.B @ turn @ plant.B.T @ Q).imag == 0)
    p = np.linalg.eigvals(plant.A - plant.B @ turn @ plant.B.T @ Q)
    marks = [
        (line.get_marker(), *line.get_xydata()[0])
        for line in plot.axes[0, 1].lines
        if line.get_marker() != "None" and len(line.get_xdata())
    ]
    right = sorted(("o", abs(x), -100 * x.real / abs(x)) for x in p if x.imag > 0)
    assert [mark[0] for mark in marks] == ["o"] * len(right) and right
    np.testing.assert_allclose([mark[1:] for mark in sorted(marks)], [mark[1:] for mark in right], rtol=1e-9)
    plt.close(plot.figure)


def test_a_mode_that_ceases_to_oscillate_is_drawn_without_a_gap():
    factors = np.geomspace(1e-2, 1e2, 21)
    plot = phc.damping_plot(phc.spring_chain([1.0, 1.0], [2.0], ground=1.0), 1.0, factors=factors)
    zeta, (size, beside) = plot.lines[0, 0][0].get_ydata(), plot.lines[0, 1][0].get_data()
    assert np.all(np.isfinite(zeta)) and zeta[0] < 1 and zeta[-1] == 100
    critical = np.argmax(beside == 100)  # straight up, where it still oscillates
    assert size[critical] == size[critical - 1] and plot.axes[0, 1].get_xscale() == "linear"
    wide = phc.damping_plot(phc.spring_chain([1.0, 1e-3], [2.0], ground=1.0), 1e-3, factors=factors)
    assert wide.axes[0, 1].get_xscale() == "log"
    wide.figure.canvas.draw()
    assert {"1", "10"} <= {label.get_text() for label in wide.axes[0, 1].get_xticklabels()}
    for picture in (plot, wide):
        plt.close(picture.figure)


@pytest.mark.slow
def test_the_title_of_a_damping_plot_names_the_system():
    named = phc.ph(phc.modes(1.0, 1.0), name="bracket")
    for sys, title in ((named, "Damping of bracket over the gain"), (phc.ph(named, name="sys[3]"), "Damping over")):
        plot = phc.damping_plot(sys, 0.5)
        assert plot.figure.get_suptitle().startswith(title)
        plt.close(plot.figure)


def test_a_mode_with_a_node_at_the_damper_limits_the_damping_and_is_no_missing_optimum():
    # the seventh mass of this chain stands still in its second mode, which keeps its own damping
    plant = phc.spring_chain(np.full(10, 100.0), 4e5, ground=[4e5] + [0.0] * 9, c=20.0, port=[6])
    found = phc.optimal_damping(plant, criterion="damping")
    assert np.isclose(found.cost, plant.damping_ratios[1], rtol=1e-6)
    assert found.cost > 2 * found.cost_before

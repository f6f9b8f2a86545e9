"""Sampled systems: symplectic steps, the balance of energy, and the way back to continuous time."""

import control as ct
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import EPS, dense_step, random_hamiltonian, symplectic_form

import ph_control as phc

relaxed = settings(deadline=None, max_examples=13, derandomize=True)
RULES = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
SPECTRA = {
    "decade": lambda n: np.logspace(0, 1, n),
    "wide 1e4": lambda n: np.logspace(-3, 1, n),
    "clustered 1e-6": lambda n: 2 + 1e-6 * np.arange(n),
    "repeated": lambda n: 1.0 + np.arange(n) // 2,
}


def plant(n, seed, name, ports=1):
    rng = np.random.default_rng(seed)
    Q, _ = random_hamiltonian(SPECTRA[name](n), rng, squeeze=0.5)
    return phc.ph(Q, rng.standard_normal((2 * n, ports)))


# --- one step ------------------------------------------------------------------------------------------------------


@relaxed
@given(
    st.integers(1, 8), st.integers(0, 999), st.sampled_from(list(SPECTRA)), st.sampled_from(RULES), st.integers(1, 2)
)
def test_a_sampled_system_steps_as_the_matrices_do(n, seed, name, rule, ports):
    sys = plant(n, seed, name, ports)
    h = 0.3 / sys.d.max()
    sampled = phc.sample(sys, h, rule[0], intersample=rule[1])
    F, now, then = dense_step(sys.A, sys.B, h, *rule)
    size = 1 + np.linalg.norm(F)
    allowed = 1e4 * n * EPS * size * (1 + np.linalg.norm(sys.B)) * (1 + np.linalg.norm(sys.C))
    for found, truth in ((sampled.A, F), (sampled.B, now + F @ then), (sampled.C, sys.C), (sampled.D, sys.C @ then)):
        assert np.max(np.abs(found - truth)) <= allowed
    assert sampled.dt == h and type(sampled) is ct.StateSpace


@relaxed
@given(st.integers(1, 8), st.integers(0, 999), st.sampled_from(list(SPECTRA)))
def test_the_step_is_symplectic_and_conserves_the_energy_but_for_euler(n, seed, name):
    sys = plant(n, seed, name)
    J, h = symplectic_form(n), 0.7 / sys.d.max()
    for method in ("exact", "midpoint"):
        F = phc.sample(sys, h, method).A
        size = np.linalg.norm(F, 2) ** 2
        assert np.max(np.abs(F.T @ J @ F - J)) <= 1e3 * n * EPS * size
        assert np.max(np.abs(F.T @ sys.Q @ F - sys.Q)) <= 1e3 * n * EPS * size * np.linalg.norm(sys.Q, 2)
    F = phc.sample(sys, h, "euler").A
    growth = np.linalg.det(F)
    assert abs(growth - np.prod(1 + (h * sys.d) ** 2)) < 1e-9 * growth
    assert np.max(np.abs(F.T @ J @ F - J)) > 1e-3 * h**2 * sys.d.min() ** 2


@pytest.mark.parametrize("rule", RULES, ids="-".join)
@pytest.mark.parametrize("make", [phc.ch, phc.oh])
def test_canonical_forms_are_sampled_in_their_own_coordinates(make, rule):
    sys = make([1.0, 2.0, 3.5], [1.0, 0.5, 0.2, 0.1, -0.3, 0.4])
    sampled = phc.sample(sys, 0.3, rule[0], intersample=rule[1])
    F, now, then = dense_step(sys.A, sys.B, 0.3, *rule)
    assert np.max(np.abs(sampled.A - F)) < 1e-12 * np.max(np.abs(F))
    assert np.max(np.abs(sampled.B - now - F @ then)) < 1e-11 * np.max(np.abs(sampled.B))
    assert np.max(np.abs(sampled.C - sys.C)) == 0


@pytest.mark.variants
@pytest.mark.parametrize("make", [phc.ch, phc.oh])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_fifteen_modes_in_canonical_form_are_sampled_as_in_modal_coordinates(make, hold):
    sys = make(np.arange(1.0, 16.0), np.ones(30))
    sampled = phc.sample(sys, 0.05, intersample=hold)
    z = np.exp(0.037j)
    with mp.workdps(50):
        A, B, C, D = (mp.matrix(M.tolist()) for M in (sampled.A, sampled.B, sampled.C, sampled.D))
        found = complex((C * mp.lu_solve(mp.mpc(z) * mp.eye(30) - A, B))[0] + D[0])
    truth = phc.sample(phc.ph(sys), 0.05, intersample=hold)(z)
    assert abs(found - truth) < 1e-11 * abs(truth)


@pytest.mark.variants
@pytest.mark.parametrize("make", [phc.ch, phc.oh])
def test_a_sampled_matrix_that_carries_no_digit_is_finite_and_warns(make):
    sys = make(0.05 * np.arange(1.0, 41.0), np.ones(80))
    with pytest.warns(phc.ConditioningWarning, match=r"sampled matrix of 40 modes carries 0\.0 decimal digits"):
        sampled = phc.sample(sys, 1.0, intersample="foh")
    assert all(np.isfinite(M).all() for M in (sampled.A, sampled.B, sampled.C, sampled.D))
    assert abs(sampled.D[0, 0] / phc.sample(phc.ph(sys), 1.0, intersample="foh").D[0, 0] - 1) < 1e-12


def test_the_midpoint_rule_with_an_interpolated_input_is_the_bilinear_transformation():
    sys = plant(3, 0, "decade")
    ours, theirs = phc.sample(sys, 0.1, "midpoint", intersample="foh"), ct.sample_system(ct.ss(sys), 0.1, "bilinear")
    z = np.exp(1j * np.array([0.1, 0.5, 2.0]))
    assert np.max(np.abs(ours(z) - theirs(z))) < 1e-10 * np.max(np.abs(ours(z)))


# --- the way back --------------------------------------------------------------------------------------------------


@relaxed
@given(st.integers(1, 6), st.integers(0, 999), st.sampled_from(["decade", "wide 1e4"]), st.sampled_from(RULES))
def test_a_sampled_system_comes_back(n, seed, name, rule):
    sys = plant(n, seed, name)
    h = 2.0 / sys.d.max()
    back = phc.ph(phc.sample(sys, h, rule[0], intersample=rule[1]), method=rule[0], intersample=rule[1])
    assert back.n == n
    assert np.max(np.abs(back.d - sys.d)) < 1e-9 * sys.d.max()
    assert np.max(np.abs(back.modes.kappa - sys.modes.kappa)) < 1e-7 * sys.modes.kappa.max()


@pytest.mark.parametrize("rule", RULES, ids="-".join)
def test_a_rigid_body_and_two_ports_come_back(rule):
    B = np.zeros((6, 2))
    B[3:] = np.random.default_rng(0).standard_normal((3, 2))
    sys = phc.ph(np.diag([0.0, 4.0, 9.0, 1.0, 1.0, 1.0]), B)
    back = phc.ph(phc.sample(sys, 0.2, rule[0], intersample=rule[1]), method=rule[0], intersample=rule[1])
    s = 0.3 + 1j
    assert back.n == 3 and np.max(np.abs(back(s) - sys(s))) < 1e-9


@pytest.mark.parametrize("make", [ct.ss, ct.tf], ids=["state space", "transfer function"])
@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ("zoh", ("exact", "zoh")),
        ("foh", ("exact", "foh")),
        ("bilinear", ("midpoint", "foh")),
        ("euler", ("euler", "zoh")),
    ],
)
def test_what_python_control_samples_comes_back(make, theirs, ours):
    sys = phc.ph(phc.modes([1.0, 2.0, 3.5], [1.0, 0.5, 2.0]))
    sampled = ct.sample_system(make(sys), 0.2, theirs)
    back = phc.ph(sampled, method=ours[0], intersample=ours[1])
    assert np.max(np.abs(back.d / sys.d - 1)) < 1e-8 and np.max(np.abs(back.r / sys.r - 1)) < 1e-6


def test_a_wrong_method_is_refused_or_gives_another_system_never_silently_the_same():
    sys = phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5]))
    euler = phc.sample(sys, 0.3, "euler")
    for method in ("exact", "midpoint"):
        with pytest.raises(phc.NotLosslessError, match="off the imaginary axis"):
            phc.ph(euler, method=method, lossless=True)
        with pytest.raises(phc.NotPassiveError):
            phc.ph(euler, method=method)
    with pytest.raises(phc.NotLosslessError, match="off the imaginary axis"):
        phc.ph(phc.sample(sys, 0.3), method="euler", lossless=True)
    assert phc.ph(phc.sample(sys, 0.3), method="euler").damping_ratios.min() > 0.1
    warped = phc.ph(phc.sample(sys, 0.3, "midpoint"), method="exact")
    assert np.max(np.abs(warped.d - 2 / 0.3 * np.arctan(0.15 * sys.d))) < 1e-12


def test_without_a_method_a_sampled_system_is_refused():
    with pytest.raises(
        phc.NotLosslessError, match=r"pass the method by which it was sampled: ph\(sys, method='exact'\)"
    ):
        phc.ph(phc.sample(phc.ph(np.eye(2), [0, 1]), 0.1))


def sampled_at(pole):
    return ct.ss([[pole]], [[1.0]], [[1.0]], 0, 0.1)


BAD = {
    "nyquist": (lambda: phc.ph(sampled_at(-1.0), method="exact"), "comes from no frequency below that of Nyquist"),
    "nyquist, midpoint": (lambda: phc.ph(sampled_at(-1.0), method="midpoint"), "comes from no frequency below"),
    "damped": (lambda: phc.ph(sampled_at(0.5), method="exact", lossless=True), "off the imaginary axis"),
    "no step": (
        lambda: phc.ph(ct.ss([[1.0]], [[1.0]], [[1.0]], 0, True), method="exact"),
        "dt of the system is True; a sampling step",
    ),
    "method of a continuous system": (
        lambda: phc.ph(ct.tf([1, 0], [1, 0, 1]), method="exact"),
        "say how a discrete-time system was sampled; this one is not sampled",
    ),
    "method": (lambda: phc.ph(sampled_at(0.5), method="rk4"), "method is 'rk4'; it must be one of 'exact'"),
    "method of python-control": (
        lambda: phc.ph(sampled_at(0.5), method="tustin"),
        "method is 'tustin'; here that is method='midpoint' with intersample='foh'",
    ),
    "another name": (
        lambda: phc.sample(phc.ph(np.eye(2), [0, 1]), 0.1, "zoh"),
        "method='exact' with intersample='zoh'",
    ),
    "hold": (lambda: phc.ph(sampled_at(0.5), method="exact", intersample="linear"), "intersample is 'linear'"),
    "euler with foh": (lambda: phc.ph(sampled_at(0.5), method="euler", intersample="foh"), "must be 'zoh'"),
    "step": (lambda: phc.sample(phc.ph(np.eye(2), [0, 1]), -1.0), "h is -1.0; it must be one positive number"),
    "plain": (lambda: phc.sample(ct.frd([1.0], [1.0]), 0.1), "this is a FrequencyResponseData; give a system"),
    "sampled with foh by euler": (
        lambda: phc.sample(phc.ph(np.eye(2), [0, 1]), 0.1, "euler", intersample="foh"),
        "intersample must be 'zoh'",
    ),
    "dlti": (lambda: phc.ph(__import__("scipy.signal").signal.dlti([1, 0], [1, 0, 1], dt=0.1)), "is discrete-time"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_sampled_or_brought_back_says_why(name):
    call, message = BAD[name]
    with pytest.raises(phc.StructureError, match=message):
        call()


# --- energy --------------------------------------------------------------------------------------------------------


@relaxed
@given(
    st.integers(1, 6),
    st.integers(0, 999),
    st.sampled_from(list(SPECTRA)),
    st.sampled_from(RULES[:4]),
    st.integers(1, 2),
)
def test_stored_energy_is_what_was_supplied(n, seed, name, rule, ports):
    sys = plant(n, seed, name, ports)
    rng = np.random.default_rng(seed)
    t = 0.5 / sys.d.max() * np.arange(100)
    response = phc.forced_response(
        sys, t, rng.standard_normal((ports, 100)), rng.standard_normal(2 * n), method=rule[0], intersample=rule[1]
    )
    balance = phc.energy_balance(response, sys, method=rule[0], intersample=rule[1])
    assert np.max(np.abs(balance.defect)) <= 1e-10 * np.max(balance.stored)
    assert np.array_equal(balance.stored, sys.hamiltonian(response.states))
    assert balance.supplied[0] == 0 and np.ptp(balance.supplied) > 0
    assert np.array_equal(phc.energy_balance(response, sys).supplied, balance.supplied)


def test_a_response_of_python_control_is_balanced_with_the_input_that_it_interpolates():
    sys = plant(3, 1, "decade", 2)
    t, u = 0.1 * np.arange(50), np.random.default_rng(0).standard_normal((2, 50))
    for response in (ct.forced_response(sys, t, u, 1.0), phc.forced_response(sys, t, u, 1.0)):
        balance = phc.energy_balance(response, sys)
        assert np.max(np.abs(balance.defect)) <= 1e-10 * np.max(balance.stored)


def test_the_supplied_energy_is_the_integral_of_the_power():
    sys = plant(3, 1, "decade")
    rng = np.random.default_rng(0)
    coarse, u = 0.05 * np.arange(21), rng.standard_normal(21)
    fine = np.linspace(0, 1, 20 * 2000 + 1)
    for hold in ("zoh", "foh"):
        drive = np.r_[np.repeat(u[:-1], 2000), u[-1]] if hold == "zoh" else np.interp(fine, coarse, u)
        power = drive * phc.forced_response(sys, fine, drive, 1.0, intersample=hold).outputs
        work = np.sum(0.5 * (power[1:] + power[:-1])) * fine[1]
        response = phc.forced_response(sys, coarse, u, 1.0, intersample=hold)
        # the trapezoidal rule jumps over the steps of a held input
        assert abs(phc.energy_balance(response, sys, intersample=hold).supplied[-1] / work - 1) < 1e-2 / 5


def test_a_rigid_body_keeps_the_balance():
    sys = phc.ph(np.diag([0.0, 4.0, 1.0, 1.0]), [0.0, 0.0, 1.0, 2.0])
    u = np.random.default_rng(0).standard_normal(200)
    for method, hold in RULES[:4]:
        response = phc.forced_response(sys, 0.1 * np.arange(200), u, 1.0, method=method, intersample=hold)
        balance = phc.energy_balance(response, sys, method=method, intersample=hold)
        assert np.max(np.abs(balance.defect)) < 1e-11 * np.max(balance.stored)


def test_euler_makes_energy_from_nothing():
    sys = phc.ph(phc.modes(2.0, 1.0))
    response = phc.forced_response(sys, 0.1 * np.arange(50), 0.0, [1.0, 0.0], method="euler")
    balance = phc.energy_balance(response, sys, method="euler")
    assert np.allclose(balance.stored, 1.04 ** np.arange(50), rtol=1e-12)
    assert np.allclose(balance.defect, balance.stored - 1.0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("simulate", [phc.initial_response, ct.initial_response])
def test_a_free_motion_dissipates_what_it_loses(simulate):
    sys = phc.spring_chain([3.0, 2.0], 40.0, ground=[60.0, 0.0], c=0.3)
    t = np.linspace(0.0, 20.0, 401)
    balance = phc.energy_balance(simulate(sys, t, [0.1, 0.0, 0.0, 0.0]), sys)
    assert not balance.supplied.any() and balance.stored[-1] < 0.5 * balance.stored[0]
    assert np.all(np.diff(balance.dissipated) > 0)
    assert np.max(np.abs(balance.defect)) < 1e-12 * balance.stored[0]


@pytest.mark.parametrize("port", [0, 1])
@pytest.mark.parametrize("simulate", [phc.step_response, ct.step_response])
def test_a_step_at_one_of_several_ports_leaves_the_others_without_input(simulate, port):
    sys = phc.spring_chain([3.0, 2.0], 40.0, ground=[60.0, 0.0], c=0.3, port=[0, 1])
    t = np.linspace(0.0, 2.0, 41)
    balance = phc.energy_balance(simulate(sys, t, input=port), sys)
    forces = np.zeros((2, 41))
    forces[port] = 1.0
    expected = phc.energy_balance(phc.forced_response(sys, t, forces), sys)
    assert np.allclose(balance.supplied, expected.supplied, atol=1e-12 * expected.supplied[-1])
    assert np.max(np.abs(balance.defect)) < 1e-12 * balance.supplied[-1]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda s, t: (phc.step_response(phc.ph(np.eye(2), np.eye(2)), t), phc.ph(np.eye(2), np.eye(2))),
            "one trace of 2 rows: of a system with several ports, forced_response",
        ),
        (lambda s, t: (phc.forced_response(s, t, 1.0, return_states=False), s), "the response has no states"),
        (lambda s, t: (phc.forced_response(s, t, 1.0), phc.ch(s)), "this is a ControllableHamiltonian"),
        (lambda s, t: (phc.forced_response(s, t, 1.0), s + s), r"states of the response have shape \(2, 5\)"),
    ],
)
def test_a_balance_needs_states_of_the_system(make, message):
    response, sys = make(phc.ph(np.eye(2), [0, 1]), np.linspace(0, 1, 5))
    with pytest.raises(phc.StructureError, match=message):
        phc.energy_balance(response, sys)


def made(time=(0.0, 0.1, 0.2), states=((1, 1, 1), (0, 0, 0)), inputs=((1, 1, 1),)):
    """A response, as python-control makes one of anything: a spring at rest under a force, or what is given instead."""
    response = ct.TimeResponseData([0.0, 0.1, 0.2], np.ones((1, 3)), np.ones((2, 3)), np.ones((1, 3)))
    response.t, response.x, response.u = np.asarray(time), np.asarray(states), np.asarray(inputs)
    return response


@pytest.mark.parametrize(
    ("response", "message"),
    [
        (None, "this is a NoneType; pass the response that forced_response gives"),
        ((np.zeros(3), np.zeros(3)), "this is a tuple"),
        (made(states=np.full((2, 3), np.nan)), "the list of states of the response is not finite"),
        (made(inputs=[[1.0, np.nan, 2.0]]), "the list of inputs of the response is not finite"),
        (made(states=np.full((2, 3), 1j)), "the list of states of the response is complex"),
        (made(inputs=[["a", "b", "c"]]), "the list of inputs of the response does not hold real numbers"),
        (made(time=["a", "b", "c"]), "the time vector does not hold real numbers"),
        (made(time=[0.0, 0.1]), "the response has 3 samples of states at 2 instants"),
        (made(inputs=np.ones((1, 4))), "the response has 4 samples of inputs at 3 instants"),
        (made(states=np.full((2, 3), 1e200)), r"z is out of range: its largest entry is 1e\+200"),
        (made(states=1e120 * np.eye(2, 3), inputs=[[1e200, 1e200, 0]]), "the energies supplied leave the range"),
    ],
)
def test_a_response_of_other_sizes_or_without_numbers_has_no_balance(response, message):
    with pytest.raises(phc.StructureError, match=message):
        phc.energy_balance(response, phc.ph(np.eye(2), [0.0, 1.0]))
    assert abs(phc.energy_balance(made(), phc.ph(np.eye(2), [0.0, 1.0])).stored[0] - 0.5) < 4 * EPS


def test_a_response_too_large_for_its_energy_says_so():
    sys = phc.ph(np.eye(2), [0.0, 1.0])
    response = phc.forced_response(sys, [0, 0.1, 0.2], 1e200)
    with pytest.raises(phc.StructureError, match=r"z is out of range: its largest entry is 1.99e\+199"):
        phc.energy_balance(response, sys)


# --- Nyquist -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [phc.ph, phc.ch, phc.oh, lambda modes: phc.affine(phc.ph(modes).Q, phc.ph(modes).B)])
def test_modes_at_and_beyond_the_frequency_of_nyquist_are_named(make):
    sys = make(phc.modes([1.0, 2.0, 4.0], [1.0, 1.0, 1.0]))
    for h, named in (
        (np.pi / 2, "2 modes at d = 2, 4 rad"),
        (0.8, "1 mode at d = 4 rad"),
        (np.pi / 4, "1 mode at d = 4"),
    ):
        with pytest.warns(
            phc.ResolutionWarning, match=f"half a period or more of {named}.* take a step below 0.7854"
        ) as w:
            phc.sample(sys, h)
        assert w[0].filename == __file__
    for method, h in (("exact", 0.999 * np.pi / 4), ("midpoint", 2.0), ("euler", 2.0)):
        phc.sample(sys, h, method)

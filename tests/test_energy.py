"""Energy balances in any unit of time, against closed forms and 60 digits; and those that no motion has."""

import control as ct
import mpmath as mp
import numpy as np
import pytest
from reference import DIGITS, exact_motion, exact_steps
from slow import slowly

import ph_control as phc

UNITS = [1e-12, 1e-9, 1e-5, 1.0, 1e6, 1e12]  # per second: how often these plants go round in one
ALLOWED = 1e-12  # of the largest energy supplied


def off(balance, stored, supplied, dissipated):
    """Largest error of any of the three, of the energy supplied."""
    pairs = (balance.stored, stored), (balance.supplied, supplied), (balance.dissipated, dissipated)
    return max(float(np.max(np.abs(found - exact))) for found, exact in pairs) / float(np.max(np.abs(supplied)))


@pytest.mark.variants
@pytest.mark.parametrize(
    "make", [lambda c: phc.ph(ct.tf([1], [1, c])), lambda c: phc.ph([[1.0]], [1.0], R=[[c]], J=[[0.0]])]
)
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("step", [1e-3, 0.4, 3.0, 70.0])
def test_a_mass_against_a_dashpot_takes_up_what_the_force_does_along_its_way(make, unit, step):
    sys, t = make(unit), np.arange(21) * (step / unit)
    with mp.workdps(DIGITS):
        ways = [(mp.mpf(x) + mp.expm1(-mp.mpf(unit) * mp.mpf(x)) / unit) / unit for x in t.tolist()]
        energies = [mp.expm1(-mp.mpf(unit) * mp.mpf(x)) ** 2 / (2 * mp.mpf(unit) ** 2) for x in t.tolist()]
    supplied, stored = np.array(ways, float), np.array(energies, float)
    balance = phc.energy_balance(phc.forced_response(sys, t, np.ones(21), intersample="zoh"), sys)
    lost = np.array([way - energy for way, energy in zip(ways, energies, strict=True)], float)
    assert off(balance, stored, supplied, lost) < ALLOWED


PLANTS = {
    "critical": lambda s: phc.ph(np.diag([9.0 * s * s, 1.0]), [0.0, 1.0], R=np.diag([0.0, 6.0 * s])),
    "overdamped": lambda s: phc.ph(np.diag([2.0 * s * s, 1.0]), [0.0, 1.0], R=np.diag([0.0, 500.0 * s])),
    "light": lambda s: phc.ph(np.diag([9.0 * s * s, 0.5]), [0.0, 1.0], R=np.diag([0.0, 0.01 * s])),
    "through": lambda s: phc.ph(
        np.diag([9.0 * s * s, 0.5]), [0.0, 1.0], R=np.diag([0.0, 0.3 * s]), S=[[0.2 / s]], P=[[0.0], [0.02]]
    ),
    "two ports": lambda s: phc.spring_chain([1.0, 3.0], 5.0 * s * s, ground=[0.7 * s * s, 0.0], c=0.2 * s, port=[0, 1]),
    "loose": lambda s: phc.spring_chain([1.0, 3.0], 5.0 * s * s, c=0.2 * s),
}


def exact_energies(sys, t, u, hold):
    """By a fine rule of Gauss along the motion, whose pieces are exact: stored, supplied and dissipated."""
    pieces, n = 4, sys.nstates
    nodes, weights = np.polynomial.legendre.leggauss(12)
    h = t[1] / pieces
    fine = np.array([np.interp(np.arange((len(t) - 1) * pieces + 1) / pieces, np.arange(len(t)), row) for row in u])
    if hold == "zoh":
        fine = np.hstack([np.repeat(u[:, :-1], pieces, axis=1), u[:, -1:]])
    z = exact_motion(exact_steps(sys.A, sys.B, h), fine, np.zeros(n), hold)
    starts = np.array([[float(value) for value in column] for column in z]).T
    power, loss = np.zeros(len(z) - 1), np.zeros(len(z) - 1)
    W = np.block([[sys.R, sys.P], [sys.P.T, sys.S]])
    for node, weight in zip(0.5 * (nodes + 1), 0.5 * weights * h, strict=True):
        F, G, S = (np.array(part.tolist(), float) for part in exact_steps(sys.A, sys.B, h * node))
        rise = node * np.diff(fine) if hold == "foh" else 0 * fine[:, 1:]
        now = fine[:, :-1] + rise
        x = F @ starts[:, :-1] + G @ fine[:, :-1] + S @ rise
        m = len(u)
        power += weight * np.sum(now * (sys.C[:m] @ x + sys.D[:m] @ now), axis=0)
        efforts = np.vstack([sys.Q @ x, now])
        loss += weight * np.sum(efforts * (W @ efforts), axis=0)
    sums = [np.r_[0.0, np.cumsum(part)][::pieces] for part in (power, loss)]
    stored = 0.5 * np.sum(starts * (sys.Q @ starts), axis=0)[::pieces]
    return stored, *sums


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("name", PLANTS)
def test_every_term_is_the_integral_along_the_motion_in_any_unit_of_time(name, hold):
    one, rng = PLANTS[name](1.0), np.random.default_rng(3)
    u, t = rng.standard_normal((one.ninputs, 9)), np.arange(9) * (0.01 if name == "overdamped" else 1.5)
    exact = exact_energies(one, t, u, hold)
    for unit in 2.0 ** np.array([-40, -13, 0, 9, 40]):
        sys = PLANTS[name](unit)
        balance = phc.energy_balance(phc.forced_response(sys, t / unit, u, intersample=hold), sys)
        assert off(balance, *(energy / unit**2 for energy in exact)) < ALLOWED
        assert np.max(np.abs(balance.defect)) < ALLOWED * np.max(np.abs(balance.supplied))


@pytest.mark.variants
@pytest.mark.parametrize("name", [*list(PLANTS)[:2], *slowly(*list(PLANTS)[2:])])
def test_long_steps_of_any_size_leave_no_defect(name):
    for unit in UNITS:
        sys = PLANTS[name](unit)
        for step in (1e-5, 30.0, 900.0):
            t = np.arange(12) * (step / unit)
            u = np.random.default_rng(5).standard_normal((sys.ninputs, 12))
            balance = phc.energy_balance(phc.forced_response(sys, t, u), sys)
            # what a lightly damped mode stores may be more than what was supplied last
            size = max(np.max(np.abs(balance.supplied)), np.max(balance.stored))
            assert np.max(np.abs(balance.defect)) < ALLOWED * size


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("plant", ["light", "through"])
def test_steps_of_the_midpoint_rule_supply_the_product_of_mean_input_and_mean_output(plant, hold):
    sys = PLANTS[plant](1.0)
    t, u = 0.1 * np.arange(40), np.random.default_rng(1).standard_normal(40)
    response = phc.forced_response(sys, t, u, method="midpoint", intersample=hold)
    balance = phc.energy_balance(response, sys, method="midpoint", intersample=hold)
    held = u[:-1] if hold == "zoh" else 0.5 * (u[:-1] + u[1:])
    z = 0.5 * (response.states[:, :-1] + response.states[:, 1:])
    flow = 0.1 * held * (sys.C[:1] @ z + sys.D[0, 0] * held)[0]
    np.testing.assert_allclose(balance.supplied, np.cumsum(np.concatenate([[0.0], flow])), atol=1e-12)
    assert np.max(np.abs(balance.defect)) < 1e-12


# --- what no motion has --------------------------------------------------------------------------------------------


def test_what_is_no_motion_of_the_system_has_no_balance():
    sys = phc.ph(np.diag([9.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.6]))
    t, u = 0.3 * np.arange(30), np.random.default_rng(0).standard_normal(30)
    response = phc.forced_response(sys, t, u, intersample="foh")
    phc.energy_balance(response, sys)
    heavier = phc.ph(np.diag([9.0, 0.999999]), [0.0, 1.0], R=np.diag([0.0, 0.6]))
    for wrong in (
        lambda: phc.energy_balance(response, sys, intersample="zoh"),
        lambda: phc.energy_balance(response, sys, method="midpoint"),
        lambda: phc.energy_balance(response, heavier),
    ):
        with pytest.raises(
            phc.StructureError, match=r"differ by .* rounding of energies of .*pass the method and inter"
        ):
            wrong()
    touched = phc.forced_response(sys, t, u)
    touched.x = touched.x * np.where(np.arange(30) == 17, 1 + 1e-8, 1.0)
    with pytest.raises(phc.StructureError, match="not states of the system that respond to these inputs"):
        phc.energy_balance(touched, sys)


def test_the_energy_that_eulers_rule_makes_is_a_number_and_no_error():
    sys = phc.ph(np.diag([9.0, 1.0]), [0.0, 1.0], R=np.diag([0.0, 0.6]))
    response = phc.forced_response(sys, 0.1 * np.arange(20), 1.0, method="euler")
    assert phc.energy_balance(response, sys).defect[-1] > 0.01


@pytest.mark.parametrize("samples", [100, 20_000])
def test_rounding_of_long_records_is_no_defect(samples):
    damped = phc.spring_chain([1.0, 2.0, 0.5], 3.0, ground=[1.0, 0, 0], c=0.01)
    for sys in (damped, phc.ph(phc.modes([1.0, 7.0], [1, 2]))):
        t, u = 0.2 * np.arange(samples), np.random.default_rng(1).standard_normal(samples)
        for simulate in (phc.forced_response, ct.forced_response):
            balance = phc.energy_balance(simulate(sys, t, u), sys)
            assert np.max(np.abs(balance.defect)) < 1e-10 * np.max(balance.stored)


def test_states_of_one_unit_store_their_energy_beside_those_of_another():
    sys = PLANTS["two ports"](1e-13)
    z = np.array([1.0, -2.0, 0.0, 0.0])
    exact = 0.5 * (0.7 * 1.0 + 5.0 * 9.0) * 1e-26
    assert abs(sys.hamiltonian(z) / exact - 1) < 1e-14

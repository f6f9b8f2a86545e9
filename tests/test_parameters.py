"""Physical parameters of a system function, fitted to records and responses by the likelihood of a free fit."""

from __future__ import annotations

import functools

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares
from slow import slowly

import ph_control as phc
from ph_control import StructureError

DT = 0.05
SPRINGS = np.array([100.0, 120.0, 90.0])
KNOWN = {"dt": DT, "quantity": "displacement", "intersample": "zoh", "delay": 0.0}


def chain(k):
    """Displacements of masses on a wall, a force on the last."""
    k, n = np.asarray(k), len(k)
    K = np.diag(np.append(k[:-1] + k[1:], k[-1])) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -0.002 * K - 0.01 * np.eye(n)]])
    return ct.ss(A, np.append(np.zeros(2 * n - 1), 1.0)[:, None], np.eye(n, 2 * n), np.zeros((n, 1)))


def simulated(plant, u, state):
    """Outputs for held inputs, step by step."""
    A, B, C = (np.asarray(each) for each in (plant.A, plant.B, plant.C))
    n, m = B.shape
    both = expm(DT * np.block([[A, B], [np.zeros((m, n + m))]]))
    y = np.empty((len(C), u.shape[1]))
    for k in range(u.shape[1]):
        y[:, k] = C @ state
        state = both[:n, :n] @ state + both[:n, n:] @ u[:, k]
    return y + np.asarray(plant.D) @ u


def record(seed=0, samples=1500, noise=0.05, driven=True):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((1, samples)) * driven
    y = simulated(chain(SPRINGS), u, 0.2 * rng.standard_normal(6))
    return u[0], y + noise * y.std() * rng.standard_normal(y.shape)


@functools.cache
def fitted():
    return phc.pem(record(), 3, **KNOWN, model=chain, parameters=np.full(3, 80.0))


def deviations(result, truth):
    return (result.parameters - truth) / result.stderr["parameters"]


def test_springs_are_found_from_motion_within_their_errors():
    result = fitted()
    assert np.all(np.abs(deviations(result, SPRINGS)) < 4)
    assert np.all(result.stderr["parameters"] < 0.01 * SPRINGS)
    assert result.structure == "parametric" and result.success
    assert result.fitted_parameters.evaluations <= 60


def test_the_minimum_and_its_errors_are_those_of_least_squares_over_springs_and_first_state():
    (u, y), result = record(), fitted()
    size = np.sqrt(result.noise_variance)[:, None]
    constant = np.asarray(result.offsets)[0][:, None]

    def residuals(x):
        return ((y - constant - simulated(chain(x[:3]), u[None], x[3:])) / size).ravel()

    start = np.append(result.parameters, np.zeros(6))
    least = least_squares(residuals, start, x_scale=np.append(np.full(3, 0.1), np.full(6, 0.01)), xtol=1e-12)
    covariance = np.linalg.inv(least.jac.T @ least.jac)
    errors = np.sqrt(np.diag(covariance))[:3]
    assert np.all(np.abs(least.x[:3] - result.parameters) < 0.05 * errors)
    assert np.allclose(errors, result.stderr["parameters"], rtol=0.03)
    correlations = covariance[:3, :3] / np.outer(errors, errors)
    assert np.allclose(correlations, result.fitted_parameters.correlations, atol=0.03)


def test_modes_of_the_result_are_those_of_the_function_with_errors_that_follow_from_its_parameters():
    result = fitted()
    poles = chain(result.parameters).poles()
    assert np.allclose(np.sort(np.abs(poles[poles.imag > 0])), result.natural_frequencies, rtol=1e-9)
    step = 1e-4 * np.eye(3)
    slopes = np.stack([
        (np.sort(np.abs(chain(result.parameters + h).poles()))[::2]
         - np.sort(np.abs(chain(result.parameters - h).poles()))[::2]) / 2e-4
        for h in step
    ], axis=1)  # fmt: skip
    expected = np.sqrt(np.diag(slopes @ result.fitted_parameters.covariance @ slopes.T))
    assert np.allclose(expected, result.stderr["natural_frequencies"], rtol=1e-2)


def test_a_true_function_stands_within_the_free_model_and_a_wrong_one_does_not():
    def without_wall(k):
        return chain(np.array([k[0], k[0], k[1]]))

    wrong = phc.pem(record(), 3, **KNOWN, model=without_wall, parameters=[100.0, 100.0])
    (test,) = fitted().tests
    assert test.hypothesis == "parametric" and test.p > 0.001 and test.dof > 10
    assert wrong.tests[0].p < 1e-10
    assert any(finding.cause.name == "WRONG_MODEL" for finding in wrong.findings)
    assert not any(finding.cause.name == "WRONG_MODEL" for finding in fitted().findings)


def test_the_file_of_a_result_has_its_parameters(tmp_path):
    result = fitted()
    result.save(tmp_path / "fit.json")
    back = phc.load(tmp_path / "fit.json")
    assert np.array_equal(back.parameters, result.parameters)
    assert np.array_equal(back.stderr["parameters"], result.stderr["parameters"])
    assert back.fitted_parameters.names == result.fitted_parameters.names
    assert str(back) == str(result) and "theta[1]" in str(back)


def test_a_record_from_rest_has_no_state_to_estimate():
    u = np.random.default_rng(8).standard_normal((1, 800))
    y = simulated(chain(SPRINGS), u, np.zeros(6))
    y = y + 0.05 * y.std() * np.random.default_rng(9).standard_normal(y.shape)
    options = {"dt": DT, "quantity": "displacement", "intersample": "zoh", "model": chain, "parameters": [95.0] * 3}
    rest, moving = (phc.pem((u[0], y), 3, initial_state=state, **options) for state in ("zero", "estimate"))
    assert np.all(np.abs(deviations(rest, SPRINGS)) < 4) and rest.tests[0].p > 1e-3
    assert np.all(rest.stderr["parameters"] < moving.stderr["parameters"])


def test_intervals_have_the_parameters():
    low, high = fitted().confidence_interval()["parameters"].T
    assert np.all((low < fitted().parameters) & (fitted().parameters < high))


def test_a_fit_without_a_function_has_no_parameters():
    result = phc.pem(record(samples=400), 3, dt=DT, structure="free")
    with pytest.raises(phc.NoSuchQuantityError, match="model=f"):
        _ = result.parameters


@pytest.mark.variants
@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_units_of_parameters_do_not_matter(size):
    result = phc.pem(
        record(samples=600), dt=DT, quantity="displacement", intersample="zoh",
        model=lambda theta: chain(theta * [1 / size, 1.0, size]), parameters=[80.0 * size, 80.0, 80.0 / size],
    )  # fmt: skip
    assert np.all(np.abs(deviations(result, SPRINGS * [size, 1.0, 1 / size])) < 4)


def test_a_combination_without_a_trace_is_named_and_the_rest_keeps_its_error():
    def twice(theta):
        return chain(np.array([100.0, theta[0] * theta[1], theta[2]]))

    result = phc.pem(record(), 3, **KNOWN, model=twice, parameters={"area": 10.0, "modulus": 11.0, "k3": 80.0})
    (finding,) = [each for each in result.findings if each.cause.name == "UNIDENTIFIED"]
    assert "area" in finding.output and "modulus" in finding.output and "k3" not in finding.output
    errors = result.stderr["parameters"]
    assert np.isinf(errors[:2]).all() and 0 < errors[2] < 1
    assert abs(result.parameters[0] * result.parameters[1] - 120) < 2
    assert np.all(np.isfinite(result.stderr["natural_frequencies"]))


def test_a_parameter_at_a_bound_is_held_there_and_told():
    result = phc.pem(
        record(), 3, **KNOWN, model=chain, parameters=[100.0, 100.0, 80.0],
        bounds=([50.0, 50.0, 50.0], [200.0, 110.0, 200.0]),
    )  # fmt: skip
    (finding,) = [each for each in result.findings if each.cause.name == "PARAMETER_BOUND"]
    assert finding.output == "theta[1]" and finding.values == (110.0,)
    assert result.parameters[1] == 110.0 and np.isnan(result.stderr["parameters"][1])


def test_gaps_and_constants_are_those_of_any_fit():
    u, y = record(3)
    y = y + np.array([[3.0], [0.0], [-2.0]])
    y[1, 200:260] = np.nan
    result = phc.pem(
        (u, y), dt=DT, quantity="displacement", intersample="zoh", model=chain, parameters=np.full(3, 95.0)
    )
    assert np.all(np.abs(deviations(result, SPRINGS)) < 4)
    assert np.allclose(result.offsets[0], [3.0, 0.0, -2.0], atol=0.1)
    assert result.fit_percent > 90


def test_a_free_motion_tells_springs_by_its_shapes_as_well():
    _, y = record(1, driven=False, noise=0.02, samples=800)
    result = phc.pem((None, y), dt=DT, quantity="displacement", model=chain, parameters=np.full(3, 95.0))
    assert np.all(np.abs(deviations(result, SPRINGS)) < 4)


def test_correlated_noise_of_the_free_fit_weighs_the_residuals():
    u, y = record(5, noise=0.0, samples=1000)
    root = np.linalg.cholesky(np.full((3, 3), 0.9) + 0.1 * np.eye(3))
    y = y + 0.05 * y.std() * root @ np.random.default_rng(50).standard_normal(y.shape)
    options = {"dt": DT, "quantity": "displacement", "intersample": "zoh", "model": chain, "parameters": [95.0] * 3}
    shared = phc.pem((u, y), 3, noise="correlated", **options)
    alone = phc.pem((u, y), 3, noise="white", **options)
    assert np.all(np.abs(deviations(shared, SPRINGS)) < 4) and shared.tests[0].p > 1e-4
    assert np.all(shared.stderr["parameters"] < alone.stderr["parameters"])


# --- circuits and other plants ---------------------------------------------------------------------------------------

CIRCUIT = """coil and capacitor
V1 1 0
R1 1 2 50
L1 2 3 1m
C1 3 0 10n
R2 3 0 20k
"""


def test_a_netlist_gives_resistance_inductance_and_capacitance_of_a_response():
    function, truth = phc.read_netlist(CIRCUIT, parameters=["r1", "L1", "C1"]), np.array([47.0, 1.08e-3, 9.3e-9])
    omega, rng = 2 * np.pi * np.geomspace(5e3, 3e5, 200), np.random.default_rng(0)
    exact = np.squeeze(function(truth)(1j * omega))
    noise = 0.002 * np.abs(exact).max() * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
    result = phc.pem(ct.frd(exact + noise, omega), model=function, quantity="free")
    assert result.fitted_parameters.names == ("R1", "L1", "C1")
    assert np.array_equal(result.fitted_parameters.start, [50.0, 1e-3, 1e-8])
    assert np.all(np.abs(deviations(result, truth)) < 4) and result.tests[0].p > 1e-3
    J = np.stack([
        np.squeeze(function(truth + h)(1j * omega) - function(truth - h)(1j * omega)) / (2 * h.max())
        for h in 1e-6 * np.diag(truth)
    ], axis=1)  # fmt: skip
    J = np.concatenate([J.real, J.imag]) / (0.002 * np.abs(exact).max()) * truth
    bound = truth * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    assert np.allclose(result.stderr["parameters"], bound, rtol=0.2)


def test_a_netlist_is_in_seconds_and_no_model_of_data_in_milliseconds():
    function = phc.read_netlist(CIRCUIT, parameters=["R1", "L1", "C1"])
    assert function(function.values).time_unit == phc.read_netlist(CIRCUIT).time_unit == "s"
    omega = 2e-3 * np.pi * np.geomspace(5e3, 3e5, 40)
    data = ct.frd(np.squeeze(function(function.values)(1e3j * omega)), omega)
    data.time_unit = "ms"
    with pytest.raises(StructureError, match="in ms here and in s there"):
        phc.pem(data, model=function, quantity="free")
    with pytest.raises(StructureError, match="in ms here and in s there"):
        phc.update_model(function, function.values, phc.pem(data, 1, quantity="free", structure="free"))


@pytest.mark.parametrize(
    "parameters, message",
    [(["R9"], "no 'R9'"), ([], "one at least"), (["R1", "r1"], "different"), ("R1", "names of elements")],
)
def test_elements_that_a_netlist_does_not_have_are_refused(parameters, message):
    with pytest.raises(StructureError, match=message):
        phc.read_netlist(CIRCUIT, parameters=parameters)


def test_a_netlist_refuses_values_that_no_element_has():
    function = phc.read_netlist(CIRCUIT, parameters=["R1", "C1"])
    with pytest.raises(StructureError, match="must be positive"):
        function([50.0, -1e-9])
    with pytest.raises(StructureError, match="2 open values"):
        function([50.0])


def test_poles_that_turn_complex_on_the_way_do_no_harm():
    def motor(theta):
        return ct.tf([theta[1]], [1.0, 2 * theta[0], theta[1]])  # critical at theta[0]**2 = theta[1]

    rng = np.random.default_rng(2)
    u = rng.standard_normal((1, 800))
    y = simulated(ct.ss(motor([1.0, 4.0])), u, np.zeros(2))[0] + 0.02 * rng.standard_normal(800)
    for start in ([4.0, 3.0], [2.0, 4.0]):  # the second is critical itself
        result = phc.pem((u[0], y), dt=DT, quantity="free", model=motor, parameters=start, intersample="zoh")
        assert np.all(np.abs(deviations(result, [1.0, 4.0])) < 4)


def test_a_rigid_body_has_a_mass():
    def carriage(theta):
        return ct.tf([1.0 / theta[0]], [1.0, 0.0, 0.0])

    rng = np.random.default_rng(4)
    u = rng.standard_normal((1, 400))
    y = simulated(ct.ss(carriage([2.5])), u, np.zeros(2))[0]
    y = y + 1e-3 * np.abs(y).max() * rng.standard_normal(400)
    result = phc.pem((u[0], y), dt=DT, quantity="displacement", model=carriage, parameters=[1.5], intersample="zoh")
    assert abs(deviations(result, [2.5])[0]) < 4 and result.stderr["parameters"][0] < 0.01


@pytest.mark.slow
def test_large_structures_come_with_a_few_modes():
    from scipy import sparse

    n = 200
    M = sparse.eye_array(n, format="csc")
    springs = sparse.diags_array([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csc")
    force = np.zeros(n)
    force[60] = 1.0

    def beam(theta):
        K = (theta[0] * 1e5) * springs
        return phc.from_second_order(M, K, force, C=1e-4 * K + 0.05 * M, modes=6)

    rng = np.random.default_rng(0)
    u, t = rng.standard_normal(1500), DT * np.arange(1500)
    y = phc.forced_response(beam([1.1]), t, u, intersample="zoh").outputs
    y = y + 0.05 * y.std() * rng.standard_normal(1500)
    result = phc.pem((u, y), dt=DT, quantity="velocity", model=beam, parameters=[1.0], intersample="zoh")
    assert abs(deviations(result, [1.1])[0]) < 4 and result.fitted_parameters.evaluations <= 20


# --- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options, message",
    [
        ({"model": chain}, "parameters to start from"),
        ({"model": 3.0, "parameters": [1.0]}, "must be a function"),
        ({"model": chain, "parameters": [[1.0]]}, "must be a vector"),
        ({"model": chain, "parameters": [1.0], "bounds": (2.0, 3.0)}, "outside of its bounds"),
        ({"model": chain, "parameters": [1.0], "bounds": 2.0}, "pair"),
        ({"model": chain, "parameters": [1.0, 1.0]}, "2 outputs; the data have"),
        ({"model": lambda theta: theta, "parameters": [1.0]}, "must return a StateSpace"),
        ({"model": lambda theta: ct.c2d(chain(theta), 0.1), "parameters": [1.0] * 3}, "continuous time"),
        ({"model": chain, "parameters": [1.0] * 3, "structure": "free"}, "leave it out"),
        ({"parameters": [1.0]}, "model=f"),
        ({"bounds": (0.0, 1.0)}, "model=f"),
    ],
)
def test_what_is_no_model_is_refused_before_anything_is_fitted(options, message):
    with pytest.raises(StructureError, match=message):
        phc.pem(record(samples=200), dt=DT, **options)


def test_parameters_that_were_given_are_not_changed():
    start = np.full(3, 95.0)
    phc.pem(record(samples=300), 3, dt=DT, quantity="displacement", model=chain, parameters=start)
    assert np.array_equal(start, np.full(3, 95.0))


def windy(seed, colour, samples=1200):
    """A record of the chain beside a force on the second mass that nobody measured, with a third of its motion."""
    rng = np.random.default_rng([seed, 5])
    plant = chain(SPRINGS)
    other = ct.ss(plant.A, np.array([[0, 0, 0, 0, 1.0, 0]]).T, plant.C, np.zeros((3, 1)))
    u, wind = rng.standard_normal((1, samples)), rng.standard_normal((1, samples))
    for k in range(1, samples):
        wind[0, k] += colour * wind[0, k - 1]
    y, moved = simulated(plant, u, np.zeros(6)), simulated(other, wind, np.zeros(6))
    y = y + 0.3 * moved * y.std() / moved.std()
    return u[0], y + 0.02 * y.std() * rng.standard_normal(y.shape)


@pytest.mark.parametrize("colour", [0.0, *slowly(0.9)])
@pytest.mark.parametrize("seed", [0, *slowly(1, 2)])
def test_springs_are_found_beside_forces_that_nobody_measured(seed, colour):
    result = phc.pem(windy(seed, colour), 3, **KNOWN, model=chain, parameters=np.full(3, 80.0))
    assert "FORCES" in [finding.cause.name for finding in result.findings]
    assert np.all(np.abs(deviations(result, SPRINGS)) < 4)
    assert np.all(result.stderr["parameters"] < 0.01 * SPRINGS)
    assert result.tests[0].p > 1e-3

"""Model updating: parameters of a computed model that bring its modes to fitted ones."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import ph_control as phc
from ph_control import StructureError

DT = 0.05
TRUTH = np.array([100.0, 70.0, 100.0, 100.0])


def building(k, sensors=3):
    """Velocity of the roof, where the force acts, and displacements of floors below."""
    k, n = np.asarray(k), len(k)
    K = np.diag(np.append(k[:-1] + k[1:], k[-1])) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    F = np.append(np.zeros(n - 1), 1.0)
    return phc.from_second_order(np.eye(n), K, F, C=0.003 * K + 0.02 * np.eye(n), sensors=np.eye(sensors, n))


@functools.cache
def fit(seed=0, sensors=3):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(2500)
    y = phc.forced_response(building(TRUTH, sensors), DT * np.arange(2500), u, intersample="zoh").outputs
    y = y + 0.05 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    quantity = ["velocity"] + ["displacement"] * sensors
    return phc.pem((u, y), 4, dt=DT, quantity=quantity, structure="free", noise="white", intersample="zoh")


def test_a_weak_storey_is_found_within_its_interval():
    update = phc.update_model(building, np.full(4, 100.0), fit())
    assert np.all(np.abs(update.parameters - TRUTH) < 4 * update.stderr) and np.all(update.stderr < 2)
    assert update.success and update.p > 1e-3
    low, high = update.confidence_interval()[1]
    assert low < update.parameters[1] < high < 80
    assert update.fitted_parameters.evaluations <= 80


def test_the_distance_is_least_and_the_errors_are_its_curvature():
    update, result = phc.update_model(building, np.full(4, 100.0), fit()), fit()
    count, n = len(result.poles), result.order
    kept = np.isfinite(np.diag(result.covariance)) & (np.diag(result.covariance) > 0)
    kept[-result.feedthrough.size :] = False
    deviation = np.sqrt(np.diag(result.covariance)[kept])
    inverse = np.linalg.pinv(
        result.covariance[np.ix_(kept, kept)] / np.outer(deviation, deviation), 1e-9, hermitian=True
    )

    def numbers(theta):
        form = phc.modes(building(theta))
        poles = form.poles[form.poles.imag > 0]
        order = np.argsort(np.abs(poles))
        residues = form.residues[form.poles.imag > 0][order]
        size = np.abs(poles[order])
        damping = -poles[order].real / size
        return np.concatenate([size, damping, residues.real.ravel(), residues.imag.ravel(), np.zeros(4)])[kept]

    mine = np.concatenate([
        np.abs(result.poles), result.damping_ratios, result.residues.real.ravel(), result.residues.imag.ravel(),
        np.zeros(4),
    ])[kept]  # fmt: skip

    def whitened(theta):
        return (mine - numbers(theta)) / deviation

    assert count == n
    J = np.stack(
        [(whitened(update.parameters + h) - whitened(update.parameters - h)) / 2e-3 for h in 1e-3 * np.eye(4)]
    ).T
    gradient, gram = J.T @ inverse @ whitened(update.parameters), J.T @ inverse @ J
    assert np.allclose(np.sqrt(np.diag(np.linalg.inv(gram))), update.stderr, rtol=1e-2)
    assert np.all(np.abs(np.linalg.solve(gram, gradient)) < 0.02 * update.stderr)
    assert np.isclose(whitened(update.parameters) @ inverse @ whitened(update.parameters), update.distance, rtol=1e-2)


def test_the_report_has_frequencies_and_assurance_before_and_after():
    update = phc.update_model(building, {"k1": 100.0, "k2": 100.0, "k3": 100.0, "k4": 100.0}, fit())
    assert np.all(np.abs(update.after / update.measured - 1) < np.abs(update.before / update.measured - 1) + 2e-3)
    assert np.all(update.mac_after > 0.999) and np.all(update.mac_before < 1.0)
    text = str(update)
    assert "k2" in text and "MAC after" in text and "agrees with 4 fitted modes" in text


def test_modes_are_paired_by_their_shapes_where_frequencies_have_crossed():
    update = phc.update_model(building, np.full(4, 160.0), fit())
    assert np.all(np.abs(update.parameters - TRUTH) < 4 * update.stderr)


def test_shapes_of_any_scale_and_frequencies_are_enough():
    update = phc.update_model(building, np.full(4, 100.0), fit(), quantities=["natural_frequencies", "shapes"])
    assert np.all(np.abs(update.parameters - TRUTH) < 5 * update.stderr)
    assert np.all(update.stderr > 0.9 * phc.update_model(building, np.full(4, 100.0), fit()).stderr)


def test_outputs_that_were_not_measured_are_left_out():
    result = fit(sensors=1)
    update = phc.update_model(building, np.full(4, 100.0), result, outputs=[0, 1])
    assert np.all(np.abs(update.parameters - TRUTH) < 4 * update.stderr)
    with pytest.raises(StructureError, match=r"outputs=\[\.\.\]"):
        phc.update_model(building, np.full(4, 100.0), result)


def test_some_of_the_modes_tell_less():
    every, some = (phc.update_model(building, np.full(4, 100.0), fit(), modes=modes) for modes in (None, [0, 1]))
    assert np.all(some.stderr > every.stderr) and len(some.after) == 2


def test_a_model_that_cannot_be_right_is_told():
    update = phc.update_model(lambda theta: building(np.full(4, theta[0])), [100.0], fit())
    assert update.p < 1e-6 and "does NOT agree" in str(update)


def test_what_is_known_beforehand_counts_by_its_standard_deviation_and_only_if_given():
    free = phc.update_model(building, np.full(4, 100.0), fit())
    strict = phc.update_model(building, np.full(4, 100.0), fit(), prior=1e-5)
    assert np.all(np.abs(strict.parameters - 100.0) < 0.5) and np.all(strict.stderr < 2e-5)
    loose = phc.update_model(building, np.full(4, 100.0), fit(), prior=1e4)
    assert np.allclose(loose.parameters, free.parameters, rtol=1e-5)


def test_a_combination_without_a_trace_has_infinite_errors():
    def twice(theta):
        return building([100.0, theta[0] * theta[1], 100.0, 100.0])

    update = phc.update_model(twice, [10.0, 10.0], fit())
    assert np.isinf(update.stderr).all() and "leaves no trace" in str(update)
    assert abs(update.parameters[0] * update.parameters[1] - 70) < 2


def tower(theta, foot=None):
    """Damping in proportion to the stiffness, unless another damper is at the foot."""
    dashpot = 1.5 * theta[1] if foot is None else foot
    masses = [300.0, 200.0, 100.0]
    return phc.spring_chain(masses, theta[0], ground=[6e5, 0, 0], c=theta[1], ground_c=[dashpot, 0, 0], port=2)


@functools.cache
def tower_fit(structure, foot=None):
    rng = np.random.default_rng(1)
    u = 100 * rng.standard_normal(2000)
    y = phc.forced_response(tower([4e5, 150.0], foot), 0.005 * np.arange(2000), u, intersample="zoh").outputs
    y = y + 0.05 * y.std() * rng.standard_normal(2000)
    return phc.pem((u, y), 3, dt=0.005, structure=structure, noise="white", intersample="zoh")


def test_a_fit_with_real_shapes_does_not_update_a_model_of_complex_ones():
    def model(theta):
        return tower(theta, 100.0)

    result = tower_fit("classical", 100.0)
    assert result.tests[0].p > 0.05  # though the data do not reject them
    with pytest.raises(StructureError, match=r"fit of structure 'classical'.*structure='free'"):
        phc.update_model(model, [3e5, 100.0], result)
    update = phc.update_model(model, [3e5, 100.0], tower_fit("free", 100.0))
    assert np.all(np.abs(update.parameters - [4e5, 150.0]) < 4 * update.stderr) and update.p > 1e-3


def test_a_fit_with_real_shapes_updates_a_model_of_real_ones_as_a_free_fit_does():
    updates = [phc.update_model(tower, [3e5, 100.0], tower_fit(structure)) for structure in ("classical", "free")]
    for update in updates:
        assert np.all(np.abs(update.parameters - [4e5, 150.0]) < 4 * update.stderr) and update.p > 1e-3
    assert np.allclose(updates[0].stderr, updates[1].stderr, rtol=0.02)


def test_a_bound_holds():
    update = phc.update_model(building, np.full(4, 100.0), fit(), bounds=(80.0, 150.0))
    assert update.parameters[1] == 80.0 and np.isnan(update.stderr[1])


@pytest.mark.parametrize(
    "options, message",
    [
        ({"result": 3.0}, "a fit by pem"),
        ({"quantities": ["energies"]}, "quantities"),
        ({"modes": [7]}, "there are 0 to 3"),
        ({"modes": [0, 0]}, "different whole numbers"),
        ({"prior": -1.0}, "must be positive"),
        ({"outputs": [0, 1]}, "the fit has 4"),
        ({"f": 3.0}, "must be a function"),
    ],
)
def test_what_does_not_go_together_is_refused(options, message):
    known = {"f": building, "theta0": np.full(4, 100.0), "result": fit()}
    with pytest.raises(StructureError, match=message):
        phc.update_model(**(known | options))

"""Covariance of the estimates, against finite differences of a dense prediction and against repeated noise."""

from functools import partial

import numpy as np
import pytest
from reference import EPS
from scipy.signal import lfilter

import ph_control as phc
from ph_control.identification.regression.time_rows import RecordRows
from ph_control.identification.regression.variable_projection import Problem
from ph_control.identification.uncertainty.covariance import uncertainty
from ph_control.modal.discretization import Hold

lossless_fit = partial(phc.pem, structure="lossless")

D, R = np.array([0.7, 2.0, 3.5]), np.array([1.0, 0.4, 0.2])
N = len(D)
QUANTITIES = ("velocity", "displacement", "acceleration")


def predicted(d, r, state, u, h, quantity="velocity"):
    """Output from a state in Williamson coordinates, one complex recursion for each mode."""
    n = len(d)
    y = u * (r * d).sum() if quantity == "acceleration" else np.zeros(len(u))
    weight = {"velocity": np.ones(n) + 0j, "displacement": 1j / d, "acceleration": -1j * d}[quantity]
    for l in range(n):
        lam = np.exp(-1j * d[l] * h)
        start = d[l] * np.sqrt(r[l]) * (state[l] + 1j * state[n + l])
        pushed = np.concatenate([[start], r[l] * (1 - lam) / 1j * u[:-1]])
        y = y + (weight[l] * lfilter([1.0], [1.0, -lam], pushed)).real
    return y


def recording(samples, h, seed, noise=0.1, quantity="velocity", offset=0.0, d=D, r=R):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = predicted(d, r, rng.standard_normal(2 * len(d)), u, h, quantity)
    y = y + noise * np.std(y) * rng.standard_normal(samples) + offset
    y[rng.random(samples) < 0.03] = np.nan
    return u, y


def dense_covariance(result, experiments, steps, quantity, with_offset, held=()):
    """`s^2 (J^T J)^-1` of `(d, r, states, offsets)`, differences of the dense prediction; NaN for what is held."""
    n, count = result.order, len(experiments)
    theta = np.concatenate([result.d, result.r, *result.initial_states, result.offsets[: count * with_offset]])

    def output(theta):
        states = theta[2 * n : 2 * n * (1 + count)].reshape(count, 2 * n)
        constants = theta[2 * n * (1 + count) :] if with_offset else np.zeros(count)
        return np.concatenate([
            (predicted(theta[:n], theta[n : 2 * n], states[k], u, steps[k], quantity) + constants[k])[~np.isnan(y)]
            for k, (u, y) in enumerate(experiments)
        ])  # fmt: skip

    J = np.empty((len(output(theta)), len(theta)))
    for k in range(len(theta)):
        shift = np.zeros(len(theta))
        shift[k] = 1e-5 * max(abs(theta[k]), 0.1)
        J[:, k] = (output(theta + shift) - output(theta - shift)) / (2 * shift[k])
    left = np.concatenate([y[~np.isnan(y)] for _, y in experiments]) - output(theta)
    lengths = np.linalg.norm(J, axis=0)
    variance = left @ left / (len(left) - len(theta))
    return variance * np.linalg.inv((J / lengths).T @ (J / lengths)) / np.outer(lengths, lengths), variance


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_covariance_is_that_of_the_dense_fisher_information(quantity, offset, count):
    steps = [0.1, 0.13][:count]
    experiments = [
        recording(T, h, T, quantity=quantity, offset=2.0 * offset) for T, h in zip([500, 400], steps, strict=False)
    ]
    result = phc.pem(experiments, N, dt=steps, quantity=quantity, offset=offset)
    expected, variance = dense_covariance(result, experiments, steps, quantity, offset)
    assert np.isclose(result.noise_variance, variance, rtol=1e-10)
    shown = expected[: 2 * N * (1 + count), : 2 * N * (1 + count)]
    deviation = np.sqrt(np.diag(shown))
    assert result.covariance.shape == shown.shape == 2 * (2 * N * (1 + count),)
    # sensitivities by central differences over 1e-5 of records of about 50 radians
    assert np.abs((result.covariance - shown) / np.outer(deviation, deviation)).max() <= 1e-5
    assert np.allclose(result.covariance, result.covariance.T, rtol=0, atol=100 * EPS * np.abs(result.covariance).max())
    if offset:
        assert np.allclose(result.stderr["offset"], np.sqrt(np.diag(expected))[-count:], rtol=1e-6)
    # the mapping is the diagonal, in the form of the parameters
    flat = np.concatenate([result.stderr["d"], result.stderr["r"], np.ravel(result.stderr["initial_state"])])
    assert np.allclose(flat, deviation, rtol=1e-5)
    assert result.stderr["initial_state"].shape == ((2 * N,) if count == 1 else (count, 2 * N))


def test_covariance_of_a_plant_at_rest_has_no_states():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(500)
    y = predicted(D, R, np.zeros(2 * N), u, 0.1) + 0.1 * rng.standard_normal(500)
    result = phc.pem((u, y), N, dt=0.1, initial_state="zero")
    assert np.isnan(result.covariance[2 * N :]).all() and np.isnan(result.stderr["initial_state"]).all()
    known = result.covariance[: 2 * N, : 2 * N]
    theta, step, still = np.concatenate([result.d, result.r]), 1e-5, np.zeros(2 * N)

    def at(theta):
        return predicted(theta[:N], theta[N:], still, u, 0.1)

    J = np.array([(at(theta + shift) - at(theta - shift)) / (2 * step) for shift in step * np.eye(2 * N)]).T
    expected = result.noise_variance * np.linalg.inv(J.T @ J)
    deviation = np.sqrt(np.diag(expected))
    assert np.abs((known - expected) / np.outer(deviation, deviation)).max() <= 1e-5


def test_a_weight_held_at_zero_has_no_error_and_its_mode_no_state():
    u, y = recording(800, 0.1, 1, noise=0.05)
    y = y - predicted(np.array([5.0]), np.array([0.1]), np.array([8.0, 0.0]), u, 0.1)
    result = lossless_fit((u, y), N + 1, dt=0.1)
    assert result.active == (3,) and abs(result.d[3] - 5.0) < 0.05
    missing = np.isnan(np.diag(result.covariance))
    held = np.zeros(4 * (N + 1), bool)
    held[[N + 1 + 3, 2 * (N + 1) + 3, 3 * (N + 1) + 3]] = True
    assert np.array_equal(missing, held)
    assert np.isnan(result.covariance[held]).all() and np.isnan(result.covariance[:, held]).all()
    assert np.isfinite(result.covariance[np.ix_(~held, ~held)]).all()
    # the frequency of what moves there is known, and what is known of the others hardly changes
    assert 0 < result.stderr["d"][3] < 0.01
    clean = lossless_fit((u, y), N + 1, dt=0.1, representation="observable").confidence_interval()
    assert np.isnan(clean["r"][3]).all() and np.isfinite(clean["d"]).all()


@pytest.mark.parametrize("options", [{"initial_state": "zero"}, {"representation": "controllable"}])
def test_a_mode_that_neither_answers_nor_moves_has_a_frequency_without_error(options):
    # with the sign of the sensor reversed, nothing that a plant at rest can do helps
    rng = np.random.default_rng(6)
    u = rng.standard_normal(400)
    y = predicted(D[:2], R[:2], np.zeros(4), u, 0.1) - 0.3 * predicted(D[2:], R[2:], np.zeros(2), u, 0.1)
    result = lossless_fit((u, y + 0.02 * rng.standard_normal(400)), 3, dt=0.1, initial_guess=(D, R), **options)
    held = np.isin(np.arange(3), result.active)
    assert held.any() and np.array_equal(np.isnan(result.stderr["d"]), held)
    assert np.isfinite(result.stderr["d"][~held]).all() and np.isfinite(result.stderr["r"][~held]).all()
    assert result.success


def test_modes_that_were_asked_for_but_are_not_in_the_data_are_nan_in_their_places():
    rng = np.random.default_rng(2)
    u = rng.standard_normal(400)
    y = predicted(D, R, rng.standard_normal(2 * N), u, 0.1)
    total = N + 2
    result = phc.pem((u, y), total, dt=0.1)
    assert result.unseen == (3, 4) and result.covariance.shape == (4 * total, 4 * total)
    seen = np.isfinite(np.diag(result.covariance)).reshape(4, total)
    assert seen[:, :N].all() and not seen[:, N:].any()
    assert np.isnan(result.stderr["d"][N:]).all() and np.isfinite(result.stderr["d"][:N]).all()


def test_order_of_the_modes_in_the_search_does_not_matter():
    u, y = recording(400, 0.1, 3)
    one = RecordRows(u, y, ~np.isnan(y), Hold(0.1), offset=True)
    found = []
    for order in ([0, 1, 2], [2, 0, 1]):
        at = Problem((one,)).project(D[order])
        found.append(uncertainty(at.ascending, N, "velocity"))
    scale = np.sqrt(np.diag(found[0].covariance))
    assert np.abs((found[0].covariance - found[1].covariance) / np.outer(scale, scale)).max() <= 1e6 * EPS
    assert np.allclose(found[0].offsets, found[1].offsets, rtol=1e6 * EPS)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_standard_errors_are_those_of_repeated_noise(quantity):
    rng = np.random.default_rng(4)
    d, r, samples, seeds = D[:2], R[:2], 250, 60
    u, state = rng.standard_normal(samples), rng.standard_normal(4)
    clean = predicted(d, r, state, u, 0.1, quantity)
    deviation = 0.05 * np.std(clean)
    scores = []
    for seed in range(seeds):
        y = clean + deviation * np.random.default_rng(1000 + seed).standard_normal(samples)
        result = phc.pem((u, y), 2, dt=0.1, quantity=quantity, initial_guess=(d, r))
        scores.append(np.concatenate([
            (result.d - d) / result.stderr["d"], (result.r - r) / result.stderr["r"],
            (result.initial_state - state) / result.stderr["initial_state"],
        ]))  # fmt: skip
    mean_square = np.mean(np.square(scores), axis=0)
    # eight tests at four deviations of a chi-squared mean
    assert (np.abs(mean_square - 1) <= 4 * np.sqrt(2 / seeds)).all()
    assert abs(np.mean(mean_square) - 1) <= 4 * np.sqrt(2 / seeds / 4)


def test_more_data_shrink_the_errors_as_they_should():
    # errors of frequencies fall with the length to the power 3/2, of weights with its root
    short, long = (lossless_fit(recording(T, 0.1, 5, noise=0.1), N, dt=0.1) for T in (500, 4000))
    assert np.allclose(np.mean(long.stderr["d"] / short.stderr["d"]), 8**-1.5, rtol=0.4)
    twice = recording(500, 0.1, 5)
    both = lossless_fit([twice, twice], N, dt=0.1)
    # the same record twice: half the variance, whatever belongs to each of them being known separately
    one = lossless_fit(twice, N, dt=0.1)
    degrees = (2 * (2 * int(np.sum(~np.isnan(twice[1]))) - 6 * N)) / (2 * int(np.sum(~np.isnan(twice[1]))) - 8 * N)
    assert np.allclose(both.d, one.d, rtol=1e-12)
    assert np.allclose((one.stderr["d"] / both.stderr["d"]) ** 2, degrees, rtol=1e-6)

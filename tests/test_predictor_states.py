"""States of predictors from the past of outputs and inputs, and the fits in noise far from white that they begin."""

import control as ct
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import lfilter

import ph_control as phc
from ph_control.identification.search.predictor_states import PredictorStates, products_of_past

STEP = 1.0


def innovations_form(rng, n, p, m):
    """Matrices `A, B, C, D, K` of n states, the plant stable and the predictor quick, and a covariance of errors."""
    while True:
        A = rng.standard_normal((n, n))
        A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
        B, C, D = rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m))
        K, L = 0.2 * rng.standard_normal((n, p)), rng.standard_normal((p, p)) + 2 * np.eye(p)
        if np.abs(np.linalg.eigvals(A - K @ C)).max() < 0.85:
            return A, B, C, D, K, L @ L.T


def exact_correlations(model, lags):
    """Correlations of outputs and of white inputs of variance 1, from the covariance of the states."""
    A, B, C, D, K, S = model
    p, m = D.shape
    P = solve_discrete_lyapunov(A, B @ B.T + K @ S @ K.T)
    R = [np.block([[C @ P @ C.T + D @ D.T + S, D], [D.T, np.eye(m)]])]
    power = np.eye(len(A))
    for _ in range(lags):
        with_outputs = C @ power @ (A @ P @ C.T + B @ D.T + K @ S)
        R.append(np.block([[with_outputs, C @ power @ B], [np.zeros((m, p + m))]]))
        power = A @ power
    return np.array(R)


@pytest.mark.parametrize("seed, n, p, m", [(0, 1, 1, 1), (1, 4, 1, 1), (2, 3, 2, 1), (3, 5, 2, 3)])
def test_exact_correlations_give_back_the_innovations_form(seed, n, p, m):
    model = innovations_form(np.random.default_rng(seed), n, p, m)
    A, _, C, _, K, S = model
    R = exact_correlations(model, 80)
    lags = [*R[:0:-1].transpose(0, 2, 1), *R]
    products = np.block([[lags[80 + j - i] for j in range(81)] for i in range(81)])
    predictor = PredictorStates(products, p, m)
    # with fewer states errors are larger, and with more no smaller
    errors = predictor.errors
    np.testing.assert_allclose(errors[n:], np.linalg.slogdet(S)[1], atol=1e-6)
    assert np.all(np.diff(errors[: n + 1]) < 1e-9) and errors[n - 1] > errors[n] + 1e-6
    estimated_A, estimated_C, estimated_K = predictor.model(n)
    poles = (np.sort_complex(np.linalg.eigvals(matrix)) for matrix in (estimated_A, A))
    np.testing.assert_allclose(*poles, atol=1e-5)
    for k in range(6):
        expected = C @ np.linalg.matrix_power(A, k) @ K
        now = estimated_C @ np.linalg.matrix_power(estimated_A, k) @ estimated_K
        np.testing.assert_allclose(now, expected, atol=1e-4)


@pytest.mark.parametrize("lengths, horizon", [([30], 3), ([25, 40], 5), ([12], 1)])
def test_products_of_the_past_are_those_of_all_samples_that_have_one(lengths, horizon):
    rng = np.random.default_rng(0)
    records = [rng.standard_normal((3, T)) + 1.0 for T in lengths]
    pasts = [
        np.concatenate([x[:, horizon - lag : x.shape[1] - lag] for lag in range(horizon + 1)]) for x in records
    ]  # fmt: skip
    expected = sum(past @ past.T for past in pasts) / sum(past.shape[1] for past in pasts)
    np.testing.assert_allclose(products_of_past(records, horizon), expected, atol=1e-12 * np.abs(expected).max())


def frame(shapes, w=(0.5, 1.1, 1.7), zeta=(0.01, 0.012, 0.009)):
    """Modes with real shapes (p, n) in velocities, a force at the first output."""
    n = len(w)
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 1)), np.zeros((len(shapes), 2 * n))
    for k in range(n):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, 1], [-(w[k] ** 2), -2 * zeta[k] * w[k]]]
    B[1::2, 0], C[:, 1::2] = shapes[0], shapes
    return ct.ss(A, B, C, 0)


def answer(plant, u):
    """Outputs (p, T) to a held input, from rest."""
    return ct.forced_response(ct.c2d(plant, STEP), inputs=u).outputs.reshape(plant.noutputs, -1)


@pytest.mark.slow
def test_a_weak_mode_is_found_below_noise_that_sensors_share():
    rng = np.random.default_rng(5)
    shapes = np.array([[1.0, 0.8, 0.2], [0.7, -1.0, -0.2], [-0.9, 0.6, 0.2]])
    u = rng.standard_normal(3000)
    y = answer(frame(shapes), u)
    shared = np.linalg.cholesky(0.05 * np.eye(3) + 0.95)
    y = y + 0.3 * np.sqrt(np.mean(y.var(axis=1))) * shared @ rng.standard_normal(y.shape)
    result = phc.pem((u, y), dt=STEP, quantity="velocity")
    assert result.order == 3 and not len(result.real_poles)
    assert [finding.cause.name for finding in result.findings].count("CORRELATED_NOISE") == 1
    z = (result.natural_frequencies - [0.5, 1.1, 1.7]) / result.stderr["natural_frequencies"]
    assert np.all(np.abs(z) < 4)


def test_slow_noise_of_the_sensor_is_neither_a_mode_nor_a_lag():
    rng = np.random.default_rng(3)
    u = rng.standard_normal(1000)
    y = answer(frame(np.array([[1.0, 0.8]]), (0.5, 1.1), (0.01, 0.012)), u)[0]
    e = lfilter([1.0], [1.0, -0.99], rng.standard_normal(2000))[1000:]
    y = y + 0.4 * np.std(y) * e / np.std(e)
    result = phc.pem((u, y), dt=STEP, quantity="velocity")
    assert result.order == 2 and not len(result.real_poles) and not np.any(result.delay)
    z = (result.natural_frequencies - [0.5, 1.1]) / result.stderr["natural_frequencies"]
    assert np.all(np.abs(z) < 4)


@pytest.mark.slow
def test_the_number_of_real_poles_that_is_given_holds_beside_forces():
    rng = np.random.default_rng(4)
    shapes = np.array([[1.0, 0.8], [0.7, -1.0]])
    plant = frame(shapes, (0.5, 1.1), (0.01, 0.012))
    u, wind = rng.standard_normal((2, 2500))
    y = answer(plant, u) + 0.5 * answer(plant, wind) + 0.02 * rng.standard_normal((2, 2500))
    result = phc.pem((u, y), 2, dt=STEP, quantity="velocity", real_poles=0)
    assert result.order == 2 and not len(result.real_poles)
    assert "FORCES" in {finding.cause.name for finding in result.findings}
    assert np.all(np.abs(result.natural_frequencies - [0.5, 1.1]) < 4 * result.stderr["natural_frequencies"])


def test_a_slow_undamped_motion_is_not_answered_by_forces():
    # a predictor from a short past foretells little of it
    rng = np.random.default_rng(6)
    u = rng.standard_normal(2000)
    plant = frame(np.array([[1.0, 0.5]]), (0.05, 0.19), (0.0, 0.0))
    y = answer(plant, u)[0]
    y = y + 0.05 * np.std(y) * rng.standard_normal(2000)
    result = phc.pem((u, y), dt=STEP)
    assert result.order == 2 and result.fit_percent > 90
    assert "FORCES" not in {finding.cause.name for finding in result.findings}

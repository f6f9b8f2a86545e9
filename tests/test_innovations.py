"""The likelihood of prediction errors against the Kalman filter of the same plant, and its gradient."""

import numpy as np
import pytest
from ambient_plant import ambient, sampled
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from ph_control.identification.innovations.minimum import Experiment, InnovationsModel, Problem, minimise
from ph_control.identification.innovations.subspace import in_sections


def innovations_form(noise=0.2):
    """The steady Kalman filter of the plant: `A`, `C`, gain, covariance of the prediction errors."""
    A, C, Q = sampled()
    R = noise**2 * np.diag(np.diag(C @ solve_discrete_lyapunov(A, Q) @ C.T))
    P = solve_discrete_are(A.T, C.T, Q, R)
    S = C @ P @ C.T + R
    return A, C, np.linalg.solve(S, C @ P @ A.T).T, S


def filtered(y, A, C, K, x):
    """Errors of a predictor that begins in a state, and the state where it ends."""
    errors = np.empty(y.shape)
    for t in range(y.shape[1]):
        errors[:, t] = y[:, t] - C @ x
        x = A @ x + K @ errors[:, t]
    return errors, x


def problem_at_truth(y, real_shapes=False):
    """The plant's own predictor in sections, per sample, and the problem of its likelihood."""
    A, C, K, _ = innovations_form()
    noise = in_sections(A, C, K, 1.0)
    problem = Problem([Experiment.of_outputs(y)], np.zeros((0, 3), bool), real_shapes=real_shapes)
    return problem, noise


def test_prediction_errors_in_bins_are_those_of_the_kalman_filter():
    y = ambient(1, 501)
    A, C, K, S = innovations_form()
    problem, noise = problem_at_truth(y)
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(noise.A)), np.sort_complex(np.linalg.eigvals(A)))
    first = np.random.default_rng(0).standard_normal(6)
    expected, last = filtered(y, noise.A, noise.C, noise.K, first)
    # a record that repeats has the jump of the state where it begins again
    evaluation = problem.at(InnovationsModel(noise, np.zeros((0, 3)), (), (first - last,)))
    errors = np.fft.irfft(evaluation.errors[0], 501) * np.sqrt(501)
    np.testing.assert_allclose(errors, expected, atol=1e-9 * np.abs(expected).max())
    _, size = np.linalg.slogdet(expected @ expected.T / 501)
    np.testing.assert_allclose(evaluation.cost, 501 * (size + 3 * (1 + np.log(2 * np.pi))))
    # and those of the plant's own filter, whatever the coordinates of its states
    own, _ = filtered(y, A, C, K, np.zeros(6))
    again, _ = filtered(y, noise.A, noise.C, noise.K, np.zeros(6))
    np.testing.assert_allclose(again, own, atol=1e-9)
    np.testing.assert_allclose(own @ own.T / 501, S, rtol=0.5, atol=0.2 * np.abs(S).max())


@pytest.mark.parametrize("real_shapes", [False, True])
def test_the_gradient_is_that_of_the_likelihood(real_shapes):
    problem, noise = problem_at_truth(ambient(2, 400), real_shapes)
    noise = noise.of_real_shapes() if real_shapes else noise
    point = InnovationsModel(noise, np.zeros((0, 3)), (), (np.zeros(6),))
    gram, gradient = problem.at(point).normal
    x, differences = problem.vector(point), np.zeros(len(gradient))
    for j in range(len(x)):
        change = np.zeros(len(x))
        change[j] = 1e-6 * max(abs(x[j]), 1e-2)
        up, down = (problem.at(problem.point(x + s * change, point)).cost for s in (1, -1))
        differences[j] = 0.25 * (up - down) / change[j]
    held = np.zeros(len(x), bool)
    if real_shapes:
        held[6:24].reshape(3, 6)[:, 1::2] = True  # what outputs see of the second states
        assert not gradient[held].any() and not gram[held].any()
    lengths = np.sqrt(np.diag(gram))
    np.testing.assert_allclose(gradient[~held] / lengths[~held], differences[~held] / lengths[~held], atol=2e-4)


def test_bases_of_the_states_change_nothing_and_are_no_unknowns():
    y = ambient(3, 600)
    for real_shapes, bases in ((False, 6), (True, 3 + 9)):
        problem, noise = problem_at_truth(y, real_shapes)
        noise = noise.of_real_shapes() if real_shapes else noise
        evaluation = minimise(problem, InnovationsModel(noise, np.zeros((0, 3)), (), (np.zeros(6),))).evaluation
        gram, _ = evaluation.normal
        assert evaluation.bases.shape[1] == bases
        lengths = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        assert np.abs((gram / np.outer(lengths, lengths)) @ (evaluation.bases * lengths[:, None])).max() < 1e-6
        assert evaluation.unknowns == 6 + 36 + 6 - bases + 6

"""The likelihood of prediction errors against the Kalman filter of the same plant, and its gradient."""

from dataclasses import replace

import numpy as np
import pytest
from ambient_plant import ambient, sampled
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov
from scipy.signal import lfilter
from scipy.stats import chi2

import ph_control as phc
from ph_control.identification.innovations import forces
from ph_control.identification.innovations.joint import with_estimated_noise
from ph_control.identification.innovations.minimum import (
    Experiment,
    InnovationsModel,
    LikelihoodEvaluation,
    Problem,
    minimise,
)
from ph_control.identification.innovations.noise_sections import NoiseSections
from ph_control.identification.innovations.set_ups import SetUpsProblem
from ph_control.identification.innovations.subspace import in_sections
from ph_control.identification.regression.sections import Sections


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
    evaluation = problem.evaluated(InnovationsModel(noise, np.zeros((0, 3)), (), (first - last,)))
    errors = np.fft.irfft(evaluation.errors[0], 501) * np.sqrt(501)
    np.testing.assert_allclose(errors, expected, atol=1e-9 * np.abs(expected).max())
    _, size = np.linalg.slogdet(expected @ expected.T / 501)
    np.testing.assert_allclose(evaluation.cost, 501 * (size + 3 * (1 + np.log(2 * np.pi))))
    # and those of the plant's own filter, whatever the coordinates of its states
    own, _ = filtered(y, A, C, K, np.zeros(6))
    again, _ = filtered(y, noise.A, noise.C, noise.K, np.zeros(6))
    np.testing.assert_allclose(again, own, atol=1e-9)
    np.testing.assert_allclose(own @ own.T / 501, S, rtol=0.5, atol=0.2 * np.abs(S).max())


def slopes_by_differences(problem, point):
    """Half the derivatives of the cost by all numbers, which the gradient is, from central differences."""
    x = problem.vector(point)
    differences = np.zeros(len(x))
    for j in range(len(x)):
        change = np.zeros(len(x))
        change[j] = 1e-6 * max(abs(x[j]), 1e-2)
        up, down = (problem.evaluated(problem.point(x + s * change, point)).cost for s in (1, -1))
        differences[j] = 0.25 * (up - down) / change[j]
    return differences


@pytest.mark.parametrize("real_shapes", [False, True])
def test_the_gradient_is_that_of_the_likelihood(real_shapes):
    problem, noise = problem_at_truth(ambient(2, 400), real_shapes)
    noise = noise.of_real_shapes() if real_shapes else noise
    point = InnovationsModel(noise, np.zeros((0, 3)), (), (np.zeros(6),))
    gram, gradient = problem.evaluated(point).normal
    differences = slopes_by_differences(problem, point)
    held = np.zeros(len(gradient), bool)
    if real_shapes:
        held[6:24].reshape(3, 6)[:, 1::2] = True  # what outputs see of the second states
        assert not gradient[held].any() and not gram[held].any()
    lengths = np.sqrt(np.diag(gram))
    np.testing.assert_allclose(gradient[~held] / lengths[~held], differences[~held] / lengths[~held], atol=2e-4)


def test_the_gradient_of_set_ups_is_that_of_the_sum_of_their_likelihoods():
    shapes = np.array([[0.4, 1.0, -0.6], [0.8, 0.3, 1.0], [1.0, -0.9, -0.7], [0.5, 0.2, 0.6]])
    shown = [np.array(rows) for rows in ([0, 1], [0, 2, 3], [0, 1])]
    outputs = [ambient(seed, 150, shapes=shapes)[rows] for seed, rows in enumerate(shown)]
    problem = SetUpsProblem(Problem([Experiment.of_outputs(y) for y in outputs], np.zeros((0, 4), bool)), shown)
    A, C, _ = sampled(shapes)
    alone = in_sections(A, C[:1], 0.05 * np.ones((6, 1)), 1.0)
    begun = problem.extended(alone, np.array([0]))
    rng = np.random.default_rng(1)
    x = problem.vector(begun) + 1e-3 * rng.standard_normal(len(problem.vector(begun)))
    evaluation = problem.evaluated(problem.point(x, begun))
    parts = zip(problem.set_ups, problem.models(evaluation.point), strict=True)
    assert evaluation.cost == sum(each.problem.evaluated(model).cost for each, model in parts)
    assert evaluation.values == 150 * (2 + 3 + 2)
    for k in range(len(x)):
        h = 1e-5 * np.eye(len(x))[k]
        after, before = (problem.evaluated(problem.point(x + s * h, begun)).cost for s in (1, -1))
        assert abs((after - before) / 4e-5 - evaluation.normal[1][k]) < 1e-5 * np.abs(evaluation.normal[1]).max()
    moved = problem.evaluated(problem.point(x + 1e-4 * evaluation.bases @ np.ones(evaluation.bases.shape[1]), begun))
    assert evaluation.bases.shape[1] == 6 and abs(moved.cost - evaluation.cost) < 1e-3


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


def test_a_lag_before_the_noise_colours_the_innovations_and_has_the_gradient_of_the_likelihood():
    y = ambient(2, 400)
    problem, noise = problem_at_truth(y)
    shape, gain, z = np.array([1.0, -0.5, 0.2]), np.array([0.3, 0.1, 0.0]), np.exp(1j * np.array([0.01, 0.5, 3.0]))
    longer = noise.with_lag(0.4, shape, gain)
    before, after = (np.eye(3) + each.outputs_of_states(z) @ each.K for each in (noise, longer))
    colour = np.eye(3) + np.outer(shape, gain) / (z - np.exp(-0.4))[:, None, None]
    np.testing.assert_allclose(after, before @ colour, rtol=1e-9)
    assert longer.unknowns == noise.unknowns + 6
    point = InnovationsModel(longer, np.zeros((0, 3)), (), (np.zeros(7),))
    gram, gradient = problem.evaluated(point).normal
    differences = slopes_by_differences(problem, point)
    lengths = np.sqrt(np.diag(gram))
    np.testing.assert_allclose(gradient / lengths, differences / lengths, atol=2e-4)


def test_a_predictor_that_grows_is_reflected_to_the_noise_of_the_same_spectrum():
    A, C, K, S = innovations_form()
    noise = in_sections(A, C, K, 1.0)
    grown = noise.moved(noise.sections, noise.C, noise.K + 3.0 * np.linalg.pinv(noise.C))
    assert not grown.is_stable
    again = grown.that_forgets(S)
    assert again.is_stable
    z = np.exp(1j * np.linspace(0.05, 3.0, 7))
    before, after = (np.eye(3) + each.outputs_of_states(z) @ each.K for each in (grown, again))
    spectrum = before @ S @ before.conj().transpose(0, 2, 1)
    # of a larger covariance of what cannot be foretold, the same at all frequencies
    inverse = np.linalg.inv(after)
    white = inverse @ spectrum @ inverse.conj().transpose(0, 2, 1)
    np.testing.assert_allclose(white, np.broadcast_to(white[0], white.shape), atol=1e-8 * np.abs(white).max())
    assert noise.that_forgets(S) is noise


def test_a_real_pole_among_modes_keeps_its_place_as_numbers_move():
    sections = Sections.of(np.array([-0.1 + 1j, -0.2, -0.05 + 2j]))
    noise = NoiseSections(sections, 1.0, np.array([1.0, 2.0]), np.ones((1, 5)), np.full((5, 1), 0.1))
    problem = Problem([Experiment.of_outputs(np.ones((1, 50)))], np.ones((6, 1), bool))
    point = InnovationsModel(noise, np.arange(6.0)[:, None])
    again = problem.point(problem.vector(point), point)
    np.testing.assert_allclose(again.poles, [-0.1 + 1j, -0.2, -0.05 + 2j])
    np.testing.assert_array_equal(again.shared, point.shared)


def of_estimated_noise(evaluation, covariance):
    """Kenward and Roger's covariance from matrices of all bins and differences: what it adds, and to what."""
    point, (experiment,), p = evaluation.point, evaluation.problem.experiments, evaluation.p
    noise, width, z = point.noise, point.noise.C.size, experiment.z
    few = len(noise.sections.x)
    lower = np.tril_indices(p)

    def spectrum(theta):
        C, K = theta[:width].reshape(p, -1), theta[width : 2 * width].reshape(-1, p)
        S = np.zeros((p, p))
        S[lower] = theta[2 * width :]
        S = S + np.tril(S, -1).T
        H = np.eye(p) + noise.moved(noise.sections, C, K).outputs_of_states(z) @ K
        return H @ S @ H.conj().transpose(0, 2, 1)

    theta = np.concatenate([noise.C.ravel(), noise.K.ravel(), evaluation.covariance[lower]])
    V = np.linalg.inv(spectrum(theta))
    slopes = []
    for j, value in enumerate(theta):
        change = np.zeros(len(theta))
        change[j] = 1e-6 * max(abs(value), 1e-3)
        slopes.append((spectrum(theta + change) - spectrum(theta - change)) / (2 * change[j]))
    counts = experiment.counts[:, None, None]
    whole = np.array([np.concatenate([(V @ slope * np.sqrt(counts)).ravel()]) for slope in slopes])
    crossed = np.array([(V @ slope * np.sqrt(counts)).transpose(0, 2, 1).ravel() for slope in slopes])
    lengths = np.sqrt(np.sum(np.abs(whole) ** 2, axis=1))
    information = 0.5 * (whole @ crossed.T).real / np.outer(lengths, lengths)
    of_noise = np.linalg.pinv(information, rcond=1e-6, hermitian=True) / np.outer(lengths, lengths)

    x, mean = evaluation.problem.vector(point), []
    plant = np.append(np.arange(few), np.arange(few + 2 * width, len(x)))
    for j in plant:
        change = np.zeros(len(x))
        change[j] = 1e-6 * max(abs(x[j]), 1e-3)
        up, down = (evaluation.problem.evaluated(evaluation.problem.point(x + s * change, point)) for s in (1, -1))
        mean.append((down.disturbances[0] - up.disturbances[0]).T / (2 * change[j]))
    X = np.array(mean).transpose(1, 2, 0)
    Xh, known = X.conj().transpose(0, 2, 1) * counts, covariance[np.ix_(plant, plant)]
    P = [-(Xh @ V @ slope @ V @ X).sum(axis=0).real for slope in slopes]
    added = np.zeros(known.shape)
    for i, j in np.ndindex(of_noise.shape):
        Q = (Xh @ V @ slopes[i] @ V @ slopes[j] @ V @ X).sum(axis=0).real
        added += of_noise[i, j] * (2 * (Q - P[i] @ known @ P[j]) + 0.5 * np.trace(known @ P[i]) * P[j])
    return plant, known, known @ added @ known


@pytest.mark.variants
@pytest.mark.parametrize("outputs", [1, 2])
def test_errors_beside_estimated_noise_are_those_of_the_formula_for_all_bins(outputs, monkeypatch):
    seen = []

    def keep(evaluation, covariance):
        seen.append((evaluation, covariance, with_estimated_noise(evaluation, covariance)))
        return seen[-1][2]

    monkeypatch.setattr("ph_control.identification.innovations.joint.with_estimated_noise", keep)
    rng = np.random.default_rng(outputs)
    u, forces = rng.standard_normal((1, 900)), 0.2 * rng.standard_normal((1, 900))
    motion = lfilter([0, 1, -1], np.poly(np.exp([-0.016 + 0.8j, -0.016 - 0.8j])).real, (u + forces)[0])
    y = np.array([1.0, 0.7])[:outputs, None] * motion
    result = phc.pem((u, y + 0.1 * rng.standard_normal(y.shape)), 1, dt=1.0, real_poles=0, noise="forces", delay=0)
    assert "FORCES" in {finding.cause.name for finding in result.findings}
    evaluation, covariance, changed = seen[-1]
    plant, known, added = of_estimated_noise(evaluation, covariance)
    more = changed[np.ix_(plant, plant)] - known
    # that of poles, per cent of variances; bins without information are left out
    np.testing.assert_allclose(
        np.diag(more)[:2] / np.diag(known)[:2], np.diag(added)[:2] / np.diag(known)[:2], rtol=0.1
    )
    assert np.all(np.diag(more) >= -1e-12 * np.diag(known))
    assert np.all(np.diag(more)[:2] > 0.01 * np.diag(known)[:2])


def test_white_noise_beside_modes_that_last_as_long_as_the_record_has_the_score_of_white_noise(monkeypatch):
    """The motion in which a record begins is fitted, and what it takes from the errors is not told for forces."""
    scores = []

    def scored(evaluation, *, allowing):
        value = score(evaluation, allowing=True)
        scores.append((value, evaluation.point.noise.K.size))
        return value

    score = forces._score
    monkeypatch.setattr(forces, "_score", scored)
    plant = phc.modes([0.3, 1.1], [1.0, 0.6], damping=[0.0013, 0.0005])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(800)
        y = phc.forced_response(plant, np.arange(800.0), u, intersample="zoh").outputs
        phc.pem((u, y + 0.2 * y.std() * rng.standard_normal(800)), 2, dt=1.0, real_poles=0, noise="auto")
    total, count = np.sum(scores, axis=0)
    assert len(scores) > 3 and total < chi2.ppf(0.999, count)


@pytest.mark.parametrize("rates", [(), (0.05,), (0.4,), (3.0,)])
@pytest.mark.parametrize("driven", [0, 1])
def test_a_section_becomes_two_lags_of_the_same_noise(rates, driven):
    """One of its real poles is a lag then; the other makes a section with a first-order section that there is."""
    rng = np.random.default_rng(len(rates) + 2 * driven)
    sections = Sections.from_coordinates(np.array([0.5, 0.3, 0.25 - 0.09, 0.09 + 1.0, *rates]))  # poles 0.2 and 0.8
    states = 5 + len(rates)
    C, K = rng.standard_normal((2, states)), rng.standard_normal((states, 2))
    noise = NoiseSections(sections, 0.5, np.array([0.7, 1.0]), C, K, np.array([0.9]))
    apart = noise.of_two_lags(0, driven)
    z = np.exp(1j * np.linspace(0.01, 3, 50))
    before, after = (each.outputs_of_states(z) @ each.K for each in (noise, apart))
    np.testing.assert_allclose(after, before, rtol=1e-10, atol=1e-12)
    assert apart.lags[0] == pytest.approx([0.8, 0.2][driven])
    real = np.sort(-apart.sections.p[apart.sections.p.imag == 0].real)
    np.testing.assert_allclose(real, np.sort([[0.2, 0.8][driven], *rates]), rtol=1e-9)


def test_noise_through_lags_alone_has_no_state_of_the_plant():
    sections = Sections.from_coordinates(np.array([0.3, 1.09, 0.2]))
    noise = NoiseSections(sections, 0.5, np.ones(1), np.zeros((1, 0)), np.zeros((0, 1)), apart=True)
    noise = noise.with_lag(0.1, np.array([2.0]), np.array([0.3]))
    assert (noise.states, noise.A.shape, len(noise.x)) == (1, (1, 1), 4)
    assert noise.unknowns == 2  # the rate, and what white noise leaves of it
    z = np.exp(1j * np.linspace(0.01, 3, 50))
    np.testing.assert_allclose(
        np.ravel(noise.outputs_of_states(z) @ noise.K), 0.6 / (z - np.exp(-0.05)), rtol=1e-12
    )  # fmt: skip


@pytest.mark.parametrize("through_plant", [False, True])
def test_prediction_errors_beside_inputs_are_those_of_a_filter_whose_lags_begin_anywhere(through_plant, monkeypatch):
    """A sensor that wanders ends elsewhere than it began, which a record that repeats would show as a jump."""
    seen = []

    def keep(evaluation, covariance):
        seen.append(evaluation)
        return with_estimated_noise(evaluation, covariance)

    monkeypatch.setattr("ph_control.identification.innovations.joint.with_estimated_noise", keep)
    rng = np.random.default_rng(1)
    u, forces = rng.standard_normal((1, 600)), 2.0 * through_plant * rng.standard_normal(600)
    a = np.poly(0.9 * np.exp([0.6j, -0.6j])).real if through_plant else [1, -0.9]
    y = lfilter([0, 0.1], a, u[0] + forces)
    y += 0.1 * rng.standard_normal(600) + 0.03 * (1 + 2 * through_plant) * np.cumsum(rng.standard_normal(600))
    numbers = {"order": int(through_plant), "real_poles": int(not through_plant)}
    phc.pem((u, y[None]), dt=1.0, delay=0, quantity="free", intersample="zoh", offset=True, **numbers)
    evaluation = seen[-1]
    problem, point = evaluation.problem, evaluation.point
    noise = point.noise
    assert len(noise.lags) == 1 and noise.apart != through_plant and point.states[0][0] != 0
    known = problem.point(problem.vector(point), point)
    steady = LikelihoodEvaluation(problem, replace(known, states=()))  # as if the lags ended where they began
    disturbance = np.fft.irfft(steady.disturbances[0], 600) * np.sqrt(600)
    ways = [
        filtered(disturbance, noise.A, noise.C, noise.K, x)[0][0]
        for x in (np.zeros(noise.states), *np.eye(noise.states))
    ]
    columns = np.array([way - ways[0] for way in ways[1:]]).T
    first = np.linalg.lstsq(columns, -ways[0], rcond=None)[0]
    errors = np.fft.irfft(evaluation.errors[0], 600)[0] * np.sqrt(600)
    np.testing.assert_allclose(errors, ways[0] + columns @ first, atol=1e-3 * np.std(errors))
    elsewhere = problem.point(
        problem.vector(point) * (1 + 0.05 * rng.standard_normal(len(problem.vector(point)))), point
    )
    expected = slopes_by_differences(problem, elsewhere)
    np.testing.assert_allclose(
        problem.evaluated(elsewhere).normal[1], expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max()
    )

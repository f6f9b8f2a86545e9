"""Variable projection: the inner linear problem, the exact Jacobian, the refinement."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import ph_control as phc
from ph_control.identification.regression.time_rows import RecordRows
from ph_control.identification.regression.variable_projection import Problem, refine
from ph_control.identification.search.steps import TimeSearch
from ph_control.modal.discretization import Hold


def problem_of(d, r, *, samples=400, h=0.1, noise=0.05, sign=1.0, seed=0, method="exact", from_rest=False):
    """A noisy record of a plant; with sign=-1 its last residue is negative, so the constraint must act."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(samples // 2), 2)
    t = h * np.arange(samples)
    parts = [
        phc.forced_response(phc.ph(phc.modes(a, b)), t, u, method=method, intersample="zoh").outputs
        for a, b in zip(d, r, strict=True)
    ]
    y = sum(parts[:-1], 0.0) + sign * parts[-1]
    y = y + noise * np.std(y) * rng.standard_normal(samples)
    return Problem((RecordRows(u, y, np.ones(samples, bool), Hold(h, method), from_rest),))


def dense(problem, d):
    """Columns of the linear problem over the whole record, residues first."""
    (one,) = problem.experiments
    columns = one.sensitivities(d, np.zeros(len(d)), np.zeros(len(d), complex))[:, len(d) :]
    return columns[:, : len(d)] if one.from_rest else columns


@pytest.mark.parametrize("from_rest", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_inner_problem_is_solved_as_a_bounded_least_squares_solver_does(sign, from_rest):
    problem = problem_of([1.0, 2.5, 6.0], [1.0, 0.5, 0.3], sign=sign, from_rest=from_rest)
    d = np.array([1.01, 2.49, 6.0])
    found = problem.project(d)
    columns = dense(problem, d)
    lower = np.where(np.arange(columns.shape[1]) < 3, 0.0, -np.inf)
    expected = lsq_linear(columns, problem.experiments[0].y, (lower, np.inf), tol=1e-14)
    assert np.isclose(found.loss, 2 * expected.cost, rtol=1e-9)
    assert np.allclose(np.concatenate([found.kappa, found.own[0]]), expected.x, rtol=1e-6, atol=1e-9)
    assert (found.kappa >= 0).all() and (found.kappa[2] == 0) == (sign < 0)


@pytest.mark.parametrize("from_rest", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("method", ["exact", "midpoint", "euler"])
def test_gradient_is_the_derivative_of_the_loss(method, sign, from_rest):
    problem = problem_of([0.4, 1.1, 2.0], [1.0, 0.5, 0.3], sign=sign, method=method, h=0.05, from_rest=from_rest)
    d = np.array([0.42, 1.09, 2.03])
    gradient, step = problem.project(d).gradient, 1e-6
    for l in range(3):
        shift = step * np.eye(3)[l]
        difference = (problem.project(d + shift).loss - problem.project(d - shift).loss) / (4 * step)
        assert abs(gradient[l] - difference) <= 1e-6 * np.abs(gradient).max()


def test_jacobian_has_the_gram_matrix_of_the_dense_one():
    problem = problem_of([0.4, 1.1], [1.0, 0.5], noise=0.5)
    d = np.array([0.41, 1.08])
    at = problem.project(d)
    (one,) = problem.experiments
    own = at.own[0]
    J = one.sensitivities(d, at.kappa, own[:2] + 1j * own[2:])
    by_d, inside = J[:, :2], J[:, 2:]
    reduced, known = at.jacobian()
    assert known.all() and len(reduced) < 20
    assert np.allclose(reduced.T @ reduced, J.T @ J, rtol=1e-10, atol=1e-10 * np.abs(J.T @ J).max())
    left = by_d - inside @ np.linalg.lstsq(inside, by_d, rcond=None)[0]
    assert np.allclose(at.gram, left.T @ left, rtol=1e-8)


def test_refinement_reaches_a_stationary_point():
    problem = problem_of([1.0, 2.5], [1.0, 0.5])
    found = refine(problem, np.array([1.02, 2.47]), rtol=1e-14)
    assert found.converged
    at = found.projection
    assert np.abs(at.gradient).max() <= 1e-7 * np.sqrt(np.diag(at.gram).max() * at.loss)


def test_refinement_of_no_modes_is_the_record_itself():
    problem = problem_of([1.0], [1.0])
    found = refine(problem, np.zeros(0), rtol=1e-9)
    y = problem.experiments[0].y
    assert found.converged and found.projection.loss == pytest.approx(y @ y)


def test_missing_samples_do_not_count():
    (full,) = problem_of([1.0, 2.5], [1.0, 0.5]).experiments
    observed = full.observed.copy()
    observed[[3, 50, 51, 200]] = False
    y = np.where(observed, full.y, np.nan)
    gappy = Problem((RecordRows(full.u, y, observed, full.hold),))
    columns = dense(gappy, np.array([1.0, 2.5]))[observed]
    expected = np.linalg.lstsq(columns, y[observed], rcond=None)[1][0]
    assert gappy.project(np.array([1.0, 2.5])).loss == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("samples", [2000, 20_000])
@pytest.mark.parametrize("method, h", [("exact", 0.1), ("midpoint", 0.1), ("euler", 0.005)])
@pytest.mark.parametrize("d", [0.2, 1.37, 9.1])
def test_strongest_mode_is_found_within_a_bin(method, h, d, samples):
    problem = problem_of([d], [1.0], samples=samples, h=h * 2000 / samples, method=method, noise=0.1)
    assert abs(TimeSearch(problem).step(np.zeros(0), 1e-4).candidates[0] - d) <= problem.bin

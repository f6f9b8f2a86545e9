"""Variable projection: the inner linear problem, the exact Jacobian, the refinement."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import ph_control as phc
from ph_control.identification.regressors import Hold
from ph_control.identification.solver import Problem, refine
from ph_control.identification.start import Screen


def problem_of(d, r, *, samples=400, h=0.1, noise=0.05, sign=1.0, seed=0, method="exact", from_rest=False):
    """A noisy record of a plant; with sign=-1 its last residue is negative, so the constraint must act."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(samples // 2), 2)
    t = h * np.arange(samples)
    parts = [
        phc.forced_response(phc.ph(phc.modes(a, b)), t, u, method=method).outputs for a, b in zip(d, r, strict=True)
    ]
    y = sum(parts[:-1], 0.0) + sign * parts[-1]
    y = y + noise * np.std(y) * rng.standard_normal(samples)
    return Problem(u, y, np.ones(samples, bool), Hold(h, method), from_rest)


@pytest.mark.parametrize("from_rest", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_inner_problem_is_solved_as_a_bounded_least_squares_solver_does(sign, from_rest):
    problem = problem_of([1.0, 2.5, 6.0], [1.0, 0.5, 0.3], sign=sign, from_rest=from_rest)
    d = np.array([1.01, 2.49, 6.0])
    found = problem.project(d)
    columns = found.regressors.columns()[:, : 3 if from_rest else 9]
    lower = np.where(np.arange(columns.shape[1]) < 3, 0.0, -np.inf)
    expected = lsq_linear(columns, problem.y, (lower, np.inf), tol=1e-14)
    assert np.isclose(found.loss, 2 * expected.cost, rtol=1e-9)
    assert (found.coefficients[:3] >= 0).all()
    assert (found.coefficients[2] == 0) == (sign < 0)


@pytest.mark.parametrize("from_rest", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("method", ["exact", "midpoint", "euler"])
def test_jacobian_is_the_derivative_of_the_residual(method, sign, from_rest):
    problem = problem_of([0.4, 1.1, 2.0], [1.0, 0.5, 0.3], sign=sign, method=method, h=0.05, from_rest=from_rest)
    d = np.array([0.42, 1.09, 2.03])
    J = problem.project(d).jacobian()
    step = 1e-6
    for l in range(3):
        shift = step * np.eye(3)[l]
        difference = (problem.project(d + shift).residual - problem.project(d - shift).residual) / (2 * step)
        assert np.abs(J[:, l] - difference).max() <= 1e-6 * np.abs(J).max()


def test_jacobian_without_the_turning_of_the_projector_would_be_noticed():
    problem = problem_of([0.4, 1.1], [1.0, 0.5], noise=0.5)
    at = problem.project(np.array([0.45, 1.0]))
    basis = at._solution[1]
    short = -(at.sensitivity - basis @ (basis.T @ at.sensitivity))
    assert np.abs(at.jacobian() - short).max() > 1e-3 * np.abs(short).max()


def test_refinement_reaches_a_stationary_point():
    problem = problem_of([1.0, 2.5], [1.0, 0.5])
    found = refine(problem, np.array([1.02, 2.47]), rtol=1e-14)
    assert found.converged
    at = found.projection
    gradient = at.jacobian().T @ at.residual
    assert np.abs(gradient).max() <= 1e-7 * np.linalg.norm(at.jacobian(), axis=0).max() * np.sqrt(at.loss)


def test_refinement_of_no_modes_is_the_record_itself():
    problem = problem_of([1.0], [1.0])
    found = refine(problem, np.zeros(0), rtol=1e-9)
    assert found.converged and found.projection.loss == pytest.approx(problem.y @ problem.y)


def test_missing_samples_do_not_count():
    full = problem_of([1.0, 2.5], [1.0, 0.5])
    observed = full.observed.copy()
    observed[[3, 50, 51, 200]] = False
    y = np.where(observed, full.y, np.nan)
    gappy = Problem(full.u, y, observed, full.hold).project(np.array([1.0, 2.5]))
    columns = gappy.regressors.columns()[observed]
    expected = np.linalg.lstsq(columns, y[observed], rcond=None)[1][0]
    assert gappy.loss == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("method, h", [("exact", 0.1), ("midpoint", 0.1), ("euler", 0.005)])
@pytest.mark.parametrize("d", [0.2, 1.37, 9.1])
def test_strongest_mode_is_found_within_a_bin(method, h, d):
    problem = problem_of([d], [1.0], samples=2000, h=h, method=method, noise=0.1)
    assert abs(Screen(problem).strongest(problem.y) - d) <= problem.bin

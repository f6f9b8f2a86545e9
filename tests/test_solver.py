"""Variable projection: the inner linear problem, the exact Jacobian, the refinement, weights that must not be < 0."""

from types import SimpleNamespace

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

import ph_control as phc
from ph_control.identification.regression.free import FreeProblem, FreeProjection, refine_free
from ph_control.identification.regression.sections import PoleRegion, Sections
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.identification.regression.variable_projection import refine
from ph_control.identification.search.free_search import Records
from ph_control.identification.structure.constrained import constrained
from ph_control.identification.structure.coordinates import ChannelLayout
from ph_control.modal.discretization import Hold

POLES = np.array([-0.01 + 0.42j, 1.09j, -0.08 + 2.03j])


def record_of(d, r, *, samples=400, h=0.1, noise=0.05, sign=1.0, seed=0, method="exact", moving=True):
    """A noisy record of a plant; with sign=-1 its last residue is negative, so that a weight has to be 0."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(samples // 2), 2)
    t = h * np.arange(samples)
    parts = [
        phc.forced_response(phc.ph(phc.modes(a, b)), t, u, method=method, intersample="zoh").outputs
        for a, b in zip(d, r, strict=True)
    ]
    y = sum(parts[:-1], 0.0) + sign * parts[-1]
    y = y + noise * np.std(y) * rng.standard_normal(samples)
    return FreeRecord(u[None], y[None], np.ones(samples, bool), Hold(h, method), moving, through=False)


def region_of(record):
    return PoleRegion(record.bin, record.ceiling)


def dense(record, p):
    """Columns of motions and residues over the whole record, and their derivatives by the real axis."""
    whole = FreeRecord(record.u, record.u, np.ones(record.length, bool), record.hold, record.moving, through=False)
    rows = np.concatenate(list(whole.evaluated(p).blocks()), axis=1)[:-1].T
    return np.split(rows, 2, axis=1)


@pytest.mark.parametrize("moving", [False, True])
def test_inner_problem_is_solved_as_a_least_squares_solver_does(moving):
    record = record_of([0.4, 1.1, 2.0], [1.0, 0.5, 0.3], moving=moving)
    found = FreeProjection([record], POLES)
    columns, _ = dense(record, POLES)
    x, (loss,), *_ = np.linalg.lstsq(columns, record.y[0])
    assert np.isclose(found.loss, loss, rtol=1e-9)
    assert np.allclose(np.concatenate([found.own[0], found.shared])[:, 0], x, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_weights_are_those_of_a_bounded_least_squares_solver(sign):
    record = record_of([1.0, 2.5, 6.0], [1.0, 0.5, 0.3], sign=sign)
    at = refine_free(lambda _: [record], np.array([1.0j, 2.5j, 6.0j]), region_of(record))
    fit = constrained(at, ChannelLayout(1, 1, np.ones(1), ("velocity",), ((0, 0),)), "lossless", region_of(record))
    assert np.all(fit.p.real == 0) and fit.converged
    columns, _ = dense(record, fit.p)
    # no motion is bounded, and of residues only real parts are free
    real = columns[:, np.r_[: len(fit.p) * 3]]
    lower = np.where(np.arange(real.shape[1]) < 2 * len(fit.p), -np.inf, 0.0)
    expected = lsq_linear(real, record.y[0], (lower, np.inf), tol=1e-14)
    assert np.isclose(fit.loss, 2 * expected.cost, rtol=1e-9)
    residues = fit.residues[:, 0, 0]
    assert np.all(residues.imag == 0) and np.all(residues.real >= 0)
    assert np.allclose(residues.real, expected.x[2 * len(fit.p) :], rtol=1e-6, atol=1e-9)
    assert (residues[np.argmax(fit.p.imag)] == 0) == (sign < 0)


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("method", ["exact", "midpoint", "euler"])
def test_gradient_is_the_derivative_of_the_loss(method, moving):
    record = record_of([0.4, 1.1, 2.0], [1.0, 0.5, 0.3], method=method, h=0.05, moving=moving)
    problem, x = FreeProblem([record], region_of(record)), FreeProjection([record], POLES).x
    gradient, step = problem.project(x).gradient, 1e-6
    for l in range(len(x)):
        shift = step * np.eye(len(x))[l]
        difference = (problem.project(x + shift).loss - problem.project(x - shift).loss) / (4 * step)
        assert abs(gradient[l] - difference) <= 1e-6 * np.abs(gradient).max()


def test_covariance_is_the_inverse_of_the_dense_gram_matrix():
    record = record_of([0.4, 1.1], [1.0, 0.5], noise=0.5)
    at = FreeProjection([record], POLES[:2])
    (inside, slopes), n = dense(record, POLES[:2]), 2
    # of a coefficient a + i b, by the real and by the imaginary part of the pole
    by_real, by_imaginary = 0.0, 0.0
    for k, (a, b) in enumerate([np.split(at.own[0][:, 0], 2), np.split(at.shared[:, 0], 2)]):
        first, second = slopes[:, 2 * k * n :][:, :n], slopes[:, (2 * k + 1) * n :][:, :n]
        by_real, by_imaginary = by_real + first * a + second * b, by_imaginary + second * a - first * b
    J = np.concatenate([by_imaginary, by_real, inside[:, 2 * n :], inside[:, : 2 * n]], axis=1)
    expected = np.linalg.inv(J.T @ J)[: 4 * n, : 4 * n]
    found = at.covariance(1.0)
    assert np.allclose(found, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    # by the coordinates, all linear unknowns moving along
    left = J[:, : 2 * n] - inside @ np.linalg.lstsq(inside, J[:, : 2 * n])[0]
    reduced = left @ at.sections.pole_slopes
    assert np.allclose(at.gram, reduced.T @ reduced, rtol=1e-8)


def test_refinement_reaches_a_stationary_point():
    record = record_of([1.0, 2.5], [1.0, 0.5])
    start = FreeProjection([record], np.array([-0.01 + 1.02j, -0.01 + 2.47j])).x
    found = refine(FreeProblem([record], region_of(record)), start, rtol=1e-14)
    assert found.converged
    at = found.projection
    assert np.abs(at.gradient).max() <= 1e-7 * np.sqrt(np.diag(at.gram).max() * at.loss)


def test_refinement_of_no_modes_is_the_record_itself():
    record = record_of([1.0], [1.0])
    found = refine(FreeProblem([record], region_of(record)), np.zeros(0), rtol=1e-9)
    assert found.converged and found.projection.loss == pytest.approx(np.sum(record.y**2))


def test_missing_samples_do_not_count():
    full, p = record_of([1.0, 2.5], [1.0, 0.5]), np.array([-0.01 + 1.0j, 2.5j])
    observed = full.observed.copy()
    observed[[3, 50, 51, 200]] = False
    y = np.where(observed, full.y, np.nan)
    gappy = FreeRecord(full.u, y, observed, full.hold, through=False)
    columns, _ = dense(gappy, p)
    expected = np.linalg.lstsq(columns[observed], y[0, observed])[1][0]
    assert FreeProjection([gappy], p).loss == pytest.approx(expected, rel=1e-12)


@pytest.mark.variants
@pytest.mark.parametrize("samples", [2000, 20_000])
@pytest.mark.parametrize("method, h", [("exact", 0.1), ("midpoint", 0.1), ("euler", 0.005)])
@pytest.mark.parametrize("d", [0.2, 1.37, 9.1])
def test_strongest_mode_is_found_within_a_bin(method, h, d, samples):
    record = record_of([d], [1.0], samples=samples, h=h * 2000 / samples, method=method, noise=0.1)
    search = Records([record])
    poles, _ = search.candidates(SimpleNamespace(residuals=[spectrum.Y for spectrum in search.spectra]))
    assert abs(poles[0].imag - d) <= record.bin


POLE_PAIRS = [
    [-0.02 + 1.1j], [-1.0, -1e-9], [-3.0, 1e-7], [-2.0 + 1e-3j], [-2.0, -2.0 - 1e-3], [0.3, -1e-5, -50.0],
    [-1e4, 0.0, -0.2 + 3j],
]  # fmt: skip


@pytest.mark.parametrize("poles", POLE_PAIRS)
def test_poles_come_back_from_the_coordinates_of_their_sections(poles):
    """Slow poles beside fast ones keep their digits: from their product, not from a difference."""
    p = np.array(poles, complex)
    again = np.sort_complex(Sections.from_coordinates(Sections.of(p).x).p)
    assert np.all(np.abs(again - np.sort_complex(p)) <= 1e-7 * np.abs(np.sort_complex(p)))


@pytest.mark.parametrize("poles", POLE_PAIRS)
def test_poles_move_with_the_coordinates_as_their_derivatives_say(poles):
    """Against differences of poles from the roots of the polynomials of the sections in many digits."""
    sections = Sections.of(np.array(poles, complex))
    slopes, x = sections.pole_slopes, sections.x
    for k in range(len(x)):
        with mp.workdps(60):
            ends = []
            for sign in (-1, 1):
                moved = [mp.mpf(float(value)) for value in x]
                moved[k] += sign * mp.mpf(10) ** -25
                ends.append(exact_poles(moved, sections))
            change = [(after - before) / (2 * mp.mpf(10) ** -25) for before, after in zip(*ends, strict=True)]
        n = len(change)
        assert_allclose(slopes[:n, k], [float(each.imag) for each in change], rtol=1e-6, atol=1e-9)
        assert_allclose(slopes[n:, k], [float(each.real) for each in change], rtol=1e-6, atol=1e-9)


def exact_poles(x, sections):
    """Poles of sections with coordinates in many digits, at their places."""
    count = len(sections.decay)
    poles = [mp.mpc(0)] * len(sections.p)
    for k, (slow, fast) in enumerate(sections.places.tolist()):
        decay, product = x[k], x[count + k]
        root = mp.sqrt(mp.mpc(decay**2 - product))
        poles[slow], poles[fast] = -decay + root, -decay - root
        if slow == fast:
            poles[slow] = mp.mpc(-decay, abs(root.imag))
    for place, rate in zip(sections.single.tolist(), x[2 * count :], strict=True):
        poles[place] = mp.mpc(-rate)
    return poles


def test_a_search_for_a_fast_pole_beside_an_integrator_ends_soon():
    """Data that show an integrator to many digits leave a straight valley for the lag beside it."""
    rng, h, samples = np.random.default_rng(3), 0.1, 2000
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 40), 40)
    x, y = 0.0, np.zeros(samples)
    for k in range(1, samples):
        x += h * u[k - 1]
        y[k] = x
    lag = lfilter([0.0, 1 - np.exp(-0.3 * h)], [1.0, -np.exp(-0.3 * h)], u)
    y += 0.2 * lag + 0.3 * rng.standard_normal(samples)
    record = FreeRecord(u[None], y[None], np.ones(samples, bool), Hold(h), False, through=False)
    end = refine(
        FreeProblem([record], region_of(record)), Sections.of(np.array([-1e-6, -2.0])).x, rtol=1e-8, last=False
    )
    assert end.converged
    assert end.iterations < 20

"""Structures of fits: minima against a dense least-squares problem over all unknowns, covariance, tests, the choice."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scripts import ROOT

from ph_control.identification.regression.free import FreeProjection, PoleRegion, refine_free
from ph_control.identification.regression.frequency_rows import FreeResponse
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.identification.structure.constrained import ConstrainedProblem, constrained, coordinates_of
from ph_control.identification.structure.hypothesis_tests import choose, structure_tests
from ph_control.identification.structure.layout import POWERS, ChannelLayout
from ph_control.modal.discretization import Hold

sys.path.insert(0, str(ROOT))  # the benchmarks are not installed with the package

from benchmarks import structure_tests as study

SAMPLES = 400
P = np.array([-0.008 + 0.6j, -0.02 + 1.5j])
REGION = PoleRegion(2 * np.pi / SAMPLES, np.pi)
PORTS = ((0, 0), (1, 1))


def factor(p, quantities):
    """`p**k / (2j Im p)`, shape (n, outputs, 1)."""
    powers = np.array([POWERS[one] for one in quantities])
    return (p[:, None] ** powers / (2j * p.imag[:, None]))[:, :, None]


def columns(p, u):
    """Response of `1 / (s - p)` to each held input, (n, inputs, T), and the free motion, (n, T)."""
    forced = [[lfilter([0.0, np.expm1(one) / one], [1.0, -np.exp(one)], each + 0j) for each in u] for one in p]
    return np.array(forced), np.exp(np.outer(p, np.arange(u.shape[1])))


def output(p, residues, through, motion, u):
    """`2 Re` of all modes, what is fed through, and free motions (n, outputs)."""
    forced, free = columns(p, u)
    return 2 * (np.einsum("loi,lit->ot", residues, forced) + np.einsum("lo,lt->ot", motion, free)).real + through @ u


QUANTITIES = ("velocity", "displacement", "acceleration")
TRUE = {
    "lossless": (1j * P.imag, np.array([[0.9, -0.6, 0.4], [0.5, 0.8, -0.7]])),
    "classical": (P, np.array([[0.9, -0.6, 0.4], [0.5, 0.8, -0.7]])),
    "rank one": (P, np.array([[0.9 + 0.3j, -0.6, 0.4], [0.5, 0.8 - 0.5j, -0.7j]])),
    "reciprocal": (P, np.array([[0.9 + 0.3j, -0.6, 0.4], [0.5, 0.8 - 0.5j, -0.7j]])),
}


def plant(kind, rng):
    """Poles, residues and feedthrough of a plant with this structure: two ports and one more sensor."""
    p, x = TRUE[kind]
    matrices = x[:, :, None] * x[:, None, :2]
    if kind == "rank one":
        matrices = x[:, :, None] * np.array([[0.7, 0.2j], [-0.4, 1.0]])[:, None]
    if kind == "reciprocal":
        more = rng.standard_normal((2, 3, 2)) + 1j * rng.standard_normal((2, 3, 2))
        more[:, 0, 1] = more[:, 1, 0]
        matrices = matrices + more
    return p, factor(p, QUANTITIES) * matrices, rng.standard_normal((3, 2))


def recorded(kind, seed=0, noise=0.3):
    rng = np.random.default_rng(seed)
    p, residues, through = plant(kind, np.random.default_rng(100))
    u = rng.standard_normal((2, SAMPLES))
    motion = rng.standard_normal((2, 3)) + 1j * rng.standard_normal((2, 3))
    clean = output(p, residues, through, motion, u)
    size = noise * np.std(clean, axis=1, keepdims=True)
    return u, clean + size * rng.standard_normal(clean.shape), size[:, 0]


def free_fit(kind, seed=0, gaps=False):
    u, y, scales = recorded(kind, seed)
    observed = np.ones(y.shape, bool)
    if gaps:
        observed[1:] = np.random.default_rng(9).random((2, SAMPLES)) > 0.2
    rows = FreeRecord.by_observation(u, y / scales[:, None], observed, Hold(1.0))
    at = refine_free(lambda _: rows, P.copy(), REGION, 1e-12)
    return u, y, observed, at, ChannelLayout(3, 2, scales, QUANTITIES, PORTS)


def dense_minimum(kind, u, y, observed, scales, start):
    """Least squares over poles, shapes or matrices, feedthrough and free motions, by differences."""

    def model(x):
        parts = np.split(x, np.cumsum([2, 2 * (kind != "lossless"), 6, 12]))
        p = 1j * parts[0] + (parts[1] if kind != "lossless" else 0.0)
        motion = (parts[3][:6] + 1j * parts[3][6:]).reshape(2, 3)
        if kind in ("lossless", "classical"):
            shapes = parts[4].reshape(2, 3)
            matrices = shapes[:, :, None] * shapes[:, None, :2]
        elif kind == "rank one":
            c = (parts[4][:6] + 1j * parts[4][6:12]).reshape(2, 3)
            b = (parts[4][12:14] + 1j * parts[4][14:]).reshape(2, 1)
            matrices = c[:, :, None] * np.concatenate([np.ones((2, 1)), b], axis=1)[:, None]
        else:
            each = (parts[4][:10] + 1j * parts[4][10:]).reshape(2, 5)
            matrices = each[:, [[0, 1], [1, 2], [3, 4]]]
        return p, factor(p, QUANTITIES) * matrices, parts[2].reshape(3, 2), motion

    def left(x):
        p, residues, through, motion = model(x)
        return ((output(p, residues, through, motion, u) - y) / scales[:, None])[observed]

    end = least_squares(left, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    return 2 * end.cost, model(end.x), end.jac


def dense_start(kind, fit):
    """The model of a fit in the unknowns of `dense_minimum`, without its free motions."""
    matrices = fit.residues / factor(fit.p, QUANTITIES)
    if kind in ("lossless", "classical"):
        shapes = [fit.shapes.ravel()]
    elif kind == "rank one":
        c, b = matrices[:, :, 0], matrices[:, 0, 1] / matrices[:, 0, 0]
        shapes = [c.real.ravel(), c.imag.ravel(), b.real, b.imag]
    else:
        each = matrices[:, [0, 0, 1, 2, 2], [0, 1, 1, 0, 1]]
        shapes = [each.real.ravel(), each.imag.ravel()]
    decay = [] if kind == "lossless" else [fit.p.real]
    return np.concatenate([fit.p.imag, *decay, fit.feedthrough.ravel(), np.zeros(12), *shapes])


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("kind", ["lossless", "classical", "rank one", "reciprocal"])
def test_minimum_is_that_of_all_unknowns_together(kind, gaps):
    u, y, observed, at, layout = free_fit(kind, gaps=gaps)
    fit = constrained(at, layout, kind, REGION)
    nudged = dense_start(kind, fit) * (1 + 1e-3 * np.random.default_rng(1).standard_normal(1))
    loss, (p, residues, through, _), J = dense_minimum(kind, u, y, observed, layout.scales, nudged)
    assert fit.loss > at.loss
    assert np.isclose(fit.loss, loss, rtol=1e-9)
    assert np.allclose(fit.p, p, rtol=0, atol=1e-5)
    assert np.allclose(fit.residues, residues, rtol=0, atol=1e-4)
    assert np.allclose(fit.feedthrough, through, rtol=0, atol=1e-4)
    # poles first in both, frequencies before growth
    count = 2 if kind == "lossless" else 4
    variance = at.loss / (at.rows - at.unknowns)
    errors = np.sqrt(np.diag(variance * np.linalg.pinv(J.T @ J))[:count])
    assert np.allclose(np.sqrt(np.diag(fit.covariance)[:count]), errors, rtol=1e-3)
    assert fit.parameters == J.shape[1] - 12


@pytest.mark.parametrize("kind", ["lossless", "classical", "rank one", "reciprocal"])
def test_gradient_and_derivatives_are_those_of_differences(kind):
    *_, at, layout = free_fit(kind)
    of = coordinates_of(at, layout, kind)
    x = of.start(at.p, *layout.split(at.shared, 2)) * 1.01
    problem = ConstrainedProblem(of, at, REGION, np.ones(of.size, bool))
    nudge = 1e-6 * np.eye(of.size)
    differences = [(problem.project(x + one).loss - problem.project(x - one).loss) / 2e-6 for one in nudge]
    assert np.allclose(2 * problem.project(x).gradient, differences, rtol=1e-5, atol=1e-6 * np.abs(differences).max())
    for output in range(3):

        def shared(x, output=output):
            _, residues, through = of.model(x)
            return layout.joined(residues, through, True)[:, output]

        differences = np.transpose([(shared(x + one) - shared(x - one)) / 2e-6 for one in nudge])
        found = of.derivatives(x, output, True) / layout.scales[output]
        assert np.allclose(found, differences, rtol=1e-6, atol=1e-6 * np.abs(differences).max())


def entries(shapes, p, ports=(), seed=0):
    """Free fit of a matrix of receptances, each entry with its own lines, and its layout."""
    rng, omega = np.random.default_rng(seed), np.linspace(0.3, 2.0, 300)
    matrices = factor(p, ["displacement"] * shapes.shape[1]) * shapes[:, :, None] * shapes[:, None, :2]
    rows, scales = [], 0.3 * np.ones(2 * shapes.shape[1])
    for k in range(2 * shapes.shape[1]):
        kept = np.sort(rng.choice(300, 280, replace=False))
        rho, s = matrices[:, k // 2, k % 2, None], 1j * omega[kept]
        response = np.sum(rho / (s - p[:, None]) + rho.conj() / (s - p.conj()[:, None]), axis=0)
        response += scales[k] * (rng.standard_normal(280) + 1j * rng.standard_normal(280))
        measured = omega[kept], response[None] / scales[k], np.ones(280), np.ones(280, bool)
        rows.append(FreeResponse(*measured, "displacement", np.array([k])))
    at = refine_free(lambda _: rows, p.copy(), PoleRegion(0.006, 2.0), 1e-12)
    return at, ChannelLayout(shapes.shape[1], 2, scales, ("displacement",) * shapes.shape[1], ports, True), matrices


def test_entries_of_a_response_matrix_share_shapes():
    shapes = TRUE["classical"][1]
    at, layout, truth = entries(shapes, P, PORTS)
    found = structure_tests(at, layout, PoleRegion(0.006, 2.0))
    # 4 + 24 unknowns of the free model; poles and 2 x 3 shapes, 2 x 3 complex ones and participations less a scale
    assert {one.hypothesis: one.dof for one in found.tests} == {
        "lossless": 28 - 8, "classical": 28 - 10, "rank one": 28 - 4 - 16, "reciprocal": 4,
    }  # fmt: skip
    assert not found.stands("lossless")
    assert all(found.stands(one, 0.01) for one in ("classical", "rank one", "reciprocal"))
    fit = choose(found, 0.01)
    assert fit.structure == "classical" and np.array_equal(fit.shapes[:, :2], fit.participation)
    signs = np.sign(np.sum(fit.shapes * shapes, axis=1))[:, None]
    assert np.allclose(fit.shapes * signs, shapes, rtol=0, atol=0.02)

    def errors(covariance):
        count = covariance[4:, 4:].shape[0]
        return np.sqrt(np.diag(covariance)[-count:])

    # fewer unknowns: no error grows, and those of residues shrink
    wide, narrow = (errors(found.fits[one].covariance) for one in ("free", "classical"))
    assert np.all(narrow < 1.02 * wide) and np.median(narrow / wide) < 0.8
    assert np.linalg.norm(fit.residues - truth) < np.linalg.norm(found.fits["free"].residues - truth)


def test_of_a_port_with_a_negative_weight_no_classical_model_is_left():
    shapes = np.array([[0.9, 0.5], [0.6, -0.8]])
    crossed, layout, _ = entries(shapes, P)
    assert structure_tests(crossed, layout, PoleRegion(0.006, 2.0)).stands("classical", 0.01)
    # output 0 is not at input 1
    wrong = ChannelLayout(2, 2, layout.scales, layout.quantities, ((0, 1),), True)
    assert not structure_tests(crossed, wrong, PoleRegion(0.006, 2.0)).stands("classical", 0.01)


def free_motion(p, amplitudes, noise, seed=3):
    rng = np.random.default_rng(seed)
    y = 2 * (amplitudes.T @ np.exp(np.outer(p, np.arange(SAMPLES)))).real + noise * rng.standard_normal((2, SAMPLES))
    rows = [FreeRecord(np.zeros((1, SAMPLES)), y / noise, np.ones(SAMPLES, bool), Hold(1.0), driven=False,
                       outputs=np.arange(2))]  # fmt: skip
    at = refine_free(lambda _: rows, p.copy(), REGION, 1e-12)
    return at, ChannelLayout(2, 0, np.full(2, noise), ("displacement",) * 2)


def test_free_motion_is_tested_for_damping_alone():
    amplitudes = np.array([[1.0, 0.3j], [0.5, -0.4]])
    decaying = structure_tests(*free_motion(P, amplitudes, 0.1), REGION)
    assert [(one.hypothesis, one.dof) for one in decaying.tests] == [("lossless", 2)]
    assert decaying.tests[0].p < 1e-6 and choose(decaying).hypothesis == "free"
    still = structure_tests(*free_motion(1j * P.imag, amplitudes, 0.1), REGION)
    assert still.tests[0].p > 0.01 and choose(still).structure == "lossless"


def test_a_mode_that_no_input_drives_and_a_double_pole_are_borne():
    u, y, scales = recorded("classical")
    rows = FreeRecord.by_observation(u, y / scales[:, None], np.ones(y.shape, bool), Hold(1.0))
    layout = ChannelLayout(3, 2, scales, QUANTITIES, PORTS)
    for p in (np.append(P, -1e-3 + 2.7j), P[[0, 0, 1]] * np.array([1, 1 + 1e-9, 1])):
        at = FreeProjection(rows, p)
        found = structure_tests(at, layout, REGION)
        assert len(found.tests) == 4 and all(0 <= one.p <= 1 for one in found.tests)
        assert all(np.isfinite(one.covariance).all() for one in found.fits.values())


def test_exact_data_stand_on_rounding():
    p, shapes = study.chain(2, np.zeros(2))
    residues = study.velocities(p, (shapes[:, :1] * shapes[:, :1])[:, :, None])
    u = np.random.default_rng(0).standard_normal((1, 500))
    y = output(p, residues, np.zeros((1, 1)), np.zeros((2, 1)), u)
    rows = [FreeRecord(u, y, np.ones(500, bool), Hold(1.0), through=False)]
    at = refine_free(lambda _: rows, p * (1 + 1e-4), PoleRegion(2 * np.pi / 500, np.pi), 1e-12)
    layout = ChannelLayout(1, 1, np.ones(1), ("velocity",), ((0, 0),))
    fit = choose(structure_tests(at, layout, PoleRegion(2 * np.pi / 500, np.pi)))
    assert fit.structure == "lossless" and np.allclose(fit.p, p, rtol=1e-10)


@pytest.mark.parametrize("kind", ["lossless", "lightly damped", "sensor beside", "gyroscope"])
def test_true_structures_stand_and_false_ones_are_found(kind):
    """Seeded, at 20 dB: chance rejects what is true in more than 4 of 20 once in 400 times; all find what is false."""
    true, false = study.CASES[kind]
    found = study.shares(kind, 8 if kind == "gyroscope" else 20)
    assert all(found[one] <= 0.2 for one in true) and all(found[one] == 1 for one in false)

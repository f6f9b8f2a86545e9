"""Structures of fits: minima against a dense least-squares problem over all unknowns, covariance, tests, the choice."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from ph_control.identification.regression.free import PoleRegion, refine_free
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.identification.structure.constrained import constrained
from ph_control.identification.structure.layout import POWERS, ChannelLayout
from ph_control.modal.discretization import Hold

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
    from ph_control.identification.structure.constrained import ConstrainedProblem, coordinates_of

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

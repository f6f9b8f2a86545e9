"""Structures of fits: minima against a dense least-squares problem over all unknowns, covariance, tests, the choice."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
import structure_plants
from scipy.optimize import least_squares, minimize
from scipy.signal import lfilter

import ph_control as phc
from ph_control._units import DERIVATIVES
from ph_control.identification.regression.free import FreeProjection, refine_free
from ph_control.identification.regression.frequency_rows import FreeResponse
from ph_control.identification.regression.sections import PoleRegion
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.identification.structure.constrained import ConstrainedProblem, constrained, coordinates_of
from ph_control.identification.structure.coordinates import ChannelLayout
from ph_control.identification.structure.hypothesis_tests import choose, structure_tests
from ph_control.modal.discretization import Hold
from ph_control.modal.general_form import real_matrices

SAMPLES = 400
P = np.array([-0.008 + 0.6j, -0.02 + 1.5j])
REGION = PoleRegion(2 * np.pi / SAMPLES, np.pi)
PORTS = ((0, 0), (1, 1))


def factor(p, quantities):
    """`p**k / (2j Im p)`, shape (n, outputs, 1)."""
    powers = np.array([DERIVATIVES[one] for one in quantities])
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
# without losses nothing is fed through but to an accelerometer
FELT = {"lossless": np.array([[0.0], [0.0], [1.0]])}
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
    return p, factor(p, QUANTITIES) * matrices, FELT.get(kind, 1.0) * rng.standard_normal((3, 2))


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
        return p, factor(p, QUANTITIES) * matrices, FELT.get(kind, 1.0) * parts[2].reshape(3, 2), motion

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


@pytest.mark.variants
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
    assert fit.parameters == np.count_nonzero(np.any(J, axis=0)) - 12


@pytest.mark.variants
@pytest.mark.parametrize("kind", ["lossless", "classical", "rank one", "reciprocal"])
def test_gradient_and_derivatives_are_those_of_differences(kind):
    *_, at, layout = free_fit(kind)
    of = coordinates_of(at, layout, kind)
    x = of.start(*layout.split(at.shared, 2)) * 1.01
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
    assert {one.hypothesis: one.dof for one in found.tests if one.hypothesis != "passive"} == {
        "lossless": 28 - 8, "classical": 28 - 10, "rank one": 28 - 4 - 16, "reciprocal": 4,
    }  # fmt: skip
    assert not found.stands("lossless")
    assert all(found.stands(one, 0.01) for one in ("classical", "passive", "rank one", "reciprocal"))
    fit = choose(found, PoleRegion(0.006, 2.0), 0.01)
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
    assert decaying.tests[0].p < 1e-6 and choose(decaying, REGION).hypothesis == "free"
    still = structure_tests(*free_motion(1j * P.imag, amplitudes, 0.1), REGION)
    assert still.tests[0].p > 0.01 and choose(still, REGION).structure == "lossless"


@pytest.mark.slow
def test_a_mode_that_no_input_drives_and_a_double_pole_are_borne():
    u, y, scales = recorded("classical")
    rows = FreeRecord.by_observation(u, y / scales[:, None], np.ones(y.shape, bool), Hold(1.0))
    layout = ChannelLayout(3, 2, scales, QUANTITIES, PORTS)
    for p in (np.append(P, -1e-3 + 2.7j), P[[0, 0, 1]] * np.array([1, 1 + 1e-9, 1])):
        at = FreeProjection(rows, p)
        found = structure_tests(at, layout, REGION)
        assert len(found.tests) == 5 and all(0 <= one.p <= 1 for one in found.tests)
        assert all(np.isfinite(one.covariance).all() for one in found.fits.values())


def test_exact_data_stand_on_rounding():
    p, shapes = structure_plants.chain(2, np.zeros(2))
    residues = structure_plants.velocities(p, (shapes[:, :1] * shapes[:, :1])[:, :, None])
    u = np.random.default_rng(0).standard_normal((1, 500))
    y = output(p, residues, np.zeros((1, 1)), np.zeros((2, 1)), u)
    rows = [FreeRecord(u, y, np.ones(500, bool), Hold(1.0), through=False)]
    at = refine_free(lambda _: rows, p * (1 + 1e-4), PoleRegion(2 * np.pi / 500, np.pi), 1e-12)
    layout = ChannelLayout(1, 1, np.ones(1), ("velocity",), ((0, 0),))
    region = PoleRegion(2 * np.pi / 500, np.pi)
    fit = choose(structure_tests(at, layout, region), region)
    assert fit.structure == "lossless" and np.allclose(fit.p, p, rtol=1e-10)


@pytest.mark.variants
@pytest.mark.parametrize("kind", ["lossless", "lightly damped", "dashpot", "sensor beside", "gyroscope"])
def test_true_structures_stand_and_false_ones_are_found(kind):
    """Seeded, at 20 dB: chance rejects what is true in more than 2 of 6 once in 500 times; all find what is false."""
    true, false = structure_plants.CASES[kind]
    p, residues, ports = structure_plants.plant(kind)
    region, rejected = PoleRegion(2 * np.pi / structure_plants.SAMPLES, np.pi), []
    for seed in range(6 if true else 2):
        u, y = structure_plants.recorded(p, residues, seed)
        scales = structure_plants.NOISE * np.std(y, axis=1)
        rows = FreeRecord.by_observation(u, y / scales[:, None], np.ones(y.shape, bool), Hold(1.0), through=False)
        at = refine_free(lambda _, rows=rows: rows, p, region, 1e-12)
        layout = ChannelLayout(len(y), len(u), scales, ("velocity",) * len(y), ports)
        rejected.append({test.hypothesis: test.p < 0.05 for test in structure_tests(at, layout, region).tests})
    for name in true:
        assert sum(each[name] for each in rejected) <= 2, name
    assert all(each[name] for each in rejected for name in false)


# --- passive models -------------------------------------------------------------------------------------------------


def mobility(p, residues, through):
    """State space of a model of one port."""
    A, B, C = real_matrices(p, np.ones((len(p), 1), complex), 2 * residues.reshape(1, -1))
    return ct.ss(A, B, C, [[through]])


def one_port(kind, seed):
    """Free fit of a recording from rest of one port, feedthrough free, noise known."""
    p, residues, ports = structure_plants.plant(kind)
    u, y = structure_plants.recorded(p, residues, seed)
    scale, region = structure_plants.NOISE * np.std(y), PoleRegion(2 * np.pi / structure_plants.SAMPLES, np.pi)
    rows = [FreeRecord(u, y / scale, np.ones(structure_plants.SAMPLES, bool), Hold(1.0), moving=False)]
    at = refine_free(lambda _: rows, p, region, 1e-12)
    return u, y, at, ChannelLayout(1, 1, np.array([scale]), ("velocity",), ports), region


def least_passive_loss(u, y, scale, fit):
    """Sequential quadratic programming on the loss itself, `G + G*` not negative on a fixed grid of frequencies."""
    n = len(fit.p)
    omega = np.unique(
        np.concatenate([[0.0], np.geomspace(1e-2, 1e2, 300), *np.linspace(0.9, 1.1, 60)[:, None] * fit.d])
    )
    size = np.concatenate([np.repeat(np.sqrt(np.diag(fit.covariance(1.0)))[: 4 * n], 1), [0.01]])
    start = np.concatenate([fit.p.imag, fit.p.real, fit.residues[:, 0, 0].real, fit.residues[:, 0, 0].imag, [0.0]])
    start[2 * n : 4 * n] *= scale
    size[2 * n : 4 * n] *= scale

    def model(x):
        w, s, a, b = (start + size * x)[: 4 * n].reshape(4, n)
        return s + 1j * w, a + 1j * b, (start + size * x)[4 * n]

    def loss(x):
        p, rho, through = model(x)
        left = y - output(p, rho[:, None, None], np.array([[through]]), np.zeros((n, 1)), u)
        return np.sum(left**2) / scale**2

    def margin(x):
        p, rho, through = model(x)
        s = 1j * omega[:, None]
        G = through + np.sum(rho / (s - p) + rho.conj() / (s - p.conj()), axis=1)
        return np.concatenate([1e3 * G.real, [1e3 * through], -1e3 * p.real])

    end = minimize(loss, np.zeros(4 * n + 1), method="SLSQP", constraints={"type": "ineq", "fun": margin},
                   options={"maxiter": 300, "ftol": 1e-9})  # fmt: skip
    assert end.success
    return loss(end.x)


@pytest.mark.variants
@pytest.mark.parametrize(("kind", "seed"), [("dashpot", 3), ("lossless", 0), ("lossless", 3)])
def test_passive_minimum_is_that_of_quadratic_programming_on_a_grid(kind, seed):
    u, y, at, layout, region = one_port(kind, seed)
    fit = constrained(at, layout, "passive", region)
    reference = least_passive_loss(u, y, layout.scales[0], at) - at.loss
    # on a grid a model may be active in between, and poles come to the axis
    assert 0.99 * reference < fit.loss - at.loss < 1.05 * reference
    assert phc.passivity(mobility(fit.p, fit.residues, fit.feedthrough[0, 0])).is_passive
    assert not phc.passivity(mobility(at.p, at.residues, at.feedthrough[0, 0])).is_passive
    errors = np.sqrt(np.diag(fit.covariance))
    assert np.all(errors <= (1 + 1e-9) * np.sqrt(np.diag(constrained(at, layout, "free", region).covariance)))


def test_a_free_fit_that_is_passive_stays_as_it_is():
    *_, at, layout, region = one_port("dashpot", 0)
    assert phc.passivity(mobility(at.p, at.residues, at.feedthrough[0, 0])).is_passive
    found = structure_tests(at, layout, region)
    passive = next(one for one in found.tests if one.hypothesis == "passive")
    assert (passive.likelihood_ratio, passive.dof, passive.p) == (0.0, 0, 1.0)
    fit = choose(found, region)
    assert fit.structure == "passive" and fit.loss == at.loss and np.array_equal(fit.p, at.p)


@pytest.mark.variants
@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_passivity_is_that_of_the_velocity_whatever_was_measured(quantity):
    """Two ports, entries of a response matrix: the mobility of the passive model is passive, and others were not."""
    p, omega = 1j * P.imag - 0.002, np.linspace(0.3, 2.0, 300)
    rho = factor(p, [quantity] * 2) * TRUE["classical"][1][:, :2, None] * TRUE["classical"][1][:, None, :2]
    power, s, rows, active = DERIVATIVES[quantity], 1j * omega, [], 0
    for seed in range(2):
        rng, rows = np.random.default_rng(seed), []
        for k in range(4):
            each = rho[:, k // 2, k % 2, None]
            response = np.sum(each / (s - p[:, None]) + each.conj() / (s - p.conj()[:, None]), axis=0) / 0.3
            response += rng.standard_normal(300) + 1j * rng.standard_normal(300)
            rows.append(FreeResponse(omega, response[None], np.ones(300), np.ones(300, bool), quantity, np.array([k])))
        region = PoleRegion(0.006, 2.0)
        at = refine_free(lambda _, rows=rows: rows, p, region, 1e-12)
        layout = ChannelLayout(2, 2, np.full(4, 0.3), (quantity,) * 2, ((0, 0), (1, 1)), True)
        fit = constrained(at, layout, "passive", region)
        moved = fit.residues * (fit.p[:, None, None] ** (1 - power))
        D = 2 * fit.residues.sum(axis=0).real if quantity == "displacement" else np.zeros((2, 2))
        grid = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 4001), (fit.p.imag[:, None] * [0.99, 1, 1.01]).ravel()])
        at_grid, q = 1j * grid[:, None, None, None], fit.p[:, None, None]
        G = D + np.sum(moved / (at_grid - q) + moved.conj() / (at_grid - q.conj()), axis=1)
        values = np.linalg.eigvalsh(G + G.conj().transpose(0, 2, 1))
        assert np.all(values[:, 0] > -1e-6 * values[:, 1] - 1e-14 * values.max())
        active += likelihood_dof(fit, at, layout, region)
    assert active


def likelihood_dof(fit, at, layout, region):
    """Number of constraints that hold a passive model."""
    return constrained(at, layout, "free", region).parameters - fit.parameters

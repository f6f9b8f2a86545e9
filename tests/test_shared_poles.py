"""Several inputs and outputs with shared poles: residues and derivatives against dense matrices and differences."""

from __future__ import annotations

import numpy as np
import pytest
from reference import EPS
from scipy.linalg import expm
from scipy.signal import lfilter

from ph_control.identification.regression.free import FreeProblem, FreeProjection, refine_free
from ph_control.identification.regression.sections import PoleRegion, Sections
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.identification.regression.variable_projection import refine
from ph_control.identification.search.free_search import Channels
from ph_control.modal.discretization import Hold

H, SAMPLES = 0.1, 240
P = np.array([-0.02 + 1.1j, -0.05 + 2.4j])


def plant(seed=0):
    """Residues (n, outputs, inputs) and feedthrough (outputs, inputs) of two modes, three sensors, two actuators."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((2, 3, 2)) + 1j * rng.standard_normal((2, 3, 2)), rng.standard_normal((3, 2))


def simulated(residues, D, u, start):
    """Outputs under held inputs from free motions `start` (n, outputs), one real second-order block at a time."""
    y = D @ u
    for p, rho, motion in zip(P, residues, start, strict=True):
        A = np.array([[p.real, -p.imag], [p.imag, p.real]])
        for output in range(len(D)):
            # y = 2 Re x: each output has modal states of its own
            B = np.stack([2 * rho[output].real, 2 * rho[output].imag])
            step = expm(H * np.block([[A, B], [np.zeros((2, 4))]]))
            x = 2 * np.array([motion[output].real, motion[output].imag])
            for k in range(u.shape[1]):
                y[output, k] += x[0]
                x = step[:2, :2] @ x + step[:2, 2:] @ u[:, k]
    return y


def record(noise=0.0, seed=1):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((2, SAMPLES))
    start = rng.standard_normal((2, 3)) + 1j * rng.standard_normal((2, 3))
    y = simulated(*plant(), u, start)
    return u, y + noise * rng.standard_normal(y.shape), start


def missing(share=0.2, seed=2):
    """The first output was observed throughout, the second and third not, and not at the same samples."""
    observed = np.random.default_rng(seed).random((3, SAMPLES)) > share
    observed[0] = True
    return observed


@pytest.mark.parametrize("gaps", [False, True])
def test_all_residues_and_motions_follow_from_one_record(gaps):
    u, y, start = record()
    observed = missing() if gaps else np.ones((3, SAMPLES), bool)
    rows = FreeRecord.by_observation(u, np.where(observed, y, np.nan), observed, Hold(H))
    assert len(rows) == (3 if gaps else 1)
    at = FreeProjection(rows, P)
    residues, D = plant()
    assert np.sqrt(at.loss) <= 1e4 * EPS * np.linalg.norm(y)
    assert np.allclose(at.residues, residues, rtol=0, atol=1e-9) and np.allclose(at.feedthrough, D, rtol=0, atol=1e-9)
    for one, own in zip(rows, at.own, strict=True):
        assert np.allclose(own[:2] + 1j * own[2:], start[:, one.outputs], rtol=0, atol=1e-9)
    for one, predicted in zip(rows, at.predictions(), strict=True):
        assert np.allclose(predicted, y[one.outputs], rtol=0, atol=1e-9)


def test_outputs_share_no_more_than_the_poles():
    """The loss of all outputs is the sum of those of each alone, at any poles."""
    u, y, _ = record(noise=0.3)
    observed, p = missing(), P * (1.01 + 0.003j)
    together = FreeProjection(FreeRecord.by_observation(u, y, observed, Hold(H)), p)
    alone = [FreeProjection([FreeRecord(u, y[[k]], observed[k], Hold(H))], p) for k in range(3)]
    assert np.isclose(together.loss, sum(one.loss for one in alone), rtol=1e-12)
    assert np.allclose(together.gradient, sum(one.gradient for one in alone), rtol=1e-9)
    assert together.rows == observed.sum()


def test_gradient_is_that_of_differences():
    u, y, _ = record(noise=0.3)
    rows, p, nudge = FreeRecord.by_observation(u, y, missing(), Hold(H, "exact", "foh")), P * 1.01, 1e-6

    def loss(x):
        return FreeProjection(rows, Sections.from_coordinates(x).p).loss

    x = Sections.of(p).x
    differences = [(loss(x + nudge * one) - loss(x - nudge * one)) / (2 * nudge) for one in np.eye(4)]
    found = 2 * FreeProjection(rows, p).gradient
    assert np.allclose(found, differences, rtol=1e-5, atol=1e-6 * np.abs(differences).max())


def test_experiments_that_excite_and_measure_different_channels_are_one_problem():
    """A hammer moves on, and so do the sensors: each record shows two outputs and drives one input."""
    residues, D = plant()
    rng, rows = np.random.default_rng(5), []
    for driven, outputs in [(0, [0, 1]), (1, [0, 1]), (0, [2]), (1, [2])]:
        u = np.zeros((2, SAMPLES))
        u[driven] = rng.standard_normal(SAMPLES)
        y = simulated(residues, D, u, np.zeros((2, 3)))[outputs]
        rows.append(FreeRecord(u, y, np.ones(SAMPLES, bool), Hold(H), outputs=np.array(outputs)))
    at = FreeProjection(rows, P)
    assert np.allclose(at.residues, residues, rtol=0, atol=1e-9) and np.allclose(at.feedthrough, D, rtol=0, atol=1e-9)


def test_more_outputs_make_poles_surer_and_errors_hold():
    region, scores = PoleRegion(2 * np.pi / (SAMPLES * H), np.pi / H), []
    for seed in range(8):
        u, y, _ = record(noise=0.5, seed=seed)
        rows = FreeRecord.by_observation(u, y, np.ones((3, SAMPLES), bool), Hold(H))
        end = refine(FreeProblem(rows, region), Sections.of(P * 1.01).x, rtol=1e-12)
        assert end.converged
        covariance = end.projection.covariance(0.25)
        errors = np.sqrt(np.diag(covariance)[:4])
        scores.append((end.projection.pole_parts - np.concatenate([P.imag, P.real])) / errors)
        first = refine(FreeProblem([FreeRecord(u, y[:1], np.ones(SAMPLES, bool), Hold(H))], region), end.projection.x,
                       rtol=1e-12).projection  # fmt: skip
        assert np.all(np.sqrt(np.diag(first.covariance(0.25))[:4]) > errors)
    # 32 squares of scores, about 1 each
    assert 0.5 < np.mean(np.square(scores)) < 1.8


def test_all_channels_together_find_the_poles_from_nothing():
    """Five modes at 20 dB, two inputs, four outputs: each joins where it explains most of all outputs together."""
    rng, samples = np.random.default_rng(3), 1500
    truth = np.array([0.4, 0.9, 1.0, 1.9, 2.6]) * (1j - np.array([0.02, 0.005, 0.01, 0.01, 0.02]))
    shapes = rng.standard_normal((2, 5, 4, 2))
    u, y = rng.standard_normal((2, samples)), np.zeros((4, samples))
    for p, rho in zip(truth, shapes[0] + 1j * shapes[1], strict=True):
        for driven in range(2):
            multiplier, (now, _) = Hold(1.0).multiplier(p), Hold(1.0).weights(np.array([p]))
            state = lfilter([0.0, now[0]], [1.0, -multiplier], u[driven].astype(complex))
            y += 2 * (rho[:, driven, None] * state).real
    y += 0.1 * np.std(y, axis=1, keepdims=True) * rng.standard_normal(y.shape)
    rows = FreeRecord.by_observation(u, y, np.ones(y.shape, bool), Hold(1.0), through=False)
    channels = Channels(np.fft.rfft(u), samples, Hold(1.0), np.pi)
    left, found = np.fft.rfft(y), np.zeros(0, complex)
    for _ in range(5):
        candidates, gains = channels.modes(left)
        start = np.append(found, candidates[np.argmax(gains)])
        at = refine_free(lambda _: rows, start, PoleRegion(2 * np.pi / samples, np.pi))
        found, left = at.p, np.fft.rfft(y - at.predictions()[0])
    rank = np.argsort(found.imag)
    errors = np.sqrt(np.diag(at.covariance(at.loss / at.rows)))
    assert np.all(np.abs(found.imag[rank] - truth.imag) < 5 * errors[:5][rank])
    assert np.all(np.abs(found.real[rank] - truth.real) < 5 * errors[5:10][rank])

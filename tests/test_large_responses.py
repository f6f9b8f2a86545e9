"""Responses of many lines: what a part of them is enough for, and noise that grows with the gain."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from slow import slowly

import ph_control as phc

LINES = 6000


def response(entries=1, share=0.0, floor=0.0, seed=0):
    """Natural frequencies, damping ratios, and a response of four modes with noise, at many lines."""
    rng = np.random.default_rng(seed)
    omega = np.linspace(0.02, 10.0, LINES)
    d, zeta = np.array([1.1, 2.9, 5.2, 8.3]), np.array([0.004, 0.006, 0.003, 0.005])
    shapes = rng.uniform(0.5, 1.0, (entries, 4)) * np.where(rng.uniform(size=(entries, 4)) < 0.5, -1, 1)
    columns = 1j * omega / (d[:, None] ** 2 - omega**2 + 2j * (zeta * d)[:, None] * omega)
    H = (shapes * shapes[0]) @ columns
    size = np.hypot(share * np.abs(H), floor * np.median(np.abs(H), axis=1, keepdims=True))
    noise = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    return d, zeta, ct.frd((H + size * noise)[:, None], omega, smooth=False)


@pytest.mark.parametrize("share, floor", [(0.0, 0.02), *slowly((0.01, 0.02))])
def test_many_lines_show_the_modes_and_no_ghosts(share, floor):
    d, zeta, data = response(2, share, floor, seed=1)
    result = phc.pem(data)
    assert result.order == 4 and not len(result.real_poles) and result.outcome.name == "CONSISTENT"
    score = (result.natural_frequencies - d) / result.stderr["natural_frequencies"]
    other = (result.damping_ratios - zeta) / result.stderr["damping_ratios"]
    assert np.all(np.abs(score) < 4.5) and np.all(np.abs(other) < 4.5)
    laws = [one.values for one in result.findings if one.cause.name == "GAIN_NOISE"]
    assert bool(laws) == (share > 0) and (not laws or np.allclose(laws[0], share, rtol=0.1))


@pytest.mark.slow
def test_a_slow_real_pole_among_many_lines_is_found():
    _, _, data = response(2, floor=0.02, seed=2)
    omega, H = data.omega, data.frdata
    lag = 3.0 / (1j * omega + 0.05)
    rng = np.random.default_rng(3)
    H = H + lag * np.array([1.0, -0.6])[:, None, None] + 0.01 * rng.standard_normal(H.shape)
    result = phc.pem(ct.frd(H, omega, smooth=False))
    assert result.order == 4
    assert np.allclose(result.time_constants, [20.0], rtol=0.02)


def ladder(n, port=50.0):
    """Response 2 x 2 of a ladder with a source behind a resistor at both ends, at 200 lines."""
    rng = np.random.default_rng(0)
    C, L, R = rng.uniform(0.7, 1.3, n), rng.uniform(0.7, 1.3, n - 1), rng.uniform(0.01, 0.04, n - 1)
    # voltages of the nodes and currents along the ladder
    A = np.zeros((2 * n - 1, 2 * n - 1))
    for k in (0, n - 1):
        A[k, k] = -1 / (port * C[k])
    for k in range(n - 1):
        A[n + k, [n + k, k, k + 1]] = -R[k] / L[k], 1 / L[k], -1 / L[k]
        A[k, n + k], A[k + 1, n + k] = -1 / C[k], 1 / C[k + 1]
    B = np.zeros((2 * n - 1, 2))
    B[0, 0], B[n - 1, 1] = 1 / (port * C[0]), 1 / (port * C[-1])
    out = np.zeros((2, 2 * n - 1))
    out[0, 0] = out[1, n - 1] = -1 / port
    omega = np.linspace(0.02, 2.3, 200)
    return omega, np.stack(
        [out @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + np.eye(2) / port for w in omega], axis=2
    )


def lossy_line(omega, skin=0.02, resistance=0.01):
    """Admittances 2 x 2 of a line of two conductors that the skin effect damps, which has no finite number of modes."""
    inductance, capacity = np.array([[1.0, 0.35], [0.35, 1.0]]), np.array([[1.0, -0.2], [-0.2, 1.0]])
    H = np.zeros((2, 2, len(omega)), complex)
    for k, s in enumerate(1j * omega):
        series = s * inductance + (np.eye(2) + 0.3) * (resistance + skin * np.sqrt(s))
        squares, T = np.linalg.eig(series @ (s * capacity))
        gamma, inverse = np.sqrt(squares), np.linalg.inv(T)
        surge = np.linalg.inv(series) @ T * gamma
        near, far = surge / np.tanh(gamma) @ inverse, -surge / np.sinh(gamma) @ inverse
        H[:, :, k] = near - far @ np.linalg.solve(near + np.diag([0.05, 3.0]), far.T)
    return H


def misfit(H, omega, noise=1e-4, **options):
    """Relative error of the fit to a response with noise, and the result."""
    rng = np.random.default_rng(1)
    size = noise * np.sqrt(np.mean(np.abs(H) ** 2) / 2)
    data = ct.frd(H + size * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)), omega, smooth=False)
    result = phc.pem(data, structure="free", **options)
    error = np.reshape(result.predicted, H.shape) - H
    return np.sqrt(np.mean(np.abs(error) ** 2) / np.mean(np.abs(H) ** 2)), result


def test_overlapping_modes_of_a_ladder_are_fitted_to_a_thousandth():
    omega, H = ladder(9)
    assert misfit(H, omega)[0] < 1e-3


@pytest.mark.slow
def test_a_line_with_skin_effect_is_fitted_with_modes_above_the_band():
    omega = np.linspace(0.05, 25.0, 200)
    error, result = misfit(lossy_line(omega), omega)
    assert error < 2e-4
    # those above shape what is in the band; a line gives no energy to any of them
    assert omega[-1] < result.natural_frequencies.max() < 2 * omega[-1]
    assert np.all(result.damping_ratios >= 0)


@pytest.mark.slow
def test_where_overlapping_modes_end_at_the_largest_order_this_is_said():
    omega = np.linspace(0.05, 25.0, 200)
    error, result = misfit(lossy_line(omega), omega, max_order=5)
    assert result.order >= 5 and error > 1e-2
    assert any(finding.cause.name == "LARGEST_ORDER" for finding in result.findings)

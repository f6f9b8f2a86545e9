"""Responses of many lines: what a part of them is enough for, and noise that grows with the gain."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

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


@pytest.mark.parametrize("share, floor", [(0.0, 0.02), (0.01, 0.0), (0.01, 0.02)])
def test_many_lines_show_the_modes_and_no_ghosts(share, floor):
    d, zeta, data = response(2, share, floor, seed=1)
    result = phc.pem(data)
    assert result.order == 4 and not len(result.real_poles) and result.outcome.name == "CONSISTENT"
    score = (result.natural_frequencies - d) / result.stderr["natural_frequencies"]
    other = (result.damping_ratios - zeta) / result.stderr["damping_ratios"]
    assert np.all(np.abs(score) < 4.5) and np.all(np.abs(other) < 4.5)
    laws = [one.values for one in result.findings if one.cause.name == "GAIN_NOISE"]
    assert bool(laws) == (share > 0) and (not laws or np.allclose(laws[0], share, rtol=0.1))


def test_a_slow_real_pole_among_many_lines_is_found():
    _, _, data = response(2, floor=0.02, seed=2)
    omega, H = data.omega, data.frdata
    lag = 3.0 / (1j * omega + 0.05)
    rng = np.random.default_rng(3)
    H = H + lag * np.array([1.0, -0.6])[:, None, None] + 0.01 * rng.standard_normal(H.shape)
    result = phc.pem(ct.frd(H, omega, smooth=False))
    assert result.order == 4
    assert np.allclose(result.time_constants, [20.0], rtol=0.02)

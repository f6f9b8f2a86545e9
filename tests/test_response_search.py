"""Frequency responses whose poles show together only, and criteria of weighted ones."""

from __future__ import annotations

import control as ct
import numpy as np
from test_late_responses import LOG, measured

import ph_control as phc


def test_lags_that_none_of_them_shows_alone_are_found_together():
    gains = np.random.default_rng(1).standard_normal((3, 1, 3))
    fit = phc.pem(measured(gains, (0.7, 3.5, 16.0), np.linspace(0.2, 15.6, 104), noise=0.015))
    assert (fit.order, len(fit.real_poles)) == (0, 3)


def test_weak_modes_are_found_beside_a_close_pair():
    modes = (([[0.14]], 1.4, 0.0175), ([[0.5]], 3.7, 0.015), ([[0.8]], 4.08, 0.0048))
    fit = phc.pem(measured((), (), np.linspace(0.17, 15.6, 137), modes=modes, noise=0.0015))
    assert fit.order == 3
    assert not any(finding.cause.name == "GAIN_NOISE" for finding in fit.findings)


def test_criteria_are_of_the_data_whatever_their_weights():
    rng, s = np.random.default_rng(3), 1j * LOG
    values = 1.0 / (s + 1.0)
    values = values * (1 + 0.01 * (rng.standard_normal(len(LOG)) + 1j * rng.standard_normal(len(LOG))))
    response = ct.frd(values[None, None], LOG, smooth=False)
    constant, weighted = (phc.pem(response, weights=each) for each in (np.ones(len(LOG)), 1 / np.abs(values) ** 2))
    scaled = phc.pem(response, weights=100 / np.abs(values) ** 2)
    np.testing.assert_allclose(scaled.bic, weighted.bic)
    assert weighted.bic < constant.bic - 50  # the noise grows with the gain
    np.testing.assert_allclose(phc.pem(response).bic, weighted.bic, atol=10)

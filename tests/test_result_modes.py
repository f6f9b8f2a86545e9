"""What every result says of its modes: residues, shapes and their errors, comparisons of shapes."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

import ph_control as phc

KAPPA, D = np.array([0.8, 0.5]), np.array([1.0, 2.0])
POWER = {"displacement": -1, "velocity": 0, "acceleration": 1}


@pytest.fixture(scope="module", params=list(POWER))
def fit(request):
    """A lossless fit to a response of the quantity."""
    rng, w = np.random.default_rng(0), np.linspace(0.1, 3.0, 150)
    response = phc.modes(D, KAPPA / D).freqresp(w) * (1j * w) ** POWER[request.param]
    noise = 0.05 * (rng.standard_normal(len(w)) + 1j * rng.standard_normal(len(w)))
    return phc.pem(ct.frd(response + noise, w), 2, quantity=request.param)


@pytest.mark.variants
def test_residues_and_feedthrough_are_those_of_the_observed_system(fit):
    s = 1j * np.array([0.3, 1.7, 5.0]) + 0.2
    terms = fit.residues[:, 0, 0, None] / (s - fit.poles[:, None])
    mirrored = fit.residues[:, 0, 0, None].conj() / (s - fit.poles[:, None].conj())
    response = (terms + mirrored).sum(axis=0) + fit.feedthrough[0, 0]
    assert np.allclose(response, fit.observed_system(s), rtol=1e-12)


def test_shapes_have_unit_modal_mass_and_make_the_residues_with_the_participation(fit):
    assert np.allclose(fit.shapes[:, 0] ** 2, fit.modes.kappa, rtol=1e-12) and fit.shapes_scaled
    assert np.allclose(fit.shapes[:, :, None] * fit.participation[:, None, :], fit.residues, rtol=1e-12)
    assert np.array_equal(fit.natural_frequencies, fit.d) and not fit.damping_ratios.any()
    assert fit.structure == "lossless" and fit.order == len(fit.poles) == 2


@pytest.mark.variants
def test_errors_are_those_of_draws(fit):
    draws = fit.sample(40_000, rng=1)
    residues, errors = draws.residues[:, :, 0, 0], fit.stderr["residues"][:, 0, 0]
    part, other = ("real", "imag") if fit.quantity == "velocity" else ("imag", "real")
    assert np.allclose(getattr(errors, part), getattr(residues, part).std(axis=0), rtol=0.03)
    assert not getattr(errors, other).any() and not getattr(residues, other).any()
    kappa = 2 * np.abs(residues) * draws.d ** -POWER[fit.quantity]
    assert np.allclose(fit.stderr["shapes"][:, 0], np.sqrt(kappa).std(axis=0), rtol=0.03)
    assert np.allclose(fit.stderr["kappa"], kappa.std(axis=0), rtol=0.03)
    assert np.allclose(fit.stderr["r"], (kappa / draws.d).std(axis=0), rtol=0.03)
    assert np.array_equal(fit.stderr["natural_frequencies"], fit.stderr["d"])


def test_intervals_of_complex_numbers_are_those_of_their_parts(fit):
    intervals = fit.confidence_interval(0.9)
    assert {"natural_frequencies", "damping_ratios", "residues", "shapes", "d", "r"} <= set(intervals)
    low, high = intervals["residues"][..., 0], intervals["residues"][..., 1]
    assert np.allclose((low + high) / 2, fit.residues, rtol=1e-12)
    ratio = (high - low)[fit.stderr["residues"] != 0] / fit.stderr["residues"][fit.stderr["residues"] != 0]
    assert np.allclose(ratio, ratio[0]) and 3.2 < ratio[0].real < 3.4


def test_shapes_are_compared_with_results_forms_and_arrays(fit):
    assert np.allclose(fit.mac(fit), 1) and np.allclose(fit.mac(fit.modes), 1)
    assert np.allclose(fit.mac([[2.0 - 1j]]), [[1], [1]]) and np.allclose(fit.phase_collinearity, 1)
    for other in ([1.0, 2.0], [[1.0, 2.0]], "shapes", [[np.nan]]):
        with pytest.raises(phc.StructureError):
            fit.mac(other)

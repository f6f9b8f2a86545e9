"""Records that are too long to be searched as a whole: on the disk, in single precision, of several channels."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.signal import lfilter

import ph_control as phc

STEP, SAMPLES = 0.1, 1_200_000
D, KAPPA = np.array([1.0, 2.3, 4.1]), np.array([1.0, 1.61, 2.05])


def moved(u, zeta, shapes):
    """Outputs, one for each row of shapes, of modes `kappa s / (s^2 + 2 zeta d s + d^2)` with the input held."""
    p = -zeta * D + 1j * D * np.sqrt(1 - zeta**2)
    lam, residues = np.exp(p * STEP), KAPPA * p / (2j * p.imag)
    responses = [
        2 * lfilter([0, weight], [1, -pole], u + 0j).real
        for weight, pole in zip(residues * (lam - 1) / p, lam, strict=True)
    ]
    return shapes @ np.array(responses)


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    """Write an array, and map it."""
    folder = tmp_path_factory.mktemp("long")

    def make(values):
        path = folder / f"{len(list(folder.iterdir()))}.npy"
        np.save(path, values)
        return np.load(path, mmap_mode="r")

    return make


@pytest.fixture(scope="module")
def loaded():
    """Import what a first fit does, which is no memory of a fit."""
    u = np.random.default_rng(0).standard_normal(400)
    y = moved(u, 0.01, np.ones((1, 3)))[0] + 0.1 * u[::-1]
    for structure in ("auto", "lossless", "free"):
        phc.pem((u, y), 3, dt=STEP, structure=structure)


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(0).standard_normal((3, SAMPLES))


@pytest.mark.slow
def test_lossless_modes_are_followed_from_a_part_to_the_whole(disk, noise, loaded):
    u = disk(noise[0])
    y = disk(moved(noise[0], 0.0, np.ones((1, 3)))[0] + 30.0 * noise[1])
    tracemalloc.start()
    result = phc.pem((u, y), dt=STEP)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (result.structure, result.order, result.success) == ("lossless", 3, True)
    assert (np.abs(result.d - D) < 5 * result.stderr["d"]).all()
    short = phc.pem((u[-300_000:], y[-300_000:]), 3, dt=STEP, structure="lossless", noise="white", delay=0.0)
    # as of the whole: errors fall with the power 3/2 of the length, and the larger motion at its end
    assert (result.stderr["d"] < 0.2 * short.stderr["d"]).all()
    assert result.predicted.shape == (SAMPLES,)
    assert result.tests[0].p > 1e-4
    assert result.whiteness > 1e-4
    # prediction and mask; what is searched; some blocks
    assert peak < 9 * SAMPLES + 130e6
    np.testing.assert_array_equal(result.record.time, STEP * np.arange(SAMPLES))


@pytest.mark.slow
@pytest.mark.parametrize("structure", ["auto", "free"])
def test_no_time_is_made_of_a_long_record_before_somebody_asks_for_it(tmp_path, structure, loaded):
    samples = 10_000_000
    for name in "uy":
        np.lib.format.open_memmap(tmp_path / name, "w+", float, (samples,))
    u, y = (np.load(tmp_path / name, mmap_mode="r") for name in "uy")
    tracemalloc.start()
    with pytest.raises(phc.PHControlError, match="zero throughout"):
        phc.pem((u, y), 1, dt=STEP, structure=structure)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6 * samples


@pytest.mark.slow
def test_damped_modes_of_a_long_record_get_a_damped_answer(disk, noise):
    u = disk(noise[0])
    y = disk(moved(noise[0], 0.01, np.ones((1, 3)))[0] + 0.5 * noise[1])
    result = phc.pem((u, y), dt=STEP, structure="classical")
    assert (result.structure, result.order) == ("classical", 3)
    assert (np.abs(result.natural_frequencies - D) < 5 * result.stderr["natural_frequencies"]).all()
    assert (np.abs(result.damping_ratios - 0.01) < 5 * result.stderr["damping_ratios"]).all()
    assert len(result.residuals) == SAMPLES
    np.testing.assert_allclose(np.var(result.residuals), result.noise_variance, rtol=1e-3)


@pytest.mark.slow
def test_channels_in_single_precision_stay_on_the_disk(disk, noise, loaded):
    shapes = np.array([[1.0, 1.0, 1.0], [1.0, -0.5, 2.0]])
    y = moved(noise[0], 0.01, shapes) + [[0.5], [2.0]] * noise[1:]
    u, y = disk(noise[:1].astype(np.float32)), disk(y.astype(np.float32))
    tracemalloc.start()
    result = phc.pem((u, y), 3, dt=STEP, structure="free", ports=[(0, 0)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.shares_memory(result.record.y, y)
    assert (np.abs(result.natural_frequencies - D) < 5 * result.stderr["natural_frequencies"]).all()
    np.testing.assert_allclose(result.noise_variance, [0.25, 4.0], rtol=0.01)
    ratios = (result.shapes[:, 1] / result.shapes[:, 0]).real
    np.testing.assert_allclose(ratios, shapes[1], atol=0.01)
    assert peak < 18 * SAMPLES + 200e6


def test_a_long_record_that_was_not_observed_everywhere_and_a_plant_at_rest(disk, noise):
    y = moved(noise[0], 0.01, np.ones((1, 3)))[0] + 0.5 * noise[1]
    y[np.random.default_rng(1).random(SAMPLES) < 0.01] = np.nan
    mapped = disk(noise[0]), disk(y)
    result = phc.pem(mapped, 3, dt=STEP, structure="free", initial_state="zero", offset=False, intersample="zoh")
    assert (np.abs(result.natural_frequencies - D) < 5 * result.stderr["natural_frequencies"]).all()
    assert np.isnan(result.residuals).sum() == np.isnan(y).sum()

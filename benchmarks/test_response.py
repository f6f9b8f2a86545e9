"""Frequency and time responses beside python-control, in one group each.

Run with `OPENBLAS_NUM_THREADS=1 python -m pytest benchmarks`; quote the ratios within a group.
"""

import control as ct
import numpy as np
import pytest

import ph_control as phc


@pytest.fixture(scope="module", params=[5, 100])
def plant(request):
    """A plant of 5 or 100 modes, and the same as a plain state-space system."""
    rng = np.random.default_rng(0)
    system = phc.ph(phc.modes(np.sort(rng.uniform(0.5, 50.0, request.param)), rng.uniform(0.1, 1.0, request.param)))
    return request.param, system, ct.ss(system)


@pytest.mark.parametrize("which", ["ph_control", "python-control"])
def test_frequency_response(benchmark, plant, which):
    n, system, plain = plant
    benchmark.group = f"frequency response, {n} modes, 1000 frequencies"
    s = 1j * np.linspace(0.1, 60.0, 1000)
    chosen = system if which == "ph_control" else plain
    assert benchmark(chosen, s).shape == (1000,)


@pytest.mark.parametrize("which", ["ph_control", "python-control"])
def test_forced_response(benchmark, plant, which):
    n, system, plain = plant
    benchmark.group = f"forced response, {n} modes, 10 000 samples"
    t = 0.02 * np.arange(10_000)
    u = np.random.default_rng(1).standard_normal(10_000)
    if which == "ph_control":
        result = benchmark(phc.forced_response, system, t, u, intersample="foh")
    else:
        result = benchmark(ct.forced_response, plain, t, u)
    assert result.outputs.shape == (10_000,)

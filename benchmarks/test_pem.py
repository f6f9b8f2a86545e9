"""Time of a fit, cold, order known, and of the search for the order.

Run with `OPENBLAS_NUM_THREADS=1 python -m pytest benchmarks`.
"""

import numpy as np
import pytest

import ph_control as phc


def record(n, samples):
    """A white-noise recording, 20 dB signal to noise."""
    rng = np.random.default_rng(n)
    d = np.linspace(0.3, 2.8, n)
    plant, u = phc.ph(phc.modes(d, rng.uniform(0.5, 1.0, n) / d)), rng.standard_normal(samples)
    y = phc.forced_response(plant, np.arange(samples), u, return_states=False).outputs
    return d, (u, y + 0.1 * np.std(y) * rng.standard_normal(samples))


@pytest.mark.parametrize("order", ["known", "auto"])
@pytest.mark.parametrize("n, samples", [(5, 1000), (10, 10_000)])
def test_fit(benchmark, n, samples, order):
    benchmark.group = f"fit, {n} modes, {samples} samples"
    d, data = record(n, samples)
    result = benchmark.pedantic(phc.pem, (data, n if order == "known" else "auto"), {"dt": 1.0}, rounds=5)
    assert np.allclose(result.d, d, rtol=1e-3)

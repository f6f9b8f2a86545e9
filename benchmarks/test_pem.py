"""Time of a fit without a guess, order known; of the search for the order; how time grows with the record; memory.

Run with `python -m pytest benchmarks/test_pem.py`; `-k "not long and not growth"` leaves out what takes minutes.
"""

import numpy as np
import pytest

import ph_control as phc

from .cold import MEGABYTE, measure, recording_of

LENGTHS = (10_000, 30_000, 100_000, 300_000, 1_000_000)


def fits(benchmark, order, recording, rounds):
    """Fit a recording several times, and see that the answer is right."""
    result = benchmark.pedantic(phc.pem, ((recording.u, recording.y), order), {"dt": 1.0}, rounds=rounds)
    assert np.allclose(result.d, recording.d, rtol=1e-3)


@pytest.mark.parametrize("order", ["known", "auto"])
@pytest.mark.parametrize("n, samples", [(5, 1000), (10, 10_000)])
def test_fit(benchmark, n, samples, order):
    benchmark.group = f"fit, {n} modes, {samples} samples"
    fits(benchmark, n if order == "known" else "auto", recording_of(n, samples), rounds=5)


@pytest.mark.parametrize("n, samples", [(5, 1000), (10, 10_000), (50, 1_000_000)], ids=["short", "middle", "long"])
def test_cold_process(benchmark, capsys, n, samples):
    benchmark.group = f"fit in a process of its own (with its start), {n} modes, {samples} samples"
    found = benchmark.pedantic(measure, (n, samples), rounds=1)
    benchmark.extra_info.update(found)
    with capsys.disabled():
        print(f"\nn={n}, T={samples}: {found['seconds']:.3g} s, peak {found['peak'] / MEGABYTE:.0f} MB")
    assert found["error"] < 1e-3


@pytest.fixture(scope="module")
def growth():
    """Median time of a fit of 10 modes by the length of the record."""
    return {}


@pytest.mark.parametrize("samples", LENGTHS)
def test_growth_with_the_record(benchmark, growth, samples):
    benchmark.group = "fit, 10 modes, by length of the record"
    fits(benchmark, 10, recording_of(10, samples), rounds=3 if samples <= 100_000 else 1)
    growth[samples] = benchmark.stats.stats.median


def test_growth_slope(capsys, growth):
    if len(growth) < 2:
        pytest.skip("needs two lengths of test_growth_with_the_record")
    samples, seconds = np.log(list(growth)), np.log(list(growth.values()))
    with capsys.disabled():
        print(f"\ntime of a fit of 10 modes grows as T^{np.polyfit(samples, seconds, 1)[0]:.2f}, {growth}")

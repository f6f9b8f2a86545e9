"""The columns of the linear problem and their derivatives, against dense simulation and differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ph_control as phc
from ph_control.identification.regressors import Hold, regressors

HOLDS = [("exact", "zoh"), ("exact", "foh"), ("midpoint", "zoh"), ("midpoint", "foh"), ("euler", "zoh")]
BLOCKS = ["forced", "cosine", "sine"]


@pytest.mark.parametrize("method, intersample", HOLDS)
def test_columns_reproduce_a_simulation_with_initial_state(method, intersample):
    rng = np.random.default_rng(2)
    h, d, r, u = 0.05, np.array([0.7, 3.0, 11.0]), np.array([1.0, 0.2, 0.5]), rng.standard_normal(300)
    plant = phc.ph(phc.modes(d, r))
    z0 = rng.standard_normal(6)
    y = phc.forced_response(plant, h * np.arange(300), u, z0, method=method, intersample=intersample).outputs
    hold = Hold(h, method, intersample)
    amplitude = d * np.sqrt(r) * (z0[:3] + 1j * z0[3:])
    predicted = regressors(d, u, hold).columns() @ np.concatenate([r * d, amplitude.real, amplitude.imag])
    assert np.abs(predicted - y).max() <= 4e3 * np.finfo(float).eps * np.abs(y).max()


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("method, intersample", HOLDS)
def test_slopes_are_the_derivatives_of_the_columns(method, intersample, block):
    rng = np.random.default_rng(3)
    u, hold, step = rng.standard_normal(250), Hold(0.1, method, intersample), 1e-5
    d = np.array([1e-3, 0.3, 4.0, 29.0]) if method != "euler" else np.array([1e-3, 0.3, 1.0, 2.0])
    difference = (getattr(regressors(d + step, u, hold), block) - getattr(regressors(d - step, u, hold), block)) / (
        2 * step
    )
    slope = getattr(regressors(d, u, hold), block + "_slope")
    # a central difference is right to step^2 |f'''| / 6 plus rounding / step
    third = (250 * 0.1) ** 3 * np.abs(getattr(regressors(d, u, hold), block)).max()
    allowed = third * step**2 / 6 + 1e3 * np.finfo(float).eps * np.abs(slope).max() / step
    assert np.abs(slope - difference).max() <= allowed
    assert np.abs(slope).max() > 1e2 * allowed


@settings(deadline=None, max_examples=30, derandomize=True)
@given(phase=st.floats(1e-6, 1.5), h=st.floats(1e-9, 1e9), method=st.sampled_from(["exact", "midpoint", "euler"]))
def test_frequency_of_a_phase_turns_a_mode_by_that_phase(phase, h, method):
    hold = Hold(h, method)
    d = hold.frequency_of(np.array([phase]))
    assert np.isclose(-np.angle(hold.step(d).multiplier[0]), phase, rtol=1e-12)

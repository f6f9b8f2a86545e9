"""
A hammer test
=============

A hammer hits a structure, and an accelerometer somewhere else on it records what follows: 5 s at 20 kHz, three modes
that lose energy, with residues of both signs. No lossless model describes such a record; the fit says so, and is one of
damped modes, from free residues to the simplest structure that the data do not reject.
"""

import control as ct
import numpy as np
from scipy.signal import cont2discrete, lfilter

import ph_control as phc

STEP, SAMPLES = 5e-5, 100_000
HERTZ, RATIOS, WEIGHTS = [120.0, 310.0, 540.0], [0.005, 0.012, 0.02], [1.0, -0.6, 0.8]

# %%
# The recording: a half-sine pulse of 0.8 ms, the acceleration of each mode, and 1 % of white noise.

t = STEP * np.arange(SAMPLES)
force = np.where((t >= 0.01) & (t <= 0.0108), 100 * np.sin(np.pi * (t - 0.01) / 8e-4), 0.0)
acceleration = np.zeros(SAMPLES)
for hertz, ratio, weight in zip(HERTZ, RATIOS, WEIGHTS, strict=True):
    d = 2 * np.pi * hertz
    numerator, denominator, _ = cont2discrete(([weight, 0, 0], [1, 2 * ratio * d, d**2]), STEP, "zoh")
    acceleration += lfilter(numerator[0], denominator, force)
acceleration += 0.01 * np.std(acceleration) * np.random.default_rng(0).standard_normal(SAMPLES)

# %%
# The default call. The search notices that the strongest peak is broader than that of a lossless mode, and follows the
# damped modes; structures with a sensor at the actuator are rejected.

labels = {"input_labels": ["force [N]"], "output_labels": ["acceleration [m/s²]"]}  # which tell the quantity
data = ct.TimeResponseData(t, acceleration, inputs=force, issiso=True, **labels)
data.time_unit = "s"
result = phc.pem(data)
print(result.summary())
assert result.structure == "free"
assert np.all(np.abs(result.damping_ratios - RATIOS) < 4.5 * result.stderr["damping_ratios"])

# %%
# The frequency response of the model over that of the recording, and a report of the fit as one HTML page.

result.plot(kind="responses").figure.savefig("hammer_test.png", dpi=110)
result.report("hammer_test.html", title="Hammer test", overwrite=True)

"""
A hammer test
=============

A hammer hits a structure, and an accelerometer somewhere else on it records what follows: 5 s at 20 kHz, three modes
that lose energy, with residues of both signs. No lossless model describes such a record; the fit says so, and is one of
damped modes, from free residues to the simplest structure that the data do not reject.
"""

import matplotlib.pyplot as plt
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

result = phc.pem((force, acceleration), dt=STEP, quantity="acceleration")
print(result.summary())
assert result.structure == "free"
assert np.all(np.abs(result.damping_ratios - RATIOS) < 4.5 * result.stderr["damping_ratios"])

# %%
# ``result.system`` is a ``control.StateSpace``; here its response beside that of the plant.

f = np.linspace(50, 700, 1500)
s = 2j * np.pi * f
d = 2 * np.pi * np.array(HERTZ)[:, None]
plant = np.sum(np.array(WEIGHTS)[:, None] * s**2 / (s**2 + 2 * np.array(RATIOS)[:, None] * d * s + d**2), axis=0)
figure, axis = plt.subplots(layout="constrained")
axis.semilogy(f, np.abs(plant), color="0.7", linewidth=4, label="plant")
axis.semilogy(f, np.abs(result.system(s).ravel()), color="C0", label="damped model")
axis.set(xlabel="frequency [Hz]", ylabel="acceleration / force", title="Hammer test")
axis.legend()
figure.savefig("hammer_test.png", dpi=110)

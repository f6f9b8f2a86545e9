"""
A small shaker in the wind
==========================

A shaker moves a footbridge, and so do the wind and those who walk on it, half as much.
`pem` takes the forces that nobody measured into the likelihood. Modes have errors that hold, shapes are scaled to modal
mass by the measured force, and the predictor knows what the bridge will do next.
"""

import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# A bridge as three masses on a beam, with the shapes of its bending. The shaker stands at the first mass, and a sensor
# of velocity at each.

STEP, SAMPLES, MASS = 0.04, 3000, 900.0  # s, kg
places = np.arange(1, 4) / 4
shapes = np.sqrt(2 / 4) * np.sin(np.pi * np.outer(places, np.arange(1, 4)))
omega = 2 * np.pi * np.array([2.1, 5.6, 9.7])
zeta = np.array([0.006, 0.009, 0.010])
M, K = MASS * np.eye(3), MASS * shapes @ np.diag(omega**2) @ shapes.T
C = MASS * shapes @ np.diag(2 * zeta * omega) @ shapes.T
bridge = phc.from_second_order(M, K, np.eye(3), C=C)

# %%
# The wind is as strong as a third of the shaker, at each of the three masses, and changes five times a step.

FINE = 5
rng = np.random.default_rng(5)
u = np.repeat(rng.standard_normal(SAMPLES), FINE)
t = STEP / FINE * np.arange(len(u))
driven, blown = np.zeros((3, len(u))), 20 * np.sqrt(FINE) * rng.standard_normal((3, len(u)))
driven[0] = 60 * u
of_shaker, of_wind = (
    phc.forced_response(bridge, t, forces, intersample="zoh").outputs[:, ::FINE] for forces in (driven, blown)
)
force, y = driven[0, ::FINE], of_shaker + of_wind
y = y + 0.05 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
print(f"size of what the wind does, over that of the shaker: {np.std(of_wind) / np.std(of_shaker):.2f}")

# %%
# The finding says how much of each output is no response to the shaker. Errors are those beside such forces.

result = phc.pem((force, y), dt=STEP, ports=[(0, 0)])
print(result.summary())
white = phc.pem((force, y), 3, dt=STEP, ports=[(0, 0)], noise="white", structure="classical", real_poles=0)
assert result.order == 3 and "FORCES" in {finding.cause.name for finding in result.findings}

# %%
# Were the noise white, the same record would say less of the modes, with errors that are not what is stated.

for name, true in (("natural_frequencies", omega), ("damping_ratios", zeta)):
    off = [np.sqrt(np.mean(((getattr(fit, name) - true) / fit.stderr[name]) ** 2)) for fit in (result, white)]
    print(f"{name:20s} errors over stated ones: {off[0]:.1f} with the forces, {off[1]:.1f} with white noise")
    assert np.all(np.abs(getattr(result, name) - true) < 4 * result.stderr[name]), name

# %%
# The measured force scales the shapes to modal mass, small as it is.

expected = np.abs(shapes.T) / np.sqrt(MASS)
assert np.all(np.abs(np.abs(result.shapes.real) - expected) < 4.5 * result.stderr["shapes"].real)

# %%
# What is no response to the shaker is noise that the modes have filtered, so that the past foretells it: one step ahead
# the predictor, a Kalman filter, leaves little of what a simulation leaves.

last = slice(SAMPLES - 150, SAMPLES)
ahead, simulated = result.predict((force, y), horizon=1).outputs, result.predict((force, y)).outputs
comparison = {"simulated": simulated, "one step ahead": ahead}
for name, outputs in comparison.items():
    share = 1 - np.linalg.norm(y - outputs) / np.linalg.norm(y - y.mean(axis=1, keepdims=True))
    print(f"{name:15s} {100 * share:.0f} %")

figure, (motion, ratios) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", width_ratios=[3, 2])
seconds = STEP * np.arange(SAMPLES)[last]
motion.plot(seconds, 1e3 * y[0, last], color="0.6", lw=3, label="recorded at the shaker")
for name, colour in (("simulated", "C3"), ("one step ahead", "C0")):
    motion.plot(seconds, 1e3 * comparison[name][0, last], color=colour, lw=1, label=name)
motion.set(xlabel="Time [s]", ylabel="Velocity [mm/s]")
motion.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, fontsize="small", frameon=False)
hertz = omega / (2 * np.pi)
ratios.plot(hertz, 100 * zeta, "k_", ms=16, label="true")
for fit, name, colour, shift in ((result, "with the forces", "C0", -0.15), (white, "white noise", "C3", 0.15)):
    ratios.errorbar(hertz + shift, 100 * fit.damping_ratios, 196 * fit.stderr["damping_ratios"], fmt="o",
                    color=colour, ms=4, capsize=3, label=f"{name}, 95 %")  # fmt: skip
# of the two fits side by side, neither stands at its own frequency
ratios.set_xticks(hertz, [f"{f:.1f}" for f in hertz])
ratios.set(xlabel="Mode at frequency [Hz]", ylabel="Damping ratio [%]", ylim=(0, None))
ratios.legend(fontsize="small")
for axis in (motion, ratios):
    axis.grid(alpha=0.4)
figure.savefig("shaker_in_wind.png", dpi=120)

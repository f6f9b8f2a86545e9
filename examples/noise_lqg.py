"""
LQG with identified noise
=========================

A flexible arm whose tip is pushed about by slow loads that nobody measures. A fit finds the modes, and the noise beside
them; its predictor is the Kalman filter that linear quadratic control needs. Beside it stands the same control with a
guess: white forces at the motor.
"""

from dataclasses import replace

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# Two modes, from the torque of a motor to the displacement of the tip in mm. The slow loads move the tip by 4 mm, and
# lose their memory in a second.

step, samples = 0.02, 6000
poles = 2 * np.pi * np.array([1.1, 4.7]) * np.exp(1j * (np.pi - np.arccos([0.02, 0.015])))
truth = ct.ss(phc.modes(poles, [[-30j], [12j]], [[1.0], [1.0]]).state_space())
plant = ct.c2d(truth, step)
rng = np.random.default_rng(3)
torque = np.repeat(rng.choice([-1.0, 1.0], samples // 5), 5)


def slow_loads(rng):
    """Displacement of the tip by loads, which is 0.98 times what it was a step before, and something new."""
    memory = ct.ss([[0.98]], [[1.0]], [[4 * np.sqrt(1 - 0.98**2)]], 0, step)
    return np.squeeze(ct.forced_response(memory, inputs=rng.standard_normal(samples)).outputs)


moved = np.squeeze(ct.forced_response(plant, inputs=torque).outputs)
tip = moved + slow_loads(rng) + 0.02 * rng.standard_normal(samples)
print(f"the tip moves by {np.std(moved):.1f} mm, of which the torque does not explain {np.std(tip - moved):.1f} mm")

# %%
# The fit to the first half: two modes, and an autoregression. One step ahead it predicts the second half far better
# than it simulates it, and what it leaves is white.

half = samples // 2
result = phc.pem((torque[:half], tip[:half]), order=2, dt=step, quantity="displacement")
fresh = torque[half:], tip[half:]
print(result.noise)
for horizon in (1, 10, None):
    print(phc.compare(fresh, result, horizon=horizon))
analysis = phc.residual_analysis(fresh, result)
print(analysis)
assert analysis.whiteness > 0.001 > analysis.simulation_whiteness

# %%
# The predictor has the past of the noise among its states, which the torque cannot change; the tip is the sum of both.
# Its gain, and the feedback that weighs the tip against the torque, are a controller.

effort = 2.0


def controller(predictor):
    """Linear quadratic control by the states of a predictor of one input and one output."""
    gain = predictor.B[:, 1:]
    A, B, C = predictor.A + gain @ predictor.C, predictor.B[:, :1], predictor.C
    feedback, _, _ = ct.dlqr(A, B, C.T @ C, [[effort]])
    return ct.ss(A - B @ feedback - gain @ C, gain, feedback, 0, step)


identified = controller(result.predictor)

# %%
# The same with the guess of white forces at the motor, and a sensor with noise of 0.02 mm. Forces change the states of
# `observed_system`; the noise that a fit has found is replaced by another one.

model = result.observed_system
guess = replace(result, noise=phc.NoiseModel.driven(model, model.B, 1.0, [[0.02**2]], step))
plain = controller(guess.predictor)

# %%
# In continuous time `kalman_gain` is the gain of `control.lqe` for the states of `system`, as `control.lqr` needs it.

system, observer = guess.system, guess.kalman_gain
row = system.C[[system.output_labels.index("y")]]
regulator, _, _ = ct.lqr(system.A, system.B, row.T @ row, [[effort]])
continuous = ct.ss(system.A - system.B @ regulator - observer @ row, observer, regulator, 0)
zeta = ct.damp(ct.feedback(truth, continuous), doprint=False)[1]
print(f"in continuous time, with white forces: least damping {100 * zeta.min():.0f} %")

# %%
# Both loops around the arm as it is, in a step of the load, over frequency, and under new slow loads.

loops = {
    "identified noise": ct.feedback(1, plant * identified),
    "white forces at the motor": ct.feedback(1, plant * plain),
}
loads = slow_loads(np.random.default_rng(8))
remaining = {"without control": np.std(loads)}
figure, (above, below) = plt.subplots(2, layout="constrained", figsize=(7, 6))
time, omega = step * np.arange(200), np.geomspace(0.1, np.pi / step, 400)
above.axhline(1.0, color="0.5", linestyle=":", label="without control")
below.axhline(0.0, color="0.5", linestyle=":")
for (name, loop), style in zip(loops.items(), ("-", "--"), strict=True):
    assert np.abs(loop.poles()).max() < 1
    remaining[name] = np.std(ct.forced_response(loop, inputs=loads).outputs)
    above.step(time, np.squeeze(ct.forced_response(loop, inputs=np.ones(time.size)).outputs), style, label=name)
    response = np.squeeze(loop(np.exp(1j * omega * step)))
    below.semilogx(omega / (2 * np.pi), 20 * np.log10(np.abs(response)), style)
for name, size in remaining.items():
    print(f"tip under slow loads, {name}: {size:.2f} mm")
assert remaining["identified noise"] < 0.8 * min(remaining["without control"], remaining["white forces at the motor"])
above.set(xlabel="Time [s]", ylabel="Tip [mm]", title="A load that moves the tip by 1 mm, from time 0 on")
above.legend()
below.set(xlabel="Frequency [Hz]", ylabel="Tip over load [dB]", title="Sensitivity of the tip to loads")
for axis in (above, below):
    axis.grid(alpha=0.4)
figure.savefig("noise_lqg.png", dpi=110)

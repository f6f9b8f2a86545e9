"""
From a recording to a controller
================================

A structure with five natural frequencies is pushed at one point, and the velocity of that point is recorded. From the
recording alone comes a model with error bars, and from the model a controller that takes the energy out.
"""

# sphinx_gallery_thumbnail_number = 2
import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# A recording
# -----------
# Here it is made: random force on the first of five masses, sensor noise 20 dB below the velocity, and a structure that
# is in motion when the recording begins. With a recording of your own, leave this block out.

plant = phc.spring_chain(np.ones(5), 4.0, ground=0.5, name="plant")
rng = np.random.default_rng(1)
time, force = 0.1 * np.arange(4000), rng.standard_normal(4000)
velocity = phc.forced_response(plant, time, force, rng.standard_normal(10), intersample="zoh").outputs
velocity = velocity + 0.1 * np.std(velocity) * rng.standard_normal(4000)
table = np.column_stack([time, force, velocity])
np.savetxt("recording.csv", table, delimiter=",", header="time [s],force [N],velocity [m/s]", comments="", fmt="%.8g")

# %%
# The model
# ---------
# Nothing but the table goes in: no order, no starting guess. The summary lists each mode with its standard errors, and
# below them the structures that the data do not reject: a structure without losses among them.

data = phc.read_csv("recording.csv", input="force", output="velocity")
result = phc.pem(data)
print(result.summary())

# %%
# Measurement and prediction, and what is left. The residual is the sensor noise: it has no structure.

result.plot(output_label="Velocity", output_unit="m/s").figure.savefig("fit.png", dpi=110)

# %%
# The dots are an estimate of the frequency response from the same recording, without any model.

bode = phc.bode_plot(result.system, data=data, gain_unit="(m/s)/N", label="identified model")
bode.figure.savefig("bode.png", dpi=110)

# %%
# The controller
# --------------
# A port-Hamiltonian system stores what its port is supplied with: the stored energy `H` changes at the rate `y u`.
# Feed back `u = -k y`, the force of a damper at the port, and the energy can only fall, at the rate `-k y^2`. This is
# called damping injection. It holds for every `k > 0`, and for any error of the model, since the real structure stores
# energy too. The model is needed to choose `k` well: a stiff damper holds the point fast, and the rest of the structure
# swings on.
#
# `result.system` is a `control.StateSpace`, so that the loop is closed with `ct.feedback`.

gains = np.geomspace(0.1, 20.0, 60)


def slowest_decay(model, k):
    """Return the decay rate in 1/s of the mode that lives longest under the feedback `u = -k y`."""
    return -max(ct.poles(ct.feedback(model, k)).real)


k = gains[np.argmax([slowest_decay(result.system, k) for k in gains])]
print(f"k = {k:.2f} N s/m: slowest decay {slowest_decay(result.system, k):.4f} 1/s by the model,", end=" ")
print(f"{slowest_decay(plant, k):.4f} 1/s in truth")
for other in (k / 10, 10 * k):
    print(f"k = {other:.2f} N s/m: {slowest_decay(result.system, other):.4f} 1/s")

# %%
# How sure is that, given the noise? The design is tried on models drawn from the distribution of the estimate.

decays = [slowest_decay(model, k) for model in result.sample_systems(100, rng=0)]
print(f"slowest decay of 100 models that the recording allows: {min(decays):.4f} to {max(decays):.4f} 1/s")

# %%
# How much may be wrong with the loop before it swings up? The gain may have any size. The phase may be off by 90
# degrees; so a delay in sensor, computer and actuator must stay below the time in which the highest frequency where the
# loop gain is 1 turns by 90 degrees.

loop = k * result.system
gain_margin, phase_margin, _, _, crossings, _ = phc.stability_margins(loop, returnall=True)
print(f"gain margin {phc.margin(loop)[0]}, phase margin {np.min(np.abs(phase_margin)):.0f} degrees")
print(f"admissible delay {np.pi / 2 / np.max(crossings):.3f} s")

# %%
# The loop on the true structure, let go in motion: without feedback the energy stays what it is, with feedback it falls
# and never rises. Below, the answer of the velocity to a step of the force.

t = np.linspace(0.0, 60.0, 1201)
closed = ct.feedback(plant, k)
start = np.random.default_rng(2).standard_normal(10)
swinging = ct.initial_response(closed, t, start)
energy = np.array([plant.hamiltonian(z) for z in swinging.states.T])
assert np.all(np.diff(energy) <= 1e-12 * energy[0])

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7, 5.5), layout="constrained")
above.axhline(energy[0], color="C0", label="open loop")
above.semilogy(t, energy, color="C1", label=f"u = -k y, k = {k:.2f} N s/m")
above.set_ylabel("Stored energy [J]")
above.set_ylim(1.0, 100.0)
step = phc.step_response(plant, t)
below.plot(t, step.outputs, color="C0", linewidth=0.8, label="open loop")
below.plot(t, ct.step_response(closed, t).outputs, color="C1", label="closed loop, true structure")
model_step = ct.step_response(ct.feedback(result.system, k), t)
below.plot(t, model_step.outputs, "k:", linewidth=1.2, label="closed loop, model")
below.set_ylabel("Velocity after a step\nof the force [m/s]")
below.set_xlabel("Time [s]")
below.set_xlim(0, t[-1])
for axis in (above, below):
    axis.grid(True, alpha=0.4)
    axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, fontsize="small", frameon=False)
figure.savefig("damping_injection.png", dpi=110)

# %%
# Keep the model
# --------------
# A JSON file, which holds every number to the last bit.

phc.save(result.system, "model.json", overwrite=True)
assert np.array_equal(phc.load("model.json").d, result.d)
print("largest relative error of a natural frequency:", f"{np.max(np.abs(result.d / plant.d - 1)):.1e}")

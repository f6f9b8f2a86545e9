"""From a recording to a model: read it, fit it, look at it, use it with python-control, save it."""

import control as ct
import numpy as np

import ph_control as phc

# A recording to work on: white force on the first of five masses, its velocity, noise 20 dB below.
plant = phc.spring_chain(np.ones(5), 4.0, ground=0.5, name="plant")
rng = np.random.default_rng(1)
time, force = 0.1 * np.arange(4000), rng.standard_normal(4000)
velocity = phc.forced_response(plant, time, force, rng.standard_normal(10)).outputs
velocity = velocity + 0.1 * np.std(velocity) * rng.standard_normal(4000)
table = np.column_stack([time, force, velocity])
np.savetxt("recording.csv", table, delimiter=",", header="time [s],force [N],velocity [m/s]", comments="", fmt="%.8g")

# The job: everything from here on is what one does with a recording of one's own.
data = phc.read_csv("recording.csv", input="force", output="velocity")
result = phc.pem(data)
print(result.summary())

result.plot(output_label="Velocity", output_unit="m/s").figure.savefig("fit.png", dpi=110)
bode = phc.bode_plot(result.system, data=data, gain_unit="(m/s)/N", label="identified model")
bode.figure.savefig("bode.png", dpi=110)

# The model is a control.StateSpace: close a loop around it, sample it, build with it.
damped = ct.feedback(result.system, 0.5)
print("slowest decay with velocity feedback 0.5:", f"{max(ct.poles(damped).real):.4f}", "1/s")

phc.save(result.system, "model.json", overwrite=True)
assert np.array_equal(phc.load("model.json").d, result.d)

print("largest relative error of a natural frequency:", f"{np.max(np.abs(result.d / plant.d - 1)):.1e}")

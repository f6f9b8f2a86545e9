"""
From a hammer test to a tuned mass damper
=========================================

A machine frame hums at its first mode. A hammer test at the point where a damper could stand gives a port-Hamiltonian
model; the best damper of 2.5 kg is found on it, built from a spring and a dashpot that can be bought, and tried on the
frame.
"""

import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# The frame, which the test does not know: three storeys, 0.3 to 1 % of damping. The hammer hits the top, and an
# accelerometer there records 4 s at 500 Hz, with 1 % of noise.

frame = phc.spring_chain([80.0, 60.0, 40.0], [4e5, 2.5e5], ground=[6e5, 0, 0], c=[60.0, 40.0], ground_c=[80.0, 0, 0],
                         port=2)  # fmt: skip
t = np.arange(2000) / 500
force = np.where((t > 0.01) & (t < 0.02), 800 * np.sin(np.pi * (t - 0.01) / 0.01), 0.0)
velocity = phc.forced_response(frame, t, force, intersample="foh")
acceleration = (frame.A @ velocity.states + frame.B * force)[-1] / 40.0  # of the momentum of the top
noise = 0.01 * acceleration.std() * np.random.default_rng(0).standard_normal(t.size)
signals = {"force [N]": force, "acceleration [m/s²]": acceleration + noise}
recording = phc.recording(signals, input="force [N]", output="acceleration [m/s²]", fs=500)
recording.time_unit = "s"
result = phc.pem(recording, ports=[(0, 0)])
print(result.summary())
assert result.order == 3 and result.structure in ("classical", "passive")
assert np.all(np.abs(result.hertz - frame.hertz) < 4 * result.stderr["natural_frequencies"] / (2 * np.pi))

# %%
# The model has a port for the damper: force in, velocity out. Its mass is 2.5 kg. The rule of den Hartog levels the
# response to a sine; the H2 optimum is best for forces of all frequencies.

plant = result.system
for criterion in ("fixed points", "h2"):
    print(phc.optimal_damping(plant, [0], mass=2.5, criterion=criterion, outputs="displacement", mode=0))
best = phc.optimal_damping(plant, [0], mass=2.5, outputs="displacement", mode=0)

# %%
# What is in stock: springs in steps of 200 N/m, dashpots of 10, 15, 22, 33 and 47 N s/m. Any of these is passive, so
# that no choice can make the frame unstable.

stiffness = 200 * round(best.stiffnesses[0] / 200)
dashpots = np.array([10.0, 15, 22, 33, 47])
damping = dashpots[np.argmin(np.abs(np.log(dashpots / best.gains[0])))]
print(f"ordered: a spring of {stiffness} N/m and a dashpot of {damping:.0f} N s/m")
damper = phc.ph(
    np.diag([stiffness, 1 / 2.5]), [-1.0, 0.0], R=np.diag([0.0, damping]), P=[[0.0], [-damping]], S=[[damping]]
)
built = {"frame": frame, "with the best damper": phc.damping_injection(frame, best.controller),
         "with the damper from stock": phc.damping_injection(frame, damper)}  # fmt: skip

# %%
# On the frame itself, which the design never saw.

f = np.linspace(3, 30, 3000)
s = 2j * np.pi * f
figure, axis = plt.subplots(layout="constrained")
for (name, system), style in zip(built.items(), ("-", "--", "-."), strict=True):
    compliance = np.abs(system(s).ravel() / s)
    axis.semilogy(f, 1e6 * compliance, style, label=name)
    print(f"{name}: largest displacement {1e6 * compliance.max():.1f} µm/N")
axis.set(xlabel="Frequency [Hz]", ylabel="Displacement at the top [µm/N]", title="A frame and its tuned mass damper")
axis.grid(alpha=0.4)
axis.legend()
figure.savefig("hammer_to_damper.png", dpi=110)
peaks = [np.abs(system(s) / s).max() for system in built.values()]
assert peaks[0] > 8 * peaks[2] and peaks[2] < 1.3 * peaks[1]

"""
An LC circuit
=============

Three branches, each an inductor in series with a capacitor, in parallel at a voltage source. The input is the voltage,
the output the current: their product is the power, so that the circuit is port-Hamiltonian.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

C, L = np.array([1.0, 0.5, 0.25]), np.array([1.0, 0.8, 0.6])  # F, H
circuit = phc.lc_circuit(C, L, name="circuit", inputs="voltage", outputs="current")
print(circuit)

# %%
# Each branch is a mode: its natural frequency is `1/sqrt(L C)`, and the residue of the admittance at it is `1/L`.

assert np.allclose(circuit.d, 1 / np.sqrt(L * C)) and np.allclose(circuit.r * circuit.d, 1 / L)
print("natural frequencies [rad/s]:", circuit.d.round(4))
print("zeros [rad/s]:", circuit.modes.zeros.imag[circuit.modes.zeros.imag >= 0].round(4))

# %%
# Poles and zeros alternate along the imaginary axis, as Foster found for every circuit without resistors: between two
# series resonances there is a frequency at which the branches block together.

phc.bode_plot(circuit, gain_unit="A/V", time_unit="s").figure.savefig("lc_bode.png", dpi=110)

# %%
# A voltage that is switched on for a second and a half supplies energy; when it is off the energy stays. The simulation
# is exact for an input that is held between samples: what is stored and what was supplied differ by rounding only.

t = np.linspace(0.0, 20.0, 2001)
voltage = np.where(t < 1.5, 1.0, 0.0)
response = phc.forced_response(circuit, t, voltage, intersample="zoh")
balance = phc.energy_balance(response, circuit)
print(f"stored less supplied, at most {np.max(np.abs(balance.defect)):.0e} J of {balance.stored[-1]:.3f} J")

figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(7, 5.5), layout="constrained")
top.plot(t, voltage, color="0.5", label="voltage")
top.plot(t, response.outputs, color="C0", label="current")
top.set_ylabel("Voltage [V], current [A]")
flux, charge = response.states[3:], response.states[:3]
parts = {"all": balance.stored, "capacitors": 0.5 * (charge**2 / C[:, None]).sum(0)}
parts["inductors"] = parts["all"] - parts["capacitors"]
for (name, energy), style in zip(parts.items(), ("k-", "C1--", "C2-"), strict=True):
    bottom.plot(t, energy, style, linewidth=1.6 if name == "all" else 1.0, label=name)
bottom.set_ylim(0, None)
bottom.set_xlim(0, t[-1])
bottom.set_ylabel("Stored energy [J]")
bottom.set_xlabel("Time [s]")
for axis in (top, bottom):
    axis.grid(True, alpha=0.4)
    axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, fontsize="small", frameon=False)
figure.savefig("lc_energy.png", dpi=110)

# %%
# The model is a `control.StateSpace`. A source with an inner resistance of 0.5 ohm is a feedback from current to
# voltage.

print("with 0.5 ohm:", ct.poles(ct.feedback(circuit, 0.5)).round(3))

"""
The circuit of a crystal from its admittance
============================================

A quartz crystal is a series branch (motional inductance, capacitance and resistance) beside the capacitance of its
electrodes: the circuit of Butterworth and Van Dyke. An analyser measures the admittance around a resonance, from which
the four elements follow; and the circuit then predicts what was not measured, here the crystal as a filter.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

Lm, Cm, Rm, Cp = 12.665e-3, 20e-15, 15.0, 5e-12  # H, F, ohm, F
rng = np.random.default_rng(0)
f = 1 / (2 * np.pi * np.sqrt(Lm * Cm)) + np.linspace(-3e3, 3e3, 401)
s = 2j * np.pi * f
exact = 1 / (Rm + s * Lm + 1 / (s * Cm)) + s * Cp
admittance = exact + 2e-6 * (rng.standard_normal(401) + 1j * rng.standard_normal(401))
measured = ct.frd(admittance, s.imag, inputs="voltage [V]", outputs="current [A]")
measured.time_unit = "s"

# %%
# One mode in the band. What lies outside, here the electrodes, are background terms of the fit. The data reject a
# branch without resistance, and not one of the kind of the circuit.

result = phc.pem(measured, 1, ports=[(0, 0)])
print(result.summary())
assert result.structure == "classical"

# %%
# ``netlist`` makes a branch of the mode. What is left of the measurement belongs to the electrodes. Models drawn from
# the distribution of the estimate tell how sure the three elements of the branch are.

branch = phc.netlist(result.system)
L, R, C = (next(one.value for one in branch.elements if one.letter == letter) for letter in "LRC")
rest = admittance - result.system(s)
electrodes = np.sum(rest.imag * s.imag) / np.sum(s.imag**2)

drawn = result.sample(1000, rng=1)
inductances, poles = 0.5 / drawn.residues[:, 0, 0, 0].real, drawn.poles[:, 0]
spread = {
    "Lm": np.std(inductances), "Rm": np.std(-2 * poles.real * inductances),
    "Cm": np.std(1 / (inductances * np.abs(poles) ** 2)),
    "Cp": np.std(rest.imag - electrodes * s.imag) / np.sqrt(np.sum(s.imag**2)),
}  # fmt: skip
for name, value, true in (("Lm", L, Lm), ("Rm", R, Rm), ("Cm", C, Cm), ("Cp", electrodes, Cp)):
    print(f"{name} {value:.7g} +- {1.96 * spread[name]:.1g}, off by {100 * (value / true - 1):+.4f} %")
    assert abs(value - true) < 3 * spread[name] < 2e-3 * true

# %%
# The crystal between a source and a load of 50 ohm each, as a netlist: the current of the source times 50 ohm is the
# voltage at the load.

filter_circuit = phc.read_netlist(f"""crystal as a filter
V1 in 0 AC 1
Rs in a 50
L1 a b {float(L)!r}
R1 b c {float(R)!r}
C1 c out {float(C)!r}
C0 a out {float(electrodes)!r}
Rl out 0 50
.end""")
print("states:", *filter_circuit.state_labels)
print("damping ratios:", *(f"{ratio:.4g}" for ratio in filter_circuit.damping_ratios))
assert phc.passivity(filter_circuit).is_passive

wide = f.mean() + np.linspace(-10e3, 40e3, 4001)
gain = 50 * filter_circuit(2j * np.pi * wide)
truth = 50 / (100 + 1 / (1 / (Rm + 2j * np.pi * wide * Lm + 1 / (2j * np.pi * wide * Cm)) + 2j * np.pi * wide * Cp))
notch = wide[np.abs(gain).argmin()]  # the parallel resonance, far out of the measured band
true_notch = wide[np.abs(truth).argmin()]
print(f"notch {notch - f.mean():.0f} Hz above the series resonance, exact {true_notch - f.mean():.0f} Hz")
assert abs(notch - true_notch) < 200

# %%
# Left: the measurement, and the model of the branch with its electrodes. Right: the filter over a wider band.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
offset = 1e-3 * (f - f.mean())
left.semilogy(offset, np.abs(admittance), ".", markersize=4, color="0.6", label="measured")
left.semilogy(offset, np.abs(result.system(s) + s * electrodes), color="C0", label="four elements")
left.set(xlabel=f"Frequency above {1e-6 * f.mean():.4f} MHz [kHz]", ylabel="Admittance [S]", title="Crystal alone")
left.legend()
offset = 1e-3 * (wide - f.mean())
right.plot(offset, 20 * np.log10(np.abs(truth)), color="0.75", linewidth=5, label="exact")
right.plot(offset, 20 * np.log10(np.abs(gain)), color="C0", label="four elements found")
right.axvspan(-3, 3, color="0.92", zorder=0, label="band of the measurement")
right.set(
    xlabel=f"Frequency above {1e-6 * f.mean():.4f} MHz [kHz]",
    ylabel="Load over source voltage [dB]",
    title="As a filter",
)
right.legend(loc="upper right")
for axis in (left, right):
    axis.grid(True, alpha=0.4)
figure.savefig("crystal_circuit.png", dpi=110)

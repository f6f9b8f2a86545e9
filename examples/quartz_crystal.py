"""
A quartz crystal
================

The equivalent circuit of a quartz resonator is a motional branch, inductance `Lm` and capacitance `Cm` in series, in
parallel with the capacitance `Cp` of its electrodes. Without its resistance of some ohms the circuit is lossless, and
its impedance `Z(s) = (1 + Lm Cm s^2) / (s (Cp + Cm + Lm Cm Cp s^2))` a port-Hamiltonian system from current to voltage.

The element values are typical of a crystal for 10 MHz: Cm = 20 fF, Cp = 5 pF, and Lm = 12.7 mH as the frequency asks.
They span twelve decades, and the two resonances are 0.2 % apart.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

f_series, Cm, Cp = 10e6, 20e-15, 5e-12  # Hz, F, F
Lm = 1 / ((2 * np.pi * f_series) ** 2 * Cm)
print(f"Lm = {1e3 * Lm:.2f} mH")


def crystal(load=0.0):
    """Return the crystal with a capacitance in parallel to its electrodes, from current to voltage."""
    C = Cp + load
    impedance = ct.tf([Lm * Cm, 0, 1], [Lm * Cm * C, 0, C + Cm, 0])
    return phc.ph(impedance, name=f"load {1e12 * load:.0f} pF", inputs="current", outputs="voltage")


# %%
# `ph` checks that the impedance is lossless and finds its modes: the parallel resonance, and a mode at frequency 0,
# which is the charge that a direct current leaves behind. The series resonance is the zero of the impedance.

bare = crystal()
f_parallel = bare.d[-1] / (2 * np.pi)
(zero,) = (z.imag for z in bare.modes.zeros if z.imag > 0)
print(f"series {zero / (2 * np.pi):.3f} Hz, parallel {f_parallel:.3f} Hz")
exact = f_series * np.sqrt(1 + Cm / Cp)
print(f"relative error of the parallel resonance {abs(f_parallel / exact - 1):.0e}")
print(f"direct current charges {1e12 / bare.modes.kappa_0:.3f} pF, the formula says {1e12 * (Cp + Cm):.3f} pF")
assert abs(f_parallel / exact - 1) < 1e-12

# %%
# The magnitude around the two resonances, for the bare crystal and with a capacitance in parallel. The frequencies come
# close to pole and zero from both sides: on a uniform grid the height of a peak would be chance.

near = np.geomspace(1e-5, 30e3, 400)  # Hz
figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for load, style in ((0.0, "-"), (10e-12, "--"), (30e-12, "-.")):
    loaded = crystal(load)
    pole = loaded.d[-1] / (2 * np.pi) - f_series
    offset = np.sort(np.concatenate([pole - near, pole + near, -near, near]))
    axis.semilogy(
        1e-3 * offset,
        np.abs(loaded.modes.freqresp(2 * np.pi * (f_series + offset))),
        style,
        label=f"{1e12 * load:.0f} pF",
    )
axis.set_xlim(-10, 30)
axis.set_xlabel("Frequency above 10 MHz [kHz]")
axis.set_ylabel("Impedance [ohm]")
axis.set_ylim(1.0, 1e8)
axis.grid(True, alpha=0.4)
axis.legend(title="load", loc="upper right")
figure.savefig("quartz_impedance.png", dpi=110)

# %%
# A load capacitance pulls the frequency. Data sheets use `f = f_s (1 + Cm / (2 (Cp + CL)))`, the first term of the
# root. Its error is two parts in a million without a load, and soon less.

swept = np.linspace(0.0, 40e-12, 161)
pulled = np.array([crystal(load).d[-1] for load in swept]) / (2 * np.pi)
rule = f_series * (1 + Cm / (2 * (Cp + swept)))
figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7, 5), layout="constrained")
above.plot(1e12 * swept, 1e6 * (pulled / f_series - 1), color="C0", label="root of the impedance")
above.plot(1e12 * swept, 1e6 * (rule / f_series - 1), "k--", linewidth=1, label="rule of the data sheet")
above.set_ylabel("Above the series\nresonance [ppm]")
above.legend()
below.plot(1e12 * swept, 1e6 * (rule / pulled - 1), color="C3")
below.set_ylabel("Error of\nthe rule [ppm]")
below.set_xlabel("Load capacitance [pF]")
for axis in (above, below):
    axis.grid(True, alpha=0.4)
figure.savefig("quartz_pulling.png", dpi=110)
for load in (0, 80):
    print(f"error of the rule at {swept[load] * 1e12:.0f} pF: {1e6 * (rule[load] / pulled[load] - 1):.3f} ppm")

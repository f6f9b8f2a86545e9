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
# The magnitude near the two resonances, for the bare crystal and with a capacitance in parallel.

loads = np.array([0.0, 10e-12, 30e-12])
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
offset = np.linspace(-10e3, 30e3, 4001)
for load in loads:
    Z = crystal(load).modes.freqresp(2 * np.pi * (f_series + offset))
    left.semilogy(1e-3 * offset, np.abs(Z), label=f"{1e12 * load:.0f} pF")
left.set_xlabel("Frequency above 10 MHz [kHz]")
left.set_ylabel("Impedance [ohm]")
left.set_ylim(1.0, 1e8)
left.set_title("Impedance of crystal and load", loc="left", fontsize="medium")
left.legend(title="load", fontsize="small", loc="upper right")

# %%
# A load capacitance pulls the frequency. Data sheets use `f = f_s (1 + Cm / (2 (Cp + CL)))`, which is the first term of
# the root; the error is a few parts in 1e6 without a load, which matters for a clock, and soon less.

swept = np.linspace(0.0, 40e-12, 41)
pulled = np.array([crystal(load).d[-1] for load in swept]) / (2 * np.pi)
rule = f_series * (1 + Cm / (2 * (Cp + swept)))
right.plot(1e12 * swept, 1e6 * (pulled / f_series - 1), color="C0", label="root of the impedance")
right.plot(1e12 * swept, 1e6 * (rule / f_series - 1), "k--", linewidth=1, label="rule of the data sheet")
right.set_xlabel("Load capacitance [pF]")
right.set_ylabel("Parallel resonance above series [ppm]")
right.set_title("Pulling", loc="left", fontsize="medium")
right.legend(fontsize="small")
for axis in (left, right):
    axis.grid(True, alpha=0.4)
figure.savefig("quartz.png", dpi=110)
for load in (0, 20):
    error = rule[load] / pulled[load] - 1
    print(f"error of the rule at {load} pF: {1e6 * error:.3f} ppm")

"""
A circuit from its impedance
============================

A bank of three filters hangs at the terminals of a converter and takes the harmonics 5, 7 and 11 of 50 Hz: each is a
coil, its resistance and a capacitor in series. An impedance analyser measures the bank as a whole, 150 to 800 Hz, with
an error of 1 % of each value. What are the nine elements?
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

L, R = np.array([12e-3, 8e-3, 4e-3]), np.array([0.35, 0.30, 0.25])  # H, ohm
C = 1 / (L * (2 * np.pi * np.array([245.0, 345.0, 540.0])) ** 2)  # tuned a little below the harmonics
bank = phc.lc_circuit(C, L, R=R)  # from voltage to current: an admittance

# %%
# The measurement. Its error is in proportion to the admittance, and so are the weights: 1/variance.

rng = np.random.default_rng(1)
f = np.arange(150.0, 801.0)
error = 0.01 * rng.standard_normal((2, f.size))
admittance = bank(2j * np.pi * f) * (1 + error[0] + 1j * error[1])
measured = ct.frd(admittance, 2 * np.pi * f, inputs="voltage [V]", outputs="current [A]")
measured.time_unit = "s"

# %%
# Voltage and current belong to one port. The simplest model that the data do not reject is looked for: without losses
# it is not, and with one series branch for each mode it is.

result = phc.pem(measured, ports=[(0, 0)], weights=1 / np.abs(admittance) ** 2)
print(result.summary())
assert result.order == 3 and result.structure == "classical"

# %%
# A branch is ``kappa s / (s^2 + 2 zeta d s + d^2)``, where ``kappa = 1 / L = 2 Re rho``. Models drawn from the
# distribution of the estimate carry its uncertainty over to the elements.


def elements(poles, residues):
    """Resistances, inductances and capacitances of the branches, each of shape (..., 3)."""
    inductance = 1 / (2 * residues.real)
    return -2 * poles.real * inductance, inductance, 1 / (np.abs(poles) ** 2 * inductance)


found = elements(result.poles, result.residues[:, 0, 0])
drawn = result.sample(2000, rng=0)
spread = [values.std(axis=0) for values in elements(drawn.poles, drawn.residues[:, :, 0, 0])]
for name, unit, size, values, deviations, true in zip(
    ("R", "L", "C"), ("ohm", "mH", "uF"), (1, 1e3, 1e6), found, spread, (R, L, C), strict=True
):
    text = ", ".join(f"{size * v:.4f} +- {size * s:.4f}" for v, s in zip(values, deviations, strict=True))
    print(f"{name} [{unit}]: {text}; true {', '.join(f'{size * one:.4f}' for one in true)}")
    assert np.all(np.abs(values - true) < 4.5 * deviations)

circuit = phc.lc_circuit(found[2], found[1], R=found[0])
assert phc.passivity(circuit).is_passive

# %%
# The impedance of the circuit through the measurement, and how far the elements are off, with their 95 % intervals.

figure, axes = plt.subplot_mosaic(
    [["above", "errors"], ["below", "errors"]], figsize=(10, 5), layout="constrained", width_ratios=(1.6, 1),
    height_ratios=(1.4, 1),
)  # fmt: skip
above, below, errors = (axes[name] for name in ("above", "below", "errors"))
fine = np.linspace(f[0], f[-1], 3000)
line = 1 / circuit(2j * np.pi * fine)
above.semilogy(f, np.abs(1 / admittance), ".", markersize=3, color="0.6", label="measured")
above.semilogy(fine, np.abs(line), color="C0", label="circuit of nine elements")
above.set(ylabel="Impedance [ohm]", xlim=(f[0], f[-1]))
above.legend(loc="upper right")
below.plot(f, np.degrees(np.angle(1 / admittance)), ".", markersize=3, color="0.6")
below.plot(fine, np.degrees(np.angle(line)), color="C0")
below.set(xlabel="Frequency [Hz]", ylabel="Phase [deg]", yticks=(-90, 0, 90), xlim=(f[0], f[-1]))
for axis in (above, below):
    axis.grid(True, alpha=0.4)

names, offsets, widths = [], [], []
for k in range(3):
    for name, values, deviations, true in zip("RLC", found, spread, (R, L, C), strict=True):
        names.append(f"${name}_{k + 1}$")
        offsets.append(100 * (values[k] / true[k] - 1))
        widths.append(196 * deviations[k] / true[k])
places = np.arange(9)[::-1]
errors.axvline(0, color="0.3", linewidth=1)
errors.errorbar(offsets, places, xerr=widths, fmt="o", color="C0", capsize=3)
errors.set(yticks=places, xlabel="Estimated less true [%]", title="Elements, 95 % intervals")
errors.set_yticklabels(names)
errors.grid(True, axis="x", alpha=0.4)
figure.savefig("filter_bank.png", dpi=110)
